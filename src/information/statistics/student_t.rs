//! Quantiles of Student's t for intervals of means.

/// Half width of a 95 % interval in standard errors: the 97.5 % quantile of Student's t with `freedom` degrees of freedom.
///
/// From 3 degrees on it is the expansion about the normal quantile (Hill 1970), within 1 % of the table; below, it is the table.
pub(crate) fn student_95(freedom: f64) -> f64 {
    if freedom < 3.0 {
        return if freedom < 2.0 { 12.706 } else { 4.303 };
    }
    let z: f64 = 1.959_964;
    let (z2, n) = (z * z, freedom);
    let first = (z2 + 1.0) / 4.0;
    let second = ((5.0 * z2 + 16.0) * z2 + 3.0) / 96.0;
    let third = (((3.0 * z2 + 19.0) * z2 + 17.0) * z2 - 15.0) / 384.0;
    z * (1.0 + (first + (second + third / n) / n) / n)
}

#[cfg(test)]
mod tests {
    use super::student_95;

    #[test]
    fn quantiles_equal_the_tables() {
        for (freedom, quantile) in
            [(0.0, 12.706), (1.0, 12.706), (2.0, 4.303), (3.0, 3.182), (15.0, 2.1314), (47.0, 2.0117), (1e6, 1.95997)]
        {
            let found = student_95(freedom);
            assert!((found / quantile - 1.0).abs() < if freedom < 10.0 { 0.01 } else { 1e-4 }, "{freedom}: {found}");
        }
    }
}
