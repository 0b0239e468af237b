//! Object sets: opened once, drawn from any number of times.

use std::fmt;
use std::ops::{Range, RangeInclusive};
use std::path::Path;

use ndarray::{Array2, Array4, ArrayViewMut2};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::formats::{FormatError, GreyValues, PixelStack, read_cifar, read_idx, read_stack};
use crate::plural::counted;
use crate::progress::{CancelToken, Progress};

use super::beads::{BeadScale, Beads};
use super::clean::at_limits;
use super::load::{Loaded, Size, load, one_file};
use super::mosaic::Mosaic;
use super::placement::Placement;
use super::split::Parts;
use super::whole_images::WholeImages;
use super::{ObjectError, ObjectSource, Split};

mod base_images;

/// Longest side of an image that is made into mosaics, px.
const LONGEST_TILE_PX: usize = 1024;
/// Longest side of an object, px.
const LONGEST_FIELD_PX: usize = 16_384;
/// Largest number of pixels of an object. Transforms take about forty bytes per pixel.
const MOST_FIELD_PIXELS: usize = 1 << 26;

/// How objects are made from their source.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let options = ObjectOptions { field: (64, 64), ..ObjectOptions::default() };
/// assert_eq!(options.mean_photons, 100.0);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ObjectOptions {
    /// Rows and columns of each object, px; `stack:` objects keep their own.
    pub field: (usize, usize),
    /// Mean over the set, photons per pixel. `beads-max:` has 2000 photons per bead instead.
    pub mean_photons: f64,
    /// How images larger than half the field get its size.
    pub placement: Placement,
}

impl Default for ObjectOptions {
    /// 96 x 96 px and 100 photons per pixel, as in the paper.
    fn default() -> Self {
        Self { field: (96, 96), mean_photons: 100.0, placement: Placement::Scaled }
    }
}

/// Numbers of training images of which a part validates fits to the others. Fewer images would leave too little. Sets of
/// 8,000 images showed no overfitting.
const FEW: RangeInclusive<usize> = 5..=4000;

/// Largest number of objects drawn and measured at a time, and largest number of bytes.
const BATCH: usize = 500;
const BATCH_BYTES: usize = 256 << 20;

/// Progress of reading objects, in files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadProgress {
    /// Files read.
    pub done: usize,
    /// Files to read.
    pub total: usize,
    /// How the files were interpreted, once they are read.
    pub understood: Option<String>,
}

impl ReadProgress {
    pub(super) fn files(done: usize, total: usize) -> Self {
        Self { done, total, understood: None }
    }
}

/// Messages about files for the user.
#[derive(Clone, Debug, Default)]
pub(super) struct FileReport {
    /// How the files were interpreted.
    pub(super) understood: Option<String>,
    /// What was left out or changed.
    pub(super) notices: Vec<String>,
}

impl fmt::Display for ReadProgress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Reading objects, {} of {}", self.done, counted(self.total, "file"))
    }
}

/// Reports a step of reading.
pub(super) fn report_read(progress: &mut dyn Progress<ReadProgress>, step: &ReadProgress) -> Result<(), ObjectError> {
    if progress.report(step).is_break() { Err(ObjectError::Cancelled) } else { Ok(()) }
}

#[derive(Clone, Debug)]
enum Content {
    Beads(Beads),
    Mosaic(Mosaic, Parts),
    Whole(WholeImages, Parts),
}

/// A base image within an object. Its tile may reach beyond the object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlacedImage {
    /// Number of the base image in the set.
    pub image: u32,
    /// Rows of the object that its tile covers.
    pub rows: Range<isize>,
    /// Columns of the object that its tile covers.
    pub cols: Range<isize>,
}

/// A set of objects. It is large and never changes, so it is shared in an `Arc`.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let set = ObjectSet::open(&"beads:0.02".parse()?, &ObjectOptions::default())?;
/// assert_eq!((set.planes(), set.field()), (1, (96, 96)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ObjectSet {
    source: ObjectSource,
    content: Content,
    field: (usize, usize),
    mean: f64,
    report: FileReport,
    fingerprint: String,
}

