//! Images of a folder or file, as tiles of mosaics or as whole objects.

use std::path::Path;

use rayon::prelude::*;

use crate::formats::{FormatError, GreyValues, ImageFile, ImageSummary, PixelStack, Samples, image_files, no_images};
use crate::plural::{counted, one_or_many};
use crate::progress::Progress;

use super::ObjectError;
use super::clean::{at_limits, clean};
use super::placement::Placement;
use super::set::{FileReport, ReadProgress, report_read};

/// Number of files read at a time.
const BATCH_FILES: usize = 8;
/// Largest number of pixels of images scaled to the field. All are in memory at the same time: 4 GiB.
const MOST_FITTED_PIXELS: usize = 1 << 30;
/// Largest number of files that a notice names.
const NAMED_FILES: usize = 5;

/// Size of the objects, and how larger images get it.
#[derive(Clone, Copy)]
pub(super) struct Size {
    /// Rows and columns in pixels.
    pub(super) field: (usize, usize),
    pub(super) placement: Placement,
}

impl Size {
    fn fit(self, stack: PixelStack) -> PixelStack {
        self.placement.fit(stack, self.field)
    }
}

/// Images of a path, in the size of objects.
pub(super) enum Loaded {
    /// Tiles: all images are at most half the field.
    Tiles(Vec<PixelStack>),
    /// Whole images in the size of the field.
    Whole(PixelStack),
}

/// Images of one file.
enum Item {
    /// At most half the field on both sides, unchanged.
    Small(PixelStack),
    /// In the size of the field.
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
    size: Size,
    report: &mut FileReport,
    progress: &mut dyn Progress<ReadProgress>,
) -> Result<Loaded, ObjectError> {
    let field = size.field;
    let files = image_files(path)?;
    let is_folder = ImageFile::find(path)?.path.is_dir();
    let mut items = Vec::with_capacity(files.len());
    let (mut pages, mut has_fitted, mut cleaned) = (0_usize, false, Vec::new());
    let (mut understood, mut changed): (Option<ImageSummary>, Vec<String>) = (None, Vec::new());
    let (mut unreadable, mut values): (Vec<FormatError>, GreyValues) = (Vec::new(), GreyValues::default());
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
                    values.add_stack(&stack);
                    cleaned.extend(clean(&file.path, &mut stack)?);
                    pages = pages.saturating_add(stack.pages);
                    has_fitted |= !is_small(&stack, field);
                    // If one image is scaled to the field, all are.
                    if has_fitted && pages.saturating_mul(field.0 * field.1) > MOST_FITTED_PIXELS {
                        return Err(ObjectError::TooMany { count: pages, planes: 1, rows: field.0, cols: field.1 });
                    }
                    if !is_small(&stack, field) {
                        changed.extend(size.placement.change(&stack, field));
                    }
                    items.push(item(stack, size));
                }
                Err(error) if !is_folder => return Err(error.into()),
                Err(error) => unreadable.push(error),
            }
        }
    }
    report_read(progress, &ReadProgress::files(files.len(), files.len()))?;
    if items.is_empty() {
        let Some(first) = unreadable.first() else { return Err(no_images(path).into()) };
        let found = format!("{}, the first: {first}", counted(unreadable.len(), "unreadable one"));
        let expected = "PNG, JPEG, TIFF, BMP, NPY or NPZ images";
        return Err(FormatError::malformed(path, expected, found, "choose a folder with images").into());
    }
    report.understood = understood.map(|understood| understood.to_string());
    let notices = &mut report.notices;
    notices.extend(at_limits(&values));
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
    notices.extend(changes(&changed, has_fitted, size));
    Ok(combine(items, size))
}

