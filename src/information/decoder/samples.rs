//! New beads and measurements of a channel, each from its own random streams.

use ndarray::ArrayView3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::problem::Problem;
use crate::sensor::BlurWorkspace;

/// Purpose of samples. Streams of different purposes never overlap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::information) enum Purpose {
    Training = 1,
    Test = 2,
    Posterior = 3,
    Slope = 4,
}

/// Identity of a sample: each has its own random streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::information) struct SampleId {
    /// Seed of all samples.
    pub seed: u64,
    /// Purpose of the sample.
    pub purpose: Purpose,
    /// Number among the samples of the purpose.
    pub index: usize,
}

/// Consecutive samples of a seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleRange {
    /// Seed of all samples.
    pub seed: u64,
    /// Number of the first sample.
    pub first: usize,
    /// Number of samples.
    pub count: usize,
}

impl SampleRange {
    /// Identity of a sample, counted from the first of the range.
    pub(in crate::information) fn sample(self, purpose: Purpose, index: usize) -> SampleId {
        SampleId { seed: self.seed, purpose, index: self.first + index }
    }
}

/// Sites that are revealed to the decoder at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::information) enum Reveal {
    /// No sites: all decoded sites are predicted from the measurement alone.
    Nothing,
    /// This number of decoded sites, drawn without replacement, and the weight of the others' code length.
    Random { count: usize, weight: f64 },
}

/// One object and its measurement. Site arrays have the order of [`Problem::sites`].
#[derive(Clone, Debug, Default)]
pub(in crate::information) struct Sample {
    /// 1 where there is a bead, else 0.
    pub beads: Vec<f32>,
    /// Clean photons, the mean of the noisy ones, (rows, cols) of the patch.
    pub clean: Vec<f32>,
    /// Noisy photons, in the same order.
    pub noisy: Vec<f32>,
    /// 1 for sites that are to be predicted, else 0.
    pub free: Vec<f32>,
    /// Probability of a bead at sites that are not to be predicted: 0 or 1 where revealed, the prior where not decoded.
    pub known: Vec<f32>,
    /// Weight of the code length.
    pub weight: f64,
}

/// Streams of one purpose, and the half of them that draws objects.
const PURPOSE_SHIFT: u32 = 56;
const OBJECTS: u64 = 1 << 63;

impl Sample {
    /// Draws a sample.
    pub fn draw(
        &mut self,
        scene: &Problem,
        SampleId { seed, purpose, index }: SampleId,
        reveal: impl FnOnce(&mut ChaCha8Rng) -> Reveal,
        blur: &mut BlurWorkspace,
    ) {
        let stream = ((purpose as u64) << PURPOSE_SHIFT) + index as u64;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(OBJECTS | stream);
        let (sites, pixels) = (scene.site_count(), scene.pixels());
        self.beads.clear();
        self.beads.extend((0..sites).map(|_| f32::from(u8::from(random.random::<f64>() < scene.probability))));

        self.clean.resize(pixels, 0.0);
        scene.light.blur(&self.beads, &mut self.clean, blur);
        for photons in &mut self.clean {
            *photons = photons.max(0.0) + scene.bias;
        }
        if let Ok(clean) = ArrayView3::from_shape((1, scene.patch.0, scene.patch.1), &self.clean[..]) {
            let noisy = scene.noise.draw_from(clean, stream as usize, seed);
            self.noisy.clear();
            self.noisy.extend(noisy);
        }

        self.free.clear();
        self.free.resize(sites, 0.0);
        self.known.clear();
        self.known.resize(sites, scene.probability as f32);
        for &site in &scene.decoded {
            self.free[site] = 1.0;
        }
        self.weight = 1.0;
        if let Reveal::Random { count, weight } = reveal(&mut random) {
            self.weight = weight;
            // Each site has a number, decoded or not. Masks that decode more or fewer sites thus reveal the others
            // alike.
            let numbers: Vec<u32> = (0..sites).map(|_| random.random()).collect();
            let mut order: Vec<(u32, usize)> = scene.decoded.iter().map(|&site| (numbers[site], site)).collect();
            if count < order.len() {
                order.select_nth_unstable(count);
            }
            for &(_, site) in &order[..count] {
                self.free[site] = 0.0;
                self.known[site] = self.beads[site];
            }
        }
    }

    /// Marks some sites for prediction and reveals all other decoded ones.
    pub fn ask(&mut self, scene: &Problem, asked: impl Fn(usize) -> bool) {
        for &site in &scene.decoded {
            let free = asked(site);
            self.free[site] = f32::from(u8::from(free));
            self.known[site] = if free { scene.probability as f32 } else { self.beads[site] };
        }
    }

    /// Code length of the predicted sites under the prior, bits.
    pub fn prior_bits(&self, probability: f64) -> f64 {
        let (all, lit) = self
            .beads
            .iter()
            .zip(&self.free)
            .fold((0.0, 0.0), |(all, lit), (&bead, &free)| (all + f64::from(free), lit + f64::from(free * bead)));
        -(lit * probability.log2() + (all - lit) * (1.0 - probability).log2())
    }
}
