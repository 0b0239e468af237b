//! Optimizer runs of a design: their states in files, their scores, and the thread that runs them for the window.

mod computation;
mod design_run;
pub(crate) mod record;
mod run;
mod run_thread;
mod score;
mod slot;
mod store;

pub use design_run::{DesignRun, RankedStart, RunBounds, RunStatus, Start};
pub(super) use record::segment_lengths;
pub use record::{IdealRecord, curve_of, patches_of};
pub use run::run_ideal;
pub(super) use run_thread::RunThread;
pub use score::{comparison_summary, result_lines, score_in_patches, score_settings, score_whole};
pub use store::{RunQueue, RunStore, StoredRun};
