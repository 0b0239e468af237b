//! Previews of the captures of several systems: what was understood, and the first image of each.

use std::sync::Arc;

use ndarray::{Array2, ArrayView2, Axis};
use serde::{Deserialize, Serialize};

use crate::evaluation::{EstimateProgress, MeasuredImages, MeasuredOptions, MeasuredSource};
use crate::workbench::background::activity::ActivityKind;
use crate::workbench::background::latest::{Order, Work};

/// Captures of several systems, converted alike.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SystemCaptures {
    /// Locations of the images, one for each system.
    pub sources: Vec<MeasuredSource>,
    /// How the images become electrons.
    pub options: MeasuredOptions,
}

impl SystemCaptures {
    /// The same captures by absolute paths.
    pub(super) fn absolute(&self) -> Self {
        let sources = self.sources.iter().map(MeasuredSource::absolute).collect();
        Self { sources, options: self.options.absolute() }
    }

    /// Whether both name the same files and options.
    pub fn is_same(&self, other: &Self) -> bool {
        self.absolute() == other.absolute()
    }
}

/// Unit of converted captures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaptureUnit {
    /// Electrons: a camera file states the gain.
    Electrons,
    /// Photons: the gain is typed.
    Photons,
    /// Grey values: no gain is known.
    GreyValues,
}

impl CaptureUnit {
    fn of(options: &MeasuredOptions) -> Self {
        match options {
            MeasuredOptions { camera: Some(_), .. } => Self::Electrons,
            options if options.calibration.gain == 1.0 => Self::GreyValues,
            _ => Self::Photons,
        }
    }

    /// Its name, for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Electrons => "electrons",
            Self::Photons => "photons",
            Self::GreyValues => "grey values",
        }
    }
}

/// The captures of one system as they are understood.
#[derive(Clone, Debug)]
pub struct CapturePreview {
    /// Summary of the files, as the command line prints it.
    pub understood: String,
    /// Number of images.
    pub images: usize,
    /// The first image in [`CapturePreview::unit`] per (binned) pixel, shape (rows, cols).
    pub image: Arc<Array2<f32>>,
    /// Least and largest value of the first image.
    pub range: (f32, f32),
    /// Mean of all images, in the same unit.
    pub mean: f64,
    /// Unit of the values.
    pub unit: CaptureUnit,
}

impl CapturePreview {
    fn of(images: &MeasuredImages, options: &MeasuredOptions) -> Self {
        let image = images.photons().index_axis(Axis(0), 0).to_owned();
        Self {
            understood: images.understood().to_owned(),
            images: images.photons().len_of(Axis(0)),
            range: range_of(image.view()),
            image: Arc::new(image),
            mean: images.mean(),
            unit: CaptureUnit::of(options),
        }
    }
}

/// Least and largest value of an image, shape (rows, cols).
pub fn range_of(image: ArrayView2<'_, f32>) -> (f32, f32) {
    image.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)))
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
            let read = MeasuredImages::read_with(source, &captures.options, &mut on_progress);
            let preview =
                read.map_err(|error| error.to_string()).map(|images| CapturePreview::of(&images, &captures.options));
            work.publish(|previews| previews.systems.push(preview));
        }
        Ok(())
    }
}
