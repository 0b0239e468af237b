//! The pages of TIFF files.

use std::fs::File;
use std::io::{BufReader, Seek, SeekFrom};
use std::path::Path;

use ndarray::Array2;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::{ColorType, TiffError};

use super::bytes::{open, read_values};
use super::raster::{LARGEST_IMAGE_BYTES, LONGEST_SIDE_PX, most_unpacked_bytes};
use super::samples::Narrowing;
use super::tiff_directory::{Directories, PageTags, StoredValues, photometric, unread_compression};
use super::{Channel, FormatError, ImageFile, PixelStack, Samples};
use crate::plural::{counted, one_or_many};

const ADVICE: &str = "save it as uncompressed grey or RGB TIFF";

/// Reads every page of a TIFF file as grey values of shape (rows, cols), as stored: 1- to 64-bit integers, 16- to 64-bit
/// floats. RGB becomes Rec. 709 luma; alpha is ignored.
///
/// # Errors
/// [`FormatError`] if the file is missing, damaged, of another colour model, or a page is larger than 32,768 px a side or
/// 1 GiB.
pub fn read_pages(path: &Path) -> Result<Vec<Array2<f32>>, FormatError> {
    let file = ImageFile::find(path)?;
    let mut pages = Vec::new();
    for_each_page(&file, |stack| {
        pages.extend((0..stack.pages).map(|page| stack.image(page)));
        Ok(())
    })?;
    Ok(pages)
}

/// Reads a TIFF file whose pages all have one shape, in the number type of the file.
pub(super) fn read_equal_pages(source: &ImageFile) -> Result<PixelStack, FormatError> {
    let path = &source.path;
    let mut stack: Option<PixelStack> = None;
    for_each_page(source, |page| {
        let Some(stack) = stack.as_mut() else {
            stack = Some(page);
            return Ok(());
        };
        if (page.rows, page.cols) != (stack.rows, stack.cols) {
            let expected = format!("pages of {} x {} px like the first", stack.rows, stack.cols);
            let found = format!("page {} of {} x {} px", stack.pages + 1, page.rows, page.cols);
            return Err(FormatError::malformed(path, expected, found, "crop all pages to one shape"));
        }
        stack.pages += page.pages;
        stack.from_colour |= page.from_colour;
        stack.white = stack.white.filter(|_| stack.white == page.white);
        let (numbers, of_page) = (stack.numbers(), page.numbers());
        stack.understood.numbers = Some(if numbers == of_page { numbers } else { "several number types".into() });
        page.understood.notes.into_iter().for_each(|note| stack.note(note));
        stack.samples.append(page.samples);
        Ok(())
    })?;
    stack.ok_or_else(|| FormatError::malformed(path, "at least one page", "none", ADVICE))
}

