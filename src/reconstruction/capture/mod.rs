//! Captures of a camera and a photograph of its point spread function, prepared for decoders.
//!
//! Colour is read channel by channel. The dark level is subtracted from capture and PSF; saturated pixels count as not measured. Squares of
//! pixels may be averaged. System gain and read noise are estimated from the capture itself.

mod noise;

use std::path::{Path, PathBuf};
use std::str::FromStr;

use ndarray::{Array, Array2, Array3, ArrayView, Axis, Dimension, s};
use thiserror::Error;

use crate::formats::{Channel, FormatError, GreyValues, ImageFile, ImageSummary, PixelStack, Saturated, Wrapped};
use crate::optics::CornerLevel;
use crate::sensor::Noise;
use crate::significant::significant;
use noise::SensorNoise;

/// Shortest and longest side of a capture after binning, px. The noise of a sensor is read from squares of 2 x 2 px.
const SHORTEST_SIDE_PX: usize = 2;
const LONGEST_SIDE_PX: usize = 4096;
/// Least difference of two dark levels that is reported, DN and in standard deviations of the corners of the PSF.
const LEAST_DARK_DIFFERENCE: f64 = 1.0;
const DARK_DEVIATIONS: f64 = 5.0;
/// Channels of colour images, as notices name them after the file.
const COLOURS: [&str; 3] = [", red", ", green", ", blue"];
/// Significant digits of dark levels.
const LEVEL_DIGITS: i32 = 4;
/// Largest share of saturated pixels.
const MOST_SATURATED: f64 = 0.5;

/// Reason why a capture cannot be reconstructed.
#[derive(Debug, Error)]
pub enum CaptureError {
    /// A file cannot be read.
    #[error(transparent)]
    File(#[from] FormatError),
    /// Negative values wrapped around zero.
    #[error("{path}: {wrapped}")]
    Wrapped {
        /// The file.
        path: String,
        /// The values.
        wrapped: Wrapped,
    },
    /// Capture and PSF have other channels.
    #[error(
        "{measurement}: expected the channels of the PSF, found {found} beside {expected} in {psf}; add ?channel=green to both"
    )]
    Channels {
        /// File of the capture.
        measurement: String,
        /// File of the PSF.
        psf: String,
        /// Channels of the capture.
        found: &'static str,
        /// Channels of the PSF.
        expected: &'static str,
    },
    /// A dark frame has colours that the capture does not have.
    #[error("{path}: expected a grey dark frame, as {measurement} is grey, found colours; add ?channel=green to it")]
    DarkColours {
        /// File of the dark frame.
        path: String,
        /// File of the capture.
        measurement: String,
    },
    /// A pixel is NaN or infinite.
    #[error("{path}: expected finite values, found {value} at row {row}, column {col}; repair or leave out that image")]
    NotFinite {
        /// The file.
        path: String,
        /// The value.
        value: f32,
        /// Row of the pixel.
        row: usize,
        /// Its column.
        col: usize,
    },
    /// The file holds several images where one is needed.
    #[error("{path}: expected one image, found {found}; add ?frame=1 to the path to take the first")]
    Several {
        /// The file.
        path: String,
        /// Images of the file.
        found: usize,
    },
    /// An image is too large or too small.
    #[error("{path}: expected {expected}, found {rows} x {cols} px; {advice}")]
    Size {
        /// The file.
        path: String,
        /// The sizes that would do.
        expected: String,
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
        /// What to do.
        advice: &'static str,
    },
    /// Too much of the capture is saturated.
    #[error(
        "{path}: expected light below saturation, found {percent:.0} % of the pixels at {value}; expose it for a shorter time"
    )]
    Saturated {
        /// The file.
        path: String,
        /// Share of saturated pixels, per cent.
        percent: f64,
        /// The largest value.
        value: f32,
    },
    /// Nothing is left above the dark level.
    #[error("{path}: expected light above the dark level of {}, found none; check --dark", significant(*dark, LEVEL_DIGITS))]
    Dark {
        /// The file.
        path: String,
        /// The dark level, DN.
        dark: f64,
    },
}

