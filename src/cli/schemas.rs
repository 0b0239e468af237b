//! The JSON schemas in `docs/reference/schema`: one for each public file, and one for each JSON on standard output.
//!
//! They describe what this version writes, and are made of the types that write it. That of a design describes what this
//! version reads. `tests/command_line/schemas.rs` compares them with files and outputs.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use super::{bounds, calibrate, export, optimize, reconstruct, reproduce, simulate, tamura};
use crate::camera::CameraFile;
use crate::design::IdealSettings;
use crate::evaluation::Compared;
use crate::forward::Design;
use crate::information::Estimate;
use crate::optics::MASK_DOCUMENT_VERSION;
use crate::studies::StudyRecord;
use crate::studies::plans::CellRecord;
use crate::workbench::{IdealRecord, LiveRecord};

/// Content of a design file.
#[derive(JsonSchema)]
struct DesignFile {
    #[schemars(flatten)]
    _design: Design,
    /// The rendered PSF for other programs: planes of rows of numbers. Opening ignores it.
    #[schemars(rename = "psf")]
    _psf: Option<Vec<Vec<Vec<f64>>>>,
}

/// A schema and the name of its file.
struct Page {
    name: &'static str,
    schema: Value,
}

/// Schema of the JSON that a type is written as.
fn written<T: JsonSchema>(name: &'static str, title: &str) -> Page {
    page::<T>(name, title, SchemaSettings::draft2020_12().for_serialize())
}

fn page<T: JsonSchema>(name: &'static str, title: &str, settings: SchemaSettings) -> Page {
    let mut schema = settings.into_generator().into_root_schema_for::<T>().to_value();
    shorten(&mut schema);
    schema["title"] = json!(title);
    Page { name, schema }
}

/// Leaves the first paragraph of each description, in words of JSON, and leaves out the widths of numbers.
fn shorten(schema: &mut Value) {
    match schema {
        Value::Object(entries) => {
            if let Some(Value::String(text)) = entries.get_mut("description") {
                let first = text.split("\n\n").next().unwrap_or_default();
                *text = first.replace('\n', " ").replace("[`", "`").replace("`]", "`").replace("`None`", "null");
            }
            entries.retain(|name, value| name != "format" || !value.is_string());
            entries.values_mut().for_each(shorten);
        }
        Value::Array(values) => values.iter_mut().for_each(shorten),
        _ => {}
    }
}

/// Versions of files that hold masks: 2 where a throughput is not 1, 3 where the field or the grid of a diffuser is not the published one.
const WITH_MASKS: &[u64] = &[1, 2, MASK_DOCUMENT_VERSION];

/// The schema of a file of a kind, with the two entries that such a file begins with.
fn of_kind(mut page: Page, format: &str, versions: &[u64]) -> Page {
    let schema = &mut page.schema;
    schema["properties"]["format"] = json!({"const": format, "description": "The kind of the file."});
    schema["properties"]["format_version"] = json!({"enum": versions, "description": "Version of the entries."});
    if let Some(Value::Array(required)) = schema.get_mut("required") {
        required.retain(|name| name != "format" && name != "format_version");
        required.splice(0..0, [json!("format"), json!("format_version")]);
    }
    page
}

fn pages() -> Vec<Page> {
    let design = page::<DesignFile>("design", "A design", SchemaSettings::draft2020_12().for_deserialize());
    vec![
        of_kind(design, "lenslet-studio/design", WITH_MASKS),
        of_kind(written::<Estimate>("estimate", "The JSON of estimate"), "lenslet-studio/estimate", &[1]),
        of_kind(written::<CellRecord>("study-cell", "A cell of a study"), "lenslet-studio/study-cell", &[1]),
        of_kind(
            written::<StudyRecord>("study", "study.json, the comparison of a run"),
            "lenslet-studio/study",
            WITH_MASKS,
        ),
        of_kind(
            written::<Compared>("system-comparison", "The JSON of estimate for several systems"),
            "lenslet-studio/system-comparison",
            &[1],
        ),
        of_kind(written::<IdealRecord>("run", "run.json, the record of a run"), "lenslet-studio/ideal", WITH_MASKS),
        of_kind(
            written::<LiveRecord>("live-estimate", "The record of a live estimate"),
            "lenslet-studio/live-estimate",
            WITH_MASKS,
        ),
        of_kind(written::<CameraFile>("camera", "A camera file"), "lenslet-studio/camera", &[1]),
        of_kind(
            written::<calibrate::Calibrated>("calibrate-output", "The JSON of calibrate"),
            "lenslet-studio/camera",
            &[1],
        ),
        written::<IdealSettings>("optimize-config", "The JSON of optimize --print-config"),
        written::<export::Exported>("export-output", "The JSON of export"),
        written::<simulate::Measured>("simulate-output", "The JSON of simulate"),
        written::<bounds::DesignBounds>("bounds-output", "The JSON of bounds"),
        written::<optimize::Outcome<'_>>("optimize-output", "The JSON of optimize"),
        written::<reconstruct::TestResult>("reconstruct-output", "The JSON of reconstruct for a design"),
        written::<reconstruct::CaptureResult>("reconstruct-capture-output", "The JSON of reconstruct for a capture"),
        written::<reproduce::RepeatedRun<'_>>("reproduce-run-output", "The JSON of reproduce for a run"),
        written::<reproduce::RepeatedEstimate>("reproduce-live-output", "The JSON of reproduce for a live estimate"),
        written::<tamura::Summary>("tamura-output", "The JSON of tamura"),
    ]
}

fn reference() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference")
}

/// With `UPDATE_DOCS` set the files are written.
#[test]
fn schemas_are_up_to_date() {
    let folder = reference().join("schema");
    for Page { name, schema } in pages() {
        let path = folder.join(format!("{name}.schema.json"));
        let text = serde_json::to_string_pretty(&schema).unwrap() + "\n";
        if std::env::var_os("UPDATE_DOCS").is_some() {
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(&path, &text).unwrap();
        }
        let found = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(found == text, "{} is out of date: run this test with UPDATE_DOCS=1", path.display());
    }
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), pages().len());
}

/// The objects with properties in a schema.
fn objects(schema: &Value) -> Vec<&Map<String, Value>> {
    match schema {
        Value::Object(entries) => {
            let own = Some(entries).filter(|entries| entries.get("properties").is_some_and(Value::is_object));
            own.into_iter().chain(entries.values().flat_map(objects)).collect()
        }
        Value::Array(values) => values.iter().flat_map(objects).collect(),
        _ => Vec::new(),
    }
}

#[test]
fn every_entry_is_explained() {
    let text = std::fs::read_to_string(reference().join("files.md")).unwrap();
    let settings = std::fs::read_to_string(reference().join("settings.md")).unwrap();
    for Page { name, schema } in pages() {
        assert!(text.contains(&format!("schema/{name}.schema.json")), "files.md has no link to the schema of {name}");
        for object in objects(&schema) {
            let entries = object["properties"].as_object().unwrap();
            // The doc comment of a variant is that of its only entry.
            let is_variant = entries.len() == 1 && object.contains_key("description");
            for (entry, value) in entries {
                let is_explained = is_variant || value.get("description").is_some() || value.get("const").is_some();
                assert!(is_explained, "{name}: {entry} has no doc comment");
                // Entries of the recipe and the start of a live estimate are for the program alone.
                let is_named = [&text, &settings].iter().any(|page| page.contains(entry.as_str()));
                assert!(is_named || name.contains("live"), "{name}: files.md has no {entry}");
            }
        }
    }
}
