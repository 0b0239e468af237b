//! The file of a study: its settings, the cells computed so far, and their summary.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::formats::{DocumentKind, FormatError, Mismatch, read_json, write_json};
use crate::information::{BoundMethod, Estimate, NUMBERS_VERSION, PairedDifference};
use crate::optics::MASK_DOCUMENT_VERSION;
use crate::studies::comparison::settings::{PlannedCell, StudySettings, patch_name};
use crate::studies::comparison::summary::StudySummary;
use crate::studies::error::StudyError;
use crate::studies::machine::Machine;
use crate::studies::published::Published;

/// The kind of the file.
const STUDY: DocumentKind = DocumentKind::new("lenslet-studio/study", "a study").at_version(MASK_DOCUMENT_VERSION);

/// A study as it stands in its file. Information is in bits per pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct StudyRecord {
    /// Always "lenslet-studio/study".
    pub format: String,
    /// Version of the fields.
    pub format_version: u64,
    /// Version of the program that computed the cells.
    pub program_version: String,
    /// Settings of the study.
    pub settings: StudySettings,
    /// Notices on the objects.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notices: Vec<String>,
    /// The cells computed so far, in the order of the settings.
    pub cells: Vec<StudyCell>,
    /// Summary of all cells; reading ignores it.
    #[serde(skip_deserializing)]
    pub summary: StudySummary,
}

/// One cell: an estimate with all that belongs to it, or the sentence that says why there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct StudyCell {
    /// The objects, by the text of their source.
    pub objects: String,
    /// The mask, by its name in the settings.
    pub design: String,
    /// Rows and columns of the patch in pixels; `None` for the whole measurement.
    pub patch: Option<(usize, usize)>,
    /// The published value, where there is one for exactly this cell.
    pub published: Option<Published>,
    /// The estimate; none where it failed.
    pub estimate: Option<Estimate>,
    /// Why it failed.
    pub failure: Option<String>,
    /// Machine that computed the cell.
    pub machine: Machine,
    /// Information of each test patch by the density model, bits per pixel. It is that of the first of several designs, with which the
    /// others are compared.
    #[serde(default, alias = "told", skip_serializing_if = "Vec::is_empty")]
    pub patch_information: Vec<f64>,
    /// Information of the first design less that of this one by the density model, on the same test patches. None for the first design,
    /// and for measurements of another size.
    #[serde(default, alias = "first_less_this", skip_serializing_if = "Option::is_none")]
    pub difference_to_reference: Option<PairedDifference>,
}

impl StudyCell {
    /// A cell of the plan. An estimate that is not finite counts as failed, because no file could hold it.
    pub(super) fn new(
        planned: &PlannedCell<'_>,
        settings: &StudySettings,
        result: Result<Estimate, String>,
        machine: Machine,
    ) -> Self {
        let (estimate, failure) = match result {
            Ok(estimate) if estimate.is_finite() => (Some(estimate), None),
            Ok(_) => (None, Some("the estimate is not a finite number; give the fit more time".into())),
            Err(sentence) => (None, Some(sentence)),
        };
        Self {
            objects: planned.objects.source.to_string(),
            design: planned.design.name.clone(),
            patch: planned.patch,
            published: planned.published(settings),
            estimate,
            failure,
            machine,
            patch_information: Vec::new(),
            difference_to_reference: None,
        }
    }

    /// Whether this is the cell of the plan.
    pub(super) fn is(&self, planned: &PlannedCell<'_>) -> bool {
        self.patch == planned.patch
            && self.design == planned.design.name
            && self.objects == planned.objects.source.to_string()
    }

    /// The estimate, an upper bound: bits per pixel.
    pub fn bits_per_pixel(&self) -> Option<f64> {
        self.estimate.as_ref().map(|estimate| estimate.bits_per_pixel)
    }

    /// Information by the density model alone, bits per pixel: the estimate, or one bound of several.
    pub fn model_bits(&self) -> Option<f64> {
        if self.estimate.as_ref()?.is_of_one_model() {
            self.bits_per_pixel()
        } else {
            self.upper_from(BoundMethod::Density)
        }
    }

    /// Name of the upper bound that the estimate was chosen from; none where it is the bound of one model.
    pub fn chosen_from(&self) -> Option<BoundMethod> {
        let estimate = self.estimate.as_ref().filter(|estimate| !estimate.is_of_one_model())?;
        Some(estimate.bracket.as_ref()?.upper_from)
    }

    /// The lower bound, bits per pixel, where one was computed.
    pub fn lower(&self) -> Option<f64> {
        self.estimate.as_ref()?.lower()
    }

    /// The upper bound of a bracket by this method, bits per pixel.
    pub fn upper_from(&self, method: BoundMethod) -> Option<f64> {
        let bounds = &self.estimate.as_ref()?.bracket.as_ref()?.upper_bounds;
        bounds.iter().find(|bound| bound.from == method).map(|bound| bound.bits_per_pixel)
    }

