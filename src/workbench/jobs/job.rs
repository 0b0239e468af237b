//! Jobs that touch files: the same for window and command line.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ndarray::{Array2, Array3, ArrayD, Axis};

use crate::camera::CalibratedCamera;
use crate::evaluation::scene::{EvaluationError, Optics, Scene, SceneTables};
use crate::formats::{write_csv_text, write_png_rgb};
use crate::forward::{Design, ForwardModel};
use crate::information::Protocol;
use crate::objects::ObjectSet;
use crate::optics::{Diffuser, Encoder, ImportedPsf, PsfPhotograph, fit_lenslets, import_psf};
use crate::progress::CancelToken;
use crate::reconstruction::{DecoderScene, ImagingModel, ReconstructionError, TrainedNetwork};
use crate::studies::plans::{CSV_HEADER, CellState, Figure, StudyFolder, StudyTable, write_figure};
use crate::workbench::document::network_file::{read_network, weights_beside, write_network};
use crate::workbench::export::colormap::Colormap;
use crate::workbench::export::design_files::{self, Curve};
use crate::workbench::export::reconstruction_files;
use crate::workbench::export::stacks::{self, MEASUREMENT_STACKS, MeasurementFormat};
use crate::workbench::jobs::outcome::Outcome;
use crate::workbench::live::record::LiveRecord;
use crate::workbench::runs::IdealRecord;

/// A job that the window gives to the worker.
#[derive(Clone, Debug)]
pub enum Job {
    /// Reads a design file.
    OpenDesign {
        /// Number of the contents that it replaces.
        replaces: u64,
        /// The file.
        path: PathBuf,
    },
    /// Writes a design file.
    SaveDesign {
        /// The design at the time of the request.
        design: Arc<Design>,
        /// Number of its document.
        document: u64,
        /// Number of its contents.
        contents: u64,
        /// Its trained network, which is written beside it.
        network: Option<Arc<TrainedNetwork>>,
        /// The file.
        path: PathBuf,
    },
    /// Reads the weights of a network.
    OpenNetwork {
        /// The design and its objects, if they are open; weights that do not serve it are refused. `None` takes any.
        serves: Option<(Arc<Design>, Option<Arc<ObjectSet>>)>,
        /// Number of the document that it is for.
        document: u64,
        /// The file.
        path: PathBuf,
    },
    /// Writes the weights of a network.
    ExportNetwork {
        /// The network.
        network: Arc<TrainedNetwork>,
        /// The file.
        path: PathBuf,
    },
    /// Opens the objects of `design`, which is the open design with other objects.
    OpenObjects {
        /// The design with the new objects.
        design: Arc<Design>,
        /// Number of its document.
        document: u64,
    },
    /// Measures the first live object of a snapshot.
    MeasureSnapshot {
        /// Number of the snapshot.
        number: u64,
        /// Name of the snapshot.
        name: String,
        /// Its design.
        design: Arc<Design>,
    },
    /// Reads a PSF image, resampled to `side` pixels where that is given.
    ImportPsf {
        /// The file.
        path: PathBuf,
        /// Rows and columns to resample to.
        side: Option<usize>,
        /// Number of the document that it is for.
        document: u64,
    },
    /// Writes the settings of a PSF import.
    SavePsfSettings {
        /// The photograph with its options.
        photograph: PsfPhotograph,
        /// The file.
        path: PathBuf,
    },
    /// Makes a diffuser, which takes long on a large grid.
    MakeDiffuser {
        /// What it is made from.
        origin: DiffuserOrigin,
        /// Side of the PSF grid, pixels.
        grid_px: usize,
        /// Number of the contents that it replaces.
        replaces: u64,
    },
    /// Fits lenslets to the PSF of a mask without lenslets.
    FitLenslets {
        /// The mask.
        encoder: Encoder,
        /// Number of the contents that they replace.
        replaces: u64,
    },
    /// Writes the PSF in every format, the design and the lenslets into a folder.
    ExportDesign {
        /// The design.
        design: Arc<Design>,
        /// The folder.
        folder: PathBuf,
    },
    /// Writes objects and measurements into a folder.
    ExportMeasurements {
        /// Objects, shape (n, rows, cols), those of several planes (n, planes, rows, cols).
        objects: ArrayD<f32>,
        /// Encoded images, shape (n, rows, cols).
        noiseless: Array3<f32>,
        /// Noisy measurements, shape (n, rows, cols).
        noisy: Array3<f32>,
        /// The files to write.
        format: MeasurementFormat,
        /// The folder.
        folder: PathBuf,
    },
    /// Writes a view as a PNG, one pixel per pixel.
    ExportView {
        /// Shape (rows, cols).
        image: Array2<f32>,
        /// Values drawn in the first and the last colour.
        limits: (f32, f32),
        /// The colours.
        colormap: Colormap,
        /// The file.
        path: PathBuf,
    },
    /// Writes the reconstruction of a capture into a folder; images of shape (rows, cols, channels).
    ExportCapture {
        /// The object.
        object: Arc<Array3<f32>>,
        /// The capture.
        measurement: Arc<Array3<f32>>,
        /// The folder.
        folder: PathBuf,
    },
    /// Writes a coloured image.
    ExportImage {
        /// Shape (rows, cols, 3).
        image: Array3<u8>,
        /// The file.
        path: PathBuf,
    },
    /// Writes the record of a run.
    ExportRecord {
        /// The record.
        record: Arc<IdealRecord>,
        /// The file.
        path: PathBuf,
    },
    /// Writes the record of a live estimate.
    ExportLive {
        /// The record.
        record: Box<LiveRecord>,
        /// The file.
        path: PathBuf,
        /// Whether the record is for a command line, and not requested by itself.
        for_command: bool,
    },
    /// Writes the plot of a study.
    ExportFigure {
        /// The figure.
        figure: Arc<Figure>,
        /// The file.
        path: PathBuf,
    },
    /// Writes the table of a study as CSV.
    ExportStudyTable {
        /// Its folder.
        folder: Arc<StudyFolder>,
        /// State of each cell.
        states: Arc<Vec<CellState>>,
        /// The file.
        path: PathBuf,
    },
    /// Writes a camera file, with maps and drawing beside it.
    SaveCamera {
        /// The camera.
        camera: Arc<CalibratedCamera>,
        /// The file.
        path: PathBuf,
    },
    /// Writes a curve as CSV.
    ExportCurve {
        /// The curve.
        curve: Curve,
        /// The file.
        path: PathBuf,
    },
}

