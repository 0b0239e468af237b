//! Grey pixels in the number type of their file.

use std::cell::Cell;
use std::path::Path;

use ndarray::{Array2, Array3, ArrayView, IxDyn};

use super::{Channel, FormatError, ImageFile, Understood};
use crate::plural::counted;

/// Rec. ITU-R BT.709 luma weights of red, green and blue.
pub const GREY_WEIGHTS: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Pixel values in the type of the file: 8- and 16-bit counts keep their width, everything else is `f32`.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    /// 8-bit counts, 0 to 255.
    U8(Vec<u8>),
    /// 16-bit counts, 0 to 65535.
    U16(Vec<u16>),
    /// Any other values.
    F32(Vec<f32>),
}

impl Samples {
    /// Number of pixels.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) => values.len(),
            Self::F32(values) => values.len(),
        }
    }

    /// Whether there is no pixel.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Value of pixel `index`.
    ///
    /// # Panics
    /// If `index` is not below [`Samples::len`].
    pub fn value(&self, index: usize) -> f32 {
        match self {
            Self::U8(values) => f32::from(values[index]),
            Self::U16(values) => f32::from(values[index]),
            Self::F32(values) => values[index],
        }
    }

    /// Largest value; 0 where none is above.
    fn brightest(&self) -> f32 {
        match self {
            Self::U8(values) => values.iter().copied().max().map_or(0.0, f32::from),
            Self::U16(values) => values.iter().copied().max().map_or(0.0, f32::from),
            Self::F32(values) => values.iter().copied().fold(0.0, f32::max),
        }
    }

    /// All values as `f32`, without a copy where they have that type.
    pub fn into_f32(self) -> Vec<f32> {
        match self {
            Self::U8(values) => values.into_iter().map(f32::from).collect(),
            Self::U16(values) => values.into_iter().map(f32::from).collect(),
            Self::F32(values) => values,
        }
    }

    /// Appends the pixels of `other`. Both become `f32` where their types differ.
    pub fn append(&mut self, other: Samples) {
        if self.is_empty() {
            *self = other;
            return;
        }
        match (&mut *self, other) {
            (Self::U8(values), Self::U8(more)) => values.extend(more),
            (Self::U16(values), Self::U16(more)) => values.extend(more),
            (Self::F32(values), more) => values.extend(more.into_f32()),
            (_, more) if more.is_empty() => {}
            (_, more) => {
                let mut values = std::mem::replace(self, Self::F32(Vec::new())).into_f32();
                values.extend(more.into_f32());
                *self = Self::F32(values);
            }
        }
    }

    /// Passes the pixels, little-endian and preceded by their width, to `sink` in blocks.
    pub fn for_each_block(&self, mut sink: impl FnMut(&[u8])) {
        const BLOCK_VALUES: usize = 16 * 1024;
        match self {
            Self::U8(values) => {
                sink(b"u8");
                sink(values);
            }
            Self::U16(values) => {
                sink(b"u16");
                for block in values.chunks(BLOCK_VALUES) {
                    sink(&block.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>());
                }
            }
            Self::F32(values) => {
                sink(b"f32");
                for block in values.chunks(BLOCK_VALUES) {
                    sink(&block.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>());
                }
            }
        }
    }

    /// Count of the brightest pixel of this type; `None` for floating-point numbers.
    fn white(&self) -> Option<u16> {
        match self {
            Self::U8(_) => Some(u16::from(u8::MAX)),
            Self::U16(_) => Some(u16::MAX),
            Self::F32(_) => None,
        }
    }

    /// All values times `factor`; counts become `f32`.
    #[must_use]
    pub fn times(self, factor: f32) -> Samples {
        Self::F32(self.into_f32().into_iter().map(|value| value * factor).collect())
    }

    /// Red, green and blue of the pixels of interleaved `channels`.
    fn colours(&self, channels: usize) -> impl Iterator<Item = [f32; 3]> {
        (0..self.len() / channels).map(move |pixel| [0, 1, 2].map(|channel| self.value(pixel * channels + channel)))
    }

    /// Values of an array of this shape with its axes in another order, row-major.
    ///
    /// # Panics
    /// If the shape does not hold all values or `order` is not a permutation of its axes.
    pub(super) fn permuted(self, shape: &[usize], order: &[usize]) -> Samples {
        fn permute<T: Copy>(values: &[T], shape: &[usize], order: &[usize]) -> Vec<T> {
            let array = ArrayView::from_shape(IxDyn(shape), values).expect("every reader fills its shape");
            array.permuted_axes(IxDyn(order)).iter().copied().collect()
        }
        match self {
            Self::U8(values) => Self::U8(permute(&values, shape, order)),
            Self::U16(values) => Self::U16(permute(&values, shape, order)),
            Self::F32(values) => Self::F32(permute(&values, shape, order)),
        }
    }

    /// The `count` values at `source(0)`, `source(1)` and so on.
    ///
    /// # Panics
    /// If `source` is beyond the last value.
    pub(super) fn gathered(&self, count: usize, source: impl Fn(usize) -> usize) -> Samples {
        match self {
            Self::U8(values) => Self::U8((0..count).map(|index| values[source(index)]).collect()),
            Self::U16(values) => Self::U16((0..count).map(|index| values[source(index)]).collect()),
            Self::F32(values) => Self::F32((0..count).map(|index| values[source(index)]).collect()),
        }
    }

    /// Channel `index` of interleaved `channels`.
    fn channel(self, index: usize, channels: usize) -> Samples {
        if channels == 1 {
            return self;
        }
        self.gathered(self.len() / channels, |pixel| pixel * channels + index)
    }

    /// Whether any pixel of interleaved `channels` is not grey.
    fn has_colours(&self, channels: usize) -> bool {
        channels > 2 && self.colours(channels).any(|[red, green, blue]| red != green || green != blue)
    }

    /// Grey values of pixels of interleaved `channels`. One channel is grey, two are grey and alpha, three and four are
    /// red, green, blue (and alpha). Colours are weighted by [`GREY_WEIGHTS`] where they differ. Alpha is ignored.
    ///
    /// # Panics
    /// If `channels` is 0.
    fn grey(self, channels: usize) -> Samples {
        if self.has_colours(channels) {
            return Self::F32(self.colours(channels).map(luma).collect());
        }
        self.channel(0, channels)
    }
}

