//! Valid convolution of object stacks with a point spread function, by real FFTs.
//!
//! The measurement is smaller than the object: x = (o * h)[valid] + bias, summed over depth planes. This is a true
//! convolution (the kernel is flipped). A 96x96 object and a 32x32 PSF give a 65x65 measurement, x(i, j) = sum over k of
//! `h(k) o(i + 31 - k_row, j + 31 - k_col)`. A circular convolution of the object's own size is exact on the valid
//! region, because wrapped values land outside of it. So nothing is padded beyond the next length with small prime
//! factors.
//!
//! [`Convolution`] holds the plans, made once per pair of shapes. [`Convolver`] holds the spectrum of a PSF.
//! [`ObjectSpectra`] holds the spectra of objects that are measured repeatedly. Images are distributed over threads; the
//! result does not depend on the number of threads.

use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array3, ArrayView2, ArrayView3, ArrayView4, Axis};
use rayon::prelude::*;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use super::error::{SensorError, shape_error};

mod transposed;

pub use transposed::BlurWorkspace;

/// Plans of the transforms for objects and PSFs of given shapes.
#[derive(Clone)]
pub struct Convolution {
    object: (usize, usize),
    psf: (usize, usize),
    /// Rows and columns of the transforms.
    extent: (usize, usize),
    rows_forward: Arc<dyn RealToComplex<f32>>,
    rows_inverse: Arc<dyn ComplexToReal<f32>>,
    cols_forward: Arc<dyn Fft<f32>>,
    cols_inverse: Arc<dyn Fft<f32>>,
}

/// Plans of the transforms and the spectrum of one PSF.
#[derive(Clone)]
pub struct Convolver {
    plan: Convolution,
    /// One spectrum per plane, already divided by the length of the transform.
    spectra: Vec<Spectrum>,
}

/// Spectra of a stack of objects, for measurements with several PSFs.
pub struct ObjectSpectra {
    /// Per object, per plane.
    objects: Vec<Vec<Spectrum>>,
}

/// Half spectrum of a real image: `extent.0` row frequencies per column frequency, contiguous.
type Spectrum = Vec<Complex<f32>>;

/// Number of rows that are transposed together: the complex numbers of one cache line.
const BLOCK: usize = 8;

/// Buffers of a transform besides input and output, one per thread and call.
struct Workspace {
    /// One row of pixels.
    line: Vec<f32>,
    /// Half spectra of [`BLOCK`] rows.
    block: Vec<Complex<f32>>,
    scratch: Vec<Complex<f32>>,
}

/// Smallest even length of at least `least` with no prime factor above 5.
fn fast_length(least: usize) -> usize {
    let smooth = |mut length: usize| {
        for factor in [2, 3, 5] {
            while length.is_multiple_of(factor) {
                length /= factor;
            }
        }
        length == 1
    };
    // A power of two lies within a factor of two.
    let least = least.max(2);
    (least..2 * least).find(|&length| length.is_multiple_of(2) && smooth(length)).unwrap_or(least)
}

impl Convolution {
    /// Plans the transforms for objects of shape `object` and PSFs of shape `psf`, both (rows, cols).
    ///
    /// # Errors
    /// [`SensorError::ObjectSmallerThanPsf`] where the valid region would be empty.
    pub fn new(object: (usize, usize), psf: (usize, usize)) -> Result<Self, SensorError> {
        if psf.0 == 0 || psf.1 == 0 || object.0 < psf.0 || object.1 < psf.1 {
            return Err(SensorError::ObjectSmallerThanPsf {
                object_rows: object.0,
                object_cols: object.1,
                psf_rows: psf.0,
                psf_cols: psf.1,
            });
        }
        let extent = (fast_length(object.0), fast_length(object.1));
        let mut real = RealFftPlanner::new();
        let mut complex = FftPlanner::new();
        Ok(Self {
            object,
            psf,
            extent,
            rows_forward: real.plan_fft_forward(extent.1),
            rows_inverse: real.plan_fft_inverse(extent.1),
            cols_forward: complex.plan_fft_forward(extent.0),
            cols_inverse: complex.plan_fft_inverse(extent.0),
        })
    }

    /// Shape (rows, cols) of the measurements.
    pub fn measurement_shape(&self) -> (usize, usize) {
        (self.object.0 - self.psf.0 + 1, self.object.1 - self.psf.1 + 1)
    }

