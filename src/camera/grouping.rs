//! Groups of equal light in a folder of frames, by sub-folders or by file names.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::error::CameraError;
use super::exposure::{NamedExposure, exposure_in, resolved};
use super::series::{FrameGroup, FrameSeries, Grouping};
use crate::formats::{FormatError, ImageFile, image_files};

/// Words in the name of a group without light.
const DARK: [&str; 3] = ["dark", "bias", "black"];

/// Finds the groups of a folder.
pub(super) fn group(folder: &ImageFile) -> Result<FrameSeries, CameraError> {
    let folders = sub_folders(&folder.path)?;
    let own = files_of(&folder.path)?;
    let mut found: Vec<(FrameGroup, Option<NamedExposure>)> = Vec::new();
    for sub_folder in &folders {
        let files = files_of(sub_folder)?;
        let name = name_of(sub_folder);
        let deeper = sub_folders(sub_folder)?;
        for inner in &deeper {
            let label = format!("{name}/{}", name_of(inner));
            found.extend(named(&label, &label, files_of(inner)?));
        }
        let mut parts = by_name(&files);
        // Names that leave a frame alone count frames, not groups.
        if parts.values().any(|files| files.len() < 2 && !is_stack(files)) {
            parts = BTreeMap::from([(String::new(), files)]);
        }
        let several = parts.len() > 1;
        found.extend(parts.into_iter().filter_map(|(part, files)| {
            let full = format!("{name}/{part}");
            named(if several { &full } else { &name }, &full, files)
        }));
    }
    let grouping = if found.is_empty() { Grouping::Names } else { Grouping::Folders };
    found.extend(by_name(&own).into_iter().filter_map(|(part, files)| named(&part, &part, files)));
    let (mut groups, exposures): (Vec<FrameGroup>, Vec<Option<NamedExposure>>) = found.into_iter().unzip();
    let (exposures, note) = resolved(&exposures);
    groups.iter_mut().zip(exposures).for_each(|(group, exposure_ns)| group.exposure_ns = exposure_ns);
    let (path, meaning, notes) = (folder.path.clone(), folder.meaning.clone(), note.into_iter().collect());
    Ok(FrameSeries { path, grouping, bits: None, shape: None, groups, meaning, notes })
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Sub-folders in the order of their names, without hidden ones.
fn sub_folders(folder: &Path) -> Result<Vec<PathBuf>, FormatError> {
    let failed = |error| FormatError::from_read(folder, error);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() && !name_of(&path).starts_with('.') {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Image files of a folder.
fn files_of(folder: &Path) -> Result<Vec<PathBuf>, FormatError> {
    Ok(image_files(folder)?.into_iter().map(|file| file.path).collect())
}

/// Files by the common beginning of their names. Where the files hold several frames each, every file is a group.
fn by_name(files: &[PathBuf]) -> BTreeMap<String, Vec<PathBuf>> {
    let each_is_group = files.len() > 1 && is_stack(&files[..1]);
    let mut groups: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for file in files {
        let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let key = if each_is_group { stem } else { beginning(&stem).to_owned() };
        groups.entry(key).or_default().push(file.clone());
    }
    groups
}

/// Whether a single file holds several frames.
fn is_stack(files: &[PathBuf]) -> bool {
    let [file] = files else { return false };
    ImageFile::find(file).and_then(|file| file.read()).is_ok_and(|stack| stack.pages > 1)
}

/// A name without its last number or letter and the signs before it: `level_03_b` and `level_03_2` begin `level_03`.
fn beginning(stem: &str) -> &str {
    let is_sign = |letter: char| matches!(letter, '_' | '-' | '.' | ' ' | '(' | ')' | '#');
    let stem = stem.trim_end_matches(is_sign);
    let digits = stem.trim_end_matches(|letter: char| letter.is_ascii_digit());
    if digits.len() < stem.len() {
        return digits.trim_end_matches(is_sign);
    }
    // One letter behind a sign or a digit counts frames too.
    let mut letters = stem.char_indices().rev();
    match (letters.next(), letters.next()) {
        (Some((at, last)), Some((_, before)))
            if last.is_alphabetic() && (is_sign(before) || before.is_ascii_digit()) =>
        {
            stem[..at].trim_end_matches(is_sign)
        }
        _ => stem,
    }
}

/// The group of these files, and the exposure in its `full` name; `None` without files.
fn named(label: &str, full: &str, files: Vec<PathBuf>) -> Option<(FrameGroup, Option<NamedExposure>)> {
    let lower = full.to_lowercase();
    let is_dark = DARK.iter().any(|word| lower.contains(word));
    let label = if label.is_empty() { "frames".to_owned() } else { label.to_owned() };
    let group = FrameGroup { label, is_dark, exposure_ns: None, photons: None, files };
    (!group.files.is_empty()).then(|| (group, exposure_in(&lower)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::write_array;

    fn groups(files: &[&str], frames: usize) -> Vec<(String, usize, bool)> {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            write_array(&path, ndarray::Array3::<f32>::zeros((frames, 8, 9)).view()).unwrap();
        }
        let series = FrameSeries::open(folder.path()).unwrap();
        series.groups.into_iter().map(|group| (group.label, group.files.len(), group.is_dark)).collect()
    }

    fn of(label: &str, files: usize, is_dark: bool) -> (String, usize, bool) {
        (label.to_owned(), files, is_dark)
    }

    #[test]
    fn sub_folders_are_groups() {
        let files = ["l1/a.npy", "l1/b.npy", "Dark/x_1.npy", "Dark/x_2.npy", ".hidden/a.npy", "l2/1.npy", "l2/2.npy"];
        assert_eq!(groups(&files, 1), [of("Dark", 2, true), of("l1", 2, false), of("l2", 2, false)]);
        let parts = [
            "dark/1ms_1.npy",
            "dark/1ms_2.npy",
            "dark/2ms_1.npy",
            "dark/2ms_2.npy",
            "light/1ms_a.npy",
            "light/1ms_b.npy",
        ];
        assert_eq!(groups(&parts, 1), [of("dark/1ms", 2, true), of("dark/2ms", 2, true), of("light", 2, false)]);
        let nested = ["dark/10ms/1.npy", "dark/10ms/2.npy", "light/10ms/1.npy", "light/10ms/2.npy"];
        assert_eq!(groups(&nested, 1), [of("dark/10ms", 2, true), of("light/10ms", 2, false)]);
        // Times of day count frames.
        let times = ["dark/12-01-01.npy", "dark/12-01-02.npy", "dark/12-02-01.npy", "l/1.npy", "l/2.npy"];
        assert_eq!(groups(&times, 1)[0], of("dark", 3, true));
    }

    #[test]
    fn files_whose_names_begin_alike_are_groups() {
        let files =
            ["dark_1.npy", "dark_2.npy", "dark_3.npy", "level_01_a.npy", "level_01_b.npy", "l02a.npy", "l02b.npy"];
        assert_eq!(groups(&files, 1), [of("dark", 3, true), of("l02", 2, false), of("level_01", 2, false)]);
        let stacks = ["dark.npy", "level_01.npy", "level_02.npy"];
        assert_eq!(groups(&stacks, 4), [of("dark", 1, true), of("level_01", 1, false), of("level_02", 1, false)]);
    }

    #[test]
    fn exposures_with_a_decimal_comma_and_fractions_are_those_of_the_groups() {
        let exposures = |names: &[&str]| {
            let folder = tempfile::tempdir().unwrap();
            for name in names {
                std::fs::create_dir(folder.path().join(name)).unwrap();
                for file in ["1.npy", "2.npy"] {
                    let frame = ndarray::Array2::<f32>::zeros((8, 9));
                    write_array(&folder.path().join(name).join(file), frame.view()).unwrap();
                }
            }
            let series = FrameSeries::open(folder.path()).unwrap();
            (series.groups.iter().map(|group| group.exposure_ns).collect::<Vec<_>>(), series.notes)
        };
        let comma = exposures(&["dark 0,5ms", "light 0,5ms", "light 1,0ms"]);
        assert_eq!(comma, (vec![Some(5e5), Some(5e5), Some(1e6)], Vec::new()));
        let fractions = exposures(&["dark 1_100s", "light 1_100s", "light 1_50s"]);
        assert_eq!(fractions, (vec![Some(1e7), Some(1e7), Some(2e7)], Vec::new()));
        let (unknown, notes) = exposures(&["dark 1_100s", "light 1_100s"]);
        assert_eq!((unknown, notes.len()), (vec![None, None], 1));
    }
}
