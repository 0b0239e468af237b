//! Parser of typed numbers, for all fields of the window.
//!
//! A number is an optional sign (`+`, `-` or the minus sign U+2212), digits with at most one separator (`.` or `,`), and
//! an optional exponent (`e` or `E`). Blanks around it do not count, nor do the prefix and the unit of its field.
//!
//! | typed | is |
//! |---|---|
//! | `0.46`, `0,46`, `+0,46`, ` 0.46 ` | 0.46 |
//! | `46,5` | 46.5 |
//! | `.5`, `,5` | 0.5 |
//! | `5.`, `5,` | 5 |
//! | `-3`, U+2212 `3` | -3 |
//! | `1.5e3`, `1,5E+3` | 1500 |
//! | `12 px`, `12px` in a field of pixels | 12 |
//! | `1.234` | 1.234 |
//! | `1234,567`, `0,465`, `,125`, `1,2345`, `1,23` | decimals after the comma |
//! | `1,234`, `12,345`, `999,000`, `-1,234` | refused: the comma may stand before decimals or between thousands |
//! | `1.234,5`, `1,234.5`, `1.2.3`, `1,2,3` | refused: more than one separator |
//! | `1 234`, `1'234`, `- 3`, U+00A0 or U+202F between digits | refused |
//! | `nan`, `inf`, `0x10`, `1e`, `e5`, `.`, `-`, `abc`, `1e999`, nothing | refused |
//! | `2.5` in a field of whole numbers | refused |
//! | a number outside the range of its field | refused |

/// Why a text is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// The text is empty.
    Empty,
    /// The comma may stand before decimals or between thousands.
    Ambiguous,
    /// The text is not a number.
    NoNumber,
    /// The field holds whole numbers.
    NotWhole,
    /// The number lies outside the range of the field.
    Outside,
}

/// The number in a text, without prefix and unit.
///
/// `prefix` and one of `units` may be typed before and after the number.
///
/// # Errors
/// [`Rejection::Empty`], [`Rejection::Ambiguous`] or [`Rejection::NoNumber`].
pub fn parse(text: &str, prefix: &str, units: &[&str]) -> Result<f64, Rejection> {
    let text = bare(text.trim(), prefix.trim(), units);
    if text.is_empty() {
        return Err(Rejection::Empty);
    }
    let (sign, unsigned) = signed(text);
    let (mantissa, exponent) = match unsigned.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, Some(exponent)),
        None => (unsigned, None),
    };
    let (whole, comma, decimals) = match mantissa.split_once(['.', ',']) {
        Some((whole, decimals)) => (whole, mantissa[whole.len()..].starts_with(','), decimals),
        None => (mantissa, false, ""),
    };
    if !(are_digits(whole) && are_digits(decimals) && whole.len() + decimals.len() > 0) {
        return Err(Rejection::NoNumber);
    }
    if comma && decimals.len() == 3 && (1..=3).contains(&whole.len()) && !whole.starts_with('0') {
        return Err(Rejection::Ambiguous);
    }
    let exponent = match exponent.map(signed) {
        Some((_, digits)) if digits.is_empty() || !are_digits(digits) => return Err(Rejection::NoNumber),
        Some((sign, digits)) => format!("{sign}{digits}"),
        None => "0".into(),
    };
    let number: f64 = format!("{sign}0{whole}.{decimals}0e{exponent}").parse().map_err(|_| Rejection::NoNumber)?;
    // A large exponent overflows.
    if number.is_finite() { Ok(number) } else { Err(Rejection::NoNumber) }
}

/// A text without the prefix before it and the unit after it.
fn bare<'a>(text: &'a str, prefix: &str, units: &[&str]) -> &'a str {
    let text = text.strip_prefix(prefix).map_or(text, str::trim_start);
    let mut units = units.iter().map(|unit| unit.trim()).filter(|unit| !unit.is_empty());
    units.find_map(|unit| text.strip_suffix(unit)).map_or(text, str::trim_end)
}

/// Sign of a text, and the rest.
fn signed(text: &str) -> (&'static str, &str) {
    match text.strip_prefix(['-', '\u{2212}']) {
        Some(rest) => ("-", rest),
        None => ("", text.strip_prefix('+').unwrap_or(text)),
    }
}

