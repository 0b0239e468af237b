//! Training objects, fresh for every step, and the masks that they are measured with.

use std::sync::Arc;

use ndarray::Axis;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::features::{Example, Features};
use super::masks::{TrainingMasks, random_psf};
use crate::objects::{ObjectSet, Split};
use crate::progress::CancelToken;
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::linear::Prior;
use crate::reconstruction::model::ImagingModel;
use crate::reconstruction::protocol::DecoderScene;
use crate::seeds::SeedStream;

/// Objects of a step.
pub(super) const BATCH: usize = 4;
/// Steps whose objects are drawn together.
const TOGETHER: usize = 8;
/// Masks in use at a time, where a network is trained for any.
const BANK: usize = 8;
/// Steps after which one of them is replaced.
const STEPS_PER_MASK: usize = 3 * TOGETHER;
/// Training images above which the prior is learned from all of them, and the network from the same ones.
const ENOUGH_IMAGES: usize = 20_000;

/// One object to learn from.
pub(super) struct Sample {
    pub(super) example: Example,
    /// The object, row by row, photons per pixel on the scale of the set.
    pub(super) truth: Vec<f32>,
    /// Photons of a result of 1 of the network.
    pub(super) unit: f32,
}

/// A prior, and objects that it was not learned from where images are few.
struct Fold {
    prior: Arc<Prior>,
    set: Arc<ObjectSet>,
}

/// Source of training samples.
pub(super) struct Batches<'a> {
    scene: &'a DecoderScene,
    masks: &'a TrainingMasks,
    folds: Vec<Fold>,
    /// For each mask in use: the fold, and the mask prepared with its prior.
    bank: Vec<(usize, Features)>,
    deviation: f64,
    seed: u64,
    random: ChaCha8Rng,
    /// Objects drawn so far.
    drawn: usize,
    waiting: Vec<Sample>,
}

