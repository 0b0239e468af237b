//! The panels of the window.

use serde::{Deserialize, Serialize};

/// A panel. Layout files store its title.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "&'static str")]
pub enum Pane {
    /// The PSF plane with the lenslets.
    Mask,
    /// The lenslets as numbers.
    Lenslets,
    /// One object.
    Object,
    /// One measurement.
    Measurement,
    /// What a decoder makes of it.
    Reconstruction,
    /// Objects and sensor.
    Scene,
    /// Information and Tamura coefficient.
    Information,
    /// Modulation transfer function.
    Mtf,
    /// Information after each edit.
    History,
    /// Estimates that take minutes.
    Estimates,
    /// Information of each pixel of a patch.
    InformationMap,
    /// Optimization runs.
    Optimize,
    /// Designs side by side.
    Compare,
    /// Plans of many estimates.
    Studies,
    /// Calibration and captures of cameras.
    Camera,
    /// A panel of another version, from its layout file.
    Unknown,
}

impl From<String> for Pane {
    fn from(title: String) -> Self {
        Self::ALL.into_iter().find(|pane| pane.title() == title).unwrap_or(Self::Unknown)
    }
}

impl From<Pane> for &'static str {
    fn from(pane: Pane) -> Self {
        pane.title()
    }
}

impl Pane {
    /// All panels.
    pub const ALL: [Self; 15] = [
        Self::Mask,
        Self::Lenslets,
        Self::Object,
        Self::Measurement,
        Self::Reconstruction,
        Self::Information,
        Self::Scene,
        Self::Optimize,
        Self::Estimates,
        Self::InformationMap,
        Self::Mtf,
        Self::History,
        Self::Compare,
        Self::Studies,
        Self::Camera,
    ];

    /// Title of the tab.
    pub fn title(self) -> &'static str {
        match self {
            Self::Mask => "Mask",
            Self::Lenslets => "Lenslets",
            Self::Object => "Object",
            Self::Measurement => "Measurement",
            Self::Reconstruction => "Reconstruction",
            Self::Scene => "Scene",
            Self::Information => "Information",
            Self::Mtf => "MTF",
            Self::History => "History",
            Self::Estimates => "Estimates",
            Self::InformationMap => "Map",
            Self::Optimize => "Optimize",
            Self::Compare => "Compare",
            Self::Studies => "Studies",
            Self::Camera => "Camera",
            Self::Unknown => "Unknown",
        }
    }
}
