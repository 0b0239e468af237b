//! The bracket: the best lower and the best upper bound, with their sources.

use serde::{Deserialize, Serialize};

use super::method::BoundMethod;
use crate::information::ais::bound::AisBound;
use crate::information::decoder::lower_bound::LowerBound;

/// A lower or upper bound on the information, bits per pixel, and its source.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// use lenslet_studio::information::BoundMethod;
///
/// let bound = NamedBound::exact(BoundMethod::EntropyBound, 0.41);
/// assert_eq!(bound.interval_95, [0.41, 0.41]);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct NamedBound {
    /// Source.
    pub from: BoundMethod,
    /// The bound, bits per pixel.
    pub bits_per_pixel: f64,
    /// Its 95 % interval, bits per pixel; both ends are the bound itself where nothing was sampled.
    pub interval_95: [f64; 2],
}

/// Bounds that use the prior of beads.
#[derive(Clone, Debug, PartialEq)]
pub struct BeadBounds {
    /// Lower bound of a fitted decoder on held-out samples.
    pub decoder: LowerBound,
    /// Lower bound by reverse AIS from the true beads.
    pub below: AisBound,
    /// Upper bound by AIS from the decoder's posterior.
    pub above: AisBound,
}

impl BeadBounds {
    /// The lower bounds with their sources.
    pub(in crate::information) fn lower(&self) -> Vec<NamedBound> {
        let decoder = &self.decoder;
        vec![
            NamedBound {
                from: decoder.decoder.into(),
                bits_per_pixel: decoder.bits_per_pixel,
                interval_95: decoder.interval_95,
            },
            NamedBound::from(&self.below),
        ]
    }
}

impl NamedBound {
    /// A bound without sampling: its interval is the bound itself.
    pub fn exact(from: BoundMethod, bits_per_pixel: f64) -> Self {
        Self { from, bits_per_pixel, interval_95: [bits_per_pixel; 2] }
    }
}

impl From<&AisBound> for NamedBound {
    fn from(bound: &AisBound) -> Self {
        // Information is not negative.
        let known = |bits: f64| if bits < 0.0 { 0.0 } else { bits };
        let (bits_per_pixel, interval_95) = (known(bound.bits_per_pixel), bound.interval_95.map(known));
        Self { from: BoundMethod::Ais, bits_per_pixel, interval_95 }
    }
}

/// Lower and upper bounds on the information of one encoder for one kind of scene.
///
/// A density model alone cannot separate a poor encoder from a poor fit; a bracket can. The truth lies between the
/// largest lower bound (decoder, [`LowerBound`], or AIS, [`AisBound`]) and the smallest upper bound (density model,
/// Gaussian, object entropy or AIS).
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// use lenslet_studio::information::BoundMethod;
///
/// let lower = NamedBound { from: BoundMethod::Decoder, bits_per_pixel: 0.25, interval_95: [0.24, 0.26] };
/// let uppers = vec![NamedBound::exact(BoundMethod::EntropyBound, 0.41), NamedBound::exact(BoundMethod::Density, 0.5)];
/// let bracket = Bracket::new(uppers, vec![lower]).expect("an upper bound");
/// assert_eq!((bracket.lower, bracket.upper), (Some(0.25), 0.41));
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Bracket {
    /// Lower bound, bits per pixel; `None` for objects with an unknown prior.
    pub lower: Option<f64>,
    /// Its 95 % interval, bits per pixel.
    pub lower_interval_95: Option<[f64; 2]>,
    /// Its source.
    pub lower_from: Option<BoundMethod>,
    /// The smallest upper bound, bits per pixel.
    pub upper: f64,
    /// Its 95 % interval, bits per pixel.
    pub upper_interval_95: [f64; 2],
    /// Its source.
    pub upper_from: BoundMethod,
    /// All upper bounds, the smallest first.
    pub upper_bounds: Vec<NamedBound>,
    /// All lower bounds, the largest first; empty in files of versions with a single lower bound.
    #[serde(default)]
    pub lower_bounds: Vec<NamedBound>,
}

impl Bracket {
    /// Collects bounds; `None` without an upper bound.
    pub fn new(mut upper_bounds: Vec<NamedBound>, mut lower_bounds: Vec<NamedBound>) -> Option<Self> {
        upper_bounds.sort_by(|a, b| a.bits_per_pixel.total_cmp(&b.bits_per_pixel));
        lower_bounds.sort_by(|a, b| b.bits_per_pixel.total_cmp(&a.bits_per_pixel));
        let (best, lower) = (upper_bounds.first()?, lower_bounds.first());
        Some(Self {
            lower: lower.map(|bound| bound.bits_per_pixel),
            lower_interval_95: lower.map(|bound| bound.interval_95),
            lower_from: lower.map(|bound| bound.from),
            upper: best.bits_per_pixel,
            upper_interval_95: best.interval_95,
            upper_from: best.from,
            upper_bounds,
            lower_bounds,
        })
    }

    /// Merges brackets of the same encoder, scene and patch; `None` without any.
    pub fn joined<'a>(brackets: impl IntoIterator<Item = &'a Self>) -> Option<Self> {
        let (mut upper, mut lower) = (Vec::new(), Vec::new());
        for bracket in brackets {
            upper.extend(bracket.upper_bounds.iter().cloned());
            lower.extend(bracket.lower_bounds.iter().cloned());
        }
        Self::new(upper, lower)
    }

    /// Two bounds sorted, bits per pixel: tight bounds can cross by chance.
    pub fn in_order(lower: f64, upper: f64) -> (f64, f64) {
        (lower.min(upper), lower.max(upper))
    }

    /// Distance between the bounds, bits per pixel.
    pub fn width(&self) -> Option<f64> {
        self.lower.map(|lower| self.upper - lower)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bound(from: BoundMethod, bits: f64) -> NamedBound {
        NamedBound { from, bits_per_pixel: bits, interval_95: [bits - 0.125, bits + 0.125] }
    }

    #[test]
    fn bracket_takes_smallest_upper_and_largest_lower_bound() {
        let bounds = vec![
            bound(BoundMethod::Density, 0.5),
            bound(BoundMethod::Gaussian, 0.9),
            bound(BoundMethod::EntropyBound, 0.4),
        ];
        let below = vec![bound(BoundMethod::Decoder, 0.25), bound(BoundMethod::Ais, 0.375)];
        let both = Bracket::new(bounds.clone(), below).unwrap();
        assert_eq!((both.lower, both.lower_from), (Some(0.375), Some(BoundMethod::Ais)));
        assert_eq!(both.lower_interval_95, Some([0.25, 0.5]));
        assert!((both.width().unwrap() - 0.025).abs() < 1e-12);
        let bracket = Bracket::new(bounds, Vec::new()).unwrap();
        assert_eq!((bracket.upper, bracket.upper_from), (0.4, BoundMethod::EntropyBound));
        assert_eq!(bracket.upper_interval_95, [0.4 - 0.125, 0.4 + 0.125]);
        assert_eq!((bracket.lower, bracket.width()), (None, None));
        let order: Vec<BoundMethod> = bracket.upper_bounds.iter().map(|bound| bound.from).collect();
        assert_eq!(order, [BoundMethod::EntropyBound, BoundMethod::Density, BoundMethod::Gaussian]);
        assert_eq!(Bracket::new(Vec::new(), Vec::new()), None);
    }
}
