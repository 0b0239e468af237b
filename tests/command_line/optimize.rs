//! Optimizer runs from the command line: their files, and resuming after a power cut.

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use serde_json::{Value, json};

use super::{Bench, npy, text};

/// A run that takes a second.
const TINY: &str = "optimize --start random:4 --seed 5 --objects beads:0.05 --patch 6 --objective density --score none \
                    --config {\"first_fit\":20,\"refit\":5,\"last_fit\":20}";

fn read(bench: &Bench, name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(bench.path(name)).unwrap()).unwrap()
}

#[test]
fn run_writes_design_psf_curve_and_record() {
    let bench = Bench::new();
    let told = bench.json(&format!("{TINY} --steps 6 --out a"));
    for name in ["psf.npy", "psf.tiff", "psf.png", "psf16.png", "lenslets.csv", "curve.csv", "run.safetensors"] {
        assert!(bench.path("a").join(name).exists(), "{name}");
    }
    let record = read(&bench, "a/run.json");
    assert_eq!(told["record"], record);
    assert_eq!((&record["format"], &record["finished"]), (&json!("lenslet-studio/ideal"), &json!(true)));
    let checkpoints = record["checkpoints"].as_array().unwrap();
    let steps: Vec<u64> = checkpoints.iter().map(|checkpoint| checkpoint["step"].as_u64().unwrap()).collect();
    assert_eq!(steps, [0, 5, 6]);
    assert_eq!(told["end"], checkpoints[2]);
    let design = read(&bench, "a/design.json");
    assert_eq!(design["encoder"], record["result"]);
    assert_ne!(design["encoder"]["lenslets"], record["start"]["encoder"]["lenslets"]);
    assert_eq!(std::fs::read_to_string(bench.path("a/curve.csv")).unwrap().lines().count(), 4);
    // Every other command accepts the design.
    bench.done("estimate --estimator gaussian --patch 6 --patches-train 100 --patches-test 20 a/design.json");

    // A finished run is not repeated. A longer one resumes from it.
    let again = bench.json(&format!("{TINY} --steps 6 --out a"));
    assert_eq!(again["end"], told["end"]);
    let longer = bench.json(&format!("{TINY} --steps 12 --out a"));
    assert_eq!(longer["end"]["step"], json!(12));
    assert_eq!(longer["record"]["checkpoints"][0], checkpoints[0]);
    let told = bench.done(&format!("{TINY} --steps 12 --out a"));
    assert!(told.contains("upper bound by the run's density model") && told.contains("12 steps"), "{told}");

    // The user's settings determine the schedule.
    let told = bench.json(&format!(
        "{TINY} --config {{\"refit_every\":2,\"refit\":3,\"rates\":{{\"position\":0.25}}}} --steps 4 --out set"
    ));
    let settings = &told["record"]["settings"];
    assert_eq!((&settings["refit_every"], &settings["refit"]), (&json!(2), &json!(3)));
    assert_eq!(settings["rates"]["position"], json!(0.25));
    let steps: Vec<&Value> =
        told["record"]["checkpoints"].as_array().unwrap().iter().map(|checkpoint| &checkpoint["step"]).collect();
    assert_eq!(steps, [&json!(0), &json!(2), &json!(4)]);

    // The folder refuses another run.
    let sentence = bench.refused(&format!("{TINY} --steps 12 --free positions --out a"));
    assert!(sentence.contains("not the state of this run"), "{sentence}");
}

/// A run of seconds from two starts, for images of `side` pixels a side. Images of 40 px leave a sensor of a single
/// patch.
fn two_starts(bench: &Bench, side: usize) -> String {
    let value = |index: usize| (index * 37 % 101 + index / side % 7 * 9) as f32;
    let values: Vec<f32> = (0..30 * side * side).map(value).collect();
    bench.write("seen.npy", npy(&format!("(30, {side}, {side})"), &values));
    let objects =
        "--objects stack:seen.npy --patch 6 --config {\"first_fit\":20,\"last_fit\":20} --score 0.2s --baselines 2";
    format!("optimize --start random:4 --seed 5 {objects} --starts 2 --steps 2 --out a")
}

