//! Power spectrum of an image: variance at each spatial frequency, for comparison with the noise.
//!
//! P(f) = |FFT2(w (y - mean y))|^2 / sum w^2 with a Hann window w. The window keeps the mismatch of opposite borders
//! from leaking into other frequencies. White noise of variance v has P(f) = v at every f: shot noise alone lies at
//! the mean of the image, read noise at sigma^2. Frequencies are averaged over rings.

use ndarray::ArrayView2;
use rustfft::num_complex::Complex64;

use super::fourier::Fourier2;

/// Index of the first ring used; lower ones hold the mean, spread by the window.
const FIRST_RING: usize = 2;

/// Power of the spatial frequencies of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct PowerSpectrum {
    /// (frequency in cycles per pixel, power in photons^2), averaged over rings as wide as one frequency step of the
    /// shorter side; frequencies rise up to half the sampling rate.
    pub radial: Vec<[f64; 2]>,
    /// Mean of the image, photons per pixel; the power of its shot noise.
    pub mean: f64,
}

/// The power spectrum of an image in photons per pixel, shape (rows, cols).
///
/// It has no rings where a side is shorter than four pixels, or a value is not finite.
pub fn power_spectrum(image: ArrayView2<'_, f32>) -> PowerSpectrum {
    let (rows, cols) = image.dim();
    let mean = image.iter().map(|&value| f64::from(value)).sum::<f64>() / image.len().max(1) as f64;
    let steps = rows.min(cols);
    if steps < 4 || !mean.is_finite() {
        return PowerSpectrum { radial: Vec::new(), mean };
    }
    let (by_row, by_col) = (hann(rows), hann(cols));
    let mut data: Vec<Complex64> = image
        .indexed_iter()
        .map(|((row, col), &value)| Complex64::new((f64::from(value) - mean) * by_row[row] * by_col[col], 0.0))
        .collect();
    let fourier = Fourier2::new(rows, cols);
    fourier.forward(&mut data, rows, &mut fourier.workspace());
    let squares = |window: &[f64]| window.iter().map(|weight| weight * weight).sum::<f64>();
    let scale = 1.0 / (squares(&by_row) * squares(&by_col));
    // Sums of frequency and power, and how many frequencies of the grid lie in each ring.
    let mut rings = vec![(0.0, 0.0, 0_u32); steps / 2 + 1];
    let frequency = |index: usize, count: usize| index.min(count - index) as f64 / count as f64;
    for (index, value) in data.iter().enumerate() {
        let radius = frequency(index / cols, rows).hypot(frequency(index % cols, cols));
        if let Some(ring) = rings.get_mut((radius * steps as f64).round() as usize) {
            ring.0 += radius;
            ring.1 += value.norm_sqr() * scale;
            ring.2 += 1;
        }
    }
    let mean_of = |&(frequency, power, count): &(f64, f64, u32)| {
        (count > 0).then(|| [frequency / f64::from(count), power / f64::from(count)])
    };
    PowerSpectrum { radial: rings.iter().skip(FIRST_RING).filter_map(mean_of).collect(), mean }
}

