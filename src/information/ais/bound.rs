//! The bounds: numbers of bits per pixel with all that belongs to them.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::chain::Walk;
use super::checkpoint::Followed;
use super::light::Light;
use super::progress::Watch;
use super::proposals::{Effort, Guess, Steps};
use super::state::Measured;
use crate::information::decoder::channel::BeadChannel;
use crate::information::decoder::layers::Decoder;
use crate::information::decoder::pass::Pass;
use crate::information::decoder::problem::Problem;
use crate::information::decoder::samples::{Purpose, Reveal, Sample};
use crate::information::entropy::likelihood::log_likelihood;
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::FitCheckpoint;
use crate::information::statistics::area_sums::AreaSums;
use crate::information::statistics::student_t::student_95;
use crate::information::stopwatch::Stopwatch;
use crate::nn::Pool;

/// Samples between two reports.
const REPORT: usize = 4;
/// Samples that are followed whatever the budget: fewer have no interval to speak of.
const FEWEST_SAMPLES: usize = 16;
/// The guess is kept within these log odds, or a little beyond those of the prior.
const MOST_CERTAIN: f64 = 14.0;
/// Chances to change per level: of every site, and of every bead that is to be expected.
const FLIPS_PER_SITE: f64 = 0.08;
const SHIFTS_PER_BEAD: f64 = 2.5;
/// Squared separation at which half of what a bead could tell is counted as told, and how much of the chance number of
/// beads is taken out of the mean.
const HALF_TOLD: f64 = 10.0;
const TAKEN_OUT: f64 = 0.9;
/// Levels where there is no budget, and of the few samples by which the time of others is told.
const USUAL_LEVELS: usize = 400;
const TRIAL_LEVELS: usize = 32;
/// The first of those samples, far from the others.
const FIRST_TRIAL: usize = 1 << 31;
/// Levels that a budget is worth.
const FEWEST_LEVELS: f64 = 64.0;
const MOST_LEVELS: f64 = 16_384.0;
/// Samples that a budget should suffice for.
const BUDGETED_SAMPLES: f64 = 48.0;
/// Levels up to which more levels are worth more than more samples. A walk backwards by one walker gains from every level,
/// while that from above comes to its end soon: what is left is the looseness of its groups.
const WORTHY_LEVELS_BELOW: f64 = 1024.0;
const WORTHY_LEVELS_ABOVE: f64 = 128.0;
/// Pixels of a patch from which on that number of levels is larger from below: each sample tells more.
const USUAL_PIXELS: f64 = 1024.0;
/// Random streams of walks, beside those of samples.
const WALKS: u64 = 0x7f << 56;

/// How carefully the posterior is followed.
#[derive(Clone, Debug, PartialEq)]
pub struct AisSettings {
    /// Groups of sites that are asked for one by one, given the others; more are looser but need fewer levels. The lower
    /// bound always asks for all at once.
    pub groups: usize,
    /// Walkers of each group; the lower bound has one.
    pub walkers: usize,
    /// Steps from guess to posterior; without a number as many as the budget allows for 16 to 48 samples.
    pub levels: Option<usize>,
    /// Largest number of samples.
    pub samples: usize,
    /// Half width of the 95 % interval at which sampling ends, bits per pixel.
    pub half_width: f64,
    /// Time after which no further samples are begun; 16 are always followed.
    pub budget: Option<Duration>,
    /// Seed of samples, groups and walks.
    pub seed: u64,
}

impl AisSettings {
    /// The usual fit within a budget of time.
    pub fn within(budget: Duration, seed: u64) -> Self {
        Self { levels: None, budget: Some(budget), ..Self::of_levels(USUAL_LEVELS, seed) }
    }

    /// The usual fit of a number of levels: equal seeds give equal bits, whatever the number of threads.
    pub fn of_levels(levels: usize, seed: u64) -> Self {
        Self { groups: 4, walkers: 4, levels: Some(levels), samples: 256, half_width: 0.0015, budget: None, seed }
    }

    fn check(&self) -> Result<(), InformationError> {
        let refuse = |expected, found: usize| Err(InformationError::DecoderFit { expected, found: found.to_string() });
        if !(1..=1 << 12).contains(&self.groups) {
            return refuse("1 to 4096 groups of sites", self.groups);
        }
        if !(1..=1 << 10).contains(&self.walkers) {
            return refuse("1 to 1024 walkers", self.walkers);
        }
        if let Some(levels) = self.levels.filter(|levels| !(1..=1 << 24).contains(levels)) {
            return refuse("1 to 16,777,216 levels", levels);
        }
        if self.samples < 2 {
            return refuse("at least two samples", self.samples);
        }
        Ok(())
    }
}

