//! Images of a folder or file, as tiles of mosaics or as whole objects.

use std::path::Path;

use image::imageops::{FilterType, resize};
use image::{ImageBuffer, Luma};
use rayon::prelude::*;

use crate::formats::{FormatError, ImageFile, ImageSummary, PixelStack, Samples, image_files};
use crate::plural::{counted, one_or_many};
use crate::progress::Progress;

use super::ObjectError;
use super::clean::clean;
use super::set::{FileReport, ReadProgress, report_read};

/// Number of files read at a time.
const BATCH_FILES: usize = 8;
/// Largest number of pixels of images scaled to the field. All are in memory at the same time: 4 GiB.
const MOST_FITTED_PIXELS: usize = 1 << 30;
/// Largest number of files that a notice names.
const NAMED_FILES: usize = 5;

/// Images of a path, scaled for objects.
pub(super) enum Loaded {
    /// Tiles: all images are at most half the field.
    Tiles(Vec<PixelStack>),
    /// Whole images, scaled and cropped to the field.
    Whole(PixelStack),
}

/// Images of one file.
enum Item {
    /// At most half the field on both sides, unchanged.
    Small(PixelStack),
    /// Scaled and cropped to the field.
    Fitted(PixelStack),
}

impl Item {
    fn stack(&mut self) -> &mut PixelStack {
        match self {
            Self::Small(stack) | Self::Fitted(stack) => stack,
        }
    }
}

/// Reads the images of one file, or of a folder in the order of their names.
///
/// Unreadable files of a folder are left out and listed in `notices`.
pub(super) fn load(
    path: &Path,
    field: (usize, usize),
    report: &mut FileReport,
    progress: &mut dyn Progress<ReadProgress>,
) -> Result<Loaded, ObjectError> {
    let files = image_files(path)?;
    let is_folder = ImageFile::find(path)?.path.is_dir();
    let mut items = Vec::with_capacity(files.len());
    let (mut pages, mut has_fitted, mut cleaned) = (0_usize, false, Vec::new());
    let (mut understood, mut changed): (Option<ImageSummary>, Vec<String>) = (None, Vec::new());
    let mut unreadable: Vec<FormatError> = Vec::new();
    for (batch_index, batch) in files.chunks(BATCH_FILES).enumerate() {
        report_read(progress, &ReadProgress::files(batch_index * BATCH_FILES, files.len()))?;
        let read: Vec<Result<PixelStack, FormatError>> = batch.par_iter().map(ImageFile::read).collect();
        for (file, stack) in batch.iter().zip(read) {
            match stack {
                Ok(mut stack) => {
                    let summary = ImageSummary::of(&stack);
                    match &mut understood {
                        None => understood = Some(summary),
                        Some(understood) => understood.join(summary),
                    }
                    cleaned.extend(clean(&file.path, &mut stack)?);
                    pages = pages.saturating_add(stack.pages);
                    has_fitted |= !is_small(&stack, field);
                    // If one image is scaled to the field, all are.
                    if has_fitted && pages.saturating_mul(field.0 * field.1) > MOST_FITTED_PIXELS {
                        return Err(ObjectError::TooMany { count: pages, planes: 1, rows: field.0, cols: field.1 });
                    }
                    if !is_small(&stack, field) {
                        changed.extend(change(&stack, field));
                    }
                    items.push(item(stack, field));
                }
                Err(error) if !is_folder => return Err(error.into()),
                Err(error) => unreadable.push(error),
            }
        }
    }
    report_read(progress, &ReadProgress::files(files.len(), files.len()))?;
    if items.is_empty() {
        let found = match unreadable.first() {
            None => "none".into(),
            Some(first) => format!("{}, the first: {first}", counted(unreadable.len(), "unreadable one")),
        };
        let expected = "PNG, JPEG, TIFF, BMP, NPY or NPZ images";
        return Err(FormatError::malformed(path, expected, found, "choose a folder with images").into());
    }
    report.understood = understood.map(|understood| understood.to_string());
    let notices = &mut report.notices;
    let more = cleaned.len().saturating_sub(NAMED_FILES);
    notices.extend(cleaned.into_iter().take(NAMED_FILES));
    notices.extend((more > 0).then(|| format!("the same in {}", counted(more, "more file"))));
    if !unreadable.is_empty() {
        let names: Vec<String> = unreadable.iter().take(NAMED_FILES).map(|error| name_of(error.path())).collect();
        let more = if unreadable.len() > NAMED_FILES { " and others" } else { "" };
        notices.push(format!(
            "{} {} left out: {}{more}",
            counted(unreadable.len(), "unreadable file"),
            one_or_many(unreadable.len(), "was", "were"),
            names.join(", ")
        ));
    }
    notices.extend(mixed_levels(&mut items));
    notices.extend(same_white(&mut items));
    notices.extend(changes(&changed, has_fitted, field));
    Ok(combine(items, field))
}

