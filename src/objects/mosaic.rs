//! Mosaics of small images. The paper makes objects of 96 x 96 px from MNIST or CIFAR-10 images in this way.

use ndarray::{Array2, ArrayViewMut2};
use rand::{Rng, RngExt};
use rayon::prelude::*;

use crate::formats::{PixelStack, Samples};

use super::autocovariance::summed_autocorrelation;

/// Common tile side, px. Smaller images are centred in it, so that 28 x 28 px images match those of CIFAR-10.
const COMMON_TILE_PX: usize = 32;

/// Place of an image in the samples.
#[derive(Clone, Copy, Debug)]
struct Place {
    start: usize,
    rows: u32,
    cols: u32,
}

/// Small images, each centred in a square tile of zeros, and their photon scale.
#[derive(Clone, Debug)]
pub(super) struct Mosaic {
    samples: Samples,
    places: Vec<Place>,
    tile: usize,
    photons_per_count: f64,
    /// Count of a truth of 1.
    peak: f32,
}

impl Mosaic {
    /// Mosaic with a mean of `mean` photons per pixel over all tiles; `None` if every pixel is 0. Tiles have 32 px, or
    /// the largest side of any larger image. The pixels have been checked to be finite and not negative.
    pub(super) fn new(stacks: Vec<PixelStack>, mean: f64) -> Option<Self> {
        let (mut samples, mut places, mut tile) = (Samples::U8(Vec::new()), Vec::new(), COMMON_TILE_PX);
        let peak = stacks.iter().map(PixelStack::peak).fold(0.0, f32::max);
        for stack in stacks {
            let pixels = stack.rows * stack.cols;
            tile = tile.max(stack.rows).max(stack.cols);
            let first = samples.len();
            places.extend((0..stack.pages).map(|page| Place {
                start: first + page * pixels,
                rows: stack.rows as u32,
                cols: stack.cols as u32,
            }));
            samples.append(stack.samples);
        }
        let total = total(&samples);
        let counts = total / (places.len() * tile * tile) as f64;
        (total > 0.0).then(|| Self { samples, places, tile, photons_per_count: mean / counts, peak })
    }

    pub(super) fn images(&self) -> usize {
        self.places.len()
    }

    pub(super) fn tile(&self) -> usize {
        self.tile
    }

    /// Photons of a truth of 1.
    pub(super) fn peak(&self) -> f64 {
        f64::from(self.peak) * self.photons_per_count
    }

    /// Draws tiles from `members` for an object of shape (rows, cols). Returns each image with the first row and column
    /// of its tile. A grid larger than the object is cropped at random.
    pub(super) fn tiles(
        &self,
        generator: &mut impl Rng,
        members: &[u32],
        (rows, cols): (usize, usize),
    ) -> Vec<(u32, isize, isize)> {
        let (grid_rows, grid_cols) = (rows.div_ceil(self.tile), cols.div_ceil(self.tile));
        let mut crop = |grid: usize, length: usize| match grid * self.tile - length {
            0 => 0,
            spare => generator.random_range(0..=spare as u64) as usize,
        };
        let (top, left) = (crop(grid_rows, rows) as isize, crop(grid_cols, cols) as isize);
        let places = (0..grid_rows).flat_map(|row| (0..grid_cols).map(move |col| (row, col)));
        let tile = |(row, col): (usize, usize)| {
            let image = members[generator.random_range(0..members.len() as u32) as usize];
            (image, (row * self.tile) as isize - top, (col * self.tile) as isize - left)
        };
        places.map(tile).collect()
    }

    /// Fills `object` with tiles drawn from `members`.
    pub(super) fn draw(&self, generator: &mut impl Rng, members: &[u32], mut object: ArrayViewMut2<f32>) {
        for (image, top, left) in self.tiles(generator, members, object.dim()) {
            self.for_each_pixel(image as usize, |row, col, photons| {
                let place = (top.wrapping_add_unsigned(row) as usize, left.wrapping_add_unsigned(col) as usize);
                if let Some(pixel) = object.get_mut(place) {
                    *pixel = photons as f32;
                }
            });
        }
    }

