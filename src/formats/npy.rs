//! NumPy array files.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use ndarray::{ArrayD, ArrayView, Dimension, IxDyn, ShapeBuilder};

use super::atomic_write::{CompleteFile, SafeFile};
use super::bytes::{open, read_values};
use super::npy_header::{ADVICE, Element, MAGIC, Mismatch, NpyHeader, element_count, header_of_f32};
use super::raw_array::RawArray;
use super::samples::Narrowing;
use super::{FormatError, Samples, Understood};
use crate::plural::counted;

/// Reads an array file as `f32`: NPY 1 to 3; booleans, 8- to 64-bit integers, 32- and 64-bit floats; either byte order; C
/// or Fortran order. NaN and infinities stay.
///
/// # Errors
/// [`FormatError`] if the file is missing, is not NPY, is truncated, holds another number type, or has bytes behind the
/// array.
pub fn read_array(path: &Path) -> Result<ArrayD<f32>, FormatError> {
    let (file, length) = open(path)?;
    let mut reader = BufReader::new(file);
    let header = header(path, &mut reader, length)?;
    let values = values(&header, &mut reader, true, |value| value as f32);
    let array = arrange(path, &header, values)?;
    check_end(path, &header, &mut reader)?;
    Ok(array)
}

/// Reads an array file in the number type of the file.
pub(super) fn read_raw(path: &Path) -> Result<RawArray, FormatError> {
    let (file, length) = open(path)?;
    let mut reader = BufReader::new(file);
    let header = header(path, &mut reader, length)?;
    raw(path, header, &mut reader, true)
}

/// Reads the elements after a header.
pub(super) fn raw(
    path: &Path,
    header: NpyHeader,
    reader: &mut dyn Read,
    length_is_certain: bool,
) -> Result<RawArray, FormatError> {
    let samples = match header.element {
        Element::U8 => {
            let values = read_values(reader, header.count, 1, length_is_certain, |bytes| bytes[0]);
            Samples::U8(row_major(path, &header, values)?)
        }
        Element::U16 => {
            let values = values(&header, reader, length_is_certain, |value| value as u16);
            Samples::U16(row_major(path, &header, values)?)
        }
        _ => {
            let narrowing = Narrowing::default();
            let values = values(&header, reader, length_is_certain, |value| narrowing.of(value));
            narrowing.check(path)?;
            Samples::F32(row_major(path, &header, values)?)
        }
    };
    check_end(path, &header, reader)?;
    let numbers = header.element.for_people().map(Into::into);
    Ok(RawArray { shape: header.shape, samples, understood: Understood { numbers, ..Understood::default() } })
}

/// Refuses bytes behind the last element. They would be lost in silence, and may be further arrays.
pub(super) fn check_end(path: &Path, header: &NpyHeader, reader: &mut dyn Read) -> Result<(), FormatError> {
    if header.bytes_behind == 0 {
        return Ok(());
    }
    let mut next = Vec::new();
    let failed = |error| FormatError::from_read(path, error);
    reader.take(MAGIC.len() as u64).read_to_end(&mut next).map_err(failed)?;
    let (found, advice) = if next == MAGIC {
        ("another array behind it".to_owned(), "save all as one array, numpy.stack, or each to a file of its own")
    } else {
        (format!("{} behind it", counted(header.bytes_behind, "byte")), ADVICE)
    };
    Err(FormatError::malformed(path, "a file that ends with its array", found, advice))
}

/// Reads a header at the start of `available` bytes.
pub(super) fn header(path: &Path, reader: &mut dyn Read, available: u64) -> Result<NpyHeader, FormatError> {
    NpyHeader::read(reader, available)
        .map_err(|Mismatch { expected, found, advice }| FormatError::malformed(path, expected, found, advice))
}

/// Reads the elements after a header.
pub(super) fn values<T>(
    header: &NpyHeader,
    reader: &mut dyn Read,
    length_is_certain: bool,
    convert: impl Fn(f64) -> T,
) -> io::Result<Vec<T>> {
    read_values(reader, header.count, header.element.width(), length_is_certain, |bytes| convert(header.value(bytes)))
}

