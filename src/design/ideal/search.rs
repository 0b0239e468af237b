//! Lenslets that are tried at other places, where no slope would bring them.
//!
//! Spots are narrow: slopes tell of the pixels beside a spot alone, and a mask ends at the first place from where every small move
//! leads down. What a faint spot tells grows with the square of its light while what is taken for it from others is lost at
//! once, so a lenslet that has gone dark stays so. So masks with one lenslet elsewhere are judged as they are.

use std::ops::{Range, RangeInclusive};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::Ideal;
use crate::design::error::IdealError;
use crate::design::guide::BLOCK;
use crate::design::merge::{close_pair, joined, merged};
use crate::design::movement::project;
use crate::design::settings::IdealSettings;
use crate::design::state::{Doing, IdealEvent};
use crate::design::watched::Watched;
use crate::information::paired_gain;
use crate::optics::{Lenslet, LensletArray, Limits};
use crate::seeds::SeedStream;

/// A lenslet is faint that has less than this share of the mean light of the others.
const FAINT: f64 = 0.25;
/// Sixteenths of the steps after which lenslets are tried at other places.
const OCCASIONS: RangeInclusive<usize> = 4..=12;
/// Scenes on which they are judged, for each block of a value, and how many masks are then judged on more.
const SCREENS: [(usize, usize); 3] = [(8, 24), (24, 6), (96, 1)];
/// How many times the scenes of a value, other ones, the mask that is left is compared on with the mask as it is.
const COMPARED: usize = 4;
/// Distance to other spots within which slopes lead, px.
const NEAR_PX: f64 = 2.0;
/// How far beyond the limits places are drawn, as a share of the room between these: what lies there comes to stand on the limit.
const BEYOND: f64 = 0.25;

impl Ideal<'_> {
    /// Now and then, puts a lenslet at another place, where it tells more.
    pub(super) fn search(&mut self, watch: &Watched<'_>) -> Result<(), IdealError> {
        let step = self.state.step;
        let sixteenth = |step: usize| 16 * step / self.settings.steps.max(1);
        let (before, now) = (sixteenth(step.saturating_sub(self.settings.refit_every)), sixteenth(step));
        // Where one was put elsewhere in the round before, another may follow.
        let follows = matches!(self.state.events.last(), Some(IdealEvent::Relocated { step: at, .. })
            if at + self.settings.refit_every == step);
        if !OCCASIONS.contains(&now) || (before == now && !follows) {
            return Ok(());
        }
        let (state, settings) = (&self.state, &self.settings);
        let Some(posterior) = self.guide.posterior() else { return Ok(()) };
        let seed = |part: u64| SeedStream::Relocation { part, step: state.step }.derive(settings.seed);
        let mut tried = tried(&state.array, (settings, &self.limits), &state.pruned, seed(0));
        if tried.is_empty() {
            return Ok(());
        }
        let savings = |array: &LensletArray, (scenes, part, block): (Range<usize>, u64, usize), share: f64| {
            let go_on = || watch.tell(state, Some((Doing::Searching, share))).is_continue();
            posterior.savings(array, (scenes, seed(part), block), &go_on)
        };
        let blocks = posterior.scenes() / BLOCK;
        let compared = COMPARED * blocks * BLOCK;
        let all = (work(tried.len()) * blocks + 2 * compared) as f64;
        let mut done = 0;
        for (until, left) in SCREENS {
            for mask in &mut tried {
                let due = mask.savings.len()..until * blocks;
                done += due.len();
                mask.savings.extend(savings(&mask.array, (due, 1, SCREENS[0].0 * blocks), done as f64 / all)?);
            }
            tried.sort_by(|one, other| other.mean().total_cmp(&one.mean()));
            tried.truncate(left);
        }
        let Some(best) = tried.pop() else { return Ok(()) };
        let before = savings(&state.array, (0..compared, 2, BLOCK), (done + compared) as f64 / all)?;
        let after = savings(&best.array, (0..compared, 2, BLOCK), 1.0)?;
        let (gain, half_width) = paired_gain(&before, &after);
        if gain > half_width {
            self.state.array = best.array;
            self.state.momentum.forget(best.lenslet);
            self.state.followed = false;
            self.state.events.push(IdealEvent::Relocated { step: self.state.step, lenslet: best.lenslet });
        }
        Ok(())
    }
}

/// Scenes that so many masks are judged on before one is left, for each block of a value.
fn work(masks: usize) -> usize {
    let (mut masks, mut known, mut work) = (masks, 0, 0);
    for (until, left) in SCREENS {
        work += masks * (until - known);
        (masks, known) = (masks.min(left), until);
    }
    work
}

