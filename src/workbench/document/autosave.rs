//! Autosave: copies of the open design and its trained network that survive a crash, while they are unsaved, in a folder of their own.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::formats::{DocumentKind, FileWriter, FormatError, TEMPORARY_PREFIX, create_folder};
use crate::forward::Design;
use crate::optics::MASK_DOCUMENT_VERSION;
use crate::reconstruction::TrainedNetwork;
use crate::workbench::background::threads::Wake;
use crate::workbench::document::network_file::{read_network, weights_beside};

/// Least time between two writings.
const EVERY: Duration = Duration::from_secs(5);
/// Endings of the files, and of the lock files that show whether their owner still runs.
const ENDING: &str = "json";
const LOCK_ENDING: &str = "lock";

/// A design that a program left behind when it ended without being closed.
pub struct Recovered {
    /// The design in the file.
    pub design: Design,
    /// The file that the design had been opened from or saved to.
    pub path: Option<PathBuf>,
    /// A trained network that was in no file.
    pub network: Option<Arc<TrainedNetwork>>,
    /// Time of the autosave.
    pub kept_at: SystemTime,
    file: PathBuf,
    /// Held so that no second program offers the same design.
    lock: File,
}

/// The kind of the files.
const UNSAVED_DESIGN: DocumentKind =
    DocumentKind::unmarked_before("lenslet-studio/unsaved-design", "an unsaved design")
        .at_version(MASK_DOCUMENT_VERSION);

/// The contents of a file.
#[derive(Serialize, Deserialize)]
struct Kept {
    design: Design,
    path: Option<PathBuf>,
    /// Seconds since 1970.
    seconds: u64,
}

/// What of a design is unsaved.
#[derive(Clone, Default)]
pub(crate) struct Unsaved {
    /// Whether the design has unsaved changes.
    pub is_changed: bool,
    /// A trained network that is in no file.
    pub network: Option<Arc<TrainedNetwork>>,
}

/// What was noted of a design.
#[derive(PartialEq, Eq)]
struct Noted {
    /// Number of its contents.
    contents: u64,
    /// Whether the autosave holds it.
    is_saved: bool,
    path: Option<PathBuf>,
}

/// Keeps the open design and its network in files while they are unsaved, on a thread of its own.
pub struct Autosave {
    writer: FileWriter,
    file: PathBuf,
    /// Recovered designs that the next files include.
    superseded: Vec<Recovered>,
    /// The design as noted last.
    noted: Option<Noted>,
    /// The network as noted last.
    noted_network: Option<Arc<TrainedNetwork>>,
    lock_file: PathBuf,
    /// Held while this program runs.
    lock: Option<File>,
}

impl Autosave {
    /// Opens the autosave in a folder. Also returns the designs left there by programs that ended without being closed, newest first.
    /// `wake` is called after each attempt to write or remove a file, because [`Autosave::is_done`] or the failure may have changed.
    ///
    /// # Errors
    /// Where the folder cannot be written to, or the operating system gives no thread.
    pub fn in_folder(folder: &Path, wake: Wake) -> Result<(Self, Vec<Recovered>), FormatError> {
        Self::writing_every(EVERY, folder, wake)
    }

    /// The same with another time between two writings.
    fn writing_every(every: Duration, folder: &Path, wake: Wake) -> Result<(Self, Vec<Recovered>), FormatError> {
        create_folder(folder)?;
        let found = left_behind(folder);
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let name = format!("{}-{}", std::process::id(), now.as_nanos());
        let file = folder.join(&name).with_extension(ENDING);
        let lock_file = folder.join(&name).with_extension(LOCK_ENDING);
        let lock = File::create(&lock_file).map_err(|error| FormatError::from_write(&lock_file, error))?;
        // Where the folder's file system has no locks, a second program would offer the design that is open here.
        let _ = lock.try_lock();
        let writer = FileWriter::start("lenslet-autosave", every, move || wake());
        let writer = writer.map_err(|error| FormatError::from_write(folder, error))?;
        Ok((
            Self {
                writer,
                file,
                superseded: Vec::new(),
                noted: None,
                noted_network: None,
                lock_file,
                lock: Some(lock),
            },
            found,
        ))
    }

