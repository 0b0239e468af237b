//! Uniform dequantisation of whole counts.

use ndarray::{Array3, ArrayView3, Axis};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// First random stream of the test patches; training patches count from 0.
pub(in crate::information) const TEST_STREAM: u64 = 1 << 32;

/// Whether all values are whole numbers.
pub(in crate::information) fn whole(patches: ArrayView3<'_, f32>) -> bool {
    patches.iter().all(|y| y.fract() == 0.0)
}

/// The patches plus uniform numbers from 0 to 1; one random stream for each patch.
pub(crate) fn dequantised(patches: ArrayView3<'_, f32>, seed: u64, first_stream: u64) -> Array3<f32> {
    let mut out = patches.to_owned();
    let each: Vec<_> = out.axis_iter_mut(Axis(0)).enumerate().collect();
    each.into_par_iter().for_each(|(index, mut patch)| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(first_stream + index as u64);
        patch.iter_mut().for_each(|y| *y += rng.random::<f32>());
    });
    out
}
