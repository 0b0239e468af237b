//! Reasons why a command stopped.

/// Reason why a command stopped; it decides the exit code.
#[derive(Debug)]
pub enum Failure {
    /// The reader of the results has closed the pipe: code 0.
    Closed,
    /// Bad input, usage, or a file that cannot be read or written: code 2.
    Input(anyhow::Error),
    /// The result is incomplete: code 1.
    Incomplete(anyhow::Error),
}

/// Errors of the library concern its input: files, settings, designs.
impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Input(error.into())
    }
}