/// How far a bound has come; sent after every few samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AisProgress {
    /// Samples followed.
    pub samples: usize,
    /// Most samples there will be.
    pub most: usize,
    /// Time since the start.
    pub elapsed: Duration,
    /// Time left, once it can be told; the fewest samples can take longer.
    pub remaining: Option<Duration>,
    /// The bound so far, bits per pixel.
    pub bits_per_pixel: f64,
}

/// A bound on the information between beads and noisy measurements by following the posterior.
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
    /// Walkers of each group.
    pub walkers: usize,
    /// Steps from guess to posterior.
    pub levels: usize,
    /// Samples whose posterior was followed.
    pub samples: usize,
    /// Time, seconds.
    pub seconds: f64,
    /// Seed of samples, groups and walks.
    pub seed: u64,
}

/// Hears of progress, on any thread, and answers whether to go on.
pub type OnAis<'a> = &'a mut (dyn FnMut(&AisProgress) -> ControlFlow<()> + Send);

/// An upper bound on the information of a channel, for any decoder; a better one and more levels lower it. The noise is
/// that of [`bounding`](crate::sensor::Noise::bounding). A bound whose samples `keeper` has goes on from them; where it is of a number
/// of levels it comes to the same bits as in one go.
///
/// # Errors
/// For what is no channel or no fit, where what is kept cannot be read or written or is of another bound, and when cancelled: `on_progress` is called every 50 ms and may break off.
pub fn ais_upper_bound(
    channel: &BeadChannel,
    fit: &AisSettings,
    decoder: &Decoder,
    keeper: Option<&dyn FitCheckpoint>,
    on_progress: OnAis<'_>,
) -> Result<AisBound, InformationError> {
    let bounding = BeadChannel { noise: channel.noise.bounding(), ..channel.clone() };
    bound(&bounding, fit, (decoder, Side::Above), keeper, on_progress)
}

/// A lower bound on the information of a channel, for any decoder; a better one and more levels raise it. All sites are
/// asked for at once by one walker, whatever the fit says.
///
/// # Errors
/// As [`ais_upper_bound`].
pub fn ais_lower_bound(
    channel: &BeadChannel,
    fit: &AisSettings,
    decoder: &Decoder,
    keeper: Option<&dyn FitCheckpoint>,
    on_progress: OnAis<'_>,
) -> Result<AisBound, InformationError> {
    let fit = AisSettings { groups: 1, walkers: 1, ..fit.clone() };
    bound(channel, &fit, (decoder, Side::Below), keeper, on_progress)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Above,
    Below,
}

fn bound(
    channel: &BeadChannel,
    fit: &AisSettings,
    (decoder, side): (&Decoder, Side),
    keeper: Option<&dyn FitCheckpoint>,
    on_progress: OnAis<'_>,
) -> Result<AisBound, InformationError> {
    fit.check()?;
    let followed = keeper.map(|keeper| Followed::restore(keeper, fit.samples)).transpose()?.flatten();
    let (levels, mut nats, before) = match followed {
        Some(Followed { levels, nats, elapsed, .. }) => (Some(levels), nats, elapsed),
        None => (fit.levels, Vec::new(), Duration::ZERO),
    };
    let time = Stopwatch::after(before);
    let scene = Problem::new(channel)?;
    let known = (nats.len(), mean_and_half_width(&nats, 0.0, scene.pixels()).0);
    let watch = Watch::new(on_progress, known, (fit.samples, fit.budget), time);
    let follower = Follower::new(channel, &scene, fit, decoder, &watch)?;
    let levels = levels.unwrap_or_else(|| follower.affordable_levels(side, time));
    let mut kept = time.elapsed();
    loop {
        let first = nats.len();
        nats.extend(follower.block(first..first + REPORT.min(fit.samples - first), levels, side));
        if let Some(patch) = nats.iter().position(|nats| !nats.is_finite()).filter(|_| watch.goes_on()) {
            return Err(InformationError::NotFinite { what: "posteriors of the beads", patch });
        }
        let (mean, half_width) = mean_and_half_width(&nats, follower.least_variance(), scene.pixels());
        let elapsed = time.elapsed();
        if !watch.note(nats.len(), mean) {
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
                walkers: fit.walkers,
                levels,
                samples: nats.len(),
                seconds: elapsed.as_secs_f64(),
                seed: fit.seed,
            });
        }
        if let Some(keeper) = keeper
            && elapsed >= kept + keeper.every()
        {
            Followed::keep(keeper, (levels, &nats), elapsed)?;
            kept = elapsed;
        }
    }
}

