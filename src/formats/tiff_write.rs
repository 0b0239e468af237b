//! TIFF files of 32-bit floats, written at once or in parts.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use ndarray::ArrayView3;
use tiff::TiffError;
use tiff::encoder::{TiffEncoder, TiffKind, TiffKindBig, TiffKindStandard, colortype::Gray32Float};

use super::FormatError;
use super::atomic_write::{CompleteFile, SafeFile};

/// Size in bytes from which a file is written as BigTIFF. The offsets of a plain TIFF end at 4 GiB.
const BIG_TIFF_BYTES: usize = 0xF000_0000;
/// Space for the directory of one page, bytes.
const DIRECTORY_BYTES: usize = 512;

/// Writes pages of shape (pages, rows, cols) as an uncompressed 32-bit float TIFF that ImageJ and `tifffile` read.
///
/// # Errors
/// [`FormatError::NotWritten`] if the file cannot be written or there is no pixel.
pub fn write_tiff(path: &Path, pages: ArrayView3<f32>) -> Result<(), FormatError> {
    let mut writer = PageWriter::create(path, pages.dim())?;
    writer.append(pages)?;
    writer.finish()
}

/// Writer of a TIFF file in parts, for stacks too large for memory.
///
/// [`PageWriter::finish`] puts the file in place. Without it no file appears.
pub struct PageWriter {
    path: PathBuf,
    file: SafeFile,
    encoder: Encoder,
    /// Number of missing pages.
    left: usize,
    rows: usize,
    cols: usize,
}

/// Pages are written in one piece each, unbuffered. A buffer would gain nothing, and its errors could be missed.
enum Encoder {
    Standard(TiffEncoder<File, TiffKindStandard>),
    Big(TiffEncoder<File, TiffKindBig>),
}

impl PageWriter {
    /// Starts a file of `pages` pages of `rows` x `cols` 32-bit floats.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] if the folder is missing or not writable, `path` cannot be replaced, or there is no
    /// pixel.
    pub fn create(path: &Path, (pages, rows, cols): (usize, usize, usize)) -> Result<Self, FormatError> {
        let bytes = pages.saturating_mul(rows).saturating_mul(cols).saturating_mul(size_of::<f32>());
        let started = || {
            if bytes == 0 {
                return Err(io::Error::new(io::ErrorKind::InvalidInput, "pages without pixels"));
            }
            let file = SafeFile::create(path)?;
            let writer = file.file().try_clone()?;
            let directories = pages.saturating_mul(DIRECTORY_BYTES);
            let encoder = if bytes.saturating_add(directories) < BIG_TIFF_BYTES {
                Encoder::Standard(TiffEncoder::new(writer).map_err(system_error)?)
            } else {
                Encoder::Big(TiffEncoder::new_big(writer).map_err(system_error)?)
            };
            Ok(Self { path: path.to_path_buf(), file, encoder, left: pages, rows, cols })
        };
        started().map_err(|error| FormatError::from_write(path, error))
    }

    /// Adds pages, shape (pages, rows, cols).
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] if the disk is full, or the pages are of another shape or more than were announced.
    pub fn append(&mut self, pages: ArrayView3<f32>) -> Result<(), FormatError> {
        let (count, rows, cols) = pages.dim();
        let written = match self.left.checked_sub(count) {
            Some(left) if (rows, cols) == (self.rows, self.cols) => {
                self.left = left;
                match &mut self.encoder {
                    Encoder::Standard(encoder) => write_pages(encoder, pages),
                    Encoder::Big(encoder) => write_pages(encoder, pages),
                }
                .map_err(system_error)
            }
            _ => Err(io::Error::new(io::ErrorKind::InvalidInput, "pages that were not announced")),
        };
        written.map_err(|error| FormatError::from_write(&self.path, error))
    }

    /// Completes the file and puts it in place.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] if pages are missing or the file cannot be put in place.
    pub fn finish(self) -> Result<(), FormatError> {
        self.complete()?.put_in_place()
    }

    /// Writes all pages to the disk, without giving the file its name.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] if pages are missing or the disk is full.
    pub fn complete(self) -> Result<CompleteFile, FormatError> {
        let completed = match self.left {
            0 => self.file.complete(),
            left => Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{left} pages fewer than announced"))),
        };
        completed.map_err(|error| FormatError::from_write(&self.path, error))
    }
}

fn system_error(error: TiffError) -> io::Error {
    match error {
        TiffError::IoError(error) => error,
        error => io::Error::new(io::ErrorKind::InvalidInput, error),
    }
}

fn write_pages<K: TiffKind>(encoder: &mut TiffEncoder<File, K>, pages: ArrayView3<f32>) -> Result<(), TiffError> {
    for page in pages.outer_iter() {
        let (Ok(width), Ok(height)) = (u32::try_from(page.ncols()), u32::try_from(page.nrows())) else {
            return Err(TiffError::LimitsExceeded);
        };
        encoder.write_image::<Gray32Float>(width, height, &page.iter().copied().collect::<Vec<_>>())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::{read_pages, read_stack};
    use ndarray::Array3;

    #[test]
    fn float_pages_read_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        let pages = Array3::from_shape_fn((3, 4, 5), |(n, r, c)| (n as f32 - 1.5) * (r as f32 + 0.1).powi(c as i32));
        write_tiff(&path, pages.view()).unwrap();
        let stack = read_stack(&path).unwrap().into_array();
        assert!(stack.dim() == (3, 4, 5) && stack.iter().zip(&pages).all(|(a, b)| a.to_bits() == b.to_bits()));
        assert_eq!(read_pages(&path).unwrap()[2], pages.index_axis(ndarray::Axis(0), 2));
        let whole = std::fs::read(&path).unwrap();
        let mut writer = PageWriter::create(&path, (3, 4, 5)).unwrap();
        writer.append(pages.slice(ndarray::s![..2, .., ..])).unwrap();
        assert!(writer.append(pages.view()).is_err(), "one page is left");
        assert!(writer.append(pages.slice(ndarray::s![2.., 1.., ..])).is_err(), "another shape");
        writer.append(pages.slice(ndarray::s![2.., .., ..])).unwrap();
        writer.finish().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), whole, "parts make the same file");
        let unfinished = PageWriter::create(&folder.path().join("b.tif"), (1, 4, 5)).unwrap();
        assert!(unfinished.finish().unwrap_err().to_string().contains("1 pages fewer"));
        assert!(write_tiff(&path, Array3::zeros((0, 4, 5)).view()).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
