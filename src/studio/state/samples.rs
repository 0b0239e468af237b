//! State of the Object, Measurement and Reconstruction panels: the shown sample, the images, their linked zoom and cursor.

use egui::TextureHandle;
use ndarray::{ArrayView2, Axis, CowArray, Ix2};

use crate::evaluation::{Measurements, Scene};
use crate::sensor::field_offset;
use crate::studio::canvas::image_view::ImageView;
use crate::studio::state::reconstruction::ReconstructionState;
use crate::workbench::{Colormap, InspectionKey, Live, Networks, ReconstructionKey};

/// State of the Object, Measurement and Reconstruction panels.
pub struct SamplesState {
    /// One object.
    pub object: ImageView,
    /// Its measurement.
    pub measurement: ImageView,
    /// What a decoder makes of that.
    pub reconstruction: ReconstructionState,
    /// The shown sample.
    pub shown: ShownSample,
    /// Position of the pointer in one of the images.
    pub cursor: Option<CursorPlace>,
    /// Information overlay of the measurement.
    pub overlay: InformationOverlay,
}

/// The sample that object and measurement show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShownSample {
    /// Index of the sample.
    pub index: usize,
    /// Whether the measurement is shown with noise.
    pub noisy: bool,
}

impl Default for SamplesState {
    fn default() -> Self {
        Self {
            object: ImageView::new("Object", "photons", Colormap::Gray),
            measurement: ImageView::new("Measurement", "photons", Colormap::Gray),
            reconstruction: ReconstructionState::default(),
            shown: ShownSample { index: 0, noisy: true },
            cursor: None,
            overlay: InformationOverlay::default(),
        }
    }
}

impl SamplesState {
    /// The image of a side.
    pub fn image(&self, side: Side) -> &ImageView {
        match side {
            Side::Object => &self.object,
            Side::Measurement => &self.measurement,
            Side::Reconstruction => self.reconstruction.view(),
        }
    }

    fn image_mut(&mut self, side: Side) -> &mut ImageView {
        match side {
            Side::Object => &mut self.object,
            Side::Measurement => &mut self.measurement,
            Side::Reconstruction => self.reconstruction.view_mut(),
        }
    }

    /// Copies the viewport of one image to another; `offset` leads from its pixel coordinates (x, y) to those of the other.
    pub fn copy_viewport(&mut self, from: Side, to: Side, offset: (f64, f64)) {
        self.image_mut(to).viewport = self.image(from).viewport.shifted(offset);
    }

    /// Moves the cursor to a place (x, y) in an image, or away from that image. Returns whether it has moved.
    pub fn move_cursor(&mut self, side: Side, place: Option<(f64, f64)>, pass: u64) -> bool {
        let before = self.cursor;
        match place {
            Some(place) => self.cursor = Some(CursorPlace { side, place, pass }),
            None => self.cursor = before.filter(|cursor| cursor.side != side),
        }
        let place_of = |cursor: CursorPlace| (cursor.side, cursor.place);
        before.map(place_of) != self.cursor.map(place_of)
    }

    /// The cursor of another image, if that was drawn in this egui pass or the one before.
    pub fn cursor_of_other(&self, side: Side, pass: u64) -> Option<CursorPlace> {
        self.cursor.filter(|cursor| cursor.side != side && cursor.pass + 1 >= pass)
    }

    /// Key of the reconstruction that belongs to the shown sample, for a design of this revision and by these networks.
    pub fn reconstruction_key(&self, revision: u64, networks: &Networks) -> ReconstructionKey {
        let (ShownSample { index, noisy }, decoder) = (self.shown, self.reconstruction.decoder);
        let networks = if decoder.needs().training { networks.serial() } else { 0 };
        ReconstructionKey { revision, sample: index, noisy, decoder, networks }
    }
}

/// One of the linked images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The object.
    Object,
    /// Its measurement.
    Measurement,
    /// The reconstructed object.
    Reconstruction,
}

impl Side {
    /// The other sides.
    pub fn others(self) -> [Self; 2] {
        match self {
            Self::Object => [Self::Measurement, Self::Reconstruction],
            Self::Measurement => [Self::Object, Self::Reconstruction],
            Self::Reconstruction => [Self::Object, Self::Measurement],
        }
    }

