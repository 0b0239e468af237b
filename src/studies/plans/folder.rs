//! The folder of a study: its plan, and one file for each cell that was computed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::cell::{CELL, CellRecord, CellSettings};
use super::plan::Plan;
use super::shard::Shard;
use crate::formats::{FormatError, create_folder};
use crate::information::NUMBERS_VERSION;
use crate::studies::error::StudyError;

/// The file of the plan.
const PLAN: &str = "plan.toml";
/// Folder of the cells.
const CELLS: &str = "cells";

/// State of a cell in a folder.
#[derive(Clone, Debug, PartialEq)]
pub enum CellState {
    /// There is no result yet.
    Waiting,
    /// It has an estimate.
    Done(Box<CellRecord>),
    /// It failed; the record has the sentence. A later run tries it again.
    Failed(Box<CellRecord>),
    /// Its file cannot be used, as the sentence says. A later run replaces it.
    Unusable(String),
}

impl CellState {
    /// The record of a cell with an estimate.
    pub fn done(&self) -> Option<&CellRecord> {
        if let Self::Done(record) = self { Some(record) } else { None }
    }

    /// The sentence about a cell that failed or cannot be used.
    pub fn failure(&self) -> Option<&str> {
        match self {
            Self::Failed(record) => record.failure.as_deref(),
            Self::Unusable(sentence) => Some(sentence),
            Self::Waiting | Self::Done(_) => None,
        }
    }
}

/// A plan in its folder: `plan.toml`, and `cells/ID.json` for every cell with a result.
#[derive(Clone, Debug)]
pub struct StudyFolder {
    path: PathBuf,
    plan: Plan,
    cells: Vec<CellSettings>,
    ids: Vec<String>,
}

impl StudyFolder {
    /// Begins a study in `path`, or resumes the same plan there. A plan with all cells of the one there, and more, takes its place.
    ///
    /// # Errors
    /// [`StudyError`] where the plan has no cells, or the folder holds another plan.
    pub fn begin(plan: Plan, path: &Path) -> Result<Self, StudyError> {
        let cells = plan.cells()?;
        let file = path.join(PLAN);
        if file.exists() {
            let there = Self::open(path)?;
            if there.cells == cells {
                return Ok(there);
            }
            // A plan may grow: its cells stay.
            if !there.cells.iter().all(|cell| cells.contains(cell)) {
                return Err(StudyError::OtherPlan { path: path.into(), found: there.plan.difference(&plan) });
            }
        } else if path.join(crate::studies::comparison::STUDY_RECORD).exists() {
            return Err(StudyError::EarlierStudy { path: path.into() });
        }
        create_folder(&path.join(CELLS))?;
        plan.save(&file)?;
        Ok(Self::of(plan, cells, path))
    }

    /// Opens the study of a folder.
    ///
    /// # Errors
    /// [`StudyError`] where the folder holds no plan that this version knows.
    pub fn open(path: &Path) -> Result<Self, StudyError> {
        if !Self::is_at(path) {
            return Err(StudyError::NoPlan { path: path.into() });
        }
        let plan = Self::read_plan(path)?;
        let cells = plan.cells()?;
        create_folder(&path.join(CELLS))?;
        Ok(Self::of(plan, cells, path))
    }

    fn of(plan: Plan, cells: Vec<CellSettings>, path: &Path) -> Self {
        let ids = cells.iter().map(CellSettings::id).collect();
        Self { path: path.to_path_buf(), plan, cells, ids }
    }

    /// Whether a folder holds a study.
    pub fn is_at(path: &Path) -> bool {
        path.join(PLAN).is_file()
    }

    /// The plan in a folder.
    ///
    /// # Errors
    /// [`StudyError`] where it cannot be read.
    pub fn read_plan(path: &Path) -> Result<Plan, StudyError> {
        Plan::open(&path.join(PLAN))
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The cells, in the order of tables.
    pub fn cells(&self) -> &[CellSettings] {
        &self.cells
    }

    /// The id of each cell, in the same order.
    pub fn ids(&self) -> &[String] {
        &self.ids
    }

    /// Rank of each cell, by which cells are dealt to tasks.
    pub fn ranks(&self) -> Vec<usize> {
        Shard::ranks(&self.cells)
    }

    /// File of a cell's result.
    pub fn cell_file(&self, index: usize) -> PathBuf {
        self.path.join(CELLS).join(format!("{}.json", self.ids[index]))
    }

    /// File of a cell's state while it is computed.
    pub(super) fn state_file(&self, index: usize) -> PathBuf {
        self.path.join(CELLS).join(format!("{}.state", self.ids[index]))
    }

    /// File of a cell's design, where an optimizer makes its mask.
    pub fn design_file(&self, index: usize) -> PathBuf {
        self.path.join(CELLS).join(format!("{}.design.json", self.ids[index]))
    }

    /// File of the optimizer's state while a cell's mask is designed.
    pub(super) fn design_state_file(&self, index: usize) -> PathBuf {
        self.path.join(CELLS).join(format!("{}.design.state", self.ids[index]))
    }

    /// State of a cell.
    ///
    /// # Errors
    /// Where its file is there and cannot be read.
    pub fn state(&self, index: usize) -> Result<CellState, StudyError> {
        let file = self.cell_file(index);
        if !file.exists() {
            return Ok(CellState::Waiting);
        }
        let record = match CELL.read::<CellRecord>(&file) {
            Ok(record) => record,
            Err(error @ FormatError::Malformed { .. }) => {
                let found = error.to_string();
                return Ok(CellState::Unusable(format!(
                    "{}: expected a whole cell; run the study again ({found})",
                    file.display()
                )));
            }
            Err(error) => return Err(error.into()),
        };
        if record.program_version != NUMBERS_VERSION {
            let found = record.program_version;
            return Ok(CellState::Unusable(format!(
                "{}: expected numbers of version {NUMBERS_VERSION}, found {found}; run the study again",
                file.display()
            )));
        }
        if record.settings != self.cells[index] {
            return Ok(CellState::Unusable(format!(
                "{}: expected the cell of its name, found another; run the study again",
                file.display()
            )));
        }
        let record = Box::new(record);
        Ok(if record.estimate.is_some() { CellState::Done(record) } else { CellState::Failed(record) })
    }

    /// States of all cells, in the order of tables.
    ///
    /// # Errors
    /// As [`StudyFolder::state`].
    pub fn states(&self) -> Result<Vec<CellState>, StudyError> {
        (0..self.cells.len()).map(|index| self.state(index)).collect()
    }

    /// Writes the result of a cell, safely.
    pub(super) fn put(&self, index: usize, record: &CellRecord) -> Result<(), StudyError> {
        Ok(CELL.write(&self.cell_file(index), record)?)
    }

    /// Number of cells by the words of their states, for a summary.
    pub fn counts(states: &[CellState]) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        for state in states {
            let word = match state {
                CellState::Waiting => "waiting",
                CellState::Done(_) => "done",
                CellState::Failed(_) => "failed",
                CellState::Unusable(_) => "unusable",
            };
            *counts.entry(word).or_default() += 1;
        }
        counts
    }
}
