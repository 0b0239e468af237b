//! The Python of the documentation, with the built program.

use std::path::Path;
use std::process::Command;

use super::{Bench, text};

/// The blocks of one language, in order.
fn blocks<'a>(page: &'a str, language: &str) -> Vec<&'a str> {
    let opening = format!("```{language}\n");
    page.split(&opening).skip(1).filter_map(|rest| Some(rest.split_once("\n```")?.0)).collect()
}

/// The text with every number replaced by a sign: machines and versions of NumPy differ in digits.
fn without_numbers(text: &str) -> String {
    let is_number = |c: char| c.is_ascii_digit() || c == '.' || c == '-';
    let mut plain = String::new();
    for c in text.chars() {
        match is_number(c) {
            true if plain.ends_with('#') => {}
            true => plain.push('#'),
            false => plain.push(c),
        }
    }
    plain
}

#[test]
fn python_of_the_documentation_runs() {
    let has_numpy = Command::new("python3").args(["-c", "import numpy"]).output();
    if !has_numpy.is_ok_and(|found| found.status.success()) {
        println!("skipped: python3 with NumPy is missing");
        return;
    }
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/howto/python.md");
    let page = std::fs::read_to_string(page).unwrap();
    let (code, printed) = (blocks(&page, "python"), blocks(&page, "text"));
    assert!(code.len() > 5 && printed.len() > 4, "{} blocks of code, {} of output", code.len(), printed.len());
    let bench = Bench::new();
    bench.write("page.py", code.join("\n"));
    let program = Path::new(env!("CARGO_BIN_EXE_lenslet-studio"));
    let others = std::env::var_os("PATH").unwrap_or_default();
    let path =
        std::env::join_paths([program.parent().unwrap().to_owned()].into_iter().chain(std::env::split_paths(&others)));
    let mut python = Command::new("python3");
    python.arg("page.py").current_dir(bench.path("")).env("PATH", path.unwrap());
    let output = python.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let (found, expected) = (text(&output.stdout), printed.join("\n"));
    assert_eq!(without_numbers(found.trim()), without_numbers(expected.trim()), "it printed\n{found}");
}
