//! Help, completions, and input and output through pipes.

use std::fs::OpenOptions;
use std::io::{BufRead, BufReader};
use std::process::Stdio;

use super::{Bench, text};

#[test]
fn everything_has_help() {
    let bench = Bench::new();
    let help = bench.done("--help");
    let commands = help.split("Commands:").nth(1).unwrap().split("\n\n").next().unwrap();
    // The description of a command may continue on the next line, indented further.
    let named = commands.lines().filter_map(|line| line.strip_prefix("  ").filter(|line| !line.starts_with(' ')));
    let names: Vec<&str> = named.filter_map(|line| line.split_whitespace().next()).collect();
    assert!(names.len() > 9 && names.contains(&"estimate"), "{help}");
    for name in names.into_iter().filter(|&name| name != "help") {
        let of_command = bench.done(&format!("{name} --help"));
        assert!(of_command.contains("Usage: lenslet-studio ") && of_command.contains(name), "{of_command}");
        assert_eq!(of_command, bench.done(&format!("help {name}")));
    }
    assert_eq!(bench.done("--version").trim(), format!("lenslet-studio {}", env!("CARGO_PKG_VERSION")));
    assert!(bench.files().is_empty());
}

#[test]
fn shells_are_offered_completions() {
    let bench = Bench::new();
    for (shell, part) in
        [("bash", "complete -F"), ("zsh", "#compdef lenslet-studio"), ("fish", "complete -c lenslet-studio")]
    {
        let script = bench.done(&format!("completions {shell}"));
        assert!(script.contains(part) && script.contains("patches-train"), "{shell}");
    }
    assert!(bench.refused("completions tcl").contains("bash"));
}

/// A reader that leaves after the first line is no error, and the output files are written.
#[test]
fn a_closed_pipe_is_no_error() {
    let bench = Bench::new();
    for line in [
        "--help",
        "completions zsh",
        "export --out a",
        "simulate --count 2 --out b",
        "simulate --count 2 --out c --json",
        "estimate --patch 4 --patches-train 50 --patches-test 20 --json",
        "",
    ] {
        // The pipe is closed before anything is printed.
        let mut child = bench
            .command()
            .args(line.split_whitespace())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        let told = text(&output.stderr);
        assert!(output.status.code() == Some(0) && !told.contains("panicked"), "{line}: {told}");
    }
    for name in ["a/psf.npy", "b/measurements.npy", "c/design.json", "lenslet-studio-export/psf.npy"] {
        assert!(bench.path(name).is_file(), "{name}");
    }
    // One that reads a line first.
    let mut child = bench.command().args(["completions", "bash"]).stdout(Stdio::piped()).spawn().unwrap();
    let mut first = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut first).unwrap();
    assert!(!first.is_empty() && child.wait().unwrap().code() == Some(0));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_standard_output_is_told() {
    let bench = Bench::new();
    bench.done("simulate --count 1 --out b");
    for line in ["--help", "completions bash", "tamura b/objects.npy", "export --out a --json", "--version"] {
        let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = bench.command().args(line.split_whitespace()).stdout(full).output().unwrap();
        let told = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{line}: {told}");
        // The interpretation of a file may precede it.
        let last = told.trim_end().lines().last().unwrap_or_default();
        assert!(last.starts_with("lenslet-studio: standard output: expected"), "{told}");
        // With standard error also full, no report is possible, and the exit code remains.
        let full = || OpenOptions::new().write(true).open("/dev/full").unwrap();
        let status = bench.command().args(line.split_whitespace()).stdout(full()).stderr(full()).status().unwrap();
        assert_eq!(status.code(), Some(2), "{line}");
    }
    let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
    let status = bench.command().args(["tamura", "none.npy"]).stderr(full).status().unwrap();
    assert_eq!(status.code(), Some(2));
}

#[cfg(unix)]
#[test]
fn files_that_outgrow_the_disk_leave_nothing_behind() {
    let bench = Bench::new();
    // A limit on the length of files simulates a full disk: both refuse further writes.
    let limited = |blocks: usize, line: &str| {
        let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" {line}");
        let mut command = std::process::Command::new("sh");
        command.args(["-c", &script, env!("CARGO_BIN_EXE_lenslet-studio")]).current_dir(bench.path("."));
        command.output().unwrap()
    };
    // 1000 measurements of 65 x 65 px take 17 MB, their objects 37 MB.
    for line in [
        "simulate --count 1000 --out out",
        "simulate --count 1000 --out out --tiff",
        "export --out out --mask heuristic:9",
    ] {
        let output = limited(16, line);
        let told = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{line}: {told}");
        assert!(told.starts_with("lenslet-studio: out/") && told.contains("free some space"), "{told}");
        let kept = bench.files();
        assert!(kept.iter().all(|file| !file.to_string_lossy().contains(".writing")), "{line}: {kept:?}");
        if line.starts_with("simulate") {
            assert!(kept.is_empty(), "{line}: {kept:?}");
        } else {
            // Every existing file is complete. The longer design file is missing.
            assert!(kept.iter().all(|file| !file.ends_with("design.json")), "{kept:?}");
            for file in kept.iter().filter(|file| file.extension().is_some_and(|ending| ending == "png")) {
                assert_eq!(lenslet_studio::formats::read_grey(file).unwrap().dim(), (32, 32));
            }
        }
    }
}
