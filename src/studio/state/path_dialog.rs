//! The question for a path: its purpose and the typed answer.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::Receiver;

use ndarray::{Array2, Array3};

use crate::camera::CalibratedCamera;
use crate::formats::path_text;
use crate::optics::PsfPhotograph;
use crate::reconstruction::TrainedNetwork;
use crate::studies::plans::{Figure, Plan};
use crate::studio::state::camera::CameraPath;
use crate::studio::widgets::file_preview::Preview;
use crate::workbench::{
    Colormap, Curve, DESIGN_FILES, FileUse, IdealRecord, LiveRecord, MEASUREMENT_STACKS, MeasurementFormat, OpenStudy,
    RECONSTRUCTIONS_FILE,
};

/// Most files of a question that are named between the first and the last.
const MOST_NAMED: usize = 4;

/// One of the two files of a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaptureFile {
    /// The capture.
    Measurement,
    /// Photograph of the PSF.
    Psf,
}

/// Purpose of a path.
#[derive(Clone, Debug)]
pub enum PathPurpose {
    /// Opens a design file.
    OpenDesign,
    /// Saves the design under another name.
    SaveAs,
    /// Opens the objects of a file or folder.
    OpenObjects,
    /// Chooses a file of a capture to reconstruct.
    ChooseCapture(CaptureFile),
    /// Writes the settings of a PSF import.
    SavePsfSettings(PsfPhotograph),
    /// Opens the weights of a network.
    OpenWeights,
    /// Writes the weights of a network.
    ExportWeights(Arc<TrainedNetwork>),
    /// Stores unsaved changes in a folder.
    KeepUnsaved,
    /// Writes the PSF in all formats and the design.
    ExportDesign,
    /// Writes the live objects and measurements.
    ExportMeasurements,
    /// Writes a view as a colour image.
    ExportView {
        /// Name of the view.
        name: &'static str,
        /// Its values.
        image: Array2<f32>,
        /// Values in the first and the last colour.
        limits: (f32, f32),
        /// Its colours.
        colormap: Colormap,
    },
    /// Writes the reconstruction of a capture; images of shape (rows, cols, channels).
    ExportCapture {
        /// The object.
        object: Arc<Array3<f32>>,
        /// The capture.
        measurement: Arc<Array3<f32>>,
    },
    /// Writes an image of a panel.
    ExportPanel {
        /// Name of the panel.
        name: &'static str,
        /// Shape (rows, cols, 3).
        image: Array3<u8>,
    },
    /// Writes the record of a run.
    ExportRecord(Arc<IdealRecord>),
    /// Writes the record of a live estimate.
    ExportLive(Box<LiveRecord>),
    /// Opens the plan of a study.
    OpenPlan,
    /// Begins a plan in a folder.
    NewStudy(Box<Plan>),
    /// Opens the study of a folder.
    OpenStudy,
    /// Writes the plot of a study.
    ExportStudyPlot(Arc<Figure>),
    /// Writes the table of a study.
    ExportStudyTable(OpenStudy),
    /// Chooses a path of the Camera panel.
    Camera(CameraPath),
    /// Writes a camera file, with maps and drawing beside it.
    SaveCamera(Arc<CalibratedCamera>),
    /// Writes a curve as CSV.
    ExportCurve {
        /// The curve.
        curve: Curve,
        /// Suggested file name.
        name: &'static str,
    },
}

impl PathPurpose {
    /// Heading of the dialog.
    pub fn title(&self) -> String {
        match self {
            Self::OpenDesign => "Open design".into(),
            Self::SaveAs => "Save design as".into(),
            Self::OpenObjects => "Open objects".into(),
            Self::ChooseCapture(CaptureFile::Measurement) => "Capture".into(),
            Self::ChooseCapture(CaptureFile::Psf) => "PSF of the capture".into(),
            Self::ExportCapture { .. } => "Export reconstruction".into(),
            Self::SavePsfSettings(_) => "Save settings of the import".into(),
            Self::OpenWeights => "Open weights".into(),
            Self::ExportWeights(_) => "Export weights".into(),
            Self::KeepUnsaved => "Folder for unsaved changes".into(),
            Self::ExportDesign => "Export design".into(),
            Self::ExportMeasurements => "Export measurements".into(),
            Self::ExportView { name, .. } => format!("Export {name} view"),
            Self::ExportPanel { name, .. } => format!("Export image of {name}"),
            Self::ExportRecord(_) => "Export record".into(),
            Self::ExportLive(_) => "Export record of the live estimate".into(),
            Self::OpenPlan => "Open plan".into(),
            Self::NewStudy(plan) => format!("Folder for the study {}", plan.name),
            Self::OpenStudy => "Open study".into(),
            Self::ExportStudyPlot(_) => "Export plot".into(),
            Self::ExportStudyTable(_) => "Export table".into(),
            Self::Camera(path) => path.title().into(),
            Self::SaveCamera(_) => "Save camera".into(),
            Self::ExportCurve { .. } => "Export curve".into(),
        }
    }

