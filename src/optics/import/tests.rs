use std::path::Path;

use ndarray::Array2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::*;
use crate::formats::Scratch;
use crate::optics::modulation_transfer;

fn import(path: &Path, query: &str) -> Result<ImportedPsf, PsfError> {
    import_psf(Path::new(&format!("{}{query}", path.display())), None)
}

fn sentences(path: &Path, query: &str) -> String {
    import(path, query).unwrap().report.sentences().join("\n")
}

/// Three spots of 800 DN in an image of `cols` columns, on a level with alternating deviations of `noise`.
fn spots(cols: usize, level: f32, noise: f32) -> impl Fn(usize) -> f32 {
    move |index| {
        let (row, col) = (index / cols, index % cols);
        let sign = if (row * 31 + col * 17) % 2 == 0 { 1.0 } else { -1.0 };
        let spot = [(10, 14), (14, 20), (22, 16)].iter().any(|&(r, c)| row.abs_diff(r) + col.abs_diff(c) < 2);
        level + noise * sign + if spot { 800.0 } else { 0.0 }
    }
}

#[test]
fn black_level_is_reported_and_subtracted_where_it_is_asked_for() {
    let scratch = Scratch::new();
    let path = scratch.write("psf.npy", &[32, 32], spots(32, 256.0, 2.0));
    let plain = import(&path, "").unwrap();
    let suspected = plain.report.suspected.unwrap();
    assert!((suspected.share - 0.956).abs() < 0.01, "{suspected:?}");
    let reported = sentences(&path, "");
    assert!(reported.contains("of all light if it is the black level; ?dark=corners subtracts it"), "{reported}");
    assert!(plain.image.photograph.is_none() && plain.report.noise_floor.is_none());
    let dark = import(&path, "?dark=corners").unwrap();
    assert!(sentences(&path, "?dark=corners").contains("from the corners is subtracted, 96.4 % of all grey value"));
    assert!(dark.image.psf[(0, 0)] < 0.001 && dark.image.psf[(10, 14)] > 0.06, "{}", dark.image.psf);
    assert!(dark.image.photograph.unwrap().noise_floor > 0.0);
    let level = import(&path, "?dark=254").unwrap();
    assert!(level.report.below_dark.is_none() && level.report.dark.unwrap().level == 254.0);
    let none = import(&path, "?dark=5000").unwrap_err().to_string();
    assert!(none.contains("no light above the dark level of 5000"), "{none}");
}

#[test]
fn slightly_negative_pixels_become_0_and_others_are_named() {
    let scratch = Scratch::new();
    let path = scratch.write("psf.npy", &[32, 32], spots(32, 0.0, 2.0));
    let imported = import(&path, "").unwrap();
    assert!(imported.image.psf.iter().all(|&value| value >= 0.0));
    assert!(sentences(&path, "").contains("slightly negative pixels (down to -2) were set to 0"));
    let broken = scratch.write("nan.npy", &[8, 8], |index| if index == 19 { f32::NAN } else { 1.0 });
    for query in ["", "?dark=corners", "@4"] {
        let error = import(&broken, query).unwrap_err().to_string();
        assert!(error.contains("expected finite light, found NaN at row 2, column 3; replace"), "{error}");
    }
}

#[test]
fn light_that_is_cut_off_is_reported_with_what_keeps_it() {
    let scratch = Scratch::new();
    let wide = |index: usize| match (index / 64, index % 64) {
        (_, 2 | 61) => 1.0,
        (24, _) => 0.5,
        _ => 0.0,
    };
    let path = scratch.write("wide.npy", &[48, 64], wide);
    let reported = sentences(&path, "@32");
    assert!(
        reported.contains("areas of 1.50 x 1.50 px hold 19 % of the light, 81 % is cut off; ?window=auto"),
        "{reported}"
    );
    assert_eq!(import(&path, "?window=all&grid=32").unwrap().image.psf.dim(), (24, 32));
    let reported = sentences(&path, "?window=all&grid=32");
    assert!(
        reported.contains("the whole photograph in areas of 2 x 2 px holds 100 % of the light, 0 % is cut off"),
        "{reported}"
    );
    let reported = sentences(&path, "?window=0,0,48,10");
    assert!(
        reported.contains("rows 0 to 47, columns 0 to 9 hold") && reported.contains("?window=all keeps all"),
        "{reported}"
    );
    for (query, part) in [
        ("?window=0,60,48,10", "expected a window within 48 x 64 px, found 0,60,48,10"),
        ("?window=0,0,4,4&bin=5", "bins of at most the window's 4 x 4 px, found 5"),
        ("?bin=2@32", "one of bin, grid"),
        ("?dark=corner", "found dark=corner"),
        ("?colour=red", "frame=NUMBER, dark, window, bin, grid, rotate, mirror after the ?, found \"colour=red\""),
    ] {
        let error = import(&path, query).unwrap_err().to_string();
        assert!(error.contains(part), "{query}: {error}");
    }
}

