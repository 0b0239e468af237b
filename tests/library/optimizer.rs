//! Runs of IDEAL: a case with a known optimum, equal runs, interrupted runs, and their records.

use std::ops::ControlFlow;

use lenslet_studio::design::{
    Checkpoint, Free, IdealError, IdealEvent, IdealOptimizer, IdealProgress, IdealSettings, IdealState, Objective,
    Preset, merged,
};
use lenslet_studio::formats::write_array;
use lenslet_studio::forward::{Design, ForwardModel};
use lenslet_studio::information::{InformationError, NoiseEntropy, PatchBatch, Protocol, binary_entropy, score};
use lenslet_studio::objects::{ObjectOptions, ObjectSet, ObjectSource, Split};
use lenslet_studio::optics::{Encoder, Lenslet, LensletArray, Limits, Spot, render_psf};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::seeds::SeedStream;
use lenslet_studio::sensor::{Noise, Patches};
use lenslet_studio::workbench::run_ideal;
use ndarray::{Array3, ArrayView3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Small bead objects for a small sensor.
fn beads(density: f64) -> ObjectSet {
    let options = ObjectOptions { field: (27, 27), mean_photons: 100.0, ..ObjectOptions::default() };
    ObjectSet::open(&format!("beads:{density}").parse().unwrap(), &options).unwrap()
}

fn mask(lenslets: Vec<Lenslet>) -> LensletArray {
    LensletArray::new(12, 12, lenslets)
}

/// A poor start of two lenslets.
fn two() -> LensletArray {
    mask(vec![Lenslet::round(3.0, 4.0, 1.6, 0.7), Lenslet::round(8.0, 7.5, 1.2, 0.3)])
}

fn settings() -> IdealSettings {
    IdealSettings {
        steps: 12,
        objects: 6,
        patches: 8,
        patch: Some((8, 8)),
        refit_every: 4,
        first_fit: 60,
        refit: 20,
        last_fit: 60,
        ..IdealSettings::new(Preset::Default, Objective::Density, 3)
    }
}

/// A run of the same length with the posterior objective.
fn up_the_posterior() -> IdealSettings {
    let IdealSettings { steps, patch, refit_every, first_fit, refit, last_fit, .. } = settings();
    let usual = IdealSettings::new(Preset::Default, Objective::Posterior, 3);
    IdealSettings {
        steps,
        patches: 8,
        patch,
        refit_every,
        first_fit,
        refit,
        last_fit,
        relocation_candidates: 6,
        ..usual
    }
}

/// A short run of the published procedure.
fn up_a_pixelcnn() -> IdealSettings {
    let IdealSettings { steps, patch, refit_every, .. } = settings();
    let (first_fit, refit, last_fit) = (6, 6, 6);
    let paper = IdealSettings::new(Preset::Paper, Objective::PixelCnn, 3);
    IdealSettings { steps, objects: 6, patches: 8, patch, refit_every, first_fit, refit, last_fit, ..paper }
}

fn forward_model(set: &ObjectSet) -> ForwardModel {
    ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap()
}

fn run<'a>(forward: &'a ForwardModel, start: &LensletArray, settings: IdealSettings) -> IdealOptimizer<'a> {
    let mut ideal = IdealOptimizer::new(forward, start, Limits::default(), settings).unwrap();
    while !ideal.is_finished() {
        ideal.advance(&mut CancelToken::new()).unwrap();
    }
    ideal
}

