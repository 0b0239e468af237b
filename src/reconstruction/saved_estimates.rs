//! Estimates of a slow decoder in a file, so that a stopped test resumes after its last images.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};

use super::decoder::{Decoder, DecoderKind, ObjectEstimates, PreparedDecoder, ReconstructionStep};
use super::error::ReconstructionError;
use super::model::ImagingModel;
use super::one_by_one::report as report_to;
use crate::formats::FormatError;
use crate::information::InformationError;
use crate::progress::{CancelToken, Progress};

/// Bytes of a hash.
const HASH: usize = blake3::OUT_LEN;

/// A decoder that saves its estimates in a file as soon as they are made. Those that are there already are read instead.
///
/// A file of other settings is replaced. Where the file cannot be written, estimates are made as without it; when they are stopped, the
/// error is that of the file.
pub struct SavingDecoder {
    decoder: Box<dyn Decoder>,
    file: PathBuf,
    settings: String,
}

impl SavingDecoder {
    /// A decoder with its file. `settings` is the key of all that decides an estimate beside its measurement.
    pub fn new(decoder: Box<dyn Decoder>, file: PathBuf, settings: String) -> Self {
        Self { decoder, file, settings }
    }
}

impl Decoder for SavingDecoder {
    fn kind(&self) -> DecoderKind {
        self.decoder.kind()
    }

    fn prepare(
        &self,
        model: &ImagingModel,
        cancel: &CancelToken,
    ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError> {
        let prepared = self.decoder.prepare(model, cancel)?;
        let saved = match EstimateFile::open(&self.file, &self.settings, model.field()) {
            Ok(file) => Saved { file: Some(file), failure: None },
            Err(reason) => Saved { file: None, failure: Some(reason) },
        };
        let (path, field) = (self.file.clone(), model.field());
        Ok(Box::new(SavedEstimates { prepared, path, field, saved: Mutex::new(saved) }))
    }
}

struct SavedEstimates {
    prepared: Box<dyn PreparedDecoder>,
    path: PathBuf,
    field: (usize, usize),
    saved: Mutex<Saved>,
}

struct Saved {
    /// None where it cannot be opened.
    file: Option<EstimateFile>,
    /// Why the last estimates are in no file.
    failure: Option<io::Error>,
}

impl SavedEstimates {
    /// Saved estimates of measurements, in their order.
    fn saved(&self, keys: &[[u8; HASH]]) -> Vec<Option<Estimate>> {
        let mut saved = self.saved.lock().unwrap_or_else(PoisonError::into_inner);
        keys.iter().map(|key| saved.file.as_mut()?.read(key).ok().flatten()).collect()
    }

    fn save(&self, key: [u8; HASH], estimate: &Estimate) {
        let mut saved = self.saved.lock().unwrap_or_else(PoisonError::into_inner);
        // An estimate that a full disk does not take is made again after a stop.
        if let Some(Err(reason)) = saved.file.as_mut().map(|file| file.append(key, estimate)) {
            saved.failure = Some(reason);
        }
    }

    /// The error of a stop: that of the file where it does not hold all estimates.
    fn stopped(&self) -> ReconstructionError {
        let failure = self.saved.lock().unwrap_or_else(PoisonError::into_inner).failure.take();
        failure.map_or(ReconstructionError::Cancelled, |reason| {
            InformationError::from(FormatError::from_write(&self.path, reason)).into()
        })
    }

