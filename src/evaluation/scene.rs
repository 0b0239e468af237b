//! Evaluation of one design on one set of objects: the computation behind every mouse move, step by step.
//!
//! Steps that depend only on the objects ([`Scene`]), or on the objects and the shape of the PSF ([`SceneTables`]), are kept between
//! edits. An edit then costs one PSF, the products with known spectra, and the later steps.

use std::sync::Arc;

use ndarray::{Array2, Array3, Array4, ArrayView3, Axis};
use thiserror::Error;

use crate::design::{IdealError, merged};
use crate::formats::FormatError;
use crate::forward::{Design, DesignError, ForwardError, bead_response, mean_measurement, open_set_with};
use crate::information::{
    AnalyticGaussian, BeadEntropyBound, EntropyBound, GaussianBound, InformationError, NoiseEntropy, bootstrap_interval,
};
use crate::objects::{ObjectError, ObjectSet, ReadProgress, Split};
use crate::optics::{Mtf, modulation_transfer};
use crate::progress::Progress;
use crate::sensor::{Convolution, ObjectSpectra, SensorError};
use crate::sparsity::{TamuraSummary, tamura_of_stack};

/// Objects that are measured for every edit; fewer where they are large.
pub const LIVE_COUNT: usize = 64;

/// Fewest of them at larger fields, and pixels of [`LIVE_COUNT`] objects of the published 96 x 96 px.
const LEAST_LIVE_COUNT: usize = 8;
const PAPER_PIXELS: usize = LIVE_COUNT * 96 * 96;

/// Most pixels that are measured for every edit: beyond, there are fewer than [`LIVE_COUNT`] objects.
const LIVE_PIXELS: usize = 1 << 24;

/// Side in pixels of the patch that live information refers to.
pub const LIVE_PATCH: usize = 32;

/// Reasons why a design has no numbers.
#[derive(Debug, Error)]
pub enum EvaluationError {
    /// The design, its objects, or both together.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// The estimate.
    #[error(transparent)]
    Information(#[from] InformationError),
    /// A run of IDEAL.
    #[error(transparent)]
    Ideal(#[from] IdealError),
    /// A file that keeps what was computed.
    #[error(transparent)]
    File(#[from] FormatError),
    /// Only lenslets can be moved.
    #[error("{mask} has no lenslets to move; choose a lenslet preset first")]
    NoLenslets {
        /// The mask.
        mask: String,
    },
    /// The bound without a fit holds where mean and covariance are the same everywhere.
    #[error(
        "{objects} are whole images, which may be brighter in the middle, where gaussian-analytic is no bound; choose \
         gaussian, which is fitted"
    )]
    NotStationary {
        /// The objects.
        objects: String,
    },
}

impl From<DesignError> for EvaluationError {
    fn from(error: DesignError) -> Self {
        Self::Forward(error.into())
    }
}

impl From<ObjectError> for EvaluationError {
    fn from(error: ObjectError) -> Self {
        Self::Forward(error.into())
    }
}

impl From<SensorError> for EvaluationError {
    fn from(error: SensorError) -> Self {
        Self::Forward(error.into())
    }
}

impl EvaluationError {
    /// Whether the computation was cancelled.
    pub fn is_cancelled(&self) -> bool {
        match self {
            Self::Information(error) | Self::Ideal(IdealError::Information(error)) => {
                *error == InformationError::Cancelled
            }
            Self::Forward(error) => matches!(error, ForwardError::Objects(ObjectError::Cancelled)),
            _ => false,
        }
    }

    /// Whether the error is about a file that may be there, or may be writable, another time.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Forward(ForwardError::Objects(ObjectError::File(error))) | Self::File(error) => error.may_pass(),
            _ => false,
        }
    }
}

/// A PSF and its transfer function.
#[derive(Clone, Debug)]
pub struct Optics {
    /// Shape (planes, rows, cols).
    pub psf: Array3<f64>,
    /// The PSF as the sensor sees it, all planes together, shape (rows, cols).
    pub image: Array2<f32>,
    /// MTF of all planes together.
    pub mtf: Mtf,
    /// Its [mean below Nyquist](Mtf::mean_below_nyquist).
    pub mean_mtf: f64,
    /// Number of lenslets that are neither dark nor coincident, and the number of equal lenslets that would spread the light alike.
    pub distinct_lenslets: Option<(usize, f64)>,
}

impl Optics {
    /// Renders the PSF of a design.
    ///
    /// # Errors
    /// [`DesignError`] where the mask cannot be rendered.
    pub fn of(design: &Design, planes: usize) -> Result<Self, DesignError> {
        let psf = design.psf(planes)?;
        let sum = psf.sum_axis(Axis(0));
        let distinct_lenslets = design.encoder.lenslets().map(|array| {
            let distinct = merged(array);
            (distinct.lenslets.len(), distinct.effective_count())
        });
        let mtf = modulation_transfer(sum.view());
        let (image, mean_mtf) = (sum.mapv(|value| value as f32), mtf.mean_below_nyquist());
        Ok(Self { psf, image, mtf, mean_mtf, distinct_lenslets })
    }
}