/// Passes the pages in turn. A page that stands for several images passes them all.
fn for_each_page(
    source: &ImageFile,
    mut take: impl FnMut(PixelStack) -> Result<(), FormatError>,
) -> Result<(), FormatError> {
    let path = &source.path;
    let damaged = |error: TiffError| match error {
        TiffError::IoError(error) => FormatError::from_read(path, error),
        error => FormatError::malformed(path, "an undamaged TIFF file", error.to_string(), ADVICE),
    };
    let (file, length) = open(path)?;
    let directories = Directories::read(&mut BufReader::new(&file));
    // Several pages may share one strip, so the sum over all pages is limited too.
    let mut left = most_unpacked_bytes(length).min(LARGEST_IMAGE_BYTES.max(length.saturating_mul(64)));
    let mut limits = Limits::default();
    limits.decoding_buffer_size = LARGEST_IMAGE_BYTES.min(left) as usize;
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    let reader = StoredValues::new(&file, &directories).map_err(|error| FormatError::from_read(path, error))?;
    let tags_of = |index: usize| {
        let mut tags = directories.pages.get(index).cloned().unwrap_or_default();
        // ImageJ describes a stack on its first page.
        if let Some(first) = directories.pages.first().filter(|first| first.is_imagej() && !tags.is_imagej()) {
            tags.description.clone_from(&first.description);
        }
        tags
    };
    check_tags(path, &tags_of(0))?;
    let mut decoder = Decoder::new(BufReader::new(reader)).map_err(damaged)?.with_limits(limits);
    let reduced = directories.pages.iter().filter(|page| page.is_reduced).count();
    let leaves_out = reduced < directories.pages.len();
    for index in 0.. {
        let tags = tags_of(index);
        if !(tags.is_reduced && leaves_out) {
            let (width, height) = decoder.dimensions().map_err(damaged)?;
            let colour = decoder.colortype().map_err(damaged)?;
            let bytes = u64::from(width)
                .saturating_mul(u64::from(height))
                .saturating_mul(u64::from(colour.num_samples()) * u64::from(colour.bit_depth()).div_ceil(8));
            if width.max(height) > LONGEST_SIDE_PX || bytes > left.min(LARGEST_IMAGE_BYTES) {
                let expected = format!("at most {LONGEST_SIDE_PX} px a side and as many bytes as the file can hold");
                let found = format!("a page of {height} x {width} px");
                return Err(FormatError::malformed(path, expected, found, "crop or scale it first"));
            }
            left -= bytes;
            let channels = channels_of(path, colour)?;
            let mut decoded = DecodingResult::U8(Vec::new());
            let layout = decoder.read_image_to_buffer(&mut decoded).map_err(damaged)?;
            let page = Page { source, tags: &tags, rows: height as usize, cols: width as usize, channels };
            let narrowing = Narrowing::default();
            let (numbers, samples) = samples(decoded, &narrowing);
            narrowing.check(path)?;
            let samples = match colour.bit_depth() {
                bits @ (1 | 2 | 4) => page.unpacked(&samples, bits),
                _ if layout.planes > 1 => interleave(&samples, page.pixels(), channels),
                _ => samples,
            };
            if samples.len() != page.pixels() * channels {
                let found = format!("{} values for {height} x {width} px", samples.len());
                return Err(FormatError::malformed(path, format!("{channels} values per pixel"), found, ADVICE));
            }
            let (others, note) = match directories.pages.len() {
                1 if layout.planes <= 1 => page.others(&file, length, &directories)?,
                pages => (None, page.missing(pages as u64)),
            };
            let mut stack = page.stack(samples, others)?;
            stack.understood.numbers = match colour.bit_depth() {
                bits @ (1 | 2 | 4) => Some(counted(usize::from(bits), "bit")),
                _ => numbers.map(Into::into).or(stack.understood.numbers),
            };
            if let Some(note) = note {
                stack.note(note);
            }
            if reduced > 0 && leaves_out {
                stack.note(format!("{} left out", counted(reduced, "reduced page")));
            }
            take(stack)?;
        }
        if !decoder.more_images() {
            break;
        }
        check_tags(path, &tags_of(index + 1))?;
        decoder.next_image().map_err(damaged)?;
    }
    Ok(())
}

/// Refuses unsupported pages with an error that names the feature.
fn check_tags(path: &Path, tags: &PageTags) -> Result<(), FormatError> {
    let refuse =
        |expected: &str, found: String, advice: &str| Err(FormatError::malformed(path, expected, found, advice));
    if let Some(name) = unread_compression(tags.compression) {
        let expected = "an uncompressed TIFF file or one packed by LZW, Deflate, PackBits or JPEG";
        return refuse(expected, name, "save it without compression");
    }
    // The bits of JPEG streams have one order.
    if tags.fill_order == 2 && tags.compression != 7 {
        let found = "bytes with their lowest bit first (FillOrder 2)".into();
        return refuse(
            "bytes with their highest bit first",
            found,
            "save it with FillOrder 1, tiffcp -f msb2lsb IN OUT",
        );
    }
    if tags.layers > 1 {
        let found = format!("a volume of {} layers in one page (ImageDepth or TileDepth)", tags.layers);
        return refuse("pages of one layer", found, "save each layer as a page of its own");
    }
    // The decoder loses its place in the planes behind the first (tiff 0.11.3, `Image::chunk_data_dimensions`).
    let has_planes = tags.is_planar && tags.samples_per_pixel > 1;
    if has_planes && tags.rows.checked_rem(tags.tile_rows).is_some_and(|rest| rest > 0) {
        let found = "planes of tiles that go beyond the image (PlanarConfiguration 2)".into();
        return refuse(
            "the colours of a pixel together",
            found,
            "save it with PlanarConfiguration 1, tiffcp -p contig IN OUT",
        );
    }
    if matches!(tags.sample_format, 5 | 6) {
        return refuse("real numbers", "complex numbers".into(), "save their squared magnitude, the light");
    }
    if !matches!(tags.bits, 0 | 1 | 2 | 4 | 8 | 16 | 32 | 64) {
        let found = format!("{} bits packed across bytes", tags.bits);
        return refuse("1, 2, 4, 8, 16, 32 or 64 bits", found, "save it with 16 bits");
    }
    let colours = match tags.photometric {
        Some(4) => "a transparency mask",
        Some(5) => "CMYK colours",
        Some(6) => "YCbCr colours",
        Some(8..=10) => "Lab colours",
        _ => return Ok(()),
    };
    refuse("grey or RGB", colours.into(), "save it as grey or RGB TIFF")
}

