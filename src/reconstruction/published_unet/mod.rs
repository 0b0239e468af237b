//! Published U-net (Kabuli et al. 2026): objects from the measurement alone, without a model of the camera.

mod burn_module;
mod decoder;
mod layers;
mod objects;
#[cfg(test)]
mod parity;
mod passes;
#[cfg(test)]
mod tests;
mod trained;
mod training;

pub use decoder::UnetDecoder;
pub use trained::TrainedUnet;
pub use training::UnetTraining;
