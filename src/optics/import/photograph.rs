//! A PSF photograph: its file with the options of its import, and its pixels.

use std::borrow::Cow;
use std::path::Path;

use ndarray::{Array2, ArrayView2, Axis, s};

use super::corners::CornerLevel;
use super::error::PsfError;
use super::normalise::{check_finite, normalised_psf};
use super::options::{NAMES, PixelRectangle, PsfDark, PsfImportOptions, PsfScale, PsfWindow, query};
use super::report::{BlackLevel, NegativePixels, PsfImportReport};
use super::settings_file::{is_settings_file, open_settings};
use super::window::{binned, central_square, light_square, resampled};

use crate::formats::{
    Channel, GreyValues, ImageFile, ImageSummary, Meaning, PathOption, PixelStack, Saturated, Wrapped, path_text,
    turned,
};
use crate::optics::{LensletArray, PhotographQuality, PsfImage};

/// Least share of all grey value of a level in the corners that may be a black level.
const BLACK_SHARE: f64 = 0.03;
/// Largest standard deviation of a black level, as a share of it. Light varies more.
const BLACK_VARIATION: f64 = 0.5;
/// Largest negative residue of a subtracted dark frame, as a share of the largest pixel.
const LARGEST_NEGATIVE_SHARE: f32 = 0.05;
/// Largest side of a PSF without advice to bin it, pixels.
const LARGE_SIDE: usize = 128;
/// Largest side of the PSF that the advised bins make, pixels.
const ADVISED_SIDE: usize = 48;

/// The file of a PSF photograph, and how it becomes a PSF.
#[derive(Clone, Debug, PartialEq)]
pub struct PsfPhotograph {
    /// The file.
    pub file: ImageFile,
    /// The options.
    pub options: PsfImportOptions,
}

/// An imported PSF.
#[derive(Clone, Debug)]
pub struct ImportedPsf {
    /// The PSF.
    pub image: PsfImage,
    /// How the file was interpreted.
    pub summary: ImageSummary,
    /// What was done with its pixels.
    pub report: PsfImportReport,
}

impl ImportedPsf {
    /// Sentences about file and import, each with the name of the file.
    pub fn notices(&self) -> Vec<String> {
        let all = std::iter::once(self.summary.to_string()).chain(self.report.sentences());
        all.map(|sentence| format!("{}: {sentence}", self.image.origin)).collect()
    }
}

impl PsfPhotograph {
    /// The photograph of a path, `FILE?channel=green&dark=corners&window=auto&bin=25`, or of a settings file (TOML).
    ///
    /// # Errors
    /// [`PsfError`] where there is no such file, or an option is not understood.
    pub fn find(named: &Path) -> Result<Self, PsfError> {
        let (file, options) = ImageFile::find_with(named, &NAMES)?;
        let options = PsfImportOptions::of(&options, &file.path.display().to_string())?;
        if !is_settings_file(&file.path) {
            return Ok(Self { file, options });
        }
        if file.meaning != Meaning::default() || options != PsfImportOptions::default() {
            let [expected, found, advice] =
                ["the options inside the file alone", "others after the ?", "leave them out"];
            return Err(PsfError::Settings { path: file.path, expected, found: found.into(), advice });
        }
        open_settings(&file.path)
    }

    /// The text that [`PsfPhotograph::find`] reads back.
    pub fn text(&self) -> String {
        let options = self.path_options();
        let mark = if options.is_empty() { "" } else { "?" };
        format!("{}{mark}{}", path_text(&self.file.path), query(&options))
    }

    /// All options of the path.
    pub(super) fn path_options(&self) -> Vec<PathOption> {
        [self.file.meaning.options(), self.options.options()].concat()
    }

