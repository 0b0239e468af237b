//! Relocation search: candidates with one lenslet at another position, beyond the reach of the gradient.
//!
//! Spots are narrow, so that the gradient depends on nearby pixels alone and a mask ends in the nearest local optimum. The information
//! of a faint spot grows with the square of its weight, while the others lose in proportion: a dark lenslet stays dark. The search
//! compares whole masks instead.

use std::ops::{Range, RangeInclusive};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::IdealOptimizer;
use crate::design::error::IdealError;
use crate::design::merge::{close_pair, joined, merged};
use crate::design::objective_model::BLOCK;
use crate::design::observer::RunObserver;
use crate::design::projection::project;
use crate::design::settings::IdealSettings;
use crate::design::state::{IdealEvent, Phase};
use crate::information::{SceneDraw, paired_gain};
use crate::optics::{Lenslet, LensletArray, Limits};
use crate::seeds::SeedStream;

/// Share of the mean weight of the others below which a lenslet is faint.
const FAINT: f64 = 0.25;
/// Sixteenths of the steps at which a search takes place.
const OCCASIONS: RangeInclusive<usize> = 4..=12;
/// Rounds of the screening: scenes for each block of a checkpoint, and the candidates that are left afterwards.
const SCREENS: [(usize, usize); 3] = [(8, 24), (24, 6), (96, 1)];
/// Scenes of the final comparison, as a multiple of those of a checkpoint.
const COMPARED: usize = 4;
/// Distance to other spots within the reach of the gradient, px.
const NEAR_PX: f64 = 2.0;
/// Margin beyond the limits in which positions are drawn, as a share of their distance; such positions are clamped to the limit.
const BEYOND: f64 = 0.25;

impl IdealOptimizer<'_> {
    /// Relocates one lenslet where that gains information, at some of the steps.
    pub(super) fn relocate(&mut self, observer: &RunObserver<'_>) -> Result<(), IdealError> {
        let step = self.state.step;
        let sixteenth = |step: usize| 16 * step / self.settings.steps.max(1);
        let (before, now) = (sixteenth(step.saturating_sub(self.settings.refit_every)), sixteenth(step));
        // Another search comes after a relocation in the round before.
        let follows = matches!(self.state.events.last(), Some(IdealEvent::Relocated { step: at, .. })
            if at + self.settings.refit_every == step);
        if !OCCASIONS.contains(&now) || (before == now && !follows) {
            return Ok(());
        }
        let (state, settings) = (&self.state, &self.settings);
        let Some(posterior) = self.model.posterior() else { return Ok(()) };
        let seed = |part: u64| SeedStream::Relocation { part, step: state.step }.derive(settings.seed);
        let mut candidates = candidates(&state.array, settings, &self.limits, &state.pruned, seed(0));
        if candidates.is_empty() {
            return Ok(());
        }
        let gains = |array: &LensletArray, scenes: Range<usize>, part: u64, block: usize, share: f64| {
            let progress = &mut |_: &usize| observer.notify(state, Some((Phase::Searching, share)));
            posterior.gains(array, &SceneDraw { scenes, seed: seed(part), block }, progress)
        };
        let blocks = posterior.scenes() / BLOCK;
        let compared = COMPARED * blocks * BLOCK;
        let all = (work(candidates.len()) * blocks + 2 * compared) as f64;
        let mut done = 0;
        for (until, left) in SCREENS {
            for candidate in &mut candidates {
                let due = candidate.gains.len()..until * blocks;
                done += due.len();
                let more = gains(&candidate.array, due, 1, SCREENS[0].0 * blocks, done as f64 / all)?;
                candidate.gains.extend(more);
            }
            candidates.sort_by(|one, other| other.mean().total_cmp(&one.mean()));
            candidates.truncate(left);
        }
        let Some(best) = candidates.pop() else { return Ok(()) };
        let before = gains(&state.array, 0..compared, 2, BLOCK, (done + compared) as f64 / all)?;
        let after = gains(&best.array, 0..compared, 2, BLOCK, 1.0)?;
        let (gain, half_width) = paired_gain(&before, &after);
        if gain > half_width {
            self.state.array = best.array;
            self.state.adam.reset(best.lenslet);
            self.state.model_up_to_date = false;
            self.state.events.push(IdealEvent::Relocated { step: self.state.step, lenslet: best.lenslet });
        }
        Ok(())
    }
}

