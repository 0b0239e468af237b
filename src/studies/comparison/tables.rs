//! A study as tables: Markdown for people, CSV for other programs. Information is in bits per pixel.

use crate::information::BoundMethod;
use crate::objects::ObjectSource;
use crate::plural::counted;
use crate::studies::comparison::record::{StudyCell, StudyRecord};
use crate::studies::comparison::settings::{StudySettings, patch_name};
use crate::studies::markdown::{NOTHING, bits, difference, header, lower, row, with_interval};

/// Columns of the CSV table; information and intervals in bits per pixel. Unknown values are empty.
pub(super) const CSV_HEADER: [&str; 31] = [
    "objects",
    "density_beads_per_px",
    "design",
    "lenslets",
    "patch_rows_px",
    "patch_cols_px",
    "estimator",
    "bits_per_px",
    "low_95_bits_per_px",
    "high_95_bits_per_px",
    "upper_from",
    "lower_bits_per_px",
    "lower_low_95_bits_per_px",
    "lower_high_95_bits_per_px",
    "lower_from",
    "decoder_bound_bits_per_px",
    "posterior_sampling_lower_bits_per_px",
    "posterior_sampling_upper_bits_per_px",
    "density_bound_bits_per_px",
    "first_design_less_this_density_model_bits_per_px",
    "difference_to_reference_low_95_bits_per_px",
    "difference_to_reference_high_95_bits_per_px",
    "gaussian_bound_bits_per_px",
    "ceiling_bits_per_px",
    "published_bits_per_px",
    "published_low_95_bits_per_px",
    "published_high_95_bits_per_px",
    "seconds",
    "processor",
    "threads",
    "failure",
];

/// A cell under [`CSV_HEADER`]; numbers have the digits that read back to the same value.
pub(super) fn csv_row(settings: &StudySettings, cell: &StudyCell) -> Vec<String> {
    let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:?}"));
    let count = |value: Option<usize>| value.map_or(String::new(), |value| value.to_string());
    let estimate = cell.estimate.as_ref();
    let bracket = estimate.and_then(|estimate| estimate.bracket.as_ref());
    let patch = estimate.map(|estimate| estimate.patch);
    let design = settings.designs.iter().find(|design| design.name == cell.design);
    let interval = estimate.map(|estimate| estimate.interval_95);
    let lower_interval = bracket.and_then(|bracket| bracket.lower_interval_95);
    let published_interval = cell.published.and_then(|published| published.interval_95);
    vec![
        cell.objects.clone(),
        number(density_of(cell)),
        cell.design.clone(),
        count(design.and_then(crate::studies::StudyDesign::lenslets)),
        count(patch.map(|[rows, _]| rows).or(cell.patch.map(|(rows, _)| rows))),
        count(patch.map(|[_, cols]| cols).or(cell.patch.map(|(_, cols)| cols))),
        settings.estimator.to_string(),
        number(cell.bits_per_pixel()),
        number(interval.map(|[low, _]| low)),
        number(interval.map(|[_, high]| high)),
        cell.chosen_from().map(BoundMethod::name_in_files).unwrap_or_default(),
        number(cell.lower()),
        number(lower_interval.map(|[low, _]| low)),
        number(lower_interval.map(|[_, high]| high)),
        bracket.and_then(|bracket| bracket.lower_from).map(BoundMethod::name_in_files).unwrap_or_default(),
        number(cell.lower_from_decoder()),
        number(cell.lower_from_ais()),
        number(cell.upper_from(BoundMethod::Ais)),
        number(cell.upper_from(BoundMethod::Density)),
        number(cell.difference_to_reference.map(|difference| difference.bits_per_pixel)),
        number(cell.difference_to_reference.map(|difference| difference.interval_95[0])),
        number(cell.difference_to_reference.map(|difference| difference.interval_95[1])),
        number(cell.upper_from(BoundMethod::Gaussian)),
        number(cell.ceiling()),
        number(cell.published.map(|published| published.bits_per_pixel)),
        number(published_interval.map(|[low, _]| low)),
        number(published_interval.map(|[_, high]| high)),
        number(estimate.map(|estimate| estimate.seconds)),
        cell.machine.processor.clone(),
        cell.machine.threads.to_string(),
        cell.failure.clone().unwrap_or_default(),
    ]
}

