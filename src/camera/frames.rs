//! Temporal mean and variance of the pixels of a group of frames.

use std::collections::HashSet;
use std::fs::File;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Read;
use std::path::{Path, PathBuf};

use ndarray::ArrayView2;

use super::channel::ColourChoice;
use super::error::CameraError;
use super::series::{FrameGroup, FrameSeries};
use crate::formats::{GreyValues, Wrapped, bits_of};

/// Frames of one group, reduced to temporal statistics of each pixel, row by row, in grey values (DN).
#[derive(Clone, Debug)]
pub(super) struct FrameStack {
    /// Rows and columns.
    pub(super) shape: (usize, usize),
    /// Number of frames.
    pub(super) frames: usize,
    /// Mean of each pixel.
    pub(super) mean: Vec<f64>,
    /// Variance of each pixel over the frames, each less its own mean. For two frames it is half the square of their difference
    /// (EMVA 1288 release 4.0, equation 18), over all pixels half the variance of the difference.
    pub(super) variance: Vec<f64>,
    /// Smallest and largest mean of a frame.
    pub(super) frame_means: (f64, f64),
    /// Smallest and largest value.
    pub(super) range: (f32, f32),
    /// Share of the values that are cut off at 0; 0 where values are negative.
    pub(super) cut_off_share: f64,
    /// Number of frames that repeat an earlier one.
    pub(super) copies: usize,
}

/// Number type and size of all frames of a series, and the first file.
#[derive(Clone, Debug)]
struct Format {
    path: PathBuf,
    shape: (usize, usize),
    white: Option<u16>,
}

/// Reads groups of frames of one size and number type.
pub(super) struct FrameReader<'a> {
    pub(super) series: &'a FrameSeries,
    colour: ColourChoice,
    format: Option<Format>,
    /// Name of the colour that was taken.
    pub(super) colour_text: Option<String>,
    /// Whether a path names a channel, which is then taken.
    pub(super) names_channel: bool,
    /// All values so far.
    values: GreyValues,
    /// Number of files so far, and of those that are JPEG.
    pub(super) files: usize,
    pub(super) jpegs: usize,
}

impl<'a> FrameReader<'a> {
    pub(super) fn new(series: &'a FrameSeries, colour: ColourChoice) -> Self {
        Self {
            series,
            colour,
            format: None,
            colour_text: None,
            names_channel: false,
            values: GreyValues::default(),
            files: 0,
            jpegs: 0,
        }
    }

    /// Values so far that look like negative ones that wrapped around zero.
    pub(super) fn wrapped(&self) -> Option<Wrapped> {
        self.values.wrapped()
    }

    /// Step of the grey values: their greatest common divisor. 0 where values are not whole.
    pub(super) fn step(&self) -> f64 {
        self.values.step().unwrap_or_default()
    }

    /// Bits of the number type; `None` for floats.
    pub(super) fn type_bits(&self) -> Option<u32> {
        self.format.as_ref()?.white.map(bits_of)
    }

    /// Reads the frames of a group one by one.
    pub(super) fn read(&mut self, group: &FrameGroup) -> Result<FrameStack, CameraError> {
        let mut sums: Option<Sums> = None;
        for path in &group.files {
            let file = self.series.image_file(path)?;
            self.names_channel |= file.meaning.channel.is_some();
            let read = self.colour.read(&file)?;
            // One plane of pixels has one dark signal and one gain.
            let Some(plane) = read.planes.into_iter().next() else { continue };
            let shape = (plane.dim().1, plane.dim().2);
            self.check(path, shape, read.white)?;
            self.files += 1;
            self.jpegs += usize::from(is_jpeg(path));
            self.colour_text = read.colour.or(self.colour_text.take());
            for frame in plane.outer_iter() {
                check_finite(path, frame)?;
                self.values.add(frame, read.white);
                sums.get_or_insert_with(|| Sums::new(frame)).add(frame);
            }
        }
        match sums {
            Some(sums) if sums.frames >= 2 => Ok(sums.finish()),
            _ => Err(CameraError::OneFrame {
                path: group.files.first().cloned().unwrap_or_default(),
                group: group.label.clone(),
            }),
        }
    }

