//! The live estimate and ordered estimates of a session.

use std::path::Path;
use std::sync::Arc;

use crate::evaluation::measured::MeasuredOrder;
use crate::evaluation::request::EstimateRequest;
use crate::formats::FormatError;
use crate::workbench::estimates::files::{EstimateOrder, FinishedEstimate};
use crate::workbench::estimates::queue::Estimates;
use crate::workbench::session::Session;

impl Session {
    /// Live estimate and ordered estimates; compare their revisions with [`Session::revision`].
    pub fn estimates(&self) -> Estimates {
        self.worker.estimator().estimates()
    }

    /// Whether live estimates are computed.
    pub fn is_live(&self) -> bool {
        self.worker.estimator().is_live()
    }

    /// Switches live estimates on or off.
    pub fn set_live(&self, live: bool) {
        self.worker.estimator().set_live(live);
    }

    /// Divides all times in the schedule of live estimates by `speed`, from the next one on. The schedule of 1 suits a person who edits on a
    /// two-core machine. Higher speeds give the first and the last number sooner, from shorter fits; they serve programs and tests.
    pub fn set_live_speed(&self, speed: f64) {
        self.worker.estimator().set_live_speed(speed);
    }

    /// Orders an estimate of the design as it is now.
    ///
    /// # Errors
    /// One sentence where too many orders wait.
    pub fn order_estimate(&self, request: EstimateRequest) -> Result<(), String> {
        let (design, revision) = (Arc::clone(&self.design), self.revision);
        self.worker.estimator().order(EstimateOrder { design, revision, request, measured: None })
    }

    /// Orders an estimate of images of a camera, whose noise is that of the open design.
    ///
    /// # Errors
    /// One sentence where too many orders wait.
    pub fn order_estimate_of_images(&self, measured: MeasuredOrder, request: EstimateRequest) -> Result<(), String> {
        let (design, revision) = (Arc::clone(self.open_design()), self.revision);
        self.worker.estimator().order(EstimateOrder { design, revision, request, measured: Some(measured) })
    }

    /// Stores estimates in a folder and loads those in it. The interrupted one resumes.
    ///
    /// # Errors
    /// Where the folder cannot be created.
    pub fn keep_estimates_in(&self, folder: &Path) -> Result<(), FormatError> {
        self.worker.estimator().keep_in(folder)
    }

    /// Whether the next session can resume the running estimate.
    pub fn keeps_estimates(&self) -> bool {
        self.worker.estimator().keeps_orders()
    }

    /// Restores the finished estimate that was deleted last to its place.
    pub fn bring_back_estimate(&self) {
        self.worker.estimator().bring_back();
    }

    /// Deletes a finished estimate and its file; it can be [brought back](Session::bring_back_estimate).
    pub fn delete_estimate(&self, finished: &Arc<FinishedEstimate>) {
        self.worker.estimator().delete(finished);
    }

    /// Stops the running estimate.
    pub fn cancel_estimate(&self) {
        self.worker.estimator().cancel();
    }
}
