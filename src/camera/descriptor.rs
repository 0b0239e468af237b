//! Descriptor files of EMVA 1288: which frames were recorded at which exposure and light.
//!
//! Lines, each with a letter and its values (EMVA standard 1288, release 4.0, and its reference data):
//!
//! | line | meaning |
//! |---|---|
//! | `v 4.0` | version of the standard |
//! | `n bits width height` | bit depth, columns and rows of the frames |
//! | `b exposure photons` | the next frames have light: exposure in ns, mean photons per pixel (0 where unknown) |
//! | `d exposure` | the next frames are dark |
//! | `i path` | a frame; paths start at the folder of the descriptor, with `/` or `\` |
//! | `# text` | comment |

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::error::CameraError;
use super::series::{FrameGroup, FrameSeries, Grouping, exposure_text};
use crate::formats::{FormatError, Meaning, read_bytes, write_safely};

/// Largest size of a descriptor, bytes.
const LARGEST_BYTES: u64 = 16 << 20;
/// Version of the standard that is written.
const VERSION: &str = "4.0";
const LINES: &str = "a line v, n, b, d, i or # of an EMVA 1288 descriptor";

/// Reads a descriptor. Consecutive groups of equal exposure and light stay apart.
pub(super) fn read(path: &Path) -> Result<FrameSeries, CameraError> {
    let bytes = read_bytes(path, LARGEST_BYTES)?;
    let text = String::from_utf8_lossy(&bytes);
    let text = text.trim_start_matches('\u{feff}');
    if text.contains('\0') {
        let advice = "choose a folder of frames or a text file with lines b, d and i";
        return Err(FormatError::malformed(path, LINES, "a binary file", advice).into());
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut series = FrameSeries {
        path: path.to_path_buf(),
        grouping: Grouping::Descriptor,
        bits: None,
        shape: None,
        groups: Vec::new(),
        meaning: Meaning::default(),
        notes: Vec::new(),
    };
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        let wrong = |expected: &str| {
            let found = format!("{line:?} in line {}", index + 1);
            CameraError::from(FormatError::malformed(path, expected, found, "correct that line"))
        };
        let mut letters = line.chars();
        let (letter, rest) = match letters.next() {
            None | Some('#') => continue,
            Some(letter) => (letter, letters.as_str()),
        };
        if !rest.is_empty() && !rest.starts_with(char::is_whitespace) {
            return Err(wrong(LINES));
        }
        match letter.to_ascii_lowercase() {
            'v' => {}
            'n' => match numbers(rest)[..] {
                [Some(bits), Some(width), Some(height)]
                    if [bits, width, height].iter().all(|value| *value >= 1.0 && value.fract() == 0.0)
                        && bits <= 32.0 =>
                {
                    series.bits = Some(bits as u32);
                    series.shape = Some((height as usize, width as usize));
                }
                _ => return Err(wrong("n, the bit depth, width and height")),
            },
            'b' => match numbers(rest)[..] {
                [Some(exposure), Some(photons)] if exposure >= 0.0 && photons >= 0.0 => {
                    series.groups.push(group(false, exposure, photons));
                }
                _ => return Err(wrong("b, the exposure in ns and the photons (0 where unknown)")),
            },
            // Some programs write the photons of dark frames too, which are 0.
            'd' => match numbers(rest)[..] {
                [Some(exposure)] | [Some(exposure), Some(0.0)] if exposure >= 0.0 => {
                    series.groups.push(group(true, exposure, 0.0));
                }
                _ => return Err(wrong("d and the exposure in ns")),
            },
            'i' => {
                let group = series.groups.last_mut().ok_or_else(|| wrong("a line b or d before the first line i"))?;
                let named = rest.trim().trim_matches('"');
                if named.is_empty() {
                    return Err(wrong("i and the path of a frame"));
                }
                group.files.push(found(folder, named));
            }
            _ => return Err(wrong(LINES)),
        }
    }
    if let Some(empty) = series.groups.iter().find(|group| group.files.is_empty()) {
        let found = format!("none after {}", empty.label);
        return Err(
            FormatError::malformed(path, "lines i with frames", found, "add them or leave that line out").into()
        );
    }
    if series.groups.is_empty() {
        let advice = "choose a folder of frames or a text file with lines b, d and i";
        return Err(FormatError::malformed(path, LINES, "none", advice).into());
    }
    Ok(series)
}

fn group(is_dark: bool, exposure: f64, photons: f64) -> FrameGroup {
    let photons = (photons > 0.0).then_some(photons);
    let label = match photons {
        Some(photons) => format!("b {} {photons}", exposure_text(exposure)),
        None => format!("{} {}", if is_dark { "d" } else { "b" }, exposure_text(exposure)),
    };
    FrameGroup { label, is_dark, exposure_ns: Some(exposure), photons, files: Vec::new() }
}

/// The numbers of a line, `None` for what is no number. A decimal comma is one.
fn numbers(text: &str) -> Vec<Option<f64>> {
    let text = text.split('#').next().unwrap_or_default();
    let number = |word: &str| word.replace(',', ".").parse().ok().filter(|value: &f64| value.is_finite());
    text.split_whitespace().map(number).collect()
}

