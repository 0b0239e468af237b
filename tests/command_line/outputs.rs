//! Files and output of every subcommand.

use lenslet_studio::formats::{read_array, read_grey, read_pages};
use ndarray::{Array2, Array3, Axis, Ix2, Ix3};
use serde_json::{Value, json};

use super::{Bench, idx};

/// Sizes that take less time than the usual ones, with sensors larger than the patches of `bounds`.
const SMALL: &str = "--grid 12 --field 48";

fn array2(bench: &Bench, name: &str) -> Array2<f32> {
    read_array(&bench.path(name)).unwrap().into_dimensionality::<Ix2>().unwrap()
}

fn array3(bench: &Bench, name: &str) -> Array3<f32> {
    read_array(&bench.path(name)).unwrap().into_dimensionality::<Ix3>().unwrap()
}

fn bytes(bench: &Bench, name: &str) -> Vec<u8> {
    std::fs::read(bench.path(name)).unwrap()
}

#[test]
fn export_writes_one_psf_in_every_format() {
    let bench = Bench::new();
    let result = bench.json("export --mask heuristic:6 --out a");
    assert_eq!((&result["encoder"], &result["psf_rows"]), (&Value::from("6 lenslets"), &Value::from(32)));
    let files: Vec<&str> = result["files"].as_array().unwrap().iter().map(|file| file.as_str().unwrap()).collect();
    assert_eq!(files.len(), 6);
    assert!(files.iter().all(|file| bench.path(file).is_file()), "{files:?}");

    let psf = array2(&bench, "a/psf.npy");
    assert_eq!(psf.dim(), (32, 32));
    assert!((psf.mapv(f64::from).sum() - 1.0).abs() < 1e-6);
    // Row and column are those of the layout: lenslet 2 lies at row 7, column 9.
    assert!(psf[[7, 9]] > 0.9 * psf[[16, 16]] && psf[[9, 7]] < 0.1 * psf[[16, 16]]);
    let pages = read_pages(&bench.path("a/psf.tiff")).unwrap();
    assert!(pages.len() == 1 && pages[0] == psf);
    let peak = psf.iter().copied().fold(0.0, f32::max);
    for (name, levels) in [("a/psf.png", 255.0), ("a/psf16.png", 65535.0)] {
        let image = read_grey(&bench.path(name)).unwrap();
        let apart = (&image - &(&psf / peak * levels)).mapv(f32::abs).iter().copied().fold(0.0, f32::max);
        assert!(image.dim() == (32, 32) && apart <= 0.51, "{name}: {apart}");
    }
    let table = std::fs::read_to_string(bench.path("a/lenslets.csv")).unwrap();
    let lines: Vec<&str> = table.lines().collect();
    assert!(lines[0].starts_with("x_px,y_px,sigma_px,weight") && lines.len() == 7, "{table}");
    assert!(lines[2].starts_with("9.0,7.0,0.8,"), "{table}");
    // Export of a mask without lenslets removes the lenslets of an earlier mask from the folder.
    bench.done("export --mask diffuser:16 --out a");
    assert!(!bench.path("a/lenslets.csv").exists() && bench.path("a/psf.npy").is_file());
}

#[test]
fn an_exported_design_exports_the_same_bytes() {
    let bench = Bench::new();
    for (name, mask) in [("lenslets", "random:7"), ("volume", "depth:4"), ("diffuser", "diffuser:16")] {
        let (first, second) = (format!("{name}1"), format!("{name}2"));
        bench.done(&format!("export --mask {mask} --seed 5 --out {first}"));
        let result = bench.json(&format!("export {first}/design.json --out {second}"));
        for file in result["files"].as_array().unwrap() {
            let again = file.as_str().unwrap();
            let once = again.replacen(&second, &first, 1);
            assert!(bytes(&bench, &once) == bytes(&bench, again), "{once} and {again}");
        }
    }
    bench.done("export --mask psf:lenslets1/psf.tiff --out image1");
    bench.done("export image1/design.json --out image2");
    assert_eq!(bytes(&bench, "image1/psf.npy"), bytes(&bench, "lenslets1/psf.npy"));
    assert_eq!(bytes(&bench, "image1/design.json"), bytes(&bench, "image2/design.json"));
    assert_eq!(read_array(&bench.path("volume1/psf.npy")).unwrap().shape(), [5, 32, 32]);
    bench.done("export --mask psf:lenslets1/psf16.png@20 --out small");
    assert_eq!(array2(&bench, "small/psf.npy").dim(), (20, 20));
}

