//! Intensity grid: possible expected photons of a pixel, and the likelihood of a measurement for each.

use ndarray::ArrayView3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::information::entropy::likelihood::{ln_normal, ln_poisson, log_likelihood};
use crate::nn::{exponential, vectorised};
use crate::sensor::Noise;

/// The number of levels is a multiple of this, which suits vector instructions.
const ROUND: usize = 16;
/// Smallest and largest number of levels.
const COUNTS: (usize, usize) = (64, 512);
/// Intended distance between levels, in standard deviations of the noise.
const SPACING: f64 = 0.8;
/// Distance, in standard deviations of the noise, from which levels are widened so that no gap opens between them.
const WIDEN_FROM: f64 = 1.2;
/// Factor by which the levels extend the range of a sample, beyond its brightest pixel.
const HEADROOM: f64 = 1.15;
/// Distance, in standard deviations of the noise, by which measurements may lie below the grid: the darkest pixels of
/// two samples differ.
const BEYOND: f64 = 1.0;
/// Smallest remaining [`HEADROOM`].
const LEAST_HEADROOM: f64 = 1.05;
/// Smallest share of levels that measurements must use.
const LEAST_USED: f64 = 0.6;
/// Darkest level, photons: counts of 0 are then all but certain.
const DARKEST: f64 = 1e-3;
/// Most rows of a table of likelihoods.
const MOST_ROWS: usize = 16_384;
/// Steps of an interpolated table per standard deviation of the read noise.
const STEPS_PER_SIGMA: f64 = 10.0;

/// The square-root scale on which shot noise has unit deviation (Anscombe 1948; with read noise, Murtagh et al. 1995),
/// or units of the read noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale {
    noise: Noise,
}

impl Scale {
    pub fn new(noise: Noise) -> Self {
        Self { noise }
    }

    fn shift(self) -> f64 {
        0.375 + self.noise.read_sigma().map_or(0.0, |sigma| sigma * sigma)
    }

    /// From photons.
    pub fn of(self, photons: f64) -> f64 {
        match self.noise {
            Noise::Read { sigma } => photons / sigma,
            _ => 2.0 * (photons + self.shift()).max(0.0).sqrt(),
        }
    }

    /// Derivative of [`Scale::of`], per photon; 0 where that is cut off, as for negative noisy values.
    pub fn slope(self, photons: f64) -> f64 {
        match self.noise {
            Noise::Read { sigma } => 1.0 / sigma,
            _ if photons + self.shift() > 0.0 => 1.0 / (photons + self.shift()).sqrt(),
            _ => 0.0,
        }
    }

    /// Derivative of [`Scale::variance`], photons.
    pub fn variance_slope(self, photons: f64) -> f64 {
        if self.noise.has_shot_noise() && photons > DARKEST { 1.0 } else { 0.0 }
    }

    /// To photons.
    fn back(self, z: f64) -> f64 {
        match self.noise {
            Noise::Read { sigma } => z * sigma,
            _ => 0.25 * z * z - self.shift(),
        }
    }

    /// Variance of the noise at a mean of `photons`.
    pub fn variance(self, photons: f64) -> f64 {
        let read = self.noise.read_sigma().map_or(0.0, |sigma| sigma * sigma);
        if self.noise.has_shot_noise() { photons.max(DARKEST) + read } else { read }
    }
}

/// Smallest variance of a Gaussian likelihood of counts. A wider Gaussian sums to no more than 1.00002 over whole
/// numbers, so it is a likelihood of counts too; narrower ones are not (Poisson summation).
const LEAST_VARIANCE_OF_COUNTS: f64 = 0.6;

/// Variance of levels at this distance, in standard deviations of the noise, over that of the noise.
fn widening(step: f64) -> f64 {
    if step > WIDEN_FROM { 1.0 + 0.25 * step * step } else { 1.0 }
}

/// Computation of the likelihood of a level.
#[derive(Clone, Debug)]
enum Kernel {
    /// Probabilities of the counts 0, 1, ..., each row (levels) divided by its largest entry.
    Counts(Table),
    /// Densities on a fine grid, interpolated linearly, which keeps their integral.
    Grid { first: f64, step: f64, table: Table },
    /// Gaussians of these inverse deviations and log norms, where levels are far apart or measurements are no counts.
    Gaussian { inverse: Vec<f32>, log_norm: Vec<f32> },
}