#[test]
fn several_starts_are_ranked_by_their_scores() {
    let bench = Bench::new();
    let scored = " --score 0.2s --baselines 2";
    let line = two_starts(&bench, 40);
    let told = bench.json(&line);
    let ranked = told["ranked"].as_array().unwrap();
    let worth = |place: usize| ranked[place]["estimate"]["bits_per_pixel"].as_f64().unwrap();
    assert_eq!(ranked.len(), 2);
    assert!(worth(0) >= worth(1), "{} {}", worth(0), worth(1));
    // The best start copied its result; its own folder holds the whole run.
    let name = ranked[0]["name"].as_str().unwrap();
    let number = if name.ends_with("seed 5") { 1 } else { 2 };
    let own = read(&bench, &format!("a/start-{number}/run.json"));
    assert_eq!((&own, &read(&bench, "a/run.json")), (&told["record"], &told["record"]));
    assert_ne!(read(&bench, "a/start-1/design.json"), read(&bench, "a/start-2/design.json"));
    assert_eq!(ranked[0]["design"]["encoder"], read(&bench, "a/design.json")["encoder"]);

    // Result, start and two heuristic lenslets.
    let cells = told["score"]["cells"].as_array().unwrap();
    let names: Vec<&str> = cells.iter().map(|cell| cell["design"].as_str().unwrap()).collect();
    assert_eq!(names, ["design", "start", "heuristic:2"]);
    let verdict: Vec<&str> = told["verdict"].as_array().unwrap().iter().map(|line| line.as_str().unwrap()).collect();
    assert!(verdict[0].starts_with("whole sensor: at most ") && verdict[0].contains("its start"), "{verdict:?}");
    for (sentence, other) in verdict[1..].iter().zip([", its start ", ", best heuristic "]) {
        assert!(sentence.contains(other) && sentence.contains("only upper bounds are known"), "{verdict:?}");
    }

    // Nothing is repeated, neither runs nor estimates: all report their original times.
    let again = bench.json(&line);
    assert_eq!((&again["ranked"], &again["score"]), (&told["ranked"], &told["score"]));
    let printed = bench.done(&line);
    assert!(printed.contains(&format!("1. {name}: ")) && printed.contains("its start"), "{printed}");
    // A comparison once requested stays for a command without one.
    let brief = bench.json(&line.replace(scored, ""));
    assert_eq!(brief["score"], told["score"]);
    assert!(!bench.path("a/score-1").exists());
    let sentence = bench.refused(&TINY.replace("random:4", "heuristic:4 --starts 2 --out b"));
    assert!(sentence.contains("--start random:25"), "{sentence}");
    // Other runs do not replace it.
    let ranking = read(&bench, "a/order.json");
    for other in [line.replace("--seed 5", "--seed 6"), format!("{line} --free positions")] {
        let sentence = bench.refused(&other);
        assert!(sentence.contains("a: expected the starts and settings of the runs that are there"), "{sentence}");
    }
    assert_eq!(read(&bench, "a/order.json"), ranking);
    // A single run replaces none of it.
    let sentence = bench.refused(&format!("{TINY} --steps 1 --out a"));
    assert!(sentence.contains("found the runs of several starts; choose another --out"), "{sentence}");
}

