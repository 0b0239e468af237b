//! The state of each panel.

use crate::studio::state::comparison::CompareState;
use crate::studio::state::estimate_form::EstimatesState;
use crate::studio::state::image_panels::{InformationMapState, MtfState};
use crate::studio::state::mask_panel::MaskPanelState;
use crate::studio::state::optimize_form::OptimizeState;
use crate::studio::state::samples::SamplesState;
use crate::studio::state::selection::Selection;

/// The state of each panel. A panel gets its own part; only mask and lenslet table share one, the selection.
#[derive(Default)]
pub struct Panels {
    /// The selected lenslets.
    pub selection: Selection,
    /// Mask.
    pub mask: MaskPanelState,
    /// Object and Measurement.
    pub samples: SamplesState,
    /// MTF.
    pub mtf: MtfState,
    /// Map.
    pub map: InformationMapState,
    /// Estimates.
    pub estimates: EstimatesState,
    /// Optimize.
    pub optimize: OptimizeState,
    /// Compare.
    pub compare: CompareState,
}
