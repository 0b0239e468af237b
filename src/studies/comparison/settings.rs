//! Settings of a study: objects, designs and patches, in all combinations, and the settings that all cells share.

use std::collections::HashSet;
use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::evaluation::{DensityModel, EstimateRequest, EvaluationError, WeightsFiles};
use crate::forward::{Design, is_published_field, is_usual_placement, published_field};
use crate::information::{EngineChoice, Estimator, NoiseEntropy, Protocol};
use crate::objects::{ObjectSource, Placement};
use crate::optics::{Encoder, heuristic_layout};
use crate::sensor::Noise;
use crate::studies::error::StudyError;
use crate::studies::published::{Published, PublishedSet, heuristic_lenslets, published};

/// The kind of a study. Only grids are made now; earlier versions wrote the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum StudyKind {
    /// Objects and designs against published values.
    Grid,
    /// One design and object set, patches of many sizes.
    Patches,
    /// Lower and upper bounds against bead density.
    Bracket,
}

impl fmt::Display for StudyKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Grid => "grid",
            Self::Patches => "patches",
            Self::Bracket => "bracket",
        })
    }
}

/// A set of objects of a study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct StudyObjects {
    /// Source of the objects.
    pub source: ObjectSource,
    /// The published image set that they correspond to; beads need no name.
    pub published_as: Option<PublishedSet>,
    /// Fingerprint of the set; empty until the study is opened.
    pub fingerprint: String,
}

impl StudyObjects {
    /// Objects that are not opened yet.
    pub fn new(source: ObjectSource, published_as: Option<PublishedSet>) -> Self {
        Self { source, published_as, fingerprint: String::new() }
    }
}

/// A mask of a study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct StudyDesign {
    /// `heuristic:9` for a heuristic layout, a description for other masks.
    pub name: String,
    /// The mask.
    pub encoder: Encoder,
}

impl StudyDesign {
    /// A mask by the name that tables give it.
    pub fn new(encoder: Encoder) -> Self {
        let name = match heuristic_lenslets(&encoder) {
            Some(count) => format!("heuristic:{count}"),
            None => encoder.describe(),
        };
        Self { name, encoder }
    }

    /// The heuristic layout of `count` lenslets, 1 to 9.
    ///
    /// # Panics
    /// Where `count` is not 1 to 9.
    pub fn heuristic(count: usize) -> Self {
        Self::new(Encoder::Lenslets(heuristic_layout(count)))
    }

    /// Number of lenslets, where there are lenslets.
    pub fn lenslets(&self) -> Option<usize> {
        self.encoder.lenslets().map(|array| array.lenslets.len())
    }
}

/// All settings that decide the numbers of a study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct StudySettings {
    /// The kind of the study.
    pub kind: StudyKind,
    /// The object sets; every set is imaged by every design.
    pub objects: Vec<StudyObjects>,
    /// The masks.
    pub designs: Vec<StudyDesign>,
    /// Rows and columns of the patches in pixels; `None` takes whole measurements.
    pub patches: Vec<Option<(usize, usize)>>,
    /// The estimator.
    pub estimator: Estimator,
    /// Time for the fits of one cell, seconds; `None` for estimators that are not fitted for a time.
    pub budget_seconds: Option<f64>,
    /// Number of training patches, for an estimator that does not draw fresh ones.
    pub patches_train: usize,
    /// Number of held-out patches of the score.
    pub patches_test: usize,
    /// Whether fits of causal and bracket start from random weights, in place of the pretrained ones.
    #[serde(default)]
    pub fresh: bool,
    /// Noise of the sensor.
    pub noise: Noise,
    /// Mean of the objects, photons per pixel.
    pub mean_photons: f64,
    /// Background, photons per pixel.
    pub bias_photons: f64,
    /// Seed of objects, noise, patches and fits.
    pub seed: u64,
    /// Rows and columns of the objects in pixels; 96 x 96 where absent.
    #[serde(default = "published_field", skip_serializing_if = "is_published_field")]
    pub field: (usize, usize),
    /// How whole images get the size of the field; scaled where absent.
    #[serde(default, skip_serializing_if = "is_usual_placement")]
    pub placement: Placement,
}

