//! Which device of burn a name means, and whether it is there.

use burn::tensor::Device;

use super::super::engine::{BurnDevice, EngineChoice};
use crate::information::InformationError;

/// The device of this name.
pub(super) fn open_device(device: BurnDevice) -> Result<Device, InformationError> {
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
    let missing = |reason: &str| {
        Err(InformationError::Engine { engine: EngineChoice::Burn(BurnDevice::Wgpu), reason: reason.into() })
    };
    if found.is_empty() {
        return missing("no graphics driver was found; install one, or choose the engine cpu");
    }
    let software = Device::wgpu(DeviceKind::Cpu);
    if found.iter().all(|device| *device == software) {
        return missing(
            "only a software driver was found and no graphics card; choose the engine cpu, which is faster",
        );
    }
    let kinds = [DeviceKind::DiscreteGpu(0), DeviceKind::IntegratedGpu(0), DeviceKind::VirtualGpu(0)];
    let best = kinds.into_iter().map(Device::wgpu).find(|device| found.contains(device));
    Ok(best.unwrap_or_else(|| Device::wgpu(DeviceKind::DefaultDevice)))
}

#[cfg(not(feature = "cuda"))]
fn cuda() -> Result<Device, InformationError> {
    Err(InformationError::EngineNotBuilt { engine: EngineChoice::Burn(BurnDevice::Cuda), feature: "cuda" })
}

/// The first NVIDIA card.
#[cfg(feature = "cuda")]
fn cuda() -> Result<Device, InformationError> {
    Ok(Device::cuda(0))
}
