//! Scores of held-out patches by a causal model, and maps of information per pixel.

use ndarray::{Array3, Axis, Zip};

use super::model::CausalModel;
use super::stream::PatchBatch;
use crate::information::entropy::likelihood::log_likelihood;
use crate::information::entropy::noise_entropy::NoiseEntropy;
use crate::information::error::InformationError;
use crate::progress::{CancelToken, Progress};

/// Held-out patches scored between two checks for cancellation.
const SCORED_AT_ONCE: usize = 32;

/// Scores of held-out patches, bits per pixel, one per patch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatchScores {
    /// Information.
    pub information: Vec<f64>,
    /// Entropy of the noise.
    pub entropy_y_given_x: Vec<f64>,
}

/// As [`score`], in parts; reports the number of scored patches after each.
///
/// # Errors
/// As [`score`], and [`InformationError::Cancelled`] where `progress` cancels.
pub fn score_with_progress(
    model: &CausalModel,
    entropy: &NoiseEntropy,
    test: &PatchBatch,
    progress: &mut dyn Progress<usize>,
) -> Result<PatchScores, InformationError> {
    let mut scores = PatchScores::default();
    for part in test.in_parts(SCORED_AT_ONCE) {
        let PatchScores { information, entropy_y_given_x } = score(model, entropy, &part)?;
        scores.information.extend(information);
        scores.entropy_y_given_x.extend(entropy_y_given_x);
        if progress.report(&scores.information.len()).is_break() {
            return Err(InformationError::Cancelled);
        }
    }
    Ok(scores)
}

/// Scores of every held-out patch. The information is `log2 p(y|x) - log2 q(y)` where clean
/// patches are known, otherwise `-log2 q(y) - H(Y|X)` with the noisy ones as means. `entropy` is that of the model's
/// noise.
///
/// # Errors
/// For patches of another shape or with invalid values.
pub fn score(model: &CausalModel, entropy: &NoiseEntropy, test: &PatchBatch) -> Result<PatchScores, InformationError> {
    let map = information_map(model, entropy, test)?;
    let information = map.outer_iter().map(|bits| bits.mean().unwrap_or(f64::NAN)).collect();
    let entropy_y_given_x = match &test.clean {
        Some(clean) => entropy.patch_bits(clean.view())?,
        None => entropy.patch_bits(test.noisy.mapv(|y| y.max(0.0)).view())?,
    };
    Ok(PatchScores { information, entropy_y_given_x })
}

/// Information that each pixel of held-out patches adds to the pixels before it, bits; shape of the patches. The mean over
/// patches is the information.
///
/// # Errors
/// As [`score`].
pub fn information_map(
    model: &CausalModel,
    entropy: &NoiseEntropy,
    test: &PatchBatch,
) -> Result<Array3<f64>, InformationError> {
    let noise = model.conditioning.noise;
    let mut map = model.cross_entropy_map(test.noisy.view())?;
    if let Some(clean) = &test.clean {
        Zip::from(&mut map).and(&test.noisy).and(clean).par_for_each(|bits, &y, &x| {
            *bits += log_likelihood(noise, f64::from(y), f64::from(x)) / std::f64::consts::LN_2;
        });
    } else {
        Zip::from(&mut map).and(&test.noisy).par_for_each(|bits, &y| *bits -= entropy.bits(f64::from(y.max(0.0))));
    }
    Ok(map)
}

/// As [`information_map`], in parts; the token is checked before each.
///
/// # Errors
/// As [`score_with_progress`].
pub fn cancellable_information_map(
    model: &CausalModel,
    entropy: &NoiseEntropy,
    test: &PatchBatch,
    cancel: &CancelToken,
) -> Result<Array3<f64>, InformationError> {
    let mut map = Array3::zeros(test.noisy.dim());
    for (mut map, part) in map.axis_chunks_iter_mut(Axis(0), SCORED_AT_ONCE).zip(test.in_parts(SCORED_AT_ONCE)) {
        if cancel.is_cancelled() {
            return Err(InformationError::Cancelled);
        }
        map.assign(&information_map(model, entropy, &part)?);
    }
    Ok(map)
}
