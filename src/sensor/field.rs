//! Part of an object in the field of view of the sensor.

/// Offset from a measurement pixel to its object pixel, (rows, cols).
///
/// `psf` is the shape (rows, cols) of the point spread function. A lenslet at its middle pixel (rows / 2, cols / 2) maps
/// object pixel (i, j) plus this offset to measurement pixel (i, j). This follows from the valid convolution, `x(i, j) =
/// sum over k of h(k) o(i + rows - 1 - k_row, j + cols - 1 - k_col)`. The offset is (15, 15) for a PSF of 32 x 32 px. So
/// the 65 x 65 px of a measurement show the middle of a 96 x 96 object.
pub fn field_offset(psf: (usize, usize)) -> (usize, usize) {
    let along = |length: usize| length.saturating_sub(1) - length / 2;
    (along(psf.0), along(psf.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Convolution;
    use ndarray::{Array3, Array4};

    /// A mask of one point in the middle shows every object point at the offset, for even and odd sides.
    #[test]
    fn a_point_in_the_middle_of_the_mask_shows_the_object_at_the_offset() {
        for (rows, cols) in [(32, 32), (5, 8), (1, 1), (4, 7)] {
            let offset = field_offset((rows, cols));
            let mut psf = Array3::zeros((1, rows, cols));
            psf[(0, rows / 2, cols / 2)] = 1.0;
            let mut object = Array4::zeros((1, 1, rows + 9, cols + 11));
            let (row, col) = (3, 6);
            object[(0, 0, row + offset.0, col + offset.1)] = 50.0;
            let plan = Convolution::new((rows + 9, cols + 11), (rows, cols)).unwrap();
            let measured = plan.with_psf(psf.view()).unwrap().measure(object.view(), 0.0).unwrap();
            assert_eq!(measured.dim(), (1, 10, 12));
            for ((_, i, j), value) in measured.indexed_iter() {
                let expected = if (i, j) == (row, col) { 50.0 } else { 0.0 };
                assert!((value - expected).abs() < 1e-3, "{rows} x {cols}: ({i}, {j}) is {value}");
            }
        }
    }
}
