//! A plan and its TOML file.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::axes::{Axes, Axis};
use super::cell::CellSettings;
use super::estimates::EstimateSettings;
use super::facet::Facet;
use super::ideal_settings::time_of_design;
use super::reconstruction::ReconstructionSettings;
use crate::formats::{FormatError, write_safely};
use crate::information::{Estimator, Protocol};
use crate::objects::ObjectSource;
use crate::studies::error::StudyError;

/// Value of the entry `format` of a plan file.
const FORMAT: &str = "lenslet-studio/plan";
/// Version of its entries.
const VERSION: u64 = 1;
/// Largest plan file, bytes.
const LARGEST: u64 = 16 << 20;
/// Time of a cell apart from its fits: drawing and scoring of measurements.
const AROUND_FITS: Duration = Duration::from_millis(4_500);

/// A study: axes whose values cross to cells, and settings that all cells share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Always "lenslet-studio/plan".
    pub format: String,
    /// Version of the entries.
    pub format_version: u64,
    /// Short name; tables and plots are named by it.
    pub name: String,
    /// Title of its table and plot.
    pub title: String,
    /// Image sets by the names that the axis `objects` uses. The names mnist, fashion and cifar10 stand for the published sets.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub sets: BTreeMap<String, ObjectSource>,
    /// The axes.
    pub axes: Axes,
    /// Settings of the estimates.
    #[serde(default)]
    pub estimates: EstimateSettings,
    /// The decoder whose image quality every cell reports, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reconstruction: Option<ReconstructionSettings>,
    /// The plot.
    pub plot: PlotSettings,
    /// Settings of a first look.
    #[serde(default)]
    pub quick: QuickSettings,
}

/// Roles of axes in the plot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlotSettings {
    /// What lies along x.
    pub x: Facet,
    /// What distinguishes the lines.
    pub lines: Facet,
    /// What distinguishes the panels, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panels: Option<Facet>,
    /// Whether x is logarithmic.
    #[serde(default)]
    pub logarithmic: bool,
    /// Whether each line's largest value gets a star, and a second panel shows the sensor's Tamura coefficient there.
    #[serde(default)]
    pub optima: bool,
}

/// Settings of a first look: every second value of each axis, and less time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct QuickSettings {
    /// Time for the fits of one cell, seconds.
    pub seconds: f64,
    /// Steps of each optimizer run.
    pub ideal_steps: usize,
    /// Axes that keep all their values.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub keep: Vec<Axis>,
}

impl Default for QuickSettings {
    fn default() -> Self {
        Self { seconds: 10.0, ideal_steps: 100, keep: Vec::new() }
    }
}

impl Plan {
    /// A plan of these axes.
    pub fn new(name: &str, title: &str, axes: Axes, plot: PlotSettings) -> Self {
        Self {
            format: FORMAT.into(),
            format_version: VERSION,
            name: name.into(),
            title: title.into(),
            sets: BTreeMap::new(),
            axes,
            estimates: EstimateSettings::default(),
            reconstruction: None,
            plot,
            quick: QuickSettings::default(),
        }
    }

    /// Reads a plan file.
    ///
    /// # Errors
    /// [`StudyError`] where it cannot be read, or names an axis or an entry that there is not.
    pub fn open(path: &Path) -> Result<Self, StudyError> {
        let size = std::fs::metadata(path).map_err(|error| FormatError::from_read(path, error))?.len();
        let refused = |found: String| StudyError::PlanFile { path: path.into(), found };
        if size > LARGEST {
            return Err(refused(format!("a file of {size} bytes")));
        }
        let text = std::fs::read_to_string(path).map_err(|error| FormatError::from_read(path, error))?;
        Self::from_toml(&text).map_err(refused)
    }

    /// The plan of a text; the error says what was found instead.
    pub(super) fn from_toml(text: &str) -> Result<Self, String> {
        let line_of = |error: &toml::de::Error| {
            let line = error.span().map(|span| text[..span.start.min(text.len())].matches('\n').count() + 1);
            line.map_or(String::new(), |line| format!(" in line {line}"))
        };
        let plan: Self = toml::from_str(text)
            .map_err(|error| format!("{}{}", error.message().replace('\n', " "), line_of(&error)))?;
        if plan.format != FORMAT {
            return Err(format!("format {:?}", plan.format));
        }
        if !(1..=VERSION).contains(&plan.format_version) {
            return Err(format!("version {}, written by a newer Lenslet Studio", plan.format_version));
        }
        Ok(plan)
    }