#[test]
fn colours_are_extra_and_change_no_data() {
    let bench = Bench::new();
    bench.done("export --out plain");
    for name in ["gray", "viridis", "inferno", "cividis", "diverging"] {
        bench.done(&format!("export --out coloured --colormap {name}"));
        assert!(read_grey(&bench.path(format!("coloured/psf-{name}.png"))).unwrap().dim() == (32, 32));
    }
    for name in ["psf.npy", "psf.png", "psf16.png", "psf.tiff", "design.json", "lenslets.csv"] {
        assert_eq!(bytes(&bench, &format!("plain/{name}")), bytes(&bench, &format!("coloured/{name}")), "{name}");
    }
    // Files of one mask stay together, and are removed for another mask.
    let coloured = |name: &str| bench.path(format!("coloured/psf-{name}.png")).exists();
    assert!(["gray", "viridis", "inferno", "cividis", "diverging"].into_iter().all(coloured));
    bench.done("export --out coloured --mask heuristic:2 --colormap gray");
    assert!(coloured("gray") && !["viridis", "inferno", "cividis", "diverging"].into_iter().any(coloured));
    // An input file is not removed.
    let refusal = bench.refused("export --mask psf:coloured/psf-gray.png --out coloured");
    assert!(refusal.contains("psf-gray.png"), "{refusal}");
}

#[test]
fn measurements_have_their_shapes_and_poisson_statistics() {
    let bench = Bench::new();
    let result = bench.json("simulate --mask heuristic:3 --count 40 --seed 9 --out a");
    assert_eq!(result["object_shape"], serde_json::json!([40, 96, 96]));
    assert_eq!(result["measurement_shape"], serde_json::json!([40, 65, 65]));
    let noiseless = array3(&bench, "a/noiseless.npy");
    let noisy = array3(&bench, "a/measurements.npy");
    assert_eq!(array3(&bench, "a/objects.npy").dim(), (40, 96, 96));
    assert!(String::from_utf8_lossy(&bytes(&bench, "a/measurements.npy")[..128]).contains("'<f4'"));
    assert!(noiseless.iter().all(|&photons| photons >= 10.0));
    assert!(noisy.iter().all(|&photons| photons >= 0.0 && photons.fract() == 0.0));
    let scores: Vec<f64> =
        noisy.iter().zip(&noiseless).map(|(&y, &x)| f64::from(y - x) / f64::from(x).sqrt()).collect();
    let samples = scores.len() as f64;
    let (mean, variance) = (scores.iter().sum::<f64>() / samples, scores.iter().map(|z| z * z).sum::<f64>() / samples);
    assert!(mean.abs() < 4.0 / samples.sqrt(), "{mean}");
    // The fourth moment of a standardised Poisson value is 3 + 1/x, with x at least 10.
    assert!((variance - 1.0).abs() < 4.0 * (2.1 / samples).sqrt(), "{variance}");

    let rated = bench.json("tamura a/measurements.npy");
    assert_eq!(rated, result["tamura"]);
    assert_eq!(rated["count"], 40);
    assert!((0.6..0.9).contains(&rated["mean"].as_f64().unwrap()), "{rated}");
    assert_eq!(bench.json("tamura a/objects.npy a/objects.npy")["count"], 80);
}

#[test]
fn seeds_reproduce_and_the_design_that_is_kept_repeats_the_run() {
    let bench = Bench::new();
    let line = "simulate --objects volume:3:0.01 --mask depth:3 --noise shot+read:2 --bias 4 --count 3";
    bench.done(&format!("{line} --seed 18446744073709551615 --out a"));
    bench.done("simulate a/design.json --count 3 --out b");
    bench.done(&format!("{line} --seed 1 --out c"));
    bench.done("simulate a/design.json --count 2 --out d");
    for name in ["objects.npy", "noiseless.npy", "measurements.npy", "design.json"] {
        assert!(bytes(&bench, &format!("a/{name}")) == bytes(&bench, &format!("b/{name}")), "{name}");
    }
    assert_ne!(bytes(&bench, "a/measurements.npy"), bytes(&bench, "c/measurements.npy"));
    assert_eq!(
        array3(&bench, "a/measurements.npy").slice_axis(Axis(0), (0..2).into()),
        array3(&bench, "d/measurements.npy")
    );
    assert_eq!(read_array(&bench.path("a/objects.npy")).unwrap().shape(), [3, 3, 96, 96]);
}

