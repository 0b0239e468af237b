//! Whole sets of objects: photons, splits, statistics, and real images where they are available.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use lenslet_studio::formats::{FormatError, PixelStack, read_cifar, read_idx, write_array, write_png8};
use lenslet_studio::objects::{ObjectError, ObjectOptions, ObjectSet, ObjectSource, ReadProgress, Split};
use ndarray::{Array2, Array3, Array4, ArrayView2, Axis};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn open(source: &str) -> ObjectSet {
    ObjectSet::open(&source.parse().unwrap(), &ObjectOptions::default()).unwrap()
}

fn with_field(source: &ObjectSource, field: (usize, usize)) -> ObjectSet {
    ObjectSet::open(source, &ObjectOptions { field, ..ObjectOptions::default() }).unwrap()
}

/// An IDX file of random 28 x 28 px images that are brighter at the top. Each image adds a different grey level.
fn idx_file(folder: &Path, images: usize) -> ObjectSource {
    let mut generator = ChaCha8Rng::seed_from_u64(3);
    let mut bytes = vec![0, 0, 8, 3];
    for axis in [images as u32, 28, 28] {
        bytes.extend(axis.to_be_bytes());
    }
    for _ in 0..images {
        let level = generator.random_range(0..100_u8);
        bytes.extend(
            (0..28 * 28_u32).map(|pixel| level + (100 - 3 * (pixel / 28)) as u8 + generator.random_range(0..50_u8)),
        );
    }
    let path = folder.join("images.idx");
    std::fs::write(&path, bytes).unwrap();
    ObjectSource::Idx(path)
}

/// Mean product of deviations of pixels a lag apart, over the first pixels of `rows` and `cols`.
fn sample_covariance(
    objects: &Array4<f32>,
    mean: f64,
    rows: std::ops::Range<usize>,
    cols: std::ops::Range<usize>,
    (down, right): (usize, usize),
) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for object in
        objects.outer_iter().flat_map(|object| object.outer_iter().map(|plane| plane.to_owned()).collect::<Vec<_>>())
    {
        for row in rows.clone() {
            for col in cols.clone() {
                let deviation = |row: usize, col: usize| f64::from(object[[row, col]]) - mean;
                sum += deviation(row, col) * deviation(row + down, col + right);
                count += 1.0;
            }
        }
    }
    sum / count
}

/// Square root of the coefficient of variation of Sobel gradient magnitudes, edge pixels repeated.
fn tamura(object: &ArrayView2<f32>) -> f64 {
    let (rows, cols) = object.dim();
    let magnitudes = Array2::from_shape_fn((rows, cols), |(row, col)| {
        let at = |down: isize, right: isize| {
            let row = row.saturating_add_signed(down).min(rows - 1);
            f64::from(object[[row, col.saturating_add_signed(right).min(cols - 1)]])
        };
        let across = at(-1, 1) + 2.0 * at(0, 1) + at(1, 1) - at(-1, -1) - 2.0 * at(0, -1) - at(1, -1);
        let down = at(1, -1) + 2.0 * at(1, 0) + at(1, 1) - at(-1, -1) - 2.0 * at(-1, 0) - at(-1, 1);
        across.hypot(down)
    });
    (magnitudes.std(0.0) / magnitudes.mean().unwrap()).sqrt()
}

fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared").join(name);
    if !path.exists() {
        println!("skipped: ../shared is absent");
        return None;
    }
    Some(path)
}

#[test]
fn an_object_depends_on_seed_and_split_and_not_on_the_count_or_threads() {
    let folder = tempfile::tempdir().unwrap();
    let mosaics = idx_file(folder.path(), 20).to_string();
    for source in ["beads:0.02", "volume:3:0.01", &mosaics] {
        let set = open(source);
        let many = set.objects(Split::Train, 5, 7).unwrap();
        let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let few = one_thread.install(|| set.objects(Split::Train, 2, 7).unwrap());
        assert_eq!(many.dim(), (5, set.planes(), 96, 96));
        assert_eq!(many.slice_axis(Axis(0), (0..2).into()), few);
        assert_ne!(many.index_axis(Axis(0), 0), many.index_axis(Axis(0), 1));
        assert_ne!(set.objects(Split::Train, 2, 8).unwrap(), few);
        assert_ne!(set.objects(Split::Test, 2, 7).unwrap(), few);
        assert_eq!(set.objects(Split::All, 0, 0).unwrap().len(), 0);
        assert!(matches!(set.objects(Split::All, usize::MAX / 100, 0), Err(ObjectError::TooMany { .. })));
    }
    let volume = open("volume:3:0.01").objects(Split::All, 1, 0).unwrap();
    assert_ne!(volume.index_axis(Axis(1), 0), volume.index_axis(Axis(1), 1));
}

