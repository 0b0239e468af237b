//! The axes of a plan and their values.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::cell::{CellSettings, StudyMask};
use super::estimates::EstimateSettings;
use super::reconstruction::ReconstructionSettings;
use super::size::SizeChoice;
use super::study_decoder::StudyDecoder;
use crate::information::Estimator;
use crate::objects::ObjectSource;
use crate::sensor::{Noise, PatchSize};
use crate::studies::error::StudyError;
use crate::studies::published::PublishedSet;

/// Most cells of a plan.
const MOST_CELLS: usize = 100_000;

/// An axis of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// The objects.
    Objects,
    /// Mean of the objects, photons per pixel.
    Photons,
    /// Background, photons per pixel.
    Background,
    /// Noise of the sensor.
    Noise,
    /// Patch of the estimate.
    Patch,
    /// The estimator.
    Estimator,
    /// Seed of masks, objects, noise, patches and fits.
    Seed,
    /// Rows and columns of the objects.
    Field,
    /// Side of the PSF grid.
    Grid,
    /// The decoder.
    Decoder,
    /// The mask.
    Mask,
}

impl Axis {
    /// All axes, from the slowest to the fastest in the order of the cells.
    pub const ALL: [Self; 11] = [
        Self::Objects,
        Self::Photons,
        Self::Background,
        Self::Noise,
        Self::Patch,
        Self::Estimator,
        Self::Seed,
        Self::Field,
        Self::Grid,
        Self::Decoder,
        Self::Mask,
    ];
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Objects => "objects",
            Self::Photons => "photons",
            Self::Background => "background",
            Self::Noise => "noise",
            Self::Patch => "patch",
            Self::Estimator => "estimator",
            Self::Seed => "seed",
            Self::Field => "field",
            Self::Grid => "grid",
            Self::Decoder => "decoder",
            Self::Mask => "mask",
        })
    }
}

/// Values of the axes. Axes cross, apart from those that are zipped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axes {
    /// Masks, as `--mask` names them, or `ideal:START` for the design of an optimizer run from that start.
    pub mask: Vec<StudyMask>,
    /// Objects, as `--objects` names them, or the name of one of the plan's sets.
    pub objects: Vec<String>,
    /// Mean of the objects, photons per pixel.
    #[serde(default = "published_photons")]
    pub photons: Vec<f64>,
    /// Background, photons per pixel.
    #[serde(default = "published_background")]
    pub background: Vec<f64>,
    /// Noise of the sensor.
    #[serde(default = "shot")]
    pub noise: Vec<Noise>,
    /// Patches of the estimates.
    #[serde(default = "published_patch")]
    pub patch: Vec<PatchSize>,
    /// The estimators.
    #[serde(default = "causal")]
    pub estimator: Vec<Estimator>,
    /// Seeds.
    #[serde(default = "first_seed")]
    pub seed: Vec<u64>,
    /// Rows and columns of the objects, pixels.
    #[serde(default = "usual_size")]
    pub field: Vec<SizeChoice>,
    /// Sides of the PSF grid, pixels. Masks scale with it as by `--grid`.
    #[serde(default = "usual_size")]
    pub grid: Vec<SizeChoice>,
    /// Decoders whose image quality the cells report. Without them, the plan's `reconstruction` has the only one, if any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub decoder: Vec<StudyDecoder>,
    /// Groups of axes that advance together instead of crossing. The axes of a group have equally many values.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub zip: Vec<Vec<Axis>>,
}

fn published_photons() -> Vec<f64> {
    vec![100.0]
}

fn published_background() -> Vec<f64> {
    vec![crate::sensor::DEFAULT_BIAS]
}

fn shot() -> Vec<Noise> {
    vec![Noise::Shot]
}

fn published_patch() -> Vec<PatchSize> {
    vec![PatchSize::Shape(32, 32)]
}

fn causal() -> Vec<Estimator> {
    vec![Estimator::Causal]
}

fn usual_size() -> Vec<SizeChoice> {
    vec![SizeChoice::Usual]
}

fn first_seed() -> Vec<u64> {
    vec![1]
}

