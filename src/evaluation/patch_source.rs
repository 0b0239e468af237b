//! Patches of a design's simulated measurements, each of an object of its own.

use std::cell::RefCell;
use std::rc::Rc;

use ndarray::{Array3, ArrayView3, Axis};

use crate::evaluation::progress::{EstimateProgress, report_step};
use crate::evaluation::scene::EvaluationError;
use crate::forward::{Design, ForwardModel};
use crate::information::{InformationError, ObjectDraw, Protocol, SharedImages, Trial};
use crate::objects::Split;
use crate::progress::Progress;
use crate::seeds::SeedStream;
use crate::sensor::{Convolver, Noise, Patches};

/// Most bytes that the clean or the noisy patches of one kind may take.
pub(crate) const LARGEST_PATCHES_BYTES: usize = 4 << 30;

/// The base images that test patches show.
struct Shown {
    patches: usize,
    seed: u64,
    images: Rc<SharedImages>,
}

/// Source of patches.
pub(crate) struct PatchSource<'a> {
    pub design: &'a Design,
    pub forward: &'a ForwardModel,
    /// Convolver for the PSF of the design.
    pub convolver: &'a Convolver,
    pub patch: (usize, usize),
    pub protocol: Protocol,
    /// The base images that were asked for last.
    shown: RefCell<Option<Shown>>,
}

impl<'a> PatchSource<'a> {
    /// Source of the patches of a design and its forward, with the convolver for its PSF.
    pub fn new(
        design: &'a Design,
        forward: &'a ForwardModel,
        convolver: &'a Convolver,
        patch: (usize, usize),
        protocol: Protocol,
    ) -> Self {
        Self { design, forward, convolver, patch, protocol, shown: RefCell::default() }
    }

    /// Parts of the set to train and to test on.
    pub fn splits(&self) -> (Split, Split) {
        match self.protocol {
            Protocol::Default => (Split::Train, Split::Test),
            Protocol::Paper => (Split::All, Split::All),
        }
    }

    /// Seed of the test patches of a trial. All trials have the same, since the smallest of estimates on other scenes would
    /// be that of the dullest ones; published trials have their own.
    pub fn test_seed(&self, trial: u64) -> u64 {
        match self.protocol {
            Protocol::Default => SeedStream::TestPatches.derive(self.design.seed),
            Protocol::Paper => SeedStream::TestPatches.derive(trial),
        }
    }

    /// The batch of objects of one part of the patches.
    fn part(&self, split: Split, index: usize, seed: u64) -> Batch {
        let first = index * self.forward.set.batch();
        let place_seed = SeedStream::Batch { first }.derive(seed);
        // Whole images come in one order, so that none comes again before all have come.
        match self.forward.set.whole_images(split) {
            Some(_) => Batch { first, object_seed: seed, place_seed },
            None => Batch { first: 0, object_seed: place_seed, place_seed },
        }
    }

    /// A trial with an interval that counts the base images which its test patches share ([`Trial::with_clustered_interval`]).
    pub fn with_clustered_interval(&self, trial: Trial, patches: usize, seed: u64) -> Result<Trial, EvaluationError> {
        let images = self.images(patches, seed)?;
        Ok(images.iter().fold(trial, |trial, images| trial.with_clustered_interval(images)))
    }

    /// The base images that the test patches of a trial show, where their objects have any.
    pub fn images(&self, patches: usize, seed: u64) -> Result<Option<Rc<SharedImages>>, EvaluationError> {
        let (set, (_, split)) = (&self.forward.set, self.splits());
        if set.base_images().is_none() {
            return Ok(None);
        }
        let seed = self.test_seed(seed);
        if let Some(shown) = &*self.shown.borrow()
            && (shown.patches, shown.seed) == (patches, seed)
        {
            return Ok(Some(Rc::clone(&shown.images)));
        }
        let psf = self.forward.psf(self.design)?;
        let images = Rc::new(self.shared(psf.view(), split, patches, seed)?);
        self.shown.replace(Some(Shown { patches, seed, images: Rc::clone(&images) }));
        Ok(Some(images))
    }

    /// The base images that the patches show which are drawn of a part with a seed.
    fn shared(
        &self,
        psf: ArrayView3<'_, f64>,
        split: Split,
        patches: usize,
        seed: u64,
    ) -> Result<SharedImages, EvaluationError> {
        let (rows, cols) = self.convolver.plan().measurement_shape();
        let mut shared = SharedImages::default();
        for (index, first) in (0..patches).step_by(self.forward.set.batch()).enumerate() {
            let Batch { first: object, object_seed, place_seed } = self.part(split, index, seed);
            let places =
                Patches::one_each((self.forward.set.batch().min(patches - first), rows, cols), self.patch, place_seed)?;
            let objects = ObjectDraw { split, first: object, seed: object_seed };
            let part = self.forward.shared_images(psf, self.patch, objects, &places);
            shared = shared.and(part.unwrap_or_default());
        }
        Ok(shared)
    }

