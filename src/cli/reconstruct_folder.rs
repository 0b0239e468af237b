//! The folder of `reconstruct --out`: its lock, the settings of its networks, and the state of a training.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::choices::check_folder;
use super::stop::StopSignal;
use crate::formats::{DocumentKind, lock_folder, write_safely};
use crate::information::{FitCheckpoint, FitFile, InformationError};

/// The kind of the file of settings.
const SETTINGS: DocumentKind = DocumentKind::new("lenslet-studio/networks", "settings of trained networks");
/// Its name.
const SETTINGS_FILE: &str = "networks.json";
/// Names of the files of networks: weights of `network-1.safetensors`, the state of a training `network-1.state`.
const NETWORK_PREFIX: &str = "network-";
const NETWORK_ENDINGS: [&str; 2] = [".safetensors", ".state"];

/// The folder of the results, which other programs do not write into. One that was made for them is removed where it stays empty.
pub struct OutFolder {
    /// Folders that were made, the innermost first.
    made: Vec<PathBuf>,
    lock: Option<File>,
}

impl OutFolder {
    /// Makes and locks the folder.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        let missing = path.ancestors().take_while(|folder| !folder.as_os_str().is_empty() && !folder.exists());
        let mut opened = Self { made: missing.map(Path::to_path_buf).collect(), lock: None };
        check_folder(path)?;
        opened.lock = lock_folder(path)?;
        Ok(opened)
    }

    /// Ends the lock, before a writer with a lock of its own.
    pub fn unlock(&mut self) {
        self.lock = None;
    }
}

impl Drop for OutFolder {
    fn drop(&mut self) {
        self.unlock();
        for folder in &self.made {
            // One that holds anything stays.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// A folder of networks of the same settings.
pub struct NetworkFolder<'a> {
    path: &'a Path,
    settings: KeptSettings,
    /// Whether it had networks of these settings before.
    is_known: bool,
    is_written: bool,
}

/// Content of the file of settings: the key of all that decides the networks.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct KeptSettings {
    settings: String,
}

impl<'a> NetworkFolder<'a> {
    /// Refuses a folder with networks of other settings. Nothing is written before [`NetworkFolder::begin`].
    pub fn find(path: &'a Path, settings: String) -> anyhow::Result<Self> {
        let settings = KeptSettings { settings };
        let file = path.join(SETTINGS_FILE);
        // Settings alone are those of a training that has never begun.
        let is_known = file.exists() && has_networks(path);
        if is_known && SETTINGS.read::<KeptSettings>(&file)? != settings {
            anyhow::bail!(
                "{}: expected the settings of the networks that are there, found others; choose another --out",
                path.display()
            );
        }
        Ok(Self { path, settings, is_known, is_written: is_known })
    }

    /// Key of all that decides the networks.
    pub fn settings(&self) -> &str {
        &self.settings.settings
    }

    /// Whether it had networks of these settings before.
    pub fn is_known(&self) -> bool {
        self.is_known
    }

    /// Writes the file of the settings, once.
    pub fn begin(&mut self) -> anyhow::Result<()> {
        if !self.is_written {
            SETTINGS.write(&self.path.join(SETTINGS_FILE), &self.settings)?;
            self.is_written = true;
        }
        Ok(())
    }

    /// File of the weights of a network, by its number from 1.
    pub fn weights(&self, number: usize) -> PathBuf {
        self.path.join(format!("{NETWORK_PREFIX}{number}{}", NETWORK_ENDINGS[0]))
    }

    /// File of the state of its training.
    pub fn state(&self, number: usize) -> PathBuf {
        self.path.join(format!("{NETWORK_PREFIX}{number}{}", NETWORK_ENDINGS[1]))
    }
}

/// Whether a folder has weights of networks or states of trainings.
fn has_networks(folder: &Path) -> bool {
    fs::read_dir(folder).into_iter().flatten().flatten().any(|entry| {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        name.starts_with(NETWORK_PREFIX) && NETWORK_ENDINGS.iter().any(|ending| name.ends_with(ending))
    })
}

/// File of the state of a training. A full disk stops no training, but it is the error of one that is asked to stop.
pub struct StateFile<'a> {
    /// The file and the key of the training.
    pub file: FitFile,
    /// Signal that asks the training to stop.
    pub stop: &'a StopSignal,
}

impl FitCheckpoint for StateFile<'_> {
    fn key(&self) -> &str {
        self.file.key()
    }

    fn place(&self) -> String {
        self.file.place()
    }

    fn every(&self) -> Duration {
        self.file.every()
    }

    fn load(&self) -> Result<Option<Vec<u8>>, InformationError> {
        self.file.load()
    }

    fn store(&self, state: &[u8]) -> Result<(), InformationError> {
        let written = write_safely(&self.file.path, |out| out.write_all(state));
        // While the training runs, the earlier state stays, and the next one may find room.
        if self.stop.check().is_break() { Ok(written?) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_that_were_made_go_unless_they_hold_files() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("a/b");
        let opened = OutFolder::open(&inner).unwrap();
        let busy = OutFolder::open(&inner).err().unwrap().to_string();
        assert!(busy.contains("another run at work"), "{busy}");
        drop(opened);
        assert!(!folder.path().join("a").exists() && folder.path().exists());
        let opened = OutFolder::open(&inner).unwrap();
        fs::write(inner.join("file"), "x").unwrap();
        drop(opened);
        assert!(inner.join("file").exists());
    }

    #[test]
    fn settings_block_others_only_beside_networks() {
        let folder = tempfile::tempdir().unwrap();
        let find = |settings: &str| NetworkFolder::find(folder.path(), settings.to_owned());
        let mut first = find("a").unwrap();
        assert!(!folder.path().join(SETTINGS_FILE).exists() && !first.is_known());
        first.begin().unwrap();
        assert!(!find("b").unwrap().is_known());
        fs::write(first.state(1), "x").unwrap();
        let refusal = find("b").err().unwrap().to_string();
        assert!(refusal.contains("expected the settings of the networks that are there"), "{refusal}");
        assert!(find("a").unwrap().is_known());
    }

    #[test]
    fn states_without_room_are_the_error_of_a_stop_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none/network-1.state");
        let store = |stop: &StopSignal| {
            StateFile { file: FitFile { path: path.clone(), key: "a".into() }, stop }.store(b"state")
        };
        assert!(store(&StopSignal::listen_if(false)).is_ok());
        let error = store(&StopSignal::received()).unwrap_err().to_string();
        assert!(error.contains("network-1.state: expected"), "{error}");
    }
}
