//! Optical encoders: editable lenslets, a diffuser, or an imported PSF.

use std::fmt;
use std::ops::RangeInclusive;

use ndarray::{Array2, Array3, Axis};
use serde::{Deserialize, Serialize};

use super::diffuser::Diffuser;
use super::import::{PsfError, normalised_psf};
use super::lenslets::{LensletArray, LensletError};
use super::psf::render_psf;
use super::throughput::{OF_APERTURES, OF_LENSLETS, finish_debug, is_unit, unit};

use crate::plural::counted;

/// Newest version of documents that hold masks or designs. Programs that know an earlier version alone would ignore what it lacks and
/// compute other numbers.
pub(crate) const MASK_DOCUMENT_VERSION: u64 = 3;

/// An optical encoder of scenes.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let encoder = Encoder::Lenslets(heuristic_layout(4));
/// let psf = encoder.psf(1)?;
/// assert_eq!(psf.dim(), (1, 32, 32));
/// assert!((psf.sum() - 1.0).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Encoder {
    /// An array of lenslets.
    Lenslets(LensletArray),
    /// A synthetic diffuser.
    Diffuser(Diffuser),
    /// An imported PSF.
    Image(PsfImage),
}

/// An imported PSF with its origin.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(try_from = "PsfImageRecord", into = "PsfImageRecord")]
pub struct PsfImage {
    /// The kernel, shape (rows, cols), not negative, sum 1.
    pub psf: Array2<f32>,
    /// Sum of the PSF, more than 0 and at most 1.
    pub throughput: f64,
    /// File name, or another name.
    pub origin: String,
    /// Quality of the photograph that it was made of, if it was.
    pub photograph: Option<PhotographQuality>,
}

/// Quality of the photograph of a PSF.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct PhotographQuality {
    /// MTF below which there is noise alone; 0 where it is not known.
    pub noise_floor: f64,
    /// Share of saturated pixels.
    pub saturated_share: f64,
}

impl fmt::Debug for PsfImage {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Saved work is found by this format, which knew no photographs.
        let Self { psf, origin, throughput, photograph: _ } = self;
        let mut shown = formatter.debug_struct("PsfImage");
        finish_debug(shown.field("psf", psf).field("origin", origin), *throughput)
    }
}

impl Encoder {
    /// Checks that the encoder can be rendered and that its throughput is in its range. An image was checked when it was
    /// made.
    ///
    /// # Errors
    /// [`LensletError`] names what is wrong.
    pub fn check(&self) -> Result<(), LensletError> {
        let (found, allowed) = (self.throughput(), self.throughputs());
        match self {
            Self::Lenslets(array) => array.check(),
            _ if allowed.contains(&found) => Ok(()),
            _ => Err(LensletError::Throughput { found, most: *allowed.end() }),
        }
    }

    /// Range of the throughput of this kind of encoder.
    pub fn throughputs(&self) -> RangeInclusive<f64> {
        match self {
            Self::Lenslets(_) => OF_LENSLETS,
            Self::Diffuser(_) | Self::Image(_) => OF_APERTURES,
        }
    }

    /// PSF for scenes of `planes` depth planes, shape (planes, rows, cols). It sums to the throughput over all planes of the
    /// encoder. Diffusers and images focus on the first plane only.
    ///
    /// # Errors
    /// [`LensletError`] where a lenslet array cannot be rendered.
    pub fn psf(&self, planes: usize) -> Result<Array3<f64>, LensletError> {
        let on_first_plane = |image: Array2<f64>| {
            let (rows, cols) = image.dim();
            let mut psf = Array3::zeros((planes, rows, cols));
            psf.index_axis_mut(Axis(0), 0).assign(&image);
            psf
        };
        match self {
            Self::Lenslets(array) => render_psf(array, planes),
            Self::Diffuser(diffuser) => Ok(on_first_plane(diffuser.render())),
            Self::Image(image) => Ok(on_first_plane(image.psf.map(|&value| f64::from(value) * image.throughput))),
        }
    }

    /// Rows and columns of the PSF grid in pixels.
    pub fn grid(&self) -> (usize, usize) {
        match self {
            Self::Lenslets(array) => (array.rows, array.cols),
            Self::Diffuser(diffuser) => (diffuser.grid_px, diffuser.grid_px),
            Self::Image(image) => image.psf.dim(),
        }
    }