/// Number of values per pixel.
fn channels_of(path: &Path, colour: ColorType) -> Result<usize, FormatError> {
    match colour {
        ColorType::Gray(_) => Ok(1),
        ColorType::GrayA(_) => Ok(2),
        ColorType::RGB(bits) if bits >= 8 => Ok(3),
        ColorType::RGBA(bits) if bits >= 8 => Ok(4),
        ColorType::Multiband { bit_depth, num_samples } if bit_depth >= 8 => Ok(usize::from(num_samples)),
        _ => {
            let found = format!("{colour:?}");
            Err(FormatError::malformed(path, "grey, or RGB of at least 8 bits", found, ADVICE))
        }
    }
}

/// One page and its interpretation.
struct Page<'a> {
    source: &'a ImageFile,
    tags: &'a PageTags,
    rows: usize,
    cols: usize,
    channels: usize,
}

impl Page<'_> {
    fn pixels(&self) -> usize {
        self.rows * self.cols
    }

    /// Values of 1, 2 or 4 bits as one byte each. Every row starts at a byte.
    fn unpacked(&self, packed: &Samples, bits: u8) -> Samples {
        let Samples::U8(packed) = packed else { return Samples::U8(Vec::new()) };
        let (bits, values) = (usize::from(bits), self.cols * self.channels);
        let row_bytes = (values * bits).div_ceil(8).max(1);
        let value = |row: &[u8], index: usize| {
            let first = index * bits;
            row.get(first / 8).map(|byte| byte >> (8 - bits - first % 8) & ((1 << bits) - 1))
        };
        let rows = packed.chunks(row_bytes);
        Samples::U8(rows.flat_map(|row| (0..values).filter_map(move |index| value(row, index))).collect())
    }

    /// Note on images that the description counts beyond `found`.
    fn missing(&self, found: u64) -> Option<String> {
        let described = self.tags.described_images(self.pixels() as u64)?;
        (found > 1 || self.tags.is_imagej()).then_some(())?;
        let missing = described.checked_sub(found).filter(|&missing| missing > 0)?;
        Some(format!(
            "its description counts {described} images; the other {missing} {} not found in the file",
            one_or_many(missing as usize, "was", "were")
        ))
    }

    /// Images after the only page that have no pages of their own, as ImageJ and tifffile write long stacks. A note
    /// reports fewer images than the description counts.
    fn others(
        &self,
        mut file: &File,
        length: u64,
        directories: &Directories,
    ) -> Result<(Option<Samples>, Option<String>), FormatError> {
        let none = |found| Ok((None, self.missing(found)));
        let Some(described) = self.tags.described_images(self.pixels() as u64).filter(|&count| count > 1) else {
            return none(1);
        };
        let image_bytes = (self.pixels() * self.channels) as u64 * self.tags.bits / 8;
        if self.tags.compression != 1 || image_bytes == 0 {
            return none(1);
        }
        // Pixels end where a directory or its values start.
        let end = directories.end_of_pixels(self.tags.offset).unwrap_or(length).min(length);
        let there = (end.saturating_sub(self.tags.offset) / image_bytes).min(described);
        if there < 2 {
            return none(1);
        }
        let start = self.tags.offset + image_bytes;
        let failed = |error| FormatError::from_read(&self.source.path, error);
        file.seek(SeekFrom::Start(start)).map_err(failed)?;
        let values = (there - 1) as usize * self.pixels() * self.channels;
        let mut reader = BufReader::new(file);
        macro_rules! values {
            ($type:ty, $variant:path, $convert:expr) => {{
                let convert = |bytes: &[u8]| {
                    let mut value = [0; size_of::<$type>()];
                    value.copy_from_slice(bytes);
                    let value = if directories.big_endian {
                        <$type>::from_be_bytes(value)
                    } else {
                        <$type>::from_le_bytes(value)
                    };
                    $convert(value)
                };
                read_values(&mut reader, values, size_of::<$type>(), true, convert).map($variant)
            }};
        }
        let narrowing = Narrowing::default();
        let others = match (self.tags.bits, self.tags.sample_format) {
            (8, 0 | 1) => values!(u8, Samples::U8, |value| value),
            (16, 0 | 1) => values!(u16, Samples::U16, |value| value),
            (8, 2) => values!(i8, Samples::F32, f32::from),
            (16, 2) => values!(i16, Samples::F32, f32::from),
            (32, 0 | 1) => values!(u32, Samples::F32, |value| value as f32),
            (32, 2) => values!(i32, Samples::F32, |value| value as f32),
            (32, 3) => values!(f32, Samples::F32, |value| value),
            (64, 3) => values!(f64, Samples::F32, |value| narrowing.of(value)),
            _ => return none(1),
        };
        narrowing.check(&self.source.path)?;
        Ok((Some(others.map_err(failed)?), self.missing(there)))
    }

    /// The page and the images after it.
    fn stack(&self, mut samples: Samples, others: Option<Samples>) -> Result<PixelStack, FormatError> {
        if let Some(others) = others {
            samples.append(others);
        }
        let pages = samples.len() / (self.pixels() * self.channels).max(1);
        let palette = self.palette(&samples);
        let (samples, channels, note) = match palette {
            Some(Ok(colours)) => {
                (colours, 3, Some("colours of its colour table (?channel=1 takes the stored numbers)"))
            }
            Some(Err(note)) => (samples, self.channels, Some(note)),
            None => (samples, self.channels, None),
        };
        let mut stack = PixelStack::interleaved(self.source, [pages, self.rows, self.cols], samples, channels)?;
        if let Some(note) = note {
            stack.note(note);
        }
        match self.tags.photometric {
            Some(photometric::WHITE_IS_ZERO) => stack.note("stored values, though they are marked white-is-zero"),
            Some(photometric::FILTER_ARRAY) => stack.note("pixels of a colour filter array, as they are"),
            _ => {}
        }
        if let Some(shift) = self.tags.imagej_shift() {
            let values = stack.samples.into_f32().into_iter().map(|value| value + shift).collect();
            (stack.samples, stack.white) = (Samples::F32(values), None);
            stack.understood.numbers = Some("16 bits with sign".into());
        }
        self.tags.imagej_axes().into_iter().for_each(|axes| stack.note(axes));
        Ok(stack.turned(self.tags.orientation))
    }

    /// Colours of pixels that index a colour table, or the reason why they are ignored; `None` without a table.
    fn palette(&self, samples: &Samples) -> Option<Result<Samples, &'static str>> {
        let is_palette = self.tags.photometric == Some(photometric::PALETTE) && self.channels == 1;
        let entries = 1_usize << self.tags.bits.min(16);
        let [red, green, blue] = [0, 1, 2].map(|table| self.tags.palette.get(table * entries..(table + 1) * entries));
        let (true, Some(red), Some(green), Some(blue)) = (is_palette, red, green, blue) else { return None };
        let channel = self.source.meaning.channel;
        if channel == Some(Channel::Number(1)) {
            return Some(Err("stored numbers, without its colour table"));
        }
        // ImageJ tables colour measured values. Photographs are saved with their colours in the table.
        if self.tags.is_imagej() && channel.is_none() {
            return Some(Err("stored values, without its colour table (LUT)"));
        }
        // Tables of 8 bits use the upper bytes, by the standard, or the lower ones.
        let all = || [red, green, blue].into_iter().flatten().copied();
        let is_low = all().all(|value| value < 256);
        let shift = if is_low { 0 } else { 8 };
        let colours = (0..samples.len()).flat_map(|index| {
            let entry = samples.value(index) as usize;
            [red[entry], green[entry], blue[entry]]
        });
        let is_narrow = is_low || all().all(|value| value % 257 == 0 || value % 256 == 0);
        Some(Ok(if is_narrow {
            Samples::U8(colours.map(|value| (value >> shift) as u8).collect())
        } else {
            Samples::U16(colours.collect())
        }))
    }
}

