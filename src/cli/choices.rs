//! Argument types of the command line: masks, patches, estimators, budgets.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::{Args, ValueEnum};

use super::output;
use crate::evaluation::{EvaluationError, MeasuredSource};
use crate::forward::{Design, ForwardError, MaskSource, OpenedMask};
use crate::information::Estimator;
use crate::objects::ObjectSource;
use crate::sensor::PatchSize;
use crate::studies::PublishedSet;
use crate::studies::plans::Shard;

/// Reads a mask from an argument, which need not be UTF-8, as paths need not be.
pub fn mask_argument() -> impl TypedValueParser<Value = MaskSource> {
    OsStringValueParser::new().try_map(|text| MaskSource::from_os(&text))
}

/// Makes or reads the mask for the objects of a design, and reports how its file was understood. Without `grid` a preset has the
/// grid of the design, and a file its own.
pub fn open_mask(mask: &MaskSource, design: &Design, grid: Option<usize>) -> anyhow::Result<OpenedMask> {
    let grid = grid.map(|side| (side, side)).or_else(|| mask.file().is_none().then(|| design.encoder.grid()));
    let opened = mask.mask(design.seed, &design.objects, grid)?;
    opened.notices.iter().for_each(output::report);
    Ok(opened)
}

/// Reads the size of the objects from an argument: `256`, or rows x cols such as `256x320`.
pub fn field_argument(text: &str) -> Result<(usize, usize), String> {
    match text.parse::<PatchSize>().ok().and_then(PatchSize::shape) {
        Some(field) => Ok(field),
        None => Err(format!("field {text:?}: expected pixels such as 256, or rows x cols such as 256x320")),
    }
}

/// Reads objects from an argument.
pub fn objects_argument() -> impl TypedValueParser<Value = ObjectSource> {
    OsStringValueParser::new().try_map(|text| ObjectSource::from_os(&text))
}

/// Reads measurements from an argument.
pub fn measurements_argument() -> impl TypedValueParser<Value = MeasuredSource> {
    OsStringValueParser::new().try_map(|text| MeasuredSource::from_os(&text))
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

/// The share that the environment of a Slurm job array names; everything outside of one.
pub fn shard_of_slurm() -> anyhow::Result<Shard> {
    let named = Shard::of_slurm(|name| std::env::var(name).ok()).map_err(anyhow::Error::msg)?;
    Ok(named.unwrap_or_default())
}

/// Paths as text; JSON holds no others.
pub fn names_of(files: &[PathBuf]) -> Vec<String> {
    files.iter().map(|file| file.display().to_string()).collect()
}

/// Refuses a count that is out of range.
pub fn check_count(name: &str, found: usize, range: RangeInclusive<usize>) -> anyhow::Result<()> {
    if !range.contains(&found) {
        let cure = if found < *range.start() { "raise it" } else { "lower it" };
        bail!("{name} {found}: expected {} to {}; {cure}", range.start(), range.end());
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

/// A heuristic layout by its number of lenslets.
pub fn layout(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if (1..=9).contains(&count) => Ok(count),
        _ => Err(format!("lenslets {text:?}: expected numbers of lenslets from 1 to 9, such as 1,2,4")),
    }
}

/// Image sets by the names of the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PublishedChoice {
    Cifar10,
    Mnist,
    Fashion,
    /// Objects without published values.
    None,
}

impl PublishedChoice {
    pub fn set(self) -> Option<PublishedSet> {
        match self {
            Self::Cifar10 => Some(PublishedSet::Cifar10),
            Self::Mnist => Some(PublishedSet::Mnist),
            Self::Fashion => Some(PublishedSet::Fashion),
            Self::None => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_are_parsed_with_their_unit() {
        for (text, seconds) in [("60s", 60.0), ("1.5m", 90.0), ("2h", 7200.0), ("0.25s", 0.25)] {
            assert_eq!(text.parse(), Ok(BudgetChoice(Duration::from_secs_f64(seconds))));
        }
        for wrong in ["", "60", "s", "-5s", "0s", "nans", "infs", "1e9h", "5 m", "5d"] {
            assert!(wrong.parse::<BudgetChoice>().is_err(), "{wrong}");
        }
    }
}
