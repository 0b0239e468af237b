//! Fits of the causal density model: the states they save, and how they resume.

use std::ops::ControlFlow;

use crate::known_cases::{GaussianField, KnownTruth, TwoRates};
use crate::study_stream::StudyStream;
use lenslet_studio::information::{
    CausalFit, CausalModel, CausalRequest, Estimator, FitCheckpoint, FitLength, InformationError, Init, PatchBatch,
    PatchStream, causal_estimate, causal_model,
};
use lenslet_studio::information::{FitContext, FitProgress, FitStep};
use lenslet_studio::progress::CancelToken;
use ndarray::Axis;

/// A few patches, repeated endlessly.
struct Few(PatchBatch);

impl PatchStream for Few {
    fn draw(&self, count: usize, _seed: u64) -> Result<PatchBatch, InformationError> {
        let indices: Vec<usize> = (0..count).map(|index| index % self.0.noisy.len_of(Axis(0))).collect();
        Ok(PatchBatch { noisy: self.0.noisy.select(Axis(0), &indices), clean: None })
    }
}

/// A fit of `steps` steps from random weights.
fn request<'a>(
    study: &KnownTruth,
    stream: &'a dyn PatchStream,
    test: &'a PatchBatch,
    steps: usize,
) -> CausalRequest<'a> {
    CausalRequest {
        stream,
        test,
        validation: None,
        keeper: None,
        moments: None,
        noise: study.noise(),
        length: FitLength::Steps(steps),
        init: Init::Random,
        estimator: Estimator::Causal,
        seed: 4,
    }
}

#[test]
fn a_fit_whose_numbers_run_away_is_given_up() {
    let study = KnownTruth::TwoRates(TwoRates { side_px: 8, ..TwoRates::default() });
    let test = PatchBatch { noisy: study.draw(20, 1).unwrap().1, clean: None };
    let stream = StudyStream(&study);
    let request = request(&study, &stream, &test, 500);
    let mut model = causal_model(&request).unwrap();
    let fit = CausalFit { rate: f64::from(f32::MAX), ..CausalFit::new(request.length, request.seed) };
    let result = fit.fit(&mut model, &FitContext::new(&stream), &mut CancelToken::new());
    assert!(matches!(result, Err(InformationError::Diverged { refused: 30 })), "{result:?}");
}

