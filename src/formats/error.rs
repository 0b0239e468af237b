//! Errors of files, each one sentence.

use std::io;
use std::path::{Path, PathBuf};

/// Error of reading or writing a file. The text is `PATH: expected X, found Y; WHAT TO DO`.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// There is no file of this name.
    #[error("{}: expected a file, found nothing; check the name and the folder", .path.display())]
    NotFound {
        /// The requested name.
        path: PathBuf,
    },
    /// The system refused to read the file.
    #[error("{}: expected to read the file, found \"{reason}\"; check its permissions and the disk", .path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's error.
        reason: io::Error,
    },
    /// The file is readable but does not hold what its name or header states.
    #[error("{}: expected {expected}, found {found}; {advice}", .path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The content that the reader needs here.
        expected: String,
        /// The content found.
        found: String,
        /// Advice for the user.
        advice: String,
    },
    /// The file was not written. An earlier file of that name is unchanged.
    #[error("{}: expected to write the file, found \"{reason}\"; {advice}", .path.display())]
    NotWritten {
        /// The file.
        path: PathBuf,
        /// The system's error.
        reason: io::Error,
        /// Advice for the user.
        advice: String,
    },
    /// Another program writes into the folder.
    #[error("{}: expected a folder of this run alone, found another run at work in it; wait for it or choose another folder", .path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// Another program writes the file.
    #[error("{}: expected a file of this estimate alone, found another at work with it; wait for it or choose another name", .path.display())]
    InUse {
        /// The file.
        path: PathBuf,
    },
}

impl FormatError {
    /// The file this is about.
    pub fn path(&self) -> &Path {
        match self {
            Self::NotFound { path }
            | Self::Unreadable { path, .. }
            | Self::Malformed { path, .. }
            | Self::NotWritten { path, .. }
            | Self::Busy { path }
            | Self::InUse { path } => path,
        }
    }

    /// Whether a repetition may succeed: the disk is full or missing, or another program uses the file.
    pub fn may_pass(&self) -> bool {
        !matches!(self, Self::Malformed { .. })
    }

    /// A [`FormatError::Malformed`] for `path`.
    pub fn malformed(
        path: &Path,
        expected: impl Into<String>,
        found: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self::Malformed {
            path: path.to_path_buf(),
            expected: expected.into(),
            // Messages of decoders may have several lines; this one is a sentence.
            found: found.into().split_whitespace().collect::<Vec<_>>().join(" "),
            advice: advice.into(),
        }
    }

    /// The error of a failed read. A missing or damaged file is distinguished from a failing disk.
    pub(crate) fn from_read(path: &Path, reason: io::Error) -> Self {
        match reason.kind() {
            io::ErrorKind::NotFound => Self::NotFound { path: path.to_path_buf() },
            io::ErrorKind::UnexpectedEof => {
                Self::malformed(path, "more data", "the end of the file", "the file is cut short; copy it again")
            }
            io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput => {
                Self::malformed(path, "undamaged data", reason.to_string(), "copy or download the file again")
            }
            _ => Self::Unreadable { path: path.to_path_buf(), reason },
        }
    }

    /// The error of a failed write, with advice for the usual causes.
    pub(crate) fn from_write(path: &Path, reason: io::Error) -> Self {
        let advice = match reason.kind() {
            io::ErrorKind::NotFound => "make the folder first or choose another",
            io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
                "choose a file and folder that you may write"
            }
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
                "free some space or choose another disk"
            }
            io::ErrorKind::InvalidInput => "correct what is to be written",
            _ => "choose another file name or folder",
        };
        Self::NotWritten { path: path.to_path_buf(), reason, advice: advice.into() }
    }
}
