//! Single images: PNG, JPEG and BMP in, PNG out.

use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError, ImageFormat, ImageReader, Limits,
};
use ndarray::{ArrayView2, ArrayView3};

use super::bytes::{open, read_bytes};
use super::jpeg::has_its_end;
use super::{CompleteFile, FormatError, ImageFile, PixelStack, Samples, complete_file};

/// Longest side of an image, px.
pub(super) const LONGEST_SIDE_PX: u32 = 32_768;
/// Largest memory of an unpacked image, bytes.
pub(super) const LARGEST_IMAGE_BYTES: u64 = 1 << 30;
const ADVICE: &str = "save the image again as PNG or TIFF";

/// Largest number of bytes that the pixels of a packed file of `length` bytes may take.
///
/// The strongest packing, of an empty 1-bit PNG, is 8 times that of deflate.
pub(super) fn most_unpacked_bytes(length: u64) -> u64 {
    length.saturating_mul(10_000).saturating_add(1 << 20)
}

/// Reads a PNG, JPEG or BMP image. The image must not be larger than its file can hold.
pub(super) fn read_page(file: &ImageFile) -> Result<PixelStack, FormatError> {
    let (source, path) = (file, &file.path);
    let damaged = |error: ImageError| match error {
        ImageError::IoError(error) => FormatError::from_read(path, error),
        ImageError::Limits(_) => FormatError::malformed(
            path,
            format!("at most {LONGEST_SIDE_PX} px a side and 1 GiB of pixels"),
            "a larger image",
            "crop or scale it first",
        ),
        error => FormatError::malformed(path, "an undamaged image", error.to_string(), ADVICE),
    };
    let (file, length) = open(path)?;
    let mut reader = ImageReader::new(BufReader::new(file))
        .with_guessed_format()
        .map_err(|error| FormatError::from_read(path, error))?;
    // Too short for a signature.
    let Some(format) = reader.format() else { return Err(cut_short(path)) };
    if format == ImageFormat::Jpeg && !has_its_end(&read_bytes(path, length)?) {
        return Err(cut_short(path));
    }
    let frames = if format == ImageFormat::Png { frames_of_png(path)? } else { 1 };
    let mut limits = Limits::default();
    limits.max_image_width = Some(LONGEST_SIDE_PX);
    limits.max_image_height = Some(LONGEST_SIDE_PX);
    limits.max_alloc = Some(LARGEST_IMAGE_BYTES);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    if decoder.total_bytes() > most_unpacked_bytes(length).min(LARGEST_IMAGE_BYTES) {
        let found = format!("{width} x {height} px in {length} bytes");
        return Err(FormatError::malformed(path, "an image as large as its header says", found, ADVICE));
    }
    // A camera held upright records that beside the pixels.
    let orientation = decoder.orientation().map_or(1, |orientation| u64::from(orientation.to_exif()));
    let image = DynamicImage::from_decoder(decoder).map_err(damaged)?;
    let channels = usize::from(image.color().channel_count());
    let samples = match image {
        DynamicImage::ImageLuma8(image) => Samples::U8(image.into_raw()),
        DynamicImage::ImageLumaA8(image) => Samples::U8(image.into_raw()),
        DynamicImage::ImageRgb8(image) => Samples::U8(image.into_raw()),
        DynamicImage::ImageRgba8(image) => Samples::U8(image.into_raw()),
        DynamicImage::ImageLuma16(image) => Samples::U16(image.into_raw()),
        DynamicImage::ImageLumaA16(image) => Samples::U16(image.into_raw()),
        DynamicImage::ImageRgb16(image) => Samples::U16(image.into_raw()),
        DynamicImage::ImageRgba16(image) => Samples::U16(image.into_raw()),
        DynamicImage::ImageRgb32F(image) => Samples::F32(image.into_raw()),
        DynamicImage::ImageRgba32F(image) => Samples::F32(image.into_raw()),
        other => {
            let found = format!("{:?}", other.color());
            return Err(FormatError::malformed(path, "grey or RGB pixels of 8, 16 or 32 bits", found, ADVICE));
        }
    };
    let mut stack = PixelStack::interleaved(source, [1, height as usize, width as usize], samples, channels)?;
    if frames > 1 {
        stack.note(format!("only the first of the {frames} frames of the animation"));
    }
    Ok(stack.turned(orientation))
}

fn cut_short(path: &Path) -> FormatError {
    let advice = "the file is cut short; copy it again";
    FormatError::malformed(path, "the end of the image", "the end of the file", advice)
}

