//! A design, which holds all settings that its numbers depend on, and its JSON file.

use std::fmt;
use std::path::Path;

use ndarray::{Array3, Axis};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::formats::{CompleteFile, DocumentKind, FormatError, Mismatch, read_json};
use crate::objects::{ObjectOptions, ObjectSource, Placement};
use crate::optics::{
    Diffuser, Encoder, Lenslet, LensletArray, LensletError, Limits, MASK_DOCUMENT_VERSION, heuristic_layout,
};
use crate::sensor::{DEFAULT_BIAS, Noise};

/// A design: mask, objects, sensor, and the seed of every random draw.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let design = Design { encoder: Encoder::Lenslets(heuristic_layout(3)), ..Design::default() };
/// assert_eq!(design.psf(1)?.dim(), (1, 32, 32));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Design {
    /// The mask.
    pub encoder: Encoder,
    /// The objects.
    pub objects: ObjectSource,
    /// Mean of the objects in photons per pixel, where their source does not set it.
    pub mean_photons: f64,
    /// Background light in photons per pixel.
    pub bias_photons: f64,
    /// Noise of the sensor.
    pub noise: Noise,
    /// Seed of objects, noise and patches.
    pub seed: u64,
    /// Manufacturing limits.
    #[serde(default)]
    pub limits: Limits,
    /// Rows and columns of the objects in pixels, 1 to 1024; 96 x 96 where absent. Objects of `stack:` keep their own.
    #[serde(default = "published_field", skip_serializing_if = "is_published_field")]
    pub field: (usize, usize),
    /// How whole images of `images:` get the size of the field; scaled where absent.
    #[serde(default, skip_serializing_if = "is_usual_placement")]
    pub placement: Placement,
    /// Pitch of the sensor's pixels in micrometres, 0.01 to 1000, for physical scales. No number of bits depends on it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_pitch_um: Option<f64>,
}

pub(crate) fn published_field() -> (usize, usize) {
    ObjectOptions::default().field
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
pub(crate) fn is_published_field(field: &(usize, usize)) -> bool {
    *field == published_field()
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
pub(crate) fn is_usual_placement(placement: &Placement) -> bool {
    *placement == Placement::default()
}

impl fmt::Debug for Design {
    /// Keys of earlier programs are made from this format, which knew no sizes: those of their own are left out.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { encoder, objects, mean_photons, bias_photons, noise, seed, limits, .. } = self;
        let Self { field, placement, pixel_pitch_um, .. } = self;
        let mut shown = formatter.debug_struct("Design");
        shown.field("encoder", encoder).field("objects", objects).field("mean_photons", mean_photons);
        shown.field("bias_photons", bias_photons).field("noise", noise).field("seed", seed).field("limits", limits);
        if !is_published_field(field) {
            shown.field("field", field);
        }
        if !is_usual_placement(placement) {
            shown.field("placement", placement);
        }
        if let Some(pitch) = pixel_pitch_um {
            shown.field("pixel_pitch_um", pitch);
        }
        shown.finish()
    }
}

impl Default for Design {
    /// Nine heuristic lenslets imaging beads of density 0.02 under shot noise: the published setting.
    fn default() -> Self {
        Self {
            encoder: Encoder::Lenslets(heuristic_layout(9)),
            objects: ObjectSource::Beads { density: 0.02 },
            mean_photons: 100.0,
            bias_photons: DEFAULT_BIAS,
            noise: Noise::Shot,
            seed: 1,
            limits: Limits::default(),
            field: published_field(),
            placement: Placement::default(),
            pixel_pitch_um: None,
        }
    }
}

/// Reason why a design cannot be computed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum DesignError {
    /// The mask cannot be rendered.
    #[error(transparent)]
    Lenslets(#[from] LensletError),
    /// A number is out of its range.
    #[error("{name} is {found:?}; expected {expected}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// Its value.
        found: f64,
        /// The allowed values.
        expected: &'static str,
    },
    /// A side of the field or of a diffuser's grid is out of its range.
    #[error("{name} is {found} px; expected {least} to {most} px")]
    Side {
        /// The setting.
        name: &'static str,
        /// Its value in pixels.
        found: usize,
        /// Smallest allowed value.
        least: usize,
        /// Largest allowed value.
        most: usize,
    },
    /// The objects are smaller than the PSF, so no pixel of the sensor has its full light.
    #[error(
        "the field of the objects is {} x {} px; expected at least the {} x {} px of the PSF grid; enlarge the field or take \
         a smaller grid",
        .field.0, .field.1, .grid.0, .grid.1
    )]
    Field {
        /// Rows and columns of the objects.
        field: (usize, usize),
        /// Rows and columns of the PSF grid.
        grid: (usize, usize),
    },
}

impl Design {
    /// Largest mean or background in photons per pixel.
    pub const MAX_PHOTONS: f64 = 1e7;
    /// Range of the pixel pitch in micrometres.
    pub const PIXEL_PITCHES: std::ops::RangeInclusive<f64> = 0.01..=1000.0;

