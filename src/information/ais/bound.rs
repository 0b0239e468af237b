//! AIS bounds in bits per pixel.

use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::chain::AisChain;
use super::checkpoint::AisCheckpoint;
use super::light::Light;
use super::progress::AisObserver;
use super::proposals::{InitialDistribution, Moves, SweepSize};
use super::state::Measurement;
use crate::information::decoder::channel::BeadChannel;
use crate::information::decoder::layers::Decoder;
use crate::information::decoder::pass::Pass;
use crate::information::decoder::problem::Problem;
use crate::information::decoder::samples::{Purpose, Reveal, Sample, SampleId};
use crate::information::entropy::likelihood::log_likelihood;
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::FitCheckpoint;
use crate::information::statistics::area_sums::AreaSums;
use crate::information::statistics::student_t::student_95;
use crate::information::stopwatch::Stopwatch;
use crate::nn::Pool;
use crate::progress::Progress;

/// Samples between two reports.
const REPORT: usize = 4;
/// Smallest number of samples, for any budget; the interval of fewer is meaningless.
const FEWEST_SAMPLES: usize = 16;
/// Limit of the log odds of the initial distribution, or a little beyond those of the prior.
pub(super) const MOST_CERTAIN: f64 = 14.0;
/// Proposals per temperature: flips per site and moves per expected bead.
pub(super) const FLIPS_PER_SITE: f64 = 0.08;
pub(super) const SHIFTS_PER_BEAD: f64 = 2.5;
/// Control variate: squared separation at which a bead is taken to yield half of its surprise, and the share of the bead
/// count's variation that is removed.
const HALF_SEPARATION: f64 = 10.0;
const CONTROL_SHARE: f64 = 0.9;
/// Temperatures without a budget, and of the samples that measure speed.
const DEFAULT_LEVELS: usize = 400;
const TRIAL_LEVELS: usize = 32;
/// Index of the first of those samples, far from the others.
const FIRST_TRIAL: usize = 1 << 31;
/// Range of the number of temperatures with a budget.
const FEWEST_LEVELS: f64 = 64.0;
const MOST_LEVELS: f64 = 16_384.0;
/// Samples that a budget should cover.
const BUDGETED_SAMPLES: f64 = 48.0;
/// Temperatures up to which more temperatures help more than more samples. The reverse chain of one particle gains from
/// every temperature; the upper bound is soon limited by its groups.
const USEFUL_LEVELS_BELOW: f64 = 1024.0;
const USEFUL_LEVELS_ABOVE: f64 = 128.0;
/// Pixels of a patch above which the number for the lower bound grows in proportion.
const USUAL_PIXELS: f64 = 1024.0;
/// First random stream of the chains.
const CHAIN_STREAM: u64 = 0x7f << 56;

/// Settings of an AIS bound.
#[derive(Clone, Debug, PartialEq)]
pub struct AisSettings {
    /// Groups of sites of the upper bound, each annealed given the others. More groups are looser and need fewer
    /// temperatures. The lower bound uses one group.
    pub groups: usize,
    /// Particles per group; the lower bound uses one.
    pub particles: usize,
    /// Temperatures; `None` chooses as many as the budget allows for 16 to 48 samples.
    pub levels: Option<usize>,
    /// Largest number of samples.
    pub samples: usize,
    /// Half width of the 95 % interval at which sampling stops, bits per pixel.
    pub half_width: f64,
    /// Time after which no further samples start; 16 are always computed.
    pub budget: Option<Duration>,
    /// Seed of samples, groups and chains.
    pub seed: u64,
}

impl AisSettings {
    /// Default settings for a time budget.
    pub fn within(budget: Duration, seed: u64) -> Self {
        Self { levels: None, budget: Some(budget), ..Self::of_levels(DEFAULT_LEVELS, seed) }
    }

    /// Default settings for a number of temperatures. Equal seeds give equal bits on any number of threads.
    pub fn of_levels(levels: usize, seed: u64) -> Self {
        Self { groups: 4, particles: 4, levels: Some(levels), samples: 256, half_width: 0.0015, budget: None, seed }
    }

    fn check(&self) -> Result<(), InformationError> {
        let refuse = |expected, found: usize| Err(InformationError::DecoderFit { expected, found: found.to_string() });
        if !(1..=1 << 12).contains(&self.groups) {
            return refuse("1 to 4096 groups of sites", self.groups);
        }
        if !(1..=1 << 10).contains(&self.particles) {
            return refuse("1 to 1024 particles", self.particles);
        }
        if let Some(levels) = self.levels.filter(|levels| !(1..=1 << 24).contains(levels)) {
            return refuse("1 to 16,777,216 temperatures", levels);
        }
        if self.samples < 2 {
            return refuse("at least two samples", self.samples);
        }
        Ok(())
    }
}

