//! Exposure times in the names of groups and files, such as `light_10ms`.

use std::collections::BTreeSet;

/// An exposure time in a name.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum NamedExposure {
    /// The time, ns.
    Known(f64),
    /// Two numbers before the unit, such as `1_100s`: a counter and a time, or 1 over the second one.
    Pair {
        /// The text of both with the unit.
        text: String,
        /// The first number.
        first: f64,
        /// The second number as a time, ns.
        time_ns: f64,
        /// 1 second over the second number, ns; `None` where these are no seconds or the first number is not 1.
        fraction_ns: Option<f64>,
    },
    /// A comma before three digits, such as `1,250ms`: of a decimal fraction or of thousands.
    Comma {
        /// The text with the unit.
        text: String,
    },
}

/// Factor of a unit of time to nanoseconds.
fn factor_of(unit: &str) -> Option<f64> {
    Some(match unit {
        "ns" | "nsec" => 1.0,
        "us" | "usec" | "\u{b5}s" | "\u{3bc}s" => 1e3,
        "ms" | "msec" => 1e6,
        "s" | "sec" | "secs" | "second" | "seconds" => 1e9,
        _ => return None,
    })
}

const fn is_mark(letter: char) -> bool {
    matches!(letter, '.' | ',')
}

/// Length of an exponent such as `e-2` at the start of a text; 0 without one.
fn exponent_length(text: &str) -> usize {
    let Some(after) = text.strip_prefix('e') else { return 0 };
    let digits = after.strip_prefix(['-', '+']).unwrap_or(after);
    let end = digits.find(|letter: char| !letter.is_ascii_digit()).unwrap_or(digits.len());
    if end == 0 { 0 } else { text.len() - digits.len() + end }
}

/// The unit at the start of a text, behind spaces and underscores: its factor, and the length up to its end.
fn unit_at(text: &str) -> Option<(f64, usize)> {
    let word = text.trim_start_matches([' ', '_']);
    let end = word.find(|letter: char| !letter.is_alphabetic()).unwrap_or(word.len());
    Some((factor_of(&word[..end])?, text.len() - word.len() + end))
}

/// The first exposure in a name of small letters, such as `light_10ms`, `exp 0,5 s` or `1.5e-2s`.
pub(super) fn exposure_in(name: &str) -> Option<NamedExposure> {
    let mut at = 0;
    while let Some(offset) = name[at..].find(|letter: char| letter.is_ascii_digit()) {
        let start = at + offset;
        let is_number = |letter: char| letter.is_ascii_digit() || is_mark(letter);
        let end = name[start..].find(|letter| !is_number(letter)).map_or(name.len(), |length| start + length);
        let exponent = exponent_length(&name[end..]);
        // An `e` may begin a word too.
        let with_unit =
            [exponent, 0].into_iter().find_map(|exponent| Some((exponent, unit_at(&name[end + exponent..])?)));
        if let Some((exponent, (factor, unit))) = with_unit {
            let length = exponent + unit;
            let found = time_of(name, start..end, &name[end..end + exponent], factor, end + length);
            if found.is_some() {
                return found;
            }
        }
        at = end;
    }
    None
}

/// The time of the number in `digits`, followed by an exponent and a unit up to `end`; `None` where it is no number.
fn time_of(
    name: &str,
    digits: std::ops::Range<usize>,
    exponent: &str,
    factor: f64,
    end: usize,
) -> Option<NamedExposure> {
    let before = &name[..digits.start];
    let number = name[digits.clone()].trim_end_matches(is_mark);
    if let Some((whole, part)) = number.split_once(',')
        && part.len() == 3
        && !part.contains(is_mark)
        && !whole.starts_with('0')
    {
        return Some(NamedExposure::Comma { text: name[digits.start..end].to_owned() });
    }
    // A point at the start of a name or behind a space begins a number.
    let begins = |marked: &str| marked.is_empty() || marked.ends_with([' ', '_', '-', '/']);
    let point = if before.strip_suffix(is_mark).is_some_and(begins) { "0." } else { "" };
    let value: f64 = format!("{point}{}{exponent}", number.replace(',', ".")).parse().ok()?;
    let time_ns = value * factor;
    let Some((first, start)) = before.strip_suffix(['_', '-']).and_then(counter_at_end) else {
        return Some(NamedExposure::Known(time_ns));
    };
    // Cameras name fractions of a second: 1/100 s.
    let is_whole = number.chars().all(|letter| letter.is_ascii_digit()) && exponent.is_empty() && value >= 2.0;
    let fraction_ns = (first == 1.0 && factor == 1e9 && is_whole).then(|| factor / value);
    Some(NamedExposure::Pair { text: name[start..end].to_owned(), first, time_ns, fraction_ns })
}

