//! Names of object sets, as text.

use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::ObjectError;
use crate::formats::{ImageFile, image_files, path_text, split_kind, text_form};

/// Largest number of depth planes of a volume.
const MOST_PLANES: usize = 64;
const CHOICES: &str = "beads:0.02, beads-max:0.05, volume:5:0.02, idx:FILE, cifar:FILE, images:FOLDER or stack:FILE";

/// Source of objects. Each variant gives its text form (`Display`, `FromStr`, serde).
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let source: ObjectSource = "volume:5:0.02".parse()?;
/// assert_eq!(source, ObjectSource::Volume { planes: 5, density: 0.02 });
/// assert_eq!(source.to_string(), "volume:5:0.02");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema), schemars(extend("examples" = ["beads:0.02", "idx:FILE"])))]
#[serde(try_from = "String", into = "String")]
pub enum ObjectSource {
    /// `beads:0.02`: blurred point sources on this share of the pixels, scaled to a mean photon count over the set.
    Beads {
        /// Share of pixels that hold a bead, above 0 and at most 1.
        density: f64,
    },
    /// `beads-max:0.05`: the same beads with a constant photon count per bead.
    BeadsMax {
        /// Share of pixels that hold a bead, above 0 and at most 1.
        density: f64,
    },
    /// `volume:5:0.02`: independent depth planes of beads, scaled to a mean photon count over all voxels.
    Volume {
        /// Number of depth planes, 1 to 64.
        planes: usize,
        /// Share of pixels of each plane that hold a bead, above 0 and at most 1.
        density: f64,
    },
    /// `idx:FILE`: mosaics of the images of an IDX file (MNIST, Fashion-MNIST), plain or gzipped.
    Idx(PathBuf),
    /// `cifar:FILE`: mosaics of the images of a CIFAR-10 binary batch.
    Cifar(PathBuf),
    /// `images:FOLDER` or `images:FILE`: images, scaled to the field or tiled to mosaics if small.
    Images(PathBuf),
    /// `stack:FILE`: whole objects of any shape from an NPY, NPZ or TIFF file.
    Stack(PathBuf),
}

impl ObjectSource {
    /// The most likely source of a dropped or typed path, by its name. Reading the file reveals a wrong guess. A path
    /// with a kind, such as `stack:FILE`, has that kind.
    pub fn guess(path: &Path) -> Self {
        let file = match ImageFile::find(path) {
            Ok(found) => found.path,
            // An error about a missing file names the path.
            Err(_) => match Self::from_os(path.as_os_str()) {
                Ok(named) => return named,
                Err(_) => path.to_path_buf(),
            },
        };
        let name = file.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
        let ends = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
        let is_image = file.is_dir() || ends(&[".png", ".jpg", ".jpeg", ".bmp"]);
        let path = path.to_path_buf();
        if is_image {
            Self::Images(path)
        } else if ends(&[".npy", ".npz", ".tif", ".tiff"]) {
            Self::Stack(path)
        } else if ends(&[".bin"]) {
            Self::Cifar(path)
        } else if ends(&[".gz", ".idx", "-ubyte"]) || name.contains("idx") {
            Self::Idx(path)
        } else {
            Self::Images(path)
        }
    }
}

impl ObjectSource {
    /// Whether the objects are read from files, which may change.
    pub fn is_read(&self) -> bool {
        self.path().is_some()
    }

    /// Its file or folder, with options.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Self::Idx(path) | Self::Cifar(path) | Self::Images(path) | Self::Stack(path) => Some(path),
            Self::Beads { .. } | Self::BeadsMax { .. } | Self::Volume { .. } => None,
        }
    }

    /// Files of the source. A folder gives its images; a folder that cannot be read gives none.
    pub fn files(&self) -> Vec<PathBuf> {
        let Some(path) = self.path() else { return Vec::new() };
        image_files(path)
            .map_or_else(|_| vec![path.to_path_buf()], |files| files.into_iter().map(|file| file.path).collect())
    }

    /// The same source with an absolute path.
    #[must_use]
    pub fn absolute(&self) -> Self {
        let whole = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        match self {
            Self::Idx(path) => Self::Idx(whole(path)),
            Self::Cifar(path) => Self::Cifar(whole(path)),
            Self::Images(path) => Self::Images(whole(path)),
            Self::Stack(path) => Self::Stack(whole(path)),
            drawn => drawn.clone(),
        }
    }

    /// Whether the mean of the objects can be chosen. Otherwise the beads determine it.
    pub fn has_mean(&self) -> bool {
        !matches!(self, Self::BeadsMax { .. })
    }

    /// Whether the objects are beads at random places. Their prior is known.
    pub fn is_beads(&self) -> bool {
        match self {
            Self::Beads { density } | Self::BeadsMax { density } | Self::Volume { density, .. } => *density < 1.0,
            Self::Idx(_) | Self::Cifar(_) | Self::Images(_) | Self::Stack(_) => false,
        }
    }
}

impl fmt::Display for ObjectSource {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Beads { density } => write!(formatter, "beads:{density}"),
            Self::BeadsMax { density } => write!(formatter, "beads-max:{density}"),
            Self::Volume { planes, density } => write!(formatter, "volume:{planes}:{density}"),
            Self::Idx(path) => write!(formatter, "idx:{}", path_text(path)),
            Self::Cifar(path) => write!(formatter, "cifar:{}", path_text(path)),
            Self::Images(path) => write!(formatter, "images:{}", path_text(path)),
            Self::Stack(path) => write!(formatter, "stack:{}", path_text(path)),
        }
    }
}

