//! Two-dimensional Fourier transforms of real images, of one image at a time.
//!
//! A spectrum holds the non-negative column frequencies, one after another, each with all row frequencies. Neither direction is scaled:
//! forward and inverse together multiply by the number of points. Large images are distributed over threads; results do not depend on
//! their number.

use std::sync::Arc;

use ndarray::ArrayView2;
use rayon::prelude::*;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};

/// Rows and columns that are transposed together: the complex numbers of one cache line.
const BLOCK: usize = 8;
/// Least number of points that several threads share.
const SHARED_POINTS: usize = 1 << 17;

/// Plans for a grid of fixed shape.
#[derive(Clone)]
pub(super) struct Fourier {
    rows: usize,
    cols: usize,
    rows_forward: Arc<dyn RealToComplex<f32>>,
    rows_inverse: Arc<dyn ComplexToReal<f32>>,
    cols_forward: Arc<dyn Fft<f32>>,
    cols_inverse: Arc<dyn Fft<f32>>,
}

/// Buffer of one transform at a time.
pub(super) struct FourierBuffer {
    /// Half spectra of all rows.
    rows: Vec<Complex32>,
}

/// Smallest even length of at least `least` with no prime factor above 5.
pub(super) fn fast_length(least: usize) -> usize {
    let is_smooth = |mut length: usize| {
        for factor in [2, 3, 5] {
            while length.is_multiple_of(factor) {
                length /= factor;
            }
        }
        length == 1
    };
    // A power of two lies within a factor of two.
    let least = least.max(2);
    (least..2 * least).find(|&length| length.is_multiple_of(2) && is_smooth(length)).unwrap_or(2 * least)
}

impl Fourier {
    /// Plans for at least `rows` x `cols` points, rounded up to fast lengths.
    pub(super) fn at_least((rows, cols): (usize, usize)) -> Self {
        let (rows, cols) = (fast_length(rows), fast_length(cols));
        let (mut real, mut complex) = (RealFftPlanner::new(), FftPlanner::new());
        Self {
            rows,
            cols,
            rows_forward: real.plan_fft_forward(cols),
            rows_inverse: real.plan_fft_inverse(cols),
            cols_forward: complex.plan_fft_forward(rows),
            cols_inverse: complex.plan_fft_inverse(rows),
        }
    }

    /// Rows and columns of the grid.
    pub(super) fn shape(&self) -> (usize, usize) {
        (self.rows, self.cols)
    }

    /// Number of points.
    pub(super) fn points(&self) -> usize {
        self.rows * self.cols
    }

    /// Number of column frequencies.
    pub(super) fn half(&self) -> usize {
        self.cols / 2 + 1
    }

    pub(super) fn buffer(&self) -> FourierBuffer {
        FourierBuffer { rows: vec![Complex32::default(); self.rows * self.half()] }
    }

    /// A spectrum of zeros.
    pub(super) fn empty(&self) -> Vec<Complex32> {
        vec![Complex32::default(); self.rows * self.half()]
    }

    /// Number of rows or columns, of `length` points each, that one thread transforms at least.
    fn share(&self) -> usize {
        if self.points() < SHARED_POINTS { usize::MAX } else { 1 }
    }

    /// Spectrum of an image that fills the grid.
    pub(super) fn forward(&self, image: &[f32], spectrum: &mut [Complex32], buffer: &mut FourierBuffer) {
        let half = self.half();
        let share = self.share();
        buffer.rows.par_chunks_mut(half).with_min_len(share).zip(image.par_chunks(self.cols)).for_each_init(
            || (vec![0.0; self.cols], self.rows_forward.make_scratch_vec()),
            |(line, scratch), (transformed, pixels)| {
                line.copy_from_slice(pixels);
                // The transform fails only for wrong lengths, and these are those of the plan.
                let _ = self.rows_forward.process_with_scratch(line, transformed, scratch);
            },
        );
        let rows = &buffer.rows;
        let columns = spectrum.par_chunks_mut(BLOCK * self.rows).with_min_len(share).enumerate();
        columns.for_each_init(
            || vec![Complex32::default(); self.cols_forward.get_inplace_scratch_len()],
            |scratch, (block, columns)| {
                let first = block * BLOCK;
                let width = columns.len() / self.rows;
                for (row, values) in rows.chunks_exact(half).enumerate() {
                    for (col, &value) in values[first..first + width].iter().enumerate() {
                        columns[col * self.rows + row] = value;
                    }
                }
                self.cols_forward.process_with_scratch(columns, scratch);
            },
        );
    }