impl ObjectSet {
    /// Opens a set and loads the files of its source.
    ///
    /// # Errors
    /// [`ObjectError`] if an option is out of range, a file cannot be read, or its pixels cannot be photons: NaN,
    /// infinite, negative by more than 5 % of the largest, or all 0.
    pub fn open(source: &ObjectSource, options: &ObjectOptions) -> Result<Self, ObjectError> {
        Self::open_with(source, options, &mut CancelToken::new())
    }

    /// [`ObjectSet::open`] with reports of the files read.
    ///
    /// # Errors
    /// As [`ObjectSet::open`], and [`ObjectError::Cancelled`].
    pub fn open_with(
        source: &ObjectSource,
        options: &ObjectOptions,
        progress: &mut dyn Progress<ReadProgress>,
    ) -> Result<Self, ObjectError> {
        check(options)?;
        let mut report = FileReport::default();
        let beads = |density, planes, scale| Beads::new(density, planes, options.field, scale).map(Content::Beads);
        let mean = options.mean_photons;
        let content = match source {
            ObjectSource::Beads { density } => beads(*density, 1, BeadScale::Mean(mean))?,
            ObjectSource::BeadsMax { density } => beads(*density, 1, BeadScale::PerBead)?,
            ObjectSource::Volume { planes, density } => beads(*density, *planes, BeadScale::Mean(mean))?,
            ObjectSource::Idx(path) => mosaic(path, vec![one_file(path, read_idx, &mut report, progress)?], mean)?,
            ObjectSource::Cifar(path) => mosaic(path, vec![one_file(path, read_cifar, &mut report, progress)?], mean)?,
            ObjectSource::Images(path) => {
                match load(path, Size { field: options.field, placement: options.placement }, &mut report, progress)? {
                    Loaded::Tiles(stacks) => mosaic(path, stacks, mean)?,
                    Loaded::Whole(stack) => whole(path, stack, mean)?,
                }
            }
            ObjectSource::Stack(path) => {
                let stack = one_file(path, read_stack, &mut report, progress)?;
                let mut values = GreyValues::default();
                values.add_stack(&stack);
                report.notices.splice(0..0, at_limits(&values));
                whole(path, stack, mean)?
            }
        };
        let (field, mean) = match &content {
            Content::Beads(beads) => (beads.field(), beads.mean()),
            Content::Mosaic(..) => (options.field, mean),
            Content::Whole(images, _) => (images.field(), mean),
        };
        let fingerprint = fingerprint(source, &content, field, mean);
        if let Some(understood) = &report.understood {
            let understood = Some(format!("{source}: {understood}"));
            report_read(progress, &ReadProgress { done: 1, total: 1, understood })?;
        }
        Ok(Self { source: source.clone(), content, field, mean, report, fingerprint })
    }

    /// The training part as a set of its own, with the same mean; a tenth of its base images is for testing. It is for
    /// methods whose final test uses the test part of the whole set. Beads stay as they are. The fingerprint stays that
    /// of the whole set.
    #[must_use]
    pub fn of_training(mut self) -> Self {
        if let Content::Mosaic(_, parts) | Content::Whole(_, parts) = &mut self.content {
            *parts = parts.of_training();
        }
        self
    }

    /// The part to fit models on, and the part that validates the fit. There is a validation part where the training
    /// images are few enough for a long fit to overfit.
    pub fn fitting_parts(&self) -> (Split, Option<Split>) {
        match &self.content {
            Content::Mosaic(_, parts) | Content::Whole(_, parts)
                if FEW.contains(&parts.members(Split::Train).len()) =>
            {
                (Split::Fit, Some(Split::Validation))
            }
            _ => (Split::Train, None),
        }
    }

    /// Number of objects to draw and measure at a time.
    pub fn batch(&self) -> usize {
        let bytes = size_of::<f32>() * self.planes() * self.field.0 * self.field.1;
        (BATCH_BYTES / bytes.max(1)).clamp(1, BATCH)
    }

