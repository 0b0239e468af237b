//! Forward and backward pass of one sample through all unrolled steps.

use super::features::{ByEvidence, Evidence, Moves, PixelVariance, Pixels, REVEALED};
use super::features::{
    code_lengths, features, features_backward, probabilities, probabilities_backward, residuals, residuals_backward,
    update, update_backward,
};
use super::layers::{Decoder, FEATURES, INPUTS, Windows};
use super::problem::Problem;
use super::samples::Sample;
use super::update::{Activations, LayerScratch, Layers};
use crate::sensor::BlurWorkspace;

/// Weight of the code length of every step before the last in the loss.
const EARLIER_STEPS: f32 = 0.1;

/// Values of one step that the backward pass needs.
struct Kept {
    evidence: Evidence,
    pixels: Pixels,
    activations: Activations,
    moves: Moves,
}

/// Memory of one thread.
pub(in crate::information) struct Pass<'a> {
    scene: &'a Problem,
    windows: Windows,
    noise: PixelVariance,
    kept: Vec<Kept>,
    /// The sample that is decoded.
    pub sample: Sample,
    /// Memory for the blurs.
    pub blur: BlurWorkspace,
    squared_blur: BlurWorkspace,
    layers: LayerScratch,
    known_logits: Vec<f32>,
    variance: Vec<f32>,
    features: Vec<f32>,
    by_features: Vec<f32>,
    by_evidence: ByEvidence,
    by_claimed: Vec<f32>,
    by_gate: Vec<f32>,
    nats: Vec<f32>,
    by_light: Vec<f32>,
    by_variance: Vec<f32>,
    by_residual: Vec<f32>,
    by_precision: Vec<f32>,
    by_contrast: Vec<f32>,
}

impl<'a> Pass<'a> {
    /// Memory for decoders of `steps` steps.
    pub fn new(scene: &'a Problem, steps: usize) -> Self {
        let (sites, pixels) = (scene.site_count(), scene.pixels());
        let kept = || Kept {
            evidence: Evidence::new(sites),
            pixels: Pixels::new(pixels),
            activations: Activations::new(scene.sites),
            moves: Moves::new(sites),
        };
        let per_site = || vec![0.0; sites];
        let per_pixel = || vec![0.0; pixels];
        let sigma = scene.noise.read_sigma().unwrap_or(0.0);
        Self {
            scene,
            windows: Windows::new(scene.sites),
            noise: PixelVariance {
                per_photon: f32::from(u8::from(scene.noise.has_shot_noise())),
                constant: (sigma * sigma) as f32,
            },
            kept: (0..steps).map(|_| kept()).collect(),
            sample: Sample::default(),
            blur: scene.light.blur_workspace(),
            squared_blur: scene.squared.blur_workspace(),
            layers: LayerScratch::new(scene.sites),
            known_logits: per_site(),
            variance: per_site(),
            features: vec![0.0; FEATURES * sites],
            by_features: vec![0.0; FEATURES * sites],
            by_evidence: ByEvidence::new(sites),
            by_claimed: per_site(),
            by_gate: per_site(),
            nats: per_site(),
            by_light: per_site(),
            by_variance: per_site(),
            by_residual: per_pixel(),
            by_precision: per_pixel(),
            by_contrast: per_pixel(),
        }
    }

    /// Sites of the sample that are predicted.
    pub fn free_sites(&self) -> usize {
        self.sample.free.iter().filter(|&&free| free > 0.0).count()
    }

    /// Code length of the free sites under the prior, bits.
    pub fn prior_bits(&self) -> f64 {
        self.sample.prior_bits(self.scene.probability)
    }

    /// Decodes the sample; returns the code length of the free sites, bits, without their weight.
    pub fn forward(&mut self, decoder: &Decoder, weights: &[f32]) -> f64 {
        let prior = self.scene.prior_logit();
        for (logit, &known) in self.known_logits.iter_mut().zip(&self.sample.known) {
            *logit = if known == 0.0 || known == 1.0 { REVEALED * (2.0 * known - 1.0) } else { prior };
        }
        self.kept[0].evidence.logits.fill(prior);
        for step in 0..self.kept.len() {
            self.step_forward(step, decoder, weights);
        }
        let last = self.kept.len() - 1;
        self.score(last, 0.0);
        self.nats.iter().map(|&nats| f64::from(nats)).sum::<f64>() / std::f64::consts::LN_2
    }

