//! The program as users run it: the built binary, its files, its sentences and its exit codes.

mod calibrate;
mod cameras;
mod display;
mod documentation;
mod failures;
mod inputs;
mod measured;
mod optimize;
mod options;
mod outputs;
mod python;
mod reconstruct;
mod schemas;
mod streams;
mod study;
mod throughput;

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use serde_json::Value;
use tempfile::TempDir;

/// A separate folder in which the program runs, without a display.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        std::fs::create_dir_all(self.path(name).parent().unwrap()).unwrap();
        std::fs::write(self.path(name), bytes).unwrap();
    }

    fn command(&self) -> Command {
        self.process(env!("CARGO_BIN_EXE_lenslet-studio"))
    }

    fn process(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.current_dir(self.folder.path()).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
        command
    }

    fn run<S: AsRef<OsStr>>(&self, arguments: impl IntoIterator<Item = S>) -> Output {
        self.command().args(arguments).output().unwrap()
    }

    /// Runs a line that must succeed and returns its output.
    fn done(&self, line: &str) -> String {
        let output = self.run(line.split_whitespace());
        assert!(output.status.code() == Some(0), "{line}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Runs a line that must succeed with JSON on standard output.
    fn json(&self, line: &str) -> Value {
        serde_json::from_str(&self.done(&format!("{line} --json"))).unwrap()
    }

    /// Runs a line that must be refused: code 2, nothing on standard output, one sentence on standard error, and no new
    /// file. Returns the sentence.
    fn refused(&self, line: &str) -> String {
        let before = self.files();
        let output = self.run(line.split_whitespace());
        // The interpretation of files may precede it.
        let told = text(&output.stderr);
        let start = told.find("lenslet-studio: ").or(told.find("error: ")).unwrap_or_default();
        let sentence = told[start..].to_owned();
        let is_of_files = |line: &str| [" px", " file", " group"].iter().any(|word| line.contains(word));
        assert!(told[..start].lines().all(is_of_files), "{line}: {told}");
        assert_eq!(output.status.code(), Some(2), "{line}: {sentence}");
        assert_eq!(text(&output.stdout), "", "{line}");
        assert!(!sentence.contains("panicked"), "{line}: {sentence}");
        if let Some(own) = sentence.strip_prefix("lenslet-studio: ") {
            assert!(own.trim_end().lines().count() == 1, "{line}: {sentence}");
        } else {
            assert!(sentence.starts_with("error: "), "{line}: {sentence}");
        }
        assert_eq!(self.files(), before, "{line}: what was there before is all that is there");
        sentence
    }

    /// Starts a line and kills it as soon as `is_due`, which looks at its files: nothing else tells how far a program has come. Tries again
    /// where the program ended first, as may happen on a busy machine. `reset` removes its files before each attempt.
    fn kill_midway(&self, line: &str, reset: impl Fn(), is_due: impl Fn() -> bool) {
        let is_killed = || {
            reset();
            let mut program = self
                .command()
                .args(line.split_whitespace())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            while !is_due() && program.try_wait().unwrap().is_none() {
                std::thread::sleep(Duration::from_millis(1));
            }
            program.kill().unwrap();
            !program.wait().unwrap().success()
        };
        assert!((0..20).any(|_| is_killed()), "{line}: it ends before it can be killed");
    }

    /// All files, at any depth.
    fn files(&self) -> Vec<PathBuf> {
        fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() { collect(&path, files) } else { files.push(path) }
            }
        }
        let mut files = Vec::new();
        collect(self.folder.path(), &mut files);
        files.sort();
        files
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// An NPY file of little-endian `f32`.
fn npy(shape: &str, values: &[f32]) -> Vec<u8> {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat();
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// An IDX file of images whose pixels are `value(index)`.
fn idx(pages: u32, side: u32, value: impl Fn(u32) -> u8) -> Vec<u8> {
    let axes = [pages, side, side].into_iter().flat_map(u32::to_be_bytes);
    [0, 0, 8, 3].into_iter().chain(axes).chain((0..pages * side * side).map(value)).collect()
}
