//! Gradient of the information by the encoded images, with the model's weights held fixed. It links a density model
//! to the mask that makes the images.

use ndarray::{Array3, ArrayView3, Axis};
use rayon::prelude::*;

use super::conditioning::{InputGradients, PatchInputs};
use super::head::{FARTHEST, exact_loss, level_losses};
use super::levels::Levels;
use super::model::CausalModel;
use super::network::Workspace;
use crate::information::density::frozen::FrozenDensity;
use crate::information::entropy::reparameterisation::{DARKEST, Reparameterised};
use crate::information::error::InformationError;
use crate::nn::if_not_negligible;
use crate::progress::Progress;

impl FrozenDensity for CausalModel {
    /// Both terms of `log2 p(y|x) - log2 q(y)` at the same measurements. For Poisson counts the part that depends on
    /// y alone drops out of both.
    fn information_gradient(
        &self,
        clean: ArrayView3<'_, f32>,
        normals: ArrayView3<'_, f32>,
        _progress: &mut dyn Progress<usize>,
    ) -> Result<(f64, Array3<f64>), InformationError> {
        let noise = Reparameterised::new(self.conditioning.noise);
        let mut noisy = clean.to_owned();
        noisy.zip_mut_with(&normals, |x, e| *x = noise.measured(f64::from(*x), f64::from(*e)) as f32);
        self.check_shape(noisy.view())?;
        let inputs = self.conditioning.inputs(noisy.view());
        let pixels = noisy.len() / noisy.len_of(Axis(0)).max(1);
        let parts: Vec<PatchLoss> = (0..noisy.len_of(Axis(0)))
            .into_par_iter()
            .with_max_len(1)
            .map(|index| {
                self.workspaces.with(self, |workspace| self.loss_by_patch(workspace, inputs.patch(index, pixels)))
            })
            .collect();
        // The gradient through the prediction is computed for all patches together: its matrix is large.
        let by_predicted: Vec<f32> = parts.iter().flat_map(|part| part.by_predicted.iter().copied()).collect();
        let through = self.conditioning.through_predictions(&by_predicted);
        let losses = parts.iter().flat_map(|part| part.nats.iter().zip(&part.by_values)).zip(&through);
        let mut gradient = Array3::zeros(clean.dim());
        let mut total = 0.0;
        let pixels = gradient.iter_mut().zip(clean.iter().zip(&normals)).zip(&noisy);
        for (((out, (&x, &e)), &y), ((&nats, &by_value), &through)) in pixels.zip(losses) {
            let (seen, e, y) = (f64::from(x).max(DARKEST), f64::from(e), f64::from(y));
            let [log, slope_y, slope_x] = self.likelihood(y, seen);
            total += nats + log;
            // Darker pixels all count as this dark.
            let is_dark = f64::from(x) < seen;
            let slope = || slope_x + (slope_y + by_value + f64::from(through)) * noise.slope(seen, e);
            *out = if is_dark { 0.0 } else { slope() };
        }
        let share = 1.0 / (noisy.len().max(1) as f64 * std::f64::consts::LN_2);
        gradient *= share;
        Ok((total * share, gradient))
    }
}

impl CausalModel {
    /// Losses `-ln q` of every pixel of one patch, and the gradients of their sum; Poisson likelihoods without the
    /// part that depends on y alone.
    fn loss_by_patch(&self, workspace: &mut Workspace, inputs: PatchInputs<'_>) -> PatchLoss {
        let pixels = inputs.values.len();
        let count = self.conditioning.levels.count();
        let mut by_outputs = workspace.forward(&self.layers, &self.weights, inputs).to_vec();
        let mut by = InputGradients::new(pixels);
        let mut nats = Vec::with_capacity(pixels);
        let mut mixture = Mixture::new(count);
        for (pixel, outputs) in by_outputs.chunks_exact_mut(count + 1).enumerate() {
            let y = f64::from(inputs.values[pixel]);
            let loss = mixture.loss(&self.conditioning.levels, y, inputs.guess[pixel], outputs);
            nats.push(loss.nats);
            by.values[pixel] = loss.by_y;
            by.guess[pixel] = loss.by_guess;
        }
        workspace.set_output_gradients(&by_outputs);
        workspace.backward(&self.layers, &self.weights, inputs, None);
        workspace.by_inputs(&self.layers, &self.weights, &mut by.window, &mut by.present);
        let (by_values, by_predicted) = self.conditioning.by_values(inputs, by);
        PatchLoss { nats, by_values, by_predicted }
    }

    /// ln p(y | x) as in [`Levels::smooth_likelihoods`], and its derivatives by y and by x.
    fn likelihood(&self, y: f64, x: f64) -> [f64; 3] {
        let read = self.conditioning.noise.read_sigma().map_or(0.0, |sigma| sigma * sigma);
        if self.conditioning.levels.has_counts() {
            return [y * x.ln() - x, x.ln(), y / x - 1.0];
        }
        let (variance, by_x) = if self.conditioning.noise.has_shot_noise() { (x + read, 1.0) } else { (read, 0.0) };
        let z = y - x;
        let log = -0.5 * (z * z / variance + (std::f64::consts::TAU * variance).ln());
        let by_variance = 0.5 * (z * z / variance - 1.0) / variance;
        [log, -z / variance, z / variance + by_variance * by_x]
    }
}

/// Losses of the pixels of one patch, and their gradients.
struct PatchLoss {
    nats: Vec<f64>,
    /// By the photons, without the part through the prediction.
    by_values: Vec<f64>,
    by_predicted: Vec<f32>,
}

