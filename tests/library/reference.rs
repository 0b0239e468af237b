//! Optics, sensor and sparsity against values computed by the published procedure.

use std::path::Path;

use lenslet_studio::formats::read_npz_f64;
use lenslet_studio::optics::{
    HEURISTIC_CENTRES, HEURISTIC_SIGMA, Lenslet, LensletArray, heuristic_layout, psf_gradient, render_psf,
};
use lenslet_studio::sensor::{Convolution, Convolver, DEFAULT_BIAS};
use lenslet_studio::sparsity::tamura;
use ndarray::{Array1, Array2, Array3, Array4, ArrayD, Axis, Ix1, Ix2, Ix3};

/// Pixels per unit of the published grid, on which 32 samples span -16 to 16.
const PX_PER_UNIT: f64 = 31.0 / 32.0;

/// An array of the reference values.
fn reference(name: &str) -> ArrayD<f64> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/reference/optics.npz");
    read_npz_f64(&path, Some(name)).unwrap()
}

fn vector(name: &str) -> Array1<f64> {
    reference(name).into_dimensionality::<Ix1>().unwrap()
}

fn matrix(name: &str) -> Array2<f64> {
    reference(name).into_dimensionality::<Ix2>().unwrap()
}

fn stack(name: &str) -> Array3<f64> {
    reference(name).into_dimensionality::<Ix3>().unwrap()
}

/// The 25 lenslets after projection, in pixels.
fn lenslets() -> LensletArray {
    let (means, variances, weights) = (matrix("means"), vector("variances"), vector("weights"));
    let px = |coordinate: f64| (coordinate + 16.0) * PX_PER_UNIT;
    let lenslets = means.rows().into_iter().zip(&variances).zip(&weights).map(|((mean, &variance), &weight)| {
        // Means are (row, column).
        Lenslet::round(px(mean[1]), px(mean[0]), PX_PER_UNIT * variance.sqrt(), weight)
    });
    LensletArray::new(32, 32, lenslets.collect())
}

fn objects() -> Array4<f32> {
    stack("objects").mapv(|value| value as f32).insert_axis(Axis(1))
}

fn convolver(array: &LensletArray) -> Convolver {
    let psf = render_psf(array, 1).unwrap();
    Convolution::new((96, 96), (32, 32)).unwrap().with_psf(psf.view()).unwrap()
}

/// Largest |found / expected - 1|.
fn relative<'a>(found: impl IntoIterator<Item = f64>, expected: impl IntoIterator<Item = &'a f64>) -> f64 {
    found.into_iter().zip(expected).map(|(found, expected)| (found / expected - 1.0).abs()).fold(0.0, f64::max)
}

#[test]
fn psf_of_25_lenslets() {
    let (array, expected) = (lenslets(), matrix("psf"));
    let psf = render_psf(&array, 1).unwrap();
    assert_eq!(psf.dim(), (1, 32, 32));
    let apart = relative(psf.iter().copied(), &expected);
    println!("PSF, largest relative difference {apart:.1e}");
    assert!(apart < 1e-8, "{apart}");
}

#[test]
fn projection_brings_centres_into_the_central_part() {
    let (before, after) = (matrix("means_in"), lenslets());
    let limits = lenslet_studio::optics::Limits::default();
    for (mean, projected) in before.rows().into_iter().zip(&after.lenslets) {
        let px = |coordinate: f64| (coordinate + 16.0) * PX_PER_UNIT;
        let lenslet = limits.project(Lenslet { x: px(mean[1]), y: px(mean[0]), ..*projected }, 32, 32);
        assert!((lenslet.x - projected.x).abs() < 1e-6 && (lenslet.y - projected.y).abs() < 1e-6, "{mean}");
    }
}

#[test]
fn measurements_of_two_objects() {
    let measured = convolver(&lenslets()).measure(objects().view(), DEFAULT_BIAS).unwrap();
    assert_eq!(measured.dim(), (6, 65, 65));
    let expected = stack("measurements");
    assert_eq!(expected.dim(), (2, 65, 65));
    let apart = relative(measured.iter().map(|&value| f64::from(value)), &expected);
    println!("measurements, largest relative difference {apart:.1e}");
    assert!(apart < 1e-5, "{apart}");
}

