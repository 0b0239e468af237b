//! How information changes with the encoded images, the model's weights held: the link between a density model and the
//! mask that makes the images.

use ndarray::{Array3, ArrayView3, Axis};
use rayon::prelude::*;

use super::conditioning::{InputGradients, Inputs};
use super::model::CausalModel;
use super::network::Workspace;
use crate::information::InformationError;
use crate::network::Write;
use crate::sensor::Noise;

/// Least photons of an encoded pixel for its noise.
const DARKEST: f64 = 1e-3;

impl CausalModel {
    /// Information of noisy patches under the model, bits per pixel, and its gradient by the encoded patches, bits per
    /// pixel and photon; all of shape (n, rows, cols).
    ///
    /// The noise is reparameterised, `y = x + s(x) e`, where s is the standard deviation of the noise at x and `normals`
    /// holds e (Kabuli et al. 2026); so the measurements move with the images, and both terms of
    /// `log2 p(y|x) - log2 q(y)` do. Of Poisson counts the part of both terms that depends on y alone drops out.
    ///
    /// # Errors
    /// For patches of another shape than the model's, or values that are not finite.
    pub fn information_gradient(
        &self,
        clean: ArrayView3<'_, f32>,
        normals: ArrayView3<'_, f32>,
    ) -> Result<(f64, Array3<f64>), InformationError> {
        let noise = Reparameterised::new(self.conditioning.noise);
        let mut noisy = clean.to_owned();
        noisy.zip_mut_with(&normals, |x, e| *x = noise.measured(f64::from(*x), f64::from(*e)) as f32);
        self.check_shape(noisy.view())?;
        let inputs = self.conditioning.inputs(noisy.view());
        let pixels = noisy.len() / noisy.len_of(Axis(0)).max(1);
        let mut gradient = Array3::zeros(clean.dim());
        let bits: Vec<f64> = gradient
            .axis_iter_mut(Axis(0))
            .into_par_iter()
            .enumerate()
            .map(|(index, mut gradient)| {
                let part = inputs.of_patch(index, pixels);
                let (nats, by_patch) = self.loss_by_patch(&part);
                let clean = clean.index_axis(Axis(0), index);
                let normals = normals.index_axis(Axis(0), index);
                let mut total = nats.iter().sum::<f64>();
                let given = clean.iter().zip(&normals).zip(&part.values).zip(by_patch);
                for (out, (((&x, &e), &y), by_y)) in gradient.iter_mut().zip(given) {
                    let (x, e, y) = (f64::from(x).max(DARKEST), f64::from(e), f64::from(y));
                    let [log, slope_y, slope_x] = self.likelihood(y, x);
                    total += log;
                    *out = slope_x + (slope_y + by_y) * noise.slope(x, e);
                }
                total
            })
            .collect();
        let share = 1.0 / (noisy.len().max(1) as f64 * std::f64::consts::LN_2);
        gradient *= share;
        Ok((bits.iter().sum::<f64>() * share, gradient))
    }

    /// -ln q of every pixel of one patch, nats, and the gradient of their sum by the patch; Poisson likelihoods without
    /// the part that depends on y alone.
    fn loss_by_patch(&self, inputs: &Inputs) -> (Vec<f64>, Vec<f64>) {
        let pixels = inputs.values.len();
        let part = inputs.patch(0, pixels);
        let mut workspace = Workspace::new(&self.shape, &self.layers, self.patch());
        let count = self.conditioning.levels.count();
        let outputs = workspace.forward(&self.layers, &self.weights, part).to_vec();
        let mut by_outputs = vec![0.0_f32; outputs.len()];
        let mut by = InputGradients::new(pixels);
        let mut losses = Vec::with_capacity(pixels);
        let per_pixel = outputs.chunks_exact(count + 1).zip(by_outputs.chunks_exact_mut(count + 1)).enumerate();
        for (pixel, (outputs, by_outputs)) in per_pixel {
            let y = f64::from(inputs.values[pixel]);
            let loss = self.pixel_loss(y, inputs.guess[pixel], outputs, by_outputs);
            losses.push(loss.nats);
            by.values[pixel] = loss.by_y;
            by.guess[pixel] = loss.by_guess;
        }
        let mut unused = vec![0.0; self.layout.count()];
        workspace.set_output_gradients(&by_outputs);
        workspace.backward(&self.layers, &self.weights, part, &mut unused, Write::Replace);
        workspace.by_inputs(&self.layers, &self.weights, &mut by.window, &mut by.present);
        let by_patch = self.conditioning.by_values(inputs, &by);
        (losses, by_patch)
    }