    fn check(&mut self, path: &Path, shape: (usize, usize), white: Option<u16>) -> Result<(), CameraError> {
        let Some(Format { path: first, shape: expected, white: expected_white }) = &self.format else {
            self.format = Some(Format { path: path.to_path_buf(), shape, white });
            return Ok(());
        };
        let (path, first) = (path.to_path_buf(), first.clone());
        if shape != *expected {
            return Err(CameraError::Size { path, first, expected: *expected, found: shape });
        }
        if white != *expected_white {
            let depth =
                |white: Option<u16>| white.map_or("floats".to_owned(), |white| format!("{} bits", bits_of(white)));
            return Err(CameraError::Depth { path, first, expected: depth(*expected_white), found: depth(white) });
        }
        Ok(())
    }
}

/// Whether a file that was read is JPEG, by its first bytes.
fn is_jpeg(path: &Path) -> bool {
    let mut start = [0; 3];
    File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == [0xFF, 0xD8, 0xFF]
}

fn check_finite(path: &Path, frame: ArrayView2<'_, f32>) -> Result<(), CameraError> {
    match frame.indexed_iter().find(|(_, value)| !value.is_finite()) {
        None => Ok(()),
        Some(((row, col), &value)) => Err(CameraError::NotFinite { path: path.to_path_buf(), value, row, col }),
    }
}

/// Running sums of the differences to the first frame, each frame less its own mean.
struct Sums {
    shape: (usize, usize),
    frames: usize,
    /// The first frame less its mean.
    first: Vec<f64>,
    sum: Vec<f64>,
    squares: Vec<f64>,
    means: f64,
    frame_means: (f64, f64),
    range: (f32, f32),
    zeros: usize,
    /// Hashes of the frames so far.
    hashes: HashSet<u64>,
    copies: usize,
}

impl Sums {
    fn new(frame: ArrayView2<'_, f32>) -> Self {
        let mean = mean_of(frame);
        let first: Vec<f64> = frame.iter().map(|&value| f64::from(value) - mean).collect();
        let pixels = first.len();
        Self {
            shape: frame.dim(),
            frames: 0,
            first,
            sum: vec![0.0; pixels],
            squares: vec![0.0; pixels],
            means: 0.0,
            frame_means: (f64::INFINITY, f64::NEG_INFINITY),
            range: (f32::INFINITY, f32::NEG_INFINITY),
            zeros: 0,
            hashes: HashSet::new(),
            copies: 0,
        }
    }

    fn add(&mut self, frame: ArrayView2<'_, f32>) {
        let mean = mean_of(frame);
        self.frames += 1;
        self.means += mean;
        self.frame_means = (self.frame_means.0.min(mean), self.frame_means.1.max(mean));
        let sums = self.sum.iter_mut().zip(&mut self.squares);
        for ((&value, first), (sum, squares)) in frame.iter().zip(&self.first).zip(sums) {
            let difference = f64::from(value) - mean - first;
            *sum += difference;
            *squares += difference * difference;
            self.range = (self.range.0.min(value), self.range.1.max(value));
            self.zeros += usize::from(value == 0.0);
        }
        self.copies += usize::from(has_noise(frame) && !self.hashes.insert(hash_of(frame)));
    }

    fn finish(self) -> FrameStack {
        let frames = self.frames as f64;
        let pixels = self.first.len() as f64;
        let level = self.means / frames;
        let mean = self.first.iter().zip(&self.sum).map(|(first, sum)| first + sum / frames + level).collect();
        // Frames less their own means vary by one pixel in all less.
        let lost = if pixels > 1.0 { pixels / (pixels - 1.0) } else { 1.0 };
        let scale = lost / (frames - 1.0);
        let variance = self.squares.iter().zip(&self.sum).map(|(squares, sum)| (squares - sum * sum / frames) * scale);
        FrameStack {
            shape: self.shape,
            frames: self.frames,
            mean,
            variance: variance.map(|variance: f64| variance.max(0.0)).collect(),
            frame_means: self.frame_means,
            range: self.range,
            cut_off_share: if self.range.0 < 0.0 { 0.0 } else { self.zeros as f64 / (frames * pixels) },
            copies: self.copies,
        }
    }
}

/// Whether most pixels lie between the smallest and the largest value. Frames that are saturated or dark have no noise.
fn has_noise(frame: ArrayView2<'_, f32>) -> bool {
    let limits =
        frame.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
    let between = frame.iter().filter(|&&value| limits.0 < value && value < limits.1).count();
    2 * between > frame.len()
}

