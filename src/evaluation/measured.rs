//! Estimates from the measurements of a camera: without a design and without clean images.

use std::borrow::Cow;
use std::path::PathBuf;

use ndarray::{Array3, ArrayView3, Axis};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::evaluation::calibration::Calibration;
use crate::evaluation::checkpoint::{EstimateCheckpoint, Identity};
use crate::evaluation::equal_light::EqualLight;
use crate::evaluation::estimation::{TrialContext, network_trial};
use crate::evaluation::level_limit::LevelLimit;
use crate::evaluation::measured_checks::{
    BELOW_ZERO_SATURATED, GreyNotes, below_zero, few_images_note, few_photons_note, neighbour_note,
};
use crate::evaluation::measured_error::MeasuredError;
use crate::evaluation::measured_source::MeasuredSource;
use crate::evaluation::patch_source::LARGEST_PATCHES_BYTES;
use crate::evaluation::pixel_calibration::Origins;
use crate::evaluation::progress::{EstimateProgress, converting, in_trial, report_step};
use crate::evaluation::request::{DensityModel, EstimateRequest};
use crate::information::{
    CausalRequest, Covariance, Estimate, GaussianRequest, InformationError, NoiseEntropy, PatchBatch, PatchStream,
    PixelCnnRequest, Protocol, Provenance, SharedImages, TestPatches, Trial, causal_estimate, gaussian_estimate,
};
use crate::plural::counted;
use crate::progress::Progress;
use crate::seeds::SeedStream;
use crate::sensor::{Noise, Patches, SensorError};

/// One image in this many is held out for the test patches.
const TEST_SHARE: usize = 5;
/// One training image in this many is held out for early stopping of the causal model, and the number of validation patches.
const VALIDATION_SHARE: usize = 8;
const VALIDATION_PATCHES: usize = 128;

/// The images of an estimate, and the calibration of their grey values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredOrder {
    /// Location of the images.
    pub source: MeasuredSource,
    /// Calibration of the images.
    pub calibration: Calibration,
}

impl MeasuredOrder {
    /// The same order by an absolute path.
    pub(crate) fn absolute(&self) -> Self {
        Self { source: self.source.absolute(), calibration: self.calibration }
    }

    /// Reads the images and estimates their information, as [`MeasuredImages::open`] and [`MeasuredImages::estimate`].
    ///
    /// # Errors
    /// As these.
    pub fn estimate(
        &self,
        request: &EstimateRequest,
        noise: Noise,
        seed: u64,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<Estimate, MeasuredError> {
        MeasuredImages::open(&self.source, &self.calibration, progress)?.estimate(request, noise, seed, progress)
    }
}

/// Images of a camera in photons.
///
/// ```no_run
/// use lenslet_studio::prelude::*;
///
/// let calibration = Calibration { gain: 2.0, offset: 64.0, bin: 1 };
/// let mut progress = CancelToken::new();
/// let images = MeasuredImages::open(&"stack:captures.npy".parse()?, &calibration, &mut progress)?;
/// let request = EstimateRequest::new(Estimator::GaussianStationary);
/// println!("{}", images.estimate(&request, Noise::Shot, 1, &mut progress)?.summary());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct MeasuredImages {
    /// Photons per (binned) pixel, shape (n, rows, cols).
    pub(crate) photons: Array3<f32>,
    pub(crate) path: PathBuf,
    /// What the grey values can carry; none where they are not whole.
    pub(crate) limit: Option<LevelLimit>,
    /// Gain, offset and bins.
    pub(crate) calibration: Calibration,
    pub(crate) origins: Origins,
    pub(crate) grey_notes: GreyNotes,
    pub(crate) notes: Vec<String>,
    pub(crate) understood: String,
}

/// Noise, light and seed of an estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredConditions {
    /// Noise of the photons.
    pub noise: Noise,
    /// Equal light; `None` takes the images as they are.
    pub light: Option<EqualLight>,
    /// Seed of all random draws.
    pub seed: u64,
}

