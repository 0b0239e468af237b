//! Calibrations of simulated sensors, compared with their known truth.

use std::path::Path;

use ndarray::{Array3, ArrayView2, s};

use super::simulated::SimulatedSensor;
use super::{CalibratedCamera, CameraCalibration, CameraError, ColourChannel, ColourChoice, FrameSeries, calibrate};
use crate::formats::{write_array, write_png16, write_tiff};
use crate::progress::CancelToken;

fn calibrated(path: &Path) -> Result<CalibratedCamera, CameraError> {
    calibrate(&FrameSeries::open(path)?, ColourChoice::default(), &mut CancelToken::new())
}

fn has_note(found: &CameraCalibration, part: &str) -> bool {
    found.notes.iter().any(|note| note.contains(part))
}

#[test]
fn gain_and_dark_noise_of_known_sensors_are_found() {
    for (gain, bits, dark_noise, full_well) in [
        (0.05, 10, 30.0, 1e9),
        (0.05, 8, 30.0, 1e9),
        (0.05, 12, 15.0, 60_000.0),
        (0.5, 12, 1.8, 1e9),
        (1.0, 12, 1.0, 1e9),
        (5.0, 16, 10.0, 9_000.0),
        (5.0, 14, 1.0, 1e9),
    ] {
        // Dark frames that are cut off at 0 would have too small a variance.
        let offset = (8.0_f64 * gain * dark_noise + 0.3).max(if bits == 8 { 16.4 } else { 64.3 });
        let sensor = SimulatedSensor {
            shape: (200, 260),
            gain,
            bits,
            dark_noise,
            full_well,
            offset,
            ..SimulatedSensor::default()
        };
        let CalibratedCamera { calibration: found, .. } = sensor.calibrated(20, 4);
        let gain_error = found.system_gain_dn_per_electron / gain - 1.0;
        assert!(gain_error.abs() < 0.005, "gain {gain}, {bits} bits: {:.2} % {:?}", 100.0 * gain_error, found.notes);
        let noise_error = found.temporal_dark_noise_electrons / dark_noise - 1.0;
        assert!(noise_error.abs() < 0.02, "gain {gain}, {bits} bits: noise {:.2} % {found:?}", 100.0 * noise_error);
        let offset_error = found.dark_signal_dn - offset;
        assert!(offset_error.abs() < 0.05 * gain.max(1.0), "gain {gain}: {offset_error}");
        let saturation = found.saturation_electrons / sensor.saturation() - 1.0;
        assert!(saturation.abs() < 0.08, "gain {gain}: saturation {saturation}");
        assert!((found.quantum_efficiency.unwrap() - 0.5).abs() < 0.005, "{:?}", found.quantum_efficiency);
        assert!(found.linearity_error_percent.unwrap() < 0.3, "{:?}", found.linearity_error_percent);
        let expected = 10.0 * found.saturation_electrons.log10();
        assert!((found.snr_max_db - expected).abs() < 1e-9);
        let least = (dark_noise * dark_noise + 1.0 / 12.0 / gain / gain).sqrt() + 0.5;
        let range = 20.0 * (sensor.saturation() / least).log10();
        assert!((found.dynamic_range_db - range).abs() < 0.7, "{} {range}", found.dynamic_range_db);
        assert_eq!(found.light_levels.len(), 20);
    }
}

