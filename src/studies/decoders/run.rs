//! Computing a study of decoders cell by cell.

use std::fs::File;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::plot::scatter_plot;
use super::record::{DecoderStudyCell, DecoderStudyRecord, SensorInformation};
use super::report::{CSV_HEADER, csv_rows, markdown};
use super::settings::{DecoderStudySettings, PlannedCell};
use crate::evaluation::estimation::estimate_on_patches;
use crate::evaluation::{DensityModel, EstimateProgress, EstimateRequest, EvaluationError, WeightsFiles};
use crate::formats::{create_folder, lock_folder, write_csv_text, write_safely};
use crate::forward::open_set;
use crate::information::{EngineChoice, Estimator, Protocol};
use crate::progress::Progress;
use crate::reconstruction::{DecoderKind, DecoderQuality, ReconstructionError, TrainingBudget};
use crate::studies::error::StudyError;
use crate::studies::image_quality::QualityRequest;
use crate::studies::machine::Machine;

/// The file that holds the study; the others are made from it.
const RECORD: &str = "decoders.json";
/// Patches of the score of an information estimate: few whole sensors suffice.
const TEST_PATCHES: usize = 300;
const TRAINING_PATCHES: usize = 10_000;

/// A study of decoders in its folder: `decoders.json`, the tables `decoders.md` and `decoders.csv`, and the plot `decoders.svg`.
#[derive(Debug)]
pub struct DecoderStudy {
    folder: PathBuf,
    record: DecoderStudyRecord,
    /// Held while the study is open, so that no other run computes the same cells.
    _lock: Option<File>,
}

/// Progress of a study of decoders.
#[derive(Clone, Debug)]
pub struct DecoderStudyEvent<'a> {
    /// Cells that are done.
    pub done: usize,
    /// Cells of the study.
    pub cells: usize,
    /// Objects, mask and decoder of the current cell.
    pub name: &'a str,
    /// The cell, once it is computed and in the file.
    pub finished: Option<&'a DecoderStudyCell>,
}

impl DecoderStudy {
    /// Opens the study of `folder`, which is created if it is missing, or starts it there.
    ///
    /// # Errors
    /// [`StudyError`] where the settings cannot be computed, or the folder holds a study of other settings, by another version of the
    /// program, or a file that is none.
    pub fn open(mut settings: DecoderStudySettings, folder: &Path) -> Result<Self, StudyError> {
        settings.check()?;
        let designs = settings.designs.clone();
        for index in 0..settings.objects.len() {
            let design = settings.design(&settings.objects[index], &designs[0]);
            let set = open_set(&design).map_err(EvaluationError::from)?;
            settings.objects[index].fingerprint = set.fingerprint();
        }
        create_folder(folder)?;
        let lock = lock_folder(folder)?;
        let mut record = DecoderStudyRecord::new(settings);
        let path = folder.join(RECORD);
        if path.exists() {
            let earlier = DecoderStudyRecord::open(&path)?;
            record.check_same(&earlier, &path)?;
            earlier.cells.into_iter().for_each(|cell| record.put(cell));
        }
        Ok(Self { folder: folder.to_path_buf(), record, _lock: lock })
    }

    /// The record of the study so far.
    pub fn record(&self) -> &DecoderStudyRecord {
        &self.record
    }

    /// The files of the study once it has run.
    pub fn files(&self) -> Vec<PathBuf> {
        [RECORD, "decoders.md", "decoders.csv", "decoders.svg"].map(|name| self.folder.join(name)).into()
    }

    /// The cells without a result: their number, and the time of their fits and trainings. Reading, linear estimates and chains come on
    /// top.
    pub fn missing(&self) -> (usize, Duration) {
        let settings = &self.record.settings;
        let plan = settings.plan();
        let missing =
            plan.iter().filter(|planned| !self.record.cell(planned).is_some_and(DecoderStudyCell::is_computed));
        let seconds: Vec<f64> = missing
            .map(|planned| match planned.decoder {
                None => settings.information_seconds,
                Some(DecoderKind::Network | DecoderKind::Unet) => settings.training_seconds,
                Some(_) => 0.0,
            })
            .collect();
        (seconds.len(), Duration::from_secs_f64(seconds.iter().sum()))
    }

    /// The study as Markdown tables.
    pub fn markdown(&self) -> String {
        markdown(&self.record)
    }

