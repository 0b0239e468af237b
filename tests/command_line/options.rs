//! Values of options, valid and not: every value is computed or refused, and nothing panics.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use serde_json::Value;

use super::{Bench, idx, npy, text};

#[test]
fn values_out_of_range_are_refused_by_name() {
    let bench = Bench::new();
    for (line, part) in [
        ("estimate --patch 66", "66 x 66"),
        ("estimate --patch 0", "patch \"0\""),
        ("estimate --patch 4x", "patch \"4x\""),
        ("estimate --patch 18446744073709551615", "18446744073709551615"),
        ("estimate --patches-test 0", "--patches-test 0: expected 2"),
        // An interval of one patch has no width.
        ("estimate --patches-test 1", "--patches-test 1: expected 2"),
        ("study run bracket --patches-test 1 --out study", "patches_test: expected 2"),
        ("estimate --trials 0", "--trials 0: expected 1"),
        ("estimate --trials 18446744073709551615", "--trials"),
        ("estimate --patches-train 0", "at least"),
        ("estimate --patches-train 18446744073709551615", "--patches-train"),
        ("estimate --patches-train 100000000000", "--patches-train"),
        ("estimate --patches-test 1000000 --patch sensor --patches-train 2", "do not fit into memory"),
        ("estimate --noise none", "unbounded without noise"),
        ("estimate --noise read:0", "read noise"),
        ("estimate --noise read:nan", "read noise"),
        ("estimate --estimator pixel", "pixelcnn"),
        ("estimate --budget 60s", "--estimator pixelcnn"),
        ("estimate --estimator pixelcnn --budget 60", "budget \"60\""),
        ("estimate --estimator pixelcnn --budget 200h", "168h"),
        ("estimate --engine burn:ndarray", "--estimator pixelcnn"),
        ("estimate --resume fit", "--estimator pixelcnn, causal or bracket"),
        ("estimate --estimator causal --save-weights fit", "are for --estimator pixelcnn"),
        ("estimate --estimator pixelcnn --resume fit --save-weights ./fit", "expected two files"),
        ("estimate --estimator pixelcnn --weights none", "none"),
        ("estimate --estimator pixelcnn --weights none --trials 2", "--trials"),
        (
            "estimate --estimator pixelcnn --budget 1s --save-weights none/fit",
            "none/fit: expected to write the file, found \"no such folder\"",
        ),
        ("estimate --estimator causal --engine cpu", "--estimator pixelcnn"),
        ("estimate --init random", "--estimator causal or bracket"),
        ("estimate --estimator causal --protocol paper", "leave it out for causal"),
        ("estimate --estimator bracket --trials 2", "one trial"),
        ("estimate --estimator causal --noise none", "unbounded without noise"),
        ("estimate --estimator bracket --patch 66", "do not fit measurements of 65 x 65"),
        ("estimate --estimator pixelcnn --engine gpu", "burn:ndarray"),
        ("estimate --estimator pixelcnn --engine cpu:2", "burn:wgpu"),
        ("estimate --protocol mine", "paper"),
        (
            "estimate --bias 0 --protocol paper --patch 8 --patches-train 50 --patches-test 50 --objects beads:0.0005",
            "bias",
        ),
        ("simulate --count 0 --out out", "--count 0: expected 1"),
        ("simulate --count 18446744073709551615 --out out", "--count"),
        ("simulate --count 99999999999999999999 --out out", "--count"),
        ("simulate --count -1 --out out", "-1"),
        ("simulate --objects beads:0.0001 --out out", "at least 0.000108"),
        ("simulate --objects beads:1e-320 --out out", "density"),
        ("simulate --objects volume:65:0.1 --out out", "64 planes"),
        ("simulate --objects beads:nan --out out", "above 0"),
        ("simulate --objects mnist --out out", "beads:0.02"),
        ("simulate --mean-photons 0 --out out", "mean_photons"),
        ("simulate --mean-photons 1e308 --out out", "mean_photons"),
        ("simulate --mean-photons nan --out out", "mean_photons"),
        ("simulate --bias=-1 --out out", "bias_photons"),
        ("simulate --bias inf --out out", "bias_photons"),
        ("simulate --seed -1 --out out", "-1"),
        ("simulate --seed 18446744073709551616 --out out", "--seed"),
        ("export --mask heuristic:10 --out out", "1 to 9"),
        ("export --mask heuristic:-1 --out out", "1 to 9"),
        ("export --mask random:4097 --out out", "1 to 4096"),
        ("export --mask diffuser:33 --out out", "1 to 32"),
        ("export --mask depth:0 --out out", "1 to 5"),
        ("export --mask psf:a@0 --out out", "1 to 1024"),
        ("export --mask psf:a@99999999999999999999 --out out", "1 to 1024"),
        ("export --mask pinhole --out out", "heuristic:1 to 9"),
        ("export --mask psf:a --grid 0 --out out", "--grid 0: expected 1 to 1024"),
        ("export --mask psf:a@8 --grid 8 --out out", "expected a --mask without @"),
        (
            "export --mask heuristic:2 --grid 97 --field 96 --out out",
            "expected at least the 97 x 97 px of the PSF grid",
        ),
        ("export --mask diffuser:8 --grid 7 --out out", "grid_px is 7 px; expected 8 to 1024 px"),
        ("bounds --field 20", "the field of the objects is 20 x 20 px; expected at least the 32 x 32 px"),
        ("bounds --field 0", "field \"0\": expected pixels such as 256, or rows x cols"),
        ("bounds --field 96x1025", "field columns is 1025 px; expected 1 to 1024 px"),
        ("bounds --placement mirrored", "expected scaled, tiled or cropped"),
        ("bounds --pixel-pitch 0", "pixel_pitch_um is 0.0; expected 0.01 to 1000 micrometres"),
        ("export --colormap jet --out out", "viridis"),
        ("export", "--out"),
        ("simulate", "--out"),
        ("tamura", "FILES"),
        ("export --out out --count 3", "--count"),
    ] {
        let told = bench.refused(line);
        assert!(told.contains(part), "{line}: {part:?} in {told}");
    }
    assert!(bench.files().is_empty());
}