    /// Log odds of every site after the last step; call [`Pass::forward`] first.
    pub fn claimed(&self) -> &[f32] {
        self.kept.last().map_or(&[], |kept| &kept.moves.claimed)
    }

    fn step_forward(&mut self, step: usize, decoder: &Decoder, weights: &[f32]) {
        let (scene, sample) = (self.scene, &self.sample);
        let (now, later) = self.kept.split_at_mut(step + 1);
        let (Kept { evidence, pixels, activations, moves }, next) = (&mut now[step], later.first_mut());
        let Evidence { logits, probability, gain, precision, contrast } = evidence;
        probabilities(&sample.free, &sample.known, &self.known_logits, logits, probability, &mut self.variance);
        scene.light.blur(probability, &mut pixels.expected, &mut self.blur);
        scene.squared.blur(&self.variance, &mut pixels.precision, &mut self.squared_blur);
        residuals(&sample.noisy, scene.bias, self.noise, pixels);
        scene.light.blur_transposed(&pixels.residual, gain, &mut self.blur);
        scene.squared.blur_transposed(&pixels.precision, precision, &mut self.squared_blur);
        scene.light.blur_transposed(&pixels.contrast, contrast, &mut self.blur);
        features(evidence, &sample.free, &scene.per_light, &mut self.features);
        let layers = Layers { sites: scene.sites, windows: &self.windows, step: &decoder.steps[step], weights };
        let (next_logits, next_inputs) = match next {
            Some(next) => (Some(&mut next.evidence.logits), Some(&mut next.activations.inputs[..])),
            None => (None, None),
        };
        layers.forward(&self.features, activations, moves, next_inputs, &mut self.layers);
        // The next logits of the last step are not used.
        let next_logits = next_logits.unwrap_or(&mut self.variance);
        update(evidence, scene.prior_logit(), moves, next_logits);
    }

    /// Code lengths of the free sites after a step, and `weight` times their gradients by its log odds.
    fn score(&mut self, step: usize, weight: f32) {
        let (sample, prior) = (&self.sample, self.scene.prior_logit());
        let claimed = &self.kept[step].moves.claimed;
        code_lengths(&sample.beads, &sample.free, prior, weight, claimed, &mut self.nats, &mut self.by_claimed);
    }

    /// Adds `weight` times the gradient of the loss by the weights to `gradient`; call [`Pass::forward`] first. The
    /// loss is the code length of the last step plus a tenth of that of the earlier ones, nats.
    pub fn backward(&mut self, decoder: &Decoder, weights: &[f32], weight: f32, gradient: &mut [f32]) {
        let last = self.kept.len() - 1;
        self.layers.by_inputs.fill(0.0);
        self.by_evidence.logits.fill(0.0);
        for step in (0..=last).rev() {
            self.score(step, if step == last { weight } else { EARLIER_STEPS * weight });
            self.step_backward(step, decoder, weights, gradient);
        }
    }

    fn step_backward(&mut self, step: usize, decoder: &Decoder, weights: &[f32], gradient: &mut [f32]) {
        let (scene, sample) = (self.scene, &self.sample);
        let Kept { evidence, pixels, activations, moves } = &self.kept[step];
        let by = &mut self.by_evidence;
        update_backward(evidence, moves, scene.prior_logit(), by, &mut self.by_claimed, &mut self.by_gate);
        let layers = Layers { sites: scene.sites, windows: &self.windows, step: &decoder.steps[step], weights };
        let (by_features, scratch) = (&mut self.by_features, &mut self.layers);
        layers.backward(activations, &self.by_claimed, &self.by_gate, gradient, by_features, scratch);
        if step == 0 {
            // The first logits are those of the prior.
            return;
        }
        features_backward(evidence, &scene.per_light, &self.by_features, by);
        scene.light.blur(&by.gain, &mut self.by_residual, &mut self.blur);
        scene.squared.blur(&by.precision, &mut self.by_precision, &mut self.squared_blur);
        scene.light.blur(&by.contrast, &mut self.by_contrast, &mut self.blur);
        let (by_residual, by_precision) = (&mut self.by_residual, &mut self.by_precision);
        residuals_backward(&sample.noisy, self.noise, pixels, &self.by_contrast, by_residual, by_precision);
        scene.light.blur_transposed(&self.by_residual, &mut self.by_light, &mut self.blur);
        scene.squared.blur_transposed(&self.by_precision, &mut self.by_variance, &mut self.squared_blur);
        probabilities_backward(&sample.free, &evidence.probability, &self.by_variance, &self.by_light, by);
    }
}

