//! Random changes of beads that leave a distribution between a guess and the posterior as it is.

use ndarray::Array3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::state::State;

/// Beads step this far at most, px.
const NEAR: isize = 2;
/// Images of a bead that count as those of lenslets, and the least share of the brightest one's peak.
const MOST_IMAGES: usize = 16;
const FAINTEST_IMAGE: f64 = 0.2;
/// Weight that every site has in the choice of the next, beside the standard deviation of its guess.
const LEAST_WEIGHT: f64 = 0.02;

/// Where a bead may move: rows and columns, with every step its opposite.
#[derive(Clone, Debug)]
pub(super) struct Steps {
    /// To close by.
    near: Vec<(isize, isize)>,
    /// To where its image through one lenslet lies near that through another.
    far: Vec<(isize, isize)>,
}

impl Steps {
    /// For beads of a spot, shape (planes, rows, cols).
    pub fn new(spot: &Array3<f64>) -> Self {
        let around = |reach: isize| (-reach..=reach).flat_map(move |row| (-reach..=reach).map(move |col| (row, col)));
        let mut near: Vec<_> = around(NEAR).filter(|&step| step != (0, 0)).collect();
        // The closest ones more often.
        near.extend([(0, 1), (0, -1), (1, 0), (-1, 0)].repeat(2));
        let mut far = Vec::new();
        for plane in spot.outer_iter() {
            let at = |row: isize, col: isize| *plane.get((row as usize, col as usize)).unwrap_or(&0.0);
            let peak = |(row, col): (usize, usize)| {
                let (row, col) = (row as isize, col as isize);
                around(1).all(|(r, c)| at(row + r, col + c) <= at(row, col))
            };
            let brightest = plane.iter().copied().fold(0.0, f64::max);
            let mut images: Vec<_> = plane
                .indexed_iter()
                .filter(|&(place, &photons)| photons > FAINTEST_IMAGE * brightest && peak(place))
                .map(|((row, col), &photons)| (photons, row as isize, col as isize))
                .collect();
            images.sort_by(|a, b| b.0.total_cmp(&a.0));
            images.truncate(MOST_IMAGES);
            for one in &images {
                let others = images.iter().map(|other| (other.1 - one.1, other.2 - one.2));
                let apart = others.filter(|(row, col)| row.abs().max(col.abs()) > NEAR + 1);
                far.extend(apart.flat_map(|(row, col)| around(1).map(move |(r, c)| (row + r, col + c))));
            }
        }
        Self { near, far }
    }

    fn draw(&self, random: &mut ChaCha8Rng) -> (isize, isize) {
        let steps = if self.far.is_empty() || random.random::<bool>() { &self.near } else { &self.far };
        steps[random.random_range(0..steps.len())]
    }
}

/// Independent probabilities of beads at the sites in question: where annealing begins.
#[derive(Clone, Debug)]
pub(super) struct Guess {
    /// Log odds of a bead; those of the prior at sites that are no question.
    pub log_odds: Vec<f64>,
    /// Whether the site is in question.
    pub free: Vec<bool>,
    /// Log odds of the prior.
    pub prior: f64,
    chances: Vec<f64>,
    /// Log of the prior probability of no beads over that of the guess, nats.
    dark: f64,
}

impl Guess {
    /// From log odds of all sites, kept within `limit` of 0.
    pub fn new(log_odds: &[f32], free: Vec<bool>, (prior, limit): (f64, f64)) -> Self {
        let clamped = |(&odds, &free): (&f32, &bool)| {
            if free && !odds.is_nan() { f64::from(odds).clamp(-limit, limit) } else { prior }
        };
        let log_odds: Vec<f64> = log_odds.iter().zip(&free).map(clamped).collect();
        let mut sum = 0.0;
        let chances = log_odds.iter().zip(&free).map(|(&odds, &free)| {
            let p = probability(odds);
            sum += if free { (p * (1.0 - p)).sqrt() + LEAST_WEIGHT } else { 0.0 };
            sum
        });
        let chances = chances.collect();
        let asked = log_odds.iter().zip(&free).filter(|&(_, &free)| free);
        let dark = asked.map(|(&odds, _)| softplus(odds) - softplus(prior)).sum();
        Self { log_odds, free, prior, chances, dark }
    }

    /// Beads as the guess has them.
    pub fn draw(&self, random: &mut ChaCha8Rng) -> Vec<usize> {
        let sites = 0..self.free.len();
        sites.filter(|&site| self.free[site] && random.random::<f64>() < probability(self.log_odds[site])).collect()
    }

    /// Log of the prior probability of beads over that of the guess, nats.
    pub fn prior_over_guess(&self, lit: &[u32]) -> f64 {
        self.dark + lit.iter().map(|&site| self.prior - self.log_odds[site as usize]).sum::<f64>()
    }

    /// A site in question, those the guess is unsure of more often.
    fn site(&self, random: &mut ChaCha8Rng) -> usize {
        let all = self.chances.last().copied().unwrap_or(0.0);
        let chance = random.random::<f64>() * all;
        self.chances.partition_point(|&sum| sum <= chance).min(self.chances.len().saturating_sub(1))
    }
}

/// Probability of log odds.
pub(super) fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

/// `ln(1 + e^x)`.
fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// So many single sites and so many beads get the chance to change in random order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Effort {
    pub flips: usize,
    pub shifts: usize,
}

/// Changes beads at random such that `guess^(1 - heat) (prior x likelihood)^heat` stays as it is: every change is one of
/// Metropolis, and their random order is as likely as its reverse, so that time may run either way.
pub(super) fn stir(
    state: &mut State<'_>,
    guess: &Guess,
    steps: &Steps,
    (heat, effort): (f64, Effort),
    grid: (usize, usize),
    random: &mut ChaCha8Rng,
) {
    let all = effort.flips + effort.shifts;
    for _ in 0..all {
        if random.random_range(0..all) < effort.flips {
            let site = guess.site(random);
            let sign = if state.holds(site) { -1.0 } else { 1.0 };
            let odds = (1.0 - heat) * guess.log_odds[site] + heat * guess.prior;
            let change = sign * odds + heat * state.gain(site, sign as f32);
            if accepted(change, random) {
                state.shine(site, sign as f32);
                state.toggle(site);
            }
            continue;
        }
        if state.lit.is_empty() {
            continue;
        }
        let from = state.lit[random.random_range(0..state.lit.len())] as usize;
        let Some(to) = stepped(from, steps.draw(random), grid) else { continue };
        if state.holds(to) || !guess.free[to] {
            continue;
        }
        let lost = state.gain(from, -1.0);
        state.shine(from, -1.0);
        let change = heat * (lost + state.gain(to, 1.0)) + (1.0 - heat) * (guess.log_odds[to] - guess.log_odds[from]);
        if accepted(change, random) {
            state.shine(to, 1.0);
            state.toggle(from);
            state.toggle(to);
        } else {
            state.shine(from, 1.0);
        }
    }
}

fn accepted(change: f64, random: &mut ChaCha8Rng) -> bool {
    random.random::<f64>() < change.exp()
}

/// The site so many rows and columns away in the same plane.
fn stepped(site: usize, step: (isize, isize), (rows, cols): (usize, usize)) -> Option<usize> {
    let (line, col) = (site / cols, site % cols);
    let (plane, row) = (line / rows, line % rows);
    let row = row.checked_add_signed(step.0).filter(|&row| row < rows)?;
    let col = col.checked_add_signed(step.1).filter(|&col| col < cols)?;
    Some((plane * rows + row) * cols + col)
}
