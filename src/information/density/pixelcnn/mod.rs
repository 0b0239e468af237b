//! PixelCNN: a density model of patches as a product of densities of each pixel given those above and to its left
//! (van den Oord et al. 2016), with the network and the fit of Pinkard et al. 2024 and Kabuli et al. 2026.

pub(in crate::information) mod batches;
pub(in crate::information) mod burn_engine;
pub(in crate::information) mod cpu_engine;
pub(in crate::information) mod engine;
pub(in crate::information) mod file;
pub(in crate::information) mod fit;
pub(in crate::information) mod gradient;
pub(in crate::information) mod initial_mixture;
pub(in crate::information) mod mixture;
pub(in crate::information) mod model;
pub(in crate::information) mod network;
pub(in crate::information) mod open;
pub(in crate::information) mod protocols;
pub(in crate::information) mod scale;
pub(in crate::information) mod shape;