impl Axes {
    /// These masks and objects, under the published light and shot noise.
    pub fn new(mask: Vec<StudyMask>, objects: Vec<String>) -> Self {
        Self {
            mask,
            objects,
            photons: published_photons(),
            background: published_background(),
            noise: shot(),
            patch: published_patch(),
            estimator: causal(),
            seed: first_seed(),
            field: usual_size(),
            grid: usual_size(),
            decoder: Vec::new(),
            zip: Vec::new(),
        }
    }

    /// Number of values of an axis.
    pub fn len_of(&self, axis: Axis) -> usize {
        match axis {
            Axis::Objects => self.objects.len(),
            Axis::Photons => self.photons.len(),
            Axis::Background => self.background.len(),
            Axis::Noise => self.noise.len(),
            Axis::Patch => self.patch.len(),
            Axis::Estimator => self.estimator.len(),
            Axis::Seed => self.seed.len(),
            Axis::Field => self.field.len(),
            Axis::Grid => self.grid.len(),
            Axis::Decoder => self.decoder.len().max(1),
            Axis::Mask => self.mask.len(),
        }
    }

    /// The values of an axis for people, in their order.
    pub fn names_of(&self, axis: Axis) -> Vec<String> {
        fn texts<T: ToString>(values: &[T]) -> Vec<String> {
            values.iter().map(ToString::to_string).collect()
        }
        match axis {
            Axis::Objects => self.objects.clone(),
            Axis::Photons => texts(&self.photons),
            Axis::Background => texts(&self.background),
            Axis::Noise => texts(&self.noise),
            Axis::Patch => texts(&self.patch),
            Axis::Estimator => texts(&self.estimator),
            Axis::Seed => texts(&self.seed),
            Axis::Field => texts(&self.field),
            Axis::Grid => texts(&self.grid),
            Axis::Decoder => texts(&self.decoder),
            Axis::Mask => texts(&self.mask),
        }
    }

    /// The axes with every second value of those that have more than two, apart from those to `keep`. The first value and
    /// designed masks stay, and all estimators and decoders.
    #[must_use]
    pub fn halved(&self, keep: &[Axis]) -> Self {
        fn half<T: Clone>(values: &[T], is_kept: bool) -> Vec<T> {
            if is_kept || values.len() <= 2 { values.to_vec() } else { values.iter().step_by(2).cloned().collect() }
        }
        let kept = |axis: Axis| keep.contains(&axis);
        // Designed masks are the question of their plan.
        let (designed, given): (Vec<_>, Vec<_>) =
            self.mask.iter().cloned().partition(|mask| matches!(mask, StudyMask::Ideal { .. }));
        let mask = if kept(Axis::Mask) { self.mask.clone() } else { [half(&given, false), designed].concat() };
        Self {
            mask,
            objects: half(&self.objects, kept(Axis::Objects)),
            photons: half(&self.photons, kept(Axis::Photons)),
            background: half(&self.background, kept(Axis::Background)),
            noise: half(&self.noise, kept(Axis::Noise)),
            patch: half(&self.patch, kept(Axis::Patch)),
            estimator: self.estimator.clone(),
            seed: half(&self.seed, kept(Axis::Seed)),
            field: half(&self.field, kept(Axis::Field)),
            grid: half(&self.grid, kept(Axis::Grid)),
            decoder: self.decoder.clone(),
            zip: self.zip.clone(),
        }
    }

    /// Number of cells; none where that exceeds every number.
    pub fn size(&self) -> Option<usize> {
        let zipped = |axis: &Axis| self.zip.iter().any(|group| group.iter().skip(1).any(|other| other == axis));
        Axis::ALL
            .iter()
            .filter(|axis| !zipped(axis))
            .try_fold(1_usize, |cells, &axis| cells.checked_mul(self.len_of(axis)))
    }

