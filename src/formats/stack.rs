//! Files of images as grey pages.

use std::path::Path;

use ndarray::Array2;

use super::bytes::magic;
use super::kind::named_for_what_it_is;
use super::raw_array::RawArray;
use super::{Channel, FormatError, ImageFile, Meaning, PixelStack, idx, npy, npz, raster, tiff_pages};
use crate::plural::counted;

/// Least length of the first two axes of a colour image, exclusive. A stack of a few narrow pages is not a colour image.
const COLOUR_IMAGE_PX: usize = 4;
/// Kinds of files that are read, for error sentences.
const KINDS: &str = "an NPY, NPZ, TIFF, PNG, JPEG, BMP or IDX file";

/// Reads a file of images as grey pages, in the number type and the counts of the file, with its interpretation.
///
/// The first bytes, not the name, decide the kind: NPY, NPZ, TIFF (all pages), PNG, JPEG, BMP, IDX (also gzipped). The
/// path may state the meaning of the file: see [`ImageFile::find`]. Without it the axes of arrays are: (rows, cols);
/// (images, rows, cols); (rows, cols, 1); (rows, cols, 3 or 4) colour with rows and cols above 4; (images, rows, cols, 3
/// or 4) colour. Other axes of length 1 are dropped. Colour becomes Rec. 709 luma.
///
/// ```no_run
/// use lenslet_studio::prelude::*;
///
/// let photons = read_stack("measurements.npy".as_ref())?.into_array();
/// println!("{:?} (images, rows, cols)", photons.dim());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`FormatError`] if the file is missing, damaged, of another kind, or an array of other axes.
pub fn read_stack(path: &Path) -> Result<PixelStack, FormatError> {
    ImageFile::find(path)?.read()
}

impl ImageFile {
    /// Reads the images of the file.
    ///
    /// # Errors
    /// As [`read_stack`].
    pub fn read(&self) -> Result<PixelStack, FormatError> {
        read(self)
    }

    /// Reads the file as [`ImageFile::read`], but of colours takes this channel in place of their luma where the path names none.
    ///
    /// # Errors
    /// As [`ImageFile::read`].
    pub fn read_of_colours(&self, channel: Channel) -> Result<PixelStack, FormatError> {
        let meaning = Meaning { of_colours: Some(channel), ..self.meaning.clone() };
        read(&Self { meaning, ..self.clone() })
    }
}

/// Reads an image or array as grey values of shape (rows, cols), in the counts of the file: 0 to 255, 0 to 65535 or
/// float. Of several images it returns the first. Colour becomes Rec. 709 luma; alpha is ignored.
///
/// # Errors
/// [`FormatError`] if the file is missing, damaged, of another kind, larger than 32,768 px a side or 1 GiB.
pub fn read_grey(path: &Path) -> Result<Array2<f32>, FormatError> {
    Ok(read_stack(path)?.image(0))
}

fn read(file: &ImageFile) -> Result<PixelStack, FormatError> {
    let path = &file.path;
    let start = magic::<4>(path)?;
    let (is_npy, is_archive) = (start == *b"\x93NUM", matches!(start, [b'P', b'K', 3 | 5, 4 | 6]));
    file.check_options(is_npy || is_archive, is_archive)?;
    let stack = match start {
        _ if is_npy => from_array(file, npy::read_raw(path)?)?,
        _ if is_archive => from_array(file, npz::read_raw(path, file.meaning.key.as_deref())?)?,
        [b'I', b'I', 42 | 43, 0] | [b'M', b'M', 0, 42 | 43] => tiff_pages::read_equal_pages(file)?,
        [0x89, b'P', b'N', b'G'] | [0xFF, 0xD8, 0xFF, _] | [b'B', b'M', ..] => raster::read_page(file)?,
        [0, 0, _, 3] => idx::read_images(file)?,
        [0x1f, 0x8b, ..] if idx::is_packed_images(path) => idx::read_images(file)?,
        _ => return Err(named_for_what_it_is(path, KINDS)),
    };
    if stack.samples.is_empty() {
        let found = format!("none in {} of {} x {} px", counted(stack.pages, "image"), stack.rows, stack.cols);
        return Err(FormatError::malformed(path, "images with pixels", found, "choose another file or save it again"));
    }
    file.chosen_frame(stack)
}

