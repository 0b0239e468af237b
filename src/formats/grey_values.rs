//! Grey values of many pixels: range, smallest distance, saturation and wrapped values.

use std::fmt;

use ndarray::{ArrayView, Dimension};

use super::PixelStack;

/// Largest whole number that a float of 32 bits counts to.
const MOST_WHOLE: f32 = 16_777_216.0;
/// Number of levels of the histogram, those of 16 bits.
const LEVELS: usize = 1 << 16;
/// Least number of pixels at the largest value, and least share of all, that are saturated.
const SATURATED_PIXELS: u64 = 16;
const SATURATED_SHARE: f64 = 1e-4;
/// Least ratio of the pixels at a limit to those at any of the values below it.
const PILE: u64 = 3;
/// Number of values next to the limit that it is compared with.
const BEFORE: usize = 8;
/// Share of the type's range above which a value may be a negative one that wrapped, and below which the median then lies.
const WRAPPED_ABOVE: f64 = 0.9;
const WRAPPED_MEDIAN: f64 = 0.1;
/// Largest share of one value among those that wrapped: more is a limit, as noise takes several values.
const WRAPPED_ALIKE: f64 = 0.8;
/// Number types whose negative values may have wrapped, bits: those of cameras, and of arrays.
const WRAPPED_BITS: std::ops::RangeInclusive<u32> = 8..=16;
const WIDE_BITS: [u32; 2] = [32, 64];

/// Least share of pixels at 0 that were cut off, and least ratio of the pixels at the second value above it to those at the first.
const LEAST_CUT_OFF: f64 = 1e-2;
const LEAST_FLATNESS: f64 = 0.6;

/// Statistics of grey values (DN).
#[derive(Clone, Debug, Default)]
pub struct GreyValues {
    count: u64,
    /// Smallest and largest value.
    range: Option<(f32, f32)>,
    /// Pixels of the largest value.
    at_most: u64,
    /// A value, and the greatest common divisor of the distances to it; `None` once a value is not whole.
    step: Option<(f32, u32)>,
    is_fractional: bool,
    /// Pixels of each value from 0 to 65535; empty where others occur.
    histogram: Vec<u64>,
    /// Pixels just below the largest count of a wide number type.
    wide: u64,
    /// Largest count of the number type: 255 or 65535.
    white: Option<u16>,
}

/// Pixels that have the largest value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saturated {
    /// Share of all pixels.
    pub share: f64,
    /// The value, DN.
    pub value: f32,
}

/// Pixels whose values look like negative ones that wrapped around zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrapped {
    /// Share of all pixels.
    pub share: f64,
    /// Value above which they lie, DN.
    pub above: f64,
    /// Median of all pixels, DN.
    pub median: f64,
}

impl fmt::Display for Saturated {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:.1} % of the pixels are at {}, the largest value", 100.0 * self.share, self.value)
    }
}

impl fmt::Display for Wrapped {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "{:.1} % of the values lie above {} while the median is {}: negative values wrapped around zero; subtract the dark level \
             in signed numbers or floats",
            100.0 * self.share,
            self.above,
            self.median
        )
    }
}

impl GreyValues {
    /// Adds pixels of a number type whose largest count is `white` (`None` for floats). Values that are not finite are left out.
    pub fn add<D: Dimension>(&mut self, pixels: ArrayView<'_, f32, D>, white: Option<u16>) {
        if self.count == 0 {
            self.histogram = vec![0; LEVELS];
            self.white = white;
        }
        for &value in pixels.iter().filter(|value| value.is_finite()) {
            self.count += 1;
            let (low, high) = self.range.unwrap_or((value, value));
            self.at_most = match value.partial_cmp(&high) {
                Some(std::cmp::Ordering::Greater) => 1,
                Some(std::cmp::Ordering::Equal) => self.at_most + 1,
                _ => self.at_most,
            };
            self.range = Some((low.min(value), high.max(value)));
            if is_wide(value) {
                self.wide += 1;
                continue;
            }
            if value.fract() != 0.0 || value.abs() > MOST_WHOLE {
                self.is_fractional = true;
                self.histogram = Vec::new();
                continue;
            }
            let (base, step) = self.step.unwrap_or((value, 0));
            let step = if step == 1 { 1 } else { greatest_common_divisor(step, (value - base).abs() as u32) };
            self.step = Some((base, step));
            if value >= 0.0 {
                if let Some(pixels) = self.histogram.get_mut(value as usize) {
                    *pixels += 1;
                }
            } else {
                self.histogram = Vec::new();
            }
        }
    }

