//! The ceiling that the entropy of independent beads puts on the information of any encoder.

mod area_sums;
mod beads;
mod gaussian_channel;
mod poisson_channel;
#[cfg(test)]
mod tests;

pub(super) use area_sums::AreaSums;
pub use beads::{BeadCeiling, Ceiling, binary_entropy};
