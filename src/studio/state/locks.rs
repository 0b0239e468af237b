//! Lenslets that runs leave as they are.

use std::collections::{BTreeMap, BTreeSet};

use crate::workbench::Command;

/// Which lenslets of the open design are locked.
#[derive(Default)]
pub struct Locks {
    indices: BTreeSet<usize>,
    /// Number of the lenslets that the indices are of.
    lenslets: u64,
    /// The indices of others, by their numbers, to which an undo or a redo may go.
    others: BTreeMap<u64, BTreeSet<usize>>,
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

    /// Where the lenslets are others, takes those that were locked when these were last there, as after an undo; none in another
    /// document or by a run.
    pub fn check(&mut self, lenslets: u64) {
        if self.lenslets != lenslets {
            self.keep();
            self.indices = self.others.remove(&lenslets).unwrap_or_default();
            self.lenslets = lenslets;
        }
    }

    /// Keeps the indices for the time that these lenslets come back.
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
    fn locks_come_back_with_the_lenslets_that_they_were_on() {
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
