//! A `PixelCNN` with its weights: densities of patches and gradients of their loss.

use ndarray::{Array4, ArrayView3, s};
use rayon::prelude::*;

use super::mixture::component;
use super::network::{Ready, Workspace};
use super::scale::DataScale;
use super::shape::{Layers, PixelCnnShape};
use crate::information::density::patch_checks::check_values;
use crate::information::error::InformationError;
use crate::nn::{Grid, ParameterLayout, Pool};
use crate::progress::Progress;

/// Largest patch, px: a thread needs about 22 kB for each pixel.
const MAX_PATCH_PIXELS: usize = 1 << 14;
/// Pixels in the network of a thread at a time, unless a patch is larger; they fit its cache.
pub(super) const CHUNK_PIXELS: usize = 1024;

/// The published autoregressive network (Pinkard et al. 2024) for one kind of data.
///
/// Its 617,592 open weights (847,480 with those behind masks) cover 13 rows above and 13 px to the left.
#[derive(Clone, Debug)]
pub struct PixelCnn {
    pub(super) shape: PixelCnnShape,
    pub(super) layers: Layers,
    pub(super) layout: ParameterLayout,
    pub(super) scale: DataScale,
    pub(super) weights: Vec<f32>,
}

/// The mixture of Gaussians at every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixtures {
    /// Means in photons, shape (n, rows, cols, components).
    pub means: Array4<f32>,
    /// Standard deviations in photons, the same shape.
    pub widths: Array4<f32>,
    /// Logarithms of the weights up to a constant, the same shape.
    pub logits: Array4<f32>,
}

impl PixelCnn {
    /// A network with random weights, for data of this scale.
    pub fn new(shape: PixelCnnShape, scale: DataScale, seed: u64) -> Self {
        let (layers, layout) = shape.layers(&scale);
        let weights = layout.draw(seed);
        Self { shape, layers, layout, scale, weights }
    }

    /// Statistics of the data it is for.
    pub fn scale(&self) -> &DataScale {
        &self.scale
    }

    /// Names, shapes and places of its weights.
    pub fn layout(&self) -> &ParameterLayout {
        &self.layout
    }

    /// All weights, in the order of [`PixelCnn::layout`].
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// All weights, mutable.
    pub fn weights_mut(&mut self) -> &mut [f32] {
        &mut self.weights
    }

    /// Cross-entropy of each patch, `-log2 p(y)` in bits per pixel; patches in photons, shape (n, rows, cols).
    ///
    /// # Errors
    /// For empty or too large patches, and values that are not finite or above 10 million.
    pub fn cross_entropy_bits(&self, patches: ArrayView3<'_, f32>) -> Result<Vec<f64>, InformationError> {
        let pixels = patches.dim().1 * patches.dim().2;
        self.over_chunks(&self.ready(), patches, |workspace, values, out| {
            workspace.score(&self.scale, values, 0.0);
            out.extend(workspace.losses.chunks_exact(pixels).map(|losses| {
                let nats: f64 = losses.iter().map(|&loss| f64::from(loss)).sum();
                nats / pixels as f64 / std::f64::consts::LN_2
            }));
        })
    }

    /// The mixture at every pixel of patches (photons), shape (n, rows, cols).
    ///
    /// # Errors
    /// As [`PixelCnn::cross_entropy_bits`].
    pub fn mixtures(&self, patches: ArrayView3<'_, f32>) -> Result<Mixtures, InformationError> {
        let components = self.shape.components;
        let all = self.over_chunks(&self.ready(), patches, |workspace, _, out| {
            out.extend(workspace.heads.chunks_exact(components).map(<[f32]>::to_vec));
        })?;
        let (samples, rows, cols) = patches.dim();
        let pick = |value: &dyn Fn(usize, usize) -> f32| {
            Array4::from_shape_fn((samples, rows, cols, components), |(n, row, col, k)| {
                value(3 * ((n * rows + row) * cols + col), k)
            })
        };
        let gaussian = |at: usize, k: usize| component(&self.scale, all[at][k], all[at + 1][k]);
        Ok(Mixtures {
            means: pick(&|at, k| gaussian(at, k).0),
            widths: pick(&|at, k| gaussian(at, k).1),
            logits: pick(&|at, k| all[at + 2][k]),
        })
    }

