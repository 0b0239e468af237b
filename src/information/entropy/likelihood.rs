//! Likelihood of a measured pixel when its encoded value is known.

use crate::sensor::{Noise, ln_factorial};

/// Half width of sums over counts, in standard deviations of the read noise.
const REACH: f64 = 9.0;
/// Multiple of the shot noise above which read noise hides all likely counts. Next, the half width of the sum over
/// them: standard deviations of the shot noise, and additional counts.
const WIDE: f64 = 3.0;
const REACH_OF_COUNTS: (f64, f64) = (12.0, 30.0);

/// ln p(y | x) for a pixel that measured `y` where the encoded image holds `x` photons, nats.
///
/// For shot noise it is the log probability of a count (minus infinity where `y` is no count), otherwise a log
/// density per photon. Without noise there is no density; the result is then NaN.
pub fn log_likelihood(noise: Noise, y: f64, x: f64) -> f64 {
    match noise {
        Noise::None => f64::NAN,
        Noise::Shot => ln_poisson(y, x),
        Noise::Read { sigma } => ln_normal(y - x, sigma),
        Noise::ShotRead { sigma } => {
            let (middle, reach) = if sigma > WIDE * x.sqrt().max(1.0) {
                (x, REACH_OF_COUNTS.0 * x.sqrt() + REACH_OF_COUNTS.1)
            } else {
                (y, REACH * sigma)
            };
            let first = (middle - reach).ceil().max(0.0);
            let last = (middle + reach).floor();
            // Where no count lies near the value, the nearest one carries all of the density.
            let (first, last) = if last < first { (y.round().max(0.0), y.round().max(0.0)) } else { (first, last) };
            // The summand is a bell over the counts. Sums in steps of half its width differ by a factor of 1 + exp(-8
            // pi^2).
            let step = (0.5 * (x * sigma * sigma / (x + sigma * sigma)).sqrt()).floor().max(1.0);
            let terms = ((last - first) / step) as usize;
            let term = |i: usize| {
                let count = first + i as f64 * step;
                ln_poisson(count, x) + ln_normal(y - count, sigma)
            };
            let largest = (0..=terms).map(term).fold(f64::NEG_INFINITY, f64::max);
            if largest == f64::NEG_INFINITY {
                return largest;
            }
            largest + (0..=terms).map(|i| (term(i) - largest).exp()).sum::<f64>().ln() + step.ln()
        }
    }
}

/// ln of the probability of the count `y` at a mean of `x` photons.
pub(in crate::information) fn ln_poisson(y: f64, x: f64) -> f64 {
    if y < 0.0 || y.fract() != 0.0 || x < 0.0 {
        f64::NEG_INFINITY
    } else if x == 0.0 {
        if y == 0.0 { 0.0 } else { f64::NEG_INFINITY }
    } else if y < 32.0 {
        y * x.ln() - x - ln_factorial(y)
    } else {
        // Loader's form (2000) of the saddle point: no large numbers are subtracted from each other.
        let r = 1.0 / y;
        let stirling = r * (1.0 / 12.0 - r * r * (1.0 / 360.0 - r * r / 1260.0));
        -deviance(y, x) - 0.5 * (2.0 * std::f64::consts::PI * y).ln() - stirling
    }
}

/// `y ln(y / x) + x - y`.
fn deviance(y: f64, x: f64) -> f64 {
    let t = (x - y) / y;
    if t.abs() < 0.01 {
        // t - ln(1 + t) as a series.
        let mut sum = 0.0;
        let mut power = t;
        for k in 2..=10 {
            power *= -t;
            sum -= power / f64::from(k);
        }
        y * sum
    } else {
        y * (t - t.ln_1p())
    }
}

pub(in crate::information) fn ln_normal(distance: f64, sigma: f64) -> f64 {
    let z = distance / sigma;
    -0.5 * z * z - sigma.ln() - 0.5 * (2.0 * std::f64::consts::PI).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_of_counts_sum_to_one_and_follow_their_recursion() {
        for x in [0.02_f64, 1.0, 10.0, 31.7, 200.0, 5000.0] {
            let last = (x + 14.0 * x.sqrt() + 40.0) as u32;
            let total: f64 = (0..=last).map(|y| ln_poisson(f64::from(y), x).exp()).sum();
            assert!((total - 1.0).abs() < 1e-9, "{x}: {total}");
            for y in [1.0, 31.0, 32.0, 33.0, 199.0, 5050.0] {
                let step = ln_poisson(y, x) - ln_poisson(y - 1.0, x);
                let rounding = 1e-8 + 1e-12 * ln_poisson(y, x).abs();
                assert!((step - (x / y).ln()).abs() < rounding, "{x} {y}");
            }
        }
        assert_eq!(ln_poisson(0.0, 0.0), 0.0);
        assert_eq!(ln_poisson(2.5, 3.0), f64::NEG_INFINITY);
    }

    #[test]
    fn densities_of_blurred_counts_integrate_to_one() {
        for (sigma, x) in [(0.3, 2.0), (1.0, 10.0), (4.0, 100.0)] {
            let noise = Noise::ShotRead { sigma };
            let step = 0.1 * sigma.min(1.0);
            let from = -10.0 * sigma;
            let count = ((x + 12.0 * (x + sigma * sigma).sqrt() - from) / step) as usize;
            let total: f64 = (0..count).map(|i| log_likelihood(noise, from + i as f64 * step, x).exp()).sum();
            assert!((total * step - 1.0).abs() < 1e-6, "{sigma} {x}: {}", total * step);
        }
        let read = log_likelihood(Noise::Read { sigma: 2.0 }, 3.0, 3.0);
        assert!((read + 2.0_f64.ln() + 0.918_938_533).abs() < 1e-8);
        assert!(log_likelihood(Noise::ShotRead { sigma: 1.0 }, -30.0, 2.0).is_finite());
        // However the sum is truncated, it equals that over all counts.
        for (x, sigma) in [
            (0.0_f64, 3.1_f64),
            (5.0, 6.6),
            (5.0, 6.8),
            (17.0, 400.0),
            (100.0, 9.0),
            (100.0, 31.0),
            (1e4, 1e3),
            (3e4, 250.0),
        ] {
            let deviation = (x + sigma * sigma).sqrt();
            for y in [x - 4.0 * deviation, x, x + 4.0 * deviation] {
                let terms = 0..=(x + 30.0 * x.sqrt() + 60.0) as u32;
                let term =
                    |count: u32| (ln_poisson(f64::from(count), x) + ln_normal(y - f64::from(count), sigma)).exp();
                let (found, all) = (log_likelihood(Noise::ShotRead { sigma }, y, x), terms.map(term).sum::<f64>().ln());
                assert!((found - all).abs() < 1e-9, "{x} {sigma} {y}: {found} {all}");
            }
        }
        assert!(log_likelihood(Noise::ShotRead { sigma: 1e9 }, 3.0, 100.0).is_finite());
    }
}