#[test]
fn tamura_coefficients() {
    for name in ["objects", "measurements", "noisy"] {
        let (images, expected) = (stack(name), vector(&format!("tamura_{name}")));
        assert!(!expected.is_empty());
        for (image, expected) in images.outer_iter().zip(&expected) {
            let found = tamura(image.mapv(|value| value as f32).view());
            assert!((found - expected).abs() < 1e-6, "{name}: {found} against {expected}");
        }
    }
}

/// The heuristic layout of `count` lenslets as published: spots are cut off 3 px from their centre along either axis.
fn cut_off(count: usize) -> Array2<f64> {
    let mut psf = Array2::zeros((32, 32));
    for &(row, col) in &HEURISTIC_CENTRES[..count] {
        let spot = Array2::from_shape_fn((32, 32), |(r, c)| {
            let (down, right) = (r as f64 - row, c as f64 - col);
            let inside = down.abs().max(right.abs()) <= 3.0;
            if inside { (-0.5 * (down * down + right * right) / HEURISTIC_SIGMA.powi(2)).exp() } else { 0.0 }
        });
        psf += &(&spot / (spot.sum() * count as f64));
    }
    psf
}

#[test]
fn nine_heuristic_psfs() {
    let expected = stack("heuristic_psfs");
    assert_eq!(expected.dim(), (9, 32, 32));
    for (expected, count) in expected.outer_iter().zip(1..) {
        let psf = render_psf(&heuristic_layout(count), 1).unwrap();
        let peak = expected.iter().copied().fold(0.0, f64::max);
        let apart = psf.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / peak;
        let cut = cut_off(count);
        let exact = cut.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(exact < 1e-12, "{count} lenslets: the layout is the published one but for {exact}");
        // The published spots are cut off more than 3 px away, where a spot of 0.8 px has fallen to 3.7e-6 of its peak.
        println!("{count} lenslets, largest difference {apart:.1e} of the peak");
        assert!(apart < 1e-5, "{count} lenslets: {apart}");
    }
}

/// The functional is the sum of cotangent x measurements. Its gradients are with respect to the lenslets after
/// projection, and include the normalisation of the weights.
#[test]
fn gradients_of_a_functional_of_the_measurements() {
    let (array, objects, cotangent) = (lenslets(), objects(), stack("cotangent"));
    let convolver = convolver(&array);
    let measured = convolver.measure(objects.view(), DEFAULT_BIAS).unwrap();
    let found: f64 = measured.iter().zip(&cotangent).map(|(&x, c)| f64::from(x) * c).sum();
    let expected = reference("functional").sum();
    assert!((found / expected - 1.0).abs() < 1e-5, "{found} against {expected}");

    let cotangent = cotangent.mapv(|value| value as f32);
    let by_psf = convolver.psf_cotangent(objects.view(), cotangent.view()).unwrap();
    let gradients = psf_gradient(&array, by_psf.view()).unwrap();
    // Chain rule: x_px = 31/32 (coordinate + 16), sigma_px = 31/32 sqrt(variance).
    let by_means: Vec<f64> = gradients.iter().flat_map(|g| [g.y * PX_PER_UNIT, g.x * PX_PER_UNIT]).collect();
    let by_weights: Vec<f64> = gradients.iter().map(|g| g.weight).collect();
    let variances = vector("variances");
    let by_variances: Vec<f64> =
        gradients.iter().zip(&variances).map(|(g, variance)| g.sigma * PX_PER_UNIT / (2.0 * variance.sqrt())).collect();
    for (name, found) in [("means", by_means), ("variances", by_variances), ("weights", by_weights)] {
        let expected = reference(&format!("grad_{name}"));
        let scale = expected.iter().map(|value| value.abs()).fold(0.0, f64::max);
        let apart = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / scale;
        println!("gradient by {name}, largest difference {apart:.1e} of the largest entry");
        assert!(found.len() == expected.len() && apart < 1e-5, "{name}: {apart}");
    }
}
