//! The prior of a set: that of the beads, or base images to learn one from.

use ndarray::Array2;

use super::{Content, ObjectSet};
use crate::objects::{BeadPrior, Split};

impl ObjectSet {
    /// Prior of the beads; `None` for images, whose prior is unknown.
    pub fn bead_prior(&self) -> Option<BeadPrior> {
        match &self.content {
            Content::Beads(beads) => Some(beads.prior().clone()),
            _ => None,
        }
    }

    /// Side of the tiles, px, where every object is a grid of whole tiles that are drawn independently of each other. `None` for beads, for
    /// whole images, and for a field that cuts tiles at random places.
    pub fn whole_tiles(&self) -> Option<usize> {
        let Content::Mosaic(mosaic, _) = &self.content else { return None };
        let (tile, (rows, cols)) = (mosaic.tile(), self.field);
        (rows.is_multiple_of(tile) && cols.is_multiple_of(tile)).then_some(tile)
    }

    /// The first `most` tiles of a part of the base images, one a row: shape (n, side x side), photons per pixel. Their order is random
    /// and fixed. `None` for objects that are no mosaics.
    pub fn tiles(&self, split: Split, most: usize) -> Option<Array2<f32>> {
        let Content::Mosaic(mosaic, parts) = &self.content else { return None };
        let members = parts.members(split);
        let (side, count) = (mosaic.tile(), members.len().min(most));
        let mut tiles = Array2::zeros((count, side * side));
        for (&image, mut tile) in members.iter().zip(tiles.rows_mut()) {
            mosaic.for_each_pixel(image as usize, |row, col, photons| tile[row * side + col] = photons as f32);
        }
        Some(tiles)
    }

    /// The training part in two sets without common base images, whole sets for training. `None` for beads, and for fewer than four
    /// training images. The mean and the fingerprint stay those of the whole set.
    pub fn halves_of_training(&self) -> Option<[Self; 2]> {
        let (Content::Mosaic(_, parts) | Content::Whole(_, parts)) = &self.content else { return None };
        let halves = parts.halves_of_training()?;
        Some(halves.map(|half| {
            let mut set = self.clone();
            if let Content::Mosaic(_, parts) | Content::Whole(_, parts) = &mut set.content {
                *parts = half;
            }
            set
        }))
    }

    /// Photons per pixel of a truth of 1, the peak of image quality: a count of 255 of 8-bit images, the brightest pixel of others. For
    /// beads it is the unit of the published bead, which sums to 2 and peaks at 0.194.
    pub fn peak(&self) -> f64 {
        match &self.content {
            Content::Beads(beads) => beads.prior().spot.sum() / 2.0,
            Content::Mosaic(mosaic, _) => mosaic.peak(),
            Content::Whole(images, _) => images.peak(),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::formats::write_array;
    use crate::objects::{ObjectOptions, ObjectSet, ObjectSource, Split};
    use ndarray::{Array3, ArrayD, IxDyn};

    /// Sixteen images of 20 x 20 px as an IDX file.
    fn mosaics(field: (usize, usize)) -> ObjectSet {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("images.idx");
        let axes = [16_u32, 20, 20].into_iter().flat_map(u32::to_be_bytes);
        let pixels = (0..16 * 400_u32).map(|index| (index * 7919 % 200) as u8);
        std::fs::write(&path, [0, 0, 8, 3].into_iter().chain(axes).chain(pixels).collect::<Vec<u8>>()).unwrap();
        ObjectSet::open(
            &ObjectSource::Idx(path),
            &ObjectOptions { field, mean_photons: 50.0, ..ObjectOptions::default() },
        )
        .unwrap()
    }

    #[test]
    fn tiles_are_those_of_the_objects() {
        let set = mosaics((64, 32));
        assert_eq!(set.whole_tiles(), Some(32));
        assert_eq!(mosaics((64, 40)).whole_tiles(), None);
        let tiles = set.tiles(Split::Test, usize::MAX).unwrap();
        assert_eq!(tiles.dim(), (3, 1024));
        assert_eq!(set.tiles(Split::Test, 2).unwrap().dim(), (2, 1024));
        let objects = set.objects(Split::Test, 5, 1).unwrap();
        for object in objects.outer_iter() {
            for corner in [0, 32] {
                let found = object.slice(ndarray::s![0, corner..corner + 32, ..]).iter().copied().collect::<Vec<_>>();
                assert!(tiles.rows().into_iter().any(|tile| tile.iter().eq(&found)));
            }
        }
        // The brightest pixel has a count of 199, the peak one of 255.
        let brightest = set.tiles(Split::All, usize::MAX).unwrap().iter().copied().fold(0.0, f32::max);
        assert!((set.peak() / f64::from(brightest) * 199.0 / 255.0 - 1.0).abs() < 1e-6);
    }

    #[test]
    fn peaks_are_the_unit_of_a_bead_and_the_brightest_pixel() {
        let beads = ObjectSet::open(&"beads-max:0.02".parse().unwrap(), &ObjectOptions::default()).unwrap();
        assert!((beads.peak() - 1000.0).abs() < 1e-9 && beads.tiles(Split::Train, 9).is_none());
        assert_eq!(beads.whole_tiles(), None);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stack.npy");
        let stack = Array3::from_shape_fn((4, 15, 16), |(n, row, col)| (n + row * col) as f32);
        let values: ArrayD<f32> = stack.clone().into_shape_with_order(IxDyn(&[4, 15, 16])).unwrap();
        write_array(&path, values.view()).unwrap();
        let set = ObjectSet::open(&ObjectSource::Stack(path), &ObjectOptions::default()).unwrap();
        let expected = 100.0 * 213.0 / f64::from(stack.mean().unwrap());
        assert!((set.peak() / expected - 1.0).abs() < 1e-6, "{} {expected}", set.peak());
    }
}