    /// The design whose measurements give an upper bound on the information of this one by a density model; see
    /// [`Noise::bounding`].
    #[must_use]
    pub fn bounding(&self) -> Self {
        Self { noise: self.noise.bounding(), ..self.clone() }
    }

    /// Largest side of the objects in pixels.
    pub const MAX_FIELD: usize = LensletArray::MAX_SIDE;

    /// How the objects of this design are made from their source.
    pub fn object_options(&self) -> ObjectOptions {
        ObjectOptions { field: self.field, mean_photons: self.mean_photons, placement: self.placement }
    }

    /// Whether another design images the same objects.
    pub fn has_objects_of(&self, other: &Self) -> bool {
        self.objects == other.objects && self.object_options() == other.object_options() && self.seed == other.seed
    }

    /// The design with room for its mask: where the field is smaller than the PSF grid, it becomes three times as large as the grid, the
    /// published ratio, up to the largest field.
    #[must_use]
    pub fn with_room(mut self) -> Self {
        let grid = self.encoder.grid();
        if !self.has_room() {
            let side = |field: usize, grid: usize| field.max((3 * grid).min(Self::MAX_FIELD));
            self.field = (side(self.field.0, grid.0), side(self.field.1, grid.1));
        }
        self
    }

    /// Whether the objects are at least as large as the PSF. A stack has a field of its own, which is known once it is read.
    fn has_room(&self) -> bool {
        let (field, grid) = (self.field, self.encoder.grid());
        matches!(self.objects, ObjectSource::Stack(_)) || (field.0 >= grid.0 && field.1 >= grid.1)
    }

    /// Checks that this design can be computed.
    ///
    /// # Errors
    /// [`DesignError`] names the first invalid setting.
    pub fn check(&self) -> Result<(), DesignError> {
        self.check_entries()?;
        if self.has_room() { Ok(()) } else { Err(DesignError::Field { field: self.field, grid: self.encoder.grid() }) }
    }

    /// Checks each entry alone. Earlier programs saved designs whose field is too small, and these still open.
    pub(crate) fn check_entries(&self) -> Result<(), DesignError> {
        self.encoder.check()?;
        let side = |name, found: usize, least, most| {
            let is_allowed = (least..=most).contains(&found);
            if is_allowed { Ok(()) } else { Err(DesignError::Side { name, found, least, most }) }
        };
        if let Encoder::Diffuser(Diffuser { aperture_px, grid_px, .. }) = self.encoder {
            side("grid_px", grid_px, *Diffuser::GRIDS.start(), *Diffuser::GRIDS.end())?;
            side("aperture_px", aperture_px, 1, grid_px)?;
        }
        side("field rows", self.field.0, 1, Self::MAX_FIELD)?;
        side("field columns", self.field.1, 1, Self::MAX_FIELD)?;
        if let Some(found) = self.pixel_pitch_um.filter(|pitch| !Self::PIXEL_PITCHES.contains(pitch)) {
            let expected = "0.01 to 1000 micrometres";
            return Err(DesignError::Setting { name: "pixel_pitch_um", found, expected });
        }
        if !(self.mean_photons > 0.0 && self.mean_photons <= Self::MAX_PHOTONS) {
            let expected = "more than 0 and at most 1e7 photons per pixel";
            return Err(DesignError::Setting { name: "mean_photons", found: self.mean_photons, expected });
        }
        if !(self.bias_photons >= 0.0 && self.bias_photons <= Self::MAX_PHOTONS) {
            let expected = "0 to 1e7 photons per pixel";
            return Err(DesignError::Setting { name: "bias_photons", found: self.bias_photons, expected });
        }
        if !(self.limits.min_sigma_px >= 0.1 && self.limits.min_sigma_px <= 1000.0) {
            let expected = "0.1 to 1000 pixels";
            return Err(DesignError::Setting { name: "min_sigma_px", found: self.limits.min_sigma_px, expected });
        }
        if !(self.limits.central_share > 0.0 && self.limits.central_share <= 1.0) {
            let expected = "more than 0 and at most 1";
            return Err(DesignError::Setting { name: "central_share", found: self.limits.central_share, expected });
        }
        Ok(())
    }

    /// Approximate memory of this design, bytes.
    pub fn size_in_memory(&self) -> usize {
        let mask = match &self.encoder {
            Encoder::Lenslets(array) => std::mem::size_of_val(array.lenslets.as_slice()),
            Encoder::Diffuser(_) => 0,
            Encoder::Image(image) => 4 * image.psf.len(),
        };
        size_of::<Self>() + mask
    }

    /// Reads a design file.
    ///
    /// # Errors
    /// [`DesignFileError`] describes the contents of any other file.
    pub fn open(path: &Path) -> Result<Self, DesignFileError> {
        Self::from_value(read_json(path)?, &path.display().to_string())
    }

