//! Light for lenslets that have none of their own, at places where no slope would bring them.
//!
//! What a faint spot tells grows with the square of its light while what is taken for it from others is lost at once, so a
//! lenslet that has gone dark stays so, however much a fair share of the light would tell where it stands or elsewhere. So
//! masks with such a share at places all over the grid are judged as they are.

use super::{Ideal, RELIT_SEEDS};
use crate::design::error::IdealError;
use crate::design::guide::Valued;
use crate::design::imaging::derived_seed;
use crate::design::merge::{close_pair, joined, merged};
use crate::design::movement::project;
use crate::design::settings::IdealSettings;
use crate::design::state::{Doing, IdealEvent};
use crate::design::watched::Watched;
use crate::optics::{Lenslet, LensletArray, Limits};

/// Places along each side of the region where lenslets may stand.
const PLACES: usize = 5;
/// A lenslet is faint that has less than this share of the mean light of the others.
const FAINT: f64 = 0.25;
/// Eighths of the steps after which lenslets may get light again.
const OCCASIONS: std::ops::RangeInclusive<usize> = 2..=6;
/// Scenes on which masks with a lenslet that gets light elsewhere are judged, and other ones on which the best of them is
/// compared with the mask as it is.
const SCREENED: usize = 256;
const COMPARED: usize = 2048;

impl Ideal<'_> {
    /// Now and then, gives a lenslet without light of its own some at another place, where that tells more.
    pub(super) fn relight(&mut self, watch: &Watched<'_>) -> Result<(), IdealError> {
        let eighth = |step: usize| 8 * step / self.settings.steps.max(1);
        let (before, now) =
            (eighth(self.state.step.saturating_sub(self.settings.refit_every)), eighth(self.state.step));
        if before == now || !OCCASIONS.contains(&now) {
            return Ok(());
        }
        let state = &self.state;
        let Some((lenslet, masks)) = relit(&state.array, (&self.settings, &self.limits), &state.pruned, now) else {
            return Ok(());
        };
        let seed = |part: u64| derived_seed(self.settings.seed, RELIT_SEEDS | part << 28 | state.step as u64);
        let foreseen = |mask: &LensletArray, samples: usize, part: u64, share: f64| {
            let go_on = || watch.tell(state, Some((Doing::Relighting, share))).is_continue();
            self.guide.foreseen(mask, (samples, seed(part)), &go_on)
        };
        let mut best: Option<(f64, LensletArray)> = None;
        let count = masks.len() as f64;
        for (index, mask) in masks.into_iter().enumerate() {
            let Some((bits, _)) = foreseen(&mask, SCREENED, 0, index as f64 / count)? else { return Ok(()) };
            if best.as_ref().is_none_or(|(most, _)| bits > *most) {
                best = Some((bits, mask));
            }
        }
        let Some((_, mask)) = best else { return Ok(()) };
        let (before, after) = (foreseen(&state.array, COMPARED, 1, 1.0)?, foreseen(&mask, COMPARED, 1, 1.0)?);
        let half = |[low, high]: [f64; 2]| 0.5 * (high - low);
        let is_more =
            |((before, around), (after, beside)): (Valued, Valued)| after - before > half(around).hypot(half(beside));
        if before.zip(after).is_some_and(is_more) {
            self.state.array = mask;
            self.state.momentum.forget(lenslet);
            self.state.followed = false;
            self.state.events.push(IdealEvent::Relit { step: self.state.step, lenslet });
        }
        Ok(())
    }
}

