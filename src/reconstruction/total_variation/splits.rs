//! One step of ADMM with the splits crop, gradients and sign.

use ndarray::Array2;
use rayon::prelude::*;
use rustfft::num_complex::Complex32;

use crate::reconstruction::data_term::DataTerm;
use crate::reconstruction::fourier::{Fourier, FourierBuffer};

/// Pixels that one thread works on at least.
const SHARE: usize = 1 << 15;
/// Penalties of sign and gradients, relative to that of the crop and to the root of the energy of the point spread function.
const SIGN_PENALTY: f64 = 0.5;
const GRADIENT_PENALTY: f64 = 0.08;

/// The measurement in units of the mean object, and where it lies on the grid.
pub(super) struct Target<'a> {
    data: &'a DataTerm,
    unit: f32,
    /// First row and column of the measurement on the grid.
    corner: (usize, usize),
}

impl<'a> Target<'a> {
    pub(super) fn new(data: &'a DataTerm, unit: f64, corner: (usize, usize)) -> Self {
        Self { data, unit: unit as f32, corner }
    }
}

/// Penalties of the splits.
#[derive(Clone, Copy)]
pub(super) struct Penalties {
    crop: f32,
    gradients: f32,
    sign: f32,
}

impl Penalties {
    /// Penalties for a typical data weight, and for a point spread function of this energy (sum of its squares).
    ///
    /// Pixels of large weight follow the measurement at once under any penalty, those of small weight only under a small one. So the
    /// typical weight is that of the mean variance. The mean power of the mask over all frequencies is its energy, and that of its lowest
    /// frequency is 1. The penalty of the sign lies between both. As small as the energy, it would let the object of a wide mask stay
    /// negative for thousands of iterations, and without its negative light such an object is far too bright.
    pub(super) fn of(level: f64, energy: f64) -> Self {
        let of_object = |penalty: f64| (penalty * level * energy.sqrt()) as f32;
        Self { crop: level as f32, gradients: of_object(GRADIENT_PENALTY), sign: of_object(SIGN_PENALTY) }
    }
}

/// State of the iterations. All images fill the grid.
pub(super) struct Splits {
    object: Vec<f32>,
    /// The object through the mask.
    image: Vec<f32>,
    /// Scaled dual variables.
    crop_dual: Vec<f32>,
    row_dual: Vec<f32>,
    col_dual: Vec<f32>,
    sign_dual: Vec<f32>,
    /// Split variables minus their duals.
    crop: Vec<f32>,
    row: Vec<f32>,
    col: Vec<f32>,
    sign: Vec<f32>,
    spectrum: Vec<Complex32>,
    other: Vec<Complex32>,
    buffer: FourierBuffer,
}

impl Splits {
    /// Starts at an object of 1 everywhere, whose image is `throughput`.
    pub(super) fn new(fourier: &Fourier, throughput: f32) -> Self {
        let grid = |value: f32| vec![value; fourier.points()];
        Self {
            object: grid(1.0),
            image: grid(throughput),
            crop_dual: grid(0.0),
            row_dual: grid(0.0),
            col_dual: grid(0.0),
            sign_dual: grid(0.0),
            crop: grid(0.0),
            row: grid(0.0),
            col: grid(0.0),
            sign: grid(0.0),
            spectrum: fourier.empty(),
            other: fourier.empty(),
            buffer: fourier.buffer(),
        }
    }

    /// One iteration. Returns the weighted squared residual of the object before it.
    pub(super) fn step(
        &mut self,
        fourier: &Fourier,
        encoder: &[Complex32],
        target: &Target<'_>,
        penalties: Penalties,
        weight: f32,
    ) -> f64 {
        let cols = fourier.shape().1;
        let misfit = self.split_crop(cols, target, penalties.crop);
        self.split_gradients(cols, weight / penalties.gradients);
        self.split_sign();
        self.right_side(cols, penalties);
        fourier.forward(&self.crop, &mut self.spectrum, &mut self.buffer);
        fourier.forward(&self.sign, &mut self.other, &mut self.buffer);
        self.divide(fourier, encoder, penalties);
        fourier.inverse(&mut self.spectrum, &mut self.object);
        fourier.inverse(&mut self.other, &mut self.image);
        misfit
    }

    /// Rows of one thread.
    fn block(cols: usize) -> usize {
        SHARE.div_ceil(cols) * cols
    }

