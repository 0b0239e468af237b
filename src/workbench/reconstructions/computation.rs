//! Computation of reconstructions: prior and prepared decoder are kept, and the test set grows while the request stays.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use ndarray::{Array2, Array3, ArrayView2, Axis};
use rayon::prelude::*;

use crate::forward::ForwardModel;
use crate::information::Protocol;
use crate::objects::ObjectSet;
use crate::progress::CancelToken;
use crate::reconstruction::{
    Decoder, DecoderKind, DecoderQuality, DecoderScene, ImageQuality, ImagingModel, NetworkDecoder, PreparedDecoder,
    Prior, ReconstructionError, ReconstructionStep, TestScores, in_units_of,
};
use crate::workbench::background::mailbox::{Computation, Mailbox};
use crate::workbench::reconstructions::networks::NetworkFit;
use crate::workbench::reconstructions::queue::{
    Reconstruction, ReconstructionKey, ReconstructionQueue, ReconstructionRequest, SeenRegion, SetQuality,
};

/// Test objects between two numbers.
const PART: usize = 8;

/// What is kept between requests.
#[derive(Default)]
pub(crate) struct ReconstructionComputation {
    /// The prior of the last set of objects.
    prior: Option<(Arc<ObjectSet>, Arc<Prior>)>,
    ready: Option<Ready>,
}

/// A decoder that is ready for one design, and its quality so far.
struct Ready {
    /// Sample and noise do not matter.
    key: ReconstructionKey,
    scene: DecoderScene,
    model: ImagingModel,
    /// Which network serves the design, where the decoder is one.
    network: Option<NetworkFit>,
    decoder: Box<dyn PreparedDecoder>,
    scores: TestScores,
    seconds: f64,
}

impl Computation<ReconstructionQueue> for ReconstructionComputation {
    fn run(
        &mut self,
        request: &ReconstructionRequest,
        cancel: &CancelToken,
        mailbox: &Mailbox<ReconstructionQueue>,
    ) -> Option<String> {
        match self.reconstruct(request, cancel, mailbox) {
            Ok(()) | Err(ReconstructionError::Cancelled) => None,
            Err(error) => Some(error.to_string()),
        }
    }
}

impl ReconstructionComputation {
    fn reconstruct(
        &mut self,
        request: &ReconstructionRequest,
        cancel: &CancelToken,
        mailbox: &Mailbox<ReconstructionQueue>,
    ) -> Result<(), ReconstructionError> {
        let key = request.key;
        let known = self.ready.take().filter(|ready| ready.key.has_decoder_of(&key));
        let ready = match known {
            Some(ready) => ready,
            None => self.prepare(request, cancel)?,
        };
        let ready = self.ready.insert(ready);
        let measurement = request.measurement();
        if !mailbox.look(|queue| queue.has_complete(key)) {
            ready.image(request, cancel, mailbox)?;
        }
        let is_missing = || mailbox.look(ReconstructionQueue::has_no_deviation);
        if request.with_deviation
            && is_missing()
            && let Some(deviation) = ready.decoder.standard_deviation(measurement, cancel)?
        {
            mailbox.publish(|queue| queue.publish_standard_deviation(deviation));
        }
        while ready.scores.count() < request.test_objects {
            match ready.test(request, cancel) {
                // Small objects have an image and no numbers.
                Err(ReconstructionError::SmallImage { .. }) => break,
                done => done?,
            }
            let quality = ready.so_far(request.design.seed)?;
            let set = SetQuality { key, quality, planned: request.test_objects };
            mailbox.publish(|queue| queue.publish_set(set));
        }
        Ok(())
    }

    fn prepare(&mut self, request: &ReconstructionRequest, cancel: &CancelToken) -> Result<Ready, ReconstructionError> {
        let ReconstructionRequest { key, design, scene, optics, .. } = request;
        let forward = ForwardModel::of_objects(design, Arc::clone(&scene.set))?;
        let scene = DecoderScene::new(&forward, Protocol::Default)?;
        let model = scene.model(optics.psf.slice(ndarray::s![..1, .., ..]))?.of_mask(&design.encoder);
        let prior = if key.decoder.needs().objects { Some(self.prior(&scene, cancel)?) } else { None };
        let network = (key.decoder == DecoderKind::Network).then(|| request.networks.fit(&scene, &model));
        let began = Instant::now();
        let decoder: Box<dyn Decoder> = match (&network, prior) {
            (Some(NetworkFit::Current(network)), Some(prior)) => {
                Box::new(NetworkDecoder::new(Arc::clone(network), &scene, prior)?)
            }
            (Some(_), prior) => DecoderKind::Linear.decoder(prior, None)?,
            (None, prior) => key.decoder.decoder(prior, None)?,
        };
        let decoder = decoder.prepare(&model, cancel)?;
        let seconds = began.elapsed().as_secs_f64();
        let scores = TestScores::new(&scene);
        Ok(Ready { key: *key, scene, model, network, decoder, scores, seconds })
    }

