//! The burn device of a name, and whether this machine has it.

use std::panic::{AssertUnwindSafe, catch_unwind};

use burn::tensor::Device;

use crate::information::engine_choice::{BurnDevice, EngineChoice};
use crate::information::error::InformationError;

/// Runs `work` on a device and turns a panic into an error: burn's devices panic where memory or drivers fail.
///
/// # Errors
/// That of `work`, or the first line of the panic.
pub(crate) fn guarded<T>(
    engine: EngineChoice,
    work: impl FnOnce() -> Result<T, String>,
) -> Result<T, InformationError> {
    let message = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(value)) => return Ok(value),
        Ok(Err(message)) => message,
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("the device failed").to_owned()
        }
    };
    // The lines after the first name the place in the libraries.
    let message = message.lines().next().unwrap_or_default();
    let reason = format!("{message}; check its driver and free memory, or choose the engine cpu");
    Err(InformationError::Engine { engine, reason })
}

/// The device of this name.
///
/// # Errors
/// Where this program was built without it, or this machine has none.
pub(crate) fn open_device(device: BurnDevice) -> Result<Device, InformationError> {
    match device {
        // burn advises its flex device instead, whose kernels take minutes more to compile.
        #[allow(deprecated, reason = "the device that is compiled within a bearable time")]
        BurnDevice::Ndarray => Ok(Device::ndarray()),
        BurnDevice::Wgpu => wgpu(),
        BurnDevice::Cuda => cuda(),
    }
}

#[cfg(not(feature = "gpu"))]
fn wgpu() -> Result<Device, InformationError> {
    Err(InformationError::EngineNotBuilt { engine: EngineChoice::Burn(BurnDevice::Wgpu), feature: "gpu" })
}

/// The best graphics card, if there is one: a software driver would be slower than the processor without it.
#[cfg(feature = "gpu")]
fn wgpu() -> Result<Device, InformationError> {
    use burn::tensor::{DeviceKind, DeviceType};
    let found = Device::enumerate(DeviceType::Wgpu).into_vec();
    check_cards(&found, &Device::wgpu(DeviceKind::Cpu))?;
    let kinds = [DeviceKind::DiscreteGpu(0), DeviceKind::IntegratedGpu(0), DeviceKind::VirtualGpu(0)];
    let best = kinds.into_iter().map(Device::wgpu).find(|device| found.contains(device));
    Ok(best.unwrap_or_else(|| Device::wgpu(DeviceKind::DefaultDevice)))
}

/// Checks that a card was found: at least one device other than the `software` driver.
#[cfg_attr(not(feature = "gpu"), allow(dead_code, reason = "tested in every build"))]
fn check_cards<D: PartialEq>(found: &[D], software: &D) -> Result<(), InformationError> {
    let reason = if found.is_empty() {
        "no graphics driver was found; install one, or choose the engine cpu"
    } else if found.iter().all(|device| device == software) {
        "only a software driver was found and no graphics card; choose the engine cpu, which is faster"
    } else {
        return Ok(());
    };
    Err(InformationError::Engine { engine: EngineChoice::Burn(BurnDevice::Wgpu), reason: reason.into() })
}

#[cfg(not(feature = "cuda"))]
fn cuda() -> Result<Device, InformationError> {
    Err(InformationError::EngineNotBuilt { engine: EngineChoice::Burn(BurnDevice::Cuda), feature: "cuda" })
}

/// The first NVIDIA card, if there is one.
#[cfg(feature = "cuda")]
fn cuda() -> Result<Device, InformationError> {
    use burn::tensor::DeviceType;
    Device::enumerate(DeviceType::Cuda).into_vec().into_iter().next().ok_or_else(|| InformationError::Engine {
        engine: EngineChoice::Burn(BurnDevice::Cuda),
        reason: "no NVIDIA card with its driver was found; choose burn:wgpu or cpu".into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn software_drivers_are_no_cards() {
        let checked = |found: &[&str]| check_cards(found, &"software").map_err(|error| error.to_string());
        assert_eq!(checked(&["card"]), Ok(()));
        assert_eq!(checked(&["software", "card"]), Ok(()));
        let refused = checked(&["software", "software"]).unwrap_err();
        assert!(refused.contains("only a software driver") && refused.contains("engine cpu"), "{refused}");
        assert!(checked(&[]).unwrap_err().contains("no graphics driver"));
    }
}
