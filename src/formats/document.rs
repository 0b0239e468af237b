//! JSON documents that name their kind: first `format` and `format_version`, then their content.
//!
//! Every kind of JSON file that the program writes is a [`DocumentKind`]. Older versions can always be opened; newer
//! versions are refused with an error sentence. [`content_key`] names saved work by its content.

use std::fmt;
use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::tables::{complete_json, read_json};
use super::{CompleteFile, FormatError};

/// A kind of JSON document.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DocumentKind {
    /// Value of the entry `format`, such as "lenslet-studio/design".
    pub format: &'static str,
    /// Newest `format_version`, which is the one written.
    pub version: u64,
    /// Name in sentences, such as "a design".
    pub name: &'static str,
    /// Whether files without the two entries are of this kind. They were written before the kind had these entries.
    pub was_unmarked: bool,
}

/// Reason why a JSON value is not a document of a kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Mismatch {
    /// It is something else, as described here.
    OtherKind(String),
    /// It was written by a newer program, in this version of the format.
    Newer(u64),
    /// Its version is unreadable.
    NoVersion,
}

impl fmt::Display for Mismatch {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OtherKind(found) => formatter.write_str(found),
            Self::Newer(version) => write!(formatter, "version {version}, written by a newer Lenslet Studio"),
            Self::NoVersion => formatter.write_str("no usable format_version"),
        }
    }
}

impl Mismatch {
    /// Advice for the user.
    pub fn advice(&self) -> &'static str {
        match self {
            Self::OtherKind(_) => "choose another file",
            Self::Newer(_) => "update this program to open it",
            Self::NoVersion => "restore it from a backup",
        }
    }
}

/// A document with its two format entries, as written.
#[derive(Serialize)]
struct Marked<'a, T> {
    format: &'a str,
    format_version: u64,
    #[serde(flatten)]
    content: &'a T,
}

impl DocumentKind {
    /// A kind in its first version whose files have always had `format` and `format_version`.
    pub const fn new(format: &'static str, name: &'static str) -> Self {
        Self { format, version: 1, name, was_unmarked: false }
    }

    /// A kind whose files of earlier programs have neither entry.
    pub const fn unmarked_before(format: &'static str, name: &'static str) -> Self {
        Self { format, version: 1, name, was_unmarked: true }
    }

    /// The kind with another version: the newest that is read, and the one written.
    #[must_use]
    pub const fn at_version(self, version: u64) -> Self {
        Self { version, ..self }
    }

    /// Version of a document of this kind. It is 0 for a document without the two entries, where the kind once had none.
    ///
    /// # Errors
    /// The mismatch, where the value is another kind of document.
    pub fn version_of(&self, value: &Value) -> Result<u64, Mismatch> {
        match value.get("format").map(Value::as_str) {
            Some(Some(format)) if format == self.format => {}
            Some(Some(other)) => return Err(Mismatch::OtherKind(format!("format {other:?}"))),
            None if self.was_unmarked => return Ok(0),
            _ => return Err(Mismatch::OtherKind("no format entry".to_owned())),
        }
        match value.get("format_version").and_then(Value::as_u64) {
            Some(known) if (1..=self.version).contains(&known) => Ok(known),
            Some(newer) if newer > self.version => Err(Mismatch::Newer(newer)),
            _ => Err(Mismatch::NoVersion),
        }
    }

    /// Content of a value that was read from `path`.
    ///
    /// # Errors
    /// [`FormatError::Malformed`] where the value is another kind of document, a newer one, or damaged.
    pub fn content<T: DeserializeOwned>(&self, value: Value, path: &Path) -> Result<T, FormatError> {
        let expected = || format!("{} of version {} or earlier", self.name, self.version);
        self.version_of(&value)
            .map_err(|found| FormatError::malformed(path, expected(), found.to_string(), found.advice()))?;
        // The error starts with the entry that it concerns.
        serde_path_to_error::deserialize(value).map_err(|error| {
            FormatError::malformed(path, expected(), error.to_string(), "restore the file from a backup")
        })
    }

    /// Reads a document of this kind.
    ///
    /// # Errors
    /// [`FormatError`] where the file cannot be read, is another kind of document, a newer one, or damaged.
    pub fn read<T: DeserializeOwned>(&self, path: &Path) -> Result<T, FormatError> {
        self.content(read_json(path)?, path)
    }

    /// Whether the file holds a document of this kind that needs a newer program. Such a file is never overwritten.
    pub fn is_newer(&self, path: &Path) -> bool {
        read_json::<Value>(path).is_ok_and(|value| matches!(self.version_of(&value), Err(Mismatch::Newer(_))))
    }

