//! The linear maps of Winograd's minimal filtering F(4, 3), and their application to many channels.
//!
//! The product of polynomials of four and of three numbers takes one multiplication at each of six points: 0, 1, -1,
//! 2, -2 and infinity. Its transpose computes four outputs from six inputs and three taps (Lavin & Gray 2016).

use std::ops::{Add, Mul, Sub};

use pulp::{Arch, Simd, WithSimd};

use super::matmul::Write;

/// Outputs of a tile.
pub(in crate::nn) const TILE: usize = 4;
/// Taps in a row.
pub(in crate::nn) const TAPS: usize = 3;
/// Inputs of a tile, and points at which their polynomials are multiplied.
pub(in crate::nn) const POINTS: usize = TILE + TAPS - 1;

/// Number type of a transform: one number, or a vector register of them.
pub(in crate::nn) trait Number:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<f32, Output = Self>
{
}

impl Number for f32 {}

/// A vector register of numbers.
#[derive(Clone, Copy)]
struct Lanes<S: Simd>(S, S::f32s);

impl<S: Simd> Number for Lanes<S> {}

#[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
impl<S: Simd> Add for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0, self.0.add_f32s(self.1, other.1))
    }
}

#[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
impl<S: Simd> Sub for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0, self.0.sub_f32s(self.1, other.1))
    }
}

#[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
impl<S: Simd> Mul<f32> for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f32) -> Self {
        Self(self.0, self.0.mul_f32s(self.1, self.0.splat_f32s(factor)))
    }
}

/// A linear map from `I` to `O` numbers.
pub(in crate::nn) trait Linear<const I: usize, const O: usize> {
    fn apply<N: Number>(&self, from: [N; I]) -> [N; O];
}

