//! Where the frames of a series are: in a folder, or in the lines of a descriptor.

use std::path::Path;

use super::descriptor;
use super::error::CameraError;
use super::grouping;
use super::series::FrameSeries;
use crate::formats::ImageFile;

impl FrameSeries {
    /// Finds the frames of a folder or of a descriptor file of EMVA 1288. In a folder, files are read only to count their frames.
    ///
    /// In a folder each sub-folder is a group; without sub-folders, files whose names begin alike are. Groups whose name holds
    /// "dark", "bias" or "black" are dark. A time such as `10ms` in the name of a group is its exposure.
    ///
    /// # Errors
    /// [`CameraError`] where there is no such file, or dark frames or light levels are missing.
    pub fn open(path: &Path) -> Result<Self, CameraError> {
        let place = ImageFile::find(path)?;
        let mut series = if place.path.is_dir() { grouping::group(&place)? } else { descriptor::read(&place.path)? };
        series.groups.sort_by_key(|group| !group.is_dark);
        if series.groups.iter().all(|group| !group.is_dark) {
            return Err(CameraError::NoDark { path: series.path });
        }
        if series.groups.iter().all(|group| group.is_dark) {
            return Err(CameraError::NoLight { path: series.path });
        }
        Ok(series)
    }

    /// Writes the series as a descriptor file of EMVA 1288.
    ///
    /// # Errors
    /// [`CameraError::File`] where it cannot be written.
    pub fn write_descriptor(&self, path: &Path, shape: (usize, usize), bits: u32) -> Result<(), CameraError> {
        descriptor::write(self, path, shape, bits)
    }
}
