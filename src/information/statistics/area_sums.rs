//! Sums over the part of a bead's spot that falls on a patch.

use std::ops::{Add, Sub};

/// Sums over rectangles of a spot, from a summed-area table.
pub(in crate::information) struct AreaSums<T> {
    cols: usize,
    /// Entry [r, c] of (rows + 1) x (cols + 1): the sum over all pixels above and left.
    table: Vec<T>,
}

/// A rectangle of a spot: places of its corners in the table, bottom right, top right, bottom left, top left.
pub(in crate::information) type Corners = [u32; 4];

impl<T: Copy + Default + Add<Output = T> + Sub<Output = T>> AreaSums<T> {
    /// Sums of `value(row, col)` over rectangles of a spot of `shape` (rows, cols).
    pub(in crate::information) fn new(shape: (usize, usize), mut value: impl FnMut(usize, usize) -> T) -> Self {
        let (rows, cols) = shape;
        let mut table = vec![T::default(); (rows + 1) * (cols + 1)];
        for r in 0..rows {
            let mut along_row = T::default();
            for c in 0..cols {
                along_row = along_row + value(r, c);
                table[(r + 1) * (cols + 1) + c + 1] = table[r * (cols + 1) + c + 1] + along_row;
            }
        }
        Self { cols, table }
    }

    /// Sum over the whole spot.
    pub(in crate::information) fn total(&self) -> T {
        self.table[self.table.len() - 1]
    }

    /// Sum over a rectangle.
    pub(in crate::information) fn over(&self, corners: Corners) -> T {
        let [bottom_right, top_right, bottom_left, top_left] = corners.map(|at| self.table[at as usize]);
        bottom_right - top_right - bottom_left + top_left
    }

    /// The part of the spot on the patch when its last pixel lies on patch pixel (row, col) `last`. `last` may also
    /// lie beyond the patch's far side.
    pub(in crate::information) fn overlap(&self, last: (usize, usize), patch: (usize, usize)) -> Corners {
        let rows = self.table.len() / (self.cols + 1) - 1;
        // Spot pixel r lies on patch row last - (rows - 1) + r.
        let span = |last: usize, length: usize, side: usize| {
            let first = (length - 1).saturating_sub(last);
            (first, (side + length - 1 - last).min(length))
        };
        let (top, bottom) = span(last.0, rows, patch.0);
        let (left, right) = span(last.1, self.cols, patch.1);
        let at = |row: usize, col: usize| (row * (self.cols + 1) + col) as u32;
        [at(bottom, right), at(top, right), at(bottom, left), at(top, left)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_overlap_is_the_sum_of_what_falls_on_the_patch() {
        let value = |r: usize, c: usize| (1 + r * 10 + c * c) as f64;
        let (shape, patch) = ((3, 4), (5, 2));
        let sums = AreaSums::new(shape, value);
        for last in (0..7_usize).flat_map(|row| (0..5_usize).map(move |col| (row, col))) {
            let mut expected = 0.0;
            for (r, c) in (0..3).flat_map(|r| (0..4).map(move |c| (r, c))) {
                // The last spot pixel is (2, 3).
                let (row, col) = ((last.0 + r).checked_sub(2), (last.1 + c).checked_sub(3));
                if row.is_some_and(|row| row < patch.0) && col.is_some_and(|col| col < patch.1) {
                    expected += value(r, c);
                }
            }
            assert_eq!(sums.over(sums.overlap(last, patch)), expected, "{last:?}");
        }
    }
}
