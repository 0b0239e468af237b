//! Simulated sensors of known gain, noise and nonuniformity, for tests.

use std::fmt::Write;
use std::path::Path;

use ndarray::{Array2, Array3, Axis};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::{CalibratedCamera, ColourChoice, FrameSeries, calibrate};
use crate::formats::write_array;
use crate::progress::CancelToken;
use crate::sensor::Noise;

/// A linear sensor with shot noise, read noise, rounding and saturation.
#[derive(Clone, Debug)]
pub(super) struct SimulatedSensor {
    pub(super) shape: (usize, usize),
    /// DN per electron.
    pub(super) gain: f64,
    pub(super) bits: u32,
    /// Electrons.
    pub(super) dark_noise: f64,
    /// Grey value without light, DN.
    pub(super) offset: f64,
    /// Electrons.
    pub(super) full_well: f64,
    /// Relative standard deviation of the response.
    pub(super) prnu: f64,
    /// Standard deviation of the dark signal, electrons.
    pub(super) dsnu: f64,
    /// Pixels with more dark signal, and that signal in electrons.
    pub(super) hot: Vec<(usize, f64)>,
    /// Pixels of another response, and that response.
    pub(super) dim: Vec<(usize, f64)>,
    /// Share of the signal that is lost at the full well.
    pub(super) bend: f64,
    pub(super) seed: u64,
}

impl Default for SimulatedSensor {
    fn default() -> Self {
        Self {
            shape: (128, 160),
            gain: 0.5,
            bits: 12,
            dark_noise: 5.0,
            offset: 64.3,
            full_well: 1e9,
            prnu: 0.01,
            dsnu: 2.0,
            hot: Vec::new(),
            dim: Vec::new(),
            bend: 0.0,
            seed: 1,
        }
    }
}

impl SimulatedSensor {
    /// Largest grey value.
    fn top(&self) -> f64 {
        f64::from(self.bits).exp2() - 1.0
    }

    /// Electrons at saturation.
    pub(super) fn saturation(&self) -> f64 {
        self.full_well.min((self.top() - self.offset) / self.gain)
    }

    /// Light levels from 4 % of saturation to beyond it, electrons.
    pub(super) fn levels(&self, count: usize) -> Vec<f64> {
        (1..=count).map(|level| 1.1 * self.saturation() * level as f64 / count as f64).collect()
    }

    /// The calibration by this number of levels and of frames for each.
    pub(super) fn calibrated(&self, levels: usize, frames: usize) -> CalibratedCamera {
        let folder = tempfile::tempdir().unwrap();
        let series = FrameSeries::open(&self.write(folder.path(), &self.levels(levels), frames, 0.5)).unwrap();
        calibrate(&series, ColourChoice::default(), &mut CancelToken::new()).unwrap()
    }

    /// Frames of a mean number of electrons; `stream` numbers the group.
    pub(super) fn frames(&self, electrons: f64, count: usize, stream: u64) -> Array3<f32> {
        let (rows, cols) = self.shape;
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        let mut normal = |deviation: f64| deviation * random.sample::<f64, _>(StandardNormal);
        let mut response = Array2::from_shape_simple_fn((rows, cols), || 1.0 + normal(self.prnu));
        // Dark signals of a real sensor have no negative electrons: they stand on a pedestal.
        let mut dark = Array2::from_shape_simple_fn((rows, cols), || normal(self.dsnu));
        self.hot.iter().for_each(|&(pixel, signal)| dark[(pixel / cols, pixel % cols)] += signal);
        self.dim.iter().for_each(|&(pixel, factor)| response[(pixel / cols, pixel % cols)] = factor);
        let mean = response.mapv(|response| (electrons * response).max(0.0) as f32);
        let means = Array3::from_shape_fn((count, rows, cols), |(_, r, c)| mean[(r, c)]);
        let mut frames = Noise::Shot.draw(means.view(), self.seed.wrapping_mul(1009).wrapping_add(stream));
        for (index, mut frame) in frames.axis_iter_mut(Axis(0)).enumerate() {
            let mut random = ChaCha8Rng::seed_from_u64(self.seed + 1);
            random.set_stream(stream << 16 | index as u64);
            frame.zip_mut_with(&dark.mapv(|value| value as f32), |pixel, &dark| {
                let read = self.dark_noise * random.sample::<f64, _>(StandardNormal);
                let electrons = f64::from(*pixel).min(self.full_well);
                let linear = electrons * (1.0 - self.bend * electrons / self.saturation());
                let value = self.offset + self.gain * (linear + f64::from(dark) + read);
                *pixel = value.round().clamp(0.0, self.top()) as f32;
            });
        }
        frames
    }

    /// Writes `frames` frames in the dark and of each level as arrays, and a descriptor with one photon for each electron over
    /// `efficiency`. Returns the descriptor.
    pub(super) fn write(&self, folder: &Path, levels: &[f64], frames: usize, efficiency: f64) -> std::path::PathBuf {
        let mut text = format!("v 4.0\nn {} {} {}\nd 1000\ni dark.npy\n", self.bits, self.shape.1, self.shape.0);
        write_array(&folder.join("dark.npy"), self.frames(0.0, frames, 0).view()).unwrap();
        for (level, electrons) in levels.iter().enumerate() {
            let name = format!("light_{level:02}.npy");
            write_array(&folder.join(&name), self.frames(*electrons, frames, level as u64 + 1).view()).unwrap();
            writeln!(text, "b 1000 {}\ni {name}", electrons / efficiency).unwrap();
        }
        let path = folder.join("camera.txt");
        std::fs::write(&path, text).unwrap();
        path
    }
}
