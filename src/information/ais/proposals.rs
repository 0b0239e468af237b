//! Metropolis proposals for beads: single flips and moves to other sites.

use ndarray::Array3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::state::State;

/// Largest near move, px.
const NEAR: isize = 2;
/// Largest number of lenslet images of a bead, and the smallest peak of an image as a share of the brightest.
const MOST_IMAGES: usize = 16;
const FAINTEST_IMAGE: f64 = 0.2;
/// Weight of every site in the choice of a flip, added to the standard deviation of its initial distribution.
const LEAST_WEIGHT: f64 = 0.02;

/// Offsets (rows, cols) that a bead may move by. The set contains the opposite of each.
#[derive(Clone, Debug)]
pub(super) struct Moves {
    /// To neighbouring sites.
    near: Vec<(isize, isize)>,
    /// To sites whose image through one lenslet lies near the present image through another.
    far: Vec<(isize, isize)>,
}

impl Moves {
    /// Moves for a bead response of shape (planes, rows, cols).
    pub fn new(spot: &Array3<f64>) -> Self {
        let around = |reach: isize| (-reach..=reach).flat_map(move |row| (-reach..=reach).map(move |col| (row, col)));
        let mut near: Vec<_> = around(NEAR).filter(|&step| step != (0, 0)).collect();
        // Direct neighbours are proposed more often.
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

/// Initial distribution of annealing: independent bead probabilities at the free sites.
#[derive(Clone, Debug)]
pub(super) struct InitialDistribution {
    /// Log odds of a bead per site; those of the prior at fixed sites.
    pub log_odds: Vec<f64>,
    /// Whether the site is sampled.
    pub free: Vec<bool>,
    /// Log odds of the prior.
    pub prior: f64,
    chances: Vec<f64>,
    /// Log ratio of prior to initial distribution for no beads at all, nats.
    dark: f64,
}

impl InitialDistribution {
    /// From the log odds of all sites, clamped to `limit` around 0.
    pub fn new(log_odds: &[f32], free: Vec<bool>, prior: f64, limit: f64) -> Self {
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
        let in_group = log_odds.iter().zip(&free).filter(|&(_, &free)| free);
        let dark = in_group.map(|(&odds, _)| softplus(odds) - softplus(prior)).sum();
        Self { log_odds, free, prior, chances, dark }
    }

    /// Draws the occupied sites.
    pub fn draw(&self, random: &mut ChaCha8Rng) -> Vec<usize> {
        let sites = 0..self.free.len();
        sites.filter(|&site| self.free[site] && random.random::<f64>() < probability(self.log_odds[site])).collect()
    }

    /// Log ratio of prior to initial distribution for beads at these sites, nats.
    pub fn prior_over_initial(&self, occupied: &[u32]) -> f64 {
        self.dark + occupied.iter().map(|&site| self.prior - self.log_odds[site as usize]).sum::<f64>()
    }

    /// A free site, drawn more often where the initial distribution is uncertain.
    fn site(&self, random: &mut ChaCha8Rng) -> usize {
        let all = self.chances.last().copied().unwrap_or(0.0);
        let control_variate = random.random::<f64>() * all;
        self.chances.partition_point(|&sum| sum <= control_variate).min(self.chances.len().saturating_sub(1))
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

/// Number of proposals in one MCMC sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SweepSize {
    /// Proposals to flip a single site.
    pub flips: usize,
    /// Proposals to move a bead.
    pub shifts: usize,
}

/// One MCMC sweep that leaves `initial^(1 - beta) (prior x likelihood)^beta` invariant. All proposals are accepted by
/// Metropolis' rule in random order, so the sweep is reversible.
pub(super) fn mcmc_sweep(
    state: &mut State<'_>,
    initial: &InitialDistribution,
    steps: &Moves,
    beta: f64,
    effort: SweepSize,
    grid: (usize, usize),
    random: &mut ChaCha8Rng,
) {
    let all = effort.flips + effort.shifts;
    for _ in 0..all {
        if random.random_range(0..all) < effort.flips {
            let site = initial.site(random);
            let sign = if state.holds(site) { -1.0 } else { 1.0 };
            let odds = (1.0 - beta) * initial.log_odds[site] + beta * initial.prior;
            let change = sign * odds + beta * state.log_likelihood_change(site, sign as f32);
            if accepted(change, random) {
                state.add_photons(site, sign as f32);
                state.toggle(site);
            }
            continue;
        }
        if state.occupied.is_empty() {
            continue;
        }
        let from = state.occupied[random.random_range(0..state.occupied.len())] as usize;
        let Some(to) = stepped(from, steps.draw(random), grid) else { continue };
        if state.holds(to) || !initial.free[to] {
            continue;
        }
        let lost = state.log_likelihood_change(from, -1.0);
        state.add_photons(from, -1.0);
        let change = beta * (lost + state.log_likelihood_change(to, 1.0))
            + (1.0 - beta) * (initial.log_odds[to] - initial.log_odds[from]);
        if accepted(change, random) {
            state.add_photons(to, 1.0);
            state.toggle(from);
            state.toggle(to);
        } else {
            state.add_photons(from, 1.0);
        }
    }
}

fn accepted(change: f64, random: &mut ChaCha8Rng) -> bool {
    random.random::<f64>() < change.exp()
}

/// The site at an offset in the same plane; `None` outside.
fn stepped(site: usize, step: (isize, isize), (rows, cols): (usize, usize)) -> Option<usize> {
    let (line, col) = (site / cols, site % cols);
    let (plane, row) = (line / rows, line % rows);
    let row = row.checked_add_signed(step.0).filter(|&row| row < rows)?;
    let col = col.checked_add_signed(step.1).filter(|&col| col < cols)?;
    Some((plane * rows + row) * cols + col)
}
