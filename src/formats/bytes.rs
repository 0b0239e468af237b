//! Opening files and reading them within limits.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use super::FormatError;

/// Largest expansion factor of deflate.
pub(super) const DEFLATE_RATIO: u64 = 1032;

/// Largest number of bytes read from a compressed file, whatever its header states.
pub(super) const LARGEST_UNPACKED_BYTES: u64 = 16 << 30;

/// Opens a regular file and returns it with its length in bytes. Folders, pipes and devices are refused.
pub(super) fn open(path: &Path) -> Result<(File, u64), FormatError> {
    let metadata = std::fs::metadata(path).map_err(|error| FormatError::from_read(path, error))?;
    if !metadata.is_file() {
        let found = if metadata.is_dir() { "a folder" } else { "a device or pipe" };
        return Err(FormatError::malformed(path, "a file", found, "name a file"));
    }
    let file = File::open(path).map_err(|error| FormatError::from_read(path, error))?;
    Ok((file, metadata.len()))
}

/// All bytes of a file of at most `most` bytes.
///
/// # Errors
/// [`FormatError`] where the file is missing, not a regular file, unreadable, or larger.
pub fn read_bytes(path: &Path, most: u64) -> Result<Vec<u8>, FormatError> {
    let (file, length) = open(path)?;
    if length > most {
        let expected = format!("a file of at most {most} bytes");
        return Err(FormatError::malformed(path, expected, format!("{length} bytes"), "choose another file"));
    }
    let mut bytes = Vec::new();
    file.take(most).read_to_end(&mut bytes).map_err(|error| FormatError::from_read(path, error))?;
    Ok(bytes)
}

/// The first `N` bytes of the file, padded with zeros where the file is shorter.
pub(super) fn magic<const N: usize>(path: &Path) -> Result<[u8; N], FormatError> {
    let (file, _) = open(path)?;
    let mut start = Vec::with_capacity(N);
    file.take(N as u64).read_to_end(&mut start).map_err(|error| FormatError::from_read(path, error))?;
    let mut magic = [0; N];
    magic[..start.len()].copy_from_slice(&start);
    Ok(magic)
}

/// Reads `count` values of `width` bytes, a block at a time.
///
/// Memory grows with the data that arrives. It is reserved at once only where `length_is_certain` states that the file
/// holds all values.
pub(super) fn read_values<T>(
    reader: &mut dyn Read,
    count: usize,
    width: usize,
    length_is_certain: bool,
    convert: impl Fn(&[u8]) -> T,
) -> io::Result<Vec<T>> {
    const BLOCK_VALUES: usize = 16 * 1024;
    let reserve = if length_is_certain { count } else { count.min(BLOCK_VALUES) };
    let mut values = Vec::new();
    values.try_reserve_exact(reserve).map_err(|_| io::ErrorKind::OutOfMemory)?;
    let mut block = vec![0; width * count.min(BLOCK_VALUES)];
    while values.len() < count {
        let wanted = width * (count - values.len()).min(BLOCK_VALUES);
        reader.read_exact(&mut block[..wanted])?;
        values.try_reserve(wanted / width).map_err(|_| io::ErrorKind::OutOfMemory)?;
        values.extend(block[..wanted].chunks_exact(width).map(&convert));
    }
    Ok(values)
}
