//! Options that make a PSF of a photograph, and their text form.

use std::fmt;
use std::str::FromStr;

use super::error::PsfError;
use crate::formats::PathOption;
use crate::optics::LensletArray;

/// Names of the options.
pub(super) const NAMES: [&str; 6] = ["dark", "window", "bin", "grid", "rotate", "mirror"];
/// Largest side of a bin, pixels.
pub(super) const LARGEST_BIN: usize = 4096;

/// Grey value of a photograph without light, DN.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PsfDark {
    /// Nothing is subtracted.
    #[default]
    None,
    /// The median of the four corners.
    Corners,
    /// This grey value.
    Level(f64),
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelRectangle {
    /// Row of the first pixel.
    pub top: usize,
    /// Column of the first pixel.
    pub left: usize,
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub cols: usize,
}

/// Part of a photograph that becomes the PSF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PsfWindow {
    /// The whole photograph.
    #[default]
    All,
    /// The central square.
    Square,
    /// The smallest square around the centroid that holds 99 % of the light above the noise floor.
    Auto,
    /// These pixels.
    Rectangle(PixelRectangle),
}

/// Pixels of the window that become one pixel of the PSF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PsfScale {
    /// One.
    #[default]
    One,
    /// Sums of squares of this side; rows and columns that fill none are left out.
    Bin(usize),
    /// Averages of areas, so that the longer side of the PSF has this many pixels.
    Grid(usize),
}

/// How a photograph becomes a PSF. The steps follow in this order: the dark level is subtracted, the window is cut, its
/// pixels are binned, the result is turned and mirrored. Negative values then become 0, and the sum becomes 1.
///
/// The default changes no pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PsfImportOptions {
    /// Grey value without light: `dark=corners`, a number, or `none`.
    pub dark: PsfDark,
    /// Part that is used: `window=auto`, `square`, `all`, or `TOP,LEFT,ROWS,COLS`.
    pub window: PsfWindow,
    /// Size of the pixels: `bin=25` or `grid=32`.
    pub scale: PsfScale,
    /// Quarter turns counter-clockwise: `rotate=90`, `180` or `270`.
    pub quarter_turns: u8,
    /// Whether the PSF is mirrored left to right, after the turn: `mirror=yes`.
    pub is_mirrored: bool,
}

impl fmt::Display for PsfDark {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => formatter.write_str("none"),
            Self::Corners => formatter.write_str("corners"),
            Self::Level(level) => write!(formatter, "{level}"),
        }
    }
}

impl FromStr for PsfDark {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        match text {
            "none" => Ok(Self::None),
            "corners" => Ok(Self::Corners),
            _ => text.parse().ok().filter(|level: &f64| level.is_finite()).map(Self::Level).ok_or(()),
        }
    }
}

impl fmt::Display for PixelRectangle {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { top, left, rows, cols } = self;
        write!(formatter, "{top},{left},{rows},{cols}")
    }
}

impl fmt::Display for PsfWindow {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => formatter.write_str("all"),
            Self::Square => formatter.write_str("square"),
            Self::Auto => formatter.write_str("auto"),
            Self::Rectangle(rectangle) => write!(formatter, "{rectangle}"),
        }
    }
}

impl FromStr for PsfWindow {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        match text {
            "all" => return Ok(Self::All),
            "square" => return Ok(Self::Square),
            "auto" => return Ok(Self::Auto),
            _ => {}
        }
        let numbers: Result<Vec<usize>, _> = text.split(',').map(str::parse).collect();
        match numbers.as_deref() {
            Ok(&[top, left, rows, cols]) if rows > 0 && cols > 0 => {
                Ok(Self::Rectangle(PixelRectangle { top, left, rows, cols }))
            }
            _ => Err(()),
        }
    }
}

