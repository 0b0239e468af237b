//! The `PixelCNN`: its gradients, its causality, published reference values, and known information.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Duration;

use lenslet_studio::formats::read_npz_f64;
use lenslet_studio::information::{
    BurnDevice, DataScale, EngineChoice, InformationError, PixelCnn, PixelCnnFit, PixelCnnRequest, PixelCnnShape,
    Protocol, TrainingPatches, Trial, gaussian_entropy, pixelcnn_estimate, poisson_entropy,
};
use lenslet_studio::information::{FitProgress, PixelCnnContext};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::sensor::Noise;
use ndarray::{Array3, ArrayD, Axis, s};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson, StandardNormal};

/// The engines of this build and machine. Only a graphics card may be missing.
fn engines() -> Vec<EngineChoice> {
    let cards = [BurnDevice::Wgpu, BurnDevice::Cuda].map(EngineChoice::Burn);
    let here = |engine: &EngineChoice| match engine.open() {
        Ok(_) => true,
        Err(missing) if cards.contains(engine) => {
            println!("{engine} is not tested: {missing}");
            false
        }
        Err(error) => panic!("{error}"),
    };
    EngineChoice::built().into_iter().filter(here).collect()
}

fn small_model(seed: u64) -> (PixelCnn, Array3<f32>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let patches = Array3::from_shape_simple_fn((3, 7, 6), || 60.0 + 25.0 * rng.sample::<f32, _>(StandardNormal));
    let scale = DataScale::of(patches.view(), 1.0).unwrap();
    let mut model = PixelCnn::new(PixelCnnShape::new(16, 6, vec![1, 2]).unwrap(), scale, seed);
    // Non-zero biases, and widths between their limits.
    for weight in model.weights_mut() {
        *weight += 0.05 * rng.sample::<f32, _>(StandardNormal);
    }
    let widths = model.layout().tensors().last().unwrap().range.start + 6;
    model.weights_mut()[widths..widths + 6].iter_mut().enumerate().for_each(|(k, bias)| *bias = 4.0 + 2.0 * k as f32);
    (model, patches)
}

#[test]
fn gradients_are_slopes_of_the_loss() {
    let (model, patches) = small_model(1);
    let (_, gradient, by_patch) = model.loss_and_gradients(patches.view()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let loss = |model: &PixelCnn, patches: &Array3<f32>| model.loss_and_gradients(patches.view()).unwrap().0;
    for tensor in model.layout().tensors() {
        let direction: Vec<f32> = tensor.range.clone().map(|_| rng.sample(StandardNormal)).collect();
        let moved = |by: f32| {
            let mut model = model.clone();
            for (weight, d) in model.weights_mut()[tensor.range.clone()].iter_mut().zip(&direction) {
                *weight += by * d;
            }
            loss(&model, &patches)
        };
        let step = 2e-3;
        let slope = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
        let found: f64 =
            gradient[tensor.range.clone()].iter().zip(&direction).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
        assert!((found - slope).abs() < 2e-3 * slope.abs() + 3e-4, "{}: {found} {slope}", tensor.name);
    }
    let direction = patches.mapv(|_| rng.sample::<f32, _>(StandardNormal));
    let step = 0.02;
    let moved = |by: f32| loss(&model, &(&patches + &(&direction * by)));
    let slope = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
    let found: f64 = by_patch.iter().zip(&direction).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
    assert!((found - slope).abs() < 2e-3 * slope.abs() + 3e-4, "patches: {found} {slope}");
}

#[test]
fn a_pixel_depends_on_those_before_it_alone() {
    let (model, patches) = small_model(3);
    let before = model.mixtures(patches.view()).unwrap();
    let mut reached = 0;
    for row in 0..7 {
        for col in 0..6 {
            let mut changed = patches.clone();
            changed[[1, row, col]] += 30.0;
            let after = model.mixtures(changed.view()).unwrap();
            let pairs =
                [(&before.means, &after.means), (&before.widths, &after.widths), (&before.logits, &after.logits)];
            for (before, after) in pairs {
                for r in 0..7 {
                    for c in 0..6 {
                        let same = before.slice(s![1, r, c, ..]) == after.slice(s![1, r, c, ..]);
                        assert!(same || (r, c) > (row, col), "({row}, {col}) reaches ({r}, {c})");
                        reached += usize::from(!same);
                    }
                }
                assert_eq!(before.slice(s![0, .., .., ..]), after.slice(s![0, .., .., ..]), "patches are apart");
            }
        }
    }
    assert!(reached > 500, "the network sees its context: {reached}");
}

#[test]
fn threads_do_not_change_a_bit() {
    let patches = pixels_of_two_rates(90, 8, 1).1;
    let fit = PixelCnnFit { batch: 20, steps_per_epoch: 4, max_epochs: 2, ..PixelCnnFit::standard(5) };
    let run = |threads, seed| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let fit = PixelCnnFit { seed, ..fit.clone() };
        let training = TrainingPatches { noisy: patches.view(), clean: None };
        let shape = PixelCnnShape::new(16, 5, vec![1, 2]).unwrap();
        let fitted = pool.install(|| fit.fit(shape, 1.0, &PixelCnnContext::new(training), &mut CancelToken::new()));
        let (model, report) = fitted.unwrap();
        (model.weights().to_vec(), report.epochs.iter().map(|epoch| epoch.1).collect::<Vec<_>>())
    };
    assert_eq!(run(1, 5), run(3, 5));
    assert_ne!(run(1, 5), run(1, 6));
}

