//! Posterior mean and variance of bead objects given one measurement.
//!
//! The trained decoder gives the probability of a bead at every site. Blurred by the bead, the probabilities are an estimate of the mean.
//! Markov chains that start there and anneal to the posterior (as in [`super::chain`]) give mean and variance themselves.

use std::ops::{ControlFlow, Range};

use ndarray::{Array2, ArrayView2, Axis};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::bound::{FLIPS_PER_SITE, MOST_CERTAIN, SHIFTS_PER_BEAD};
use super::chain::{RECOMPUTE_EVERY, beta};
use super::light::Light;
use super::proposals::{InitialDistribution, Moves, SweepSize, mcmc_sweep, probability};
use super::state::{Measurement, State};
use crate::forward::bead_response;
use crate::information::decoder::channel::BeadChannel;
use crate::information::decoder::layers::Decoder;
use crate::information::decoder::pass::Pass;
use crate::information::decoder::problem::Problem;
use crate::information::decoder::samples::Sample;
use crate::information::error::InformationError;
use crate::objects::BeadPrior;
use crate::sensor::Noise;

/// Sweeps between two reports.
const REPORT_EVERY: usize = 4;

/// A measurement of beads: the scene, the mask and the light.
#[derive(Clone, Debug)]
pub struct BeadScene<'a> {
    /// The beads, in photons as they are lit.
    pub prior: &'a BeadPrior,
    /// Rows and columns of the objects.
    pub field: (usize, usize),
    /// Point spread function, shape (rows, cols).
    pub psf: ArrayView2<'a, f64>,
    /// Background, photons per pixel.
    pub background: f64,
    /// Noise of the sensor.
    pub noise: Noise,
}

/// Mean and variance of an object given a measurement, shape (rows, cols) of the field.
#[derive(Clone, Debug)]
pub struct ObjectPosterior {
    /// Mean, photons per pixel.
    pub mean: Array2<f32>,
    /// Variance of every pixel, photons squared.
    pub variance: Array2<f32>,
}

/// Length of the chains of one measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PosteriorChains {
    /// Independent chains. Samples of all of them count alike, so the variance shows where they disagree.
    pub chains: usize,
    /// Sweeps from the decoder's probabilities to the posterior.
    pub annealing: usize,
    /// Sweeps at the posterior whose objects are averaged.
    pub sampling: usize,
    /// Seed of the chains.
    pub seed: u64,
}

impl PosteriorChains {
    /// Four chains of `sweeps` sweeps each, of which the last third is averaged.
    ///
    /// A chain that is stuck in one explanation of the measurement shows in the mean of few chains, so four short ones give a better mean
    /// than two of twice their length.
    pub fn of_sweeps(sweeps: usize, seed: u64) -> Self {
        let sampling = (sweeps / 3).max(1);
        Self { chains: 4, annealing: sweeps.saturating_sub(sampling).max(1), sampling, seed }
    }
}

/// Function that is called with the number of sweeps done and with the posteriors so far.
pub type OnSweeps<'a, T> = dyn FnMut(usize, &dyn Fn() -> Vec<ObjectPosterior>) -> T + 'a;

/// Posterior of beads through one mask.
pub struct BeadPosterior {
    problem: Problem,
    light: Light,
    moves: Moves,
    decoder: Decoder,
    prior: BeadPrior,
    field: (usize, usize),
    /// Site of the first pixel of the field.
    corner: (usize, usize),
    /// Whether a site lies in the field. There are no beads elsewhere.
    in_field: Vec<bool>,
}

