//! What plots and tables know of a cell: values of its axes, and numbers in them.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::cell::{CellSettings, StudyMask};
use crate::forward::MaskSource;
use crate::objects::ObjectSource;

/// An axis of a plan, or a part of its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Facet {
    /// The mask.
    Mask,
    /// The objects.
    Objects,
    /// Share of the pixels that hold a bead.
    Density,
    /// Depth planes of the objects.
    Planes,
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
    /// The seed.
    Seed,
}

impl Facet {
    /// The facets that tell all cells of a plan apart.
    pub const AXES: [Self; 8] = [
        Self::Objects,
        Self::Mask,
        Self::Photons,
        Self::Background,
        Self::Noise,
        Self::Patch,
        Self::Estimator,
        Self::Seed,
    ];

    /// Whether cells that agree in this facet agree in `other` as well.
    pub fn holds(self, other: Self) -> bool {
        self == other || (self == Self::Objects && matches!(other, Self::Density | Self::Planes))
    }

    /// The value of a cell, for people.
    pub(super) fn value(self, sets: &BTreeMap<String, ObjectSource>, cell: &CellSettings) -> String {
        match self {
            Self::Mask => cell.mask.to_string(),
            Self::Objects => {
                let named = sets.iter().find(|(_, source)| **source == cell.objects);
                named.map_or_else(|| cell.objects.to_string(), |(name, _)| name.clone())
            }
            Self::Density => cell.density().map_or_else(|| cell.objects.to_string(), |density| density.to_string()),
            Self::Planes => planes(cell).to_string(),
            Self::Photons => cell.mean_photons.to_string(),
            Self::Background => cell.bias_photons.to_string(),
            Self::Noise => cell.noise.to_string(),
            Self::Patch => cell.patch.to_string(),
            Self::Estimator => cell.estimator.to_string(),
            Self::Seed => cell.seed.to_string(),
        }
    }

    /// The value of a cell as a number, where it is one.
    pub fn number(self, cell: &CellSettings) -> Option<f64> {
        match self {
            Self::Mask => match (&cell.mask, cell.mask.source()) {
                (
                    StudyMask::Given(_),
                    MaskSource::Heuristic(count)
                    | MaskSource::Random(count)
                    | MaskSource::Depth(count)
                    | MaskSource::Diffuser(count),
                ) => Some(*count as f64),
                _ => None,
            },
            Self::Objects | Self::Density => cell.density(),
            Self::Planes => Some(planes(cell) as f64),
            Self::Photons => Some(cell.mean_photons),
            Self::Background => Some(cell.bias_photons),
            Self::Patch => cell.patch.shape().map(|(rows, cols)| ((rows * cols) as f64).sqrt()),
            Self::Seed => Some(cell.seed as f64),
            Self::Noise | Self::Estimator => None,
        }
    }

    /// Label of the axis of a plot, with its unit.
    pub fn label(self, is_numeric: bool) -> &'static str {
        match self {
            Self::Mask if is_numeric => "lenslets, or aperture in px",
            Self::Mask => "mask",
            Self::Objects if is_numeric => "beads per object pixel",
            Self::Objects => "objects",
            Self::Density => "beads per object pixel",
            Self::Planes => "depth planes",
            Self::Photons => "mean photons per object pixel",
            Self::Background => "background, photons per pixel",
            Self::Noise => "noise",
            Self::Patch => "side of the patch, px",
            Self::Estimator => "estimator",
            Self::Seed => "seed",
        }
    }
}

impl fmt::Display for Facet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mask => "mask",
            Self::Objects => "objects",
            Self::Density => "density",
            Self::Planes => "planes",
            Self::Photons => "photons",
            Self::Background => "background",
            Self::Noise => "noise",
            Self::Patch => "patch",
            Self::Estimator => "estimator",
            Self::Seed => "seed",
        })
    }
}

fn planes(cell: &CellSettings) -> usize {
    if let ObjectSource::Volume { planes, .. } = cell.objects { planes } else { 1 }
}
