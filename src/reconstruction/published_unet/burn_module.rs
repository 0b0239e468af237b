//! The published U-net as a burn module: the independent reference of our kernels, and the way to a graphics card.

use burn::module::{Module, Param};
use burn::tensor::module::{conv2d, max_pool2d};
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{Device, Tensor, TensorData, Transaction};

use super::layers::{BLOCKS, Layers, Source};
use super::passes::Example;
use crate::information::{BurnDevice, EngineChoice, guarded, open_device};
use crate::nn::{BATCH_NORM_EPSILON, ChannelSums};
use crate::reconstruction::error::ReconstructionError;

/// A 3x3 convolution, batch normalisation and rectification; [`super::layers::Block`] is its configuration.
#[derive(Module, Debug)]
struct Block {
    /// Shape (9 taps, inputs, outputs).
    kernel: Param<Tensor<3>>,
    /// Shape (outputs).
    gain: Param<Tensor<1>>,
    /// Shape (outputs).
    shift: Param<Tensor<1>>,
}

/// The network; [`Layers`] is its configuration.
#[derive(Module, Debug)]
struct Unet {
    /// In the order of the computation.
    blocks: Vec<Block>,
    /// Kernel of the 1x1 convolution, shape (inputs, 1).
    out: Param<Tensor<2>>,
    /// Shape (1).
    bias: Param<Tensor<1>>,
}

/// What a pass through a batch gives.
struct Passed {
    /// Shape (n, 1, rows, cols).
    output: Tensor<4>,
    /// Mean and variance over a batch of the channels of each block.
    moments: Vec<[Tensor<1>; 2]>,
}

/// The network on a device of burn. Every step transfers the weights to it and the gradients back.
pub(super) struct BurnPasses<'a> {
    layers: &'a Layers,
    field: (usize, usize),
    choice: EngineChoice,
    device: Device,
}

impl Block {
    /// Normalised and rectified output, shape (n, outputs, rows, cols), with mean and variance of the batch.
    fn forward(&self, input: Tensor<4>) -> (Tensor<4>, [Tensor<1>; 2]) {
        let [_, inputs, outputs] = self.kernel.val().dims();
        let kernel = self.kernel.val().reshape([3, 3, inputs, outputs]).permute([3, 2, 0, 1]);
        let convolved = conv2d(input, kernel, None, ConvOptions::new([1, 1], [1, 1], [1, 1], 1));
        let over_batch = |values: Tensor<4>| values.mean_dim(0).mean_dim(2).mean_dim(3);
        let mean = over_batch(convolved.clone());
        let centred = convolved - mean.clone();
        let variance = over_batch(centred.clone().square());
        let per_channel = |values: Tensor<1>| values.reshape([1, outputs, 1, 1]);
        let normalised = centred / (variance.clone() + BATCH_NORM_EPSILON).sqrt() * per_channel(self.gain.val())
            + per_channel(self.shift.val());
        (normalised.clamp_min(0.0), [mean, variance].map(|moment| moment.reshape([outputs])))
    }
}

impl Unet {
    fn new(layers: &Layers, weights: &[f32], device: &Device) -> Self {
        let vector = |range: &std::ops::Range<usize>| {
            Param::from_data(TensorData::new(weights[range.clone()].to_vec(), [range.len()]), device)
        };
        let block = |layer: &super::layers::Block| {
            let shape = [9, layer.convolution.inputs, layer.convolution.outputs];
            let kernel = TensorData::new(weights[layer.kernel.clone()].to_vec(), shape);
            Block {
                kernel: Param::from_data(kernel, device),
                gain: vector(&layer.norm.gain),
                shift: vector(&layer.norm.shift),
            }
        };
        let out = TensorData::new(weights[layers.out.kernel.clone()].to_vec(), [layers.out.inputs, 1]);
        Self {
            blocks: layers.blocks.iter().map(block).collect(),
            out: Param::from_data(out, device),
            bias: vector(&layers.out.bias),
        }
    }

    /// From images of shape (n, 1, rows, cols).
    fn forward(&self, layers: &Layers, images: Tensor<4>) -> Passed {
        let mut outputs: Vec<Tensor<4>> = Vec::with_capacity(BLOCKS);
        let mut moments = Vec::with_capacity(BLOCKS);
        for (block, layer) in self.blocks.iter().zip(&layers.blocks) {
            let input = match layer.source {
                Source::Image => images.clone(),
                Source::Block(of) => outputs[of].clone(),
                Source::Pooled(of) => max_pool2d(outputs[of].clone(), MaxPoolOptions::new([2, 2])),
                Source::Joined { below, skip } => {
                    let doubled = doubled(doubled(outputs[below].clone(), 2), 3);
                    Tensor::cat(vec![doubled, outputs[skip].clone()], 1)
                }
            };
            let (output, moment) = block.forward(input);
            outputs.push(output);
            moments.push(moment);
        }
        let last = outputs.swap_remove(BLOCKS - 1);
        let [inputs, _] = self.out.val().dims();
        let kernel = self.out.val().permute([1, 0]).reshape([1, inputs, 1, 1]);
        let output = conv2d(last, kernel, Some(self.bias.val()), ConvOptions::new([1, 1], [0, 0], [1, 1], 1));
        Passed { output, moments }
    }
}