/// A factor that is a power of two changes no digit.
#[test]
fn dim_mask_is_optimized_as_at_less_light_and_keeps_its_throughput() {
    for settings in [settings(), up_the_posterior()] {
        let settings = IdealSettings { steps: 4, first_fit: 20, last_fit: 10, ..settings };
        let state = |mean_photons: f64, throughput: f64| {
            let options = ObjectOptions { field: (27, 27), mean_photons, ..ObjectOptions::default() };
            let forward = forward_model(&ObjectSet::open(&"beads:0.05".parse().unwrap(), &options).unwrap());
            run(&forward, &two().with_throughput(throughput), settings.clone()).state().clone()
        };
        let (bright, dim) = (state(100.0, 1.0), state(400.0, 0.25));
        assert!(dim.checkpoints.iter().all(|checkpoint| checkpoint.array.throughput == 0.25));
        let path = |state: &IdealState| {
            let step = |checkpoint: &Checkpoint| (checkpoint.array.lenslets.clone(), checkpoint.bits_per_pixel);
            state.checkpoints.iter().map(step).collect::<Vec<_>>()
        };
        assert_eq!(path(&bright), path(&dim), "{:?}", settings.objective);
        assert_ne!(dim.array.lenslets, two().lenslets);
    }
}

#[test]
fn one_lenslet_before_points_becomes_as_sharp_as_it_may() {
    let set = beads(0.03);
    let forward = forward_model(&set);
    let settings = IdealSettings {
        steps: 300,
        refit_every: 5,
        first_fit: 150,
        rates: lenslet_studio::design::Rates { position: 0.02, variance: 0.03, weight: 1e-3, relative_weight: 0.0 },
        ..settings()
    };
    let ideal = run(&forward, &mask(vec![Lenslet::round(5.5, 5.5, 1.7, 1.0)]), settings);
    let state = ideal.state();
    let (first, last) = (state.checkpoints.first().unwrap(), state.checkpoints.last().unwrap());
    assert!((last.array.lenslets[0].spot.mean_sigma() - 0.775).abs() < 0.02, "{:?}", last.array);
    assert!(last.interval_95[0] > first.interval_95[1] + 0.05, "{first:?} {last:?}");
    assert!((last.array.lenslets[0].weight - 1.0).abs() < 1e-12);
    // Every fifth checkpoint and the last also have a lower bound. So the gain does not come from a loose upper bound.
    for (index, checkpoint) in state.checkpoints.iter().enumerate() {
        let due = index % 5 == 0 || index + 1 == state.checkpoints.len();
        assert_eq!(checkpoint.lower.is_some(), due, "checkpoint {index}");
        assert!(
            checkpoint.lower.is_none_or(|lower| lower.interval_95[0] < checkpoint.interval_95[1]),
            "{checkpoint:?}"
        );
    }
    let (first, last) = (first.lower.unwrap(), last.lower.unwrap());
    assert!(last.interval_95[0] > first.interval_95[1], "{first:?} {last:?}");
}

#[test]
#[ignore = "takes a minute or more; run with --ignored"]
fn one_lenslet_before_gaussian_objects_becomes_as_sharp_as_it_may() {
    // Every measurement of white Gaussian objects is nearly Gaussian. Its information only decreases as the lenslet
    // widens.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("objects.npy");
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let normal = Normal::new(100.0_f32, 30.0).unwrap();
    let objects = ndarray::Array3::from_shape_simple_fn((400, 27, 27), || normal.sample(&mut random).max(0.0));
    lenslet_studio::formats::write_array(&path, objects.view()).unwrap();
    let options = ObjectOptions { field: (27, 27), mean_photons: 100.0, ..ObjectOptions::default() };
    let set = ObjectSet::open(&ObjectSource::Stack(path), &options).unwrap();
    let forward = forward_model(&set);
    let settings = IdealSettings {
        steps: 200,
        refit_every: 5,
        first_fit: 150,
        rates: lenslet_studio::design::Rates { position: 0.02, variance: 0.05, weight: 1e-3, relative_weight: 0.0 },
        ..settings()
    };
    let ideal = run(&forward, &mask(vec![Lenslet::round(5.5, 5.5, 1.7, 1.0)]), settings);
    let (first, last) = (ideal.state().checkpoints.first().unwrap(), ideal.state().checkpoints.last().unwrap());
    assert!((last.array.lenslets[0].spot.mean_sigma() - 0.775).abs() < 0.02, "{:?}", last.array);
    // Information of a Gaussian of the same covariance, in closed form.
    let known = forward.analytic_moments(Split::All, (12, 12), (8, 8)).unwrap();
    let truth = |array: &LensletArray| {
        let psf = render_psf(array, 1).unwrap();
        let (signal, noise) = (900.0 * psf.iter().map(|p| p * p).sum::<f64>(), 110.0);
        let moments = known.of(psf.view()).unwrap();
        assert!((moments.mean - 110.0).abs() < 0.5, "{}", moments.mean);
        0.5 * (1.0 + signal / noise).log2()
    };
    assert!(last.bits_per_pixel > first.bits_per_pixel + 0.1, "{first:?} {last:?}");
    // Value for independent pixels; neighbours share light.
    for checkpoint in [first, last] {
        assert!(checkpoint.interval_95[0] < truth(&checkpoint.array) + 0.02, "{checkpoint:?}");
    }
}

