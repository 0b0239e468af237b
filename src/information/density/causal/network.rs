//! Forward and backward pass of the network: from patches to losses, and from losses to gradients by weights.

use super::conditioning::{Conditioning, PatchInputs, WINDOW_CHANNELS};
use super::head::{exact_loss, level_losses};
use super::levels::Levels;
use super::masked_conv::MaskedConvMemory;
use super::shape::{Block, CausalShape, FAR_CHANNELS, Layers};
use crate::nn::{Grid, Write, glu, glu_backward, rms_norm, rms_norm_backward, silu, silu_backward};

/// Pixels whose likelihoods are looked up at a time: few enough for the cache.
const STRETCH: usize = 32;

/// Values of one residual block that the backward pass needs.
#[derive(Clone, Debug, Default)]
struct Kept {
    /// Input of the block, (pixels, C).
    stream: Vec<f32>,
    /// The same, normalised.
    normalised: Vec<f32>,
    /// 1 / rms of every pixel.
    inverses: Vec<f32>,
    /// Sigmoids of the gate, (pixels, C).
    sigmoids: Vec<f32>,
    /// Output of the gate, (pixels, C).
    gated: Vec<f32>,
    /// Input of the far places, (pixels, [`FAR_CHANNELS`]).
    narrow: Vec<f32>,
}

/// Memory of one thread for one patch.
#[derive(Clone, Debug)]
pub(super) struct Workspace {
    grid: Grid,
    channels: usize,
    levels: usize,
    kept: Vec<Kept>,
    window_columns: Vec<f32>,
    five_taps: MaskedConvMemory,
    far_columns: Vec<f32>,
    features: Vec<f32>,
    first_sigmoids: Vec<f32>,
    first: Vec<f32>,
    stream: Vec<f32>,
    before_last: Vec<f32>,
    last: Vec<f32>,
    /// Outputs, later the gradient by them; (pixels, levels + 1).
    outputs: Vec<f32>,
    /// Outputs of a few pixels before they are replaced by their gradients.
    before_losses: Vec<f32>,
    shares: Vec<f32>,
    /// Negative log-likelihoods of the pixels, nats.
    pub losses: Vec<f32>,
    by_stream: Vec<f32>,
    by_gated: Vec<f32>,
    by_gain: Vec<f32>,
    by_narrow: Vec<f32>,
    scratch: Vec<f32>,
}

impl Workspace {
    pub fn new(shape: &CausalShape, layers: &Layers, patch: (usize, usize)) -> Self {
        let grid = Grid { samples: 1, rows: patch.0, cols: patch.1 };
        let pixels = grid.pixels();
        let per_pixel = |count: usize| vec![0.0; pixels * count];
        let (channels, levels) = (shape.channels, layers.head.outputs - 1);
        let kept = Kept {
            stream: per_pixel(channels),
            normalised: per_pixel(channels),
            inverses: per_pixel(1),
            sigmoids: per_pixel(channels),
            gated: per_pixel(channels),
            narrow: per_pixel(FAR_CHANNELS),
        };
        Self {
            grid,
            channels,
            levels,
            kept: vec![kept; layers.blocks.len()],
            window_columns: per_pixel(layers.window.inputs),
            five_taps: MaskedConvMemory::default(),
            far_columns: per_pixel(layers.far_taps.count() * FAR_CHANNELS),
            by_narrow: per_pixel(FAR_CHANNELS),
            features: per_pixel(2 * channels),
            first_sigmoids: per_pixel(channels),
            first: per_pixel(channels),
            stream: per_pixel(channels),
            before_last: per_pixel(channels),
            last: per_pixel(channels),
            outputs: per_pixel(levels + 1),
            before_losses: vec![0.0; STRETCH * (levels + 1)],
            shares: Vec::new(),
            losses: per_pixel(1),
            by_stream: per_pixel(channels),
            by_gated: per_pixel(channels),
            by_gain: vec![0.0; channels],
            scratch: Vec::new(),
        }
    }

    /// Whether the workspace has this size.
    pub fn serves(&self, layers: &Layers, patch: (usize, usize)) -> bool {
        (self.grid.rows, self.grid.cols) == patch
            && self.levels + 1 == layers.head.outputs
            && self.kept.len() == layers.blocks.len()
            && self.channels == layers.last.inputs
    }