impl FromStr for ObjectSource {
    type Err = ObjectError;

    fn from_str(text: &str) -> Result<Self, ObjectError> {
        Self::from_os(OsStr::new(text))
    }
}

impl ObjectSource {
    /// Reads a source from text. The text need not be UTF-8, because paths need not be.
    ///
    /// # Errors
    /// [`ObjectError::Source`], with the choices, where the text names no source.
    pub fn from_os(text: &OsStr) -> Result<Self, ObjectError> {
        let name = || text.to_string_lossy().into_owned();
        let wrong =
            |expected: &str, found: String| ObjectError::Source { text: name(), expected: expected.into(), found };
        let Some((kind, path)) = split_kind(text) else {
            let found = match ImageFile::find(Path::new(text)) {
                Ok(_) => format!("a path; try {}", Self::guess(Path::new(text))),
                Err(_) => "no colon".into(),
            };
            return Err(wrong(CHOICES, found));
        };
        let rest = path.to_string_lossy().into_owned();
        let density = |text: &str| match text.trim().parse::<f64>() {
            Ok(density) if density > 0.0 && density <= 1.0 => Ok(density),
            _ => Err(wrong("a density above 0 and at most 1, such as 0.02", format!("\"{text}\""))),
        };
        let path = || match rest.trim() {
            "" => Err(wrong("a file or folder after the colon", "nothing".into())),
            _ => Ok(path.clone()),
        };
        match kind.trim() {
            "beads" => Ok(Self::Beads { density: density(&rest)? }),
            "beads-max" => Ok(Self::BeadsMax { density: density(&rest)? }),
            "volume" => {
                let (planes, rest) = rest.split_once(':').unwrap_or((&rest, ""));
                let planes = match planes.trim().parse() {
                    Ok(planes) if (1..=MOST_PLANES).contains(&planes) => planes,
                    _ => {
                        let expected = format!("1 to {MOST_PLANES} planes and a density, such as volume:5:0.02");
                        return Err(wrong(&expected, format!("\"{planes}\"")));
                    }
                };
                Ok(Self::Volume { planes, density: density(rest)? })
            }
            "idx" => path().map(Self::Idx),
            "cifar" => path().map(Self::Cifar),
            "images" => path().map(Self::Images),
            "stack" => path().map(Self::Stack),
            kind => Err(wrong(CHOICES, format!("the kind \"{kind}\""))),
        }
    }
}

text_form!(ObjectSource);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_source_are_one() {
        for text in [
            "beads:0.02",
            "beads-max:1",
            "volume:5:0.008",
            "idx:train images.gz",
            "cifar:C:\\data\\b.bin",
            "images:.",
            "stack:a.npy",
        ] {
            let source: ObjectSource = text.parse().unwrap();
            assert_eq!(source.to_string(), text);
            let json = serde_json::to_string(&source).unwrap();
            assert_eq!(json, serde_json::to_string(text).unwrap());
            assert_eq!(serde_json::from_str::<ObjectSource>(&json).unwrap(), source);
        }
    }

    #[test]
    fn names_are_guessed_from_and_folders_hold_images() {
        let folder = tempfile::tempdir().unwrap();
        let photos = folder.path().join("idx_photos");
        std::fs::create_dir(&photos).unwrap();
        assert_eq!(ObjectSource::guess(&photos), ObjectSource::Images(photos));
        for (name, of) in [
            ("idx_01.png", ObjectSource::Images as fn(PathBuf) -> ObjectSource),
            ("t10k-images-idx3-ubyte", ObjectSource::Idx),
            ("t10k-images-idx3-ubyte.gz", ObjectSource::Idx),
            ("Stack.TIFF", ObjectSource::Stack),
            ("test_batch.bin", ObjectSource::Cifar),
        ] {
            assert_eq!(ObjectSource::guess(Path::new(name)), of(name.into()));
            assert_eq!(ObjectSource::guess(Path::new(&format!("idx:{name}"))), ObjectSource::Idx(name.into()));
        }
        assert_eq!(ObjectSource::guess(Path::new("beads:0.5")), ObjectSource::Beads { density: 0.5 });
    }

    #[test]
    fn a_path_without_its_kind_is_answered_with_the_likely_one() {
        let folder = tempfile::tempdir().unwrap();
        let stack = folder.path().join("stack.npy");
        std::fs::write(&stack, []).unwrap();
        let answer = stack.display().to_string().parse::<ObjectSource>().unwrap_err().to_string();
        assert!(answer.ends_with(&format!("try stack:{}", stack.display())), "{answer}");
    }

    #[test]
    fn mistakes_are_answered_with_the_choices() {
        for (text, answer) in [
            ("mnist", "beads:0.02"),
            ("bead:0.02", "the kind \"bead\""),
            ("beads:0", "above 0 and at most 1"),
            ("beads:1.5", "above 0"),
            ("beads:NaN", "above 0"),
            ("beads:", "above 0"),
            ("volume:5", "above 0"),
            ("volume:0:0.02", "1 to 64 planes"),
            ("idx: ", "a file or folder"),
        ] {
            let error = text.parse::<ObjectSource>().unwrap_err().to_string();
            assert!(error.contains(answer) && error.contains(text), "{error}");
        }
    }
}
