//! Bead configurations with their expected image, and the change of the log-likelihood by one bead.
//!
//! The likelihood is a model: faint light is spread evenly, every pixel expects at least a thousandth of a photon, and shot
//! plus read noise is Gaussian with the sum of both variances. A normalised model that differs from the truth can only
//! loosen either bound. In the upper bound this would count once per group of sites, so its chains end with the exact noise
//! distribution ([`State::correction`]).

use super::light::{LANES, Light};
use crate::information::decoder::problem::Problem;
use crate::information::decoder::samples::Sample;
use crate::information::entropy::likelihood::{ln_normal, ln_poisson, log_likelihood};
use crate::nn::{logarithm, vectorised};
use crate::sensor::Noise;

/// Least photons that the model expects of a pixel.
const LEAST_PHOTONS: f32 = 1e-3;
/// Squared skewness of shot plus read noise below which it counts as Gaussian. The cost is about a twelfth of it, nats per
/// pixel.
const SKEWED: f64 = 1e-3;
/// No site.
const NOWHERE: u32 = u32::MAX;

/// A measurement and the expected photons of its fixed beads.
#[derive(Clone, Debug)]
pub(super) struct Measurement {
    noise: Noise,
    /// Noisy photons, in the form of [`Light::image`].
    noisy: Vec<f32>,
    /// 1 on the patch, 0 beside it.
    inside: Vec<f32>,
    /// Expected photons of the background and the fixed beads.
    known: Vec<f32>,
}

impl Measurement {
    /// The measurement of a sample whose beads at `known` sites are fixed.
    pub fn new(problem: &Problem, light: &Light, sample: &Sample, known: impl Fn(usize) -> bool) -> Self {
        let inside = light.image(&vec![1.0; problem.pixels()], 0.0);
        let mut clean = vec![light.background as f32; inside.len()];
        for site in (0..sample.beads.len()).filter(|&site| sample.beads[site] > 0.0 && known(site)) {
            light.add(site, 1.0, &mut clean);
        }
        Self { noise: problem.noise, noisy: light.image(&sample.noisy, 0.0), inside, known: clean }
    }
}

/// Beads at the free sites, with the image that they produce.
#[derive(Clone, Debug)]
pub(super) struct State<'a> {
    light: &'a Light,
    measured: &'a Measurement,
    /// Sites that hold a bead, in any order.
    pub occupied: Vec<u32>,
    /// Position of each site in that list.
    places: Vec<u32>,
    clean: Vec<f32>,
}

impl<'a> State<'a> {
    /// A state with beads at the given sites, out of `sites`.
    pub fn new(
        light: &'a Light,
        measured: &'a Measurement,
        sites: usize,
        occupied: impl Iterator<Item = usize>,
    ) -> Self {
        let occupied: Vec<u32> = occupied.map(|site| site as u32).collect();
        let mut places = vec![NOWHERE; sites];
        for (place, &site) in occupied.iter().enumerate() {
            places[site as usize] = place as u32;
        }
        let mut state = Self { light, measured, occupied, places, clean: Vec::new() };
        state.refresh();
        state
    }

    /// Whether there is a bead at a site.
    pub fn holds(&self, site: usize) -> bool {
        self.places[site] != NOWHERE
    }

    /// Recomputes the image, without the rounding of many small changes.
    pub fn refresh(&mut self) {
        self.clean.clone_from(&self.measured.known);
        for &site in &self.occupied {
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

    /// Exact minus modelled log-likelihood, nats; 0 where the model is exact.
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

    /// Change of the log-likelihood by `sign` more beads at a site, nats.
    pub fn log_likelihood_change(&self, site: usize, sign: f32) -> f64 {
        let (light, clean) = (self.light, &self.clean[..]);
        let Measurement { noise, noisy, inside, .. } = self.measured;
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

    /// Adds the photons of `sign` beads at a site to the image, without changing the beads.
    pub fn add_photons(&mut self, site: usize, sign: f32) {
        self.light.add(site, sign, &mut self.clean);
    }

    /// Adds a bead at an empty site or removes it from an occupied one, without changing the image.
    pub fn toggle(&mut self, site: usize) {
        let place = std::mem::replace(&mut self.places[site], NOWHERE);
        if place == NOWHERE {
            self.places[site] = self.occupied.len() as u32;
            self.occupied.push(site as u32);
        } else {
            self.occupied.swap_remove(place as usize);
            if let Some(&moved) = self.occupied.get(place as usize) {
                self.places[moved as usize] = place;
            }
        }
    }
}

/// Defines a change of the log-likelihood: `$term` of expected photons before and after, and of measured photons.
macro_rules! log_likelihood_change {
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

log_likelihood_change!(shot_gain<FUSED>, (), |before, after, noisy| noisy * logarithm::<FUSED>(after / before)
    - (after - before));
// At high photon counts the rounding of the ratio would dominate; Kahan's form takes the logarithm of the change instead.
log_likelihood_change!(bright_gain<FUSED>, (), |before, after, noisy| {
    let change = after - before;
    let (ratio, share) = (after / before, change / before);
    let step = ratio - 1.0;
    let log = if step == 0.0 { share } else { logarithm::<FUSED>(ratio) * (share / step) };
    noisy * log - change
});
log_likelihood_change!(read_gain<FUSED>, (), |before, after, noisy| (after - before)
    * (noisy - 0.5 * (after + before)));
log_likelihood_change!(both_gain<FUSED>, (variance), |before, after, noisy| {
    let (v0, v1) = (before + variance, after + variance);
    let (d0, d1) = (noisy - before, noisy - after);
    0.5 * (d0 * d0 / v0 - d1 * d1 / v1 - logarithm::<FUSED>(v1 / v0))
});
