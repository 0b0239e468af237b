//! State of the panels MTF and Map.

use crate::studio::canvas::image_view::ImageView;
use crate::workbench::{Colormap, LiveEstimate};
use ndarray::{ArrayView2, Axis};

/// State of the MTF panel.
pub struct MtfState {
    /// What it shows.
    pub mode: MtfMode,
    /// Two-dimensional transfer function.
    pub image: ImageView,
}

impl Default for MtfState {
    fn default() -> Self {
        Self { mode: MtfMode::default(), image: ImageView::new("MTF map", "", Colormap::Viridis) }
    }
}

/// What the MTF panel shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MtfMode {
    /// Two cuts through frequency 0.
    #[default]
    Cuts,
    /// The whole transfer function.
    Map,
    /// The power spectrum of the shown measurement.
    Spectrum,
}

/// State of the Map panel.
pub struct InformationMapState {
    /// Information of the pixels of a patch.
    pub image: ImageView,
    /// Index of the patch; none for the mean over all patches.
    pub patch: Option<usize>,
}

impl Default for InformationMapState {
    fn default() -> Self {
        Self { image: ImageView::new("Information map", "bits", Colormap::Inferno), patch: None }
    }
}

impl InformationMapState {
    /// Index of the shown patch, if the estimate has it.
    pub fn shown_patch(&self, live: &LiveEstimate) -> Option<usize> {
        self.patch.filter(|&patch| patch < live.maps.len_of(Axis(0)))
    }

    /// The shown map, bits, shape (rows, cols).
    pub fn map_of<'a>(&self, live: &'a LiveEstimate) -> ArrayView2<'a, f32> {
        match self.shown_patch(live) {
            Some(patch) => live.maps.index_axis(Axis(0), patch),
            None => live.mean_map.view(),
        }
    }
}
