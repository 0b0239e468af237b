//! Queue of reconstructions: the newest request alone, and its results as they come.

use std::sync::Arc;

use ndarray::{Array2, ArrayView2, Axis};

use crate::evaluation::scene::{Measurements, Optics, Scene};
use crate::forward::Design;
use crate::progress::CancelToken;
use crate::reconstruction::{DecoderKind, DecoderQuality, ImageQuality, TrainedNetwork};
use crate::workbench::background::mailbox::Queue;
use crate::workbench::reconstructions::networks::{NetworkFit, Networks};

/// Identifies a reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReconstructionKey {
    /// Revision of the design.
    pub revision: u64,
    /// Index of the measurement.
    pub sample: usize,
    /// Whether the measurement has noise.
    pub noisy: bool,
    /// The decoder.
    pub decoder: DecoderKind,
    /// Number of the networks that it chooses from; 0 for decoders without training.
    pub networks: u64,
}

impl ReconstructionKey {
    /// Whether the other one is by the same decoder for the same design.
    pub fn has_decoder_of(&self, other: &Self) -> bool {
        (self.revision, self.decoder, self.networks) == (other.revision, other.decoder, other.networks)
    }
}

/// Request for the reconstruction of a measurement.
#[derive(Clone)]
pub struct ReconstructionRequest {
    /// Key of the reconstruction.
    pub key: ReconstructionKey,
    /// The design.
    pub design: Arc<Design>,
    /// Its objects.
    pub scene: Arc<Scene>,
    /// Its PSF.
    pub optics: Arc<Optics>,
    /// Its measurements.
    pub measurements: Arc<Measurements>,
    /// Objects of the test set; 0 where only the image is wanted.
    pub test_objects: usize,
    /// Whether the posterior standard deviation is wanted, which takes longer than the image.
    pub with_deviation: bool,
    /// Trained networks.
    pub networks: Networks,
}

impl ReconstructionRequest {
    /// The object, shape (rows, cols), photons per pixel; its first plane where it has several.
    pub fn object(&self) -> ArrayView2<'_, f32> {
        let last = self.scene.objects.len_of(Axis(0)).saturating_sub(1);
        self.scene.objects.index_axis(Axis(0), self.key.sample.min(last)).index_axis_move(Axis(0), 0)
    }

    /// The measurement, shape (rows, cols), photons per pixel.
    pub fn measurement(&self) -> ArrayView2<'_, f32> {
        let stack = if self.key.noisy { &self.measurements.noisy } else { &self.measurements.noiseless };
        let last = stack.len_of(Axis(0)).saturating_sub(1);
        stack.index_axis(Axis(0), self.key.sample.min(last))
    }
}

/// The part of an object that lies before the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SeenRegion {
    /// First row and column.
    pub corner: (usize, usize),
    /// Rows and columns.
    pub shape: (usize, usize),
}

/// Reconstruction of one measurement.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Its key.
    pub key: ReconstructionKey,
    /// Number that no other reconstructed object has.
    pub serial: u64,
    /// The object that was measured, shape (rows, cols), photons per pixel.
    pub truth: Arc<Array2<f32>>,
    /// The reconstructed object, shape (rows, cols), photons per pixel.
    pub object: Arc<Array2<f32>>,
    /// Object minus reconstruction, shape (rows, cols), photons per pixel.
    pub error: Arc<Array2<f32>>,
    /// Largest size of a value of the error, above 0.
    pub largest_error: f32,
    /// Part before the sensor.
    pub seen: SeenRegion,
    /// Iterations done and most iterations, while the decoder iterates.
    pub iterations: Option<(usize, usize)>,
    /// Photons per pixel of a truth of 1, the unit of the quality.
    pub peak_photons: f64,
    /// Quality of the object once it is complete; none below 11 px a side.
    pub quality: Option<ImageQuality>,
    /// Posterior standard deviation, shape (rows, cols), photons per pixel, where the decoder has one.
    pub standard_deviation: Option<Arc<Array2<f32>>>,
    /// Which network serves the design, where the decoder is one. Without, the object is the linear estimate.
    pub network: Option<NetworkFit>,
}

