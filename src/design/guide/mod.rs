//! What tells a run how much its mask is worth and which way is up.

mod density;
mod posterior;

use std::ops::ControlFlow;

pub(super) use density::DensityGuide;
pub(super) use posterior::PosteriorGuide;

use super::error::IdealError;
use super::gradient::GradientDraw;
use crate::information::CausalModel;
use crate::optics::{LensletArray, LensletGradient};

/// Factor of the learning rate of fits that go on from weights of a similar mask.
const WARM_RATE: f64 = 0.5;

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

/// A model of measurements that is fitted to the mask again and again.
pub(super) trait Guide {
    /// Turns to a mask, with the weights as they are or, where it is not `warm`, with those of the start.
    fn follow(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError>;

    /// Fits the weights to fresh training measurements of the mask that it follows.
    fn fit(&mut self, fit: &GuideFit, watch: OnFit<'_>) -> Result<(), IdealError>;

    /// Information of a mask on objects that neither guide nor mask has seen, the same ones every time, and its 95 %
    /// interval, bits per pixel; of more of them for the `last` value of a run. It ends early where `go_on` says so.
    fn value(&self, array: &LensletArray, last: bool, go_on: &dyn Fn() -> bool) -> Result<(f64, [f64; 2]), IdealError>;

    /// How the information changes with every lenslet.
    fn slopes(&self, array: &LensletArray, draw: &GradientDraw) -> Result<Vec<LensletGradient>, IdealError>;

    /// Weights and `details`, as the bytes of a safetensors file.
    fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError>;

    /// Takes the weights of such a file.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError>;

    /// Whether a value can be too high because the guide has lost track of the mask; bounds from below cannot.
    fn can_overrate(&self) -> bool;

    /// The density model, for guides that are one.
    fn density_model(&self) -> Option<&CausalModel> {
        None
    }
}