    /// Outputs of the network, before the losses: (pixels, levels + 1).
    pub fn forward(&mut self, layers: &Layers, weights: &[f32], inputs: PatchInputs<'_>) -> &[f32] {
        let (grid, channels) = (self.grid, self.channels);
        layers.window_taps.gather(grid, WINDOW_CHANNELS, inputs.window, &mut self.window_columns);
        layers.window.forward(weights, &self.window_columns, &mut self.features);
        layers.present.add_forward(weights, inputs.present, &mut self.features);
        glu(&self.features, channels, &mut self.first_sigmoids, &mut self.first);
        for (index, block) in layers.blocks.iter().enumerate() {
            let (now, later) = self.kept.split_at_mut(index + 1);
            let now = &mut now[index];
            if index == 0 {
                now.stream.copy_from_slice(&self.first);
            }
            rms_norm(&now.stream, &weights[block.gain.clone()], &mut now.inverses, &mut now.normalised);
            block.wide.forward(grid, weights, &now.normalised, &mut self.features, &mut self.five_taps);
            if let Some(far) = &block.far {
                now.narrow.fill(0.0);
                far.narrow.add_forward(weights, &now.normalised, &mut now.narrow);
                layers.far_taps.gather(grid, FAR_CHANNELS, &now.narrow, &mut self.far_columns);
                far.wide.add_forward(weights, &self.far_columns, &mut self.features);
            }
            glu(&self.features, channels, &mut now.sigmoids, &mut now.gated);
            let next = later.first_mut().map_or(&mut self.stream, |next| &mut next.stream);
            crate::nn::add_bias(block.out.bias(weights), &now.stream, next);
            block.out.add_forward(weights, &now.gated, next);
        }
        layers.last.forward(weights, &self.stream, &mut self.before_last);
        silu(&self.before_last, &mut self.last);
        layers.head.forward(weights, &self.last, &mut self.outputs);
        &self.outputs
    }

    /// Writes losses to [`Workspace::losses`] and `weight` times their gradients over the outputs; call
    /// [`Workspace::forward`] first.
    pub fn score(&mut self, conditioning: &Conditioning, inputs: PatchInputs<'_>, weight: f32) {
        let levels = &conditioning.levels;
        let (count, targets) = (levels.count(), inputs.targets.len() / inputs.values.len());
        self.shares.resize(STRETCH * targets * count, 0.0);
        self.scratch.resize(2 * count + targets, 0.0);
        let stretches = self.outputs.chunks_mut(STRETCH * (count + 1)).zip(self.losses.chunks_mut(STRETCH));
        let given = inputs.guess.chunks(STRETCH).zip(inputs.targets.chunks(STRETCH * targets));
        for ((outputs, losses), (guess, values)) in stretches.zip(given) {
            // Where single precision fails, the original outputs are needed.
            let before = &mut self.before_losses[..outputs.len()];
            before.copy_from_slice(outputs);
            let room = self.shares.chunks_exact_mut(count);
            let likelihoods: Vec<_> = values.iter().zip(room).map(|(&y, room)| levels.likelihoods(y, room)).collect();
            level_losses(&levels.photons, guess, &likelihoods, weight, outputs, losses, &mut self.scratch);
            let pixels = outputs.chunks_exact_mut(count + 1).zip(before.chunks_exact(count + 1));
            let given = guess.iter().zip(values.chunks_exact(targets));
            for ((loss, (by, outputs)), (&guess, values)) in losses.iter_mut().zip(pixels).zip(given) {
                if !loss.is_finite() {
                    *loss = exact_mean(levels, guess, values, weight, outputs, by);
                }
            }
        }
    }

    /// Replaces the gradients of [`Workspace::score`] by gradients by the outputs, (pixels, levels + 1).
    pub fn set_output_gradients(&mut self, by_outputs: &[f32]) {
        self.outputs.copy_from_slice(by_outputs);
    }

    /// Gradients by the window channels and the present channels of the inputs; call [`Workspace::backward`] first.
    pub fn by_inputs(&mut self, layers: &Layers, weights: &[f32], by_window: &mut [f32], by_present: &mut [f32]) {
        layers.window.by_input(weights, &self.features, &mut self.window_columns, Write::Replace);
        by_window.fill(0.0);
        layers.window_taps.scatter_add(self.grid, WINDOW_CHANNELS, &self.window_columns, by_window);
        layers.present.by_input(weights, &self.features, by_present, Write::Replace);
    }

