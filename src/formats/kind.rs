//! Recognition of file kinds by content, for error sentences about unexpected kinds.

use std::fmt::Write as _;
use std::io::Read;
use std::path::Path;

use flate2::read::GzDecoder;

use super::FormatError;
use super::bytes::open;
use crate::plural::counted;

/// Number of bytes read from the start of a file.
const HEAD_BYTES: u64 = 4096;
/// Records of CIFAR-10 and CIFAR-100: one or two labels and three planes of 32 x 32 px.
const CIFAR_10_RECORD: u64 = 1 + 3 * 1024;
const CIFAR_100_RECORD: u64 = 2 + 3 * 1024;

/// Kind of a file and the advice to make it readable.
#[derive(Debug, PartialEq, Eq)]
struct Kind {
    what: String,
    advice: &'static str,
}

fn kind(what: impl Into<String>, advice: &'static str) -> Kind {
    Kind { what: what.into(), advice }
}

/// The error of a file of another kind. It names the kind found and the advice.
///
/// For an unreadable file it states that instead.
pub fn named_for_what_it_is(path: &Path, expected: &str) -> FormatError {
    let head = || {
        let (file, length) = open(path)?;
        let mut head = Vec::new();
        file.take(HEAD_BYTES).read_to_end(&mut head).map_err(|error| FormatError::from_read(path, error))?;
        Ok((head, length))
    };
    match head() {
        Ok((head, length)) => {
            let Kind { what, advice } = kind_of(&head, length, path);
            FormatError::malformed(path, expected, what, advice)
        }
        Err(error) => error,
    }
}