/// Grey value without light.
#[derive(Clone, Debug, PartialEq)]
pub enum DarkLevel {
    /// The same for all pixels, DN.
    Constant(f64),
    /// A capture without light; of several frames their mean.
    File(PathBuf),
}

impl FromStr for DarkLevel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse::<f64>() {
            Ok(level) if level.is_finite() => Ok(Self::Constant(level)),
            Ok(_) => Err(format!("dark level {text:?}: expected a grey value or a file")),
            Err(_) => Ok(Self::File(text.into())),
        }
    }
}

/// Files of a capture.
#[derive(Clone, Debug, PartialEq)]
pub struct CaptureFiles {
    /// The capture, one image or several.
    pub measurement: PathBuf,
    /// Photograph of the PSF.
    pub psf: PathBuf,
    /// Dark level of both; `None` takes the background of the PSF in its corners.
    pub dark: Option<DarkLevel>,
    /// Side of the squares of pixels that are averaged.
    pub bin: usize,
}

/// A capture ready for decoders.
#[derive(Clone, Debug)]
pub struct Capture {
    /// One channel, or red, green and blue.
    pub channels: Vec<CaptureChannel>,
    /// How the files were read, and what was changed.
    pub notices: Vec<String>,
}

/// A channel of a capture.
#[derive(Clone, Debug)]
pub struct CaptureChannel {
    /// Photons of each pixel above the dark level, shape (n, rows, cols), by the estimated gain; NaN where saturated.
    pub measurements: Array3<f32>,
    /// PSF without background, shape (rows, cols), sum 1.
    pub psf: Array2<f64>,
    /// Estimated system gain, DN per photon.
    pub gain: f64,
    /// Estimated noise, photons.
    pub noise: Noise,
}

impl CaptureChannel {
    /// Photons of this channel as grey values (DN) above the dark level.
    pub fn grey_values<D: Dimension>(&self, photons: ArrayView<'_, f32, D>) -> Array<f32, D> {
        photons.mapv(|photons| (f64::from(photons) * self.gain) as f32)
    }
}

impl CaptureFiles {
    /// Reads and prepares the files.
    ///
    /// # Errors
    /// [`CaptureError`] names the file, what was expected and what was found.
    pub fn open(&self) -> Result<Capture, CaptureError> {
        let mut notices = Vec::new();
        let measured = channels_of(&self.measurement, &mut notices)?;
        let psfs = channels_of(&self.psf, &mut notices)?;
        if measured.len() != psfs.len() {
            let name = |count: usize| if count == 1 { "grey" } else { "colours" };
            let (measurement, psf) = (self.measurement.display().to_string(), self.psf.display().to_string());
            let (found, expected) = (name(measured.len()), name(psfs.len()));
            return Err(CaptureError::Channels { measurement, psf, found, expected });
        }
        let darks = match &self.dark {
            Some(DarkLevel::File(path)) => {
                let darks = channels_of(path, &mut notices)?;
                match darks.as_slice() {
                    [all] if measured.len() > 1 => {
                        notices.push(format!("{}: the same dark frame for all channels", path.display()));
                        vec![Some(all.clone()); measured.len()]
                    }
                    _ if darks.len() == measured.len() => darks.into_iter().map(Some).collect(),
                    _ => {
                        let (path, measurement) = (path.display().to_string(), self.measurement.display().to_string());
                        return Err(CaptureError::DarkColours { path, measurement });
                    }
                }
            }
            _ => vec![None; measured.len()],
        };
        let mut channels = Vec::new();
        let names: &[&str] = if measured.len() == 1 { &[""] } else { &COLOURS };
        for (((measured, psf), dark), name) in measured.into_iter().zip(psfs).zip(darks).zip(names) {
            channels.push(self.channel(measured, psf, dark, (name, &mut notices))?);
        }
        Ok(Capture { channels, notices })
    }

