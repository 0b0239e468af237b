//! Lenslets that runs leave as they are.

use std::collections::BTreeSet;

use crate::workbench::Command;

/// Which lenslets of the open design are locked.
#[derive(Default)]
pub struct Locks {
    indices: BTreeSet<usize>,
    /// Number of the lenslets that the indices are of.
    lenslets: u64,
}

impl Locks {
    /// Indices of the locked lenslets.
    pub fn indices(&self) -> &BTreeSet<usize> {
        &self.indices
    }

    /// Locks lenslets, or unlocks them where all are.
    pub fn toggle(&mut self, lenslets: &BTreeSet<usize>) {
        if lenslets.is_subset(&self.indices) {
            self.indices.retain(|index| !lenslets.contains(index));
        } else {
            self.indices.extend(lenslets);
        }
    }

    /// Follows a command that has left the lenslets of this number.
    pub fn follow(&mut self, command: &Command, lenslets: u64) {
        match command {
            Command::DeleteLenslets(deleted) => {
                let left = self.indices.iter().filter(|index| !deleted.contains(index));
                self.indices = left.map(|index| index - deleted.iter().filter(|gone| *gone < index).count()).collect();
            }
            Command::ReplaceEncoder { .. } | Command::ReplaceDesign { .. } => self.indices.clear(),
            _ => {}
        }
        self.lenslets = lenslets;
    }

    /// Forgets all where the lenslets are others, as after an undo, in another document or by a run: nobody knows which of them
    /// were locked.
    pub fn check(&mut self, lenslets: u64) {
        if self.lenslets != lenslets {
            *self = Self { indices: BTreeSet::new(), lenslets };
        }
    }

    /// Forgets all.
    pub fn forget(&mut self) {
        self.indices.clear();
    }
}
