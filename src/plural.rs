//! Counts and amounts beside the word that they count: "1 lenslet", "2 lenslets", "1 photon", "0.5 photons".

use std::fmt::Display;

/// A count or amount and its noun: "1 lenslet", "0 lenslets", "9 patches", "1 unreadable file".
///
/// `noun` is the singular and may have words before it. Its plural is that of the spelling; a noun with another one
/// ("axis") takes [`one_or_many`].
pub fn counted<N: Copy + Display + PartialEq + From<u8>>(count: N, noun: &str) -> String {
    let (stem, ending) = if count == N::from(1) { (noun, "") } else { plural(noun) };
    format!("{count} {stem}{ending}")
}

/// `one` for a count of 1, else `many`: verbs ("is", "are") and nouns with another plural ("axis", "axes").
pub fn one_or_many<'a>(count: usize, one: &'a str, many: &'a str) -> &'a str {
    if count == 1 { one } else { many }
}

/// What stays of a noun in its plural, and what follows.
fn plural(noun: &str) -> (&str, &str) {
    match noun.strip_suffix('y') {
        Some(stem) if !stem.ends_with(['a', 'e', 'o', 'u']) => (stem, "ies"),
        _ if ["ch", "sh", "s", "x"].iter().any(|ending| noun.ends_with(ending)) => (noun, "es"),
        _ => (noun, "s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_is_singular() {
        assert_eq!(counted(1, "lenslet"), "1 lenslet");
        assert_eq!(counted(0, "bead"), "0 beads");
        assert_eq!(counted(2_usize, "whole float image"), "2 whole float images");
        assert_eq!(counted(21_u64, "test patch"), "21 test patches");
        assert_eq!((counted(2, "pass"), counted(2, "box")), ("2 passes".into(), "2 boxes".into()));
        assert_eq!((counted(3, "entropy"), counted(3, "array")), ("3 entropies".into(), "3 arrays".into()));
        assert_eq!((counted(1.0, "photon"), counted(0.5, "photon")), ("1 photon".into(), "0.5 photons".into()));
        assert_eq!(format!("{} {}", 1, one_or_many(1, "axis", "axes")), "1 axis");
        assert_eq!(one_or_many(0, "is", "are"), "are");
    }
}
