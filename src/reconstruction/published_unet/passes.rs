//! Passes of the published U-net: through a batch, whose statistics normalise it, and through one image by running statistics.

use rayon::prelude::*;

use super::layers::{BLOCKS, Layers, Source};
use crate::nn::{
    ChannelSums, Grid, NormRelu, Pool, TileMemory, Write, concatenate, max_pool, max_pool_backward, moment_sums,
    ordered_sum, part_range, split_channels, upsample, upsample_backward,
};
use crate::progress::CancelToken;

/// Parts that a batch is split into, whatever the number of threads.
const PARTS: usize = 16;

/// Outputs of the convolutions for one image, before normalisation.
struct Convolved(Vec<Vec<f32>>);

/// Memory of one thread.
#[derive(Default)]
struct Scratch {
    /// Input of a block, or the gradient by it.
    input: Vec<f32>,
    by_input: Vec<f32>,
    /// Normalised outputs of blocks.
    output: Vec<f32>,
    other: Vec<f32>,
    tiles: TileMemory,
}

/// The network with its memory for batches of images of one size.
pub(super) struct Passes<'a> {
    layers: &'a Layers,
    field: (usize, usize),
    samples: Vec<Sample>,
    scratch: Pool<Scratch>,
}

/// Memory of one image of a batch.
struct Sample {
    convolved: Convolved,
    /// Gradients by the outputs of blocks.
    gradients: Vec<Vec<f32>>,
    /// Output of the network.
    result: Vec<f32>,
}

/// An image to learn from.
#[derive(Clone, Debug)]
pub(super) struct Example {
    /// Padded measurement, row by row.
    pub(super) image: Vec<f32>,
    /// Object, row by row, in units of the peak.
    pub(super) truth: Vec<f32>,
}

/// What one thread computes of a block.
struct Part {
    sums: Vec<ChannelSums>,
    gradient: Vec<f32>,
    error: f64,
}

/// Kernels in the form that the convolutions take.
struct Kernels(Vec<Vec<f32>>);

impl Kernels {
    fn new(layers: &Layers, weights: &[f32]) -> Self {
        let transformed =
            layers.blocks.par_iter().map(|block| block.convolution.transformed(&weights[block.kernel.clone()]));
        Self(transformed.collect())
    }
}

impl Convolved {
    fn new(layers: &Layers, (rows, cols): (usize, usize)) -> Self {
        let output =
            |block: &super::layers::Block| vec![0.0; ((rows * cols) >> (2 * block.level)) * block.convolution.outputs];
        Self(layers.blocks.iter().map(output).collect())
    }
}

/// Geometry of the blocks.
#[derive(Clone, Copy)]
struct Geometry<'a> {
    layers: &'a Layers,
    field: (usize, usize),
}

impl Geometry<'_> {
    fn grid(self, block: usize) -> Grid {
        let level = self.layers.blocks[block].level;
        Grid { samples: 1, rows: self.field.0 >> level, cols: self.field.1 >> level }
    }

    fn channels(self, block: usize) -> usize {
        self.layers.blocks[block].convolution.outputs
    }

    /// Writes the input of a block, from the image and the convolved outputs of the blocks before, to `scratch.input`.
    fn input(self, block: usize, image: &[f32], convolved: &Convolved, norms: &[NormRelu], scratch: &mut Scratch) {
        let Scratch { input, output, other, .. } = scratch;
        let pixels = self.grid(block).pixels();
        input.resize(pixels * self.layers.blocks[block].convolution.inputs, 0.0);
        let normalised = |of: usize, out: &mut Vec<f32>| {
            out.resize(convolved.0[of].len(), 0.0);
            norms[of].forward(&convolved.0[of], out);
        };
        match self.layers.blocks[block].source {
            Source::Image => input.copy_from_slice(image),
            Source::Block(of) => normalised(of, input),
            Source::Pooled(of) => {
                normalised(of, output);
                max_pool(output, self.grid(of).cols, self.channels(of), input);
            }
            Source::Joined { below, skip } => {
                normalised(below, output);
                other.resize(pixels * self.channels(below), 0.0);
                upsample(output, self.grid(below).cols, self.channels(below), other);
                normalised(skip, output);
                concatenate(other, self.channels(below), output, input);
            }
        }
    }

    /// Convolves the input of a block.
    fn convolve(self, block: usize, kernels: &Kernels, convolved: &mut Convolved, scratch: &mut Scratch) {
        let layer = self.layers.blocks[block].convolution;
        let no_bias = vec![0.0; layer.outputs];
        let out = &mut convolved.0[block];
        layer.forward(self.grid(block), (&kernels.0[block], &no_bias), &scratch.input, out, &mut scratch.tiles);
    }

    /// Passes the gradient by the input of a block on to the outputs that it was made of.
    fn pass_back(self, block: usize, sample: &mut Sample, norms: &[NormRelu], scratch: &mut Scratch) {
        let Scratch { by_input, output, other, .. } = scratch;
        match self.layers.blocks[block].source {
            Source::Image => {}
            Source::Block(of) => sample.gradients[of].copy_from_slice(by_input),
            Source::Pooled(of) => {
                output.resize(sample.convolved.0[of].len(), 0.0);
                norms[of].forward(&sample.convolved.0[of], output);
                let to = &mut sample.gradients[of];
                max_pool_backward(output, self.grid(of).cols, self.channels(of), by_input, to);
            }
            Source::Joined { below, skip } => {
                other.resize(self.grid(block).pixels() * self.channels(below), 0.0);
                split_channels(by_input, other, self.channels(below), &mut sample.gradients[skip]);
                let to = &mut sample.gradients[below];
                upsample_backward(other, self.grid(below).cols, self.channels(below), to);
            }
        }
    }
}

