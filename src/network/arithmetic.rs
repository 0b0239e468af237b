//! Exponential and logarithm that the compiler can turn into vector instructions, and the choice of the widest ones.

/// Defines a function whose body is compiled for the widest vector instructions of this processor (AVX-512, AVX2, NEON,
/// or the baseline).
///
/// The choice is made at run time, so one program runs on any machine of its architecture. The body must be part of the
/// function that the choice leads to, which an attribute on a closure cannot ask for; hence the struct.
macro_rules! vectorised {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident<$life:lifetime $(, const $constant:ident: usize)?>(
        $($argument:ident: $kind:ty),* $(,)?
    ) $body:block) => {
        $(#[$meta])*
        $visibility fn $name<$life $(, const $constant: usize)?>($($argument: $kind),*) {
            struct Work<$life $(, const $constant: usize)?> {
                $($argument: $kind,)*
                lifetime: std::marker::PhantomData<&$life ()>,
            }
            impl$(<const $constant: usize>)? pulp::NullaryFnOnce for Work<'_ $(, $constant)?> {
                type Output = ();
                #[inline(always)]
                fn call(self) {
                    let Self { $($argument,)* .. } = self;
                    $body
                }
            }
            let work: Work<'_ $(, $constant)?> = Work { $($argument,)* lifetime: std::marker::PhantomData };
            pulp::Arch::new().dispatch(work);
        }
    };
}
pub(crate) use vectorised;

/// 1.5 * 2^23: adding it to a small number leaves its rounded integer in the low bits.
const ROUND: f32 = 12_582_912.0;

/// e^x, relative error below 3e-7; x is limited to [-87, 88], so the result is never 0, subnormal or infinite.
///
/// Range reduction and polynomial as in Cephes (Moshier 1989), `expf`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "loops around it become vector code only when it is inlined")]
pub fn exponential(x: f32) -> f32 {
    let x = x.clamp(-87.0, 88.0);
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    // ln 2 in two parts, the first short enough for an exact product.
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let mut p = 1.987_569_1e-4;
    for c in [1.398_199_9e-3, 8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 0.5] {
        p = p * r + c;
    }
    let power_of_two = f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3f80_0000));
    (p * r * r + r + 1.0) * power_of_two
}

/// Below this a share of a whole counts for nothing.
const NEGLIGIBLE: f32 = 1e-19;

/// A share of a whole, or 0 where it is too small to count: products of such shares and of gradients are subnormal, with
/// which processors may calculate many times more slowly. Measurements of dark scenes would be full of them.
#[inline(always)]
#[allow(clippy::inline_always, reason = "loops around it become vector code only when it is inlined")]
pub fn if_not_negligible(share: f32) -> f32 {
    if share > NEGLIGIBLE { share } else { 0.0 }
}

/// Natural logarithm of a positive normal number, relative error below 3e-7 (absolute near 1).
///
/// Range reduction and polynomial as in Cephes (Moshier 1989), `logf`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "loops around it become vector code only when it is inlined")]
pub fn logarithm(x: f32) -> f32 {
    let bits = x.to_bits();
    let mantissa = f32::from_bits((bits & 0x007f_ffff) | 0x3f00_0000);
    let exponent = ((bits >> 23) as i32 - 126) as f32;
    let small = mantissa < std::f32::consts::FRAC_1_SQRT_2;
    let exponent = if small { exponent - 1.0 } else { exponent };
    let m = if small { mantissa + mantissa } else { mantissa } - 1.0;
    let square = m * m;
    let mut p = 7.037_683_6e-2;
    for c in [
        -1.151_461e-1,
        1.167_699_9e-1,
        -1.242_014_1e-1,
        1.424_932_3e-1,
        -1.666_805_7e-1,
        2.000_071_5e-1,
        -2.499_999_4e-1,
        3.333_333e-1,
    ] {
        p = p * m + c;
    }
    let low = p * m * square - exponent * 2.121_944_4e-4 - 0.5 * square;
    exponent * 0.693_359_4 + (m + low)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_is_that_of_the_standard_library() {
        for i in -8700..=8800_i16 {
            let x = f32::from(i) * 0.01;
            let expected = f64::from(x).exp();
            let error = (f64::from(exponential(x)) - expected) / expected;
            assert!(error.abs() < 3e-7, "{x}: {error}");
        }
        assert!(exponential(-1e30) > 0.0 && exponential(1e30).is_finite());
        assert!(exponential(f32::NAN).is_nan());
    }

    #[test]
    fn logarithm_is_that_of_the_standard_library() {
        for i in 0..40_000 {
            let x = (1.0 + i as f32 * 1e-4) * 10_f32.powi(i % 71 - 35);
            let expected = f64::from(x).ln();
            let error = f64::from(logarithm(x)) - expected;
            assert!(error.abs() < 3e-7 * expected.abs().max(1.0), "{x}: {error}");
        }
        assert!(logarithm(1.0).abs() < 1e-9);
    }
}
