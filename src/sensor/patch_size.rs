//! Size of a patch, as text.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::formats::text_form;

/// Rows and columns of a patch: `32`, `16x24`, or `sensor` for the whole measurement.
///
/// ```
/// use lenslet_studio::sensor::PatchSize;
///
/// assert_eq!("16x24".parse::<PatchSize>()?.shape(), Some((16, 24)));
/// assert_eq!("sensor".parse::<PatchSize>()?.shape(), None);
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(try_from = "String", into = "String")]
pub enum PatchSize {
    /// Rows and columns in pixels.
    Shape(usize, usize),
    /// The whole measurement.
    Sensor,
}

impl PatchSize {
    /// Rows and columns in pixels; none for the whole measurement.
    pub fn shape(self) -> Option<(usize, usize)> {
        match self {
            Self::Shape(rows, cols) => Some((rows, cols)),
            Self::Sensor => None,
        }
    }
}

impl FromStr for PatchSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| text.parse::<usize>().ok().filter(|&side| side > 0);
        let shape = match text.split_once('x') {
            _ if text == "sensor" => return Ok(Self::Sensor),
            Some((rows, cols)) => side(rows).zip(side(cols)),
            None => side(text).map(|side| (side, side)),
        };
        shape
            .map(|(rows, cols)| Self::Shape(rows, cols))
            .ok_or_else(|| format!("patch {text:?}: expected pixels such as 32, rows x cols such as 16x24, or sensor"))
    }
}

text_form!(PatchSize);

impl fmt::Display for PatchSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shape(rows, cols) if rows == cols => write!(f, "{rows}"),
            Self::Shape(rows, cols) => write!(f, "{rows}x{cols}"),
            Self::Sensor => f.write_str("sensor"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_are_parsed_from_their_names() {
        for (text, expected) in
            [("32", PatchSize::Shape(32, 32)), ("16x24", PatchSize::Shape(16, 24)), ("sensor", PatchSize::Sensor)]
        {
            assert_eq!(text.parse(), Ok(expected));
            assert_eq!(expected.to_string(), text);
        }
        for wrong in ["0", "x", "", "3x", "1e3"] {
            assert!(wrong.parse::<PatchSize>().is_err(), "{wrong}");
        }
    }
}
