//! Standard output and standard error, where either may be a closed pipe or a full disk.

use std::fmt::Display;
use std::io::{self, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::Failure;
use crate::workbench::spoken;

/// Prints a result, followed by the end of a line.
///
/// # Errors
/// [`Failure::Closed`] where nobody reads any more, [`Failure::Input`] where the text cannot be written.
pub fn print(text: &str) -> Result<(), Failure> {
    write_to(&mut io::stdout().lock(), text)
}

/// Prints a result as indented JSON.
pub fn print_json(result: &impl Serialize) -> Result<(), Failure> {
    print(&serde_json::to_string_pretty(result)?)
}

/// Tells the user something beside the result. Where standard error is closed, nobody is there to be told.
pub fn tell(text: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Progress of what takes long, on standard error: a bar on a terminal, a line a minute elsewhere, as in the log of a
/// cluster's job.
pub struct Meter {
    bar: ProgressBar,
    /// Whole minutes until the last line.
    minutes: AtomicU64,
}

impl Meter {
    /// Begins at nothing.
    pub fn new() -> Self {
        let bar = ProgressBar::new(1).with_style(
            // The template is fixed and valid; a default bar is as good.
            ProgressStyle::with_template("{bar:20} {pos}/{len} {elapsed} {wide_msg}")
                .unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        Self { bar, minutes: AtomicU64::new(0) }
    }

    /// Shows that `done` of `total` steps are done, and what goes on.
    pub fn show(&self, done: usize, total: usize, message: &str) {
        if self.bar.is_hidden() {
            let elapsed = self.bar.elapsed();
            let minutes = elapsed.as_secs() / 60;
            if self.minutes.fetch_max(minutes, Ordering::Relaxed) < minutes {
                tell(line(elapsed, done, total, message));
            }
            return;
        }
        self.bar.set_length(total as u64);
        self.bar.set_position(done as u64);
        self.bar.set_message(message.to_owned());
    }

    /// Tells something for good.
    pub fn tell(&self, text: impl Display) {
        self.bar.suspend(|| tell(text));
    }

    /// Leaves the place to the result.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

fn line(elapsed: Duration, done: usize, total: usize, message: &str) -> String {
    format!("{}: {done} of {total}{}{message}", spoken(elapsed), if message.is_empty() { "" } else { "; " })
}

fn write_to(writer: &mut dyn Write, text: &str) -> Result<(), Failure> {
    let end = if text.ends_with('\n') { "" } else { "\n" };
    match write!(writer, "{text}{end}").and_then(|()| writer.flush()) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(Failure::Closed),
        Err(error) => Err(anyhow::anyhow!(
            "standard output: expected to write the result, found \"{error}\"; redirect it to a place with room"
        )
        .into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_progress_tells_time_and_place() {
        let told = |message| line(Duration::from_secs(190), 120, 1600, message);
        assert_eq!(told("9 lenslets"), "3 min: 120 of 1600; 9 lenslets");
        assert_eq!(told(""), "3 min: 120 of 1600");
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
    fn a_reader_who_left_is_no_error_and_a_full_disk_is() {
        assert!(matches!(write_to(&mut Broken(io::ErrorKind::BrokenPipe), "x"), Err(Failure::Closed)));
        let Err(Failure::Input(error)) = write_to(&mut Broken(io::ErrorKind::StorageFull), "x") else { panic!() };
        assert!(error.to_string().starts_with("standard output: expected"), "{error}");
        let mut text = Vec::new();
        assert!(write_to(&mut text, "a").is_ok() && write_to(&mut text, "b\n").is_ok());
        assert_eq!(text, b"a\nb\n");
    }
}
