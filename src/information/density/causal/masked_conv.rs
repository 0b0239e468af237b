//! The layer of a residual block that sees five taps: two in the own row, three in a row above.

use std::ops::Range;

use crate::nn::{Grid, Layer, RowAbove, Taps, TileMemory, Write};

/// Places of its weights, and its computation: the own row by a product of gathered pixels, the row above by minimal
/// filtering.
#[derive(Clone, Debug)]
pub(super) struct MaskedConv {
    own_taps: Taps,
    /// Kernel of the own row, and the bias.
    own: Layer,
    above: RowAbove,
    above_kernel: Range<usize>,
}

/// Memory of one thread for such layers.
#[derive(Clone, Debug, Default)]
pub(super) struct MaskedConvMemory {
    columns: Vec<f32>,
    tiles: TileMemory,
}

impl MaskedConv {
    /// Number of taps.
    pub const COUNT: usize = 5;
    /// Number of taps in the own row.
    const OWN: usize = 2;

    /// With `dilation` px between the taps; the kernel of `layer` has shape (5 taps, channels, outputs), its taps in the order of
    /// (0, 0), (0, -d), (-d, -d), (-d, 0), (-d, d) (rows down, columns right).
    pub fn new(dilation: usize, layer: Layer) -> Self {
        let (channels, outputs) = (layer.inputs / Self::COUNT, layer.outputs);
        let middle = layer.kernel.start + Self::OWN * channels * outputs;
        Self {
            own_taps: Taps::new([(0, 0), (0, -(dilation as isize))]),
            above: RowAbove { dilation, inputs: channels, outputs },
            above_kernel: middle..layer.kernel.end,
            own: Layer { kernel: layer.kernel.start..middle, inputs: Self::OWN * channels, ..layer },
        }
    }

    /// `out = input kernel + bias`; input (pixels, channels), out (pixels, outputs).
    pub fn forward(&self, grid: Grid, weights: &[f32], input: &[f32], out: &mut [f32], memory: &mut MaskedConvMemory) {
        let MaskedConvMemory { columns, tiles } = memory;
        self.gather(grid, input, columns);
        self.own.forward(weights, columns, out);
        let kernel = self.above.transformed(&weights[self.above_kernel.clone()]);
        self.above.add_forward(grid, &kernel, input, out, tiles);
    }

    /// Writes the gradient by the input to `by_input` (pixels, channels), from the gradient by the output (pixels,
    /// outputs). Those by its weights are written to `gradient`, of the length of all weights, where it is given.
    pub fn backward(
        &self,
        grid: Grid,
        weights: &[f32],
        (input, by_output): (&[f32], &[f32]),
        mut gradient: Option<&mut [f32]>,
        by_input: &mut [f32],
        memory: &mut MaskedConvMemory,
    ) {
        let MaskedConvMemory { columns, tiles } = memory;
        if let Some(gradient) = gradient.as_deref_mut() {
            self.gather(grid, input, columns);
            self.own.by_weights(columns, by_output, gradient, Write::Replace);
        }
        columns.resize(grid.pixels() * self.own.inputs, 0.0);
        self.own.by_input(weights, by_output, columns, Write::Replace);
        by_input.fill(0.0);
        self.own_taps.scatter_add(grid, self.above.inputs, columns, by_input);
        let kernel = self.above.transformed(&weights[self.above_kernel.clone()]);
        let gradient = gradient.map(|gradient| &mut gradient[self.above_kernel.clone()]);
        self.above.backward(grid, &kernel, (input, by_output), gradient, by_input, tiles);
    }

    fn gather(&self, grid: Grid, input: &[f32], columns: &mut Vec<f32>) {
        columns.resize(grid.pixels() * self.own.inputs, 0.0);
        self.own_taps.gather(grid, self.above.inputs, input, columns);
    }
}
