//! Plans, their cells, shards and figures, with estimates of fractions of a second.

use std::ops::ControlFlow;
use std::path::Path;

use super::axes::{Axes, Axis};
use super::cell::{CellSettings, StudyMask};
use super::estimates::EstimateSettings;
use super::facet::Facet;
use super::figure::{Quantity, figure_of};
use super::folder::{CellState, StudyFolder};
use super::named::{NamedPlan, named_plans};
use super::paint::{png, svg};
use super::plan::{Plan, PlotSettings};
use super::reconstruction::ReconstructionSettings;
use super::run::{PlanEvent, run_cells};
use super::shard::Shard;
use super::size::SizeChoice;
use super::table::{CSV_HEADER, StudyTable};
use crate::formats::json_of;
use crate::information::Estimator;
use crate::objects::ObjectSource;
use crate::progress::CancelToken;
use crate::reconstruction::DecoderKind;
use crate::sensor::PatchSize;
use crate::studies::error::StudyError;

/// Two layouts imaging beads of two densities.
pub(super) fn small() -> Plan {
    let mask = vec![StudyMask::heuristic(1), StudyMask::heuristic(4)];
    let axes = Axes {
        patch: vec![PatchSize::Shape(6, 6)],
        estimator: vec![Estimator::GaussianStationary],
        ..Axes::new(mask, vec!["beads:0.008".into(), "beads:0.05".into()])
    };
    let plot = PlotSettings {
        x: Facet::Density,
        lines: Facet::Axis(Axis::Mask),
        panels: None,
        logarithmic: true,
        optima: true,
        scatter: false,
    };
    let estimates = EstimateSettings { patches_train: 200, patches_test: 40, ..EstimateSettings::default() };
    Plan { estimates, ..Plan::new("small", "Two layouts", axes, plot) }
}

/// Runs a share of a plan; returns the number of computed cells.
pub(super) fn computed(folder: &StudyFolder, shard: Shard) -> usize {
    let summary = run_cells(folder, shard, &mut CancelToken::new()).unwrap();
    assert_eq!(summary.failed, 0);
    summary.cells - summary.before
}

pub(super) fn begun(plan: Plan, path: &Path) -> StudyFolder {
    StudyFolder::begin(plan, path).unwrap()
}

fn rows(folder: &StudyFolder) -> Vec<Vec<String>> {
    StudyTable::new(folder, &folder.states().unwrap()).csv_rows()
}

pub(super) fn sentence<T>(result: Result<T, StudyError>) -> String {
    result.err().unwrap().to_string()
}

#[test]
fn named_plans_are_read_from_their_files_again() {
    for NamedPlan { plan, .. } in named_plans() {
        assert_eq!(Plan::from_toml(&plan.to_toml().unwrap()).unwrap(), plan);
        // The published image sets have no file yet.
        let mut plan = plan;
        for name in ["mnist", "fashion", "cifar10"] {
            plan.sets.insert(name.into(), ObjectSource::Idx("a.idx".into()));
        }
        let cells = plan.cells().unwrap();
        assert!(Some(cells.len()) == plan.axes.size() || plan.left_out().unwrap().is_some());
        let mut ids: Vec<String> = cells.iter().map(CellSettings::id).collect();
        ids.sort();
        ids.dedup();
        assert_eq!(ids.len(), cells.len(), "{}", plan.name);
        let quick = plan.quick().cells().unwrap();
        assert!(quick.len() <= cells.len() && quick[0].mask == cells[0].mask);
    }
    let fig2 = NamedPlan::find("fig2").unwrap().plan;
    assert_eq!((fig2.cells().unwrap().len(), fig2.quick().cells().unwrap().len()), (216, 60));
    // A first look at depth has every number of planes at both densities.
    let s2 = NamedPlan::find("s2").unwrap().plan.quick();
    assert_eq!((s2.axes.mask.len(), s2.axes.objects.len()), (3, 10));
}

#[test]
fn zipped_axes_advance_together() {
    let mut plan = small();
    plan.axes.zip = vec![vec![Axis::Mask, Axis::Objects]];
    let cells = plan.cells().unwrap();
    let names: Vec<String> = cells.iter().map(|cell| format!("{} {}", cell.mask, cell.objects)).collect();
    assert_eq!(names, ["heuristic:1 beads:0.008", "heuristic:4 beads:0.05"]);
    plan.axes.objects.pop();
    assert!(sentence(plan.cells()).contains("equally many values"));
}

