//! Valid convolution and its transpose on plain slices, one image at a time, without allocation.

use ndarray::ArrayView2;

use super::{Convolver, Spectrum, Workspace, add_product};

/// Buffers for the convolutions of one thread.
pub struct BlurWorkspace {
    workspace: Workspace,
    part: Spectrum,
    sum: Spectrum,
}

impl Convolver {
    /// Buffers for [`Convolver::blur`] and [`Convolver::blur_transposed`].
    pub fn blur_workspace(&self) -> BlurWorkspace {
        BlurWorkspace {
            workspace: self.plan.workspace(),
            part: self.plan.empty_spectrum(),
            sum: self.plan.empty_spectrum(),
        }
    }

    /// Writes the valid convolution of one object, (planes, rows, cols), without bias into `out` (rows, cols). Rounding
    /// may leave small negative numbers.
    ///
    /// # Panics
    /// Where a length does not match the plan.
    pub fn blur(&self, object: &[f32], out: &mut [f32], memory: &mut BlurWorkspace) {
        let plan = &self.plan;
        let BlurWorkspace { workspace, part, sum } = memory;
        let planes = object.chunks_exact(plan.object.0 * plan.object.1).zip(&self.spectra);
        for (index, (plane, psf)) in planes.enumerate() {
            let spectrum = if index == 0 { &mut *sum } else { &mut *part };
            forward(self, plane, plan.object, workspace, spectrum);
            if index == 0 {
                sum.iter_mut().zip(psf).for_each(|(value, psf)| *value *= psf);
            } else {
                add_product(sum, part, psf);
            }
        }
        let (rows, cols) = plan.measurement_shape();
        let (top, left) = (plan.psf.0 - 1, plan.psf.1 - 1);
        plan.inverse(sum, workspace, top..top + rows, |row, line| {
            let at = (row - top) * cols;
            out[at..at + cols].copy_from_slice(&line[left..left + cols]);
        });
    }

    /// Transpose of [`Convolver::blur`]: maps an image (rows, cols) to the object pixels (planes, rows, cols).
    ///
    /// # Panics
    /// Where a length does not match the plan.
    pub fn blur_transposed(&self, image: &[f32], out: &mut [f32], memory: &mut BlurWorkspace) {
        let plan = &self.plan;
        let BlurWorkspace { workspace, part, sum } = memory;
        forward(self, image, plan.measurement_shape(), workspace, sum);
        let (rows, cols) = plan.object;
        for (plane, psf) in out.chunks_exact_mut(rows * cols).zip(&self.spectra) {
            for ((value, image), psf) in part.iter_mut().zip(sum.iter()).zip(psf) {
                *value = image * psf.conj();
            }
            // The first image pixel lies at the last row and column of the PSF support. So the correlation with the image
            // at the origin is shifted by that offset.
            let (down, right) = (plan.psf.0 - 1, plan.psf.1 - 1);
            let first_col = (plan.extent.1 - right) % plan.extent.1;
            let before_wrap = (plan.extent.1 - first_col).min(cols);
            plan.inverse(part, workspace, 0..plan.extent.0, |row, line| {
                let row = (row + down) % plan.extent.0;
                if row < rows {
                    let out = &mut plane[row * cols..(row + 1) * cols];
                    out[..before_wrap].copy_from_slice(&line[first_col..first_col + before_wrap]);
                    out[before_wrap..].copy_from_slice(&line[..cols - before_wrap]);
                }
            });
        }
    }
}

fn forward(
    convolver: &Convolver,
    image: &[f32],
    shape: (usize, usize),
    workspace: &mut Workspace,
    spectrum: &mut Spectrum,
) {
    // Callers guarantee that the length matches the shape.
    if let Ok(image) = ArrayView2::from_shape(shape, image) {
        convolver.plan.forward(image, workspace, spectrum);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Convolution;
    use ndarray::{Array3, Array4};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn blur_is_the_measurement_and_its_transpose_has_the_same_products() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        for (planes, object, psf) in [(1, (14, 11), (5, 4)), (3, (9, 16), (9, 2)), (2, (72, 50), (41, 19))] {
            let psf = Array3::from_shape_simple_fn((planes, psf.0, psf.1), || random.random::<f64>());
            let convolver = Convolution::new(object, (psf.dim().1, psf.dim().2)).unwrap().with_psf(psf.view()).unwrap();
            let objects = Array4::from_shape_simple_fn((1, planes, object.0, object.1), || random.random::<f32>());
            let measured = convolver.measure(objects.view(), 0.0).unwrap();
            let mut memory = convolver.blur_workspace();
            let mut blurred = vec![f32::NAN; measured.len()];
            convolver.blur(objects.as_slice().unwrap(), &mut blurred, &mut memory);
            for (found, expected) in blurred.iter().zip(&measured) {
                assert!((found - expected).abs() < 1e-4 * expected.abs().max(1.0), "{found} {expected}");
            }
            let image: Vec<f32> = measured.iter().map(|_| random.random::<f32>() - 0.3).collect();
            let mut back = vec![f32::NAN; objects.len()];
            convolver.blur_transposed(&image, &mut back, &mut memory);
            let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum::<f64>();
            let (first, second) = (dot(&blurred, &image), dot(objects.as_slice().unwrap(), &back));
            assert!((first / second - 1.0).abs() < 1e-5, "{first} {second}");
        }
    }
}
