//! Parts that small networks on the CPU are built from: matrix products, causal taps, activations, optimizers, weights.
//!
//! Arrays are plain slices of `f32`, row-major, the last axis being the channel: (samples, rows, cols, channels). Work
//! that is split between threads is split the same way whatever their number, and summed in order, so equal seeds give
//! equal bits.

mod activation;
mod adam;
mod arithmetic;
mod bias;
mod bordered;
mod elementwise;
mod error;
mod layer;
mod minimal_filter;
mod muon;
mod normalise;
mod optimizer;
mod parameters;
mod parts;
mod pool;
mod product;
mod row_above;
mod schedule;
mod taps;
#[cfg(test)]
mod test_numbers;
mod tiles;
mod weights_file;
mod window_product;
mod winograd;

pub use activation::{elu, elu_backward, gate, gate_backward, glu, glu_backward, silu, silu_backward, silu_plus};
pub use adam::{Adam, moving_average};
pub(crate) use arithmetic::vectorised;
pub use arithmetic::{exponential, if_not_negligible, logarithm, multiplies_and_adds};
pub use bias::{add_bias, column_sums, fill_bias};
pub use bordered::Bordered;
pub(crate) use elementwise::{LANES, euclidean_norm, sum_of_lanes};
pub use error::NetworkError;
pub use layer::Layer;
pub use muon::Muon;
pub use normalise::{rms_norm, rms_norm_backward};
pub use optimizer::{Averaging, Optimizer, Rule};
pub use parameters::{Initial, ParameterLayout, Tensor};
pub use parts::{part_range, sum_in_order};
pub use pool::Pool;
pub use product::{Write, product, product_of_transposed, product_with_transposed};
pub use row_above::RowAbove;
pub use schedule::{rate_rise, rate_schedule};
pub use taps::{Grid, Taps};
pub use tiles::TileMemory;
pub use weights_file::{WeightsHeader, read_detail, read_details, read_weights, write_weights};
pub use window_product::{Window, transposed_kernel, window_product, window_product_by_kernel};
pub use winograd::Winograd;
