//! Grey pixels in the number type of their file.

use ndarray::{Array2, Array3};

/// Rec. ITU-R BT.709 luma weights of red, green and blue.
pub const GREY_WEIGHTS: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Pixel values as the file holds them: 8- and 16-bit counts keep their width, everything else is `f32`.
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

    /// True without any pixel.
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

    /// All values as `f32`, without a copy where they are already.
    pub fn into_f32(self) -> Vec<f32> {
        match self {
            Self::U8(values) => values.into_iter().map(f32::from).collect(),
            Self::U16(values) => values.into_iter().map(f32::from).collect(),
            Self::F32(values) => values,
        }
    }

    /// Adds the pixels of `other` behind these; both become `f32` where their types differ.
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

    /// Feeds the pixels, little-endian and preceded by their width, to `sink` in blocks.
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

    /// Count of the brightest pixel that this type can hold; none of floating-point numbers.
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

    /// Whether any pixel of interleaved `channels` is not grey.
    fn has_colours(&self, channels: usize) -> bool {
        channels > 2 && self.colours(channels).any(|[red, green, blue]| red != green || green != blue)
    }

    /// Pixels of interleaved `channels` made grey: one channel as it is, two as grey and alpha, three and four as
    /// red, green, blue (and alpha), weighted by [`GREY_WEIGHTS`] where they differ. Alpha is ignored.
    ///
    /// # Panics
    /// If `channels` is 0.
    fn grey(self, channels: usize) -> Samples {
        if self.has_colours(channels) {
            return Self::F32(self.colours(channels).map(luma).collect());
        }
        match (self, channels) {
            (samples, 1) => samples,
            (Self::U8(values), _) => Self::U8(values.into_iter().step_by(channels).collect()),
            (Self::U16(values), _) => Self::U16(values.into_iter().step_by(channels).collect()),
            (Self::F32(values), _) => Self::F32(values.into_iter().step_by(channels).collect()),
        }
    }
}

/// Rec. 709 luma of red, green and blue in the same unit.
pub(super) fn luma(rgb: [f32; 3]) -> f32 {
    rgb.iter().zip(GREY_WEIGHTS).map(|(&value, weight)| f64::from(value) * weight).sum::<f64>() as f32
}

/// Grey pictures of one shape, (pages, rows, cols), row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelStack {
    /// Number of pictures.
    pub pages: usize,
    /// Rows of each picture, px.
    pub rows: usize,
    /// Columns of each picture, px.
    pub cols: usize,
    /// `pages * rows * cols` values.
    pub samples: Samples,
    /// Count of the brightest pixel that the file can hold, 255 or 65535; none of other numbers.
    pub white: Option<u16>,
    /// Whether the file has colours, of which `samples` is the luma.
    pub from_colour: bool,
}

impl PixelStack {
    /// Grey pictures from their samples.
    pub fn new(pages: usize, rows: usize, cols: usize, samples: Samples) -> Self {
        Self { pages, rows, cols, white: samples.white(), samples, from_colour: false }
    }

    /// One picture from samples of interleaved `channels`.
    pub(super) fn page(rows: usize, cols: usize, samples: Samples, channels: usize) -> Self {
        let (white, from_colour) = (samples.white(), samples.has_colours(channels));
        Self { white, from_colour, ..Self::new(1, rows, cols, samples.grey(channels)) }
    }

    /// Pictures as an array of shape (pages, rows, cols), in the counts of the file.
    ///
    /// # Panics
    /// If there are not `pages * rows * cols` samples, which every reader sees to.
    pub fn into_array(self) -> Array3<f32> {
        Array3::from_shape_vec((self.pages, self.rows, self.cols), self.samples.into_f32())
            .expect("every reader fills pages * rows * cols samples")
    }

    /// Picture `page` as an array of shape (rows, cols), in the counts of the file.
    ///
    /// # Panics
    /// If `page` is not below `pages`.
    pub fn picture(&self, page: usize) -> Array2<f32> {
        let start = page * self.rows * self.cols;
        Array2::from_shape_fn((self.rows, self.cols), |(row, col)| self.samples.value(start + row * self.cols + col))
    }
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
    fn appending_another_type_keeps_every_value() {
        let mut samples = Samples::U8(vec![]);
        samples.append(Samples::U16(vec![300]));
        assert_eq!(samples, Samples::U16(vec![300]));
        samples.append(Samples::U8(vec![2]));
        assert_eq!(samples, Samples::F32(vec![300.0, 2.0]));
    }
}
