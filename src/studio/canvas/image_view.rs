//! An image view: colours, colour bar with units, zoom and pan, value under the pointer. It never changes the values.

use egui::{Color32, ColorImage, Pos2, Rect, Sense, TextureHandle, TextureOptions, Ui, pos2, vec2};
use ndarray::{ArrayView2, s};

use crate::studio::canvas::display_range::{self, DisplayRange, Histogram};
use crate::studio::canvas::overlays::{self, PixelRegion, PixelSize};
use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::canvas::viewport::{Placement, Viewport};
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::format::format_significant;
use crate::workbench::Colormap;

/// Width of the choice of colours, points: that of most names, and of the longest one.
const COLOURS: f32 = 76.0;
const WIDE_COLOURS: f32 = 92.0;
/// Least width with a colour bar, points. The image alone fills less.
const LEAST_WITH_BAR: f32 = 130.0;
/// Limit of a texture's side, pixels.
const LONGEST_TEXTURE: usize = 8192;

/// The colours of all colour maps.
pub struct ColourPalettes {
    colours: Vec<(Colormap, Vec<Color32>)>,
}

impl Default for ColourPalettes {
    fn default() -> Self {
        let colours = |map: Colormap| map.palette().into_iter().map(|[r, g, b]| Color32::from_rgb(r, g, b)).collect();
        Self { colours: Colormap::ALL.map(|map| (map, colours(map))).to_vec() }
    }
}

impl ColourPalettes {
    /// The colours of a map, lowest value first.
    pub fn of(&self, map: Colormap) -> &[Color32] {
        self.colours.iter().find(|(known, _)| *known == map).map_or(&[], |(_, colours)| colours)
    }
}

/// Identifies the values of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageVersion {
    /// Revision of the design, or another number of the content.
    pub revision: u64,
    /// Index of the image in that content.
    pub index: usize,
}

/// What an image view shows.
#[derive(Clone, Copy)]
pub struct ImageContent<'a> {
    /// The values, shape (rows, cols).
    pub values: ArrayView2<'a, f32>,
    /// Their version.
    pub version: ImageVersion,
    /// Whether they belong to an earlier revision; such an image is dimmed.
    pub is_stale: bool,
}

/// Data that a texture depends on.
#[derive(Clone, Copy, PartialEq)]
struct TextureKey {
    version: ImageVersion,
    colormap: Colormap,
    limits: (f32, f32),
    /// Longest side of the texture.
    longest: usize,
}

/// One image with its settings.
pub struct ImageView {
    /// Unique name, also that of its controls.
    name: &'static str,
    /// What the values are of, at the end of the name where that matters.
    detail: &'static str,
    /// Unit of the values.
    unit: &'static str,
    /// Width of the choice of colours, points.
    colours_width: f32,
    /// The colours.
    pub colormap: Colormap,
    /// Zoom and pan.
    pub viewport: Viewport,
    /// Size of a pixel.
    pixel: PixelSize,
    /// Outlined part; the rest is dimmed.
    region: Option<PixelRegion>,
    texture: Option<TextureHandle>,
    drawn: Option<TextureKey>,
    /// Rule of the display range, and whether the histogram is logarithmic.
    levels: DisplayRange,
    logarithmic: bool,
    /// Display range (low, high), and the data it was derived from.
    limits: (f32, f32),
    levelled: Option<(ImageVersion, DisplayRange)>,
    /// Display range that this image shares with others.
    common: Option<(f32, f32)>,
    /// Computed while the editor is open.
    histogram: Option<(ImageVersion, Histogram)>,
    histogram_wanted: bool,
}

/// An image as drawn in this frame.
pub struct Shown {
    /// Its placement on the screen.
    pub placement: Placement,
    /// Rectangle of the whole image without zoom.
    pub fit: Rect,
    /// Visible part of the screen.
    pub seen: Rect,
    /// Response to the pointer.
    pub response: egui::Response,
    /// Whether it was zoomed or panned in this frame.
    pub moved: bool,
}

impl ImageView {
    /// Width of the colour bar with its numbers, points.
    const BAR: f32 = 58.0;

