//! A decoder as a value of an axis.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::formats::text_form;
use crate::reconstruction::DecoderKind;

/// A decoder of a plan, or none. Its text form is `none` or a name of `--decoder` (`Display`, `FromStr`, serde).
///
/// ```
/// use lenslet_studio::reconstruction::DecoderKind;
/// use lenslet_studio::studies::plans::StudyDecoder;
///
/// assert_eq!("tv".parse(), Ok(StudyDecoder::Kind(DecoderKind::TotalVariation)));
/// assert_eq!(StudyDecoder::Absent.to_string(), "none");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum StudyDecoder {
    /// `none`: information alone.
    Absent,
    /// A decoder whose image quality the cell reports.
    Kind(DecoderKind),
}

impl StudyDecoder {
    /// `none`, and all decoders in the order of the menu.
    pub fn all() -> impl Iterator<Item = Self> {
        std::iter::once(Self::Absent).chain(DecoderKind::ALL.map(Self::Kind))
    }

    /// The decoder, where there is one.
    pub fn kind(self) -> Option<DecoderKind> {
        match self {
            Self::Absent => None,
            Self::Kind(kind) => Some(kind),
        }
    }
}

impl From<Option<DecoderKind>> for StudyDecoder {
    fn from(kind: Option<DecoderKind>) -> Self {
        kind.map_or(Self::Absent, Self::Kind)
    }
}

impl FromStr for StudyDecoder {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::all().find(|decoder| decoder.to_string() == text).ok_or_else(|| {
            let names: Vec<String> = Self::all().map(|decoder| decoder.to_string()).collect();
            format!("decoder {text:?}: expected one of {}", names.join(", "))
        })
    }
}

text_form!(StudyDecoder);

impl fmt::Display for StudyDecoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => f.write_str("none"),
            // The serialized name is the one of the command line.
            Self::Kind(kind) => kind.serialize(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_forms_are_those_of_the_command_line() {
        let names: Vec<String> = StudyDecoder::all().map(|decoder| decoder.to_string()).collect();
        assert_eq!(names, ["none", "linear", "posterior", "tv", "network", "unet", "richardson-lucy"]);
        assert!(StudyDecoder::all().all(|decoder| decoder.to_string().parse() == Ok(decoder)));
        assert!("magic".parse::<StudyDecoder>().unwrap_err().contains("expected one of none, linear"));
    }
}
