//! Atomic writing of files: the whole file or none.

use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::channel;
use std::time::Duration;

use tempfile::NamedTempFile;

use super::{FormatError, read_bytes};

/// Prefix of temporary files. Only a killed process leaves them.
pub const TEMPORARY_PREFIX: &str = ".writing-";

/// Writes a file atomically through a temporary file in the same folder. After success the file is complete and on the
/// disk. After any failure the old file is unchanged, and nothing else is left in the folder.
///
/// A new file gets the usual permissions (0666 less the umask). A replaced file keeps its permissions. Links are
/// followed.
///
/// # Errors
/// [`FormatError::NotWritten`] if `fill` fails, the folder is missing or not writable, the disk is full, or `path` is
/// write-protected or not a regular file.
pub fn write_safely(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), FormatError> {
    complete_file(path, fill)?.put_in_place()
}

/// [`write_safely`] without the final renaming. Files that belong together get their names when all are complete.
///
/// # Errors
/// As [`write_safely`].
pub fn complete_file(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<CompleteFile, FormatError> {
    filled(path, fill).map_err(|error| FormatError::from_write(path, error))
}

/// Checks whether [`write_safely`] could write a file of this name now. The check leaves nothing behind.
///
/// # Errors
/// [`FormatError::NotWritten`] where it could not.
pub fn check_writable(path: &Path) -> Result<(), FormatError> {
    SafeFile::create(path).map(drop).map_err(|error| FormatError::from_write(path, error))
}

/// Creates a folder and its missing parents. An existing folder is no error.
///
/// # Errors
/// [`FormatError::NotWritten`] if it cannot be created, for example where a file has that name.
pub fn create_folder(path: &Path) -> Result<(), FormatError> {
    fs::create_dir_all(path).map_err(|error| FormatError::from_write(path, error))
}

/// Time in which another program may release a lock.
const GRACE: Duration = Duration::from_millis(500);

/// Locks a folder against other programs until the file is dropped or the process ends in any way. Also removes
/// unfinished files that killed programs left there. Without folder locks in the system there is no protection.
///
/// # Errors
/// [`FormatError::Busy`] where another program holds the lock for more than half a second. The system releases the locks
/// of a killed program only after its memory.
pub fn lock_folder(path: &Path) -> Result<Option<File>, FormatError> {
    let locked = locked(path)?;
    remove_left_behind(path);
    Ok(locked)
}

fn locked(path: &Path) -> Result<Option<File>, FormatError> {
    let Ok(folder) = File::open(path) else { return Ok(None) };
    lock_within_grace(folder).map(Some).ok_or_else(|| FormatError::Busy { path: path.to_path_buf() })
}

/// The locked file, or the file itself on systems without locks; `None` if another process holds the lock.
fn lock_within_grace(file: File) -> Option<File> {
    let Err(TryLockError::WouldBlock) = file.try_lock() else { return Some(file) };
    let (sender, receiver) = channel();
    // A receiver that timed out releases the lock at once.
    let wait = move || drop(file.lock().map(|()| sender.send(file)));
    let waiting = std::thread::Builder::new().name("lenslet-lock".into()).spawn(wait);
    waiting.ok().and_then(|_| receiver.recv_timeout(GRACE).ok())
}

/// Lock of a file that is replaced repeatedly, against other programs. The lock is on an empty file beside it, which is
/// removed with it.
#[derive(Debug)]
pub struct NameLock {
    path: PathBuf,
    _file: File,
}

/// Locks the name of a file until the lock is dropped or the process ends in any way. The file need not exist. `lock` is
/// the empty file that represents it. Where `lock` cannot be written, or is a user's file, there is no protection.
///
/// # Errors
/// [`FormatError::InUse`] where another program holds the lock, as for [`lock_folder`].
pub fn lock_name(path: &Path, lock: &Path) -> Result<Option<NameLock>, FormatError> {
    lock_opened(path, lock, || File::options().create(true).truncate(false).write(true).open(lock))
}

/// [`lock_name`] with the function that opens the lock file.
fn lock_opened(
    path: &Path,
    lock: &Path,
    mut open: impl FnMut() -> io::Result<File>,
) -> Result<Option<NameLock>, FormatError> {
    loop {
        let Ok(file) = open() else { return Ok(None) };
        if file.metadata().map_or(true, |of| of.len() > 0 || !of.is_file()) {
            return Ok(None);
        }
        let Some(file) = lock_within_grace(file) else { return Err(FormatError::InUse { path: path.to_path_buf() }) };
        // The former owner may have removed the lock file meanwhile, and another process may have made a new one.
        if is_at(&file, lock) {
            return Ok(Some(NameLock { path: lock.to_path_buf(), _file: file }));
        }
    }
}

/// Whether an open file still has this name.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let place = |of: fs::Metadata| (of.dev(), of.ino());
    file.metadata().ok().map(place) == fs::metadata(path).ok().map(place)
}

/// On other systems an open file keeps its name.
#[cfg(not(unix))]
fn is_at(_: &File, _: &Path) -> bool {
    true
}

