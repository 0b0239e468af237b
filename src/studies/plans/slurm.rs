//! Batch scripts of a Slurm job array.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::shard::Shard;
use crate::formats::shell_quoted;

/// Line of the script that holds the number of tasks.
const TASKS: &str = "tasks=";
/// Time that a task may take beyond its estimate, as a factor.
const MARGIN: f64 = 1.5;
/// Shortest time limit of a task.
const SHORTEST: Duration = Duration::from_mins(10);

/// A batch script; its text form is the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BatchScript {
    /// Name of the job.
    pub name: String,
    /// The program.
    pub program: PathBuf,
    /// Folder of the study.
    pub folder: PathBuf,
    /// Number of tasks.
    pub tasks: usize,
    /// Processors of a task.
    pub processors: usize,
    /// Estimated time of the longest task.
    pub time: Duration,
}

/// Number of tasks in the text of a batch script; none in another text.
pub fn shards_of_script(text: &str) -> Option<usize> {
    text.lines().find_map(|line| line.strip_prefix(TASKS))?.trim().parse().ok().filter(|&tasks| tasks > 0)
}

impl BatchScript {
    /// The tasks of an array that hold the cells of these ranks, as Slurm lists them: `0-2,5`.
    pub fn array_of(ranks: impl IntoIterator<Item = usize>, tasks: usize) -> String {
        let mut numbers: Vec<usize> = ranks.into_iter().map(|rank| Shard::of(rank, tasks).index).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let mut runs: Vec<(usize, usize)> = Vec::new();
        for number in numbers {
            match runs.last_mut() {
                Some((_, last)) if *last + 1 == number => *last = number,
                _ => runs.push((number, number)),
            }
        }
        let text = |&(first, last): &(usize, usize)| {
            if first == last { first.to_string() } else { format!("{first}-{last}") }
        };
        runs.iter().map(text).collect::<Vec<_>>().join(",")
    }
}

impl fmt::Display for BatchScript {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, program, folder, tasks, processors, time } = self;
        let limit = time.mul_f64(MARGIN).max(SHORTEST).as_secs().div_ceil(60);
        let (hours, minutes) = (limit / 60, limit % 60);
        writeln!(f, "#!/bin/bash")?;
        writeln!(
            f,
            "# A study as a job array: every task computes its share of the cells and skips those that are done."
        )?;
        writeln!(f, "# Submit it again to resume it; study missing DIR --sbatch lists the tasks that are left.")?;
        writeln!(f, "#SBATCH --job-name={name}")?;
        writeln!(f, "#SBATCH --array=0-{}", tasks - 1)?;
        writeln!(f, "#SBATCH --cpus-per-task={processors}")?;
        writeln!(f, "#SBATCH --mem-per-cpu=2G")?;
        writeln!(
            f,
            "# The estimated time of the longest task is {} min; the limit leaves half as much again, and 10 min at least.",
            time.as_secs().div_ceil(60)
        )?;
        writeln!(f, "#SBATCH --time={hours}:{minutes:02}:00")?;
        writeln!(f, "# A minute before the limit the task keeps the state of its cell and ends.")?;
        writeln!(f, "#SBATCH --signal=USR1@60")?;
        writeln!(f, "#SBATCH --output=\"{}/task-%a.log\"", shell_comment(folder))?;
        writeln!(f)?;
        writeln!(f, "{TASKS}{tasks}")?;
        writeln!(f, "export RAYON_NUM_THREADS=${{SLURM_CPUS_PER_TASK:-{processors}}}")?;
        let quoted = |path: &Path| shell_quoted(&path.display().to_string());
        let (program, folder) = (quoted(program), quoted(folder));
        writeln!(f, "# srun passes signals on to the program.")?;
        writeln!(f, "srun {program} study run {folder} --out {folder} --shard \"$SLURM_ARRAY_TASK_ID/$tasks\"")
    }
}

/// A path in a directive, where a line end would end it.
fn shell_comment(path: &Path) -> String {
    path.display().to_string().replace('\n', " ").replace('%', "%%").replace('"', "\\\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_name_the_tasks_that_are_left() {
        assert_eq!(BatchScript::array_of([0, 4, 8, 1, 2], 4), "0-2");
        assert_eq!(BatchScript::array_of([3, 1, 7], 4), "1,3");
        assert_eq!(BatchScript::array_of([0, 1, 2, 5, 7, 8], 10), "0-2,5,7-8");
        assert_eq!(BatchScript::array_of([], 4), "");
    }

    #[test]
    fn scripts_hold_their_tasks_and_a_limit() {
        let script = BatchScript {
            name: "fig2".into(),
            program: "/opt/lens let/lenslet-studio".into(),
            folder: "/data/it's".into(),
            tasks: 4,
            processors: 2,
            time: Duration::from_mins(100),
        };
        let text = script.to_string();
        assert_eq!(shards_of_script(&text), Some(4));
        for line in [
            "#SBATCH --array=0-3",
            "#SBATCH --time=2:30:00",
            "#SBATCH --output=\"/data/it's/task-%a.log\"",
            "srun '/opt/lens let/lenslet-studio' study run '/data/it'\\''s' --out '/data/it'\\''s' --shard \"$SLURM_ARRAY_TASK_ID/$tasks\"",
        ] {
            assert!(text.lines().any(|of| of == line), "{line} in {text}");
        }
        assert_eq!(shards_of_script("#!/bin/bash\n"), None);
    }
}