/// Progress of an AIS bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AisProgress {
    /// Samples done.
    pub samples: usize,
    /// Largest number of samples.
    pub most: usize,
    /// Time since the start.
    pub elapsed: Duration,
    /// Estimated time left; `None` before the first samples.
    pub remaining: Option<Duration>,
    /// The bound so far, bits per pixel.
    pub bits_per_pixel: f64,
}

/// Bound on the information between beads and noisy measurements by annealed importance sampling.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AisBound {
    /// The bound, bits per pixel of the patch.
    pub bits_per_pixel: f64,
    /// 95 % interval (low, high), bits per pixel, from the standard error over samples (Student's t).
    pub interval_95: [f64; 2],
    /// Patch shape [rows, cols], pixels.
    pub patch: [usize; 2],
    /// Groups of sites.
    pub groups: usize,
    /// Particles per group.
    #[serde(alias = "walkers")]
    pub particles: usize,
    /// Temperatures.
    pub levels: usize,
    /// Samples.
    pub samples: usize,
    /// Computing time, seconds.
    pub seconds: f64,
    /// Seed of samples, groups and chains.
    pub seed: u64,
}

/// Upper bound on the information of a channel by forward AIS. It holds for any decoder; a better decoder and more
/// temperatures lower it. The noise is that of [`bounding`](crate::sensor::Noise::bounding).
///
/// A bound resumes from the checkpoint in `keeper`. With a fixed number of temperatures the result is the same to the bit.
///
/// # Errors
/// For an invalid channel or settings, for a checkpoint that cannot be read or written or belongs to another bound, and
/// when `progress`, which receives reports every 50 ms on any thread, cancels.
pub fn ais_upper_bound(
    channel: &BeadChannel,
    fit: &AisSettings,
    decoder: &Decoder,
    keeper: Option<&dyn FitCheckpoint>,
    progress: &mut (dyn Progress<AisProgress> + Send),
) -> Result<AisBound, InformationError> {
    let bounding = BeadChannel { noise: channel.noise.bounding(), ..channel.clone() };
    bound(&bounding, fit, decoder, Side::Above, keeper, progress)
}

/// Lower bound on the information of a channel by reverse AIS. It holds for any decoder; a better decoder and more
/// temperatures raise it. One group and one particle are used for any settings.
///
/// # Errors
/// As [`ais_upper_bound`].
pub fn ais_lower_bound(
    channel: &BeadChannel,
    fit: &AisSettings,
    decoder: &Decoder,
    keeper: Option<&dyn FitCheckpoint>,
    progress: &mut (dyn Progress<AisProgress> + Send),
) -> Result<AisBound, InformationError> {
    let fit = AisSettings { groups: 1, particles: 1, ..fit.clone() };
    bound(channel, &fit, decoder, Side::Below, keeper, progress)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Above,
    Below,
}

fn bound(
    channel: &BeadChannel,
    fit: &AisSettings,
    decoder: &Decoder,
    side: Side,
    keeper: Option<&dyn FitCheckpoint>,
    progress: &mut (dyn Progress<AisProgress> + Send),
) -> Result<AisBound, InformationError> {
    fit.check()?;
    let followed = keeper.map(|keeper| AisCheckpoint::restore(keeper, fit.samples)).transpose()?.flatten();
    let (levels, mut nats, before) = match followed {
        Some(AisCheckpoint { levels, nats, elapsed, .. }) => (Some(levels), nats, elapsed),
        None => (fit.levels, Vec::new(), Duration::ZERO),
    };
    let time = Stopwatch::after(before);
    let problem = Problem::new(channel)?;
    let restored = AisProgress {
        samples: nats.len(),
        most: fit.samples,
        elapsed: before,
        remaining: None,
        bits_per_pixel: mean_and_half_width(&nats, 0.0, problem.pixels()).0,
    };
    let observer = AisObserver::new(progress, restored, fit.budget, time);
    let sampler = AisSampler::new(channel, &problem, fit, decoder, &observer)?;
    let levels = levels.unwrap_or_else(|| sampler.levels_within_budget(side, time));
    let mut kept = time.elapsed();
    loop {
        let (first, began) = (nats.len(), time.elapsed());
        nats.extend(sampler.block(first..first + REPORT.min(fit.samples - first), levels, side));
        if let Some(patch) = nats.iter().position(|nats| !nats.is_finite()).filter(|_| observer.poll().is_continue()) {
            return Err(InformationError::NotFinite { what: "posteriors of the beads", patch });
        }
        let (mean, half_width) = mean_and_half_width(&nats, sampler.least_variance(), problem.pixels());
        let elapsed = time.elapsed();
        if observer.note(nats.len(), mean).is_break() {
            // The last block may be incomplete.
            if let Some(keeper) = keeper.filter(|_| first > 0) {
                AisCheckpoint::keep(keeper, levels, &nats[..first], began)?;
            }
            return Err(InformationError::Cancelled);
        }
        let late = fit.budget.is_some_and(|budget| elapsed >= budget);
        let enough = nats.len() >= FEWEST_SAMPLES && (late || half_width <= fit.half_width);
        if enough || nats.len() >= fit.samples {
            return Ok(AisBound {
                bits_per_pixel: mean,
                interval_95: [mean - half_width, mean + half_width],
                patch: channel.patch.into(),
                groups: fit.groups,
                particles: fit.particles,
                levels,
                samples: nats.len(),
                seconds: elapsed.as_secs_f64(),
                seed: fit.seed,
            });
        }
        if let Some(keeper) = keeper
            && elapsed >= kept + keeper.every()
        {
            AisCheckpoint::keep(keeper, levels, &nats, elapsed)?;
            kept = elapsed;
        }
    }
}

