//! The JSON schemas in `docs/reference/schema` hold for files of earlier versions and for the JSON of every command.

use std::collections::BTreeSet;
use std::io::Read;
use std::path::{Path, PathBuf};

use boon::{Compiler, SchemaIndex, Schemas};
use lenslet_studio::information::Estimate;
use lenslet_studio::studies::StudyRecord;
use lenslet_studio::workbench::Record;
use serde_json::{Value, json};

use super::{Bench, npy};

/// A schema of the documentation.
pub(super) struct Schema {
    schemas: Schemas,
    index: SchemaIndex,
    /// Every entry that it names.
    entries: BTreeSet<String>,
}

fn names(schema: &Value, found: &mut BTreeSet<String>) {
    match schema {
        Value::Object(entries) => {
            let own = entries.get("properties").and_then(Value::as_object);
            found.extend(own.into_iter().flat_map(|entries| entries.keys().cloned()));
            entries.values().for_each(|value| names(value, found));
        }
        Value::Array(values) => values.iter().for_each(|value| names(value, found)),
        _ => {}
    }
}

/// The first entry of a document, at any depth, that is not among the names.
fn unnamed(document: &Value, known: &BTreeSet<String>) -> Option<String> {
    match document {
        Value::Object(entries) => {
            let unknown = entries.keys().find(|name| !known.contains(*name)).cloned();
            unknown.or_else(|| entries.values().find_map(|value| unnamed(value, known)))
        }
        Value::Array(values) => values.iter().find_map(|value| unnamed(value, known)),
        _ => None,
    }
}

impl Schema {
    pub(super) fn open(name: &str) -> Self {
        let path = root().join(format!("docs/reference/schema/{name}.schema.json"));
        let schema: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
        let mut entries = BTreeSet::new();
        names(&schema, &mut entries);
        let (mut schemas, mut compiler) = (Schemas::new(), Compiler::new());
        compiler.add_resource("schema.json", schema).unwrap();
        let index = compiler.compile("schema.json", &mut schemas).unwrap();
        Self { schemas, index, entries }
    }

    /// The sentence on a document that the schema does not describe.
    fn violation(&self, document: &Value) -> Option<String> {
        let validated = self.schemas.validate(document, self.index).err().map(|error| format!("{error:#}"));
        validated.or_else(|| Some(format!("unknown entry {}", unnamed(document, &self.entries)?)))
    }

    pub(super) fn check(&self, document: &Value) {
        if let Some(violation) = self.violation(document) {
            panic!("{violation}");
        }
    }
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn golden(name: &str) -> PathBuf {
    root().join("tests/data/golden").join(name)
}

/// The text of a golden file.
fn read(name: &str) -> String {
    std::fs::read_to_string(golden(name)).unwrap()
}

#[test]
fn designs_validate() {
    let schema = Schema::open("design");
    for name in
        ["v1.json", "v1-diffuser.json", "v1-picture.json", "v1-volume.json", "v2-diffuser.json", "v2-throughput.json"]
    {
        let name = format!("../design-{name}");
        schema.check(&serde_json::from_str(&read(&name)).unwrap());
    }
    for name in ["nine-lenslets", "designed", "diffuser"] {
        let path = root().join(format!("assets/samples/{name}.json"));
        schema.check(&serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap());
    }
    let bench = Bench::new();
    for (mask, folder) in [("heuristic:3", "a"), ("depth:2", "b"), ("diffuser:8", "c"), ("psf:a/psf.npy", "d")] {
        bench.done(&format!("export --mask {mask} --out {folder}"));
        let written = std::fs::read(bench.path(folder).join("design.json")).unwrap();
        schema.check(&serde_json::from_slice(&written).unwrap());
    }
}

#[test]
fn broken_designs_do_not_validate() {
    let schema = Schema::open("design");
    let design: Value = serde_json::from_str(&read("../design-v1.json")).unwrap();
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut changed = design.clone();
        change(&mut changed);
        schema.violation(&changed)
    };
    assert_eq!(changed(&|_| ()), None);
    assert!(changed(&|design| design["seed"] = json!("one")).is_some());
    assert!(changed(&|design| design["format"] = json!("lenslet-studio/study")).is_some());
    assert!(changed(&|design| design["encoder"]["kind"] = json!("prism")).is_some());
    assert!(changed(&|design| design["encoder"]["lenslets"][0]["weight"] = Value::Null).is_some());
    assert!(changed(&|design| drop(design.as_object_mut().unwrap().remove("objects"))).is_some());
    assert!(changed(&|design| design["limits"]["prism"] = json!(1)).is_some());
}

