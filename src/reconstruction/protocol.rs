//! Test sets of decoders, and their results over them.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use ndarray::{Array, Array2, Array3, ArrayView, ArrayView3, Axis, Dimension};
use serde::{Deserialize, Serialize};

use super::decoder::{Decoder, DecoderKind, ReconstructionStep};
use super::error::ReconstructionError;
use super::linear::{Light, Prior, mean_object};
use super::model::ImagingModel;
use super::quality::{ImageQuality, clipped_mse, psnr_db};
use crate::forward::ForwardModel;
use crate::information::{InformationError, Protocol, paired_interval};
use crate::objects::{ObjectSet, Split};
use crate::progress::{CancelToken, Progress};
use crate::seeds::SeedStream;
use crate::sensor::{Convolution, Noise};

/// Photons per pixel that the published protocol scales each object to.
const PAPER_PHOTONS: f64 = 100.0;
/// Objects whose errors are averaged before the logarithm of a PSNR, as in the publication.
const BATCH: usize = 64;

/// Objects, light and noise that decoders are trained for and tested on.
///
/// - Default protocol: the scene as it is, with its background, photons and noise.
/// - Paper protocol (Kabuli et al. 2026): each object alone is scaled to 100 photons per pixel; no background; shot noise.
///
/// Test objects come from the test part of the base images. Truth is the object in units of [`ObjectSet::peak`], so that images
/// of 8 bits lie in [0, 1].
#[derive(Clone)]
pub struct DecoderScene {
    /// The objects.
    pub set: Arc<ObjectSet>,
    /// Light on the objects.
    pub light: Light,
    /// Background, photons per pixel.
    pub background: f64,
    /// Noise of the sensor.
    pub noise: Noise,
    /// The protocol.
    pub protocol: Protocol,
}

/// Objects of a test set, all of shape (n, rows, cols).
pub struct TestObjects {
    /// Objects, photons per pixel on the scale of the set.
    pub objects: Array3<f32>,
    /// Their noisy measurements, photons per pixel.
    pub measurements: Array3<f32>,
}

impl DecoderScene {
    /// The scene of a forward model under a protocol.
    ///
    /// # Errors
    /// [`ReconstructionError::Planes`] for objects with depth.
    pub fn new(forward: &ForwardModel, protocol: Protocol) -> Result<Self, ReconstructionError> {
        let set = forward.set.clone();
        if set.planes() != 1 {
            return Err(ReconstructionError::Planes { decoder: "reconstruction", planes: set.planes() });
        }
        Ok(match protocol {
            Protocol::Default => {
                Self { set, light: Light::Scene, background: forward.bias, noise: forward.noise, protocol }
            }
            Protocol::Paper => {
                let light = Light::EachObject { mean_photons: PAPER_PHOTONS };
                Self { set, light, background: 0.0, noise: Noise::Shot, protocol }
            }
        })
    }

    /// The model of a point spread function of shape (1, rows, cols) in this scene.
    ///
    /// # Errors
    /// As [`ImagingModel::new`].
    pub fn model(&self, psf: ArrayView3<'_, f64>) -> Result<ImagingModel, ReconstructionError> {
        ImagingModel::new(psf, self.set.field(), self.background, self.noise)
    }

    /// The prior of the training objects in this light.
    ///
    /// # Errors
    /// As [`Prior::learn`].
    pub fn prior(&self, cancel: &CancelToken) -> Result<Prior, ReconstructionError> {
        Prior::learn(&self.set, self.light, cancel)
    }

    /// Mean of the training objects, shape (rows, cols), photons per pixel: the best estimate without a measurement.
    pub fn mean_object(&self) -> Array2<f32> {
        mean_object(&self.set)
    }

    /// Test objects of these numbers and their measurements by a model. Objects and noise depend on their number and the seed alone.
    ///
    /// # Errors
    /// [`ReconstructionError::Forward`] where the set has no test images or the objects do not fit into memory.
    pub fn test_objects(
        &self,
        model: &ImagingModel,
        numbers: Range<usize>,
        seed: u64,
    ) -> Result<TestObjects, ReconstructionError> {
        let (first, count) = (numbers.start, numbers.len());
        let objects_seed = SeedStream::ReconstructionObjects.derive(seed);
        let objects = self.set.objects_from(Split::Test, first, count, objects_seed)?;
        let mut lit = objects.clone();
        self.light.apply(&mut lit);
        let plan = Convolution::new(model.field(), model.psf().dim())?;
        let convolver = plan.with_psf(model.psf().insert_axis(Axis(0)))?;
        let noiseless = convolver.measure(lit.view(), model.background)?;
        let noise_seed = SeedStream::ReconstructionNoise.derive(seed);
        let measurements = model.noise.draw_from(noiseless.view(), first, noise_seed);
        Ok(TestObjects { objects: objects.index_axis_move(Axis(1), 0), measurements })
    }
}

