//! Forward and backward pass of the layers of one unrolled step.

use super::features::{Moves, carry, interleave, separate};
use super::layers::{HIDDEN, INPUTS, OUTPUTS, StepLayers, Windows};
use crate::nn::{
    PaddedImages, column_sums, silu, silu_backward, silu_plus, transposed_kernel, window_product,
    window_product_by_kernel,
};

/// Values of the layers of one step that the backward pass needs; (positions, channels).
#[derive(Clone, Debug)]
pub(super) struct Activations {
    /// Hidden channels and features.
    pub inputs: Vec<f32>,
    looked: Vec<f32>,
    windowed: Vec<f32>,
}

impl Activations {
    pub fn new(sites: PaddedImages) -> Self {
        let positions = sites.positions();
        Self {
            inputs: vec![0.0; positions * INPUTS],
            looked: vec![0.0; positions * HIDDEN],
            windowed: vec![0.0; positions * HIDDEN],
        }
    }
}

/// Memory of the layers, overwritten in every step.
#[derive(Clone, Debug)]
pub(super) struct LayerScratch {
    first: Vec<f32>,
    second: Vec<f32>,
    /// Outputs of a step, or the gradient by them.
    pub outputs: Vec<f32>,
    /// Gradient by the inputs of a step.
    pub by_inputs: Vec<f32>,
    by_first: Vec<f32>,
    by_second: Vec<f32>,
    kernel: Vec<f32>,
    transposed: Vec<f32>,
    by_kernel: Vec<f32>,
}

impl LayerScratch {
    pub fn new(sites: PaddedImages) -> Self {
        let per_position = |count: usize| vec![0.0; sites.positions() * count];
        Self {
            first: per_position(HIDDEN),
            second: per_position(HIDDEN),
            outputs: per_position(OUTPUTS),
            by_inputs: per_position(INPUTS),
            by_first: per_position(HIDDEN),
            by_second: per_position(HIDDEN),
            kernel: vec![0.0; HIDDEN * OUTPUTS],
            transposed: vec![0.0; 9 * HIDDEN * HIDDEN],
            by_kernel: vec![0.0; HIDDEN * OUTPUTS],
        }
    }
}

/// The layers of one step on the grid of sites.
#[derive(Clone, Copy)]
pub(super) struct Layers<'a> {
    pub sites: PaddedImages,
    pub windows: &'a Windows,
    pub step: &'a StepLayers,
    pub weights: &'a [f32],
}