/// A mask with one lenslet elsewhere.
struct Tried {
    lenslet: usize,
    array: LensletArray,
    /// What its decoder tells of each scene so far.
    savings: Vec<f64>,
}

impl Tried {
    fn mean(&self) -> f64 {
        self.savings.iter().sum::<f64>() / self.savings.len().max(1) as f64
    }
}

/// Masks in which one free lenslet stands at another place, drawn at random, with the light that it has; or a faint one with the
/// mean light of the others, where light is free. Lenslets that all but coincide move as one. None where places are not free.
fn tried(
    array: &LensletArray,
    (settings, limits): (&IdealSettings, &Limits),
    pruned: &[usize],
    seed: u64,
) -> Vec<Tried> {
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
    // One that is lit and faint is tried with the light that it has, too.
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
    let masks = (0..settings.tried).filter_map(|number| {
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
        Some(Tried { lenslet: index, array, savings: Vec::new() })
    });
    masks.collect()
}

/// The mask with one lenslet for all that all but coincide, the others dark.
fn folded(array: &LensletArray, settings: &IdealSettings, free: &[usize]) -> LensletArray {
    let mut folded = array.clone();
    loop {
        let lit: Vec<usize> = free.iter().copied().filter(|&index| folded.lenslets[index].weight > 0.0).collect();
        let Some((one, other)) = close_pair(&folded, &lit) else { return folded };
        folded.lenslets[one] = joined(folded.lenslets[one], folded.lenslets[other], settings.free);
        folded.lenslets[other].weight = 0.0;
    }
}

