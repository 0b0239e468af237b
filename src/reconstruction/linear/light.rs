//! Objects as they are lit, and their mean.

use ndarray::{Array2, Array4, Axis};
use serde::{Deserialize, Serialize};

use super::principal_components::mean_of;
use crate::objects::{BeadPrior, ObjectSet, Split};
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

    /// Expected factor from lit objects to the scale of a set of this mean.
    pub(crate) fn to_set_scale(self, set_mean: f64) -> f64 {
        match self {
            Self::Scene => 1.0,
            Self::EachObject { mean_photons } => set_mean / mean_photons,
        }
    }
}

/// Mean of the training objects of a set, shape (rows, cols), photons per pixel. Mosaics have that of a tile, beads thin out at the border,
/// and others have one mean for all pixels.
pub fn mean_object(set: &ObjectSet) -> Array2<f32> {
    if let (Some(side), Some(tiles)) = (set.whole_tiles(), set.tiles(Split::Train, usize::MAX)) {
        let mean: Vec<f32> = mean_of(tiles.view()).into_iter().map(|mean| mean as f32).collect();
        return repeated(&mean, side, set.field());
    }
    match set.bead_prior() {
        Some(prior) => mean_of_beads(&prior, set.field()),
        None => Array2::from_elem(set.field(), set.mean() as f32),
    }
}

/// Expected beads in every pixel: fewer at the border, beyond which there are none.
pub(super) fn mean_of_beads(prior: &BeadPrior, (rows, cols): (usize, usize)) -> Array2<f32> {
    let (anchor_row, anchor_col) = prior.anchor;
    // A bead at (row, col) adds spot[i, j] to (row + i - anchor_row, col + j - anchor_col).
    let is_inside = |pixel: usize, anchor: usize, index: usize, length: usize| {
        (pixel + anchor).checked_sub(index).is_some_and(|place| place < length)
    };
    Array2::from_shape_fn((rows, cols), |(row, col)| {
        let spot = prior.spot.indexed_iter();
        let light =
            spot.filter(|((i, j), _)| is_inside(row, anchor_row, *i, rows) && is_inside(col, anchor_col, *j, cols));
        (prior.probability * light.map(|(_, &photons)| photons).sum::<f64>()) as f32
    })
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

/// One tile of shape (side, side), repeated over the field.
pub(super) fn repeated(tile: &[f32], side: usize, field: (usize, usize)) -> Array2<f32> {
    Array2::from_shape_fn(field, |(row, col)| tile[row % side * side + col % side])
}