/// Number of frames of a PNG image, from the chunk `acTL` of animations (PNG 3, section 11.3.6.1). Damage is left to the
/// decoder.
fn frames_of_png(path: &Path) -> Result<u32, FormatError> {
    let (file, _) = open(path)?;
    let mut reader = BufReader::new(file);
    let mut frames = || -> io::Result<u32> {
        reader.seek(SeekFrom::Start(8))?;
        loop {
            // Length and name of a chunk, and the first number of its data.
            let mut chunk = [0; 12];
            reader.read_exact(&mut chunk)?;
            let number = |at: usize| u32::from_be_bytes([0, 1, 2, 3].map(|byte| chunk[at + byte]));
            match &chunk[4..8] {
                b"acTL" => return Ok(number(8)),
                b"IDAT" | b"IEND" => return Ok(1),
                // The rest of the data, and its checksum.
                _ => reader.seek_relative(i64::from(number(0)))?,
            }
        }
    };
    Ok(frames().unwrap_or(1))
}

/// Writes an 8-bit grey PNG: `low` becomes 0, `high` 255, values beyond are clipped and NaN is 0.
///
/// # Errors
/// [`FormatError::NotWritten`] if it cannot be written, has no pixel, or `high` is not above `low`.
pub fn write_png8(path: &Path, image: ArrayView2<f32>, low: f32, high: f32) -> Result<(), FormatError> {
    complete_png8(path, image, low, high)?.put_in_place()
}

/// [`write_png8`] without the final renaming.
///
/// # Errors
/// As [`write_png8`].
pub fn complete_png8(path: &Path, image: ArrayView2<f32>, low: f32, high: f32) -> Result<CompleteFile, FormatError> {
    let bytes = levels(path, image, low, high, 255.0)?.map(|level| level as u8).collect::<Vec<_>>();
    complete_png(path, &bytes, image.ncols(), image.nrows(), ExtendedColorType::L8)
}

/// Writes a 16-bit grey PNG: `low` becomes 0, `high` 65535, values beyond are clipped and NaN is 0.
///
/// # Errors
/// As [`write_png8`].
pub fn write_png16(path: &Path, image: ArrayView2<f32>, low: f32, high: f32) -> Result<(), FormatError> {
    complete_png16(path, image, low, high)?.put_in_place()
}

/// [`write_png16`] without the final renaming.
///
/// # Errors
/// As [`write_png8`].
pub fn complete_png16(path: &Path, image: ArrayView2<f32>, low: f32, high: f32) -> Result<CompleteFile, FormatError> {
    let levels = levels(path, image, low, high, 65_535.0)?;
    // The encoder takes 16-bit samples in the byte order of the machine.
    let bytes = levels.flat_map(|level| (level as u16).to_ne_bytes()).collect::<Vec<_>>();
    complete_png(path, &bytes, image.ncols(), image.nrows(), ExtendedColorType::L16)
}

/// Writes an 8-bit colour PNG of shape (rows, cols, 3).
///
/// # Errors
/// [`FormatError::NotWritten`] if it cannot be written, has no pixel or the last axis is not 3.
pub fn write_png_rgb(path: &Path, image: ArrayView3<u8>) -> Result<(), FormatError> {
    complete_png_rgb(path, image)?.put_in_place()
}

/// [`write_png_rgb`] without the final renaming.
///
/// # Errors
/// As [`write_png_rgb`].
pub fn complete_png_rgb(path: &Path, image: ArrayView3<u8>) -> Result<CompleteFile, FormatError> {
    let (rows, cols, channels) = image.dim();
    if channels != 3 {
        let source = io::Error::new(io::ErrorKind::InvalidInput, format!("{channels} colours instead of 3"));
        return Err(FormatError::from_write(path, source));
    }
    complete_png(path, &image.iter().copied().collect::<Vec<_>>(), cols, rows, ExtendedColorType::Rgb8)
}

/// Values as whole levels of 0 to `top`, as `f32`, row by row.
fn levels<'a>(
    path: &Path,
    image: ArrayView2<'a, f32>,
    low: f32,
    high: f32,
    top: f32,
) -> Result<impl Iterator<Item = f32> + use<'a>, FormatError> {
    let span = high - low;
    if !(span > 0.0 && span.is_finite()) {
        let source = io::Error::new(io::ErrorKind::InvalidInput, format!("grey levels from {low} to {high}"));
        return Err(FormatError::from_write(path, source));
    }
    Ok(image.into_iter().map(move |value| ((value - low) / span * top).round().clamp(0.0, top)))
}

