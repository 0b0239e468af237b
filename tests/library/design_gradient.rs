//! Gradient of information with respect to the mask, against finite differences and in a case with a known answer.

use lenslet_studio::design::{GradientScene, information_gradient};
use lenslet_studio::information::FitContext;
use lenslet_studio::information::{
    CausalFit, CausalModel, CausalShape, FitLength, InformationError, Init, Moments, PatchBatch, PatchStream,
};
use lenslet_studio::objects::{ObjectOptions, ObjectSet, ObjectSource, Split};
use lenslet_studio::optics::{LensletArray, heuristic_layout, render_psf};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::sensor::{Convolution, DEFAULT_BIAS, Noise, Patches};
use ndarray::Array3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Patches of measurements through one mask.
struct Measured<'a> {
    set: &'a ObjectSet,
    plan: &'a Convolution,
    array: LensletArray,
    side: usize,
}

impl PatchStream for Measured<'_> {
    fn draw(&self, count: usize, seed: u64) -> Result<PatchBatch, InformationError> {
        let objects = self.set.objects(Split::Train, count.div_ceil(4), seed).unwrap();
        let psf = render_psf(&self.array, 1).unwrap();
        let encoded = self.plan.with_psf(psf.view()).unwrap().measure(objects.view(), DEFAULT_BIAS).unwrap();
        let clean = Patches::draw(encoded.dim(), (self.side, self.side), count, seed).unwrap().cut(encoded.view());
        Ok(PatchBatch { noisy: Noise::Shot.draw(clean.view(), seed), clean: Some(clean) })
    }
}

fn fitted(stream: &Measured<'_>, steps: usize) -> CausalModel {
    let sample = stream.draw(256, 1).unwrap();
    let moments = Moments::of_patches(sample.noisy.view()).unwrap();
    let mut model = CausalModel::new(CausalShape::default(), Noise::Shot, &sample, &moments, Init::Random, 2).unwrap();
    let fit = CausalFit::new(FitLength::Steps(steps), 3);
    fit.fit(&mut model, &FitContext::new(stream), &mut CancelToken::new()).unwrap();
    model
}

/// The gradient of a mask of this throughput against finite differences, under a model after a fit of `steps`.
fn check_gradient(throughput: f64, steps: usize) {
    let source: ObjectSource = "beads:0.02".parse().unwrap();
    let set = ObjectSet::open(&source, &ObjectOptions::default()).unwrap();
    let plan = Convolution::new(set.field(), (32, 32)).unwrap();
    let mut array = heuristic_layout(3);
    array.lenslets[1].weight = 0.6;
    array.throughput = throughput;
    let side = 12;
    let stream = Measured { set: &set, plan: &plan, array: array.clone(), side };
    let model = fitted(&stream, steps);
    let objects = set.objects(Split::Test, 12, 9).unwrap();
    let patches = Patches::draw((12, 65, 65), (side, side), 64, 10).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let normals = Array3::from_shape_simple_fn((64, side, side), || StandardNormal.sample(&mut random));
    let scene = GradientScene {
        plan: &plan,
        objects: objects.view(),
        bias: DEFAULT_BIAS,
        patches: &patches,
        normals: normals.view(),
    };
    let value = |array: &LensletArray| information_gradient(array, &scene, &model, &mut CancelToken::new()).unwrap();
    let here = value(&array);
    assert!(here.bits_per_pixel > 0.1 && here.bits_per_pixel < 3.0, "{}", here.bits_per_pixel);
    for (index, gradient) in here.lenslets.iter().enumerate() {
        let difference = |change: &dyn Fn(&mut LensletArray, f64)| {
            let step = 2e-3;
            let (mut up, mut down) = (array.clone(), array.clone());
            change(&mut up, step);
            change(&mut down, -step);
            (value(&up).bits_per_pixel - value(&down).bits_per_pixel) / (2.0 * step)
        };
        for (name, exact, numeric) in [
            ("x", gradient.x, difference(&|array, step| array.lenslets[index].x += step)),
            ("y", gradient.y, difference(&|array, step| array.lenslets[index].y += step)),
            ("weight", gradient.weight, difference(&|array, step| array.lenslets[index].weight += step)),
            (
                "sigma",
                gradient.sigma,
                difference(&|array, step| {
                    let spot = &mut array.lenslets[index].spot;
                    *spot = spot.with_mean_sigma(spot.mean_sigma() + step);
                }),
            ),
        ] {
            assert!((exact - numeric).abs() < 0.02 * numeric.abs() + 5e-4, "{index} {name}: {exact} {numeric}");
        }
        assert!(gradient.sigma < 0.0, "a sharper lenslet tells more of points: {gradient:?}");
    }
}

#[test]
fn the_gradient_of_a_mask_is_that_of_finite_differences() {
    check_gradient(1.0, 300);
}

#[test]
fn the_gradient_of_a_dim_mask_is_that_of_finite_differences() {
    check_gradient(0.3, 150);
}
