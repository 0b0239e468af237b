//! Optimizer of all weights of a network, with one update rule per tensor.

use rayon::prelude::*;

use super::adam::{Adam, moving_average};
use super::muon::Muon;
use crate::nn::parameters::{ParameterLayout, Tensor};

/// Update rule of a tensor.
#[derive(Clone, Debug, PartialEq)]
pub enum Rule {
    /// By [`Adam`].
    Adam,
    /// By [`Adam`], with a factor of the rate for every column.
    Columns(Vec<f32>),
    /// By [`Muon`]; for matrices between the first and the last layer.
    Muon,
}

/// The state of one tensor.
#[derive(Clone, Debug)]
enum State {
    Adam(Adam),
    Columns(Adam, Vec<f32>),
    Muon(Muon),
}

/// Steps over which weights are averaged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Averaging {
    /// None: the weights are those of the last step.
    Off,
    /// About this share of all steps so far, the most recent ones.
    LastShare(f32),
    /// Average over about this many last steps. Before the first step the weights are the initial ones.
    Last(usize),
}

impl Averaging {
    /// The last tenth of all steps so far.
    pub const LAST_TENTH: Self = Self::LastShare(0.1);
}

/// Updates all weights of a network, and averages them if configured.
#[derive(Clone, Debug)]
pub struct Optimizer {
    states: Vec<(usize, State)>,
    averaging: Averaging,
    average: Option<Vec<f32>>,
    steps: usize,
}

impl Optimizer {
    /// An optimizer for the weights of a layout; `rule` chooses the update of each tensor. Vectors given to Muon use Adam.
    pub fn new(
        layout: &ParameterLayout,
        weights: &[f32],
        averaging: Averaging,
        rule: impl Fn(&Tensor) -> Rule,
    ) -> Self {
        let states = layout.tensors().iter().map(|tensor| {
            let count = tensor.range.len();
            let state = match rule(tensor) {
                Rule::Muon if tensor.shape.len() > 1 => {
                    // The last axis holds the outputs, all others are inputs.
                    let cols = tensor.shape.last().copied().unwrap_or(1);
                    State::Muon(Muon::new(count / cols, cols))
                }
                Rule::Adam | Rule::Muon => State::Adam(Adam::new(count)),
                Rule::Columns(factors) => State::Columns(Adam::new(count), factors),
            };
            (count, state)
        });
        let average = (averaging != Averaging::Off).then(|| weights.to_vec());
        Self { states: states.collect(), averaging, average, steps: 0 }
    }

    /// One step of `rate` against `scale` times the gradient.
    pub fn step(&mut self, mut weights: &mut [f32], mut gradient: &[f32], scale: f32, rate: f32) {
        let all = &mut *weights;
        let mut tensors = Vec::with_capacity(self.states.len());
        let mut rest = all;
        for (count, state) in &mut self.states {
            let (own, others) = rest.split_at_mut(*count);
            let (by, by_others) = gradient.split_at(*count);
            tensors.push((state, own, by));
            (rest, gradient) = (others, by_others);
        }
        tensors.into_par_iter().with_max_len(1).for_each(|(state, weights, gradient)| match state {
            State::Adam(adam) => adam.step(weights, gradient, scale, rate),
            State::Columns(adam, factors) => {
                let before = weights.to_vec();
                adam.step(weights, gradient, scale, rate);
                let moved = weights.iter_mut().zip(before).zip(factors.iter().cycle());
                for ((weight, before), factor) in moved {
                    *weight = before + factor * (*weight - before);
                }
            }
            State::Muon(muon) => muon.step(weights, gradient, scale, rate),
        });
        weights = &mut *weights;
        if let Some(average) = &mut self.average {
            let over = match self.averaging {
                Averaging::Off => 1.0,
                Averaging::LastShare(share) => share * self.steps as f32 + 1.0,
                Averaging::Last(steps) => steps.max(1) as f32,
            };
            moving_average(average, weights, 1.0 / over);
        }
        self.steps += 1;
    }

    /// The optimizer state without the weights and the number of steps, in the order of the tensors; the average of
    /// the weights comes last.
    pub fn state(&self) -> Vec<f32> {
        let mut state = Vec::new();
        for (_, own) in &self.states {
            match own {
                State::Adam(adam) | State::Columns(adam, _) => {
                    adam.moments().into_iter().for_each(|part| state.extend(part));
                }
                State::Muon(muon) => state.extend(muon.momentum()),
            }
        }
        state.extend(self.average.iter().flatten());
        state
    }

    /// Restores the state of [`Optimizer::state`] after a number of steps, for the same layout.
    ///
    /// # Panics
    /// For a state of another length.
    pub fn restore(&mut self, mut state: &[f32], steps: usize) {
        for (count, own) in &mut self.states {
            match own {
                State::Adam(adam) | State::Columns(adam, _) => {
                    let (parts, rest) = state.split_at(2 * *count);
                    adam.restore(parts, steps);
                    state = rest;
                }
                State::Muon(muon) => {
                    let (momentum, rest) = state.split_at(*count);
                    muon.restore(momentum);
                    state = rest;
                }
            }
        }
        if let Some(average) = &mut self.average {
            average.copy_from_slice(state);
        }
        self.steps = steps;
    }

    /// Steps since the start of the optimizer.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// The averaged weights, or the given ones without averaging.
    pub fn result<'a>(&'a self, weights: &'a [f32]) -> &'a [f32] {
        self.average.as_deref().unwrap_or(weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::parameters::Initial;

    #[test]
    fn weights_are_averaged_over_the_chosen_steps() {
        let mut layout = ParameterLayout::default();
        layout.add("one", &[1], Initial::Zeros);
        let result = |averaging: Averaging| {
            let mut weights = vec![0.0];
            let mut optimizer = Optimizer::new(&layout, &weights, averaging, |_| Rule::Adam);
            // With a constant gradient, Adam moves one rate down in every step.
            for _ in 0..200 {
                optimizer.step(&mut weights, &[1.0], 1.0, 0.01);
            }
            let averaged = optimizer.result(&weights)[0];
            averaged - weights[0]
        };
        assert_eq!(result(Averaging::Off), 0.0);
        assert!((result(Averaging::Last(1))).abs() < 1e-6);
        let (tenth, last) = (result(Averaging::LAST_TENTH), result(Averaging::Last(30)));
        assert!((0.15..0.2).contains(&tenth), "{tenth}");
        assert!((0.28..0.3).contains(&last), "{last}");
        // For steps of equal length, the average over the last half of the steps lies a third of the way back.
        let half = result(Averaging::LastShare(0.5));
        assert!((0.62..0.68).contains(&half), "{half}");
    }
}
