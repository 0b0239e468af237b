//! Images on screen: colours, display range, zoom, overlays.

pub mod display_range;
pub mod image_view;
pub mod overlays;
pub mod pan_zoom;
pub mod viewport;
