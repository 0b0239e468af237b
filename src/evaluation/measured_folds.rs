//! Estimates of few images by cross-validation: every image is a test image once.

use crate::evaluation::measured::{FoldResult, MeasuredConditions, MeasuredImages};
use crate::evaluation::measured_error::MeasuredError;
use crate::evaluation::progress::EstimateProgress;
use crate::evaluation::request::EstimateRequest;
use crate::information::{Estimate, InformationError, PairedDifference, SharedImages, TestPatches};
use crate::plural::counted;
use crate::progress::Progress;

/// Number of images up to which every image is tested.
const FEW_IMAGES: usize = 100;

impl MeasuredImages {
    /// As [`MeasuredImages::estimate_patches`]; up to 100 images are all tested in turn, by models of the others.
    ///
    /// A fifth of the images is held out at a time. The number is the mean over all test patches, the interval that of their images.
    ///
    /// # Errors
    /// As [`MeasuredImages::estimate`].
    pub fn cross_validated(
        &self,
        request: &EstimateRequest,
        conditions: MeasuredConditions,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<(Estimate, TestPatches), MeasuredError> {
        let images = self.photons().dim().0;
        if images > FEW_IMAGES {
            return self.estimate_patches(request, conditions, progress);
        }
        let folds = images.div_ceil(self.test_images());
        let prepared = self.prepare(request, conditions)?;
        let mut results = Vec::new();
        for fold in 0..folds {
            results.push(self.estimate_fold(request, &prepared, fold, progress)?);
        }
        pooled(results, conditions.seed)
    }
}

/// All splits together.
fn pooled(results: Vec<FoldResult>, seed: u64) -> Result<(Estimate, TestPatches), MeasuredError> {
    let folds = results.len() as f64;
    let mean = |value: &dyn Fn(&Estimate) -> f64| results.iter().map(|fold| value(&fold.estimate)).sum::<f64>() / folds;
    let (entropy_y, entropy_y_given_x) = (mean(&|fold| fold.entropy_y), mean(&|fold| fold.entropy_y_given_x));
    let seconds = folds * mean(&|fold| fold.seconds);
    let (mut first, mut information, mut images): (Option<Estimate>, Vec<f64>, Vec<u32>) =
        (None, Vec::new(), Vec::new());
    for fold in results {
        first.get_or_insert(fold.estimate);
        information.extend(fold.information);
        images.extend(fold.images);
    }
    let Some(mut estimate) = first else { return Err(InformationError::Empty.into()) };
    let images = SharedImages::one_each(images);
    // The difference from no information at all.
    let none = TestPatches { information: vec![0.0; information.len()], images: images.clone() };
    if let Some(found) = PairedDifference::new(&information, &none, seed)? {
        estimate.bits_per_pixel = found.bits_per_pixel;
        estimate.bits_per_patch = found.bits_per_pixel * estimate.pixels();
        estimate.interval_95 = found.interval_95;
    }
    (estimate.entropy_y, estimate.entropy_y_given_x, estimate.seconds) = (entropy_y, entropy_y_given_x, seconds);
    estimate.patches_test = information.len();
    estimate.notes.push(format!(
        "cross-validation: all {} were tested in {folds} parts, each by models of the others",
        counted(images.images(), "image")
    ));
    Ok((estimate, TestPatches { information, images }))
}
