//! Published lenslet layouts (Kabuli et al. 2026) and random starts.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::lenslets::{Lenslet, LensletArray, Limits, Spot};

/// Centres (row, col) in pixels of the nine heuristic lenslets, in the order in which they are added.
pub const HEURISTIC_CENTRES: [(f64, f64); 9] = [
    (16.0, 16.0),
    (7.0, 9.0),
    (23.0, 21.0),
    (8.0, 24.0),
    (21.0, 5.0),
    (27.0, 13.0),
    (4.0, 16.0),
    (16.0, 26.0),
    (14.0, 7.0),
];

/// Width of the heuristic lenslets in pixels.
pub const HEURISTIC_SIGMA: f64 = 0.8;

/// Depth plane of each lenslet of the depth layouts, and the order in which planes are added to an object.
const DEPTH_PLANES: [usize; 5] = [2, 0, 4, 1, 3];

/// Rows and columns of the published PSF grid.
const GRID: usize = 32;

/// Heuristic layout of `count` lenslets, 1 to 9, equal weights, on a 32x32 grid.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let array = heuristic_layout(9);
/// assert_eq!((array.lenslets.len(), array.rows, array.cols), (9, 32, 32));
/// ```
///
/// # Panics
/// Where `count` is not 1 to 9.
pub fn heuristic_layout(count: usize) -> LensletArray {
    assert!((1..=9).contains(&count), "heuristic layouts have 1 to 9 lenslets");
    let lenslets = HEURISTIC_CENTRES[..count]
        .iter()
        .map(|&(row, col)| Lenslet::round(col, row, HEURISTIC_SIGMA, 1.0 / count as f64))
        .collect();
    LensletArray::new(GRID, GRID, lenslets)
}

/// Layout for volumes of `planes` (1 to 5) depth planes: the first `count` heuristic lenslets (1 to 5), each focused on a
/// different plane.
///
/// Each lenslet has weight 1, so the throughput is `count`; with [`LensletArray::with_throughput`] of 1 the lenslets share
/// the light. Five planes are in focus in the published order 2, 0, 4, 1, 3. Fewer planes are the first of these, numbered
/// by depth. Lenslets beyond `planes` focus on planes without objects, and planes beyond `count` have no lenslet. So
/// min(`count`, `planes`) lenslets image objects.
///
/// ```
/// use lenslet_studio::optics::{depth_layout, render_psf};
///
/// // The third of three lenslets images nothing of two planes.
/// assert_eq!(render_psf(&depth_layout(3, 2), 2)?, render_psf(&depth_layout(2, 2), 2)?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Panics
/// Where `count` or `planes` is not 1 to 5.
pub fn depth_layout(count: usize, planes: usize) -> LensletArray {
    let allowed = 1..=DEPTH_PLANES.len();
    assert!(allowed.contains(&count) && allowed.contains(&planes), "depth layouts have 1 to 5 lenslets and planes");
    let mut array = heuristic_layout(count).with_throughput(count as f64);
    for (index, lenslet) in array.lenslets.iter_mut().enumerate() {
        lenslet.weight = 1.0;
        let in_front = || DEPTH_PLANES[..planes].iter().filter(|&&plane| plane < DEPTH_PLANES[index]).count();
        lenslet.plane = if index < planes { in_front() } else { index };
    }
    array
}

/// Random start of `count` lenslets on a 32x32 grid, equal weights.
///
/// Centres are those of the smallest square grid of at least `count` points over the central 70 % of the PSF (5x5 for 25,
/// as published). They are jittered by N(0, 1.6) and projected into [`Limits`]. Variances are U(1, 5). Lengths are in the
/// published grid units, in which 32 samples span -16 to 16.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// assert_eq!(random_layout(25, 7), random_layout(25, 7));
/// assert_ne!(random_layout(25, 7), random_layout(25, 8));
/// ```
pub fn random_layout(count: usize, seed: u64) -> LensletArray {
    const GRID_UNIT_PX: f64 = (GRID as f64 - 1.0) / GRID as f64;
    const CENTRE: f64 = (GRID as f64 - 1.0) / 2.0;
    const HALF_SPAN: f64 = 0.7 * 16.0;
    const JITTER: f64 = 1.6;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let side = (1..=count).find(|side| side * side >= count).unwrap_or(1);
    let tick = |index: usize| match side {
        1 => 0.0,
        _ => HALF_SPAN * (2.0 * index as f64 / (side - 1) as f64 - 1.0),
    };
    let mut cells: Vec<(usize, usize)> = (0..side * side).map(|cell| (cell / side, cell % side)).collect();
    if side * side > count {
        cells.shuffle(&mut random);
    }
    let lenslets = cells[..count]
        .iter()
        .map(|&(row, col)| {
            let mut coordinate = |index: usize| {
                let jitter: f64 = StandardNormal.sample(&mut random);
                CENTRE + GRID_UNIT_PX * (tick(index) + JITTER * jitter)
            };
            let (y, x) = (coordinate(row), coordinate(col));
            let variance: f64 = random.random_range(1.0..5.0);
            let spot = Spot::Isotropic(GRID_UNIT_PX * variance.sqrt());
            Limits::default().project(Lenslet { x, y, spot, weight: 1.0 / count as f64, plane: 0 }, GRID, GRID)
        })
        .collect();
    LensletArray::new(GRID, GRID, lenslets)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::render_psf;

    #[test]
    fn a_random_start_follows_its_seed_and_the_limits() {
        let array = random_layout(25, 42);
        assert_eq!(array, random_layout(25, 42));
        assert_ne!(array, random_layout(25, 43));
        for lenslet in &array.lenslets {
            assert_eq!(Limits::default().project(*lenslet, 32, 32), *lenslet);
        }
        assert_eq!(random_layout(7, 1).lenslets.len(), 7);
    }

    #[test]
    fn lenslets_in_depth_have_a_plane_and_the_light_of_one_lenslet_each() {
        let planes = |count, planes| depth_layout(count, planes).lenslets.iter().map(|l| l.plane).collect::<Vec<_>>();
        assert_eq!(planes(5, 5), DEPTH_PLANES);
        assert_eq!(planes(5, 3), [1, 0, 2, 3, 4]);
        assert_eq!(planes(3, 1), [0, 1, 2]);
        for count in 1..=5 {
            for planes in 1..=5 {
                let psf = render_psf(&depth_layout(count, planes), planes).unwrap();
                let imaged = count.min(planes);
                assert!((psf.sum() - imaged as f64).abs() < 1e-12);
                let of_as_many = render_psf(&depth_layout(imaged, planes), planes).unwrap();
                assert_eq!(psf, of_as_many, "lenslets beyond the planes change nothing");
                let shared = depth_layout(count, planes).with_throughput(1.0);
                let sum = render_psf(&shared, planes).unwrap().sum();
                assert!((sum - imaged as f64 / count as f64).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn random_starts_have_the_published_spread() {
        let lenslets: Vec<_> = (0..400).flat_map(|seed| random_layout(25, seed).lenslets).collect();
        let mean = |f: &dyn Fn(&Lenslet) -> f64| lenslets.iter().map(f).sum::<f64>() / lenslets.len() as f64;
        assert!((mean(&|l| l.x) - 15.5).abs() < 0.2);
        assert!((mean(&|l| l.y) - 15.5).abs() < 0.2);
        let variance = mean(&|l| l.spot.covariance().0) * (32.0_f64 / 31.0).powi(2);
        assert!((variance - 3.0).abs() < 0.05, "U(1, 5) has mean 3, found {variance}");
    }
}
