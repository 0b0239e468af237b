//! What a fit and a score ask of whatever computes a `PixelCNN`, and the names of those that can.

use std::fmt;
use std::str::FromStr;

use ndarray::ArrayView3;
use serde::{Deserialize, Serialize};

use super::burn_engine::BurnEngine;
use super::cpu_engine::CpuEngine;
use super::model::PixelCnn;
use crate::information::InformationError;

/// Computes losses and gradients of a [`PixelCnn`]; weights and gradients are in the order of [`PixelCnn::layout`],
/// whatever computes them, so the rules by which weights move are the same for all.
pub trait Engine {
    /// Which one it is.
    fn choice(&self) -> EngineChoice;

    /// Mean negative log density of `patches` (photons per pixel, shape (n, rows, cols)), nats per pixel.
    ///
    /// Its gradient by all weights is written to `gradient`, that by the patches (per photon) to `by_patch` where it is
    /// given. Values that are not finite give a loss that is not finite, without an error.
    ///
    /// # Errors
    /// Where a device fails, such as a graphics card without memory.
    fn loss_and_gradients(
        &mut self,
        model: &PixelCnn,
        patches: ArrayView3<'_, f32>,
        gradient: &mut [f32],
        by_patch: Option<&mut [f32]>,
    ) -> Result<f64, InformationError>;

    /// Cross-entropy of each patch, `-log2 p(y)` in bits per pixel, as [`PixelCnn::cross_entropy_bits`].
    ///
    /// # Errors
    /// As [`PixelCnn::cross_entropy_bits`], and where a device fails.
    fn cross_entropy_bits(
        &mut self,
        model: &PixelCnn,
        patches: ArrayView3<'_, f32>,
    ) -> Result<Vec<f64>, InformationError>;
}

/// What computes a `PixelCNN`. The names are stable: they are those of the command line and of files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum EngineChoice {
    /// `cpu`: the fused passes of [`crate::network`], on all threads. Equal seeds give equal bits.
    #[default]
    Cpu,
    /// `burn:` and the name of a device: the same network in burn.
    Burn(BurnDevice),
}

impl EngineChoice {
    /// Those that this program was built with; whether a card is there is told when one is opened.
    pub fn built() -> Vec<Self> {
        let burn = [
            Some(BurnDevice::Ndarray),
            cfg!(feature = "flex").then_some(BurnDevice::Flex),
            cfg!(feature = "gpu").then_some(BurnDevice::Wgpu),
            cfg!(feature = "cuda").then_some(BurnDevice::Cuda),
        ];
        std::iter::once(Self::Cpu).chain(burn.into_iter().flatten().map(Self::Burn)).collect()
    }
}

/// A device that burn computes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BurnDevice {
    /// `burn:ndarray`: the processor, through ndarray.
    Ndarray,
    /// `burn:flex`: the processor, through burn's own kernels; needs the cargo feature `flex`.
    Flex,
    /// `burn:wgpu`: a graphics card, through Vulkan, Metal or DirectX 12; needs the cargo feature `gpu`.
    Wgpu,
    /// `burn:cuda`: an NVIDIA card, through CUDA; needs the cargo feature `cuda`.
    Cuda,
}

impl EngineChoice {
    /// All of them, whether this program was built with them or not.
    pub const ALL: [Self; 5] = [
        Self::Cpu,
        Self::Burn(BurnDevice::Ndarray),
        Self::Burn(BurnDevice::Flex),
        Self::Burn(BurnDevice::Wgpu),
        Self::Burn(BurnDevice::Cuda),
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Burn(BurnDevice::Ndarray) => "burn:ndarray",
            Self::Burn(BurnDevice::Flex) => "burn:flex",
            Self::Burn(BurnDevice::Wgpu) => "burn:wgpu",
            Self::Burn(BurnDevice::Cuda) => "burn:cuda",
        }
    }

    /// Makes it ready to compute.
    ///
    /// # Errors
    /// Where this program was built without it, or this machine has no device for it.
    pub fn open(self) -> Result<Box<dyn Engine>, InformationError> {
        Ok(match self {
            Self::Cpu => Box::new(CpuEngine::default()),
            Self::Burn(device) => Box::new(BurnEngine::open(device)?),
        })
    }
}

impl fmt::Display for EngineChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for EngineChoice {
    type Err = InformationError;

    fn from_str(text: &str) -> Result<Self, InformationError> {
        Self::ALL
            .into_iter()
            .find(|choice| choice.name() == text)
            .ok_or_else(|| InformationError::UnknownEngine { found: text.to_owned() })
    }
}

impl From<EngineChoice> for String {
    fn from(choice: EngineChoice) -> Self {
        choice.name().to_owned()
    }
}

impl TryFrom<String> for EngineChoice {
    type Error = InformationError;

    fn try_from(text: String) -> Result<Self, InformationError> {
        text.parse()
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
            let told = wrong.parse::<EngineChoice>().unwrap_err().to_string();
            assert!(told.contains(&format!("{wrong:?}")) && told.contains("burn:ndarray"), "{told}");
        }
    }

    #[test]
    fn an_engine_that_was_not_built_in_is_refused_with_advice() {
        for (choice, feature, built_in) in [
            (EngineChoice::Burn(BurnDevice::Wgpu), "gpu", cfg!(feature = "gpu")),
            (EngineChoice::Burn(BurnDevice::Cuda), "cuda", cfg!(feature = "cuda")),
        ] {
            if !built_in {
                let told = choice.open().map(|engine| engine.choice()).unwrap_err().to_string();
                let parts = [choice.name(), &format!("--features {feature}"), "cpu"];
                assert!(parts.iter().all(|part| told.contains(part)), "{told}");
            }
        }
    }
}
