//! Position gradients of the lenslets of a design, with a significance test.

use std::time::{Duration, Instant};

use crate::design::{GradientDraw, IdealError};
use crate::forward::ForwardModel;
use crate::information::{CausalModel, Decoder};
use crate::objects::Split;
use crate::optics::{LensletArray, LensletGradient};
use crate::progress::CancelToken;
use crate::seeds::SeedStream;

/// Fresh scenes per block, and the pixels of a measurement above which a block has fewer. The differences between blocks estimate the
/// sampling error.
const SCENES: f64 = 8.0;
const PIXELS: f64 = 65.0 * 65.0;
/// Fewest blocks for that estimate, and most; more blocks would only delay each other.
const BLOCKS: usize = 8;
const MOST_BLOCKS: usize = 2048;
/// Level of the significance test: the share of purely random gradients that count as significant.
const TAKEN_FOR_MORE: f64 = 0.05;

/// Derivative of the information by the centre of a lenslet, bits per pixel and pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionGradient {
    /// Derivative by the column.
    pub x: f64,
    /// Derivative by the row.
    pub y: f64,
    /// Whether the gradient is statistically significant at a level of 5 %, by the differences between scenes of the held-out objects
    /// available.
    pub is_significant: bool,
}

/// Position gradients of the lenslets of a design, by the live estimate or, where that is loose, by the decoder of beads. The gradients
/// of a loose density model point to where it is looser still. A decoder errs where beads are many; density models do not.
pub(crate) struct Pulls<'a> {
    forward: &'a ForwardModel,
    /// The lenslets; none for other masks, which have no position gradients.
    array: Option<&'a LensletArray>,
    seed: u64,
    /// The decoder, where it applies to these objects.
    decoder: Option<&'static Decoder>,
    /// Gradients by the centres (x, y), block by block, and whether the decoder computed them.
    blocks: Vec<Vec<(f64, f64)>>,
    are_decoded: bool,
    gradients: Option<Vec<PositionGradient>>,
}

impl<'a> Pulls<'a> {
    /// The state before any scene.
    pub fn new(forward: &'a ForwardModel, array: Option<&'a LensletArray>, seed: u64) -> Self {
        let decoder = Decoder::shipped().filter(|_| forward.set.bead_prior().is_some());
        let seed = SeedStream::PositionGradients.derive(seed);
        Self { forward, array, seed, decoder, blocks: Vec::new(), are_decoded: false, gradients: None }
    }

    /// The position gradients so far; none before there are enough scenes, and where numbers are not finite.
    pub fn gradients(&self) -> Option<Vec<PositionGradient>> {
        self.gradients.clone()
    }

    /// Computes position gradients for `time` by the current model or, where that `is_loose`, by a decoder. Later calls with a decoder
    /// add scenes to the earlier ones. Scenes that cannot be computed contribute nothing.
    pub fn look(
        &mut self,
        model: &CausalModel,
        is_loose: bool,
        time: Duration,
        cancel: &CancelToken,
    ) -> Option<Vec<PositionGradient>> {
        let array = self.array?;
        let decoder = self.decoder.filter(|_| is_loose);
        if decoder.is_none() || !self.are_decoded {
            self.blocks.clear();
        }
        self.are_decoded = decoder.is_some();
        let began = Instant::now();
        while !cancel.is_cancelled()
            && self.blocks.len() < MOST_BLOCKS
            && (self.blocks.len() < BLOCKS || began.elapsed() < time)
        {
            let seed = SeedStream::Block { index: self.blocks.len() }.derive(self.seed);
            let slopes = match decoder {
                Some(decoder) => self.by_decoder(decoder, array, model, seed),
                None => self.by_density(model, array, seed),
            };
            let Ok(slopes) = slopes else { break };
            let block = slopes.iter().map(|by| (by.x, by.y)).collect();
            self.blocks.push(if self.are_decoded { without_common(block) } else { block });
        }
        if self.blocks.len() >= BLOCKS {
            self.gradients = (0..array.lenslets.len()).map(|lenslet| pull(&self.blocks, lenslet)).collect();
        }
        self.gradients()
    }

    /// Gradients by the decoder from whole measurements; a decoder does not take measurements of any size.
    fn by_decoder(
        &self,
        decoder: &Decoder,
        array: &LensletArray,
        model: &CausalModel,
        seed: u64,
    ) -> Result<Vec<LensletGradient>, IdealError> {
        let by = |patch| self.forward.posterior_gradient(array, patch, scenes_of(patch), seed, decoder);
        by(self.forward.patch(None)).or_else(|_| by(model.patch()))
    }

    fn by_density(
        &self,
        model: &CausalModel,
        array: &LensletArray,
        seed: u64,
    ) -> Result<Vec<LensletGradient>, IdealError> {
        let scenes = scenes_of(model.patch());
        let draw = GradientDraw { split: Split::Test, objects: scenes, patches: scenes, seed };
        Ok(self.forward.gradient(array, &draw, model.patch(), model, &mut CancelToken::new())?.lenslets)
    }
}

