//! Adam (Kingma and Ba 2015) on the parameters of the lenslets.

use serde::{Deserialize, Serialize};

use super::projection::project;
use super::settings::IdealSettings;
use crate::optics::{LensletArray, LensletGradient, Limits, Spot};

/// Parameters of a lenslet: x, y, xx, xy, yy, weight. The variance of a round spot stands in xx.
pub(super) const PARAMETERS: usize = 6;
/// Gradient by the [parameters](PARAMETERS) of one lenslet.
pub(super) type ParameterGradient = [f64; PARAMETERS];
/// Decay rates of the two moments.
const DECAYS: (f64, f64) = (0.9, 0.999);
const EPSILON: f64 = 1e-12;

/// First and second moments of the gradient of every lenslet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Adam {
    first: Vec<ParameterGradient>,
    second: Vec<ParameterGradient>,
    steps: i32,
    /// Steps after which the moments of each lenslet were reset.
    #[serde(default)]
    since: Vec<i32>,
}

impl Adam {
    /// Updates the moments by the gradient of a step, for lenslets that may change.
    pub fn update(&mut self, gradient: &[ParameterGradient], free: &[usize]) {
        let (first_decay, second_decay) = DECAYS;
        self.first.resize(gradient.len(), [0.0; PARAMETERS]);
        self.second.resize(gradient.len(), [0.0; PARAMETERS]);
        self.since.resize(gradient.len(), 0);
        self.steps = self.steps.saturating_add(1);
        for &index in free {
            for (parameter, &derivative) in gradient[index].iter().enumerate() {
                let first = &mut self.first[index][parameter];
                let second = &mut self.second[index][parameter];
                *first += (1.0 - first_decay) * (derivative - *first);
                *second += (1.0 - second_decay) * (derivative * derivative - *second);
            }
        }
    }

    /// Moves the mask by `scale` times the rates of the settings, and projects it. Lenslets that were `pruned` stay dark.
    pub fn apply(
        &self,
        array: &mut LensletArray,
        settings: &IdealSettings,
        limits: &Limits,
        pruned: &[usize],
        scale: f64,
    ) {
        for index in settings.free_lenslets(array.lenslets.len(), pruned) {
            let lenslet = &mut array.lenslets[index];
            let direction = self.direction(index);
            if settings.free.positions {
                lenslet.x += scale * settings.rates.position * direction[0];
                lenslet.y += scale * settings.rates.position * direction[1];
            }
            if settings.free.widths {
                let step = scale * settings.rates.variance;
                lenslet.spot = match lenslet.spot {
                    Spot::Isotropic(sigma) => {
                        let least = limits.min_sigma_px.powi(2).min(sigma * sigma);
                        Spot::Isotropic((sigma * sigma + step * direction[2]).max(least).sqrt())
                    }
                    Spot::Anisotropic { xx, xy, yy } => Spot::Anisotropic {
                        xx: xx + step * direction[2],
                        xy: xy + step * direction[3],
                        yy: yy + step * direction[4],
                    },
                };
            }
            if settings.free.weights {
                let step = settings.rates.weight.max(settings.rates.relative_weight * lenslet.weight);
                lenslet.weight += scale * step * direction[5];
            }
        }
        project(array, settings, limits);
    }

    /// Resets the moments of all lenslets.
    pub fn reset_all(&mut self) {
        for index in 0..self.since.len() {
            self.reset(index);
        }
    }

    /// Resets the moments of one lenslet, after a relocation.
    pub fn reset(&mut self, index: usize) {
        if index < self.since.len() {
            (self.first[index], self.second[index]) = ([0.0; PARAMETERS], [0.0; PARAMETERS]);
            self.since[index] = self.steps;
        }
    }

    /// First moment by the centre (x, y) of each lenslet, bits per pixel and pixel, corrected for its bias; zero before the first
    /// gradient.
    pub fn position_gradients(&self) -> impl Iterator<Item = (f64, f64)> {
        self.first.iter().zip(&self.since).map(|(first, since)| {
            let steps = self.steps - since;
            let bias = if steps == 0 { 1.0 } else { 1.0 - DECAYS.0.powi(steps) };
            (first[0] / bias, first[1] / bias)
        })
    }

