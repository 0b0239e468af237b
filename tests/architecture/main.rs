//! Architecture of the crate: modules import only from floors below their own, folders inside a floor too, and no long
//! cycle of imports exists.
//!
//! The test parses every file of `src` and traces each import, through re-exports, to the file that defines the item. The
//! front page of the crate explains the floors.

mod documentation;
mod source;

use std::fs;
use std::path::{Path, PathBuf};

use source::{House, identifiers, module_of};

/// Top-level modules and their floors, ground first. The modules of one floor do not import each other. On the ground
/// floor the order of this list counts.
const FLOORS: [&[&str]; 9] = [
    &["plural", "percentile", "seeds", "significant", "progress", "formats"],
    &["optics", "objects", "sensor", "nn", "sparsity"],
    &["forward", "camera"],
    &["information"],
    &["design", "reconstruction"],
    &["evaluation"],
    &["studies"],
    &["workbench"],
    &["studio", "cli"],
];

/// Modules that may use any floor: the library's front page and prelude, and the program.
const ROOF: [&str; 4] = ["lib", "main", "prelude", ""];

/// Imports between modules of one floor that are allowed: the command line opens the window.
const BESIDE: [(&str, &str); 1] = [("cli", "studio")];

/// The modules of a folder from the lowest to the highest. Each imports only from earlier ones and from itself.
const ORDER: [(&str, &[&str]); 3] = [
    (
        "information",
        &[
            "engine_choice",
            "estimator",
            "error",
            "stopwatch",
            "progress",
            "fit_checkpoint",
            "test_beads",
            "statistics",
            "entropy",
            "density",
            "decoder",
            "ais",
            "bounds",
            "estimate",
        ],
    ),
    (
        "workbench",
        &[
            "background",
            "document",
            "export",
            "live",
            "reconstructions",
            "captures",
            "cameras",
            "trainings",
            "studies",
            "runs",
            "estimates",
            "jobs",
            "session",
        ],
    ),
    ("studio", &["widgets", "canvas", "state", "panels", "dialogs", "app"]),
];

/// Crates that only the window may name.
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

/// Largest number of files in one cycle of imports.
const LONGEST_CYCLE: usize = 2;

impl House {
    /// Violations of the architecture, one sentence each.
    fn violations(&self) -> Vec<String> {
        let mut found = self.violations.clone();
        for mention in &self.mentions {
            let climbs = mention.path.iter().take_while(|name| *name == "super").count();
            let depth = mention.module.split("::").count();
            if climbs > 0 && climbs >= depth {
                let file = &self.files[self.modules[&mention.module].file];
                found.push(format!(
                    "{}:{}: super leads out of the module; write crate::",
                    file.display(),
                    mention.line
                ));
            }
        }
        for (file, path) in self.files.iter().enumerate() {
            let module = module_of(path);
            let top = module.split("::").next().unwrap_or_default();
            if !ROOF.contains(&top) && floor(top).is_none() {
                found.push(format!("{}: the module {top} has no floor; give it one", path.display()));
            }
            if let Some((folder, order)) = ORDER.iter().find(|(folder, _)| *folder == top)
                && let Some(part) = module.split("::").nth(1)
                && !order.contains(&part)
            {
                found.push(format!("{}: {part} has no place in the order of {folder}", self.files[file].display()));
            }
        }
        for ((own, target), line) in self.imports() {
            if let Some(reason) = self.forbidden(own, target) {
                found.push(format!("{}:{line}: {reason}", self.files[own].display()));
            }
        }
        let imports = self.imports();
        found.extend(self.cycles().into_iter().map(|cycle| {
            let name = |file: usize| self.files[file].display().to_string();
            let of = |file: usize| {
                let inside = |other: &&usize| imports.contains_key(&(file, **other));
                let others: Vec<String> = cycle.iter().filter(inside).map(|&other| name(other)).collect();
                format!("\n    {} -> {}", name(file), others.join(", "))
            };
            format!(
                "{} files import each other:{}",
                cycle.len(),
                cycle.iter().map(|&file| of(file)).collect::<String>()
            )
        }));
        found
    }