    /// A view called `name` of values in `unit`.
    pub fn new(name: &'static str, unit: &'static str, colormap: Colormap) -> Self {
        Self {
            name,
            detail: "",
            unit,
            colours_width: COLOURS,
            colormap,
            viewport: Viewport::default(),
            pixel: PixelSize::of_sensor(None),
            region: None,
            texture: None,
            drawn: None,
            levels: DisplayRange::default(),
            logarithmic: false,
            limits: (0.0, 1.0),
            levelled: None,
            common: None,
            histogram: None,
            histogram_wanted: false,
        }
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// The same view with a choice of colours as wide as the longest name, so that its row stays in place beside views of other colours.
    pub fn with_wide_colours(self) -> Self {
        Self { colours_width: WIDE_COLOURS, ..self }
    }

    /// Sets what the values are of, as in "of the linear estimate"; empty where the name says it.
    pub fn set_detail(&mut self, detail: &'static str) {
        self.detail = detail;
    }

    /// Its name and what the values are of.
    pub fn title(&self) -> String {
        if self.detail.is_empty() { self.name.to_owned() } else { format!("{} {}", self.name, self.detail) }
    }

    /// Display range (low, high) of an image, shape (rows, cols).
    pub fn limits_of(&self, image: ArrayView2<'_, f32>) -> (f32, f32) {
        self.levels.limits(image, self.common)
    }

    /// Sets a display range (low, high) that several images share; fixed values precede it.
    pub fn fix_limits(&mut self, (low, high): (f32, f32)) {
        let common = (low < high).then_some((low, high));
        if self.common != common {
            self.common = common;
            self.levelled = None;
        }
    }

    /// Resets the display range for another quantity.
    pub fn reset_display_range(&mut self) {
        self.levels = DisplayRange::default();
    }

    /// Sets the size of a pixel.
    pub fn set_pixel(&mut self, size: PixelSize) {
        self.pixel = size;
    }

    /// Sets the part that is outlined; the rest is dimmed.
    pub fn set_region(&mut self, region: Option<PixelRegion>) {
        self.region = region;
    }

    /// Controls of colour map and display range.
    pub fn colour_controls(&mut self, ui: &mut Ui, palettes: &ColourPalettes) {
        let response = egui::ComboBox::from_id_salt((self.name, "colormap"))
            .selected_text(self.colormap.to_string())
            .width(self.colours_width)
            .show_ui(ui, |ui| {
                for map in Colormap::ALL {
                    ui.selectable_value(&mut self.colormap, map, map.to_string());
                }
            })
            .response;
        name_widget(&response, &format!("{} colours", self.name));
        let button = ui.small_button("Range").on_hover_text("Histogram and display range");
        name_widget(&button, &format!("{} display range", self.name));
        let popup = egui::Popup::from_toggle_button_response(&button)
            .close_behavior(egui::PopupCloseBehavior::CloseOnClickOutside)
            .accessible_name(format!("Display range of {}", self.name));
        let open = popup.is_open();
        if open && !self.histogram_wanted {
            // The histogram is computed when the image is drawn.
            ui.ctx().request_repaint();
        }
        self.histogram_wanted = open;
        popup.show(|ui| match &self.histogram {
            Some((_, histogram)) => {
                let (name, unit) = (self.name, self.unit);
                if !self.detail.is_empty() {
                    ui.weak(self.title());
                }
                let colours = palettes.of(self.colormap);
                let edited = display_range::EditedImage { name, unit, colours, histogram, limits: self.limits };
                display_range::editor(ui, &edited, &mut self.levels, &mut self.logarithmic);
            }
            None => {
                ui.weak("There is no image yet.");
            }
        });
    }

    /// Shows the image, as large as fits, with its colour bar where there is room for one. Images of equal room begin at equal height.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        palettes: &ColourPalettes,
        content: ImageContent<'_>,
        pointer_mode: PointerMode,
    ) -> Shown {
        let ImageContent { values: image, version, is_stale } = content;
        let (rows, cols) = image.dim();
        let room = ui.available_rect_before_wrap();
        let has_bar = room.width() >= LEAST_WITH_BAR;
        let bar = if has_bar { Self::BAR } else { 0.0 };
        let space = vec2((room.width() - bar).max(16.0), room.height().max(16.0));
        let scale = (space.x / cols as f32).min(space.y / rows as f32);
        let extent = vec2(cols as f32, rows as f32) * scale;
        let corner = room.min + vec2(((space.x - extent.x) / 2.0).max(0.0), 0.0);
        let fit = Rect::from_min_size(corner.round(), extent);
        // A zoomed image fills the space; rounding may make an unzoomed one larger by a point.
        let stage = Rect::from_min_size(room.min, space).union(fit).intersect(room);
        let seen = self.viewport.placement(fit, image.dim()).rect.intersect(stage);
        let response = ui.allocate_rect(seen, Sense::click_and_drag());
        let before = self.viewport;
        self.viewport = pointer_mode.apply(self.viewport, ui, &response, fit, image.dim());
        let placement = self.viewport.placement(fit, image.dim());
        let seen = placement.rect.intersect(stage);
        self.update_limits(image, version);
        self.update_texture(ui.ctx(), palettes, image, version);
        let painter = ui.painter_at(room);
        if let Some(texture) = &self.texture {
            let tint = if is_stale { Color32::from_white_alpha(215) } else { Color32::WHITE };
            // Only the visible part: single precision does not resolve pixels far beyond the screen.
            let part = |position: Pos2| ((position - placement.rect.min) / placement.rect.size()).to_pos2();
            painter.image(texture.id(), seen, Rect::from_min_max(part(seen.min), part(seen.max)), tint);
        }
        if has_bar {
            self.colour_bar(ui, palettes, seen, room);
        }
        let palette = palettes.of(self.colormap);
        let above = ui.painter_at(seen);
        if let Some(region) = self.region.filter(|region| region.shape != (rows, cols)) {
            overlays::region(&above, placement, seen, region);
        }
        overlays::pixel_values(&above, placement, seen, image, |value| palette[Colormap::index(value, self.limits)]);
        let bar = overlays::scale_bar_length(seen.width(), placement.scale, self.pixel);
        if let Some(bar) = &bar {
            overlays::scale_bar(&above, seen, bar);
        }
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, self.title()));
        ui.ctx().accesskit_node_builder(response.id, |node| {
            let (x, y) = self.viewport.centre(image.dim());
            let zoom = self.viewport.zoom();
            let bar = bar.map_or_else(String::new, |bar| format!(", scale bar {}", bar.text));
            let region = self.region.map_or_else(String::new, PixelRegion::describe);
            node.set_value(format!("zoom {zoom:.2}, x {x:.2} px, y {y:.2} px in the middle{bar}{region}"));
        });
        self.fit_button(ui, seen);
        Shown { placement, fit, seen, response, moved: self.viewport != before }
    }

    /// Button that resets the zoom, in a corner of a zoomed image.
    fn fit_button(&mut self, ui: &mut Ui, seen: Rect) {
        if self.viewport.is_fitted() {
            return;
        }
        let place = Rect::from_min_size(seen.right_top() + vec2(-38.0, 6.0), vec2(32.0, 20.0));
        let tip = format!("Shows the whole image; the zoom is {:.1}", self.viewport.zoom());
        let response = ui.put(place, egui::Button::new("Fit").small()).on_hover_text(tip);
        name_widget(&response, &format!("Fit {}", self.name));
        if response.clicked() {
            self.viewport = Viewport::default();
            ui.ctx().request_repaint();
        }
    }

    /// Name, coordinates and value of the pixel under the pointer.
    pub fn describe_pixel(&self, image: ArrayView2<'_, f32>, (x, y): (f64, f64)) -> Option<String> {
        // Adding 0 turns -0 into 0.
        let (col, row) = (x.round() + 0.0, y.round() + 0.0);
        if col < 0.0 || row < 0.0 {
            return None;
        }
        let value = image.get((row as usize, col as usize))?;
        Some(format!(
            "{}  x {col} px, y {row} px: {} {}",
            self.title(),
            format_significant(f64::from(*value)),
            self.unit
        ))
    }

    /// Updates the display range, and the histogram while its editor is open.
    fn update_limits(&mut self, image: ArrayView2<'_, f32>, version: ImageVersion) {
        let found_from = (version, self.levels);
        if self.levelled != Some(found_from) {
            self.limits = self.limits_of(image);
            self.levelled = Some(found_from);
        }
        if self.histogram_wanted && self.histogram.as_ref().is_none_or(|(counted, _)| *counted != version) {
            self.histogram = Some((version, Histogram::of(image)));
        }
    }

    fn update_texture(
        &mut self,
        ctx: &egui::Context,
        palettes: &ColourPalettes,
        image: ArrayView2<'_, f32>,
        version: ImageVersion,
    ) {
        let longest = max_texture_side(ctx);
        let wanted = TextureKey { version, colormap: self.colormap, limits: self.limits, longest };
        if self.drawn == Some(wanted) {
            return;
        }
        let palette = palettes.of(self.colormap);
        let image = subsampled(image, longest);
        let (rows, cols) = image.dim();
        let pixels = image.iter().map(|&value| palette[Colormap::index(value, self.limits)]).collect();
        let color_image = ColorImage::new([cols, rows], pixels);
        match &mut self.texture {
            Some(texture) => texture.set(color_image, TextureOptions::NEAREST),
            None => self.texture = Some(ctx.load_texture(self.name, color_image, TextureOptions::NEAREST)),
        }
        self.drawn = Some(wanted);
    }

    /// Draws the colour bar right of the image, highest value at the top.
    fn colour_bar(&self, ui: &Ui, palettes: &ColourPalettes, image: Rect, room: Rect) {
        const WIDTH: f32 = 12.0;
        let painter = ui.painter_at(room);
        let left = image.right() + 6.0;
        let bar = Rect::from_min_max(pos2(left, image.top()), pos2(left + WIDTH, image.bottom()));
        let palette = palettes.of(self.colormap);
        let mut mesh = egui::Mesh::default();
        for step in (0..=255).step_by(5) {
            let y = egui::lerp(bar.bottom()..=bar.top(), step as f32 / 255.0);
            let Some(&colour) = palette.get(step) else { return };
            let next = mesh.vertices.len() as u32;
            mesh.colored_vertex(pos2(bar.left(), y), colour);
            mesh.colored_vertex(pos2(bar.right(), y), colour);
            if next >= 2 {
                mesh.add_triangle(next - 2, next - 1, next);
                mesh.add_triangle(next - 1, next, next + 1);
            }
        }
        painter.add(mesh);
        // The frame keeps its white end visible on a light background.
        let frame = ui.visuals().widgets.noninteractive.bg_stroke;
        painter.rect_stroke(bar, 0.0, frame, egui::StrokeKind::Outside);
        let font = egui::FontId::proportional(10.0);
        let colour = ui.visuals().weak_text_color();
        let (low, high) = (f64::from(self.limits.0), f64::from(self.limits.1));
        for (value, y, align) in [
            (high, bar.top(), egui::Align2::LEFT_TOP),
            (0.5 * (low + high), bar.center().y, egui::Align2::LEFT_CENTER),
            (low, bar.bottom(), egui::Align2::LEFT_BOTTOM),
        ] {
            painter.text(pos2(bar.right() + 3.0, y), align, format_significant(value), font.clone(), colour);
        }
        if bar.height() > 110.0 {
            let y = bar.top() + 0.25 * bar.height();
            painter.text(pos2(bar.right() + 3.0, y), egui::Align2::LEFT_CENTER, self.unit, font, colour);
        }
    }
}