/// Doubles a side by linear interpolation between pixel centres; outside the image lies its edge.
fn doubled(values: Tensor<4>, dim: usize) -> Tensor<4> {
    let mut shape = values.dims();
    let count = shape[dim];
    let part = |from: usize, to: usize| values.clone().slice_dim(dim, from..to);
    let before = Tensor::cat(vec![part(0, 1), part(0, count - 1)], dim);
    let after = Tensor::cat(vec![part(1, count), part(count - 1, count)], dim);
    let near = values.clone() * 0.75;
    let pair = vec![near.clone() + before * 0.25, near + after * 0.25];
    shape[dim] = 2 * count;
    Tensor::stack::<5>(pair, dim + 1).reshape(shape)
}

impl<'a> BurnPasses<'a> {
    /// For batches of images of shape `field`, multiples of 4 px, on a device.
    ///
    /// # Errors
    /// Where this program was built without the device, or this machine has none.
    pub(super) fn new(
        layers: &'a Layers,
        field: (usize, usize),
        device: BurnDevice,
    ) -> Result<Self, ReconstructionError> {
        let (choice, device) = (EngineChoice::Burn(device), open_device(device)?.autodiff());
        Ok(Self { layers, field, choice, device })
    }

    /// As [`super::passes::Passes::step`].
    ///
    /// # Errors
    /// Where the device fails.
    pub(super) fn step(
        &mut self,
        weights: &mut [f32],
        batch: &[Example],
        gradient: &mut [f32],
    ) -> Result<f64, ReconstructionError> {
        let (layers, (rows, cols)) = (self.layers, self.field);
        let stack = |of: fn(&Example) -> &[f32]| {
            let values: Vec<f32> = batch.iter().flat_map(|example| of(example).iter().copied()).collect();
            Tensor::<4>::from_data(TensorData::new(values, [batch.len(), 1, rows, cols]), &self.device)
        };
        let pixels = |block: usize| batch.len() * ((rows * cols) >> (2 * layers.blocks[block].level));
        Ok(guarded(self.choice, || {
            let network = Unet::new(layers, weights, &self.device);
            let Passed { output, moments } = network.forward(layers, stack(|example| &example.image));
            let loss = (output - stack(|example| &example.truth)).square().mean();
            let gradients = loss.clone().backward();
            // One transfer for all: each transfer waits for the device.
            let mut reading = Transaction::default().register(loss.inner());
            for [mean, variance] in moments {
                reading = reading.register(mean.inner()).register(variance.inner());
            }
            let mut places = Vec::new();
            let missing = || "a weight has no gradient".to_owned();
            for (block, layer) in network.blocks.iter().zip(&layers.blocks) {
                reading = reading.register(block.kernel.val().grad(&gradients).ok_or_else(missing)?);
                reading = reading.register(block.gain.val().grad(&gradients).ok_or_else(missing)?);
                reading = reading.register(block.shift.val().grad(&gradients).ok_or_else(missing)?);
                places.extend([&layer.kernel, &layer.norm.gain, &layer.norm.shift]);
            }
            reading = reading.register(network.out.val().grad(&gradients).ok_or_else(missing)?);
            reading = reading.register(network.bias.val().grad(&gradients).ok_or_else(missing)?);
            places.extend([&layers.out.kernel, &layers.out.bias]);
            let read = reading.try_execute().map_err(|error| format!("{error:?}"))?;
            let numbers = |at: usize| read[at].as_slice::<f32>().map_err(|error| format!("{error:?}"));
            for (block, layer) in layers.blocks.iter().enumerate() {
                let (mean, variance) = (numbers(1 + 2 * block)?, numbers(2 + 2 * block)?);
                let count = pixels(block) as f64;
                let first: Vec<f64> = mean.iter().map(|&mean| f64::from(mean) * count).collect();
                let squares = mean.iter().zip(variance);
                let second = squares.map(|(&mean, &of)| (f64::from(of) + f64::from(mean).powi(2)) * count).collect();
                layer.norm.of_batch(&ChannelSums { first, second }, pixels(block), weights);
            }
            for (index, place) in places.into_iter().enumerate() {
                gradient[place.clone()].copy_from_slice(numbers(1 + 2 * BLOCKS + index)?);
            }
            Ok(f64::from(numbers(0)?[0]))
        })?)
    }
}