#[test]
fn sets_have_the_mean_that_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let mosaics = idx_file(folder.path(), 40).to_string();
    for (source, tolerance) in [("beads:0.05", 0.3), ("volume:5:0.008", 0.3), (&mosaics, 2.0)] {
        let set = open(source);
        let mean = set.objects(Split::All, 200, 1).unwrap().mapv(f64::from).mean().unwrap();
        assert!((mean - 100.0).abs() < tolerance && (set.mean() - 100.0).abs() < 1e-9, "{source}: {mean}");
    }
    let per_bead = open("beads-max:0.05");
    let mean = per_bead.objects(Split::All, 100, 1).unwrap().mapv(f64::from).mean().unwrap();
    assert!((mean / per_bead.mean() - 1.0).abs() < 3e-3, "{mean} against {}", per_bead.mean());
    // 460 beads of 2000 photons on 9216 px, less a few percent at the border.
    assert!((per_bead.mean() / (460.0 * 2000.0 / 9216.0) - 0.98).abs() < 0.01);
}

#[test]
fn a_source_of_beads_is_one_whose_prior_leaves_something_to_tell() {
    for text in ["beads:0.02", "beads-max:0.05", "volume:3:0.02", "beads:1"] {
        let source: ObjectSource = text.parse().unwrap();
        let prior = open(text).bead_prior();
        assert_eq!(source.is_beads(), prior.is_some_and(|prior| prior.probability < 1.0), "{text}");
    }
}

#[test]
fn bead_autocovariance_is_that_of_the_objects() {
    let set = open("beads:0.02");
    let objects = set.objects(Split::All, 150, 2).unwrap();
    let prior = set.bead_prior().unwrap();
    let interior = prior.probability * prior.spot.sum();
    let expected = set.autocovariance(Split::All, 12);
    let variance = expected[[12, 12]];
    for lag in [(0, 0), (0, 1), (1, 1), (2, 0), (3, 3), (1, 4), (0, 12)] {
        let value = sample_covariance(&objects, interior, 8..76, 8..76, lag);
        let expected = expected[[12 + lag.0, 12 + lag.1]];
        assert!((value - expected).abs() < 0.015 * variance, "{lag:?}: {value} against {expected}");
    }
}

#[test]
fn mosaic_autocovariance_is_that_of_the_objects() {
    let folder = tempfile::tempdir().unwrap();
    let source = idx_file(folder.path(), 30);
    // Five tiles a side: the first pixels cover four whole tiles, so every place in a tile has equal weight.
    let set = with_field(&source, (160, 160));
    let objects = set.objects(Split::All, 60, 2).unwrap();
    let expected = set.autocovariance(Split::All, 32);
    let variance = expected[[32, 32]];
    for lag in [(0, 0), (0, 1), (5, 3), (16, 0), (0, 31), (32, 0), (32, 32)] {
        let value = sample_covariance(&objects, set.mean(), 0..128, 0..128, lag);
        let expected = expected[[32 + lag.0, 32 + lag.1]];
        assert!((value - expected).abs() < 0.03 * variance, "{lag:?}: {value} against {expected}");
    }
}

#[test]
fn train_and_test_share_no_image_whatever_their_seeds() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stack.npy");
    // Image k is k + 1 everywhere, so each object identifies its image.
    let images = Array3::from_shape_fn((10, 20, 30), |(image, _, _)| image as f32 + 1.0);
    write_array(&path, images.view()).unwrap();
    let set = open(&format!("stack:{}", path.display()));
    assert_eq!((set.field(), set.base_images(), set.planes()), ((20, 30), Some(10), 1));
    let levels = |split, seed| {
        let objects = set.objects(split, 30, seed).unwrap();
        let mut levels: Vec<u32> =
            objects.outer_iter().map(|object| (object[[0, 3, 4]] * 5.5 / 100.0).round() as u32).collect();
        assert!(levels.chunks(levels.len() / 3).all(|turn| turn.len() == 10));
        levels.sort_unstable();
        levels.dedup();
        levels
    };
    let (train, test) = (levels(Split::Train, 1), levels(Split::Test, 2));
    assert_eq!((train.len(), test.len()), (8, 2));
    assert_eq!((levels(Split::Train, 9), levels(Split::Test, 9)), (train.clone(), test.clone()));
    let mut all = [train, test].concat();
    all.sort_unstable();
    assert_eq!(all, (1..=10).collect::<Vec<u32>>());
}

