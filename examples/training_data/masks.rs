//! Random masks, light levels and noise.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use lenslet_studio::optics::{Lenslet, LensletArray, Limits, heuristic_layout, random_layout};
use lenslet_studio::sensor::Noise;

/// Largest number of lenslets of a random mask, and range of their widths, px.
const MOST_LENSLETS: f64 = 25.5;
const WIDTHS: (f64, f64) = (0.775, 2.5);

/// Share of designs with the usual light; mean light and background, photons per pixel.
pub const USUAL_SHARE: f64 = 0.7;
const USUAL: (f64, f64) = (100.0, 10.0);
/// Range of the background of the others, and of the read noise, photons.
const BIAS: (f64, f64) = (3.0, 40.0);
const READ_NOISE: (f64, f64) = (1.0, 10.0);

/// A heuristic mask, a random start of the optimizer, or lenslets at random positions.
pub fn mask(random: &mut ChaCha8Rng) -> LensletArray {
    let choice: f64 = random.random();
    if choice < 0.4 {
        return heuristic_layout(random.random_range(1..=9));
    }
    if choice < 0.5 {
        return random_layout(25, random.random());
    }
    let limits = Limits::default();
    let count = between(random, (1.0, MOST_LENSLETS)).round() as usize;
    let mut array = heuristic_layout(1);
    let (low, high) = limits.coordinate_range(array.cols);
    let sharp = random.random_bool(0.6);
    let uneven = if random.random_bool(0.5) { 0.6 } else { 0.0 };
    array.lenslets = (0..count)
        .map(|_| {
            let sigma = if sharp { random.random_range(0.775..0.85) } else { between(random, WIDTHS) };
            let spread: f64 = StandardNormal.sample(random);
            let (x, y) = (random.random_range(low..high), random.random_range(low..high));
            Lenslet::round(x, y, sigma, (uneven * spread).exp() / count as f64)
        })
        .collect();
    array
}

/// Mean light of the objects (usual, or log-uniform in `range`) and background, photons per pixel.
pub fn light(random: &mut ChaCha8Rng, usual: bool, range: (f64, f64)) -> (f64, f64) {
    if usual { USUAL } else { (between(random, range), between(random, BIAS)) }
}

/// Shot noise and read noise with these shares; both in the rest of the designs.
pub fn noise(random: &mut ChaCha8Rng, (shot, read): (f64, f64)) -> Noise {
    match random.random_range(0.0..1.0) {
        share if share < shot => Noise::Shot,
        share if share < shot + read => Noise::Read { sigma: between(random, READ_NOISE) },
        _ => Noise::ShotRead { sigma: between(random, READ_NOISE) },
    }
}

/// A log-uniform number.
pub fn between(random: &mut ChaCha8Rng, (low, high): (f64, f64)) -> f64 {
    random.random_range(low.ln()..high.ln()).exp()
}
