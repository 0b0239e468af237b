//! Scores of a run's result beside its start and the heuristic layouts, all by one estimator.

use std::time::Duration;

use crate::design::Checkpoint;
use crate::evaluation::estimation::read;
use crate::evaluation::progress::EstimateProgress;
use crate::evaluation::{DensityModel, EstimateRequest, EvaluationError, estimate};
use crate::forward::{Design, ForwardModel};
use crate::information::{EngineChoice, Estimate, Estimator, MAX_PATCH_PIXELS};
use crate::optics::{Encoder, heuristic_layout};
use crate::progress::Progress;
use crate::studies::{StudyCell, StudyDesign, StudyKind, StudyObjects, StudyRecord, StudySettings};
use crate::workbench::runs::design_run::score_request;
use crate::workbench::runs::record::{IdealRecord, patches_of};

/// Names of the result and the start of a run among the masks that they are compared with.
const RESULT: &str = "design";
const START: &str = "start";
/// Side of the published patch, px.
const PATCH: usize = 32;

/// Score of a run's result in patches of 32 x 32 px, or as large as the measurements allow, by separate models. Their fits have this
/// time, or a fixed number of steps so that the estimate can be reproduced.
///
/// # Errors
/// As [`estimate`].
pub fn score_in_patches(
    design: &Design,
    budget: Option<Duration>,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Estimate, EvaluationError> {
    let patch = ForwardModel::of_objects(design, read(design, progress)?)?.patch(Some((PATCH, PATCH)));
    estimate(design, &score_within(design, Some(patch), budget), progress)
}

/// [`score_request`] with fits of this time, where there is one.
fn score_within(design: &Design, patch: Option<(usize, usize)>, budget: Option<Duration>) -> EstimateRequest {
    let request = score_request(design, patch);
    let timed = budget.map(|_| DensityModel::new(scoring_estimator(design), budget, EngineChoice::default()));
    EstimateRequest { model: timed.unwrap_or(request.model), ..request }
}

/// The same score for whole measurements, where they are larger than the patches of `patches` and no larger than models can be.
///
/// # Errors
/// As [`estimate`].
pub fn score_whole(
    design: &Design,
    patches: &Estimate,
    budget: Option<Duration>,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Option<Estimate>, EvaluationError> {
    let whole = ForwardModel::of_objects(design, read(design, progress)?)?.patch(None);
    if whole == patches.patch.into() || whole.0 * whole.1 > MAX_PATCH_PIXELS {
        return Ok(None);
    }
    estimate(design, &score_within(design, None, budget), progress).map(Some)
}

/// The study that compares a run's result with its start and with heuristic layouts of the numbers of lenslets in `against`, all of the
/// throughput of the start. Patches are
/// of 32 x 32 px, as far as the measurements are as large; the whole sensor is added where a model can be fitted to it. Each estimate has
/// `budget`. Estimates are brackets where the prior of the objects is known, live estimates otherwise.
///
/// # Errors
/// Where the objects can no longer be read.
pub fn score_settings(
    record: &IdealRecord,
    against: &[usize],
    budget: Duration,
) -> Result<StudySettings, EvaluationError> {
    let start = &record.start;
    let forward = ForwardModel::open(start)?;
    let (patch, sensor) = (forward.patch(Some((PATCH, PATCH))), forward.patch(None));
    let patches = match (patch == sensor, sensor.0 * sensor.1 <= MAX_PATCH_PIXELS) {
        (true, true) => vec![None],
        (false, true) => vec![Some(patch), None],
        (_, false) => vec![Some(patch)],
    };
    let against = against.iter().enumerate().filter(|&(index, count)| !against[..index].contains(count));
    let named = |name: &str, encoder: &Encoder| StudyDesign { name: name.into(), encoder: encoder.clone() };
    let begun = record.checkpoints.first().map_or_else(|| start.encoder.clone(), mask_of);
    let designs = [named(RESULT, &record.result), named(START, &begun)];
    // Masks are compared at the same light.
    let throughput = start.encoder.throughput();
    let (rows, cols) = start.encoder.grid();
    let layout = |count| {
        StudyDesign::new(Encoder::Lenslets(heuristic_layout(count).on_grid(rows, cols)).with_throughput(throughput))
    };
    Ok(StudySettings {
        kind: StudyKind::Grid,
        objects: vec![StudyObjects::new(start.objects.clone(), None)],
        designs: designs.into_iter().chain(against.map(|(_, &count)| layout(count))).collect(),
        patches,
        estimator: scoring_estimator(start),
        budget_seconds: Some(budget.as_secs_f64()),
        patches_train: 0,
        patches_test: 600,
        fresh: false,
        noise: start.noise,
        mean_photons: start.mean_photons,
        bias_photons: start.bias_photons,
        seed: start.seed,
        field: start.field,
        placement: start.placement,
    })
}

/// Whether a study of [`score_settings`] has this mask as its result.
pub(super) fn matches_mask(study: &StudyRecord, result: &Encoder) -> bool {
    study.settings.designs.first().is_some_and(|design| design.encoder == *result)
}

/// Estimator that scores the masks of a design: a bracket where the prior of its objects is known.
pub(super) fn scoring_estimator(design: &Design) -> Estimator {
    if design.objects.is_beads() { Estimator::Bracket } else { Estimator::Causal }
}

fn mask_of(checkpoint: &Checkpoint) -> Encoder {
    Encoder::Lenslets(checkpoint.array.clone())
}

/// Scores of result and start by a study of [`score_settings`], a sentence for each patch.
pub fn result_lines(study: &StudyRecord) -> Vec<String> {
    let of_patch = |patch: Option<(usize, usize)>| {
        let worth = |name: &str| {
            let cell = study.cells.iter().find(|cell| cell.patch == patch && cell.design == name)?;
            worth_of(cell)
        };
        let start = worth(START).map_or(String::new(), |start| format!("; its start {start}"));
        Some(format!("{}: {} bits per pixel{start}", patches_of(patch), worth(RESULT)?))
    };
    study.settings.patches.iter().filter_map(|&patch| of_patch(patch)).collect()
}

/// Comparison of the result with its start and heuristic layouts by a study of [`score_settings`], a sentence for each bound and patch;
/// none for a patch where estimates are missing.
pub fn comparison_summary(study: &StudyRecord) -> Vec<String> {
    let mut sentences = Vec::new();
    for &patch in &study.settings.patches {
        let place = patches_of(patch);
        let cells: Vec<&StudyCell> = study.cells.iter().filter(|cell| cell.patch == patch).collect();
        let Some(result) = cells.iter().find(|cell| cell.design == RESULT) else { continue };
        let start = cells.iter().copied().find(|cell| cell.design == START);
        sentences.extend(start.and_then(|start| over_start(result, start)).map(|gain| format!("{place}, {gain}")));
        // Masks that are still to be estimated may be the best.
        if cells.len() < study.settings.designs.len() {
            continue;
        }
        let size = |cell: &StudyCell| cell.estimate.as_ref().map(|estimate| estimate.patch);
        // On a grid of another size they give other measurements, whose bits per pixel cannot be compared.
        let is_alike = |cell: &StudyCell| size(cell).is_none_or(|patch| size(result).is_none_or(|of| of == patch));
        let is_layout = |cell: &&StudyCell| cell.design != RESULT && cell.design != START;
        let layouts: Vec<&StudyCell> = cells.iter().copied().filter(is_layout).filter(|cell| is_alike(cell)).collect();
        sentences.extend(over_layouts_by_density(result, &layouts).map(|gain| format!("{place}, {gain}")));
        if result.ceiling().zip(result.model_bits()).is_some_and(|(ceiling, bits)| bits > ceiling) {
            sentences.push(format!("{place}: the density model lies above what the objects hold; it proves nothing"));
        }
        sentences.extend(over_layouts_by_lower(result, &layouts).map(|gain| format!("{place}, {gain}")));
    }
    sentences
}

/// Gain of a result over the mask that its run started from.
fn over_start(result: &StudyCell, start: &StudyCell) -> Option<String> {
    if let Some(((lower, _), (before, _))) = lower_of(result).zip(lower_of(start)) {
        let judged = judged(result, &[start], "its start cannot tell as much");
        return Some(format!("lower bound: {lower:.3}, its start {before:.3}, {:+.3}; it {judged}", lower - before));
    }
    let (bits, before) = (result.model_bits()?, start.model_bits()?);
    let gain = gain(result, start)?;
    Some(format!("density model: {bits:.3} bits per pixel, its start {before:.3}, {gain}"))
}

fn over_layouts_by_density(result: &StudyCell, layouts: &[&StudyCell]) -> Option<String> {
    let bits = result.model_bits()?;
    let all = layouts.iter().filter_map(|cell| Some((cell.model_bits()?, *cell)));
    let (best, cell) = all.max_by(|one, other| one.0.total_cmp(&other.0))?;
    let (name, gain) = (&cell.design, gain(result, cell)?);
    Some(format!("density model: {bits:.3} bits per pixel, best heuristic {best:.3} ({name}), {gain}"))
}

fn over_layouts_by_lower(result: &StudyCell, layouts: &[&StudyCell]) -> Option<String> {
    let (lower, _) = lower_of(result)?;
    let all = layouts.iter().filter_map(|cell| Some((lower_of(cell)?.0, *cell)));
    let (best, cell) = all.max_by(|one, other| one.0.total_cmp(&other.0))?;
    let (name, judged) = (&cell.design, judged(result, layouts, "no heuristic mask can tell as much"));
    Some(format!("lower bound: {lower:.3}, best heuristic {best:.3} ({name}), {:+.3}; it {judged}", lower - best))
}

/// Verdict on the lower bound of a result: whether it is above all upper bounds of the others, or above their lower bounds.
fn judged(result: &StudyCell, others: &[&StudyCell], proof: &str) -> String {
    let Some((_, [low, _])) = lower_of(result) else { return "does not confirm a gain".into() };
    // One that could not be estimated may be the best.
    if others.iter().all(|other| highest_of(other).is_some_and(|highest| low > highest)) {
        format!("proves the gain: {proof}")
    } else if others.iter().filter_map(|other| lower_of(other)).all(|(_, [_, high])| low > high) {
        "confirms the gain".into()
    } else {
        "does not confirm a gain".into()
    }
}

/// Information gain of a result over another mask by the density model, with what makes it doubtful.
fn gain(result: &StudyCell, other: &StudyCell) -> Option<String> {
    let gain = result.model_bits()? - other.model_bits()?;
    let (words, doubt) = match &other.difference_to_reference {
        Some(paired) => {
            let [low, high] = paired.interval_95;
            let words = format!("{gain:+.3} ({low:+.3} to {high:+.3}, by the same test patches)");
            (words, (!paired.is_clear()).then_some("which may be none, and "))
        }
        None => (format!("{gain:+.3}"), overlap(result, other).then_some("within their intervals, and ")),
    };
    Some(match lower_of(result) {
        Some(_) => words,
        None => format!("{words}; {}only upper bounds are known", doubt.unwrap_or_default()),
    })
}

/// Score of a mask, for people, in bits per pixel.
fn worth_of(cell: &StudyCell) -> Option<String> {
    let estimate = cell.estimate.as_ref()?;
    let [low, high] = estimate.interval_95;
    Some(match estimate.ends() {
        Some(ends) => ends.map(|(bits, [low, high])| format!("{bits:.3} ({low:.3} to {high:.3})")).join(" to "),
        None => format!("at most {:.3} ({low:.3} to {high:.3})", estimate.bits_per_pixel),
    })
}

/// Whether the intervals of two estimates have numbers in common.
fn overlap(one: &StudyCell, other: &StudyCell) -> bool {
    let interval = |cell: &StudyCell| cell.estimate.as_ref().map(|estimate| estimate.interval_95);
    interval(one).zip(interval(other)).is_some_and(|([a, b], [c, d])| a <= d && c <= b)
}

fn lower_of(cell: &StudyCell) -> Option<(f64, [f64; 2])> {
    let bracket = cell.estimate.as_ref()?.bracket.as_ref()?;
    Some((bracket.lower?, bracket.lower_interval_95?))
}

/// Upper end of the interval of a mask's upper bound.
fn highest_of(cell: &StudyCell) -> Option<f64> {
    let bracket = cell.estimate.as_ref()?.bracket.as_ref()?;
    Some(bracket.upper_interval_95[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::{IdealOptimizer, IdealSettings, Objective, Preset};
    use crate::formats::write_array;
    use crate::forward::open_set;
    use crate::information::PairedDifference;
    use crate::objects::{ObjectOptions, ObjectSet, ObjectSource};
    use crate::optics::heuristic_layout;
    use crate::sensor::Noise;
    use crate::studies::{Study, StudyEvent};
    use ndarray::Array3;
    use std::ops::ControlFlow;

    #[test]
    fn measurements_too_large_for_a_model_are_scored_in_patches_alone() {
        let folder = tempfile::tempdir().unwrap();
        let with_field = |side: usize| {
            let path = folder.path().join(format!("{side}.npy"));
            let objects = Array3::from_shape_fn((20, side, side), |(n, r, c)| ((n * 5 + r * c) % 7) as f32);
            write_array(&path, objects.view()).unwrap();
            let design = Design { objects: ObjectSource::Stack(path), ..Design::default() };
            let set = open_set(&design).unwrap();
            let start = design.encoder.lenslets().unwrap();
            let settings =
                IdealSettings { patch: Some((6, 6)), ..IdealSettings::new(Preset::Default, Objective::Density, 1) };
            let forward = ForwardModel::of_objects(&design, set.clone()).unwrap();
            let record =
                IdealRecord::new(&design, &IdealOptimizer::new(&forward, start, design.limits, settings).unwrap());
            score_settings(&record, &[1], Duration::from_secs(1)).unwrap().patches
        };
        // A mask of 32 px leaves 90 x 90 = 8,100 px of it, and 91 x 91 = 8,281.
        assert_eq!(with_field(121), [Some((32, 32)), None]);
        assert_eq!(with_field(122), [Some((32, 32))]);
    }

    #[test]
    fn a_result_is_judged_by_density_and_by_lower_bound() {
        let design = Design { encoder: Encoder::Lenslets(heuristic_layout(2)), ..Design::default() };
        let set = ObjectSet::open(&design.objects, &ObjectOptions::default()).unwrap();
        let forward = ForwardModel::new(set.clone(), (32, 32), 10.0, Noise::Shot).unwrap();
        let settings =
            IdealSettings { patch: Some((6, 6)), ..IdealSettings::new(Preset::Default, Objective::Density, 1) };
        let ideal = IdealOptimizer::new(&forward, &heuristic_layout(2), design.limits, settings).unwrap();
        let mut settings =
            score_settings(&IdealRecord::new(&design, &ideal), &[1, 3, 1], Duration::from_millis(300)).unwrap();
        assert_eq!((settings.estimator, settings.cells()), (Estimator::Bracket, 8));
        settings.patches = vec![Some((6, 6))];
        settings.patches_test = 20;
        let folder = tempfile::tempdir().unwrap();
        let mut study = Study::open(settings, folder.path()).unwrap();
        let mut done = 0;
        study
            .run(&mut |event: &StudyEvent<'_>| {
                done += usize::from(matches!(event, StudyEvent::Done { .. }));
                ControlFlow::Continue(())
            })
            .unwrap();
        assert_eq!(done, 4);
        let mut record = study.record().clone();
        let summary = comparison_summary(&record).join("\n");
        let mut partial = record.clone();
        partial.cells.retain(|cell| cell.design != "heuristic:3");
        let of_start = comparison_summary(&partial);
        assert!(of_start.len() == 1 && of_start[0].contains(", its start 0."), "a missing layout may be the best");
        assert!(
            summary.contains("6 x 6 px patches, density model") && summary.contains("6 x 6 px patches, lower bound"),
            "{summary}"
        );
        // Bounds that are far apart are distinguished.
        let mut set = |name: &str, bits: f64| {
            let cell = record.cells.iter_mut().find(|cell| cell.design == name).unwrap();
            let bracket = cell.estimate.as_mut().unwrap().bracket.as_mut().unwrap();
            (bracket.lower, bracket.lower_interval_95) = (Some(bits), Some([bits - 0.01, bits + 0.01]));
        };
        set("heuristic:1", 0.1);
        set("heuristic:3", 0.2);
        set("design", 0.205);
        let judged = |record: &StudyRecord| comparison_summary(record).last().unwrap().clone();
        assert!(judged(&record).ends_with("does not confirm a gain"), "{}", judged(&record));
        let mut set = |name: &str, bits: f64| {
            let cell = record.cells.iter_mut().find(|cell| cell.design == name).unwrap();
            let bracket = cell.estimate.as_mut().unwrap().bracket.as_mut().unwrap();
            (bracket.lower, bracket.lower_interval_95) = (Some(bits), Some([bits - 0.01, bits + 0.01]));
        };
        set("design", 50.0);
        assert!(judged(&record).contains("proves the gain") && judged(&record).contains("(heuristic:3)"));
        // A mask that could not be estimated may have more information.
        record.cells.iter_mut().find(|cell| cell.design == "heuristic:1").unwrap().estimate = None;
        assert!(judged(&record).ends_with("confirms the gain"), "{}", judged(&record));

        let three = record.cells.iter_mut().find(|cell| cell.design == "heuristic:3").unwrap();
        assert!(three.difference_to_reference.take().is_some(), "both were scored on the same patches");
        // For objects of unknown entropy there is one number for each mask.
        let mut upper = |name: &str, bits: f64| {
            let estimate = record.cells.iter_mut().find(|cell| cell.design == name).unwrap().estimate.as_mut().unwrap();
            (estimate.bracket, estimate.bits_per_pixel) = (None, bits);
            estimate.interval_95 = [bits - 0.01, bits + 0.01];
        };
        upper("heuristic:3", 0.2);
        upper("design", 0.215);
        let words =
            "0.215 bits per pixel, best heuristic 0.200 (heuristic:3), +0.015; within their intervals, and only";
        assert!(judged(&record).contains(words), "{}", judged(&record));
        let mut upper = |name: &str, bits: f64| {
            let estimate = record.cells.iter_mut().find(|cell| cell.design == name).unwrap().estimate.as_mut().unwrap();
            estimate.interval_95 = [bits - 0.001, bits + 0.001];
        };
        upper("design", 0.215);
        upper("heuristic:3", 0.2);
        assert!(judged(&record).ends_with("+0.015; only upper bounds are known"), "{}", judged(&record));
        // On the same patches the difference is known better, or not.
        let mut summary_with = |interval_95| {
            let cell = record.cells.iter_mut().find(|cell| cell.design == "heuristic:3").unwrap();
            cell.difference_to_reference = Some(PairedDifference { bits_per_pixel: 0.015, interval_95 });
            judged(&record)
        };
        let clear = summary_with([0.012, 0.018]);
        assert!(
            clear.ends_with("+0.015 (+0.012 to +0.018, by the same test patches); only upper bounds are known"),
            "{clear}"
        );
        let doubtful = summary_with([-0.002, 0.032]);
        assert!(
            doubtful.ends_with("by the same test patches); which may be none, and only upper bounds are known"),
            "{doubtful}"
        );
    }
}
