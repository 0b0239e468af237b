//! The threads of the camera room.

use std::path::PathBuf;
use std::sync::Arc;

use crate::formats::FormatError;
use crate::workbench::background::activity::Activities;
use crate::workbench::background::latest::{LatestThread, WorkState};
use crate::workbench::background::mailbox::ThreadSettings;
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::cameras::calibration::{CalibrationOrder, CalibrationResults};
use crate::workbench::cameras::comparison::{ComparisonOrder, ComparisonResults, KeptComparison};
use crate::workbench::cameras::comparison_file;
use crate::workbench::cameras::previews::{CapturePreviews, PreviewOrder};

/// Threads of calibrations, previews and comparisons: none waits for another.
pub(crate) struct CameraDesk {
    pub(crate) calibrations: LatestThread<CalibrationOrder>,
    pub(crate) previews: LatestThread<PreviewOrder>,
    pub(crate) comparisons: LatestThread<KeptComparison>,
    /// File of the newest comparison; none where nothing is stored.
    comparison_file: Option<PathBuf>,
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
            comparison_file: None,
        })
    }

    /// Stores the newest comparison in a file, and loads the one in it.
    ///
    /// # Errors
    /// Where there is a file that cannot be read.
    pub fn keep_comparison_in(&mut self, file: PathBuf) -> Result<(), FormatError> {
        let earlier = if file.exists() { comparison_file::read(&file).map(Some) } else { Ok(None) };
        self.comparison_file = Some(file);
        if let Some(earlier) = earlier? {
            self.comparisons.restore(Some(Arc::new(earlier)));
        }
        Ok(())
    }

    /// Estimates and compares systems.
    pub fn compare(&self, order: ComparisonOrder) {
        self.comparisons.order(KeptComparison { order, file: self.comparison_file.clone() });
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
