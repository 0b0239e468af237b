//! Outputs, loss, gradients and running statistics against those of the same network in `PyTorch`.

use std::path::{Path, PathBuf};

use super::burn_module::BurnPasses;
use super::layers::Layers;
use super::passes::{Evaluation, Example, Passes};
use crate::formats::read_npz_f64;
use crate::information::BurnDevice;
use crate::progress::CancelToken;

/// The values by `PyTorch`: weights, one batch, and what becomes of both.
struct Reference(PathBuf);

impl Reference {
    fn open() -> Option<Self> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/reference/unet_96.npz");
        if path.exists() {
            return Some(Self(path));
        }
        println!("skipped: ../shared is absent");
        None
    }

    fn array(&self, name: &str) -> Vec<f32> {
        read_npz_f64(&self.0, Some(name)).unwrap().iter().map(|&value| value as f32).collect()
    }

    /// Our tensor of a name and shape. Kernels are (out, in, rows, cols) in the file.
    fn tensor(&self, group: &str, name: &str, shape: &[usize]) -> Vec<f32> {
        let (layer, part) = name.rsplit_once('.').unwrap();
        let part = match (layer, part) {
            ("out", "kernel") => "weight",
            ("out", _) => "bias",
            (_, "kernel") => "conv.weight",
            (_, "gain") => "bn.weight",
            (_, "shift") => "bn.bias",
            (_, "running_mean") => "bn.running_mean",
            _ => "bn.running_var",
        };
        let values = self.array(&format!("{group}.{layer}.{part}"));
        let &[taps, inputs, outputs] = shape else { return values };
        let place = |at: usize| {
            let (tap, input, output) = (at / (inputs * outputs), at / outputs % inputs, at % outputs);
            values[(output * inputs + input) * taps + tap]
        };
        (0..values.len()).map(place).collect()
    }
}

/// Largest difference as a share of the largest value.
fn worst(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let error = found.iter().zip(expected).map(|(x, y)| f64::from((x - y).abs())).fold(0.0, f64::max);
    error / expected.iter().map(|y| f64::from(y.abs())).fold(0.0, f64::max)
}

#[test]
fn outputs_loss_and_gradients_are_those_of_the_published_network() {
    let Some(reference) = Reference::open() else { return };
    let layers = Layers::new();
    assert_eq!(layers.trained.count(), 152_497);
    let mut weights = layers.layout.draw(1);
    for tensor in layers.trained.tensors() {
        weights[tensor.range.clone()].copy_from_slice(&reference.tensor("param", &tensor.name, &tensor.shape));
    }
    // One value of this channel is zero but for less than 1e-5 and lies on the other side of zero in the reference: its gradient there
    // is not 0. It moves the gradients by all weights before it by up to 6e-4.
    weights[layers.blocks[8].norm.shift.start + 3] += 1e-5;
    let (images, truths) = (reference.array("input"), reference.array("target"));
    let pairs = images.chunks(96 * 96).zip(truths.chunks(96 * 96));
    let example = |(image, truth): (&[f32], &[f32])| Example { image: image.to_vec(), truth: truth.to_vec() };
    let batch: Vec<Example> = pairs.map(example).collect();

    let mut passes = Passes::new(&layers, (96, 96));
    let mut gradient = vec![f32::NAN; layers.trained.count()];
    let loss = passes.step(&mut weights, &batch, &mut gradient, &CancelToken::new()).unwrap();
    let expected = f64::from(reference.array("loss")[0]);
    assert!((loss / expected - 1.0).abs() < 1e-5, "{loss} {expected}");
    let results: Vec<f32> = passes.results().flatten().copied().collect();
    let error = worst(&results, &reference.array("output_train"));
    assert!(error < 1e-4, "{error}");
    let (trained, statistics) = layers.layout.tensors().split_at(layers.trained.tensors().len());
    for tensor in trained {
        let error = worst(&gradient[tensor.range.clone()], &reference.tensor("grad", &tensor.name, &tensor.shape));
        println!("gradient by {}: {error:.1e}", tensor.name);
        assert!(error < 1e-4, "{}: {error}", tensor.name);
    }
    for tensor in statistics {
        let expected = reference.tensor("buffer_after", &tensor.name, &tensor.shape);
        let error = worst(&weights[tensor.range.clone()], &expected);
        assert!(error < 1e-4, "{}: {error}", tensor.name);
    }
    let evaluation = Evaluation::new(&layers, &weights, (96, 96));
    let results: Vec<f32> = batch.iter().flat_map(|example| evaluation.result(&example.image)).collect();
    let error = worst(&results, &reference.array("output_eval"));
    assert!(error < 1e-4, "{error}");
}

