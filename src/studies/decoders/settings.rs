//! Settings of a study of decoders, and its cells.

use serde::{Deserialize, Serialize};

use crate::forward::Design;
use crate::information::Protocol;
use crate::objects::ObjectSource;
use crate::reconstruction::DecoderKind;
use crate::studies::comparison::{StudyDesign, StudyObjects, check_distinct};
use crate::studies::error::StudyError;

/// All settings that decide the numbers of a study of decoders.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct DecoderStudySettings {
    /// The object sets.
    pub objects: Vec<StudyObjects>,
    /// The masks.
    pub designs: Vec<StudyDesign>,
    /// The decoders.
    pub decoders: Vec<DecoderKind>,
    /// Light of information and reconstruction alike. Paper: no background, and each object scaled alone for the decoders.
    pub protocol: Protocol,
    /// Test objects of each decoder.
    pub test: usize,
    /// Sweeps of the Markov chains of the posterior mean; `None` takes the trained decoder alone.
    pub sweeps: Option<usize>,
    /// Time of training of a network for one mask, seconds.
    pub training_seconds: f64,
    /// Time for the information of one mask, seconds.
    pub information_seconds: f64,
    /// Mean of the objects, photons per pixel.
    pub mean_photons: f64,
    /// Background under the default protocol, photons per pixel.
    pub bias_photons: f64,
    /// Seed of objects, noise and fits.
    pub seed: u64,
}

/// One cell: the information of a mask, or what a decoder reaches with it.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlannedCell<'a> {
    pub objects: &'a StudyObjects,
    pub design: &'a StudyDesign,
    /// `None` for the information.
    pub decoder: Option<DecoderKind>,
}

impl DecoderStudySettings {
    /// Nine heuristic layouts imaging beads of density 0.02, by the linear estimate and the posterior mean.
    pub fn beads() -> Self {
        let Design { mean_photons, bias_photons, seed, .. } = Design::default();
        Self {
            objects: vec![StudyObjects::new(ObjectSource::Beads { density: 0.02 }, None)],
            designs: (1..=9).map(StudyDesign::heuristic).collect(),
            decoders: vec![DecoderKind::Linear, DecoderKind::Posterior],
            protocol: Protocol::Default,
            test: 500,
            sweeps: None,
            training_seconds: 60.0,
            information_seconds: 60.0,
            mean_photons,
            bias_photons,
            seed,
        }
    }

    /// The cells, in the order in which they are computed. The posterior mean is for beads alone.
    pub(super) fn plan(&self) -> Vec<PlannedCell<'_>> {
        let mut plan = Vec::new();
        for objects in &self.objects {
            let is_beads = objects.source.is_beads();
            for design in &self.designs {
                let decoders = self.decoders.iter().copied();
                let decoders = decoders.filter(|&decoder| is_beads || decoder != DecoderKind::Posterior).map(Some);
                plan.extend([None].into_iter().chain(decoders).map(|decoder| PlannedCell { objects, design, decoder }));
            }
        }
        plan
    }

    /// Checks that there are cells, none of them twice, and that they can be computed.
    ///
    /// # Errors
    /// [`StudyError`] names the first invalid setting.
    pub fn check(&self) -> Result<(), StudyError> {
        check_distinct("objects", self.objects.iter().map(|objects| objects.source.to_string()).collect())?;
        check_distinct("lenslets", self.designs.iter().map(|design| design.name.clone()).collect())?;
        check_distinct("decoders", self.decoders.iter().map(ToString::to_string).collect())?;
        let plan = self.plan();
        for objects in &self.objects {
            let is_decoded = |cell: &PlannedCell<'_>| cell.objects == objects && cell.decoder.is_some();
            if !plan.iter().any(is_decoded) {
                let (expected, found) =
                    (format!("one for {}", objects.source), "posterior, which is for beads".to_owned());
                return Err(StudyError::Setting { what: "decoders", expected, found });
            }
            for design in &self.designs {
                self.design(objects, design).check().map_err(crate::evaluation::EvaluationError::from)?;
            }
        }
        Ok(())
    }

    /// Version of a document that holds these settings.
    pub(super) fn document_version(&self) -> u64 {
        self.designs.iter().map(|design| design.encoder.document_version()).max().unwrap_or(1)
    }

    /// The design of a cell, in the light of the protocol.
    pub(super) fn design(&self, objects: &StudyObjects, design: &StudyDesign) -> Design {
        let bias_photons = if self.protocol == Protocol::Paper { 0.0 } else { self.bias_photons };
        Design {
            encoder: design.encoder.clone(),
            objects: objects.source.clone(),
            mean_photons: self.mean_photons,
            bias_photons,
            seed: self.seed,
            ..Design::default()
        }
    }
}

impl PlannedCell<'_> {
    /// Objects, mask and decoder for people.
    pub(super) fn name(&self) -> String {
        let what = self.decoder.map_or("information".to_owned(), |decoder| decoder.to_string());
        format!("{}, {}, {what}", self.objects.source, self.design.name)
    }
}
