//! Zero-padded 3x3 convolutions of images (rows, cols, channels), and their gradients.

use std::ops::Range;

use crate::nn::kernels::bias::column_sums;
use crate::nn::kernels::matmul::Write;
use crate::nn::kernels::taps::Grid;
use crate::nn::kernels::tiles::TileMemory;
use crate::nn::kernels::winograd::{TapRows, Winograd};
use crate::nn::parameters::{Initial, ParameterLayout};

/// A zero-padded 3x3 convolution with a bias: its places among the weights of a network.
///
/// The kernel has shape (9 taps, inputs, outputs), row by row, and is applied as a correlation: the first tap multiplies the pixel
/// above and to the left.
#[derive(Clone, Debug)]
pub struct Convolution3x3 {
    /// Place of the kernel.
    pub kernel: Range<usize>,
    /// Place of the bias (outputs).
    pub bias: Range<usize>,
    tiled: Winograd,
}

impl Convolution3x3 {
    /// Appends kernel and bias to a layout. The bias starts at 0.
    pub fn add(layout: &mut ParameterLayout, name: &str, (inputs, outputs): (usize, usize), initial: Initial) -> Self {
        let kernel = layout.add(format!("{name}.kernel"), &[9, inputs, outputs], initial);
        let bias = layout.add(format!("{name}.bias"), &[outputs], Initial::Zeros);
        Self { kernel, bias, tiled: Winograd { rows: TapRows::All, dilation: 1, inputs, outputs } }
    }

    /// The kernel in the form that the passes take.
    pub fn transformed(&self, weights: &[f32]) -> Vec<f32> {
        self.tiled.transformed(&weights[self.kernel.clone()])
    }

    /// `out = input * kernel + bias`, from the weights and the [`Convolution3x3::transformed`] kernel.
    pub fn forward(
        &self,
        grid: Grid,
        (weights, kernel): (&[f32], &[f32]),
        input: &[f32],
        out: &mut [f32],
        memory: &mut TileMemory,
    ) {
        self.tiled.forward(grid, (kernel, &weights[self.bias.clone()]), input, out, memory);
    }

    /// Writes the gradients by kernel and bias to their places in `gradient`, and that by the input to `by_input`, from the gradient by
    /// the output.
    pub fn backward(
        &self,
        grid: Grid,
        kernel: &[f32],
        (input, by_output): (&[f32], &[f32]),
        gradient: &mut [f32],
        by_input: &mut [f32],
        memory: &mut TileMemory,
    ) {
        let bias = &mut gradient[self.bias.clone()];
        bias.fill(0.0);
        column_sums(by_output, bias);
        let into = Some((&mut gradient[self.kernel.clone()], Write::Replace));
        self.tiled.backward(grid, kernel, (input, by_output), into, by_input, memory);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::test_numbers::numbers;

    /// The convolution by its definition, in f64.
    fn expected(
        grid: Grid,
        (inputs, outputs): (usize, usize),
        kernel: &[f32],
        bias: &[f32],
        input: &[f32],
    ) -> Vec<f64> {
        let mut out = Vec::new();
        for pixel in 0..grid.pixels() {
            let (row, col) = (pixel / grid.cols % grid.rows, pixel % grid.cols);
            for o in 0..outputs {
                let mut sum = f64::from(bias[o]);
                for tap in 0..9 {
                    let (r, c) = ((row + tap / 3).wrapping_sub(1), (col + tap % 3).wrapping_sub(1));
                    if r < grid.rows && c < grid.cols {
                        let from = (pixel / (grid.rows * grid.cols) * grid.rows + r) * grid.cols + c;
                        let pairs = (0..inputs).map(|i| {
                            f64::from(input[from * inputs + i]) * f64::from(kernel[(tap * inputs + i) * outputs + o])
                        });
                        sum += pairs.sum::<f64>();
                    }
                }
                out.push(sum);
            }
        }
        out
    }

    #[test]
    fn convolution_is_its_definition_and_its_gradients_are_differences() {
        for (inputs, outputs, grid) in [
            (5, 3, Grid { samples: 2, rows: 4, cols: 7 }),
            (32, 17, Grid { samples: 1, rows: 5, cols: 8 }),
            (1, 1, Grid { samples: 1, rows: 1, cols: 1 }),
        ] {
            let mut layout = ParameterLayout::default();
            layout.add("before", &[3], Initial::Zeros);
            let layer = Convolution3x3::add(&mut layout, "layer", (inputs, outputs), Initial::Zeros);
            let mut weights = numbers(layout.count(), 1);
            let (mut input, by_output) = (numbers(grid.pixels() * inputs, 2), numbers(grid.pixels() * outputs, 3));
            let mut memory = TileMemory::default();
            let reference = |weights: &[f32], input: &[f32]| {
                let (kernel, bias) = (&weights[layer.kernel.clone()], &weights[layer.bias.clone()]);
                expected(grid, (inputs, outputs), kernel, bias, input)
            };
            let mut out = vec![f32::NAN; grid.pixels() * outputs];
            let kernel = layer.transformed(&weights);
            layer.forward(grid, (&weights, &kernel), &input, &mut out, &mut memory);
            for (found, expected) in out.iter().zip(reference(&weights, &input)) {
                assert!((f64::from(*found) - expected).abs() < 1e-4, "{found} {expected}");
            }
            let (mut gradient, mut by_input) = (vec![f32::NAN; weights.len()], vec![f32::NAN; input.len()]);
            layer.backward(grid, &kernel, (&input, &by_output), &mut gradient, &mut by_input, &mut memory);
            // The output is linear in each number, so differences are exact.
            let loss = |weights: &[f32], input: &[f32]| -> f64 {
                reference(weights, input).iter().zip(&by_output).map(|(value, by)| value * f64::from(*by)).sum()
            };
            let before = loss(&weights, &input);
            for at in (layer.kernel.start..layer.bias.end).step_by(23) {
                let kept = weights[at];
                weights[at] += 1.0;
                let step = f64::from(weights[at] - kept);
                let difference = (loss(&weights, &input) - before) / step;
                weights[at] = kept;
                assert!(
                    (f64::from(gradient[at]) - difference).abs() < 1e-3 * difference.abs().max(1.0),
                    "{at}: {difference}"
                );
            }
            for at in (0..input.len()).step_by(29) {
                let kept = input[at];
                input[at] += 1.0;
                let step = f64::from(input[at] - kept);
                let difference = (loss(&weights, &input) - before) / step;
                input[at] = kept;
                assert!(
                    (f64::from(by_input[at]) - difference).abs() < 1e-3 * difference.abs().max(1.0),
                    "{at}: {difference}"
                );
            }
        }
    }
}
