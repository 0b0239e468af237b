//! Fits that go on while something else is done, to measurements that change meanwhile.

use std::ops::Range;
use std::time::Duration;

use super::conditioning::Inputs;
use super::fit::{CausalFit, DRAWN, Mover, inputs};
use super::model::CausalModel;
use super::stream::PatchBatch;
use crate::information::InformationError;

/// Gives the model for the measurements as they are by now, with the weights of the given one, and so many fresh patches of
/// them by a seed.
pub type OnPatches<'a> =
    &'a mut dyn FnMut(&CausalModel, usize, u64) -> Result<(CausalModel, PatchBatch), InformationError>;

/// A fit of a number of steps that is done part by part, to measurements that change meanwhile.
pub struct CausalRefit {
    fit: CausalFit,
    model: CausalModel,
    mover: Mover,
    inputs: Option<Inputs>,
    /// Of the patches that were drawn last.
    batches: Vec<Range<usize>>,
}

impl CausalRefit {
    /// Begins from the weights of a model.
    pub fn new(fit: CausalFit, start: &CausalModel) -> Self {
        Self { fit, model: start.clone(), mover: Mover::new(start), inputs: None, batches: Vec::new() }
    }

    /// Goes on up to so many steps in all. `patches` is asked whenever those that were drawn are used up,
    /// `go_on` after every step.
    ///
    /// # Errors
    /// As [`CausalFit::fit`].
    pub fn go_on(
        &mut self,
        steps: usize,
        patches: OnPatches<'_>,
        go_on: &dyn Fn() -> bool,
    ) -> Result<(), InformationError> {
        let Self { fit, model, mover, inputs: drawn, batches } = self;
        while mover.course.steps < steps && fit.done(mover.course.steps, Duration::ZERO) < 1.0 {
            if let (Some(drawn), Some(indices)) = (&*drawn, batches.pop()) {
                mover.step(fit, model, (drawn, indices), fit.done(mover.course.steps, Duration::ZERO))?;
                if !go_on() {
                    return Err(InformationError::Cancelled);
                }
            } else {
                let seed = mover.next_seed(fit);
                let (followed, fresh) = patches(model, DRAWN, seed)?;
                mover.replace(model, followed);
                *drawn = Some(inputs(model, &fresh, seed)?);
                *batches = fit.batches().collect();
                batches.reverse();
            }
        }
        Ok(())
    }

    /// The model with weights averaged over the last steps.
    pub fn model(&self) -> CausalModel {
        CausalModel { weights: self.mover.averaged(&self.model), ..self.model.clone() }
    }
}
