//! README and documentation: links and images exist, and the README stays short.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Most words of the README.
const MOST_WORDS: usize = 1_200;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// All pages: those beside the README, and those of the documentation.
fn pages() -> Vec<PathBuf> {
    let mut pages = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md"].map(|name| root().join(name)).to_vec();
    let mut folders = vec![root().join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.extension() {
                _ if path.is_dir() => folders.push(path),
                Some(ending) if ending == "md" => pages.push(path),
                _ => {}
            }
        }
    }
    pages.sort();
    pages
}

/// The text without code blocks and code spans, in which brackets are no links.
fn prose(text: &str) -> String {
    let blocks = text.split("```").step_by(2);
    blocks.map(|part| part.split('`').step_by(2).collect::<Vec<_>>().join("`")).collect::<Vec<_>>().join("\n")
}

/// Targets of the links and images of a page.
fn targets(text: &str) -> Vec<String> {
    let after = prose(text);
    after.split("](").skip(1).filter_map(|rest| Some(rest.split_once(')')?.0.to_owned())).collect()
}

/// The anchor of a heading, as a forge and mdBook make it.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    kept.chars().filter(|c| c.is_alphanumeric() || "- _".contains(*c)).map(|c| if c == ' ' { '-' } else { c }).collect()
}

fn anchors(text: &str) -> BTreeSet<String> {
    let outside = text.split("```").step_by(2).collect::<String>();
    let headings = outside.lines().filter_map(|line| line.strip_prefix('#'));
    headings.map(|line| anchor(&line.trim_start_matches('#').replace('`', ""))).collect()
}

#[test]
fn readme_is_short() {
    let words = read(&root().join("README.md")).split_whitespace().count();
    assert!(words <= MOST_WORDS, "{words} words");
}

#[test]
fn links_and_images_exist() {
    let (mut missing, mut found) = (Vec::new(), 0);
    for page in pages() {
        let text = read(&page);
        for target in targets(&text).into_iter().filter(|target| !target.contains("://")) {
            let (file, place) = target.split_once('#').unwrap_or((&target, ""));
            let path = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            let is_there = path.exists() && (place.is_empty() || anchors(&read(&path)).contains(place));
            found += 1;
            if !is_there {
                missing.push(format!("{}: {target}", page.strip_prefix(root()).unwrap().display()));
            }
        }
    }
    assert!(missing.is_empty() && found > 100, "{found} links; {missing:#?}");
}

#[test]
fn every_page_is_in_the_table_of_contents() {
    let contents = root().join("docs/SUMMARY.md");
    let listed: BTreeSet<PathBuf> =
        targets(&read(&contents)).into_iter().map(|target| root().join("docs").join(target)).collect();
    let pages = pages().into_iter().filter(|page| page.starts_with(root().join("docs")) && *page != contents);
    let unlisted: Vec<PathBuf> = pages.filter(|page| !listed.contains(page)).collect();
    assert!(unlisted.is_empty(), "{unlisted:#?}");
}

/// The book has the pages of `docs` and finds the images in `assets`. It has no other file.
#[test]
fn pages_of_the_book_link_to_what_it_has() {
    let book = [root().join("docs"), root().join("assets")].map(|folder| folder.canonicalize().unwrap());
    let mut outside = Vec::new();
    for page in pages().into_iter().filter(|page| page.starts_with(root().join("docs"))) {
        for target in targets(&read(&page)).into_iter().filter(|target| !target.contains("://")) {
            let file = target.split('#').next().unwrap_or_default();
            let path = page.parent().unwrap().join(file).canonicalize();
            if !file.is_empty() && !path.is_ok_and(|path| book.iter().any(|folder| path.starts_with(folder))) {
                outside.push(format!("{}: {target}", page.strip_prefix(root()).unwrap().display()));
            }
        }
    }
    assert!(outside.is_empty(), "{outside:#?}");
}

#[test]
fn broken_links_would_be_found() {
    let text = "# A title, of `code`\n[one](two.md#three) and ![four](five.png)\n```\n[no](link)\n```\n`[no](link)`\n";
    assert_eq!(targets(text), ["two.md#three", "five.png"]);
    assert!(anchors(text).contains("a-title-of-code"));
}
