//! The plan that a command names, and the flags that change it.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::builder::{OsStringValueParser, PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};

use super::choices::{BudgetChoice, EstimatorChoice};
use crate::information::{Estimator, Protocol};
use crate::objects::ObjectSource;
use crate::reconstruction::DecoderKind;
use crate::sensor::{Noise, PatchSize};
use crate::studies::plans::{NamedPlan, Plan, SizeChoice, StudyDecoder, StudyFolder, StudyMask, named_plans};

/// A plan by name or file, and what replaces its entries.
#[derive(Args, Debug)]
pub(super) struct PlanArgs {
    /// Name of a plan, its TOML file, or the folder of a study.
    plan: PathBuf,

    #[command(flatten)]
    changes: Changes,
}

/// Replacements of a plan's entries.
#[derive(Args, Debug)]
pub(super) struct Changes {
    /// A first look: every second value of long axes, and seconds for each cell.
    #[arg(long)]
    quick: bool,

    /// Estimates by exact entropies, or by the published procedure: a fitted PixelCNN, five trials.
    #[arg(long, value_enum)]
    protocol: Option<ProtocolChoice>,

    /// An image set of the plan, such as mnist=idx:FILE; repeat the flag for several.
    #[arg(long, value_name = "NAME=SOURCE", value_parser = set_argument())]
    set: Vec<(String, ObjectSource)>,

    /// Masks in place of the plan's, as in estimate, or ideal:START for a designed one; repeat the flag for several.
    #[arg(long, value_name = "MASK", value_parser = mask_argument())]
    mask: Vec<StudyMask>,

    /// Objects in place of the plan's, as in estimate, or names of its image sets; repeat the flag for several.
    #[arg(long, value_name = "OBJECTS")]
    objects: Vec<String>,

    /// Means of the objects, photons per pixel.
    #[arg(long, value_name = "PHOTONS", value_delimiter = ',')]
    photons: Vec<f64>,

    /// Backgrounds, photons per pixel.
    #[arg(long, value_name = "PHOTONS", value_delimiter = ',')]
    background: Vec<f64>,

    /// Noise of the sensor: shot, read:SIGMA or shot+read:SIGMA.
    #[arg(long, value_delimiter = ',')]
    noise: Vec<Noise>,

    /// Patches in pixels: 32, 16x24 (rows x cols), or sensor for whole measurements.
    #[arg(long, value_delimiter = ',')]
    patch: Vec<PatchSize>,

    /// The estimators.
    #[arg(long, value_enum, value_delimiter = ',')]
    estimator: Vec<EstimatorChoice>,

    /// Seeds of masks, objects, noise, patches and fits.
    #[arg(long, value_delimiter = ',')]
    seed: Vec<u64>,

    /// Fields in pixels: 192, 96x128 (rows x cols), or usual for the published one; larger where the PSF grid needs it.
    #[arg(long, value_name = "SIZE", value_delimiter = ',')]
    field: Vec<SizeChoice>,

    /// Sides of the PSF grid in pixels, or usual for that of the mask. Masks scale with it as by --grid of estimate.
    #[arg(long, value_name = "SIZE", value_delimiter = ',')]
    grid: Vec<SizeChoice>,

    /// Time for the fits of one cell, such as 60s, 5m or 1h.
    #[arg(long, conflicts_with = "steps")]
    budget: Option<BudgetChoice>,

    /// Steps of each fit and training in place of a time; equal steps give equal numbers on one machine.
    #[arg(long)]
    steps: Option<usize>,

    /// Decoders whose image quality the cells report, or none; posterior is for beads alone.
    #[arg(long, value_delimiter = ',', value_parser = decoder_argument())]
    decoder: Vec<StudyDecoder>,

    /// Test objects of a decoder.
    #[arg(long, value_name = "N")]
    test: Option<usize>,

    /// Markov chains of this many sweeps for each image refine the posterior mean.
    #[arg(long, value_name = "N")]
    sweeps: Option<usize>,

    /// Time for the training of a decoder in one cell, such as 60s.
    #[arg(long, conflicts_with = "steps")]
    training: Option<BudgetChoice>,

    /// Steps of each optimizer run of an ideal: mask.
    #[arg(long)]
    ideal_steps: Option<usize>,

    /// Training patches of gaussian and pixelcnn.
    #[arg(long)]
    patches_train: Option<usize>,

    /// Held-out test patches.
    #[arg(long)]
    patches_test: Option<usize>,

    /// Trials; the smallest estimate counts.
    #[arg(long)]
    trials: Option<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ProtocolChoice {
    Default,
    Paper,
}

fn set_argument() -> impl TypedValueParser<Value = (String, ObjectSource)> {
    OsStringValueParser::new().try_map(|text| {
        let wrong = || format!("{}: expected NAME=SOURCE, such as mnist=idx:FILE", text.display());
        let bytes = text.as_encoded_bytes();
        let at = bytes.iter().position(|&byte| byte == b'=').filter(|&at| at > 0).ok_or_else(wrong)?;
        let name = std::str::from_utf8(&bytes[..at]).map_err(|_| wrong())?;
        let source = Path::new(&text).to_str().map(|text| OsStr::new(&text[at + 1..]).to_owned()).ok_or_else(wrong)?;
        ObjectSource::from_os(&source).map(|source| (name.to_owned(), source)).map_err(|error| error.to_string())
    })
}

fn decoder_argument() -> impl TypedValueParser<Value = StudyDecoder> {
    let none = PossibleValue::new("none").help("Information alone");
    let kinds = DecoderKind::value_variants().iter().filter_map(ValueEnum::to_possible_value);
    PossibleValuesParser::new(std::iter::once(none).chain(kinds)).try_map(|text| text.parse())
}

fn mask_argument() -> impl TypedValueParser<Value = StudyMask> {
    OsStringValueParser::new().try_map(|text| StudyMask::from_os(&text))
}

impl PlanArgs {
    /// The folder of a study that names the plan.
    pub fn study_folder(&self) -> Option<&Path> {
        StudyFolder::is_at(&self.plan).then_some(&*self.plan)
    }