/// Masks in which a faint lenslet, or one of two that all but coincide, has the mean light of the others at another place, and
/// which lenslet that is; of several without any light another one on each occasion. None where lenslets, light or places are
/// not free.
fn relit(
    array: &LensletArray,
    (settings, limits): (&IdealSettings, &Limits),
    pruned: &[usize],
    occasion: usize,
) -> Option<(usize, Vec<LensletArray>)> {
    if !settings.free.positions || !settings.free.weights {
        return None;
    }
    let free = settings.free_lenslets(array.lenslets.len(), pruned);
    let (spare, without) = spared(array, settings, &free, occasion)?;
    let bright = merged(&without).lenslets;
    let mut lenslet = Lenslet { weight: mean_light(&without, &free), ..array.lenslets[spare] };
    if settings.free.widths {
        lenslet.spot = bright.iter().max_by(|one, other| one.weight.total_cmp(&other.weight))?.spot;
    }
    let (left, right) = limits.coordinate_range(array.cols);
    let (top, bottom) = limits.coordinate_range(array.rows);
    let along = |low: f64, high: f64, place: usize| low + (high - low) * place as f64 / (PLACES - 1) as f64;
    // Half the way to the next place.
    let near = 0.5 * (right - left).max(bottom - top) / (PLACES - 1) as f64;
    let masks = (0..PLACES * PLACES).filter_map(|place| {
        let (x, y) = (along(left, right, place % PLACES), along(top, bottom, place / PLACES));
        let taken = |other: &Lenslet| {
            let distance = (other.x - x).hypot(other.y - y);
            distance < settings.min_separation_px || (other.plane == lenslet.plane && distance < near)
        };
        if bright.iter().any(taken) {
            return None;
        }
        let mut mask = without.clone();
        mask.lenslets[spare] = Lenslet { x, y, ..lenslet };
        project(&mut mask, settings, limits);
        Some(mask)
    });
    Some((spare, masks.collect()))
}

