//! Causal density model of the measurements; its cross-entropy gives an upper bound on the information.

use ndarray::{Array3, ArrayView3, Axis, Slice, concatenate};

use super::{MaskGradient, ModelFit, ModelValue, ObjectiveModel, SAMPLE, WARM_RATE};
use crate::design::error::IdealError;
use crate::design::gradient::GradientDraw;
use crate::design::objective_model::held_out::{HeldOut, HeldOutPatches};
use crate::forward::ForwardModel;
use crate::information::{AnalyticMoments, MeasurementStream};
use crate::information::{
    CausalFit, CausalModel, CausalRefit, CausalShape, FitContext, FitLength, FitStep, FrozenDensity, InformationError,
    NoiseEntropy, PatchBatch, PatchStream, Protocol, check_causal_patch, score_with_progress,
};
use crate::objects::Split;
use crate::optics::{Lenslet, LensletArray, Limits, render_psf};
use crate::progress::Progress;
use crate::seeds::SeedStream;

/// The causal model, refitted to the mask.
pub(in crate::design) struct DensityModel {
    /// Forward model with the noise of the upper bound.
    forward: ForwardModel,
    moments: AnalyticMoments,
    patch: (usize, usize),
    seed: u64,
    entropy: NoiseEntropy,
    held_out: HeldOut,
    /// Weights before any fit, for the mask of the start.
    initial: CausalModel,
    model: CausalModel,
    /// Measurements through the mask of the model.
    stream: MeasurementStream,
    /// The online fit to a mask that moves on from there.
    refit: Option<CausalRefit>,
}

impl DensityModel {
    /// An unfitted model. Its intensity grid reaches up to the brightest measurement that the limits allow: that of one sharp
    /// lenslet, on any plane.
    ///
    /// # Errors
    /// Where objects, noise and patch allow none.
    pub fn new(
        forward: &ForwardModel,
        start: &LensletArray,
        limits: &Limits,
        patch: (usize, usize),
        seed: u64,
    ) -> Result<Self, IdealError> {
        check_causal_patch(patch)?;
        let forward = forward.bounding();
        let moments = forward.analytic_moments(Split::Train, (start.rows, start.cols), patch)?;
        let held_out = HeldOut::new(&forward, patch, seed)?;
        let entropy = NoiseEntropy::new(forward.noise, Protocol::Default)?;
        let planes = forward.set.planes();
        let drawn = |array: &LensletArray| -> Result<_, IdealError> {
            let psf = render_psf(array, planes)?;
            let stream = forward.stream(forward.convolver(psf.view())?, Split::Train, patch);
            Ok((stream.draw(SAMPLE, SeedStream::ScalePatches.derive(seed))?, psf, stream))
        };
        let (sample, psf, stream) = drawn(start)?;
        let (x, y) = ((start.cols / 2) as f64, (start.rows / 2) as f64);
        let planes_in_use = start.planes().min(planes);
        // All the light may gather on one plane.
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
        let initial = CausalModel::covering(CausalShape::default(), forward.noise, &sample, &known, &extremes, seed)?;
        let model = initial.clone();
        Ok(Self { forward, moments, patch, seed, entropy, held_out, initial, model, stream, refit: None })
    }

    /// Training measurements through a mask of this PSF.
    fn training_stream(&self, psf: ArrayView3<'_, f64>) -> Result<MeasurementStream, IdealError> {
        Ok(self.forward.stream(self.forward.convolver(psf)?, Split::Train, self.patch))
    }
}

/// Patches of a gradient between two reports.
const REPORT_EVERY: usize = 64;

/// Density whose gradient by thousands of patches is computed in parts.
struct InParts<'a>(&'a dyn FrozenDensity);

impl FrozenDensity for InParts<'_> {
    fn information_gradient(
        &self,
        clean: ArrayView3<'_, f32>,
        normals: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<usize>,
    ) -> Result<(f64, Array3<f64>), InformationError> {
        let patches = clean.len_of(Axis(0));
        let mut gradient = Array3::zeros(clean.dim());
        let mut bits = 0.0;
        for first in (0..patches).step_by(REPORT_EVERY) {
            if progress.report(&first).is_break() {
                return Err(InformationError::Cancelled);
            }
            let part = Slice::from(first..(first + REPORT_EVERY).min(patches));
            let (clean, normals) = (clean.slice_axis(Axis(0), part), normals.slice_axis(Axis(0), part));
            let (part_bits, mut by_part) = self.0.information_gradient(clean, normals, progress)?;
            let share = by_part.len_of(Axis(0)) as f64 / patches as f64;
            by_part *= share;
            bits += share * part_bits;
            gradient.slice_axis_mut(Axis(0), part).assign(&by_part);
        }
        Ok((bits, gradient))
    }
}

