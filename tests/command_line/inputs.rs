//! Files of images from users: their interpretation, its correction, and the names of files that are not images.

use super::{Bench, npy, text};

/// Standard error of a line that must succeed.
fn said(bench: &Bench, line: &str) -> String {
    let output = bench.run(line.split_whitespace());
    assert_eq!(output.status.code(), Some(0), "{line}: {}", text(&output.stderr));
    text(&output.stderr)
}

/// A stack of 6 x 40 x 36 whose images differ.
fn stack() -> Vec<u8> {
    npy("(6, 40, 36)", &(0..6 * 40 * 36).map(|pixel| (pixel * 7 % 251) as f32).collect::<Vec<_>>())
}

#[test]
fn what_is_understood_of_files_is_said_on_standard_error() {
    let bench = Bench::new();
    bench.write("a.npy", stack());
    let understood = "6 images of 40 x 36 px, axis 1 counts them, 32-bit floats, range 0 to 250";
    for line in [
        "tamura a.npy",
        "bounds --objects stack:a.npy",
        "simulate --objects stack:a.npy --count 1 --out out",
        "estimate --objects stack:a.npy --estimator gaussian --patch 4 --patches-train 60 --patches-test 20",
        "estimate --measurements a.npy --estimator gaussian --patch 4 --patches-train 60 --patches-test 20",
    ] {
        assert!(said(&bench, line).contains(&format!("a.npy: {understood}")), "{line}: {}", said(&bench, line));
    }
    bench.write("psf.npy", npy("(32, 32)", &[1.0; 1024]));
    let psf = said(&bench, "export --mask psf:psf.npy --out psf");
    assert!(psf.contains("psf.npy: 1 image of 32 x 32 px, 32-bit floats, range 1 to 1"), "{psf}");
}

#[test]
fn options_of_a_path_change_what_is_understood_for_every_use() {
    let bench = Bench::new();
    bench.write("last.npy", npy("(40, 36, 6)", &(0..6 * 40 * 36).map(|pixel| (pixel % 6) as f32).collect::<Vec<_>>()));
    let twenty = "6 images of 40 x 36 px, axis 3 counts them";
    for line in [
        "tamura last.npy?axis=last",
        "bounds --objects stack:last.npy?axis=last",
        "estimate --measurements last.npy?axis=3 --estimator gaussian --patch 4 --patches-train 60 --patches-test 20",
    ] {
        assert!(said(&bench, line).contains(twenty), "{line}: {}", said(&bench, line));
    }
    bench.write("colour.npy", npy("(8, 8, 3)", &(0..192).map(|value| (value % 3) as f32).collect::<Vec<_>>()));
    let psf = said(&bench, "export --mask psf:colour.npy?channel=blue@4 --out out");
    assert!(psf.contains("range 2 to 2; channel 3 of 3"), "{psf}");
    let frame = said(&bench, "export --mask psf:last.npy?axis=last&frame=2 --out out");
    assert!(frame.contains("range 1 to 1; image 2 of 6"), "{frame}");
    let told = bench.refused("tamura last.npy?axes=last");
    assert!(told.contains("axis=first, last or a number") && told.contains("found \"axes=last\""), "{told}");
    // Of colours as measurements the green channel is taken, and told.
    let grey: Vec<f32> = (0..4 * 8 * 8 * 3).map(|value| (value * 13 % 17) as f32).collect();
    bench.write("colours.npy", npy("(4, 8, 8, 3)", &grey));
    let line =
        "estimate --estimator gaussian --patch 2 --patches-train 60 --patches-test 20 --measurements colours.npy";
    assert!(said(&bench, line).contains("taken: the green channel"));
    assert!(said(&bench, &format!("{line}?channel=green")).contains("4 images of 8 x 8 px"));
}

#[test]
fn hidden_files_of_a_folder_are_left_out_as_measurements_too() {
    let bench = Bench::new();
    for (index, level) in [3.0, 5.0, 8.0].into_iter().enumerate() {
        let pixels: Vec<f32> = (0..64).map(|pixel| level + (pixel % 5) as f32).collect();
        bench.write(&format!("frames/{index}.npy"), npy("(8, 8)", &pixels));
        bench.write(&format!("frames/._{index}.npy"), b"\0\x05\x16\x07\0\x02\0\0Mac OS X");
    }
    bench.write("frames/Thumbs.db", "thumbnails");
    let line = "estimate --estimator gaussian --patch 2 --patches-train 60 --patches-test 20 --measurements frames";
    assert!(said(&bench, line).contains("frames: 3 images of 8 x 8 px in 3 files, 32-bit floats, range 3 to 12"));
}

