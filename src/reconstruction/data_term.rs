//! The data term of decoders without a prior: light above the background, the noise variance that weights it, and the residual.

use ndarray::{ArrayView2, ArrayView3, Axis};

use super::error::ReconstructionError;
use super::model::ImagingModel;
use crate::sensor::Convolution;

/// Pixels to each side that the variance of a pixel is estimated from.
const SURROUNDINGS_PX: usize = 2;

/// A measurement without background, and the weights of its pixels.
pub(super) struct DataTerm {
    /// Rows and columns.
    pub(super) shape: (usize, usize),
    /// Photons above the background, row by row; 0 where nothing was measured.
    pub(super) light: Vec<f32>,
    /// 1 / variance of each pixel; 0 where nothing was measured.
    pub(super) weights: Vec<f32>,
    /// Mean light of the measured pixels, photons.
    pub(super) mean: f64,
    /// Number of measured pixels.
    pub(super) pixels: f64,
}

impl DataTerm {
    /// The data term of a measurement in photons. A pixel that is NaN was not measured.
    ///
    /// # Errors
    /// [`ReconstructionError::NotFinite`] for infinite pixels, [`ReconstructionError::Dark`] without light above the background.
    pub(super) fn new(model: &ImagingModel, measurement: ArrayView2<'_, f32>) -> Result<Self, ReconstructionError> {
        if measurement.iter().any(|value| value.is_infinite()) {
            ReconstructionError::check_finite("measurement", &measurement.mapv(|v| if v.is_nan() { 0.0 } else { v }))?;
        }
        let means = local_means(measurement);
        let (mut sum, mut pixels) = (0.0, 0.0);
        for &value in measurement.iter().filter(|value| !value.is_nan()) {
            sum += f64::from(value);
            pixels += 1.0;
        }
        let scale = sum / f64::max(pixels, 1.0);
        let mean = scale - model.background;
        if mean <= 0.0 {
            return Err(ReconstructionError::Dark);
        }
        let background = model.background as f32;
        let light = measurement.iter().map(|&value| if value.is_nan() { 0.0 } else { value - background }).collect();
        let weight = |(&value, &mean): (&f32, &f32)| {
            if value.is_nan() { 0.0 } else { (1.0 / model.noise_variance(f64::from(mean), scale)) as f32 }
        };
        let weights = measurement.iter().zip(&means).map(weight).collect();
        Ok(Self { shape: measurement.dim(), light, weights, mean, pixels })
    }

    /// Inverse of the mean variance of the measured pixels.
    pub(super) fn typical_weight(&self) -> f64 {
        let variances = self.weights.iter().filter(|&&weight| weight > 0.0).map(|&weight| 1.0 / f64::from(weight));
        self.pixels / variances.sum::<f64>()
    }
}

/// Root mean square of what measurements have more or less than the images of their objects, in units of the noise of each pixel. It is 1
/// where nothing but noise is left. Pixels that are NaN were not measured.
///
/// Shapes are (n, field rows, field cols) and (n, rows, cols).
///
/// # Errors
/// [`ReconstructionError`] for images of other shapes than those of the model, for infinite pixels, and without light.
pub fn residual_in_noise(
    model: &ImagingModel,
    objects: ArrayView3<'_, f32>,
    measurements: ArrayView3<'_, f32>,
) -> Result<f64, ReconstructionError> {
    model.check_measurements(&measurements)?;
    let convolver = Convolution::new(model.field(), model.psf().dim())?.with_psf(model.psf().insert_axis(Axis(0)))?;
    let (mut squares, mut pixels) = (0.0, 0.0);
    for (object, measurement) in objects.outer_iter().zip(measurements.outer_iter()) {
        let data = DataTerm::new(model, measurement)?;
        let image = convolver.measure(object.insert_axis(Axis(0)).insert_axis(Axis(0)), 0.0)?;
        let residuals = data.light.iter().zip(&image).zip(&data.weights);
        squares += residuals.map(|((light, image), weight)| f64::from(weight * (light - image).powi(2))).sum::<f64>();
        pixels += data.pixels;
    }
    Ok((squares / f64::max(pixels, 1.0)).sqrt())
}

/// Mean of the measured pixels of the surroundings of every pixel; 0 where there is none.
fn local_means(image: ArrayView2<'_, f32>) -> Vec<f32> {
    let (rows, cols) = image.dim();
    let around =
        |index: usize, length: usize| index.saturating_sub(SURROUNDINGS_PX)..(index + SURROUNDINGS_PX + 1).min(length);
    // Sums along the rows first: (light, measured pixels).
    let mut along_rows = vec![(0.0_f32, 0.0_f32); rows * cols];
    for (line, values) in along_rows.chunks_exact_mut(cols).zip(image.rows()) {
        for (col, sum) in line.iter_mut().enumerate() {
            for value in around(col, cols).map(|other| values[other]).filter(|value| !value.is_nan()) {
                *sum = (sum.0 + value, sum.1 + 1.0);
            }
        }
    }
    let mut means = vec![0.0; rows * cols];
    for (row, line) in means.chunks_exact_mut(cols).enumerate() {
        for (col, mean) in line.iter_mut().enumerate() {
            let sums = around(row, rows).map(|other| along_rows[other * cols + col]);
            let (light, count) = sums.fold((0.0, 0.0), |sum, part| (sum.0 + part.0, sum.1 + part.1));
            *mean = if count > 0.0 { light / count } else { 0.0 };
        }
    }
    means
}