/// Gives elements the shape of their header, in C order.
pub(super) fn arrange<T: Clone>(
    path: &Path,
    header: &NpyHeader,
    values: io::Result<Vec<T>>,
) -> Result<ArrayD<T>, FormatError> {
    let values = values.map_err(|error| FormatError::from_read(path, error))?;
    let shape = IxDyn(&header.shape).set_f(header.fortran_order);
    let array = ArrayD::from_shape_vec(shape, values).map_err(|error| {
        FormatError::malformed(path, "an array that fits into memory", format!("{:?}: {error}", header.shape), ADVICE)
    })?;
    Ok(if header.fortran_order { array.as_standard_layout().into_owned() } else { array })
}

fn row_major<T: Clone>(path: &Path, header: &NpyHeader, values: io::Result<Vec<T>>) -> Result<Vec<T>, FormatError> {
    if !header.fortran_order {
        return values.map_err(|error| FormatError::from_read(path, error));
    }
    Ok(arrange(path, header, values)?.into_iter().collect())
}

/// Writes an array file of little-endian `f32` in C order, like NumPy.
///
/// ```no_run
/// use lenslet_studio::prelude::*;
///
/// let psf = Design::default().psf(1)?.mapv(|value| value as f32);
/// write_array("psf.npy".as_ref(), psf.view())?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`FormatError::NotWritten`]; an earlier file of that name is then unchanged.
pub fn write_array<D: Dimension>(path: &Path, array: ArrayView<f32, D>) -> Result<(), FormatError> {
    let mut writer = ArrayWriter::create(path, array.shape())?;
    writer.append(array)?;
    writer.finish()
}

/// Writer of an array file in parts, for arrays too large for memory.
///
/// [`ArrayWriter::finish`] puts the file in place. Without it no file appears.
pub struct ArrayWriter {
    path: PathBuf,
    file: SafeFile,
    writer: BufWriter<File>,
    /// Number of missing elements.
    left: u64,
}

impl ArrayWriter {
    /// Starts a file of little-endian `f32` of this shape, in C order.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] if the folder is missing or not writable, or `path` cannot be replaced.
    pub fn create(path: &Path, shape: &[usize]) -> Result<Self, FormatError> {
        let started = || {
            let left = element_count(shape, size_of::<f32>()).ok_or(io::ErrorKind::FileTooLarge)? as u64;
            let file = SafeFile::create(path)?;
            let mut writer = BufWriter::with_capacity(1 << 16, file.file().try_clone()?);
            writer.write_all(&header_of_f32(shape)?)?;
            Ok(Self { path: path.to_path_buf(), file, writer, left })
        };
        started().map_err(|error| FormatError::from_write(path, error))
    }

    /// Appends the elements of `part` in C order.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] if the disk is full or the shape holds no more elements.
    pub fn append<D: Dimension>(&mut self, part: ArrayView<f32, D>) -> Result<(), FormatError> {
        let written = match self.left.checked_sub(part.len() as u64) {
            None => Err(io::Error::new(io::ErrorKind::InvalidInput, "more values than the array's shape holds")),
            Some(left) => {
                self.left = left;
                part.iter().try_for_each(|value| self.writer.write_all(&value.to_le_bytes()))
            }
        };
        written.map_err(|error| FormatError::from_write(&self.path, error))
    }

    /// Completes the file and puts it in place.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] if elements are missing or the file cannot be put in place.
    pub fn finish(self) -> Result<(), FormatError> {
        self.complete()?.put_in_place()
    }