/// Scenes of the screening of `masks` candidates, for each block of a checkpoint.
fn work(masks: usize) -> usize {
    let (mut masks, mut known, mut work) = (masks, 0, 0);
    for (until, left) in SCREENS {
        work += masks * (until - known);
        (masks, known) = (masks.min(left), until);
    }
    work
}

/// A mask with one lenslet at another position.
struct Candidate {
    lenslet: usize,
    array: LensletArray,
    /// Information gain of every scene so far, bits.
    gains: Vec<f64>,
}

impl Candidate {
    fn mean(&self) -> f64 {
        self.gains.iter().sum::<f64>() / self.gains.len().max(1) as f64
    }
}

/// Candidates: masks with one free lenslet at a random position. It keeps its weight, or, where it is faint and weights are free,
/// has the mean weight of the others. Close pairs move as one lenslet. Empty where positions are fixed.
fn candidates(
    array: &LensletArray,
    settings: &IdealSettings,
    limits: &Limits,
    pruned: &[usize],
    seed: u64,
) -> Vec<Candidate> {
    if !settings.free.positions {
        return Vec::new();
    }
    let free = settings.free_lenslets(array.lenslets.len(), pruned);
    let folded = if settings.free.weights { folded(array, settings, &free) } else { array.clone() };
    let weight = |index: usize| folded.lenslets[index].weight;
    let faintest = free.iter().copied().min_by(|&one, &other| weight(one).total_cmp(&weight(other)));
    let mut others = folded.clone();
    if let Some(faintest) = faintest {
        others.lenslets[faintest].weight = 0.0;
    }
    let mean = mean_light(&others, &free);
    let spare = faintest.filter(|&index| settings.free.weights && mean > 0.0 && weight(index) < FAINT * mean);
    // A lit faint lenslet is a candidate with its own weight as well.
    let lit = free.iter().copied().filter(|&index| weight(index) > 0.0).map(|index| (index, folded.lenslets[index]));
    let brightest = free.iter().copied().max_by(|&one, &other| weight(one).total_cmp(&weight(other)));
    let relit = spare.zip(brightest).map(|(spare, brightest)| {
        let spot = if settings.free.widths { folded.lenslets[brightest].spot } else { folded.lenslets[spare].spot };
        (spare, Lenslet { weight: mean, spot, ..folded.lenslets[spare] })
    });
    let movable: Vec<(usize, Lenslet)> = lit.chain(relit).collect();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut coordinate = |side: usize| {
        let (low, high) = limits.coordinate_range(side);
        let beyond = BEYOND * (high - low);
        random.random_range(low - beyond..=high + beyond).clamp(low, high)
    };
    let masks = (0..settings.relocation_candidates).filter_map(|number| {
        let &(index, lenslet) = movable.get(number % movable.len().max(1))?;
        let (x, y) = (coordinate(folded.cols), coordinate(folded.rows));
        let taken = |(at, other): (usize, &Lenslet)| {
            let distance = (other.x - x).hypot(other.y - y);
            at != index
                && other.weight > 0.0
                && (distance < settings.min_separation_px || (other.plane == lenslet.plane && distance < NEAR_PX))
        };
        if folded.lenslets.iter().enumerate().any(taken) {
            return None;
        }
        let mut array = folded.clone();
        array.lenslets[index] = Lenslet { x, y, ..lenslet };
        project(&mut array, settings, limits);
        Some(Candidate { lenslet: index, array, gains: Vec::new() })
    });
    masks.collect()
}

/// The mask with every close pair joined into one lenslet; the others are dark.
fn folded(array: &LensletArray, settings: &IdealSettings, free: &[usize]) -> LensletArray {
    let mut folded = array.clone();
    loop {
        let lit: Vec<usize> = free.iter().copied().filter(|&index| folded.lenslets[index].weight > 0.0).collect();
        let Some((one, other)) = close_pair(&folded, &lit) else { return folded };
        folded.lenslets[one] = joined(folded.lenslets[one], folded.lenslets[other], settings.free);
        folded.lenslets[other].weight = 0.0;
    }
}

