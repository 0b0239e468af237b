//! The machine that a time belongs to.

use serde::{Deserialize, Serialize};

use crate::plural::counted;

/// The machine that computed a cell: seconds mean little without it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Machine {
    /// Model of the processor, or its kind where the system does not name the model.
    pub processor: String,
    /// Threads that computed.
    pub threads: usize,
}

impl Machine {
    /// The machine that this program runs on.
    pub fn here() -> Self {
        let listed = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let processor = model_name(&listed)
            .unwrap_or_else(|| format!("{} processor under {}", std::env::consts::ARCH, std::env::consts::OS));
        Self { processor, threads: rayon::current_num_threads() }
    }

    /// One line for people.
    pub fn describe(&self) -> String {
        format!("{}, {}", self.processor, counted(self.threads, "thread"))
    }
}

/// The first model name in the list of processors that Linux keeps.
fn model_name(listed: &str) -> Option<String> {
    let name = listed.lines().find_map(|line| line.strip_prefix("model name"))?;
    let name = name.trim_start_matches([' ', '\t', ':']).split_whitespace().collect::<Vec<_>>().join(" ");
    (!name.is_empty()).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_is_read_where_the_system_names_it() {
        let listed = "processor\t: 0\nmodel name\t: ACME  Fast 9000\nprocessor\t: 1\nmodel name\t: other\n";
        assert_eq!(model_name(listed).as_deref(), Some("ACME Fast 9000"));
        assert_eq!(model_name("processor\t: 0\nCPU part\t: 0xd40\n"), None);
        let here = Machine::here();
        assert!(!here.processor.is_empty() && here.threads > 0);
    }
}
