//! I-MMSE gradient: derivative of the information about beads by the light that they leave on the sensor.
//!
//! Let x be the clean photons of one pixel, and dx their change for a small change of the mask; dx depends on the beads.
//! The information then changes by the sum over pixels of `E[dx log2(x / E[x | y])]` under shot noise (Atar and Weissman
//! 2012; for vectors Wang et al. 2014). Under read noise it is `E[dx (x - E[x | y])] / (sigma^2 ln 2)` (Palomar and
//! Verdú 2006). Here y is the whole measurement. Both depend only on the mean of the
//! clean measurement given the noisy one. That mean needs only the probability of a bead at each site, which a
//! decoder estimates. With both noises the photons count as Poisson with sigma^2 more, which has the same variance.

use ndarray::{Array3, ArrayView4};
use rayon::prelude::*;

use super::channel::BeadChannel;
use super::gradient::Passes;
use super::layers::Decoder;
use super::problem::Problem;
use super::samples::{Purpose, Reveal, SampleRange};
use crate::information::error::InformationError;
use crate::sensor::Noise;

/// Gradient of the information by every pixel of the channel's spot (planes, rows, cols), bits per pixel of the patch
/// and photon. It is the mean over new samples. It is exact where the decoder's
/// probabilities are those of the posterior.
///
/// # Errors
/// For an invalid channel.
pub fn bead_response_gradient(
    channel: &BeadChannel,
    decoder: &Decoder,
    samples: SampleRange,
) -> Result<Array3<f64>, InformationError> {
    // Dark pixels of the spot also have a gradient.
    let scene = Problem::of(channel, channel.whole_spot()?)?;
    let passes = Passes::new(&scene, decoder);
    let seen: Vec<(Vec<f32>, Vec<f32>)> = (0..samples.count)
        .into_par_iter()
        .with_max_len(1)
        .map(|index| {
            passes.lend(|pass| {
                let sample = samples.sample(Purpose::Slope, index);
                pass.sample.draw(&scene, sample, |_| Reveal::Nothing, &mut pass.blur);
                pass.forward(decoder, &decoder.weights);
                let known = pass.sample.known.iter().zip(&pass.sample.free);
                let guessed: Vec<f32> = pass
                    .claimed()
                    .iter()
                    .zip(known)
                    .map(|(claimed, (&known, &free))| if free > 0.0 { 1.0 / (1.0 + (-claimed).exp()) } else { known })
                    .collect();
                let mut slopes = vec![0.0; scene.pixels()];
                let mut mean = vec![0.0; scene.pixels()];
                scene.light.blur(&pass.sample.beads, &mut slopes, &mut pass.blur);
                scene.light.blur(&guessed, &mut mean, &mut pass.blur);
                for (clean, mean) in slopes.iter_mut().zip(&mean) {
                    let photons = |light: f32| at_least(f64::from(light), 0.0) + f64::from(scene.bias);
                    *clean = pixel_slope(photons(*clean), photons(*mean), scene.noise) as f32;
                }
                (pass.sample.beads.clone(), slopes)
            })
        })
        .collect();
    let (mut beads, mut slopes) = (Vec::new(), Vec::new());
    for (drawn, sloped) in seen {
        beads.extend(drawn);
        slopes.extend(sloped);
    }
    let sites = (samples.count, scene.sites.images, scene.sites.rows, scene.sites.cols);
    // All have the shapes of the problem, so these fit.
    let no_light = |_| InformationError::NoLight;
    let beads = ArrayView4::from_shape(sites, &beads).map_err(no_light)?;
    let slopes = Array3::from_shape_vec((samples.count, scene.patch.0, scene.patch.1), slopes).map_err(no_light)?;
    let by_spot = scene.light.psf_cotangent(beads, slopes.view()).map_err(|_| InformationError::NoLight)?;
    Ok(by_spot / (samples.count * scene.pixels()).max(1) as f64)
}

/// Derivative of the information by one photon of clean light, bits, at `clean` photons. `mean` is their expectation
/// given the measurement.
fn pixel_slope(clean: f64, mean: f64, noise: Noise) -> f64 {
    let variance = noise.read_sigma().map_or(0.0, |sigma| sigma * sigma);
    if noise.has_shot_noise() {
        (at_least(clean + variance, LEAST) / at_least(mean + variance, LEAST)).log2()
    } else {
        (clean - mean) / variance / std::f64::consts::LN_2
    }
}

/// Lower limit of photons.
const LEAST: f64 = 1e-3;

/// The larger of both. NaN stays NaN, so the caller of the gradient notices it.
fn at_least(value: f64, least: f64) -> f64 {
    if value < least { least } else { value }
}

#[cfg(test)]
mod tests {
    use super::super::fit::DecoderFit;
    use super::super::kind::DecoderKind;
    use super::super::lower_bound::decoder_lower_bound;
    use super::*;
    use crate::progress::CancelToken;
    use crate::sensor::Noise;

    const PROBABILITY: f64 = 0.3;
    const BIAS: f64 = 6.0;
    const NOISES: [Noise; 3] = [Noise::Shot, Noise::Read { sigma: 5.0 }, Noise::ShotRead { sigma: 2.0 }];