    /// Reason why a file may not import from another.
    fn forbidden(&self, own: usize, target: usize) -> Option<String> {
        let [own, target] = [own, target].map(|file| module_of(&self.files[file]));
        let parts = |module: &str| module.split("::").map(String::from).collect::<Vec<_>>();
        let (own, target) = (parts(&own), parts(&target));
        if ROOF.contains(&own[0].as_str()) {
            return None;
        }
        if own[0] == target[0] {
            let is_panel =
                |parts: &[String]| parts.len() > 2 && parts[..2] == ["studio", "panels"] && parts[2] != "parts";
            if is_panel(&target) && own[1] == "panels" && own.len() > 2 && own[2] != target[2] {
                return Some(format!("{} may not import {}: panels do not know each other", own[2], target[2]));
            }
            let (folder, order) = ORDER.iter().find(|(folder, _)| *folder == own[0])?;
            let place =
                |parts: &[String]| order.iter().position(|part| Some(*part) == parts.get(1).map(String::as_str));
            let (here, there) = (place(&own)?, place(&target)?);
            return (there > here)
                .then(|| format!("in {folder}, {} may not import {}, which is above it", own[1], target[1]));
        }
        if BESIDE.contains(&(own[0].as_str(), target[0].as_str())) {
            return None;
        }
        let (here, there) = (floor(&own[0])?, floor(&target[0]));
        let is_below = there.is_some_and(|there| there < here);
        (!is_below).then(|| format!("{} may not import {}: an import only goes down", own[0], target[0]))
    }

    /// Cycles of imports with too many files: the strongly connected components (Tarjan 1972).
    fn cycles(&self) -> Vec<Vec<usize>> {
        let mut edges = vec![Vec::new(); self.files.len()];
        for (own, target) in self.imports().into_keys() {
            edges[own].push(target);
        }
        let mut search =
            Search { edges: &edges, index: vec![None; edges.len()], low: vec![0; edges.len()], ..Search::default() };
        for file in 0..edges.len() {
            if search.index[file].is_none() {
                search.visit(file);
            }
        }
        search.components.retain(|component| component.len() > LONGEST_CYCLE);
        search.components
    }
}

#[derive(Default)]
struct Search<'a> {
    edges: &'a [Vec<usize>],
    index: Vec<Option<usize>>,
    low: Vec<usize>,
    stack: Vec<usize>,
    next: usize,
    components: Vec<Vec<usize>>,
}

impl Search<'_> {
    fn visit(&mut self, node: usize) {
        self.index[node] = Some(self.next);
        self.low[node] = self.next;
        self.next += 1;
        self.stack.push(node);
        for &other in &self.edges[node] {
            match self.index[other] {
                None => {
                    self.visit(other);
                    self.low[node] = self.low[node].min(self.low[other]);
                }
                Some(index) if self.stack.contains(&other) => self.low[node] = self.low[node].min(index),
                Some(_) => {}
            }
        }
        if Some(self.low[node]) == self.index[node] {
            let place = self.stack.iter().position(|&other| other == node).expect("it was put there");
            self.components.push(self.stack.split_off(place));
        }
    }
}

/// The place of a top-level module: its floor, and its place on the ground floor.
fn floor(module: &str) -> Option<(usize, usize)> {
    FLOORS.iter().enumerate().find_map(|(floor, modules)| {
        let place = modules.iter().position(|name| *name == module)?;
        Some((floor, if floor == 0 { place } else { 0 }))
    })
}

fn read_folder(root: &Path, folder: &Path, sources: &mut Vec<(PathBuf, String)>) {
    let mut entries: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            read_folder(root, &path, sources);
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            // Files of tests alone have no place in the architecture.
            let is_test = path.file_stem().is_some_and(|name| name == "tests");
            let name = path.strip_prefix(root).unwrap().to_path_buf();
            sources.extend((!is_test).then(|| (name, fs::read_to_string(&path).unwrap())));
        }
    }
}

fn sources() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut sources = Vec::new();
    read_folder(&root, &root, &mut sources);
    assert!(sources.len() > 150, "the source is read");
    sources
}

#[test]
fn imports_only_go_down_and_cycles_have_two_files_at_most() {
    let found = House::of(&sources()).violations();
    assert!(found.is_empty(), "\n{}", found.join("\n"));
}

/// Every number of the window uses one kind of field, which parses all numbers by the same rules.
#[test]
fn numbers_are_typed_into_the_number_field_alone() {
    for (path, source) in sources().into_iter().filter(|(path, _)| path.starts_with("studio")) {
        let mut names = Vec::new();
        identifiers(source.parse().unwrap(), &mut names);
        let count = |wanted: &str| names.iter().filter(|(name, _)| name == wanted).count();
        assert!(path.ends_with("number_field.rs") || count("DragValue") == 0, "{}: use NumberField", path.display());
        // The value box of a slider would be another kind.
        let sliders = names.windows(2).filter(|pair| pair[0].0 == "Slider" && pair[1].0 == "new").count();
        assert_eq!(sliders, source.matches(".show_value(false)").count(), "{}: a slider with a box", path.display());
    }
}

