//! Fresh patches of a design's measurements, as many as are asked for.

use super::design::Design;
use super::simulation::derived_seed;
use crate::information::{InformationError, PatchBatch, PatchStream};
use crate::objects::{ObjectSet, Split};
use crate::sensor::{Convolver, Patches};

/// Patches that are cut from one measurement while a model is fitted: drawing objects costs more than cutting.
const PATCHES_PER_OBJECT: usize = 4;

/// Measurements of one part of an object set through one design, cut at random places.
pub(super) struct DesignStream<'a> {
    pub design: &'a Design,
    pub set: &'a ObjectSet,
    pub convolver: &'a Convolver,
    pub split: Split,
    /// Rows and columns of a patch.
    pub patch: (usize, usize),
}

impl PatchStream for DesignStream<'_> {
    fn draw(&self, count: usize, seed: u64) -> Result<PatchBatch, InformationError> {
        let failed = |error: &dyn std::fmt::Display| InformationError::Stream { reason: error.to_string() };
        let objects = count.div_ceil(PATCHES_PER_OBJECT);
        let objects = self.set.objects(self.split, objects, seed).map_err(|error| failed(&error))?;
        let encoded =
            self.convolver.measure(objects.view(), self.design.bias_photons).map_err(|error| failed(&error))?;
        let places = Patches::draw(encoded.dim(), self.patch, count, seed).map_err(|error| failed(&error))?;
        let clean = places.cut(encoded.view());
        let noisy = self.design.noise.draw(clean.view(), derived_seed(seed, 1));
        Ok(PatchBatch { noisy, clean: Some(clean) })
    }
}
