//! Shot and read noise.

use std::fmt;
use std::str::FromStr;

use ndarray::{Array3, ArrayView3, Axis};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::poisson::sample_poisson;
use crate::formats::text_form;

/// Least and greatest standard deviation of read noise, photons.
const LEAST_SIGMA: f64 = 1e-6;
const MOST_SIGMA: f64 = 1e6;
/// Least read noise that hides the whole counts, photons. Below it the sum of read noise and count still determines the
/// count. At this value the density of measurements rises and falls by 1.4 % between counts, which is 0.0001 bits.
const LEAST_HIDING_SIGMA: f64 = 0.5;

/// Noise of the sensor. Written `shot`, `read:5`, `shot+read:2` or `none`.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let noise: Noise = "shot+read:2".parse()?;
/// assert_eq!(noise, Noise::ShotRead { sigma: 2.0 });
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema), schemars(extend("examples" = ["shot", "read:5", "shot+read:2", "none"])))]
#[serde(try_from = "String", into = "String")]
pub enum Noise {
    /// No noise: the measurement is the encoded image. Information is then unbounded, so estimates refuse it.
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

impl Noise {
    /// Whether there is photon shot noise.
    pub fn has_shot_noise(self) -> bool {
        matches!(self, Self::Shot | Self::ShotRead { .. })
    }

    /// Noise that density models use for an upper bound on information. Read noise only reduces the information of the
    /// counts. Read noise too weak to hide that counts are whole is omitted: density models that ignore whole counts
    /// would count them as information.
    #[must_use]
    pub fn bounding(self) -> Self {
        match self {
            Self::ShotRead { sigma } if sigma < LEAST_HIDING_SIGMA => Self::Shot,
            other => other,
        }
    }

    /// Standard deviation of the read noise in photons.
    pub fn read_sigma(self) -> Option<f64> {
        match self {
            Self::Read { sigma } | Self::ShotRead { sigma } => Some(sigma),
            Self::None | Self::Shot => None,
        }
    }

    /// Noisy measurements of encoded images, shape (n, rows, cols) in photons per pixel.
    ///
    /// Image i uses stream i of the generator of `seed`, so its noise does not depend on the rest of the stack.
    pub fn draw(self, encoded: ArrayView3<'_, f32>, seed: u64) -> Array3<f32> {
        self.draw_from(encoded, 0, seed)
    }

    /// [`Noise::draw`] for the images from `first` on of a stack that is drawn in parts.
    pub fn draw_from(self, encoded: ArrayView3<'_, f32>, first: usize, seed: u64) -> Array3<f32> {
        let mut noisy = encoded.to_owned();
        noisy.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(index, mut image)| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(first.wrapping_add(index) as u64);
            if self.has_shot_noise() {
                image.map_inplace(|pixel| *pixel = sample_poisson(f64::from(*pixel), &mut random) as f32);
            }
            if let Some(sigma) = self.read_sigma() {
                image.map_inplace(|pixel| {
                    let normal: f64 = StandardNormal.sample(&mut random);
                    *pixel += (sigma * normal) as f32;
                });
            }
        });
        noisy
    }
}

impl fmt::Display for Noise {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => formatter.write_str("none"),
            Self::Shot => formatter.write_str("shot"),
            Self::Read { sigma } => write!(formatter, "read:{sigma}"),
            Self::ShotRead { sigma } => write!(formatter, "shot+read:{sigma}"),
        }
    }
}

impl FromStr for Noise {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sigma = |text: &str| match text.parse::<f64>() {
            Ok(sigma) if (LEAST_SIGMA..=MOST_SIGMA).contains(&sigma) => Ok(sigma),
            _ => Err(format!(
                "read noise {text:?}: expected a standard deviation of {LEAST_SIGMA} to {MOST_SIGMA} photons, such as read:5"
            )),
        };
        match text.split_once(':') {
            None if text == "none" => Ok(Self::None),
            None if text == "shot" => Ok(Self::Shot),
            Some(("read", value)) => Ok(Self::Read { sigma: sigma(value)? }),
            Some(("shot+read", value)) => Ok(Self::ShotRead { sigma: sigma(value)? }),
            _ => Err(format!("noise {text:?}: expected shot, read:SIGMA, shot+read:SIGMA or none")),
        }
    }
}

text_form!(Noise);

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::s;

    #[test]
    fn text_and_noise_are_one() {
        for noise in [Noise::None, Noise::Shot, Noise::Read { sigma: 5.0 }, Noise::ShotRead { sigma: 0.25 }] {
            assert_eq!(noise.to_string().parse(), Ok(noise));
        }
        for wrong in ["", "shots", "read", "read:", "read:-1", "read:nan", "shot+read:0", "read:1e9"] {
            assert!(wrong.parse::<Noise>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn mean_and_variance_are_those_of_the_model() {
        let encoded = Array3::from_elem((40, 64, 64), 30.0_f32);
        for (noise, variance) in [
            (Noise::None, 0.0),
            (Noise::Shot, 30.0),
            (Noise::Read { sigma: 5.0 }, 25.0),
            (Noise::ShotRead { sigma: 5.0 }, 55.0),
        ] {
            let noisy = noise.draw(encoded.view(), 9).mapv(f64::from);
            let mean = noisy.mean().unwrap();
            let found = noisy.mapv(|value| (value - mean).powi(2)).mean().unwrap();
            let samples: f64 = 40.0 * 64.0 * 64.0;
            assert!((mean - 30.0).abs() <= 4.0 * f64::sqrt(variance / samples), "{noise}: mean {mean}");
            assert!((found - variance).abs() <= 4.0 * variance * (2.1 / samples).sqrt(), "{noise}: {found}");
        }
    }

    #[test]
    fn an_image_has_the_same_noise_in_any_stack() {
        let encoded = Array3::from_shape_fn((6, 8, 8), |(n, r, c)| (n + r + c) as f32 * 7.0);
        let noise = Noise::ShotRead { sigma: 1.0 };
        let whole = noise.draw(encoded.view(), 3);
        assert_eq!(noise.draw(encoded.slice(s![..2, .., ..]), 3), whole.slice(s![..2, .., ..]));
        assert_eq!(noise.draw_from(encoded.slice(s![2.., .., ..]), 2, 3), whole.slice(s![2.., .., ..]));
        assert_ne!(noise.draw(encoded.view(), 4), whole);
    }

    #[test]
    fn read_noise_that_leaves_counts_apart_is_left_out_of_bounds_from_above() {
        let of = |sigma| Noise::ShotRead { sigma }.bounding();
        assert_eq!((of(0.05), of(0.49)), (Noise::Shot, Noise::Shot));
        assert_eq!(of(0.5), Noise::ShotRead { sigma: 0.5 });
        let read = Noise::Read { sigma: 0.05 };
        assert_eq!([Noise::Shot, read, Noise::None].map(Noise::bounding), [Noise::Shot, read, Noise::None]);
    }
}
