//! Failures to read, compute or write give one sentence that names the file, and leave nothing behind.

use std::io::Write;
use std::process::{Output, Stdio};
use std::time::Duration;

use serde_json::{Value, json};

use super::{Bench, idx, npy};

fn assert_told(sentence: &str, parts: &[&str]) {
    for part in parts {
        assert!(sentence.contains(part), "{part:?} in {sentence}");
    }
}

#[test]
fn missing_files_are_named() {
    let bench = Bench::new();
    for line in [
        "export none.x --out out",
        "export --mask psf:none.x --out out",
        "export --mask design:none.x --out out",
        "simulate none.x --out out",
        "simulate --objects idx:none.x --out out",
        "simulate --objects cifar:none.x --out out",
        "simulate --objects images:none.x --out out",
        "simulate --objects stack:none.x --out out",
        "estimate --objects stack:none.x",
        "tamura none.x",
        "none.x",
    ] {
        assert_told(&bench.refused(line), &["none.x", "expected", "found nothing"]);
    }
}

#[test]
fn broken_object_files_are_named() {
    let bench = Bench::new();
    let images = idx(3, 28, |index| index as u8);
    let gzip = |bytes: &[u8]| {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        packer.write_all(bytes).unwrap();
        packer.finish().unwrap()
    };
    let packed = gzip(&images);
    let mut tiff = Vec::new();
    let image = ndarray::Array3::from_elem((1, 40, 40), 3.0_f32);
    lenslet_studio::formats::write_tiff(&bench.path("whole.tiff"), image.view()).unwrap();
    tiff.extend(std::fs::read(bench.path("whole.tiff")).unwrap());
    let mut odd = vec![1.0; 64 * 64];
    odd[70] = f32::NAN;
    let mut negative = vec![1.0; 64 * 64];
    negative[70] = -3.0;
    let cases: [(&str, Vec<u8>, &str); 19] = [
        ("idx", images[..images.len() - 1].to_vec(), "header says"),
        ("idx", [&images[..], &[0]].concat(), "expected"),
        ("idx", packed[..packed.len() / 2].to_vec(), "expected"),
        ("idx", b"not an IDX file at all".to_vec(), "found a text"),
        ("idx", idx(0, 28, |_| 0), "images with pixels"),
        ("idx", idx(4, 0, |_| 0), "images with pixels"),
        ("idx", idx(4, 28, |_| 0), "some light"),
        ("idx", Vec::new(), "expected"),
        ("cifar", vec![0; 3072], "records of 3073 bytes"),
        ("cifar", vec![200; 3073], "labels of 0 to 9"),
        ("cifar", Vec::new(), "an empty file"),
        ("stack", npy("(2, 64, 64)", &[1.0; 4096]), "16384 bytes"),
        ("stack", npy("(64,)", &[1.0; 64]), "shape [64]"),
        ("stack", npy("(0, 64, 64)", &[]), "images with pixels"),
        ("stack", npy("(1, 64, 64)", &odd), "NaN in image 1, row 1, column 6"),
        ("stack", npy("(1, 64, 64)", &negative), "-3 in image 1, row 1, column 6"),
        ("stack", npy("(1, 64, 64)", &[0.0; 4096]), "some light"),
        ("stack", tiff[..tiff.len() / 2].to_vec(), "expected"),
        ("stack", b"PK\x03\x04 and no more".to_vec(), "zip archive"),
    ];
    for (kind, content, part) in cases {
        bench.write("bad.file", content);
        for command in ["simulate --out out", "estimate"] {
            assert_told(&bench.refused(&format!("{command} --objects {kind}:bad.file")), &["bad.file", part]);
        }
    }
    // `tamura` rates readable images. It refuses images without a coefficient.
    for (content, part) in [
        (npy("(1, 64, 64)", &odd), "NaN in image 1 at row 1, column 6"),
        (npy("(0, 64, 64)", &[]), "expected images with pixels, found none"),
        (npy("(2, 64, 64)", &[1.0; 4096]), "16384 bytes"),
        (vec![], "expected"),
    ] {
        bench.write("bad.file", content);
        assert_told(&bench.refused("tamura bad.file"), &["bad.file", part]);
    }
}

