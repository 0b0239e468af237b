//! A run from a design, in the hands of whoever keeps its states.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::record::IdealRecord;
use crate::design::{Ideal, IdealSettings, IdealState, OnIdeal};
use crate::formats::{create_folder, read_if_there, read_json, write_json, write_safely};
use crate::optics::LensletArray;
use crate::workbench::simulation::{imaging, open_set};
use crate::workbench::{Design, EvaluationError};

/// Takes a state of a run, which lies between two of its rounds.
pub(super) type Keep<'a> = &'a mut dyn FnMut(&Ideal<'_>) -> Result<(), EvaluationError>;

/// Lets the mask of a design climb the information of its measurements, from the start or from a state (`from`) of the same
/// run; `keep` gets the run after every round.
///
/// # Errors
/// Where design, objects, noise and settings allow no run, a state is of another one, or `watch` breaks off.
pub fn run_ideal(
    design: &Design,
    settings: &IdealSettings,
    from: Option<&[u8]>,
    keep: Keep<'_>,
    watch: OnIdeal<'_>,
) -> Result<IdealRecord, EvaluationError> {
    let set = open_set(design)?;
    let imaging = imaging(design, &set)?;
    let mut ideal = Ideal::new(&imaging, start_of(design)?, design.limits, settings.clone())?;
    if let Some(bytes) = from {
        ideal = ideal.resumed(bytes)?;
        ideal.extend_to(settings.steps);
    }
    while !ideal.is_finished() {
        ideal.advance(watch)?;
        keep(&ideal)?;
    }
    Ok(IdealRecord::new(design, &ideal))
}

/// The lenslets of a design.
pub(super) fn start_of(design: &Design) -> Result<&LensletArray, EvaluationError> {
    design.encoder.lenslets().ok_or_else(|| EvaluationError::NoLenslets { mask: design.encoder.describe() })
}

/// A folder that holds the last state of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeptRun {
    folder: PathBuf,
}

/// What a run was started from: beside its state this is all that is needed to go on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptStart {
    /// The design.
    pub start: Design,
    /// What is done.
    pub settings: IdealSettings,
}

impl KeptRun {
    /// The run in `folder`, which is made if need be.
    ///
    /// # Errors
    /// Where the folder cannot be made.
    pub fn in_folder(folder: &Path) -> Result<Self, EvaluationError> {
        create_folder(folder)?;
        Ok(Self { folder: folder.to_path_buf() })
    }

    fn state(&self) -> PathBuf {
        self.folder.join("run.safetensors")
    }

    fn start(&self) -> PathBuf {
        self.folder.join("start.json")
    }

    /// The state that was kept last, if any.
    ///
    /// # Errors
    /// Where the file cannot be read.
    pub fn load(&self) -> Result<Option<Vec<u8>>, EvaluationError> {
        Ok(read_if_there(&self.state())?)
    }

    /// Puts the state of a run in place of the last one, safely.
    ///
    /// # Errors
    /// Where the file cannot be written; the last state is then still there.
    pub fn store(&self, ideal: &Ideal<'_>) -> Result<(), EvaluationError> {
        let bytes = ideal.to_bytes()?;
        Ok(write_safely(&self.state(), |out| out.write_all(&bytes))?)
    }

    /// Notes what the run of this folder does from here on.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn begin(&self, start: &KeptStart) -> Result<(), EvaluationError> {
        Ok(write_json(&self.start(), start)?)
    }

    /// Forgets the run.
    pub fn end(&self) {
        // A file that stays behind is replaced by the next run.
        let _ = std::fs::remove_file(self.state());
        let _ = std::fs::remove_file(self.start());
    }

    /// The run that was begun here and neither accepted nor given up; none where its files are missing or broken.
    pub fn last(&self) -> Option<(KeptStart, Vec<u8>, IdealState)> {
        let start: KeptStart = read_json(&self.start()).ok()?;
        let bytes = self.load().ok()??;
        let state = Ideal::state_in(&bytes).ok()?;
        start.start.check().is_ok().then_some((start, bytes, state))
    }
}
