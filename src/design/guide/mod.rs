//! What tells a run how much its mask is worth and which way is up.

mod density;
mod pixelcnn;
mod posterior;

use std::ops::ControlFlow;

use ndarray::{Array3, Array4};

pub(super) use density::DensityGuide;
pub(super) use pixelcnn::PixelCnnGuide;
pub(super) use posterior::{BLOCK, PosteriorGuide, bound};

use super::error::IdealError;
use super::gradient::GradientDraw;
use crate::forward::ForwardModel;
use crate::information::{CausalModel, DecoderRefit, SharedImages, paired_interval};
use crate::objects::Split;
use crate::optics::{LensletArray, LensletGradient, render_psf};
use crate::seeds::SeedStream;
use crate::sensor::Patches;

/// Factor of the learning rate of fits that go on from weights of a similar mask.
const WARM_RATE: f64 = 0.5;

/// Patches that a density model takes the scale of its data from.
const SAMPLE: usize = 256;
/// Held-out objects of a density model, one patch of each.
const HELD_OUT: usize = 128;

/// Hears which share of a fit is done, and answers whether to go on.
pub(super) type OnFit<'a> = &'a mut dyn FnMut(f64) -> ControlFlow<()>;

/// One fit of a guide.
#[derive(Clone, Copy, Debug)]
pub(super) struct GuideFit {
    pub steps: usize,
    pub seed: u64,
    /// Whether it goes on from weights that were fitted to a similar mask.
    pub warm: bool,
}

/// Information and its 95 % interval, bits per pixel.
pub(super) type Valued = (f64, [f64; 2]);
/// How the information changes with every lenslet.
pub(super) type Slopes = Result<Vec<LensletGradient>, IdealError>;

/// A model of measurements that is fitted to the mask again and again.
pub(super) trait Guide {
    /// Turns to a mask, with the weights as they are or, where it is not `warm`, with those that any fit begins with.
    fn follow(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError>;

    /// Fits the weights to fresh training measurements of the mask that it follows.
    fn fit(&mut self, fit: &GuideFit, watch: OnFit<'_>) -> Result<(), IdealError>;

    /// Information of a mask on objects that neither guide nor mask has seen, the same ones every time, and its 95 %
    /// interval, bits per pixel; of more of them for the `last` value of a run. It ends early where `go_on` says so.
    fn value(&self, array: &LensletArray, last: bool, go_on: &dyn Fn() -> bool) -> Result<Valued, IdealError>;

    /// How the information changes with every lenslet. It ends early where `go_on` says so.
    fn slopes(&self, array: &LensletArray, draw: &GradientDraw, go_on: &dyn Fn() -> bool) -> Slopes;

    /// Weights and `details`, as the bytes of a safetensors file.
    fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError>;

    /// Takes the weights of such a file.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError>;

    /// Whether a value can be too high because the guide has lost track of the mask; bounds from below cannot.
    fn can_overrate(&self) -> bool;

    /// The decoder, for guides that are one: it can be fitted and asked little by little, while the mask moves.
    fn posterior(&self) -> Option<&PosteriorGuide<'_>> {
        None
    }

    /// Takes the outcome of a fit that was done so.
    fn take(&mut self, _fit: DecoderRefit) {}

    /// Goes on up to so many steps with a fit to a mask that moves meanwhile, and knows at once what it has learned. Guides that
    /// are not fitted so say that they are not.
    fn keep_up(
        &mut self,
        _fit: &GuideFit,
        (_array, _steps): (&LensletArray, usize),
        _go_on: &dyn Fn() -> bool,
    ) -> Result<bool, IdealError> {
        Ok(false)
    }

    /// The density model, for guides that are one.
    fn density_model(&self) -> Option<&CausalModel> {
        None
    }
}

/// Objects that neither a density model nor its mask has seen.
struct HeldOut {
    /// Shape (n, planes, rows, cols).
    objects: Array4<f32>,
    /// Which base images the patches show.
    shared: SharedImages,
    patch: (usize, usize),
    seed: u64,
}

impl HeldOut {
    fn new(imaging: &ForwardModel<'_>, patch: (usize, usize), seed: u64) -> Result<Self, IdealError> {
        // A picture that comes again tells nothing new; an interval takes two.
        let count = imaging.set.whole_pictures(Split::Test).map_or(HELD_OUT, |pictures| pictures.clamp(2, HELD_OUT));
        let object_seed = SeedStream::HeldOutObjects.derive(seed);
        let objects = imaging.set.objects(Split::Test, count, object_seed)?;
        // The mask will change; on the whole every part of its grid is as bright.
        let ((field_rows, field_cols), (rows, cols)) = (imaging.set.field(), imaging.plan().measurement_shape());
        let flat = Array3::ones((1, field_rows + 1 - rows, field_cols + 1 - cols));
        let places = Patches::one_each((count, rows, cols), patch, SeedStream::HeldOutPlaces.derive(seed))?;
        let shared = imaging.shared_pictures(flat.view(), patch, (Split::Test, 0, object_seed), &places);
        Ok(Self { objects, shared: shared.unwrap_or_default(), patch, seed })
    }

    /// Clean and noisy patches of their measurements, shape (n, rows, cols); the same places and seeds every time.
    fn measured(
        &self,
        imaging: &ForwardModel<'_>,
        array: &LensletArray,
    ) -> Result<(Array3<f32>, Array3<f32>), IdealError> {
        let psf = render_psf(array, imaging.set.planes())?;
        let encoded = imaging.convolver(psf.view())?.measure(self.objects.view(), imaging.bias)?;
        let clean = Patches::one_each(encoded.dim(), self.patch, SeedStream::HeldOutPlaces.derive(self.seed))?
            .cut(encoded.view());
        let noisy = imaging.noise.draw(clean.view(), SeedStream::HeldOutNoise.derive(self.seed));
        Ok((clean, noisy))
    }

    /// Mean and 95 % interval of what a model says of each patch, bits per pixel.
    fn value(&self, information: &[f64]) -> Result<Valued, IdealError> {
        let mean = information.iter().sum::<f64>() / information.len() as f64;
        Ok((mean, self.shared.inflate_interval(information, mean, paired_interval(information, self.seed)?)))
    }
}