    /// Computes the missing cells. After every cell the files hold it. Failed cells have their sentence in the record.
    ///
    /// # Errors
    /// [`StudyError::Cancelled`] where `progress` cancels, and where a file cannot be written.
    pub fn run(
        &mut self,
        progress: &mut (dyn for<'a> Progress<DecoderStudyEvent<'a>> + Send),
    ) -> Result<(), StudyError> {
        self.write()?;
        let settings = self.record.settings.clone();
        let plan = settings.plan();
        let machine = Machine::here();
        for (done, planned) in plan.iter().enumerate() {
            if self.record.cell(planned).is_some_and(DecoderStudyCell::is_computed) {
                continue;
            }
            let (name, cells) = (planned.name(), plan.len());
            let mut poll = || progress.report(&DecoderStudyEvent { done, cells, name: &name, finished: None });
            let cell = DecoderStudyCell {
                objects: planned.objects.source.to_string(),
                design: planned.design.name.clone(),
                decoder: planned.decoder,
                information: None,
                quality: None,
                failure: None,
                machine: machine.clone(),
            };
            let cell = match planned.decoder {
                None => match information(&settings, planned, &mut poll) {
                    Ok(information) => DecoderStudyCell { information: Some(information), ..cell },
                    Err(error) if error.is_cancelled() => return Err(StudyError::Cancelled),
                    Err(error) => DecoderStudyCell { failure: Some(error.to_string()), ..cell },
                },
                Some(decoder) => match quality(&settings, planned, decoder, &mut poll) {
                    Ok(quality) => DecoderStudyCell { quality: Some(quality), ..cell },
                    Err(ReconstructionError::Cancelled) => return Err(StudyError::Cancelled),
                    Err(error) => DecoderStudyCell { failure: Some(error.to_string()), ..cell },
                },
            };
            self.record.put(cell.clone());
            self.write()?;
            let event = DecoderStudyEvent { done: done + 1, cells, name: &name, finished: Some(&cell) };
            if progress.report(&event).is_break() {
                return Err(StudyError::Cancelled);
            }
        }
        Ok(())
    }

    fn write(&self) -> Result<(), StudyError> {
        self.record.save(&self.folder.join(RECORD))?;
        let text = self.markdown();
        write_safely(&self.folder.join("decoders.md"), |writer| writer.write_all(text.as_bytes()))?;
        write_csv_text(&self.folder.join("decoders.csv"), &CSV_HEADER, csv_rows(&self.record).into_iter())?;
        let plot = scatter_plot(&self.record)?;
        write_safely(&self.folder.join("decoders.svg"), |writer| writer.write_all(plot.as_bytes()))?;
        Ok(())
    }
}

/// Information of the whole sensor: a bracket for beads, whose lower bound ranks masks, and the causal model for images.
fn information(
    settings: &DecoderStudySettings,
    planned: &PlannedCell<'_>,
    poll: &mut (dyn FnMut() -> ControlFlow<()> + Send),
) -> Result<SensorInformation, EvaluationError> {
    let estimator = if planned.objects.source.is_beads() { Estimator::Bracket } else { Estimator::Causal };
    let budget = Duration::try_from_secs_f64(settings.information_seconds).unwrap_or_default();
    let request = EstimateRequest {
        model: DensityModel::new(estimator, Some(budget), EngineChoice::default()),
        protocol: Protocol::Default,
        patch: None,
        patches_train: TRAINING_PATCHES,
        patches_test: TEST_PATCHES,
        fresh: false,
        trials: 1,
        keep: None,
        weights: WeightsFiles::default(),
    };
    let design = settings.design(planned.objects, planned.design);
    let (estimate, _) = estimate_on_patches(&design, &request, &mut |_: &EstimateProgress| poll())?;
    Ok(SensorInformation::of(&estimate))
}

/// Image quality of a decoder on held-out objects.
fn quality(
    settings: &DecoderStudySettings,
    planned: &PlannedCell<'_>,
    kind: DecoderKind,
    poll: &mut (dyn FnMut() -> ControlFlow<()> + Send),
) -> Result<DecoderQuality, ReconstructionError> {
    let request = QualityRequest {
        kind,
        protocol: settings.protocol,
        training: TrainingBudget::Seconds(settings.training_seconds),
        sweeps: settings.sweeps,
        test_objects: settings.test,
        seed: settings.seed,
    };
    request.measure(&settings.design(planned.objects, planned.design), poll)
}
