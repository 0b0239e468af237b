//! Information from an endless stream of patches by the causal density model.

use std::time::Instant;

use ndarray::Axis;

use super::trial::{Trial, TrialSettings};
use crate::information::density::causal::conditioning::Moments;
use crate::information::density::causal::fit::{CausalFit, FitContext, FitLength, FitStep, Fitted};
use crate::information::density::causal::init::Init;
use crate::information::density::causal::model::{CausalModel, check_causal_patch};
use crate::information::density::causal::pretrained::PretrainedWeights;
use crate::information::density::causal::score::{PatchScores, score_with_progress};
use crate::information::density::causal::shape::CausalShape;
use crate::information::density::causal::stream::{PatchBatch, PatchStream};
use crate::information::entropy::noise_entropy::{NoiseEntropy, Protocol};
use crate::information::error::InformationError;
use crate::information::estimator::Estimator;
use crate::information::fit_checkpoint::FitCheckpoint;
use crate::information::progress::FitProgress;
use crate::plural::counted;
use crate::progress::Progress;
use crate::sensor::Noise;

/// Patches from which levels and units are taken.
const SAMPLE: usize = 256;
/// Patches from which second moments are taken where they are not given.
const MOMENT_PATCHES: usize = 2048;

/// Request of a causal estimate.
#[derive(Clone, Copy)]
pub struct CausalRequest<'a> {
    /// Source of training patches.
    pub stream: &'a dyn PatchStream,
    /// Held-out patches of other scenes.
    pub test: &'a PatchBatch,
    /// Validation patches of other scenes, for sources with few images. The fit keeps the weights that score best on
    /// them.
    pub validation: Option<&'a PatchBatch>,
    /// Checkpoint of the fit.
    pub keeper: Option<&'a dyn FitCheckpoint>,
    /// Mean and autocovariance of the measurements where they are known; otherwise they are taken from patches.
    pub moments: Option<&'a Moments>,
    /// Noise of the measurements.
    pub noise: Noise,
    /// Length of the fit.
    pub length: FitLength,
    /// Initial weights.
    pub init: Init<'a>,
    /// Estimator of the trial.
    pub estimator: Estimator,
    /// Seed of initial weights, patches, noise and bootstraps.
    pub seed: u64,
}

/// A model for a source of patches before its fit: intensity grid, units, linear prediction and initial weights.
///
/// # Errors
/// Where the stream fails, or its patches allow no model (constant, too large, not finite).
pub fn causal_model(request: &CausalRequest<'_>) -> Result<CausalModel, InformationError> {
    let (_, rows, cols) = request.test.noisy.dim();
    check_causal_patch((rows, cols))?;
    let sample = request.stream.draw(SAMPLE, request.seed ^ 0x5eed)?;
    let own;
    let moments = if let Some(moments) = request.moments {
        moments
    } else {
        own = Moments::of_patches(request.stream.draw(MOMENT_PATCHES, request.seed ^ 0x5eee)?.noisy.view())?;
        &own
    };
    CausalModel::new(CausalShape::default(), request.noise, &sample, moments, request.init, request.seed)
}

/// Fits the causal density model to a stream and returns an upper bound on the information. The bound is its
/// cross-entropy on held-out patches, `I <= E[log2 p(y|x) - log2 q(y)]`, bits per pixel.
///
/// Both terms use the same measurements, so their common noise drops out of the difference. Without clean patches (an
/// experiment) the noisy ones replace the means in `H(Y|X)`.
///
/// # Errors
/// As [`causal_model`]; when `progress` cancels.
pub fn causal_estimate(
    request: &CausalRequest<'_>,
    progress: &mut dyn Progress<FitProgress>,
) -> Result<(Trial, CausalModel), InformationError> {
    let started = Instant::now();
    let mut model = causal_model(request)?;
    let fit = CausalFit::new(request.length, request.seed);
    let context = FitContext { stream: request.stream, validation: request.validation, keeper: request.keeper };
    let on_step = &mut |step: &FitStep<'_>| progress.report(&step.progress);
    let Fitted { steps, best, before } = fit.fit(&mut model, &context, on_step)?;
    let from = match request.init {
        Init::Pretrained if PretrainedWeights::shipped().is_some() => ", from the pretrained weights",
        Init::Warm(_) => ", warm-started from the model of a similar design",
        Init::Pretrained | Init::Random => "",
    };
    let mut notes = vec![format!("fitted in {} of {}{from}", counted(steps, "step"), counted(fit.batch, "new patch"))];
    if let Some(step) = best {
        notes.push(format!("the weights of step {step} score best on the validation patches and are used"));
    }
    if let Some(bits) = model.looseness_bits() {
        notes.push(format!(
            "the range of light is too wide for the model's intensity grid, so the number may be too high by about {bits:.2} bits \
             per pixel"
        ));
    }
    if request.test.clean.is_none() {
        notes.push("the noise entropy uses the noisy measurements in place of clean images".to_owned());
    }
    let PatchScores { information, entropy_y_given_x } = score_in_parts(&model, request, started, steps, progress)?;
    let settings = TrialSettings {
        estimator: request.estimator,
        protocol: Protocol::Default,
        noise: request.noise,
        patch: model.patch(),
        patches_train: steps * fit.batch,
        seed: request.seed,
    };
    let seconds = (before + started.elapsed()).as_secs_f64();
    // Both logarithms of a patch belong to the same measurement; their difference is the information.
    let cross_entropy: Vec<f64> = information.iter().zip(&entropy_y_given_x).map(|(i, h)| i + h).collect();
    let trial = Trial::from_patches(settings, &cross_entropy, &entropy_y_given_x, seconds, notes)?;
    Ok((trial, model))
}

/// As [`score`] of the held-out patches, with a report after each part.
fn score_in_parts(
    model: &CausalModel,
    request: &CausalRequest<'_>,
    started: Instant,
    step: usize,
    progress: &mut dyn Progress<FitProgress>,
) -> Result<PatchScores, InformationError> {
    let total = request.test.noisy.len_of(Axis(0));
    let entropy = NoiseEntropy::new(request.noise, Protocol::Default)?;
    score_with_progress(model, &entropy, request.test, &mut |scored: &usize| {
        progress.report(&FitProgress {
            epoch: 1,
            epochs: 1,
            step,
            validation_bits: None,
            best_bits: None,
            elapsed: started.elapsed(),
            remaining: None,
            scored: Some((*scored, total)),
        })
    })
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    /// A stream that must not be used.
    struct Untouched;

    impl PatchStream for Untouched {
        fn draw(&self, _: usize, _: u64) -> Result<PatchBatch, InformationError> {
            Err(InformationError::Stream { reason: "patches were drawn".to_owned() })
        }
    }

    #[test]
    fn too_large_patch_is_refused_before_drawing() {
        let asked = |side: usize| {
            let request = CausalRequest {
                stream: &Untouched,
                test: &PatchBatch { noisy: Array3::zeros((1, side, side)), clean: None },
                validation: None,
                keeper: None,
                moments: None,
                noise: Noise::Shot,
                length: FitLength::Steps(1),
                init: Init::Random,
                estimator: Estimator::Causal,
                seed: 1,
            };
            causal_model(&request).unwrap_err()
        };
        assert!(matches!(asked(8), InformationError::Stream { .. }));
        assert_eq!(asked(100), InformationError::PatchSize { rows: 100, cols: 100, limit: 8192 });
    }
}
