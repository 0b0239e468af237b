//! Pixel unshuffle and its inverse: squares of 2 x 2 px become the channels of one pixel, and back (Shi et al. 2016).
//!
//! A convolution of 2 x 2 px with a stride of 2 px is an unshuffle and one matrix product; its transpose is a matrix product and
//! a shuffle.

/// Writes images (rows, cols, channels) of even sides to `out` (rows / 2, cols / 2, 4 channels). The channels of a square come row by
/// row.
///
/// # Panics
/// Where a length does not fit its shape.
pub fn pixel_unshuffle(input: &[f32], (cols, channels): (usize, usize), out: &mut [f32]) {
    pairs_of_rows(input.len(), (cols, channels), |from, to| {
        out[to..to + 2 * channels].copy_from_slice(&input[from..from + 2 * channels]);
    });
}

/// Writes images (rows / 2, cols / 2, 4 channels) to `out` (rows, cols, channels): the inverse of [`pixel_unshuffle`], and its gradient.
///
/// # Panics
/// Where a length does not fit its shape.
pub fn pixel_shuffle(input: &[f32], (cols, channels): (usize, usize), out: &mut [f32]) {
    pairs_of_rows(out.len(), (cols, channels), |to, from| {
        out[to..to + 2 * channels].copy_from_slice(&input[from..from + 2 * channels]);
    });
}

/// Places of all pairs of pixels within a row: in images of `cols` columns, and in their squares.
fn pairs_of_rows(length: usize, (cols, channels): (usize, usize), mut each: impl FnMut(usize, usize)) {
    let (line, pair) = (cols * channels, 2 * channels);
    for row in 0..length / line {
        for col in 0..cols / 2 {
            let square = row / 2 * (cols / 2) + col;
            each(row * line + col * pair, square * 2 * pair + row % 2 * pair);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_become_channels_and_back() {
        let image: Vec<f32> = (0..4 * 6 * 3).map(|i| i as f32).collect();
        let mut squares = vec![f32::NAN; image.len()];
        pixel_unshuffle(&image, (6, 3), &mut squares);
        // Square in row 1, column 2: the lower right pixel is (3, 5).
        let at = |row: usize, col: usize| image[(row * 6 + col) * 3];
        let square = &squares[(3 + 2) * 12..(3 + 3) * 12];
        assert_eq!([square[0], square[3], square[6], square[9]], [at(2, 4), at(2, 5), at(3, 4), at(3, 5)]);
        let mut back = vec![f32::NAN; image.len()];
        pixel_shuffle(&squares, (6, 3), &mut back);
        assert_eq!(back, image);
    }
}
