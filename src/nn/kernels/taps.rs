//! Taps of masked, dilated convolutions: the neighbours of a pixel, gathered into columns for a matrix product.
//!
//! Only the taps that a mask leaves open are gathered, so masked ones cost nothing.

use pulp::{Arch, Simd, WithSimd};

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

/// Offsets (rows down, columns right) from a pixel to its taps; outside the image there are zeros.
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

    /// Offsets (rows down, columns right) from a pixel to its taps, px.
    pub fn offsets(&self) -> &[(isize, isize)] {
        &self.offsets
    }

    /// Writes the values at the taps of each pixel of `input` (pixels, channels) to `columns` (pixels, taps,
    /// channels).
    pub fn gather(&self, grid: Grid, channels: usize, input: &[f32], columns: &mut [f32]) {
        match channels {
            8 => gather_of::<8>(self, grid, input, columns),
            48 => gather_of::<48>(self, grid, input, columns),
            64 => gather_of::<64>(self, grid, input, columns),
            _ => self.gather_by(grid, channels, input, columns),
        }
    }

    /// Inlined, so that a constant number of channels turns the copies into a few vector moves.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "the constant number of channels must reach the inner loop")]
    fn gather_by(&self, grid: Grid, channels: usize, input: &[f32], columns: &mut [f32]) {
        let wide = self.count() * channels;
        for (line, columns) in columns.chunks_exact_mut(grid.cols * wide).enumerate() {
            for (tap, &offset) in self.offsets.iter().enumerate() {
                let Run { first, count, source } = Run::of(grid, line, offset);
                let part = tap * channels..(tap + 1) * channels;
                let (before, rest) = columns.split_at_mut(first * wide);
                let (within, after) = rest.split_at_mut(count * wide);
                let seen = input[source * channels..].chunks_exact(channels);
                for (column, pixel) in within.chunks_exact_mut(wide).zip(seen) {
                    column[part.clone()].copy_from_slice(pixel);
                }
                for column in before.chunks_exact_mut(wide).chain(after.chunks_exact_mut(wide)) {
                    column[part.clone()].fill(0.0);
                }
            }
        }
    }

    /// The transpose of [`Taps::gather`]: adds each column entry to the pixel it was read from.
    pub fn scatter_add(&self, grid: Grid, channels: usize, columns: &[f32], output: &mut [f32]) {
        Arch::new().dispatch(ScatterAdd { taps: self, grid, channels, columns, output });
    }
}

vectorised! {
    fn gather_of<'a, const CHANNELS: usize>(taps: &'a Taps, grid: Grid, input: &'a [f32], columns: &'a mut [f32]) {
        taps.gather_by(grid, CHANNELS, input, columns);
    }
}

/// Written with vectors: for plain loops the compiler gathers one channel of many columns.
struct ScatterAdd<'a> {
    taps: &'a Taps,
    grid: Grid,
    channels: usize,
    columns: &'a [f32],
    output: &'a mut [f32],
}

impl WithSimd for ScatterAdd<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { taps, grid, channels, columns, output } = self;
        let wide = taps.count() * channels;
        for (line, columns) in columns.chunks_exact(grid.cols * wide).enumerate() {
            for (tap, &offset) in taps.offsets.iter().enumerate() {
                let Run { first, count, source } = Run::of(grid, line, offset);
                let part = tap * channels..(tap + 1) * channels;
                let columns = columns[first * wide..(first + count) * wide].chunks_exact(wide);
                for (pixel, column) in output[source * channels..].chunks_exact_mut(channels).zip(columns) {
                    let (sums, last_sums) = S::as_mut_simd_f32s(pixel);
                    let (values, last_values) = S::as_simd_f32s(&column[part.clone()]);
                    for (sum, value) in sums.iter_mut().zip(values) {
                        *sum = simd.add_f32s(*sum, *value);
                    }
                    if !last_sums.is_empty() {
                        let (sum, value) = (simd.partial_load_f32s(last_sums), simd.partial_load_f32s(last_values));
                        simd.partial_store_f32s(last_sums, simd.add_f32s(sum, value));
                    }
                }
            }
        }
    }
}

/// The pixels of one image line with a tap inside the image.
struct Run {
    /// Column of the first.
    first: usize,
    count: usize,
    /// Pixel at the tap of the first one.
    source: usize,
}

impl Run {
    fn of(grid: Grid, line: usize, (down, right): (isize, isize)) -> Self {
        let row = line % grid.rows;
        let seen = row.checked_add_signed(down).filter(|seen| *seen < grid.rows);
        let Some(seen) = seen else { return Self { first: 0, count: 0, source: 0 } };
        let reach = right.unsigned_abs().min(grid.cols);
        let (first, skipped) = if right < 0 { (reach, 0) } else { (0, reach) };
        let source = (line - row + seen) * grid.cols + skipped;
        Self { first, count: grid.cols - reach, source }
    }
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
            (8, Grid { samples: 1, rows: 4, cols: 3 }),
            (48, Grid { samples: 1, rows: 5, cols: 3 }),
            (50, Grid { samples: 1, rows: 3, cols: 4 }),
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