#[test]
#[ignore = "takes a minute or more; run with --ignored"]
fn the_posterior_leads_to_the_same_optimum_within_the_ceiling() {
    let set = beads(0.03);
    let forward = forward_model(&set);
    let rates = lenslet_studio::design::Rates { position: 0.02, variance: 0.1, weight: 1e-3, relative_weight: 0.0 };
    // Gradients from fewer scenes are so noisy that the last digits of sums decide the end of such a run.
    let relocation_candidates = IdealSettings::new(Preset::Default, Objective::Posterior, 3).relocation_candidates;
    let settings =
        IdealSettings { steps: 200, patches: 256, refit_every: 20, rates, relocation_candidates, ..up_the_posterior() };
    let ideal = run(&forward, &mask(vec![Lenslet::round(5.5, 5.5, 1.7, 1.0)]), settings);
    let (first, last) = (ideal.state().checkpoints.first().unwrap(), ideal.state().checkpoints.last().unwrap());
    assert!((last.array.lenslets[0].spot.mean_sigma() - 0.775).abs() < 0.05, "{:?}", last.array);
    assert!(last.interval_95[0] > first.interval_95[1], "{first:?} {last:?}");
    let psf = render_psf(&last.array, 1).unwrap();
    let channel = forward.bead_channel(psf.view(), (8, 8)).unwrap();
    let (rows, cols) = (channel.spot.dim().1, channel.spot.dim().2);
    let sites = ((8 + rows - 1) * (8 + cols - 1)) as f64;
    assert!(last.interval_95[1] < sites / 64.0 * binary_entropy(0.03), "{last:?}");
    // A run on the lower bound has no further lower bounds, and no density model.
    assert!(
        ideal.state().checkpoints.iter().all(|checkpoint| checkpoint.lower.is_none())
            && ideal.density_model().is_none()
    );
}

#[test]
fn the_published_procedure_sharpens_a_lenslet_too() {
    let set = beads(0.03);
    let forward = forward_model(&set);
    let rates = lenslet_studio::design::Rates { variance: 0.1, ..up_a_pixelcnn().rates };
    let settings =
        IdealSettings { steps: 40, patches: 64, refit_every: 20, first_fit: 60, refit: 60, rates, ..up_a_pixelcnn() };
    let ideal = run(&forward, &mask(vec![Lenslet::round(5.5, 5.5, 1.7, 1.0)]), settings);
    let (first, last) = (ideal.state().checkpoints.first().unwrap(), ideal.state().checkpoints.last().unwrap());
    let width = |checkpoint: &Checkpoint| checkpoint.array.lenslets[0].spot.mean_sigma();
    assert!(width(last) < width(first) - 0.3, "{last:?}");
    assert!(last.lower.is_some_and(|lower| lower.interval_95[0] < last.interval_95[1]), "{last:?}");
}

