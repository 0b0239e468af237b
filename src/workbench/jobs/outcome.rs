//! Outcomes of jobs.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ndarray::Array2;

use crate::forward::Design;
use crate::objects::ObjectSource;
use crate::optics::{Diffuser, Encoder, FittedLenslets};
use crate::plural::counted;
use crate::reconstruction::TrainedNetwork;

/// Outcome of a job.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// A design file was read.
    Opened {
        /// The design in the file.
        design: Box<Design>,
        /// Number of the contents that it replaces.
        replaces: u64,
        /// The file.
        path: PathBuf,
    },
    /// A design file was written.
    Saved {
        /// Number of the document that was open at the request.
        document: u64,
        /// Number of the contents that were written.
        contents: u64,
        /// The trained network with its file, or the reason why it was not written.
        network: Option<Result<(Arc<TrainedNetwork>, PathBuf), String>>,
        /// The file.
        path: PathBuf,
    },
    /// The weights of a network were read.
    NetworkOpened {
        /// The network.
        network: Arc<TrainedNetwork>,
        /// Number of the document that was open at the request.
        document: u64,
        /// The file.
        path: PathBuf,
    },
    /// The weights of a network were written.
    NetworkExported {
        /// The network.
        network: Arc<TrainedNetwork>,
        /// The file.
        path: PathBuf,
    },
    /// Objects were opened and can be used.
    ObjectsOpened {
        /// Their source.
        source: ObjectSource,
        /// Number of the document that was open at the request.
        document: u64,
        /// Summary of its files; none of beads.
        understood: Option<String>,
        /// Notices on the files.
        notices: Vec<String>,
    },
    /// A snapshot was measured.
    SnapshotMeasured {
        /// Number of the snapshot.
        number: u64,
        /// Name of the snapshot.
        name: String,
        /// Its measurement with noise, photons per pixel, shape (rows, cols); or the reason why there is none.
        measurement: Result<Array2<f32>, String>,
    },
    /// The record of a live estimate was written, for a command line.
    RecordKept {
        /// The file.
        path: PathBuf,
    },
    /// A PSF image was read.
    PsfImported {
        /// The encoder made from it.
        encoder: Encoder,
        /// Summary of the file.
        understood: String,
        /// Sentences about the import.
        notices: Vec<String>,
        /// Number of the document that was open at the request.
        document: u64,
    },
    /// A diffuser was made.
    DiffuserMade {
        /// The diffuser.
        diffuser: Diffuser,
        /// Its name.
        name: String,
        /// Number of the contents that it replaces.
        replaces: u64,
    },
    /// Lenslets were fitted to a PSF.
    LensletsFitted {
        /// The lenslets, and the quality of the fit.
        fitted: FittedLenslets,
        /// Number of the contents that they replace.
        replaces: u64,
    },
    /// Files were written.
    Exported {
        /// The files.
        files: Vec<PathBuf>,
    },
}

impl Outcome {
    /// Whether a person requested it for this particular design or file.
    pub fn is_asked_for(&self) -> bool {
        !matches!(self, Self::SnapshotMeasured { .. } | Self::RecordKept { .. })
    }

    /// Sentences about the file, for people.
    pub fn notices(&self) -> &[String] {
        match self {
            Self::ObjectsOpened { notices, .. } | Self::PsfImported { notices, .. } => notices,
            _ => &[],
        }
    }

    /// Report of the outcome, for people.
    pub fn sentence(&self) -> String {
        match self {
            Self::Opened { path, .. } => format!("Opened {}", path.display()),
            Self::Saved { path, network: Some(Ok((_, weights))), .. } => {
                format!("Saved {} and its network {}", path.display(), weights.display())
            }
            Self::Saved { path, .. } => format!("Saved {}", path.display()),
            Self::NetworkOpened { network, path, .. } => format!("Opened {}: {}", path.display(), network.summary()),
            Self::NetworkExported { path, .. } => format!("Exported {}", path.display()),
            Self::ObjectsOpened { source, understood: Some(understood), .. } => {
                format!("Opened {source}: {understood}")
            }
            Self::ObjectsOpened { source, .. } => format!("Opened {source}"),
            Self::SnapshotMeasured { name, measurement: Ok(_), .. } => format!("Measured {name}"),
            Self::SnapshotMeasured { name, .. } => format!("{name} was not measured"),
            Self::RecordKept { path } => format!("The record for the command line is {}", path.display()),
            Self::DiffuserMade { name, .. } => format!("Using {name}"),
            Self::LensletsFitted { fitted, .. } => fitted.summary(),
            Self::PsfImported { encoder, understood, .. } => format!("Using {}: {understood}", encoder.describe()),
            Self::Exported { files } => match files.as_slice() {
                [file] => format!("Exported {}", file.display()),
                files => {
                    let folder = files.first().and_then(|file| file.parent()).unwrap_or(Path::new("."));
                    format!("Exported {} to {}", counted(files.len(), "file"), folder.display())
                }
            },
        }
    }
}