    /// Writes all elements to the disk, without giving the file its name.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] if elements are missing or the disk is full.
    pub fn complete(self) -> Result<CompleteFile, FormatError> {
        let Self { path, file, mut writer, left } = self;
        let completed = match left {
            0 => writer.flush().and_then(|()| file.complete()),
            left => Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!("{left} values fewer than the array's shape holds"),
            )),
        };
        completed.map_err(|error| FormatError::from_write(&path, error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array3, arr2};

    fn file(descr: &str, fortran: &str, shape: &str, data: &[u8], version: u8) -> tempfile::NamedTempFile {
        let text = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
        let mut bytes = [b"\x93NUMPY".as_slice(), &[version, 0]].concat();
        if version == 1 {
            bytes.extend((text.len() as u16).to_le_bytes());
        } else {
            bytes.extend((text.len() as u32).to_le_bytes());
        }
        bytes.extend(text.as_bytes());
        bytes.extend(data);
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        file
    }

    #[test]
    fn every_type_and_byte_order_gives_the_same_numbers() {
        let numbers = [0_i8, 1, 100, 7, 5, 3];
        macro_rules! data {
            ($type:ty, $order:ident) => {
                numbers.iter().flat_map(|&number| (number as $type).$order()).collect::<Vec<u8>>()
            };
        }
        let cases = [
            ("|u1", data!(u8, to_le_bytes)),
            ("|i1", data!(i8, to_le_bytes)),
            ("<u2", data!(u16, to_le_bytes)),
            (">u2", data!(u16, to_be_bytes)),
            ("<i2", data!(i16, to_le_bytes)),
            (">i2", data!(i16, to_be_bytes)),
            ("<u4", data!(u32, to_le_bytes)),
            (">u4", data!(u32, to_be_bytes)),
            (">i4", data!(i32, to_be_bytes)),
            ("<u8", data!(u64, to_le_bytes)),
            (">i8", data!(i64, to_be_bytes)),
            ("<f4", data!(f32, to_le_bytes)),
            (">f4", data!(f32, to_be_bytes)),
            ("<f8", data!(f64, to_le_bytes)),
            (">f8", data!(f64, to_be_bytes)),
        ];
        for (version, (descr, data)) in [1, 2, 3].into_iter().cycle().zip(cases) {
            let array = read_array(file(descr, "False", "(2, 3)", &data, version).path()).unwrap();
            assert_eq!(array, arr2(&[[0.0, 1.0, 100.0], [7.0, 5.0, 3.0]]).into_dyn(), "{descr}");
            let array = read_array(file(descr, "True", "(3, 2)", &data, version).path()).unwrap();
            assert_eq!(array, arr2(&[[0.0, 7.0], [1.0, 5.0], [100.0, 3.0]]).into_dyn(), "{descr}");
            assert!(array.is_standard_layout());
        }
        let signed = read_array(file(">i2", "False", "(2,)", &[0xff, 0xfe, 0x80, 0x00], 1).path()).unwrap();
        assert_eq!(signed.as_slice().unwrap(), [-2.0, -32768.0]);
        let flags = read_array(file("|b1", "False", "(3,)", &[0, 1, 2], 1).path()).unwrap();
        assert_eq!(flags.as_slice().unwrap(), [0.0, 1.0, 1.0]);
    }

    #[test]
    fn half_floats_are_read_and_other_types_say_what_to_do() {
        // 1, -2, the largest, the smallest, infinity, NaN.
        let bits = [0x3c00_u16, 0xc000, 0x7bff, 0x0001, 0x7c00, 0x7e00];
        for (descr, data) in
            [("<f2", bits.map(u16::to_le_bytes).concat()), (">f2", bits.map(u16::to_be_bytes).concat())]
        {
            let array = read_array(file(descr, "False", "(6,)", &data, 1).path()).unwrap();
            let values = array.as_slice().unwrap();
            assert_eq!(values[..5], [1.0, -2.0, 65504.0, 2.0_f32.powi(-24), f32::INFINITY]);
            assert!(values[5].is_nan());
        }
        for (descr, found, advice) in [
            ("<c8", "complex numbers", "np.abs(a)**2"),
            (">c16", "complex numbers", "np.abs(a)**2"),
            ("<f16", "long doubles", "a.astype('float32')"),
            ("<f12", "long doubles", "a.astype('float32')"),
            ("|O", "Python objects", "np.stack"),
            ("<U7", "text", "numbers"),
            ("|S3", "text", "numbers"),
            ("<M8[ns]", "dates", "numbers"),
            ("|V2", "bytes without a type", "a.astype('float32')"),
        ] {
            let error = read_array(file(descr, "False", "(1,)", &[0; 32], 1).path()).unwrap_err().to_string();
            assert!(error.contains(found) && error.contains(advice), "{error}");
        }
    }

    #[test]
    fn what_lies_behind_an_array_is_not_lost_in_silence() {
        let bytes = std::fs::read(file("|u1", "False", "(2,)", &[1, 2], 1).path()).unwrap();
        let both = tempfile::NamedTempFile::new().unwrap();
        for (behind, expected) in [
            (&bytes[..], "found another array behind it; save all as one array, numpy.stack, or each to a file"),
            (&[0], "found 1 byte behind it; write the array again"),
        ] {
            std::fs::write(both.path(), [&bytes, behind].concat()).unwrap();
            for error in [read_raw(both.path()).err().unwrap(), read_array(both.path()).unwrap_err()] {
                assert!(error.to_string().contains(expected), "{error}");
            }
        }
    }

    #[test]
    fn doubles_beyond_single_precision_are_called_by_their_value() {
        let read = |numbers: [f64; 2]| {
            let data = numbers.map(f64::to_le_bytes).concat();
            read_raw(file("<f8", "False", "(2,)", &data, 1).path()).map(|array| array.samples)
        };
        let error = read([1.0, -1e303]).unwrap_err().to_string();
        assert!(error.contains("found -1e303; divide all values by a constant"), "{error}");
        let samples = read([f64::INFINITY, f64::from(f32::MAX)]).unwrap();
        assert_eq!(samples, Samples::F32(vec![f32::INFINITY, f32::MAX]));
    }

    #[test]
    fn counts_keep_their_type_and_fortran_order_is_undone() {
        let array = read_raw(file("|u1", "True", "(2, 3)", &[1, 2, 3, 4, 5, 6], 1).path()).unwrap();
        assert_eq!((array.shape, array.samples), (vec![2, 3], Samples::U8(vec![1, 3, 5, 2, 4, 6])));
        let array = read_raw(file(">u2", "False", "(2,)", &[1, 0, 0, 2], 2).path()).unwrap();
        assert_eq!(array.samples, Samples::U16(vec![256, 2]));
    }

    #[test]
    fn what_is_written_reads_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let array =
            Array3::from_shape_fn((2, 3, 4), |(i, j, k)| (i as f32 - 0.1) * 3.0_f32.powi(j as i32) / (k as f32));
        write_array(&path, array.view()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes.len() % 64 == (24 * 4) % 64 && String::from_utf8_lossy(&bytes).contains("'<f4'"));
        let back = read_array(&path).unwrap();
        assert_eq!(back.shape(), [2, 3, 4]);
        assert!(back.iter().zip(&array).all(|(a, b)| a.to_bits() == b.to_bits()));
        let mut reversed = array.view();
        reversed.invert_axis(ndarray::Axis(1));
        write_array(&path, reversed).unwrap();
        assert!(read_array(&path).unwrap().iter().zip(reversed).all(|(a, b)| a.to_bits() == b.to_bits()));
    }

    #[test]
    fn parts_make_the_file_that_the_whole_makes() {
        let folder = tempfile::tempdir().unwrap();
        let (whole, parts) = (folder.path().join("whole.npy"), folder.path().join("parts.npy"));
        let array = Array3::from_shape_fn((7, 3, 2), |(i, j, k)| (i * 100 + j * 10 + k) as f32);
        write_array(&whole, array.view()).unwrap();
        for length in [1, 3, 7] {
            let mut writer = ArrayWriter::create(&parts, &[7, 3, 2]).unwrap();
            for part in array.axis_chunks_iter(ndarray::Axis(0), length) {
                writer.append(part).unwrap();
            }
            writer.finish().unwrap();
            assert_eq!(std::fs::read(&parts).unwrap(), std::fs::read(&whole).unwrap());
        }
    }

    #[test]
    fn a_file_that_is_not_complete_never_appears() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let mut writer = ArrayWriter::create(&path, &[2, 2]).unwrap();
        writer.append(arr2(&[[1.0_f32, 2.0]]).view()).unwrap();
        assert!(writer.append(arr2(&[[1.0_f32, 2.0, 3.0]]).view()).unwrap_err().to_string().contains("more values"));
        assert!(writer.finish().unwrap_err().to_string().contains("2 values fewer"));
        drop(ArrayWriter::create(&path, &[0]).unwrap());
        assert!(ArrayWriter::create(&path, &[usize::MAX, 2]).is_err());
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
    }

    #[test]
    fn short_file_is_refused_before_memory_is_reserved() {
        let error = read_array(file("<f8", "False", "(1000000, 1000000)", &[0; 16], 1).path()).unwrap_err().to_string();
        assert!(error.contains("8000000000000 bytes") && error.contains("16 bytes"), "{error}");
        let error = read_array(file("<f4", "False", "(0, 18446744073709551615)", &[], 1).path()).unwrap_err();
        assert!(error.to_string().contains("memory"), "{error}");
    }
}
