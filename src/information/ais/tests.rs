//! Tests on small channels whose measurement probabilities can be summed over all objects.

use std::ops::ControlFlow;

use ndarray::array;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::bound::{AisBound, AisProgress, AisSettings, ais_lower_bound, ais_upper_bound};
use super::chain::AisChain;
use super::checkpoint::AisCheckpoint;
use super::light::Light;
use super::proposals::{InitialDistribution, Moves, SweepSize};
use super::state::{Measurement, State};
use crate::information::decoder::channel::BeadChannel;
use crate::information::decoder::layers::Decoder;
use crate::information::decoder::problem::Problem;
use crate::information::decoder::samples::{Purpose, Reveal, Sample, SampleId};
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::{FitCheckpoint, InMemory};
use crate::progress::CancelToken;
use crate::sensor::Noise;

const NOISES: [Noise; 3] = [Noise::Shot, Noise::Read { sigma: 4.0 }, Noise::ShotRead { sigma: 2.0 }];

/// Ten object pixels in a row whose spots overlap on eight sensor pixels.
fn toy(noise: Noise) -> BeadChannel {
    let spot = array![[[9.0, 14.0, 5.0]]];
    BeadChannel { spot, probability: 0.3, bias: 4.0, noise, patch: (1, 8) }
}

fn sample(problem: &Problem, index: usize) -> Sample {
    let mut sample = Sample::default();
    let id = SampleId { seed: 3, purpose: Purpose::Posterior, index };
    sample.draw(problem, id, |_| Reveal::Nothing, &mut problem.light.blur_workspace());
    sample
}

#[test]
fn rounding_residues_in_dark_pixels_belong_to_the_channel() {
    // A clean image with photons where no bead emits any, as a transform may leave them, and a count there.
    let channel = BeadChannel { bias: 0.0, ..toy(Noise::Shot) };
    let fit = AisSettings { samples: 64, ..AisSettings::of_levels(16, 1) };
    let decoder = Decoder::shipped().unwrap();
    let bound = ais_upper_bound(&channel, &fit, decoder, None, &mut CancelToken::new()).unwrap();
    assert!(bound.bits_per_pixel > 0.2 && bound.interval_95[0] > 0.0, "{bound:?}");
    let below = ais_lower_bound(&channel, &fit, decoder, None, &mut CancelToken::new()).unwrap();
    assert!(below.interval_95[0] <= bound.interval_95[1], "{below:?}");
    let problem = Problem::new(&channel).unwrap();
    let sample = sample(&problem, 1);
    assert_eq!(sample.clean.len(), sample.noisy.len());
    let likely = |(&y, &x): (&f32, &f32)| y == 0.0 || x > 0.0;
    assert!(sample.noisy.iter().zip(&sample.clean).all(likely), "no count comes from nothing");
}

fn sites_of(object: usize) -> impl Iterator<Item = usize> {
    (0..10).filter(move |site| object >> site & 1 == 1)
}

/// Log of prior times likelihood of all objects.
fn all_logs(problem: &Problem, light: &Light, measured: &Measurement) -> Vec<f64> {
    let (occupied, dark) = (problem.probability.ln(), (1.0 - problem.probability).ln());
    let log = |object: usize| {
        let beads = sites_of(object).count() as f64;
        State::new(light, measured, 10, sites_of(object)).log_likelihood() + beads * occupied + (10.0 - beads) * dark
    };
    (0..1 << 10).map(log).collect()
}

fn log_sum(logs: &[f64]) -> f64 {
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest + logs.iter().map(|log| (log - largest).exp()).sum::<f64>().ln()
}

/// Mean of values and its standard error.
fn mean(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (mean, (square / count).sqrt())
}