const _: () = assert!(INPUTS == 24, "the window products know 16 and 24 channels");

#[cfg(test)]
mod tests {
    use super::super::channel::BeadChannel;
    use super::super::samples::{Purpose, Reveal, SampleId};
    use super::*;
    use crate::sensor::Noise;
    use ndarray::Array3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    fn scene(noise: Noise) -> Problem {
        let spot = Array3::from_shape_fn((2, 3, 4), |(z, r, c)| ((z * 5 + r * 3 + c * 7) % 11) as f64 * 4.0);
        Problem::new(&BeadChannel { spot, probability: 0.15, bias: 6.0, noise, patch: (6, 5) }).unwrap()
    }

    fn loss(pass: &mut Pass<'_>, decoder: &Decoder, weights: &[f32]) -> f64 {
        pass.forward(decoder, weights);
        let last = pass.kept.len() - 1;
        let steps = (0..=last).map(|step| {
            pass.score(step, 0.0);
            let nats: f64 = pass.nats.iter().map(|&nats| f64::from(nats)).sum();
            nats * if step == last { 1.0 } else { f64::from(EARLIER_STEPS) }
        });
        steps.sum()
    }

    #[test]
    fn gradients_are_slopes_of_the_loss() {
        for noise in [Noise::Shot, Noise::Read { sigma: 3.0 }, Noise::ShotRead { sigma: 2.0 }] {
            let scene = scene(noise);
            let mut random = ChaCha8Rng::seed_from_u64(7);
            let mut decoder = Decoder::new(3, 2).unwrap();
            for weight in &mut decoder.weights {
                *weight += 0.05 * random.sample::<f32, _>(StandardNormal);
            }
            let mut pass = Pass::new(&scene, 3);
            let revealed = |_: &mut ChaCha8Rng| Reveal::Random { count: scene.decoded.len() / 4, weight: 1.0 };
            pass.sample.draw(
                &scene,
                SampleId { seed: 4, purpose: Purpose::Training, index: 0 },
                revealed,
                &mut pass.blur,
            );
            pass.forward(&decoder, &decoder.weights);
            let mut gradient = vec![0.0; decoder.layout.count()];
            pass.backward(&decoder, &decoder.weights, 1.0, &mut gradient);
            for tensor in decoder.layout.tensors() {
                let direction: Vec<f32> = tensor.range.clone().map(|_| random.sample(StandardNormal)).collect();
                let length = direction.iter().map(|d| d * d).sum::<f32>().sqrt();
                let step = 4e-3 / length;
                let mut moved = |by: f32| {
                    let mut weights = decoder.weights.clone();
                    for (weight, d) in weights[tensor.range.clone()].iter_mut().zip(&direction) {
                        *weight += by * d;
                    }
                    loss(&mut pass, &decoder, &weights)
                };
                let slope = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
                let along = gradient[tensor.range.clone()].iter().zip(&direction);
                let found: f64 = along.map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
                let tolerance = 0.01 * slope.abs() + 2e-3 * f64::from(length);
                println!("{noise} {}: {found} {slope}", tensor.name);
                assert!((found - slope).abs() < tolerance, "{noise} {}: {found} {slope}", tensor.name);
            }
        }
    }

    #[test]
    fn a_decoder_without_evidence_knows_the_prior() {
        let scene = scene(Noise::Shot);
        let mut decoder = Decoder::new(1, 2).unwrap();
        decoder.weights.fill(0.0);
        // A closed gate leaves the prior.
        let gate = decoder.steps[0].heads.1.start + 1;
        decoder.weights[gate] = -80.0;
        let mut pass = Pass::new(&scene, 1);
        pass.sample.draw(
            &scene,
            SampleId { seed: 4, purpose: Purpose::Test, index: 3 },
            |_| Reveal::Nothing,
            &mut pass.blur,
        );
        let bits = pass.forward(&decoder, &decoder.weights);
        assert!((bits / pass.prior_bits() - 1.0).abs() < 1e-5, "{bits} {}", pass.prior_bits());
    }
}
