//! Features of the sites, updates of the logits, and the derivatives of both. All are passes over plain arrays with
//! one number per site or per pixel.

use super::layers::{FEATURES, HIDDEN, INPUTS, OUTPUTS};
use crate::nn::{exponential, logarithm, vectorised};

/// Limit of the log odds around zero between steps, or a little beyond those of the prior.
const STATE_LIMIT: f32 = 14.0;
/// Margin beyond that limit for the log odds of the last step.
const CLAIM_MARGIN: f32 = 4.0;
/// Log odds that the network receives for revealed sites.
pub(super) const REVEALED: f32 = 8.0;
/// Lower limit of precisions and variances.
const LEAST_PRECISION: f32 = 1e-4;
const LEAST_VARIANCE: f32 = 1e-2;
const LEAST_PHOTONS: f32 = 0.1;
/// Added to denominators to keep quotients finite.
const EPSILON: f32 = 1e-3;

/// Limits of the log odds under a prior: between steps, and of the output.
pub(super) fn limits(prior_logit: f32) -> (f32, f32) {
    let state = STATE_LIMIT.max(prior_logit.abs() + 2.0);
    (state, state + CLAIM_MARGIN)
}

/// Arrays over pixels: expected clean photons, precision of the residual (1 / photons squared), and residual over
/// variance.
#[derive(Clone, Debug)]
pub(super) struct Pixels {
    pub expected: Vec<f32>,
    pub precision: Vec<f32>,
    pub residual: Vec<f32>,
    /// Residual over the sum of expected and measured photons. It is bounded, so a bead not yet found does not mask
    /// others.
    pub contrast: Vec<f32>,
}

/// Noise of a pixel: variance per photon and variance without photons.
#[derive(Clone, Copy, Debug)]
pub(super) struct PixelVariance {
    pub per_photon: f32,
    pub constant: f32,
}

impl PixelVariance {
    /// Photons added to the denominator of a contrast, so that contrasts of dark pixels stay small.
    fn floor(self) -> f32 {
        self.constant.sqrt() + LEAST_PHOTONS
    }
}

impl Pixels {
    pub fn new(count: usize) -> Self {
        let zeros = || vec![0.0; count];
        Self { expected: zeros(), precision: zeros(), residual: zeros(), contrast: zeros() }
    }
}

vectorised! {
    /// Probabilities and their variances: from logits at free sites, from the known values elsewhere.
    pub(super) fn probabilities<'a, fused FUSED>(
        free: &'a [f32],
        known: &'a [f32],
        known_logits: &'a [f32],
        logits: &'a mut [f32],
        probability: &'a mut [f32],
        variance: &'a mut [f32],
    ) {
        let n = logits.len();
        let (free, known, known_logits) = (&free[..n], &known[..n], &known_logits[..n]);
        let (probability, variance) = (&mut probability[..n], &mut variance[..n]);
        for i in 0..n {
            let p = 1.0 / (1.0 + exponential::<FUSED>(-logits[i]));
            let p = free[i] * p + (1.0 - free[i]) * known[i];
            logits[i] = free[i] * logits[i] + (1.0 - free[i]) * known_logits[i];
            probability[i] = p;
            variance[i] = p * (1.0 - p);
        }
    }
}

vectorised! {
    /// Computes expected photons, precision and weighted residual of every pixel. On entry `pixels.expected` holds
    /// the blurred probabilities and `pixels.precision` the blurred variances.
    pub(super) fn residuals<'a>(noisy: &'a [f32], bias: f32, noise: PixelVariance, pixels: &'a mut Pixels) {
        let n = noisy.len();
        let Pixels { expected, precision, residual, contrast } = pixels;
        let (expected, precision) = (&mut expected[..n], &mut precision[..n]);
        let (residual, contrast) = (&mut residual[..n], &mut contrast[..n]);
        let floor = noise.floor();
        for i in 0..n {
            let x = expected[i].max(0.0) + bias;
            let variance = noise.per_photon * x + noise.constant + precision[i].max(0.0);
            let w = 1.0 / variance.max(LEAST_VARIANCE);
            expected[i] = x;
            precision[i] = w;
            residual[i] = (noisy[i] - x) * w;
            contrast[i] = (noisy[i] - x) / (x + noisy[i].max(0.0) + floor);
        }
    }
}