    /// Step of each parameter of one lenslet, of order 1; zero before the first gradient.
    fn direction(&self, index: usize) -> ParameterGradient {
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

/// The gradient of a mask by the [parameters](PARAMETERS) of its lenslets.
pub(super) fn by_parameters(array: &LensletArray, gradient: &[LensletGradient]) -> Vec<ParameterGradient> {
    let by_lenslet = array.lenslets.iter().zip(gradient).map(|(lenslet, by)| {
        let [xx, xy, yy] = match lenslet.spot {
            Spot::Isotropic(sigma) => [by.sigma / (2.0 * sigma), 0.0, 0.0],
            Spot::Anisotropic { .. } => by.covariance,
        };
        [by.x, by.y, xx, xy, yy, by.weight]
    });
    by_lenslet.collect()
}

#[cfg(test)]
mod tests {
    use super::super::settings::{Free, Objective, Preset};
    use super::*;
    use crate::optics::heuristic_layout;

    fn settings() -> IdealSettings {
        IdealSettings::new(Preset::Default, Objective::Density, 1)
    }

    /// One step, within the limits of the editor.
    fn step(
        array: &mut LensletArray,
        adam: &mut Adam,
        gradient: &[LensletGradient],
        settings: &IdealSettings,
        pruned: &[usize],
    ) {
        let free = settings.free_lenslets(array.lenslets.len(), pruned);
        adam.update(&by_parameters(array, gradient), &free);
        adam.apply(array, settings, &Limits::default(), pruned, 1.0);
    }

    #[test]
    fn constant_gradient_is_the_position_gradient() {
        let mut adam = Adam::default();
        assert_eq!(adam.position_gradients().count(), 0);
        let gradient = [[0.5, -2.0, 0.0, 0.0, 0.0, 1.0]; 2];
        for _ in 0..3 {
            adam.update(&gradient, &[1]);
        }
        let gradients: Vec<(f64, f64)> = adam.position_gradients().collect();
        assert_eq!(gradients[0], (0.0, 0.0), "a lenslet that is not free");
        assert!((gradients[1].0 - 0.5).abs() < 1e-12 && (gradients[1].1 + 2.0).abs() < 1e-12, "{gradients:?}");
        adam.reset_all();
        assert!(adam.position_gradients().all(|gradient| gradient == (0.0, 0.0)));
    }

    #[test]
    fn fixed_parameters_stay_to_the_bit() {
        let start = heuristic_layout(6);
        let gradient: Vec<LensletGradient> = (0..6)
            .map(|i| {
                let derivative = f64::from(i) - 2.7;
                LensletGradient {
                    x: derivative,
                    y: -derivative,
                    sigma: derivative,
                    covariance: [0.0; 3],
                    weight: derivative,
                }
            })
            .collect();
        let moved_by = |settings: &IdealSettings, pruned: &[usize]| {
            let (mut array, mut adam) = (start.clone(), Adam::default());
            for _ in 0..3 {
                step(&mut array, &mut adam, &gradient, settings, pruned);
            }
            array
        };
        let all = moved_by(&settings(), &[]);
        assert!(all.lenslets.iter().zip(&start.lenslets).all(|(after, before)| after.x != before.x));
        // Adam's steps have the size of the rate, whatever the gradient.
        let moved = all.lenslets[3].x - start.lenslets[3].x;
        assert!((moved - 3.0 * settings().rates.position).abs() < 1e-9, "{moved}");
        let free = Free { positions: true, widths: false, weights: false };
        let fixed = moved_by(&IdealSettings { free, ..settings() }, &[]);
        for (after, before) in fixed.lenslets.iter().zip(&start.lenslets) {
            assert_eq!((after.spot, after.weight), (before.spot, before.weight));
        }
        let locked = moved_by(&IdealSettings { locked: vec![1], ..settings() }, &[4]);
        assert_eq!(locked.lenslets[1], start.lenslets[1]);
        assert_eq!((locked.lenslets[4].x, locked.lenslets[4].y), (start.lenslets[4].x, start.lenslets[4].y));
    }

    #[test]
    fn reset_lenslet_moves_as_in_the_first_step() {
        let (mut array, mut adam) = (heuristic_layout(2), Adam::default());
        let by = |x| LensletGradient { x, y: 0.0, sigma: 0.0, covariance: [0.0; 3], weight: 0.0 };
        let advance = |array: &mut LensletArray, adam: &mut Adam, derivative: f64| {
            let before = array.lenslets[0].x;
            step(array, adam, &[by(derivative), by(derivative)], &settings(), &[]);
            (array.lenslets[0].x - before) / settings().rates.position
        };
        for _ in 0..50 {
            advance(&mut array, &mut adam, 0.0);
        }
        adam.reset(0);
        assert!((advance(&mut array, &mut adam, 3.0) - 1.0).abs() < 1e-6);
        let mut late = adam.clone();
        late.reset_all();
        assert!((advance(&mut array.clone(), &mut late, -2.0) + 1.0).abs() < 1e-6);
        assert!((advance(&mut array, &mut adam, -2.0) + 1.0).abs() > 0.1, "the first step counts");
    }

    #[test]
    fn bright_lenslets_change_their_weights_by_a_share_of_them() {
        let by = |weight| LensletGradient { x: 0.0, y: 0.0, sigma: 0.0, covariance: [0.0; 3], weight };
        let gap = |count: usize| {
            let (mut array, mut adam) = (heuristic_layout(count), Adam::default());
            let gradient: Vec<_> = (0..count).map(|index| by(if index < count / 2 { 3.0 } else { -1.0 })).collect();
            step(&mut array, &mut adam, &gradient, &settings(), &[]);
            array.lenslets[0].weight - array.lenslets[count - 1].weight
        };
        let rates = settings().rates;
        // Of two lenslets each has half of the light; of as many as fit, each has so little that the least step counts.
        assert!((gap(2) - rates.relative_weight).abs() < 1e-9, "{}", gap(2));
        assert!(2.0 * rates.weight < gap(8) && gap(8) < 0.3 * gap(2), "{}", gap(8));
    }

    #[test]
    fn width_at_the_limit_does_not_shrink_further() {
        let mut array = heuristic_layout(2);
        array.lenslets[0].spot = Spot::Anisotropic { xx: 1.0, xy: 0.0, yy: 0.7 };
        let by = LensletGradient { x: 0.0, y: 0.0, sigma: -1.0, covariance: [-1.0, 0.3, -1.0], weight: 0.0 };
        let (mut adam, limits) = (Adam::default(), Limits::default());
        for _ in 0..400 {
            step(&mut array, &mut adam, &[by, by], &settings(), &[]);
        }
        for lenslet in &array.lenslets {
            assert!((lenslet.spot.principal_sigmas().0 - limits.min_sigma_px).abs() < 1e-6, "{lenslet:?}");
        }
        array.check().unwrap();
    }
}