impl Job {
    /// Name of the job, for people.
    pub fn name(&self) -> String {
        match self {
            Self::OpenDesign { path, .. } | Self::OpenNetwork { path, .. } => format!("Open {}", path.display()),
            Self::SaveDesign { path, .. } | Self::SaveCamera { path, .. } => format!("Save {}", path.display()),
            Self::OpenObjects { design, .. } => format!("Read {}", design.objects),
            Self::MeasureSnapshot { name, .. } => format!("Measure {name}"),
            Self::ImportPsf { path, .. } => format!("Import {}", path.display()),
            Self::MakeDiffuser { origin, grid_px, .. } => format!("Make {}", origin.name(*grid_px)),
            Self::FitLenslets { encoder, .. } => format!("Fit lenslets to {}", encoder.describe()),
            Self::ExportDesign { folder, .. } => format!("Export design to {}", folder.display()),
            Self::ExportMeasurements { folder, .. } => format!("Export measurements to {}", folder.display()),
            Self::ExportCapture { folder, .. } => format!("Export reconstruction to {}", folder.display()),
            Self::ExportView { path, .. }
            | Self::ExportImage { path, .. }
            | Self::ExportRecord { path, .. }
            | Self::ExportLive { path, .. }
            | Self::ExportNetwork { path, .. }
            | Self::ExportFigure { path, .. }
            | Self::ExportStudyTable { path, .. }
            | Self::ExportCurve { path, .. }
            | Self::SavePsfSettings { path, .. } => {
                format!("Export {}", path.display())
            }
        }
    }