#[test]
fn what_a_fit_learns_by_heart_is_not_kept() {
    let study = KnownTruth::GaussianField(GaussianField { side_px: 8, ..GaussianField::default() });
    let batch = |count, seed| PatchBatch { noisy: study.draw(count, seed).unwrap().1, clean: None };
    let (few, validation, test) = (Few(batch(6, 1)), batch(64, 2), batch(200, 3));
    let estimate = |validation, keeper, stop_at| {
        let request = CausalRequest { validation, keeper, ..request(&study, &few, &test, 1000) };
        let mut first = None;
        let estimate = causal_estimate(&request, &mut |progress: &FitProgress| {
            first.get_or_insert(progress.step);
            if progress.step == stop_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        estimate.map(|(trial, _)| (trial, first))
    };
    let (guarded, _) = estimate(Some(&validation), None, usize::MAX).unwrap();
    let (blind, _) = estimate(None, None, usize::MAX).unwrap();
    assert!(guarded.notes().iter().any(|note| note.contains("score best")), "{:?}", guarded.notes());
    assert!(guarded.bits_per_pixel() < blind.bits_per_pixel() - 0.05, "{guarded:?} {blind:?}");
    // A stopped and resumed fit still has its best weights from before the overfitting.
    let kept = InMemory::default();
    assert_eq!(estimate(Some(&validation), Some(&kept), 900).unwrap_err(), InformationError::Cancelled);
    let (resumed, first) = estimate(Some(&validation), Some(&kept), usize::MAX).unwrap();
    assert_eq!(first, Some(897));
    assert_eq!(resumed.bits_per_pixel().to_bits(), guarded.bits_per_pixel().to_bits());
    assert_eq!(resumed.notes(), guarded.notes());
}

#[test]
fn a_fit_that_is_broken_off_late_has_not_learnt_by_heart_either() {
    let study = KnownTruth::GaussianField(GaussianField { side_px: 8, ..GaussianField::default() });
    let batch = |count, seed| PatchBatch { noisy: study.draw(count, seed).unwrap().1, clean: None };
    let (few, validation, test) = (Few(batch(6, 1)), batch(64, 2), batch(200, 3));
    let bits = |model: &CausalModel| model.cross_entropy_map(test.noisy.view()).unwrap().mean().unwrap();
    let broken_off = |validation| {
        let request = request(&study, &few, &test, 1000);
        let (mut model, mut late) = (causal_model(&request).unwrap(), f64::NAN);
        let fit = CausalFit::new(request.length, request.seed);
        let context = FitContext { validation, ..FitContext::new(&few) };
        let ended = fit.fit(&mut model, &context, &mut |step: &FitStep<'_>| {
            if step.progress.step < 900 {
                return ControlFlow::Continue(());
            }
            late = bits(&step.model());
            ControlFlow::Break(())
        });
        assert_eq!(ended.unwrap_err(), InformationError::Cancelled);
        // The last snapshot of a fit equals the final model.
        assert_eq!(late, bits(&model));
        late
    };
    let (guarded, blind) = (broken_off(Some(&validation)), broken_off(None));
    assert!(guarded < blind - 0.05, "{guarded} {blind}");
}

/// Keeps the state of a fit in memory, as often as possible or after `every`.
#[derive(Default)]
struct InMemory {
    state: std::sync::Mutex<Option<Vec<u8>>>,
    every: std::time::Duration,
}

impl FitCheckpoint for InMemory {
    fn key(&self) -> &'static str {
        "this fit"
    }

    fn place(&self) -> String {
        "memory".into()
    }

    fn every(&self) -> std::time::Duration {
        self.every
    }

    fn load(&self) -> Result<Option<Vec<u8>>, InformationError> {
        Ok(self.state.lock().unwrap().clone())
    }

    fn store(&self, state: &[u8]) -> Result<(), InformationError> {
        *self.state.lock().unwrap() = Some(state.to_vec());
        Ok(())
    }
}

#[test]
fn a_stopped_fit_goes_on_bit_for_bit() {
    let study = KnownTruth::TwoRates(TwoRates { side_px: 8, ..TwoRates::default() });
    let stream = StudyStream(&study);
    let test = stream.draw(20, 3).unwrap();
    let run = |keeper: Option<&dyn FitCheckpoint>, stop_at: usize| {
        let request = CausalRequest {
            stream: &stream,
            test: &test,
            validation: None,
            keeper,
            moments: None,
            noise: study.noise(),
            length: FitLength::Steps(150),
            init: Init::Random,
            estimator: Estimator::Causal,
            seed: 4,
        };
        let mut steps = 0;
        let estimate = causal_estimate(&request, &mut |progress: &FitProgress| {
            steps += usize::from(progress.scored.is_none());
            if steps == stop_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        estimate.map(|(trial, _)| (trial.bits_per_pixel().to_bits(), steps))
    };
    let (whole, steps) = run(None, usize::MAX).unwrap();
    assert_eq!(steps, 150);
    // A cancelled fit keeps its state when none is due, too.
    let seldom = InMemory { every: std::time::Duration::from_hours(24), ..InMemory::default() };
    for kept in [&InMemory::default(), &seldom] {
        assert_eq!(run(Some(kept), 100), Err(InformationError::Cancelled));
        let (resumed, steps) = run(Some(kept), usize::MAX).unwrap();
        // Patches are drawn for 32 steps at a time.
        assert_eq!((resumed, steps), (whole, 150 - 96));
    }
    let kept = InMemory::default();
    kept.store(b"something else").unwrap();
    assert!(run(Some(&kept), usize::MAX).unwrap_err().to_string().contains("safetensors"));
}
