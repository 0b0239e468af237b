//! Files of reconstructions: all of them as an array, some beside truth and measurement as images.

use std::fs::File;
use std::path::{Path, PathBuf};

use ndarray::{Array3, ArrayView2, ArrayView3, ArrayViewD, Axis, Zip};

use crate::formats::{self, ArrayWriter, CompleteFile};
use crate::workbench::export::colormap::Colormap;
use crate::workbench::export::design_files::{ExportError, put_in_place};

/// The array of all reconstructions.
pub const RECONSTRUCTIONS_FILE: &str = "reconstructions.npy";
/// Images of an example, in the order of their making.
const EXAMPLE_IMAGES: [&str; 4] = ["truth", "measurement", "reconstruction", "error"];
/// Images of a frame of a capture.
const FRAME_IMAGES: [&str; 2] = ["reconstruction", "measurement"];
/// Share of the pixels of an image that are darker than its white.
const WHITE_SHARE: f64 = 0.998;

/// Reconstructions on their way into a folder. No file appears before [`ReconstructionWriter::finish`].
pub struct ReconstructionWriter {
    folder: PathBuf,
    array: ArrayWriter,
    images: Vec<(PathBuf, CompleteFile)>,
    _lock: Option<File>,
}

/// One object, what was measured of it, and what a decoder made of that; shapes (rows, cols), photons per pixel.
#[derive(Clone, Copy)]
pub struct ReconstructionExample<'a> {
    /// The object.
    pub truth: ArrayView2<'a, f32>,
    /// The noisy measurement.
    pub measurement: ArrayView2<'a, f32>,
    /// The reconstruction.
    pub reconstruction: ArrayView2<'a, f32>,
}

impl ReconstructionWriter {
    /// Starts `reconstructions.npy` of this shape in a folder, which is created if it is missing.
    ///
    /// # Errors
    /// [`ExportError`] names the file that could not be written, or the folder where another program writes into it.
    pub fn create(folder: &Path, shape: &[usize]) -> Result<Self, ExportError> {
        formats::create_folder(folder)?;
        let lock = formats::lock_folder(folder)?;
        let array = ArrayWriter::create(&folder.join(RECONSTRUCTIONS_FILE), shape)?;
        Ok(Self { folder: folder.to_owned(), array, images: Vec::new(), _lock: lock })
    }

    /// Appends reconstructions.
    ///
    /// # Errors
    /// [`ExportError`] where the file cannot be written.
    pub fn append(&mut self, part: ArrayViewD<'_, f32>) -> Result<(), ExportError> {
        Ok(self.array.append(part)?)
    }

    /// Writes the images of example `number`: truth and reconstruction in grey on one scale, the measurement on its own, the error
    /// (object minus reconstruction) from blue to red.
    ///
    /// # Errors
    /// [`ExportError`] where a file cannot be written.
    pub fn example(&mut self, number: usize, example: ReconstructionExample<'_>) -> Result<(), ExportError> {
        let ReconstructionExample { truth, measurement, reconstruction } = example;
        let error = &truth - &reconstruction;
        let largest = |image: ArrayView2<'_, f32>| image.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let white = largest(truth);
        let half = largest(error.mapv(f32::abs).view());
        let [truth_file, measurement_file, reconstruction_file, error_file] =
            EXAMPLE_IMAGES.map(|name| self.folder.join(format!("example-{number}-{name}.png")));
        let grey = |path: &Path, image, white| formats::complete_png8(path, image, 0.0, white);
        self.images.extend([
            (truth_file.clone(), grey(&truth_file, truth, white)?),
            (measurement_file.clone(), grey(&measurement_file, measurement, largest(measurement))?),
            (reconstruction_file.clone(), grey(&reconstruction_file, reconstruction, white)?),
            (error_file.clone(), Colormap::Diverging.complete_png(error.view(), (-half, half), &error_file)?),
        ]);
        Ok(())
    }

    /// Writes the images of frame `number` of a capture: its reconstruction and its measurement, each of one or three channels, shape (rows,
    /// cols, channels). The brightest pixels are white.
    ///
    /// # Errors
    /// [`ExportError`] where a file cannot be written.
    pub fn frame(
        &mut self,
        number: usize,
        reconstruction: ArrayView3<'_, f32>,
        measurement: ArrayView3<'_, f32>,
    ) -> Result<(), ExportError> {
        for (name, image) in FRAME_IMAGES.into_iter().zip([reconstruction, measurement]) {
            let path = self.folder.join(format!("{name}-{number}.png"));
            let white = white_of(image);
            let file = match image.shape()[2] {
                3 => formats::complete_png_rgb(&path, levels(image, white).view())?,
                _ => formats::complete_png8(&path, image.index_axis(Axis(2), 0), 0.0, white)?,
            };
            self.images.push((path, file));
        }
        Ok(())
    }

