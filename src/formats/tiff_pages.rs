//! TIFF files of one or many pages.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use ndarray::{Array2, ArrayView3};
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::encoder::{TiffEncoder, TiffKind, TiffKindBig, TiffKindStandard, colortype::Gray32Float};
use tiff::{ColorType, TiffError};

use super::bytes::open;
use super::picture::{LARGEST_PICTURE_BYTES, LONGEST_SIDE_PX, most_unpacked_bytes};
use super::write::{CompleteFile, SafeFile};
use super::{FormatError, PixelStack, Samples};

const ADVICE: &str = "save it as uncompressed grey or RGB TIFF";
/// From this many bytes on a file is written as BigTIFF; the offsets of a plain one end at 4 GiB.
const BIG_TIFF_BYTES: usize = 0xF000_0000;
/// Room for what describes one page.
const DIRECTORY_BYTES: usize = 512;

/// Reads every page of a TIFF file as grey values of shape (rows, cols), in the counts of the file: 8- to 64-bit
/// integers, 16- to 64-bit floats; RGB becomes Rec. 709 luma, alpha is ignored.
///
/// # Errors
/// [`FormatError`] if the file is missing, damaged, of another colour model, or a page is larger than 32,768 px a side
/// or 1 GiB.
pub fn read_pages(path: &Path) -> Result<Vec<Array2<f32>>, FormatError> {
    let mut pages = Vec::new();
    for_each_page(path, |page| {
        pages.push(page.picture(0));
        Ok(())
    })?;
    Ok(pages)
}

/// Reads a TIFF file whose pages are all of one shape, in the number type of the file.
pub(super) fn read_equal_pages(path: &Path) -> Result<PixelStack, FormatError> {
    let mut stack: Option<PixelStack> = None;
    for_each_page(path, |page| {
        let Some(stack) = stack.as_mut() else {
            stack = Some(page);
            return Ok(());
        };
        if (page.rows, page.cols) != (stack.rows, stack.cols) {
            let expected = format!("pages of {} x {} px like the first", stack.rows, stack.cols);
            let found = format!("page {} of {} x {} px", stack.pages + 1, page.rows, page.cols);
            return Err(FormatError::malformed(path, expected, found, "crop all pages to one shape"));
        }
        stack.pages += 1;
        stack.from_colour |= page.from_colour;
        stack.white = stack.white.filter(|_| stack.white == page.white);
        stack.samples.append(page.samples);
        Ok(())
    })?;
    stack.ok_or_else(|| FormatError::malformed(path, "at least one page", "none", ADVICE))
}

fn for_each_page(path: &Path, mut take: impl FnMut(PixelStack) -> Result<(), FormatError>) -> Result<(), FormatError> {
    let damaged = |error: TiffError| match error {
        TiffError::IoError(error) => FormatError::from_read(path, error),
        error => FormatError::malformed(path, "an undamaged TIFF file", error.to_string(), ADVICE),
    };
    let (file, length) = open(path)?;
    // Several pages may share one strip; the sum over all pages is bounded too.
    let mut left = most_unpacked_bytes(length).min(LARGEST_PICTURE_BYTES.max(length.saturating_mul(64)));
    let mut limits = Limits::default();
    limits.decoding_buffer_size = LARGEST_PICTURE_BYTES.min(left) as usize;
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    let mut decoder = Decoder::new(BufReader::new(file)).map_err(damaged)?.with_limits(limits);
    loop {
        let (width, height) = decoder.dimensions().map_err(damaged)?;
        let colour = decoder.colortype().map_err(damaged)?;
        let bytes = u64::from(width)
            .saturating_mul(u64::from(height))
            .saturating_mul(u64::from(colour.num_samples()) * u64::from(colour.bit_depth()).div_ceil(8));
        if width.max(height) > LONGEST_SIDE_PX || bytes > left.min(LARGEST_PICTURE_BYTES) {
            let expected = format!("at most {LONGEST_SIDE_PX} px a side and as many bytes as the file can hold");
            let found = format!("a page of {width} x {height} px");
            return Err(FormatError::malformed(path, expected, found, "crop or scale it first"));
        }
        left -= bytes;
        let channels = match colour {
            ColorType::Gray(bits) if bits >= 8 => 1,
            ColorType::GrayA(bits) | ColorType::Multiband { bit_depth: bits, num_samples: 2 } if bits >= 8 => 2,
            ColorType::RGB(bits) if bits >= 8 => 3,
            ColorType::RGBA(bits) if bits >= 8 => 4,
            _ => {
                let found = format!("{colour:?}");
                return Err(FormatError::malformed(path, "grey or RGB of at least 8 bits", found, ADVICE));
            }
        };
        let mut decoded = DecodingResult::U8(Vec::new());
        let layout = decoder.read_image_to_buffer(&mut decoded).map_err(damaged)?;
        let (rows, cols) = (height as usize, width as usize);
        let samples = samples(decoded);
        let samples = if layout.planes > 1 { interleave(&samples, rows * cols, channels) } else { samples };
        if samples.len() != rows * cols * channels {
            let found = format!("{} values for {rows} x {cols} px", samples.len());
            return Err(FormatError::malformed(path, format!("{channels} values per pixel"), found, ADVICE));
        }
        take(PixelStack::page(rows, cols, samples, channels))?;
        if !decoder.more_images() {
            return Ok(());
        }
        decoder.next_image().map_err(damaged)?;
    }
}

