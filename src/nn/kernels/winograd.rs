//! Dilated convolutions of three taps in the own row, three in a row above, and on request three in a row below. They
//! take half the multiplications where a row is a multiple of four dilations long.
//!
//! Four outputs of a row depend on six inputs. Winograd's minimal filtering F(4, 3) computes them from six products
//! of transformed inputs and transformed taps. The sums themselves take twelve (Lavin & Gray 2016; points 0, 1, -1,
//! 2, -2 and infinity). Rows are never mixed: without taps below, no row depends, even by rounding, on those below.
//! Within a row an output may depend by rounding on all six inputs of its tile. Layers that are masked within rows therefore cannot
//! use it.

use std::ops::Range;

use super::bias::fill_bias;
use super::matmul::{Write, matmul_transposed_lhs, matmul_transposed_rhs, product};
use super::minimal_filter::{
    InputsToPoints, OutputsToPoints, POINTS, PointsToInputs, PointsToOutputs, PointsToTaps, TAPS, TapsToPoints,
    transform,
};
use super::taps::{Grid, Taps};
use super::tiles::{TileMemory, part, part_mut, points_of, taps_of, tiles_of_row};

/// The point whose product is added once to every output of a tile.
const EVERYWHERE: usize = 1;

/// Rows of taps of a convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TapRows {
    /// The row above and the own row: a masked convolution of 6 taps.
    AboveAndOwn,
    /// The row above, the own row and the row below: a zero-padded convolution of 9 taps.
    All,
}

/// A convolution with `dilation` px between its taps: three in each row.
///
/// Its kernel has shape (taps, inputs, outputs), in the order of [`Winograd::taps`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Winograd {
    /// Rows of taps.
    pub rows: TapRows,
    /// Distance between taps, px.
    pub dilation: usize,
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
}

impl Winograd {
    /// Offsets of the taps, in the order of the kernel.
    pub fn taps(&self) -> Taps {
        let d = self.dilation as isize;
        let rows = self.kernel_rows() as isize;
        Taps::new((-1..rows - 1).flat_map(|row| [(row * d, -d), (row * d, 0), (row * d, d)]).collect::<Vec<_>>())
    }

    fn kernel_rows(&self) -> usize {
        match self.rows {
            TapRows::AboveAndOwn => 2,
            TapRows::All => 3,
        }
    }

    /// The rows of the kernel in the order in which their products are summed, with the tiles that they read and those that they
    /// write, out of `count`. Tiles that depend on each other are `shift` apart.
    fn row_products(&self, count: usize, shift: usize) -> impl Iterator<Item = RowProduct> {
        let other = count - shift;
        let own = RowProduct { row: 1, seen: 0..count, given: 0..count };
        let above = RowProduct { row: 0, seen: 0..other, given: shift..count };
        let below = RowProduct { row: 2, seen: shift..count, given: 0..other };
        [own, above, below].into_iter().take(self.kernel_rows())
    }

    /// The kernel (taps, inputs, outputs), transformed for the passes: (6 points, rows, inputs, outputs).
    pub fn transformed(&self, kernel: &[f32]) -> Vec<f32> {
        let mut points = vec![0.0; kernel.len() / TAPS * POINTS];
        let size = self.inputs * self.outputs;
        let rows = self.kernel_rows();
        transform(TapsToPoints, size, kernel, &mut points, Write::Replace, rows, |row| {
            (taps_of(row), points_of(row, rows))
        });
        points
    }

    /// `out = input * kernel + bias`; input (pixels, inputs), out (pixels, outputs), kernel [`Winograd::transformed`].
    pub fn forward(
        &self,
        grid: Grid,
        (kernel, bias): (&[f32], &[f32]),
        input: &[f32],
        out: &mut [f32],
        memory: &mut TileMemory,
    ) {
        let shift = self.prepare(grid, memory);
        let TileMemory { tiles, inputs, outputs, .. } = memory;
        let count = tiles.len();
        transform(InputsToPoints, self.inputs, input, inputs, Write::Replace, count, |n| {
            (tiles[n].seen, points_of(n, count))
        });
        for point in 0..POINTS {
            let (seen, given) = (part(inputs, point), part_mut(outputs, point));
            let mut write = Write::Replace;
            if point == EVERYWHERE {
                fill_bias(bias, given);
                write = Write::Add;
            }
            for RowProduct { row, seen: from, given: to } in self.row_products(count, shift) {
                let (seen, given) = (of_tiles(seen, &from, self.inputs), of_tiles_mut(given, &to, self.outputs));
                product(seen, self.part_of(kernel, point, row), (from.len(), self.inputs, self.outputs), given, write);
                write = Write::Add;
            }
        }
        transform(PointsToOutputs, self.outputs, outputs, out, Write::Replace, count, |n| {
            (points_of(n, count), tiles[n].given)
        });
    }

