//! What the images show: colours and limits, the linked cursor, the drag on the mask.

use std::collections::BTreeSet;

use egui::TextureHandle;

use crate::optics::Lenslet;
use crate::studio::canvas::image_view::ImageView;
use crate::workbench::{CloserKey, Colormap};

/// The pictures, each with its own colours and limits.
pub struct Views {
    /// Point spread function under the lenslets.
    pub psf: ImageView,
    /// One object.
    pub object: ImageView,
    /// One measurement.
    pub measurement: ImageView,
    /// Two-dimensional transfer function.
    pub mtf: ImageView,
    /// Information of the pixels of a patch.
    pub information: ImageView,
}

/// A drag on the mask canvas.
pub enum MaskDrag {
    /// Lenslets are moved: their state when the drag began, and the pointer's place then, in PSF pixels.
    Move {
        /// Indices and lenslets.
        from: Vec<(usize, Lenslet)>,
        /// Pointer (x, y).
        start: (f64, f64),
        /// Whether the pointer has been farther from there than in a click: a long press trembles.
        begun: bool,
    },
    /// A box is drawn around lenslets, from this pointer place in PSF pixels.
    Select {
        /// Pointer (x, y).
        start: (f64, f64),
        /// What was selected before and stays so.
        kept: BTreeSet<usize>,
    },
}

/// What the room shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MtfView {
    /// Two cuts through frequency 0.
    #[default]
    Cuts,
    /// The whole transfer function.
    Map,
    /// The power spectrum of the shown measurement.
    Spectrum,
}

/// One of the linked pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// What is imaged.
    Object,
    /// What the sensor sees of it.
    Measurement,
}

/// Where the pointer is.
#[derive(Default)]
pub struct LinkedCursor(pub Option<CursorPlace>);

/// A place of the pointer.
#[derive(Clone, Copy, PartialEq)]
pub struct CursorPlace {
    pub side: Side,
    /// Pixel coordinates (x, y) of that picture.
    pub place: (f64, f64),
    /// When it was there: it is forgotten where the picture is no longer drawn.
    pub pass: u64,
}

impl Side {
    pub fn other(self) -> Self {
        match self {
            Self::Object => Self::Measurement,
            Self::Measurement => Self::Object,
        }
    }

    pub fn view(self, views: &mut Views) -> &mut ImageView {
        match self {
            Self::Object => &mut views.object,
            Self::Measurement => &mut views.measurement,
        }
    }
}

/// The overlay.
#[derive(Default)]
pub struct InformationOverlay {
    /// Whether it is wanted.
    pub shown: bool,
    pub texture: Option<TextureHandle>,
    pub drawn: Option<(CloserKey, Colormap)>,
    /// Bits of the most telling pixel.
    pub most: f32,
}