vectorised! {
    /// Replaces the gradients by residual and precision by those by the blurred probabilities and variances, from
    /// these and the gradient by the contrast.
    pub(super) fn residuals_backward<'a>(
        noisy: &'a [f32],
        noise: PixelVariance,
        pixels: &'a Pixels,
        by_contrast: &'a [f32],
        by_residual: &'a mut [f32],
        by_precision: &'a mut [f32],
    ) {
        let n = noisy.len();
        let Pixels { expected, precision, contrast, .. } = pixels;
        let (expected, precision, contrast) = (&expected[..n], &precision[..n], &contrast[..n]);
        let (floor, by_contrast) = (noise.floor(), &by_contrast[..n]);
        let (by_residual, by_precision) = (&mut by_residual[..n], &mut by_precision[..n]);
        for i in 0..n {
            let w = precision[i];
            let by_w = by_precision[i] + (noisy[i] - expected[i]) * by_residual[i];
            let by_variance = if w < 1.0 / LEAST_VARIANCE { -w * w * by_w } else { 0.0 };
            let by_light = by_contrast[i] * (1.0 + contrast[i]) / (expected[i] + noisy[i].max(0.0) + floor);
            by_residual[i] = noise.per_photon * by_variance - w * by_residual[i] - by_light;
            by_precision[i] = by_variance;
        }
    }
}

/// Inputs of a step at the sites, before its layers.
#[derive(Clone, Debug)]
pub(super) struct Evidence {
    pub logits: Vec<f32>,
    pub probability: Vec<f32>,
    /// Back-projected residual.
    pub gain: Vec<f32>,
    /// Back-projected precision.
    pub precision: Vec<f32>,
    /// Back-projected contrast.
    pub contrast: Vec<f32>,
}

impl Evidence {
    pub fn new(count: usize) -> Self {
        let zeros = || vec![0.0; count];
        Self { logits: zeros(), probability: zeros(), gain: zeros(), precision: zeros(), contrast: zeros() }
    }
}

/// Log-likelihood ratio of a bead for Gaussian noise, with all other sites at their expected values.
#[inline(always)]
#[allow(clippy::inline_always, reason = "part of the vector loops below")]
fn likelihood_ratio(gain: f32, precision: f32, probability: f32) -> f32 {
    gain + (probability - 0.5) * precision
}

vectorised! {
    /// Writes the features of all sites, one array after the other. `per_light` is 1 / photons that a bead leaves on
    /// the patch.
    pub(super) fn features<'a, fused FUSED>(
        evidence: &'a Evidence,
        free: &'a [f32],
        per_light: &'a [f32],
        features: &'a mut [f32],
    ) {
        let n = free.len();
        let (contrast, per_light) = (&evidence.contrast[..n], &per_light[..n]);
        let Evidence { logits, probability, gain, precision, .. } = evidence;
        let (s, p, g, h) = (&logits[..n], &probability[..n], &gain[..n], &precision[..n]);
        let (f0, rest) = features.split_at_mut(n);
        let (f1, rest) = rest.split_at_mut(n);
        let (f2, rest) = rest.split_at_mut(n);
        let (f3, rest) = rest.split_at_mut(n);
        let (f4, rest) = rest.split_at_mut(n);
        let (f5, rest) = rest.split_at_mut(n);
        let (f6, rest) = rest.split_at_mut(n);
        let f7 = &mut rest[..n];
        for i in 0..n {
            let precision = h[i].max(LEAST_PRECISION);
            let ratio = likelihood_ratio(g[i], precision, p[i]);
            let root = precision.sqrt();
            let size = ratio.abs();
            f0[i] = s[i] / 6.0;
            f1[i] = p[i];
            f2[i] = 4.0 / (1.0 + exponential::<FUSED>(-ratio / 4.0)) - 2.0;
            f3[i] = (logarithm::<FUSED>(size + (size * size + 1.0).sqrt()) / 3.0).copysign(ratio);
            f4[i] = g[i] / (3.0 * (root + EPSILON));
            f5[i] = logarithm::<FUSED>(1.0 + root) / 4.0;
            f6[i] = 1.0 - free[i];
            f7[i] = 2.0 * contrast[i] * per_light[i];
        }
    }
}

/// Gradients by the inputs of a step ([`Evidence`]).
#[derive(Clone, Debug)]
pub(super) struct ByEvidence {
    pub logits: Vec<f32>,
    pub probability: Vec<f32>,
    pub gain: Vec<f32>,
    pub precision: Vec<f32>,
    pub contrast: Vec<f32>,
    /// By the log-likelihood ratio where it enters the logit.
    pub ratio: Vec<f32>,
}

impl ByEvidence {
    pub fn new(count: usize) -> Self {
        let zeros = || vec![0.0; count];
        Self {
            logits: zeros(),
            probability: zeros(),
            gain: zeros(),
            precision: zeros(),
            contrast: zeros(),
            ratio: zeros(),
        }
    }
}

