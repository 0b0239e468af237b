//! Settings files: a photograph and the options of its import, as TOML.
//!
//! Every option has the name that it has in a path. The photograph's path starts at the folder of the file.

use std::fmt::Write;
use std::path::Path;

use toml::{Table, Value};

use super::error::PsfError;
use super::options::{NAMES, PsfImportOptions};
use super::photograph::PsfPhotograph;
use crate::formats::{FormatError, ImageFile, Meaning, PathOption, path_text, write_safely};

const FORMAT: &str = "lenslet-studio/psf-import";
const VERSION: i64 = 1;
/// Largest settings file, bytes.
const LARGEST: u64 = 1 << 16;
/// Entry of the photograph.
const PHOTOGRAPH: &str = "photograph";
const EXPECTED: &str = "the settings of a PSF import, version 1 or earlier";

/// Whether a path is that of a settings file.
pub(super) fn is_settings_file(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
}

/// Reads a settings file.
pub(super) fn open_settings(path: &Path) -> Result<PsfPhotograph, PsfError> {
    let refuse = |found: String, advice: &'static str| PsfError::Settings {
        path: path.to_owned(),
        expected: EXPECTED,
        found,
        advice,
    };
    let unreadable = |error| PsfError::from(FormatError::from_read(path, error));
    let size = std::fs::metadata(path).map_err(unreadable)?.len();
    if size > LARGEST {
        return Err(refuse(format!("a file of {size} bytes"), "choose another file"));
    }
    let text = std::fs::read_to_string(path).map_err(unreadable)?;
    let mut table: Table = text
        .parse()
        .map_err(|error: toml::de::Error| refuse(error.message().replace('\n', " "), "correct it in a text editor"))?;
    match table.remove("format") {
        Some(Value::String(format)) if format == FORMAT => {}
        Some(format) => return Err(refuse(format!("format {format}"), "choose another file")),
        None => return Err(refuse("no format entry".into(), "choose another file")),
    }
    match table.remove("format_version") {
        Some(Value::Integer(version)) if (1..=VERSION).contains(&version) => {}
        Some(Value::Integer(version)) if version > VERSION => {
            let found = format!("version {version}, written by a newer Lenslet Studio");
            return Err(refuse(found, "update this program to open it"));
        }
        _ => return Err(refuse("no usable format_version".into(), "restore it from a backup")),
    }
    let Some(Value::String(photograph)) = table.remove(PHOTOGRAPH) else {
        return Err(refuse("no photograph".into(), "add photograph = \"FILE\""));
    };
    let options: Vec<PathOption> = table
        .into_iter()
        .map(|(name, value)| match value {
            Value::String(text) => PathOption { name, value: text },
            other => PathOption { name, value: other.to_string() },
        })
        .collect();
    let (own, others): (Vec<_>, Vec<_>) = options.into_iter().partition(|option| NAMES.contains(&option.name.as_str()));
    let meaning = Meaning::of(&others).map_err(|found| refuse(found, "correct or remove that entry"))?;
    let options = PsfImportOptions::of(&own, &path.display().to_string())?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let found = ImageFile::find(&folder.join(photograph))?;
    Ok(PsfPhotograph { file: ImageFile { path: found.path, meaning }, options })
}

impl PsfPhotograph {
    /// Writes the settings file that [`PsfPhotograph::find`] opens.
    ///
    /// # Errors
    /// [`FormatError`] where it cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FormatError> {
        let text = self.settings(path);
        write_safely(path, |writer| writer.write_all(text.as_bytes()))
    }

    /// Text of the settings file at a path.
    fn settings(&self, path: &Path) -> String {
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let (photograph, own) = (absolute(&self.file.path), absolute(path));
        // A photograph beside or below the file is named from there, so that both can be moved.
        let photograph = own.parent().and_then(|folder| photograph.strip_prefix(folder).ok()).unwrap_or(&photograph);
        let mut text = format!(
            "format = \"{FORMAT}\"\nformat_version = {VERSION}\n{PHOTOGRAPH} = {}\n",
            Value::String(path_text(photograph))
        );
        for PathOption { name, value } in self.path_options() {
            let value = value.parse().map_or(Value::String(value), Value::Integer);
            let _ = writeln!(text, "{name} = {value}");
        }
        text
    }
}