impl<'a> Batches<'a> {
    /// Learns the priors from the training part of `training`, and prepares the masks.
    pub(super) fn new(
        (scene, training): (&'a DecoderScene, &ObjectSet),
        masks: &'a TrainingMasks,
        (deviation, seed): (f64, u64),
        cancel: &CancelToken,
    ) -> Result<Self, ReconstructionError> {
        let learn = |set: &ObjectSet| Ok::<_, ReconstructionError>(Arc::new(Prior::learn(set, scene.light, cancel)?));
        let few = training.base_images().is_some_and(|images| images < ENOUGH_IMAGES);
        let folds = match training.halves_of_training().filter(|_| few) {
            Some([first, second]) => {
                // Cross-fitting: a linear estimate is better on the objects that its prior was learned from than on others.
                let priors = [learn(&first)?, learn(&second)?];
                let sets = [Arc::new(second), Arc::new(first)];
                priors.into_iter().zip(sets).map(|(prior, set)| Fold { prior, set }).collect()
            }
            None => vec![Fold { prior: learn(training)?, set: Arc::new(training.clone()) }],
        };
        let mut batches = Self {
            scene,
            masks,
            folds,
            bank: Vec::new(),
            deviation,
            seed,
            random: ChaCha8Rng::seed_from_u64(SeedStream::Block { index: 2 }.derive(seed)),
            drawn: 0,
            waiting: Vec::new(),
        };
        let masks = match masks {
            TrainingMasks::One(_) => batches.folds.len(),
            TrainingMasks::Any { .. } => BANK,
        };
        for index in 0..masks {
            let prepared = batches.prepare(index % batches.folds.len(), cancel)?;
            batches.bank.push(prepared);
        }
        Ok(batches)
    }

    fn prepare(&mut self, fold: usize, cancel: &CancelToken) -> Result<(usize, Features), ReconstructionError> {
        let model = self.next_model()?;
        Ok((fold, self.features(fold, &model, cancel)?))
    }

    /// The mask, or a new one of any.
    fn next_model(&mut self) -> Result<ImagingModel, ReconstructionError> {
        match self.masks {
            TrainingMasks::One(model) => Ok(model.clone()),
            TrainingMasks::Any { psf } => self.scene.model(random_psf(*psf, &mut self.random)?.view()),
        }
    }

    fn features(
        &self,
        fold: usize,
        model: &ImagingModel,
        cancel: &CancelToken,
    ) -> Result<Features, ReconstructionError> {
        let moments = (self.deviation, self.scene.set.mean());
        Features::new(model, &self.folds[fold].prior, moments, cancel)
    }

    /// Skips the samples of a number of steps, as if they had been drawn.
    pub(super) fn skip(&mut self, steps: usize, cancel: &CancelToken) -> Result<(), ReconstructionError> {
        let before = steps - steps % TOGETHER;
        if matches!(self.masks, TrainingMasks::Any { .. }) {
            // Masks that were replaced again need no preparation.
            let mut newest: Vec<Option<ImagingModel>> = vec![None; self.bank.len()];
            for replacement in 1..before.div_ceil(STEPS_PER_MASK) {
                newest[replacement % self.bank.len()] = Some(self.next_model()?);
            }
            for (place, model) in newest.into_iter().enumerate() {
                if let Some(model) = model {
                    let fold = self.bank[place].0;
                    self.bank[place] = (fold, self.features(fold, &model, cancel)?);
                }
            }
        }
        self.drawn = before * BATCH;
        for _ in before..steps {
            self.next(cancel)?;
        }
        Ok(())
    }

    /// The samples of a step.
    pub(super) fn next(&mut self, cancel: &CancelToken) -> Result<Vec<Sample>, ReconstructionError> {
        if self.waiting.is_empty() {
            self.draw(cancel)?;
        }
        Ok(self.waiting.split_off(self.waiting.len() - BATCH))
    }

    fn draw(&mut self, cancel: &CancelToken) -> Result<(), ReconstructionError> {
        let steps = self.drawn / BATCH;
        if matches!(self.masks, TrainingMasks::Any { .. }) && steps > 0 && steps.is_multiple_of(STEPS_PER_MASK) {
            let oldest = steps / STEPS_PER_MASK % self.bank.len();
            self.bank[oldest] = self.prepare(self.bank[oldest].0, cancel)?;
        }
        // Each mask has its share of the objects that are drawn together.
        let count = self.bank.len();
        let share = TOGETHER * BATCH / count;
        let mut parts: Vec<std::vec::IntoIter<Sample>> = Vec::new();
        for (fold, features) in &self.bank {
            let set = &self.folds[*fold].set;
            let draw = Draw { set, split: Split::Train, first: self.drawn, count: share, seed: self.seed };
            let samples = samples(self.scene, draw, features, cancel)?;
            parts.push(samples.into_iter());
            self.drawn += share;
        }
        // Turn by turn from the masks: a step has objects of both folds, or of one of many masks.
        let turn = if count < BATCH { BATCH / count } else { BATCH };
        while parts.iter().any(|part| part.len() > 0) {
            for part in &mut parts {
                self.waiting.extend(part.by_ref().take(turn));
            }
        }
        Ok(())
    }
}

/// Objects of a part of a set.
#[derive(Clone, Copy)]
pub(super) struct Draw<'a> {
    pub(super) set: &'a ObjectSet,
    pub(super) split: Split,
    /// Number of the first object.
    pub(super) first: usize,
    pub(super) count: usize,
    /// Seed of objects and noise.
    pub(super) seed: u64,
}

/// Draws objects and measures them.
pub(super) fn samples(
    scene: &DecoderScene,
    Draw { set, split, first, count, seed }: Draw<'_>,
    features: &Features,
    cancel: &CancelToken,
) -> Result<Vec<Sample>, ReconstructionError> {
    let objects = set.objects_from(split, first, count, SeedStream::ReconstructionObjects.derive(seed))?;
    let mut lit = objects.clone();
    scene.light.apply(&mut lit);
    let measurements = features.measure(lit.view(), (first, SeedStream::ReconstructionNoise.derive(seed)))?;
    let examples = features.examples(measurements.view(), cancel)?;
    let unit = features.unit();
    let truths = objects.axis_iter(Axis(0)).map(|object| object.iter().copied().collect());
    Ok(examples.into_iter().zip(truths).map(|(example, truth)| Sample { example, truth, unit }).collect())
}