/// Loss of one pixel and its derivatives.
struct PixelLoss {
    nats: f64,
    by_y: f64,
    /// By the predicted mean and by -1/2 over its variance.
    by_guess: (f64, f64),
}

/// The mixture of one pixel, with room to work in.
struct Mixture {
    logs: Vec<f64>,
    shares: Vec<f32>,
    slopes: Vec<f32>,
    /// The outputs before they are replaced by their gradients.
    before: Vec<f32>,
    /// Gradients of the prediction and weights as [`level_losses`] leaves them, and scratch space.
    scratch: Vec<f32>,
}

impl Mixture {
    fn new(levels: usize) -> Self {
        let numbers = || vec![0.0; levels];
        Self {
            logs: vec![0.0; levels],
            shares: numbers(),
            slopes: numbers(),
            before: vec![0.0; levels + 1],
            scratch: vec![0.0; 2 * levels + 1],
        }
    }

    /// The loss of a pixel that measured `y` and its derivatives; those by the outputs replace the outputs.
    fn loss(&mut self, levels: &Levels, y: f64, guess: (f32, f32), outputs: &mut [f32]) -> PixelLoss {
        let count = levels.count();
        let largest = levels.smooth_likelihoods(y, &mut self.logs, &mut self.shares, &mut self.slopes);
        let scale = f64::from(1.0 + outputs[count]);
        self.before.copy_from_slice(outputs);
        let mut nats = [0.0];
        let likelihoods = [(self.shares.as_slice(), 0.0)];
        level_losses(&levels.photons, &[guess], &likelihoods, 1.0, outputs, &mut nats, &mut self.scratch);
        let mut nats = f64::from(nats[0]) - largest;
        let (pulls, weights) = (&self.scratch[..count], &self.scratch[count..2 * count]);
        let mut by_y = 0.0;
        if nats.is_finite() {
            let (mut sum, mut slope) = (0.0_f32, 0.0_f32);
            for ((weight, share), by) in weights.iter().zip(&self.shares).zip(&self.slopes) {
                let posterior = weight * if_not_negligible(*share);
                sum += posterior;
                slope += posterior * by;
            }
            by_y -= f64::from(slope / sum);
        } else {
            outputs.copy_from_slice(&self.before);
            let (exact, posteriors) = exact_loss(&levels.photons, guess, &self.logs, 1.0, outputs);
            nats = exact;
            by_y -= posteriors.iter().zip(&self.slopes).map(|(posterior, by)| posterior * f64::from(*by)).sum::<f64>();
        }
        let (mut by_mean, mut by_half) = (0.0_f64, 0.0_f64);
        for ((&by_logit, &pull), &x) in outputs.iter().zip(pulls).zip(&levels.photons) {
            if pull > FARTHEST {
                let distance = f64::from(x - guess.0);
                by_mean += f64::from(by_logit) * distance;
                by_half += f64::from(by_logit) * distance * distance;
            }
        }
        PixelLoss { nats, by_y, by_guess: (-2.0 * scale * f64::from(guess.1) * by_mean, scale * by_half) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::conditioning::Moments;
    use super::super::init::Init;
    use super::super::shape::CausalShape;
    use super::super::stream::PatchBatch;
    use super::*;
    use crate::progress::CancelToken;
    use crate::sensor::Noise;

    #[test]
    fn the_gradient_is_that_of_finite_differences() {
        for noise in [Noise::Shot, Noise::Read { sigma: 3.0 }, Noise::ShotRead { sigma: 2.0 }] {
            let clean = Array3::from_shape_fn((12, 6, 7), |(n, r, c)| {
                let distance = (r as f32 - (n * 5 % 6) as f32).hypot(c as f32 - (n * 3 % 7) as f32);
                15.0 + 60.0 * (-0.3 * distance * distance).exp()
            });
            let sample = PatchBatch { noisy: noise.draw(clean.view(), 5), clean: Some(clean.clone()) };
            let moments = Moments::of_patches(sample.noisy.view()).unwrap();
            let shape = CausalShape { channels: 6, dilations: vec![1, 2] };
            let mut model = CausalModel::new(shape, noise, &sample, &moments, Init::Random, 3).unwrap();
            for (i, weight) in model.weights.iter_mut().enumerate() {
                *weight += 0.1 * ((i * 37 % 101) as f32 / 50.0 - 1.0);
            }
            let clean = clean.slice_move(ndarray::s![..2, .., ..]);
            let normals = clean.mapv(|x| (x * 7.3).sin() * 1.2);
            let value = |clean: &Array3<f32>| {
                model.information_gradient(clean.view(), normals.view(), &mut CancelToken::new()).unwrap()
            };
            let (bits, gradient) = value(&clean);
            assert!((0.0..5.0).contains(&bits), "{noise}: {bits}");
            for index in [(0, 0, 0), (0, 2, 3), (1, 3, 1), (1, 5, 6), (0, 4, 5), (1, 0, 3)] {
                let moved = |by: f32| {
                    let mut clean = clean.clone();
                    clean[index] += by;
                    value(&clean).0
                };
                let step = 0.05;
                let slope = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
                let found = gradient[index];
                assert!(
                    (slope - found).abs() < 0.01 * slope.abs() + 2e-5,
                    "{noise} {index:?}: differences {slope}, gradient {found}"
                );
            }
        }
    }
}
