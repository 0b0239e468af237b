//! What the benches of training steps share: the steps of a fit, and the products that no step can do without.
#![allow(dead_code, reason = "each bench takes what it needs")]

use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use lenslet_studio::information::FitProgress;
use lenslet_studio::nn::{Write, matmul_transposed_lhs, matmul_transposed_rhs, product};
use lenslet_studio::progress::Progress;
use rayon::prelude::*;

/// (inputs, outputs) of all products of the forward pass of the causal density model for one pixel.
pub fn causal_shapes() -> Vec<(usize, usize)> {
    let mut shapes = vec![(48, 96), (9, 96)];
    for block in 0..5 {
        shapes.extend([(240, 96), (48, 48)]);
        if block % 2 == 1 {
            shapes.extend([(48, 8), (128, 96)]);
        }
    }
    shapes.extend([(48, 48), (48, 97)]);
    shapes
}

/// (inputs, outputs) of all products of the forward pass of a decoder of so many unrolled steps for one object pixel.
pub fn decoder_shapes(unrolled: usize) -> Vec<(usize, usize)> {
    [(24, 16), (9 * 16, 16), (16, 24)].repeat(unrolled)
}

/// Which gradients a pass takes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Gradients {
    /// By the inputs of every layer and by its weights.
    All,
    /// By the inputs of every layer.
    Inputs,
    /// None: the pass goes forward alone.
    None,
}

/// The products of every layer with (inputs, outputs) in `shapes`, forward and for its gradients, for `chunks` times
/// `pixels` pixels of which each chunk is taken through the network by one thread.
pub fn products_alone(shapes: &[(usize, usize)], pixels: usize, chunks: usize, gradients: Gradients) {
    let largest = |size: &dyn Fn(&(usize, usize)) -> usize| shapes.iter().map(size).max().unwrap_or(0);
    let (inputs, outputs) = (largest(&|shape| shape.0), largest(&|shape| shape.1));
    let kernels = largest(&|shape| shape.0 * shape.1);
    (0..chunks).into_par_iter().with_max_len(1).for_each(|_| {
        let input = vec![0.5_f32; pixels * inputs];
        let kernel = vec![0.25_f32; kernels];
        let (mut output, mut by_input) = (vec![0.0_f32; pixels * outputs], vec![0.0_f32; pixels * inputs]);
        let mut by_kernel = vec![0.0_f32; kernels];
        for &(inputs, outputs) in shapes {
            let (input, kernel) = (&input[..pixels * inputs], &kernel[..inputs * outputs]);
            let output = &mut output[..pixels * outputs];
            product(input, kernel, (pixels, inputs, outputs), output, Write::Add);
            if gradients == Gradients::All {
                let by_kernel = &mut by_kernel[..inputs * outputs];
                matmul_transposed_lhs(input, output, (inputs, pixels, outputs), by_kernel, Write::Replace);
            }
            if gradients != Gradients::None {
                let by_input = &mut by_input[..pixels * inputs];
                matmul_transposed_rhs(output, kernel, (pixels, outputs, inputs), by_input, Write::Replace);
            }
        }
        black_box((&output, &by_kernel, &by_input));
    });
}

/// Time of `steps` steps of a fit, after a first one that fills the caches; the fit is then stopped.
pub fn training_time(steps: u64, fit: impl FnOnce(&mut dyn Progress<FitProgress>)) -> Duration {
    let (mut begun, mut taken) = (Instant::now(), Duration::ZERO);
    fit(&mut |progress: &FitProgress| {
        match progress.step as u64 {
            1 => begun = Instant::now(),
            step if step == steps + 1 => {
                taken = begun.elapsed();
                return ControlFlow::Break(());
            }
            _ => {}
        }
        ControlFlow::Continue(())
    });
    taken
}
