//! Orientation of images: quarter turns and mirror images.

use ndarray::{ArrayView3, Axis};

/// Images of shape (n, rows, cols), turned counter-clockwise by quarter turns, then mirrored left to right.
pub fn turned<T>(mut images: ArrayView3<'_, T>, quarter_turns: u8, is_mirrored: bool) -> ArrayView3<'_, T> {
    for _ in 0..quarter_turns % 4 {
        images.swap_axes(1, 2);
        images.invert_axis(Axis(1));
    }
    if is_mirrored {
        images.invert_axis(Axis(2));
    }
    images
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn images_are_turned_before_they_are_mirrored() {
        let images = array![[[1, 2, 3], [4, 5, 6]]];
        assert_eq!(turned(images.view(), 1, false), array![[[3, 6], [2, 5], [1, 4]]]);
        assert_eq!(turned(images.view(), 1, true), array![[[6, 3], [5, 2], [4, 1]]]);
        assert_eq!(turned(images.view(), 6, false), array![[[6, 5, 4], [3, 2, 1]]]);
    }
}
