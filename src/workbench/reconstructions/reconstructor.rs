//! The thread of reconstructions.

use crate::workbench::background::mailbox::{MailboxThread, ThreadSettings};
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::reconstructions::computation::ReconstructionComputation;
use crate::workbench::reconstructions::queue::ReconstructionQueue;

/// Starts the thread. Dropping it cancels the running reconstruction.
///
/// # Errors
/// Where the operating system gives no thread.
pub(crate) fn start(wake: Wake, threads: Threads) -> std::io::Result<MailboxThread<ReconstructionQueue>> {
    let settings = ThreadSettings { name: "lenslet-reconstructor", work: Work::Reconstruction, threads, wake };
    MailboxThread::start(settings, ReconstructionQueue::default(), ReconstructionComputation::default)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;
    use std::sync::{Arc, Mutex};

    use super::*;
    use crate::evaluation::scene::{Optics, Scene, SceneTables};
    use crate::forward::{Design, ForwardModel};
    use crate::information::Protocol;
    use crate::progress::CancelToken;
    use crate::reconstruction::{DecoderKind, DecoderScene, DecoderTest, ReconstructionError};
    use crate::workbench::background::threads::lock;
    use crate::workbench::reconstructions::networks::Networks;
    use crate::workbench::reconstructions::queue::{ReconstructionKey, ReconstructionRequest, Reconstructions};

    fn request(design: Design, decoder: DecoderKind, test_objects: usize) -> ReconstructionRequest {
        let design = Arc::new(design);
        let scene = Arc::new(Scene::open(&design, &mut CancelToken::new()).unwrap());
        let optics = Arc::new(Optics::of(&design, scene.set.planes()).unwrap());
        let tables = SceneTables::new(&scene, design.encoder.grid()).unwrap();
        let measurements = Arc::new(tables.measure(&design, &optics, &scene).unwrap());
        let key = ReconstructionKey { revision: 1, sample: 2, noisy: true, decoder, networks: 0 };
        let networks = Networks::default();
        ReconstructionRequest {
            key,
            design,
            scene,
            optics,
            measurements,
            test_objects,
            with_deviation: false,
            networks,
        }
    }

    /// Results of a request, once it is done.
    fn results(request: ReconstructionRequest) -> Reconstructions {
        let (wake, woken) = channel();
        let wake = Mutex::new(wake);
        let wake: Wake = Arc::new(move || lock(&wake).send(()).unwrap_or_default());
        let reconstructor = start(wake, Threads::default()).unwrap();
        reconstructor.change(|queue| queue.request(request));
        while reconstructor.look(ReconstructionQueue::is_computing) {
            woken.recv().unwrap();
        }
        reconstructor.look(|queue| queue.results().clone())
    }

    #[test]
    fn quality_on_the_test_set_is_that_of_the_library() {
        let request = request(Design::default(), DecoderKind::Linear, 20);
        let found = results(request.clone());
        assert!(found.failure.is_none() && found.shown.unwrap().key == request.key);
        let set = found.set.unwrap();
        assert_eq!((set.planned, set.quality.test_objects), (20, 20));
        let forward = ForwardModel::open(&request.design).unwrap();
        let scene = DecoderScene::new(&forward, Protocol::Default).unwrap();
        let model = scene.model(forward.psf(&request.design).unwrap().view()).unwrap();
        let prior = Arc::new(scene.prior(&CancelToken::new()).unwrap());
        let decoder = DecoderKind::Linear.decoder(Some(prior), None).unwrap();
        let test = DecoderTest { objects: 20, seed: request.design.seed };
        let expected = test
            .run::<ReconstructionError>(&*decoder, &scene, &model, &mut CancelToken::new(), &mut |_| Ok(()))
            .unwrap();
        assert_eq!(
            (set.quality.psnr_db, set.quality.psnr_db_interval_95),
            (expected.psnr_db, expected.psnr_db_interval_95)
        );
        assert_eq!((set.quality.ssim, set.quality.r2), (expected.ssim, expected.r2));
        assert_eq!(set.quality.psnr_constant_db, expected.psnr_constant_db);
    }

    #[test]
    fn objects_with_depth_are_refused_in_one_sentence() {
        let design = Design { objects: "volume:3:0.02".parse().unwrap(), ..Design::default() };
        let found = results(request(design, DecoderKind::Linear, 0));
        assert!(found.shown.is_none());
        assert!(found.failure.unwrap().1.contains("expected objects of one plane, found 3"));
    }
}
