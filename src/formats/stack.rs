//! Whatever file holds pictures, as grey pages.

use std::path::Path;

use ndarray::Array3;

use super::bytes::magic;
use super::{FormatError, PixelStack, Samples, npy, npz, picture, tiff_pages};

/// The first two axes of a colour picture are longer than this, so that a stack of a few narrow pages is not one.
const COLOUR_PICTURE_PX: usize = 4;

/// Reads a file of pictures as grey pages of shape (pages, rows, cols), in the counts of the file.
///
/// The first bytes, not the name, tell the kind: NPY, NPZ (one array), TIFF (all pages), PNG, JPEG, BMP. Arrays may be
/// (rows, cols), (pages, rows, cols), or (rows, cols, 3 or 4) colour with rows and cols above 4, which becomes
/// Rec. 709 luma.
///
/// # Errors
/// [`FormatError`] if the file is missing, damaged, of another kind, or an array of other axes.
pub fn read_picture_or_array(path: &Path) -> Result<Array3<f32>, FormatError> {
    Ok(read_stack(path)?.into_array())
}

/// [`read_picture_or_array`] in the number type of the file.
pub fn read_stack(path: &Path) -> Result<PixelStack, FormatError> {
    match magic::<4>(path)? {
        [0x93, b'N', b'U', b'M'] => from_array(path, npy::read_samples(path)?),
        [b'P', b'K', 3 | 5, 4 | 6] => from_array(path, npz::read_samples(path)?),
        [b'I', b'I', 42 | 43, 0] | [b'M', b'M', 0, 42 | 43] => tiff_pages::read_equal_pages(path),
        [0x89, b'P', b'N', b'G'] | [0xFF, 0xD8, 0xFF, _] | [b'B', b'M', ..] => picture::read_page(path),
        start => {
            let found = format!("the first bytes {start:02x?}");
            Err(FormatError::malformed(path, "an NPY, NPZ, TIFF, PNG, JPEG or BMP file", found, "convert it first"))
        }
    }
}

fn from_array(path: &Path, (shape, samples): (Vec<usize>, Samples)) -> Result<PixelStack, FormatError> {
    match shape[..] {
        [rows, cols] => Ok(PixelStack::page(rows, cols, samples, 1)),
        [rows, cols, channels @ (3 | 4)] if rows.min(cols) > COLOUR_PICTURE_PX => {
            Ok(PixelStack::page(rows, cols, samples, channels))
        }
        [pages, rows, cols] => Ok(PixelStack::new(pages, rows, cols, samples)),
        _ => Err(FormatError::malformed(
            path,
            "an array of shape (rows, cols), (pages, rows, cols) or (rows, cols, 3)",
            format!("shape {shape:?}"),
            "reshape it first",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::write_array;
    use ndarray::{ArrayD, IxDyn};

    #[test]
    fn colour_is_told_from_a_stack_by_its_axes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        for (shape, expected) in [
            (&[7, 9][..], Some((1, 7, 9))),
            (&[7, 9, 3], Some((1, 7, 9))),
            (&[7, 9, 4], Some((1, 7, 9))),
            (&[7, 9, 5], Some((7, 9, 5))),
            (&[2, 9, 3], Some((2, 9, 3))),
            (&[0, 9, 9], Some((0, 9, 9))),
            (&[9], None),
            (&[2, 2, 9, 9], None),
        ] {
            write_array(&path, ArrayD::ones(IxDyn(shape)).view()).unwrap();
            assert_eq!(read_picture_or_array(&path).ok().map(|stack| stack.dim()), expected, "{shape:?}");
        }
        write_array(&path, ArrayD::ones(IxDyn(&[5, 5, 3])).view()).unwrap();
        assert!(read_picture_or_array(&path).unwrap().iter().all(|value| (value - 1.0).abs() < 1e-6));
    }

    #[test]
    fn other_files_are_named_with_what_would_do() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = read_picture_or_array(file.path()).unwrap_err().to_string();
        assert!(error.contains("expected an NPY, NPZ, TIFF, PNG, JPEG or BMP file"), "{error}");
        let error = read_picture_or_array(Path::new("/none/a.npy")).unwrap_err();
        assert!(matches!(error, FormatError::NotFound { .. }), "{error}");
        let error = read_picture_or_array(&std::env::temp_dir()).unwrap_err().to_string();
        assert!(error.contains("found a folder"), "{error}");
    }
}
