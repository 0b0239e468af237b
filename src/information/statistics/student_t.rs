//! Quantiles of Student's t for intervals of means.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// The 97.5 % quantile of the normal distribution.
const NORMAL: f64 = 1.959_964;
/// Degrees of freedom above which the asymptotic expansion is exact to 1e-9, while inverting the beta function loses digits.
const MANY: f64 = 1000.0;

/// Half width of a 95 % interval in standard errors: the 97.5 % quantile of Student's t with `freedom` degrees of freedom.
/// Fewer than one degree counts as one; infinity gives the normal quantile.
pub(crate) fn student_95(freedom: f64) -> f64 {
    if freedom > MANY {
        return expansion(freedom);
    }
    // Location 0, scale 1 and a finite positive number of degrees are always valid.
    StudentsT::new(0.0, 1.0, freedom.max(1.0)).map_or(NORMAL, |student| student.inverse_cdf(0.975))
}

/// The quantile expanded about that of the normal distribution (Hill 1970).
fn expansion(n: f64) -> f64 {
    let z2 = NORMAL * NORMAL;
    let first = (z2 + 1.0) / 4.0;
    let second = ((5.0 * z2 + 16.0) * z2 + 3.0) / 96.0;
    let third = (((3.0 * z2 + 19.0) * z2 + 17.0) * z2 - 15.0) / 384.0;
    NORMAL * (1.0 + (first + (second + third / n) / n) / n)
}

#[cfg(test)]
mod tests {
    use super::{MANY, expansion, student_95};

    #[test]
    fn quantiles_equal_the_tables() {
        for (freedom, quantile) in [
            (0.0, 12.7062),
            (1.0, 12.7062),
            (2.0, 4.30265),
            (3.0, 3.18245),
            (15.0, 2.13145),
            (47.0, 2.01174),
            (1e6, 1.95997),
        ] {
            let found = student_95(freedom);
            assert!((found / quantile - 1.0).abs() < 1e-5, "{freedom}: {found}");
        }
        assert_eq!(student_95(f64::INFINITY), 1.959_964);
        assert!((student_95(MANY) / expansion(MANY) - 1.0).abs() < 1e-6, "{}", student_95(MANY));
    }
}
