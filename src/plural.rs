//! Counts beside the word that they count: "1 lenslet", "2 lenslets".

/// A count and its noun, whose plural takes an `s`: "1 lenslet", "0 lenslets", "9 lenslets".
///
/// `noun` is the singular and may have words before it: `counted(1, "unreadable file")`.
pub fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", one_or_many(count, "", "s"))
}

/// `one` for a count of 1, else `many`: verbs ("is", "are") and nouns with another plural ("axis", "axes").
pub fn one_or_many<'a>(count: usize, one: &'a str, many: &'a str) -> &'a str {
    if count == 1 { one } else { many }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_is_singular() {
        assert_eq!(counted(1, "lenslet"), "1 lenslet");
        assert_eq!(counted(0, "bead"), "0 beads");
        assert_eq!(counted(2, "whole float picture"), "2 whole float pictures");
        assert_eq!(counted(21, "file"), "21 files");
        assert_eq!(format!("{} {}", 1, one_or_many(1, "axis", "axes")), "1 axis");
        assert_eq!(one_or_many(0, "is", "are"), "are");
    }
}
