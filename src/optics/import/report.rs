//! What an import did with a photograph, in numbers and sentences.

use super::options::{PixelRectangle, PsfDark, PsfImportOptions, PsfScale, PsfWindow};
use crate::formats::{Saturated, Wrapped};
use crate::plural::{counted, one_or_many};
use crate::significant::significant;

/// Significant digits of grey values and sizes.
const DIGITS: i32 = 3;
/// Largest share of the light outside the window without advice.
const LITTLE_LIGHT: f64 = 0.02;

/// Grey value of the corners that may be a black level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlackLevel {
    /// The grey value, DN.
    pub level: f64,
    /// Its share of all grey value.
    pub share: f64,
}

/// Negative pixels that were set to 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NegativePixels {
    /// Their number.
    pub count: usize,
    /// The lowest value.
    pub lowest: f32,
}

/// Where the options of an import are set, for advice on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PsfOptionsIn {
    /// Behind the question mark of a path.
    Path,
    /// In the dialog of the window.
    Dialog,
}

/// What an import did with a photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct PsfImportReport {
    /// The options.
    pub options: PsfImportOptions,
    /// Rows and columns of the photograph.
    pub photograph: (usize, usize),
    /// The dark level that was subtracted; `None` where none was.
    pub dark: Option<BlackLevel>,
    /// Grey value of the corners that was not subtracted and may be a black level.
    pub suspected: Option<BlackLevel>,
    /// Pixels that make the PSF.
    pub window: PixelRectangle,
    /// Side of a pixel of the PSF, pixels of the photograph.
    pub pixel: f64,
    /// Share of the light that the PSF holds, above the dark level or the suspected black level.
    pub light_kept: f64,
    /// Saturated pixels of the photograph.
    pub saturated: Option<Saturated>,
    /// Pixels that look like negative ones that wrapped around zero.
    pub wrapped: Option<Wrapped>,
    /// Slightly negative pixels of the file.
    pub negative: Option<NegativePixels>,
    /// Pixels of the PSF that fell below the dark level.
    pub below_dark: Option<NegativePixels>,
    /// MTF below which there is noise alone; `None` without a dark level.
    pub noise_floor: Option<f64>,
}

impl PsfImportReport {
    /// One sentence for each fact, warnings first; advice is on options of the path.
    pub fn sentences(&self) -> Vec<String> {
        [self.warnings(PsfOptionsIn::Path), self.facts(PsfOptionsIn::Path)].concat()
    }

    /// One sentence for each doubt about the photograph.
    pub fn warnings(&self, options_in: PsfOptionsIn) -> Vec<String> {
        let saturated = self.saturated.map(|Saturated { share, value }| {
            format!(
                "{} of the pixels are at {value}, the largest value: they are saturated and the peaks of the PSF are too \
                 low; expose it for a shorter time",
                percent(share)
            )
        });
        let wrapped = self.wrapped.map(|wrapped| wrapped.to_string());
        let suspected = self.suspected.map(|BlackLevel { level, share }| {
            let advice = match options_in {
                PsfOptionsIn::Path => "?dark=corners subtracts it",
                PsfOptionsIn::Dialog => "choose Median of the corners as dark level to subtract it",
            };
            // Corners brighter than the mean of the image are more than all light.
            let share = if share < 1.0 { format!("{} of all light", percent(share)) } else { "all light".into() };
            format!(
                "the corners have the grey value {}, {share} if it is the black level; {advice}",
                significant(level, DIGITS)
            )
        });
        [saturated, wrapped, suspected].into_iter().flatten().collect()
    }

