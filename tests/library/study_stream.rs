//! New patches of the studies with known information.

use crate::known_cases::KnownTruth;
use lenslet_studio::information::{InformationError, PatchBatch, PatchStream};

/// Stream of new patches of a study.
pub struct StudyStream<'a>(pub &'a KnownTruth);

impl PatchStream for StudyStream<'_> {
    fn draw(&self, count: usize, seed: u64) -> Result<PatchBatch, InformationError> {
        let drawn = self.0.draw(count, seed);
        let (clean, noisy) = drawn.map_err(|error| InformationError::Stream { reason: error.to_string() })?;
        Ok(PatchBatch { noisy, clean: Some(clean) })
    }
}
