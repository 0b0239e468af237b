//! Products of the windows around all pixels with a narrow kernel, without gathering the windows first.
//!
//! In a layer of 16 channels, copying the windows for a general matrix product takes longer than the arithmetic. Here
//! a few pixels at a time keep their sums in vector registers, which reaches 70 % of the peak of one AVX2 core. The
//! number of pixels is the largest that leaves registers for the weights.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

/// Pixels whose gradients are summed in registers before they are added to the total: as many as stay in the nearest
/// cache.
const STRETCH: usize = 192;

/// Window of a layer: its pixels, and the numbers of inputs and outputs per pixel.
///
/// Inputs and outputs are 16 and 16, 24 and 16, or 16 and 24.
#[derive(Clone, Debug)]
pub struct Window {
    /// Places of the window's pixels, relative to its output pixel.
    pub offsets: Vec<isize>,
    /// Output pixels; their windows lie inside the array.
    pub range: Range<usize>,
    /// Input numbers per pixel.
    pub inputs: usize,
    /// Output numbers per pixel.
    pub outputs: usize,
}

/// `out[p] = bias + sum over taps t of input[p + offsets[t]] kernel[t]`; without a bias the sum is added to `out`.
///
/// `input` is (positions, inputs), `kernel` (taps, inputs, outputs), `out` (positions, outputs).
///
/// # Panics
/// Where a window leaves the array.
pub fn window_product(window: &Window, input: &[f32], kernel: &[f32], bias: Option<&[f32]>, out: &mut [f32]) {
    arch(window).dispatch(Sums { window, input, kernel, bias, out });
}

/// Adds the gradient of [`window_product`] by its kernel to `gradient` (taps, inputs, outputs), from the gradient by its
/// output (positions, outputs).
///
/// # Panics
/// Where a window leaves the array.
pub fn window_product_by_kernel(window: &Window, input: &[f32], by_output: &[f32], gradient: &mut [f32]) {
    arch(window).dispatch(ByKernel { window, input, by_output, gradient });
}

/// The widest vector instructions of this processor whose vectors are filled by the outputs of a pixel.
fn arch(window: &Window) -> Arch {
    #[cfg(target_arch = "x86_64")]
    if !window.outputs.is_multiple_of(16)
        && let Some(avx2) = pulp::x86::V3::try_new()
    {
        return Arch::V3(avx2);
    }
    Arch::new()
}

/// The kernel for which [`window_product`] converts gradients by the output to gradients by the input: taps in
/// reverse order, inputs and outputs exchanged. The offsets must be symmetric.
pub fn transposed_kernel(kernel: &[f32], (inputs, outputs): (usize, usize), transposed: &mut [f32]) {
    let size = inputs * outputs;
    for (tap, out) in kernel.chunks_exact(size).rev().zip(transposed.chunks_exact_mut(size)) {
        for (index, value) in out.iter_mut().enumerate() {
            *value = tap[(index % inputs) * outputs + index / inputs];
        }
    }
}

struct Sums<'a> {
    window: &'a Window,
    input: &'a [f32],
    kernel: &'a [f32],
    bias: Option<&'a [f32]>,
    out: &'a mut [f32],
}

#[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
impl WithSimd for Sums<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match (self.window.inputs, self.window.outputs, S::F32_LANES) {
            (16, 16, 16) => self.run::<S, 16, 1, 12>(simd),
            (24, 16, 16) => self.run::<S, 24, 1, 12>(simd),
            (16, 16, 8) => self.run::<S, 16, 2, 6>(simd),
            (24, 16, 8) => self.run::<S, 24, 2, 6>(simd),
            (16, 24, 8) => self.run::<S, 16, 3, 4>(simd),
            (16, 16, 4) => self.run::<S, 16, 4, 4>(simd),
            (24, 16, 4) => self.run::<S, 24, 4, 4>(simd),
            (16, 24, 4) => self.run::<S, 16, 6, 3>(simd),
            (16, 16, 1) => self.run::<S, 16, 16, 1>(simd),
            (24, 16, 1) => self.run::<S, 24, 16, 1>(simd),
            (16, 24, 1) => self.run::<S, 16, 24, 1>(simd),
            shape => debug_assert!(false, "no window product for inputs, outputs and lanes {shape:?}"),
        }
    }
}

