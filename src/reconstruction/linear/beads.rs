//! Moments of beads: independent sites, as many in every object, none beyond the field.

use std::sync::Arc;

use ndarray::{Array2, ArrayView2};
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use rustfft::num_complex::Complex32;

use super::conjugate_gradients::{MeasurementCovariance, PriorSample};
use super::light::{Light, mean_of_beads};
use super::stationary::{StationaryCovariance, StationaryMemory, StationaryMoments};
use crate::objects::{BeadPrior, ObjectSet};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::fourier::{Fourier, FourierBuffer, place};
use crate::reconstruction::model::ImagingModel;

/// Mean and covariance of a set of beads.
pub(super) struct BeadMoments {
    pub(super) prior: BeadPrior,
    /// Mean on the scale of the set, photons per pixel.
    pub(super) mean: Array2<f32>,
    /// Moments without the border, whose inverse is a filter.
    inside: Arc<StationaryMoments>,
    /// Factor from lit objects to the scale of the set.
    pub(super) to_set_scale: f64,
}

impl BeadMoments {
    /// Moments of a set whose beads have this prior.
    pub(super) fn learn(set: &ObjectSet, prior: BeadPrior, light: Light) -> Result<Self, ReconstructionError> {
        let mean = mean_of_beads(&prior, set.field());
        let inside = Arc::new(StationaryMoments::learn(set, light)?);
        Ok(Self { prior, mean, inside, to_set_scale: light.to_set_scale(set.mean()) })
    }
}

/// Covariance of measurements of beads.
pub(super) struct BeadCovariance {
    moments: Arc<BeadMoments>,
    field: (usize, usize),
    measured: (usize, usize),
    /// First pixel of the measurement within the field, for the transpose of the valid convolution.
    corner: (usize, usize),
    /// Grid on which neither the mask nor a bead reaches from one side of the field to the other.
    grid: Fourier,
    /// Spectra of the mask, and of a bead on the scale of the set.
    mask: Vec<Complex32>,
    bead: Vec<Complex32>,
    inside: StationaryCovariance,
}

/// Images of one thread.
pub(super) struct BeadMemory {
    image: Vec<f32>,
    spectrum: Vec<Complex32>,
    buffer: FourierBuffer,
    inside: StationaryMemory,
}

impl BeadCovariance {
    pub(super) fn new(model: &ImagingModel, moments: Arc<BeadMoments>) -> Self {
        let (field, psf, spot) = (model.field(), model.psf(), moments.prior.spot.view());
        let grid = Fourier::at_least((field.0 + spot.nrows(), field.1 + spot.ncols()));
        let (rows, cols) = grid.shape();
        let mut bead = vec![0.0; grid.points()];
        let (anchor_row, anchor_col) = moments.prior.anchor;
        for ((row, col), &photons) in spot.indexed_iter() {
            bead[(row + rows - anchor_row) % rows * cols + (col + cols - anchor_col) % cols] = photons as f32;
        }
        let mut spectrum = grid.empty();
        grid.forward(&bead, &mut spectrum, &mut grid.buffer());
        Self {
            field,
            measured: model.measurement_shape(),
            corner: (psf.nrows() - 1, psf.ncols() - 1),
            mask: grid.spectrum_of(psf.mapv(|value| value as f32).view()),
            bead: spectrum,
            inside: StationaryCovariance::new(model, moments.inside.clone()),
            grid,
            moments,
        }
    }

    /// Sites of the transposed measurement, times their covariance, on the grid; scaled for both transforms.
    fn sites(&self, v: &[f32], memory: &mut BeadMemory) {
        let cols = self.grid.shape().1;
        memory.image.fill(0.0);
        // Callers pass measurements.
        if let Ok(v) = ArrayView2::from_shape(self.measured, v) {
            place(v, self.corner, cols, &mut memory.image);
        }
        self.grid.forward(&memory.image, &mut memory.spectrum, &mut memory.buffer);
        let factors = self.mask.iter().zip(&self.bead);
        memory.spectrum.iter_mut().zip(factors).for_each(|(value, (mask, bead))| *value *= (mask * bead).conj());
        self.grid.inverse(&mut memory.spectrum, &mut memory.image);
        let variance = self.site_variance() / (self.grid.points() as f64).powi(2);
        self.with_fixed_count(&mut memory.image, variance);
    }

