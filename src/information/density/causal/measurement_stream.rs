//! Patches of new measurements, cut at random places, and the base images that they show.

use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};

use super::stream::{PatchBatch, PatchStream};
use crate::forward::{ForwardError, ForwardModel};
use crate::information::error::InformationError;
use crate::information::statistics::shared_images::SharedImages;
use crate::objects::{ObjectSet, PlacedImage, Split};
use crate::seeds::SeedStream;
use crate::sensor::{Convolver, Noise, Patches, SensorError};

/// Patches cut from one measurement during a fit: drawing objects costs more than cutting.
const PATCHES_PER_OBJECT: usize = 4;

/// Validation patches of a fit to few images.
const VALIDATION_PATCHES: usize = 64;

/// Smallest share of the light of a patch for a base image to count.
const LEAST_SHARE: f64 = 1e-3;

/// Objects of some measurements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObjectDraw {
    /// Part of the set.
    pub split: Split,
    /// Number of the first object.
    pub first: usize,
    /// Seed of the objects.
    pub seed: u64,
}

impl ForwardModel {
    /// Base images that patches at `places` show through a point spread function of shape (planes, rows, cols). The
    /// measurements are those of `objects`; `None` for beads.
    pub fn shared_images(
        &self,
        psf: ArrayView3<'_, f64>,
        patch: (usize, usize),
        ObjectDraw { split, first, seed }: ObjectDraw,
        places: &Patches,
    ) -> Option<SharedImages> {
        let corners = places.corners();
        let objects = corners.iter().map(|corner| corner.0 + 1).max().unwrap_or(0);
        let images = self.set.images_from(split, first, objects, seed)?;
        let footprint = Footprint::new(psf.index_axis(Axis(0), 0), patch);
        let shown = |&(object, row, col): &(usize, usize, usize)| {
            let light = |placed: &PlacedImage| (placed.image, footprint.light(placed, (row, col)));
            let light: Vec<(u32, f64)> = images[object].iter().map(light).collect();
            let all: f64 = light.iter().map(|(_, light)| light).sum();
            let seen = light.into_iter().filter(|&(_, light)| light > LEAST_SHARE * all);
            seen.map(|(image, light)| (image, light / all)).collect()
        };
        Some(SharedImages::new(corners.iter().map(shown).collect()))
    }

    /// New patches of measurements of one part of the objects.
    pub fn stream(&self, convolver: Convolver, split: Split, patch: (usize, usize)) -> MeasurementStream {
        MeasurementStream { set: Arc::clone(&self.set), convolver, bias: self.bias, noise: self.noise, split, patch }
    }

    /// New patches of training objects for a fit, and held-out ones that [validate](ObjectSet::fitting_parts) it
    /// where these are few.
    ///
    /// # Errors
    /// As [`PatchStream::draw`].
    pub fn fitting(
        &self,
        convolver: &Convolver,
        patch: (usize, usize),
        seed: u64,
    ) -> Result<(MeasurementStream, Option<PatchBatch>), InformationError> {
        let stream = |split| self.stream(convolver.clone(), split, patch);
        let (fit, validation) = self.set.fitting_parts();
        let validation = validation.map(|split| stream(split).draw_one_each(VALIDATION_PATCHES, seed)).transpose()?;
        Ok((stream(fit), validation))
    }
}

/// Share of the light of a patch from each part of an evenly bright object.
struct Footprint {
    /// Entry [r, c]: the share of all object pixels above and left of (r, c), counted from the patch's corner.
    above: Array2<f64>,
}

impl Footprint {
    /// Of a patch (rows, cols) through a point spread function.
    fn new(psf: ArrayView2<'_, f64>, patch: (usize, usize)) -> Self {
        let (rows, cols) = (patch.0 + psf.nrows() - 1, patch.1 + psf.ncols() - 1);
        // The PSF is rotated by 180 degrees; a box of the patch's size surrounds each of its pixels.
        let turned = summed(psf.nrows(), psf.ncols(), |r, c| psf[[psf.nrows() - 1 - r, psf.ncols() - 1 - c]]);
        let inside =
            |at: usize, side: usize, length: usize| ((at + 1).saturating_sub(side).min(length), (at + 1).min(length));
        let light = |r: usize, c: usize| {
            let (top, bottom) = inside(r, patch.0, psf.nrows());
            let (left, right) = inside(c, patch.1, psf.ncols());
            over(&turned, (top, bottom), (left, right))
        };
        Self { above: summed(rows, cols, light) }
    }