/// Mean over test objects and its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Mean {
    value: f64,
    interval: [f64; 2],
}

impl Mean {
    fn of(values: &[f64], seed: u64) -> Result<Self, InformationError> {
        let value = values.iter().sum::<f64>() / values.len().max(1) as f64;
        Ok(Self { value, interval: paired_interval(values, seed)? })
    }

    /// PSNR of mean squared errors, of which each batch is averaged before the logarithm.
    fn psnr(errors: &[f64], seed: u64) -> Result<Self, InformationError> {
        let batches: Vec<f64> =
            errors.chunks(BATCH).map(|batch| psnr_db(batch.iter().sum::<f64>() / batch.len() as f64)).collect();
        let [low, high] = paired_interval(errors, seed)?;
        let value = batches.iter().sum::<f64>() / batches.len().max(1) as f64;
        Ok(Self { value, interval: [psnr_db(high), psnr_db(low.max(0.0))] })
    }
}

/// Image quality of a decoder over a test set. Intervals of 95 % cover the choice of test objects and their noise.
///
/// PSNRs average the squared errors of 64 objects before the logarithm, and then the batches, as the publication does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct DecoderQuality {
    /// The decoder.
    pub decoder: DecoderKind,
    /// Protocol of light, background and noise.
    pub protocol: Protocol,
    /// Peak signal-to-noise ratio of estimates clipped to [0, 1], dB.
    pub psnr_db: f64,
    /// Its interval.
    pub psnr_db_interval_95: [f64; 2],
    /// Mean structural similarity.
    pub ssim: f64,
    /// Its interval.
    pub ssim_interval_95: [f64; 2],
    /// Mean squared error of clipped estimates, in units of the squared peak.
    pub mse: f64,
    /// Its interval.
    pub mse_interval_95: [f64; 2],
    /// Mean of 1 - MSE / variance of the object; `None` where all objects are of one value.
    pub r2: Option<f64>,
    /// Its interval.
    pub r2_interval_95: Option<[f64; 2]>,
    /// PSNR of the mean of the training objects as the estimate of every object, dB.
    pub psnr_constant_db: f64,
    /// Its interval.
    pub psnr_constant_db_interval_95: [f64; 2],
    /// PSNR of estimates that are not clipped, dB.
    pub psnr_unclipped_db: f64,
    /// Its interval.
    pub psnr_unclipped_db_interval_95: [f64; 2],
    /// PSNR of estimates that are not clipped, in closed form, dB. `None` for decoders without one.
    pub psnr_linear_closed_form_db: Option<f64>,
    /// PSNR of estimates that are not clipped, as the posterior of each measurement expects it, dB. `None` for decoders without a
    /// posterior of each measurement.
    #[serde(default)]
    pub psnr_posterior_db: Option<f64>,
    /// Number of test objects.
    pub test_objects: usize,
    /// Trained networks that the numbers are means over; 0 for decoders without training.
    pub networks: usize,
    /// Photons per pixel of a truth of 1.
    pub peak_photons: f64,
    /// Seed of test objects and noise.
    pub seed: u64,
    /// Seconds of preparation for the mask and of all reconstructions.
    pub seconds: f64,
}

/// A part of a test set with its reconstructions, and the quality of each.
pub struct Evaluated<'a> {
    /// Number of the first object.
    pub first: usize,
    /// Objects and measurements.
    pub test: &'a TestObjects,
    /// Reconstructions, shape (n, rows, cols), photons per pixel on the scale of the set.
    pub reconstructions: ArrayView3<'a, f32>,
    /// Quality of each.
    pub quality: &'a [ImageQuality],
}

/// Test of a decoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecoderTest {
    /// Number of test objects.
    pub objects: usize,
    /// Seed of test objects and noise.
    pub seed: u64,
}

impl Default for DecoderTest {
    fn default() -> Self {
        Self { objects: 500, seed: 1 }
    }
}

