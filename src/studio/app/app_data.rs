//! Files that outlive a session: preferences, layout and snapshots, each in a file of its own.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use egui_tiles::Tree;
use serde::Serialize;
use serde_json::Value;
use thiserror::Error;

use crate::formats::{DocumentKind, FileWriter, FormatError, json_of, read_json};
use crate::studio::app::layout;
use crate::studio::state::pane::Pane;
use crate::studio::state::preferences::{Preferences, RECENT, RendererChoice, THREADS, ZOOM};
use crate::workbench::FileChange;

/// Names of the files.
const PREFERENCES: &str = "preferences.json";
const LAYOUT: &str = "layout.json";
/// Their kinds.
const PREFERENCES_KIND: DocumentKind =
    DocumentKind::unmarked_before("lenslet-studio/preferences", "the preferences of the window");
const LAYOUT_KIND: DocumentKind = DocumentKind::unmarked_before("lenslet-studio/layout", "a layout of the window");
/// File in which eframe stores size and position of the window.
const GEOMETRY: &str = "app.ron";
/// Folder of the snapshots.
pub const SNAPSHOTS: &str = "kept";

/// Reason why a folder cannot store application data.
#[derive(Debug, Error)]
#[error("{} cannot be written ({reason})", folder.display())]
pub struct AppDataError {
    folder: PathBuf,
    reason: std::io::Error,
}

/// The folder of the application data, and the thread that writes its files.
pub struct AppData {
    folder: PathBuf,
    /// Preferences written last.
    preferences: Preferences,
    layout: String,
    /// Content of the preferences file that this window wrote last.
    written: Arc<Mutex<Value>>,
    writer: FileWriter,
}

impl AppData {
    /// Preferences and layout of a folder; unreadable files count as missing.
    pub fn read(folder: &Path) -> (Preferences, Option<Tree<Pane>>) {
        let mut preferences: Preferences = PREFERENCES_KIND.read(&folder.join(PREFERENCES)).unwrap_or_default();
        if !ZOOM.contains(&preferences.zoom) {
            preferences.zoom = 1.0;
        }
        preferences.threads = preferences.threads.filter(|count| THREADS.contains(count));
        (preferences, LAYOUT_KIND.read(&folder.join(LAYOUT)).ok().and_then(layout::restored))
    }

    /// Application data in a folder whose files hold these preferences and this layout. `on_attempt` is called after each attempt to
    /// write a file, because [`AppData::keep`] may then return its failure.
    ///
    /// # Errors
    /// If the folder is not writable, or no thread can be started.
    pub fn in_folder(
        folder: &Path,
        preferences: &Preferences,
        layout: Option<&Tree<Pane>>,
        on_attempt: impl Fn() + Send + 'static,
    ) -> Result<Self, AppDataError> {
        let refused = |reason| AppDataError { folder: folder.to_owned(), reason };
        std::fs::create_dir_all(folder).and_then(|()| tempfile::tempfile_in(folder)).map_err(refused)?;
        let writer = FileWriter::start("lenslet-app-data", Duration::ZERO, on_attempt).map_err(refused)?;
        Ok(Self {
            folder: folder.to_owned(),
            preferences: preferences.clone(),
            layout: layout.and_then(|layout| layout_text(layout).ok()).unwrap_or_default(),
            written: Arc::new(Mutex::new(json_of(&preferences.storable()))),
            writer,
        })
    }

    /// One sentence per file of a newer program version. Such files are neither used nor overwritten.
    pub fn newer_files(folder: &Path) -> Vec<String> {
        let is_newer = |(kind, name): &(DocumentKind, &str)| kind.is_newer(&folder.join(name));
        let files = [(PREFERENCES_KIND, PREFERENCES), (LAYOUT_KIND, LAYOUT)];
        let refused = |(kind, name): (DocumentKind, &str)| kind.read::<Value>(&folder.join(name)).err();
        files.into_iter().filter(is_newer).filter_map(refused).map(|error| error.to_string()).collect()
    }

    /// Renderer in the preferences of a folder.
    pub fn renderer(folder: &Path) -> Option<RendererChoice> {
        PREFERENCES_KIND.read::<Preferences>(&folder.join(PREFERENCES)).ok().map(|preferences| preferences.renderer)
    }

