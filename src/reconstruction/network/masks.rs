//! Masks that a network is trained for: one, or random ones.

use ndarray::Array3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Exp1};

use crate::forward::{DesignError, ForwardError};
use crate::optics::{Encoder, HEURISTIC_SIGMA, Lenslet, LensletArray, render_psf};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;

/// Most lenslets.
const MOST_LENSLETS: usize = 10;
/// Centres keep this distance from the edge, px, where the grid is large enough.
const MARGIN_PX: f64 = 3.0;
/// Least distance between centres, px.
const DISTANCE_PX: f64 = 4.0;
/// Draws of a centre before the distance is given up.
const TRIES: usize = 100;
/// Range of the widths of half of the masks, px; the other half has that of the heuristic layouts.
const SIGMAS_PX: std::ops::Range<f64> = 0.775..1.6;

/// Masks that a network is trained for.
#[derive(Clone, Debug)]
pub enum TrainingMasks {
    /// One mask.
    One(ImagingModel),
    /// Any mask: random lenslets on a grid.
    Any {
        /// Rows and columns of the point spread functions, px.
        psf: (usize, usize),
    },
}

impl TrainingMasks {
    /// Any mask of lenslets on the grid of this one.
    ///
    /// # Errors
    /// [`ReconstructionError::NoLenslets`] where it has no lenslets, [`ReconstructionError::Throughput`] where it loses or gains light, as
    /// the random masks do not.
    pub fn any(encoder: &Encoder) -> Result<Self, ReconstructionError> {
        match (encoder.lenslets(), encoder.throughput_unless_unit()) {
            (None, _) => Err(ReconstructionError::NoLenslets { found: encoder.describe() }),
            (_, Some(throughput)) => Err(ReconstructionError::Throughput { throughput }),
            (Some(_), None) => Ok(Self::Any { psf: encoder.grid() }),
        }
    }
}

/// A random lenslet mask on a grid of (rows, cols), as a point spread function of shape (1, rows, cols).
///
/// It has 1 to 10 lenslets of one width at random places. Half of the masks have equal weights, the others random ones.
pub(super) fn random_psf(
    (rows, cols): (usize, usize),
    random: &mut ChaCha8Rng,
) -> Result<Array3<f64>, ReconstructionError> {
    let count = random.random_range(1..=MOST_LENSLETS);
    // A single lenslet away from the middle sees little of the field.
    let along = |side: usize| {
        let last = side as f64 - 1.0;
        let margin = if count == 1 { 0.25 * last } else { MARGIN_PX.min(0.4 * last) };
        (margin, last - 2.0 * margin)
    };
    let ((left, width), (top, height)) = (along(cols), along(rows));
    let sigma = if random.random::<bool>() { HEURISTIC_SIGMA } else { random.random_range(SIGMAS_PX) };
    let is_equal = random.random::<bool>();
    let mut lenslets: Vec<Lenslet> = Vec::new();
    for _ in 0..count {
        let mut centre = || (left + width * random.random::<f64>(), top + height * random.random::<f64>());
        let is_free =
            |&(x, y): &(f64, f64)| lenslets.iter().all(|other| (other.x - x).hypot(other.y - y) > DISTANCE_PX);
        let Some((x, y)) = (0..TRIES).map(|_| centre()).find(is_free) else { break };
        let weight = if is_equal { 1.0 } else { Distribution::<f64>::sample(&Exp1, random).max(0.05) };
        lenslets.push(Lenslet::round(x, y, sigma, weight));
    }
    let array = LensletArray::new(rows, cols, lenslets);
    render_psf(&array, 1).map_err(|error| ForwardError::from(DesignError::from(error)).into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn masks_differ_and_keep_their_light() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let masks: Vec<_> = (0..20).map(|_| random_psf((32, 24), &mut random).unwrap()).collect();
        for (index, mask) in masks.iter().enumerate() {
            assert_eq!(mask.dim(), (1, 32, 24));
            assert!((mask.sum() - 1.0).abs() < 0.05, "{}", mask.sum());
            assert!(masks[..index].iter().all(|other| other != mask));
        }
        assert!(random_psf((2, 2), &mut random).is_ok());
    }

    #[test]
    fn any_mask_is_one_of_lenslets() {
        let lenslets = Encoder::Lenslets(crate::optics::heuristic_layout(3));
        assert!(matches!(TrainingMasks::any(&lenslets), Ok(TrainingMasks::Any { psf }) if psf == lenslets.grid()));
        let sentence = TrainingMasks::any(&lenslets.with_throughput(0.5)).unwrap_err().to_string();
        assert!(sentence.contains("expected a mask of throughput 1, found 0.5"), "{sentence}");
        let diffuser = Encoder::Diffuser(crate::optics::Diffuser::with_light_kept(8, 1));
        let sentence = TrainingMasks::any(&diffuser).unwrap_err().to_string();
        assert!(sentence.contains("expected a mask of lenslets, found diffuser, aperture 8 px"), "{sentence}");
    }
}