    /// Notes the open design and what of it is unsaved: `contents` is the number of its contents, `path` its file. Returns the failure of
    /// the last attempt to save it, once.
    pub(crate) fn note(
        &mut self,
        design: &Arc<Design>,
        contents: u64,
        Unsaved { is_changed, network }: Unsaved,
        path: Option<&Path>,
    ) -> Option<String> {
        // A network needs its design, even if that is in a file.
        let noted = Noted { contents, is_saved: is_changed || network.is_some(), path: path.map(Path::to_owned) };
        if self.noted.as_ref() != Some(&noted) {
            if noted.is_saved {
                let (design, path) = (Arc::clone(design), noted.path.clone());
                self.writer.write(self.file.clone(), Box::new(move || content(&design, path)), None);
            } else {
                self.writer.remove(self.file.clone(), None);
            }
            self.noted = Some(noted);
        }
        if network.as_ref().map(Arc::as_ptr) != self.noted_network.as_ref().map(Arc::as_ptr) {
            self.noted_network.clone_from(&network);
            let file = weights_beside(&self.file);
            match network {
                Some(network) => self.writer.write(file, Box::new(move || network.to_bytes().ok()), None),
                None => self.writer.remove(file, None),
            }
        }
        self.discard_superseded();
        self.writer.take_failure()
    }

    /// Removes recovered files once all of their contents are written again.
    fn discard_superseded(&mut self) {
        if self.writer.is_idle() {
            self.superseded.drain(..).for_each(Recovered::discard);
        }
    }

    /// Whether the last noted design is saved, or need not be.
    pub fn is_done(&self) -> bool {
        self.writer.is_idle()
    }

    /// Ends the autosave, after the person was asked about unsaved changes. Without this call, for example after a lost renderer, unsaved
    /// changes stay and are offered again.
    pub fn close(mut self) {
        self.writer.remove(weights_beside(&self.file), None);
        self.writer.remove(self.file.clone(), None);
        self.superseded.drain(..).for_each(Recovered::discard);
    }

    /// Removes the files of a recovered design once all of it is saved again.
    pub fn supersede(&mut self, recovered: Recovered) {
        self.superseded.push(recovered);
    }
}

impl Recovered {
    /// Removes the file.
    pub fn discard(self) {
        // A file that stays behind is offered again.
        let _ = std::fs::remove_file(&self.file);
        let _ = std::fs::remove_file(weights_beside(&self.file));
        let _ = std::fs::remove_file(self.file.with_extension(LOCK_ENDING));
        drop(self.lock);
    }
}

impl Drop for Autosave {
    fn drop(&mut self) {
        // The lock is held until the last change is written.
        self.writer.finish();
        drop(self.lock.take());
        let _ = std::fs::remove_file(&self.lock_file);
    }
}

/// Contents of the file for a design that was opened from or saved to `path`; none where it has no JSON form.
fn content(design: &Design, path: Option<PathBuf>) -> Option<Vec<u8>> {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    // The next program may be started in another folder.
    let path = path.and_then(|path| std::path::absolute(path).ok());
    // JSON holds Unicode alone: a design with another path is saved without it.
    let path = path.filter(|path| path.to_str().is_some());
    let design = Design { objects: design.objects.absolute(), ..design.clone() };
    let kind = UNSAVED_DESIGN.at_version(design.document_version());
    serde_json::to_vec_pretty(&kind.marked(&Kept { design, path, seconds })).ok()
}

/// Files whose owners no longer run.
fn left_behind(folder: &Path) -> Vec<Recovered> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut found: Vec<Recovered> = entries
        .filter_map(|entry| {
            let file = entry.ok()?.path();
            if is_half_written(&file) {
                // A file that cannot be removed does no harm.
                let _ = std::fs::remove_file(&file);
            }
            if file.extension()? != ENDING {
                return None;
            }
            let lock = File::options().create(true).truncate(false).write(true).open(file.with_extension(LOCK_ENDING));
            let lock = lock.ok().filter(|lock| lock.try_lock().is_ok())?;
            let kept: Kept = UNSAVED_DESIGN.read(&file).ok()?;
            kept.design.check().ok()?;
            let kept_at = UNIX_EPOCH.checked_add(Duration::from_secs(kept.seconds))?;
            // There may be none, and one that cannot be read is no reason to give up the design.
            let network = read_network(&weights_beside(&file)).ok().map(Arc::new);
            Some(Recovered { design: kept.design, path: kept.path, network, kept_at, file, lock })
        })
        .collect();
    found.sort_by_key(|recovered| std::cmp::Reverse(recovered.kept_at));
    found
}