    /// Negative log density of every pixel, nats, and the gradient of their sum by that pixel, per photon; patches in
    /// photons, pixel after pixel. The number of patches so far is reported before each part.
    pub(super) fn losses_and_gradients(
        &self,
        patches: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<usize>,
    ) -> Result<Vec<(f32, f32)>, InformationError> {
        let (ready, (samples, rows, cols)) = (self.ready(), patches.dim());
        // One chunk for every thread between two checks for cancellation.
        let at_once = samples_per_chunk(rows * cols) * rayon::current_num_threads();
        let mut all = Vec::with_capacity(patches.len());
        for first in (0..samples).step_by(at_once) {
            if progress.report(&first).is_break() {
                return Err(InformationError::Cancelled);
            }
            let some = patches.slice(s![first..samples.min(first + at_once), .., ..]);
            all.extend(self.over_chunks(&ready, some, |workspace, values, out| {
                workspace.score(&self.scale, values, 1.0);
                workspace.backward(&ready, None);
                out.extend(workspace.losses.iter().copied().zip(workspace.by_value.iter().copied()));
            })?);
        }
        Ok(all)
    }

    /// The network with weights prepared for passes.
    pub(super) fn ready(&self) -> Ready<'_> {
        Ready::new(&self.layers, &self.scale, &self.weights)
    }

    /// Passes patches through the network, some at a time, and concatenates the results of `read`, in order.
    fn over_chunks<T: Send>(
        &self,
        ready: &Ready<'_>,
        patches: ArrayView3<'_, f32>,
        read: impl Fn(&mut Workspace, &[f32], &mut Vec<T>) + Sync,
    ) -> Result<Vec<T>, InformationError> {
        let grid = check(patches)?;
        let values = patches.as_standard_layout();
        // A standard layout is contiguous, so the slice is there.
        let values = values.as_slice().unwrap_or_default();
        let pixels = grid.rows * grid.cols;
        let chunk = samples_per_chunk(pixels) * pixels;
        let workspaces = Workspaces::default();
        let parts: Vec<Vec<T>> = values
            .par_chunks(chunk)
            .map(|values| {
                let grid = Grid { samples: values.len() / pixels, ..grid };
                let mut out = Vec::new();
                workspaces.with(&self.shape, grid, |workspace| {
                    workspace.forward(ready, values);
                    read(workspace, values, &mut out);
                });
                out
            })
            .collect();
        Ok(parts.into_iter().flatten().collect())
    }
}

/// Patches in the network of a thread at a time.
pub(super) fn samples_per_chunk(patch_pixels: usize) -> usize {
    (CHUNK_PIXELS / patch_pixels.max(1)).max(1)
}

/// Checks that the network can take the patches.
pub(in crate::information) fn check(patches: ArrayView3<'_, f32>) -> Result<Grid, InformationError> {
    let (samples, rows, cols) = patches.dim();
    if !(1..=MAX_PATCH_PIXELS).contains(&(rows * cols)) {
        return Err(InformationError::PatchSize { rows, cols, limit: MAX_PATCH_PIXELS });
    }
    check_values(patches, "patches")?;
    Ok(Grid { samples, rows, cols })
}

/// Workspaces of the threads, reused between stacks of patches.
#[derive(Debug, Default)]
pub(super) struct Workspaces(Pool<Workspace>);

impl Workspaces {
    /// Lends a workspace for this grid.
    pub fn with(&self, shape: &PixelCnnShape, grid: Grid, work: impl FnOnce(&mut Workspace)) {
        self.0.with(|workspace| workspace.grid() == grid, || Workspace::new(shape, grid), work);
    }
}
