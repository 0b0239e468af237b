//! The parts of a run of IDEAL from 25 random lenslets before beads. Up a density model: the gradient of one step of the mask,
//! of that the optics on the way there and back, the likelihood with its gradient by the images, and the matrix products that
//! this cannot do without; a whole round (refit, value on held-out objects, five steps), its refit alone, and its products. Up the
//! posterior: a step by its moves one after the other, a round of twenty, its refit alone, and their products.

mod training;

use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use lenslet_studio::design::{GradientDraw, IdealOptimizer, IdealSettings, Objective, Preset};
use lenslet_studio::forward::ForwardModel;
use lenslet_studio::information::SampleRange;
use lenslet_studio::information::{
    CausalFit, Decoder, DecoderFit, DecoderKind, DecoderRefit, FitContext, FitLength, FrozenDensity,
    bead_response_gradient,
};
use lenslet_studio::objects::{ObjectOptions, ObjectSet, Split};
use lenslet_studio::optics::{Limits, psf_gradient, random_layout, render_psf};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::sensor::{Noise, Patches};
use ndarray::Array3;
use training::{Gradients, causal_shapes, decoder_shapes, products_alone};

const PIXELS: usize = 32 * 32;
/// Patches of one step of a fit.
const BATCH: usize = 2;
/// Held-out patches that the value of a mask up a density model rests on.
const HELD_OUT: usize = 128;
/// Scenes of a patch that the value of a mask up the posterior rests on.
const SAMPLES: usize = 512;

/// Time for so many rounds from where a run has come to.
fn time_of_rounds(ideal: &mut IdealOptimizer<'_>, count: u64) -> Duration {
    let started = Instant::now();
    for _ in 0..count {
        // So far ahead that neither its end nor an occasion to move a dark lenslet is near.
        ideal.extend_to(8 * (ideal.state().step + 2 * ideal.settings().refit_every));
        ideal.advance(&mut CancelToken::new()).expect("a round");
    }
    started.elapsed()
}

fn beads() -> ObjectSet {
    ObjectSet::open(&"beads:0.02".parse().expect("beads"), &ObjectOptions::default()).expect("beads")
}

fn up_a_density_model(criterion: &mut Criterion) {
    let set = beads();
    let forward = ForwardModel::new(set.clone(), (32, 32), 10.0, Noise::Shot).expect("optics");
    let settings = IdealSettings::new(Preset::Default, Objective::Density, 1);
    let start = random_layout(25, 1);
    let mut ideal = IdealOptimizer::new(&forward, &start, Limits::default(), settings.clone()).expect("a run");
    ideal.advance(&mut CancelToken::new()).expect("the first round");
    let draw = GradientDraw { split: Split::Train, objects: settings.objects, patches: settings.patches, seed: 1 };
    let shapes = causal_shapes();
    let mut group = criterion.benchmark_group("ideal");
    group.sample_size(10).measurement_time(Duration::from_secs(12));
    group.bench_function("gradient of a step", |bencher| {
        bencher.iter(|| {
            let model = ideal.density_model().expect("a density model");
            forward.gradient(&start, &draw, model.patch(), model, &mut CancelToken::new()).expect("a gradient")
        });
    });
    let objects = set.objects(Split::Train, settings.objects, 1).expect("objects");
    let shape = forward.plan().measurement_shape();
    let patches = Patches::draw((settings.objects, shape.0, shape.1), (32, 32), settings.patches, 1).expect("patches");
    group.bench_function("optics forward", |bencher| {
        bencher.iter(|| {
            let psf = render_psf(&start, 1).expect("a PSF");
            let convolver = forward.convolver(psf.view()).expect("optics");
            let encoded = convolver.measure(objects.view(), forward.bias).expect("measurements");
            patches.cut(encoded.view())
        });
    });
    let psf = render_psf(&start, 1).expect("a PSF");
    let convolver = forward.convolver(psf.view()).expect("optics");
    let by_encoded = Array3::from_elem((settings.objects, shape.0, shape.1), 1e-3);
    group.bench_function("optics backward", |bencher| {
        bencher.iter(|| {
            let by_psf = convolver.psf_cotangent(objects.view(), by_encoded.view()).expect("a gradient");
            psf_gradient(&start, by_psf.view()).expect("a gradient")
        });
    });
    let clean = patches.cut(convolver.measure(objects.view(), forward.bias).expect("measurements").view());
    // Any noise takes as long.
    let normals = Array3::from_shape_fn(clean.dim(), |(n, r, c)| ((n * 7 + r * 5 + c * 3) % 9) as f32 * 0.25 - 1.0);
    group.bench_function("likelihood and its gradient", |bencher| {
        let model = ideal.density_model().expect("a density model");
        bencher.iter(|| {
            model.information_gradient(clean.view(), normals.view(), &mut CancelToken::new()).expect("a likelihood")
        });
    });
    group.bench_function("its products alone", |bencher| {
        bencher.iter(|| products_alone(&shapes, PIXELS, settings.patches, Gradients::Inputs));
    });
    group.bench_function("a round", |bencher| {
        bencher.iter_custom(|count| time_of_rounds(&mut ideal, count));
    });
    group.bench_function("the refit of a round", |bencher| {
        let model = ideal.density_model().expect("a density model").clone();
        let stream = forward.stream(forward.convolver(psf.view()).expect("optics"), Split::Train, model.patch());
        let fit = CausalFit::new(FitLength::Steps(settings.refit), 1);
        bencher
            .iter(|| fit.fit(&mut model.clone(), &FitContext::new(&stream), &mut CancelToken::new()).expect("a refit"));
    });
    group.bench_function("the products of a round alone", |bencher| {
        bencher.iter(|| {
            for _ in 0..settings.refit {
                products_alone(&shapes, PIXELS, BATCH, Gradients::All);
            }
            products_alone(&shapes, PIXELS, HELD_OUT, Gradients::None);
            for _ in 0..settings.refit_every {
                products_alone(&shapes, PIXELS, settings.patches, Gradients::Inputs);
            }
        });
    });
    group.finish();
}