/// Maximal side of a texture, pixels.
pub fn max_texture_side(ctx: &egui::Context) -> usize {
    ctx.input(|input| input.max_texture_side).min(LONGEST_TEXTURE)
}

/// Every n-th row and m-th column of an image, so that no side exceeds `longest` pixels.
pub fn subsampled(image: ArrayView2<'_, f32>, longest: usize) -> ArrayView2<'_, f32> {
    let (rows, cols) = image.dim();
    let step = |count: usize| count.div_ceil(longest.max(1)).max(1) as isize;
    image.slice_move(s![..;step(rows), ..;step(cols)])
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;

    #[test]
    fn large_images_are_subsampled_for_the_renderer() {
        let image = Array2::from_shape_fn((64, 10_000), |(row, col)| (10_000 * row + col) as f32);
        let thin = subsampled(image.view(), 8192);
        assert_eq!((thin.dim(), thin[(1, 0)], thin[(0, 4999)]), ((64, 5000), 10_000.0, 9998.0));
        assert_eq!(subsampled(image.t(), 3000).dim(), (2500, 64));
        assert_eq!(subsampled(image.view(), 10_000), image);
        let ctx = egui::Context::default();
        let mut view = ImageView::new("Measurement", "photons", Colormap::Gray);
        // Limit of a renderer, and the expected texture width.
        for (most, cols) in [(2048, 2000), (16_384, 5000)] {
            ctx.input_mut(|input| input.max_texture_side = most);
            view.update_texture(&ctx, &ColourPalettes::default(), image.view(), ImageVersion { revision: 1, index: 0 });
            assert_eq!(view.texture.as_ref().map(TextureHandle::size), Some([cols, 64]));
        }
    }
}
