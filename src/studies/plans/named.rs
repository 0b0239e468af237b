//! The plans of the published figures, and others by name.

use super::axes::{Axes, Axis};
use super::cell::{Freedom, StudyMask};
use super::estimates::EstimateSettings;
use super::facet::Facet;
use super::plan::{Plan, PlotSettings, QuickSettings};
use super::reconstruction::ReconstructionSettings;
use super::study_decoder::StudyDecoder;
use crate::forward::MaskSource;
use crate::information::Estimator;
use crate::objects::ObjectSource;
use crate::reconstruction::DecoderKind;
use crate::sensor::{Noise, PatchSize};
use crate::studies::error::StudyError;
use crate::studies::published::PublishedSet;

/// Bead densities of the published sweep.
const DENSITIES: [&str; 24] = [
    "0.008", "0.009", "0.01", "0.011", "0.012", "0.013", "0.015", "0.017", "0.02", "0.023", "0.026", "0.03", "0.034",
    "0.04", "0.045", "0.05", "0.06", "0.07", "0.08", "0.09", "0.1", "0.11", "0.13", "0.15",
];
/// Densities of beads with a constant photon count.
const DENSE: [&str; 12] = ["0.005", "0.01", "0.02", "0.03", "0.05", "0.08", "0.11", "0.15", "0.2", "0.3", "0.4", "0.5"];
/// Densities behind a diffuser: the published range to 0.02, and denser ones, where information begins to fall.
const SPARSE: [&str; 12] =
    ["0.002", "0.003", "0.004", "0.005", "0.006", "0.008", "0.01", "0.013", "0.02", "0.03", "0.04", "0.05"];
/// Densities around the transition from sparse to dense scenes.
const TRANSITION: [&str; 6] = ["0.005", "0.008", "0.013", "0.02", "0.03", "0.05"];
/// Apertures of the published diffuser, pixels.
const APERTURES: [usize; 5] = [32, 28, 16, 12, 8];
/// Whole sensors of the fit and of the score of an estimate.
const SENSORS_TRAIN: usize = 2_000;
const SENSORS_TEST: usize = 300;
/// Lenslets of a random start.
const RANDOM: usize = 25;

/// A plan that has a name.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedPlan {
    /// One sentence about its question.
    pub question: &'static str,
    /// The plan.
    pub plan: Plan,
}

fn lines(x: Facet, lines: Facet) -> PlotSettings {
    PlotSettings { x, lines, panels: None, logarithmic: false, optima: false, scatter: false }
}

/// A sweep over bead density: one line for each mask, its optimum, and the sensor's Tamura coefficient there.
fn sweep(name: &str, title: &str, mask: Vec<StudyMask>, kind: &str, densities: &[&str]) -> Plan {
    let objects = densities.iter().map(|density| format!("{kind}:{density}")).collect();
    let axes = Axes { estimator: vec![Estimator::Bracket], ..Axes::new(mask, objects) };
    let plot = PlotSettings { logarithmic: true, optima: true, ..lines(Facet::Density, Facet::Axis(Axis::Mask)) };
    // A bracket of beads is tight within seconds, as its fits start from pretrained weights.
    let quick = QuickSettings { seconds: 8.0, ..QuickSettings::default() };
    Plan { quick, ..Plan::new(name, title, axes, plot) }
}

/// A plan whose first look has all its objects.
fn keeping_objects(plan: Plan) -> Plan {
    Plan { quick: QuickSettings { keep: vec![Axis::Objects], ..plan.quick.clone() }, ..plan }
}

fn heuristic(counts: impl IntoIterator<Item = usize>) -> Vec<StudyMask> {
    counts.into_iter().map(StudyMask::heuristic).collect()
}

fn designed(start: MaskSource, freedom: Freedom) -> StudyMask {
    StudyMask::Ideal { start, freedom }
}

/// All named plans, those of the published figures first.
pub fn named_plans() -> Vec<NamedPlan> {
    let named = |question, plan| NamedPlan { question, plan };
    vec![
        named(
            "How does information depend on bead density and on the number of lenslets?",
            sweep("fig2", "Information against bead density", heuristic(1..=9), "beads", &DENSITIES),
        ),
        named("Which masks suit which objects, and how much better are designed ones?", fig3()),
        named("How far do small patches overstate the information of the sensor?", s1()),
        named("Does the information of lenslets in depth depend on lenslets and planes by their minimum alone?", s2()),
        named(
            "How does information depend on the aperture of a diffuser and on bead density?",
            sweep(
                "s3",
                "Diffusers: information against bead density",
                APERTURES.into_iter().map(|side| StudyMask::Given(MaskSource::Diffuser(side))).collect(),
                "beads",
                &SPARSE,
            ),
        ),
        named("Does figure 2 hold under read noise?", {
            let plan =
                sweep("s4", "Read noise: information against bead density", heuristic(1..=9), "beads", &DENSITIES);
            Plan { axes: Axes { noise: vec![Noise::Read { sigma: 5.0 }], ..plan.axes }, ..plan }
        }),
        named(
            "Does figure 2 hold with a constant photon count per bead?",
            sweep(
                "s5",
                "Constant photons per bead: information against density",
                heuristic(1..=9),
                "beads-max",
                &DENSE,
            ),
        ),
        named("Do elliptic lenslets beat round ones?", shape()),
        named("How do estimates compare with published values, over four bead densities and five layouts?", grid()),
        named("How far do patches overstate the sensor, for one mask and its objects?", patches()),
        named(
            "Between which bounds does the information lie, over six bead densities and nine layouts?",
            sweep("bracket", "Lower and upper bounds against bead density", heuristic(1..=9), "beads", &TRANSITION),
        ),
        named("Does the information of the whole sensor predict what decoders make of its measurements?", decoders()),
    ]
}

