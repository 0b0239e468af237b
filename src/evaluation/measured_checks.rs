//! Checks of camera images and of the estimates from them, a sentence each.

use std::collections::HashSet;

use ndarray::{ArrayView3, Axis, s};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::camera::hash_of;
use crate::evaluation::calibration::Calibration;
use crate::evaluation::pixel_calibration::Origins;
use crate::formats::GreyValues;
use crate::information::{Estimator, NoiseEntropy, Protocol, gaussian_entropy};
use crate::plural::{counted, one_or_many};
use crate::sensor::Noise;
use crate::significant::significant;

/// Least share of the variance that is the same in all images for a note.
const FIXED_SHARE: f64 = 0.02;
/// Standard errors by which that share must exceed 0.
const CLEAR: f64 = 4.0;
/// Least variance of neighbouring pixels without a note, as a share of that of the stated noise.
const LEAST_NOISE_SHARE: f64 = 0.9;
/// Largest bias without a note, bits per pixel.
const LEAST_BIAS: f64 = 0.02;
/// Side of the blocks whose mean stands for the light there, pixels.
const BLOCK_PX: usize = 8;
/// Draws at each light level of the simulated bias.
const DRAWS: usize = 4000;
/// Light levels at which the bias is simulated; it is smooth between them.
const TABLE: usize = 24;
/// Variance of the uniform number that is added to whole counts.
const DEQUANTISATION: f64 = 1.0 / 12.0;
const SEED: u64 = 9;

/// The sentence on an estimate below zero of saturated images.
pub(crate) const BELOW_ZERO_SATURATED: &str = "error: the estimate is below zero by more than its interval, as saturated pixels do \
                                               not vary; record images of less light";
/// The note on counts that overflowed.
pub(crate) const OVERFLOWED: &str = "values reach from the least to the largest number of 16 signed bits: counts above 32767 may have \
                                     become negative; read them as unsigned numbers";
/// Largest share of saturated pixels of an estimate that can be relied on.
const MANY_SATURATED: f64 = 0.01;

/// Notes on grey values.
#[derive(Clone, Debug, Default)]
pub(crate) struct GreyNotes {
    /// On saturated pixels.
    pub(crate) saturated: Option<String>,
    /// On values that wrapped around zero.
    pub(crate) wrapped: Option<String>,
    /// On negative values that were cut off.
    pub(crate) cut_off: Option<String>,
    /// On the distance of grey values.
    pub(crate) steps: Option<String>,
}

impl GreyNotes {
    /// Notes on what spoils any estimate.
    pub(crate) fn grave(&self) -> impl Iterator<Item = String> {
        [&self.saturated, &self.wrapped, &self.cut_off].into_iter().flatten().cloned()
    }
}

/// Notes on grey values.
pub(crate) fn grey_notes(values: &GreyValues) -> GreyNotes {
    let saturated = values.saturated().map(|saturated| {
        let advice = if saturated.share > MANY_SATURATED { ", and the estimate is not to be relied on" } else { "" };
        format!("{saturated}: they are saturated{advice}")
    });
    let wrapped = values.wrapped().map(|wrapped| wrapped.to_string());
    let cut_off = values.cut_off_at_zero().map(|share| {
        format!(
            "{:.1} % of the pixels are 0, far more than have the next grey values: noise below the dark level was cut off and counts as \
             information; subtract the dark level in signed numbers or floats",
            100.0 * share
        )
    });
    let steps = values
        .step()
        .filter(|step| *step > 1.0)
        .map(|step| format!("all grey values are {step} apart, as of fewer bits that were shifted"));
    GreyNotes { saturated, wrapped, cut_off, steps }
}

