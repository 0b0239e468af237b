//! Argument types of the command line: masks, patches, estimators, budgets.

use std::ffi::OsStr;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::{Args, ValueEnum};

use super::output;
use crate::evaluation::{EvaluationError, MeasuredSource};
use crate::formats::{ImageFile, split_kind};
use crate::forward::{Design, ForwardError};
use crate::information::Estimator;
use crate::objects::ObjectSource;
use crate::optics::{
    Diffuser, Encoder, PsfImage, depth_layout, fit_lenslets, heuristic_layout, import_psf, psf_file, random_layout,
};

/// Mask named by `--mask`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EncoderChoice {
    /// `heuristic:9`
    Heuristic(usize),
    /// `random:25`, with the seed of `--seed`.
    Random(usize),
    /// `depth:5`
    Depth(usize),
    /// `diffuser:32`, with the seed of `--seed`.
    Diffuser(usize),
    /// `psf:FILE`, resampled to the given side in pixels (also written `psf:FILE@32`).
    Psf(PathBuf, Option<usize>),
    /// `fit:FILE`: lenslets fitted to the PSF image, resampled as for `psf:`.
    Fit(PathBuf, Option<usize>),
    /// `design:FILE`: the mask of a design file.
    Design(PathBuf),
}

impl EncoderChoice {
    /// File of the mask.
    pub fn file(&self) -> Option<PathBuf> {
        match self {
            Self::Psf(path, _) | Self::Fit(path, _) => {
                Some(ImageFile::find(path).map_or_else(|_| path.clone(), |file| file.path))
            }
            Self::Design(path) => Some(path.clone()),
            Self::Heuristic(_) | Self::Random(_) | Self::Depth(_) | Self::Diffuser(_) => None,
        }
    }
}

/// Reads an encoder from an argument, which need not be UTF-8, as paths need not be.
pub fn encoder_argument() -> impl TypedValueParser<Value = EncoderChoice> {
    OsStringValueParser::new().try_map(|text| EncoderChoice::from_os(&text))
}

/// Reads objects from an argument.
pub fn objects_argument() -> impl TypedValueParser<Value = ObjectSource> {
    OsStringValueParser::new().try_map(|text| ObjectSource::from_os(&text))
}

/// Reads measurements from an argument.
pub fn measurements_argument() -> impl TypedValueParser<Value = MeasuredSource> {
    OsStringValueParser::new().try_map(|text| MeasuredSource::from_os(&text))
}

const CHOICES: &str =
    "heuristic:1 to 9, random:COUNT, depth:1 to 5, diffuser:APERTURE, psf:FILE, fit:FILE, or design:FILE";

impl FromStr for EncoderChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::from_os(OsStr::new(text))
    }
}

impl EncoderChoice {
    /// Encoder of a text that need not be UTF-8.
    fn from_os(text: &OsStr) -> Result<Self, String> {
        let named = text.display();
        let wrong = || format!("mask \"{named}\": expected {CHOICES}");
        let (kind, path) = split_kind(text).ok_or_else(wrong)?;
        let (rest, is_named) = (path.to_string_lossy(), !path.as_os_str().is_empty());
        let image = || psf_file(&path).map_err(|error| error.to_string());
        let count = |range: RangeInclusive<usize>| match rest.parse::<usize>() {
            Ok(count) if range.contains(&count) => Ok(count),
            _ => Err(format!("mask \"{named}\": expected {} to {} after {kind}:", range.start(), range.end())),
        };
        match kind {
            "heuristic" => count(1..=9).map(Self::Heuristic),
            "random" => count(1..=crate::optics::LensletArray::MAX_LENSLETS).map(Self::Random),
            "depth" => count(1..=5).map(Self::Depth),
            "diffuser" => count(1..=Diffuser::GRID).map(Self::Diffuser),
            "psf" if is_named => image().map(|(path, side)| Self::Psf(path, side)),
            "fit" if is_named => image().map(|(path, side)| Self::Fit(path, side)),
            "design" if is_named => Ok(Self::Design(path)),
            _ => Err(wrong()),
        }
    }
}

impl EncoderChoice {
    /// The same mask with its PSF image resampled to `side` pixels (`--resample`).
    ///
    /// # Errors
    /// One sentence where the mask has no PSF image, or names another side already.
    pub fn resampled(&self, side: usize) -> anyhow::Result<Self> {
        match self {
            Self::Psf(path, None) => Ok(Self::Psf(path.clone(), Some(side))),
            Self::Fit(path, None) => Ok(Self::Fit(path.clone(), Some(side))),
            Self::Psf(path, Some(_)) | Self::Fit(path, Some(_)) => {
                bail!(
                    "--resample {side}: expected a --mask without @, found {}@; leave one of them out",
                    path.display()
                )
            }
            _ => bail!("--resample {side}: expected --mask psf:FILE or fit:FILE; leave it out for other masks"),
        }
    }

