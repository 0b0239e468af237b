//! Names of masks, as text.

use std::ffi::OsStr;
use std::fmt;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::formats::{path_text, split_kind, text_form};
use crate::forward::{Design, DesignFileError};
use crate::objects::ObjectSource;
use crate::optics::{
    Diffuser, Encoder, LensletArray, LensletFitError, PsfError, PsfPhotograph, depth_layout, fit_lenslets,
    heuristic_layout, import_psf, psf_file, random_layout,
};

const CHOICES: &str =
    "heuristic:1 to 9, random:COUNT, depth:1 to 5, diffuser:APERTURE, psf:FILE, fit:FILE, or design:FILE";
/// Most lenslets and planes of a depth layout.
const MOST_DEPTH: usize = 5;

/// A mask by its name. Each variant gives its text form (`Display`, `FromStr`, serde).
///
/// ```
/// use lenslet_studio::forward::MaskSource;
///
/// let source: MaskSource = "heuristic:9".parse()?;
/// assert_eq!(source, MaskSource::Heuristic(9));
/// let objects = "beads:0.02".parse()?;
/// assert_eq!(source.mask(1, &objects, None)?.encoder.psf(1)?.dim(), (1, 32, 32));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum MaskSource {
    /// `heuristic:9`: the published layout of 1 to 9 lenslets.
    Heuristic(usize),
    /// `random:25`: lenslets at random places, drawn with the seed of the design.
    Random(usize),
    /// `depth:3`: 1 to 5 lenslets, each in focus at its own depth plane of the objects; see [`depth_layout`].
    Depth(usize),
    /// `diffuser:32`: a diffuser behind a square aperture of this side in pixels, drawn with the seed of the design. The
    /// aperture blocks the light outside.
    Diffuser(usize),
    /// `psf:FILE`, resampled to the given side in pixels (also written `psf:FILE@32`). The path may hold options of the
    /// import: see [`PsfImportOptions`](crate::optics::PsfImportOptions).
    Psf(PathBuf, Option<usize>),
    /// `fit:FILE`: lenslets fitted to the PSF image, resampled as for `psf:`.
    Fit(PathBuf, Option<usize>),
    /// `design:FILE`: the mask of a design file.
    Design(PathBuf),
}

/// A mask, and what was understood of its file.
#[derive(Clone, Debug)]
pub struct OpenedMask {
    /// The mask.
    pub encoder: Encoder,
    /// Sentences about the file that the mask was read from, for people.
    pub notices: Vec<String>,
}