#[test]
fn tiff_stacks_hold_what_npy_stacks_hold() {
    let bench = Bench::new();
    bench.write("a.idx", idx(20, 28, |index| (index * 7 % 251) as u8));
    bench.done("simulate --objects idx:a.idx --count 3 --out npy");
    bench.done("simulate --objects idx:a.idx --count 3 --out tiff --tiff");
    for name in ["objects", "noiseless", "measurements"] {
        let stack = array3(&bench, &format!("npy/{name}.npy"));
        let pages = read_pages(&bench.path(format!("tiff/{name}.tiff"))).unwrap();
        assert_eq!(pages.len(), 3);
        assert!(pages.iter().zip(stack.outer_iter()).all(|(page, image)| page == image), "{name}");
    }
}

#[test]
fn an_estimate_is_never_bare() {
    let bench = Bench::new();
    let line = "estimate --patch 8x6 --patches-train 300 --patches-test 100 --trials 2 --noise shot --seed 3";
    for (estimator, name) in [
        ("gaussian", "gaussian-stationary"),
        ("gaussian-full", "gaussian-full"),
        ("gaussian-analytic", "gaussian-analytic"),
    ] {
        let result = bench.json(&format!("{line} --estimator {estimator}"));
        let number = |key: &str| result[key].as_f64().unwrap_or_else(|| panic!("{key} in {result}"));
        let bits = number("bits_per_pixel");
        assert!((number("entropy_y") - number("entropy_y_given_x") - bits).abs() < 1e-9);
        let [low, high] = [0, 1].map(|end| result["interval_95"][end].as_f64().unwrap());
        assert!(low <= bits && bits <= high && high - low < 0.5, "{low} {bits} {high}");
        assert!(number("ceiling") > 0.0 && number("seconds") >= 0.0 && number("trial_spread") >= 0.0);
        assert_eq!(result["estimator"], name);
        assert_eq!(result["protocol"], "default");
        assert_eq!(result["patch"], serde_json::json!([8, 6]));
        assert_eq!(result["patches_train"], if estimator == "gaussian-analytic" { 0 } else { 300 });
        assert_eq!((&result["patches_test"], &result["trials"]), (&Value::from(100), &Value::from(2)));
        assert_eq!((&result["noise"], &result["bias"]), (&Value::from("shot"), &Value::from(10.0)));
        assert_eq!(number("seed"), 3.0, "the seed that gives the same again");
        assert!([1.0, 2.0].contains(&number("smallest_trial")));
        for key in ["format", "format_version", "objects", "objects_fingerprint", "encoder", "notes"] {
            assert!(!result[key].is_null(), "{key}");
        }
        let mut again = bench.json(&format!("{line} --estimator {estimator}"));
        again["seconds"] = result["seconds"].clone();
        assert_eq!(again, result, "the same seed gives the same estimate");
    }
    let told = bench.done(line);
    for part in
        ["at most", "bits per pixel", "entropy bound", "gaussian-stationary", "default protocol", "seed", "patch 8 x 6"]
    {
        assert!(told.contains(part), "{part} in {told}");
    }
    assert_eq!(
        bench.json("estimate --patch sensor --patches-train 40 --patches-test 20")["patch"],
        serde_json::json!([65, 65])
    );
    let paper = bench.json(&format!("{line} --protocol paper"));
    assert_eq!(paper["protocol"], "paper");
}

#[test]
fn bounds_that_cross_are_told_alike_in_text_and_json() {
    let bench = Bench::new();
    let line = "estimate --mask heuristic:1 --mean-photons 1 --bias 10000 --patches-train 2000 --patches-test 200";
    let found = bench.json(line);
    let number = |name: &str| found[name].as_f64().unwrap_or_else(|| panic!("{name} in {found}"));
    let notes = found["notes"].to_string();
    assert!(number("upper") < 0.0 && number("upper") < number("lower"), "the light is lost in the noise: {found}");
    assert!(notes.contains("they agree") && notes.contains("the estimate is negative"), "{notes}");
    let told = bench.done(line);
    for part in [
        format!("lower bound {:.4} by ", number("lower")),
        format!("upper {:.4} by ", number("upper")),
        "note: the bounds cross within their intervals".to_owned(),
    ] {
        assert!(told.contains(&part), "{part} in {told}");
    }
}

