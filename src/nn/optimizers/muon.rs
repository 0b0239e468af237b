//! Muon: momentum with all singular values made equal, for matrices in the middle of a network.

use crate::nn::kernels::arithmetic::vectorised;
use crate::nn::kernels::elementwise::{Elementwise, each, euclidean_norm};
use crate::nn::kernels::matmul::{Write, matmul_transposed_lhs, matmul_transposed_rhs, product};

/// Decay of the momentum.
const DECAY: f32 = 0.9;
/// Odd quintics (coefficients of x, x^3 and x^5), applied one after the other. They move singular values between 0.01
/// and 1 to within 0.27 of 1. Each deviates least from 1 over the range that the one before it leaves of that
/// interval (Amsel et al. 2025).
const QUINTICS: [[f32; 3]; 3] = [[8.0934, -23.6206, 17.4463], [3.6366, -2.7219, 0.5365], [2.6613, -1.9772, 0.4526]];
/// Weight decay per step and unit of the rate.
const FORGOTTEN: f32 = 0.1;
/// Root mean square of a step relative to the rate, about that of Adam.
const MATCHED: f32 = 0.2;

/// Muon (Jordan et al. 2024) with Nesterov momentum 0.9, for one matrix.
///
/// A step has the size of an Adam step at the same rate, root mean square 0.2 times the rate. Weights decay by 0.1
/// times the rate. Without decay they grow from step to step, and the steps become ever smaller relative to them (Liu
/// et al. 2025).
#[derive(Clone, Debug)]
pub struct Muon {
    momentum: Vec<f32>,
    rows: usize,
    cols: usize,
}

impl Muon {
    /// State for a matrix of shape (rows, cols), before the first step.
    pub fn new(rows: usize, cols: usize) -> Self {
        Self { momentum: vec![0.0; rows * cols], rows, cols }
    }

    /// The momentum, (rows, cols).
    pub fn momentum(&self) -> &[f32] {
        &self.momentum
    }

    /// Restores this momentum.
    pub fn restore(&mut self, momentum: &[f32]) {
        self.momentum.copy_from_slice(momentum);
    }

    /// Takes one step of `rate` (units of the weights) against `scale` times `gradient`, both (rows, cols).
    pub fn step(&mut self, weights: &mut [f32], gradient: &[f32], scale: f32, rate: f32) {
        let mut direction = vec![0.0; gradient.len()];
        accumulate(scale, gradient, &mut self.momentum, &mut direction);
        let direction = equalised(direction, self.rows, self.cols);
        let factor = rate * MATCHED * (self.rows.max(self.cols) as f32).sqrt();
        combine(1.0 - FORGOTTEN * rate, -factor, &direction, weights);
    }
}

/// The matrix with all singular values near 1.
fn equalised(mut matrix: Vec<f32>, rows: usize, cols: usize) -> Vec<f32> {
    // Scales the matrix, so that later numbers stay far from the largest and the smallest.
    multiply(1.0 / (euclidean_norm(&matrix) as f32 + 1e-7), &mut matrix);
    // The Gram matrix of the shorter side is the cheaper one; both give the same polynomial.
    let tall = rows > cols;
    let side = rows.min(cols);
    let (mut gram, mut polynomial) = (vec![0.0; side * side], vec![0.0; side * side]);
    let mut next = vec![0.0; matrix.len()];
    for (iteration, [a, b, c]) in QUINTICS.into_iter().enumerate() {
        if tall {
            matmul_transposed_lhs(&matrix, &matrix, (side, rows, side), &mut gram, Write::Replace);
        } else {
            matmul_transposed_rhs(&matrix, &matrix, (side, cols, side), &mut gram, Write::Replace);
        }
        if iteration == 0 {
            // No singular value exceeds the root of this norm, which is closer to the largest one than the norm of
            // the matrix.
            let norm = euclidean_norm(&gram).max(1e-12) as f32;
            multiply(1.0 / norm, &mut gram);
            multiply(1.0 / norm.sqrt(), &mut matrix);
        }
        product(&gram, &gram, (side, side, side), &mut polynomial, Write::Replace);
        combine(c, b, &gram, &mut polynomial);
        for diagonal in polynomial.iter_mut().step_by(side + 1) {
            *diagonal += a;
        }
        if tall {
            product(&matrix, &polynomial, (rows, side, cols), &mut next, Write::Replace);
        } else {
            product(&polynomial, &matrix, (rows, side, cols), &mut next, Write::Replace);
        }
        std::mem::swap(&mut matrix, &mut next);
    }
    matrix
}