    /// Convolver with the spectrum of a PSF, shape (planes, rows, cols).
    ///
    /// # Errors
    /// [`SensorError::Shape`] where the PSF does not have the planned shape.
    pub fn with_psf(&self, psf: ArrayView3<'_, f64>) -> Result<Convolver, SensorError> {
        let (planes, rows, cols) = psf.dim();
        if (rows, cols) != self.psf || planes == 0 {
            return Err(shape_error("PSF", &[1, self.psf.0, self.psf.1], psf.shape()));
        }
        let scale = 1.0 / (self.extent.0 * self.extent.1) as f64;
        let scaled = psf.map(|&value| (value * scale) as f32);
        let mut workspace = self.workspace();
        let spectra = scaled.axis_iter(Axis(0)).map(|plane| self.spectrum_of(plane, &mut workspace)).collect();
        Ok(Convolver { plan: self.clone(), spectra })
    }

    /// Spectra of a stack of objects, shape (n, planes, rows, cols).
    ///
    /// # Errors
    /// [`SensorError::Shape`] where the objects do not have the planned shape.
    pub fn object_spectra(&self, objects: ArrayView4<'_, f32>) -> Result<ObjectSpectra, SensorError> {
        self.check_objects(&objects)?;
        let spectra = objects
            .axis_iter(Axis(0))
            .into_par_iter()
            .map_init(
                || self.workspace(),
                |workspace, object| object.axis_iter(Axis(0)).map(|plane| self.spectrum_of(plane, workspace)).collect(),
            )
            .collect();
        Ok(ObjectSpectra { objects: spectra })
    }

    fn check_objects(&self, objects: &ArrayView4<'_, f32>) -> Result<(), SensorError> {
        let (count, planes, rows, cols) = objects.dim();
        if (rows, cols) == self.object && planes > 0 {
            return Ok(());
        }
        Err(shape_error("objects", &[count, planes.max(1), self.object.0, self.object.1], objects.shape()))
    }

    /// Number of column frequencies of the half spectrum.
    fn half(&self) -> usize {
        self.extent.1 / 2 + 1
    }

    fn workspace(&self) -> Workspace {
        let scratch = [
            self.rows_forward.get_scratch_len(),
            self.rows_inverse.get_scratch_len(),
            self.cols_forward.get_inplace_scratch_len(),
            self.cols_inverse.get_inplace_scratch_len(),
        ];
        Workspace {
            line: vec![0.0; self.extent.1],
            block: vec![Complex::default(); BLOCK * self.half()],
            scratch: vec![Complex::default(); scratch.into_iter().max().unwrap_or(0)],
        }
    }

    /// Spectrum of zeros.
    fn empty_spectrum(&self) -> Spectrum {
        vec![Complex::default(); self.half() * self.extent.0]
    }

    /// Half spectrum of an image in a new buffer.
    fn spectrum_of(&self, image: ArrayView2<'_, f32>, workspace: &mut Workspace) -> Spectrum {
        let mut spectrum = self.empty_spectrum();
        self.forward(image, workspace, &mut spectrum);
        spectrum
    }

    /// Computes the half spectrum of an image no larger than the transform, zero-padded at the bottom and right.
    fn forward(&self, image: ArrayView2<'_, f32>, workspace: &mut Workspace, spectrum: &mut Spectrum) {
        let extent_rows = self.extent.0;
        let half = self.half();
        let Workspace { line, block, scratch } = workspace;
        let row_scratch = self.rows_forward.get_scratch_len();
        let (rows, cols) = image.dim();
        for first in (0..extent_rows).step_by(BLOCK) {
            let block_rows = BLOCK.min(extent_rows - first);
            for (index, transformed) in block.chunks_exact_mut(half).take(block_rows).enumerate() {
                let row = first + index;
                if row >= rows {
                    transformed.fill(Complex::default());
                    continue;
                }
                let pixels = image.row(row);
                match pixels.as_slice() {
                    Some(pixels) => line[..cols].copy_from_slice(pixels),
                    None => line.iter_mut().zip(pixels).for_each(|(value, &pixel)| *value = pixel),
                }
                line[cols..].fill(0.0);
                // The transform fails only for wrong buffer lengths, and these have the lengths of the plan.
                let _ = self.rows_forward.process_with_scratch(line, transformed, &mut scratch[..row_scratch]);
            }
            for (col, run) in spectrum.chunks_exact_mut(extent_rows).enumerate() {
                for (index, value) in run[first..first + block_rows].iter_mut().enumerate() {
                    *value = block[index * half + col];
                }
            }
        }
        self.cols_forward.process_with_scratch(spectrum, scratch);
    }

