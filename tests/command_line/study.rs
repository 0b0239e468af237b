//! Studies: tables that are computed cell by cell, resumed, and refused where their settings differ.

use serde_json::{Value, json};

use super::{Bench, idx, npy, text};

/// Cells that take fractions of a second.
const TINY: &str = "--patch 6 --patches-train 200 --patches-test 40 --estimator gaussian";

fn cells(study: &Value) -> &Vec<Value> {
    study["cells"].as_array().unwrap()
}

fn read(bench: &Bench, name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(bench.path(name)).unwrap()).unwrap()
}

fn written(bench: &Bench, name: &str) -> String {
    std::fs::read_to_string(bench.path(name)).unwrap()
}

#[test]
fn a_grid_is_computed_into_one_file_and_tables() {
    let bench = Bench::new();
    let study =
        bench.json(&format!("study grid {TINY} --objects beads:0.008 --objects beads:0.05 --lenslets 1,4 --out a"));
    assert_eq!(study, read(&bench, "a/study.json"));
    assert_eq!((&study["format"], &study["format_version"]), (&json!("lenslet-studio/study"), &json!(1)));
    let names: Vec<(&str, &str)> = cells(&study)
        .iter()
        .map(|cell| (cell["objects"].as_str().unwrap(), cell["design"].as_str().unwrap()))
        .collect();
    let beads = ["beads:0.008", "beads:0.05"];
    assert_eq!(names, beads.map(|beads| [(beads, "heuristic:1"), (beads, "heuristic:4")]).concat());
    for cell in cells(&study) {
        let estimate = &cell["estimate"];
        assert!(estimate["bits_per_pixel"].as_f64().unwrap() > 0.0 && estimate["ceiling"].as_f64().unwrap() > 0.0);
        assert_eq!((&estimate["format"], &estimate["patch"]), (&json!("lenslet-studio/estimate"), &json!([6, 6])));
        assert!(cell["machine"]["threads"].as_u64().unwrap() > 0, "{cell}");
        // Published values belong to other patches.
        assert_eq!(cell["published"], Value::Null);
    }
    assert_eq!((&study["summary"]["estimated"], &study["summary"]["failed"]), (&json!(4), &json!(0)));
    // A cell equals the result of the estimate command.
    let line = "estimate --estimator gaussian --patch 6 --patches-train 200 --patches-test 40 --seed 1";
    let mut alone = bench.json(&format!("{line} --objects beads:0.05 --mask heuristic:4"));
    alone["seconds"] = cells(&study)[3]["estimate"]["seconds"].clone();
    for (name, value) in cells(&study)[3]["estimate"].as_object().unwrap() {
        assert_eq!(&alone[name], value, "{name}");
    }
    assert_eq!(written(&bench, "a/study.csv").lines().count(), 5);
    assert!(written(&bench, "a/study.md").contains("| beads:0.05 | heuristic:4 | 6 x 6 px |"));
    assert!(!bench.path("a/study.svg").exists());
}

#[test]
fn images_that_were_left_out_are_told() {
    let bench = Bench::new();
    let images: Vec<f32> = (0..12 * 40 * 40).map(|index| (index * 37 % 101) as f32).collect();
    bench.write("seen/all.npy", npy("(12, 40, 40)", &images));
    bench.write("seen/bad.png", "no image");
    let line = format!("study grid {TINY} --objects images:seen --lenslets 2 --out a");
    let printed = bench.done(&line);
    let notice = "- images:seen: 1 unreadable file was left out: bad.png";
    assert!(printed.contains(notice) && written(&bench, "a/study.md").contains(notice), "{printed}");
    assert!(read(&bench, "a/study.json")["notices"].to_string().contains("bad.png"));
    // The study stays the same where its objects become readable later.
    std::fs::remove_file(bench.path("seen/bad.png")).unwrap();
    assert!(!bench.done(&line).contains("left out"));
}