impl Layers<'_> {
    /// Kernel from channels to outputs: hidden channels, level, gate, padding.
    fn out_kernel(&self, kernel: &mut [f32]) {
        let hidden = self.weights[self.step.hidden.clone()].chunks_exact(HIDDEN);
        let heads = self.weights[self.step.heads.0.clone()].chunks_exact(2);
        for (row, (hidden, heads)) in kernel.chunks_exact_mut(OUTPUTS).zip(hidden.zip(heads)) {
            row[..HIDDEN].copy_from_slice(hidden);
            row[HIDDEN..HIDDEN + 2].copy_from_slice(heads);
        }
    }

    /// Activations of the window layer and their sum with its input, in `first` and `second` of the scratch.
    fn activate(&self, kept: &Activations, scratch: &mut LayerScratch) {
        let covered = self.sites.covered();
        let range = covered.start * HIDDEN..covered.end * HIDDEN;
        let (first, second) = (&scratch.first[range.clone()], &mut scratch.second[range.clone()]);
        silu_plus(&kept.windowed[range], first, second);
    }

    /// The input of the window layer in `first` of the scratch, zero outside the grid.
    fn look(&self, kept: &Activations, scratch: &mut LayerScratch) {
        let covered = self.sites.covered();
        let range = covered.start * HIDDEN..covered.end * HIDDEN;
        silu(&kept.looked[range.clone()], &mut scratch.first[range]);
        self.sites.clear_borders(HIDDEN, &mut scratch.first);
    }

    /// Computes the updates and, in `next_inputs`, the next hidden channels. Inputs are `features` (one array after
    /// the other) and the hidden channels in `kept.inputs`.
    pub fn forward(
        &self,
        features: &[f32],
        kept: &mut Activations,
        moves: &mut Moves,
        next_inputs: Option<&mut [f32]>,
        scratch: &mut LayerScratch,
    ) {
        let (windows, weights, cols) = (self.windows, self.weights, self.sites.cols);
        let count = moves.level.len();
        let inputs = kept.inputs.as_chunks_mut::<INPUTS>().0;
        for (row, start) in self.sites.row_starts().enumerate() {
            interleave(features, count, row * cols, &mut inputs[start..start + cols]);
        }
        let (kernel, bias) = &self.step.look;
        let bias = Some(&weights[bias.clone()]);
        window_product(&windows.look, &kept.inputs, &weights[kernel.clone()], bias, &mut kept.looked);
        self.look(kept, scratch);
        let (kernel, bias) = &self.step.window;
        let bias = Some(&weights[bias.clone()]);
        window_product(&windows.window, &scratch.first, &weights[kernel.clone()], bias, &mut kept.windowed);
        self.activate(kept, scratch);
        let mut bias = [0.0; OUTPUTS];
        bias[HIDDEN..HIDDEN + 2].copy_from_slice(&weights[self.step.heads.1.clone()]);
        self.out_kernel(&mut scratch.kernel);
        window_product(&windows.out, &scratch.second, &scratch.kernel, Some(&bias), &mut scratch.outputs);

        let outputs = scratch.outputs.as_chunks::<OUTPUTS>().0;
        for (row, start) in self.sites.row_starts().enumerate() {
            let levels = moves.level[row * cols..].iter_mut().zip(&mut moves.gate[row * cols..]);
            for ((level, gate), output) in levels.zip(&outputs[start..start + cols]) {
                (*level, *gate) = (output[HIDDEN], output[HIDDEN + 1]);
            }
        }
        if let Some(next) = next_inputs {
            let covered = self.sites.covered();
            let inputs = &kept.inputs.as_chunks::<INPUTS>().0[covered.clone()];
            carry(inputs, &outputs[covered.clone()], &mut next.as_chunks_mut::<INPUTS>().0[covered]);
        }
    }

    /// Adds the gradient by the weights to `gradient` and writes those by features and, in the scratch, by the
    /// inputs. On entry the scratch holds the gradient by the next inputs, which is zero for the last step and on
    /// borders.
    pub fn backward(
        &self,
        kept: &Activations,
        by_level: &[f32],
        by_gate: &[f32],
        gradient: &mut [f32],
        by_features: &mut [f32],
        scratch: &mut LayerScratch,
    ) {
        let (windows, weights, cols) = (self.windows, self.weights, self.sites.cols);
        // The hidden channels are also passed on unchanged.
        let outputs = scratch.outputs.as_chunks_mut::<OUTPUTS>().0;
        for (output, input) in outputs.iter_mut().zip(scratch.by_inputs.as_chunks::<INPUTS>().0) {
            output[..HIDDEN].copy_from_slice(&input[..HIDDEN]);
            output[HIDDEN..].fill(0.0);
        }
        for (row, start) in self.sites.row_starts().enumerate() {
            let moves = by_level[row * cols..].iter().zip(&by_gate[row * cols..]);
            for ((level, gate), output) in moves.zip(&mut outputs[start..start + cols]) {
                (output[HIDDEN], output[HIDDEN + 1]) = (*level, *gate);
            }
        }

        self.look(kept, scratch);
        self.activate(kept, scratch);
        self.out_backward(gradient, scratch);
        let covered = self.sites.covered();
        let range = covered.start * HIDDEN..covered.end * HIDDEN;
        scratch.by_first[range.clone()].copy_from_slice(&scratch.by_second[range.clone()]);
        silu_backward(&kept.windowed[range.clone()], &mut scratch.by_second[range.clone()]);

        let (kernel, bias) = &self.step.window;
        window_product_by_kernel(&windows.window, &scratch.first, &scratch.by_second, &mut gradient[kernel.clone()]);
        column_sums(&scratch.by_second[range.clone()], &mut gradient[bias.clone()]);
        transposed_kernel(&weights[kernel.clone()], (HIDDEN, HIDDEN), &mut scratch.transposed);
        window_product(&windows.window, &scratch.by_second, &scratch.transposed, None, &mut scratch.by_first);
        silu_backward(&kept.looked[range.clone()], &mut scratch.by_first[range.clone()]);
        self.sites.clear_borders(HIDDEN, &mut scratch.by_first);

        let (kernel, bias) = &self.step.look;
        window_product_by_kernel(&windows.look, &kept.inputs, &scratch.by_first, &mut gradient[kernel.clone()]);
        column_sums(&scratch.by_first[range], &mut gradient[bias.clone()]);
        let transposed = &mut scratch.transposed[..INPUTS * HIDDEN];
        transposed_kernel(&weights[kernel.clone()], (INPUTS, HIDDEN), transposed);
        window_product(&windows.look_back, &scratch.by_first, transposed, None, &mut scratch.by_inputs);

        let count = by_level.len();
        let inputs = scratch.by_inputs.as_chunks_mut::<INPUTS>().0;
        for (row, start) in self.sites.row_starts().enumerate() {
            separate(&inputs[start..start + cols], count, row * cols, by_features);
        }
        for input in inputs {
            input[HIDDEN..].fill(0.0);
        }
    }

    /// The backward pass of the last layer: from `outputs` to `by_second`.
    fn out_backward(&self, gradient: &mut [f32], scratch: &mut LayerScratch) {
        let LayerScratch { second, outputs, by_second, kernel, transposed, by_kernel, .. } = scratch;
        by_kernel.fill(0.0);
        window_product_by_kernel(&self.windows.out, second, outputs, by_kernel);
        let hidden = self.step.hidden.clone().step_by(HIDDEN);
        let heads = self.step.heads.0.clone().step_by(2);
        for (row, (hidden, head)) in by_kernel.chunks_exact(OUTPUTS).zip(hidden.zip(heads)) {
            for (sum, value) in gradient[hidden..hidden + HIDDEN].iter_mut().zip(row) {
                *sum += value;
            }
            gradient[head] += row[HIDDEN];
            gradient[head + 1] += row[HIDDEN + 1];
        }
        let mut by_bias = [0.0; OUTPUTS];
        column_sums(outputs, &mut by_bias);
        let bias = self.step.heads.1.start;
        gradient[bias] += by_bias[HIDDEN];
        gradient[bias + 1] += by_bias[HIDDEN + 1];
        self.out_kernel(kernel);
        let transposed = &mut transposed[..HIDDEN * OUTPUTS];
        transposed_kernel(kernel, (HIDDEN, OUTPUTS), transposed);
        let covered = self.sites.covered();
        by_second[covered.start * HIDDEN..covered.end * HIDDEN].fill(0.0);
        window_product(&self.windows.out_back, outputs, transposed, None, by_second);
    }
}