    /// Writes a document of this kind atomically: afterwards the file is either the complete old one or the complete new
    /// one.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] where it cannot be written.
    pub fn write(&self, path: &Path, content: &impl Serialize) -> Result<(), FormatError> {
        self.complete(path, content)?.put_in_place()
    }

    /// [`DocumentKind::write`] without the final renaming.
    ///
    /// # Errors
    /// As [`DocumentKind::write`].
    pub fn complete(&self, path: &Path, content: &impl Serialize) -> Result<CompleteFile, FormatError> {
        complete_json(path, &self.marked(content))
    }

    /// The document with its two format entries, as written.
    pub fn marked<'a>(&'a self, content: &'a impl Serialize) -> impl Serialize + 'a {
        Marked { format: self.format, format_version: self.version, content }
    }
}

/// Key of saved work: the BLAKE3 hash, in hexadecimal, of the canonical JSON of everything that determines its content.
///
/// Canonical JSON sorts all entry names by code point and has no blanks. Entries need fixed names, so that no change of
/// the code renames them.
pub fn content_key(content: &Value) -> String {
    // serde_json sorts the entries of objects by name.
    blake3::hash(content.to_string().as_bytes()).to_hex().to_string()
}

/// JSON of a value, for [`content_key`]; `null` where it has none.
pub fn json_of(value: &impl Serialize) -> Value {
    serde_json::to_value(value).unwrap_or_default()
}

/// Entries of a list. Older programs wrote it as a bare array.
#[derive(Deserialize)]
#[serde(untagged)]
pub enum Listed<T> {
    /// The current form.
    Entries {
        /// The entries.
        entries: Vec<T>,
    },
    /// The form without format entries.
    Bare(Vec<T>),
}

impl<T> Listed<T> {
    /// The entries.
    pub fn into_entries(self) -> Vec<T> {
        match self {
            Self::Entries { entries } | Self::Bare(entries) => entries,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde_json::json;

    use super::*;

    const KIND: DocumentKind = DocumentKind::new("lenslet-studio/test", "a test");
    const ONCE_UNMARKED: DocumentKind = DocumentKind::unmarked_before("lenslet-studio/test", "a test");

    #[test]
    fn documents_read_back_and_begin_with_their_format() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        let content = BTreeMap::from([("bits".to_owned(), 0.25), ("a".to_owned(), 1.0)]);
        KIND.write(&path, &content).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("{\n  \"format\": \"lenslet-studio/test\",\n  \"format_version\": 1,"), "{text}");
        let read: serde_json::Map<String, Value> = KIND.read(&path).unwrap();
        assert_eq!(read["bits"], 0.25);
    }

    #[test]
    fn other_and_newer_documents_are_refused_and_unmarked_ones_where_none_ever_were() {
        let path = Path::new("a.json");
        let refused = |kind: DocumentKind, value: Value| kind.content::<Value>(value, path).unwrap_err().to_string();
        let newer = json!({"format": KIND.format, "format_version": 2});
        for kind in [KIND, ONCE_UNMARKED] {
            let found = refused(kind, newer.clone());
            assert!(found.contains("version 2, written by a newer") && found.contains("update"), "{found}");
            let found = refused(kind, json!({"format": "lenslet-studio/design", "format_version": 1}));
            assert!(found.contains("format \"lenslet-studio/design\""), "{found}");
            assert!(refused(kind, json!({"format": KIND.format})).contains("no usable format_version"));
            assert!(refused(kind, json!({"format": 3})).contains("no format entry"));
        }
        assert!(refused(KIND, json!({"bits": 1})).contains("no format entry"));
        assert_eq!(ONCE_UNMARKED.version_of(&json!({"bits": 1})), Ok(0));
        assert_eq!(ONCE_UNMARKED.version_of(&json!([1, 2])), Ok(0));
    }

    #[test]
    fn lists_are_read_bare_and_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("list");
        for text in ["[1, 2]", "{\"format\": \"lenslet-studio/test\", \"format_version\": 1, \"entries\": [1, 2]}"] {
            std::fs::write(&path, text).unwrap();
            let list: Listed<u8> = ONCE_UNMARKED.read(&path).unwrap();
            assert_eq!(list.into_entries(), [1, 2], "{text}");
        }
    }

    #[test]
    fn keys_depend_on_content_and_not_on_the_order_of_entries() {
        let key = |text: &str| content_key(&serde_json::from_str(text).unwrap());
        assert_eq!(key("{\"b\": [1.5, null], \"a\": \"x\"}"), key("{\"a\":\"x\",\"b\":[1.50,null]}"));
        assert_ne!(key("{\"a\": 1}"), key("{\"a\": 2}"));
        assert_eq!(content_key(&json!({})), blake3::hash(b"{}").to_hex().to_string());
    }
}
