//! Passes of the residual U-net through one image, forward and backward.

use rayon::prelude::*;

use super::layers::{Block, Layers};
use crate::nn::{Grid, TileMemory, Write, add_assign, pixel_shuffle, pixel_unshuffle, silu, silu_backward};
use crate::reconstruction::error::ReconstructionError;

/// Bytes of [`Activations`] for a pixel of the images, nearly.
const BYTES_PER_PIXEL: usize = 1100;
/// Most bytes of all images of a batch.
const MOST_BYTES: usize = 1 << 33;

/// Refuses images of which `count` do not fit into memory.
pub(super) fn check_memory((rows, cols): (usize, usize), count: usize) -> Result<(), ReconstructionError> {
    let bytes = rows.saturating_mul(cols).saturating_mul(BYTES_PER_PIXEL * count);
    if bytes <= MOST_BYTES {
        return Ok(());
    }
    Err(ReconstructionError::TooLarge { rows, cols, gibibytes: bytes as f64 / f64::from(1 << 30) })
}

/// A network with its weights, ready for passes.
pub(super) struct Ready<'a> {
    layers: &'a Layers,
    weights: &'a [f32],
    /// Transformed kernels of [`Layers::convolutions`].
    kernels: Vec<Vec<f32>>,
}

/// What a block keeps for its gradient.
struct BlockMemory {
    input: Vec<f32>,
    activated: Vec<f32>,
    middle: Vec<f32>,
    middle_activated: Vec<f32>,
}

/// All images of one pass.
pub(super) struct Activations {
    field: (usize, usize),
    stem_input: Vec<f32>,
    blocks: [Vec<BlockMemory>; 5],
    /// Results of the stages.
    results: [Vec<f32>; 5],
    /// Unshuffled results of the first two stages.
    squares: [Vec<f32>; 2],
    last_activated: Vec<f32>,
    /// Before the last shuffle.
    out: Vec<f32>,
    /// The result, shape (rows, cols).
    pub(super) result: Vec<f32>,
    /// Gradients by the results of the stages.
    by_results: [Vec<f32>; 5],
    by_squares: [Vec<f32>; 2],
    by_out: Vec<f32>,
    by_input: [Vec<f32>; 3],
    by_middle: [Vec<f32>; 3],
    by_stem_input: Vec<f32>,
    tiles: TileMemory,
}

impl Activations {
    /// For images of shape `field`, multiples of 8 px.
    pub(super) fn new(layers: &Layers, field: (usize, usize)) -> Self {
        let pixels = field.0 * field.1;
        let zeros = |count: usize| vec![0.0; count];
        let of_stage = |stage: usize| (pixels >> (2 + 2 * Layers::level(stage))) * Layers::channels(stage);
        let block = |stage: usize| {
            let zeros = || zeros(of_stage(stage));
            BlockMemory { input: zeros(), activated: zeros(), middle: zeros(), middle_activated: zeros() }
        };
        Self {
            field,
            stem_input: zeros(pixels * layers.inputs),
            blocks: std::array::from_fn(|stage| layers.stages[stage].iter().map(|_| block(stage)).collect()),
            results: std::array::from_fn(|stage| zeros(of_stage(stage))),
            squares: std::array::from_fn(|stage| zeros(of_stage(stage))),
            last_activated: zeros(of_stage(4)),
            out: zeros(pixels),
            result: zeros(pixels),
            by_results: std::array::from_fn(|stage| zeros(of_stage(stage))),
            by_squares: std::array::from_fn(|stage| zeros(of_stage(stage))),
            by_out: zeros(pixels),
            by_input: std::array::from_fn(|stage| zeros(of_stage(stage))),
            by_middle: std::array::from_fn(|stage| zeros(of_stage(stage))),
            by_stem_input: zeros(pixels * layers.inputs),
            tiles: TileMemory::default(),
        }
    }

    fn grid(&self, level: usize) -> Grid {
        Grid { samples: 1, rows: self.field.0 >> (level + 1), cols: self.field.1 >> (level + 1) }
    }
}

impl<'a> Ready<'a> {
    pub(super) fn new(layers: &'a Layers, weights: &'a [f32]) -> Self {
        let convolutions: Vec<_> = layers.convolutions().collect();
        let kernels = convolutions.into_par_iter().map(|layer| layer.transformed(weights)).collect();
        Self { layers, weights, kernels }
    }

