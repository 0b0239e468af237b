//! Random images: curves on a dark background, shaded shapes, and dead leaves.

use ndarray::{Array2, s};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Side of an image, px.
pub const TILE: usize = 32;
/// Images of one set.
const COUNT: usize = 150;
/// Pixels next to the border that bodies leave dark.
const MARGIN: usize = 2;

/// Images of one kind, brightness 0 to 1, shape (32, 32) each.
pub fn images(random: &mut ChaCha8Rng) -> Vec<Array2<f32>> {
    let kind: f64 = random.random();
    let strokes = (random.random_range(1..=4), random.random_range(0.8..2.2));
    let grain = if random.random_bool(0.5) { random.random_range(0.0..0.25) } else { 0.0 };
    let leaves = (random.random_range(0.6..2.0), random.random_range(8..60));
    let soft = random.random_bool(0.5);
    (0..COUNT)
        .map(|_| match kind {
            kind if kind < 0.35 => curves(random, strokes),
            kind if kind < 0.7 => bodies(random, grain),
            _ => dead_leaves(random, leaves, soft),
        })
        .collect()
}

/// Up to `most` bright connected curves of half width `width`, px.
fn curves(random: &mut ChaCha8Rng, (most, width): (usize, f32)) -> Array2<f32> {
    let mut tile = Array2::zeros((TILE, TILE));
    let point = |random: &mut ChaCha8Rng| [random.random_range(4.0..28.0_f32), random.random_range(5.0..27.0_f32)];
    let count = random.random_range(1..=most);
    let mut start = point(random);
    for _ in 0..count {
        let (bend, end) = (point(random), point(random));
        let (other, closed) = (point(random), random.random_bool(0.3));
        let end = if closed { start } else { end };
        for step in 0..=60 {
            // A cubic Bezier curve.
            let t = step as f32 / 60.0;
            let mixed = |axis: usize| {
                let (a, b, c, d) = (start[axis], bend[axis], other[axis], end[axis]);
                let u = 1.0 - t;
                u * u * u * a + 3.0 * u * u * t * b + 3.0 * u * t * t * c + t * t * t * d
            };
            dab(&mut tile, (mixed(0), mixed(1)), width);
        }
        start = end;
    }
    tile
}

/// Brightens the pixels around a point.
fn dab(tile: &mut Array2<f32>, (row, col): (f32, f32), width: f32) {
    let reach = width + 1.5;
    let (first_row, first_col) = ((row - reach).max(0.0) as usize, (col - reach).max(0.0) as usize);
    for r in first_row..((row + reach) as usize + 1).min(TILE) {
        for c in first_col..((col + reach) as usize + 1).min(TILE) {
            let distance = (r as f32 - row).hypot(c as f32 - col);
            let light = (width + 0.5 - distance).clamp(0.0, 1.0);
            tile[(r, c)] = tile[(r, c)].max(light);
        }
    }
}

/// Shaded shapes on a dark background, many of them symmetric.
fn bodies(random: &mut ChaCha8Rng, grain: f32) -> Array2<f32> {
    let mut tile = Array2::zeros((TILE, TILE));
    let base = random.random_range(0.15..1.0_f32);
    let slope = [random.random_range(-0.02..0.02_f32), random.random_range(-0.02..0.02_f32)];
    let stripes = if random.random_bool(0.3) { random.random_range(0.05..0.4) } else { 0.0 };
    let period = random.random_range(2.0..9.0_f32);
    for _ in 0..random.random_range(1..=4) {
        let centre = [random.random_range(7.0..25.0_f32), random.random_range(9.0..23.0_f32)];
        let size = [random.random_range(2.0..14.0_f32), random.random_range(2.0..10.0_f32)];
        let power = if random.random_bool(0.5) { 2.0 } else { 8.0 };
        let lean = random.random_range(-0.4..0.4_f32);
        let shade = base * random.random_range(0.6..1.1_f32);
        let mirrored = random.random_bool(0.6);
        for ((row, col), pixel) in tile.indexed_iter_mut() {
            let lit = MARGIN..TILE - MARGIN;
            if !lit.contains(&row) || !lit.contains(&col) {
                continue;
            }
            let (r, c) = (row as f32, col as f32);
            let inside = |centre_col: f32, lean: f32| {
                let down = (r - centre[0]) / size[0];
                let right = (c - centre_col - lean * (r - centre[0])) / size[1];
                (down.abs().powf(power) + right.abs().powf(power)) < 1.0
            };
            if inside(centre[1], lean) || (mirrored && inside(31.0 - centre[1], -lean)) {
                let noise: f32 = StandardNormal.sample(random);
                let stripe = 1.0 - stripes * f32::from(u8::from((r / period).fract() < 0.5));
                let light = shade + slope[0] * (r - 16.0) + slope[1] * (c - 16.0);
                *pixel = (light * stripe * (1.0 + grain * noise)).clamp(0.02, 1.0);
            }
        }
    }
    tile
}

/// Dead leaves: `count` occluding ellipses and rectangles, the smallest of size `smallest`, px.
fn dead_leaves(random: &mut ChaCha8Rng, (smallest, count): (f32, usize), soft: bool) -> Array2<f32> {
    let mut tile = Array2::from_elem((TILE, TILE), random.random_range(0.1..0.9));
    let (middle, spread) = (random.random_range(0.25..0.75_f32), random.random_range(0.05..0.35_f32));
    for _ in 0..count {
        // Sizes of density r^-3, as natural scenes have them.
        let share: f32 = random.random_range(0.02..1.0);
        let size = (smallest / share.sqrt()).min(16.0) * random.random_range(1.0..2.5_f32);
        let (flat, angle) = (random.random_range(0.4..1.0_f32), random.random_range(0.0..std::f32::consts::PI));
        let square = random.random_bool(0.3);
        let centre = [random.random_range(0.0..32.0_f32), random.random_range(0.0..32.0_f32)];
        let normal: f32 = StandardNormal.sample(random);
        let shade = middle + spread * normal;
        let slope = [random.random_range(-0.01..0.01_f32), random.random_range(-0.01..0.01_f32)];
        for ((row, col), pixel) in tile.indexed_iter_mut() {
            let (r, c) = (row as f32 - centre[0], col as f32 - centre[1]);
            let along = (r * angle.cos() + c * angle.sin()).abs() / size;
            let across = (c * angle.cos() - r * angle.sin()).abs() / (size * flat);
            let inside = if square { along.max(across) < 1.0 } else { along * along + across * across < 1.0 };
            if inside {
                *pixel = (shade + slope[0] * r + slope[1] * c).clamp(0.0, 1.0);
            }
        }
    }
    if soft { softened(&tile) } else { tile }
}

/// Means over 3 x 3 pixels.
fn softened(tile: &Array2<f32>) -> Array2<f32> {
    Array2::from_shape_fn(tile.dim(), |(row, col)| {
        let rows = row.saturating_sub(1)..(row + 2).min(TILE);
        let cols = col.saturating_sub(1)..(col + 2).min(TILE);
        tile.slice(s![rows, cols]).mean().unwrap_or(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn images_are_between_dark_and_bright_and_differ() {
        for seed in 0..10 {
            let set = images(&mut ChaCha8Rng::seed_from_u64(seed));
            assert_eq!(set.len(), COUNT);
            assert!(set.iter().flatten().all(|light| (0.0..=1.0).contains(light)));
            let uneven = set.iter().filter(|tile| tile.std(0.0) > 0.01).count();
            assert!(uneven > COUNT * 9 / 10, "{uneven} of kind {seed}");
            assert_ne!(set[0], set[1]);
        }
    }
}
