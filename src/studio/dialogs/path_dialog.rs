//! Questions that need a path: one window with a typed path, and the system's own file dialog behind a button.
//!
//! The system's dialog runs one at a time; where the system has none, a sentence says so and the path field takes the
//! keyboard.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};

use egui::accesskit::Live;
use egui::{Key, TextEdit};
use ndarray::{Array2, Array3, Array4, ArrayD, Axis};

use crate::formats::path_text;
use crate::objects::ObjectSource;
use crate::studio::dialogs::file_preview::Preview;
use crate::studio::dialogs::system_dialog::{self, Answer, Picker};
use crate::studio::panels::messages::{Severity, speak};
use crate::studio::state::app_state::State;
use crate::studio::widgets::modal;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{
    Colormap, Curve, DESIGN_FILE, DESIGN_FILES, FileUse, IdealRecord, Job, LiveRecord, MEASUREMENT_STACKS,
    MeasurementFormat,
};

/// What is said where *Browse* has nothing to open.
const NO_DIALOG: &str =
    "This system has no file dialog: neither a desktop portal nor zenity answers. Type the path above.";

/// What a path is asked for.
#[derive(Clone, Debug)]
pub enum Purpose {
    /// Opens a design file.
    OpenDesign,
    /// Saves the design under another name.
    SaveAs,
    /// Images the objects of a file or folder.
    OpenObjects,
    /// Chooses images of a camera to estimate from.
    ChooseImages,
    /// Uses a picture as the PSF.
    ImportPsf,
    /// Keeps unsaved changes in a folder.
    KeepUnsaved,
    /// Writes the PSF in all formats and the design.
    ExportDesign,
    /// Writes the live objects and measurements.
    ExportMeasurements,
    /// Writes a picture as shown.
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
    /// Writes a picture of a room.
    ExportPicture {
        /// Name of the room.
        name: &'static str,
        /// Shape (rows, cols, 3).
        image: Array3<u8>,
    },
    /// Writes the record of a run.
    ExportRecord(Arc<IdealRecord>),
    /// Writes the record of a live estimate.
    ExportLive(Box<LiveRecord>),
    /// Writes a curve as CSV.
    ExportCurve {
        /// The curve.
        curve: Curve,
        /// Name of the file that is suggested.
        name: &'static str,
    },
}

impl Purpose {
    fn title(&self) -> String {
        match self {
            Self::OpenDesign => "Open design".into(),
            Self::SaveAs => "Save design as".into(),
            Self::OpenObjects => "Open objects".into(),
            Self::ChooseImages => "Images of a camera".into(),
            Self::ImportPsf => "Import PSF".into(),
            Self::KeepUnsaved => "Folder for unsaved changes".into(),
            Self::ExportDesign => "Export design".into(),
            Self::ExportMeasurements => "Export measurements".into(),
            Self::ExportView { name, .. } => format!("Export {name} view"),
            Self::ExportPicture { name, .. } => format!("Export picture of {name}"),
            Self::ExportRecord(_) => "Export record".into(),
            Self::ExportLive(_) => "Export record of the live estimate".into(),
            Self::ExportCurve { .. } => "Export curve".into(),
        }
    }