    /// Source of the set.
    pub fn source(&self) -> &ObjectSource {
        &self.source
    }

    /// Depth planes of each object.
    pub fn planes(&self) -> usize {
        match &self.content {
            Content::Beads(beads) => beads.prior().planes,
            _ => 1,
        }
    }

    /// Rows and columns of each object, px.
    pub fn field(&self) -> (usize, usize) {
        self.field
    }

    /// Number of base images; `None` for beads, which are unlimited.
    pub fn base_images(&self) -> Option<usize> {
        match &self.content {
            Content::Beads(_) => None,
            Content::Mosaic(mosaic, _) => Some(mosaic.images()),
            Content::Whole(images, _) => Some(images.images()),
        }
    }

    /// Number of whole images in one part; `None` where objects are drawn without limit.
    pub fn whole_images(&self, split: Split) -> Option<usize> {
        match &self.content {
            Content::Whole(_, parts) => Some(parts.members(split).len()),
            Content::Beads(_) | Content::Mosaic(..) => None,
        }
    }

    /// Whether mean and covariance are the same everywhere in randomly placed patches of shape (rows, cols). Those of
    /// beads are. Those of mosaics are where the patch covers whole tiles, so that it sees every part of a tile equally
    /// often. Whole images may be brighter in the middle.
    pub fn is_stationary(&self, patch: (usize, usize)) -> bool {
        match &self.content {
            Content::Beads(_) => true,
            Content::Mosaic(mosaic, _) => {
                patch.0.is_multiple_of(mosaic.tile()) && patch.1.is_multiple_of(mosaic.tile())
            }
            Content::Whole(..) => false,
        }
    }

    /// Messages for the user about files left out and pixels changed.
    pub fn notices(&self) -> &[String] {
        &self.report.notices
    }

    /// How the files were interpreted: number of images, shape, number type and range. `None` for beads.
    pub fn understood(&self) -> Option<&str> {
        self.report.understood.as_deref()
    }

    /// BLAKE3 hash, in hexadecimal, of the pixels and all settings that determine the drawn objects, for run records.
    /// Sets of equal fingerprint draw equal objects, wherever their files lie.
    pub fn fingerprint(&self) -> String {
        self.fingerprint.clone()
    }

    /// Description in one line.
    pub fn describe(&self) -> String {
        let (rows, cols) = self.field;
        let end = format!("{rows} x {cols} px, mean {:.4} photons/px", self.mean);
        match &self.content {
            Content::Beads(beads) => {
                let planes = match self.planes() {
                    1 => String::new(),
                    planes => format!("{planes} planes of "),
                };
                let probability = beads.prior().probability;
                let count = counted(beads.beads_per_plane(), "bead");
                format!("{planes}{count} at random pixels (density {probability:.4}), {end}")
            }
            Content::Mosaic(mosaic, _) => {
                let (images, tile) = (counted(mosaic.images(), "image"), mosaic.tile());
                format!("mosaics of {images} in tiles of {tile} x {tile} px, {end}")
            }
            Content::Whole(images, _) => {
                format!("{}, {end}", counted(images.images(), "whole image"))
            }
        }
    }

    /// Draws `count` objects, shape (count, planes, rows, cols), photons per pixel.
    ///
    /// Object `i` of a part and seed does not depend on `count` or the number of threads. Beads are drawn for each
    /// object. Mosaics draw their tiles with replacement. Whole images come in an order that depends on the seed, and
    /// repeat after all have been used.
    ///
    /// # Errors
    /// [`ObjectError::EmptySplit`] if no base image is in that part, [`ObjectError::TooMany`] if memory does not
    /// suffice.
    pub fn objects(&self, split: Split, count: usize, seed: u64) -> Result<Array4<f32>, ObjectError> {
        self.objects_from(split, 0, count, seed)
    }

