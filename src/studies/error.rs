//! Errors of studies, one sentence each.

use std::path::PathBuf;

use thiserror::Error;

use crate::evaluation::EvaluationError;
use crate::formats::FormatError;
use crate::objects::ObjectError;

/// A study that was refused or stopped. A failed cell is no such error: it is recorded, and the study continues.
#[derive(Debug, Error)]
pub enum StudyError {
    /// A setting cannot be computed.
    #[error("{what}: expected {expected}, found {found}; change it")]
    Setting {
        /// Name of the setting.
        what: &'static str,
        /// The expected values.
        expected: String,
        /// The value found.
        found: String,
    },
    /// A plan cannot be computed.
    #[error("{what}: expected {expected}, found {found}; change the plan")]
    Plan {
        /// The part of the plan.
        what: String,
        /// The expected values.
        expected: String,
        /// The value found.
        found: String,
    },
    /// A text names no objects.
    #[error("{0}; give one of these or a name of the plan's sets")]
    Objects(#[from] ObjectError),
    /// A file is no plan.
    #[error("{}: expected a plan of a study, found {found}; correct it, or begin with the output of study plan NAME", .path.display())]
    PlanFile {
        /// The file.
        path: PathBuf,
        /// Description of what it holds.
        found: String,
    },
    /// The folder holds a study of another plan.
    #[error("{}: expected a folder of this plan, found the cells of one with other values of {found}; choose another folder", .path.display())]
    OtherPlan {
        /// The folder.
        path: PathBuf,
        /// Names of the entries that differ.
        found: String,
    },
    /// A plot has an unknown ending.
    #[error("{}: expected a name that ends in .svg or .png; choose another name", .path.display())]
    Ending {
        /// The file.
        path: PathBuf,
    },
    /// The folder holds no study.
    #[error("{}: expected the folder of a study, found no plan.toml in it; give the --out of study run", .path.display())]
    NoPlan {
        /// The folder.
        path: PathBuf,
    },
    /// The folder holds a study by an earlier program.
    #[error(
        "{}: expected an empty folder or one of this plan, found a study by an earlier version, whose table is study.csv; \
         choose another folder", .path.display()
    )]
    EarlierStudy {
        /// The folder.
        path: PathBuf,
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
        /// The version in the file.
        found: String,
    },
    /// The plot of the study cannot be drawn.
    #[error("the plot of the study was not drawn: {reason}")]
    Plot {
        /// Reason, by the plotting library.
        reason: String,
    },
    /// The file in the folder is no study that this version knows.
    #[error("{}: expected a Lenslet Studio study of version {version}, found {found}; {advice}", .path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// Newest version that is read.
        version: u64,
        /// Description of what the file holds.
        found: String,
        /// Advice on what to do.
        advice: &'static str,
    },
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FormatError),
    /// Objects, mask or noise allow no estimate in any cell.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
    /// The callback asked to stop; the cells computed so far are in the file.
    #[error("the study was stopped; start it again in the same folder to go on")]
    Cancelled,
}

impl StudyError {
    /// Whether the folder holds something other than the study to be resumed.
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
