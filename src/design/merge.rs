//! Merging of coincident lenslets and removal of dark ones.

use super::settings::{Free, IdealSettings};
use crate::optics::{Lenslet, LensletArray, Spot};

/// Distance of centres below which two lenslets coincide, px.
const COINCIDENT_PX: f64 = 0.25;
/// Distance of centres below which two lenslets are a close pair, px.
const CLOSE_PX: f64 = 1.0;
/// Share of the total weight below which a lenslet is dark, and share of the mean weight; the smaller of both counts, since each of
/// hundreds of lenslets has little.
const DARK: f64 = 1e-3;
const DARK_OF_MEAN: f64 = 0.1;

/// The array without dark lenslets and with coincident ones merged: their total weight, centre of mass and mean covariance.
pub fn merged(array: &LensletArray) -> LensletArray {
    merged_where(array, Free::default(), &[])
}

/// The result of a run with these settings: as [`merged`], but locked lenslets and fixed parameters stay.
pub fn merged_result(array: &LensletArray, settings: &IdealSettings) -> LensletArray {
    merged_where(array, settings.free, &settings.locked)
}

fn merged_where(array: &LensletArray, free: Free, locked: &[usize]) -> LensletArray {
    let total: f64 = array.lenslets.iter().map(|lenslet| lenslet.weight).sum();
    let dark = total * DARK.min(DARK_OF_MEAN / array.lenslets.len().max(1) as f64);
    let lenslets = array.lenslets.iter().enumerate().map(|(index, lenslet)| (*lenslet, !locked.contains(&index)));
    let mut lenslets: Vec<_> = lenslets.filter(|(lenslet, may_change)| lenslet.weight >= dark || !may_change).collect();
    let mut is_joining = free.weights;
    while is_joining {
        let apart = apart(&lenslets, free);
        // A joined lenslet may coincide with another one.
        is_joining = apart.len() < lenslets.len();
        lenslets = apart;
    }
    if lenslets.is_empty() {
        return array.clone();
    }
    let lenslets = lenslets.into_iter().map(|(lenslet, _)| lenslet).collect();
    LensletArray { lenslets, ..array.clone() }.with_unit_weight()
}

/// The lenslets, each with whether it may change, and each joined to the first one before it that it coincides with.
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

/// Whether two lenslets coincide: close centres and about the same width.
fn coincide(one: &Lenslet, other: &Lenslet) -> bool {
    let ((axx, axy, ayy), (bxx, bxy, byy)) = (one.spot.covariance(), other.spot.covariance());
    one.plane == other.plane
        && (one.x - other.x).hypot(one.y - other.y) < COINCIDENT_PX
        && (axx.sqrt() - bxx.sqrt()).abs() < COINCIDENT_PX
        && (ayy.sqrt() - byy.sqrt()).abs() < COINCIDENT_PX
        && (axy - bxy).abs() < COINCIDENT_PX
}

/// Indices of the two lenslets of one plane with the closest centres, and their distance, px.
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

/// Least distance of the centres of two lenslets of one plane, px; none for fewer than two.
pub fn least_separation_px(array: &LensletArray) -> Option<f64> {
    closest(&array.lenslets).map(|(_, _, distance)| distance)
}

/// Indices of a close pair among some lenslets of an array.
pub(super) fn close_pair(array: &LensletArray, among: &[usize]) -> Option<(usize, usize)> {
    let lenslets: Vec<Lenslet> = among.iter().map(|&index| array.lenslets[index]).collect();
    let (one, other, _) = closest(&lenslets).filter(|&(_, _, distance)| distance < CLOSE_PX)?;
    Some((among[one], among[other]))
}

/// One lenslet with the weight of two; fixed parameters are those of the first.
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
    fn merging_keeps_the_psf() {
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
    fn merging_spares_halos_locked_lenslets_and_fixed_weights() {
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
    fn merging_repeats_until_no_pair_coincides() {
        let at = |x: f64| Lenslet::round(x, 5.0, 1.0, 1.0);
        let array = LensletArray::new(10, 10, [5.0, 5.4, 5.2, 5.34].map(at).to_vec());
        let [one] = &merged(&array).lenslets[..] else { panic!("one lenslet") };
        assert!((one.x - 5.235).abs() < 1e-12 && (one.weight - 1.0).abs() < 1e-12, "{one:?}");
    }

    #[test]
    fn many_lenslets_are_not_dark_beside_brighter_ones() {
        let lenslet = |index: usize| Lenslet::round((index % 40) as f64, (index / 40) as f64, 1.0, 1.0);
        let mut array = LensletArray::new(50, 40, (0..2000).map(lenslet).collect());
        for lenslet in &mut array.lenslets[..10] {
            lenslet.weight = 3.0;
        }
        array.lenslets[20].weight = 0.01;
        assert_eq!(merged(&array).lenslets.len(), 1999);
    }
}
