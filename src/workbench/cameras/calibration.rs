//! Calibration of a camera: its frames in groups, its quantities, and camera files.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::camera::{
    CalibratedCamera, CalibrationProgress, CameraError, ColourChoice, FrameSeries, GroupSummary, calibrate,
};
use crate::workbench::background::activity::ActivityKind;
use crate::workbench::background::latest::{Order, Work};

/// An order of the calibration.
#[derive(Clone, Debug)]
pub enum CalibrationOrder {
    /// Groups the frames of a folder or descriptor, and reads what each group holds.
    Group {
        /// The folder or descriptor.
        path: PathBuf,
        /// The colour that is taken from the frames.
        colour: ColourChoice,
    },
    /// Calibrates a camera.
    Calibrate {
        /// Its frames.
        series: Arc<FrameSeries>,
        /// The colour that is taken from them.
        colour: ColourChoice,
    },
    /// Opens a camera file.
    Open(PathBuf),
}

/// Frames and camera as far as they are known.
#[derive(Clone, Debug, Default)]
pub struct CalibrationResults {
    /// The frames in groups; none before a folder was chosen, and for an opened camera file.
    pub series: Option<Arc<FrameSeries>>,
    /// Content of the groups that were read, in the order of the series.
    pub groups: Arc<Vec<GroupSummary>>,
    /// The colour that was taken from the frames, once the groups are read.
    pub colour: Option<ColourChoice>,
    /// The camera.
    pub camera: Option<Arc<CalibratedCamera>>,
    /// The file that the camera was read from.
    pub file: Option<PathBuf>,
}

impl Order for CalibrationOrder {
    type Results = CalibrationResults;

    fn activity(&self) -> Option<(ActivityKind, String)> {
        match self {
            Self::Calibrate { series, .. } => {
                Some((ActivityKind::Calibration, format!("Calibrate {}", series.path.display())))
            }
            Self::Group { .. } | Self::Open(_) => None,
        }
    }

    fn run(&self, work: &Work<'_, Self>) -> Result<(), String> {
        match self {
            Self::Group { path, colour } => {
                work.publish(|results| *results = CalibrationResults::default());
                group(path, *colour, work)
            }
            Self::Calibrate { series, colour } => {
                let mut on_progress = |progress: &CalibrationProgress| {
                    let share = progress.done as f64 / progress.total.max(1) as f64;
                    work.report(&format!("Reading {}", progress.group), Some(share))
                };
                calibrate(series, *colour, &mut on_progress).map(|camera| {
                    work.publish(|results| (results.camera, results.file) = (Some(Arc::new(camera)), None));
                })
            }
            Self::Open(path) => CalibratedCamera::open(path).map(|camera| {
                let (camera, file) = (Some(Arc::new(camera)), Some(path.clone()));
                work.publish(|results| *results = CalibrationResults { camera, file, ..CalibrationResults::default() });
            }),
        }
        .map_err(|error| error.to_string())
    }
}

/// Groups frames, and publishes the groups before their files are read.
fn group(path: &Path, colour: ColourChoice, work: &Work<'_, CalibrationOrder>) -> Result<(), CameraError> {
    let series = Arc::new(FrameSeries::open(path)?);
    let shown = Arc::clone(&series);
    work.publish(|results| (results.series, results.colour) = (Some(shown), Some(colour)));
    let count = series.groups.len();
    for (index, group) in series.groups.iter().enumerate() {
        if work.report(&format!("Reading {}", group.label), Some(index as f64 / count as f64)).is_break() {
            return Err(CameraError::Cancelled);
        }
        let summary = series.summarize(group, colour)?;
        work.publish(|results| Arc::make_mut(&mut results.groups).push(summary));
    }
    Ok(())
}