/// A note on the share of the variance that is the same in all images.
///
/// The mean of n images has the variance `F + (V - F) / n` over its pixels, where V is that of single images and F the part that all
/// share.
pub(crate) fn fixed_pattern_note(photons: ArrayView3<'_, f32>, has_dark: bool) -> Option<String> {
    let (images, rows, cols) = photons.dim();
    if images < 2 {
        return None;
    }
    let (n, pixels) = (images as f64, (rows * cols) as f64);
    let variance = |values: &mut dyn Iterator<Item = f64>| {
        let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for value in values {
            count += 1.0;
            sum += value;
            squares += value * value;
        }
        (squares - sum * sum / count) / count
    };
    // Less a level near the mean, so that squares keep their digits.
    let level = f64::from(photons.first().copied()?);
    let of_images = photons.outer_iter();
    let single =
        of_images.map(|image| variance(&mut image.iter().map(|&value| f64::from(value) - level))).sum::<f64>() / n;
    let mut mean = ndarray::Array2::<f64>::zeros((rows, cols));
    for image in photons.outer_iter() {
        mean.zip_mut_with(&image, |mean, &value| *mean += (f64::from(value) - level) / n);
    }
    let of_mean = variance(&mut mean.iter().copied());
    let share = (n * of_mean - single) / (n - 1.0) / single;
    // Pixels alike differ by chance too.
    let error = (2.0 / pixels).sqrt() / (n - 1.0);
    let advice = if has_dark {
        "give flat images by --flat, or mind it"
    } else {
        "give dark images by --dark, and flat ones by --flat"
    };
    (images > 1 && share > FIXED_SHARE && share > CLEAR * error).then(|| {
        format!(
            "{:.1} % of the variance is the same in all images: fixed pattern of the sensor or a common background counts as \
             information; {advice}",
            100.0 * share
        )
    })
}

/// A note on images that equal an earlier one, of which one may be a test image and the other one of training.
pub(crate) fn copies_note(photons: ArrayView3<'_, f32>) -> Option<String> {
    let mut seen = HashSet::new();
    let copies = photons.outer_iter().filter(|image| !seen.insert(hash_of(image.view()))).count();
    (copies > 0).then(|| {
        format!(
            "{copies} of {} {} an earlier one: estimates take images to be independent; leave copies out",
            counted(photons.len_of(Axis(0)), "image"),
            one_or_many(copies, "equals", "equal")
        )
    })
}

/// Variance of the noise of neighbouring pixels at most: half the mean square of their differences, photons^2.
fn neighbour_variance(photons: ArrayView3<'_, f32>) -> f64 {
    let (_, rows, cols) = photons.dim();
    let mean_square = |one: ArrayView3<'_, f32>, other: ArrayView3<'_, f32>| {
        let squares = one.iter().zip(&other).map(|(&one, &other)| (f64::from(one) - f64::from(other)).powi(2));
        squares.sum::<f64>() / one.len().max(1) as f64 / 2.0
    };
    let down = mean_square(photons.slice(s![.., ..rows - 1, ..]), photons.slice(s![.., 1.., ..]));
    let right = mean_square(photons.slice(s![.., .., ..cols - 1]), photons.slice(s![.., .., 1..]));
    match (rows > 1, cols > 1) {
        (true, true) => down.min(right),
        (true, false) => down,
        _ => right,
    }
}

fn mean_of(photons: ArrayView3<'_, f32>) -> f64 {
    photons.iter().map(|&value| f64::from(value)).sum::<f64>() / photons.len().max(1) as f64
}

/// A note where neighbouring pixels vary less than the noise that was stated.
pub(crate) fn neighbour_note(photons: ArrayView3<'_, f32>, noise: Noise) -> Option<String> {
    let shot = if noise.has_shot_noise() { mean_of(photons) } else { 0.0 };
    let stated = shot + noise.read_sigma().unwrap_or_default().powi(2);
    let share = neighbour_variance(photons) / stated;
    (share < LEAST_NOISE_SHARE).then(|| {
        format!(
            "neighbouring pixels vary by {share:.2} of the variance of the stated noise: check gain and offset, and whether the \
             images were averaged, denoised or interpolated"
        )
    })
}

/// The sentence on an estimate that is below zero by more than its interval: gain or offset is wrong.
pub(crate) fn below_zero(
    photons: ArrayView3<'_, f32>,
    calibration: Calibration,
    origins: Origins,
    noise: Noise,
) -> String {
    let start = "error: the estimate is below zero by more than its interval, as the measurements vary less than the noise that was \
                 stated";
    if !noise.has_shot_noise() {
        return format!("{start}; check the noise, and the gain of {} DN per photon", calibration.gain);
    }
    let Calibration { gain, offset, bin } = calibration;
    let (first, reason) = match origins {
        Origins { has_dark: true, .. } => ("gain", "the offset is that of dark images".to_owned()),
        Origins { has_camera: true, .. } => ("offset", "the gain is that of the camera file".to_owned()),
        _ if offset == 0.0 => ("offset", "it is 0, which few cameras have".to_owned()),
        _ if gain == 1.0 => ("gain", "it is 1 DN per photon".to_owned()),
        _ => ("offset, then the gain", "both were stated".to_owned()),
    };
    let (mean, variance) =
        (mean_of(photons), neighbour_variance(photons) - noise.read_sigma().unwrap_or_default().powi(2));
    let fitting = if variance > 0.0 {
        let offset = offset + (mean - variance) * gain / (bin * bin) as f64;
        format!(
            "; shot noise fits an offset of {offset:.1} DN at this gain, or a gain of {} DN per photon at this offset; images that were \
             averaged, denoised or interpolated vary less as well",
            significant(gain * variance / mean, 3)
        )
    } else {
        String::new()
    };
    let read = match noise.read_sigma() {
        Some(sigma) if sigma > 0.0 => format!(", and the read noise of {sigma}"),
        _ => String::new(),
    };
    format!("{start}; check the {first}: {reason}{read}{fitting}")
}

