//! Preview of a file of images before it is used.

use std::path::Path;

use crate::formats::{FormatError, ImageFile, ImageSummary, Meaning, PixelStack, image_files};
use crate::objects::ObjectSource;
use crate::plural::counted;

/// Largest file that is previewed, bytes. Larger files are not read twice, for the preview and for their use.
const LARGEST_BYTES: u64 = 256 << 20;

/// Intended use of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileUse {
    /// Objects.
    Objects,
    /// Images of a camera.
    Measurements,
}

/// Summary of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilePreview {
    /// One sentence, or the error sentence.
    pub understood: Result<String, String>,
    /// Options that fix the meaning of the file, for the `?` after its path: `axis=last`, `channel=green`.
    pub choices: Vec<String>,
}

impl FilePreview {
    /// Reads a file, or the first one of a folder, in the same way as for its use.
    pub fn of(path: &Path, of: FileUse) -> Self {
        match look(path, of) {
            Ok((understood, choices)) => Self { understood: Ok(understood), choices },
            Err(sentence) => Self { understood: Err(sentence), choices: Vec::new() },
        }
    }
}

/// The text of a path with one more option, such as `axis=last`.
pub fn with_option(text: &str, option: &str) -> String {
    let has_options = ImageFile::find(Path::new(text)).is_ok_and(|file| file.meaning != Meaning::default());
    let mark = if has_options { '&' } else { '?' };
    format!("{text}{mark}{option}")
}

fn look(path: &Path, of: FileUse) -> Result<(String, Vec<String>), String> {
    let message = |error: FormatError| error.to_string();
    let mut read: fn(&ImageFile) -> Result<PixelStack, FormatError> = ImageFile::read;
    let path = match of {
        FileUse::Objects => match ObjectSource::guess(path) {
            ObjectSource::Cifar(path) => {
                read = ImageFile::read_cifar;
                path
            }
            ObjectSource::Idx(path) | ObjectSource::Images(path) | ObjectSource::Stack(path) => path,
            drawn => return Ok((format!("{drawn}, drawn at random"), Vec::new())),
        },
        FileUse::Measurements => path.to_path_buf(),
    };
    let files = image_files(&path).map_err(message)?;
    let Some(first) = files.first() else {
        return Err(format!("{}: expected images, found none; choose another folder", path.display()));
    };
    let bytes = first.path.metadata().map_or(0, |metadata| metadata.len());
    if bytes > LARGEST_BYTES {
        return Ok((format!("{:.1} GB, read when it is used", bytes as f64 / 1e9), Vec::new()));
    }
    let summary = ImageSummary::of(&read(first).map_err(message)?);
    let of_several =
        if files.len() > 1 { format!("{}, the first: ", counted(files.len(), "file")) } else { String::new() };
    Ok((format!("{of_several}{summary}"), summary.choices().to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_preview_says_what_a_file_or_folder_holds_and_what_else_it_could_be() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        crate::formats::write_array(&path, ndarray::Array3::<f32>::ones((9, 8, 5)).view()).unwrap();
        let preview = FilePreview::of(&path, FileUse::Objects);
        assert!(preview.understood.unwrap().starts_with("9 images of 8 x 5 px, axis 1 counts them"));
        assert_eq!(preview.choices, ["axis=2", "axis=last"]);
        let last = format!("{}?axis=last", path.display());
        let preview = FilePreview::of(Path::new(&last), FileUse::Measurements);
        assert!(preview.understood.unwrap().starts_with("5 images of 9 x 8 px, axis 3 counts them"));
        std::fs::copy(&path, folder.path().join("b.npy")).unwrap();
        let preview = FilePreview::of(folder.path(), FileUse::Measurements);
        assert!(preview.understood.unwrap().starts_with("2 files, the first: 9 images of 8 x 5 px"));
        for (name, option, expected) in [
            ("a.npy", "axis=last", "a.npy?axis=last"),
            ("a.npy?axis=last", "frame=2", "a.npy?axis=last&frame=2"),
            ("odd?.npy", "axis=2", "odd?.npy?axis=2"),
        ] {
            std::fs::write(folder.path().join("odd?.npy"), "").unwrap();
            let text = |name: &str| folder.path().join(name).display().to_string();
            assert_eq!(with_option(&text(name), option), text(expected));
        }
        assert!(FilePreview::of(&folder.path().join("none.npy"), FileUse::Measurements).understood.is_err());
    }
}
