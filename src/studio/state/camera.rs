//! State of the Camera panel: calibration, captures of systems, and their comparison.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::camera::ColourChoice;
use crate::evaluation::{Calibration, Crop, EstimateRequest, MeasuredOptions, View as CaptureView};
use crate::information::{EngineChoice, Estimator};
use crate::studio::canvas::image_view::{ImageVersion, ImageView};
use crate::studio::state::estimates::FitLengthForm;
use crate::studio::state::path_dialog::Picker;
use crate::workbench::{Colormap, SystemCaptures};

/// The usual patch.
pub const PATCH: Option<(usize, usize)> = Some((32, 32));

/// A part of the panel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraTab {
    /// Photon transfer.
    #[default]
    Calibration,
    /// Captures of systems.
    Captures,
    /// Information of systems.
    Comparison,
}

/// What is shown of a calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CalibrationPart {
    /// The frames in groups.
    #[default]
    Groups,
    /// The table.
    Values,
    /// The photon transfer curve.
    PhotonTransfer,
    /// Deviations from a line.
    Linearity,
    /// Signal-to-noise ratio.
    Snr,
}

/// Use of a path that the panel asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraPath {
    /// Folder of frames to calibrate with.
    Frames,
    /// Descriptor file of such frames.
    Descriptor,
    /// Camera file to show.
    CameraFile,
    /// Folder of captures of a system.
    CaptureFolder,
    /// File of captures of a system.
    CaptureFile,
    /// Camera file that calibrates captures.
    CameraOfCaptures,
    /// Dark images of the captures.
    Dark,
    /// Flat images of the captures.
    Flat,
}

impl CameraPath {
    /// Heading of the dialog.
    pub fn title(self) -> &'static str {
        match self {
            Self::Frames => "Folder of frames",
            Self::Descriptor => "Descriptor of frames",
            Self::CameraFile | Self::CameraOfCaptures => "Camera file",
            Self::CaptureFolder => "Folder of captures",
            Self::CaptureFile => "File of captures",
            Self::Dark => "Dark images",
            Self::Flat => "Flat images",
        }
    }

    /// What the path names.
    pub fn hint(self) -> &'static str {
        match self {
            Self::Frames => {
                "Dark frames and frames at several light levels, two or more each, by sub-folder or file name"
            }
            Self::Descriptor => "A descriptor file of EMVA 1288 (lines n, b, d and i)",
            Self::CameraFile | Self::CameraOfCaptures => "A camera file (.json), as calibrate --out writes it",
            Self::CaptureFolder => "A folder of images of one system: one to look at, two or more to estimate",
            Self::CaptureFile => {
                "An image of one system to look at, or a stack (NPY, NPZ, TIFF) to estimate. FILE?axis=last names the axis that counts images"
            }
            Self::Dark => "A folder, or a stack, of images without light",
            Self::Flat => "A folder, or a stack, of images of even light",
        }
    }

    /// Dialog of the system for such paths.
    pub fn picker(self) -> Picker {
        match self {
            Self::Descriptor | Self::CameraFile | Self::CaptureFile | Self::CameraOfCaptures => Picker::Open,
            Self::Frames | Self::CaptureFolder | Self::Dark | Self::Flat => Picker::Folder,
        }
    }
}

/// State of the Camera panel.
pub struct CameraState {
    /// The shown part of the panel.
    pub tab: CameraTab,
    /// What is shown of the calibration.
    pub part: CalibrationPart,
    /// Whether a camera was known in the last frame; a new one shows its table.
    pub had_camera: bool,
    /// Whether the axes of the photon transfer curve are logarithmic.
    pub is_logarithmic: bool,
    /// The chosen frames.
    pub frames: Option<PathBuf>,
    /// Camera file that was written last.
    pub saved: Option<PathBuf>,
    /// The colour that is taken from the frames.
    pub colour: ColourChoice,
    /// The captures.
    pub captures: CapturesForm,
    /// The comparison.
    pub comparison: ComparisonForm,
}