#[test]
fn objects_smaller_than_the_psf_are_named() {
    let bench = Bench::new();
    bench.write("small.npy", npy("(2, 31, 40)", &[1.0; 2 * 31 * 40]));
    for line in ["simulate --out out", "estimate"] {
        let told = bench.refused(&format!("{line} --objects stack:small.npy"));
        assert_told(&told, &["small.npy", "31 x 40", "32 x 32", "smaller PSF"]);
    }
    bench.write("one.npy", npy("(1, 64, 64)", &[1.0; 4096]));
    let told = bench.refused("estimate --objects stack:one.npy");
    assert_told(&told, &["one.npy", "found none among 1"]);
}

#[test]
fn folders_without_images_are_named() {
    let bench = Bench::new();
    std::fs::create_dir(bench.path("empty")).unwrap();
    assert_told(&bench.refused("simulate --objects images:empty --out out"), &["empty", "found none"]);
    std::fs::create_dir(bench.path("bad")).unwrap();
    bench.write("bad/a.png", "no image");
    bench.write("bad/b.tif", "II*\0 none");
    let told = bench.refused("simulate --objects images:bad --out out");
    assert_told(&told, &["bad", "2 unreadable ones", "a.png"]);
    for kind in ["idx", "cifar", "stack"] {
        assert_told(&bench.refused(&format!("estimate --objects {kind}:bad")), &["bad", "a folder"]);
    }
    for line in ["tamura bad", "export bad --out out", "export --mask psf:bad --out out"] {
        assert_told(&bench.refused(line), &["bad", "a folder"]);
    }
    // One good image among bad ones is used, and the others are named.
    bench.write("good.npy", npy("(60, 60)", &[2.0; 3600]));
    std::fs::rename(bench.path("good.npy"), bench.path("bad/good.npy")).unwrap();
    let result = bench.json("simulate --objects images:bad --count 1 --out out");
    assert_told(result["notices"][0].as_str().unwrap(), &["2 unreadable files", "a.png", "b.tif"]);
}

#[test]
fn what_is_no_psf_is_named() {
    let bench = Bench::new();
    let pixels = |change: f32| {
        let mut values = vec![1.0; 64];
        values[11] = change;
        npy("(8, 8)", &values)
    };
    for (content, part) in [
        (pixels(f32::NAN), "NaN at row 1, column 3"),
        (pixels(f32::INFINITY), "inf at row 1, column 3"),
        (pixels(-0.5), "-0.5 at row 1, column 3"),
        (npy("(8, 8)", &[0.0; 64]), "no light at all"),
        (npy("(0, 8)", &[]), "0 x 8"),
        (npy("(1, 2000)", &[1.0; 2000]), "1 x 2000"),
        (npy("(3, 8, 8)", &[1.0; 192]), "3"),
        (b"\x89PNG and no more".to_vec(), "expected"),
    ] {
        bench.write("psf.file", content);
        assert_told(&bench.refused("export --mask psf:psf.file --out out"), &["psf.file", part]);
    }
}

/// A valid design file with a change.
fn design_file(bench: &Bench, change: impl Fn(&mut Value)) {
    if !bench.path("base/design.json").is_file() {
        bench.done("export --mask heuristic:3 --out base");
    }
    let mut design: Value = serde_json::from_slice(&std::fs::read(bench.path("base/design.json")).unwrap()).unwrap();
    change(&mut design);
    bench.write("bad.json", serde_json::to_vec(&design).unwrap());
}

