//! Zoom and pan of an image, and the map between its pixels and the screen.

use std::ops::Range;

use egui::{Pos2, Rect, Vec2, pos2, vec2};

/// Maximal size of a pixel, points.
const LARGEST_PIXEL: f64 = 160.0;

/// Placement of an image on the screen.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// Rectangle of the whole image, including hidden parts.
    pub rect: Rect,
    /// Points per pixel.
    pub scale: f32,
}

impl Placement {
    /// Screen position of pixel coordinates (x, y), pixel centres at integers.
    pub fn to_screen(self, x: f64, y: f64) -> Pos2 {
        self.rect.min + vec2(x as f32 + 0.5, y as f32 + 0.5) * self.scale
    }

    /// Pixel coordinates (x, y) of a screen position.
    pub fn to_pixels(self, position: Pos2) -> (f64, f64) {
        let offset = (position - self.rect.min) / self.scale;
        (f64::from(offset.x) - 0.5, f64::from(offset.y) - 0.5)
    }

    /// Rows and columns of an image of shape (rows, cols) that are at least partly inside `seen`.
    pub fn pixels_in(self, seen: Rect, (rows, cols): (usize, usize)) -> (Range<usize>, Range<usize>) {
        let (left, top) = self.to_pixels(seen.min);
        let (right, bottom) = self.to_pixels(seen.max);
        // A pixel extends half a pixel around its centre; the casts saturate at 0.
        let along = |low: f64, high: f64, count: usize| {
            let end = ((high + 0.5).ceil().max(0.0) as usize).min(count);
            ((low + 0.5).floor().max(0.0) as usize).min(end)..end
        };
        (along(top, bottom, rows), along(left, right, cols))
    }
}

/// Zoom and pan. The image always covers the rectangle that it has without zoom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewport {
    /// Zoom factor, at least 1.
    zoom: f64,
    /// Pixel coordinates (x, y) of the view centre; none for the image centre.
    centre: Option<(f64, f64)>,
}

impl Default for Viewport {
    fn default() -> Self {
        Self { zoom: 1.0, centre: None }
    }
}

impl Viewport {
    /// Zoom factor, at least 1.
    pub fn zoom(self) -> f64 {
        self.zoom
    }

    /// Whether the whole image is visible.
    pub fn is_fitted(self) -> bool {
        self.zoom <= 1.0
    }

    /// Pixel coordinates (x, y) of the view centre, for an image of shape (rows, cols).
    pub fn centre(self, (rows, cols): (usize, usize)) -> (f64, f64) {
        let along = |wanted: Option<f64>, count: usize| {
            let middle = 0.5 * (count as f64 - 1.0);
            let free = 0.5 * count as f64 * (1.0 - 1.0 / self.zoom.max(1.0));
            wanted.map_or(middle, |wanted| wanted.clamp(middle - free, middle + free))
        };
        (along(self.centre.map(|centre| centre.0), cols), along(self.centre.map(|centre| centre.1), rows))
    }

    /// Placement of an image of shape (rows, cols) whose rectangle without zoom is `fit`.
    pub fn placement(self, fit: Rect, dim: (usize, usize)) -> Placement {
        let fitted = fit.width() / dim.1.max(1) as f32;
        if self.is_fitted() {
            return Placement { rect: fit, scale: fitted };
        }
        let scale = f64::from(fitted) * self.zoom;
        let (x, y) = self.centre(dim);
        let middle = fit.center();
        let corner =
            pos2((f64::from(middle.x) - (x + 0.5) * scale) as f32, (f64::from(middle.y) - (y + 0.5) * scale) as f32);
        let scale = scale as f32;
        Placement { rect: Rect::from_min_size(corner, vec2(dim.1 as f32, dim.0 as f32) * scale), scale }
    }

    /// Zooms by `factor` around `pointer`, as far as the border of the image allows.
    #[must_use]
    pub fn zoomed(self, factor: f64, pointer: Pos2, fit: Rect, dim: (usize, usize)) -> Self {
        let fitted = f64::from(fit.width()) / dim.1.max(1) as f64;
        // A linked image may have zoomed this one beyond its own limit.
        let most = (LARGEST_PIXEL / fitted).max(self.zoom).max(1.0);
        let wanted = self.zoom * factor;
        if !wanted.is_finite() {
            return self;
        }
        let zoom = wanted.min(most);
        // The last step out ends at exactly 1.
        if zoom <= 1.0 || (factor < 1.0 && zoom < 1.002) {
            return Self::default();
        }
        let (x, y) = self.placement(fit, dim).to_pixels(pointer);
        let away = (pointer - fit.center()) / (fitted * zoom) as f32;
        Self { zoom, centre: Some((x - f64::from(away.x), y - f64::from(away.y))) }.held(dim)
    }

    /// Pans by `by` points.
    #[must_use]
    pub fn panned(self, by: Vec2, fit: Rect, dim: (usize, usize)) -> Self {
        if self.is_fitted() {
            return self;
        }
        let scale = self.placement(fit, dim).scale;
        let (x, y) = self.centre(dim);
        let by = by / scale;
        Self { centre: Some((x - f64::from(by.x), y - f64::from(by.y))), ..self }.held(dim)
    }

    /// The same view in pixel coordinates that are larger by (x, y).
    #[must_use]
    pub fn shifted(self, (x, y): (f64, f64)) -> Self {
        Self { centre: self.centre.map(|centre| (centre.0 + x, centre.1 + y)), ..self }
    }

    /// Clamps the view centre.
    fn held(self, dim: (usize, usize)) -> Self {
        Self { centre: Some(self.centre(dim)), ..self }
    }
}