    /// Refuses empty axes, values that are given twice, zipped axes of different lengths, and more cells than a folder should hold.
    pub(super) fn check(&self) -> Result<(), StudyError> {
        let refused = |what: String, expected: String, found: String| Err(StudyError::Plan { what, expected, found });
        for axis in Axis::ALL {
            let mut names = self.names_of(axis);
            if self.len_of(axis) == 0 {
                return refused(format!("axis {axis}"), "at least one value".into(), "none".into());
            }
            let is_zipped = self.zip.iter().any(|group| group.contains(&axis));
            names.sort();
            let twice = names.array_windows().find(|[one, other]| one == other).filter(|_| !is_zipped);
            if let Some([twice, _]) = twice {
                return refused(format!("axis {axis}"), "each value once".into(), format!("{twice} twice"));
            }
        }
        for group in &self.zip {
            let lengths: Vec<String> = group.iter().map(|&axis| format!("{axis} with {}", self.len_of(axis))).collect();
            if group.iter().any(|&axis| self.len_of(axis) != self.len_of(group[0])) {
                return refused("zip".into(), "axes of equally many values".into(), lengths.join(", "));
            }
        }
        let mut zipped: Vec<Axis> = self.zip.iter().flatten().copied().collect();
        zipped.sort();
        if let Some([twice, _]) = zipped.array_windows().find(|[one, other]| one == other) {
            return refused("zip".into(), "each axis once".into(), format!("{twice} twice"));
        }
        match self.size() {
            Some(cells) if cells <= MOST_CELLS => Ok(()),
            found => {
                let found = found.map_or("more than can be counted".into(), |cells| cells.to_string());
                refused("plan".into(), format!("at most {MOST_CELLS} cells"), found)
            }
        }
    }

    /// All cells in their order: objects slowest, masks fastest. `reconstructions` has one entry for each value of the axis of decoders.
    ///
    /// # Errors
    /// Where an objects' name is none of `sets` and no source of objects.
    pub(super) fn expand(
        &self,
        sets: &BTreeMap<String, ObjectSource>,
        estimates: &EstimateSettings,
        reconstructions: &[Option<ReconstructionSettings>],
    ) -> Result<Vec<CellSettings>, StudyError> {
        let sources: Vec<ObjectSource> =
            self.objects.iter().map(|name| source_of(name, sets)).collect::<Result<_, _>>()?;
        if self.photons.len() > 1
            && let Some(fixed) = sources.iter().find(|source| !source.has_mean())
        {
            let expected = format!("one value, as {fixed} sets its photons itself");
            return Err(StudyError::Plan {
                what: "axis photons".into(),
                expected,
                found: self.photons.len().to_string(),
            });
        }
        let leader = |axis: Axis| {
            self.zip.iter().find(|group| group.contains(&axis)).and_then(|group| group.first()).copied().unwrap_or(axis)
        };
        let mut cells = Vec::with_capacity(self.size().unwrap_or_default());
        let free: Vec<Axis> = Axis::ALL.into_iter().filter(|&axis| leader(axis) == axis).collect();
        let mut place: BTreeMap<Axis, usize> = free.iter().map(|&axis| (axis, 0)).collect();
        loop {
            let at = |axis: Axis| place[&leader(axis)];
            cells.push(CellSettings {
                mask: self.mask[at(Axis::Mask)].clone(),
                objects: sources[at(Axis::Objects)].clone(),
                mean_photons: self.photons[at(Axis::Photons)],
                bias_photons: self.background[at(Axis::Background)],
                noise: self.noise[at(Axis::Noise)],
                patch: self.patch[at(Axis::Patch)],
                estimator: self.estimator[at(Axis::Estimator)],
                seed: self.seed[at(Axis::Seed)],
                field: self.field[at(Axis::Field)],
                grid: self.grid[at(Axis::Grid)],
                published_as: PublishedSet::named(&self.objects[at(Axis::Objects)]),
                estimates: estimates.of(self.estimator[at(Axis::Estimator)]),
                reconstruction: reconstructions[at(Axis::Decoder)],
            });
            let Some(&next) = free.iter().rev().find(|&&axis| place[&axis] + 1 < self.len_of(axis)) else {
                return Ok(cells);
            };
            for &axis in free.iter().rev().take_while(|&&axis| axis != next) {
                place.insert(axis, 0);
            }
            *place.entry(next).or_default() += 1;
        }
    }
}

/// The objects of a name: one of the plan's sets, or a source.
fn source_of(name: &str, sets: &BTreeMap<String, ObjectSource>) -> Result<ObjectSource, StudyError> {
    if let Some(source) = sets.get(name) {
        return Ok(source.clone());
    }
    if PublishedSet::named(name).is_some() {
        return Err(StudyError::Plan {
            what: format!("objects {name}"),
            expected: format!("its file, such as --set {name}=idx:FILE"),
            found: "none".into(),
        });
    }
    Ok(ObjectSource::from_os(OsStr::new(name))?)
}
