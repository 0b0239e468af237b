//! Copies to the clipboard of the system.
//!
//! egui copies from text fields and reports no failures. Buttons and menus copy from here, and failures are reported.

/// A clipboard for texts.
#[derive(Default)]
pub enum Clipboard {
    /// The clipboard of egui: on Wayland, which reports no failure, and in tests.
    #[default]
    OfEgui,
    /// The clipboard of the system.
    OfSystem(arboard::Clipboard),
    /// No system clipboard, for this reason; texts can be pasted in this window only.
    Missing(String),
}

impl Clipboard {
    /// The clipboard of the system.
    pub fn of_system() -> Self {
        match arboard::Clipboard::new() {
            Ok(clipboard) => Self::OfSystem(clipboard),
            Err(error) => Self::Missing(error.to_string()),
        }
    }

    /// Copies a text.
    ///
    /// # Errors
    /// The reason if other programs cannot paste it.
    pub fn put(&mut self, ctx: &egui::Context, text: String) -> Result<(), String> {
        match self {
            Self::OfEgui => {
                ctx.copy_text(text);
                Ok(())
            }
            Self::OfSystem(clipboard) => clipboard.set_text(text).map_err(|error| error.to_string()),
            Self::Missing(reason) => {
                ctx.copy_text(text);
                Err(reason.clone())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_system_copy_is_reported() {
        let copied = |clipboard: &mut Clipboard| {
            let ctx = egui::Context::default();
            let mut answer = Ok(());
            let mut output =
                ctx.run_ui(egui::RawInput::default(), |ui| answer = clipboard.put(ui.ctx(), "0.46".into()));
            output.textures_delta.clear();
            let is_there = output.platform_output.commands.contains(&egui::OutputCommand::CopyText("0.46".into()));
            (answer, is_there)
        };
        assert_eq!(copied(&mut Clipboard::default()), (Ok(()), true));
        let mut missing = Clipboard::Missing("no server answers".into());
        assert_eq!(copied(&mut missing), (Err("no server answers".into()), true));
    }
}