    /// Image behind the mask: nearer to the measurement where there is one.
    fn split_crop(&mut self, cols: usize, target: &Target<'_>, penalty: f32) -> f64 {
        let (data, unit) = (target.data, target.unit);
        let (top, left) = target.corner;
        let (rows, width) = data.shape;
        let block = Self::block(cols);
        let parts: Vec<f64> =
            (self.image.par_chunks(block), self.crop_dual.par_chunks_mut(block), self.crop.par_chunks_mut(block))
                .into_par_iter()
                .enumerate()
                .map(|(index, (image, dual, split))| {
                    let mut misfit = 0.0;
                    let first = index * block / cols;
                    let lines = image.chunks(cols).zip(dual.chunks_mut(cols)).zip(split.chunks_mut(cols));
                    for (row, ((image, dual), split)) in lines.enumerate() {
                        for ((&image, dual), split) in image.iter().zip(dual.iter_mut()).zip(split.iter_mut()) {
                            // Without a measurement the split follows the image, and its dual is 0.
                            *split = image + *dual;
                            *dual = 0.0;
                        }
                        let Some(row) = (first + row).checked_sub(top).filter(|&row| row < rows) else { continue };
                        let measured = row * width..(row + 1) * width;
                        let pixels = data.light[measured.clone()].iter().zip(&data.weights[measured]);
                        let seen = left..left + width;
                        let duals = dual[seen.clone()].iter_mut().zip(&mut split[seen.clone()]);
                        for (((&light, &weight), (dual, split)), &image) in pixels.zip(duals).zip(&image[seen]) {
                            let weight = weight * unit * unit;
                            let light = light / unit;
                            misfit += f64::from(weight * (light - image) * (light - image));
                            let shifted = *split;
                            let nearer = (weight * light + penalty * shifted) / (weight + penalty);
                            *dual = shifted - nearer;
                            *split = nearer - *dual;
                        }
                    }
                    misfit
                })
                .collect();
        parts.iter().sum()
    }

    /// Gradients: shrunk towards 0, rows and columns together.
    fn split_gradients(&mut self, cols: usize, threshold: f32) {
        let block = Self::block(cols);
        let object = &self.object;
        let pixels = object.len();
        (
            self.row_dual.par_chunks_mut(block),
            self.col_dual.par_chunks_mut(block),
            self.row.par_chunks_mut(block),
            self.col.par_chunks_mut(block),
        )
            .into_par_iter()
            .enumerate()
            .for_each(|(index, (row_dual, col_dual, row, col))| {
                let lines = row_dual.chunks_mut(cols).zip(col_dual.chunks_mut(cols));
                let splits = row.chunks_mut(cols).zip(col.chunks_mut(cols));
                for (line, ((row_dual, col_dual), (row, col))) in lines.zip(splits).enumerate() {
                    let start = index * block + line * cols;
                    let here = &object[start..start + cols];
                    let below = (start + cols) % pixels;
                    let below = &object[below..below + cols];
                    for at in 0..cols {
                        let right = if at + 1 == cols { here[0] } else { here[at + 1] };
                        let down = below[at] - here[at] + row_dual[at];
                        let across = right - here[at] + col_dual[at];
                        let length = (down * down + across * across).sqrt();
                        let kept = if length > threshold { 1.0 - threshold / length } else { 0.0 };
                        row_dual[at] = down * (1.0 - kept);
                        col_dual[at] = across * (1.0 - kept);
                        row[at] = down * kept - row_dual[at];
                        col[at] = across * kept - col_dual[at];
                    }
                }
            });
    }

    /// Sign: no negative light.
    fn split_sign(&mut self) {
        let lines =
            (self.object.par_chunks(SHARE), self.sign_dual.par_chunks_mut(SHARE), self.sign.par_chunks_mut(SHARE));
        lines.into_par_iter().for_each(|(object, dual, split)| {
            for ((&object, dual), split) in object.iter().zip(dual).zip(split) {
                let shifted = object + *dual;
                let positive = shifted.max(0.0);
                *dual = shifted - positive;
                *split = positive - *dual;
            }
        });
    }

    /// Right side of the object's equation besides the crop, in `sign`.
    fn right_side(&mut self, cols: usize, penalties: Penalties) {
        let block = Self::block(cols);
        let (row, col) = (&self.row, &self.col);
        let pixels = row.len();
        self.sign.par_chunks_mut(block).enumerate().for_each(|(index, right)| {
            for (line, right) in right.chunks_mut(cols).enumerate() {
                let start = index * block + line * cols;
                let above = (start + pixels - cols) % pixels;
                let (here, above) = (&row[start..start + cols], &row[above..above + cols]);
                let across = &col[start..start + cols];
                for at in 0..cols {
                    let left = if at == 0 { across[cols - 1] } else { across[at - 1] };
                    let transposed = above[at] - here[at] + left - across[at];
                    right[at] = penalties.sign * right[at] + penalties.gradients * transposed;
                }
            }
        });
    }

    /// Spectra of the object, and of the object through the mask, scaled for the inverse transform.
    fn divide(&mut self, fourier: &Fourier, encoder: &[Complex32], penalties: Penalties) {
        let (rows, cols) = fourier.shape();
        let scale = 1.0 / fourier.points() as f32;
        let laplacian = |index: usize, length: usize| {
            2.0 - 2.0 * (std::f64::consts::TAU * index as f64 / length as f64).cos() as f32
        };
        let along_rows: Vec<f32> = (0..rows).map(|index| laplacian(index, rows)).collect();
        let columns = (self.spectrum.par_chunks_mut(rows), self.other.par_chunks_mut(rows), encoder.par_chunks(rows));
        let share = (SHARE / rows).max(1);
        columns.into_par_iter().with_min_len(share).enumerate().for_each(|(col, (spectrum, other, encoder))| {
            let across = laplacian(col, cols);
            for (((value, other), h), &down) in spectrum.iter_mut().zip(other).zip(encoder).zip(&along_rows) {
                let divisor = penalties.crop * h.norm_sqr() + penalties.gradients * (down + across) + penalties.sign;
                let object = (h.conj() * penalties.crop * *value + *other) * (scale / divisor);
                *value = object;
                *other = h * object;
            }
        });
    }