    /// Objects `first` to `first + count - 1` of those that [`ObjectSet::objects`] draws. Large sets can so be drawn in
    /// parts.
    ///
    /// # Errors
    /// As [`ObjectSet::objects`].
    pub fn objects_from(
        &self,
        split: Split,
        first: usize,
        count: usize,
        seed: u64,
    ) -> Result<Array4<f32>, ObjectError> {
        let ((rows, cols), planes) = (self.field, self.planes());
        let too_many = || ObjectError::TooMany { count, planes, rows, cols };
        let pixels = rows * cols;
        let length = count.checked_mul(planes).and_then(|product| product.checked_mul(pixels)).ok_or_else(too_many)?;
        let members = match &self.content {
            Content::Beads(_) => Vec::new(),
            Content::Mosaic(_, parts) => parts.members(split).to_vec(),
            Content::Whole(_, parts) => WholeImages::order(parts.members(split), split, seed),
        };
        if let (Some(images), true) = (self.base_images(), members.is_empty()) {
            return Err(ObjectError::EmptySplit { split, source_name: self.source.to_string(), images });
        }
        let mut photons = Vec::new();
        photons.try_reserve_exact(length).map_err(|_| too_many())?;
        photons.resize(length, 0.0);
        photons.par_chunks_mut(planes * pixels).enumerate().for_each(|(offset, object)| {
            let index = first.wrapping_add(offset);
            let mut generator = split.generator(seed, index as u64);
            for plane in object.chunks_mut(pixels) {
                let plane = view((rows, cols), plane);
                match &self.content {
                    Content::Beads(beads) => beads.draw(&mut generator, plane),
                    Content::Mosaic(mosaic, _) => mosaic.draw(&mut generator, &members, plane),
                    Content::Whole(images, _) => images.copy(members[index % members.len()] as usize, plane),
                }
            }
        });
        Array4::from_shape_vec((count, planes, rows, cols), photons).map_err(|_| too_many())
    }

    /// Base images in objects `first` to `first + count - 1` of those that [`ObjectSet::objects`] draws, with their
    /// places. `None` for beads, which are new in each object.
    pub fn images_from(&self, split: Split, first: usize, count: usize, seed: u64) -> Option<Vec<Vec<PlacedImage>>> {
        let objects = first..first.saturating_add(count);
        match &self.content {
            Content::Beads(_) => None,
            Content::Mosaic(mosaic, parts) => {
                let (members, side) = (parts.members(split), mosaic.tile() as isize);
                let tiles = |index: usize| {
                    let mut generator = split.generator(seed, index as u64);
                    let tiles = mosaic.tiles(&mut generator, members, self.field).into_iter();
                    tiles.map(|(image, row, col)| PlacedImage { image, rows: row..row + side, cols: col..col + side })
                };
                Some(if members.is_empty() {
                    Vec::new()
                } else {
                    objects.map(|index| tiles(index).collect()).collect()
                })
            }
            Content::Whole(_, parts) => {
                let order = WholeImages::order(parts.members(split), split, seed);
                let (rows, cols) = (self.field.0 as isize, self.field.1 as isize);
                let whole =
                    |index: usize| PlacedImage { image: order[index % order.len()], rows: 0..rows, cols: 0..cols };
                Some(if order.is_empty() { Vec::new() } else { objects.map(|index| vec![whole(index)]).collect() })
            }
        }
    }

