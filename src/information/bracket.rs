//! The bracket around the truth: the best bound from either side, each by name.

use serde::{Deserialize, Serialize};

use super::LowerBound;

/// An upper bound on the information, bits per pixel, and where it comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UpperBound {
    /// "density", "gaussian", "ceiling" or "posterior sampling".
    pub from: String,
    /// The bound, bits per pixel.
    pub bits_per_pixel: f64,
    /// Its 95 % interval, bits per pixel; both ends are the bound itself where nothing was sampled.
    pub interval_95: [f64; 2],
}

/// What is known of the information of one encoder for one kind of scene, from both sides.
///
/// No density model can tell a poor encoder from a poor fit; the bracket can, because what it holds is proven: the
/// truth lies between a decoder's saving ([`LowerBound`]) and the smallest of a density model's cross-entropy, the
/// Gaussian bound, the entropy ceiling of the objects and posterior sampling ([`super::PosteriorBound`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bracket {
    /// Lower bound, bits per pixel; none for objects whose prior is not known.
    pub lower: Option<f64>,
    /// Its 95 % interval, bits per pixel.
    pub lower_interval_95: Option<[f64; 2]>,
    /// The decoder it comes from.
    pub lower_from: Option<String>,
    /// The smallest upper bound, bits per pixel.
    pub upper: f64,
    /// Its 95 % interval, bits per pixel.
    pub upper_interval_95: [f64; 2],
    /// Where it comes from.
    pub upper_from: String,
    /// All upper bounds, the smallest first.
    pub upper_bounds: Vec<UpperBound>,
}

impl Bracket {
    /// From all bounds that are known; `None` without an upper bound.
    pub fn new(mut upper_bounds: Vec<UpperBound>, lower: Option<&LowerBound>) -> Option<Self> {
        upper_bounds.sort_by(|a, b| a.bits_per_pixel.total_cmp(&b.bits_per_pixel));
        let best = upper_bounds.first()?;
        Some(Self {
            lower: lower.map(|bound| bound.bits_per_pixel),
            lower_interval_95: lower.map(|bound| bound.interval_95),
            lower_from: lower.map(|bound| format!("{} decoder", bound.decoder)),
            upper: best.bits_per_pixel,
            upper_interval_95: best.interval_95,
            upper_from: best.from.clone(),
            upper_bounds,
        })
    }

    /// Distance between the bounds, bits per pixel.
    pub fn width(&self) -> Option<f64> {
        self.lower.map(|lower| self.upper - lower)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn upper(from: &str, bits: f64) -> UpperBound {
        UpperBound { from: from.to_owned(), bits_per_pixel: bits, interval_95: [bits - 0.125, bits + 0.125] }
    }

    #[test]
    fn the_smallest_upper_bound_counts_and_is_named() {
        let bounds = vec![upper("density", 0.5), upper("gaussian", 0.9), upper("ceiling", 0.4)];
        let bracket = Bracket::new(bounds, None).unwrap();
        assert_eq!((bracket.upper, bracket.upper_from.as_str()), (0.4, "ceiling"));
        assert_eq!(bracket.upper_interval_95, [0.4 - 0.125, 0.4 + 0.125]);
        assert_eq!((bracket.lower, bracket.width()), (None, None));
        let order: Vec<&str> = bracket.upper_bounds.iter().map(|bound| bound.from.as_str()).collect();
        assert_eq!(order, ["ceiling", "density", "gaussian"]);
        assert_eq!(Bracket::new(Vec::new(), None), None);
    }
}
