//! Entropy of a Poisson count.

use std::sync::OnceLock;

/// Below this mean the entropy is summed directly, photons.
const SUM_BELOW: f64 = 2.0;
/// From this mean on the asymptotic series is used, photons.
const SERIES_FROM: f64 = 64.0;
/// Intervals of the table per photon.
const PER_PHOTON: f64 = 8.0;

/// Entropy of a Poisson count of `mean_photons`, in bits.
///
/// Below 2 photons the defining sum; from 64 on the series of Evans and Boersma (1988),
/// `1/2 ln(2 pi e L) - 1/(12 L) - 1/(24 L^2) - 19/(360 L^3) - 9/(80 L^4) - 863/(2520 L^5)` nats; between them a quintic
/// through value and two derivatives of the sum at every eighth of a photon. The error is below 1e-9 bit throughout.
/// A mean that is negative or not a number gives NaN.
pub fn poisson_entropy(mean_photons: f64) -> f64 {
    let x = mean_photons;
    if x >= SERIES_FROM {
        let r = 1.0 / x;
        let tail = r * (1.0 / 12.0 + r * (1.0 / 24.0 + r * (19.0 / 360.0 + r * (0.1125 + r * (863.0 / 2520.0)))));
        0.5 * (2.0 * std::f64::consts::PI * std::f64::consts::E * x).log2() - tail / std::f64::consts::LN_2
    } else if x >= SUM_BELOW {
        let position = (x - SUM_BELOW) * PER_PHOTON;
        let interval = position as usize;
        let t = position - interval as f64;
        let c = &table()[interval];
        c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
    } else if x > 0.0 {
        entropy_and_derivatives(x)[0]
    } else if x == 0.0 {
        0.0
    } else {
        f64::NAN
    }
}

/// Entropy in bits and its first two derivatives by the mean, from the defining sums.
///
/// `H = x - x ln x + E ln K!` nats; differentiating a Poisson expectation gives the expectation of the difference, so
/// `H' = -ln x + E ln(K+1)` and `H'' = -1/x + E ln((K+2)/(K+1))`.
fn entropy_and_derivatives(x: f64) -> [f64; 3] {
    let terms = (x + 12.0 * x.sqrt() + 30.0) as usize;
    let mut probability = (-x).exp();
    let mut ln_factorial = 0.0;
    let mut sums = [0.0; 3];
    for k in 0..terms {
        let next = (k + 1) as f64;
        let ln_next = next.ln();
        sums[0] += probability * ln_factorial;
        sums[1] += probability * ln_next;
        sums[2] += probability * (1.0 / next).ln_1p();
        ln_factorial += ln_next;
        probability *= x / next;
    }
    let bits = 1.0 / std::f64::consts::LN_2;
    [(x - x * x.ln() + sums[0]) * bits, (sums[1] - x.ln()) * bits, (sums[2] - 1.0 / x) * bits]
}

/// Coefficients of the quintic of every interval between [`SUM_BELOW`] and [`SERIES_FROM`].
fn table() -> &'static [[f64; 6]] {
    static TABLE: OnceLock<Vec<[f64; 6]>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let intervals = ((SERIES_FROM - SUM_BELOW) * PER_PHOTON) as usize;
        let step = 1.0 / PER_PHOTON;
        let nodes: Vec<[f64; 3]> = (0..=intervals)
            .map(|i| {
                let [value, slope, curvature] = entropy_and_derivatives(SUM_BELOW + i as f64 * step);
                [value, slope * step, curvature * step * step]
            })
            .collect();
        nodes.windows(2).map(|pair| quintic(pair[0], pair[1])).collect()
    })
}

/// The quintic on [0, 1] with the given value, slope and curvature at both ends (Hermite interpolation).
fn quintic(left: [f64; 3], right: [f64; 3]) -> [f64; 6] {
    let [c0, c1, twice_c2] = left;
    let c2 = 0.5 * twice_c2;
    let rise = right[0] - (c0 + c1 + c2);
    let slope = right[1] - (c1 + 2.0 * c2);
    let curvature = right[2] - 2.0 * c2;
    [
        c0,
        c1,
        c2,
        10.0 * rise - 4.0 * slope + 0.5 * curvature,
        -15.0 * rise + 7.0 * slope - curvature,
        6.0 * rise - 3.0 * slope + 0.5 * curvature,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition, -sum p log2 p, with factorials from sums of logarithms.
    fn entropy_by_definition(x: f64) -> f64 {
        let mut ln_factorial = 0.0;
        let mut entropy = 0.0;
        for k in 0..(x + 15.0 * x.sqrt() + 60.0) as usize {
            if k > 1 {
                ln_factorial += (k as f64).ln();
            }
            let ln_probability = k as f64 * x.ln() - x - ln_factorial;
            entropy -= ln_probability.exp() * ln_probability;
        }
        entropy / std::f64::consts::LN_2
    }

    #[test]
    fn equals_the_definition_in_every_range() {
        let means = (1..400).map(|i| 1e-3 * 1.04_f64.powi(i)).filter(|&x| x < 3000.0);
        for x in means.chain([2.0, 63.999_999, 64.0]) {
            let (found, expected) = (poisson_entropy(x), entropy_by_definition(x));
            assert!((found - expected).abs() < 1e-9, "{x}: {found} {expected}");
        }
    }

    #[test]
    fn gaussian_approximation_overstates_by_the_known_amounts() {
        for (x, excess) in [(10.0, 0.0127), (15.0, 0.0083), (20.0, 0.0062), (50.0, 0.0024), (100.0, 0.0012)] {
            let gaussian = 0.5 * (2.0 * std::f64::consts::PI * std::f64::consts::E * x).log2();
            assert!((gaussian - poisson_entropy(x) - excess).abs() < 5e-5, "{x}");
        }
    }

    #[test]
    fn zero_photons_are_certain_and_nonsense_is_not_a_number() {
        assert!(poisson_entropy(0.0).abs() < 1e-300);
        assert!(poisson_entropy(1e-300) >= 0.0);
        assert!(poisson_entropy(-1.0).is_nan());
        assert!(poisson_entropy(f64::NAN).is_nan());
    }
}
