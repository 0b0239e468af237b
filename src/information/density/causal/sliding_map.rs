//! Information map of a whole measurement by a model of patches.

use ndarray::{Array2, Array3, ArrayView2, Axis, s};

use super::model::CausalModel;
use super::score::information_map;
use super::stream::PatchBatch;
use crate::information::entropy::noise_entropy::{NoiseEntropy, Protocol};
use crate::information::error::InformationError;
use crate::progress::CancelToken;

/// Patches that are computed at a time.
const AT_ONCE: usize = 16;

/// Information that each pixel of a measurement adds to the pixels before it, bits, within the reach of a patch of
/// the model; shape of the measurement.
///
/// Patches overlap by half. Every pixel is taken from the patch that includes most rows above it and most columns to
/// its left. All of those come before it in raster order, so the sum over the measurement is an upper bound like that
/// over a patch.
///
/// # Errors
/// [`InformationError::Stream`] for a measurement smaller than a patch, and as
/// [`information_map`](super::information_map). Cancelled by the token, which is checked every few patches.
pub fn sliding_information_map(
    model: &CausalModel,
    noisy: ArrayView2<'_, f32>,
    clean: ArrayView2<'_, f32>,
    cancel: &CancelToken,
) -> Result<Array2<f32>, InformationError> {
    let (side_rows, side_cols) = model.patch();
    let (rows, cols) = noisy.dim();
    if rows < side_rows || cols < side_cols || clean.dim() != noisy.dim() {
        let expected = format!("a measurement of at least {side_rows} x {side_cols} pixels and its clean image");
        return Err(InformationError::Stream { reason: format!("expected {expected}, found {rows} x {cols} pixels") });
    }
    let (tops, lefts) = (starts(rows, side_rows), starts(cols, side_cols));
    let places: Vec<(usize, usize)> = tops.iter().flat_map(|&top| lefts.iter().map(move |&left| (top, left))).collect();
    let cut = |image: ArrayView2<'_, f32>, places: &[(usize, usize)]| {
        let mut patches = Array3::zeros((places.len(), side_rows, side_cols));
        for (mut patch, &(top, left)) in patches.outer_iter_mut().zip(places) {
            patch.assign(&image.slice(s![top..top + side_rows, left..left + side_cols]));
        }
        patches
    };
    let entropy = NoiseEntropy::new(model.conditioning.noise, Protocol::Default)?;
    let mut maps = Array3::zeros((places.len(), side_rows, side_cols));
    for (places, mut maps) in places.chunks(AT_ONCE).zip(maps.axis_chunks_iter_mut(Axis(0), AT_ONCE)) {
        if cancel.is_cancelled() {
            return Err(InformationError::Cancelled);
        }
        let batch = PatchBatch { noisy: cut(noisy, places), clean: Some(cut(clean, places)) };
        maps.assign(&information_map(model, &entropy, &batch)?);
    }
    Ok(Array2::from_shape_fn((rows, cols), |(row, col)| {
        let (i, j) = (first_over(&tops, side_rows, row), first_over(&lefts, side_cols, col));
        maps[(i * lefts.len() + j, row - tops[i], col - lefts[j])] as f32
    }))
}

/// Starts of patches along an axis: half a patch apart, the last one at the end.
fn starts(length: usize, side: usize) -> Vec<usize> {
    let last = length - side;
    (0..last).step_by((side / 2).max(1)).chain([last]).collect()
}

/// The first patch that contains a place.
fn first_over(starts: &[usize], side: usize, place: usize) -> usize {
    starts.partition_point(|start| start + side <= place)
}

#[cfg(test)]
mod tests {
    use super::super::conditioning::Moments;
    use super::super::init::Init;
    use super::super::shape::CausalShape;
    use super::*;
    use crate::sensor::Noise;

    #[test]
    fn every_pixel_is_taken_from_the_patch_with_most_context() {
        for (length, side) in [(6, 6), (7, 6), (20, 6), (13, 5), (9, 1)] {
            let starts = starts(length, side);
            assert_eq!((starts[0], starts.last().copied()), (0, Some(length - side)));
            for place in 0..length {
                let start = starts[first_over(&starts, side, place)];
                assert!(start <= place && place < start + side);
                assert!(place - start >= place.min(side / 2), "{length} {side} {place}: {start}");
            }
        }
    }

    #[test]
    fn measurement_of_patch_size_has_the_map_of_the_patch() {
        let clean = Array3::from_shape_fn((40, 9, 11), |(n, r, c)| 5.0 + ((3 * n + r * r + 2 * c) % 13) as f32);
        let batch = PatchBatch { noisy: Noise::Shot.draw(clean.view(), 5), clean: Some(clean.clone()) };
        let patches = |rows: usize, cols: usize| PatchBatch {
            noisy: batch.noisy.slice(s![.., ..rows, ..cols]).to_owned(),
            clean: Some(clean.slice(s![.., ..rows, ..cols]).to_owned()),
        };
        let model = |sample: &PatchBatch| {
            let moments = Moments::of_patches(sample.noisy.view()).unwrap();
            let shape = CausalShape { channels: 6, dilations: vec![1, 2] };
            CausalModel::new(shape, Noise::Shot, sample, &moments, Init::Random, 3).unwrap()
        };
        let over = |model: &CausalModel| {
            sliding_information_map(
                model,
                batch.noisy.slice(s![0, .., ..]),
                clean.slice(s![0, .., ..]),
                &CancelToken::new(),
            )
            .unwrap()
        };
        let whole = model(&batch);
        let entropy = NoiseEntropy::new(Noise::Shot, Protocol::Default).unwrap();
        // The patches are computed in other groups, so sums are rounded differently.
        let same = |one: ArrayView2<'_, f32>, other: ArrayView2<'_, f64>| {
            one.iter().zip(other).all(|(&one, &other)| (f64::from(one) - other).abs() < 1e-4)
        };
        let map = information_map(&whole, &entropy, &batch).unwrap();
        assert!(same(over(&whole).view(), map.slice(s![0, .., ..])));
        // The first patch of a larger measurement has no other past either.
        let (part, sample) = (model(&patches(6, 6)), patches(6, 6));
        let map = information_map(&part, &entropy, &sample).unwrap();
        let all = over(&part);
        assert!(same(all.slice(s![..6, ..6]), map.slice(s![0, .., ..])));
        assert!(all.iter().all(|bits| bits.is_finite()));
        let small = batch.noisy.slice(s![0, ..5, ..]);
        assert!(sliding_information_map(&part, small, clean.slice(s![0, ..5, ..]), &CancelToken::new()).is_err());
        let cancelled = CancelToken::new();
        cancelled.cancel();
        let stopped =
            sliding_information_map(&part, batch.noisy.slice(s![0, .., ..]), clean.slice(s![0, .., ..]), &cancelled);
        assert_eq!(stopped, Err(InformationError::Cancelled));
    }
}
