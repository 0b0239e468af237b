//! Modules import only from floors below their own: the house of the crate's front page, checked by reading the source.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

/// Top-level modules and their floors; what all of them may use lies in the basement.
const FLOORS: [(&str, i8); 16] = [
    ("plural", -1),
    ("seeds", -1),
    ("formats", 0),
    ("optics", 1),
    ("objects", 1),
    ("sensor", 1),
    ("sparsity", 1),
    ("nn", 1),
    ("forward", 2),
    ("information", 3),
    ("design", 4),
    ("evaluation", 5),
    ("reconstruction", 4),
    ("studies", 4),
    ("workbench", 6),
    ("cli", 7),
];

/// The window has the floor of the command line, which opens it.
const WINDOW: &str = "studio";
/// Crates of the window.
const WINDOW_CRATES: [&str; 11] = [
    "egui",
    "eframe",
    "rfd",
    "egui_plot",
    "egui_tiles",
    "egui_wgpu",
    "egui_kittest",
    "epaint",
    "arboard",
    "winit",
    "zbus",
];

/// What is wrong with one line.
#[derive(Debug, PartialEq)]
struct Violation {
    file: PathBuf,
    line: usize,
    reason: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}:{}: {}", self.file.display(), self.line, self.reason)
    }
}

fn floor(module: &str) -> Option<i8> {
    if module == WINDOW {
        return Some(7);
    }
    FLOORS.iter().find(|(name, _)| *name == module).map(|&(_, floor)| floor)
}

/// A source text in which comments and the contents of strings are blank; lines stay where they are.
fn code_of(source: &str) -> String {
    let mut code = String::with_capacity(source.len());
    let mut rest = source;
    let blank = |text: &str| text.chars().map(|c| if c == '\n' { '\n' } else { ' ' }).collect::<String>();
    while let Some(first) = rest.chars().next() {
        let length = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |end| end + 2)
        } else if let Some(hashes) = raw_string(rest) {
            let end = format!("\"{}", "#".repeat(hashes));
            let start = hashes + 2;
            rest[start..].find(&end).map_or(rest.len(), |at| start + at + end.len())
        } else if first == '"' {
            string_length(rest)
        } else if let Some(length) = character_length(rest) {
            length
        } else {
            code.push(first);
            rest = &rest[first.len_utf8()..];
            continue;
        };
        code += &blank(&rest[..length]);
        rest = &rest[length..];
    }
    code
}

/// Number of `#` of a raw string that starts here.
fn raw_string(text: &str) -> Option<usize> {
    let after = text.strip_prefix('r')?;
    let hashes = after.bytes().take_while(|&byte| byte == b'#').count();
    after[hashes..].starts_with('"').then_some(hashes)
}

fn string_length(text: &str) -> usize {
    let mut escaped = false;
    for (index, c) in text.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return index + 1,
            _ => {}
        }
    }
    text.len()
}

/// Length of a character literal that starts here; a lifetime is none.
fn character_length(text: &str) -> Option<usize> {
    let after = text.strip_prefix('\'')?;
    if let Some(escape) = after.strip_prefix('\\') {
        let skipped = escape.chars().next()?.len_utf8();
        return escape[skipped..].find('\'').map(|end| 2 + skipped + end + 1);
    }
    let length = after.chars().next()?.len_utf8();
    after[length..].starts_with('\'').then_some(length + 2)
}

/// Names that follow `crate::` or `lenslet_studio::` here: one, or those of a group in braces.
fn named(after: &str) -> Vec<String> {
    let identifier =
        |text: &str| -> String { text.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect() };
    let after = after.trim_start();
    let Some(group) = after.strip_prefix('{') else { return vec![identifier(after)] };
    let (mut names, mut depth, mut start) = (Vec::new(), 0, 0);
    for (index, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => {
                names.push(identifier(&group[start..index]));
                break;
            }
            '}' => depth -= 1,
            ',' if depth == 0 => {
                names.push(identifier(&group[start..index]));
                start = index + 1;
            }
            _ => {}
        }
    }
    names.retain(|name| !name.is_empty());
    names
}

/// Places where `word` stands alone.
fn words<'a>(code: &'a str, word: &'a str) -> impl Iterator<Item = usize> + 'a {
    let part = |c: char| c.is_alphanumeric() || c == '_';
    code.match_indices(word)
        .map(|(at, _)| at)
        .filter(move |&at| !code[..at].ends_with(part) && !code[at + word.len()..].starts_with(part))
}

