//! The file of a study of decoders.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::published::published_psnr_db;
use super::settings::{DecoderStudySettings, PlannedCell};
use crate::formats::{DocumentKind, FormatError, read_json, write_json};
use crate::information::{Estimate, NUMBERS_VERSION};
use crate::optics::MASK_DOCUMENT_VERSION;
use crate::reconstruction::{DecoderKind, DecoderQuality};
use crate::studies::error::StudyError;
use crate::studies::machine::Machine;
use crate::studies::published::published;
use crate::studies::rank::{pearson, spearman};

/// The kind of the file.
const STUDY: DocumentKind =
    DocumentKind::new("lenslet-studio/decoder-study", "a study of decoders").at_version(MASK_DOCUMENT_VERSION);
/// The published patch, px.
const PUBLISHED_PATCH: Option<(usize, usize)> = Some((32, 32));

/// A study of decoders as it stands in its file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct DecoderStudyRecord {
    /// Always "lenslet-studio/decoder-study".
    pub format: String,
    /// Version of the fields.
    pub format_version: u64,
    /// Version of the program that computed the cells.
    pub program_version: String,
    /// Settings of the study.
    pub settings: DecoderStudySettings,
    /// The cells computed so far, in the order of the settings.
    pub cells: Vec<DecoderStudyCell>,
    /// Correlations of the cells so far; reading ignores them.
    #[serde(skip_deserializing)]
    pub correlations: Vec<Correlation>,
}

/// Information of the whole sensor, bits per pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct SensorInformation {
    /// Lower bound, for beads.
    pub lower: Option<f64>,
    /// Its 95 % interval.
    pub lower_interval_95: Option<[f64; 2]>,
    /// Upper bound.
    pub upper: f64,
    /// Its 95 % interval.
    pub upper_interval_95: [f64; 2],
    /// Time of the estimate, seconds.
    pub seconds: f64,
}

impl SensorInformation {
    pub(super) fn of(estimate: &Estimate) -> Self {
        let lower_interval_95 = estimate.bracket.as_ref().and_then(|bracket| bracket.lower_interval_95);
        Self {
            lower: estimate.lower(),
            lower_interval_95,
            upper: estimate.bits_per_pixel,
            upper_interval_95: estimate.interval_95,
            seconds: estimate.seconds,
        }
    }

    /// The lower bound where there is one, which ranks masks without the looseness of a density model; else the upper one.
    pub fn best(&self) -> f64 {
        self.lower.unwrap_or(self.upper)
    }
}

/// One cell: information or quality, or the sentence that says why there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct DecoderStudyCell {
    /// The objects, by the text of their source.
    pub objects: String,
    /// The mask, by its name in the settings.
    pub design: String,
    /// The decoder; `None` for the information.
    pub decoder: Option<DecoderKind>,
    /// Information, in a cell without decoder.
    pub information: Option<SensorInformation>,
    /// Image quality, in a cell with a decoder.
    pub quality: Option<DecoderQuality>,
    /// Why there is none of them.
    pub failure: Option<String>,
    /// Machine that computed the cell.
    pub machine: Machine,
}

/// Agreement of the PSNR of a decoder with information, over the masks of one set of objects.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Correlation {
    /// The objects.
    pub objects: String,
    /// The decoder; `None` for the published PSNR.
    pub decoder: Option<DecoderKind>,
    /// Masks compared.
    pub designs: usize,
    /// Spearman's rank correlation with the information of the whole sensor.
    pub spearman_sensor: Option<f64>,
    /// Pearson's correlation with the information of the whole sensor.
    pub pearson_sensor: Option<f64>,
    /// Spearman's rank correlation with the published information of patches of 32 x 32 px.
    pub spearman_published: Option<f64>,
    /// Pearson's correlation with the published information.
    pub pearson_published: Option<f64>,
}

