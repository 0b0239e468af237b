//! Lower bound by the pretrained decoder, without a fit.

use serde::{Deserialize, Serialize};

use super::channel::BeadChannel;
use super::fit::{DecoderFit, DecoderProgress};
use super::information_gain::InformationGain;
use super::kind::DecoderKind;
use super::layers::Decoder;
use super::lower_bound::decoder_lower_bound;
use crate::information::error::InformationError;
use crate::progress::Progress;

/// A lower bound by a decoder without any fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct PretrainedLowerBound {
    /// Bits per pixel of the patch.
    pub bits_per_pixel: f64,
    /// 95 % interval over new samples.
    pub interval_95: [f64; 2],
    /// Number of samples.
    pub samples: usize,
}

/// Settings of the test of a decoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecoderTest {
    /// Largest number of samples.
    pub samples: usize,
    /// Half width of the 95 % interval at which the test ends, bits per pixel.
    pub half_width: f64,
    /// Seed of the samples.
    pub seed: u64,
}

impl PretrainedLowerBound {
    /// Tests the pretrained decoder. `None` where the program has no decoder.
    ///
    /// # Errors
    /// As [`decoder_lower_bound`].
    pub fn new(
        channel: &BeadChannel,
        DecoderTest { samples, half_width, seed }: DecoderTest,
        progress: &mut dyn Progress<DecoderProgress>,
    ) -> Result<Option<Self>, InformationError> {
        let Some(decoder) = Decoder::shipped() else { return Ok(None) };
        let fit = DecoderFit {
            half_width,
            max_test: samples,
            unrolled: decoder.unrolled(),
            ..DecoderFit::of_steps(0, DecoderKind::Autoregressive, seed)
        };
        let (bound, _) = decoder_lower_bound(channel, &fit, Some(decoder), None, progress)?;
        let (bits_per_pixel, interval_95) = (bound.bits_per_pixel, bound.interval_95);
        Ok(Some(Self { bits_per_pixel, interval_95, samples: bound.test_patches }))
    }

    /// The bound from the [information gains](super::decoder_information) of samples.
    pub fn of_savings(savings: Vec<f64>) -> Self {
        let savings = InformationGain(savings);
        let (mean, half_width) = savings.mean_and_half_width();
        let interval_95 = [(mean - half_width).max(0.0), (mean + half_width).max(0.0)];
        Self { bits_per_pixel: mean.max(0.0), interval_95, samples: savings.count() }
    }
}
