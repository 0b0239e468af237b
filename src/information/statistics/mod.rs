//! Statistics: intervals of means, paired differences, and the numerical tools that the models share.

pub(in crate::information) mod area_sums;
pub(in crate::information) mod bootstrap;
pub(in crate::information) mod dequantisation;
pub(in crate::information) mod fourier;
pub(in crate::information) mod paired_difference;
pub(in crate::information) mod power_spectrum;
pub(in crate::information) mod shared_images;
pub(in crate::information) mod student_t;
pub(in crate::information) mod uniform_table;
