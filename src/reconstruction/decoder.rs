//! What all decoders are: prepared for a mask, they turn measurements into objects.

use std::fmt;
use std::sync::Arc;

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};
use serde::{Deserialize, Serialize};

use super::error::ReconstructionError;
use super::model::ImagingModel;
use crate::progress::{CancelToken, Progress};

/// A method of reconstruction, with all that it knows before it sees a mask.
///
/// ```
/// use std::sync::Arc;
/// use lenslet_studio::prelude::*;
/// use lenslet_studio::reconstruction::{DecoderKind, ImagingModel, Light, Prior};
///
/// let design = Design::default();
/// let forward = ForwardModel::open(&design)?;
/// let model = ImagingModel::of_design(&design, &forward)?;
/// let prior = Prior::learn(&forward.set, Light::Scene, &CancelToken::new())?;
/// let decoder = DecoderKind::Linear.decoder(Some(Arc::new(prior)), None)?;
/// let prepared = decoder.prepare(&model, &CancelToken::new())?;
/// let measured = forward.simulate(model.psf().insert_axis(ndarray::Axis(0)), 0..2, 1)?;
/// let objects = prepared.reconstruct(measured.noisy.view(), &mut CancelToken::new())?;
/// assert_eq!(objects.dim(), (2, 96, 96));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Decoder: Send + Sync {
    /// The method.
    fn kind(&self) -> DecoderKind;

    /// The decoder ready for one mask; again after every edit.
    ///
    /// # Errors
    /// [`ReconstructionError`] where the model does not fit the decoder or memory; [`ReconstructionError::Cancelled`].
    fn prepare(
        &self,
        model: &ImagingModel,
        cancel: &CancelToken,
    ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError>;
}

/// A decoder that is ready for one mask. Results do not depend on the number of threads, nor on the other images of a stack.
pub trait PreparedDecoder: Send + Sync {
    /// Objects of measurements of shape (n, rows, cols): shape (n, field rows, field cols), photons per pixel on the scale of the
    /// object set. Values may be negative where the method does not know better.
    ///
    /// # Errors
    /// [`ReconstructionError`] for measurements of another shape or without finite values; [`ReconstructionError::Cancelled`].
    fn reconstruct(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array3<f32>, ReconstructionError>;

    /// As [`PreparedDecoder::reconstruct`], with the squared error that the method expects of each object.
    ///
    /// # Errors
    /// As [`PreparedDecoder::reconstruct`].
    fn estimate(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<ObjectEstimates, ReconstructionError> {
        Ok(ObjectEstimates { objects: self.reconstruct(measurements, progress)?, expected_mse: None })
    }

    /// Posterior standard deviation of every pixel of the object, shape (field rows, field cols), photons per pixel. `None` where the
    /// method has no posterior.
    ///
    /// # Errors
    /// As [`PreparedDecoder::reconstruct`].
    fn standard_deviation(
        &self,
        _measurement: ArrayView2<'_, f32>,
        _cancel: &CancelToken,
    ) -> Result<Option<Array2<f32>>, ReconstructionError> {
        Ok(None)
    }

    /// Expected squared error of a pixel, mean over the field and over all measurements, photons squared. `None` where the method has no
    /// closed form.
    ///
    /// # Errors
    /// [`ReconstructionError::Cancelled`].
    fn expected_mse(&self, _cancel: &CancelToken) -> Result<Option<f64>, ReconstructionError> {
        Ok(None)
    }
}

/// Objects of a stack of measurements.
pub struct ObjectEstimates {
    /// Objects as by [`PreparedDecoder::reconstruct`].
    pub objects: Array3<f32>,
    /// Squared error that the posterior of each measurement expects, mean over the pixels, photons squared. `None` where the method
    /// has none.
    pub expected_mse: Option<Vec<f64>>,
}

impl dyn PreparedDecoder + '_ {
    /// Object of one measurement of shape (rows, cols).
    ///
    /// # Errors
    /// As [`PreparedDecoder::reconstruct`].
    pub fn reconstruct_one(
        &self,
        measurement: ArrayView2<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array2<f32>, ReconstructionError> {
        let objects = self.reconstruct(measurement.insert_axis(Axis(0)), progress)?;
        Ok(objects.index_axis_move(Axis(0), 0))
    }
}

/// Progress of a reconstruction.
#[derive(Clone, Debug)]
pub enum ReconstructionStep {
    /// Images of a stack that are done.
    Images {
        /// Images done.
        done: usize,
        /// Images of the stack.
        total: usize,
    },
    /// An iterative method at work on a single image.
    Iteration {
        /// Iterations done.
        done: usize,
        /// Most iterations.
        most: usize,
        /// The object so far, shape (field rows, field cols); not with every iteration.
        object: Option<Arc<Array2<f32>>>,
    },
}

/// What a decoder needs besides mask and measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecoderNeeds {
    /// A set of objects to learn a prior from.
    pub objects: bool,
    /// Training for the mask.
    pub training: bool,
}

/// The decoders, by the names of the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub enum DecoderKind {
    /// Linear estimate of least squared error, with a prior from the training objects; live.
    #[default]
    Linear,
    /// Posterior mean of beads, by the trained decoder and, given time, by Markov chains.
    Posterior,
    /// Total variation with non-negativity, by ADMM; needs no objects.
    #[serde(rename = "tv")]
    #[cfg_attr(feature = "cli", value(name = "tv"))]
    TotalVariation,
    /// Trained network on top of the linear estimate.
    Network,
    /// Published U-net, trained for one mask.
    Unet,
    /// Richardson-Lucy iterations until the residual is that of the noise; needs no objects.
    RichardsonLucy,
}

impl DecoderKind {
    /// All decoders, in the order of the menu.
    pub const ALL: [Self; 6] =
        [Self::Linear, Self::Posterior, Self::TotalVariation, Self::Network, Self::Unet, Self::RichardsonLucy];

    /// Name in the window and in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "Linear MMSE",
            Self::Posterior => "Posterior mean",
            Self::TotalVariation => "Total variation",
            Self::Network => "Trained network",
            Self::Unet => "Published U-net",
            Self::RichardsonLucy => "Richardson-Lucy",
        }
    }

    /// Whether it has a posterior standard deviation.
    pub fn has_deviation(self) -> bool {
        matches!(self, Self::Linear | Self::Posterior | Self::Network)
    }

    /// What it needs.
    pub fn needs(self) -> DecoderNeeds {
        let objects = matches!(self, Self::Linear | Self::Posterior | Self::Network);
        DecoderNeeds { objects, training: matches!(self, Self::Network | Self::Unet) }
    }
}

impl fmt::Display for DecoderKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}
