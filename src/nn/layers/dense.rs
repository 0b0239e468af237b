//! A layer that multiplies by a matrix and adds a bias, and its gradients.

use std::ops::Range;

use crate::nn::kernels::bias::{column_sums, fill_bias};
use crate::nn::kernels::matmul::{Write, matmul_transposed_lhs, matmul_transposed_rhs, product};

/// Places of the weights of a layer among all weights: a matrix of shape (inputs, outputs) and a bias of (outputs).
#[derive(Clone, Debug)]
pub struct Layer {
    /// Place of the matrix, row-major.
    pub kernel: Range<usize>,
    /// Place of the bias; empty for a layer without one.
    pub bias: Range<usize>,
    /// Rows of the matrix.
    pub inputs: usize,
    /// Columns of the matrix.
    pub outputs: usize,
}

impl Layer {
    /// The bias.
    pub fn bias<'a>(&self, weights: &'a [f32]) -> &'a [f32] {
        &weights[self.bias.clone()]
    }

    /// `out = input kernel + bias`.
    pub fn forward(&self, weights: &[f32], input: &[f32], out: &mut [f32]) {
        fill_bias(self.bias(weights), out);
        self.add_forward(weights, input, out);
    }

    /// `out += input kernel`.
    pub fn add_forward(&self, weights: &[f32], input: &[f32], out: &mut [f32]) {
        let shape = (input.len() / self.inputs, self.inputs, self.outputs);
        product(input, &weights[self.kernel.clone()], shape, out, Write::Add);
    }

    /// Gradient by kernel and bias from the gradient by the output.
    pub fn by_weights(&self, input: &[f32], by_output: &[f32], gradient: &mut [f32], write: Write) {
        self.by_kernel(input, by_output, gradient, write);
        self.by_bias(by_output, gradient, write);
    }

    /// Gradient by the bias alone.
    pub fn by_bias(&self, by_output: &[f32], gradient: &mut [f32], write: Write) {
        let bias = &mut gradient[self.bias.clone()];
        if write == Write::Replace {
            bias.fill(0.0);
        }
        column_sums(by_output, bias);
    }

    /// Gradient by the kernel alone.
    pub fn by_kernel(&self, input: &[f32], by_output: &[f32], gradient: &mut [f32], write: Write) {
        let shape = (self.inputs, input.len() / self.inputs, self.outputs);
        matmul_transposed_lhs(input, by_output, shape, &mut gradient[self.kernel.clone()], write);
    }

    /// Gradient by the input from the gradient by the output.
    pub fn by_input(&self, weights: &[f32], by_output: &[f32], by_input: &mut [f32], write: Write) {
        let shape = (by_output.len() / self.outputs, self.outputs, self.inputs);
        matmul_transposed_rhs(by_output, &weights[self.kernel.clone()], shape, by_input, write);
    }
}