    /// Offset (x, y) from pixel coordinates of this image to those of another.
    pub fn offset_to(self, other: Self, live: &Live) -> Option<(f64, f64)> {
        let is_measured = [self, other].map(|side| side == Self::Measurement);
        if is_measured[0] == is_measured[1] {
            return Some((0.0, 0.0));
        }
        let (_, _, rows, cols) = live.scene.as_ref()?.value.objects.dim();
        let (_, measured_rows, measured_cols) = live.measurements.as_ref()?.value.noisy.dim();
        // A stale measurement may have another shape.
        let psf = ((rows + 1).checked_sub(measured_rows)?, (cols + 1).checked_sub(measured_cols)?);
        let (by_row, by_col) = field_offset(psf);
        let sign = if is_measured[0] { 1.0 } else { -1.0 };
        Some((sign * by_col as f64, sign * by_row as f64))
    }
}

/// A pointer position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CursorPlace {
    /// The image under the pointer.
    pub side: Side,
    /// Pixel coordinates (x, y) of that image.
    pub place: (f64, f64),
    /// egui pass of the position, which expires when the image is no longer drawn.
    pub pass: u64,
}

/// The information overlay of the measurement.
#[derive(Default)]
pub struct InformationOverlay {
    /// Whether it is switched on.
    pub shown: bool,
    /// Its colours on the screen.
    pub texture: Option<TextureHandle>,
    /// What the texture was made of.
    pub drawn: Option<(InspectionKey, Colormap)>,
    /// Information of the most informative pixel, bits.
    pub most: f32,
}

/// An object summed over its planes, shape (rows, cols).
pub fn object_of(scene: &Scene, sample: usize) -> CowArray<'_, f32, Ix2> {
    let last = scene.objects.len_of(Axis(0)).saturating_sub(1);
    let object = scene.objects.index_axis(Axis(0), sample.min(last));
    if object.len_of(Axis(0)) == 1 {
        object.index_axis_move(Axis(0), 0).into()
    } else {
        object.sum_axis(Axis(0)).into()
    }
}

/// The shown measurement, shape (rows, cols).
pub fn measurement_of(measurements: &Measurements, shown: ShownSample) -> ArrayView2<'_, f32> {
    let stack = if shown.noisy { &measurements.noisy } else { &measurements.noiseless };
    let last = stack.len_of(Axis(0)).saturating_sub(1);
    stack.index_axis(Axis(0), shown.index.min(last))
}

#[cfg(test)]
mod tests {
    use egui::{Rect, pos2, vec2};

    use super::*;

    #[test]
    fn cursor_stays_until_its_own_image_loses_it() {
        let mut samples = SamplesState::default();
        assert!(samples.move_cursor(Side::Object, Some((3.0, 4.0)), 7));
        assert!(!samples.move_cursor(Side::Object, Some((3.0, 4.0)), 8), "a later pass is no move");
        assert!(!samples.move_cursor(Side::Measurement, None, 8), "the pointer is in the object");
        assert!(samples.move_cursor(Side::Object, None, 9));
        assert_eq!(samples.cursor, None);
    }

    #[test]
    fn cursor_of_the_other_image_expires_after_a_pass() {
        let mut samples = SamplesState::default();
        samples.move_cursor(Side::Object, Some((3.0, 4.0)), 7);
        let seen = |pass| samples.cursor_of_other(Side::Measurement, pass).map(|cursor| cursor.place);
        assert_eq!([7, 8, 9].map(seen), [Some((3.0, 4.0)), Some((3.0, 4.0)), None]);
        assert_eq!(samples.cursor_of_other(Side::Object, 7), None, "an image shows no cross hair of its own");
    }

    #[test]
    fn linked_viewports_show_the_same_place() {
        let mut samples = SamplesState::default();
        let fit = Rect::from_min_size(pos2(0.0, 0.0), vec2(320.0, 320.0));
        let zoomed = samples.object.viewport.zoomed(4.0, pos2(100.0, 200.0), fit, (64, 64));
        samples.object.viewport = zoomed;
        samples.copy_viewport(Side::Object, Side::Measurement, (-4.0, -5.0));
        samples.copy_viewport(Side::Object, Side::Reconstruction, (0.0, 0.0));
        assert_eq!(samples.reconstruction.view().viewport, zoomed);
        let (x, y) = zoomed.centre((64, 64));
        assert_eq!(samples.measurement.viewport.zoom(), 4.0);
        let (other_x, other_y) = samples.measurement.viewport.centre((64, 64));
        assert!((other_x - x + 4.0).abs() < 1e-9 && (other_y - y + 5.0).abs() < 1e-9, "{other_x} {other_y}");
    }
}