impl BeadPosterior {
    /// Plans the transforms of a scene with one depth plane.
    ///
    /// # Errors
    /// As [`crate::information::decoder_lower_bound`] for an invalid channel: no light, no noise, a sensor too large.
    pub fn new(scene: &BeadScene<'_>, decoder: &Decoder) -> Result<Self, InformationError> {
        let (psf, prior) = (scene.psf, scene.prior);
        let patch = ((scene.field.0 + 1).saturating_sub(psf.nrows()), (scene.field.1 + 1).saturating_sub(psf.ncols()));
        let channel = BeadChannel {
            spot: bead_response(&prior.spot, psf.insert_axis(Axis(0))),
            probability: prior.probability,
            bias: scene.background,
            noise: scene.noise,
            patch,
        };
        let spot = channel.whole_spot()?;
        let problem = Problem::of(&channel, spot.clone())?;
        let (light, moves) = (Light::new(&spot, &problem), Moves::new(&spot));
        // A bead at pixel r of the field adds spot[k] to row r - anchor + k of the full convolution, and a site q to row q + k - (rows of
        // the spot - 1) of the measurement, which begins at row (rows of the PSF - 1).
        let corner = (prior.spot.nrows() - 1 - prior.anchor.0, prior.spot.ncols() - 1 - prior.anchor.1);
        let mut in_field = vec![false; problem.site_count()];
        for row in corner.0..corner.0 + scene.field.0 {
            let start = row * problem.sites.cols + corner.1;
            in_field[start..start + scene.field.1].fill(true);
        }
        Ok(Self {
            problem,
            light,
            moves,
            decoder: decoder.clone(),
            prior: prior.clone(),
            field: scene.field,
            corner,
            in_field,
        })
    }

    /// The mean object of a measurement, row by row, by the probabilities of the decoder.
    pub fn mean_of_decoder(&self, noisy: &[f32]) -> Array2<f32> {
        let odds = self.log_odds(noisy);
        let mut image = Array2::zeros(self.field);
        for (pixel, site) in self.sites() {
            self.add_bead(pixel, probability(f64::from(odds[site])), &mut image);
        }
        image.mapv(|value| value as f32)
    }

    /// Posteriors of measurements, each row by row, by Markov chains. `progress` is called after every few sweeps with the number of sweeps
    /// done and the posteriors so far; there are none while the chains anneal. It ends the chains by `Break`.
    ///
    /// # Errors
    /// [`InformationError::Cancelled`].
    pub fn of_chains(
        &self,
        measurements: &[Vec<f32>],
        settings: PosteriorChains,
        progress: &mut OnSweeps<'_, ControlFlow<()>>,
    ) -> Result<Vec<ObjectPosterior>, InformationError> {
        let starts: Vec<(InitialDistribution, Measurement)> =
            measurements.par_iter().map(|noisy| self.start(noisy)).collect();
        let per_image = settings.chains.max(1);
        let chain = |(initial, measured), index| Chain::new(self, initial, measured, settings.seed, index);
        let mut chains: Vec<Chain<'_>> = starts
            .iter()
            .flat_map(|(initial, measured)| (0..per_image).map(move |index| chain((initial, measured), index)))
            .collect();
        let posteriors = |chains: &[Chain<'_>]| {
            let of_image = |chains: &[Chain<'_>]| {
                let mut record = Record::new(self.field);
                for chain in chains {
                    record.join(&chain.record);
                }
                record.posterior()
            };
            chains.chunks(per_image).map(of_image).collect::<Vec<_>>()
        };
        let most = settings.annealing + settings.sampling.max(1);
        for first in (0..most).step_by(REPORT_EVERY) {
            let sweeps = first + 1..(first + REPORT_EVERY).min(most) + 1;
            let done = sweeps.end - 1;
            chains.par_iter_mut().with_max_len(1).for_each(|chain| chain.run(sweeps.clone(), settings.annealing));
            let so_far = || if done > settings.annealing { posteriors(&chains) } else { Vec::new() };
            if progress(done, &so_far).is_break() {
                return Err(InformationError::Cancelled);
            }
        }
        Ok(posteriors(&chains))
    }

    /// Initial distribution of the chains of a measurement, by the decoder.
    fn start(&self, noisy: &[f32]) -> (InitialDistribution, Measurement) {
        let prior = f64::from(self.problem.prior_logit());
        let limit = MOST_CERTAIN.max(prior.abs() + 2.0);
        let initial = InitialDistribution::new(&self.log_odds(noisy), self.in_field.clone(), prior, limit);
        (initial, Measurement::new(&self.problem, &self.light, &self.sample(noisy), |_| false))
    }

