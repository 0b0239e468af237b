//! Kernels: the loops that do the arithmetic, each on plain slices and on one thread.

pub(in crate::nn) mod arithmetic;
pub(in crate::nn) mod bias;
pub(in crate::nn) mod elementwise;
pub(in crate::nn) mod matmul;
mod minimal_filter;
pub(in crate::nn) mod ordered_sum;
pub(in crate::nn) mod padded;
pub(in crate::nn) mod row_above;
pub(in crate::nn) mod taps;
pub(in crate::nn) mod tiles;
pub(in crate::nn) mod window_conv;
pub(in crate::nn) mod winograd;
pub(in crate::nn) mod workspace_pool;