impl NamedPlan {
    /// The plan of this name.
    pub fn find(name: &str) -> Option<Self> {
        named_plans().into_iter().find(|named| named.plan.name == name)
    }

    /// Number of cells, also while the published image sets have no files.
    ///
    /// # Errors
    /// As [`Plan::cells`].
    pub fn cell_count(&self) -> Result<usize, StudyError> {
        let mut plan = self.plan.clone();
        for name in plan.axes.objects.iter().filter(|name| PublishedSet::named(name).is_some()) {
            plan.sets.insert(name.clone(), ObjectSource::Idx(name.into()));
        }
        Ok(plan.cells()?.len())
    }
}

fn fig3() -> Plan {
    let best = [MaskSource::Random(RANDOM)].into_iter().map(|start| designed(start, Freedom::Round));
    let layouts = [4, 6, 9].map(|count| designed(MaskSource::Heuristic(count), Freedom::EqualWeights));
    let mask = heuristic(1..=9).into_iter().chain(best).chain(layouts).collect();
    let objects = ["mnist", "fashion", "cifar10", "beads:0.02"].map(str::to_owned).into();
    let plot = PlotSettings {
        panels: Some(Facet::Axis(Axis::Objects)),
        ..lines(Facet::Axis(Axis::Mask), Facet::Axis(Axis::Estimator))
    };
    let plan = Plan::new("fig3", "Information of layouts and of designed masks", Axes::new(mask, objects), plot);
    keeping_objects(Plan { reconstruction: Some(ReconstructionSettings::of(DecoderKind::Network)), ..plan })
}

fn s1() -> Plan {
    let patch = [2, 4, 6, 8, 10, 12, 16, 24, 32, 48].map(|side| PatchSize::Shape(side, side));
    let objects = ["cifar10", "mnist", "beads:0.02"].map(str::to_owned).into();
    let axes =
        Axes { patch: patch.into_iter().chain([PatchSize::Sensor]).collect(), ..Axes::new(heuristic([4, 8]), objects) };
    let plot = PlotSettings {
        logarithmic: true,
        panels: Some(Facet::Axis(Axis::Objects)),
        ..lines(Facet::Axis(Axis::Patch), Facet::Axis(Axis::Mask))
    };
    keeping_objects(Plan::new("s1", "Information against the size of the patch", axes, plot))
}

fn s2() -> Plan {
    let mask = (1..=5).map(|count| StudyMask::Given(MaskSource::Depth(count))).collect();
    let objects = ["0.02", "0.08"]
        .into_iter()
        .flat_map(|density| (1..=5).map(move |planes| format!("volume:{planes}:{density}")))
        .collect();
    let plot = PlotSettings { panels: Some(Facet::Density), ..lines(Facet::Axis(Axis::Mask), Facet::Planes) };
    keeping_objects(Plan::new("s2", "Lenslets in depth before objects in planes", Axes::new(mask, objects), plot))
}

fn shape() -> Plan {
    let start = || MaskSource::Random(RANDOM);
    let mask = vec![
        StudyMask::heuristic(8),
        StudyMask::heuristic(9),
        designed(start(), Freedom::Round),
        designed(start(), Freedom::Elliptic),
    ];
    let plot = lines(Facet::Axis(Axis::Mask), Facet::Axis(Axis::Objects));
    Plan::new("s5-shape", "Round and elliptic lenslets", Axes::new(mask, vec!["mnist".into()]), plot)
}

fn grid() -> Plan {
    let objects = ["0.008", "0.02", "0.05", "0.11"].map(|density| format!("beads:{density}")).into();
    let axes = Axes::new(heuristic([1, 2, 4, 6, 9]), objects);
    Plan::new(
        "grid",
        "Estimates and published values",
        axes,
        lines(Facet::Axis(Axis::Mask), Facet::Axis(Axis::Objects)),
    )
}

fn patches() -> Plan {
    let patch = [8, 12, 16, 24, 32, 48].map(|side| PatchSize::Shape(side, side));
    let axes = Axes {
        patch: patch.into_iter().chain([PatchSize::Sensor]).collect(),
        ..Axes::new(heuristic([9]), vec!["beads:0.02".into()])
    };
    let plan = Plan::new(
        "patches",
        "Patches and the whole sensor",
        axes,
        lines(Facet::Axis(Axis::Patch), Facet::Axis(Axis::Mask)),
    );
    Plan { quick: QuickSettings { seconds: 20.0, ..QuickSettings::default() }, ..plan }
}

/// Information and image quality of the same measurements: one light, one background.
fn decoders() -> Plan {
    let objects = ["beads:0.02", "mnist", "cifar10", "fashion"].map(str::to_owned).into();
    let kinds = [DecoderKind::Linear, DecoderKind::TotalVariation, DecoderKind::Posterior, DecoderKind::Network];
    let axes = Axes {
        patch: vec![PatchSize::Sensor],
        // Lower bounds of beads rank masks without the looseness of a density model.
        estimator: vec![Estimator::Bracket],
        decoder: kinds.map(StudyDecoder::Kind).into(),
        ..Axes::new(heuristic(1..=9), objects)
    };
    let plot = PlotSettings {
        panels: Some(Facet::Axis(Axis::Objects)),
        scatter: true,
        ..lines(Facet::Axis(Axis::Mask), Facet::Axis(Axis::Decoder))
    };
    // Few whole sensors suffice: each has thousands of pixels.
    let estimates = EstimateSettings {
        seconds: Some(60.0),
        patches_train: SENSORS_TRAIN,
        patches_test: SENSORS_TEST,
        ..EstimateSettings::default()
    };
    keeping_objects(Plan { estimates, ..Plan::new("decoders", "Information and decoders", axes, plot) })
}
