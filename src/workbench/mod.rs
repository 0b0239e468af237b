//! The workbench: the open design, its commands, the worker that evaluates it, and files. It does not depend on the window.

mod background;
mod cameras;
mod captures;
mod document;
mod estimates;
mod export;
mod jobs;
mod live;
mod reconstructions;
mod runs;
mod session;
mod studies;
mod trainings;

pub use background::activity::{Activity, ActivityKind, ActivityState};
pub use background::latest::WorkState;
pub use cameras::calibration::{CalibrationOrder, CalibrationResults};
pub use cameras::comparison::{ComparisonOrder, ComparisonResults};
pub use cameras::desk::CameraResults;
pub use cameras::previews::{CapturePreview, CapturePreviews, CaptureUnit, SystemCaptures, range_of};
pub use captures::queue::{CaptureOrder, CaptureQuality, CaptureReconstruction, CaptureState};
pub use document::autosave::Recovered;
pub use document::command::{Command, CommandError, LensletChange};
pub use document::file_preview::{FilePreview, FileUse, with_option};
pub use document::network_file::weights_beside;
pub use document::psf_preview::{PsfPreview, PsfPreviewRequest, PsfPreviewer};
pub use document::samples::{SAMPLES, Sample};
pub use estimates::files::{EstimateOrder, FinishedEstimate};
pub use estimates::queue::{Estimates, RunningEstimate};
pub use export::colormap::Colormap;
pub use export::design_files::{
    Curve, DESIGN_FILE, DESIGN_FILES, ExportError, design_outputs, export_design, write_design,
};
pub use export::reconstruction_files::{
    RECONSTRUCTIONS_FILE, ReconstructionExample, ReconstructionWriter, colour_levels,
};
pub use export::stacks::{MEASUREMENT_STACKS, MeasuredStacks, MeasurementFormat, export_measurements, measure_into};
pub use jobs::commands::{
    bounds_command, capture_command, comparison_command, estimate_command, images_command, reconstruct_command,
    reproduce_command, run_command,
};
pub use jobs::job::{DiffuserOrigin, Job};
pub use jobs::outcome::Outcome;
pub use jobs::record::{Record, RecordError};
pub use jobs::worker::Worker;
pub use live::bounds::{BoundSource, SensorBounds};
pub use live::estimate::{LiveEstimate, ReplayRecipe};
pub use live::inspection::{InspectionKey, InspectionRequest, SampleInspection};
pub use live::position_gradients::PositionGradient;
pub use live::published::{Live, Revisioned};
pub use live::record::{LiveNumbers, LiveRecord, Repeated};
pub use reconstructions::networks::{KnownNetwork, NetworkFit, Networks};
pub use reconstructions::queue::{
    Reconstruction, ReconstructionKey, ReconstructionRequest, Reconstructions, SeenRegion, SetQuality,
};
pub use runs::{
    DesignRun, IdealRecord, RankedStart, RunBounds, RunQueue, RunStatus, RunStore, Start, StoredRun,
    comparison_summary, curve_of, patches_of, result_lines, run_ideal, score_in_patches, score_settings, score_whole,
};
pub use session::Session;
pub use session::snapshots::{
    Bits, FileChange, FoundSnapshots, LiveResults, Snapshot, SnapshotNumbers, SnapshotReconstruction, Snapshots,
};
pub use studies::queue::{OpenStudy, StudyStatus, StudyView};
pub use trainings::queue::{LossPoint, Training, TrainingOrder, TrainingScope, TrainingStatus, Trainings};