    /// Reads the pixels. Of a colour image with options of an import it takes the green channel, never a weighted grey
    /// value, unless the path names another channel. `origin` names the file in messages.
    ///
    /// # Errors
    /// [`PsfError`] where the file cannot be read, holds several images, or a pixel is not finite.
    pub fn read(&self, origin: &str) -> Result<PhotographPixels, PsfError> {
        let has_options = self.options != PsfImportOptions::default();
        self.pixels(if has_options { self.file.read_of_colours(Channel::Green) } else { self.file.read() }?, origin)
    }

    /// Reads the pixels as [`PsfPhotograph::read`], of a colour image the green channel even without options.
    ///
    /// # Errors
    /// As [`PsfPhotograph::read`].
    pub fn read_green(&self, origin: &str) -> Result<PhotographPixels, PsfError> {
        self.pixels(self.file.read_of_colours(Channel::Green)?, origin)
    }

    fn pixels(&self, stack: PixelStack, origin: &str) -> Result<PhotographPixels, PsfError> {
        let origin = origin.to_owned();
        let from_colour = stack.from_colour && self.file.meaning.channel.is_none();
        if stack.pages != 1 {
            return Err(PsfError::Several { origin, found: stack.pages });
        }
        let summary = ImageSummary::of(&stack);
        let (white, pixels) = (stack.white, stack.into_array().index_axis_move(Axis(0), 0));
        check_finite(pixels.view(), &origin)?;
        let mut values = GreyValues::default();
        values.add(pixels.view(), white);
        let wrapped = values.wrapped();
        let saturated = values.saturated();
        let corners = CornerLevel::of(pixels.view());
        let sum = sum_of(pixels.view());
        let meaning = self.file.meaning.clone();
        Ok(PhotographPixels { origin, meaning, summary, from_colour, pixels, sum, corners, saturated, wrapped })
    }
}

/// The pixels of a PSF photograph and what is known of them.
#[derive(Clone, Debug)]
pub struct PhotographPixels {
    /// Name of the file in messages.
    origin: String,
    /// Interpretation of the file.
    meaning: Meaning,
    /// How the file was interpreted.
    pub summary: ImageSummary,
    /// Whether the file has colours and its path names none.
    pub from_colour: bool,
    /// Grey values, shape (rows, cols), DN.
    pub pixels: Array2<f32>,
    /// Their sum.
    sum: f64,
    /// Grey values of the corners.
    pub corners: CornerLevel,
    /// Saturated pixels.
    saturated: Option<Saturated>,
    /// Pixels that wrapped around zero.
    wrapped: Option<Wrapped>,
}

impl PhotographPixels {
    /// Options that fit the pixels: a dark level where the corners have one, a window and bins for large photographs.
    pub fn suggested(&self) -> PsfImportOptions {
        let mut options = PsfImportOptions::default();
        let longest = self.pixels.nrows().max(self.pixels.ncols());
        if self.corners.median > 0.0 && (self.suspected().is_some() || longest > LARGE_SIDE) {
            options.dark = PsfDark::Corners;
        }
        if longest > LARGE_SIDE {
            options.window = PsfWindow::Auto;
            let level = self.corners.median as f32;
            let light = self.pixels.mapv(|value| value - level);
            let side = light_square(light.view(), self.corners.sigma, 1).map_or(longest, |square| square.rows);
            let bin = side.div_ceil(ADVISED_SIDE);
            if bin > 1 {
                options.scale = PsfScale::Bin(bin);
            }
        }
        options
    }

    /// The grey value of the corners where it may be a black level.
    fn suspected(&self) -> Option<BlackLevel> {
        let CornerLevel { median: level, sigma } = self.corners;
        let share = level * self.pixels.len() as f64 / self.sum;
        (level > 0.0 && sigma <= BLACK_VARIATION * level && share > BLACK_SHARE).then_some(BlackLevel { level, share })
    }