    /// What the path names.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::OpenDesign | Self::SaveAs => "A design file (.json)",
            Self::OpenObjects => {
                "IDX (also .gz), CIFAR-10 .bin, NPY, NPZ or TIFF stack, an image, or a folder of images"
            }
            Self::ChooseCapture(CaptureFile::Measurement) => {
                "An image of the camera (TIFF, PNG, JPEG, NPY), grey or colour"
            }
            Self::ChooseCapture(CaptureFile::Psf) => "A photograph of a point source by the same camera",
            Self::ExportCapture { .. } => {
                "A folder for reconstructions.npy, reconstruction-1.png and measurement-1.png; it is created if missing"
            }
            Self::OpenWeights => "A safetensors file of weights, also of `lenslet-studio reconstruct --out`",
            Self::ExportWeights(_) => "A safetensors file that `lenslet-studio reconstruct --weights FILE` reads",
            Self::SavePsfSettings(_) => "A TOML file that repeats the import: psf:FILE.toml",
            Self::ExportDesign => {
                "A folder for psf.png, psf16.png, psf.tiff, psf.npy, design.json and lenslets.csv; it is created if missing"
            }
            Self::KeepUnsaved => "A folder on a disk that is always connected; it is created if missing",
            Self::ExportMeasurements => "A folder for objects, noiseless and measurements; it is created if missing",
            Self::ExportView { .. } => "A PNG file with one pixel per value",
            Self::ExportPanel { .. } => "A PNG file of the panel as shown",
            Self::ExportRecord(_) => "A JSON file that reproduces the run",
            Self::ExportLive(_) => "A JSON file that `lenslet-studio reproduce FILE` reads",
            Self::OpenPlan => "A TOML file, as `lenslet-studio study plan fig2` prints it",
            Self::NewStudy(_) => "A folder for plan and cells; it is created if missing",
            Self::OpenStudy => "The folder of a study: --out of `lenslet-studio study run`",
            Self::ExportStudyPlot(_) => "An SVG or PNG file, by its ending",
            Self::Camera(path) => path.hint(),
            Self::SaveCamera(_) => "A camera file (.json); maps and drawing are written beside it",
            Self::ExportCurve { .. } | Self::ExportStudyTable(_) => "A CSV file",
        }
    }

    /// Use of a file of images.
    pub fn file_use(&self) -> Option<FileUse> {
        match self {
            Self::OpenObjects => Some(FileUse::Objects),
            _ => None,
        }
    }

    /// Label of the button that confirms.
    pub fn action(&self) -> &'static str {
        match self {
            Self::OpenDesign
            | Self::OpenObjects
            | Self::OpenWeights
            | Self::OpenPlan
            | Self::OpenStudy
            | Self::Camera(CameraPath::CameraFile) => "Open",
            Self::ChooseCapture(_) | Self::Camera(_) => "Choose",
            Self::SaveAs | Self::SaveCamera(_) | Self::SavePsfSettings(_) => "Save",
            Self::KeepUnsaved | Self::NewStudy(_) => "Use",
            _ => "Export",
        }
    }

    /// Dialog of the system for such paths.
    pub fn picker(&self) -> Picker {
        match self {
            Self::Camera(path) => path.picker(),
            Self::OpenDesign | Self::OpenObjects | Self::OpenWeights | Self::OpenPlan | Self::ChooseCapture(_) => {
                Picker::Open
            }
            Self::SaveAs
            | Self::SaveCamera(_)
            | Self::SavePsfSettings(_)
            | Self::ExportWeights(_)
            | Self::ExportView { .. }
            | Self::ExportPanel { .. }
            | Self::ExportRecord(_)
            | Self::ExportLive(_)
            | Self::ExportStudyPlot(_)
            | Self::ExportStudyTable(_)
            | Self::ExportCurve { .. } => Picker::Save,
            Self::ExportDesign
            | Self::ExportMeasurements
            | Self::ExportCapture { .. }
            | Self::NewStudy(_)
            | Self::OpenStudy
            | Self::KeepUnsaved => Picker::Folder,
        }
    }

    /// Default extension of a written file.
    pub fn extension(&self) -> Option<&'static str> {
        match self {
            Self::SaveAs | Self::SaveCamera(_) | Self::ExportRecord(_) | Self::ExportLive(_) => Some("json"),
            Self::ExportView { .. } | Self::ExportPanel { .. } => Some("png"),
            Self::ExportCurve { .. } | Self::ExportStudyTable(_) => Some("csv"),
            Self::ExportStudyPlot(_) => Some("svg"),
            Self::SavePsfSettings(_) => Some("toml"),
            Self::ExportWeights(_) => Some("safetensors"),
            Self::OpenDesign
            | Self::OpenObjects
            | Self::OpenWeights
            | Self::OpenPlan
            | Self::NewStudy(_)
            | Self::OpenStudy
            | Self::ChooseCapture(_)
            | Self::KeepUnsaved
            | Self::Camera(_)
            | Self::ExportDesign
            | Self::ExportCapture { .. }
            | Self::ExportMeasurements => None,
        }
    }

    /// Initial text of the path field.
    pub fn suggestion(&self, beside: Option<&Path>) -> String {
        let folder = beside.and_then(Path::parent).map_or_else(|| PathBuf::from("."), Path::to_path_buf);
        let name = match self {
            Self::OpenDesign
            | Self::OpenObjects
            | Self::OpenWeights
            | Self::OpenPlan
            | Self::OpenStudy
            | Self::ChooseCapture(_)
            | Self::Camera(_)
            | Self::KeepUnsaved => return String::new(),
            Self::SavePsfSettings(photograph) => photograph.file.path.with_extension("toml"),
            Self::NewStudy(plan) => folder.join(&plan.name),
            Self::ExportStudyPlot(_) => folder.join("plot.svg"),
            Self::ExportStudyTable(_) => folder.join("table.csv"),
            Self::SaveAs => beside.map_or_else(|| free_name(&folder), Path::to_path_buf),
            Self::ExportDesign => folder.join("export"),
            Self::ExportMeasurements => folder.join("measurements"),
            Self::ExportCapture { .. } => folder.join("capture"),
            Self::ExportView { name, .. } | Self::ExportPanel { name, .. } => {
                folder.join(format!("{}.png", name.to_lowercase().replace(' ', "-")))
            }
            Self::SaveCamera(_) => folder.join("camera.json"),
            Self::ExportRecord(_) => folder.join("run.json"),
            Self::ExportLive(_) => folder.join("live.json"),
            Self::ExportWeights(_) => folder.join("network.safetensors"),
            Self::ExportCurve { name, .. } => folder.join(name),
        };
        name.strip_prefix(".").map_or(name.clone(), Path::to_path_buf).display().to_string()
    }
}