/// Rounding of doubles to single precision, which finds finite values beyond its range.
#[derive(Default)]
pub(super) struct Narrowing {
    beyond: Cell<Option<f64>>,
}

impl Narrowing {
    /// The value in single precision.
    pub(super) fn of(&self, value: f64) -> f32 {
        let narrow = value as f32;
        if narrow.is_infinite() && value.is_finite() {
            self.beyond.set(self.beyond.get().or(Some(value)));
        }
        narrow
    }

    /// Refuses a file with a finite value beyond single precision.
    pub(super) fn check(&self, path: &Path) -> Result<(), FormatError> {
        let Some(value) = self.beyond.get() else { return Ok(()) };
        let expected = format!("values within single precision, at most {:e}", f32::MAX);
        Err(FormatError::malformed(path, expected, format!("{value:e}"), "divide all values by a constant"))
    }
}

/// Rec. 709 luma of red, green and blue in the same unit.
fn luma(rgb: [f32; 3]) -> f32 {
    rgb.iter().zip(GREY_WEIGHTS).map(|(&value, weight)| f64::from(value) * weight).sum::<f64>() as f32
}

/// Grey images of one shape, (pages, rows, cols), row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelStack {
    /// Number of images.
    pub pages: usize,
    /// Rows of each image, px.
    pub rows: usize,
    /// Columns of each image, px.
    pub cols: usize,
    /// `pages * rows * cols` values.
    pub samples: Samples,
    /// Count of the brightest pixel that the file can hold, 255 or 65535; `None` for other numbers.
    pub white: Option<u16>,
    /// Whether the file has colours and its path names no channel. `samples` then holds their luma, or the channel that was to stand in
    /// for it.
    pub from_colour: bool,
    /// Further interpretation of the file by the reader.
    pub understood: Understood,
}

impl PixelStack {
    /// Value of a truth of 1 in image quality: 255 for 8-bit files, the brightest pixel for others, whose range is seldom used.
    pub fn peak(&self) -> f32 {
        match self.white {
            Some(white) if white == u16::from(u8::MAX) => f32::from(white),
            _ => self.samples.brightest(),
        }
    }