fn samples(decoded: DecodingResult) -> Samples {
    fn narrow<T>(values: Vec<T>, convert: impl Fn(T) -> f32) -> Samples {
        Samples::F32(values.into_iter().map(convert).collect())
    }
    match decoded {
        DecodingResult::U8(values) => Samples::U8(values),
        DecodingResult::U16(values) => Samples::U16(values),
        DecodingResult::F32(values) => Samples::F32(values),
        DecodingResult::U32(values) => narrow(values, |value| value as f32),
        DecodingResult::U64(values) => narrow(values, |value| value as f32),
        DecodingResult::F16(values) => narrow(values, f32::from),
        DecodingResult::F64(values) => narrow(values, |value| value as f32),
        DecodingResult::I8(values) => narrow(values, f32::from),
        DecodingResult::I16(values) => narrow(values, f32::from),
        DecodingResult::I32(values) => narrow(values, |value| value as f32),
        DecodingResult::I64(values) => narrow(values, |value| value as f32),
    }
}

/// Colour planes one after the other, as pixels one after the other.
fn interleave(planes: &Samples, pixels: usize, channels: usize) -> Samples {
    if planes.len() != pixels * channels {
        return Samples::F32(Vec::new());
    }
    Samples::F32(
        (0..pixels * channels).map(|index| planes.value(index % channels * pixels + index / channels)).collect(),
    )
}

/// Writes pages of shape (pages, rows, cols) as an uncompressed 32-bit float TIFF, as ImageJ and `tifffile` read it.
///
/// # Errors
/// [`FormatError::NotWritten`] if it cannot be written or there is no pixel.
pub fn write_tiff(path: &Path, pages: ArrayView3<f32>) -> Result<(), FormatError> {
    let mut writer = PageWriter::create(path, pages.dim())?;
    writer.append(pages)?;
    writer.finish()
}

/// Writes a TIFF file part by part, for stacks that are larger than memory should hold.
///
/// The file appears under its name when [`PageWriter::finish`] is called, and not at all where it is not.
pub struct PageWriter {
    path: PathBuf,
    file: SafeFile,
    encoder: Encoder,
    /// Pages that are still to come.
    left: usize,
    rows: usize,
    cols: usize,
}

/// Pages are written in one piece each, so a buffer, which could not be asked whether it arrived, would bring nothing.
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

    /// Completes the file.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] if pages are missing or the file cannot be put in place.
    pub fn finish(self) -> Result<(), FormatError> {
        self.complete()?.put_in_place()
    }

    /// Brings all pages to the disk, under no name yet.
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
    use ndarray::Array3;
    use tiff::encoder::colortype;

    #[test]
    fn alpha_beside_grey_is_ignored() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        // One row of two pixels, grey and alpha in turn: width, height, bits, compression, photometric, strip offset, samples,
        // rows per strip, strip bytes, extra samples.
        let entries: [(u16, u32, u32); 10] = [
            (256, 1, 2),
            (257, 1, 1),
            (258, 2, 8 | 8 << 16),
            (259, 1, 1),
            (262, 1, 1),
            (273, 1, 8),
            (277, 1, 2),
            (278, 1, 1),
            (279, 1, 4),
            (338, 1, 2),
        ];
        let mut file = [b"II*\0".as_slice(), &12_u32.to_le_bytes(), &[10, 255, 200, 3]].concat();
        file.extend((entries.len() as u16).to_le_bytes());
        for (tag, count, value) in entries {
            // Whole numbers of 16 bits.
            file.extend([tag, 3].map(u16::to_le_bytes).concat());
            file.extend([count, value].map(u32::to_le_bytes).concat());
        }
        file.extend([0; 4]);
        std::fs::write(&path, file).unwrap();
        assert_eq!(read_equal_pages(&path).unwrap().into_array(), ndarray::array![[[10.0, 200.0]]]);
    }

    #[test]
    fn float_pages_read_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        let pages = Array3::from_shape_fn((3, 4, 5), |(n, r, c)| (n as f32 - 1.5) * (r as f32 + 0.1).powi(c as i32));
        write_tiff(&path, pages.view()).unwrap();
        let stack = read_equal_pages(&path).unwrap().into_array();
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

    #[test]
    fn integers_doubles_and_colour_pages_of_different_shapes_are_read() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut encoder = TiffEncoder::new(file.reopen().unwrap()).unwrap();
        encoder.write_image::<colortype::Gray8>(2, 1, &[3, 250]).unwrap();
        encoder.write_image::<colortype::Gray16>(1, 2, &[3, 65_000]).unwrap();
        encoder.write_image::<colortype::Gray32>(1, 1, &[70_000]).unwrap();
        encoder.write_image::<colortype::GrayI16>(1, 1, &[-7]).unwrap();
        encoder.write_image::<colortype::Gray64Float>(1, 1, &[0.25]).unwrap();
        encoder.write_image::<colortype::RGB8>(1, 1, &[0, 100, 0]).unwrap();
        let pages = read_pages(file.path()).unwrap();
        let values: Vec<f32> = pages.iter().flatten().copied().collect();
        assert_eq!(values, [3.0, 250.0, 3.0, 65_000.0, 70_000.0, -7.0, 0.25, 71.52]);
        assert_eq!((pages[0].dim(), pages[1].dim()), ((1, 2), (2, 1)));
        let error = read_equal_pages(file.path()).unwrap_err().to_string();
        assert!(error.contains("page 2 of 2 x 1 px"), "{error}");
    }

    #[test]
    fn colour_planes_become_pixels() {
        let planes = Samples::U8(vec![1, 2, 10, 20, 100, 200]);
        assert_eq!(interleave(&planes, 2, 3), Samples::F32(vec![1.0, 10.0, 100.0, 2.0, 20.0, 200.0]));
    }
}
