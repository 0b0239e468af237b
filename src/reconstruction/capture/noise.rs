//! Gain and read noise of a sensor from a single capture.
//!
//! Neighbouring pixels of a blurred image differ by noise. In squares of four pixels the alternating sum has the variance of one pixel; its
//! rise with the mean is the system gain, its start the read noise (photon transfer, EMVA 1288). Structure of the image adds to both, so the
//! noise is rather too large.

use ndarray::ArrayView2;

/// Groups of squares of similar light.
const GROUPS: usize = 24;
/// Fewest squares of a group.
const LEAST_SQUARES: usize = 32;
/// Median absolute deviation of a standard normal number.
const MEDIAN_DEVIATION: f64 = 0.674_489_75;
/// Photons of the mean pixel that stand in where a capture shows no noise.
const QUIET_PHOTONS: f64 = 1e6;

/// Noise of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SensorNoise {
    /// DN per photon.
    pub(super) gain: f64,
    /// Standard deviation of the read noise, photons.
    pub(super) read_sigma: f64,
}

impl SensorNoise {
    /// Noise of a capture without its dark level, DN. Pixels that are NaN were not measured.
    pub(super) fn of(image: ArrayView2<'_, f32>) -> Self {
        let mut squares = Vec::new();
        for square in image.exact_chunks((2, 2)) {
            let [a, b, c, d] = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|at| f64::from(square[at]));
            let mean = 0.25 * (a + b + c + d);
            if mean.is_finite() {
                squares.push((mean, 0.5 * (a - b - c + d)));
            }
        }
        squares.sort_by(|one, other| one.0.total_cmp(&other.0));
        let size = squares.len().div_ceil(GROUPS).max(LEAST_SQUARES);
        let groups: Vec<(f64, f64)> =
            squares.chunks(size).filter(|group| group.len() >= LEAST_SQUARES).map(moments).collect();
        let (gain, variance) = line(&groups);
        let light = squares.iter().map(|square| square.0).sum::<f64>() / squares.len().max(1) as f64;
        if gain > 0.0 {
            return Self { gain, read_sigma: (variance.sqrt() / gain).max(1e-3) };
        }
        // Read noise alone: a gain so small that the shot noise of the photons is negligible.
        let gain = (light / QUIET_PHOTONS).max(f64::MIN_POSITIVE);
        Self { gain, read_sigma: (variance.sqrt() / gain).max(1e-3) }
    }
}

/// Mean light and robust variance of a group of squares.
fn moments(group: &[(f64, f64)]) -> (f64, f64) {
    let mean = group.iter().map(|square| square.0).sum::<f64>() / group.len() as f64;
    let mut sizes: Vec<f64> = group.iter().map(|square| square.1.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    (mean, (sizes[sizes.len() / 2] / MEDIAN_DEVIATION).powi(2))
}

/// Gain (slope) and read variance (start) of the variance by light, neither negative. Groups count by the inverse of their
/// squared variance, as its relative error is the same.
fn line(groups: &[(f64, f64)]) -> (f64, f64) {
    let least = groups.iter().map(|group| group.1).fold(0.0, f64::max) * 1e-6;
    let weight = |variance: f64| 1.0 / variance.max(least).max(f64::MIN_POSITIVE).powi(2);
    let sums = groups.iter().fold([0.0; 5], |[n, x, y, xx, xy], &(light, variance)| {
        let w = weight(variance);
        [n + w, x + w * light, y + w * variance, xx + w * light * light, xy + w * light * variance]
    });
    let [n, x, y, xx, xy] = sums;
    let determinant = n * xx - x * x;
    let gain = if determinant > 0.0 { (n * xy - x * y) / determinant } else { 0.0 };
    let start = if n > 0.0 { (y - gain * x) / n } else { 0.0 };
    if gain <= 0.0 || !gain.is_finite() {
        return (0.0, if n > 0.0 { (y / n).max(0.0) } else { 0.0 });
    }
    if start < 0.0 { (if xx > 0.0 { (xy / xx).max(0.0) } else { 0.0 }, 0.0) } else { (gain, start) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, Array3, Axis};

    use crate::sensor::Noise;

    /// A smooth image of 50 to 450 photons.
    fn smooth() -> Array3<f32> {
        Array3::from_shape_fn((1, 240, 240), |(_, row, col)| {
            250.0 + 200.0 * ((row as f32 / 60.0).sin() * (col as f32 / 45.0).cos())
        })
    }

    #[test]
    fn gain_and_read_noise_of_a_known_sensor_are_found() {
        for (gain, read) in [(1.0, 5.0), (0.25, 20.0), (7.0, 0.0)] {
            let noise = if read > 0.0 { Noise::ShotRead { sigma: read } } else { Noise::Shot };
            let photons = noise.draw(smooth().view(), 3);
            let found = SensorNoise::of(photons.index_axis(Axis(0), 0).mapv(|value| gain as f32 * value).view());
            assert!((found.gain / gain - 1.0).abs() < 0.15, "{found:?} for {gain}, {read}");
            assert!((found.read_sigma.powi(2) - read * read).abs() < 40.0, "{found:?} for {gain}, {read}");
        }
    }

    #[test]
    fn captures_without_shot_noise_have_many_photons() {
        let quiet = SensorNoise::of(Array2::from_elem((50, 50), 3.0).view());
        assert!((3.0 / quiet.gain / QUIET_PHOTONS - 1.0).abs() < 1e-9 && quiet.read_sigma <= 1e-3, "{quiet:?}");
        let none = SensorNoise::of(Array2::from_elem((1, 1), 3.0).view());
        assert!(none.gain > 0.0 && none.read_sigma.is_finite());
    }
}