/// What is known of one mask imaging one set of objects.
pub(super) struct MaskRow<'a> {
    pub design: &'a str,
    pub lenslets: Option<usize>,
    pub information: Option<SensorInformation>,
    pub published_bits: Option<f64>,
    pub published_psnr_db: Option<f64>,
    /// By the decoders of the settings.
    pub quality: Vec<Option<&'a DecoderQuality>>,
}

impl DecoderStudyRecord {
    /// A study without cells.
    pub(super) fn new(settings: DecoderStudySettings) -> Self {
        Self {
            format: STUDY.format.into(),
            format_version: settings.document_version(),
            program_version: NUMBERS_VERSION.into(),
            settings,
            cells: Vec::new(),
            correlations: Vec::new(),
        }
    }

    /// The study of a file.
    ///
    /// # Errors
    /// [`StudyError`] where the file cannot be read, is no study of decoders, or one of a newer version.
    pub fn open(path: &Path) -> Result<Self, StudyError> {
        let value = read_json(path)?;
        let refused =
            |found: String, advice| StudyError::Refused { path: path.into(), version: STUDY.version, found, advice };
        STUDY.version_of(&value).map_err(|mismatch| refused(mismatch.to_string(), "choose another folder"))?;
        let mut record: Self = serde_path_to_error::deserialize(value)
            .map_err(|error| refused(error.to_string(), "restore it from a backup, or choose another folder"))?;
        record.correlations = record.correlate();
        Ok(record)
    }

    /// Refuses the study of another version of the program, or of other settings.
    pub(super) fn check_same(&self, earlier: &Self, path: &Path) -> Result<(), StudyError> {
        if self.program_version != earlier.program_version {
            let (expected, found) = (self.program_version.clone(), earlier.program_version.clone());
            return Err(StudyError::OtherVersion { path: path.into(), expected, found });
        }
        // The texts in a file are what two studies share.
        let text = |settings: &DecoderStudySettings| serde_json::to_value(settings).unwrap_or_default();
        let (here, there) = (text(&self.settings), text(&earlier.settings));
        if here == there {
            return Ok(());
        }
        let names =
            ["decoders", "protocol", "test", "sweeps", "training_seconds", "information_seconds", "seed", "objects"];
        let what = names.into_iter().find(|&name| here[name] != there[name]).unwrap_or("designs");
        let (expected, found) = (here[what].to_string(), there[what].to_string());
        Err(StudyError::Changed { path: path.into(), what, expected, found })
    }

    /// Writes the file, whole or not at all.
    pub(super) fn save(&self, path: &Path) -> Result<(), FormatError> {
        write_json(path, self)
    }

    /// The cell of a plan, if it was computed.
    pub(super) fn cell(&self, planned: &PlannedCell<'_>) -> Option<&DecoderStudyCell> {
        self.cells.iter().find(|cell| cell.is(planned))
    }

    /// Puts a cell in its place.
    pub(super) fn put(&mut self, cell: DecoderStudyCell) {
        self.cells
            .retain(|old| (&old.objects, &old.design, old.decoder) != (&cell.objects, &cell.design, cell.decoder));
        self.cells.push(cell);
        let mut cells = std::mem::take(&mut self.cells);
        let plan = self.settings.plan();
        cells.sort_by_key(|cell| plan.iter().position(|planned| cell.is(planned)));
        self.cells = cells;
        self.correlations = self.correlate();
    }

