//! Warm starts of a model for a mask that has changed: same intensity grid and weights, new statistics.

use std::sync::Arc;

use ndarray::{Array3, Axis};

use super::conditioning::{Conditioning, Moments};
use super::levels::Levels;
use super::model::{CausalModel, check};
use super::shape::CausalShape;
use super::stream::PatchBatch;
use crate::information::entropy::noise_entropy::{NoiseEntropy, Protocol};
use crate::information::error::InformationError;
use crate::nn::{NetworkError, WeightsHeader, read_details, read_weights, write_weights};
use crate::sensor::Noise;

/// Levels beyond those of a sample that count as used: other samples are brighter and darker.
const MARGIN: usize = 4;
/// Largest distance in rows or columns, px, over which a moved far place counts as the same.
const SAME_PLACE: usize = 2;
/// Header of the file.
const HEADER: WeightsHeader<'_> = WeightsHeader { format: "lenslet-studio/causal-model", version: 1 };

impl CausalModel {
    /// A model before its fit whose intensity grid also covers `extremes` (photons), so that it can be
    /// [retargeted](CausalModel::following) to masks with such measurements.
    ///
    /// # Errors
    /// As [`CausalModel::new`].
    pub fn covering(
        shape: CausalShape,
        noise: Noise,
        sample: &PatchBatch,
        moments: &Moments,
        extremes: &Array3<f32>,
        seed: u64,
    ) -> Result<Self, InformationError> {
        NoiseEntropy::new(noise, Protocol::Default)?;
        check(sample.noisy.view())?;
        let images = sample.clean.as_ref().unwrap_or(&sample.noisy);
        let both = ndarray::concatenate(Axis(0), &[images.view(), extremes.view()])
            .map_err(|error| InformationError::Stream { reason: error.to_string() })?;
        let counts = sample.noisy.iter().all(|y| y.fract() == 0.0);
        let levels = Levels::new(noise, both.view(), counts);
        let conditioning = Conditioning::with_levels(noise, sample, moments, levels)?;
        let mut model = Self::unfitted(shape, conditioning, sample, seed);
        model.begin_as_shipped();
        Ok(model)
    }

    /// This model for the measurements of a slightly different mask. Grid and weights stay; units, linear prediction and far
    /// places are those of the new measurements. Weights of far places that are no longer used are cleared.
    ///
    /// # Errors
    /// As [`CausalModel::new`].
    pub fn following(&self, sample: &PatchBatch, moments: &Moments) -> Result<Self, InformationError> {
        check(sample.noisy.view())?;
        let known = &self.conditioning;
        let conditioning = Conditioning::with_levels(known.noise, sample, moments, known.levels.clone())?;
        let mut conditioning = conditioning.keeping_places_of(&known.far);
        let images = sample.clean.as_ref().unwrap_or(&sample.noisy);
        let frequencies = conditioning.levels.log_frequencies(images.view());
        let last = conditioning.levels.count() - 1;
        let used = conditioning.used;
        conditioning.used =
            (known.used.0.min(used.0.saturating_sub(MARGIN)), known.used.1.max((used.1 + MARGIN).min(last)));
        let (now, before) = (conditioning.used, known.used);
        let mut model = Self::unfitted(self.shape.clone(), conditioning, sample, 0);
        model.weights.copy_from_slice(&self.weights);
        for (index, before) in known.far.iter().enumerate() {
            let now = model.conditioning.far[index];
            if before.0.abs_diff(now.0).max(before.1.abs_diff(now.1)) > SAME_PLACE {
                model.forget_far_place(index);
            }
        }
        for level in before.1 + 1..=now.1 {
            model.start_level(level, before.1, &frequencies);
        }
        for level in now.0..before.0 {
            model.start_level(level, before.0, &frequencies);
        }
        Ok(model)
    }

    /// Cold start on the same intensity grid: pretrained weights for the measurements of another mask.
    ///
    /// # Errors
    /// As [`CausalModel::new`].
    pub fn anew(&self, sample: &PatchBatch, moments: &Moments) -> Result<Self, InformationError> {
        check(sample.noisy.view())?;
        let known = &self.conditioning;
        let conditioning = Conditioning::with_levels(known.noise, sample, moments, known.levels.clone())?;
        let mut model = Self::unfitted(self.shape.clone(), conditioning, sample, 0);
        model.begin_as_shipped();
        Ok(model)
    }