/// Whether a file is the rest of an interrupted write. Files of the last minute may still be in use.
fn is_half_written(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let changed = std::fs::metadata(file).and_then(|metadata| metadata.modified()).ok();
    let age = changed.and_then(|changed| changed.elapsed().ok()).unwrap_or_default();
    name.starts_with(TEMPORARY_PREFIX) && age > Duration::from_mins(1)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, channel};

    use super::*;

    /// An autosave that writes without delay.
    struct Fixture {
        autosave: Autosave,
        found: Vec<Recovered>,
        attempts: Receiver<()>,
    }

    fn fixture(folder: &Path) -> Fixture {
        let (attempt, attempts) = channel();
        // The last attempts may come while the fixture is dropped.
        let wake: Wake = Arc::new(move || attempt.send(()).unwrap_or_default());
        let (autosave, found) = Autosave::writing_every(Duration::ZERO, folder, wake).unwrap();
        Fixture { autosave, found, attempts }
    }

    impl Fixture {
        /// Notes a design without a file.
        fn note(&mut self, design: &Arc<Design>, contents: u64, is_unsaved: bool) -> Option<String> {
            self.note_in(design, contents, is_unsaved, None)
        }

        /// Notes a design that was opened from a file.
        fn note_in(
            &mut self,
            design: &Arc<Design>,
            contents: u64,
            is_changed: bool,
            path: Option<&Path>,
        ) -> Option<String> {
            self.autosave.note(design, contents, Unsaved { is_changed, network: None }, path)
        }

        /// Waits until all that was noted is written or removed.
        fn settle(&mut self) {
            while !self.autosave.is_done() {
                self.attempts.recv().unwrap();
            }
            self.autosave.discard_superseded();
        }

        /// Name of the file.
        fn file(&self) -> PathBuf {
            self.autosave.lock_file.with_extension(ENDING)
        }
    }

    /// The autosave files.
    fn kept(folder: &Path) -> Vec<PathBuf> {
        let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        files.filter(|file| file.extension().is_some_and(|ending| ending == ENDING)).collect()
    }

    #[test]
    fn what_a_crash_leaves_is_offered_once_and_what_is_closed_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let design = Arc::new(Design { seed: 7, ..Design::default() });
        let mut first = fixture(folder.path());
        assert!(first.found.is_empty());
        let path = Path::new("mine.json");
        assert_eq!(first.note_in(&design, 2, true, Some(path)), None);
        first.settle();
        // Another program sees that the owner still runs.
        let other = fixture(folder.path());
        assert!(other.found.is_empty());
        drop(other);
        // A crash: the lock goes with the process, nothing else happens.
        let file = kept(folder.path()).remove(0);
        let bytes = std::fs::read(&file).unwrap();
        first.autosave.close();
        let left = std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(left, 0, "who closes the window leaves nothing behind");
        std::fs::write(&file, bytes).unwrap();

        let mut next = fixture(folder.path());
        let recovered = next.found.pop().unwrap();
        assert!(next.found.is_empty() && recovered.design == *design);
        // The next program may be started in another folder.
        assert_eq!(recovered.path, std::path::absolute(path).ok());
        assert!(fixture(folder.path()).found.is_empty(), "it is offered once");
        // The file stays until the design is saved again.
        next.autosave.supersede(recovered);
        assert!(file.exists());
        assert_eq!(next.note(&design, 3, true), None);
        next.settle();
        assert_eq!(kept(folder.path()), [next.file()]);
        assert_eq!(next.note(&design, 3, false), None);
        next.settle();
        assert!(kept(folder.path()).is_empty());
    }

    #[test]
    fn trained_network_in_no_file_is_kept_with_its_design_until_it_has_one() {
        let folder = tempfile::tempdir().unwrap();
        let (design, network) = (Arc::new(Design::default()), TrainedNetwork::of_one_step());
        let network = Unsaved { network: Some(Arc::new(network)), is_changed: false };
        let mut first = fixture(folder.path());
        assert_eq!(first.autosave.note(&design, 1, network.clone(), None), None);
        first.settle();
        assert_eq!(kept(folder.path()).len(), 1, "its design is kept with it");
        // A crash: nothing is closed.
        drop(first);
        let mut next = fixture(folder.path());
        let recovered = next.found.pop().unwrap();
        assert_eq!(recovered.network, network.network);
        // Both files of the crash stay until both are written again. A folder in place of one stands for a full disk.
        let (file, weights) = (recovered.file.clone(), weights_beside(&recovered.file));
        let own = weights_beside(&next.file());
        std::fs::create_dir(&own).unwrap();
        next.autosave.supersede(recovered);
        let mut failure = next.autosave.note(&design, 1, network.clone(), None);
        while failure.is_none() {
            next.attempts.recv().unwrap();
            failure = next.autosave.note(&design, 1, network.clone(), None);
        }
        assert!(file.exists() && weights.exists() && next.file().exists());
        std::fs::remove_dir(&own).unwrap();
        let again = network.network.as_deref().cloned().map(Arc::new);
        assert_eq!(next.autosave.note(&design, 1, Unsaved { network: again, is_changed: false }, None), None);
        next.settle();
        assert!(!file.exists() && !weights.exists() && own.is_file());
        // Saving the design saves its network.
        assert_eq!(next.note(&design, 1, false), None);
        next.settle();
        assert!(!own.exists() && kept(folder.path()).is_empty());
    }

    #[test]
    fn what_nobody_has_closed_is_offered_again() {
        let folder = tempfile::tempdir().unwrap();
        let design = Arc::new(Design { seed: 7, ..Design::default() });
        let mut autosave = fixture(folder.path());
        // A renderer that is lost takes the window with it, in good order and at once.
        assert_eq!(autosave.note(&design, 2, true), None);
        drop(autosave);
        let found = fixture(folder.path()).found;
        assert_eq!(found.into_iter().map(|kept| kept.design).collect::<Vec<_>>(), [Design::clone(&design)]);
    }

    #[test]
    fn broken_files_are_passed_over_and_a_full_disk_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("1-1.json"), b"{\"design\": 3").unwrap();
        // The rest of a write that was killed is removed when it is old.
        let (old, new) = (folder.path().join(".writing-old"), folder.path().join(".writing-new"));
        std::fs::write(&old, b"{").unwrap();
        std::fs::write(&new, b"{").unwrap();
        let hour_ago = SystemTime::now() - Duration::from_hours(1);
        File::options().write(true).open(&old).unwrap().set_modified(hour_ago).unwrap();
        let mut autosave = fixture(folder.path());
        assert!(autosave.found.is_empty() && !old.exists() && new.exists());
        // A folder where the file should be stands for a disk that cannot be written to.
        std::fs::create_dir(autosave.file()).unwrap();
        let design = Arc::new(Design::default());
        let at_once = autosave.note(&design, 2, true);
        autosave.attempts.recv().unwrap();
        let failure = at_once.or_else(|| autosave.note(&design, 2, true)).unwrap();
        assert!(failure.contains("a folder or device"), "{failure}");
        assert!(!autosave.autosave.is_done(), "it is tried again");
        // The next change is written at once.
        std::fs::remove_dir(autosave.file()).unwrap();
        assert_eq!(autosave.note(&design, 3, true), None);
        autosave.settle();
        assert!(UNSAVED_DESIGN.read::<Kept>(&autosave.file()).is_ok());
    }

    #[test]
    #[cfg(unix)]
    fn a_design_whose_path_json_cannot_hold_is_kept_without_it() {
        use std::os::unix::ffi::OsStrExt;
        let folder = tempfile::tempdir().unwrap();
        let mut autosave = fixture(folder.path());
        let design = Arc::new(Design { seed: 7, ..Design::default() });
        let path = Path::new(std::ffi::OsStr::from_bytes(b"/a/\xff.json"));
        assert_eq!(autosave.note_in(&design, 2, true, Some(path)), None);
        autosave.settle();
        let kept: Kept = UNSAVED_DESIGN.read(&autosave.file()).unwrap();
        assert_eq!((kept.design, kept.path), (Design::clone(&design), None));
        assert_eq!(autosave.note_in(&design, 2, true, Some(path)), None);
    }

    #[test]
    fn the_newest_edit_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let mut autosave = fixture(folder.path());
        for seed in 1..6 {
            assert_eq!(autosave.note(&Arc::new(Design { seed, ..Design::default() }), seed, true), None);
        }
        autosave.settle();
        assert_eq!(UNSAVED_DESIGN.read::<Kept>(&autosave.file()).unwrap().design.seed, 5);
    }
}
