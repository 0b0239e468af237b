//! Moments of measurements from objects and mask, without drawing any measurement.

use std::sync::Arc;

use ndarray::{ArrayView3, s};

use crate::forward::{ForwardModel, bead_response, mean_measurement};
use crate::information::decoder::channel::BeadChannel;
use crate::information::density::causal::conditioning::Moments;
use crate::information::density::gaussian::analytic::AnalyticGaussian;
use crate::information::error::InformationError;
use crate::objects::{ObjectSet, Split};
use crate::sensor::Noise;

impl ForwardModel {
    /// The channel from beads to patches of measurements through a point spread function of shape (planes, rows,
    /// cols). `None` where the objects are no beads or carry no information.
    pub fn bead_channel(&self, psf: ArrayView3<'_, f64>, patch: (usize, usize)) -> Option<BeadChannel> {
        let prior = self.set.bead_prior().filter(|prior| prior.probability < 1.0)?;
        let spot = bead_response(&prior.spot, psf.slice(s![..self.set.planes(), .., ..]));
        Some(BeadChannel { spot, probability: prior.probability, bias: self.bias, noise: self.noise, patch })
    }

    /// Analytic moments of patches of the objects of a split, for any mask of `grid` (rows, cols). A model scored on
    /// other objects must not use those of its test.
    ///
    /// # Errors
    /// For patches that are too large.
    pub fn analytic_moments(
        &self,
        split: Split,
        grid: (usize, usize),
        patch: (usize, usize),
    ) -> Result<AnalyticMoments, InformationError> {
        let reach = (patch.0 + grid.0).max(patch.1 + grid.1) - 2;
        let covariance = AnalyticGaussian::new(&self.set.autocovariance(split, reach), grid, patch)?;
        Ok(AnalyticMoments { set: Arc::clone(&self.set), bias: self.bias, noise: self.noise, covariance })
    }
}

/// Mean and covariance of measurements, without drawing any.
pub struct AnalyticMoments {
    set: Arc<ObjectSet>,
    bias: f64,
    noise: Noise,
    /// The Gaussian of that covariance.
    pub covariance: AnalyticGaussian,
}

impl AnalyticMoments {
    /// The moments of measurements through a point spread function of shape (planes, rows, cols), which has the
    /// objects' planes.
    ///
    /// # Errors
    /// For another shape, or no noise.
    pub fn of(&self, psf: ArrayView3<'_, f64>) -> Result<Moments, InformationError> {
        let mean = mean_measurement(&self.set, psf, self.bias);
        let autocovariance = self.covariance.measured_autocovariance(psf, mean, self.noise)?;
        Ok(Moments { mean, autocovariance })
    }
}