/// Hash of all pixels, for copies.
pub(crate) fn hash_of(frame: ArrayView2<'_, f32>) -> u64 {
    let mut hasher = DefaultHasher::new();
    frame.iter().for_each(|value| value.to_bits().hash(&mut hasher));
    hasher.finish()
}

fn mean_of(frame: ArrayView2<'_, f32>) -> f64 {
    frame.iter().map(|&value| f64::from(value)).sum::<f64>() / frame.len().max(1) as f64
}

/// Sums of the pixels of a group in blocks of the sensor, for resampling.
#[derive(Clone, Debug)]
pub(super) struct BlockSums {
    /// Number of pixels, sum of their means and sum of their variances, for each block.
    blocks: Vec<[f64; 3]>,
}

/// Mean and temporal variance over pixels of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moments {
    /// Mean, DN.
    pub(super) mean: f64,
    /// Temporal variance, DN^2.
    pub(super) variance: f64,
}

impl BlockSums {
    /// Most blocks along each side of the sensor.
    const SIDE: usize = 16;

    /// Sums over the pixels that count.
    pub(super) fn of(stack: &FrameStack, counts: &[bool]) -> Self {
        let (rows, cols) = stack.shape;
        let side = |length: usize| length.clamp(1, Self::SIDE);
        let across = side(cols);
        let mut blocks = vec![[0.0; 3]; side(rows) * across];
        for (pixel, _) in counts.iter().enumerate().filter(|(_, counts)| **counts) {
            let (row, col) = (pixel / cols, pixel % cols);
            let block = &mut blocks[row * side(rows) / rows * across + col * across / cols];
            block[0] += 1.0;
            block[1] += stack.mean[pixel];
            block[2] += stack.variance[pixel];
        }
        Self { blocks }
    }

    pub(super) fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Moments over all blocks, each counted as often as `draws` says; once each without.
    pub(super) fn moments(&self, draws: Option<&[f64]>) -> Moments {
        let mut sums = [0.0; 3];
        for (index, block) in self.blocks.iter().enumerate() {
            let times = draws.map_or(1.0, |draws| draws[index]);
            sums.iter_mut().zip(block).for_each(|(sum, value)| *sum += times * value);
        }
        let [pixels, mean, variance] = sums;
        Moments { mean: mean / pixels.max(1.0), variance: variance / pixels.max(1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    fn stack(frames: &[ndarray::Array2<f32>]) -> FrameStack {
        let mut sums = Sums::new(frames[0].view());
        for frame in frames {
            sums.add(frame.view());
        }
        sums.finish()
    }

    #[test]
    fn variance_of_two_frames_is_half_that_of_their_difference() {
        let (one, other) = (array![[1.0, 5.0], [9.0, 2.0]], array![[4.0, 7.0], [8.0, 1.0]]);
        let found = stack(&[one.clone(), other.clone()]);
        // Differences 3, 2, -1, -1 less their mean 0.75; over n - 1.
        let expected: f64 = [2.25_f64, 1.25, -1.75, -1.75].iter().map(|value| value * value / 2.0).sum::<f64>() / 3.0;
        let mean = found.variance.iter().sum::<f64>() / 4.0;
        assert!((mean - expected).abs() < 1e-12, "{mean} {expected}");
        assert_eq!(found.mean.iter().sum::<f64>() / 4.0, 37.0 / 8.0);
        assert_eq!((found.frame_means, found.range), ((4.25, 5.0), (1.0, 9.0)));
        // A lamp that flickers between frames adds no variance.
        let flicker = stack(&[one.clone(), one.mapv(|value| value + 3.0)]);
        assert!(flicker.variance.iter().all(|variance| *variance < 1e-12));
    }

    #[test]
    fn blocks_cover_the_sensor_and_leave_pixels_out() {
        let frames =
            [ndarray::Array2::from_shape_fn((37, 50), |(r, c)| (r * 50 + c) as f32), ndarray::Array2::ones((37, 50))];
        let found = stack(&frames);
        let mut counts = vec![true; 37 * 50];
        let all = BlockSums::of(&found, &counts);
        assert_eq!(all.len(), 256);
        let mean = found.mean.iter().sum::<f64>() / 1850.0;
        assert!((all.moments(None).mean - mean).abs() < 1e-9);
        assert_eq!(all.moments(Some(&[1.0; 256])), all.moments(None));
        counts[1..].fill(false);
        assert_eq!(BlockSums::of(&found, &counts).moments(None).mean, found.mean[0]);
    }
}
