//! Output to standard output and standard error; either may be a closed pipe or a full disk.

use std::fmt::Display;
use std::io::{self, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::failure::Failure;
use crate::evaluation::format_duration;

/// Prints a result and a line end.
///
/// # Errors
/// [`Failure::Closed`] for a closed pipe, [`Failure::Input`] for text that cannot be written.
pub fn print(text: &str) -> Result<(), Failure> {
    write_to(&mut io::stdout().lock(), text)
}

/// Prints a result as indented JSON.
pub fn print_json(result: &impl Serialize) -> Result<(), Failure> {
    print(&serde_json::to_string_pretty(result)?)
}

/// Reports a message on standard error. A closed standard error is ignored.
pub fn report(text: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Progress on standard error: a bar on a terminal, a line per minute in a log.
pub struct ProgressLine {
    bar: ProgressBar,
    /// Elapsed minutes at the last line.
    minutes: AtomicU64,
}

impl ProgressLine {
    /// A progress line at zero.
    pub fn new() -> Self {
        let bar = ProgressBar::new(1).with_style(
            // The template is fixed and valid.
            ProgressStyle::with_template("{bar:20} {pos}/{len} {elapsed} {wide_msg}")
                .unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        Self { bar, minutes: AtomicU64::new(0) }
    }

    /// Shows `done` of `total` steps and the current activity.
    pub fn show(&self, done: usize, total: usize, message: &str) {
        if self.bar.is_hidden() {
            let elapsed = self.bar.elapsed();
            let minutes = elapsed.as_secs() / 60;
            if self.minutes.fetch_max(minutes, Ordering::Relaxed) < minutes {
                report(line(elapsed, done, total, message));
            }
            return;
        }
        self.bar.set_length(total as u64);
        self.bar.set_position(done as u64);
        self.bar.set_message(message.to_owned());
    }

    /// Reports a message above the bar.
    pub fn report(&self, text: impl Display) {
        self.bar.suspend(|| report(text));
    }

    /// Removes the bar.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

fn line(elapsed: Duration, done: usize, total: usize, message: &str) -> String {
    format!("{}: {done} of {total}{}{message}", format_duration(elapsed), if message.is_empty() { "" } else { "; " })
}

fn write_to(writer: &mut dyn Write, text: &str) -> Result<(), Failure> {
    let end = if text.ends_with('\n') { "" } else { "\n" };
    match write!(writer, "{text}{end}").and_then(|()| writer.flush()) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(Failure::Closed),
        Err(error) => Err(anyhow::anyhow!(
            "standard output: expected to write the result, found \"{error}\"; redirect it to a disk with free space"
        )
        .into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_lines_hold_time_and_count() {
        let text = |message| line(Duration::from_secs(190), 120, 1600, message);
        assert_eq!(text("9 lenslets"), "3 min: 120 of 1600; 9 lenslets");
        assert_eq!(text(""), "3 min: 120 of 1600");
    }

    struct Broken(io::ErrorKind);

    impl Write for Broken {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(self.0.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn closed_pipes_are_ignored_and_full_disks_are_errors() {
        assert!(matches!(write_to(&mut Broken(io::ErrorKind::BrokenPipe), "x"), Err(Failure::Closed)));
        let Err(Failure::Input(error)) = write_to(&mut Broken(io::ErrorKind::StorageFull), "x") else { panic!() };
        assert!(error.to_string().starts_with("standard output: expected"), "{error}");
        let mut text = Vec::new();
        assert!(write_to(&mut text, "a").is_ok() && write_to(&mut text, "b\n").is_ok());
        assert_eq!(text, b"a\nb\n");
    }
}
