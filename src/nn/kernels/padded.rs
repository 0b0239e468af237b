//! Images with a border of zeros, laid out so that a neighbour is always the same number of pixels away.

use std::ops::Range;

/// A stack of images in one array in which every image is followed by a row of zeros, and every row by one zero
/// pixel.
///
/// The zeros serve the row or image before and after them, so a 3x3 window reads one array without checks for edges.
/// The array begins and ends with as many zeros as such a window reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PaddedImages {
    /// Number of images.
    pub images: usize,
    /// Rows of one image, px.
    pub rows: usize,
    /// Columns of one image, px.
    pub cols: usize,
}

impl PaddedImages {
    /// Pixels from one pixel to the one below it.
    pub fn stride(self) -> usize {
        self.cols + 1
    }

    /// Pixels of the array, zeros included.
    pub fn positions(self) -> usize {
        self.covered().end + self.stride() + 1
    }

    /// Pixels between the leading and the trailing zeros.
    pub fn covered(self) -> Range<usize> {
        let first = self.stride() + 1;
        first..first + self.images * (self.rows + 1) * self.stride()
    }

    /// Place of the first pixel of every image row, in the order of a stack without borders.
    pub fn row_starts(self) -> impl Iterator<Item = usize> {
        let first = self.covered().start;
        (0..self.images * self.rows).map(move |row| first + (row + row / self.rows) * self.stride())
    }

    /// Offsets of a pixel's 3x3 window, row by row.
    pub fn window(self) -> [isize; 9] {
        let stride = self.stride() as isize;
        std::array::from_fn(|tap| (tap as isize / 3 - 1) * stride + tap as isize % 3 - 1)
    }

    /// Sets the borders between rows and images of `values` (positions, channels) to zero.
    pub fn clear_borders(self, channels: usize, values: &mut [f32]) {
        let mut clear = |range: Range<usize>| values[range.start * channels..range.end * channels].fill(0.0);
        let mut end = self.covered().start;
        for start in self.row_starts() {
            clear(end..start);
            end = start + self.cols;
        }
        clear(end..self.covered().end);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_lie_between_zeros() {
        let grid = PaddedImages { images: 2, rows: 3, cols: 2 };
        let mut values = vec![1.0; grid.positions() * 2];
        grid.clear_borders(2, &mut values);
        let covered = grid.covered();
        let sum: f32 = values[2 * covered.start..2 * covered.end].iter().sum();
        assert_eq!(sum, 24.0, "two channels of twelve pixels are left");
        let starts: Vec<usize> = grid.row_starts().collect();
        assert_eq!(starts, [4, 7, 10, 16, 19, 22]);
        assert!(starts.iter().all(|start| values[2 * start..2 * start + 4].iter().all(|&value| value == 1.0)));
        assert_eq!(grid.window(), [-4, -3, -2, -1, 0, 1, 2, 3, 4]);
        assert!(covered.start >= 4 && grid.positions() >= covered.end + 4);
    }
}
