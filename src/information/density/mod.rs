//! Density models of noisy patches. Their cross-entropy is an upper bound on H(Y).

pub(in crate::information) mod causal;
pub(in crate::information) mod frozen;
pub(in crate::information) mod gaussian;
pub(in crate::information) mod patch_checks;
pub(in crate::information) mod pixelcnn;
