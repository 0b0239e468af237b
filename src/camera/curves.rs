//! The curves of a calibration: photon transfer, linearity and signal-to-noise ratio.

use super::calibration::CameraCalibration;
use super::response::{LINEAR, linearity};
use super::transfer::LightLevel;

/// Deviations of the light levels from a line.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearityCurve {
    /// Name of the exposure with its unit.
    pub unit: &'static str,
    /// The light levels, by rising signal.
    pub points: Vec<LinearityPoint>,
}

/// One light level of a [`LinearityCurve`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearityPoint {
    /// Exposure in the unit of the curve.
    pub exposure: f64,
    /// Mean grey value less that in the dark, DN.
    pub signal_dn: f64,
    /// Deviation from the line, per cent of the line.
    pub deviation_percent: f64,
    /// Whether the level lies between 5 and 95 % of saturation and counts for the linearity error.
    pub is_judged: bool,
}

impl LightLevel {
    /// Temporal variance less that in the dark, DN^2: the ordinate of the photon transfer curve.
    pub fn shot_variance_dn2(&self) -> f64 {
        self.temporal_variance_dn2 - self.dark_variance_dn2
    }
}

impl CameraCalibration {
    /// Largest signal of the levels to which the system gain was fitted, DN; 0 without one.
    pub fn fitted_signal_dn(&self) -> f64 {
        let fitted = self.light_levels.iter().filter(|level| level.is_fitted);
        fitted.map(|level| level.signal_dn).fold(0.0, f64::max)
    }

    /// Signal-to-noise ratio of the linear model at a number of electrons, dB.
    pub fn snr_db(&self, electrons: f64) -> f64 {
        let noise = self.temporal_dark_noise_dn / self.system_gain_dn_per_electron;
        20.0 * (electrons / (electrons + noise * noise).sqrt()).log10()
    }

    /// Electrons and signal-to-noise ratio (dB) of each light level above one electron and 0 dB.
    pub fn snr_of_levels(&self) -> Vec<[f64; 2]> {
        let gain = self.system_gain_dn_per_electron;
        let bright =
            self.light_levels.iter().filter(|level| level.signal_dn > gain && level.temporal_variance_dn2 > 0.0);
        bright
            .map(|level| {
                let ratio = level.signal_dn / level.temporal_variance_dn2.sqrt();
                [level.signal_dn / gain, 20.0 * ratio.log10()]
            })
            .filter(|[_, ratio]| *ratio > 0.0)
            .collect()
    }

    /// Deviations from the line of EMVA 1288 release 4.0, section 8; `None` where exposures are unknown or too few.
    pub fn linearity_curve(&self) -> Option<LinearityCurve> {
        let saturation = self.saturation_dn - self.dark_signal_dn;
        let found = linearity(&self.light_levels, saturation)?;
        let points = found.exposures.iter().zip(&self.light_levels).map(|(&exposure, level)| {
            let fitted = found.line.start + found.line.slope * exposure;
            LinearityPoint {
                exposure,
                signal_dn: level.signal_dn,
                deviation_percent: 100.0 * (level.signal_dn - fitted) / fitted,
                is_judged: LINEAR.contains(&(level.signal_dn / saturation)),
            }
        });
        Some(LinearityCurve { unit: found.unit, points: points.collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulated::SimulatedSensor;

    #[test]
    fn curves_agree_with_the_quantities() {
        let camera = SimulatedSensor { shape: (24, 32), ..SimulatedSensor::default() }.calibrated(8, 2).calibration;
        let curve = camera.linearity_curve().unwrap();
        let judged: Vec<f64> =
            curve.points.iter().filter(|point| point.is_judged).map(|point| point.deviation_percent.abs()).collect();
        let mean = judged.iter().sum::<f64>() / judged.len() as f64;
        assert!((mean - camera.linearity_error_percent.unwrap()).abs() < 1e-9, "{mean}");
        assert_eq!(curve.unit, "photons per pixel");
        // Below saturation the model is what is measured.
        for [electrons, measured] in &camera.snr_of_levels()[..5] {
            assert!((camera.snr_db(*electrons) - measured).abs() < 1.0, "{electrons} electrons: {measured} dB");
        }
        let fitted = camera.fitted_signal_dn();
        assert!(fitted > 0.3 * camera.saturation_dn && fitted < 0.75 * camera.saturation_dn, "{fitted}");
        // Shot noise: the variance of the dimmest level is the gain times its signal.
        let level = &camera.light_levels[0];
        let gain = level.shot_variance_dn2() / level.signal_dn;
        assert!((gain / camera.system_gain_dn_per_electron - 1.0).abs() < 0.3, "{gain}");
    }
}