#[test]
fn nonuniformity_and_pixels_that_stand_out_are_found() {
    let sensor = SimulatedSensor {
        prnu: 0.012,
        dsnu: 4.0,
        hot: vec![(77, 300.0), (5000, 900.0), (5001, 2000.0)],
        dim: vec![(160, 0.3), (9999, 0.0), (20_479, 0.6)],
        ..SimulatedSensor::default()
    };
    let CalibratedCamera { calibration: found, maps } = sensor.calibrated(16, 24);
    assert!((found.prnu_percent.unwrap() - 1.2).abs() < 0.06, "{:?}", found.prnu_percent);
    assert!((found.dsnu_electrons.unwrap() - 4.0).abs() < 0.1, "{:?}", found.dsnu_electrons);
    assert_eq!(found.hot_pixels.places, [[0, 77], [31, 40], [31, 41]]);
    assert_eq!(found.dim_pixels.places, [[1, 0], [62, 79], [127, 159]]);
    assert_eq!((maps.mask[(31, 41)], maps.mask[(1, 0)], maps.mask.sum()), (1.0, 2.0, 9.0));
    assert!((found.temporal_dark_noise_electrons / 5.0 - 1.0).abs() < 0.02, "{found:?}");
    assert!(has_note(&found, "3 hot pixels are left out"));
    let (dark, response) = (maps.dark_signal_dn.unwrap(), maps.response.unwrap());
    assert!((f64::from(dark[(31, 41)]) - 64.3 - 1000.0).abs() < 5.0, "{}", dark[(31, 41)]);
    assert!((response[(1, 0)] - 0.3).abs() < 0.02 && (response.mean().unwrap() - 1.0).abs() < 1e-3);
}

#[test]
fn two_frames_of_each_level_give_no_nonuniformity() {
    let CalibratedCamera { calibration: found, maps } = SimulatedSensor::default().calibrated(12, 2);
    assert_eq!((found.prnu_percent, found.dsnu_electrons), (None, None));
    assert!(has_note(&found, "no PRNU") && has_note(&found, "no DSNU"), "{:?}", found.notes);
    assert!(maps.dark_signal_dn.is_none() && maps.response.is_none());
    assert_eq!((found.hot_pixels.count, found.dim_pixels.count, maps.mask.sum()), (0, 0, 0.0));
}

#[test]
fn sensors_that_round_their_noise_away_are_clamped() {
    let sensor =
        SimulatedSensor { gain: 0.05, bits: 10, dark_noise: 3.0, shape: (200, 260), ..SimulatedSensor::default() };
    let CalibratedCamera { calibration: found, .. } = sensor.calibrated(20, 4);
    let error = found.system_gain_dn_per_electron / 0.05 - 1.0;
    assert!(error.abs() < 0.01, "{:.2} %", 100.0 * error);
    let most = (0.24_f64 - 1.0 / 12.0).sqrt() / found.system_gain_dn_per_electron;
    assert!((found.temporal_dark_noise_electrons - most).abs() < 1e-9 && most > 3.0);
    assert!(has_note(&found, "rounding rules") && has_note(&found, "starts at a fitted variance"));
}

#[test]
fn dark_noise_that_is_cut_off_at_0_is_noted() {
    // With an offset of one standard deviation 18.4 % of a Gaussian are rounded to 0 or cut off there.
    for (offset, is_cut_off) in [(5.0, true), (30.0, false)] {
        let sensor = SimulatedSensor { gain: 1.0, dark_noise: 5.0, dsnu: 0.0, offset, ..SimulatedSensor::default() };
        let CalibratedCamera { calibration: found, .. } = sensor.calibrated(12, 4);
        let note = found.notes.iter().find(|note| note.contains("cuts its noise off"));
        assert_eq!(note.is_some(), is_cut_off, "{:?}", found.notes);
        if let Some(note) = note {
            let percent: f64 = note.split(' ').next().unwrap().parse().unwrap();
            assert!((percent - 18.4).abs() < 1.0, "{note}");
            assert!(found.temporal_dark_noise_electrons < 4.8, "{found:?}");
        }
    }
}

