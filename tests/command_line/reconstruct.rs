//! Reconstructions of designs and of captures.

#[cfg(unix)]
use std::io::{BufRead, BufReader};
#[cfg(unix)]
use std::process::{ExitStatus, Stdio};

use lenslet_studio::formats::{read_array, read_grey};
use serde_json::Value;

use super::{Bench, idx, npy};

fn number(result: &Value, name: &str) -> f64 {
    result[name].as_f64().unwrap_or_else(|| panic!("{name} in {result}"))
}

#[test]
fn a_design_has_image_quality_and_files() {
    let bench = Bench::new();
    let line = "reconstruct --mask heuristic:5 --objects beads:0.02 --test 6 --examples 2";
    let result = bench.json(&format!("{line} --out a"));
    for name in ["psnr_db", "ssim", "mse", "r2", "psnr_constant_db", "psnr_unclipped_db"] {
        let interval = result[format!("{name}_interval_95")].as_array().unwrap();
        let (low, high) = (interval[0].as_f64().unwrap(), interval[1].as_f64().unwrap());
        let value = number(&result, name);
        assert!(low <= value && value <= high, "{name}: {low} {value} {high}");
    }
    assert!(number(&result, "psnr_db") > number(&result, "psnr_constant_db"));
    assert!(number(&result, "psnr_linear_closed_form_db") > 20.0 && number(&result, "seconds") > 0.0);
    assert_eq!((&result["decoder"], &result["protocol"]), (&"linear".into(), &"default".into()));
    assert_eq!((&result["test_objects"], &result["networks"]), (&6.into(), &0.into()));
    let files: Vec<&str> = result["files"].as_array().unwrap().iter().map(|file| file.as_str().unwrap()).collect();
    assert!(files.len() == 9 && files.iter().all(|file| bench.path(file).is_file()), "{files:?}");
    assert_eq!(read_array(&bench.path("a/reconstructions.npy")).unwrap().shape(), [6, 96, 96]);
    for (name, shape) in [("truth", (96, 96)), ("measurement", (65, 65)), ("reconstruction", (96, 96))] {
        assert_eq!(read_grey(&bench.path(format!("a/example-2-{name}.png"))).unwrap().dim(), shape);
    }
    // The same again, in words, without files.
    let printed = bench.done(line.trim_end_matches(" --examples 2"));
    for part in [
        "Linear MMSE: 5 lenslets imaging beads:0.02, default protocol",
        "PSNR",
        "SSIM",
        "in closed form",
        "6 test objects",
    ] {
        assert!(printed.contains(part), "{part} in {printed}");
    }
    assert!(printed.contains(&format!("{:.3} [", number(&result, "psnr_db"))), "{printed}");
}

#[test]
fn decoders_without_a_prior_know_no_closed_form() {
    let bench = Bench::new();
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    for decoder in ["tv", "richardson-lucy"] {
        let line = format!("reconstruct --decoder {decoder} --objects idx:images.idx --protocol paper --test 2");
        let result = bench.json(&line);
        assert_eq!((&result["decoder"], &result["protocol"]), (&decoder.into(), &"paper".into()));
        assert_eq!(result["psnr_linear_closed_form_db"], Value::Null);
        assert_eq!(result["noise"], "shot");
    }
}

