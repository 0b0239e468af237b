//! Locked lenslets, which runs leave unchanged.

use std::collections::{BTreeMap, BTreeSet};

use crate::workbench::Command;

/// Set of the locked lenslets of the open design.
#[derive(Default)]
pub struct Locks {
    indices: BTreeSet<usize>,
    /// Number of the lenslet list that the indices refer to.
    lenslets: u64,
    /// Locks of other lenslet lists by number, for undo and redo.
    others: BTreeMap<u64, BTreeSet<usize>>,
}

impl Locks {
    /// Indices of the locked lenslets.
    pub fn indices(&self) -> &BTreeSet<usize> {
        &self.indices
    }

    /// Locks lenslets, or unlocks them if all are locked.
    pub fn toggle(&mut self, lenslets: &BTreeSet<usize>) {
        if lenslets.is_subset(&self.indices) {
            self.indices.retain(|index| !lenslets.contains(index));
        } else {
            self.indices.extend(lenslets);
        }
    }

    /// Updates the indices after a command, whose result is the lenslet list of this number.
    pub fn follow(&mut self, command: &Command, lenslets: u64) {
        if lenslets == self.lenslets {
            return;
        }
        self.keep();
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

    /// Restores the locks of the lenslet list of this number, for example after an undo. A list of another document or a
    /// run has none.
    pub fn check(&mut self, lenslets: u64) {
        if self.lenslets != lenslets {
            self.keep();
            self.indices = self.others.remove(&lenslets).unwrap_or_default();
            self.lenslets = lenslets;
        }
    }

    /// Stores the locks of the current list.
    fn keep(&mut self) {
        if self.indices.is_empty() {
            self.others.remove(&self.lenslets);
        } else {
            self.others.insert(self.lenslets, self.indices.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Lenslet;

    #[test]
    fn undo_restores_locks() {
        let set = |indices: &[usize]| indices.iter().copied().collect::<BTreeSet<_>>();
        let mut locks = Locks::default();
        locks.check(1);
        locks.toggle(&set(&[1, 3]));
        locks.follow(&Command::DeleteLenslets(vec![0]), 2);
        assert_eq!(*locks.indices(), set(&[0, 2]));
        locks.follow(&Command::AddLenslet(Lenslet::round(16.0, 16.0, 1.0, 1.0)), 3);
        locks.toggle(&set(&[0]));
        assert_eq!(*locks.indices(), set(&[2]));
        for (lenslets, locked) in [(2, &[0, 2][..]), (1, &[1, 3]), (2, &[0, 2]), (3, &[2]), (7, &[])] {
            locks.check(lenslets);
            assert_eq!(*locks.indices(), set(locked), "{lenslets}");
        }
    }
}
