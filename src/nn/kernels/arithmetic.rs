//! Exponential and logarithm for vector instructions, and the choice of the widest ones.

/// Defines a function whose body is compiled for the widest vector instructions of this processor (AVX-512, AVX2,
/// NEON, or the baseline).
///
/// The choice is made at run time, so one program runs on any machine of its architecture. The body must be inlined
/// into the chosen function. An attribute on a closure cannot require that; hence the struct.
///
/// `fused NAME` among the parameters makes NAME a constant of the body: whether [`multiplies_and_adds`].
macro_rules! vectorised {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident<$life:lifetime, fused $fused:ident>(
        $($argument:ident: $kind:ty),* $(,)?
    ) $body:block) => {
        $(#[$meta])*
        $visibility fn $name<$life>($($argument: $kind),*) {
            $crate::nn::vectorised! {
                #[allow(clippy::too_many_arguments, reason = "those of the function around it")]
                fn vectors<$life, const $fused: bool>($($argument: $kind),*) $body
            }
            if $crate::nn::multiplies_and_adds() {
                vectors::<true>($($argument),*);
            } else {
                vectors::<false>($($argument),*);
            }
        }
    };
    ($(#[$meta:meta])* $visibility:vis fn $name:ident<$life:lifetime $(, const $constant:ident: $type:ident)?>(
        $($argument:ident: $kind:ty),* $(,)?
    ) $body:block) => {
        $(#[$meta])*
        $visibility fn $name<$life $(, const $constant: $type)?>($($argument: $kind),*) {
            struct Work<$life $(, const $constant: $type)?> {
                $($argument: $kind,)*
                lifetime: std::marker::PhantomData<&$life ()>,
            }
            impl$(<const $constant: $type>)? pulp::NullaryFnOnce for Work<'_ $(, $constant)?> {
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

/// Whether vector instructions of this processor multiply and add in one instruction, with one rounding.
pub fn multiplies_and_adds() -> bool {
    !matches!(pulp::Arch::new(), pulp::Arch::Scalar)
}

/// `a b + c`, in one instruction where the processor is known to have it; elsewhere that would be a library call.
#[inline(always)]
#[allow(clippy::inline_always, reason = "loops around it become vector code only when it is inlined")]
fn multiply_add<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// 1.5 * 2^23: adding it to a small number leaves its rounded integer in the low bits.
const ROUND: f32 = 12_582_912.0;

/// e^x, relative error below 3e-7; x is clamped to [-87, 88], so the result is never 0, subnormal or infinite.
///
/// Range reduction and polynomial as in Cephes (Moshier 1989), `expf`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "loops around it become vector code only when it is inlined")]
pub fn exponential<const FUSED: bool>(x: f32) -> f32 {
    let x = x.clamp(-87.0, 88.0);
    let shifted = multiply_add::<FUSED>(x, std::f32::consts::LOG2_E, ROUND);
    let n = shifted - ROUND;
    // ln 2 in two parts, the first short enough for an exact product.
    let r = multiply_add::<FUSED>(n, 2.121_944_4e-4, multiply_add::<FUSED>(n, -0.693_359_4, x));
    let mut p = 1.987_569_1e-4;
    for c in [1.398_199_9e-3, 8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 0.5] {
        p = multiply_add::<FUSED>(p, r, c);
    }
    let power_of_two = f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3f80_0000));
    (multiply_add::<FUSED>(p * r, r, r) + 1.0) * power_of_two
}

/// Shares of a whole below this are set to 0.
const NEGLIGIBLE: f32 = 1e-19;

/// A share of a whole, or 0 where it is negligible. Products of such shares and of gradients would be subnormal, and
/// some processors compute these many times more slowly. Measurements of dark scenes would have many of them.
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
pub fn logarithm<const FUSED: bool>(x: f32) -> f32 {
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
        p = multiply_add::<FUSED>(p, m, c);
    }
    let low = multiply_add::<FUSED>(exponent, -2.121_944_4e-4, multiply_add::<FUSED>(p * m, square, -0.5 * square));
    multiply_add::<FUSED>(exponent, 0.693_359_4, m + low)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors<const FUSED: bool>() -> (f64, f64) {
        let relative = |x: f32| {
            let expected = f64::from(x).exp();
            ((f64::from(exponential::<FUSED>(x)) - expected) / expected).abs()
        };
        let of_exponential = (-8700..=8800_i16).map(|i| relative(f32::from(i) * 0.01)).fold(0.0, f64::max);
        let relative = |x: f32| {
            let expected = f64::from(x).ln();
            (f64::from(logarithm::<FUSED>(x)) - expected).abs() / expected.abs().max(1.0)
        };
        let of_logarithm = (0..40_000).map(|i| relative((1.0 + i as f32 * 1e-4) * 10_f32.powi(i % 71 - 35)));
        (of_exponential, of_logarithm.fold(0.0, f64::max))
    }

    fn edges<const FUSED: bool>() {
        assert!(exponential::<FUSED>(-1e30) > 0.0 && exponential::<FUSED>(1e30).is_finite());
        assert!(exponential::<FUSED>(f32::NAN).is_nan());
        assert!(logarithm::<FUSED>(1.0).abs() < 1e-9);
    }

    #[test]
    fn exponential_and_logarithm_are_those_of_the_standard_library() {
        for (exponential, logarithm) in [errors::<false>(), errors::<true>()] {
            assert!(exponential < 3e-7 && logarithm < 3e-7, "{exponential}, {logarithm}");
        }
        edges::<false>();
        edges::<true>();
    }
}