impl StudySettings {
    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.objects.len() * self.designs.len() * self.patches.len()
    }

    /// Checks that there are cells, none of them twice, and that noise and light allow an estimate.
    ///
    /// # Errors
    /// [`StudyError`] names the first invalid setting.
    pub fn check(&self) -> Result<(), StudyError> {
        check_distinct("objects", self.objects.iter().map(|objects| objects.source.to_string()).collect())?;
        check_distinct("lenslets", self.designs.iter().map(|design| design.name.clone()).collect())?;
        check_distinct("patches", self.patches.iter().map(|&patch| patch_name(patch)).collect())?;
        self.model()?;
        NoiseEntropy::new(self.noise, Protocol::Default).map_err(EvaluationError::from)?;
        for (objects, design) in self.objects.iter().flat_map(|objects| self.designs.iter().map(move |d| (objects, d)))
        {
            self.design(objects, design).check().map_err(EvaluationError::from)?;
        }
        Ok(())
    }

    /// Time for the fits of one cell; zero for estimators that are not fitted for a time.
    pub fn budget(&self) -> Duration {
        self.budget_seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()).unwrap_or_default()
    }

    /// The design of a cell.
    pub(super) fn design(&self, objects: &StudyObjects, design: &StudyDesign) -> Design {
        Design {
            encoder: design.encoder.clone(),
            objects: objects.source.clone(),
            mean_photons: self.mean_photons,
            bias_photons: self.bias_photons,
            noise: self.noise,
            seed: self.seed,
            field: self.field,
            placement: self.placement,
            ..Design::default()
        }
    }

    /// Version of a document that holds these settings; see [`Design::document_version`].
    pub(super) fn document_version(&self) -> u64 {
        let cells = self.plan();
        cells.iter().map(|cell| self.design(cell.objects, cell.design).document_version()).max().unwrap_or(1)
    }

    /// The request of a cell.
    pub(super) fn request(&self, patch: Option<(usize, usize)>) -> Result<EstimateRequest, StudyError> {
        Ok(EstimateRequest {
            model: self.model()?,
            protocol: Protocol::Default,
            patch,
            patches_train: self.patches_train,
            patches_test: self.patches_test,
            fresh: self.fresh,
            trials: 1,
            keep: None,
            weights: WeightsFiles::default(),
        })
    }

    /// The cells, in the order in which they are computed: by objects, then designs, then patches.
    pub(super) fn plan(&self) -> Vec<PlannedCell<'_>> {
        let mut plan = Vec::with_capacity(self.cells());
        for objects in &self.objects {
            for design in &self.designs {
                plan.extend(self.patches.iter().map(|&patch| PlannedCell { objects, design, patch }));
            }
        }
        plan
    }

    /// All settings by name, for people; equal settings of two studies give equal texts.
    pub(super) fn described(&self) -> Vec<(&'static str, String)> {
        let objects = |text: &dyn Fn(&StudyObjects) -> String| joined(self.objects.iter().map(text));
        let images = objects(&|objects| objects.published_as.map_or("-".into(), |set| set.to_string()));
        vec![
            ("kind", self.kind.to_string()),
            ("objects", objects(&|objects| objects.source.to_string())),
            ("published image sets", images),
            ("objects of the fingerprint", objects(&|objects| objects.fingerprint.clone())),
            ("designs", joined(self.designs.iter().map(|design| design.name.clone()))),
            ("patches", joined(self.patches.iter().map(|&patch| patch_name(patch)))),
            ("estimator", self.estimator.to_string()),
            ("budget", self.budget_seconds.map_or("none".into(), |seconds| format!("{seconds} s"))),
            ("training patches", self.patches_train.to_string()),
            ("test patches", self.patches_test.to_string()),
            ("fits from the beginning", if self.fresh { "yes" } else { "no" }.into()),
            ("noise", self.noise.to_string()),
            ("mean photons per pixel", self.mean_photons.to_string()),
            ("background photons per pixel", self.bias_photons.to_string()),
            ("seed", self.seed.to_string()),
            ("field of the objects", format!("{} x {} px", self.field.0, self.field.1)),
            ("placement of whole images", self.placement.to_string()),
        ]
    }

    /// The density model, where the budget suits the estimator.
    fn model(&self) -> Result<DensityModel, StudyError> {
        let found = self.budget_seconds.map_or("none".into(), |seconds| format!("{seconds} s"));
        let budget = self.budget_seconds.map(|seconds| Duration::try_from_secs_f64(seconds).unwrap_or_default());
        let expected = match (self.estimator.default_budget(), budget) {
            (None, Some(_)) => "none",
            (Some(_), None) => "a time",
            (Some(_), Some(Duration::ZERO)) => "a time above 0 s",
            _ => return Ok(DensityModel::new(self.estimator, budget, EngineChoice::default())),
        };
        Err(StudyError::Setting { what: "budget", expected: format!("{expected} for {}", self.estimator), found })
    }
}