#[test]
fn designs_that_cannot_be_are_named() {
    type Change = fn(&mut Value);
    let bench = Bench::new();
    let cases: [(Change, &str); 22] = [
        (|design| design["format_version"] = json!(4), "newer Lenslet Studio"),
        (|design| design["format_version"] = json!(u64::MAX), "newer Lenslet Studio"),
        (|design| design["format_version"] = json!(0), "format_version"),
        (|design| design["format_version"] = json!("1"), "format_version"),
        (|design| design["format"] = json!("lenslet-studio/estimate"), "lenslet-studio/estimate"),
        (|design| *design = json!([1, 2]), "no format entry"),
        (|design| *design = json!(null), "no format entry"),
        (|design| design["encoder"]["lenslets"][1]["x_px"] = json!(1e300), "lenslet 2: x_px is 1e300"),
        (|design| design["encoder"]["lenslets"][1]["y_px"] = json!(null), "lenslet 2: invalid type: null"),
        (|design| design["encoder"]["lenslets"][1]["sigma_px"] = json!(-1.0), "lenslet 2: sigma_px"),
        (|design| design["encoder"]["lenslets"][0]["weight"] = json!(-1e-9), "lenslet 1: weight"),
        (|design| design["encoder"]["lenslets"][0]["plane"] = json!(1_000_000), "lenslet 1: plane"),
        (|design| design["encoder"]["lenslets"] = json!([]), "no lenslet"),
        (|design| design["encoder"]["rows"] = json!(u64::MAX), "PSF grid"),
        (|design| design["encoder"]["rows"] = json!(0), "PSF grid"),
        (|design| design["encoder"]["kind"] = json!("mirror"), "mirror"),
        (|design| design["mean_photons"] = json!(0), "mean_photons"),
        (|design| design["bias_photons"] = json!(1e300), "bias_photons"),
        (|design| design["noise"] = json!("read:-1"), "read noise"),
        (|design| design["objects"] = json!("beads:2"), "density"),
        (|design| design["limits"]["central_share"] = json!(0), "central_share"),
        (|design| design["seed"] = json!(-1), "seed: invalid value"),
    ];
    // All commands read designs in the same way.
    let mut commands = ["export bad.json --out out", "bad.json", "estimate bad.json"].into_iter().cycle();
    for (change, part) in cases {
        design_file(&bench, change);
        assert_told(&bench.refused(commands.next().unwrap()), &["bad.json", part]);
    }
    let weights = |design: &mut Value| {
        for lenslet in design["encoder"]["lenslets"].as_array_mut().unwrap() {
            lenslet["weight"] = json!(0);
        }
    };
    design_file(&bench, weights);
    assert_told(&bench.refused("export bad.json --out out"), &["bad.json", "weight 0"]);
    let covariance = |design: &mut Value| {
        let lenslet = design["encoder"]["lenslets"][2].as_object_mut().unwrap();
        lenslet.remove("sigma_px");
        lenslet.insert("covariance_px2".into(), json!({"xx": 1.0, "xy": 2.0, "yy": 1.0}));
    };
    design_file(&bench, covariance);
    assert_told(&bench.refused("export bad.json --out out"), &["bad.json", "lenslet 3", "positive definite"]);
    let many = |design: &mut Value| {
        let one = design["encoder"]["lenslets"][0].clone();
        design["encoder"]["lenslets"] = Value::Array(vec![one; 10_000]);
    };
    design_file(&bench, many);
    assert_told(&bench.refused("export bad.json --out out"), &["bad.json", "10000 lenslets", "at most 4096"]);
    let diffuser = |design: &mut Value| design["encoder"] = json!({"kind": "diffuser", "aperture_px": 0, "seed": 1});
    design_file(&bench, diffuser);
    assert_told(&bench.refused("export bad.json --out out"), &["bad.json", "aperture_px"]);
    for broken in ["", "{", "nonsense", "{\"format\": \"lenslet-studio/design\", \"format_version\": 1}", "\u{feff}{}"]
    {
        bench.write("bad.json", broken);
        assert_told(&bench.refused("export bad.json --out out"), &["bad.json", "expected"]);
    }
    bench.write("bad.json", "{\"format\": \"lenslet-studio/design\", \"format_version\": 1, \"mean_photons\": NaN}");
    assert_told(&bench.refused("export bad.json --out out"), &["bad.json", "line 1"]);
}

#[test]
fn folders_that_cannot_be_written_are_named() {
    let bench = Bench::new();
    bench.write("taken", "a file");
    for line in ["export --out taken", "simulate --count 1 --out taken", "export --out taken/below"] {
        assert_told(&bench.refused(line), &["taken"]);
    }
    // A folder in place of an output file.
    std::fs::create_dir_all(bench.path("out/psf.npy")).unwrap();
    std::fs::create_dir_all(bench.path("out/measurements.npy")).unwrap();
    assert_told(&bench.refused("export --out out"), &["out/psf.npy", "a folder or device"]);
    assert_told(&bench.refused("simulate --count 1 --out out"), &["out/measurements.npy", "a folder or device"]);
}

