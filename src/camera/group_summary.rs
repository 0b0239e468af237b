//! What the files of a group hold, before a calibration uses them.

use super::channel::ColourChoice;
use super::error::CameraError;
use super::series::{FrameGroup, FrameSeries};

/// Content of the files of a group of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupSummary {
    /// Number of frames.
    pub frames: usize,
    /// Rows and columns of the frames; `None` where they differ.
    pub shape: Option<(usize, usize)>,
    /// Mean grey value, DN.
    pub mean_dn: f64,
}

impl FrameSeries {
    /// Reads the files of a group and reports what they hold, also where a calibration refuses them.
    ///
    /// # Errors
    /// [`CameraError`] for a file that cannot be read, or without the colour.
    pub fn summarize(&self, group: &FrameGroup, colour: ColourChoice) -> Result<GroupSummary, CameraError> {
        let colour = colour.of_one_plane();
        let (mut frames, mut sum, mut pixels) = (0, 0.0, 0);
        let mut shapes = Vec::new();
        for path in &group.files {
            let read = colour.read(&self.image_file(path)?)?;
            let Some(plane) = read.planes.into_iter().next() else { continue };
            let (count, rows, cols) = plane.dim();
            frames += count;
            pixels += plane.len();
            sum += plane.iter().map(|&value| f64::from(value)).sum::<f64>();
            shapes.push((rows, cols));
        }
        shapes.dedup();
        let shape = if let [shape] = shapes[..] { Some(shape) } else { None };
        Ok(GroupSummary { frames, shape, mean_dn: sum / pixels.max(1) as f64 })
    }
}