#[test]
#[ignore = "takes a minute or more; run with --ignored"]
fn interrupted_runs_go_on_bit_for_bit() {
    let anew = IdealSettings { warm: false, ..settings() };
    for settings in [settings(), anew, up_the_posterior(), up_a_pixelcnn()] {
        goes_on_bit_for_bit(&settings);
    }
}

#[test]
fn equal_runs_are_equal_on_any_number_of_threads() {
    let set = beads(0.05);
    let forward = forward_model(&set);
    for settings in [settings(), up_the_posterior(), up_a_pixelcnn()] {
        let settings = IdealSettings { steps: 3, first_fit: 12, ..settings };
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let state = pool.install(|| run(&forward, &two(), settings.clone()).state().clone());
            let bits: Vec<f64> = state.checkpoints.iter().map(|checkpoint| checkpoint.bits_per_pixel).collect();
            (state.array, bits)
        };
        let alone = on(1);
        assert!(alone.0 != two());
        assert_eq!(on(3), alone, "{:?}", settings.objective);
    }
}

fn goes_on_bit_for_bit(settings: &IdealSettings) {
    let set = beads(0.05);
    let forward = forward_model(&set);
    let settings = || settings.clone();
    let whole = run(&forward, &two(), settings());
    assert_ne!(whole.state().array, two());

    let new = || IdealOptimizer::new(&forward, &two(), Limits::default(), settings()).unwrap();
    let to_its_end = |ideal: &mut IdealOptimizer<'_>| {
        while !ideal.is_finished() {
            ideal.advance(&mut CancelToken::new()).unwrap();
        }
    };
    let mut first = new();
    first.advance(&mut CancelToken::new()).unwrap();
    let bytes = first.to_bytes().unwrap();
    // Steps after the last saved state are lost with the process.
    let mut last = bytes.clone();
    let stopped = loop {
        let told = first.advance(&mut |progress: &IdealProgress<'_>| {
            if progress.state.step == 4 + 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        match told {
            Ok(()) => last = first.to_bytes().unwrap(),
            Err(stopped) => break stopped,
        }
    };
    assert!(matches!(stopped, IdealError::Information(InformationError::Cancelled)));
    assert_eq!(first.state().step, 4 + 2, "a run stops within a step");
    let kept = IdealOptimizer::state_in(&last).unwrap().step;
    assert_eq!(kept, if settings().warm { 4 } else { 4 + 1 }, "where models begin anew every step is kept");
    let bits = |ideal: &IdealOptimizer<'_>| -> Vec<u64> {
        ideal.state().checkpoints.iter().map(|checkpoint| checkpoint.bits_per_pixel.to_bits()).collect()
    };
    let mut resumed = new().resumed(&last).unwrap();
    to_its_end(&mut resumed);
    assert_eq!((&resumed.state().array, bits(&resumed)), (&whole.state().array, bits(&whole)));
    let mut resumed = new().resumed(&bytes).unwrap();
    to_its_end(&mut resumed);
    assert_eq!((&resumed.state().array, bits(&resumed)), (&whole.state().array, bits(&whole)));

    // A run may be extended, but a state of another run is refused.
    resumed.extend_to(16);
    assert!(matches!(resumed.state().events.last(), Some(IdealEvent::Extended { .. })));
    to_its_end(&mut resumed);
    assert_eq!(resumed.state().step, 16);
    let other =
        IdealOptimizer::new(&forward, &two(), Limits::default(), IdealSettings { objects: 7, ..settings() }).unwrap();
    assert!(other.resumed(&bytes).err().unwrap().to_string().contains("another mask, scene or setting"));
    assert!(new().resumed(&bytes[..40]).is_err());
}

