//! Why a study cannot begin or go on, told in one sentence.

use std::path::PathBuf;

use thiserror::Error;

use crate::evaluation::EvaluationError;
use crate::formats::FormatError;

/// A study that was refused or stopped. A cell that fails is none of these: it is recorded, and the study goes on.
#[derive(Debug, Error)]
pub enum StudyError {
    /// A setting is not one that can be computed.
    #[error("{what}: expected {expected}, found {found}; change it")]
    Setting {
        /// The setting.
        what: &'static str,
        /// What it may be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// The folder holds a study of other settings.
    #[error(
        "{}: expected a study with {what} {expected}, found one with {found}; repeat the settings that it was started \
         with, or choose another folder", .path.display()
    )]
    Changed {
        /// The file of the study.
        path: PathBuf,
        /// The first setting that differs.
        what: &'static str,
        /// Its value now.
        expected: String,
        /// Its value in the file.
        found: String,
    },
    /// The folder holds a study by another version of the program.
    #[error(
        "{}: expected a study by version {expected} of the program, found one by {found}, whose numbers do not belong into one \
         table with these; go on with that version, or choose another folder", .path.display()
    )]
    OtherVersion {
        /// The file of the study.
        path: PathBuf,
        /// This version.
        expected: String,
        /// That in the file.
        found: String,
    },
    /// The file in the folder is no study that this version knows.
    #[error("{}: expected a Lenslet Studio study of version {version}, found {found}; {advice}", .path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// Newest version that is read.
        version: u64,
        /// What it holds.
        found: String,
        /// What to do.
        advice: &'static str,
    },
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FormatError),
    /// Objects, mask or noise allow no estimate in any cell.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
    /// Whoever watches asked to stop; the cells computed so far are in the file.
    #[error("the study was stopped; start it again in the same folder to go on")]
    Cancelled,
}

impl StudyError {
    /// Whether the folder holds something else than the study that was to go on there.
    pub(crate) fn is_about_another(&self) -> bool {
        matches!(
            self,
            Self::Changed { .. }
                | Self::OtherVersion { .. }
                | Self::Refused { .. }
                | Self::File(FormatError::Malformed { .. })
        )
    }
}