    /// Light of a base image in a patch with this corner.
    fn light(&self, placed: &PlacedImage, (row, col): (usize, usize)) -> f64 {
        let (rows, cols) = (self.above.nrows() as isize - 1, self.above.ncols() as isize - 1);
        let span = |range: &Range<isize>, corner: usize, length: isize| {
            let at = |place: isize| (place - corner as isize).clamp(0, length) as usize;
            (at(range.start), at(range.end))
        };
        over(&self.above, span(&placed.rows, row, rows), span(&placed.cols, col, cols))
    }
}

/// Entry [r, c]: the sum of `value` over all rows above r and columns left of c.
fn summed(rows: usize, cols: usize, value: impl Fn(usize, usize) -> f64) -> Array2<f64> {
    let mut sums = Array2::zeros((rows + 1, cols + 1));
    for r in 0..rows {
        let mut along = 0.0;
        for c in 0..cols {
            along += value(r, c);
            sums[[r + 1, c + 1]] = sums[[r, c + 1]] + along;
        }
    }
    sums
}

/// The sum over rows and columns (first, end) of such sums.
fn over(sums: &Array2<f64>, (top, bottom): (usize, usize), (left, right): (usize, usize)) -> f64 {
    sums[[bottom, right]] - sums[[top, right]] - sums[[bottom, left]] + sums[[top, left]]
}

/// Measurements of one part of an object set through one mask, cut at random places.
pub struct MeasurementStream {
    set: Arc<ObjectSet>,
    convolver: Convolver,
    bias: f64,
    noise: Noise,
    split: Split,
    patch: (usize, usize),
}

impl MeasurementStream {
    /// Independent patches: each is cut from its own measurement. A smaller number of a seed gives the first of a
    /// larger number.
    ///
    /// # Errors
    /// As [`PatchStream::draw`].
    pub fn draw_one_each(&self, count: usize, seed: u64) -> Result<PatchBatch, InformationError> {
        let (rows, cols) = self.convolver.plan().measurement_shape();
        self.cut(count, seed, Patches::one_each((count, rows, cols), self.patch, seed))
    }

    /// Base images that the patches of [`MeasurementStream::draw_one_each`] show through the mask's point spread
    /// function, shape (planes, rows, cols); `None` for beads.
    ///
    /// # Errors
    /// As [`PatchStream::draw`].
    pub fn shared_images(
        &self,
        forward: &ForwardModel,
        psf: ArrayView3<'_, f64>,
        count: usize,
        seed: u64,
    ) -> Result<Option<SharedImages>, InformationError> {
        let (rows, cols) = self.convolver.plan().measurement_shape();
        let places = Patches::one_each((count, rows, cols), self.patch, seed);
        let places = places.map_err(|error| InformationError::Stream { reason: error.to_string() })?;
        Ok(forward.shared_images(psf, self.patch, ObjectDraw { split: self.split, first: 0, seed }, &places))
    }

    /// Patches at `places` of the measurements of a number of objects of a seed. They are drawn in parts: few large
    /// images fit into memory at a time.
    fn cut(
        &self,
        objects: usize,
        seed: u64,
        places: Result<Patches, SensorError>,
    ) -> Result<PatchBatch, InformationError> {
        let cut = || -> Result<_, ForwardError> {
            let places = places?;
            let mut clean = Array3::zeros((places.corners().len(), self.patch.0, self.patch.1));
            for first in (0..objects).step_by(self.set.batch()) {
                let count = self.set.batch().min(objects - first);
                let drawn = self.set.objects_from(self.split, first, count, seed)?;
                let measured = self.convolver.measure(drawn.view(), self.bias)?;
                places.cut_some(first, measured.view(), &mut clean);
            }
            Ok(clean)
        };
        let clean = cut().map_err(|error| InformationError::Stream { reason: error.to_string() })?;
        let noisy = self.noise.draw(clean.view(), SeedStream::PatchNoise.derive(seed));
        Ok(PatchBatch { noisy, clean: Some(clean) })
    }
}

