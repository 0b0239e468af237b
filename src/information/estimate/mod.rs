//! Estimates: trials of the estimators, combined with intervals, bounds and notes.

pub(in crate::information) mod analytic_moments;
pub(in crate::information) mod causal;
pub(in crate::information) mod combined;
pub(in crate::information) mod format;
pub(in crate::information) mod gaussian;
pub(in crate::information) mod pixelcnn;
#[cfg(test)]
mod tests;
pub(in crate::information) mod trial;
