//! Beads that could have made a measurement, with their light, and what one bead more or less would change.
//!
//! The likelihood is that of a model: light too faint to be followed is spread evenly, no pixel expects less than a
//! thousandth of a photon, and shot plus read noise is Gaussian with the sum of both variances. A normalised model of the
//! measurements that is not quite the truth can only raise an upper bound, and can only lower a lower one. From above it would do so
//! for every group of sites, so that walks end with the exact law of the noise there ([`State::correction`]).

use super::light::{LANES, Light};
use crate::information::decoder::problem::Problem;
use crate::information::decoder::samples::Sample;
use crate::information::entropy::likelihood::{ln_normal, ln_poisson, log_likelihood};
use crate::nn::{logarithm, vectorised};
use crate::sensor::Noise;

/// Least photons that the model expects of a pixel.
const LEAST_PHOTONS: f32 = 1e-3;
/// Squared skewness of shot plus read noise below which it is as good as Gaussian: a twelfth of it is about what that costs a pixel,
/// nats.
const SKEWED: f64 = 1e-3;
/// No site.
const NOWHERE: u32 = u32::MAX;

/// A measurement, and the light that is known to be in it.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    noise: Noise,
    /// Noisy photons, in the form of [`Light::image`].
    noisy: Vec<f32>,
    /// 1 on the patch, 0 beside it.
    inside: Vec<f32>,
    /// Photons of the background and of the beads that are known.
    known: Vec<f32>,
}

impl Measured {
    /// The measurement of a sample whose beads at `known` sites are no question.
    pub fn new(scene: &Problem, light: &Light, sample: &Sample, known: impl Fn(usize) -> bool) -> Self {
        let inside = light.image(&vec![1.0; scene.pixels()], 0.0);
        let mut clean = vec![light.background as f32; inside.len()];
        for site in (0..sample.beads.len()).filter(|&site| sample.beads[site] > 0.0 && known(site)) {
            light.add(site, 1.0, &mut clean);
        }
        Self { noise: scene.noise, noisy: light.image(&sample.noisy, 0.0), inside, known: clean }
    }
}

/// Beads at the sites in question.
#[derive(Clone, Debug)]
pub(super) struct State<'a> {
    light: &'a Light,
    measured: &'a Measured,
    /// Sites that hold a bead, in any order.
    pub lit: Vec<u32>,
    /// Where each site stands in that list.
    places: Vec<u32>,
    clean: Vec<f32>,
}

impl<'a> State<'a> {
    /// With beads at the given ones of `sites` sites.
    pub fn new(light: &'a Light, measured: &'a Measured, sites: usize, lit: impl Iterator<Item = usize>) -> Self {
        let lit: Vec<u32> = lit.map(|site| site as u32).collect();
        let mut places = vec![NOWHERE; sites];
        for (place, &site) in lit.iter().enumerate() {
            places[site as usize] = place as u32;
        }
        let mut state = Self { light, measured, lit, places, clean: Vec::new() };
        state.refresh();
        state
    }

    /// Whether there is a bead at a site.
    pub fn holds(&self, site: usize) -> bool {
        self.places[site] != NOWHERE
    }

    /// Adds up the light anew, without the rounding of many small changes.
    pub fn refresh(&mut self) {
        self.clean.clone_from(&self.measured.known);
        for &site in &self.lit {
            self.light.add(site as usize, 1.0, &mut self.clean);
        }
    }

    /// Log of the probability (density) of the measurement given the beads, nats.
    pub fn log_likelihood(&self) -> f64 {
        let pixels = self.light.patch_of(&self.measured.noisy).zip(self.light.patch_of(&self.clean));
        let terms = pixels.map(|(noisy, clean)| {
            let (noisy, clean) = (f64::from(noisy), f64::from(clean.max(LEAST_PHOTONS)));
            match self.measured.noise {
                Noise::None => f64::NAN,
                Noise::Shot => ln_poisson(noisy, clean),
                Noise::Read { sigma } => ln_normal(noisy - clean, sigma),
                Noise::ShotRead { sigma } => ln_normal(noisy - clean, (clean + sigma * sigma).sqrt()),
            }
        });
        terms.sum()
    }

    /// What the exact law of the noise adds to the log likelihood, nats; nothing where the model has it.
    pub fn correction(&self) -> f64 {
        let noise @ Noise::ShotRead { sigma } = self.measured.noise else { return 0.0 };
        let pixels = self.light.patch_of(&self.measured.noisy).zip(self.light.patch_of(&self.clean));
        let terms = pixels.map(|(noisy, clean)| {
            let (noisy, clean) = (f64::from(noisy), f64::from(clean.max(LEAST_PHOTONS)));
            let variance = clean + sigma * sigma;
            if clean * clean < SKEWED * variance.powi(3) {
                return 0.0;
            }
            log_likelihood(noise, noisy, clean) - ln_normal(noisy - clean, variance.sqrt())
        });
        terms.sum()
    }

