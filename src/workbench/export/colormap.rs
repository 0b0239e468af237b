//! Colours for values. Choosing other colours never changes data.

use std::fmt;
use std::path::Path;

use colorgrad::Gradient;
use ndarray::{Array3, ArrayView2};

use crate::formats::{self, CompleteFile, FormatError};

/// A map from values to colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Colormap {
    /// Black to white.
    Gray,
    /// Dark blue over green to yellow, perceptually uniform.
    #[default]
    Viridis,
    /// Black over red to light yellow.
    Inferno,
    /// Blue to yellow, made for colour-blind readers.
    Cividis,
    /// Blue over white to red, for values around a middle.
    Diverging,
}

impl Colormap {
    /// All maps, in the order of the menu.
    pub const ALL: [Self; 5] = [Self::Gray, Self::Viridis, Self::Inferno, Self::Cividis, Self::Diverging];

    /// 256 colours from the lowest value to the highest, red, green and blue.
    pub fn palette(self) -> Vec<[u8; 3]> {
        let sample = |gradient: &dyn Gradient, reverse: bool| {
            (0..256_u16)
                .map(|step| {
                    let position = f32::from(if reverse { 255 - step } else { step }) / 255.0;
                    let [red, green, blue, _] = gradient.at(position).to_rgba8();
                    [red, green, blue]
                })
                .collect()
        };
        match self {
            Self::Gray => (0..=255).map(|level| [level; 3]).collect(),
            Self::Viridis => sample(&colorgrad::preset::viridis(), false),
            Self::Inferno => sample(&colorgrad::preset::inferno(), false),
            Self::Cividis => sample(&colorgrad::preset::cividis(), false),
            Self::Diverging => sample(&colorgrad::preset::rd_bu(), true),
        }
    }

    /// Index of a value's colour in the palette; what is not a number gets the lowest.
    pub fn index(value: f32, (low, high): (f32, f32)) -> usize {
        let share = (value - low) / (high - low);
        // The cast saturates, and NaN becomes 0.
        (share * 255.0 + 0.5).clamp(0.0, 255.0) as usize
    }

    /// Writes an image as a PNG in these colours, one pixel per pixel.
    ///
    /// # Errors
    /// [`FormatError`] where the file cannot be written.
    pub fn write_png(self, image: ArrayView2<'_, f32>, limits: (f32, f32), path: &Path) -> Result<(), FormatError> {
        self.complete_png(image, limits, path)?.put_in_place()
    }

    /// As [`Colormap::write_png`], up to the name of the file.
    ///
    /// # Errors
    /// As [`Colormap::write_png`].
    pub(crate) fn complete_png(
        self,
        image: ArrayView2<'_, f32>,
        limits: (f32, f32),
        path: &Path,
    ) -> Result<CompleteFile, FormatError> {
        let palette = self.palette();
        let (rows, cols) = image.dim();
        let pixels = Array3::from_shape_fn((rows, cols, 3), |(row, col, channel)| {
            palette[Self::index(image[(row, col)], limits)][channel]
        });
        formats::complete_png_rgb(path, pixels.view())
    }
}

impl fmt::Display for Colormap {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Gray => "Gray",
            Self::Viridis => "Viridis",
            Self::Inferno => "Inferno",
            Self::Cividis => "Cividis",
            Self::Diverging => "Diverging",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_run_from_dark_to_light() {
        let light = |[red, green, blue]: [u8; 3]| u32::from(red) * 2 + u32::from(green) * 5 + u32::from(blue);
        for map in [Colormap::Gray, Colormap::Viridis, Colormap::Inferno, Colormap::Cividis] {
            let palette = map.palette();
            assert_eq!(palette.len(), 256);
            assert!(palette.windows(8).all(|run| light(run[7]) >= light(run[0])), "{map}");
        }
        let diverging = Colormap::Diverging.palette();
        assert!(diverging[0][2] > diverging[0][0], "low values are blue");
        assert!(diverging[255][0] > diverging[255][2], "high values are red");
    }

    #[test]
    fn values_find_their_colour() {
        assert_eq!(Colormap::index(5.0, (5.0, 9.0)), 0);
        assert_eq!(Colormap::index(9.0, (5.0, 9.0)), 255);
        assert_eq!(Colormap::index(700.0, (5.0, 9.0)), 255);
        assert_eq!(Colormap::index(f32::NAN, (5.0, 9.0)), 0);
        assert_eq!(Colormap::index(3.0, (3.0, 3.0)), 0);
    }
}
