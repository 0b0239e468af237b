//! Numbers and file names as text.

use std::path::Path;

/// A number with three to four significant digits.
pub fn format_significant(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".into()
    } else if (0.001..10_000.0).contains(&size) {
        let decimals = (2 - size.log10().floor() as i32).clamp(0, 5) as usize;
        format!("{value:.decimals$}")
    } else {
        format!("{value:.2e}")
    }
}

/// Name of a file, or "Untitled".
pub fn file_name(path: Option<&Path>) -> String {
    path.and_then(Path::file_name).map_or_else(|| "Untitled".into(), |name| name.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_significant_digits() {
        for (value, text) in
            [(0.0, "0"), (1.0, "1.00"), (134.2, "134"), (0.04567, "0.0457"), (1234.5, "1234"), (2e-7, "2.00e-7")]
        {
            assert_eq!(format_significant(value), text);
        }
    }
}
