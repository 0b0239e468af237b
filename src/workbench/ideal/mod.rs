//! Runs of IDEAL on a design: computed, kept in files, and on a thread of their own for the window.

mod design_run;
mod designer;
mod record;
mod run;
mod score;

pub use design_run::{DesignRun, RankedStart, RunBounds, RunStatus, Start};
pub(super) use designer::Designer;
pub use record::{IdealRecord, curve_of, patches_of};
pub use run::{KeptRun, run_ideal};
pub use score::{score_settings, verdict};