#[test]
fn likelihood_change_equals_difference_of_log_likelihoods() {
    for (noise, bias, brightness) in
        NOISES.map(|noise| (noise, 6.0, 4.0)).into_iter().chain([(Noise::Shot, 5e6, 400.0)])
    {
        let level = |(z, r, c): (usize, usize, usize)| ((z * 5 + r * 3 + c * 7) % 11) as f64 * brightness;
        let spot = ndarray::Array3::from_shape_fn((2, 3, 11), level);
        let channel = BeadChannel { spot, probability: 0.15, bias, noise, patch: (6, 5) };
        let problem = Problem::new(&channel).unwrap();
        let light = Light::new(&channel.checked_spot().unwrap(), &problem);
        let sample = sample(&problem, 1);
        let measured = Measurement::new(&problem, &light, &sample, |site| site % 3 == 0);
        let beads = (0..sample.beads.len()).filter(|&site| sample.beads[site] > 0.0 && site % 3 > 0);
        let mut state = State::new(&light, &measured, sample.beads.len(), beads);
        for site in (0..sample.beads.len()).filter(|site| site % 3 > 0) {
            let (before, sign) = (state.log_likelihood(), if state.holds(site) { -1.0 } else { 1.0 });
            let log_likelihood_change = state.log_likelihood_change(site, sign);
            state.toggle(site);
            state.add_photons(site, sign);
            let found = state.log_likelihood() - before;
            assert!(
                (log_likelihood_change - found).abs() < 1e-3 * (1.0 + found.abs()),
                "{noise} {site}: {log_likelihood_change} {found}"
            );
        }
        // The image after removing beads equals a newly computed one; the image of all beads equals that of the
        // sample.
        let changed = state.log_likelihood();
        state.refresh();
        assert!((state.log_likelihood() - changed).abs() < 1e-3);
    }
}

#[test]
fn omitted_light_carries_no_information() {
    for (brightness, probability) in [(1.0, 0.02), (50.0, 0.02), (1.0, 0.001)] {
        let spot = crate::information::test_beads::bead_spot(4, probability) * brightness;
        let channel = BeadChannel { spot, probability, patch: (24, 20), ..toy(Noise::Shot) };
        let spot = channel.checked_spot().unwrap();
        let light = Light::new(&spot, &Problem::new(&channel).unwrap());
        let energy = |photons: f64| photons * photons;
        let followed: f64 = light.photons.iter().map(|&photons| energy(f64::from(photons))).sum();
        let left = spot.iter().copied().map(energy).sum::<f64>() - followed;
        // Photons are accumulated in single precision.
        assert!(left <= 0.02 * light.variance + 1e-6 * followed, "{brightness}, {probability}: {left}");
    }
}

#[test]
fn image_of_true_beads_equals_clean_sample() {
    let channel = BeadChannel {
        spot: crate::information::test_beads::bead_spot(4, 0.02),
        patch: (24, 20),
        ..toy(Noise::Read { sigma: 1e-3 })
    };
    let channel = BeadChannel { probability: 0.02, ..channel };
    let problem = Problem::new(&channel).unwrap();
    let light = Light::new(&channel.checked_spot().unwrap(), &problem);
    let sample = sample(&problem, 2);
    let mut clean = light.image(&vec![light.background as f32; problem.pixels()], 0.0);
    for site in (0..sample.beads.len()).filter(|&site| sample.beads[site] > 0.0) {
        light.add(site, 1.0, &mut clean);
    }
    for (clean, noisy) in light.patch_of(&clean).zip(&sample.noisy) {
        // Light too faint for the runs is included on average.
        assert!((clean - noisy).abs() < 1.0, "{clean} {noisy}");
    }
}

