//! How a mask moves: Adam for every parameter of every lenslet, and the way back to what can be made.

use serde::{Deserialize, Serialize};

use super::settings::IdealSettings;
use crate::optics::{LensletArray, LensletGradient, Limits, Spot};

/// Parameters of a lenslet: x, y, xx, xy, yy, weight. The variance of a round spot stands in xx.
pub(super) const PARAMETERS: usize = 6;
/// Decays of Adam (Kingma and Ba 2015).
const DECAYS: (f64, f64) = (0.9, 0.999);
const EPSILON: f64 = 1e-12;
/// Sweeps over all pairs that are too close.
const SWEEPS: usize = 20;

/// Means of gradients and of their squares over past steps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Momentum {
    first: Vec<[f64; PARAMETERS]>,
    second: Vec<[f64; PARAMETERS]>,
    steps: i32,
    /// Steps after which the means of each lenslet began.
    #[serde(default)]
    since: Vec<i32>,
}

impl Momentum {
    /// Takes the gradient of a step into the means, for lenslets that may change.
    pub fn learn(&mut self, gradient: &[[f64; PARAMETERS]], free: &[usize]) {
        let (first_decay, second_decay) = DECAYS;
        self.first.resize(gradient.len(), [0.0; PARAMETERS]);
        self.second.resize(gradient.len(), [0.0; PARAMETERS]);
        self.since.resize(gradient.len(), 0);
        self.steps = self.steps.saturating_add(1);
        for &index in free {
            for (parameter, &slope) in gradient[index].iter().enumerate() {
                let first = &mut self.first[index][parameter];
                let second = &mut self.second[index][parameter];
                *first += (1.0 - first_decay) * (slope - *first);
                *second += (1.0 - second_decay) * (slope * slope - *second);
            }
        }
    }

    /// Moves the mask by `rate` times the rates of the settings along what it has learned, and projects it back. Dark lenslets
    /// that were `pruned` stay so.
    pub fn climb(
        &self,
        array: &mut LensletArray,
        (settings, limits): (&IdealSettings, &Limits),
        pruned: &[usize],
        rate: f64,
    ) {
        for index in settings.free_lenslets(array.lenslets.len(), pruned) {
            let lenslet = &mut array.lenslets[index];
            let moves = self.moves(index);
            if settings.free.positions {
                lenslet.x += rate * settings.rates.position * moves[0];
                lenslet.y += rate * settings.rates.position * moves[1];
            }
            if settings.free.widths {
                let step = rate * settings.rates.variance;
                lenslet.spot = match lenslet.spot {
                    Spot::Isotropic(sigma) => {
                        let least = limits.min_sigma_px.powi(2).min(sigma * sigma);
                        Spot::Isotropic((sigma * sigma + step * moves[2]).max(least).sqrt())
                    }
                    Spot::Anisotropic { xx, xy, yy } => Spot::Anisotropic {
                        xx: xx + step * moves[2],
                        xy: xy + step * moves[3],
                        yy: yy + step * moves[4],
                    },
                };
            }
            if settings.free.weights {
                let step = settings.rates.weight.max(settings.rates.relative_weight * lenslet.weight);
                lenslet.weight += rate * step * moves[5];
            }
        }
        project(array, settings, limits);
    }

    /// Begins anew for all lenslets.
    pub fn forget_all(&mut self) {
        for index in 0..self.since.len() {
            self.forget(index);
        }
    }

    /// Begins anew for a lenslet that has been put elsewhere: its steps so far tell nothing of those from there.
    pub fn forget(&mut self, index: usize) {
        if index < self.since.len() {
            (self.first[index], self.second[index]) = ([0.0; PARAMETERS], [0.0; PARAMETERS]);
            self.since[index] = self.steps;
        }
    }

    /// The mean gradient of late by the centre of each lenslet (x, y), bits per pixel and pixel; zero before there is one.
    pub fn pulls(&self) -> impl Iterator<Item = (f64, f64)> {
        self.first.iter().zip(&self.since).map(|(first, since)| {
            let steps = self.steps - since;
            let bias = if steps == 0 { 1.0 } else { 1.0 - DECAYS.0.powi(steps) };
            (first[0] / bias, first[1] / bias)
        })
    }

    /// The move of each parameter of one lenslet, of order one; none before there is a gradient.
    fn moves(&self, index: usize) -> [f64; PARAMETERS] {
        let steps = self.since.get(index).map_or(0, |since| self.steps - since);
        if steps == 0 {
            return [0.0; PARAMETERS];
        }
        let (first_decay, second_decay) = DECAYS;
        let bias = (1.0 - first_decay.powi(steps), 1.0 - second_decay.powi(steps));
        std::array::from_fn(|parameter| {
            let (first, second) = (self.first[index][parameter], self.second[index][parameter]);
            first / bias.0 / ((second / bias.1).sqrt() + EPSILON)
        })
    }
}

