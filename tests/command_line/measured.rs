//! Estimates from the images of a camera.

use super::{Bench, npy};

/// Photons of `images` images of 24 x 20 px: about 20 in dark columns and 60 in bright ones, with noise similar to
/// Poisson's.
fn photons(images: usize) -> Vec<f32> {
    let mut state = 1_u64;
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1_u64 << 24) as f32
    };
    let mut values = Vec::new();
    for _ in 0..images * 24 {
        for col in 0..20 {
            let mean: f32 = if col / 5 % 2 == 0 { 20.0 } else { 60.0 };
            // A sum of twelve uniform numbers has the variance of a standard normal one.
            let normal = (0..12).map(|_| uniform()).sum::<f32>() - 6.0;
            values.push((mean + mean.sqrt() * normal).round().max(0.0));
        }
    }
    values
}

const LINE: &str = "estimate --patch 6 --patches-train 600 --patches-test 200 --seed 4";

#[test]
fn grey_levels_become_photons_and_the_result_says_how() {
    let bench = Bench::new();
    let photons = photons(10);
    let grey: Vec<f32> = photons.iter().map(|x| 100.0 + 2.0 * x).collect();
    bench.write("photons.npy", npy("(10, 24, 20)", &photons));
    bench.write("grey.npy", npy("(10, 24, 20)", &grey));
    let expected = bench.json(&format!("{LINE} --measurements photons.npy"));
    let found = bench.json(&format!("{LINE} --measurements stack:grey.npy --gain 2 --offset 100"));
    assert_eq!(found["bits_per_pixel"], expected["bits_per_pixel"]);
    assert_eq!(found["objects_fingerprint"], expected["objects_fingerprint"]);
    let notes = found["notes"].to_string();
    for part in ["in place of clean images", "(grey level - 100) / 2", "from 2 images", "from 8 other images"] {
        assert!(notes.contains(part), "{part} in {notes}");
    }
    assert!(found["ceiling"].is_null() && found["noise"] == "shot" && found["patches_train"] == 600);
    assert!(found["bits_per_pixel"].as_f64().unwrap() > 0.1, "columns differ: {found}");

    // The same images one by one, some as TIFF.
    std::fs::create_dir(bench.path("folder")).unwrap();
    for (index, image) in grey.chunks(24 * 20).enumerate() {
        if index % 2 == 0 {
            bench.write(&format!("folder/{index}.npy"), npy("(24, 20)", image));
        } else {
            let image = ndarray::Array3::from_shape_vec((1, 24, 20), image.to_vec()).unwrap();
            lenslet_studio::formats::write_tiff(&bench.path(format!("folder/{index}.tif")), image.view()).unwrap();
        }
    }
    let folder = bench.json(&format!("{LINE} --measurements folder --gain 2 --offset 100"));
    assert_eq!(folder["objects_fingerprint"], expected["objects_fingerprint"]);
    let told = bench.done(&format!("{LINE} --measurements images:folder --estimator gaussian-full --noise read:3"));
    for part in ["unknown mask imaging the scenes of folder (10 images of 24 x 20 px)", "gaussian-full", "read:3 noise"]
    {
        assert!(told.contains(part), "{part} in {told}");
    }
    let loud = bench.json(&format!("{LINE} --measurements photons.npy --noise read:500"));
    assert!(loud["notes"].to_string().contains("vary less than the noise that was stated"), "{loud}");
    let coarse = bench.json(&format!("{LINE} --measurements photons.npy --gain 0.5"));
    assert!(coarse["notes"].to_string().contains("one grey level is 2.000 photons"), "{coarse}");
}

#[test]
fn that_grey_levels_are_whole_tells_a_density_model_nothing() {
    let bench = Bench::new();
    // One photon on average everywhere, and pixels below the offset: 0, 1, 2, 3 with the probabilities of Poisson's law.
    let mut state = 7_u64;
    let mut dark = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let share = (state >> 40) as f32 / (1_u64 << 24) as f32;
        [0.368, 0.736, 0.920, 0.981].into_iter().filter(|&below| share > below).count() as f32
    };
    let counts: Vec<f32> = (0..20 * 24 * 20).map(|pixel| dark() - if pixel % 35 == 0 { 1.0 } else { 0.0 }).collect();
    bench.write("dark.npy", npy("(20, 24, 20)", &counts));
    for noise in ["shot", "shot+read:0.2"] {
        let line =
            "estimate --estimator causal --steps 150 --patch 8 --patches-test 100 --seed 4 --measurements dark.npy";
        let found = bench.json(&format!("{line} --noise {noise}"));
        assert!(found["bits_per_pixel"].as_f64().unwrap() > 0.0, "{found}");
        assert_eq!(found["noise"], noise);
    }
}

