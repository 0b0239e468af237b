//! Moments of mosaics: tiles are independent and share a mean and leading principal components.

use std::sync::Arc;

use faer::{Mat, MatRef};
use ndarray::Array2;
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;

use super::conjugate_gradients::{MeasurementCovariance, PriorSample};
use super::light::{DrawnObjects, Light, repeated};
use super::principal_components::{Components, columns, held_out_shares, mean_of, product};
use crate::objects::{ObjectSet, Split};
use crate::progress::CancelToken;
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;
use crate::sensor::{BlurWorkspace, Convolution, Convolver};

/// Most components of a tile. More gain less than 0.1 dB on natural images and cost time with their cube.
const MOST_COMPONENTS: usize = 300;
/// Most values of the samples that components are learned from; 256 MiB.
const MOST_VALUES: usize = 1 << 26;
/// Fewest images that variances are validated on.
const LEAST_VALIDATION: usize = 8;
/// Fewest and most objects that are drawn for samples where each object is lit to the same mean.
const FEWEST_OBJECTS: usize = 500;
const MOST_OBJECTS: usize = 3000;

/// Moments of a tile: as lit it is `mean_lit + U z`, on the scale of the set `mean_truth + V z`, for z of mean 0 and covariance I; pixels vary
/// beside by `left_out`.
pub(in crate::reconstruction) struct TileMoments {
    pub(super) side: usize,
    /// Rows and columns of tiles.
    pub(super) grid: (usize, usize),
    pub(super) field: (usize, usize),
    pub(super) mean_lit: Vec<f32>,
    pub(super) mean_truth: Vec<f32>,
    /// U, shape (pixels, components).
    pub(super) lit: Mat<f32>,
    /// V, shape (pixels, components).
    pub(super) truth: Mat<f32>,
    /// Variance of each lit pixel that the components leave out, photons squared.
    pub(super) left_out_lit: Vec<f32>,
    /// Variance of each pixel on the scale of the set that the components leave out, photons squared.
    pub(super) left_out_truth: Vec<f32>,
}

impl TileMoments {
    /// Learns the moments of the training tiles of a set of mosaics with tiles of `side` px.
    pub(super) fn learn(
        set: &ObjectSet,
        side: usize,
        light: Light,
        cancel: &CancelToken,
    ) -> Result<Self, ReconstructionError> {
        let field = set.field();
        let pixels = side * side;
        let mut samples = TileSamples::draw(set, side, light, Split::Train)?;
        if samples.lit.nrows() == 0 {
            // The same error as for objects of that part.
            set.objects(Split::Train, 1, 0)?;
        }
        let (mean_lit, variance_lit) = centred(&mut samples.lit);
        let components = Components::of(&samples.lit, MOST_COMPONENTS);
        if cancel.is_cancelled() {
            return Err(ReconstructionError::Cancelled);
        }
        let shares = Self::shares(set, side, light);
        let count = components.variances.len().min(shares.len());
        let deviation = |k: usize| components.variances[k].sqrt();
        let directions = &components.directions;
        let u = |i: usize, k: usize| (f64::from(directions[(i, k)]) * deviation(k) * shares[k].sqrt()) as f32;
        let lit = Mat::from_fn(pixels, count, u);
        let (mean_truth, variance_truth, truth) = match samples.truth {
            None => (mean_lit.clone(), variance_lit.clone(), lit.clone()),
            Some(mut truth) => {
                let (mean, variance) = centred(&mut truth);
                let scores = product(columns(&samples.lit).transpose(), directions.as_ref());
                let cross = product(columns(&truth), scores.as_ref());
                let tiles = truth.nrows() as f64;
                let v = |i: usize, k: usize| match deviation(k) * tiles {
                    size if size > 0.0 => (f64::from(cross[(i, k)]) / size * shares[k].sqrt()) as f32,
                    _ => 0.0,
                };
                (mean, variance, Mat::from_fn(pixels, count, v))
            }
        };
        Ok(Self {
            side,
            grid: (field.0 / side, field.1 / side),
            field,
            left_out_lit: left_out(&variance_lit, &lit),
            left_out_truth: left_out(&variance_truth, &truth),
            mean_lit,
            mean_truth,
            lit,
            truth,
        })
    }