    /// Sets the weights of a far place to zero.
    fn forget_far_place(&mut self, index: usize) {
        let places = self.conditioning.far.len();
        for far in self.layers.blocks.iter().filter_map(|block| block.far.as_ref()) {
            let weights = &mut self.weights[far.wide.kernel.clone()];
            let of_one = weights.len() / places;
            weights[index * of_one..(index + 1) * of_one].fill(0.0);
        }
    }

    /// Starts a newly used level with the weights of the nearest used one. While it was unused, the fit made it ever less likely
    /// without data.
    fn start_level(&mut self, level: usize, from: usize, log_frequencies: &[f32]) {
        let head = &self.layers.head;
        let kernel = &mut self.weights[head.kernel.clone()];
        for row in kernel.chunks_exact_mut(head.outputs) {
            row[level] = row[from];
        }
        let bias = &mut self.weights[head.bias.clone()];
        bias[level] = bias[from] + log_frequencies[level] - log_frequencies[from];
    }

    /// State that [`CausalModel::following`] needs besides the grid, as the bytes of a safetensors file.
    ///
    /// # Errors
    /// Where the weights fit no file.
    pub fn state(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, InformationError> {
        let far: Vec<String> = self.conditioning.far.iter().map(|(rows, cols)| format!("{rows},{cols}")).collect();
        let (darkest, brightest) = self.conditioning.used;
        let own = [("far", far.join(" ")), ("used", format!("{darkest},{brightest}"))];
        let details = details.into_iter().chain(own).collect();
        Ok(write_weights(&self.layout, &self.weights, &HEADER, details)?)
    }

    /// This model with the state of another one of the same levels.
    ///
    /// # Errors
    /// For other files, and states of another shape.
    pub fn with_state(mut self, bytes: &[u8]) -> Result<Self, InformationError> {
        let details = read_details(bytes, &HEADER)?;
        let text = |name| details.get(name).map(String::as_str).ok_or_else(|| missing(name));
        let place = |text: &str| {
            let (rows, cols) = text.split_once(',')?;
            Some((rows.parse().ok()?, cols.parse().ok()?))
        };
        let far: Option<Vec<(isize, isize)>> = text("far")?.split(' ').map(place).collect();
        let far = far.filter(|far| far.len() == self.conditioning.far.len()).ok_or_else(|| missing("far"))?;
        let used = text("used")?.split_once(',').and_then(|(low, high)| Some((low.parse().ok()?, high.parse().ok()?)));
        let used: Option<(usize, usize)> = used.filter(|(_, high)| *high < self.conditioning.levels.count());
        self.weights = read_weights(&self.layout, bytes)?;
        let mut conditioning = Conditioning::clone(&self.conditioning);
        conditioning.far = far;
        conditioning.used = used.ok_or_else(|| missing("used"))?;
        self.conditioning = Arc::new(conditioning);
        Ok(self)
    }
}

fn missing(name: &str) -> NetworkError {
    NetworkError::Weights { expected: format!("an entry {name:?}"), found: "none that can be read".into() }
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::super::init::Init;
    use super::*;
    use crate::nn::read_detail;

    fn batch(peak: f32, count: usize) -> PatchBatch {
        let clean = Array3::from_shape_fn((count, 6, 7), |(n, r, c)| {
            let distance = (r as f32 - (n * 5 % 6) as f32).hypot(c as f32 - (n * 3 % 7) as f32);
            15.0 + peak * (-0.3 * distance * distance).exp()
        });
        PatchBatch { noisy: Noise::Shot.draw(clean.view(), 5), clean: Some(clean) }
    }

    fn moments(batch: &PatchBatch) -> Moments {
        Moments::of_patches(batch.noisy.view()).unwrap()
    }

    #[test]
    fn model_is_retargeted_to_brighter_measurements_and_restored() {
        let (dim, bright) = (batch(20.0, 40), batch(400.0, 40));
        let shape = CausalShape { channels: 6, dilations: vec![1, 2] };
        let extremes = bright.clean.clone().unwrap();
        let first = CausalModel::covering(shape, Noise::Shot, &dim, &moments(&dim), &extremes, 3).unwrap();
        assert!(first.conditioning.levels.range().1 > 400.0);
        let then = first.following(&bright, &moments(&bright)).unwrap();
        // Newly used levels start from the brightest used one; all other weights stay.
        let (bias, kernel) = (first.layers.head.bias.clone(), first.layers.head.kernel.clone());
        let brightest = first.conditioning.used.1;
        assert!(then.conditioning.used.1 > brightest + 20);
        let last = then.conditioning.used.1 - 5;
        let outputs = first.layers.head.outputs;
        assert_eq!(then.weights[kernel.start + last], first.weights[kernel.start + brightest]);
        assert_eq!(then.weights[kernel.start + outputs + last], first.weights[kernel.start + outputs + brightest]);
        assert!(then.weights[bias.start + last] > -13.0);
        assert_eq!(then.weights[..kernel.start], first.weights[..kernel.start]);
        assert_eq!(
            then.weights[bias.start..=bias.start + brightest],
            first.weights[bias.start..=bias.start + brightest]
        );
        assert!(then.cross_entropy_map(bright.noisy.view()).unwrap().iter().all(|bits| bits.is_finite()));
        let bytes = then.state(vec![("step", "7".into())]).unwrap();
        assert_eq!(read_detail(&bytes, "step").unwrap(), "7");
        // The restored state gives exactly the same model for the next mask.
        let restored = first.clone().with_state(&bytes).unwrap();
        let (one, other) =
            (then.following(&dim, &moments(&dim)).unwrap(), restored.following(&dim, &moments(&dim)).unwrap());
        assert_eq!(
            one.cross_entropy_map(dim.noisy.view()).unwrap(),
            other.cross_entropy_map(dim.noisy.view()).unwrap()
        );
        assert!(first.with_state(&bytes[..bytes.len() - 4]).is_err());
    }

    #[test]
    fn unused_far_places_are_cleared() {
        // Copies of the image at a distance to the right, half as bright.
        let copies = |distance: Option<f64>| {
            let autocovariance = Array2::from_shape_fn((11, 41), |(row, col)| {
                let (down, right) = (row as f64 - 5.0, col as f64 - 20.0);
                let blob = |right: f64| (-0.3 * (down * down + right * right)).exp();
                let copies = distance.map_or(0.0, |distance| blob(right - distance) + blob(right + distance));
                let noise = if (down, right) == (0.0, 0.0) { 20.0 } else { 0.0 };
                100.0 * (1.25 * blob(right) + 0.5 * copies) + noise
            });
            Moments { mean: 30.0, autocovariance }
        };
        let clean = Array3::from_shape_fn((8, 6, 21), |(n, r, c)| ((n * 7 + r * 5 + c * 3) % 40 + 10) as f32);
        let sample = PatchBatch { noisy: Noise::Shot.draw(clean.view(), 5), clean: Some(clean) };
        let shape = CausalShape { channels: 6, dilations: vec![1, 2] };
        let beginning = Init::Random;
        let first = CausalModel::new(shape, Noise::Shot, &sample, &copies(Some(8.0)), beginning, 3).unwrap();
        let place = first.conditioning.far.iter().position(|place| *place == (0, -8)).unwrap();
        let follow = |distance| {
            let then = first.following(&sample, &copies(distance)).unwrap();
            (then.conditioning.far[place], then.weights)
        };
        let (there, known) = follow(Some(8.0));
        assert_eq!(there, (0, -8));
        let changed = |weights: &[f32]| weights.iter().zip(&known).filter(|(now, before)| now != before).count();
        for (distance, expected) in [(Some(9.0), (0, -9)), (None, (0, -8))] {
            let (there, weights) = follow(distance);
            assert_eq!((there, changed(&weights)), (expected, 0));
        }
        let (there, weights) = follow(Some(14.0));
        assert_eq!(there, (0, -14));
        let mut forgotten = 0;
        for far in first.layers.blocks.iter().filter_map(|block| block.far.as_ref()) {
            let kernel = far.wide.kernel.clone();
            let of_one = kernel.len() / first.conditioning.far.len();
            let of_place = kernel.start + place * of_one..kernel.start + (place + 1) * of_one;
            assert!(weights[of_place.clone()].iter().all(|weight| *weight == 0.0));
            forgotten += known[of_place].iter().filter(|weight| **weight != 0.0).count();
        }
        assert!(forgotten > 0);
        assert_eq!(changed(&weights), forgotten, "all else stays");
    }
}