#[test]
fn values_at_the_ends_of_their_ranges_are_computed() {
    let bench = Bench::new();
    bench.write("flat.npy", npy("(2, 40, 33)", &[5.0; 2 * 40 * 33]));
    bench.write("one.npy", npy("(1, 1)", &[7.0]));
    bench.write("one.idx", idx(2, 1, |_| 255));
    for line in [
        "simulate --count 1 --seed 18446744073709551615 --out a",
        "simulate --count 1 --objects beads:0.00011 --out a",
        "simulate --count 1 --objects beads:1 --out a",
        "simulate --count 1 --objects beads-max:0.15 --out a",
        "simulate --count 1 --objects volume:64:0.001 --out a",
        "simulate --count 3 --objects stack:flat.npy --out a",
        "simulate --count 1 --objects idx:one.idx --out a",
        "simulate --count 1 --bias 0 --mean-photons 1e-300 --out a",
        "simulate --count 1 --bias 1e7 --mean-photons 1e7 --noise shot+read:1e6 --out a",
        "simulate --count 1 --noise read:1e-6 --out a",
        "simulate --count 1 --mask psf:one.npy --out a",
        "simulate --count 1 --mask psf:one.npy@96 --out a",
        "export --mask random:4096 --seed 0 --out b",
        "export --mask diffuser:1 --seed 18446744073709551615 --out b",
        "export --mask psf:one.npy@1024 --out b",
        "estimate --patch 1 --patches-train 50 --patches-test 2 --seed 18446744073709551615 --trials 3",
        "estimate --patch 65x1 --patches-train 300 --patches-test 20",
        "estimate --patches-train 0 --patches-test 5 --estimator gaussian-analytic",
        "estimate --bias 0 --patch 4 --patches-train 50 --patches-test 20",
        "estimate --protocol paper --noise read:5 --patch 4 --patches-train 50 --patches-test 20",
        "estimate --objects beads:1 --patch 4 --patches-train 50 --patches-test 20",
        "estimate --objects stack:flat.npy --patch 4x2 --patches-train 50 --patches-test 20",
    ] {
        bench.done(line);
    }
}