    /// The loss of one pixel in double precision and its derivatives; those by the outputs are written.
    fn pixel_loss(&self, y: f64, (mean, half): (f32, f32), outputs: &[f32], by_outputs: &mut [f32]) -> PixelLoss {
        let levels = &self.conditioning.levels;
        let count = levels.count();
        let (mean, half) = (f64::from(mean), f64::from(half));
        let scale = 1.0 + f64::from(outputs[count]);
        let distance = |level: usize| f64::from(levels.photons[level]) - mean;
        let pull = |level: usize| (distance(level).powi(2) * half).max(super::head::FARTHEST.into());
        let logits: Vec<f64> = (0..count).map(|level| f64::from(outputs[level]) + scale * pull(level)).collect();
        let terms: Vec<[f64; 2]> = (0..count).map(|level| levels.smooth_log_likelihood(y, level)).collect();
        let (total, weights) = softmax(logits.iter().copied());
        let (mixture, posteriors) = softmax(logits.iter().zip(&terms).map(|(logit, [log, _])| logit + log));
        let mut loss = PixelLoss { nats: total - mixture, by_y: 0.0, by_guess: (0.0, 0.0) };
        let mut by_scale = 0.0;
        for level in 0..count {
            let by_logit = weights[level] - posteriors[level];
            by_outputs[level] = by_logit as f32;
            by_scale += by_logit * pull(level);
            if pull(level) > super::head::FARTHEST.into() {
                loss.by_guess.0 -= by_logit * scale * 2.0 * distance(level) * half;
                loss.by_guess.1 += by_logit * scale * distance(level).powi(2);
            }
            loss.by_y -= posteriors[level] * terms[level][1];
        }
        by_outputs[count] = by_scale as f32;
        loss
    }

    /// ln p(y | x) as in [`super::levels::Levels::smooth_log_likelihood`], and its slopes by y and by x.
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

/// What one pixel loses, and derivatives.
struct PixelLoss {
    nats: f64,
    by_y: f64,
    /// By the predicted mean and by -1/2 over its variance.
    by_guess: (f64, f64),
}

/// ln of the sum of exponentials, and their shares.
fn softmax(logs: impl Iterator<Item = f64>) -> (f64, Vec<f64>) {
    let mut shares: Vec<f64> = logs.collect();
    let most = shares.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut sum = 0.0;
    for share in &mut shares {
        *share = (*share - most).exp();
        sum += *share;
    }
    for share in &mut shares {
        *share /= sum;
    }
    (most + sum.ln(), shares)
}

/// Noise as a function of the image and of standard normal numbers.
struct Reparameterised {
    shot: f64,
    read: f64,
}

impl Reparameterised {
    fn new(noise: Noise) -> Self {
        let read = noise.read_sigma().map_or(0.0, |sigma| sigma * sigma);
        Self { shot: f64::from(u8::from(noise.has_shot_noise())), read }
    }

    fn measured(&self, x: f64, e: f64) -> f64 {
        let x = x.max(DARKEST);
        x + (self.shot * x + self.read).sqrt() * e
    }

    /// dy/dx.
    fn slope(&self, x: f64, e: f64) -> f64 {
        1.0 + 0.5 * self.shot * e / (self.shot * x + self.read).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::super::conditioning::Moments;
    use super::super::shape::CausalShape;
    use super::super::stream::PatchBatch;
    use super::*;

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
            let mut model = CausalModel::new(shape, noise, &sample, &moments, None, 3).unwrap();
            for (i, weight) in model.weights.iter_mut().enumerate() {
                *weight += 0.1 * ((i * 37 % 101) as f32 / 50.0 - 1.0);
            }
            let clean = clean.slice_move(ndarray::s![..2, .., ..]);
            let normals = clean.mapv(|x| (x * 7.3).sin() * 1.2);
            let (bits, gradient) = model.information_gradient(clean.view(), normals.view()).unwrap();
            assert!((0.0..5.0).contains(&bits), "{noise}: {bits}");
            for index in [(0, 0, 0), (0, 2, 3), (1, 3, 1), (1, 5, 6), (0, 4, 5), (1, 0, 3)] {
                let moved = |by: f32| {
                    let mut clean = clean.clone();
                    clean[index] += by;
                    model.information_gradient(clean.view(), normals.view()).unwrap().0
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
