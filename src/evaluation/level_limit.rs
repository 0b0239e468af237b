//! The effect of whole grey values on an estimate of measured images.

use crate::sensor::Noise;

/// Largest distance of grey values that read noise hides, in its standard deviations.
const MOST_STEP: f64 = 2.0;

/// Limit that the number of grey values sets to information.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LevelLimit {
    /// Bits per pixel.
    pub(crate) bits: f64,
    /// Photons of one step of the grey values.
    pub(crate) step: f64,
}

impl LevelLimit {
    /// The noise of the upper bound for whole grey values. Read noise that is too weak to hide the steps is left out, as
    /// [`Noise::bounding`] does it for whole counts. Read noise only takes information from whole values.
    pub(crate) fn bounding(&self, noise: Noise) -> Noise {
        match noise {
            Noise::ShotRead { sigma } if self.step > MOST_STEP * sigma => Noise::Shot,
            other => other,
        }
    }

    /// A warning where whole grey values are coarse beside the noise.
    pub(crate) fn warn_of_steps(&self, noise: Noise) -> Option<String> {
        let (step, read) = (self.step, MOST_STEP * noise.read_sigma().unwrap_or(0.0));
        // Shot noise hides steps of a photon.
        let hidden = if noise.has_shot_noise() { read.max(1.0) } else { read };
        (step > hidden).then(|| {
            format!(
                "one grey level is {step:.3} photons: steps that coarse can be distinguished by a flexible model, so that the \
                 number may fall below the information; to a Gaussian model their rounding is noise beyond the stated one, so that it may \
                 rise above"
            )
        })
    }
}
