//! The share of a plan's cells that one task of a job array computes.

use std::collections::HashMap;
use std::fmt;
use std::str::FromStr;

use super::cell::CellSettings;

/// Task `index` of `count`. Cells are dealt in the order of their ids, so the share does not depend on what is done already.
///
/// ```
/// use lenslet_studio::studies::plans::Shard;
///
/// let shard: Shard = "1/4".parse()?;
/// assert_eq!((shard.index, shard.count), (1, 4));
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of the task, from 0.
    pub index: usize,
    /// Number of tasks.
    pub count: usize,
}

impl Default for Shard {
    /// One task that computes all cells.
    fn default() -> Self {
        Self { index: 0, count: 1 }
    }
}

impl Shard {
    /// Rank of each cell, by which cells are dealt to tasks: the order of their ids. Cells that differ in their reconstruction alone have
    /// the rank of the first of them, so that one task computes their estimate once.
    pub fn ranks(cells: &[CellSettings]) -> Vec<usize> {
        let named: Vec<(String, String)> = cells.iter().map(|cell| (cell.estimate_id(), cell.id())).collect();
        let mut first: HashMap<&str, &str> = HashMap::new();
        for (estimate, id) in &named {
            let least = first.entry(estimate).or_insert(id);
            *least = (*least).min(id);
        }
        let mut order: Vec<(&str, &str)> = first.into_iter().collect();
        order.sort_by_key(|&(_, id)| id);
        let ranks: HashMap<&str, usize> =
            order.into_iter().enumerate().map(|(rank, (estimate, _))| (estimate, rank)).collect();
        named.iter().map(|(estimate, _)| ranks[estimate.as_str()]).collect()
    }

    /// Whether the cells of this rank belong to the task.
    pub fn holds(self, rank: usize) -> bool {
        rank % self.count == self.index
    }

    /// The task that holds the cell of a rank, of `count` tasks.
    pub fn of(rank: usize, count: usize) -> Self {
        Self { index: rank % count, count }
    }

    /// The share that the environment of a Slurm job array names; none outside of one.
    ///
    /// # Errors
    /// One sentence for an array whose numbers are no run from its first to its last.
    pub fn of_slurm(variable: impl Fn(&str) -> Option<String>) -> Result<Option<Self>, String> {
        let number = |name: &str| variable(name).and_then(|text| text.parse::<usize>().ok());
        let (Some(task), Some(count)) = (number("SLURM_ARRAY_TASK_ID"), number("SLURM_ARRAY_TASK_COUNT")) else {
            return Ok(None);
        };
        let (first, last) =
            (number("SLURM_ARRAY_TASK_MIN").unwrap_or(0), number("SLURM_ARRAY_TASK_MAX").unwrap_or(count - 1));
        if last + 1 != first + count || !(first..=last).contains(&task) {
            return Err(format!(
                "job array: expected the tasks {first} to {last} without gaps, found {count} of them; give --shard i/n"
            ));
        }
        Ok(Some(Self { index: task - first, count }))
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.parse::<usize>().ok();
        text.split_once('/')
            .and_then(|(index, count)| Some(Self { index: number(index)?, count: number(count)? }))
            .filter(|shard| shard.index < shard.count)
            .ok_or_else(|| {
                format!("shard {text:?}: expected the number of a task and of all tasks, such as 0/4 to 3/4")
            })
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cell_belongs_to_one_task() {
        for count in 1..=7 {
            for rank in 0..20 {
                let tasks = (0..count).filter(|&index| Shard { index, count }.holds(rank));
                assert_eq!(tasks.collect::<Vec<_>>(), [Shard::of(rank, count).index]);
            }
        }
        for wrong in ["", "4", "4/4", "0/0", "a/2", "-1/2", "1/2/3"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn job_arrays_name_their_tasks() {
        let array = |id: &str, count: &str, first: &str, last: &str| {
            let texts = [id, count, first, last].map(str::to_owned);
            let names = ["ID", "COUNT", "MIN", "MAX"].map(|end| format!("SLURM_ARRAY_TASK_{end}"));
            Shard::of_slurm(move |name| names.iter().position(|known| known == name).map(|at| texts[at].clone()))
        };
        assert_eq!(array("6", "4", "5", "8"), Ok(Some(Shard { index: 1, count: 4 })));
        assert!(array("2", "2", "0", "2").unwrap_err().contains("without gaps"));
        assert_eq!(Shard::of_slurm(|_| None), Ok(None));
    }
}
