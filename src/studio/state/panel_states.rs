//! The state of each panel.

use crate::studio::state::camera::CameraState;
use crate::studio::state::compare::CompareState;
use crate::studio::state::estimates::EstimatesState;
use crate::studio::state::mask::MaskState;
use crate::studio::state::mtf_and_map::{InformationMapState, MtfState};
use crate::studio::state::optimize::OptimizeState;
use crate::studio::state::samples::SamplesState;
use crate::studio::state::selection::Selection;
use crate::studio::state::studies::StudiesState;

/// The state of each panel. A panel gets its own part; only mask and lenslet table share one, the selection.
#[derive(Default)]
pub struct Panels {
    /// The selected lenslets.
    pub selection: Selection,
    /// Mask.
    pub mask: MaskState,
    /// Object, Measurement and Reconstruction.
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
    /// Studies.
    pub studies: StudiesState,
    /// Camera.
    pub camera: CameraState,
}
