//! One step of ADMM with the splits crop, gradients and sign.

use ndarray::Array2;
use rayon::prelude::*;
use rustfft::num_complex::Complex32;

use crate::reconstruction::data_term::DataTerm;
use crate::reconstruction::fourier::{Fourier, FourierBuffer};

/// Pixels that one thread works on at least.
const SHARE: usize = 1 << 15;

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
    /// Penalties for this mean data weight.
    pub(super) fn of(level: f64) -> Self {
        let level = level as f32;
        Self { crop: level, gradients: 0.1 * level, sign: 0.1 * level }
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
        let parts: Vec<f64> = (self.image.par_chunks(block), self.crop_dual.par_chunks_mut(block), self.crop.par_chunks_mut(block))
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
        let lines = (self.object.par_chunks(SHARE), self.sign_dual.par_chunks_mut(SHARE), self.sign.par_chunks_mut(SHARE));
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
