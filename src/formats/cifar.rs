//! CIFAR-10 binary batches (Krizhevsky 2009).

use std::io::Read;
use std::path::Path;

use super::bytes::open;
use super::kind::named_for_what_it_is;
use super::{FormatError, ImageFile, PixelStack, Samples};

/// Rows and columns of a CIFAR image, px.
const SIDE: usize = 32;
const PLANE: usize = SIDE * SIDE;
/// Size of a record: one label byte, then red, green and blue planes.
const RECORD_BYTES: usize = 1 + 3 * PLANE;
const ADVICE: &str = "use the binary version of CIFAR-10 (data_batch_1.bin and the like)";

/// Reads a CIFAR-10 binary batch as grey images of 32 x 32 px (Rec. 709 luma, counts of 0 to 255).
///
/// # Errors
/// [`FormatError`] if the file is missing, or is not a whole number of records of 3073 bytes with labels of 0 to 9.
pub fn read_cifar(path: &Path) -> Result<PixelStack, FormatError> {
    ImageFile::find(path)?.read_cifar()
}

impl ImageFile {
    /// Reads the file as a CIFAR-10 binary batch. The format has no signature, so the caller chooses it.
    ///
    /// # Errors
    /// As [`read_cifar`].
    pub fn read_cifar(&self) -> Result<PixelStack, FormatError> {
        read(self)
    }
}

fn read(found: &ImageFile) -> Result<PixelStack, FormatError> {
    let path = &found.path;
    found.check_options(false, false)?;
    let (mut file, length) = open(path)?;
    if length == 0 || length % RECORD_BYTES as u64 != 0 {
        let expected = format!("a CIFAR-10 binary batch (records of {RECORD_BYTES} bytes)");
        return Err(named_for_what_it_is(path, &expected));
    }
    let pages = (length / RECORD_BYTES as u64) as usize;
    let mut colours = Vec::new();
    let failed = |error| FormatError::from_read(path, error);
    colours.try_reserve_exact(pages * 3 * PLANE).map_err(|_| failed(std::io::ErrorKind::OutOfMemory.into()))?;
    let mut record = [0; RECORD_BYTES];
    for page in 0..pages {
        file.read_exact(&mut record).map_err(failed)?;
        let [label, planes @ ..] = &record;
        if *label > 9 {
            let wrong = format!("label {label} in record {}", page + 1);
            return Err(FormatError::malformed(path, "labels of 0 to 9", wrong, ADVICE));
        }
        colours.extend((0..PLANE).flat_map(|pixel| [0, 1, 2].map(|plane| planes[plane * PLANE + pixel])));
    }
    found.chosen_frame(PixelStack::interleaved(found, [pages, SIDE, SIDE], Samples::U8(colours), 3)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_red_green_blue_and_rows_come_first() {
        let mut bytes = vec![0; 2 * RECORD_BYTES];
        bytes[RECORD_BYTES] = 9;
        bytes[RECORD_BYTES + 1 + SIDE + 2] = 100;
        bytes[RECORD_BYTES + 1 + PLANE + 2 * SIDE] = 100;
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), &bytes).unwrap();
        let images = read_cifar(file.path()).unwrap();
        assert_eq!(images.pages, 2);
        let second = images.image(1);
        assert!((second[[1, 2]] - 21.26).abs() < 1e-5 && (second[[2, 0]] - 71.52).abs() < 1e-5);
        assert!((second.sum() - 92.78).abs() < 1e-4 && images.image(0).sum() == 0.0);
    }

    #[test]
    fn a_part_of_a_record_and_a_foreign_label_are_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        for (bytes, expected) in [
            (vec![0; RECORD_BYTES + 1], "the size and labels of CIFAR-100"),
            (vec![0; RECORD_BYTES + 2], "nothing but zeros"),
            (vec![10; RECORD_BYTES], "label 10 in record 1"),
        ] {
            std::fs::write(file.path(), bytes).unwrap();
            assert!(read_cifar(file.path()).unwrap_err().to_string().contains(expected));
        }
    }
}
