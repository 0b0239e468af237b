//! Forward model: measurements of objects by a mask and a sensor.

use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array2, Array3, Array4, ArrayView3, s};

use super::design::{Design, DesignError};
use super::design_objects::open_set;
use super::error::ForwardError;
use crate::objects::{ObjectSet, Split};
use crate::sensor::{Convolution, Convolver, Noise, SensorError};

/// Objects and a sensor, for any mask of one grid. The mask comes with each call, as its point spread function: an optimizer or a person
/// changes it all the time, while objects and sensor stay.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let design = Design::default();
/// let model = ForwardModel::open(&design)?;
/// let measured = model.simulate(model.psf(&design)?.view(), 0..2, design.seed)?;
/// assert_eq!(measured.noisy.dim(), (2, 65, 65));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct ForwardModel {
    /// The objects.
    pub set: Arc<ObjectSet>,
    /// Background, photons per pixel.
    pub bias: f64,
    /// Noise of the sensor.
    pub noise: Noise,
    plan: Convolution,
}

/// Objects and their measurements.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let design = Design::default();
/// let model = ForwardModel::open(&design)?;
/// let Simulated { objects, noiseless, noisy } = model.simulate(model.psf(&design)?.view(), 0..1, 3)?;
/// assert_eq!(objects.dim(), (1, 1, 96, 96));
/// assert_eq!(noiseless.dim(), noisy.dim());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Simulated {
    /// Shape (n, planes, rows, cols), photons per pixel.
    pub objects: Array4<f32>,
    /// Encoded images with background, shape (n, rows, cols).
    pub noiseless: Array3<f32>,
    /// Noisy measurements, shape (n, rows, cols), photons per pixel.
    pub noisy: Array3<f32>,
}

impl ForwardModel {
    /// A forward model of objects imaged by point spread functions of `grid` (rows, cols).
    ///
    /// # Errors
    /// Where the grid is larger than the objects.
    pub fn new(
        set: impl Into<Arc<ObjectSet>>,
        grid: (usize, usize),
        bias: f64,
        noise: Noise,
    ) -> Result<Self, SensorError> {
        let set = set.into();
        let plan = Convolution::new(set.field(), grid)?;
        Ok(Self { set, bias, noise, plan })
    }

    /// The forward model of a design, for any mask of its grid. Opens its objects.
    ///
    /// # Errors
    /// [`ForwardError`] where the objects cannot be read or do not fit the mask.
    pub fn open(design: &Design) -> Result<Self, ForwardError> {
        Self::of_objects(design, open_set(design)?)
    }

    /// The forward model of a design whose objects are open.
    ///
    /// # Errors
    /// [`ForwardError`] where the objects do not fit the mask.
    pub fn of_objects(design: &Design, set: impl Into<Arc<ObjectSet>>) -> Result<Self, ForwardError> {
        Ok(Self::new(set, design.encoder.grid(), design.bias_photons, design.noise)?)
    }

    /// The point spread function of a design on the planes of the objects, shape (planes, rows, cols).
    ///
    /// # Errors
    /// [`DesignError`] where the mask cannot be rendered.
    pub fn psf(&self, design: &Design) -> Result<Array3<f64>, DesignError> {
        let planes = self.set.planes();
        Ok(design.psf(planes)?.slice_move(s![..planes, .., ..]))
    }

    /// Simulates measurements of a range of the objects through a point spread function of shape (planes, rows, cols). An object and its
    /// noise depend only on its number and the seed: ranges of any length give the same whole.
    ///
    /// # Errors
    /// [`ForwardError`] for a point spread function of another grid, and where the objects do not fit into memory.
    pub fn simulate(
        &self,
        psf: ArrayView3<'_, f64>,
        objects: Range<usize>,
        seed: u64,
    ) -> Result<Simulated, ForwardError> {
        let convolver = self.convolver(psf)?;
        let first = objects.start;
        let objects = self.set.objects_from(Split::All, first, objects.len(), seed)?;
        let noiseless = convolver.measure(objects.view(), self.bias)?;
        let noisy = self.noise.draw_from(noiseless.view(), first, seed);
        Ok(Simulated { objects, noiseless, noisy })
    }

    /// The forward model with the noise for upper bounds by density models; see [`Noise::bounding`].
    #[must_use]
    pub fn bounding(&self) -> Self {
        Self { noise: self.noise.bounding(), ..self.clone() }
    }

    /// Transforms of the convolution.
    pub fn plan(&self) -> &Convolution {
        &self.plan
    }

    /// Shape (rows, cols) of a patch: `wished`, limited to the measurement; without `wished`, the measurement.
    pub fn patch(&self, wished: Option<(usize, usize)>) -> (usize, usize) {
        let (rows, cols) = self.plan.measurement_shape();
        wished.map_or((rows, cols), |wished| (rows.min(wished.0), cols.min(wished.1)))
    }

    /// The convolution with a point spread function of shape (planes, rows, cols); planes without objects are left
    /// out.
    ///
    /// # Errors
    /// For a grid of another size.
    pub fn convolver(&self, psf: ArrayView3<'_, f64>) -> Result<Convolver, SensorError> {
        self.plan.with_psf(psf.slice(s![..self.set.planes(), .., ..]))
    }
}

/// Mean of the measurements of a set of objects through a point spread function of shape (planes, rows, cols) with a
/// background of `bias`; photons per pixel.
pub fn mean_measurement(set: &ObjectSet, psf: ArrayView3<'_, f64>, bias: f64) -> f64 {
    // Within the measurement, beads are not thinned out by the border as they are in the mean over whole objects.
    let mean_object = set.bead_prior().map_or(set.mean(), |prior| prior.probability * prior.spot.sum());
    mean_object * psf.sum() + bias
}

/// Full convolution of a bead with the PSF: photons of one bead on an infinite sensor, shape (planes, rows, cols).
pub fn bead_response(spot: &Array2<f64>, psf: ArrayView3<'_, f64>) -> Array3<f64> {
    let (planes, rows, cols) = psf.dim();
    let (spot_rows, spot_cols) = spot.dim();
    let mut on_sensor = Array3::zeros((planes, rows + spot_rows - 1, cols + spot_cols - 1));
    for ((row, col), &photons) in spot.indexed_iter() {
        on_sensor.slice_mut(s![.., row..row + rows, col..col + cols]).scaled_add(photons, &psf);
    }
    on_sensor
}