fn up_the_posterior(criterion: &mut Criterion) {
    let set = beads();
    let forward = ForwardModel::new(set.clone(), (32, 32), 10.0, Noise::Shot).expect("optics");
    let start = random_layout(25, 1);
    let psf = render_psf(&start, 1).expect("a PSF");
    let mut group = criterion.benchmark_group("ideal");
    group.sample_size(10).measurement_time(Duration::from_secs(12));
    let settings = IdealSettings::new(Preset::Default, Objective::Posterior, 1);
    let patch = forward.patch(settings.patch);
    let channel = forward.bead_channel(psf.view(), patch).expect("beads");
    // As many as have the pixels of so many patches.
    let of_patch = |count: usize| (count * PIXELS) as f64 / (patch.0 * patch.1) as f64;
    let (scenes, samples) = (of_patch(settings.patches).round() as usize, of_patch(SAMPLES) as usize);
    let decoder = Decoder::shipped().expect("a decoder");
    group.bench_function("slope of a step up the posterior", |bencher| {
        let at_once = (scenes / settings.substeps).max(2);
        bencher.iter(|| {
            for first in (0..scenes).step_by(at_once) {
                bead_response_gradient(&channel, decoder, SampleRange { seed: 1, first, count: at_once })
                    .expect("a slope");
            }
        });
    });
    let shapes = decoder_shapes(decoder.unrolled());
    // Object pixels that a measurement sees.
    let (_, rows, cols) = channel.spot.dim();
    let sites = (patch.0 + rows - 1) * (patch.1 + cols - 1);
    group.bench_function("the products of such a slope alone", |bencher| {
        bencher.iter(|| products_alone(&shapes, sites, scenes, Gradients::None));
    });
    let mut ideal = IdealOptimizer::new(&forward, &start, Limits::default(), settings.clone()).expect("a run");
    group.bench_function("a round up the posterior", |bencher| {
        bencher.iter_custom(|count| time_of_rounds(&mut ideal, count));
    });
    group.bench_function("the refit of such a round", |bencher| {
        let fit = DecoderFit::of_steps(settings.refit, DecoderKind::Autoregressive, 1);
        bencher.iter(|| {
            let mut refit = DecoderRefit::new(fit.clone(), decoder).expect("a refit");
            refit.advance_to(&channel, settings.refit, &mut CancelToken::new()).expect("a refit");
        });
    });
    group.bench_function("the products of such a round alone", |bencher| {
        bencher.iter(|| {
            for _ in 0..settings.refit {
                products_alone(&shapes, sites, BATCH, Gradients::All);
            }
            products_alone(&shapes, sites, samples.next_multiple_of(64), Gradients::None);
            for _ in 0..settings.refit_every {
                products_alone(&shapes, sites, scenes, Gradients::None);
            }
        });
    });
    group.finish();
}

criterion_group!(benches, up_a_density_model, up_the_posterior);
criterion_main!(benches);