#[derive(Clone, Debug)]
struct Table {
    /// (rows, levels).
    shares: Vec<f32>,
    /// ln of the largest entry of each row.
    log_largest: Vec<f32>,
}

/// Range and kind of the measurements for which levels are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub(super) struct LevelSpan {
    /// Darkest pixel, photons.
    low: f64,
    /// Brightest pixel, photons.
    high: f64,
    /// Whether the measurements are whole numbers from shot noise.
    counts: bool,
}

impl LevelSpan {
    /// Whether the photons of a measurement can have this range.
    pub fn is_sound(self) -> bool {
        const MOST: f64 = 1e9;
        (-MOST..=MOST).contains(&self.low) && (self.low..=MOST).contains(&self.high)
    }
}

/// Levels `x_l`, uniform on the square-root scale, and the likelihoods `P(y | x_l)`.
#[derive(Clone, Debug)]
pub(super) struct Levels {
    noise: Noise,
    pub span: LevelSpan,
    /// Photons.
    pub photons: Vec<f32>,
    /// Their logarithms.
    logs: Vec<f64>,
    kernel: Kernel,
    /// Distance between them, in standard deviations of the noise.
    step: f64,
}

impl Levels {
    /// Levels for images of `clean` photons under a noise, or for noisy ones where clean ones are unknown. `counts`
    /// states whether the measurements are whole numbers from shot noise.
    pub fn new(noise: Noise, images: ArrayView3<'_, f32>, counts: bool) -> Self {
        let (low, high) = images.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| {
            (low.min(f64::from(x)), high.max(f64::from(x)))
        });
        Self::spanning(noise, LevelSpan { low, high, counts })
    }

    /// Levels from the darkest to the brightest pixel.
    pub fn spanning(noise: Noise, span: LevelSpan) -> Self {
        let LevelSpan { low, high, counts } = span;
        let scale = Scale::new(noise);
        let low = if noise.has_shot_noise() { low.max(DARKEST) } else { low };
        let high = low + (high - low).max(0.0) * HEADROOM;
        let (first, last) = (scale.of(low), scale.of(high).max(scale.of(low) + 1.0));
        let wished = ((last - first) / SPACING).ceil() as usize + 1;
        let count = wished.clamp(COUNTS.0, COUNTS.1).div_ceil(ROUND) * ROUND;
        let step = (last - first) / (count - 1) as f64;
        let photons: Vec<f64> = (0..count)
            .map(|l| if l == 0 { low } else { scale.back(first + l as f64 * step) })
            .map(|x| if noise.has_shot_noise() { x.max(DARKEST) } else { x })
            .collect();
        let kernel = Self::kernel(noise, scale, &photons, step, counts);
        let photons: Vec<f32> = photons.iter().map(|&x| x as f32).collect();
        let logs = photons.iter().map(|&x| f64::from(x).ln()).collect();
        Self { noise, span, photons, logs, kernel, step }
    }

    fn kernel(noise: Noise, scale: Scale, photons: &[f64], step: f64, counts: bool) -> Kernel {
        let brightest = photons.last().copied().unwrap_or(1.0);
        let spread = scale.variance(brightest).sqrt();
        match noise {
            Noise::Shot if counts && step <= WIDEN_FROM => {
                let rows = (brightest + 12.0 * spread + 60.0) as usize;
                if rows <= MOST_ROWS {
                    return Kernel::Counts(Table::new(rows, photons, &|row, x| ln_poisson(row as f64, x)));
                }
            }
            Noise::ShotRead { sigma } if step <= WIDEN_FROM => {
                let (first, step) = (-9.0 * sigma, sigma / STEPS_PER_SIGMA);
                let rows = ((brightest + 12.0 * spread + 60.0 - first) / step) as usize;
                if rows <= MOST_ROWS {
                    let value = |row: usize, x: f64| log_likelihood(noise, first + row as f64 * step, x);
                    return Kernel::Grid { first, step, table: Table::new(rows, photons, &value) };
                }
            }
            _ => {}
        }
        // Grey values of a camera may also be counts, some of them below its offset.
        let least = if noise == Noise::Shot { LEAST_VARIANCE_OF_COUNTS } else { 0.0 };
        let deviations = photons.iter().map(|&x| (widening(step) * scale.variance(x).max(least)).sqrt());
        let (inverse, log_norm) = deviations.map(|s| ((1.0 / s) as f32, ln_normal(0.0, s) as f32)).unzip();
        Kernel::Gaussian { inverse, log_norm }
    }

    /// Whether this grid serves measurements that `others` was made for: it covers them to within the noise, and most of it is
    /// used.
    pub fn serve(&self, others: &Self) -> bool {
        let scale = Scale::new(self.noise);
        let of = |photons: f32| scale.of(f64::from(photons));
        let (first, last) = (of(self.range().0), of(self.range().1));
        let LevelSpan { low, high, .. } = others.span;
        let (low, high) = (of(others.range().0), scale.of(low + (high - low) * LEAST_HEADROOM));
        low >= first - BEYOND && high <= last && high - low >= LEAST_USED * (last - first)
    }

    /// Looseness of a density on a coarse grid, bits per pixel; `None` for a fine grid.
    pub fn looseness(&self) -> Option<f64> {
        (self.step > WIDEN_FROM).then(|| 0.5 * widening(self.step).log2())
    }

    /// Number of levels.
    pub fn count(&self) -> usize {
        self.photons.len()
    }

    /// Photons of the lowest and the highest level.
    pub fn range(&self) -> (f32, f32) {
        (self.photons.first().copied().unwrap_or(0.0), self.photons.last().copied().unwrap_or(0.0))
    }

    /// The levels next to the darkest and the brightest pixel of `images` (photons).
    pub fn used_by(&self, images: ArrayView3<'_, f32>) -> (usize, usize) {
        let (low, high) =
            images.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
        let last = self.count() - 1;
        let below = self.photons.partition_point(|&level| level < low).saturating_sub(1);
        (below.min(last), self.photons.partition_point(|&level| level < high).min(last))
    }

    /// Log frequency with which the pixels of `images` (photons) lie nearest to each level; no level has frequency 0.
    pub fn log_frequencies(&self, images: ArrayView3<'_, f32>) -> Vec<f32> {
        let mut counts = vec![1.0_f64; self.count()];
        for &x in images {
            let above = self.photons.partition_point(|&level| level < x).clamp(1, self.count() - 1);
            let nearest = if x - self.photons[above - 1] < self.photons[above] - x { above - 1 } else { above };
            counts[nearest] += 1.0;
        }
        let total: f64 = counts.iter().sum();
        counts.iter().map(|count| (count / total).ln() as f32).collect()
    }

    /// Likelihoods of all levels for `y` photons, relative to the largest, and the logarithm of that one. `room`
    /// holds one number per level.
    pub fn likelihoods<'a>(&'a self, y: f32, room: &'a mut [f32]) -> (&'a [f32], f32) {
        let levels = self.count();
        let log_largest = match &self.kernel {
            // A measured stack may have a pixel below its offset; it counts as dark.
            Kernel::Counts(table) if (y as usize) < table.log_largest.len() => {
                return (table.row(y as usize, levels), table.log_largest[y as usize]);
            }
            Kernel::Grid { first, step, table } => {
                let position = (f64::from(y) - first) / step;
                if position >= 0.0 && (position as usize) + 1 < table.log_largest.len() {
                    table.between(position, levels, room)
                } else {
                    self.directly(y, room)
                }
            }
            Kernel::Gaussian { inverse, log_norm } => {
                gaussian_logs(&self.photons, inverse, log_norm, y, room);
                let log_largest = largest(room);
                relative(log_largest, room);
                log_largest
            }
            Kernel::Counts(_) => self.directly(y, room),
        };
        (room, log_largest)
    }

    /// `ln P(y | x_l)` without a table, nats.
    pub fn log_likelihood(&self, y: f32, level: usize) -> f64 {
        let x = f64::from(self.photons[level]);
        match &self.kernel {
            Kernel::Gaussian { inverse, .. } => ln_normal(f64::from(y) - x, 1.0 / f64::from(inverse[level])),
            Kernel::Counts(_) => ln_poisson(f64::from(y.max(0.0)), x),
            Kernel::Grid { .. } => log_likelihood(self.noise, f64::from(y), x),
        }
    }

    /// Whether the likelihoods are those of counts.
    pub fn has_counts(&self) -> bool {
        matches!(self.kernel, Kernel::Counts(_))
    }

    /// `P(y | x_l)` of all levels as smooth functions of y, relative to the largest, whose logarithm is returned
    /// (nats), and the derivatives of their logarithms per photon. For counts the part that depends on y alone is
    /// left out. Shot and read noise together are a Gaussian of their variance.
    pub fn smooth_likelihoods(&self, y: f64, logs: &mut [f64], shares: &mut [f32], slopes: &mut [f32]) -> f64 {
        let levels = self.photons.iter().zip(logs.iter_mut()).zip(slopes.iter_mut());
        match &self.kernel {
            Kernel::Counts(_) => {
                for (((&x, log), slope), &ln) in levels.zip(&self.logs) {
                    *log = y * ln - f64::from(x);
                    *slope = ln as f32;
                }
            }
            Kernel::Gaussian { inverse, log_norm } => {
                for (((&x, log), slope), (&inverse, &norm)) in levels.zip(inverse.iter().zip(log_norm)) {
                    let z = (y - f64::from(x)) * f64::from(inverse);
                    *log = f64::from(norm) - 0.5 * z * z;
                    *slope = -z as f32 * inverse;
                }
            }
            Kernel::Grid { .. } => {
                for ((&x, log), slope) in levels {
                    let deviation = Scale::new(self.noise).variance(f64::from(x)).sqrt();
                    *log = ln_normal(y - f64::from(x), deviation);
                    *slope = ((f64::from(x) - y) / (deviation * deviation)) as f32;
                }
            }
        }
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for (share, log) in shares.iter_mut().zip(logs) {
            *share = (*log - most) as f32;
        }
        relative(0.0, shares);
        most
    }

    fn directly(&self, y: f32, shares: &mut [f32]) -> f32 {
        let logs: Vec<f64> = (0..self.count()).map(|level| self.log_likelihood(y, level)).collect();
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for (share, log) in shares.iter_mut().zip(logs) {
            *share = (log - most).exp() as f32;
        }
        most as f32
    }
}