/// The value of a checkpoint, recomputed from objects to which neither model nor mask was fitted.
#[test]
fn information_is_told_of_held_out_objects_only() {
    let set = beads(0.05);
    let forward = forward_model(&set);
    let ideal = run(&forward, &two(), IdealSettings { steps: 4, ..settings() });
    let checkpoint = ideal.state().checkpoints.last().unwrap();
    let psf = render_psf(&checkpoint.array, 1).unwrap();
    let convolver = forward.convolver(psf.view()).unwrap();
    let value = |split| {
        let objects = set.objects(split, 128, SeedStream::HeldOutObjects.derive(3)).unwrap();
        let encoded = convolver.measure(objects.view(), 10.0).unwrap();
        let clean =
            Patches::one_each(encoded.dim(), (8, 8), SeedStream::HeldOutPlaces.derive(3)).unwrap().cut(encoded.view());
        let noisy = Noise::Shot.draw(clean.view(), SeedStream::HeldOutNoise.derive(3));
        let entropy = NoiseEntropy::new(Noise::Shot, Protocol::Default).unwrap();
        let test = PatchBatch { noisy, clean: Some(clean) };
        let bits = score(ideal.density_model().unwrap(), &entropy, &test).unwrap().information;
        bits.iter().sum::<f64>() / bits.len() as f64
    };
    assert_eq!(checkpoint.bits_per_pixel, value(Split::Test));
    assert_ne!(checkpoint.bits_per_pixel, value(Split::Train));
}

#[test]
fn only_what_is_free_moves_and_the_wished_number_is_left() {
    let set = beads(0.05);
    let forward = forward_model(&set);
    let start =
        mask((0..5).map(|i| Lenslet::round(2.0 + 1.7 * f64::from(i), 9.0 - 1.3 * f64::from(i), 1.0, 0.2)).collect());
    let free = Free { positions: true, widths: false, weights: false };
    let settings = IdealSettings { free, locked: vec![1], min_separation_px: 1.5, ..settings() };
    let ideal = run(&forward, &start, settings.clone());
    let array = &ideal.state().array;
    assert_eq!(array.lenslets[1], start.lenslets[1]);
    for (after, before) in array.lenslets.iter().zip(&start.lenslets) {
        assert_eq!((after.spot, after.weight), (before.spot, before.weight));
    }
    assert!(array.lenslets.iter().zip(&start.lenslets).filter(|(after, before)| after.x != before.x).count() == 4);

    let ideal = run(&forward, &start, IdealSettings { cardinality: Some(2), free: Free::default(), ..settings });
    let left = merged(&ideal.state().array);
    assert_eq!(left.lenslets.len(), 2, "{left:?}");
    assert!(ideal.state().array.lenslets[1].weight > 0.0, "a locked lenslet is not taken out");
}

#[test]
fn spots_may_become_elliptic() {
    let set = beads(0.05);
    let forward = forward_model(&set);
    let ideal = run(&forward, &two(), IdealSettings { anisotropic: true, steps: 8, ..settings() });
    for lenslet in &ideal.state().array.lenslets {
        let Spot::Anisotropic { .. } = lenslet.spot else { panic!("{lenslet:?}") };
        let (minor, major) = lenslet.spot.principal_sigmas();
        assert!(minor >= 0.775 * (1.0 - 1e-9) && major > minor * (1.0 + 1e-6), "{lenslet:?}");
    }
}

#[test]
fn a_mask_or_setting_that_allows_no_run_is_told() {
    let set = beads(0.05);
    let forward = forward_model(&set);
    let told = |start: &LensletArray, settings: IdealSettings| {
        IdealOptimizer::new(&forward, start, Limits::default(), settings).err().unwrap().to_string()
    };
    assert!(told(&mask(Vec::new()), settings()).contains("no lenslet"));
    assert!(told(&two(), IdealSettings { patches: 0, ..settings() }).contains("patches is 0"));
    let silent = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::None).unwrap();
    let error = IdealOptimizer::new(&silent, &two(), Limits::default(), settings()).err().unwrap().to_string();
    assert!(error.contains("noise"), "{error}");
    let error = IdealOptimizer::new(&silent, &two(), Limits::default(), up_the_posterior()).err().unwrap().to_string();
    assert!(error.contains("without noise"), "{error}");
    let spread = ObjectSet::open(
        &"beads:1".parse().unwrap(),
        &ObjectOptions { field: (27, 27), mean_photons: 100.0, ..ObjectOptions::default() },
    );
    let (known, spread) = (up_the_posterior(), spread.unwrap());
    let full = self::forward_model(&spread);
    let of_unknown = IdealOptimizer::new(&full, &two(), Limits::default(), known).err().unwrap().to_string();
    assert!(of_unknown.contains("objective is posterior"), "{of_unknown}");
}