    /// Passes the given rows of the image with this half spectrum to `receive` as (row, pixels). Overwrites the spectrum.
    fn inverse(
        &self,
        spectrum: &mut Spectrum,
        workspace: &mut Workspace,
        rows: Range<usize>,
        mut receive: impl FnMut(usize, &[f32]),
    ) {
        let extent_rows = self.extent.0;
        let half = self.half();
        let Workspace { line, block, scratch } = workspace;
        let row_scratch = self.rows_inverse.get_scratch_len();
        self.cols_inverse.process_with_scratch(spectrum, scratch);
        for first in rows.clone().step_by(BLOCK) {
            let block_rows = BLOCK.min(rows.end - first);
            for (col, run) in spectrum.chunks_exact(extent_rows).enumerate() {
                for (index, &value) in run[first..first + block_rows].iter().enumerate() {
                    block[index * half + col] = value;
                }
            }
            for (index, transformed) in block.chunks_exact_mut(half).take(block_rows).enumerate() {
                // A real image has real values at frequency 0 and at the highest frequency; rounding leaves small
                // imaginary parts.
                transformed[0].im = 0.0;
                transformed[half - 1].im = 0.0;
                let _ = self.rows_inverse.process_with_scratch(transformed, line, &mut scratch[..row_scratch]);
                receive(first + index, line);
            }
        }
    }
}

/// `sum` += `a` x `b`, entry by entry.
fn add_product(sum: &mut [Complex<f32>], a: &[Complex<f32>], b: &[Complex<f32>]) {
    for (value, (&a, &b)) in sum.iter_mut().zip(a.iter().zip(b)) {
        *value += a * b;
    }
}

impl Convolver {
    /// Plans of the transforms of this convolver.
    pub fn plan(&self) -> &Convolution {
        &self.plan
    }

    /// Encoded images of a stack of objects, shape (n, planes, rows, cols) in photons per pixel, plus `bias` photons. The
    /// result has shape (n, rows, cols) of the valid region and is never below `bias`.
    ///
    /// # Errors
    /// [`SensorError::Shape`] where the objects do not have the planned shape or the planes of the PSF.
    pub fn measure(&self, objects: ArrayView4<'_, f32>, bias: f64) -> Result<Array3<f32>, SensorError> {
        self.plan.check_objects(&objects)?;
        self.check_planes(objects.len_of(Axis(1)))?;
        let convolve = |index: usize, workspace: &mut Workspace, part: &mut Spectrum, sum: &mut Spectrum| {
            for (plane, psf) in objects.index_axis(Axis(0), index).axis_iter(Axis(0)).zip(&self.spectra) {
                self.plan.forward(plane, workspace, part);
                add_product(sum, part, psf);
            }
        };
        Ok(self.measure_each(objects.len_of(Axis(0)), bias, convolve))
    }

    /// [`Convolver::measure`] for objects with known spectra.
    ///
    /// # Errors
    /// [`SensorError::Shape`] where the objects do not have the planes of the PSF.
    pub fn measure_spectra(&self, objects: &ObjectSpectra, bias: f64) -> Result<Array3<f32>, SensorError> {
        for planes in &objects.objects {
            self.check_planes(planes.len())?;
        }
        let convolve = |index: usize, _: &mut Workspace, _: &mut Spectrum, sum: &mut Spectrum| {
            for (spectrum, psf) in objects.objects[index].iter().zip(&self.spectra) {
                add_product(sum, spectrum, psf);
            }
        };
        Ok(self.measure_each(objects.objects.len(), bias, convolve))
    }