impl Default for CameraState {
    fn default() -> Self {
        Self {
            tab: CameraTab::default(),
            part: CalibrationPart::default(),
            had_camera: false,
            is_logarithmic: true,
            frames: None,
            saved: None,
            colour: ColourChoice::default(),
            captures: CapturesForm::default(),
            comparison: ComparisonForm::default(),
        }
    }
}

/// Captures of systems, and how they become electrons.
pub struct CapturesForm {
    /// Path of each system, with its options.
    pub systems: Vec<String>,
    /// The system whose first image is shown.
    pub shown: usize,
    /// Camera file.
    pub camera: Option<String>,
    /// Dark images.
    pub dark: Option<String>,
    /// Flat images.
    pub flat: Option<String>,
    /// Gain and offset where no camera file and no dark images state them, and bins.
    pub calibration: Calibration,
    /// The colour that is taken.
    pub colour: ColourChoice,
    /// Part of the images as it is typed.
    pub typed_crop: String,
    /// Part of the images; empty for the whole.
    pub crop: String,
    /// Quarter turns counter-clockwise.
    pub quarter_turns: u8,
    /// Whether images are mirrored.
    pub is_mirrored: bool,
    /// Captures whose previews were requested last.
    pub asked: Option<Arc<SystemCaptures>>,
    /// The first image of the shown system.
    pub image: ImageView,
    /// The simulated measurement beside it.
    pub simulated: ImageView,
    /// Least and largest value of the simulated measurement, with its version.
    pub simulated_range: Option<(ImageVersion, (f32, f32))>,
}

impl Default for CapturesForm {
    fn default() -> Self {
        Self {
            systems: Vec::new(),
            shown: 0,
            camera: None,
            dark: None,
            flat: None,
            calibration: Calibration::default(),
            colour: ColourChoice::default(),
            typed_crop: String::new(),
            crop: String::new(),
            quarter_turns: 0,
            is_mirrored: false,
            asked: None,
            image: ImageView::new("First image", "per px", Colormap::Gray),
            simulated: ImageView::new("Simulated measurement", "photons", Colormap::Gray),
            simulated_range: None,
        }
    }
}

impl CapturesForm {
    /// Takes a chosen path.
    pub fn choose(&mut self, what: CameraPath, path: String) {
        match what {
            CameraPath::CaptureFolder | CameraPath::CaptureFile => {
                self.shown = self.systems.len();
                self.systems.push(path);
            }
            CameraPath::CameraOfCaptures => self.camera = Some(path),
            CameraPath::Dark => self.dark = Some(path),
            CameraPath::Flat => self.flat = Some(path),
            CameraPath::Frames | CameraPath::Descriptor | CameraPath::CameraFile => {}
        }
    }

    /// Takes captures with all their options in place of those of the form.
    pub fn take(&mut self, captures: &SystemCaptures) {
        let SystemCaptures { sources, options } = captures;
        let text = |path: &Option<PathBuf>| path.as_ref().map(|path| path.to_string_lossy().into_owned());
        self.systems = sources.iter().map(ToString::to_string).collect();
        self.shown = 0;
        [self.camera, self.dark, self.flat] = [&options.camera, &options.dark, &options.flat].map(text);
        (self.calibration, self.colour) = (options.calibration, options.colour);
        let CaptureView { crop, quarter_turns, is_mirrored } = options.view;
        self.crop = crop.map_or_else(String::new, |crop| crop.to_string());
        self.typed_crop.clone_from(&self.crop);
        (self.quarter_turns, self.is_mirrored) = (quarter_turns, is_mirrored);
    }

    /// Removes a system.
    pub fn remove(&mut self, index: usize) {
        self.systems.remove(index);
        if self.shown > index || self.shown == self.systems.len() {
            self.shown = self.shown.saturating_sub(1);
        }
    }

    /// Name of a system: that of its file or folder.
    pub fn name(&self, index: usize) -> String {
        self.systems.get(index).map_or_else(String::new, |path| name_of(path))
    }

