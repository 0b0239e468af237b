//! Design files of every version can be opened, and identify themselves to readers that cannot open them.

use std::path::{Path, PathBuf};

use lenslet_studio::forward::Design;
use lenslet_studio::objects::{ObjectSource, Placement};
use lenslet_studio::optics::{Encoder, Limits, Spot};
use lenslet_studio::sensor::Noise;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use serde_json::{Value, json};

/// Files of every version of the format. They are never changed: every file that once opened must always open.
const VERSIONS: [&str; 8] = [
    "design-v1.json",
    "design-v1-volume.json",
    "design-v1-diffuser.json",
    "design-v1-picture.json",
    "design-v2-throughput.json",
    "design-v2-diffuser.json",
    "design-v3-field.json",
    "design-v3-diffuser.json",
];

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn json_of(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn version_1_opens_with_every_value() {
    let design = Design::open(&data("design-v1.json")).unwrap();
    let Encoder::Lenslets(array) = &design.encoder else { panic!("{:?}", design.encoder) };
    assert_eq!((array.rows, array.cols, array.lenslets.len()), (8, 10, 2));
    let [round, oval] = &array.lenslets[..] else { panic!() };
    assert_eq!((round.x, round.y, round.spot, round.weight, round.plane), (2.25, 4.5, Spot::Isotropic(0.8), 0.75, 0));
    assert_eq!(oval.spot, Spot::Anisotropic { xx: 1.5, xy: -0.25, yy: 0.75 });
    assert_eq!(design.objects, ObjectSource::Beads { density: 0.02 });
    assert_eq!(design.noise, Noise::ShotRead { sigma: 2.5 });
    assert_eq!((design.mean_photons, design.bias_photons, design.seed), (100.0, 10.0, u64::MAX));
    assert_eq!(design.limits, Limits { min_sigma_px: 0.775, central_share: 0.8 });

    let volume = Design::open(&data("design-v1-volume.json")).unwrap();
    assert_eq!(volume.psf(1).unwrap().dim(), (3, 8, 8));
    assert_eq!(volume.objects, ObjectSource::Volume { planes: 3, density: 0.01 });
    assert_eq!(volume.noise, Noise::Read { sigma: 5.0 });
    assert_eq!(volume.limits, Limits::default(), "an early file without limits has the published ones");

    let diffuser = Design::open(&data("design-v1-diffuser.json")).unwrap();
    assert!(
        matches!(diffuser.encoder, Encoder::Diffuser(diffuser) if (diffuser.aperture_px, diffuser.seed) == (12, 3))
    );
    assert_eq!(diffuser.encoder.throughput(), 1.0, "files without a throughput keep the light");
    assert_eq!(diffuser.objects, ObjectSource::Idx("train images.gz".into()));

    let imported = Design::open(&data("design-v1-picture.json")).unwrap();
    let Encoder::Image(image) = &imported.encoder else { panic!("{:?}", imported.encoder) };
    assert_eq!((image.origin.as_str(), image.psf.dim(), image.psf[[1, 2]]), ("camera.tiff", (2, 3), 0.375));
    assert_eq!((imported.objects, imported.noise), (ObjectSource::Stack("scenes.npy".into()), Noise::None));
}

#[test]
fn version_2_opens_with_its_throughput() {
    let volume = Design::open(&data("design-v2-throughput.json")).unwrap();
    assert_eq!(volume.encoder.throughput(), 2.0);
    assert!((volume.psf(2).unwrap().sum() - 2.0).abs() < 1e-12);
    let diffuser = Design::open(&data("design-v2-diffuser.json")).unwrap();
    let kept = Design::open(&data("design-v1-diffuser.json")).unwrap();
    assert_eq!(diffuser.encoder.with_throughput(1.0), kept.encoder);
}

#[test]
fn version_3_opens_with_its_sizes() {
    let design = Design::open(&data("design-v3-field.json")).unwrap();
    assert_eq!((design.field, design.encoder.grid()), ((192, 256), (64, 48)));
    assert_eq!((design.placement, design.pixel_pitch_um), (Placement::Tiled, Some(3.45)));
    let diffuser = Design::open(&data("design-v3-diffuser.json")).unwrap();
    assert_eq!((diffuser.encoder.grid(), diffuser.field), ((48, 48), (96, 96)));
    assert!((diffuser.psf(1).unwrap().sum() - 0.25).abs() < 1e-12);
}

#[test]
fn version_3_is_written_only_where_earlier_programs_would_compute_other_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.json");
    let own = Design::open(&data("design-v1.json")).unwrap();
    let pitch = Design { pixel_pitch_um: Some(2.0), ..own.clone() };
    let large = Design { field: (96, 100), ..own.clone() };
    let cropped = Design { placement: Placement::Cropped, ..own.clone() };
    for (design, version) in [(own, 1), (pitch, 1), (large, 3), (cropped, 3)] {
        design.save(&path).unwrap();
        assert_eq!(json_of(&path)["format_version"], version);
        assert_eq!(Design::open(&path).unwrap(), design);
    }
}