/// Objects ready to be measured.
pub struct Scene {
    /// The design that it was opened for.
    design: Design,
    /// The whole set.
    pub set: Arc<ObjectSet>,
    /// Up to [`LIVE_COUNT`] of its objects, shape (n, planes, rows, cols), photons per pixel.
    pub objects: Array4<f32>,
    /// Tamura coefficient of the noiseless objects, first plane.
    pub tamura: TamuraSummary,
}

impl Scene {
    /// Opens the objects of a design, with reports of the files read.
    ///
    /// # Errors
    /// [`ObjectError`] where the objects cannot be read.
    pub fn open(design: &Design, progress: &mut dyn Progress<ReadProgress>) -> Result<Self, ObjectError> {
        Self::of_set(open_set_with(design, progress)?, design)
    }

    fn of_set(set: ObjectSet, design: &Design) -> Result<Self, ObjectError> {
        let (rows, cols) = set.field();
        // A mouse move measures them all, so larger fields have fewer.
        let affordable = (PAPER_PIXELS / (rows * cols).max(1)).clamp(LEAST_LIVE_COUNT, LIVE_COUNT);
        let count = (LIVE_PIXELS / (set.planes() * rows * cols).max(1)).clamp(1, affordable);
        let objects = set.objects(Split::All, count, design.seed)?;
        let coefficients = tamura_of_stack(objects.index_axis(Axis(1), 0));
        let tamura = TamuraSummary::of(coefficients.as_slice().unwrap_or(&[])).unwrap_or(TamuraSummary {
            mean: 0.0,
            sd: 0.0,
            count: 0,
        });
        Ok(Self { design: design.clone(), set: Arc::new(set), objects, tamura })
    }

    /// Whether this scene is the one that the design images.
    pub fn serves(&self, design: &Design) -> bool {
        self.design.has_objects_of(design)
    }
}

/// Tables computed once for a scene and a shape of PSF.
pub struct SceneTables {
    psf_shape: (usize, usize),
    plan: Convolution,
    spectra: ObjectSpectra,
    analytic: AnalyticGaussian,
    /// Object-entropy bound and response to one bead, where the objects are beads of nonzero entropy.
    beads: Option<(BeadEntropyBound, Array2<f64>)>,
    patch: (usize, usize),
}

/// Measurements of the live objects.
#[derive(Clone, Debug)]
pub struct Measurements {
    /// Encoded images with background, shape (n, rows, cols), photons per pixel.
    pub noiseless: Array3<f32>,
    /// With noise.
    pub noisy: Array3<f32>,
    /// The counts without the read noise that upper bounds leave out; none where they leave out nothing.
    pub counts: Option<Array3<f32>>,
    /// Tamura coefficient of the noisy measurements' patches, the published sensor TC.
    pub tamura: TamuraSummary,
}

/// The live information of a design: upper bounds, in bits per pixel, under the default protocol.
#[derive(Clone, Debug)]
pub struct LiveInformation {
    /// The Gaussian bound.
    pub gaussian: GaussianBound,
    /// Whether the Gaussian number is a bound. For objects that are not stationary the Gaussian of the mean covariance may have less
    /// entropy.
    pub gaussian_is_bound: bool,
    /// 95 % interval of the bound: of the mean noise entropy over the live measurements.
    pub interval_95: [f64; 2],
    /// Object-entropy bound, where the objects' entropy is known.
    pub ceiling: Option<EntropyBound>,
    /// Rows and columns of the patch of both bounds.
    pub patch: (usize, usize),
}

impl LiveInformation {
    /// The name of the Gaussian number, as a bound or an approximation.
    pub fn gaussian_name(&self) -> &'static str {
        if self.gaussian_is_bound { "Gaussian bound" } else { "Gaussian approximation" }
    }

    /// The Gaussian bound of an infinitely large patch.
    pub fn infinite_patch_bits(&self) -> f64 {
        self.gaussian.spectral_entropy - self.gaussian.entropy_y_given_x
    }

    /// The object-entropy bound, bits per pixel.
    pub fn ceiling_bits(&self) -> Option<f64> {
        self.ceiling.as_ref().map(|ceiling| ceiling.bits_per_pixel)
    }
}