/// Mean weight of the free lenslets without the dark ones; coincident ones count as one.
fn mean_light(array: &LensletArray, free: &[usize]) -> f64 {
    let lenslets: Vec<Lenslet> = free.iter().map(|&index| array.lenslets[index]).collect();
    let all = lenslets.iter().map(|lenslet| lenslet.weight).sum::<f64>();
    all / merged(&LensletArray { lenslets, ..array.clone() }).lenslets.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::super::tests::{few_beads, short};
    use super::*;
    use crate::design::settings::{Free, Objective, Preset};
    use crate::forward::ForwardModel;
    use crate::optics::Spot;
    use crate::progress::CancelToken;
    use crate::sensor::Noise;

    fn settings() -> IdealSettings {
        IdealSettings::new(Preset::Default, Objective::Posterior, 1)
    }

    /// Three bright lenslets and a faint one.
    fn mask() -> LensletArray {
        let lenslet = |x, y, weight| Lenslet::round(x, y, 1.0, weight);
        let lenslets = vec![
            lenslet(3.1, 3.1, 0.32),
            lenslet(15.0, 15.0, 0.02),
            lenslet(27.9, 3.1, 0.42),
            lenslet(15.5, 27.9, 0.24),
        ];
        LensletArray::new(32, 32, lenslets)
    }

    fn candidates_of(array: &LensletArray, settings: &IdealSettings, pruned: &[usize]) -> Vec<Candidate> {
        candidates(array, settings, &Limits::default(), pruned, 1)
    }

    fn distance(one: &Lenslet, other: &Lenslet) -> f64 {
        (one.x - other.x).hypot(one.y - other.y)
    }

    #[test]
    fn every_lenslet_is_a_candidate_and_a_faint_one_with_the_mean_weight_too() {
        let mut mask = mask();
        mask.lenslets[2].spot = Spot::Isotropic(0.9);
        let found = candidates_of(&mask, &settings(), &[]);
        let most = settings().relocation_candidates;
        assert!(found.len() > most / 2 && found.len() <= most, "{}", found.len());
        for Candidate { lenslet, array, .. } in &found {
            let moved = array.lenslets[*lenslet];
            assert!((array.lenslets.iter().map(|lenslet| lenslet.weight).sum::<f64>() - 1.0).abs() < 1e-12);
            for (index, (other, before)) in array.lenslets.iter().zip(&mask.lenslets).enumerate() {
                assert!(index == *lenslet || (other.x, other.y, other.spot) == (before.x, before.y, before.spot));
                assert!(index == *lenslet || distance(&moved, other) >= NEAR_PX);
            }
            let before = mask.lenslets[*lenslet];
            let is_relit = (moved.weight - before.weight).abs() > 1e-6;
            let sharpest = mask.lenslets[2].spot;
            assert!(!is_relit || (*lenslet == 1 && (moved.weight - 0.25).abs() < 1e-12 && moved.spot == sharpest));
        }
        let counts = [0, 1, 2, 3].map(|index| found.iter().filter(|candidate| candidate.lenslet == index).count());
        // The faint one is a candidate twice: with its own weight and with the mean weight.
        assert!(counts.iter().all(|&count| count > 8) && counts[1] > counts[0], "{counts:?}");
        let (left, right) = Limits::default().coordinate_range(32);
        let at_a_limit =
            found.iter().filter(|candidate| [left, right].contains(&candidate.array.lenslets[candidate.lenslet].x));
        assert!(at_a_limit.count() > found.len() / 8, "optimal positions are often there");
    }

    #[test]
    fn close_lenslets_are_relocated_as_one() {
        let mut mask = mask();
        mask.lenslets[1] = Lenslet { x: 27.5, weight: 0.4, ..mask.lenslets[2] };
        let found = candidates_of(&mask, &settings(), &[]);
        let joined = |candidate: &Candidate| (candidate.lenslet == 1).then_some(candidate.array.lenslets[1].weight);
        let lights: Vec<f64> = found.iter().filter_map(joined).collect();
        assert!(!lights.is_empty() && lights.iter().all(|light| (light - 0.82 / 1.38).abs() < 1e-12), "{lights:?}");
        // The lenslet that is left over gets light at another position.
        let spared =
            found.iter().filter(|candidate| candidate.lenslet == 2).map(|candidate| candidate.array.lenslets[2].weight);
        assert!(spared.clone().count() > 0 && spared.into_iter().all(|light| (light - 0.25).abs() < 1e-9));
        let held = IdealSettings { free: Free { weights: false, ..Free::default() }, ..settings() };
        for candidate in candidates_of(&mask, &held, &[]) {
            let weights =
                |array: &LensletArray| array.lenslets.iter().map(|lenslet| lenslet.weight).collect::<Vec<_>>();
            assert_eq!(weights(&candidate.array), weights(&mask), "fixed weights stay");
        }
    }

    #[test]
    fn fixed_parameters_and_locked_lenslets_stay() {
        let held = |free: Free| IdealSettings { free, ..settings() };
        assert!(candidates_of(&mask(), &held(Free { positions: false, ..Free::default() }), &[]).is_empty());
        let of =
            |found: &[Candidate], index: usize| found.iter().filter(|candidate| candidate.lenslet == index).count();
        let found = candidates_of(&mask(), &IdealSettings { locked: vec![1], ..settings() }, &[3]);
        assert!(of(&found, 0) > 0 && of(&found, 2) > 0 && of(&found, 1) == 0 && of(&found, 3) == 0);
        let settings = IdealSettings {
            locked: vec![0],
            min_separation_px: 10.0,
            ..held(Free { widths: false, ..Free::default() })
        };
        let found = candidates_of(&mask(), &settings, &[]);
        assert!(!found.is_empty());
        for Candidate { lenslet, array, .. } in found {
            assert_eq!((array.lenslets[0], array.lenslets[lenslet].spot), (mask().lenslets[0], Spot::Isotropic(1.0)));
            let others = array.lenslets.iter().enumerate().filter(|&(index, _)| index != lenslet);
            assert!(others.into_iter().all(|(_, other)| distance(other, &array.lenslets[lenslet]) > 9.9));
        }
        let all_locked = IdealSettings { locked: vec![0, 1, 2, 3], ..settings };
        assert!(candidates_of(&mask(), &all_locked, &[]).is_empty());
    }

    #[test]
    fn mean_weight_is_that_of_free_lenslets() {
        let mut mask = mask();
        let settings = IdealSettings { locked: vec![2], ..settings() };
        let relit = |found: Vec<Candidate>| {
            let lights = found
                .into_iter()
                .filter(|candidate| candidate.lenslet == 1)
                .map(|candidate| candidate.array.lenslets[1].weight);
            lights.fold(0.0, f64::max)
        };
        // Two free lenslets share 0.56 and the 0.02 of the faint one.
        assert!((relit(candidates_of(&mask, &settings, &[])) - 0.58 / 3.0).abs() < 1e-3);
        (mask.lenslets[0].weight, mask.lenslets[1].weight, mask.lenslets[3].weight) = (0.0, 0.0, 0.0);
        assert!(candidates_of(&mask, &settings, &[]).is_empty(), "no light is free");
    }

    #[test]
    fn work_is_the_sum_over_all_screens() {
        assert_eq!(work(96), 96 * 8 + 24 * 16 + 6 * 72);
        assert_eq!(work(3), 3 * 8 + 3 * 16 + 3 * 72);
    }

    #[test]
    #[ignore = "takes a minute or more; run with --ignored"]
    fn dark_lenslet_is_relit_where_that_gains_information_and_resumed_runs_do_the_same() {
        let set = few_beads();
        let forward = ForwardModel::new(set.clone(), (16, 16), 10.0, Noise::Shot).unwrap();
        // Two lenslets show more of the scene on the whole sensor.
        let lenslets = [1.0, 0.0].map(|weight| Lenslet::round(4.0, 7.5, 0.8, weight));
        let run = || {
            let mut run = short(&forward, &lenslets, 4);
            run.settings.relocation_candidates = 24;
            run
        };
        let mut whole = run();
        let mut kept = Vec::new();
        while !whole.is_finished() {
            whole.advance(&mut CancelToken::new()).unwrap();
            kept.push(whole.to_bytes().unwrap());
        }
        assert_eq!(whole.state.events[0], IdealEvent::Relocated { step: 1, lenslet: 1 });
        let [_, after, ..] = &whole.state.checkpoints[..] else { panic!("a checkpoint of every step") };
        assert_eq!((whole.state.checkpoints[0].distinct_lenslets, after.distinct_lenslets), (1, 2));
        assert!(after.bits_per_pixel > whole.state.checkpoints[0].bits_per_pixel);
        let mut resumed = run().resumed(&kept[0]).unwrap();
        while !resumed.is_finished() {
            resumed.advance(&mut CancelToken::new()).unwrap();
        }
        assert_eq!(resumed.state.array, whole.state.array);
    }
}