impl DecoderTest {
    /// Tests a decoder on a model of a scene. `receive` gets every part as soon as it is done; its error ends the test.
    ///
    /// # Errors
    /// [`ReconstructionError`] of decoder and scene, or that of `receive`.
    pub fn run<E: From<ReconstructionError>>(
        self,
        decoder: &dyn Decoder,
        scene: &DecoderScene,
        model: &ImagingModel,
        progress: &mut dyn Progress<ReconstructionStep>,
        receive: &mut dyn FnMut(&Evaluated<'_>) -> Result<(), E>,
    ) -> Result<DecoderQuality, E> {
        let cancel = CancelToken::new();
        let started = Instant::now();
        let prepared = decoder.prepare(model, &cancel)?;
        let mut seconds = started.elapsed().as_secs_f64();
        let (mut scores, mut expected) = (TestScores::new(scene), Vec::new());
        for first in (0..self.objects).step_by(BATCH) {
            let numbers = first..(first + BATCH).min(self.objects);
            let test = scene.test_objects(model, numbers.clone(), self.seed)?;
            let started = Instant::now();
            let estimates = prepared.estimate(test.measurements.view(), &mut |step: &ReconstructionStep| {
                let ReconstructionStep::Images { done, .. } = step else { return progress.report(step) };
                progress.report(&ReconstructionStep::Images { done: first + done, total: self.objects })
            })?;
            let reconstructions = estimates.objects;
            expected.extend(estimates.expected_mse.unwrap_or_default());
            seconds += started.elapsed().as_secs_f64();
            let quality = scores.add(test.objects.view(), reconstructions.view())?;
            receive(&Evaluated { first, test: &test, reconstructions: reconstructions.view(), quality })?;
        }
        let peak = scene.set.peak();
        let to_psnr = |mse: f64| psnr_db(mse / (peak * peak));
        let closed_form = prepared.expected_mse(&cancel)?.map(to_psnr);
        let posterior = (!expected.is_empty()).then(|| to_psnr(expected.iter().sum::<f64>() / expected.len() as f64));
        let quality = scores.summary(decoder.kind(), scene.protocol, self.seed, seconds)?;
        Ok(DecoderQuality { psnr_linear_closed_form_db: closed_form, psnr_posterior_db: posterior, ..quality })
    }
}

/// Quality of the test objects so far.
pub(crate) struct TestScores {
    peak: f64,
    /// Mean of the training objects in units of the peak.
    mean_object: Array2<f32>,
    quality: Vec<ImageQuality>,
    /// Squared errors of the mean object.
    constant: Vec<f64>,
}

impl TestScores {
    /// No scores in a scene.
    pub(crate) fn new(scene: &DecoderScene) -> Self {
        let peak = scene.set.peak();
        let mean_object = in_units_of(peak, scene.mean_object().view());
        Self { peak, mean_object, quality: Vec::new(), constant: Vec::new() }
    }

    /// Test objects so far.
    pub(crate) fn count(&self) -> usize {
        self.quality.len()
    }

    /// Adds objects and their reconstructions, both of shape (n, rows, cols), photons per pixel. Returns the quality of each.
    ///
    /// # Errors
    /// As [`ImageQuality::of`].
    pub(crate) fn add(
        &mut self,
        objects: ArrayView3<'_, f32>,
        reconstructions: ArrayView3<'_, f32>,
    ) -> Result<&[ImageQuality], ReconstructionError> {
        let [truth, found] = [objects, reconstructions].map(|photons| in_units_of(self.peak, photons));
        let before = self.count();
        self.quality.extend(ImageQuality::of_stack(truth.view(), found.view())?);
        self.constant.extend(truth.outer_iter().map(|truth| clipped_mse(truth, self.mean_object.view())));
        Ok(&self.quality[before..])
    }

