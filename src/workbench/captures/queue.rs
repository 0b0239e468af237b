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

/// How a decoder ended; of several channels the most iterations and the largest residual.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CaptureQuality {
    /// Iterations done and most iterations, where the decoder iterates.
    pub iterations: Option<(usize, usize)>,
    /// Root mean square of the residual, in units of the estimated noise.
    pub residual: f64,
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
        /// How the decoder ended.
        quality: CaptureQuality,
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
    /// Order of the images, where they are the complete ones of an earlier order. They stay until the newest one has an object.
    pub earlier: Option<CaptureOrder>,
}

impl CaptureReconstruction {
    /// Whether the object is complete.
    pub fn is_complete(&self) -> bool {
        self.earlier.is_some() || matches!(self.state, CaptureState::Done { .. })
    }
}

/// End of an order.
pub(crate) enum CaptureEnd {
    Done { seconds: f64, quality: CaptureQuality },
    Stopped,
    Failed(String),
}

/// The waiting and the running order, and the newest results.
pub(crate) struct CaptureQueue {
    activities: Activities,
    waiting: Option<(CaptureOrder, ActivityHandle)>,
    running: Option<(u64, CancelToken)>,
    newest: Option<CaptureReconstruction>,
    /// Capture and notices of the running order, while images of an earlier one are shown.
    unseen: Option<(Arc<Array3<f32>>, Vec<String>)>,
}

impl CaptureQueue {
    /// An empty queue.
    pub fn new(activities: Activities) -> Self {
        Self { activities, waiting: None, running: None, newest: None, unseen: None }
    }

    /// Orders a capture in place of earlier ones. The images of a complete one stay until this one has an object.
    pub fn order(&mut self, order: CaptureOrder) {
        if let Some((_, cancel)) = &self.running {
            cancel.cancel();
        }
        let name = format!("Reconstruct {}", order.files.measurement.display());
        let entry = self.activities.add(ActivityKind::Capture, name);
        self.unseen = None;
        let before = self.newest.take();
        let serial = before.as_ref().map_or(0, |known| known.serial) + 1;
        let complete = before.filter(CaptureReconstruction::is_complete).map(|known| {
            let earlier = known.earlier.clone().or(Some(known.order.clone()));
            CaptureReconstruction { order: order.clone(), state: CaptureState::Reading, serial, earlier, ..known }
        });
        self.newest = complete.or(Some(CaptureReconstruction {
            order: order.clone(),
            state: CaptureState::Reading,
            serial,
            measurement: None,
            object: None,
            seen: SeenRegion { corner: (0, 0), shape: (0, 0) },
            notices: Vec::new(),
            earlier: None,
        }));
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

    /// Receives the capture of the running order and how its files were read.
    pub fn publish_measurement(&mut self, measurement: Arc<Array3<f32>>, notices: Vec<String>) {
        if self.waiting.is_none() {
            self.unseen = Some((measurement, notices));
        }
        if self.newest.as_ref().is_some_and(|newest| newest.earlier.is_none()) {
            self.show_measurement();
        }
    }

    /// Receives the object of the running order as far as it is known. It takes the place of earlier images.
    pub fn publish_object(&mut self, object: Arc<Array3<f32>>, seen: SeenRegion, state: CaptureState) {
        self.show_measurement();
        self.publish(|newest| (newest.object, newest.seen, newest.state) = (Some(object), seen, state));
    }

    /// Shows the capture of the running order.
    fn show_measurement(&mut self) {
        if let Some((measurement, notices)) = self.unseen.take() {
            self.publish(|newest| {
                (newest.measurement, newest.notices) = (Some(measurement), notices);
                (newest.object, newest.earlier) = (None, None);
            });
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
            Ok(CaptureEnd::Done { seconds, quality }) => {
                entry.end(Ok(format!("done in {seconds:.1} s")));
                CaptureState::Done { seconds, quality }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn order(name: &str) -> CaptureOrder {
        let files = CaptureFiles { measurement: name.into(), psf: "psf.tif".into(), dark: None, bin: 1 };
        CaptureOrder { files, decoder: DecoderKind::RichardsonLucy }
    }

    fn image(value: f32) -> Arc<Array3<f32>> {
        Arc::new(Array3::from_elem((2, 2, 1), value))
    }

    const SEEN: SeenRegion = SeenRegion { corner: (0, 0), shape: (2, 2) };

    /// A queue whose first order is complete.
    fn with_complete_order() -> CaptureQueue {
        let mut queue = CaptureQueue::new(Activities::default());
        queue.order(order("first.tif"));
        let task = queue.next(&CancelToken::new()).unwrap();
        queue.publish_measurement(image(1.0), vec!["first".into()]);
        queue.publish_object(image(2.0), SEEN, CaptureState::Reading);
        queue.end(task, Ok(CaptureEnd::Done { seconds: 1.0, quality: CaptureQuality::default() }));
        queue
    }

    #[test]
    fn complete_images_stay_when_the_next_order_fails() {
        let mut queue = with_complete_order();
        for _ in 0..2 {
            queue.order(order("second.tif"));
            let task = queue.next(&CancelToken::new()).unwrap();
            queue.end(task, Ok(CaptureEnd::Failed("no file".into())));
            let newest = queue.newest().unwrap();
            assert_eq!((&newest.state, newest.is_complete()), (&CaptureState::Failed("no file".into()), true));
            assert_eq!((&newest.object, &newest.measurement), (&Some(image(2.0)), &Some(image(1.0))));
            assert_eq!(newest.earlier, Some(order("first.tif")));
        }
    }

    #[test]
    fn complete_images_stay_until_the_next_order_has_an_object() {
        let mut queue = with_complete_order();
        queue.order(order("second.tif"));
        let task = queue.next(&CancelToken::new()).unwrap();
        queue.publish_measurement(image(3.0), vec!["second".into()]);
        let newest = queue.newest().unwrap();
        assert_eq!((&newest.measurement, &newest.notices), (&Some(image(1.0)), &vec!["first".to_owned()]));
        queue.publish_object(image(4.0), SEEN, CaptureState::Reading);
        let newest = queue.newest().unwrap();
        assert_eq!((&newest.object, &newest.measurement), (&Some(image(4.0)), &Some(image(3.0))));
        assert_eq!((&newest.earlier, newest.is_complete()), (&None, false));
        queue.end(task, Ok(CaptureEnd::Stopped));
        queue.order(order("third.tif"));
        assert_eq!(queue.newest().unwrap().object, None, "an incomplete object does not stay");
    }
}