#[test]
fn published_values_stand_beside_estimates_of_the_same_patch() {
    let bench = Bench::new();
    bench.write("a.idx", idx(40, 28, |index| (index * 7 % 251) as u8));
    bench.write("b.idx", idx(40, 28, |index| (index * 11 % 241) as u8));
    let tiny = "--estimator gaussian --patches-train 60 --patches-test 20";
    let published = |line: &str| -> Vec<Value> {
        let study = bench.json(&format!("study grid {tiny} {line}"));
        cells(&study).iter().map(|cell| cell["published"]["bits_per_pixel"].clone()).collect()
    };
    assert_eq!(
        published("--lenslets 2,3 --objects beads:0.02 --objects beads:0.021 --out a"),
        [json!(0.3866), json!(0.477), Value::Null, Value::Null]
    );
    assert_eq!(published("--lenslets 2 --objects beads:0.02 --noise read:5 --out b"), [json!(0.4671)]);
    let sets = "--lenslets 9 --objects idx:a.idx --objects idx:b.idx";
    assert_eq!(
        published(&format!("{sets} --published-as mnist --published-as none --out c")),
        [json!(0.611), Value::Null]
    );
    assert_eq!(
        published(&format!("{sets} --published-as cifar10 --published-as fashion --out d")),
        [json!(0.1691), json!(0.3829)]
    );
    // Beads need no set name.
    assert_eq!(
        published("--lenslets 9 --objects beads:0.02 --objects idx:a.idx --published-as mnist --out g"),
        [json!(0.57), json!(0.611)]
    );
    // No published set consists of beads.
    let sentence = bench.refused("study grid --objects beads:0.02 --published-as mnist --out f");
    assert!(sentence.contains("beads:0.02") && sentence.contains("--published-as none"), "{sentence}");
    // Gaussian bounds of beads decrease with the number of lenslets. Published values of sparse ones increase.
    let told = bench.done(
        "study grid --estimator gaussian --patches-train 2000 --patches-test 200 --objects beads:0.008 --lenslets 1,4,9 --out e",
    );
    for part in [
        "rank correlation with the published order of 3 designs -1.00",
        "0 of 3 estimates (0 %) at most the published value + 0.02 bits per pixel, 0 by the density model alone",
        "3 of 3 estimates above the entropy bound",
        "e/study.csv",
    ] {
        assert!(told.contains(&part.replace('/', std::path::MAIN_SEPARATOR_STR)), "{part} in {told}");
    }
}

#[test]
fn what_is_missing_is_computed_and_nothing_else() {
    let bench = Bench::new();
    let line = format!("study grid {TINY} --objects beads:0.02 --lenslets 1,2,4 --out a");
    let whole = bench.json(&line);
    // The state after a kill in the third cell. The first cell carries a mark.
    let mut part = whole.clone();
    part["cells"].as_array_mut().unwrap().truncate(2);
    part["cells"][0]["estimate"]["notes"] = json!(["computed before"]);
    bench.write("a/study.json", part.to_string());
    std::fs::remove_file(bench.path("a/study.csv")).unwrap();
    let output = bench.run(format!("{line} --json").split_whitespace());
    let told = text(&output.stderr);
    assert!(told.contains("3 cells, seconds each, 2 of them there already"), "{told}");
    assert!(told.contains("Cell 3 of 3: beads:0.02, heuristic:4") && !told.contains("Cell 2 of 3"), "{told}");
    let again: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(cells(&again)[..2], cells(&part)[..]);
    let bits = |study: &Value| cells(study)[2]["estimate"]["bits_per_pixel"].clone();
    assert_eq!(bits(&again), bits(&whole), "the same seed gives the same cell");
    assert_eq!(written(&bench, "a/study.csv").lines().count(), 4);
    // Nothing is missing: nothing is computed, and the file is unchanged.
    let bytes = written(&bench, "a/study.json");
    let output = bench.run(line.split_whitespace());
    assert!(text(&output.stderr).contains("nothing is left to compute"), "{}", text(&output.stderr));
    assert_eq!(written(&bench, "a/study.json"), bytes);
}

#[test]
fn a_changed_setting_is_refused_in_one_sentence() {
    let bench = Bench::new();
    bench.write("a.idx", idx(40, 28, |index| (index * 7 % 251) as u8));
    let line = "study grid --patches-train 200 --patches-test 40 --estimator gaussian --objects idx:a.idx --patch 6";
    bench.done(&format!("{line} --lenslets 1 --out a"));
    let before = written(&bench, "a/study.json");
    for (change, part) in [
        ("--lenslets 1,2", "designs heuristic:1, heuristic:2, found one with heuristic:1"),
        ("--lenslets 1 --seed 2", "seed 2, found one with 1"),
        ("--lenslets 1 --noise read:5", "noise read:5, found one with shot"),
        ("--lenslets 1 --published-as mnist", "published image sets mnist"),
    ] {
        let told = bench.refused(&format!("{line} {change} --out a"));
        assert!(told.contains(part) && told.contains("study.json") && told.contains("another folder"), "{told}");
    }
    assert!(bench.refused("study patches --estimator gaussian --sides 6 --out a").contains("kind patches"));
    // The same name with other images.
    bench.write("a.idx", idx(40, 28, |index| (index * 11 % 251) as u8));
    let told = bench.refused(&format!("{line} --lenslets 1 --out a"));
    assert!(told.contains("objects of the fingerprint"), "{told}");
    assert_eq!(written(&bench, "a/study.json"), before);
}