fn are_digits(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn documented_examples_hold() {
        let minus = '\u{2212}';
        for (text, number) in [
            ("0.46", 0.46),
            ("0,46", 0.46),
            ("+0,46", 0.46),
            (" \u{a0}0.46\t", 0.46),
            ("46,5", 46.5),
            (".5", 0.5),
            (",5", 0.5),
            ("5.", 5.0),
            ("5,", 5.0),
            ("-3", -3.0),
            (&format!("{minus}3"), -3.0),
            ("1.5e3", 1500.0),
            ("1,5E+3", 1500.0),
            (&format!("2e{minus}2"), 0.02),
            ("12 px", 12.0),
            ("12px", 12.0),
            ("seed 7", 7.0),
            ("1.234", 1.234),
            ("1234,567", 1234.567),
            ("0,465", 0.465),
            (",125", 0.125),
            ("1,2345", 1.2345),
            ("1,23", 1.23),
            ("00,125", 0.125),
            ("007", 7.0),
            ("1e-400", 0.0),
        ] {
            assert_eq!(parse(text, "seed ", &[" px"]), Ok(number), "{text:?}");
        }
        for text in ["1,234", "12,345", "999,000", "-1,234", "1,234 px", "1,234e2"] {
            assert_eq!(parse(text, "seed ", &[" px"]), Err(Rejection::Ambiguous), "{text:?}");
        }
        for text in ["", "  ", "px", " px "] {
            assert_eq!(parse(text, "seed ", &[" px"]), Err(Rejection::Empty), "{text:?}");
        }
        for text in [
            "1.234,5",
            "1,234.5",
            "1.2.3",
            "1,2,3",
            "1 234",
            "1'234",
            "1\u{a0}234",
            "1\u{202f}234",
            "1_000",
            "- 3",
            "--3",
            "+-3",
            "nan",
            "NaN",
            "inf",
            "-Infinity",
            "0x10",
            "1e",
            "1e+",
            "e5",
            "1e2e3",
            "1e2.5",
            ".",
            ",",
            "-",
            "abc",
            "12a",
            "a12",
            "1e999",
            "12 px px",
            "12 %",
            "\u{0661}\u{0662}",
            "1/2",
            "\u{ff11}",
            "1;5",
            "px 12",
            "12 seed",
        ] {
            assert_eq!(parse(text, "seed ", &[" px"]), Err(Rejection::NoNumber), "{text:?}");
        }
    }

    /// An independent implementation of the rules, as a state table, character by character.
    fn by_the_rules(text: &str) -> Option<f64> {
        let text = text.trim();
        let (mut plain, mut separator, mut before, mut after, mut exponent) = (String::new(), None, 0, 0, None);
        for (index, c) in text.chars().enumerate() {
            match c {
                '+' | '-' | '\u{2212}' if index == 0 || exponent == Some(0) && plain.ends_with('e') => {
                    plain.push(if c == '+' { '+' } else { '-' });
                }
                '0'..='9' => {
                    plain.push(c);
                    match (&mut exponent, separator) {
                        (Some(digits), _) => *digits += 1,
                        (None, Some(_)) => after += 1,
                        (None, None) => before += 1,
                    }
                }
                '.' | ',' if separator.is_none() && exponent.is_none() => {
                    separator = Some(c);
                    plain.push('.');
                }
                'e' | 'E' if exponent.is_none() && before + after > 0 => {
                    exponent = Some(0);
                    plain.push('e');
                }
                _ => return None,
            }
        }
        let first = text.trim_start_matches(['+', '-', '\u{2212}']).chars().next()?;
        let is_ambiguous = separator == Some(',') && after == 3 && (1..=3).contains(&before) && first != '0';
        (before + after > 0 && exponent != Some(0) && !is_ambiguous).then(|| plain.parse().ok()).flatten()
    }

    proptest! {
        #[test]
        fn random_texts_are_what_the_rules_say(text in "[-+\u{2212}]?[0-9., '\u{a0}\u{202f}eE]{0,9}[a-z%]?") {
            let expected = by_the_rules(&text).filter(|number| number.is_finite());
            prop_assert_eq!(parse(&text, "", &[]).ok(), expected, "{:?}", text);
        }

        #[test]
        fn numbers_with_a_point_come_back(number in -1e12..1e12_f64) {
            prop_assert_eq!(parse(&number.to_string(), "", &[]), Ok(number));
            prop_assert_eq!(parse(&format!("{number:e} px"), "", &["px"]), Ok(number));
        }
    }
}