#[test]
fn tasks_of_a_job_array_share_the_starts() {
    let bench = Bench::new();
    let steps = "\"first_fit\":2,\"refit\":2,\"last_fit\":2,\"refit_every\":1";
    let tiny = format!("\"objects\":4,\"patches\":4,\"substeps\":1,\"relocation_candidates\":0,{steps}");
    let line = two_starts(&bench, 33).replace("--patch 6", "--patch 2");
    let line = line.replace("\"first_fit\":20,\"last_fit\":20", &tiny);
    bench.done(&line.replace("--out a", "--out whole"));
    let first = bench.json(&format!("{line} --shard 1/2"));
    assert_eq!((&first["shard"], &first["waiting"]), (&json!("1/2"), &json!([1])));
    assert!(!bench.path("a/run.json").exists() && !bench.path("a/start-1").exists(), "{:?}", bench.files());
    let sentence = bench.refused(&format!("{line} --shard 0/2 --free positions"));
    assert!(sentence.contains("a: expected the starts and settings of the runs that are there"), "{sentence}");
    assert!(bench.refused(&format!("{TINY} --shard 0/2 --out b")).contains("--shard: expected several starts"));

    // The environment of a job array names the share of the task that ends last.
    let mut command = bench.command();
    command.env("SLURM_ARRAY_TASK_ID", "1").env("SLURM_ARRAY_TASK_COUNT", "2");
    command.env("SLURM_ARRAY_TASK_MIN", "1").env("SLURM_ARRAY_TASK_MAX", "2");
    let output = command.args(line.split_whitespace()).arg("--json").output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let last: Value = serde_json::from_slice(&output.stdout).unwrap();
    let numbers = |folder: &str, start: usize| -> Vec<Value> {
        let record = read(&bench, &format!("{folder}/start-{start}/run.json"));
        let checkpoints = record["checkpoints"].as_array().unwrap();
        let bits = checkpoints.iter().map(|checkpoint| checkpoint["bits_per_pixel"].clone());
        bits.chain([record["result"].clone()]).collect()
    };
    for start in [1, 2] {
        assert_eq!(numbers("a", start), numbers("whole", start), "start {start}");
    }
    let ranked = last["ranked"].as_array().unwrap();
    assert_eq!((ranked.len(), &ranked[0]["design"]["encoder"]), (2, &read(&bench, "a/design.json")["encoder"]));
    let best = if ranked[0]["name"].as_str().unwrap().ends_with("seed 5") { 1 } else { 2 };
    assert_eq!(read(&bench, "a/run.json"), read(&bench, &format!("a/start-{best}/run.json")));
    assert_eq!(read(&bench, "a/order.json")["ranked"], last["ranked"]);
    // The same command without a share computes nothing again.
    assert_eq!(bench.json(&line)["ranked"], last["ranked"]);
}

