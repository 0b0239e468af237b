//! Autocorrelation of images by Fourier transform, in `f64`.

use std::sync::Arc;

use ndarray::Array2;
use rayon::prelude::*;
use rustfft::{Fft, FftPlanner, num_complex::Complex64};

/// Largest number of parts that sums are formed over. It does not depend on the number of threads, so neither do the
/// sums.
const MOST_PARTS: usize = 16;
/// Approximate number of spectrum values that all parts together hold.
const MOST_PART_VALUES: usize = 1 << 25;

/// Two-dimensional transform of a fixed grid, unnormalised. The forward transform leaves its result transposed.
struct Fft2 {
    rows: usize,
    cols: usize,
    along_rows: Arc<dyn Fft<f64>>,
    along_cols: Arc<dyn Fft<f64>>,
    back_along_rows: Arc<dyn Fft<f64>>,
    back_along_cols: Arc<dyn Fft<f64>>,
}

impl Fft2 {
    fn new(rows: usize, cols: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self {
            rows,
            cols,
            along_rows: planner.plan_fft_forward(cols),
            along_cols: planner.plan_fft_forward(rows),
            back_along_rows: planner.plan_fft_inverse(cols),
            back_along_cols: planner.plan_fft_inverse(rows),
        }
    }

    fn forward(&self, grid: &mut Vec<Complex64>) {
        self.along_rows.process(grid);
        *grid = transposed(grid, self.rows, self.cols);
        self.along_cols.process(grid);
    }

    fn back(&self, grid: &mut Vec<Complex64>) {
        self.back_along_cols.process(grid);
        *grid = transposed(grid, self.cols, self.rows);
        self.back_along_rows.process(grid);
    }
}

fn transposed(grid: &[Complex64], rows: usize, cols: usize) -> Vec<Complex64> {
    (0..cols).flat_map(|col| (0..rows).map(move |row| grid[row * cols + col])).collect()
}

/// Linear (zero-padded) autocorrelation summed over `count` images of one shape.
///
/// `fill(index, store)` passes every non-zero pixel of image `index` as `store(row, col, value)`. The result has shape
/// `(2 L + 1, 2 L + 1)`, with lag (0, 0) in the middle. Lags beyond the image are 0.
pub(super) fn summed_autocorrelation(
    count: usize,
    (rows, cols): (usize, usize),
    max_lag: usize,
    fill: impl Fn(usize, &mut dyn FnMut(usize, usize, f64)) + Sync,
) -> Array2<f64> {
    let (row_lag, col_lag) = (max_lag.min(rows.saturating_sub(1)), max_lag.min(cols.saturating_sub(1)));
    let (grid_rows, grid_cols) = (fast_length(rows + row_lag), fast_length(cols + col_lag));
    let fft = Fft2::new(grid_rows, grid_cols);
    let pairs = count.div_ceil(2);
    let parts = (MOST_PART_VALUES / (grid_rows * grid_cols)).clamp(1, MOST_PARTS).min(pairs);
    let sums: Vec<Vec<f64>> = (0..parts)
        .into_par_iter()
        .map(|part| {
            let mut power = vec![0.0; grid_rows * grid_cols];
            let mut grid = vec![Complex64::ZERO; grid_rows * grid_cols];
            for pair in (part..pairs).step_by(parts) {
                // Two real images share one complex transform: the autocorrelation of a + ib has the real part
                // of those of a and b added.
                grid.fill(Complex64::ZERO);
                fill(2 * pair, &mut |row, col, value| grid[row * grid_cols + col].re = value);
                if 2 * pair + 1 < count {
                    fill(2 * pair + 1, &mut |row, col, value| grid[row * grid_cols + col].im = value);
                }
                fft.forward(&mut grid);
                power.iter_mut().zip(&grid).for_each(|(sum, value)| *sum += value.norm_sqr());
            }
            power
        })
        .collect();
    let mut grid = vec![Complex64::ZERO; grid_rows * grid_cols];
    for part in &sums {
        grid.iter_mut().zip(part).for_each(|(sum, value)| sum.re += value);
    }
    fft.back(&mut grid);
    let norm = 1.0 / (grid_rows * grid_cols) as f64;
    Array2::from_shape_fn((2 * max_lag + 1, 2 * max_lag + 1), |(row, col)| {
        if row.abs_diff(max_lag) > row_lag || col.abs_diff(max_lag) > col_lag {
            return 0.0;
        }
        let (row, col) = ((row + grid_rows - max_lag) % grid_rows, (col + grid_cols - max_lag) % grid_cols);
        grid[row * grid_cols + col].re * norm
    })
}