impl SceneTables {
    /// Prepares a scene for PSFs of shape (rows, cols).
    ///
    /// # Errors
    /// [`SensorError`] where the objects are smaller than the PSF; [`InformationError`] where their covariance is not valid.
    pub fn new(scene: &Scene, psf_shape: (usize, usize)) -> Result<Self, EvaluationError> {
        let plan = Convolution::new(scene.set.field(), psf_shape)?;
        let spectra = plan.object_spectra(scene.objects.view())?;
        let (rows, cols) = plan.measurement_shape();
        let patch = (rows.min(LIVE_PATCH), cols.min(LIVE_PATCH));
        let reach = patch.0.max(patch.1) + psf_shape.0.max(psf_shape.1) - 2;
        let analytic = AnalyticGaussian::new(&scene.set.autocovariance(Split::All, reach), psf_shape, patch)?;
        let beads = bead_ceiling(&scene.set)?;
        Ok(Self { psf_shape, plan, spectra, analytic, beads, patch })
    }

    /// Whether these tables apply to PSFs of this shape.
    pub fn serves(&self, psf_shape: (usize, usize)) -> bool {
        self.psf_shape == psf_shape
    }

    /// Measures the live objects through a PSF.
    ///
    /// # Errors
    /// [`SensorError`] where the PSF is of another shape.
    pub fn measure(&self, design: &Design, optics: &Optics, scene: &Scene) -> Result<Measurements, EvaluationError> {
        let planes = scene.set.planes();
        let seen = optics.psf.slice(ndarray::s![..planes, .., ..]);
        let noiseless = self.plan.with_psf(seen)?.measure_spectra(&self.spectra, design.bias_photons)?;
        let noisy = design.noise.draw(noiseless.view(), design.seed);
        // The published sensor TC is that of patches. One central patch is cut from each measurement, at the same place before and after
        // an edit, so that edits are comparable.
        let (rows, cols) = self.plan.measurement_shape();
        let (top, left) = ((rows - self.patch.0) / 2, (cols - self.patch.1) / 2);
        let patches = noisy.slice(ndarray::s![.., top..top + self.patch.0, left..left + self.patch.1]);
        let coefficients = tamura_of_stack(patches);
        let tamura = TamuraSummary::of(coefficients.as_slice().unwrap_or(&[])).unwrap_or(TamuraSummary {
            mean: 0.0,
            sd: 0.0,
            count: 0,
        });
        let bounding = design.noise.bounding();
        // Read noise is drawn after all counts of an image.
        let counts = (bounding != design.noise).then(|| bounding.draw(noiseless.view(), design.seed));
        Ok(Measurements { noiseless, noisy, counts, tamura })
    }

    /// The bounds on the information of a PSF's measurements; `noise_entropy` is the entropy of the noise of the upper bounds.
    ///
    /// # Errors
    /// [`InformationError`] where there is no noise, so that information is unbounded.
    pub fn information(
        &self,
        design: &Design,
        optics: &Optics,
        scene: &Scene,
        measurements: &Measurements,
        noise_entropy: &NoiseEntropy,
    ) -> Result<LiveInformation, EvaluationError> {
        let seen = optics.psf.slice(ndarray::s![..scene.set.planes(), .., ..]);
        let per_image = noise_entropy.patch_bits(measurements.noiseless.view())?;
        let entropy_y_given_x = per_image.iter().sum::<f64>() / per_image.len().max(1) as f64;
        let mean = mean_measurement(&scene.set, seen, design.bias_photons);
        let gaussian = self.analytic.evaluate(seen, mean, design.noise.bounding(), entropy_y_given_x)?;
        let interval_95 = bootstrap_interval(&[gaussian.entropy_y], &per_image, design.seed)?;
        let ceiling = match &self.beads {
            Some((table, spot)) => {
                let on_sensor = bead_response(spot, seen);
                Some(table.evaluate(on_sensor.view(), design.bias_photons, self.patch, design.noise.bounding())?)
            }
            None => None,
        };
        let gaussian_is_bound = scene.set.is_stationary(self.patch);
        Ok(LiveInformation { gaussian, gaussian_is_bound, interval_95, ceiling, patch: self.patch })
    }
}

/// Tables for the object-entropy bound of a set of objects; `None` where their entropy is not known, or is 0 (a bead on every pixel).
fn bead_ceiling(set: &ObjectSet) -> Result<Option<(BeadEntropyBound, Array2<f64>)>, InformationError> {
    let prior = set.bead_prior().filter(|prior| prior.probability < 1.0);
    prior.map(|prior| Ok((BeadEntropyBound::new(prior.probability)?, prior.spot))).transpose()
}

/// The object-entropy bound of a patch, where the objects' entropy is known. It is the bound of the counts themselves, which takes longer
/// than an edit may.
pub(crate) fn ceiling_of(
    design: &Design,
    set: &ObjectSet,
    psf: ArrayView3<'_, f64>,
    patch: (usize, usize),
) -> Result<Option<EntropyBound>, InformationError> {
    let seen = psf.slice_move(ndarray::s![..set.planes(), .., ..]);
    let beads = bead_ceiling(set)?;
    let ceiling = beads.map(|(table, spot)| {
        let spots = bead_response(&spot, seen);
        table.evaluate_exact(spots.view(), design.bias_photons, patch, design.noise.bounding())
    });
    ceiling.transpose()
}
