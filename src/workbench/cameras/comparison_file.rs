//! File of the newest comparison of systems, which outlives the window.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::evaluation::Compared;
use crate::formats::{DocumentKind, FormatError};
use crate::information::NUMBERS_VERSION;
use crate::workbench::cameras::comparison::{ComparisonOrder, ComparisonResults};

const KEPT: DocumentKind = DocumentKind::new("lenslet-studio/kept-comparison", "a stored comparison of systems");

/// A comparison, as the file holds it.
#[derive(Serialize, Deserialize)]
struct Kept {
    program_version: String,
    order: ComparisonOrder,
    own: KeptLight,
    equal: Option<KeptLight>,
}

/// The systems at one light. The JSON of the command line has no means.
#[derive(Serialize, Deserialize)]
struct KeptLight {
    compared: Compared,
    /// Mean of the images of each system, electrons or photons per (binned) pixel.
    means: Vec<f64>,
}

impl From<&Compared> for KeptLight {
    fn from(compared: &Compared) -> Self {
        Self { compared: compared.clone(), means: compared.means.clone() }
    }
}

impl From<KeptLight> for Compared {
    fn from(KeptLight { compared, means }: KeptLight) -> Self {
        Self { means, ..compared }
    }
}

/// Writes a comparison in place of an earlier one, with absolute paths for a program that is started in another folder.
///
/// # Errors
/// Where the file cannot be written, or a newer version of the program wrote it.
pub(super) fn write(file: &Path, results: &ComparisonResults) -> Result<(), FormatError> {
    if KEPT.is_newer(file) {
        return read(file).map(drop);
    }
    let ComparisonResults { order, own, equal, .. } = results;
    let captures = order.captures.absolute().into();
    let kept = Kept {
        program_version: NUMBERS_VERSION.into(),
        order: ComparisonOrder { captures, ..order.clone() },
        own: own.into(),
        equal: equal.as_ref().map(KeptLight::from),
    };
    KEPT.write(file, &kept)
}

/// Reads a comparison.
///
/// # Errors
/// Where the file cannot be read, is damaged, or a newer version of the program wrote it.
pub(super) fn read(file: &Path) -> Result<ComparisonResults, FormatError> {
    let Kept { program_version, order, own, equal } = KEPT.read(file)?;
    let is_of_this_version = program_version == NUMBERS_VERSION;
    Ok(ComparisonResults { order, own: own.into(), equal: equal.map(Compared::from), is_of_this_version })
}