/// Reads the images of one file.
pub(super) fn one_file(
    path: &Path,
    read: impl Fn(&Path) -> Result<PixelStack, FormatError>,
    report: &mut FileReport,
    progress: &mut dyn Progress<ReadProgress>,
) -> Result<PixelStack, ObjectError> {
    report_read(progress, &ReadProgress::files(0, 1))?;
    let mut stack = read(path)?;
    report.understood = Some(ImageSummary::of(&stack).to_string());
    report.notices.extend(clean(path, &mut stack)?);
    report_read(progress, &ReadProgress::files(1, 1))?;
    Ok(stack)
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

/// Description of the changes of all files, in one sentence.
fn changes(changed: &[String], has_fitted: bool, size: Size) -> Option<String> {
    let (first, others) = changed.split_first().filter(|_| has_fitted)?;
    if others.iter().all(|other| other == first) {
        return Some(format!("objects are {first}"));
    }
    Some(format!("objects are {}", size.placement.change_of_several(size.field)))
}

fn is_small(stack: &PixelStack, field: (usize, usize)) -> bool {
    2 * stack.rows <= field.0 && 2 * stack.cols <= field.1
}

fn item(stack: PixelStack, size: Size) -> Item {
    if is_small(&stack, size.field) { Item::Small(stack) } else { Item::Fitted(size.fit(stack)) }
}

fn combine(items: Vec<Item>, size: Size) -> Loaded {
    if items.iter().all(|item| matches!(item, Item::Small(_))) {
        let small = items.into_iter().map(|item| match item {
            Item::Small(stack) | Item::Fitted(stack) => stack,
        });
        return Loaded::Tiles(small.collect());
    }
    let mut whole = PixelStack::new(0, size.field.0, size.field.1, Samples::U8(Vec::new()));
    for item in items {
        let stack = match item {
            Item::Small(stack) => size.fit(stack),
            Item::Fitted(stack) => stack,
        };
        whole.pages += stack.pages;
        whole.samples.append(stack.samples);
    }
    Loaded::Whole(whole)
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;
    use crate::objects::{ObjectOptions, ObjectSet, ObjectSource};

    const SIZE: Size = Size { field: (96, 96), placement: Placement::Scaled };

    fn image(rows: usize, cols: usize, value: impl Fn(usize, usize) -> f32) -> PixelStack {
        let samples = Samples::F32((0..rows * cols).map(|pixel| value(pixel / cols, pixel % cols)).collect());
        PixelStack::new(1, rows, cols, samples)
    }

    #[test]
    fn white_is_white_whatever_the_depth_of_the_file() {
        let deep = |value: u16| item(PixelStack::new(1, 20, 20, Samples::U16(vec![value; 400])), SIZE);
        let shallow = |side: usize| item(PixelStack::new(1, side, side, Samples::U8(vec![255; side * side])), SIZE);
        let mut items = vec![shallow(20), deep(65_535), deep(300), shallow(60)];
        let report = same_white(&mut items).unwrap();
        assert_eq!(report, "2 8-bit files were brought to the range of the 16-bit ones among them (times 257)");
        let firsts: Vec<f32> = items.iter_mut().map(|item| item.stack().samples.value(0)).collect();
        assert_eq!(firsts, [65_535.0, 65_535.0, 300.0, 65_535.0]);
        assert_eq!(same_white(&mut [shallow(20), shallow(60)]), None);
        assert_eq!(same_white(&mut [deep(9), deep(5)]), None);
        let float = || item(image(20, 20, |_, _| 0.5), SIZE);
        let report = mixed_levels(&mut [shallow(20), float(), deep(9)]).unwrap();
        assert!(report.starts_with("1 of 3 files holds values without a range"), "{report}");
        assert_eq!((mixed_levels(&mut [float(), float()]), mixed_levels(&mut [shallow(20), deep(9)])), (None, None));
    }

    #[test]
    fn small_images_are_tiles_unless_a_large_one_is_among_them() {
        let small = || item(image(48, 20, |_, _| 1.0), SIZE);
        let large = || item(image(49, 20, |_, _| 1.0), SIZE);
        assert!(matches!(combine(vec![small(), small()], SIZE), Loaded::Tiles(tiles) if tiles.len() == 2));
        let Loaded::Whole(whole) = combine(vec![small(), large()], SIZE) else { panic!("tiles") };
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
    fn saturated_and_wrapped_pixels_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let notices = |value: &dyn Fn(usize) -> f32| {
            let images = ndarray::Array3::from_shape_fn((3, 20, 20), |(n, row, col)| value(400 * n + 20 * row + col));
            crate::formats::write_array(&path, images.view()).unwrap();
            let set = ObjectSet::open(&ObjectSource::Stack(path.clone()), &ObjectOptions::default()).unwrap();
            set.notices().join("\n")
        };
        let saturated = notices(&|pixel| ((pixel * 37 % 400) as f32).min(255.0));
        assert!(saturated.contains("36.2 % of the pixels are at 255, the largest value"), "{saturated}");
        let wrapped = notices(&|pixel| ((pixel % 21) as f32 - 2.0).rem_euclid(65_536.0));
        assert!(wrapped.contains("negative values wrapped around zero"), "{wrapped}");
        let sound = notices(&|pixel| (pixel % 200) as f32);
        assert!(!sound.contains("largest value") && !sound.contains("wrapped"), "{sound}");
    }

    #[test]
    fn notices_of_many_files_stay_few() {
        let folder = tempfile::tempdir().unwrap();
        for number in 0..12 {
            let mut image = Array2::from_shape_fn((8, 8), |(row, col)| 50.0 + (row * 8 + col) as f32);
            image[[0, 0]] = -0.01;
            crate::formats::write_array(&folder.path().join(format!("{number}.npy")), image.view()).unwrap();
        }
        let set =
            ObjectSet::open(&ObjectSource::Images(folder.path().to_path_buf()), &ObjectOptions::default()).unwrap();
        let notices = set.notices();
        assert_eq!((notices.len(), notices[5].as_str()), (6, "the same in 7 more files"));
    }
}
