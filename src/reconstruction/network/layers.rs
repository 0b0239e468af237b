//! Layers of the residual U-net: their places among the weights.

use crate::nn::{Convolution3x3, Initial, Layer, ParameterLayout, Rule, Tensor};

/// Channels at a half, a quarter and an eighth of the resolution.
const CHANNELS: [usize; 3] = [32, 64, 96];
/// Residual blocks of the stages: down at a half and a quarter, at an eighth, up at a quarter and a half.
const BLOCKS: [usize; 5] = [1, 2, 2, 1, 1];
/// Size of the second kernel of a block at the start, relative to that which keeps the variance: blocks begin near the identity.
const SMALL: f32 = 0.3;
/// Rate of tensors that Adam updates, relative to that of Muon.
const ADAM_FACTOR: f32 = 0.25;

/// A residual block: `x + second(silu(first(silu(x))))`.
pub(super) struct Block {
    pub(super) first: Convolution3x3,
    pub(super) second: Convolution3x3,
}

/// Residual U-net from images of `inputs` channels to one channel.
///
/// Images are unshuffled to a half of their resolution first, and the result is shuffled back. Its sides are multiples of 8 px.
pub(super) struct Layers {
    pub(super) layout: ParameterLayout,
    pub(super) inputs: usize,
    pub(super) stem: Convolution3x3,
    pub(super) stages: [Vec<Block>; 5],
    /// Convolutions of 2 x 2 px with a stride of 2 px.
    pub(super) down: [Layer; 2],
    /// Transposed convolutions of 2 x 2 px: to a quarter, then to a half of the resolution.
    pub(super) up: [Layer; 2],
    pub(super) out: Convolution3x3,
}

impl Layers {
    pub(super) fn new(inputs: usize) -> Self {
        let mut layout = ParameterLayout::default();
        let stem = Convolution3x3::add(&mut layout, "stem", (4 * inputs, CHANNELS[0]), uniform(9 * 4 * inputs));
        let stage = |layout: &mut ParameterLayout, index: usize| -> Vec<Block> {
            let channels = Self::channels(index);
            let block = |block: usize| {
                let name = |part: &str| format!("stage{index}.block{block}.{part}");
                let small = Initial::Normal { deviation: SMALL / (9.0 * channels as f32).sqrt() };
                Block {
                    first: Convolution3x3::add(layout, &name("first"), (channels, channels), uniform(9 * channels)),
                    second: Convolution3x3::add(layout, &name("second"), (channels, channels), small),
                }
            };
            (0..BLOCKS[index]).map(block).collect()
        };
        let [a, b, c] = CHANNELS;
        let stage0 = stage(&mut layout, 0);
        let down0 = dense(&mut layout, "down0", (4 * a, b));
        let stage1 = stage(&mut layout, 1);
        let down1 = dense(&mut layout, "down1", (4 * b, c));
        let stage2 = stage(&mut layout, 2);
        let up0 = dense(&mut layout, "up0", (c, 4 * b));
        let stage3 = stage(&mut layout, 3);
        let up1 = dense(&mut layout, "up1", (b, 4 * a));
        let stage4 = stage(&mut layout, 4);
        let out = Convolution3x3::add(&mut layout, "out", (a, 4), Initial::Zeros);
        let stages = [stage0, stage1, stage2, stage3, stage4];
        Self { layout, inputs, stem, stages, down: [down0, down1], up: [up0, up1], out }
    }

    /// Channels of a stage.
    pub(super) fn channels(stage: usize) -> usize {
        CHANNELS[Self::level(stage)]
    }

    /// Level of a stage: 0 at a half, 1 at a quarter, 2 at an eighth of the resolution.
    pub(super) fn level(stage: usize) -> usize {
        stage.min(4 - stage)
    }

    /// Muon for the kernels within the network; Adam for the first and the last one and for all biases.
    pub(super) fn rule(tensor: &Tensor) -> Rule {
        let is_within = !tensor.name.starts_with("stem") && !tensor.name.starts_with("out");
        if is_within && tensor.shape.len() > 1 { Rule::Muon } else { Rule::Columns(vec![ADAM_FACTOR]) }
    }

    /// All 3x3 convolutions, in the order of [`super::unet::Ready`].
    pub(super) fn convolutions(&self) -> impl Iterator<Item = &Convolution3x3> {
        let blocks = self.stages.iter().flatten().flat_map(|block| [&block.first, &block.second]);
        std::iter::once(&self.stem).chain(blocks).chain(std::iter::once(&self.out))
    }
}

/// Uniform of variance 1 / (3 inputs).
fn uniform(inputs: usize) -> Initial {
    let high = 1.0 / (inputs as f32).sqrt();
    Initial::Uniform { low: -high, high }
}

fn dense(layout: &mut ParameterLayout, name: &str, (inputs, outputs): (usize, usize)) -> Layer {
    let kernel = layout.add(format!("{name}.kernel"), &[inputs, outputs], uniform(inputs));
    let bias = layout.add(format!("{name}.bias"), &[outputs], Initial::Zeros);
    Layer { kernel, bias, inputs, outputs }
}
