//! A decoder of beads, which bounds the information from below and tells what clean light is expected of a measurement.

use std::ops::{ControlFlow, Range};

use ndarray::{Array2, Array3, ArrayView3, s};

use super::{Guide, GuideFit, OnFit, Slopes, Valued, WARM_RATE};
use crate::design::error::IdealError;
use crate::design::gradient::GradientDraw;
use crate::forward::ForwardModel;
use crate::information::{
    BeadChannel, Decoder, DecoderFit, DecoderKind, DecoderRefit, PretrainedLowerBound, bead_response_gradient,
    decoder_information,
};
use crate::optics::{LensletArray, LensletGradient, psf_gradient, render_psf};
use crate::seeds::SeedStream;

/// Pixels of a patch of 32 x 32 px. Larger ones tell as much of a mask by fewer scenes.
const SMALL: f64 = 32.0 * 32.0;
/// Scenes of such a patch that a value rests on.
const SCENES: usize = 512;
/// Scenes that belong together: values rest on multiples of it.
pub(in crate::design) const BLOCK: usize = 64;
/// How many times as many scenes the value of the last mask rests on.
const LAST: usize = 4;

/// The autoregressive decoder of lower bounds.
pub(in crate::design) struct PosteriorGuide<'a> {
    imaging: &'a ForwardModel<'a>,
    patch: (usize, usize),
    seed: u64,
    /// Before any fit to a mask of this run.
    first: Decoder,
    decoder: Decoder,
    /// Of the mask that it follows.
    channel: BeadChannel,
}

impl<'a> PosteriorGuide<'a> {
    /// The decoder that comes with the program.
    ///
    /// # Errors
    /// For objects whose prior is not known, and masks and noise that make no channel.
    pub fn new(
        imaging: &'a ForwardModel<'a>,
        start: &LensletArray,
        (patch, seed): ((usize, usize), u64),
    ) -> Result<Self, IdealError> {
        let channel = channel(imaging, start, patch)?;
        channel.check()?;
        let found = "posterior".into();
        let no_decoder = IdealError::Setting { name: "objective", found, expected: "density: there is no decoder" };
        let first = Decoder::shipped().ok_or(no_decoder)?.clone();
        Ok(Self { imaging, patch, seed, decoder: first.clone(), first, channel })
    }
}

impl PosteriorGuide<'_> {
    /// Scenes that a value rests on: a multiple of [`BLOCK`].
    pub(in crate::design) fn scenes(&self) -> usize {
        self.as_many(SCENES).next_multiple_of(BLOCK)
    }

    /// Scenes of its patch that have as many pixels as so many of 32 x 32 px, and no more than so many.
    pub(in crate::design) fn as_many(&self, patches: usize) -> usize {
        let pixels = (self.patch.0 * self.patch.1) as f64;
        (patches as f64 * SMALL / pixels).round().clamp(1.0, patches as f64) as usize
    }

    /// Begins a fit from the weights as they are, which stay in use meanwhile.
    pub(in crate::design) fn refit(
        &self,
        &GuideFit { steps, seed, warm }: &GuideFit,
    ) -> Result<DecoderRefit, IdealError> {
        let mut fit = DecoderFit::of_steps(steps, DecoderKind::Autoregressive, seed);
        if warm {
            fit.rate *= WARM_RATE;
        }
        Ok(DecoderRefit::new(fit, &self.decoder)?)
    }

    /// Goes on with such a fit up to so many of its steps, on measurements through a mask. It ends early where `go_on` says so.
    pub(in crate::design) fn fit_on(
        &self,
        refit: &mut DecoderRefit,
        (array, steps): (&LensletArray, usize),
        go_on: &dyn Fn() -> bool,
    ) -> Result<(), IdealError> {
        if refit.steps() < steps {
            let channel = channel(self.imaging, array, self.patch)?;
            let watch = &mut |_| if go_on() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
            refit.advance_to(&channel, steps, watch)?;
        }
        Ok(())
    }

    /// What the decoder tells of some of the scenes of a value through a mask; all of them make it a [`bound`].
    pub(in crate::design) fn value_savings(
        &self,
        array: &LensletArray,
        scenes: Range<usize>,
        go_on: &dyn Fn() -> bool,
    ) -> Result<Vec<f64>, IdealError> {
        self.savings(array, (scenes, SeedStream::RunLowerBound.derive(self.seed), BLOCK), go_on)
    }

    /// What the decoder tells of some of the scenes of a seed through any mask, each `block` of which belong together.
    pub(in crate::design) fn savings(
        &self,
        array: &LensletArray,
        (scenes, seed, block): (Range<usize>, u64, usize),
        go_on: &dyn Fn() -> bool,
    ) -> Result<Vec<f64>, IdealError> {
        let channel = channel(self.imaging, array, self.patch)?;
        Ok(decoder_information(&self.decoder, &channel, (seed, block), scenes, go_on)?)
    }
}

/// Information and its 95 % interval by what all scenes of a value tell.
pub(in crate::design) fn bound(savings: Vec<f64>) -> Valued {
    let bound = PretrainedLowerBound::of_gains(savings);
    (bound.bits_per_pixel, bound.interval_95)
}

