//! Network inputs: patches in photons converted to numbers of order one.

use std::ops::Range;

use ndarray::{Array2, ArrayView3};
use rayon::prelude::*;

use super::levels::{Levels, Scale};
use super::predictor::Predictor;
use super::stream::PatchBatch;
use crate::information::density::gaussian::stationary::StationaryGaussian;
use crate::information::error::InformationError;
use crate::sensor::Noise;

/// Channels of every past pixel in the first window: square root, photons, one, surprise.
pub(super) const WINDOW_CHANNELS: usize = 4;
/// Inputs at the present pixel that do not depend on its value: the prediction, its certainty, and the pixel's place.
pub(super) const PRESENT_CHANNELS: usize = 3 + BORDER_CHANNELS;
/// Of these, those that encode the pixel's place.
const BORDER_CHANNELS: usize = 6;
/// Noisy values predicted at every pixel whose clean value is known. All are equally likely given the past, so the
/// loss has the same mean for any number of them. More values make the gradient steadier.
pub(super) const TARGETS: usize = 8;
/// Number of far places that serve as inputs.
pub(super) const FAR_PLACES: usize = 16;
/// A place outside every patch.
pub(super) const NOWHERE: (isize, isize) = (-1_000_000, 0);
/// Largest distance in rows or columns that the first window and its neighbours cover well, px.
const NEAR: isize = 3;
/// Smallest peak of the autocovariance that makes a far place, as a share of the value next to lag 0.
const LEAST_PEAK: f64 = 0.02;
/// Largest surprise, standard deviations.
const MOST_SURPRISE: f32 = 8.0;
/// Smallest variance of the prediction, as a share of that of the noise.
const LEAST_VARIANCE: f32 = 0.05;

/// Second moments of the measurements, noise included.
#[derive(Clone, Debug)]
pub struct Moments {
    /// Mean, photons per pixel.
    pub mean: f64,
    /// Autocovariance, photons squared, shape (2 rows - 1, 2 cols - 1) for the patch, lag 0 in the centre.
    pub autocovariance: Array2<f64>,
}

impl Moments {
    /// Of noisy patches, averaged over patches and places ([`StationaryGaussian::fit`]).
    ///
    /// # Errors
    /// As [`StationaryGaussian::fit`].
    pub fn of_patches(noisy: ArrayView3<'_, f32>) -> Result<Self, InformationError> {
        let model = StationaryGaussian::fit(noisy)?;
        Ok(Self { mean: model.mean(), autocovariance: model.autocovariance().to_owned() })
    }
}

/// Units of the measurements as network inputs: (mean, inverse standard deviation).
#[derive(Clone, Copy, Debug)]
pub(super) struct Units {
    /// Of the square roots of photons.
    pub roots: (f32, f32),
    /// Of photons.
    pub photons: (f32, f32),
}

/// Statistics of one design and kind of scene that condition the network.
#[derive(Clone, Debug)]
pub(super) struct Conditioning {
    pub noise: Noise,
    pub patch: (usize, usize),
    pub levels: Levels,
    /// The darkest and the brightest grid level used by measurements so far.
    pub used: (usize, usize),
    scale: Scale,
    /// Mean and inverse deviation on the square-root scale, and of photons.
    roots: (f32, f32),
    photons: (f32, f32),
    predictor: Predictor,
    /// Closeness of each pixel to the borders, (pixels, [`BORDER_CHANNELS`]).
    border: Vec<f32>,
    /// Offsets (rows down, columns right) of far places that help to predict the present pixel, px; the same number
    /// for all designs.
    pub far: Vec<(isize, isize)>,
}

/// Patches as network inputs.
#[derive(Clone, Debug, Default)]
pub(super) struct Inputs {
    /// Photons, (pixels).
    pub values: Vec<f32>,
    /// Photons that could also have been measured, (pixels, targets): the losses are taken at them. Empty where they
    /// are taken at [`Inputs::values`].
    pub targets: Vec<f32>,
    /// (pixels, [`WINDOW_CHANNELS`]).
    pub window: Vec<f32>,
    /// (pixels, [`PRESENT_CHANNELS`]).
    pub present: Vec<f32>,
    /// Predicted mean, photons, and -1/2 over its variance, per pixel.
    pub guess: Vec<(f32, f32)>,
    /// The predicted mean before it was clamped to the levels, photons, per pixel.
    pub predicted: Vec<f32>,
}

/// The part of [`Inputs`] that belongs to one patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct PatchInputs<'a> {
    pub values: &'a [f32],
    /// Photons at which the losses are taken, (pixels, targets).
    pub targets: &'a [f32],
    pub window: &'a [f32],
    pub present: &'a [f32],
    pub guess: &'a [(f32, f32)],
    pub predicted: &'a [f32],
}