/// The folder of reference values beside the crate. It is not part of the crate.
fn reference(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/reference").join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: ../shared is absent");
    None
}

/// Names of a tensor in the reference file, each with its range of our output channels.
fn reference_names(name: &str) -> Vec<String> {
    let (layer, part) = name.rsplit_once('.').unwrap();
    if layer == "heads" {
        return ["mu_dense", "sigma_dense", "mix_logit_dense"].iter().map(|head| format!("{head}/{part}")).collect();
    }
    let layer = match layer.split_once('.') {
        Some(("first", "vertical")) => "conv_vstack/conv/Conv_0".to_owned(),
        Some(("first", _)) => "conv_hstack/conv/Conv_0".to_owned(),
        Some((block, kind)) => {
            let kind = match kind {
                "vertical" => "VerticalStackConvolution_0/conv/Conv_0",
                "horizontal" => "HorizontalStackConvolution_0/conv/Conv_0",
                "link" => "Conv_0",
                _ => "Conv_1",
            };
            format!("conv_layers_{}/{kind}", block.trim_start_matches("block"))
        }
        None => "conv_out".to_owned(),
    };
    vec![format!("{layer}/{part}")]
}

/// One of our tensors from the reference file, as far as the file holds it: open taps only, heads side by side.
fn reference_tensor(array: impl Fn(&str) -> ArrayD<f32>, group: &str, name: &str, shape: &[usize]) -> Vec<f32> {
    let parts: Vec<ArrayD<f32>> = reference_names(name).iter().map(|name| array(&format!("{group}/{name}"))).collect();
    let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
    let joined = ndarray::concatenate(Axis(parts[0].ndim() - 1), &views).unwrap();
    // Row-major order (row, col, in, out): the open taps of every kernel are its first ones.
    joined.iter().copied().take(shape.iter().product()).collect()
}

fn worst<'a>(found: impl IntoIterator<Item = &'a f32>, expected: impl IntoIterator<Item = &'a f32>) -> f64 {
    let (mut error, mut largest) = (0.0_f64, 0.0_f64);
    for (x, y) in found.into_iter().zip(expected) {
        error = error.max(f64::from((x - y).abs()));
        largest = largest.max(f64::from(y.abs()));
    }
    error / largest
}

