//! Runs of IDEAL on a design: computed, kept in files, and on a thread of their own for the window.

mod design_run;
mod designer;
mod record;
mod run;
mod runner;
mod score;

pub use design_run::{DesignRun, RankedStart, RunBounds, RunStatus, Start};
pub(super) use designer::Designer;
pub(super) use record::ends_of;
pub use record::{IdealRecord, curve_of, patches_of};
pub use run::{GoOn, KeptOrder, KeptRun, run_ideal};
pub use score::{score_in_patches, score_settings, score_whole, verdict, worths};
