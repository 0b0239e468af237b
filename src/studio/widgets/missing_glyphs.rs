//! Characters of file names that no font can draw.
//!
//! egui falls back to fonts of the system. If none has a character, it draws a box, and a message names the character.

use egui::{Context, TextStyle};

/// Maximal number of named characters.
const NAMED: usize = 6;

/// Message about the characters of a text that no font can draw.
pub fn missing_glyphs(ctx: &Context, text: &str) -> Option<String> {
    let font = TextStyle::Body.resolve(&ctx.global_style());
    let mut missing: Vec<char> = Vec::new();
    ctx.fonts_mut(|fonts| {
        for c in text.chars().filter(|c| !c.is_control() && !c.is_whitespace()) {
            if !missing.contains(&c) && !fonts.has_glyph(&font, c) {
                missing.push(c);
            }
        }
    });
    let codes: Vec<String> = missing.iter().take(NAMED).map(|&c| format!("U+{:04X}", u32::from(c))).collect();
    let more = if missing.len() > NAMED { " and others" } else { "" };
    (!missing.is_empty()).then(|| {
        format!(
            "This system has no font for {}{more} in file names; boxes replace them. Install a font for the script and restart the program.",
            codes.join(" ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn message_names_characters_without_font() {
        let ctx = Context::default();
        let mut sentences = Vec::new();
        // System fonts are not loaded here.
        let mut output = ctx.run_ui(egui::RawInput::default(), |ui| {
            for text in [
                "Entwurf für Müller, 9 µm.json",
                "\u{8bbe}\u{8ba1}\u{8bbe}.json",
                "\u{3042}\u{3044}\u{3046}\u{3048}\u{304a}\u{304b}\u{304d}",
            ] {
                sentences.push(missing_glyphs(ui.ctx(), text));
            }
        });
        output.textures_delta.clear();
        assert_eq!(sentences[0], None);
        assert!(sentences[1].as_ref().unwrap().contains("no font for U+8BBE U+8BA1 in"), "{sentences:?}");
        assert!(sentences[2].as_ref().unwrap().contains("U+3046 U+3048 U+304A U+304B and others"), "{sentences:?}");
    }
}
