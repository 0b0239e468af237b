//! The workbench: the open design, the commands that change it, the worker that computes what it does, and files.
//! It knows no window.

mod activity;
mod bead_bounds;
mod bench;
mod calibration;
mod closer;
mod colormap;
mod command;
mod estimate_files;
mod estimate_request;
mod estimation;
mod estimator;
mod evaluation;
mod export;
mod first;
mod history;
mod ideal;
mod jobs;
mod kept_estimate;
mod live_bounds;
mod live_record;
mod live_subject;
mod measured;
mod measured_error;
mod patch_source;
mod preview;
mod progress;
mod pulls;
mod record;
mod recovery;
mod refinement;
mod repeat;
mod samples;
mod snapshots;
mod stacks;
pub mod study;
mod threads;
mod watched;
mod worker;

pub use activity::{Activity, ActivityKind, ActivityState};
pub use bead_bounds::lower_bound_at_once;
pub use bench::Workbench;
pub use calibration::Calibration;
pub use closer::{Closer, CloserKey, CloserOrder};
pub use colormap::Colormap;
pub use command::{Command, CommandError, LensletChange};
pub use estimate_files::{EstimateOrder, FinishedEstimate};
pub use estimate_request::{DensityModel, EstimateRequest, WeightsFiles};
pub use estimation::{estimate, tells_of_unwritten_weights};
pub use estimator::{Estimates, RunningEstimate};
pub use evaluation::{
    EvaluationError, LIVE_COUNT, LIVE_PATCH, LiveInformation, Measurements, Optics, Scene, SceneOptics,
};
pub use export::{Curve, DESIGN_FILE, DESIGN_FILES, ExportError, design_outputs, export_design, write_design};
pub use first::{first_channel, first_scene};
pub use ideal::{
    DesignRun, GoOn, IdealRecord, KeptOrder, KeptRun, RankedStart, RunBounds, RunStatus, Start, curve_of, patches_of,
    run_ideal, score_in_patches, score_settings, score_whole, verdict, worths,
};
pub use jobs::{Job, Outcome};
pub use kept_estimate::has_name_of_fit;
pub use live_bounds::{Draws, SensorBounds};
pub use live_record::{LiveNumbers, LiveRecord, Repeated};
pub use measured::{MeasuredImages, MeasuredOrder, MeasuredSource};
pub use measured_error::MeasuredError;
pub use preview::{FilePreview, FileUse, with_option};
pub use progress::{EstimateProgress, FitPoint, FittedModel, Watch, spoken};
pub use pulls::Pull;
pub use record::{Record, RecordError};
pub use recovery::Recovered;
pub use refinement::{LiveEstimate, LiveRecipe};
pub use repeat::{bounds_command, estimate_command, images_command, reproduce_command, run_command};
pub use samples::{SAMPLES, Sample};
pub use snapshots::{Bits, FileChange, Snapshot, SnapshotNumbers, Snapshots};
pub use stacks::{MEASUREMENT_STACKS, MeasuredStacks, MeasurementFormat, export_measurements, measure_into};
pub use worker::{Live, Stamped, Worker};
