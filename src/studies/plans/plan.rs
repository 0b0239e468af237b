//! A plan and its TOML file.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::axes::{Axes, Axis};
use super::cell::CellSettings;
use super::estimates::EstimateSettings;
use super::facet::{Facet, distinct};
use super::ideal_settings::time_of_design;
use super::reconstruction::ReconstructionSettings;
use crate::formats::{FormatError, split_end, write_safely};
use crate::information::{Estimator, Protocol};
use crate::objects::ObjectSource;
use crate::plural::counted;
use crate::reconstruction::DecoderKind;
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
    /// The decoder whose image quality every cell reports, if any, and settings of its test. The axis of decoders replaces the decoder.
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
    /// Whether PSNR is drawn against information, with a point for each cell that has a decoder. `x` then names the points.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub scatter: bool,
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
        Self { seconds: 10.0, ideal_steps: 400, keep: Vec::new() }
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
            reconstruction: self.shared_reconstruction().map(|settings| settings.within(self.quick.seconds)),
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

    /// Name of a cell, with that of its set for the objects.
    pub fn name_of(&self, cell: &CellSettings) -> String {
        cell.name_with(&self.value(Facet::Axis(Axis::Objects), cell))
    }

    /// A sentence for each file of objects or masks of these cells that is not there; those cells will fail.
    pub fn missing_files(&self, cells: &[CellSettings]) -> Vec<String> {
        let mut counts: BTreeMap<&Path, usize> = BTreeMap::new();
        for path in cells.iter().flat_map(|cell| cell.objects.path().into_iter().chain(cell.mask.source().path())) {
            *counts.entry(path).or_default() += 1;
        }
        let missing = counts.into_iter().filter(|(path, _)| !is_there(path));
        let sentence = |(path, count): (&Path, usize)| {
            format!("{}: no such file or folder; {} with it will fail", path.display(), counted(count, "cell"))
        };
        missing.map(sentence).collect()
    }

    /// The decoders: those of the axis, or the one of the reconstruction.
    pub fn decoders(&self) -> Vec<DecoderKind> {
        if self.axes.decoder.is_empty() {
            return self.reconstruction.iter().map(|settings| settings.decoder).collect();
        }
        self.axes.decoder.iter().filter_map(|decoder| decoder.kind()).collect()
    }

    /// Settings that all decoders share; none without decoders. Their decoder is one that is trained, where there is one.
    pub fn shared_reconstruction(&self) -> Option<ReconstructionSettings> {
        let kinds = self.decoders();
        let decoder = *kinds.iter().find(|kind| kind.needs().training).or(kinds.first())?;
        let usual = ReconstructionSettings::of(decoder);
        Some(ReconstructionSettings { decoder, ..self.reconstruction.unwrap_or(usual) })
    }

    fn of_decoder(&self, decoder: DecoderKind) -> ReconstructionSettings {
        let usual = ReconstructionSettings::of(decoder);
        ReconstructionSettings { decoder, ..self.reconstruction.unwrap_or(usual) }.complete()
    }

    /// The cells, in the order of tables: by objects first, by masks last. Cells whose decoder does not fit their objects are left out.
    ///
    /// # Errors
    /// [`StudyError`] names the first setting that cannot be computed, and objects that no decoder of the plan fits.
    pub fn cells(&self) -> Result<Vec<CellSettings>, StudyError> {
        let (cells, left_out) = self.crossed()?;
        // Objects change slowest.
        let mut with_cells: Vec<_> = cells.iter().map(|cell| &cell.objects).collect();
        with_cells.dedup();
        for cell in left_out.iter().filter(|cell| !with_cells.contains(&&cell.objects)) {
            cell.check()?;
        }
        for cell in &cells {
            cell.check()?;
        }
        Ok(cells)
    }

    /// One sentence on the cells that are left out, as their decoder does not fit their objects; none where all fit.
    ///
    /// # Errors
    /// As [`Plan::cells`].
    pub fn left_out(&self) -> Result<Option<String>, StudyError> {
        let (_, cells) = self.crossed()?;
        let objects = distinct(cells.iter().map(|cell| self.value(Facet::Axis(Axis::Objects), cell))).join(", ");
        let sentence = |cell: &CellSettings| {
            format!("decoder {} is for beads: {} of {objects} left out", cell.decoder(), counted(cells.len(), "cell"))
        };
        Ok(cells.first().map(sentence))
    }

    /// The cells whose decoder fits their objects, and the others.
    fn crossed(&self) -> Result<(Vec<CellSettings>, Vec<CellSettings>), StudyError> {
        self.axes.check()?;
        self.estimates.check()?;
        let of_axis = self.axes.decoder.iter().map(|decoder| decoder.kind().map(|kind| self.of_decoder(kind)));
        let reconstructions: Vec<_> = if self.axes.decoder.is_empty() {
            vec![self.reconstruction.map(ReconstructionSettings::complete)]
        } else {
            of_axis.collect()
        };
        let cells = self.axes.expand(&self.sets, &self.estimates, &reconstructions)?;
        Ok(cells.into_iter().partition(CellSettings::decoder_fits))
    }
}

/// Whether a file or folder is there, whose path may end with options such as `?frame=1`.
fn is_there(path: &Path) -> bool {
    path.exists() || split_end(path, b'?').is_some_and(|(file, _)| file.exists())
}

/// Estimated times of cells that are computed one after another. The first cell of an estimate has its time; the others share it.
pub fn times_of<'a>(cells: impl IntoIterator<Item = &'a CellSettings>) -> Vec<Duration> {
    let mut estimates = HashSet::new();
    cells.into_iter().map(|cell| time_of(cell, estimates.insert(cell.estimate_id()))).collect()
}

/// Estimated time of a cell: that of its optimizer run and its fits, unless another cell has the same, of its training, and of what
/// surrounds them.
pub(super) fn time_of(cell: &CellSettings, with_estimate: bool) -> Duration {
    let training = cell.reconstruction.and_then(|settings| settings.training_seconds);
    let training = training.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()).unwrap_or_default();
    if !with_estimate {
        return training + AROUND_FITS;
    }
    let fits = cell.estimates.seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    let trials = if cell.estimator == Estimator::Bracket { 1 } else { cell.estimates.trials as u32 };
    fits.unwrap_or_default().saturating_mul(trials) + training + time_of_design(cell) + AROUND_FITS
}