#[test]
fn chains_are_unbiased_and_improve_with_more_temperatures() {
    for noise in NOISES {
        let channel = toy(noise);
        let problem = Problem::new(&channel).unwrap();
        let spot = channel.checked_spot().unwrap();
        let (light, steps) = (Light::new(&spot, &problem), Moves::new(&spot));
        let measured = Measurement::new(&problem, &light, &sample(&problem, 4), |_| false);
        let logs = all_logs(&problem, &light, &measured);
        let truth = log_sum(&logs);
        let mut random = ChaCha8Rng::seed_from_u64(5);
        // An initial distribution that is wrong at every site, within limits.
        let odds: Vec<f32> = (0..10).map(|site| [-1.5, 0.3, 1.1][site % 3]).collect();
        let initial = InitialDistribution::new(&odds, vec![true; 10], f64::from(problem.prior_logit()), 14.0);
        let effort = SweepSize { flips: 4, shifts: 2 };
        let (light, measured, initial, steps) = (&light, &measured, &initial, &steps);
        let chain = |levels| AisChain { light, measured, initial, steps, effort, levels };
        let mut last = f64::NEG_INFINITY;
        for (levels, particles) in [(1, 1), (6, 3), (400, 3)] {
            let chain = chain(levels);
            let found: Vec<f64> = (0..800)
                .map(|_| chain.forward_log_weight(particles, &mut random, &mut CancelToken::new()) - truth)
                .collect();
            let (ratio, error) = mean(&found.iter().map(|log| log.exp()).collect::<Vec<f64>>());
            let (log, _) = mean(&found);
            println!("{noise} {levels} {particles}: {ratio} +- {error}, log {log}");
            // With too few temperatures, rare chains carry the mean.
            let fair = (ratio - 1.0).abs() < 4.0 * error + 1e-3;
            assert!(fair || levels < 100, "{noise} {levels}: {ratio} +- {error}");
            assert!(log < 0.0 && log > last, "{noise} {levels}: {log}");
            last = log;
        }
        assert!(last > -0.2, "{noise}: {last}");

        let draw = |random: &mut ChaCha8Rng| {
            let mut left = random.random::<f64>();
            let chosen = logs.iter().position(|log| {
                left -= (log - truth).exp();
                left < 0.0
            });
            sites_of(chosen.unwrap_or(0)).collect::<Vec<usize>>()
        };
        last = f64::INFINITY;
        for levels in [1, 6, 400] {
            let chain = chain(levels);
            let found: Vec<f64> = (0..800)
                .map(|_| {
                    let beads = draw(&mut random);
                    chain.reverse_log_weight(&beads, &mut random, &mut CancelToken::new()) - truth
                })
                .collect();
            let (ratio, error) = mean(&found.iter().map(|log| (-log).exp()).collect::<Vec<f64>>());
            let (log, _) = mean(&found);
            println!("{noise} {levels} backwards: {ratio} +- {error}, log {log}");
            // With too few temperatures, rare chains carry the mean.
            let fair = (ratio - 1.0).abs() < 4.0 * error + 1e-3;
            assert!(fair || levels < 100, "{noise} {levels}: {ratio} +- {error}");
            assert!(log > 0.0 && log < last, "{noise} {levels}: {log}");
            last = log;
        }
        assert!(last < 0.4, "{noise}: {last}");
    }
}

fn fit(groups: usize, levels: usize) -> AisSettings {
    AisSettings { groups, particles: 2, levels: Some(levels), samples: 200, half_width: 0.0, budget: None, seed: 6 }
}

fn bounds(channel: &BeadChannel, fit: &AisSettings) -> [AisBound; 2] {
    let decoder = Decoder::shipped().unwrap();
    [ais_lower_bound, ais_upper_bound].map(|bound| bound(channel, fit, decoder, None, &mut CancelToken::new()).unwrap())
}

/// The information of a toy by enumeration, bits per pixel, and its standard error.
fn truth_of(channel: &BeadChannel) -> (f64, f64) {
    let problem = Problem::new(channel).unwrap();
    let light = Light::new(&channel.checked_spot().unwrap(), &problem);
    let values: Vec<f64> = (0..4000)
        .map(|index| {
            let sample = sample(&problem, index);
            let measured = Measurement::new(&problem, &light, &sample, |_| false);
            let sites = sample.beads.len();
            let beads = (0..sites).filter(|&site| sample.beads[site] > 0.0);
            let own = State::new(&light, &measured, sites, beads).log_likelihood();
            (own - log_sum(&all_logs(&problem, &light, &measured))) / std::f64::consts::LN_2 / problem.pixels() as f64
        })
        .collect();
    mean(&values)
}