#[test]
fn large_colour_photograph_is_refused_with_options_that_fit_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.png");
    let photo = image::RgbImage::from_fn(1100, 1040, |x, y| {
        let level = 16 + ((x * 31 + y * 17) % 3) as u8;
        let is_lit = (300..700).contains(&x) && (500..800).contains(&y) && (x / 20 + y / 20) % 3 == 0;
        if is_lit {
            image::Rgb([level + 20, level + 100, level + 60])
        } else {
            image::Rgb([level + 9, level, level + 3])
        }
    });
    photo.save(&path).unwrap();
    let error = import(&path, "").unwrap_err().to_string();
    let query = "channel=green&dark=corners&window=auto&bin=9";
    assert!(error.contains(&format!("found 1040 x 1100; add ?{query} to the path for one of 44 x 44 px")), "{error}");
    let imported = import(&path, &format!("?{query}")).unwrap();
    assert_eq!(imported.image.psf.dim(), (44, 44));
    assert!(imported.report.light_kept > 0.98, "{:?}", imported.report);
    assert!((imported.report.dark.unwrap().level - 17.0).abs() <= 1.0, "green, no weighted grey");
    // Without a channel the green one is taken, and reported.
    let other = import(&path, "?dark=corners&window=auto&bin=9").unwrap();
    assert_eq!(other.image.psf, imported.image.psf);
    assert!(other.summary.to_string().contains("channel 2 of 3"), "{}", other.summary);
    let red = import(&path, "?channel=red&dark=corners&window=auto&bin=9").unwrap();
    assert!((red.report.dark.unwrap().level - 26.0).abs() <= 1.0);
}

#[test]
fn axes_of_other_programs_are_read() {
    let scratch = Scratch::new();
    let colours = |index: usize| spots(32, 0.0, 0.0)(index / 3 % 1024) * [0.25, 1.0, 0.5][index % 3];
    let one = scratch.write("one.npy", &[1, 32, 32, 3], colours);
    let several =
        scratch.write("several.npy", &[2, 32, 32, 3], |index| colours(index % 3072) * (1 + index / 3072) as f32);
    let green = import(&one, "?channel=green").unwrap();
    assert_eq!(green.image.psf.dim(), (32, 32));
    assert!(import(&several, "").unwrap_err().to_string().contains("add ?frame=1"));
    assert_eq!(import(&several, "?frame=2&channel=green").unwrap().image.psf, green.image.psf);
}

#[test]
fn saturated_photograph_is_reported_first() {
    let scratch = Scratch::new();
    let path = scratch.write("psf.npy", &[64, 64], |index| spots(64, 20.0, 1.0)(index).min(255.0));
    let many = scratch.write("many.npy", &[64, 64], |index| {
        if index / 64 < 5 && index % 64 > 30 { 255.0 } else { (index % 90) as f32 }
    });
    assert!(import(&path, "").unwrap().report.saturated.is_none(), "15 pixels may have one value by chance");
    let reported = import(&many, "").unwrap();
    assert_eq!(reported.report.saturated.unwrap().value, 255.0);
    assert!(
        reported.report.sentences()[0].starts_with("4.0 % of the pixels are at 255"),
        "{:?}",
        reported.report.sentences()
    );
    assert!(reported.image.photograph.unwrap().saturated_share > 0.03);
}