/// A run does not see the test images of the final comparison. Other test images leave it bit-identical.
#[test]
fn test_images_are_unseen_by_a_run() {
    let folder = tempfile::tempdir().unwrap();
    // Each image has one bright pixel in a row of its own. Its transpose is equally bright.
    let images = |turned: &[usize]| {
        Array3::from_shape_fn((20, 27, 27), |(n, row, col)| {
            let (row, col) = if turned.contains(&n) { (col, row) } else { (row, col) };
            1.0 + ((n * 31 + row * 17 + col * 5) % 11) as f32 + if (row, col) == (n, 13) { 1000.0 } else { 0.0 }
        })
    };
    let design = |name: &str, turned: &[usize]| {
        let path = folder.path().join(name);
        write_array(&path, images(turned).view()).unwrap();
        Design { objects: ObjectSource::Stack(path), encoder: Encoder::Lenslets(two()), ..Design::default() }
    };
    let as_they_are = design("as they are.npy", &[]);
    let set = ObjectSet::open(&as_they_are.objects, &ObjectOptions::default()).unwrap();
    let objects = set.objects(Split::Test, 64, 1).unwrap();
    let bright = |object: ArrayView3<'_, f32>| (0..20).find(|&row| object[[0, row, 13]] > 30.0 * object[[0, 26, 26]]);
    let mut tested: Vec<usize> = objects.outer_iter().map(|object| bright(object).unwrap()).collect();
    tested.sort_unstable();
    tested.dedup();
    assert_eq!(tested.len(), 4);
    let trained: Vec<usize> = (0..20).filter(|index| !tested.contains(index)).collect();
    let result = |design: &Design| {
        let settings = IdealSettings { steps: 4, ..settings() };
        let never = CancelToken::new();
        run_ideal(design, &settings, None, &mut never.clone(), &mut |_| Ok(()), &mut never.clone()).unwrap()
    };
    let told = |design: &Design| {
        let record = result(design);
        (
            record.result.clone(),
            record.checkpoints.iter().map(|checkpoint| checkpoint.bits_per_pixel).collect::<Vec<_>>(),
        )
    };
    let before = told(&as_they_are);
    assert_eq!(told(&design("other tests.npy", &tested)), before);
    assert_ne!(told(&design("other training.npy", &trained)), before);
}

/// Values of a density model overstate the information of sparse beads. The record reports this where it is statistically
/// significant.
#[test]
fn a_run_that_ends_above_the_ceiling_says_so() {
    let design = |density: &str| Design { objects: density.parse().unwrap(), ..Design::default() };
    let settings = IdealSettings { steps: 1, patch: Some((16, 16)), first_fit: 20, last_fit: 20, ..settings() };
    let notices = |design: &Design, settings: &IdealSettings| {
        let never = CancelToken::new();
        run_ideal(design, settings, None, &mut never.clone(), &mut |_| Ok(()), &mut never.clone()).unwrap().notices
    };
    let sparse = notices(&design("beads:0.008"), &settings);
    assert!(sparse.len() == 1 && sparse[0].contains("above the object-entropy bound"), "{sparse:?}");
    assert!(notices(&design("beads:0.11"), &settings).is_empty());
}
