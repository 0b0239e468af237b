//! `PixelCNN` density model of the measurements, as published.

use super::held_out::{HeldOut, HeldOutPatches};
use super::{MaskGradient, ModelFit, ModelValue, ObjectiveModel, SAMPLE};
use crate::design::error::IdealError;
use crate::design::gradient::GradientDraw;
use crate::forward::ForwardModel;
use crate::information::MeasurementStream;
use crate::information::{
    DataScale, FitProgress, FrozenPixelCnn, NoiseEntropy, PatchStream, PixelCnn, PixelCnnContext, PixelCnnFit,
    PixelCnnShape, Protocol, TrainingPatches, dequantised,
};
use crate::objects::Split;
use crate::optics::{LensletArray, render_psf};
use crate::progress::Progress;
use crate::seeds::SeedStream;

/// Patches of one fit; a tenth of them validates it.
const TRAINING: usize = 4096;
/// Steps of a fit between two validations, and validations without improvement after which it stops; as published.
const EPOCH: usize = 100;
const PATIENCE: usize = 10;
/// Least width of a Gaussian component, photons; as published.
const MIN_WIDTH: f32 = 1.0;

/// The network and the fit of Kabuli et al. 2026.
pub(in crate::design) struct PixelCnnModel {
    /// Forward model with the noise of the upper bound.
    forward: ForwardModel,
    patch: (usize, usize),
    seed: u64,
    /// Exact noise entropy for values; gradients use the published approximation.
    entropy: NoiseEntropy,
    held_out: HeldOut,
    network: PixelCnn,
    /// Measurements through the mask of the model.
    stream: MeasurementStream,
}

impl PixelCnnModel {
    /// An unfitted network.
    ///
    /// # Errors
    /// Where objects, noise and patch allow none.
    pub fn new(
        forward: &ForwardModel,
        start: &LensletArray,
        patch: (usize, usize),
        seed: u64,
    ) -> Result<Self, IdealError> {
        let forward = forward.bounding();
        let entropy = NoiseEntropy::new(forward.noise, Protocol::Default)?;
        let held_out = HeldOut::new(&forward, patch, seed)?;
        let stream = stream(&forward, start, patch)?;
        let sample = stream.draw(SAMPLE, SeedStream::ScalePatches.derive(seed))?;
        let scale = DataScale::of(sample.noisy.view(), MIN_WIDTH)?;
        let network = PixelCnn::new(PixelCnnShape::default(), scale, seed);
        Ok(Self { forward, patch, seed, entropy, held_out, network, stream })
    }
}

impl ObjectiveModel for PixelCnnModel {
    fn retarget(&mut self, array: &LensletArray, _warm: bool) -> Result<(), IdealError> {
        self.stream = stream(&self.forward, array, self.patch)?;
        Ok(())
    }

    fn fit(&mut self, fit: &ModelFit, progress: &mut dyn Progress<f64>) -> Result<(), IdealError> {
        let &ModelFit { steps, seed, warm } = fit;
        let drawn = self.stream.draw(TRAINING, seed)?;
        let steps_per_epoch = EPOCH.min(steps);
        let epochs = steps.div_ceil(steps_per_epoch);
        let patience = Some(PATIENCE);
        let fit = PixelCnnFit { steps_per_epoch, max_epochs: epochs, patience, ..PixelCnnFit::paper(seed) };
        let patches = TrainingPatches { noisy: drawn.noisy.view(), clean: None };
        let start = warm.then_some(&self.network);
        let share = |step: usize| step as f64 / (epochs * steps_per_epoch) as f64;
        let on_step = &mut |step: &FitProgress| progress.report(&share(step.step));
        let context = PixelCnnContext { start, ..PixelCnnContext::new(patches) };
        (self.network, _) = fit.fit(PixelCnnShape::default(), MIN_WIDTH, &context, on_step)?;
        Ok(())
    }

    fn value(
        &self,
        array: &LensletArray,
        _last: bool,
        _progress: &mut dyn Progress<usize>,
    ) -> Result<ModelValue, IdealError> {
        let HeldOutPatches { clean, noisy } = self.held_out.measured(&self.forward, array)?;
        let noisy = dequantised(noisy.view(), SeedStream::Dequantisation.derive(self.seed), 0);
        let cross_entropy = self.network.cross_entropy_bits(noisy.view())?;
        let of_noise = self.entropy.patch_bits(clean.view())?;
        let information: Vec<f64> = cross_entropy.iter().zip(of_noise).map(|(all, noise)| all - noise).collect();
        self.held_out.value(&information)
    }

    fn gradient(&self, array: &LensletArray, draw: &GradientDraw, progress: &mut dyn Progress<usize>) -> MaskGradient {
        let held = FrozenPixelCnn { network: &self.network, noise: self.forward.noise };
        Ok(self.forward.gradient(array, draw, self.patch, &held, progress)?.lenslets)
    }

    fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError> {
        Ok(self.network.to_bytes_with(details)?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError> {
        self.network = PixelCnn::from_bytes(bytes)?;
        Ok(())
    }

    fn is_upper_bound(&self) -> bool {
        true
    }
}

fn stream(
    forward: &ForwardModel,
    array: &LensletArray,
    patch: (usize, usize),
) -> Result<MeasurementStream, IdealError> {
    let psf = render_psf(array, forward.set.planes())?;
    Ok(forward.stream(forward.convolver(psf.view())?, Split::Train, patch))
}
