//! Plans with an axis of decoders, with estimates of fractions of a second.

use std::time::Duration;

use super::axes::Axis;
use super::cell::{CellSettings, StudyMask};
use super::correlation::{CORRELATION_HEADER, Correlation, correlations};
use super::facet::Facet;
use super::figure::{Quantity, figure_of};
use super::folder::{CellState, StudyFolder};
use super::named::NamedPlan;
use super::paint::svg;
use super::plan::{Plan, time_of, times_of};
use super::reconstruction::ReconstructionSettings;
use super::shard::Shard;
use super::study_decoder::StudyDecoder;
use super::table::{CSV_HEADER, StudyTable};
use super::tests::{begun, computed, sentence, small};
use crate::information::Protocol;
use crate::objects::ObjectSource;
use crate::reconstruction::{DecoderKind, DecoderQuality};

const LINEAR: StudyDecoder = StudyDecoder::Kind(DecoderKind::Linear);
const VARIATION: StudyDecoder = StudyDecoder::Kind(DecoderKind::TotalVariation);
const POSTERIOR: StudyDecoder = StudyDecoder::Kind(DecoderKind::Posterior);

/// Three layouts imaging beads of one density, as the plan of decoders draws them.
fn scattered(decoder: &[StudyDecoder]) -> Plan {
    let mut plan = small();
    plan.axes.mask = [1, 4, 6].map(StudyMask::heuristic).into();
    plan.axes.objects = vec!["beads:0.02".into()];
    plan.axes.decoder = decoder.to_vec();
    plan.plot = NamedPlan::find("decoders").unwrap().plan.plot;
    plan.reconstruction =
        Some(ReconstructionSettings { test_objects: 3, ..ReconstructionSettings::of(DecoderKind::Linear) });
    plan
}

/// A study whose cells have the estimates of their masks and the PSNR of `psnr_db`, by the place of the decoder and the information.
fn with_quality(decoder: &[StudyDecoder], psnr_db: &dyn Fn(usize, f64) -> f64) -> (StudyFolder, Vec<CellState>) {
    let place = tempfile::tempdir().unwrap();
    let masks = begun(scattered(&[StudyDecoder::Absent]), &place.path().join("masks"));
    computed(&masks, Shard::default());
    let folder = begun(scattered(decoder), &place.path().join("decoders"));
    let estimates = masks.states().unwrap();
    let state = |(index, cell): (usize, &CellSettings)| {
        let mut record = estimates[index % estimates.len()].done().unwrap().clone();
        record.settings = cell.clone();
        let psnr_db = psnr_db(index / estimates.len(), record.lower().unwrap());
        record.reconstruction = cell.reconstruction.map(|settings| quality(settings.decoder, psnr_db));
        CellState::Done(Box::new(record))
    };
    let states = folder.cells().iter().enumerate().map(state).collect();
    (folder, states)
}

fn quality(decoder: DecoderKind, psnr_db: f64) -> DecoderQuality {
    DecoderQuality {
        decoder,
        protocol: Protocol::Default,
        psnr_db,
        psnr_db_interval_95: [psnr_db - 0.1, psnr_db + 0.1],
        ssim: 0.8,
        ssim_interval_95: [0.7, 0.9],
        mse: 0.001,
        mse_interval_95: [0.0009, 0.0011],
        r2: Some(0.7),
        r2_interval_95: Some([0.6, 0.8]),
        psnr_constant_db: 23.7,
        psnr_constant_db_interval_95: [23.6, 23.8],
        psnr_unclipped_db: psnr_db,
        psnr_unclipped_db_interval_95: [psnr_db - 0.1, psnr_db + 0.1],
        psnr_linear_closed_form_db: None,
        psnr_posterior_db: None,
        test_objects: 3,
        networks: 0,
        peak_photons: 100.0,
        seed: 1,
        seconds: 1.0,
    }
}

