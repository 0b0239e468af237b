//! Reading of camera images: colour, calibration of the pixels, view and bins, with notes on what may be wrong with them.

use std::path::{Path, PathBuf};

use ndarray::{Array2, Array3, Axis};
use serde::{Deserialize, Serialize};

use crate::camera::{CalibratedCamera, ChosenFrames, ColourChoice};
use crate::evaluation::calibration::Calibration;
use crate::evaluation::level_limit::LevelLimit;
use crate::evaluation::measured::MeasuredImages;
use crate::evaluation::measured_checks::{OVERFLOWED, copies_note, fixed_pattern_note, grey_notes};
use crate::evaluation::measured_error::MeasuredError;
use crate::evaluation::measured_source::MeasuredSource;
use crate::evaluation::measured_view::View;
use crate::evaluation::pixel_calibration::{Origins, PixelCalibration};
use crate::evaluation::progress::{EstimateProgress, report_step, report_understood};
use crate::formats::{FormatError, GreyValues, ImageSummary, bits_of, image_files, no_images};
use crate::plural::{counted, one_or_many};
use crate::progress::Progress;
use crate::sensor::Noise;

/// How camera images become electrons.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MeasuredOptions {
    /// Gain and offset, where no camera file and no dark frames state them, and bins.
    pub calibration: Calibration,
    /// Camera file of the `calibrate` command.
    pub camera: Option<PathBuf>,
    /// Colour that is taken from the images.
    pub colour: ColourChoice,
    /// File or folder of dark images; their mean is the dark signal of each pixel.
    pub dark: Option<PathBuf>,
    /// File or folder of flat images; their mean is the response of each pixel.
    pub flat: Option<PathBuf>,
    /// Part and orientation of the images.
    pub view: View,
}

/// Images of all files, converted, and what is known of their grey values.
struct ConvertedImages {
    /// Electrons or photons of shape (n, rows, cols).
    photons: Array3<f32>,
    values: GreyValues,
    understood: ImageSummary,
    colour: Option<String>,
    /// Planes of a mosaic that were summed.
    planes: usize,
}

