//! Stacks of objects and measurements, written part by part.

use std::path::{Path, PathBuf};

use ndarray::{ArrayViewD, Axis};

use crate::evaluation::scene::EvaluationError;
use crate::formats::{self, ArrayWriter, CompleteFile, FormatError, PageWriter};
use crate::forward::{Design, ForwardModel};
use crate::information::InformationError;
use crate::progress::Progress;
use crate::sparsity::tamura_of_stack;
use crate::workbench::export::design_files::{DESIGN_FILE, ExportError, put_in_place};

/// File format of measurement stacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeasurementFormat {
    /// NPY, 32-bit float.
    Npy,
    /// TIFF, one page of 32-bit floats per measurement.
    Tiff,
}

impl MeasurementFormat {
    /// The file of the stack of this name.
    pub fn file(self, folder: &Path, name: &str) -> PathBuf {
        let extension = match self {
            Self::Npy => "npy",
            Self::Tiff => "tiff",
        };
        folder.join(format!("{name}.{extension}"))
    }
}

/// Names of the stacks of an export: objects, encoded images, and noisy measurements.
pub const MEASUREMENT_STACKS: [&str; 3] = ["objects", "noiseless", "measurements"];

/// Bytes of objects and measurements that are in memory at a time, about.
const BATCH_BYTES: usize = 64 << 20;

/// One stack on its way to a file.
struct StackWriter {
    path: PathBuf,
    writer: Writer,
}

enum Writer {
    Npy(ArrayWriter),
    Tiff(PageWriter),
}

impl StackWriter {
    /// Starts `folder/name.npy` or `folder/name.tiff` of this shape: (n, rows, cols) or (n, planes, rows, cols).
    fn create(folder: &Path, name: &str, format: MeasurementFormat, shape: &[usize]) -> Result<Self, FormatError> {
        let path = format.file(folder, name);
        let writer = match format {
            MeasurementFormat::Npy => Writer::Npy(ArrayWriter::create(&path, shape)?),
            MeasurementFormat::Tiff => Writer::Tiff(PageWriter::create(&path, pages_of(shape))?),
        };
        Ok(Self { path, writer })
    }

    fn append(&mut self, part: ArrayViewD<'_, f32>) -> Result<(), FormatError> {
        match &mut self.writer {
            Writer::Npy(writer) => writer.append(part),
            Writer::Tiff(writer) => {
                // As many pages as hold all pixels, so the shape always fits.
                let pages = part.to_shape(pages_of(part.shape())).map_err(std::io::Error::other);
                writer.append(pages.map_err(|error| FormatError::from_write(&self.path, error))?.view())
            }
        }
    }

    /// The file, whole and on the disk, and the name that it is to take.
    fn complete(self) -> Result<(PathBuf, CompleteFile), FormatError> {
        let file = match self.writer {
            Writer::Npy(writer) => writer.complete()?,
            Writer::Tiff(writer) => writer.complete()?,
        };
        Ok((self.path, file))
    }
}

/// The shape (pages, rows, cols) of a stack with planes or without.
fn pages_of(shape: &[usize]) -> (usize, usize, usize) {
    match shape {
        [before @ .., rows, cols] => {
            (before.iter().fold(1, |product: usize, &axis| product.saturating_mul(axis)), *rows, *cols)
        }
        _ => (0, 0, 0),
    }
}