    /// All masks of one set of objects.
    pub(super) fn rows(&self, objects: usize) -> Vec<MaskRow<'_>> {
        let settings = &self.settings;
        let objects = &settings.objects[objects];
        let row = |design| {
            let cell = |decoder| self.cell(&PlannedCell { objects, design, decoder });
            let of_paper = crate::forward::Design { bias_photons: 10.0, ..settings.design(objects, design) };
            let lenslets = design.lenslets();
            MaskRow {
                design: &design.name,
                lenslets,
                information: cell(None).and_then(|cell| cell.information),
                published_bits: published(&of_paper, objects.published_as, PUBLISHED_PATCH)
                    .map(|known| known.bits_per_pixel),
                published_psnr_db: lenslets
                    .and_then(|count| published_psnr_db(&objects.source, objects.published_as, count)),
                quality: settings
                    .decoders
                    .iter()
                    .map(|&decoder| cell(Some(decoder)).and_then(|cell| cell.quality.as_ref()))
                    .collect(),
            }
        };
        settings.designs.iter().map(row).collect()
    }

    fn correlate(&self) -> Vec<Correlation> {
        let mut correlations = Vec::new();
        for (index, objects) in self.settings.objects.iter().enumerate() {
            let rows = self.rows(index);
            let of_decoder = |place: Option<usize>| {
                let psnr = |row: &MaskRow<'_>| match place {
                    Some(place) => row.quality[place].map(|quality| quality.psnr_db),
                    None => row.published_psnr_db,
                };
                let pairs = |bits: &dyn Fn(&MaskRow<'_>) -> Option<f64>| -> Vec<(f64, f64)> {
                    rows.iter().filter_map(|row| bits(row).zip(psnr(row))).collect()
                };
                let sensor = pairs(&|row| row.information.map(|information| information.best()));
                // The same masks, so that the two compare.
                let published = pairs(&|row| row.information.and(row.published_bits));
                Correlation {
                    objects: objects.source.to_string(),
                    decoder: place.map(|place| self.settings.decoders[place]),
                    designs: sensor.len(),
                    spearman_sensor: spearman(&sensor),
                    pearson_sensor: pearson(&sensor),
                    spearman_published: spearman(&published),
                    pearson_published: pearson(&published),
                }
            };
            let places = (0..self.settings.decoders.len()).map(Some).chain([None]);
            correlations.extend(places.map(of_decoder).filter(|found| found.designs > 2));
        }
        correlations
    }
}

impl DecoderStudyCell {
    /// Whether this is the cell of the plan.
    fn is(&self, planned: &PlannedCell<'_>) -> bool {
        self.decoder == planned.decoder
            && self.design == planned.design.name
            && self.objects == planned.objects.source.to_string()
    }

