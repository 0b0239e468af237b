//! Sizes of field and PSF grid as values of axes.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::formats::text_form;
use crate::sensor::PatchSize;

/// Rows and columns of a field or of a PSF grid: `64`, `96x128`, or `usual`.
///
/// The usual grid is that of the mask. The usual field is the published one, or three times the PSF grid where that has no room in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(try_from = "String", into = "String")]
pub enum SizeChoice {
    /// The usual size.
    #[default]
    Usual,
    /// Rows and columns in pixels.
    Shape(usize, usize),
}

impl SizeChoice {
    /// Rows and columns in pixels; none for the usual size.
    pub fn shape(self) -> Option<(usize, usize)> {
        match self {
            Self::Shape(rows, cols) => Some((rows, cols)),
            Self::Usual => None,
        }
    }

    /// Whether it is the usual size, which files of cells leave out.
    pub(super) fn is_usual(&self) -> bool {
        *self == Self::Usual
    }
}

impl FromStr for SizeChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "usual" {
            return Ok(Self::Usual);
        }
        let shape = text.parse::<PatchSize>().ok().and_then(PatchSize::shape);
        shape
            .map(|(rows, cols)| Self::Shape(rows, cols))
            .ok_or_else(|| format!("size {text:?}: expected pixels such as 64, rows x cols such as 96x128, or usual"))
    }
}

text_form!(SizeChoice);

impl fmt::Display for SizeChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Shape(rows, cols) => PatchSize::Shape(rows, cols).fmt(f),
            Self::Usual => f.write_str("usual"),
        }
    }
}