    /// Share of the variance of each component that images have which it was not found from.
    fn shares(set: &ObjectSet, side: usize, light: Light) -> Vec<f64> {
        let [mut fit, mut validation] = [Split::Fit, Split::Validation]
            .map(|split| TileSamples::draw(set, side, light, split).map(|tiles| tiles.lit));
        let (Ok(fit), Ok(validation)) = (&mut fit, &mut validation) else { return vec![1.0; MOST_COMPONENTS] };
        if validation.nrows() < LEAST_VALIDATION {
            return vec![1.0; MOST_COMPONENTS];
        }
        let (mean, _) = centred(fit);
        for mut tile in validation.rows_mut() {
            tile.iter_mut().zip(&mean).for_each(|(value, &mean)| *value -= mean);
        }
        held_out_shares(fit, validation, MOST_COMPONENTS)
    }

    /// Components of a tile.
    pub(super) fn components(&self) -> usize {
        self.lit.ncols()
    }

    /// Tiles of an object.
    pub(super) fn tiles(&self) -> usize {
        self.grid.0 * self.grid.1
    }

    /// Coefficients of an object.
    pub(super) fn unknowns(&self) -> usize {
        self.components() * self.tiles()
    }

    /// First row and column of a tile within the object.
    pub(super) fn corner(&self, tile: usize) -> (usize, usize) {
        (tile / self.grid.1 * self.side, tile % self.grid.1 * self.side)
    }

    /// Copies the tiles of an object, row by row, to the columns of a matrix (pixels, tiles), column after column.
    pub(super) fn cut(&self, object: &[f32], tiles: &mut [f32]) {
        let (side, cols) = (self.side, self.field.1);
        for (index, tile) in tiles.chunks_exact_mut(side * side).enumerate() {
            let (top, left) = self.corner(index);
            for (row, values) in tile.chunks_exact_mut(side).enumerate() {
                let start = (top + row) * cols + left;
                values.copy_from_slice(&object[start..start + side]);
            }
        }
    }

    /// Writes tiles into an object: the inverse of [`TileMoments::cut`].
    pub(super) fn join(&self, tiles: &[f32], object: &mut [f32]) {
        let (side, cols) = (self.side, self.field.1);
        for (index, tile) in tiles.chunks_exact(side * side).enumerate() {
            let (top, left) = self.corner(index);
            for (row, values) in tile.chunks_exact(side).enumerate() {
                let start = (top + row) * cols + left;
                object[start..start + side].copy_from_slice(values);
            }
        }
    }
}

/// Tiles of a part of a set, one a row.
struct TileSamples {
    /// As they are lit.
    lit: Array2<f32>,
    /// On the scale of the set, where that differs.
    truth: Option<Array2<f32>>,
}

impl TileSamples {
    /// Base images in the light of the scene; tiles of drawn objects where each object is lit alone.
    fn draw(set: &ObjectSet, side: usize, light: Light, split: Split) -> Result<Self, ReconstructionError> {
        let most = (MOST_VALUES / (side * side)).max(1);
        let tiles = set.tiles(split, most).unwrap_or_default();
        if light == Light::Scene || tiles.nrows() == 0 {
            return Ok(Self { lit: tiles, truth: None });
        }
        let places = (set.field().0 / side) * (set.field().1 / side);
        let count =
            (2 * tiles.nrows()).div_ceil(places).clamp(FEWEST_OBJECTS, MOST_OBJECTS).min((most / places).max(1));
        let drawn = DrawnObjects::draw(set, light, split, count)?;
        Ok(Self { lit: DrawnObjects::tiles(&drawn.lit, side), truth: Some(DrawnObjects::tiles(&drawn.truth, side)) })
    }
}

/// Subtracts the mean from samples (n, pixels); returns it and the variance of each pixel.
fn centred(samples: &mut Array2<f32>) -> (Vec<f32>, Vec<f64>) {
    let mean: Vec<f32> = mean_of(samples.view()).into_iter().map(|mean| mean as f32).collect();
    let mut variance = vec![0.0; mean.len()];
    for mut sample in samples.rows_mut() {
        for ((value, &mean), variance) in sample.iter_mut().zip(&mean).zip(&mut variance) {
            *value -= mean;
            *variance += f64::from(*value).powi(2);
        }
    }
    let count = samples.nrows().max(1) as f64;
    (mean, variance.into_iter().map(|sum| sum / count).collect())
}