/// Number of images from which on an estimate is taken to hold for their kind.
const MANY_IMAGES: usize = 100;

/// A note on an estimate of few images.
pub(crate) fn few_images_note(images: usize) -> Option<String> {
    (images < MANY_IMAGES).then(|| {
        format!(
            "there are {images} images, so the estimate may hold for these scenes alone; measure {MANY_IMAGES} or more for their kind"
        )
    })
}

/// A note on the bias of noisy measurements in place of clean images, where it matters.
///
/// Measurements are simulated at the mean light of blocks of 8 x 8 pixels. Their noise entropy falls short of that of the light. A
/// Gaussian model adds that counts are no Gaussian.
pub(crate) fn few_photons_note(
    photons: ArrayView3<'_, f32>,
    noise: Noise,
    protocol: Protocol,
    estimator: Estimator,
) -> Option<String> {
    if !noise.has_shot_noise() {
        return None;
    }
    let entropy = NoiseEntropy::new(noise, protocol).ok()?;
    let is_gaussian = matches!(estimator, Estimator::GaussianStationary | Estimator::GaussianFull);
    let levels = block_means(photons);
    let (low, high) =
        levels.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &level| (low.min(level), high.max(level)));
    let bias = |level: f64| simulated_bias(level, noise, &entropy, is_gaussian);
    let at = |place: usize| low * (high / low).powf(place as f64 / (TABLE - 1) as f64);
    let table: Vec<f64> =
        if high > 1.001 * low { (0..TABLE).map(|place| bias(at(place))).collect() } else { vec![bias(low)] };
    let interpolated = |level: f64| {
        if table.len() == 1 {
            return table[0];
        }
        let place = ((level / low).ln() / (high / low).ln() * (TABLE - 1) as f64).clamp(0.0, (TABLE - 1) as f64);
        let below = (place.floor() as usize).min(TABLE - 2);
        table[below] + (place - below as f64) * (table[below + 1] - table[below])
    };
    let mean = levels.iter().map(|&level| interpolated(level)).sum::<f64>() / levels.len().max(1) as f64;
    (mean > LEAST_BIAS).then(|| {
        format!(
            "at this light ({:.1} photons per pixel) noisy measurements in place of clean images add about {mean:.2} bits per pixel, \
             by simulation: images without any structure would give that",
            mean_of(photons)
        )
    })
}

/// Means of blocks of pixels, photons, at least a tenth of a photon.
fn block_means(photons: ArrayView3<'_, f32>) -> Vec<f64> {
    let mut means = Vec::new();
    for image in photons.axis_iter(Axis(0)) {
        for rows in image.axis_chunks_iter(Axis(0), BLOCK_PX) {
            for block in rows.axis_chunks_iter(Axis(1), BLOCK_PX) {
                let sum: f64 = block.iter().map(|&value| f64::from(value)).sum();
                means.push((sum / block.len() as f64).max(0.1));
            }
        }
    }
    means
}