/// Earlier programs saved such designs before the objects that have the size.
#[test]
fn designs_whose_field_is_too_small_open_and_are_refused_when_computed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.json");
    let mut value = json_of(&data("design-v1.json"));
    value["encoder"]["rows"] = json!(200);
    std::fs::write(&path, value.to_string()).unwrap();
    let design = Design::open(&path).unwrap();
    assert!(design.check().unwrap_err().to_string().contains("at least the 200 x 10 px"));
}

#[test]
fn version_2_is_written_only_where_programs_of_version_1_would_misread_the_light() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.json");
    let kept = Design::open(&data("design-v1.json")).unwrap();
    let dim = Design { encoder: kept.encoder.clone().with_throughput(0.5), ..kept.clone() };
    for (design, version) in [(kept, 1), (dim, 2)] {
        design.save(&path).unwrap();
        assert_eq!(json_of(&path)["format_version"], version);
        let line: Value = serde_json::from_str(&design.to_json().unwrap()).unwrap();
        assert_eq!(line["format_version"], version);
    }
}

#[test]
fn throughputs_out_of_range_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.json");
    let mut value = json_of(&data("design-v2-diffuser.json"));
    value["encoder"]["throughput"] = json!(1.5);
    std::fs::write(&path, value.to_string()).unwrap();
    let refusal = Design::open(&path).unwrap_err().to_string();
    assert!(refusal.contains("the throughput is 1.5; expected 0.000001 to 1"), "{refusal}");
}

#[test]
fn what_is_opened_is_saved_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    for name in VERSIONS {
        let design = Design::open(&data(name)).unwrap();
        let (once, twice) = (folder.path().join("once.json"), folder.path().join("twice.json"));
        design.save(&once).unwrap();
        let again = Design::open(&once).unwrap();
        assert_eq!(again, design, "{name}");
        again.save(&twice).unwrap();
        assert!(std::fs::read(&once).unwrap() == std::fs::read(&twice).unwrap(), "{name}");
        // The saved file has all entries of the old one, under names that older readers know.
        let (old, new) = (json_of(&data(name)), json_of(&once));
        for (key, value) in old.as_object().unwrap() {
            if key != "psf" {
                assert_eq!(&new[key], value, "{name}: {key}");
            }
        }
    }
}

#[test]
fn the_psf_for_other_programs_is_the_one_that_opening_renders() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.json");
    for name in VERSIONS {
        let design = Design::open(&data(name)).unwrap();
        design.save(&path).unwrap();
        let psf: Vec<Vec<Vec<f64>>> = serde_json::from_value(json_of(&path)["psf"].clone()).unwrap();
        let values: Vec<f64> = psf.into_iter().flatten().flatten().collect();
        assert_eq!(values, design.psf(1).unwrap().iter().copied().collect::<Vec<_>>(), "{name}");
        assert!((values.iter().sum::<f64>() - design.encoder.throughput()).abs() < 1e-6);
    }
    let text = std::fs::read_to_string(&path).unwrap();
    let (format, version) = (text.find("\"format\"").unwrap(), text.find("\"format_version\"").unwrap());
    assert!(format < version && text[..format].trim() == "{", "format and version come first");
}

#[test]
fn unknown_entries_are_ignored_and_newer_versions_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.json");
    let mut value = json_of(&data("design-v1.json"));
    value["comment"] = json!("by another program");
    value["psf"] = json!("not looked at");
    std::fs::write(&path, value.to_string()).unwrap();
    assert_eq!(Design::open(&path).unwrap(), Design::open(&data("design-v1.json")).unwrap());

    value["format_version"] = json!(4);
    value["encoder"] = json!({"kind": "of the future"});
    std::fs::write(&path, value.to_string()).unwrap();
    let told = Design::open(&path).unwrap_err().to_string();
    assert!(told.starts_with(&path.display().to_string()) && !told.contains('\n'), "{told}");
    assert!(told.contains("version 4, written by a newer Lenslet Studio; update this program"), "{told}");
}