    /// Images of a pass.
    pub(super) fn activations(&self, field: (usize, usize)) -> Activations {
        Activations::new(self.layers, field)
    }

    /// Index of the first kernel of a block among the convolutions.
    fn kernel_of(&self, stage: usize, block: usize) -> usize {
        1 + 2 * (self.layers.stages[..stage].iter().map(Vec::len).sum::<usize>() + block)
    }

    /// Passes an image of shape (rows, cols, inputs) forward; the result is in [`Activations::result`].
    pub(super) fn forward(&self, image: &[f32], memory: &mut Activations) {
        let (layers, weights, cols) = (self.layers, self.weights, memory.field.1);
        pixel_unshuffle(image, (cols, layers.inputs), &mut memory.stem_input);
        let grid = memory.grid(0);
        let first = &mut memory.blocks[0][0].input;
        layers.stem.forward(grid, (weights, &self.kernels[0]), &memory.stem_input, first, &mut memory.tiles);
        for stage in 0..5 {
            if let 1..=2 = stage {
                let (squares, shape) = (&mut memory.squares[stage - 1], (cols >> stage, Layers::channels(stage - 1)));
                pixel_unshuffle(&memory.results[stage - 1], shape, squares);
                layers.down[stage - 1].forward(weights, squares, &mut memory.blocks[stage][0].input);
            }
            if let 3..=4 = stage {
                // The squares' gradient is of the same size and is not in use yet.
                let (skip, squares) = (4 - stage, &mut memory.by_squares[4 - stage]);
                let input = &mut memory.blocks[stage][0].input;
                layers.up[stage - 3].forward(weights, &memory.results[stage - 1], squares);
                pixel_shuffle(squares, (cols >> (skip + 1), Layers::channels(skip)), input);
                add_assign(input, &memory.results[skip]);
            }
            self.run_stage(stage, memory);
        }
        silu(&memory.results[4], &mut memory.last_activated);
        let kernel = self.kernels.last().map_or(&[][..], Vec::as_slice);
        layers.out.forward(grid, (weights, kernel), &memory.last_activated, &mut memory.out, &mut memory.tiles);
        pixel_shuffle(&memory.out, (cols, 1), &mut memory.result);
    }

    fn run_stage(&self, stage: usize, memory: &mut Activations) {
        let grid = memory.grid(Layers::level(stage));
        let blocks = &self.layers.stages[stage];
        for (index, block) in blocks.iter().enumerate() {
            let (now, later) = memory.blocks[stage].split_at_mut(index + 1);
            let result = later.first_mut().map_or(&mut memory.results[stage], |later| &mut later.input);
            let BlockMemory { input, activated, middle, middle_activated } = &mut now[index];
            let kernel = self.kernel_of(stage, index);
            let [first, second] = [kernel, kernel + 1].map(|kernel| (self.weights, self.kernels[kernel].as_slice()));
            silu(input, activated);
            block.first.forward(grid, first, activated, middle, &mut memory.tiles);
            silu(middle, middle_activated);
            block.second.forward(grid, second, middle_activated, result, &mut memory.tiles);
            add_assign(result, input);
        }
    }

