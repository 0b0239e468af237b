//! Inspection of one measurement on request: its spectrum, and its map of information.

use std::sync::Arc;

use ndarray::{Array2, ArrayView2, Axis, s};

use crate::evaluation::scene::Measurements;
use crate::information::{CausalModel, InformationError, PowerSpectrum, power_spectrum, sliding_information_map};
use crate::progress::CancelToken;

/// Largest side of the region that is transformed, pixels. Of a larger image the middle is taken, so that edits never wait long for its
/// transform.
const LARGEST_SIDE: usize = 512;

/// Pixels of the largest measurement whose map is computed, for the same reason.
const MOST_MAPPED: usize = 256 * 256;

/// Identifies one inspection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InspectionKey {
    /// Revision of the design.
    pub revision: u64,
    /// Index of the measurement.
    pub sample: usize,
    /// Whether the measurement is shown with noise.
    pub noisy: bool,
    /// Training steps of the model behind the information map; none where no map is requested.
    pub steps: Option<usize>,
}

/// Request for an inspection.
#[derive(Clone, Debug)]
pub struct InspectionRequest {
    /// Key of the inspection.
    pub key: InspectionKey,
    /// The measurements of that design.
    pub measurements: Arc<Measurements>,
    /// The model of the live estimate, where the map is requested.
    pub model: Option<Arc<CausalModel>>,
}

/// Result of an inspection.
#[derive(Clone, Debug)]
pub struct SampleInspection {
    /// Key of the inspection.
    pub key: InspectionKey,
    /// Power spectrum of the measurement as it is shown.
    pub spectrum: PowerSpectrum,
    /// Bits that each pixel of the noisy measurement adds to the pixels before it, shape (rows, cols).
    pub map: Option<Array2<f32>>,
}

impl InspectionRequest {
    /// Computes the inspection. Ends without an answer once cancelled, because another design waits.
    pub(crate) fn look(&self, cancel: &CancelToken) -> Option<SampleInspection> {
        let Measurements { noiseless, noisy, counts, .. } = &*self.measurements;
        let last = noisy.len_of(Axis(0)).saturating_sub(1);
        let of = self.key.sample.min(last);
        let (clean, measured) = (noiseless.index_axis(Axis(0), of), noisy.index_axis(Axis(0), of));
        let spectrum = power_spectrum(middle(if self.key.noisy { measured } else { clean }));
        // The model describes the noise of the upper bounds.
        let modelled = counts.as_ref().map_or(measured, |counts| counts.index_axis(Axis(0), of));
        // Without a map the image is shown as it is.
        let model = self.model.as_ref().filter(|_| measured.len() <= MOST_MAPPED);
        let map = match model.map(|model| sliding_information_map(model, modelled, clean, cancel)) {
            Some(Err(InformationError::Cancelled)) => return None,
            map => map.and_then(Result::ok),
        };
        Some(SampleInspection { key: self.key, spectrum, map })
    }
}

/// Returns at most [`LARGEST_SIDE`] rows and columns in the middle of an image.
fn middle(image: ArrayView2<'_, f32>) -> ArrayView2<'_, f32> {
    let (rows, cols) = image.dim();
    let (tall, wide) = (rows.min(LARGEST_SIDE), cols.min(LARGEST_SIDE));
    let (top, left) = ((rows - tall) / 2, (cols - wide) / 2);
    image.slice_move(s![top..top + tall, left..left + wide])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_large_images_is_taken() {
        let image = Array2::from_shape_fn((600, 20), |(row, col)| (100 * row + col) as f32);
        let part = middle(image.view());
        assert_eq!(part.dim(), (512, 20));
        assert_eq!(part[(0, 0)], 4400.0);
    }
}