    fn channel(
        &self,
        measured: PixelStack,
        psf: PixelStack,
        dark: Option<PixelStack>,
        (name, notices): (&str, &mut Vec<String>),
    ) -> Result<CaptureChannel, CaptureError> {
        let (path, psf_path) = (self.measurement.display().to_string(), self.psf.display().to_string());
        if psf.pages != 1 {
            return Err(CaptureError::Several { path: psf_path, found: psf.pages });
        }
        let white = measured.white;
        let mut light = finite(measured, &self.measurement)?;
        if let Some(Saturated { share, value }) = mark_saturated(&mut light, white, &path)? {
            let percent = 100.0 * share;
            if percent > 100.0 * MOST_SATURATED {
                return Err(CaptureError::Saturated { path, percent, value });
            }
            notices.push(format!(
                "{path}{name}: {percent:.2} % of the pixels are saturated at {value} and count as not measured"
            ));
        }
        let white = psf.white;
        let mut spread = finite(psf, &self.psf)?;
        if let Some(Saturated { share, value }) = mark_saturated(&mut spread, white, &psf_path)? {
            let percent = 100.0 * share;
            notices.push(format!(
                "{psf_path}{name}: {percent:.2} % of the PSF are saturated at {value}; its peaks are too low"
            ));
            spread.mapv_inplace(|pixel| if pixel.is_nan() { value } else { pixel });
        }
        let dark_path = match &self.dark {
            Some(DarkLevel::File(path)) => path.as_path(),
            _ => Path::new(""),
        };
        let dark = dark.map(|dark| finite(dark, dark_path)).transpose()?.and_then(|dark| dark.mean_axis(Axis(0)));
        let (rows, cols) = (light.len_of(Axis(1)), light.len_of(Axis(2)));
        if let Some(dark) = dark.as_ref().filter(|dark| dark.dim() != (rows, cols)) {
            let expected = format!("{rows} x {cols} px, as the capture");
            let (rows, cols) = dark.dim();
            let path = dark_path.display().to_string();
            return Err(CaptureError::Size {
                path,
                expected,
                rows,
                cols,
                advice: "use a dark frame of the same camera",
            });
        }
        let corners = CornerLevel::of(spread.index_axis(Axis(0), 0));
        let level = match (&self.dark, &dark) {
            (Some(DarkLevel::Constant(level)), _) => *level,
            (_, Some(dark)) => dark.iter().map(|&value| f64::from(value)).sum::<f64>() / dark.len() as f64,
            _ => corners.median,
        };
        let most_apart = LEAST_DARK_DIFFERENCE.max(DARK_DEVIATIONS * corners.sigma);
        if let Some(DarkLevel::File(path)) = &self.dark
            && (level - corners.median).abs() > most_apart
        {
            notices.push(format!(
                "{}{name}: its mean is {level:.1} DN, the corners of the PSF have {:.1} DN; check that both have the same black level",
                path.display(),
                corners.median
            ));
        }
        if self.dark.is_none() && level != 0.0 {
            let level = significant(level, LEVEL_DIGITS);
            notices.push(format!(
                "{psf_path}{name}: dark level of {level} from the corners of the PSF; --dark sets another"
            ));
        }
        subtract(&mut light, dark.as_ref(), level);
        let same_camera = dark.as_ref().filter(|dark| dark.dim() == (spread.len_of(Axis(1)), spread.len_of(Axis(2))));
        subtract(&mut spread, same_camera, level);
        let light = binned(&light, self.bin.max(1));
        let spread =
            binned(&spread, self.bin.max(1)).index_axis_move(Axis(0), 0).mapv(|value| f64::from(value.max(0.0)));
        let (rows, cols) = (light.len_of(Axis(1)), light.len_of(Axis(2)));
        if rows.max(cols) > LONGEST_SIDE_PX || rows.min(cols) < SHORTEST_SIDE_PX {
            let expected = format!("{SHORTEST_SIDE_PX} to {LONGEST_SIDE_PX} px a side");
            let advice = match self.bin {
                _ if rows.max(cols) > LONGEST_SIDE_PX => "raise --bin",
                0..=1 => "choose a larger image",
                _ => "lower --bin",
            };
            return Err(CaptureError::Size { path, expected, rows, cols, advice });
        }
        if rows < spread.nrows() || cols < spread.ncols() {
            let expected = format!("at least the {} x {} px of the PSF", spread.nrows(), spread.ncols());
            return Err(CaptureError::Size { path, expected, rows, cols, advice: "crop the PSF" });
        }
        let total = spread.sum();
        if total <= 0.0 {
            return Err(CaptureError::Dark { path: psf_path, dark: level });
        }
        let sum: f64 = light.iter().filter(|value| !value.is_nan()).map(|&value| f64::from(value)).sum();
        if sum <= 0.0 {
            return Err(CaptureError::Dark { path, dark: level });
        }
        let noise = SensorNoise::of(light.index_axis(Axis(0), 0));
        let measurements = light.mapv(|value| (f64::from(value) / noise.gain) as f32);
        Ok(CaptureChannel {
            measurements,
            psf: spread / total,
            gain: noise.gain,
            noise: Noise::ShotRead { sigma: noise.read_sigma },
        })
    }
}

