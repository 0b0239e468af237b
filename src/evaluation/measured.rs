//! Estimates from the measurements of a camera: without a design and without clean images.

use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use ndarray::{Array3, ArrayView3, Axis};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::evaluation::calibration::Calibration;
use crate::evaluation::checkpoint::{EstimateCheckpoint, Identity};
use crate::evaluation::estimation::{TrialContext, network_trial};
use crate::evaluation::measured_error::MeasuredError;
use crate::evaluation::patch_source::LARGEST_PATCHES_BYTES;
use crate::evaluation::progress::{EstimateProgress, converting, in_trial, report_step, report_understood};
use crate::evaluation::request::{DensityModel, EstimateRequest};
use crate::formats::{FormatError, ImageSummary, image_files, path_text};
use crate::information::{
    CausalRequest, Covariance, Estimate, GaussianRequest, InformationError, NoiseEntropy, PatchBatch, PatchStream,
    PixelCnnRequest, Protocol, Provenance, SharedImages, Trial, causal_estimate, gaussian_estimate,
};
use crate::objects::ObjectSource;
use crate::plural::counted;
use crate::progress::Progress;
use crate::seeds::SeedStream;
use crate::sensor::{Noise, Patches, SensorError};

/// One image in this many is held out for the test patches.
const TEST_SHARE: usize = 5;
/// One training image in this many is held out for early stopping of the causal model, and the number of validation patches.
const VALIDATION_SHARE: usize = 8;
const VALIDATION_PATCHES: usize = 128;

/// Location of measurements: a file or a folder, also written `stack:FILE` or `images:FOLDER`.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let source: MeasuredSource = "images:captures".parse()?;
/// assert_eq!(source, "captures".parse()?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct MeasuredSource(PathBuf);

impl FromStr for MeasuredSource {
    type Err = MeasuredError;

    fn from_str(text: &str) -> Result<Self, MeasuredError> {
        Self::from_os(OsStr::new(text))
    }
}

impl MeasuredSource {
    /// Parses the measurements of a text that need not be UTF-8, as paths need not be.
    ///
    /// # Errors
    /// [`MeasuredError::Source`] where it names none.
    pub fn from_os(text: &OsStr) -> Result<Self, MeasuredError> {
        let wrong = || MeasuredError::Source { text: text.to_string_lossy().into_owned() };
        match ObjectSource::from_os(text) {
            Ok(ObjectSource::Stack(path) | ObjectSource::Images(path)) => Ok(Self(path)),
            // A path with a colon that names no kind of objects.
            Err(_) if !text.as_encoded_bytes().trim_ascii().is_empty() => Ok(Self(text.into())),
            _ => Err(wrong()),
        }
    }
}

impl From<String> for MeasuredSource {
    fn from(path: String) -> Self {
        Self(path.into())
    }
}

impl From<MeasuredSource> for String {
    fn from(source: MeasuredSource) -> Self {
        path_text(&source.0)
    }
}

impl MeasuredSource {
    /// The files of the images.
    ///
    /// # Errors
    /// [`FormatError`] if a folder cannot be read.
    pub fn files(&self) -> Result<Vec<PathBuf>, FormatError> {
        Ok(image_files(&self.0)?.into_iter().map(|file| file.path).collect())
    }

    /// The same source by an absolute path.
    fn absolute(&self) -> Self {
        Self(std::path::absolute(&self.0).unwrap_or_else(|_| self.0.clone()))
    }
}

impl From<PathBuf> for MeasuredSource {
    fn from(path: PathBuf) -> Self {
        Self(path)
    }
}

impl fmt::Display for MeasuredSource {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&path_text(&self.0))
    }
}

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
    photons: Array3<f32>,
    path: PathBuf,
    /// Calibration of whole grey values; none where they are not whole.
    steps: Option<Calibration>,
    notes: Vec<String>,
}

/// Images for test and training.
struct ImageParts<'a> {
    test: &'a [usize],
    /// Seed of the test patches.
    test_seed: u64,
    train: &'a [usize],
}

