//! Gradients of the loss of a batch, in parts that do not depend on the number of threads.

use rayon::prelude::*;

use super::model::{PixelCnn, Workspaces, samples_per_chunk};
use crate::network::{Grid, Write, part_range, sum_in_order};

/// Parts of a batch, each summed by one thread and then all in order.
const PARTS: usize = 16;

/// One part of a batch.
#[derive(Debug, Default)]
struct Part {
    gradient: Vec<f32>,
    nats: f64,
    by_patch: Vec<f32>,
}

/// Memory for gradients, kept from step to step.
#[derive(Debug)]
pub(super) struct Gradients {
    workspaces: Workspaces,
    parts: Vec<Part>,
    /// Gradient of the mean loss by all weights.
    pub total: Vec<f32>,
}

impl Gradients {
    /// For a network of `count` weights.
    pub fn new(count: usize) -> Self {
        Self { workspaces: Workspaces::default(), parts: Vec::new(), total: vec![0.0; count] }
    }

    /// Mean negative log density of `values` (photons), nats per pixel. Its gradient by the weights is left in
    /// [`Gradients::total`], that by the values in `by_patch` where it is given.
    pub fn evaluate(&mut self, model: &PixelCnn, grid: Grid, values: &[f32], by_patch: Option<&mut [f32]>) -> f64 {
        let count = PARTS.min(grid.samples);
        self.parts.resize_with(count, Part::default);
        let pixels = grid.rows * grid.cols;
        let weight = 1.0 / grid.pixels() as f32;
        let chunk = samples_per_chunk(pixels) * pixels;
        let keep_patches = by_patch.is_some();
        let workspaces = &self.workspaces;
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
                    workspace.forward(&model.layers, &model.scale, &model.weights, values);
                    workspace.score(&model.scale, values, weight);
                    workspace.backward(&model.layers, &model.scale, &model.weights, &mut part.gradient, write);
                    part.nats += workspace.losses.iter().map(|&loss| f64::from(loss)).sum::<f64>();
                    if keep_patches {
                        part.by_patch.extend_from_slice(&workspace.by_value);
                    }
                });
            }
        });
        let parts: Vec<&[f32]> = self.parts.iter().map(|part| part.gradient.as_slice()).collect();
        sum_in_order(&parts, &mut self.total);
        if let Some(out) = by_patch {
            let all = self.parts.iter().flat_map(|part| &part.by_patch);
            for (out, value) in out.iter_mut().zip(all) {
                *out = *value;
            }
        }
        self.parts.iter().map(|part| part.nats).sum::<f64>() / grid.pixels() as f64
    }

    /// Euclidean norm of the gradient by all weights.
    pub fn norm(&self) -> f64 {
        self.total.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>().sqrt()
    }
}