#[test]
fn read_noise_does_not_raise_the_upper_bound() {
    // As many groups as sites; each would add the error of a Gaussian approximation.
    let of = |noise: Noise| bounds(&toy(noise), &fit(10, 200))[1].clone();
    let (shot, both) = (of(Noise::Shot), of(Noise::ShotRead { sigma: 1.0 }));
    println!("{} {}", shot.bits_per_pixel, both.bits_per_pixel);
    assert!(both.bits_per_pixel < shot.bits_per_pixel + 0.06, "{both:?} {shot:?}");
}

#[test]
fn bounds_enclose_known_truth_and_converge() {
    for noise in NOISES {
        let channel = toy(noise);
        let (truth, error) = truth_of(&channel);
        let [coarse_low, coarse_high] = bounds(&channel, &fit(1, 2));
        let [low, high] = bounds(&channel, &fit(1, 4000));
        let [_, grouped] = bounds(&channel, &fit(5, 1000));
        println!(
            "{noise}: {truth:.4} +- {error:.4}; {:.4} {:.4} {:.4} {:.4}, in groups {:.4}",
            coarse_low.bits_per_pixel,
            low.bits_per_pixel,
            high.bits_per_pixel,
            coarse_high.bits_per_pixel,
            grouped.bits_per_pixel
        );
        // Three standard errors of both.
        let spread = |bound: &AisBound| 3.0 * error + (bound.interval_95[1] - bound.interval_95[0]) * 0.77;
        // The chain's model approximates shot plus read noise.
        let model = if matches!(noise, Noise::ShotRead { .. }) { 0.01 } else { 0.0 };
        for below in [&coarse_low, &low] {
            assert!(below.bits_per_pixel < truth + spread(below), "{noise}: {below:?} {truth}");
        }
        for above in [&coarse_high, &high, &grouped] {
            assert!(above.bits_per_pixel > truth - spread(above), "{noise}: {above:?} {truth}");
        }
        assert!((low.bits_per_pixel - truth).abs() < spread(&low) + 0.1 + model, "{noise}: {low:?} {truth}");
        assert!((high.bits_per_pixel - truth).abs() < spread(&high) + 0.1 + model, "{noise}: {high:?} {truth}");
        assert!(coarse_low.bits_per_pixel < low.bits_per_pixel && high.bits_per_pixel < coarse_high.bits_per_pixel);
        assert!(grouped.bits_per_pixel > high.bits_per_pixel);
    }
}

#[test]
fn equal_seeds_give_equal_bits_on_any_number_of_threads() {
    let channel = toy(Noise::Shot);
    let fit = AisSettings { samples: 24, ..fit(3, 10) };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bounds(&channel, &fit)).map(|bound| AisBound { seconds: 0.0, ..bound })
    };
    let one = on(1);
    assert_eq!(one, on(3));
    let text = serde_json::to_string(&one[1]).unwrap();
    assert_eq!(serde_json::from_str::<AisBound>(&text).unwrap(), one[1]);
    let other = bounds(&channel, &AisSettings { seed: 7, ..fit });
    assert_ne!(one[1].bits_per_pixel, other[1].bits_per_pixel);
}