fn complete_png(
    path: &Path,
    bytes: &[u8],
    cols: usize,
    rows: usize,
    colour: ExtendedColorType,
) -> Result<CompleteFile, FormatError> {
    let (Ok(width), Ok(height)) = (u32::try_from(cols), u32::try_from(rows)) else {
        return Err(FormatError::from_write(path, io::ErrorKind::InvalidInput.into()));
    };
    if bytes.is_empty() {
        let source = io::Error::new(io::ErrorKind::InvalidInput, "an image without pixels");
        return Err(FormatError::from_write(path, source));
    }
    complete_file(path, |writer| {
        PngEncoder::new(writer).write_image(bytes, width, height, colour).map_err(|error| match error {
            ImageError::IoError(error) => error,
            error => io::Error::new(io::ErrorKind::InvalidInput, error),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::super::{read_grey, read_stack};
    use super::*;
    use ndarray::{Array3, arr2};

    #[test]
    fn grey_pngs_read_back_as_levels() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let image = arr2(&[[0.0, 0.5, 1.0], [-3.0, 9.0, f32::NAN]]);
        write_png8(&path, image.view(), 0.0, 1.0).unwrap();
        assert_eq!(read_grey(&path).unwrap(), arr2(&[[0.0, 128.0, 255.0], [0.0, 255.0, 0.0]]));
        write_png16(&path, image.view(), 0.0, 1.0).unwrap();
        assert_eq!(read_grey(&path).unwrap(), arr2(&[[0.0, 32768.0, 65535.0], [0.0, 65535.0, 0.0]]));
        assert_eq!(read_stack(&path).unwrap().samples, Samples::U16(vec![0, 32768, 65535, 0, 65535, 0]));
    }

    #[test]
    fn a_jpeg_that_is_cut_short_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jpg");
        let pixels: Vec<u8> = (0..64 * 64).map(|index| (index * 37 % 251) as u8).collect();
        let mut whole = Vec::new();
        image::codecs::jpeg::JpegEncoder::new(&mut whole).write_image(&pixels, 64, 64, ExtendedColorType::L8).unwrap();
        std::fs::write(&path, &whole).unwrap();
        let read = read_grey(&path).unwrap();
        std::fs::write(&path, [&whole[..], b"what a camera adds"].concat()).unwrap();
        assert_eq!(read_grey(&path).unwrap(), read);
        for length in [whole.len() / 2, whole.len() - 2] {
            std::fs::write(&path, &whole[..length]).unwrap();
            let message = read_grey(&path).unwrap_err().to_string();
            assert!(message.contains("cut short"), "{length}: {message}");
        }
    }

    #[test]
    fn frames_of_an_animation_are_not_left_out_in_silence() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        write_png8(&path, arr2(&[[0.0, 1.0]]).view(), 0.0, 1.0).unwrap();
        let still = std::fs::read(&path).unwrap();
        assert!(read_stack(&path).unwrap().understood.notes.is_empty());
        // The chunk stands behind the header: its length, name, numbers of frames and plays, and checksum.
        let chunk = [&8_u32.to_be_bytes()[..], b"acTL", &3_u32.to_be_bytes(), &[0; 4], &0x5a00_0000_u32.to_be_bytes()];
        let mut data = chunk.concat();
        let mut check = flate2::Crc::new();
        check.update(&data[4..16]);
        data[16..].copy_from_slice(&check.sum().to_be_bytes());
        std::fs::write(&path, [&still[..33], &data, &still[33..]].concat()).unwrap();
        let stack = read_stack(&path).unwrap();
        assert_eq!(stack.understood.notes, ["only the first of the 3 frames of the animation"]);
        std::fs::write(&path, &still[..4]).unwrap();
        let error = read_stack(&path).unwrap_err().to_string();
        assert!(error.contains("the file is cut short; copy it again"), "{error}");
    }

    #[test]
    fn colour_is_weighted_and_orientation_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let mut image = Array3::<u8>::zeros((2, 3, 3));
        image[[1, 0, 1]] = 200;
        write_png_rgb(&path, image.view()).unwrap();
        let grey = read_grey(&path).unwrap();
        assert_eq!(grey.dim(), (2, 3));
        assert!((grey[[1, 0]] - 143.04).abs() < 1e-4 && (grey.sum() - grey[[1, 0]]).abs() < 1e-6);
    }

    #[test]
    fn what_cannot_be_a_image_is_refused_before_writing() {
        let path = Path::new("never-written.png");
        assert!(write_png8(path, arr2(&[[1.0]]).view(), 1.0, 1.0).unwrap_err().to_string().contains("from 1 to 1"));
        assert!(
            write_png8(path, arr2(&[[0.0; 0]]).view(), 0.0, 1.0).unwrap_err().to_string().contains("without pixels")
        );
        assert!(write_png_rgb(path, Array3::zeros((1, 1, 4)).view()).unwrap_err().to_string().contains("4 colours"));
        assert!(!path.exists());
    }
}