#[test]
fn a_lenslet_that_is_none_is_named_by_its_number() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.json");
    let told = |entry: &str, content: Value| {
        let mut value = json_of(&data("design-v1.json"));
        value["encoder"]["lenslets"][1] = json!({"x_px": 3.0, "y_px": 4.0, "sigma_px": 1.0, "weight": 1.0});
        value["encoder"]["lenslets"][1][entry] = content;
        std::fs::write(&path, value.to_string()).unwrap();
        Design::open(&path).unwrap_err().to_string()
    };
    let refusal = told("x_px", json!("left"));
    assert!(refusal.contains("found lenslet 2: ") && refusal.contains("left"), "{refusal}");
    let refusal = told("covariance_px2", json!({"xx": 1.0, "xy": 0.0, "yy": 1.0}));
    assert!(refusal.contains("found lenslet 2: both sigma_px and covariance_px2"), "{refusal}");
}

/// Every place of a JSON value, the outermost first.
fn places(value: &Value, path: &str, found: &mut Vec<String>) {
    found.push(path.to_owned());
    match value {
        Value::Object(entries) => {
            entries.iter().for_each(|(key, entry)| places(entry, &format!("{path}/{key}"), found));
        }
        Value::Array(entries) => {
            entries.iter().enumerate().for_each(|(index, entry)| places(entry, &format!("{path}/{index}"), found));
        }
        _ => {}
    }
}

fn any_value() -> impl Strategy<Value = Value> {
    let number = prop_oneof![
        any::<f64>().prop_map(|value| json!(value)),
        any::<i64>().prop_map(|value| json!(value)),
        any::<u64>().prop_map(|value| json!(value)),
        prop::sample::select(vec![0.0, -0.0, 1e-300, 1e300, -1.0, 0.1, 1000.0, 1e9, 31.5, 1e-5]).prop_map(|v| json!(v)),
        (0..70_u64).prop_map(|value| json!(value)),
    ];
    let text = prop_oneof![
        "\\PC{0,8}",
        "(beads|beads-max|volume|read|shot[+]read|stack):[0-9.e-]{0,6}",
        prop::sample::select(vec!["shot", "none", "lenslets", "diffuser", "image", ""]).prop_map(str::to_owned),
    ];
    prop_oneof![
        6 => number,
        2 => text.prop_map(Value::from),
        1 => prop::sample::select(vec![json!(null), json!(true), json!([]), json!({}), json!([[]]), json!([[1, 2], [3]])]),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 400,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(20_260_302),
        ..ProptestConfig::default()
    })]

    /// A file with an arbitrary value at any place is refused in one sentence, or is a design that can be rendered and
    /// saved.
    #[test]
    fn changed_files_are_refused_or_are_designs(
        name in prop::sample::select(VERSIONS.to_vec()),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any_value(), any::<bool>()), 1..3),
    ) {
        let mut value = json_of(&data(name));
        for (place, new, removed) in changes {
            let mut found = Vec::new();
            places(&value, "", &mut found);
            let place = found[place.index(found.len())].clone();
            let (parent, key) = place.rsplit_once('/').unwrap_or(("", ""));
            match value.pointer_mut(parent).and_then(Value::as_object_mut) {
                Some(entries) if removed => {
                    entries.remove(key);
                }
                _ => *value.pointer_mut(&place).unwrap() = new,
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        std::fs::write(&path, value.to_string()).unwrap();
        match Design::open(&path) {
            Err(error) => {
                let told = error.to_string();
                prop_assert!(told.starts_with(&path.display().to_string()) && !told.contains('\n'), "{told}");
                prop_assert!(told.len() < path.as_os_str().len() + 400, "{told}");
            }
            Ok(design) => {
                let psf = design.psf(1).unwrap();
                prop_assert!(psf.iter().all(|value| value.is_finite() && *value >= 0.0));
                let ratio = psf.sum() / design.encoder.throughput();
                prop_assert!((ratio - 1.0).abs() < 1e-5, "{} from {value}", psf.sum());
                design.save(&path).unwrap();
                prop_assert_eq!(Design::open(&path).unwrap(), design);
            }
        }
    }
}
