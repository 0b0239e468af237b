//! PixelCNN: a density model of patches as a product of densities of each pixel given those above and to its left
//! (van den Oord et al. 2016), with the network and the fit of Pinkard et al. 2024 and Kabuli et al. 2026.

mod batches;
mod burn_engine;
mod cpu_engine;
mod engine;
mod estimate;
mod file;
mod first_mixture;
mod fit;
mod gradient;
mod mixture;
mod model;
mod network;
mod protocols;
mod scale;
mod shape;

pub use engine::{BurnDevice, Engine, EngineChoice};
pub use estimate::{PixelCnnRequest, pixelcnn_estimate, pixelcnn_score};
pub use gradient::HeldPixelCnn;
pub use model::{Mixtures, PixelCnn};
pub use protocols::{FitReport, PixelCnnFit, TrainingPatches};
pub use scale::DataScale;
pub(super) use scale::check_values;
pub use shape::PixelCnnShape;