/// Notice of floating-point images among integer ones: their range is unknown.
fn mixed_levels(items: &mut [Item]) -> Option<String> {
    let all = items.len();
    let floats = items.iter_mut().map(Item::stack).filter(|stack| stack.white.is_none()).count();
    (floats > 0 && floats < all).then(|| {
        format!(
            "{floats} of {all} files {} values without a range, taken as they are beside those of 8 or 16 bits",
            one_or_many(floats, "holds", "hold")
        )
    })
}

/// Scales 8-bit images among 16-bit ones to the same white level, with a notice.
fn same_white(items: &mut [Item]) -> Option<String> {
    let whites: Vec<Option<u16>> = items.iter_mut().map(|item| item.stack().white).collect();
    let (narrow, wide) = (Some(u16::from(u8::MAX)), Some(u16::MAX));
    if !(whites.contains(&narrow) && whites.contains(&wide)) {
        return None;
    }
    let factor = u16::MAX / u16::from(u8::MAX);
    let mut scaled = 0;
    for stack in items.iter_mut().map(Item::stack).filter(|stack| stack.white == narrow) {
        let samples = std::mem::replace(&mut stack.samples, Samples::U8(Vec::new()));
        (stack.samples, stack.white) = (samples.times(f32::from(factor)), wide);
        scaled += 1;
    }
    Some(format!(
        "{} {} brought to the range of the 16-bit ones among them (times {factor})",
        counted(scaled, "8-bit file"),
        one_or_many(scaled, "was", "were")
    ))
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Description of how images are changed to fit the field; `None` where they fit unchanged. It applies to images larger
/// than half the field, and to small ones among such images.
fn change(stack: &PixelStack, (rows, cols): (usize, usize)) -> Option<String> {
    let (crop_rows, crop_cols) = crop(stack, (rows, cols));
    let cropped = (crop_rows, crop_cols) != (stack.rows, stack.cols);
    let scaled = (crop_rows, crop_cols) != (rows, cols);
    let middle = format!("the middle {crop_rows} x {crop_cols} of {} x {} px", stack.rows, stack.cols);
    match (cropped, scaled) {
        (false, false) => None,
        (true, false) => Some(middle),
        (true, true) => Some(format!("{middle}, scaled to {rows} x {cols} px")),
        (false, true) => Some(format!("scaled from {} x {} px to {rows} x {cols} px", stack.rows, stack.cols)),
    }
}

/// Description of the changes of all files, in one sentence.
fn changes(changed: &[String], has_fitted: bool, (rows, cols): (usize, usize)) -> Option<String> {
    let (first, others) = changed.split_first().filter(|_| has_fitted)?;
    if others.iter().all(|other| other == first) {
        return Some(format!("objects are {first}"));
    }
    Some(format!("objects are the middles of images of several sizes, scaled to {rows} x {cols} px"))
}

fn is_small(stack: &PixelStack, field: (usize, usize)) -> bool {
    2 * stack.rows <= field.0 && 2 * stack.cols <= field.1
}

fn item(stack: PixelStack, field: (usize, usize)) -> Item {
    if is_small(&stack, field) { Item::Small(stack) } else { Item::Fitted(fit(stack, field)) }
}

fn combine(items: Vec<Item>, field: (usize, usize)) -> Loaded {
    if items.iter().all(|item| matches!(item, Item::Small(_))) {
        let small = items.into_iter().map(|item| match item {
            Item::Small(stack) | Item::Fitted(stack) => stack,
        });
        return Loaded::Tiles(small.collect());
    }
    let mut whole = PixelStack::new(0, field.0, field.1, Samples::U8(Vec::new()));
    for item in items {
        let stack = match item {
            Item::Small(stack) => fit(stack, field),
            Item::Fitted(stack) => stack,
        };
        whole.pages += stack.pages;
        whole.samples.append(stack.samples);
    }
    Loaded::Whole(whole)
}

/// Rows and columns of the central part with the aspect ratio of the field.
fn crop(stack: &PixelStack, (rows, cols): (usize, usize)) -> (usize, usize) {
    let scale = (rows as f64 / stack.rows as f64).max(cols as f64 / stack.cols as f64);
    let part = |length: usize, of: usize| ((length as f64 / scale).round() as usize).clamp(1, of);
    (part(rows, stack.rows), part(cols, stack.cols))
}

/// Crops the middle of each image to the aspect ratio of the field and scales it to the field. The triangle filter
/// averages over areas when it shrinks.
fn fit(stack: PixelStack, (rows, cols): (usize, usize)) -> PixelStack {
    if (stack.rows, stack.cols) == (rows, cols) {
        return stack;
    }
    let (crop_rows, crop_cols) = crop(&stack, (rows, cols));
    let (top, left) = ((stack.rows - crop_rows) / 2, (stack.cols - crop_cols) / 2);
    let mut values = Vec::with_capacity(stack.pages * rows * cols);
    for page in 0..stack.pages {
        let start = page * stack.rows * stack.cols;
        let value =
            |row: u32, col: u32| stack.samples.value(start + (top + row as usize) * stack.cols + left + col as usize);
        let (rows_u32, cols_u32) = (crop_rows as u32, crop_cols as u32);
        // The resizer clips floats to 0..1, so the values are scaled to that range and back.
        let largest = (0..rows_u32).flat_map(|row| (0..cols_u32).map(move |col| (row, col)));
        let largest = largest.map(|(row, col)| value(row, col)).fold(0.0, f32::max);
        if largest == 0.0 {
            values.resize(values.len() + rows * cols, 0.0);
            continue;
        }
        let unit =
            ImageBuffer::<Luma<f32>, _>::from_fn(cols_u32, rows_u32, |col, row| Luma([value(row, col) / largest]));
        let scaled = resize(&unit, cols as u32, rows as u32, FilterType::Triangle);
        values.extend(scaled.into_raw().into_iter().map(|value| value * largest));
    }
    PixelStack { rows, cols, samples: Samples::F32(values), ..stack }
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;
    use crate::objects::{ObjectOptions, ObjectSet, ObjectSource};

    fn image(rows: usize, cols: usize, value: impl Fn(usize, usize) -> f32) -> PixelStack {
        let samples = Samples::F32((0..rows * cols).map(|pixel| value(pixel / cols, pixel % cols)).collect());
        PixelStack::new(1, rows, cols, samples)
    }

    #[test]
    fn scaling_keeps_levels_orientation_and_the_middle() {
        let flat = fit(image(270, 480, |_, _| 300.0), (96, 96)).image(0);
        assert!(flat.dim() == (96, 96) && flat.iter().all(|value| (value - 300.0).abs() < 1e-3));
        // A ramp along the columns stays a ramp: 270 px scale to 96, and the middle column stays in the middle.
        let ramp = fit(image(270, 480, |_, col| col as f32), (96, 96)).image(0);
        let slope = (ramp[[50, 80]] - ramp[[50, 16]]) / 64.0;
        assert!((slope - 270.0 / 96.0).abs() < 0.01, "{slope}");
        assert!((f32::midpoint(ramp[[10, 47]], ramp[[10, 48]]) - 239.5).abs() < 0.01);
        assert!((ramp[[10, 30]] - ramp[[90, 30]]).abs() < 1e-3);
        let tall = fit(image(1, 30_000, |_, _| 2.0), (96, 64)).image(0);
        assert!(tall.dim() == (96, 64) && (tall.sum() - 2.0 * 96.0 * 64.0).abs() < 1.0);
    }

    #[test]
    fn white_is_white_whatever_the_depth_of_the_file() {
        let deep = |value: u16| item(PixelStack::new(1, 20, 20, Samples::U16(vec![value; 400])), (96, 96));
        let shallow = |side: usize| item(PixelStack::new(1, side, side, Samples::U8(vec![255; side * side])), (96, 96));
        let mut items = vec![shallow(20), deep(65_535), deep(300), shallow(60)];
        let report = same_white(&mut items).unwrap();
        assert_eq!(report, "2 8-bit files were brought to the range of the 16-bit ones among them (times 257)");
        let firsts: Vec<f32> = items.iter_mut().map(|item| item.stack().samples.value(0)).collect();
        assert_eq!(firsts, [65_535.0, 65_535.0, 300.0, 65_535.0]);
        assert_eq!(same_white(&mut [shallow(20), shallow(60)]), None);
        assert_eq!(same_white(&mut [deep(9), deep(5)]), None);
        let float = || item(image(20, 20, |_, _| 0.5), (96, 96));
        let report = mixed_levels(&mut [shallow(20), float(), deep(9)]).unwrap();
        assert!(report.starts_with("1 of 3 files holds values without a range"), "{report}");
        assert_eq!((mixed_levels(&mut [float(), float()]), mixed_levels(&mut [shallow(20), deep(9)])), (None, None));
    }

    #[test]
    fn small_images_are_tiles_unless_a_large_one_is_among_them() {
        let small = || item(image(48, 20, |_, _| 1.0), (96, 96));
        let large = || item(image(49, 20, |_, _| 1.0), (96, 96));
        assert!(matches!(combine(vec![small(), small()], (96, 96)), Loaded::Tiles(tiles) if tiles.len() == 2));
        let Loaded::Whole(whole) = combine(vec![small(), large()], (96, 96)) else { panic!("tiles") };
        assert_eq!((whole.pages, whole.rows, whole.cols, whole.samples.len()), (2, 96, 96, 2 * 96 * 96));
    }

    #[test]
    fn images_that_memory_cannot_hold_are_refused_before_they_are_scaled() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("many.npy");
        let pages = MOST_FITTED_PIXELS / (96 * 96) + 1;
        crate::formats::write_array(&path, ndarray::Array3::<f32>::ones((pages, 1, 49)).view()).unwrap();
        let opened = ObjectSet::open(&ObjectSource::Images(path), &ObjectOptions::default());
        let Err(error) = opened else { panic!("they were opened") };
        assert!(matches!(error, ObjectError::TooMany { count, .. } if count == pages), "{error}");
    }

    #[test]
    fn notices_of_many_files_stay_few() {
        let folder = tempfile::tempdir().unwrap();
        for number in 0..12 {
            let mut image = Array2::from_elem((8, 8), 50.0_f32);
            image[[0, 0]] = -0.01;
            crate::formats::write_array(&folder.path().join(format!("{number}.npy")), image.view()).unwrap();
        }
        let set =
            ObjectSet::open(&ObjectSource::Images(folder.path().to_path_buf()), &ObjectOptions::default()).unwrap();
        let notices = set.notices();
        assert_eq!((notices.len(), notices[5].as_str()), (6, "the same in 7 more files"));
    }
}