impl Inputs {
    /// Patch `index`, for patches of this number of pixels.
    pub fn patch(&self, index: usize, pixels: usize) -> PatchInputs<'_> {
        let of = |count: usize| -> Range<usize> { index * pixels * count..(index + 1) * pixels * count };
        let targets = self.targets.len() / self.values.len().max(1);
        PatchInputs {
            values: &self.values[of(1)],
            targets: if targets == 0 { &self.values[of(1)] } else { &self.targets[of(targets)] },
            window: &self.window[of(WINDOW_CHANNELS)],
            present: &self.present[of(PRESENT_CHANNELS)],
            guess: &self.guess[of(1)],
            predicted: &self.predicted[of(1)],
        }
    }
}

/// Gradients of a sum of losses by the inputs of one patch.
#[derive(Clone, Debug)]
pub(super) struct InputGradients {
    /// By the photons where these are predicted, (pixels).
    pub values: Vec<f64>,
    /// (pixels, [`WINDOW_CHANNELS`]).
    pub window: Vec<f32>,
    /// (pixels, [`PRESENT_CHANNELS`]).
    pub present: Vec<f32>,
    /// By the predicted mean and by -1/2 over its variance, per pixel.
    pub guess: Vec<(f64, f64)>,
}

impl InputGradients {
    /// Zeros.
    pub fn new(pixels: usize) -> Self {
        Self {
            values: vec![0.0; pixels],
            window: vec![0.0; pixels * WINDOW_CHANNELS],
            present: vec![0.0; pixels * PRESENT_CHANNELS],
            guess: vec![(0.0, 0.0); pixels],
        }
    }
}

impl Conditioning {
    /// From sample patches and the moments of many.
    pub fn new(noise: Noise, sample: &PatchBatch, moments: &Moments) -> Result<Self, InformationError> {
        let images = sample.clean.as_ref().unwrap_or(&sample.noisy);
        let counts = sample.noisy.iter().all(|y| *y >= 0.0 && y.fract() == 0.0);
        Self::with_levels(noise, sample, moments, Levels::new(noise, images.view(), counts))
    }

    /// As [`Conditioning::new`], with given levels.
    pub fn with_levels(
        noise: Noise,
        sample: &PatchBatch,
        moments: &Moments,
        levels: Levels,
    ) -> Result<Self, InformationError> {
        let (_, rows, cols) = sample.noisy.dim();
        let scale = Scale::new(noise);
        let standard = |value: &dyn Fn(f32) -> f64| {
            let count = sample.noisy.len() as f64;
            let mean = sample.noisy.iter().map(|&y| value(y)).sum::<f64>() / count;
            let square = sample.noisy.iter().map(|&y| (value(y) - mean).powi(2)).sum::<f64>() / count;
            (mean as f32, (1.0 / square.sqrt().max(1e-6)) as f32)
        };
        let images = sample.clean.as_ref().unwrap_or(&sample.noisy);
        Ok(Self {
            noise,
            patch: (rows, cols),
            used: levels.used_by(images.view()),
            levels,
            scale,
            roots: standard(&|y| scale.of(f64::from(y))),
            photons: standard(&|y| f64::from(y)),
            far: far_places(&moments.autocovariance),
            predictor: Predictor::new(moments.mean, &moments.autocovariance, (rows, cols))?,
            border: border((rows, cols)),
        })
    }

    /// This conditioning with the units that `start` gave to the inputs and, where they fit, its `levels`. Weights
    /// fitted to those keep their meaning. The noise is the same.
    pub fn in_units_of(mut self, units: Units, far: &[(isize, isize)], levels: &Levels) -> Self {
        self.roots = units.roots;
        self.photons = units.photons;
        self.far = in_order_of(far, self.far);
        if levels.serve(&self.levels) {
            self.levels = levels.clone();
        }
        self
    }

    /// Units of the inputs.
    pub fn units(&self) -> Units {
        Units { roots: self.roots, photons: self.photons }
    }

    /// This conditioning with its far places in the order of the closest ones of `before`. Those of before remain
    /// where no new place replaces them: a place that is no longer a peak may still carry information.
    pub fn keeping_places_of(mut self, before: &[(isize, isize)]) -> Self {
        self.far = in_order_of(before, self.far);
        for (place, &before) in self.far.iter_mut().zip(before).filter(|(place, _)| **place == NOWHERE) {
            *place = before;
        }
        self
    }