impl ObjectiveModel for DensityModel {
    fn retarget(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError> {
        let psf = render_psf(array, self.forward.set.planes())?;
        self.stream = self.training_stream(psf.view())?;
        let sample = self.stream.draw(SAMPLE, SeedStream::ScalePatches.derive(self.seed))?;
        let moments = self.moments.of(psf.view())?;
        self.model =
            if warm { self.model.following(&sample, &moments)? } else { self.initial.anew(&sample, &moments)? };
        self.refit = None;
        Ok(())
    }

    fn fit(&mut self, fit: &ModelFit, progress: &mut dyn Progress<f64>) -> Result<(), IdealError> {
        let &ModelFit { steps, seed, warm } = fit;
        let mut fit = CausalFit::new(FitLength::Steps(steps), seed);
        if warm {
            fit.rate *= WARM_RATE;
        }
        let on_step = &mut |step: &FitStep<'_>| progress.report(&(step.progress.step as f64 / steps as f64));
        fit.fit(&mut self.model, &FitContext::new(&self.stream), on_step)?;
        Ok(())
    }

    fn fit_online(
        &mut self,
        &ModelFit { steps: all, seed, .. }: &ModelFit,
        array: &LensletArray,
        steps: usize,
        progress: &mut dyn Progress<usize>,
    ) -> Result<bool, IdealError> {
        let psf = render_psf(array, self.forward.set.planes())?;
        let stream = self.training_stream(psf.view())?;
        let refit = self.refit.get_or_insert_with(|| CausalRefit::new(all, seed, self.model.clone()));
        refit.advance_to(steps, &stream, progress)?;
        self.model = refit.model();
        Ok(true)
    }

    fn value(
        &self,
        array: &LensletArray,
        _last: bool,
        progress: &mut dyn Progress<usize>,
    ) -> Result<ModelValue, IdealError> {
        let HeldOutPatches { clean, noisy } = self.held_out.measured(&self.forward, array)?;
        let test = PatchBatch { noisy, clean: Some(clean) };
        let scores = score_with_progress(&self.model, &self.entropy, &test, progress)?;
        self.held_out.value(&scores.information)
    }

    fn gradient(&self, array: &LensletArray, draw: &GradientDraw, progress: &mut dyn Progress<usize>) -> MaskGradient {
        Ok(self.forward.gradient(array, draw, self.patch, &InParts(&self.model), progress)?.lenslets)
    }

    fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError> {
        Ok(self.model.state(details)?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError> {
        self.model = self.model.clone().with_state(bytes)?;
        Ok(())
    }

    fn is_upper_bound(&self) -> bool {
        true
    }

    fn density_model(&self) -> Option<&CausalModel> {
        Some(&self.model)
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::objects::{ObjectOptions, ObjectSet};
    use crate::sensor::Noise;

    #[test]
    fn value_can_be_cancelled() {
        let options = ObjectOptions { field: (27, 27), mean_photons: 100.0, ..ObjectOptions::default() };
        let set = ObjectSet::open(&"beads:0.05".parse().unwrap(), &options).unwrap();
        let forward = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap();
        let start = LensletArray::new(12, 12, vec![Lenslet::round(5.0, 5.0, 1.0, 1.0)]);
        let model = DensityModel::new(&forward, &start, &Limits::default(), (6, 6), 1).unwrap();
        let mut reports = 0;
        let value = model.value(&start, false, &mut |_: &usize| {
            reports += 1;
            if reports < 2 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        });
        assert!(matches!(value, Err(IdealError::Information(InformationError::Cancelled))));
        assert_eq!(reports, 2);
    }

    /// Density whose information is a mean.
    struct Mean;

    impl FrozenDensity for Mean {
        fn information_gradient(
            &self,
            clean: ArrayView3<'_, f32>,
            normals: ArrayView3<'_, f32>,
            _progress: &mut dyn Progress<usize>,
        ) -> Result<(f64, Array3<f64>), InformationError> {
            let share = 1.0 / clean.len() as f64;
            let values = (&clean * &normals).mapv(f64::from);
            Ok((values.sum() * share, values * share))
        }
    }

    #[test]
    fn gradient_is_the_mean_of_its_parts_and_can_be_cancelled() {
        let clean = Array3::from_shape_fn((150, 2, 3), |(n, r, c)| (n * 7 % 11 + r + 2 * c) as f32);
        let normals = clean.mapv(|x| 0.1 * x - 0.4);
        let computed = |model: &dyn FrozenDensity, last: usize| {
            let mut reported = Vec::new();
            let result = model.information_gradient(clean.view(), normals.view(), &mut |patches: &usize| {
                reported.push(*patches);
                if *patches < last { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            });
            (result, reported)
        };
        let (result, reported) = computed(&InParts(&Mean), 150);
        assert_eq!(reported, [0, 64, 128]);
        let (bits, gradient) = result.unwrap();
        let (whole, by_whole) = computed(&Mean, 150).0.unwrap();
        assert!((bits - whole).abs() < 1e-12 * whole.abs());
        assert!(gradient.iter().zip(&by_whole).all(|(one, other)| (one - other).abs() < 1e-15));
        assert_eq!(computed(&InParts(&Mean), 64), (Err(InformationError::Cancelled), vec![0, 64]));
    }
}