#[test]
fn field_and_grid_give_their_sizes_to_every_command() {
    let bench = Bench::new();
    bench.done("simulate --mask heuristic:3 --grid 48 --field 100x120 --pixel-pitch 3.45 --count 2 --out a");
    let size = std::fs::metadata(bench.path("a/measurements.npy")).unwrap().len();
    assert_eq!(size, 128 + 4 * 2 * (100 - 47) * (120 - 47));
    let design: Value = serde_json::from_slice(&std::fs::read(bench.path("a/design.json")).unwrap()).unwrap();
    assert_eq!((&design["field"], &design["format_version"]), (&serde_json::json!([100, 120]), &Value::from(3)));
    assert_eq!((&design["encoder"]["rows"], &design["pixel_pitch_um"]), (&Value::from(48), &Value::from(3.45)));
    // The grid of a design scales its own mask; a preset takes the grid of the design.
    for (mask, grid, lenslets) in [("--grid 24", 24, 3), ("--mask heuristic:5", 48, 5)] {
        bench.done(&format!("export a/design.json {mask} --out b"));
        let design: Value = serde_json::from_slice(&std::fs::read(bench.path("b/design.json")).unwrap()).unwrap();
        assert_eq!(design["encoder"]["cols"], grid);
        assert_eq!(design["encoder"]["lenslets"].as_array().unwrap().len(), lenslets);
    }
    bench.done("export --mask psf:a/../b/psf.npy --grid 128 --out c");
    let design: Value = serde_json::from_slice(&std::fs::read(bench.path("c/design.json")).unwrap()).unwrap();
    assert_eq!(design["field"], serde_json::json!([384, 384]), "room for the PSF");
    let told = bench.done("bounds a/design.json");
    assert!(told.contains("100 x 120 px") && told.contains("of a 32 x 32 px patch"), "{told}");
    bench.done(
        "optimize --start random:4 --grid 24 --field 60 --steps 1 --patch 6 --objective density --score none --out run \
         --config {\"first_fit\":60,\"refit\":15,\"last_fit\":60}",
    );
    let run: Value = serde_json::from_slice(&std::fs::read(bench.path("run/run.json")).unwrap()).unwrap();
    assert_eq!((&run["start"]["field"], &run["result"]["rows"]), (&serde_json::json!([60, 60]), &Value::from(24)));
}

#[test]
fn former_names_of_commands_and_flags_are_read() {
    let bench = Bench::new();
    bench.write("one.npy", npy("(2, 2)", &[1.0, 2.0, 3.0, 4.0]));
    let sizes = "--patch 6 --patches-test 20 --steps 2 --seed 3";
    for (former, now) in [
        ("look --field 40 --lenslets heuristic:2", "bounds --field 40 --mask heuristic:2"),
        ("look --field 24 --lenslets psf:one.npy@8", "bounds --field 24 --mask psf:one.npy --resample 8"),
        (
            &*format!("estimate --estimator causal --fresh {sizes}"),
            &*format!("estimate --estimator causal --init random {sizes}"),
        ),
    ] {
        let number = |line: &str| {
            let result = bench.json(line);
            let bits = if line.contains("estimate") {
                &result["bits_per_pixel"]
            } else {
                &result["information"]["gaussian_bound"]
            };
            bits.as_f64().unwrap()
        };
        assert_eq!(number(former), number(now), "{former}");
    }
    bench.done("measure --count 1 --out a");
    for command in ["repeat", "reproduce"] {
        assert!(bench.refused(&format!("{command} none.json")).contains("none.json"));
    }
}

#[test]
fn lenslets_are_fitted_to_a_psf_image() {
    let bench = Bench::new();
    bench.done("export --mask heuristic:4 --out a");
    let told = text(&bench.run("export --mask fit:a/psf.tiff --out b".split_whitespace()).stderr);
    assert!(told.contains("4 lenslets stand for the PSF, 0.0 % of whose light is elsewhere"), "{told}");
    let rows = |folder: &str| std::fs::read_to_string(bench.path(format!("{folder}/lenslets.csv"))).unwrap();
    assert_eq!(rows("b").lines().count(), rows("a").lines().count());
    let told = bench.refused("design --start psf:a/psf.npy --out run");
    assert!(told.contains("--start fit:FILE"), "{told}");
}

