//! One training step of the published `PixelCNN` (batch of 64 patches: draw, gradient, Adam) against the matrix products alone on
//! the same shapes, in the same run and on the same threads.

use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use lenslet_studio::information::{PixelCnnFit, PixelCnnShape, TrainingPatches};
use lenslet_studio::network::{Write, product, product_of_transposed, product_with_transposed};
use ndarray::Array3;
use rayon::prelude::*;

const BATCH: usize = 64;
/// Pixels that one thread takes through the network at a time.
const CHUNK: usize = 1024;

/// (inputs, outputs) of all products of the forward pass for one pixel.
fn shapes() -> Vec<(usize, usize)> {
    let mut shapes = vec![(3, 64), (1, 64)];
    for _ in 0..7 {
        shapes.extend([(384, 128), (128, 128), (128, 128), (64, 64)]);
    }
    shapes.extend([(64, 64), (64, 120)]);
    shapes
}

/// Forward, by input and by kernel: the three products of every layer, over all pixels of a batch.
fn products_alone(pixels: usize) {
    (0..pixels / CHUNK).into_par_iter().with_max_len(1).for_each(|_| {
        let input = vec![0.5_f32; CHUNK * 384];
        let kernel = vec![0.25_f32; 384 * 128];
        let (mut output, mut by_input) = (vec![0.0_f32; CHUNK * 128], vec![0.0_f32; CHUNK * 384]);
        let mut by_kernel = vec![0.0_f32; 384 * 128];
        for (inputs, outputs) in shapes() {
            let input = &input[..CHUNK * inputs];
            let kernel = &kernel[..inputs * outputs];
            let output = &mut output[..CHUNK * outputs];
            product(input, kernel, (CHUNK, inputs, outputs), output, Write::Add);
            let by_kernel = &mut by_kernel[..inputs * outputs];
            product_of_transposed(input, output, (inputs, CHUNK, outputs), by_kernel, Write::Replace);
            let by_input = &mut by_input[..CHUNK * inputs];
            product_with_transposed(output, kernel, (CHUNK, outputs, inputs), by_input, Write::Replace);
        }
        black_box((&output, &by_kernel, &by_input));
    });
}

/// Time of `steps` steps, after a first one that fills the caches.
fn training_time(patches: &Array3<f32>, steps: u64) -> Duration {
    let (mut begun, mut taken) = (Instant::now(), Duration::ZERO);
    let training = TrainingPatches { noisy: patches.view(), clean: None };
    let fit = PixelCnnFit::paper(1).fit(PixelCnnShape::default(), 1.0, training, None, &mut |progress| {
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
    assert!(fit.is_err(), "cancelled before the first epoch ends");
    taken
}

fn training_step(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("pixelcnn");
    group.sample_size(10).measurement_time(Duration::from_secs(10));
    for side in [16, 32] {
        let patches =
            Array3::from_shape_fn((2 * BATCH, side, side), |(n, r, c)| ((n * 31 + r * 7 + c * 13) % 97) as f32);
        group.bench_with_input(BenchmarkId::new("step", side), &side, |bencher, _| {
            bencher.iter_custom(|steps| training_time(&patches, steps));
        });
        group.bench_with_input(BenchmarkId::new("products alone", side), &side, |bencher, _| {
            bencher.iter(|| products_alone(BATCH * side * side));
        });
    }
    group.finish();
}

criterion_group!(benches, training_step);
criterion_main!(benches);