/// A free file name for a new design: `design.lenslet.json`, `design-2.lenslet.json` and so on. A desktop opens files of such
/// names with the program.
fn free_name(folder: &Path) -> PathBuf {
    let first = folder.join("design.lenslet.json");
    let others = (2..1000).map(|number| folder.join(format!("design-{number}.lenslet.json")));
    let free = std::iter::once(first.clone()).chain(others).find(|path| !path.exists());
    // Beyond that the user chooses.
    free.unwrap_or(first)
}

/// The open question, if any.
#[derive(Default)]
pub struct PathDialog {
    /// The question.
    pub open: Option<PathQuestion>,
}

/// A question for a path, with its typed answer.
pub struct PathQuestion {
    /// Purpose of the path.
    pub purpose: PathPurpose,
    /// The path as typed.
    pub path: String,
    /// Path from the dialog of the system until the text is edited. It need not be Unicode.
    pub chosen: Option<PathBuf>,
    /// Preview of the file.
    pub preview: Preview,
    /// File format of measurements.
    pub format: MeasurementFormat,
    /// Answer of the dialog of the system, while it is open.
    pub system: Option<Receiver<Answer>>,
    /// Whether the system has no file dialog.
    pub is_alone: bool,
    /// Whether the path field requests the keyboard focus.
    pub focus: bool,
    /// Files whose replacement was confirmed or asked about.
    pub replaced: Vec<PathBuf>,
}