/// The file of a path in a descriptor, whose folders may be parted by backslashes.
///
/// A file that exists under the name as it stands has precedence. A path of another machine is looked for by its name beside
/// the descriptor.
fn found(folder: &Path, named: &str) -> PathBuf {
    let slashed = named.replace('\\', "/");
    let name = slashed.rsplit('/').next().unwrap_or_default();
    let places = [folder.join(named), folder.join(&slashed), folder.join(name)];
    let [_, by_default, _] = &places;
    places.iter().find(|place| place.is_file()).unwrap_or(by_default).clone()
}

/// Writes a descriptor. Paths start at its folder where they can.
pub(super) fn write(
    series: &FrameSeries,
    path: &Path,
    (rows, cols): (usize, usize),
    bits: u32,
) -> Result<(), CameraError> {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let folder = absolute(path).parent().map(Path::to_path_buf).unwrap_or_default();
    let mut text = format!("# Frames of {}\nv {VERSION}\nn {bits} {cols} {rows}\n", series.path.display());
    for group in &series.groups {
        let exposure = group.exposure_ns.unwrap_or(0.0);
        _ = match (group.is_dark, group.photons) {
            (true, _) => writeln!(text, "# {}\nd {exposure}", group.label),
            (false, photons) => writeln!(text, "# {}\nb {exposure} {}", group.label, photons.unwrap_or(0.0)),
        };
        for file in &group.files {
            let file = absolute(file);
            _ = writeln!(text, "i {}", file.strip_prefix(&folder).unwrap_or(&file).display());
        }
    }
    write_safely(path, |writer| writer.write_all(text.as_bytes()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<FrameSeries, CameraError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.txt");
        for file in ["light/a 1.tif", "b.tif", "dark.tif"] {
            std::fs::create_dir_all(folder.path().join("light")).unwrap();
            std::fs::write(folder.path().join(file), "").unwrap();
        }
        std::fs::write(&path, text).unwrap();
        let mut series = FrameSeries::open(&path)?;
        series.path = PathBuf::from("camera.txt");
        for file in series.groups.iter_mut().flat_map(|group| &mut group.files) {
            *file = file.strip_prefix(folder.path()).unwrap_or(file).to_path_buf();
        }
        Ok(series)
    }

    const TEXT: &str = "\u{feff}# a camera\r\nv 4.0\r\nn 12 640 480\r\n\r\nb 10000,5 1.5e3 # half\r\ni light\\a 1.tif\r\n\
                        i C:\\frames\\b.tif\r\nb 20000 0\r\ni light/none.tif\r\nd 10000.5\r\ni \"dark.tif\"\r\n";

    #[test]
    fn descriptors_are_read_with_either_slash_and_come_back_as_written() {
        let series = read_text(TEXT).unwrap();
        assert_eq!((series.bits, series.shape), (Some(12), Some((480, 640))));
        let [dark, half, full] = &series.groups[..] else { panic!("{series:?}") };
        assert!(dark.is_dark && dark.exposure_ns == Some(10000.5) && dark.files == [PathBuf::from("dark.tif")]);
        assert_eq!(half.files, ["light/a 1.tif", "b.tif"].map(PathBuf::from));
        assert_eq!((half.photons, full.photons, full.exposure_ns), (Some(1500.0), None, Some(20000.0)));
        assert_eq!(full.files, [PathBuf::from("light/none.tif")]);
        let lines = series.lines();
        assert_eq!(lines[0], "camera.txt: 3 groups by the lines of the descriptor");
        assert_eq!(lines[2], "  light b 10.0005 us 1500: 2 files, 10.0005 us, 1500 photons");

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("again.txt");
        let mut moved = series.clone();
        for file in moved.groups.iter_mut().flat_map(|group| &mut group.files) {
            *file = folder.path().join(&*file);
        }
        moved.write_descriptor(&path, (480, 640), 12).unwrap();
        let again = FrameSeries::open(&path).unwrap();
        assert_eq!((again.groups, again.bits, again.shape), (moved.groups, series.bits, series.shape));
    }

    #[test]
    fn wrong_lines_are_named() {
        for (text, expected) in [
            ("n 12 640\nd 1\ni a\nb 1 0\ni a", "bit depth, width and height, found \"n 12 640\" in line 1"),
            ("b 1\n", "the exposure in ns and the photons"),
            ("d -1\n", "d and the exposure"),
            ("d 1 x\n", "d and the exposure"),
            ("i a\n", "a line b or d before"),
            ("d 1\ni  \n", "the path of a frame"),
            ("x 1\n", "found \"x 1\" in line 1"),
            ("dark 1\n", "found \"dark 1\" in line 1"),
            ("d 1\nb 1 0\ni a", "found none after d 1 ns"),
            ("", "found none"),
            ("# nothing\n", "found none"),
            ("d 1\ni a\n\0", "a binary file"),
            ("b 1 0\ni a\n", "expected dark frames"),
            ("d 1\ni a\n", "a light level or more, found none"),
        ] {
            let error = read_text(text).unwrap_err().to_string();
            assert!(error.contains(expected) && !error.contains('\n'), "{text:?}: {error}");
        }
    }
}