/// Nesterov momentum: the direction one step ahead.
struct Nesterov {
    scale: f32,
}

impl Elementwise<1, 2> for Nesterov {
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "loops around it become vector code only when it is inlined")]
    fn apply(&self, [gradient]: [f32; 1], [momentum, _]: [f32; 2]) -> [f32; 2] {
        let gradient = gradient * self.scale;
        let momentum = DECAY * momentum + gradient;
        [momentum, DECAY * momentum + gradient]
    }
}

vectorised! {
    fn accumulate<'a>(scale: f32, gradient: &'a [f32], momentum: &'a mut [f32], direction: &'a mut [f32]) {
        each(&Nesterov { scale }, [gradient], [momentum, direction]);
    }
}

vectorised! {
    /// `out = own out + other numbers`.
    fn combine<'a>(own: f32, other: f32, numbers: &'a [f32], out: &'a mut [f32]) {
        for (out, number) in out.iter_mut().zip(numbers) {
            *out = own * *out + other * number;
        }
    }
}

fn multiply(factor: f32, values: &mut [f32]) {
    for value in values {
        *value *= factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    #[test]
    fn directions_have_singular_values_near_one() {
        for (rows, cols) in [(24, 8), (8, 24), (16, 16)] {
            // Singular values from 7 to 0.1, each with its own direction on either side.
            let values: Vec<f32> =
                (0..rows.min(cols)).map(|i| 7.0 * 0.014_f32.powf(i as f32 / (rows.min(cols) - 1) as f32)).collect();
            let mut random = ChaCha8Rng::seed_from_u64(4);
            let mut reflection = |side: usize| {
                let axis: Vec<f32> = (0..side).map(|_| random.sample(StandardNormal)).collect();
                let square: f32 = axis.iter().map(|x| x * x).sum();
                move |i: usize, j: usize| f32::from(u8::from(i == j)) - 2.0 * axis[i] * axis[j] / square
            };
            let (left, right) = (reflection(rows), reflection(cols));
            let entry = |i: usize| {
                let of = |(k, value): (usize, &f32)| left(i / cols, k) * value * right(k, i % cols);
                values.iter().enumerate().map(of).sum()
            };
            let matrix: Vec<f32> = (0..rows * cols).map(entry).collect();
            let out = equalised(matrix.clone(), rows, cols);
            let singular = faer::MatRef::from_row_major_slice(&out, rows, cols).singular_values().unwrap();
            assert!(singular.iter().all(|s| (0.72..1.28).contains(s)), "{singular:?}");
            // The direction still points along the gradient.
            assert!(matrix.iter().zip(&out).map(|(x, y)| x * y).sum::<f32>() > 0.0);
        }
    }

    #[test]
    fn a_step_has_the_announced_size_and_lowers_a_quadratic() {
        let (rows, cols) = (12, 6);
        let target: Vec<f32> = (0..72).map(|i| ((i * 29 % 31) as f32 - 15.0) * 0.1).collect();
        let mut weights = vec![0.0; 72];
        let mut muon = Muon::new(rows, cols);
        let error = |weights: &[f32]| weights.iter().zip(&target).map(|(w, t)| (w - t).powi(2)).sum::<f32>();
        let before = error(&weights);
        for step in 0..200 {
            let gradient: Vec<f32> = weights.iter().zip(&target).map(|(w, t)| w - t).collect();
            let earlier = weights.clone();
            muon.step(&mut weights, &gradient, 1.0, 0.05);
            if step == 0 {
                let square: f32 = weights.iter().zip(&earlier).map(|(w, e)| (w - e).powi(2)).sum();
                // Six singular values near 1 in 72 entries: 0.05 * 0.2 * sqrt(12) * sqrt(6 / 72) = 0.01.
                assert!(((square / 72.0).sqrt() - 0.01).abs() < 0.003, "{square}");
            }
        }
        assert!(error(&weights) < 0.05 * before, "{} {before}", error(&weights));
    }
}