    /// Mean over the set, photons per pixel. For beads it is the expectation, including the loss at the border.
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Autocovariance of one plane of the objects of a split, as a stationary process, photons squared. For `max_lag` L
    /// the shape is `(2 L + 1, 2 L + 1)`. Element `[L + dr, L + dc]` belongs to a lag of `dr` rows and `dc` columns.
    ///
    /// - Beads: `p (1 - p)` times the autocorrelation of the spot. The border is neglected. So is the correlation
    ///   of `-1 / (number of pixels)` that a fixed number of beads causes.
    /// - Mosaics: exact for an endless mosaic of independent tiles at a random place.
    /// - Whole images: the mean unbiased estimate. Its spectrum is clipped at 0 (with period 2 L + 1) and the variance is
    ///   preserved.
    ///
    /// Every block-Toeplitz matrix of these lags is a covariance. Planes of a volume are independent and have the same
    /// distribution.
    pub fn autocovariance(&self, split: Split, max_lag: usize) -> Array2<f64> {
        match &self.content {
            Content::Beads(beads) => beads.autocovariance(max_lag),
            Content::Mosaic(mosaic, parts) => mosaic.autocovariance(parts.members(split), max_lag),
            Content::Whole(images, parts) => images.autocovariance(parts.members(split), max_lag),
        }
    }
}

fn check(options: &ObjectOptions) -> Result<(), ObjectError> {
    let (rows, cols) = options.field;
    let sides = 1..=LONGEST_FIELD_PX;
    if !sides.contains(&rows) || !sides.contains(&cols) {
        let expected = format!("1 to {LONGEST_FIELD_PX} px a side");
        return Err(ObjectError::Option { name: "field", expected, found: format!("{rows} x {cols} px") });
    }
    let mean = options.mean_photons;
    if !(mean > 0.0 && mean <= 1e12) {
        let expected = "more than 0 and at most 1e12 photons per pixel".into();
        return Err(ObjectError::Option { name: "mean_photons", expected, found: mean.to_string() });
    }
    Ok(())
}

fn mosaic(path: &Path, stacks: Vec<PixelStack>, mean: f64) -> Result<Content, ObjectError> {
    if let Some(stack) = stacks.iter().find(|stack| stack.rows.max(stack.cols) > LONGEST_TILE_PX) {
        let expected = format!("images of at most {LONGEST_TILE_PX} px a side for mosaics");
        let found = format!("{} x {} px", stack.rows, stack.cols);
        return Err(FormatError::malformed(path, expected, found, "open them with images: or stack: instead").into());
    }
    let mosaic = Mosaic::new(stacks, mean).ok_or_else(|| dark(path))?;
    let parts = Parts::new(mosaic.images());
    Ok(Content::Mosaic(mosaic, parts))
}

fn whole(path: &Path, stack: PixelStack, mean: f64) -> Result<Content, ObjectError> {
    if stack.rows.max(stack.cols) > LONGEST_FIELD_PX || stack.rows * stack.cols > MOST_FIELD_PIXELS {
        let expected = format!("images of at most {LONGEST_FIELD_PX} px a side and {MOST_FIELD_PIXELS} pixels");
        let found = format!("{} x {} px", stack.rows, stack.cols);
        return Err(FormatError::malformed(path, expected, found, "crop or shrink them").into());
    }
    let images = WholeImages::new(stack, mean).ok_or_else(|| dark(path))?;
    let parts = Parts::new(images.images());
    Ok(Content::Whole(images, parts))
}

fn dark(path: &Path) -> FormatError {
    FormatError::malformed(path, "some light", "pixels that are all 0", "choose images with content")
}

/// One plane of an object as an array.
fn view(shape: (usize, usize), plane: &mut [f32]) -> ArrayViewMut2<'_, f32> {
    ArrayViewMut2::from_shape(shape, plane).expect("planes are cut to rows * cols pixels")
}

fn fingerprint(source: &ObjectSource, content: &Content, field: (usize, usize), mean: f64) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"lenslet studio objects 1");
    hasher.update(&(field.0 as u64).to_le_bytes());
    hasher.update(&(field.1 as u64).to_le_bytes());
    hasher.update(&mean.to_le_bytes());
    match content {
        Content::Beads(_) => {
            hasher.update(source.to_string().as_bytes());
        }
        Content::Mosaic(mosaic, _) => {
            hasher.update(b"mosaic");
            mosaic.hash_into(&mut hasher);
        }
        Content::Whole(images, _) => {
            hasher.update(b"whole");
            images.hash_into(&mut hasher);
        }
    }
    hasher.finalize().to_hex().to_string()
}