    /// Passes the pixels of an image as (row, col, photons) within its tile.
    pub(super) fn for_each_pixel(&self, image: usize, mut take: impl FnMut(usize, usize, f64)) {
        let Place { start, rows, cols } = self.places[image];
        let (rows, cols) = (rows as usize, cols as usize);
        let (top, left) = ((self.tile - rows) / 2, (self.tile - cols) / 2);
        for row in 0..rows {
            for col in 0..cols {
                let value = f64::from(self.samples.value(start + row * cols + col));
                take(top + row, left + col, value * self.photons_per_count);
            }
        }
    }

    /// Autocovariance of an endless mosaic of independent tiles of `members`, photons squared. The grid lies at a
    /// uniformly random place.
    ///
    /// Two pixels a lag apart either share a tile or lie in different tiles. A shared tile contributes the linear
    /// autocorrelation of one image. Different tiles contribute the periodic autocorrelation of the mean tile:
    /// `[E lin(image) + circ(mean tile) - lin(mean tile)] / tile^2 - mean^2`.
    pub(super) fn autocovariance(&self, members: &[u32], max_lag: usize) -> Array2<f64> {
        let tile = self.tile;
        let within = tile - 1;
        let images = members.len();
        let of_images = summed_autocorrelation(images, (tile, tile), within, |index, store| {
            self.for_each_pixel(members[index] as usize, store);
        });
        let mean_tile = self.mean_tile(members);
        let of_mean = summed_autocorrelation(1, (tile, tile), within, |_, store| {
            mean_tile.indexed_iter().for_each(|((row, col), &photons)| store(row, col, photons));
        });
        let linear = |lags: &Array2<f64>, down: isize, right: isize| {
            let index = (down + within as isize, right + within as isize);
            if index.0 < 0 || index.1 < 0 {
                0.0
            } else {
                lags.get((index.0 as usize, index.1 as usize)).map_or(0.0, |&value| value)
            }
        };
        let side = tile as isize;
        let circular = |down: isize, right: isize| {
            let (down, right) = (down.rem_euclid(side), right.rem_euclid(side));
            linear(&of_mean, down, right)
                + linear(&of_mean, down - side, right)
                + linear(&of_mean, down, right - side)
                + linear(&of_mean, down - side, right - side)
        };
        let pixels = (tile * tile) as f64;
        let mean = mean_tile.sum() / pixels;
        Array2::from_shape_fn((2 * max_lag + 1, 2 * max_lag + 1), |(row, col)| {
            let (down, right) = (row as isize - max_lag as isize, col as isize - max_lag as isize);
            let same_tile = linear(&of_images, down, right) / images as f64 - linear(&of_mean, down, right);
            (same_tile + circular(down, right)) / pixels - mean * mean
        })
    }

    /// Mean of the tiles of `members`, photons per pixel.
    fn mean_tile(&self, members: &[u32]) -> Array2<f64> {
        let mut sum = Array2::zeros((self.tile, self.tile));
        for &image in members {
            self.for_each_pixel(image as usize, |row, col, photons| sum[[row, col]] += photons);
        }
        sum / members.len() as f64
    }

    /// Adds the content of the set to a fingerprint.
    pub(super) fn hash_into(&self, hasher: &mut blake3::Hasher) {
        hasher.update(&(self.tile as u64).to_le_bytes());
        for place in &self.places {
            hasher.update(&place.rows.to_le_bytes());
            hasher.update(&place.cols.to_le_bytes());
        }
        self.samples.for_each_block(|block| {
            hasher.update(block);
        });
    }
}

