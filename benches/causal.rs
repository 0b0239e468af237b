//! One training step of the causal density model (two patches of 32 x 32 px: gradients and Muon) against the matrix
//! products alone on the same shapes, in the same run and on the same threads.

use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use lenslet_studio::information::{
    CausalFit, CausalModel, CausalShape, FitLength, InformationError, Moments, PatchBatch, PatchStream,
};
use lenslet_studio::network::{Write, product, product_of_transposed, product_with_transposed};
use lenslet_studio::sensor::Noise;
use ndarray::Array3;
use rayon::prelude::*;

const SIDE: usize = 32;
const BATCH: usize = 2;

/// (inputs, outputs) of all products of the forward pass for one pixel.
fn shapes() -> Vec<(usize, usize)> {
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

/// Forward, by input and by kernel: the three products of every layer, over all pixels of a batch.
fn products_alone() {
    let pixels = SIDE * SIDE;
    (0..BATCH).into_par_iter().with_max_len(1).for_each(|_| {
        let input = vec![0.5_f32; pixels * 240];
        let kernel = vec![0.25_f32; 240 * 97];
        let (mut output, mut by_input) = (vec![0.0_f32; pixels * 97], vec![0.0_f32; pixels * 240]);
        let mut by_kernel = vec![0.0_f32; 240 * 97];
        for (inputs, outputs) in shapes() {
            let (input, kernel) = (&input[..pixels * inputs], &kernel[..inputs * outputs]);
            let output = &mut output[..pixels * outputs];
            product(input, kernel, (pixels, inputs, outputs), output, Write::Add);
            let by_kernel = &mut by_kernel[..inputs * outputs];
            product_of_transposed(input, output, (inputs, pixels, outputs), by_kernel, Write::Replace);
            let by_input = &mut by_input[..pixels * inputs];
            product_with_transposed(output, kernel, (pixels, outputs, inputs), by_input, Write::Replace);
        }
        black_box((&output, &by_kernel, &by_input));
    });
}

/// The same patches again and again: drawing them is no part of the step.
struct Same(PatchBatch);

impl PatchStream for Same {
    fn draw(&self, _count: usize, _seed: u64) -> Result<PatchBatch, InformationError> {
        Ok(self.0.clone())
    }
}

/// Time of `steps` steps, after a first one that fills the caches.
fn training_time(model: &CausalModel, stream: &Same, steps: u64) -> Duration {
    let mut model = model.clone();
    let (mut begun, mut taken) = (Instant::now(), Duration::ZERO);
    let fit = CausalFit::new(FitLength::Steps(usize::MAX), 1);
    let fitted = fit.fit(&mut model, stream, &mut |progress| {
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
    assert!(fitted.is_err(), "cancelled before the last step");
    taken
}

fn training_step(criterion: &mut Criterion) {
    let noisy = Array3::from_shape_fn((64, SIDE, SIDE), |(n, r, c)| ((n * 31 + r * 7 + c * 13) % 97) as f32);
    let batch = PatchBatch { noisy, clean: None };
    let moments = Moments::of_patches(batch.noisy.view()).expect("patches that vary");
    let model = CausalModel::new(CausalShape::default(), Noise::Shot, &batch, &moments, None, 1).expect("a model");
    let stream = Same(batch);
    let mut group = criterion.benchmark_group("causal");
    group.sample_size(10).measurement_time(Duration::from_secs(10));
    group.bench_function("step", |bencher| {
        bencher.iter_custom(|steps| training_time(&model, &stream, steps));
    });
    group.bench_function("products alone", |bencher| bencher.iter(products_alone));
    group.finish();
}

criterion_group!(benches, training_step);
criterion_main!(benches);