#[cfg(unix)]
#[test]
fn names_that_are_no_text_open_everywhere() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let bench = Bench::new();
    let name = OsStr::from_bytes(b"caf\xe9.npy");
    std::fs::write(bench.path(name), stack()).unwrap();
    std::fs::write(bench.path(OsStr::from_bytes(b"psf\xe9.npy")), npy("(32, 32)", &[1.0; 1024])).unwrap();
    let words = |line: &str| {
        line.split_whitespace()
            .map(|word| {
                OsStr::from_bytes(&word.bytes().map(|byte| if byte == b'~' { 0xe9 } else { byte }).collect::<Vec<_>>())
                    .to_owned()
            })
            .collect::<Vec<_>>()
    };
    for line in [
        "tamura caf~.npy",
        "bounds --objects stack:caf~.npy",
        "export --mask psf:psf~.npy --out out",
        "estimate --measurements caf~.npy --estimator gaussian --patch 4 --patches-train 60 --patches-test 20",
        "simulate --objects stack:caf~.npy --count 1 --out kept",
    ] {
        let output = bench.run(words(line));
        assert_eq!(output.status.code(), Some(0), "{line}: {}", text(&output.stderr));
    }
    // A design saved with such a name can be opened again.
    let design = std::fs::read_to_string(bench.path("kept/design.json")).unwrap();
    assert!(design.contains("stack:caf%E9.npy"), "{design}");
    assert!(said(&bench, "bounds kept/design.json").contains("6 images of 40 x 36 px"));
}

/// A spot on a black level of 256, more light than the spot.
#[test]
fn photograph_of_a_psf_is_imported_by_options_of_its_path_and_by_a_file() {
    let bench = Bench::new();
    let pixel = |row: usize, col: usize| {
        let noise = ((row * 31 + col * 17) % 3) as f32;
        256.0 + noise + if row.abs_diff(30) < 8 && col.abs_diff(40) < 8 { 900.0 } else { 0.0 }
    };
    bench.write("photo.npy", npy("(80, 100)", &(0..8000).map(|i| pixel(i / 100, i % 100)).collect::<Vec<_>>()));
    let plain = said(&bench, "export --mask psf:photo.npy --out plain");
    assert!(plain.contains("photo.npy: the corners have the grey value 257"), "{plain}");
    let line = "export --mask psf:photo.npy?dark=corners&window=auto&bin=2 --out out";
    let told = said(&bench, line);
    assert!(told.contains("the dark level of 257 from the corners is subtracted, 9"), "{told}");
    assert!(told.contains("in sums of 2 x 2 px hold"), "{told}");
    let result = bench.json(line);
    assert_eq!((result["psf_rows"].as_u64(), result["psf_cols"].as_u64()), (Some(8), Some(8)));
    let (mean, floor) = (result["mean_mtf"].as_f64().unwrap(), result["mtf_noise_floor"].as_f64().unwrap());
    assert!(mean > 0.01 && mean < 0.5 && floor > 0.0 && floor < 0.01, "{mean} {floor}");
    assert!(result["notices"].as_array().unwrap().len() > 2, "{result}");
    bench.write(
        "photo.toml",
        "format = \"lenslet-studio/psf-import\"\nformat_version = 1\nphotograph = \"photo.npy\"\ndark = \"corners\"\n\
         window = \"auto\"\nbin = 2\n",
    );
    bench.done("export --mask psf:photo.toml --out same");
    let psf = |folder: &str| std::fs::read(bench.path(format!("{folder}/psf.npy"))).unwrap();
    assert_eq!(psf("same"), psf("out"));
    // The design keeps what the photograph limits.
    assert!(bench.json("export out/design.json --out again")["mtf_noise_floor"].is_f64());
    let lenslets = bench.json("export --mask heuristic:9 --out nine");
    assert!(lenslets["mean_mtf"].is_f64() && lenslets["mtf_noise_floor"].is_null());
    let refused = bench.refused("export --mask psf:photo.npy?bin=2@8 --out two");
    assert!(refused.contains("one of bin, grid"), "{refused}");
}

#[test]
fn an_at_sign_in_a_name_is_no_side() {
    let bench = Bench::new();
    bench.write("psf@32", npy("(8, 8)", &[1.0; 64]));
    assert!(said(&bench, "export --mask psf:psf@32 --out out").contains("psf@32: 1 image of 8 x 8 px"));
    let shape = |line: &str| bench.json(line)["measurement_shape"].to_string();
    assert_eq!(shape("simulate --count 1 --mask psf:psf@32@4 --out out4"), "[1,93,93]");
    assert_eq!(shape("simulate --count 1 --mask psf:psf@32 --out out8"), "[1,89,89]");
}

#[test]
fn files_that_are_none_are_named_whatever_they_are_used_for() {
    let bench = Bench::new();
    let labels = [&[0, 0, 8, 1, 0, 0, 0, 9][..], &[1; 9]].concat();
    for (content, what) in [
        (b"version https://git-lfs.github.com/spec/v1\n".to_vec(), "a Git LFS pointer"),
        (b"<!DOCTYPE html><html>".to_vec(), "a web page"),
        (Vec::new(), "an empty file"),
        (labels, "IDX labels (1 axis)"),
        (b"\x89HDF\r\n\x1a\n".to_vec(), "an HDF5 file"),
    ] {
        bench.write("bad.npy", content);
        for line in [
            "tamura bad.npy",
            "export --mask psf:bad.npy --out out",
            "bounds --objects stack:bad.npy",
            "bounds --objects idx:bad.npy",
            "estimate --measurements bad.npy",
        ] {
            let told = bench.refused(line);
            assert!(told.contains("bad.npy: expected") && told.contains(&format!("found {what}")), "{line}: {told}");
        }
    }
    bench.write("design.json", "\u{feff}<html>");
    assert!(bench.refused("bounds design.json").contains("found a web page"));
}
