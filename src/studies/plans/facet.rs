//! Roles of cells in plots and tables: an axis, or a part of its values.

use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::axes::Axis;
use super::cell::{CellSettings, StudyMask};
use crate::formats::text_form;
use crate::forward::MaskSource;
use crate::objects::ObjectSource;

/// An axis of a plan, or a part of its values. Each gives its text form (`Display`, `FromStr`, serde).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Facet {
    /// An axis, by its name.
    Axis(Axis),
    /// `density`: share of the object pixels that hold a bead.
    Density,
    /// `planes`: depth planes of the objects.
    Planes,
}

impl Facet {
    /// The value of a cell, for people. Objects have the name of their set.
    pub(super) fn value(self, sets: &BTreeMap<String, ObjectSource>, cell: &CellSettings) -> String {
        match self {
            Self::Axis(Axis::Mask) => cell.mask.to_string(),
            Self::Axis(Axis::Objects) => {
                let named = sets.iter().find(|(_, source)| **source == cell.objects);
                named.map_or_else(|| cell.objects.to_string(), |(name, _)| name.clone())
            }
            Self::Axis(Axis::Photons) if !cell.objects.has_mean() => "of the objects".into(),
            Self::Axis(Axis::Photons) => cell.mean_photons.to_string(),
            Self::Axis(Axis::Background) => cell.bias_photons.to_string(),
            Self::Axis(Axis::Noise) => cell.noise.to_string(),
            Self::Axis(Axis::Patch) => cell.patch.to_string(),
            Self::Axis(Axis::Estimator) => cell.estimator.to_string(),
            Self::Axis(Axis::Seed) => cell.seed.to_string(),
            Self::Axis(Axis::Field) => cell.field.to_string(),
            Self::Axis(Axis::Grid) => cell.grid.to_string(),
            Self::Axis(Axis::Decoder) => cell.decoder().to_string(),
            Self::Density => cell.density().map_or_else(|| cell.objects.to_string(), |density| density.to_string()),
            Self::Planes => planes(cell).to_string(),
        }
    }

    /// The value of a cell as a number, where it is one.
    pub fn number(self, cell: &CellSettings) -> Option<f64> {
        match self {
            Self::Axis(Axis::Mask) => match (&cell.mask, cell.mask.source()) {
                (
                    StudyMask::Given(_),
                    MaskSource::Heuristic(count)
                    | MaskSource::Random(count)
                    | MaskSource::Depth(count)
                    | MaskSource::Diffuser(count),
                ) => Some(*count as f64),
                _ => None,
            },
            Self::Axis(Axis::Objects) | Self::Density => cell.density(),
            Self::Axis(Axis::Photons) => Some(cell.mean_photons),
            Self::Axis(Axis::Background) => Some(cell.bias_photons),
            Self::Axis(Axis::Patch) => cell.patch.shape().map(side_of),
            Self::Axis(Axis::Field) => cell.field.shape().map(side_of),
            Self::Axis(Axis::Grid) => cell.grid.shape().map(side_of),
            Self::Axis(Axis::Seed) => Some(cell.seed as f64),
            Self::Planes => Some(planes(cell) as f64),
            Self::Axis(Axis::Noise | Axis::Estimator | Axis::Decoder) => None,
        }
    }

    /// Label of the axis of a plot, with its unit.
    pub fn label(self, is_numeric: bool) -> &'static str {
        match self {
            Self::Axis(Axis::Mask) => "mask",
            Self::Axis(Axis::Objects) if !is_numeric => "objects",
            Self::Axis(Axis::Objects) | Self::Density => "beads per object pixel",
            Self::Axis(Axis::Photons) => "mean photons per object pixel",
            Self::Axis(Axis::Background) => "background, photons per pixel",
            Self::Axis(Axis::Noise) => "noise",
            Self::Axis(Axis::Patch) => "side of the patch, px",
            Self::Axis(Axis::Estimator) => "estimator",
            Self::Axis(Axis::Seed) => "seed",
            Self::Axis(Axis::Field) => "side of the field, px",
            Self::Axis(Axis::Grid) => "side of the PSF grid, px",
            Self::Axis(Axis::Decoder) => "decoder",
            Self::Planes => "depth planes",
        }
    }
}

impl FromStr for Facet {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let all = Axis::ALL.map(Self::Axis).into_iter().chain([Self::Density, Self::Planes]);
        let names: Vec<String> = all.clone().map(|facet| facet.to_string()).collect();
        all.into_iter()
            .find(|facet| facet.to_string() == text)
            .ok_or_else(|| format!("{text:?}: expected one of {}", names.join(", ")))
    }
}

text_form!(Facet);

impl fmt::Display for Facet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Axis(axis) => axis.fmt(f),
            Self::Density => f.write_str("density"),
            Self::Planes => f.write_str("planes"),
        }
    }
}

/// Side of the square of equal area, pixels.
fn side_of((rows, cols): (usize, usize)) -> f64 {
    ((rows * cols) as f64).sqrt()
}

fn planes(cell: &CellSettings) -> usize {
    if let ObjectSource::Volume { planes, .. } = cell.objects { planes } else { 1 }
}

/// The values in the order in which they first occur.
pub(super) fn distinct(values: impl Iterator<Item = String>) -> Vec<String> {
    let mut seen = HashSet::new();
    values.filter(|value| seen.insert(value.clone())).collect()
}
