//! The preferences of the user.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use egui_tiles::Tree;
use serde::{Deserialize, Serialize};

use crate::information::EngineChoice;
use crate::studio::state::pane::Pane;

/// Length of the list of recent designs.
pub const RECENT: usize = 10;
/// Range of the interface zoom.
pub const ZOOM: std::ops::RangeInclusive<f32> = 0.5..=4.0;
/// Range of the number of compute threads.
pub const THREADS: std::ops::RangeInclusive<usize> = 1..=256;
/// Settings that are stored between sessions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Preferences {
    /// Recent design files, newest first.
    pub recent: Vec<PathBuf>,
    /// Theme: light, dark or that of the system.
    pub theme: egui::ThemePreference,
    /// Interface zoom.
    pub zoom: f32,
    /// Whether live estimates are computed.
    pub live: bool,
    /// Renderer from the next start on.
    pub renderer: RendererChoice,
    /// Whether zoom and cursor of object and measurement are linked.
    pub link_views: bool,
    /// Whether the welcome dialog was shown.
    pub welcomed: bool,
    /// Saved layouts by number.
    pub layouts: BTreeMap<usize, Tree<Pane>>,
    /// Number of compute threads; one per core if none is chosen.
    pub threads: Option<usize>,
    /// Engine of the PixelCNN.
    pub engine: EngineChoice,
    /// Folder of unsaved changes, instead of the default one.
    pub unsaved: Option<PathBuf>,
    /// Folder of the last study, which is opened again.
    pub study: Option<PathBuf>,
}

impl Default for Preferences {
    fn default() -> Self {
        Self {
            recent: Vec::new(),
            theme: egui::ThemePreference::System,
            zoom: 1.0,
            live: true,
            renderer: RendererChoice::default(),
            link_views: true,
            welcomed: false,
            layouts: BTreeMap::new(),
            threads: None,
            engine: EngineChoice::default(),
            unsaved: None,
            study: None,
        }
    }
}

impl Preferences {
    /// Moves a design file to the top of the recent ones.
    pub fn remember(&mut self, path: &Path) {
        // A relative path depends on the working folder.
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        self.recent.retain(|known| *known != path);
        self.recent.insert(0, path);
        self.recent.truncate(RECENT);
    }

    /// The preferences without paths that JSON cannot hold.
    pub fn storable(&self) -> Self {
        let is_text = |path: &PathBuf| path.to_str().is_some();
        let mut storable = self.clone();
        storable.recent.retain(is_text);
        storable.unsaved = storable.unsaved.filter(is_text);
        storable.study = storable.study.filter(is_text);
        storable
    }
}

/// Graphics interface that draws the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum RendererChoice {
    /// OpenGL; also the faster one for software rendering.
    #[default]
    Glow,
    /// Vulkan, Metal or DirectX 12.
    Wgpu,
}

impl RendererChoice {
    /// The renderer tried when this one does not start.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Glow => Self::Wgpu,
            Self::Wgpu => Self::Glow,
        }
    }

    /// Its name for eframe.
    pub fn renderer(self) -> eframe::Renderer {
        match self {
            Self::Glow => eframe::Renderer::Glow,
            Self::Wgpu => eframe::Renderer::Wgpu,
        }
    }

    /// Its name for display.
    pub fn name(self) -> &'static str {
        match self {
            Self::Glow => "OpenGL (glow)",
            Self::Wgpu => "wgpu",
        }
    }
}
