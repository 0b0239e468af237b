//! Leading principal components of many samples, by randomised subspace iteration (Halko, Martinsson and Tropp, SIAM Review 53, 2011).

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, Side};
use ndarray::{Array2, ArrayView2};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Directions beyond those asked for, which make these accurate.
const OVERSAMPLING: usize = 32;
/// Subspace iterations. Two suffice for spectra that fall as slowly as those of natural images.
const ITERATIONS: usize = 2;
/// Least variance of a component relative to the first. Below, it is rounding.
const LEAST_SHARE: f64 = 1e-6;
/// Seed of the start directions, which the result hardly depends on.
const SEED: u64 = 1;

/// Orthonormal directions, one a column, by falling variance of the samples along them.
pub(super) struct Components {
    /// Shape (pixels, count).
    pub(super) directions: Mat<f32>,
    /// Variance along each direction.
    pub(super) variances: Vec<f64>,
}

/// Samples, one a row of a row-major array, as the columns of a matrix.
pub(super) fn columns(samples: &Array2<f32>) -> MatRef<'_, f32> {
    let (count, pixels) = samples.dim();
    // Arrays of this module are made row by row.
    MatRef::from_column_major_slice(samples.as_slice().unwrap_or_default(), pixels, count)
}

/// `a b`.
pub(super) fn product(a: MatRef<'_, f32>, b: MatRef<'_, f32>) -> Mat<f32> {
    let mut result = Mat::zeros(a.nrows(), b.ncols());
    matmul(result.as_mut(), Accum::Replace, a, b, 1.0, Par::rayon(0));
    result
}

/// Work whose bits depend on the number of threads: QR and eigenvectors of faer. Both are small here.
fn on_one_thread<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(pool) => pool.install(work),
        // Without another thread the bits may differ from those of another machine, within rounding.
        Err(_) => work(),
    }
}

impl Components {
    /// At most `count` components of samples (n, pixels) with mean 0; fewer where samples differ in fewer ways.
    pub(super) fn of(samples: &Array2<f32>, count: usize) -> Self {
        let (rows, pixels) = samples.dim();
        let most = rows.min(pixels);
        let (count, wide) = (count.min(most), (count + OVERSAMPLING).min(most));
        let x = columns(samples);
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        let mut directions = Mat::from_fn(pixels, wide, |_, _| random.sample::<f32, _>(StandardNormal));
        for _ in 0..=ITERATIONS {
            let scores = product(x.transpose(), directions.as_ref());
            let wide = product(x, scores.as_ref());
            directions = on_one_thread(|| wide.qr().compute_thin_Q());
        }
        let scores = product(x.transpose(), directions.as_ref());
        let gram = product(scores.transpose(), scores.as_ref());
        let covariance = Mat::from_fn(wide, wide, |i, j| f64::from(gram[(i, j)]) / rows.max(1) as f64);
        let Ok(eigen) = on_one_thread(|| covariance.self_adjoint_eigen(Side::Lower)) else {
            // Does not converge for samples that are not finite, which have been refused before.
            return Self { directions: Mat::zeros(pixels, 0), variances: Vec::new() };
        };
        // Eigenvalues rise.
        let values = eigen.S().column_vector();
        let least = LEAST_SHARE * values[wide.max(1) - 1];
        let count = (0..count).take_while(|j| values[wide - 1 - j] > least).count();
        let rotation = Mat::from_fn(wide, count, |i, j| eigen.U()[(i, wide - 1 - j)] as f32);
        Self {
            directions: product(directions.as_ref(), rotation.as_ref()),
            variances: (0..count).map(|j| values[wide - 1 - j].max(0.0)).collect(),
        }
    }
}

/// Share of the variance of samples that components were not found from, relative to the share of those they were found from: by component,
/// averaged over neighbours. Below 1, as components also fit what their samples have by chance.
pub(super) fn held_out_shares(found_from: &Array2<f32>, held_out: &Array2<f32>, count: usize) -> Vec<f64> {
    let components = Components::of(found_from, count);
    let scores = product(columns(held_out).transpose(), components.directions.as_ref());
    let samples = held_out.nrows().max(1) as f64;
    let variance = |k: usize| scores.col(k).iter().map(|&score| f64::from(score).powi(2)).sum::<f64>() / samples;
    let seen = &components.variances;
    // Images that are brighter or darker than others by chance do not count.
    let brightness = total_variance(held_out) / total_variance(found_from);
    let new: Vec<f64> = (0..seen.len()).map(|k| variance(k) / brightness).collect();
    // A single ratio scatters with the few images that are held out. Later components are more alike.
    let around = |k: usize| {
        let reach = (k / 2).max(8);
        k.saturating_sub(reach)..(k + reach + 1).min(seen.len())
    };
    let share = |k: usize| {
        let ratios: Vec<f64> = around(k).filter(|&k| seen[k] > 0.0).map(|k| new[k] / seen[k]).collect();
        if ratios.is_empty() { 0.0 } else { (ratios.iter().sum::<f64>() / ratios.len() as f64).min(1.0) }
    };
    (0..seen.len()).map(share).collect()
}

/// Sum of the variances of all columns of samples (n, pixels) with mean 0.
fn total_variance(samples: &Array2<f32>) -> f64 {
    samples.iter().map(|&value| f64::from(value).powi(2)).sum::<f64>() / samples.nrows().max(1) as f64
}

/// Mean of every column of samples (n, pixels).
pub(super) fn mean_of(samples: ArrayView2<'_, f32>) -> Vec<f64> {
    let mut mean = vec![0.0; samples.ncols()];
    for sample in samples.rows() {
        mean.iter_mut().zip(sample).for_each(|(sum, &value)| *sum += f64::from(value));
    }
    for sum in &mut mean {
        *sum /= samples.nrows().max(1) as f64;
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn components_are_the_same_on_any_number_of_threads() {
        let samples = Array2::from_shape_fn((700, 400), |(row, col)| ((row * 37 + col * col * 11) % 101) as f32 - 50.0);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Components::of(&samples, 300).directions)
        };
        assert!(run(1) == run(3));
    }

    #[test]
    fn components_of_a_known_covariance_are_found() {
        // Three directions of the standard deviations 9, 5 and 2 and white noise of 0.1 in 40 dimensions.
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut samples = Array2::<f32>::zeros((4000, 40));
        for mut sample in samples.rows_mut() {
            for (axis, deviation) in [9.0, 5.0, 2.0].into_iter().enumerate() {
                sample[7 * axis + 3] = deviation * random.sample::<f32, _>(StandardNormal);
            }
            sample.mapv_inplace(|value| value + 0.1 * random.sample::<f32, _>(StandardNormal));
        }
        let mean = mean_of(samples.view());
        for mut sample in samples.rows_mut() {
            sample.iter_mut().zip(&mean).for_each(|(value, &mean)| *value -= mean as f32);
        }
        let found = Components::of(&samples, 3);
        for (k, deviation) in [9.0_f64, 5.0, 2.0].into_iter().enumerate() {
            assert!((found.variances[k].sqrt() / deviation - 1.0).abs() < 0.05, "{:?}", found.variances);
            assert!(found.directions[(7 * k + 3, k)].abs() > 0.999);
        }
        let few = Components::of(&samples.slice(ndarray::s![..2, ..]).to_owned(), 30);
        assert_eq!(few.directions.ncols(), 2);
    }
}