#[test]
fn paths_may_have_spaces_and_any_letters() {
    let bench = Bench::new();
    let folder = bench.path("lens let ü 光 'a' \"b\" @32");
    std::fs::create_dir(&folder).unwrap();
    let name = |file: &str| folder.join(file).to_str().unwrap().to_owned();
    std::fs::write(name("a: b.npy"), npy("(2, 40, 40)", &[5.0; 3200])).unwrap();
    let done = |arguments: &[&str]| {
        let output = bench.run(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        text(&output.stdout)
    };
    let objects = format!("stack:{}", name("a: b.npy"));
    done(&["simulate", "--objects", &objects, "--count", "2", "--out", &name("out put")]);
    done(&["simulate", &name("out put/design.json"), "--count", "2", "--out", &name("again")]);
    assert_eq!(std::fs::read(name("out put/objects.npy")).unwrap(), std::fs::read(name("again/objects.npy")).unwrap());
    done(&["tamura", &name("out put/objects.npy")]);
    done(&["export", "--mask", &format!("design:{}", name("again/design.json")), "--out", &name("export")]);
    done(&["export", "--mask", &format!("psf:{}@16", name("export/psf.npy")), "--out", &name("small")]);
    done(&["export", "--objects", &objects, "--bias", "3", "--noise", "read:2", "--out", &name("scene")]);
    let scene: Value = serde_json::from_slice(&std::fs::read(name("scene/design.json")).unwrap()).unwrap();
    assert_eq!((&scene["objects"], &scene["noise"]), (&Value::from(objects.as_str()), &Value::from("read:2")));
    assert_eq!(scene["bias_photons"], 3.0);
    // After two dashes, a name that starts with a dash is a file.
    bench.write("-x.npy", npy("(8, 9)", &(0..72).map(|value| value as f32).collect::<Vec<_>>()));
    done(&["tamura", "--", "-x.npy"]);
}

#[cfg(target_os = "linux")]
#[test]
fn paths_need_not_be_text() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let bench = Bench::new();
    let odd = OsStr::from_bytes(b"odd-\xff\xfe");
    for json in [false, true] {
        let mut arguments =
            vec![OsStr::new("simulate"), OsStr::new("--count"), OsStr::new("1"), OsStr::new("--out"), odd];
        arguments.extend(json.then_some(OsStr::new("--json")));
        let output = bench.run(&arguments);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let exported = bench.run([OsStr::new("export"), OsStr::new("--json"), OsStr::new("--out"), odd]);
        assert_eq!(exported.status.code(), Some(0), "{}", text(&exported.stderr));
    }
    assert!(bench.path(odd).join("measurements.npy").is_file());
    let file = bench.path(odd).join("objects.npy");
    assert_eq!(bench.run([OsStr::new("tamura"), file.as_os_str()]).status.code(), Some(0));
    let missing = bench.run([OsStr::new("tamura"), OsStr::from_bytes(b"none-\xff")]);
    assert!(missing.status.code() == Some(2) && text(&missing.stderr).contains("found nothing"));
    let design = bench.path(odd).join("design.json");
    assert_eq!(bench.run([design.as_os_str()]).status.code(), Some(0));
    let objects = bench.run([
        OsStr::new("simulate"),
        OsStr::new("--objects"),
        OsStr::from_bytes(b"stack:\xff"),
        OsStr::new("--out"),
        odd,
    ]);
    assert_eq!(objects.status.code(), Some(2));
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 60,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(20_260_301),
        ..ProptestConfig::default()
    })]

    /// Numbers and words at the limits of the parsers, in every option.
    #[test]
    fn no_value_makes_it_panic(
        option in prop::sample::select(vec![
            "--objects", "--noise", "--bias", "--mean-photons", "--seed", "--mask", "--tiff", "--unknown",
        ]),
        kind in prop::sample::select(vec!["", "beads:", "volume:2:", "volume:", "read:", "shot+read:", "heuristic:",
            "random:", "diffuser:", "depth:", "psf:", "design:", "stack:", "idx:", "images:", "cifar:"]),
        value in prop_oneof![
            "[0-9]{1,2}", "-?[0-9]{0,3}(\\.[0-9]{0,3})?(e-?[0-9]{1,3})?", "[a-z:@ .x]{0,8}", "\\PC{0,6}",
            Just("nan".to_owned()), Just("inf".to_owned()), Just("1e999".to_owned()),
        ],
    ) {
        let bench = Bench::new();
        let value = format!("{kind}{value}");
        let output = bench.run(["simulate", "--count=1", "--out=out", &format!("{option}={value}")]);
        let told = text(&output.stderr);
        prop_assert!(matches!(output.status.code(), Some(0 | 2)), "{option}={value}: {:?} {told}", output.status);
        prop_assert!(!told.contains("panicked"), "{option}={value}: {told}");
    }
}
