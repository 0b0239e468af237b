//! Context menu and export menu of images.

use egui::Ui;
use ndarray::{Array2, Axis};

use crate::studio::canvas::image_view::{ImageView, Shown};
use crate::studio::canvas::viewport::Viewport;
use crate::studio::panels::parts::linked_cursor::{measurement_of, object_of, sync_viewports};
use crate::studio::state::app_state::State;
use crate::studio::state::path_question::PathPurpose;
use crate::studio::state::views::{MtfView, Side};

/// An image that can be exported.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// Point spread function.
    Psf,
    /// The shown object.
    Object,
    /// Its measurement.
    Measurement,
    /// The transfer function, as a map.
    Mtf,
    /// The information map.
    Information,
}

impl View {
    const ALL: [Self; 5] = [Self::Psf, Self::Object, Self::Measurement, Self::Mtf, Self::Information];

    fn of(self, state: &State) -> &ImageView {
        match self {
            Self::Psf => &state.views.psf,
            Self::Object => &state.views.object,
            Self::Measurement => &state.views.measurement,
            Self::Mtf => &state.views.mtf,
            Self::Information => &state.views.information,
        }
    }

    fn of_mut(self, state: &mut State) -> &mut ImageView {
        match self {
            Self::Psf => &mut state.views.psf,
            Self::Object => &mut state.views.object,
            Self::Measurement => &mut state.views.measurement,
            Self::Mtf => &mut state.views.mtf,
            Self::Information => &mut state.views.information,
        }
    }

    /// Whether its image belongs to the current revision.
    fn is_current(self, state: &State) -> bool {
        let live = &state.live;
        let revision = match self {
            Self::Mtf if state.mtf_view != MtfView::Map => None,
            Self::Psf | Self::Mtf => live.optics.as_ref().map(|optics| optics.revision),
            Self::Object => live.scene.as_ref().map(|scene| scene.revision),
            Self::Measurement => live.measurements.as_ref().map(|measured| measured.revision),
            Self::Information => state.estimates.live.as_ref().map(|live| live.revision),
        };
        revision.is_some_and(|revision| state.is_current(revision))
    }

    /// Its image, shape (rows, cols).
    fn image(self, state: &State) -> Option<Array2<f32>> {
        let live = &state.live;
        Some(match self {
            Self::Psf => live.optics.as_ref()?.value.image.clone(),
            Self::Object => object_of(&live.scene.as_ref()?.value, state.sample).into_owned(),
            Self::Measurement => {
                measurement_of(&live.measurements.as_ref()?.value, state.sample, state.noisy).to_owned()
            }
            Self::Mtf if state.mtf_view == MtfView::Map => live.optics.as_ref()?.value.mtf.map.clone(),
            Self::Mtf => return None,
            Self::Information => {
                let live = &state.estimates.live.as_ref()?.value;
                match state.map_sample.filter(|&sample| sample < live.maps.len_of(Axis(0))) {
                    Some(sample) => live.maps.index_axis(Axis(0), sample).to_owned(),
                    None => live.mean_map.clone(),
                }
            }
        })
    }
}

/// Menu with one entry per available image.
pub fn export_menu(ui: &mut Ui, state: &mut State) {
    for view in View::ALL {
        let text = format!("{}...", view.of(state).name());
        if view.is_current(state) && ui.button(text).clicked() {
            export(state, view);
            ui.close();
        }
    }
}

fn export(state: &mut State, view: View) {
    let Some(image) = view.image(state) else { return };
    let shown = view.of(state);
    let (name, colormap, limits) = (shown.name(), shown.colormap, shown.limits_of(image.view()));
    state.path_dialog.ask(PathPurpose::ExportView { name, image, limits, colormap }, state.session.path());
}

/// Context menu of an image; `more` adds entries of its own for the clicked position (x, y), px.
pub fn show(ui: &Ui, state: &mut State, view: View, shown: &Shown, more: impl FnOnce(&mut Ui, &mut State, (f64, f64))) {
    let id = shown.response.id.with("clicked");
    if shown.response.secondary_clicked()
        && let Some(position) = shown.response.interact_pointer_pos()
    {
        ui.data_mut(|data| data.insert_temp(id, shown.placement.to_pixels(position)));
    }
    let place = ui.data(|data| data.get_temp(id)).unwrap_or_default();
    shown.response.context_menu(|ui| {
        more(ui, state, place);
        let fitted = view.of(state).viewport.is_fitted();
        if ui.add_enabled(!fitted, egui::Button::new("Show all")).clicked() {
            view.of_mut(state).viewport = Viewport::default();
            match view {
                View::Object => sync_viewports(ui, state, Side::Object),
                View::Measurement => sync_viewports(ui, state, Side::Measurement),
                View::Psf | View::Mtf | View::Information => {}
            }
            ui.close();
        }
        if ui.button("Copy value").clicked() {
            let image = view.image(state);
            let text = image.and_then(|image| view.of(state).describe_pixel(image.view(), place));
            if let Some(text) = text {
                state.copy(ui.ctx(), text, "Value");
            }
            ui.close();
        }
        if ui.add_enabled(view.is_current(state), egui::Button::new("Export image...")).clicked() {
            export(state, view);
            ui.close();
        }
    });
}