/// Signatures at fixed offsets, each of one kind.
const SIGNATURES: &[(usize, &[u8], &str, &str)] = &[
    (0, b"\x93NUMPY", "a NumPy array (NPY)", NUMPY),
    (0, b"PK\x03\x04", "a zip archive", "unpack it first"),
    (0, b"\x89PNG", "a PNG image", IMAGE),
    (0, b"\xff\xd8\xff", "a JPEG image", IMAGE),
    (0, b"II*\0", "a TIFF image", IMAGE),
    (0, b"MM\0*", "a TIFF image", IMAGE),
    (0, b"II+\0", "a BigTIFF image", IMAGE),
    (0, b"MM\0+", "a BigTIFF image", IMAGE),
    (0, b"GIF8", "a GIF image", AS_PNG),
    (8, b"WEBP", "a WebP image", AS_PNG),
    (4, b"ftypheic", "a HEIC image", AS_PNG),
    (4, b"ftypmif1", "a HEIF image", AS_PNG),
    (4, b"ftypavif", "an AVIF image", AS_PNG),
    (4, b"ftypcrx", "a raw photograph (Canon CR3)", RAW),
    (4, b"ftyp", "a film (MP4 or MOV)", "save its frames as PNG or TIFF"),
    (0, b"\0\0\0\x0cjP  ", "a JPEG 2000 image", AS_PNG),
    (0, b"\xff\x4f\xff\x51", "a JPEG 2000 image", AS_PNG),
    (0, b"\xff\x0a", "a JPEG XL image", AS_PNG),
    (0, b"\0\0\0\x0cJXL ", "a JPEG XL image", AS_PNG),
    (0, b"8BPS", "a Photoshop image", AS_PNG),
    (0, b"\x76\x2f\x31\x01", "an OpenEXR image", AS_FLOAT),
    (0, b"#?RADIANCE", "a Radiance HDR image", AS_FLOAT),
    (0, b"FUJIFILMCCD-RAW", "a raw photograph (Fujifilm)", RAW),
    (0, b"IIRO", "a raw photograph (Olympus)", RAW),
    (0, b"IIU\0", "a raw photograph (Panasonic)", RAW),
    (0, b"SIMPLE  =", "a FITS file", "save its image with numpy.save or as TIFF"),
    (0, b"\x89HDF\r\n\x1a\n", "an HDF5 file", "save the array with numpy.save"),
    (0, b"CDF\x01", "a NetCDF file", "save the array with numpy.save"),
    (0, b"CDF\x02", "a NetCDF file", "save the array with numpy.save"),
    (0, b"MATLAB 5.0", "a MATLAB file", "save the array with scipy.io.loadmat and numpy.save"),
    (0, b"MATLAB 7.3", "a MATLAB file (HDF5)", "save the array with h5py and numpy.save"),
    (128, b"DICM", "a DICOM file", "save its image as TIFF"),
    (0, b"ZISRAWFILE", "a Zeiss CZI file", "save it as TIFF"),
    (0, b"\xda\xce\xbe\x0a", "a Nikon ND2 file", "save it as TIFF"),
    (0, b"BZh", "a file packed by bzip2", "unpack it first"),
    (0, b"\xfd7zXZ\0", "a file packed by xz", "unpack it first"),
    (0, b"\x28\xb5\x2f\xfd", "a file packed by zstd", "unpack it first"),
    (0, b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive", "unpack it first"),
    (0, b"Rar!", "a RAR archive", "unpack it first"),
    (257, b"ustar", "a tar archive", "unpack it first"),
    (0, b"%PDF", "a PDF document", AS_PNG),
    (0, b"RIFF", "a RIFF file (film or sound)", "save its frames as PNG or TIFF"),
    (0, b"\x1aE\xdf\xa3", "a film (Matroska or WebM)", "save its frames as PNG or TIFF"),
    (0, b"SQLite format 3", "an SQLite database", OTHER),
    (0, b"\x7fELF", "a program", OTHER),
    (0, b"MZ\x90\0", "a program", OTHER),
    (0, b"\0\x05\x16\x07", "what macOS keeps beside a file (its name begins with ._)", "take the file itself"),
];

const NUMPY: &str = "choose it where arrays are read";
const IMAGE: &str = "choose it where images are read";
const AS_FLOAT: &str = "save it as 32-bit float TIFF";
const AS_PNG: &str = "save it as PNG or TIFF";
const RAW: &str = "convert it to TIFF without changing its values";
const OTHER: &str = "choose another file";
/// Files of images in place of others of the same set.
const IMAGES_OF_IDX: &str = "use the file of the images, such as train-images-idx3-ubyte.gz";
const IMAGES_OF_3_AXES: &str = "use a file of images, which have 3";
const CIFAR: &str = "use the binary version of CIFAR-10 (data_batch_1.bin and the like)";

fn kind_of(head: &[u8], length: u64, path: &Path) -> Kind {
    if length == 0 {
        return kind("an empty file", "copy or download it again");
    }
    if head.starts_with(b"version https://git-lfs") {
        return kind("a Git LFS pointer, not the file that it stands for", "run git lfs pull");
    }
    if head.starts_with(&[0x1f, 0x8b]) {
        return packed(head);
    }
    let is_there = |&&(at, signature, ..): &&(usize, &[u8], &str, &str)| {
        head.get(at..).is_some_and(|rest| rest.starts_with(signature))
    };
    if let [0, 0, 0x08 | 0x09 | 0x0b..=0x0e, axes @ 1..=8, ..] = head {
        return match axes {
            1 => kind("IDX labels (1 axis)", IMAGES_OF_IDX),
            3 => kind("IDX images", "open them as idx:FILE"),
            axes => kind(format!("an IDX array of {axes} axes"), IMAGES_OF_3_AXES),
        };
    }
    if let Some((_, _, what, advice)) = SIGNATURES.iter().find(is_there) {
        return kind(*what, advice);
    }
    match head {
        [b'P', b'1'..=b'6', blank, ..] if blank.is_ascii_whitespace() => return kind("a PNM image", AS_PNG),
        [b'P', b'f' | b'F', blank, ..] if blank.is_ascii_whitespace() => return kind("a PFM image", AS_FLOAT),
        _ => {}
    }
    // Protocol 2 and later start with the opcode PROTO, the earlier ones with a dictionary, a list or the name of a class.
    let is_early =
        [&b"(dp"[..], b"(lp", b"}q\0", b"]q\0", b"cnumpy", b"ccopy_reg\n"].iter().any(|start| head.starts_with(start));
    if is_early || matches!(head, [0x80, 2..=5, ..]) {
        let of_cifar = [&b"batch_label"[..], b"fine_labels", b"label_names", b"data"]
            .iter()
            .any(|name| head.windows(name.len()).any(|part| part == *name));
        return if of_cifar {
            kind("a Python pickle, such as the Python version of CIFAR-10", CIFAR)
        } else {
            kind("a Python pickle", "save the array with numpy.save")
        };
    }
    if length.is_multiple_of(CIFAR_10_RECORD) && head[0] < 10 && path.extension().is_some_and(|ending| ending == "bin")
    {
        return kind("a CIFAR-10 binary batch", "open it as objects, cifar:FILE");
    }
    // The labels of the first two records stand in the head.
    let is_cifar = path.extension().is_some_and(|ending| ending == "bin")
        && [0, CIFAR_10_RECORD as usize].iter().all(|&record| head.get(record).is_some_and(|&label| label < 10));
    let is_cifar_100 = length.is_multiple_of(CIFAR_100_RECORD);
    if is_cifar && !is_cifar_100 && head.iter().any(|&byte| byte != 0) {
        let more = counted(length % CIFAR_10_RECORD, "byte");
        return kind(
            format!("what looks like a CIFAR-10 binary batch, with {more} behind its last image"),
            "download it again",
        );
    }
    if is_cifar_100 && head[0] < 20 && head.get(1).is_some_and(|&fine| fine < 100) {
        return kind("the size and labels of CIFAR-100", CIFAR);
    }
    match text_kind(head) {
        Some(kind) => kind,
        None if head.iter().all(|&byte| byte == 0) => {
            kind("nothing but zeros", "the copy or download was broken off; do it again")
        }
        None => {
            let mut start = String::new();
            head.iter().take(4).for_each(|byte| _ = write!(start, " {byte:02x}"));
            let ending = path.extension().map_or_else(String::new, |ending| format!(" .{}", ending.to_string_lossy()));
            kind(
                format!("an unknown{ending} file of {} that begins with{start}", counted(length, "byte")),
                "convert it first",
            )
        }
    }
}

/// Kind of the content of a gzip file.
fn packed(head: &[u8]) -> Kind {
    let mut inner = Vec::new();
    // The start of the file is cut at an arbitrary byte. So an error follows after the part that unpacks.
    let _ = GzDecoder::new(head).take(HEAD_BYTES).read_to_end(&mut inner);
    if inner.starts_with(&[0x1f, 0x8b]) {
        return kind("a file that was gzipped twice", "run gunzip on it once");
    }
    if inner.is_empty() {
        return kind("a damaged gzip file", "copy or download it again");
    }
    let inside = kind_of(&inner, inner.len() as u64, Path::new(""));
    // Unpacked it would not do either.
    let is_of_no_use = [IMAGES_OF_IDX, IMAGES_OF_3_AXES, CIFAR].contains(&inside.advice);
    let advice = if is_of_no_use { inside.advice } else { "run gunzip on it" };
    kind(format!("a gzip file with {} inside", inside.what), advice)
}

/// Kind of a text; `None` where it is not text.
fn text_kind(head: &[u8]) -> Option<Kind> {
    let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
    let valid = match str::from_utf8(head) {
        Ok(text) => text,
        // The last character may be cut.
        Err(error) if head.len() - error.valid_up_to() < 4 => str::from_utf8(&head[..error.valid_up_to()]).ok()?,
        Err(_) => return None,
    };
    if valid.is_empty() || valid.chars().any(|letter| letter.is_control() && !letter.is_whitespace()) {
        return None;
    }
    let start = valid.trim_start().chars().take(200).collect::<String>().to_lowercase();
    let numbers = start.lines().next().is_some_and(|line| {
        !line.is_empty() && line.chars().all(|letter| letter.is_ascii_digit() || "+-.,;e \t".contains(letter))
    });
    let starts = |beginnings: &[&str]| beginnings.iter().any(|beginning| start.starts_with(beginning));
    Some(if starts(&["<!doctype html", "<html", "<head", "<body"]) {
        kind("a web page", "download the file itself; a sign-in or quota page was saved in its place")
    } else if starts(&["<svg"]) || start.starts_with("<?xml") && valid.contains("<svg") {
        kind("an SVG drawing", AS_PNG)
    } else if starts(&["<?xml"]) {
        kind("an XML text", OTHER)
    } else if starts(&["{", "["]) {
        kind("a JSON text", "open it as a design, if it is one")
    } else if numbers {
        kind("a table of numbers as text", "save it with numpy.save(\"a.npy\", numpy.loadtxt(FILE))")
    } else if start.is_empty() {
        kind("nothing but blanks", OTHER)
    } else {
        kind("a text", OTHER)
    })
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn sentence_for(bytes: &[u8]) -> String {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        named_for_what_it_is(file.path(), "an image").to_string()
    }

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        packer.write_all(bytes).unwrap();
        packer.finish().unwrap()
    }

    #[test]
    fn files_are_named_for_what_they_are() {
        let labels = [&[0, 0, 8, 1, 0, 0, 0, 9][..], &[1; 9]].concat();
        let tar = [&[b'a'; 257][..], b"ustar"].concat();
        let cifar_100 = [&[19, 99][..], &[7; 3072]].concat().repeat(3);
        let cases: &[(&[u8], &str)] = &[
            (b"", "found an empty file; copy or download it again"),
            (b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n", "run git lfs pull"),
            (b"<!DOCTYPE html><html>Quota exceeded", "found a web page"),
            (b"\n  <HTML>", "found a web page"),
            (&labels, "found IDX labels (1 axis); use the file of the images"),
            (&gzip(&labels), "found a gzip file with IDX labels (1 axis) inside; use the file of the images"),
            (&gzip(&gzip(&labels)), "found a file that was gzipped twice; run gunzip on it once"),
            (&gzip(&tar), "found a gzip file with a tar archive inside; run gunzip on it"),
            (&cifar_100, "CIFAR-100"),
            (b"\x80\x02}q\0(X\x0b\0\0\0batch_labelq", "the Python version of CIFAR-10; use the binary version"),
            (b"\x80\x04K\x01.", "found a Python pickle; save the array with numpy.save"),
            (b"(dp1\nS'batch_label'\np2\nS'\\x01", "the Python version of CIFAR-10; use the binary version"),
            (b"cnumpy.core.multiarray\n_reconstruct\np0\n", "found a Python pickle; save the array"),
            (b"\x89HDF\r\n\x1a\n....", "found an HDF5 file"),
            (b"GIF89a", "found a GIF image; save it as PNG or TIFF"),
            (b"RIFF....WEBPVP8 ", "found a WebP image"),
            (b"....ftypheic", "found a HEIC image"),
            (b"%PDF-1.7", "found a PDF document"),
            (b"P5 28 28 255 ", "found a PNM image"),
            (b"P53 is a protein", "found a text"),
            (b"PFAS", "found a text"),
            (b"1.5, 2e-3\n3, 4\n", "a table of numbers as text"),
            (b"{\"format\": 1}", "found a JSON text"),
            ("ein sch\u{f6}ner Text".as_bytes(), "found a text"),
            (&[0; 100], "found nothing but zeros"),
            (&[1, 2, 3, 0xfe, 9], "an unknown file of 5 bytes that begins with 01 02 03 fe"),
            (&[0xfe], "an unknown file of 1 byte that begins with fe"),
        ];
        for (bytes, expected) in cases {
            let sentence = sentence_for(bytes);
            assert!(sentence.contains("expected an image, found") && sentence.contains(expected), "{sentence}");
        }
    }

    #[test]
    fn bytes_behind_the_records_of_cifar_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data_batch_1.bin");
        std::fs::write(&path, [&[7; 3 * 3073][..], &[0; 2]].concat()).unwrap();
        let sentence = named_for_what_it_is(&path, "images").to_string();
        assert!(sentence.contains("CIFAR-10 binary batch, with 2 bytes behind its last image; download"), "{sentence}");
    }

    #[test]
    fn a_missing_file_is_not_found() {
        let error = named_for_what_it_is(Path::new("/none/a.npy"), "an image");
        assert!(matches!(error, FormatError::NotFound { .. }), "{error}");
    }
}
