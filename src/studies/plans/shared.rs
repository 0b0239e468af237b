//! Estimates that cells share, as they differ in their reconstruction alone.

use std::collections::HashMap;

use super::cell::{CellRecord, CellSettings, StudyMask};
use super::folder::{CellState, StudyFolder};
use crate::formats::{FormatError, read_if_there, write_safely};
use crate::studies::error::StudyError;

/// The cells that have each estimate.
#[derive(Default)]
pub(super) struct SharedEstimates(HashMap<String, usize>);

impl SharedEstimates {
    /// Notes a cell that is done.
    pub fn note(&mut self, index: usize, cell: &CellSettings) {
        self.0.entry(cell.estimate_id()).or_insert(index);
    }

    /// The finished cell with the estimate of `cell`, where there is one.
    ///
    /// # Errors
    /// As [`StudyFolder::state`].
    pub fn of(&self, folder: &StudyFolder, cell: &CellSettings) -> Result<Option<SharedEstimate>, StudyError> {
        let Some(&index) = self.0.get(&cell.estimate_id()) else { return Ok(None) };
        let CellState::Done(record) = folder.state(index)? else { return Ok(None) };
        Ok(Some(SharedEstimate { index, record }))
    }
}

/// A finished cell whose estimate another one takes.
pub(super) struct SharedEstimate {
    index: usize,
    /// The finished cell.
    pub record: Box<CellRecord>,
}

impl SharedEstimate {
    /// Id of the cell that computed the estimate.
    pub fn id(&self, folder: &StudyFolder) -> String {
        self.record.estimate_of.clone().unwrap_or_else(|| folder.ids()[self.index].clone())
    }

    /// Lays the designed mask of the finished cell beside the cell `index`.
    ///
    /// # Errors
    /// Where a file cannot be read or written.
    pub fn copy_design(&self, folder: &StudyFolder, index: usize) -> Result<(), FormatError> {
        let file = folder.design_file(index);
        let is_designed = matches!(self.record.settings.mask, StudyMask::Ideal { .. });
        if is_designed
            && !file.exists()
            && let Some(bytes) = read_if_there(&folder.design_file(self.index))?
        {
            write_safely(&file, |writer| writer.write_all(&bytes))?;
        }
        Ok(())
    }
}
