//! Object-entropy bound: the information cannot exceed the entropy of the objects.

pub(in crate::information) mod bead_upper_bound;
pub(in crate::information) mod gaussian_channel;
pub(in crate::information) mod poisson_channel;
#[cfg(test)]
mod tests;