vectorised! {
    /// Adds the gradients by logits and replaces those by probability, gain, precision and contrast. They follow from
    /// the gradients by features and by the ratio.
    pub(super) fn features_backward<'a, fused FUSED>(
        evidence: &'a Evidence,
        per_light: &'a [f32],
        by_features: &'a [f32],
        by: &'a mut ByEvidence,
    ) {
        let n = by.logits.len();
        let Evidence { probability, gain, precision, .. } = evidence;
        let (p, g, h) = (&probability[..n], &gain[..n], &precision[..n]);
        let feature = |k: usize| &by_features[k * n..(k + 1) * n];
        let (b0, b1, b2, b3, b4, b5) = (feature(0), feature(1), feature(2), feature(3), feature(4), feature(5));
        let (b7, per_light) = (feature(7), &per_light[..n]);
        let ByEvidence { logits, probability, gain, precision, contrast, ratio } = by;
        let by_contrast = &mut contrast[..n];
        let (by_s, by_p, by_g, by_h) = (&mut logits[..n], &mut probability[..n], &mut gain[..n], &mut precision[..n]);
        let by_ratio = &ratio[..n];
        for i in 0..n {
            let precision = h[i].max(LEAST_PRECISION);
            let ratio = likelihood_ratio(g[i], precision, p[i]);
            let root = precision.sqrt();
            let s = 1.0 / (1.0 + exponential::<FUSED>(-ratio / 4.0));
            let by_ratio = by_ratio[i] + b2[i] * s * (1.0 - s) + b3[i] / (3.0 * (ratio * ratio + 1.0).sqrt());
            let quotient = 1.0 / (root + EPSILON);
            let by_root = b5[i] / (4.0 * (1.0 + root)) - b4[i] * g[i] * quotient * quotient / 3.0;
            by_s[i] += b0[i] / 6.0;
            by_contrast[i] = 2.0 * b7[i] * per_light[i];
            by_p[i] = b1[i] + by_ratio * precision;
            by_g[i] = b4[i] * quotient / 3.0 + by_ratio;
            let by_precision = by_ratio * (p[i] - 0.5) + by_root / (2.0 * root);
            by_h[i] = if h[i] > LEAST_PRECISION { by_precision } else { 0.0 };
        }
    }
}

/// Updates of the logits by the layers: an added level, and a gate on the log-likelihood ratio.
#[derive(Clone, Debug)]
pub(super) struct Moves {
    pub level: Vec<f32>,
    pub gate: Vec<f32>,
    /// Log odds after the step, before damping.
    pub claimed: Vec<f32>,
}

impl Moves {
    pub fn new(count: usize) -> Self {
        Self { level: vec![0.0; count], gate: vec![0.0; count], claimed: vec![0.0; count] }
    }
}

vectorised! {
    /// Computes the log odds of the step and those from which the next step starts, which lie halfway.
    pub(super) fn update<'a, fused FUSED>(
        evidence: &'a Evidence,
        prior: f32,
        moves: &'a mut Moves,
        next: &'a mut [f32],
    ) {
        let n = next.len();
        let Evidence { logits, probability, gain, precision, .. } = evidence;
        let (s, p, g, h) = (&logits[..n], &probability[..n], &gain[..n], &precision[..n]);
        let Moves { level, gate, claimed } = moves;
        let (level, gate, claimed) = (&level[..n], &gate[..n], &mut claimed[..n]);
        let (limit, _) = limits(prior);
        for i in 0..n {
            let ratio = likelihood_ratio(g[i], h[i].max(LEAST_PRECISION), p[i]);
            let logit = prior + 0.5 * ratio / (1.0 + exponential::<FUSED>(-gate[i])) + 4.0 * level[i];
            claimed[i] = logit;
            next[i] = (0.5 * (s[i] + logit)).clamp(-limit, limit);
        }
    }
}

