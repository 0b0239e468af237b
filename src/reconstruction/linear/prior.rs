//! First two moments of a set of objects.

use std::sync::Arc;

use ndarray::{Array2, ArrayView2};

use super::light::{Light, repeated};
use super::stationary::StationaryMoments;
use super::tiles::TileMoments;
use crate::objects::ObjectSet;
use crate::progress::CancelToken;
use crate::reconstruction::error::ReconstructionError;

/// First two moments of the training part of a set of objects, for [`super::LinearMmse`].
///
/// - Mosaics of whole tiles: mean and leading principal components of a tile; tiles are independent of each other.
/// - Beads: stationary covariance in closed form, and the mean with its loss at the border.
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
        let moments = match set.whole_tiles() {
            Some(side) => Moments::Tiles(Arc::new(TileMoments::learn(set, side, light, cancel)?)),
            None => Moments::Stationary(Arc::new(StationaryMoments::learn(set, light)?)),
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

    /// Light of the objects that it was learned for.
    pub fn light(&self) -> Light {
        self.light
    }
}