#[test]
fn photograph_is_turned_before_it_is_mirrored() {
    let scratch = Scratch::new();
    let path = scratch.write("psf.npy", &[4, 6], |index| if index == 1 { 1.0 } else { 0.0 });
    let place = |query: &str| {
        let psf = import(&path, query).unwrap().image.psf;
        let (place, _) = psf.indexed_iter().find(|(_, value)| **value > 0.5).unwrap();
        (psf.dim(), place)
    };
    assert_eq!(place("?rotate=90"), ((6, 4), (4, 0)));
    assert_eq!(place("?rotate=90&mirror=yes"), ((6, 4), (4, 3)));
    assert_eq!(place("?rotate=180"), ((4, 6), (3, 4)));
    assert_eq!(place("?window=0,1,2,5&mirror=yes"), ((2, 5), (0, 4)));
}

/// The PSF of a file without options, and with a side, as earlier programs made them.
#[test]
fn clean_psfs_are_unchanged_to_the_bit() {
    let scratch = Scratch::new();
    let light = |index: usize| 0.3 + ((index * 37) % 101) as f32 / 7.0;
    let path = scratch.write("psf.npy", &[50, 41], light);
    let image = Array2::from_shape_fn((50, 41), |(row, col)| light(row * 41 + col));
    assert_eq!(import(&path, "").unwrap().image.psf, normalised_psf(image.clone(), "p").unwrap());
    let square = image.slice(ndarray::s![4..45, ..]);
    let step = 41.0 / 32.0;
    let overlaps = Array2::from_shape_fn((32, 41), |(target, source)| {
        let (from, to) = (target as f64 * step, (target + 1) as f64 * step);
        ((to.min(source as f64 + 1.0) - from.max(source as f64)).max(0.0) / step) as f32
    });
    let small = normalised_psf(overlaps.dot(&square).dot(&overlaps.t()), "p").unwrap();
    assert_eq!(import(&path, "@32").unwrap().image.psf, small);
    assert_eq!(import(&path, "?window=square&grid=32").unwrap().image.psf, small);
}

