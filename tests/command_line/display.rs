//! The window's own options where no window can be opened.
#![cfg(all(feature = "studio", target_os = "linux"))]

use std::process::Command;

use serde_json::{Value, json};

use super::{Bench, text};

/// A display that does not answer.
const NO_DISPLAY: &str = ":9999";

/// The program with such a display and a separate home folder.
fn opens_in_vain(bench: &Bench) -> Command {
    let mut command = bench.command();
    command.env("DISPLAY", NO_DISPLAY).env("XDG_DATA_HOME", bench.path("home"));
    command
}

fn kept(bench: &Bench, name: &str) -> Vec<u8> {
    std::fs::read(bench.path("home/lenslet-studio").join(name)).unwrap()
}

#[test]
fn a_display_that_does_not_answer_is_told_in_one_sentence_and_the_design_exported() {
    let bench = Bench::new();
    for renderer in ["glow", "wgpu"] {
        let output = opens_in_vain(&bench).args(["--renderer", renderer]).output().unwrap();
        let told = text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{told}");
        assert!(told.trim_end().lines().count() == 1 && !told.contains("panicked"), "{told}");
        for part in ["no window could be opened", "DISPLAY", "the design is computed here instead"] {
            assert!(told.contains(part), "{part} in {told}");
        }
        assert!(text(&output.stdout).contains("Gaussian bound"));
        let exported = bench.path("lenslet-studio-export");
        assert!(exported.join("design.json").is_file());
        std::fs::remove_dir_all(exported).unwrap();
    }
}

#[test]
fn reset_ui_forgets_how_the_window_looks_but_no_design() {
    let bench = Bench::new();
    let chosen = json!({
        "welcomed": true,
        "theme": "Dark",
        "zoom": 1.5,
        "live": false,
        "link_views": false,
        "recent": ["/designs/one.json"],
        "unsaved": "/elsewhere/unsaved",
    });
    bench.write("home/lenslet-studio/preferences.json", chosen.to_string());
    bench.write("home/lenslet-studio/layout.json", "{}");
    bench.write("home/lenslet-studio/app.ron", "{}");
    let designs = ["unsaved/1-1.json", "kept/one.json", "run/state"];
    for name in designs {
        bench.write(&format!("home/lenslet-studio/{name}"), name);
    }
    // The reset happens before the window is opened.
    assert!(opens_in_vain(&bench).arg("--reset-ui").output().unwrap().status.success());
    let known: Value = serde_json::from_slice(&kept(&bench, "preferences.json")).unwrap();
    for (name, value) in [
        ("theme", json!("System")),
        ("zoom", json!(1.0)),
        ("live", json!(true)),
        ("link_views", json!(true)),
        ("recent", chosen["recent"].clone()),
        ("unsaved", chosen["unsaved"].clone()),
    ] {
        assert_eq!(known[name], value, "{name}");
    }
    for name in ["layout.json", "app.ron"] {
        assert!(!bench.path("home/lenslet-studio").join(name).exists(), "{name}");
    }
    for name in designs {
        assert_eq!(kept(&bench, name), name.as_bytes(), "{name}");
    }
}