    /// Gradient with respect to the PSF, shape (planes, rows, cols). `cotangent` is the gradient with respect to the
    /// encoded images, shape (n, rows, cols). Entry k is the sum over images and pixels p of `cotangent[p]` o(p - k).
    ///
    /// # Errors
    /// [`SensorError::Shape`] where the shapes of objects and cotangent do not match.
    pub fn psf_cotangent(
        &self,
        objects: ArrayView4<'_, f32>,
        cotangent: ArrayView3<'_, f32>,
    ) -> Result<Array3<f64>, SensorError> {
        let plan = &self.plan;
        plan.check_objects(&objects)?;
        self.check_planes(objects.len_of(Axis(1)))?;
        let (count, (rows, cols)) = (objects.len_of(Axis(0)), plan.measurement_shape());
        if cotangent.dim() != (count, rows, cols) {
            return Err(shape_error("cotangent", &[count, rows, cols], cotangent.shape()));
        }
        let (psf_rows, psf_cols) = plan.psf;
        let planes = self.spectra.len();
        let scale = 1.0 / (plan.extent.0 * plan.extent.1) as f64;
        let parts: Vec<Array3<f64>> = (0..count)
            .into_par_iter()
            .map_init(
                || plan.workspace(),
                |workspace, index| {
                    // The first pixel of the measurement lies at the last row and column of the PSF support.
                    let mut placed = ndarray::Array2::<f32>::zeros(plan.object);
                    placed
                        .slice_mut(ndarray::s![psf_rows - 1.., psf_cols - 1..])
                        .assign(&cotangent.index_axis(Axis(0), index));
                    let seen = plan.spectrum_of(placed.view(), workspace);
                    let mut part = Array3::zeros((planes, psf_rows, psf_cols));
                    for (plane, object) in objects.index_axis(Axis(0), index).axis_iter(Axis(0)).enumerate() {
                        let mut product = plan.spectrum_of(object, workspace);
                        product.iter_mut().zip(&seen).for_each(|(value, &c)| *value = c * value.conj());
                        plan.inverse(&mut product, workspace, 0..psf_rows, |row, line| {
                            for col in 0..psf_cols {
                                part[(plane, row, col)] = f64::from(line[col]) * scale;
                            }
                        });
                    }
                    part
                },
            )
            .collect();
        // Summed in order, so that the result does not depend on the number of threads.
        Ok(parts.into_iter().fold(Array3::zeros((planes, psf_rows, psf_cols)), |sum, part| sum + part))
    }

    fn check_planes(&self, found: usize) -> Result<(), SensorError> {
        if found == self.spectra.len() {
            return Ok(());
        }
        Err(shape_error("planes of the objects", &[self.spectra.len()], &[found]))
    }

    /// Encoded images whose spectra `convolve` adds to zeros: (index, workspace, spare spectrum, spectrum).
    fn measure_each(
        &self,
        count: usize,
        bias: f64,
        convolve: impl Fn(usize, &mut Workspace, &mut Spectrum, &mut Spectrum) + Sync,
    ) -> Array3<f32> {
        let plan = &self.plan;
        let (rows, cols) = plan.measurement_shape();
        let (first_row, first_col) = (plan.psf.0 - 1, plan.psf.1 - 1);
        let bias = bias as f32;
        let mut measurements = Array3::zeros((count, rows, cols));
        measurements.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each_init(
            || (plan.workspace(), plan.empty_spectrum(), plan.empty_spectrum()),
            |(workspace, part, sum), (index, mut image)| {
                sum.fill(Complex::default());
                convolve(index, workspace, part, sum);
                plan.inverse(sum, workspace, first_row..first_row + rows, |row, line| {
                    let seen = &line[first_col..first_col + cols];
                    for (pixel, &value) in image.row_mut(row - first_row).iter_mut().zip(seen) {
                        // Light is not negative, but the transforms round.
                        *pixel = value.max(0.0) + bias;
                    }
                });
            },
        );
        measurements
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array4, s};

    fn pattern(shape: (usize, usize, usize, usize)) -> Array4<f32> {
        Array4::from_shape_fn(shape, |(n, p, r, c)| ((n * 5 + p * 11 + r * 3 + c * 7) as f32 * 0.61).sin() + 1.0)
    }

    fn psf(planes: usize, rows: usize, cols: usize) -> Array3<f64> {
        Array3::from_shape_fn((planes, rows, cols), |(p, r, c)| ((p * 3 + r * 2 + c) as f64 * 0.37).cos() + 1.1)
    }

