//! Forward model: measurements of objects by a mask and a sensor.

use ndarray::{Array2, Array3, ArrayView3, s};

use crate::objects::ObjectSet;
use crate::sensor::{Convolution, Convolver, Noise, SensorError};

/// Objects and a sensor, for masks of one grid.
pub struct ForwardModel<'a> {
    /// The objects.
    pub set: &'a ObjectSet,
    /// Background, photons per pixel.
    pub bias: f64,
    /// Noise of the sensor.
    pub noise: Noise,
    plan: Convolution,
}

impl<'a> ForwardModel<'a> {
    /// A forward model of objects imaged by point spread functions of `grid` (rows, cols).
    ///
    /// # Errors
    /// Where the grid is larger than the objects.
    pub fn new(set: &'a ObjectSet, grid: (usize, usize), bias: f64, noise: Noise) -> Result<Self, SensorError> {
        Ok(Self { set, bias, noise, plan: Convolution::new(set.field(), grid)? })
    }

    /// The forward model with the noise for upper bounds by density models; see [`Noise::bounding`].
    #[must_use]
    pub fn bounding(&self) -> Self {
        Self { noise: self.noise.bounding(), plan: self.plan.clone(), ..*self }
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