impl<'a> Passes<'a> {
    /// Memory for batches of images of shape `field`, multiples of 4 px.
    pub(super) fn new(layers: &'a Layers, field: (usize, usize)) -> Self {
        Self { layers, field, samples: Vec::new(), scratch: Pool::default() }
    }

    /// Bytes for each image of a batch.
    pub(super) fn bytes_per_image(layers: &Layers, (rows, cols): (usize, usize)) -> f64 {
        let numbers = layers.blocks.iter().map(|block| (rows * cols * block.convolution.outputs) >> (2 * block.level));
        2.0 * 4.0 * numbers.sum::<usize>() as f64
    }

    /// Mean squared error of a batch, and its gradient by the weights, written to `gradient`. Moves the running statistics among
    /// `weights` towards those of the batch. `None` where it was cancelled, within a block; the gradient is then incomplete.
    pub(super) fn step(
        &mut self,
        weights: &mut [f32],
        batch: &[Example],
        gradient: &mut [f32],
        cancel: &CancelToken,
    ) -> Option<f64> {
        let kernels = Kernels::new(self.layers, weights);
        while self.samples.len() < batch.len() {
            let convolved = Convolved::new(self.layers, self.field);
            let gradients = convolved.0.clone();
            self.samples.push(Sample { convolved, gradients, result: vec![0.0; self.field.0 * self.field.1] });
        }
        let layers = self.layers;
        let geometry = Geometry { layers, field: self.field };
        let pixels = |block: usize| batch.len() * geometry.grid(block).pixels();
        let mut norms: Vec<NormRelu> = Vec::new();
        for (block, layer) in layers.blocks.iter().enumerate() {
            if cancel.is_cancelled() {
                return None;
            }
            let parts = self.each_sample(batch, 0, |example, sample, scratch, _| {
                geometry.input(block, &example.image, &sample.convolved, &norms, scratch);
                geometry.convolve(block, &kernels, &mut sample.convolved, scratch);
                (moment_sums(&sample.convolved.0[block], layer.convolution.outputs), 0.0)
            });
            norms.push(layer.norm.of_batch(&sum_of(&parts, layer.convolution.outputs), pixels(block), weights));
        }
        let last = BLOCKS - 1;
        let out = &layers.out;
        let factor = 2.0 / (batch.len() * self.field.0 * self.field.1) as f32;
        let mut parts = self.each_sample(batch, out.bias.end, |example, sample, scratch, gradient| {
            let Sample { convolved, gradients, result } = sample;
            scratch.output.resize(convolved.0[last].len(), 0.0);
            norms[last].forward(&convolved.0[last], &mut scratch.output);
            out.forward(weights, &scratch.output, result);
            let mut error = 0.0;
            scratch.by_input.clear();
            for (value, truth) in result.iter().zip(&example.truth) {
                let missing = value - truth;
                error += f64::from(missing) * f64::from(missing);
                scratch.by_input.push(factor * missing);
            }
            out.by_weights(&scratch.output, &scratch.by_input, gradient, Write::Add);
            out.by_input(weights, &scratch.by_input, &mut gradients[last], Write::Replace);
            (norms[last].gradient_sums(&convolved.0[last], &gradients[last]), error)
        });
        let of_out: Vec<&[f32]> = parts.iter().map(|part| &part.gradient[out.kernel.start..]).collect();
        ordered_sum(&of_out, &mut gradient[out.kernel.start..out.bias.end]);
        let loss = parts.iter().map(|part| part.error).sum::<f64>() * 0.5 * f64::from(factor);
        for (block, layer) in layers.blocks.iter().enumerate().rev() {
            if cancel.is_cancelled() {
                return None;
            }
            let sums = sum_of(&parts, layer.convolution.outputs);
            layer.norm.by_weights(&norms[block], &sums, gradient);
            parts = self.each_sample(batch, layer.kernel.len(), |example, sample, scratch, gradient| {
                geometry.input(block, &example.image, &sample.convolved, &norms, scratch);
                let Sample { convolved, gradients, .. } = &mut *sample;
                norms[block].backward(&sums, pixels(block), &convolved.0[block], &mut gradients[block]);
                let Scratch { input, by_input, tiles, .. } = &mut *scratch;
                by_input.resize(input.len(), 0.0);
                let (kernel, pair) = (&kernels.0[block], (input.as_slice(), gradients[block].as_slice()));
                let into = Some((gradient, Write::Add));
                layer.convolution.backward(geometry.grid(block), kernel, pair, into, by_input, tiles);
                geometry.pass_back(block, sample, &norms, scratch);
                let Some(before) = block.checked_sub(1) else { return (ChannelSums::new(0), 0.0) };
                (norms[before].gradient_sums(&sample.convolved.0[before], &sample.gradients[before]), 0.0)
            });
            let of_kernel: Vec<&[f32]> = parts.iter().map(|part| part.gradient.as_slice()).collect();
            ordered_sum(&of_kernel, &mut gradient[layer.kernel.clone()]);
        }
        Some(loss)
    }