/// A planned cell of the table.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlannedCell<'a> {
    pub objects: &'a StudyObjects,
    pub design: &'a StudyDesign,
    pub patch: Option<(usize, usize)>,
}

impl PlannedCell<'_> {
    /// The published value for comparison, where there is one.
    pub fn published(&self, settings: &StudySettings) -> Option<Published> {
        published(&settings.design(self.objects, self.design), self.objects.published_as, self.patch)
    }

    /// Objects, design and patch for people.
    pub fn name(&self) -> String {
        format!("{}, {}, {}", self.objects.source, self.design.name, patch_name(self.patch))
    }
}

/// Refuses names that are missing or given twice.
fn check_distinct(what: &'static str, names: Vec<String>) -> Result<(), StudyError> {
    let mut seen = HashSet::new();
    let twice = names.iter().find(|name| !seen.insert(name.as_str())).map(|name| format!("{name} twice"));
    match twice.or_else(|| names.is_empty().then(|| "none".to_owned())) {
        Some(found) => Err(StudyError::Setting { what, expected: "each once".into(), found }),
        None => Ok(()),
    }
}

/// A patch for people: `32 x 32 px`, or `sensor`.
pub(super) fn patch_name(patch: Option<(usize, usize)>) -> String {
    patch.map_or("sensor".into(), |(rows, cols)| format!("{rows} x {cols} px"))
}

fn joined(names: impl Iterator<Item = String>) -> String {
    names.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
impl StudySettings {
    /// The published grid: five heuristic layouts imaging beads of four densities, shot noise, patches of 32 x 32 px.
    pub(in crate::studies) fn grid() -> Self {
        let Design { mean_photons, bias_photons, noise, seed, field, placement, .. } = Design::default();
        let beads = |&density: &f64| StudyObjects::new(ObjectSource::Beads { density }, None);
        Self {
            kind: StudyKind::Grid,
            objects: [0.008, 0.02, 0.05, 0.11].iter().map(beads).collect(),
            designs: [1, 2, 4, 6, 9].map(StudyDesign::heuristic).into(),
            patches: vec![Some((32, 32))],
            estimator: Estimator::Causal,
            budget_seconds: Estimator::Causal.default_budget().map(|budget| budget.as_secs_f64()),
            patches_train: 10_000,
            patches_test: 1_500,
            fresh: false,
            noise,
            mean_photons,
            bias_photons,
            seed,
            field,
            placement,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_grid_has_twenty_cells_with_published_values() {
        let grid = StudySettings::grid();
        grid.check().unwrap();
        let plan = grid.plan();
        assert_eq!((plan.len(), grid.cells(), grid.budget()), (20, 20, Duration::from_mins(1)));
        assert!(plan.iter().all(|cell| cell.published(&grid).is_some_and(|known| known.interval_95.is_some())));
        assert_eq!(
            (plan[1].objects.source.to_string().as_str(), plan[1].design.name.as_str()),
            ("beads:0.008", "heuristic:2")
        );
    }

    #[test]
    fn impossible_settings_are_refused_before_any_computation() {
        let refusal = |change: &dyn Fn(&mut StudySettings)| {
            let mut settings = StudySettings::grid();
            change(&mut settings);
            settings.check().unwrap_err().to_string()
        };
        for (message, part) in [
            (refusal(&|grid| grid.designs.push(StudyDesign::heuristic(4))), "heuristic:4 twice"),
            (refusal(&|grid| grid.objects.clear()), "objects: expected each once, found none"),
            (refusal(&|grid| grid.patches = vec![None, None]), "sensor twice"),
            (refusal(&|grid| grid.budget_seconds = None), "a time for causal"),
            (refusal(&|grid| grid.budget_seconds = Some(f64::NAN)), "above 0 s"),
            (refusal(&|grid| grid.estimator = Estimator::GaussianStationary), "found 60 s"),
            (refusal(&|grid| grid.noise = Noise::None), "without noise"),
            (refusal(&|grid| grid.mean_photons = 0.0), "mean_photons"),
        ] {
            assert!(message.contains(part), "{part} in {message}");
        }
    }
}