/// The slopes of a mask by the parameters that move.
pub(super) fn by_parameters(array: &LensletArray, gradient: &[LensletGradient]) -> Vec<[f64; PARAMETERS]> {
    let by_lenslet = array.lenslets.iter().zip(gradient).map(|(lenslet, by)| {
        let [xx, xy, yy] = match lenslet.spot {
            Spot::Isotropic(sigma) => [by.sigma / (2.0 * sigma), 0.0, 0.0],
            Spot::Anisotropic { .. } => by.covariance,
        };
        [by.x, by.y, xx, xy, yy, by.weight]
    });
    by_lenslet.collect()
}

/// The nearest mask that can be made: limits of the editor, least distance, weights that sum to 1. Locked lenslets stay.
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
            // Locked lenslets that hold all the light leave none.
            let scale = (1.0 - kept).max(0.0) / free;
            for (index, lenslet) in array.lenslets.iter_mut().enumerate() {
                if !locked(index) {
                    lenslet.weight *= scale;
                }
            }
        }
    }
}

/// Pushes bright lenslets apart until none is closer to another than it may be, as far as the limits leave room.
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
                // Lenslets on one point part along a direction of their own.
                let angle = (one * count + other) as f64;
                let (dx, dy) = if distance > 1e-9 {
                    ((b.x - a.x) / distance, (b.y - a.y) / distance)
                } else {
                    (angle.cos(), angle.sin())
                };
                let free = [one, other].map(|index| !settings.locked.contains(&index));
                let shares = match free {
                    // The fainter one gives way: one that has just got some light does not push a bright one off.
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
    use super::super::settings::{Free, Objective, Preset};
    use super::*;
    use crate::optics::{Lenslet, heuristic_layout, random_layout};

    fn settings() -> IdealSettings {
        IdealSettings::new(Preset::Default, Objective::Density, 1)
    }

    /// One step, within the limits of the editor.
    fn step(
        array: &mut LensletArray,
        momentum: &mut Momentum,
        gradient: &[LensletGradient],
        (settings, pruned): (&IdealSettings, &[usize]),
    ) {
        let free = settings.free_lenslets(array.lenslets.len(), pruned);
        momentum.learn(&by_parameters(array, gradient), &free);
        momentum.climb(array, (settings, &Limits::default()), pruned, 1.0);
    }

    #[test]
    fn a_gradient_that_stays_is_the_pull() {
        let mut momentum = Momentum::default();
        assert_eq!(momentum.pulls().count(), 0);
        let gradient = [[0.5, -2.0, 0.0, 0.0, 0.0, 1.0]; 2];
        for _ in 0..3 {
            momentum.learn(&gradient, &[1]);
        }
        let pulls: Vec<(f64, f64)> = momentum.pulls().collect();
        assert_eq!(pulls[0], (0.0, 0.0), "a lenslet that stays");
        assert!((pulls[1].0 - 0.5).abs() < 1e-12 && (pulls[1].1 + 2.0).abs() < 1e-12, "{pulls:?}");
        momentum.forget_all();
        assert!(momentum.pulls().all(|pull| pull == (0.0, 0.0)));
    }

    #[test]
    fn locked_lenslets_that_hold_all_the_light_leave_none() {
        let mut array = heuristic_layout(3);
        for (lenslet, weight) in array.lenslets.iter_mut().zip([0.6, 0.4, 0.1]) {
            lenslet.weight = weight;
        }
        project(&mut array, &IdealSettings { locked: vec![0, 1], ..settings() }, &Limits::default());
        assert_eq!(array.lenslets.iter().map(|lenslet| lenslet.weight).collect::<Vec<_>>(), [0.6, 0.4, 0.0]);
    }

    #[test]
    fn a_projected_mask_is_projected_onto_itself() {
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
    fn a_faint_lenslet_gives_way_to_a_bright_one() {
        let at = |x: f64, weight: f64| Lenslet::round(x, 15.0, 1.0, weight);
        let mut array = LensletArray { rows: 32, cols: 32, lenslets: vec![at(15.0, 1.0), at(16.0, 1e-5)] };
        project(&mut array, &IdealSettings { min_separation_px: 4.0, ..settings() }, &Limits::default());
        let [bright, faint] = [array.lenslets[0].x, array.lenslets[1].x];
        assert!((bright - 15.0).abs() < 1e-4 && (faint - bright - 4.0).abs() < 1e-6, "{bright} {faint}");
    }

    #[test]
    fn what_is_not_free_stays_to_the_bit() {
        let start = heuristic_layout(6);
        let gradient: Vec<LensletGradient> = (0..6)
            .map(|i| {
                let slope = f64::from(i) - 2.7;
                LensletGradient { x: slope, y: -slope, sigma: slope, covariance: [0.0; 3], weight: slope }
            })
            .collect();
        let climbed = |settings: &IdealSettings, pruned: &[usize]| {
            let (mut array, mut momentum) = (start.clone(), Momentum::default());
            for _ in 0..3 {
                step(&mut array, &mut momentum, &gradient, (settings, pruned));
            }
            array
        };
        let all = climbed(&settings(), &[]);
        assert!(all.lenslets.iter().zip(&start.lenslets).all(|(after, before)| after.x != before.x));
        // Adam's steps have the size of the rate, whatever the gradient.
        let moved = all.lenslets[3].x - start.lenslets[3].x;
        assert!((moved - 3.0 * settings().rates.position).abs() < 1e-9, "{moved}");
        let free = Free { positions: true, widths: false, weights: false };
        let fixed = climbed(&IdealSettings { free, ..settings() }, &[]);
        for (after, before) in fixed.lenslets.iter().zip(&start.lenslets) {
            assert_eq!((after.spot, after.weight), (before.spot, before.weight));
        }
        let locked = climbed(&IdealSettings { locked: vec![1], ..settings() }, &[4]);
        assert_eq!(locked.lenslets[1], start.lenslets[1]);
        assert_eq!((locked.lenslets[4].x, locked.lenslets[4].y), (start.lenslets[4].x, start.lenslets[4].y));
    }

    #[test]
    fn a_lenslet_that_was_put_elsewhere_moves_as_in_the_first_step() {
        let (mut array, mut momentum) = (heuristic_layout(2), Momentum::default());
        let by = |x| LensletGradient { x, y: 0.0, sigma: 0.0, covariance: [0.0; 3], weight: 0.0 };
        let climb = |array: &mut LensletArray, momentum: &mut Momentum, slope: f64| {
            let before = array.lenslets[0].x;
            step(array, momentum, &[by(slope), by(slope)], (&settings(), &[]));
            (array.lenslets[0].x - before) / settings().rates.position
        };
        for _ in 0..50 {
            climb(&mut array, &mut momentum, 0.0);
        }
        momentum.forget(0);
        assert!((climb(&mut array, &mut momentum, 3.0) - 1.0).abs() < 1e-6);
        let mut late = momentum.clone();
        late.forget_all();
        assert!((climb(&mut array.clone(), &mut late, -2.0) + 1.0).abs() < 1e-6);
        assert!((climb(&mut array, &mut momentum, -2.0) + 1.0).abs() > 0.1, "the first step counts");
    }

    #[test]
    fn bright_lenslets_move_their_weights_by_a_share_of_them() {
        let by = |weight| LensletGradient { x: 0.0, y: 0.0, sigma: 0.0, covariance: [0.0; 3], weight };
        let gap = |count: usize| {
            let (mut array, mut momentum) = (heuristic_layout(count), Momentum::default());
            let gradient: Vec<_> = (0..count).map(|index| by(if index < count / 2 { 3.0 } else { -1.0 })).collect();
            step(&mut array, &mut momentum, &gradient, (&settings(), &[]));
            array.lenslets[0].weight - array.lenslets[count - 1].weight
        };
        let rates = settings().rates;
        // Of two lenslets each has half of the light; of as many as fit, each has so little that the least step counts.
        assert!((gap(2) - rates.relative_weight).abs() < 1e-9, "{}", gap(2));
        assert!(2.0 * rates.weight < gap(8) && gap(8) < 0.3 * gap(2), "{}", gap(8));
    }

    #[test]
    fn a_width_below_the_floor_is_not_pulled_down_further() {
        let mut array = heuristic_layout(2);
        array.lenslets[0].spot = Spot::Anisotropic { xx: 1.0, xy: 0.0, yy: 0.7 };
        let by = LensletGradient { x: 0.0, y: 0.0, sigma: -1.0, covariance: [-1.0, 0.3, -1.0], weight: 0.0 };
        let (mut momentum, limits) = (Momentum::default(), Limits::default());
        for _ in 0..400 {
            step(&mut array, &mut momentum, &[by, by], (&settings(), &[]));
        }
        for lenslet in &array.lenslets {
            assert!((lenslet.spot.principal_sigmas().0 - limits.min_sigma_px).abs() < 1e-6, "{lenslet:?}");
        }
        array.check().unwrap();
    }
}