#[test]
fn weak_read_noise_tells_no_more_than_none() {
    let bench = Bench::new();
    let bits = |line: &str, noise: &str| {
        let found = bench.json(&format!("{line} --noise {noise}"));
        (found["bits_per_pixel"].as_f64().unwrap(), found)
    };
    let lines = [
        "estimate --estimator gaussian-analytic --patch 8 --patches-test 60",
        "estimate --patch 8 --patches-train 300 --patches-test 60",
        "estimate --estimator causal --steps 4 --patch 8 --patches-test 20 --mask heuristic:2",
    ];
    for line in lines {
        let (shot, _) = bits(line, "shot");
        let (weak, found) = bits(line, "shot+read:0.05");
        assert_eq!(weak, shot, "{line}");
        assert_eq!(found["noise"], "shot+read:0.05", "{line}");
        assert!(found["notes"].to_string().contains("counts are whole"), "{line}: {}", found["notes"]);
        // Where read noise hides the counts it is not omitted. The difference is small here.
        let (more, found) = bits(line, "shot+read:0.5");
        assert!(more != shot && more < shot + 0.05, "{line}: {more} {shot}");
        assert!(!found["notes"].to_string().contains("counts are whole"), "{}", found["notes"]);
    }
    let gaussian =
        |noise: &str| bench.json(&format!("bounds {SMALL} --noise {noise}"))["information"]["gaussian_bound"].clone();
    let shot = gaussian("shot");
    assert!(shot.is_number(), "{shot}");
    assert_eq!(gaussian("shot+read:0.05"), shot);
}

#[test]
fn trials_of_fits_for_a_time_are_compared() {
    let bench = Bench::new();
    let found = bench.json("estimate --estimator causal --budget 0.3s --trials 2 --patch 6 --patches-test 20 --seed 4");
    assert_eq!(found["trials"], 2);
    assert!(found["trial_spread"].as_f64().unwrap() >= 0.0);
}

#[test]
fn beads_that_no_light_comes_from_are_told_before_a_fit() {
    let bench = Bench::new();
    // The one lenslet is focused on a plane without beads.
    let line = "estimate --mask depth:1 --patch 6 --patches-test 20 --steps 2";
    let refusal = bench.refused(&format!("{line} --estimator bracket"));
    assert!(refusal.contains("no photons"), "{refusal}");
    let found = bench.json(&format!("{line} --estimator causal"));
    assert!(found["notes"].to_string().contains("no bound by annealed importance sampling"), "{}", found["notes"]);
}

#[test]
fn light_from_planes_that_the_objects_do_not_have_is_told() {
    let bench = Bench::new();
    let part = "25.0 % of the PSF lies on planes that these objects do not have: they have 3, the mask has 4";
    let scene = format!("{SMALL} --mask depth:4 --objects volume:3:0.02");
    let sizes = "--patch 6 --patches-train 60 --patches-test 20";
    for (line, entry) in [
        (format!("bounds {scene}"), "notices"),
        (format!("simulate {scene} --count 1 --out a"), "notices"),
        (format!("estimate {scene} {sizes}"), "notes"),
        (format!("estimate {scene} {sizes} --estimator causal --steps 2"), "notes"),
    ] {
        let found = bench.json(&line)[entry].to_string();
        assert!(found.contains(part), "{line}: {found}");
    }
    let all = bench.json(&format!("bounds {}", scene.replace("volume:3", "volume:5")))["notices"].to_string();
    assert!(!all.contains("of the PSF lies"), "{all}");
}

#[test]
fn a_design_is_not_replaced_by_another_one() {
    let bench = Bench::new();
    bench.done("export --mask heuristic:2 --out own");
    for line in [
        "export own/design.json --bias 3 --out own",
        "simulate own/design.json --seed 9 --count 1 --out own",
        "design own/design.json --steps 1 --out own",
        "export --mask design:own/design.json --seed 5 --out own",
        "design --start design:own/design.json --steps 1 --out own",
    ] {
        let refusal = bench.refused(line);
        assert!(refusal.contains("design.json") && refusal.contains("--out"), "{line}: {refusal}");
    }
    bench.done("export own/design.json --out own");
    bench.done("simulate own/design.json --count 1 --out own");
}

