//! The decoders with their standard settings.

use std::sync::Arc;

use super::decoder::{Decoder, DecoderKind};
use super::error::ReconstructionError;
use super::linear::{LinearMmse, Prior};
use super::posterior_mean::PosteriorMean;
use super::richardson_lucy::RichardsonLucy;
use super::total_variation::TotalVariation;
use crate::information::PosteriorChains;

impl DecoderKind {
    /// The decoder with its standard settings. `prior` is that of the objects. `chains` refine the posterior mean. A
    /// decoder that needs none of them ignores them.
    ///
    /// # Errors
    /// [`ReconstructionError::NoPrior`] where it needs one and there is none; [`ReconstructionError::NoBeads`] for the posterior mean of
    /// other objects; [`ReconstructionError::NoNetwork`] where it needs training: see [`DecoderTraining`](super::DecoderTraining).
    pub fn decoder(
        self,
        prior: Option<Arc<Prior>>,
        chains: Option<PosteriorChains>,
    ) -> Result<Box<dyn Decoder>, ReconstructionError> {
        Ok(match self {
            Self::Linear => {
                let prior = prior.ok_or(ReconstructionError::NoPrior { decoder: self.name() })?;
                Box::new(LinearMmse::new(prior))
            }
            Self::Posterior => {
                let prior = prior.ok_or(ReconstructionError::NoPrior { decoder: self.name() })?;
                Box::new(PosteriorMean::new(&prior, chains)?)
            }
            Self::Network | Self::Unet => return Err(ReconstructionError::NoNetwork { decoder: self.name() }),
            Self::TotalVariation => Box::new(TotalVariation::default()),
            Self::RichardsonLucy => Box::new(RichardsonLucy::default()),
        })
    }
}