    /// Runs the job. [`Job::OpenObjects`] only checks that the objects can be opened; the worker keeps them instead.
    ///
    /// # Errors
    /// One sentence for the person who made the request.
    pub fn run(&self) -> Result<Outcome, String> {
        match self {
            Self::OpenDesign { replaces, path } => {
                let design = Box::new(Design::open(path).map_err(|error| error.to_string())?);
                Ok(Outcome::Opened { design, replaces: *replaces, path: path.clone() })
            }
            Self::SaveDesign { design, document, contents, network, path } => {
                design.save(path).map_err(|error| error.to_string())?;
                let write = |network: &Arc<TrainedNetwork>| {
                    let weights = weights_beside(path);
                    write_network(network, &weights)?;
                    Ok((Arc::clone(network), weights))
                };
                let network = network.as_ref().map(write);
                Ok(Outcome::Saved { document: *document, contents: *contents, network, path: path.clone() })
            }
            Self::OpenNetwork { serves, document, path } => {
                let network = read_network(path)?;
                if let Some((design, set)) = serves {
                    check_network(&network, design, set.clone())
                        .map_err(|error| format!("{}: {error}", path.display()))?;
                }
                Ok(Outcome::NetworkOpened { network: Arc::new(network), document: *document, path: path.clone() })
            }
            Self::ExportNetwork { network, path } => {
                write_network(network, path)?;
                Ok(Outcome::NetworkExported { network: Arc::clone(network), path: path.clone() })
            }
            Self::OpenObjects { design, document } => {
                let scene = Scene::open(design, &mut CancelToken::new()).map_err(|error| error.to_string())?;
                let notices = scene.set.notices().to_vec();
                let understood = scene.set.understood().map(Into::into);
                Ok(Outcome::ObjectsOpened { source: design.objects.clone(), document: *document, understood, notices })
            }
            Self::MeasureSnapshot { number, name, design } => {
                let scene = Scene::open(design, &mut CancelToken::new()).map_err(|error| error.to_string());
                let measurement = first_measurement(design, scene.as_ref().map_err(Clone::clone));
                Ok(Outcome::SnapshotMeasured { number: *number, name: name.clone(), measurement })
            }
            Self::ImportPsf { path, side, document } => imported_psf(path, *side, *document),
            Self::SavePsfSettings { photograph, path } => {
                photograph.save(path).map_err(|error| error.to_string())?;
                Ok(Outcome::Exported { files: vec![path.clone()] })
            }
            Self::MakeDiffuser { origin, grid_px, replaces } => {
                let (diffuser, name) = (origin.diffuser().on_grid(*grid_px), origin.name(*grid_px));
                Ok(Outcome::DiffuserMade { diffuser, name, replaces: *replaces })
            }
            Self::FitLenslets { encoder, replaces } => {
                let fitted = fit_lenslets(encoder).map_err(|error| error.to_string())?;
                Ok(Outcome::LensletsFitted { fitted, replaces: *replaces })
            }
            Self::ExportDesign { design, folder } => {
                let files = design_files::export_design(design, folder, None).map_err(|error| error.to_string())?;
                Ok(Outcome::Exported { files })
            }
            Self::ExportMeasurements { objects, noiseless, noisy, format, folder } => {
                let files = export_measurements(objects, [noiseless, noisy], *format, folder);
                Ok(Outcome::Exported { files: files? })
            }
            Self::ExportView { image, limits, colormap, path } => {
                colormap.write_png(image.view(), *limits, path).map_err(|error| error.to_string())?;
                Ok(Outcome::Exported { files: vec![path.clone()] })
            }
            Self::ExportCapture { object, measurement, folder } => {
                let files = reconstruction_files::export_capture(folder, object.view(), measurement.view());
                Ok(Outcome::Exported { files: files.map_err(|error| error.to_string())? })
            }
            Self::ExportImage { image, path } => {
                write_png_rgb(path, image.view()).map_err(|error| error.to_string())?;
                Ok(Outcome::Exported { files: vec![path.clone()] })
            }
            Self::ExportRecord { record, path } => {
                record.save(path).map_err(|error| error.to_string())?;
                Ok(Outcome::Exported { files: vec![path.clone()] })
            }
            Self::ExportLive { record, path, for_command } => {
                record.save(path).map_err(|error| error.to_string())?;
                let path = path.clone();
                Ok(if *for_command { Outcome::RecordKept { path } } else { Outcome::Exported { files: vec![path] } })
            }
            Self::ExportFigure { figure, path } => {
                write_figure(figure, path).map_err(|error| error.to_string())?;
                Ok(Outcome::Exported { files: vec![path.clone()] })
            }
            Self::ExportStudyTable { folder, states, path } => {
                let rows = StudyTable::new(folder, states).csv_rows().into_iter();
                write_csv_text(path, &CSV_HEADER, rows).map_err(|error| error.to_string())?;
                Ok(Outcome::Exported { files: vec![path.clone()] })
            }
            Self::SaveCamera { camera, path } => {
                Ok(Outcome::Exported { files: camera.write(path).map_err(|error| error.to_string())? })
            }
            Self::ExportCurve { curve, path } => {
                curve.write(path).map_err(|error| error.to_string())?;
                Ok(Outcome::Exported { files: vec![path.clone()] })
            }
        }
    }
}

