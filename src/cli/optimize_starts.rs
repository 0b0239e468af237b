//! Several starts of `optimize`: their runs, computed here or by the tasks of a job array, and their ranking.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::bail;

use super::choices::about_objects;
use super::optimize_runs::{optimize, start_folder, write};
use super::output::{self, ProgressLine};
use super::stop::{StopSignal, is_stopped};
use crate::design::IdealSettings;
use crate::evaluation::EstimateProgress;
use crate::forward::Design;
use crate::studies::plans::Shard;
use crate::workbench::{IdealRecord, RankedStart, RunQueue, RunStore, Start, score_in_patches, score_whole};

/// Runs from several starts in folders of `out`.
pub(super) struct MultiStart<'a> {
    /// The starts, in their order.
    pub starts: Vec<Start>,
    /// Settings of every run.
    pub settings: &'a IdealSettings,
    /// Folder of all runs.
    pub out: &'a Path,
    /// Store of the ranking, in that folder.
    pub order: &'a RunStore,
    /// Time of each estimate of a score; none for a fixed number of steps.
    pub budget: Option<Duration>,
    /// Signals that stop the command.
    pub stop: &'a StopSignal,
}

/// Results of several starts.
#[derive(Default)]
pub(super) struct Ranking {
    /// Record of the best result; none while starts of other tasks have no result.
    pub record: Option<IdealRecord>,
    /// All results, the best first.
    pub ranked: Vec<RankedStart>,
    /// Number of starts of this command that failed.
    pub failed: usize,
    /// Numbers of the starts without a result, from 1.
    pub waiting: Vec<usize>,
}

