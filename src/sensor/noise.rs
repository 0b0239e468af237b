//! Shot and read noise.

use serde::{Deserialize, Serialize};

/// The noise of the sensor (SCIENCE: "Model").
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Noise {
    /// No noise; the measurement is the encoded image. Information is then unbounded, so estimates refuse it.
    None,
    /// Photon shot noise, `y ~ Poisson(x)`.
    Shot,
    /// Gaussian read noise of standard deviation `sigma` (photons), `y = x + sigma e`.
    Read {
        /// Standard deviation in photons.
        sigma: f64,
    },
    /// Both, `y = Poisson(x) + sigma e`.
    ShotRead {
        /// Standard deviation of the read noise in photons.
        sigma: f64,
    },
}