vectorised! {
    /// Gradient of [`update`]. On entry `by.logits` holds the gradient by the next logits; on return it holds that by
    /// the logits. `by_claimed` holds the gradient of the loss by the log odds of the step. The gradients by level
    /// and gate replace `by_claimed` and `by_gate`; the gradient by the ratio is written too.
    pub(super) fn update_backward<'a, fused FUSED>(
        evidence: &'a Evidence,
        moves: &'a Moves,
        prior: f32,
        by: &'a mut ByEvidence,
        by_claimed: &'a mut [f32],
        by_gate: &'a mut [f32],
    ) {
        let n = by_claimed.len();
        let Evidence { logits, probability, gain, precision, .. } = evidence;
        let (s, p, g, h) = (&logits[..n], &probability[..n], &gain[..n], &precision[..n]);
        let (gate, claimed) = (&moves.gate[..n], &moves.claimed[..n]);
        let (by_s, by_ratio, by_gate) = (&mut by.logits[..n], &mut by.ratio[..n], &mut by_gate[..n]);
        let (limit, _) = limits(prior);
        for i in 0..n {
            let inside = (0.5 * (s[i] + claimed[i])).abs() < limit;
            let half = if inside { 0.5 * by_s[i] } else { 0.0 };
            let by_logit = by_claimed[i] + half;
            let open = 1.0 / (1.0 + exponential::<FUSED>(-gate[i]));
            let ratio = likelihood_ratio(g[i], h[i].max(LEAST_PRECISION), p[i]);
            by_s[i] = half;
            by_ratio[i] = 0.5 * open * by_logit;
            by_gate[i] = 0.5 * ratio * open * (1.0 - open) * by_logit;
            by_claimed[i] = 4.0 * by_logit;
        }
    }
}

vectorised! {
    /// Code lengths of the free sites under the log odds of a step, nats, and `weight` times their gradients.
    pub(super) fn code_lengths<'a, fused FUSED>(
        beads: &'a [f32],
        free: &'a [f32],
        prior: f32,
        weight: f32,
        claimed: &'a [f32],
        nats: &'a mut [f32],
        by_claimed: &'a mut [f32],
    ) {
        let n = beads.len();
        let (free, claimed) = (&free[..n], &claimed[..n]);
        let (nats, by_claimed) = (&mut nats[..n], &mut by_claimed[..n]);
        let (_, limit) = limits(prior);
        for i in 0..n {
            let logit = claimed[i].clamp(-limit, limit);
            let p = 1.0 / (1.0 + exponential::<FUSED>(-logit));
            let softplus = logit.max(0.0) + logarithm::<FUSED>(1.0 + exponential::<FUSED>(-logit.abs()));
            nats[i] = free[i] * (softplus - beads[i] * logit);
            let slope = if claimed[i].abs() < limit { p - beads[i] } else { 0.0 };
            by_claimed[i] = weight * free[i] * slope;
        }
    }
}

vectorised! {
    /// Adds the gradients by a step's blurred images to those by probability, then converts these to gradients by the
    /// logits of free sites, in place.
    pub(super) fn probabilities_backward<'a>(
        free: &'a [f32],
        probability: &'a [f32],
        by_variance: &'a [f32],
        by_light: &'a [f32],
        by: &'a mut ByEvidence,
    ) {
        let n = free.len();
        let (p, by_variance, by_light) = (&probability[..n], &by_variance[..n], &by_light[..n]);
        let (by_s, by_p) = (&mut by.logits[..n], &by.probability[..n]);
        for i in 0..n {
            let by_p = by_p[i] + by_light[i] + by_variance[i] * (1.0 - 2.0 * p[i]);
            by_s[i] = free[i] * (by_s[i] + by_p * p[i] * (1.0 - p[i]));
        }
    }
}

/// Writes features (one array after the other) beside the hidden channels of the sites of one row.
pub(super) fn interleave(features: &[f32], count: usize, first: usize, inputs: &mut [[f32; INPUTS]]) {
    let cols = inputs.len();
    let features: [&[f32]; FEATURES] = std::array::from_fn(|k| &features[k * count + first..][..cols]);
    for (col, input) in inputs.iter_mut().enumerate() {
        for (feature, value) in features.iter().zip(&mut input[HIDDEN..]) {
            *value = feature[col];
        }
    }
}

/// The transpose of [`interleave`].
pub(super) fn separate(inputs: &[[f32; INPUTS]], count: usize, first: usize, features: &mut [f32]) {
    for (k, features) in features.chunks_exact_mut(count).enumerate().take(FEATURES) {
        for (input, value) in inputs.iter().zip(&mut features[first..]) {
            *value = input[HIDDEN + k];
        }
    }
}

/// Hidden channels at the start of the next step: those of this step plus the output of its layers.
pub(super) fn carry(inputs: &[[f32; INPUTS]], outputs: &[[f32; OUTPUTS]], next: &mut [[f32; INPUTS]]) {
    // Not compiled for the widest vectors: the compiler would gather single channels of many sites.
    for (next, (input, output)) in next.iter_mut().zip(inputs.iter().zip(outputs)) {
        for k in 0..HIDDEN {
            next[k] = input[k] + output[k];
        }
    }
}