    /// Makes or reads the encoder. Random masks are drawn with `seed`.
    pub fn encoder(&self, seed: u64) -> anyhow::Result<Encoder> {
        Ok(match self {
            Self::Heuristic(count) => Encoder::Lenslets(heuristic_layout(*count)),
            Self::Random(count) => Encoder::Lenslets(random_layout(*count, seed)),
            Self::Depth(count) => Encoder::Lenslets(depth_layout(*count)),
            Self::Diffuser(aperture_px) => Encoder::Diffuser(Diffuser { aperture_px: *aperture_px, seed }),
            Self::Psf(path, side) => Encoder::Image(import_and_report(path, *side)?),
            Self::Fit(path, side) => {
                let fitted = fit_lenslets(&Encoder::Image(import_and_report(path, *side)?))?;
                output::report(format_args!("{}: {}", path.display(), fitted.in_words()));
                Encoder::Lenslets(fitted.array)
            }
            Self::Design(path) => Design::open(path)?.encoder,
        })
    }
}

/// Reads a PSF and reports how its file was interpreted.
fn import_and_report(path: &Path, side: Option<usize>) -> anyhow::Result<PsfImage> {
    let (image, understood) = import_psf(path, side)?;
    output::report(format_args!("{}: {understood}", image.origin));
    Ok(image)
}

/// The patch of an estimate: `32`, `16x24` (rows x cols), or `sensor` for the whole measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PatchChoice {
    /// Rows and columns in pixels.
    Shape(usize, usize),
    /// The whole measurement.
    Sensor,
}

impl FromStr for PatchChoice {
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

impl PatchChoice {
    /// Rows and columns in pixels; none for the whole measurement.
    pub fn shape(self) -> Option<(usize, usize)> {
        match self {
            Self::Shape(rows, cols) => Some((rows, cols)),
            Self::Sensor => None,
        }
    }
}

/// Estimators by the names of the command line.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum EstimatorChoice {
    /// Stationary Gaussian fitted to patches.
    #[value(alias = "gaussian-stationary")]
    Gaussian,
    /// Gaussian with the full covariance of all pixels of a patch, fitted to patches.
    GaussianFull,
    /// Gaussian with the covariance computed from objects and PSF; nothing is fitted.
    GaussianAnalytic,
    /// Published autoregressive network (PixelCNN), fitted to patches.
    #[value(name = "pixelcnn")]
    PixelCnn,
    /// Causal density model, fitted for 60 s or the --budget to patches drawn as the fit proceeds.
    #[value(aliases = ["live", "full"])]
    Causal,
    /// Lower and upper bounds: causal model, Gaussian bound, entropy bound, decoder and annealed importance sampling, in
    /// 5 minutes or the --budget.
    Bracket,
}

impl EstimatorChoice {
    /// The estimator of the library.
    pub fn estimator(self) -> Estimator {
        match self {
            Self::Gaussian => Estimator::GaussianStationary,
            Self::GaussianFull => Estimator::GaussianFull,
            Self::GaussianAnalytic => Estimator::GaussianAnalytic,
            Self::PixelCnn => Estimator::PixelCnn,
            Self::Causal => Estimator::Causal,
            Self::Bracket => Estimator::Bracket,
        }
    }
}

/// Largest number of patches of one kind: 4 GB at 32 x 32 px.
const MOST_PATCHES: usize = 1_000_000;

/// Initial weights by the names of the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum InitChoice {
    /// Pretrained weights, included in the program.
    Pretrained,
    /// Random weights (cold start).
    Random,
}

/// The flag `--init`, and its former spelling.
#[derive(Args, Debug)]
pub(super) struct InitArgs {
    /// Initial weights of the fits of causal and bracket.
    #[arg(long, value_enum, default_value_t = InitChoice::Pretrained)]
    init: InitChoice,

    /// Former name of `--init random`.
    #[arg(long, hide = true, conflicts_with = "init")]
    fresh: bool,
}

impl InitArgs {
    /// Whether fits of `estimator` start from random weights.
    ///
    /// # Errors
    /// One sentence where they are asked for and the estimator has no pretrained weights.
    pub fn is_random(&self, estimator: Estimator) -> anyhow::Result<bool> {
        let is_random = self.fresh || self.init == InitChoice::Random;
        if is_random && !estimator.has_pretrained_weights() {
            bail!(
                "--init is for --estimator causal or bracket, as the others have no pretrained weights; leave it out"
            );
        }
        Ok(is_random)
    }
}

/// Refuses numbers of patches that exceed memory, and a single test patch, which has no confidence interval.
pub fn check_patches(train: usize, test: usize) -> anyhow::Result<()> {
    check_count("--patches-train", train, 0..=MOST_PATCHES)?;
    check_count("--patches-test", test, 2..=MOST_PATCHES)
}

