//! Studies: plans of cells that are computed one by one or by tasks of a job array, resumed, tabulated and drawn.

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use serde_json::{Value, json};

use super::{Bench, idx, npy, text};

/// Cells that take fractions of a second.
const TINY: &str = "--patch 6 --patches-train 200 --patches-test 40 --estimator gaussian";

fn cells(study: &Value) -> &Vec<Value> {
    study["cells"].as_array().unwrap()
}

fn written(bench: &Bench, name: &str) -> String {
    std::fs::read_to_string(bench.path(name)).unwrap()
}

/// Files of the cells with a result.
fn cell_files(bench: &Bench, folder: &str) -> Vec<std::path::PathBuf> {
    let entries = std::fs::read_dir(bench.path(folder).join("cells")).unwrap();
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|ending| ending == "json"));
    files.sort();
    files
}

#[test]
fn cells_tables_and_plots_of_a_plan_are_written() {
    let bench = Bench::new();
    let grid = "--objects beads:0.008 --objects beads:0.05 --mask heuristic:1 --mask heuristic:4";
    let study = bench.json(&format!("study run grid {TINY} {grid} --out a"));
    let names: Vec<(&str, &str)> = cells(&study)
        .iter()
        .map(|cell| (cell["settings"]["objects"].as_str().unwrap(), cell["settings"]["mask"].as_str().unwrap()))
        .collect();
    let beads = ["beads:0.008", "beads:0.05"];
    assert_eq!(names, beads.map(|beads| [(beads, "heuristic:1"), (beads, "heuristic:4")]).concat());
    assert_eq!((&study["waiting"], &study["failed"], cell_files(&bench, "a").len()), (&json!(0), &json!(0), 4));
    for cell in cells(&study) {
        assert!(cell["machine"]["threads"].as_u64().unwrap() > 0 && cell["seconds"].as_f64().unwrap() > 0.0, "{cell}");
        assert!(cell["sensor_tamura"]["mean"].as_f64().unwrap() > 0.5, "{cell}");
    }
    // A cell equals the result of the estimate command.
    let line = "estimate --estimator gaussian --patch 6 --patches-train 200 --patches-test 40 --seed 1";
    let mut alone = bench.json(&format!("{line} --objects beads:0.05 --mask heuristic:4"));
    alone["seconds"] = cells(&study)[3]["estimate"]["seconds"].clone();
    for (name, value) in cells(&study)[3]["estimate"].as_object().unwrap() {
        assert_eq!(&alone[name], value, "{name}");
    }
    assert_eq!(written(&bench, "a/table.csv").lines().count(), 5);
    assert!(written(&bench, "a/table.md").contains("| beads:0.05 | heuristic:4 | "));
    assert!(written(&bench, "a/plot.svg").contains("information, bits per pixel"));
    assert!(std::fs::read(bench.path("a/plot.png")).unwrap().starts_with(b"\x89PNG"));
    // Tables and plots are made again from the folder alone.
    let table = written(&bench, "a/table.csv");
    std::fs::remove_file(bench.path("a/table.csv")).unwrap();
    assert!(bench.done("study table a").contains("4 cells: 4 done"));
    assert_eq!(written(&bench, "a/table.csv"), table);
    assert!(bench.done("study plot a --out b.svg").contains("b.svg") && bench.path("b.svg").is_file());
    assert!(bench.refused("study plot a --out b.gif").contains(".svg or .png"));
    assert!(bench.done("study missing a").contains("Nothing is missing"));
}