/// Hann window of a period of `count` pixels: its own spectrum ends after the first frequency.
fn hann(count: usize) -> Vec<f64> {
    let turn = std::f64::consts::TAU / count as f64;
    (0..count).map(|index| 0.5 - 0.5 * ((index as f64 + 0.5) * turn).cos()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Noise;
    use ndarray::{Array2, Array3, Axis};

    /// White noise is flat at its variance; that of shot noise is the mean of the image.
    #[test]
    fn shot_noise_of_known_mean_is_a_flat_line_at_that_mean() {
        for (noise, mean, variance) in
            [(Noise::Shot, 40.0, 40.0), (Noise::Read { sigma: 3.0 }, 40.0, 9.0), (Noise::Shot, 4.0, 4.0)]
        {
            let clean = Array3::from_elem((1, 192, 256), mean as f32);
            let noisy = noise.draw(clean.view(), 11);
            let spectrum = power_spectrum(noisy.index_axis(Axis(0), 0));
            assert!((spectrum.mean - mean).abs() < 6.0 * (variance / (192.0 * 256.0_f64)).sqrt());
            assert_eq!(spectrum.radial.len(), 95);
            let mut all = 0.0;
            for &[frequency, power] in &spectrum.radial {
                // A ring holds 2 pi r frequencies of the longer side's density, of which half are mirrored, and the
                // window ties neighbours together: (35 / 18)^2 times the variance of as many independent ones.
                let count = std::f64::consts::TAU * frequency * 192.0 * (256.0 / 192.0);
                let deviation = variance * (2.0 * (35.0_f64 / 18.0).powi(2) / count).sqrt();
                assert!((power - variance).abs() < 5.0 * deviation, "{noise} at {frequency}: {power}");
                all += power * frequency;
            }
            let mean_power = all / spectrum.radial.iter().map(|[frequency, _]| frequency).sum::<f64>();
            assert!((mean_power / variance - 1.0).abs() < 0.02, "{noise}: {mean_power}");
        }
    }

    /// One bright pixel is white without any chance: A^2 w^2 / sum w^2, with w the window there and (3/8) rows (3/8) cols
    /// the sum of its squares.
    #[test]
    fn one_bright_pixel_has_the_power_of_the_closed_form_everywhere() {
        let (rows, cols, bright) = (24, 40, 7.0);
        let mut image = Array2::zeros((rows, cols));
        image[(9, 22)] = bright as f32;
        let at = |index: f64, count: usize| 0.5 - 0.5 * (std::f64::consts::TAU * (index + 0.5) / count as f64).cos();
        let weight = at(9.0, rows) * at(22.0, cols);
        let expected = (bright * weight).powi(2) / (0.375 * rows as f64 * 0.375 * cols as f64);
        let spectrum = power_spectrum(image.view());
        assert_eq!(spectrum.radial.len(), 11);
        // The longer side has finer frequencies: those of ring 2 and above do not overlap the window's own.
        for &[frequency, power] in &spectrum.radial {
            assert!((power / expected - 1.0).abs() < 1e-9, "{frequency}: {power} {expected}");
        }
    }

    /// A wave appears at its own frequency, in either direction.
    #[test]
    fn a_wave_stands_at_its_frequency() {
        for (by_row, by_col) in [(0.0, 12.0), (12.0, 0.0), (-6.0, 8.0)] {
            let wave = Array2::from_shape_fn((64, 64), |(row, col)| {
                let turns = (row as f64 * by_row + col as f64 * by_col) / 64.0;
                (100.0 + 10.0 * (std::f64::consts::TAU * turns).cos()) as f32
            });
            let spectrum = power_spectrum(wave.view());
            let peak = spectrum.radial.iter().max_by(|one, other| one[1].total_cmp(&other[1])).unwrap();
            assert!((peak[0] * 64.0 - f64::hypot(by_row, by_col)).abs() < 0.5, "{peak:?}");
            // Beyond the neighbours of that ring there is nothing.
            let rest = spectrum.radial.iter().filter(|point| (point[0] - peak[0]).abs() * 64.0 > 3.0);
            assert!(rest.map(|point| point[1]).fold(0.0, f64::max) < 1e-6 * peak[1]);
        }
    }

    #[test]
    fn images_without_frequencies_have_no_rings() {
        assert!(power_spectrum(Array2::zeros((3, 90)).view()).radial.is_empty());
        assert!(power_spectrum(Array2::zeros((0, 0)).view()).radial.is_empty());
        assert!(power_spectrum(Array2::from_elem((8, 8), f32::NAN).view()).radial.is_empty());
        assert!(power_spectrum(Array2::from_elem((8, 8), 3.0).view()).radial.iter().all(|&[_, power]| power == 0.0));
    }
}
