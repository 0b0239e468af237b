//! The model that a decoder inverts: one mask, one field, the light and the noise of one sensor.

use ndarray::{Array2, ArrayView2, ArrayView3, Axis};

use super::error::ReconstructionError;
use super::network::TrainingMasks;
use crate::forward::{Design, ForwardModel};
use crate::optics::Encoder;
use crate::sensor::{Noise, SensorError, field_offset};

/// Least variance of the noise of a pixel in shares of the squared mean measurement; stands in for that of a sensor without noise.
const LEAST_RELATIVE_VARIANCE: f64 = 1e-8;

/// Valid convolution of one object plane with a point spread function, plus background and noise: `y = noise(h * o + b)`.
///
/// ```
/// use lenslet_studio::prelude::*;
/// use lenslet_studio::reconstruction::ImagingModel;
///
/// let design = Design::default();
/// let model = ImagingModel::new(design.psf(1)?.view(), (96, 96), design.bias_photons, design.noise)?;
/// assert_eq!(model.measurement_shape(), (65, 65));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ImagingModel {
    psf: Array2<f64>,
    field: (usize, usize),
    /// The mask in words, where it is none that networks for any mask learn from.
    beyond_training: Option<String>,
    /// Background, photons per pixel.
    pub background: f64,
    /// Noise of the sensor.
    pub noise: Noise,
}

impl ImagingModel {
    /// The model of a point spread function of shape (1, rows, cols) that images objects of shape `field`.
    ///
    /// # Errors
    /// [`ReconstructionError::Planes`] for more planes than one; where the field is smaller than the point spread function.
    pub fn new(
        psf: ArrayView3<'_, f64>,
        field: (usize, usize),
        background: f64,
        noise: Noise,
    ) -> Result<Self, ReconstructionError> {
        let (planes, rows, cols) = psf.dim();
        if planes != 1 {
            return Err(ReconstructionError::Planes { decoder: "reconstruction", planes });
        }
        if rows == 0 || cols == 0 || field.0 < rows || field.1 < cols {
            let (object_rows, object_cols) = field;
            let error = SensorError::ObjectSmallerThanPsf { object_rows, object_cols, psf_rows: rows, psf_cols: cols };
            return Err(error.into());
        }
        let psf = psf.index_axis(Axis(0), 0).to_owned();
        Ok(Self { psf, field, beyond_training: None, background, noise })
    }

    /// The same model, of which the mask is known as well. A network for any mask serves it where [`TrainingMasks::any`] trains for it; a
    /// model of a PSF alone counts as such a mask.
    #[must_use]
    pub fn of_mask(self, encoder: &Encoder) -> Self {
        let beyond_training = TrainingMasks::any(encoder).is_err().then(|| encoder.describe());
        Self { beyond_training, ..self }
    }

    /// The model of a design whose objects are open.
    ///
    /// # Errors
    /// [`ReconstructionError::Planes`] for objects with depth; where the mask cannot be rendered.
    pub fn of_design(design: &Design, forward: &ForwardModel) -> Result<Self, ReconstructionError> {
        let psf = forward.psf(design).map_err(crate::forward::ForwardError::from)?;
        let model = Self::new(psf.view(), forward.set.field(), forward.bias, forward.noise)?;
        Ok(model.of_mask(&design.encoder))
    }

    /// The model of a capture of shape `measurement` without background: the field is all that the mask lets the sensor see.
    ///
    /// # Errors
    /// [`ReconstructionError::SmallMeasurement`] where the capture is smaller than the point spread function.
    pub fn of_capture(
        psf: ArrayView2<'_, f64>,
        measurement: (usize, usize),
        noise: Noise,
    ) -> Result<Self, ReconstructionError> {
        let ((psf_rows, psf_cols), (rows, cols)) = (psf.dim(), measurement);
        if rows < psf_rows || cols < psf_cols {
            return Err(ReconstructionError::SmallMeasurement { rows, cols, psf_rows, psf_cols });
        }
        let field = (rows + psf_rows.max(1) - 1, cols + psf_cols.max(1) - 1);
        Self::new(psf.insert_axis(Axis(0)), field, 0.0, noise)
    }

    /// Point spread function, shape (rows, cols).
    pub fn psf(&self) -> ArrayView2<'_, f64> {
        self.psf.view()
    }

    /// The mask in words, where it is known to be none that networks for any mask learn from.
    pub(super) fn beyond_training(&self) -> Option<&str> {
        self.beyond_training.as_deref()
    }

    /// Rows and columns of the objects.
    pub fn field(&self) -> (usize, usize) {
        self.field
    }

    /// Rows and columns of the measurements.
    pub fn measurement_shape(&self) -> (usize, usize) {
        (self.field.0 + 1 - self.psf.nrows(), self.field.1 + 1 - self.psf.ncols())
    }

    /// First row and column of the part of the field that lies before the sensor, which has the shape of the measurement.
    pub fn sensor_corner(&self) -> (usize, usize) {
        field_offset(self.psf.dim())
    }

    /// Variance of the noise of a pixel with this mean, photons squared. `scale` is the mean of the measurements.
    pub(super) fn noise_variance(&self, mean: f64, scale: f64) -> f64 {
        let shot = if self.noise.has_shot_noise() { mean.max(1.0) } else { 0.0 };
        let read = self.noise.read_sigma().map_or(0.0, |sigma| sigma * sigma);
        (shot + read).max(LEAST_RELATIVE_VARIANCE * scale * scale).max(f64::MIN_POSITIVE)
    }

    /// Checks the shape of measurements (n, rows, cols).
    pub(super) fn check_measurements(&self, measurements: &ArrayView3<'_, f32>) -> Result<(), ReconstructionError> {
        let (count, rows, cols) = measurements.dim();
        let expected = self.measurement_shape();
        if (rows, cols) == expected {
            return Ok(());
        }
        Err(ReconstructionError::shape("measurements", &[count, expected.0, expected.1], measurements.shape()))
    }
}
