//! Opens the compute backend of a name.

use super::burn_engine::BurnEngine;
use super::cpu_engine::CpuEngine;
use super::engine::Engine;
use crate::information::engine_choice::EngineChoice;
use crate::information::error::InformationError;

impl EngineChoice {
    /// Opens the engine.
    ///
    /// # Errors
    /// When this program was built without the engine, or this machine has no device for it.
    pub fn open(self) -> Result<Box<dyn Engine>, InformationError> {
        Ok(match self {
            Self::Cpu => Box::new(CpuEngine::default()),
            Self::Burn(device) => Box::new(BurnEngine::open(device)?),
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::information::engine_choice::{BurnDevice, EngineChoice};

    #[test]
    fn missing_engine_is_refused_with_advice() {
        for (choice, feature, built_in) in [
            (EngineChoice::Burn(BurnDevice::Wgpu), "gpu", cfg!(feature = "gpu")),
            (EngineChoice::Burn(BurnDevice::Cuda), "cuda", cfg!(feature = "cuda")),
        ] {
            if !built_in {
                let error = choice.open().map(|engine| engine.choice()).unwrap_err().to_string();
                let parts = [choice.name(), &format!("--features {feature}"), "cpu"];
                assert!(parts.iter().all(|part| error.contains(part)), "{error}");
            }
        }
    }
}