/// Adds the name of the objects to the error that objects and mask do not fit each other.
pub fn about_objects(design: &Design, error: EvaluationError) -> anyhow::Error {
    match error {
        EvaluationError::Forward(ForwardError::Sensor(error)) => anyhow::anyhow!("{}: {error}", design.objects),
        other => other.into(),
    }
}

/// Paths as text; JSON holds no others.
pub fn names_of(files: &[PathBuf]) -> Vec<String> {
    files.iter().map(|file| file.display().to_string()).collect()
}

/// Refuses a count that is out of range.
pub fn check_count(name: &str, found: usize, range: RangeInclusive<usize>) -> anyhow::Result<()> {
    if !range.contains(&found) {
        bail!("{name} {found}: expected {} to {}", range.start(), range.end());
    }
    Ok(())
}

/// Makes the output folder, or refuses it before the computation starts.
pub fn check_folder(folder: &Path) -> anyhow::Result<()> {
    if folder.exists() && !folder.is_dir() {
        bail!("{}: expected a folder to write into, found a file; choose another name", folder.display());
    }
    crate::formats::create_folder(folder).context("the output folder cannot be created")
}

/// Whether two paths name one file, which need not exist.
pub fn is_same_file(one: &Path, other: &Path) -> bool {
    let place = |path: &Path| {
        let path = std::path::absolute(path).ok()?;
        let new = || Some(path.parent()?.canonicalize().ok()?.join(path.file_name()?));
        path.canonicalize().ok().or_else(new)
    };
    place(one).is_some_and(|one| place(other) == Some(one))
}

/// Duration of a fit: `60s`, `5m` or `1h`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BudgetChoice(pub Duration);

/// Longest duration of a fit, seconds: one week.
const LONGEST_BUDGET: f64 = 7.0 * 86_400.0;

impl FromStr for BudgetChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let unit = |suffix: char, seconds: f64| text.strip_suffix(suffix).map(|number| (number, seconds));
        let (number, unit) = unit('s', 1.0).or(unit('m', 60.0)).or(unit('h', 3600.0)).unwrap_or((text, 0.0));
        number
            .parse::<f64>()
            .ok()
            .map(|number| number * unit)
            .filter(|seconds| (0.001..=LONGEST_BUDGET).contains(seconds))
            .map(|seconds| Self(Duration::from_secs_f64(seconds)))
            .ok_or_else(|| format!("budget {text:?}: expected a time such as 60s, 5m or 1h, at most 168h"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_parsed_from_their_names() {
        for (text, expected) in [
            ("heuristic:9", EncoderChoice::Heuristic(9)),
            ("random:25", EncoderChoice::Random(25)),
            ("psf:a/b.npy", EncoderChoice::Psf("a/b.npy".into(), None)),
            ("psf:me@lab/psf.npy", EncoderChoice::Psf("me@lab/psf.npy".into(), None)),
            ("psf:a@b.png@48", EncoderChoice::Psf("a@b.png".into(), Some(48))),
            ("diffuser:16", EncoderChoice::Diffuser(16)),
        ] {
            assert_eq!(text.parse(), Ok(expected));
        }
        for wrong in ["", "9", "heuristic:0", "heuristic:10", "random:x", "psf:", "psf:a@0", "lens:1"] {
            assert!(wrong.parse::<EncoderChoice>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn only_psf_images_are_resampled() {
        let mask: EncoderChoice = "psf:a.png".parse().unwrap();
        assert_eq!(mask.resampled(48).unwrap(), EncoderChoice::Psf("a.png".into(), Some(48)));
        for wrong in ["psf:a.png@32", "heuristic:3", "design:a.json"] {
            assert!(wrong.parse::<EncoderChoice>().unwrap().resampled(48).is_err(), "{wrong}");
        }
    }

    #[test]
    fn budgets_are_parsed_with_their_unit() {
        for (text, seconds) in [("60s", 60.0), ("1.5m", 90.0), ("2h", 7200.0), ("0.25s", 0.25)] {
            assert_eq!(text.parse(), Ok(BudgetChoice(Duration::from_secs_f64(seconds))));
        }
        for wrong in ["", "60", "s", "-5s", "0s", "nans", "infs", "1e9h", "5 m", "5d"] {
            assert!(wrong.parse::<BudgetChoice>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn patches_are_parsed_from_their_names() {
        assert_eq!("32".parse(), Ok(PatchChoice::Shape(32, 32)));
        assert_eq!("16x24".parse(), Ok(PatchChoice::Shape(16, 24)));
        assert_eq!("sensor".parse(), Ok(PatchChoice::Sensor));
        assert!("0".parse::<PatchChoice>().is_err() && "x".parse::<PatchChoice>().is_err());
    }
}