impl PatchStream for MeasurementStream {
    fn draw(&self, count: usize, seed: u64) -> Result<PatchBatch, InformationError> {
        if self.convolver.plan().measurement_shape() == self.patch {
            // Each object has one whole measurement.
            return self.draw_one_each(count, seed);
        }
        let ((rows, cols), objects) = (self.convolver.plan().measurement_shape(), count.div_ceil(PATCHES_PER_OBJECT));
        self.cut(objects, seed, Patches::draw((objects, rows, cols), self.patch, count, seed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::{ObjectOptions, ObjectSource};
    use crate::optics::{heuristic_layout, render_psf};
    use ndarray::s;

    /// Mosaics of twelve images as large as a tile, of which number k is k + 1 everywhere.
    fn twelve_images() -> ObjectSet {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("images.idx");
        let mut bytes: Vec<u8> = vec![0, 0, 8, 3, 0, 0, 0, 12, 0, 0, 0, 32, 0, 0, 0, 32];
        bytes.extend((1..=12).flat_map(|level| [level; 32 * 32]));
        std::fs::write(&path, bytes).unwrap();
        let options = ObjectOptions { field: (100, 90), mean_photons: 6.5, ..ObjectOptions::default() };
        ObjectSet::open(&ObjectSource::Idx(path), &options).unwrap()
    }

    #[test]
    fn few_images_are_not_fitted_to_alone() {
        let set = twelve_images();
        let forward = ForwardModel::new(set.clone(), (32, 32), 10.0, Noise::Shot).unwrap();
        let convolver = forward.convolver(render_psf(&heuristic_layout(3), 1).unwrap().view()).unwrap();
        let (stream, validation) = forward.fitting(&convolver, (20, 26), 5).unwrap();
        let validation = validation.unwrap();
        let held_out = forward.stream(convolver.clone(), Split::Validation, (20, 26));
        assert_eq!(validation.noisy, held_out.draw_one_each(VALIDATION_PATCHES, 5).unwrap().noisy);
        assert_eq!(stream.split, Split::Fit);
        let shown = |split| {
            let objects = set.images_from(split, 0, 60, 5).unwrap();
            objects.iter().flatten().map(|placed| placed.image).collect::<std::collections::BTreeSet<_>>()
        };
        let (fit, validation) = (shown(Split::Fit), shown(Split::Validation));
        assert!(fit.is_disjoint(&validation) && validation.len() == 1);
        assert_eq!(&fit | &validation, shown(Split::Train));
        // Beads are unlimited.
        let set = ObjectSet::open(&"beads:0.05".parse().unwrap(), &ObjectOptions::default()).unwrap();
        assert_eq!(set.fitting_parts(), (Split::Train, None));
    }

    #[test]
    fn the_light_of_a_patch_is_that_of_the_images_it_shows() {
        let (set, psf) = (twelve_images(), render_psf(&heuristic_layout(3), 1).unwrap());
        let forward = ForwardModel::new(set.clone(), (32, 32), 10.0, Noise::Shot).unwrap();
        let stream = forward.stream(forward.convolver(psf.view()).unwrap(), Split::All, (20, 26));
        // More than one batch.
        let count = set.batch() + 40;
        let clean = stream.draw_one_each(count, 5).unwrap().clean.unwrap();
        let shared = stream.shared_images(&forward, psf.view(), count, 5).unwrap().unwrap();
        assert_eq!(shared.images(), 12);
        for (patch, shares) in clean.outer_iter().zip(shared.shares()) {
            let expected: f64 = shares.iter().map(|(image, share)| share * f64::from(image + 1)).sum();
            let found = f64::from(patch.mean().unwrap()) - 10.0;
            // What is left out of the shares is a thousandth of the light of each image.
            assert!((found - expected).abs() < 0.02, "{found} {expected}");
        }
    }

    #[test]
    fn independent_patches_of_a_seed_begin_alike() {
        let options = ObjectOptions { field: (27, 27), mean_photons: 100.0, ..ObjectOptions::default() };
        let set = ObjectSet::open(&"beads:0.05".parse().unwrap(), &options).unwrap();
        let psf = render_psf(&heuristic_layout(2), 1).unwrap().slice_move(s![.., 8..20, 8..20]);
        let forward = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap();
        let stream = forward.stream(forward.convolver(psf.view()).unwrap(), Split::Test, (6, 6));
        let (few, more) = (stream.draw_one_each(5, 3).unwrap(), stream.draw_one_each(9, 3).unwrap());
        assert_eq!(few.noisy, more.noisy.slice(s![..5, .., ..]));
        assert_eq!(few.clean.unwrap(), more.clean.unwrap().slice(s![..5, .., ..]));
    }
}