/// A part of the reference values: weights rounded to 16 bits, the outputs of the first patch, the first values and the norm
/// of each gradient.
#[test]
fn outputs_and_gradients_are_those_of_the_published_network() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/reference/pixelcnn.npz");
    // Rounded to 16 bits, the weights move gradients: by 0.005 and 0.044 where they were exact to 0.001.
    compare_with_published_network(&path, 1, Tolerance { weights: 1e-2, patches: 6e-2 });
}

#[test]
fn all_outputs_and_gradients_are_those_of_the_published_network() {
    let Some(path) = reference("pixelcnn_16.npz") else { return };
    compare_with_published_network(&path, 4, Tolerance { weights: 1e-3, patches: 1e-3 });
}

/// Largest error of gradients by weights and by patches, as a share of their largest value.
struct Tolerance {
    weights: f64,
    patches: f64,
}

/// Compares the outputs of the first patches, the loss of all, and the gradients that the file holds.
fn compare_with_published_network(path: &Path, patches: usize, tolerance: Tolerance) {
    let stored = |name: &str| read_npz_f64(path, Some(name)).ok().map(|array| array.mapv(|x| x as f32));
    let array = |name: &str| {
        let values = stored(name).unwrap();
        // Rounded weights are integers with a scale.
        match name.strip_prefix("param/").and_then(|rest| stored(&format!("param_scale/{rest}"))) {
            Some(scale) => values * scale[0],
            None => values,
        }
    };
    let number = |name: &str| *array(name).iter().next().unwrap();
    let scale = DataScale {
        mean: number("mean"),
        deviation: number("std"),
        min: number("min"),
        max: number("max"),
        min_width: 1.0,
    };
    let mut model = PixelCnn::new(PixelCnnShape::default(), scale, 0);
    let layout = model.layout().clone();
    assert_eq!(layout.count(), 617_592, "open weights of the published network");
    for tensor in layout.tensors() {
        let values = reference_tensor(array, "param", &tensor.name, &tensor.shape);
        model.weights_mut()[tensor.range.clone()].copy_from_slice(&values);
    }
    let noisy = array("noisy").into_dimensionality::<ndarray::Ix3>().unwrap();

    let mixtures = model.mixtures(noisy.view()).unwrap();
    for (name, found) in [("mu", &mixtures.means), ("sigma", &mixtures.widths), ("logits", &mixtures.logits)] {
        let expected = array(name);
        assert_eq!(expected.len() * noisy.dim().0, found.len() * patches, "{name}");
        let error = worst(found, &expected);
        println!("{name}: {error:.1e}");
        assert!(error < 1e-4, "{name}: {error}");
    }
    let gradients: Vec<Vec<f32>> =
        layout.tensors().iter().map(|tensor| reference_tensor(array, "grad", &tensor.name, &tensor.shape)).collect();
    let norm_of = |name: &str| {
        let norms = reference_names(name).into_iter().map(|name| stored(&format!("grad_norm/{name}")));
        let squares: Option<f64> = norms.map(|norm| norm.map(|norm| f64::from(norm[0]).powi(2))).sum();
        squares.map(f64::sqrt)
    };
    let (expected, expected_by_patch) = (f64::from(number("loss")), array("grad_input"));
    for choice in engines() {
        let mut engine = choice.open().unwrap();
        let (loss, gradient, by_patch) = model.loss_and_gradients_on(engine.as_mut(), noisy.view()).unwrap();
        assert!((loss - expected).abs() < 1e-4 * expected, "{choice}: {loss} {expected}");
        for (tensor, expected) in layout.tensors().iter().zip(&gradients) {
            let found = &gradient[tensor.range.clone()];
            let error = worst(found, expected);
            assert!(error < tolerance.weights, "{choice}, {}: {error}", tensor.name);
            if let Some(expected) = norm_of(&tensor.name) {
                let norm = found.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
                assert!((norm / expected - 1.0).abs() < 1e-3, "{choice}, {}: {norm} {expected}", tensor.name);
            }
        }
        let error = worst(&by_patch, &expected_by_patch);
        println!("{choice}: loss {:.1e}, grad_input {error:.1e}", (loss - expected).abs() / expected);
        assert!(error < tolerance.patches, "{choice}, grad_input: {error}");
        let bits = engine.cross_entropy_bits(&model, noisy.view()).unwrap();
        assert!((bits.iter().sum::<f64>() / 4.0 * std::f64::consts::LN_2 - expected).abs() < 1e-4 * expected);
    }
}