    /// The encoder over a grid of `rows` x `cols` pixels: positions and apertures keep their share of the grid, widths stay in pixels.
    /// The grid of a diffuser is square, of the shorter side. None for an image of another shape, whose pixels are given.
    #[must_use]
    pub fn on_grid(self, rows: usize, cols: usize) -> Option<Self> {
        match self {
            Self::Lenslets(array) => Some(Self::Lenslets(array.on_grid(rows, cols))),
            Self::Diffuser(diffuser) => Some(Self::Diffuser(diffuser.on_grid(rows.min(cols)))),
            Self::Image(image) => (image.psf.dim() == (rows, cols)).then_some(Self::Image(image)),
        }
    }

    /// Throughput: the sum of the PSF over all planes of the encoder.
    pub fn throughput(&self) -> f64 {
        match self {
            Self::Lenslets(array) => array.throughput,
            Self::Diffuser(diffuser) => diffuser.throughput,
            Self::Image(image) => image.throughput,
        }
    }

    /// Version of a document that holds this mask: 1 where earlier programs compute the same with it, 2 for a throughput other than 1,
    /// 3 for a diffuser on another grid.
    pub(crate) fn document_version(&self) -> u64 {
        match self {
            Self::Diffuser(diffuser) if diffuser.grid_px != Diffuser::GRID => MASK_DOCUMENT_VERSION,
            _ if self.throughput_unless_unit().is_some() => 2,
            _ => 1,
        }
    }

    /// The throughput where it is not 1.
    pub fn throughput_unless_unit(&self) -> Option<f64> {
        Some(self.throughput()).filter(|throughput| !is_unit(throughput))
    }

    /// The encoder with another throughput.
    #[must_use]
    pub fn with_throughput(mut self, throughput: f64) -> Self {
        self.set_throughput(throughput);
        self
    }

    /// Changes the throughput.
    pub fn set_throughput(&mut self, throughput: f64) {
        match self {
            Self::Lenslets(array) => array.throughput = throughput,
            Self::Diffuser(diffuser) => diffuser.throughput = throughput,
            Self::Image(image) => image.throughput = throughput,
        }
    }

    /// The lenslets, if the encoder has any.
    pub fn lenslets(&self) -> Option<&LensletArray> {
        match self {
            Self::Lenslets(array) => Some(array),
            Self::Diffuser(_) | Self::Image(_) => None,
        }
    }

    /// Quality of the photograph that the PSF was made of, if it was.
    pub fn photograph(&self) -> Option<PhotographQuality> {
        match self {
            Self::Image(image) => image.photograph,
            Self::Lenslets(_) | Self::Diffuser(_) => None,
        }
    }

    /// Description in one line, with the throughput where it is not 1.
    pub fn describe(&self) -> String {
        let mask = self.describe_mask();
        match self.throughput_unless_unit() {
            Some(throughput) => format!("{mask}, throughput {}", rounded(throughput)),
            None => mask,
        }
    }

    fn describe_mask(&self) -> String {
        match self {
            Self::Lenslets(array) => counted(array.lenslets.len(), "lenslet"),
            Self::Diffuser(diffuser) => {
                format!("diffuser, aperture {} px, seed {}", diffuser.aperture_px, diffuser.seed)
            }
            Self::Image(image) => format!("PSF image {}", image.origin),
        }
    }
}

/// A throughput rounded to three significant digits.
fn rounded(throughput: f64) -> f64 {
    let scale = 10_f64.powf(2.0 - throughput.log10().floor());
    (throughput * scale).round() / scale
}

/// JSON form of a PSF image: rows of numbers.
#[derive(Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct PsfImageRecord {
    /// File name, or another name.
    origin: String,
    /// Rows of numbers, not negative. Opening scales them to sum 1.
    psf: Vec<Vec<f32>>,
    /// Sum of the PSF after this scaling, more than 0 and at most 1; 1 where absent.
    #[serde(default = "unit", skip_serializing_if = "is_unit")]
    throughput: f64,
    /// Quality of the photograph that it was made of, if it was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    photograph: Option<PhotographQuality>,
}

impl From<PsfImage> for PsfImageRecord {
    fn from(image: PsfImage) -> Self {
        let psf = image.psf.rows().into_iter().map(|row| row.to_vec()).collect();
        Self { origin: image.origin, psf, throughput: image.throughput, photograph: image.photograph }
    }
}