    /// Writes the gradient by the input to `by_input` (pixels, inputs), from the gradient by the output (pixels,
    /// outputs). Writes or adds that by the kernel as `into` states; kernel [`Winograd::transformed`].
    pub fn backward(
        &self,
        grid: Grid,
        kernel: &[f32],
        (input, by_output): (&[f32], &[f32]),
        into: Option<(&mut [f32], Write)>,
        by_input: &mut [f32],
        memory: &mut TileMemory,
    ) {
        let shift = self.prepare(grid, memory);
        let TileMemory { tiles, inputs, outputs, by_kernel } = memory;
        let count = tiles.len();
        transform(OutputsToPoints, self.outputs, by_output, outputs, Write::Replace, count, |n| {
            (tiles[n].given, points_of(n, count))
        });
        if let Some((gradient, write)) = into {
            transform(InputsToPoints, self.inputs, input, inputs, Write::Replace, count, |n| {
                (tiles[n].seen, points_of(n, count))
            });
            by_kernel.resize(kernel.len(), 0.0);
            for point in 0..POINTS {
                let (seen, by_given) = (part(inputs, point), part(outputs, point));
                let by_point = part_mut(by_kernel, point);
                for RowProduct { row, seen: from, given: to } in self.row_products(count, shift) {
                    let (seen, by_given) = (of_tiles(seen, &from, self.inputs), of_tiles(by_given, &to, self.outputs));
                    let by_row = of_tiles_mut(by_point, &(row..row + 1), self.inputs * self.outputs);
                    let shape = (self.inputs, from.len(), self.outputs);
                    matmul_transposed_lhs(seen, by_given, shape, by_row, Write::Replace);
                }
            }
            let rows = self.kernel_rows();
            transform(PointsToTaps, gradient.len() / (rows * TAPS), by_kernel, gradient, write, rows, |row| {
                (points_of(row, rows), taps_of(row))
            });
        }
        for point in 0..POINTS {
            let (by_seen, by_given) = (part_mut(inputs, point), part(outputs, point));
            let mut write = Write::Replace;
            for RowProduct { row, seen: to, given: from } in self.row_products(count, shift) {
                let (by_given, by_seen) =
                    (of_tiles(by_given, &from, self.outputs), of_tiles_mut(by_seen, &to, self.inputs));
                let shape = (from.len(), self.outputs, self.inputs);
                matmul_transposed_rhs(by_given, self.part_of(kernel, point, row), shape, by_seen, write);
                write = Write::Add;
            }
        }
        by_input.fill(0.0);
        transform(PointsToInputs, self.inputs, inputs, by_input, Write::Add, count, |n| {
            (points_of(n, count), tiles[n].seen)
        });
    }

    /// Kernel of one point and row, (inputs, outputs).
    fn part_of<'a>(&self, kernel: &'a [f32], point: usize, row: usize) -> &'a [f32] {
        of_tiles(part(kernel, point), &(row..row + 1), self.inputs * self.outputs)
    }

    /// Lists the tiles in the order of rows, then samples, and allocates memory. Returns the number of tiles between
    /// one and the tile below that uses it, a constant number.
    fn prepare(&self, grid: Grid, memory: &mut TileMemory) -> usize {
        let d = self.dilation;
        memory.tiles.clear();
        for row in 0..grid.rows {
            for sample in 0..grid.samples {
                let line = (sample * grid.rows + row) * grid.cols;
                memory.tiles.extend(tiles_of_row((grid.cols, d), (line, line)));
            }
        }
        let count = memory.tiles.len();
        memory.inputs.resize(POINTS * count * self.inputs, 0.0);
        memory.outputs.resize(POINTS * count * self.outputs, 0.0);
        count / grid.rows.max(1) * d.min(grid.rows)
    }
}

/// The product of all tiles with one row of the kernel.
struct RowProduct {
    /// Row of the kernel.
    row: usize,
    /// Tiles of the input.
    seen: Range<usize>,
    /// Tiles of the output.
    given: Range<usize>,
}

/// The numbers of these tiles.
fn of_tiles<'a>(values: &'a [f32], tiles: &Range<usize>, channels: usize) -> &'a [f32] {
    &values[tiles.start * channels..tiles.end * channels]
}

