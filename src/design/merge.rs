//! Lenslets that have become one, or dark: how many there really are, and the mask without the others.

use super::settings::Free;
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
    let total: f64 = array.lenslets.iter().map(|lenslet| lenslet.weight).sum();
    let dark = total * DARK.min(DARK_OF_MEAN / array.lenslets.len().max(1) as f64);
    let mut lenslets: Vec<Lenslet> = array.lenslets.iter().filter(|lenslet| lenslet.weight >= dark).copied().collect();
    loop {
        let apart = apart(&lenslets);
        if apart.len() == lenslets.len() {
            break;
        }
        // What was joined may have come upon another.
        lenslets = apart;
    }
    if lenslets.is_empty() {
        return array.clone();
    }
    LensletArray { lenslets, ..array.clone() }.with_unit_weight()
}

/// The lenslets with each joined to the first one before it that it coincides with.
fn apart(lenslets: &[Lenslet]) -> Vec<Lenslet> {
    let mut apart: Vec<Lenslet> = Vec::with_capacity(lenslets.len());
    for &lenslet in lenslets {
        let coincides = |other: &&mut Lenslet| {
            other.plane == lenslet.plane && (other.x - lenslet.x).hypot(other.y - lenslet.y) < COINCIDENT_PX
        };
        match apart.iter_mut().find(coincides) {
            Some(other) => *other = joined(*other, lenslet, Free::default()),
            None => apart.push(lenslet),
        }
    }
    apart
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
