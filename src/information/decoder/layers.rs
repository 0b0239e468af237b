//! Layers of the decoder and the places of their weights.

use std::ops::Range;

use crate::information::error::InformationError;
use crate::nn::{Initial, PaddedImages, ParameterLayout, Window};

/// Channels that a site carries from step to step; below, the number of its features in every step.
pub(in crate::information) const HIDDEN: usize = 16;
pub(in crate::information) const FEATURES: usize = 8;
/// Inputs of a step per site.
pub(in crate::information) const INPUTS: usize = HIDDEN + FEATURES;
/// Outputs of a step per site: changes of the hidden channels, two updates of the logit, and padding.
pub(in crate::information) const OUTPUTS: usize = HIDDEN + 8;
/// Largest number of unrolled steps.
const MAX_STEPS: usize = 32;

/// Places of the weights of one unrolled step.
#[derive(Clone, Debug)]
pub(in crate::information) struct StepLayers {
    /// From hidden channels and features to channels, (inputs, channels).
    pub look: (Range<usize>, Range<usize>),
    /// 3x3 window over channels, (taps, channels, channels).
    pub window: (Range<usize>, Range<usize>),
    /// From channels to changes of the hidden channels, (channels, channels).
    pub hidden: Range<usize>,
    /// From channels to level and gate of the logit, (channels, 2).
    pub heads: (Range<usize>, Range<usize>),
}

/// A trained decoder. Its weights belong to no channel: a decoder fitted to one design is a good start for the next.
#[derive(Clone, Debug)]
pub struct Decoder {
    pub(in crate::information) steps: Vec<StepLayers>,
    pub(in crate::information) layout: ParameterLayout,
    pub(in crate::information) weights: Vec<f32>,
}

impl Decoder {
    /// Unrolled steps of the pretrained decoder, which serves immediate bounds and runs.
    pub const UNROLLED: usize = 6;
    /// Unrolled steps of the decoder that brackets start from. Its bound is tighter and takes longer for each
    /// problem.
    pub const DEEP: usize = 8;

    /// A decoder of `steps` unrolled steps with random weights.
    ///
    /// # Errors
    /// For no steps, or more than 32.
    pub fn new(steps: usize, seed: u64) -> Result<Self, InformationError> {
        if !(1..=MAX_STEPS).contains(&steps) {
            return Err(InformationError::DecoderFit { expected: "1 to 32 unrolled steps", found: steps.to_string() });
        }
        let mut layout = ParameterLayout::default();
        let uniform = |deviation: f32| {
            let high = deviation * 3.0_f32.sqrt();
            Initial::Uniform { low: -high, high }
        };
        let steps = (0..steps).map(|step| {
            let mut tensor = |name: &str, shape: &[usize], initial| layout.add(name, shape, initial);
            let name = |part: &str| format!("block{step}.{part}");
            StepLayers {
                look: (
                    tensor(&name("look.kernel"), &[INPUTS, HIDDEN], Initial::LecunNormal { inputs: INPUTS }),
                    tensor(&name("look.bias"), &[HIDDEN], Initial::Zeros),
                ),
                window: (
                    tensor(&name("window.kernel"), &[9, HIDDEN, HIDDEN], Initial::LecunNormal { inputs: 9 * HIDDEN }),
                    tensor(&name("window.bias"), &[HIDDEN], Initial::Zeros),
                ),
                hidden: tensor(&name("hidden.kernel"), &[HIDDEN, HIDDEN], uniform(0.3 / (HIDDEN as f32).sqrt())),
                heads: (
                    tensor(&format!("heads{step}.kernel"), &[HIDDEN, 2], uniform(0.05)),
                    tensor(&format!("heads{step}.bias"), &[2], Initial::Zeros),
                ),
            }
        });
        let steps = steps.collect();
        let weights = layout.draw(seed);
        Ok(Self { steps, layout, weights })
    }

    /// This decoder with more unrolled steps, `steps` in all: the last but one is repeated. Without a fit its bound
    /// is looser; a short fit tightens it.
    ///
    /// # Errors
    /// For fewer steps than there are, or more than 32.
    pub fn deepened(&self, steps: usize) -> Result<Self, InformationError> {
        let (unrolled, last) = (self.unrolled(), self.unrolled() - 1);
        if steps < unrolled {
            let (expected, found) = ("at least the unrolled steps that are there", format!("{steps} of {unrolled}"));
            return Err(InformationError::DecoderFit { expected, found });
        }
        let deeper = Self::new(steps, 0)?;
        let one = self.weights.len() / unrolled;
        let taken = |step: usize| if step + 1 == steps { last } else { step.min(last.saturating_sub(1)) };
        let weights = (0..steps).flat_map(|step| &self.weights[taken(step) * one..][..one]).copied().collect();
        Ok(Self { weights, ..deeper })
    }

    /// Number of unrolled steps.
    pub fn unrolled(&self) -> usize {
        self.steps.len()
    }

    /// All weights, in the order of [`Decoder::layout`].
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Names and shapes of the weights.
    pub fn layout(&self) -> &ParameterLayout {
        &self.layout
    }
}

/// The windows of the layers on one grid of sites, forwards and backwards.
#[derive(Clone, Debug)]
pub(in crate::information) struct Windows {
    pub look: Window,
    pub look_back: Window,
    pub window: Window,
    pub out: Window,
    pub out_back: Window,
}

impl Windows {
    pub fn new(sites: PaddedImages) -> Self {
        let window = |offsets: Vec<isize>, inputs: usize, outputs: usize| Window {
            offsets,
            range: sites.covered(),
            inputs,
            outputs,
        };
        Self {
            look: window(vec![0], INPUTS, HIDDEN),
            look_back: window(vec![0], HIDDEN, INPUTS),
            window: window(sites.window().to_vec(), HIDDEN, HIDDEN),
            out: window(vec![0], HIDDEN, OUTPUTS),
            out_back: window(vec![0], OUTPUTS, HIDDEN),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deeper_decoder_takes_the_last_step_but_one_again() {
        let decoder = Decoder::new(3, 8).unwrap();
        let deeper = decoder.deepened(5).unwrap();
        for (step, taken) in [(0, 0), (1, 1), (2, 1), (3, 1), (4, 2)] {
            let (new, old) = (&deeper.steps[step], &decoder.steps[taken]);
            let pairs = [(&new.look.0, &old.look.0), (&new.window.0, &old.window.0), (&new.heads.0, &old.heads.0)];
            for (new, old) in pairs.into_iter().chain([(&new.hidden, &old.hidden)]) {
                assert_eq!(deeper.weights[new.clone()], decoder.weights[old.clone()], "step {step}");
            }
        }
        assert_eq!(decoder.deepened(3).unwrap().weights, decoder.weights);
        assert!(decoder.deepened(2).unwrap_err().to_string().contains("2 of 3"));
        assert_eq!(Decoder::new(1, 8).unwrap().deepened(3).unwrap().unrolled(), 3);
    }
}