    /// Grey images from their samples.
    pub fn new(pages: usize, rows: usize, cols: usize, samples: Samples) -> Self {
        let understood = Understood::default();
        Self { pages, rows, cols, white: samples.white(), samples, from_colour: false, understood }
    }

    /// Images of shape [pages, rows, cols] of a file from samples of interleaved `channels`. The path may choose a
    /// channel. Otherwise the result is grey without opacity, or the luma of red, green and blue where they differ.
    ///
    /// # Errors
    /// [`FormatError`] where there is no such channel, or none was chosen of more than four.
    pub(super) fn interleaved(
        file: &ImageFile,
        [pages, rows, cols]: [usize; 3],
        samples: Samples,
        channels: usize,
    ) -> Result<Self, FormatError> {
        let white = samples.white();
        let from_colour = samples.has_colours(channels);
        let in_place_of_luma = file.meaning.of_colours.filter(|_| from_colour && file.meaning.channel.is_none());
        let in_place_of_luma = in_place_of_luma.and_then(|channel| chosen(channel, channels));
        let refuse = |expected: &str, advice: &str| {
            FormatError::malformed(&file.path, expected, counted(channels, "channel"), advice)
        };
        // Up to four channels become their luma anyway.
        let choice = file.meaning.channel.filter(|&choice| choice != Channel::Luma || channels > 4);
        let chosen = match choice {
            Some(choice) => {
                let index = chosen(choice, channels);
                Some(index.ok_or_else(|| refuse("the channel that ?channel= names", "choose another"))?)
            }
            None if channels > 4 => {
                let advice = "choose one: add ?channel=1 to the path";
                return Err(refuse("one channel, or red, green and blue", advice));
            }
            None => None,
        };
        if let Some(index) = chosen.or(in_place_of_luma) {
            let from_colour = in_place_of_luma.is_some();
            let mut stack =
                Self { white, from_colour, ..Self::new(pages, rows, cols, samples.channel(index, channels)) };
            if channels > 1 {
                stack.note(format!("channel {} of {channels}", index + 1));
            }
            return Ok(stack);
        }
        let mut stack = Self { white, from_colour, ..Self::new(pages, rows, cols, samples.grey(channels)) };
        if from_colour {
            stack.understood.numbers = white.map(|white| format!("{} bits", bits_of(white)));
            stack.note("luma of red, green and blue (?channel=green takes one)");
            stack.understood.choices.extend(["channel=red", "channel=green", "channel=blue"].map(Into::into));
        }
        if matches!(channels, 2 | 4) {
            stack.note("opacity left out");
        }
        Ok(stack)
    }

    /// Image `page` alone.
    pub(super) fn only(self, page: usize) -> Self {
        let pixels = self.rows * self.cols;
        let samples = self.samples.gathered(pixels, |pixel| page * pixels + pixel);
        let mut stack = Self { samples, pages: 1, ..self };
        stack.note(format!("image {} of {}", page + 1, self.pages));
        stack.understood.axis = None;
        stack
    }

    /// The images turned upright according to the orientation tag of EXIF and TIFF, 1 to 8. Orientation 1 changes
    /// nothing.
    pub(super) fn turned(self, orientation: u64) -> Self {
        let (rows, cols) = (self.rows, self.cols);
        let (new_rows, new_cols) = if (5..=8).contains(&orientation) { (cols, rows) } else { (rows, cols) };
        let source = |row: usize, col: usize| match orientation {
            2 => (row, cols - 1 - col),
            3 => (rows - 1 - row, cols - 1 - col),
            4 => (rows - 1 - row, col),
            5 => (col, row),
            6 => (rows - 1 - col, row),
            7 => (rows - 1 - col, cols - 1 - row),
            _ => (col, cols - 1 - row),
        };
        if !(2..=8).contains(&orientation) {
            return self;
        }
        let pixels = rows * cols;
        let samples = self.samples.gathered(self.samples.len(), |index| {
            let (page, pixel) = (index / pixels, index % pixels);
            let (row, col) = source(pixel / new_cols, pixel % new_cols);
            page * pixels + row * cols + col
        });
        let mut stack = Self { samples, rows: new_rows, cols: new_cols, ..self };
        stack.note(format!("turned upright (orientation {orientation} of the file)"));
        stack
    }