/// Mean of samples in nats and the half width of its 95 % interval, both in bits per pixel. The variance of a sample is at
/// least `least`, nats squared.
fn mean_and_half_width(nats: &[f64], least: f64, pixels: usize) -> (f64, f64) {
    let count = nats.len() as f64;
    let unit = pixels as f64 * std::f64::consts::LN_2;
    let mean = nats.iter().sum::<f64>() / count;
    let square = nats.iter().map(|nats| (nats - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    (mean / unit, student_95(count - 1.0) * (square.max(least) / count).sqrt() / unit)
}

/// The parts that all samples share.
struct AisSampler<'a> {
    problem: &'a Problem,
    fit: &'a AisSettings,
    decoder: &'a Decoder,
    observer: &'a AisObserver<'a>,
    free: Pool<Pass<'a>>,
    light: Light,
    steps: Moves,
    /// Expected information of a bead at each site, nats: weights of the control variate.
    expected_nats: Vec<f64>,
}

impl<'a> AisSampler<'a> {
    fn new(
        channel: &BeadChannel,
        problem: &'a Problem,
        fit: &'a AisSettings,
        decoder: &'a Decoder,
        observer: &'a AisObserver<'a>,
    ) -> Result<Self, InformationError> {
        let spot = channel.checked_spot()?;
        let light = Light::new(&spot, problem);
        let surprise = ((1.0 - channel.probability) / channel.probability).ln();
        let mut expected_nats = Vec::with_capacity(problem.site_count());
        for plane in spot.outer_iter() {
            let sums = AreaSums::new(plane.dim(), |r, c| plane[[r, c]] * plane[[r, c]]);
            for row in 0..problem.sites.rows {
                for col in 0..problem.sites.cols {
                    let separation = sums.over(sums.overlap((row, col), problem.patch)).max(0.0) / light.variance;
                    expected_nats.push(CONTROL_SHARE * surprise * separation / (separation + HALF_SEPARATION));
                }
            }
        }
        Ok(Self {
            problem,
            fit,
            decoder,
            observer,
            free: Pool::default(),
            light,
            steps: Moves::new(&spot),
            expected_nats,
        })
    }

    /// Variance of a sample by the random number of its beads alone, after the control variate. Samples that happen to hold
    /// no beads agree with each other and would understate it.
    fn least_variance(&self) -> f64 {
        let p = self.problem.probability;
        let left = 1.0 / CONTROL_SHARE - 1.0;
        self.expected_nats.iter().map(|expected_nats| p * (1.0 - p) * (left * expected_nats).powi(2)).sum()
    }

    fn with_sample<T>(&self, index: usize, work: impl FnOnce(&mut Pass<'a>) -> T) -> T {
        self.free.with(
            |_| true,
            || Pass::new(self.problem, self.decoder.unrolled()),
            |pass| {
                let sample = SampleId { seed: self.fit.seed, purpose: Purpose::Posterior, index };
                pass.sample.draw(self.problem, sample, |_| Reveal::Nothing, &mut pass.blur);
                work(pass)
            },
        )
    }

    /// Log ratios of a few samples, nats.
    fn block(&self, samples: std::ops::Range<usize>, levels: usize, side: Side) -> Vec<f64> {
        let groups = self.fit.groups;
        let tasks = (samples.start * groups..samples.end * groups).into_par_iter().with_max_len(1);
        let parts: Vec<f64> =
            tasks.map(|task| self.group_log_ratio(task / groups, task % groups, levels, side)).collect();
        let sums = parts.chunks(groups).zip(samples);
        sums.map(|(parts, sample)| parts.iter().sum::<f64>() - self.control_variate(sample)).collect()
    }

    /// Number of temperatures that the budget allows, from the speed of a few samples.
    fn levels_within_budget(&self, side: Side, spent: Stopwatch) -> usize {
        let Some(budget) = self.fit.budget else { return DEFAULT_LEVELS };
        // Separate samples: those of the bound must not decide how it is computed.
        let trials = FIRST_TRIAL..FIRST_TRIAL + REPORT;
        let time = |levels: usize| {
            let before = Instant::now();
            self.block(trials.clone(), levels, side);
            before.elapsed().as_secs_f64() / REPORT as f64
        };
        // The first samples allocate memory.
        time(1);
        let (fixed, trial) = (time(1), time(1 + TRIAL_LEVELS));
        // With coarse timing a temperature still has a cost.
        let each = (trial - fixed).max(0.1 * trial).max(1e-9) / TRIAL_LEVELS as f64;
        let left = budget.saturating_sub(spent.elapsed()).as_secs_f64();
        let useful = match side {
            Side::Above => USEFUL_LEVELS_ABOVE,
            Side::Below => USEFUL_LEVELS_BELOW * (self.problem.pixels() as f64 / USUAL_PIXELS).max(1.0),
        };
        let levels = |samples: f64| (left / samples - fixed) / each;
        let (most, balanced) = (levels(FEWEST_SAMPLES as f64), levels(BUDGETED_SAMPLES));
        most.min(balanced.max(useful)).clamp(FEWEST_LEVELS, MOST_LEVELS) as usize
    }

    /// Control variate of a sample, nats: mean 0, correlated with the information of the measurement.
    fn control_variate(&self, index: usize) -> f64 {
        self.with_sample(index, |pass| {
            let beads = pass.sample.beads.iter().zip(&self.expected_nats);
            beads.map(|(&bead, expected_nats)| (f64::from(bead) - self.problem.probability) * expected_nats).sum()
        })
    }

    /// `log p(y | x) - log p(y | x of the other groups)` of one group of a sample, nats; the second term by AIS.
    fn group_log_ratio(&self, index: usize, group: usize, levels: usize, side: Side) -> f64 {
        let (problem, fit) = (self.problem, self.fit);
        let mut random = ChaCha8Rng::seed_from_u64(fit.seed);
        random.set_stream(CHAIN_STREAM + (index * (fit.groups + 1)) as u64);
        let in_group: Vec<bool> =
            (0..problem.site_count()).map(|_| random.random_range(0..fit.groups) == group).collect();
        random.set_stream(CHAIN_STREAM + (index * (fit.groups + 1) + group + 1) as u64);
        let (initial, measured, occupied, exact) = self.with_sample(index, |pass| {
            pass.sample.ask(problem, |site| in_group[site]);
            pass.forward(self.decoder, &self.decoder.weights);
            let prior = f64::from(problem.prior_logit());
            let mut log_odds = vec![problem.prior_logit(); in_group.len()];
            for &site in &problem.decoded {
                log_odds[site] = pass.claimed()[site];
            }
            let limit = MOST_CERTAIN.max(prior.abs() + 2.0);
            let measured = Measurement::new(problem, &self.light, &pass.sample, |site| !in_group[site]);
            let beads = &pass.sample.beads;
            let occupied: Vec<usize> = (0..beads.len()).filter(|&site| beads[site] > 0.0 && in_group[site]).collect();
            let exact = self.exact(&pass.sample);
            (InitialDistribution::new(&log_odds, in_group, prior, limit), measured, occupied, exact)
        });
        let sites = initial.free.iter().filter(|&&free| free).count() as f64;
        let effort = SweepSize {
            flips: (FLIPS_PER_SITE * sites).ceil() as usize,
            shifts: (SHIFTS_PER_BEAD * problem.probability * sites).ceil() as usize,
        };
        let (light, steps) = (&self.light, &self.steps);
        let chain = AisChain { light, measured: &measured, initial: &initial, steps, effort, levels };
        let progress = &mut |_: &usize| self.observer.poll();
        match side {
            Side::Above => exact - chain.forward_log_weight(fit.particles, &mut random, progress),
            // The reverse chain uses the model likelihood, so both terms must.
            Side::Below => {
                chain.model_log_likelihood(&occupied) - chain.reverse_log_weight(&occupied, &mut random, progress)
            }
        }
    }

    /// Exact log-likelihood of a sample's measurement given its beads, nats. Rounding residues in dark pixels belong to the
    /// channel, as the noise was drawn from them.
    fn exact(&self, sample: &Sample) -> f64 {
        let pixels = sample.noisy.iter().zip(&sample.clean);
        pixels.map(|(&y, &x)| log_likelihood(self.problem.noise, f64::from(y), f64::from(x))).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_samples_keep_a_positive_half_width() {
        let (mean, half) = mean_and_half_width(&[2.0; 16], 4.0, 100);
        let unit = 100.0 * std::f64::consts::LN_2;
        assert!((mean * unit - 2.0).abs() < 1e-12 && (half * unit - 2.1314 * 0.5).abs() < 1e-3, "{mean} {half}");
    }
}
