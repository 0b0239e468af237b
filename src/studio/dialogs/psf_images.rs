//! Images of the PSF import: the photograph with its window, which the pointer drags, and the PSF beside it.

use egui::{Color32, ColorImage, Pos2, Rect, Sense, TextureHandle, TextureOptions, Ui, pos2, vec2};
use ndarray::ArrayView2;

use crate::optics::{PixelRectangle, PsfWindow};
use crate::studio::canvas::display_range::DisplayRange;
use crate::studio::canvas::image_view::ColourPalettes;
use crate::studio::canvas::overlays::{self, PixelRegion};
use crate::studio::canvas::viewport::Placement;
use crate::studio::state::psf_import::{Grab, PsfImportForm};
use crate::studio::widgets::controls::name_widget;
use crate::workbench::{Colormap, PsfPreview};

/// Height of the images, points.
const HEIGHT: f32 = 250.0;
/// Least width of the dialog with both images side by side, points.
const SIDE_BY_SIDE: f32 = 520.0;
/// Distance from a corner of the window at which the pointer grabs it, points.
const REACH: f32 = 10.0;

/// Shows both images, side by side where there is room.
pub fn show(ui: &mut Ui, form: &mut PsfImportForm, preview: &PsfPreview, serial: u64, palettes: &ColourPalettes) {
    let [photo, psf] = textures(ui, form, preview, serial, palettes);
    let width = ui.available_width();
    if width < SIDE_BY_SIDE {
        photograph(ui, form, preview, photo.as_ref(), width);
        result(ui, preview, psf.as_ref(), width);
        return;
    }
    let of_psf = HEIGHT.min(0.4 * width);
    ui.horizontal_top(|ui| {
        let rest = width - of_psf - ui.spacing().item_spacing.x;
        ui.vertical(|ui| photograph(ui, form, preview, photo.as_ref(), rest));
        ui.vertical(|ui| result(ui, preview, psf.as_ref(), of_psf));
    });
}

/// Textures of photograph and PSF; they are made again for every preview.
fn textures(
    ui: &Ui,
    form: &mut PsfImportForm,
    preview: &PsfPreview,
    serial: u64,
    palettes: &ColourPalettes,
) -> [Option<TextureHandle>; 2] {
    if let Some((known, textures)) = &form.textures
        && *known == serial
    {
        return textures.clone();
    }
    let load = |name: &str, image: ArrayView2<'_, f32>, map: Colormap| {
        let pixels = coloured(image, palettes.of(map));
        ui.ctx().load_texture(name, pixels, TextureOptions::NEAREST)
    };
    let photo = load("PSF photograph", preview.shown.view(), Colormap::Gray);
    let psf = preview.psf.as_ref().ok();
    let psf = psf.map(|imported| load("imported PSF", imported.image.psf.view(), Colormap::Viridis));
    let textures = [Some(photo), psf];
    form.textures = Some((serial, textures.clone()));
    textures
}

/// An image in colours, without the few brightest and darkest pixels.
fn coloured(image: ArrayView2<'_, f32>, palette: &[Color32]) -> ColorImage {
    let limits = DisplayRange::Auto.limits(image, None);
    let colour = |&value: &f32| palette.get(Colormap::index(value, limits)).copied().unwrap_or(Color32::BLACK);
    ColorImage::new([image.ncols(), image.nrows()], image.iter().map(colour).collect())
}

/// Paints an image of shape (rows, cols) into the middle of the given space; returns its rectangle.
fn paint(
    ui: &mut Ui,
    texture: Option<&TextureHandle>,
    (rows, cols): (usize, usize),
    width: f32,
) -> (Rect, egui::Response) {
    let (space, response) = ui.allocate_exact_size(vec2(width, HEIGHT), Sense::click_and_drag());
    let scale = (space.width() / cols.max(1) as f32).min(space.height() / rows.max(1) as f32);
    let size = vec2(cols as f32, rows as f32) * scale;
    let rect = Rect::from_center_size(space.center(), size);
    ui.painter().rect_filled(space, 2.0, ui.visuals().extreme_bg_color);
    if let Some(texture) = texture {
        let whole = Rect::from_min_max(Pos2::ZERO, pos2(1.0, 1.0));
        ui.painter().image(texture.id(), rect, whole, Color32::WHITE);
    }
    (rect, response)
}

