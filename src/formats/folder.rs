//! The image files of a folder.

use std::path::Path;

use super::{FormatError, ImageFile};
use crate::plural::counted;

/// Extensions of files that hold images.
const ENDINGS: [&str; 8] = ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "npy", "npz"];

/// Image files of a path: those of a folder, sorted by name, or the file itself.
///
/// Hidden files are omitted: names that start with a dot, among them the `._*` files that macOS leaves on other disks.
/// The options of the path apply to all files.
///
/// # Errors
/// [`FormatError`] if there is no such file or folder, or the folder cannot be read.
pub fn image_files(named: &Path) -> Result<Vec<ImageFile>, FormatError> {
    let place = ImageFile::find(named)?;
    if !place.path.is_dir() {
        return Ok(vec![place]);
    }
    let failed = |error| FormatError::from_read(&place.path, error);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(&place.path).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let is_hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        if !is_hidden && ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str())) && path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files.into_iter().map(|path| ImageFile { path, meaning: place.meaning.clone() }).collect())
}

/// The error of a folder without images. It names folders in it, which may hold them.
pub fn no_images(folder: &Path) -> FormatError {
    let expected = "PNG, JPEG, TIFF, BMP, NPY or NPZ images";
    let entries = ImageFile::find(folder).ok().and_then(|place| std::fs::read_dir(place.path).ok());
    let folders = entries.into_iter().flatten().filter(|entry| entry.as_ref().is_ok_and(|entry| entry.path().is_dir()));
    match folders.count() {
        0 => FormatError::malformed(folder, expected, "none", "choose a folder with images"),
        count => {
            let found = format!("none, but {}", counted(count, "folder"));
            FormatError::malformed(folder, expected, found, "choose one of the folders in it")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hidden_files_are_left_out_and_the_meaning_holds_for_all() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b.PNG", "a.tif", "._a.tif", ".b.png", "Thumbs.db", ".DS_Store", "notes.txt"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        std::fs::create_dir(folder.path().join("c.png")).unwrap();
        let named = format!("{}?frame=2", folder.path().display());
        let files = image_files(Path::new(&named)).unwrap();
        let names: Vec<_> = files.iter().map(|file| file.path.file_name().unwrap().to_str().unwrap()).collect();
        assert_eq!(names, ["a.tif", "b.PNG"]);
        assert!(files.iter().all(|file| file.meaning.frame == Some(2)));
        assert_eq!(image_files(&files[0].path).unwrap()[0].path, files[0].path);
    }

    #[test]
    fn folders_in_a_folder_without_images_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let said = || no_images(folder.path()).to_string();
        assert!(said().contains("found none; choose a folder with images"), "{}", said());
        std::fs::create_dir(folder.path().join("monday")).unwrap();
        assert!(said().contains("found none, but 1 folder; choose one of the folders in it"), "{}", said());
    }
}