#[test]
fn ids_of_plans_with_one_decoder_or_none_are_those_of_earlier_folders() {
    let of = |name: &str, lenslets: usize, decoder: Option<DecoderKind>| {
        let mut plan = NamedPlan::find(name).unwrap().plan;
        plan.axes.mask = vec![StudyMask::heuristic(lenslets)];
        plan.axes.objects = vec!["beads:0.02".into()];
        plan.axes.decoder = decoder.map(StudyDecoder::Kind).into_iter().collect();
        plan.cells().unwrap()[0].id()
    };
    assert_eq!(of("fig2", 1, None), "399bfaf15150f088");
    assert_eq!(of("fig3", 4, None), "04763856ba12f527");
    assert_eq!(of("grid", 4, Some(DecoderKind::Linear)), "104a79b840a4d6e4");
    // A decoder as an axis and as the one of the reconstruction are one cell.
    let mut plan = NamedPlan::find("grid").unwrap().plan;
    plan.axes.mask = vec![StudyMask::heuristic(4)];
    plan.axes.objects = vec!["beads:0.02".into()];
    plan.reconstruction = Some(ReconstructionSettings::of(DecoderKind::Linear));
    assert_eq!(plan.cells().unwrap()[0].id(), "104a79b840a4d6e4");
}

#[test]
fn cells_whose_decoder_does_not_fit_their_objects_are_left_out() {
    let mut plan = scattered(&[LINEAR, POSTERIOR]);
    assert_eq!(plan.left_out().unwrap(), None);
    plan.axes.objects.push("photos".into());
    plan.sets.insert("photos".into(), ObjectSource::Images("photos".into()));
    let names: Vec<String> =
        plan.cells().unwrap().iter().map(|cell| plan.value(Facet::Axis(Axis::Decoder), cell)).collect();
    assert_eq!(names.concat(), ["linear"; 3].concat() + &["posterior"; 3].concat() + &["linear"; 3].concat());
    assert_eq!(plan.left_out().unwrap().as_deref(), Some("decoder posterior is for beads: 3 cells of photos left out"));
    // Objects without any cell are no study of them.
    plan.axes.decoder = vec![POSTERIOR];
    assert!(sentence(plan.cells()).contains("decoder posterior: expected beads"));
    plan.axes.decoder.push(StudyDecoder::Absent);
    assert_eq!(plan.cells().unwrap().len(), 3 + 2 * 3);
}

#[test]
fn decoders_share_the_estimate_of_their_mask() {
    let place = tempfile::tempdir().unwrap();
    let mut plan = scattered(&[StudyDecoder::Absent, LINEAR]);
    plan.axes.mask.truncate(2);
    let folder = begun(plan, place.path());
    let times = times_of(folder.cells());
    let alone = time_of(&folder.cells()[0], true);
    assert_eq!((times.len(), times[0], times[2] <= times[0]), (4, alone, true));
    // A task has all cells of its estimates.
    let ranks = folder.ranks();
    assert_eq!(ranks[..2], ranks[2..]);
    let shards: [Shard; 2] = ["0/2", "1/2"].map(|text| text.parse().unwrap());
    assert_eq!(shards.map(|shard| computed(&folder, shard)), [2, 2]);
    let states = folder.states().unwrap();
    let records: Vec<_> = states.iter().map(|state| state.done().unwrap()).collect();
    for (mask, (first, other)) in records[..2].iter().zip(&records[2..]).enumerate() {
        assert!(first.estimate_of.is_none() && first.reconstruction.is_none());
        assert_eq!(other.estimate_of.as_ref(), Some(&folder.ids()[mask]));
        assert_eq!((&other.estimate, &other.test_patches), (&first.estimate, &first.test_patches));
        assert_eq!((&other.mask_fingerprint, other.sensor_tamura), (&first.mask_fingerprint, first.sensor_tamura));
        assert!(other.reconstruction.is_some());
    }
    // A cell that is lost takes the estimate of another one again.
    std::fs::remove_file(folder.cell_file(0)).unwrap();
    assert_eq!(computed(&folder, Shard::default()), 1);
    let again = folder.state(0).unwrap();
    assert_eq!(again.done().unwrap().estimate, records[0].estimate);
    assert!(again.done().unwrap().estimate_of.is_some());
}

#[test]
fn one_estimate_is_one_point_of_information() {
    let (folder, states) = with_quality(&[StudyDecoder::Absent, LINEAR], &|_, bits| 20.0 + bits);
    let mut plan = folder.plan().clone();
    plan.plot.scatter = false;
    plan.plot.panels = None;
    let figure = figure_of(&plan, folder.cells(), &states);
    let [information, psnr] = figure.panels.as_slice() else { panic!("{figure:?}") };
    assert_eq!((information.series.len(), information.series[0].points.len()), (1, 3));
    assert_eq!((psnr.title.as_str(), psnr.series[0].name.as_str()), ("PSNR", "linear"));
}