    /// Adds the pixels of a stack.
    pub fn add_stack(&mut self, stack: &PixelStack) {
        for page in 0..stack.pages {
            self.add(stack.image(page).view(), stack.white);
        }
    }

    /// Smallest distance of the values, their greatest common divisor, DN; `None` where values are not whole.
    pub fn step(&self) -> Option<f64> {
        let (_, step) = self.step.filter(|_| !self.is_fractional)?;
        // Equal values have no distance.
        Some(f64::from(step.max(1)))
    }

    /// Number of values from the smallest to the largest, in their steps; `None` where values are not whole.
    pub fn levels(&self) -> Option<f64> {
        let (low, high) = self.range?;
        Some(f64::from(high - low) / self.step()? + 1.0)
    }

    /// Pixels at the largest value, where it is that of the number type or many more have it than the values before it. The top of values
    /// that wrapped is no saturation.
    pub fn saturated(&self) -> Option<Saturated> {
        if self.wrapped().is_some() {
            return None;
        }
        let (low, value) = self.range?;
        let share = self.at_most as f64 / self.count as f64;
        let is_white = self.white.is_some_and(|white| value >= f32::from(white));
        let step = self.step().unwrap_or(1.0) as usize;
        let before = |number: usize| self.histogram.get((value as usize).checked_sub(number * step)?).copied();
        let most_before = (1..=BEFORE).filter_map(before).max();
        // Floats of many values meet at the largest one only by a limit.
        let is_pile = most_before.map_or(self.is_fractional, |most| self.at_most > PILE * most.max(1));
        let is_many = self.at_most >= SATURATED_PIXELS && share >= SATURATED_SHARE;
        // Pixels of two values are a mask, those of one value nothing to go by unless it is the largest count.
        let has_levels = low < value && self.levels().is_none_or(|levels| levels > 2.0);
        let is_all_white = low == value && (is_white || self.is_largest_count(value));
        (is_many && (is_all_white || has_levels && (is_white || is_pile))).then_some(Saturated { share, value })
    }

    /// Whether a value is the largest count of 8 or more bits.
    fn is_largest_count(&self, value: f32) -> bool {
        !self.is_fractional && value >= 255.0 && (value as u32 + 1).is_power_of_two()
    }

    /// Pixels near the top of an unsigned number type, while the median is near its bottom and few lie between.
    pub fn wrapped(&self) -> Option<Wrapped> {
        let (_, high) = self.range?;
        if self.histogram.is_empty() {
            return None;
        }
        let wrapped = |pixels: u64, above: f64| Wrapped {
            share: pixels as f64 / self.count as f64,
            above: above.floor(),
            median: self.median(),
        };
        if self.wide > 0 {
            let bits = WIDE_BITS.into_iter().find(|&bits| f64::from(high) <= 2_f64.powi(bits as i32))?;
            return (self.wide >= SATURATED_PIXELS)
                .then(|| wrapped(self.wide, WRAPPED_ABOVE * 2_f64.powi(bits as i32)));
        }
        let top = WRAPPED_BITS.map(|bits| 2_f64.powi(bits as i32) - 1.0).find(|&top| f64::from(high) <= top)?;
        if f64::from(high) < 0.99 * top {
            return None;
        }
        let within = |from: f64, to: f64| &self.histogram[from as usize..=to as usize];
        let above: u64 = within(WRAPPED_ABOVE * top, top).iter().sum();
        let between: u64 = within(0.2 * top, 0.8 * top).iter().sum();
        let most = within(WRAPPED_ABOVE * top, top).iter().copied().max().unwrap_or_default();
        let is_low = self.median() < WRAPPED_MEDIAN * top && between < above / 4;
        let is_spread = most as f64 <= WRAPPED_ALIKE * above as f64;
        (above >= SATURATED_PIXELS && is_low && is_spread).then(|| wrapped(above, WRAPPED_ABOVE * top))
    }

