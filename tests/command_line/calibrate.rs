//! `calibrate`: frames of a simulated sensor through the program.

use serde_json::json;

use super::schemas::Schema;
use super::{Bench, npy, text};

/// Frames of `count` pairs of 40 x 50 px of a sensor of 2 DN per electron, offset 100 and read noise of 3 electrons.
fn frames(electrons: f64, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1_u64 << 24) as f64
    };
    let mut normal = move || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
    let value = |normal: f64| 100.0 + 2.0 * (electrons + (electrons + 9.0).sqrt() * normal);
    (0..2 * 40 * 50).map(|_| value(normal()).round().clamp(0.0, 4095.0) as f32).collect()
}

/// A folder of frames and a descriptor of the same.
fn series(bench: &Bench) {
    let mut descriptor = "v 4.0\nn 12 50 40\nd 1000\ni frames\\dark.npy\n".to_owned();
    bench.write("frames/dark.npy", npy("(2, 40, 50)", &frames(0.0, 1)));
    for level in 1..=12 {
        let electrons = 180.0 * f64::from(level);
        let name = format!("light_{level:02}.npy");
        bench.write(&format!("frames/{name}"), npy("(2, 40, 50)", &frames(electrons, 1 + level as u64)));
        descriptor += &["b 1000 ", &(2.0 * electrons).to_string(), "\ni frames\\", &name, "\n"].concat();
    }
    bench.write("camera.txt", descriptor);
}

#[test]
fn cameras_are_calibrated_from_folder_and_descriptor() {
    let bench = Bench::new();
    series(&bench);
    let found = bench.json("calibrate camera.txt --out camera.json");
    let gain = found["system_gain_dn_per_electron"].as_f64().unwrap();
    assert!((gain - 2.0).abs() < 0.15, "{found}");
    assert_eq!((&found["format"], &found["grouping"]), (&json!("lenslet-studio/camera"), &json!("descriptor")));
    assert_eq!(found["groups"].as_array().unwrap().len(), 13);
    assert!((found["quantum_efficiency"].as_f64().unwrap() - 0.5).abs() < 0.02, "{found}");
    assert!(found["prnu_percent"].is_null());
    for file in ["camera.json", "camera-mask.npy", "camera.svg"] {
        assert!(bench.path(file).is_file(), "{file}");
    }
    Schema::open("calibrate-output").check(&found);
    Schema::open("camera").check(&serde_json::from_slice(&std::fs::read(bench.path("camera.json")).unwrap()).unwrap());
    let folder = bench.json("calibrate frames");
    assert_eq!(folder["system_gain_dn_per_electron"], found["system_gain_dn_per_electron"]);
    assert_eq!((&folder["files"], &folder["quantum_efficiency"]), (&json!([]), &json!(null)));

    let output = bench.run("calibrate frames --descriptor again.txt".split(' '));
    let (printed, report) = (text(&output.stdout), text(&output.stderr));
    for part in ["system gain", "DN/e-", "inverse gain", "95 % intervals", "linearity error            unknown"] {
        assert!(printed.contains(part), "{part} in {printed}");
    }
    assert!(report.contains("frames: 13 groups by file names") && report.contains("dark  dark: 1 file"), "{report}");
    let again = bench.json("calibrate again.txt");
    assert_eq!(again["system_gain_dn_per_electron"], found["system_gain_dn_per_electron"]);
}

#[test]
fn what_cannot_be_calibrated_is_refused_and_nothing_is_written() {
    let bench = Bench::new();
    series(&bench);
    bench.write("alone/dark_1.npy", npy("(2, 2)", &[1.0; 4]));
    bench.write("alone/light_1.npy", npy("(2, 2)", &[1.0; 4]));
    bench.write("wrong.txt", "b 1\n");
    let wrapped: Vec<f32> = frames(0.0, 1).iter().map(|value| (value - 100.0).rem_euclid(65536.0)).collect();
    bench.write("wrapped/dark.npy", npy("(2, 40, 50)", &wrapped));
    bench.write("wrapped/light.npy", npy("(2, 40, 50)", &frames(500.0, 2)));
    for (line, part) in [
        ("calibrate", "FRAMES"),
        ("calibrate none", "found nothing"),
        ("calibrate frames/dark.npy", "a line v, n, b, d, i or #"),
        ("calibrate wrong.txt --out a.json", "found \"b 1\" in line 1"),
        ("calibrate alone --out a.json", "expected 2 or more frames of dark, found 1"),
        ("calibrate frames --out none/a.json", "no such folder"),
        ("calibrate frames --out frames/dark.npy", "found an input"),
        ("calibrate frames --out a.json --descriptor ./a.json", "expected two files"),
        ("calibrate frames --channel luma", "expected red, green, blue"),
        ("calibrate frames --channel red", "found grey frames; leave the channel out"),
        ("calibrate wrapped", "negative values wrapped around zero"),
        ("calibrate frames --bayer RGB", "expected RGGB"),
    ] {
        let sentence = bench.refused(line);
        assert!(sentence.contains(part), "{line}: {part:?} in {sentence}");
    }
}
