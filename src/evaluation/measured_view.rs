//! The part of camera images that is estimated, and its orientation.

use ndarray::{Array3, Axis};
use serde::{Deserialize, Serialize};

use crate::evaluation::measured_error::MeasuredError;
use crate::formats::turned;

/// Part of the images that is estimated, and its orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct View {
    /// Part of the image; `None` is the whole.
    pub crop: Option<Crop>,
    /// Quarter turns counter-clockwise, after the crop.
    pub quarter_turns: u8,
    /// Whether the image is mirrored left to right, after the turn.
    pub is_mirrored: bool,
}

/// A rectangle of pixels, written `ROWSxCOLS+TOP+LEFT`, such as `64x96+10+20`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Crop {
    /// Row of the first pixel.
    pub top: usize,
    /// Column of the first pixel.
    pub left: usize,
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub cols: usize,
}

impl std::str::FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("crop {text:?}: expected ROWSxCOLS+TOP+LEFT in pixels, such as 64x96+10+20");
        let numbers: Option<Vec<usize>> = text.split(['x', '+']).map(|part| part.parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[rows, cols, top, left]) if rows > 0 && cols > 0 && text.find('x') < text.find('+') => {
                Ok(Self { top, left, rows, cols })
            }
            _ => Err(wrong()),
        }
    }
}

impl std::fmt::Display for Crop {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{}x{}+{}+{}", self.rows, self.cols, self.top, self.left)
    }
}

impl View {
    /// Cuts, turns and mirrors images of shape (n, rows, cols).
    ///
    /// # Errors
    /// [`MeasuredError::Crop`] for a crop that leaves the images.
    pub(crate) fn of(&self, images: Array3<f32>) -> Result<Array3<f32>, MeasuredError> {
        if *self == Self::default() {
            return Ok(images);
        }
        let (_, rows, cols) = images.dim();
        let mut view = images.view();
        if let Some(crop) = self.crop {
            let ends = (crop.top.saturating_add(crop.rows), crop.left.saturating_add(crop.cols));
            if ends.0 > rows || ends.1 > cols {
                return Err(MeasuredError::Crop { crop: crop.to_string(), rows, cols });
            }
            view.slice_axis_inplace(Axis(1), (crop.top..ends.0).into());
            view.slice_axis_inplace(Axis(2), (crop.left..ends.1).into());
        }
        let view = turned(view, self.quarter_turns, self.is_mirrored);
        Ok(view.as_standard_layout().into_owned())
    }

    /// Summary of the view; `None` for whole images as they are.
    pub(crate) fn describe(&self) -> Option<String> {
        let crop = self.crop.map(|crop| format!("crop {crop}"));
        let turn = (!self.quarter_turns.is_multiple_of(4))
            .then(|| format!("turned by {} degrees", 90 * (self.quarter_turns % 4)));
        let mirror = self.is_mirrored.then(|| "mirrored".to_owned());
        let parts: Vec<String> = [crop, turn, mirror].into_iter().flatten().collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{array, s};

    #[test]
    fn views_are_cut_turned_and_mirrored() {
        let images = Array3::from_shape_fn((1, 4, 5), |(_, r, c)| (10 * r + c) as f32);
        let crop = Some("2x3+1+2".parse().unwrap());
        let of = |view: View| view.of(images.clone()).unwrap().slice(s![0, .., ..]).to_owned();
        let cut = View { crop, ..View::default() };
        assert_eq!(of(cut), array![[12.0, 13.0, 14.0], [22.0, 23.0, 24.0]]);
        assert_eq!(of(View { quarter_turns: 1, ..cut }), array![[14.0, 24.0], [13.0, 23.0], [12.0, 22.0]]);
        assert_eq!(of(View { is_mirrored: true, ..cut }), array![[14.0, 13.0, 12.0], [24.0, 23.0, 22.0]]);
        let outside = View { crop: Some("2x3+3+2".parse().unwrap()), ..View::default() };
        assert!(outside.of(images.clone()).unwrap_err().to_string().contains("2x3+3+2"));
        for wrong in ["", "2x3", "2x3+1", "0x3+1+1", "2+3x1+1", "ax3+1+1", "2x3+1+1+1"] {
            assert!(wrong.parse::<Crop>().is_err(), "{wrong}");
        }
    }
}
