//! The selected lenslets.

use std::collections::BTreeSet;

use crate::optics::{Lenslet, LensletArray};

/// Indices of the selected lenslets. Mask and lenslet table share them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    indices: BTreeSet<usize>,
}

impl Selection {
    /// The indices, smallest first.
    pub fn indices(&self) -> &BTreeSet<usize> {
        &self.indices
    }

    /// Whether the lenslet of this index is selected.
    pub fn contains(&self, index: usize) -> bool {
        self.indices.contains(&index)
    }

    /// Selects a lenslet; with `add`, toggles it in the selection.
    pub fn select(&mut self, index: usize, add: bool) {
        if !add {
            self.indices.clear();
        }
        if !self.indices.insert(index) {
            self.indices.remove(&index);
        }
    }

    /// Replaces the selection.
    pub fn set(&mut self, indices: impl IntoIterator<Item = usize>) {
        self.indices = indices.into_iter().collect();
    }

    /// Selects nothing.
    pub fn clear(&mut self) {
        self.indices.clear();
    }

    /// Drops indices that a mask of `count` lenslets does not have.
    pub fn truncate(&mut self, count: usize) {
        self.indices.retain(|&index| index < count);
    }

    /// The selected lenslets of a mask with their indices.
    pub fn of(&self, array: &LensletArray) -> Vec<(usize, Lenslet)> {
        self.indices.iter().filter_map(|&index| Some((index, *array.lenslets.get(index)?))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::heuristic_layout;

    fn selected(indices: &[usize]) -> Selection {
        Selection { indices: indices.iter().copied().collect() }
    }

    #[test]
    fn selecting_replaces_and_adding_toggles() {
        let mut selection = selected(&[1, 4]);
        selection.select(4, false);
        assert_eq!(selection, selected(&[4]), "a lenslet selected before stays selected");
        selection.select(2, true);
        assert_eq!(selection, selected(&[2, 4]));
        selection.select(4, true);
        assert_eq!(selection, selected(&[2]));
    }

    #[test]
    fn indices_beyond_the_mask_select_nothing() {
        let array = heuristic_layout(3);
        let mut selection = selected(&[0, 2, 3]);
        assert_eq!(selection.of(&array), [(0, array.lenslets[0]), (2, array.lenslets[2])]);
        selection.truncate(2);
        assert_eq!(selection, selected(&[0]));
    }
}