#[test]
fn a_single_image_has_no_test_part() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one.png");
    write_png8(&path, Array2::from_shape_fn((100, 120), |(row, _)| row as f32).view(), 0.0, 100.0).unwrap();
    let set = open(&format!("images:{}", path.display()));
    assert_eq!(set.objects(Split::Train, 3, 0).unwrap().dim(), (3, 1, 96, 96));
    let error = set.objects(Split::Test, 1, 0).unwrap_err().to_string();
    assert!(error.contains("test objects of images:") && error.contains("among 1"), "{error}");
}

#[test]
fn a_folder_tells_what_it_left_out_and_can_be_cancelled() {
    let folder = tempfile::tempdir().unwrap();
    let image = |level: f32| Array2::from_shape_fn((100, 100), move |(row, col)| level * (row + col) as f32);
    write_png8(&folder.path().join("b.png"), image(1.0).view(), 0.0, 200.0).unwrap();
    write_array(&folder.path().join("a.npy"), image(0.1).view()).unwrap();
    std::fs::write(folder.path().join("c.tif"), b"no image").unwrap();
    std::fs::write(folder.path().join("notes.txt"), b"no image").unwrap();
    let source = ObjectSource::Images(folder.path().to_path_buf());
    let set = ObjectSet::open(&source, &ObjectOptions::default()).unwrap();
    assert_eq!(set.base_images(), Some(2));
    let [left_out, mixed, scaled] = set.notices() else { panic!("{:?}", set.notices()) };
    assert_eq!(left_out, "1 unreadable file was left out: c.tif");
    assert!(mixed.starts_with("1 of 2 files holds values without a range"), "{mixed}");
    assert_eq!(scaled, "objects are scaled from 100 x 100 px to 96 x 96 px");
    let understood = "2 images of 100 x 100 px in 2 files, several number types, range 0 to 252";
    assert_eq!(set.understood(), Some(understood));
    let cancelled =
        ObjectSet::open_with(&source, &ObjectOptions::default(), &mut |_: &ReadProgress| ControlFlow::Break(()));
    assert!(matches!(cancelled, Err(ObjectError::Cancelled)));

    write_array(&folder.path().join("d.npy"), image(f32::NAN).view()).unwrap();
    let error = ObjectSet::open(&source, &ObjectOptions::default()).unwrap_err().to_string();
    assert!(error.contains("d.npy") && error.contains("found NaN in image 1, row 0, column 0"), "{error}");
    write_array(&folder.path().join("d.npy"), Array2::<f32>::zeros((4, 4)).view()).unwrap();
    let dark = ObjectSource::Stack(folder.path().join("d.npy"));
    assert!(ObjectSet::open(&dark, &ObjectOptions::default()).unwrap_err().to_string().contains("all 0"));
    let none = ObjectSource::Images(folder.path().join("none"));
    assert!(ObjectSet::open(&none, &ObjectOptions::default()).unwrap_err().to_string().contains("found nothing"));
}

#[test]
fn fingerprints_tell_sets_apart_by_content_and_not_by_place() {
    let folder = tempfile::tempdir().unwrap();
    let source = idx_file(folder.path(), 5);
    let first = with_field(&source, (96, 96));
    let moved = folder.path().join("moved.idx");
    std::fs::copy(folder.path().join("images.idx"), &moved).unwrap();
    assert_eq!(with_field(&ObjectSource::Idx(moved.clone()), (96, 96)).fingerprint(), first.fingerprint());
    assert_ne!(with_field(&source, (96, 64)).fingerprint(), first.fingerprint());
    let mut bytes = std::fs::read(&moved).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&moved, bytes).unwrap();
    assert_ne!(with_field(&ObjectSource::Idx(moved), (96, 96)).fingerprint(), first.fingerprint());
    assert_ne!(open("beads:0.02").fingerprint(), open("beads:0.03").fingerprint());
    assert_eq!(open("beads:0.02").fingerprint().len(), 64);
}

#[test]
fn options_outside_their_range_are_refused() {
    let source: ObjectSource = "beads:0.02".parse().unwrap();
    for (field, mean_photons, told) in [
        ((0, 96), 100.0, "field"),
        ((96, 1 << 20), 100.0, "field"),
        ((96, 96), 0.0, "mean_photons"),
        ((96, 96), f64::NAN, "mean_photons"),
        ((5, 5), 100.0, "one bead"),
    ] {
        let error = ObjectSet::open(&source, &ObjectOptions { field, mean_photons, ..ObjectOptions::default() })
            .unwrap_err()
            .to_string();
        assert!(error.contains(told), "{error}");
    }
}

