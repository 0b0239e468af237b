//! The table of a calibration, for people.

use super::calibration::CameraCalibration;
use crate::plural::counted;

/// One row of the table of a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantity {
    /// Name in EMVA 1288; empty where the row repeats the quantity above in another unit.
    pub name: &'static str,
    /// Symbol in EMVA 1288.
    pub symbol: &'static str,
    /// Unit of value and interval.
    pub unit: &'static str,
    /// The value; `None` where it is unknown.
    pub value: Option<f64>,
    /// Its 95 % interval (low, high), where one is known.
    pub interval_95: Option<[f64; 2]>,
}

impl Quantity {
    /// The value with five significant digits, or "unknown".
    pub fn value_text(&self) -> String {
        self.value.map_or_else(|| "unknown".to_owned(), digits)
    }

    /// The interval in brackets; empty without one.
    pub fn interval_text(&self) -> String {
        self.interval_95.map_or(String::new(), |[low, high]| format!("[{}, {}]", digits(low), digits(high)))
    }
}

/// A number with five significant digits.
fn digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let before = value.abs().log10().floor() as i32 + 1;
    format!("{value:.*}", usize::try_from(5 - before).unwrap_or(0))
}

impl CameraCalibration {
    /// The rows of the table, in the order of the standard.
    pub fn quantities(&self) -> Vec<Quantity> {
        let of = |name, symbol, unit, value| Quantity { name, symbol, unit, value, interval_95: None };
        let with = |name, symbol, unit, value, interval| Quantity {
            interval_95: Some(interval),
            ..of(name, symbol, unit, Some(value))
        };
        let gain = self.system_gain_dn_per_electron;
        vec![
            with("system gain", "K", "DN/e-", gain, self.system_gain_dn_per_electron_interval_95),
            of("inverse gain", "1/K", "e-/DN", Some(1.0 / gain)),
            with("dark signal", "\u{3bc}_y.dark", "DN", self.dark_signal_dn, self.dark_signal_dn_interval_95),
            with(
                "temporal dark noise",
                "\u{3c3}_y.dark",
                "DN",
                self.temporal_dark_noise_dn,
                self.temporal_dark_noise_dn_interval_95,
            ),
            with(
                "",
                "\u{3c3}_d",
                "e-",
                self.temporal_dark_noise_electrons,
                self.temporal_dark_noise_electrons_interval_95,
            ),
            of("saturation", "\u{3bc}_y.sat", "DN", Some(self.saturation_dn)),
            of("saturation capacity", "\u{3bc}_e.sat", "e-", Some(self.saturation_electrons)),
            of("largest SNR", "SNR_max", "dB", Some(self.snr_max_db)),
            of("dynamic range", "DR", "dB", Some(self.dynamic_range_db)),
            of("linearity error", "LE", "%", self.linearity_error_percent),
            of("DSNU", "DSNU_1288", "e-", self.dsnu_electrons),
            of("PRNU", "PRNU_1288", "%", self.prnu_percent),
            of("quantum efficiency", "\u{3b7}", "e-/photon", self.quantum_efficiency),
        ]
    }

    /// Size, light levels, pixels that stand out, the colour that was taken, and notes; a line each.
    pub fn remarks(&self) -> Vec<String> {
        let fitted = self.light_levels.iter().filter(|level| level.is_fitted).count();
        let mut lines = vec![format!(
            "{} x {} px, {}, {fitted} of them fitted; {}, {}",
            self.rows,
            self.cols,
            counted(self.light_levels.len(), "light level"),
            counted(self.hot_pixels.count, "hot pixel"),
            counted(self.dim_pixels.count, "dim pixel")
        )];
        lines.extend(self.colour.iter().map(|colour| format!("taken: {colour}")));
        lines.extend(self.notes.iter().map(|note| format!("note: {note}")));
        lines
    }
}
