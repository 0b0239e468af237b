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
    unit: Unit,
}

/// What a progress line counts.
#[derive(Clone, Copy, PartialEq)]
enum Unit {
    /// Steps: "120 of 1600".
    Steps,
    /// Hundredths: "40 %".
    Percent,
}

impl ProgressLine {
    /// A progress line at zero.
    pub fn new() -> Self {
        Self::of("{bar:20} {pos}/{len} {elapsed} {wide_msg}", Unit::Steps)
    }

    /// A progress line at zero that counts per cent, for [`ProgressLine::show_share`].
    pub fn of_percent() -> Self {
        Self::of("{bar:20} {pos} % {elapsed} {wide_msg}", Unit::Percent)
    }

    fn of(template: &str, unit: Unit) -> Self {
        let bar = ProgressBar::new(1).with_style(
            // The templates are fixed and valid.
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        Self { bar, minutes: AtomicU64::new(0), unit }
    }

    /// Shows a share of the work, 0 to 1, and the current activity.
    pub fn show_share(&self, share: f64, message: &str) {
        self.show((100.0 * share) as usize, 100, message);
    }

    /// Shows `done` of `total` steps and the current activity.
    pub fn show(&self, done: usize, total: usize, message: &str) {
        if self.bar.is_hidden() {
            let elapsed = self.bar.elapsed();
            let minutes = elapsed.as_secs() / 60;
            if self.minutes.fetch_max(minutes, Ordering::Relaxed) < minutes {
                report(line(elapsed, &self.unit.text(done, total), message));
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

impl Unit {
    fn text(self, done: usize, total: usize) -> String {
        match self {
            Self::Steps => format!("{done} of {total}"),
            Self::Percent => format!("{done} %"),
        }
    }
}

fn line(elapsed: Duration, done: &str, message: &str) -> String {
    format!("{}: {done}{}{message}", format_duration(elapsed), if message.is_empty() { "" } else { "; " })
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
        let text = |unit: Unit, message| line(Duration::from_secs(190), &unit.text(12, 1600), message);
        assert_eq!(text(Unit::Steps, "9 lenslets"), "3 min: 12 of 1600; 9 lenslets");
        assert_eq!(text(Unit::Steps, ""), "3 min: 12 of 1600");
        assert_eq!(text(Unit::Percent, "Training"), "3 min: 12 %; Training");
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
