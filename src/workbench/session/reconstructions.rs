//! Reconstructions of a session: of its measurements, and of captures.

use crate::workbench::captures::queue::{CaptureOrder, CaptureQueue, CaptureReconstruction};
use crate::workbench::reconstructions::queue::{ReconstructionQueue, ReconstructionRequest, Reconstructions};
use crate::workbench::session::Session;

impl Session {
    /// Requests what a decoder makes of a measurement; replaces an earlier request.
    pub fn reconstruct(&self, request: ReconstructionRequest) {
        self.reconstructor.change(|queue| queue.request(request));
    }

    /// Stops the running reconstruction, whose results so far stay.
    pub fn stop_reconstruction(&self) {
        self.reconstructor.change(ReconstructionQueue::stop);
    }

    /// The latest reconstructions; compare their keys with [`Session::revision`].
    pub fn reconstructions(&self) -> Reconstructions {
        self.reconstructor.look(|queue| queue.results().clone())
    }

    /// Whether results of the requested reconstruction are still to come.
    pub fn is_reconstructing(&self) -> bool {
        self.reconstructor.look(ReconstructionQueue::is_computing)
    }

    /// Reconstructs a capture in place of earlier ones.
    pub fn reconstruct_capture(&self, order: CaptureOrder) {
        self.capturer.publish(|queue| queue.order(order));
    }

    /// Stops the reconstruction of the capture.
    pub fn stop_capture(&self) {
        self.capturer.publish(CaptureQueue::cancel);
    }

    /// The newest capture with its results.
    pub fn capture(&self) -> Option<CaptureReconstruction> {
        self.capturer.look(|queue| queue.newest().cloned())
    }
}
