//! Layers of the published U-net: their places among the weights.

use std::ops::Range;

use crate::nn::{BatchNorm, Initial, Layer, ParameterLayout, TapRows, Winograd};

/// Channels at the full resolution, and at a half and a quarter of it.
const FULL: usize = 24;
const COARSE: usize = 64;
/// Blocks of the network.
pub(super) const BLOCKS: usize = 11;
/// The network passes images whose sides are multiples of this, px.
pub(super) const MULTIPLE: usize = 4;

/// What a block sees. A number is that of another block.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source {
    /// The image.
    Image,
    /// The output of a block.
    Block(usize),
    /// That output, pooled to half its sides.
    Pooled(usize),
    /// An output of half the sides, upsampled, and beside its channels those of an output of the same size.
    Joined { below: usize, skip: usize },
}

/// A 3x3 convolution without bias, batch normalisation, and a rectified linear unit.
pub(super) struct Block {
    pub(super) name: &'static str,
    pub(super) source: Source,
    /// How often the sides of the image were halved.
    pub(super) level: usize,
    pub(super) convolution: Winograd,
    /// Place of the kernel, shape (9 taps, inputs, outputs).
    pub(super) kernel: Range<usize>,
    pub(super) norm: BatchNorm,
}

/// The network from one channel to one channel: 152,497 weights, and the running statistics of its normalisations behind them.
pub(super) struct Layers {
    /// Weights and statistics.
    pub(super) layout: ParameterLayout,
    /// The weights alone, which come first.
    pub(super) trained: ParameterLayout,
    pub(super) blocks: [Block; BLOCKS],
    /// The 1x1 convolution.
    pub(super) out: Layer,
}

impl Layers {
    pub(super) fn new() -> Self {
        let plan: [(&'static str, Source, usize, (usize, usize)); BLOCKS] = [
            ("down1.0", Source::Image, 0, (1, FULL)),
            ("down1.1", Source::Block(0), 0, (FULL, FULL)),
            ("down2.0", Source::Pooled(1), 1, (FULL, COARSE)),
            ("down2.1", Source::Block(2), 1, (COARSE, COARSE)),
            ("centre.0", Source::Pooled(3), 2, (COARSE, COARSE)),
            ("up2.0", Source::Joined { below: 4, skip: 3 }, 1, (2 * COARSE, FULL)),
            ("up2.1", Source::Block(5), 1, (FULL, FULL)),
            ("up2.2", Source::Block(6), 1, (FULL, FULL)),
            ("up1.0", Source::Joined { below: 7, skip: 1 }, 0, (2 * FULL, FULL)),
            ("up1.1", Source::Block(8), 0, (FULL, FULL)),
            ("up1.2", Source::Block(9), 0, (FULL, FULL)),
        ];
        let mut layout = ParameterLayout::default();
        let mut blocks = plan.map(|(name, source, level, (inputs, outputs))| {
            let convolution = Winograd { rows: TapRows::All, dilation: 1, inputs, outputs };
            let kernel = layout.add(format!("{name}.kernel"), &[9, inputs, outputs], uniform(9 * inputs));
            let gain = layout.add(format!("{name}.gain"), &[outputs], Initial::Constant(1.0));
            let shift = layout.add(format!("{name}.shift"), &[outputs], Initial::Zeros);
            let norm = BatchNorm { gain, shift, mean: 0..0, variance: 0..0 };
            Block { name, source, level, convolution, kernel, norm }
        });
        let kernel = layout.add("out.kernel", &[FULL, 1], uniform(FULL));
        let bias = layout.add("out.bias", &[1], uniform(FULL));
        let trained = layout.clone();
        for Block { name, norm, convolution, .. } in &mut blocks {
            let shape = [convolution.outputs];
            norm.mean = layout.add(format!("{name}.running_mean"), &shape, Initial::Zeros);
            norm.variance = layout.add(format!("{name}.running_variance"), &shape, Initial::Constant(1.0));
        }
        Self { layout, trained, blocks, out: Layer { kernel, bias, inputs: FULL, outputs: 1 } }
    }
}

/// Uniform of variance 1 / (3 inputs), with which `PyTorch` begins.
fn uniform(inputs: usize) -> Initial {
    let high = 1.0 / (inputs as f32).sqrt();
    Initial::Uniform { low: -high, high }
}
