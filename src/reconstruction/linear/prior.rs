//! First two moments of a set of objects.

use std::sync::Arc;

use ndarray::{Array2, Array4, ArrayView2, Axis};
use serde::{Deserialize, Serialize};

use super::repeated;
use super::stationary::StationaryMoments;
use super::tiles::TileMoments;
use crate::objects::{ObjectSet, Split};
use crate::progress::CancelToken;
use crate::reconstruction::error::ReconstructionError;
use crate::seeds::SeedStream;

/// How objects are lit when they are measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Light {
    /// As the set draws them: one scale for all.
    #[default]
    Scene,
    /// Each object alone is scaled to this mean, photons per pixel. The decoder does not know by how much.
    EachObject {
        /// Photons per pixel.
        mean_photons: f64,
    },
}

impl Light {
    /// Scales objects (n, planes, rows, cols) as they are lit. Dark objects stay dark.
    pub fn apply(self, objects: &mut Array4<f32>) {
        let Self::EachObject { mean_photons } = self else { return };
        for mut object in objects.outer_iter_mut() {
            let mean = object.iter().map(|&value| f64::from(value)).sum::<f64>() / object.len() as f64;
            if mean > 0.0 {
                object.mapv_inplace(|value| (f64::from(value) * mean_photons / mean) as f32);
            }
        }
    }

    /// Factor from an estimate of lit objects to the scale of a set of this mean, where the estimate says nothing better.
    pub(crate) fn to_set_scale(self, set_mean: f64) -> f64 {
        match self {
            Self::Scene => 1.0,
            Self::EachObject { mean_photons } => set_mean / mean_photons,
        }
    }
}

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

/// Objects of a part: as they are lit, and on the scale of the set; shape (n, 1, rows, cols).
pub(super) struct DrawnObjects {
    pub(super) lit: Array4<f32>,
    pub(super) truth: Array4<f32>,
}

impl DrawnObjects {
    pub(super) fn draw(set: &ObjectSet, light: Light, split: Split, count: usize) -> Result<Self, ReconstructionError> {
        let seed = SeedStream::ReconstructionPrior.derive(0);
        let truth = set.objects(split, count, seed)?;
        let mut lit = truth.clone();
        light.apply(&mut lit);
        Ok(Self { lit, truth })
    }

    /// Tiles of `side` px of all objects, one a row.
    pub(super) fn tiles(objects: &Array4<f32>, side: usize) -> Array2<f32> {
        let (count, _, rows, cols) = objects.dim();
        let (down, across) = (rows / side, cols / side);
        let mut tiles = Array2::zeros((count * down * across, side * side));
        for (index, mut tile) in tiles.axis_iter_mut(Axis(0)).enumerate() {
            let (object, row, col) = (index / (down * across), index / across % down * side, index % across * side);
            let from = objects.slice(ndarray::s![object, 0, row..row + side, col..col + side]);
            tile.iter_mut().zip(from).for_each(|(value, &photons)| *value = photons);
        }
        tiles
    }
}
