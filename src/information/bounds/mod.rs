//! Bounds that hold for any encoder, and the bracket that collects lower and upper bounds.

pub(in crate::information) mod bracket;
pub(in crate::information) mod method;
pub(in crate::information) mod object_entropy;