    fn hint(&self) -> &'static str {
        match self {
            Self::OpenDesign | Self::SaveAs => "A design file (.json)",
            Self::OpenObjects => {
                "IDX (.gz too), CIFAR-10 .bin, NPY, NPZ or TIFF stack, a picture, or a folder of pictures"
            }
            Self::ChooseImages => "Two or more grey images: an NPY, NPZ or TIFF stack, or a folder of pictures",
            Self::ImportPsf => "A picture (PNG, JPEG, TIFF, BMP) or an NPY array of the PSF",
            Self::ExportDesign => {
                "A folder for psf.png, psf16.png, psf.tiff, psf.npy, design.json and lenslets.csv; it is made if need be"
            }
            Self::KeepUnsaved => "A folder of a disk that is there whenever the program runs; it is made if need be",
            Self::ExportMeasurements => "A folder for objects, noiseless and measurements; it is made if need be",
            Self::ExportView { .. } => "A PNG file, one pixel per pixel",
            Self::ExportPicture { .. } => "A PNG file, as it was on the screen",
            Self::ExportRecord(_) => "A JSON file with everything that is needed to repeat the run",
            Self::ExportLive(_) => {
                "A JSON file from which `lenslet-studio repeat FILE` computes the same numbers again"
            }
            Self::ExportCurve { .. } => "A CSV file",
        }
    }

    /// What a file of images is read for.
    fn file_use(&self) -> Option<FileUse> {
        match self {
            Self::OpenObjects => Some(FileUse::Objects),
            Self::ImportPsf => Some(FileUse::Psf),
            Self::ChooseImages => Some(FileUse::Measurements),
            _ => None,
        }
    }

    fn action(&self) -> &'static str {
        match self {
            Self::OpenDesign | Self::OpenObjects => "Open",
            Self::ChooseImages => "Choose",
            Self::ImportPsf => "Import",
            Self::SaveAs => "Save",
            Self::KeepUnsaved => "Use",
            _ => "Export",
        }
    }

    fn picker(&self) -> Picker {
        match self {
            Self::OpenDesign | Self::OpenObjects | Self::ChooseImages | Self::ImportPsf => Picker::Open,
            Self::SaveAs
            | Self::ExportView { .. }
            | Self::ExportPicture { .. }
            | Self::ExportRecord(_)
            | Self::ExportLive(_)
            | Self::ExportCurve { .. } => Picker::Save,
            Self::ExportDesign | Self::ExportMeasurements | Self::KeepUnsaved => Picker::Folder,
        }
    }

    /// Extension of the file that is written where none is typed; none where no file is asked for.
    fn extension(&self) -> Option<&'static str> {
        match self {
            Self::SaveAs | Self::ExportRecord(_) | Self::ExportLive(_) => Some("json"),
            Self::ExportView { .. } | Self::ExportPicture { .. } => Some("png"),
            Self::ExportCurve { .. } => Some("csv"),
            Self::OpenDesign
            | Self::OpenObjects
            | Self::ChooseImages
            | Self::ImportPsf
            | Self::KeepUnsaved
            | Self::ExportDesign
            | Self::ExportMeasurements => None,
        }
    }

    /// What stands in the path field at first.
    fn suggestion(&self, beside: Option<&Path>) -> String {
        let folder = beside.and_then(Path::parent).map_or_else(|| PathBuf::from("."), Path::to_path_buf);
        let name = match self {
            Self::OpenDesign | Self::OpenObjects | Self::ChooseImages | Self::ImportPsf | Self::KeepUnsaved => {
                return String::new();
            }
            Self::SaveAs => beside.map_or_else(|| free_name(&folder), Path::to_path_buf),
            Self::ExportDesign => folder.join("export"),
            Self::ExportMeasurements => folder.join("measurements"),
            Self::ExportView { name, .. } | Self::ExportPicture { name, .. } => {
                folder.join(format!("{}.png", name.to_lowercase().replace(' ', "-")))
            }
            Self::ExportRecord(_) => folder.join("run.json"),
            Self::ExportLive(_) => folder.join("live.json"),
            Self::ExportCurve { name, .. } => folder.join(name),
        };
        name.strip_prefix(".").map_or(name.clone(), Path::to_path_buf).display().to_string()
    }
}

/// A file for a design that is in none, which is not there yet: `design.json`, `design-2.json` and so on.
fn free_name(folder: &Path) -> PathBuf {
    let first = folder.join(DESIGN_FILE);
    let others = (2..1000).map(|number| folder.join(format!("design-{number}.json")));
    let free = std::iter::once(first.clone()).chain(others).find(|path| !path.exists());
    // Among so many, a person chooses.
    free.unwrap_or(first)
}

/// The open question, if any.
#[derive(Default)]
pub struct Dialogs {
    open: Option<Question>,
}

struct Question {
    purpose: Purpose,
    path: String,
    /// The path that the system's dialog has chosen, as long as its text is not changed: it may be no text.
    chosen: Option<PathBuf>,
    /// What is understood of the file.
    preview: Preview,
    /// Pixels to resample an imported PSF to; 0 leaves it as it is.
    resample: usize,
    /// What measurements are written as.
    format: MeasurementFormat,
    /// Answer of the system's dialog, while it is open.
    system: Option<Receiver<Answer>>,
    /// The system was found to have no dialog.
    is_alone: bool,
    /// The path field takes the keyboard once.
    focus: bool,
    /// Files that may be replaced: the system's dialog or this one has asked whether they may.
    replaced: Vec<PathBuf>,
}

impl Question {
    /// The file or folder that the path stands for: a file that is written always has an extension.
    fn target(&self) -> PathBuf {
        let chosen = self.chosen.as_ref().filter(|chosen| path_text(chosen) == self.path);
        let path = chosen.map_or_else(|| PathBuf::from(self.path.trim()), PathBuf::clone);
        match self.purpose.extension() {
            Some(extension) if path.extension().is_none() => path.with_extension(extension),
            _ => path,
        }
    }