/// Files of earlier versions have former names of some entries, so they are written again.
#[test]
fn files_of_earlier_versions_validate() {
    let estimate = Schema::open("estimate");
    for name in ["bracket", "full", "gaussian", "gaussian-full", "live", "measured", "pixelcnn"] {
        let read = Estimate::from_json(&read(&format!("estimate-v1-{name}.json"))).unwrap();
        estimate.check(&serde_json::to_value(read).unwrap());
    }
    let study = StudyRecord::open(&golden("study-v1.json")).unwrap();
    Schema::open("study").check(&serde_json::to_value(study).unwrap());
    let of_run = Schema::open("run");
    for name in ["run-v1-density.json", "run-v1-posterior.json", "run-v2-throughput.json"] {
        let Record::Run(run) = Record::open(&golden(name)).unwrap() else { panic!("another record") };
        of_run.check(&serde_json::to_value(run).unwrap());
    }
    let bench = Bench::new();
    let mut live = Vec::new();
    let packed = std::fs::File::open(golden("live-estimate-v1.json.gz")).unwrap();
    flate2::read::GzDecoder::new(packed).read_to_end(&mut live).unwrap();
    bench.write("live.json", live);
    let Record::Live(live) = Record::open(&bench.path("live.json")).unwrap() else { panic!("another record") };
    Schema::open("live-estimate").check(&serde_json::to_value(live).unwrap());
}

#[test]
fn json_of_commands_validates() {
    let bench = Bench::new();
    let check = |name: &str, line: &str| Schema::open(name).check(&bench.json(line));
    check("export-output", "export --out exported");
    check("simulate-output", "simulate --mask heuristic:2 --count 2 --out measured");
    check("tamura-output", "tamura measured/measurements.npy");
    check("bounds-output", "bounds --mask heuristic:2");
    check("bounds-output", "bounds --mask heuristic:2 --noise none");
    let few = "--estimator gaussian --patches-train 100 --patches-test 20";
    check("estimate", &format!("estimate {few} --patch 8"));
    check("estimate", &format!("estimate {few} --patch 8 --measurements measured/measurements.npy"));
    check("reconstruct-output", "reconstruct --mask heuristic:2 --test 2");
    check("reconstruct-output", "reconstruct --decoder network --steps 1 --test 2");
    bench.write("psf.npy", npy("(4, 4)", &(0..16).map(|index| (index % 5) as f32).collect::<Vec<_>>()));
    bench.write("capture.npy", npy("(24, 24)", &(0..576).map(|index| (index * 31 % 97) as f32).collect::<Vec<_>>()));
    check(
        "reconstruct-capture-output",
        "reconstruct --measurement capture.npy --psf psf.npy --dark 0 --decoder richardson-lucy",
    );
    let study = bench.json(&format!(
        "study run grid {few} --objects beads:0.05 --mask heuristic:2 --decoder linear,tv --test 2 --out study"
    ));
    assert_eq!(study["cells"].as_array().unwrap().len(), 2);
    for file in std::fs::read_dir(bench.path("study/cells")).unwrap() {
        let cell = std::fs::read(file.unwrap().path()).unwrap();
        Schema::open("study-cell").check(&serde_json::from_slice(&cell).unwrap());
    }
}

#[test]
fn json_of_runs_validates() {
    let bench = Bench::new();
    let tiny = "optimize --start random:3 --objects beads:0.05 --patch 4 --objective density --score none --steps 1 --out run \
                --config {\"first_fit\":5,\"last_fit\":5}";
    Schema::open("optimize-config")
        .check(&serde_json::from_str(&bench.done(&format!("{tiny} --print-config"))).unwrap());
    Schema::open("optimize-output").check(&bench.json(tiny));
    Schema::open("reproduce-run-output").check(&bench.json("reproduce run/run.json"));
    Schema::open("run").check(&serde_json::from_slice(&std::fs::read(bench.path("run/run.json")).unwrap()).unwrap());
}
