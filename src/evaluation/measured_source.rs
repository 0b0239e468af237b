//! Location of camera images.

use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::evaluation::measured_error::MeasuredError;
use crate::formats::path_text;
use crate::objects::ObjectSource;

/// Location of measurements: a file or a folder, also written `stack:FILE` or `images:FOLDER`.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let source: MeasuredSource = "images:captures".parse()?;
/// assert_eq!(source, "captures".parse()?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct MeasuredSource(PathBuf);

impl FromStr for MeasuredSource {
    type Err = MeasuredError;

    fn from_str(text: &str) -> Result<Self, MeasuredError> {
        Self::from_os(OsStr::new(text))
    }
}

impl MeasuredSource {
    /// Parses the measurements of a text that need not be UTF-8, as paths need not be.
    ///
    /// # Errors
    /// [`MeasuredError::Source`] where it names none.
    pub fn from_os(text: &OsStr) -> Result<Self, MeasuredError> {
        let wrong = || MeasuredError::Source { text: text.to_string_lossy().into_owned() };
        match ObjectSource::from_os(text) {
            Ok(ObjectSource::Stack(path) | ObjectSource::Images(path)) => Ok(Self(path)),
            // A path with a colon that names no kind of objects.
            Err(_) if !text.as_encoded_bytes().trim_ascii().is_empty() => Ok(Self(text.into())),
            _ => Err(wrong()),
        }
    }
}

impl From<String> for MeasuredSource {
    fn from(path: String) -> Self {
        Self(path.into())
    }
}

impl From<MeasuredSource> for String {
    fn from(source: MeasuredSource) -> Self {
        path_text(&source.0)
    }
}

impl MeasuredSource {
    /// The file or folder, with its options.
    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// The same source by an absolute path.
    pub(crate) fn absolute(&self) -> Self {
        Self(std::path::absolute(&self.0).unwrap_or_else(|_| self.0.clone()))
    }
}

impl From<PathBuf> for MeasuredSource {
    fn from(path: PathBuf) -> Self {
        Self(path)
    }
}

impl fmt::Display for MeasuredSource {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&path_text(&self.0))
    }
}
