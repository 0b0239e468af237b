//! One training step of the published `PixelCNN` (batch of 64 patches: draw, gradient, Adam) against matrix products alone, in
//! the same run and on the same threads: with as many multiplications as the step (but for a few at edges, which it leaves out),
//! and with those of its layers without minimal filtering.

mod training;

use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use lenslet_studio::information::{
    BurnDevice, EngineChoice, PixelCnnContext, PixelCnnFit, PixelCnnShape, TrainingPatches,
};
use ndarray::Array3;
use training::{Gradients, products_alone, training_time};

const BATCH: usize = 64;
/// Pixels that one thread takes through the network at a time.
const CHUNK: usize = 1024;

/// (inputs, outputs) of all products of the forward pass for one pixel, those of a vertical layer being `vertical`.
fn shapes(vertical: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let mut shapes = vec![(3, 64), (1, 64)];
    for _ in 0..7 {
        shapes.extend(vertical);
        shapes.extend([(128, 128), (128, 128), (64, 64)]);
    }
    shapes.extend([(64, 64), (64, 120)]);
    shapes
}

/// Time of `steps` steps of a fit on this engine.
fn time_of_steps(patches: &Array3<f32>, engine: EngineChoice, steps: u64) -> Duration {
    let training = TrainingPatches { noisy: patches.view(), clean: None };
    training_time(steps, |progress| {
        let fit = PixelCnnFit { engine, steps_per_epoch: 1 << 20, ..PixelCnnFit::paper(1) };
        let fit = fit.fit(PixelCnnShape::default(), 1.0, &PixelCnnContext::new(training), progress);
        assert!(fit.is_err(), "stopped before the first epoch ends");
    })
}

/// The graphics cards that this program was built for and this machine has.
fn cards() -> Vec<EngineChoice> {
    let cards = [BurnDevice::Wgpu, BurnDevice::Cuda].map(EngineChoice::Burn);
    let built = EngineChoice::built();
    cards.into_iter().filter(|card| built.contains(card) && card.open().is_ok()).collect()
}

fn training_step(criterion: &mut Criterion) {
    // Six products for four pixels, for each of two rows.
    let filtered = shapes(&[(64, 128); 3]);
    let plain = shapes(&[(384, 128)]);
    let mut group = criterion.benchmark_group("pixelcnn");
    group.sample_size(10).measurement_time(Duration::from_secs(10));
    for side in [16, 32] {
        let patches =
            Array3::from_shape_fn((2 * BATCH, side, side), |(n, r, c)| ((n * 31 + r * 7 + c * 13) % 97) as f32);
        group.bench_with_input(BenchmarkId::new("step", side), &side, |bencher, _| {
            bencher.iter_custom(|steps| time_of_steps(&patches, EngineChoice::Cpu, steps));
        });
        for card in cards() {
            group.bench_with_input(BenchmarkId::new(format!("step on {card}"), side), &side, |bencher, _| {
                bencher.iter_custom(|steps| time_of_steps(&patches, card, steps));
            });
        }
        for (name, shapes) in [("products alone", &filtered), ("products without filtering", &plain)] {
            group.bench_with_input(BenchmarkId::new(name, side), &side, |bencher, _| {
                bencher.iter(|| products_alone(shapes, CHUNK, BATCH * side * side / CHUNK, Gradients::All));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, training_step);
criterion_main!(benches);