impl Drop for NameLock {
    fn drop(&mut self) {
        // A lock file that remains, as after a kill, is reused by the next lock.
        let _ = fs::remove_file(&self.path);
    }
}

/// Removes temporary files that no process writes. A writer holds a lock.
fn remove_left_behind(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let is_temporary = entry.file_name().to_string_lossy().starts_with(TEMPORARY_PREFIX);
        if !is_temporary || !entry.file_type().is_ok_and(|kind| kind.is_file()) {
            continue;
        }
        let file = File::options().write(true).open(entry.path());
        if file.is_ok_and(|file| file.try_lock().is_ok()) {
            // A file that cannot be removed does no harm.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// An unfinished file: a temporary file in the same folder. It gets its name when it is complete, and is removed
/// otherwise.
pub(super) struct SafeFile {
    target: PathBuf,
    temporary: NamedTempFile,
}

impl SafeFile {
    /// Starts a file with the final name `path`.
    pub(super) fn create(path: &Path) -> io::Result<Self> {
        let target = target(path)?;
        let mut builder = tempfile::Builder::new();
        builder.prefix(TEMPORARY_PREFIX);
        #[cfg(unix)]
        let everyone = <fs::Permissions as std::os::unix::fs::PermissionsExt>::from_mode(0o666);
        #[cfg(unix)]
        builder.permissions(everyone);
        let temporary = builder.tempfile_in(folder_of(&target)).map_err(|error| without_name(&error))?;
        // The lock marks the file as being written.
        let _ = temporary.as_file().try_lock();
        Ok(Self { target, temporary })
    }

    /// The file to write to, unbuffered.
    pub(super) fn file(&self) -> &File {
        self.temporary.as_file()
    }

    /// Writes everything to the disk.
    pub(super) fn complete(self) -> io::Result<CompleteFile> {
        if let Ok(earlier) = fs::metadata(&self.target) {
            self.file().set_permissions(earlier.permissions())?;
        }
        self.file().sync_all()?;
        Ok(CompleteFile(self))
    }
}

/// A complete file on the disk that does not have its name yet. Putting it in place rarely fails.
pub struct CompleteFile(SafeFile);

impl CompleteFile {
    /// Puts the file in place of an earlier one.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] where the system refuses.
    pub fn put_in_place(self) -> Result<(), FormatError> {
        let Self(SafeFile { target, temporary }) = self;
        temporary.persist(&target).map_err(|error| FormatError::from_write(&target, error.error))?;
        // The file is in place. Some network folders cannot be synced, so a failure here is ignored.
        #[cfg(unix)]
        if let Ok(folder) = File::open(folder_of(&target)) {
            let _ = folder.sync_all();
        }
        Ok(())
    }
}

fn filled(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<CompleteFile> {
    let file = SafeFile::create(path)?;
    let mut writer = BufWriter::with_capacity(1 << 16, file.file());
    fill(&mut writer)?;
    writer.flush()?;
    drop(writer);
    file.complete()
}

/// The system's error without the name of the temporary file.
fn without_name(error: &io::Error) -> io::Error {
    let cause = error.get_ref().and_then(std::error::Error::source);
    let code = cause.and_then(|cause| cause.downcast_ref::<io::Error>()).and_then(io::Error::raw_os_error);
    if error.kind() == io::ErrorKind::NotFound {
        return io::Error::new(io::ErrorKind::NotFound, "no such folder");
    }
    code.map_or_else(|| error.kind().into(), io::Error::from_raw_os_error)
}

fn folder_of(target: &Path) -> &Path {
    match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// The file to replace. Links are followed. Write-protected files and anything but a regular file are refused.
fn target(path: &Path) -> io::Result<PathBuf> {
    if path.file_name().is_none() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "this is no file name"));
    }
    let Ok(metadata) = fs::metadata(path) else {
        // A link to a file that does not exist yet.
        return Ok(fs::read_link(path).map_or_else(|_| path.to_path_buf(), |to| folder_of(path).join(to)));
    };
    if !metadata.is_file() {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "a folder or device has this name"));
    }
    if metadata.permissions().readonly() {
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, "the file is write-protected"));
    }
    if path.is_symlink() { fs::canonicalize(path) } else { Ok(path.to_path_buf()) }
}

/// Removes a file. A missing file is no error.
///
/// # Errors
/// [`FormatError::NotWritten`] where the file cannot be removed.
pub fn remove_if_there(path: &Path) -> Result<(), FormatError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(FormatError::from_write(path, error)),
        _ => Ok(()),
    }
}

