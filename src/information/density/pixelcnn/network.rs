//! Forward and backward pass of the network: from patches to outputs, and from gradients by outputs to those by
//! weights and patches.

use rayon::prelude::*;

use super::mixture::{SCRATCH, mixture_losses};
use super::scale::DataScale;
use super::shape::{Block, Layers, PixelCnnShape};
use crate::nn::{Grid, TileMemory, Write, add_bias, column_sums, elu, elu_backward, fill_bias, gate, gate_backward};

/// A network with weights prepared for passes.
#[derive(Debug)]
pub(super) struct Ready<'a> {
    layers: &'a Layers,
    scale: &'a DataScale,
    weights: &'a [f32],
    /// Kernel of every block's vertical layer, transformed for [`Block::tiled`].
    tiled: Vec<Vec<f32>>,
}

impl<'a> Ready<'a> {
    pub fn new(layers: &'a Layers, scale: &'a DataScale, weights: &'a [f32]) -> Self {
        let tiled = |block: &Block| block.tiled.transformed(&weights[block.vertical.kernel.clone()]);
        Self { layers, scale, weights, tiled: layers.blocks.par_iter().map(tiled).collect() }
    }
}

/// Gradient by the weights, and whether it is written or added; `None` without training.
pub(super) type ByWeights<'a> = Option<(&'a mut [f32], Write)>;

/// Values of one gated block that the backward pass needs; (pixels, channels C or 2C).
#[derive(Clone, Debug, Default)]
struct Kept {
    vertical: Vec<f32>,
    horizontal: Vec<f32>,
    vertical_features: Vec<f32>,
    vertical_factors: Vec<f32>,
    horizontal_factors: Vec<f32>,
    gated: Vec<f32>,
}

/// Memory of one thread for one stack of patches.
#[derive(Clone, Debug)]
pub(super) struct Workspace {
    grid: Grid,
    channels: usize,
    standardised: Vec<f32>,
    kept: Vec<Kept>,
    horizontal: Vec<f32>,
    rectified: Vec<f32>,
    out: Vec<f32>,
    /// Outputs, later the gradient by them; (pixels, 3 components).
    pub heads: Vec<f32>,
    /// Negative log densities of the pixels, nats.
    pub losses: Vec<f32>,
    /// Gradient by the patches, photons.
    pub by_value: Vec<f32>,
    columns: Vec<f32>,
    tiles: TileMemory,
    features: Vec<f32>,
    by_vertical: Vec<f32>,
    by_horizontal: Vec<f32>,
    by_gated: Vec<f32>,
    by_vertical_features: Vec<f32>,
    joint_bias: Vec<f32>,
    scratch: Vec<f32>,
}

impl Workspace {
    /// A workspace for stacks of exactly this grid.
    pub fn new(shape: &PixelCnnShape, grid: Grid) -> Self {
        let pixels = grid.pixels();
        let per_pixel = |count: usize| vec![0.0; pixels * count];
        let (channels, wide) = (shape.channels, 2 * shape.channels);
        let kept = Kept {
            vertical: per_pixel(channels),
            horizontal: per_pixel(channels),
            vertical_features: per_pixel(wide),
            vertical_factors: per_pixel(wide),
            horizontal_factors: per_pixel(wide),
            gated: per_pixel(channels),
        };
        Self {
            grid,
            channels,
            standardised: per_pixel(1),
            kept: vec![kept; shape.dilations.len()],
            horizontal: per_pixel(channels),
            rectified: per_pixel(channels),
            out: per_pixel(channels),
            heads: per_pixel(3 * shape.components),
            losses: per_pixel(1),
            by_value: per_pixel(1),
            columns: per_pixel(3.max(2 * channels)),
            tiles: TileMemory::default(),
            features: per_pixel(wide),
            by_vertical: per_pixel(channels),
            by_horizontal: per_pixel(channels),
            by_gated: per_pixel(channels),
            by_vertical_features: per_pixel(wide),
            joint_bias: vec![0.0; wide],
            scratch: vec![0.0; SCRATCH * shape.components],
        }
    }

    /// The grid of its stack.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Writes the outputs of the network for `values` (pixels, photons) to [`Workspace::heads`].
    pub fn forward(&mut self, ready: &Ready<'_>, values: &[f32]) {
        let Ready { layers, scale, weights, tiled } = ready;
        let (grid, pixels, channels) = (self.grid, self.grid.pixels(), self.channels);
        for (out, value) in self.standardised.iter_mut().zip(values) {
            *out = (value - scale.mean) / scale.deviation;
        }
        let columns = &mut self.columns[..3 * pixels];
        layers.first_vertical_taps.gather(grid, 1, &self.standardised, columns);
        layers.first_vertical.forward(weights, columns, &mut self.kept[0].vertical);
        let columns = &mut self.columns[..pixels];
        layers.first_horizontal_taps.gather(grid, 1, &self.standardised, columns);
        layers.first_horizontal.forward(weights, columns, &mut self.kept[0].horizontal);

        for (index, block) in layers.blocks.iter().enumerate() {
            let (now, later) = self.kept.split_at_mut(index + 1);
            let (now, next) = (&mut now[index], later.first_mut());
            let kernel_and_bias = (tiled[index].as_slice(), block.vertical.bias(weights));
            block.tiled.forward(grid, kernel_and_bias, &now.vertical, &mut now.vertical_features, &mut self.tiles);
            let (next_vertical, next_horizontal) = match next {
                Some(next) => (Some(&mut next.vertical), &mut next.horizontal),
                None => (None, &mut self.horizontal),
            };
            if let Some(vertical) = next_vertical {
                gate(&now.vertical_features, channels, &mut now.vertical_factors, vertical);
            }
            let columns = &mut self.columns[..2 * channels * pixels];
            block.horizontal_taps.gather(grid, channels, &now.horizontal, columns);
            add_bias(block.link.bias(weights), block.horizontal.bias(weights), &mut self.joint_bias);
            fill_bias(&self.joint_bias, &mut self.features);
            block.horizontal.add_forward(weights, columns, &mut self.features);
            block.link.add_forward(weights, &now.vertical_features, &mut self.features);
            gate(&self.features, channels, &mut now.horizontal_factors, &mut now.gated);
            add_bias(block.output.bias(weights), &now.horizontal, next_horizontal);
            block.output.add_forward(weights, &now.gated, next_horizontal);
        }
        elu(&self.horizontal, &mut self.rectified);
        layers.out.forward(weights, &self.rectified, &mut self.out);
        layers.heads.forward(weights, &self.out, &mut self.heads);
    }

