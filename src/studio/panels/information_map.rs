//! Information of each pixel of a patch, by the live estimate.

use egui::Ui;
use ndarray::Axis;

use crate::studio::canvas::image_view::{ImageContent, ImageVersion};
use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::panels::parts::image_menu::{self, MenuImage};
use crate::studio::state::mtf_and_map::InformationMapState;
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::{name_widget, placeholder, toolbar};

/// Shows the map.
pub fn show(ui: &mut Ui, map: &mut InformationMapState, view: &View<'_>, requests: &mut Vec<Request>) {
    let live = view.estimates.live.as_ref();
    toolbar(ui, |ui| {
        map.image.colour_controls(ui, view.palettes);
        let count = live.map_or(0, |live| live.value.maps.len_of(Axis(0)));
        let mean = ui
            .selectable_label(map.patch.is_none(), "Mean")
            .on_hover_text("Mean over held-out patches; pixels are scanned row by row, so the first ones carry most");
        name_widget(&mean, "Mean information map");
        if mean.clicked() {
            map.patch = None;
        }
        let one =
            ui.selectable_label(map.patch.is_some(), "Patch").on_hover_text("Information of each pixel of one patch");
        name_widget(&one, "Information map of a patch");
        if one.clicked() {
            map.patch = Some(map.patch.unwrap_or(0));
        }
        if let Some(patch) = &mut map.patch {
            *patch = (*patch).min(count.saturating_sub(1));
            let next = ui.small_button(">").on_hover_text("Next patch");
            name_widget(&next, "Next patch");
            if next.clicked() {
                *patch = (*patch + 1) % count.max(1);
            }
            ui.weak(format!("{} of {count}", *patch + 1));
        }
    });
    let Some(live) = live else {
        placeholder(ui, if view.is_live { "Computing" } else { "The live estimate is off." });
        return;
    };
    let is_current = view.is_current(live.revision);
    let index = live.value.recipe.steps * 16 + map.patch.map_or(0, |patch| patch + 1);
    let image = map.map_of(&live.value);
    if image.is_empty() {
        return;
    }
    let patch = map.shown_patch(&live.value);
    let version = ImageVersion { revision: live.revision, index };
    let content = ImageContent { values: image, version, is_stale: !is_current };
    let shown = map.image.show(ui, view.palettes, content, PointerMode::View);
    if let Some(position) = shown.response.hover_pos() {
        let (x, y) = shown.placement.to_pixels(position);
        let photons = patch.and_then(|patch| {
            let (row, col) = (y.round().max(0.0) as usize, x.round().max(0.0) as usize);
            live.value.patches.get((patch, row, col)).copied()
        });
        let photons = photons.map_or_else(String::new, |photons| format!(", {photons:.0} photons"));
        requests.extend(map.image.describe_pixel(image, (x, y)).map(|text| Request::Describe(text + &photons)));
    }
    let menu = MenuImage { image, is_current, shown: &shown };
    image_menu::show(ui, &mut map.image, &menu, requests, |_, _, _| {});
}