    /// The sum of the definition.
    fn naive(objects: &Array4<f32>, psf: &Array3<f64>, bias: f64) -> Array3<f64> {
        let (count, planes, rows, cols) = objects.dim();
        let (_, psf_rows, psf_cols) = psf.dim();
        Array3::from_shape_fn((count, rows - psf_rows + 1, cols - psf_cols + 1), |(n, i, j)| {
            let mut sum = bias;
            for p in 0..planes {
                for r in 0..psf_rows {
                    for c in 0..psf_cols {
                        sum += psf[(p, r, c)] * f64::from(objects[(n, p, i + psf_rows - 1 - r, j + psf_cols - 1 - c)]);
                    }
                }
            }
            sum
        })
    }

    #[test]
    fn agrees_with_the_definition_for_odd_shapes_and_volumes() {
        for (object, kernel, planes) in [((17, 22), (5, 4), 1), ((13, 11), (13, 11), 1), ((20, 31), (7, 9), 3)] {
            let objects = pattern((3, planes, object.0, object.1));
            let psf = psf(planes, kernel.0, kernel.1);
            let plan = Convolution::new(object, kernel).unwrap();
            let convolver = plan.with_psf(psf.view()).unwrap();
            let expected = naive(&objects, &psf, 10.0);
            let found = convolver.measure(objects.view(), 10.0).unwrap();
            let again = convolver.measure_spectra(&plan.object_spectra(objects.view()).unwrap(), 10.0).unwrap();
            assert_eq!(found.dim(), expected.dim());
            for ((index, &value), &twin) in expected.indexed_iter().zip(&again) {
                assert!((f64::from(found[index]) - value).abs() < 1e-5 * value, "{object:?} {index:?}");
                assert!((f64::from(twin) - value).abs() < 1e-5 * value);
            }
        }
    }

    /// Orientation: a point moves with the PSF, not against it.
    #[test]
    fn a_point_shows_the_psf_the_right_way_round() {
        let mut objects = Array4::zeros((1, 1, 24, 24));
        objects[(0, 0, 12, 12)] = 1.0;
        let mut psf = Array3::zeros((1, 9, 9));
        psf[(0, 1, 6)] = 1.0;
        let plan = Convolution::new((24, 24), (9, 9)).unwrap();
        let image = plan.with_psf(psf.view()).unwrap().measure(objects.view(), 0.0).unwrap();
        // x(i, j) = o(i + 8 - 1, j + 8 - 6), so the point of (12, 12) is at i = 5, j = 10.
        assert!((image[(0, 5, 10)] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn the_adjoint_is_the_adjoint() {
        let (objects, psf) = (pattern((4, 2, 21, 18)), psf(2, 6, 5));
        let plan = Convolution::new((21, 18), (6, 5)).unwrap();
        let convolver = plan.with_psf(psf.view()).unwrap();
        let cotangent = pattern((1, 4, 16, 14)).index_axis_move(Axis(0), 0).mapv(|value| value - 0.8);
        let pulled = convolver.psf_cotangent(objects.view(), cotangent.view()).unwrap();
        // <c, o * h> = <A^T c, h> for any h; the definition gives A^T c by one-hot PSFs.
        for index in [(0, 0, 0), (1, 5, 4), (0, 3, 2)] {
            let mut hot = Array3::zeros((2, 6, 5));
            hot[index] = 1.0;
            let image = naive(&objects, &hot, 0.0);
            let expected: f64 = image.iter().zip(&cotangent).map(|(x, &c)| x * f64::from(c)).sum();
            assert!((pulled[index] - expected).abs() < 1e-3 * expected.abs().max(1.0), "{index:?}");
        }
    }

    #[test]
    fn shapes_that_do_not_fit_are_named() {
        let error = Convolution::new((16, 40), (32, 32)).err().unwrap().to_string();
        assert!(error.contains("16 x 40") && error.contains("32 x 32"), "{error}");
        let plan = Convolution::new((40, 40), (8, 8)).unwrap();
        assert!(plan.with_psf(psf(1, 9, 8).view()).is_err());
        let convolver = plan.with_psf(psf(1, 8, 8).view()).unwrap();
        assert!(convolver.measure(pattern((1, 1, 39, 40)).view(), 0.0).is_err());
        assert!(convolver.measure(pattern((1, 2, 40, 40)).view(), 0.0).is_err());
        assert_eq!(
            convolver.measure(pattern((1, 1, 40, 40)).slice(s![0..0, .., .., ..]), 0.0).unwrap().dim(),
            (0, 33, 33)
        );
    }
}
