//! Reconstructions of a session: of its measurements, and of captures.

use crate::workbench::captures::queue::{CaptureOrder, CaptureReconstruction};
use crate::workbench::reconstructions::queue::{ReconstructionRequest, Reconstructions};
use crate::workbench::session::Session;

impl Session {
    /// Requests what a decoder makes of a measurement; replaces an earlier request.
    pub fn reconstruct(&self, request: ReconstructionRequest) {
        self.reconstructor.request(request);
    }

    /// Stops the running reconstruction, whose results so far stay.
    pub fn stop_reconstruction(&self) {
        self.reconstructor.stop();
    }

    /// The latest reconstructions; compare their keys with [`Session::revision`].
    pub fn reconstructions(&self) -> Reconstructions {
        self.reconstructor.results()
    }

    /// Whether results of the requested reconstruction are still to come.
    pub fn is_reconstructing(&self) -> bool {
        self.reconstructor.is_computing()
    }

    /// Reconstructs a capture in place of earlier ones.
    pub fn reconstruct_capture(&self, order: CaptureOrder) {
        self.capturer.order(order);
    }

    /// Stops the reconstruction of the capture.
    pub fn stop_capture(&self) {
        self.capturer.cancel();
    }

    /// The newest capture with its results.
    pub fn capture(&self) -> Option<CaptureReconstruction> {
        self.capturer.newest()
    }
}
