//! Commands of README and documentation run as they stand there.
//!
//! A code block that begins with ```` ```sh run ```` is run by a shell: the blocks of one page in one folder, in order,
//! without a display. A `text` block right after it is part of what the commands print, apart from digits.
// The commands are those of a Unix shell.
#![cfg(unix)]

use std::path::{Path, PathBuf};

use super::{Bench, text};

/// The first line of a block that is run.
const RUN: &str = "```sh run";

/// Commands of a page, and the output that the page shows for them.
#[derive(Debug, PartialEq)]
struct Block {
    commands: String,
    output: Option<String>,
}

/// The blocks of a page that are run.
fn blocks(page: &str) -> Vec<Block> {
    let mut lines = page.lines().peekable();
    let mut found = Vec::new();
    while let Some(line) = lines.next() {
        let mut code = || lines.by_ref().take_while(|line| *line != "```").collect::<Vec<_>>().join("\n");
        if line != RUN {
            // The end of another block must not be taken for a beginning.
            if line.starts_with("```") {
                code();
            }
            continue;
        }
        let commands = code();
        while lines.next_if(|line| line.is_empty()).is_some() {}
        let output = lines.next_if_eq(&"```text").is_some();
        let output = output.then(|| lines.by_ref().take_while(|line| *line != "```").collect::<Vec<_>>().join("\n"));
        found.push(Block { commands, output });
    }
    found
}

/// The words of an output, with `#` for each number: digits differ from one machine to another.
fn words(output: &str) -> Vec<String> {
    let mask = |word: &str| {
        let mut masked = String::new();
        let mut characters = word.chars().peekable();
        while let Some(character) = characters.next() {
            let begins =
                character.is_ascii_digit() || (character == '-' && characters.peek().is_some_and(char::is_ascii_digit));
            masked.push(if begins { '#' } else { character });
            if begins {
                while characters.next_if(|next| next.is_ascii_digit() || *next == '.').is_some() {}
            }
        }
        masked
    };
    output.split_whitespace().map(mask).collect()
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(page: &str) -> String {
    std::fs::read_to_string(root().join(page)).unwrap_or_else(|error| panic!("{page}: {error}"))
}

fn run(page: &str) {
    let bench = Bench::new();
    let program = Path::new(env!("CARGO_BIN_EXE_lenslet-studio")).parent().unwrap().as_os_str();
    let path = [program.to_owned(), std::env::var_os("PATH").unwrap_or_default()].join(":".as_ref());
    for Block { commands, output } in blocks(&read(page)) {
        // The shell stops at the first command that fails.
        let run = bench.process("sh").args(["-e", "-c", &commands]).env("PATH", &path).output().unwrap();
        assert!(run.status.code() == Some(0), "{page}: {commands}\n{}", text(&run.stderr));
        if let Some(expected) = output {
            let (found, expected) = (words(&text(&run.stdout)), words(&expected));
            let is_part = found.windows(expected.len()).any(|part| part == expected);
            assert!(is_part, "{page}: {commands}\nexpected {expected:?}\n   found {found:?}");
        }
    }
}

/// One test for each page, so that they run side by side.
macro_rules! pages {
    ($($name:ident: $page:literal,)*) => {
        const PAGES: &[&str] = &[$($page),*];
        $(#[test]
        fn $name() {
            run($page);
        })*
    };
}

pages! {
    readme: "README.md",
    install: "docs/start/install.md",
    first_mask: "docs/start/first-mask.md",
    first_own_images: "docs/start/first-own-images.md",
    load_objects: "docs/howto/load-objects.md",
    set_sizes: "docs/howto/set-sizes.md",
    import_a_psf: "docs/howto/import-a-psf.md",
    estimate_camera_images: "docs/howto/estimate-camera-images.md",
    compare_designs: "docs/howto/compare-designs.md",
    run_a_study: "docs/howto/run-a-study.md",
    reproduce_a_number: "docs/howto/reproduce-a-number.md",
    command_line: "docs/reference/command-line.md",
    settings: "docs/reference/settings.md",
}

#[test]
fn every_page_with_commands_to_run_has_a_test() {
    let mut folders = vec![PathBuf::from("docs")];
    let mut found = vec!["README.md".to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root().join(&folder)).unwrap() {
            let path = folder.join(entry.unwrap().file_name());
            match path.extension() {
                Some(ending) if ending == "md" => found.push(path.to_str().unwrap().to_owned()),
                _ if root().join(&path).is_dir() => folders.push(path),
                _ => {}
            }
        }
    }
    found.retain(|page| read(page).lines().any(|line| line.trim_start().starts_with(RUN)));
    let mut listed = PAGES.to_vec();
    found.sort();
    listed.sort_unstable();
    assert_eq!(found, listed);
    let commands = found.iter().flat_map(|page| blocks(&read(page))).map(|block| block.commands.lines().count());
    assert!(commands.sum::<usize>() >= 15);
}

#[test]
fn blocks_and_words_of_a_page() {
    let page =
        "```sh\nlater\n```\n\n```sh run\na 1\nb\n```\n\n```text\nx 0.5 [0.4, -1]\n```\n```sh run\nc\n```\nThen\n";
    let output = Some("x 0.5 [0.4, -1]".to_owned());
    let expected = [Block { commands: "a 1\nb".into(), output }, Block { commands: "c".into(), output: None }];
    assert_eq!(blocks(page), expected);
    assert_eq!(words("x 0.5  [0.4, -1]\n32x32 1.2 s"), words("x 0.25 [1.4, 7] 8x16 10 s"));
    assert_ne!(words("at least 0.3 decoder"), words("at most 0.3 decoder"));
}