#[test]
fn all_engines_compute_the_same() {
    let (model, patches) = small_model(5);
    let reference = model.loss_and_gradients(patches.view()).unwrap();
    let bits = model.cross_entropy_bits(patches.view()).unwrap();
    for choice in engines() {
        let mut engine = choice.open().unwrap();
        assert_eq!(engine.choice(), choice);
        let found = model.loss_and_gradients_on(engine.as_mut(), patches.view()).unwrap();
        let close = (found.0 - reference.0).abs() < 1e-5 * reference.0.abs();
        assert!(close, "{choice}: {} {}", found.0, reference.0);
        let mut parts: Vec<(&str, &[f32], &[f32])> = Vec::new();
        for tensor in model.layout().tensors() {
            parts.push((&tensor.name, &found.1[tensor.range.clone()], &reference.1[tensor.range.clone()]));
        }
        parts.push(("patches", found.2.as_slice().unwrap(), reference.2.as_slice().unwrap()));
        let mut largest = 0.0_f64;
        for (name, found, expected) in parts {
            let square = |pairs: &mut dyn Iterator<Item = f32>| pairs.map(|x| f64::from(x).powi(2)).sum::<f64>();
            let error = square(&mut found.iter().zip(expected).map(|(x, y)| x - y));
            let norm = square(&mut expected.iter().copied());
            assert!(norm > 0.0, "{name} has a gradient");
            let error = (error / norm).sqrt();
            assert!(error < 1e-3, "{choice}, {name}: {error}");
            largest = largest.max(error);
        }
        println!("{choice}: gradients differ by {largest:.1e} of their norm at most");
        for (found, expected) in engine.cross_entropy_bits(&model, patches.view()).unwrap().iter().zip(&bits) {
            assert!((found - expected).abs() < 1e-5 * expected.abs(), "{choice}: {found} {expected}");
        }
    }
}

#[test]
fn a_fit_goes_the_same_way_on_all_engines() {
    let patches = pixels_of_two_rates(60, 6, 1).1;
    let training = TrainingPatches { noisy: patches.view(), clean: None };
    let engines = engines();
    let fit = |&engine: &EngineChoice| {
        let fit = PixelCnnFit { batch: 8, steps_per_epoch: 5, max_epochs: 2, engine, ..PixelCnnFit::standard(5) };
        let shape = PixelCnnShape::new(8, 4, vec![1, 2]).unwrap();
        fit.fit(shape, 1.0, &PixelCnnContext::new(training), &mut CancelToken::new()).unwrap().1
    };
    let fits: Vec<_> = engines.iter().map(fit).collect();
    for (choice, report) in engines.iter().zip(&fits) {
        assert_eq!(report.steps, 10);
        for (found, expected) in report.epochs.iter().zip(&fits[0].epochs) {
            assert!((found.1 - expected.1).abs() < 1e-3, "{choice}: {} {}", found.1, expected.1);
        }
    }
    assert!(fits[0].epochs[1].1 < fits[0].epochs[0].1, "ten steps lead somewhere: {:?}", fits[0].epochs);
}

const RATES: [f32; 2] = [10.0, 40.0];

/// Independent pixels of two rates, without and with shot noise.
fn pixels_of_two_rates(count: usize, side: usize, seed: u64) -> (Array3<f32>, Array3<f32>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let clean = Array3::from_shape_simple_fn((count, side, side), || RATES[usize::from(rng.random::<bool>())]);
    let noisy = clean.mapv(|x| Poisson::new(x).unwrap().sample(&mut rng));
    (clean, noisy)
}

