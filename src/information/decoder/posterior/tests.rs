use std::ops::ControlFlow;

use super::super::super::test_beads::bead_spot;
use super::super::channel::BeadChannel;
use super::super::layers::Decoder;
use super::*;
use crate::sensor::Noise;

#[test]
#[ignore]
fn tune() {
    let text = |name: &str, usual: &str| std::env::var(name).unwrap_or(usual.to_owned());
    let number = |name: &str, usual: &str| text(name, usual).parse::<f64>().unwrap();
    let (lenslets, p) = (number("L", "4") as usize, number("P", "0.02"));
    let channel =
        BeadChannel { spot: bead_spot(lenslets, p), probability: p, bias: 10.0, noise: Noise::Shot, patch: (32, 32) };
    let fit = PosteriorFit {
        groups: number("G", "4") as usize,
        walkers: number("K", "4") as usize,
        levels: number("T", "250") as usize,
        samples: number("N", "16") as usize,
        half_width: 0.0,
        budget: None,
        seed: 11,
    };
    let on = &mut |_: &PosteriorProgress| ControlFlow::Continue(());
    let decoder = Decoder::shipped().unwrap();
    let show = |name: &str, b: &PosteriorBound| {
        println!(
            "{name} L={lenslets} P={p} G={} K={} T={} N={}: {:.4} +- {:.4}, {:.2} s",
            b.groups, b.walkers, b.levels, b.samples, b.bits_per_pixel, b.interval_95[1] - b.bits_per_pixel, b.seconds
        );
    };
    if text("SIDE", "both") != "lower" {
        show("upper", &posterior_upper_bound(&channel, &fit, decoder, on).unwrap());
    }
    if text("SIDE", "both") != "upper" {
        show("lower", &posterior_lower_bound(&channel, &fit, decoder, on).unwrap());
    }
}
