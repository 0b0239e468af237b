//! Whatever file holds images, as grey pages.

use std::path::Path;

use ndarray::Array3;

use super::bytes::magic;
use super::kind::named_for_what_it_is;
use super::{FormatError, ImageFile, PixelStack, Samples, Understood, idx, npy, npz, picture, tiff_pages};
use crate::plural::counted;

/// The first two axes of a colour picture are longer than this, so that a stack of a few narrow pages is not one.
const COLOUR_PICTURE_PX: usize = 4;
/// Files that are read, for messages.
const KINDS: &str = "an NPY, NPZ, TIFF, PNG, JPEG, BMP or IDX file";

/// An array of a file before its axes have a meaning.
pub(super) struct RawArray {
    /// Its axes.
    pub(super) shape: Vec<usize>,
    /// Its values, row-major.
    pub(super) samples: Samples,
    /// Name, number type and notes.
    pub(super) understood: Understood,
}

/// Reads a file of pictures as grey pages of shape (pages, rows, cols), in the counts of the file.
///
/// The first bytes, not the name, tell the kind: NPY, NPZ, TIFF (all pages), PNG, JPEG, BMP, IDX (gzipped, too). The
/// path may tell what the file means: see [`ImageFile::find`]. Axes of arrays, unless told otherwise: (rows, cols),
/// (images, rows, cols), (rows, cols, 1), (rows, cols, 3 or 4) colour with rows and cols above 4, (images, rows, cols,
/// 3 or 4) colour; other axes of length 1 are left out. Colour becomes Rec. 709 luma.
///
/// # Errors
/// [`FormatError`] if the file is missing, damaged, of another kind, or an array of other axes.
pub fn read_picture_or_array(path: &Path) -> Result<Array3<f32>, FormatError> {
    Ok(read_stack(path)?.into_array())
}

/// [`read_picture_or_array`] in the number type of the file, with what was understood.
pub fn read_stack(path: &Path) -> Result<PixelStack, FormatError> {
    ImageFile::find(path)?.read()
}

pub(super) fn read(file: &ImageFile) -> Result<PixelStack, FormatError> {
    let path = &file.path;
    let is_array = |axes: RawArray| from_array(file, axes);
    let stack = match magic::<4>(path)? {
        [0x93, b'N', b'U', b'M'] => is_array(npy::read_raw(path)?)?,
        [b'P', b'K', 3 | 5, 4 | 6] => is_array(npz::read_raw(path, file.meaning.key.as_deref())?)?,
        [b'I', b'I', 42 | 43, 0] | [b'M', b'M', 0, 42 | 43] => {
            tiff_pages::read_equal_pages(path, file.meaning.channel)?
        }
        [0x89, b'P', b'N', b'G'] | [0xFF, 0xD8, 0xFF, _] | [b'B', b'M', ..] => {
            picture::read_page(path, file.meaning.channel)?
        }
        [0, 0, _, 3] => idx::read_images(path)?,
        [0x1f, 0x8b, ..] if idx::is_packed_images(path) => idx::read_images(path)?,
        _ => return Err(named_for_what_it_is(path, KINDS)),
    };
    restrict(file, stack)
}

/// Takes the image that was asked for alone, and refuses what has no meaning for the file.
pub(super) fn restrict(file: &ImageFile, stack: PixelStack) -> Result<PixelStack, FormatError> {
    let start = magic::<4>(&file.path)?;
    let (is_npy, is_npz) = (start == *b"\x93NUM", start[..2] == *b"PK");
    if file.meaning.axis.is_some() && !(is_npy || is_npz) {
        return Err(file.cannot_mean("axis", "a file that is no array"));
    }
    if file.meaning.key.is_some() && !is_npz {
        return Err(file.cannot_mean("key", "a file that is no archive of arrays"));
    }
    match file.meaning.frame {
        None => Ok(stack),
        Some(frame) if frame <= stack.pages => Ok(stack.only(frame - 1)),
        Some(frame) => {
            let expected = format!("image {frame}, as ?frame={frame} asks for");
            Err(FormatError::malformed(&file.path, expected, counted(stack.pages, "image"), "choose another"))
        }
    }
}