/// Mean of nats per sample, whose variance is known to be `least` at least, and half the width of its 95 % interval, both in
/// bits per pixel.
fn mean_and_half_width(nats: &[f64], least: f64, pixels: usize) -> (f64, f64) {
    let count = nats.len() as f64;
    let unit = pixels as f64 * std::f64::consts::LN_2;
    let mean = nats.iter().sum::<f64>() / count;
    let square = nats.iter().map(|nats| (nats - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    (mean / unit, student_95(count - 1.0) * (square.max(least) / count).sqrt() / unit)
}

/// What all samples share.
struct Follower<'a> {
    scene: &'a Problem,
    fit: &'a AisSettings,
    decoder: &'a Decoder,
    watch: &'a Watch<'a>,
    free: Pool<Pass<'a>>,
    light: Light,
    steps: Steps,
    /// How much a bead at each site is expected to tell, nats, less than all.
    told: Vec<f64>,
}

impl<'a> Follower<'a> {
    fn new(
        channel: &BeadChannel,
        scene: &'a Problem,
        fit: &'a AisSettings,
        decoder: &'a Decoder,
        watch: &'a Watch<'a>,
    ) -> Result<Self, InformationError> {
        let spot = channel.checked_spot()?;
        let light = Light::new(&spot, scene);
        let surprise = ((1.0 - channel.probability) / channel.probability).ln();
        let mut told = Vec::with_capacity(scene.site_count());
        for plane in spot.outer_iter() {
            let sums = AreaSums::new(plane.dim(), |r, c| plane[[r, c]] * plane[[r, c]]);
            for row in 0..scene.sites.rows {
                for col in 0..scene.sites.cols {
                    let separation = sums.over(sums.overlap((row, col), scene.patch)).max(0.0) / light.variance;
                    told.push(TAKEN_OUT * surprise * separation / (separation + HALF_TOLD));
                }
            }
        }
        Ok(Self { scene, fit, decoder, watch, free: Pool::default(), light, steps: Steps::new(&spot), told })
    }

    /// Variance of a sample by the chance number of its beads alone, of which the mean leaves a part: samples that happen to
    /// hold none agree with each other and tell nothing of it.
    fn least_variance(&self) -> f64 {
        let p = self.scene.probability;
        let left = 1.0 / TAKEN_OUT - 1.0;
        self.told.iter().map(|told| p * (1.0 - p) * (left * told).powi(2)).sum()
    }

    fn with_sample<T>(&self, index: usize, work: impl FnOnce(&mut Pass<'a>) -> T) -> T {
        self.free.with(
            |_| true,
            || Pass::new(self.scene, self.decoder.unrolled()),
            |pass| {
                let draw = (self.fit.seed, Purpose::Posterior, index);
                pass.sample.draw(self.scene, draw, |_| Reveal::Nothing, &mut pass.blur);
                work(pass)
            },
        )
    }

    /// Log ratios of a few samples, nats.
    fn block(&self, samples: std::ops::Range<usize>, levels: usize, side: Side) -> Vec<f64> {
        let groups = self.fit.groups;
        let tasks = (samples.start * groups..samples.end * groups).into_par_iter().with_max_len(1);
        let parts: Vec<f64> = tasks.map(|task| self.follow(task / groups, task % groups, (levels, side))).collect();
        let sums = parts.chunks(groups).zip(samples);
        sums.map(|(parts, sample)| parts.iter().sum::<f64>() - self.chance(sample)).collect()
    }

    /// Levels for which the time of a fit suffices, from that of a few samples of few levels.
    fn affordable_levels(&self, side: Side, spent: Stopwatch) -> usize {
        let Some(budget) = self.fit.budget else { return USUAL_LEVELS };
        // Samples of their own: what a bound rests on does not decide how it is computed.
        let trials = FIRST_TRIAL..FIRST_TRIAL + REPORT;
        let time = |levels: usize| {
            let before = Instant::now();
            self.block(trials.clone(), levels, side);
            before.elapsed().as_secs_f64() / REPORT as f64
        };
        // The first samples need memory besides.
        time(1);
        let (fixed, trial) = (time(1), time(1 + TRIAL_LEVELS));
        // Where timing is too coarse to tell, levels are not for free.
        let each = (trial - fixed).max(0.1 * trial).max(1e-9) / TRIAL_LEVELS as f64;
        let left = budget.saturating_sub(spent.elapsed()).as_secs_f64();
        let worthy = match side {
            Side::Above => WORTHY_LEVELS_ABOVE,
            Side::Below => WORTHY_LEVELS_BELOW * (self.scene.pixels() as f64 / USUAL_PIXELS).max(1.0),
        };
        let levels = |samples: f64| (left / samples - fixed) / each;
        let (most, balanced) = (levels(FEWEST_SAMPLES as f64), levels(BUDGETED_SAMPLES));
        most.min(balanced.max(worthy)).clamp(FEWEST_LEVELS, MOST_LEVELS) as usize
    }

    /// What the beads of a sample tell by being more or fewer than expected, nats; its mean is 0 and it varies with what
    /// the measurement tells, so the difference varies less.
    fn chance(&self, index: usize) -> f64 {
        self.with_sample(index, |pass| {
            let beads = pass.sample.beads.iter().zip(&self.told);
            beads.map(|(&bead, told)| (f64::from(bead) - self.scene.probability) * told).sum()
        })
    }

    /// `log p(y | x) - log p(y | x of the other groups)` of one group of a sample, nats, the second by annealing.
    fn follow(&self, index: usize, group: usize, (levels, side): (usize, Side)) -> f64 {
        let (scene, fit) = (self.scene, self.fit);
        let mut random = ChaCha8Rng::seed_from_u64(fit.seed);
        random.set_stream(WALKS + (index * (fit.groups + 1)) as u64);
        let asked: Vec<bool> = (0..scene.site_count()).map(|_| random.random_range(0..fit.groups) == group).collect();
        random.set_stream(WALKS + (index * (fit.groups + 1) + group + 1) as u64);
        let (guess, measured, lit, exact) = self.with_sample(index, |pass| {
            pass.sample.ask(scene, |site| asked[site]);
            pass.forward(self.decoder, &self.decoder.weights);
            let prior = f64::from(scene.prior_logit());
            let mut log_odds = vec![scene.prior_logit(); asked.len()];
            for &site in &scene.decoded {
                log_odds[site] = pass.claimed()[site];
            }
            let limits = (prior, MOST_CERTAIN.max(prior.abs() + 2.0));
            let measured = Measured::new(scene, &self.light, &pass.sample, |site| !asked[site]);
            let beads = &pass.sample.beads;
            let lit: Vec<usize> = (0..beads.len()).filter(|&site| beads[site] > 0.0 && asked[site]).collect();
            let exact = self.exact(&pass.sample);
            (Guess::new(&log_odds, asked, limits), measured, lit, exact)
        });
        let sites = guess.free.iter().filter(|&&free| free).count() as f64;
        let effort = Effort {
            flips: (FLIPS_PER_SITE * sites).ceil() as usize,
            shifts: (SHIFTS_PER_BEAD * scene.probability * sites).ceil() as usize,
        };
        let (light, steps) = (&self.light, &self.steps);
        let go_on = || self.watch.goes_on();
        let walk = Walk { light, measured: &measured, guess: &guess, steps, effort, levels, go_on: &go_on };
        match side {
            Side::Above => exact - walk.forwards(fit.walkers, &mut random),
            // The walk knows its model alone, so that both logs must be of it.
            Side::Below => walk.model_of(&lit) - walk.backwards(&lit, &mut random),
        }
    }

    /// Log of the probability (density) of a sample's measurement given its beads, nats. Light that arithmetic leaves where
    /// there is none belongs to the channel: noise was drawn of it.
    fn exact(&self, sample: &Sample) -> f64 {
        let pixels = sample.noisy.iter().zip(&sample.clean);
        pixels.map(|(&y, &x)| log_likelihood(self.scene.noise, f64::from(y), f64::from(x))).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_that_agree_by_chance_are_not_taken_for_certain() {
        let (mean, half) = mean_and_half_width(&[2.0; 16], 4.0, 100);
        let unit = 100.0 * std::f64::consts::LN_2;
        assert!((mean * unit - 2.0).abs() < 1e-12 && (half * unit - 2.1314 * 0.5).abs() < 1e-3, "{mean} {half}");
    }
}
