//! Standard output and standard error, where either may be a closed pipe or a full disk.

use std::fmt::Display;
use std::io::{self, Write};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::Failure;

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

/// A bar on standard error for what takes long; nothing is drawn where that is no terminal.
pub fn progress_bar() -> ProgressBar {
    ProgressBar::new(1).with_style(
        // The template is fixed and valid; a default bar is as good.
        ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {elapsed}")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    )
}

/// A time for people, in its two largest units.
pub fn spoken(time: Duration) -> String {
    let seconds = time.as_secs_f64();
    let minutes = (seconds / 60.0).round() as u64;
    match minutes {
        _ if seconds < 9.95 => format!("{} s", (seconds * 10.0).round() / 10.0),
        _ if seconds < 99.5 => format!("{seconds:.0} s"),
        ..120 => format!("{minutes} min"),
        _ if minutes.is_multiple_of(60) => format!("{} h", minutes / 60),
        _ => format!("{} h {} min", minutes / 60, minutes % 60),
    }
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

    #[test]
    fn times_are_told_in_their_two_largest_units() {
        for (seconds, text) in [
            (0.25, "0.3 s"),
            (9.0, "9 s"),
            (60.0, "60 s"),
            (300.0, "5 min"),
            (1200.0, "20 min"),
            (7200.0, "2 h"),
            (16_200.0, "4 h 30 min"),
        ] {
            assert_eq!(spoken(Duration::from_secs_f64(seconds)), text);
        }
    }
}