/// Axes of an array, numbered from 0. Axes that are not listed here have length 1.
struct Axes {
    /// Axis that counts images.
    frames: Option<usize>,
    rows: usize,
    cols: usize,
    /// Axis of colours.
    colours: Option<usize>,
}

impl Axes {
    /// Axes of a shape, from the path or guessed from the lengths. The error is the advice.
    fn of(shape: &[usize], meaning: &Meaning) -> Result<Self, &'static str> {
        const RESHAPE: &str = "reshape it to one of these";
        let chosen = match meaning.axis {
            Some(axis) => Some(axis.index(shape.len()).ok_or("correct the number behind ?axis=")?),
            None => None,
        };
        // Axes of length 1 are dropped. Of three axes it is the last one, so that an image remains.
        let mut axes: Vec<usize> = (0..shape.len()).collect();
        while axes.len() > 3
            && let Some(layer) = axes.iter().position(|&axis| shape[axis] == 1 && Some(axis) != chosen)
        {
            axes.remove(layer);
        }
        if axes.len() == 3 && chosen.is_none() && shape[axes[2]] == 1 {
            axes.pop();
        }
        axes.retain(|&axis| Some(axis) != chosen);
        let is_wide = |one: usize, other: usize| shape[one].min(shape[other]) > COLOUR_IMAGE_PX;
        let is_known = meaning.channel.is_some();
        let is_colour = |axis: usize| matches!(shape[axis], 3 | 4) || (is_known && shape[axis] == 2);
        let axes = match axes[..] {
            [rows, cols] => Self { frames: chosen, rows, cols, colours: None },
            [rows, cols, colours] if is_colour(colours) && (is_wide(rows, cols) || chosen.is_some() || is_known) => {
                Self { frames: chosen, rows, cols, colours: Some(colours) }
            }
            [colours, rows, cols] if is_known && is_colour(colours) => {
                Self { frames: chosen, rows, cols, colours: Some(colours) }
            }
            [frames, rows, cols] if chosen.is_none() && !is_known => {
                Self { frames: Some(frames), rows, cols, colours: None }
            }
            [frames, rows, cols, colours] if chosen.is_none() && is_colour(colours) => {
                Self { frames: Some(frames), rows, cols, colours: Some(colours) }
            }
            [frames, colours, rows, cols] if chosen.is_none() && is_colour(colours) && is_known => {
                Self { frames: Some(frames), rows, cols, colours: Some(colours) }
            }
            [_, colours, _, _] if chosen.is_none() && is_colour(colours) => {
                return Err("add ?channel=luma or ?channel=1 if axis 2 holds colours, or reshape it");
            }
            [_, _, _] | [_, _, _, _] => {
                return Err("reshape it, or add ?axis=last or ?axis=2 if that axis counts images");
            }
            _ => return Err(RESHAPE),
        };
        Ok(axes)
    }

    /// Axis order: images, rows, columns, colours.
    fn order(&self, count: usize) -> Vec<usize> {
        let named = || self.frames.into_iter().chain([self.rows, self.cols]).chain(self.colours);
        let single = (0..count).filter(|&axis| named().all(|other| other != axis));
        single.chain(named()).collect()
    }
}

/// Gives the axes of an array their meaning.
fn from_array(file: &ImageFile, array: RawArray) -> Result<PixelStack, FormatError> {
    let RawArray { shape, samples, understood } = array;
    let meaning = &file.meaning;
    let axes = Axes::of(&shape, meaning).map_err(|advice| {
        let expected = "an array of shape (rows, cols), (images, rows, cols) or (rows, cols, 3)";
        FormatError::malformed(&file.path, expected, format!("shape {shape:?}"), advice)
    })?;
    let order = axes.order(shape.len());
    let samples = if order.is_sorted() { samples } else { samples.permuted(&shape, &order) };
    let size = [axes.frames.map_or(1, |axis| shape[axis]), shape[axes.rows], shape[axes.cols]];
    let mut stack = PixelStack::interleaved(file, size, samples, axes.colours.map_or(1, |axis| shape[axis]))?;
    // A single layer counts no images, unless the path names the axis.
    let counts = axes.frames.filter(|&axis| shape[axis] != 1 || meaning.axis.is_some());
    stack.understood.axis = counts.map(|axis| axis + 1);
    stack.understood.key = understood.key;
    stack.understood.numbers = understood.numbers.or(stack.understood.numbers);
    if let Some(colours) = axes.colours {
        stack.note(format!("axis {} holds colours", colours + 1));
    }
    if meaning.axis.is_none() && shape.len() == 3 {
        suggest_axes(&mut stack, meaning, &axes, &shape);
    }
    Ok(stack)
}