/// Information of a pixel of two rates, bits: the sum over all counts.
fn information_of_two_rates() -> f64 {
    let probability = |k: usize, x: f64| (1..=k).fold((-x).exp(), |p, i| p * x / i as f64);
    let entropy_y: f64 = (0..120)
        .map(|k| RATES.map(|rate| 0.5 * probability(k, f64::from(rate))).iter().sum::<f64>())
        .map(|p| -p * p.log2())
        .sum();
    entropy_y - 0.5 * (poisson_entropy(10.0) + poisson_entropy(40.0))
}

fn half_width(trial: &Trial) -> f64 {
    0.5 * (trial.interval_95()[1] - trial.interval_95()[0])
}

#[test]
fn an_estimate_bounds_the_information_from_above() {
    let (train_clean, train) = pixels_of_two_rates(400, 4, 1);
    let (test_clean, test) = pixels_of_two_rates(500, 4, 2);
    let request = PixelCnnRequest {
        train: train.view(),
        train_clean: Some(train_clean.view()),
        test: test.view(),
        test_clean: Some(test_clean.view()),
        noise: Noise::Shot,
        protocol: Protocol::Default,
        budget: Some(Duration::from_millis(500)),
        start: None,
        keeper: None,
        engine: EngineChoice::Cpu,
        seed: 3,
    };
    let (trial, model) = pixelcnn_estimate(&request, &mut CancelToken::new()).unwrap();
    let (found, truth) = (trial.bits_per_pixel(), information_of_two_rates());
    assert!(found > truth - half_width(&trial), "{found} below {truth}");
    assert!(trial.notes()[0].contains("new noise"), "{:?}", trial.notes());
    assert_eq!(trial.settings().estimator.to_string(), "pixelcnn");
    assert_eq!(trial.engine(), Some(EngineChoice::Cpu));
    assert!((model.scale().mean - 25.0).abs() < 1.0);
}

#[test]
fn independent_pixels_are_bounded_tightly() {
    let (clean, noisy) = pixels_of_two_rates(400, 4, 1);
    // New noise in each epoch, and a number of steps that does not depend on the machine.
    let training = TrainingPatches { noisy: noisy.view(), clean: Some((clean.view(), Noise::Shot)) };
    let fit = PixelCnnFit { batch: 16, steps_per_epoch: 150, max_epochs: 2, ..PixelCnnFit::standard(3) };
    let shape = PixelCnnShape::new(16, 12, vec![1]).unwrap();
    let (model, report) = fit.fit(shape, 1.0, &PixelCnnContext::new(training), &mut CancelToken::new()).unwrap();
    assert_eq!(report.steps, 300);
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let test = pixels_of_two_rates(2000, 4, 2).1.mapv(|count| count + rng.random::<f32>());
    let bits = model.cross_entropy_bits(test.view()).unwrap();
    let entropy_y = bits.iter().sum::<f64>() / bits.len() as f64;
    let entropy_y_given_x = 0.5 * (poisson_entropy(10.0) + poisson_entropy(40.0));
    let (found, truth) = (entropy_y - entropy_y_given_x, information_of_two_rates());
    let gaussian = gaussian_entropy(250.0 + 1.0 / 12.0) - entropy_y_given_x;
    println!("found {found:.4}, truth {truth:.4}, Gaussian {gaussian:.4}");
    assert!(found > truth - 0.02 && found < truth + 0.05 && found < gaussian - 0.05, "{found}: {truth} to {gaussian}");
}