    /// Light of each of the four objects on one pixel, and its probability; two sites that light the pixel
    /// differently.
    fn objects(spot: [f64; 2]) -> [(f64, f64, [f64; 2]); 4] {
        [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|beads| {
            let chance = |bead: f64| if bead > 0.0 { PROBABILITY } else { 1.0 - PROBABILITY };
            (BIAS + beads[0] * spot[0] + beads[1] * spot[1], chance(beads[0]) * chance(beads[1]), beads)
        })
    }

    /// Possible measurements, and the density of each where `clean` photons are expected.
    fn outcomes(noise: Noise) -> (Vec<f64>, f64, impl Fn(f64, f64) -> f64) {
        let poisson = |count: usize, mean: f64| {
            let log: f64 = (1..=count).map(|k| (mean / k as f64).ln()).sum();
            (log - mean).exp()
        };
        let step = if noise.read_sigma().is_some() { 0.1 } else { 1.0 };
        let values = (0..(200.0 / step) as usize).map(|index| -40.0 + step * index as f64).collect();
        let density = move |value: f64, clean: f64| {
            let normal =
                |mean: f64, sigma: f64| (-0.5 * ((value - mean) / sigma).powi(2)).exp() / sigma / 2.506_628_274;
            match noise.read_sigma() {
                None if value < 0.0 => 0.0,
                None => poisson(value as usize, clean),
                Some(sigma) if !noise.has_shot_noise() => normal(clean, sigma),
                Some(sigma) => (0..140).map(|count| poisson(count, clean) * normal(count as f64, sigma)).sum(),
            }
        };
        (values, step, density)
    }

    fn information(spot: [f64; 2], noise: Noise) -> f64 {
        let (values, step, density) = outcomes(noise);
        let mut bits = 0.0;
        for value in values {
            let by_object = objects(spot).map(|(clean, chance, _)| (chance, density(value, clean)));
            let marginal: f64 = by_object.iter().map(|(chance, density)| chance * density).sum();
            let possible = by_object.iter().filter(|(_, density)| *density > 0.0);
            bits +=
                step * possible.map(|(chance, density)| chance * density * (density / marginal).log2()).sum::<f64>();
        }
        bits
    }

    /// The gradients by the rule of this module, with the posterior summed over all objects.
    fn exact_slopes(spot: [f64; 2], noise: Noise) -> [f64; 2] {
        let (values, step, density) = outcomes(noise);
        let mut slopes = [0.0; 2];
        for value in values {
            let by_object = objects(spot).map(|(clean, chance, beads)| (clean, chance * density(value, clean), beads));
            let marginal: f64 = by_object.iter().map(|object| object.1).sum();
            if marginal < 1e-300 {
                continue;
            }
            let mean = by_object.iter().map(|(clean, joint, _)| clean * joint).sum::<f64>() / marginal;
            for (clean, joint, beads) in by_object {
                for (slope, bead) in slopes.iter_mut().zip(beads) {
                    *slope += step * joint * bead * pixel_slope(clean, mean, noise);
                }
            }
        }
        slopes
    }

    #[test]
    fn the_rule_gives_the_slopes_of_the_information() {
        let spot = [31.0, 12.0];
        for noise in NOISES {
            let found = exact_slopes(spot, noise);
            for site in 0..2 {
                let moved = |by: f64| {
                    let mut spot = spot;
                    spot[site] += by;
                    information(spot, noise)
                };
                let slope = (moved(0.01) - moved(-0.01)) / 0.02;
                // Photons with read noise are not quite Poisson counts.
                let tolerance = if noise.has_shot_noise() && noise.read_sigma().is_some() { 0.02 } else { 1e-4 };
                assert!((found[site] / slope - 1.0).abs() < tolerance, "{noise} {site}: {} {slope}", found[site]);
            }
        }
    }

    #[test]
    fn what_is_no_number_gives_no_slope() {
        for noise in NOISES {
            assert!(pixel_slope(8.0, f64::NAN, noise).is_nan() && pixel_slope(f64::NAN, 8.0, noise).is_nan());
            assert!(pixel_slope(0.0, 0.0, noise).abs() < 1e-12);
        }
    }

    #[test]
    fn a_fitted_decoder_finds_the_slopes() {
        for noise in NOISES {
            let spot = ndarray::array![[[9.0, 4.0]]];
            let channel = BeadChannel { spot, probability: PROBABILITY, bias: BIAS, noise, patch: (1, 1) };
            let fit = DecoderFit {
                batch: 16,
                unrolled: 2,
                max_test: 1,
                ..DecoderFit::of_steps(1500, DecoderKind::Factorised, 5)
            };
            let (_, decoder) = decoder_lower_bound(&channel, &fit, None, None, &mut CancelToken::new()).unwrap();
            let found =
                bead_response_gradient(&channel, &decoder, SampleRange { seed: 7, first: 0, count: 200_000 }).unwrap();
            let exact = exact_slopes([9.0, 4.0], noise);
            println!("{noise}: {found} {exact:?}");
            for (found, exact) in found.iter().zip(exact) {
                assert!((found / exact - 1.0).abs() < 0.1, "{noise}: {found} {exact}");
            }
        }
    }
}
