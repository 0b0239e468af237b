//! Dilated convolutions with three taps in one row above, for layers that are masked within their own row. They take
//! half the multiplications where a row is a multiple of four dilations long: minimal filtering as in
//! [`Winograd`](super::Winograd).
//!
//! All taps of a pixel lie in a row before its own, so no pixel depends, even by rounding, on those after it.

use super::matmul::{Write, matmul_transposed_lhs, matmul_transposed_rhs, product};
use super::minimal_filter::{
    InputsToPoints, OutputsToPoints, POINTS, PointsToInputs, PointsToOutputs, PointsToTaps, TAPS, TapsToPoints,
    transform,
};
use super::taps::Grid;
use super::tiles::{TileMemory, part, part_mut, points_of, taps_of, tiles_of_row};

/// A convolution with three taps in the row `dilation` px above, at the same distance from each other, and no bias.
///
/// Its kernel has shape (3 taps, inputs, outputs), from left to right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowAbove {
    /// Distance between taps, and of their row, px.
    pub dilation: usize,
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
}

impl RowAbove {
    /// The kernel (3 taps, inputs, outputs), transformed for the passes: (6 points, inputs, outputs).
    pub fn transformed(self, kernel: &[f32]) -> Vec<f32> {
        let mut points = vec![0.0; kernel.len() / TAPS * POINTS];
        let places = |row| (taps_of(row), points_of(row, 1));
        transform(TapsToPoints, self.inputs * self.outputs, kernel, &mut points, Write::Replace, 1, places);
        points
    }

    /// `out += input * kernel`; input (pixels, inputs), out (pixels, outputs), kernel [`RowAbove::transformed`].
    pub fn add_forward(self, grid: Grid, kernel: &[f32], input: &[f32], out: &mut [f32], memory: &mut TileMemory) {
        let count = self.prepare(grid, memory);
        let TileMemory { tiles, inputs, outputs, .. } = memory;
        transform(InputsToPoints, self.inputs, input, inputs, Write::Replace, count, |n| {
            (tiles[n].seen, points_of(n, count))
        });
        for point in 0..POINTS {
            let (seen, given) = (part(inputs, point), part_mut(outputs, point));
            product(seen, part(kernel, point), (count, self.inputs, self.outputs), given, Write::Replace);
        }
        transform(PointsToOutputs, self.outputs, outputs, out, Write::Add, count, |n| {
            (points_of(n, count), tiles[n].given)
        });
    }

    /// Adds the gradient by the input to `by_input` (pixels, inputs), from the gradient by the output (pixels,
    /// outputs). Writes that by the kernel to `gradient` where it is given; kernel [`RowAbove::transformed`].
    pub fn backward(
        self,
        grid: Grid,
        kernel: &[f32],
        (input, by_output): (&[f32], &[f32]),
        gradient: Option<&mut [f32]>,
        by_input: &mut [f32],
        memory: &mut TileMemory,
    ) {
        let count = self.prepare(grid, memory);
        let TileMemory { tiles, inputs, outputs, by_kernel } = memory;
        transform(OutputsToPoints, self.outputs, by_output, outputs, Write::Replace, count, |n| {
            (tiles[n].given, points_of(n, count))
        });
        if let Some(gradient) = gradient {
            transform(InputsToPoints, self.inputs, input, inputs, Write::Replace, count, |n| {
                (tiles[n].seen, points_of(n, count))
            });
            by_kernel.resize(kernel.len(), 0.0);
            for point in 0..POINTS {
                let (seen, by_given) = (part(inputs, point), part(outputs, point));
                let by_point = part_mut(by_kernel, point);
                matmul_transposed_lhs(seen, by_given, (self.inputs, count, self.outputs), by_point, Write::Replace);
            }
            let places = |row| (points_of(row, 1), taps_of(row));
            transform(PointsToTaps, self.inputs * self.outputs, by_kernel, gradient, Write::Replace, 1, places);
        }
        for point in 0..POINTS {
            let (by_seen, by_given) = (part_mut(inputs, point), part(outputs, point));
            let shape = (count, self.outputs, self.inputs);
            matmul_transposed_rhs(by_given, part(kernel, point), shape, by_seen, Write::Replace);
        }
        transform(PointsToInputs, self.inputs, inputs, by_input, Write::Add, count, |n| {
            (points_of(n, count), tiles[n].seen)
        });
    }

