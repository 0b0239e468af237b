//! State of the Reconstruction panel.

use crate::reconstruction::DecoderKind;
use crate::studio::canvas::image_view::ImageView;
use crate::studio::state::training_form::TrainingForm;
use crate::workbench::{Colormap, Reconstruction};

use ndarray::ArrayView2;

/// Objects of the test set.
pub const TEST_OBJECTS: usize = 64;

/// State of the Reconstruction panel.
pub struct ReconstructionState {
    /// The decoder.
    pub decoder: DecoderKind,
    /// Form of a training.
    pub training: TrainingForm,
    /// What is to be shown.
    wanted: ShownQuantity,
    /// What is shown.
    shown: ShownQuantity,
    object: ImageView,
    error: ImageView,
    uncertainty: ImageView,
    /// Height of what stood below the image in the last frame, points.
    pub below: f32,
}

/// What is shown of a reconstruction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShownQuantity {
    /// The reconstructed object.
    #[default]
    Object,
    /// Object minus reconstruction.
    Error,
    /// Posterior standard deviation.
    Uncertainty,
}

impl Default for ReconstructionState {
    fn default() -> Self {
        Self {
            decoder: DecoderKind::default(),
            training: TrainingForm::default(),
            wanted: ShownQuantity::Object,
            shown: ShownQuantity::Object,
            object: ImageView::new("Reconstruction", "photons", Colormap::Gray).with_wide_colours(),
            error: ImageView::new("Reconstruction error", "photons", Colormap::Diverging).with_wide_colours(),
            uncertainty: ImageView::new("Reconstruction uncertainty", "photons", Colormap::Viridis).with_wide_colours(),
            below: 0.0,
        }
    }
}

impl ReconstructionState {
    /// What is shown.
    pub fn shown(&self) -> ShownQuantity {
        self.shown
    }

    /// What is to be shown.
    pub fn wanted(&self) -> ShownQuantity {
        self.wanted
    }

    /// Chooses what is to be shown.
    pub fn want(&mut self, wanted: ShownQuantity) {
        self.wanted = wanted;
    }

    /// Shows the chosen quantity with the same zoom, and the object while there is no uncertainty: it comes after the object.
    pub fn follow(&mut self, has_uncertainty: bool) {
        let viewport = self.view().viewport;
        let is_missing = self.wanted == ShownQuantity::Uncertainty && !has_uncertainty;
        self.shown = if is_missing { ShownQuantity::Object } else { self.wanted };
        self.view_mut().viewport = viewport;
    }

    /// The image on view.
    pub fn view(&self) -> &ImageView {
        match self.shown {
            ShownQuantity::Object => &self.object,
            ShownQuantity::Error => &self.error,
            ShownQuantity::Uncertainty => &self.uncertainty,
        }
    }

    /// The image on view, to change it.
    pub fn view_mut(&mut self) -> &mut ImageView {
        match self.shown {
            ShownQuantity::Object => &mut self.object,
            ShownQuantity::Error => &mut self.error,
            ShownQuantity::Uncertainty => &mut self.uncertainty,
        }
    }

    /// The values on view, shape (rows, cols), photons per pixel; the object where there is no uncertainty.
    pub fn values_of<'a>(&self, reconstruction: &'a Reconstruction) -> ArrayView2<'a, f32> {
        match (self.shown, &reconstruction.standard_deviation) {
            (ShownQuantity::Error, _) => reconstruction.error.view(),
            (ShownQuantity::Uncertainty, Some(deviation)) => deviation.view(),
            _ => reconstruction.object.view(),
        }
    }

    /// Sets what the uncertainty is of, where that is not the reconstruction.
    pub fn set_uncertainty_of(&mut self, what: Option<&'static str>) {
        self.uncertainty.set_detail(what.unwrap_or_default());
    }

    /// Centres the display range of the error on 0, with this largest value.
    pub fn centre_error(&mut self, largest: f32) {
        self.error.fix_limits((-largest, largest));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_share_their_zoom() {
        let mut state = ReconstructionState::default();
        let fit = egui::Rect::from_min_size(egui::pos2(0.0, 0.0), egui::vec2(320.0, 320.0));
        let zoomed = state.view().viewport.zoomed(4.0, egui::pos2(100.0, 200.0), fit, (64, 64));
        state.view_mut().viewport = zoomed;
        for shown in [ShownQuantity::Error, ShownQuantity::Uncertainty, ShownQuantity::Object] {
            state.want(shown);
            state.follow(true);
            assert_eq!((state.shown(), state.view().viewport), (shown, zoomed));
        }
    }

    #[test]
    fn object_is_shown_until_its_uncertainty_is_known() {
        let mut state = ReconstructionState::default();
        state.want(ShownQuantity::Uncertainty);
        for (has_uncertainty, shown) in [(false, ShownQuantity::Object), (true, ShownQuantity::Uncertainty)] {
            state.follow(has_uncertainty);
            assert_eq!((state.shown(), state.wanted()), (shown, ShownQuantity::Uncertainty));
        }
    }
}