    /// What `sign` beads more at a site would add to the log likelihood, nats.
    pub fn gain(&self, site: usize, sign: f32) -> f64 {
        let (light, clean) = (self.light, &self.clean[..]);
        let Measured { noise, noisy, inside, .. } = self.measured;
        let mut sums = [0.0; LANES];
        match *noise {
            Noise::None => {}
            Noise::Shot if light.is_bright => bright_gain(light, (site, sign), clean, noisy, inside, &mut sums),
            Noise::Shot => shot_gain(light, (site, sign), clean, noisy, inside, &mut sums),
            Noise::Read { sigma } => {
                read_gain(light, (site, sign), clean, noisy, inside, &mut sums);
                let precision = (1.0 / (sigma * sigma)) as f32;
                for sum in &mut sums {
                    *sum *= precision;
                }
            }
            Noise::ShotRead { sigma } => {
                let variance = (sigma * sigma) as f32;
                both_gain(light, (site, sign), variance, clean, noisy, inside, &mut sums);
            }
        }
        sums.iter().map(|&sum| f64::from(sum)).sum()
    }

    /// Adds the light of `sign` beads at a site, but not the beads.
    pub fn shine(&mut self, site: usize, sign: f32) {
        self.light.add(site, sign, &mut self.clean);
    }

    /// Puts a bead at a dark site, or takes that of a lit one, but not its light.
    pub fn toggle(&mut self, site: usize) {
        let place = std::mem::replace(&mut self.places[site], NOWHERE);
        if place == NOWHERE {
            self.places[site] = self.lit.len() as u32;
            self.lit.push(site as u32);
        } else {
            self.lit.swap_remove(place as usize);
            if let Some(&moved) = self.lit.get(place as usize) {
                self.places[moved as usize] = place;
            }
        }
    }
}

/// The body of a gain: `$term` from clean photons before and after, noisy photons.
macro_rules! gain {
    ($name:ident<$fused:ident>, ($($extra:ident),*), |$before:ident, $after:ident, $noisy:ident| $term:expr) => {
        vectorised! {
            fn $name<'a, fused $fused>(
                light: &'a Light,
                change: (usize, f32),
                $($extra: f32,)*
                clean: &'a [f32],
                noisy: &'a [f32],
                inside: &'a [f32],
                sums: &'a mut [f32; LANES],
            ) {
                let (site, sign) = change;
                let mut total = [0.0; LANES];
                for (first, start, length) in light.runs(site) {
                    let pixels = first..first + length;
                    let photons = light.photons[start..start + length].as_chunks::<LANES>().0;
                    let clean = clean[pixels.clone()].as_chunks::<LANES>().0;
                    let noisy = noisy[pixels.clone()].as_chunks::<LANES>().0;
                    let inside = inside[pixels].as_chunks::<LANES>().0;
                    for (((photons, clean), noisy), inside) in photons.iter().zip(clean).zip(noisy).zip(inside) {
                        for lane in 0..LANES {
                            let $before = clean[lane].max(LEAST_PHOTONS);
                            let $after = (clean[lane] + sign * photons[lane]).max(LEAST_PHOTONS);
                            let $noisy = noisy[lane];
                            total[lane] += inside[lane] * $term;
                        }
                    }
                }
                *sums = total;
            }
        }
    };
}

gain!(shot_gain<FUSED>, (), |before, after, noisy| noisy * logarithm::<FUSED>(after / before) - (after - before));
// Where light is bright the rounding of the ratio, times the counts, would be as large as the gain: there the logarithm is taken of
// the change, as Kahan does it.
gain!(bright_gain<FUSED>, (), |before, after, noisy| {
    let change = after - before;
    let (ratio, share) = (after / before, change / before);
    let step = ratio - 1.0;
    let log = if step == 0.0 { share } else { logarithm::<FUSED>(ratio) * (share / step) };
    noisy * log - change
});
gain!(read_gain<FUSED>, (), |before, after, noisy| (after - before) * (noisy - 0.5 * (after + before)));
gain!(both_gain<FUSED>, (variance), |before, after, noisy| {
    let (v0, v1) = (before + variance, after + variance);
    let (d0, d1) = (noisy - before, noisy - after);
    0.5 * (d0 * d0 / v0 - d1 * d1 / v1 - logarithm::<FUSED>(v1 / v0))
});
