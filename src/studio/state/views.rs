//! State of the images: colours, display range, linked cursor, drag on the mask.

use std::collections::BTreeSet;

use egui::TextureHandle;

use crate::optics::Lenslet;
use crate::studio::canvas::image_view::ImageView;
use crate::workbench::{Colormap, InspectionKey};

/// The images, each with its own colours and display range.
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

/// View of the MTF panel.
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

/// One of the two linked images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The object.
    Object,
    /// Its measurement.
    Measurement,
}

/// Position of the pointer in one of the linked images.
#[derive(Default)]
pub struct LinkedCursor(pub Option<CursorPlace>);

/// A pointer position.
#[derive(Clone, Copy, PartialEq)]
pub struct CursorPlace {
    pub side: Side,
    /// Pixel coordinates (x, y) of that image.
    pub place: (f64, f64),
    /// egui pass of the position, which expires when the image is no longer drawn.
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

/// The information overlay of the measurement.
#[derive(Default)]
pub struct InformationOverlay {
    /// Whether it is switched on.
    pub shown: bool,
    pub texture: Option<TextureHandle>,
    pub drawn: Option<(InspectionKey, Colormap)>,
    /// Information of the most informative pixel, bits.
    pub most: f32,
}
