//! The comparison of snapshots.

use std::collections::HashMap;

use egui::TextureHandle;

use crate::studio::canvas::image_view::ImageView;
use crate::studio::canvas::viewport::Viewport;
use crate::workbench::Colormap;

/// State of the Compare panel.
pub struct Comparison {
    /// Numbers of the two designs.
    pub pair: [Option<u64>; 2],
    pub side: ComparedSide,
    pub what: Quantity,
    /// The user has just chosen a design or the measurement: failed simulations are repeated.
    pub tries_again: bool,
    pub image: ImageView,
    pub difference: ImageView,
    /// Their common zoom and pan.
    pub viewport: Viewport,
    pub thumbnails: HashMap<u64, TextureHandle>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub enum ComparedSide {
    A,
    B,
    Difference,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    Psf,
    Measurement,
    Mtf,
}

impl Default for Comparison {
    fn default() -> Self {
        Self {
            pair: [None; 2],
            side: ComparedSide::A,
            what: Quantity::Psf,
            tries_again: false,
            image: ImageView::new("Comparison", "", Colormap::Viridis),
            difference: ImageView::new("Difference", "", Colormap::Diverging),
            viewport: Viewport::default(),
            thumbnails: HashMap::new(),
        }
    }
}
