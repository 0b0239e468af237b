//! Information of a binary input through Gaussian noise.

/// Information in bits of a Bernoulli(p) input about which of two unit Gaussians, `d` apart, was drawn.
///
/// `I = p d^2 / 2 - E0[g ln g]` nats with the likelihood ratio mixture `g = 1 - p + p exp(d u - d^2 / 2)`.
pub(in crate::information) fn two_point_information(p: f64, d: f64) -> f64 {
    // The integrand is analytic up to pi / d off the real axis; this step leaves an error below 1e-10.
    let step = 0.05;
    let count = ((18.0 + d) / step).ceil() as usize;
    let density = |u: f64| (-0.5 * u * u).exp() / (2.0 * std::f64::consts::PI).sqrt();
    let mut sum = 0.0;
    for i in 0..=count {
        let u = i as f64 * step - 9.0;
        let mixture = (1.0 - p) * density(u) + p * density(u - d);
        sum += mixture * (p * (d * u - 0.5 * d * d).exp_m1()).ln_1p();
    }
    ((0.5 * p * d * d - sum * step) / std::f64::consts::LN_2).max(0.0)
}