    /// The lower bound of a bracket by a decoder of any kind, bits per pixel.
    pub fn lower_from_decoder(&self) -> Option<f64> {
        self.lower_where(BoundMethod::is_decoder)
    }

    /// The lower bound of a bracket by annealed importance sampling, bits per pixel.
    pub fn lower_from_ais(&self) -> Option<f64> {
        self.lower_where(|method| method == BoundMethod::Ais)
    }

    fn lower_where(&self, is_asked_for: impl Fn(BoundMethod) -> bool) -> Option<f64> {
        let bounds = &self.estimate.as_ref()?.bracket.as_ref()?.lower_bounds;
        bounds.iter().find(|bound| is_asked_for(bound.from)).map(|bound| bound.bits_per_pixel)
    }

    /// The object-entropy bound, bits per pixel, where the entropy of the objects is known.
    pub fn ceiling(&self) -> Option<f64> {
        self.estimate.as_ref()?.ceiling
    }

    /// Objects, design and patch for people.
    pub fn name(&self) -> String {
        format!("{}, {}, {}", self.objects, self.design, patch_name(self.patch))
    }
}

impl StudyRecord {
    /// A study without cells.
    pub(super) fn new(settings: StudySettings) -> Self {
        let summary = StudySummary::of(&settings, &[]);
        Self {
            format: STUDY.format.into(),
            format_version: settings.document_version(),
            program_version: NUMBERS_VERSION.into(),
            settings,
            notices: Vec::new(),
            cells: Vec::new(),
            summary,
        }
    }

    /// The study of a file.
    ///
    /// # Errors
    /// [`StudyError`] where the file cannot be read, is no study, or one of a newer version.
    pub fn open(path: &Path) -> Result<Self, StudyError> {
        Self::from_value(path, read_json(path)?)
    }

    fn from_value(path: &Path, value: serde_json::Value) -> Result<Self, StudyError> {
        let refused =
            |found: String, advice| StudyError::Refused { path: path.into(), version: STUDY.version, found, advice };
        STUDY.version_of(&value).map_err(|mismatch| {
            let advice = match mismatch {
                Mismatch::Newer(_) => "update this program, or choose another folder",
                Mismatch::OtherKind(_) | Mismatch::NoVersion => "choose another folder",
            };
            refused(mismatch.to_string(), advice)
        })?;
        let mut record: Self = serde_path_to_error::deserialize(value)
            .map_err(|error| refused(error.to_string(), "restore it from a backup, or choose another folder"))?;
        record.summary = StudySummary::of(&record.settings, &record.cells);
        Ok(record)
    }

    /// The study as it would be read back. Settings compare equal only after the same round trip through a file.
    pub(super) fn as_read(&self, path: &Path) -> Result<Self, StudyError> {
        let lost = |error: serde_json::Error| FormatError::from_write(path, error.into());
        let text = serde_json::to_string(self).map_err(lost)?;
        Self::from_value(path, serde_json::from_str(&text).map_err(lost)?)
    }

    /// Whether `other`, read from `path`, is the same study by the same version of the program.
    pub(super) fn check_same(&self, other: &Self, path: &Path) -> Result<(), StudyError> {
        let changed = |what, expected: &str, found: &str| {
            Err(StudyError::Changed { path: path.into(), what, expected: short(expected), found: short(found) })
        };
        if self.program_version != other.program_version {
            let (expected, found) = (self.program_version.clone(), short(&other.program_version));
            return Err(StudyError::OtherVersion { path: path.into(), expected, found });
        }
        let settings = self.settings.described().into_iter().zip(other.settings.described());
        if let Some(((what, expected), (_, found))) = settings.into_iter().find(|(here, there)| here.1 != there.1) {
            return changed(what, &expected, &found);
        }
        if self.settings != other.settings {
            return changed("the masks", "of these settings", "others of the same names");
        }
        Ok(())
    }

    /// Puts a cell in its place, instead of an earlier one of the same objects, design and patch.
    pub(crate) fn put(&mut self, cell: StudyCell) {
        let mut cells = std::mem::take(&mut self.cells);
        cells.retain(|old| (&old.objects, &old.design, old.patch) != (&cell.objects, &cell.design, cell.patch));
        cells.push(cell);
        // Few cells: the plan is searched for each.
        let plan = self.settings.plan();
        cells.sort_by_key(|cell| plan.iter().position(|planned| cell.is(planned)));
        drop(plan);
        self.summary = StudySummary::of(&self.settings, &cells);
        self.cells = cells;
    }

    /// Writes the file, whole or not at all.
    pub(super) fn save(&self, path: &Path) -> Result<(), FormatError> {
        write_json(path, self)
    }
}

/// Most characters of a setting in a sentence.
const LONGEST: usize = 80;

fn short(text: &str) -> String {
    if text.chars().count() <= LONGEST {
        return text.to_owned();
    }
    format!("{}...", text.chars().take(LONGEST).collect::<String>())
}
