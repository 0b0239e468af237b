//! Online fits to measurements that change during the fit.

use std::ops::Range;

use super::conditioning::Inputs;
use super::fit::{CausalFit, FitLength, Trainer};
use super::model::CausalModel;
use super::stream::PatchStream;
use crate::information::error::InformationError;
use crate::nn::{Averaging, warmup_factor};
use crate::progress::Progress;

/// Factor of the learning rate, which does not fall. At twice this rate the same masks of a run gave estimates 0.002
/// bits per pixel higher.
const RATE: f64 = 0.25;
/// Steps of the weight average. The weights fluctuate at a constant rate; a tenth of a short fit would not average
/// that out.
const AVERAGED: usize = 50;

/// A fit of a number of steps, done in parts. Its rate does not fall: measurements change to the end.
pub struct CausalRefit {
    fit: CausalFit,
    /// Of the whole fit.
    steps: usize,
    model: CausalModel,
    trainer: Trainer,
    /// Inputs of the patches drawn last.
    inputs: Inputs,
    /// Those of them not yet used by a step.
    batches: Vec<Range<usize>>,
}

impl CausalRefit {
    /// Starts an online fit of `steps` steps from the weights of a model; `seed` is that of patches and noise.
    pub fn new(steps: usize, seed: u64, start: CausalModel) -> Self {
        let fit = CausalFit::new(FitLength::Steps(steps), seed);
        let fit = CausalFit { rate: RATE * fit.rate, ..fit };
        let trainer = Trainer::new(&start, Averaging::Last(AVERAGED));
        Self { fit, steps, model: start, trainer, inputs: Inputs::default(), batches: Vec::new() }
    }

    /// Advances to `steps` steps in all. New patches are drawn whenever the last ones are used up. The number of steps so far is
    /// reported after every step.
    ///
    /// # Errors
    /// As [`CausalFit::fit`].
    pub fn advance_to(
        &mut self,
        steps: usize,
        stream: &dyn PatchStream,
        progress: &mut dyn Progress<usize>,
    ) -> Result<(), InformationError> {
        let Self { fit, steps: all, model, trainer, inputs, batches } = self;
        while trainer.course.steps < steps.min(*all) {
            let Some(indices) = batches.pop() else {
                *inputs = trainer.draw(fit, model, stream)?;
                batches.extend(fit.batches().rev());
                continue;
            };
            let factor = warmup_factor(trainer.course.steps as f64 / *all as f64);
            trainer.step(fit, model, inputs, indices, factor)?;
            if progress.report(&trainer.course.steps).is_break() {
                return Err(InformationError::Cancelled);
            }
        }
        Ok(())
    }

    /// The model with weights averaged over the last steps.
    pub fn model(&self) -> CausalModel {
        CausalModel { weights: self.trainer.averaged(&self.model), ..self.model.clone() }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use ndarray::Array3;

    use super::super::conditioning::Moments;
    use super::super::init::Init;
    use super::super::shape::CausalShape;
    use super::super::stream::PatchBatch;
    use super::*;
    use crate::progress::CancelToken;
    use crate::sensor::Noise;

    /// Spots at places set by the seed.
    struct Spots;

    impl PatchStream for Spots {
        fn draw(&self, count: usize, seed: u64) -> Result<PatchBatch, InformationError> {
            let clean = Array3::from_shape_fn((count, 6, 7), |(n, r, c)| {
                let place = (seed % 1000) as usize + n;
                let distance = (r as f32 - (place * 5 % 6) as f32).hypot(c as f32 - (place * 3 % 7) as f32);
                15.0 + 60.0 * (-0.3 * distance * distance).exp()
            });
            Ok(PatchBatch { noisy: Noise::Shot.draw(clean.view(), seed), clean: Some(clean) })
        }
    }

    #[test]
    fn fit_in_parts_equals_one_fit_and_can_be_cancelled() {
        let sample = Spots.draw(60, 1).unwrap();
        let moments = Moments::of_patches(sample.noisy.view()).unwrap();
        let shape = CausalShape { channels: 6, dilations: vec![1, 2] };
        let start = CausalModel::new(shape, Noise::Shot, &sample, &moments, Init::Random, 3).unwrap();
        let begin = || CausalRefit::new(300, 7, start.clone());
        let (mut whole, mut parts) = (begin(), begin());
        whole.advance_to(300, &Spots, &mut CancelToken::new()).unwrap();
        for steps in [0, 3, 3, 40, 300, 400] {
            parts.advance_to(steps, &Spots, &mut CancelToken::new()).unwrap();
        }
        assert_eq!(whole.model().weights, parts.model().weights);
        let held_out = Spots.draw(200, 999).unwrap();
        let bits = |model: &CausalModel| model.cross_entropy_map(held_out.noisy.view()).unwrap().mean().unwrap();
        assert!(bits(&whole.model()) < bits(&start) - 0.02);
        let mut reported = Vec::new();
        let mut until_five = |steps: &usize| {
            reported.push(*steps);
            if *steps < 5 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        assert!(matches!(begin().advance_to(300, &Spots, &mut until_five), Err(InformationError::Cancelled)));
        assert_eq!(reported, [1, 2, 3, 4, 5]);
    }
}
