//! Matrix products of row-major slices, one thread each.
//!
//! The products are faer's, which choose AVX-512, AVX2 or NEON kernels at run time through a safe interface. One thread
//! per product, because the callers split their samples between threads: the order of every sum is then fixed.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

/// Effect of a product on its destination.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Write {
    /// Overwrites it.
    Replace,
    /// Adds to it.
    Add,
}

impl From<Write> for Accum {
    fn from(write: Write) -> Self {
        match write {
            Write::Replace => Self::Replace,
            Write::Add => Self::Add,
        }
    }
}

/// `out = a b` (or `+=`): a (rows, inner), b (inner, cols), out (rows, cols).
///
/// # Panics
/// Where a length does not fit its shape.
pub fn product(a: &[f32], b: &[f32], (rows, inner, cols): (usize, usize, usize), out: &mut [f32], write: Write) {
    let a = MatRef::from_row_major_slice(a, rows, inner);
    let b = MatRef::from_row_major_slice(b, inner, cols);
    matmul(MatMut::from_row_major_slice_mut(out, rows, cols), write.into(), a, b, 1.0, Par::Seq);
}

/// `out = a b^T` (or `+=`): a (rows, inner), b (cols, inner), out (rows, cols).
///
/// # Panics
/// Where a length does not fit its shape.
pub fn matmul_transposed_rhs(
    a: &[f32],
    b: &[f32],
    (rows, inner, cols): (usize, usize, usize),
    out: &mut [f32],
    write: Write,
) {
    let a = MatRef::from_row_major_slice(a, rows, inner);
    let b = MatRef::from_row_major_slice(b, cols, inner).transpose();
    matmul(MatMut::from_row_major_slice_mut(out, rows, cols), write.into(), a, b, 1.0, Par::Seq);
}

/// `out = a^T b` (or `+=`): a (inner, rows), b (inner, cols), out (rows, cols).
///
/// # Panics
/// Where a length does not fit its shape.
pub fn matmul_transposed_lhs(
    a: &[f32],
    b: &[f32],
    (rows, inner, cols): (usize, usize, usize),
    out: &mut [f32],
    write: Write,
) {
    let a = MatRef::from_row_major_slice(a, inner, rows).transpose();
    let b = MatRef::from_row_major_slice(b, inner, cols);
    matmul(MatMut::from_row_major_slice_mut(out, rows, cols), write.into(), a, b, 1.0, Par::Seq);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::test_numbers::numbers;

    fn transposed(a: &[f32], rows: usize, cols: usize) -> Vec<f32> {
        (0..rows * cols).map(|i| a[(i % rows) * cols + i / rows]).collect()
    }

    #[test]
    fn products_match_the_definition() {
        for (rows, inner, cols) in [(1, 1, 1), (5, 3, 7), (64, 3, 40), (33, 129, 64), (128, 17, 120)] {
            let (a, b) = (numbers(rows * inner, 1), numbers(inner * cols, 2));
            let mut expected = vec![0.0; rows * cols];
            for (i, value) in expected.iter_mut().enumerate() {
                let sum: f64 =
                    (0..inner).map(|k| f64::from(a[(i / cols) * inner + k]) * f64::from(b[k * cols + i % cols])).sum();
                *value = sum as f32;
            }
            let check = |found: &[f32], shift: f32| {
                for (x, y) in found.iter().zip(&expected) {
                    assert!((x - y - shift).abs() < 1e-4, "{x} {y}");
                }
            };
            let shape = (rows, inner, cols);
            let mut out = vec![f32::NAN; rows * cols];
            product(&a, &b, shape, &mut out, Write::Replace);
            check(&out, 0.0);
            out.fill(3.0);
            product(&a, &b, shape, &mut out, Write::Add);
            check(&out, 3.0);
            matmul_transposed_rhs(&a, &transposed(&b, inner, cols), shape, &mut out, Write::Replace);
            check(&out, 0.0);
            matmul_transposed_lhs(&transposed(&a, rows, inner), &b, shape, &mut out, Write::Replace);
            check(&out, 0.0);
        }
    }
}