    /// Patches (photons) as network inputs.
    pub fn inputs(&self, patches: ArrayView3<'_, f32>) -> Inputs {
        let values: Vec<f32> = patches.iter().copied().collect();
        let predictions = self.predictor.predict(&values);
        let pixels = self.patch.0 * self.patch.1;
        let (low, high) = self.levels.range();
        let mut window = vec![0.0; values.len() * WINDOW_CHANNELS];
        let mut present = vec![0.0; values.len() * PRESENT_CHANNELS];
        let mut guess = vec![(0.0, 0.0); values.len()];
        let out =
            window.par_chunks_mut(pixels * WINDOW_CHANNELS).zip(present.par_chunks_mut(pixels * PRESENT_CHANNELS));
        let given = values.par_chunks(pixels).zip(predictions.par_chunks(pixels));
        out.zip(guess.par_chunks_mut(pixels)).zip(given).for_each(
            |(((window, present), guess), (values, predicted))| {
                let numbers = window.chunks_exact_mut(WINDOW_CHANNELS).zip(present.chunks_exact_mut(PRESENT_CHANNELS));
                for (i, ((window, present), guess)) in numbers.zip(guess).enumerate() {
                    let (y, variance) = (values[i], self.predictor.variances[i]);
                    let surprise = (y - predicted[i]) / variance.sqrt();
                    window[0] = self.root(y);
                    window[1] = (y - self.photons.0) * self.photons.1;
                    window[2] = 1.0;
                    window[3] = 0.5 * surprise.clamp(-MOST_SURPRISE, MOST_SURPRISE);
                    let mean = predicted[i].clamp(low, high);
                    let noise = self.scale.variance(f64::from(mean)) as f32;
                    let signal = (variance - noise).max(LEAST_VARIANCE * noise);
                    *guess = (mean, -0.5 / signal);
                    present[0] = self.root(mean);
                    present[1] = (predicted[i] - self.photons.0) * self.photons.1;
                    present[2] = 0.5 * (signal / noise).ln();
                    present[3..].copy_from_slice(&self.border[i * BORDER_CHANNELS..][..BORDER_CHANNELS]);
                }
            },
        );
        Inputs { values, targets: Vec::new(), window, present, guess, predicted: predictions }
    }

    /// Possible measurements of `clean` patches (photons), drawn several times: (pixels, [`TARGETS`]).
    pub fn targets(&self, clean: ArrayView3<'_, f32>, seed: u64) -> Vec<f32> {
        let mut targets = vec![0.0; clean.len() * TARGETS];
        for target in 0..TARGETS {
            let noisy = self.noise.draw(clean, seed.wrapping_add(target as u64));
            for (out, &y) in targets.iter_mut().skip(target).step_by(TARGETS).zip(&noisy) {
                *out = y;
            }
        }
        targets
    }

    /// Gradients by the photons of one patch, without those through the prediction, and gradients by the predictions.
    /// They follow from the gradients by all outputs of [`Conditioning::inputs`];
    /// [`Conditioning::through_predictions`] completes them.
    pub fn by_values(&self, inputs: PatchInputs<'_>, by: InputGradients) -> (Vec<f64>, Vec<f32>) {
        let (low, high) = self.levels.range();
        let predicted = inputs.predicted;
        let mut by_predicted = vec![0.0_f32; predicted.len()];
        let mut by_values = by.values;
        for (i, &y) in inputs.values.iter().enumerate() {
            let window = &by.window[i * WINDOW_CHANNELS..][..WINDOW_CHANNELS];
            let present = &by.present[i * PRESENT_CHANNELS..][..PRESENT_CHANNELS];
            let variance = self.predictor.variances[i];
            by_values[i] += f64::from(window[0]) * self.root_slope(y) + f64::from(window[1] * self.photons.1);
            let mut by_mean = 0.0;
            if predicted[i] > low && predicted[i] < high {
                let noise = self.scale.variance(f64::from(predicted[i]));
                let noise_slope = self.scale.variance_slope(f64::from(predicted[i]));
                let free = f64::from(variance) - noise;
                let least = f64::from(LEAST_VARIANCE) * noise;
                let (signal, signal_slope) =
                    if free > least { (free, -noise_slope) } else { (least, f64::from(LEAST_VARIANCE) * noise_slope) };
                by_mean += by.guess[i].0
                    + by.guess[i].1 * 0.5 * signal_slope / (signal * signal)
                    + f64::from(present[0]) * self.root_slope(predicted[i])
                    + f64::from(present[2]) * 0.5 * (signal_slope / signal - noise_slope / noise);
            }
            by_mean += f64::from(present[1] * self.photons.1);
            let surprise = (y - predicted[i]) / variance.sqrt();
            if surprise.abs() < MOST_SURPRISE {
                let slope = f64::from(0.5 * window[3] / variance.sqrt());
                by_values[i] += slope;
                by_mean -= slope;
            }
            by_predicted[i] = by_mean as f32;
        }
        (by_values, by_predicted)
    }