/// Images of a file, one stack for each channel: grey, or red, green and blue where the path chooses none.
fn channels_of(path: &Path, notices: &mut Vec<String>) -> Result<Vec<PixelStack>, FormatError> {
    let file = ImageFile::find(path)?;
    let first = file.read_of_colours(Channel::Red)?;
    if !first.from_colour {
        notices.push(format!("{}: {}", path.display(), ImageSummary::of(&first)));
        return Ok(vec![first]);
    }
    let shape = format!("{} x {} px", first.rows, first.cols);
    notices.push(format!("{}: red, green and blue, each of {shape}", path.display()));
    Ok(vec![first, file.read_of_colours(Channel::Green)?, file.read_of_colours(Channel::Blue)?])
}

/// The images of a file, shape (n, rows, cols).
fn finite(stack: PixelStack, path: &Path) -> Result<Array3<f32>, CaptureError> {
    let images = stack.into_array();
    let odd = images.indexed_iter().find(|(_, value)| !value.is_finite());
    if let Some(((_, row, col), &value)) = odd {
        return Err(CaptureError::NotFinite { path: path.display().to_string(), value, row, col });
    }
    Ok(images)
}

/// Sets saturated pixels to NaN, of a file whose largest count is `white`. Returns their share and value, where there are any.
///
/// # Errors
/// [`CaptureError::Wrapped`] where negative values wrapped around zero.
fn mark_saturated(images: &mut Array3<f32>, white: Option<u16>, path: &str) -> Result<Option<Saturated>, CaptureError> {
    let mut values = GreyValues::default();
    values.add(images.view(), white);
    if let Some(wrapped) = values.wrapped() {
        return Err(CaptureError::Wrapped { path: path.to_owned(), wrapped });
    }
    let saturated = values.saturated();
    if let Some(Saturated { value: largest, .. }) = saturated {
        images.mapv_inplace(|value| if value == largest { f32::NAN } else { value });
    }
    Ok(saturated)
}

fn subtract(images: &mut Array3<f32>, dark: Option<&Array2<f32>>, level: f64) {
    for mut image in images.outer_iter_mut() {
        match dark {
            Some(dark) => image -= dark,
            None => image.mapv_inplace(|value| (f64::from(value) - level) as f32),
        }
    }
}

/// Means over squares of `bin` px; rows and columns that fill none are left out. A square with a pixel that was not measured is NaN.
fn binned(images: &Array3<f32>, bin: usize) -> Array3<f32> {
    let (count, rows, cols) = images.dim();
    let area = (bin * bin) as f32;
    Array3::from_shape_fn((count, rows / bin, cols / bin), |(n, row, col)| {
        images.slice(s![n, row * bin..(row + 1) * bin, col * bin..(col + 1) * bin]).sum() / area
    })
}

#[cfg(test)]
mod tests;
