//! Words of a POSIX shell.

/// `word` as a person types it in a shell: quoted where it has to be.
pub fn shell_word(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:+,@=".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) { word.to_owned() } else { shell_quoted(word) }
}

/// `word` in quotes.
pub fn shell_quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_where_they_have_to_be() {
        let words = ["a/b", "a b", "it's", ""].map(shell_word);
        assert_eq!(words, ["a/b", "'a b'", "'it'\\''s'", "''"]);
    }
}
