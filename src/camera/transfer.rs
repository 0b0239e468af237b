//! Photon transfer: system gain, temporal dark noise and saturation from temporal means and variances.
//!
//! Equations of EMVA 1288 release 4.0: `s2_y - s2_dark = K (mu_y - mu_dark)`, K in DN per electron.

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::error::CameraError;
use super::frames::{BlockSums, Moments};
use super::line::{Line, slope_through_origin};
use crate::percentile::interval_95;
use crate::plural::{counted, one_or_many};

/// Share of the saturation up to which the gain is fitted.
const FITTED_SHARE: f64 = 0.7;
/// Smallest dark variance that is more than quantisation, in squared steps (EMVA 1288).
const LEAST_VARIANCE: f64 = 0.24;
/// Dark variance below which the variance of rounded values depends on where the mean lies between two steps, in squared steps.
const ROUNDED_VARIANCE: f64 = 0.4;
/// Largest share of dark values at 0 where the noise counts as complete (EMVA 1288).
const MOST_CUT_OFF: f64 = 0.005;
/// Largest share of values at 0 of a light level whose variance replaces that in the dark: it then loses about 0.1 %.
const MOST_CUT_OFF_OF_LIGHT: f64 = 0.0005;
/// Variance of the rounding error, in squared steps.
pub(super) const ROUNDING_VARIANCE: f64 = 1.0 / 12.0;
/// Standard errors by which a variance has to differ to count.
const CLEAR: f64 = 5.0;
/// Resamplings of the blocks.
const RESAMPLINGS: usize = 1000;
const SEED: u64 = 1288;

/// Frames of one exposure and light, reduced to blocks.
#[derive(Clone, Debug)]
pub(super) struct Step {
    pub(super) label: String,
    pub(super) exposure_ns: Option<f64>,
    pub(super) photons: Option<f64>,
    pub(super) frames: usize,
    pub(super) pixels: f64,
    /// Share of the values that are cut off at 0.
    pub(super) cut_off_share: f64,
    pub(super) sums: BlockSums,
}

impl Step {
    /// Whether the camera cuts the noise of dark frames off at 0.
    fn is_cut_off(&self) -> bool {
        self.cut_off_share > MOST_CUT_OFF
    }

    /// Relative standard error of the variance.
    fn relative_error(&self) -> f64 {
        (2.0 / (self.pixels * (self.frames as f64 - 1.0))).sqrt()
    }

    /// Standard error of the mean over the pixels, DN, for a temporal variance.
    fn error_of_mean(&self, variance: f64) -> f64 {
        (variance / (self.pixels * self.frames as f64)).sqrt()
    }
}

/// One light level of a photon transfer curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct LightLevel {
    /// Name of the group of frames.
    pub label: String,
    /// Exposure time in nanoseconds, or null.
    pub exposure_ns: Option<f64>,
    /// Mean photons of a pixel, or null.
    pub photons: Option<f64>,
    /// Number of frames.
    pub frames: usize,
    /// Mean grey value, less that in the dark, DN.
    pub signal_dn: f64,
    /// Temporal variance, DN^2.
    pub temporal_variance_dn2: f64,
    /// Temporal variance of the dark frames of the level, DN^2.
    pub dark_variance_dn2: f64,
    /// Whether the system gain was fitted to this level.
    pub is_fitted: bool,
}

/// The result of a photon transfer series.
#[derive(Clone, Debug)]
pub(super) struct PhotonTransfer {
    pub(super) gain: f64,
    pub(super) gain_interval: [f64; 2],
    pub(super) dark_signal: f64,
    pub(super) dark_signal_interval: [f64; 2],
    pub(super) noise_dn: f64,
    pub(super) noise_dn_interval: [f64; 2],
    pub(super) noise_electrons: f64,
    pub(super) noise_electrons_interval: [f64; 2],
    /// Signal at saturation, or of the brightest level, above the dark signal, DN.
    pub(super) saturation_dn: f64,
    pub(super) levels: Vec<LightLevel>,
    pub(super) notes: Vec<String>,
}