    /// Quality over the objects so far.
    ///
    /// # Errors
    /// [`ReconstructionError::Information`] for fewer than two objects.
    pub(crate) fn summary(
        &self,
        decoder: DecoderKind,
        protocol: Protocol,
        seed: u64,
        seconds: f64,
    ) -> Result<DecoderQuality, ReconstructionError> {
        let list = |value: fn(&ImageQuality) -> f64| self.quality.iter().map(value).collect::<Vec<_>>();
        let psnr = Mean::psnr(&list(|quality| quality.mse), seed)?;
        let unclipped = Mean::psnr(&list(|quality| quality.mse_unclipped), seed)?;
        let mse = Mean::of(&list(|quality| quality.mse), seed)?;
        let ssim = Mean::of(&list(|quality| quality.ssim), seed)?;
        let r2: Vec<f64> = self.quality.iter().filter_map(|quality| quality.r2).collect();
        let r2 = if r2.is_empty() { None } else { Some(Mean::of(&r2, seed)?) };
        let constant = Mean::psnr(&self.constant, seed)?;
        Ok(DecoderQuality {
            decoder,
            protocol,
            psnr_db: psnr.value,
            psnr_db_interval_95: psnr.interval,
            ssim: ssim.value,
            ssim_interval_95: ssim.interval,
            mse: mse.value,
            mse_interval_95: mse.interval,
            r2: r2.map(|mean| mean.value),
            r2_interval_95: r2.map(|mean| mean.interval),
            psnr_constant_db: constant.value,
            psnr_constant_db_interval_95: constant.interval,
            psnr_unclipped_db: unclipped.value,
            psnr_unclipped_db_interval_95: unclipped.interval,
            psnr_linear_closed_form_db: None,
            psnr_posterior_db: None,
            test_objects: self.count(),
            networks: 0,
            peak_photons: self.peak,
            seed,
            seconds,
        })
    }
}

/// Photons in units of the peak.
pub(crate) fn in_units_of<D: Dimension>(peak: f64, photons: ArrayView<'_, f32, D>) -> Array<f32, D> {
    photons.mapv(|value| (f64::from(value) / peak) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::Design;
    use crate::reconstruction::DecoderKind;

    fn scene(protocol: Protocol) -> (DecoderScene, ImagingModel) {
        let design = Design::default();
        let forward = ForwardModel::open(&design).unwrap();
        let scene = DecoderScene::new(&forward, protocol).unwrap();
        let model = scene.model(forward.psf(&design).unwrap().view()).unwrap();
        (scene, model)
    }

    #[test]
    fn test_objects_depend_on_their_number_and_the_seed_alone() {
        let (scene, model) = scene(Protocol::Default);
        let whole = scene.test_objects(&model, 0..5, 7).unwrap();
        let part = scene.test_objects(&model, 3..5, 7).unwrap();
        assert_eq!(whole.objects.slice(ndarray::s![3.., .., ..]), part.objects);
        assert_eq!(whole.measurements.slice(ndarray::s![3.., .., ..]), part.measurements);
        assert_ne!(part.objects, scene.test_objects(&model, 3..5, 8).unwrap().objects);
        let mean = whole.measurements.mean().unwrap();
        assert!((mean - 110.0).abs() < 15.0, "photons and background: {mean}");
    }

    #[test]
    fn paper_protocol_lights_each_object_alike_without_background() {
        let (scene, model) = scene(Protocol::Paper);
        assert_eq!((model.background, model.noise), (0.0, Noise::Shot));
        let mut objects = scene.set.objects(Split::Test, 4, 1).unwrap();
        objects.index_axis_mut(Axis(0), 2).mapv_inplace(|value| 3.0 * value);
        objects.index_axis_mut(Axis(0), 3).fill(0.0);
        scene.light.apply(&mut objects);
        for (object, mean) in objects.outer_iter().zip([100.0, 100.0, 100.0, 0.0]) {
            assert!((object.mean().unwrap() - mean).abs() < 1e-3);
        }
    }

    /// The closed form is the expectation of the sample; the numbers of one image are those of the whole.
    #[test]
    fn linear_estimate_of_beads_is_as_good_as_its_closed_form() {
        let (scene, model) = scene(Protocol::Default);
        let prior = Arc::new(scene.prior(&CancelToken::new()).unwrap());
        let decoder = DecoderKind::Linear.decoder(Some(prior), None).unwrap();
        let test = DecoderTest { objects: 70, seed: 3 };
        let (mut parts, mut errors) = (Vec::new(), Vec::new());
        let quality = test
            .run::<ReconstructionError>(&*decoder, &scene, &model, &mut CancelToken::new(), &mut |part| {
                parts.push((part.first, part.reconstructions.dim()));
                errors.extend(part.quality.iter().map(|quality| quality.mse));
                Ok(())
            })
            .unwrap();
        assert_eq!(parts, [(0, (64, 96, 96)), (64, (6, 96, 96))]);
        let closed_form = quality.psnr_linear_closed_form_db.unwrap();
        assert!((quality.psnr_unclipped_db - closed_form).abs() < 0.15, "{quality:?}");
        assert!(quality.psnr_db > quality.psnr_constant_db + 1.0, "{quality:?}");
        assert!((quality.mse - errors.iter().sum::<f64>() / 70.0).abs() < 1e-12);
        let [low, high] = quality.psnr_db_interval_95;
        assert!(low < quality.psnr_db && quality.psnr_db < high && high - low < 0.5, "{quality:?}");
        let json = serde_json::to_value(&quality).unwrap();
        assert_eq!((&json["decoder"], &json["networks"]), (&"linear".into(), &0.into()));
        assert_eq!(serde_json::from_value::<DecoderQuality>(json).unwrap(), quality);
    }

    #[test]
    fn volumes_are_refused() {
        let design = Design { objects: "volume:3:0.02".parse().unwrap(), ..Design::default() };
        let forward = ForwardModel::open(&design).unwrap();
        let error = DecoderScene::new(&forward, Protocol::Default).err().unwrap().to_string();
        assert!(error.contains("expected objects of one plane, found 3"), "{error}");
    }
}