/// A lenslet that the mask can do without, and the mask without its light.
fn spared(
    array: &LensletArray,
    settings: &IdealSettings,
    free: &[usize],
    occasion: usize,
) -> Option<(usize, LensletArray)> {
    let weight = |index: usize| array.lenslets[index].weight;
    let least = free.iter().map(|&index| weight(index)).min_by(f64::total_cmp)?;
    let faintest: Vec<usize> = free.iter().copied().filter(|&index| weight(index) == least).collect();
    let faintest = faintest[(occasion - OCCASIONS.start()) * faintest.len() / OCCASIONS.count()];
    let mut without = array.clone();
    without.lenslets[faintest].weight = 0.0;
    if least < FAINT * mean_light(&without, free) {
        return Some((faintest, without));
    }
    let (one, other) = close_pair(array, free)?;
    without.clone_from(array);
    without.lenslets[one] = joined(array.lenslets[one], array.lenslets[other], settings.free);
    without.lenslets[other].weight = 0.0;
    Some((other, without))
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
    use crate::design::imaging::Imaging;
    use crate::design::settings::{Free, Objective, Preset};
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

    #[test]
    fn a_faint_lenslet_gets_the_mean_light_at_every_free_place() {
        let mut mask = mask();
        mask.lenslets[2].spot = Spot::Isotropic(0.9);
        let (spare, masks) = relit(&mask, (&settings(), &Limits::default()), &[], 2).unwrap();
        assert_eq!(spare, 1);
        // The three bright ones take a place each.
        assert_eq!(masks.len(), PLACES * PLACES - 3);
        for relit in &masks {
            let moved = relit.lenslets[1];
            assert!((moved.weight - 0.25).abs() < 1e-12, "{moved:?}");
            assert_eq!(moved.spot, Spot::Isotropic(0.9), "as sharp as the brightest");
            assert!((relit.lenslets.iter().map(|lenslet| lenslet.weight).sum::<f64>() - 1.0).abs() < 1e-12);
            for other in [0, 2, 3] {
                assert!((moved.x - mask.lenslets[other].x).hypot(moved.y - mask.lenslets[other].y) > 3.0);
                assert!((relit.lenslets[other].weight / mask.lenslets[other].weight - 0.75 / 0.98).abs() < 1e-12);
            }
        }
        let (left, right) = Limits::default().coordinate_range(32);
        let corner = |x: f64, y: f64| {
            masks.iter().any(|mask| (mask.lenslets[1].x - x).abs() < 1e-9 && (mask.lenslets[1].y - y).abs() < 1e-9)
        };
        assert!(corner(left, right) && corner(right, right) && !corner(left, left));
    }

    #[test]
    fn one_of_two_lenslets_on_one_spot_can_be_spared() {
        let mut mask = mask();
        mask.lenslets[1] = Lenslet { x: 27.5, weight: 0.4, ..mask.lenslets[2] };
        let (spare, masks) = relit(&mask, (&settings(), &Limits::default()), &[], 2).unwrap();
        assert_eq!(spare, 2);
        // What stays has the light of both.
        let share = |index: usize| masks[0].lenslets[index].weight / 0.75;
        assert!((share(1) - 0.82 / 1.38).abs() < 1e-12 && (share(0) - 0.32 / 1.38).abs() < 1e-12);
        // A width that may not change is not that of both.
        mask.lenslets[1].spot = Spot::Isotropic(2.0);
        let held = IdealSettings { free: Free { widths: false, ..Free::default() }, ..settings() };
        let (_, masks) = relit(&mask, (&held, &Limits::default()), &[], 2).unwrap();
        assert_eq!(masks[0].lenslets[1].spot, Spot::Isotropic(2.0));
        mask.lenslets[1].x = 20.0;
        assert!(relit(&mask, (&settings(), &Limits::default()), &[], 2).is_none(), "all are needed");
    }

    #[test]
    fn each_occasion_tries_another_of_the_dark_lenslets_away_from_all_others() {
        let mut mask = mask();
        let dark = |plane| Lenslet { weight: 0.0, plane, ..mask.lenslets[1] };
        mask.lenslets = [&mask.lenslets[..], &[dark(0), dark(1), dark(2), dark(3), dark(4)]].concat();
        mask.lenslets.remove(1);
        let settings = IdealSettings { min_separation_px: 4.0, ..settings() };
        let tried = OCCASIONS.map(|occasion| {
            let (spare, masks) = relit(&mask, (&settings, &Limits::default()), &[], occasion).unwrap();
            for relit in &masks {
                assert_eq!(relit.lenslets[..3].iter().map(|lenslet| lenslet.x).collect::<Vec<_>>(), [3.1, 27.9, 15.5]);
            }
            spare
        });
        assert_eq!(tried.collect::<Vec<_>>(), [3, 4, 5, 6, 7]);
    }

    #[test]
    fn the_share_is_that_of_lenslets_whose_light_is_free() {
        let mut mask = mask();
        let settings = IdealSettings { locked: vec![2], ..settings() };
        let (_, masks) = relit(&mask, (&settings, &Limits::default()), &[], 2).unwrap();
        // Two free lenslets shared 0.56 and the spare one's 0.02.
        assert!((masks[0].lenslets[1].weight - 0.58 / 3.0).abs() < 1e-12, "{:?}", masks[0].lenslets[1]);
        (mask.lenslets[0].weight, mask.lenslets[1].weight, mask.lenslets[3].weight) = (0.0, 0.0, 0.0);
        assert!(relit(&mask, (&settings, &Limits::default()), &[], 2).is_none(), "no light is free");
    }

    #[test]
    fn what_must_stay_stays() {
        let limits = Limits::default();
        let held = |free: Free| IdealSettings { free, ..settings() };
        let none =
            |settings: &IdealSettings, pruned: &[usize]| relit(&mask(), (settings, &limits), pruned, 2).is_none();
        assert!(none(&held(Free { positions: false, ..Free::default() }), &[]));
        assert!(none(&held(Free { weights: false, ..Free::default() }), &[]));
        assert!(none(&IdealSettings { locked: vec![1], ..settings() }, &[]));
        assert!(none(&settings(), &[1]));
        let settings = IdealSettings {
            locked: vec![0],
            min_separation_px: 10.0,
            ..held(Free { widths: false, ..Free::default() })
        };
        let (_, masks) = relit(&mask(), (&settings, &limits), &[], 2).unwrap();
        assert!(!masks.is_empty());
        for relit in masks {
            let moved = relit.lenslets[1];
            assert_eq!(moved.spot, mask().lenslets[1].spot);
            assert_eq!(relit.lenslets[0], mask().lenslets[0]);
            for other in [0, 2, 3].map(|index| relit.lenslets[index]) {
                assert!((moved.x - other.x).hypot(moved.y - other.y) > 9.9);
            }
        }
    }

    #[test]
    fn a_dark_lenslet_gets_light_where_that_tells_more_and_resumed_runs_do_the_same() {
        let set = few_beads();
        let imaging = Imaging::new(&set, (16, 16), 10.0, Noise::Shot).unwrap();
        // The whole sensor sees more of the scene through two lenslets.
        let lenslets = [1.0, 0.0].map(|weight| Lenslet::round(4.0, 7.5, 0.8, weight));
        let run = || short(&imaging, &lenslets, 4);
        let mut whole = run();
        let mut kept = Vec::new();
        while !whole.is_finished() {
            whole.advance(&mut |_| ControlFlow::Continue(())).unwrap();
            kept.push(whole.to_bytes().unwrap());
        }
        assert_eq!(whole.state.events[0], IdealEvent::Relit { step: 1, lenslet: 1 });
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