#[test]
fn field_and_grid_are_axes() {
    let folder = tempfile::tempdir().unwrap();
    let mut plan = small();
    plan.axes.objects.truncate(1);
    plan.axes.mask = vec![StudyMask::heuristic(4)];
    plan.axes.grid = vec![SizeChoice::Usual, SizeChoice::Shape(16, 16), SizeChoice::Shape(100, 100)];
    let study = begun(plan.clone(), folder.path());
    // Cells of the usual sizes have the file that they had before there were sizes.
    let text = json_of(&study.cells()[0]).to_string();
    assert!(!text.contains("grid") && !text.contains("field"), "{text}");
    let shapes = study.cells().iter().map(|cell| {
        let design = cell.design(cell.open_mask().unwrap().encoder);
        (design.encoder.grid(), design.field)
    });
    let expected = [((32, 32), (96, 96)), ((16, 16), (96, 96)), ((100, 100), (300, 300))];
    assert_eq!(shapes.collect::<Vec<_>>(), expected);
    plan.axes.grid.pop();
    plan.axes.field = vec!["48x64".parse().unwrap()];
    let sized = tempfile::tempdir().unwrap();
    let study = begun(plan.clone(), sized.path());
    assert_eq!(computed(&study, Shard::default()), 2);
    let rows = rows(&study);
    let column = |name: &str| CSV_HEADER.iter().position(|column| *column == name).unwrap();
    assert_eq!((rows[1][column("field")].as_str(), rows[1][column("grid")].as_str()), ("48x64", "16"));
    // No published value is one of another size.
    assert_eq!(rows[1][column("published")], "");
    let states = study.states().unwrap();
    assert!(StudyTable::new(&study, &states).markdown().contains("field of 48x64 px"));
    assert!(study.cells()[1].name().contains("field 48 x 64 px, grid 16 x 16 px"));
    for (field, grid, part) in [("16", "usual", "field of the objects"), ("usual", "8x16", "a square")] {
        plan.axes.field = vec![field.parse().unwrap()];
        plan.axes.grid = vec![grid.parse().unwrap()];
        let found = sentence(plan.cells());
        assert!(found.contains(part), "{found}");
    }
    assert!("0".parse::<SizeChoice>().unwrap_err().contains("or usual"));
}

#[test]
fn plans_that_cannot_be_computed_are_refused_in_one_sentence() {
    let linear = ReconstructionSettings::of(DecoderKind::Linear);
    let refused = |change: &dyn Fn(&mut Plan)| {
        let mut plan = small();
        change(&mut plan);
        sentence(plan.cells())
    };
    for (message, part) in [
        (refused(&|plan| plan.axes.mask.clear()), "axis mask: expected at least one value, found none"),
        (refused(&|plan| plan.axes.mask.push(StudyMask::heuristic(4))), "heuristic:4 twice"),
        (refused(&|plan| plan.axes.seed = (0..1_000_000).collect()), "at most 100000 cells, found 4000000"),
        (refused(&|plan| plan.axes.photons = vec![-1.0]), "mean_photons"),
        (refused(&|plan| plan.axes.noise = vec![crate::sensor::Noise::None]), "without noise"),
        (refused(&|plan| plan.axes.mask = vec!["ideal:diffuser:8".parse().unwrap()]), "a start with lenslets"),
        (
            refused(&|plan| {
                plan.axes.objects = vec!["beads-max:0.02".into()];
                plan.axes.photons = vec![50.0, 100.0];
            }),
            "sets its photons itself",
        ),
        (refused(&|plan| plan.axes.objects = vec!["mnist".into()]), "--set mnist=idx:FILE"),
        (refused(&|plan| plan.axes.objects = vec!["pearls:1".into()]), "objects \"pearls:1\""),
        (refused(&|plan| plan.axes.patch = vec![PatchSize::Shape(66, 8)]), "the sensor of 65 x 65 px, found 66 x 8"),
        (refused(&|plan| plan.estimates.patches_test = 1), "patches_test: expected 2"),
        (refused(&|plan| plan.estimates.seconds = Some(f64::NAN)), "seconds: expected 0.001 s"),
        (
            refused(&|plan| plan.reconstruction = Some(ReconstructionSettings { test_objects: 1, ..linear })),
            "test_objects",
        ),
        (
            refused(&|plan| {
                plan.axes.objects = vec!["images:photos".into()];
                plan.reconstruction = Some(ReconstructionSettings::of(DecoderKind::Posterior));
            }),
            "decoder posterior: expected beads",
        ),
    ] {
        assert!(message.contains(part) && !message.contains('\n'), "{part} in {message}");
    }
    let text = small().to_toml().unwrap();
    for (from, to, part) in [
        ("mask = ", "masks = ", "unknown field `masks`"),
        ("lenslet-studio/plan", "lenslet-studio/design", "format \"lenslet-studio/design\""),
        ("format_version = 1", "format_version = 9", "newer Lenslet Studio"),
        ("heuristic:1", "heuristic:77", "1 to 9"),
        ("[plot]", "[plot", "in line"),
        ("x = \"density\"", "x = \"colour\"", "colour"),
    ] {
        let found = Plan::from_toml(&text.replacen(from, to, 1)).unwrap_err();
        assert!(found.contains(part) && !found.contains('\n'), "{part} in {found}");
    }
}