#[test]
fn a_bracket_names_both_bounds_and_where_they_come_from() {
    let bench = Bench::new();
    let line = "estimate --estimator bracket --mask heuristic:2 --patch 8 --patches-test 60 --budget 1s --seed 3";
    let found = bench.json(&format!("{line} --objects beads:0.02"));
    let bits = |name: &str| found[name].as_f64().unwrap_or_else(|| panic!("{name} in {found}"));
    assert!(bits("lower") < bits("upper") && bits("upper") == bits("bits_per_pixel"), "{found}");
    assert!(bits("upper") <= bits("ceiling") && found["lower_from"] == found["lower_bounds"][0]["from"]);
    let interval = found["lower_interval_95"].as_array().unwrap();
    assert!(interval[0].as_f64().unwrap() <= bits("lower") && bits("lower") <= interval[1].as_f64().unwrap());
    let names: Vec<&str> =
        found["upper_bounds"].as_array().unwrap().iter().map(|bound| bound["from"].as_str().unwrap()).collect();
    assert!(names.len() == 4 && names[0] == found["upper_from"], "{names:?}");
    assert!(names.contains(&"posterior sampling"), "{names:?}");
    assert_eq!((&found["seed"], &found["estimator"]), (&Value::from(3), &Value::from("bracket")));

    // A request for an upper bound alone also gives the smallest one.
    let live = line.replace("bracket", "causal");
    let found = bench.json(&format!("{live} --objects beads:0.02"));
    let names: Vec<&str> =
        found["upper_bounds"].as_array().unwrap().iter().map(|bound| bound["from"].as_str().unwrap()).collect();
    assert!(names.len() == 3 && names.contains(&"density") && names.contains(&"posterior sampling"), "{names:?}");
    assert_eq!(
        (&found["upper"], &found["lower_from"]),
        (&found["bits_per_pixel"], &json!("decoder that comes with the program"))
    );
    let told = bench.done(&format!("{live} --objects beads:0.02"));
    assert!(told.contains("between 0.") && told.contains("pretrained decoder"), "{told}");

    // Objects of unknown entropy have no lower bound.
    bench.write("digits", idx(12, 28, |pixel| (pixel * 37 % 256) as u8));
    let told = bench.done(&format!("{line} --objects idx:digits"));
    assert!(told.contains("no lower bound is known") && told.contains("so there is no lower bound"), "{told}");
}

#[test]
fn the_state_of_a_fit_is_removed_in_the_end_and_foreign_files_are_refused() {
    let bench = Bench::new();
    let line = "estimate --estimator causal --mask heuristic:1 --patch 8 --patches-test 20 --budget 0.3s --resume fit";
    bench.json(line);
    assert!(!bench.path("fit").exists());
    bench.write("fit", "not a state");
    assert!(bench.refused(line).contains("expected the state of an estimate"), "{}", bench.refused(line));
    assert_eq!(bytes(&bench, "fit"), b"not a state");
}

#[cfg(target_os = "linux")]
#[test]
fn what_could_not_be_printed_is_not_computed_again() {
    let bench = Bench::new();
    bench.done("simulate --mask heuristic:2 --count 12 --out seen");
    for subject in ["--mask heuristic:1", "--measurements seen/measurements.npy"] {
        let line = format!(
            "estimate {subject} --estimator causal --patch 8 --patches-test 20 --budget 0.3s --resume kept --json"
        );
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = bench.command().args(line.split_whitespace()).stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
        let kept = bytes(&bench, "kept");
        // A fit for a time never gives the same numbers twice.
        let printed = [(); 2].map(|()| {
            bench.write("kept", &kept);
            let estimate: Value = serde_json::from_str(&bench.done(&line)).unwrap();
            assert!(!bench.path("kept").exists(), "it is out");
            estimate["bits_per_pixel"].clone()
        });
        assert_eq!(printed[0], printed[1], "{subject}");
    }
}