/// Sends a scheduler's signal to a command after a line on standard error with `part`. Returns its end and the lines after that one.
#[cfg(unix)]
fn stopped(bench: &Bench, line: &str, part: &str) -> (ExitStatus, Vec<String>) {
    let mut child = bench.command().args(line.split_whitespace()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains(part)), "{part}");
    assert!(bench.process("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    let rest = lines.map(Result::unwrap).collect();
    (child.wait().unwrap(), rest)
}

/// Stops a command after its first line, which is on the images, and checks that it ends as one that can be resumed.
#[cfg(unix)]
fn stop_after_first_line(bench: &Bench, line: &str) {
    let (status, rest) = stopped(bench, line, "40 images");
    let is_told = rest.iter().any(|line| line.contains("a: stopped; the same command resumes it"));
    assert!(status.success() && is_told, "{rest:?}");
}

/// A capture has no state: a signal ends it as it ends other programs, and nothing says that it can be resumed.
#[cfg(unix)]
#[test]
fn a_capture_that_is_stopped_by_a_signal_saves_nothing_and_says_so() {
    use std::os::unix::process::ExitStatusExt;
    let bench = Bench::new();
    bench.write("psf.npy", npy("(16, 16)", &(0..256).map(|index| (index % 17) as f32).collect::<Vec<_>>()));
    let capture: Vec<f32> = (0..700 * 700_u64).map(|index| 60.0 + (index * 7919 % 200) as f32).collect();
    bench.write("capture.npy", npy("(700, 700)", &capture));
    let line = "reconstruct --measurement capture.npy --psf psf.npy --dark 0 --out a";
    let (status, rest) = stopped(&bench, line, "psf.npy");
    assert_eq!(status.signal(), Some(15), "{rest:?}");
    assert!(rest.iter().any(|line| line.contains("a: stopped; nothing was saved")), "{rest:?}");
    assert!(!bench.path("a").exists());
}

/// What is refused leaves no folder, and settings without networks block nobody.
#[test]
fn a_refused_command_leaves_nothing_behind() {
    let bench = Bench::new();
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    bench.write("two.idx", idx(2, 28, |index| index as u8));
    write_capture(&bench);
    bench.write("wide.npy", npy("(16, 40)", &[9.0; 640]));
    let network = "reconstruct --decoder network --objects idx:images.idx --steps 1 --test 2 --examples 0";
    for (line, part) in [
        (format!("{network} --any-mask --mask diffuser:8 --out a/b"), "expected a mask of lenslets, found diffuser"),
        (format!("{network} --any-mask --throughput 0.5 --out a"), "expected a mask of throughput 1, found 0.5"),
        ("reconstruct --decoder unet --any-mask --out a".to_owned(), "--any-mask: expected --decoder network"),
        ("reconstruct --any-mask --out a".to_owned(), "--any-mask: expected --decoder network, found Linear MMSE"),
        ("reconstruct --decoder unet --steps 1 --engine burn:cuda --out a".to_owned(), "--features cuda"),
        (
            "reconstruct --decoder network --objects idx:two.idx --out a".to_owned(),
            "Trained network: expected at least 3 images to train on and to test with, found 2",
        ),
        ("reconstruct --measurement capture.npy --psf wide.npy --out a".to_owned(), "crop the PSF"),
        ("reconstruct --examples 3".to_owned(), "--examples: expected a folder for the images, found none"),
    ] {
        let sentence = bench.refused(&line);
        assert!(sentence.contains(part), "{line}: {sentence}");
        assert!(!bench.path("a").exists(), "{line}");
    }
    // Those of a program that was killed at its first step.
    bench.done(&format!("{network} --out b"));
    std::fs::create_dir(bench.path("c")).unwrap();
    std::fs::rename(bench.path("b/networks.json"), bench.path("c/networks.json")).unwrap();
    let other = network.replace("--steps 1", "--steps 1 --seed 2");
    bench.done(&format!("{other} --out c"));
}

/// One rule for networks of any mask: what training refuses, use refuses, with the name of the file.
#[test]
fn a_network_of_any_mask_serves_the_masks_that_it_may_be_trained_for() {
    let bench = Bench::new();
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    let line = "reconstruct --decoder network --objects idx:images.idx --test 2";
    bench.done(&format!("{line} --any-mask --steps 1 --examples 0 --out a"));
    let line = format!("{line} --weights a/network-1.safetensors");
    bench.done(&format!("{line} --mask heuristic:2"));
    for (flags, part) in [
        ("--mask diffuser:8", "found diffuser, aperture 8 px"),
        ("--throughput 0.5", "throughput 0.5; train it for this mask alone"),
        ("--grid 24", "on a grid of 32 x 32 px, found 24 x 24 px"),
    ] {
        let sentence = bench.refused(&format!("{line} {flags}"));
        assert!(
            sentence.contains("--weights a/network-1.safetensors: network") && sentence.contains(part),
            "{sentence}"
        );
    }
}

#[test]
fn nothing_is_trained_into_a_folder_that_another_program_writes_into() {
    let bench = Bench::new();
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    write_capture(&bench);
    std::fs::create_dir(bench.path("a")).unwrap();
    let folder = std::fs::File::open(bench.path("a")).unwrap();
    folder.lock().unwrap();
    for line in [
        "reconstruct --decoder network --objects idx:images.idx --steps 1 --out a",
        "reconstruct --measurement capture.npy --psf psf.npy --out a",
    ] {
        let sentence = bench.refused(line);
        assert!(sentence.contains("found another run at work in it"), "{sentence}");
    }
    drop(folder);
    bench.done("reconstruct --measurement capture.npy --psf psf.npy --out a");
}

/// A damaged state is the fault of no file that was chosen: the sentence says to delete it.
#[test]
fn damaged_states_and_unsaved_results_have_a_cure() {
    let bench = Bench::new();
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    let line = "reconstruct --decoder network --objects idx:images.idx --steps 1 --test 2";
    let output = bench.run(line.split_whitespace());
    assert!(super::text(&output.stderr).contains("add --out DIR"), "{}", super::text(&output.stderr));
    bench.done(&format!("{line} --examples 0 --out a"));
    std::fs::rename(bench.path("a/network-1.safetensors"), bench.path("a/network-1.state")).unwrap();
    let sentence = bench.refused(&format!("{line} --examples 0 --out a"));
    assert!(sentence.contains("a/network-1.state: expected the state of this training"), "{sentence}");
    assert!(sentence.contains("delete it") && !sentence.contains("choose another"), "{sentence}");
}

#[test]
fn few_images_are_noted_in_the_result() {
    let bench = Bench::new();
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    let notices = |flags: &str| bench.json(&format!("reconstruct --test 2 {flags}"))["notices"].to_string();
    let few = notices("--objects idx:images.idx");
    assert!(few.contains("32 training images") && few.contains("8 held-out images"), "{few}");
    let without_prior = notices("--objects idx:images.idx --decoder tv");
    assert!(!without_prior.contains("training images") && without_prior.contains("8 held-out"), "{without_prior}");
    assert_eq!(notices(""), "[]");
}

/// At a scheduler's signal a training keeps its state, and the same command resumes it.
#[cfg(unix)]
#[test]
fn a_training_that_is_stopped_by_a_signal_resumes() {
    let bench = Bench::new();
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    let line = "reconstruct --decoder network --objects idx:images.idx --test 2 --steps 2 --examples 0 --out";
    stop_after_first_line(&bench, &format!("{line} a"));
    assert!(bench.path("a/network-1.state").is_file() && !bench.path("a/network-1.safetensors").exists());
    let (resumed, whole) = (bench.json(&format!("{line} a")), bench.json(&format!("{line} b")));
    assert_eq!((&resumed["psnr_db"], &resumed["trained"][0]["steps"]), (&whole["psnr_db"], &2.into()));
    assert!(!bench.path("a/network-1.state").exists() && bench.path("a/network-1.safetensors").is_file());
}

/// Estimates of a slow decoder are kept at a signal, and the same command makes the others.
#[cfg(unix)]
#[test]
fn a_test_of_a_slow_decoder_that_is_stopped_by_a_signal_resumes() {
    let bench = Bench::new();
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    let line = "reconstruct --decoder tv --objects idx:images.idx --test 9 --examples 0 --out";
    stop_after_first_line(&bench, &format!("{line} a"));
    let saved = || {
        let files = std::fs::read_dir(bench.path("a")).unwrap().map(|file| file.unwrap());
        let saved = files.filter(|file| file.file_name().to_string_lossy().starts_with("estimates-"));
        saved.map(|file| file.metadata().unwrap().len()).collect::<Vec<_>>()
    };
    // The images that were at work are among them.
    let one_object = 96 * 96 * 4;
    assert!(matches!(saved()[..], [bytes] if bytes > one_object), "{:?}", saved());
    let (resumed, whole) = (bench.json(&format!("{line} a")), bench.json(&format!("{line} b")));
    assert_eq!(resumed["psnr_db"], whole["psnr_db"]);
    let objects = |folder: &str| std::fs::read(bench.path(folder).join("reconstructions.npy")).unwrap();
    assert!(objects("a") == objects("b") && saved().is_empty());
}

#[test]
fn networks_are_trained_tested_and_read_again() {
    let bench = Bench::new();
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    let line = "reconstruct --decoder network --objects idx:images.idx --test 2";
    let result = bench.json(&format!("{line} --steps 1 --networks 2 --examples 0 --out a"));
    assert_eq!((&result["decoder"], &result["networks"]), (&"network".into(), &2.into()));
    let trained = result["trained"].as_array().unwrap();
    assert!(trained.len() == 2 && trained.iter().all(|network| network["steps"] == 1), "{result}");
    let weights = bench.path("a/network-2.safetensors");
    assert!(weights.is_file());
    // Networks that are there are not trained again; one that is missing is.
    let first = std::fs::metadata(bench.path("a/network-1.safetensors")).unwrap().modified().unwrap();
    let bytes = std::fs::read(&weights).unwrap();
    std::fs::remove_file(&weights).unwrap();
    let output = bench.run(format!("{line} --steps 1 --networks 2 --examples 0 --out a --json").split_whitespace());
    let reported = super::text(&output.stderr);
    assert!(
        reported.contains("network-1.safetensors: trained before") && !reported.contains("network-2.safetensors: t"),
        "{reported}"
    );
    let again: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&again["psnr_db"], &again["trained"][0]), (&result["psnr_db"], &trained[0]));
    assert_eq!(std::fs::metadata(bench.path("a/network-1.safetensors")).unwrap().modified().unwrap(), first);
    assert_ne!(bytes.len(), 0);
    assert_eq!(std::fs::read(&weights).unwrap().len(), bytes.len());
    let printed = bench.refused(&format!("{line} --steps 2 --examples 0 --out a"));
    assert!(printed.contains("a: expected the settings of the networks that are there"), "{printed}");
    let read = bench.json(&format!("{line} --weights a/network-1.safetensors"));
    assert_eq!((&read["networks"], &read["trained"][0]), (&1.into(), &trained[0]));
    for (line, message) in [
        (format!("{line} --mask heuristic:5 --weights a/network-1.safetensors"), "the mask that it was trained for"),
        (format!("{line} --bias 3 --weights a/network-1.safetensors"), "the scene that it was trained for"),
        (format!("{line} --weights images.idx"), "not weights of this network"),
        ("reconstruct --steps 3".to_owned(), "--steps: expected --decoder network"),
        (
            format!("{line} --weights a/network-1.safetensors --networks 3"),
            "--networks: expected a training, found --weights",
        ),
        (
            format!("{line} --weights a/network-1.safetensors --any-mask"),
            "--any-mask: expected a training, found --weights",
        ),
        (format!("{line} --any-mask --steps 1 --mask diffuser:8"), "expected a mask of lenslets, found diffuser"),
        (format!("{line} --networks 0"), "--networks 0: expected 1 to 100"),
        (
            "reconstruct --decoder unet --any-mask".to_owned(),
            "--any-mask: expected --decoder network, found Published U-net",
        ),
        (
            format!("{line} --mask heuristic:5 --weights a/network-1.safetensors"),
            "--weights a/network-1.safetensors: network: expected the mask",
        ),
        (
            "reconstruct --decoder unet --objects idx:images.idx --weights a/network-1.safetensors".to_owned(),
            "not weights of this network",
        ),
    ] {
        let printed = bench.refused(&line);
        assert!(printed.contains(message), "{message} in {printed}");
    }
}

