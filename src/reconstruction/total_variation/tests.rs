use ndarray::{Array2, Array3, Axis, s};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::super::data_term::residual_in_noise;
use super::super::richardson_lucy::RichardsonLucy;
use super::*;
use crate::sensor::{Convolution, Noise};

/// Blocks of constant light, photons per pixel.
fn blocks(field: (usize, usize), photons: f32) -> Array2<f32> {
    let mut object = Array2::from_elem(field, 0.0);
    object.slice_mut(s![14..26, 12..22]).fill(photons);
    object.slice_mut(s![18..32, 26..36]).fill(0.4 * photons);
    object
}

/// Three points of a mask, not symmetric.
fn psf() -> Array3<f64> {
    let mut psf = Array3::zeros((1, 11, 13));
    for (row, col, light) in [(2, 3, 0.5), (8, 4, 0.3), (5, 11, 0.2)] {
        psf[(0, row, col)] = light;
    }
    psf
}

fn measure(model: &ImagingModel, object: &Array2<f32>, seed: u64) -> Array2<f32> {
    let plan = Convolution::new(model.field(), model.psf().dim()).unwrap();
    let convolver = plan.with_psf(model.psf().insert_axis(Axis(0))).unwrap();
    let objects = object.view().insert_axis(Axis(0)).insert_axis(Axis(0));
    let clean = convolver.measure(objects, model.background).unwrap();
    model.noise.draw(clean.view(), seed).index_axis_move(Axis(0), 0)
}

/// Root of the mean squared error relative to that of the object, over what all points of the mask show.
fn relative_error(found: &Array2<f32>, object: &Array2<f32>) -> f64 {
    let part = s![12..36, 12..38];
    let difference = &found.slice(part) - &object.slice(part);
    let power = |image: &Array2<f32>| image.iter().map(|&value| f64::from(value).powi(2)).sum::<f64>();
    (power(&difference) / power(&object.slice(part).to_owned())).sqrt()
}

fn reconstruct(decoder: &dyn Decoder, model: &ImagingModel, measurement: &Array2<f32>) -> Array2<f32> {
    let prepared = decoder.prepare(model, &CancelToken::new()).unwrap();
    prepared.reconstruct_one(measurement.view(), &mut CancelToken::new()).unwrap()
}

fn residual(model: &ImagingModel, found: &Array2<f32>, y: &Array2<f32>) -> f64 {
    residual_in_noise(model, found.view().insert_axis(Axis(0)), y.view().insert_axis(Axis(0))).unwrap()
}

#[test]
fn blocks_of_constant_light_are_found() {
    let field = (48, 50);
    for (photons, background, noise, largest) in
        [(4000.0, 0.0, Noise::Shot, 0.06), (400.0, 10.0, Noise::ShotRead { sigma: 3.0 }, 0.12)]
    {
        let model = ImagingModel::new(psf().view(), field, background, noise).unwrap();
        let object = blocks(field, photons);
        let y = measure(&model, &object, 1);
        let found = reconstruct(&TotalVariation::default(), &model, &y);
        let error = relative_error(&found, &object);
        let classical = relative_error(&reconstruct(&RichardsonLucy::default(), &model, &y), &object);
        println!("{photons} photons: TV {error:.3}, Richardson-Lucy {classical:.3}");
        assert!(found.iter().all(|value| *value >= 0.0));
        assert!(error < largest && error < classical, "{error} {classical}");
        let residual = residual(&model, &found, &y);
        assert!((0.92..1.07).contains(&residual), "the residual is not that of the noise: {residual}");
    }
}

/// A wide mask passes fine structure weakly. Its object must not stay negative where there is no light, because what is left without its
/// negative light does not fit the measurement.
#[test]
fn objects_before_a_wide_mask_fit_the_measurement_without_negative_light() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let psf = Array3::from_shape_fn((1, 48, 48), |_| f64::from(random.random::<f32>()).powi(8));
    let psf = &psf / psf.sum();
    let model = ImagingModel::new(psf.view(), (100, 100), 0.0, Noise::Shot).unwrap();
    let y = measure(&model, &blocks((100, 100), 1e5), 1);
    let found = reconstruct(&TotalVariation { iterations: 100, weight: None }, &model, &y);
    let residual = residual(&model, &found, &y);
    assert!(residual < 6.0, "{residual}");
}

#[test]
fn pixels_that_were_not_measured_do_not_count() {
    let field = (48, 50);
    let model = ImagingModel::new(psf().view(), field, 0.0, Noise::Shot).unwrap();
    let object = blocks(field, 2000.0);
    let mut y = measure(&model, &object, 2);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    y.mapv_inplace(|value| if random.random::<f32>() < 0.1 { f32::NAN } else { value });
    for (decoder, largest) in
        [(&TotalVariation::default() as &dyn Decoder, 0.12), (&RichardsonLucy::default() as &dyn Decoder, 0.4)]
    {
        let error = relative_error(&reconstruct(decoder, &model, &y), &object);
        assert!(error < largest, "{}: {error}", decoder.kind());
    }
    y.fill(f32::NAN);
    let prepared = TotalVariation::default().prepare(&model, &CancelToken::new()).unwrap();
    assert!(prepared.reconstruct_one(y.view(), &mut CancelToken::new()).is_err());
}

/// Stacks are solved image by image, in the order of their numbers.
#[test]
fn images_of_a_stack_do_not_depend_on_each_other() {
    let field = (48, 50);
    let model = ImagingModel::new(psf().view(), field, 0.0, Noise::Shot).unwrap();
    let decoder = TotalVariation { iterations: 20, weight: None };
    let prepared = decoder.prepare(&model, &CancelToken::new()).unwrap();
    let images: Vec<Array2<f32>> = (1..=3).map(|n| measure(&model, &blocks(field, 300.0 * n as f32), n)).collect();
    let views: Vec<ArrayView2<'_, f32>> = images.iter().map(|image| image.view()).collect();
    let stack = ndarray::stack(Axis(0), &views).unwrap();
    let mut seen = Vec::new();
    let together = prepared.reconstruct(stack.view(), &mut |step: &ReconstructionStep| {
        if let ReconstructionStep::Images { done, total } = step {
            seen.push((*done, *total));
        }
        std::ops::ControlFlow::Continue(())
    });
    for (object, image) in together.unwrap().outer_iter().zip(&images) {
        assert_eq!(object, prepared.reconstruct_one(image.view(), &mut CancelToken::new()).unwrap());
    }
    assert_eq!(seen.last(), Some(&(3, 3)));
}

#[test]
fn iterations_are_shown_and_end_on_request() {
    let field = (48, 50);
    let model = ImagingModel::new(psf().view(), field, 0.0, Noise::Shot).unwrap();
    let y = measure(&model, &blocks(field, 300.0), 3);
    for decoder in [&TotalVariation::default() as &dyn Decoder, &RichardsonLucy::default() as &dyn Decoder] {
        let prepared = decoder.prepare(&model, &CancelToken::new()).unwrap();
        let mut shown = 0;
        let result = prepared.reconstruct_one(y.view(), &mut |step: &ReconstructionStep| {
            let ReconstructionStep::Iteration { done, object, .. } = step else { panic!() };
            shown += usize::from(object.as_ref().is_some_and(|object| object.dim() == field));
            if *done < 5 { std::ops::ControlFlow::Continue(()) } else { std::ops::ControlFlow::Break(()) }
        });
        assert!(matches!(result, Err(ReconstructionError::Cancelled)));
        assert!(shown > 0, "{}", decoder.kind());
    }
}
