//! Previews of the captures of several systems: what was understood, and the first image of each.

use std::sync::Arc;

use ndarray::{Array2, Axis};

use crate::evaluation::{EstimateProgress, MeasuredImages, MeasuredOptions, MeasuredSource};
use crate::workbench::background::activity::ActivityKind;
use crate::workbench::background::latest::{Order, Work};

/// Captures of several systems, converted alike.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SystemCaptures {
    /// Locations of the images, one for each system.
    pub sources: Vec<MeasuredSource>,
    /// How the images become electrons.
    pub options: MeasuredOptions,
}

/// The captures of one system as they are understood.
#[derive(Clone, Debug)]
pub struct CapturePreview {
    /// Summary of the files, as the command line prints it.
    pub understood: String,
    /// The first image, electrons or photons per (binned) pixel, shape (rows, cols).
    pub image: Arc<Array2<f32>>,
    /// Mean of all images, electrons or photons per (binned) pixel.
    pub mean: f64,
    /// Whether the unit is electrons: a camera file is used.
    pub is_in_electrons: bool,
}

/// The newest captures and their previews.
#[derive(Clone, Debug, Default)]
pub struct CapturePreviews {
    /// Number that changes with every order.
    pub serial: u64,
    /// The captures.
    pub of: Option<Arc<SystemCaptures>>,
    /// The preview of each system so far, or the reason why it cannot be used.
    pub systems: Vec<Result<CapturePreview, String>>,
}

/// Reads the captures of all systems.
pub(crate) struct PreviewOrder(pub Arc<SystemCaptures>);

impl Order for PreviewOrder {
    type Results = CapturePreviews;

    fn activity(&self) -> Option<(ActivityKind, String)> {
        None
    }

    fn run(&self, work: &Work<'_, Self>) -> Result<(), String> {
        let captures = &self.0;
        work.publish(|previews| {
            let of = Some(Arc::clone(captures));
            *previews = CapturePreviews { serial: previews.serial + 1, of, systems: Vec::new() };
        });
        let count = captures.sources.len();
        for (index, source) in captures.sources.iter().enumerate() {
            let mut on_progress =
                |_: &EstimateProgress| work.report(&format!("Reading {source}"), Some(index as f64 / count as f64));
            let read = MeasuredImages::open_with(source, &captures.options, &mut on_progress);
            let preview = read.map_err(|error| error.to_string()).map(|images| CapturePreview {
                understood: images.understood().to_owned(),
                image: Arc::new(images.photons().index_axis(Axis(0), 0).to_owned()),
                mean: images.mean(),
                is_in_electrons: captures.options.camera.is_some(),
            });
            work.publish(|previews| previews.systems.push(preview));
        }
        Ok(())
    }
}
