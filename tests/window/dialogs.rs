//! The button of the system's file dialog: missing, cancelled and answered.
#![cfg(target_os = "linux")]

use std::os::unix::fs::PermissionsExt;
use std::process::Command;

use egui_kittest::kittest::NodeT;

use super::waiting::wait_for;
use super::*;

/// Variable with the folder of all programs that the test below can start. It runs in its own process, with no portal and
/// no dialog except in that folder, whatever the machine has.
const PROGRAMS: &str = "LENSLET_STUDIO_DIALOG_PROGRAMS";

/// Installs a program that records its call and then runs `and`.
fn put_dialog(programs: &Path, and: &str) {
    let program = programs.join("zenity");
    std::fs::write(&program, format!("#!/bin/sh\necho >>'{}'\n{and}\n", programs.join("asked").display())).unwrap();
    std::fs::set_permissions(program, std::fs::Permissions::from_mode(0o755)).unwrap();
}

/// Number of calls of the system's dialog.
fn asked(programs: &Path) -> usize {
    std::fs::read(programs.join("asked")).map_or(0, |lines| lines.len())
}

/// Presses the button and waits for the system's answer.
fn browse(window: &mut Window) {
    click(window, "Browse...");
    wait_for(window, "the answer of the system", |window| {
        !window.get_by_label("Browse...").accesskit_node().is_disabled()
    });
}

fn path_field(window: &Window) -> String {
    window.get_by_label("Path").value().unwrap_or_default()
}

#[test]
fn typed_path_survives_missing_or_cancelled_dialog() {
    let Some(programs) = std::env::var_os(PROGRAMS).map(std::path::PathBuf::from) else {
        let programs = tempfile::tempdir().unwrap();
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["dialogs::typed_path_survives_missing_or_cancelled_dialog", "--exact"])
            .env(PROGRAMS, programs.path())
            .env("PATH", programs.path())
            .env("DBUS_SESSION_BUS_ADDRESS", "unix:path=/nowhere")
            .output()
            .unwrap();
        let (report, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success() && report.contains("1 passed"), "{report}\n{errors}");
        return;
    };
    let chosen = programs.join("chosen.json");
    Design { seed: 77, ..Design::default() }.save(&chosen).unwrap();
    let mut window = open(Design::default());
    menu(&mut window, &["File", "Open design..."]);
    window.get_by_label("Path").type_text("/some/where.json");
    window.run_steps(2);
    browse(&mut window);
    assert_eq!((path_field(&window).as_str(), asked(&programs)), ("/some/where.json", 0), "there is none");
    let says_so = |window: &Window| window.query_by_label_contains("This system has no file dialog").is_some();
    assert!(says_so(&window) && window.get_by_label("Path").is_focused());
    window.get_by_label("Cancel").click();
    window.run_steps(4);
    menu(&mut window, &["File", "Open design..."]);
    window.get_by_label("Path").type_text("/some/where.json");
    window.run_steps(2);
    put_dialog(&programs, "exit 1");
    browse(&mut window);
    assert_eq!((path_field(&window).as_str(), asked(&programs)), ("/some/where.json", 1), "it was cancelled");
    assert!(!says_so(&window), "there is one, and it was cancelled");
    put_dialog(&programs, &format!("echo '{}'", chosen.display()));
    browse(&mut window);
    assert_eq!((path_field(&window), asked(&programs)), (chosen.display().to_string(), 2));
    click(&mut window, "Open");
    settle(&mut window);
    assert_eq!(studio(&window).session().design().seed, 77);

    // The system has asked about the name without its extension.
    let other = programs.join("other.json");
    Design { seed: 5, ..Design::default() }.save(&other).unwrap();
    put_dialog(&programs, &format!("echo '{}'", programs.join("other").display()));
    menu(&mut window, &["File", "Save design as..."]);
    browse(&mut window);
    click(&mut window, "Save");
    settle(&mut window);
    assert_eq!(Design::open(&other).unwrap().seed, 5, "it is asked about first");
    window.get_by_label("Replace");
    click(&mut window, "Cancel");
    // The system has asked about the file itself, so the window does not ask.
    menu(&mut window, &["File", "Save design as..."]);
    put_dialog(&programs, &format!("echo '{}'", other.display()));
    browse(&mut window);
    click(&mut window, "Replace");
    settle(&mut window);
    assert_eq!(Design::open(&other).unwrap().seed, 77);
}