#[test]
fn shards_fill_one_folder_as_one_machine_does() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let alone = begun(small(), one.path());
    assert_eq!(computed(&alone, Shard::default()), 4);
    let shared = begun(small(), two.path());
    let shards = ["0/3", "1/3", "2/3"].map(|text| text.parse().unwrap());
    let counts = shards.map(|shard| computed(&shared, shard));
    assert_eq!(counts.iter().sum::<usize>(), 4);
    assert!(counts.iter().all(|&count| count > 0));
    assert_eq!(rows(&alone), rows(&shared));
    assert!(rows(&alone).iter().all(|row| !row[11].is_empty()));
    // Nothing is computed twice, and the folder may be opened without its plan.
    assert_eq!(computed(&StudyFolder::open(two.path()).unwrap(), Shard::default()), 0);
}

#[test]
fn files_that_are_cut_old_or_of_another_cell_are_computed_again() {
    let place = tempfile::tempdir().unwrap();
    let folder = begun(small(), place.path());
    computed(&folder, Shard::default());
    let before = rows(&folder);
    let text = |index: usize| std::fs::read_to_string(folder.cell_file(index)).unwrap();
    std::fs::write(folder.cell_file(0), &text(0)[..400]).unwrap();
    std::fs::write(folder.cell_file(1), text(1).replacen("\"format_version\": 1", "\"format_version\": 7", 1)).unwrap();
    std::fs::write(folder.cell_file(2), text(3)).unwrap();
    let states = folder.states().unwrap();
    let reasons: Vec<&str> = states.iter().filter_map(CellState::failure).collect();
    assert_eq!(reasons.len(), 3);
    assert!(
        reasons[0].contains("run the study again")
            && reasons[1].contains("newer")
            && reasons[2].contains("found another"),
        "{reasons:?}"
    );
    assert!(StudyTable::new(&folder, &states).markdown().contains("3 unusable"));
    assert_eq!(computed(&folder, Shard::default()), 3);
    assert_eq!(rows(&folder), before);
}

#[test]
fn other_plans_are_kept_out_of_a_folder() {
    let place = tempfile::tempdir().unwrap();
    begun(small(), place.path());
    let mut other = small();
    other.axes.seed = vec![2];
    assert!(sentence(StudyFolder::begin(other.clone(), place.path())).contains("other values of seed"));
    // It may grow, and then shrinks no more.
    other.axes.seed = vec![1, 2];
    assert_eq!(begun(other, place.path()).cells().len(), 8);
    assert!(sentence(StudyFolder::begin(small(), place.path())).contains("other values of seed"));
    let place = tempfile::tempdir().unwrap();
    begun(small(), place.path());
    // A new title is no other plan.
    begun(Plan { title: "Two".into(), ..small() }, place.path());
    let empty = tempfile::tempdir().unwrap();
    assert!(sentence(StudyFolder::open(empty.path())).contains("no plan.toml"));
    std::fs::write(empty.path().join("study.json"), "{}").unwrap();
    assert!(sentence(StudyFolder::begin(small(), empty.path())).contains("earlier version"));
}