/// Bytes of a file that [`write_safely`] may have written; `None` where there is no file.
///
/// # Errors
/// [`FormatError`] where the file exists and cannot be read, or is a folder, device or pipe.
pub fn read_if_there(path: &Path) -> Result<Option<Vec<u8>>, FormatError> {
    match read_bytes(path, u64::MAX) {
        Err(FormatError::NotFound { .. }) => Ok(None),
        read => read.map(Some),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_failing_writer_leaves_the_earlier_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result.csv");
        write_safely(&path, |writer| writer.write_all(b"first")).unwrap();
        let full = |writer: &mut dyn Write| {
            writer.write_all(&vec![7; 1 << 20])?;
            Err(io::ErrorKind::StorageFull.into())
        };
        let error = write_safely(&path, full).unwrap_err();
        assert!(error.to_string().contains("free some space"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(names(folder.path()), ["result.csv"]);
    }

    #[test]
    fn missing_folder_and_folder_as_target_are_reported() {
        let folder = tempfile::tempdir().unwrap();
        let error = write_safely(&folder.path().join("none/a.npy"), |_| Ok(())).unwrap_err();
        assert!(matches!(error, FormatError::NotWritten { .. }) && error.to_string().contains("make the folder"));
        assert!(!error.to_string().contains(TEMPORARY_PREFIX), "{error}");
        assert_eq!(check_writable(&folder.path().join("none/a.npy")).unwrap_err().to_string(), error.to_string());
        assert!(check_writable(&folder.path().join("a.npy")).is_ok());
        let error = write_safely(folder.path(), |_| Ok(())).unwrap_err();
        assert!(error.to_string().contains("a folder or device"), "{error}");
        assert!(std::error::Error::source(&error).is_none(), "what the system said is told once");
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn what_a_killed_program_left_is_removed_and_what_is_being_written_stays() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(".writing-Ab12Cd"), b"half").unwrap();
        fs::write(folder.path().join("notes"), b"mine").unwrap();
        let path = folder.path().join("a.npy");
        let going_on = SafeFile::create(&path).unwrap();
        let lock = lock_folder(folder.path()).unwrap();
        let mut found = names(folder.path());
        found.sort();
        assert!(found.len() == 2 && found[0].starts_with(TEMPORARY_PREFIX) && found[1] == "notes", "{found:?}");
        going_on.complete().unwrap().put_in_place().unwrap();
        assert!(path.is_file() && lock.is_some());
        assert!(matches!(lock_folder(folder.path()), Err(FormatError::Busy { .. })));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_name_is_locked_whether_its_file_is_there_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let [path, lock] = ["kept", "kept.lock"].map(|name| folder.path().join(name));
        let held = lock_name(&path, &lock).unwrap();
        assert!(held.is_some() && !path.exists());
        write_safely(&path, |writer| writer.write_all(b"one")).unwrap();
        let message = lock_name(&path, &lock).unwrap_err().to_string();
        assert!(message.contains("kept: expected a file of this estimate alone"), "{message}");
        drop(held);
        assert_eq!(names(folder.path()), ["kept"], "nothing stays of the lock");
        // A lock file left by a kill blocks nobody, and a user's file stays.
        fs::write(&lock, b"").unwrap();
        drop(lock_name(&path, &lock).unwrap().unwrap());
        assert!(!lock.exists());
        fs::write(&lock, b"mine").unwrap();
        assert!(lock_name(&path, &lock).unwrap().is_none());
        assert_eq!(fs::read(&lock).unwrap(), b"mine");
        assert!(lock_name(&path, &folder.path().join("no/lock")).unwrap().is_none());
        // A lock file that its owner removes after another process opened it is not what that process gets.
        let lock = folder.path().join("other.lock");
        let held = lock_name(&path, &lock).unwrap().unwrap();
        let open = || File::options().create(true).truncate(false).write(true).open(&lock);
        let mut removed = Some(open().unwrap());
        drop(held);
        let next = lock_opened(&path, &lock, || removed.take().map_or_else(open, Ok)).unwrap().unwrap();
        assert!(lock.exists() && lock_name(&path, &lock).is_err());
        drop(next);
    }

    #[cfg(unix)]
    #[test]
    fn permissions_are_those_of_any_new_file_and_survive_replacement() {
        use std::os::unix::fs::PermissionsExt;
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        let folder = tempfile::tempdir().unwrap();
        let (plain, safe) = (folder.path().join("plain"), folder.path().join("safe"));
        fs::write(&plain, b"x").unwrap();
        write_safely(&safe, |writer| writer.write_all(b"x")).unwrap();
        assert_eq!(mode(&safe), mode(&plain));
        fs::set_permissions(&safe, fs::Permissions::from_mode(0o640)).unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&safe, &link).unwrap();
        write_safely(&link, |writer| writer.write_all(b"y")).unwrap();
        assert!(link.is_symlink() && mode(&safe) == 0o640 && fs::read(&safe).unwrap() == b"y");
        // Also through a link to a missing file.
        let (ahead, later) = (folder.path().join("ahead"), folder.path().join("later"));
        std::os::unix::fs::symlink("later", &ahead).unwrap();
        write_safely(&ahead, |writer| writer.write_all(b"z")).unwrap();
        assert!(ahead.is_symlink() && fs::read(&later).unwrap() == b"z");
        fs::set_permissions(&safe, fs::Permissions::from_mode(0o440)).unwrap();
        assert!(write_safely(&safe, |_| Ok(())).unwrap_err().to_string().contains("write-protected"));
    }
}
