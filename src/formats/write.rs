//! Writing a whole file or none.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use super::FormatError;

/// Writes a file through a temporary one in the same folder: after success the file is complete and on the disk,
/// after any failure it is as it was before, and nothing else is left in the folder.
///
/// A new file gets the usual permissions (0666 less the umask), a replaced one keeps its own, and a link is written
/// through.
///
/// # Errors
/// [`FormatError::NotWritten`] if `fill` fails, the folder is missing or not writable, the disk is full, or `path` is
/// write-protected or not a regular file.
pub fn write_safely(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), FormatError> {
    write_seekable_safely(path, |writer| fill(writer))
}

/// Makes a folder and those above it; one that is there already is fine.
///
/// # Errors
/// [`FormatError::NotWritten`] if it cannot be made, a file of that name being there for example.
pub fn create_folder(path: &Path) -> Result<(), FormatError> {
    fs::create_dir_all(path).map_err(|error| FormatError::from_write(path, error))
}

/// [`write_safely`] for formats that come back to fill in offsets.
pub(super) fn write_seekable_safely(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>,
) -> Result<(), FormatError> {
    replace(path, fill).map_err(|error| FormatError::from_write(path, error))
}

fn replace(path: &Path, fill: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>) -> io::Result<()> {
    let target = target(path)?;
    let folder = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".writing-");
    #[cfg(unix)]
    let everyone = <fs::Permissions as std::os::unix::fs::PermissionsExt>::from_mode(0o666);
    #[cfg(unix)]
    builder.permissions(everyone);
    let temporary = builder.tempfile_in(folder)?;
    let mut writer = BufWriter::with_capacity(1 << 16, temporary.as_file());
    fill(&mut writer)?;
    writer.flush()?;
    drop(writer);
    if let Ok(earlier) = fs::metadata(&target) {
        temporary.as_file().set_permissions(earlier.permissions())?;
    }
    temporary.as_file().sync_all()?;
    temporary.persist(&target).map_err(|error| error.error)?;
    // The file is in place by now, and some network folders cannot be synced: a refusal here is not a failed write.
    #[cfg(unix)]
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
    Ok(())
}

/// The file to replace: links are followed; write-protected files and anything but a regular file are refused.
fn target(path: &Path) -> io::Result<PathBuf> {
    if path.file_name().is_none() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "this is no file name"));
    }
    let Ok(metadata) = fs::metadata(path) else { return Ok(path.to_path_buf()) };
    if !metadata.is_file() {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "a folder or device has this name"));
    }
    if metadata.permissions().readonly() {
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, "the file is write-protected"));
    }
    if path.is_symlink() { fs::canonicalize(path) } else { Ok(path.to_path_buf()) }
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
    fn a_missing_folder_and_a_folder_as_target_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let error = write_safely(&folder.path().join("none/a.npy"), |_| Ok(())).unwrap_err();
        assert!(matches!(error, FormatError::NotWritten { .. }) && error.to_string().contains("make the folder"));
        let error = write_safely(folder.path(), |_| Ok(())).unwrap_err();
        assert!(error.to_string().contains("a folder or device"), "{error}");
        assert!(names(folder.path()).is_empty());
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
        fs::set_permissions(&safe, fs::Permissions::from_mode(0o440)).unwrap();
        assert!(write_safely(&safe, |_| Ok(())).unwrap_err().to_string().contains("write-protected"));
    }
}