    /// Noiseless and noisy patches, each of an object of its own.
    pub fn draw(
        &self,
        split: Split,
        count: usize,
        seed: u64,
        role: PatchRole,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<(Array3<f32>, Array3<f32>), EvaluationError> {
        let (rows, cols) = self.patch;
        let pixels = rows * cols;
        if count == 0 {
            return Err(InformationError::TooFewPatches { model: role.user(), needed: 1, found: 0, pixels }.into());
        }
        let most = LARGEST_PATCHES_BYTES / (size_of::<f32>() * pixels.max(1));
        if count > most {
            return Err(InformationError::TooManyPatches { count, rows, cols, most }.into());
        }
        let mut clean = Array3::zeros((count, rows, cols));
        for (index, mut part) in clean.axis_chunks_iter_mut(Axis(0), self.forward.set.batch()).enumerate() {
            report_step(progress, role.name(), index * self.forward.set.batch(), count)?;
            let batch = self.part(split, index, seed);
            let objects = self.forward.set.objects_from(split, batch.first, part.len_of(Axis(0)), batch.object_seed)?;
            let encoded = self.convolver.measure(objects.view(), self.design.bias_photons)?;
            part.assign(&Patches::one_each(encoded.dim(), self.patch, batch.place_seed)?.cut(encoded.view()));
        }
        let mut noisy = self.design.noise.draw(clean.view(), SeedStream::BatchNoise.derive(seed));
        if self.protocol == Protocol::Paper && matches!(self.design.noise, Noise::Read { .. }) {
            // As published: read noise does not take a pixel below 0.
            noisy.mapv_inplace(|value| value.max(0.0));
        }
        Ok((clean, noisy))
    }
}

/// A batch of objects, with one patch cut from each.
struct Batch {
    /// Number of the first object.
    first: usize,
    object_seed: u64,
    place_seed: u64,
}

/// Purpose of patches that are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PatchRole {
    /// A model is fitted to them.
    Training,
    /// A model is scored on them.
    Test,
}

impl PatchRole {
    /// Name of the step that draws them.
    fn name(self) -> &'static str {
        match self {
            Self::Training => "Training patches",
            Self::Test => "Test patches",
        }
    }

    /// What they are for, in messages.
    fn user(self) -> &'static str {
        match self {
            Self::Training => "the fit",
            Self::Test => "the test",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::open_set_with;
    use crate::objects::ObjectSource;
    use crate::progress::CancelToken;

    #[test]
    fn intervals_know_the_images_that_test_patches_show() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("images.idx");
        // Image k is k + 1 everywhere, as large as a tile.
        let mut bytes: Vec<u8> = vec![0, 0, 8, 3, 0, 0, 0, 50, 0, 0, 0, 32, 0, 0, 0, 32];
        bytes.extend((1..=50).flat_map(|level| [level; 32 * 32]));
        std::fs::write(&path, bytes).unwrap();
        let mosaics = Design { objects: ObjectSource::Idx(path), ..Design::default() };
        let pages = folder.path().join("pages.npy");
        let page = |(page, _, _)| page as f32 + 1.0;
        crate::formats::write_array(&pages, Array3::from_shape_fn((50, 40, 40), page).view()).unwrap();
        let whole = Design { objects: ObjectSource::Stack(pages), ..mosaics.clone() };
        for (design, grid) in [(mosaics, (32, 32)), (whole, (16, 16))] {
            let set = open_set_with(&design, &mut CancelToken::new()).unwrap();
            let forward = ForwardModel::new(set.clone(), grid, 10.0, design.noise).unwrap();
            let mut psf = Array3::zeros((1, grid.0, grid.1));
            psf[[0, 9, 4]] = 1.0;
            let convolver = forward.convolver(psf.view()).unwrap();
            let (design, patch, protocol) = (&design, (12, 15), Protocol::Default);
            let source = PatchSource::new(design, &forward, &convolver, patch, protocol);
            let count = 2 * set.batch() + 7;
            let (clean, _) = source.draw(Split::Test, count, 3, PatchRole::Test, &mut CancelToken::new()).unwrap();
            let shared = source.shared(psf.view(), Split::Test, count, 3).unwrap();
            assert_eq!((shared.shares().len(), shared.images()), (count, 10));
            for (patch, shares) in clean.outer_iter().zip(shared.shares()) {
                let expected: f64 = shares.iter().map(|(image, share)| share * f64::from(image + 1)).sum();
                let found = (f64::from(patch.mean().unwrap()) - 10.0) * 25.5 / 100.0;
                assert!((found - expected).abs() < 0.15, "{found} {expected}");
            }
        }
    }
}