/// Writes objects, noiseless and noisy measurements into a folder.
fn export_measurements(
    objects: &ArrayD<f32>,
    measured: [&Array3<f32>; 2],
    format: MeasurementFormat,
    folder: &Path,
) -> Result<Vec<PathBuf>, String> {
    let [first, second, third] = MEASUREMENT_STACKS;
    let [noiseless, noisy] = measured.map(|stack| stack.view().into_dyn());
    let stacks = [(first, objects.view()), (second, noiseless), (third, noisy)];
    stacks::export_measurements(&stacks, format, folder).map_err(|error| error.to_string())
}

/// What a diffuser is made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DiffuserOrigin {
    /// An aperture on the published grid, which blocks the light outside.
    Aperture {
        /// Side of the aperture, pixels.
        aperture_px: usize,
        /// Seed of the surface.
        seed: u64,
    },
    /// A diffuser of another PSF grid.
    OtherGrid(Diffuser),
}

impl DiffuserOrigin {
    fn diffuser(self) -> Diffuser {
        match self {
            Self::Aperture { aperture_px, seed } => Diffuser::behind_aperture(aperture_px, seed),
            Self::OtherGrid(diffuser) => diffuser,
        }
    }

    /// Name of the diffuser on a grid of this side, pixels.
    fn name(self, grid_px: usize) -> String {
        match self {
            Self::Aperture { aperture_px, .. } => format!("diffuser, aperture {aperture_px} px"),
            Self::OtherGrid(_) => format!("diffuser on a grid of {grid_px} px"),
        }
    }
}

/// Refuses a network of other objects or of another mask than those of a design.
fn check_network(
    network: &TrainedNetwork,
    design: &Design,
    set: Option<Arc<ObjectSet>>,
) -> Result<(), ReconstructionError> {
    let forward = match set {
        Some(set) => ForwardModel::of_objects(design, set)?,
        None => ForwardModel::open(design)?,
    };
    network.training.check_scene(&DecoderScene::new(&forward, Protocol::Default)?)?;
    network.training.check_mask(&ImagingModel::of_design(design, &forward)?)
}

/// The mask of a PSF image.
fn imported_psf(path: &Path, side: Option<usize>, document: u64) -> Result<Outcome, String> {
    let ImportedPsf { image, summary, report } = import_psf(path, side).map_err(|error| error.to_string())?;
    let (understood, notices) = (summary.to_string(), report.sentences());
    Ok(Outcome::PsfImported { encoder: Encoder::Image(image), understood, notices, document })
}

/// The first live measurement of a design, with noise, as the window shows it.
///
/// # Errors
/// One sentence where there are no objects, or they cannot be measured.
pub(crate) fn first_measurement(design: &Design, scene: Result<&Scene, String>) -> Result<Array2<f32>, String> {
    let measure = |scene: &Scene| {
        let optics = Optics::of(design, scene.set.planes())?;
        let measured = SceneTables::new(scene, design.encoder.grid())?.measure(design, &optics, scene)?;
        Ok::<_, EvaluationError>(measured.noisy.index_axis_move(Axis(0), 0))
    };
    scene.and_then(|scene| measure(scene).map_err(|error| error.to_string()))
}
