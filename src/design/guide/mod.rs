//! What tells a run how much its mask is worth and which way is up.

mod density;
mod pixelcnn;
mod posterior;

use std::ops::{ControlFlow, Range};

use ndarray::{Array3, Array4, Axis};

pub(super) use density::DensityGuide;
pub(super) use pixelcnn::PixelCnnGuide;
pub(super) use posterior::PosteriorGuide;

use super::error::IdealError;
use super::gradient::GradientDraw;
use super::imaging::{Imaging, derived_seed};
use crate::information::{CausalModel, DecoderRefit, SharedPictures, paired_interval};
use crate::objects::Split;
use crate::optics::{LensletArray, LensletGradient, render_psf};
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
pub(super) trait Guide: Sync {
    /// Turns to a mask, with the weights as they are or, where it is not `warm`, with those that any fit begins with.
    fn follow(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError>;

    /// Fits the weights to fresh training measurements of the mask that it follows.
    fn fit(&mut self, fit: &GuideFit, watch: OnFit<'_>) -> Result<(), IdealError>;

    /// Begins a fit to a mask that moves meanwhile; none for guides that are only fitted while the mask waits. The guide stays
    /// as it is until it [takes](Guide::take) the outcome.
    fn begin_beside(&self, _fit: &GuideFit) -> Result<Option<DecoderRefit>, IdealError> {
        Ok(None)
    }

    /// Goes on with such a fit up to so many of its steps, on measurements of the mask as it is by now. It ends early where
    /// `go_on` says so.
    fn fit_beside(
        &self,
        _fit: &mut DecoderRefit,
        _array: &LensletArray,
        _steps: usize,
        _go_on: &dyn Fn() -> bool,
    ) -> Result<(), IdealError> {
        Ok(())
    }

    /// Takes what such a fit has come to.
    fn take(&mut self, _fit: DecoderRefit) {}

    /// Objects that a value rests on, or the `last` one of a run; a [`Guide::tells`] of them all makes one.
    fn held_out(&self, last: bool) -> usize;

    /// What each of a range of objects that neither guide nor mask has seen tells through a mask, bits per pixel; the same
    /// objects every time. It ends early where `go_on` says so.
    fn tells(
        &self,
        array: &LensletArray,
        range: Range<usize>,
        go_on: &dyn Fn() -> bool,
    ) -> Result<Vec<f64>, IdealError>;

    /// Information and its 95 % interval by what all of these objects tell.
    fn valued(&self, told: Vec<f64>) -> Result<Valued, IdealError>;

    /// The same of a mask that it does not follow, on so many scenes, which the seed decides; none from a guide that knows only
    /// the mask that it follows.
    fn foreseen(
        &self,
        _array: &LensletArray,
        (_samples, _seed): (usize, u64),
        _go_on: &dyn Fn() -> bool,
    ) -> Result<Option<Valued>, IdealError> {
        Ok(None)
    }

    /// How the information changes with every lenslet. It ends early where `go_on` says so.
    fn slopes(&self, array: &LensletArray, draw: &GradientDraw, go_on: &dyn Fn() -> bool) -> Slopes;

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

/// Purpose of the seed of the places of held-out patches.
const PLACES: u64 = 3;

/// Objects that neither a density model nor its mask has seen.
struct HeldOut {
    /// Shape (n, planes, rows, cols).
    objects: Array4<f32>,
    /// Which base images the patches show.
    shared: SharedPictures,
    patch: (usize, usize),
    seed: u64,
}

impl HeldOut {
    fn new(imaging: &Imaging<'_>, patch: (usize, usize), seed: u64) -> Result<Self, IdealError> {
        // A picture that comes again tells nothing new; an interval takes two.
        let count = imaging.set.whole_pictures(Split::Test).map_or(HELD_OUT, |pictures| pictures.clamp(2, HELD_OUT));
        let object_seed = derived_seed(seed, 1);
        let objects = imaging.set.objects(Split::Test, count, object_seed)?;
        // The mask will change; on the whole every part of its grid is as bright.
        let ((field_rows, field_cols), (rows, cols)) = (imaging.set.field(), imaging.plan().measurement_shape());
        let flat = Array3::ones((1, field_rows + 1 - rows, field_cols + 1 - cols));
        let places = Patches::one_each((count, rows, cols), patch, derived_seed(seed, PLACES))?;
        let shared = imaging.shared_pictures(flat.view(), patch, (Split::Test, 0, object_seed), &places);
        Ok(Self { objects, shared: shared.unwrap_or_default(), patch, seed })
    }

    /// How many they are.
    fn count(&self) -> usize {
        self.objects.len_of(Axis(0))
    }

    /// Clean and noisy patches of the measurements of a range of them, shape (n, rows, cols); the same places and seeds every
    /// time.
    fn measured(
        &self,
        imaging: &Imaging<'_>,
        array: &LensletArray,
        range: Range<usize>,
    ) -> Result<(Array3<f32>, Array3<f32>), IdealError> {
        let psf = render_psf(array, imaging.set.planes())?;
        let objects = self.objects.slice_axis(Axis(0), range.clone().into());
        let encoded = imaging.convolver(psf.view())?.measure(objects, imaging.bias)?;
        let (rows, cols) = imaging.plan().measurement_shape();
        let places = Patches::one_each((self.count(), rows, cols), self.patch, derived_seed(self.seed, PLACES))?;
        let clean = places.of_images(range.clone()).cut(encoded.view());
        let noisy = imaging.noise.draw_from(clean.view(), range.start, derived_seed(self.seed, 4));
        Ok((clean, noisy))
    }

    /// Mean and 95 % interval of what a model says of each patch, bits per pixel.
    fn value(&self, information: &[f64]) -> Result<Valued, IdealError> {
        let mean = information.iter().sum::<f64>() / information.len() as f64;
        Ok((mean, self.shared.widened(information, mean, paired_interval(information, self.seed)?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::{ObjectOptions, ObjectSet};
    use crate::optics::{Limits, heuristic_layout};
    use crate::sensor::Noise;

    #[test]
    fn objects_tell_the_same_part_by_part() {
        let options = ObjectOptions { field: (47, 47), mean_photons: 100.0 };
        let set = ObjectSet::open(&"beads:0.02".parse().unwrap(), &options).unwrap();
        let imaging = Imaging::new(&set, (32, 32), 10.0, Noise::Shot).unwrap();
        let (mask, as_seen) = (heuristic_layout(3), ((8, 8), 1));
        let guides: [Box<dyn Guide + '_>; 3] = [
            Box::new(PosteriorGuide::new(&imaging, &mask, as_seen).unwrap()),
            Box::new(DensityGuide::new(&imaging, &mask, &Limits::default(), as_seen).unwrap()),
            Box::new(PixelCnnGuide::new(&imaging, &mask, as_seen).unwrap()),
        ];
        for guide in guides {
            let all = guide.held_out(false);
            let tells = |range: Range<usize>| guide.tells(&mask, range, &|| true).unwrap();
            let whole = tells(0..all);
            let mut parts = Vec::new();
            for end in [8, 24, 30, all] {
                parts.extend(tells(parts.len()..end));
            }
            assert_eq!(parts.len(), all);
            let apart = whole.iter().zip(&parts).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max);
            assert!(apart < 1e-5, "{apart}");
            let (value, [low, high]) = guide.valued(parts).unwrap();
            assert!(low <= value && value <= high);
            assert!(whole.iter().any(|bits| (bits - whole[0]).abs() > 1e-3), "objects differ");
        }
    }
}
