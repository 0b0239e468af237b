//! Conversion of grey values of a camera to photons.

use ndarray::{Array3, ArrayView3, s};
use serde::{Deserialize, Serialize};

use crate::evaluation::measured_error::MeasuredError;
use crate::plural::counted;

/// Conversion of grey values to photons: `photons = (grey - offset) / gain`, then sums over bins of pixels.
///
/// Sums keep the statistics of shot noise: the sum of Poisson counts is Poisson distributed, their mean is not.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// // 2 grey values per photon, 64 without light.
/// let calibration = Calibration { gain: 2.0, offset: 64.0, bin: 1 };
/// assert_ne!(calibration, Calibration::default());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::unsafe_derive_deserialize, reason = "the slicing macro of ndarray has unsafe code of its own")]
pub struct Calibration {
    /// Grey values per photon: the gradient of variance against mean of flat images at many intensities.
    pub gain: f64,
    /// Grey value without light.
    pub offset: f64,
    /// Rows and columns of the square bins whose pixels are summed.
    pub bin: usize,
}

impl Default for Calibration {
    fn default() -> Self {
        Self { gain: 1.0, offset: 0.0, bin: 1 }
    }
}

impl Calibration {
    pub(crate) fn check(&self) -> Result<(), MeasuredError> {
        let wrong = |what, expected, found| Err(MeasuredError::Calibration { what, expected, found });
        if !(self.gain > 0.0 && self.gain.is_normal()) {
            return wrong("gain", "a number above 0, in grey levels per photon", self.gain);
        }
        if !self.offset.is_finite() {
            return wrong("offset", "a finite grey level", self.offset);
        }
        Ok(())
    }

    /// Photons of images in grey values, shape (n, rows, cols); rows and columns that fill no bin are left out.
    pub(crate) fn photons(&self, grey: ArrayView3<'_, f32>) -> Result<Array3<f32>, MeasuredError> {
        let (count, rows, cols) = grey.dim();
        let bin = self.bin;
        if !(1..=rows.min(cols)).contains(&bin) {
            return Err(MeasuredError::Bin { most: rows.min(cols), found: bin });
        }
        Ok(Array3::from_shape_fn((count, rows / bin, cols / bin), |(n, r, c)| {
            let square = grey.slice(s![n, r * bin..(r + 1) * bin, c * bin..(c + 1) * bin]);
            let sum: f64 = square.iter().map(|&grey| (f64::from(grey) - self.offset) / self.gain).sum();
            sum as f32
        }))
    }

    /// Summary of the calibration, for people.
    pub(crate) fn describe(&self) -> String {
        let Self { gain, offset, bin } = *self;
        let sum = if bin > 1 { format!(", summed over {bin} x {bin} pixels") } else { String::new() };
        let inverse = (1e5 / gain).round() / 1e5;
        format!("photons are (grey level - {offset}) / {gain} ({} per DN){sum}", counted(inverse, "photon"))
    }
}