/// Gradients without their common part. Beads are equally likely everywhere, so a shift of the whole mask leaves the information
/// unchanged. The gradient by all centres together is therefore only decoder error.
fn without_common(block: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let share = 1.0 / block.len().max(1) as f64;
    let (x, y) = block.iter().fold((0.0, 0.0), |sum, slope| (sum.0 + share * slope.0, sum.1 + share * slope.1));
    block.into_iter().map(|slope| (slope.0 - x, slope.1 - y)).collect()
}

/// Scenes per block of patches of this shape (rows, cols).
fn scenes_of((rows, cols): (usize, usize)) -> usize {
    (SCENES * PIXELS / (rows * cols) as f64).clamp(1.0, SCENES) as usize
}

/// Mean over all blocks, and its significance by Hotelling's test of a mean in the plane.
fn pull(blocks: &[Vec<(f64, f64)>], lenslet: usize) -> Option<PositionGradient> {
    let count = blocks.len() as f64;
    let sum =
        |of: &dyn Fn(f64, f64) -> f64| blocks.iter().map(|block| of(block[lenslet].0, block[lenslet].1)).sum::<f64>();
    let (x, y) = (sum(&|x, _| x) / count, sum(&|_, y| y) / count);
    // Covariance of the mean.
    let freedom = count * (count - 1.0);
    let xx = sum(&|a, _| (a - x).powi(2)) / freedom;
    let yy = sum(&|_, b| (b - y).powi(2)) / freedom;
    let xy = sum(&|a, b| (a - x) * (b - y)) / freedom;
    // Squared distance from 0 that chance exceeds at the level of the test. The quantile of F with 2 degrees of freedom is a power.
    let rest = count - 2.0;
    let quantile = 0.5 * rest * (TAKEN_FOR_MORE.powf(-2.0 / rest) - 1.0);
    let limit = 2.0 * (count - 1.0) / rest * quantile;
    // No division by the determinant, which is 0 where all blocks are equal.
    let is_significant = x * x * yy - 2.0 * x * y * xy + y * y * xx > limit * (xx * yy - xy * xy);
    [x, y, xx, yy].iter().all(|value| value.is_finite()).then_some(PositionGradient { x, y, is_significant })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::evaluation::scene::Scene;
    use crate::forward::Design;
    use crate::optics::{Encoder, Lenslet};
    use crate::workbench::live::problem::LiveProblem;

    #[test]
    fn of_many_beads_two_lenslets_that_nearly_coincide_are_pulled_together() {
        let lenslets = [14.3, 16.7].map(|x| Lenslet::round(x, 15.5, 0.8, 0.5)).to_vec();
        let encoder = Encoder::Lenslets(LensletArray::new(32, 32, lenslets));
        let design = Design { encoder, objects: "beads:0.11".parse().unwrap(), ..Design::default() };
        let scene = Arc::new(Scene::open(&design, &mut CancelToken::new()).unwrap());
        let forward = ForwardModel::of_objects(&design, Arc::clone(&scene.set)).unwrap();
        let subject = LiveProblem::new(&design, design.noise, &scene, &forward).unwrap();
        let model = subject.model(&subject.stream(Split::Train), &subject.test(32).unwrap(), None).unwrap();
        let mut pulls = Pulls::new(&forward, design.encoder.lenslets(), design.seed);
        let (never, cancelled) = (CancelToken::new(), CancelToken::new());
        cancelled.cancel();
        let mut look = |is_loose: bool, cancel| pulls.look(&model, is_loose, Duration::ZERO, cancel);
        assert_eq!(look(false, &cancelled), None, "it was cancelled");
        let first = look(false, &never).unwrap();
        let [left, right] = &first[..] else { panic!("two lenslets") };
        assert!(left.is_significant && right.is_significant && left.x > 0.0 && right.x < 0.0, "{left:?} {right:?}");
        assert_eq!(look(false, &never), Some(first), "the same scenes");
        // A decoder adds scenes with every call.
        let few = look(true, &never).unwrap();
        pulls.look(&model, true, Duration::from_secs(2), &never);
        assert!(pulls.blocks.len() > BLOCKS && pulls.gradients() != Some(few), "{}", pulls.blocks.len());
        // A shift of the whole mask leaves the information unchanged.
        let [left, right] = &pulls.gradients().unwrap()[..] else { panic!("two lenslets") };
        assert!((left.x + right.x).abs() < 1e-12 && (left.y + right.y).abs() < 1e-12, "{left:?} {right:?}");
    }

    #[test]
    fn chance_is_taken_for_more_one_time_in_twenty() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        for count in [BLOCKS, 40] {
            let mut certain = |mean: f64| {
                let trials = 4000;
                let found = (0..trials).filter(|_| {
                    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
                    // One axis varies more than the other, and with it.
                    let block = |_| {
                        let (a, b) = (normal(), normal());
                        vec![(mean + 3.0 * a, a + 0.5 * b)]
                    };
                    pull(&(0..count).map(block).collect::<Vec<_>>(), 0).unwrap().is_significant
                });
                found.count() as f64 / f64::from(trials)
            };
            let (alone, moved) = (certain(0.0), certain(3.0));
            assert!((alone - TAKEN_FOR_MORE).abs() < 0.012 && moved > 0.9, "{count} blocks: {alone} {moved}");
        }
        assert_eq!(pull(&vec![vec![(f64::NAN, 0.0)]; 8], 0), None);
    }
}
