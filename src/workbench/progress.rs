//! What long computations tell while they go on, and how they are stopped.

use std::ops::ControlFlow;

use crate::information::{DecoderProgress, FitProgress, InformationError};

/// What an estimate is doing and how far it is.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimateProgress {
    /// The step, for people.
    pub step: String,
    /// How much of it is done.
    pub done: usize,
    /// How much there is to do: objects, patches, or seconds of a fit.
    pub total: usize,
    /// Where a fit has come to.
    pub fit: Option<FitPoint>,
}

/// A point of the curve of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitPoint {
    /// What is fitted.
    pub model: FittedModel,
    /// Seconds since the fit began.
    pub seconds: f64,
    /// Bits per pixel: the cross-entropy of a density model, which falls, or what a decoder saves, which rises.
    pub bits: f64,
}

/// What is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FittedModel {
    /// A density model of the measurements.
    Density,
    /// A decoder of the objects.
    Decoder,
}

/// Hears of progress, and answers whether to go on; after `Break` the computation ends in
/// [`InformationError::Cancelled`].
pub type Watch<'a> = &'a mut dyn FnMut(&EstimateProgress) -> ControlFlow<()>;

/// Tells of a step that is no fit.
pub(super) fn tell(watch: Watch<'_>, step: &str, done: usize, total: usize) -> Result<(), InformationError> {
    match watch(&EstimateProgress { step: step.to_owned(), done, total, fit: None }) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(InformationError::Cancelled),
    }
}

impl From<&FitProgress> for EstimateProgress {
    fn from(fit: &FitProgress) -> Self {
        if let Some((done, total)) = fit.scored {
            return Self { step: "Scoring test patches".into(), done, total, fit: None };
        }
        let left = fit.remaining.map_or(0, |left| left.as_secs_f64().ceil() as usize);
        let done = fit.elapsed.as_secs() as usize;
        let step = match fit.best_bits {
            Some(bits) => format!("Fitting, H(Y) {bits:.3} bits per pixel, {left} s left at most"),
            None => format!("Fitting, {left} s left at most"),
        };
        let seconds = fit.elapsed.as_secs_f64();
        let fit = fit.validation_bits.map(|bits| FitPoint { model: FittedModel::Density, seconds, bits });
        Self { step, done, total: done + left, fit }
    }
}

impl From<&DecoderProgress> for EstimateProgress {
    fn from(fit: &DecoderProgress) -> Self {
        if let Some(tested) = fit.tested {
            return Self { step: "Testing the decoder".into(), done: tested, total: tested + 1, fit: None };
        }
        let left = fit.remaining.map_or(0, |left| left.as_secs_f64().ceil() as usize);
        let done = fit.elapsed.as_secs() as usize;
        let (seconds, bits) = (fit.elapsed.as_secs_f64(), fit.training_bits);
        let step = format!("Fitting a decoder, {bits:.3} bits per pixel saved, {left} s left");
        Self { step, done, total: done + left, fit: Some(FitPoint { model: FittedModel::Decoder, seconds, bits }) }
    }
}
