//! Comma-separated tables and JSON.

use std::io::{self, Read};
use std::path::Path;

use serde::{Serialize, de::DeserializeOwned};

use super::bytes::open;
use super::kind::named_for_what_it_is;
use super::{CompleteFile, FormatError, complete_file};

/// Largest JSON file read, bytes.
const LARGEST_JSON_BYTES: u64 = 256 << 20;

/// Writes a comma-separated table (RFC 4180) of numbers. Each has the digits that read back to the same `f64`.
///
/// # Errors
/// [`FormatError::NotWritten`] if it cannot be written or a row does not have the length of the header.
pub fn write_csv(path: &Path, header: &[&str], rows: impl Iterator<Item = Vec<f64>>) -> Result<(), FormatError> {
    complete_csv(path, header, rows)?.put_in_place()
}

/// [`write_csv`] without the final renaming.
///
/// # Errors
/// As [`write_csv`].
pub fn complete_csv(
    path: &Path,
    header: &[&str],
    rows: impl Iterator<Item = Vec<f64>>,
) -> Result<CompleteFile, FormatError> {
    complete_csv_text(path, header, rows.map(|row| row.iter().map(|value| format!("{value:?}")).collect()))
}

/// Writes a comma-separated table (RFC 4180) of texts, quoted where needed.
///
/// # Errors
/// [`FormatError::NotWritten`] if it cannot be written or a row does not have the length of the header.
pub fn write_csv_text(
    path: &Path,
    header: &[&str],
    rows: impl Iterator<Item = Vec<String>>,
) -> Result<(), FormatError> {
    complete_csv_text(path, header, rows)?.put_in_place()
}

fn complete_csv_text(
    path: &Path,
    header: &[&str],
    rows: impl Iterator<Item = Vec<String>>,
) -> Result<CompleteFile, FormatError> {
    complete_file(path, |writer| {
        let names: Vec<String> = header.iter().map(|name| quoted(name)).collect();
        writeln!(writer, "{}", names.join(","))?;
        for (index, row) in rows.enumerate() {
            if row.len() != header.len() {
                let text = format!("row {} of {} values under {} names", index + 1, row.len(), header.len());
                return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
            }
            let values: Vec<String> = row.iter().map(|value| quoted(value)).collect();
            writeln!(writer, "{}", values.join(","))?;
        }
        Ok(())
    })
}

fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.into() }
}

/// Writes a value as indented JSON with a final newline.
///
/// # Errors
/// [`FormatError::NotWritten`] if it cannot be written or has no JSON form.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), FormatError> {
    complete_json(path, value)?.put_in_place()
}

/// [`write_json`] without the final renaming.
///
/// # Errors
/// As [`write_json`].
pub fn complete_json(path: &Path, value: &impl Serialize) -> Result<CompleteFile, FormatError> {
    complete_file(path, |writer| {
        serde_json::to_writer_pretty(&mut *writer, value).map_err(io::Error::from)?;
        writer.write_all(b"\n")
    })
}

/// Reads a value from JSON of at most 256 MiB.
///
/// # Errors
/// [`FormatError`] if the file is missing, too large, or not JSON of this kind; line and column are given.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, FormatError> {
    let (file, length) = open(path)?;
    if length > LARGEST_JSON_BYTES {
        let expected = format!("at most {LARGEST_JSON_BYTES} bytes of JSON");
        return Err(FormatError::malformed(path, expected, format!("{length} bytes"), "choose another file"));
    }
    let mut text = Vec::new();
    file.take(LARGEST_JSON_BYTES).read_to_end(&mut text).map_err(|error| FormatError::from_read(path, error))?;
    // Editors may write a byte order mark first.
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&text);
    if !matches!(text.trim_ascii_start().first(), Some(b'{' | b'[' | b'"' | b'-' | b'0'..=b'9' | b't' | b'f' | b'n')) {
        return Err(named_for_what_it_is(path, "JSON"));
    }
    // The text of the error ends with line and column.
    serde_json::from_slice(text)
        .map_err(|error| FormatError::malformed(path, "JSON of this kind", error.to_string(), "correct that place"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_keep_every_digit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let rows = vec![vec![1.0 / 3.0, 1e300], vec![f64::NAN, -0.1]];
        write_csv(&path, &["bits", "mean, \"photons\""], rows.into_iter()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, "bits,\"mean, \"\"photons\"\"\"\n0.3333333333333333,1e300\nNaN,-0.1\n");
        let error = write_csv(&path, &["a"], vec![vec![1.0], vec![1.0, 2.0]].into_iter()).unwrap_err().to_string();
        assert!(error.contains("row 2 of 2 values under 1 names"), "{error}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }

    #[test]
    fn json_reads_back_and_mistakes_have_a_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        write_json(&path, &vec![0.1, 2.0]).unwrap();
        assert!(std::fs::read_to_string(&path).unwrap().ends_with("]\n"));
        assert_eq!(read_json::<Vec<f64>>(&path).unwrap(), [0.1, 2.0]);
        std::fs::write(&path, "[1,\n \"two\"]").unwrap();
        let error = read_json::<Vec<f64>>(&path).unwrap_err().to_string();
        assert!(error.contains("line 2 column 6"), "{error}");
        std::fs::write(&path, vec![b'['; 100_000]).unwrap();
        assert!(read_json::<serde_json::Value>(&path).is_err());
    }
}