/// Dark frames and light levels, and what is known of their grey values.
pub(super) struct TransferSeries<'a> {
    /// File or folder, for error sentences.
    pub(super) path: &'a Path,
    pub(super) darks: Vec<Step>,
    /// Light levels by rising mean.
    pub(super) lights: Vec<Step>,
    /// Step of the grey values; 0 where they are not whole.
    pub(super) step: f64,
    /// Largest grey value that the stated bit depth can hold.
    pub(super) top: Option<f64>,
}

/// Moments of all steps under one resampling.
struct Drawn {
    darks: Vec<Moments>,
    lights: Vec<Moments>,
}

impl TransferSeries<'_> {
    fn drawn(&self, draws: Option<&[f64]>) -> Drawn {
        let of = |steps: &[Step]| steps.iter().map(|step| step.sums.moments(draws)).collect();
        Drawn { darks: of(&self.darks), lights: of(&self.lights) }
    }

    /// Dark frames of the exposure that is nearest to that of a light level.
    fn dark_of(&self, light: &Step) -> usize {
        let distance = |dark: &Step| match (dark.exposure_ns, light.exposure_ns) {
            (Some(dark), Some(light)) => (dark - light).abs(),
            _ => 0.0,
        };
        let nearest =
            (0..self.darks.len()).min_by(|&a, &b| distance(&self.darks[a]).total_cmp(&distance(&self.darks[b])));
        nearest.unwrap_or_default()
    }

    /// Dark frames of the shortest exposure.
    fn shortest_dark(&self) -> usize {
        let exposure = |index: &usize| self.darks[*index].exposure_ns.unwrap_or(0.0);
        (0..self.darks.len()).min_by(|a, b| exposure(a).total_cmp(&exposure(b))).unwrap_or_default()
    }

    /// Evaluates the series.
    pub(super) fn evaluate(&self) -> Result<PhotonTransfer, CameraError> {
        let mut notes = Vec::new();
        let dark_of: Vec<usize> = self.lights.iter().map(|light| self.dark_of(light)).collect();
        self.note_exposures(&dark_of, &mut notes);
        let plain = self.drawn(None);
        self.check(&plain, &dark_of)?;
        let signal = |drawn: &Drawn, level: usize| drawn.lights[level].mean - drawn.darks[dark_of[level]].mean;
        let signals: Vec<f64> = (0..self.lights.len()).map(|level| signal(&plain, level)).collect();
        let saturation_dn = self.saturation(&plain, &signals, &mut notes);
        let mut fitted: Vec<usize> = (0..signals.len())
            .filter(|&level| signals[level] > 0.0 && signals[level] <= FITTED_SHARE * saturation_dn.for_fit)
            .collect();
        if fitted.is_empty() {
            let advice = "record levels between the dark and 70 % of saturation";
            return Err(self.no_shot_noise(&plain, advice));
        }
        let shortest = self.shortest_dark();
        let square = self.step * self.step;
        let dark_variance = plain.darks[shortest].variance;
        let start = self.start(&plain, &dark_of, &mut fitted, &mut notes);
        let points = |drawn: &Drawn| -> Vec<[f64; 2]> {
            let point = |&level: &usize| {
                let Moments { mean, variance } = drawn.lights[level];
                match start {
                    Start { is_fitted: true, is_cut_off: true } => [mean, variance],
                    Start { is_fitted: true, .. } => [signal(drawn, level), variance],
                    _ => [signal(drawn, level), variance - drawn.darks[dark_of[level]].variance],
                }
            };
            fitted.iter().map(point).collect()
        };
        let slope = |drawn: &Drawn| {
            let points = points(drawn);
            if start.is_fitted {
                Line::fit_relative(&points).map_or(f64::NAN, |line| line.slope)
            } else {
                gain_through_origin(&points, drawn.darks[shortest].variance)
            }
        };
        let gain = slope(&plain);
        if gain <= 0.0 || !gain.is_finite() {
            let advice = "the frames are saturated, averaged, or copies of one frame";
            return Err(self.no_shot_noise(&plain, advice));
        }
        if fitted.len() < 3 {
            notes.push(format!("the gain rests on {} below 70 % of saturation", counted(fitted.len(), "light level")));
        }
        if !start.is_fitted {
            notes.extend(bend(&points(&plain), gain, |at| self.lights[fitted[at]].relative_error()));
        }
        if dark_variance < LEAST_VARIANCE * square && !start.is_cut_off {
            notes.push(format!(
                "the dark variance of {dark_variance:.3} DN^2 is below 0.24 squared steps, where rounding rules: the temporal dark \
                 noise is at most the value given"
            ));
        }
        let noise_dn = |drawn: &Drawn| drawn.darks[shortest].variance.max(LEAST_VARIANCE * square).sqrt();
        let noise_electrons =
            |noise_dn: f64, gain: f64| (noise_dn * noise_dn - ROUNDING_VARIANCE * square).max(0.0).sqrt() / gain;
        let mut resampled: [Vec<f64>; 4] = Default::default();
        for draws in self.resamplings() {
            let drawn = self.drawn(Some(&draws));
            let (gain, noise) = (slope(&drawn), noise_dn(&drawn));
            let values = [gain, drawn.darks[shortest].mean, noise, noise_electrons(noise, gain)];
            resampled.iter_mut().zip(values).for_each(|(all, value)| all.push(value));
        }
        let [gain_interval, dark_signal_interval, noise_dn_interval, noise_electrons_interval] =
            resampled.map(interval_95);
        let levels = self.lights.iter().enumerate().map(|(level, light)| LightLevel {
            label: light.label.clone(),
            exposure_ns: light.exposure_ns,
            photons: light.photons,
            frames: light.frames,
            signal_dn: signals[level],
            temporal_variance_dn2: plain.lights[level].variance,
            dark_variance_dn2: plain.darks[dark_of[level]].variance,
            is_fitted: fitted.contains(&level),
        });
        Ok(PhotonTransfer {
            gain,
            gain_interval,
            dark_signal: plain.darks[shortest].mean,
            dark_signal_interval,
            noise_dn: noise_dn(&plain),
            noise_dn_interval,
            noise_electrons: noise_electrons(noise_dn(&plain), gain),
            noise_electrons_interval,
            saturation_dn: saturation_dn.signal,
            levels: levels.collect(),
            notes,
        })
    }

    /// Where the line of the gain starts. The `fitted` levels lose those that a line without dark frames cannot rest on.
    fn start(&self, plain: &Drawn, dark_of: &[usize], fitted: &mut Vec<usize>, notes: &mut Vec<String>) -> Start {
        let (shortest, square) = (self.shortest_dark(), self.step * self.step);
        let dark_variance = plain.darks[shortest].variance;
        let cut_off = dark_of.iter().chain([&shortest]).map(|&dark| &self.darks[dark]).find(|dark| dark.is_cut_off());
        // Rounded values of little noise have a variance that depends on their mean: the line then starts anywhere.
        let resolved = |&level: &usize| {
            plain.lights[level].variance >= ROUNDED_VARIANCE * square
                && (cut_off.is_none() || self.lights[level].cut_off_share <= MOST_CUT_OFF_OF_LIGHT)
        };
        let is_fitted = (cut_off.is_some() || dark_variance < ROUNDED_VARIANCE * square)
            && fitted.iter().copied().filter(|level| resolved(level)).count() > 1;
        if is_fitted {
            fitted.retain(resolved);
        }
        if let Some(dark) = cut_off {
            let clamped = dark_variance < LEAST_VARIANCE * square;
            notes.push(cut_off_note(dark.cut_off_share, is_fitted.then_some(fitted.len()), clamped));
        } else if is_fitted {
            notes.push(format!(
                "the dark variance of {dark_variance:.3} DN^2 is mostly rounding, so the line of the gain starts at a fitted \
                 variance"
            ));
        }
        Start { is_fitted, is_cut_off: cut_off.is_some() }
    }

    fn note_exposures(&self, dark_of: &[usize], notes: &mut Vec<String>) {
        let differs = self.lights.iter().zip(dark_of).filter(|(light, dark)| {
            let pair = light.exposure_ns.zip(self.darks[**dark].exposure_ns);
            pair.is_some_and(|(light, dark)| (light - dark).abs() > 1e-3 * light)
        });
        let count = differs.count();
        if count > 0 {
            notes.push(format!(
                "{} {} no dark frames of the same exposure, so those of the nearest were subtracted; dark current is then left in",
                counted(count, "light level"),
                one_or_many(count, "has", "have")
            ));
        }
    }

    fn no_shot_noise(&self, plain: &Drawn, advice: &'static str) -> CameraError {
        let most = plain.lights.iter().map(|light| light.variance).fold(0.0, f64::max);
        let dark = plain.darks.iter().map(|dark| dark.variance).fold(f64::INFINITY, f64::min);
        let (found, dark) = (format!("{most:.4}"), format!("{dark:.4}"));
        CameraError::NoShotNoise { path: self.path.to_path_buf(), found, dark, advice }
    }

    /// Refuses series whose dark frames are bright, or whose light has no noise.
    fn check(&self, plain: &Drawn, dark_of: &[usize]) -> Result<(), CameraError> {
        let mut brightest_clear = false;
        for (level, light) in self.lights.iter().enumerate() {
            let (found, dark) = (plain.lights[level], plain.darks[dark_of[level]]);
            let error =
                light.error_of_mean(found.variance).hypot(self.darks[dark_of[level]].error_of_mean(dark.variance));
            if found.mean < dark.mean - CLEAR * error - 0.5 * self.step {
                return Err(CameraError::DarkIsBright {
                    path: self.path.to_path_buf(),
                    dark: (dark.mean * 100.0).round() / 100.0,
                    dimmest: (found.mean * 100.0).round() / 100.0,
                });
            }
            let error =
                found.variance * light.relative_error() + dark.variance * self.darks[dark_of[level]].relative_error();
            brightest_clear |= found.variance - dark.variance > CLEAR * error;
        }
        if brightest_clear {
            return Ok(());
        }
        Err(self.no_shot_noise(plain, "the frames are saturated, too dim, or copies of one frame"))
    }

    /// Saturation: the level of the largest variance, if the variance of a brighter one is clearly smaller.
    fn saturation(&self, plain: &Drawn, signals: &[f64], notes: &mut Vec<String>) -> Saturation {
        let most = (0..signals.len()).max_by(|&a, &b| plain.lights[a].variance.total_cmp(&plain.lights[b].variance));
        let most = most.unwrap_or_default();
        let largest = plain.lights[most].variance;
        let falls = |level: usize| {
            let error = self.lights[level].relative_error().hypot(self.lights[most].relative_error());
            plain.lights[level].variance < largest * (1.0 - CLEAR * error)
        };
        if (most + 1..signals.len()).any(falls) {
            return Saturation { signal: signals[most], for_fit: signals[most] };
        }
        let brightest = signals.iter().copied().fold(0.0, f64::max);
        notes.push(
            "the variance does not turn down, so the brightest level stands for saturation: saturation, SNR and dynamic range \
             are at least the values given"
                .into(),
        );
        let dark = plain.darks.iter().map(|dark| dark.mean).fold(f64::INFINITY, f64::min);
        let most_stated = self.top.map_or(0.0, |top| top - dark);
        Saturation { signal: brightest, for_fit: brightest.max(most_stated) }
    }

    /// How often each block counts, for each resampling of the blocks with replacement.
    fn resamplings(&self) -> impl Iterator<Item = Vec<f64>> + use<> {
        let blocks = self.darks.first().map_or(0, |dark| dark.sums.len());
        (0..RESAMPLINGS).map(move |index| {
            let mut random = ChaCha8Rng::seed_from_u64(SEED);
            random.set_stream(index as u64);
            let mut draws = vec![0.0; blocks];
            (0..blocks).for_each(|_| draws[random.random_range(0..blocks)] += 1.0);
            draws
        })
    }
}

