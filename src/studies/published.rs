//! Published values that estimates are compared with (Kabuli et al., Optica 13(2) 227, 2026): facts, typed in.
//!
//! Each is the smallest of five fits of a PixelCNN to 10,000 patches of 32 x 32 px, with the 95 % interval of that fit:
//! heuristic layouts, 100 photons per pixel on average, 10 photons of background.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::forward::{Design, is_published_field};
use crate::objects::ObjectSource;
use crate::optics::{Encoder, heuristic_layout};
use crate::sensor::Noise;

/// A published estimate, bits per pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Published {
    /// The estimate, bits per pixel.
    pub bits_per_pixel: f64,
    /// Its 95 % interval, bits per pixel, where that is known.
    pub interval_95: Option<[f64; 2]>,
}

/// An image set of the published study.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum PublishedSet {
    /// CIFAR-10.
    Cifar10,
    /// MNIST.
    Mnist,
    /// Fashion-MNIST.
    Fashion,
}

impl PublishedSet {
    /// The set of this name.
    pub fn named(name: &str) -> Option<Self> {
        [Self::Cifar10, Self::Mnist, Self::Fashion].into_iter().find(|set| set.to_string() == name)
    }
}

impl fmt::Display for PublishedSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cifar10 => "cifar10",
            Self::Mnist => "mnist",
            Self::Fashion => "fashion",
        })
    }
}

/// Rows and columns of the published patches, pixels.
const PATCH: (usize, usize) = (32, 32);
/// Mean of the published objects, photons per pixel.
const MEAN_PHOTONS: f64 = 100.0;
/// Published background, photons per pixel.
const BIAS_PHOTONS: f64 = 10.0;
/// Published read noise, photons.
const READ_SIGMA: f64 = 5.0;

/// Bead density, lenslets, estimate and ends of its interval in bits per pixel; shot noise.
const BEADS_SHOT: [(f64, usize, f64, f64, f64); 20] = [
    (0.008, 1, 0.13, 0.1185, 0.1418),
    (0.02, 1, 0.267, 0.2559, 0.2768),
    (0.05, 1, 0.492, 0.4829, 0.4993),
    (0.11, 1, 0.6441, 0.639, 0.6475),
    (0.008, 2, 0.1896, 0.1759, 0.2033),
    (0.02, 2, 0.3866, 0.3773, 0.3974),
    (0.05, 2, 0.6169, 0.6107, 0.6219),
    (0.11, 2, 0.5415, 0.5379, 0.5438),
    (0.008, 4, 0.3138, 0.3005, 0.3283),
    (0.02, 4, 0.5801, 0.5721, 0.5893),
    (0.05, 4, 0.5661, 0.5614, 0.5701),
    (0.11, 4, 0.4355, 0.4321, 0.4379),
    (0.008, 6, 0.4081, 0.3935, 0.4224),
    (0.02, 6, 0.6175, 0.6112, 0.6236),
    (0.05, 6, 0.5023, 0.4973, 0.5059),
    (0.11, 6, 0.3751, 0.3723, 0.3773),
    (0.008, 9, 0.504, 0.4892, 0.5173),
    (0.02, 9, 0.57, 0.5645, 0.5759),
    (0.05, 9, 0.433, 0.4285, 0.4363),
    (0.11, 9, 0.317, 0.3139, 0.319),
];

/// Bead density, lenslets and estimate in bits per pixel, shot noise, of cells whose interval is not known.
const BEADS_SHOT_ALONE: [(f64, usize, f64); 6] =
    [(0.02, 3, 0.477), (0.02, 5, 0.617), (0.02, 7, 0.604), (0.02, 8, 0.591), (0.013, 9, 0.605), (0.03, 9, 0.512)];

/// As [`BEADS_SHOT`], read noise of 5 photons.
const BEADS_READ: [(f64, usize, f64, f64, f64); 20] = [
    (0.008, 1, 0.1625, 0.159, 0.167),
    (0.02, 1, 0.3211, 0.3177, 0.325),
    (0.05, 1, 0.5891, 0.5846, 0.592),
    (0.11, 1, 0.8874, 0.8851, 0.8896),
    (0.008, 2, 0.2507, 0.2467, 0.2542),
    (0.02, 2, 0.4671, 0.4636, 0.4717),
    (0.05, 2, 0.8327, 0.8297, 0.8367),
    (0.11, 2, 0.8208, 0.8188, 0.8226),
    (0.008, 4, 0.3865, 0.3824, 0.3914),
    (0.02, 4, 0.7402, 0.7346, 0.7461),
    (0.05, 4, 0.8486, 0.8467, 0.8504),
    (0.11, 4, 0.698, 0.6963, 0.6993),
    (0.008, 6, 0.4965, 0.4912, 0.5019),
    (0.02, 6, 0.866, 0.8626, 0.8701),
    (0.05, 6, 0.7756, 0.7739, 0.7775),
    (0.11, 6, 0.6212, 0.6195, 0.6225),
    (0.008, 9, 0.6208, 0.6151, 0.6266),
    (0.02, 9, 0.846, 0.8435, 0.8484),
    (0.05, 9, 0.6927, 0.6907, 0.6942),
    (0.11, 9, 0.5431, 0.5414, 0.5445),
];