    /// One sentence for each step of the import.
    pub fn facts(&self, options_in: PsfOptionsIn) -> Vec<String> {
        let dark = self.dark.map(|BlackLevel { level, share }| {
            let of = if self.options.dark == PsfDark::Corners { " from the corners" } else { "" };
            format!(
                "the dark level of {}{of} is subtracted, {} of all grey value",
                significant(level, DIGITS),
                percent(share)
            )
        });
        let negative = self.negative.map(|NegativePixels { count, lowest }| {
            let (pixels, were) = (counted(count, "slightly negative pixel"), one_or_many(count, "was", "were"));
            format!("{pixels} (down to {lowest}) {were} set to 0")
        });
        let below = self.below_dark.map(|NegativePixels { count, .. }| {
            let (pixels, were) = (counted(count, "pixel"), one_or_many(count, "was", "were"));
            format!("{pixels} of the PSF below the dark level {were} set to 0")
        });
        let floor = self.noise_floor.map(|floor| format!("noise hides an MTF below {}", significant(floor, DIGITS)));
        let facts = [dark, self.window_sentence(options_in), self.turn_sentence(), negative, below, floor];
        facts.into_iter().flatten().collect()
    }

    /// Window, size of the pixels and share of the light; `None` for a whole file as it is.
    fn window_sentence(&self, options_in: PsfOptionsIn) -> Option<String> {
        let PsfImportOptions { window, scale, .. } = self.options;
        if window == PsfWindow::All && scale == PsfScale::One {
            return None;
        }
        let PixelRectangle { top, left, rows, cols } = self.window;
        let place = match window {
            PsfWindow::All => "the whole photograph".to_owned(),
            _ => format!("rows {top} to {}, columns {left} to {}", top + rows - 1, left + cols - 1),
        };
        let pixels = match scale {
            PsfScale::One => String::new(),
            PsfScale::Bin(bin) => format!(" in sums of {bin} x {bin} px"),
            PsfScale::Grid(_) => format!(" in areas of {0} x {0} px", significant(self.pixel, DIGITS)),
        };
        let lost = 1.0 - self.light_kept;
        let advice = match (window, options_in) {
            _ if lost < LITTLE_LIGHT => "",
            (PsfWindow::Square, PsfOptionsIn::Path) => {
                "; ?window=auto moves the square to the light, ?window=all keeps all"
            }
            (PsfWindow::Square, PsfOptionsIn::Dialog) => {
                "; choose Square around the light as window to move it to the light, Whole photograph to keep all"
            }
            (PsfWindow::Auto | PsfWindow::Rectangle(_), PsfOptionsIn::Path) => "; ?window=all keeps all",
            (PsfWindow::Auto | PsfWindow::Rectangle(_), PsfOptionsIn::Dialog) => {
                "; choose Whole photograph as window to keep all"
            }
            (PsfWindow::All, _) => "; choose a bin that divides the sides",
        };
        let verb = if window == PsfWindow::All { "holds" } else { "hold" };
        Some(format!(
            "{place}{pixels} {verb} {} of the light, {} is cut off{advice}",
            percent(self.light_kept),
            percent(lost)
        ))
    }

    fn turn_sentence(&self) -> Option<String> {
        let PsfImportOptions { quarter_turns, is_mirrored, .. } = self.options;
        let turns = quarter_turns % 4;
        let turn = (turns > 0).then(|| format!("turned by {} degrees counter-clockwise", 90 * u16::from(turns)));
        let mirror = is_mirrored.then(|| "mirrored left to right".to_owned());
        let parts: Vec<String> = [turn, mirror].into_iter().flatten().collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

/// A share in per cent with two significant digits, and never 100 % or 0 % by rounding.
fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    let rest = percent.min(100.0 - percent).abs();
    let decimals = if rest == 0.0 || rest >= 9.95 { 0.0 } else { (1.0 - rest.log10().floor()).clamp(1.0, 4.0) };
    format!("{percent:.*} %", decimals as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_keep_what_differs_from_nothing_and_all() {
        let texts = [0.0, 1.0, 0.706, 0.0139, 0.9912, 0.0001, 0.99996].map(percent);
        assert_eq!(texts, ["0 %", "100 %", "71 %", "1.4 %", "99.12 %", "0.010 %", "99.9960 %"]);
    }
}
