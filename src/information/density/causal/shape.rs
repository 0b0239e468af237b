//! Layers of the network and the places of their weights.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::conditioning::{PRESENT_CHANNELS, WINDOW_CHANNELS};
use super::masked_conv::MaskedConv;
use crate::nn::{Initial, Layer, ParameterLayout, Rule, Taps, Tensor};

/// Rows above and columns to either side in the first window.
const WINDOW: (isize, isize) = (2, 2);

/// Channels of far places in a block.
pub(super) const FAR_CHANNELS: usize = 8;

/// Size of the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct CausalShape {
    /// Channels C of the hidden layers.
    pub(super) channels: usize,
    /// Distance in px between the taps of each residual block.
    pub(super) dilations: Vec<usize>,
}

impl Default for CausalShape {
    fn default() -> Self {
        Self { channels: 48, dilations: vec![1, 2, 4, 8, 1] }
    }
}

/// Far places that a block sees besides its taps, at the copies of the same object point.
#[derive(Clone, Debug)]
pub(super) struct Far {
    /// C -> [`FAR_CHANNELS`], no bias.
    pub narrow: Layer,
    /// Places [`FAR_CHANNELS`] -> 2C, no bias.
    pub wide: Layer,
}

/// A residual block: normalise, see five taps, gate, project.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// In every second block.
    pub far: Option<Far>,
    /// Gain of the normalisation (C).
    pub gain: Range<usize>,
    /// Taps C -> 2C.
    pub wide: MaskedConv,
    /// C -> C.
    pub out: Layer,
}

/// All layers, in the order of the computation.
#[derive(Clone, Debug)]
pub(super) struct Layers {
    pub window_taps: Taps,
    /// Window of the past -> 2C.
    pub window: Layer,
    /// Inputs at the present pixel -> 2C, added to it.
    pub present: Layer,
    pub blocks: Vec<Block>,
    pub far_taps: Taps,
    /// C -> C.
    pub last: Layer,
    /// C -> levels and, last, the weight of the linear prediction.
    pub head: Layer,
}

impl CausalShape {
    /// Layers for a number of levels and far places (offsets, px), and the names and initial values of their weights.
    pub(super) fn layers(&self, levels: usize, far: &[(isize, isize)]) -> (Layers, ParameterLayout) {
        let channels = self.channels;
        let mut layout = ParameterLayout::default();
        let mut layer = |name: &str, inputs: usize, outputs: usize, gain: f32| {
            let initial = Initial::Normal { deviation: gain / (inputs as f32).sqrt() };
            let kernel = layout.add(format!("{name}.kernel"), &[inputs, outputs], initial);
            let bias = layout.add(format!("{name}.bias"), &[outputs], Initial::Zeros);
            Layer { kernel, bias, inputs, outputs }
        };
        let window_taps = first_window();
        let window = layer("window", window_taps.count() * WINDOW_CHANNELS, 2 * channels, 1.0);
        let mut blocks = Vec::new();
        for (index, &dilation) in self.dilations.iter().enumerate() {
            let wide = layer(&format!("block{index}.wide"), MaskedConv::COUNT * channels, 2 * channels, 1.0);
            blocks.push(Block {
                wide: MaskedConv::new(dilation, wide),
                out: layer(&format!("block{index}.out"), channels, channels, 0.5),
                gain: 0..0,
                far: None,
            });
        }
        let last = layer("last", channels, channels, 1.0);
        let head = layer("head", channels, levels + 1, 0.1);
        // The window has a bias already.
        let initial = Initial::Normal { deviation: 1.0 / (PRESENT_CHANNELS as f32).sqrt() };
        let kernel = layout.add("present.kernel", &[PRESENT_CHANNELS, 2 * channels], initial);
        let present = Layer { kernel, bias: 0..0, inputs: PRESENT_CHANNELS, outputs: 2 * channels };
        let mut plain = |name: String, inputs: usize, outputs: usize| {
            let initial = Initial::Normal { deviation: 1.0 / (inputs as f32).sqrt() };
            Layer { kernel: layout.add(name, &[inputs, outputs], initial), bias: 0..0, inputs, outputs }
        };
        for (index, block) in blocks.iter_mut().enumerate().skip(1).step_by(2) {
            block.far = Some(Far {
                narrow: plain(format!("block{index}.narrow"), channels, FAR_CHANNELS),
                wide: plain(format!("block{index}.far"), far.len() * FAR_CHANNELS, 2 * channels),
            });
        }
        for (index, block) in blocks.iter_mut().enumerate() {
            block.gain = layout.add(format!("block{index}.gain"), &[channels], Initial::Constant(1.0));
        }
        (Layers { window_taps, window, present, blocks, far_taps: Taps::new(far), last, head }, layout)
    }
}

/// Muon for the matrices between the inputs and the head, Adam for the rest.
pub(super) fn rule(tensor: &Tensor) -> Rule {
    let hidden = ["window.kernel", "last.kernel"].contains(&tensor.name.as_str()) || tensor.name.starts_with("block");
    if hidden && tensor.shape.len() > 1 { Rule::Muon } else { Rule::Adam }
}

/// The pixels before the present one in raster order, two rows up and two columns to either side.
fn first_window() -> Taps {
    let (up, side) = WINDOW;
    let above = (1..=up).flat_map(|down| (-side..=side).map(move |right| (-down, right)));
    let left = (1..=side).map(|left| (0, -left));
    Taps::new(above.chain(left).collect::<Vec<_>>())
}