/// Share of the pixels that hold a bead, where the objects of a cell are beads in one plane.
pub(super) fn density_of(cell: &StudyCell) -> Option<f64> {
    match cell.objects.parse() {
        Ok(ObjectSource::Beads { density } | ObjectSource::BeadsMax { density }) => Some(density),
        _ => None,
    }
}

/// The whole study as Markdown, for people.
pub(super) fn markdown(record: &StudyRecord) -> String {
    let settings = &record.settings;
    let budget = settings.budget_seconds.map_or(String::new(), |seconds| format!(", {seconds} s for each cell"));
    let has_mean = settings.objects.iter().any(|objects| objects.source.has_mean());
    let light = if has_mean {
        format!(", {} per pixel on average", counted(settings.mean_photons, "photon"))
    } else {
        String::new()
    };
    let mut lines = vec![
        "# Objects and designs".to_owned(),
        String::new(),
        format!(
            "Estimator {}{budget}; {} noise{light}, {} per pixel of background; {}; seed {}; \
             Lenslet Studio {}. Information in bits per pixel, 95 % intervals.",
            settings.estimator,
            settings.noise,
            counted(settings.bias_photons, "photon"),
            counted(settings.patches_test, "test patch"),
            settings.seed,
            record.program_version
        ),
        String::new(),
    ];
    lines.extend(header(HEADER.into_iter()));
    lines.extend(record.cells.iter().map(|cell| row(columns(cell).into_iter())));
    lines.push(String::new());
    lines.extend(record.summary.lines().iter().map(|text| format!("- {text}")));
    let failures = record.cells.iter().filter_map(|cell| Some((cell.name(), cell.failure.as_ref()?)));
    lines.extend(failures.map(|(name, failure)| format!("- failed: {name}: {failure}")));
    lines.extend(record.notices.iter().map(|notice| format!("- {notice}")));
    let mut machines: Vec<String> = Vec::new();
    for cell in &record.cells {
        let machine = cell.machine.describe();
        if !machines.contains(&machine) {
            machines.push(machine);
        }
    }
    lines.extend(machines.iter().map(|machine| format!("- computed on {machine}")));
    lines.push(String::new());
    lines.join("\n")
}

const HEADER: [&str; 12] = [
    "objects",
    "design",
    "patch",
    "estimate",
    "from",
    "lower bound",
    "density bound",
    "first design's - this",
    "entropy bound",
    "published",
    "estimate - published",
    "seconds",
];

fn columns(cell: &StudyCell) -> Vec<String> {
    let above_published = cell.bits_per_pixel().zip(cell.published).map(|(bits, known)| bits - known.bits_per_pixel);
    vec![
        cell.objects.clone(),
        cell.design.clone(),
        patch_name(cell.patch),
        estimate(cell),
        upper_from(cell),
        lower(cell.estimate.as_ref()),
        density(cell),
        difference(cell.difference_to_reference),
        bits(cell.ceiling()),
        published(cell),
        above_published.map_or(NOTHING.into(), |bits| format!("{bits:+.4}")),
        seconds(cell),
    ]
}

fn estimate(cell: &StudyCell) -> String {
    match &cell.estimate {
        Some(estimate) => with_interval(estimate.bits_per_pixel, Some(estimate.interval_95)),
        None => "failed".into(),
    }
}

/// Name of the bound that the estimate was chosen from.
fn upper_from(cell: &StudyCell) -> String {
    cell.chosen_from().map_or(NOTHING.into(), |method| method.to_string())
}

/// The density model's bound, and whether it is above the object-entropy bound.
fn density(cell: &StudyCell) -> String {
    let bound = bits(cell.model_bits());
    let above = cell.model_bits().zip(cell.ceiling()).is_some_and(|(bits, ceiling)| bits > ceiling);
    if above { format!("{bound}, above the entropy bound") } else { bound }
}

fn published(cell: &StudyCell) -> String {
    cell.published.map_or(NOTHING.into(), |known| with_interval(known.bits_per_pixel, known.interval_95))
}

fn seconds(cell: &StudyCell) -> String {
    cell.estimate.as_ref().map_or(NOTHING.into(), |estimate| format!("{:.1}", estimate.seconds))
}
