//! Progress of jobs as text.

use std::sync::Arc;

use crate::evaluation::format_duration;
use crate::workbench::Activity;

/// Name and progress of the first active job, and the number of others.
pub fn summary(all: &[Arc<Activity>]) -> Option<String> {
    let mut open = all.iter().filter(|activity| activity.is_open());
    let first = open.next()?;
    let more = open.count();
    let share = first.share.map_or(String::new(), |share| format!(" {:.0} %", 100.0 * share));
    let left = left_of(first);
    let others = if more == 0 { String::new() } else { format!(" (+{more})") };
    Some(format!("{}{share}{left}{others}", first.name))
}

/// Remaining time as text.
pub fn left_of(activity: &Activity) -> String {
    match (activity.left, activity.step_left()) {
        (Some(left), _) => format!(", {} left", format_duration(left)),
        (None, Some(left)) => format!(", {} left in this step", format_duration(left)),
        (None, None) => String::new(),
    }
}