    /// Image of a spectrum, which is overwritten.
    pub(super) fn inverse(&self, spectrum: &mut [Complex32], image: &mut [f32]) {
        let half = self.half();
        let share = self.share();
        spectrum.par_chunks_mut(BLOCK * self.rows).with_min_len(share).for_each_init(
            || vec![Complex32::default(); self.cols_inverse.get_inplace_scratch_len()],
            |scratch, columns| self.cols_inverse.process_with_scratch(columns, scratch),
        );
        let spectrum = &*spectrum;
        image.par_chunks_mut(BLOCK * self.cols).with_min_len(share).enumerate().for_each_init(
            || (vec![Complex32::default(); BLOCK * half], self.rows_inverse.make_scratch_vec()),
            |(lines, scratch), (block, pixels)| {
                let first = block * BLOCK;
                let height = pixels.len() / self.cols;
                for (col, values) in spectrum.chunks_exact(self.rows).enumerate() {
                    for (row, &value) in values[first..first + height].iter().enumerate() {
                        lines[row * half + col] = value;
                    }
                }
                for (line, pixels) in lines.chunks_exact_mut(half).zip(pixels.chunks_exact_mut(self.cols)) {
                    // A real image has real values at the lowest and the highest frequency; rounding leaves imaginary parts.
                    line[0].im = 0.0;
                    line[half - 1].im = 0.0;
                    let _ = self.rows_inverse.process_with_scratch(line, pixels, scratch);
                }
            },
        );
    }

    /// Spectrum of a small image at the origin of the grid, zeros elsewhere.
    pub(super) fn spectrum_of(&self, image: ArrayView2<'_, f32>) -> Vec<Complex32> {
        let mut grid = vec![0.0; self.points()];
        place(image, (0, 0), self.cols, &mut grid);
        let mut spectrum = self.empty();
        self.forward(&grid, &mut spectrum, &mut self.buffer());
        spectrum
    }
}

/// Writes an image into a grid of `cols` columns, its first pixel at `corner`.
pub(super) fn place(image: ArrayView2<'_, f32>, corner: (usize, usize), cols: usize, grid: &mut [f32]) {
    for (row, pixels) in image.rows().into_iter().enumerate() {
        let start = (corner.0 + row) * cols + corner.1;
        grid[start..start + pixels.len()].iter_mut().zip(pixels).for_each(|(value, &pixel)| *value = pixel);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    #[test]
    fn transform_is_the_defining_sum_and_inverts() {
        let fourier = Fourier::at_least((11, 15));
        assert_eq!(fourier.shape(), (12, 16));
        let image: Vec<f32> = (0..192).map(|index| ((index * index) % 31) as f32 - 12.0).collect();
        let mut spectrum = fourier.empty();
        fourier.forward(&image, &mut spectrum, &mut fourier.buffer());
        for (u, v) in [(0, 0), (1, 0), (0, 3), (7, 8), (11, 5)] {
            let mut sum = rustfft::num_complex::Complex64::default();
            for (index, &value) in image.iter().enumerate() {
                let turns = (u * (index / 16)) as f64 / 12.0 + (v * (index % 16)) as f64 / 16.0;
                sum += f64::from(value) * rustfft::num_complex::Complex64::cis(-std::f64::consts::TAU * turns);
            }
            let found = spectrum[v * 12 + u];
            assert!((f64::from(found.re) - sum.re).hypot(f64::from(found.im) - sum.im) < 1e-3, "{u} {v}");
        }
        let mut back = vec![f32::NAN; 192];
        fourier.inverse(&mut spectrum, &mut back);
        assert!(back.iter().zip(&image).all(|(back, value)| (back / 192.0 - value).abs() < 1e-4));
    }

    #[test]
    fn large_grids_give_the_same_bits_on_any_number_of_threads() {
        let fourier = Fourier::at_least((400, 500));
        let image = Array2::from_shape_fn((400, 500), |(row, col)| ((row * 31 + col * 17) % 101) as f32);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| fourier.spectrum_of(image.view()))
        };
        assert_eq!(run(1), run(3));
    }
}
