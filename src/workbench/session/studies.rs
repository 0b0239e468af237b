//! The study of a session.

use std::path::PathBuf;

use crate::forward::Design;
use crate::studies::plans::{CellState, Plan, StudyMask};
use crate::workbench::session::Session;
use crate::workbench::studies::queue::{StudyQueue, StudyView};

impl Session {
    /// Opens the study of a folder, or begins a plan there.
    ///
    /// # Errors
    /// One sentence where a study is running.
    pub fn open_study(&self, plan: Option<Plan>, path: PathBuf) -> Result<(), String> {
        let path = std::path::absolute(&path).unwrap_or(path);
        self.study.change(|queue| queue.open(plan.map(Box::new), path))
    }

    /// Computes the cells of the open study that have no result.
    pub fn start_study(&self) {
        self.study.publish(StudyQueue::start);
    }

    /// Pauses or resumes the study.
    pub fn pause_study(&self, pause: bool) {
        self.study.publish(|queue| queue.pause(pause));
    }

    /// Stops the study. Finished cells stay in the folder.
    pub fn stop_study(&self) {
        self.study.publish(StudyQueue::stop);
    }

    /// The study as of now.
    pub fn study(&self) -> StudyView {
        self.study.look(|queue| queue.view().clone())
    }

    /// The design of a cell of the open study. A mask that is designed has one once its run has ended.
    ///
    /// # Errors
    /// One sentence where the mask cannot be read or is not designed yet.
    pub fn design_of_cell(&self, index: usize) -> Result<Design, String> {
        let view = self.study();
        let Some(open) = view.open.filter(|open| index < open.states.len()) else {
            return Err("no study is open".into());
        };
        let cell = &open.folder.cells()[index];
        match &cell.mask {
            StudyMask::Given(_) => {
                let mask = cell.open_mask().map_err(|error| error.to_string())?;
                Ok(cell.design(mask.encoder))
            }
            StudyMask::Ideal { .. } if matches!(open.states[index], CellState::Done(_)) => {
                Design::open(&open.folder.design_file(index)).map_err(|error| error.to_string())
            }
            StudyMask::Ideal { .. } => Err("the mask of this cell is not designed yet".into()),
        }
    }
}