/// Bits per pixel that an image of this light alone seems to carry.
fn simulated_bias(light: f64, noise: Noise, entropy: &NoiseEntropy, is_gaussian: bool) -> f64 {
    let sigma = noise.read_sigma().unwrap_or_default();
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let mut sum = 0.0;
    for _ in 0..DRAWS {
        let read: f64 = rand::RngExt::sample(&mut random, rand_distr::StandardNormal);
        let measured = crate::sensor::sample_poisson(light, &mut random) + sigma * read;
        sum += entropy.measured_bits(measured);
    }
    let measured = sum / DRAWS as f64;
    let rounding = if sigma == 0.0 { DEQUANTISATION } else { 0.0 };
    let density = if is_gaussian { gaussian_entropy(light + sigma * sigma + rounding) } else { entropy.bits(light) };
    density - measured
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn shot(mean: f32) -> Array3<f32> {
        Noise::Shot.draw(Array3::from_elem((6, 64, 64), mean).view(), 5)
    }

    #[test]
    fn fixed_pattern_is_noted_with_its_share() {
        let mut images = shot(100.0);
        assert_eq!(fixed_pattern_note(images.view(), false), None);
        for ((_, r, c), pixel) in images.indexed_iter_mut() {
            *pixel += if (r * 31 + c * 17) % 2 == 0 { 10.0 } else { -10.0 };
        }
        let note = fixed_pattern_note(images.view(), false).unwrap();
        let share: f64 = note.split(' ').next().unwrap().parse().unwrap();
        assert!((share - 50.0).abs() < 3.0 && note.contains("--dark"), "{note}");
    }

    #[test]
    fn copies_are_counted() {
        let mut images = shot(100.0);
        assert_eq!(copies_note(images.view()), None);
        let first = images.index_axis(Axis(0), 0).to_owned();
        images.index_axis_mut(Axis(0), 4).assign(&first);
        assert!(copies_note(images.view()).unwrap().starts_with("1 of 6 images equals an earlier one"));
    }

    #[test]
    fn noise_below_the_stated_one_is_noted() {
        assert_eq!(neighbour_note(shot(100.0).view(), Noise::Shot), None);
        assert!(neighbour_note((shot(100.0) * 0.5).view(), Noise::Shot).unwrap().contains("by 0.50 of"));
        assert!(neighbour_note(shot(100.0).view(), Noise::Read { sigma: 20.0 }).unwrap().contains("by 0.25 of"));
    }

    #[test]
    fn estimates_below_zero_name_what_to_check() {
        // 100 photons, 2 DN each and an offset of 100, read with an offset of 0.
        let photons = (shot(100.0) * 2.0 + 100.0) / 2.0;
        let wrong = Calibration { gain: 2.0, offset: 0.0, bin: 1 };
        let no_origins = Origins { has_camera: false, has_dark: false };
        let text = below_zero(photons.view(), wrong, no_origins, Noise::Shot);
        assert!(text.contains("check the offset: it is 0"), "{text}");
        let offset: f64 = text.split("offset of ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!((offset - 100.0).abs() < 4.0, "{text}");
        let of = |calibration, origins| below_zero(photons.view(), calibration, origins, Noise::Shot);
        assert!(
            of(wrong, Origins { has_camera: false, has_dark: true }).contains("check the gain: the offset is that of")
        );
        assert!(
            of(wrong, Origins { has_camera: true, has_dark: false }).contains("check the offset: the gain is that")
        );
        let gain = Calibration { gain: 1.0, offset: 5.0, bin: 1 };
        assert!(of(gain, no_origins).contains("check the gain: it is 1"));
        let read = below_zero(photons.view(), wrong, no_origins, Noise::Read { sigma: 9.0 });
        assert!(read.contains("check the noise"), "{read}");
        let both = below_zero(photons.view(), wrong, no_origins, Noise::ShotRead { sigma: 3.0 });
        assert!(both.contains("and the read noise of 3") && both.contains("averaged, denoised"), "{both}");
        // Floats of 0 to 1.
        let small = Calibration { gain: 1.0, offset: 0.01, bin: 1 };
        let text = below_zero((shot(100.0) / 4095.0).view(), small, no_origins, Noise::Shot);
        let gain: f64 = text.split("or a gain of ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!((gain * 4095.0 - 1.0).abs() < 0.1, "{text}");
    }

    #[test]
    fn bias_of_few_photons_is_that_of_estimates_without_structure() {
        let note =
            |mean: f32, estimator| few_photons_note(shot(mean).view(), Noise::Shot, Protocol::Default, estimator);
        let bias = |mean: f32| -> f64 {
            let text = note(mean, Estimator::GaussianStationary).unwrap();
            text.split("about ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap()
        };
        assert!((bias(1.0) - 0.73).abs() < 0.03 && (bias(10.0) - 0.07).abs() < 0.015, "{} {}", bias(1.0), bias(10.0));
        assert_eq!(note(200.0, Estimator::GaussianStationary), None);
        assert!(note(1.0, Estimator::Causal).unwrap().contains("about 0.5"));
        let read = few_photons_note(shot(1.0).view(), Noise::Read { sigma: 1.0 }, Protocol::Default, Estimator::Causal);
        assert_eq!(read, None);
    }
}
