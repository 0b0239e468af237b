//! The channel from beads to noisy measurements.

use ndarray::{Array3, Axis, s};

use crate::information::entropy::noise_entropy::check_noise;
use crate::information::error::InformationError;
use crate::sensor::Noise;

/// Largest number of object pixels, all planes together, of a decoder.
const MAX_SITES: usize = 1 << 18;
/// Share of the brightest pixel below which rows and columns at the edges of a spot are left out. Their information
/// is far below 1e-6 bit.
const FAINT: f64 = 1e-6;

/// Independent beads imaged by an encoder. Every object pixel that could reach the patch holds a bead with the same
/// probability. Every bead adds the same spot to the sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct BeadChannel {
    /// Photons that one bead adds to an infinite sensor (bead convolved with the point spread function), shape (planes,
    /// rows, cols).
    pub spot: Array3<f64>,
    /// Probability of a bead at an object pixel.
    pub probability: f64,
    /// Photons per pixel without beads.
    pub bias: f64,
    /// Noise of the sensor.
    pub noise: Noise,
    /// Rows and columns of the patch, px; up to the whole sensor.
    pub patch: (usize, usize),
}

impl BeadChannel {
    /// Checks the channel, with and without the dark edges of its spot.
    ///
    /// # Errors
    /// As [`super::decoder_lower_bound`] for an invalid channel.
    pub fn check(&self) -> Result<(), InformationError> {
        self.whole_spot().map(|_| ())
    }

    /// Checks the channel and returns the spot without its dark edges.
    pub(crate) fn checked_spot(&self) -> Result<Array3<f64>, InformationError> {
        self.check_numbers()?;
        self.of_sites(self.trimmed()?)
    }

    /// Returns the spot with its dark edges; otherwise as [`BeadChannel::checked_spot`].
    pub(crate) fn whole_spot(&self) -> Result<Array3<f64>, InformationError> {
        self.check_numbers()?;
        self.trimmed()?;
        self.of_sites(self.spot.clone())
    }

    fn check_numbers(&self) -> Result<(), InformationError> {
        check_noise(self.noise)?;
        if !(self.probability > 0.0 && self.probability < 1.0) {
            return Err(InformationError::Probability { found: self.probability });
        }
        let (rows, cols) = self.patch;
        if rows.checked_mul(cols).is_none_or(|pixels| !(1..=MAX_SITES).contains(&pixels)) {
            return Err(InformationError::PatchSize { rows, cols, limit: MAX_SITES });
        }
        if let Some(&found) = self.spot.iter().chain([&self.bias]).find(|value| !(value.is_finite() && **value >= 0.0))
        {
            return Err(InformationError::Photons { found });
        }
        Ok(())
    }

    /// Returns the spot if the number of sites that reach the patch is within the limit of a decoder.
    fn of_sites(&self, spot: Array3<f64>) -> Result<Array3<f64>, InformationError> {
        let (rows, cols) = self.patch;
        let (planes, spot_rows, spot_cols) = spot.dim();
        let found = planes.saturating_mul((rows + spot_rows - 1) * (cols + spot_cols - 1));
        if found > MAX_SITES {
            return Err(InformationError::TooManySites { found, limit: MAX_SITES });
        }
        Ok(spot)
    }

    fn trimmed(&self) -> Result<Array3<f64>, InformationError> {
        let peak = self.spot.iter().copied().fold(0.0, f64::max);
        let bright = |axis: usize| {
            let lines = self.spot.axis_iter(Axis(axis)).map(|line| line.iter().any(|&value| value > FAINT * peak));
            let lines: Vec<bool> = lines.collect();
            let first = lines.iter().position(|&lit| lit)?;
            let last = lines.iter().rposition(|&lit| lit)?;
            Some(first..=last)
        };
        match (bright(1), bright(2)) {
            (Some(rows), Some(cols)) => Ok(self.spot.slice(s![.., rows, cols]).to_owned()),
            _ => Err(InformationError::NoLight),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel() -> BeadChannel {
        let mut spot = Array3::zeros((1, 9, 7));
        spot[[0, 3, 2]] = 50.0;
        spot[[0, 4, 4]] = 20.0;
        spot[[0, 8, 6]] = 1e-6;
        BeadChannel { spot, probability: 0.1, bias: 10.0, noise: Noise::Shot, patch: (4, 4) }
    }

    #[test]
    fn dark_edges_are_cut_off() {
        let spot = channel().checked_spot().unwrap();
        assert_eq!(spot.dim(), (1, 2, 3));
        assert_eq!(spot.sum(), 70.0);
    }

    #[test]
    fn what_is_no_channel_is_refused_in_a_sentence() {
        let refused = |change: &dyn Fn(&mut BeadChannel), part: &str| {
            let mut channel = channel();
            change(&mut channel);
            let message = channel.checked_spot().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        };
        refused(&|c| c.probability = 0.0, "between 0 and 1");
        refused(&|c| c.probability = f64::NAN, "between 0 and 1");
        refused(&|c| c.patch = (0, 3), "0 x 3");
        refused(&|c| c.patch = (usize::MAX, 2), "cannot be modelled");
        refused(&|c| c.patch = (512, 512), "object pixels reach the patch");
        refused(&|c| c.noise = Noise::None, "without noise");
        refused(&|c| c.noise = Noise::Read { sigma: -1.0 }, "read noise");
        refused(&|c| c.spot.fill(0.0), "no photons");
        refused(&|c| c.spot = Array3::zeros((0, 0, 0)), "no photons");
        refused(&|c| c.spot[[0, 1, 1]] = f64::NAN, "finite");
        refused(&|c| c.bias = -1.0, "not negative");
    }
}
