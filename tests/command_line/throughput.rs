//! The flag `--throughput`, in results and files.

use lenslet_studio::formats::read_array;
use serde_json::Value;

use super::Bench;

/// Sum of an exported PSF.
fn sum(bench: &Bench, folder: &str) -> f64 {
    read_array(&bench.path(folder).join("psf.npy")).unwrap().iter().map(|&value| f64::from(value)).sum()
}

#[test]
fn bounds_of_a_dim_mask_are_those_of_less_light() {
    let bench = Bench::new();
    let bounds = |flags: &str| bench.json(&format!("bounds --mask heuristic:2 {flags}"));
    let (little, dim) = (bounds("--mean-photons 25"), bounds("--throughput 0.25"));
    assert_eq!(little["information"], dim["information"]);
    assert_eq!((&little["throughput"], &dim["throughput"]), (&Value::from(1.0), &Value::from(0.25)));
    assert_eq!(dim["encoder"], "2 lenslets, throughput 0.25");
    let estimate = "estimate --estimator gaussian-analytic --patch 8 --patches-test 20 --throughput 0.25";
    assert_eq!(bench.json(estimate)["throughput"], 0.25);
}

#[test]
fn exported_psf_sums_to_the_throughput() {
    let bench = Bench::new();
    let export = |flags: &str| {
        let result = bench.json(&format!("export {flags} --out a"));
        let throughput = result["throughput"].as_f64().unwrap();
        assert!((sum(&bench, "a") - throughput).abs() < 1e-4 * throughput, "{flags}");
        throughput
    };
    let [blocked, kept, dim, deep, shared] = [
        "--mask diffuser:8",
        "--mask diffuser:8 --throughput 1",
        "--mask heuristic:3 --throughput 0.3",
        "--mask depth:4",
        "--mask depth:4 --throughput 1",
    ]
    .map(export);
    assert!((0.02..0.2).contains(&blocked), "{blocked}");
    assert_eq!([kept, dim, deep, shared], [1.0, 0.3, 4.0, 1.0]);
    // A design keeps its throughput; an image of a PSF does not tell it.
    bench.done("export --mask diffuser:8 --out b");
    bench.done("export b/design.json --out c");
    assert_eq!(sum(&bench, "b"), sum(&bench, "c"));
    bench.done("export --mask psf:b/psf.npy --out d");
    assert!((sum(&bench, "d") - 1.0).abs() < 1e-5);
}

#[test]
fn throughputs_out_of_range_are_refused() {
    let bench = Bench::new();
    for (line, part) in [
        ("bounds --throughput 0", "the throughput is 0.0; expected 0.000001 to 64"),
        ("bounds --mask diffuser:8 --throughput 1.5", "the throughput is 1.5; expected 0.000001 to 1"),
        ("optimize --start heuristic:2 --throughput 65 --out out", "expected 0.000001 to 64"),
        ("bounds --mask depth:6", "1 to 5"),
    ] {
        let sentence = bench.refused(line);
        assert!(sentence.contains(part), "{line}: {sentence}");
    }
    assert!(bench.files().is_empty());
}
