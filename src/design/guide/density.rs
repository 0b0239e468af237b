//! A density model of the measurements, whose cross-entropy bounds the information from above.

use ndarray::{Array3, ArrayView3, Axis, concatenate};

use super::{Guide, GuideFit, HeldOut, OnFit, SAMPLE, Slopes, Valued, WARM_RATE};
use crate::design::error::IdealError;
use crate::design::gradient::GradientDraw;
use crate::design::imaging::{Imaging, KnownMoments, MeasurementStream, derived_seed};
use crate::information::{
    CausalFit, CausalModel, CausalRefit, CausalShape, FitLength, NoiseEntropy, PatchBatch, PatchStream, Protocol, score,
};
use crate::objects::Split;
use crate::optics::{Lenslet, LensletArray, Limits, render_psf};

/// The causal density model of live estimates.
pub(in crate::design) struct DensityGuide<'a> {
    /// With the noise that bounds from above.
    imaging: Imaging<'a>,
    moments: KnownMoments<'a>,
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
        imaging: &Imaging<'a>,
        start: &LensletArray,
        limits: &Limits,
        (patch, seed): ((usize, usize), u64),
    ) -> Result<Self, IdealError> {
        let imaging = imaging.bounding();
        let moments = imaging.known_moments(Split::Train, (start.rows, start.cols), patch)?;
        let held_out = HeldOut::new(&imaging, patch, seed)?;
        let entropy = NoiseEntropy::new(imaging.noise, Protocol::Default)?;
        let planes = imaging.set.planes();
        let drawn = |array: &LensletArray| -> Result<_, IdealError> {
            let psf = render_psf(array, planes)?;
            let stream = imaging.stream(imaging.convolver(psf.view())?, Split::Train, patch);
            Ok((stream.draw(SAMPLE, derived_seed(seed, 2))?, psf, stream))
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

impl Guide for DensityGuide<'_> {
    fn follow(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError> {
        let psf = render_psf(array, self.imaging.set.planes())?;
        self.stream = self.seen_through(psf.view())?;
        let sample = self.stream.draw(SAMPLE, derived_seed(self.seed, 2))?;
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
        refit.go_on(steps, &stream, go_on)?;
        self.model = refit.model();
        Ok(true)
    }

    fn value(&self, array: &LensletArray, _last: bool, _go_on: &dyn Fn() -> bool) -> Result<Valued, IdealError> {
        let (clean, noisy) = self.held_out.measured(&self.imaging, array)?;
        let (information, _) = score(&self.model, &self.entropy, &PatchBatch { noisy, clean: Some(clean) })?;
        self.held_out.value(&information)
    }

    fn slopes(&self, array: &LensletArray, draw: &GradientDraw, _go_on: &dyn Fn() -> bool) -> Slopes {
        Ok(self.imaging.gradient(array, draw, self.patch, &self.model)?.lenslets)
    }

    fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError> {
        Ok(self.model.state(details)?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError> {
        self.model = self.first.clone().with_state(bytes)?;
        Ok(())
    }

    fn can_overrate(&self) -> bool {
        true
    }

    fn density_model(&self) -> Option<&CausalModel> {
        Some(&self.model)
    }
}