    /// Log odds of a bead at every site by the decoder.
    fn log_odds(&self, noisy: &[f32]) -> Vec<f32> {
        let mut pass = Pass::new(&self.problem, self.decoder.unrolled());
        pass.sample = self.sample(noisy);
        pass.forward(&self.decoder, self.decoder.weights());
        let claimed = pass.claimed();
        let mut odds = vec![self.problem.prior_logit(); self.in_field.len()];
        for &site in &self.problem.decoded {
            odds[site] = claimed[site];
        }
        odds
    }

    /// A measurement without known beads.
    fn sample(&self, noisy: &[f32]) -> Sample {
        let sites = self.in_field.len();
        let mut sample = Sample {
            beads: vec![0.0; sites],
            noisy: noisy.to_vec(),
            free: vec![0.0; sites],
            known: vec![self.problem.probability as f32; sites],
            weight: 1.0,
            ..Sample::default()
        };
        for &site in &self.problem.decoded {
            sample.free[site] = 1.0;
        }
        for site in (0..sites).filter(|&site| !self.in_field[site]) {
            (sample.free[site], sample.known[site]) = (0.0, 0.0);
        }
        sample
    }

    /// Pixels of the field with their sites.
    fn sites(&self) -> impl Iterator<Item = ((usize, usize), usize)> + '_ {
        let (rows, cols) = self.field;
        let pixels = (0..rows).flat_map(move |row| (0..cols).map(move |col| (row, col)));
        pixels.map(|(row, col)| ((row, col), (row + self.corner.0) * self.problem.sites.cols + col + self.corner.1))
    }

    /// Adds `share` of a bead at a pixel of the field to an image of it.
    fn add_bead(&self, (row, col): (usize, usize), share: f64, image: &mut Array2<f64>) {
        let (rows, cols) = self.field;
        let (anchor_row, anchor_col) = self.prior.anchor;
        for ((i, j), &photons) in self.prior.spot.indexed_iter() {
            let place = (row + i).checked_sub(anchor_row).zip((col + j).checked_sub(anchor_col));
            if let Some((row, col)) = place.filter(|&(row, col)| row < rows && col < cols) {
                image[(row, col)] += share * photons;
            }
        }
    }
}

/// One chain.
struct Chain<'a> {
    scene: &'a BeadPosterior,
    initial: &'a InitialDistribution,
    state: State<'a>,
    random: ChaCha8Rng,
    effort: SweepSize,
    record: Record,
}

impl<'a> Chain<'a> {
    fn new(
        scene: &'a BeadPosterior,
        initial: &'a InitialDistribution,
        measured: &'a Measurement,
        seed: u64,
        index: usize,
    ) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(index as u64);
        let beads = initial.draw(&mut random).into_iter();
        let sites = (scene.field.0 * scene.field.1) as f64;
        let effort = SweepSize {
            flips: (FLIPS_PER_SITE * sites).ceil() as usize,
            shifts: (SHIFTS_PER_BEAD * scene.problem.probability * sites).ceil() as usize,
        };
        let state = State::new(&scene.light, measured, scene.in_field.len(), beads);
        Self { scene, initial, state, random, effort, record: Record::new(scene.field) }
    }

    /// Runs sweeps of these numbers, of which the first `annealing` raise the inverse temperature.
    fn run(&mut self, sweeps: Range<usize>, annealing: usize) {
        let Self { scene, initial, state, random, effort, record } = self;
        for sweep in sweeps {
            let beta = if sweep >= annealing { 1.0 } else { beta(sweep as f64 / annealing as f64) };
            mcmc_sweep(state, initial, &scene.moves, beta, *effort, scene.light.grid, random);
            if sweep.is_multiple_of(RECOMPUTE_EVERY) {
                state.refresh();
            }
            if sweep > annealing {
                record.add(scene, &state.occupied);
            }
        }
    }
}

/// Sums over objects of a chain.
struct Record {
    count: f64,
    sum: Array2<f64>,
    squares: Array2<f64>,
}

