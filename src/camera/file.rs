//! Camera files: the calibration as JSON, with the maps of its pixels and a drawing beside it.

use std::path::{Path, PathBuf};

use ndarray::{Array2, Ix2};
use serde::{Deserialize, Serialize};

use super::calibration::{CalibratedCamera, CameraCalibration, CameraMaps};
use super::error::CameraError;
use super::plot::calibration_plot;
use crate::formats::{ArrayWriter, CompleteFile, DocumentKind, FormatError, complete_file, read_array};

/// The kind of camera files.
const CAMERA: DocumentKind = DocumentKind::new("lenslet-studio/camera", "a camera");

/// Names of the maps beside a camera file, NPY of shape (rows, cols).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct MapFiles {
    /// Dark signal of each pixel, DN, or null where one value holds for all.
    pub dark_signal_dn: Option<String>,
    /// Response of each pixel over the mean, or null where one gain holds for all.
    pub response: Option<String>,
    /// 0 for a good pixel, 1 for a hot and 2 for a dim one.
    pub mask: String,
}

/// Content of a camera file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct CameraFile {
    /// The quantities of the camera.
    #[serde(flatten)]
    pub calibration: CameraCalibration,
    /// The maps of its pixels.
    pub maps: MapFiles,
}

/// Files beside a camera file.
struct Names {
    dark: String,
    response: String,
    mask: String,
    plot: String,
}

impl Names {
    fn of(path: &Path) -> Self {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Self {
            dark: format!("{stem}-dark.npy"),
            response: format!("{stem}-response.npy"),
            mask: format!("{stem}-mask.npy"),
            plot: format!("{stem}.svg"),
        }
    }
}

impl CalibratedCamera {
    /// The calibration as JSON with `format` and `format_version`, as printed and written.
    pub fn marked<T: Serialize>(content: &T) -> impl Serialize {
        CAMERA.marked(content)
    }

    /// Content of the camera file that [`CalibratedCamera::write`] writes at `path`.
    pub fn file(&self, path: &Path) -> CameraFile {
        let names = Names::of(path);
        let maps = MapFiles {
            dark_signal_dn: self.maps.dark_signal_dn.is_some().then_some(names.dark),
            response: self.maps.response.is_some().then_some(names.response),
            mask: names.mask,
        };
        CameraFile { calibration: self.calibration.clone(), maps }
    }

    /// The files that [`CalibratedCamera::write`] writes at `path`, the camera file first.
    pub fn files(&self, path: &Path) -> Vec<PathBuf> {
        let MapFiles { dark_signal_dn, response, mask } = self.file(path).maps;
        let names = [dark_signal_dn, response, Some(mask), Some(Names::of(path).plot)];
        let beside = names.into_iter().flatten().map(|name| path.with_file_name(name));
        std::iter::once(path.to_path_buf()).chain(beside).collect()
    }

    /// Writes the camera file, its maps and its drawing (SVG), all or none. Returns the files.
    ///
    /// # Errors
    /// [`CameraError::File`] where one cannot be written.
    pub fn write(&self, path: &Path) -> Result<Vec<PathBuf>, CameraError> {
        let names = Names::of(path);
        let beside = |name: &String| path.with_file_name(name);
        let mut files: Vec<(PathBuf, CompleteFile)> = Vec::new();
        let maps = [
            (&names.dark, self.maps.dark_signal_dn.as_ref()),
            (&names.response, self.maps.response.as_ref()),
            (&names.mask, Some(&self.maps.mask)),
        ];
        for (name, map) in maps {
            if let Some(map) = map {
                let mut writer = ArrayWriter::create(&beside(name), map.shape())?;
                writer.append(map.view())?;
                files.push((beside(name), writer.complete()?));
            }
        }
        if let Some(svg) = calibration_plot(&self.calibration) {
            let plot = beside(&names.plot);
            let complete = complete_file(&plot, |writer| writer.write_all(svg.as_bytes()))?;
            files.push((plot, complete));
        }
        files.push((path.to_path_buf(), CAMERA.complete(path, &self.file(path))?));
        let mut written = Vec::new();
        for (path, file) in files {
            file.put_in_place()?;
            written.push(path);
        }
        Ok(written)
    }

    /// Reads a camera file and its maps.
    ///
    /// # Errors
    /// [`CameraError::File`] for a file that is missing, of another kind, or newer, and a map of another size.
    pub fn open(path: &Path) -> Result<Self, CameraError> {
        let CameraFile { calibration, maps } = CAMERA.read(path)?;
        let shape = (calibration.rows, calibration.cols);
        let read = |name: &String| read_map(&path.with_file_name(name), shape);
        let maps = CameraMaps {
            dark_signal_dn: maps.dark_signal_dn.as_ref().map(read).transpose()?,
            response: maps.response.as_ref().map(read).transpose()?,
            mask: read(&maps.mask)?,
        };
        let gain = calibration.system_gain_dn_per_electron;
        if !(gain > 0.0 && gain.is_normal()) {
            let found = format!("system_gain_dn_per_electron of {gain}");
            return Err(
                FormatError::malformed(path, "a system gain above 0", found, "calibrate the camera again").into()
            );
        }
        Ok(Self { calibration, maps })
    }
}

fn read_map(path: &Path, shape: (usize, usize)) -> Result<Array2<f32>, FormatError> {
    let array = read_array(path)?;
    let found = array.shape().to_vec();
    let map = array.into_dimensionality::<Ix2>().ok().filter(|map| map.dim() == shape);
    map.ok_or_else(|| {
        let expected = format!("a map of {} x {} px, as in the camera file", shape.0, shape.1);
        FormatError::malformed(path, expected, format!("shape {found:?}"), "calibrate the camera again")
    })
}

#[cfg(test)]
mod tests {
    use super::super::simulated::SimulatedSensor;
    use super::super::{ColourChoice, FrameSeries, calibrate};
    use super::*;
    use crate::progress::CancelToken;

    #[test]
    fn cameras_are_written_whole_and_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let sensor = SimulatedSensor { shape: (30, 40), prnu: 0.05, dsnu: 9.0, ..SimulatedSensor::default() };
        let series = FrameSeries::open(&sensor.write(folder.path(), &sensor.levels(8), 12, 1.0)).unwrap();
        let camera = calibrate(&series, ColourChoice::default(), &mut CancelToken::new()).unwrap();
        let path = folder.path().join("my camera.json");
        let written = camera.write(&path).unwrap();
        let names: Vec<_> = written.iter().map(|path| path.file_name().unwrap().to_str().unwrap()).collect();
        let expected =
            ["my camera-dark.npy", "my camera-response.npy", "my camera-mask.npy", "my camera.svg", "my camera.json"];
        assert_eq!(names, expected);
        let again = CalibratedCamera::open(&path).unwrap();
        assert_eq!((again.calibration, &again.maps), (camera.calibration.clone(), &camera.maps));
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("{\n  \"format\": \"lenslet-studio/camera\",\n  \"format_version\": 1,"), "{text}");

        std::fs::remove_file(folder.path().join("my camera-mask.npy")).unwrap();
        let error = CalibratedCamera::open(&path).unwrap_err().to_string();
        assert!(error.contains("my camera-mask.npy: expected a file, found nothing"), "{error}");
        let none = folder.path().join("none/camera.json");
        assert!(camera.write(&none).is_err() && !folder.path().join("none").exists());
    }
}
