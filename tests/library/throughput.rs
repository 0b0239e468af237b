//! Throughput of masks: photons on the sensor, and information at other light.

use lenslet_studio::evaluation::{EstimateRequest, estimate, pretrained_lower_bound};
use lenslet_studio::forward::{Design, ForwardModel, mean_measurement};
use lenslet_studio::information::Estimator;
use lenslet_studio::optics::{
    DIFFUSER_APERTURES, Diffuser, Encoder, PsfImage, depth_layout, heuristic_layout, normalised_psf,
};
use lenslet_studio::progress::CancelToken;
use ndarray::Array2;

fn design(encoder: Encoder, objects: &str) -> Design {
    Design { encoder, objects: objects.parse().unwrap(), ..Design::default() }
}

/// Mean of clean measurements of some objects, photons per pixel.
fn mean_light(design: &Design) -> f64 {
    let model = ForwardModel::open(design).unwrap();
    let psf = model.psf(design).unwrap();
    let measured = model.simulate(psf.view(), 0..24, 3).unwrap().noiseless;
    let found = measured.mapv(f64::from).mean().unwrap();
    let expected = mean_measurement(&model.set, psf.view(), design.bias_photons);
    assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
    expected
}

#[test]
fn mean_measurement_is_throughput_times_light_plus_background() {
    let image = Array2::from_shape_fn((20, 24), |(row, col)| ((row * 5 + col * 3) % 7) as f32);
    let psf = normalised_psf(image, "psf").unwrap();
    for encoder in [
        Encoder::Lenslets(heuristic_layout(3)),
        Encoder::Diffuser(Diffuser::with_light_kept(16, 1)),
        Encoder::Image(PsfImage { psf, origin: "psf".into(), throughput: 1.0, photograph: None }),
    ] {
        let whole = mean_light(&design(encoder.clone(), "beads:0.02"));
        let dim = design(encoder.with_throughput(0.3), "beads:0.02");
        let expected = 0.3 * (whole - dim.bias_photons) + dim.bias_photons;
        assert!((mean_light(&dim) - expected).abs() < 1e-4 * expected);
    }
}

/// A factor that is a power of two changes no digit, so all draws and all bits are equal.
#[test]
fn information_of_a_dim_mask_is_that_of_less_light() {
    let mask = Encoder::Lenslets(heuristic_layout(2));
    let little = Design { mean_photons: 100.0, ..design(mask.clone(), "beads:0.02") };
    let dim = Design { mean_photons: 400.0, ..design(mask.with_throughput(0.25), "beads:0.02") };
    let measured = |design: &Design| {
        let model = ForwardModel::open(design).unwrap();
        model.simulate(model.psf(design).unwrap().view(), 0..2, 5).unwrap()
    };
    let (one, other) = (measured(&little), measured(&dim));
    assert_eq!(one.objects.mapv(|value| 4.0 * value), other.objects);
    assert_eq!((one.noiseless, one.noisy), (other.noiseless, other.noisy));

    // Decoder, AIS and entropy bound see the objects through this channel alone.
    let channel = |design: &Design| {
        let model = ForwardModel::open(design).unwrap();
        model.bead_channel(model.psf(design).unwrap().view(), (8, 8)).unwrap()
    };
    assert_eq!(channel(&little), channel(&dim));
    for estimator in [Estimator::GaussianAnalytic, Estimator::GaussianStationary] {
        let request = EstimateRequest::new(estimator).with_patch(8, 8).with_patches(120, 40);
        let [one, other] = [&little, &dim].map(|design| estimate(design, &request, &mut CancelToken::new()).unwrap());
        assert_eq!(one.bits_per_pixel, other.bits_per_pixel, "{estimator}");
        assert_eq!((one.interval_95, one.ceiling, one.lower()), (other.interval_95, other.ceiling, other.lower()));
    }
}

#[test]
fn apertures_of_one_caustic_bring_less_and_less_light_and_information() {
    let mut before: Option<(f64, f64)> = None;
    for aperture in DIFFUSER_APERTURES {
        let diffuser = Diffuser::behind_aperture(aperture, 2);
        let design = design(Encoder::Diffuser(diffuser), "beads:0.02");
        let light = mean_light(&design) - design.bias_photons;
        let kept = mean_light(&Design {
            encoder: Encoder::Diffuser(Diffuser::with_light_kept(aperture, 2)),
            ..design.clone()
        });
        assert!((light - diffuser.throughput * (kept - design.bias_photons)).abs() < 1e-6 * kept);
        if let Some((more, _)) = before {
            assert!(light < more, "{aperture} px");
        }
        before = Some((light, diffuser.throughput));
    }
    let (light, throughput) = before.unwrap();
    assert!((0.02..0.15).contains(&throughput) && light < 15.0, "8 px: {throughput}, {light} photons");
}

/// Photons on the sensor count the lenslets that image a plane: `min(lenslets, planes)`.
#[test]
fn lenslets_in_depth_collect_the_light_of_one_lenslet_each() {
    let light = |lenslets: usize, planes: usize| {
        let objects = format!("volume:{planes}:0.02");
        let design = design(Encoder::Lenslets(depth_layout(lenslets, planes)), &objects);
        mean_light(&design) - design.bias_photons
    };
    let one = light(1, 1);
    for (lenslets, planes) in [(1, 3), (2, 2), (3, 2), (2, 3), (5, 5)] {
        let found = light(lenslets, planes) / one;
        assert!((found - lenslets.min(planes) as f64).abs() < 1e-9, "{lenslets} lenslets, {planes} planes: {found}");
    }
}

#[test]
fn information_in_depth_depends_on_the_smaller_of_lenslets_and_planes() {
    let request = EstimateRequest::new(Estimator::GaussianAnalytic).with_patch(8, 8).with_patches(60, 200);
    let numbers = |lenslets: usize, planes: usize| {
        let objects = format!("volume:{planes}:0.02");
        let design = design(Encoder::Lenslets(depth_layout(lenslets, planes)), &objects);
        let estimate = estimate(&design, &request, &mut CancelToken::new()).unwrap();
        let model = ForwardModel::open(&design).unwrap();
        let lower = pretrained_lower_bound(&design, &model.set, (8, 8)).unwrap().map(|bound| bound.bits_per_pixel);
        (estimate, lower)
    };
    let (two, two_lower) = numbers(2, 2);
    // The third lenslet focuses on a plane without objects: the forward model is the same.
    let (beyond, beyond_lower) = numbers(3, 2);
    assert_eq!((two.bits_per_pixel, two_lower), (beyond.bits_per_pixel, beyond_lower));
    // The third plane has no lenslet: other draws of the same measurements.
    let (unseen, _) = numbers(2, 3);
    let [low, high] = two.interval_95;
    let [unseen_low, unseen_high] = unseen.interval_95;
    assert!(low < unseen_high && unseen_low < high, "{:?} {:?}", two.interval_95, unseen.interval_95);
    let (three, _) = numbers(3, 3);
    assert!(three.interval_95[0] > high || three.interval_95[1] < low, "another plane changes the information");
}
