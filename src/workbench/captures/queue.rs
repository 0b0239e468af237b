//! Queue of captures: the newest order alone, and its state.

use std::sync::Arc;

use ndarray::Array3;

use crate::progress::CancelToken;
use crate::reconstruction::{CaptureFiles, DecoderKind};
use crate::workbench::background::activity::{Activities, ActivityHandle, ActivityKind};
use crate::workbench::background::mailbox::Queue;
use crate::workbench::reconstructions::queue::SeenRegion;

/// A capture to be reconstructed.
#[derive(Clone, Debug, PartialEq)]
pub struct CaptureOrder {
    /// Its files.
    pub files: CaptureFiles,
    /// The decoder, one that needs neither objects nor training.
    pub decoder: DecoderKind,
}

/// State of a capture.
#[derive(Clone, Debug, PartialEq)]
pub enum CaptureState {
    /// It waits, or its files are read.
    Reading,
    /// The decoder is at work.
    Reconstructing {
        /// Number of the channel, from 1.
        channel: usize,
        /// Number of channels.
        channels: usize,
        /// Iterations done.
        done: usize,
        /// Most iterations.
        most: usize,
    },
    /// It is complete.
    Done {
        /// Seconds from the order to the end.
        seconds: f64,
    },
    /// A person stopped it.
    Stopped,
    /// There is no reconstruction, for this reason.
    Failed(String),
}

impl CaptureState {
    /// Whether it is still computed.
    pub fn is_open(&self) -> bool {
        matches!(self, Self::Reading | Self::Reconstructing { .. })
    }
}

/// The capture and what a decoder makes of it; images of shape (rows, cols, channels), DN above the dark level.
#[derive(Clone, Debug)]
pub struct CaptureReconstruction {
    /// What was ordered.
    pub order: CaptureOrder,
    /// State of the order.
    pub state: CaptureState,
    /// Number that changes with every image.
    pub serial: u64,
    /// The capture.
    pub measurement: Option<Arc<Array3<f32>>>,
    /// The object, as far as it is known.
    pub object: Option<Arc<Array3<f32>>>,
    /// Part of the object before the sensor.
    pub seen: SeenRegion,
    /// How the files were read.
    pub notices: Vec<String>,
}

/// End of an order.
pub(crate) enum CaptureEnd {
    Done { seconds: f64 },
    Stopped,
    Failed(String),
}

/// The waiting and the running order, and the newest results.
pub(crate) struct CaptureQueue {
    activities: Activities,
    waiting: Option<(CaptureOrder, ActivityHandle)>,
    running: Option<(u64, CancelToken)>,
    newest: Option<CaptureReconstruction>,
}

impl CaptureQueue {
    /// An empty queue.
    pub fn new(activities: Activities) -> Self {
        Self { activities, waiting: None, running: None, newest: None }
    }

    /// Orders a capture in place of earlier ones.
    pub fn order(&mut self, order: CaptureOrder) {
        if let Some((_, cancel)) = &self.running {
            cancel.cancel();
        }
        let name = format!("Reconstruct {}", order.files.measurement.display());
        let entry = self.activities.add(ActivityKind::Capture, name);
        self.newest = Some(CaptureReconstruction {
            order: order.clone(),
            state: CaptureState::Reading,
            serial: self.newest.as_ref().map_or(0, |known| known.serial) + 1,
            measurement: None,
            object: None,
            seen: SeenRegion { corner: (0, 0), shape: (0, 0) },
            notices: Vec::new(),
        });
        self.waiting = Some((order, entry));
    }

    /// Stops the running and the waiting order.
    pub fn cancel(&mut self) {
        if self.waiting.take().is_some()
            && let Some(newest) = &mut self.newest
        {
            newest.state = CaptureState::Stopped;
        }
        if let Some((_, cancel)) = &self.running {
            cancel.cancel();
        }
    }

    /// The newest order with its results.
    pub fn newest(&self) -> Option<&CaptureReconstruction> {
        self.newest.as_ref()
    }

    /// Changes the results of the running order, unless a newer one waits.
    pub fn publish(&mut self, change: impl FnOnce(&mut CaptureReconstruction)) {
        if self.waiting.is_none()
            && let Some(newest) = &mut self.newest
        {
            change(newest);
            newest.serial += 1;
        }
    }
}

impl Queue for CaptureQueue {
    type Task = (CaptureOrder, ActivityHandle);
    type Answer = CaptureEnd;

    fn next(&mut self, cancel: &CancelToken) -> Option<Self::Task> {
        let (order, entry) = self.waiting.take()?;
        entry.begin();
        self.running = Some((entry.number(), cancel.clone()));
        Some((order, entry))
    }

    fn end(&mut self, (_, entry): Self::Task, answer: Result<CaptureEnd, String>) {
        self.running = None;
        let state = match answer {
            Ok(CaptureEnd::Done { seconds }) => {
                entry.end(Ok(format!("done in {seconds:.1} s")));
                CaptureState::Done { seconds }
            }
            // The dropped entry counts as stopped.
            Ok(CaptureEnd::Stopped) => CaptureState::Stopped,
            Ok(CaptureEnd::Failed(sentence)) | Err(sentence) => {
                entry.end(Err(sentence.clone()));
                CaptureState::Failed(sentence)
            }
        };
        self.publish(|newest| newest.state = state);
    }

    fn close(&mut self) {
        self.waiting = None;
    }
}