#[test]
fn a_budget_ends_a_fit_and_says_whether_that_was_early() {
    let patches = pixels_of_two_rates(100, 4, 1).1;
    let training = TrainingPatches { noisy: patches.view(), clean: None };
    let run = |fit: PixelCnnFit| {
        let shape = PixelCnnShape::new(8, 4, vec![1]).unwrap();
        fit.fit(shape, 1.0, &PixelCnnContext::new(training), &mut CancelToken::new()).unwrap().1
    };
    let (short, long) = (Some(Duration::from_millis(30)), Some(Duration::from_hours(1)));
    let early = run(PixelCnnFit { budget: short, ..PixelCnnFit::paper(1) });
    assert!(early.cut_short && early.steps > 0 && early.epochs.len() < 20, "{early:?}");
    // A schedule planned for the budget ends with it.
    let planned = run(PixelCnnFit { budget: short, ..PixelCnnFit::standard(1) });
    assert!(!planned.cut_short && planned.steps > 0, "{planned:?}");
    // A fit that converges first ends before it.
    let done = run(PixelCnnFit {
        budget: long,
        steps_per_epoch: 2,
        patience: Some(1),
        max_epochs: 3,
        ..PixelCnnFit::paper(1)
    });
    assert!(!done.cut_short && done.steps <= 6, "{done:?}");
}

#[test]
fn steps_without_finite_numbers_are_refused() {
    let patches = pixels_of_two_rates(100, 4, 1).1;
    let training = TrainingPatches { noisy: patches.view(), clean: None };
    for engine in engines() {
        // One step at this rate makes the squares of all weights overflow.
        let fit = PixelCnnFit { rate: 1e30, engine, ..PixelCnnFit::paper(1) };
        let shape = PixelCnnShape::new(8, 4, vec![1]).unwrap();
        let mut steps = 0;
        let fitted = fit.fit(shape, 1.0, &PixelCnnContext::new(training), &mut |progress: &FitProgress| {
            steps = progress.step;
            ControlFlow::Continue(())
        });
        assert_eq!(fitted.unwrap_err(), InformationError::Diverged { refused: 30 });
        assert!(steps < 60, "{steps}");
    }
}