    /// Lists the tiles and allocates memory; returns the number of tiles.
    fn prepare(self, grid: Grid, memory: &mut TileMemory) -> usize {
        memory.tiles.clear();
        for sample in 0..grid.samples {
            for row in self.dilation..grid.rows {
                let given = (sample * grid.rows + row) * grid.cols;
                let seen = given - self.dilation * grid.cols;
                memory.tiles.extend(tiles_of_row((grid.cols, self.dilation), (seen, given)));
            }
        }
        let count = memory.tiles.len();
        memory.inputs.resize(POINTS * count * self.inputs, 0.0);
        memory.outputs.resize(POINTS * count * self.outputs, 0.0);
        count
    }
}

#[cfg(test)]
mod tests {
    use super::super::taps::Taps;
    use super::*;
    use crate::nn::test_numbers::numbers;

    #[test]
    fn tiles_give_the_sums_of_the_taps_and_their_gradients() {
        let mut memory = TileMemory::default();
        for (dilation, inputs, outputs, grid) in [
            (1, 16, 32, Grid { samples: 2, rows: 4, cols: 8 }),
            (1, 5, 19, Grid { samples: 3, rows: 3, cols: 7 }),
            (2, 3, 4, Grid { samples: 2, rows: 5, cols: 13 }),
            (4, 18, 2, Grid { samples: 1, rows: 6, cols: 16 }),
            (3, 2, 3, Grid { samples: 2, rows: 7, cols: 2 }),
            // No row lies that far above.
            (2, 4, 3, Grid { samples: 2, rows: 2, cols: 5 }),
        ] {
            let layer = RowAbove { dilation, inputs, outputs };
            let (input, kernel) = (numbers(grid.pixels() * inputs, 1), numbers(TAPS * inputs * outputs, 2));
            let by_output = numbers(grid.pixels() * outputs, 4);
            let (d, wide) = (dilation as isize, TAPS * inputs);
            let taps = Taps::new([(-d, -d), (-d, 0), (-d, d)]);
            let mut columns = vec![0.0; grid.pixels() * wide];
            taps.gather(grid, inputs, &input, &mut columns);
            let mut expected = vec![2.0; by_output.len()];
            product(&columns, &kernel, (grid.pixels(), wide, outputs), &mut expected, Write::Add);
            let (mut out, points) = (vec![2.0; by_output.len()], layer.transformed(&kernel));
            layer.add_forward(grid, &points, &input, &mut out, &mut memory);
            for (found, expected) in out.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-5 * wide as f32, "{layer:?} {found} {expected}");
            }

            let mut by_kernel = vec![f32::NAN; kernel.len()];
            let mut by_input = vec![1.0; input.len()];
            let given = (input.as_slice(), by_output.as_slice());
            layer.backward(grid, &points, given, Some(&mut by_kernel), &mut by_input, &mut memory);
            let mut expected = vec![0.0; kernel.len()];
            matmul_transposed_lhs(&columns, &by_output, (wide, grid.pixels(), outputs), &mut expected, Write::Replace);
            for (found, expected) in by_kernel.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-5 * grid.pixels() as f32, "{layer:?} {found} {expected}");
            }
            matmul_transposed_rhs(&by_output, &kernel, (grid.pixels(), outputs, wide), &mut columns, Write::Replace);
            let mut expected = vec![1.0; input.len()];
            taps.scatter_add(grid, inputs, &columns, &mut expected);
            for (found, expected) in by_input.iter().zip(&expected) {
                assert!((found - expected).abs() < 2e-5 * (TAPS * outputs) as f32, "{layer:?} {found} {expected}");
            }
            // The gradient by the input alone.
            let mut again = vec![1.0; input.len()];
            layer.backward(grid, &points, given, None, &mut again, &mut memory);
            assert_eq!(again, by_input);
        }
    }

    #[test]
    fn pixels_that_are_not_above_change_no_bit() {
        let grid = Grid { samples: 2, rows: 6, cols: 9 };
        let layer = RowAbove { dilation: 2, inputs: 16, outputs: 16 };
        let kernel = layer.transformed(&numbers(TAPS * 16 * 16, 2));
        let given = |input: &[f32]| {
            let mut out = vec![0.0; grid.pixels() * 16];
            layer.add_forward(grid, &kernel, input, &mut out, &mut TileMemory::default());
            out
        };
        let input = numbers(grid.pixels() * 16, 1);
        let mut changed = input.clone();
        let (row, image) = (grid.cols * 16, grid.rows * grid.cols * 16);
        for image in changed.chunks_exact_mut(image) {
            image[row..].iter_mut().for_each(|value| *value = 1e6 - *value);
        }
        let (before, after) = (given(&input), given(&changed));
        for (before, after) in before.chunks_exact(image).zip(after.chunks_exact(image)) {
            // The third row has taps in the first.
            assert_eq!(before[..3 * row], after[..3 * row]);
            assert!(before[3 * row..] != after[3 * row..]);
        }
    }
}