    /// The captures of the form.
    ///
    /// # Errors
    /// One sentence where the crop is no crop.
    pub fn captures(&self) -> Result<SystemCaptures, String> {
        let crop = match self.crop.trim() {
            "" => None,
            text => Some(text.parse::<Crop>()?),
        };
        let path = |path: &Option<String>| path.as_ref().map(PathBuf::from);
        // A camera file states gain and dark signal, dark images the dark signal.
        let usual = Calibration { bin: self.calibration.bin, ..Calibration::default() };
        let calibration = match (&self.camera, &self.dark) {
            (Some(_), _) => usual,
            (None, Some(_)) => Calibration { gain: self.calibration.gain, ..usual },
            (None, None) => self.calibration,
        };
        let options = MeasuredOptions {
            calibration,
            camera: path(&self.camera),
            colour: self.colour,
            dark: path(&self.dark),
            flat: path(&self.flat),
            view: CaptureView { crop, quarter_turns: self.quarter_turns, is_mirrored: self.is_mirrored },
        };
        let sources = self.systems.iter().map(|path| PathBuf::from(path).into()).collect();
        Ok(SystemCaptures { sources, options })
    }
}

/// Name of the file or folder of a path.
pub fn name_of(path: &str) -> String {
    let name = Path::new(path).file_name();
    name.map_or_else(|| path.to_owned(), |name| name.to_string_lossy().into_owned())
}

/// Estimators that need no objects, with their labels.
pub const OF_IMAGES: [(Estimator, &str); 3] = [
    (Estimator::GaussianStationary, "Gaussian"),
    (Estimator::Causal, "Causal model"),
    (Estimator::PixelCnn, "PixelCNN"),
];

/// The form of a comparison.
pub struct ComparisonForm {
    /// The estimator.
    pub kind: Estimator,
    /// Length of the fit.
    pub length: FitLengthForm,
    /// Rows and columns of a patch, pixels; `None` for whole images.
    pub patch: Option<(usize, usize)>,
    /// Whether systems are compared at equal light, too.
    pub with_equal_light: bool,
    /// Mean of equal light, photons per pixel.
    pub equal_light: f64,
    /// Whether frames of equal numbers show the same scene.
    pub is_simultaneous: bool,
    /// Whether details are those at equal light.
    pub shows_equal: bool,
}

impl Default for ComparisonForm {
    fn default() -> Self {
        let kind = Estimator::GaussianStationary;
        Self {
            kind,
            length: FitLengthForm::usual(kind),
            patch: PATCH,
            with_equal_light: true,
            equal_light: 500.0,
            is_simultaneous: false,
            shows_equal: false,
        }
    }
}

impl ComparisonForm {
    /// Request of the estimates.
    pub fn request(&self, engine: EngineChoice) -> EstimateRequest {
        let model = self.length.model(self.kind, engine);
        EstimateRequest { model, patch: self.patch, ..EstimateRequest::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn form_gives_captures_and_refuses_a_wrong_crop() {
        let mut form = CapturesForm::default();
        for path in ["/data/lensed", "/data/diffuser.npy?axis=last"] {
            form.choose(CameraPath::CaptureFolder, path.into());
        }
        form.calibration = Calibration { gain: 2.0, offset: 64.0, bin: 2 };
        form.crop = " 64x96+10+20".into();
        let captures = form.captures().unwrap();
        assert_eq!((captures.sources.len(), captures.options.calibration), (2, form.calibration));
        assert_eq!(captures.options.view.crop.map(|crop| crop.to_string()), Some("64x96+10+20".into()));
        form.choose(CameraPath::Dark, "dark".into());
        let options = form.captures().unwrap().options;
        assert_eq!(options.calibration, Calibration { gain: 2.0, offset: 0.0, bin: 2 });
        form.choose(CameraPath::CameraOfCaptures, "camera.json".into());
        let options = form.captures().unwrap().options;
        assert_eq!(options.calibration, Calibration { gain: 1.0, offset: 0.0, bin: 2 });
        let mut again = CapturesForm::default();
        again.take(&form.captures().unwrap());
        assert_eq!(again.captures(), form.captures(), "captures come back with their options");
        form.crop = "64".into();
        assert!(form.captures().unwrap_err().contains("ROWSxCOLS+TOP+LEFT"));
        assert_eq!((form.shown, form.name(0)), (1, "lensed".into()));
        form.remove(0);
        assert_eq!((form.shown, form.name(0)), (0, "diffuser.npy?axis=last".into()));
    }
}
