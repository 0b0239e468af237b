//! Initial mixture at the values of the data.

use ndarray::ArrayView3;

use super::model::PixelCnn;

/// Largest number of values to sort.
const MOST_VALUES: usize = 100_000;

/// Sets the biases of means and widths so that the initial mixture resembles the histogram of the data. Means lie at
/// its quantiles; widths reach the neighbours.
///
/// The published start has means anywhere in the range and widths of about 1 photon. It takes thousands of steps to
/// reach this mixture.
pub(super) fn spread_over(model: &mut PixelCnn, patches: ArrayView3<'_, f32>) {
    let components = model.shape.components;
    let stride = patches.len().div_ceil(MOST_VALUES).max(1);
    let mut values: Vec<f32> = patches.iter().copied().step_by(stride).collect();
    values.sort_by(f32::total_cmp);
    let Some(last) = values.len().checked_sub(1) else { return };
    let quantile = |share: f32| values[((share * last as f32).round() as usize).min(last)];
    let share = |k: f32| ((k + 0.5) / components as f32).clamp(0.0, 1.0);
    let bias = model.layers.heads.bias.clone();
    let bias = &mut model.weights[bias];
    for k in 0..components {
        let reach = 0.5 * (quantile(share(k as f32 + 1.0)) - quantile(share(k as f32 - 1.0)));
        let widest = 0.5 * model.scale.deviation;
        let width = reach.min(widest).max(1.5 * model.scale.min_width);
        bias[k] = quantile(share(k as f32));
        bias[components + k] = softplus_inverse(width);
    }
}

/// x with ln(1 + e^x) = y, for y above 0.
fn softplus_inverse(y: f32) -> f32 {
    y + (-(-y).exp()).ln_1p()
}

#[cfg(test)]
mod tests {
    use super::super::scale::DataScale;
    use super::super::shape::PixelCnnShape;
    use super::*;
    use ndarray::Array3;

    #[test]
    fn the_first_mixture_fits_better_than_the_published_start() {
        let patches = Array3::from_shape_fn((20, 6, 6), |(n, r, c)| 10.0 + ((n * 36 + r * 6 + c) % 720) as f32 * 0.3);
        let scale = DataScale::of(patches.view(), 1.0).unwrap();
        let mut model = PixelCnn::new(PixelCnnShape::new(8, 10, vec![1]).unwrap(), scale, 1);
        let mean = |model: &PixelCnn| model.cross_entropy_bits(patches.view()).unwrap().iter().sum::<f64>() / 20.0;
        let before = mean(&model);
        spread_over(&mut model, patches.view());
        let after = mean(&model);
        // The values are uniform over 216 photons: 7.75 bits.
        assert!(after < before && after < 8.1, "{before} {after}");
        let mixtures = model.mixtures(patches.view()).unwrap();
        assert!(mixtures.widths.iter().all(|width| (1.0..=scale.deviation).contains(width)));
        assert!((softplus_inverse(3.0).exp().ln_1p() - 3.0).abs() < 1e-5);
    }
}