#[test]
fn weighted_colours_and_patches_without_end_are_refused() {
    let bench = Bench::new();
    bench.write("photons.npy", npy("(10, 24, 20)", &photons(10)));
    let side = usize::MAX / 2 + 1;
    for patch in ["2147483648".to_owned(), side.to_string(), usize::MAX.to_string(), "25x20".into()] {
        let line = format!("{LINE} --measurements photons.npy").replace("--patch 6", &format!("--patch {patch}"));
        assert!(bench.refused(&line).contains("24 x 20"), "{}", bench.refused(&line));
    }
    // Three equal channels are grey, with equal numbers.
    let grey: Vec<f32> = photons(2)[..24 * 20].iter().flat_map(|&x| [x; 3]).collect();
    let mut tinted = grey.clone();
    tinted[7] += 1.0;
    for (folder, pixels) in [("grey", &grey), ("tinted", &tinted)] {
        for index in 0..4 {
            bench.write(&format!("{folder}/{index}.npy"), npy("(24, 20, 3)", pixels));
        }
    }
    bench.done(&format!("{LINE} --measurements grey"));
    let tinted = bench.json(&format!("{LINE} --measurements tinted"));
    assert!(tinted["notes"].to_string().contains("the green channel of colour images"), "{tinted}");
    let sentence = bench.refused(&format!("{LINE} --measurements tinted?channel=luma"));
    assert!(sentence.contains("tinted") && sentence.contains("found a weighted grey value"), "{sentence}");
}

#[test]
fn a_gaussian_that_is_not_fitted_bounds_nothing_before_whole_images() {
    let bench = Bench::new();
    let images: Vec<f32> = (0..12 * 40 * 40).map(|pixel| (pixel * 7 % 251) as f32).collect();
    bench.write("images.npy", npy("(12, 40, 40)", &images));
    let line = "estimate --objects stack:images.npy --patch 4 --patches-train 60 --patches-test 20";
    let sentence = bench.refused(&format!("{line} --estimator gaussian-analytic"));
    assert!(
        sentence.contains("stack:images.npy are whole images") && sentence.contains("choose gaussian"),
        "{sentence}"
    );
    bench.done(line);
}

#[test]
fn bins_add_up() {
    let bench = Bench::new();
    let photons = photons(6);
    let mut binned = Vec::new();
    for image in photons.chunks(24 * 20) {
        for (r, c) in (0..12).flat_map(|r| (0..10).map(move |c| (r, c))) {
            let at = |row: usize, col: usize| image[(2 * r + row) * 20 + 2 * c + col];
            binned.push(at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1));
        }
    }
    bench.write("photons.npy", npy("(6, 24, 20)", &photons));
    bench.write("binned.npy", npy("(6, 12, 10)", &binned));
    let expected = bench.json(&format!("{LINE} --measurements binned.npy"));
    let found = bench.json(&format!("{LINE} --measurements photons.npy --bin 2"));
    assert_eq!(found["bits_per_pixel"], expected["bits_per_pixel"]);
    assert!(found["notes"].to_string().contains("summed over 2 x 2 pixels"), "{found}");
    // 24 x 20 pixels hold 3 x 2 bins of 7.
    let sensor =
        bench.json(&format!("{LINE} --measurements photons.npy --bin 7 --patch sensor").replace("--patch 6", ""));
    assert_eq!(sensor["patch"], serde_json::json!([3, 2]));
}

#[test]
fn a_network_is_fitted_to_measurements() {
    let bench = Bench::new();
    bench.write("photons.npy", npy("(10, 24, 20)", &photons(10)));
    let line = "estimate --patch 5 --patches-train 60 --patches-test 20 --estimator pixelcnn --budget 0.2s";
    let found = bench.json(&format!("{line} --measurements photons.npy"));
    assert_eq!((&found["estimator"], &found["patches_test"]), (&"pixelcnn".into(), &20.into()));
    assert!(found["notes"].to_string().contains("in place of clean images"), "{found}");
}

