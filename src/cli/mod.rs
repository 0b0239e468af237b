//! The command line: the same computations and files as the window, without one.
//!
//! Results go to standard output, progress and errors to standard error. Exit codes: 0 success; 1 incomplete result; 2 bad
//! input, wrong usage, or a file that cannot be read or written; 101 a bug.

mod bounds;
mod calibrate;
mod choices;
mod comparison;
mod design_args;
mod estimate;
mod export;
mod failure;
mod headless;
mod measurements;
mod optimize;
mod optimize_runs;
mod optimize_starts;
mod output;
mod reconstruct;
mod reconstruct_folder;
mod reconstruct_network;
mod reproduce;
#[cfg(test)]
mod schemas;
mod simulate;
mod stop;
mod study;
mod study_plan;
mod study_run;
mod tamura;

use failure::Failure;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

/// Design lensless cameras by the information their measurements carry.
///
/// Without a subcommand the studio opens its window, on DESIGN where one is given.
#[derive(Debug, Parser)]
#[command(name = "lenslet-studio", version, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,

    /// Design file to open in the window.
    design: Option<PathBuf>,

    /// Draw the window by OpenGL (glow) or by Vulkan, Metal or DirectX (wgpu); the other is tried where one fails
    /// [default: that of the settings, or glow].
    #[cfg(feature = "studio")]
    #[arg(long, value_enum)]
    renderer: Option<crate::studio::RendererChoice>,

    /// Forget the layout of the window and its preferences; designs and recent files stay.
    #[cfg(feature = "studio")]
    #[arg(long)]
    reset_ui: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Write the PSF as PNG, TIFF and NPY, the design as JSON and the lenslets as CSV.
    Export(export::Arguments),
    /// Simulate measurements: objects, noiseless and noisy measurements as NPY or TIFF.
    #[command(alias = "measure")]
    Simulate(simulate::Arguments),
    /// Print the bounds that the window updates with every edit: Gaussian bound, entropy bound, Tamura coefficients.
    #[command(alias = "look")]
    Bounds(bounds::Arguments),
    /// Estimate the information of a design's measurements, in bits per pixel.
    Estimate(estimate::Arguments),
    /// Calibrate a camera after EMVA 1288: system gain, noise, saturation and nonuniformity from frames.
    Calibrate(calibrate::Arguments),
    /// Optimize a mask by the information of its measurements (IDEAL), resumable, into a folder.
    #[command(alias = "design")]
    Optimize(optimize::Arguments),
    /// Studies: plans of cells over masks, objects and settings, computed into a folder (resumable), with tables and plots.
    Study(study::Arguments),
    /// Reconstruct objects: the image quality of a decoder for a design, or the object of a real capture.
    Reconstruct(reconstruct::Arguments),
    /// Recompute a live estimate or a run from its record, and compare the results.
    #[command(alias = "repeat")]
    Reproduce(reproduce::Arguments),
    /// Print the Tamura coefficient of NPY, TIFF or image files.
    Tamura(tamura::Arguments),
    /// Print a completion script for a shell.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
}

/// Exit code of a bug: the code of a panic.
const PANICKED: u8 = 101;

/// Runs the program with the arguments it was started with.
pub fn run() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(message) => return usage(&message),
    };
    // A panic is a bug. The default hook prints its message.
    match std::panic::catch_unwind(|| dispatch(arguments)) {
        Ok(result) => finish(result),
        Err(_) => ExitCode::from(PANICKED),
    }
}

/// Prints help and version to standard output, and a wrong argument to standard error with code 2.
fn usage(message: &clap::Error) -> ExitCode {
    if message.use_stderr() {
        let _ = message.print();
        return ExitCode::from(2);
    }
    finish(output::print(&message.render().to_string()))
}

fn finish(result: Result<(), Failure>) -> ExitCode {
    let (error, code) = match result {
        // The reader has closed the pipe on purpose.
        Ok(()) | Err(Failure::Closed) => return ExitCode::SUCCESS,
        Err(Failure::Input(error)) => (error, 2),
        Err(Failure::Incomplete(error)) => (error, 1),
    };
    output::report(format_args!("lenslet-studio: {error:#}"));
    ExitCode::from(code)
}

fn dispatch(arguments: Arguments) -> Result<(), Failure> {
    match arguments.command {
        Some(Command::Export(arguments)) => arguments.run(),
        Some(Command::Simulate(arguments)) => arguments.run(),
        Some(Command::Bounds(arguments)) => arguments.run(),
        Some(Command::Estimate(arguments)) => arguments.run(),
        Some(Command::Calibrate(arguments)) => arguments.run(),
        Some(Command::Optimize(arguments)) => arguments.run(),
        Some(Command::Study(arguments)) => arguments.run(),
        Some(Command::Reconstruct(arguments)) => arguments.run(),
        Some(Command::Reproduce(arguments)) => arguments.run(),
        Some(Command::Tamura(arguments)) => arguments.run(),
        Some(Command::Completions { shell }) => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Arguments::command(), "lenslet-studio", &mut script);
            output::print(&String::from_utf8_lossy(&script))
        }
        None => open(arguments),
    }
}