#[test]
fn image_quality_stands_against_information_with_its_correlations() {
    let (folder, states) = with_quality(&[LINEAR, VARIATION], &|place, bits| 26.0 + place as f64 + bits);
    let waiting = vec![CellState::Waiting; states.len()];
    let empty = figure_of(folder.plan(), folder.cells(), &waiting);
    assert!(!svg(&empty).unwrap().contains("NaN"));
    let figure = figure_of(folder.plan(), folder.cells(), &states);
    let [panel] = figure.panels.as_slice() else { panic!("{figure:?}") };
    assert_eq!((panel.quantity, panel.title.as_str()), (Quantity::Psnr, "beads:0.02"));
    let names: Vec<&str> = panel.series.iter().map(|series| series.name.as_str()).collect();
    assert_eq!(names, ["linear", "tv", "published U-net"]);
    for (index, point) in panel.series[0].points.iter().enumerate() {
        let record = states[index].done().unwrap();
        let quality = record.reconstruction.as_ref().unwrap();
        assert_eq!((point.value, point.interval_95), (quality.psnr_db, quality.psnr_db_interval_95));
        assert_eq!(Some(point.x), record.lower());
        assert!(point.x_interval_95[0] <= point.x && point.x <= point.x_interval_95[1], "{point:?}");
    }
    let published: Vec<f64> = panel.series[2].points.iter().map(|point| point.value).collect();
    assert_eq!(published, [27.18, 27.67, 27.47]);
    let drawn = svg(&figure).unwrap();
    for part in ["information, bits per pixel", "PSNR, dB", "beads:0.02", "published U-net", "\n6\n"] {
        assert!(drawn.contains(part) && !drawn.contains("NaN"), "{part}");
    }
    let table = StudyTable::new(&folder, &states);
    let text = table.markdown();
    for part in [
        "published PSNR, dB",
        "| 27.67 |",
        "Spearman",
        "| beads:0.02 | tv | 3 |",
        "| beads:0.02 | published U-net | 3 |",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    let column = |name: &str| CSV_HEADER.iter().position(|known| *known == name).unwrap();
    let rows = table.csv_rows();
    assert_eq!(
        (rows[4][column("decoder")].as_str(), rows[4][column("published_psnr_db")].as_str()),
        ("Total variation", "27.67")
    );
    let found = table.correlations();
    assert!(found.iter().all(|of| of.csv_row().len() == CORRELATION_HEADER.len()) && found.len() == 3);
}

/// PSNR of one decoder rises with information, that of the other falls.
#[test]
fn correlations_are_those_of_the_cells() {
    let signed = |place: usize, bits: f64| if place == 0 { 20.0 + bits } else { 20.0 - bits };
    let (folder, mut states) = with_quality(&[LINEAR, VARIATION], &signed);
    let found = correlations(folder.plan(), folder.cells(), &states);
    let [rising, falling, published] = found.as_slice() else { panic!("{found:?}") };
    assert_eq!((rising.decoder.as_str(), rising.masks, rising.spearman), ("linear", 3, Some(1.0)));
    assert_eq!((falling.decoder.as_str(), falling.spearman), ("tv", Some(-1.0)));
    assert!((rising.pearson.unwrap() - 1.0).abs() < 1e-9 && (falling.pearson.unwrap() + 1.0).abs() < 1e-9);
    // Published PSNR 27.18, 27.67, 27.47 against published information 0.267, 0.5801, 0.6175.
    assert_eq!((published.decoder.as_str(), published.spearman_published), ("published U-net", Some(0.5)));
    // Two masks are no correlation.
    states[0] = CellState::Waiting;
    states[3] = CellState::Waiting;
    assert_eq!(correlations(folder.plan(), folder.cells(), &states), Vec::<Correlation>::new());
}

#[test]
fn a_first_look_keeps_all_decoders() {
    let named = NamedPlan::find("decoders").unwrap();
    assert_eq!(named.cell_count().unwrap(), 9 * (4 + 3 * 3));
    let quick = named.plan.quick();
    assert_eq!((&quick.axes.decoder, &quick.axes.objects), (&named.plan.axes.decoder, &named.plan.axes.objects));
    assert_eq!(quick.axes.mask.len(), 5);
    let mut quick = quick;
    quick.axes.objects.truncate(1);
    let training = |cell: &CellSettings| cell.reconstruction.and_then(|settings| settings.training_seconds);
    let longest = quick.cells().unwrap().iter().filter_map(training).fold(0.0, f64::max);
    assert_eq!(longest, quick.quick.seconds);
    let times: Duration = times_of(&quick.cells().unwrap()).iter().sum();
    assert!(times < Duration::from_mins(5), "{times:?}");
}
