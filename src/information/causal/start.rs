//! What a fitted model gives to the fit of a similar design.

use serde::{Deserialize, Serialize};

use super::conditioning::FAR_PLACES;
use super::levels::{LevelSpan, Levels};
use super::model::CausalModel;
use super::shape::CausalShape;
use crate::network::ParameterLayout;
use crate::sensor::Noise;

/// Largest distance of a far place in rows or columns, px; that which stands for none is as far.
const FARTHEST: usize = 1_000_000;

/// The weights that a model begins with.
#[derive(Clone, Copy, Debug)]
pub enum Beginning<'a> {
    /// Those that come with the program ([`FirstWeights`](super::FirstWeights)).
    Shipped,
    /// Drawn by chance.
    Drawn,
    /// Those of the model of a similar design, or of the program where it was before another noise.
    Similar(&'a CausalStart),
}

/// Everything that a fit takes from the model of a similar design, in numbers that go through a file unchanged: a fit that
/// starts from them is the same whenever it is repeated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CausalStart {
    pub(super) shape: CausalShape,
    pub(super) noise: Noise,
    pub(super) span: LevelSpan,
    /// Units of the inputs: mean and inverse deviation of the roots of photons, and of photons.
    pub(super) roots: (f32, f32),
    pub(super) photons: (f32, f32),
    /// Far places (rows down, columns right), px.
    pub(super) far: Vec<(isize, isize)>,
    pub(super) weights: Vec<f32>,
}

impl CausalStart {
    /// The weights.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Whether it is of measurements with this noise.
    pub fn is_of(&self, noise: Noise) -> bool {
        self.noise == noise
    }

    /// Whether a model can have given it, and not a damaged file.
    pub fn is_sound(&self) -> bool {
        let near = |place: &(isize, isize)| place.0.unsigned_abs() <= FARTHEST && place.1.unsigned_abs() <= FARTHEST;
        let units = [self.roots.0, self.roots.1, self.photons.0, self.photons.1];
        self.far.len() == FAR_PLACES
            && self.far.iter().all(near)
            && units.iter().all(|unit| unit.is_finite())
            && self.span.is_sound()
            && self.layout(Levels::spanning(self.noise, self.span).count()).is_some()
    }

    /// Where the weights lie; none where they are too many or too few, as those of a damaged file are.
    pub(super) fn layout(&self, levels: usize) -> Option<ParameterLayout> {
        let (_, layout) = self.shape.layers(levels, &self.far);
        (layout.count() == self.weights.len() && self.weights.iter().all(|weight| weight.is_finite())).then_some(layout)
    }
}

impl From<&CausalModel> for CausalStart {
    fn from(model: &CausalModel) -> Self {
        let conditioning = &model.conditioning;
        let (roots, photons) = conditioning.units();
        Self {
            shape: model.shape.clone(),
            noise: conditioning.noise,
            span: conditioning.levels.span,
            roots,
            photons,
            far: conditioning.far.clone(),
            weights: model.weights.clone(),
        }
    }
}