    /// Resets layout and preferences of a folder. Recent files and the folder of unsaved changes stay, so that designs left
    /// by a crash are still offered.
    ///
    /// # Errors
    /// If the files cannot be written.
    pub fn reset(folder: &Path) -> Result<(), FormatError> {
        for name in [LAYOUT, GEOMETRY] {
            // The file may not exist.
            let _ = std::fs::remove_file(folder.join(name));
        }
        let path = folder.join(PREFERENCES);
        let Ok(known) = PREFERENCES_KIND.read::<Preferences>(&path) else { return Ok(()) };
        PREFERENCES_KIND
            .write(&path, &Preferences { recent: known.recent, unsaved: known.unsaved, ..Preferences::default() })
    }

    /// Writes changed preferences, and the layout if given, on another thread. Returns the failure of an earlier write once.
    pub fn keep(&mut self, preferences: &Preferences, layout: Option<&Tree<Pane>>) -> Option<String> {
        if self.preferences != *preferences {
            self.preferences = preferences.clone();
            let now = match serde_json::to_value(preferences.storable()) {
                Ok(now) => now,
                Err(error) => return Some(format!("the preferences were not saved: {error}")),
            };
            let path = self.folder.join(PREFERENCES);
            let (file, written, value) = (path.clone(), Arc::clone(&self.written), now.clone());
            let content = move || {
                if PREFERENCES_KIND.is_newer(&file) {
                    return None;
                }
                let before = written.lock().unwrap_or_else(PoisonError::into_inner).clone();
                bytes_of(&PREFERENCES_KIND.marked(&changed(&file, &before, value)))
            };
            let written = Arc::clone(&self.written);
            let then = move || *written.lock().unwrap_or_else(PoisonError::into_inner) = now;
            self.writer.write(path, Box::new(content), Some(Box::new(then)));
        }
        if let Some(Ok(text)) = layout.map(layout_text)
            && text != self.layout
        {
            self.layout.clone_from(&text);
            let path = self.folder.join(LAYOUT);
            let file = path.clone();
            let content = move || (!LAYOUT_KIND.is_newer(&file)).then(|| text.into_bytes());
            self.writer.write(path, Box::new(content), None);
        }
        self.writer.take_failure()
    }

    /// Writes and removes files of snapshots, on another thread.
    pub fn keep_designs(&self, changes: Vec<FileChange>) {
        for (name, content) in changes {
            let path = self.folder.join(SNAPSHOTS).join(name);
            match content {
                Some(content) => self.writer.write(path, content, None),
                None => self.writer.remove(path, None),
            }
        }
    }
}

/// Content of the preferences file after a change from `before` to `now`. Changes by another window stay.
fn changed(path: &Path, before: &Value, now: Value) -> Value {
    let (Ok(Value::Object(mut file)), Value::Object(now)) = (read_json(path), &now) else { return now };
    for (name, value) in now.iter().filter(|&(name, value)| before.get(name) != Some(value)) {
        let value = if name == "recent" { with_others(value, file.get(name)) } else { value.clone() };
        file.insert(name.clone(), value);
    }
    // The writer adds them before the content.
    for mark in ["format", "format_version"] {
        file.remove(mark);
    }
    Value::Object(file)
}

/// Text of a layout file.
fn layout_text(layout: &Tree<Pane>) -> serde_json::Result<String> {
    text_of(&LAYOUT_KIND.marked(layout))
}

/// Recent files of this window and of others; empty if the list was cleared.
fn with_others(own: &Value, known: Option<&Value>) -> Value {
    match (own.as_array(), known.and_then(Value::as_array)) {
        (Some(own), Some(known)) if !own.is_empty() => {
            let others = known.iter().filter(|path| !own.contains(path));
            own.iter().chain(others).take(RECENT).cloned().collect()
        }
        _ => own.clone(),
    }
}

/// Content of a file; `None` if the value cannot be written as JSON.
fn bytes_of(value: &impl Serialize) -> Option<Vec<u8>> {
    text_of(value).ok().map(String::into_bytes)
}