/// Sum of all values. The parts are fixed, so the sum does not depend on the number of threads.
pub(super) fn total(samples: &Samples) -> f64 {
    const BLOCK_VALUES: usize = 1 << 18;
    let starts: Vec<usize> = (0..samples.len()).step_by(BLOCK_VALUES).collect();
    let parts: Vec<f64> = starts
        .into_par_iter()
        .map(|start| {
            (start..samples.len().min(start + BLOCK_VALUES)).map(|index| f64::from(samples.value(index))).sum()
        })
        .collect();
    parts.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::Split;

    fn images(pages: usize, rows: usize, cols: usize) -> PixelStack {
        let values = (0..pages * rows * cols).map(|index| ((index * 7919) % 251) as u8 % 97);
        PixelStack::new(pages, rows, cols, Samples::U8(values.collect()))
    }

    #[test]
    fn tiles_are_centred_and_scaled_after_padding() {
        let mosaic = Mosaic::new(vec![images(3, 28, 28)], 100.0).unwrap();
        assert_eq!(mosaic.tile(), 32);
        assert!((mosaic.mean_tile(&[0, 1, 2]).mean().unwrap() - 100.0).abs() < 1e-9);
        let mut object = Array2::zeros((96, 96));
        mosaic.draw(&mut Split::All.generator(0, 0), &[1], object.view_mut());
        let source = images(3, 28, 28).image(1);
        for ((row, col), &photons) in object.indexed_iter() {
            let (row, col) = ((row % 32).wrapping_sub(2), (col % 32).wrapping_sub(2));
            let counts = source.get((row, col)).copied().unwrap_or(0.0);
            assert!((f64::from(photons) - f64::from(counts) * mosaic.photons_per_count).abs() < 1e-3);
        }
        assert!(Mosaic::new(vec![PixelStack { samples: Samples::U8(vec![0; 4]), ..images(1, 2, 2) }], 1.0).is_none());
    }

    #[test]
    fn images_of_several_shapes_share_the_largest_tile() {
        let mosaic = Mosaic::new(vec![images(1, 40, 10), images(2, 3, 5)], 50.0).unwrap();
        assert_eq!((mosaic.tile(), mosaic.images()), (40, 3));
        let mut seen = Vec::new();
        mosaic.for_each_pixel(2, |row, col, _| seen.push((row, col)));
        assert_eq!((seen.len(), seen[0], seen[14]), (15, (18, 17), (20, 21)));
    }

    #[test]
    fn autocovariance_is_that_of_an_endless_mosaic() {
        // Independent check: all pairs of pixels of a large mosaic of equally probable tiles. The expectation is
        // enumerated: two tiles are equal (same cell) or independent.
        let mosaic = Mosaic::new(vec![images(4, 33, 30)], 20.0).unwrap();
        let (tile, max_lag) = (33_isize, 40_isize);
        let tiles: Vec<Array2<f64>> = (0..4)
            .map(|image| {
                let mut pixels = Array2::zeros((33, 33));
                mosaic.for_each_pixel(image, |row, col, photons| pixels[[row, col]] = photons);
                pixels
            })
            .collect();
        let mean_tile = mosaic.mean_tile(&[0, 1, 2, 3]);
        let covariance = mosaic.autocovariance(&[0, 1, 2, 3], max_lag as usize);
        for (down, right) in [(0, 0), (0, 1), (3, -2), (-32, 5), (33, 0), (40, -40), (1, 34)] {
            let mut expected = 0.0;
            for row in 0..tile {
                for col in 0..tile {
                    let (r, c) = (row + down, col + right);
                    let here = [row as usize, col as usize];
                    let there = [r.rem_euclid(tile) as usize, c.rem_euclid(tile) as usize];
                    expected += if (0..tile).contains(&r) && (0..tile).contains(&c) {
                        tiles.iter().map(|pixels| pixels[here] * pixels[there]).sum::<f64>() / 4.0
                    } else {
                        mean_tile[here] * mean_tile[there]
                    };
                }
            }
            expected = expected / (33.0 * 33.0) - 400.0;
            let value = covariance[[(max_lag + down) as usize, (max_lag + right) as usize]];
            assert!((value - expected).abs() < 1e-7, "lag {down}, {right}: {value} against {expected}");
        }
    }

    #[test]
    fn spectrum_is_not_negative() {
        let mosaic = Mosaic::new(vec![images(5, 40, 40)], 100.0).unwrap();
        let covariance = mosaic.autocovariance(&[0, 1, 2, 3, 4], 80);
        // On a torus of three tiles the mean tile repeats exactly, and correlation within a tile does not overlap.
        let torus = Array2::from_shape_fn((120, 120), |(row, col)| {
            let lag = |index: usize| if index <= 60 { 80 + index } else { 80 + index - 120 };
            covariance[[lag(row), lag(col)]]
        });
        let odd = Array2::from_shape_fn((120, 120), |(row, col)| torus[[(row + 60) % 120, (col + 60) % 120]]);
        let least = super::super::autocovariance::least_eigenvalue(&odd);
        assert!(least > -1e-6 * covariance[[80, 80]], "{least}");
    }
}
