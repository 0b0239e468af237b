//! Fields and PSF grids of other sizes than the published ones.

use lenslet_studio::evaluation::{EstimateRequest, Optics, Scene, SceneTables, estimate};
use lenslet_studio::forward::{Design, ForwardModel, MaskSource};
use lenslet_studio::information::{Estimator, NoiseEntropy, Protocol};
use lenslet_studio::objects::{ObjectSource, Placement};
use lenslet_studio::optics::Encoder;
use lenslet_studio::progress::CancelToken;

/// Nine lenslets on a grid imaging beads of a field.
fn design(field: (usize, usize), grid: (usize, usize)) -> Design {
    let mask = MaskSource::Heuristic(9).mask(1, &Design::default().objects, Some(grid)).unwrap();
    Design { encoder: mask.encoder, field, ..Design::default() }
}

#[test]
fn information_per_pixel_of_beads_hardly_depends_on_the_field() {
    let request = EstimateRequest::new(Estimator::GaussianStationary).with_patch(12, 12).with_patches(1200, 400);
    let [published, larger] = [(96, 96), (128, 160)].map(|field| {
        let design = design(field, (32, 32));
        estimate(&design, &request, &mut CancelToken::new()).unwrap()
    });
    let half_width = |interval: [f64; 2]| 0.5 * (interval[1] - interval[0]);
    let allowed = half_width(published.interval_95) + half_width(larger.interval_95);
    let difference = (published.bits_per_pixel - larger.bits_per_pixel).abs();
    assert!(difference > 0.0 && difference < allowed, "{difference} against {allowed}");
}

#[test]
fn live_numbers_exist_at_any_size() {
    let mut bounds = Vec::new();
    for (field, grid, count) in [((96, 96), (32, 32), 64), ((200, 168), (48, 40), 17), ((300, 300), (96, 96), 8)] {
        let design = design(field, grid);
        let scene = Scene::open(&design, &mut CancelToken::new()).unwrap();
        assert_eq!(scene.objects.dim(), (count, 1, field.0, field.1));
        let tables = SceneTables::new(&scene, grid).unwrap();
        let optics = Optics::of(&design, 1).unwrap();
        let measured = tables.measure(&design, &optics, &scene).unwrap();
        assert_eq!(measured.noisy.dim(), (count, field.0 - grid.0 + 1, field.1 - grid.1 + 1));
        let entropy = NoiseEntropy::new(design.noise, Protocol::Default).unwrap();
        let live = tables.information(&design, &optics, &scene, &measured, &entropy).unwrap();
        bounds.push((live.gaussian.bits_per_pixel, live.ceiling_bits().unwrap()));
    }
    // Spots of one width further apart: copies of a bead meet in fewer patches, so the entropy bound rises and neither is far off.
    for (gaussian, ceiling) in &bounds {
        assert!((gaussian / bounds[0].0 - 1.0).abs() < 0.1 && ceiling / bounds[0].1 > 0.9, "{bounds:?}");
    }
}

#[test]
fn caches_know_field_and_placement() {
    let design = Design::default();
    let scene = Scene::open(&design, &mut CancelToken::new()).unwrap();
    assert!(scene.serves(&Design { pixel_pitch_um: Some(2.0), bias_photons: 3.0, ..design.clone() }));
    for other in [
        Design { field: (96, 97), ..design.clone() },
        Design { placement: Placement::Tiled, ..design.clone() },
        Design { seed: 2, ..design.clone() },
    ] {
        assert!(!scene.serves(&other) && !design.has_objects_of(&other));
    }
}

#[test]
fn placements_of_whole_images_give_other_objects() {
    let folder = tempfile::tempdir().unwrap();
    let pixels = ndarray::Array3::from_shape_fn((2, 70, 90), |(n, row, col)| (1 + (n + row * col) % 17) as f32);
    lenslet_studio::formats::write_array(&folder.path().join("images.npy"), pixels.view()).unwrap();
    let fingerprint = |placement| {
        let objects = ObjectSource::Images(folder.path().join("images.npy"));
        let design = Design { objects, placement, field: (60, 80), ..Design::default() };
        let model = ForwardModel::open(&design).unwrap();
        assert_eq!(model.set.field(), (60, 80));
        model.set.fingerprint()
    };
    let [scaled, tiled, cropped] = Placement::ALL.map(fingerprint);
    assert!(scaled != tiled && tiled == cropped, "images larger than the field are cut by both");
}

#[test]
fn a_field_must_hold_the_psf_unless_the_objects_bring_their_own() {
    let small = design((40, 40), (48, 32));
    let refused = small.check().unwrap_err().to_string();
    assert!(refused.contains("40 x 40 px; expected at least the 48 x 32 px of the PSF grid"), "{refused}");
    assert!(Design { objects: ObjectSource::Stack("own.npy".into()), ..small.clone() }.check().is_ok());
    assert!(Design { field: (48, 1024), ..small.clone() }.check().is_ok());
    for wrong in [(0, 96), (48, 1025)] {
        assert!(
            Design { field: wrong, ..small.clone() }.check().unwrap_err().to_string().contains("expected 1 to 1024 px")
        );
    }
    let pitch = Design { pixel_pitch_um: Some(0.0), ..Design::default() }.check().unwrap_err().to_string();
    assert_eq!(pitch, "pixel_pitch_um is 0.0; expected 0.01 to 1000 micrometres");
}

#[test]
fn a_diffuser_of_another_grid_has_bumps_of_the_same_size() {
    let objects = Design::default().objects;
    let mask = |grid| MaskSource::Diffuser(32).mask(3, &objects, Some((grid, grid))).unwrap().encoder;
    // The mean horizontal neighbour product, relative to the mean square, is the same for bumps of the same size.
    let likeness = |grid: usize| {
        let Encoder::Diffuser(diffuser) = mask(grid) else { panic!("a diffuser") };
        let psf = diffuser.render();
        assert!(psf.dim() == (grid, grid) && (psf.sum() - 1.0).abs() < 1e-9);
        let pairs: f64 = psf.windows((1, 2)).into_iter().map(|pair| pair[[0, 0]] * pair[[0, 1]]).sum();
        pairs / psf.iter().map(|value| value * value).sum::<f64>()
    };
    let (published, large) = (likeness(32), likeness(96));
    assert!((published - large).abs() < 0.2, "{published} {large}");
}
