//! Drawing of lenslets over the PSF: handles, limits, gradient arrows.

use egui::{Color32, Rect, Stroke, Ui, Vec2, vec2};

use crate::optics::{Lenslet, LensletArray, Spot};
use crate::studio::canvas::viewport::Placement;
use crate::studio::state::selection::Selection;
use crate::studio::state::view::View;
use crate::workbench::{DesignRun, PositionGradient};

/// Length of the longest gradient arrow, PSF px.
const LONGEST_ARROW_PX: f64 = 3.0;
/// Colour of gradient arrows. No colour map contains it.
const ARROW: Color32 = Color32::from_rgb(255, 96, 160);
/// Minimal radius of a handle, points.
const MIN_HANDLE: f32 = 7.0;

/// The drawn mask.
#[derive(Clone, Copy)]
pub struct Canvas<'a> {
    /// What the panel reads.
    pub view: &'a View<'a>,
    /// The lenslets.
    pub array: &'a LensletArray,
    /// Placement of the PSF on the screen.
    pub placement: Placement,
}

/// Draws the position gradient of each lenslet, from the previewed run or the live estimate. The longest arrow has
/// [`LONGEST_ARROW_PX`].
pub fn draw_arrows(ui: &Ui, canvas: Canvas<'_>) {
    let Canvas { view, array, placement } = canvas;
    let significant =
        |gradient: &PositionGradient| if gradient.is_significant { (gradient.x, gradient.y) } else { (0.0, 0.0) };
    let by_live = || Some(position_gradients(view)?.iter().map(significant).collect());
    let of_run = |run: &&DesignRun| run.is_active() && !run.position_gradients.is_empty() && *run.array == *array;
    let run = view.run.filter(of_run);
    let gradients: Option<Vec<(f64, f64)>> = run.map(|run| run.position_gradients.to_vec()).or_else(by_live);
    let Some(gradients) = gradients.filter(|gradients| gradients.len() == array.lenslets.len()) else { return };
    let longest = gradients.iter().map(|&(x, y)| x.hypot(y)).fold(0.0, f64::max);
    if longest <= 0.0 {
        return;
    }
    let scale = LONGEST_ARROW_PX / longest;
    for (lenslet, (x, y)) in array.lenslets.iter().zip(gradients) {
        let from = placement.to_screen(lenslet.x, lenslet.y);
        let to = placement.to_screen(lenslet.x + scale * x, lenslet.y + scale * y);
        if from.distance(to) > 3.0 {
            ui.painter().arrow(from, to - from, Stroke::new(3.5, Color32::from_black_alpha(160)));
            ui.painter().arrow(from, to - from, Stroke::new(1.8, ARROW));
        }
    }
}

/// Position gradients of the current live estimate.
pub fn position_gradients<'a>(view: &View<'a>) -> Option<&'a [PositionGradient]> {
    let live = view.estimates.live.as_ref().filter(|live| view.is_current(live.revision));
    live?.value.pulls.as_deref()
}

/// Draws the limits of position and width as dashed lines.
pub fn draw_limits(ui: &Ui, canvas: Canvas<'_>, selection: &Selection) {
    let Canvas { view, array, placement } = canvas;
    let limits = &view.design.limits;
    let (left, right) = limits.coordinate_range(array.cols);
    let (top, bottom) = limits.coordinate_range(array.rows);
    let corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)];
    let points: Vec<_> = corners.iter().map(|&(x, y)| placement.to_screen(x, y)).collect();
    let stroke = Stroke::new(1.0, Color32::from_white_alpha(110));
    ui.painter().extend(egui::Shape::dashed_line(&points, stroke, 5.0, 4.0));
    let smallest = limits.min_sigma_px.powi(2);
    for (_, lenslet) in selection.of(array) {
        let centre = placement.to_screen(lenslet.x, lenslet.y);
        let mut outline: Vec<_> =
            ellipse(smallest, 0.0, smallest).map(|(dx, dy)| centre + vec2(dx, dy) * placement.scale).collect();
        outline.extend(outline.first().copied());
        ui.painter().extend(egui::Shape::dashed_line(&outline, stroke, 3.0, 3.0));
    }
}

/// Screen rectangle of a handle.
pub fn frame_of(placement: Placement, lenslet: &Lenslet) -> Rect {
    let reach = (lenslet.spot.mean_sigma() as f32 * placement.scale).clamp(MIN_HANDLE, 24.0);
    Rect::from_center_size(placement.to_screen(lenslet.x, lenslet.y), Vec2::splat(2.0 * reach))
}

/// Draws a handle.
pub fn draw_handle(ui: &Ui, canvas: Canvas<'_>, response: &egui::Response, lenslet: &Lenslet, selected: bool) {
    let Canvas { array, placement, .. } = canvas;
    let radius = lenslet.spot.mean_sigma() as f32 * placement.scale;
    let brightest = array.lenslets.iter().map(|lenslet| lenslet.weight).fold(0.0, f64::max);
    let share = if brightest > 0.0 { (lenslet.weight / brightest) as f32 } else { 0.0 };
    let accent = ui.visuals().selection.stroke.color;
    let base = if selected { Color32::from_rgb(255, 170, 40) } else { Color32::WHITE };
    let width = if response.hovered() || response.has_focus() { 2.5 } else { 1.5 };
    let painter = ui.painter();
    let centre = placement.to_screen(lenslet.x, lenslet.y);
    let fill = base.gamma_multiply(0.04 + 0.24 * share);
    let outline: Vec<_> = match lenslet.spot {
        Spot::Isotropic(_) => Vec::new(),
        Spot::Anisotropic { xx, xy, yy } => {
            ellipse(xx, xy, yy).map(|(dx, dy)| centre + vec2(dx, dy) * placement.scale).collect()
        }
    };
    // A light line with a dark outline is visible on every colour.
    if outline.is_empty() {
        let radius = radius.max(3.5);
        painter.circle(centre, radius, fill, Stroke::new(width, base));
        painter.circle_stroke(centre, radius + 0.5 * width + 0.5, Stroke::new(1.0, Color32::from_black_alpha(170)));
    } else {
        painter.add(egui::Shape::convex_polygon(outline.clone(), fill, Stroke::new(width, base)));
        painter.add(egui::Shape::closed_line(outline, Stroke::new(1.0, Color32::from_black_alpha(170))));
    }
    if response.has_focus() {
        painter.circle_stroke(centre, radius.max(MIN_HANDLE) + 4.0, Stroke::new(1.0, accent));
    }
}

/// Outline of the ellipse of one standard deviation, in pixels around its centre.
fn ellipse(xx: f64, xy: f64, yy: f64) -> impl Iterator<Item = (f32, f32)> {
    // Cholesky factor of the covariance maps the unit circle onto it.
    let a = xx.sqrt();
    let b = xy / a;
    let c = (yy - b * b).max(0.0).sqrt();
    (0..40).map(move |step| {
        let angle = std::f64::consts::TAU * f64::from(step) / 40.0;
        ((a * angle.cos()) as f32, (b * angle.cos() + c * angle.sin()) as f32)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ellipse_has_widths_of_its_covariance() {
        let radii: Vec<f64> = ellipse(4.0, 1.0, 2.0).map(|(x, y)| f64::from(x.hypot(y))).collect();
        let (minor, major) = Spot::Anisotropic { xx: 4.0, xy: 1.0, yy: 2.0 }.principal_sigmas();
        assert!((radii.iter().copied().fold(0.0, f64::max) - major).abs() < 0.02);
        assert!((radii.iter().copied().fold(f64::INFINITY, f64::min) - minor).abs() < 0.02);
    }
}
