//! Computing a study cell by cell, so that whatever stops it costs the current cell at most.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::evaluation::estimation::estimate_on_patches;
use crate::evaluation::{EstimateProgress, EstimateRequest, EvaluationError};
use crate::formats::{create_folder, lock_folder, write_csv_text, write_safely};
use crate::forward::{Design, open_set};
use crate::information::{Estimate, PairedDifference, TestPatches};
use crate::progress::Progress;
use crate::studies::comparison::record::{StudyCell, StudyRecord};
use crate::studies::comparison::settings::{PlannedCell, StudySettings};
use crate::studies::comparison::tables::{CSV_HEADER, csv_row, markdown};
use crate::studies::error::StudyError;
use crate::studies::machine::Machine;

/// The file that holds a study; the others are made from it.
pub const RECORD: &str = "study.json";

/// Function that computes a cell; tests use a quicker one.
type Estimator<'a> = &'a dyn Fn(
    &Design,
    &EstimateRequest,
    &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Estimated, EvaluationError>;
/// An estimate, and the information of each test patch by its density model.
type Estimated = (Estimate, TestPatches);

/// A study in its folder: `study.json` and the tables `study.md` and `study.csv`. A study that was started without a folder is
/// in memory alone.
#[derive(Debug)]
pub struct Study {
    folder: Option<PathBuf>,
    record: StudyRecord,
    /// Held while the study is open, so that no other run computes the same cells.
    _lock: Option<File>,
}

/// Progress of the current cell.
#[derive(Clone, Debug, PartialEq)]
pub struct StudyStep<'a> {
    /// Number of the cell among all, from 1.
    pub number: usize,
    /// Cells of the study.
    pub cells: usize,
    /// Objects, design and patch.
    pub name: &'a str,
    /// Progress of its estimate.
    pub progress: &'a EstimateProgress,
    /// Estimated time for this cell and the later ones.
    pub left: Duration,
}

/// An event of a running study.
#[derive(Clone, Debug, PartialEq)]
pub enum StudyEvent<'a> {
    /// A cell is being computed.
    Step(StudyStep<'a>),
    /// A cell was computed, or failed, and is in the file.
    Done {
        /// Number of the cell among all, from 1.
        number: usize,
        /// Cells of the study.
        cells: usize,
        /// The cell.
        cell: &'a StudyCell,
    },
}

impl Study {
    /// Opens the study of `folder`, which is created if it is missing, or starts it there. Objects are read, so that changed ones are
    /// detected.
    ///
    /// # Errors
    /// [`StudyError`] where the settings cannot be computed, or the folder holds a study of other settings, by another
    /// version of the program, or a file that is none.
    pub fn open(settings: StudySettings, folder: &Path) -> Result<Self, StudyError> {
        let Self { record, .. } = Self::begin(settings)?;
        create_folder(folder)?;
        let lock = lock_folder(folder)?;
        let path = folder.join(RECORD);
        let mut record = record.as_read(&path)?;
        if path.exists() {
            let earlier = StudyRecord::open(&path)?;
            record.check_same(&earlier, &path)?;
            for cell in earlier.cells {
                record.put(cell);
            }
        }
        Ok(Self { folder: Some(folder.to_path_buf()), record, _lock: lock })
    }

    /// Starts a study that is not stored.
    ///
    /// # Errors
    /// [`StudyError`] where the settings cannot be computed.
    pub fn begin(mut settings: StudySettings) -> Result<Self, StudyError> {
        settings.check()?;
        let Some(first) = settings.designs.first().cloned() else { return Err(StudyError::Cancelled) };
        let mut notices = Vec::new();
        for index in 0..settings.objects.len() {
            let design = settings.design(&settings.objects[index], &first);
            let set = open_set(&design).map_err(EvaluationError::from)?;
            settings.objects[index].fingerprint = set.fingerprint();
            notices.extend(set.understood().map(|understood| format!("{}: {understood}", design.objects)));
            notices.extend(set.notices().iter().map(|notice| format!("{}: {notice}", design.objects)));
        }
        Ok(Self { folder: None, record: StudyRecord { notices, ..StudyRecord::new(settings) }, _lock: None })
    }

    /// The record of the study so far.
    pub fn record(&self) -> &StudyRecord {
        &self.record
    }

    /// Number of cells without an estimate; failed ones are tried again.
    pub fn missing(&self) -> usize {
        self.record.settings.plan().iter().filter(|planned| !self.has(planned)).count()
    }

    /// Estimated time for the missing cells.
    pub fn time_left(&self) -> Duration {
        self.time_of_cell().mul_f64(self.missing() as f64)
    }

    /// The files of the study once it has run; none for one without a folder.
    pub fn files(&self) -> Vec<PathBuf> {
        let Some(folder) = &self.folder else { return Vec::new() };
        [RECORD, "study.md", "study.csv"].into_iter().map(|name| folder.join(name)).collect()
    }

    /// The study as a Markdown table with its settings and its summary.
    pub fn markdown(&self) -> String {
        markdown(&self.record)
    }

    /// Computes the missing cells. After every cell the files hold it. Failed cells have their sentence in the record.
    ///
    /// # Errors
    /// [`StudyError::Cancelled`] where `progress` cancels, and where a file cannot be written.
    pub fn run(&mut self, progress: &mut (dyn for<'a> Progress<StudyEvent<'a>> + Send)) -> Result<(), StudyError> {
        self.run_with(&|design, request, progress| estimate_on_patches(design, request, progress), progress)
    }

