//! Throughput of a mask: the sum of its PSF over all planes of the mask.
//!
//! A PSF is a throughput times a kernel of sum 1. The mean measurement is the throughput times the mean of the objects,
//! plus the background. An aperture blocks light, so its throughput is below 1. Lenslets in depth of weight 1 each collect
//! more: k lenslets have throughput k.

use std::fmt::{self, DebugStruct};
use std::ops::RangeInclusive;

/// Least throughput of a mask.
pub const LEAST_THROUGHPUT: f64 = 1e-6;
/// Range of the throughput of lenslets: up to 1 for each plane of the deepest volume.
pub(super) const OF_LENSLETS: RangeInclusive<f64> = LEAST_THROUGHPUT..=64.0;
/// Range of the throughput of apertures and images.
pub(super) const OF_APERTURES: RangeInclusive<f64> = LEAST_THROUGHPUT..=1.0;

/// Throughput of a mask that keeps the light; serde takes it for files without the entry.
pub(super) fn unit() -> f64 {
    1.0
}

/// Ends the debug format of a mask. A throughput of 1 is left out, because keys of earlier programs are made from this
/// format.
pub(super) fn finish_debug(shown: &mut DebugStruct<'_, '_>, throughput: f64) -> fmt::Result {
    if is_unit(&throughput) { shown.finish() } else { shown.field("throughput", &throughput).finish() }
}

/// Whether a throughput needs no entry in a file.
#[allow(clippy::trivially_copy_pass_by_ref, clippy::float_cmp, reason = "serde passes a reference; 1 is exact")]
pub(super) fn is_unit(throughput: &f64) -> bool {
    *throughput == 1.0
}