impl PathQuestion {
    /// The file or folder of the path, with the default extension.
    pub fn target(&self) -> PathBuf {
        let chosen = self.chosen.as_ref().filter(|chosen| path_text(chosen) == self.path);
        let path = chosen.map_or_else(|| PathBuf::from(self.path.trim()), PathBuf::clone);
        match self.purpose.extension() {
            Some(extension) if path.extension().is_none() => path.with_extension(extension),
            _ => path,
        }
    }

    /// Existing files that the answer would replace. Saving to the design's `own` file is no replacement.
    pub fn would_replace(&self, own: Option<&Path>) -> Vec<PathBuf> {
        let target = self.target();
        let mut files = match &self.purpose {
            PathPurpose::ExportDesign => DESIGN_FILES.map(|name| target.join(name)).to_vec(),
            PathPurpose::ExportMeasurements => MEASUREMENT_STACKS.map(|name| self.format.file(&target, name)).to_vec(),
            PathPurpose::ExportCapture { .. } => vec![target.join(RECONSTRUCTIONS_FILE)],
            PathPurpose::SaveCamera(camera) => camera.files(&target),
            _ if self.purpose.extension().is_some() => vec![target],
            _ => Vec::new(),
        };
        let is_saved = matches!(self.purpose, PathPurpose::SaveAs);
        files.retain(|file| file.exists() && !(is_saved && own == Some(file)));
        files
    }

    /// The question whether these files of one folder may be replaced. Few are all named.
    pub fn ask_to_replace(files: &[PathBuf]) -> Option<String> {
        let (first, others) = files.split_first()?;
        let first = first.display();
        let names: Vec<_> = others.iter().filter_map(|file| Some(file.file_name()?.to_string_lossy())).collect();
        Some(match names.as_slice() {
            [] => format!("{first} already exists. Replace it?"),
            [only] => format!("{first} and {only} already exist. Replace them?"),
            [more @ .., last] if more.len() < MOST_NAMED => {
                format!("{first}, {} and {last} already exist. Replace them?", more.join(", "))
            }
            more => format!("{first} and {} more already exist. Replace them?", more.len()),
        })
    }
}

impl PathDialog {
    /// Opens a question. Suggestions lie in the folder of `beside`, the file of the design.
    pub fn ask(&mut self, purpose: PathPurpose, beside: Option<&Path>) {
        let path = purpose.suggestion(beside);
        let (system, replaced, format) = (None, Vec::new(), MeasurementFormat::Npy);
        let (chosen, preview, is_alone, focus) = (None, Preview::default(), false, true);
        self.open = Some(PathQuestion { purpose, path, chosen, preview, format, system, is_alone, focus, replaced });
    }

    /// Whether a question is open.
    pub fn is_open(&self) -> bool {
        self.open.is_some()
    }
}

/// Kind of file dialog.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Picker {
    /// For an existing file.
    Open,
    /// For a file to write.
    Save,
    /// For a folder.
    Folder,
}

/// Answer of the file dialog.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// A path was chosen.
    Chosen(PathBuf),
    /// The dialog was cancelled.
    Cancelled,
    /// The system has no dialog.
    Missing,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    pub fn a_design_without_a_file_is_offered_a_name_that_is_free() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["design.lenslet.json", "design-2.lenslet.json", "design-3.lenslet.json"] {
            assert_eq!(free_name(folder.path()), folder.path().join(name));
            std::fs::write(folder.path().join(name), b"").unwrap();
        }
        let own = Path::new("/a/mine.json");
        assert_eq!(PathPurpose::SaveAs.suggestion(Some(own)), own.display().to_string());
    }
}