impl MeasuredImages {
    /// Reads all images of a file, or of the files of a folder, and converts their grey values to photons.
    ///
    /// # Errors
    /// [`MeasuredError`] for files that cannot be read or are in colour, images of different shapes or depths, pixels that are not finite, a
    /// calibration without meaning, and fewer than two images.
    pub fn open(
        source: &MeasuredSource,
        calibration: &Calibration,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<Self, MeasuredError> {
        calibration.check()?;
        let path = &source.0;
        let files = image_files(path)?;
        let mut photons: Option<Array3<f32>> = None;
        let (mut whole_levels, mut white) = (true, None);
        let mut understood: Option<ImageSummary> = None;
        for (index, file) in files.iter().enumerate() {
            report_step(progress, "Reading measurements", index, files.len())?;
            let stack = file.read()?;
            let file = &file.path;
            let summary = ImageSummary::of(&stack);
            match &mut understood {
                None => understood = Some(summary),
                Some(understood) => understood.join(summary),
            }
            if stack.from_colour {
                return Err(MeasuredError::Colour { path: file.clone() });
            }
            // Grey values of 8 and 16 bits differ, and there is one gain for all.
            if let (Some(found), Some(expected)) = (stack.white, white)
                && found != expected
            {
                let depth = |white: u16| format!("{} bits", u16::BITS - white.leading_zeros());
                let expected = format!("grey levels of {}, as in the files before it", depth(expected));
                let advice = "estimate the files of each depth by themselves, with their own gain";
                return Err(FormatError::malformed(file, expected, depth(found), advice).into());
            }
            white = stack.white.or(white);
            let grey = stack.into_array();
            if grey.is_empty() {
                let found = format!("an array of shape {:?}", grey.dim());
                return Err(FormatError::malformed(file, "images with pixels", found, "choose another file").into());
            }
            check_finite(file, &grey)?;
            whole_levels &= grey.iter().all(|level| level.fract() == 0.0);
            let more = calibration.photons(grey.view())?;
            match &mut photons {
                None => photons = Some(more),
                Some(photons) => append(photons, &more, file, &grey)?,
            }
        }
        let photons = photons.unwrap_or_default();
        let found = photons.len_of(Axis(0));
        if found < 2 {
            return Err(MeasuredError::TooFewImages { path: path.clone(), found });
        }
        let mean = photons.iter().map(|&value| f64::from(value)).sum::<f64>() / photons.len() as f64;
        if !mean.is_finite() {
            let expected = "as many grey levels per photon as leave the photons a finite number";
            return Err(MeasuredError::Calibration { what: "gain", expected, found: calibration.gain });
        }
        if mean <= 0.0 {
            return Err(MeasuredError::Dark { found: mean });
        }
        let understood = understood.map(|understood| format!("{}: {understood}", path.display()));
        if let Some(understood) = &understood {
            report_understood(progress, understood)?;
        }
        let mut notes: Vec<String> = understood.into_iter().chain([calibration.describe()]).collect();
        let negative = photons.iter().filter(|value| **value < 0.0).count();
        if negative > 0 {
            let share = 100.0 * negative as f64 / photons.len() as f64;
            notes.push(format!("{share:.2} % of the pixels lie below the offset"));
        }
        Ok(Self { photons, path: path.clone(), steps: whole_levels.then_some(*calibration), notes })
    }

    /// Photons per (binned) pixel, shape (n, rows, cols).
    pub fn photons(&self) -> ArrayView3<'_, f32> {
        self.photons.view()
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
        let start = std::time::Instant::now();
        let mut notes = self.notes.clone();
        notes.extend(self.steps.and_then(|steps| steps.warn_of_steps(noise)));
        let stated = noise;
        let noise = match self.steps {
            Some(steps) if request.protocol == Protocol::Default => steps.bounding(noise),
            _ => noise,
        };
        NoiseEntropy::new(noise, request.protocol)?;
        let (images, rows, cols) = self.photons.dim();
        let patch = request.patch.unwrap_or((rows, cols));
        // A patch that fits no image is refused before anything is cut.
        Patches::draw((images, rows, cols), patch, 0, seed)?;
        request.model.check_patch(patch)?;
        let test_images = images.div_ceil(TEST_SHARE);
        // All trials share the test patches: the smallest of estimates on different scenes would be that of the dullest scene.
        let test_seed = SeedStream::TestPatches.derive(seed);
        let mut order: Vec<usize> = (0..images).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(SeedStream::MeasuredOrder.derive(seed)));
        let (test, train) = order.split_at(test_images);
        let parts = ImageParts { test, test_seed, train };
        let fingerprint = self.fingerprint();
        let mut kept = EstimateCheckpoint::open(request.keep.as_deref(), || {
            let content = json!({
                "measurements": fingerprint,
                "noise": noise.to_string(),
                "seed": seed,
                "request": request.identity(),
            });
            let earlier = request.earlier_identities();
            let earlier = earlier.into_iter().map(|text| format!("{:#?}", (&fingerprint, noise, seed, text))).collect();
            Identity { content, earlier }
        })?;
        let (mut trials, repetitions, mut seconds) = (Vec::new(), request.repetitions(), 0.0);
        for index in 0..repetitions {
            let (seed, smallest) = (seed.wrapping_add(index as u64), kept.smallest());
            trials.push(kept.trial(index, |keeper| {
                in_trial(index, repetitions, &mut seconds, progress, |progress| {
                    self.trial(request, noise, patch, &parts, &TrialContext { seed, keeper, smallest }, progress)
                })
            })?);
        }
        notes.push(format!(
            "test patches were cut from {}, training patches from {}",
            counted(test_images, "image"),
            counted(images - test_images, "other image")
        ));
        let provenance = Provenance {
            bias: 0.0,
            objects: format!(
                "the scenes of {} ({} of {rows} x {cols} px)",
                self.path.display(),
                counted(images, "image")
            ),
            objects_fingerprint: fingerprint,
            encoder: "unknown mask".into(),
            throughput: None,
            ceiling: None,
            notes,
        };
        let mut estimate = Estimate::new(&trials, provenance)?;
        if estimate.interval_95[1] < 0.0 {
            estimate.notes.push(
                "the measurements vary less than the noise that was stated; check gain, offset, binning and noise"
                    .into(),
            );
        }
        estimate.noise = stated;
        estimate.seconds = start.elapsed().as_secs_f64().max(kept.seconds());
        Ok(estimate)
    }

    fn trial(
        &self,
        request: &EstimateRequest,
        noise: Noise,
        patch: (usize, usize),
        &ImageParts { test, test_seed, train }: &ImageParts<'_>,
        &TrialContext { seed, keeper, smallest }: &TrialContext<'_>,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<Trial, MeasuredError> {
        let (test, shown) = self.cut(test, patch, request.patches_test, test_seed, "the test")?;
        if let DensityModel::Causal { length } = request.model {
            // Images are few, so long fits would overfit.
            let (validation, train) =
                train.split_at(if train.len() > 1 { train.len().div_ceil(VALIDATION_SHARE) } else { 0 });
            let stream = MeasuredStream { images: self.photons.select(Axis(0), train), patch };
            let validation = match validation {
                [] => None,
                images => {
                    let (noisy, _) =
                        self.cut(images, patch, VALIDATION_PATCHES, SeedStream::CausalFit.derive(seed), "the fit")?;
                    Some(PatchBatch { noisy, clean: None })
                }
            };
            let fit = CausalRequest {
                stream: &stream,
                test: &PatchBatch { noisy: test, clean: None },
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
        let train = match request.weights.from {
            Some(_) => None,
            None => Some(
                self.cut(train, patch, request.patches_train, SeedStream::TrainingPatches.derive(seed), "the fit")?.0,
            ),
        };
        report_step(progress, "Fitting", 0, 1)?;
        let (test, protocol) = (test.view(), request.protocol);
        let train = train.as_ref().map_or(test, |train| train.view());
        let gaussian =
            |covariance| GaussianRequest { train, test, test_clean: None, covariance, noise, protocol, seed };
        Ok(match request.model {
            DensityModel::Stationary => gaussian_estimate(&gaussian(Covariance::Stationary))?,
            DensityModel::GaussianFull => gaussian_estimate(&gaussian(Covariance::Full))?,
            DensityModel::PixelCnn { budget, engine } => {
                let (train_clean, test_clean, start) = (None, None, None);
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
        &self,
        images: &[usize],
        patch: (usize, usize),
        count: usize,
        seed: u64,
        model: &'static str,
    ) -> Result<(Array3<f32>, SharedImages), MeasuredError> {
        let (rows, cols) = patch;
        let pixels = rows.saturating_mul(cols);
        if count == 0 {
            return Err(InformationError::TooFewPatches { model, needed: 1, found: 0, pixels }.into());
        }
        let most = LARGEST_PATCHES_BYTES / (size_of::<f32>() * pixels.max(1));
        if count > most {
            return Err(InformationError::TooManyPatches { count, rows, cols, most }.into());
        }
        let part = self.photons.select(Axis(0), images);
        let places = Patches::draw(part.dim(), patch, count, seed)?;
        let shown = SharedImages::one_each(places.corners().iter().map(|&(image, ..)| image as u32));
        Ok((places.cut(part.view()), shown))
    }
}

/// Patches at random places of images, as many as are requested.
struct MeasuredStream {
    images: Array3<f32>,
    patch: (usize, usize),
}

impl PatchStream for MeasuredStream {
    fn draw(&self, count: usize, seed: u64) -> Result<PatchBatch, InformationError> {
        let failed = |error: SensorError| InformationError::Stream { reason: error.to_string() };
        let places = Patches::draw(self.images.dim(), self.patch, count, seed).map_err(failed)?;
        Ok(PatchBatch { noisy: places.cut(self.images.view()), clean: None })
    }
}

fn append(photons: &mut Array3<f32>, more: &Array3<f32>, file: &Path, grey: &Array3<f32>) -> Result<(), FormatError> {
    photons.append(Axis(0), more.view()).map_err(|_| {
        let (_, rows, cols) = photons.dim();
        let (_, found_rows, found_cols) = more.dim();
        let (_, file_rows, file_cols) = grey.dim();
        let found = format!("{found_rows} x {found_cols} px ({file_rows} x {file_cols} before binning)");
        let expected = format!("images of {rows} x {cols} px, as the first");
        FormatError::malformed(file, expected, found, "keep images of one camera and one crop in the folder")
    })
}

fn check_finite(file: &Path, grey: &Array3<f32>) -> Result<(), FormatError> {
    match grey.indexed_iter().find(|(_, level)| !level.is_finite()) {
        None => Ok(()),
        Some(((image, row, col), level)) => {
            let found = format!("{level} in image {}, row {row}, column {col}", image + 1);
            Err(FormatError::malformed(file, "finite pixels", found, "replace such pixels or leave the image out"))
        }
    }
}