/// Defines a [`Linear`] map.
macro_rules! linear {
    ($(#[$meta:meta])* $name:ident, $from:expr => $to:expr, |$pattern:pat_param| $body:expr) => {
        $(#[$meta])*
        pub(in crate::nn) struct $name;

        #[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
        impl Linear<{ $from }, { $to }> for $name {
            #[inline(always)]
            fn apply<N: Number>(&self, $pattern: [N; $from]) -> [N; $to] {
                $body
            }
        }
    };
}

linear!(InputsToPoints, POINTS => POINTS, |[x0, x1, x2, x3, x4, x5]| {
    let (near_even, near_odd) = (x4 - x2 * 4.0, x3 - x1 * 4.0);
    let (far_even, far_odd) = (x4 - x2, (x3 - x1) * 2.0);
    [
        x0 * 4.0 - x2 * 5.0 + x4,
        near_even + near_odd,
        near_even - near_odd,
        far_even + far_odd,
        far_even - far_odd,
        x1 * 4.0 - x3 * 5.0 + x5,
    ]
});

linear!(
    /// The transpose of [`InputsToPoints`].
    PointsToInputs, POINTS => POINTS, |[p0, p1, p2, p3, p4, p5]| {
        let (near, far) = (p1 + p2, p3 + p4);
        let (near_skew, far_skew) = (p1 - p2, (p3 - p4) * 2.0);
        [
            p0 * 4.0,
            (p5 - near_skew) * 4.0 - far_skew,
            p0 * -5.0 - near * 4.0 - far,
            near_skew + far_skew - p5 * 5.0,
            p0 + near + far,
            p5,
        ]
    }
);

linear!(PointsToOutputs, POINTS => TILE, |[p0, p1, p2, p3, p4, p5]| {
    let (near, far) = (p1 + p2, p3 + p4);
    let (near_skew, far_skew) = (p1 - p2, p3 - p4);
    [p0 + near + far, near_skew + far_skew * 2.0, near + far * 4.0, near_skew + far_skew * 8.0 + p5]
});

linear!(
    /// The transpose of [`PointsToOutputs`].
    OutputsToPoints, TILE => POINTS, |[y0, y1, y2, y3]| {
        let (near_even, near_odd) = (y0 + y2, y1 + y3);
        let (far_even, far_odd) = (y0 + y2 * 4.0, y1 * 2.0 + y3 * 8.0);
        [y0, near_even + near_odd, near_even - near_odd, far_even + far_odd, far_even - far_odd, y3]
    }
);

linear!(TapsToPoints, TAPS => POINTS, |[a, b, c]| {
    let (near_even, near_odd) = ((a + c) * (-1.0 / 6.0), b * (1.0 / 6.0));
    let (far_even, far_odd) = (a * (1.0 / 24.0) + c * (1.0 / 6.0), b * (1.0 / 12.0));
    [a * 0.25, near_even - near_odd, near_even + near_odd, far_even + far_odd, far_even - far_odd, c]
});

linear!(
    /// The transpose of [`TapsToPoints`].
    PointsToTaps, POINTS => TAPS, |[p0, p1, p2, p3, p4, p5]| {
        let (near, far) = ((p1 + p2) * (1.0 / 6.0), p3 + p4);
        let odd = (p2 - p1) * (1.0 / 6.0) + (p3 - p4) * (1.0 / 12.0);
        [p0 * 0.25 - near + far * (1.0 / 24.0), odd, far * (1.0 / 6.0) - near + p5]
    }
);

/// Applies `linear` `count` times to all channels of places of `source` and `target`, both (places, channels).
/// `places` returns these places. A missing input place reads as zeros; a missing output place is not written.
pub(in crate::nn) fn transform<L: Linear<I, O>, P: Fn(usize) -> Places<I, O>, const I: usize, const O: usize>(
    linear: L,
    channels: usize,
    source: &[f32],
    target: &mut [f32],
    write: Write,
    count: usize,
    places: P,
) {
    Arch::new().dispatch(Transform { linear, channels, source, target, write, count, places });
}

/// Places of the inputs and of the outputs of a map.
pub(in crate::nn) type Places<const I: usize, const O: usize> = ([Option<usize>; I], [Option<usize>; O]);

struct Transform<'a, L, P, const I: usize, const O: usize> {
    linear: L,
    channels: usize,
    source: &'a [f32],
    target: &'a mut [f32],
    write: Write,
    count: usize,
    places: P,
}

#[allow(clippy::inline_always, reason = "vector instructions reach it only inside the dispatched function")]
impl<L: Linear<I, O>, P: Fn(usize) -> Places<I, O>, const I: usize, const O: usize> WithSimd
    for Transform<'_, L, P, I, O>
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { linear, channels, source, target, write, count, places } = self;
        let zero = simd.splat_f32s(0.0);
        for n in 0..count {
            // Read by reference: places passed by value are copied first, which delays each tile.
            let (from, to) = places(n);
            let mut seen: [&[f32]; I] = [&[]; I];
            for (seen, place) in seen.iter_mut().zip(&from) {
                if let Some(place) = place {
                    *seen = &source[place * channels..(place + 1) * channels];
                }
            }
            let seen_vectors = seen.map(|seen| S::as_simd_f32s(seen).0);
            for vector in 0..channels / S::F32_LANES {
                let mut values = [Lanes(simd, zero); I];
                for (value, seen) in values.iter_mut().zip(&seen_vectors) {
                    if let Some(seen) = seen.get(vector) {
                        value.1 = *seen;
                    }
                }
                let results = linear.apply(values);
                for (place, result) in to.iter().zip(&results) {
                    let Some(place) = place else { continue };
                    let first = place * channels + vector * S::F32_LANES;
                    let given = &mut S::as_mut_simd_f32s(&mut target[first..first + S::F32_LANES]).0[0];
                    *given = if write == Write::Add { simd.add_f32s(*given, result.1) } else { result.1 };
                }
            }
            for channel in channels - channels % S::F32_LANES..channels {
                let results = linear.apply(seen.map(|seen| seen.get(channel).copied().unwrap_or_default()));
                for (place, result) in to.iter().zip(&results) {
                    let Some(place) = place else { continue };
                    let given = &mut target[place * channels + channel];
                    *given = if write == Write::Add { *given + result } else { *result };
                }
            }
        }
    }
}