/// Writes named stacks, shape (n, rows, cols) or (n, planes, rows, cols), into `folder`, which is created if it is missing. TIFF has one
/// page per plane.
///
/// # Errors
/// [`ExportError`] names the file that could not be written, or the folder where another program writes into it.
pub fn export_measurements(
    stacks: &[(&str, ArrayViewD<'_, f32>)],
    format: MeasurementFormat,
    folder: &Path,
) -> Result<Vec<PathBuf>, ExportError> {
    formats::create_folder(folder)?;
    let _lock = formats::lock_folder(folder)?;
    let write = |(name, stack): &(&str, ArrayViewD<'_, f32>)| {
        let mut writer = StackWriter::create(folder, name, format, stack.shape())?;
        writer.append(stack.view())?;
        Ok(writer.complete()?)
    };
    put_in_place(stacks.iter().map(write).collect::<Result<_, ExportError>>()?)
}

/// Result of [`measure_into`].
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredStacks {
    /// Shape of the objects: (n, rows, cols), or (n, planes, rows, cols) for volumes.
    pub object_shape: Vec<usize>,
    /// Shape of the measurements: (n, rows, cols).
    pub measurement_shape: Vec<usize>,
    /// Tamura coefficient of each noisy measurement.
    pub tamura: Vec<f64>,
    /// The files: objects, noiseless and noisy measurements, design.
    pub files: Vec<PathBuf>,
}

/// Measures `count` objects of a design into `objects`, `noiseless` and `measurements` (NPY or TIFF) and `design.json` in `folder`, which
/// is created if it is missing.
///
/// Memory does not grow with `count`: objects are drawn, measured and written a batch at a time. The files do not depend on the length of
/// a batch. No file appears before all are complete. Reports the number of finished objects.
///
/// # Errors
/// [`ExportError`] where something cannot be computed or written, or another program writes into the folder; where `progress` cancels.
pub fn measure_into(
    folder: &Path,
    design: &Design,
    forward: &ForwardModel,
    count: usize,
    format: MeasurementFormat,
    progress: &mut dyn Progress<usize>,
) -> Result<MeasuredStacks, ExportError> {
    let (rows, cols) = forward.set.field();
    let (measured_rows, measured_cols) = forward.plan().measurement_shape();
    let bytes = 4 * (forward.set.planes() * rows * cols + 2 * measured_rows * measured_cols);
    measure_in_batches(folder, design, forward, count, (BATCH_BYTES / bytes).max(1), format, progress)
}

fn measure_in_batches(
    folder: &Path,
    design: &Design,
    forward: &ForwardModel,
    count: usize,
    batch: usize,
    format: MeasurementFormat,
    progress: &mut dyn Progress<usize>,
) -> Result<MeasuredStacks, ExportError> {
    let (rows, cols) = forward.set.field();
    let object_shape = match forward.set.planes() {
        1 => vec![count, rows, cols],
        planes => vec![count, planes, rows, cols],
    };
    let (measured_rows, measured_cols) = forward.plan().measurement_shape();
    let measurement_shape = vec![count, measured_rows, measured_cols];
    let psf = forward.psf(design).map_err(EvaluationError::from)?;
    formats::create_folder(folder)?;
    let _lock = formats::lock_folder(folder)?;
    let start = |name, shape: &[usize]| StackWriter::create(folder, name, format, shape);
    let mut objects = start("objects", &object_shape)?;
    let mut noiseless = start("noiseless", &measurement_shape)?;
    let mut noisy = start("measurements", &measurement_shape)?;
    let mut tamura = Vec::new();
    let mut first = 0;
    while first < count {
        let length = batch.min(count - first);
        let part = forward.simulate(psf.view(), first..first + length, design.seed).map_err(EvaluationError::from)?;
        objects.append(match forward.set.planes() {
            1 => part.objects.index_axis(Axis(1), 0).into_dyn(),
            _ => part.objects.view().into_dyn(),
        })?;
        noiseless.append(part.noiseless.view().into_dyn())?;
        noisy.append(part.noisy.view().into_dyn())?;
        tamura.extend(tamura_of_stack(part.noisy.view()));
        first += length;
        if progress.report(&first).is_break() {
            return Err(EvaluationError::from(InformationError::Cancelled).into());
        }
    }
    let record = folder.join(DESIGN_FILE);
    let is_of_another = Design::open(&record).is_ok_and(|earlier| earlier != *design);
    let complete = vec![
        objects.complete()?,
        noiseless.complete()?,
        noisy.complete()?,
        (record.clone(), design.complete_file(&record)?),
    ];
    let files = put_in_place(complete)?;
    // Stacks of the same design in the other format may stay.
    let others = [MeasurementFormat::Npy, MeasurementFormat::Tiff].into_iter().filter(|&other| other != format);
    let stale = others.flat_map(|other| MEASUREMENT_STACKS.map(|name| other.file(folder, name)));
    for file in stale.filter(|_| is_of_another) {
        formats::remove_if_there(&file)?;
    }
    Ok(MeasuredStacks { object_shape, measurement_shape, tamura, files })
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::optics::{Encoder, depth_layout};
    use crate::progress::CancelToken;
    use crate::sensor::Noise;

    #[test]
    fn the_length_of_a_batch_changes_no_byte() {
        let folder = tempfile::tempdir().unwrap();
        let volume = Design {
            objects: "volume:3:0.01".parse().unwrap(),
            encoder: Encoder::Lenslets(depth_layout(3, 5)),
            noise: Noise::ShotRead { sigma: 2.0 },
            ..Design::default()
        };
        for (kind, design) in [Design::default(), volume].iter().enumerate() {
            let forward = ForwardModel::open(design).unwrap();
            for format in [MeasurementFormat::Npy, MeasurementFormat::Tiff] {
                let written = |batch: usize| {
                    let folder = folder.path().join(format!("{kind}-{format:?}-{batch}"));
                    let result =
                        measure_in_batches(&folder, design, &forward, 7, batch, format, &mut CancelToken::new())
                            .unwrap();
                    let bytes: Vec<_> = result.files.iter().map(|file| std::fs::read(file).unwrap()).collect();
                    (result.tamura, bytes)
                };
                let whole = written(100);
                assert_eq!(whole.0.len(), 7);
                for batch in [1, 3, 7] {
                    assert!(written(batch) == whole, "batches of {batch}");
                }
            }
        }
    }

    #[test]
    fn cancelled_export_leaves_no_stack() {
        let folder = tempfile::tempdir().unwrap();
        let design = Design::default();
        let forward = ForwardModel::open(&design).unwrap();
        let mut reported = Vec::new();
        let mut until_four = |done: &usize| {
            reported.push(*done);
            if *done < 4 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let npy = MeasurementFormat::Npy;
        let result = measure_in_batches(folder.path(), &design, &forward, 7, 2, npy, &mut until_four);
        assert!(matches!(result, Err(ExportError::Evaluation(error)) if error.is_cancelled()));
        assert_eq!(reported, [2, 4]);
        assert!(MEASUREMENT_STACKS.iter().all(|name| !npy.file(folder.path(), name).exists()));
    }

    #[test]
    fn pages_hold_all_planes() {
        assert_eq!(pages_of(&[5, 3, 7, 9]), (15, 7, 9));
        assert_eq!(pages_of(&[5, 7, 9]), (5, 7, 9));
    }
}
