//! Tiles of minimal filtering along rows: their input and output pixels, and the places of their numbers.

use super::minimal_filter::{POINTS, TAPS, TILE};

/// Input and output pixels of a tile; `None` outside the image.
#[derive(Clone, Copy, Debug)]
pub(in crate::nn) struct Tile {
    pub seen: [Option<usize>; POINTS],
    pub given: [Option<usize>; TILE],
}

/// Memory of one thread for convolutions by minimal filtering.
#[derive(Clone, Debug, Default)]
pub struct TileMemory {
    pub(in crate::nn) tiles: Vec<Tile>,
    /// (points, tiles, inputs).
    pub(in crate::nn) inputs: Vec<f32>,
    /// (points, tiles, outputs).
    pub(in crate::nn) outputs: Vec<f32>,
    /// (points, rows, inputs, outputs).
    pub(in crate::nn) by_kernel: Vec<f32>,
}

/// The tiles of a row of `cols` pixels with `dilation` px between taps. The input row begins at pixel `seen`, the
/// output row at pixel `given`.
pub(in crate::nn) fn tiles_of_row(
    (cols, dilation): (usize, usize),
    (seen, given): (usize, usize),
) -> impl Iterator<Item = Tile> {
    let inside = move |first: usize, col: usize| (col < cols).then_some(first + col);
    let starts = (0..dilation.min(cols)).flat_map(move |first| (first..cols).step_by(TILE * dilation));
    starts.map(move |start| Tile {
        seen: std::array::from_fn(|i| (start + i * dilation).checked_sub(dilation).and_then(|col| inside(seen, col))),
        given: std::array::from_fn(|i| inside(given, start + i * dilation)),
    })
}

/// The numbers of one point, out of those of all points.
pub(in crate::nn) fn part(values: &[f32], point: usize) -> &[f32] {
    let size = values.len() / POINTS;
    &values[point * size..(point + 1) * size]
}

/// The numbers of one point, mutable.
pub(in crate::nn) fn part_mut(values: &mut [f32], point: usize) -> &mut [f32] {
    let size = values.len() / POINTS;
    &mut values[point * size..(point + 1) * size]
}

/// Places of the points of tile or row `n` of `count`.
pub(in crate::nn) fn points_of(n: usize, count: usize) -> [Option<usize>; POINTS] {
    std::array::from_fn(|point| Some(point * count + n))
}

/// Places of the taps of a row of the kernel.
pub(in crate::nn) fn taps_of(row: usize) -> [Option<usize>; TAPS] {
    std::array::from_fn(|tap| Some(row * TAPS + tap))
}