    /// The PSF that these options make.
    ///
    /// # Errors
    /// [`PsfError`] where no light is left, pixels are negative, or window or bins do not fit.
    pub fn psf(&self, options: PsfImportOptions) -> Result<ImportedPsf, PsfError> {
        let origin = || self.origin.clone();
        let dark = match options.dark {
            PsfDark::None => None,
            PsfDark::Corners => Some(self.corners.median),
            PsfDark::Level(level) => Some(level),
        };
        let (light, negative) = match dark {
            None => self.not_negative()?,
            Some(level) => (Cow::Owned(self.pixels.mapv(|value| (f64::from(value) - level) as f32)), None),
        };
        let window = self.window(options, light.view(), dark)?;
        let PixelRectangle { top, left, rows, cols } = window;
        let part = light.slice(s![top..top + rows, left..left + cols]);
        let (psf, pixel) = match options.scale {
            PsfScale::One => (part.to_owned(), 1.0),
            PsfScale::Bin(bin) if bin > rows || bin > cols => {
                return Err(PsfError::Bin { origin: origin(), rows, cols, bin });
            }
            PsfScale::Bin(bin) => (binned(part, bin), bin as f64),
            PsfScale::Grid(grid) if part.is_empty() => {
                return Err(PsfError::Shape { origin: origin(), rows: grid.min(rows), cols: grid.min(cols) });
            }
            PsfScale::Grid(grid) => (resampled(part, grid), rows.max(cols) as f64 / grid as f64),
        };
        let longest = psf.nrows().max(psf.ncols());
        if longest > LensletArray::MAX_SIDE && options == PsfImportOptions::default() {
            return Err(self.large());
        }
        // The part of the window that fills pixels of the PSF.
        let used = match options.scale {
            PsfScale::Bin(bin) => part.slice(s![..psf.nrows() * bin, ..psf.ncols() * bin]),
            PsfScale::One | PsfScale::Grid(_) => part,
        };
        let suspected = self.suspected().filter(|_| dark.is_none());
        let light_kept = share_of(used, light.view(), suspected);
        // Area averages become sums.
        let used_light = sum_of(used);
        let noise_floor = dark.filter(|_| used_light > 0.0 && self.corners.sigma > 0.0);
        let noise_floor = noise_floor.map(|_| self.corners.sigma * (used.len() as f64).sqrt() / used_light);
        let (psf, below_dark) = cleaned(psf);
        let psf = psf.insert_axis(Axis(0));
        let psf = turned(psf.view(), options.quarter_turns, options.is_mirrored).index_axis_move(Axis(0), 0);
        let psf = psf.as_standard_layout().into_owned();
        if let Some(level) = dark.filter(|_| !psf.is_empty() && psf.iter().all(|&value| value <= 0.0)) {
            return Err(PsfError::Dark { origin: origin(), above: format!(" above the dark level of {level}") });
        }
        let psf = normalised_psf(psf, &self.origin)?;
        let saturated_share = self.saturated.map_or(0.0, |saturated| saturated.share);
        let is_rough = noise_floor.is_some() || saturated_share > 0.0;
        let photograph =
            is_rough.then(|| PhotographQuality { noise_floor: noise_floor.unwrap_or_default(), saturated_share });
        let report = PsfImportReport {
            options,
            photograph: self.pixels.dim(),
            dark: dark.map(|level| BlackLevel { level, share: (level * self.pixels.len() as f64 / self.sum).min(1.0) }),
            suspected,
            window,
            pixel,
            light_kept,
            saturated: self.saturated,
            wrapped: self.wrapped,
            negative,
            below_dark,
            noise_floor,
        };
        let image = PsfImage { psf, origin: origin(), throughput: 1.0, photograph };
        Ok(ImportedPsf { image, summary: self.summary.clone(), report })
    }

