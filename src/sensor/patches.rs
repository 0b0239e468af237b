//! Random patches of measurements.

use ndarray::{Array3, ArrayView3, Axis, s};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::error::SensorError;

/// Places of patches. They are drawn once, so that noisy and noiseless stacks are cut at the same places.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Patches {
    shape: (usize, usize),
    /// (image, first row, first column) of each patch.
    corners: Vec<(usize, usize, usize)>,
}

impl Patches {
    /// Draws `count` places of patches of `shape` (rows, cols), uniformly over a stack of dimensions (n, rows, cols).
    ///
    /// # Errors
    /// [`SensorError::PatchTooLarge`] where no patch fits; [`SensorError::Shape`] where the stack is empty.
    pub fn draw(
        stack: (usize, usize, usize),
        shape: (usize, usize),
        count: usize,
        seed: u64,
    ) -> Result<Self, SensorError> {
        let (images, rows, cols) = stack;
        if shape.0 == 0 || shape.1 == 0 || shape.0 > rows || shape.1 > cols {
            return Err(SensorError::PatchTooLarge { patch_rows: shape.0, patch_cols: shape.1, rows, cols });
        }
        if images == 0 {
            return Err(SensorError::Shape {
                what: "measurements to cut patches from",
                expected: "at least 1".into(),
                found: "none".into(),
            });
        }
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let corners = (0..count)
            .map(|_| {
                let image = random.random_range(0..images);
                (image, random.random_range(0..=rows - shape.0), random.random_range(0..=cols - shape.1))
            })
            .collect();
        Ok(Self { shape, corners })
    }

    /// Draws one place per image, in the order of the images. No two patches share an object.
    ///
    /// # Errors
    /// As [`Patches::draw`].
    pub fn one_each(stack: (usize, usize, usize), shape: (usize, usize), seed: u64) -> Result<Self, SensorError> {
        let mut patches = Self::draw(stack, shape, stack.0, seed)?;
        for (image, corner) in patches.corners.iter_mut().enumerate() {
            corner.0 = image;
        }
        Ok(patches)
    }

    /// (image, first row, first column) of each patch.
    pub fn corners(&self) -> &[(usize, usize, usize)] {
        &self.corners
    }

    /// Cuts the patches, shape (count, rows, cols), from a stack of the dimensions given to [`Patches::draw`].
    ///
    /// # Panics
    /// Where the stack is smaller.
    pub fn cut(&self, stack: ArrayView3<'_, f32>) -> Array3<f32> {
        let images = stack.len_of(Axis(0));
        assert!(self.corners.iter().all(|corner| corner.0 < images), "patches of more than {images} images");
        let mut patches = Array3::zeros((self.corners.len(), self.shape.0, self.shape.1));
        self.cut_some(0, stack, &mut patches);
        patches
    }

    /// Cuts the patches whose images are in `stack` into `patches` of shape (count, rows, cols). `stack` starts with
    /// image `first`. The other patches stay unchanged.
    ///
    /// # Panics
    /// Where the images are smaller than given to [`Patches::draw`], or the patches fewer.
    pub fn cut_some(&self, first: usize, stack: ArrayView3<'_, f32>, patches: &mut Array3<f32>) {
        let images = first..first + stack.len_of(Axis(0));
        for (mut patch, &(image, row, col)) in patches.axis_iter_mut(Axis(0)).zip(&self.corners) {
            if images.contains(&image) {
                patch.assign(&stack.slice(s![image - first, row..row + self.shape.0, col..col + self.shape.1]));
            }
        }
    }

    /// Transpose of [`Patches::cut`]: adds patches of shape (count, rows, cols) to `stack` at their places.
    ///
    /// # Panics
    /// Where the stack is smaller than given to [`Patches::draw`].
    pub fn add_back(&self, patches: ArrayView3<'_, f64>, stack: &mut Array3<f64>) {
        for (patch, &(image, row, col)) in patches.outer_iter().zip(&self.corners) {
            let mut place = stack.slice_mut(s![image, row..row + self.shape.0, col..col + self.shape.1]);
            place += &patch;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_uniform_and_belong_to_their_seed() {
        let patches = Patches::draw((3, 10, 12), (4, 5), 30_000, 1).unwrap();
        assert_eq!(patches, Patches::draw((3, 10, 12), (4, 5), 30_000, 1).unwrap());
        let mut counts = Array3::<f64>::zeros((3, 7, 8));
        for &corner in &patches.corners {
            counts[corner] += 1.0;
        }
        let expected = 30_000.0 / counts.len() as f64;
        let chi_square: f64 = counts.iter().map(|count| (count - expected).powi(2) / expected).sum();
        let freedom = counts.len() as f64 - 1.0;
        assert!((chi_square - freedom).abs() < 4.5 * (2.0 * freedom).sqrt(), "{chi_square}");
    }

    #[test]
    #[should_panic(expected = "more than 1 images")]
    fn no_patch_of_a_missing_image_is_taken_for_dark() {
        let stack = Array3::zeros((2, 9, 9));
        let places = Patches::one_each(stack.dim(), (3, 3), 5).unwrap();
        places.cut(stack.slice(s![..1, .., ..]));
    }

    #[test]
    fn noisy_and_noiseless_patches_share_their_places() {
        let stack = Array3::from_shape_fn((2, 9, 9), |(n, r, c)| (n * 100 + r * 10 + c) as f32);
        let patches = Patches::draw(stack.dim(), (3, 3), 20, 5).unwrap();
        let cut = patches.cut(stack.view());
        assert_eq!(patches.cut(stack.mapv(|value| value + 1.0).view()), &cut + 1.0);
        let mut in_parts = Array3::zeros(cut.dim());
        for (image, stack) in stack.axis_chunks_iter(Axis(0), 1).enumerate() {
            patches.cut_some(image, stack, &mut in_parts);
        }
        assert_eq!(in_parts, cut);
        let first = cut.index_axis(Axis(0), 0);
        assert_eq!(first[(2, 1)] - first[(0, 0)], 21.0, "rows and columns keep their order");
        assert!(Patches::draw((2, 9, 9), (10, 3), 1, 0).is_err());
        assert!(Patches::draw((0, 9, 9), (3, 3), 1, 0).is_err());
    }
}
