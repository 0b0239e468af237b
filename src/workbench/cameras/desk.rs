//! The threads of the camera room.

use std::sync::Arc;

use crate::workbench::background::activity::Activities;
use crate::workbench::background::latest::{LatestThread, WorkState};
use crate::workbench::background::mailbox::ThreadSettings;
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::cameras::calibration::{CalibrationOrder, CalibrationResults};
use crate::workbench::cameras::comparison::{ComparisonOrder, ComparisonResults};
use crate::workbench::cameras::previews::{CapturePreviews, PreviewOrder};

/// Threads of calibrations, previews and comparisons: none waits for another.
pub(crate) struct CameraDesk {
    pub(crate) calibrations: LatestThread<CalibrationOrder>,
    pub(crate) previews: LatestThread<PreviewOrder>,
    pub(crate) comparisons: LatestThread<ComparisonOrder>,
}

/// The camera room as of now.
#[derive(Clone, Debug, Default)]
pub struct CameraResults {
    /// Frames and camera.
    pub calibration: CalibrationResults,
    /// State of the newest order of a calibration.
    pub calibration_state: WorkState,
    /// Previews of the captures.
    pub previews: CapturePreviews,
    /// State of the newest previews.
    pub previews_state: WorkState,
    /// The newest comparison.
    pub comparison: Option<Arc<ComparisonResults>>,
    /// State of the newest order of a comparison.
    pub comparison_state: WorkState,
}

impl CameraDesk {
    /// Starts the threads.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn start(wake: &Wake, threads: &Threads, activities: &Activities) -> std::io::Result<Self> {
        let settings = |name, work| ThreadSettings { name, work, threads: threads.clone(), wake: Arc::clone(wake) };
        Ok(Self {
            calibrations: LatestThread::start(settings("lenslet-camera", Work::Estimate), activities.clone())?,
            previews: LatestThread::start(settings("lenslet-preview", Work::Computation), activities.clone())?,
            comparisons: LatestThread::start(settings("lenslet-systems", Work::Estimate), activities.clone())?,
        })
    }

    /// What the window shows.
    pub fn results(&self) -> CameraResults {
        CameraResults {
            calibration: self.calibrations.results(),
            calibration_state: self.calibrations.state(),
            previews: self.previews.results(),
            previews_state: self.previews.state(),
            comparison: self.comparisons.results(),
            comparison_state: self.comparisons.state(),
        }
    }
}
