//! First two moments of a set of objects.

use std::sync::Arc;

use ndarray::{Array2, ArrayView2};

use super::beads::BeadMoments;
use super::light::{Light, repeated};
use super::stationary::StationaryMoments;
use super::tiles::TileMoments;
use crate::objects::{BeadPrior, ObjectSet};
use crate::progress::CancelToken;
use crate::reconstruction::error::ReconstructionError;

/// First two moments of the training part of a set of objects, for [`super::LinearMmse`].
///
/// - Mosaics of whole tiles: mean and leading principal components of a tile; tiles are independent of each other.
/// - Beads: mean and covariance in closed form, with the loss at the border.
/// - Whole images, and mosaics that a field cuts at random places: stationary covariance, constant mean.
#[derive(Clone)]
pub struct Prior {
    pub(super) moments: Moments,
    field: (usize, usize),
    mean: Array2<f32>,
    light: Light,
}

#[derive(Clone)]
pub(super) enum Moments {
    Tiles(Arc<TileMoments>),
    Beads(Arc<BeadMoments>),
    Stationary(Arc<StationaryMoments>),
}

impl Prior {
    /// Learns the prior of the training part of a set.
    ///
    /// # Errors
    /// [`ReconstructionError::Planes`] for objects with depth, [`ReconstructionError::Cancelled`], and where the set has no training
    /// images.
    pub fn learn(set: &ObjectSet, light: Light, cancel: &CancelToken) -> Result<Self, ReconstructionError> {
        if set.planes() != 1 {
            return Err(ReconstructionError::Planes { decoder: "Linear MMSE", planes: set.planes() });
        }
        let moments = match (set.whole_tiles(), set.bead_prior()) {
            (Some(side), _) => Moments::Tiles(Arc::new(TileMoments::learn(set, side, light, cancel)?)),
            (None, Some(prior)) => Moments::Beads(Arc::new(BeadMoments::learn(set, prior, light)?)),
            (None, None) => Moments::Stationary(Arc::new(StationaryMoments::learn(set, light)?)),
        };
        if cancel.is_cancelled() {
            return Err(ReconstructionError::Cancelled);
        }
        Ok(Self { light, ..Self::known(moments, set.field()) })
    }

    /// The prior of known moments, in the light of the scene.
    pub(super) fn known(moments: Moments, field: (usize, usize)) -> Self {
        let mean = match &moments {
            Moments::Tiles(tiles) => repeated(&tiles.mean_truth, tiles.side, field),
            Moments::Beads(beads) => beads.mean.clone(),
            Moments::Stationary(stationary) => stationary.mean_truth(),
        };
        Self { moments, field, mean, light: Light::Scene }
    }

    /// Rows and columns of the objects.
    pub fn field(&self) -> (usize, usize) {
        self.field
    }

    /// Mean object, shape (rows, cols), photons per pixel on the scale of the set.
    pub fn mean(&self) -> ArrayView2<'_, f32> {
        self.mean.view()
    }

    /// The beads as they are lit, where the objects are beads.
    pub(in crate::reconstruction) fn lit_beads(&self) -> Option<BeadPrior> {
        let Moments::Beads(beads) = &self.moments else { return None };
        let spot = beads.prior.spot.mapv(|photons| photons / beads.to_set_scale);
        Some(BeadPrior { spot, ..beads.prior.clone() })
    }

    /// Factor from lit objects to the scale of the set.
    pub(in crate::reconstruction) fn to_set_scale(&self) -> f64 {
        match &self.moments {
            Moments::Beads(beads) => beads.to_set_scale,
            _ => 1.0,
        }
    }

    /// Light of the objects that it was learned for.
    pub fn light(&self) -> Light {
        self.light
    }
}
