//! Text form of bits per pixel and their intervals, in the window and on the command line.

use crate::information::bounds::bracket::Bracket;

/// Decimals of a number of bits.
const DECIMALS: usize = 3;
/// Decimals beyond which the ends of an interval count as equal.
const MOST_DECIMALS: usize = 6;

/// Bits with three decimals.
pub fn rounded(bits: f64) -> String {
    format!("{bits:.DECIMALS$}")
}

/// Both bounds, the smaller first.
pub fn between(lower: f64, upper: f64) -> String {
    let (low, high) = Bracket::in_order(lower, upper);
    format!("{} \u{2013} {}", rounded(low), rounded(high))
}

/// A number of bits with its 95 % interval: "0.412 [0.408, 0.416]".
///
/// An interval of zero width is left out. A narrow one gets enough decimals to distinguish its ends.
pub fn with_interval(bits: f64, interval: [f64; 2]) -> String {
    with_decimals(bits, interval, DECIMALS)
}

/// As [`with_interval`], with at least `least` decimals.
pub fn with_decimals(bits: f64, interval: [f64; 2], least: usize) -> String {
    let number = text(bits, decimals(interval, least).unwrap_or(least));
    number + &interval_behind(interval, least)
}

/// The interval after a number, with a leading blank and at least `least` decimals: " [0.408, 0.416]". It is empty
/// for an interval of zero width.
pub fn interval_behind([low, high]: [f64; 2], least: usize) -> String {
    let decimals = decimals([low, high], least);
    decimals.map_or_else(String::new, |decimals| format!(" [{}, {}]", text(low, decimals), text(high, decimals)))
}

/// Number of decimals that distinguishes the ends of an interval.
fn decimals([low, high]: [f64; 2], least: usize) -> Option<usize> {
    (least..=MOST_DECIMALS).find(|&decimals| text(low, decimals) != text(high, decimals))
}

/// A number with a given number of decimals. A number that rounds to zero has no sign.
fn text(number: f64, decimals: usize) -> String {
    let text = format!("{number:.decimals$}");
    if text.trim_matches(['-', '0', '.']).is_empty() { text.trim_start_matches('-').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_of_no_width_is_not_shown_and_a_narrow_one_keeps_its_width() {
        assert_eq!(with_interval(0.412_34, [0.408, 0.416_04]), "0.412 [0.408, 0.416]");
        assert_eq!(with_interval(0.412, [0.412, 0.412]), "0.412");
        assert_eq!(with_interval(0.0, [-1e-9, 1e-9]), "0.000");
        assert_eq!(with_interval(0.412_34, [0.412_2, 0.412_4]), "0.4123 [0.4122, 0.4124]");
        assert_eq!(with_interval(0.1, [f64::NAN, f64::NAN]), "0.100");
        assert_eq!(with_decimals(0.5, [0.5, 0.5], 4), "0.5000");
        assert_eq!(with_decimals(0.5, [0.4, 0.6], 4), "0.5000 [0.4000, 0.6000]");
        assert_eq!(between(0.5, 0.4), "0.400 \u{2013} 0.500");
    }
}
