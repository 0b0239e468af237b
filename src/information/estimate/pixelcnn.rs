//! Information from noisy patches by a fitted `PixelCNN`.

use std::time::{Duration, Instant};

use ndarray::{ArrayView3, Axis};

use super::trial::{Trial, TrialSettings};
use crate::information::density::patch_checks::check_clean;
use crate::information::density::pixelcnn::fit::SCORED_AT_ONCE;
use crate::information::density::pixelcnn::model::{PixelCnn, check};
use crate::information::density::pixelcnn::protocols::{FitReport, PixelCnnContext, PixelCnnFit, TrainingPatches};
use crate::information::density::pixelcnn::shape::PixelCnnShape;
use crate::information::engine_choice::EngineChoice;
use crate::information::entropy::noise_entropy::{NoiseEntropy, Protocol};
use crate::information::error::InformationError;
use crate::information::estimator::Estimator;
use crate::information::fit_checkpoint::FitCheckpoint;
use crate::information::progress::FitProgress;
use crate::information::statistics::dequantisation::{TEST_STREAM, dequantised, whole};
use crate::plural::{counted, one_or_many};
use crate::progress::Progress;
use crate::sensor::Noise;

/// Patches and settings of one `PixelCNN` trial.
#[derive(Clone, Copy)]
pub struct PixelCnnRequest<'a> {
    /// Noisy patches to fit, photons per pixel, shape (n, rows, cols).
    pub train: ArrayView3<'a, f32>,
    /// The training patches without noise, in the same order. With them the default protocol draws new noise for
    /// every batch; the paper protocol does not use them.
    pub train_clean: Option<ArrayView3<'a, f32>>,
    /// Noisy patches to score, photons per pixel, of scenes that the training patches do not show, shape (m, rows, cols).
    pub test: ArrayView3<'a, f32>,
    /// The test patches without noise, in the same order. Without them (an experiment) the noisy ones replace the
    /// means, negative values as 0; accurate above about 10 photons.
    pub test_clean: Option<ArrayView3<'a, f32>>,
    /// Noise of the measurements.
    pub noise: Noise,
    /// Protocol of the fit and of the entropies.
    pub protocol: Protocol,
    /// Time for the fit; scoring the test patches takes additional time.
    pub budget: Option<Duration>,
    /// Warm start: the network of a similar design.
    pub start: Option<&'a PixelCnn>,
    /// Checkpoint of the fit.
    pub keeper: Option<&'a dyn FitCheckpoint>,
    /// Compute backend.
    pub engine: EngineChoice,
    /// Seed of initial weights, order, noise, dequantisation and bootstraps.
    pub seed: u64,
}

/// Fits a `PixelCNN` to noisy patches and returns an upper bound on the information by its cross-entropy on held-out
/// patches.
///
/// The bound is `I <= -E log2 p(y) - H(Y|X)`, bits per pixel (Pinkard et al. 2024). The cross-entropy is measured,
/// never extrapolated, so a short fit gives a looser bound and not a wrong one. Whole counts get a uniform number
/// from 0 to 1, as in [`super::super::gaussian_estimate`]. Returns the trial and the network, which can start the
/// next fit.
///
/// # Errors
/// For patches of different shapes, fewer than a batch and its validation, constant, too bright or invalid ones; for
/// noise without a finite entropy; for an engine that this program or machine lacks; when `progress` cancels.
pub fn pixelcnn_estimate(
    request: &PixelCnnRequest<'_>,
    progress: &mut dyn Progress<FitProgress>,
) -> Result<(Trial, PixelCnn), InformationError> {
    let started = Instant::now();
    let PixelCnnRequest { train, train_clean, test, noise, protocol, budget, start, keeper, engine, seed, .. } =
        *request;
    check_test(train, test)?;
    let dequantise = request.dequantises();
    // Checks come before the fit.
    let (entropy_y_given_x, mut notes) = request.noise_entropies()?;
    let (fit, fresh, min_width) = match protocol {
        Protocol::Paper => (PixelCnnFit::paper(seed), None, 1.0),
        Protocol::Default => (PixelCnnFit::standard(seed), train_clean, narrowest(noise)),
    };
    let fit = PixelCnnFit { dequantise, budget, engine, ..fit };
    let patches = TrainingPatches { noisy: train, clean: fresh.map(|clean| (clean, noise)) };
    let (model, report) =
        fit.fit(PixelCnnShape::default(), min_width, &PixelCnnContext { patches, start, keeper }, progress)?;
    notes.extend(explained(&report, &fit, fresh.is_some()));

    let fitted = FittedNetwork { model: &model, patches_train: train.len_of(Axis(0)), report: &report, started };
    let trial = request.score(&fitted, &entropy_y_given_x, notes, progress)?;
    Ok((trial, model))
}

/// Upper bound on the information by the cross-entropy of a given network on held-out patches. The training patches
/// of the request are not used. A network fitted to other measurements gives a looser bound, not a wrong one.
///
/// # Errors
/// As [`pixelcnn_estimate`], except for those of a fit.
pub fn pixelcnn_score(
    request: &PixelCnnRequest<'_>,
    model: &PixelCnn,
    progress: &mut dyn Progress<FitProgress>,
) -> Result<Trial, InformationError> {
    let started = Instant::now();
    check_test(request.test, request.test)?;
    let (entropy_y_given_x, mut notes) = request.noise_entropies()?;
    notes.push("the network was scored without a fit".to_owned());
    let report = FitReport { steps: 0, epochs: Vec::new(), best_epoch: 0, refused: 0, cut_short: false };
    let fitted = FittedNetwork { model, patches_train: 0, report: &report, started };
    request.score(&fitted, &entropy_y_given_x, notes, progress)
}

