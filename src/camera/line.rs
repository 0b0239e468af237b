//! Weighted least squares of lines.

/// A line `y = start + slope x`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub(super) start: f64,
    pub(super) slope: f64,
    /// Standard error of the slope, where weights are inverse variances.
    pub(super) slope_error: f64,
}

impl Line {
    /// The line through points (x, y) with their weights; `None` where all abscissas are equal.
    pub(super) fn fit(points: impl IntoIterator<Item = ([f64; 2], f64)>) -> Option<Self> {
        let mut sums = [0.0; 5];
        for ([x, y], weight) in points {
            let terms = [1.0, x, y, x * x, x * y];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
        }
        let [n, x, y, xx, xy] = sums;
        let determinant = n * xx - x * x;
        (determinant > 0.0).then(|| Self {
            start: (xx * y - x * xy) / determinant,
            slope: (n * xy - x * y) / determinant,
            slope_error: (n / determinant).sqrt(),
        })
    }

    /// The line through points whose ordinates scatter by a share of themselves: weights are their inverse squares.
    pub(super) fn fit_relative(points: &[[f64; 2]]) -> Option<Self> {
        Self::fit(points.iter().map(|&[x, y]| ([x, y], 1.0 / (y * y))))
    }
}

/// Least-squares slope of a line through the origin.
pub(super) fn slope_through_origin(points: &[[f64; 2]]) -> f64 {
    let products: f64 = points.iter().map(|[x, y]| x * y).sum();
    products / points.iter().map(|[x, _]| x * x).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_found() {
        let line = |start: f64| [1.0, 2.0, 5.0].map(|x| [x, start + 0.5 * x]);
        assert!((slope_through_origin(&line(0.0)) - 0.5).abs() < 1e-12);
        let found = Line::fit_relative(&line(3.0)).unwrap();
        assert!((found.slope - 0.5).abs() < 1e-12 && (found.start - 3.0).abs() < 1e-12, "{found:?}");
        assert_eq!(Line::fit_relative(&[[2.0, 1.0], [2.0, 3.0]]), None);
    }
}