    /// The prior of the objects, learned once for each set.
    fn prior(&mut self, scene: &DecoderScene, cancel: &CancelToken) -> Result<Arc<Prior>, ReconstructionError> {
        if let Some((_, prior)) = self.prior.as_ref().filter(|(set, _)| Arc::ptr_eq(set, &scene.set)) {
            return Ok(Arc::clone(prior));
        }
        let prior = Arc::new(scene.prior(cancel)?);
        self.prior = Some((Arc::clone(&scene.set), Arc::clone(&prior)));
        Ok(prior)
    }
}

impl Ready {
    /// Reconstructs the shown measurement, and publishes what there is.
    fn image(
        &self,
        request: &ReconstructionRequest,
        cancel: &CancelToken,
        mailbox: &Mailbox<ReconstructionQueue>,
    ) -> Result<(), ReconstructionError> {
        let truth = Arc::new(request.object().to_owned());
        let peak_photons = self.scene.set.peak();
        let seen = SeenRegion { corner: self.model.sensor_corner(), shape: self.model.measurement_shape() };
        let reconstruction = |object: Arc<Array2<f32>>, iterations, quality| {
            let error = &*truth - &*object;
            let finite = error.iter().copied().filter(|value| value.is_finite());
            Reconstruction {
                key: request.key,
                serial: 0,
                truth: Arc::clone(&truth),
                object,
                largest_error: finite.fold(f32::MIN_POSITIVE, |most, value| most.max(value.abs())),
                error: Arc::new(error),
                seen,
                iterations,
                peak_photons,
                quality,
                standard_deviation: None,
                network: self.network.clone(),
            }
        };
        let mut on_progress = |step: &ReconstructionStep| -> ControlFlow<()> {
            if let ReconstructionStep::Iteration { done, most, object: Some(object) } = step
                && !cancel.is_cancelled()
            {
                let so_far = reconstruction(Arc::clone(object), Some((*done, *most)), None);
                mailbox.publish(|queue| queue.publish(so_far));
            }
            cancel.check()
        };
        let object = self.decoder.reconstruct_one(request.measurement(), &mut on_progress)?;
        // Small images have no numbers.
        let [expected, found] = [truth.view(), object.view()].map(|photons| in_units_of(peak_photons, photons));
        let quality = ImageQuality::of(expected.view(), found.view()).ok();
        let complete = reconstruction(Arc::new(object), None, quality);
        mailbox.publish(|queue| queue.publish(complete));
        Ok(())
    }

    /// Adds the next part of the test set.
    fn test(&mut self, request: &ReconstructionRequest, cancel: &CancelToken) -> Result<(), ReconstructionError> {
        let first = self.scores.count();
        let numbers = first..(first + PART).min(request.test_objects);
        let test = self.scene.test_objects(&self.model, numbers, request.design.seed)?;
        let began = Instant::now();
        // Each on its own, so that a cancellation ends within an image.
        let one = |measurement: ArrayView2<'_, f32>| self.decoder.reconstruct_one(measurement, &mut cancel.clone());
        let measurements = test.measurements.axis_iter(Axis(0)).into_par_iter();
        let found: Vec<Array2<f32>> = measurements.map(one).collect::<Result<_, _>>()?;
        self.seconds += began.elapsed().as_secs_f64();
        let mut objects = Array3::zeros(test.objects.dim());
        for (mut object, found) in objects.outer_iter_mut().zip(&found) {
            object.assign(found);
        }
        self.scores.add(test.objects.view(), objects.view())?;
        if cancel.is_cancelled() { Err(ReconstructionError::Cancelled) } else { Ok(()) }
    }

    /// Quality on the part of the test set that is done.
    fn so_far(&self, seed: u64) -> Result<DecoderQuality, ReconstructionError> {
        let decoder = self.network.as_ref().map_or(self.key.decoder, NetworkFit::decoder);
        self.scores.summary(decoder, self.scene.protocol, seed, self.seconds)
    }
}