    /// Estimates of measurements: saved ones, and others, which are saved.
    fn complete(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<ObjectEstimates, ReconstructionError> {
        let total = measurements.len_of(Axis(0));
        let keys: Vec<[u8; HASH]> = measurements.outer_iter().map(key_of).collect();
        let mut estimates = self.saved(&keys);
        let missing: Vec<usize> = (0..total).filter(|&index| estimates[index].is_none()).collect();
        let mut done = total - missing.len();
        // As many at a time as there are threads: a stop loses no more than these.
        for part in missing.chunks(rayon::current_num_threads()) {
            let mut report = |step: &ReconstructionStep| match step {
                // These are saved before a stop.
                ReconstructionStep::Images { done, .. } if *done == part.len() => ControlFlow::Continue(()),
                ReconstructionStep::Images { done: of_part, .. } => {
                    progress.report(&ReconstructionStep::Images { done: done + of_part, total })
                }
                ReconstructionStep::Iteration { .. } => progress.report(&ReconstructionStep::Images { done, total }),
            };
            let made = self.prepared.estimate(measurements.select(Axis(0), part).view(), &mut report)?;
            for (at, (&index, object)) in part.iter().zip(made.objects.outer_iter()).enumerate() {
                let expected_mse = made.expected_mse.as_ref().map(|expected| expected[at]);
                let estimate = Estimate { expected_mse, object: object.to_owned() };
                self.save(keys[index], &estimate);
                estimates[index] = Some(estimate);
            }
            done += part.len();
            report_to(progress, &ReconstructionStep::Images { done, total })?;
        }
        let (rows, cols) = self.field;
        let mut objects = Array3::zeros((total, rows, cols));
        // None is missing any more.
        for (mut object, estimate) in objects.outer_iter_mut().zip(estimates.iter().flatten()) {
            object.assign(&estimate.object);
        }
        let expected_mse = estimates.iter().flatten().map(|estimate| estimate.expected_mse).collect();
        Ok(ObjectEstimates { objects, expected_mse })
    }
}

impl PreparedDecoder for SavedEstimates {
    fn reconstruct(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array3<f32>, ReconstructionError> {
        Ok(self.estimate(measurements, progress)?.objects)
    }

    fn estimate(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<ObjectEstimates, ReconstructionError> {
        self.complete(measurements, progress).map_err(|error| match error {
            ReconstructionError::Cancelled => self.stopped(),
            error => error,
        })
    }

    fn standard_deviation(
        &self,
        measurement: ArrayView2<'_, f32>,
        cancel: &CancelToken,
    ) -> Result<Option<Array2<f32>>, ReconstructionError> {
        self.prepared.standard_deviation(measurement, cancel)
    }

    fn expected_mse(&self, cancel: &CancelToken) -> Result<Option<f64>, ReconstructionError> {
        self.prepared.expected_mse(cancel)
    }
}

/// The hash of a measurement.
fn key_of(measurement: ArrayView2<'_, f32>) -> [u8; HASH] {
    let mut hasher = blake3::Hasher::new();
    measurement.iter().for_each(|value| {
        hasher.update(&value.to_le_bytes());
    });
    hasher.finalize().into()
}

/// Estimate of one measurement.
#[derive(Clone, Debug, PartialEq)]
struct Estimate {
    expected_mse: Option<f64>,
    object: Array2<f32>,
}

/// A file that estimates are added to: the hash of its settings, and for each estimate the hash of the measurement, the expected squared
/// error or NaN, the object, and a hash of all of these.
struct EstimateFile {
    file: File,
    field: (usize, usize),
    /// Places of whole records.
    places: HashMap<[u8; HASH], u64>,
    /// Bytes of whole records. A record that a stop cut in half is written over.
    end: u64,
}

impl EstimateFile {
    fn open(path: &Path, settings: &str, field: (usize, usize)) -> io::Result<Self> {
        let file = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
        let mut opened = Self { file, field, places: HashMap::new(), end: HASH as u64 };
        let settings: [u8; HASH] = blake3::hash(settings.as_bytes()).into();
        let mut reader = BufReader::new(&opened.file);
        let mut header = [0; HASH];
        if reader.read_exact(&mut header).is_err() || header != settings {
            drop(reader);
            opened.file.set_len(0)?;
            opened.file.rewind()?;
            opened.file.write_all(&settings)?;
            return Ok(opened);
        }
        let mut record = vec![0; opened.record_bytes()];
        let (mut places, mut end) = (HashMap::new(), opened.end);
        while reader.read_exact(&mut record).is_ok() {
            let Some(key) = whole(&record) else { break };
            places.insert(key, end);
            end += record.len() as u64;
        }
        drop(reader);
        (opened.places, opened.end) = (places, end);
        Ok(opened)
    }

    fn record_bytes(&self) -> usize {
        HASH + size_of::<f64>() + self.field.0 * self.field.1 * size_of::<f32>() + HASH
    }

    fn read(&mut self, key: &[u8; HASH]) -> io::Result<Option<Estimate>> {
        let Some(&place) = self.places.get(key) else { return Ok(None) };
        let mut record = vec![0; self.record_bytes()];
        self.file.seek(SeekFrom::Start(place))?;
        self.file.read_exact(&mut record)?;
        if whole(&record) != Some(*key) {
            return Ok(None);
        }
        let (expected, pixels) = record[HASH..record.len() - HASH].split_at(size_of::<f64>());
        let expected = f64::from_le_bytes(expected.try_into().map_err(io::Error::other)?);
        let values = pixels.as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
        let object = Array2::from_shape_vec(self.field, values).map_err(io::Error::other)?;
        Ok(Some(Estimate { expected_mse: (!expected.is_nan()).then_some(expected), object }))
    }

    fn append(&mut self, key: [u8; HASH], Estimate { expected_mse, object }: &Estimate) -> io::Result<()> {
        let mut record = Vec::with_capacity(self.record_bytes());
        record.extend(key);
        record.extend(expected_mse.unwrap_or(f64::NAN).to_le_bytes());
        record.extend(object.iter().flat_map(|value| value.to_le_bytes()));
        let check: [u8; HASH] = blake3::hash(&record).into();
        record.extend(check);
        self.file.seek(SeekFrom::Start(self.end))?;
        self.file.write_all(&record)?;
        self.places.insert(key, self.end);
        self.end += record.len() as u64;
        Ok(())
    }
}

/// The hash of the measurement of a record, where the record is whole.
fn whole(record: &[u8]) -> Option<[u8; HASH]> {
    let (content, check) = record.split_last_chunk::<HASH>()?;
    (*blake3::hash(content).as_bytes() == *check).then(|| content.first_chunk().copied())?
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::sensor::Noise;

    /// A decoder whose objects are the field filled with the first pixel. It counts the images that it is given.
    struct Filled {
        images: Arc<AtomicUsize>,
    }

    impl Decoder for Filled {
        fn kind(&self) -> DecoderKind {
            DecoderKind::TotalVariation
        }

        fn prepare(
            &self,
            model: &ImagingModel,
            _: &CancelToken,
        ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError> {
            Ok(Box::new(PreparedFilled { images: Arc::clone(&self.images), field: model.field() }))
        }
    }

    struct PreparedFilled {
        images: Arc<AtomicUsize>,
        field: (usize, usize),
    }

    impl PreparedDecoder for PreparedFilled {
        fn reconstruct(
            &self,
            measurements: ArrayView3<'_, f32>,
            progress: &mut dyn Progress<ReconstructionStep>,
        ) -> Result<Array3<f32>, ReconstructionError> {
            let total = measurements.len_of(Axis(0));
            self.images.fetch_add(total, Ordering::Relaxed);
            let (rows, cols) = self.field;
            let objects = Array3::from_shape_fn((total, rows, cols), |(image, ..)| measurements[(image, 0, 0)]);
            match progress.report(&ReconstructionStep::Images { done: total, total }) {
                ControlFlow::Continue(()) => Ok(objects),
                ControlFlow::Break(()) => Err(ReconstructionError::Cancelled),
            }
        }

        fn estimate(
            &self,
            measurements: ArrayView3<'_, f32>,
            progress: &mut dyn Progress<ReconstructionStep>,
        ) -> Result<ObjectEstimates, ReconstructionError> {
            let expected = measurements.outer_iter().map(|image| f64::from(image[(0, 0)])).collect();
            Ok(ObjectEstimates { objects: self.reconstruct(measurements, progress)?, expected_mse: Some(expected) })
        }
    }

    /// Twelve measurements, each of another value.
    fn measurements() -> Array3<f32> {
        Array3::from_shape_fn((12, 5, 6), |(image, ..)| image as f32 + 0.5)
    }

    /// Estimates of all of them with a file, and how many the decoder made.
    fn estimate(file: &Path, settings: &str) -> (ObjectEstimates, usize) {
        let (prepared, images) = prepare(file, settings);
        let found = prepared.estimate(measurements().view(), &mut CancelToken::new()).unwrap();
        (found, images.load(Ordering::Relaxed))
    }

    fn prepare(file: &Path, settings: &str) -> (Box<dyn PreparedDecoder>, Arc<AtomicUsize>) {
        let images = Arc::default();
        let decoder = Box::new(Filled { images: Arc::clone(&images) });
        let psf = Array3::from_elem((1, 2, 2), 0.25);
        let model = ImagingModel::new(psf.view(), (6, 7), 1.0, Noise::Shot).unwrap();
        let kept = SavingDecoder::new(decoder, file.into(), settings.into());
        assert_eq!(kept.kind(), DecoderKind::TotalVariation);
        (kept.prepare(&model, &CancelToken::new()).unwrap(), images)
    }

    fn is_right(found: &ObjectEstimates) -> bool {
        let expected: Vec<f64> = (0..12).map(|image| f64::from(image) + 0.5).collect();
        let objects = Array3::from_shape_fn((12, 6, 7), |(image, ..)| image as f32 + 0.5);
        found.objects == objects && found.expected_mse == Some(expected)
    }

    #[test]
    fn saved_estimates_are_not_computed_again() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("estimates.state");
        let (prepared, images) = prepare(&file, "a");
        // Six of twelve are made before the stop.
        let mut stop = |step: &ReconstructionStep| match step {
            ReconstructionStep::Images { done, .. } if *done > 4 => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        };
        let two_threads = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let stopped = two_threads.install(|| prepared.estimate(measurements().view(), &mut stop));
        assert!(matches!(stopped, Err(ReconstructionError::Cancelled)) && images.load(Ordering::Relaxed) == 6);
        drop(prepared);
        let (found, made) = estimate(&file, "a");
        assert!(is_right(&found) && made == 6, "{made}");
        let (found, made) = estimate(&file, "a");
        assert!(is_right(&found) && made == 0, "{made}");
        // Those of other settings are of no use.
        let (found, made) = estimate(&file, "b");
        assert!(is_right(&found) && made == 12, "{made}");
    }

    #[test]
    fn record_that_is_cut_or_changed_is_made_again() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("estimates.state");
        estimate(&file, "a");
        let bytes = std::fs::read(&file).unwrap();
        std::fs::write(&file, &bytes[..bytes.len() - 3]).unwrap();
        let (found, made) = estimate(&file, "a");
        assert!(is_right(&found) && made == 1, "{made}");
        assert_eq!(std::fs::read(&file).unwrap(), bytes);
        // The middle of the sixth record of twelve.
        let record = (bytes.len() - HASH) / 12;
        let mut changed = bytes.clone();
        changed[HASH + 5 * record + record / 2] ^= 1;
        std::fs::write(&file, &changed).unwrap();
        let (found, made) = estimate(&file, "a");
        assert!(is_right(&found) && made == 7, "{made}");
    }

    #[test]
    fn file_that_cannot_be_written_stops_no_estimate() {
        let folder = tempfile::tempdir().unwrap();
        let (found, made) = estimate(folder.path(), "a");
        assert!(is_right(&found) && made == 12, "{made}");
    }

    #[test]
    fn stop_without_a_file_of_the_estimates_is_the_error_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let (prepared, _) = prepare(folder.path(), "a");
        let mut stop = |_: &ReconstructionStep| ControlFlow::Break(());
        let error = prepared.estimate(measurements().view(), &mut stop).err().unwrap().to_string();
        assert!(error.contains(&*folder.path().to_string_lossy()), "{error}");
    }
}
