//! How whole images get the size of the field.

use std::fmt;
use std::str::FromStr;

use image::imageops::{FilterType, resize};
use image::{ImageBuffer, Luma};
use serde::{Deserialize, Serialize};

use crate::formats::{PixelStack, Samples};

/// How an image larger than half the field gets its size. Smaller images are tiles of mosaics.
///
/// ```
/// use lenslet_studio::objects::Placement;
///
/// assert_eq!("cropped".parse(), Ok(Placement::Cropped));
/// assert_eq!(Placement::default().to_string(), "scaled");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Placement {
    /// Cut to the aspect ratio of the field and scaled to it.
    #[default]
    Scaled,
    /// Repeated side by side in its own size, from the middle of the field.
    Tiled,
    /// In its own size, cut to the field; dark around a smaller image.
    Cropped,
}

impl Placement {
    /// All placements.
    pub const ALL: [Self; 3] = [Self::Scaled, Self::Tiled, Self::Cropped];

    /// The images of a stack in the size of the field, (rows, cols).
    pub(super) fn fit(self, stack: PixelStack, field: (usize, usize)) -> PixelStack {
        match self {
            _ if (stack.rows, stack.cols) == field => stack,
            Self::Scaled => scaled(stack, field),
            Self::Tiled => moved(stack, field, |index, length| Some(index.rem_euclid(length as isize) as usize)),
            Self::Cropped => moved(stack, field, |index, length| usize::try_from(index).ok().filter(|&at| at < length)),
        }
    }

    /// Description of how images change; `None` where they fit unchanged.
    pub(super) fn change(self, stack: &PixelStack, (rows, cols): (usize, usize)) -> Option<String> {
        if (stack.rows, stack.cols) == (rows, cols) {
            return None;
        }
        let own = format!("{} x {} px", stack.rows, stack.cols);
        let is_cut = stack.rows >= rows && stack.cols >= cols;
        match self {
            Self::Tiled | Self::Cropped if is_cut => Some(format!("the middle {rows} x {cols} of {own}")),
            Self::Tiled => Some(format!("{own} repeated to {rows} x {cols} px")),
            Self::Cropped => Some(format!("{own} in the middle of {rows} x {cols} px")),
            Self::Scaled => {
                let (crop_rows, crop_cols) = crop(stack, (rows, cols));
                let cropped = (crop_rows, crop_cols) != (stack.rows, stack.cols);
                let middle = format!("the middle {crop_rows} x {crop_cols} of {own}");
                match (cropped, (crop_rows, crop_cols) != (rows, cols)) {
                    (false, _) => Some(format!("scaled from {own} to {rows} x {cols} px")),
                    (true, false) => Some(middle),
                    (true, true) => Some(format!("{middle}, scaled to {rows} x {cols} px")),
                }
            }
        }
    }

    /// Description of how images of several sizes change.
    pub(super) fn change_of_several(self, (rows, cols): (usize, usize)) -> String {
        match self {
            Self::Scaled => format!("the middles of images of several sizes, scaled to {rows} x {cols} px"),
            Self::Tiled => format!("images of several sizes, repeated or cut to {rows} x {cols} px"),
            Self::Cropped => format!("images of several sizes, in the middle of {rows} x {cols} px or cut to it"),
        }
    }
}

impl fmt::Display for Placement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Scaled => "scaled",
            Self::Tiled => "tiled",
            Self::Cropped => "cropped",
        })
    }
}

impl FromStr for Placement {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let named = Self::ALL.into_iter().find(|placement| placement.to_string() == text);
        named.ok_or_else(|| format!("placement {text:?}: expected scaled, tiled or cropped"))
    }
}

/// Rows and columns of the central part with the aspect ratio of the field.
fn crop(stack: &PixelStack, (rows, cols): (usize, usize)) -> (usize, usize) {
    let scale = (rows as f64 / stack.rows as f64).max(cols as f64 / stack.cols as f64);
    let part = |length: usize, of: usize| ((length as f64 / scale).round() as usize).clamp(1, of);
    (part(rows, stack.rows), part(cols, stack.cols))
}

/// Crops the middle of each image to the aspect ratio of the field and scales it to the field. The triangle filter
/// averages over areas when it shrinks.
fn scaled(stack: PixelStack, (rows, cols): (usize, usize)) -> PixelStack {
    let (crop_rows, crop_cols) = crop(&stack, (rows, cols));
    let (top, left) = ((stack.rows - crop_rows) / 2, (stack.cols - crop_cols) / 2);
    let mut values = Vec::with_capacity(stack.pages * rows * cols);
    for page in 0..stack.pages {
        let start = page * stack.rows * stack.cols;
        let value =
            |row: u32, col: u32| stack.samples.value(start + (top + row as usize) * stack.cols + left + col as usize);
        let (rows_u32, cols_u32) = (crop_rows as u32, crop_cols as u32);
        // The resizer clips floats to 0..1, so the values are scaled to that range and back.
        let largest = (0..rows_u32).flat_map(|row| (0..cols_u32).map(move |col| (row, col)));
        let largest = largest.map(|(row, col)| value(row, col)).fold(0.0, f32::max);
        if largest == 0.0 {
            values.resize(values.len() + rows * cols, 0.0);
            continue;
        }
        let unit =
            ImageBuffer::<Luma<f32>, _>::from_fn(cols_u32, rows_u32, |col, row| Luma([value(row, col) / largest]));
        let scaled = resize(&unit, cols as u32, rows as u32, FilterType::Triangle);
        values.extend(scaled.into_raw().into_iter().map(|value| value * largest));
    }
    PixelStack { rows, cols, samples: Samples::F32(values), ..stack }
}

