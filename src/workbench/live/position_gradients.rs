//! Where information pulls the lenslets of a design, and how much of that may be chance.

use std::time::{Duration, Instant};

use crate::design::{GradientDraw, IdealError};
use crate::forward::ForwardModel;
use crate::information::{CausalModel, Decoder};
use crate::objects::Split;
use crate::optics::{LensletArray, LensletGradient};
use crate::seeds::SeedStream;

/// Fresh scenes of a block, and fewer of measurements with more pixels than these; blocks tell by how much they differ what is chance.
const SCENES: f64 = 8.0;
const PIXELS: f64 = 65.0 * 65.0;
/// Fewest blocks that tell that, and most; more would only wait for each other.
const BLOCKS: usize = 8;
const MOST_BLOCKS: usize = 2048;
/// Share of the pulls that are chance alone and are taken for more.
const TAKEN_FOR_MORE: f64 = 0.05;

/// How the information changes with the centre of a lenslet, bits per pixel and pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionGradient {
    /// By its column.
    pub x: f64,
    /// By its row.
    pub y: f64,
    /// Whether it is more than chance, at a level of 5 %: by what scenes differ, of the held-out objects that there are.
    pub is_significant: bool,
}

/// The pulls on the lenslets of a design: by the live estimate, or, where that is loose, by what can be told of beads. A loose density
/// model pulls to where it is looser still; a decoder errs where beads are many, which is where density models do not.
pub(crate) struct Pulls<'a> {
    imaging: &'a ForwardModel<'a>,
    /// None for other masks, which nothing pulls.
    array: Option<&'a LensletArray>,
    seed: u64,
    /// Where it can tell of these objects.
    decoder: Option<&'static Decoder>,
    /// Slopes by the centres (x, y), block by block, and whether the decoder told them.
    blocks: Vec<Vec<(f64, f64)>>,
    are_decoded: bool,
    told: Option<Vec<PositionGradient>>,
}

impl<'a> Pulls<'a> {
    /// Before any scene.
    pub fn new(imaging: &'a ForwardModel<'a>, array: Option<&'a LensletArray>, seed: u64) -> Self {
        let decoder = Decoder::shipped().filter(|_| imaging.set.bead_prior().is_some());
        let seed = SeedStream::PositionGradients.derive(seed);
        Self { imaging, array, seed, decoder, blocks: Vec::new(), are_decoded: false, told: None }
    }

    /// What scenes have told so far; none before there are enough, and where numbers are not finite.
    pub fn told(&self) -> Option<Vec<PositionGradient>> {
        self.told.clone()
    }

    /// What scenes tell after a look for so long, by the model as it is by now or, where that `is_loose`, by a decoder, which then
    /// tells of more and more scenes. Those that cannot be had tell nothing.
    pub fn look(
        &mut self,
        (model, is_loose): (&CausalModel, bool),
        time: Duration,
        stop: &dyn Fn() -> bool,
    ) -> Option<Vec<PositionGradient>> {
        let array = self.array?;
        let decoder = self.decoder.filter(|_| is_loose);
        if decoder.is_none() || !self.are_decoded {
            self.blocks.clear();
        }
        self.are_decoded = decoder.is_some();
        let began = Instant::now();
        while !stop() && self.blocks.len() < MOST_BLOCKS && (self.blocks.len() < BLOCKS || began.elapsed() < time) {
            let seed = SeedStream::Block { index: self.blocks.len() }.derive(self.seed);
            let slopes = match decoder {
                Some(decoder) => self.by_decoder(decoder, (array, model), seed),
                None => self.by_density(model, array, seed),
            };
            let Ok(slopes) = slopes else { break };
            let block = slopes.iter().map(|by| (by.x, by.y)).collect();
            self.blocks.push(if self.are_decoded { without_common(block) } else { block });
        }
        if self.blocks.len() >= BLOCKS {
            self.told = (0..array.lenslets.len()).map(|lenslet| pull(&self.blocks, lenslet)).collect();
        }
        self.told()
    }

