//! Lenslets that have become one, or dark: how many there really are, and the mask without the others.

use super::settings::{Free, IdealSettings};
use crate::optics::{Lenslet, LensletArray, Spot};

/// Distance of centres below which two lenslets make one spot, px.
const COINCIDENT_PX: f64 = 0.25;
/// Distance of centres below which two lenslets may as well be one, px.
const CLOSE_PX: f64 = 1.0;
/// Share of the light below which a lenslet is dark, and the same as a share of what one lenslet of many has on average:
/// where there are hundreds, all of them may have little.
const DARK: f64 = 1e-3;
const DARK_OF_MEAN: f64 = 0.1;

/// The array with dark lenslets left out and coincident ones made one: the same light, its centre of mass and mean
/// covariance.
pub fn merged(array: &LensletArray) -> LensletArray {
    merged_where(array, Free::default(), &[])
}

/// The mask that a run with these settings leaves: as [`merged`], but locked lenslets and what is held are as they
/// were.
pub fn merged_result(array: &LensletArray, settings: &IdealSettings) -> LensletArray {
    merged_where(array, settings.free, &settings.locked)
}

fn merged_where(array: &LensletArray, free: Free, locked: &[usize]) -> LensletArray {
    let total: f64 = array.lenslets.iter().map(|lenslet| lenslet.weight).sum();
    let dark = total * DARK.min(DARK_OF_MEAN / array.lenslets.len().max(1) as f64);
    let lenslets = array.lenslets.iter().enumerate().map(|(index, lenslet)| (*lenslet, !locked.contains(&index)));
    let mut lenslets: Vec<_> = lenslets.filter(|(lenslet, may_change)| lenslet.weight >= dark || !may_change).collect();
    let mut go_on = free.weights;
    while go_on {
        let apart = apart(&lenslets, free);
        // What was joined may have come upon another.
        go_on = apart.len() < lenslets.len();
        lenslets = apart;
    }
    if lenslets.is_empty() {
        return array.clone();
    }
    let lenslets = lenslets.into_iter().map(|(lenslet, _)| lenslet).collect();
    LensletArray { lenslets, ..array.clone() }.with_unit_weight()
}

/// The lenslets, which may change or not, with each joined to the first one before it that it coincides with.
fn apart(lenslets: &[(Lenslet, bool)], free: Free) -> Vec<(Lenslet, bool)> {
    let mut apart: Vec<(Lenslet, bool)> = Vec::with_capacity(lenslets.len());
    for &(lenslet, may_change) in lenslets {
        let found = apart.iter_mut().find(|(other, may)| may_change && *may && coincide(other, &lenslet));
        match found {
            Some((other, _)) => *other = joined(*other, lenslet, free),
            None => apart.push((lenslet, may_change)),
        }
    }
    apart
}

/// Whether two lenslets make one spot: a narrow one in the middle of a wide one does not.
fn coincide(one: &Lenslet, other: &Lenslet) -> bool {
    let ((axx, axy, ayy), (bxx, bxy, byy)) = (one.spot.covariance(), other.spot.covariance());
    one.plane == other.plane
        && (one.x - other.x).hypot(one.y - other.y) < COINCIDENT_PX
        && (axx.sqrt() - bxx.sqrt()).abs() < COINCIDENT_PX
        && (ayy.sqrt() - byy.sqrt()).abs() < COINCIDENT_PX
        && (axy - bxy).abs() < COINCIDENT_PX
}

/// The two lenslets of one plane whose centres are closest, and their distance in px.
fn closest(lenslets: &[Lenslet]) -> Option<(usize, usize, f64)> {
    let mut found: Option<(usize, usize, f64)> = None;
    for (one, a) in lenslets.iter().enumerate() {
        for (other, b) in lenslets.iter().enumerate().skip(one + 1).filter(|(_, b)| b.plane == a.plane) {
            let distance = (a.x - b.x).hypot(a.y - b.y);
            if found.is_none_or(|(_, _, least)| distance < least) {
                found = Some((one, other, distance));
            }
        }
    }
    found
}

/// Least distance of the centres of two lenslets of one plane, px, where there are two.
pub fn least_separation_px(array: &LensletArray) -> Option<f64> {
    closest(&array.lenslets).map(|(_, _, distance)| distance)
}

/// Of some lenslets of an array the two that all but coincide, as places in the list.
pub(super) fn close_pair(array: &LensletArray, among: &[usize]) -> Option<(usize, usize)> {
    let lenslets: Vec<Lenslet> = among.iter().map(|&index| array.lenslets[index]).collect();
    let (one, other, _) = closest(&lenslets).filter(|&(_, _, distance)| distance < CLOSE_PX)?;
    Some((among[one], among[other]))
}

