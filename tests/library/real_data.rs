//! Measurements, sparsity and information of real images and captures, where those are available.

use std::path::Path;

use lenslet_studio::evaluation::{DensityModel, EstimateRequest, WeightsFiles, estimate};
use lenslet_studio::formats::read_stack;
use lenslet_studio::forward::{Design, ForwardModel};
use lenslet_studio::information::{Estimate, Protocol};
use lenslet_studio::optics::{Encoder, heuristic_layout};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::sensor::Noise;
use lenslet_studio::sparsity::tamura_of_stack;
use lenslet_studio::workbench::{MeasurementFormat, measure_into};

const SETS: [(&str, &str); 3] = [
    ("MNIST", "idx:mnist/t10k-images-idx3-ubyte.gz"),
    ("Fashion-MNIST", "idx:fashion-mnist/sprite900-images-idx3-ubyte.gz"),
    ("CIFAR-10", "cifar:cifar-10-batches-bin/test_batch.bin"),
];

/// A design with a real image set; `None` without it, reported once.
fn design(source: &str, lenslets: usize) -> Option<Design> {
    let (kind, name) = source.split_once(':').unwrap();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !path.exists() {
        println!("skipped: ../shared is absent");
        return None;
    }
    let objects = format!("{kind}:{}", path.display()).parse().unwrap();
    Some(Design { objects, encoder: Encoder::Lenslets(heuristic_layout(lenslets)), ..Design::default() })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn estimated(design: &Design, model: DensityModel) -> Estimate {
    let request = EstimateRequest {
        model,
        protocol: Protocol::Default,
        patch: Some((16, 16)),
        patches_train: 1500,
        patches_test: 500,
        fresh: false,
        trials: 1,
        keep: None,
        weights: WeightsFiles::default(),
    };
    estimate(design, &request, &mut CancelToken::new()).unwrap()
}

#[test]
fn measurements_keep_the_photons_of_their_objects() {
    let folder = tempfile::tempdir().unwrap();
    for (name, source) in SETS {
        let Some(design) = design(source, 4) else { return };
        let forward = ForwardModel::open(&design).unwrap();
        let written =
            measure_into(folder.path(), &design, &forward, 150, MeasurementFormat::Npy, &mut CancelToken::new())
                .unwrap();
        assert_eq!(written.object_shape, [150, 96, 96]);
        assert_eq!(written.measurement_shape, [150, 65, 65]);
        let read = |name: &str| read_stack(&folder.path().join(name)).unwrap().into_array().mapv(f64::from);
        let (objects, noiseless, noisy) = (read("objects.npy"), read("noiseless.npy"), read("measurements.npy"));
        let photons = objects.mean().unwrap();
        // 150 mosaics of 9 tiles: the mean over the set is met within the spread of its images.
        assert!((photons - 100.0).abs() < 6.0, "{name}: {photons}");
        let (clean, shot) = (noiseless.mean().unwrap(), noisy.mean().unwrap());
        assert!((clean - photons - 10.0).abs() < 0.15 * photons, "{name}: {clean} from {photons}");
        let spread = (clean / noisy.len() as f64).sqrt();
        assert!((shot - clean).abs() < 5.0 * spread, "{name}: noise shifts {clean} to {shot}");
        let objects_tamura = mean(tamura_of_stack(objects.mapv(|value| value as f32).view()).as_slice().unwrap());
        let sensor = mean(&written.tamura);
        println!("{name}: Tamura coefficient of objects {objects_tamura:.3}, of measurements {sensor:.3}");
        assert!((0.6..2.0).contains(&objects_tamura) && (0.6..1.2).contains(&sensor), "{name}");
        assert!(sensor < objects_tamura, "{name}: blur and noise even out gradients");
    }
}

#[test]
fn estimates_are_finite_and_fitted_bounds_agree_with_the_analytic_one() {
    for (name, source) in SETS {
        for lenslets in [1, 9] {
            let Some(design) = design(source, lenslets) else { return };
            let fitted = estimated(&design, DensityModel::Stationary);
            let analytic = estimated(&design, DensityModel::Analytic);
            println!(
                "{name}, {lenslets} lenslets: stationary {:.3}, analytic {:.3}",
                fitted.bits_per_pixel, analytic.bits_per_pixel
            );
            for estimate in [&fitted, &analytic] {
                let bits = estimate.bits_per_pixel;
                assert!(bits.is_finite() && bits > 0.0 && bits < 3.0, "{name}: {bits}");
                assert!(estimate.ceiling.is_none(), "{name}: the entropy of real images is not known");
                assert!(estimate.interval_95[0] <= bits && bits <= estimate.interval_95[1]);
            }
            // Both are cross-entropies of Gaussians with nearly the same covariance.
            assert!((fitted.bits_per_pixel - analytic.bits_per_pixel).abs() < 0.25, "{name}, {lenslets} lenslets");
            let louder =
                estimated(&Design { noise: Noise::ShotRead { sigma: 20.0 }, ..design }, DensityModel::Analytic);
            assert!(louder.bits_per_pixel < analytic.bits_per_pixel, "{name}: more noise, less information");
        }
    }
}

/// Natural images are dense: overlapping copies blur each other. So one lenslet gives more information than nine (Kabuli
/// et al. 2026).
#[test]
fn one_lenslet_is_better_than_nine_for_natural_images() {
    let Some((one, nine)) = design(SETS[2].1, 1).zip(design(SETS[2].1, 9)) else { return };
    let bits = |design: &Design| estimated(design, DensityModel::Stationary).bits_per_pixel;
    let (one, nine) = (bits(&one), bits(&nine));
    assert!(one > nine + 0.05, "{one} against {nine}");
}

#[test]
fn captures_are_whole_objects_and_the_diffuser_evens_them_out() {
    let mut coefficients = Vec::new();
    for folder in ["lensed", "diffuser"] {
        let Some(design) = design(&format!("images:captures/{folder}"), 3) else { return };
        let forward = ForwardModel::open(&design).unwrap();
        assert_eq!((forward.set.base_images(), forward.set.field()), (Some(9), (96, 96)));
        let simulated = forward.simulate(forward.psf(&design).unwrap().view(), 0..9, design.seed).unwrap();
        assert_eq!(simulated.noisy.dim(), (9, 65, 65));
        let photons = simulated.objects.mapv(f64::from).mean().unwrap();
        assert!((photons - 100.0).abs() < 1e-3, "{folder}: nine of nine captures have the mean asked for, {photons}");
        assert!(simulated.noiseless.iter().all(|&value| value >= 10.0));
        let objects = simulated.objects.index_axis(ndarray::Axis(1), 0);
        let tamura = mean(tamura_of_stack(objects).as_slice().unwrap());
        println!("{folder}: Tamura coefficient {tamura:.3}");
        assert!((0.5..2.0).contains(&tamura));
        coefficients.push(tamura);
        let estimate = estimated(&design, DensityModel::Stationary);
        println!("{folder}: {:.3} bits per pixel, notes {:?}", estimate.bits_per_pixel, estimate.notes);
        assert!(estimate.bits_per_pixel.is_finite() && estimate.entropy_y > 0.0);
    }
    assert!(coefficients[1] < coefficients[0], "{coefficients:?}");
}