impl Guide for PosteriorGuide<'_> {
    fn follow(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError> {
        self.channel = channel(self.imaging, array, self.patch)?;
        if !warm {
            self.decoder = self.first.clone();
        }
        Ok(())
    }

    fn fit(&mut self, fit: &GuideFit, watch: OnFit<'_>) -> Result<(), IdealError> {
        let steps = fit.steps;
        let mut refit = self.refit(fit)?;
        refit.advance_to(&self.channel, steps, &mut |step: usize| watch(step as f64 / steps as f64))?;
        self.take(refit);
        Ok(())
    }

    fn value(&self, array: &LensletArray, last: bool, go_on: &dyn Fn() -> bool) -> Result<Valued, IdealError> {
        let scenes = if last { LAST * self.scenes() } else { self.scenes() };
        Ok(bound(self.value_savings(array, 0..scenes, go_on)?))
    }

    fn posterior(&self) -> Option<&PosteriorGuide<'_>> {
        Some(self)
    }

    fn take(&mut self, fit: DecoderRefit) {
        self.decoder = fit.decoder();
    }

    fn slopes(&self, array: &LensletArray, draw: &GradientDraw, _go_on: &dyn Fn() -> bool) -> Slopes {
        self.imaging.posterior_gradient(array, (draw.patches, draw.seed), self.patch, &self.decoder)
    }

    fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError> {
        Ok(self.decoder.to_bytes_with(details)?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError> {
        self.decoder = Decoder::from_bytes(bytes)?;
        Ok(())
    }

    fn can_overrate(&self) -> bool {
        false
    }
}

impl ForwardModel<'_> {
    /// How what patches (rows, cols) of freshly drawn measurements tell of beads changes with every lenslet, bits per pixel and
    /// unit of the parameter: by the mean over so many patches, as exact as what the decoder says of single sites.
    ///
    /// # Errors
    /// For objects whose prior is not known, and where mask, objects and patches do not belong together.
    pub fn posterior_gradient(
        &self,
        array: &LensletArray,
        (patches, seed): (usize, u64),
        patch: (usize, usize),
        decoder: &Decoder,
    ) -> Result<Vec<LensletGradient>, IdealError> {
        let bead = &self.set.bead_prior().ok_or_else(no_prior)?.spot;
        let by_spot = bead_response_gradient(&channel(self, array, patch)?, decoder, (seed, 0, patches))?;
        Ok(psf_gradient(array, by_psf(by_spot.view(), bead).view())?)
    }
}

fn channel(imaging: &ForwardModel<'_>, array: &LensletArray, patch: (usize, usize)) -> Result<BeadChannel, IdealError> {
    let psf = render_psf(array, imaging.set.planes())?;
    imaging.bead_channel(psf.view(), patch).ok_or_else(no_prior)
}

fn no_prior() -> IdealError {
    IdealError::Setting {
        name: "objective",
        found: "posterior".into(),
        expected: "density for objects that are no beads, or leave nothing to tell",
    }
}

/// From slopes by the spot of a bead on the sensor to those by the point spread function, both (planes, rows, cols); `bead`
/// is what it is blurred with.
fn by_psf(by_spot: ArrayView3<'_, f64>, bead: &Array2<f64>) -> Array3<f64> {
    let (planes, rows, cols) = by_spot.dim();
    let (rows, cols) = (rows + 1 - bead.nrows(), cols + 1 - bead.ncols());
    let mut by_psf = Array3::zeros((planes, rows, cols));
    for ((row, col), &photons) in bead.indexed_iter() {
        by_psf.scaled_add(photons, &by_spot.slice(s![.., row..row + rows, col..col + cols]));
    }
    by_psf
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::bead_response;
    use crate::objects::{ObjectOptions, ObjectSet};
    use crate::optics::heuristic_layout;
    use crate::sensor::Noise;

    #[test]
    fn scenes_tell_the_same_part_by_part() {
        let options = ObjectOptions { field: (47, 47), mean_photons: 100.0 };
        let set = ObjectSet::open(&"beads:0.02".parse().unwrap(), &options).unwrap();
        let imaging = ForwardModel::new(&set, (32, 32), 10.0, Noise::Shot).unwrap();
        let mask = heuristic_layout(3);
        let guide = PosteriorGuide::new(&imaging, &mask, ((8, 8), 1)).unwrap();
        let savings = |scenes: Range<usize>| guide.value_savings(&mask, scenes, &|| true).unwrap();
        let mut parts = Vec::new();
        for end in [8, 24, 30, 300, guide.scenes()] {
            parts.extend(savings(parts.len()..end));
        }
        assert_eq!(parts, savings(0..guide.scenes()));
        assert!(parts.iter().any(|bits| (bits - parts[0]).abs() > 1e-3), "scenes differ");
        assert_eq!(bound(parts), guide.value(&mask, false, &|| true).unwrap());
    }

    #[test]
    fn slopes_are_pulled_back_by_the_adjoint_of_the_blur() {
        let number = |place: usize| ((place * 7 + place * place) % 13) as f64 - 5.0;
        let bead = Array2::from_shape_fn((3, 2), |(r, c)| number(r * 2 + c));
        let psf = Array3::from_shape_fn((2, 4, 5), |(z, r, c)| number(z * 20 + r * 5 + c));
        let by_spot = Array3::from_shape_fn((2, 6, 6), |(z, r, c)| number(z * 36 + r * 6 + c + 3));
        let (there, back) = (bead_response(&bead, psf.view()), by_psf(by_spot.view(), &bead));
        assert_eq!((there.dim(), back.dim()), (by_spot.dim(), psf.dim()));
        assert!(((there * &by_spot).sum() - (back * &psf).sum()).abs() < 1e-9);
    }
}
