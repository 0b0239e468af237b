//! What the Markdown tables of studies share: rows, and numbers with their intervals.

use crate::information::{Estimate, PairedDifference};

/// Text of an empty place.
pub(super) const NOTHING: &str = "-";

/// A row of a table; a bar in a text would end its column.
pub(super) fn row(columns: impl Iterator<Item = String>) -> String {
    let columns: Vec<String> = columns.map(|text| text.replace('|', "\\|").replace('\n', " ")).collect();
    format!("| {} |", columns.join(" | "))
}

/// A header of these columns, with the line below it.
pub(super) fn header<'a>(columns: impl Iterator<Item = &'a str> + Clone) -> [String; 2] {
    [row(columns.clone().map(str::to_owned)), row(columns.map(|_| "---".to_owned()))]
}

/// A value in bits per pixel with its interval. A bound without samples has none.
pub(super) fn with_interval(bits: f64, interval: Option<[f64; 2]>) -> String {
    match interval {
        Some([low, high]) if low < high => format!("{bits:.4} ({low:.4} to {high:.4})"),
        _ => format!("{bits:.4}"),
    }
}

/// A value in bits per pixel, where there is one.
pub(super) fn bits(value: Option<f64>) -> String {
    value.map_or(NOTHING.into(), |bits| format!("{bits:.4}"))
}

/// A difference with its sign and interval, where there is one.
pub(super) fn difference(value: Option<PairedDifference>) -> String {
    value.map_or(NOTHING.into(), |PairedDifference { bits_per_pixel, interval_95: [low, high] }| {
        format!("{bits_per_pixel:+.4} ({low:+.4} to {high:+.4})")
    })
}

/// The lower bound of an estimate with its interval, where there is one.
pub(super) fn lower(estimate: Option<&Estimate>) -> String {
    let bracket = estimate.and_then(|estimate| estimate.bracket.as_ref());
    match bracket.and_then(|bracket| Some((bracket.lower?, bracket.lower_interval_95))) {
        Some((bits, interval)) => with_interval(bits, interval),
        None => NOTHING.into(),
    }
}
