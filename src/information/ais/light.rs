//! Bead responses as runs of pixels, laid out for vector instructions.

use ndarray::Array3;

use crate::information::decoder::problem::Problem;

/// Pixels per vector; the length of every run is a multiple of it.
pub(super) const LANES: usize = 8;
/// Largest share of a bead's photons that is spread evenly over the patch, so that a bead touches fewer pixels.
const FAINT_SHARE: f64 = 2e-3;
/// Largest energy of that faint light over the noise variance of a pixel. Its information about a bead is half of this,
/// nats.
const FAINT_ENERGY: f64 = 0.02;

/// Photons per pixel above which changes of the log-likelihood are computed with compensated logarithms. Below, rounding
/// costs at most 6e-4 nats.
const BRIGHT: f64 = 1e4;

/// A run of pixels in one row of a bead response.
#[derive(Clone, Copy, Debug)]
struct Run {
    row: usize,
    col: usize,
    /// Place of its first pixel in the photons of all runs.
    start: usize,
    length: usize,
}

/// Responses of single beads on an image of the patch. The image has dark columns on both sides, so no run is cut.
#[derive(Clone, Debug)]
pub(super) struct Light {
    /// Rows and columns of the sites of one plane.
    pub grid: (usize, usize),
    patch: (usize, usize),
    /// Rows and columns of the spot, less one.
    last: (isize, isize),
    border: usize,
    /// Photons of all runs.
    pub photons: Vec<f32>,
    planes: Vec<Vec<Run>>,
    /// Variance of the noise of a pixel of average light, photons squared.
    pub variance: f64,
    /// Whether single precision rounds the ratios of light too coarsely for counts this large.
    pub is_bright: bool,
    /// Photons per pixel without beads, plus the mean of the faint light that the runs leave out.
    pub background: f64,
}

impl Light {
    /// From a bead response of shape (planes, rows, cols), photons.
    pub fn new(spot: &Array3<f64>, problem: &Problem) -> Self {
        let (_, rows, cols) = spot.dim();
        let total: f64 = spot.sum();
        let bias = f64::from(problem.bias);
        let sigma = problem.noise.read_sigma().unwrap_or(0.0);
        let shot = if problem.noise.has_shot_noise() { bias + total * problem.probability } else { 0.0 };
        let variance = (shot + sigma * sigma).max(f64::MIN_POSITIVE);
        let mut sorted: Vec<f64> = spot.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let (mut faint, mut energy) = (FAINT_SHARE * total, FAINT_ENERGY * variance);
        let peak = sorted.last().copied().unwrap_or_default();
        let least = sorted.into_iter().find(|photons| {
            faint -= photons;
            energy -= photons * photons;
            faint < 0.0 || energy < 0.0
        });
        let least = least.unwrap_or(0.0);
        let (mut photons, mut planes) = (Vec::new(), Vec::new());
        for plane in spot.outer_iter() {
            let mut runs = Vec::new();
            for (row, line) in plane.outer_iter().enumerate() {
                let mut col = 0;
                while let Some(ahead) = line.iter().skip(col).position(|&value| value >= least && value > 0.0) {
                    let (first, start) = (col + ahead, photons.len());
                    col = first;
                    while (col < cols && line[col] >= least && line[col] > 0.0) || (photons.len() - start) % LANES > 0 {
                        photons.push(line.get(col).map_or(0.0, |&value| value as f32));
                        col += 1;
                    }
                    runs.push(Run { row, col: first, start, length: photons.len() - start });
                }
            }
            planes.push(runs);
        }
        let followed: f64 = photons.iter().map(|&value| f64::from(value)).sum();
        let border = planes.iter().flatten().map(|run| run.length).max().unwrap_or(0);
        Self {
            grid: (problem.sites.rows, problem.sites.cols),
            patch: problem.patch,
            last: (rows as isize - 1, cols as isize - 1),
            border,
            photons,
            planes,
            variance,
            is_bright: bias + peak > BRIGHT,
            background: bias + (total - followed).max(0.0) * problem.probability,
        }
    }

    /// Length of a row of the image.
    fn stride(&self) -> usize {
        self.patch.1 + 2 * self.border
    }

    /// An image of `patch` (rows, cols) with the value `border` in the columns on both sides.
    pub fn image(&self, patch: &[f32], border: f32) -> Vec<f32> {
        let mut image = vec![border; self.patch.0 * self.stride()];
        for (line, values) in image.chunks_exact_mut(self.stride()).zip(patch.chunks_exact(self.patch.1)) {
            line[self.border..self.border + self.patch.1].copy_from_slice(values);
        }
        image
    }

    /// The pixels of the patch in an image, row by row.
    pub fn patch_of<'a>(&'a self, image: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
        let inside = self.border..self.border + self.patch.1;
        image.chunks_exact(self.stride()).flat_map(move |line| &line[inside.clone()]).copied()
    }

    /// First pixel in the image, first of the [`Light::photons`], and length, of every run of a site that reaches the patch.
    #[inline]
    pub fn runs(&self, site: usize) -> impl Iterator<Item = (usize, usize, usize)> + '_ {
        let (rows, cols) = self.grid;
        let (plane, place) = (site / (rows * cols), site % (rows * cols));
        // The last pixel of the spot of site (0, 0) lies on pixel (0, 0).
        let (top, left) = ((place / cols) as isize - self.last.0, (place % cols) as isize - self.last.1);
        self.planes[plane].iter().filter_map(move |run| {
            let (row, col) = (top + run.row as isize, left + run.col as isize);
            let seen = row >= 0 && row < self.patch.0 as isize && col < self.patch.1 as isize;
            let seen = seen && col + run.length as isize > 0;
            seen.then(|| (row as usize * self.stride() + (col + self.border as isize) as usize, run.start, run.length))
        })
    }

    /// Adds `sign` beads at a site to an image.
    pub fn add(&self, site: usize, sign: f32, image: &mut [f32]) {
        for (first, start, length) in self.runs(site) {
            let photons = &self.photons[start..start + length];
            for (pixel, photons) in image[first..first + length].iter_mut().zip(photons) {
                *pixel += sign * photons;
            }
        }
    }
}
