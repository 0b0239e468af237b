//! Two-dimensional discrete Fourier transforms on a grid of fixed shape.

use std::sync::Arc;

use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

/// Plans for one grid. Neither direction is scaled: forward and back multiplies by the number of points.
#[derive(Clone)]
pub(in crate::information) struct Fourier2 {
    pub(in crate::information) rows: usize,
    pub(in crate::information) cols: usize,
    along_rows: [Arc<dyn Fft<f64>>; 2],
    along_cols: [Arc<dyn Fft<f64>>; 2],
}

/// Buffers of one transform at a time.
pub(in crate::information) struct Workspace {
    transposed: Vec<Complex64>,
    scratch: Vec<Complex64>,
}

impl Fourier2 {
    pub(in crate::information) fn new(rows: usize, cols: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self {
            rows,
            cols,
            along_rows: [planner.plan_fft_forward(cols), planner.plan_fft_inverse(cols)],
            along_cols: [planner.plan_fft_forward(rows), planner.plan_fft_inverse(rows)],
        }
    }

    pub(in crate::information) fn workspace(&self) -> Workspace {
        let plans = self.along_rows.iter().chain(&self.along_cols);
        let scratch = plans.map(|plan| plan.get_inplace_scratch_len()).max().unwrap_or(0);
        Workspace {
            transposed: vec![Complex64::default(); self.rows * self.cols],
            scratch: vec![Complex64::default(); scratch],
        }
    }

    /// Transforms row-major `data` in place. The first `filled_rows` rows alone may differ from zero.
    pub(in crate::information) fn forward(
        &self,
        data: &mut [Complex64],
        filled_rows: usize,
        workspace: &mut Workspace,
    ) {
        self.along_rows[0].process_with_scratch(&mut data[..filled_rows * self.cols], &mut workspace.scratch);
        self.along_columns(data, 0, workspace);
    }

    /// The unscaled inverse in place.
    pub(in crate::information) fn inverse(&self, data: &mut [Complex64], workspace: &mut Workspace) {
        self.along_rows[1].process_with_scratch(data, &mut workspace.scratch);
        self.along_columns(data, 1, workspace);
    }

    fn along_columns(&self, data: &mut [Complex64], direction: usize, workspace: &mut Workspace) {
        transpose(data, &mut workspace.transposed, self.rows, self.cols);
        self.along_cols[direction].process_with_scratch(&mut workspace.transposed, &mut workspace.scratch);
        transpose(&workspace.transposed, data, self.cols, self.rows);
    }
}

/// Writes the transpose of row-major `from` (rows x cols) to `to`, in tiles that fit the cache.
fn transpose(from: &[Complex64], to: &mut [Complex64], rows: usize, cols: usize) {
    const TILE: usize = 8;
    for row_start in (0..rows).step_by(TILE) {
        for col_start in (0..cols).step_by(TILE) {
            for c in col_start..cols.min(col_start + TILE) {
                for r in row_start..rows.min(row_start + TILE) {
                    to[c * rows + r] = from[r * cols + c];
                }
            }
        }
    }
}

/// The smallest length, at least `needed`, whose only prime factors are 2, 3 and 5.
pub(in crate::information) fn good_length(needed: usize) -> usize {
    let smooth = |n: &usize| {
        let mut n = *n;
        for factor in [2, 3, 5] {
            while n.is_multiple_of(factor) {
                n /= factor;
            }
        }
        n == 1
    };
    // A power of two lies within a factor of two.
    let needed = needed.max(1);
    (needed..2 * needed).find(smooth).unwrap_or(needed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transform_is_the_defining_sum_and_inverts() {
        let (rows, cols) = (6, 10);
        let fourier = Fourier2::new(rows, cols);
        let mut workspace = fourier.workspace();
        let signal: Vec<Complex64> =
            (0..rows * cols)
                .map(|i| {
                    if i < 3 * cols { Complex64::new((i * i % 7) as f64, (i % 5) as f64) } else { Complex64::default() }
                })
                .collect();
        let mut data = signal.clone();
        fourier.forward(&mut data, 3, &mut workspace);
        for (u, v) in [(0, 0), (1, 0), (0, 3), (5, 7)] {
            let mut sum = Complex64::default();
            for (i, value) in signal.iter().enumerate() {
                let turns = (u * (i / cols)) as f64 / rows as f64 + (v * (i % cols)) as f64 / cols as f64;
                sum += value * Complex64::cis(-2.0 * std::f64::consts::PI * turns);
            }
            assert!((data[u * cols + v] - sum).norm() < 1e-10);
        }
        fourier.inverse(&mut data, &mut workspace);
        for (back, value) in data.iter().zip(&signal) {
            assert!((back / (rows * cols) as f64 - value).norm() < 1e-12);
        }
    }

    #[test]
    fn good_lengths_are_smooth() {
        assert_eq!([1, 7, 61, 125, 127].map(good_length), [1, 8, 64, 125, 128]);
    }
}