/// Reason why a text names no mask, or its mask cannot be made.
#[derive(Debug, Error)]
pub enum MaskError {
    /// The text names no mask.
    #[error("mask \"{text}\": expected {expected}")]
    Name {
        /// The text.
        text: String,
        /// The names that there are.
        expected: String,
    },
    /// The pixels of the mask are given.
    #[error(
        "--grid {side}: expected lenslets, a diffuser or --mask psf:FILE, found {mask}; name its file with --mask psf:FILE"
    )]
    NoGrid {
        /// The side, pixels.
        side: usize,
        /// The mask.
        mask: String,
    },
    /// The side is named twice.
    #[error("--grid {side}: expected a --mask without @, found {}@; leave one of them out", .file.display())]
    TwoSides {
        /// The side, pixels.
        side: usize,
        /// File of the mask.
        file: PathBuf,
    },
    /// The PSF image.
    #[error(transparent)]
    Psf(#[from] PsfError),
    /// The lenslets of a PSF image.
    #[error(transparent)]
    Fit(#[from] LensletFitError),
    /// The design file.
    #[error(transparent)]
    Design(#[from] DesignFileError),
}

impl MaskSource {
    /// Its file, with options.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Self::Psf(path, _) | Self::Fit(path, _) | Self::Design(path) => Some(path),
            Self::Heuristic(_) | Self::Random(_) | Self::Depth(_) | Self::Diffuser(_) => None,
        }
    }

    /// The mask of a text that need not be UTF-8, as paths need not be.
    ///
    /// # Errors
    /// [`MaskError`] lists the names that there are.
    pub fn from_os(text: &OsStr) -> Result<Self, MaskError> {
        let refused = |expected: String| MaskError::Name { text: text.display().to_string(), expected };
        let wrong = || refused(CHOICES.to_owned());
        let (kind, path) = split_kind(text).ok_or_else(wrong)?;
        let (rest, is_named) = (path.to_string_lossy(), !path.as_os_str().is_empty());
        let count = |range: RangeInclusive<usize>| match rest.parse::<usize>() {
            Ok(count) if range.contains(&count) => Ok(count),
            _ => Err(refused(format!("{} to {} after {kind}:", range.start(), range.end()))),
        };
        Ok(match kind {
            "heuristic" => Self::Heuristic(count(1..=9)?),
            "random" => Self::Random(count(1..=LensletArray::MAX_LENSLETS)?),
            "depth" => Self::Depth(count(1..=MOST_DEPTH)?),
            "diffuser" => Self::Diffuser(count(1..=Diffuser::GRID)?),
            "psf" if is_named => psf_file(&path).map(|(path, side)| Self::Psf(path, side))?,
            "fit" if is_named => psf_file(&path).map(|(path, side)| Self::Fit(path, side))?,
            "design" if is_named => Self::Design(path),
            _ => return Err(wrong()),
        })
    }

    /// The same mask with an absolute path.
    #[must_use]
    pub fn absolute(&self) -> Self {
        let whole = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        match self {
            Self::Psf(path, side) => Self::Psf(whole(path), *side),
            Self::Fit(path, side) => Self::Fit(whole(path), *side),
            Self::Design(path) => Self::Design(whole(path)),
            made => made.clone(),
        }
    }

    /// File of the mask.
    pub fn file(&self) -> Option<PathBuf> {
        match self {
            Self::Psf(path, _) | Self::Fit(path, _) => {
                Some(PsfPhotograph::find(path).map_or_else(|_| path.clone(), |photograph| photograph.file.path))
            }
            Self::Design(path) => Some(path.clone()),
            Self::Heuristic(_) | Self::Random(_) | Self::Depth(_) | Self::Diffuser(_) => None,
        }
    }

    /// Makes or reads the mask. Random masks are drawn with `seed`. Lenslets in depth focus on the planes of `objects`, up
    /// to five; before objects that are no volume they have the published planes of five.
    ///
    /// The names stand for layouts on the published grid of 32 x 32 px; `grid` is another one, (rows, cols). Positions and
    /// apertures keep their share of it, and widths stay in pixels. PSF images are resampled to a square grid, and keep their own
    /// pixels without one.
    ///
    /// # Errors
    /// [`MaskError`] where its file cannot be read, no lenslets can be fitted, or its grid is named twice.
    pub fn mask(
        &self,
        seed: u64,
        objects: &ObjectSource,
        grid: Option<(usize, usize)>,
    ) -> Result<OpenedMask, MaskError> {
        let made = |encoder| Ok(OpenedMask { encoder: on_grid(encoder, grid)?, notices: Vec::new() });
        let image = |path: &Path, side: Option<usize>| match (grid, side) {
            (Some((side, _)), Some(_)) => Err(MaskError::TwoSides { side, file: path.to_owned() }),
            (grid, side) => image_of(path, side.or(grid.map(|(rows, _)| rows))),
        };
        match self {
            Self::Heuristic(count) => made(Encoder::Lenslets(heuristic_layout(*count))),
            Self::Random(count) => made(Encoder::Lenslets(random_layout(*count, seed))),
            Self::Depth(count) => made(Encoder::Lenslets(depth_layout(*count, planes_of(objects)))),
            Self::Diffuser(aperture_px) => made(Encoder::Diffuser(Diffuser::behind_aperture(*aperture_px, seed))),
            Self::Design(path) => made(Design::open(path)?.encoder),
            Self::Psf(path, side) => image(path, *side),
            Self::Fit(path, side) => {
                let OpenedMask { encoder, mut notices } = image(path, *side)?;
                let fitted = fit_lenslets(&encoder)?;
                notices.push(format!("{}: {}", path.display(), fitted.summary()));
                Ok(OpenedMask { encoder: Encoder::Lenslets(fitted.array), notices })
            }
        }
    }
}

/// The mask on another grid, where one is given.
///
/// # Errors
/// [`MaskError::NoGrid`] for a PSF image of another shape.
pub fn on_grid(encoder: Encoder, grid: Option<(usize, usize)>) -> Result<Encoder, MaskError> {
    let Some((rows, cols)) = grid else { return Ok(encoder) };
    let mask = encoder.describe();
    encoder.on_grid(rows, cols).ok_or(MaskError::NoGrid { side: rows, mask })
}

/// Planes that a depth layout is made for.
fn planes_of(objects: &ObjectSource) -> usize {
    match objects {
        ObjectSource::Volume { planes, .. } => (*planes).clamp(1, MOST_DEPTH),
        _ => MOST_DEPTH,
    }
}

/// The PSF of an image file.
fn image_of(path: &Path, side: Option<usize>) -> Result<OpenedMask, MaskError> {
    let imported = import_psf(path, side)?;
    let notices = imported.notices();
    Ok(OpenedMask { encoder: Encoder::Image(imported.image), notices })
}

