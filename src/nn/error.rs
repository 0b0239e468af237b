//! What can be wrong with the weights of a network.

use thiserror::Error;

/// Why weights are not those of a network.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NetworkError {
    /// The bytes are not a safetensors file of this network.
    #[error("these are not weights of this network: expected {expected}, found {found}; choose another file")]
    Weights {
        /// What was expected.
        expected: String,
        /// What was found instead.
        found: String,
    },
    /// The file was written by a newer program, or by none.
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
