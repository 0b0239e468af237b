//! The estimators by name.

use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

/// The density model behind an estimate. The serialised names are stable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// Gaussian with one mean and a covariance by lag, fitted to patches.
    GaussianStationary,
    /// Gaussian with a mean per pixel and a full covariance, fitted to patches.
    GaussianFull,
    /// Gaussian of the exact covariance, without samples.
    GaussianAnalytic,
    /// The published autoregressive network, fitted to patches.
    #[serde(rename = "pixelcnn")]
    PixelCnn,
    /// Causal density model over clean levels, fitted for as long as one waits.
    Live,
    /// The same, fitted until it gains no more.
    Full,
    /// The smallest of a live estimate, the Gaussian bound and the ceiling, beside a decoder's lower bound.
    Bracket,
}

impl Estimator {
    /// Whether it is of the program's own density model, which can begin with weights that come with the program.
    pub fn begins_with_weights(self) -> bool {
        matches!(self, Self::Live | Self::Full | Self::Bracket)
    }

    /// Time for a fit where nothing else is asked for; none for estimators that are not fitted for a time.
    pub fn usual_budget(self) -> Option<Duration> {
        match self {
            Self::GaussianStationary | Self::GaussianFull | Self::GaussianAnalytic => None,
            Self::Live => Some(Duration::from_mins(1)),
            Self::PixelCnn | Self::Bracket => Some(Duration::from_mins(5)),
            Self::Full => Some(Duration::from_mins(30)),
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
            Self::Live => "live",
            Self::Full => "full",
            Self::Bracket => "bracket",
        })
    }
}