/// What all splits of an estimate share.
pub(crate) struct Prepared<'a> {
    conditions: MeasuredConditions,
    /// Noise of the density model.
    noise: Noise,
    /// Rows and columns of a patch.
    patch: (usize, usize),
    stacks: Stacks<'a>,
    fingerprint: String,
    notes: Vec<String>,
}

/// The estimate of one split, with the information of each test patch and the image that it shows.
pub(crate) struct FoldResult {
    pub(crate) estimate: Estimate,
    pub(crate) information: Vec<f64>,
    pub(crate) images: Vec<u32>,
}

/// Noisy images, and clean ones where they are known, shape (n, rows, cols).
struct Stacks<'a> {
    noisy: Cow<'a, Array3<f32>>,
    clean: Option<Array3<f32>>,
}

/// Patches of images.
struct CutPatches {
    noisy: Array3<f32>,
    clean: Option<Array3<f32>>,
    shown: SharedImages,
}

/// Images for test and training.
struct ImageParts<'a> {
    test: &'a [usize],
    /// Seed of the test patches.
    test_seed: u64,
    train: &'a [usize],
}

impl MeasuredImages {
    /// Photons per (binned) pixel, shape (n, rows, cols).
    pub fn photons(&self) -> ArrayView3<'_, f32> {
        self.photons.view()
    }

    /// Mean of all pixels, photons per (binned) pixel.
    pub fn mean(&self) -> f64 {
        self.photons.iter().map(|&value| f64::from(value)).sum::<f64>() / self.photons.len().max(1) as f64
    }

    /// What was understood of the files, as the estimate notes it.
    pub fn understood(&self) -> &str {
        &self.understood
    }

    /// BLAKE3 sum of shape and pixels, in hexadecimal.
    fn fingerprint(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format!("lenslet studio measurements 1 {:?}", self.photons.dim()).as_bytes());
        for value in &self.photons {
            hasher.update(&value.to_le_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Estimates the information of the images. The noisy measurements stand in for the clean ones in the noise entropy, which is fair
    /// above about 10 photons per pixel.
    ///
    /// Patches are cut at random places, several from each image. Test patches come from images without training patches, the same ones
    /// in every trial. Trial t uses the seed + t.
    ///
    /// # Errors
    /// [`MeasuredError`] for a patch that is larger than the images, a model that is not fitted, or what the estimator
    /// refuses.
    pub fn estimate(
        &self,
        request: &EstimateRequest,
        noise: Noise,
        seed: u64,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<Estimate, MeasuredError> {
        Ok(self.estimate_patches(request, MeasuredConditions { noise, light: None, seed }, progress)?.0)
    }

    /// As [`MeasuredImages::estimate`], at equal light where it is given, with the information of each test patch.
    ///
    /// Images of two systems with as many images of one shape have the same patches at equal seeds.
    ///
    /// # Errors
    /// As [`MeasuredImages::estimate`].
    pub fn estimate_patches(
        &self,
        request: &EstimateRequest,
        conditions: MeasuredConditions,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<(Estimate, TestPatches), MeasuredError> {
        let prepared = self.prepare(request, conditions)?;
        let FoldResult { mut estimate, information, images } = self.estimate_fold(request, &prepared, 0, progress)?;
        estimate.notes.push(self.describe_split());
        Ok((estimate, TestPatches { information, images: SharedImages::one_each(images) }))
    }

    /// Checks the request, and draws noise and finds notes for all splits.
    pub(crate) fn prepare(
        &self,
        request: &EstimateRequest,
        conditions: MeasuredConditions,
    ) -> Result<Prepared<'_>, MeasuredError> {
        let MeasuredConditions { noise: stated, light, seed } = conditions;
        let mut notes = self.notes.clone();
        // Whole grey values limit the information, but not that of fresh noise.
        let steps = self.limit.filter(|_| light.is_none());
        notes.extend(steps.and_then(|steps| steps.warn_of_steps(stated)));
        let noise = match steps {
            Some(steps) if request.protocol == Protocol::Default => steps.bounding(stated),
            _ => stated,
        };
        NoiseEntropy::new(noise, request.protocol)?;
        let (images, rows, cols) = self.photons.dim();
        let patch = request.patch.unwrap_or((rows, cols));
        // A patch that fits no image is refused before anything is cut.
        Patches::draw((images, rows, cols), patch, 0, seed)?;
        request.model.check_patch(patch)?;
        let stacks = self.stacks(light, noise, seed);
        notes.extend(light.map(EqualLight::describe));
        if light.is_none() {
            notes.extend(few_photons_note(self.photons.view(), noise, request.protocol, request.model.estimator()));
        }
        notes.extend(few_images_note(images));
        Ok(Prepared { conditions, noise, patch, stacks, fingerprint: self.fingerprint(), notes })
    }

    /// The estimate of split number `fold`, from 0, into test and training images.
    pub(crate) fn estimate_fold(
        &self,
        request: &EstimateRequest,
        prepared: &Prepared<'_>,
        fold: usize,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<FoldResult, MeasuredError> {
        let start = std::time::Instant::now();
        let &Prepared { conditions, noise, patch, ref stacks, ref fingerprint, ref notes } = prepared;
        let MeasuredConditions { noise: stated, light, seed } = conditions;
        let (images, rows, cols) = self.photons.dim();
        let test_images = self.test_images();
        // All trials share the test patches: the smallest of estimates on different scenes would be that of the dullest scene.
        let test_seed = SeedStream::TestPatches.derive(seed);
        let mut order: Vec<usize> = (0..images).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(SeedStream::MeasuredOrder.derive(seed)));
        order.rotate_left(fold * test_images % images);
        let (test, train) = order.split_at(test_images);
        let parts = ImageParts { test, test_seed, train };
        let mut kept = EstimateCheckpoint::open(request.keep.as_deref(), || {
            let mut content = json!({
                "measurements": fingerprint,
                "noise": noise.to_string(),
                "seed": seed,
                "request": request.identity(),
            });
            if let Some(EqualLight { mean_photons, background_photons }) = light {
                content["equal_light"] = json!([mean_photons, background_photons]);
            }
            let earlier = if light.is_some() { Vec::new() } else { request.earlier_identities() };
            let earlier = earlier.into_iter().map(|text| format!("{:#?}", (fingerprint, noise, seed, text))).collect();
            Identity { content, earlier }
        })?;
        let (mut trials, repetitions, mut seconds) = (Vec::new(), request.repetitions(), 0.0);
        for index in 0..repetitions {
            let (seed, smallest) = (seed.wrapping_add(index as u64), kept.smallest());
            trials.push(kept.trial(index, |keeper| {
                in_trial(index, repetitions, &mut seconds, progress, |progress| {
                    let context = TrialContext { seed, keeper, smallest };
                    trial(request, noise, patch, (stacks, &parts), &context, progress)
                })
            })?);
        }
        let scenes =
            format!("the scenes of {} ({} of {rows} x {cols} px)", self.path.display(), counted(images, "image"));
        let provenance = Provenance {
            bias: light.map_or(0.0, |light| light.background_photons),
            objects: scenes,
            objects_fingerprint: fingerprint.clone(),
            encoder: "unknown mask".into(),
            throughput: None,
            ceiling: None,
            notes: notes.clone(),
        };
        let mut estimate = Estimate::new(&trials, provenance)?;
        if light.is_none() {
            self.check(&mut estimate, stated);
        }
        estimate.notes.splice(0..0, self.grey_notes.grave());
        estimate.noise = stated;
        estimate.seconds = start.elapsed().as_secs_f64().max(kept.seconds());
        let smallest = trials.iter().min_by(|one, other| one.bits_per_pixel().total_cmp(&other.bits_per_pixel()));
        let information = smallest.map(|trial| trial.information().to_vec()).unwrap_or_default();
        let places = Patches::draw((test_images, rows, cols), patch, information.len(), test_seed)?;
        let images = places.corners().iter().map(|&(image, ..)| test[image] as u32).collect();
        Ok(FoldResult { estimate, information, images })
    }

    /// A note on the numbers of test and training images.
    pub(crate) fn describe_split(&self) -> String {
        let (images, test) = (self.photons.len_of(Axis(0)), self.test_images());
        format!(
            "test patches were cut from {}, training patches from {}",
            counted(test, "image"),
            counted(images - test, "other image")
        )
    }

    /// Number of images that are held out.
    pub(crate) fn test_images(&self) -> usize {
        self.photons.len_of(Axis(0)).div_ceil(TEST_SHARE)
    }

    /// Names estimates that cannot be: below zero by more than their interval, or above what the grey values carry.
    fn check(&self, estimate: &mut Estimate, noise: Noise) {
        // Intervals of few images are too narrow, so one that ends just below zero proves nothing.
        let [low, high] = estimate.interval_95;
        if high + (high - low) / 2.0 < 0.0 {
            estimate.notes.retain(|note| !note.contains("the estimate is negative"));
            let note = if self.grey_notes.saturated.is_some() {
                BELOW_ZERO_SATURATED.into()
            } else {
                below_zero(self.photons.view(), self.calibration, self.origins, noise)
            };
            estimate.notes.insert(0, note);
            return;
        }
        estimate.notes.extend(neighbour_note(self.photons.view(), noise));
        if let Some(LevelLimit { bits, step }) = self.limit.filter(|limit| estimate.bits_per_pixel > limit.bits) {
            let note = format!(
                "error: the model gives {:.2} bits per pixel, but the grey values carry {bits:.2} at most, which the result is set to: \
                 the noise {noise} is finer than a grey level of {step:.3} photons; check the noise and the gain",
                estimate.bits_per_pixel
            );
            estimate.notes.insert(0, note);
            estimate.bits_per_patch *= bits / estimate.bits_per_pixel;
            estimate.bits_per_pixel = bits;
            estimate.interval_95 = estimate.interval_95.map(|end| end.min(bits));
        }
    }

    /// The images as they are, or at equal light with fresh noise.
    fn stacks(&self, light: Option<EqualLight>, noise: Noise, seed: u64) -> Stacks<'_> {
        let Some(light) = light else {
            return Stacks { noisy: Cow::Borrowed(&self.photons), clean: None };
        };
        let clean = light.clean(self.photons.view());
        let noisy = noise.draw(clean.view(), SeedStream::EqualLight.derive(seed));
        Stacks { noisy: Cow::Owned(noisy), clean: Some(clean) }
    }
}

fn trial(
    request: &EstimateRequest,
    noise: Noise,
    patch: (usize, usize),
    (stacks, &ImageParts { test, test_seed, train }): (&Stacks<'_>, &ImageParts<'_>),
    &TrialContext { seed, keeper, smallest }: &TrialContext<'_>,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Trial, MeasuredError> {
    let CutPatches { noisy: test, clean: test_clean, shown } =
        cut(stacks, test, patch, (request.patches_test, test_seed), "the test")?;
    if let DensityModel::Causal { length } = request.model {
        // Images are few, so long fits would overfit.
        let (validation, train) =
            train.split_at(if train.len() > 1 { train.len().div_ceil(VALIDATION_SHARE) } else { 0 });
        let part = |stack: &Array3<f32>| stack.select(Axis(0), train);
        let stream = MeasuredStream { noisy: part(&stacks.noisy), clean: stacks.clean.as_ref().map(part), patch };
        let validation = match validation {
            [] => None,
            images => {
                let seed = SeedStream::CausalFit.derive(seed);
                let CutPatches { noisy, clean, .. } =
                    cut(stacks, images, patch, (VALIDATION_PATCHES, seed), "the fit")?;
                Some(PatchBatch { noisy, clean })
            }
        };
        let fit = CausalRequest {
            stream: &stream,
            test: &PatchBatch { noisy: test, clean: test_clean },
            validation: validation.as_ref(),
            keeper,
            moments: None,
            noise,
            length,
            init: request.init(),
            estimator: crate::information::Estimator::Causal,
            seed,
        };
        let (trial, _) = causal_estimate(&fit, &mut converting(progress))?;
        return Ok(trial.with_clustered_interval(&shown));
    }
    let train = if request.weights.from.is_some() {
        None
    } else {
        let seed = SeedStream::TrainingPatches.derive(seed);
        Some(cut(stacks, train, patch, (request.patches_train, seed), "the fit")?)
    };
    report_step(progress, "Fitting", 0, 1)?;
    let (test, test_clean, protocol) = (test.view(), test_clean.as_ref().map(|clean| clean.view()), request.protocol);
    let train_clean = train.as_ref().and_then(|train| train.clean.as_ref()).map(|clean| clean.view());
    let train = train.as_ref().map_or(test, |train| train.noisy.view());
    let gaussian = |covariance| GaussianRequest { train, test, test_clean, covariance, noise, protocol, seed };
    Ok(match request.model {
        DensityModel::Stationary => gaussian_estimate(&gaussian(Covariance::Stationary))?,
        DensityModel::GaussianFull => gaussian_estimate(&gaussian(Covariance::Full))?,
        DensityModel::PixelCnn { budget, engine } => {
            let start = None;
            let network = PixelCnnRequest {
                train,
                train_clean,
                test,
                test_clean,
                noise,
                protocol,
                budget,
                start,
                keeper,
                engine,
                seed,
            };
            network_trial(&network, &request.weights, smallest, progress)?
        }
        DensityModel::Causal { .. } | DensityModel::Bracket { .. } | DensityModel::Analytic => {
            return Err(MeasuredError::NeedsObjects { estimator: request.model.estimator() });
        }
    }
    .with_clustered_interval(&shown))
}

/// Patches at random places of the given images, and which image each shows.
fn cut(
    stacks: &Stacks<'_>,
    images: &[usize],
    patch: (usize, usize),
    (count, seed): (usize, u64),
    model: &'static str,
) -> Result<CutPatches, MeasuredError> {
    let (rows, cols) = patch;
    let pixels = rows.saturating_mul(cols);
    if count == 0 {
        return Err(InformationError::TooFewPatches { model, needed: 1, found: 0, pixels }.into());
    }
    let most = LARGEST_PATCHES_BYTES / (size_of::<f32>() * pixels.max(1));
    if count > most {
        return Err(InformationError::TooManyPatches { count, rows, cols, most }.into());
    }
    let part = stacks.noisy.select(Axis(0), images);
    let places = Patches::draw(part.dim(), patch, count, seed)?;
    let clean = stacks.clean.as_ref().map(|clean| places.cut(clean.select(Axis(0), images).view()));
    Ok(CutPatches { noisy: places.cut(part.view()), clean, shown: shown(&places) })
}

/// Which image each patch shows.
fn shown(places: &Patches) -> SharedImages {
    SharedImages::one_each(places.corners().iter().map(|&(image, ..)| image as u32))
}

/// Patches at random places of images, as many as are requested.
struct MeasuredStream {
    noisy: Array3<f32>,
    clean: Option<Array3<f32>>,
    patch: (usize, usize),
}

impl PatchStream for MeasuredStream {
    fn draw(&self, count: usize, seed: u64) -> Result<PatchBatch, InformationError> {
        let failed = |error: SensorError| InformationError::Stream { reason: error.to_string() };
        let places = Patches::draw(self.noisy.dim(), self.patch, count, seed).map_err(failed)?;
        let clean = self.clean.as_ref().map(|clean| places.cut(clean.view()));
        Ok(PatchBatch { noisy: places.cut(self.noisy.view()), clean })
    }
}
