//! Optics of the mask: lenslets, point spread functions and their gradients, transfer functions.

mod diffuser;
mod encoder;
mod import;
mod layouts;
mod lenslet_fit;
mod lenslets;
mod mtf;
mod psf;
mod throughput;

pub use diffuser::{DIFFUSER_APERTURES, Diffuser};
pub(crate) use encoder::MASK_DOCUMENT_VERSION;
pub use encoder::{Encoder, PhotographQuality, PsfImage};
pub use import::{
    BlackLevel, CornerLevel, ImportedPsf, NegativePixels, PhotographPixels, PixelRectangle, PsfDark, PsfError,
    PsfImportOptions, PsfImportReport, PsfOptionsIn, PsfPhotograph, PsfScale, PsfWindow, import_psf, normalised_psf,
    psf_file,
};
pub use layouts::{HEURISTIC_CENTRES, HEURISTIC_SIGMA, depth_layout, heuristic_layout, random_layout};
pub use lenslet_fit::{FittedLenslets, LensletFitError, fit_lenslets};
pub use lenslets::{Lenslet, LensletArray, LensletError, Limits, Spot};
pub use mtf::{Mtf, modulation_transfer};
pub use psf::{LensletGradient, psf_gradient, render_psf};
pub use throughput::LEAST_THROUGHPUT;