#[test]
fn violations_are_found() {
    let house = |files: &[(&str, &str)]| {
        let sources: Vec<_> = files.iter().map(|(path, source)| (PathBuf::from(path), (*source).to_owned())).collect();
        House::of(&sources).violations()
    };
    let others = [
        ("lib.rs", "pub mod optics;"),
        ("objects/mod.rs", "mod set;\npub use set::ObjectSet;"),
        ("objects/set.rs", "pub struct ObjectSet;"),
        ("optics/mod.rs", "pub struct Encoder;"),
        ("workbench/mod.rs", "pub mod document;\npub mod live;"),
        ("workbench/document/mod.rs", "pub struct Job;"),
        ("workbench/live/mod.rs", "pub struct Live;"),
        ("cli/mod.rs", "pub fn run() {}"),
        ("studio/mod.rs", "pub fn open_window() {}"),
        ("studio/panels/mod.rs", ""),
        ("studio/panels/mtf.rs", "pub fn show() {}"),
    ];
    let with = |path: &str, source: &str| {
        let mut files: Vec<(&str, &str)> = others.iter().filter(|(other, _)| *other != path).copied().collect();
        files.push((path, source));
        house(&files)
    };
    for (path, source, line) in [
        ("forward/a.rs", "use std::fmt;\nuse crate::workbench::document::Job;", 2),
        ("optics/psf.rs", "fn f() { let _ = crate::objects::ObjectSet; }", 1),
        ("information/error.rs", "use crate::{\n    optics::Encoder,\n    workbench::document::Job,\n};", 1),
        ("workbench/document/a.rs", "use crate::cli::run;", 1),
        ("workbench/document/a.rs", "use crate::workbench::live::Live;", 1),
        ("workbench/document/a.rs", "use super::super::live::Live;", 1),
        ("workbench/document/a.rs", "use egui::Color32;", 1),
        ("studio/app/a.rs", "use crate::cli::run;", 1),
        ("studio/panels/mask.rs", "use crate::studio::panels::mtf::show;", 1),
        ("studio/panels/parts/a.rs", "use crate::studio::panels::mtf::show;", 1),
        ("main.rs", "use eframe::App;", 1),
        ("optics/psf.rs", "fn f() { println!(\"{}\", crate::cli::run()); }", 1),
        ("sparsity.rs", "use super::optics::Encoder;", 1),
    ] {
        let found = with(path, source);
        assert!(
            found.iter().any(|text| text.starts_with(&format!("{path}:{line}:"))),
            "{path}: {source:?} gives {found:?}"
        );
    }
    for (path, source, words) in
        [("elsewhere/a.rs", "", "has no floor"), ("workbench/elsewhere/a.rs", "", "has no place in the order")]
    {
        assert!(with(path, source).iter().any(|text| text.contains(words)), "{path}");
    }
    for (path, source) in [
        (
            "forward/a.rs",
            "use crate::{optics, objects::ObjectSet};\nuse crate::forward::b::B;\nfn f(_: optics::Encoder) {}",
        ),
        ("forward/a.rs", "//! Unlike [`crate::workbench`].\n/* use egui; */ const A: &str = \"crate::cli\";"),
        ("cli/mod.rs", "fn f() { crate::studio::open_window(); crate::workbench::live::Live; }\npub fn run() {}"),
        ("studio/app/view.rs", "use egui::Ui;\nuse crate::workbench::live::Live;"),
        ("optics/psf.rs", "use super::Encoder;\n#[cfg(test)]\nmod tests {\n    use crate::cli::run;\n}"),
        ("workbench/live/a.rs", "use super::Live;\nuse crate::workbench::document::Job;"),
    ] {
        assert_eq!(with(path, source), Vec::<String>::new(), "{path}");
    }
    let two = [
        ("optics/mod.rs", "mod a;\nmod b;\nmod c;\npub use a::A;\npub use b::B;\npub use c::C;"),
        ("optics/a.rs", "use super::B;\npub struct A;"),
        ("optics/b.rs", "use super::A;\npub struct B;"),
        ("optics/c.rs", "pub struct C;"),
    ];
    assert_eq!(house(&two), Vec::<String>::new(), "two files may import each other");
    let three = [
        two[0],
        ("optics/a.rs", "use super::C;\npub struct A;"),
        two[2],
        ("optics/c.rs", "use super::*;\nstruct D(B);\npub struct C;\nfn f(_: super::B) {}"),
    ];
    assert!(house(&three).iter().any(|text| text.starts_with("3 files import each other")), "{:?}", house(&three));
}