/// One lenslet with the light of two; what is not free is as it was in the first.
pub(super) fn joined(one: Lenslet, other: Lenslet, free: Free) -> Lenslet {
    let weight = one.weight + other.weight;
    let share = if weight > 0.0 { one.weight / weight } else { 0.5 };
    let mean = |a: f64, b: f64| share * a + (1.0 - share) * b;
    let spot = match (one.spot, other.spot) {
        _ if !free.widths => one.spot,
        (Spot::Isotropic(a), Spot::Isotropic(b)) => Spot::Isotropic(mean(a * a, b * b).sqrt()),
        (a, b) => {
            let ((axx, axy, ayy), (bxx, bxy, byy)) = (a.covariance(), b.covariance());
            Spot::Anisotropic { xx: mean(axx, bxx), xy: mean(axy, bxy), yy: mean(ayy, byy) }
        }
    };
    let (x, y) = if free.positions { (mean(one.x, other.x), mean(one.y, other.y)) } else { (one.x, one.y) };
    Lenslet { x, y, spot, weight: if free.weights { weight } else { one.weight }, plane: one.plane }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::{Objective, Preset};
    use crate::optics::{heuristic_layout, render_psf};

    #[test]
    fn coincident_and_dark_lenslets_leave_the_psf_as_it_was() {
        let mut array = heuristic_layout(4);
        array.lenslets.push(Lenslet { weight: 1e-9, x: 20.0, ..array.lenslets[0] });
        array.lenslets.push(Lenslet { x: array.lenslets[2].x + 0.02, weight: 0.1, ..array.lenslets[2] });
        let merged = merged(&array);
        assert_eq!(merged.lenslets.len(), 4);
        let (one, other) = (render_psf(&array, 1).unwrap(), render_psf(&merged, 1).unwrap());
        assert!((one - other).iter().all(|difference| difference.abs() < 1e-4));
        assert!((merged.effective_count() - 4.0).abs() < 0.3);
        array.lenslets[5].plane = 1;
        assert_eq!(super::merged(&array).lenslets.len(), 5, "planes are kept apart");
    }

    #[test]
    fn a_core_keeps_its_halo_locked_lenslets_their_place_and_held_weights_their_light() {
        let mut array = heuristic_layout(3);
        array.lenslets.push(Lenslet { spot: Spot::Isotropic(5.0), ..array.lenslets[0] });
        assert_eq!(merged(&array).lenslets.len(), 4);
        array.lenslets[3] = Lenslet { x: array.lenslets[0].x + 0.1, ..array.lenslets[0] };
        array.lenslets[2].weight = 0.0;
        let settings = IdealSettings::new(Preset::Default, Objective::Density, 1);
        let left = |settings: &IdealSettings| merged_result(&array, settings).lenslets;
        assert_eq!(left(&settings).len(), 2);
        let locked = left(&IdealSettings { locked: vec![0, 2], ..settings.clone() });
        assert_eq!(locked.len(), 4);
        assert_eq!((locked[0].x, locked[2].weight), (array.lenslets[0].x, 0.0));
        let held = Free { weights: false, ..Free::default() };
        let held = left(&IdealSettings { free: held, ..settings });
        assert_eq!(held.len(), 3);
        assert!(held.iter().all(|lenslet| (lenslet.weight - 1.0 / 3.0).abs() < 1e-12));
    }

    #[test]
    fn lenslets_that_come_together_by_being_joined_are_one() {
        let at = |x: f64| Lenslet::round(x, 5.0, 1.0, 1.0);
        let array = LensletArray { rows: 10, cols: 10, lenslets: [5.0, 5.4, 5.2, 5.34].map(at).to_vec() };
        let [one] = &merged(&array).lenslets[..] else { panic!("one lenslet") };
        assert!((one.x - 5.235).abs() < 1e-12 && (one.weight - 1.0).abs() < 1e-12, "{one:?}");
    }

    #[test]
    fn none_of_many_lenslets_is_dark_because_others_have_become_brighter() {
        let lenslet = |index: usize| Lenslet::round((index % 40) as f64, (index / 40) as f64, 1.0, 1.0);
        let mut array = LensletArray { rows: 50, cols: 40, lenslets: (0..2000).map(lenslet).collect() };
        for lenslet in &mut array.lenslets[..10] {
            lenslet.weight = 3.0;
        }
        array.lenslets[20].weight = 0.01;
        assert_eq!(merged(&array).lenslets.len(), 1999);
    }
}
