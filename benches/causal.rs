//! One training step of the causal density model (two patches of 32 x 32 px: gradients and Muon) against the matrix
//! products alone on the same shapes, in the same run and on the same threads.

mod training;

use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use lenslet_studio::information::{
    CausalFit, CausalModel, CausalShape, FitContext, FitLength, FitStep, InformationError, Init, Moments, PatchBatch,
    PatchStream,
};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::sensor::Noise;
use ndarray::Array3;
use training::{Gradients, causal_shapes, products_alone, training_time};

const SIDE: usize = 32;
const BATCH: usize = 2;

/// The same patches again and again: drawing them is no part of the step.
struct Same(PatchBatch);

impl PatchStream for Same {
    fn draw(&self, _count: usize, _seed: u64) -> Result<PatchBatch, InformationError> {
        Ok(self.0.clone())
    }
}

/// Time of `steps` steps of a fit.
fn time_of_steps(model: &CausalModel, stream: &Same, steps: u64) -> Duration {
    let mut model = model.clone();
    let fit = CausalFit::new(FitLength::Steps(usize::MAX), 1);
    training_time(steps, |progress| {
        let on_step = &mut |step: &FitStep<'_>| progress.report(&step.progress);
        assert!(fit.fit(&mut model, &FitContext::new(stream), on_step).is_err(), "stopped before the last step");
    })
}

fn training_step(criterion: &mut Criterion) {
    let clean = Array3::from_shape_fn((64, SIDE, SIDE), |(n, r, c)| {
        let wave = |period: f32, place: usize| (place as f32 / period + n as f32).sin();
        60.0 + 20.0 * wave(3.0, r) + 25.0 * wave(5.0, c) * wave(4.0, r + c)
    });
    let batch = PatchBatch { noisy: Noise::Shot.draw(clean.view(), 1), clean: Some(clean) };
    let moments = Moments::of_patches(batch.noisy.view()).expect("patches that vary");
    let mut model =
        CausalModel::new(CausalShape::default(), Noise::Shot, &batch, &moments, Init::Random, 1).expect("a model");
    let (stream, shapes) = (Same(batch), causal_shapes());
    // A step as most of a fit are: unfitted densities expect little, and what they do not expect is summed in double precision.
    let first = CausalFit::new(FitLength::Steps(400), 1);
    first.fit(&mut model, &FitContext::new(&stream), &mut CancelToken::new()).expect("a fitted model");
    let mut group = criterion.benchmark_group("causal");
    group.sample_size(10).measurement_time(Duration::from_secs(10));
    group.bench_function("step", |bencher| {
        bencher.iter_custom(|steps| time_of_steps(&model, &stream, steps));
    });
    group.bench_function("products alone", |bencher| {
        bencher.iter(|| products_alone(&shapes, SIDE * SIDE, BATCH, Gradients::All));
    });
    group.finish();
}

criterion_group!(benches, training_step);
criterion_main!(benches);