#[test]
fn images_too_long_for_a_tile_are_refused_and_sets_can_be_shared() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.idx");
    let header = [0, 0, 8, 3, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 8, 0];
    std::fs::write(&path, [&header[..], &[1; 2048]].concat()).unwrap();
    let error = ObjectSet::open(&ObjectSource::Idx(path.clone()), &ObjectOptions::default()).unwrap_err().to_string();
    assert!(error.contains("found 1 x 2048 px"), "{error}");
    let source = ObjectSource::Images(path.with_extension("npy"));
    write_array(&path.with_extension("npy"), Array2::<f32>::ones((1, 2048)).view()).unwrap();
    let set = std::sync::Arc::new(ObjectSet::open(&source, &ObjectOptions::default()).unwrap());
    let other = std::sync::Arc::clone(&set);
    let drawn = std::thread::spawn(move || other.objects(Split::All, 1, 0).unwrap()).join().unwrap();
    assert_eq!(drawn, set.objects(Split::All, 1, 0).unwrap());
}

#[test]
fn real_images_have_the_published_tamura_coefficients() {
    // The paper's coefficients of image sets are those of the single images, before padding and tiling. The CIFAR images
    // here are copies after JPEG. Those of Fashion-MNIST are a part of the set, whose mean is uncertain.
    type Read = fn(&Path) -> Result<PixelStack, FormatError>;
    let sets: [(Read, &str, usize, f64, f64); 3] = [
        (read_idx, "data/mnist/t10k-images-idx3-ubyte.gz", 10_000, 1.363, 0.002),
        (read_idx, "data/fashion-mnist/sprite900-images-idx3-ubyte.gz", 900, 1.196, 0.01),
        (read_cifar, "data/cifar-10-batches-bin/test_batch.bin", 5_000, 0.970, 0.015),
    ];
    for (read, name, pages, published, tolerance) in sets {
        let Some(path) = shared(name) else { return };
        let images = read(&path).unwrap().into_array();
        assert_eq!(images.dim().0, pages);
        let measured = images.outer_iter().map(|image| tamura(&image)).sum::<f64>() / pages as f64;
        assert!((measured - published).abs() < tolerance, "{name}: {measured} against {published}");
    }
}

#[test]
fn real_images_become_mosaics_of_the_mean_that_was_asked_for() {
    // Coefficients of 300 mosaics each, made independently with NumPy.
    for (source, name, numpy_tamura) in [
        ("idx", "data/mnist/t10k-images-idx3-ubyte.gz", 1.471),
        ("idx", "data/fashion-mnist/sprite900-images-idx3-ubyte.gz", 1.309),
        ("cifar", "data/cifar-10-batches-bin/test_batch.bin", 0.983),
    ] {
        let Some(path) = shared(name) else { return };
        let set = open(&format!("{source}:{}", path.display()));
        let objects = set.objects(Split::All, 400, 11).unwrap();
        let mean = objects.mapv(f64::from).mean().unwrap();
        assert!((mean - 100.0).abs() < 3.0, "{name}: {mean}");
        let tamuras = objects.outer_iter().map(|object| tamura(&object.index_axis(Axis(0), 0)));
        let measured = tamuras.sum::<f64>() / 400.0;
        assert!((measured - numpy_tamura).abs() < 0.02, "{name}: {measured}");
        let covariance = set.autocovariance(Split::All, 32);
        let variance = covariance[[32, 32]];
        for lag in [(0, 0), (0, 3), (3, 0), (8, 8)] {
            let value = sample_covariance(&objects, set.mean(), 0..64, 0..64, lag);
            let expected = covariance[[32 + lag.0, 32 + lag.1]];
            assert!((value - expected).abs() < 0.05 * variance, "{name} {lag:?}: {value} against {expected}");
        }
    }
}

#[test]
fn real_captures_and_photographs_become_objects() {
    let Some(captures) = shared("data/captures/diffuser") else { return };
    let set = open(&format!("images:{}", captures.display()));
    assert_eq!((set.base_images(), set.field()), (Some(9), (96, 96)));
    let (fitted, cleaned) = set.notices().split_last().unwrap();
    assert_eq!(fitted, "objects are the middle 270 x 270 of 270 x 480 px, scaled to 96 x 96 px");
    assert!(cleaned.iter().all(|notice| notice.contains("slightly negative pixels")), "{cleaned:?}");
    let objects = set.objects(Split::All, 9, 0).unwrap();
    assert!((objects.mapv(f64::from).mean().unwrap() - 100.0).abs() < 1e-3);
    assert!(objects.iter().all(|&photons| photons >= 0.0));
    assert_eq!(set.objects(Split::Test, 2, 0).unwrap().dim(), (2, 1, 96, 96));
    let one = open(&format!("stack:{}", captures.join("im65.npy").display()));
    assert_eq!((one.field(), one.base_images()), ((270, 480), Some(1)));
    let Some(photos) = shared("data/photos") else { return };
    assert_eq!(open(&format!("images:{}", photos.display())).base_images(), Some(2));
}
