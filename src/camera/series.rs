//! Frames for a calibration, in groups of equal light.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::formats::{FormatError, ImageFile, Meaning};
use crate::plural::counted;

/// Frames of one exposure and one light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct FrameGroup {
    /// Name: the sub-folder, the common beginning of the file names, or the exposure in a descriptor.
    pub label: String,
    /// Whether the frames have no light.
    pub is_dark: bool,
    /// Exposure time in nanoseconds, or null where it is unknown.
    pub exposure_ns: Option<f64>,
    /// Mean number of photons that reach a pixel during the exposure, or null where it is unknown.
    pub photons: Option<f64>,
    /// Files of the group. A file may hold several frames.
    pub files: Vec<PathBuf>,
}

impl FrameGroup {
    /// The exposure time with a unit, such as `12.5 ms`; `None` where it is unknown.
    pub fn exposure_text(&self) -> Option<String> {
        self.exposure_ns.map(exposure_text)
    }
}

/// How the groups were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Grouping {
    /// By the lines of a descriptor file.
    Descriptor,
    /// By sub-folders.
    Folders,
    /// By the common beginnings of file names.
    Names,
}

impl fmt::Display for Grouping {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Descriptor => "the lines of the descriptor",
            Self::Folders => "sub-folders",
            Self::Names => "file names",
        })
    }
}

/// A photon transfer series: frames in the dark and at several light levels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct FrameSeries {
    /// The folder or descriptor file.
    pub path: PathBuf,
    /// How the groups were found.
    pub grouping: Grouping,
    /// Bit depth that the descriptor states, or null.
    pub bits: Option<u32>,
    /// Rows and columns that the descriptor states, or null.
    pub shape: Option<(usize, usize)>,
    /// The groups, dark ones first.
    pub groups: Vec<FrameGroup>,
    /// Interpretation of the files that the path of a folder states.
    #[serde(skip)]
    pub meaning: Meaning,
    /// Sentences on names that were not understood.
    #[serde(skip)]
    pub notes: Vec<String>,
}

impl FrameSeries {
    /// A file of the series with its interpretation. A path of a descriptor may have options of its own.
    pub(super) fn image_file(&self, path: &Path) -> Result<ImageFile, FormatError> {
        if self.meaning == Meaning::default() {
            ImageFile::find(path)
        } else {
            Ok(ImageFile { path: path.to_path_buf(), meaning: self.meaning.clone() })
        }
    }

    /// Summary of the groups, a line each.
    pub fn lines(&self) -> Vec<String> {
        let mut lines =
            vec![format!("{}: {} by {}", self.path.display(), counted(self.groups.len(), "group"), self.grouping)];
        lines.extend(self.groups.iter().map(|group| {
            let kind = if group.is_dark { "dark" } else { "light" };
            let exposure = group.exposure_text().map_or(String::new(), |text| format!(", {text}"));
            let photons = group.photons.map_or(String::new(), |photons| format!(", {photons} photons"));
            format!("  {kind:5} {}: {}{exposure}{photons}", group.label, counted(group.files.len(), "file"))
        }));
        lines.extend(self.notes.iter().map(|note| format!("  note: {note}")));
        lines
    }
}

/// An exposure time with a unit: `12.5 ms`.
pub(super) fn exposure_text(ns: f64) -> String {
    let (value, unit) = match ns {
        ns if ns >= 1e9 => (ns / 1e9, "s"),
        ns if ns >= 1e6 => (ns / 1e6, "ms"),
        ns if ns >= 1e3 => (ns / 1e3, "us"),
        ns => (ns, "ns"),
    };
    format!("{} {unit}", (value * 1e4).round() / 1e4)
}
