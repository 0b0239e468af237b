//! Elementwise operations over several slices, in vector instructions.
//!
//! The compiler vectorises a plain loop over several slices only if it checks that they do not overlap. Whether it
//! does so depends on the code around the loop. Here a few numbers of every slice are loaded before any is stored.

/// Numbers processed side by side.
pub(crate) const LANES: usize = 16;

/// Operation that replaces `O` numbers, given those and `I` others.
pub(crate) trait Elementwise<const I: usize, const O: usize> {
    /// The new numbers; always inlined.
    fn apply(&self, from: [f32; I], to: [f32; O]) -> [f32; O];
}

/// Defines an [`Elementwise`] operation without parameters, or with a constant: whether this processor [multiplies
/// and adds](super::multiplies_and_adds) in one instruction.
macro_rules! elementwise {
    ($(#[$meta:meta])* $name:ident $(<$fused:ident>)?, $from:expr => $to:expr, |$given:pat_param, $old:pat_param| $body:expr) => {
        $(#[$meta])*
        pub(crate) struct $name $(<const $fused: bool>)?;

        impl $(<const $fused: bool>)? $crate::nn::kernels::elementwise::Elementwise<{ $from }, { $to }> for $name $(<$fused>)? {
            #[inline(always)]
            #[allow(clippy::inline_always, reason = "loops around it become vector code only when it is inlined")]
            fn apply(&self, $given: [f32; $from], $old: [f32; $to]) -> [f32; $to] {
                $body
            }
        }
    };
}
pub(crate) use elementwise;

/// Applies an operation to each number of `to`, with those of `from` at the same place; all slices are as long as the first
/// of `to`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
pub(crate) fn each<E: Elementwise<I, O>, const I: usize, const O: usize>(
    operation: &E,
    from: [&[f32]; I],
    mut to: [&mut [f32]; O],
) {
    let count = to.first().map_or(0, |to| to.len());
    let mut at = 0;
    while at + LANES <= count {
        block::<E, I, O, LANES>(operation, at, &from, &mut to);
        at += LANES;
    }
    if at + LANES / 2 <= count {
        block::<E, I, O, { LANES / 2 }>(operation, at, &from, &mut to);
        at += LANES / 2;
    }
    while at < count {
        block::<E, I, O, 1>(operation, at, &from, &mut to);
        at += 1;
    }
}

/// As [`each`], for `N` numbers.
#[inline(always)]
#[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
#[allow(clippy::needless_range_loop, reason = "loops of constant length are unrolled before arrays become registers")]
fn block<E: Elementwise<I, O>, const I: usize, const O: usize, const N: usize>(
    operation: &E,
    at: usize,
    from: &[&[f32]; I],
    to: &mut [&mut [f32]; O],
) {
    let (mut given, mut result) = ([[0.0; N]; I], [[0.0; N]; O]);
    for i in 0..I {
        given[i].copy_from_slice(&from[i][at..at + N]);
    }
    for o in 0..O {
        result[o].copy_from_slice(&to[o][at..at + N]);
    }
    for k in 0..N {
        let (mut values, mut old) = ([0.0; I], [0.0; O]);
        for i in 0..I {
            values[i] = given[i][k];
        }
        for o in 0..O {
            old[o] = result[o][k];
        }
        let new = operation.apply(values, old);
        for o in 0..O {
            result[o][k] = new[o];
        }
    }
    for o in 0..O {
        to[o][at..at + N].copy_from_slice(&result[o]);
    }
}

/// The sum of numbers side by side, by halves: in a serial sum each addition would wait for the one before it.
#[inline(always)]
#[allow(clippy::inline_always, reason = "called in loops over pixels")]
pub(crate) fn sum_of_lanes(lanes: [f32; LANES]) -> f32 {
    let (mut eight, mut four) = ([0.0; LANES / 2], [0.0; LANES / 4]);
    for k in 0..LANES / 2 {
        eight[k] = lanes[k] + lanes[k + LANES / 2];
    }
    for k in 0..LANES / 4 {
        four[k] = eight[k] + eight[k + LANES / 4];
    }
    (four[0] + four[2]) + (four[1] + four[3])
}

/// Root of the sum of squares, in double precision.
pub(crate) fn euclidean_norm(values: &[f32]) -> f64 {
    // Many sums side by side: a single sum waits for every addition.
    let (whole, rest) = values.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for values in whole.iter().map(<[f32; LANES]>::as_slice).chain([rest]) {
        for (sum, &x) in sums.iter_mut().zip(values) {
            *sum += f64::from(x) * f64::from(x);
        }
    }
    sums.iter().sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::test_numbers::numbers;

    elementwise!(Both, 2 => 2, |[a, b], [x, y]| [x + a * b, y - a]);

    #[test]
    fn every_number_is_reached_once_at_every_length() {
        for count in 0..60 {
            let (a, b, x, y) = (numbers(count, 1), numbers(count, 2), numbers(count, 3), numbers(count, 4));
            let (mut first, mut second) = (x.clone(), y.clone());
            each(&Both, [&a, &b], [&mut first, &mut second]);
            for k in 0..count {
                assert_eq!([first[k], second[k]], [x[k] + a[k] * b[k], y[k] - a[k]], "{k} of {count}");
            }
        }
    }

    #[test]
    fn lanes_add_up() {
        let lanes: [f32; LANES] = std::array::from_fn(|k| (1 << k) as f32);
        assert_eq!(sum_of_lanes(lanes), ((1 << LANES) - 1) as f32);
    }
}