/// A network and its fit.
struct FittedNetwork<'a> {
    model: &'a PixelCnn,
    /// Training patches; 0 without a fit.
    patches_train: usize,
    report: &'a FitReport,
    /// Start of the estimate.
    started: Instant,
}

impl PixelCnnRequest<'_> {
    /// Whether measurements get a uniform number from 0 to 1.
    fn dequantises(&self) -> bool {
        self.protocol == Protocol::Paper || self.noise == Noise::Shot
    }

    /// Entropy of the noise of each test patch, bits per pixel, and notes on the measurements.
    fn noise_entropies(&self) -> Result<(Vec<f64>, Vec<String>), InformationError> {
        let entropy = NoiseEntropy::new(self.noise, self.protocol)?;
        let mut notes = Vec::new();
        let entropies = if let Some(clean) = self.test_clean {
            check_clean(clean, self.test)?;
            entropy.patch_bits(clean)?
        } else {
            notes.push("the noise entropy uses the noisy measurements in place of clean images".to_owned());
            entropy.measured_patch_bits(self.test)?
        };
        if self.dequantises() && !(whole(self.train) && whole(self.test)) {
            notes.push("measurements that are not whole counts were dequantised".to_owned());
        }
        Ok((entropies, notes))
    }

    /// The trial of a network.
    fn score(
        &self,
        fitted: &FittedNetwork<'_>,
        entropy_y_given_x: &[f64],
        notes: Vec<String>,
        progress: &mut dyn Progress<FitProgress>,
    ) -> Result<Trial, InformationError> {
        let &Self { test, noise, protocol, engine, seed, .. } = self;
        let (_, rows, cols) = test.dim();
        let test = if self.dequantises() { dequantised(test, seed, TEST_STREAM) } else { test.to_owned() };
        let cross_entropy = scored(fitted, engine, test.view(), progress)?;
        let &FittedNetwork { patches_train, report, started, .. } = fitted;
        let estimator = Estimator::PixelCnn;
        let settings = TrialSettings { estimator, protocol, noise, patch: (rows, cols), patches_train, seed };
        // A resumed fit includes the time of earlier sessions.
        let fitted = report.epochs.last().map_or(0.0, |&(seconds, _)| seconds);
        let seconds = started.elapsed().as_secs_f64().max(fitted);
        Ok(Trial::from_patches(settings, &cross_entropy, entropy_y_given_x, seconds, notes)?.on_engine(engine))
    }
}

/// Smallest width of a Gaussian of the mixture. No noisy measurement is sharper than its read noise, and a whole
/// count plus a uniform number is never narrower than 1 photon.
fn narrowest(noise: Noise) -> f32 {
    noise.read_sigma().map_or(1.0, |sigma| (sigma as f32).clamp(1e-3, 1.0))
}

fn check_test(train: ArrayView3<'_, f32>, test: ArrayView3<'_, f32>) -> Result<(), InformationError> {
    let (_, rows, cols) = train.dim();
    let (found, found_rows, found_cols) = test.dim();
    if (found_rows, found_cols) != (rows, cols) {
        return Err(InformationError::PatchShape { what: "test patches", rows, cols, found_rows, found_cols });
    }
    if found == 0 {
        let (model, pixels) = ("a held-out test", rows * cols);
        return Err(InformationError::TooFewPatches { model, needed: 1, found, pixels });
    }
    check(test).map(|_| ())
}

/// Cross-entropy of each test patch, bits per pixel, with progress.
fn scored(
    &FittedNetwork { model, report, started, .. }: &FittedNetwork<'_>,
    engine: EngineChoice,
    test: ArrayView3<'_, f32>,
    progress: &mut dyn Progress<FitProgress>,
) -> Result<Vec<f64>, InformationError> {
    let total = test.len_of(Axis(0));
    let mut engine = engine.open()?;
    let best = report.best_epoch.checked_sub(1).and_then(|epoch| report.epochs.get(epoch)).map(|&(_, bits)| bits);
    let mut bits = Vec::with_capacity(total);
    for group in test.axis_chunks_iter(Axis(0), SCORED_AT_ONCE) {
        bits.extend(engine.cross_entropy_bits(model, group)?);
        let step = FitProgress {
            epoch: report.epochs.len(),
            epochs: report.epochs.len(),
            step: report.steps,
            validation_bits: report.epochs.last().map(|&(_, bits)| bits),
            best_bits: best,
            elapsed: started.elapsed(),
            remaining: None,
            scored: Some((bits.len(), total)),
        };
        if progress.report(&step).is_break() {
            return Err(InformationError::Cancelled);
        }
    }
    Ok(bits)
}

/// Notes about the fit for the reader.
fn explained(report: &FitReport, fit: &PixelCnnFit, fresh: bool) -> Vec<String> {
    let seconds = report.epochs.last().map_or(0.0, |&(seconds, _)| seconds);
    let noise = if fresh { ", new noise for each" } else { "" };
    let mut notes = vec![format!(
        "fitted in {} of {}{noise}; weights of epoch {} of {}, {seconds:.0} s",
        counted(report.steps, "step"),
        counted(fit.batch, "patch"),
        report.best_epoch,
        report.epochs.len()
    )];
    if report.cut_short {
        notes.push("the time budget ended the fit before convergence, so the bound is looser than it could be".into());
    }
    if report.refused > 0 {
        let (steps, were) = (counted(report.refused, "step"), one_or_many(report.refused, "was", "were"));
        notes.push(format!("{steps} with a loss that is not finite {were} skipped and the learning rate was lowered"));
    }
    notes
}