    /// Files that are there and would be replaced, but for the design's `own` where that is saved: what is exported may be
    /// a mask of the run.
    fn would_replace(&self, own: Option<&Path>) -> Vec<PathBuf> {
        let target = self.target();
        let mut files = match self.purpose {
            Purpose::ExportDesign => DESIGN_FILES.map(|name| target.join(name)).to_vec(),
            Purpose::ExportMeasurements => MEASUREMENT_STACKS.map(|name| self.format.file(&target, name)).to_vec(),
            _ if self.purpose.extension().is_some() => vec![target],
            _ => Vec::new(),
        };
        let is_saved = matches!(self.purpose, Purpose::SaveAs);
        files.retain(|file| file.exists() && !(is_saved && own == Some(file)));
        files
    }

    /// Asks whether these files may be replaced.
    fn ask_to_replace(files: &[PathBuf]) -> Option<String> {
        let (first, others) = files.split_first()?;
        let first = first.display();
        Some(match others.len() {
            0 => format!("{first} is there already. Replace it?"),
            more => format!("{first} and {more} more are there already. Replace them?"),
        })
    }
}

impl Dialogs {
    /// Asks for a path. `beside` is the design's file, near which suggestions lie.
    pub fn ask(&mut self, purpose: Purpose, beside: Option<&Path>) {
        let path = purpose.suggestion(beside);
        let (system, replaced, format) = (None, Vec::new(), MeasurementFormat::Npy);
        let (chosen, preview, resample, is_alone, focus) = (None, Preview::default(), 0, false, true);
        self.open =
            Some(Question { purpose, path, chosen, preview, resample, format, system, is_alone, focus, replaced });
    }

    /// Whether a question is open.
    pub fn is_open(&self) -> bool {
        self.open.is_some()
    }
}

/// Shows the open question and does what it is answered.
pub fn show(ctx: &egui::Context, state: &mut State) {
    let Some(mut question) = state.dialogs.open.take() else { return };
    let own = state.bench.path();
    if let Some(system) = &question.system {
        match system.try_recv() {
            Ok(Answer::Chosen(path)) => {
                question.path = path_text(&path);
                question.chosen = Some(path.clone());
                question.system = None;
                // It has asked about a file of this very name.
                let has_asked = question.purpose.picker() == Picker::Save && question.target() == path;
                question.replaced = if has_asked { question.would_replace(own) } else { Vec::new() };
            }
            Ok(Answer::Missing) => {
                question.system = None;
                (question.is_alone, question.focus) = (true, true);
            }
            Ok(Answer::Cancelled) | Err(TryRecvError::Disconnected) => question.system = None,
            Err(TryRecvError::Empty) => {}
        }
    }
    let mut done = false;
    let mut cancelled = false;
    modal::show(ctx, "path question", 480.0, |ui| {
        ui.heading(question.purpose.title());
        ui.add_space(4.0);
        ui.label(question.purpose.hint());
        ui.add_space(4.0);
        ui.horizontal(|ui| {
            let browse = 80.0;
            let width = (ui.available_width() - browse).max(80.0);
            let field = ui.add(TextEdit::singleline(&mut question.path).desired_width(width).hint_text("Path"));
            crate::studio::canvas::image_view::name_widget(&field, "Path");
            if question.focus {
                field.request_focus();
                question.focus = false;
            }
            let confirmed = field.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            done |= confirmed && !question.path.trim().is_empty();
            if ui.add_enabled(question.system.is_none(), egui::Button::new("Browse...")).clicked() {
                question.system = system_dialog::open(ui.ctx(), question.purpose.picker(), Path::new(&question.path));
            }
        });
        if question.is_alone {
            let told = ui.colored_label(ui.visuals().warn_fg_color, NO_DIALOG);
            speak(&told, Live::Assertive);
        }
        if let Some(of) = question.purpose.file_use() {
            question.preview.show_in_place(ui, &mut question.path, of);
        }
        let mut action = question.purpose.action();
        if let Some(text) = Question::ask_to_replace(&question.replaced)
            && question.replaced == question.would_replace(own)
        {
            let asked = ui.colored_label(ui.visuals().warn_fg_color, text);
            speak(&asked, Live::Assertive);
            action = "Replace";
        }
        match question.purpose {
            Purpose::ImportPsf => {
                ui.horizontal(|ui| {
                    let mut resample = question.resample > 0;
                    if ui.checkbox(&mut resample, "Resample the central square to").changed() {
                        question.resample = if resample { 32 } else { 0 };
                    }
                    if resample {
                        let field = NumberField::whole("Resampled side", 4..=1024).unit(" px");
                        field.edit_whole(ui, &mut question.resample);
                    }
                });
            }
            Purpose::ExportMeasurements => {
                ui.horizontal(|ui| {
                    ui.radio_value(&mut question.format, MeasurementFormat::Npy, "NPY");
                    ui.radio_value(&mut question.format, MeasurementFormat::Tiff, "TIFF, 32-bit float");
                });
            }
            _ => {}
        }
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            let ready = !question.path.trim().is_empty();
            done |= ui.add_enabled(ready, egui::Button::new(action)).clicked();
            cancelled |= ui.button("Cancel").clicked() || ui.input(|input| input.key_pressed(Key::Escape));
        });
    });
    if done {
        let there = question.would_replace(own);
        done = there.iter().all(|file| question.replaced.contains(file));
        question.replaced = there;
        // Another name can be typed at once, and Enter confirms this one.
        question.focus = !done;
    }
    if done {
        answer(state, question);
    } else if !cancelled {
        state.dialogs.open = Some(question);
    }
}

