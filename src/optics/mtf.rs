//! Modulation transfer function: contrast of each spatial frequency of the scene on the sensor.

use ndarray::{Array2, ArrayView2};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

/// |FFT2(h)| divided by its value at frequency 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Mtf {
    /// Shape (rows, cols) of the PSF, frequency 0 at (rows / 2, cols / 2), frequencies rising to the right and down.
    pub map: Array2<f32>,
    /// The horizontal cut through frequency 0: (cycles per pixel, modulation), from 0 to half the sampling rate.
    pub horizontal: Vec<[f64; 2]>,
    /// The vertical cut through frequency 0, likewise.
    pub vertical: Vec<[f64; 2]>,
}

impl Mtf {
    /// Mean modulation over all sampled frequencies above 0 and up to half the sampling rate in any direction (Nyquist).
    /// It compares masks and photographs of one pixel size. 0 for a PSF of one pixel.
    pub fn mean_below_nyquist(&self) -> f64 {
        let (rows, cols) = self.map.dim();
        let frequency = |index: usize, length: usize| (index as f64 - (length / 2) as f64) / length as f64;
        let (mut sum, mut count) = (0.0, 0_usize);
        for ((row, col), &modulation) in self.map.indexed_iter() {
            let radius = frequency(row, rows).hypot(frequency(col, cols));
            if radius > 0.0 && radius <= 0.5 {
                sum += f64::from(modulation);
                count += 1;
            }
        }
        sum / count.max(1) as f64
    }
}

/// The modulation transfer function of a PSF, shape (rows, cols), sampled at the PSF's own frequencies.
///
/// A PSF without light has modulation 0 everywhere.
pub fn modulation_transfer(psf: ArrayView2<'_, f64>) -> Mtf {
    let (rows, cols) = psf.dim();
    let mut planner = FftPlanner::new();
    let mut spectrum = psf.map(|&value| Complex::new(value, 0.0));
    let along_rows = planner.plan_fft_forward(cols);
    for mut row in spectrum.rows_mut() {
        let mut line = row.to_vec();
        along_rows.process(&mut line);
        row.assign(&ndarray::aview1(&line));
    }
    let along_cols = planner.plan_fft_forward(rows);
    for mut col in spectrum.columns_mut() {
        let mut line = col.to_vec();
        along_cols.process(&mut line);
        col.assign(&ndarray::aview1(&line));
    }
    let dc = spectrum[(0, 0)].norm();
    let modulation = |row: usize, col: usize| if dc > 0.0 { spectrum[(row, col)].norm() / dc } else { 0.0 };
    let map = Array2::from_shape_fn((rows, cols), |(row, col)| {
        modulation((row + rows - rows / 2) % rows, (col + cols - cols / 2) % cols) as f32
    });
    let horizontal = (0..=cols / 2).map(|k| [k as f64 / cols as f64, modulation(0, k % cols)]).collect();
    let vertical = (0..=rows / 2).map(|k| [k as f64 / rows as f64, modulation(k % rows, 0)]).collect();
    Mtf { map, horizontal, vertical }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Lenslet, heuristic_layout, render_psf};
    use ndarray::Axis;

    /// The transform of a Gaussian is exp(-2 pi^2 sigma^2 f^2). At sigma 2 the narrow grid and the sampling change it
    /// little.
    #[test]
    fn a_gaussian_has_a_gaussian_mtf() {
        let mut array = heuristic_layout(1);
        (array.rows, array.cols) = (64, 48);
        array.lenslets[0] = Lenslet::round(24.0, 32.0, 2.0, 1.0);
        let psf = render_psf(&array, 1).unwrap();
        let mtf = modulation_transfer(psf.index_axis(Axis(0), 0));
        for cut in [&mtf.horizontal, &mtf.vertical] {
            for &[frequency, modulation] in cut {
                let expected = (-2.0 * (std::f64::consts::PI * 2.0 * frequency).powi(2)).exp();
                assert!((modulation - expected).abs() < 1e-6, "{frequency}: {modulation} {expected}");
            }
        }
        assert!((mtf.map[(32, 24)] - 1.0).abs() < 1e-6);
        assert!((f64::from(mtf.map[(32, 25)]) - mtf.horizontal[1][1]).abs() < 1e-6);
        assert!((f64::from(mtf.map[(33, 24)]) - mtf.vertical[1][1]).abs() < 1e-6);
    }

    /// The mean of exp(-2 pi^2 sigma^2 f^2) over the disk |f| <= 1/2 is (1 - exp(-a/4)) 4 / a, a = 2 pi^2 sigma^2.
    #[test]
    fn mean_of_a_gaussian_is_that_of_its_closed_form() {
        let psf = |side: usize| {
            let mut array = heuristic_layout(1);
            (array.rows, array.cols) = (side, side);
            array.lenslets[0] = Lenslet::round(side as f64 / 2.0, side as f64 / 2.0, 0.8, 1.0);
            render_psf(&array, 1).unwrap().index_axis_move(Axis(0), 0)
        };
        let a = 2.0 * (std::f64::consts::PI * 0.8).powi(2);
        let expected = (1.0 - (-a / 4.0).exp()) * 4.0 / a;
        for side in [32, 45, 128] {
            let mean = modulation_transfer(psf(side).view()).mean_below_nyquist();
            assert!((mean / expected - 1.0).abs() < 0.03, "{side}: {mean} {expected}");
        }
        assert_eq!(modulation_transfer(Array2::ones((1, 1)).view()).mean_below_nyquist(), 0.0);
    }

    /// Two equal points d pixels apart: |cos(pi d f)|.
    #[test]
    fn two_points_make_fringes_across_their_separation() {
        let mut psf = Array2::zeros((32, 32));
        psf[(10, 4)] = 0.5;
        psf[(10, 12)] = 0.5;
        let mtf = modulation_transfer(psf.view());
        for &[frequency, modulation] in &mtf.horizontal {
            assert!((modulation - (std::f64::consts::PI * 8.0 * frequency).cos().abs()).abs() < 1e-12);
        }
        assert!(mtf.vertical.iter().all(|&[_, modulation]| (modulation - 1.0).abs() < 1e-12));
    }
}
