//! Masked, dilated convolutions of three taps in the own row and three in a row above. They take half the
//! multiplications where a row is a multiple of four dilations long.
//!
//! Four outputs of a row depend on six inputs. Winograd's minimal filtering F(4, 3) computes them from six products
//! of transformed inputs and transformed taps. The sums themselves take twelve (Lavin & Gray 2016; points 0, 1, -1,
//! 2, -2 and infinity). Rows are never mixed: no row depends, even by rounding, on those below. Within a row an
//! output may depend by rounding on all six inputs of its tile. Layers that are masked within rows therefore cannot
//! use it.

use super::bias::fill_bias;
use super::matmul::{Write, matmul_transposed_lhs, matmul_transposed_rhs, product};
use super::minimal_filter::{
    InputsToPoints, OutputsToPoints, POINTS, PointsToInputs, PointsToOutputs, PointsToTaps, TAPS, TapsToPoints,
    transform,
};
use super::taps::{Grid, Taps};
use super::tiles::{TileMemory, part, part_mut, points_of, taps_of, tiles_of_row};

/// Rows of taps.
const ROWS: usize = 2;
/// The point whose product is added once to every output of a tile.
const EVERYWHERE: usize = 1;

/// A convolution with `dilation` px between its taps: three in the row that far above, then three in the own row.
///
/// Its kernel has shape (6 taps, inputs, outputs), in the order of [`Winograd::taps`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Winograd {
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
        Taps::new([(-d, -d), (-d, 0), (-d, d), (0, -d), (0, 0), (0, d)])
    }

    /// The kernel (6 taps, inputs, outputs), transformed for the passes: (6 points, 2 rows, inputs, outputs).
    pub fn transformed(&self, kernel: &[f32]) -> Vec<f32> {
        let mut points = vec![0.0; kernel.len() / TAPS * POINTS];
        let size = self.inputs * self.outputs;
        transform(TapsToPoints, size, kernel, &mut points, Write::Replace, ROWS, |row| {
            (taps_of(row), points_of(row, ROWS))
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
        let (count, above) = (tiles.len(), tiles.len() - shift);
        transform(InputsToPoints, self.inputs, input, inputs, Write::Replace, count, |n| {
            (tiles[n].seen, points_of(n, count))
        });
        for point in 0..POINTS {
            let (seen, given) = (part(inputs, point), part_mut(outputs, point));
            let (from_above, own) = rows_of_kernel(kernel, point);
            let write = if point == EVERYWHERE {
                fill_bias(bias, given);
                Write::Add
            } else {
                Write::Replace
            };
            product(seen, own, (count, self.inputs, self.outputs), given, write);
            let (seen, given) = (&seen[..above * self.inputs], &mut given[shift * self.outputs..]);
            product(seen, from_above, (above, self.inputs, self.outputs), given, Write::Add);
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
        let (count, above) = (tiles.len(), tiles.len() - shift);
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
                let (by_above, by_own) = part_mut(by_kernel, point).split_at_mut(self.inputs * self.outputs);
                matmul_transposed_lhs(seen, by_given, (self.inputs, count, self.outputs), by_own, Write::Replace);
                let (seen, by_given) = (&seen[..above * self.inputs], &by_given[shift * self.outputs..]);
                matmul_transposed_lhs(seen, by_given, (self.inputs, above, self.outputs), by_above, Write::Replace);
            }
            transform(PointsToTaps, gradient.len() / (ROWS * TAPS), by_kernel, gradient, write, ROWS, |row| {
                (points_of(row, ROWS), taps_of(row))
            });
        }
        for point in 0..POINTS {
            let (by_seen, by_given) = (part_mut(inputs, point), part(outputs, point));
            let (from_above, own) = rows_of_kernel(kernel, point);
            matmul_transposed_rhs(by_given, own, (count, self.outputs, self.inputs), by_seen, Write::Replace);
            let (by_seen, by_given) = (&mut by_seen[..above * self.inputs], &by_given[shift * self.outputs..]);
            matmul_transposed_rhs(by_given, from_above, (above, self.outputs, self.inputs), by_seen, Write::Add);
        }
        by_input.fill(0.0);
        transform(PointsToInputs, self.inputs, inputs, by_input, Write::Add, count, |n| {
            (points_of(n, count), tiles[n].seen)
        });
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

/// Kernel of the row above, and of the own row.
fn rows_of_kernel(kernel: &[f32], point: usize) -> (&[f32], &[f32]) {
    part(kernel, point).split_at(kernel.len() / (POINTS * ROWS))
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
        for (dilation, inputs, outputs, grid) in [
            (1, 16, 32, Grid { samples: 2, rows: 4, cols: 8 }),
            (1, 5, 19, Grid { samples: 3, rows: 3, cols: 7 }),
            (2, 3, 4, Grid { samples: 2, rows: 5, cols: 13 }),
            (4, 18, 2, Grid { samples: 1, rows: 3, cols: 16 }),
            (3, 2, 3, Grid { samples: 2, rows: 7, cols: 2 }),
            (2, 1, 1, Grid { samples: 1, rows: 1, cols: 1 }),
        ] {
            let layer = Winograd { dilation, inputs, outputs };
            let (input, bias) = (numbers(grid.pixels() * inputs, 1), numbers(outputs, 3));
            let kernel = numbers(6 * inputs * outputs, 2);
            let by_output = numbers(grid.pixels() * outputs, 4);

            let mut columns = vec![0.0; grid.pixels() * 6 * inputs];
            layer.taps().gather(grid, inputs, &input, &mut columns);
            let shape = (grid.pixels(), 6 * inputs, outputs);
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
                assert!((found - expected).abs() < 1e-5 * (6 * inputs) as f32, "{layer:?} {found} {expected}");
            }

            let mut by_kernel = vec![1.0; kernel.len()];
            let mut by_input = vec![f32::NAN; input.len()];
            let into = Some((by_kernel.as_mut_slice(), Write::Add));
            layer.backward(grid, &points, (&input, &by_output), into, &mut by_input, &mut memory);
            let mut expected = vec![1.0; kernel.len()];
            let shape = (6 * inputs, grid.pixels(), outputs);
            matmul_transposed_lhs(&columns, &by_output, shape, &mut expected, Write::Add);
            for (found, expected) in by_kernel.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-5 * grid.pixels() as f32, "{layer:?} {found} {expected}");
            }
            let mut back = columns;
            matmul_transposed_rhs(&by_output, &kernel, (grid.pixels(), outputs, 6 * inputs), &mut back, Write::Replace);
            let mut expected = vec![0.0; input.len()];
            layer.taps().scatter_add(grid, inputs, &back, &mut expected);
            for (found, expected) in by_input.iter().zip(&expected) {
                assert!((found - expected).abs() < 2e-5 * (6 * outputs) as f32, "{layer:?} {found} {expected}");
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
        let layer = Winograd { dilation: 2, inputs: 16, outputs: 16 };
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
