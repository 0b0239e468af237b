//! The designed masks of a plan: optimizer runs as part of a cell.

use std::ops::ControlFlow;

use super::cell::Freedom;
use super::folder::StudyFolder;
use super::ideal_settings::settings_of;
use super::run::CellError;
use crate::design::{IdealOptimizer, IdealProgress};
use crate::evaluation::EvaluationError;
use crate::formats::{read_if_there, write_safely};
use crate::forward::{Design, ForwardModel, open_set};
use crate::optics::Encoder;

/// The mask of an optimizer run (IDEAL) from the mask of `design`, for its objects and noise. The run resumes from the state of an
/// interrupted one, and leaves its design beside the cell.
pub(super) fn designed(
    folder: &StudyFolder,
    index: usize,
    freedom: Freedom,
    design: Design,
    report: &mut (dyn FnMut(&str) -> ControlFlow<()> + Send),
) -> Result<Encoder, CellError> {
    let file = folder.design_file(index);
    if let Ok(there) = Design::open(&file) {
        return Ok(there.encoder);
    }
    let start =
        design.encoder.lenslets().ok_or_else(|| EvaluationError::NoLenslets { mask: design.encoder.describe() })?;
    let forward = ForwardModel::of_objects(&design, open_set(&design).map_err(EvaluationError::from)?.of_training())
        .map_err(EvaluationError::from)?;
    let settings = settings_of(&folder.cells()[index], freedom, &design);
    let steps = settings.steps;
    let new = || IdealOptimizer::new(&forward, start, design.limits, settings.clone()).map_err(EvaluationError::from);
    let state_file = folder.design_state_file(index);
    let mut ideal = new()?;
    if let Some(bytes) = read_if_there(&state_file)? {
        // A state of other settings or of an earlier program is no reason to fail: the run starts again.
        ideal = ideal.resumed(&bytes).or_else(|_| new())?;
    }
    while !ideal.is_finished() {
        let mut at = |progress: &IdealProgress<'_>| report(&format!("design: {}", step_text(progress, steps)));
        ideal.advance(&mut at).map_err(EvaluationError::from)?;
        let bytes = ideal.to_bytes().map_err(EvaluationError::from)?;
        write_safely(&state_file, |writer| writer.write_all(&bytes))?;
    }
    let encoder = Encoder::Lenslets(ideal.state().array.clone());
    let design = Design { encoder: encoder.clone(), ..design };
    design.save(&file).map_err(|error| CellError::Failed(error.to_string()))?;
    Ok(encoder)
}

/// The current step of a run, for people.
fn step_text(progress: &IdealProgress<'_>, steps: usize) -> String {
    let step = progress.state.step;
    match progress.phase {
        Some((phase, share)) => format!("step {step} of {steps}, {phase}, {:.0} %", 100.0 * share),
        None => format!("step {step} of {steps}"),
    }
}