/// Image set, lenslets, estimate and ends of its interval in bits per pixel; shot noise.
const IMAGES_SHOT: [(PublishedSet, usize, f64, f64, f64); 15] = [
    (PublishedSet::Cifar10, 1, 0.3953, 0.3886, 0.4026),
    (PublishedSet::Cifar10, 2, 0.3249, 0.3186, 0.3314),
    (PublishedSet::Cifar10, 4, 0.2517, 0.2458, 0.2574),
    (PublishedSet::Cifar10, 6, 0.2069, 0.2009, 0.2124),
    (PublishedSet::Cifar10, 9, 0.1691, 0.1633, 0.1744),
    (PublishedSet::Fashion, 1, 0.2978, 0.2833, 0.314),
    (PublishedSet::Fashion, 2, 0.3624, 0.3467, 0.3788),
    (PublishedSet::Fashion, 4, 0.4456, 0.4312, 0.4591),
    (PublishedSet::Fashion, 6, 0.4436, 0.4308, 0.4556),
    (PublishedSet::Fashion, 9, 0.3829, 0.37, 0.3941),
    (PublishedSet::Mnist, 1, 0.2367, 0.229, 0.2446),
    (PublishedSet::Mnist, 2, 0.3155, 0.306, 0.3275),
    (PublishedSet::Mnist, 4, 0.482, 0.471, 0.4944),
    (PublishedSet::Mnist, 6, 0.5807, 0.5707, 0.5949),
    (PublishedSet::Mnist, 9, 0.611, 0.6015, 0.6238),
];

/// The published estimate for a design imaging beads, or the image set that its objects correspond to. `None` where layout, light, noise
/// or patch is not a published one.
pub(super) fn published(
    design: &Design,
    images: Option<PublishedSet>,
    patch: Option<(usize, usize)>,
) -> Option<Published> {
    let light = (design.mean_photons, design.bias_photons) == (MEAN_PHOTONS, BIAS_PHOTONS);
    if !light || !is_published_field(&design.field) || patch != Some(PATCH) {
        return None;
    }
    let lenslets = heuristic_lenslets(&design.encoder)?;
    let with_interval = |&(_, _, bits, low, high): &(_, _, f64, f64, f64)| (bits, Some([low, high]));
    let (bits_per_pixel, interval_95) = match (&design.objects, images, design.noise) {
        (_, Some(set), Noise::Shot) => {
            let row = IMAGES_SHOT.iter().find(|row| (row.0, row.1) == (set, lenslets))?;
            (row.2, Some([row.3, row.4]))
        }
        (ObjectSource::Beads { density }, None, Noise::Shot) => {
            let row = BEADS_SHOT.iter().find(|row| (row.0, row.1) == (*density, lenslets));
            let alone = || BEADS_SHOT_ALONE.iter().find(|row| (row.0, row.1) == (*density, lenslets));
            row.map(with_interval).or_else(|| alone().map(|row| (row.2, None)))?
        }
        (ObjectSource::Beads { density }, None, Noise::Read { sigma: READ_SIGMA }) => {
            BEADS_READ.iter().find(|row| (row.0, row.1) == (*density, lenslets)).map(with_interval)?
        }
        _ => return None,
    };
    Some(Published { bits_per_pixel, interval_95 })
}

/// Number of lenslets, where the encoder is a heuristic layout.
pub(super) fn heuristic_lenslets(encoder: &Encoder) -> Option<usize> {
    let array = encoder.lenslets()?;
    let count = array.lenslets.len();
    ((1..=9).contains(&count) && *array == heuristic_layout(count)).then_some(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn design(objects: &str, lenslets: usize, noise: &str) -> Design {
        Design {
            encoder: Encoder::Lenslets(heuristic_layout(lenslets)),
            objects: objects.parse().unwrap(),
            noise: noise.parse().unwrap(),
            ..Design::default()
        }
    }

    #[test]
    fn cells_of_the_published_grid_are_found() {
        let bits = |objects, lenslets, noise, images| {
            published(&design(objects, lenslets, noise), images, Some((32, 32)))
                .map(|found| (found.bits_per_pixel, found.interval_95))
        };
        assert_eq!(bits("beads:0.02", 4, "shot", None), Some((0.5801, Some([0.5721, 0.5893]))));
        assert_eq!(bits("beads:0.02", 8, "shot", None), Some((0.591, None)));
        assert_eq!(bits("beads:0.02", 4, "read:5", None), Some((0.7402, Some([0.7346, 0.7461]))));
        let set = Some(PublishedSet::Mnist);
        assert_eq!(bits("idx:a.gz", 9, "shot", set), Some((0.611, Some([0.6015, 0.6238]))));
        assert_eq!(bits("idx:a.gz", 9, "shot", None), None);
        assert_eq!(bits("idx:a.gz", 3, "shot", set), None);
        assert_eq!(bits("beads:0.021", 4, "shot", None), None);
        assert_eq!(bits("beads:0.02", 4, "read:4", None), None);
        assert_eq!(bits("beads-max:0.02", 4, "shot", None), None);
    }

    #[test]
    fn other_patches_light_and_masks_have_no_published_value() {
        let known = design("beads:0.02", 4, "shot");
        assert!(published(&known, None, PATCH.into()).is_some());
        assert_eq!(published(&known, None, Some((16, 16))), None);
        assert_eq!(published(&known, None, None), None);
        assert_eq!(published(&Design { mean_photons: 50.0, ..known.clone() }, None, Some(PATCH)), None);
        assert_eq!(published(&Design { bias_photons: 5.0, ..known.clone() }, None, Some(PATCH)), None);
        let mut moved = heuristic_layout(4);
        moved.lenslets[0].x += 0.5;
        assert_eq!(published(&Design { encoder: Encoder::Lenslets(moved), ..known }, None, Some(PATCH)), None);
    }

    #[test]
    fn published_values_lie_in_their_intervals() {
        let rows = BEADS_SHOT.iter().chain(&BEADS_READ).map(|row| (row.2, row.3, row.4));
        for (bits, low, high) in rows.chain(IMAGES_SHOT.iter().map(|row| (row.2, row.3, row.4))) {
            assert!(low < bits && bits < high, "{low} {bits} {high}");
        }
    }
}
