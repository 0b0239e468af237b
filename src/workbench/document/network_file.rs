//! The file of a trained network, beside that of its design.

use std::path::{Path, PathBuf};

use crate::formats::{read_bytes, write_safely};
use crate::reconstruction::{LARGEST_WEIGHTS, TrainedNetwork};

/// Extension of the weights that lie beside the file of a design.
const EXTENSION: &str = "network.safetensors";

/// The file of weights beside the file of a design.
pub fn weights_beside(design: &Path) -> PathBuf {
    design.with_extension(EXTENSION)
}

/// Reads a file of weights.
///
/// # Errors
/// One sentence where the file is missing, too large, or no weights of this network.
pub(crate) fn read_network(path: &Path) -> Result<TrainedNetwork, String> {
    let bytes = read_bytes(path, LARGEST_WEIGHTS).map_err(|error| error.to_string())?;
    TrainedNetwork::from_bytes(&bytes).map_err(|error| format!("{}: {error}", path.display()))
}

/// Writes a file of weights.
///
/// # Errors
/// One sentence where it cannot be written.
pub(crate) fn write_network(network: &TrainedNetwork, path: &Path) -> Result<(), String> {
    let bytes = network.to_bytes().map_err(|error| error.to_string())?;
    write_safely(path, |file| file.write_all(&bytes)).map_err(|error| error.to_string())
}