    /// Gives all files their names. Images of examples and frames of an earlier, longer run are removed.
    ///
    /// # Errors
    /// [`ExportError`] where a file cannot be written.
    pub fn finish(self) -> Result<Vec<PathBuf>, ExportError> {
        let mut complete = vec![(self.folder.join(RECONSTRUCTIONS_FILE), self.array.complete()?)];
        complete.extend(self.images);
        let files = put_in_place(complete)?;
        let example = |number: usize| EXAMPLE_IMAGES.map(|name| format!("example-{number}-{name}.png")).to_vec();
        let frame = |number: usize| FRAME_IMAGES.map(|name| format!("{name}-{number}.png")).to_vec();
        for names in [&example as &dyn Fn(usize) -> Vec<String>, &frame] {
            for number in 1.. {
                let named: Vec<PathBuf> = names(number).into_iter().map(|name| self.folder.join(name)).collect();
                if files.contains(&named[0]) {
                    continue;
                }
                if !named.iter().any(|file| file.exists()) {
                    break;
                }
                for file in &named {
                    formats::remove_if_there(file)?;
                }
            }
        }
        Ok(files)
    }
}

/// Writes the reconstruction of a capture as `reconstructions.npy` and `reconstruction-1.png`, and the capture as `measurement-1.png`;
/// images of shape (rows, cols, channels).
///
/// # Errors
/// As [`ReconstructionWriter::finish`].
pub(crate) fn export_capture(
    folder: &Path,
    object: ArrayView3<'_, f32>,
    measurement: ArrayView3<'_, f32>,
) -> Result<Vec<PathBuf>, ExportError> {
    let frame = object.insert_axis(Axis(0));
    // A single channel has no axis.
    let frame =
        if frame.len_of(Axis(3)) == 1 { frame.index_axis_move(Axis(3), 0).into_dyn() } else { frame.into_dyn() };
    let mut writer = ReconstructionWriter::create(folder, frame.shape())?;
    writer.append(frame)?;
    writer.frame(1, object, measurement)?;
    writer.finish()
}

/// Levels of 0 to 255 of an image of shape (rows, cols, channels), as its file has them. The brightest pixels are white.
pub fn colour_levels(image: ArrayView3<'_, f32>) -> Array3<u8> {
    levels(image, white_of(image))
}

/// Value that most pixels do not reach.
fn white_of(image: ArrayView3<'_, f32>) -> f32 {
    let mut values: Vec<f32> = image.iter().copied().filter(|value| value.is_finite()).collect();
    values.sort_by(f32::total_cmp);
    let place = (values.len() as f64 * WHITE_SHARE) as usize;
    let brightest = values.last().copied().unwrap_or_default();
    let white = values.get(place).copied().filter(|&white| white > 0.0).unwrap_or(brightest);
    white.max(f32::MIN_POSITIVE)
}

/// Grey levels of 0 to 255.
fn levels(image: ArrayView3<'_, f32>, white: f32) -> Array3<u8> {
    let mut levels = Array3::zeros(image.dim());
    // The cast saturates, and NaN becomes 0.
    Zip::from(&mut levels).and(&image).for_each(|level, &value| *level = (255.0 * value / white + 0.5) as u8);
    levels
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, Array3, s};

    #[test]
    fn files_appear_together_and_older_examples_go() {
        let folder = tempfile::tempdir().unwrap();
        let truth = Array2::from_shape_fn((12, 14), |(row, col)| (row * col) as f32);
        let run = |examples: usize| {
            let mut writer = ReconstructionWriter::create(folder.path(), &[2, 12, 14]).unwrap();
            writer.append(Array3::<f32>::ones((2, 12, 14)).into_dyn().view()).unwrap();
            for number in 1..=examples {
                let measurement = truth.slice(s![..5, ..6]);
                let example = ReconstructionExample { truth: truth.view(), measurement, reconstruction: truth.view() };
                writer.example(number, example).unwrap();
            }
            assert_eq!(folder.path().join("reconstructions.npy").exists(), examples == 1, "nothing before the end");
            writer.finish().unwrap().len()
        };
        assert_eq!([run(3), run(1)], [13, 5]);
        let left = std::fs::read_dir(folder.path()).unwrap().count();
        assert!(left <= 6, "{left} files");
        assert_eq!(formats::read_array(&folder.path().join(RECONSTRUCTIONS_FILE)).unwrap().shape(), [2, 12, 14]);
    }

    #[test]
    fn images_of_later_frames_and_of_examples_go() {
        let folder = tempfile::tempdir().unwrap();
        let image = Array3::<f32>::ones((4, 5, 1));
        let run = |frames: usize| {
            let mut writer = ReconstructionWriter::create(folder.path(), &[frames, 4, 5]).unwrap();
            writer.append(Array3::<f32>::ones((frames, 4, 5)).into_dyn().view()).unwrap();
            (1..=frames).for_each(|number| writer.frame(number, image.view(), image.view()).unwrap());
            writer.finish().unwrap();
        };
        std::fs::write(folder.path().join("example-1-truth.png"), "x").unwrap();
        run(3);
        assert!(folder.path().join("measurement-3.png").exists());
        run(1);
        for name in ["measurement-2", "measurement-3", "reconstruction-2", "reconstruction-3", "example-1-truth"] {
            assert!(!folder.path().join(format!("{name}.png")).exists(), "{name}");
        }
        assert!(folder.path().join("reconstruction-1.png").exists());
    }

    #[test]
    fn few_bright_pixels_do_not_darken_an_image() {
        let mut image = Array3::<f32>::from_elem((50, 50, 3), 10.0);
        image[(4, 5, 0)] = 1e6;
        assert_eq!(white_of(image.view()), 10.0);
        assert_eq!(levels(image.view(), 10.0)[(4, 5, 0)], 255);
        assert!(white_of(Array3::zeros((3, 3, 1)).view()) > 0.0);
    }
}
