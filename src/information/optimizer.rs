//! Which weights of a network move by which rule, and how fast.

use rayon::prelude::*;

use crate::network::{Adam, Muon, ParameterLayout, moving_average};

/// Share of the schedule in which the rate rises, and the share of the rate that is left at its end.
const WARM_UP: f64 = 0.03;
const FINAL_RATE: f64 = 0.02;

/// Factor of the rate when a share `done` of the schedule is over: a linear rise, then a cosine.
pub(super) fn schedule(done: f64) -> f64 {
    let rise = (done / WARM_UP).min(1.0);
    let fall = FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + (std::f64::consts::PI * done).cos());
    rise.max(FINAL_RATE) * fall
}

/// The rule of one tensor.
#[derive(Clone, Debug)]
enum Rule {
    Adam(Adam),
    /// Adam with a rate for every column.
    Columns(Adam),
    Muon(Muon),
}

/// Moves all weights of a network, and averages them where that is wanted.
#[derive(Clone, Debug)]
pub(super) struct Optimizer {
    rules: Vec<(usize, Rule)>,
    /// Factors of the rate for the columns of the last layer.
    head_rates: Vec<f32>,
    /// Average of the weights over the last steps.
    average: Option<Vec<f32>>,
    steps: usize,
}

/// Share of all steps so far that the average reaches back over.
const AVERAGED_SHARE: f32 = 0.1;

impl Optimizer {
    /// Adam for all tensors, or Muon for the matrices between the first and the last layer, whose names begin with
    /// "block" or "out".
    ///
    /// `head_rates` are factors of the rate for the columns of the last layer; none are as many ones.
    pub fn new(layout: &ParameterLayout, weights: &[f32], muon: bool, average: bool, head_rates: Vec<f32>) -> Self {
        let rules = layout.tensors().iter().map(|tensor| {
            let count = tensor.range.len();
            let hidden = tensor.name.starts_with("block") || tensor.name.starts_with("out");
            let rule = if !head_rates.is_empty() && tensor.name.starts_with("heads") {
                Rule::Columns(Adam::new(count))
            } else if muon && hidden && tensor.shape.len() > 1 {
                // The last axis holds the outputs, all others are inputs.
                let cols = tensor.shape.last().copied().unwrap_or(1);
                Rule::Muon(Muon::new(count / cols, cols))
            } else {
                Rule::Adam(Adam::new(count))
            };
            (count, rule)
        });
        let rules = rules.collect();
        Self { rules, head_rates, average: average.then(|| weights.to_vec()), steps: 0 }
    }

    /// One step of `rate` against `scale` times the gradient.
    pub fn step(&mut self, mut weights: &mut [f32], mut gradient: &[f32], scale: f32, rate: f32) {
        let all = &mut *weights;
        let mut tensors = Vec::with_capacity(self.rules.len());
        let mut rest = all;
        for (count, rule) in &mut self.rules {
            let (own, others) = rest.split_at_mut(*count);
            let (by, by_others) = gradient.split_at(*count);
            tensors.push((rule, own, by));
            (rest, gradient) = (others, by_others);
        }
        tensors.into_par_iter().with_max_len(1).for_each(|(rule, weights, gradient)| match rule {
            Rule::Adam(adam) => adam.step(weights, gradient, scale, rate),
            Rule::Columns(adam) => {
                let before = weights.to_vec();
                adam.step(weights, gradient, scale, rate);
                let factors = self.head_rates.iter().cycle();
                for ((weight, before), factor) in weights.iter_mut().zip(before).zip(factors) {
                    *weight = before + factor * (*weight - before);
                }
            }
            Rule::Muon(muon) => muon.step(weights, gradient, scale, rate),
        });
        weights = &mut *weights;
        if let Some(average) = &mut self.average {
            moving_average(average, weights, 1.0 / (AVERAGED_SHARE * self.steps as f32 + 1.0));
        }
        self.steps += 1;
    }

    /// The averaged weights, or those given where there is no average.
    pub fn result<'a>(&'a self, weights: &'a [f32]) -> &'a [f32] {
        self.average.as_deref().unwrap_or(weights)
    }
}