impl Sums<'_> {
    /// Kernel for `I` inputs, `V` vectors of outputs, `P` pixels at a time.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
    #[allow(
        clippy::needless_range_loop,
        reason = "loops of constant length are unrolled before arrays become registers"
    )]
    fn run<S: Simd, const I: usize, const V: usize, const P: usize>(self, simd: S) {
        let Self { window, input, kernel, bias, out } = self;
        let input = input.as_chunks::<I>().0;
        let kernel = S::as_simd_f32s(kernel).0.as_chunks::<V>().0.as_chunks::<I>().0;
        let bias = bias.and_then(|bias| S::as_simd_f32s(bias).0.first_chunk::<V>());
        let out = &mut S::as_mut_simd_f32s(out).0.as_chunks_mut::<V>().0[window.range.clone()];
        let (blocks, rest) = out.as_chunks_mut::<P>();
        let mut at = window.range.start;
        for block in blocks {
            let mut sums = bias.map_or(*block, |bias| [*bias; P]);
            for (kernel, &offset) in kernel.iter().zip(&window.offsets) {
                let seen = at.wrapping_add_signed(offset);
                let pixels = &input[seen..seen + P];
                for i in 0..I {
                    let weights = kernel[i];
                    for p in 0..P {
                        let value = simd.splat_f32s(pixels[p][i]);
                        for v in 0..V {
                            sums[p][v] = simd.mul_add_e_f32s(value, weights[v], sums[p][v]);
                        }
                    }
                }
            }
            *block = sums;
            at += P;
        }
        for out in rest {
            let mut sums = bias.map_or(*out, |bias| *bias);
            for (kernel, &offset) in kernel.iter().zip(&window.offsets) {
                let pixel = &input[at.wrapping_add_signed(offset)];
                for i in 0..I {
                    let value = simd.splat_f32s(pixel[i]);
                    for v in 0..V {
                        sums[v] = simd.mul_add_e_f32s(value, kernel[i][v], sums[v]);
                    }
                }
            }
            *out = sums;
            at += 1;
        }
    }
}

struct ByKernel<'a> {
    window: &'a Window,
    input: &'a [f32],
    by_output: &'a [f32],
    gradient: &'a mut [f32],
}

#[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
impl WithSimd for ByKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match (self.window.outputs, S::F32_LANES) {
            (16, 16) => self.run::<S, 1, 8>(simd),
            (16, 8) => self.run::<S, 2, 4>(simd),
            (24, 8) => self.run::<S, 3, 4>(simd),
            (16, 4) => self.run::<S, 4, 4>(simd),
            (24, 4) => self.run::<S, 6, 4>(simd),
            (16, 1) => self.run::<S, 16, 4>(simd),
            (24, 1) => self.run::<S, 24, 4>(simd),
            shape => debug_assert!(false, "no window product for outputs and lanes {shape:?}"),
        }
    }
}