impl PsfImportOptions {
    /// Reads options; `origin` names the photograph in messages.
    ///
    /// # Errors
    /// [`PsfError::Option`] for a value that an option cannot have.
    pub(super) fn of(options: &[PathOption], origin: &str) -> Result<Self, PsfError> {
        let mut found = Self::default();
        for option in options {
            let value = option.value.as_str();
            let refuse = |expected: &'static str, advice: &'static str| {
                Err(PsfError::Option { origin: origin.to_owned(), expected, found: option.to_string(), advice })
            };
            let side = |most: usize| value.parse().ok().filter(|side| (1..=most).contains(side));
            match option.name.as_str() {
                "dark" => match value.parse() {
                    Ok(dark) => found.dark = dark,
                    Err(()) => return refuse("dark=corners, dark=none or a grey value", "correct it"),
                },
                "window" => match value.parse() {
                    Ok(window) => found.window = window,
                    Err(()) => {
                        return refuse("window=auto, square, all or TOP,LEFT,ROWS,COLS in pixels", "correct it");
                    }
                },
                "bin" | "grid" if found.scale != PsfScale::One => {
                    return refuse("one of bin, grid and the side after an @", "leave the others out");
                }
                "bin" => match side(LARGEST_BIN) {
                    Some(bin) => found.scale = PsfScale::Bin(bin),
                    None => return refuse("1 to 4096 pixels a side of a bin", "correct it"),
                },
                "grid" => match side(LensletArray::MAX_SIDE) {
                    Some(grid) => found.scale = PsfScale::Grid(grid),
                    None => return refuse("a grid of 1 to 1024 pixels", "correct it"),
                },
                "rotate" => match value.parse::<u16>() {
                    Ok(degrees) if degrees < 360 && degrees % 90 == 0 => found.quarter_turns = (degrees / 90) as u8,
                    _ => return refuse("rotate=90, 180 or 270 degrees counter-clockwise", "correct it"),
                },
                _ => match value {
                    "yes" | "true" => found.is_mirrored = true,
                    "no" | "false" => found.is_mirrored = false,
                    _ => return refuse("mirror=yes or mirror=no", "correct it"),
                },
            }
        }
        Ok(found)
    }

    /// The same with the side after an `@` of the path or of `--grid`: the central square, unless a window is given.
    /// `origin` names the photograph in messages.
    ///
    /// # Errors
    /// [`PsfError::Option`] beside a bin or a grid.
    pub fn resampled(mut self, side: usize, origin: &str) -> Result<Self, PsfError> {
        if self.scale != PsfScale::One {
            let [expected, advice] = ["one of bin, grid and a side to resample to", "leave the others out"];
            return Err(PsfError::Option {
                origin: origin.to_owned(),
                expected,
                found: format!("side {side} too"),
                advice,
            });
        }
        self.scale = PsfScale::Grid(side);
        if self.window == PsfWindow::All {
            self.window = PsfWindow::Square;
        }
        Ok(self)
    }

    /// The options that differ from the default.
    pub fn options(&self) -> Vec<PathOption> {
        let default = Self::default();
        let dark = (self.dark != default.dark).then(|| PathOption::new("dark", self.dark));
        let window = (self.window != default.window).then(|| PathOption::new("window", self.window));
        let scale = match self.scale {
            PsfScale::One => None,
            PsfScale::Bin(bin) => Some(PathOption::new("bin", bin)),
            PsfScale::Grid(grid) => Some(PathOption::new("grid", grid)),
        };
        let turns = self.quarter_turns % 4;
        let rotate = (turns > 0).then(|| PathOption::new("rotate", 90 * u16::from(turns)));
        let mirror = self.is_mirrored.then(|| PathOption::new("mirror", "yes"));
        [dark, window, scale, rotate, mirror].into_iter().flatten().collect()
    }
}

/// Options as the end of a path: `dark=corners&bin=25`.
pub(super) fn query(options: &[PathOption]) -> String {
    options.iter().map(ToString::to_string).collect::<Vec<_>>().join("&")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<PsfImportOptions, PsfError> {
        let options: Vec<PathOption> =
            text.split('&').map(|part| part.split_once('=').unwrap()).map(|(n, v)| PathOption::new(n, v)).collect();
        PsfImportOptions::of(&options, "psf.tif")
    }

    #[test]
    fn options_return_from_their_text() {
        for text in [
            "dark=corners&window=auto&bin=25&rotate=270&mirror=yes",
            "dark=-12.5&window=3,0,40,50&grid=32",
            "window=square&rotate=90",
        ] {
            assert_eq!(query(&of(text).unwrap().options()), text);
        }
        assert_eq!(of("dark=none&window=all&rotate=0&mirror=no").unwrap(), PsfImportOptions::default());
    }

    #[test]
    fn wrong_values_are_named_with_the_values_that_there_are() {
        for (text, expected) in [
            ("dark=low", "dark=corners, dark=none or a grey value, found dark=low"),
            ("dark=nan", "or a grey value"),
            ("window=1,2,3", "TOP,LEFT,ROWS,COLS"),
            ("window=0,0,0,4", "TOP,LEFT,ROWS,COLS"),
            ("bin=0", "1 to 4096 pixels"),
            ("bin=2&grid=3", "one of bin, grid"),
            ("grid=1025", "1 to 1024"),
            ("rotate=45", "rotate=90"),
            ("mirror=maybe", "mirror=yes"),
        ] {
            let error = of(text).unwrap_err().to_string();
            assert!(error.starts_with("psf.tif: ") && error.contains(expected), "{error}");
        }
        let twice = of("bin=2").unwrap().resampled(32, "psf.tif").unwrap_err().to_string();
        assert!(twice.contains("one of bin, grid"), "{twice}");
    }
}