#[test]
fn a_fit_is_cancelled_at_the_step_that_is_told() {
    let patches = pixels_of_two_rates(100, 4, 1).1;
    let training = TrainingPatches { noisy: patches.view(), clean: None };
    let mut seen = Vec::new();
    let shape = PixelCnnShape::new(8, 4, vec![1]).unwrap();
    let found =
        PixelCnnFit::paper(1).fit(shape, 1.0, &PixelCnnContext::new(training), &mut |progress: &FitProgress| {
            seen.push(progress.step);
            if progress.step == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
    assert_eq!(found.unwrap_err(), InformationError::Cancelled);
    assert_eq!(seen, [1, 2, 3]);
}

#[test]
fn the_published_procedure_stops_without_improvement_and_keeps_the_best() {
    // A second value, seen once: the network soon converges.
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let patches = Array3::from_shape_simple_fn((80, 4, 4), || 50.0 + rng.sample::<f32, _>(StandardNormal));
    let training = TrainingPatches { noisy: patches.view(), clean: None };
    let shape = PixelCnnShape::new(8, 4, vec![1]).unwrap();
    let fit = PixelCnnFit { steps_per_epoch: 5, patience: Some(3), ..PixelCnnFit::paper(1) };
    let (model, report) = fit.fit(shape, 1.0, &PixelCnnContext::new(training), &mut CancelToken::new()).unwrap();
    let bits: Vec<f64> = report.epochs.iter().map(|epoch| epoch.1).collect();
    let best = bits.iter().copied().fold(f64::INFINITY, f64::min);
    assert!((bits[report.best_epoch - 1] - best).abs() < 1e-12);
    assert!(report.epochs.len() == report.best_epoch + 3 || report.epochs.len() == 200, "{report:?}");
    assert_eq!(report.steps, 5 * report.epochs.len());
    assert!(!report.cut_short && report.refused == 0);
    assert!(model.weights().iter().all(|weight| weight.is_finite()));
    // A warm start from this fit is better at once.
    let (_, warm) = PixelCnnFit { max_epochs: 1, ..fit.clone() }
        .fit(
            PixelCnnShape::new(8, 4, vec![1]).unwrap(),
            1.0,
            &PixelCnnContext { start: Some(&model), ..PixelCnnContext::new(training) },
            &mut CancelToken::new(),
        )
        .unwrap();
    assert!(warm.epochs[0].1 < bits[0], "{} {}", warm.epochs[0].1, bits[0]);
}

#[test]
fn epochs_end_with_their_last_step() {
    let patches = Array3::from_shape_fn((8, 2, 2), |(n, r, c)| ((n * 5 + r * 3 + c) % 7) as f32);
    let training = TrainingPatches { noisy: patches.view(), clean: None };
    // Shares of 98 steps, taken 49 times, are not always whole numbers.
    let fit = PixelCnnFit { batch: 4, steps_per_epoch: 2, max_epochs: 49, patience: None, ..PixelCnnFit::paper(1) };
    let shape = PixelCnnShape::new(2, 2, vec![1]).unwrap();
    let mut epochs = Vec::new();
    let (_, report) = fit
        .fit(shape, 1.0, &PixelCnnContext::new(training), &mut |progress: &FitProgress| {
            epochs.push((progress.step, progress.epoch));
            ControlFlow::Continue(())
        })
        .unwrap();
    // Epochs are reported again during validation.
    epochs.dedup();
    assert_eq!(epochs, (1..=98).map(|step| (step, usize::div_ceil(step, 2))).collect::<Vec<_>>());
    assert_eq!((report.steps, report.epochs.len()), (98, 49));
}

#[test]
fn bad_patches_get_reasons() {
    let (clean, noisy) = pixels_of_two_rates(100, 4, 1);
    let estimate = |train: &Array3<f32>, test: &Array3<f32>, train_clean: Option<&Array3<f32>>| {
        let request = PixelCnnRequest {
            train: train.view(),
            train_clean: train_clean.map(|clean| clean.view()),
            test: test.view(),
            test_clean: None,
            noise: Noise::Shot,
            protocol: Protocol::Default,
            budget: Some(Duration::from_millis(1)),
            start: None,
            keeper: None,
            engine: EngineChoice::Cpu,
            seed: 1,
        };
        pixelcnn_estimate(&request, &mut CancelToken::new()).unwrap_err()
    };
    let constant = Array3::from_elem((100, 4, 4), 7.0);
    assert_eq!(estimate(&constant, &noisy, None), InformationError::Constant { value: 7.0 });
    let few = noisy.slice(s![..4, .., ..]).to_owned();
    assert!(matches!(estimate(&few, &noisy, None), InformationError::TooFewPatches { needed: 5, found: 4, .. }));
    let with = |value: f32| {
        let mut patches = noisy.clone();
        patches[[40, 1, 2]] = value;
        patches
    };
    assert!(matches!(estimate(&with(f32::NAN), &noisy, None), InformationError::NotFinite { patch: 40, .. }));
    assert!(matches!(estimate(&noisy, &with(f32::NAN), None), InformationError::NotFinite { patch: 40, .. }));
    let message = estimate(&with(2e7), &noisy, None).to_string();
    assert!(message.contains("10000000") && message.contains("20000000"), "{message}");
    let narrow = noisy.slice(s![.., .., ..3]).to_owned();
    assert!(matches!(estimate(&noisy, &narrow, None), InformationError::PatchShape { .. }));
    let fewer = clean.slice(s![..50, .., ..]).to_owned();
    assert!(matches!(estimate(&noisy, &noisy, Some(&fewer)), InformationError::PatchCount { .. }));
    let empty = Array3::zeros((0, 4, 4));
    assert!(matches!(estimate(&noisy, &empty, None), InformationError::TooFewPatches { .. }));
    assert!(matches!(estimate(&noisy, &noisy, Some(&with(f32::NAN))), InformationError::NotFinite { patch: 40, .. }));
    let message = estimate(&noisy, &noisy, Some(&with(-1e8))).to_string();
    assert!(message.contains("found -100000000"), "{message}");
    let pointless = Array3::zeros((10, 0, 4));
    assert!(matches!(estimate(&pointless, &pointless, None), InformationError::PatchSize { .. }));
}