/// The numbers of these tiles, mutable.
fn of_tiles_mut<'a>(values: &'a mut [f32], tiles: &Range<usize>, channels: usize) -> &'a mut [f32] {
    &mut values[tiles.start * channels..tiles.end * channels]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::test_numbers::numbers;

    fn dot(a: &[f32], b: &[f32]) -> f64 {
        a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum()
    }

    #[test]
    fn tiles_give_the_sums_of_the_taps_and_their_gradients() {
        let cases = [
            (1, 16, 32, Grid { samples: 2, rows: 4, cols: 8 }),
            (1, 5, 19, Grid { samples: 3, rows: 3, cols: 7 }),
            (2, 3, 4, Grid { samples: 2, rows: 5, cols: 13 }),
            (4, 18, 2, Grid { samples: 1, rows: 3, cols: 16 }),
            (3, 2, 3, Grid { samples: 2, rows: 7, cols: 2 }),
            (2, 1, 1, Grid { samples: 1, rows: 1, cols: 1 }),
        ];
        let kinds = [TapRows::AboveAndOwn, TapRows::All];
        for ((dilation, inputs, outputs, grid), rows) in
            cases.into_iter().flat_map(|case| kinds.map(|rows| (case, rows)))
        {
            let layer = Winograd { rows, dilation, inputs, outputs };
            let taps = layer.taps().count();
            let (input, bias) = (numbers(grid.pixels() * inputs, 1), numbers(outputs, 3));
            let kernel = numbers(taps * inputs * outputs, 2);
            let by_output = numbers(grid.pixels() * outputs, 4);

            let mut columns = vec![0.0; grid.pixels() * taps * inputs];
            layer.taps().gather(grid, inputs, &input, &mut columns);
            let shape = (grid.pixels(), taps * inputs, outputs);
            let mut expected = vec![0.0; by_output.len()];
            product(&columns, &kernel, shape, &mut expected, Write::Replace);
            for row in expected.chunks_exact_mut(outputs) {
                row.iter_mut().zip(&bias).for_each(|(value, bias)| *value += bias);
            }
            // Stale memory of another layer and grid has no effect.
            let stale = |count: usize| vec![f32::NAN; count];
            let (inputs_before, outputs_before) = (stale(7), stale(9999));
            let mut memory = TileMemory {
                inputs: inputs_before,
                outputs: outputs_before,
                by_kernel: stale(9999),
                tiles: Vec::new(),
            };
            let mut out = vec![f32::NAN; by_output.len()];
            let points = layer.transformed(&kernel);
            layer.forward(grid, (&points, &bias), &input, &mut out, &mut memory);
            for (found, expected) in out.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-5 * (taps * inputs) as f32, "{layer:?} {found} {expected}");
            }

            let mut by_kernel = vec![1.0; kernel.len()];
            let mut by_input = vec![f32::NAN; input.len()];
            let into = Some((by_kernel.as_mut_slice(), Write::Add));
            layer.backward(grid, &points, (&input, &by_output), into, &mut by_input, &mut memory);
            let mut expected = vec![1.0; kernel.len()];
            let shape = (taps * inputs, grid.pixels(), outputs);
            matmul_transposed_lhs(&columns, &by_output, shape, &mut expected, Write::Add);
            for (found, expected) in by_kernel.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-5 * grid.pixels() as f32, "{layer:?} {found} {expected}");
            }
            let mut back = columns;
            matmul_transposed_rhs(
                &by_output,
                &kernel,
                (grid.pixels(), outputs, taps * inputs),
                &mut back,
                Write::Replace,
            );
            let mut expected = vec![0.0; input.len()];
            layer.taps().scatter_add(grid, inputs, &back, &mut expected);
            for (found, expected) in by_input.iter().zip(&expected) {
                assert!((found - expected).abs() < 2e-5 * (taps * outputs) as f32, "{layer:?} {found} {expected}");
            }
            // Writes over existing values, and the gradient by the input alone.
            let mut written = vec![f32::NAN; kernel.len()];
            let (before, mut again) = (by_input.clone(), vec![f32::NAN; input.len()]);
            let into = Some((written.as_mut_slice(), Write::Replace));
            layer.backward(grid, &points, (&input, &by_output), into, &mut again, &mut memory);
            assert!(written.iter().zip(&by_kernel).all(|(written, added)| (written + 1.0 - added).abs() < 1e-3));
            assert_eq!(again, before);
            layer.backward(grid, &points, (&input, &by_output), None, &mut again, &mut memory);
            assert_eq!(again, before);
            let out_of_input = dot(&out, &by_output) - dot(&bias, &column_sums(&by_output, outputs));
            let gap = (dot(&by_input, &input) - out_of_input).abs();
            assert!(gap < 1e-4 * out_of_input.abs().max(1.0), "{layer:?} {gap} {out_of_input}");
        }
    }

    fn column_sums(values: &[f32], outputs: usize) -> Vec<f32> {
        let mut sums = vec![0.0; outputs];
        super::super::bias::column_sums(values, &mut sums);
        sums
    }

    #[test]
    fn rows_below_change_no_bit() {
        let grid = Grid { samples: 2, rows: 6, cols: 9 };
        let layer = Winograd { rows: TapRows::AboveAndOwn, dilation: 2, inputs: 16, outputs: 16 };
        let (kernel, bias) = (layer.transformed(&numbers(6 * 16 * 16, 2)), numbers(16, 3));
        let given = |input: &[f32]| {
            let mut out = vec![0.0; grid.pixels() * 16];
            layer.forward(grid, (&kernel, &bias), input, &mut out, &mut TileMemory::default());
            out
        };
        let input = numbers(grid.pixels() * 16, 1);
        let mut changed = input.clone();
        let (third, image) = (3 * grid.cols * 16, grid.rows * grid.cols * 16);
        for image in changed.chunks_exact_mut(image) {
            image[third..].iter_mut().for_each(|value| *value = 1e6 - *value);
        }
        let (before, after) = (given(&input), given(&changed));
        for (before, after) in before.chunks_exact(image).zip(after.chunks_exact(image)) {
            assert_eq!(before[..third], after[..third]);
            assert!(before[third..] != after[third..]);
        }
    }
}
