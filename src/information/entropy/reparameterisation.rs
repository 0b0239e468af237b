//! Noise as a function of the image and of standard normal numbers, so that measurements change smoothly with the
//! image.

use crate::sensor::Noise;

/// Smallest photons of an encoded pixel for its noise.
pub(in crate::information) const DARKEST: f64 = 1e-3;

/// `y = x + s(x) e` with the standard deviation s of the noise at x and a standard normal number e (Kabuli et al. 2026).
pub(in crate::information) struct Reparameterised {
    shot: f64,
    read: f64,
}

impl Reparameterised {
    /// The reparameterisation of `noise`.
    pub fn new(noise: Noise) -> Self {
        let read = noise.read_sigma().map_or(0.0, |sigma| sigma * sigma);
        Self { shot: f64::from(u8::from(noise.has_shot_noise())), read }
    }

    /// The measurement y, photons.
    pub fn measured(&self, x: f64, e: f64) -> f64 {
        let x = x.max(DARKEST);
        x + self.variance(x).sqrt() * e
    }

    /// The derivative dy/dx.
    pub fn slope(&self, x: f64, e: f64) -> f64 {
        1.0 + 0.5 * self.shot * e / self.variance(x).sqrt()
    }

    /// Entropy of y given x, nats, and its derivative by x.
    pub fn entropy(&self, x: f64) -> (f64, f64) {
        let variance = self.variance(x);
        (0.5 * (std::f64::consts::TAU * std::f64::consts::E * variance).ln(), 0.5 * self.shot / variance)
    }

    /// Variance of y given x, square photons.
    fn variance(&self, x: f64) -> f64 {
        self.shot * x + self.read
    }
}