/// Light that free lenslets have on average, dark ones left out and coincident ones taken for one.
fn mean_light(array: &LensletArray, free: &[usize]) -> f64 {
    let lenslets: Vec<Lenslet> = free.iter().map(|&index| array.lenslets[index]).collect();
    let all = lenslets.iter().map(|lenslet| lenslet.weight).sum::<f64>();
    all / merged(&LensletArray { lenslets, ..array.clone() }).lenslets.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::super::tests::{few_beads, short};
    use super::*;
    use crate::design::settings::{Free, Objective, Preset};
    use crate::forward::ForwardModel;
    use crate::optics::Spot;
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
        LensletArray { rows: 32, cols: 32, lenslets }
    }

    fn tried_of(array: &LensletArray, settings: &IdealSettings, pruned: &[usize]) -> Vec<Tried> {
        tried(array, (settings, &Limits::default()), pruned, 1)
    }

    fn distance(one: &Lenslet, other: &Lenslet) -> f64 {
        (one.x - other.x).hypot(one.y - other.y)
    }

    #[test]
    fn every_lenslet_is_tried_elsewhere_with_its_own_light_or_a_faint_one_with_that_of_the_others() {
        let mut mask = mask();
        mask.lenslets[2].spot = Spot::Isotropic(0.9);
        let found = tried_of(&mask, &settings(), &[]);
        let most = settings().tried;
        assert!(found.len() > most / 2 && found.len() <= most, "{}", found.len());
        for Tried { lenslet, array, .. } in &found {
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
        let counts = [0, 1, 2, 3].map(|index| found.iter().filter(|tried| tried.lenslet == index).count());
        // The faint one twice: with its light and with that of the others.
        assert!(counts.iter().all(|&count| count > 8) && counts[1] > counts[0], "{counts:?}");
        let (left, right) = Limits::default().coordinate_range(32);
        let at_a_limit = found.iter().filter(|tried| [left, right].contains(&tried.array.lenslets[tried.lenslet].x));
        assert!(at_a_limit.count() > found.len() / 8, "where the best ones often are");
    }

    #[test]
    fn lenslets_that_all_but_coincide_are_tried_as_one() {
        let mut mask = mask();
        mask.lenslets[1] = Lenslet { x: 27.5, weight: 0.4, ..mask.lenslets[2] };
        let found = tried_of(&mask, &settings(), &[]);
        let joined = |tried: &Tried| (tried.lenslet == 1).then_some(tried.array.lenslets[1].weight);
        let lights: Vec<f64> = found.iter().filter_map(joined).collect();
        assert!(!lights.is_empty() && lights.iter().all(|light| (light - 0.82 / 1.38).abs() < 1e-12), "{lights:?}");
        // The one that is spared by that gets light at another place.
        let spared = found.iter().filter(|tried| tried.lenslet == 2).map(|tried| tried.array.lenslets[2].weight);
        assert!(spared.clone().count() > 0 && spared.into_iter().all(|light| (light - 0.25).abs() < 1e-9));
        let held = IdealSettings { free: Free { weights: false, ..Free::default() }, ..settings() };
        for tried in tried_of(&mask, &held, &[]) {
            let weights =
                |array: &LensletArray| array.lenslets.iter().map(|lenslet| lenslet.weight).collect::<Vec<_>>();
            assert_eq!(weights(&tried.array), weights(&mask), "light that is held stays");
        }
    }

    #[test]
    fn what_must_stay_stays() {
        let held = |free: Free| IdealSettings { free, ..settings() };
        assert!(tried_of(&mask(), &held(Free { positions: false, ..Free::default() }), &[]).is_empty());
        let of = |found: &[Tried], index: usize| found.iter().filter(|tried| tried.lenslet == index).count();
        let found = tried_of(&mask(), &IdealSettings { locked: vec![1], ..settings() }, &[3]);
        assert!(of(&found, 0) > 0 && of(&found, 2) > 0 && of(&found, 1) == 0 && of(&found, 3) == 0);
        let settings = IdealSettings {
            locked: vec![0],
            min_separation_px: 10.0,
            ..held(Free { widths: false, ..Free::default() })
        };
        let found = tried_of(&mask(), &settings, &[]);
        assert!(!found.is_empty());
        for Tried { lenslet, array, .. } in found {
            assert_eq!((array.lenslets[0], array.lenslets[lenslet].spot), (mask().lenslets[0], Spot::Isotropic(1.0)));
            let others = array.lenslets.iter().enumerate().filter(|&(index, _)| index != lenslet);
            assert!(others.into_iter().all(|(_, other)| distance(other, &array.lenslets[lenslet]) > 9.9));
        }
        let all_locked = IdealSettings { locked: vec![0, 1, 2, 3], ..settings };
        assert!(tried_of(&mask(), &all_locked, &[]).is_empty());
    }

    #[test]
    fn the_share_of_a_faint_lenslet_is_that_of_those_whose_light_is_free() {
        let mut mask = mask();
        let settings = IdealSettings { locked: vec![2], ..settings() };
        let relit = |found: Vec<Tried>| {
            let lights =
                found.into_iter().filter(|tried| tried.lenslet == 1).map(|tried| tried.array.lenslets[1].weight);
            lights.fold(0.0, f64::max)
        };
        // Two free lenslets shared 0.56 and the faint one's 0.02.
        assert!((relit(tried_of(&mask, &settings, &[])) - 0.58 / 3.0).abs() < 1e-3);
        (mask.lenslets[0].weight, mask.lenslets[1].weight, mask.lenslets[3].weight) = (0.0, 0.0, 0.0);
        assert!(tried_of(&mask, &settings, &[]).is_empty(), "no light is free");
    }

    #[test]
    fn the_work_is_that_of_all_screens() {
        assert_eq!(work(96), 96 * 8 + 24 * 16 + 6 * 72);
        assert_eq!(work(3), 3 * 8 + 3 * 16 + 3 * 72);
    }

    #[test]
    fn a_dark_lenslet_gets_light_where_that_tells_more_and_resumed_runs_do_the_same() {
        let set = few_beads();
        let imaging = ForwardModel::new(&set, (16, 16), 10.0, Noise::Shot).unwrap();
        // The whole sensor sees more of the scene through two lenslets.
        let lenslets = [1.0, 0.0].map(|weight| Lenslet::round(4.0, 7.5, 0.8, weight));
        let run = || {
            let mut run = short(&imaging, &lenslets, 4);
            run.settings.tried = 24;
            run
        };
        let mut whole = run();
        let mut kept = Vec::new();
        while !whole.is_finished() {
            whole.advance(&mut |_| ControlFlow::Continue(())).unwrap();
            kept.push(whole.to_bytes().unwrap());
        }
        assert_eq!(whole.state.events[0], IdealEvent::Relocated { step: 1, lenslet: 1 });
        let [_, after, ..] = &whole.state.frames[..] else { panic!("a frame of every step") };
        assert_eq!((whole.state.frames[0].distinct_lenslets, after.distinct_lenslets), (1, 2));
        assert!(after.bits_per_pixel > whole.state.frames[0].bits_per_pixel);
        let mut resumed = run().resumed(&kept[0]).unwrap();
        while !resumed.is_finished() {
            resumed.advance(&mut |_| ControlFlow::Continue(())).unwrap();
        }
        assert_eq!(resumed.state.array, whole.state.array);
    }
}
