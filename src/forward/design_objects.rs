//! Opens the objects of a design.

use ndarray::{Axis, s};

use crate::forward::{Design, DesignError};
use crate::objects::{ObjectError, ObjectSet, ReadProgress};
use crate::progress::{CancelToken, Progress};

/// The objects of a design.
pub fn open_set(design: &Design) -> Result<ObjectSet, ObjectError> {
    open_set_with(design, &mut CancelToken::new())
}

/// The objects of a design, with reports of the files read.
pub fn open_set_with(design: &Design, progress: &mut dyn Progress<ReadProgress>) -> Result<ObjectSet, ObjectError> {
    ObjectSet::open_with(&design.objects, &design.object_options(), progress)
}

/// Notices about the objects of a design, and about light of the PSF on planes without objects.
///
/// # Errors
/// [`DesignError`] where the mask cannot be rendered.
pub fn notices_of(design: &Design, set: &ObjectSet) -> Result<Vec<String>, DesignError> {
    let psf = design.psf(set.planes())?;
    let lost = psf.slice(s![set.planes().., .., ..]).sum() / psf.sum();
    let notice = || {
        let planes = set.planes();
        format!(
            "{:.1} % of the PSF lies on planes that these objects do not have: they have {planes}, the mask has {}, and no light \
             comes from the others",
            100.0 * lost,
            psf.len_of(Axis(0))
        )
    };
    Ok(set.notices().iter().cloned().chain((lost > 0.0).then(notice)).collect())
}
