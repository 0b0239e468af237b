//! The engine on this machine's processor, with results that do not depend on the number of threads.

use ndarray::{Array3, ArrayView3};
use rayon::prelude::*;

use super::engine::Engine;
use super::model::{PixelCnn, Workspaces, check, samples_per_chunk};
use crate::information::engine_choice::EngineChoice;
use crate::information::error::InformationError;
use crate::nn::{Grid, Write, ordered_sum, part_range};

/// Parts of a batch. One thread sums each part; the parts are then summed in order.
const PARTS: usize = 16;

/// One part of a batch.
#[derive(Debug, Default)]
struct Part {
    gradient: Vec<f32>,
    nats: f64,
    by_patch: Vec<f32>,
}

/// Fused kernels on all threads, with workspaces reused between steps.
#[derive(Debug, Default)]
pub(super) struct CpuEngine {
    workspaces: Workspaces,
    parts: Vec<Part>,
}

impl Engine for CpuEngine {
    fn choice(&self) -> EngineChoice {
        EngineChoice::Cpu
    }

    fn loss_and_gradients(
        &mut self,
        model: &PixelCnn,
        patches: ArrayView3<'_, f32>,
        gradient: &mut [f32],
        by_patch: Option<&mut [f32]>,
    ) -> Result<f64, InformationError> {
        let (samples, rows, cols) = patches.dim();
        let values = patches.as_standard_layout();
        // A standard layout is contiguous, so the slice is there.
        let values = values.as_slice().unwrap_or_default();
        Ok(self.evaluate(model, Grid { samples, rows, cols }, values, gradient, by_patch))
    }

    fn cross_entropy_bits(
        &mut self,
        model: &PixelCnn,
        patches: ArrayView3<'_, f32>,
    ) -> Result<Vec<f64>, InformationError> {
        model.cross_entropy_bits(patches)
    }
}

impl CpuEngine {
    fn evaluate(
        &mut self,
        model: &PixelCnn,
        grid: Grid,
        values: &[f32],
        gradient: &mut [f32],
        by_patch: Option<&mut [f32]>,
    ) -> f64 {
        let count = PARTS.min(grid.samples);
        self.parts.resize_with(count, Part::default);
        let pixels = grid.rows * grid.cols;
        let weight = 1.0 / grid.pixels() as f32;
        let chunk = samples_per_chunk(pixels) * pixels;
        let keep_patches = by_patch.is_some();
        let (workspaces, ready) = (&self.workspaces, model.ready());
        self.parts.par_iter_mut().with_max_len(1).enumerate().for_each(|(index, part)| {
            let samples = part_range(grid.samples, count, index);
            let values = &values[samples.start * pixels..samples.end * pixels];
            part.gradient.resize(model.layout.count(), 0.0);
            part.nats = 0.0;
            part.by_patch.clear();
            for (number, values) in values.chunks(chunk).enumerate() {
                let grid = Grid { samples: values.len() / pixels, ..grid };
                let write = if number == 0 { Write::Replace } else { Write::Add };
                workspaces.with(&model.shape, grid, |workspace| {
                    workspace.forward(&ready, values);
                    workspace.score(&model.scale, values, weight);
                    workspace.backward(&ready, Some((&mut part.gradient, write)));
                    part.nats += workspace.losses.iter().map(|&loss| f64::from(loss)).sum::<f64>();
                    if keep_patches {
                        part.by_patch.extend_from_slice(&workspace.by_value);
                    }
                });
            }
        });
        let parts: Vec<&[f32]> = self.parts.iter().map(|part| part.gradient.as_slice()).collect();
        ordered_sum(&parts, gradient);
        if let Some(out) = by_patch {
            let all = self.parts.iter().flat_map(|part| &part.by_patch);
            for (out, value) in out.iter_mut().zip(all) {
                *out = *value;
            }
        }
        self.parts.iter().map(|part| part.nats).sum::<f64>() / grid.pixels() as f64
    }
}

impl PixelCnn {
    /// Mean negative log density, nats per pixel, with its gradients by the weights (in the order of
    /// [`PixelCnn::layout`]) and by the patches (per photon, shape of the patches).
    ///
    /// # Errors
    /// As [`PixelCnn::cross_entropy_bits`].
    pub fn loss_and_gradients(
        &self,
        patches: ArrayView3<'_, f32>,
    ) -> Result<(f64, Vec<f32>, Array3<f32>), InformationError> {
        self.loss_and_gradients_on(&mut CpuEngine::default(), patches)
    }

    /// [`PixelCnn::loss_and_gradients`] on another engine.
    ///
    /// # Errors
    /// As there, and where a device fails.
    pub fn loss_and_gradients_on(
        &self,
        engine: &mut dyn Engine,
        patches: ArrayView3<'_, f32>,
    ) -> Result<(f64, Vec<f32>, Array3<f32>), InformationError> {
        check(patches)?;
        let (mut gradient, mut by_patch) = (vec![0.0; self.layout.count()], vec![0.0; patches.len()]);
        let loss = engine.loss_and_gradients(self, patches, &mut gradient, Some(&mut by_patch))?;
        let by_patch = Array3::from_shape_vec(patches.dim(), by_patch).unwrap_or_default();
        Ok((loss, gradient, by_patch))
    }
}