/// Gives the axes of an array their meaning.
fn from_array(file: &ImageFile, array: RawArray) -> Result<PixelStack, FormatError> {
    let RawArray { shape, samples, understood } = array;
    let meaning = &file.meaning;
    let refuse = |advice: &str| {
        let expected = "an array of shape (rows, cols), (images, rows, cols) or (rows, cols, 3)";
        Err(FormatError::malformed(&file.path, expected, format!("shape {shape:?}"), advice))
    };
    let chosen = match meaning.axis.map(|axis| axis.index(shape.len())) {
        Some(None) => return refuse("correct the number behind ?axis="),
        Some(index) => index,
        None => None,
    };
    // Axes by their numbers in the file, those of one layer left out.
    let mut axes: Vec<usize> = (0..shape.len()).collect();
    while axes.len() > 3
        && let Some(layer) = axes.iter().position(|&axis| shape[axis] == 1 && Some(axis) != chosen)
    {
        axes.remove(layer);
    }
    if let ([_, _, last], None) = (axes.as_slice(), chosen)
        && shape[*last] == 1
    {
        axes.pop();
    }
    // The axis that counts images comes first, that of colours last.
    let frames = chosen.and_then(|chosen| axes.iter().position(|&axis| axis == chosen)).map(|at| axes.remove(at));
    let length = |at: usize| axes.get(at).map_or(0, |&axis| shape[axis]);
    let is_wide = |one: usize, other: usize| length(one).min(length(other)) > COLOUR_PICTURE_PX;
    let is_colour = |at: usize| matches!(length(at), 3 | 4) || (meaning.channel.is_some() && length(at) == 2);
    let (frames, colours) = match (axes.len(), frames) {
        (2, frames) => (frames, None),
        (3, frames) if is_colour(2) && (is_wide(0, 1) || frames.is_some() || meaning.channel.is_some()) => {
            (frames, Some(2))
        }
        (3, frames) if meaning.channel.is_some() && is_colour(0) => (frames, Some(0)),
        (3, None) if meaning.channel.is_none() => (Some(axes[0]), None),
        (4, None) if is_colour(3) => (Some(axes[0]), Some(3)),
        (4, None) if meaning.channel.is_some() && is_colour(1) => (Some(axes[0]), Some(1)),
        (4, None) if is_colour(1) => {
            return refuse("add ?channel=luma or ?channel=1 if axis 2 holds colours, or reshape it");
        }
        (3 | 4, _) => return refuse("reshape it, or tell by ?axis=last or ?axis=2 which axis counts images"),
        _ => return refuse("reshape it to one of these"),
    };
    let colours = colours.map(|at| axes[at]);
    let rest: Vec<usize> = axes.iter().copied().filter(|&axis| Some(axis) != frames && Some(axis) != colours).collect();
    let &[rows, cols] = rest.as_slice() else { return refuse("reshape it first") };
    let left_out = (0..shape.len()).filter(|axis| !axes.contains(axis) && Some(*axis) != frames);
    let order: Vec<usize> = left_out.chain(frames).chain([rows, cols]).chain(colours).collect();
    let samples = if order.is_sorted() { samples } else { samples.permuted(&shape, &order) };
    let channels = colours.map_or(1, |axis| shape[axis]);
    let size = (frames.map_or(1, |axis| shape[axis]), shape[rows], shape[cols]);
    let mut stack = PixelStack::interleaved(size, samples, channels, meaning.channel).map_err(|found| {
        FormatError::malformed(&file.path, "the channel that ?channel= names", found, "choose another")
    })?;
    // A single layer counts nothing, unless it was told to.
    stack.understood.axis = frames.filter(|&axis| shape[axis] != 1 || chosen.is_some()).map(|axis| axis + 1);
    stack.understood.key = understood.key;
    stack.understood.numbers = understood.numbers.or(stack.understood.numbers);
    if let Some(colours) = colours {
        stack.note(format!("axis {} holds colours", colours + 1));
    }
    for note in understood.notes {
        stack.note(note);
    }
    let last = shape.len() - 1;
    let is_guess = meaning.axis.is_none() && frames == Some(0) && shape.len() == 3 && colours.is_none();
    if is_guess && shape[last] < shape[0].min(shape[1]) {
        stack.note(format!("if axis {} counts them, add ?axis=last", last + 1));
    }
    if is_guess {
        stack.understood.choices.extend(["axis=2", "axis=last"].map(Into::into));
    }
    if meaning.axis.is_none() && meaning.channel.is_none() && shape.len() == 3 && colours == Some(last) {
        stack.note("if the last axis counts images, add ?axis=last");
        stack.understood.choices.push("axis=last".into());
    }
    Ok(stack)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::{ImageSummary, write_array};
    use ndarray::{ArrayD, IxDyn};

    /// An array whose values are their row-major indices.
    fn counting(folder: &tempfile::TempDir, shape: &[usize]) -> std::path::PathBuf {
        let path = folder.path().join("a.npy");
        let count = shape.iter().product::<usize>();
        let values = (0..count).map(|index| index as f32).collect();
        write_array(&path, ArrayD::from_shape_vec(IxDyn(shape), values).unwrap().view()).unwrap();
        path
    }

    fn with(path: &Path, query: &str) -> std::path::PathBuf {
        format!("{}?{query}", path.display()).into()
    }

    #[test]
    fn axes_have_the_meaning_that_their_lengths_suggest() {
        let folder = tempfile::tempdir().unwrap();
        for (shape, expected, axis) in [
            (&[7, 9][..], Some((1, 7, 9)), None),
            (&[7, 9, 3], Some((1, 7, 9)), None),
            (&[7, 9, 4], Some((1, 7, 9)), None),
            (&[7, 9, 5], Some((7, 7 + 2, 5)), Some(1)),
            (&[2, 9, 3], Some((2, 9, 3)), Some(1)),
            (&[0, 9, 9], Some((0, 9, 9)), Some(1)),
            (&[1, 9, 8], Some((1, 9, 8)), None),
            (&[6, 9, 1], Some((1, 6, 9)), None),
            (&[6, 1, 9], Some((6, 1, 9)), Some(1)),
            (&[1, 7, 9, 3], Some((1, 7, 9)), None),
            (&[5, 7, 9, 1], Some((5, 7, 9)), Some(1)),
            (&[5, 1, 7, 9], Some((5, 7, 9)), Some(1)),
            (&[5, 7, 9, 3], Some((5, 7, 9)), Some(1)),
            (&[1, 5, 1, 7, 9], Some((5, 7, 9)), Some(2)),
            (&[1, 1, 1, 7, 9, 3], Some((1, 7, 9)), None),
            (&[9], None, None),
            (&[], None, None),
            (&[5, 3, 7, 9], None, None),
            (&[2, 2, 9, 9], None, None),
        ] {
            let stack = read_stack(&counting(&folder, shape)).ok();
            assert_eq!(stack.as_ref().map(|stack| (stack.pages, stack.rows, stack.cols)), expected, "{shape:?}");
            assert_eq!(stack.and_then(|stack| stack.understood.axis), axis, "{shape:?}");
        }
    }

    #[test]
    fn the_axis_that_counts_images_can_be_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = counting(&folder, &[6, 5, 3]);
        for (query, dim, axis, second) in [
            ("axis=last", (3, 6, 5), 3, 1.0),
            ("axis=3", (3, 6, 5), 3, 1.0),
            ("axis=2", (5, 6, 3), 2, 3.0),
            ("axis=first", (6, 5, 3), 1, 15.0),
        ] {
            let stack = read_stack(&with(&path, query)).unwrap();
            assert_eq!(stack.understood.axis, Some(axis));
            let array = stack.into_array();
            assert_eq!((array.dim(), array[(1, 0, 0)]), (dim, second), "{query}");
        }
        // Images of one row beside those of colours.
        let colours = read_stack(&with(&counting(&folder, &[6, 5, 3, 4]), "axis=last&channel=red")).unwrap();
        assert_eq!((colours.understood.axis, colours.samples.value(1)), (Some(4), 12.0));
        counting(&folder, &[6, 5, 3]);
        for wrong in ["axis=4", "axis=1&axis=9", "key=a", "channel=alpha", "frame=7"] {
            let error = read_stack(&with(&path, wrong)).err().map(|error| error.to_string());
            assert!(error.is_some(), "{wrong} was understood");
        }
    }

    #[test]
    fn channels_and_single_images_can_be_told() {
        let folder = tempfile::tempdir().unwrap();
        let value = |shape: &[usize], query: &str| {
            let stack = read_stack(&with(&counting(&folder, shape), query)).unwrap();
            ((stack.pages, stack.rows, stack.cols), stack.samples.value(1))
        };
        assert_eq!(value(&[6, 5, 3], "channel=green"), ((1, 6, 5), 4.0));
        assert_eq!(value(&[6, 5, 2], "channel=2"), ((1, 6, 5), 3.0));
        assert_eq!(value(&[3, 6, 5], "channel=blue"), ((1, 6, 5), 61.0));
        assert_eq!(value(&[2, 3, 6, 5], "channel=blue"), ((2, 6, 5), 61.0));
        assert_eq!(value(&[4, 6, 5], "frame=3"), ((1, 6, 5), 61.0));
        let third = read_stack(&with(&counting(&folder, &[4, 6, 5]), "frame=3")).unwrap();
        assert!(ImageSummary::of(&third).to_string().ends_with("range 60 to 89; image 3 of 4"), "{third:?}");
    }

    #[test]
    fn what_was_understood_is_said_with_what_else_it_could_be() {
        let folder = tempfile::tempdir().unwrap();
        let summary = |shape: &[usize], query: &str| {
            ImageSummary::of(&read_stack(&with(&counting(&folder, shape), query)).unwrap()).to_string()
        };
        assert_eq!(
            summary(&[9, 8, 5], ""),
            "9 images of 8 x 5 px, axis 1 counts them, 32-bit floats, range 0 to 359; if axis 3 counts them, add \
             ?axis=last"
        );
        assert_eq!(
            summary(&[9, 8, 5], "axis=last"),
            "5 images of 9 x 8 px, axis 3 counts them, 32-bit floats, range 0 to 359"
        );
        assert!(!summary(&[4, 8, 5], "").contains("add ?axis=last"));
        assert!(summary(&[9, 8, 3], "").contains("luma of red, green and blue"));
    }

    #[test]
    fn other_files_are_named_with_what_would_do() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = read_picture_or_array(file.path()).unwrap_err().to_string();
        assert!(
            error.contains("expected an NPY, NPZ, TIFF, PNG, JPEG, BMP or IDX file, found an empty file"),
            "{error}"
        );
        let error = read_picture_or_array(Path::new("/none/a.npy")).unwrap_err();
        assert!(matches!(error, FormatError::NotFound { .. }), "{error}");
        let error = read_picture_or_array(&std::env::temp_dir()).unwrap_err().to_string();
        assert!(error.contains("found a folder"), "{error}");
    }
}