/// Opens the window; without a display, runs headless.
#[cfg(feature = "studio")]
fn open(arguments: Arguments) -> Result<(), Failure> {
    let design = headless::design(arguments.design.as_deref())?;
    if !headless::has_display() {
        output::report("No display was found, so there is no window; the design is computed here instead.");
        return headless::run(&design);
    }
    match crate::studio::open_window(design.clone(), arguments.design, arguments.renderer, arguments.reset_ui) {
        Ok(()) => Ok(()),
        // The edited design is lost: the start design must not be computed in its place.
        Err(error @ crate::studio::WindowError::Lost { .. }) => Err(Failure::Incomplete(error.into())),
        Err(error) => {
            output::report(format_args!("{error}; the design is computed here instead."));
            headless::run(&design)
        }
    }
}

/// A build without the window runs headless.
#[cfg(not(feature = "studio"))]
fn open(arguments: Arguments) -> Result<(), Failure> {
    let design = headless::design(arguments.design.as_deref())?;
    output::report("This build has no window; the design is computed here instead.");
    headless::run(&design)
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;
    use std::path::{Path, PathBuf};

    use clap::CommandFactory;

    use super::*;

    fn root() -> &'static Path {
        Path::new(env!("CARGO_MANIFEST_DIR"))
    }

    /// The pages of a folder and its folders.
    fn pages(folder: &Path) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let of = |path: PathBuf| if path.is_dir() { pages(&path) } else { vec![path] };
        entries.flat_map(of).filter(|path| path.extension().is_some_and(|ending| ending == "md")).collect()
    }

    /// Commands of the program in README and documentation: lines of code blocks.
    fn commands() -> Vec<String> {
        let mut found = Vec::new();
        for page in [vec![root().join("README.md")], pages(&root().join("docs"))].concat() {
            let text = std::fs::read_to_string(page).unwrap();
            let blocks = text.split("```").skip(1).step_by(2).flat_map(str::lines);
            let of_program = blocks.filter(|line| line.starts_with("lenslet-studio "));
            // A comment, a file for the output, and quotes around a word are the shell's.
            found.extend(of_program.map(|line| {
                let command = line.split(" #").next().and_then(|line| line.split(" > ").next());
                command.unwrap_or_default().replace('\'', "")
            }));
        }
        found
    }

    #[test]
    fn commands_of_the_documentation_parse() {
        let commands = commands();
        assert!(commands.len() > 50, "{commands:#?}");
        for command in commands {
            let result = Arguments::try_parse_from(command.split_whitespace());
            assert!(result.is_ok(), "{command}: {}", result.unwrap_err());
        }
    }

    /// Help of every command, as it is printed for a terminal of 100 columns.
    fn page_of_options() -> String {
        let mut page = "# Options of every command\n\nThe text of `help COMMAND`. A test keeps this page as the program prints it.\n".to_owned();
        let mut add = |name: &str, command: &mut clap::Command| {
            let help = command.clone().term_width(100).render_long_help().to_string();
            let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
            let _ = write!(page, "\n## {name}\n\n```text\n{}\n```\n", lines.join("\n").trim_end());
        };
        let mut program = Arguments::command();
        program.build();
        add("lenslet-studio", &mut program);
        for command in
            program.get_subcommands_mut().filter(|command| !command.is_hide_set() && command.get_name() != "help")
        {
            add(command.get_name().to_owned().as_str(), command);
            for part in command.get_subcommands_mut().filter(|part| !part.is_hide_set() && part.get_name() != "help") {
                add(
                    part.get_bin_name().unwrap_or_default().trim_start_matches("lenslet-studio ").to_owned().as_str(),
                    part,
                );
            }
        }
        page
    }

    /// With `UPDATE_DOCS` set the page is written.
    #[test]
    fn page_of_options_is_up_to_date() {
        let (path, page) = (root().join("docs/reference/options.md"), page_of_options());
        if std::env::var_os("UPDATE_DOCS").is_some() {
            std::fs::write(&path, &page).unwrap();
        }
        let found = std::fs::read_to_string(&path).unwrap();
        assert!(found == page, "docs/reference/options.md is out of date: run this test with UPDATE_DOCS=1");
    }

    #[test]
    fn every_flag_is_explained() {
        let text = std::fs::read_to_string(root().join("docs/reference/command-line.md")).unwrap();
        let mut program = Arguments::command();
        program.build();
        let mut commands = vec![&program];
        let mut missing = Vec::new();
        while let Some(command) = commands.pop() {
            commands.extend(command.get_subcommands().filter(|part| !part.is_hide_set() && part.get_name() != "help"));
            let flags = command.get_arguments().filter(|argument| !argument.is_hide_set());
            let names = flags.filter_map(|argument| argument.get_long()).map(|name| format!("--{name}"));
            missing.extend(names.filter(|name| !text.contains(name.as_str())));
        }
        assert!(missing.is_empty(), "docs/reference/command-line.md says nothing of {missing:?}");
    }
}
