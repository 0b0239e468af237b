//! Summary of the cells of a study.

use serde::Serialize;

use crate::studies::comparison::record::StudyCell;
use crate::studies::comparison::settings::StudySettings;
use crate::studies::rank::spearman;

use crate::plural::counted;

/// Distances above the published value within which an estimate counts, bits per pixel.
const MARGINS: [f64; 3] = [0.02, 0.005, 0.0];

/// Summary of the cells computed so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct StudySummary {
    /// Cells of the settings.
    pub cells: usize,
    /// Cells with an estimate.
    pub estimated: usize,
    /// Cells that failed.
    pub failed: usize,
    /// Estimates above the object-entropy bound. They are loose, and designs must not be ranked by them.
    pub above_ceiling: usize,
    /// Number of estimates that are as low as the published ones, by margin.
    pub within_published: Vec<WithinPublished>,
    /// Whether the density model puts designs in the published order, by objects.
    pub rank_correlations: Vec<RankCorrelation>,
}

/// Estimates at or below the published value and a margin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct WithinPublished {
    /// The margin, bits per pixel.
    pub margin: f64,
    /// Estimates with a published value.
    pub compared: usize,
    /// Estimates at or below the published value and the margin.
    pub within: usize,
    /// The same number by the density model alone.
    pub within_by_density: usize,
    /// Their share, 0 to 1.
    pub share: f64,
}

/// Agreement with the published order of the designs for one set of objects.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct RankCorrelation {
    /// The objects.
    pub objects: String,
    /// Designs with an estimate and a published value.
    pub designs: usize,
    /// Spearman's rank correlation, -1 to 1.
    pub spearman: f64,
}

impl StudySummary {
    /// Summary of these cells.
    pub(super) fn of(settings: &StudySettings, cells: &[StudyCell]) -> Self {
        let estimated = cells.iter().filter(|cell| cell.estimate.is_some()).count();
        let above = |cell: &&StudyCell| cell.estimate.as_ref().is_some_and(crate::information::Estimate::above_ceiling);
        Self {
            cells: settings.cells(),
            estimated,
            failed: cells.len() - estimated,
            above_ceiling: cells.iter().filter(above).count(),
            within_published: within_published(cells),
            rank_correlations: rank_correlations(settings, cells),
        }
    }

    /// One sentence for each result, for people.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!(
            "{} of {} with an estimate, {} failed",
            self.estimated,
            counted(self.cells, "cell"),
            self.failed
        )];
        if self.above_ceiling > 0 {
            lines.push(format!(
                "{} of {} above the entropy bound: loose there, so do not rank designs by them",
                self.above_ceiling,
                counted(self.estimated, "estimate")
            ));
        }
        lines.extend(self.within_published.iter().map(|row| {
            format!(
                "{} of {} ({:.0} %) at most the published value + {} bits per pixel, {} by the density model alone",
                row.within,
                counted(row.compared, "estimate"),
                100.0 * row.share,
                row.margin,
                row.within_by_density
            )
        }));
        lines.extend(self.rank_correlations.iter().map(|row| {
            let RankCorrelation { objects, designs, spearman } = row;
            format!(
                "{objects}: rank correlation with the published order of {} {spearman:.2}",
                counted(*designs, "design")
            )
        }));
        lines
    }
}

/// The two sides of a comparison: the number of a cell and the published value.
fn beside_published(cell: &StudyCell, bits: Option<f64>) -> Option<(f64, f64)> {
    bits.zip(cell.published.map(|published| published.bits_per_pixel))
}

/// The density model's bound of a cell, and the published value, which is a density model's bound, too.
fn densities(cell: &StudyCell) -> Option<(f64, f64)> {
    beside_published(cell, cell.model_bits())
}

fn within_published(cells: &[StudyCell]) -> Vec<WithinPublished> {
    let best: Vec<_> = cells.iter().filter_map(|cell| beside_published(cell, cell.bits_per_pixel())).collect();
    if best.is_empty() {
        return Vec::new();
    }
    let alone: Vec<_> = cells.iter().filter_map(densities).collect();
    let count = |margin: f64| {
        let within =
            |pairs: &[(f64, f64)]| pairs.iter().filter(|(ours, published)| *ours <= published + margin).count();
        let (within, within_by_density) = (within(&best), within(&alone));
        let (compared, share) = (best.len(), within as f64 / best.len() as f64);
        WithinPublished { margin, compared, within, within_by_density, share }
    };
    MARGINS.map(count).to_vec()
}

fn rank_correlations(settings: &StudySettings, cells: &[StudyCell]) -> Vec<RankCorrelation> {
    let sources = settings.objects.iter().map(|objects| objects.source.to_string());
    sources
        .filter_map(|objects| {
            let of_objects = cells.iter().filter(|cell| cell.objects == objects);
            let pairs: Vec<(f64, f64)> = of_objects.filter_map(densities).collect();
            spearman(&pairs).map(|spearman| RankCorrelation { objects, designs: pairs.len(), spearman })
        })
        .collect()
}
