//! The loss of the network's outputs, in burn's operations; see [`super::super::mixture`] for the formula.

use burn::tensor::Tensor;
use burn::tensor::activation::softplus;

use crate::information::density::pixelcnn::mixture::HALF_LN_TWO_PI;
use crate::information::density::pixelcnn::scale::DataScale;

/// Negative log density of every pixel, nats, shape (pixels, 1); `values` (photons) have that shape too, `heads` are
/// (pixels, 3K).
pub(super) fn mixture_losses(scale: &DataScale, values: Tensor<2>, heads: Tensor<2>) -> Tensor<2> {
    let [pixels, outputs] = heads.dims();
    let components = outputs / 3;
    let part = |index: usize| heads.clone().slice([0..pixels, index * components..(index + 1) * components]);
    let means = part(0).clamp_min(scale.min).clamp_max(scale.max);
    let widths = softplus(part(1), 1.0).clamp_min(scale.min_width).clamp_max(scale.deviation);
    let logits = part(2);
    let z = (values - means) / widths.clone();
    let logs = logits.clone() - z.clone() * z * 0.5 - widths.log() - HALF_LN_TWO_PI;
    log_sum_exp(logits) - log_sum_exp(logs)
}

/// Logarithm of the sum of exponentials over the columns, shape (rows, 1).
fn log_sum_exp(logs: Tensor<2>) -> Tensor<2> {
    let largest = logs.clone().detach().max_dim(1);
    (logs - largest.clone()).exp().sum_dim(1).log() + largest
}
