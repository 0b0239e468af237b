//! A density model of the measurements, whose cross-entropy bounds the information from above.

use std::ops::ControlFlow;

use ndarray::{Array3, ArrayView3, Axis, Slice, concatenate};

use super::{Guide, GuideFit, HeldOut, OnFit, SAMPLE, Slopes, Valued, WARM_RATE};
use crate::design::error::IdealError;
use crate::design::gradient::GradientDraw;
use crate::forward::ForwardModel;
use crate::information::{AnalyticMoments, MeasurementStream};
use crate::information::{
    CausalFit, CausalModel, CausalRefit, CausalShape, FitLength, FrozenDensity, InformationError, NoiseEntropy,
    PatchBatch, PatchStream, Protocol, check_causal_patch, score_with_progress,
};
use crate::objects::Split;
use crate::optics::{Lenslet, LensletArray, Limits, render_psf};
use crate::seeds::SeedStream;

/// The causal density model of live estimates.
pub(in crate::design) struct DensityGuide<'a> {
    /// With the noise that bounds from above.
    imaging: ForwardModel<'a>,
    moments: AnalyticMoments<'a>,
    patch: (usize, usize),
    seed: u64,
    entropy: NoiseEntropy,
    held_out: HeldOut,
    /// Before any fit, for the mask of the start.
    first: CausalModel,
    model: CausalModel,
    /// Measurements through the mask that it follows.
    stream: MeasurementStream<'a>,
    /// The fit that keeps up with a mask which moves on from there.
    refit: Option<CausalRefit>,
}

impl<'a> DensityGuide<'a> {
    /// A model before its fit, with levels up to the brightest measurement that the limits allow: that of one sharp lenslet, on
    /// whichever plane.
    ///
    /// # Errors
    /// Where objects, noise and patch allow none.
    pub fn new(
        imaging: &ForwardModel<'a>,
        start: &LensletArray,
        limits: &Limits,
        (patch, seed): ((usize, usize), u64),
    ) -> Result<Self, IdealError> {
        check_causal_patch(patch)?;
        let imaging = imaging.bounding();
        let moments = imaging.analytic_moments(Split::Train, (start.rows, start.cols), patch)?;
        let held_out = HeldOut::new(&imaging, patch, seed)?;
        let entropy = NoiseEntropy::new(imaging.noise, Protocol::Default)?;
        let planes = imaging.set.planes();
        let drawn = |array: &LensletArray| -> Result<_, IdealError> {
            let psf = render_psf(array, planes)?;
            let stream = imaging.stream(imaging.convolver(psf.view())?, Split::Train, patch);
            Ok((stream.draw(SAMPLE, SeedStream::ScalePatches.derive(seed))?, psf, stream))
        };
        let (sample, psf, stream) = drawn(start)?;
        let (x, y) = ((start.cols / 2) as f64, (start.rows / 2) as f64);
        let planes_in_use = start.planes().min(planes);
        // All the light may come to gather on one plane.
        let extremes = (0..planes_in_use)
            .map(|plane| {
                let sharp = Lenslet { plane, ..Lenslet::round(x, y, limits.min_sigma_px, 1.0) };
                let (patches, _, _) = drawn(&LensletArray { lenslets: vec![sharp], ..start.clone() })?;
                Ok(patches.clean.unwrap_or(patches.noisy))
            })
            .collect::<Result<Vec<Array3<f32>>, IdealError>>()?;
        let extremes: Vec<_> = extremes.iter().map(|patches| patches.view()).collect();
        let extremes = concatenate(Axis(0), &extremes).expect("patches of one shape, of one plane at least");
        let known = moments.of(psf.view())?;
        let first = CausalModel::covering(CausalShape::default(), imaging.noise, &sample, &known, &extremes, seed)?;
        let model = first.clone();
        Ok(Self { imaging, moments, patch, seed, entropy, held_out, first, model, stream, refit: None })
    }

    /// Training measurements through a mask of this PSF.
    fn seen_through(&self, psf: ArrayView3<'_, f64>) -> Result<MeasurementStream<'a>, IdealError> {
        Ok(self.imaging.stream(self.imaging.convolver(psf)?, Split::Train, self.patch))
    }
}

/// Patches whose gradients are taken from one question whether to go on to the next.
const ASKED_EVERY: usize = 64;

/// A model whose gradient of thousands of patches can be given up on the way.
struct Cancellable<'a> {
    model: &'a dyn FrozenDensity,
    go_on: &'a dyn Fn() -> bool,
}

impl FrozenDensity for Cancellable<'_> {
    fn information_gradient(
        &self,
        clean: ArrayView3<'_, f32>,
        normals: ArrayView3<'_, f32>,
    ) -> Result<(f64, Array3<f64>), InformationError> {
        let patches = clean.len_of(Axis(0));
        let mut gradient = Array3::zeros(clean.dim());
        let mut bits = 0.0;
        for first in (0..patches).step_by(ASKED_EVERY) {
            if !(self.go_on)() {
                return Err(InformationError::Cancelled);
            }
            let part = Slice::from(first..(first + ASKED_EVERY).min(patches));
            let (clean, normals) = (clean.slice_axis(Axis(0), part), normals.slice_axis(Axis(0), part));
            let (part_bits, mut by_part) = self.model.information_gradient(clean, normals)?;
            let share = by_part.len_of(Axis(0)) as f64 / patches as f64;
            by_part *= share;
            bits += share * part_bits;
            gradient.slice_axis_mut(Axis(0), part).assign(&by_part);
        }
        Ok((bits, gradient))
    }
}

