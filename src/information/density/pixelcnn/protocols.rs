//! Settings of the fit of a `PixelCNN`: the published procedure, and one that is more accurate in the same time.

use std::time::Duration;

use ndarray::ArrayView3;

use crate::information::density::pixelcnn::model::PixelCnn;
use crate::information::engine_choice::EngineChoice;
use crate::information::fit_checkpoint::FitCheckpoint;
use crate::nn::Averaging;
use crate::sensor::Noise;

/// Training patches, photons per pixel.
#[derive(Clone, Copy, Debug)]
pub struct TrainingPatches<'a> {
    /// Noisy patches, shape (n, rows, cols); the first of them are for validation.
    pub noisy: ArrayView3<'a, f32>,
    /// Clean patches, and the noise that is drawn for every batch.
    pub clean: Option<(ArrayView3<'a, f32>, Noise)>,
}

/// What a fit uses besides the shape of the network and its settings.
#[derive(Clone, Copy)]
pub struct PixelCnnContext<'a> {
    /// Training patches.
    pub patches: TrainingPatches<'a>,
    /// Network that the fit starts from; random weights where there is none, or one of another shape.
    pub start: Option<&'a PixelCnn>,
    /// Checkpoint from which the fit resumes.
    pub keeper: Option<&'a dyn FitCheckpoint>,
}

impl<'a> PixelCnnContext<'a> {
    /// Patches alone.
    pub fn new(patches: TrainingPatches<'a>) -> Self {
        Self { patches, start: None, keeper: None }
    }
}

/// Settings of the fit of a network.
// Each switch is one difference between the two protocols.
#[allow(clippy::struct_excessive_bools)]
#[derive(Clone, Debug, PartialEq)]
pub struct PixelCnnFit {
    /// Patches of one step.
    pub batch: usize,
    /// Steps of one epoch; validation follows each.
    pub steps_per_epoch: usize,
    /// Largest number of epochs.
    pub max_epochs: usize,
    /// Epochs without improvement after which the fit ends.
    pub patience: Option<usize>,
    /// Largest learning rate.
    pub rate: f64,
    /// Whether the rate rises at first and then falls linearly to the end; with a budget, to the end of the budget.
    pub schedule: bool,
    /// Whether Muon updates the hidden matrices, instead of Adam.
    pub muon: bool,
    /// Averaging of the weights.
    pub averaging: Averaging,
    /// Whether the initial mixture is spread over the data. Means and widths, which are in photons, then change by
    /// the deviation of the data times the rate.
    pub photon_scale: bool,
    /// Largest norm of a gradient; longer ones are shortened to it.
    pub max_norm: Option<f64>,
    /// Largest number of validation patches; a tenth of all patches where that is less.
    pub max_validation: usize,
    /// Whether a uniform number from 0 to 1 is added to every pixel of every batch (dequantisation).
    pub dequantise: bool,
    /// Time after which the fit ends, validation included.
    pub budget: Option<Duration>,
    /// Compute backend of losses and gradients.
    pub engine: EngineChoice,
    /// Seed of initial weights, order, noise and dequantisation.
    pub seed: u64,
}

/// Report of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct FitReport {
    /// Steps taken.
    pub steps: usize,
    /// Seconds taken, and cross-entropy of the validation patches in bits per pixel, after each epoch.
    pub epochs: Vec<(f64, f64)>,
    /// Epoch of the best weights, from 1.
    pub best_epoch: usize,
    /// Steps skipped because loss or gradient were not finite.
    pub refused: usize,
    /// Whether the budget ended the fit before its own rule did.
    pub cut_short: bool,
}

impl PixelCnnFit {
    /// The published procedure (Kabuli et al. 2026): Adam at 1e-3, batches of 64, 500 steps per epoch, at most 200
    /// epochs. It ends after 20 epochs without improvement and returns the best one. A tenth of the patches are for
    /// validation.
    pub fn paper(seed: u64) -> Self {
        Self {
            batch: 64,
            steps_per_epoch: 500,
            max_epochs: 200,
            patience: Some(20),
            rate: 1e-3,
            schedule: false,
            muon: false,
            averaging: Averaging::Off,
            photon_scale: false,
            max_norm: None,
            max_validation: usize::MAX,
            dequantise: true,
            budget: None,
            engine: EngineChoice::Cpu,
            seed,
        }
    }

    /// The default procedure: small batches, Muon with a rate that rises and falls, averaged weights. Where clean
    /// patches are given, every batch gets new noise.
    pub fn standard(seed: u64) -> Self {
        Self {
            batch: 4,
            steps_per_epoch: 600,
            max_epochs: 10,
            patience: None,
            rate: 5e-3,
            schedule: true,
            muon: true,
            averaging: Averaging::LAST_TENTH,
            photon_scale: true,
            max_norm: Some(1.0),
            max_validation: 64,
            dequantise: true,
            budget: None,
            engine: EngineChoice::Cpu,
            seed,
        }
    }
}
