//! Notices about numbers from few images.

use super::protocol::{DecoderQuality, DecoderScene};
use crate::objects::{ObjectSet, Split};
use crate::plural::counted;

/// Training images below which the closed form of the linear estimate is reported as inexact. On MNIST and Fashion-MNIST it is up to 1 dB
/// off with 160 to 720 images and 12 to 21 dB with 48, but 0.2 dB at most with 1,200 and more: one mask, 200 test objects.
const EXACT_TRAINING: usize = 1000;
/// Fewest held-out images of a test without a notice. The standard error of their mean is a tenth of the deviation between images.
const MANY_TEST: usize = 100;

impl DecoderScene {
    /// Notices about results whose images are few: a closed form from few training images, and test objects from few held-out images.
    pub fn notices(&self, quality: &DecoderQuality) -> Vec<String> {
        let mut notices = Vec::new();
        if quality.psnr_linear_closed_form_db.is_some()
            && let Some(count) = images_of(&self.set, Split::Train, EXACT_TRAINING)
        {
            notices.push(format!(
                "the closed form comes from {}: below {EXACT_TRAINING} it can be far from the PSNR of the test objects",
                counted(count, "training image")
            ));
        }
        if let Some(count) = images_of(&self.set, Split::Test, MANY_TEST) {
            notices.push(format!(
                "the test objects are made of {}: intervals do not cover the choice of these images",
                counted(count, "held-out image")
            ));
        }
        notices
    }
}

/// Base images of a part, where they are fewer than `enough`.
fn images_of(set: &ObjectSet, split: Split, enough: usize) -> Option<usize> {
    let count = set.whole_images(split).or_else(|| set.tiles(split, enough).map(|tiles| tiles.nrows()))?;
    (count < enough).then_some(count)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::forward::{Design, ForwardModel};
    use crate::information::Protocol;
    use crate::objects::{ObjectOptions, ObjectSource};
    use crate::progress::CancelToken;
    use crate::reconstruction::protocol::DecoderTest;
    use crate::reconstruction::{DecoderKind, ReconstructionError};

    #[test]
    fn few_images_are_reported_and_many_are_not() {
        let design = Design::default();
        let scene = DecoderScene::new(&ForwardModel::open(&design).unwrap(), Protocol::Default).unwrap();
        let model = scene.model(design.psf(1).unwrap().view()).unwrap();
        let decoder = DecoderKind::Linear.decoder(Some(Arc::new(scene.prior(&CancelToken::new()).unwrap())), None);
        let test = DecoderTest { objects: 2, seed: 1 };
        let quality = test
            .run::<ReconstructionError>(&*decoder.unwrap(), &scene, &model, &mut CancelToken::new(), &mut |_| Ok(()))
            .unwrap();
        assert!(quality.psnr_linear_closed_form_db.is_some());
        assert!(scene.notices(&quality).is_empty(), "beads are without limit");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("images.idx");
        let of = |count: u32| {
            let axes = [count, 4, 4].into_iter().flat_map(u32::to_be_bytes);
            let pixels = (0..count * 16).map(|index| (index * 7919 % 200) as u8);
            std::fs::write(&path, [0, 0, 8, 3].into_iter().chain(axes).chain(pixels).collect::<Vec<u8>>()).unwrap();
            let options = ObjectOptions { field: (96, 96), ..ObjectOptions::default() };
            let set = Arc::new(ObjectSet::open(&ObjectSource::Idx(path.clone()), &options).unwrap());
            DecoderScene { set, ..scene.clone() }.notices(&quality)
        };
        let few = of(60);
        assert!(few[0].contains("48 training images") && few[1].contains("12 held-out images"), "{few:?}");
        assert!(of(1250).is_empty());
        let without = DecoderQuality { psnr_linear_closed_form_db: None, ..quality.clone() };
        assert!(of(1249).len() == 1 && scene.notices(&without).is_empty());
    }
}