    /// Share of the pixels at 0, where many more have it than the values next to it: what was below 0 was cut off.
    ///
    /// Photons of faint light are often 0 as well. But then there are far fewer twos than ones.
    pub fn cut_off_at_zero(&self) -> Option<f64> {
        let (low, _) = self.range?;
        if low != 0.0 || self.is_fractional {
            return None;
        }
        let step = self.step()? as usize;
        let at = |number: usize| self.histogram.get(number * step).copied().unwrap_or_default();
        let next = (1..=BEFORE).map(at).max()?;
        let is_flat = at(2) as f64 > LEAST_FLATNESS * at(1) as f64 && at(1) > 0;
        let share = at(0) as f64 / self.count as f64;
        (at(0) >= SATURATED_PIXELS && share >= LEAST_CUT_OFF && at(0) > PILE * next && is_flat).then_some(share)
    }

    /// Whether the values fill the range of 16 signed bits, as counts above 32767 do that were read as signed numbers.
    pub fn overflowed(&self) -> bool {
        let least = f32::from(i16::MIN);
        self.range
            .is_some_and(|(low, high)| low >= least && low < 0.95 * least && high < -least && high > -0.95 * least)
    }

    /// The median of whole values; 0 without a histogram.
    fn median(&self) -> f64 {
        let mut sum = 0;
        let half = self.histogram.iter().position(|pixels| {
            sum += pixels;
            2 * sum >= self.count
        });
        half.unwrap_or_default() as f64
    }
}

impl fmt::Display for GreyValues {
    /// Share of saturated pixels and distance of the values, for the report on the images.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.saturated() {
            Some(Saturated { share, value }) => write!(formatter, "{:.2} % saturated at {value}", 100.0 * share)?,
            None => formatter.write_str("no pixel saturated")?,
        }
        match self.step() {
            Some(step) => write!(formatter, ", grey values in steps of {step}"),
            None => formatter.write_str(", grey values not whole"),
        }
    }
}

/// Whether a value is just below the largest count of a wide number type, where -1 and its neighbours are after they have wrapped.
fn is_wide(value: f32) -> bool {
    let value = f64::from(value);
    WIDE_BITS.into_iter().map(|bits| 2_f64.powi(bits as i32)).any(|top| value > 0.999 * top && value <= top)
}