    /// The output of the network in the last step for each image of its batch, row by row.
    #[cfg(test)]
    pub(super) fn results(&self) -> impl Iterator<Item = &[f32]> {
        self.samples.iter().map(|sample| sample.result.as_slice())
    }

    /// Calls `work` for each image of a batch, with a gradient of `numbers` that the images of a part share.
    fn each_sample(
        &mut self,
        batch: &[Example],
        numbers: usize,
        work: impl Fn(&Example, &mut Sample, &mut Scratch, &mut [f32]) -> (ChannelSums, f64) + Sync,
    ) -> Vec<Part> {
        let parts = PARTS.min(batch.len());
        let mut rest = self.samples.as_mut_slice();
        let mut split = Vec::new();
        for part in 0..parts {
            let range = part_range(batch.len(), parts, part);
            let (own, others) = rest.split_at_mut(range.len());
            split.push((&batch[range], own));
            rest = others;
        }
        let pool = &self.scratch;
        let of_part = |(batch, samples): (&[Example], &mut [Sample])| {
            let mut part = Part { sums: Vec::new(), gradient: vec![0.0; numbers], error: 0.0 };
            pool.with(
                |_| true,
                Scratch::default,
                |scratch| {
                    for (example, sample) in batch.iter().zip(samples) {
                        let (sums, error) = work(example, sample, scratch, &mut part.gradient);
                        part.sums.push(sums);
                        part.error += error;
                    }
                },
            );
            part
        };
        split.into_par_iter().with_max_len(1).map(of_part).collect()
    }
}

/// The sums over all images of a batch, in their order.
fn sum_of(parts: &[Part], channels: usize) -> ChannelSums {
    let mut sum = ChannelSums::new(channels);
    parts.iter().flat_map(|part| &part.sums).for_each(|part| sum.add(part));
    sum
}

/// The network with running statistics: each image alone.
pub(super) struct Evaluation<'a> {
    layers: &'a Layers,
    weights: &'a [f32],
    kernels: Kernels,
    norms: Vec<NormRelu>,
    field: (usize, usize),
    memory: Pool<(Convolved, Scratch)>,
}

impl<'a> Evaluation<'a> {
    /// For images of shape `field`, multiples of 4 px.
    pub(super) fn new(layers: &'a Layers, weights: &'a [f32], field: (usize, usize)) -> Self {
        let norms = layers.blocks.iter().map(|block| block.norm.of_running(weights)).collect();
        Self { layers, weights, kernels: Kernels::new(layers, weights), norms, field, memory: Pool::default() }
    }

    /// The output for an image, row by row.
    pub(super) fn result(&self, image: &[f32]) -> Vec<f32> {
        let geometry = Geometry { layers: self.layers, field: self.field };
        let make = || (Convolved::new(self.layers, self.field), Scratch::default());
        self.memory.with(
            |_| true,
            make,
            |(convolved, scratch)| {
                for block in 0..BLOCKS {
                    geometry.input(block, image, convolved, &self.norms, scratch);
                    geometry.convolve(block, &self.kernels, convolved, scratch);
                }
                let (last, Scratch { output, .. }) = (&convolved.0[BLOCKS - 1], scratch);
                output.resize(last.len(), 0.0);
                self.norms[BLOCKS - 1].forward(last, output);
                let mut result = vec![0.0; image.len()];
                self.layers.out.forward(self.weights, output, &mut result);
                result
            },
        )
    }
}