impl Reconstruction {
    /// The decoder of the object: the linear one where no network serves the design.
    pub fn decoder(&self) -> DecoderKind {
        self.network.as_ref().map_or(self.key.decoder, NetworkFit::decoder)
    }

    /// What the standard deviation is of, where it is not computed with the shown object.
    pub fn deviation_of(&self) -> Option<&'static str> {
        match self.key.decoder {
            DecoderKind::Network => {
                let network = self.trained_network().filter(|network| !network.is_linear());
                network.map(|_| "of the linear estimate")
            }
            DecoderKind::Posterior => Some("of Markov chains"),
            _ => None,
        }
    }

    /// The trained network of the object, where one serves the design.
    pub fn trained_network(&self) -> Option<&Arc<TrainedNetwork>> {
        match &self.network {
            Some(NetworkFit::Current(network)) => Some(network),
            _ => None,
        }
    }
}

/// Quality of a decoder on the part of the test set that is done.
#[derive(Clone, Debug)]
pub struct SetQuality {
    /// Key of a reconstruction of the design.
    pub key: ReconstructionKey,
    /// Mean quality with intervals.
    pub quality: DecoderQuality,
    /// Objects of the whole test set.
    pub planned: usize,
}

/// The latest results.
#[derive(Clone, Debug, Default)]
pub struct Reconstructions {
    /// The newest reconstruction.
    pub shown: Option<Arc<Reconstruction>>,
    /// The newest quality on a test set.
    pub set: Option<Arc<SetQuality>>,
    /// Why the newest request has no reconstruction.
    pub failure: Option<(ReconstructionKey, String)>,
}

impl Reconstructions {
    /// Quality on a test set by the decoder of this key.
    pub fn set_of(&self, key: ReconstructionKey) -> Option<&SetQuality> {
        self.set.as_deref().filter(|set| set.key.has_decoder_of(&key))
    }
}

/// What runs.
struct Running {
    key: ReconstructionKey,
    has_published: bool,
    cancel: CancelToken,
}

/// The waiting and the running request, and the results.
#[derive(Default)]
pub(crate) struct ReconstructionQueue {
    waiting: Option<ReconstructionRequest>,
    running: Option<Running>,
    results: Reconstructions,
    last_serial: u64,
}

impl ReconstructionQueue {
    /// Requests a reconstruction; replaces a waiting request. While edits come quickly, a running reconstruction still gives its image.
    pub fn request(&mut self, request: ReconstructionRequest) {
        if let Some(Running { key, has_published, cancel }) = &self.running {
            let is_same_design = key.revision == request.key.revision;
            if *has_published || is_same_design {
                cancel.cancel();
            }
        }
        self.waiting = Some(request);
    }

    /// Drops the waiting request and cancels the running one.
    pub fn stop(&mut self) {
        self.waiting = None;
        if let Some(running) = &self.running {
            running.cancel.cancel();
        }
    }

    /// The latest results.
    pub fn results(&self) -> &Reconstructions {
        &self.results
    }

    /// Whether results are still to come.
    pub fn is_computing(&self) -> bool {
        self.waiting.is_some() || self.running.is_some()
    }

    /// Whether a complete reconstruction of this key is published.
    pub fn has_complete(&self, key: ReconstructionKey) -> bool {
        self.results.shown.as_ref().is_some_and(|shown| shown.key == key && shown.iterations.is_none())
    }

    /// Whether the published reconstruction has no posterior standard deviation.
    pub fn has_no_deviation(&self) -> bool {
        self.results.shown.as_ref().is_none_or(|shown| shown.standard_deviation.is_none())
    }

    /// Publishes a reconstruction and gives it its serial number.
    pub fn publish(&mut self, reconstruction: Reconstruction) {
        self.last_serial += 1;
        self.results.failure = None;
        self.results.shown = Some(Arc::new(Reconstruction { serial: self.last_serial, ..reconstruction }));
        if let Some(running) = &mut self.running {
            running.has_published = true;
            if self.waiting.is_some() {
                running.cancel.cancel();
            }
        }
    }