#[test]
fn nothing_is_written_in_place_of_what_it_is_made_from() {
    let bench = Bench::new();
    bench.done("export --mask heuristic:3 --out cam");
    let objects: Vec<f32> = (0..6 * 40 * 40).map(|index| (index * 37 % 101) as f32).collect();
    bench.write("data/objects.npy", npy("(6, 40, 40)", &objects));
    bench.done("export --objects stack:data/objects.npy --out scene");
    let read = || bench.files().into_iter().map(|file| (std::fs::read(&file).unwrap(), file)).collect::<Vec<_>>();
    let before = read();
    for (line, file) in [
        ("export --mask psf:cam/psf.tiff@16 --out cam", "cam/psf.tiff"),
        ("export --mask fit:cam/psf.npy --out scene/../cam", "cam/psf.npy"),
        ("export --mask design:cam/design.json --bias 3 --out cam", "cam/design.json"),
        ("export --objects idx:cam/lenslets.csv --out cam", "cam/lenslets.csv"),
        ("simulate cam/design.json --bias 3 --out cam", "cam/design.json"),
        ("simulate --objects stack:data/objects.npy --out data", "data/objects.npy"),
        ("simulate --objects images:data --out data", "data/objects.npy"),
        ("simulate scene/design.json --out data", "data/objects.npy"),
        ("design --start fit:cam/psf.png --out cam", "cam/psf.png"),
        ("design --start design:cam/design.json --out cam", "cam/design.json"),
        ("design --objects cifar:cam/psf.npy --out cam", "cam/psf.npy"),
    ] {
        let output = bench.run(line.split_whitespace());
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{line}: {told}");
        assert!(
            told.contains(&format!("lenslet-studio: {file}: ")) && told.contains("overwrite this input"),
            "{line}: {told}"
        );
        assert!(read() == before, "{line}");
    }
    // The same design, and other names.
    bench.done("export cam/design.json --out cam");
    bench.done("simulate --objects stack:data/objects.npy --count 1 --tiff --out data");
    assert!(bench.path("data/objects.tiff").is_file());
}

#[test]
fn weights_and_states_of_an_estimate_take_the_place_of_no_input() {
    let bench = Bench::new();
    bench.done("export --mask heuristic:2 --out cam");
    let images: Vec<f32> = (0..6 * 40 * 40).map(|index| (index * 37 % 101) as f32).collect();
    bench.write("data/images.npy", npy("(6, 40, 40)", &images));
    let read = || bench.files().into_iter().map(|file| (std::fs::read(&file).unwrap(), file)).collect::<Vec<_>>();
    let before = read();
    let sizes = "--estimator pixelcnn --budget 0.2s --patch 8 --patches-train 20 --patches-test 10";
    for flag in ["--save-weights", "--resume"] {
        for (subject, file) in [
            ("cam/design.json", "cam/design.json"),
            ("--mask design:cam/design.json", "cam/design.json"),
            ("--mask psf:cam/psf.npy", "cam/psf.npy"),
            ("--objects stack:data/images.npy", "data/images.npy"),
            ("--objects images:data", "data/images.npy"),
            ("--measurements data/images.npy", "data/images.npy"),
            ("--measurements data", "data/images.npy"),
        ] {
            let told = bench.refused(&format!("estimate {subject} {sizes} {flag} cam/../{file}"));
            assert_told(&told, &[file, "overwrite this input", flag]);
            assert!(read() == before, "{subject} {flag}");
        }
    }
}

