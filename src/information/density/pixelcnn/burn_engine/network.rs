//! The network as burn modules, made from the layers and weights that every engine shares.

use std::ops::Range;

use burn::module::{Module, Param};
use burn::tensor::activation::{sigmoid, tanh};
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use crate::information::density::pixelcnn::shape::{Block, Layers};
use crate::nn::{Layer, Taps};

/// Place of a gradient among all weights, and its numbers on their device.
pub(super) type PlacedGradient = (Range<usize>, Tensor<1>);

/// A matrix product with a bias; [`Layer`] is its configuration.
#[derive(Module, Debug)]
pub(super) struct Product {
    /// Shape (inputs, outputs); the inputs of a convolution are (taps, channels).
    kernel: Param<Tensor<2>>,
    /// Shape (outputs).
    bias: Param<Tensor<1>>,
}

/// A gated block; [`Block`] is its configuration.
#[derive(Module, Debug)]
pub(super) struct GatedBlock {
    /// Six taps of the vertical stack, C -> 2C.
    vertical: Product,
    /// Two taps of the horizontal stack, C -> 2C.
    horizontal: Product,
    /// From the vertical to the horizontal features, 2C -> 2C.
    link: Product,
    /// C -> C.
    output: Product,
}

/// The whole network; [`Layers`] is its configuration.
#[derive(Module, Debug)]
pub(super) struct Network {
    /// Three taps, 1 -> C.
    first_vertical: Product,
    /// One tap, 1 -> C.
    first_horizontal: Product,
    /// In the order of the computation.
    blocks: Vec<GatedBlock>,
    /// C -> C.
    out: Product,
    /// C -> 3K: means, widths, logits.
    heads: Product,
}

impl GatedBlock {
    fn new(config: &Block, weights: &[f32], device: &Device) -> Self {
        Self {
            vertical: Product::new(&config.vertical, weights, device),
            horizontal: Product::new(&config.horizontal, weights, device),
            link: Product::new(&config.link, weights, device),
            output: Product::new(&config.output, weights, device),
        }
    }
}

impl Network {
    /// The network of these layers with these weights, which are in canonical order, on `device`.
    pub fn new(layers: &Layers, weights: &[f32], device: &Device) -> Self {
        Self {
            first_vertical: Product::new(&layers.first_vertical, weights, device),
            first_horizontal: Product::new(&layers.first_horizontal, weights, device),
            blocks: layers.blocks.iter().map(|block| GatedBlock::new(block, weights, device)).collect(),
            out: Product::new(&layers.out, weights, device),
            heads: Product::new(&layers.heads, weights, device),
        }
    }

    /// Outputs, shape (pixels, 3K), for standardised patches, shape (n, rows, cols, 1).
    pub fn forward(&self, layers: &Layers, standardised: Tensor<4>) -> Tensor<2> {
        let [samples, rows, cols, _] = standardised.dims();
        let pieces = samples * pieces_of((rows, cols));
        let pixels = samples * rows * cols;
        let images = |features: Tensor<3>| {
            let channels = features.dims()[2];
            features.reshape([samples, rows, cols, channels])
        };
        let seen = |taps: &Taps, features| {
            let seen = columns(taps, features);
            let channels = seen.dims()[3];
            seen.reshape([pieces, pixels / pieces, channels])
        };
        let mut vertical = self.first_vertical.forward(seen(&layers.first_vertical_taps, standardised.clone()));
        let mut horizontal = self.first_horizontal.forward(seen(&layers.first_horizontal_taps, standardised));
        for (block, config) in self.blocks.iter().zip(&layers.blocks) {
            let by_vertical = block.vertical.forward(seen(&config.tiled.taps(), images(vertical)));
            let by_horizontal = block.horizontal.forward(seen(&config.horizontal_taps, images(horizontal.clone())));
            let features = by_horizontal + block.link.forward(by_vertical.clone());
            vertical = gate(by_vertical);
            horizontal = horizontal + block.output.forward(gate(features));
        }
        let rectified = horizontal.clone().clamp_min(0.0) + (horizontal.clamp_max(0.0).exp() - 1.0);
        self.heads.forward(self.out.forward(rectified)).flatten(0, 1)
    }

    /// Gradients by all weights as they lie on the device, each with its place in canonical order.
    pub fn gradients(&self, layers: &Layers, gradients: &Gradients) -> Result<Vec<PlacedGradient>, String> {
        let blocks = self.blocks.iter().zip(&layers.blocks).flat_map(|(block, config)| {
            [
                (&block.vertical, &config.vertical),
                (&block.horizontal, &config.horizontal),
                (&block.link, &config.link),
                (&block.output, &config.output),
            ]
        });
        let first =
            [(&self.first_vertical, &layers.first_vertical), (&self.first_horizontal, &layers.first_horizontal)];
        let last = [(&self.out, &layers.out), (&self.heads, &layers.heads)];
        let mut placed = Vec::new();
        for (product, config) in first.into_iter().chain(blocks).chain(last) {
            placed.push((config.kernel.clone(), gradient_by(&product.kernel, gradients)?));
            placed.push((config.bias.clone(), gradient_by(&product.bias, gradients)?));
        }
        Ok(placed)
    }
}