/// Different code, the same mathematics.
#[test]
fn burn_gives_the_same_loss_gradients_and_statistics() {
    let layers = Layers::new();
    let mut weights = layers.layout.draw(5);
    let (rows, cols) = (8, 12);
    let numbers = |seed: usize| (0..rows * cols).map(|i| ((i * 37 + seed * 11) % 101) as f32 * 0.02 - 1.0).collect();
    let batch: Vec<Example> = (0..3).map(|k| Example { image: numbers(k), truth: numbers(k + 9) }).collect();
    let mut by_burn = weights.clone();
    let (mut gradient, mut gradient_by_burn) = (vec![0.0; layers.trained.count()], vec![0.0; layers.trained.count()]);
    let mut passes = Passes::new(&layers, (rows, cols));
    let loss = passes.step(&mut weights, &batch, &mut gradient, &CancelToken::new()).unwrap();
    let mut passes = BurnPasses::new(&layers, (rows, cols), BurnDevice::Ndarray).unwrap();
    let loss_by_burn = passes.step(&mut by_burn, &batch, &mut gradient_by_burn).unwrap();
    assert!((loss_by_burn / loss - 1.0).abs() < 1e-5, "{loss} {loss_by_burn}");
    for tensor in layers.trained.tensors() {
        let range = tensor.range.clone();
        let error = worst(&gradient_by_burn[range.clone()], &gradient[range]);
        assert!(error < 1e-3, "{}: {error}", tensor.name);
    }
    let (_, statistics) = layers.layout.tensors().split_at(layers.trained.tensors().len());
    for tensor in statistics {
        let error = worst(&by_burn[tensor.range.clone()], &weights[tensor.range.clone()]);
        assert!(error < 1e-5, "{}: {error}", tensor.name);
    }
}

#[test]
fn gradient_is_the_difference_of_the_loss() {
    let layers = Layers::new();
    let mut weights = layers.layout.draw(3);
    let numbers = |seed: usize| (0..96).map(|i| ((i * 37 + seed * 11) % 101) as f32 * 0.02 - 1.0).collect();
    let batch: Vec<Example> = (0..3).map(|k| Example { image: numbers(k), truth: numbers(k + 9) }).collect();
    let mut passes = Passes::new(&layers, (8, 12));
    let mut gradient = vec![f32::NAN; layers.trained.count()];
    let cancel = CancelToken::new();
    passes.step(&mut weights, &batch, &mut gradient, &cancel).unwrap();
    let mut unused = gradient.clone();
    for tensor in layers.trained.tensors() {
        // Along the gradient of one tensor.
        let range = tensor.range.clone();
        let square: f64 = gradient[range.clone()].iter().map(|&value| f64::from(value).powi(2)).sum();
        let step = 2e-4 / square.sqrt();
        let mut shifted = |step: f64| {
            let mut weights = weights.clone();
            for at in range.clone() {
                weights[at] += (f64::from(gradient[at]) * step) as f32;
            }
            passes.step(&mut weights, &batch, &mut unused, &cancel).unwrap()
        };
        let difference = (shifted(step) - shifted(-step)) / (2.0 * step);
        assert!((difference / square - 1.0).abs() < 0.05, "{}: {difference} {square}", tensor.name);
    }
    cancel.cancel();
    assert_eq!(passes.step(&mut weights, &batch, &mut unused, &cancel), None);
}