impl FromStr for MaskSource {
    type Err = MaskError;

    fn from_str(text: &str) -> Result<Self, MaskError> {
        Self::from_os(OsStr::new(text))
    }
}

text_form!(MaskSource);

impl fmt::Display for MaskSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let image = |f: &mut fmt::Formatter<'_>, kind: &str, path: &Path, side: &Option<usize>| {
            write!(f, "{kind}:{}", path_text(path))?;
            side.map_or(Ok(()), |side| write!(f, "@{side}"))
        };
        match self {
            Self::Heuristic(count) => write!(f, "heuristic:{count}"),
            Self::Random(count) => write!(f, "random:{count}"),
            Self::Depth(count) => write!(f, "depth:{count}"),
            Self::Diffuser(aperture) => write!(f, "diffuser:{aperture}"),
            Self::Psf(path, side) => image(f, "psf", path, side),
            Self::Fit(path, side) => image(f, "fit", path, side),
            Self::Design(path) => write!(f, "design:{}", path_text(path)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_parsed_from_their_names() {
        for (text, expected) in [
            ("heuristic:9", MaskSource::Heuristic(9)),
            ("random:25", MaskSource::Random(25)),
            ("psf:a/b.npy", MaskSource::Psf("a/b.npy".into(), None)),
            ("psf:me@lab/psf.npy", MaskSource::Psf("me@lab/psf.npy".into(), None)),
            ("psf:a@b.png@48", MaskSource::Psf("a@b.png".into(), Some(48))),
            (
                "psf:a.tif?dark=corners&window=1,2,3,4@32",
                MaskSource::Psf("a.tif?dark=corners&window=1,2,3,4".into(), Some(32)),
            ),
            ("depth:3", MaskSource::Depth(3)),
            ("diffuser:16", MaskSource::Diffuser(16)),
            ("design:a.json", MaskSource::Design("a.json".into())),
        ] {
            assert_eq!(text.parse::<MaskSource>().unwrap(), expected);
            assert_eq!(expected.to_string(), text);
        }
        for wrong in ["", "9", "heuristic:0", "heuristic:10", "depth:6", "random:x", "psf:", "psf:a@0", "lens:1"] {
            assert!(wrong.parse::<MaskSource>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn lenslets_in_depth_focus_on_the_planes_of_the_objects() {
        let planes = |objects: &str| {
            let mask = MaskSource::Depth(3).mask(1, &objects.parse().unwrap(), None).unwrap().encoder;
            mask.lenslets().unwrap().lenslets.iter().map(|lenslet| lenslet.plane).collect::<Vec<_>>()
        };
        assert_eq!(planes("volume:2:0.02"), [1, 0, 2]);
        assert_eq!([planes("volume:5:0.02"), planes("volume:9:0.02"), planes("beads:0.02")], [[2, 0, 4]; 3]);
    }

    #[test]
    fn presets_scale_to_another_grid_and_images_keep_theirs() {
        let objects = "beads:0.02".parse().unwrap();
        let mask =
            |text: &str, grid| text.parse::<MaskSource>().unwrap().mask(1, &objects, grid).map(|mask| mask.encoder);
        for text in ["heuristic:4", "random:5", "depth:3", "diffuser:16"] {
            let published = mask(text, None).unwrap();
            assert_eq!(mask(text, Some((32, 32))).unwrap(), published);
            let scaled = mask(text, Some((64, 64))).unwrap();
            assert_eq!((published.grid(), scaled.grid()), ((32, 32), (64, 64)));
            assert!((scaled.psf(1).unwrap().dim(), published.psf(1).unwrap().dim()) == ((1, 64, 64), (1, 32, 32)));
        }
        let Encoder::Lenslets(array) = mask("heuristic:2", Some((64, 96))).unwrap() else { panic!("lenslets") };
        let lenslet = array.lenslets[1];
        assert_eq!((lenslet.x, lenslet.y, lenslet.spot.mean_sigma()), (28.0, 14.5, 0.8));
        let Encoder::Diffuser(diffuser) = mask("diffuser:16", Some((64, 64))).unwrap() else { panic!("a diffuser") };
        assert!(diffuser.aperture_px == 32 && (0.05..0.6).contains(&diffuser.throughput), "{diffuser:?}");
        let twice = mask("psf:a.npy@8", Some((16, 16))).unwrap_err().to_string();
        assert_eq!(twice, "--grid 16: expected a --mask without @, found a.npy@; leave one of them out");
    }
}