impl Product {
    fn new(config: &Layer, weights: &[f32], device: &Device) -> Self {
        let kernel = TensorData::new(weights[config.kernel.clone()].to_vec(), [config.inputs, config.outputs]);
        let bias = TensorData::new(config.bias(weights).to_vec(), [config.outputs]);
        Self { kernel: Param::from_data(kernel, device), bias: Param::from_data(bias, device) }
    }

    /// Shape (pieces, pixels, outputs) from (pieces, pixels, inputs).
    fn forward(&self, input: Tensor<3>) -> Tensor<3> {
        let (kernel, bias) = (self.kernel.val(), self.bias.val());
        let ([pieces, ..], [inputs, outputs]) = (input.dims(), kernel.dims());
        // A copy for every piece: the gradients are then first summed over the pixels of each piece.
        let kernels = kernel.unsqueeze::<3>().expand([pieces, inputs, outputs]);
        let biases = bias.unsqueeze::<3>().expand([pieces, 1, outputs]);
        input.matmul(kernels) + biases
    }
}

/// The gradient by `weights`, flat.
fn gradient_by<const D: usize>(weights: &Param<Tensor<D>>, gradients: &Gradients) -> Result<Tensor<1>, String> {
    Ok(weights.val().grad(gradients).ok_or("a weight has no gradient")?.flatten(0, D - 1))
}

/// Approximate number of pixels of a piece.
const PIECE: usize = 256;

/// Number of pieces of whole rows into which a patch of (rows, cols) pixels is cut for products.
///
/// A gradient by weights is a sum over all pixels. Graphics cards compute such a sum in a few long threads, which
/// leaves most of the card idle. As a sum of sums over pieces it took a thirteenth to a seventieth of the time of one
/// over 16,384 pixels.
fn pieces_of((rows, cols): (usize, usize)) -> usize {
    let divides = |pieces: &usize| rows.is_multiple_of(*pieces);
    (1..=rows).filter(divides).min_by_key(|pieces| (rows / pieces * cols).abs_diff(PIECE)).unwrap_or(1)
}

/// Values at the taps of every pixel of (n, rows, cols, channels), shape (n, rows, cols, taps x channels); zeros
/// outside the patch.
///
/// A convolution is this gather and a matrix product. burn's own convolution is many times slower on a processor, and
/// would compute the masked taps too.
fn columns(taps: &Taps, input: Tensor<4>) -> Tensor<4> {
    let [samples, rows, cols, channels] = input.dims();
    let reach = |offset: fn(&(isize, isize)) -> isize| {
        taps.offsets().iter().map(|tap| offset(tap).max(0).unsigned_abs()).max().unwrap_or(0)
    };
    let (up, down) = (reach(|tap| -tap.0), reach(|tap| tap.0));
    let (left, right) = (reach(|tap| -tap.1), reach(|tap| tap.1));
    let padded = with_zeros(with_zeros(input, 1, (up, down)), 2, (left, right));
    let seen = taps.offsets().iter().map(|&(down, right)| {
        let (row, col) = (up.wrapping_add_signed(down), left.wrapping_add_signed(right));
        padded.clone().slice([0..samples, row..row + rows, col..col + cols, 0..channels])
    });
    Tensor::cat(seen.collect(), 3)
}

/// Returns `input` with a number of zeros before and after it in one dimension. The gradient of burn's own padding
/// takes milliseconds.
fn with_zeros(input: Tensor<4>, dim: usize, (before, after): (usize, usize)) -> Tensor<4> {
    let zeros = |count: usize| {
        let mut shape = input.dims();
        shape[dim] = count;
        (count > 0).then(|| Tensor::zeros(shape, &input.device()))
    };
    let (before, after) = (zeros(before), zeros(after));
    Tensor::cat(before.into_iter().chain([input]).chain(after).collect(), dim)
}

/// `tanh(a) sigmoid(b)`, where a and b are the first and second half of the channels.
fn gate(features: Tensor<3>) -> Tensor<3> {
    let halves = features.chunk(2, 2);
    let [a, b] = <[Tensor<3>; 2]>::try_from(halves).unwrap_or_else(|_| unreachable!("a chunk for each half"));
    tanh(a) * sigmoid(b)
}