#[test]
fn a_stopped_study_keeps_its_cells_and_goes_on() {
    let place = tempfile::tempdir().unwrap();
    let folder = begun(small(), place.path());
    let mut left = Vec::new();
    let stopped = run_cells(&folder, Shard::default(), &mut |event: &PlanEvent<'_>| match event {
        PlanEvent::Done { number: 2, .. } => ControlFlow::Break(()),
        PlanEvent::Step { left: time, .. } => {
            left.push(*time);
            ControlFlow::Continue(())
        }
        PlanEvent::Done { .. } => ControlFlow::Continue(()),
    });
    assert!(matches!(stopped, Err(StudyError::Cancelled)) && !left.is_empty());
    let done = folder.states().unwrap().iter().filter(|state| state.done().is_some()).count();
    assert_eq!((done, computed(&folder, Shard::default())), (2, 2));
}

#[test]
fn a_cell_that_fails_says_why_and_harms_no_other() {
    let place = tempfile::tempdir().unwrap();
    let mut plan = small();
    plan.axes.mask.push(format!("psf:{}", place.path().join("none.png").display()).parse().unwrap());
    plan.axes.objects.truncate(1);
    let folder = begun(plan, place.path());
    let summary = run_cells(&folder, Shard::default(), &mut CancelToken::new()).unwrap();
    assert_eq!((summary.cells, summary.failed), (3, 1));
    let states = folder.states().unwrap();
    assert!(states[2].failure().is_some_and(|failure| failure.contains("none.png")));
    assert!(StudyTable::new(&folder, &states).markdown().contains("failed: beads:0.008, psf:"));
    let again = run_cells(&folder, Shard::default(), &mut CancelToken::new()).unwrap();
    assert_eq!((again.before, again.failed), (2, 1));
}

#[test]
fn results_of_files_that_changed_are_computed_again() {
    let place = tempfile::tempdir().unwrap();
    let objects = place.path().join("objects.npy");
    let stack =
        |scale: f32| ndarray::Array3::from_shape_fn((4, 64, 64), |(n, row, col)| scale * ((n + row * col) % 7) as f32);
    crate::formats::write_array(&objects, stack(1.0).view()).unwrap();
    let mut plan = small();
    plan.axes.objects = vec![format!("stack:{}", objects.display())];
    plan.axes.mask.truncate(1);
    let folder = begun(plan, &place.path().join("out"));
    assert_eq!((computed(&folder, Shard::default()), computed(&folder, Shard::default())), (1, 0));
    crate::formats::write_array(&objects, stack(1.5).view()).unwrap();
    assert_eq!(computed(&folder, Shard::default()), 1);
}

#[test]
fn figures_hold_lines_optima_and_published_values() {
    let place = tempfile::tempdir().unwrap();
    let mut plan = small();
    plan.axes.patch = vec![PatchSize::Shape(32, 32)];
    plan.estimates = EstimateSettings { patches_train: 60, patches_test: 20, ..plan.estimates };
    let folder = begun(plan, place.path());
    let empty = figure_of(folder.plan(), folder.cells(), &folder.states().unwrap());
    assert!(empty.panels[0].series.iter().all(|series| series.points.is_empty()));
    assert!(!svg(&empty).unwrap().contains("NaN"));
    computed(&folder, Shard::default());
    let figure = figure_of(folder.plan(), folder.cells(), &folder.states().unwrap());
    let [panel] = figure.panels.as_slice() else { panic!("{figure:?}") };
    let names: Vec<&str> = panel.series.iter().map(|series| series.name.as_str()).collect();
    assert_eq!((names, figure.logarithmic), (vec!["heuristic:1", "heuristic:4"], true));
    let four = &panel.series[1];
    assert_eq!(four.points.iter().map(|point| point.published).collect::<Vec<_>>(), [Some(0.3138), Some(0.5661)]);
    let (best, bits) = four.optimum().unwrap();
    assert!(best.tamura.is_some() && four.points.iter().all(|point| point.lower.unwrap() <= bits));
    let text = svg(&figure).unwrap();
    for part in ["Two layouts", "mask", "heuristic:4", "beads per object pixel", "published", "optimum of a line"] {
        assert!(text.contains(part), "{part}");
    }
    let image = png(&figure).unwrap();
    assert!(image.dim().2 == 3 && image.iter().any(|&value| value < 100) && image[[0, 0, 0]] == 255);
}

