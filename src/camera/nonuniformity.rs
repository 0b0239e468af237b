//! Spatial nonuniformity of averaged frames: DSNU, PRNU, and pixels that stand out.

use std::ops::Range;

use super::frames::FrameStack;

/// Robust standard deviations by which a pixel stands out.
const STANDS_OUT: f64 = 6.0;
/// Half the side of the window of the local median, pixels.
const WINDOW: usize = 2;
/// Standard deviation of a normal distribution over its median absolute deviation.
const NORMAL: f64 = 1.4826;
/// Smallest scale of a map, as a share of one step of the grey values.
const LEAST_SCALE: f64 = 0.25;

/// Pixels of a map that stand out.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Outliers {
    pub(super) above: Vec<usize>,
    pub(super) below: Vec<usize>,
}

/// Spatial variance of an averaged frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SpatialVariance {
    /// Variance of the pixels, less what the temporal noise leaves in their means; at least 0. DN^2.
    pub(super) fixed: f64,
    /// Temporal variance that is left in the mean of the frames, DN^2.
    pub(super) temporal: f64,
}

/// Spatial variance of the mean of a stack over the pixels that count (EMVA 1288 release 4.0, equations 30 and 31).
pub(super) fn spatial_variance(map: &[f64], stack: &FrameStack, counts: &[bool]) -> SpatialVariance {
    let kept = || map.iter().zip(counts).filter(|(_, counts)| **counts).map(|(value, _)| *value);
    let pixels = kept().count().max(2) as f64;
    let mean = kept().sum::<f64>() / pixels;
    let measured = kept().map(|value| (value - mean).powi(2)).sum::<f64>() / (pixels - 1.0);
    let temporal = stack.variance.iter().zip(counts).filter(|(_, counts)| **counts).map(|(variance, _)| variance);
    let temporal = temporal.sum::<f64>() / pixels / stack.frames as f64;
    SpatialVariance { fixed: (measured - temporal).max(0.0), temporal }
}

/// Pixels whose values differ from the median of their neighbourhood by more than six robust standard deviations.
///
/// The local median follows shading, the scale is that of the whole map. `step` is that of the grey values.
pub(super) fn outliers(map: &[f64], (rows, cols): (usize, usize), step: f64) -> Outliers {
    let mut window = Vec::with_capacity((2 * WINDOW + 1).pow(2));
    let mut residuals = Vec::with_capacity(map.len());
    for row in 0..rows {
        for col in 0..cols {
            window.clear();
            let (down, across) = neighbours((row, rows), (col, cols));
            for r in down {
                window.extend_from_slice(&map[r * cols + across.start..r * cols + across.end]);
            }
            residuals.push(map[row * cols + col] - median(&mut window));
        }
    }
    let mut sizes: Vec<f64> = residuals.iter().map(|residual| residual.abs()).collect();
    let limit = STANDS_OUT * (NORMAL * median(&mut sizes)).max(LEAST_SCALE * step);
    let found = |stands_out: &dyn Fn(f64) -> bool| {
        residuals.iter().enumerate().filter(|(_, residual)| stands_out(**residual)).map(|(pixel, _)| pixel).collect()
    };
    if limit > 0.0 {
        Outliers { above: found(&|residual| residual > limit), below: found(&|residual| residual < -limit) }
    } else {
        Outliers::default()
    }
}

/// Rows and columns around a pixel, each given with the length of its side. They lie symmetrically around it, so that a slope does not
/// move their median; those of a corner lie inside.
fn neighbours((row, rows): (usize, usize), (col, cols): (usize, usize)) -> (Range<usize>, Range<usize>) {
    let reach = |at: usize, length: usize| WINDOW.min(at).min(length - 1 - at);
    let around = |at: usize, reach: usize, length: usize| at.saturating_sub(reach)..(at + reach + 1).min(length);
    match (reach(row, rows), reach(col, cols)) {
        (0, 0) => (around(row, 1, rows), around(col, 1, cols)),
        (down, across) => (around(row, down, rows), around(col, across, cols)),
    }
}

/// The median; it reorders the values.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Whether more than half of the fixed variance of a map is smooth shading, which the means of blocks of `side` pixels hold. `temporal` is
/// the temporal variance that is left in the map.
pub(super) fn is_shaded(map: &[f64], (rows, cols): (usize, usize), side: usize, temporal: f64) -> bool {
    let across = cols.div_ceil(side);
    let mut blocks = vec![[0.0; 3]; rows.div_ceil(side) * across];
    for (pixel, value) in map.iter().enumerate() {
        let block = &mut blocks[pixel / cols / side * across + pixel % cols / side];
        block[0] += 1.0;
        block[1] += value;
        block[2] += value * value;
    }
    let pixels = map.len() as f64;
    let mean = map.iter().sum::<f64>() / pixels;
    let total = map.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / pixels;
    let within = blocks.iter().map(|[n, sum, squares]| squares - sum * sum / n.max(1.0)).sum::<f64>() / pixels;
    total - temporal > 0.0 && within - temporal < 0.5 * (total - temporal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_that_stand_out_are_found_on_a_slope() {
        let (rows, cols) = (40, 50);
        let mut map: Vec<f64> =
            (0..rows * cols).map(|pixel| (pixel / cols) as f64 * 0.5 + ((pixel * 7919) % 101) as f64 / 101.0).collect();
        map[5 * cols + 7] += 30.0;
        map[5 * cols + 8] += 30.0;
        map[39 * cols + 49] -= 30.0;
        let found = outliers(&map, (rows, cols), 1.0);
        assert_eq!(found, Outliers { above: vec![257, 258], below: vec![1999] });
        assert_eq!(neighbours((0, 9), (4, 9)), (0..1, 2..7));
        assert_eq!(outliers(&vec![3.0; 2000], (rows, cols), 1.0), Outliers::default());
        assert_eq!(outliers(&vec![3.0; 2000], (rows, cols), 0.0), Outliers::default());
    }

    #[test]
    fn temporal_noise_is_taken_out_of_the_spatial_variance() {
        let mean: Vec<f64> = (0..100).map(|pixel| f64::from(pixel % 2) * 2.0).collect();
        let stack = FrameStack {
            shape: (10, 10),
            frames: 4,
            mean: mean.clone(),
            variance: vec![2.0; 100],
            frame_means: (1.0, 1.0),
            range: (0.0, 2.0),
            cut_off_share: 0.0,
            copies: 0,
        };
        let found = spatial_variance(&mean, &stack, &[true; 100]);
        assert!((found.fixed - (100.0 / 99.0 - 0.5)).abs() < 1e-12 && found.temporal == 0.5, "{found:?}");
        let mut counts = [true; 100];
        counts[1..].fill(false);
        counts[3] = true;
        assert!(spatial_variance(&mean, &stack, &counts).fixed >= 0.0);
    }

    #[test]
    fn smooth_shading_is_distinguished_from_pixels() {
        let shape = (64, 64);
        let smooth: Vec<f64> = (0..4096).map(|pixel| f64::from(pixel / 64)).collect();
        let rough: Vec<f64> = (0..4096).map(|pixel| f64::from((pixel * 7919) % 101)).collect();
        assert!(is_shaded(&smooth, shape, 8, 0.0) && !is_shaded(&rough, shape, 8, 0.0));
    }
}
