//! Messages to the user: completed work, notices, failures.

/// Severity of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Something was completed.
    Done,
    /// A notice.
    Notice,
    /// Something failed.
    Failure,
}

/// One message.
pub struct Message {
    /// Its severity.
    pub severity: Severity,
    /// Its text, one or more sentences.
    pub text: String,
    /// Time of its first display as a toast, seconds since the start.
    pub seen: Option<f64>,
}

/// The message log, of bounded length.
#[derive(Default)]
pub struct Messages {
    /// All messages, oldest first.
    pub entries: Vec<Message>,
    /// The newest failure, until it is [dismissed](Messages::dismiss).
    pub failure: Option<String>,
    /// Whether the log window is open.
    pub log_open: bool,
}

impl Messages {
    /// Maximal number of messages; older ones are dropped.
    const KEPT: usize = 500;

    /// Adds a message. A repeated message is not listed twice, but its toast appears again.
    pub fn push(&mut self, severity: Severity, text: impl Into<String>) {
        let text = text.into();
        if severity == Severity::Failure {
            self.failure = Some(text.clone());
        }
        if let Some(last) = self.entries.last_mut().filter(|last| last.text == text) {
            last.seen = None;
            return;
        }
        if self.entries.len() >= Self::KEPT {
            self.entries.remove(0);
        }
        self.entries.push(Message { severity, text, seen: None });
    }

    /// Closes the banner of the newest failure.
    pub fn dismiss(&mut self) {
        self.failure = None;
    }
}