impl Table {
    fn new(rows: usize, photons: &[f64], log_value: &(dyn Fn(usize, f64) -> f64 + Sync)) -> Self {
        let rows: Vec<(Vec<f32>, f32)> = (0..rows)
            .into_par_iter()
            .map(|row| {
                let logs: Vec<f64> = photons.iter().map(|&x| log_value(row, x)).collect();
                let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                (logs.iter().map(|log| (log - most).exp() as f32).collect(), most as f32)
            })
            .collect();
        let log_largest = rows.iter().map(|(_, most)| *most).collect();
        Self { shares: rows.into_iter().flat_map(|(shares, _)| shares).collect(), log_largest }
    }

    fn row(&self, row: usize, levels: usize) -> &[f32] {
        &self.shares[row * levels..(row + 1) * levels]
    }

    /// The densities between two rows; returns the logarithm of their scale.
    fn between(&self, position: f64, levels: usize, shares: &mut [f32]) -> f32 {
        let row = position as usize;
        let share = position - row as f64;
        let (a, b) = (f64::from(self.log_largest[row]), f64::from(self.log_largest[row + 1]));
        let most = a.max(b);
        let (wa, wb) = (((1.0 - share) * (a - most).exp()) as f32, (share * (b - most).exp()) as f32);
        let rows = self.row(row, levels).iter().zip(self.row(row + 1, levels));
        for (out, (a, b)) in shares.iter_mut().zip(rows) {
            *out = wa * a + wb * b;
        }
        most as f32
    }
}