#[test]
fn image_quality_has_panels_of_its_own() {
    let place = tempfile::tempdir().unwrap();
    let mut plan = small();
    plan.axes.objects.truncate(1);
    plan.reconstruction =
        Some(ReconstructionSettings { test_objects: 3, ..ReconstructionSettings::of(DecoderKind::Linear) });
    let text = plan.to_toml().unwrap();
    assert!(text.contains("[reconstruction]") && !text.contains("training"), "{text}");
    let folder = begun(plan, place.path());
    computed(&folder, Shard::default());
    let states = folder.states().unwrap();
    let figure = figure_of(folder.plan(), folder.cells(), &states);
    let [information, psnr] = figure.panels.as_slice() else { panic!("{figure:?}") };
    assert_eq!((information.quantity, psnr.quantity), (Quantity::Information, Quantity::Psnr));
    for (index, series) in psnr.series.iter().enumerate() {
        let [point] = series.points.as_slice() else { panic!("{series:?}") };
        let quality = states[index].done().unwrap().reconstruction.clone().unwrap();
        assert_eq!((point.cell, point.value, quality.test_objects), (index, quality.psnr_db, 3));
        assert!(point.value > 15.0 && point.published.is_none(), "{point:?}");
    }
    let text = svg(&figure).unwrap();
    assert!(text.contains("PSNR by Linear MMSE") && text.contains("PSNR, dB"), "{text}");
    let row = &rows(&folder)[1];
    let column = |name: &str| row[CSV_HEADER.iter().position(|known| *known == name).unwrap()].as_str();
    let (decoder, psnr_db) = (column("decoder"), column("psnr_db"));
    assert_eq!((decoder, psnr_db.parse()), ("Linear MMSE", Ok(psnr.series[1].points[0].value)));
}

#[test]
fn axes_without_a_role_tell_lines_apart() {
    let mut plan = small();
    plan.axes.seed = vec![1, 2];
    plan.plot.panels = Some(Facet::Axis(Axis::Objects));
    plan.plot.x = Facet::Axis(Axis::Mask);
    plan.plot.lines = Facet::Axis(Axis::Estimator);
    let cells = plan.cells().unwrap();
    let figure = figure_of(&plan, &cells, &vec![CellState::Waiting; cells.len()]);
    assert_eq!(figure.panels.len(), 2);
    let names: Vec<&str> = figure.panels[0].series.iter().map(|series| series.name.as_str()).collect();
    assert_eq!(names, ["gaussian-stationary, 1", "gaussian-stationary, 2"]);
    // The mask of an optimizer run has no number of lenslets before it runs: its axis has names.
    plan.axes.mask.push("ideal:random:25".parse().unwrap());
    let cells = plan.cells().unwrap();
    let figure = figure_of(&plan, &cells, &vec![CellState::Waiting; cells.len()]);
    assert_eq!(figure.ticks[2].label, "ideal:random:25");
    assert_eq!(figure.x_label, "mask");
}

#[test]
fn first_looks_keep_designed_masks() {
    let quick = |name: &str| NamedPlan::find(name).unwrap().plan.quick();
    let names: Vec<String> = quick("s5-shape").axes.names_of(Axis::Mask);
    assert_eq!(names, ["heuristic:8", "heuristic:9", "ideal:random:25", "ideal-elliptic:random:25"]);
    assert_eq!(quick("fig3").axes.mask.len(), 5 + 4);
}

/// A density model above the entropy of the beads is no measure of the difference of two masks.
#[test]
fn loose_estimates_have_no_difference_and_their_band_ends_at_the_entropy_bound() {
    let place = tempfile::tempdir().unwrap();
    let folder = begun(small(), place.path());
    computed(&folder, Shard::default());
    let states = folder.states().unwrap();
    let figure = figure_of(folder.plan(), folder.cells(), &states);
    let column = CSV_HEADER.iter().position(|name| *name == "first_mask_less_this").unwrap();
    let mut loose = 0;
    for (pair, row) in states.chunks(2).zip(rows(&folder).chunks(2)) {
        let is_loose = pair.iter().any(|state| state.done().unwrap().estimate.as_ref().unwrap().above_ceiling());
        assert_eq!(row[1][column].is_empty(), is_loose, "{row:?}");
        loose += usize::from(is_loose);
    }
    assert!(loose > 0, "sparse beads");
    for point in figure.panels[0].series.iter().flat_map(|series| &series.points) {
        let ceiling = states[point.cell].done().unwrap().estimate.as_ref().unwrap().ceiling.unwrap();
        assert_eq!(point.upper, ceiling.min(point.value));
    }
}