/// Images in their own size around the middle of the field. `source` gives the index along a side of that length, or none for darkness.
fn moved(
    stack: PixelStack,
    (rows, cols): (usize, usize),
    source: impl Fn(isize, usize) -> Option<usize>,
) -> PixelStack {
    let middle = |own: usize, side: usize| (own as isize - side as isize).div_euclid(2);
    let (top, left) = (middle(stack.rows, rows), middle(stack.cols, cols));
    let mut values = Vec::with_capacity(stack.pages * rows * cols);
    for page in 0..stack.pages {
        for row in 0..rows {
            let row = source(top + row as isize, stack.rows).map(|row| (page * stack.rows + row) * stack.cols);
            values.extend((0..cols).map(|col| {
                let col = source(left + col as isize, stack.cols);
                row.zip(col).map_or(0.0, |(start, col)| stack.samples.value(start + col))
            }));
        }
    }
    PixelStack { rows, cols, samples: Samples::F32(values), ..stack }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(rows: usize, cols: usize, value: impl Fn(usize, usize) -> f32) -> PixelStack {
        let samples = Samples::F32((0..rows * cols).map(|pixel| value(pixel / cols, pixel % cols)).collect());
        PixelStack::new(1, rows, cols, samples)
    }

    #[test]
    fn scaling_keeps_levels_orientation_and_the_middle() {
        let fit = |stack, field| Placement::Scaled.fit(stack, field);
        let flat = fit(image(270, 480, |_, _| 300.0), (96, 96)).image(0);
        assert!(flat.dim() == (96, 96) && flat.iter().all(|value| (value - 300.0).abs() < 1e-3));
        // A ramp along the columns stays a ramp: 270 px scale to 96, and the middle column stays in the middle.
        let ramp = fit(image(270, 480, |_, col| col as f32), (96, 96)).image(0);
        let slope = (ramp[[50, 80]] - ramp[[50, 16]]) / 64.0;
        assert!((slope - 270.0 / 96.0).abs() < 0.01, "{slope}");
        assert!((f32::midpoint(ramp[[10, 47]], ramp[[10, 48]]) - 239.5).abs() < 0.01);
        assert!((ramp[[10, 30]] - ramp[[90, 30]]).abs() < 1e-3);
        let tall = fit(image(1, 30_000, |_, _| 2.0), (96, 64)).image(0);
        assert!(tall.dim() == (96, 64) && (tall.sum() - 2.0 * 96.0 * 64.0).abs() < 1.0);
    }

    #[test]
    fn cropped_and_tiled_images_keep_their_pixels_around_the_middle() {
        let stack = || image(5, 9, |row, col| (10 * row + col) as f32);
        let cut = Placement::Cropped.fit(stack(), (3, 5)).image(0);
        assert_eq!((cut[[0, 0]], cut[[2, 4]]), (12.0, 36.0));
        assert_eq!(Placement::Tiled.fit(stack(), (3, 5)).image(0), cut);
        let dark = Placement::Cropped.fit(stack(), (9, 9)).image(0);
        assert_eq!((dark[[1, 3]], dark[[2, 3]], dark[[6, 8]], dark[[7, 8]]), (0.0, 3.0, 48.0, 0.0));
        let tiled = Placement::Tiled.fit(stack(), (9, 9)).image(0);
        assert_eq!((tiled[[1, 3]], tiled[[2, 3]], tiled[[6, 8]], tiled[[7, 8]]), (43.0, 3.0, 48.0, 8.0));
    }

    #[test]
    fn changes_are_described_where_there_are_any() {
        let said = |placement: Placement, rows, cols| placement.change(&image(rows, cols, |_, _| 1.0), (96, 64));
        assert_eq!(Placement::ALL.map(|placement| said(placement, 96, 64)), [None, None, None]);
        assert_eq!(said(Placement::Scaled, 192, 128).unwrap(), "scaled from 192 x 128 px to 96 x 64 px");
        assert_eq!(said(Placement::Cropped, 192, 128).unwrap(), "the middle 96 x 64 of 192 x 128 px");
        assert_eq!(said(Placement::Tiled, 60, 60).unwrap(), "60 x 60 px repeated to 96 x 64 px");
        assert_eq!(said(Placement::Cropped, 60, 60).unwrap(), "60 x 60 px in the middle of 96 x 64 px");
    }
}
