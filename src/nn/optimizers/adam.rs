//! Adam, and averages of weights over steps.

use crate::nn::kernels::arithmetic::vectorised;
use crate::nn::kernels::elementwise::{Elementwise, each};

/// Decay of the mean of gradients.
const FIRST_DECAY: f32 = 0.9;
/// Decay of the mean of squared gradients.
const SECOND_DECAY: f32 = 0.999;
/// Keeps steps finite where all gradients were 0.
const EPSILON: f32 = 1e-8;

/// Adam (Kingma and Ba 2015) with decays 0.9 and 0.999 and epsilon 1e-8, for one range of weights.
#[derive(Clone, Debug)]
pub struct Adam {
    first: Vec<f32>,
    second: Vec<f32>,
    steps: i32,
}

impl Adam {
    /// State for `count` weights, before the first step.
    pub fn new(count: usize) -> Self {
        Self { first: vec![0.0; count], second: vec![0.0; count], steps: 0 }
    }

    /// Means of gradients and of their squares.
    pub fn moments(&self) -> [&[f32]; 2] {
        [&self.first, &self.second]
    }

    /// Restores the moments, one after the other, after a number of steps.
    pub fn restore(&mut self, moments: &[f32], steps: usize) {
        let (first, second) = moments.split_at(self.first.len());
        self.first.copy_from_slice(first);
        self.second.copy_from_slice(second);
        self.steps = i32::try_from(steps).unwrap_or(i32::MAX);
    }

    /// Takes one step of `rate` (units of the weights) against `scale` times `gradient`.
    pub fn step(&mut self, weights: &mut [f32], gradient: &[f32], scale: f32, rate: f32) {
        self.steps = self.steps.saturating_add(1);
        let first_bias = 1.0 / (1.0 - FIRST_DECAY.powi(self.steps));
        let second_bias = 1.0 / (1.0 - SECOND_DECAY.powi(self.steps));
        let moved = Moved { scale, first_bias, second_bias, rate };
        step(moved, gradient, &mut self.first, &mut self.second, weights);
    }
}

/// Updates both means and a weight from its gradient.
struct Moved {
    scale: f32,
    first_bias: f32,
    second_bias: f32,
    rate: f32,
}

impl Elementwise<1, 3> for Moved {
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "loops around it become vector code only when it is inlined")]
    fn apply(&self, [gradient]: [f32; 1], [first, second, weight]: [f32; 3]) -> [f32; 3] {
        let gradient = gradient * self.scale;
        let first = FIRST_DECAY * first + (1.0 - FIRST_DECAY) * gradient;
        let second = SECOND_DECAY * second + (1.0 - SECOND_DECAY) * gradient * gradient;
        let step = self.rate * (first * self.first_bias) / ((second * self.second_bias).sqrt() + EPSILON);
        [first, second, weight - step]
    }
}

vectorised! {
    fn step<'a>(
        moved: Moved,
        gradient: &'a [f32],
        first: &'a mut [f32],
        second: &'a mut [f32],
        weights: &'a mut [f32],
    ) {
        each(&moved, [gradient], [first, second, weights]);
    }
}

vectorised! {
    /// `average += share (weights - average)`.
    pub fn moving_average<'a>(average: &'a mut [f32], weights: &'a [f32], share: f32) {
        for (average, weight) in average.iter_mut().zip(weights) {
            *average += share * (weight - *average);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_those_of_the_published_algorithm() {
        let (mut weight, mut first, mut second) = (0.3_f64, 0.0, 0.0);
        let mut adam = Adam::new(1);
        let mut found = [0.3_f32];
        for step in 1..=20 {
            let gradient = 2.0 * f64::from(found[0]) - 0.1 * f64::from(step);
            adam.step(&mut found, &[gradient as f32 * 0.5], 2.0, 0.01);
            first = 0.9 * first + 0.1 * gradient;
            second = 0.999 * second + 0.001 * gradient * gradient;
            let corrected = (first / (1.0 - 0.9_f64.powi(step)), second / (1.0 - 0.999_f64.powi(step)));
            weight -= 0.01 * corrected.0 / (corrected.1.sqrt() + 1e-8);
            assert!((weight - f64::from(found[0])).abs() < 1e-5, "{step}: {weight} {}", found[0]);
        }
    }

    #[test]
    fn an_average_of_all_steps_is_their_mean() {
        let mut average = [9.0_f32, 9.0];
        for (step, weights) in [[1.0, 2.0], [3.0, 2.0], [5.0, 8.0]].iter().enumerate() {
            moving_average(&mut average, weights, 1.0 / (step as f32 + 1.0));
        }
        assert!((average[0] - 3.0).abs() < 1e-6 && (average[1] - 4.0).abs() < 1e-6);
    }
}