/// The photograph with its window.
fn photograph(
    ui: &mut Ui,
    form: &mut PsfImportForm,
    preview: &PsfPreview,
    texture: Option<&TextureHandle>,
    width: f32,
) {
    let (rows, cols) = preview.shape;
    let (rect, response) = paint(ui, texture, preview.shape, width);
    name_widget(&response, "Photograph with its window");
    let placement = Placement { rect, scale: rect.width() / cols.max(1) as f32 };
    if let Some(window) = form.window() {
        let window = drag(form, &response, placement, window, preview.shape);
        let PixelRectangle { top, left, rows, cols } = window;
        let region = PixelRegion { corner: (top, left), shape: (rows, cols) };
        overlays::region(&ui.painter().with_clip_rect(rect.intersect(ui.clip_rect())), placement, rect, region);
        for corner in corners(placement, window) {
            ui.painter().circle(corner, 3.5, Color32::WHITE, (1.0, Color32::BLACK));
        }
    }
    ui.weak(format!("Photograph, {rows} x {cols} px; drag the window"));
}

/// Moves the window with the pointer, or one of its corners; a drag elsewhere draws another window.
fn drag(
    form: &mut PsfImportForm,
    response: &egui::Response,
    placement: Placement,
    window: PixelRectangle,
    shape: (usize, usize),
) -> PixelRectangle {
    let edges = |position: Pos2| {
        let (x, y) = placement.to_pixels(position);
        (x + 0.5, y + 0.5)
    };
    if response.drag_started()
        && let Some(start) = response.ctx.input(|input| input.pointer.press_origin())
    {
        let near = corners(placement, window).into_iter().position(|corner| corner.distance(start) < REACH);
        let (x, y) = edges(start);
        let (top, left) = (window.top as f64, window.left as f64);
        let (bottom, right) = (top + window.rows as f64, left + window.cols as f64);
        form.grab = Some(match near {
            Some(corner) => {
                Grab::Resize { fixed: [(right, bottom), (left, bottom), (right, top), (left, top)][corner] }
            }
            None if (left..right).contains(&x) && (top..bottom).contains(&y) => {
                Grab::Move { offset: (x - left, y - top) }
            }
            None => Grab::Resize { fixed: (x, y) },
        });
    }
    let dragged = form.grab.filter(|_| response.dragged()).zip(response.interact_pointer_pos());
    if response.drag_stopped() {
        form.grab = None;
    }
    let Some((grab, position)) = dragged else { return window };
    let moved = grab.window(edges(position), window, shape);
    if moved != window
        && let Some(options) = form.options()
    {
        options.window = PsfWindow::Rectangle(moved);
    }
    moved
}

/// Corners of the window on the screen: top left, top right, bottom left, bottom right.
fn corners(placement: Placement, window: PixelRectangle) -> [Pos2; 4] {
    let at = |row: usize, col: usize| placement.to_screen(col as f64 - 0.5, row as f64 - 0.5);
    let (bottom, right) = (window.top + window.rows, window.left + window.cols);
    [at(window.top, window.left), at(window.top, right), at(bottom, window.left), at(bottom, right)]
}

/// The PSF.
fn result(ui: &mut Ui, preview: &PsfPreview, texture: Option<&TextureHandle>, width: f32) {
    let Ok(imported) = &preview.psf else {
        let (_, response) = paint(ui, None, (1, 1), width);
        name_widget(&response, "No PSF");
        ui.weak("No PSF");
        return;
    };
    let (rows, cols) = imported.image.psf.dim();
    let (_, response) = paint(ui, texture, (rows, cols), width);
    name_widget(&response, &format!("PSF of {rows} x {cols} px"));
    ui.weak(format!("PSF, {rows} x {cols} px"));
}
