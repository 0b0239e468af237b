//! What one mouse move costs, step by step, on one core: the paper's sizes (32x32 PSF, 64 objects of 96x96, 65x65
//! measurements, 32x32 patches).

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use lenslet_studio::evaluation::{Optics, Scene, SceneTables};
use lenslet_studio::forward::Design;
use lenslet_studio::information::{NoiseEntropy, Protocol};
use lenslet_studio::optics::{Encoder, heuristic_layout, modulation_transfer, render_psf};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::sparsity::tamura_of_stack;
use ndarray::Axis;

fn edit(criterion: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("one thread");
    let design = Design::default();
    let Encoder::Lenslets(array) = &design.encoder else { unreachable!("the default design has lenslets") };
    let scene = Scene::open(&design, &mut CancelToken::new()).expect("beads need no file");
    let prepared = SceneTables::new(&scene, design.encoder.grid()).expect("objects are larger than the PSF");
    let optics = Optics::of(&design, 1).expect("the default design renders");
    let measurements = prepared.measure(&design, &optics, &scene).expect("shapes fit");
    let noise_entropy = NoiseEntropy::new(design.noise, Protocol::Default).expect("shot noise has an entropy");

    let mut group = criterion.benchmark_group("edit, one core");
    let mut step = |name: &str, run: &mut (dyn FnMut() + Send)| {
        group.bench_function(name, |bencher| pool.install(|| bencher.iter(&mut *run)));
    };
    step("PSF of 9 lenslets", &mut || {
        black_box(render_psf(black_box(array), 1)).ok();
    });
    step("MTF", &mut || {
        black_box(modulation_transfer(black_box(optics.psf.index_axis(Axis(0), 0))));
    });
    step("64 noiseless and noisy measurements, Tamura", &mut || {
        black_box(prepared.measure(&design, black_box(&optics), &scene)).ok();
    });
    step("of which shot noise", &mut || {
        black_box(design.noise.draw(black_box(measurements.noiseless.view()), 1));
    });
    step("of which Tamura of 64 measurements", &mut || {
        black_box(tamura_of_stack(black_box(measurements.noisy.view())));
    });
    step("Gaussian bound, noise entropy, ceiling", &mut || {
        black_box(prepared.information(&design, black_box(&optics), &scene, &measurements, &noise_entropy)).ok();
    });
    step("PSF, MTF, measurements, Tamura", &mut || {
        let optics = Optics::of(black_box(&design), 1).expect("renders");
        black_box(prepared.measure(&design, &optics, &scene)).ok();
    });
    step("whole edit", &mut || {
        let optics = Optics::of(black_box(&design), 1).expect("renders");
        let measurements = prepared.measure(&design, &optics, &scene).expect("fits");
        black_box(prepared.information(&design, &optics, &scene, &measurements, &noise_entropy)).ok();
    });
    group.finish();
}

/// The same at larger grids and fields, on two cores: what is recomputed before the first picture, and the whole edit.
fn by_size(criterion: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("two threads");
    let mut group = criterion.benchmark_group("edit by size, two cores");
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    for (grid, field) in [(32, 96), (64, 192), (128, 384), (256, 768)] {
        let encoder = Encoder::Lenslets(heuristic_layout(9).on_grid(grid, grid));
        let design = Design { encoder, field: (field, field), ..Design::default() };
        let scene = Scene::open(&design, &mut CancelToken::new()).expect("beads need no file");
        let started = Instant::now();
        let prepared = SceneTables::new(&scene, design.encoder.grid()).expect("objects are larger than the PSF");
        println!("{grid}/{field}: tables of a scene in {:.0} ms", started.elapsed().as_secs_f64() * 1e3);
        let optics = Optics::of(&design, 1).expect("renders");
        let measurements = prepared.measure(&design, &optics, &scene).expect("shapes fit");
        let noise_entropy = NoiseEntropy::new(design.noise, Protocol::Default).expect("shot noise has an entropy");
        let mut step = |name: &str, run: &mut (dyn FnMut() + Send)| {
            group.bench_function(format!("{grid}/{field} {name}"), |bencher| pool.install(|| bencher.iter(&mut *run)));
        };
        step("PSF and MTF", &mut || {
            black_box(Optics::of(black_box(&design), 1)).ok();
        });
        let count = measurements.noisy.len_of(Axis(0));
        step(&format!("{count} measurements, Tamura"), &mut || {
            black_box(prepared.measure(&design, black_box(&optics), &scene)).ok();
        });
        step("bounds", &mut || {
            black_box(prepared.information(&design, black_box(&optics), &scene, &measurements, &noise_entropy)).ok();
        });
        step("whole edit", &mut || {
            let optics = Optics::of(black_box(&design), 1).expect("renders");
            let measurements = prepared.measure(&design, &optics, &scene).expect("fits");
            black_box(prepared.information(&design, &optics, &scene, &measurements, &noise_entropy)).ok();
        });
    }
    group.finish();
}

criterion_group!(benches, edit, by_size);
criterion_main!(benches);