    /// The plan with its changes.
    pub fn plan(&self) -> anyhow::Result<Plan> {
        let plan = self.changes.applied_to(&self.plan)?;
        if self.plan.is_file() {
            plan.cells().with_context(|| self.plan.display().to_string())?;
        }
        Ok(plan)
    }
}

/// The plan of a name, a file, or the folder of a study.
fn read(named: &Path) -> anyhow::Result<Plan> {
    if let Some(found) = named.to_str().and_then(NamedPlan::find) {
        return Ok(found.plan);
    }
    if StudyFolder::is_at(named) {
        return Ok(StudyFolder::read_plan(named)?);
    }
    if !named.is_file() {
        let names: Vec<String> = named_plans().into_iter().map(|named| named.plan.name).collect();
        bail!("plan {}: expected a TOML file, the folder of a study, or one of {}", named.display(), names.join(", "));
    }
    Ok(Plan::open(named)?)
}

/// The given values, or those of the plan where none were given.
fn or<T: Clone>(given: &[T], planned: Vec<T>) -> Vec<T> {
    if given.is_empty() { planned } else { given.to_vec() }
}

impl Changes {
    /// The plan of a name, a file or a folder, with these changes and absolute paths.
    pub fn applied_to(&self, named: &Path) -> anyhow::Result<Plan> {
        let plan = self.applied(read(named)?).absolute();
        let decoders = plan.decoders();
        let is_trained = decoders.iter().any(|decoder| decoder.needs().training);
        let is_timed = plan.axes.estimator.iter().any(|estimator| estimator.default_budget().is_some()) || is_trained;
        if !is_timed && (self.budget.is_some() || self.steps.is_some()) {
            bail!("--budget and --steps are for fits; leave them out for --estimator gaussian");
        }
        if self.training.is_some() && !is_trained {
            bail!(
                "--training: expected a plan with a decoder that is trained, such as --decoder network; leave it out for others"
            );
        }
        if self.test.is_some() && decoders.is_empty() {
            bail!("--test: expected a plan with a decoder, such as --decoder linear; leave it out for others");
        }
        if self.sweeps.is_some() && !decoders.contains(&DecoderKind::Posterior) {
            bail!("--sweeps: expected --decoder posterior; leave it out for others");
        }
        Ok(plan)
    }

    fn applied(&self, plan: Plan) -> Plan {
        let mut plan = if self.protocol == Some(ProtocolChoice::Paper) { plan.by_paper_protocol() } else { plan };
        if self.quick {
            plan = plan.quick();
        }
        plan.sets.extend(self.set.iter().cloned());
        let estimators: Vec<Estimator> = self.estimator.iter().map(|choice| choice.estimator()).collect();
        let axes = &mut plan.axes;
        axes.mask = or(&self.mask, std::mem::take(&mut axes.mask));
        axes.objects = or(&self.objects, std::mem::take(&mut axes.objects));
        axes.photons = or(&self.photons, std::mem::take(&mut axes.photons));
        axes.background = or(&self.background, std::mem::take(&mut axes.background));
        axes.noise = or(&self.noise, std::mem::take(&mut axes.noise));
        axes.patch = or(&self.patch, std::mem::take(&mut axes.patch));
        axes.estimator = or(&estimators, std::mem::take(&mut axes.estimator));
        axes.seed = or(&self.seed, std::mem::take(&mut axes.seed));
        axes.field = or(&self.field, std::mem::take(&mut axes.field));
        axes.grid = or(&self.grid, std::mem::take(&mut axes.grid));
        axes.decoder = or(&self.decoder, std::mem::take(&mut axes.decoder));
        if self.training.is_some() || self.steps.is_some() || self.test.is_some() || self.sweeps.is_some() {
            plan.reconstruction = plan.shared_reconstruction();
        }
        let estimates = &mut plan.estimates;
        if let Some(BudgetChoice(budget)) = self.budget {
            (estimates.seconds, estimates.steps) = (Some(budget.as_secs_f64()), None);
        }
        if let Some(steps) = self.steps {
            (estimates.seconds, estimates.steps) = (None, Some(steps));
        }
        if self.protocol == Some(ProtocolChoice::Default) {
            estimates.protocol = Protocol::Default;
        }
        if let Some(reconstruction) = &mut plan.reconstruction {
            if let Some(BudgetChoice(training)) = self.training {
                (reconstruction.training_seconds, reconstruction.training_steps) = (Some(training.as_secs_f64()), None);
            }
            if self.steps.is_some() {
                (reconstruction.training_seconds, reconstruction.training_steps) = (None, self.steps);
            }
            reconstruction.test_objects = self.test.unwrap_or(reconstruction.test_objects);
            reconstruction.sweeps = self.sweeps.or(reconstruction.sweeps);
        }
        estimates.ideal_steps = self.ideal_steps.or(estimates.ideal_steps);
        estimates.patches_train = self.patches_train.unwrap_or(estimates.patches_train);
        estimates.patches_test = self.patches_test.unwrap_or(estimates.patches_test);
        estimates.trials = self.trials.unwrap_or(estimates.trials);
        plan
    }
}
