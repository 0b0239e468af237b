//! The thread of captures.

use crate::workbench::background::activity::Activities;
use crate::workbench::background::mailbox::{MailboxThread, ThreadSettings};
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::captures::computation;
use crate::workbench::captures::queue::CaptureQueue;

/// Starts the thread. Dropping it stops the running order.
///
/// # Errors
/// Where the operating system gives no thread.
pub(crate) fn start(
    wake: Wake,
    threads: Threads,
    activities: Activities,
) -> std::io::Result<MailboxThread<CaptureQueue>> {
    let settings = ThreadSettings { name: "lenslet-capture", work: Work::Reconstruction, threads, wake };
    MailboxThread::start(settings, CaptureQueue::new(activities), || computation::run)
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::mpsc::{Receiver, channel};
    use std::sync::{Arc, Mutex};

    use ndarray::{Array2, Array3, Axis};

    use super::*;
    use crate::reconstruction::{CaptureFiles, DecoderKind};
    use crate::sensor::Convolution;
    use crate::workbench::background::activity::ActivityState;
    use crate::workbench::background::threads::lock;
    use crate::workbench::captures::queue::{CaptureOrder, CaptureReconstruction, CaptureState};

    /// Three spots before a mask of two, in colour where `channels` is 3.
    fn write_capture(folder: &Path, channels: usize) -> CaptureOrder {
        let mut psf = Array2::<f64>::zeros((9, 9));
        (psf[(2, 3)], psf[(6, 5)]) = (0.6, 0.4);
        let mut object = Array3::<f32>::zeros((1, 40, 44));
        for (row, col) in [(10, 12), (20, 30), (31, 20)] {
            object.slice_mut(ndarray::s![0, row..row + 3, col..col + 3]).fill(600.0);
        }
        let plan = Convolution::new((40, 44), (9, 9)).unwrap().with_psf(psf.view().insert_axis(Axis(0))).unwrap();
        let measured = plan.measure(object.view().insert_axis(Axis(1)), 0.0).unwrap();
        let measured = crate::sensor::Noise::Shot.draw(measured.view(), 3).index_axis_move(Axis(0), 0);
        let coloured = |image: Array2<f32>| {
            let (rows, cols) = image.dim();
            Array3::from_shape_fn((rows, cols, channels), |(row, col, _)| image[(row, col)]).into_dyn()
        };
        let psf = psf.mapv(|value| (1000.0 * value) as f32);
        let paths = ["capture.npy", "psf.npy"].map(|name| folder.join(name));
        for (path, image) in paths.iter().zip([measured, psf]) {
            let image = if channels == 1 { image.into_dyn() } else { coloured(image) };
            crate::formats::write_array(path, image.view()).unwrap();
        }
        let [measurement, psf] = paths;
        let files = CaptureFiles { measurement, psf, dark: None, bin: 1 };
        CaptureOrder { files, decoder: DecoderKind::RichardsonLucy }
    }

    fn capturer() -> (MailboxThread<CaptureQueue>, Activities, Receiver<()>) {
        let (wake, woken) = channel();
        let wake = Mutex::new(wake);
        let wake: Wake = Arc::new(move || lock(&wake).send(()).unwrap_or_default());
        let activities = Activities::default();
        (start(wake, Threads::default(), activities.clone()).unwrap(), activities, woken)
    }

    /// The newest order once it is no longer open.
    fn ended(capturer: &MailboxThread<CaptureQueue>, woken: &Receiver<()>) -> CaptureReconstruction {
        loop {
            let newest = capturer.look(|queue| queue.newest().cloned()).unwrap();
            if !newest.state.is_open() {
                return newest;
            }
            woken.recv().unwrap();
        }
    }

    #[test]
    fn capture_is_reconstructed_with_its_images_and_its_activity() {
        let folder = tempfile::tempdir().unwrap();
        let (capturer, activities, woken) = capturer();
        let order = write_capture(folder.path(), 1);
        capturer.publish(|queue| queue.order(order.clone()));
        let found = ended(&capturer, &woken);
        assert!(matches!(found.state, CaptureState::Done { .. }), "{:?}", found.state);
        assert_eq!(found.measurement.unwrap().dim(), (32, 36, 1));
        let object = found.object.unwrap();
        assert_eq!((object.dim(), found.seen.shape), ((40, 44, 1), (32, 36)));
        assert!(object[(21, 31, 0)] > 5.0 * object.mean().unwrap(), "a spot is bright");
        assert!(matches!(activities.all()[0].state, ActivityState::Done(_)));
    }

    #[test]
    fn missing_file_is_one_sentence_and_the_next_order_works() {
        let folder = tempfile::tempdir().unwrap();
        let (capturer, activities, woken) = capturer();
        let order = write_capture(folder.path(), 1);
        let missing = CaptureFiles { psf: folder.path().join("none.tif"), ..order.files.clone() };
        capturer.publish(|queue| queue.order(CaptureOrder { files: missing, ..order.clone() }));
        let found = ended(&capturer, &woken);
        assert!(matches!(&found.state, CaptureState::Failed(sentence) if sentence.contains("none.tif")), "{found:?}");
        assert!(matches!(activities.all()[0].state, ActivityState::Failed(_)));
        capturer.publish(|queue| queue.order(order));
        assert!(matches!(ended(&capturer, &woken).state, CaptureState::Done { .. }));
    }

    #[test]
    fn cancelled_order_is_stopped() {
        let folder = tempfile::tempdir().unwrap();
        let (capturer, activities, woken) = capturer();
        let order = write_capture(folder.path(), 1);
        capturer.publish(|queue| queue.order(order));
        capturer.publish(CaptureQueue::cancel);
        let found = ended(&capturer, &woken);
        // It may have ended before it could be stopped.
        assert!(matches!(found.state, CaptureState::Stopped | CaptureState::Done { .. }), "{:?}", found.state);
        assert!(!activities.all()[0].is_open());
    }
}
