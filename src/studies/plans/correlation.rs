//! Whether the image quality of decoders rises with information.

use serde::Serialize;

use super::axes::Axis;
use super::cell::CellSettings;
use super::facet::{Facet, distinct};
use super::figure::published_value;
use super::folder::CellState;
use super::plan::Plan;
use super::scatter::{PUBLISHED, information_of, published_psnr};
use crate::sensor::PatchSize;
use crate::studies::rank::{pearson, spearman};

/// Fewest masks of a correlation.
const FEWEST: usize = 3;
/// The published patch.
const PUBLISHED_PATCH: PatchSize = PatchSize::Shape(32, 32);

/// Header of the table of correlations for programs.
pub const CORRELATION_HEADER: [&str; 7] =
    ["cells", "decoder", "masks", "spearman", "pearson", "spearman_published", "pearson_published"];

/// Agreement of the PSNR of a decoder with information, over the masks of cells that differ in nothing else.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Correlation {
    /// What the cells share: their objects, and the values of other axes.
    pub cells: String,
    /// The decoder, or "published U-net" for the published PSNR.
    pub decoder: String,
    /// Masks that are compared.
    pub masks: usize,
    /// Spearman's rank correlation of PSNR and information, -1 to 1.
    pub spearman: Option<f64>,
    /// Pearson's correlation of PSNR and information, -1 to 1.
    pub pearson: Option<f64>,
    /// Spearman's rank correlation of PSNR and the published information of patches of 32 x 32 px, -1 to 1.
    pub spearman_published: Option<f64>,
    /// Pearson's correlation of PSNR and that published information, -1 to 1.
    pub pearson_published: Option<f64>,
}

/// What is known of one mask: information and its published value in bits per pixel, PSNR and its published value in dB.
#[derive(Clone, Copy)]
struct Known {
    bits: f64,
    published_bits: Option<f64>,
    psnr_db: f64,
    published_psnr_db: Option<f64>,
}

/// The masks of cells that differ in nothing else.
struct Group<'a> {
    first: &'a CellSettings,
    masks: Vec<Known>,
}

/// Published information of a mask in patches of 32 x 32 px, bits per pixel, in the light of the cell.
pub(super) fn published_patch(cell: &CellSettings) -> Option<f64> {
    published_value(&CellSettings { patch: PUBLISHED_PATCH, ..cell.clone() }).map(|known| known.bits_per_pixel)
}

/// Correlations of a study, the published decoder after those of the plan. Those of fewer than three masks are left out.
pub fn correlations(plan: &Plan, cells: &[CellSettings], states: &[CellState]) -> Vec<Correlation> {
    let shared: Vec<Facet> = Axis::ALL
        .into_iter()
        .filter(|axis| ![Axis::Mask, Axis::Decoder].contains(axis))
        .map(Facet::Axis)
        .filter(|&facet| {
            let values = distinct(cells.iter().map(|cell| plan.value(facet, cell)));
            facet == Facet::Axis(Axis::Objects) || values.len() > 1
        })
        .collect();
    let mut groups: Vec<Group<'_>> = Vec::new();
    for (cell, state) in cells.iter().zip(states) {
        let Some(known) = known_of(cell, state) else { continue };
        let is_alike = |of: &CellSettings| CellSettings { mask: of.mask.clone(), ..cell.clone() } == *of;
        match groups.iter_mut().find(|group| is_alike(group.first)) {
            Some(group) => group.masks.push(known),
            None => groups.push(Group { first: cell, masks: vec![known] }),
        }
    }
    let name = |group: &Group<'_>| -> String {
        shared.iter().map(|&facet| plan.value(facet, group.first)).collect::<Vec<_>>().join(", ")
    };
    let mut found: Vec<Correlation> = Vec::new();
    for of_cells in distinct(groups.iter().map(name)) {
        let own: Vec<&Group<'_>> = groups.iter().filter(|group| name(group) == of_cells).collect();
        found.extend(own.iter().map(|group| {
            let pairs = group.masks.iter().map(|known| (*known, known.psnr_db)).collect();
            correlation(&of_cells, group.first.decoder().to_string(), pairs)
        }));
        let published = own.iter().max_by_key(|group| group.masks.len()).map(|group| {
            let pairs = group.masks.iter().filter_map(|known| Some((*known, known.published_psnr_db?))).collect();
            correlation(&of_cells, PUBLISHED.into(), pairs)
        });
        found.extend(published);
    }
    found.retain(|found| found.masks >= FEWEST);
    found
}

fn known_of(cell: &CellSettings, state: &CellState) -> Option<Known> {
    let record = state.done()?;
    Some(Known {
        bits: information_of(record)?.0,
        published_bits: published_patch(cell),
        psnr_db: record.reconstruction.as_ref()?.psnr_db,
        published_psnr_db: published_psnr(cell),
    })
}

/// The correlation of masks, each with a PSNR in dB.
fn correlation(cells: &str, decoder: String, masks: Vec<(Known, f64)>) -> Correlation {
    let own: Vec<(f64, f64)> = masks.iter().map(|(known, psnr)| (known.bits, *psnr)).collect();
    let published: Vec<(f64, f64)> =
        masks.iter().filter_map(|(known, psnr)| Some((known.published_bits?, *psnr))).collect();
    Correlation {
        cells: cells.into(),
        decoder,
        masks: masks.len(),
        spearman: spearman(&own),
        pearson: pearson(&own),
        spearman_published: spearman(&published),
        pearson_published: pearson(&published),
    }
}

impl Correlation {
    /// Its row of the table for programs; see [`CORRELATION_HEADER`].
    pub fn csv_row(&self) -> Vec<String> {
        let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        let texts = [self.cells.clone(), self.decoder.clone(), self.masks.to_string()];
        texts.into_iter().chain(self.numbers().map(number)).collect()
    }

    /// Spearman's and Pearson's correlation with the information of the study, and with the published one.
    pub(super) fn numbers(&self) -> [Option<f64>; 4] {
        [self.spearman, self.pearson, self.spearman_published, self.pearson_published]
    }
}