#[cfg(unix)]
#[test]
fn a_folder_that_is_read_only_is_named() {
    use std::os::unix::fs::PermissionsExt;
    let bench = Bench::new();
    std::fs::create_dir(bench.path("out")).unwrap();
    std::fs::set_permissions(bench.path("out"), std::fs::Permissions::from_mode(0o555)).unwrap();
    if std::fs::write(bench.path("out/probe"), "").is_ok() {
        println!("skipped: this user may write into read-only folders");
        return;
    }
    for line in ["export --out out", "simulate --count 1 --out out", "simulate --count 1 --out out/below"] {
        assert_told(&bench.refused(line), &["out", "may write"]);
    }
    std::fs::set_permissions(bench.path("out"), std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn an_earlier_result_survives_a_failure() {
    let bench = Bench::new();
    bench.done("simulate --count 2 --out out");
    let kept = ["out/objects.npy", "out/measurements.npy", "out/design.json"];
    let read = || kept.map(|name| std::fs::read(bench.path(name)).unwrap());
    let before = read();
    std::fs::remove_file(bench.path("out/noiseless.npy")).unwrap();
    std::fs::create_dir(bench.path("out/noiseless.npy")).unwrap();
    assert_told(&bench.refused("simulate --count 2 --seed 2 --out out"), &["out/noiseless.npy", "a folder or device"]);
    assert!(read() == before);
    // A failure at the last file changes nothing either.
    std::fs::remove_dir(bench.path("out/noiseless.npy")).unwrap();
    std::fs::remove_file(bench.path("out/design.json")).unwrap();
    std::fs::create_dir(bench.path("out/design.json")).unwrap();
    let told = bench.refused("simulate --count 2 --seed 2 --out out");
    assert_told(&told, &["out/design.json", "a folder or device"]);
    assert_eq!(told.matches("a folder or device").count(), 1, "{told}");
    assert!(!bench.path("out/noiseless.npy").exists());
    assert!(kept[..2].iter().zip(&before).all(|(name, bytes)| std::fs::read(bench.path(name)).unwrap() == *bytes));
}

#[test]
fn an_export_that_fails_leaves_the_files_of_one_mask() {
    let bench = Bench::new();
    bench.done("export --mask heuristic:2 --colormap viridis --out out");
    let read = || bench.files().into_iter().map(|file| (std::fs::read(&file).unwrap(), file)).collect::<Vec<_>>();
    for name in ["lenslets.csv", "design.json", "psf-viridis.png"] {
        let whole = std::fs::read(bench.path("out").join(name)).unwrap();
        std::fs::remove_file(bench.path("out").join(name)).unwrap();
        std::fs::create_dir(bench.path("out").join(name)).unwrap();
        let before = read();
        let told = bench.refused("export --mask heuristic:7 --colormap viridis --out out");
        assert_told(&told, &[name, "a folder or device"]);
        assert!(read() == before, "{name}");
        std::fs::remove_dir(bench.path("out").join(name)).unwrap();
        bench.write(&format!("out/{name}"), whole);
    }
}

#[cfg(unix)]
#[test]
fn nothing_is_written_into_a_folder_that_another_program_writes_into() {
    let bench = Bench::new();
    bench.done("export --mask heuristic:2 --out out");
    // The remains of a killed program.
    bench.write("out/.writing-Ab12Cd", "half a stack");
    let folder = std::fs::File::open(bench.path("out")).unwrap();
    folder.lock().unwrap();
    for line in ["export --mask heuristic:7 --out out", "simulate --count 2 --mask heuristic:2 --out out"] {
        assert_told(&bench.refused(line), &["out", "found another run at work in it", "choose another folder"]);
    }
    drop(folder);
    bench.done("simulate --count 2 --mask heuristic:2 --out out");
    assert!(!bench.path("out/.writing-Ab12Cd").exists());
    bench.done("export --mask heuristic:2 --out out");
}

#[test]
fn states_beside_an_estimate_take_the_place_of_no_file() {
    let bench = Bench::new();
    bench.done("export --mask heuristic:2 --out a");
    std::fs::rename(bench.path("a/design.json"), bench.path("k.fit-1")).unwrap();
    for line in [
        "estimate k.fit-1 --estimator causal --resume k",
        "estimate --estimator pixelcnn --resume k --save-weights k.fit-1",
    ] {
        assert_told(
            &bench.refused(line),
            &["k.fit-1: expected a name that differs", "--resume k", "choose another name"],
        );
    }
    assert!(bench.path("k.fit-1").exists() && !bench.path("k").exists());
}

#[test]
fn files_of_another_mask_do_not_pass_as_those_of_this_one() {
    let bench = Bench::new();
    let measure = |lenslets: &str| format!("simulate --count 2 --mask heuristic:{lenslets}");
    bench.done("export --mask heuristic:2 --out a");
    let refused = |line: &str, found: &str| {
        let told = format!("a: expected a folder for this mask, found {found} of another");
        assert_told(&bench.refused(line), &[&told, "choose another --out"]);
    };
    refused(&measure("3 --out a"), "psf.npy");
    bench.done(&measure("2 --out a"));
    refused("export --mask heuristic:3 --out a", "measurements.npy");
    // Stacks in the other format stay only beside those of the same design.
    bench.done(&measure("2 --out b"));
    bench.done(&measure("2 --tiff --out b"));
    let is_there = |name: &str| bench.path("b").join(name).exists();
    assert!(is_there("measurements.npy") && is_there("measurements.tiff"));
    bench.done(&measure("3 --tiff --out b"));
    assert!(!is_there("measurements.npy") && !is_there("objects.npy") && is_there("measurements.tiff"));
}

#[test]
fn weights_that_cannot_be_written_take_no_estimate_along() {
    let bench = Bench::new();
    let sizes = "--mask heuristic:1 --patch 8 --patches-train 60 --patches-test 20 --budget 0.4s";
    let line = format!("estimate --estimator pixelcnn {sizes} --save-weights network --resume kept --json");
    // A folder takes the place of the weights during the fit, which only the state of the fit shows. The fit may end before on a busy
    // machine; then another one is tried.
    let is_late = |output: &Output| output.status.success();
    let attempt = |_| {
        if bench.path("network").exists() {
            std::fs::remove_file(bench.path("network")).unwrap();
        }
        let mut program = bench.command();
        program.args(line.split_whitespace()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut program = program.spawn().unwrap();
        while !bench.path("kept").exists() && program.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        // It fails where the weights are there.
        let _ = std::fs::create_dir(bench.path("network"));
        program.wait_with_output().unwrap()
    };
    let output = (0..20).map(attempt).find(|output| !is_late(output)).unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert_told(&told, &["the weights were not written: network: ", "a folder or device"]);
    assert_eq!(told.matches("network").count(), 1, "{told}");
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(result["bits_per_pixel"].is_number());
    assert_told(&result["notes"].to_string(), &["the weights were not written"]);
    // The same command tries again.
    std::fs::remove_dir(bench.path("network")).unwrap();
    let again: Value = serde_json::from_str(&bench.done(&line)).unwrap();
    assert!(!again["notes"].to_string().contains("not written"), "{}", again["notes"]);
    assert_eq!(bench.files(), [bench.path("network")]);
}

#[cfg(unix)]
#[test]
fn weights_are_read_from_regular_files_only() {
    let bench = Bench::new();
    assert!(std::process::Command::new("mkfifo").arg(bench.path("pipe")).status().unwrap().success());
    let line = "estimate --estimator pixelcnn --weights";
    for (file, found) in [("pipe", "a device or pipe"), ("/dev/zero", "a device or pipe"), ("none", "nothing")] {
        assert_told(&bench.refused(&format!("{line} {file}")), &[file, "expected a file", found]);
    }
}

#[test]
fn a_patch_that_is_too_large_for_a_density_model_is_told() {
    let bench = Bench::new();
    let images: Vec<f32> = (0..3 * 140 * 140).map(|index| (index * 37 % 101) as f32).collect();
    bench.write("images.npy", npy("(3, 140, 140)", &images));
    for line in [
        "estimate --measurements images.npy --estimator causal --steps 2 --patches-test 2 --patch sensor",
        "estimate --objects stack:images.npy --estimator causal --steps 2 --patches-test 2 --patch sensor",
        "design --objects stack:images.npy --objective density --patch 100 --out out",
    ] {
        assert_told(&bench.refused(line), &["cannot be modelled; use 1 to 8192 pixels"]);
    }
}
