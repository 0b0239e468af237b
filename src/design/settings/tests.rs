//! Tests of the settings of a run.

use super::*;
use crate::optics::heuristic_layout;

#[test]
fn presets_are_valid_and_wrong_settings_are_named() {
    let start = heuristic_layout(3);
    for preset in [Preset::Default, Preset::Paper] {
        let beads = "beads:0.02".parse().unwrap();
        IdealSettings::new(preset, Objective::usual(preset, &beads), 1).check(&start).unwrap();
        assert_eq!(preset.to_string().parse(), Ok(preset));
    }
    let refusal = |change: &dyn Fn(&mut IdealSettings)| {
        let mut settings = IdealSettings::new(Preset::Default, Objective::Posterior, 1);
        change(&mut settings);
        settings.check(&start).unwrap_err().to_string()
    };
    for (sentence, part) in [
        (refusal(&|settings| settings.preset = Preset::Paper), "objective is posterior"),
        (refusal(&|settings| settings.objective = Objective::PixelCnn), "objective is pixelcnn"),
        (refusal(&|settings| settings.steps = 0), "steps is 0"),
        (refusal(&|settings| settings.rates.position = f64::NAN), "rates.position is NaN"),
        (refusal(&|settings| settings.locked = vec![3]), "locked is 4"),
        (refusal(&|settings| settings.locked = vec![0, 1, 2]), "may change"),
        (refusal(&|settings| settings.locked = vec![0, 2, 1, 0]), "may change"),
        (refusal(&|settings| settings.min_separation_px = 40.0), "min_separation_px is 40"),
        (refusal(&|settings| settings.cardinality = Some(0)), "at least 1"),
        (
            refusal(&|settings| settings.free = Free { positions: false, widths: false, weights: false }),
            "free is nothing",
        ),
    ] {
        assert!(sentence.contains(part), "{part} in {sentence}");
    }
    let usual = IdealSettings::new(Preset::Default, Objective::Posterior, 1);
    IdealSettings { locked: vec![1, 1, 1], cardinality: Some(1), ..usual }.check(&start).unwrap();
}

#[test]
fn rates_decay_at_the_end() {
    let settings =
        IdealSettings { steps: 100, decay_fraction: 0.4, ..IdealSettings::new(Preset::Default, Objective::Density, 1) };
    assert_eq!([settings.rate(0), settings.rate(60)], [1.0, 1.0]);
    assert!(settings.rate(80) < settings.rate(70) && (settings.rate(80) - 0.525).abs() < 1e-9);
    assert!((settings.rate(100) - LAST_RATE).abs() < 1e-12);
    assert_eq!(IdealSettings::new(Preset::Paper, Objective::Density, 1).rate(1999), 1.0);
}

#[test]
fn refits_of_a_density_model_shrink_with_the_rates() {
    let refits = |preset, objective| {
        let settings =
            IdealSettings { steps: 100, decay_fraction: 0.4, refit: 50, ..IdealSettings::new(preset, objective, 1) };
        [0, 60, 80, 100].map(|step| settings.refit_from(step))
    };
    assert_eq!(refits(Preset::Default, Objective::Density), [50, 50, 26, 25]);
    assert_eq!(refits(Preset::Default, Objective::Posterior), [50; 4]);
}

#[test]
fn objectives_have_names_and_beads_a_decoder() {
    for objective in Objective::ALL {
        assert_eq!(objective.to_string().parse(), Ok(objective));
        assert_eq!(serde_json::to_string(&objective).unwrap(), format!("\"{objective}\""));
    }
    assert!("gaussian".parse::<Objective>().is_err());
    let usual = |preset, objects: &str| Objective::usual(preset, &objects.parse().unwrap());
    assert_eq!(usual(Preset::Default, "volume:5:0.01"), Objective::Posterior);
    assert_eq!(usual(Preset::Default, "idx:digits"), Objective::Density);
    assert_eq!(usual(Preset::Paper, "beads:0.02"), Objective::PixelCnn);
    // Settings that were changed stay.
    let set = |settings| IdealSettings { cardinality: Some(7), patch: Some((24, 24)), ..settings };
    let settings = set(IdealSettings::new(Preset::Default, Objective::Density, 4));
    let turned = settings.with_preset(Preset::Default, Objective::Posterior);
    assert_eq!(turned, set(IdealSettings::new(Preset::Default, Objective::Posterior, 4)));
    let turned = IdealSettings { steps: 77, ..turned }.with_preset(Preset::Paper, Objective::Density);
    assert_eq!((turned.steps, turned.patch, turned.patches), (77, Some((24, 24)), 4096));
    // Unchanged settings are those of the new preset.
    let usual = IdealSettings::new(Preset::Default, Objective::Posterior, 4);
    assert_eq!(usual.with_preset(Preset::Default, Objective::Density).patch, Some((32, 32)));
}