/// Largest length of 1, 2 or 5 times a power of ten up to `most`; none if `most` is not positive.
pub fn round_length(most: f64) -> Option<f64> {
    if !(most > 0.0 && most.is_finite()) {
        return None;
    }
    let decade = 10.0_f64.powf(most.log10().floor());
    // Rounding may put a power of ten into the decade below its own.
    [10.0, 5.0, 2.0, 1.0].into_iter().map(|step| step * decade).find(|length| *length <= most * (1.0 + 1e-9))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DIM: (usize, usize) = (48, 64);

    fn fit() -> Rect {
        Rect::from_min_size(pos2(11.0, 7.0), vec2(320.0, 240.0))
    }

    #[test]
    fn screen_and_pixels_are_inverse() {
        let zoomed = Viewport::default().zoomed(5.5, pos2(70.0, 90.0), fit(), DIM).panned(vec2(9.0, -4.0), fit(), DIM);
        for viewport in [Viewport::default(), zoomed] {
            let placement = viewport.placement(fit(), DIM);
            let (x, y) = placement.to_pixels(placement.to_screen(3.25, 30.0));
            assert!((x - 3.25).abs() < 1e-4 && (y - 30.0).abs() < 1e-4, "{x} {y}");
        }
        let placement = Viewport::default().placement(fit(), DIM);
        assert_eq!((placement.rect, placement.scale), (fit(), 5.0));
        assert_eq!(placement.to_screen(0.0, 0.0), pos2(13.5, 9.5), "pixel centres are at integers");
    }

    #[test]
    fn zoom_keeps_pixel_under_pointer() {
        let pointer = pos2(200.0, 61.0);
        let mut viewport = Viewport::default();
        let before = viewport.placement(fit(), DIM).to_pixels(pointer);
        for _ in 0..12 {
            viewport = viewport.zoomed(1.22, pointer, fit(), DIM);
            let now = viewport.placement(fit(), DIM).to_pixels(pointer);
            assert!((now.0 - before.0).abs() < 1e-3 && (now.1 - before.1).abs() < 1e-3, "{before:?} {now:?}");
        }
        assert!(viewport.zoom() > 10.0);
        let placement = viewport.placement(fit(), DIM);
        assert!(placement.rect.contains_rect(fit()), "{placement:?}");
        for _ in 0..20 {
            viewport = viewport.zoomed(1.0 / 1.22, pos2(20.0, 220.0), fit(), DIM);
            assert!(viewport.placement(fit(), DIM).rect.expand(1e-2).contains_rect(fit()));
        }
        assert_eq!(viewport, Viewport::default(), "all of it is seen again");
    }

    #[test]
    fn pan_follows_pointer_up_to_border() {
        let viewport = Viewport::default().zoomed(4.0, fit().center(), fit(), DIM);
        let before = viewport.placement(fit(), DIM).to_screen(30.0, 20.0);
        let panned = viewport.panned(vec2(25.0, -12.0), fit(), DIM);
        let after = panned.placement(fit(), DIM).to_screen(30.0, 20.0);
        assert!((after - before - vec2(25.0, -12.0)).length() < 1e-2);
        let far = viewport.panned(vec2(1e5, 1e5), fit(), DIM).placement(fit(), DIM);
        assert!((far.rect.min - fit().min).length() < 1e-2, "the corner of the image stops at the corner of the view");
        let back = viewport.panned(vec2(1e5, 0.0), fit(), DIM).panned(vec2(-50.0, 0.0), fit(), DIM);
        assert!((back.placement(fit(), DIM).rect.min.x - fit().min.x + 50.0).abs() < 1e-2, "a border has no memory");
        assert_eq!(Viewport::default().panned(vec2(30.0, 0.0), fit(), DIM), Viewport::default());
    }

    #[test]
    fn zoom_is_limited() {
        let viewport = Viewport::default().zoomed(1e6, fit().center(), fit(), DIM);
        assert!((f64::from(viewport.placement(fit(), DIM).scale) - LARGEST_PIXEL).abs() < 1e-2);
        assert_eq!(viewport.zoomed(f64::NAN, fit().center(), fit(), DIM), viewport);
    }

    #[test]
    fn visible_pixels_are_those_drawn() {
        let all = Viewport::default().placement(fit(), DIM);
        assert_eq!(all.pixels_in(fit(), DIM), (0..48, 0..64));
        let viewport = Viewport::default().zoomed(8.0, fit().min, fit(), DIM).placement(fit(), DIM);
        // 40 points per pixel: 6 rows and 8 columns are visible from the corner on.
        assert_eq!(viewport.pixels_in(fit(), DIM), (0..6, 0..8));
        let apart = Rect::from_min_size(pos2(-900.0, -900.0), vec2(10.0, 10.0));
        let (rows, cols) = viewport.pixels_in(apart, DIM);
        assert!(rows.is_empty() && cols.is_empty());
    }

    #[test]
    fn lengths_are_round() {
        for (most, length) in
            [(1.0, 1.0), (1.99, 1.0), (2.0, 2.0), (4.9, 2.0), (9.9, 5.0), (10.0, 10.0), (73.0, 50.0), (1000.0, 1000.0)]
        {
            assert!((round_length(most).unwrap() / length - 1.0).abs() < 1e-9, "{most}: {:?}", round_length(most));
        }
        assert!((round_length(0.13).unwrap() - 0.1).abs() < 1e-12);
        assert_eq!([0.0, -3.0, f64::NAN, f64::INFINITY].map(round_length), [None; 4]);
    }
}
