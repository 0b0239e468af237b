//! The picture files of a folder.

use std::path::{Path, PathBuf};

use super::FormatError;

/// Endings of files that hold pictures.
const ENDINGS: [&str; 8] = ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "npy", "npz"];

/// Files of a folder that hold pictures by their names, in the order of their names.
///
/// # Errors
/// [`FormatError`] if the folder cannot be read.
pub fn picture_files(folder: &Path) -> Result<Vec<PathBuf>, FormatError> {
    let failed = |error| FormatError::from_read(folder, error);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        if ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str())) && path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}
