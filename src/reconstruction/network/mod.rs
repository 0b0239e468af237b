//! Trained network on top of the linear estimate: a residual U-net that corrects what a linear estimate cannot know.

mod batches;
mod decoder;
mod features;
mod layers;
mod masks;
mod quality;
#[cfg(test)]
mod tests;
mod trained;
mod training;
mod unet;

pub use decoder::NetworkDecoder;
pub use masks::TrainingMasks;
pub use trained::TrainedNetwork;
pub use training::{NetworkTraining, TrainingBudget, TrainingStep};
