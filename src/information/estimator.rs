//! Names of the estimators and their default budgets.

use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

/// Estimator of the information. The serialised names are stable.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let request = EstimateRequest::new(Estimator::Causal);
/// assert!(Estimator::Causal.default_budget() < Estimator::Bracket.default_budget());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// Gaussian with one mean and a covariance by lag, fitted to patches. Plans may call it `gaussian`, as the flag does.
    #[serde(alias = "gaussian")]
    GaussianStationary,
    /// Gaussian with a mean per pixel and a full covariance, fitted to patches.
    GaussianFull,
    /// Gaussian of the exact covariance, without samples.
    GaussianAnalytic,
    /// The published autoregressive network, fitted to patches.
    #[serde(rename = "pixelcnn")]
    PixelCnn,
    /// Causal density model: a mixture of the noise around a grid of intensities. Files of older versions call it `live` or
    /// `full`, by the length of its fit.
    #[serde(alias = "live", alias = "full")]
    Causal,
    /// Lower bounds by a decoder and AIS; upper bounds by the causal model, the Gaussian bound, the object-entropy bound and
    /// AIS.
    Bracket,
}

impl Estimator {
    /// Whether fits start from pretrained weights by default.
    pub fn has_pretrained_weights(self) -> bool {
        matches!(self, Self::Causal | Self::Bracket)
    }

    /// Default time of a fit; `None` for estimators whose fit has no time budget.
    pub fn default_budget(self) -> Option<Duration> {
        match self {
            Self::GaussianStationary | Self::GaussianFull | Self::GaussianAnalytic => None,
            Self::Causal => Some(Duration::from_mins(1)),
            Self::PixelCnn | Self::Bracket => Some(Duration::from_mins(5)),
        }
    }
}

impl fmt::Display for Estimator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::GaussianStationary => "gaussian-stationary",
            Self::GaussianFull => "gaussian-full",
            Self::GaussianAnalytic => "gaussian-analytic",
            Self::PixelCnn => "pixelcnn",
            Self::Causal => "causal",
            Self::Bracket => "bracket",
        })
    }
}
