//! Gradient of the information by the lenslets under a density model with fixed weights.

use ndarray::{Array3, ArrayView3, ArrayView4, Axis};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::error::IdealError;
use crate::forward::ForwardModel;
use crate::information::FrozenDensity;
use crate::objects::Split;
use crate::optics::{LensletArray, LensletGradient, psf_gradient, render_psf};
use crate::progress::Progress;
use crate::seeds::SeedStream;
use crate::sensor::{Convolution, Patches};

/// Objects with the random numbers of their measurements.
#[derive(Clone, Copy)]
pub struct GradientScene<'a> {
    /// Transforms for objects and PSF.
    pub plan: &'a Convolution,
    /// Shape (n, planes, rows, cols), photons per pixel.
    pub objects: ArrayView4<'a, f32>,
    /// Background, photons per pixel.
    pub bias: f64,
    /// Places of the patches in the measurements.
    pub patches: &'a Patches,
    /// A standard normal number for the noise of every pixel of every patch, shape (patches, rows, cols).
    pub normals: ArrayView3<'a, f32>,
}

/// Information of a mask and its gradient by every lenslet.
#[derive(Clone, Debug, PartialEq)]
pub struct DesignGradient {
    /// Information of these measurements under the density model, bits per pixel.
    pub bits_per_pixel: f64,
    /// Gradient by each lenslet, bits per pixel and unit of the parameter.
    pub lenslets: Vec<LensletGradient>,
}

/// Information of the measurements of `scene` through `array` under a density model with fixed weights, and its exact gradient
/// through likelihood, reparameterised noise, valid convolution and point spread function (Kabuli et al. 2026).
///
/// The weights should be fitted to measurements of this mask. The fit minimises the cross-entropy, so that its gradient by the
/// weights vanishes.
///
/// # Errors
/// [`IdealError`] where mask, objects, patches and model do not belong together.
pub fn information_gradient(
    array: &LensletArray,
    scene: &GradientScene<'_>,
    model: &dyn FrozenDensity,
    progress: &mut dyn Progress<usize>,
) -> Result<DesignGradient, IdealError> {
    let planes = scene.objects.len_of(Axis(1));
    let psf = render_psf(array, planes)?;
    let convolver = scene.plan.with_psf(psf.view())?;
    let encoded = convolver.measure(scene.objects, scene.bias)?;
    let (bits_per_pixel, by_patches) =
        model.information_gradient(scene.patches.cut(encoded.view()).view(), scene.normals, progress)?;
    let mut by_encoded = Array3::<f64>::zeros(encoded.dim());
    scene.patches.add_back(by_patches.view(), &mut by_encoded);
    let by_psf = convolver.psf_cotangent(scene.objects, by_encoded.mapv(|value| value as f32).view())?;
    Ok(DesignGradient { bits_per_pixel, lenslets: psf_gradient(array, by_psf.view())? })
}

/// Random draw of the measurements of a gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GradientDraw {
    /// Part of the objects.
    pub split: Split,
    /// Number of objects.
    pub objects: usize,
    /// Number of patches from their measurements.
    pub patches: usize,
    /// Seed of objects, places and noise.
    pub seed: u64,
}

impl ForwardModel {
    /// The [`information_gradient`] of freshly drawn measurements with patches of shape `patch` (rows, cols).
    ///
    /// # Errors
    /// As [`information_gradient`]; where objects cannot be drawn.
    pub fn gradient(
        &self,
        array: &LensletArray,
        draw: &GradientDraw,
        patch: (usize, usize),
        model: &dyn FrozenDensity,
        progress: &mut dyn Progress<usize>,
    ) -> Result<DesignGradient, IdealError> {
        let &GradientDraw { split, objects, patches: count, seed } = draw;
        let objects = self.set.objects(split, objects, seed)?;
        let (rows, cols) = self.plan().measurement_shape();
        let patches = Patches::draw((objects.len_of(Axis(0)), rows, cols), patch, count, seed)?;
        let mut random = ChaCha8Rng::seed_from_u64(SeedStream::GradientNoise.derive(seed));
        let normals = Array3::from_shape_simple_fn((count, patch.0, patch.1), || StandardNormal.sample(&mut random));
        let scene = GradientScene {
            plan: self.plan(),
            objects: objects.view(),
            bias: self.bias,
            patches: &patches,
            normals: normals.view(),
        };
        information_gradient(array, &scene, model, progress)
    }
}
