//! The store of runs: their states, the queue, and the comparison of a result.

use std::fs::File;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::design::{IdealOptimizer, IdealSettings};
use crate::evaluation::EvaluationError;
use crate::formats::{
    DocumentKind, FormatError, check_writable, create_folder, lock_folder, read_if_there, write_safely,
};
use crate::optics::{Encoder, LensletArray, MASK_DOCUMENT_VERSION};
use crate::studies::{STUDY_RECORD, Study, StudyError, StudyRecord, StudySettings};
use crate::workbench::runs::design_run::{RankedStart, Start};
use crate::workbench::runs::score::matches_mask;

/// The kind of the file of an order.
const RUN_ORDER: DocumentKind =
    DocumentKind::unmarked_before("lenslet-studio/run-order", "an order of runs").at_version(MASK_DOCUMENT_VERSION);

/// Extension of the state files.
const STATE: &str = "safetensors";

/// Folder with the newest states of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunStore {
    folder: PathBuf,
}

/// Queue of one or more runs. With the state of the current one it is all that is needed to resume.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunQueue {
    /// The starts, in their order.
    pub starts: Vec<Start>,
    /// Settings of every run.
    pub settings: IdealSettings,
    /// Index of the current start.
    pub at: usize,
    /// Results of the starts so far, the best first.
    pub ranked: Vec<RankedStart>,
    /// Failures, one sentence each.
    #[serde(default)]
    pub failures: Vec<String>,
    /// The last mask of the run that was saved in a design file.
    #[serde(default)]
    pub saved: Option<LensletArray>,
    /// Time budget of each score, seconds; none where scores have a fixed number of steps.
    #[serde(default)]
    pub budget_seconds: Option<f64>,
}

/// A run as it is stored.
#[derive(Clone, Debug)]
pub struct StoredRun {
    /// The queue.
    pub queue: RunQueue,
    /// Newest state of each start, where there is one.
    pub states: Vec<Option<Vec<u8>>>,
}

impl RunQueue {
    /// A queue before its first run.
    pub fn new(starts: Vec<Start>, settings: IdealSettings) -> Self {
        Self { starts, settings, at: 0, ranked: Vec::new(), failures: Vec::new(), saved: None, budget_seconds: None }
    }
}

impl RunStore {
    /// The store in `folder`, which is created if it is missing.
    ///
    /// # Errors
    /// Where the folder cannot be created, or a newer version has written the queue in it.
    pub fn in_folder(folder: &Path) -> Result<Self, EvaluationError> {
        create_folder(folder)?;
        let run = Self { folder: folder.to_path_buf() };
        if RUN_ORDER.is_newer(&run.order()) {
            RUN_ORDER.read::<RunQueue>(&run.order())?;
        }
        Ok(run)
    }

    /// Locks the folder against other programs until the file is dropped.
    ///
    /// # Errors
    /// [`FormatError::Busy`](crate::formats::FormatError::Busy) where another program has locked it.
    pub fn lock(&self) -> Result<Option<File>, EvaluationError> {
        Ok(lock_folder(&self.folder)?)
    }

    /// Path of the state of a single run.
    pub fn run_file(&self) -> PathBuf {
        self.state(0)
    }

    /// Whether a queue of several starts is in the folder.
    pub fn has_order(&self) -> bool {
        let order = RUN_ORDER.read::<RunQueue>(&self.order());
        order.map_or_else(|_| self.order().exists(), |queue| queue.starts.len() > 1)
    }

    /// Checks that the files of the folder can be written.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`](crate::formats::FormatError::NotWritten) for the first of them.
    pub fn check_writable(&self) -> Result<(), EvaluationError> {
        Ok([self.state(0), self.order()].iter().try_for_each(|file| check_writable(file))?)
    }

    /// Path of the state of a start, by its index.
    fn state(&self, start: usize) -> PathBuf {
        let number = if start == 0 { String::new() } else { format!("-{}", start + 1) };
        self.folder.join(format!("run{number}.{STATE}"))
    }

    fn comparison_folder(&self) -> PathBuf {
        self.folder.join("score")
    }

    /// The comparison of a result, as far as it is computed; that of another result is deleted.
    pub(super) fn comparison(&self, settings: StudySettings) -> Result<Study, StudyError> {
        let folder = self.comparison_folder();
        match Study::open(settings.clone(), &folder) {
            Err(error) if error.is_about_another() => {
                std::fs::remove_dir_all(&folder).map_err(|error| FormatError::from_write(&folder, error))?;
                Study::open(settings, &folder)
            }
            opened => opened,
        }
    }

    /// Record of the comparison of a result, as far as it is computed.
    pub fn compared(&self, result: &Encoder) -> Option<StudyRecord> {
        let file = self.comparison_folder().join(STUDY_RECORD);
        StudyRecord::open(&file).ok().filter(|study| matches_mask(study, result))
    }

    fn order(&self) -> PathBuf {
        self.folder.join("order.json")
    }

    /// Newest state of a start, if any.
    ///
    /// # Errors
    /// Where the file cannot be read.
    pub fn load(&self, start: usize) -> Result<Option<Vec<u8>>, EvaluationError> {
        Ok(read_if_there(&self.state(start))?)
    }

    /// Replaces the state of a start atomically.
    ///
    /// # Errors
    /// Where the file cannot be written; the state before then stays.
    pub fn store(&self, start: usize, state: &[u8]) -> Result<(), EvaluationError> {
        Ok(write_safely(&self.state(start), |out| out.write_all(state))?)
    }

    /// Replaces the queue atomically.
    ///
    /// # Errors
    /// Where the file cannot be written; the queue before then stays.
    pub fn note(&self, order: &RunQueue) -> Result<(), EvaluationError> {
        let version = order.starts.iter().map(|start| start.design.document_version()).max().unwrap_or(1);
        Ok(RUN_ORDER.at_version(version).write(&self.order(), order)?)
    }

    /// Removes the run with all its files.
    pub fn remove(&self) {
        let found = std::fs::read_dir(&self.folder).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
        let states = found.filter(|file| file.extension().is_some_and(|ending| ending == STATE));
        for file in states.chain([self.order()]) {
            // A file that cannot be removed is replaced by the next run.
            let _ = std::fs::remove_file(file);
        }
        let _ = std::fs::remove_dir_all(self.comparison_folder());
    }

    /// The queue and the states of its starts; none where files are missing or damaged.
    pub fn last(&self) -> Option<StoredRun> {
        let mut queue: RunQueue = RUN_ORDER.read(&self.order()).ok()?;
        let sound = queue.at < queue.starts.len()
            && queue.starts.iter().all(|start| start.design.check().is_ok())
            && queue.ranked.iter().all(|result| result.design.check().is_ok());
        // Other states are read again when they are resumed.
        let is_wanted = |start: usize, bytes: &[u8]| start != queue.at || IdealOptimizer::state_in(bytes).is_ok();
        let read = |start| self.load(start).ok()?.filter(|bytes| is_wanted(start, bytes));
        let states: Vec<_> = (0..queue.starts.len()).map(read).collect();
        let is_done = |at: usize| queue.ranked.iter().any(|result| result.name == queue.starts[at].name);
        if sound && is_done(queue.at) && states[queue.at].is_none() && queue.at + 1 < queue.starts.len() {
            // The program ended between two starts.
            queue.at += 1;
        }
        sound.then_some(StoredRun { queue, states })
    }
}
