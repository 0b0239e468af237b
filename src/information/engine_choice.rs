//! Names of the compute backends of a `PixelCNN`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Error for a name that no engine has.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("unknown engine {found:?}; write cpu, burn:ndarray, burn:wgpu or burn:cuda")]
pub struct UnknownEngine {
    /// The name.
    pub found: String,
}

/// Compute backend of a `PixelCNN`. Its names are stable: the command line and files use them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(into = "String", try_from = "String")]
pub enum EngineChoice {
    /// `cpu`: the fused kernels of [`crate::nn`], on all threads. Equal seeds give equal bits.
    #[default]
    Cpu,
    /// `burn:` and a device name: the same network in burn.
    Burn(BurnDevice),
}

impl EngineChoice {
    /// Engines built into this program. Opening an engine checks that its device exists.
    pub fn built() -> Vec<Self> {
        let burn = [
            Some(BurnDevice::Ndarray),
            cfg!(feature = "gpu").then_some(BurnDevice::Wgpu),
            cfg!(feature = "cuda").then_some(BurnDevice::Cuda),
        ];
        std::iter::once(Self::Cpu).chain(burn.into_iter().flatten().map(Self::Burn)).collect()
    }
}

/// A compute device of burn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BurnDevice {
    /// `burn:ndarray`: the processor, through ndarray.
    Ndarray,
    /// `burn:wgpu`: a graphics card, through Vulkan, Metal or DirectX 12; needs the cargo feature `gpu`.
    Wgpu,
    /// `burn:cuda`: an NVIDIA card, through CUDA; needs the cargo feature `cuda`.
    Cuda,
}

impl EngineChoice {
    /// All engines, built in or not.
    pub const ALL: [Self; 4] =
        [Self::Cpu, Self::Burn(BurnDevice::Ndarray), Self::Burn(BurnDevice::Wgpu), Self::Burn(BurnDevice::Cuda)];

    /// Name of the engine, as in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Burn(BurnDevice::Ndarray) => "burn:ndarray",
            Self::Burn(BurnDevice::Wgpu) => "burn:wgpu",
            Self::Burn(BurnDevice::Cuda) => "burn:cuda",
        }
    }
}

impl fmt::Display for EngineChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for EngineChoice {
    type Err = UnknownEngine;

    fn from_str(text: &str) -> Result<Self, UnknownEngine> {
        Self::ALL
            .into_iter()
            .find(|choice| choice.name() == text)
            .ok_or_else(|| UnknownEngine { found: text.to_owned() })
    }
}

impl From<EngineChoice> for String {
    fn from(choice: EngineChoice) -> Self {
        choice.name().to_owned()
    }
}

impl TryFrom<String> for EngineChoice {
    type Error = UnknownEngine;

    fn try_from(text: String) -> Result<Self, UnknownEngine> {
        // Files of older versions can name burn's own processor kernels.
        if text == "burn:flex" { Ok(Self::Burn(BurnDevice::Ndarray)) } else { text.parse() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn engines_have_stable_names() {
        for choice in EngineChoice::ALL {
            assert_eq!(choice.to_string().parse(), Ok(choice));
            let json = serde_json::to_string(&choice).unwrap();
            assert_eq!(json, format!("\"{choice}\""));
            assert_eq!(serde_json::from_str::<EngineChoice>(&json).unwrap(), choice);
        }
        for wrong in ["", "gpu", "burn", "burn:", "CPU", "burn:cuda:0"] {
            let error = wrong.parse::<EngineChoice>().unwrap_err().to_string();
            assert!(error.contains(&format!("{wrong:?}")) && error.contains("burn:ndarray"), "{error}");
        }
    }

    #[test]
    fn removed_engine_of_old_files_is_read_as_burn_ndarray() {
        let read: EngineChoice = serde_json::from_str("\"burn:flex\"").unwrap();
        assert_eq!(read, EngineChoice::Burn(BurnDevice::Ndarray));
    }
}