/// The start of the line of the gain.
#[derive(Clone, Copy)]
struct Start {
    /// Whether it is a fitted variance in place of the dark one.
    is_fitted: bool,
    /// Whether the camera cuts dark noise off at 0, so that dark means are too large. Each exposure has another such mean.
    is_cut_off: bool,
}

/// Saturation above the dark signal, DN.
struct Saturation {
    signal: f64,
    /// Saturation that limits the fitted range.
    for_fit: f64,
}

/// Slope of the photon transfer curve through the origin. Variances scatter by a share of themselves, so each point weighs by the inverse
/// square of the variance that a first line gives it above that of the dark. Weights of the measured variances would bias the slope.
fn gain_through_origin(points: &[[f64; 2]], dark_variance: f64) -> f64 {
    let first = slope_through_origin(points);
    let (mut products, mut squares) = (0.0, 0.0);
    for [x, y] in points {
        let weight = (dark_variance + first * x).powi(-2);
        products += weight * x * y;
        squares += weight * x * x;
    }
    // A series without shot noise is refused by its first slope.
    if first > 0.0 { products / squares } else { first }
}

/// A note on dark frames whose noise is cut off at 0, as with too small an offset of the camera.
///
/// `levels` is the number of light levels that give the gain without the dark frames; `None` where too few are free of 0. A variance
/// that is `clamped` is no bound of the dark noise.
fn cut_off_note(share: f64, levels: Option<usize>, clamped: bool) -> String {
    let gain = match levels {
        Some(levels) => format!("the gain comes from {levels} light levels without the dark frames"),
        None => "the gain is an upper bound".into(),
    };
    let bounds = if clamped {
        "dark signal is an upper bound, temporal dark noise and dynamic range are unknown"
    } else {
        "dark signal and dynamic range are upper bounds, temporal dark noise and DSNU lower bounds"
    };
    format!(
        "{:.1} % of the dark values are 0, where the camera cuts its noise off: {gain}; {bounds}; record with a larger offset (black \
         level)",
        100.0 * share
    )
}

