//! A picture of values: colours, colour bar with units, value under the pointer. It never changes the values.

use egui::{Color32, ColorImage, Pos2, Rect, Sense, TextureHandle, TextureOptions, Ui, Vec2, pos2, vec2};
use ndarray::ArrayView2;

use crate::workbench::Colormap;

/// The colours of every map, made once.
pub struct Palettes {
    colours: Vec<(Colormap, Vec<Color32>)>,
}

impl Default for Palettes {
    fn default() -> Self {
        let colours = |map: Colormap| map.palette().into_iter().map(|[r, g, b]| Color32::from_rgb(r, g, b)).collect();
        Self { colours: Colormap::ALL.map(|map| (map, colours(map))).to_vec() }
    }
}

impl Palettes {
    /// The colours of a map, lowest value first.
    pub fn of(&self, map: Colormap) -> &[Color32] {
        self.colours.iter().find(|(known, _)| *known == map).map_or(&[], |(_, colours)| colours)
    }
}

/// What a drawn picture was made of; it is drawn anew only when this changes.
#[derive(Clone, Copy, PartialEq)]
struct Drawn {
    version: (u64, usize),
    colormap: Colormap,
    limits: (f32, f32),
}

/// One picture with its settings.
pub struct ImageView {
    /// Unique name, also that of its controls.
    name: &'static str,
    /// Unit of the values.
    unit: &'static str,
    /// The colours.
    pub colormap: Colormap,
    texture: Option<TextureHandle>,
    drawn: Option<Drawn>,
    /// Values in the first and the last colour.
    limits: (f32, f32),
    /// The same where they are not those of the picture.
    fixed: Option<(f32, f32)>,
}

/// Where a picture lies on the screen.
#[derive(Clone, Copy)]
pub struct Placement {
    /// The whole picture.
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
}

impl ImageView {
    /// Width of the colour bar with its numbers, in points.
    const BAR: f32 = 58.0;

    /// A view called `name` of values in `unit`.
    pub fn new(name: &'static str, unit: &'static str, colormap: Colormap) -> Self {
        Self { name, unit, colormap, texture: None, drawn: None, limits: (0.0, 1.0), fixed: None }
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Values in the first and the last colour.
    pub fn limits(&self) -> (f32, f32) {
        self.limits
    }

    /// Draws these values in the first and the last colour, instead of the smallest and the largest of each picture.
    pub fn fix_limits(&mut self, (low, high): (f32, f32)) {
        self.fixed = (low < high).then_some((low, high));
    }

    /// The choice of colours.
    pub fn colormap_menu(&mut self, ui: &mut Ui) {
        let response = egui::ComboBox::from_id_salt((self.name, "colormap"))
            .selected_text(self.colormap.to_string())
            .width(84.0)
            .show_ui(ui, |ui| {
                for map in Colormap::ALL {
                    ui.selectable_value(&mut self.colormap, map, map.to_string());
                }
            })
            .response;
        name_widget(&response, &format!("{} colours", self.name));
    }

    /// Shows the picture as large as the room allows, with its colour bar. `version` tells one picture from another;
    /// a `stale` one is dimmed. Returns its place and what the pointer does on it.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        palettes: &Palettes,
        image: ArrayView2<'_, f32>,
        version: (u64, usize),
        stale: bool,
        sense: Sense,
    ) -> (Placement, egui::Response) {
        let (rows, cols) = image.dim();
        let room = ui.available_rect_before_wrap();
        let space = vec2((room.width() - Self::BAR).max(16.0), room.height().max(16.0));
        let scale = (space.x / cols as f32).min(space.y / rows as f32);
        let extent = vec2(cols as f32, rows as f32) * scale;
        let corner = room.min + vec2(((space.x - extent.x) / 2.0).max(0.0), ((space.y - extent.y) / 2.0).max(0.0));
        let rect = Rect::from_min_size(corner.round(), extent);
        let response = ui.allocate_rect(rect.intersect(room), sense);
        let role = egui::Role::Image;
        response.widget_info(|| egui::WidgetInfo::labeled(role, true, self.name));
        self.update_texture(ui.ctx(), palettes, image, version);
        let painter = ui.painter_at(room);
        if let Some(texture) = &self.texture {
            let tint = if stale { Color32::from_white_alpha(215) } else { Color32::WHITE };
            let whole = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
            painter.image(texture.id(), rect, whole, tint);
        }
        self.colour_bar(ui, palettes, rect, room);
        (Placement { rect, scale }, response)
    }

