//! Unsaved work of a session: its autosave, and what earlier programs left behind.

use std::path::Path;
use std::sync::Arc;

use crate::formats::FormatError;
use crate::workbench::document::autosave::{Autosave, Recovered, Unsaved};
use crate::workbench::session::Session;

impl Session {
    /// Saves the design in a folder while it has unsaved changes or a trained network that is in no file, so that they survive the
    /// program; see [`Session::note_unsaved`]. Returns what earlier programs left there without being closed, newest first.
    ///
    /// # Errors
    /// Where the folder cannot be written to.
    pub fn keep_unsaved_in(&mut self, folder: &Path) -> Result<Vec<Recovered>, FormatError> {
        let (autosave, found) = Autosave::in_folder(folder, Arc::clone(&self.wake))?;
        // A copy in the earlier folder stays until there is one here.
        let earlier = self.autosave.replace(autosave);
        self.earlier_autosave = self.earlier_autosave.take().or(earlier);
        Ok(found)
    }

    /// Designs left by programs without being closed, in another folder than the one of this program, newest first; none where the folder
    /// cannot be written to.
    pub fn left_unsaved_in(folder: &Path) -> Vec<Recovered> {
        if !folder.is_dir() {
            return Vec::new();
        }
        Autosave::in_folder(folder, Arc::new(|| ())).map(|(_, found)| found).unwrap_or_default()
    }

    /// Saves design and trained network to their autosave files, a few seconds late. To be called for every frame of the window.
    /// Returns the failure of the last attempt, once.
    pub fn note_unsaved(&mut self) -> Option<String> {
        let unsaved = Unsaved { is_changed: self.is_dirty(), network: self.unsaved_network() };
        let design = self.open.as_ref().unwrap_or(&self.design);
        let autosave = self.autosave.as_mut()?;
        let failure = autosave.note(design, self.contents, unsaved, self.path.as_deref());
        if autosave.is_done()
            && let Some(earlier) = self.earlier_autosave.take()
        {
            earlier.close();
        }
        failure
    }

    /// Closes the session, after the person was asked about unsaved changes.
    pub fn close(&mut self) {
        for autosave in self.autosave.take().into_iter().chain(self.earlier_autosave.take()) {
            autosave.close();
        }
    }

    /// Opens a recovered design with its network; it has unsaved changes.
    pub fn recover(&mut self, recovered: Recovered) {
        self.load_unsaved(recovered.design.clone(), recovered.path.clone());
        match &recovered.network {
            Some(network) => self.add_network(network, self.document, None),
            None => self.find_network(),
        }
        if let Some(autosave) = &mut self.autosave {
            autosave.supersede(recovered);
        }
    }
}