fn answer(state: &mut State, question: Question) {
    let path = question.target();
    match &question.purpose {
        Purpose::OpenDesign => state.bench.open_file(path),
        Purpose::SaveAs => state.bench.save_to(path),
        Purpose::OpenObjects => state.bench.open_objects(ObjectSource::guess(&path)),
        Purpose::ChooseImages => state.estimate_form.images.choose(question.path.trim().to_owned(), question.preview),
        Purpose::ImportPsf => {
            let side = Some(question.resample).filter(|&side| side > 0);
            state.bench.import_psf(path, side);
        }
        Purpose::ExportDesign => {
            state.bench.submit(Job::ExportDesign { design: state.bench.design().clone(), folder: path });
        }
        Purpose::ExportMeasurements => export_measurements(state, path, question.format),
        Purpose::ExportView { image, limits, colormap, .. } => {
            let image = image.clone();
            state.bench.submit(Job::ExportView { image, limits: *limits, colormap: *colormap, path });
        }
        Purpose::KeepUnsaved => {
            state.move_unsaved(Some(std::path::absolute(&path).unwrap_or(path)));
        }
        Purpose::ExportPicture { image, .. } => state.bench.submit(Job::ExportPicture { image: image.clone(), path }),
        Purpose::ExportRecord(record) => state.bench.submit(Job::ExportRecord { record: Arc::clone(record), path }),
        Purpose::ExportLive(record) => {
            state.bench.submit(Job::ExportLive { record: record.clone(), path, for_command: false });
        }
        Purpose::ExportCurve { curve, .. } => state.bench.submit(Job::ExportCurve { curve: curve.clone(), path }),
    }
}

/// Objects of shape (n, planes, rows, cols) as they are exported: those of one plane have no axis for it.
fn objects_of(objects: &Array4<f32>) -> ArrayD<f32> {
    match objects.len_of(Axis(1)) {
        1 => objects.index_axis(Axis(1), 0).to_owned().into_dyn(),
        _ => objects.clone().into_dyn(),
    }
}

fn export_measurements(state: &mut State, folder: PathBuf, format: MeasurementFormat) {
    let scene = state.live.scene.as_ref().filter(|scene| state.is_current(scene.revision));
    let (Some(scene), Some(measurements)) = (scene, state.current_measurements()) else {
        let refusal = "There are no measurements of this design yet; wait until they are computed.";
        state.messages.push(Severity::Failure, refusal);
        return;
    };
    state.bench.submit(Job::ExportMeasurements {
        objects: objects_of(&scene.value.objects),
        noiseless: measurements.value.noiseless.clone(),
        noisy: measurements.value.noisy.clone(),
        format,
        folder,
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_design_without_a_file_is_offered_a_name_that_is_free() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["design.json", "design-2.json", "design-3.json"] {
            assert_eq!(free_name(folder.path()), folder.path().join(name));
            std::fs::write(folder.path().join(name), b"").unwrap();
        }
        let own = Path::new("/a/mine.json");
        assert_eq!(Purpose::SaveAs.suggestion(Some(own)), own.display().to_string());
    }
}