    /// Whether it holds a result.
    pub(super) fn is_computed(&self) -> bool {
        self.information.is_some() || self.quality.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::super::plot::scatter_plot;
    use super::super::report::{CSV_HEADER, csv_rows, markdown};
    use super::*;
    use crate::information::Protocol;

    fn quality(decoder: DecoderKind, psnr_db: f64) -> DecoderQuality {
        DecoderQuality {
            decoder,
            protocol: Protocol::Default,
            psnr_db,
            psnr_db_interval_95: [psnr_db - 0.1, psnr_db + 0.1],
            ssim: 0.8,
            ssim_interval_95: [0.7, 0.9],
            mse: 0.001,
            mse_interval_95: [0.0009, 0.0011],
            r2: Some(0.7),
            r2_interval_95: Some([0.6, 0.8]),
            psnr_constant_db: 23.7,
            psnr_constant_db_interval_95: [23.6, 23.8],
            psnr_unclipped_db: psnr_db,
            psnr_unclipped_db_interval_95: [psnr_db - 0.1, psnr_db + 0.1],
            psnr_linear_closed_form_db: None,
            psnr_posterior_db: None,
            test_objects: 20,
            networks: 0,
            peak_photons: 100.0,
            seed: 1,
            seconds: 1.0,
        }
    }

    /// PSNR of the posterior mean rises with information, that of the linear estimate falls.
    fn record() -> DecoderStudyRecord {
        let mut record = DecoderStudyRecord::new(DecoderStudySettings::beads());
        for count in [3, 1, 2, 4] {
            let information = SensorInformation {
                lower: Some(0.1 * f64::from(count)),
                lower_interval_95: Some([0.1 * f64::from(count) - 0.01, 0.1 * f64::from(count) + 0.01]),
                upper: 0.5,
                upper_interval_95: [0.49, 0.51],
                seconds: 3.0,
            };
            for decoder in [None, Some(DecoderKind::Linear), Some(DecoderKind::Posterior)] {
                let psnr = match decoder {
                    Some(DecoderKind::Linear) => 27.0 - f64::from(count),
                    _ => 27.0 + f64::from(count * count),
                };
                record.put(DecoderStudyCell {
                    objects: "beads:0.02".into(),
                    design: format!("heuristic:{count}"),
                    decoder,
                    information: decoder.is_none().then_some(information),
                    quality: decoder.map(|decoder| quality(decoder, psnr)),
                    failure: None,
                    machine: Machine::here(),
                });
            }
        }
        record
    }

    #[test]
    fn correlations_are_those_of_the_cells() {
        let record = record();
        assert_eq!(record.cells.len(), 12);
        assert_eq!((record.cells[0].design.as_str(), record.cells[0].decoder), ("heuristic:1", None));
        let of = |decoder| record.correlations.iter().find(|found| found.decoder == decoder).unwrap();
        let (linear, posterior) = (of(Some(DecoderKind::Linear)), of(Some(DecoderKind::Posterior)));
        assert_eq!((linear.designs, linear.spearman_sensor, posterior.spearman_sensor), (4, Some(-1.0), Some(1.0)));
        assert!((linear.pearson_sensor.unwrap() + 1.0).abs() < 1e-12);
        // 1, 4, 9, 16 against 1, 2, 3, 4.
        assert!((posterior.pearson_sensor.unwrap() - 25.0 / (129.0_f64 * 5.0).sqrt()).abs() < 1e-12);
        // Published PSNR of one to four lenslets: the third is the best.
        assert!((of(None).spearman_sensor.unwrap() - 0.4).abs() < 1e-12);
        assert_eq!(of(None).spearman_published, of(None).spearman_sensor);
    }

    #[test]
    fn tables_and_plot_hold_the_cells() {
        let record = record();
        let text = markdown(&record);
        assert!(
            text.contains("| 3 | 0.300 [0.290, 0.310] | 0.477 | 28.15 | 24.000 [23.900, 24.100] | 36.000"),
            "{text}"
        );
        assert!(text.contains("| 9 | - | 0.570 | 27.33 | - | - |"), "{text}");
        assert!(text.contains("- Linear MMSE: PSNR and information of the whole sensor: Spearman -1.00"), "{text}");
        let rows = csv_rows(&record);
        assert!(rows.len() == 18 && rows.iter().all(|row| row.len() == CSV_HEADER.len()));
        assert_eq!(rows[1][..4], ["beads:0.02", "heuristic:1", "Posterior mean", "28.0"]);
        let svg = scatter_plot(&record).unwrap();
        assert!(svg.contains("\nPSNR (dB)\n") && svg.contains("\nbeads:0.02\n") && !svg.contains("NaN"));
        // Four masks of two decoders and of the published U-net, and the legend.
        assert_eq!(svg.matches("<circle").count(), 4 * 3 + 3);
        let empty = DecoderStudyRecord::new(DecoderStudySettings::beads());
        assert!(!scatter_plot(&empty).unwrap().contains("NaN"));
    }

    #[test]
    fn files_of_other_studies_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("decoders.json");
        let record = record();
        record.save(&path).unwrap();
        let read = DecoderStudyRecord::open(&path).unwrap();
        assert_eq!((&read.cells, &read.correlations), (&record.cells, &record.correlations));
        record.check_same(&read, &path).unwrap();
        let other = DecoderStudySettings { test: 21, ..DecoderStudySettings::beads() };
        let error = DecoderStudyRecord::new(other).check_same(&read, &path).unwrap_err().to_string();
        assert!(error.contains("expected a study with test 21, found one with 500"), "{error}");
        std::fs::write(&path, "{\"format\": \"lenslet-studio/study\", \"format_version\": 1}").unwrap();
        assert!(DecoderStudyRecord::open(&path).is_err());
    }
}
