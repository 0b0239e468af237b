//! A study of decoders as Markdown for people and as CSV for other programs.

use super::record::{Correlation, DecoderStudyRecord, MaskRow};
use crate::information::with_interval;
use crate::plural::counted;
use crate::studies::markdown::{NOTHING, header, row};

/// Columns of the CSV table.
pub(super) const CSV_HEADER: [&str; 17] = [
    "objects",
    "design",
    "decoder",
    "psnr_db",
    "psnr_low_95_db",
    "psnr_high_95_db",
    "ssim",
    "mse",
    "r2",
    "psnr_constant_db",
    "published_psnr_db",
    "sensor_lower_bits_per_px",
    "sensor_upper_bits_per_px",
    "published_bits_per_px",
    "test_objects",
    "seconds",
    "failure",
];

/// The rows under [`CSV_HEADER`].
pub(super) fn csv_rows(record: &DecoderStudyRecord) -> Vec<Vec<String>> {
    let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:?}"));
    let mut table = Vec::new();
    for (index, objects) in record.settings.objects.iter().enumerate() {
        for row in record.rows(index) {
            for (decoder, quality) in record.settings.decoders.iter().zip(&row.quality) {
                let source = objects.source.to_string();
                let failure = record.cells.iter().find(|cell| {
                    (&cell.objects, cell.design.as_str(), cell.decoder) == (&source, row.design, Some(*decoder))
                });
                let of = |value: &dyn Fn(&crate::reconstruction::DecoderQuality) -> Option<f64>| {
                    number(quality.and_then(value))
                };
                table.push(vec![
                    source.clone(),
                    row.design.to_owned(),
                    decoder.to_string(),
                    of(&|quality| Some(quality.psnr_db)),
                    of(&|quality| Some(quality.psnr_db_interval_95[0])),
                    of(&|quality| Some(quality.psnr_db_interval_95[1])),
                    of(&|quality| Some(quality.ssim)),
                    of(&|quality| Some(quality.mse)),
                    of(&|quality| quality.r2),
                    of(&|quality| Some(quality.psnr_constant_db)),
                    number(row.published_psnr_db),
                    number(row.information.and_then(|information| information.lower)),
                    number(row.information.map(|information| information.upper)),
                    number(row.published_bits),
                    quality.map_or(String::new(), |quality| quality.test_objects.to_string()),
                    of(&|quality| Some(quality.seconds)),
                    failure.and_then(|cell| cell.failure.clone()).unwrap_or_default(),
                ]);
            }
        }
    }
    table
}

/// The whole study as Markdown.
pub(super) fn markdown(record: &DecoderStudyRecord) -> String {
    let settings = &record.settings;
    let sweeps =
        settings.sweeps.map_or(String::new(), |sweeps| format!("; posterior mean by {}", counted(sweeps, "sweep")));
    let training = if settings.decoders.iter().any(|decoder| decoder.needs().training) {
        format!("; networks trained for {} s", settings.training_seconds)
    } else {
        String::new()
    };
    let mut lines = vec![
        "# Information and decoders".to_owned(),
        String::new(),
        format!(
            "{} protocol; {}{sweeps}{training}; information of the whole sensor within {} s; seed {}; Lenslet Studio {}. Information in bits per \
             pixel, PSNR in dB, 95 % intervals.",
            settings.protocol,
            counted(settings.test, "test object"),
            settings.information_seconds,
            settings.seed,
            record.program_version
        ),
    ];
    for (index, objects) in settings.objects.iter().enumerate() {
        lines.extend([String::new(), format!("## {}", objects.source), String::new()]);
        let decoders = settings.decoders.iter().map(ToString::to_string);
        let names = ["lenslets", "sensor", "published patch", "published PSNR"].map(str::to_owned);
        let names: Vec<String> = names.into_iter().chain(decoders).collect();
        lines.extend(header(names.iter().map(String::as_str)));
        lines.extend(record.rows(index).iter().map(|of_mask| row(columns(of_mask).into_iter())));
        let source = objects.source.to_string();
        lines.push(String::new());
        lines.extend(record.correlations.iter().filter(|found| found.objects == source).map(sentence));
    }
    let failures = record.cells.iter().filter_map(|cell| Some((cell, cell.failure.as_ref()?)));
    lines.extend(failures.map(|(cell, failure)| format!("- failed: {}, {}: {failure}", cell.objects, cell.design)));
    lines.push(String::new());
    lines.join("\n")
}

fn columns(row: &MaskRow<'_>) -> Vec<String> {
    let value = |value: Option<f64>| value.map_or(NOTHING.to_owned(), |value| format!("{value:.2}"));
    let information = row.information.map_or(NOTHING.to_owned(), |information| {
        let interval = information.lower_interval_95.unwrap_or(information.upper_interval_95);
        with_interval(information.best(), interval)
    });
    let published = row.published_bits.map_or(NOTHING.to_owned(), |bits| format!("{bits:.3}"));
    let mask = row.lenslets.map_or(row.design.to_owned(), |count| count.to_string());
    let quality = row.quality.iter().map(|quality| {
        quality.map_or(NOTHING.to_owned(), |quality| with_interval(quality.psnr_db, quality.psnr_db_interval_95))
    });
    [mask, information, published, value(row.published_psnr_db)].into_iter().chain(quality).collect()
}

fn sentence(correlation: &Correlation) -> String {
    let decoder = correlation.decoder.map_or("published U-net".to_owned(), |decoder| decoder.to_string());
    let value = |value: Option<f64>| value.map_or(NOTHING.to_owned(), |value| format!("{value:.2}"));
    format!(
        "- {decoder}: PSNR and information of the whole sensor: Spearman {}, Pearson {}; published information of patches: Spearman {}, \
         Pearson {}; {}",
        value(correlation.spearman_sensor),
        value(correlation.pearson_sensor),
        value(correlation.spearman_published),
        value(correlation.pearson_published),
        counted(correlation.designs, "mask")
    )
}
