//! Lenslets that runs leave as they are.

use std::collections::BTreeSet;

use crate::workbench::Command;

/// Which lenslets of the open design are locked.
#[derive(Default)]
pub struct Locks {
    indices: BTreeSet<usize>,
    /// Number of the document that they are in.
    document: u64,
    /// Lenslets of the design that the indices are of.
    count: usize,
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

    /// Follows a command that has left so many lenslets.
    pub fn follow(&mut self, command: &Command, count: usize) {
        match command {
            Command::DeleteLenslets(deleted) => {
                let left = self.indices.iter().filter(|index| !deleted.contains(index));
                self.indices = left.map(|index| index - deleted.iter().filter(|gone| *gone < index).count()).collect();
            }
            Command::ReplaceEncoder { .. } | Command::ReplaceDesign { .. } => self.indices.clear(),
            _ => {}
        }
        self.count = count;
    }

    /// Forgets all where another document is open, or lenslets came or went otherwise, as by a run or an undo: nobody
    /// knows which of them were locked.
    pub fn check(&mut self, document: u64, count: usize) {
        if (self.document, self.count) != (document, count) {
            *self = Self { indices: BTreeSet::new(), document, count };
        }
    }
}