#[test]
fn settings_file_repeats_an_import_and_can_be_moved_with_its_photograph() {
    let scratch = Scratch::new();
    let path =
        scratch.write("psf.npy", &[40, 48, 3], |index| spots(48, 100.0, 2.0)(index / 3) * [0.5, 1.0, 0.7][index % 3]);
    let query = "channel=green&dark=corners&window=2,3,36,40&bin=2&rotate=90&mirror=yes";
    let named = format!("{}?{query}", path.display());
    let photograph = PsfPhotograph::find(Path::new(&named)).unwrap();
    assert_eq!(photograph.text(), named);
    let settings = scratch.path().join("import.toml");
    photograph.save(&settings).unwrap();
    let text = std::fs::read_to_string(&settings).unwrap();
    assert!(text.contains("photograph = \"psf.npy\"") && text.contains("bin = 2"), "{text}");
    assert_eq!(PsfPhotograph::find(&settings).unwrap(), photograph);
    assert_eq!(import_psf(&settings, None).unwrap().image.psf, import(&path, &format!("?{query}")).unwrap().image.psf);
    let moved = tempfile::tempdir().unwrap();
    for name in ["psf.npy", "import.toml"] {
        std::fs::copy(scratch.path().join(name), moved.path().join(name)).unwrap();
    }
    let there = PsfPhotograph::find(&moved.path().join("import.toml")).unwrap();
    assert_eq!(there.file.path, moved.path().join("psf.npy"));
    for (wrong, part) in [
        ("format = \"other\"", "format \"other\""),
        ("format = \"lenslet-studio/psf-import\"\nformat_version = 9", "written by a newer Lenslet Studio"),
        ("format = \"lenslet-studio/psf-import\"\nformat_version = 1", "add photograph"),
        (&text.replace("bin = 2", "bin = 0"), "1 to 4096 pixels"),
        (&text.replace("bin = 2", "zoom = 2"), "found zoom=2"),
        ("= 3", "correct it in a text editor"),
    ] {
        std::fs::write(&settings, wrong).unwrap();
        let error = import_psf(&settings, None).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
}

/// Noise alone around one bright pixel: the modulation of the noise has the root mean square of the floor.
#[test]
fn noise_floor_is_the_modulation_of_the_noise() {
    let scratch = Scratch::new();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let noise: Vec<f32> = (0..96 * 96).map(|_| random.sample(StandardNormal)).collect();
    let path = scratch.write("psf.npy", &[96, 96], |index| {
        500.0 + 4.0 * noise[index] + if index == 48 * 96 + 48 { 20_000.0 } else { 0.0 }
    });
    let floor = import(&path, "?dark=500").unwrap().report.noise_floor.unwrap();
    let light = formats::read_array(&path).unwrap().mapv(|value| f64::from(value) - 500.0);
    let mut light = light.into_dimensionality().unwrap();
    light[(48, 48)] -= 20_000.0;
    let mtf = modulation_transfer(light.view());
    let scale = light.sum() / 20_000.0;
    let square = mtf.map.iter().map(|&value| (f64::from(value) * scale).powi(2)).sum::<f64>() / 9216.0;
    assert!((floor / square.sqrt() - 1.0).abs() < 0.25, "{floor} {}", square.sqrt());
    let binned = import(&path, "?dark=500&bin=4").unwrap().report.noise_floor.unwrap();
    assert!((binned / floor - 1.0).abs() < 1e-9, "bins change neither noise nor light");
}

#[test]
fn pixels_are_checked_before_they_are_averaged_and_one_pixel_is_a_square() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("p.npy");
    let mut image = Array2::<f32>::ones((6, 6));
    image[(2, 3)] = -0.5;
    formats::write_array(&path, image.clone().into_dyn().view()).unwrap();
    let message = import_psf(&path, Some(2)).unwrap_err().to_string();
    assert!(message.contains("-0.5 at row 2, column 3"), "{message}");
    formats::write_array(&path, Array2::<f32>::ones((1, 1)).into_dyn().view()).unwrap();
    assert_eq!(import_psf(&path, Some(8)).unwrap().image.psf.dim(), (8, 8));
}

#[test]
fn an_at_sign_is_a_side_unless_a_file_has_that_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    formats::write_array(&path("psf@32"), Array2::<f32>::ones((6, 6)).into_dyn().view()).unwrap();
    formats::write_array(&path("a.npy"), Array2::<f32>::ones((6, 6)).into_dyn().view()).unwrap();
    let side = |name: &str| import_psf(&path(name), None).map(|imported| imported.image.psf.nrows()).ok();
    assert_eq!([side("psf@32"), side("psf@32@3"), side("a.npy@4"), side("a.npy")], [6, 3, 4, 6].map(Some));
    assert_eq!(side("a.npy?channel=luma@2"), Some(2));
    assert_eq!(side("b.npy@4"), None);
    for wrong in ["a.npy@0", "a.npy@9999", "a.npy@"] {
        let error = import_psf(&path(wrong), None).unwrap_err().to_string();
        assert!(error.contains("pixels a side after the @"), "{error}");
    }
}

#[test]
fn what_is_not_light_is_refused_by_its_pixel() {
    let mut image = Array2::<f32>::ones((4, 5));
    image[(2, 3)] = -1.0;
    let message = normalised_psf(image.clone(), "p.npy").unwrap_err().to_string();
    assert!(message.contains("-1 at row 2, column 3"), "{message}");
    image[(2, 3)] = f32::NAN;
    assert!(matches!(normalised_psf(image, "p.npy"), Err(PsfError::NotFinite { .. })));
    assert!(matches!(normalised_psf(Array2::zeros((4, 4)), "p.npy"), Err(PsfError::Dark { .. })));
    assert!(matches!(normalised_psf(Array2::zeros((0, 4)), "p.npy"), Err(PsfError::Shape { .. })));
}

#[test]
fn a_normalised_psf_is_left_to_the_bit() {
    let once = normalised_psf(Array2::from_shape_fn((9, 9), |(r, c)| (r * c) as f32 + 0.1), "p").unwrap();
    assert_eq!(normalised_psf(once.clone(), "p").unwrap(), once);
}
