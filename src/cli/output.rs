//! Standard output and standard error, where either may be a closed pipe or a full disk.

use std::fmt::Display;
use std::io::{self, Write};

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

/// A bar for so many steps of something that tells much about each.
pub fn step_bar(steps: usize) -> ProgressBar {
    ProgressBar::new(steps as u64).with_style(
        // The template is fixed and valid; a default bar is as good.
        ProgressStyle::with_template("{bar:20} {pos}/{len} {elapsed} {wide_msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    )
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
}