#[test]
fn causal_estimate_fits_measurements() {
    let bench = Bench::new();
    bench.write("photons.npy", npy("(10, 24, 20)", &photons(10)));
    let estimator = "causal";
    let line = format!("estimate --patch 8 --patches-test 40 --estimator {estimator} --budget 0.3s");
    let found = bench.json(&format!("{line} --measurements photons.npy"));
    assert_eq!((&found["estimator"], &found["patches_test"]), (&estimator.into(), &40.into()));
    assert!(found["notes"].to_string().contains("in place of clean images"), "{found}");
    assert!(found["ceiling"].is_null() && found.get("upper").is_none());
    let bits = found["bits_per_pixel"].as_f64().unwrap();
    assert!(bits > 0.0 && bits < 3.0, "columns differ by no more than their contrast tells: {bits}");
}

#[test]
fn what_cannot_be_estimated_gets_one_sentence() {
    let bench = Bench::new();
    let photons = photons(4);
    bench.write("a.npy", npy("(4, 24, 20)", &photons));
    bench.write("one.npy", npy("(24, 20)", &photons[..480]));
    bench.write("flat.npy", npy("(4, 24, 20)", &[7.0; 4 * 480]));
    let mut broken = photons.clone();
    broken[481] = f32::NAN;
    bench.write("broken.npy", npy("(4, 24, 20)", &broken));
    std::fs::create_dir(bench.path("mixed")).unwrap();
    bench.write("mixed/a.npy", npy("(24, 20)", &photons[..480]));
    bench.write("mixed/b.npy", npy("(20, 24)", &photons[..480]));
    std::fs::create_dir(bench.path("depths")).unwrap();
    let level = |x: u32, y: u32| (x * 7 + y * 3) % 90;
    image::GrayImage::from_fn(20, 24, |x, y| image::Luma([level(x, y) as u8]))
        .save(bench.path("depths/a.png"))
        .unwrap();
    let deep = image::ImageBuffer::from_fn(20, 24, |x, y| image::Luma([level(x, y) as u16 * 257]));
    deep.save(bench.path("depths/b.png")).unwrap();
    std::fs::create_dir(bench.path("empty")).unwrap();
    for (arguments, told) in [
        ("a.npy --mask heuristic:3", "cannot be used with"),
        ("a.npy --objects beads:0.02", "cannot be used with"),
        ("a.npy --bias 3", "cannot be used with"),
        ("a.npy --mean-photons 3", "cannot be used with"),
        ("beads:0.02", "expected a file or folder of images"),
        ("none.npy", "none.npy"),
        ("one.npy", "one.npy: expected 2 or more images, found 1 image"),
        ("empty", "empty: expected PNG, JPEG, TIFF, BMP, NPY or NPZ images, found none"),
        ("broken.npy", "NaN in image 2, row 0, column 1"),
        ("mixed", "20 x 24 px"),
        ("depths", "b.png: expected grey levels of 8 bits, as in the files before it, found 16 bits"),
        ("a.npy --gain 0", "the gain of the measurements must be a number above 0"),
        ("a.npy --gain nan", "the gain"),
        ("a.npy --gain 1e-45", "the gain of the measurements must be as many grey levels per photon"),
        ("a.npy --offset inf", "the offset of the measurements must be a finite grey level"),
        ("a.npy --offset 5000", "must be above 0 photons"),
        ("a.npy --bin 0", "expected 1 to 20 pixels on each side of a bin, found 0"),
        ("a.npy --bin 21", "found 21"),
        ("a.npy --patch 22", "do not fit measurements of 24 x 20"),
        ("a.npy --noise none", "unbounded without noise"),
        ("a.npy --patch 6 --estimator gaussian-analytic", "gaussian-analytic needs objects that are known"),
        ("a.npy --patch 6 --estimator bracket", "bracket needs objects that are known"),
        ("a.npy --patch 6 --estimator gaussian-full --patches-train 36", "at least 37 patches"),
        ("a.npy --patch 6 --patches-train 0", "at least 1 patch"),
        ("flat.npy --patch 6 --noise read:1", "all training patches hold the same value 7"),
        ("flat.npy --patch 6 --noise shot", "all training patches hold the same value 7"),
        ("a.npy --patch 6 --gain 1e-9 --estimator pixelcnn", "photon counts up to 10000000"),
    ] {
        let sentence = bench.refused(&format!("estimate --measurements {arguments}"));
        assert!(sentence.contains(told), "{arguments}: {sentence}");
    }
    for option in ["--gain 2", "--offset 2", "--bin 2"] {
        assert!(bench.refused(&format!("estimate {option}")).contains("--measurements"), "{option}");
    }
}