impl Guide for DensityGuide<'_> {
    fn follow(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError> {
        let psf = render_psf(array, self.imaging.set.planes())?;
        self.stream = self.seen_through(psf.view())?;
        let sample = self.stream.draw(SAMPLE, SeedStream::ScalePatches.derive(self.seed))?;
        let moments = self.moments.of(psf.view())?;
        self.model =
            if warm { self.model.following(&sample, &moments)? } else { self.first.anew(&sample, &moments)? };
        self.refit = None;
        Ok(())
    }

    fn fit(&mut self, fit: &GuideFit, watch: OnFit<'_>) -> Result<(), IdealError> {
        let &GuideFit { steps, seed, warm } = fit;
        let mut fit = CausalFit::new(FitLength::Steps(steps), seed);
        if warm {
            fit.rate *= WARM_RATE;
        }
        fit.fit(&mut self.model, &self.stream, &mut |progress| watch(progress.step as f64 / steps as f64))?;
        Ok(())
    }

    fn keep_up(
        &mut self,
        &GuideFit { steps: all, seed, .. }: &GuideFit,
        (array, steps): (&LensletArray, usize),
        go_on: &dyn Fn() -> bool,
    ) -> Result<bool, IdealError> {
        let psf = render_psf(array, self.imaging.set.planes())?;
        let stream = self.seen_through(psf.view())?;
        let refit = self.refit.get_or_insert_with(|| CausalRefit::new((all, seed), self.model.clone()));
        refit.advance_to(steps, &stream, go_on)?;
        self.model = refit.model();
        Ok(true)
    }

    fn value(&self, array: &LensletArray, _last: bool, go_on: &dyn Fn() -> bool) -> Result<Valued, IdealError> {
        let (clean, noisy) = self.held_out.measured(&self.imaging, array)?;
        let test = PatchBatch { noisy, clean: Some(clean) };
        let watch = &mut |_| if go_on() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
        let (information, _) = score_with_progress(&self.model, &self.entropy, &test, watch)?;
        self.held_out.value(&information)
    }

    fn slopes(&self, array: &LensletArray, draw: &GradientDraw, go_on: &dyn Fn() -> bool) -> Slopes {
        let held = Cancellable { model: &self.model, go_on };
        Ok(self.imaging.gradient(array, draw, self.patch, &held)?.lenslets)
    }

    fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError> {
        Ok(self.model.state(details)?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError> {
        self.model = self.model.clone().with_state(bytes)?;
        Ok(())
    }

    fn can_overrate(&self) -> bool {
        true
    }

    fn density_model(&self) -> Option<&CausalModel> {
        Some(&self.model)
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::objects::{ObjectOptions, ObjectSet};
    use crate::sensor::Noise;

    #[test]
    fn a_value_is_left_between_two_parts_of_its_patches() {
        let options = ObjectOptions { field: (27, 27), mean_photons: 100.0 };
        let set = ObjectSet::open(&"beads:0.05".parse().unwrap(), &options).unwrap();
        let imaging = ForwardModel::new(&set, (12, 12), 10.0, Noise::Shot).unwrap();
        let start = LensletArray { rows: 12, cols: 12, lenslets: vec![Lenslet::round(5.0, 5.0, 1.0, 1.0)] };
        let guide = DensityGuide::new(&imaging, &start, &Limits::default(), ((6, 6), 1)).unwrap();
        let left = Cell::new(2);
        let value = guide.value(&start, false, &|| left.replace(left.get() - 1) > 1);
        assert!(matches!(value, Err(IdealError::Information(InformationError::Cancelled))));
        assert_eq!(left.get(), 0);
    }

    /// Knows the mean of what it is given.
    struct Mean;

    impl FrozenDensity for Mean {
        fn information_gradient(
            &self,
            clean: ArrayView3<'_, f32>,
            normals: ArrayView3<'_, f32>,
        ) -> Result<(f64, Array3<f64>), InformationError> {
            let share = 1.0 / clean.len() as f64;
            let values = (&clean * &normals).mapv(f64::from);
            Ok((values.sum() * share, values * share))
        }
    }

    #[test]
    fn parts_make_the_whole_and_can_be_left() {
        let clean = Array3::from_shape_fn((150, 2, 3), |(n, r, c)| (n * 7 % 11 + r + 2 * c) as f32);
        let normals = clean.mapv(|x| 0.1 * x - 0.4);
        let asked = Cell::new(0);
        let go_on = |most: usize| {
            let asked = &asked;
            move || {
                asked.set(asked.get() + 1);
                asked.get() <= most
            }
        };
        let held = Cancellable { model: &Mean, go_on: &go_on(3) };
        let (bits, gradient) = held.information_gradient(clean.view(), normals.view()).unwrap();
        let (whole, by_whole) = Mean.information_gradient(clean.view(), normals.view()).unwrap();
        assert!((bits - whole).abs() < 1e-12 * whole.abs());
        assert!(gradient.iter().zip(&by_whole).all(|(one, other)| (one - other).abs() < 1e-15));
        assert_eq!(asked.get(), 3);
        let held = Cancellable { model: &Mean, go_on: &go_on(5) };
        let left = held.information_gradient(clean.view(), normals.view());
        assert!(matches!(left, Err(InformationError::Cancelled)) && asked.get() == 6);
    }
}