#[test]
fn a_file_that_is_no_study_is_refused_and_kept() {
    let bench = Bench::new();
    let line = format!("study grid {TINY} --objects beads:0.02 --lenslets 1 --out a");
    bench.done(&line);
    let whole = written(&bench, "a/study.json");
    let newer = whole.replacen("\"format_version\": 1", "\"format_version\": 2", 1);
    let half = whole[..whole.len() / 2].to_owned();
    for (text, part) in [
        (half, "line "),
        (String::new(), "an empty file"),
        ("{\"format\": \"lenslet-studio/design\"}".into(), "lenslet-studio/design"),
        (newer, "newer Lenslet Studio"),
        (whole.replacen("\"beads:0.02\"", "\"pearls\"", 1), "pearls"),
    ] {
        bench.write("a/study.json", &text);
        let told = bench.refused(&line);
        assert!(told.contains(part) && told.contains("study.json"), "{part:?} in {told}");
        assert_eq!(written(&bench, "a/study.json"), text);
    }
}

#[test]
fn a_cell_that_fails_has_its_sentence_and_the_others_go_on() {
    let bench = Bench::new();
    let line = "study patches --estimator gaussian --patches-train 400 --patches-test 40 --sides 70,6,4 --out a";
    for _ in 0..2 {
        let output = bench.run(format!("{line} --json").split_whitespace());
        assert_eq!(output.status.code(), Some(1));
        let told = text(&output.stderr);
        assert!(told.contains("found 1 of 3 failed") && told.contains("do not fit measurements of 65 x 65"), "{told}");
        assert!(!told.contains("panicked"), "{told}");
        let study: Value = serde_json::from_slice(&output.stdout).unwrap();
        let failed = &cells(&study)[0];
        assert!(failed["failure"].as_str().unwrap().contains("70 x 70") && failed["estimate"].is_null(), "{failed}");
        assert!(cells(&study)[1..].iter().all(|cell| cell["failure"].is_null() && !cell["estimate"].is_null()));
    }
    assert!(written(&bench, "a/study.md").contains("- failed: beads:0.02, heuristic:9, 70 x 70 px: "));
    assert!(written(&bench, "a/study.csv").lines().nth(1).unwrap().contains("70 x 70"));
}

#[test]
fn patches_are_compared_with_the_sensor() {
    let bench = Bench::new();
    bench.done("export --mask random:3 --seed 5 --out design");
    let line = "study patches design/design.json --objects beads:0.05 --estimator gaussian --patches-train 60";
    let study = bench.json(&format!("{line} --patches-test 20 --sides 6,12x5,sensor --out a"));
    assert_eq!(study["settings"]["patches"], json!([[6, 6], [12, 5], null]));
    assert_eq!(cells(&study)[2]["estimate"]["patch"], json!([65, 65]));
    let bits = |cell: usize| cells(&study)[cell]["estimate"]["bits_per_pixel"].as_f64().unwrap();
    let over = &study["summary"]["patch_to_sensor_ratio"][0];
    assert!((over["difference"].as_f64().unwrap() - (bits(0) - bits(2))).abs() < 1e-12, "{over}");
    assert!((over["ratio"].as_f64().unwrap() - bits(0) / bits(2)).abs() < 1e-12, "{over}");
    assert_eq!(study["settings"]["designs"][0]["name"], "3 lenslets");
}