/// Next length whose only prime factors are 2, 3 and 5.
fn fast_length(length: usize) -> usize {
    let mut candidate = length.max(1);
    loop {
        let mut left = candidate;
        for factor in [2, 3, 5] {
            while left.is_multiple_of(factor) {
                left /= factor;
            }
        }
        if left == 1 {
            return candidate;
        }
        candidate += 1;
    }
}

/// Estimated autocovariance of shape `(2 L + 1, 2 L + 1)`, made valid for a stationary process. With its own period, the
/// spectrum is clipped at 0 and scaled so that the variance stays.
pub(super) fn positive_semidefinite(covariance: &Array2<f64>) -> Array2<f64> {
    let (rows, cols) = covariance.dim();
    let variance = covariance[[rows / 2, cols / 2]];
    let fft = Fft2::new(rows, cols);
    let mut grid = spectrum(covariance, &fft);
    let (mut before, mut after) = (0.0, 0.0);
    for value in &mut grid {
        before += value.re;
        *value = Complex64::from(value.re.max(0.0));
        after += value.re;
    }
    if after <= 0.0 || variance <= 0.0 {
        return Array2::zeros((rows, cols));
    }
    fft.back(&mut grid);
    let norm = before / after / (rows * cols) as f64;
    Array2::from_shape_fn((rows, cols), |(row, col)| {
        grid[(row + rows - rows / 2) % rows * cols + (col + cols - cols / 2) % cols].re * norm
    })
}

/// Spectrum, transposed, of a periodic array whose middle is lag (0, 0). The period is the shape of the array.
fn spectrum(covariance: &Array2<f64>, fft: &Fft2) -> Vec<Complex64> {
    let (rows, cols) = covariance.dim();
    let mut grid: Vec<Complex64> = (0..rows * cols)
        .map(|index| {
            let (row, col) = (index / cols, index % cols);
            Complex64::from(covariance[[(row + rows / 2) % rows, (col + cols / 2) % cols]])
        })
        .collect();
    fft.forward(&mut grid);
    grid
}

/// Least value of the spectrum of a periodic covariance whose middle is lag (0, 0).
#[cfg(test)]
pub(super) fn least_eigenvalue(covariance: &Array2<f64>) -> f64 {
    let (rows, cols) = covariance.dim();
    spectrum(covariance, &Fft2::new(rows, cols)).iter().map(|value| value.re).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn autocorrelation_is_that_of_the_double_loop() {
        let (rows, cols, count, max_lag) = (5_usize, 7_usize, 35_usize, 6_usize);
        let image = |index: usize, row: usize, col: usize| ((index * 31 + row * 17 + col * 5) % 13) as f64 - 3.0;
        let fast = summed_autocorrelation(count, (rows, cols), max_lag, |index, store| {
            for row in 0..rows {
                for col in 0..cols {
                    store(row, col, image(index, row, col));
                }
            }
        });
        for ((lag_row, lag_col), value) in fast.indexed_iter() {
            let mut sum = 0.0;
            for index in 0..count {
                for row in 0..rows {
                    for col in 0..cols {
                        let (r, c) = ((row + lag_row).wrapping_sub(max_lag), (col + lag_col).wrapping_sub(max_lag));
                        if r < rows && c < cols {
                            sum += image(index, row, col) * image(index, r, c);
                        }
                    }
                }
            }
            assert!((value - sum).abs() < 1e-8, "lag {lag_row}, {lag_col}: {value} against {sum}");
        }
    }

    #[test]
    fn clipping_keeps_the_variance_and_a_valid_covariance() {
        let valid = Array2::from_shape_fn((9, 9), |(row, col)| {
            let lag = row.abs_diff(4) + col.abs_diff(4);
            if lag == 0 {
                4.0
            } else if lag == 1 {
                0.5
            } else {
                0.0
            }
        });
        let same = positive_semidefinite(&valid);
        assert!((&same - &valid).iter().all(|difference| difference.abs() < 1e-12));
        let invalid = valid.mapv(|value| if value < 1.0 { 4.0 * value } else { value });
        assert!(least_eigenvalue(&invalid) < -1.0);
        let repaired = positive_semidefinite(&invalid);
        assert!(least_eigenvalue(&repaired) > -1e-12 && (repaired[[4, 4]] - 4.0).abs() < 1e-12);
    }
}