/// Values, and their number type where it is none of [`Samples`].
fn samples(decoded: DecodingResult, narrowing: &Narrowing) -> (Option<&'static str>, Samples) {
    fn narrow<T>(values: Vec<T>, convert: impl Fn(T) -> f32) -> Samples {
        Samples::F32(values.into_iter().map(convert).collect())
    }
    match decoded {
        DecodingResult::U8(values) => (None, Samples::U8(values)),
        DecodingResult::U16(values) => (None, Samples::U16(values)),
        DecodingResult::F32(values) => (None, Samples::F32(values)),
        DecodingResult::U32(values) => (Some("32 bits"), narrow(values, |value| value as f32)),
        DecodingResult::U64(values) => (Some("64 bits"), narrow(values, |value| value as f32)),
        DecodingResult::F16(values) => (Some("16-bit floats"), narrow(values, f32::from)),
        DecodingResult::F64(values) => (Some("64-bit floats"), narrow(values, |value| narrowing.of(value))),
        DecodingResult::I8(values) => (Some("8 bits with sign"), narrow(values, f32::from)),
        DecodingResult::I16(values) => (Some("16 bits with sign"), narrow(values, f32::from)),
        DecodingResult::I32(values) => (Some("32 bits with sign"), narrow(values, |value| value as f32)),
        DecodingResult::I64(values) => (Some("64 bits with sign"), narrow(values, |value| value as f32)),
    }
}

/// Interleaves colour planes to pixels.
fn interleave(planes: &Samples, pixels: usize, channels: usize) -> Samples {
    if planes.len() != pixels * channels {
        return Samples::F32(Vec::new());
    }
    planes.gathered(pixels * channels, |index| index % channels * pixels + index / channels)
}

#[cfg(test)]
mod tests;