    /// Gradients of the losses by all values inside; call [`Workspace::score`] first. Those by the weights are
    /// written to `gradient`; without it a third of the products are left out.
    pub fn backward(
        &mut self,
        layers: &Layers,
        weights: &[f32],
        inputs: PatchInputs<'_>,
        mut gradient: Option<&mut [f32]>,
    ) {
        if let Some(gradient) = gradient.as_deref_mut() {
            layers.head.by_weights(&self.last, &self.outputs, gradient, Write::Replace);
        }
        layers.head.by_input(weights, &self.outputs, &mut self.by_gated, Write::Replace);
        silu_backward(&self.before_last, &mut self.by_gated);
        if let Some(gradient) = gradient.as_deref_mut() {
            layers.last.by_weights(&self.stream, &self.by_gated, gradient, Write::Replace);
        }
        layers.last.by_input(weights, &self.by_gated, &mut self.by_stream, Write::Replace);
        for (index, block) in layers.blocks.iter().enumerate().rev() {
            self.block_backward(layers, block, index, weights, gradient.as_deref_mut());
        }
        glu_backward(&self.first_sigmoids, &self.first, self.channels, &self.by_stream, &mut self.features);
        if let Some(gradient) = gradient {
            layers.window.by_weights(&self.window_columns, &self.features, gradient, Write::Replace);
            layers.present.by_kernel(inputs.present, &self.features, gradient, Write::Replace);
        }
    }

    /// Propagates `by_stream` from the output of a block to its input.
    fn block_backward(
        &mut self,
        layers: &Layers,
        block: &Block,
        index: usize,
        weights: &[f32],
        mut gradient: Option<&mut [f32]>,
    ) {
        let (grid, channels) = (self.grid, self.channels);
        let kept = &self.kept[index];
        if let Some(gradient) = gradient.as_deref_mut() {
            block.out.by_weights(&kept.gated, &self.by_stream, gradient, Write::Replace);
        }
        block.out.by_input(weights, &self.by_stream, &mut self.by_gated, Write::Replace);
        glu_backward(&kept.sigmoids, &kept.gated, channels, &self.by_gated, &mut self.features);
        let given = (kept.normalised.as_slice(), self.features.as_slice());
        let memory = &mut self.five_taps;
        block.wide.backward(grid, weights, given, gradient.as_deref_mut(), &mut self.by_gated, memory);
        if let Some(far) = &block.far {
            let columns = &mut self.far_columns;
            if let Some(gradient) = gradient.as_deref_mut() {
                layers.far_taps.gather(grid, FAR_CHANNELS, &kept.narrow, columns);
                far.wide.by_kernel(columns, &self.features, gradient, Write::Replace);
            }
            far.wide.by_input(weights, &self.features, columns, Write::Replace);
            self.by_narrow.fill(0.0);
            layers.far_taps.scatter_add(grid, FAR_CHANNELS, columns, &mut self.by_narrow);
            if let Some(gradient) = gradient.as_deref_mut() {
                far.narrow.by_kernel(&kept.normalised, &self.by_narrow, gradient, Write::Replace);
            }
            far.narrow.by_input(weights, &self.by_narrow, &mut self.by_gated, Write::Add);
        }
        self.by_gain.fill(0.0);
        let gain = &weights[block.gain.clone()];
        let by_gain = &mut self.by_gain;
        rms_norm_backward(&kept.stream, gain, &kept.inverses, &self.by_gated, &mut self.by_stream, by_gain);
        if let Some(gradient) = gradient {
            gradient[block.gain.clone()].copy_from_slice(by_gain);
        }
    }
}

/// The loss of one pixel in double precision, nats, averaged over the possible measurements there (photons). `by`
/// receives `weight` times its gradient by `outputs`.
fn exact_mean(levels: &Levels, guess: (f32, f32), values: &[f32], weight: f32, outputs: &[f32], by: &mut [f32]) -> f32 {
    let share = 1.0 / values.len() as f32;
    by.fill(0.0);
    let losses = values.iter().map(|&y| {
        let logs: Vec<f64> = (0..levels.count()).map(|level| levels.log_likelihood(y, level)).collect();
        let mut exact = outputs.to_vec();
        let nats = exact_loss(&levels.photons, guess, &logs, share * weight, &mut exact).0;
        for (by, exact) in by.iter_mut().zip(exact) {
            *by += exact;
        }
        share * nats as f32
    });
    losses.sum()
}