    /// Variance of a site among the fixed number of beads, for the covariance `variance (I - 1/sites)`.
    fn site_variance(&self) -> f64 {
        let (p, sites) = (self.moments.prior.probability, (self.field.0 * self.field.1) as f64);
        p * (1.0 - p) * sites / (sites - 1.0).max(1.0)
    }

    /// Keeps the field of an image, without its mean, times `factor`.
    fn with_fixed_count(&self, image: &mut [f32], factor: f64) {
        let (rows, cols) = self.field;
        let wide = self.grid.shape().1;
        let sum: f64 = image.chunks_exact(wide).take(rows).flat_map(|line| &line[..cols]).map(|&v| f64::from(v)).sum();
        let mean = sum / (rows * cols) as f64;
        for (row, line) in image.chunks_exact_mut(wide).enumerate() {
            let inside = if row < rows { cols } else { 0 };
            line[..inside].iter_mut().for_each(|value| *value = ((f64::from(*value) - mean) * factor) as f32);
            line[inside..].fill(0.0);
        }
    }

    /// Convolves the sites in the memory with `spectrum`, and copies a part of the grid to `out`, times `scale`.
    fn convolve(
        &self,
        spectrum: impl Fn(usize) -> Complex32,
        (corner, width): ((usize, usize), usize),
        scale: f32,
        out: &mut [f32],
        memory: &mut BeadMemory,
    ) {
        self.grid.forward(&memory.image, &mut memory.spectrum, &mut memory.buffer);
        memory.spectrum.iter_mut().enumerate().for_each(|(at, value)| *value *= spectrum(at));
        self.grid.inverse(&mut memory.spectrum, &mut memory.image);
        let lines = memory.image.chunks_exact(self.grid.shape().1).skip(corner.0);
        for (to, from) in out.chunks_exact_mut(width).zip(lines) {
            to.iter_mut().zip(&from[corner.1..]).for_each(|(to, &from)| *to = scale * from);
        }
    }
}

impl MeasurementCovariance for BeadCovariance {
    type Memory = BeadMemory;

    fn memory(&self) -> BeadMemory {
        let grid = &self.grid;
        let (image, spectrum, buffer) = (vec![0.0; grid.points()], grid.empty(), grid.buffer());
        BeadMemory { image, spectrum, buffer, inside: self.inside.memory() }
    }

    fn mean_lit(&self) -> Array2<f32> {
        self.moments.mean.mapv(|value| (f64::from(value) / self.moments.to_set_scale) as f32)
    }

    fn apply(&self, v: &[f32], out: &mut [f32], memory: &mut BeadMemory) {
        self.sites(v, memory);
        let scale = self.moments.to_set_scale.powi(-2) as f32;
        let part = (self.corner, self.measured.1);
        self.convolve(|at| self.mask[at] * self.bead[at], part, scale, out, memory);
    }

    fn precondition(&self, r: &[f32], noise: &[f32], out: &mut [f32], memory: &mut BeadMemory) {
        self.inside.precondition(r, noise, out, &mut memory.inside);
    }

    fn estimate(&self, v: &[f32], out: &mut [f32], memory: &mut BeadMemory) {
        self.sites(v, memory);
        let scale = (1.0 / self.moments.to_set_scale) as f32;
        self.convolve(|at| self.bead[at], ((0, 0), self.field.1), scale, out, memory);
    }

    fn sample(&self, random: &mut dyn Rng, memory: &mut BeadMemory) -> PriorSample {
        memory.image.fill_with(|| random.sample(StandardNormal));
        self.with_fixed_count(&mut memory.image, self.site_variance().sqrt() / self.grid.points() as f64);
        let mut truth = vec![0.0; self.field.0 * self.field.1];
        self.convolve(|at| self.bead[at], ((0, 0), self.field.1), 1.0, &mut truth, memory);
        let scale = (1.0 / self.moments.to_set_scale) as f32;
        PriorSample { lit: truth.iter().map(|&value| value * scale).collect(), truth }
    }
}
