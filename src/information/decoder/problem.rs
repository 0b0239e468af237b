//! The decoding problem of a channel: the decoded object pixels, and the blurs that connect them with the patch.

use ndarray::Array3;

use super::channel::BeadChannel;
use crate::information::error::InformationError;
use crate::information::statistics::area_sums::AreaSums;
use crate::nn::PaddedImages;
use crate::sensor::{Convolution, Convolver, Noise};

/// Squared photons per photon of variance below which a bead is not decoded: its information is below 2e-6 bit.
const LEAST_SEPARATION: f64 = 1e-4;
/// Smallest share of a spot's energy on the patch for a decoded site, whatever the variance.
const LEAST_SHARE: f64 = 1e-12;
/// Smallest light of a decoded site, as a share of the brightest one's.
const LEAST_LIGHT: f32 = 1e-4;

/// Parts of a channel that all samples share. Sites are object pixels, in the order (planes, rows, cols).
pub(in crate::information) struct Problem {
    /// Planes, and rows and columns of each: all object pixels whose spot overlaps the patch.
    pub sites: PaddedImages,
    /// Rows and columns of the patch.
    pub patch: (usize, usize),
    /// Probability of a bead.
    pub probability: f64,
    /// Photons without beads.
    pub bias: f32,
    /// Noise of the sensor.
    pub noise: Noise,
    /// From bead probabilities to photons on the patch.
    pub light: Convolver,
    /// From bead variances to variances on the patch.
    pub squared: Convolver,
    /// 1 / photons that a bead at the site leaves on the patch; 0 for sites that are not decoded.
    pub per_light: Vec<f32>,
    /// Indices of the decoded sites. The others also emit light, but the decoder does not predict them, which can
    /// only lower the bound.
    pub decoded: Vec<usize>,
}

impl Problem {
    /// Plans the transforms of a channel.
    ///
    /// # Errors
    /// As [`super::decoder_lower_bound`] for an invalid channel.
    pub fn new(channel: &BeadChannel) -> Result<Self, InformationError> {
        Self::of(channel, channel.checked_spot()?)
    }

    /// As [`Problem::new`], for a spot of the channel with or without its dark edges.
    pub fn of(channel: &BeadChannel, spot: Array3<f64>) -> Result<Self, InformationError> {
        let (planes, spot_rows, spot_cols) = spot.dim();
        let patch = channel.patch;
        let (rows, cols) = (patch.0 + spot_rows - 1, patch.1 + spot_cols - 1);
        let shot = if channel.noise.has_shot_noise() { channel.bias } else { 0.0 };
        let variance = shot + channel.noise.read_sigma().map_or(0.0, |sigma| sigma * sigma);
        let (mut sites, mut decoded) = (0, Vec::new());
        for plane in spot.outer_iter() {
            let sums = AreaSums::new(plane.dim(), |r, c| plane[[r, c]] * plane[[r, c]]);
            let least = (LEAST_SEPARATION * variance).max(LEAST_SHARE * sums.total());
            for row in 0..rows {
                for col in 0..cols {
                    let energy = sums.over(sums.overlap((row, col), patch)).max(0.0);
                    if energy > least {
                        decoded.push(sites);
                    }
                    sites += 1;
                }
            }
        }
        // The sites were counted and the spot is not empty, so the shapes fit.
        let plan = Convolution::new((rows, cols), (spot_rows, spot_cols)).map_err(|_| InformationError::NoLight)?;
        let convolver = |spot: &Array3<f64>| plan.with_psf(spot.view()).map_err(|_| InformationError::NoLight);
        let light = convolver(&spot)?;
        let mut on_patch = vec![0.0; sites];
        light.blur_transposed(&vec![1.0; patch.0 * patch.1], &mut on_patch, &mut light.blur_workspace());
        // The light of a site at the edge may be rounding residue only.
        let least = LEAST_LIGHT * on_patch.iter().copied().fold(0.0, f32::max);
        let mut per_light = vec![0.0; sites];
        for &site in &decoded {
            per_light[site] = 1.0 / on_patch[site].max(least);
        }
        Ok(Self {
            sites: PaddedImages { images: planes, rows, cols },
            patch,
            probability: channel.probability,
            bias: channel.bias as f32,
            noise: channel.noise,
            light,
            squared: convolver(&spot.mapv(|photons| photons * photons))?,
            per_light,
            decoded,
        })
    }

    /// Object pixels, decoded or not.
    pub fn site_count(&self) -> usize {
        self.per_light.len()
    }

    /// Pixels of the patch.
    pub fn pixels(&self) -> usize {
        self.patch.0 * self.patch.1
    }

    /// Prior entropy of a site, nats.
    pub fn prior_nats(&self) -> f64 {
        let p = self.probability;
        -p * p.ln() - (1.0 - p) * (1.0 - p).ln()
    }

    /// Prior log odds of a bead.
    pub fn prior_logit(&self) -> f32 {
        (self.probability / (1.0 - self.probability)).ln() as f32
    }
}