impl Record {
    fn new(field: (usize, usize)) -> Self {
        Self { count: 0.0, sum: Array2::zeros(field), squares: Array2::zeros(field) }
    }

    fn add(&mut self, scene: &BeadPosterior, occupied: &[u32]) {
        let mut object = Array2::zeros(scene.field);
        let cols = scene.problem.sites.cols;
        for &site in occupied {
            let place = (site as usize / cols - scene.corner.0, site as usize % cols - scene.corner.1);
            scene.add_bead(place, 1.0, &mut object);
        }
        self.count += 1.0;
        self.sum += &object;
        self.squares += &object.mapv(|value| value * value);
    }

    fn join(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += &other.sum;
        self.squares += &other.squares;
    }

    fn posterior(&self) -> ObjectPosterior {
        let mean = &self.sum / self.count;
        let variance = &self.squares / self.count - mean.mapv(|value| value * value);
        ObjectPosterior {
            mean: mean.mapv(|value| value as f32),
            variance: variance.mapv(|value| value.max(0.0) as f32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};
    use rand::RngExt;

    /// Two sites in three far apart in probability; all 2^12 configurations are enumerated.
    #[test]
    fn chains_give_the_mean_and_variance_of_the_enumerated_posterior() {
        let field = (3, 4);
        let prior = BeadPrior { probability: 0.15, planes: 1, spot: array![[2.0, 5.0], [7.0, 3.0]], anchor: (1, 0) };
        let psf = array![[0.5, 0.1], [0.0, 0.4]];
        let scene = BeadScene { prior: &prior, field, psf: psf.view(), background: 2.0, noise: Noise::Shot };
        let posterior = BeadPosterior::new(&scene, Decoder::shipped().unwrap()).unwrap();
        let object = |beads: u32| {
            let mut image = Array2::<f64>::zeros(field);
            for site in (0..12).filter(|site| beads >> site & 1 == 1) {
                posterior.add_bead((site / 4, site % 4), 1.0, &mut image);
            }
            image
        };
        let measure = |object: &Array2<f64>| {
            Array2::from_shape_fn((2, 3), |(row, col)| {
                let light = psf.indexed_iter().map(|((r, c), &h)| h * object[(row + 1 - r, col + 1 - c)]);
                light.sum::<f64>() + 2.0
            })
        };
        // A draw of two beads.
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let clean = measure(&object(1 << 5 | 1 << 7));
        let noisy: Vec<f32> =
            clean.iter().map(|&mean| (mean + mean.sqrt() * (random.random::<f64>() - 0.5)).round() as f32).collect();
        let (mut total, mut mean, mut square) = (0.0, Array2::<f64>::zeros(field), Array2::<f64>::zeros(field));
        for beads in 0..1_u32 << 12 {
            let image = object(beads);
            let likelihood = measure(&image).iter().zip(&noisy).map(|(&x, &y)| f64::from(y) * x.ln() - x).sum::<f64>();
            let held = f64::from(beads.count_ones());
            let weight = (likelihood + held * 0.15_f64.ln() + (12.0 - held) * 0.85_f64.ln()).exp();
            total += weight;
            mean.scaled_add(weight, &image);
            square.scaled_add(weight, &image.mapv(|value| value * value));
        }
        mean /= total;
        let variance = square / total - mean.mapv(|value| value * value);
        let chains = PosteriorChains { chains: 4, annealing: 200, sampling: 20_000, seed: 1 };
        let found = posterior.of_chains(&[noisy], chains, &mut |_, _| ControlFlow::Continue(())).unwrap();
        for ((row, col), &expected) in mean.indexed_iter() {
            let (mean, of_mean) = (f64::from(found[0].mean[(row, col)]), f64::from(found[0].variance[(row, col)]));
            assert!((mean - expected).abs() < 0.15, "mean at {row}, {col}: {mean} against {expected}");
            let spread = variance[(row, col)];
            assert!((of_mean - spread).abs() < 0.08 * spread + 0.3, "variance at {row}, {col}: {of_mean}, {spread}");
        }
    }
}