/// Lists other meanings of three axes.
fn suggest_axes(stack: &mut PixelStack, meaning: &Meaning, axes: &Axes, shape: &[usize]) {
    if axes.colours == Some(2) && stack.from_colour && meaning.of_colours.is_none() {
        stack.note("if the last axis counts images, add ?axis=last");
        stack.understood.choices.push("axis=last".into());
    } else if axes.colours.is_none() && axes.frames == Some(0) {
        if shape[2] < shape[0].min(shape[1]) {
            stack.note("if axis 3 counts them, add ?axis=last");
        }
        stack.understood.choices.extend(["axis=2", "axis=last"].map(Into::into));
    }
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
            (&[7, 9, 5], Some((7, 9, 5)), Some(1)),
            (&[2, 9, 3], Some((2, 9, 3)), Some(1)),
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
    fn arrays_without_pixels_are_refused_whatever_their_shape() {
        let folder = tempfile::tempdir().unwrap();
        for (shape, found) in [
            (&[0, 5][..], "found none in 1 image of 0 x 5 px;"),
            (&[0, 40, 52], "found none in 0 images of 40 x 52 px;"),
        ] {
            let error = read_stack(&counting(&folder, shape)).unwrap_err().to_string();
            assert!(error.contains("expected images with pixels") && error.contains(found), "{error}");
        }
    }

    #[test]
    fn axis_that_counts_images_can_be_chosen() {
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
        // Images of one row, with colours.
        let colours = read_stack(&with(&counting(&folder, &[6, 5, 3, 4]), "axis=last&channel=red")).unwrap();
        assert_eq!((colours.understood.axis, colours.samples.value(1)), (Some(4), 12.0));
        counting(&folder, &[6, 5, 3]);
        for (wrong, message) in [
            ("axis=4", "correct the number behind ?axis="),
            ("axis=1&axis=9", "correct the number behind ?axis="),
            ("key=a", "a file that is no archive of arrays"),
            ("channel=alpha", "found 3 channels"),
            ("frame=7", "found 1 image;"),
        ] {
            let error = read_stack(&with(&path, wrong)).unwrap_err().to_string();
            assert!(error.contains(message), "{wrong}: {error}");
        }
    }

    #[test]
    fn channels_and_single_images_can_be_chosen() {
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
        let error = read_stack(file.path()).unwrap_err().to_string();
        assert!(
            error.contains("expected an NPY, NPZ, TIFF, PNG, JPEG, BMP or IDX file, found an empty file"),
            "{error}"
        );
        let error = read_stack(Path::new("/none/a.npy")).unwrap_err();
        assert!(matches!(error, FormatError::NotFound { .. }), "{error}");
        let error = read_stack(&std::env::temp_dir()).unwrap_err().to_string();
        assert!(error.contains("found a folder"), "{error}");
    }

    #[test]
    fn a_channel_stands_in_for_the_luma_of_colours_alone() {
        let folder = tempfile::tempdir().unwrap();
        let read = |name: &str, colours: [f32; 3]| {
            let path = folder.path().join(name);
            let values = (0..40 * 50 * 3).map(|index| colours[index % 3]).collect();
            write_array(&path, ArrayD::from_shape_vec(IxDyn(&[40, 50, 3]), values).unwrap().view()).unwrap();
            ImageFile::find(&path).unwrap()
        };
        let coloured = read("coloured.npy", [1.0, 7.0, 2.0]);
        let stack = coloured.read_of_colours(Channel::Green).unwrap();
        assert!(stack.from_colour && stack.samples.clone().into_f32().iter().all(|&value| value == 7.0));
        let mut named = coloured.clone();
        named.meaning.channel = Some(Channel::Green);
        let (named, summary) = (named.read().unwrap(), ImageSummary::of(&stack).to_string());
        assert_eq!((&named.samples, ImageSummary::of(&named).to_string()), (&stack.samples, summary));
        let mut blue = coloured;
        blue.meaning.channel = Some(Channel::Blue);
        let stack = blue.read_of_colours(Channel::Green).unwrap();
        assert!(!stack.from_colour && stack.samples.into_f32().iter().all(|&value| value == 2.0));
        assert!(!read("grey.npy", [3.0; 3]).read_of_colours(Channel::Green).unwrap().from_colour);
    }
}
