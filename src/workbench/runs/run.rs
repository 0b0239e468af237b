//! A run of the optimizer from a design.

use crate::design::{IdealOptimizer, IdealProgress, IdealSettings, Objective};
use crate::evaluation::EvaluationError;
use crate::evaluation::scene::ceiling_of;
use crate::forward::{Design, ForwardModel, open_set_with};
use crate::objects::ReadProgress;
use crate::optics::{LensletArray, render_psf};
use crate::progress::Progress;
use crate::workbench::runs::record::IdealRecord;

/// Callback with the optimizer between two rounds, for saving its state.
pub(super) type Keep<'a> = &'a mut dyn FnMut(&IdealOptimizer<'_>) -> Result<(), EvaluationError>;

/// Runs the optimizer on the mask of a design, from the start or from a saved state of the same run (`state`). `reading` receives the
/// progress of reading the objects, `keep` the optimizer after every round.
///
/// A run that was planned for fewer steps than the settings ask for finishes these first, and is then extended.
///
/// # Errors
/// Where design, objects, noise and settings do not allow a run, for a state of another run, and where `reading` or `progress` cancels.
pub fn run_ideal(
    design: &Design,
    settings: &IdealSettings,
    state: Option<&[u8]>,
    reading: &mut dyn Progress<ReadProgress>,
    keep: Keep<'_>,
    progress: &mut dyn for<'a> Progress<IdealProgress<'a>>,
) -> Result<IdealRecord, EvaluationError> {
    // The result is scored on the test part of the objects, which a run does not use.
    let forward = ForwardModel::of_objects(design, open_set_with(design, reading)?.of_training())?;
    let mut ideal = IdealOptimizer::new(&forward, start_of(design)?, design.limits, settings.clone())?;
    if let Some(state) = state {
        ideal = ideal.resumed(state)?;
        ideal.check_length(settings.steps)?;
        ideal.extend_to(settings.steps);
    }
    while !ideal.is_finished() {
        ideal.advance(progress)?;
        keep(&ideal)?;
        ideal.extend_to(settings.steps);
    }
    let notices = forward.set.notices().iter().cloned().chain(above_ceiling(design, &forward, &ideal)).collect();
    Ok(IdealRecord { notices, ..IdealRecord::new(design, &ideal) })
}

/// A notice where the upper bound of the last mask lies above the object-entropy bound.
fn above_ceiling(design: &Design, forward: &ForwardModel, ideal: &IdealOptimizer<'_>) -> Option<String> {
    let settings = ideal.settings();
    let last = ideal.state().checkpoints.last().filter(|_| settings.objective != Objective::Posterior)?;
    let psf = render_psf(&last.array, forward.set.planes()).ok()?;
    let ceiling = ceiling_of(design, &forward.set, psf.view(), forward.patch(settings.patch)).ok()??.bits_per_pixel;
    (last.interval_95[0] > ceiling).then(|| {
        let bits = last.bits_per_pixel;
        format!(
            "the upper bound of the run, {bits:.3} bits per pixel, lies above the object-entropy bound, {ceiling:.3}: estimate \
             the design by a bracket"
        )
    })
}

/// The lenslets of a design.
pub(super) fn start_of(design: &Design) -> Result<&LensletArray, EvaluationError> {
    design.encoder.lenslets().ok_or_else(|| EvaluationError::NoLenslets { mask: design.encoder.describe() })
}