#[test]
fn trials_that_were_done_before_a_power_cut_are_not_done_again() {
    let bench = Bench::new();
    let line =
        "estimate --estimator causal --mask heuristic:1 --patch 8 --patches-test 20 --steps 60 --trials 3 --json";
    let whole: Value = serde_json::from_str(&bench.done(line)).unwrap();
    let resumable = format!("{line} --resume kept");
    let trials = || {
        let text = std::fs::read(bench.path("kept")).ok()?;
        Some(serde_json::from_slice::<Value>(&text).ok()?["trials"].as_array()?.len())
    };
    // A program that ends removes its state.
    bench.kill_midway(&resumable, || (), || trials().is_some_and(|trials| trials > 0));
    let resumed: Value = serde_json::from_str(&bench.done(&resumable)).unwrap();
    for field in ["bits_per_pixel", "trial_spread", "seed", "interval_95"] {
        assert_eq!(resumed[field], whole[field], "{field}");
    }
    assert_eq!(resumed["trials"], json!(3));
    assert!(!bench.path("kept").exists());
    assert_eq!(bench.files(), Vec::<std::path::PathBuf>::new());
}

#[test]
fn the_weights_of_a_pixelcnn_are_written_and_scored_again() {
    let bench = Bench::new();
    let line = "estimate --estimator pixelcnn --mask heuristic:2 --patch 8 --patches-train 60 --patches-test 30";
    let fitted = bench.json(&format!("{line} --budget 0.5s --save-weights network"));
    let scored = bench.json(&format!("{line} --weights network"));
    for field in ["bits_per_pixel", "interval_95", "entropy_y"] {
        assert_eq!(scored[field], fitted[field], "{field}");
    }
    assert_eq!(scored["patches_train"], json!(0));
    assert!(scored["notes"].to_string().contains("scored without a fit"), "{}", scored["notes"]);
    // On another engine, and for other measurements than those of the fit, it is also a bound.
    let burn = bench.json(&format!("{line} --weights network --engine burn:ndarray"));
    let bits = |estimate: &Value| estimate["bits_per_pixel"].as_f64().unwrap();
    assert!((bits(&burn) - bits(&fitted)).abs() < 1e-4, "{} {}", bits(&burn), bits(&fitted));
    let other = bench.json(&format!("{} --weights network", line.replace("heuristic:2", "heuristic:9")));
    assert!(bits(&other) > other["lower"].as_f64().unwrap());
    bench.write("letter", "no weights");
    let refusal = bench.refused(&format!("{line} --weights letter"));
    assert!(refusal.contains("letter") && refusal.contains("safetensors"), "{refusal}");
}

#[test]
fn fits_begin_with_the_weights_of_the_program_unless_fresh_ones_are_wished() {
    let bench = Bench::new();
    // Measured images have only the bound of a density model.
    bench.done("simulate --mask heuristic:2 --count 12 --out seen");
    let line =
        "estimate --measurements seen/measurements.npy --estimator causal --patch 16 --patches-test 40 --steps 20";
    let bits = |estimate: &Value| estimate["bits_per_pixel"].as_f64().unwrap();
    let (shipped, fresh) = (bench.json(line), bench.json(&format!("{line} --init random")));
    assert!(bits(&shipped) < bits(&fresh) - 0.05, "{} {}", bits(&shipped), bits(&fresh));
    let notes = |estimate: &Value| estimate["notes"].to_string();
    assert!(notes(&shipped).contains("from the pretrained weights"), "{}", notes(&shipped));
    assert!(!notes(&fresh).contains("pretrained"), "{}", notes(&fresh));
}

#[test]
fn without_a_display_the_numbers_are_printed_and_the_design_exported() {
    let bench = Bench::new();
    let output = bench.run::<&str>([]);
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(super::text(&output.stderr).trim_end().lines().count(), 1, "{}", super::text(&output.stderr));
    let told = super::text(&output.stdout);
    for part in
        ["9 lenslets imaging beads:0.02", "Gaussian bound", "object-entropy bound", "Tamura coefficient", "psf.npy"]
    {
        assert!(told.contains(part), "{part} in {told}");
    }
    for name in ["psf.npy", "psf.png", "psf16.png", "psf.tiff", "design.json", "lenslets.csv"] {
        assert!(bench.path("lenslet-studio-export").join(name).is_file(), "{name}");
    }
    bench.done("simulate --noise none --count 1 --out dark");
    let told = bench.done("dark/design.json");
    assert!(
        told.contains("No information: information is unbounded without noise") && told.contains("psf.npy"),
        "{told}"
    );
}
