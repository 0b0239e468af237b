//! Published reconstructions (Kabuli et al., Optica 13(2) 227, 2026): facts, typed in.

use crate::objects::ObjectSource;
use crate::studies::published::PublishedSet;

/// Density of the published beads.
const DENSITY: f64 = 0.02;
/// PSNR of the published U-nets, dB, by the number of lenslets from 1 to 9.
const BEADS: [f64; 9] = [27.18, 27.81, 28.15, 27.67, 27.46, 27.47, 27.38, 27.34, 27.33];
const MNIST: [f64; 9] = [19.19, 20.78, 22.50, 23.30, 24.46, 24.01, 23.57, 23.35, 23.09];
const FASHION: [f64; 9] = [19.48, 20.03, 20.29, 19.93, 19.67, 19.59, 19.54, 19.53, 19.43];
const CIFAR10: [f64; 9] = [16.51, 16.37, 16.46, 16.16, 15.87, 15.98, 15.85, 15.91, 15.79];

/// Published PSNR of a heuristic layout, dB. It has the light of the paper protocol, which is not that of the default.
pub(super) fn published_psnr_db(source: &ObjectSource, set: Option<PublishedSet>, lenslets: usize) -> Option<f64> {
    let values = match (set, source) {
        (Some(PublishedSet::Mnist), _) => MNIST,
        (Some(PublishedSet::Fashion), _) => FASHION,
        (Some(PublishedSet::Cifar10), _) => CIFAR10,
        (None, ObjectSource::Beads { density }) if *density == DENSITY => BEADS,
        _ => return None,
    };
    values.get(lenslets.checked_sub(1)?).copied()
}
