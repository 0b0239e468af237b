//! Estimators and intervals against studies of known information.

use crate::known_cases::{GaussianField, KnownTruth, OneBead, TwoRates};
use crate::study_stream::StudyStream;
use lenslet_studio::information::PixelCnnContext;
use lenslet_studio::information::{
    CausalRequest, Covariance, Estimator as Model, FitLength, GaussianRequest, Init, NoiseEntropy, PatchBatch,
    PixelCnnFit, PixelCnnShape, Protocol, StationaryGaussian, TrainingPatches, bootstrap_interval, causal_estimate,
    gaussian_estimate, paired_interval,
};
use lenslet_studio::progress::CancelToken;
use lenslet_studio::sensor::Noise;
use ndarray::{Array3, Axis, s};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Training and held-out patches of one study.
struct Sample {
    study: KnownTruth,
    noise: Noise,
    train_clean: Array3<f32>,
    train: Array3<f32>,
    test_clean: Array3<f32>,
    test: Array3<f32>,
}

impl Sample {
    fn of(study: &KnownTruth, train: usize, test: usize) -> Self {
        let (train_clean, train) = study.draw(train, 1).unwrap();
        let (test_clean, test) = study.draw(test, 2).unwrap();
        Self { study: study.clone(), noise: study.noise(), train_clean, train, test_clean, test }
    }
}

/// An estimate of the bits per pixel and its 95 % interval.
type Found = (f64, [f64; 2]);
/// Function that makes an estimate from a sample.
type Estimator<'a> = &'a dyn Fn(&Sample) -> Found;

fn gaussian(sample: &Sample, covariance: Covariance) -> Found {
    let request = GaussianRequest {
        train: sample.train.view(),
        test: sample.test.view(),
        test_clean: Some(sample.test_clean.view()),
        covariance,
        noise: sample.noise,
        protocol: Protocol::Default,
        seed: 3,
    };
    let trial = gaussian_estimate(&request).unwrap();
    (trial.bits_per_pixel(), trial.interval_95())
}

/// A small network of the `PixelCNN` family after a short fit.
fn small_network(sample: &Sample) -> Found {
    let dequantise = sample.noise == Noise::Shot;
    let fit = PixelCnnFit { steps_per_epoch: 150, max_epochs: 1, dequantise, ..PixelCnnFit::standard(4) };
    let shape = PixelCnnShape::new(16, 8, vec![1, 2]).unwrap();
    let patches =
        TrainingPatches { noisy: sample.train.view(), clean: Some((sample.train_clean.view(), sample.noise)) };
    let (model, _) = fit.fit(shape, 1.0, &PixelCnnContext::new(patches), &mut CancelToken::new()).unwrap();
    let test = if dequantise { dequantised(&sample.test, 5) } else { sample.test.clone() };
    let test = test.slice(s![..300, .., ..]);
    let cross_entropy = model.cross_entropy_bits(test).unwrap();
    let clean = sample.test_clean.slice(s![..300, .., ..]);
    let conditional = NoiseEntropy::new(sample.noise, Protocol::Default).unwrap().patch_bits(clean).unwrap();
    let information = differences(&cross_entropy, &conditional);
    (mean(&information), paired_interval(&information, 6).unwrap())
}

/// The causal density model after a short fit.
fn live(sample: &Sample) -> Found {
    let part = s![..400, .., ..];
    let (noisy, clean) = (sample.test.slice(part).to_owned(), sample.test_clean.slice(part).to_owned());
    let request = CausalRequest {
        stream: &StudyStream(&sample.study),
        test: &PatchBatch { noisy, clean: Some(clean) },
        validation: None,
        keeper: None,
        moments: None,
        noise: sample.noise,
        length: FitLength::Steps(400),
        init: Init::Pretrained,
        estimator: Model::Causal,
        seed: 8,
    };
    let (trial, _) = causal_estimate(&request, &mut CancelToken::new()).unwrap();
    (trial.bits_per_pixel(), trial.interval_95())
}

fn dequantised(counts: &Array3<f32>, seed: u64) -> Array3<f32> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    counts.mapv(|y| y + random.random::<f32>())
}