#[test]
fn plans_are_listed_printed_and_run_from_their_file() {
    let bench = Bench::new();
    let listed = bench.done("study plan");
    for name in ["fig2", "fig3", "s1", "s2", "s3", "s4", "s5", "s5-shape", "grid", "patches", "bracket"] {
        assert!(listed.lines().any(|line| line.split_whitespace().next() == Some(name)), "{name} in {listed}");
    }
    let line = format!("{TINY} --objects beads:0.05 --mask heuristic:2 --seed 3");
    let text = bench.done(&format!("study plan grid {line}"));
    bench.write("my.toml", &text);
    assert_eq!(bench.done("study plan my.toml"), text);
    let mine = bench.json("study run my.toml --out a");
    let named = bench.json(&format!("study run grid {line} --out b"));
    assert_eq!(cells(&mine)[0]["estimate"]["bits_per_pixel"], cells(&named)[0]["estimate"]["bits_per_pixel"]);
    // The folder of a study names its plan as well.
    assert_eq!(bench.json("study run a --out a"), mine);
    let dry = bench.done("study run fig2 --quick --dry-run");
    assert!(dry.contains("60 cells, about 1") && dry.contains("heuristic:9, 32 x 32 px, bracket"), "{dry}");
    let paper = bench.done("study plan fig2 --protocol paper");
    assert!(paper.contains("estimator = [\"pixelcnn\"]") && paper.contains("trials = 5"), "{paper}");
}

#[test]
fn images_that_were_left_out_are_told() {
    let bench = Bench::new();
    let images: Vec<f32> = (0..12 * 40 * 40).map(|index| (index * 37 % 101) as f32).collect();
    bench.write("seen/all.npy", npy("(12, 40, 40)", &images));
    bench.write("seen/bad.png", "no image");
    let printed = bench.done(&format!("study run grid {TINY} --objects images:seen --mask heuristic:2 --out a"));
    assert!(printed.contains("1 unreadable file was left out: bad.png"), "{printed}");
}

#[test]
fn published_values_stand_beside_estimates_of_the_same_patch() {
    let bench = Bench::new();
    bench.write("a.idx", idx(40, 28, |index| (index * 7 % 251) as u8));
    let tiny = "--estimator gaussian --patches-train 60 --patches-test 20";
    let published = |line: &str, out: &str| -> Vec<String> {
        bench.done(&format!("study run grid {tiny} {line} --out {out}"));
        let table = written(&bench, &format!("{out}/table.csv"));
        let column = table.lines().next().unwrap().split(',').position(|name| name == "published").unwrap();
        table.lines().skip(1).map(|row| row.split(',').nth(column).unwrap().to_owned()).collect()
    };
    let masks = "--mask heuristic:2 --mask heuristic:3";
    assert_eq!(
        published(&format!("{masks} --objects beads:0.02 --objects beads:0.021"), "a"),
        ["0.3866", "0.477", "", ""]
    );
    assert_eq!(published("--mask heuristic:2 --objects beads:0.02 --noise read:5", "b"), ["0.4671"]);
    let sets = "--mask heuristic:9 --set mnist=idx:a.idx --objects mnist --objects idx:a.idx";
    assert_eq!(published(sets, "c"), ["0.611", ""]);
    // Gaussian bounds of sparse beads are loose.
    let masks = "--mask heuristic:1 --mask heuristic:4 --mask heuristic:9";
    let output = bench.done(&format!(
        "study run grid --estimator gaussian --patches-train 2000 --patches-test 200 --objects beads:0.008 {masks} --out e"
    ));
    assert!(!output.contains("rank correlation"), "loose estimates order nothing: {output}");
    for part in
        ["0 of 3 estimates at most the published value + 0.02 bits per pixel", "3 estimates above the entropy bound"]
    {
        assert!(output.contains(part), "{part} in {output}");
    }
}