/// JSON with sorted keys, so that equal values are equal texts.
fn text_of(value: &impl Serialize) -> serde_json::Result<String> {
    let value = serde_json::to_value(value)?;
    Ok(format!("{value:#}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::studio::app::layout::default_layout;

    /// Application data in a folder, with its preferences and layout.
    fn home_in(folder: &Path) -> (AppData, Preferences, Option<Tree<Pane>>) {
        let (preferences, layout) = AppData::read(folder);
        (AppData::in_folder(folder, &preferences, layout.as_ref(), || ()).unwrap(), preferences, layout)
    }

    #[test]
    fn preferences_are_restored_and_broken_files_are_ignored() {
        let folder = tempfile::tempdir().unwrap();
        let (mut app_data, mut preferences, layout) = home_in(folder.path());
        assert!(preferences == Preferences::default() && layout.is_none());
        preferences.zoom = 1.5;
        preferences.remember(Path::new("/a/one.json"));
        preferences.remember(Path::new("/a/two.json"));
        preferences.remember(Path::new("/a/one.json"));
        let arranged = default_layout();
        assert_eq!(app_data.keep(&preferences, Some(&arranged)), None);
        drop(app_data);
        let (app_data, known, layout) = home_in(folder.path());
        assert_eq!(known, preferences);
        assert_eq!(known.recent, [Path::new("/a/one.json"), Path::new("/a/two.json")]);
        assert_eq!(text_of(&layout.unwrap()).unwrap(), text_of(&arranged).unwrap());
        drop(app_data);
        AppData::reset(folder.path()).unwrap();
        let (_, reset, layout) = home_in(folder.path());
        assert_eq!((reset.recent.len(), reset.zoom), (2, 1.0));
        assert!(layout.is_none());
        for name in [PREFERENCES, LAYOUT] {
            std::fs::write(folder.path().join(name), b"{\"zoom\": 1e9, \"root\": 3").unwrap();
        }
        let (_, known, layout) = home_in(folder.path());
        assert!(known == Preferences::default() && layout.is_none());
    }

    #[test]
    fn changes_of_two_windows_are_merged() {
        let folder = tempfile::tempdir().unwrap();
        let (mut one, mut chosen, _) = home_in(folder.path());
        let (mut other, mut zoomed, _) = home_in(folder.path());
        chosen.unsaved = Some("/a/safe".into());
        chosen.remember(Path::new("/a/one.json"));
        assert_eq!(one.keep(&chosen, None), None);
        drop(one);
        zoomed.zoom = 1.5;
        zoomed.remember(Path::new("/a/other.json"));
        assert_eq!(other.keep(&zoomed, None), None);
        drop(other);
        let (mut next, mut known, _) = home_in(folder.path());
        chosen.remember(Path::new("/a/other.json"));
        assert_eq!(known, Preferences { zoom: 1.5, ..chosen });
        known.recent.clear();
        assert_eq!(next.keep(&known, None), None);
        drop(next);
        assert!(home_in(folder.path()).1.recent.is_empty(), "they were to be forgotten");
    }

    #[test]
    #[cfg(unix)]
    fn non_unicode_path_is_skipped_alone() {
        use std::os::unix::ffi::OsStrExt;
        let odd = Path::new(std::ffi::OsStr::from_bytes(b"/a/\xff.json"));
        assert!(text_of(&odd).is_err());
        let folder = tempfile::tempdir().unwrap();
        let (mut app_data, mut preferences, _) = home_in(folder.path());
        preferences.zoom = 1.5;
        preferences.remember(Path::new("/a/one.json"));
        preferences.remember(odd);
        preferences.unsaved = Some(odd.to_owned());
        assert_eq!(app_data.keep(&preferences, None), None);
        drop(app_data);
        let (_, known, _) = home_in(folder.path());
        let recent = vec![PathBuf::from("/a/one.json")];
        assert_eq!(known, Preferences { zoom: 1.5, recent, ..Preferences::default() });
        assert_eq!(preferences.recent[0], odd, "this window can open it again");
    }

    #[test]
    fn unwritable_folder_is_refused_in_one_sentence() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, b"").unwrap();
        for place in [file.clone(), file.join("below"), "/proc/nowhere".into()] {
            let (preferences, layout) = AppData::read(&place);
            let Err(error) = AppData::in_folder(&place, &preferences, layout.as_ref(), || ()) else {
                panic!("{place:?}")
            };
            let sentence = error.to_string();
            assert!(
                sentence.starts_with(&place.display().to_string()) && sentence.contains("cannot be written"),
                "{sentence}"
            );
            assert!(!sentence.contains("make the folder"), "{sentence}");
        }
    }
}