fn greatest_common_divisor(mut one: u32, mut other: u32) -> u32 {
    while other != 0 {
        (one, other) = (other, one % other);
    }
    one
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array1;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Poisson};

    fn of(values: impl IntoIterator<Item = f32>, white: Option<u16>) -> GreyValues {
        let mut found = GreyValues::default();
        found.add(values.into_iter().collect::<Array1<f32>>().view(), white);
        found
    }

    #[test]
    fn steps_and_levels_are_found() {
        let shifted = of((0..100).map(|level| (3 + 16 * level) as f32), Some(u16::MAX));
        assert_eq!((shifted.step(), shifted.levels()), (Some(16.0), Some(100.0)));
        let fractional = of([0.5, 1.0], None);
        assert_eq!((fractional.step(), fractional.levels()), (None, None));
        assert_eq!(of([-3.0, 4.0, 11.0], None).levels(), Some(3.0));
        assert_eq!(of([7.0; 9], None).step(), Some(1.0));
        assert_eq!(shifted.to_string(), "no pixel saturated, grey values in steps of 16");
        assert_eq!(fractional.to_string(), "no pixel saturated, grey values not whole");
        assert_eq!(of([], None).levels(), None);
    }

    #[test]
    fn piles_at_the_top_are_saturated() {
        let ramp = || (0..2000).map(|pixel| (pixel % 200) as f32);
        assert_eq!(of(ramp(), Some(255)).saturated(), None);
        let many = of(ramp().chain([200.0; 200]), Some(u16::MAX)).saturated().unwrap();
        assert!(many.value == 200.0 && (many.share - 1.0 / 11.0).abs() < 1e-9);
        let white = of((0..5120).map(|pixel| (pixel % 256) as f32), Some(255));
        assert_eq!(white.saturated().map(|found| found.value), Some(255.0));
        let float = of((0..4000).map(|pixel| (pixel as f32 / 3000.0).min(1.0)), None);
        assert_eq!(float.saturated().map(|found| found.value), Some(1.0));
        assert!(of([65_535.0; 100], Some(u16::MAX)).saturated().is_some_and(|found| found.share == 1.0));
        assert!(of([4095.0; 100], None).saturated().is_some());
        for value in [50.5, 30.0, 1e30] {
            assert_eq!(of([value; 100], None).saturated(), None);
        }
        // A mask of zeros and ones is no saturated image.
        assert_eq!(of((0..1000).map(|pixel| (pixel % 2) as f32), Some(255)).saturated(), None);
    }

    #[test]
    fn values_that_wrapped_around_zero_are_found() {
        let signed = |pixel: i32| (pixel % 21 - 2) as f32;
        let wrapped = of((0..2100).map(|pixel| signed(pixel).rem_euclid(65536.0)), Some(u16::MAX)).wrapped().unwrap();
        assert!((wrapped.share - 2.0 / 21.0).abs() < 1e-9 && wrapped.median == 10.0, "{wrapped:?}");
        assert_eq!(of((0..2100).map(signed), None).wrapped(), None);
        assert_eq!(of((0..65536).map(|level| level as f32), Some(u16::MAX)).wrapped(), None);
        assert!(of((0..2100).map(|pixel| signed(pixel).rem_euclid(256.0)), Some(255)).wrapped().is_some());
    }

    #[test]
    fn values_of_any_width_that_wrapped_are_found_and_limits_are_not() {
        let signed = |pixel: i64| pixel % 21 - 2;
        for bits in [10, 12, 32, 64] {
            let top = 2_f64.powi(bits);
            let values = (0..2100).map(|pixel| (signed(pixel) as f64).rem_euclid(top) as f32);
            let wrapped = of(values, None).wrapped().unwrap();
            assert!((wrapped.share - 2.0 / 21.0).abs() < 1e-9 && wrapped.median == 10.0, "{bits}: {wrapped:?}");
        }
        let signed = of((0..2000).map(|pixel| f32::from((pixel * 33) as u16 as i16)), None);
        assert!(signed.overflowed() && !of((0..2000).map(|pixel| pixel as f32 - 900.0), None).overflowed());
        // Cameras of one bit, and bright points on a dark frame.
        let points = |pixel: i32| if pixel % 10 == 0 { 255.0 } else { 0.0 };
        assert_eq!(of((0..2000).map(points), Some(255)).wrapped(), None);
        let spots = |pixel: i32| if pixel % 10 == 0 { 255.0 } else { (pixel % 10 + pixel % 3) as f32 };
        let spots = of((0..2000).map(spots), Some(255));
        assert!(spots.wrapped().is_none() && spots.saturated().is_some());
    }

    #[test]
    fn noise_that_was_cut_off_at_zero_is_found_but_not_faint_light() {
        let drawn = |photons: f64| -> Vec<f32> {
            let noise = Poisson::new(photons).unwrap().sample_iter(ChaCha8Rng::seed_from_u64(3));
            noise.take(10_000).map(|count: f64| count as f32).collect()
        };
        let noise = drawn(100.0).into_iter().map(|count| (count - 100.0).max(0.0));
        let share = of(noise, Some(u16::MAX)).cut_off_at_zero().unwrap();
        assert!((share - 0.5).abs() < 0.05, "{share}");
        for photons in [0.05, 0.2, 0.5, 1.0, 5.0, 100.0] {
            assert_eq!(of(drawn(photons), Some(255)).cut_off_at_zero(), None, "{photons}");
        }
    }
}