/// Checks one file; `path` is relative to `src`.
fn check(path: &Path, source: &str) -> Vec<Violation> {
    let first = path.components().next().map(|part| part.as_os_str().to_string_lossy().into_owned());
    let own = first.unwrap_or_default().trim_end_matches(".rs").to_owned();
    let code = code_of(source);
    let mut found = Vec::new();
    let mut violation = |at: usize, reason: String| {
        found.push(Violation { file: path.to_path_buf(), line: code[..at].matches('\n').count() + 1, reason });
    };
    for word in WINDOW_CRATES {
        for at in words(&code, word) {
            if own != WINDOW {
                violation(at, format!("only {WINDOW} may name {word}"));
            }
        }
    }
    // The crate's root and the program's entry stand on the roof.
    if own == "lib" || own == "main" {
        return found;
    }
    let Some(own_floor) = floor(&own) else {
        violation(0, format!("the module {own} has no floor; give it one"));
        return found;
    };
    for root in ["crate", "lenslet_studio"] {
        for at in words(&code, root) {
            let Some(after) = code[at + root.len()..].trim_start().strip_prefix("::") else { continue };
            for name in named(after) {
                let allowed = match floor(&name) {
                    None => false,
                    Some(_) if name == own => true,
                    Some(7) => own == "cli" && name == WINDOW,
                    Some(floor) => floor < own_floor,
                };
                if !allowed {
                    violation(at, format!("{own} (floor {own_floor}) may not import {name}"));
                }
            }
        }
    }
    // `super` leaves the folder where it is repeated more often than the file is deep.
    let depth = path.components().count();
    for at in words(&code, "super") {
        let mut rest = &code[at..];
        let mut ups = 0;
        while let Some(after) = rest.strip_prefix("super") {
            ups += 1;
            rest = after.trim_start().strip_prefix("::").unwrap_or("").trim_start();
        }
        // The module of `folder/file.rs` is two below the root, that of `folder/mod.rs` one; one more inside `mod tests`.
        let is_folder = path.file_name().is_some_and(|name| name == "mod.rs");
        let module_depth = if is_folder { depth - 1 } else { depth };
        let inner = code[..at].lines().any(|line| line.starts_with("mod ") && line.trim_end().ends_with('{'));
        if !code[..at].trim_end().ends_with("super::") && ups >= module_depth + usize::from(inner) {
            violation(at, "super leads out of the module; write crate:: so that the floor can be read".into());
        }
    }
    found
}

fn check_folder(root: &Path, folder: &Path, found: &mut Vec<Violation>) -> usize {
    let mut files = 0;
    let mut entries: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files += check_folder(root, &path, found);
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            files += 1;
            found.extend(check(path.strip_prefix(root).unwrap(), &fs::read_to_string(&path).unwrap()));
        }
    }
    files
}

#[test]
fn imports_only_go_down() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    assert!(check_folder(&root, &root, &mut found) > 50, "the source is read");
    let list: Vec<String> = found.iter().map(ToString::to_string).collect();
    assert!(list.is_empty(), "\n{}", list.join("\n"));
}

/// Every number of the window is typed into one kind of field, which reads all of them by the same rules.
#[test]
fn numbers_are_typed_into_the_number_field_alone() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/studio");
    let mut files = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let code = code_of(&fs::read_to_string(&path).unwrap());
        let is_field = path.ends_with("number_field.rs");
        assert!(is_field || words(&code, "DragValue").next().is_none(), "{}: use NumberField", path.display());
        // The value box of a slider would be another kind.
        let sliders = words(&code, "Slider").filter(|at| code[*at..].starts_with("Slider::new")).count();
        assert_eq!(sliders, code.matches(".show_value(false)").count(), "{}: a slider with a box", path.display());
        files += 1;
    }
    assert!(files > 40, "the source is read");
}

#[test]
fn violations_are_found() {
    let reasons = |path: &str, source: &str| -> Vec<(usize, String)> {
        check(Path::new(path), source).into_iter().map(|violation| (violation.line, violation.reason)).collect()
    };
    for (path, source, line) in [
        ("sensor/noise.rs", "use std::fmt;\nuse crate::objects::ObjectSet;", 2),
        ("optics/psf.rs", "fn f() { let _ = crate::information::x(); }", 1),
        ("information/a.rs", "use crate::{\n    optics::Encoder,\n    workbench::{Design, Job},\n};", 1),
        ("formats/a.rs", "\n\npub(in crate::workbench) fn f() {}", 3),
        ("workbench/a.rs", "use crate::cli::run;", 1),
        ("workbench/a.rs", "use egui::Color32;", 1),
        ("studio/a.rs", "use crate::cli::run;", 1),
        ("main.rs", "use eframe::App;", 1),
        ("sparsity.rs", "use crate::sensor::Noise;", 1),
        ("plural.rs", "use crate::formats::FormatError;", 1),
        ("sparsity.rs", "use super::sensor::Noise;", 1),
        ("optics/psf.rs", "use super::super::objects::Split;", 1),
        ("optics/mod.rs", "use super::objects::Split;", 1),
        ("elsewhere/a.rs", "", 1),
        ("information/a.rs", "use crate::unheard_of::A;", 1),
    ] {
        let found = reasons(path, source);
        assert!(found.len() == 1 && found[0].0 == line, "{path}: {source:?} gives {found:?}");
    }
    for (path, source) in [
        ("information/a.rs", "use crate::{formats, sensor::{Noise, Patches}};\nuse crate::information::Estimate;"),
        ("sensor/noise.rs", "//! Unlike [`crate::workbench`].\n/* use egui; */ const A: &str = \"crate::cli\";"),
        ("sensor/noise.rs", "const A: &str = r#\"use \"crate::cli\"\"#; const B: char = '\"'; fn f<'a>(_: &'a str) {}"),
        ("cli/mod.rs", "fn f() { crate::studio::open_window(); crate::evaluation::estimate(); }"),
        ("studio/view.rs", "use egui::Ui;\nuse crate::workbench::Job;\nuse super::state::State;"),
        ("optics/psf.rs", "use super::Lenslet;\nmod tests {\n    use super::super::Lenslet;\n}"),
        ("sparsity.rs", "mod tests {\n    use super::*;\n}"),
        ("formats/a.rs", "use crate::plural::counted;"),
        ("lib.rs", "pub mod studio;"),
        ("formats/a.rs", "pub(crate) fn f() {}"),
        ("sensor/a.rs", "struct Unegui; fn egui_like() {}"),
    ] {
        assert_eq!(reasons(path, source), [], "{path}");
    }
}