/// A capture of a bright square through a mask of two points, on a dark level of 8.
fn write_capture(bench: &Bench) {
    let mut psf = vec![8.0; 16 * 16];
    (psf[5 * 16 + 6], psf[10 * 16 + 9]) = (108.0, 58.0);
    bench.write("psf.npy", npy("(16, 16)", &psf));
    let value = |row: usize, col: usize| {
        let is_lit = |down: usize, right: usize| (14..22).contains(&(row + down)) && (12..20).contains(&(col + right));
        let noise = ((row * 31 + col * 17) % 7) as f32 - 3.0;
        8.0 + 400.0 * f32::from(u8::from(is_lit(5, 4))) + 200.0 * f32::from(u8::from(is_lit(0, 1))) + 40.0 + noise
    };
    let capture: Vec<f32> = (0..32 * 36).map(|index| value(index / 36, index % 36)).collect();
    bench.write("capture.npy", npy("(32, 36)", &capture));
}

#[test]
fn a_capture_is_reconstructed_with_its_psf() {
    let bench = Bench::new();
    write_capture(&bench);
    let result = bench.json("reconstruct --measurement capture.npy --psf psf.npy --out b");
    assert_eq!((&result["decoder"], &result["object_shape"]), (&"tv".into(), &serde_json::json!([1, 47, 51])));
    assert_eq!(result["sensor_corner"], serde_json::json!([7, 7]));
    let object = read_array(&bench.path("b/reconstructions.npy")).unwrap();
    // One square, as bright as both of its copies together.
    let mean = |rows: std::ops::Range<usize>, cols: std::ops::Range<usize>| {
        object.slice(ndarray::s![0, rows, cols]).iter().sum::<f32>() / 25.0
    };
    let (lit, dark) = (mean(20..25, 17..22), mean(32..37, 34..39));
    assert!(lit > 450.0 && dark < 150.0, "{lit} {dark}");
    for name in ["reconstruction-1.png", "measurement-1.png"] {
        assert!(bench.path("b").join(name).is_file(), "{name}");
    }
    let printed =
        bench.done("reconstruct --measurement capture.npy --psf psf.npy --decoder richardson-lucy --bin 2 --dark 8");
    assert!(printed.contains("Richardson-Lucy of capture.npy: 1 x 23 x 25"), "{printed}");
    let negative =
        bench.done("reconstruct --measurement capture.npy --psf psf.npy --dark -5 --decoder richardson-lucy");
    assert!(negative.contains("Richardson-Lucy of capture.npy"), "{negative}");
}

