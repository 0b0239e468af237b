//! Estimates of a design's information from patches of simulated measurements.

use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use serde_json::json;

use crate::evaluation::bead_bound_schedule::{
    DENSITY_ABOVE, DENSITY_BETWEEN, bead_bounds, bead_channel, bound_above, scale_budget, with_pretrained_lower_bound,
};
use crate::evaluation::checkpoint::{EstimateCheckpoint, Identity};
use crate::evaluation::patch_source::{PatchRole, PatchSource};
use crate::evaluation::progress::{EstimateProgress, converting, in_trial, report_step};
use crate::evaluation::request::{DensityModel, EstimateRequest, WeightsFiles};
use crate::evaluation::scene::{EvaluationError, ceiling_of};
use crate::formats::json_of;
use crate::forward::{Design, ForwardModel, mean_measurement, notices_of, open_set_with};
use crate::information::{
    CausalRequest, Covariance, EngineChoice, Estimate, Estimator, FitCheckpoint, FitLength, GaussianRequest,
    InformationError, Moments, NoiseEntropy, PatchBatch, PixelCnn, PixelCnnRequest, Protocol, Provenance, TestPatches,
    Trial, TrialSettings, causal_estimate, gaussian_estimate, pixelcnn_estimate, pixelcnn_score,
};
use crate::objects::{ObjectSet, ReadProgress, Split};
use crate::progress::Progress;
use crate::seeds::SeedStream;
use crate::sensor::Patches;

/// Identity of an estimate of a design: all that decides its numbers.
pub(crate) fn identity(design: &Design, objects_fingerprint: &String, request: &EstimateRequest) -> Identity {
    // No number depends on the pitch.
    let design = &Design { pixel_pitch_um: None, ..design.clone() };
    let content = json!({
        "design": json_of(design),
        "objects": objects_fingerprint,
        "request": request.identity(),
    });
    let earlier = request.earlier_identities();
    let earlier = earlier.into_iter().map(|text| format!("{:#?}", (design, objects_fingerprint, text))).collect();
    Identity { content, earlier }
}

/// Note of analytic bounds where patches show some parts of tiles more often than others.
const PHASES: &str = "patches of this size see some parts of the tiles more often than others, so this is nearly a bound, and \
                      one only for whole tiles";
/// Note where upper bounds leave out the read noise.
const WEAK_READ_NOISE: &str = "read noise this weak does not hide that counts are whole: upper bounds are those of shot noise \
                               alone, which it can only lower";