/// Variance of each pixel beyond that of components (pixels, count).
fn left_out(variance: &[f64], components: &Mat<f32>) -> Vec<f32> {
    let explained = |i: usize| components.row(i).iter().map(|&value| f64::from(value).powi(2)).sum::<f64>();
    variance.iter().enumerate().map(|(i, variance)| (variance - explained(i)).max(0.0) as f32).collect()
}

/// Images of one thread.
pub(super) struct TileMemory {
    blur: BlurWorkspace,
    object: Vec<f32>,
    tiles: Vec<f32>,
}

/// Covariance of measurements of mosaics.
pub(super) struct TileCovariance {
    moments: Arc<TileMoments>,
    convolver: Convolver,
}

impl TileCovariance {
    pub(super) fn new(model: &ImagingModel, moments: Arc<TileMoments>) -> Result<Self, ReconstructionError> {
        let plan = Convolution::new(model.field(), model.psf().dim())?;
        let convolver = plan.with_psf(model.psf().insert_axis(ndarray::Axis(0)))?;
        Ok(Self { moments, convolver })
    }

    /// Coefficients `U^T A^T v`, shape (components, tiles).
    fn coefficients(&self, v: &[f32], memory: &mut TileMemory) -> Mat<f32> {
        self.convolver.blur_transposed(v, &mut memory.object, &mut memory.blur);
        self.moments.cut(&memory.object, &mut memory.tiles);
        let tiles = MatRef::from_column_major_slice(&memory.tiles, self.moments.side.pow(2), self.moments.tiles());
        product(self.moments.lit.transpose(), tiles)
    }

    /// Object of coefficients (components, tiles) by components (pixels, components).
    fn object(&self, components: &Mat<f32>, z: &Mat<f32>, memory: &mut TileMemory) {
        let tiles = product(components.as_ref(), z.as_ref());
        let side = self.moments.side.pow(2);
        for (column, values) in memory.tiles.chunks_exact_mut(side).enumerate() {
            values.iter_mut().zip(tiles.col(column).iter()).for_each(|(value, &pixel)| *value = pixel);
        }
        self.moments.join(&memory.tiles, &mut memory.object);
    }
}

impl MeasurementCovariance for TileCovariance {
    type Memory = TileMemory;

    fn memory(&self) -> TileMemory {
        let pixels = self.moments.field.0 * self.moments.field.1;
        TileMemory { blur: self.convolver.blur_workspace(), object: vec![0.0; pixels], tiles: vec![0.0; pixels] }
    }

    fn mean_lit(&self) -> Array2<f32> {
        repeated(&self.moments.mean_lit, self.moments.side, self.moments.field)
    }

    fn left_out(&self) -> Option<[Array2<f32>; 2]> {
        let over_field = |tile: &[f32]| repeated(tile, self.moments.side, self.moments.field);
        Some([over_field(&self.moments.left_out_lit), over_field(&self.moments.left_out_truth)])
    }

    fn apply(&self, v: &[f32], out: &mut [f32], memory: &mut TileMemory) {
        let z = self.coefficients(v, memory);
        self.object(&self.moments.lit, &z, memory);
        self.convolver.blur(&memory.object, out, &mut memory.blur);
    }

    fn estimate(&self, v: &[f32], out: &mut [f32], memory: &mut TileMemory) {
        let z = self.coefficients(v, memory);
        self.object(&self.moments.truth, &z, memory);
        out.copy_from_slice(&memory.object);
    }

    fn sample(&self, random: &mut dyn Rng, memory: &mut TileMemory) -> PriorSample {
        let (components, tiles) = (self.moments.components(), self.moments.tiles());
        let z = Mat::from_fn(components, tiles, |_, _| random.sample::<f32, _>(StandardNormal));
        self.object(&self.moments.lit, &z, memory);
        let lit = memory.object.clone();
        self.object(&self.moments.truth, &z, memory);
        PriorSample { lit, truth: memory.object.clone() }
    }
}