impl MultiStart<'_> {
    /// Computes the starts of a share that have no result, each into its folder, and ranks all results where every start has one. A
    /// single task ranks its results without those that failed.
    pub(super) fn rank(&self, shard: Shard) -> anyhow::Result<Ranking> {
        // Other settings in the folder are refused before anything is computed.
        self.gathered()?;
        // Scores of an interrupted command are reused.
        let known = self.known(self.order)?;
        let is_alone = shard.count == 1;
        let mut ranking = Ranking::default();
        let mut records = Vec::new();
        for (at, start) in self.starts.iter().enumerate() {
            if !shard.holds(at) {
                continue;
            }
            let (folder, number) = (start_folder(self.out, at + 1), at + 1);
            let count = self.starts.len();
            output::report(format_args!("{}: {}, start {number} of {count}", folder.display(), start.name));
            match self.result(at, &folder, &known) {
                Ok((record, result)) => {
                    output::report(format_args!("{}: {}", folder.display(), format_result(&result)));
                    records.push((result.name.clone(), record));
                    ranking.ranked.push(result);
                }
                Err(error) if is_stopped(&error) => return Err(error),
                // The results of other starts stay useful.
                Err(error) if count - ranking.failed > 1 => {
                    ranking.failed += 1;
                    output::report(format_args!("{error:#}"));
                }
                Err(error) => return Err(error),
            }
            if is_alone {
                RankedStart::rank(&mut ranking.ranked);
                self.note(at, with_known(&ranking.ranked, &known, &self.starts[number..]))?;
            }
        }
        if !is_alone {
            let failed = ranking.failed;
            (ranking, records) = self.gathered()?;
            ranking.failed = failed;
            if !ranking.waiting.is_empty() {
                return Ok(ranking);
            }
            self.note(self.starts.len() - 1, ranking.ranked.clone())?;
        }
        let best = ranking.ranked.first().map(|best| &best.name);
        ranking.record = records.into_iter().find(|(name, _)| Some(name) == best).map(|(_, record)| record);
        if ranking.record.is_none() {
            bail!("--starts: no run has finished");
        }
        Ok(ranking)
    }

    /// The results of all starts by any task, and their records by name.
    fn gathered(&self) -> anyhow::Result<(Ranking, Vec<(String, IdealRecord)>)> {
        let (mut ranking, mut records) = (Ranking::default(), Vec::new());
        for at in 0..self.starts.len() {
            let folder = start_folder(self.out, at + 1);
            let found = if folder.is_dir() { self.stored(at, &RunStore::in_folder(&folder)?)? } else { None };
            let Some((record, result)) = found else {
                ranking.waiting.push(at + 1);
                continue;
            };
            records.push((result.name.clone(), record));
            ranking.ranked.push(result);
        }
        RankedStart::rank(&mut ranking.ranked);
        Ok((ranking, records))
    }

    /// The run of a start in its folder, and its scores, which are computed unless they are known.
    fn result(&self, at: usize, folder: &Path, known: &[RankedStart]) -> anyhow::Result<(IdealRecord, RankedStart)> {
        let start = &self.starts[at];
        let kept = RunStore::in_folder(folder)?;
        let _lock = kept.lock()?;
        let stored = self.stored(at, &kept)?.map(|(_, result)| result);
        // A finished run is only read, which checks that the objects are the same.
        let record = optimize(&start.design, self.settings, (&kept, folder), self.stop)?;
        write(&record, folder)?;
        let design = Arc::new(record.design());
        let known = known.iter().chain(&stored).filter(|result| result.name == start.name && result.design == design);
        let result = self.scored(start, &design, folder, known.max_by_key(|result| result.is_scored))?;
        let own = RankedStart { record: Some(Arc::new(record.clone())), ..result.clone() };
        let queue = RunQueue::new(vec![start.clone()], self.settings.clone());
        kept.note(&RunQueue { ranked: vec![own], budget_seconds: self.budget_seconds(), ..queue })?;
        Ok((record, result))
    }

    /// The result of a start with all its scores, of which `known` may hold some.
    fn scored(
        &self,
        start: &Start,
        design: &Arc<Design>,
        folder: &Path,
        known: Option<&RankedStart>,
    ) -> anyhow::Result<RankedStart> {
        if let Some(result) = known.filter(|result| result.is_scored) {
            return Ok(result.clone());
        }
        let progress_line = ProgressLine::new();
        let mut on_progress = |progress: &EstimateProgress| {
            progress_line.show(progress.done, progress.total, &progress.step);
            self.stop.check()
        };
        let mut result = if let Some(known) = known {
            known.clone()
        } else {
            let estimate = score_in_patches(design, self.budget, &mut on_progress)
                .map_err(|error| about_objects(design, error))?;
            let (name, design) = (start.name.clone(), Arc::clone(design));
            RankedStart { name, design, estimate, sensor: None, is_scored: false, sensor_failure: None, record: None }
        };
        let scored = score_whole(design, &result.estimate, self.budget, &mut on_progress);
        progress_line.finish();
        match result.set_sensor(scored) {
            Err(error) if error.is_cancelled() => return Err(error.into()),
            Err(error) => output::report(format_args!("{}: no score for the whole sensor: {error}", folder.display())),
            Ok(()) => {}
        }
        Ok(result)
    }

    /// The result that the folder of a start holds, with as many steps as asked for and scores of this time.
    fn stored(&self, at: usize, kept: &RunStore) -> anyhow::Result<Option<(IdealRecord, RankedStart)>> {
        let Some(queue) = kept.last().map(|run| run.queue) else { return Ok(None) };
        if !is_same(&queue, &self.starts[at..=at], self.settings) {
            return Err(self.other_runs());
        }
        let is_done = queue.settings.steps >= self.settings.steps && queue.budget_seconds == self.budget_seconds();
        let result = queue.ranked.into_iter().next().filter(|_| is_done);
        Ok(result.and_then(|mut result| {
            let record = result.record.take()?;
            Some((Arc::unwrap_or_clone(record), result))
        }))
    }

    /// Results in the ranking of an earlier command.
    fn known(&self, order: &RunStore) -> anyhow::Result<Vec<RankedStart>> {
        let Some(last) = order.last().map(|run| run.queue) else { return Ok(Vec::new()) };
        if !is_same(&last, &self.starts, self.settings) {
            return Err(self.other_runs());
        }
        Ok(if last.budget_seconds == self.budget_seconds() { last.ranked } else { Vec::new() })
    }

    fn other_runs(&self) -> anyhow::Error {
        anyhow::anyhow!(
            "{}: expected the starts and settings of the runs that are there, found others; choose another --out",
            self.out.display()
        )
    }

    fn note(&self, at: usize, ranked: Vec<RankedStart>) -> anyhow::Result<()> {
        let begun = RunQueue::new(self.starts.clone(), self.settings.clone());
        Ok(self.order.note(&RunQueue { at, ranked, budget_seconds: self.budget_seconds(), ..begun })?)
    }

    fn budget_seconds(&self) -> Option<f64> {
        self.budget.map(|budget| budget.as_secs_f64())
    }
}

/// The ranking, line by line.
pub(super) fn lines_of_ranked(ranked: &[RankedStart]) -> Vec<String> {
    let line =
        |(place, result): (usize, &RankedStart)| format!("{}. {}: {}", place + 1, result.name, format_result(result));
    ranked.iter().enumerate().map(line).collect()
}

/// Text of a result.
fn format_result(result: &RankedStart) -> String {
    let sensor = result.sensor.as_ref().map_or(String::new(), |sensor| format!("; whole sensor: {}", sensor.summary()));
    format!("{}{sensor}", result.estimate.summary())
}

/// Whether a queue has these starts and settings; the number of starts and steps may differ.
fn is_same(order: &RunQueue, starts: &[Start], settings: &IdealSettings) -> bool {
    let but_steps = |settings: &IdealSettings| IdealSettings { steps: 0, ..settings.clone() };
    but_steps(&order.settings) == but_steps(settings)
        && order.starts.iter().zip(starts).all(|(one, other)| one == other)
}

/// The results, with those in `known` for the starts `ahead`.
fn with_known(ranked: &[RankedStart], known: &[RankedStart], ahead: &[Start]) -> Vec<RankedStart> {
    let is_ahead = |result: &&RankedStart| ahead.iter().any(|start| start.name == result.name);
    let mut results: Vec<RankedStart> = ranked.iter().chain(known.iter().filter(is_ahead)).cloned().collect();
    RankedStart::rank(&mut results);
    results
}