/// Gains of sensors of 4 DN per electron whose dark noise is cut off at 0, and how many of their intervals hold the truth.
fn cut_off_gains(seeds: std::ops::Range<u64>) -> (Vec<f64>, usize) {
    let levels: Vec<f64> = (1..=12).map(|level| f64::from(level) * 100.0 / 12.0).collect();
    let (mut gains, mut held) = (Vec::new(), 0);
    for seed in seeds {
        let sensor = SimulatedSensor {
            shape: (64, 64),
            gain: 4.0,
            dark_noise: 3.0,
            offset: 5.0,
            dsnu: 0.0,
            seed,
            ..SimulatedSensor::default()
        };
        let folder = tempfile::tempdir().unwrap();
        let found = calibrated(&sensor.write(folder.path(), &levels, 2, 1.0)).unwrap().calibration;
        let [low, high] = found.system_gain_dn_per_electron_interval_95;
        held += usize::from((low..=high).contains(&4.0));
        gains.push(found.system_gain_dn_per_electron);
        assert!(has_note(
            &found,
            "light levels without the dark frames; dark signal and dynamic range are upper bounds"
        ));
        assert!(found.dark_signal_dn > 6.0 && found.temporal_dark_noise_electrons < 2.7, "{found:?}");
    }
    (gains, held)
}

#[test]
fn gain_is_right_where_dark_noise_is_cut_off_at_0() {
    let (gains, held) = cut_off_gains(100..140);
    let mean = gains.iter().sum::<f64>() / 40.0;
    assert!(held >= 34 && (mean / 4.0 - 1.0).abs() < 0.01, "{held} of 40 intervals, mean gain {mean}");
}

#[test]
#[ignore = "takes half a minute"]
fn gain_is_right_in_many_sensors_whose_dark_noise_is_cut_off_at_0() {
    let (gains, held) = cut_off_gains(1000..1200);
    let mean = gains.iter().sum::<f64>() / 200.0;
    assert!((184..=198).contains(&held) && (mean / 4.0 - 1.0).abs() < 0.004, "{held} of 200, mean gain {mean}");
}

#[test]
fn gain_is_an_upper_bound_where_light_is_cut_off_too() {
    let sensor = SimulatedSensor { gain: 4.0, dark_noise: 3.0, offset: 5.0, dsnu: 0.0, ..SimulatedSensor::default() };
    let folder = tempfile::tempdir().unwrap();
    let found = calibrated(&sensor.write(folder.path(), &[4.0, 5.0, 6.0], 4, 1.0)).unwrap().calibration;
    assert!(found.system_gain_dn_per_electron > 5.0, "{found:?}");
    assert!(has_note(&found, "the gain is an upper bound"), "{:?}", found.notes);
    // Noise below the first grey value is neither known nor a bound.
    let quiet = SimulatedSensor { dark_noise: 0.05, offset: 0.0, ..sensor };
    let found = calibrated(&quiet.write(folder.path(), &[40.0, 50.0, 60.0], 4, 1.0)).unwrap().calibration;
    assert!(has_note(&found, "temporal dark noise and dynamic range are unknown"), "{:?}", found.notes);
    assert!(!has_note(&found, "rounding rules"), "{:?}", found.notes);
}

/// Sub-folders of numbered frames, written by a function of path and frame.
fn folders(groups: &[(&str, Array3<f32>)], write: impl Fn(&Path, ArrayView2<'_, f32>)) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, frames) in groups {
        std::fs::create_dir(folder.path().join(name)).unwrap();
        for (number, frame) in frames.outer_iter().enumerate() {
            write(&folder.path().join(name).join(number.to_string()), frame);
        }
    }
    folder
}

fn write_npy(path: &Path, frame: ArrayView2<'_, f32>) {
    write_array(&path.with_extension("npy"), frame).unwrap();
}

