//! Plans: studies as cells over axes, from a TOML file or by name, computed here or by the tasks of a job array.
//!
//! A [`Plan`] crosses the values of its axes to cells. Each cell is one estimate, and the image quality of one decoder where
//! the plan has decoders. Its result is one JSON file in the [`StudyFolder`], named by the content of its settings. Therefore any number of
//! processes may fill one folder, in any order, without locks.

mod axes;
mod cell;
mod correlation;
mod estimates;
mod facet;
mod figure;
mod folder;
mod ideal;
mod ideal_settings;
mod named;
mod paint;
mod plan;
mod reconstruction;
mod run;
mod scatter;
mod shard;
mod shared;
mod size;
mod slurm;
mod study_decoder;
mod table;

pub use axes::{Axes, Axis};
pub use cell::{CellRecord, CellSettings, Freedom, StudyMask};
pub use correlation::{CORRELATION_HEADER, Correlation, correlations};
pub use estimates::EstimateSettings;
pub use facet::Facet;
pub use figure::{Figure, Panel, Point, Quantity, Series, Tick, figure_of, published_value};
pub use folder::{CellState, StudyFolder};
pub use named::{NamedPlan, named_plans};
pub use paint::{png, svg, write_figure};
pub use plan::{Plan, PlotSettings, QuickSettings, times_of};
pub use reconstruction::ReconstructionSettings;
pub use run::{PlanEvent, RunSummary, run_cells};
pub use shard::Shard;
pub use size::SizeChoice;
pub use slurm::{BatchScript, shards_of_script};
pub use study_decoder::StudyDecoder;
pub use table::{CSV_HEADER, StudyTable};

#[cfg(test)]
mod decoder_tests;
#[cfg(test)]
mod tests;