    /// The pixels with slightly negative ones set to 0.
    fn not_negative(&self) -> Result<(Cow<'_, Array2<f32>>, Option<NegativePixels>), PsfError> {
        let largest = self.pixels.iter().copied().fold(0.0, f32::max);
        let least = -LARGEST_NEGATIVE_SHARE * largest;
        if let Some(((row, col), &value)) = self.pixels.indexed_iter().find(|(_, value)| **value < least) {
            return Err(PsfError::Negative { origin: self.origin.clone(), row, col, value });
        }
        let negative = NegativePixels::of(self.pixels.view());
        let pixels = match negative {
            Some(_) => Cow::Owned(self.pixels.mapv(|value| value.max(0.0))),
            None => Cow::Borrowed(&self.pixels),
        };
        Ok((pixels, negative))
    }

    /// The pixels that make the PSF; `light` has the dark level subtracted.
    fn window(
        &self,
        options: PsfImportOptions,
        light: ArrayView2<'_, f32>,
        dark: Option<f64>,
    ) -> Result<PixelRectangle, PsfError> {
        let (rows, cols) = light.dim();
        match options.window {
            PsfWindow::All => Ok(PixelRectangle { top: 0, left: 0, rows, cols }),
            PsfWindow::Square => Ok(central_square(rows, cols)),
            PsfWindow::Auto => {
                let bin = if let PsfScale::Bin(bin) = options.scale { bin } else { 1 };
                // A level that is not subtracted is no light.
                let level = if dark.is_some() { 0.0 } else { self.corners.median as f32 };
                let light = light.mapv(|value| value - level);
                let square = light_square(light.view(), self.corners.sigma, bin);
                square.ok_or_else(|| PsfError::Dark { origin: self.origin.clone(), above: " above its noise".into() })
            }
            PsfWindow::Rectangle(window) => {
                let ends = (window.top.saturating_add(window.rows), window.left.saturating_add(window.cols));
                if ends.0 > rows || ends.1 > cols {
                    let (origin, window) = (self.origin.clone(), window.to_string());
                    return Err(PsfError::Window { origin, rows, cols, window });
                }
                Ok(window)
            }
        }
    }

    /// The refusal of a large photograph, with options that fit it.
    fn large(&self) -> PsfError {
        let (rows, cols) = self.pixels.dim();
        let options = self.suggested();
        let mut meaning = self.meaning.clone();
        if self.from_colour {
            meaning.channel = Some(Channel::Green);
        }
        let Ok(ImportedPsf { image, .. }) = self.psf(options) else {
            return PsfError::Shape { origin: self.origin.clone(), rows, cols };
        };
        let (side, query) = (image.psf.nrows(), query(&[meaning.options(), options.options()].concat()));
        PsfError::Large { origin: self.origin.clone(), rows, cols, query, side }
    }
}

impl NegativePixels {
    /// The negative pixels of an image; `None` where there is none.
    fn of(image: ArrayView2<'_, f32>) -> Option<Self> {
        let count = image.iter().filter(|&&value| value < 0.0).count();
        let lowest = image.iter().copied().fold(0.0, f32::min);
        (count > 0).then_some(Self { count, lowest })
    }
}

/// An image with negative values set to 0.
fn cleaned(image: Array2<f32>) -> (Array2<f32>, Option<NegativePixels>) {
    match NegativePixels::of(image.view()) {
        Some(negative) => (image.mapv_into(|value| value.max(0.0)), Some(negative)),
        None => (image, None),
    }
}

fn sum_of(image: ArrayView2<'_, f32>) -> f64 {
    image.iter().map(|&value| f64::from(value)).sum()
}

/// Share of the light in a part, above a suspected black level.
fn share_of(part: ArrayView2<'_, f32>, all: ArrayView2<'_, f32>, black: Option<BlackLevel>) -> f64 {
    let above = |level: f64| {
        let light = |view: ArrayView2<'_, f32>| sum_of(view) - level * view.len() as f64;
        (light(part), light(all))
    };
    let (mut of_part, mut of_all) = above(black.map_or(0.0, |black| black.level));
    if of_all <= 0.0 {
        (of_part, of_all) = above(0.0);
    }
    if of_all > 0.0 { (of_part / of_all).clamp(0.0, 1.0) } else { 1.0 }
}
