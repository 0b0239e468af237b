//! Zip archives of NumPy arrays.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use ndarray::ArrayD;
use zip::read::ZipFile;
use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

use super::FormatError;
use super::bytes::{DEFLATE_RATIO, LARGEST_UNPACKED_BYTES, open};
use super::npy::{arrange, check_end, header, raw, values};
use super::npy_header::NpyHeader;
use super::raw_array::RawArray;

const ADVICE: &str = "write the archive again with numpy.savez";
/// Largest number of array names that an error lists.
const LISTED_NAMES: usize = 12;

/// Reads one array of an archive as `f32`: the array called `name`, or the only one.
///
/// # Errors
/// [`FormatError`] if the archive is missing or damaged, or has no array of that name. If `name` is `None` and there are
/// several arrays, the error lists their names.
pub fn read_npz(path: &Path, name: Option<&str>) -> Result<ArrayD<f32>, FormatError> {
    with_array(path, name, |entry, length| whole(path, entry, length, |value| value as f32))
}

/// [`read_npz`] without rounding to `f32`, for reference values.
pub fn read_npz_f64(path: &Path, name: Option<&str>) -> Result<ArrayD<f64>, FormatError> {
    with_array(path, name, |entry, length| whole(path, entry, length, |value| value))
}

/// An array that fills its entry of `length` bytes.
fn whole<T: Clone>(
    path: &Path,
    entry: &mut dyn Read,
    length: u64,
    convert: impl Fn(f64) -> T,
) -> Result<ArrayD<T>, FormatError> {
    let header = header(path, entry, length)?;
    let array = arrange(path, &header, values(&header, entry, false, convert))?;
    check_end(path, &header, entry)?;
    Ok(array)
}

/// An array of an archive in the number type of the file: the named one, or the only one that can be an image.
pub(super) fn read_raw(path: &Path, name: Option<&str>) -> Result<RawArray, FormatError> {
    let image = match name {
        Some(_) => None,
        None => only_image(path)?,
    };
    let chosen = name.map(ToOwned::to_owned).or(image);
    let mut array = with_array(path, chosen.as_deref(), |entry, length| {
        let header = header(path, entry, length)?;
        raw(path, header, entry, false)
    })?;
    array.understood.key = chosen;
    Ok(array)
}

/// Name of the only array of an archive of several that can be an image: numbers with two or more axes longer than 1.
/// `None` where the archive has a single array.
fn only_image(path: &Path) -> Result<Option<String>, FormatError> {
    let (file, _) = open(path)?;
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|error| damaged(path, &error))?;
    let names = names(&archive);
    if names.is_empty() {
        return Err(no_arrays(path, &archive));
    }
    if names.len() == 1 {
        return Ok(None);
    }
    let (mut images, mut shapes) = (Vec::new(), Vec::new());
    for name in names {
        let mut entry = archive.by_name(&format!("{name}.npy")).map_err(|error| damaged(path, &error))?;
        let length = claimed_length(path, &entry)?;
        match NpyHeader::read(&mut entry, length) {
            Ok(header) => {
                let axes: Vec<String> = header.shape.iter().map(ToString::to_string).collect();
                shapes.push(match axes.as_slice() {
                    [] => format!("{name} (a number)"),
                    axes => format!("{name} ({})", axes.join(" x ")),
                });
                if header.shape.iter().filter(|&&axis| axis > 1).count() >= 2 {
                    images.push(name);
                }
            }
            Err(mismatch) => shapes.push(format!("{name} ({})", mismatch.found)),
        }
    }
    let more = if shapes.len() > LISTED_NAMES { " and more" } else { "" };
    let found = format!("{}{more}", shapes[..shapes.len().min(LISTED_NAMES)].join(", "));
    match images.as_slice() {
        [image] => Ok(Some(image.clone())),
        [] => Err(FormatError::malformed(path, "an array that can be an image", found, ADVICE)),
        [first, ..] => {
            let advice = format!("choose one: add ?key={first} to the path");
            Err(FormatError::malformed(path, "exactly one array that can be an image", found, advice))
        }
    }
}

fn damaged(path: &Path, error: &ZipError) -> FormatError {
    FormatError::malformed(path, "a zip archive of NumPy arrays", error.to_string(), ADVICE)
}

/// The error of an archive without arrays.
fn no_arrays(path: &Path, archive: &ZipArchive<BufReader<File>>) -> FormatError {
    let entries: Vec<String> = archive.file_names().filter_map(|name| Some(name.ok()?.into_owned())).collect();
    let ends = |ending: &str| entries.iter().any(|entry| entry.ends_with(ending));
    let (found, advice) = if ends("data.pkl") {
        ("a PyTorch file".to_owned(), "save the tensor, numpy.save(FILE, tensor.numpy())")
    } else if ends("[Content_Types].xml") {
        ("an office document".to_owned(), "choose another file")
    } else {
        match entries.first() {
            None => ("an empty zip archive".to_owned(), ADVICE),
            Some(first) => (format!("a zip archive of other files, such as {first}"), "unpack it first"),
        }
    };
    FormatError::malformed(path, "a zip archive of NumPy arrays", found, advice)
}

/// Names of the arrays, sorted. Entries whose names are not text are omitted.
fn names(archive: &ZipArchive<BufReader<File>>) -> Vec<String> {
    let mut names: Vec<String> =
        archive.file_names().filter_map(|entry| Some(entry.ok()?.strip_suffix(".npy")?.to_owned())).collect();
    names.sort_unstable();
    names
}