fn differences(one: &[f64], other: &[f64]) -> Vec<f64> {
    one.iter().zip(other).map(|(one, other)| one - other).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn no_estimate_falls_below_the_truth() {
    let estimators: [(&str, Estimator<'_>); 4] = [
        ("stationary Gaussian", &|sample| gaussian(sample, Covariance::Stationary)),
        ("full Gaussian", &|sample| gaussian(sample, Covariance::Full)),
        ("small network", &small_network),
        ("causal", &live),
    ];
    for study in KnownTruth::standard() {
        let truth = study.information(7).unwrap();
        let sample = Sample::of(&study, 8000, 1500);
        for (name, estimate) in estimators {
            let (bits, [low, high]) = estimate(&sample);
            let gap = bits - truth.bits_per_pixel;
            println!(
                "{study}, {name}: {bits:.4} [{low:.4}, {high:.4}], truth {:.4}, gap {gap:.4}",
                truth.bits_per_pixel
            );
            assert!(high >= truth.bits_per_pixel - 3.0 * truth.standard_error, "{study}, {name}: {bits} {truth:?}");
            assert!(low <= bits && bits <= high && high - low < 0.05, "{study}, {name}: {low} {high}");
            if name == "causal" && matches!(study, KnownTruth::TwoRates(_)) {
                assert!(gap < 0.01, "independent pixels leave nothing to learn but two levels: {gap}");
            }
            if matches!(study, KnownTruth::GaussianField(_)) && name.ends_with("Gaussian") {
                assert!(gap < 0.02, "{name}: the model is true, so nothing but its fit is missing: {gap}");
            }
        }
    }
}

/// log2 p(y|x) of each patch, bits per pixel.
fn log2_likelihoods(clean: &Array3<f32>, noisy: &Array3<f32>, noise: Noise) -> Vec<f64> {
    let ln_factorials: Vec<f64> = (0..1000)
        .scan(0.0, |sum, k| {
            *sum += f64::from(k.max(1)).ln();
            Some(*sum)
        })
        .collect();
    let pixel = |x: f64, y: f64| match noise {
        Noise::Shot => y * x.ln() - x - ln_factorials[y as usize],
        Noise::Read { sigma } => -0.5 * ((y - x) / sigma).powi(2) - 0.5 * (std::f64::consts::TAU * sigma * sigma).ln(),
        _ => unreachable!("studies have one noise"),
    };
    let patch = |n: usize| {
        let (clean, noisy) = (clean.index_axis(Axis(0), n), noisy.index_axis(Axis(0), n));
        let nats: f64 = clean.iter().zip(noisy).map(|(x, y)| pixel(f64::from(*x), f64::from(*y))).sum();
        nats / clean.len() as f64 / std::f64::consts::LN_2
    };
    (0..clean.len_of(Axis(0))).map(patch).collect()
}

/// Scores of one model that was fitted once. An interval of its test patches has to cover the mean over all possible
/// patches.
struct Scores {
    cross_entropy: Vec<f64>,
    conditional: Vec<f64>,
    paired: Vec<f64>,
}

impl Scores {
    fn of(study: &KnownTruth, model: &StationaryGaussian, count: usize, seed: u64) -> Self {
        let (clean, noisy) = study.draw(count, seed).unwrap();
        let continuous = if study.noise() == Noise::Shot { dequantised(&noisy, seed) } else { noisy.clone() };
        let pixels = (study.patch().0 * study.patch().1) as f64;
        let densities = model.log2_densities(continuous.view()).unwrap();
        let cross_entropy: Vec<f64> = densities.iter().map(|bits| -bits / pixels).collect();
        let conditional =
            NoiseEntropy::new(study.noise(), Protocol::Default).unwrap().patch_bits(clean.view()).unwrap();
        let likelihoods = log2_likelihoods(&clean, &noisy, study.noise());
        let paired = likelihoods.iter().zip(&cross_entropy).map(|(likelihood, bits)| likelihood + bits).collect();
        Self { cross_entropy, conditional, paired }
    }
}

#[test]
fn intervals_cover_what_they_should() {
    const TRIALS: usize = 300;
    const PATCHES: usize = 150;
    // The noise entropies of field patches are all alike. In the other studies they rise and fall with the
    // cross-entropies. The published intervals draw both independently, so the same scatter counts twice and the coverage
    // exceeds the nominal one.
    for (study, most) in [
        (KnownTruth::GaussianField(GaussianField { side_px: 8, ..GaussianField::default() }), 0.98),
        (KnownTruth::OneBead(OneBead::default()), 1.0),
        (KnownTruth::OneBead(OneBead { peak: 200.0, ..OneBead::default() }), 1.0),
        (KnownTruth::TwoRates(TwoRates { side_px: 8, ..TwoRates::default() }), 1.0),
    ] {
        let (_, train) = study.draw(1000, 1).unwrap();
        let train = if study.noise() == Noise::Shot { dequantised(&train, 1) } else { train };
        let model = StationaryGaussian::fit(train.view()).unwrap();
        let all = Scores::of(&study, &model, 40_000, 2);
        let target = mean(&all.cross_entropy) - mean(&all.conditional);
        assert!((mean(&all.paired) - target).abs() < 4e-3, "{study}: both ways of scoring have one mean");
        let tests = Scores::of(&study, &model, TRIALS * PATCHES, 3);
        // How often each kind of interval covers the mean of all patches, and its width.
        let mut found = [[0.0; 2]; 3];
        for trial in 0..TRIALS {
            let part = trial * PATCHES..(trial + 1) * PATCHES;
            let (cross_entropy, conditional) = (&tests.cross_entropy[part.clone()], &tests.conditional[part.clone()]);
            let seed = trial as u64;
            let of_both = paired_interval(&differences(cross_entropy, conditional), seed).unwrap();
            let of_likelihoods = paired_interval(&tests.paired[part], seed).unwrap();
            let published = bootstrap_interval(cross_entropy, conditional, seed).unwrap();
            let by_likelihoods = mean(&all.paired);
            let kinds = [(of_both, target), (of_likelihoods, by_likelihoods), (published, target)];
            for ([covered, width], ([low, high], target)) in found.iter_mut().zip(kinds) {
                *covered += f64::from(u8::from(low <= target && target <= high)) / TRIALS as f64;
                *width += (high - low) / TRIALS as f64;
            }
        }
        let [of_both, of_likelihoods, published] = found;
        println!(
            "{study}: intervals of differences cover {:.3} with a width of {:.4}, those of likelihood ratios {:.3} with {:.4}, \
             published ones {:.3} with {:.4}",
            of_both[0], of_both[1], of_likelihoods[0], of_likelihoods[1], published[0], published[1]
        );
        for [covered, _] in [of_both, of_likelihoods] {
            assert!((0.90..=0.98).contains(&covered), "{study}: {found:?}");
        }
        assert!((0.90..=most).contains(&published[0]), "{study}: {found:?}");
    }
}
