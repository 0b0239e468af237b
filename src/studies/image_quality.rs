//! Image quality of a decoder for one design, as a cell of a study computes it.

use std::ops::ControlFlow;
use std::sync::Arc;

use crate::forward::{Design, ForwardError, ForwardModel};
use crate::information::{EngineChoice, PosteriorChains, Protocol};
use crate::progress::CancelToken;
use crate::reconstruction::{
    DecoderKind, DecoderQuality, DecoderScene, DecoderTest, DecoderTraining, ReconstructionError, ReconstructionStep,
    TrainingBudget, TrainingMasks, TrainingStep,
};

/// A decoder and its test.
#[derive(Clone, Copy, Debug)]
pub(super) struct QualityRequest {
    /// The decoder.
    pub kind: DecoderKind,
    /// Protocol of light, background and noise.
    pub protocol: Protocol,
    /// Length of the training of a network.
    pub training: TrainingBudget,
    /// Sweeps of the Markov chains that refine the posterior mean; without them, the trained decoder alone.
    pub sweeps: Option<usize>,
    /// Held-out objects.
    pub test_objects: usize,
    /// Seed of training, chains and test.
    pub seed: u64,
}

impl QualityRequest {
    /// Trains the decoder where it needs that, and tests it on held-out objects.
    ///
    /// # Errors
    /// As [`ForwardModel::open`] and [`DecoderTest::run`]; [`ReconstructionError::Cancelled`] where `poll` cancels.
    pub fn measure(
        &self,
        design: &Design,
        poll: &mut (dyn FnMut() -> ControlFlow<()> + Send),
    ) -> Result<DecoderQuality, ReconstructionError> {
        let &Self { kind, protocol, training: budget, sweeps, test_objects, seed } = self;
        let forward = ForwardModel::open(design)?;
        let scene = DecoderScene::new(&forward, protocol)?;
        let psf = forward.psf(design).map_err(ForwardError::from)?;
        let model = scene.model(psf.view())?;
        let cancel = CancelToken::new();
        let prior = kind.needs().objects.then(|| scene.prior(&cancel)).transpose()?.map(Arc::new);
        let decoder = if kind.needs().training {
            let training = DecoderTraining { kind, budget, seed, engine: EngineChoice::Cpu };
            let masks = TrainingMasks::One(model.clone());
            let trained = training.train(&scene, &masks, None, None, &cancel, &mut |_: &TrainingStep| poll())?;
            trained.decoder(&scene, prior.as_ref())?
        } else {
            kind.decoder(prior, sweeps.map(|sweeps| PosteriorChains::of_sweeps(sweeps, seed)))?
        };
        let test = DecoderTest { objects: test_objects, seed };
        test.run(&*decoder, &scene, &model, &mut |_: &ReconstructionStep| poll(), &mut |_| Ok(()))
    }
}
