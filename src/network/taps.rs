//! Taps of masked, dilated convolutions: which neighbours a pixel sees, gathered into columns for a matrix product.
//!
//! Only the taps that a mask leaves open are gathered, so masked ones cost nothing.

use super::arithmetic::vectorised;

/// A stack of images that lie one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Number of images.
    pub samples: usize,
    /// Rows of one image, px.
    pub rows: usize,
    /// Columns of one image, px.
    pub cols: usize,
}

impl Grid {
    /// Pixels of all images.
    pub fn pixels(self) -> usize {
        self.samples * self.rows * self.cols
    }
}

/// Offsets (rows down, columns right) from a pixel to those it sees; outside the image there are zeros.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Taps {
    offsets: Vec<(isize, isize)>,
}

impl Taps {
    /// Taps at these offsets (rows down, columns right), px.
    pub fn new(offsets: impl Into<Vec<(isize, isize)>>) -> Self {
        Self { offsets: offsets.into() }
    }

    /// Number of taps.
    pub fn count(&self) -> usize {
        self.offsets.len()
    }

    /// Offsets (rows down, columns right) from a pixel to those it sees, px.
    pub fn offsets(&self) -> &[(isize, isize)] {
        &self.offsets
    }

    /// Writes what each pixel of `input` (pixels, channels) sees to `columns` (pixels, taps, channels).
    pub fn gather(&self, grid: Grid, channels: usize, input: &[f32], columns: &mut [f32]) {
        match channels {
            48 => gather_48(self, grid, input, columns),
            64 => gather_64(self, grid, input, columns),
            _ => self.gather_by(grid, channels, input, columns),
        }
    }

    /// Inlined, so that a constant number of channels turns the copies into a few vector moves.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "the constant number of channels must reach the inner loop")]
    fn gather_by(&self, grid: Grid, channels: usize, input: &[f32], columns: &mut [f32]) {
        let wide = self.count() * channels;
        for (line, columns) in columns.chunks_exact_mut(grid.cols * wide).enumerate() {
            let row = line % grid.rows;
            for (tap, &(down, right)) in self.offsets.iter().enumerate() {
                let source = source_line(line, row, down, grid);
                let (first, last) = seen(grid.cols, right);
                for (col, column) in columns.chunks_exact_mut(wide).enumerate() {
                    let out = &mut column[tap * channels..(tap + 1) * channels];
                    match source {
                        Some(source) if (first..last).contains(&col) => {
                            let at = (source * grid.cols).wrapping_add(col).wrapping_add_signed(right) * channels;
                            out.copy_from_slice(&input[at..at + channels]);
                        }
                        _ => out.fill(0.0),
                    }
                }
            }
        }
    }

    /// The transpose of [`Taps::gather`]: adds each column entry to the pixel it was read from.
    pub fn scatter_add(&self, grid: Grid, channels: usize, columns: &[f32], output: &mut [f32]) {
        match channels {
            48 => scatter_48(self, grid, columns, output),
            64 => scatter_64(self, grid, columns, output),
            _ => self.scatter_by(grid, channels, columns, output),
        }
    }

    #[inline(always)]
    #[allow(clippy::inline_always, reason = "the constant number of channels must reach the inner loop")]
    fn scatter_by(&self, grid: Grid, channels: usize, columns: &[f32], output: &mut [f32]) {
        let wide = self.count() * channels;
        for (line, columns) in columns.chunks_exact(grid.cols * wide).enumerate() {
            let row = line % grid.rows;
            for (tap, &(down, right)) in self.offsets.iter().enumerate() {
                let Some(source) = source_line(line, row, down, grid) else { continue };
                let (first, last) = seen(grid.cols, right);
                for col in first..last {
                    let at = (source * grid.cols + col).wrapping_add_signed(right) * channels;
                    let from = col * wide + tap * channels;
                    let column = &columns[from..from + channels];
                    for (sum, value) in output[at..at + channels].iter_mut().zip(column) {
                        *sum += value;
                    }
                }
            }
        }
    }
}

vectorised! {
    fn gather_48<'a>(taps: &'a Taps, grid: Grid, input: &'a [f32], columns: &'a mut [f32]) {
        taps.gather_by(grid, 48, input, columns);
    }
}

vectorised! {
    fn scatter_48<'a>(taps: &'a Taps, grid: Grid, columns: &'a [f32], output: &'a mut [f32]) {
        taps.scatter_by(grid, 48, columns, output);
    }
}

vectorised! {
    fn gather_64<'a>(taps: &'a Taps, grid: Grid, input: &'a [f32], columns: &'a mut [f32]) {
        taps.gather_by(grid, 64, input, columns);
    }
}

vectorised! {
    fn scatter_64<'a>(taps: &'a Taps, grid: Grid, columns: &'a [f32], output: &'a mut [f32]) {
        taps.scatter_by(grid, 64, columns, output);
    }
}

/// The image line `down` lines further in the same image.
#[inline(always)]
#[allow(clippy::inline_always, reason = "called in the loops above")]
fn source_line(line: usize, row: usize, down: isize, grid: Grid) -> Option<usize> {
    let target = row.checked_add_signed(down)?;
    (target < grid.rows).then(|| line - row + target)
}

/// Columns, first and past the last, whose neighbour `right` columns further lies in the image.
fn seen(cols: usize, right: isize) -> (usize, usize) {
    let reach = right.unsigned_abs().min(cols);
    if right < 0 { (reach, cols) } else { (0, cols - reach) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gathers pixel by pixel.
    fn plainly(offsets: &[(isize, isize)], grid: Grid, channels: usize, input: &[f32]) -> Vec<f32> {
        let mut out = Vec::new();
        for sample in 0..grid.samples {
            for row in 0..grid.rows as isize {
                for col in 0..grid.cols as isize {
                    for (down, right) in offsets {
                        let (r, c) = (row + down, col + right);
                        let inside = r >= 0 && c >= 0 && r < grid.rows as isize && c < grid.cols as isize;
                        for channel in 0..channels {
                            let at =
                                ((sample * grid.rows + r.max(0) as usize) * grid.cols + c.max(0) as usize) * channels;
                            out.push(if inside { input[at + channel] } else { 0.0 });
                        }
                    }
                }
            }
        }
        out
    }

    #[test]
    fn gathering_is_that_of_every_pixel_and_scattering_its_transpose() {
        let offsets = [(-2, -2), (-2, 0), (0, -2), (0, 0), (1, 3), (-9, 0), (0, 9)];
        let taps = Taps::new(offsets);
        for (channels, grid) in [
            (3, Grid { samples: 2, rows: 5, cols: 4 }),
            (48, Grid { samples: 1, rows: 5, cols: 3 }),
            (64, Grid { samples: 2, rows: 3, cols: 6 }),
        ] {
            let input: Vec<f32> = (0..grid.pixels() * channels).map(|i| ((i * 31) % 97) as f32).collect();
            let mut columns = vec![f32::NAN; input.len() * taps.count()];
            taps.gather(grid, channels, &input, &mut columns);
            assert_eq!(columns, plainly(&offsets, grid, channels, &input));
            // <gather x, y> = <x, scatter y>, exact in whole numbers.
            let weights: Vec<f32> = (0..columns.len()).map(|i| ((i * 17) % 13) as f32).collect();
            let mut back = vec![0.0; input.len()];
            taps.scatter_add(grid, channels, &weights, &mut back);
            let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum::<f64>();
            assert!((dot(&columns, &weights) - dot(&input, &back)).abs() < 0.5);
        }
    }
}
