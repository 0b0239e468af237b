//! Context menu of an image.

use egui::Ui;
use ndarray::ArrayView2;

use crate::studio::canvas::image_view::{ImageView, Shown};
use crate::studio::canvas::viewport::Viewport;
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::Request;

/// An image as its menu sees it.
pub struct MenuImage<'a> {
    /// The values, shape (rows, cols).
    pub image: ArrayView2<'a, f32>,
    /// Whether they belong to the current revision.
    pub is_current: bool,
    /// The image as drawn in this frame.
    pub shown: &'a Shown,
}

/// Request to export an image as shown.
pub fn export(view: &ImageView, image: ArrayView2<'_, f32>) -> Request {
    let (name, colormap, limits) = (view.name(), view.colormap, view.limits_of(image));
    Request::AskPath(PathPurpose::ExportView { name, image: image.to_owned(), limits, colormap })
}

/// Shows the context menu of an image; `more` adds entries of its own for the clicked position (x, y), px. Returns whether
/// the zoom was reset.
pub fn show(
    ui: &Ui,
    view: &mut ImageView,
    menu: &MenuImage<'_>,
    requests: &mut Vec<Request>,
    more: impl FnOnce(&mut Ui, &mut Vec<Request>, (f64, f64)),
) -> bool {
    let MenuImage { image, is_current, shown } = *menu;
    let id = shown.response.id.with("clicked");
    if shown.response.secondary_clicked()
        && let Some(position) = shown.response.interact_pointer_pos()
    {
        ui.data_mut(|data| data.insert_temp(id, shown.placement.to_pixels(position)));
    }
    let place = ui.data(|data| data.get_temp(id)).unwrap_or_default();
    let mut is_reset = false;
    shown.response.context_menu(|ui| {
        more(ui, requests, place);
        if ui.add_enabled(!view.viewport.is_fitted(), egui::Button::new("Show all")).clicked() {
            view.viewport = Viewport::default();
            is_reset = true;
            ui.close();
        }
        if ui.button("Copy value").clicked() {
            let text = view.describe_pixel(image, place);
            requests.extend(text.map(|text| Request::Copy { text, what: "Value" }));
            ui.close();
        }
        if ui.add_enabled(is_current, egui::Button::new("Export image...")).clicked() {
            requests.push(export(view, image));
            ui.close();
        }
    });
    is_reset
}
