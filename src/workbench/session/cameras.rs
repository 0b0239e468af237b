//! The camera room of a session.

use std::sync::Arc;

use crate::workbench::cameras::calibration::CalibrationOrder;
use crate::workbench::cameras::comparison::ComparisonOrder;
use crate::workbench::cameras::desk::CameraResults;
use crate::workbench::cameras::previews::{PreviewOrder, SystemCaptures};
use crate::workbench::session::Session;

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
        self.cameras.comparisons.order(order);
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