/// Finds the entry, checks its stated unpacked size, reads it, and lets the archive verify the checksum.
fn with_array<T>(
    path: &Path,
    name: Option<&str>,
    read: impl FnOnce(&mut dyn Read, u64) -> Result<T, FormatError>,
) -> Result<T, FormatError> {
    let (file, _) = open(path)?;
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|error| damaged(path, &error))?;
    let entry_name = choose(path, &archive, name)?;
    let mut entry = archive.by_name(&entry_name).map_err(|error| damaged(path, &error))?;
    let length = claimed_length(path, &entry)?;
    let array = read(&mut entry, length)?;
    // The archive verifies the checksum at the end of the entry, wherever the array ends.
    std::io::copy(&mut entry.by_ref().take(length), &mut std::io::sink())
        .map_err(|error| FormatError::from_read(path, error))?;
    Ok(array)
}

fn claimed_length(path: &Path, entry: &ZipFile<'_, BufReader<File>>) -> Result<u64, FormatError> {
    let method = entry.compression();
    if !matches!(method, CompressionMethod::STORE | CompressionMethod::DEFLATE) {
        let found = format!("one packed by {method}");
        let advice = "write the archive again with numpy.savez_compressed";
        return Err(FormatError::malformed(path, "an array that is stored or packed by Deflate", found, advice));
    }
    let (packed, unpacked) = (entry.compressed_size(), entry.size());
    let most = packed.saturating_mul(DEFLATE_RATIO).min(LARGEST_UNPACKED_BYTES);
    if unpacked > most {
        let found = format!("one that claims {unpacked} bytes");
        return Err(FormatError::malformed(path, format!("an array of at most {most} bytes"), found, ADVICE));
    }
    Ok(unpacked)
}

fn choose(path: &Path, archive: &ZipArchive<BufReader<File>>, name: Option<&str>) -> Result<String, FormatError> {
    let names = names(archive);
    let wanted = match (name, names.as_slice()) {
        (Some(name), _) if names.iter().any(|known| known == name) => return Ok(format!("{name}.npy")),
        (None, [only]) => return Ok(format!("{only}.npy")),
        (Some(name), _) => format!("an array called {name:?}"),
        (None, _) => "exactly one array".into(),
    };
    let more = if names.len() > LISTED_NAMES { " and more" } else { "" };
    let found = match names.as_slice() {
        [] => "no array".into(),
        names => format!("{}{more}", names[..names.len().min(LISTED_NAMES)].join(", ")),
    };
    let advice = match name {
        Some(_) => "name one of the arrays",
        None => "save the array alone with numpy.save",
    };
    Err(FormatError::malformed(path, wanted, found, advice))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

    fn array(values: &[f64]) -> Vec<u8> {
        let text = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({},), }}", values.len());
        let mut bytes = [b"\x93NUMPY\x01\x00".as_slice(), &(text.len() as u16).to_le_bytes(), text.as_bytes()].concat();
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        bytes
    }

    fn archive(entries: &[(&str, &[f64])], method: CompressionMethod) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut zip = ZipWriter::new(file.reopen().unwrap());
        for (name, values) in entries {
            zip.start_file(format!("{name}.npy"), SimpleFileOptions::default().compression_method(method)).unwrap();
            zip.write_all(&array(values)).unwrap();
        }
        zip.finish().unwrap();
        file
    }

    #[test]
    fn one_array_needs_no_name_and_several_are_listed() {
        let third = 1.0 / 3.0;
        for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
            let one = archive(&[("psf", &[third, 2.0])], method);
            assert_eq!(read_npz_f64(one.path(), None).unwrap().as_slice().unwrap(), [third, 2.0]);
            assert_eq!(read_npz(one.path(), Some("psf")).unwrap()[[0]].to_bits(), (third as f32).to_bits());
            let two = archive(&[("psf", &[1.0]), ("objects/a", &[2.0])], method);
            assert_eq!(read_npz(two.path(), Some("objects/a")).unwrap().as_slice().unwrap(), [2.0]);
            let error = read_npz(two.path(), None).unwrap_err().to_string();
            assert!(error.contains("objects/a, psf; save the array alone"), "{error}");
            let error = read_npz(two.path(), Some("other")).unwrap_err().to_string();
            assert!(error.contains("objects/a, psf; name one of the arrays"), "{error}");
        }
    }

    #[test]
    fn other_compressions_are_called_by_their_name() {
        let two = archive(&[("a", &[1.0]), ("b", &[2.0])], CompressionMethod::Stored);
        let stored = std::fs::read(two.path()).unwrap();
        for (method, name) in [(12, "Bzip2"), (14, "Lzma")] {
            // The method stands 8 bytes behind the start of an entry, and 10 behind that of its listing.
            let mut bytes = stored.clone();
            for at in 0..bytes.len() - 4 {
                match &stored[at..at + 4] {
                    b"PK\x03\x04" => bytes[at + 8] = method,
                    b"PK\x01\x02" => bytes[at + 10] = method,
                    _ => {}
                }
            }
            std::fs::write(two.path(), bytes).unwrap();
            for error in [read_npz(two.path(), Some("a")).unwrap_err(), read_raw(two.path(), None).err().unwrap()] {
                assert!(error.to_string().contains(&format!("found one packed by {name}; write")), "{error}");
            }
        }
    }

    #[test]
    fn a_flipped_byte_is_found_by_the_check_sum() {
        let one = archive(&[("a", &[1.0, 2.0, 3.0])], CompressionMethod::Stored);
        let mut bytes = std::fs::read(one.path()).unwrap();
        let header_end = bytes.windows(4).position(|window| window == b"), }").unwrap();
        bytes[header_end + 10] ^= 1;
        std::fs::write(one.path(), bytes).unwrap();
        assert!(read_npz(one.path(), None).unwrap_err().to_string().contains("checksum"));
    }
}