    /// Part of the gradient by the photons of patches that comes through their predictions, from the gradient by the
    /// predictions, shape (samples, pixels).
    pub fn through_predictions(&self, by_predicted: &[f32]) -> Vec<f32> {
        self.predictor.transposed(by_predicted)
    }

    fn root_slope(&self, photons: f32) -> f64 {
        self.scale.slope(f64::from(photons)) * f64::from(self.roots.1)
    }

    /// The levels on the square-root scale, in units of the inputs.
    pub fn roots_of(&self, levels: &Levels) -> impl Iterator<Item = f32> {
        levels.photons.iter().map(|&photons| self.root(photons))
    }

    fn root(&self, photons: f32) -> f32 {
        (self.scale.of(f64::from(photons)) as f32 - self.roots.0) * self.roots.1
    }
}

/// Closeness of the pixels of a patch of (rows, cols) to its upper, left and right border, on scales of 2 px and 8
/// px: (pixels, [`BORDER_CHANNELS`]).
fn border((rows, cols): (usize, usize)) -> Vec<f32> {
    let near = |distance: usize, reach: f32| (-(distance as f32) / reach).exp();
    let of = |i: usize| {
        let (row, col) = (i / cols, i % cols);
        [2.0, 8.0].into_iter().flat_map(move |reach| [row, col, cols - 1 - col].map(|distance| near(distance, reach)))
    };
    (0..rows * cols).flat_map(of).collect()
}

/// Places at the largest peaks of the autocovariance before the present pixel and beyond the reach of the first
/// window. Lenslets make copies of the present pixel's object point there.
///
/// A place is moved one row down and one column right where that is still in the past, since the features there
/// include more of the copy. If there are fewer peaks than [`FAR_PLACES`], the remaining places lie outside every
/// patch.
fn far_places(autocovariance: &Array2<f64>) -> Vec<(isize, isize)> {
    let (rows, cols) = autocovariance.dim();
    let (centre_row, centre_col) = (rows as isize / 2, cols as isize / 2);
    let at = |down: isize, right: isize| {
        let (row, col) = (centre_row + down, centre_col + right);
        let inside = (0..rows as isize).contains(&row) && (0..cols as isize).contains(&col);
        if inside { autocovariance[[row as usize, col as usize]] } else { f64::NEG_INFINITY }
    };
    let near = at(0, -1).max(at(-1, 0));
    let mut peaks = Vec::new();
    for down in -centre_row..=0 {
        let last = if down == 0 { -1 } else { centre_col };
        for right in -centre_col..=last {
            let value = at(down, right);
            let beyond = down < -NEAR || right.abs() > NEAR;
            let peak = (-1..=1).all(|r| (-1..=1).all(|c| (r, c) == (0, 0) || value > at(down + r, right + c)));
            if beyond && peak && value > LEAST_PEAK * near {
                // Pairs of pixels at this lag in the patch: distant copies are seldom of use.
                let pairs = (centre_row + 1 + down) * (centre_col + 1 - right.abs());
                peaks.push((value * pairs as f64, down, right));
            }
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    let past = |&(_, down, right): &(f64, isize, isize)| if down < -1 { (down + 1, right + 1) } else { (down, right) };
    let mut places: Vec<(isize, isize)> = peaks.iter().take(FAR_PLACES).map(past).collect();
    places.resize(FAR_PLACES, NOWHERE);
    places
}

/// The places in the order of those of a similar design, so that each weight keeps its place.
fn in_order_of(before: &[(isize, isize)], now: Vec<(isize, isize)>) -> Vec<(isize, isize)> {
    let mut left = now;
    let mut ordered = vec![None; before.len()];
    let mut pairs: Vec<(isize, usize, (isize, isize))> = Vec::new();
    for (index, from) in before.iter().enumerate() {
        pairs.extend(left.iter().map(|to| ((from.0 - to.0).pow(2) + (from.1 - to.1).pow(2), index, *to)));
    }
    pairs.sort_unstable();
    for (_, index, to) in pairs {
        if ordered[index].is_none()
            && let Some(position) = left.iter().position(|place| *place == to)
        {
            ordered[index] = Some(left.swap_remove(position));
        }
    }
    ordered.into_iter().map(|place| place.unwrap_or(NOWHERE)).collect()
}
