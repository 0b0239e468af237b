//! Moments of objects whose covariance is the same everywhere: whole images, mosaics cut at random places, beads far from the border.

use std::sync::Arc;

use ndarray::{Array2, ArrayView2, s};
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use rustfft::num_complex::Complex32;

use super::conjugate_gradients::{MeasurementCovariance, PriorSample};
use super::light::{Light, mean_object};
use crate::objects::{ObjectSet, Split};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::fourier::{Fourier, FourierBuffer, place};
use crate::reconstruction::model::ImagingModel;

/// Longest lag of the covariance, px. Pixels further apart are hardly correlated, and longer lags need larger transforms.
const LONGEST_LAG: usize = 255;

/// Mean and autocovariance of the objects of a set.
pub(in crate::reconstruction) struct StationaryMoments {
    /// Mean on the scale of the set, photons per pixel.
    mean: Array2<f32>,
    /// Covariance on the scale of the set by lag, (0, 0) in the middle, photons squared.
    autocovariance: Array2<f64>,
    /// Factor from lit objects to the scale of the set.
    to_set_scale: f64,
}

impl StationaryMoments {
    /// Moments of the training part of a set.
    pub(super) fn learn(set: &ObjectSet, light: Light) -> Result<Self, ReconstructionError> {
        let field = set.field();
        // Fails where there is no training image.
        set.objects(Split::Train, 1, 0)?;
        let mean = mean_object(set);
        let longest = field.0.max(field.1) - 1;
        let mut autocovariance = set.autocovariance(Split::Train, longest.min(LONGEST_LAG));
        if set.bead_prior().is_none() && longest > LONGEST_LAG {
            taper(&mut autocovariance);
        }
        Ok(Self { mean, autocovariance, to_set_scale: light.to_set_scale(set.mean()) })
    }

    /// Moments of a field of known mean and autocovariance.
    #[cfg(test)]
    pub(super) fn known(mean: Array2<f32>, autocovariance: Array2<f64>) -> Self {
        Self { mean, autocovariance, to_set_scale: 1.0 }
    }

    /// Mean object on the scale of the set.
    pub(super) fn mean_truth(&self) -> Array2<f32> {
        self.mean.clone()
    }
}

/// Lets a covariance fall to 0 at its longest lag. The factor is itself a covariance, so the product is one.
fn taper(autocovariance: &mut Array2<f64>) {
    let middle = autocovariance.nrows() / 2;
    for ((row, col), value) in autocovariance.indexed_iter_mut() {
        let share = |index: usize| 1.0 - index.abs_diff(middle) as f64 / (middle + 1) as f64;
        *value *= share(row) * share(col);
    }
}

/// Covariance of measurements of objects of stationary covariance.
pub(super) struct StationaryCovariance {
    moments: Arc<StationaryMoments>,
    field: (usize, usize),
    measured: (usize, usize),
    /// First pixel of the measurement within the field, for the transpose of the valid convolution.
    corner: (usize, usize),
    /// Grid on which lags of the whole field do not meet.
    wide: Fourier,
    /// Spectrum of the transposed encoder and the covariance, on the wide grid; scaled for the inverse transform.
    to_object: Vec<Complex32>,
    /// Square root of the spectrum of the covariance on the wide grid; scaled for draws.
    root: Vec<f32>,
    /// Grid on which lags of the measurement do not meet.
    narrow: Fourier,
    /// Spectrum of the covariance of the measurement on the narrow grid.
    kernel: Vec<f32>,
}

/// Images of one thread.
pub(super) struct StationaryMemory {
    image: Vec<f32>,
    spectrum: Vec<Complex32>,
    buffer: FourierBuffer,
}

impl StationaryMemory {
    fn new(fourier: &Fourier) -> Self {
        Self { image: vec![0.0; fourier.points()], spectrum: fourier.empty(), buffer: fourier.buffer() }
    }
}

impl StationaryCovariance {
    pub(super) fn new(model: &ImagingModel, moments: Arc<StationaryMoments>) -> Self {
        let (field, measured, psf) = (model.field(), model.measurement_shape(), model.psf());
        let lag = moments.autocovariance.nrows() / 2;
        let wide = Fourier::at_least((field.0 + lag, field.1 + lag));
        let narrow = Fourier::at_least((2 * measured.0 - 1, 2 * measured.1 - 1));
        let covariance = spectrum_of_lags(&wide, moments.autocovariance.view(), moments.autocovariance.dim());
        let encoder = wide.spectrum_of(psf.mapv(|value| value as f32).view());
        let scale = 1.0 / wide.points() as f32;
        // Covariance of the measurement by lag: autocorrelation of the PSF and covariance of the objects.
        let products = encoder.iter().zip(&covariance);
        let mut of_measurement: Vec<Complex32> =
            products.map(|(h, c)| Complex32::from(h.norm_sqr() * c.re * scale)).collect();
        let mut lags = vec![0.0; wide.points()];
        wide.inverse(&mut of_measurement, &mut lags);
        let (wide_rows, wide_cols) = wide.shape();
        let by_lag = Array2::from_shape_fn((2 * measured.0 - 1, 2 * measured.1 - 1), |(row, col)| {
            let wrapped = |index: usize, length: usize, grid: usize| (index + grid - (length - 1)) % grid;
            let at = wrapped(row, measured.0, wide_rows) * wide_cols + wrapped(col, measured.1, wide_cols);
            f64::from(lags[at])
        });
        let kernel = spectrum_of_lags(&narrow, by_lag.view(), by_lag.dim());
        Self {
            field,
            measured,
            corner: (psf.nrows() - 1, psf.ncols() - 1),
            to_object: encoder.iter().zip(&covariance).map(|(h, c)| h.conj() * c.re * scale).collect(),
            root: covariance.iter().map(|c| (c.re.max(0.0) * scale).sqrt()).collect(),
            kernel: kernel.iter().map(|value| value.re).collect(),
            moments,
            wide,
            narrow,
        }
    }