impl MeasuredImages {
    /// Reads all images of a file, or of the files of a folder, and converts their grey values to photons.
    ///
    /// # Errors
    /// As [`MeasuredImages::open_with`].
    pub fn open(
        source: &MeasuredSource,
        calibration: &Calibration,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<Self, MeasuredError> {
        let options = MeasuredOptions { calibration: *calibration, ..MeasuredOptions::default() };
        Self::open_with(source, &options, progress)
    }

    /// Reads all images of a file, or of the files of a folder, and converts their grey values to electrons with a camera
    /// file, dark and flat images.
    ///
    /// # Errors
    /// [`MeasuredError`] for files that cannot be read, images of different shapes or depths, maps of another shape, pixels that
    /// are not finite, a calibration without meaning, and fewer than two images.
    pub fn open_with(
        source: &MeasuredSource,
        options: &MeasuredOptions,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<Self, MeasuredError> {
        let images = Self::read_with(source, options, progress)?;
        let found = images.photons.len_of(Axis(0));
        if found < 2 {
            return Err(MeasuredError::TooFewImages { path: images.path, found });
        }
        Ok(images)
    }

    /// Reads images as [`MeasuredImages::open_with`]. A single image is read too: it can be shown, not estimated.
    ///
    /// # Errors
    /// As [`MeasuredImages::open_with`], but for a single image.
    pub fn read_with(
        source: &MeasuredSource,
        options: &MeasuredOptions,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<Self, MeasuredError> {
        let path = source.path();
        let calibration = options.pixels()?;
        let ConvertedImages { photons, values, understood, colour, planes } =
            read_images(path, options, &calibration, progress)?;
        let mean = photons.iter().map(|&value| f64::from(value)).sum::<f64>() / photons.len() as f64;
        if !mean.is_finite() {
            let expected = "as many grey levels per photon as leave the photons a finite number";
            return Err(MeasuredError::Calibration { what: "gain", expected, found: calibration.constants.gain });
        }
        if mean <= 0.0 {
            return Err(MeasuredError::Dark { found: mean });
        }
        let taken = colour.map_or(String::new(), |colour| format!("; taken: {colour}"));
        let understood = format!("{}: {understood}; {values}{taken}", path.display());
        report_understood(progress, &understood)?;
        let grey_notes = grey_notes(&values);
        let mut notes: Vec<String> = grey_notes.steps.iter().cloned().collect();
        notes.push(understood.clone());
        notes.push(options.describe(&calibration));
        notes.extend(options.view.describe());
        notes.extend(values.overflowed().then(|| OVERFLOWED.to_owned()));
        let negative = photons.iter().filter(|value| **value < 0.0).count();
        if negative > 0 {
            let share = 100.0 * negative as f64 / photons.len() as f64;
            notes.push(format!("{share:.2} % of the pixels lie below the offset"));
        }
        let origins = Origins { has_camera: options.camera.is_some(), has_dark: options.dark.is_some() };
        // Copies are alike for another reason than a fixed pattern.
        let alike = copies_note(photons.view()).or_else(|| fixed_pattern_note(photons.view(), origins.has_dark));
        notes.extend(alike);
        let summed = calibration.constants.bin.pow(2) * planes;
        let limit = values.levels().map(|levels| LevelLimit {
            bits: (summed as f64 * (levels - 1.0) + 1.0).log2(),
            step: values.step().unwrap_or(1.0) / calibration.constants.gain,
        });
        let (path, calibration) = (path.to_path_buf(), calibration.constants);
        Ok(Self { photons, path, limit, calibration, origins, grey_notes, notes, understood })
    }
}

impl MeasuredOptions {
    /// The same options with absolute paths.
    pub(crate) fn absolute(&self) -> Self {
        let absolute = |path: &Option<PathBuf>| {
            path.as_ref().map(|path| std::path::absolute(path).unwrap_or_else(|_| path.clone()))
        };
        let [camera, dark, flat] = [&self.camera, &self.dark, &self.flat].map(absolute);
        Self { camera, dark, flat, ..self.clone() }
    }

    /// Noise of the camera file: shot noise with its temporal dark noise; `None` without a file or without dark noise.
    ///
    /// # Errors
    /// [`MeasuredError`] where the camera file cannot be read.
    pub fn camera_noise(&self) -> Result<Option<Noise>, MeasuredError> {
        let Some(path) = &self.camera else { return Ok(None) };
        let camera = CalibratedCamera::open(path)?.calibration;
        // Bins add the variances of their pixels.
        let sigma = camera.temporal_dark_noise_electrons * self.calibration.bin.max(1) as f64;
        Ok((sigma > 1e-3).then_some(Noise::ShotRead { sigma: (sigma * 1e4).round() / 1e4 }))
    }

    /// Calibration of the pixels from all sources; dark and flat images go before the maps of the camera.
    fn pixels(&self) -> Result<PixelCalibration, MeasuredError> {
        self.calibration.check()?;
        let has_maps = self.camera.is_some() || self.dark.is_some() || self.flat.is_some();
        if has_maps && self.colour.sums_greens() {
            return Err(MeasuredError::TwoGreens);
        }
        let mut pixels = match &self.camera {
            Some(path) => PixelCalibration::of_camera(&CalibratedCamera::open(path)?, self.calibration.bin),
            None => PixelCalibration::constant(self.calibration),
        };
        if let Some(path) = &self.dark {
            pixels.dark = Some(self.mean_image(path)?);
        }
        if let Some(path) = &self.flat {
            let flat = self.mean_image(path)?;
            if let Some(dark) = &pixels.dark {
                check_map(path, flat.dim(), dark.dim())?;
            }
            pixels.set_response(path, flat)?;
        }
        Ok(pixels)
    }

    /// Mean of all images of a file or folder, DN.
    fn mean_image(&self, path: &Path) -> Result<Array2<f32>, MeasuredError> {
        let (mut sum, mut count): (Option<Array2<f64>>, usize) = (None, 0);
        for file in image_files(path)? {
            let read = self.colour.read(&file)?;
            let Some(plane) = read.planes.into_iter().next() else { continue };
            check_finite(&file.path, &plane)?;
            for image in plane.outer_iter() {
                let sum = sum.get_or_insert_with(|| Array2::zeros(image.dim()));
                check_map(&file.path, image.dim(), sum.dim())?;
                sum.zip_mut_with(&image, |sum, &value| *sum += f64::from(value));
                count += 1;
            }
        }
        let sum = sum.ok_or_else(|| FormatError::malformed(path, "images", "none", "choose another folder"))?;
        Ok(sum.mapv(|sum| (sum / count as f64) as f32))
    }

    /// Summary of the calibration.
    fn describe(&self, pixels: &PixelCalibration) -> String {
        let constants = pixels.constants;
        if self.camera.is_none() && self.dark.is_none() && self.flat.is_none() {
            return constants.describe();
        }
        let Calibration { gain, offset, bin } = constants;
        let dark = match (&self.dark, &pixels.dark) {
            (Some(path), _) => format!("the mean of {}", path.display()),
            (None, Some(_)) => "the dark map of the camera".into(),
            (None, None) => format!("{offset:.2}"),
        };
        let response = match (&self.flat, &pixels.response) {
            (Some(path), _) => format!(" over the response by {}", path.display()),
            (None, Some(_)) => " over the response of the camera".into(),
            (None, None) => String::new(),
        };
        let unit = if self.camera.is_some() { "electrons" } else { "photons" };
        let sum = if bin > 1 { format!(", summed over {bin} x {bin} pixels") } else { String::new() };
        let bad = pixels.bad.as_ref().map_or(0, |bad| bad.iter().filter(|bad| **bad).count());
        let bad = match bad {
            0 => String::new(),
            bad => {
                let pixels = counted(bad, "pixel");
                format!("; {pixels} {} the value of the nearest good one", one_or_many(bad, "has", "have"))
            }
        };
        format!("{unit} are (grey level - {dark}) / {gain:.5}{response} ({:.5} {unit} per DN){sum}{bad}", 1.0 / gain)
    }
}

/// Reads and converts the images of all files.
fn read_images(
    path: &Path,
    options: &MeasuredOptions,
    calibration: &PixelCalibration,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<ConvertedImages, MeasuredError> {
    let files = image_files(path)?;
    let mut photons: Option<Array3<f32>> = None;
    let (mut white, mut values, mut planes, mut colour) = (None, GreyValues::default(), 1, None);
    let mut understood: Option<ImageSummary> = None;
    for (index, file) in files.iter().enumerate() {
        report_step(progress, "Reading measurements", index, files.len())?;
        let read = options.colour.read(file)?;
        let file = &file.path;
        check_depth(file, read.white, &mut white)?;
        let more = converted(file, &read, options, calibration, &mut values)?;
        match &mut understood {
            None => understood = Some(read.summary),
            Some(understood) => understood.join(read.summary),
        }
        planes = read.planes.len();
        colour = read.colour.or(colour);
        match &mut photons {
            None => photons = Some(more),
            Some(photons) => append(photons, &more, file, &read.planes)?,
        }
    }
    let (Some(photons), Some(understood)) = (photons, understood) else {
        return Err(no_images(path).into());
    };
    Ok(ConvertedImages { photons, values, understood, colour, planes })
}

/// Photons of the images of one file, the sum of all their planes.
fn converted(
    file: &Path,
    read: &ChosenFrames,
    options: &MeasuredOptions,
    calibration: &PixelCalibration,
    values: &mut GreyValues,
) -> Result<Array3<f32>, MeasuredError> {
    let mut sum: Option<Array3<f32>> = None;
    for grey in &read.planes {
        if grey.is_empty() {
            let found = format!("an array of shape {:?}", grey.dim());
            return Err(FormatError::malformed(file, "images with pixels", found, "choose another file").into());
        }
        check_finite(file, grey)?;
        values.add(grey.view(), read.white);
        let photons = if let Some(shape) = calibration.shape() {
            check_map(file, (grey.dim().1, grey.dim().2), shape)?;
            let electrons = options.view.of(calibration.electrons(grey.view()))?;
            Calibration { bin: calibration.constants.bin, ..Calibration::default() }.photons(electrons.view())?
        } else {
            calibration.constants.photons(options.view.of(grey.clone())?.view())?
        };
        match &mut sum {
            None => sum = Some(photons),
            Some(sum) => *sum += &photons,
        }
    }
    Ok(sum.unwrap_or_default())
}

/// Refuses files whose grey values have another depth: there is one gain for all.
fn check_depth(file: &Path, found: Option<u16>, expected: &mut Option<u16>) -> Result<(), FormatError> {
    if let (Some(found), Some(expected)) = (found, *expected)
        && found != expected
    {
        let depth = |white: u16| format!("{} bits", bits_of(white));
        let expected = format!("grey levels of {}, as in the files before it", depth(expected));
        let advice = "estimate the files of each depth by themselves, with their own gain";
        return Err(FormatError::malformed(file, expected, depth(found), advice));
    }
    *expected = found.or(*expected);
    Ok(())
}

fn check_map(path: &Path, found: (usize, usize), expected: (usize, usize)) -> Result<(), FormatError> {
    if found == expected {
        return Ok(());
    }
    let size = |(rows, cols): (usize, usize)| format!("{rows} x {cols} px");
    let expected = format!("images of {}, as the maps of the camera or the dark and flat images", size(expected));
    Err(FormatError::malformed(path, expected, size(found), "use frames of the same camera and crop"))
}

fn append(
    photons: &mut Array3<f32>,
    more: &Array3<f32>,
    file: &Path,
    planes: &[Array3<f32>],
) -> Result<(), FormatError> {
    photons.append(Axis(0), more.view()).map_err(|_| {
        let (_, rows, cols) = photons.dim();
        let (_, found_rows, found_cols) = more.dim();
        let (_, file_rows, file_cols) = planes.first().map_or((0, 0, 0), Array3::dim);
        let found = format!("{found_rows} x {found_cols} px ({file_rows} x {file_cols} before binning)");
        let expected = format!("images of {rows} x {cols} px, as the first");
        FormatError::malformed(file, expected, found, "keep images of one camera and one crop in the folder")
    })
}

fn check_finite(file: &Path, grey: &Array3<f32>) -> Result<(), FormatError> {
    match grey.indexed_iter().find(|(_, level)| !level.is_finite()) {
        None => Ok(()),
        Some(((image, row, col), level)) => {
            let found = format!("{level} in image {}, row {row}, column {col}", image + 1);
            Err(FormatError::malformed(file, "finite pixels", found, "replace such pixels or leave the image out"))
        }
    }
}

impl MeasuredSource {
    /// The files of the images.
    ///
    /// # Errors
    /// [`FormatError`] if a folder cannot be read.
    pub fn files(&self) -> Result<Vec<PathBuf>, FormatError> {
        Ok(image_files(self.path())?.into_iter().map(|file| file.path).collect())
    }
}