    /// The design in the contents of a design file; errors name `path`.
    ///
    /// # Errors
    /// [`DesignFileError`] describes any other contents.
    pub fn from_value(value: serde_json::Value, path: &str) -> Result<Self, DesignFileError> {
        let refuse =
            |found: String, advice: &'static str| DesignFileError::Refused { path: path.to_owned(), found, advice };
        DESIGN.version_of(&value).map_err(|mismatch| {
            let advice = match mismatch {
                Mismatch::OtherKind(_) => "choose a file saved as a design",
                _ => mismatch.advice(),
            };
            refuse(mismatch.to_string(), advice)
        })?;
        // The mask is parsed as a whole, so its error would not name the wrong lenslet.
        if let Some(found) = wrong_lenslet(&value) {
            return Err(refuse(found, "correct the entry or restore the file from a backup"));
        }
        // The error begins with the name of its entry.
        let design: Self = serde_path_to_error::deserialize(value)
            .map_err(|error| refuse(error.to_string(), "correct the entry or restore the file from a backup"))?;
        design.check_entries().map_err(|error| refuse(error.to_string(), "correct the entry"))?;
        Ok(design)
    }

    /// Writes a design file. It includes the rendered PSF for other programs where that is of moderate size. Writing
    /// is safe: the file is either the complete old one or the complete new one.
    ///
    /// # Errors
    /// [`DesignFileError`] where the design cannot be rendered or the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), DesignFileError> {
        Ok(self.complete_file(path)?.put_in_place()?)
    }

    /// As [`Design::save`], but returns the complete file before it gets its name.
    ///
    /// # Errors
    /// As [`Design::save`].
    pub fn complete_file(&self, path: &Path) -> Result<CompleteFile, DesignFileError> {
        let psf = self.psf(1)?;
        let written = (psf.len() <= MOST_PSF_NUMBERS).then(|| rows_of(&psf));
        Ok(self.kind().complete(path, &DesignFile { design: self, psf: written })?)
    }

    /// The text of a design file on one line, without the PSF.
    ///
    /// # Errors
    /// [`DesignFileError`] where the design cannot be computed.
    pub fn to_json(&self) -> Result<String, DesignFileError> {
        self.check()?;
        serde_json::to_string(&self.kind().marked(&DesignFile { design: self, psf: None })).map_err(|error| {
            DesignFileError::Refused {
                path: "the design".into(),
                found: error.to_string(),
                advice: "correct the entry",
            }
        })
    }

    /// Version of a document that holds this design: that of its mask, or 3 where the objects have other sizes than those of earlier
    /// programs.
    pub(crate) fn document_version(&self) -> u64 {
        if is_published_field(&self.field) && is_usual_placement(&self.placement) {
            self.encoder.document_version()
        } else {
            MASK_DOCUMENT_VERSION
        }
    }

    /// The kind of its file, in the version that is written.
    fn kind(&self) -> DocumentKind {
        DESIGN.at_version(self.document_version())
    }

    /// The PSF, shape (planes, rows, cols), over at least `planes` planes and all focal planes of the lenslets.
    ///
    /// # Errors
    /// [`DesignError`] where the mask cannot be rendered.
    pub fn psf(&self, planes: usize) -> Result<Array3<f64>, DesignError> {
        let planes = planes.max(self.encoder.lenslets().map_or(1, crate::optics::LensletArray::planes));
        Ok(self.encoder.psf(planes)?)
    }
}

/// Description of the first entry of a design file that is not a lenslet or has two shapes.
fn wrong_lenslet(design: &serde_json::Value) -> Option<String> {
    let lenslets = design.get("encoder")?.get("lenslets")?.as_array()?;
    lenslets.iter().zip(1..).find_map(|(lenslet, number)| {
        let is_twofold = ["sigma_px", "covariance_px2"].iter().all(|shape| lenslet.get(shape).is_some());
        let reason = match Lenslet::deserialize(lenslet) {
            Err(error) => error.to_string(),
            Ok(_) if is_twofold => "both sigma_px and covariance_px2, of which it has one".to_owned(),
            Ok(_) => return None,
        };
        Some(format!("lenslet {number}: {reason}"))
    })
}

/// The kind of the file.
const DESIGN: DocumentKind = DocumentKind::new("lenslet-studio/design", "a design").at_version(MASK_DOCUMENT_VERSION);
/// Largest number of PSF values in a design file.
const MOST_PSF_NUMBERS: usize = 1 << 20;

/// Contents of a design file. The PSF is for other programs: opening renders it from the encoder.
#[derive(Serialize)]
struct DesignFile<'a> {
    #[serde(flatten)]
    design: &'a Design,
    #[serde(skip_serializing_if = "Option::is_none")]
    psf: Option<Vec<Vec<Vec<f64>>>>,
}

fn rows_of(psf: &Array3<f64>) -> Vec<Vec<Vec<f64>>> {
    psf.axis_iter(Axis(0)).map(|plane| plane.rows().into_iter().map(|row| row.to_vec()).collect()).collect()
}

/// Reason why a design file was not read or written.
#[derive(Debug, Error)]
pub enum DesignFileError {
    /// The file cannot be read, parsed or written.
    #[error(transparent)]
    File(#[from] FormatError),
    /// The design in memory cannot be saved.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// The file is JSON, but not a design that this version knows.
    #[error("{path}: expected a Lenslet Studio design of version 1 to 3, found {found}; {advice}")]
    Refused {
        /// The file.
        path: String,
        /// The contents found.
        found: String,
        /// The advice to the user.
        advice: &'static str,
    },
}