/// Frames in the dark and of two light levels.
fn three_groups(frames: usize) -> [(&'static str, Array3<f32>); 3] {
    let sensor = SimulatedSensor { shape: (40, 50), ..SimulatedSensor::default() };
    [("dark", 0.0), ("l1", 500.0), ("l2", 3000.0)]
        .map(|(name, level)| (name, sensor.frames(level, frames, level as u64)))
}

#[test]
fn negative_dark_values_that_wrapped_around_zero_are_named() {
    let groups = three_groups(2).map(|(name, frames)| (name, frames.mapv(|value| (value - 64.0).rem_euclid(65536.0))));
    let folder = folders(&groups, write_npy);
    let error = calibrated(folder.path()).unwrap_err().to_string();
    assert!(
        error.contains("negative values wrapped around zero; subtract the dark signal in signed numbers"),
        "{error}"
    );
    assert!(!error.contains("  ") && !error.contains('\n'), "{error}");
}

#[test]
fn a_colour_of_grey_frames_is_refused() {
    let folder = folders(&three_groups(2), write_npy);
    let series = FrameSeries::open(folder.path()).unwrap();
    let with = |channel| {
        let colour = ColourChoice { channel: Some(channel), bayer: None };
        calibrate(&series, colour, &mut CancelToken::new())
    };
    let error = with(ColourChannel::Red).unwrap_err().to_string();
    assert!(error.contains("found grey frames; leave the channel out"), "{error}");
    assert_eq!(with(ColourChannel::R).unwrap().calibration.colour.unwrap(), "the R pixels of raw RGGB mosaics");
    let coloured = folders(&three_groups(2), |path, frame| {
        let colours = ndarray::stack![ndarray::Axis(2), frame, frame.mapv(|value| value + 1.0), frame];
        write_array(&path.with_extension("npy"), colours.view()).unwrap();
    });
    let series = FrameSeries::open(coloured.path()).unwrap();
    let colour = ColourChoice { channel: Some(ColourChannel::Blue), bayer: None };
    let found = calibrate(&series, colour, &mut CancelToken::new()).unwrap().calibration;
    assert_eq!(found.colour.unwrap(), "the blue channel");
    // A channel in the path comes first.
    let named = FrameSeries::open(format!("{}?channel=green", coloured.path().display()).as_ref()).unwrap();
    assert_eq!(calibrate(&named, colour, &mut CancelToken::new()).unwrap().calibration.colour, None);
}

#[test]
fn jpeg_frames_and_copies_of_frames_are_noted() {
    let folder = folders(&three_groups(2), |path, frame| {
        let bytes: Vec<u8> = frame.iter().map(|value| (value / 16.0) as u8).collect();
        let file = std::fs::File::create(path.with_extension("jpg")).unwrap();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(file, 100);
        encoder.encode(&bytes, 50, 40, image::ExtendedColorType::L8).unwrap();
    });
    let found = calibrated(folder.path()).unwrap().calibration;
    assert!(has_note(&found, "6 of 6 files are JPEG, which is not linear"), "{:?}", found.notes);
    let mut groups = three_groups(4);
    let found = calibrated(folders(&groups, write_npy).path()).unwrap().calibration;
    assert!(!has_note(&found, "JPEG") && !has_note(&found, "copies"), "{:?}", found.notes);
    let first = groups[0].1.slice(s![..1, .., ..]).to_owned();
    groups[0].1.assign(&first);
    let found = calibrated(folders(&groups, write_npy).path()).unwrap().calibration;
    let note = "3 frames repeat another one of the same group, first in dark: copies have no temporal noise";
    assert!(has_note(&found, note), "{:?}", found.notes);
    // Saturated frames are equal and no copies.
    let mut groups = three_groups(4).to_vec();
    groups.push(("l3", Array3::from_elem((4, 40, 50), 4095.0)));
    assert!(!has_note(&calibrated(folders(&groups, write_npy).path()).unwrap().calibration, "copies"));
}

#[test]
fn bent_sensors_have_a_linearity_error_and_a_note() {
    let sensor = SimulatedSensor { bend: 0.05, bits: 14, full_well: 20_000.0, ..SimulatedSensor::default() };
    let CalibratedCamera { calibration: found, .. } = sensor.calibrated(20, 4);
    let error = found.linearity_error_percent.unwrap();
    assert!((0.3..2.0).contains(&error), "{error}");
    assert!(has_note(&found, "the photon transfer curve is bent by -"), "{:?}", found.notes);
}

#[test]
fn series_without_saturation_say_so() {
    let sensor = SimulatedSensor::default();
    let folder = tempfile::tempdir().unwrap();
    let levels: Vec<f64> = (1..=10).map(|level| f64::from(level) * 300.0).collect();
    let found = calibrated(&sensor.write(folder.path(), &levels, 4, 1.0)).unwrap().calibration;
    assert!(has_note(&found, "the variance does not turn down"), "{:?}", found.notes);
    assert!(
        (found.saturation_electrons - 3000.0).abs() < 30.0 && found.light_levels.iter().all(|level| level.is_fitted)
    );
}

/// Gain intervals of small sensors hold the truth as often as they say.
fn gain_coverage(sensors: u64, side: usize) -> f64 {
    let folder = tempfile::tempdir().unwrap();
    let covers = |&seed: &u64| {
        let sensor =
            SimulatedSensor { shape: (side, side), seed: 100 + seed, full_well: 4000.0, ..SimulatedSensor::default() };
        let path = sensor.write(folder.path(), &sensor.levels(10), 2, 1.0);
        let found = calibrated(&path).unwrap().calibration;
        let [low, high] = found.system_gain_dn_per_electron_interval_95;
        (low..=high).contains(&0.5)
    };
    (0..sensors).filter(covers).count() as f64 / sensors as f64
}

#[test]
fn gain_intervals_hold_the_truth() {
    let share = gain_coverage(60, 40);
    assert!((0.88..=1.0).contains(&share), "{share}");
}

#[test]
#[ignore = "takes a minute"]
fn gain_intervals_hold_the_truth_in_many_sensors() {
    let share = gain_coverage(500, 64);
    assert!((0.93..=0.97).contains(&share), "{share}");
}

#[test]
fn folders_of_png_and_tiff_are_calibrated_as_the_arrays_are() {
    let sensor = SimulatedSensor { shape: (60, 80), ..SimulatedSensor::default() };
    let folder = tempfile::tempdir().unwrap();
    let levels = sensor.levels(8);
    let expected = calibrated(&sensor.write(folder.path(), &levels, 2, 1.0)).unwrap().calibration;
    for ending in ["png", "tif", "npy"] {
        let folder = tempfile::tempdir().unwrap();
        for (index, electrons) in [0.0].iter().chain(&levels).enumerate() {
            let frames = sensor.frames(*electrons, 2, index as u64);
            for (number, frame) in frames.outer_iter().enumerate() {
                // Two digits sort the folders by their light.
                let name = if index == 0 { "dark 1us".into() } else { format!("level {index:02}") };
                std::fs::create_dir_all(folder.path().join(&name)).unwrap();
                let path = folder.path().join(name).join(format!("frame{number}.{ending}"));
                match ending {
                    "png" => write_png16(&path, frame, 0.0, 65535.0).unwrap(),
                    "tif" => write_tiff(&path, frame.insert_axis(ndarray::Axis(0))).unwrap(),
                    _ => write_array(&path, frame).unwrap(),
                }
            }
        }
        let found = calibrated(folder.path()).unwrap().calibration;
        assert_eq!(found.system_gain_dn_per_electron, expected.system_gain_dn_per_electron, "{ending}");
        assert_eq!((found.quantum_efficiency, found.linearity_error_percent), (None, None));
        assert!(has_note(&found, "no linearity error"));
    }
}

#[test]
fn shifted_bits_are_named_and_change_only_the_unit() {
    let sensor = SimulatedSensor { shape: (60, 80), ..SimulatedSensor::default() };
    let (plain, shifted) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let path = sensor.write(plain.path(), &sensor.levels(8), 2, 1.0);
    let expected = calibrated(&path).unwrap().calibration;
    let mut text = std::fs::read_to_string(&path).unwrap();
    text = text.replace("n 12", "n 16");
    std::fs::write(shifted.path().join("camera.txt"), text).unwrap();
    for (index, electrons) in [0.0].iter().chain(&sensor.levels(8)).enumerate() {
        let name = if index == 0 { "dark.npy".into() } else { format!("light_{:02}.npy", index - 1) };
        let frames = sensor.frames(*electrons, 2, index as u64) * 16.0;
        write_array(&shifted.path().join(name), frames.view()).unwrap();
    }
    let found = calibrated(&shifted.path().join("camera.txt")).unwrap().calibration;
    assert!((found.system_gain_dn_per_electron / expected.system_gain_dn_per_electron / 16.0 - 1.0).abs() < 1e-9);
    let noise = found.temporal_dark_noise_electrons / expected.temporal_dark_noise_electrons;
    assert!((noise - 1.0).abs() < 1e-9 && found.grey_value_step_dn == 16.0);
    assert!(has_note(&found, "16 DN apart"), "{:?}", found.notes);
}

/// Folders and their frames.
type Groups = Vec<(&'static str, Array3<f32>)>;

#[test]
fn what_cannot_be_calibrated_gets_one_sentence() {
    let sensor = SimulatedSensor { shape: (40, 50), ..SimulatedSensor::default() };
    let frames = |electrons: f64| sensor.frames(electrons, 2, electrons as u64);
    let refused = |groups: &[(&str, Array3<f32>)]| {
        let folder = tempfile::tempdir().unwrap();
        for (name, frames) in groups {
            for (number, frame) in frames.outer_iter().enumerate() {
                std::fs::create_dir_all(folder.path().join(name)).unwrap();
                write_array(&folder.path().join(name).join(format!("{number}.npy")), frame).unwrap();
            }
        }
        let error = calibrated(folder.path()).unwrap_err().to_string();
        assert!(!error.contains('\n') && !error.contains("  "), "{error}");
        error
    };
    let (dark, dim, bright) = (frames(0.0), frames(500.0), frames(3000.0));
    let lit = || vec![("dark", dark.clone()), ("l1", dim.clone()), ("l2", bright.clone())];
    let with = |change: &dyn Fn(&mut Groups)| {
        let mut groups = lit();
        change(&mut groups);
        refused(&groups)
    };
    for (error, part) in [
        (
            with(&|groups| groups[1].1 = dim.slice(s![..1, .., ..]).to_owned()),
            "expected 2 or more frames of l1, found 1",
        ),
        (with(&|groups| groups[2].1 = bright.slice(s![.., ..39, ..]).to_owned()), "expected 40 x 50 px"),
        (with(&|groups| groups[0].0 = "l0"), "expected dark frames, found none"),
        (with(&|groups| groups.truncate(1)), "a light level or more, found none"),
        (with(&|groups| groups[0].1 = bright.clone() + 200.0), "expected dark frames below"),
        (
            with(&|groups: &mut Groups| {
                for group in &mut groups[1..] {
                    group.1.fill(4095.0);
                }
            }),
            "the frames are saturated",
        ),
        (
            with(&|groups| groups[1].1.slice_mut(s![1, .., ..]).assign(&bright.slice(s![1, .., ..]))),
            "frames of the same light in l1",
        ),
        (with(&|groups| groups[1].1[(0, 3, 4)] = f32::NAN), "found NaN at row 3, column 4"),
        (refused(&[]), "expected dark frames, found none"),
    ] {
        assert!(error.contains(part), "{part:?} in {error}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = sensor.write(folder.path(), &[500.0, 900.0], 2, 1.0);
    std::fs::remove_file(folder.path().join("light_01.npy")).unwrap();
    let error = calibrated(&path).unwrap_err().to_string();
    assert!(error.contains("light_01.npy: expected a file, found nothing"), "{error}");
    std::fs::create_dir(folder.path().join("mixed")).unwrap();
    for name in ["mixed/dark", "mixed/level"] {
        std::fs::create_dir(folder.path().join(name)).unwrap();
        write_array(&folder.path().join(name).join("1.npy"), dark.index_axis(ndarray::Axis(0), 0)).unwrap();
        write_png16(&folder.path().join(name).join("2.png"), dark.index_axis(ndarray::Axis(0), 1), 0.0, 65535.0)
            .unwrap();
    }
    let error = calibrated(&folder.path().join("mixed")).unwrap_err().to_string();
    assert!(error.contains("expected floats") && error.contains("found 16 bits"), "{error}");
}
