//! Images of cameras with known faults through `estimate`: each input is made here.

use serde_json::Value;

use super::{Bench, npy, text};

/// Random numbers of a seed.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    /// A Poisson count, by products of uniform numbers where it is small.
    fn poisson(&mut self, mean: f64) -> f64 {
        if mean > 60.0 {
            return (mean + mean.sqrt() * self.normal()).round().max(0.0);
        }
        let (limit, mut product, mut count) = ((-mean).exp(), self.uniform(), 0.0);
        while product > limit {
            product *= self.uniform();
            count += 1.0;
        }
        count
    }
}

/// An NPY file of unsigned numbers of `bytes` bytes.
fn counts(shape: &str, values: &[f32], bytes: usize) -> Vec<u8> {
    let header = format!("{{'descr': '<u{bytes}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut file = [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat();
    file.extend(values.iter().flat_map(|&value| (value as u16).to_le_bytes()[..bytes].to_vec()));
    file
}

const IMAGES: usize = 20;
const SIDE: usize = 64;
const SHAPE: &str = "(20, 64, 64)";
const LINE: &str = "estimate --patch 8 --patches-train 2000 --patches-test 400 --seed 3";

fn pixels() -> std::ops::Range<usize> {
    0..IMAGES * SIDE * SIDE
}

/// Flat images of a camera: photons, gain and offset.
fn flat(photons: f64, gain: f64, offset: f64) -> Vec<f32> {
    let mut random = Random(7);
    pixels().map(|_| (offset + gain * random.poisson(photons)) as f32).collect()
}

fn bits(found: &Value) -> f64 {
    found["bits_per_pixel"].as_f64().unwrap()
}

fn notes(found: &Value) -> Vec<String> {
    found["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap().to_owned()).collect()
}

fn has_note(found: &Value, part: &str) -> bool {
    notes(found).iter().any(|note| note.contains(part))
}

#[test]
fn a_wrong_offset_is_called_an_error_once() {
    let bench = Bench::new();
    bench.write("flat.npy", counts(SHAPE, &flat(100.0, 2.0, 100.0), 2));
    let of = |gain: &str, offset: &str| {
        bench.json(&format!("{LINE} --measurements flat.npy --gain {gain} --offset {offset}"))
    };
    let right = of("2", "100");
    assert!(bits(&right).abs() < 0.02 && !has_note(&right, "error"), "{right}");
    assert!(has_note(&right, "(0.5 photons per DN)"), "{right}");
    assert!((bits(&of("0.5", "100")) - 1.0).abs() < 0.03 && (bits(&of("1", "100")) - 0.5).abs() < 0.03);
    let wrong = of("2", "0");
    assert!((bits(&wrong) + 0.29).abs() < 0.02, "{wrong}");
    let all = notes(&wrong);
    assert!(all[0].starts_with("error: ") && all[0].contains("check the offset: it is 0"), "{all:?}");
    let offset: f64 = all[0].split("offset of ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((offset - 100.0).abs() < 5.0, "{all:?}");
    assert!(!has_note(&wrong, "within the error") && all.iter().filter(|note| note.contains("vary")).count() == 1);
}

#[test]
fn images_of_eight_bits_carry_no_more_than_eight() {
    let bench = Bench::new();
    let mut random = Random(3);
    let levels: Vec<f32> = pixels().map(|_| (random.uniform() * 256.0).floor() as f32).collect();
    bench.write("levels.npy", counts(SHAPE, &levels, 1));
    let found = bench.json(&format!("{LINE} --measurements levels.npy --noise read:0.01"));
    assert!(bits(&found) <= 8.0 && found["interval_95"][1].as_f64().unwrap() <= 8.0, "{found}");
    assert!(has_note(&found, "finer than a grey level") && has_note(&found, "check the noise and the gain"), "{found}");
    // Sums of four pixels have 1021 values.
    let binned = bench.json(&format!("{LINE} --measurements levels.npy --noise read:0.01 --bin 2"));
    assert!((bits(&binned) - 1021.0_f64.log2()).abs() < 1e-6, "{binned}");
}

#[test]
fn bias_of_few_photons_is_noted() {
    let bench = Bench::new();
    for (photons, bias) in [(1.0, 0.73), (10.0, 0.07)] {
        bench.write("dim.npy", counts(SHAPE, &flat(photons, 1.0, 0.0), 2));
        let found = bench.json(&format!("{LINE} --measurements dim.npy"));
        assert!((bits(&found) - bias).abs() < 0.03, "{found}");
        let note = notes(&found).into_iter().find(|note| note.contains("at this light")).unwrap();
        let noted: f64 = note.split("about ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!((noted - bits(&found)).abs() < 0.03, "{note}");
    }
    let paper = bench.json(&format!("{LINE} --measurements dim.npy --protocol paper"));
    assert!(bits(&paper).is_finite(), "{paper}");
    bench.write("dark.npy", counts(SHAPE, &flat(1.0, 1.0, 0.0), 2));
    bench.done(&format!("{LINE} --measurements dark.npy --protocol paper"));
}

#[test]
fn fixed_pattern_is_noted_and_dark_images_take_it_away() {
    let bench = Bench::new();
    let mut random = Random(5);
    let pattern: Vec<f64> = (0..SIDE * SIDE).map(|_| 25.0 * random.normal()).collect();
    let image = |photons: f64, random: &mut Random| -> Vec<f32> {
        let value =
            |pixel: usize, random: &mut Random| 300.0 + pattern[pixel % (SIDE * SIDE)] + 2.0 * random.poisson(photons);
        pixels().map(|pixel| value(pixel, random).round() as f32).collect()
    };
    bench.write("pattern.npy", counts(SHAPE, &image(100.0, &mut random), 2));
    bench.write("dark/frames.npy", counts(SHAPE, &image(0.0, &mut random), 2));
    let line = format!("{LINE} --measurements pattern.npy --gain 2");
    let with = bench.json(&format!("{line} --offset 300"));
    assert!(bits(&with) > 0.3 && has_note(&with, "of the variance is the same in all images"), "{with}");
    let without = bench.json(&format!("{line} --dark dark"));
    assert!(bits(&without).abs() < 0.03 && !has_note(&without, "same in all images"), "{without}");
    assert!(has_note(&without, "the mean of dark"), "{without}");
    bench.write("small.npy", counts("(2, 3, 4)", &[1.0; 24], 2));
    let refused = bench.refused(&format!("{line} --dark small.npy"));
    assert!(refused.contains("expected images of 3 x 4 px"), "{refused}");
    let flat = bench.json(&format!("{line} --dark dark --flat pattern.npy"));
    assert!(has_note(&flat, "over the response by pattern.npy"), "{flat}");
}

#[test]
fn saturated_and_wrapped_pixels_are_noted_first() {
    let bench = Bench::new();
    let saturated: Vec<f32> = flat(250.0, 1.0, 0.0).into_iter().map(|value| value.min(255.0)).collect();
    let share = 100.0 * saturated.iter().filter(|value| **value == 255.0).count() as f64 / saturated.len() as f64;
    bench.write("saturated.npy", counts(SHAPE, &saturated, 1));
    let output = bench.run(format!("{LINE} --measurements saturated.npy --json").split(' '));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let expected = format!("{share:.1} % of the pixels are at 255");
    assert!(notes(&found)[0].starts_with(&expected), "{found}");
    // The preview precedes the estimate.
    let preview = format!("{share:.2} % saturated at 255, grey values in steps of 1");
    assert!(text(&output.stderr).contains(&preview) && has_note(&found, &preview), "{}", text(&output.stderr));

    let mut random = Random(9);
    let wrapped: Vec<f32> = pixels()
        .map(|_| (random.poisson(9.0) - 4.0 + (3.0 * random.normal()).round()).rem_euclid(65536.0) as f32)
        .collect();
    bench.write("wrapped.npy", counts(SHAPE, &wrapped, 2));
    let found = bench.json(&format!("{LINE} --measurements wrapped.npy"));
    assert!(has_note(&found, "wrapped around zero") && has_note(&found, "while the median is"), "{found}");
    let shifted: Vec<f32> = flat(100.0, 16.0, 160.0);
    bench.write("shifted.npy", counts(SHAPE, &shifted, 2));
    let found = bench.json(&format!("{LINE} --measurements shifted.npy --gain 16 --offset 160"));
    assert!(has_note(&found, "all grey values are 16 apart") && bits(&found).abs() < 0.03, "{found}");
}

#[test]
fn colour_takes_one_channel_or_plane_with_a_note() {
    let bench = Bench::new();
    let mut random = Random(11);
    // Red has 40, green 90, blue 60 photons; columns differ.
    let light = |pixel: usize| 1.0 + 0.5 * ((pixel % 16 / 8) as f64);
    let colours: Vec<f32> = (0..12 * 32 * 32)
        .flat_map(|pixel| [40.0, 90.0, 60.0].map(|photons| random.poisson(photons * light(pixel)) as f32))
        .collect();
    bench.write("rgb.npy", npy("(12, 32, 32, 3)", &colours));
    let channel = |index: usize| colours.iter().skip(index).step_by(3).copied().collect::<Vec<f32>>();
    for (index, name) in ["red", "green", "blue"].into_iter().enumerate() {
        bench.write("plain.npy", npy("(12, 32, 32)", &channel(index)));
        let expected = bench.json(&format!("{LINE} --measurements plain.npy"));
        let found = bench.json(&format!("{LINE} --measurements rgb.npy --channel {name}"));
        assert_eq!(found["objects_fingerprint"], expected["objects_fingerprint"], "{name}");
    }
    let found = bench.json(&format!("{LINE} --measurements rgb.npy"));
    bench.write("plain.npy", npy("(12, 32, 32)", &channel(1)));
    let green = bench.json(&format!("{LINE} --measurements plain.npy"));
    assert_eq!(found["bits_per_pixel"], green["bits_per_pixel"]);
    assert!(has_note(&found, "taken: the green channel of colour images"), "{found}");
    // A mosaic whose greens are 30 photons each: their sum is a count of 60.
    let mosaic: Vec<f32> = (0..12 * 32 * 32)
        .map(|pixel| if (pixel / 32 + pixel) % 2 == 1 { random.poisson(30.0) } else { 5.0 } as f32)
        .collect();
    bench.write("mosaic.npy", npy("(12, 32, 32)", &mosaic));
    let both = bench.json(&format!("{LINE} --measurements mosaic.npy --bayer RGGB"));
    assert!(bits(&both).abs() < 0.05 && has_note(&both, "both greens, summed"), "{both}");
    let one = bench.json(&format!("{LINE} --measurements mosaic.npy --channel g1"));
    assert!(bits(&one).abs() < 0.08 && has_note(&one, "the G1 pixels of raw RGGB mosaics"), "{one}");
    // Dark images belong to one plane.
    let greens = format!("{LINE} --measurements mosaic.npy --dark mosaic.npy");
    assert!(bench.refused(&format!("{greens} --bayer RGGB")).contains("give --channel g1 or g2"));
    assert!(bench.refused("estimate --channel red").contains("are for --measurements"));
}

#[test]
fn views_and_equal_light_are_as_stated() {
    let bench = Bench::new();
    let mut random = Random(13);
    // Every image has stripes of its own.
    let light: Vec<f64> = (0..12 * 48).map(|_| 20.0 + 40.0 * random.uniform()).collect();
    let image = |pixel: usize| light[pixel / (40 * 48) * 48 + pixel % 48];
    let values: Vec<f32> = (0..12 * 40 * 48).map(|pixel| random.poisson(image(pixel)) as f32).collect();
    bench.write("a.npy", npy("(12, 40, 48)", &values));
    let cut: Vec<f32> = values
        .chunks(40 * 48)
        .flat_map(|image| (4..36).flat_map(move |row| image[row * 48 + 8..row * 48 + 40].to_vec()))
        .collect();
    bench.write("cut.npy", npy("(12, 32, 32)", &cut));
    let expected = bench.json(&format!("{LINE} --measurements cut.npy"));
    let found = bench.json(&format!("{LINE} --measurements a.npy --crop 32x32+4+8"));
    assert_eq!(found["objects_fingerprint"], expected["objects_fingerprint"]);
    let turned = bench.json(&format!("{LINE} --measurements a.npy --crop 32x32+4+8 --rotate 90 --mirror"));
    assert!(turned["objects_fingerprint"] != found["objects_fingerprint"], "{turned}");
    assert!(has_note(&turned, "crop 32x32+4+8, turned by 90 degrees, mirrored"), "{turned}");
    let expected: Vec<f32> = cut
        .chunks(32 * 32)
        .flat_map(|image| (0..32 * 32).map(move |pixel| image[(31 - pixel % 32) * 32 + 31 - pixel / 32]))
        .collect();
    bench.write("turned.npy", npy("(12, 32, 32)", &expected));
    let expected = bench.json(&format!("{LINE} --measurements turned.npy"));
    assert_eq!(turned["objects_fingerprint"], expected["objects_fingerprint"]);

    let equal = bench.json(&format!("{LINE} --measurements a.npy --equal-light"));
    assert!(bits(&equal) > bits(&found) && equal["bias"] == 10.0, "{equal}");
    assert!(has_note(&equal, "mean of 500 photons per pixel, 10 are added"), "{equal}");
    assert!(!has_note(&equal, "in place of clean images"), "{equal}");
    // The light of the camera does not count, nor do its units.
    let scaled: Vec<f32> = values.iter().map(|value| value / 16.0).collect();
    bench.write("scaled.npy", npy("(12, 40, 48)", &scaled));
    let again = bench.json(&format!("{LINE} --measurements scaled.npy --equal-light"));
    assert!((bits(&again) - bits(&equal)).abs() < 1e-3);
    let dimmer = bench.json(&format!("{LINE} --measurements a.npy --equal-light 50"));
    assert!(bits(&dimmer) < bits(&equal), "{dimmer}");
    let short = "--estimator causal --steps 5 --patch 8 --patches-test 20";
    bench.done(&format!("estimate {short} --measurements a.npy --equal-light"));
    for (flags, part) in [
        ("--equal-light 0", "--equal-light 0: expected"),
        ("--crop 41x8+0+0", "crop 41x8+0+0: expected a part of 40 x 48 px"),
        ("--crop 8", "expected ROWSxCOLS+TOP+LEFT"),
        ("--rotate 45", "45"),
        ("--camera none.json", "none.json: expected a file, found nothing"),
        ("--camera none.json --gain 2", "cannot be used with"),
    ] {
        let sentence = bench.refused(&format!("{LINE} --measurements a.npy {flags}"));
        assert!(sentence.contains(part), "{flags}: {sentence}");
    }
}

#[test]
fn camera_files_calibrate_images() {
    let bench = Bench::new();
    let mut random = Random(17);
    let (rows, cols) = (40, 48);
    let pattern: Vec<f64> = (0..rows * cols).map(|_| 6.0 * random.normal()).collect();
    let frames = |electrons: &dyn Fn(usize) -> f64, count: usize, random: &mut Random| -> Vec<f32> {
        let value = |pixel: usize, random: &mut Random| {
            let hot = if pixel == 500 { 800.0 } else { 0.0 };
            100.0 + pattern[pixel] + hot + 1.5 * (random.poisson(electrons(pixel)) + 2.0 * random.normal())
        };
        (0..count * rows * cols)
            .map(|pixel| value(pixel % (rows * cols), random).round().clamp(0.0, 4095.0) as f32)
            .collect()
    };
    for level in 0..=10 {
        let name = if level == 0 { "frames/dark.npy".into() } else { format!("frames/light_{level:02}.npy") };
        let electrons = 280.0 * f64::from(level);
        bench.write(&name, npy("(16, 40, 48)", &frames(&|_| electrons, 16, &mut random)));
    }
    let camera = bench.json("calibrate frames --out camera.json");
    assert_eq!(camera["hot_pixels"]["places"], serde_json::json!([[10, 20]]));
    assert_eq!(camera["maps"]["dark_signal_dn"], "camera-dark.npy");
    bench.write("flat.npy", npy("(16, 40, 48)", &frames(&|_| 300.0, 16, &mut random)));
    let found = bench.json(&format!("{LINE} --measurements flat.npy --camera camera.json"));
    assert!(bits(&found).abs() < 0.03, "{found}");
    assert!(found["noise"].as_str().unwrap().starts_with("shot+read:2."), "{found}");
    for part in
        ["electrons are (grey level - the dark map of the camera) / 1.", "electrons per DN", "1 pixel has the value"]
    {
        assert!(has_note(&found, part), "{part} in {found}");
    }
    let other = bench.refused(&format!("{LINE} --measurements flat.npy --camera camera.json --gain 3"));
    assert!(other.contains("cannot be used with"), "{other}");
    bench.write("wide.npy", npy("(4, 40, 50)", &vec![300.0; 4 * 40 * 50]));
    let other = bench.refused(&format!("{LINE} --measurements wide.npy --camera camera.json"));
    assert!(other.contains("expected images of 40 x 48 px"), "{other}");
}

#[test]
fn systems_are_compared_on_equal_patches() {
    let bench = Bench::new();
    let mut random = Random(19);
    // Scenes of random stripes, the second system with a third of their contrast.
    for scene in 0..12 {
        let contrast = 0.2 + 0.8 * random.uniform();
        let stripes: Vec<f64> = (0..40).map(|_| random.uniform() - 0.5).collect();
        for (system, share) in [("lens", 1.0), ("diffuser", 0.33)] {
            let light = |pixel: usize| 100.0 * (1.0 + share * contrast * stripes[pixel % 40]);
            let image: Vec<f32> = (0..40 * 40).map(|pixel| random.poisson(light(pixel)) as f32).collect();
            bench.write(&format!("{system}/im{scene}.npy"), npy("(40, 40)", &image));
        }
    }
    let line = format!("{LINE} --measurements lens --measurements diffuser");
    let found = bench.json(&line);
    super::schemas::Schema::open("system-comparison").check(&found);
    assert_eq!(found["format"], "lenslet-studio/system-comparison");
    let difference = &found["differences"][0];
    let [low, high] = [0, 1].map(|end| difference["interval_95"][end].as_f64().unwrap());
    assert!(difference["is_paired"] == true && low > 0.0, "{found}");
    let own = found["systems"][0]["interval_95"].as_array().unwrap();
    let width = own[1].as_f64().unwrap() - own[0].as_f64().unwrap();
    assert!(high - low < 2.0 * width, "{found}");
    assert!(has_note(&found["systems"][0], "all 12 images were tested in 4 parts"), "{found}");
    let printed = bench.done(&line);
    assert!(printed.contains("lens less diffuser: ") && printed.contains("simultaneous frames"), "{printed}");
    std::fs::rename(bench.path("diffuser/im0.npy"), bench.path("diffuser/other.npy")).unwrap();
    let unpaired = bench.json(&line);
    assert_eq!(unpaired["differences"][0]["is_paired"], false);
    assert_eq!(bench.json(&format!("{line} --simultaneous"))["differences"][0]["is_paired"], true);
    let refused = bench.refused(&format!("{line} --estimator causal --resume fit"));
    assert!(refused.contains("for one system"), "{refused}");
}
