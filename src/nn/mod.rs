//! Building blocks of small neural networks on the CPU: kernels, layers, optimizers and weight files. They contain no
//! optics.
//!
//! Arrays are plain `f32` slices, row-major, with the channel as the last axis: (samples, rows, cols, channels). Work
//! is split between threads in the same way for any number of threads, and partial sums are added in a fixed order.
//! Equal seeds therefore give equal bits.

mod error;
mod kernels;
mod layers;
mod optimizers;
mod parameters;
#[cfg(test)]
mod test_numbers;
mod weights_file;

pub use error::NetworkError;
pub(crate) use kernels::arithmetic::vectorised;
pub use kernels::arithmetic::{exponential, if_not_negligible, logarithm, multiplies_and_adds};
pub use kernels::bias::{add_bias, column_sums, fill_bias};
pub(crate) use kernels::elementwise::{LANES, euclidean_norm, sum_of_lanes};
pub use kernels::matmul::{Write, matmul_transposed_lhs, matmul_transposed_rhs, product};
pub use kernels::ordered_sum::{add_assign, ordered_sum, part_range};
pub use kernels::padded::PaddedImages;
pub use kernels::row_above::RowAbove;
pub use kernels::taps::{Grid, Taps};
pub use kernels::tiles::TileMemory;
pub use kernels::window_conv::{Window, transposed_kernel, window_product, window_product_by_kernel};
pub use kernels::winograd::{TapRows, Winograd};
pub use kernels::workspace_pool::Pool;
pub use layers::activation::{
    elu, elu_backward, gate, gate_backward, glu, glu_backward, silu, silu_backward, silu_plus,
};
pub use layers::batch_norm::{BATCH_NORM_EPSILON, BatchNorm, ChannelSums, NormRelu, moment_sums};
pub use layers::convolution::Convolution3x3;
pub use layers::dense::Layer;
pub use layers::pixel_shuffle::{pixel_shuffle, pixel_unshuffle};
pub use layers::pooling::{max_pool, max_pool_backward};
pub use layers::rms_norm::{rms_norm, rms_norm_backward};
pub use layers::upsampling::{concatenate, split_channels, upsample, upsample_backward};
pub use optimizers::adam::{Adam, moving_average};
pub use optimizers::learning_rate::{cosine_factor, learning_rate_factor, warmup_factor};
pub use optimizers::muon::Muon;
pub use optimizers::optimizer::{Averaging, Optimizer, Rule};
pub use parameters::{Initial, ParameterLayout, Tensor};
pub use weights_file::{WeightsHeader, read_detail, read_details, read_weights, write_weights};
