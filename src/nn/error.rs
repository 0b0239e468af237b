//! Errors of the weights of a network.

use thiserror::Error;

/// Reason why weights do not belong to a network.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NetworkError {
    /// The bytes are not a safetensors file of this network.
    #[error("these are not weights of this network: expected {expected}, found {found}; choose another file")]
    Weights {
        /// The expected contents.
        expected: String,
        /// The contents found.
        found: String,
    },
    /// The file was written by a newer program, or has no version.
    #[error(
        "the weights are of format version {found}, this program reads up to version {newest}; use a newer Lenslet Studio"
    )]
    Version {
        /// The version of the file.
        found: String,
        /// The newest version known.
        newest: u32,
    },
}
