//! Response of a sensor to light: linearity error and quantum efficiency.

use super::line::{Line, slope_through_origin};
use super::transfer::LightLevel;

/// Range of the signal in which linearity is judged, as shares of saturation (EMVA 1288).
pub(super) const LINEAR: std::ops::RangeInclusive<f64> = 0.05..=0.95;
/// Share of the saturation up to which the responsivity is fitted.
const RESPONSIVE_SHARE: f64 = 0.7;
/// Smallest number of levels for a line and its deviations.
const LEAST_LEVELS: usize = 3;

/// The linearity of a series.
#[derive(Clone, Debug)]
pub(super) struct Linearity {
    /// Exposure of each level, in the unit of `unit`; all levels.
    pub(super) exposures: Vec<f64>,
    pub(super) unit: &'static str,
    pub(super) line: Line,
    /// Mean of the absolute relative deviations from the line between 5 and 95 % of saturation, per cent.
    pub(super) error_percent: f64,
}

/// Exposure of each level, and its unit: photons where all are known, else the exposure time if it varies.
fn exposures(levels: &[LightLevel]) -> Option<(Vec<f64>, &'static str)> {
    let varies = |values: &[f64]| values.iter().any(|value| (value - values[0]).abs() > 1e-3 * values[0].abs());
    let photons: Option<Vec<f64>> = levels.iter().map(|level| level.photons).collect();
    let times: Option<Vec<f64>> = levels.iter().map(|level| level.exposure_ns.map(|ns| ns / 1e6)).collect();
    let photons = photons.filter(|values| varies(values)).map(|values| (values, "photons per pixel"));
    photons.or_else(|| times.filter(|values| varies(values)).map(|values| (values, "exposure time (ms)")))
}

/// Linearity of the levels, after EMVA 1288 release 4.0, section 8: the line minimises squared relative deviations. `None` where
/// exposures are unknown or too few.
pub(super) fn linearity(levels: &[LightLevel], saturation_dn: f64) -> Option<Linearity> {
    let (exposures, unit) = exposures(levels)?;
    let points: Vec<[f64; 2]> = exposures
        .iter()
        .zip(levels)
        .filter(|(_, level)| LINEAR.contains(&(level.signal_dn / saturation_dn)))
        .map(|(&exposure, level)| [exposure, level.signal_dn])
        .collect();
    if points.len() < LEAST_LEVELS {
        return None;
    }
    let line = Line::fit_relative(&points)?;
    let deviation = |[x, y]: &[f64; 2]| {
        let fitted = line.start + line.slope * x;
        100.0 * ((y - fitted) / fitted).abs()
    };
    let error_percent = points.iter().map(deviation).sum::<f64>() / points.len() as f64;
    Some(Linearity { exposures, unit, line, error_percent })
}

/// Electrons per photon; `None` where photons are unknown.
pub(super) fn quantum_efficiency(levels: &[LightLevel], saturation_dn: f64, gain: f64) -> Option<f64> {
    let in_range = |level: &&LightLevel| level.signal_dn <= RESPONSIVE_SHARE * saturation_dn;
    let points: Option<Vec<[f64; 2]>> =
        levels.iter().filter(in_range).map(|level| Some([level.photons?, level.signal_dn])).collect();
    let points = points.filter(|points| !points.is_empty())?;
    Some(slope_through_origin(&points) / gain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn level(exposure_ms: f64, photons: Option<f64>, signal_dn: f64) -> LightLevel {
        LightLevel {
            label: String::new(),
            exposure_ns: Some(exposure_ms * 1e6),
            photons,
            frames: 2,
            signal_dn,
            temporal_variance_dn2: signal_dn,
            dark_variance_dn2: 0.0,
            is_fitted: true,
        }
    }

    #[test]
    fn deviations_from_a_line_are_relative() {
        let levels: Vec<LightLevel> = (1..=10).map(|ms| level(f64::from(ms), None, f64::from(ms) * 100.0)).collect();
        let straight = linearity(&levels, 1000.0).unwrap();
        assert!(straight.error_percent < 1e-9 && (straight.line.slope - 100.0).abs() < 1e-9);
        let mut bent = levels.clone();
        for level in &mut bent {
            level.signal_dn *= 1.0 - 2e-5 * level.signal_dn;
        }
        let found = linearity(&bent, 1000.0).unwrap().error_percent;
        assert!((0.1..0.6).contains(&found), "{found}");
        assert!(linearity(&levels[..2], 200.0).is_none());
        let same: Vec<LightLevel> = (1..=5).map(|n| level(1.0, None, f64::from(n))).collect();
        assert!(linearity(&same, 5.0).is_none());
    }

    #[test]
    fn efficiency_is_electrons_per_photon() {
        let levels: Vec<LightLevel> =
            (1..=5).map(|n| level(1.0, Some(100.0 * f64::from(n)), 2.0 * 60.0 * f64::from(n))).collect();
        assert!((quantum_efficiency(&levels, 1e4, 2.0).unwrap() - 0.6).abs() < 1e-12);
        assert_eq!(linearity(&levels, 700.0).unwrap().unit, "photons per pixel");
        let unknown = [level(1.0, None, 5.0)];
        assert_eq!(quantum_efficiency(&unknown, 100.0, 2.0), None);
    }
}