    /// Writes negative log densities to [`Workspace::losses`], and `weight` times their gradients by the outputs over
    /// the outputs; call [`Workspace::forward`] first.
    pub fn score(&mut self, scale: &DataScale, values: &[f32], weight: f32) {
        let Self { heads, losses, by_value, scratch, .. } = self;
        mixture_losses(scale, values, weight, heads, losses, by_value, scratch);
    }

    /// Gradient by the weights, written or added as `into` states, and by the values, in [`Workspace::by_value`];
    /// call [`Workspace::score`] first.
    pub fn backward(&mut self, ready: &Ready<'_>, mut into: ByWeights<'_>) {
        let Ready { layers, scale, weights, .. } = ready;
        let (grid, pixels) = (self.grid, self.grid.pixels());
        if let Some((gradient, write)) = &mut into {
            layers.heads.by_weights(&self.out, &self.heads, gradient, *write);
        }
        layers.heads.by_input(weights, &self.heads, &mut self.by_gated, Write::Replace);
        if let Some((gradient, write)) = &mut into {
            layers.out.by_weights(&self.rectified, &self.by_gated, gradient, *write);
        }
        layers.out.by_input(weights, &self.by_gated, &mut self.by_horizontal, Write::Replace);
        elu_backward(&self.rectified, &mut self.by_horizontal);

        let last = layers.blocks.len().saturating_sub(1);
        for index in (0..layers.blocks.len()).rev() {
            let into = into.as_mut().map(|(gradient, write)| (&mut **gradient, *write));
            self.block_backward(ready, index, index == last, into);
        }

        let by_standardised = &mut self.features[..pixels];
        by_standardised.fill(0.0);
        let firsts = [
            (&layers.first_vertical, &layers.first_vertical_taps, &self.by_vertical),
            (&layers.first_horizontal, &layers.first_horizontal_taps, &self.by_horizontal),
        ];
        for (layer, taps, by_out) in firsts {
            let columns = &mut self.columns[..layer.inputs * pixels];
            if let Some((gradient, write)) = &mut into {
                taps.gather(grid, 1, &self.standardised, columns);
                layer.by_weights(columns, by_out, gradient, *write);
            }
            layer.by_input(weights, by_out, columns, Write::Replace);
            taps.scatter_add(grid, 1, columns, by_standardised);
        }
        for (by_value, by_standardised) in self.by_value.iter_mut().zip(by_standardised) {
            *by_value += *by_standardised / scale.deviation;
        }
    }

    /// Propagates `by_horizontal` and `by_vertical` from the outputs of a block to its inputs. The last block has no
    /// vertical output.
    fn block_backward(&mut self, ready: &Ready<'_>, index: usize, last: bool, mut into: ByWeights<'_>) {
        let (grid, pixels, channels) = (self.grid, self.grid.pixels(), self.channels);
        let (block, weights, kept) = (&ready.layers.blocks[index], ready.weights, &self.kept[index]);
        if let Some((gradient, write)) = &mut into {
            block.output.by_weights(&kept.gated, &self.by_horizontal, gradient, *write);
        }
        block.output.by_input(weights, &self.by_horizontal, &mut self.by_gated, Write::Replace);
        gate_backward(&kept.horizontal_factors, channels, &self.by_gated, &mut self.features);

        let columns = &mut self.columns[..2 * channels * pixels];
        if let Some((gradient, write)) = &mut into {
            block.horizontal_taps.gather(grid, channels, &kept.horizontal, columns);
            block.horizontal.by_kernel(columns, &self.features, gradient, *write);
            block.link.by_kernel(&kept.vertical_features, &self.features, gradient, *write);
            // Both biases are added to the same features.
            let bias = &mut gradient[block.horizontal.bias.clone()];
            if *write == Write::Replace {
                bias.fill(0.0);
            }
            column_sums(&self.features, bias);
            gradient.copy_within(block.horizontal.bias.clone(), block.link.bias.start);
        }
        block.horizontal.by_input(weights, &self.features, columns, Write::Replace);
        block.horizontal_taps.scatter_add(grid, channels, columns, &mut self.by_horizontal);

        // The vertical output of the last block is not used.
        let link = if last {
            Write::Replace
        } else {
            gate_backward(&kept.vertical_factors, channels, &self.by_vertical, &mut self.by_vertical_features);
            Write::Add
        };
        block.link.by_input(weights, &self.features, &mut self.by_vertical_features, link);
        let by_features = &self.by_vertical_features;
        let into = into.map(|(gradient, write)| {
            block.vertical.by_bias(by_features, gradient, write);
            (&mut gradient[block.vertical.kernel.clone()], write)
        });
        let seen = (kept.vertical.as_slice(), by_features.as_slice());
        block.tiled.backward(grid, &ready.tiled[index], seen, into, &mut self.by_vertical, &mut self.tiles);
    }
}