    /// The measurement filtered by a spectrum on the narrow grid.
    fn filter(&self, v: &[f32], out: &mut [f32], memory: &mut StationaryMemory, factor: impl Fn(f32) -> f32) {
        let StationaryMemory { image, spectrum, buffer } = memory;
        let cols = self.narrow.shape().1;
        image.fill(0.0);
        for (from, to) in v.chunks_exact(self.measured.1).zip(image.chunks_exact_mut(cols)) {
            to[..from.len()].copy_from_slice(from);
        }
        self.narrow.forward(image, spectrum, buffer);
        spectrum.iter_mut().zip(&self.kernel).for_each(|(value, &kernel)| *value *= factor(kernel));
        self.narrow.inverse(spectrum, image);
        for (to, from) in out.chunks_exact_mut(self.measured.1).zip(image.chunks_exact(cols)) {
            to.copy_from_slice(&from[..to.len()]);
        }
    }
}

/// Spectrum of an array of lags of this shape, (0, 0) in the middle, on a grid.
fn spectrum_of_lags(fourier: &Fourier, lags: ArrayView2<'_, f64>, (rows, cols): (usize, usize)) -> Vec<Complex32> {
    let (grid_rows, grid_cols) = fourier.shape();
    let mut grid = Array2::<f32>::zeros((grid_rows, grid_cols));
    for ((row, col), &value) in lags.indexed_iter() {
        let wrapped = |index: usize, length: usize, grid: usize| (index + grid - length / 2) % grid;
        grid[(wrapped(row, rows, grid_rows), wrapped(col, cols, grid_cols))] = value as f32;
    }
    fourier.spectrum_of(grid.view())
}

impl MeasurementCovariance for StationaryCovariance {
    type Memory = StationaryMemory;

    fn memory(&self) -> StationaryMemory {
        StationaryMemory::new(&self.narrow)
    }

    fn mean_lit(&self) -> Array2<f32> {
        self.moments.mean.mapv(|value| (f64::from(value) / self.moments.to_set_scale) as f32)
    }

    fn apply(&self, v: &[f32], out: &mut [f32], memory: &mut StationaryMemory) {
        let scale = self.lit_scale() / self.narrow.points() as f32;
        self.filter(v, out, memory, |kernel| kernel * scale);
    }

    fn precondition(&self, r: &[f32], noise: &[f32], out: &mut [f32], memory: &mut StationaryMemory) {
        let mean_noise = (noise.iter().map(|&value| f64::from(value)).sum::<f64>() / noise.len() as f64) as f32;
        let (scale, points) = (self.lit_scale(), self.narrow.points() as f32);
        self.filter(r, out, memory, |kernel| 1.0 / ((kernel.max(0.0) * scale + mean_noise) * points));
    }

    fn estimate(&self, v: &[f32], out: &mut [f32], _memory: &mut StationaryMemory) {
        let StationaryMemory { mut image, mut spectrum, mut buffer } = StationaryMemory::new(&self.wide);
        let cols = self.wide.shape().1;
        // Callers pass measurements.
        if let Ok(v) = ArrayView2::from_shape(self.measured, v) {
            place(v, self.corner, cols, &mut image);
        }
        self.wide.forward(&image, &mut spectrum, &mut buffer);
        spectrum.iter_mut().zip(&self.to_object).for_each(|(value, factor)| *value *= factor);
        self.wide.inverse(&mut spectrum, &mut image);
        // Covariance of the objects on the scale of the set with lit ones.
        let scale = (1.0 / self.moments.to_set_scale) as f32;
        for (to, from) in out.chunks_exact_mut(self.field.1).zip(image.chunks_exact(cols)) {
            to.iter_mut().zip(from).for_each(|(to, &from)| *to = scale * from);
        }
    }

    fn sample(&self, random: &mut dyn Rng, _memory: &mut StationaryMemory) -> PriorSample {
        let StationaryMemory { mut image, mut spectrum, mut buffer } = StationaryMemory::new(&self.wide);
        image.fill_with(|| random.sample(StandardNormal));
        self.wide.forward(&image, &mut spectrum, &mut buffer);
        // The root is scaled for one half of the inverse transform; this is the other.
        let scale = 1.0 / (self.wide.points() as f32).sqrt();
        spectrum.iter_mut().zip(&self.root).for_each(|(value, &root)| *value *= root * scale);
        self.wide.inverse(&mut spectrum, &mut image);
        let whole = ArrayView2::from_shape(self.wide.shape(), &image).map(|image| image.to_owned()).unwrap_or_default();
        let truth: Vec<f32> = whole.slice(s![..self.field.0, ..self.field.1]).iter().copied().collect();
        let scale = (1.0 / self.moments.to_set_scale) as f32;
        PriorSample { lit: truth.iter().map(|&value| value * scale).collect(), truth }
    }
}

impl StationaryCovariance {
    /// Factor from the covariance on the scale of the set to that of lit objects.
    fn lit_scale(&self) -> f32 {
        (1.0 / (self.moments.to_set_scale * self.moments.to_set_scale)) as f32
    }
}
