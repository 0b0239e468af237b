//! Interpolation in a table over equally spaced nodes.

/// A function tabulated on equally spaced nodes, read by the cubic through the four nearest of them.
///
/// The error is at most 3/128 of the fourth derivative times the fourth power of the spacing (nine times that in the
/// first and last interval).
#[derive(Clone, Debug)]
pub(in crate::information) struct UniformTable {
    start: f64,
    inverse_step: f64,
    values: Vec<f64>,
}

impl UniformTable {
    /// A table of `values` at `start`, `start + step`, ...; at least four of them.
    pub(in crate::information) fn new(start: f64, step: f64, values: Vec<f64>) -> Self {
        debug_assert!(values.len() >= 4 && step > 0.0);
        Self { start, inverse_step: 1.0 / step, values }
    }

    /// The value at `x`, which is clamped to the table.
    pub(in crate::information) fn at(&self, x: f64) -> f64 {
        let last = (self.values.len() - 1) as f64;
        let position = ((x - self.start) * self.inverse_step).clamp(0.0, last);
        let node = (position as usize).clamp(1, self.values.len() - 3);
        let t = position - node as f64;
        let v = &self.values[node - 1..node + 3];
        let (a, b, c) = (t + 1.0, t - 1.0, t - 2.0);
        -v[0] * t * b * c / 6.0 + v[1] * a * b * c / 2.0 - v[2] * a * t * c / 2.0 + v[3] * a * t * b / 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubics_are_reproduced_everywhere() {
        let cubic = |x: f64| 2.0 - x + 0.5 * x * x - 0.25 * x * x * x;
        let table = UniformTable::new(-1.0, 0.5, (0..7).map(|i| cubic(-1.0 + 0.5 * f64::from(i))).collect());
        for x in [-1.0, -0.9, -0.2, 0.3, 1.1, 1.7, 2.0] {
            assert!((table.at(x) - cubic(x)).abs() < 1e-12, "{x}");
        }
        assert!((table.at(9.0) - cubic(2.0)).abs() < 1e-12, "held inside the table");
    }
}
