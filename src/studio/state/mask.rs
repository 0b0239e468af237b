//! State of the Mask panel.

use std::collections::BTreeSet;

use crate::optics::Lenslet;
use crate::studio::canvas::image_view::ImageView;
use crate::workbench::Colormap;

/// State of the Mask panel.
pub struct MaskState {
    /// Point spread function under the lenslets.
    pub psf: ImageView,
    /// Whether gradient arrows are shown.
    pub arrows: bool,
    /// The current drag.
    pub drag: Option<MaskDrag>,
}

impl Default for MaskState {
    fn default() -> Self {
        Self { psf: ImageView::new("PSF", "", Colormap::Viridis), arrows: true, drag: None }
    }
}

/// A drag on the mask canvas.
pub enum MaskDrag {
    /// Lenslets are moved: their state and the pointer position at the start of the drag, PSF pixels.
    Move {
        /// Indices and lenslets.
        from: Vec<(usize, Lenslet)>,
        /// Pointer (x, y).
        start: (f64, f64),
        /// Whether the pointer has left the reach of a click.
        begun: bool,
    },
    /// A selection box is drawn from this pointer position, PSF pixels.
    Select {
        /// Pointer (x, y).
        start: (f64, f64),
        /// Selection before the drag, which stays.
        before: BTreeSet<usize>,
    },
}