    /// One line about the pixel under the pointer.
    pub fn describe_pixel(&self, image: ArrayView2<'_, f32>, (x, y): (f64, f64)) -> Option<String> {
        let (col, row) = (x.round(), y.round());
        if col < 0.0 || row < 0.0 {
            return None;
        }
        let value = image.get((row as usize, col as usize))?;
        Some(format!("{}  x {col} px, y {row} px: {} {}", self.name, significant(f64::from(*value)), self.unit))
    }

    fn update_texture(
        &mut self,
        ctx: &egui::Context,
        palettes: &Palettes,
        image: ArrayView2<'_, f32>,
        version: (u64, usize),
    ) {
        if self.drawn.is_none_or(|drawn| drawn.version != version) {
            let finite = image.iter().copied().filter(|value| value.is_finite());
            let (low, high) =
                finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
            // A minimum that is as good as 0 reads better as 0.
            let low = if low > 0.0 && low < 1e-3 * high { 0.0 } else { low };
            self.limits = if low < high { (low, high) } else { (low.min(0.0), low.max(0.0) + 1.0) };
        }
        self.limits = self.fixed.unwrap_or(self.limits);
        let wanted = Drawn { version, colormap: self.colormap, limits: self.limits };
        if self.drawn == Some(wanted) {
            return;
        }
        let palette = palettes.of(self.colormap);
        let (rows, cols) = image.dim();
        let pixels = image.iter().map(|&value| palette[Colormap::index(value, self.limits)]).collect();
        let picture = ColorImage::new([cols, rows], pixels);
        match &mut self.texture {
            Some(texture) => texture.set(picture, TextureOptions::NEAREST),
            None => self.texture = Some(ctx.load_texture(self.name, picture, TextureOptions::NEAREST)),
        }
        self.drawn = Some(wanted);
    }

    /// The bar right of the picture: highest value at the top.
    fn colour_bar(&self, ui: &Ui, palettes: &Palettes, picture: Rect, room: Rect) {
        const WIDTH: f32 = 12.0;
        let painter = ui.painter_at(room);
        let left = picture.right() + 6.0;
        let bar = Rect::from_min_max(pos2(left, picture.top()), pos2(left + WIDTH, picture.bottom()));
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
        let font = egui::FontId::proportional(10.0);
        let colour = ui.visuals().weak_text_color();
        let (low, high) = (f64::from(self.limits.0), f64::from(self.limits.1));
        for (value, y, align) in [
            (high, bar.top(), egui::Align2::LEFT_TOP),
            (0.5 * (low + high), bar.center().y, egui::Align2::LEFT_CENTER),
            (low, bar.bottom(), egui::Align2::LEFT_BOTTOM),
        ] {
            painter.text(pos2(bar.right() + 3.0, y), align, significant(value), font.clone(), colour);
        }
        if bar.height() > 110.0 {
            let y = bar.top() + 0.25 * bar.height();
            painter.text(pos2(bar.right() + 3.0, y), egui::Align2::LEFT_CENTER, self.unit, font, colour);
        }
    }
}

/// Gives a control the name by which assistive technology and tests find it.
pub fn name_widget(response: &egui::Response, name: &str) {
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label(name));
}

/// A number with three to four significant digits.
pub fn significant(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".into()
    } else if (0.001..10_000.0).contains(&size) {
        let decimals = (2 - size.log10().floor() as i32).clamp(0, 5) as usize;
        format!("{value:.decimals$}")
    } else {
        format!("{value:.2e}")
    }
}

/// A row of small controls above a picture.
pub fn toolbar(ui: &mut Ui, add: impl FnOnce(&mut Ui)) {
    ui.horizontal(|ui| {
        ui.set_min_height(22.0);
        ui.spacing_mut().item_spacing.x = 6.0;
        add(ui);
    });
    ui.add_space(2.0);
}

/// Fills the room with a sentence where there is no picture yet.
pub fn placeholder(ui: &mut Ui, text: &str) {
    let size: Vec2 = ui.available_size();
    ui.allocate_ui_with_layout(size, egui::Layout::centered_and_justified(egui::Direction::TopDown), |ui| {
        ui.weak(text);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        for (value, text) in
            [(0.0, "0"), (1.0, "1.00"), (134.2, "134"), (0.04567, "0.0457"), (1234.5, "1234"), (2e-7, "2.00e-7")]
        {
            assert_eq!(significant(value), text);
        }
    }

    #[test]
    fn screen_and_pixels_are_inverse() {
        let placement = Placement { rect: Rect::from_min_size(pos2(11.0, 7.0), vec2(320.0, 320.0)), scale: 10.0 };
        let (x, y) = placement.to_pixels(placement.to_screen(3.25, 30.0));
        assert!((x - 3.25).abs() < 1e-5 && (y - 30.0).abs() < 1e-5);
        assert_eq!(placement.to_screen(0.0, 0.0), pos2(16.0, 12.0), "pixel centres are at integers");
    }
}
