//! Simulated measurements of a design, in parts.

use std::ops::ControlFlow;

use ndarray::{Array3, Array4, Axis, s};

use super::error::ForwardError;
use super::model::ForwardModel;
use crate::forward::{Design, DesignError};
use crate::objects::{ObjectError, ObjectOptions, ObjectSet, Progress, Split};
use crate::sensor::Convolver;

/// Objects and their measurements.
pub struct Simulated {
    /// Shape (n, planes, rows, cols), photons per pixel.
    pub objects: Array4<f32>,
    /// Encoded images with background, shape (n, rows, cols).
    pub noiseless: Array3<f32>,
    /// Noisy measurements, shape (n, rows, cols), photons per pixel.
    pub noisy: Array3<f32>,
}

/// A design with its objects opened, for simulated measurements.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let design = Design::default();
/// let measured = Simulator::new(&design)?.measure(0, 2)?;
/// assert_eq!(measured.noisy.dim(), (2, 65, 65));
/// # Ok::<(), ForwardError>(())
/// ```
pub struct Simulator<'a> {
    design: &'a Design,
    set: ObjectSet,
    convolver: Convolver,
}

impl<'a> Simulator<'a> {
    /// Opens the objects of a design and renders its PSF.
    ///
    /// # Errors
    /// [`ForwardError`] where the objects cannot be read or do not fit the PSF.
    pub fn new(design: &'a Design) -> Result<Self, ForwardError> {
        let set = open_set(design)?;
        let convolver = convolver(design, &set)?;
        Ok(Self { design, set, convolver })
    }

    /// The objects.
    pub fn set(&self) -> &ObjectSet {
        &self.set
    }

    /// Shape (rows, cols) of the measurements.
    pub fn measurement_shape(&self) -> (usize, usize) {
        self.convolver.plan().measurement_shape()
    }

    /// Measures objects `first` to `first + count - 1`. An object and its noise depend only on its number and the
    /// design's seed, so parts of any length give the same whole.
    ///
    /// # Errors
    /// [`ForwardError`] where they do not fit into memory.
    pub fn measure(&self, first: usize, count: usize) -> Result<Simulated, ForwardError> {
        let design = self.design;
        let objects = self.set.objects_from(Split::All, first, count, design.seed)?;
        let noiseless = self.convolver.measure(objects.view(), design.bias_photons)?;
        let noisy = design.noise.draw_from(noiseless.view(), first, design.seed);
        Ok(Simulated { objects, noiseless, noisy })
    }
}

/// The objects of a design.
pub fn open_set(design: &Design) -> Result<ObjectSet, ObjectError> {
    open_set_with(design, &|_| ControlFlow::Continue(()))
}

/// The objects of a design, with reports of the progress of reading; [`ControlFlow::Break`] cancels.
pub fn open_set_with(design: &Design, reading: &dyn Fn(Progress) -> ControlFlow<()>) -> Result<ObjectSet, ObjectError> {
    let options = ObjectOptions { mean_photons: design.mean_photons, ..ObjectOptions::default() };
    ObjectSet::open_with(&design.objects, &options, reading)
}

/// Notices about the objects of a design, and about light of the PSF on planes without objects.
///
/// # Errors
/// [`DesignError`] where the mask cannot be rendered.
pub fn notices_of(design: &Design, set: &ObjectSet) -> Result<Vec<String>, DesignError> {
    let psf = design.psf(set.planes())?;
    let lost = psf.slice(s![set.planes().., .., ..]).sum() / psf.sum();
    let notice = || {
        let planes = set.planes();
        format!(
            "{:.1} % of the PSF lies on planes that these objects do not have: they have {planes}, the mask has {}, and no light \
             comes from the others",
            100.0 * lost,
            psf.len_of(Axis(0))
        )
    };
    Ok(set.notices().iter().cloned().chain((lost > 0.0).then(notice)).collect())
}

/// The convolution of a set of objects with the PSF of a design.
pub fn convolver(design: &Design, set: &ObjectSet) -> Result<Convolver, ForwardError> {
    Ok(forward_model(design, set)?.convolver(design.psf(set.planes())?.view())?)
}

/// The forward model of a set of objects, for any mask of the grid of the design.
pub fn forward_model<'a>(design: &Design, set: &'a ObjectSet) -> Result<ForwardModel<'a>, ForwardError> {
    Ok(ForwardModel::new(set, design.encoder.grid(), design.bias_photons, design.noise)?)
}
