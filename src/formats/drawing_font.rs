//! The font of drawings (SVG, PNG).

use std::sync::Once;

use plotters::style::{FontStyle, register_font};

/// Family of all texts. Texts are measured by the program's own font; a viewer of the SVG takes its own sans-serif.
pub const DRAWING_FONT: &str = "sans-serif";

/// Makes the font known to the drawing library. A drawing without it fails.
pub fn use_drawing_font() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // The font is complete, as the program contains it; without it a drawing says that its font is missing.
        let _ = register_font(DRAWING_FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
    });
}