    /// By whole measurements; a decoder does not take those of any size.
    fn by_decoder(
        &self,
        decoder: &Decoder,
        (array, model): (&LensletArray, &CausalModel),
        seed: u64,
    ) -> Result<Vec<LensletGradient>, IdealError> {
        let by = |patch| self.imaging.posterior_gradient(array, patch, scenes_of(patch), seed, decoder);
        by(self.imaging.patch(None)).or_else(|_| by(model.patch()))
    }

    fn by_density(
        &self,
        model: &CausalModel,
        array: &LensletArray,
        seed: u64,
    ) -> Result<Vec<LensletGradient>, IdealError> {
        let scenes = scenes_of(model.patch());
        let draw = GradientDraw { split: Split::Test, objects: scenes, patches: scenes, seed };
        Ok(self.imaging.gradient(array, &draw, model.patch(), model)?.lenslets)
    }
}

/// Slopes without what is common to all: beads are as likely everywhere, so that a mask which moves as a whole tells as much as
/// before, and slopes by all centres together come from errors of the decoder alone.
fn without_common(block: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let share = 1.0 / block.len().max(1) as f64;
    let (x, y) = block.iter().fold((0.0, 0.0), |sum, slope| (sum.0 + share * slope.0, sum.1 + share * slope.1));
    block.into_iter().map(|slope| (slope.0 - x, slope.1 - y)).collect()
}

/// Scenes of a block of such patches (rows, cols).
fn scenes_of((rows, cols): (usize, usize)) -> usize {
    (SCENES * PIXELS / (rows * cols) as f64).clamp(1.0, SCENES) as usize
}

/// Mean over all blocks, and whether that is more than chance by Hotelling's test of a mean in the plane.
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
    // The square of the distance from 0 that chance exceeds so often; the quantile of F with 2 degrees of freedom is a power.
    let rest = count - 2.0;
    let quantile = 0.5 * rest * (TAKEN_FOR_MORE.powf(-2.0 / rest) - 1.0);
    let limit = 2.0 * (count - 1.0) / rest * quantile;
    // Without dividing by a determinant of 0, where all blocks say the same.
    let is_significant = x * x * yy - 2.0 * x * y * xy + y * y * xx > limit * (xx * yy - xy * xy);
    [x, y, xx, yy].iter().all(|value| value.is_finite()).then_some(PositionGradient { x, y, is_significant })
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;
    use std::sync::Arc;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::evaluation::scene::Scene;
    use crate::forward::{Design, forward_model};
    use crate::optics::{Encoder, Lenslet};
    use crate::workbench::live::problem::LiveProblem;

    #[test]
    fn of_many_beads_two_lenslets_that_nearly_coincide_are_pulled_together() {
        let lenslets = [14.3, 16.7].map(|x| Lenslet::round(x, 15.5, 0.8, 0.5)).to_vec();
        let encoder = Encoder::Lenslets(LensletArray { rows: 32, cols: 32, lenslets });
        let design = Design { encoder, objects: "beads:0.11".parse().unwrap(), ..Design::default() };
        let scene = Arc::new(Scene::open(&design, &|_| ControlFlow::Continue(())).unwrap());
        let imaging = forward_model(&design, &scene.set).unwrap();
        let subject = LiveProblem::new(&design, design.noise, &scene, &imaging).unwrap();
        let model = subject.model(&subject.stream(Split::Train), &subject.test(32).unwrap(), None).unwrap();
        let mut pulls = Pulls::new(&imaging, design.encoder.lenslets(), design.seed);
        let mut look = |is_loose: bool, stop: bool| pulls.look((&model, is_loose), Duration::ZERO, &|| stop);
        assert_eq!(look(false, true), None, "it was stopped");
        let told = look(false, false).unwrap();
        let [left, right] = &told[..] else { panic!("two lenslets") };
        assert!(left.is_significant && right.is_significant && left.x > 0.0 && right.x < 0.0, "{left:?} {right:?}");
        assert_eq!(look(false, false), Some(told), "the same scenes");
        // A decoder tells of more and more scenes.
        let few = look(true, false).unwrap();
        pulls.look((&model, true), Duration::from_secs(2), &|| false);
        assert!(pulls.blocks.len() > BLOCKS && pulls.told() != Some(few), "{}", pulls.blocks.len());
        // A mask that moves as a whole tells as much as before.
        let [left, right] = &pulls.told().unwrap()[..] else { panic!("two lenslets") };
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