impl TryFrom<PsfImageRecord> for PsfImage {
    type Error = String;

    fn try_from(record: PsfImageRecord) -> Result<Self, String> {
        let rows = record.psf.len();
        let cols = record.psf.first().map_or(0, Vec::len);
        if record.psf.iter().any(|row| row.len() != cols) {
            return Err(format!("the PSF of {} has rows of different lengths", record.origin));
        }
        let values = record.psf.into_iter().flatten().collect();
        let image = Array2::from_shape_vec((rows, cols), values).map_err(|error| error.to_string())?;
        let psf = normalised_psf(image, &record.origin).map_err(|error: PsfError| error.to_string())?;
        let PsfImageRecord { origin, throughput, photograph, .. } = record;
        Ok(Self { psf, throughput, origin, photograph })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::heuristic_layout;

    #[test]
    fn every_encoder_returns_from_json_as_it_went() {
        let image = Array2::from_shape_fn((5, 7), |(row, col)| (row * 7 + col) as f32 / 3.0);
        let psf = normalised_psf(image, "x").unwrap();
        let photograph = Some(PhotographQuality { noise_floor: 0.01, saturated_share: 0.0 });
        for encoder in [
            Encoder::Lenslets(heuristic_layout(9)),
            Encoder::Diffuser(Diffuser::with_light_kept(16, 3)),
            Encoder::Image(PsfImage { psf, origin: "camera.tiff".into(), throughput: 1.0, photograph }),
        ] {
            for throughput in [1.0, 0.3] {
                let encoder = encoder.clone().with_throughput(throughput);
                let text = serde_json::to_string_pretty(&encoder).unwrap();
                let back: Encoder = serde_json::from_str(&text).unwrap();
                assert_eq!(back, encoder);
                assert_eq!(back.psf(2).unwrap(), encoder.psf(2).unwrap());
                assert!((encoder.psf(1).unwrap().sum() - throughput).abs() < 1e-6);
                assert_eq!(text.contains("throughput"), throughput < 1.0, "{text}");
                assert_eq!(encoder.describe().ends_with(", throughput 0.3"), throughput < 1.0);
            }
        }
    }

    #[test]
    fn throughputs_out_of_range_are_refused_with_the_range_of_the_mask() {
        let lenslets = Encoder::Lenslets(heuristic_layout(2));
        let diffuser = Encoder::Diffuser(Diffuser::with_light_kept(16, 3));
        let refusal = |encoder: &Encoder, throughput: f64| {
            encoder.clone().with_throughput(throughput).check().map_err(|error| error.to_string())
        };
        for (encoder, most) in [(&lenslets, 64.0), (&diffuser, 1.0)] {
            assert_eq!((refusal(encoder, most), refusal(encoder, 1e-6)), (Ok(()), Ok(())));
            for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY, 1.001 * most, 1e-7] {
                let expected = format!("the throughput is {wrong:?}; expected 0.000001 to {most}");
                assert_eq!(refusal(encoder, wrong), Err(expected));
            }
        }
    }

    /// Earlier programs knew no throughput, and made keys of states from the debug format of masks.
    #[test]
    fn debug_format_has_a_throughput_only_where_it_is_not_1() {
        let diffuser = Diffuser::with_light_kept(16, 3);
        assert_eq!(format!("{diffuser:?}"), "Diffuser { aperture_px: 16, seed: 3 }");
        assert_eq!(
            format!("{:?}", Diffuser { throughput: 0.5, ..diffuser }),
            "Diffuser { aperture_px: 16, seed: 3, throughput: 0.5 }"
        );
        let psf = Array2::ones((1, 1));
        let image = PsfImage { psf, origin: "a".into(), throughput: 1.0, photograph: None };
        assert!(format!("{image:?}").ends_with("origin: \"a\" }"), "{image:?}");
        let array = LensletArray::new(3, 4, Vec::new());
        assert_eq!(format!("{array:?}"), "LensletArray { rows: 3, cols: 4, lenslets: [] }");
    }

    #[test]
    fn a_ragged_image_is_refused() {
        let text = r#"{"kind":"image","origin":"x","psf":[[1,2],[3]]}"#;
        let error = serde_json::from_str::<Encoder>(text).unwrap_err().to_string();
        assert!(error.contains("rows of different lengths"), "{error}");
    }
}