    /// The text of its file.
    ///
    /// # Errors
    /// [`StudyError::Plan`] for a text that TOML cannot hold.
    pub fn to_toml(&self) -> Result<String, StudyError> {
        toml::to_string(self).map_err(|error| StudyError::Plan {
            what: self.name.clone(),
            expected: "a plan that TOML can hold".into(),
            found: error.to_string(),
        })
    }

    /// Writes its file, safely.
    ///
    /// # Errors
    /// [`StudyError`] where it cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), StudyError> {
        let text = self.to_toml()?;
        Ok(write_safely(path, |writer| writer.write_all(text.as_bytes()))?)
    }

    /// The same plan with absolute paths.
    #[must_use]
    pub fn absolute(&self) -> Self {
        let mut plan = self.clone();
        for mask in &mut plan.axes.mask {
            *mask = mask.absolute();
        }
        for source in plan.sets.values_mut() {
            *source = source.absolute();
        }
        for name in &mut plan.axes.objects {
            if let Ok(source) = name.parse::<ObjectSource>() {
                *name = source.absolute().to_string();
            }
        }
        plan
    }

    /// The plan for a first look: every second value of long axes, and less time for each cell.
    #[must_use]
    pub fn quick(&self) -> Self {
        let QuickSettings { seconds, ideal_steps, .. } = self.quick;
        let seconds = if self.estimates.steps.is_some() { None } else { Some(seconds) };
        let estimates = EstimateSettings { seconds, ideal_steps: Some(ideal_steps), ..self.estimates };
        Self {
            axes: self.axes.halved(&self.quick.keep),
            estimates,
            reconstruction: self.reconstruction.map(|settings| settings.complete().within(self.quick.seconds)),
            title: format!("{} (quick)", self.title),
            ..self.clone()
        }
    }

    /// The plan with the published procedure: high-count entropies, a fitted `PixelCNN`, five trials.
    #[must_use]
    pub fn by_paper_protocol(&self) -> Self {
        let estimates = EstimateSettings { protocol: Protocol::Paper, trials: 5, ..self.estimates };
        let axes = Axes { estimator: vec![Estimator::PixelCnn], ..self.axes.clone() };
        Self { axes, estimates, ..self.clone() }
    }

    /// What differs from another plan, for people.
    pub(super) fn difference(&self, other: &Self) -> String {
        let axes = Axis::ALL.into_iter().filter(|&axis| self.axes.names_of(axis) != other.axes.names_of(axis));
        let mut parts: Vec<String> = axes.map(|axis| axis.to_string()).collect();
        let others = [
            (self.axes.zip != other.axes.zip, "zip"),
            (self.sets != other.sets, "sets"),
            (self.estimates != other.estimates, "estimates"),
            (self.reconstruction != other.reconstruction, "reconstruction"),
        ];
        parts.extend(others.into_iter().filter(|(differs, _)| *differs).map(|(_, name)| name.to_owned()));
        parts.join(", ")
    }

    /// The value of a cell, for people.
    pub fn value(&self, facet: Facet, cell: &CellSettings) -> String {
        facet.value(&self.sets, cell)
    }

    /// The cells, in the order of tables: by objects first, by masks last.
    ///
    /// # Errors
    /// [`StudyError`] names the first setting that cannot be computed.
    pub fn cells(&self) -> Result<Vec<CellSettings>, StudyError> {
        self.axes.check()?;
        self.estimates.check()?;
        let reconstruction = self.reconstruction.map(ReconstructionSettings::complete);
        let cells = self.axes.expand(&self.sets, &self.estimates, reconstruction)?;
        for cell in &cells {
            cell.check()?;
        }
        Ok(cells)
    }

    /// Estimated time of a cell: that of its optimizer run, its fits and training, and of what surrounds them.
    pub fn time_of(&self, cell: &CellSettings) -> Duration {
        let fits = cell.estimates.seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        let trials = if cell.estimator == Estimator::Bracket { 1 } else { cell.estimates.trials as u32 };
        let training = cell.reconstruction.and_then(|settings| settings.training_seconds);
        let training = training.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        fits.unwrap_or_default().saturating_mul(trials)
            + training.unwrap_or_default()
            + time_of_design(cell)
            + AROUND_FITS
    }
}
