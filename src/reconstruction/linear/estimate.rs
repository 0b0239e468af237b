//! The linear estimate as a decoder: which solver prepares it.

use std::sync::Arc;

use super::beads::BeadCovariance;
use super::cholesky::CholeskyDecoder;
use super::conjugate_gradients::IterativeDecoder;
use super::prior::{Moments, Prior};
use super::stationary::StationaryCovariance;
use super::tiles::TileCovariance;
use crate::progress::CancelToken;
use crate::reconstruction::decoder::{Decoder, DecoderKind, PreparedDecoder};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;

/// Most unknowns of a Cholesky factor: its time grows with their cube, half a second for these.
const MOST_UNKNOWNS: usize = 3200;

/// Linear MMSE estimate with a prior.
#[derive(Clone)]
pub struct LinearMmse {
    prior: Arc<Prior>,
}

impl LinearMmse {
    /// The estimate with this prior.
    pub fn new(prior: Arc<Prior>) -> Self {
        Self { prior }
    }
}

impl Decoder for LinearMmse {
    fn kind(&self) -> DecoderKind {
        DecoderKind::Linear
    }

    fn prepare(
        &self,
        model: &ImagingModel,
        cancel: &CancelToken,
    ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError> {
        let expected = self.prior.field();
        if model.field() != expected {
            let found = model.field();
            return Err(ReconstructionError::shape("field", &[expected.0, expected.1], &[found.0, found.1]));
        }
        Ok(match &self.prior.moments {
            Moments::Tiles(tiles) if tiles.unknowns() <= MOST_UNKNOWNS => {
                Box::new(CholeskyDecoder::new(model, &self.prior, tiles.clone(), cancel)?)
            }
            Moments::Tiles(tiles) => {
                let covariance = TileCovariance::new(model, tiles.clone())?;
                Box::new(IterativeDecoder::new(model, self.prior.mean().to_owned(), covariance)?)
            }
            Moments::Beads(beads) => {
                let covariance = BeadCovariance::new(model, beads.clone());
                Box::new(IterativeDecoder::new(model, self.prior.mean().to_owned(), covariance)?)
            }
            Moments::Stationary(stationary) => {
                let covariance = StationaryCovariance::new(model, stationary.clone());
                Box::new(IterativeDecoder::new(model, self.prior.mean().to_owned(), covariance)?)
            }
        })
    }
}