#[test]
fn tasks_of_a_job_array_share_a_folder() {
    let bench = Bench::new();
    let grid = format!("{TINY} --objects beads:0.02 --mask heuristic:1 --mask heuristic:2 --mask heuristic:4");
    bench.done(&format!("study run grid {grid} --out whole"));
    let output = bench.done(&format!("study sbatch grid {grid} --out shared --shards 2 --cpus 1"));
    assert!(output.contains("3 cells in 2 tasks"), "{output}");
    assert!(bench.refused("study missing whole --sbatch").contains("found none; write one with study sbatch"));
    let missing = bench.done("study missing shared --sbatch");
    assert!(missing.starts_with("sbatch --array=0-1 "), "{missing}");
    assert_eq!(bench.done("study missing shared").lines().count(), 3);
    // The environment of a job array names the share; a flag overrides it.
    let task = |number: &str| {
        let mut command = bench.command();
        command.env("SLURM_ARRAY_TASK_ID", number).env("SLURM_ARRAY_TASK_COUNT", "2");
        command.env("SLURM_ARRAY_TASK_MIN", "0").env("SLURM_ARRAY_TASK_MAX", "1");
        let output = command.args(["study", "run", "shared", "--out", "shared"]).output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
    };
    task("1");
    let missing = bench.done("study missing shared --sbatch");
    assert!(missing.starts_with("sbatch --array=0 "), "{missing}");
    task("0");
    bench.done("study run shared --out shared --shard 0/2");
    assert!(bench.done("study missing shared --sbatch").contains("Nothing is missing"));
    bench.done("study table shared");
    assert_eq!(written(&bench, "shared/table.csv"), written(&bench, "whole/table.csv"));
}