vectorised! {
    fn gaussian_logs<'a>(
        photons: &'a [f32],
        inverse: &'a [f32],
        log_norm: &'a [f32],
        y: f32,
        logs: &'a mut [f32],
    ) {
        for (((x, inverse), norm), log) in photons.iter().zip(inverse).zip(log_norm).zip(logs) {
            let z = (y - x) * inverse;
            *log = norm - 0.5 * z * z;
        }
    }
}

vectorised! {
    fn relative<'a, fused FUSED>(largest: f32, logs: &'a mut [f32]) {
        for log in logs {
            *log = exponential::<FUSED>(*log - largest);
        }
    }
}

fn largest(values: &[f32]) -> f32 {
    values.iter().copied().fold(f32::NEG_INFINITY, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn likelihoods_of_counts_sum_to_one_at_most_however_bright_the_scene() {
        for brightest in [200.0, 50_000.0, 3e6] {
            let levels = Levels::spanning(Noise::Shot, LevelSpan { low: 0.0, high: brightest, counts: true });
            for level in 0..levels.count().min(12) {
                let photons = f64::from(levels.photons[level]);
                let last = (2.0 * photons + 400.0) as u32;
                let total: f64 = (0..=last).map(|y| levels.log_likelihood(y as f32, level).exp()).sum();
                assert!(total < 1.0001, "{brightest} {photons}: {total}");
                assert!(total > 0.45, "{brightest} {photons}: {total}");
            }
        }
        // A pixel below the offset counts as dark.
        let levels = levels(Noise::Shot, 100.0, true);
        let (mut below, mut dark) = (vec![0.0; levels.count()], vec![0.0; levels.count()]);
        assert_eq!(levels.likelihoods(-3.0, &mut below), levels.likelihoods(0.0, &mut dark));
    }

    fn levels(noise: Noise, brightest: f32, counts: bool) -> Levels {
        let images = Array3::from_shape_fn((1, 2, 2), |(_, r, c)| if r + c == 0 { 10.0 } else { brightest });
        Levels::new(noise, images.view(), counts)
    }

    #[test]
    fn levels_serve_measurements_that_they_cover_and_most_of_them() {
        let spanning = |low, high| Levels::spanning(Noise::Shot, LevelSpan { low, high, counts: true });
        let known = spanning(20.0, 500.0);
        // The darkest and the brightest pixel of another sample of the same.
        assert!(known.serve(&known) && known.serve(&spanning(17.0, 540.0)) && known.serve(&spanning(25.0, 420.0)));
        assert!(!known.serve(&spanning(20.0, 620.0)), "brighter than any level");
        assert!(!known.serve(&spanning(10.0, 500.0)), "darker by more than the noise tells");
        assert!(!known.serve(&spanning(20.0, 150.0)), "most levels would be idle");
    }

    /// Sum of the likelihoods of a level over all possible measurements, which is 1.
    fn total(levels: &Levels, level: usize, from: f64, step: f64, count: usize) -> f64 {
        let mut shares = vec![0.0; levels.count()];
        let mut sum = 0.0;
        for i in 0..count {
            let (shares, log) = levels.likelihoods((from + i as f64 * step) as f32, &mut shares);
            sum += f64::from(shares[level]) * f64::from(log).exp();
        }
        sum * step
    }

    #[test]
    fn every_level_is_a_density() {
        for (noise, counts, step) in [
            (Noise::Shot, true, 1.0),
            (Noise::Shot, false, 0.25),
            (Noise::Read { sigma: 5.0 }, false, 0.5),
            (Noise::ShotRead { sigma: 2.0 }, false, 0.173),
        ] {
            let levels = levels(noise, 300.0, counts);
            assert!((64..=512).contains(&levels.count()) && levels.count().is_multiple_of(16));
            assert_eq!(levels.range().0, 10.0);
            assert!(levels.range().1 > 330.0);
            let from = if counts { 0.0 } else { -60.0 };
            for level in [0, 20, levels.count() - 1] {
                let found = total(&levels, level, from, step, (900.0 / step) as usize);
                assert!((found - 1.0).abs() < 2e-4, "{noise} {level}: {found}");
            }
        }
    }

    #[test]
    fn very_bright_images_have_levels_without_gaps() {
        assert_eq!(levels(Noise::Shot, 1e4, true).looseness(), None);
        let levels = levels(Noise::Shot, 1e6, true);
        assert_eq!(levels.count(), 512);
        // They lie 4.2 deviations apart.
        assert!(levels.looseness().is_some_and(|bits| (bits - 1.21).abs() < 0.03), "{:?}", levels.looseness());
        let middle = 300;
        let x = f64::from(levels.photons[middle]);
        let found = total(&levels, middle, (x * 0.9).floor(), 1.0, (x * 0.2) as usize);
        assert!((found - 1.0).abs() < 1e-3, "{found}");
        // Between two levels the likelihood is not far below that at a level.
        let between = 0.5 * (levels.photons[middle] + levels.photons[middle + 1]);
        let at = levels.log_likelihood(levels.photons[middle].round(), middle);
        assert!(levels.log_likelihood(between.round(), middle) > at - 1.0);
    }

    #[test]
    fn values_beyond_the_tables_have_likelihoods() {
        for (noise, counts) in [(Noise::Shot, true), (Noise::ShotRead { sigma: 2.0 }, false)] {
            let levels = levels(noise, 50.0, counts);
            let mut shares = vec![0.0; levels.count()];
            let (shares, log) = levels.likelihoods(5000.0, &mut shares);
            assert!(log.is_finite() && log < -1000.0);
            assert_eq!(shares[levels.count() - 1], 1.0);
        }
    }
}
