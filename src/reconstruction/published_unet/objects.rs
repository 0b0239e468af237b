//! Objects of a scene and their measurements as the network sees them.

use ndarray::{ArrayView2, Axis};
use rayon::prelude::*;

use super::layers::MULTIPLE;
use super::passes::Example;
use crate::objects::{ObjectSet, Split};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;
use crate::reconstruction::protocol::DecoderScene;
use crate::seeds::SeedStream;
use crate::sensor::{Convolution, Convolver};

/// Rows and columns of the images that the network passes.
pub(super) fn padded((rows, cols): (usize, usize)) -> (usize, usize) {
    (rows.next_multiple_of(MULTIPLE), cols.next_multiple_of(MULTIPLE))
}

/// A measurement as the network sees it, row by row: divided by its own maximum, with zeros around it up to the padded field.
pub(super) fn image_of(measurement: ArrayView2<'_, f32>, model: &ImagingModel) -> Vec<f32> {
    let (rows, cols) = padded(model.field());
    let (top, left) = model.sensor_corner();
    let largest = measurement.iter().copied().fold(0.0, f32::max);
    let factor = if largest > 0.0 { 1.0 / largest } else { 0.0 };
    let mut image = vec![0.0; rows * cols];
    for ((row, col), value) in measurement.indexed_iter() {
        image[(top + row) * cols + left + col] = factor * value;
    }
    image
}

/// Source of examples: a part of a set and a model. An object and its noise depend on their number and the seed alone.
pub(super) struct Objects<'a> {
    scene: &'a DecoderScene,
    model: &'a ImagingModel,
    convolver: Convolver,
    set: &'a ObjectSet,
    split: Split,
    seed: u64,
}

impl<'a> Objects<'a> {
    pub(super) fn new(
        (scene, model): (&'a DecoderScene, &'a ImagingModel),
        (set, split): (&'a ObjectSet, Split),
        seed: u64,
    ) -> Result<Self, ReconstructionError> {
        let plan = Convolution::new(model.field(), model.psf().dim())?;
        let convolver = plan.with_psf(model.psf().insert_axis(Axis(0)))?;
        Ok(Self { scene, model, convolver, set, split, seed })
    }

    /// Draws and measures the objects of these numbers.
    pub(super) fn examples(&self, numbers: &[usize]) -> Result<Vec<Example>, ReconstructionError> {
        numbers.par_iter().map(|&number| self.example(number)).collect()
    }

    fn example(&self, number: usize) -> Result<Example, ReconstructionError> {
        let objects =
            self.set.objects_from(self.split, number, 1, SeedStream::ReconstructionObjects.derive(self.seed))?;
        let mut lit = objects.clone();
        self.scene.light.apply(&mut lit);
        let noiseless = self.convolver.measure(lit.view(), self.model.background)?;
        let noise_seed = SeedStream::ReconstructionNoise.derive(self.seed);
        let measured = self.model.noise.draw_from(noiseless.view(), number, noise_seed);
        let (field, cols) = (self.model.field(), padded(self.model.field()).1);
        let mut truth = vec![0.0; padded(field).0 * cols];
        let peak = self.scene.set.peak();
        for ((_, _, row, col), &photons) in objects.indexed_iter() {
            truth[row * cols + col] = (f64::from(photons) / peak) as f32;
        }
        Ok(Example { image: image_of(measured.index_axis(Axis(0), 0), self.model), truth })
    }
}
