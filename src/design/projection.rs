//! Projection of a mask onto the feasible ones: limits of the editor, least separation, weights that sum to 1.

use super::settings::IdealSettings;
use crate::optics::{LensletArray, Limits};

/// Most sweeps over all pairs of lenslets that are too close.
const SWEEPS: usize = 20;

/// Projects a mask: limits of the editor, least separation, weights that sum to 1. Locked lenslets stay.
pub(super) fn project(array: &mut LensletArray, settings: &IdealSettings, limits: &Limits) {
    let locked = |index: usize| settings.locked.contains(&index);
    let (rows, cols) = (array.rows, array.cols);
    for (index, lenslet) in array.lenslets.iter_mut().enumerate() {
        if !locked(index) {
            *lenslet = limits.project(*lenslet, rows, cols);
        }
    }
    if settings.min_separation_px > 0.0 && settings.free.positions {
        separate(array, settings, limits);
    }
    if settings.free.weights {
        let sum = |array: &LensletArray, of: bool| {
            let lenslets = array.lenslets.iter().enumerate().filter(|(index, _)| locked(*index) == of);
            lenslets.map(|(_, lenslet)| lenslet.weight).sum::<f64>()
        };
        let (kept, free) = (sum(array, true), sum(array, false));
        if free > 0.0 {
            // Locked lenslets may hold all the light.
            let scale = (1.0 - kept).max(0.0) / free;
            for (index, lenslet) in array.lenslets.iter_mut().enumerate() {
                if !locked(index) {
                    lenslet.weight *= scale;
                }
            }
        }
    }
}

/// Pushes lit lenslets apart until every pair has the least separation, as far as the limits allow.
fn separate(array: &mut LensletArray, settings: &IdealSettings, limits: &Limits) {
    let least = settings.min_separation_px;
    let count = array.lenslets.len();
    for _ in 0..SWEEPS {
        let mut moved = false;
        for one in 0..count {
            for other in one + 1..count {
                let (a, b) = (array.lenslets[one], array.lenslets[other]);
                let distance = (b.x - a.x).hypot(b.y - a.y);
                if a.weight == 0.0 || b.weight == 0.0 || distance >= least * (1.0 - 1e-9) {
                    continue;
                }
                // Lenslets at one point are pushed along a direction that depends on the pair.
                let angle = (one * count + other) as f64;
                let (dx, dy) = if distance > 1e-9 {
                    ((b.x - a.x) / distance, (b.y - a.y) / distance)
                } else {
                    (angle.cos(), angle.sin())
                };
                let free = [one, other].map(|index| !settings.locked.contains(&index));
                let shares = match free {
                    // The fainter lenslet moves further.
                    [true, true] => [b.weight, a.weight].map(|weight| weight / (a.weight + b.weight)),
                    [true, false] => [1.0, 0.0],
                    [false, true] => [0.0, 1.0],
                    [false, false] => continue,
                };
                moved = true;
                let push = least - distance;
                for (index, signed) in [(one, -shares[0]), (other, shares[1])] {
                    if signed != 0.0 {
                        let lenslet = &mut array.lenslets[index];
                        lenslet.x += signed * push * dx;
                        lenslet.y += signed * push * dy;
                        *lenslet = limits.project(*lenslet, array.rows, array.cols);
                    }
                }
            }
        }
        if !moved {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::settings::{Objective, Preset};
    use super::*;
    use crate::optics::{Lenslet, Spot, heuristic_layout, random_layout};

    fn settings() -> IdealSettings {
        IdealSettings::new(Preset::Default, Objective::Density, 1)
    }

    #[test]
    fn free_lenslets_are_dark_where_locked_ones_hold_all_the_light() {
        let mut array = heuristic_layout(3);
        for (lenslet, weight) in array.lenslets.iter_mut().zip([0.6, 0.4, 0.1]) {
            lenslet.weight = weight;
        }
        project(&mut array, &IdealSettings { locked: vec![0, 1], ..settings() }, &Limits::default());
        assert_eq!(array.lenslets.iter().map(|lenslet| lenslet.weight).collect::<Vec<_>>(), [0.6, 0.4, 0.0]);
    }

    #[test]
    fn projection_is_idempotent() {
        let mut array = random_layout(12, 3);
        array.lenslets[2].x = -7.0;
        array.lenslets[3].spot = Spot::Isotropic(0.2);
        array.lenslets[4].weight = -0.5;
        let (x, y) = (array.lenslets[5].x, array.lenslets[5].y);
        (array.lenslets[6].x, array.lenslets[6].y) = (x, y);
        let settings = IdealSettings { min_separation_px: 3.0, locked: vec![5], ..settings() };
        let limits = Limits::default();
        let before = array.lenslets[5];
        project(&mut array, &settings, &limits);
        assert_eq!(array.lenslets[5], before);
        assert!((array.lenslets.iter().map(|lenslet| lenslet.weight).sum::<f64>() - 1.0).abs() < 1e-12);
        for (index, one) in array.lenslets.iter().enumerate() {
            assert_eq!(limits.project(*one, 32, 32), *one);
            for other in &array.lenslets[index + 1..] {
                let dark = one.weight == 0.0 || other.weight == 0.0;
                assert!(dark || (one.x - other.x).hypot(one.y - other.y) > 2.99, "{one:?} {other:?}");
            }
        }
        let once = array.clone();
        project(&mut array, &settings, &limits);
        for (one, other) in once.lenslets.iter().zip(&array.lenslets) {
            assert!((one.x - other.x).abs() + (one.y - other.y).abs() + (one.weight - other.weight).abs() < 1e-12);
        }
    }

    #[test]
    fn faint_lenslet_gives_way_to_a_bright_one() {
        let at = |x: f64, weight: f64| Lenslet::round(x, 15.0, 1.0, weight);
        let mut array = LensletArray::new(32, 32, vec![at(15.0, 1.0), at(16.0, 1e-5)]);
        project(&mut array, &IdealSettings { min_separation_px: 4.0, ..settings() }, &Limits::default());
        let [bright, faint] = [array.lenslets[0].x, array.lenslets[1].x];
        assert!((bright - 15.0).abs() < 1e-4 && (faint - bright - 4.0).abs() < 1e-6, "{bright} {faint}");
    }
}