/// Estimates the information of a design's measurements.
///
/// Every patch is cut from an object of its own. Where objects share base images, intervals are wider. Under the default protocol no base
/// image is in both training and test. Under the paper's protocol all are in both, and patches count as independent, as published.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let request = EstimateRequest::new(Estimator::GaussianStationary).with_patch(8, 8).with_patches(400, 100);
/// let result = estimate(&Design::default(), &request, &mut CancelToken::new())?;
/// assert!(result.interval_95[0] <= result.bits_per_pixel && result.bits_per_pixel <= result.interval_95[1]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`EvaluationError`] where objects, PSF, patch or noise do not allow an estimate.
pub fn estimate(
    design: &Design,
    request: &EstimateRequest,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Estimate, EvaluationError> {
    estimate_on_patches(design, request, progress).map(|(estimate, _)| estimate)
}

/// Refuses too few training patches for the Gaussian of a bracket, before the density model is fitted.
fn check_patches_of_bracket(
    request: &EstimateRequest,
    set: &ObjectSet,
    patch: (usize, usize),
) -> Result<(), InformationError> {
    let is_fitted = matches!(request.model, DensityModel::Bracket { .. }) && !set.is_stationary(patch);
    if !is_fitted || request.patches_train >= 2 {
        return Ok(());
    }
    let (model, needed, found) = ("the Gaussian of a bracket", 2, request.patches_train);
    Err(InformationError::TooFewPatches { model, needed, found, pixels: patch.0 * patch.1 })
}

/// The estimate, with the information of each test patch by the density model of the smallest trial. Under the default protocol all masks
/// of one grid have the same test patches. Differences between masks are then known better than either number.
///
/// # Errors
/// As [`estimate`].
pub(crate) fn estimate_on_patches(
    design: &Design,
    request: &EstimateRequest,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<(Estimate, TestPatches), EvaluationError> {
    let start = std::time::Instant::now();
    // Without noise, or without the engine, no estimate is possible. The error comes before the objects are read.
    NoiseEntropy::new(design.noise, request.protocol)?;
    if let DensityModel::PixelCnn { engine, .. } = request.model {
        engine.open()?;
    }
    if let Some(file) = &request.weights.from {
        PixelCnn::open_published(file)?;
    }
    let set = Arc::new(read(design, progress)?);
    let analytic_alone = matches!(request.model, DensityModel::Analytic);
    if analytic_alone && set.whole_images(Split::All).is_some() {
        return Err(EvaluationError::NotStationary { objects: design.objects.to_string() });
    }
    // Published densities took the noise as it is.
    let bounding = if request.protocol == Protocol::Paper { design.clone() } else { design.bounding() };
    let forward = ForwardModel::of_objects(&bounding, Arc::clone(&set))?;
    let convolver = forward.convolver(design.psf(set.planes())?.view())?;
    let (rows, cols) = convolver.plan().measurement_shape();
    let patch = request.patch.unwrap_or((rows, cols));
    // A patch that fits no measurement is refused before anything is drawn.
    Patches::draw((1, rows, cols), patch, 0, design.seed)?;
    request.model.check_patch(patch)?;
    let protocol = request.protocol;
    let source = PatchSource::new(&bounding, &forward, &convolver, patch, protocol);
    let (channel, refusal) = bead_channel(design, &forward, patch)?;
    // The error comes before any fit; a density model does not need the prior.
    if matches!(request.model, DensityModel::Bracket { .. })
        && let Some(refusal) = refusal
    {
        return Err(refusal.into());
    }
    let density_share = match (request.model, &channel) {
        (DensityModel::Causal { .. }, Some(_)) => DENSITY_ABOVE,
        (DensityModel::Bracket { .. }, Some(_)) => DENSITY_BETWEEN,
        _ => 1.0,
    };
    let repetitions = request.repetitions();
    check_patches_of_bracket(request, &set, patch)?;
    let mut kept = EstimateCheckpoint::open(request.keep.as_deref(), || identity(design, &set.fingerprint(), request))?;
    let mut trials = Vec::with_capacity(repetitions);
    let mut seconds = 0.0;
    for index in 0..repetitions {
        let seed = design.seed.wrapping_add(index as u64);
        let smallest = kept.smallest();
        trials.push(kept.trial(index, |keeper| {
            in_trial(index, repetitions, &mut seconds, progress, |progress| {
                trial(&source, request, density_share, &TrialContext { seed, keeper, smallest }, progress)
            })
        })?);
    }
    let mut notes = notices_of(design, &set)?;
    if analytic_alone && !set.is_stationary(patch) {
        // Fitted Gaussians see such patches as they are.
        notes.push(PHASES.to_owned());
    }
    if let Some(refusal) = &refusal
        && matches!(request.model, DensityModel::Causal { .. })
    {
        notes.push(format!("no bound by annealed importance sampling (AIS): {refusal}"));
    }
    if bounding.noise != design.noise {
        notes.push(WEAK_READ_NOISE.to_owned());
    }
    let psf = design.psf(set.planes())?;
    let ceiling = ceiling_of(design, &set, psf.view(), patch)?.map(|ceiling| ceiling.bits_per_pixel);
    let provenance = Provenance {
        bias: design.bias_photons,
        objects: design.objects.to_string(),
        objects_fingerprint: set.fingerprint(),
        encoder: design.encoder.describe(),
        throughput: design.encoder.throughput_unless_unit(),
        ceiling,
        notes,
    };
    let mut estimate = match (request.model, &channel) {
        (DensityModel::Bracket { length }, channel) => {
            let upper = if set.is_stationary(patch) {
                analytic(&source, request, design.seed, progress)?
            } else {
                let fitted = fitted(&source, request, Covariance::Stationary, design.seed, progress)?;
                source.with_clustered_interval(fitted, request.patches_test, design.seed)?
            };
            let bounds = |channel| bead_bounds(channel, design.seed, length, request.fresh, &mut kept, progress);
            let beads = channel.as_ref().map(bounds);
            Estimate::from_bracket(&trials, &upper, beads.transpose()?.as_ref(), provenance)?
        }
        (DensityModel::Causal { length, .. }, Some(channel)) => {
            match bound_above(channel, design.seed, length, &mut kept, progress)? {
                Some(above) => Estimate::from_upper_bounds(&trials, Some(&above), provenance)?,
                None => Estimate::new(&trials, provenance)?,
            }
        }
        (DensityModel::Causal { .. }, None) if refusal.is_some() => {
            Estimate::from_upper_bounds(&trials, None, provenance)?
        }
        _ => Estimate::new(&trials, provenance)?,
    };
    if let Some(channel) = &channel {
        estimate = with_pretrained_lower_bound(estimate, channel, request, design.seed, progress)?;
    }
    estimate.noise = design.noise;
    // The time that the person waited: reading, drawing and measuring objects, and the fit.
    estimate.seconds = start.elapsed().as_secs_f64().max(kept.seconds());
    Ok((estimate, test_patches(&source, &trials)?))
}

/// Information of each test patch of the smallest trial.
fn test_patches(source: &PatchSource<'_>, trials: &[Trial]) -> Result<TestPatches, EvaluationError> {
    let smallest = trials.iter().min_by(|one, other| one.bits_per_pixel().total_cmp(&other.bits_per_pixel()));
    let Some(smallest) = smallest else { return Ok(TestPatches::default()) };
    // An analytic bound holds for all images, of which its patches are a fair sample.
    let images = match smallest.settings().estimator {
        Estimator::GaussianAnalytic => None,
        _ => source.images(smallest.patches_test(), smallest.settings().seed)?,
    };
    let information = smallest.information().to_vec();
    Ok(TestPatches { information, images: images.map(Rc::unwrap_or_clone).unwrap_or_default() })
}

/// What a trial gets from its estimate.
#[derive(Clone, Copy)]
pub(crate) struct TrialContext<'a> {
    /// Seed of the trial.
    pub seed: u64,
    /// Checkpoint of its fit.
    pub keeper: Option<&'a dyn FitCheckpoint>,
    /// Smallest number of the earlier trials, bits per pixel.
    pub smallest: Option<f64>,
}

/// One trial. A density model beside bounds that use the prior gets a share of the time.
fn trial(
    source: &PatchSource<'_>,
    request: &EstimateRequest,
    density_share: f64,
    context: &TrialContext<'_>,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Trial, EvaluationError> {
    let causal = |estimator, length, progress: &mut (dyn Progress<EstimateProgress> + Send)| {
        causal(source, request, estimator, scale_budget(length, density_share), context, progress)
    };
    let seed = context.seed;
    let trial = match request.model {
        DensityModel::Stationary => fitted(source, request, Covariance::Stationary, seed, progress)?,
        DensityModel::GaussianFull => fitted(source, request, Covariance::Full, seed, progress)?,
        // It holds for all images, of which its patches are a fair sample.
        DensityModel::Analytic => return analytic(source, request, seed, progress),
        DensityModel::PixelCnn { budget, engine } => network(source, request, budget, engine, context, progress)?,
        DensityModel::Causal { length } => causal(Estimator::Causal, length, progress)?,
        DensityModel::Bracket { length } => causal(Estimator::Bracket, length, progress)?,
    };
    source.with_clustered_interval(trial, request.patches_test, seed)
}

/// The objects of a design.
pub(crate) fn read(
    design: &Design,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<ObjectSet, EvaluationError> {
    report_step(progress, "Reading objects", 0, 1)?;
    let reading = &mut |read: &ReadProgress| {
        let ReadProgress { done, total, understood } = read.clone();
        let step = "Reading objects".to_owned();
        progress.report(&EstimateProgress { step, done, total, fit: None, understood })
    };
    Ok(open_set_with(design, reading)?)
}

fn fitted(
    source: &PatchSource<'_>,
    request: &EstimateRequest,
    covariance: Covariance,
    seed: u64,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Trial, EvaluationError> {
    let (train, test) = source.splits();
    let (_, train) = source.draw(
        train,
        request.patches_train,
        SeedStream::TrainingPatches.derive(seed),
        PatchRole::Training,
        progress,
    )?;
    let (clean, test) = source.draw(test, request.patches_test, source.test_seed(seed), PatchRole::Test, progress)?;
    report_step(progress, "Fitting", 0, 1)?;
    Ok(gaussian_estimate(&GaussianRequest {
        train: train.view(),
        test: test.view(),
        test_clean: Some(clean.view()),
        covariance,
        noise: source.design.noise,
        protocol: request.protocol,
        seed,
    })?)
}

fn network(
    source: &PatchSource<'_>,
    request: &EstimateRequest,
    budget: Option<Duration>,
    engine: EngineChoice,
    &TrialContext { seed, keeper, smallest }: &TrialContext<'_>,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Trial, EvaluationError> {
    let (train, test) = source.splits();
    // Without a fit no training patches are drawn.
    let training = match request.weights.from {
        Some(_) => None,
        None => Some(source.draw(
            train,
            request.patches_train,
            SeedStream::TrainingPatches.derive(seed),
            PatchRole::Training,
            progress,
        )?),
    };
    let (test_clean, test) =
        source.draw(test, request.patches_test, source.test_seed(seed), PatchRole::Test, progress)?;
    let network = PixelCnnRequest {
        train: training.as_ref().map_or(test.view(), |(_, noisy)| noisy.view()),
        train_clean: training.as_ref().map(|(clean, _)| clean.view()),
        test: test.view(),
        test_clean: Some(test_clean.view()),
        noise: source.design.noise,
        protocol: request.protocol,
        budget,
        start: None,
        keeper,
        engine,
        seed,
    };
    Ok(network_trial(&network, &request.weights, smallest, progress)?)
}

/// The trial of a `PixelCNN` that is fitted, or of stored weights. The fitted weights are written where the trial is smaller than the
/// `smallest` one before. Where they cannot be written, the trial is still returned, with a note.
pub(crate) fn network_trial(
    request: &PixelCnnRequest<'_>,
    files: &WeightsFiles,
    smallest: Option<f64>,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Trial, InformationError> {
    if let Some(file) = &files.from {
        return pixelcnn_score(request, &PixelCnn::open_published(file)?, &mut converting(progress));
    }
    let (trial, fitted) = pixelcnn_estimate(request, &mut converting(progress))?;
    if let Some(file) = &files.to
        && smallest.is_none_or(|smallest| trial.bits_per_pixel() < smallest)
        && let Err(error) = fitted.save(file)
    {
        return Ok(trial.with_unwritten_weights(error));
    }
    Ok(trial)
}

fn causal(
    source: &PatchSource<'_>,
    request: &EstimateRequest,
    estimator: Estimator,
    length: FitLength,
    &TrialContext { seed, keeper, .. }: &TrialContext<'_>,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Trial, EvaluationError> {
    let (train, (_, test)) = (source.forward.set.fitting_parts().0, source.splits());
    let (stream, validation) =
        source.forward.fitting(source.convolver, source.patch, SeedStream::CausalFit.derive(seed))?;
    let (clean, noisy) = source.draw(test, request.patches_test, source.test_seed(seed), PatchRole::Test, progress)?;
    let (design, patch) = (source.design, source.patch);
    let fit = CausalRequest {
        stream: &stream,
        test: &PatchBatch { noisy, clean: Some(clean) },
        validation: validation.as_ref(),
        keeper,
        moments: Some(&moments(design, source.forward, train, patch)?),
        noise: design.noise,
        length,
        init: request.init(),
        estimator,
        seed,
    };
    let (trial, _) = causal_estimate(&fit, &mut converting(progress))?;
    Ok(trial)
}

/// Mean and autocovariance of the measurements, from those of the objects of a split and the PSF.
pub(crate) fn moments(
    design: &Design,
    forward: &ForwardModel,
    split: Split,
    patch: (usize, usize),
) -> Result<Moments, EvaluationError> {
    let known = forward.analytic_moments(split, design.encoder.grid(), patch)?;
    Ok(known.of(forward.psf(design)?.view())?)
}

fn analytic(
    source: &PatchSource<'_>,
    request: &EstimateRequest,
    seed: u64,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Trial, EvaluationError> {
    let start = std::time::Instant::now();
    let (design, patch) = (source.design, source.patch);
    // The covariance is that of all images, and so must be the noise: nothing is fitted.
    let (patches, test_seed) = (request.patches_test, source.test_seed(seed));
    let (clean, _) = source.draw(Split::All, patches, test_seed, PatchRole::Test, progress)?;
    report_step(progress, "Bounding", 0, 1)?;
    let per_patch = NoiseEntropy::new(design.noise, request.protocol)?.patch_bits(clean.view())?;
    let entropy_y_given_x = per_patch.iter().sum::<f64>() / per_patch.len().max(1) as f64;
    let known = source.forward.analytic_moments(Split::All, design.encoder.grid(), patch)?;
    let psf = source.forward.psf(design)?;
    let mean = mean_measurement(&source.forward.set, psf.view(), design.bias_photons);
    let bound = known.covariance.evaluate(psf.view(), mean, design.noise, entropy_y_given_x)?;
    let settings = TrialSettings {
        estimator: Estimator::GaussianAnalytic,
        protocol: request.protocol,
        noise: design.noise,
        patch,
        patches_train: 0,
        seed,
    };
    let entropy_y = vec![bound.entropy_y; per_patch.len()];
    Ok(Trial::from_patches(settings, &entropy_y, &per_patch, start.elapsed().as_secs_f64(), Vec::new())?)
}