/// The whole number at the end of a text, and its start; `None` where the text ends otherwise, as with `v1.1`.
fn counter_at_end(text: &str) -> Option<(f64, usize)> {
    let rest = text.trim_end_matches(|letter: char| letter.is_ascii_digit());
    (!rest.ends_with(is_mark)).then_some(())?;
    Some((text[rest.len()..].parse().ok()?, rest.len()))
}

/// Exposures of all names of a series, ns, and a sentence on those that have two meanings.
///
/// A counter before the time changes from name to name, the 1 of a fraction does not. So `1_5s` beside `2_5s` is 5 s, and `1_100s`
/// beside `1_50s` is 1/100 s. Alone it is not read.
pub(super) fn resolved(found: &[Option<NamedExposure>]) -> (Vec<Option<f64>>, Option<String>) {
    let (mut counts, mut times) = (false, BTreeSet::new());
    for exposure in found.iter().flatten() {
        if let NamedExposure::Pair { first, time_ns, fraction_ns, .. } = exposure {
            counts |= *first != 1.0;
            times.extend(fraction_ns.map(|_| time_ns.to_bits()));
        }
    }
    let mut unclear = None;
    let mut of = |exposure: &NamedExposure| {
        let meanings = match exposure {
            NamedExposure::Known(ns) | NamedExposure::Pair { time_ns: ns, fraction_ns: None, .. } => return Some(*ns),
            NamedExposure::Pair { time_ns, .. } if counts => return Some(*time_ns),
            NamedExposure::Pair { fraction_ns, .. } if times.len() > 1 => return *fraction_ns,
            NamedExposure::Pair { text, .. } => format!("{text:?} may be 1 over a number, or a counter and a time"),
            NamedExposure::Comma { text } => format!("{text:?} may be a decimal fraction, or thousands"),
        };
        unclear.get_or_insert(meanings);
        None
    };
    let values = found.iter().map(|exposure| exposure.as_ref().and_then(&mut of)).collect();
    (values, unclear.map(|meanings| format!("an exposure is not read: {meanings}; name the group like \"light 10ms\"")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(names: &[&str]) -> Vec<Option<f64>> {
        resolved(&names.iter().map(|name| exposure_in(name)).collect::<Vec<_>>()).0
    }

    #[test]
    fn exposures_are_read_from_names() {
        for (name, ns) in [
            ("light_10ms", Some(1e7)),
            ("level 3 0.5 s", Some(5e8)),
            ("exp250us", Some(2.5e5)),
            ("dark_100ns_2", Some(100.0)),
            ("1.5sec", Some(1.5e9)),
            ("10 msec", Some(1e7)),
            ("dark 0,5ms", Some(5e5)),
            ("light 12,25ms", Some(12.25e6)),
            ("0,125s", Some(1.25e8)),
            ("1.5e-2s", Some(1.5e7)),
            ("light 2e3us", Some(2e6)),
            ("dark .5ms", Some(5e5)),
            ("level.5ms", Some(5e6)),
            ("level 3. 10ms", Some(1e7)),
            ("level 1/100s", Some(1e11)),
            ("frame_2_5ms", Some(5e6)),
            ("frame_1_5ms", Some(5e6)),
            ("v1.1_5s", Some(5e9)),
            ("1_0.5s", Some(5e8)),
            ("1.2.5ms", None),
            ("level_3_stack", None),
            ("12 shots", None),
            ("2exposures", None),
            ("dark", None),
        ] {
            assert_eq!(times(&[name]), [ns], "{name}");
        }
    }

    #[test]
    fn fractions_keep_their_1_and_counters_change() {
        let fractions = times(&["dark 1_100s", "img_1_100s", "img_1_50s", "light 1-25s", "light 2s"]);
        assert_eq!(fractions, [Some(1e7), Some(1e7), Some(2e7), Some(4e7), Some(2e9)]);
        assert_eq!(times(&["level_1_5s", "level_2_5s", "level_3_10s"]), [Some(5e9), Some(5e9), Some(1e10)]);
        assert_eq!(times(&["frame_1_5s", "frame_2_5ms"]), [Some(5e9), Some(5e6)]);
    }

    #[test]
    fn exposures_of_two_meanings_are_not_read() {
        for (names, part) in [
            (["dark 1_100s", "light 1_100s"], "\"1_100s\" may be 1 over a number"),
            (["dark 1-50s", "light 2s"], "\"1-50s\" may be 1 over a number"),
            (["dark 1,250ms", "light 2ms"], "\"1,250ms\" may be a decimal fraction, or thousands"),
        ] {
            let (times, note) = resolved(&names.map(exposure_in));
            assert_eq!(times[0], None);
            assert!(note.clone().unwrap().contains(part), "{note:?}");
        }
        assert_eq!(resolved(&[exposure_in("10ms"), None]), (vec![Some(1e7), None], None));
    }
}
