//! Losses and gradients by burn, computed for a chunk of patches at a time.

use burn::tensor::{Device, Tensor, TensorData, Transaction};
use ndarray::{ArrayView3, Axis};

use super::super::engine::Engine;
use super::device::{guarded, open_device};
use super::mixture::mixture_losses;
use super::network::Network;
use crate::information::density::pixelcnn::model::{PixelCnn, check};
use crate::information::engine_choice::{BurnDevice, EngineChoice};
use crate::information::error::InformationError;

/// Pixels in the network at a time; automatic differentiation keeps about 45 kB for each.
const CHUNK_PIXELS: usize = 1 << 14;

/// One network on one device of burn.
///
/// Every step transfers the weights to the device and the gradients back, 2.5 MB each for the published network.
#[derive(Debug)]
pub(in super::super) struct BurnEngine {
    choice: EngineChoice,
    device: Device,
}

impl BurnEngine {
    /// The device of this name.
    ///
    /// # Errors
    /// Where this program was built without it, or this machine has no device for it.
    pub fn open(device: BurnDevice) -> Result<Self, InformationError> {
        let engine = Self { choice: EngineChoice::Burn(device), device: open_device(device)? };
        // A driver that cannot compute is reported here and not during a fit.
        guarded(engine.choice, || {
            let ones = Tensor::<1>::ones([8], &engine.device).sum().into_data();
            let sum = ones.iter::<f32>().sum::<f32>();
            if sum == 8.0 { Ok(()) } else { Err(format!("eight ones sum to {sum} on it")) }
        })?;
        Ok(engine)
    }

    /// Losses of the pixels of some patches (photons), nats, shape (pixels, 1), and the patches as a burn tensor.
    fn losses(model: &PixelCnn, network: &Network, device: &Device, patches: ArrayView3<'_, f32>) -> Scored {
        let (samples, rows, cols) = patches.dim();
        let values = TensorData::new(patches.iter().copied().collect::<Vec<f32>>(), [samples, rows, cols, 1]);
        let values = Tensor::<4>::from_data(values, device);
        let values = if device.is_autodiff() { values.require_grad() } else { values };
        let standardised = (values.clone() - model.scale.mean) / model.scale.deviation;
        let heads = network.forward(&model.layers, standardised);
        let losses = mixture_losses(&model.scale, values.clone().reshape([samples * rows * cols, 1]), heads);
        Scored { values, losses }
    }
}

/// Result of one chunk of patches.
struct Scored {
    /// Photons, shape (n, rows, cols, 1).
    values: Tensor<4>,
    /// Nats, shape (pixels, 1).
    losses: Tensor<2>,
}

impl Engine for BurnEngine {
    fn choice(&self) -> EngineChoice {
        self.choice
    }

    fn loss_and_gradients(
        &mut self,
        model: &PixelCnn,
        patches: ArrayView3<'_, f32>,
        gradient: &mut [f32],
        mut by_patch: Option<&mut [f32]>,
    ) -> Result<f64, InformationError> {
        let device = self.device.clone().autodiff();
        let pixels = patches.len_of(Axis(1)) * patches.len_of(Axis(2));
        let weight = 1.0 / patches.len() as f32;
        gradient.fill(0.0);
        guarded(self.choice, || {
            let network = Network::new(&model.layers, &model.weights, &device);
            let mut nats = 0.0;
            for (index, part) in patches.axis_chunks_iter(Axis(0), samples_per_chunk(pixels)).enumerate() {
                let Scored { values, losses } = Self::losses(model, &network, &device, part);
                let gradients = (losses.clone().sum() * weight).backward();
                let by_weights = network.gradients(&model.layers, &gradients)?;
                // One transfer for all: each transfer waits for the device.
                let mut reading = Transaction::default().register(losses.inner());
                for (_, values) in &by_weights {
                    reading = reading.register(values.clone());
                }
                if by_patch.is_some() {
                    reading = reading.register(values.grad(&gradients).ok_or("the patches have no gradient")?);
                }
                let read = reading.try_execute().map_err(|error| format!("{error:?}"))?;
                let read = read.iter().map(numbers).collect::<Result<Vec<_>, _>>()?;
                nats += sums(read[0], part.len())[0];
                for ((place, _), values) in by_weights.iter().zip(&read[1..]) {
                    for (out, value) in gradient[place.clone()].iter_mut().zip(*values) {
                        *out += value;
                    }
                }
                if let Some(by_patch) = &mut by_patch {
                    let start = index * samples_per_chunk(pixels) * pixels;
                    by_patch[start..start + part.len()].copy_from_slice(read[1 + by_weights.len()]);
                }
            }
            Ok(nats / patches.len() as f64)
        })
    }

    fn cross_entropy_bits(
        &mut self,
        model: &PixelCnn,
        patches: ArrayView3<'_, f32>,
    ) -> Result<Vec<f64>, InformationError> {
        let grid = check(patches)?;
        let pixels = grid.rows * grid.cols;
        guarded(self.choice, || {
            let network = Network::new(&model.layers, &model.weights, &self.device);
            let mut bits = Vec::with_capacity(grid.samples);
            for part in patches.axis_chunks_iter(Axis(0), samples_per_chunk(pixels)) {
                let losses = Self::losses(model, &network, &self.device, part).losses.into_data();
                let nats = sums(numbers(&losses)?, pixels);
                bits.extend(nats.iter().map(|nats| nats / pixels as f64 / std::f64::consts::LN_2));
            }
            Ok(bits)
        })
    }
}

/// Patches in the network at a time.
fn samples_per_chunk(patch_pixels: usize) -> usize {
    (CHUNK_PIXELS / patch_pixels.max(1)).max(1)
}

/// Numbers read from a device.
fn numbers(data: &TensorData) -> Result<&[f32], String> {
    data.as_slice::<f32>().map_err(|error| format!("{error:?}"))
}

/// Sums of every `count` numbers.
fn sums(values: &[f32], count: usize) -> Vec<f64> {
    values.chunks(count).map(|values| values.iter().map(|&value| f64::from(value)).sum()).collect()
}