impl ByKernel<'_> {
    /// Kernel for `V` vectors of outputs; the gradients by `G` inputs are summed in registers together.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
    #[allow(
        clippy::needless_range_loop,
        reason = "loops of constant length are unrolled before arrays become registers"
    )]
    fn run<S: Simd, const V: usize, const G: usize>(self, simd: S) {
        let Self { window, input, by_output, gradient } = self;
        let groups = window.inputs / G;
        let input = input.as_chunks::<G>().0;
        let by_output = S::as_simd_f32s(by_output).0.as_chunks::<V>().0;
        let gradient = S::as_mut_simd_f32s(gradient).0.as_chunks_mut::<V>().0.as_chunks_mut::<G>().0;
        for start in window.range.clone().step_by(STRETCH) {
            let stretch = start..window.range.end.min(start + STRETCH);
            let by_output = &by_output[stretch.clone()];
            for (gradient, &offset) in gradient.chunks_exact_mut(groups).zip(&window.offsets) {
                let from = start.wrapping_add_signed(offset) * groups;
                let pixels = &input[from..from + stretch.len() * groups];
                for (group, gradient) in gradient.iter_mut().enumerate() {
                    let mut sums = *gradient;
                    for (pixel, by_output) in pixels[group..].iter().step_by(groups).zip(by_output) {
                        for g in 0..G {
                            let value = simd.splat_f32s(pixel[g]);
                            for v in 0..V {
                                sums[g][v] = simd.mul_add_e_f32s(value, by_output[v], sums[g][v]);
                            }
                        }
                    }
                    *gradient = sums;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::padded::PaddedImages;
    use super::*;
    use crate::nn::test_numbers::numbers;

    #[test]
    fn products_are_sums_and_both_gradients_their_transposes() {
        let grid = PaddedImages { images: 2, rows: 5, cols: 7 };
        let range = grid.covered();
        for (inputs, outputs, offsets) in [(16, 16, grid.window().to_vec()), (24, 16, vec![0]), (16, 24, vec![0])] {
            let bordered = |channels: usize, seed: usize| {
                let mut values = numbers(grid.positions() * channels, seed);
                values[..range.start * channels].fill(0.0);
                values[range.end * channels..].fill(0.0);
                grid.clear_borders(channels, &mut values);
                values
            };
            let (input, bias) = (bordered(inputs, 1), numbers(outputs, 3));
            let kernel = numbers(offsets.len() * inputs * outputs, 2);
            let window = Window { offsets: offsets.clone(), range: range.clone(), inputs, outputs };
            let mut out = vec![0.0; grid.positions() * outputs];
            window_product(&window, &input, &kernel, Some(&bias), &mut out);
            for p in range.clone() {
                for o in 0..outputs {
                    let mut expected = bias[o];
                    for (t, offset) in offsets.iter().enumerate() {
                        let from = p.wrapping_add_signed(*offset) * inputs;
                        for i in 0..inputs {
                            expected += input[from + i] * kernel[(t * inputs + i) * outputs + o];
                        }
                    }
                    assert!((out[p * outputs + o] - expected).abs() < 2e-4, "{} {expected}", out[p * outputs + o]);
                }
            }
            // Adds to existing values, without a bias.
            let mut linear = vec![1.0; out.len()];
            window_product(&window, &input, &kernel, None, &mut linear);
            let at = range.start * outputs + 5;
            assert!((linear[at] - 1.0 - out[at] + bias[5]).abs() < 1e-4);

            // <input * kernel, c> = <kernel, gradient(c)> = <input, transposed(c)>.
            let cotangent = bordered(outputs, 4);
            let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum::<f64>();
            let expected = dot(&linear, &cotangent) - cotangent.iter().map(|&c| f64::from(c)).sum::<f64>();
            let mut gradient = vec![0.0; kernel.len()];
            window_product_by_kernel(&window, &input, &cotangent, &mut gradient);
            assert!((dot(&gradient, &kernel) - expected).abs() < 1e-3 * expected.abs().max(1.0));
            let mut transposed = vec![0.0; kernel.len()];
            transposed_kernel(&kernel, (inputs, outputs), &mut transposed);
            let mut back = vec![0.0; input.len()];
            let window = Window { inputs: outputs, outputs: inputs, ..window };
            window_product(&window, &cotangent, &transposed, None, &mut back);
            assert!((dot(&back, &input) - expected).abs() < 1e-3 * expected.abs().max(1.0));
        }
    }
}