    /// Images as an array of shape (pages, rows, cols), in the counts of the file.
    ///
    /// # Panics
    /// If there are not `pages * rows * cols` samples. Every reader ensures this number.
    pub fn into_array(self) -> Array3<f32> {
        Array3::from_shape_vec((self.pages, self.rows, self.cols), self.samples.into_f32())
            .expect("every reader fills pages * rows * cols samples")
    }

    /// Image `page` as an array of shape (rows, cols), in the counts of the file.
    ///
    /// # Panics
    /// If `page` is not below `pages`.
    pub fn image(&self, page: usize) -> Array2<f32> {
        let start = page * self.rows * self.cols;
        Array2::from_shape_fn((self.rows, self.cols), |(row, col)| self.samples.value(start + row * self.cols + col))
    }
}

/// Index of a channel among `channels`; `None` without such a channel.
fn chosen(choice: Channel, channels: usize) -> Option<usize> {
    let colour = |index: usize| match channels {
        // Grey images have the same red, green and blue.
        1 | 2 => Some(0),
        3 | 4 => Some(index),
        _ => None,
    };
    match choice {
        Channel::Number(number) => (number <= channels).then(|| number - 1),
        Channel::Alpha => matches!(channels, 2 | 4).then(|| channels - 1),
        Channel::Red => colour(0),
        Channel::Green => colour(1),
        Channel::Blue => colour(2),
        Channel::Luma => None,
    }
}

impl ImageFile {
    /// The single image that the path selects, or all.
    pub(super) fn chosen_frame(&self, stack: PixelStack) -> Result<PixelStack, FormatError> {
        match self.meaning.frame {
            None => Ok(stack),
            Some(frame) if frame <= stack.pages => Ok(stack.only(frame - 1)),
            Some(frame) => {
                let expected = format!("image {frame}, as ?frame={frame} asks for");
                Err(FormatError::malformed(&self.path, expected, counted(stack.pages, "image"), "choose another"))
            }
        }
    }
}

/// Bits of a number type by its largest count: 8 for 255, 16 for 65535.
pub(crate) fn bits_of(white: u16) -> u32 {
    u16::BITS - white.leading_zeros()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_of_white_is_white_and_of_red_its_weight() {
        assert!((luma([255.0; 3]) - 255.0).abs() < 1e-4);
        assert!((luma([1.0, 0.0, 0.0]) - 0.2126).abs() < 1e-7);
        let alpha_ignored = Samples::U8(vec![10, 20, 30, 0, 10, 20, 30, 255]).grey(4).into_f32();
        assert_eq!(alpha_ignored[0].to_bits(), alpha_ignored[1].to_bits());
        assert_eq!(Samples::U16(vec![7, 0, 9, 65535]).grey(2), Samples::U16(vec![7, 9]));
    }

    #[test]
    fn images_are_turned_as_their_orientation_says() {
        // Views of an image with the rows 0 1 2 and 3 4 5, by its orientation (TIFF 6.0, tag 274).
        for (orientation, rows, cols, expected) in [
            (1, 2, 3, [0, 1, 2, 3, 4, 5]),
            (2, 2, 3, [2, 1, 0, 5, 4, 3]),
            (3, 2, 3, [5, 4, 3, 2, 1, 0]),
            (4, 2, 3, [3, 4, 5, 0, 1, 2]),
            (5, 3, 2, [0, 3, 1, 4, 2, 5]),
            (6, 3, 2, [3, 0, 4, 1, 5, 2]),
            (7, 3, 2, [5, 2, 4, 1, 3, 0]),
            (8, 3, 2, [2, 5, 1, 4, 0, 3]),
            (9, 2, 3, [0, 1, 2, 3, 4, 5]),
        ] {
            let stack = PixelStack::new(2, 2, 3, Samples::U8([0, 1, 2, 3, 4, 5].repeat(2))).turned(orientation);
            assert_eq!((stack.rows, stack.cols), (rows, cols), "{orientation}");
            assert_eq!(stack.samples, Samples::U8(expected.repeat(2)), "{orientation}");
        }
    }

    #[test]
    fn appending_another_type_keeps_every_value() {
        let mut samples = Samples::U8(vec![]);
        samples.append(Samples::U16(vec![300]));
        assert_eq!(samples, Samples::U16(vec![300]));
        samples.append(Samples::U8(vec![2]));
        assert_eq!(samples, Samples::F32(vec![300.0, 2.0]));
    }
}
