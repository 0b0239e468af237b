//! The preferences: what is chosen once and kept between sessions.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use egui_tiles::Tree;
use serde::{Deserialize, Serialize};

use crate::information::EngineChoice;
use crate::studio::state::pane::Pane;

/// Designs that are remembered.
pub const RECENT: usize = 10;
/// Sizes of everything that one can see and read.
pub const ZOOM: std::ops::RangeInclusive<f32> = 0.5..=4.0;
/// Threads that one can choose.
pub const THREADS: std::ops::RangeInclusive<usize> = 1..=256;
/// What a person has chosen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Preferences {
    /// Design files, the newest first.
    pub recent: Vec<PathBuf>,
    /// Light, dark, or that of the system.
    pub theme: egui::ThemePreference,
    /// Size of everything.
    pub zoom: f32,
    /// Whether live estimates are computed.
    pub live: bool,
    /// What draws the window from the next start on.
    pub renderer: RendererChoice,
    /// Whether object and measurement show the same place.
    pub link_views: bool,
    /// Whether the first window has asked what to start from.
    pub welcomed: bool,
    /// Arrangements of rooms that are remembered, by number.
    pub layouts: BTreeMap<usize, Tree<Pane>>,
    /// Threads for everything that computes; as many as there are cores where none is chosen.
    pub threads: Option<usize>,
    /// What computes networks of the published kind.
    pub engine: EngineChoice,
    /// Folder for unsaved changes in place of the usual one.
    pub unsaved: Option<PathBuf>,
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
        }
    }
}

impl Preferences {
    /// Puts a design file first.
    pub fn remember(&mut self, path: &Path) {
        // A path that is relative today means another file tomorrow.
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        self.recent.retain(|known| *known != path);
        self.recent.insert(0, path);
        self.recent.truncate(RECENT);
    }

    /// What of them JSON can hold: not paths that are no Unicode.
    pub fn storable(&self) -> Self {
        let is_text = |path: &PathBuf| path.to_str().is_some();
        let mut storable = self.clone();
        storable.recent.retain(is_text);
        storable.unsaved = storable.unsaved.filter(is_text);
        storable
    }
}

/// Which graphics interface draws the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RendererChoice {
    /// OpenGL; also the faster one where the processor draws.
    #[default]
    Glow,
    /// Vulkan, Metal or DirectX 12.
    Wgpu,
}

impl RendererChoice {
    /// The renderer that is tried when this one does not start.
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

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Glow => "OpenGL (glow)",
            Self::Wgpu => "wgpu",
        }
    }
}
