//! IDX image files, plain or gzipped (LeCun, Cortes and Burges, the MNIST database).

use std::io::{BufReader, Read, Seek};
use std::path::Path;

use flate2::bufread::GzDecoder;
use flate2::read::MultiGzDecoder;

use super::bytes::{DEFLATE_RATIO, LARGEST_UNPACKED_BYTES, magic, open, read_values};
use super::kind::named_for_what_it_is;
use super::npy_header::element_count;
use super::samples::Narrowing;
use super::{FormatError, ImageFile, PixelStack, Samples};
use crate::plural::counted;

const ADVICE: &str = "use an image file such as train-images-idx3-ubyte.gz";
/// Expected content, for error sentences.
const IMAGES: &str = "IDX images (3 axes)";

/// Reads IDX images of shape (pages, rows, cols), plain or gzipped. Unsigned bytes keep their width.
///
/// # Errors
/// [`FormatError`] if the file is missing or damaged, has other than three axes (labels, for example), or has not the
/// length stated in its header.
pub fn read_idx(path: &Path) -> Result<PixelStack, FormatError> {
    let file = ImageFile::find(path)?;
    file.check_options(false, false)?;
    file.chosen_frame(read_images(&file)?)
}

/// Whether a gzip file starts with the header of images.
pub(super) fn is_packed_images(path: &Path) -> bool {
    let mut start = [0; 4];
    let read = open(path).map(|(file, _)| MultiGzDecoder::new(BufReader::new(file)).read_exact(&mut start));
    matches!((read, start), (Ok(Ok(())), [0, 0, _, 3]))
}

pub(super) fn read_images(source: &ImageFile) -> Result<PixelStack, FormatError> {
    let path = &source.path;
    let is_packed = magic::<2>(path)? == [0x1f, 0x8b];
    let (file, length) = open(path)?;
    if is_packed {
        let most = length.saturating_mul(DEFLATE_RATIO).min(LARGEST_UNPACKED_BYTES);
        read(source, &mut BufReader::new(MultiGzDecoder::new(BufReader::new(file))), most, false)
    } else {
        read(source, &mut BufReader::new(file), length, true)
    }
}

fn read(
    source: &ImageFile,
    reader: &mut dyn Read,
    most: u64,
    length_is_certain: bool,
) -> Result<PixelStack, FormatError> {
    let path = &source.path;
    let malformed = |expected: &str, found: String| FormatError::malformed(path, expected, found, ADVICE);
    let mut start = [0; 16];
    match reader.read_exact(&mut start[..4]) {
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            return Err(named_for_what_it_is(path, IMAGES));
        }
        other => other.map_err(|error| FormatError::from_read(path, error))?,
    }
    let [zero, also_zero, kind, axes] = [start[0], start[1], start[2], start[3]];
    if (zero, also_zero, axes) != (0, 0, 3) {
        return Err(named_for_what_it_is(path, IMAGES));
    }
    reader.read_exact(&mut start[4..]).map_err(|error| FormatError::from_read(path, error))?;
    let axis = |index: usize| u32::from_be_bytes([0, 1, 2, 3].map(|byte| start[4 * index + byte])) as usize;
    let (pages, rows, cols) = (axis(1), axis(2), axis(3));
    let (width, numbers) = match kind {
        0x08 => (1, "8 bits"),
        0x09 => (1, "8 bits with sign"),
        0x0B => (2, "16 bits with sign"),
        0x0C => (4, "32 bits with sign"),
        0x0D => (4, "32-bit floats"),
        0x0E => (8, "64-bit floats"),
        _ => return Err(malformed("an IDX number type (08, 09, 0b, 0c, 0d, 0e)", format!("{kind:02x}"))),
    };
    let Some(count) = element_count(&[pages, rows, cols], width) else {
        return Err(malformed("images that fit into memory", format!("{pages} of {rows} x {cols} px")));
    };
    let bytes = (count * width) as u64;
    if bytes > most.saturating_sub(16) {
        return Err(malformed(
            "a file as long as its header says",
            format!("{pages} images of {rows} x {cols} px in too few bytes"),
        ));
    }
    let narrowing = Narrowing::default();
    let samples = match kind {
        0x08 => read_values(reader, count, 1, length_is_certain, |bytes| bytes[0]).map(Samples::U8),
        0x09 => read_values(reader, count, 1, length_is_certain, |bytes| f32::from(bytes[0].cast_signed()))
            .map(Samples::F32),
        0x0B => read_values(reader, count, 2, length_is_certain, |bytes| {
            f32::from(i16::from_be_bytes([bytes[0], bytes[1]]))
        })
        .map(Samples::F32),
        0x0C => read_values(reader, count, 4, length_is_certain, |bytes| i32::from_be_bytes(four(bytes)) as f32)
            .map(Samples::F32),
        0x0D => {
            read_values(reader, count, 4, length_is_certain, |bytes| f32::from_be_bytes(four(bytes))).map(Samples::F32)
        }
        _ => read_values(reader, count, 8, length_is_certain, |bytes| {
            let mut value = [0; 8];
            value.copy_from_slice(bytes);
            narrowing.of(f64::from_be_bytes(value))
        })
        .map(Samples::F32),
    }
    .map_err(|error| FormatError::from_read(path, error))?;
    narrowing.check(path)?;
    // Reading one more byte detects a longer file, and makes a gzip reader compare its checksum.
    match reader.read(&mut [0]) {
        Ok(0) => {
            let mut stack = PixelStack::interleaved(source, [pages, rows, cols], samples, 1)?;
            stack.understood.numbers = Some(numbers.into());
            Ok(stack)
        }
        Ok(_) => Err(malformed("a file as long as its header says", format!("more than {} bytes", bytes + 16))),
        Err(error) => Err(match bytes_behind_gzip(path, bytes + 16) {
            Some(behind) => {
                let (expected, found) = ("a gzip file that ends with its images", counted(behind, "byte") + " behind");
                FormatError::malformed(path, expected, found, "copy or download it again")
            }
            None => FormatError::from_read(path, error),
        }),
    }
}

