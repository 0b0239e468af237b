//! Names, shapes and places of the weights of a network in one array, and their initial values.

use std::ops::Range;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Standard deviation of a standard normal cut off at two.
const CUT_DEVIATION: f32 = 0.879_625_7;

/// Distribution of a tensor before training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Initial {
    /// Zeros.
    Zeros,
    /// Normal of variance 1 / `inputs`, cut off at two standard deviations (`LeCun` et al. 1998).
    LecunNormal {
        /// Numbers summed into one output, those behind a mask included.
        inputs: usize,
    },
    /// All the same.
    Constant(f32),
    /// Normal around 0.
    Normal {
        /// Standard deviation.
        deviation: f32,
    },
    /// Uniform between two values.
    Uniform {
        /// Smallest value.
        low: f32,
        /// Largest value.
        high: f32,
    },
}

/// One named array of weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Its name, unique in the network.
    pub name: String,
    /// Its shape; the last axis runs fastest.
    pub shape: Vec<usize>,
    /// Its place among all weights.
    pub range: Range<usize>,
    /// Its distribution before training: parts of the last axis, in order, with their lengths.
    pub initial: Vec<(usize, Initial)>,
}

/// The tensors of a network in the order of one array.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParameterLayout {
    tensors: Vec<Tensor>,
}

impl ParameterLayout {
    /// Appends a tensor and returns its place.
    pub fn add(&mut self, name: impl Into<String>, shape: &[usize], initial: Initial) -> Range<usize> {
        let last = shape.last().copied().unwrap_or(1);
        self.add_in_parts(name, shape, vec![(last, initial)])
    }

    /// Appends a tensor whose last axis is drawn in parts of the given lengths, and returns its place.
    pub fn add_in_parts(
        &mut self,
        name: impl Into<String>,
        shape: &[usize],
        initial: Vec<(usize, Initial)>,
    ) -> Range<usize> {
        let start = self.count();
        let range = start..start + shape.iter().product::<usize>();
        self.tensors.push(Tensor { name: name.into(), shape: shape.to_vec(), range: range.clone(), initial });
        range
    }

    /// Number of weights.
    pub fn count(&self) -> usize {
        self.tensors.last().map_or(0, |tensor| tensor.range.end)
    }

    /// All tensors, in order.
    pub fn tensors(&self) -> &[Tensor] {
        &self.tensors
    }

    /// Draws initial weights; each tensor has its own random stream.
    pub fn draw(&self, seed: u64) -> Vec<f32> {
        let mut weights = Vec::with_capacity(self.count());
        for (index, tensor) in self.tensors.iter().enumerate() {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(index as u64);
            let last = tensor.shape.last().copied().unwrap_or(1).max(1);
            for _ in 0..tensor.range.len() / last {
                for &(length, initial) in &tensor.initial {
                    weights.extend((0..length).map(|_| initial.draw(&mut random)));
                }
            }
        }
        weights
    }
}

impl Initial {
    fn draw(self, random: &mut ChaCha8Rng) -> f32 {
        match self {
            Self::Zeros => 0.0,
            Self::Constant(value) => value,
            Self::Normal { deviation } => {
                let normal: f32 = StandardNormal.sample(random);
                deviation * normal
            }
            Self::Uniform { low, high } => low + (high - low) * random.random::<f32>(),
            Self::LecunNormal { inputs } => loop {
                let normal: f32 = StandardNormal.sample(random);
                if normal.abs() <= 2.0 {
                    break normal / CUT_DEVIATION / (inputs as f32).sqrt();
                }
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_are_contiguous() {
        let mut layout = ParameterLayout::default();
        assert_eq!(layout.add("a", &[3, 4], Initial::Zeros), 0..12);
        assert_eq!(layout.add("b", &[5], Initial::Zeros), 12..17);
        assert_eq!((layout.count(), layout.tensors().len()), (17, 2));
        assert_eq!(layout.draw(1), [0.0; 17]);
    }

    #[test]
    fn initial_weights_have_their_moments_and_depend_on_the_seed() {
        let mut layout = ParameterLayout::default();
        layout.add("kernel", &[100, 100], Initial::LecunNormal { inputs: 25 });
        let uniform = Initial::Uniform { low: 3.0, high: 5.0 };
        let mixed = layout.add_in_parts("mixed", &[2000], vec![(500, Initial::Zeros), (1500, uniform)]);
        let weights = layout.draw(7);
        assert_eq!(weights, layout.draw(7));
        assert_ne!(weights, layout.draw(8));
        let square = weights[..10_000].iter().map(|w| f64::from(*w).powi(2)).sum::<f64>() / 10_000.0;
        assert!((square - 0.04).abs() < 0.002, "{square}");
        assert!(weights[..10_000].iter().all(|w| w.abs() <= 2.0 / 5.0 / CUT_DEVIATION + 1e-6));
        let mixed = &weights[mixed];
        assert!(mixed[..500].iter().all(|&w| w == 0.0));
        assert!(mixed[500..].iter().all(|&w| (3.0..5.0).contains(&w)));
        assert!((mixed[500..].iter().sum::<f32>() / 1500.0 - 4.0).abs() < 0.1);
    }
}