#[test]
fn brackets_hold_bounds_from_both_sides_and_are_drawn() {
    let bench = Bench::new();
    let line = "study bracket --budget 0.2s --patches-test 20 --patch 8 --lenslets 1,4 --densities 0.02,0.05";
    let study = bench.json(&format!("{line} --out a"));
    assert_eq!(cells(&study).len(), 4);
    for cell in cells(&study) {
        let number = |key: &str| cell["estimate"][key].as_f64().unwrap_or_else(|| panic!("{key} in {cell}"));
        assert!(number("lower") >= 0.0 && number("lower") <= number("upper"), "{cell}");
        assert!(number("upper") <= number("ceiling"));
        assert_eq!(cell["estimate"]["upper_bounds"].as_array().unwrap().len(), 4);
    }
    let plot = written(&bench, "a/study.svg");
    for part in ["<svg ", "\n1 lenslet\n", "\n4 lenslets\n", "information (bits per pixel)", "\n0.05\n", "</svg>"] {
        assert!(plot.contains(part), "{part}");
    }
    let table = written(&bench, "a/study.md");
    assert!(
        table.contains(
            "| lower bound | by the decoder | upper bound | from | density bound | Gaussian bound | entropy bound |"
        ),
        "{table}"
    );
    let table = written(&bench, "a/study.csv");
    let columns: Vec<&str> = table.lines().next().unwrap().split(',').collect();
    for (row, cell) in table.lines().skip(1).zip(cells(&study)) {
        let row: Vec<&str> = row.split(',').collect();
        let at = |name: &str| row[columns.iter().position(|&column| column == name).unwrap()];
        let number = |name: &str| at(name).parse::<f64>().unwrap();
        assert_eq!(at("lower_from"), cell["estimate"]["lower_from"].as_str().unwrap());
        let below = ["decoder_bound_bits_per_px", "posterior_sampling_lower_bits_per_px"].map(number);
        assert_eq!(below[0].max(below[1]), number("lower_bits_per_px"), "{row:?}");
        assert!(number("posterior_sampling_upper_bits_per_px") >= number("bits_per_px"), "{row:?}");
    }
}

#[test]
fn fitted_estimators_take_their_budget() {
    let bench = Bench::new();
    let line = "study grid --patch 6 --patches-train 100 --patches-test 20 --objects beads:0.05 --lenslets 2";
    for estimator in ["causal", "pixelcnn"] {
        let study = bench.json(&format!("{line} --estimator {estimator} --budget 0.2s --out {estimator}"));
        assert_eq!(study["settings"]["estimator"], estimator);
        assert_eq!(study["settings"]["budget_seconds"], 0.2);
        assert_eq!(cells(&study)[0]["estimate"]["estimator"], estimator);
    }
}

#[test]
fn settings_that_cannot_be_computed_are_refused() {
    let bench = Bench::new();
    for (line, part) in [
        ("grid", "--out"),
        ("grid --lenslets 10 --out out", "from 1 to 9"),
        ("grid --lenslets 4,4 --out out", "heuristic:4 twice"),
        ("grid --objects beads:0.02 --objects beads:0.020 --out out", "beads:0.02 twice"),
        ("grid --objects mnist --out out", "beads:0.02"),
        ("grid --objects idx:none.gz --out out", "none.gz"),
        ("grid --objects beads:0.02 --published-as moon --out out", "cifar10"),
        ("grid --objects beads:0.02 --published-as mnist --published-as none --out out", "found 2"),
        ("grid --published-as mnist --out out", "--objects"),
        ("grid --estimator gaussian --budget 60s --out out", "leave it out"),
        ("grid --estimator magic --out out", "causal"),
        ("grid --noise none --out out", "without noise"),
        ("grid --patches-test 0 --out out", "--patches-test 0: expected 2"),
        ("grid --patch 0 --out out", "patch \"0\""),
        ("patches --sides 8,x --out out", "patch \"x\""),
        ("patches --sides 8,8 --out out", "8 x 8 px twice"),
        ("patches --mean-photons 0 --out out", "mean_photons"),
        ("bracket --densities 0 --out out", "above 0"),
        ("bracket --densities 0.02,2 --out out", "at most 1"),
        ("bracket --estimator causal --out out", "--estimator"),
        ("bracket --budget 0s --out out", "budget"),
    ] {
        let told = bench.refused(&format!("study {line}"));
        assert!(told.contains(part), "{line}: {part:?} in {told}");
    }
    bench.write("file", "x");
    assert!(bench.refused("study grid --estimator gaussian --out file").contains("found a file"));
}

/// A study of decoders is resumed, and its files hold information beside image quality.
#[test]
fn information_and_decoders_stand_side_by_side() {
    let bench = Bench::new();
    let line = "study decoders --lenslets 9 --decoders linear,posterior --test 3 --information 1s --out a";
    let record = bench.json(line);
    assert_eq!(cells(&record).len(), 3);
    assert!(cells(&record)[0]["information"]["lower"].as_f64().unwrap() > 0.2, "{record}");
    assert!(cells(&record)[2]["quality"]["psnr_db"].as_f64().unwrap() > 27.0, "{record}");
    // Nothing is computed again, so the seconds are the same.
    assert_eq!(bench.json(line), record);
    for file in ["a/decoders.md", "a/decoders.csv", "a/decoders.svg"] {
        assert!(!written(&bench, file).is_empty(), "{file}");
    }
    let refused = bench.refused(&line.replace("--test 3", "--test 4"));
    assert!(refused.contains("expected a study with test 4, found one with 3"), "{refused}");
}
