//! Settings and time of the optimizer run of a cell.

use std::time::Duration;

use super::cell::{CellSettings, Freedom, StudyMask};
use crate::design::{Free, IdealSettings, Objective, Preset};
use crate::forward::Design;
use crate::information::Protocol;

/// Time of the first and the last fit of a run, and of a step with its share of the other fits, on two cores: 1,600 steps of beads take 8 to
/// 9 min, 800 steps of images 11 to 15 min.
const FIRST_AND_LAST_FIT: Duration = Duration::from_secs(40);
const TIME_OF_BEADS_STEP: Duration = Duration::from_millis(300);
const TIME_OF_STEP: Duration = Duration::from_millis(900);

/// Estimated time of the optimizer run of a cell; none without one.
pub(super) fn time_of_design(cell: &CellSettings) -> Duration {
    let StudyMask::Ideal { freedom, .. } = cell.mask else { return Duration::ZERO };
    let settings = settings_of(cell, freedom, &cell.design(Design::default().encoder));
    let of_step = if settings.objective == Objective::Posterior { TIME_OF_BEADS_STEP } else { TIME_OF_STEP };
    FIRST_AND_LAST_FIT + of_step * u32::try_from(settings.steps).unwrap_or(u32::MAX)
}

/// The settings of `optimize` for a cell: the published ones where the cell has the published protocol.
pub(super) fn settings_of(cell: &CellSettings, freedom: Freedom, design: &Design) -> IdealSettings {
    let preset = if cell.estimates.protocol == Protocol::Paper { Preset::Paper } else { Preset::Default };
    let settings = IdealSettings::new(preset, Objective::usual(preset, &design.objects), design.seed);
    IdealSettings {
        steps: cell.estimates.ideal_steps.unwrap_or(settings.steps),
        anisotropic: freedom == Freedom::Elliptic,
        free: Free { weights: freedom != Freedom::EqualWeights, ..Free::default() },
        ..settings
    }
}