/// A scheduler's signal ends a run with success, and the same command resumes it.
#[cfg(unix)]
#[test]
fn signals_of_a_scheduler_stop_a_run() {
    let bench = Bench::new();
    let line = format!(
        "{} --steps 90000 --starts 2 --shard 0/2 --out a",
        two_starts(&bench, 37).replace(" --starts 2 --steps 2 --out a", "")
    );
    for signal in ["TERM", "USR1"] {
        let mut child = bench.command().args(line.split_whitespace()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        // The first line of the start appears after the program listens.
        assert!(lines.any(|line| line.unwrap().contains("start 1 of 2")));
        let killed = bench.process("kill").args([&format!("-{signal}"), &child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        let rest: Vec<String> = lines.map(Result::unwrap).collect();
        assert!(child.wait().unwrap().success() && rest.iter().any(|line| line.contains("resumes it")), "{rest:?}");
    }
    assert!(!bench.path("a/start-1/order.json").exists());
}

#[test]
fn deviations_from_the_request_are_reported() {
    let bench = Bench::new();
    let images: Vec<f32> = (0..12 * 40 * 40).map(|index| (index * 37 % 101) as f32).collect();
    bench.write("seen/all.npy", npy("(12, 40, 40)", &images));
    bench.write("seen/bad.png", "no image");
    let sizes = "--config {\"objects\":1,\"patches\":1,\"substeps\":1,\"refit_every\":1,\"first_fit\":1,\"refit\":1,\"last_fit\":1} --steps 1 --score none";
    let line = format!("optimize --start random:4 --objects images:seen --patch 66x4 {sizes} --out a");
    let output = bench.run(line.split_whitespace());
    let (printed, told) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(0), "{told}");
    assert!(told.contains("a patch of 66 x 4 px is larger than the measurement"), "{told}");
    // Omitted images are reported.
    assert!(printed.contains("1 unreadable file was left out: bad.png"), "{printed}");
    assert!(read(&bench, "a/run.json")["notices"].to_string().contains("bad.png"));
}

#[test]
fn folder_that_cannot_be_written_is_refused_before_the_run() {
    let bench = Bench::new();
    for name in ["run.safetensors", "run.json", "curve.csv", "psf.npy"] {
        std::fs::create_dir_all(bench.path("taken").join(name)).unwrap();
        // Objects are read before the first fit, and are missing.
        let sentence = bench.refused("optimize --objects idx:none --out taken");
        assert!(sentence.contains(name) && sentence.contains("a folder or device"), "{sentence}");
        std::fs::remove_dir(bench.path("taken").join(name)).unwrap();
    }
    bench.write("single/run.safetensors", "a state");
    let sentence = bench.refused(&format!("{TINY} --starts 2 --steps 1 --out single"));
    assert!(sentence.contains("found a single run"), "{sentence}");
}

#[test]
fn failed_start_is_reported_even_with_a_closed_pipe() {
    let bench = Bench::new();
    let line = two_starts(&bench, 40);
    bench.write("a/start-2/run.safetensors", "no state");
    let whole = bench.run(line.split_whitespace());
    assert!(!whole.stdout.is_empty());
    let mut child = bench.command();
    child.args(line.split_whitespace()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = child.spawn().unwrap();
    // The pipe is closed before anything is printed.
    drop(child.stdout.take());
    for output in [whole, child.wait_with_output().unwrap()] {
        let told = text(&output.stderr);
        assert!(output.status.code() == Some(1) && told.contains("found that 1 failed"), "{told}");
    }
}

#[test]
fn missing_sensor_score_alone_is_computed_again() {
    let bench = Bench::new();
    let line = two_starts(&bench, 66);
    let told = bench.json(&line);
    // The best start failed before.
    let mut order = read(&bench, "a/order.json");
    let best = &mut order["ranked"][0];
    assert!(!best["sensor"].is_null() && best["is_scored"] == json!(true));
    (best["sensor"], best["is_scored"]) = (Value::Null, json!(false));
    bench.write("a/order.json", order.to_string());
    let again = bench.json(&line);
    let results = |told: &Value| {
        let mut results = told["ranked"].as_array().unwrap().clone();
        results.sort_by_key(|result| result["name"].to_string());
        results
    };
    for (result, before) in results(&again).iter().zip(results(&told)) {
        assert_eq!((&result["estimate"], &result["is_scored"]), (&before["estimate"], &json!(true)));
        assert!(!result["sensor"].is_null(), "{result}");
    }
}

#[test]
fn scores_of_later_starts_survive_a_failure() {
    let bench = Bench::new();
    let line = two_starts(&bench, 40);
    let told = bench.json(&line);
    for number in [1, 2] {
        bench.write(&format!("a/start-{number}/run.safetensors"), "no state");
    }
    // The failure of the first start is recorded, and the second ends the program.
    let output = bench.run(line.split_whitespace());
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    let second = told["ranked"].as_array().unwrap().iter().find(|result| result["name"] == "4 random, seed 6").unwrap();
    assert_eq!(&read(&bench, "a/order.json")["ranked"], &json!([second]));
}

#[test]
fn default_objective_of_beads_is_the_decoder() {
    let bench = Bench::new();
    let line = TINY.replace(" --objective density", "");
    let line = format!(
        "{line} --config {{\"first_fit\":4,\"refit_every\":4,\"refit\":2,\"last_fit\":2,\"patches\":4,\"relocation_candidates\":2}}"
    );
    let told = bench.json(&format!("{line} --steps 5 --out a"));
    let record = read(&bench, "a/run.json");
    assert_eq!(record["settings"]["objective"], json!("posterior"));
    let steps: Vec<&Value> =
        record["checkpoints"].as_array().unwrap().iter().map(|checkpoint| &checkpoint["step"]).collect();
    assert_eq!(steps, [0, 4, 5]);
    assert!(told["end"]["lower"].is_null() && told["end"]["bits_per_pixel"].as_f64().unwrap() > 0.0);
    let curve = std::fs::read_to_string(bench.path("a/curve.csv")).unwrap();
    assert!(curve.starts_with("step,lower_bound_bits_per_pixel,") && curve.lines().count() == 4, "{curve}");
    let told = bench.done(&format!("{line} --steps 5 --out a"));
    assert!(told.contains("lower bound by the run's decoder"), "{told}");
    // The same scene with the density objective is another run.
    let sentence = bench.refused(&format!("{line} --objective density --steps 5 --out a"));
    assert!(sentence.contains("not the state of this run"), "{sentence}");
}

#[test]
fn killed_run_resumes_bit_for_bit() {
    let bench = Bench::new();
    let fits = "\"patches\":2,\"first_fit\":4,\"refit\":4,\"relocation_candidates\":0";
    for (objective, last_fit) in [("density", 100), ("posterior", 2)] {
        let line = TINY.replace("density", objective);
        let length = format!("--steps 8 --config {{\"refit_every\":2,{fits},\"last_fit\":{last_fit}}}");
        let line = format!("{line} {length} --out {objective}");
        let whole = bench.json(&format!("{line}-whole"));
        let folder = bench.path(format!("{objective}-killed"));
        let state = || std::fs::read(folder.join("run.safetensors")).ok();
        let reset = || {
            if folder.exists() {
                std::fs::remove_dir_all(&folder).unwrap();
            }
        };
        // The second state is that of the first steps.
        let first = std::cell::OnceCell::new();
        let is_second = || state().is_some_and(|state| first.get_or_init(|| state.clone()) != &state);
        bench.kill_midway(&format!("{line}-killed"), reset, is_second);
        assert!(!folder.join("design.json").exists(), "{objective}: the run was killed before its end");
        let output = bench.run(format!("{line}-killed --json").split_whitespace());
        assert!(text(&output.stderr).contains("resuming the run"), "{}", text(&output.stderr));
        let killed: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(killed["record"]["result"], whole["record"]["result"], "{objective}");
        let bits = |told: &Value| -> Vec<Value> {
            let checkpoints = told["record"]["checkpoints"].as_array().unwrap();
            checkpoints.iter().map(|checkpoint| checkpoint["bits_per_pixel"].clone()).collect()
        };
        assert_eq!(bits(&killed), bits(&whole), "{objective}");
    }
}

#[test]
fn run_is_reproduced_from_its_record() {
    let bench = Bench::new();
    bench.done(&format!("{TINY} --steps 6 --out a"));
    // It finished once before.
    let told = bench.json(&format!("{TINY} --steps 9 --out a"));
    let before = bench.files();
    let again = bench.json("reproduce a/run.json");
    assert_eq!(
        (&again["same"], &again["differs_from_step"], &again["notes"]),
        (&json!(true), &Value::Null, &json!([]))
    );
    assert_eq!((&again["recorded"], &again["record"]["result"]), (&told["record"], &told["record"]["result"]));
    let events = again["record"]["events"].as_array().unwrap();
    assert_eq!(
        (&told["record"]["events"], events.last()),
        (&json!(events), Some(&json!({"kind": "extended", "step": 6})))
    );
    assert_eq!(bench.files(), before, "nothing stays behind");
    // A stopped run is repeated up to its last step.
    let mut stopped = read(&bench, "a/run.json");
    stopped["checkpoints"].as_array_mut().unwrap().truncate(2);
    (stopped["finished"], stopped["events"], stopped["settings"]["steps"]) = (json!(false), json!([]), json!(6));
    bench.write("stopped.json", stopped.to_string());
    let told = bench.done("reproduce stopped.json");
    assert!(told.contains("step 5: ") && told.contains("bit-identical"), "{told}");
    assert!(told.contains("is unfinished") && !told.contains("step 6"), "{told}");

    // A record with other numbers is detected.
    let mut changed = read(&bench, "a/run.json");
    let bits = changed["checkpoints"][1]["bits_per_pixel"].as_f64().unwrap();
    changed["checkpoints"][1]["bits_per_pixel"] = json!(bits + 1e-12);
    bench.write("changed.json", changed.to_string());
    let output = bench.run("reproduce changed.json".split_whitespace());
    let (printed, told) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(printed.contains("Different from step 5"), "{printed}");
    assert!(told.contains("the record may have been edited"), "{told}");
    changed["program_version"] = json!("0.0.1");
    bench.write("changed.json", changed.to_string());
    let told = text(&bench.run("reproduce changed.json".split_whitespace()).stderr);
    assert!(told.starts_with("changed.json: the record was written by version 0.0.1\n"), "{told}");
    assert!(told.contains("those of the record: the record was written by version 0.0.1"), "{told}");

    // A run that cannot be reproduced is reported before any computation.
    let mut rewound = read(&bench, "a/run.json");
    rewound["events"] = json!([{"kind": "rewound", "step": 6, "to": 5}]);
    bench.write("rewound.json", rewound.to_string());
    let sentence = bench.refused("reproduce rewound.json");
    assert!(sentence.contains("rewound.json: the run branched, as earlier versions allowed"), "{sentence}");
    rewound["settings"]["steps"] = json!(0);
    bench.write("none.json", rewound.to_string());
    let sentence = bench.refused("reproduce none.json");
    assert!(sentence.contains("none.json: expected a record") && sentence.contains("(steps is 0"), "{sentence}");
    rewound["checkpoints"] = json!([]);
    rewound["settings"]["steps"] = json!(9);
    bench.write("none.json", rewound.to_string());
    assert!(bench.refused("reproduce none.json").contains("a run without checkpoints"));
}

#[test]
fn impossible_runs_are_refused_in_a_sentence() {
    let bench = Bench::new();
    bench.write("taken", "a file");
    bench.write("other/run.safetensors", "no state");
    for (line, part) in [
        ("optimize --out a --start diffuser:16", "no lenslets to move"),
        ("optimize --out a --noise none", "noise"),
        ("optimize --out a --steps 0", "steps is 0"),
        ("optimize --out a --lock 26", "locked is 26"),
        ("optimize --out a --cardinality 0", "cardinality is 0"),
        ("optimize --out a --lenslets 26", "--cardinality 26: expected at most the 25 of the start"),
        ("optimize --out a --anisotropic --free positions", "add widths to --free"),
        (r#"optimize --out a --config {"speed":3}"#, "unknown setting \"speed\": expected one of"),
        (r#"optimize --out a --config {"rates":{"speed":3}}"#, "unknown setting \"rates.speed\""),
        (r#"optimize --out a --config {"refit":0}"#, "refit is 0"),
        (r#"optimize --out a --config {"warm":1}"#, "setting \"warm\" is 1"),
        ("optimize --out a --config none.json", "none.json: cannot be read"),
        ("optimize --out a --config taken", "taken: expected a JSON object"),
        ("optimize --out a --lock 0", "--lock"),
        ("optimize --out a --score 5", "expected a time"),
        ("optimize --out a --starts 0", "--starts"),
        ("optimize --out a --score none --baselines 3", "--baselines"),
        ("optimize --out a --score 1s --baselines 10", "from 1 to 9"),
        ("optimize --out a --free speed", "expected positions"),
        ("optimize --out a --preset best", "expected default or paper"),
        ("optimize --out a --published-as mnist", "--preset paper"),
        ("optimize --out a --objective all", "expected posterior, density or pixelcnn"),
        ("optimize --out a --objective pixelcnn", "objective is pixelcnn"),
        ("optimize --out a --preset paper --objective posterior", "objective is posterior"),
        ("optimize --out a --min-separation 90", "min_separation_px is 90"),
        ("optimize --out a --patch 0", "patch"),
        ("optimize --out taken", "taken: expected a folder"),
        ("optimize --out a --objects idx:none", "none"),
        (
            "optimize --out other --patch 6 --objects beads:0.05",
            "other/run.safetensors: this is not the state of this run",
        ),
        ("optimize --out other --patch 6 --objects beads:0.05", "; choose another --out, or remove this file"),
        ("optimize", "--out"),
    ] {
        let sentence = bench.refused(line);
        assert!(sentence.contains(part), "{line}: {sentence}");
    }
}

#[test]
fn printed_settings_are_read_again() {
    let bench = Bench::new();
    let line = format!("{TINY} --steps 4 --cardinality 3 --print-config");
    let printed = bench.done(&line);
    let settings: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!((&settings["steps"], &settings["cardinality"], &settings["refit"]), (&json!(4), &json!(3), &json!(5)));
    bench.write("settings.json", &printed);
    let again = bench.done("optimize --start random:4 --seed 5 --config settings.json --print-config");
    assert_eq!(serde_json::from_str::<Value>(&again).unwrap(), settings);
    assert!(!bench.path("a").exists());
}
