//! Layers of the network and the places of their weights.

use std::fmt;

use super::scale::DataScale;
use crate::information::error::InformationError;
use crate::nn::{Initial, Layer, ParameterLayout, TapRows, Taps, Winograd};
use crate::plural::counted;

/// Size of a `PixelCNN`. [`PixelCnnShape::default`] is the published one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PixelCnnShape {
    /// Channels C of the hidden layers.
    pub(super) channels: usize,
    /// Number K of Gaussians in the mixture of every pixel.
    pub(super) components: usize,
    /// Distance in px between the taps of each gated block.
    pub(super) dilations: Vec<usize>,
}

/// Largest number of channels, and of components.
const MAX_WIDTH: usize = 512;
/// Largest number of gated blocks, and the largest dilation, px.
const MAX_DEPTH: usize = 64;

impl fmt::Display for PixelCnnShape {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { channels, components, dilations } = self;
        let dilations: Vec<String> = dilations.iter().map(ToString::to_string).collect();
        let (channels, components) = (counted(*channels, "channel"), counted(*components, "component"));
        write!(formatter, "{channels}, {components}, dilations {}", dilations.join(", "))
    }
}

impl Default for PixelCnnShape {
    fn default() -> Self {
        Self { channels: 64, components: 40, dilations: vec![1, 2, 1, 4, 1, 2, 1] }
    }
}

/// The four layers of a gated block, and the taps of the two convolutions.
#[derive(Clone, Debug)]
pub(super) struct Block {
    pub horizontal_taps: Taps,
    /// Taps of the vertical layer, and its computation on the processor.
    pub tiled: Winograd,
    /// Taps C -> 2C.
    pub vertical: Layer,
    /// Taps C -> 2C.
    pub horizontal: Layer,
    /// 2C -> 2C, from the vertical to the horizontal features.
    pub link: Layer,
    /// C -> C.
    pub output: Layer,
}

/// All layers, in the order of the computation.
#[derive(Clone, Debug)]
pub(super) struct Layers {
    pub first_vertical_taps: Taps,
    pub first_horizontal_taps: Taps,
    pub first_vertical: Layer,
    pub first_horizontal: Layer,
    pub blocks: Vec<Block>,
    pub out: Layer,
    /// C -> 3K: means, widths, logits.
    pub heads: Layer,
}

impl PixelCnnShape {
    /// A network of `channels` hidden channels, `components` Gaussians per pixel and one gated block per dilation
    /// (px).
    ///
    /// # Errors
    /// For a network of size zero or of excessive size.
    pub fn new(channels: usize, components: usize, dilations: Vec<usize>) -> Result<Self, InformationError> {
        let depth = 1..=MAX_DEPTH;
        let widths = [channels, components].iter().all(|width| (1..=MAX_WIDTH).contains(width));
        if widths && depth.contains(&dilations.len()) && dilations.iter().all(|dilation| depth.contains(dilation)) {
            return Ok(Self { channels, components, dilations });
        }
        Err(InformationError::NetworkShape { channels, components, dilations })
    }

    /// Layers, and the names and initial values of their weights.
    ///
    /// Kernels hold open taps only, shape (taps, inputs, outputs). Their initial variance counts the masked taps too,
    /// as published. The initial bias of the means lies anywhere in the range of the data.
    pub(super) fn layers(&self, scale: &DataScale) -> (Layers, ParameterLayout) {
        let (channels, components) = (self.channels, self.components);
        let wide = 2 * channels;
        let mut layout = ParameterLayout::default();
        let mut layer = |name: &str, taps: (usize, usize), inputs: usize, outputs: usize| {
            let (open, all) = taps;
            let initial = Initial::LecunNormal { inputs: all * inputs };
            let shape = [open, inputs, outputs];
            let shape = if all == 1 { &shape[1..] } else { &shape };
            let kernel = layout.add(format!("{name}.kernel"), shape, initial);
            let bias = layout.add(format!("{name}.bias"), &[outputs], Initial::Zeros);
            Layer { kernel, bias, inputs: open * inputs, outputs }
        };
        let first_vertical = layer("first.vertical", (3, 9), 1, channels);
        let first_horizontal = layer("first.horizontal", (1, 3), 1, channels);
        let mut blocks = Vec::new();
        for (index, &dilation) in self.dilations.iter().enumerate() {
            blocks.push(Block {
                horizontal_taps: Taps::new([(0, -(dilation as isize)), (0, 0)]),
                tiled: Winograd { rows: TapRows::AboveAndOwn, dilation, inputs: channels, outputs: wide },
                vertical: layer(&format!("block{index}.vertical"), (6, 9), channels, wide),
                horizontal: layer(&format!("block{index}.horizontal"), (2, 3), channels, wide),
                link: layer(&format!("block{index}.link"), (1, 1), wide, wide),
                output: layer(&format!("block{index}.output"), (1, 1), channels, channels),
            });
        }
        let out = layer("out", (1, 1), channels, channels);
        let kernel = Initial::LecunNormal { inputs: channels };
        let kernel = layout.add("heads.kernel", &[channels, 3 * components], kernel);
        let means = Initial::Uniform { low: scale.min, high: scale.max };
        let parts = vec![(components, means), (2 * components, Initial::Zeros)];
        let bias = layout.add_in_parts("heads.bias", &[3 * components], parts);
        let heads = Layer { kernel, bias, inputs: channels, outputs: 3 * components };
        let layers = Layers {
            first_vertical_taps: Taps::new([(-1, -1), (-1, 0), (-1, 1)]),
            first_horizontal_taps: Taps::new([(0, -1)]),
            first_vertical,
            first_horizontal,
            blocks,
            out,
            heads,
        };
        (layers, layout)
    }
}