#[test]
fn bound_can_be_cancelled_and_respects_its_budget() {
    let channel = toy(Noise::Shot);
    let decoder = Decoder::shipped().unwrap();
    let mut calls = 0;
    let stopped = ais_upper_bound(&channel, &fit(2, 5), decoder, None, &mut |_: &AisProgress| {
        calls += 1;
        if calls < 3 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    assert_eq!((stopped, calls), (Err(InformationError::Cancelled), 3));
    // Cancels inside a chain, too: all of its temperatures would take hours.
    let endless = AisSettings::of_levels(1 << 24, 1);
    let stopped = ais_lower_bound(&channel, &endless, decoder, None, &mut |_: &AisProgress| ControlFlow::Break(()));
    assert_eq!(stopped, Err(InformationError::Cancelled));
    let budget = std::time::Duration::from_millis(600);
    let fit = AisSettings { samples: usize::MAX, half_width: 0.0, ..AisSettings::within(budget, 1) };
    let bound = ais_upper_bound(&channel, &fit, decoder, None, &mut CancelToken::new()).unwrap();
    assert!(bound.seconds >= 0.6 && bound.seconds < 6.0 && bound.levels > 1, "{bound:?}");
}

#[test]
fn resumed_bound_equals_uninterrupted_bound() {
    let (channel, decoder) = (toy(Noise::Shot), Decoder::shipped().unwrap());
    let fit = AisSettings { samples: 24, ..fit(3, 10) };
    for bound in [ais_lower_bound, ais_upper_bound] {
        let run = |keeper: Option<&dyn FitCheckpoint>, stop_at: usize| {
            let mut expected_nats = Vec::new();
            let result = bound(&channel, &fit, decoder, keeper, &mut |progress: &AisProgress| {
                expected_nats.push(progress.samples);
                if progress.samples < stop_at { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            });
            (result.map(|bound| AisBound { seconds: 0.0, ..bound }), expected_nats)
        };
        let whole = run(None, usize::MAX).0.unwrap();
        let keepers: [&dyn FitCheckpoint; 2] = [&InMemory::default(), &InMemory::of_cancelled()];
        for keeper in keepers {
            assert_eq!(run(Some(keeper), 12).0, Err(InformationError::Cancelled));
            let (resumed, expected_nats) = run(Some(keeper), usize::MAX);
            // Samples of a block are in the checkpoint once the next block is there.
            assert_eq!((resumed.unwrap(), expected_nats[0] >= 8), (whole.clone(), true), "{expected_nats:?}");
        }
    }
    let broken = InMemory { state: Some(b"a letter".to_vec()).into(), ..InMemory::default() };
    let refusal = ais_upper_bound(&channel, &fit, decoder, Some(&broken), &mut CancelToken::new());
    let message = refusal.unwrap_err().to_string();
    assert!(message.contains("memory"), "{message}");
}

#[test]
fn resumed_bound_keeps_its_number_of_temperatures() {
    let (channel, decoder) = (toy(Noise::Shot), Decoder::shipped().unwrap());
    let keeper = InMemory::default();
    let (kept, elapsed) = ([0.25, 0.5, 0.75, 1.0].repeat(4), std::time::Duration::from_hours(2));
    AisCheckpoint::keep(&keeper, 77, &kept, elapsed).unwrap();
    // The budget is used up: one more block is computed, then sampling stops.
    let fit = AisSettings { half_width: 0.0, ..AisSettings::within(std::time::Duration::from_hours(1), 6) };
    let bound = ais_upper_bound(&channel, &fit, decoder, Some(&keeper), &mut CancelToken::new());
    let bound = bound.unwrap();
    assert_eq!((bound.levels, bound.samples), (77, 20));
    assert!(bound.seconds >= 7200.0, "{bound:?}");
}

#[test]
fn invalid_settings_are_refused() {
    let refused = |fit: &AisSettings, part: &str| {
        let decoder = Decoder::shipped().unwrap();
        let result = ais_upper_bound(&toy(Noise::Shot), fit, decoder, None, &mut CancelToken::new());
        let message = result.unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    };
    refused(&fit(0, 5), "groups");
    refused(&AisSettings { particles: 0, ..fit(1, 5) }, "particles");
    refused(&fit(1, 0), "temperatures");
    refused(&AisSettings { samples: 1, ..fit(1, 5) }, "two samples");
    let decoder = Decoder::shipped().unwrap();
    let none = ais_upper_bound(&toy(Noise::None), &fit(1, 5), decoder, None, &mut CancelToken::new());
    assert!(none.is_err());
}