    /// Writes the gradient by all weights after [`Ready::forward`], from the gradient by the result (rows, cols).
    pub(super) fn backward(&self, by_result: &[f32], gradient: &mut [f32], memory: &mut Activations) {
        let (layers, weights, cols) = (self.layers, self.weights, memory.field.1);
        let grid = memory.grid(0);
        pixel_unshuffle(by_result, (cols, 1), &mut memory.by_out);
        let kernel = self.kernels.last().map_or(&[][..], Vec::as_slice);
        let from = (memory.last_activated.as_slice(), memory.by_out.as_slice());
        layers.out.backward(grid, kernel, from, gradient, &mut memory.by_results[4], &mut memory.tiles);
        silu_backward(&memory.results[4], &mut memory.by_results[4]);
        for stage in (0..5).rev() {
            self.run_stage_back(stage, gradient, memory);
            let (before, now) = memory.by_results.split_at_mut(stage);
            let by_input = &now[0];
            if let 3..=4 = stage {
                // The same gradient reaches the skipped stage and the one below.
                let (skip, squares) = (4 - stage, &mut memory.by_squares[4 - stage]);
                before[skip].copy_from_slice(by_input);
                pixel_unshuffle(by_input, (cols >> (skip + 1), Layers::channels(skip)), squares);
                let layer = &layers.up[stage - 3];
                layer.by_weights(&memory.results[stage - 1], squares, gradient, Write::Replace);
                layer.by_input(weights, squares, &mut before[stage - 1], Write::Replace);
            }
            if let 1..=2 = stage {
                let (squares, layer) = (&mut memory.by_squares[stage - 1], &layers.down[stage - 1]);
                layer.by_weights(&memory.squares[stage - 1], by_input, gradient, Write::Replace);
                layer.by_input(weights, by_input, squares, Write::Replace);
                // Not in use any more, and of the same size.
                let shuffled = &mut memory.results[stage - 1];
                pixel_shuffle(squares, (cols >> stage, Layers::channels(stage - 1)), shuffled);
                add_assign(&mut before[stage - 1], shuffled);
            }
        }
        let from = (memory.stem_input.as_slice(), memory.by_results[0].as_slice());
        layers.stem.backward(grid, &self.kernels[0], from, gradient, &mut memory.by_stem_input, &mut memory.tiles);
    }

    /// Turns the gradient by the result of a stage into that by its input.
    fn run_stage_back(&self, stage: usize, gradient: &mut [f32], memory: &mut Activations) {
        let level = Layers::level(stage);
        let grid = memory.grid(level);
        let by_result = &mut memory.by_results[stage];
        let (by_middle, by_input) = (&mut memory.by_middle[level], &mut memory.by_input[level]);
        for (index, Block { first, second }) in self.layers.stages[stage].iter().enumerate().rev() {
            let now = &memory.blocks[stage][index];
            let kernel = self.kernel_of(stage, index);
            let from = (now.middle_activated.as_slice(), by_result.as_slice());
            second.backward(grid, &self.kernels[kernel + 1], from, gradient, by_middle, &mut memory.tiles);
            silu_backward(&now.middle, by_middle);
            let from = (now.activated.as_slice(), by_middle.as_slice());
            first.backward(grid, &self.kernels[kernel], from, gradient, by_input, &mut memory.tiles);
            silu_backward(&now.input, by_input);
            add_assign(by_result, by_input);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize, seed: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * 37 + seed * 11) % 101) as f32 * 0.02 - 1.0).collect()
    }

    #[test]
    fn gradient_is_the_difference_of_the_loss() {
        let layers = Layers::new(5);
        assert_eq!(layers.layout.count(), 663_748);
        let mut weights = layers.layout.draw(3);
        // The last kernel is zero at the start, which would stop all gradients.
        for (weight, number) in weights[layers.out.kernel.clone()].iter_mut().zip(numbers(1152, 5)) {
            *weight = 0.1 * number;
        }
        let (rows, cols) = (16, 24);
        let (image, by_result) = (numbers(rows * cols * 5, 1), numbers(rows * cols, 2));
        let mut memory = Activations::new(&layers, (rows, cols));
        let mut gradient = vec![f32::NAN; weights.len()];
        Ready::new(&layers, &weights).forward(&image, &mut memory);
        Ready::new(&layers, &weights).backward(&by_result, &mut gradient, &mut memory);
        assert!(gradient.iter().all(|value| value.is_finite()));
        let loss = |weights: &[f32], memory: &mut Activations| -> f64 {
            Ready::new(&layers, weights).forward(&image, memory);
            memory.result.iter().zip(&by_result).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
        };
        for tensor in layers.layout.tensors() {
            // Along the gradient of one tensor.
            let range = tensor.range.clone();
            let square: f64 = gradient[range.clone()].iter().map(|&value| f64::from(value).powi(2)).sum();
            let step = 1e-2 / square.sqrt();
            let mut shifted = |step: f64| {
                let mut weights = weights.clone();
                for at in range.clone() {
                    weights[at] += (f64::from(gradient[at]) * step) as f32;
                }
                loss(&weights, &mut memory)
            };
            let difference = (shifted(step) - shifted(-step)) / (2.0 * step);
            assert!((difference / square - 1.0).abs() < 0.02, "{}: {difference} {square}", tensor.name);
        }
    }
}
