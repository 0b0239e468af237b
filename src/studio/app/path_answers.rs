//! What follows from the answer to a question for a path.

use std::path::PathBuf;

use ndarray::{Array4, ArrayD, Axis};

use crate::objects::ObjectSource;
use crate::studies::plans::Plan;
use crate::studio::app::state::State;
use crate::studio::state::camera::CameraPath;
use crate::studio::state::messages::Severity;
use crate::studio::state::path_dialog::{PathPurpose, PathQuestion};
use crate::workbench::{CalibrationOrder, Job, MeasurementFormat};

impl State {
    /// Acts on an answered question for a path.
    pub fn use_path(&mut self, question: PathQuestion) {
        let path = question.target();
        let job = match question.purpose {
            PathPurpose::OpenDesign => return self.session.open_file(path),
            PathPurpose::SaveAs => return self.session.save_to(path),
            PathPurpose::OpenObjects => return self.session.open_objects(ObjectSource::guess(&path)),
            PathPurpose::Camera(what) => return self.use_camera_path(what, path, question.path.trim().to_owned()),
            PathPurpose::SaveCamera(camera) => {
                self.panels.camera.saved = Some(path.clone());
                Job::SaveCamera { camera, path }
            }
            PathPurpose::ChooseCapture(file) => {
                return self.dialogs.capture.choose(file, question.path.trim().to_owned());
            }
            PathPurpose::ExportCapture { object, measurement } => {
                Job::ExportCapture { object, measurement, folder: path }
            }
            PathPurpose::SavePsfSettings(photograph) => Job::SavePsfSettings { photograph, path },
            PathPurpose::KeepUnsaved => {
                return self.move_unsaved(Some(std::path::absolute(&path).unwrap_or(path)));
            }
            PathPurpose::OpenWeights => return self.session.open_network(path),
            PathPurpose::ExportWeights(network) => Job::ExportNetwork { network, path },
            PathPurpose::ExportMeasurements => return self.export_measurements(path, question.format),
            PathPurpose::ExportDesign => Job::ExportDesign { design: self.session.design().clone(), folder: path },
            PathPurpose::ExportView { image, limits, colormap, .. } => {
                Job::ExportView { image, limits, colormap, path }
            }
            PathPurpose::ExportPanel { image, .. } => Job::ExportImage { image, path },
            PathPurpose::ExportRecord(record) => Job::ExportRecord { record, path },
            PathPurpose::ExportLive(record) => Job::ExportLive { record, path, for_command: false },
            PathPurpose::OpenPlan => {
                match Plan::open(&path) {
                    Ok(plan) => self.panels.studies.from_file = Some(plan),
                    Err(error) => self.messages.push(Severity::Failure, error.to_string()),
                }
                return;
            }
            PathPurpose::NewStudy(plan) => {
                let begun = self.session.open_study(Some(*plan), path);
                return self.report(begun);
            }
            PathPurpose::OpenStudy => {
                let opened = self.session.open_study(None, path);
                return self.report(opened);
            }
            PathPurpose::ExportStudyPlot(figure) => Job::ExportFigure { figure, path },
            PathPurpose::ExportStudyTable(study) => {
                Job::ExportStudyTable { folder: study.folder, states: study.states, path }
            }
            PathPurpose::ExportCurve { curve, .. } => Job::ExportCurve { curve, path },
        };
        self.session.submit(job);
    }

    /// Uses a path of the Camera panel; `text` is the path with its options.
    fn use_camera_path(&mut self, what: CameraPath, path: PathBuf, text: String) {
        let state = &mut self.panels.camera;
        match what {
            CameraPath::Frames | CameraPath::Descriptor => {
                (state.frames, state.saved) = (Some(path.clone()), None);
                self.session.calibrate(CalibrationOrder::Group { path, colour: state.colour });
            }
            CameraPath::CameraFile => {
                (state.frames, state.saved) = (None, None);
                self.session.calibrate(CalibrationOrder::Open(path));
            }
            _ => state.captures.choose(what, text),
        }
    }

    fn export_measurements(&mut self, folder: PathBuf, format: MeasurementFormat) {
        let view = self.parts().view;
        let scene = view.live.scene.as_ref().filter(|scene| view.is_current(scene.revision));
        let (Some(scene), Some(measurements)) = (scene, view.current_measurements()) else {
            let refusal = "There are no measurements of this design yet; wait until they are computed.";
            self.messages.push(Severity::Failure, refusal);
            return;
        };
        let job = Job::ExportMeasurements {
            objects: objects_of(&scene.value.objects),
            noiseless: measurements.value.noiseless.clone(),
            noisy: measurements.value.noisy.clone(),
            format,
            folder,
        };
        self.session.submit(job);
    }
}

/// Exported objects; a single plane has no axis: shape (n, planes, rows, cols) or (n, rows, cols).
fn objects_of(objects: &Array4<f32>) -> ArrayD<f32> {
    match objects.len_of(Axis(1)) {
        1 => objects.index_axis(Axis(1), 0).to_owned().into_dyn(),
        _ => objects.clone().into_dyn(),
    }
}