/// A note on a photon transfer curve that is no line: its variance per signal changes from dim to bright levels.
fn bend(points: &[[f64; 2]], gain: f64, relative_error: impl Fn(usize) -> f64) -> Option<String> {
    // Variance over signal against signal, weighted by its error.
    let weighted = points.iter().enumerate().map(|(at, &[x, y])| {
        let error = relative_error(at) * (y / x).abs();
        ([x, y / x], if error > 0.0 { error.powi(-2) } else { 0.0 })
    });
    let Line { start, slope, slope_error } = Line::fit(weighted).filter(|_| points.len() >= 4)?;
    let brightest = points.iter().map(|point| point[0]).fold(0.0, f64::max);
    let share = slope * brightest / start;
    (slope.abs() > CLEAR * slope_error && share.abs() > 0.02).then(|| {
        format!(
            "the photon transfer curve is bent by {:.1} % up to 70 % of saturation: at low light the gain is {start:.4} in place \
             of {gain:.4} DN per electron",
            100.0 * share
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gain_is_the_slope_of_a_line() {
        let line = [1.0, 2.0, 5.0].map(|x| [x, 0.5 * x]);
        assert!((gain_through_origin(&line, 4.0) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn bent_curves_are_named_and_lines_are_not() {
        let curve = |bend: f64| {
            (1..=10).map(|x| [f64::from(x), f64::from(x) * (1.0 - bend * f64::from(x))]).collect::<Vec<_>>()
        };
        assert_eq!(bend(&curve(0.0), 1.0, |_| 0.001), None);
        assert!(bend(&curve(0.01), 0.95, |_| 0.001).unwrap().contains("bent by -10.0 %"));
        assert_eq!(bend(&curve(0.01), 0.95, |_| 0.5), None);
    }
}