    /// The object without negative light, in photons, from the first pixels of the grid.
    pub(super) fn object(&self, cols: usize, field: (usize, usize), unit: f64) -> Array2<f32> {
        Array2::from_shape_fn(field, |(row, col)| (f64::from(self.object[row * cols + col].max(0.0)) * unit) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn dot(a: &[f32], b: &[f32]) -> f64 {
        a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
    }

    fn noise(random: &mut ChaCha8Rng, count: usize) -> Vec<f32> {
        (0..count).map(|_| random.random::<f32>() - 0.5).collect()
    }

    /// Without a threshold the splits are the gradients, and the right side their transpose.
    #[test]
    fn gradients_and_their_transpose_have_the_same_products() {
        let fourier = Fourier::at_least((12, 10));
        let cols = fourier.shape().1;
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut splits = Splits::new(&fourier, 1.0);
        let object = noise(&mut random, fourier.points());
        splits.object.clone_from(&object);
        splits.split_gradients(cols, 0.0);
        let (row, col) = (splits.row.clone(), splits.col.clone());
        assert!((f64::from(row[0]) - f64::from(object[cols] - object[0])).abs() < 1e-6);
        assert!((f64::from(col[0]) - f64::from(object[1] - object[0])).abs() < 1e-6);
        let (p, q) = (noise(&mut random, fourier.points()), noise(&mut random, fourier.points()));
        splits.row.clone_from(&p);
        splits.col.clone_from(&q);
        splits.sign.fill(0.0);
        splits.right_side(cols, Penalties { crop: 0.0, gradients: 1.0, sign: 0.0 });
        let (first, second) = (dot(&row, &p) + dot(&col, &q), dot(&object, &splits.sign));
        assert!((first - second).abs() < 1e-5 * first.abs().max(1.0), "{first} {second}");
    }

    /// The division by frequencies solves the equation of the object: its right side is that of the object found.
    #[test]
    fn the_object_solves_its_equation() {
        let fourier = Fourier::at_least((16, 12));
        let (points, cols) = (fourier.points(), fourier.shape().1);
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let kernel = Array2::from_shape_fn((4, 3), |(row, col)| ((row * 3 + col) % 5) as f32 / 20.0);
        let encoder = fourier.spectrum_of(kernel.view());
        let penalties = Penalties { crop: 2.0, gradients: 0.3, sign: 0.2 };
        let mut splits = Splits::new(&fourier, 1.0);
        splits.crop = noise(&mut random, points);
        splits.sign = noise(&mut random, points);
        let (crop, other) = (splits.crop.clone(), splits.sign.clone());
        fourier.forward(&splits.crop, &mut splits.spectrum, &mut splits.buffer);
        fourier.forward(&splits.sign, &mut splits.other, &mut splits.buffer);
        splits.divide(&fourier, &encoder, penalties);
        fourier.inverse(&mut splits.spectrum, &mut splits.object);
        fourier.inverse(&mut splits.other, &mut splits.image);
        // <(crop H^T H + gradients L + sign) x, t> = <crop H^T c + o, t> for any t, with H^T and L moved to t.
        let test = noise(&mut random, points);
        let through_mask = |image: &[f32]| {
            let mut spectrum = fourier.empty();
            fourier.forward(image, &mut spectrum, &mut fourier.buffer());
            spectrum.iter_mut().zip(&encoder).for_each(|(value, h)| *value *= h / points as f32);
            let mut out = vec![0.0; points];
            fourier.inverse(&mut spectrum, &mut out);
            out
        };
        let gradients = |image: &[f32]| {
            let mut splits = Splits::new(&fourier, 1.0);
            splits.object = image.to_vec();
            splits.split_gradients(cols, 0.0);
            [splits.row, splits.col]
        };
        let (seen, shown) = (through_mask(&test), through_mask(&splits.object));
        assert!(dot(&shown, &shown) > 0.0 && shown.iter().zip(&splits.image).all(|(a, b)| (a - b).abs() < 1e-5));
        let ([a, b], [c, d]) = (gradients(&splits.object), gradients(&test));
        let left = 2.0 * dot(&shown, &seen) + 0.3 * (dot(&a, &c) + dot(&b, &d)) + 0.2 * dot(&splits.object, &test);
        let right = 2.0 * dot(&crop, &seen) + dot(&other, &test);
        assert!((left - right).abs() < 1e-4 * right.abs().max(1.0), "{left} {right}");
    }
}