    /// Adds the posterior standard deviation of the published reconstruction.
    pub fn publish_standard_deviation(&mut self, standard_deviation: Array2<f32>) {
        if let Some(shown) = &mut self.results.shown {
            Arc::make_mut(shown).standard_deviation = Some(Arc::new(standard_deviation));
        }
    }

    /// Publishes the quality on a test set.
    pub fn publish_set(&mut self, set: SetQuality) {
        self.results.set = Some(Arc::new(set));
    }
}

impl Queue for ReconstructionQueue {
    type Task = ReconstructionRequest;
    /// Why there is no reconstruction; none of that where it was cancelled.
    type Answer = Option<String>;

    fn next(&mut self, cancel: &CancelToken) -> Option<ReconstructionRequest> {
        let request = self.waiting.take()?;
        self.running = Some(Running { key: request.key, has_published: false, cancel: cancel.clone() });
        Some(request)
    }

    fn end(&mut self, request: ReconstructionRequest, answer: Result<Option<String>, String>) {
        self.running = None;
        if let Some(failure) = answer.unwrap_or_else(Some) {
            self.results.failure = Some((request.key, failure));
        }
    }

    fn close(&mut self) {
        self.waiting = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(revision: u64, sample: usize) -> ReconstructionRequest {
        let design = Arc::new(Design::default());
        let scene = Arc::new(Scene::open(&design, &mut CancelToken::new()).unwrap());
        let optics = Arc::new(Optics::of(&design, 1).unwrap());
        let tables = crate::evaluation::scene::SceneTables::new(&scene, design.encoder.grid()).unwrap();
        let measurements = Arc::new(tables.measure(&design, &optics, &scene).unwrap());
        let key = ReconstructionKey { revision, sample, noisy: true, decoder: DecoderKind::Linear, networks: 0 };
        let networks = Networks::default();
        ReconstructionRequest {
            key,
            design,
            scene,
            optics,
            measurements,
            test_objects: 0,
            with_deviation: false,
            networks,
        }
    }

    fn image(key: ReconstructionKey) -> Reconstruction {
        let object = Arc::new(Array2::zeros((12, 12)));
        Reconstruction {
            key,
            serial: 0,
            truth: Arc::clone(&object),
            error: Arc::clone(&object),
            largest_error: 1.0,
            object,
            seen: SeenRegion { corner: (0, 0), shape: (12, 12) },
            iterations: None,
            peak_photons: 1.0,
            quality: None,
            standard_deviation: None,
            network: None,
        }
    }

    #[test]
    fn edits_wait_for_the_image_and_not_for_more() {
        let (mut queue, cancel) = (ReconstructionQueue::default(), CancelToken::new());
        let first = request(1, 0);
        queue.request(first.clone());
        assert_eq!(queue.next(&cancel).unwrap().key.revision, 1);
        let later = |revision| {
            let key = ReconstructionKey { revision, ..first.key };
            ReconstructionRequest { key, ..first.clone() }
        };
        queue.request(later(2));
        queue.request(later(3));
        assert!(!cancel.is_cancelled(), "it has no image yet");
        queue.publish(image(first.key));
        assert!(cancel.is_cancelled() && queue.has_complete(first.key));
        queue.end(first.clone(), Ok(None));
        let cancel = CancelToken::new();
        assert_eq!(queue.next(&cancel).unwrap().key.revision, 3, "the latest one wins");
        queue.request(ReconstructionRequest { key: ReconstructionKey { sample: 4, ..later(3).key }, ..later(3) });
        assert!(cancel.is_cancelled(), "another sample of the same design is wanted at once");
    }

    #[test]
    fn failure_stays_until_the_next_image() {
        let mut queue = ReconstructionQueue::default();
        let request = request(1, 0);
        let key = request.key;
        queue.request(request.clone());
        let task = queue.next(&CancelToken::new()).unwrap();
        queue.end(task, Ok(Some("no light".into())));
        assert_eq!(queue.results().failure, Some((key, "no light".to_owned())));
        assert!(!queue.is_computing());
        queue.publish(image(key));
        assert_eq!(queue.results().failure, None);
        let serial = queue.results().shown.as_ref().unwrap().serial;
        queue.publish(image(key));
        assert!(queue.results().shown.as_ref().unwrap().serial > serial);
    }
}