/// Bytes behind the end of a gzip file of `unpacked` bytes; `None` where there are none, or its own end is missing.
fn bytes_behind_gzip(path: &Path, unpacked: u64) -> Option<u64> {
    let (file, length) = open(path).ok()?;
    let mut packed = GzDecoder::new(BufReader::new(file));
    std::io::copy(&mut packed.by_ref().take(unpacked), &mut std::io::sink()).ok()?;
    // One more read finds the end and compares the checksum.
    packed.read(&mut [0]).ok().filter(|&more| more == 0)?;
    let mut reader = packed.into_inner();
    length.checked_sub(reader.stream_position().ok()?).filter(|&behind| behind > 0)
}

fn four(bytes: &[u8]) -> [u8; 4] {
    [bytes[0], bytes[1], bytes[2], bytes[3]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn saved(bytes: &[u8]) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(bytes).unwrap();
        file
    }

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        packer.write_all(bytes).unwrap();
        packer.finish().unwrap()
    }

    fn header(kind: u8, pages: u32, rows: u32, cols: u32) -> Vec<u8> {
        [&[0, 0, kind, 3][..], &pages.to_be_bytes(), &rows.to_be_bytes(), &cols.to_be_bytes()].concat()
    }

    #[test]
    fn plain_and_packed_files_hold_the_same_images() {
        let bytes = [header(8, 2, 2, 3), (0..12).collect()].concat();
        let plain = read_idx(saved(&bytes).path()).unwrap();
        assert_eq!((plain.pages, plain.rows, plain.cols), (2, 2, 3));
        assert_eq!(plain.samples, Samples::U8((0..12).collect()));
        assert_eq!(read_idx(saved(&gzip(&bytes)).path()).unwrap(), plain);
        assert_eq!(plain.image(1)[[1, 2]].to_bits(), 11.0_f32.to_bits());
    }

    #[test]
    fn the_other_number_types_are_big_endian() {
        for (kind, data, numbers) in [
            (0x09, (-3_i8).to_be_bytes().to_vec(), "8 bits with sign"),
            (0x0B, (-3_i16).to_be_bytes().to_vec(), "16 bits with sign"),
            (0x0C, (-3_i32).to_be_bytes().to_vec(), "32 bits with sign"),
            (0x0D, (-3.0_f32).to_be_bytes().to_vec(), "32-bit floats"),
            (0x0E, (-3.0_f64).to_be_bytes().to_vec(), "64-bit floats"),
        ] {
            let image = read_idx(saved(&[header(kind, 1, 1, 1), data].concat()).path()).unwrap();
            assert_eq!(image.samples, Samples::F32(vec![-3.0]), "{kind:02x}");
            assert_eq!(image.understood.numbers.as_deref(), Some(numbers), "{kind:02x}");
        }
    }

    #[test]
    fn wrong_lengths_and_bombs_are_refused() {
        let zeros = vec![0; 1 << 22];
        for (bytes, expected) in [
            ([header(8, 2, 2, 3), vec![0; 11]].concat(), "too few bytes"),
            ([header(8, 2, 2, 3), vec![0; 13]].concat(), "more than 28 bytes"),
            (gzip(&[header(8, 1, 2, 2), zeros].concat()), "more than 20 bytes"),
            (gzip(&header(8, u32::MAX, 2000, 2000)), "too few bytes"),
            (header(8, u32::MAX, u32::MAX, u32::MAX), "fit into memory"),
            (header(8, 0, u32::MAX, u32::MAX), "fit into memory"),
            ([&[0, 0, 8, 1][..], &[0; 12]].concat(), "found IDX labels (1 axis)"),
            (b"P5 28 28 255 and more".to_vec(), "found a PNM image"),
            (gzip(&gzip(&header(8, 1, 1, 1))), "gzipped twice"),
        ] {
            let error = read_idx(saved(&bytes).path()).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        let mut packed = gzip(&[header(8, 1, 2, 2), vec![1, 2, 3, 4]].concat());
        for (bytes, expected) in [
            ([&packed[..], b"x"].concat(), "found 1 byte behind"),
            ([&packed[..], b"more than a header of gzip"].concat(), "found 26 bytes behind"),
            (packed[..packed.len() - 3].to_vec(), "cut short"),
        ] {
            let error = read_idx(saved(&bytes).path()).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        let check_sum = packed.len() - 8;
        packed[check_sum] ^= 1;
        assert!(read_idx(saved(&packed).path()).is_err());
    }
}
