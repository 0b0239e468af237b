//! The two kinds of decoder.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Inputs of a decoder besides the measurement. The serialised names are stable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DecoderKind {
    /// Nothing: every site has its own probability.
    Factorised,
    /// The sites before it, in random order.
    Autoregressive,
}

impl fmt::Display for DecoderKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Factorised => "factorised",
            Self::Autoregressive => "autoregressive",
        })
    }
}