/// Images of frames that an earlier capture had go, as those of examples do.
#[test]
fn a_shorter_capture_leaves_no_images_of_a_longer_one() {
    let bench = Bench::new();
    write_capture(&bench);
    let frames: Vec<f32> = (0..3 * 32 * 36).map(|index| 60.0 + (index * 31 % 97) as f32).collect();
    bench.write("three.npy", npy("(3, 32, 36)", &frames));
    let line = "reconstruct --psf psf.npy --decoder richardson-lucy --out a --measurement";
    bench.done(&format!("{line} three.npy"));
    let is_there = |name: &str| bench.path("a").join(name).exists();
    assert!(is_there("reconstruction-3.png") && is_there("measurement-3.png"));
    bench.done(&format!("{line} capture.npy"));
    for name in ["reconstruction", "measurement"] {
        let found = [1, 2, 3].map(|frame| is_there(&format!("{name}-{frame}.png")));
        assert_eq!(found, [true, false, false], "{name}");
    }
}

#[test]
fn what_cannot_be_reconstructed_is_refused() {
    let bench = Bench::new();
    write_capture(&bench);
    bench.write("wide.npy", npy("(16, 40)", &[9.0; 640]));
    bench.write(
        "colour.npy",
        npy("(32, 36, 3)", &(0..32 * 36 * 3).map(|index| (index % 97) as f32).collect::<Vec<_>>()),
    );
    let mut broken = vec![50.0; 32 * 36];
    broken[40] = f32::NAN;
    bench.write("broken.npy", npy("(32, 36)", &broken));
    bench.write("white.npy", npy("(32, 36)", &[255.0; 32 * 36]));
    bench.write("one.idx", idx(1, 28, |index| index as u8));
    bench.write("images.idx", idx(40, 28, |index| (index * 7919 % 256) as u8));
    for (line, part) in [
        ("reconstruct --test 1", "--test 1: expected 2 to 1000000; raise it"),
        ("reconstruct --objects volume:2:0.02", "expected objects of one plane, found 2"),
        ("reconstruct --objects idx:one.idx", "test objects of idx:one.idx"),
        ("reconstruct --objects idx:none.idx", "none.idx"),
        ("reconstruct --decoder magic", "magic"),
        ("reconstruct --sweeps 9", "expected --decoder posterior"),
        ("reconstruct --decoder network --engine burn:ndarray", "--engine: expected --decoder unet"),
        ("reconstruct --decoder unet --protocol paper --steps 1 --engine burn:cuda", "--features cuda"),
        ("reconstruct --decoder posterior --objects idx:images.idx", "expected beads"),
        ("reconstruct --measurement capture.npy", "--psf"),
        ("reconstruct --psf psf.npy", "--measurement"),
        ("reconstruct --measurement capture.npy --psf psf.npy --objects beads:0.02", "--objects"),
        (
            "reconstruct --measurement capture.npy --psf psf.npy --decoder linear",
            "--decoder: expected one for a capture",
        ),
        ("reconstruct --measurement capture.npy --psf psf.npy --decoder unet", "choose tv or richardson-lucy"),
        ("reconstruct --measurement capture.npy --psf psf.npy --bin 0", "--bin 0: expected 1 to"),
        ("reconstruct --measurement capture.npy --psf psf.npy --dark nan", "expected a grey value or a file"),
        ("reconstruct --measurement capture.npy --psf psf.npy --dark 9999", "above the dark level of 9999"),
        ("reconstruct --measurement capture.npy --psf none.npy", "none.npy"),
        ("reconstruct --measurement capture.npy --psf wide.npy", "at least the 16 x 40 px of the PSF, found 32 x 36"),
        ("reconstruct --measurement colour.npy --psf psf.npy --out c", "found colours beside grey"),
        ("reconstruct --measurement broken.npy --psf psf.npy --out c", "found NaN at row 1, column 4"),
        ("reconstruct --measurement white.npy --psf psf.npy", "100 % of the pixels at 255"),
        ("reconstruct --measurement capture.npy --psf psf.npy --out psf.npy", "found a file"),
    ] {
        let sentence = bench.refused(line);
        assert!(sentence.contains(part), "{line}: {sentence}");
    }
}
