//! Numbers with a number of significant digits.

/// A number with `digits` significant digits; whole numbers keep all digits.
pub fn significant(value: f64, digits: i32) -> String {
    if value.fract() == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let decimals = (digits - 1 - value.abs().log10().floor() as i32).clamp(0, 15) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_those_of_the_size() {
        let four = [139.204_193_115_234_38, 10.0, -5.0, 0.012_345_6, 65_535.0].map(|value| significant(value, 4));
        assert_eq!(four, ["139.2", "10", "-5", "0.01235", "65535"]);
        let three = [256.0, 34.28, 0.012_34, 1.0 / 4095.0, 0.0, f64::NAN].map(|value| significant(value, 3));
        assert_eq!(three, ["256", "34.3", "0.0123", "0.000244", "0", "NaN"]);
    }
}