/// A scheduler's signal ends a task with success, and the same command resumes it.
#[cfg(unix)]
#[test]
fn signals_of_a_scheduler_stop_a_task_between_checkpoints() {
    let bench = Bench::new();
    let line =
        "study run grid --steps 9000000 --patch 8 --patches-test 20 --objects beads:0.02 --mask heuristic:2 --out a";
    for signal in ["TERM", "USR1"] {
        let mut child = bench.command().args(line.split_whitespace()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        // The first line appears when the cell has begun.
        assert!(lines.next().unwrap().unwrap().contains("1 cell"));
        let killed = bench.process("kill").args([&format!("-{signal}"), &child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        let rest: Vec<String> = lines.map(Result::unwrap).collect();
        assert!(child.wait().unwrap().success() && rest.iter().any(|line| line.contains("resumes it")), "{rest:?}");
    }
    assert!(cell_files(&bench, "a").is_empty());
    assert!(bench.refused("study run grid --steps 100000001 --out a").contains("10000000"));
}

#[test]
fn a_cell_that_fails_has_its_sentence_and_the_others_go_on() {
    let bench = Bench::new();
    let line = "study run grid --estimator gaussian --patches-train 400 --patches-test 40 --patch 6 --mask heuristic:9 --out a \
                --objects stack:none.npy --objects beads:0.02 --objects beads:0.05";
    for _ in 0..2 {
        let output = bench.run(format!("{line} --json").split_whitespace());
        assert_eq!(output.status.code(), Some(1));
        let errors = text(&output.stderr);
        assert!(
            errors.contains("found 1 of 3 failed")
                && errors.contains("none.npy: no such file or folder; 1 cell with it will fail"),
            "{errors}"
        );
        assert!(!errors.contains("panicked"), "{errors}");
        let study: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((cells(&study).len(), &study["failed"]), (2, &json!(1)));
    }
    assert!(written(&bench, "a/table.md").contains("none.npy, heuristic:9, 6 x 6 px, "));
    assert!(written(&bench, "a/table.csv").lines().nth(1).unwrap().contains("none.npy"));
}

#[test]
fn fitted_estimators_take_their_budget() {
    let bench = Bench::new();
    let line = "study run grid --patch 6 --patches-train 100 --patches-test 20 --objects beads:0.05 --mask heuristic:2";
    for estimator in ["causal", "pixelcnn", "bracket"] {
        let study = bench.json(&format!("{line} --estimator {estimator} --budget 0.2s --out {estimator}"));
        assert_eq!(cells(&study)[0]["settings"]["estimates"]["seconds"], 0.2);
        assert_eq!(cells(&study)[0]["estimate"]["estimator"], estimator);
    }
}

#[test]
fn settings_that_cannot_be_computed_are_refused() {
    let bench = Bench::new();
    bench.write("unknown.toml", bench.done("study plan grid").replace("seed = ", "colour = "));
    bench.write("empty.toml", "");
    bench.write("large.toml", bench.done("study plan grid").replace("patch = [\"32\"]", "patch = [\"80\"]"));
    for (line, part) in [
        ("run grid", "--out"),
        ("run moon --out out", "one of fig2, fig3"),
        ("run unknown.toml --out out", "unknown field `colour`"),
        ("run empty.toml --out out", "missing field"),
        ("run large.toml --out out", "large.toml: axis patch: expected at most the sensor of 65 x 65 px"),
        ("run grid --mask heuristic:10 --out out", "1 to 9"),
        ("run grid --mask heuristic:4 --mask heuristic:4 --out out", "heuristic:4 twice"),
        ("run grid --objects mnist --out out", "--set mnist=idx:FILE"),
        ("run grid --set mnist --out out", "NAME=SOURCE"),
        ("run grid --objects pearls:1 --out out", "or a name of the plan's sets"),
        ("run grid --estimator gaussian --budget 60s --out out", "leave them out"),
        ("run grid --estimator magic --out out", "causal"),
        ("run grid --noise none --out out", "without noise"),
        ("run grid --training 5s --out out", "--decoder network"),
        ("run grid --decoder posterior --set mnist=idx:x --objects mnist --out out", "expected beads"),
        ("run grid --decoder linear --sweeps 9 --out out", "--decoder posterior"),
        ("run grid --test 9 --out out", "--decoder linear"),
        ("run grid --decoder magic --out out", "richardson-lucy"),
        ("decoders --lenslets 9 --out out", "study run decoders"),
        ("run grid --patches-test 0 --out out", "patches_test: expected 2"),
        ("run grid --patch 0 --out out", "patch \"0\""),
        ("run grid --photons 0 --out out", "mean_photons"),
        ("run grid --budget 0s --out out", "budget"),
        ("run grid --shard 4/4 --out out", "0/4 to 3/4"),
        ("grid --out out", "study run grid"),
        ("bracket --lenslets 1 --out out", "study run bracket"),
        ("table .", "no plan.toml"),
        ("sbatch grid --shards 0 --out out", "--shards 0"),
    ] {
        let sentence = bench.refused(&format!("study {line}"));
        assert!(sentence.contains(part), "{line}: {part:?} in {sentence}");
    }
    bench.write("file", "x");
    assert!(bench.refused("study run grid --estimator gaussian --out file").contains("found a file"));
    assert!(!bench.path("out/cells").exists());
}

/// A study of decoders is resumed, and its files hold information beside image quality.
#[test]
fn information_and_decoders_stand_side_by_side() {
    let bench = Bench::new();
    let few = "--estimator gaussian --patch 6 --patches-train 100 --patches-test 20 --test 3 --objects beads:0.02";
    let line = format!(
        "study run decoders {few} --mask heuristic:1 --mask heuristic:4 --mask heuristic:9 --decoder linear,tv --out a"
    );
    let record = bench.json(&line);
    assert_eq!((cells(&record).len(), record["correlations"].as_array().unwrap().len()), (6, 3));
    assert!(cells(&record)[0]["reconstruction"]["psnr_db"].as_f64().unwrap() > 20.0, "{record}");
    assert!(cells(&record)[3]["estimate_of"].is_string() && cells(&record)[0]["estimate_of"].is_null(), "{record}");
    // Nothing is computed again, so the seconds are the same.
    assert_eq!(bench.json(&line), record);
    for file in ["a/table.md", "a/table.csv", "a/correlations.csv", "a/plot.svg"] {
        assert!(!written(&bench, file).is_empty(), "{file}");
    }
    bench.write("images.idx", "x");
    let listed =
        bench.done("study run decoders --set mnist=idx:images.idx --objects mnist --objects beads:0.02 --dry-run");
    assert!(listed.contains("decoder posterior is for beads: 9 cells of mnist left out"), "{listed}");
    assert!(listed.contains("63 cells"), "{listed}");
}
