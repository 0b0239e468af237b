//! One training step of the network that reconstructs (batch of 4 mosaics of 96 x 96 px: draw, linear estimates, gradient, Muon) against
//! matrix products alone, in the same run and on the same threads: with as many multiplications as the passes of the step, and with those
//! of its layers without minimal filtering.

mod training;

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use lenslet_studio::forward::{Design, ForwardModel};
use lenslet_studio::information::Protocol;
use lenslet_studio::progress::CancelToken;
use lenslet_studio::reconstruction::{DecoderScene, NetworkTraining, TrainingBudget, TrainingMasks, TrainingStep};
use training::{Gradients, products_alone};

const BATCH: usize = 4;
/// (channels, pixels, 3x3 convolutions) of the three levels.
const LEVELS: [(usize, usize, usize); 3] = [(32, 48 * 48, 4), (64, 24 * 24, 6), (96, 12 * 12, 4)];

/// Mosaics of 400 images of 32 x 32 px.
fn scene() -> (DecoderScene, TrainingMasks) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("images.idx");
    let axes = [400_u32, 32, 32].into_iter().flat_map(u32::to_be_bytes);
    let pixels = (0..400 * 1024_usize).map(|index| (index / 8 * 7919 % 251) as u8);
    let bytes: Vec<u8> = [0, 0, 8, 3].into_iter().chain(axes).chain(pixels).collect();
    std::fs::write(&path, bytes).expect("a file");
    let objects = format!("idx:{}", path.display()).parse().expect("a source");
    let design = Design { objects, ..Design::default() };
    let forward = ForwardModel::open(&design).expect("a forward model");
    let scene = DecoderScene::new(&forward, Protocol::Paper).expect("a scene");
    let model = scene.model(forward.psf(&design).expect("a mask").view()).expect("a model");
    (scene, TrainingMasks::One(model))
}

/// Time of `steps` steps after a first one.
fn time_of_steps((scene, masks): &(DecoderScene, TrainingMasks), steps: u64) -> Duration {
    let (mut begun, mut taken) = (Instant::now(), Duration::ZERO);
    let training = NetworkTraining { budget: TrainingBudget::Steps(usize::MAX), seed: 1 };
    let mut progress = |step: &TrainingStep| {
        match step.steps as u64 {
            1 => begun = Instant::now(),
            step if step == steps + 1 => {
                taken = begun.elapsed();
                return ControlFlow::Break(());
            }
            _ => {}
        }
        ControlFlow::Continue(())
    };
    let ended = training.train(scene, masks, None, None, &CancelToken::new(), &mut progress);
    assert!(ended.is_err(), "stopped before its budget");
    taken
}

/// The products of all 3x3 convolutions between equal channels: six for four pixels and each row of taps, or all nine taps at once.
fn products(is_filtered: bool) {
    for (channels, pixels, layers) in LEVELS {
        let (shapes, pixels) = if is_filtered {
            (vec![(channels, channels); 3 * layers], pixels * 6 / 4)
        } else {
            (vec![(9 * channels, channels); layers], pixels)
        };
        products_alone(&shapes, pixels, BATCH, Gradients::All);
    }
}

fn training_step(criterion: &mut Criterion) {
    let scene = scene();
    let mut group = criterion.benchmark_group("network");
    group.sample_size(10).measurement_time(Duration::from_secs(10));
    group.bench_function("step", |bencher| bencher.iter_custom(|steps| time_of_steps(&scene, steps)));
    group.bench_function("products", |bencher| bencher.iter(|| products(true)));
    group.bench_function("products without filtering", |bencher| bencher.iter(|| products(false)));
    group.finish();
}

criterion_group!(benches, training_step);
criterion_main!(benches);