    /// [`Study::run`] with another function in place of the estimate.
    pub(super) fn run_with(
        &mut self,
        estimator: Estimator<'_>,
        progress: &mut (dyn for<'a> Progress<StudyEvent<'a>> + Send),
    ) -> Result<(), StudyError> {
        // A folder that cannot be written is reported now, not after the first cell.
        self.write()?;
        let settings = self.record.settings.clone();
        let plan = settings.plan();
        let machine = Machine::here();
        for (index, planned) in plan.iter().enumerate() {
            if self.has(planned) {
                continue;
            }
            let result = self.compute(&settings, index, planned, estimator, progress)?;
            let (result, patches) = match result {
                Ok((estimate, patches)) => (Ok(estimate), patches),
                Err(sentence) => (Err(sentence), TestPatches::default()),
            };
            let cell = StudyCell::new(planned, &settings, result, machine.clone());
            let cell = self.compared(cell, planned, patches);
            self.record.put(cell.clone());
            self.write()?;
            let event = StudyEvent::Done { number: index + 1, cells: plan.len(), cell: &cell };
            if progress.report(&event).is_break() {
                return Err(StudyError::Cancelled);
            }
        }
        Ok(())
    }

    /// A cell with the information of its test patches for the first design, or with the difference to the first design on the same
    /// patches.
    fn compared(&self, cell: StudyCell, planned: &PlannedCell<'_>, patches: TestPatches) -> StudyCell {
        let settings = &self.record.settings;
        let [first, _, ..] = settings.designs.as_slice() else { return cell };
        if cell.estimate.is_none() || planned.design.encoder.grid() != first.encoder.grid() {
            return cell;
        }
        if planned.design.name == first.name {
            return StudyCell { patch_information: patches.information, ..cell };
        }
        let is_first = |other: &&StudyCell| {
            (&other.objects, &other.design, other.patch) == (&cell.objects, &first.name, cell.patch)
        };
        let of = self.record.cells.iter().find(is_first).map_or(&[][..], |of| &of.patch_information);
        // A value that is not finite has failed as an estimate.
        let difference_to_reference = PairedDifference::new(of, &patches, settings.seed).unwrap_or_default();
        StudyCell { difference_to_reference, ..cell }
    }

    /// The estimate of a cell, or the sentence that says why there is none.
    fn compute(
        &self,
        settings: &StudySettings,
        index: usize,
        planned: &PlannedCell<'_>,
        estimator: Estimator<'_>,
        progress: &mut (dyn for<'a> Progress<StudyEvent<'a>> + Send),
    ) -> Result<Result<Estimated, String>, StudyError> {
        let (start, expected) = (Instant::now(), self.time_of_cell());
        let others = expected.mul_f64(self.missing().saturating_sub(1) as f64);
        let name = planned.name();
        let result = estimator(
            &settings.design(planned.objects, planned.design),
            &settings.request(planned.patch)?,
            &mut |estimate: &EstimateProgress| {
                let left = others + expected.saturating_sub(start.elapsed());
                let (number, cells) = (index + 1, settings.cells());
                progress.report(&StudyEvent::Step(StudyStep { number, cells, name: &name, progress: estimate, left }))
            },
        );
        match result {
            Ok((estimate, _)) if estimate.objects_fingerprint != planned.objects.fingerprint => Ok(Err(
                "its objects changed while the study ran; put them back as they were, or begin in another folder"
                    .into(),
            )),
            Ok(estimated) => Ok(Ok(estimated)),
            Err(error) if error.is_cancelled() => Err(StudyError::Cancelled),
            Err(error) => Ok(Err(error.to_string())),
        }
    }

    fn has(&self, planned: &PlannedCell<'_>) -> bool {
        let fingerprint = &planned.objects.fingerprint;
        let is_of_these = |cell: &StudyCell| {
            cell.estimate.as_ref().is_some_and(|estimate| estimate.objects_fingerprint == *fingerprint)
        };
        self.record.cells.iter().any(|cell| cell.is(planned) && is_of_these(cell))
    }

    /// Estimated time of a cell: the mean of the computed ones, which includes what a budget leaves out, or the budget.
    fn time_of_cell(&self) -> Duration {
        let estimates = self.record.cells.iter().filter_map(|cell| cell.estimate.as_ref());
        let seconds: Vec<f64> = estimates.map(|estimate| estimate.seconds).collect();
        let mean = seconds.iter().sum::<f64>() / seconds.len() as f64;
        Duration::try_from_secs_f64(mean).unwrap_or_else(|_| self.record.settings.budget())
    }

    fn write(&self) -> Result<(), StudyError> {
        let Some(folder) = &self.folder else { return Ok(()) };
        self.record.save(&folder.join(RECORD))?;
        let text = self.markdown();
        write_safely(&folder.join("study.md"), |writer| writer.write_all(text.as_bytes()))?;
        let rows = self.record.cells.iter().map(|cell| csv_row(&self.record.settings, cell));
        write_csv_text(&folder.join("study.csv"), &CSV_HEADER, rows)?;
        Ok(())
    }
}
