//! Posterior mean of beads: the estimate of least squared error.
//!
//! At once by the trained decoder, whose probabilities count as independent; given time, by Markov chains that start from them.

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};
use rayon::prelude::*;

use super::decoder::{Decoder, DecoderKind, ObjectEstimates, PreparedDecoder, ReconstructionStep};
use super::error::ReconstructionError;
use super::linear::Prior;
use super::model::ImagingModel;
use super::one_by_one::report;
use crate::information::{
    BeadPosterior, BeadScene, Decoder as BeadDecoder, ObjectPosterior, OnSweeps, PosteriorChains,
};
use crate::objects::BeadPrior;
use crate::progress::{CancelToken, Progress};

/// Chains that the standard deviation is taken from where the mean is the decoder's. Independent probabilities would overstate it: a bead
/// between two pixels counts at both. Each of a few short chains may be sure of one explanation, so there are many.
const CHAINS_OF_DEVIATION: PosteriorChains = PosteriorChains { chains: 8, annealing: 80, sampling: 20, seed: 1 };

/// Posterior mean of beads.
pub struct PosteriorMean {
    beads: BeadPrior,
    to_set_scale: f64,
    chains: Option<PosteriorChains>,
}

impl PosteriorMean {
    /// The posterior mean under a prior of beads; without `chains` by the trained decoder alone.
    ///
    /// # Errors
    /// [`ReconstructionError::NoBeads`] for the prior of other objects.
    pub fn new(prior: &Prior, chains: Option<PosteriorChains>) -> Result<Self, ReconstructionError> {
        let beads = prior.lit_beads().ok_or(ReconstructionError::NoBeads)?;
        Ok(Self { beads, to_set_scale: prior.to_set_scale(), chains })
    }
}

impl Decoder for PosteriorMean {
    fn kind(&self) -> DecoderKind {
        DecoderKind::Posterior
    }

    fn prepare(
        &self,
        model: &ImagingModel,
        _cancel: &CancelToken,
    ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError> {
        let decoder =
            BeadDecoder::shipped_deep().or_else(BeadDecoder::shipped).ok_or(ReconstructionError::NoWeights)?;
        let scene = BeadScene {
            prior: &self.beads,
            field: model.field(),
            psf: model.psf(),
            background: model.background,
            noise: model.noise,
        };
        let posterior = BeadPosterior::new(&scene, decoder)?;
        Ok(Box::new(Prepared { model: model.clone(), posterior, to_set_scale: self.to_set_scale, chains: self.chains }))
    }
}

/// The posterior of one mask.
struct Prepared {
    model: ImagingModel,
    posterior: BeadPosterior,
    to_set_scale: f64,
    chains: Option<PosteriorChains>,
}

impl Prepared {
    /// Mean object on the scale of the set.
    fn object(&self, mean: &Array2<f32>) -> Array2<f32> {
        mean.mapv(|value| (f64::from(value) * self.to_set_scale) as f32)
    }

    /// Mean variance of a posterior on the scale of the set, photons squared.
    fn expected_mse_of(&self, posterior: &ObjectPosterior) -> f64 {
        let sum = posterior.variance.iter().map(|&value| f64::from(value)).sum::<f64>();
        sum / posterior.variance.len() as f64 * self.to_set_scale.powi(2)
    }

    /// Posteriors of a few measurements by chains. The error of `on_sweeps` ends them.
    fn by_chains(
        &self,
        measurements: &[Vec<f32>],
        chains: PosteriorChains,
        on_sweeps: &mut OnSweeps<'_, Result<(), ReconstructionError>>,
    ) -> Result<Vec<ObjectPosterior>, ReconstructionError> {
        let mut failed = None;
        let found = self.posterior.of_chains(measurements, chains, &mut |done, so_far| match on_sweeps(done, so_far) {
            Ok(()) => std::ops::ControlFlow::Continue(()),
            Err(error) => {
                failed = Some(error);
                std::ops::ControlFlow::Break(())
            }
        });
        match failed {
            Some(error) => Err(error),
            None => Ok(found?),
        }
    }

    fn check(&self, measurements: &ArrayView3<'_, f32>) -> Result<(), ReconstructionError> {
        self.model.check_measurements(measurements)?;
        ReconstructionError::check_finite("measurements", measurements)
    }
}

impl PreparedDecoder for Prepared {
    fn reconstruct(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array3<f32>, ReconstructionError> {
        Ok(self.estimate(measurements, progress)?.objects)
    }

    fn estimate(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<ObjectEstimates, ReconstructionError> {
        self.check(&measurements)?;
        let total = measurements.len_of(Axis(0));
        let (rows, cols) = self.model.field();
        let mut objects = Array3::zeros((total, rows, cols));
        let mut expected_mse = Vec::with_capacity(total);
        let noisy: Vec<Vec<f32>> = measurements.outer_iter().map(|image| image.iter().copied().collect()).collect();
        let most = self.chains.map_or(1, |chains| chains.annealing + chains.sampling);
        let together = rayon::current_num_threads().div_ceil(self.chains.map_or(1, |chains| chains.chains.max(1)));
        for (group, measurements) in noisy.chunks(together.max(1)).enumerate() {
            let first = group * together.max(1);
            let found = match self.chains {
                None => measurements.par_iter().map(|noisy| self.posterior.mean_of_decoder(noisy)).collect(),
                Some(chains) => {
                    let found = self.by_chains(measurements, chains, &mut |done, so_far| {
                        if total > 1 {
                            // The count is that of the images before this group; here it only polls for cancellation.
                            return report(progress, &ReconstructionStep::Images { done: first, total });
                        }
                        let object = so_far().first().map(|posterior| self.object(&posterior.mean).into());
                        report(progress, &ReconstructionStep::Iteration { done, most, object })
                    })?;
                    expected_mse.extend(found.iter().map(|posterior| self.expected_mse_of(posterior)));
                    found.into_iter().map(|posterior| posterior.mean).collect::<Vec<_>>()
                }
            };
            for (index, mean) in found.iter().enumerate() {
                objects.index_axis_mut(Axis(0), first + index).assign(&self.object(mean));
            }
            let done = first + found.len();
            report(progress, &ReconstructionStep::Images { done, total })?;
        }
        let expected_mse = self.chains.is_some().then_some(expected_mse);
        Ok(ObjectEstimates { objects, expected_mse })
    }

    fn standard_deviation(
        &self,
        measurement: ArrayView2<'_, f32>,
        cancel: &CancelToken,
    ) -> Result<Option<Array2<f32>>, ReconstructionError> {
        self.check(&measurement.insert_axis(Axis(0)))?;
        let noisy: Vec<f32> = measurement.iter().copied().collect();
        let chains = self.chains.unwrap_or(CHAINS_OF_DEVIATION);
        let mut found = self.by_chains(std::slice::from_ref(&noisy), chains, &mut |_, _| {
            if cancel.is_cancelled() { Err(ReconstructionError::Cancelled) } else { Ok(()) }
        })?;
        let Some(posterior) = found.pop() else { return Ok(None) };
        let mut squares = posterior.variance;
        if self.chains.is_none() {
            // The object is another estimate than the mean of these chains.
            let distance = self.posterior.mean_of_decoder(&noisy) - posterior.mean;
            squares += &distance.mapv(|value| value * value);
        }
        Ok(Some(squares.mapv(|square| (f64::from(square).sqrt() * self.to_set_scale) as f32)))
    }
}
