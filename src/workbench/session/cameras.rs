//! The camera room of a session.

use std::path::Path;
use std::sync::Arc;

use crate::formats::FormatError;
use crate::workbench::cameras::calibration::CalibrationOrder;
use crate::workbench::cameras::comparison::ComparisonOrder;
use crate::workbench::cameras::desk::CameraResults;
use crate::workbench::cameras::previews::{PreviewOrder, SystemCaptures};
use crate::workbench::session::Session;

/// File of the newest comparison of systems.
const COMPARISON: &str = "comparison.json";

impl Session {
    /// Groups frames, calibrates a camera or opens its file, in place of earlier orders.
    pub fn calibrate(&self, order: CalibrationOrder) {
        self.cameras.calibrations.order(order);
    }

    /// Stops the calibration.
    pub fn stop_calibration(&self) {
        self.cameras.calibrations.cancel();
    }

    /// Reads captures for their previews, in place of earlier ones.
    pub fn preview_captures(&self, captures: Arc<SystemCaptures>) {
        self.cameras.previews.order(PreviewOrder(captures));
    }

    /// Estimates and compares systems, in place of an earlier comparison.
    pub fn compare_systems(&self, order: ComparisonOrder) {
        self.cameras.compare(order);
    }

    /// Stores the newest comparison of systems in a folder, and loads the one in it.
    ///
    /// # Errors
    /// Where the folder holds a comparison that cannot be read.
    pub fn keep_comparison_in(&mut self, folder: &Path) -> Result<(), FormatError> {
        self.cameras.keep_comparison_in(folder.join(COMPARISON))
    }

    /// Stops the comparison of systems. The last finished one stays.
    pub fn stop_comparison(&self) {
        self.cameras.comparisons.cancel();
    }

    /// Calibration, previews and comparison as of now.
    pub fn cameras(&self) -> CameraResults {
        self.cameras.results()
    }
}
