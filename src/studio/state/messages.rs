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
        self.log(severity, text);
    }

    /// Adds a failure that its own dialog shows: it has no banner.
    pub fn log_failure(&mut self, text: &str) {
        self.log(Severity::Failure, text.to_owned());
    }

    /// Severity of the newest message for the status bar: a failure without a banner counts as a thing of the past.
    pub fn newest_severity(&self) -> Option<Severity> {
        let newest = self.entries.last()?;
        let is_past = newest.severity == Severity::Failure && self.failure.as_ref() != Some(&newest.text);
        Some(if is_past { Severity::Done } else { newest.severity })
    }

    fn log(&mut self, severity: Severity, text: String) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dismissed_failure_is_listed_and_no_longer_marked() {
        let mut messages = Messages::default();
        messages.push(Severity::Failure, "no file");
        assert_eq!(
            (messages.failure.as_deref(), messages.newest_severity()),
            (Some("no file"), Some(Severity::Failure))
        );
        messages.dismiss();
        assert_eq!((messages.entries.len(), messages.newest_severity()), (1, Some(Severity::Done)));
    }

    #[test]
    fn failure_that_a_dialog_shows_has_no_banner() {
        let mut messages = Messages::default();
        messages.log_failure("no light");
        assert_eq!((&messages.failure, messages.newest_severity()), (&None, Some(Severity::Done)));
        assert_eq!(messages.entries[0].severity, Severity::Failure, "the log marks it");
    }
}
