//! Messages to the user: what was done, what to know, what failed.

/// How serious a message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Something was done.
    Done,
    /// Something to know.
    Notice,
    /// Something was not done.
    Failure,
}

/// One message.
pub struct Message {
    pub severity: Severity,
    pub text: String,
    /// When it was first seen in the corner, seconds since the window was opened.
    pub seen: Option<f64>,
}

/// All messages since the start, bounded.
#[derive(Default)]
pub struct Messages {
    pub entries: Vec<Message>,
    /// The newest failure, until it is [dismissed](Messages::dismiss).
    pub failure: Option<String>,
    /// Whether the log window is open.
    pub log_open: bool,
}

impl Messages {
    /// Messages that are kept; older ones are dropped.
    const KEPT: usize = 500;

    /// Adds a message. The same message again is not repeated in the list, but shows in the corner anew.
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

    /// The newest failure has been seen, or what failed has been done after all.
    pub fn dismiss(&mut self) {
        self.failure = None;
    }
}
