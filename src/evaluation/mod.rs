//! The evaluation of one design: its measurements, its bounds, and estimates that take minutes.

pub(crate) mod bead_bound_schedule;
pub(crate) mod calibration;
pub(crate) mod checkpoint;
pub(crate) mod comparison;
pub(crate) mod equal_light;
pub(crate) mod estimation;
pub(crate) mod level_limit;
pub(crate) mod measured;
pub(crate) mod measured_checks;
pub(crate) mod measured_error;
pub(crate) mod measured_folds;
pub(crate) mod measured_open;
pub(crate) mod measured_source;
pub(crate) mod measured_view;
pub(crate) mod patch_source;
pub(crate) mod pixel_calibration;
pub(crate) mod progress;
pub(crate) mod request;
pub(crate) mod scene;

pub use bead_bound_schedule::pretrained_lower_bound;
pub use calibration::Calibration;
pub use checkpoint::is_checkpoint_file;
pub use comparison::{Compared, SystemComparison, SystemDifference};
pub use equal_light::EqualLight;
pub use estimation::estimate;
pub use measured::{MeasuredConditions, MeasuredImages, MeasuredOrder};
pub use measured_error::MeasuredError;
pub use measured_open::MeasuredOptions;
pub use measured_source::MeasuredSource;
pub use measured_view::{Crop, View};
pub use progress::{EstimateProgress, FitPoint, FittedModel, format_duration};
pub use request::{DensityModel, EstimateRequest, WeightsFiles};
pub use scene::{EvaluationError, LIVE_COUNT, LIVE_PATCH, LiveInformation, Measurements, Optics, Scene, SceneTables};
