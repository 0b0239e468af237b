use super::*;
use crate::formats::Scratch;

/// A PSF of one bright pixel on a dark level of 10.
fn psf_in(scratch: &Scratch) -> PathBuf {
    scratch.write("psf.npy", &[32, 32], |index| if index == 16 * 32 + 16 { 1010.0 } else { 10.0 })
}

fn files(measurement: PathBuf, psf: PathBuf) -> CaptureFiles {
    CaptureFiles { measurement, psf, dark: None, bin: 1 }
}

fn refusal(files: &CaptureFiles) -> String {
    files.open().unwrap_err().to_string()
}

#[test]
fn the_dark_level_of_the_corners_is_subtracted_from_both() {
    let scratch = Scratch::new();
    let measured = scratch.write("y.npy", &[40, 48], |index| 60.5 + (index % 7) as f32);
    let capture = files(measured, psf_in(&scratch)).open().unwrap();
    let [channel] = &capture.channels[..] else { panic!() };
    let light = channel.measurements.mapv(|value| f64::from(value) * channel.gain);
    assert!((light[(0, 0, 3)] - 53.5).abs() < 1e-3, "{}", light[(0, 0, 3)]);
    assert_eq!(channel.psf[(16, 16)], 1.0);
    assert!(capture.notices.iter().any(|notice| notice.contains("dark level of 10")), "{:?}", capture.notices);
}

#[test]
fn squares_are_averaged_and_saturated_ones_left_out() {
    let scratch = Scratch::new();
    // Rows 0 and 1 are saturated.
    let measured =
        scratch.write("y.npy", &[64, 64], |index| if index < 128 { 255.0 } else { 20.0 + (index % 2) as f32 });
    let files = CaptureFiles { bin: 2, dark: Some(DarkLevel::Constant(10.0)), ..files(measured, psf_in(&scratch)) };
    let capture = files.open().unwrap();
    let channel = &capture.channels[0];
    assert_eq!((channel.measurements.dim(), channel.psf.dim()), ((1, 32, 32), (16, 16)));
    assert!(channel.measurements.slice(s![0, 0, ..]).iter().all(|value| value.is_nan()));
    assert!((f64::from(channel.measurements[(0, 1, 0)]) * channel.gain - 10.5).abs() < 1e-3);
    assert!(capture.notices.iter().any(|notice| notice.contains("3.12 % of the pixels are saturated")));
}

#[test]
fn colours_are_read_channel_by_channel() {
    let scratch = Scratch::new();
    let measured = scratch.write("y.npy", &[40, 40, 3], |index| [50.5, 90.5, 70.5][index % 3]);
    let colours =
        scratch.write("psf.npy", &[32, 32, 3], |index| if index / 3 == 500 { 9.0 + (index % 3) as f32 } else { 0.0 });
    let capture = files(measured.clone(), colours).open().unwrap();
    let light: Vec<f64> = capture.channels.iter().map(|c| f64::from(c.measurements[(0, 5, 5)]) * c.gain).collect();
    assert!(light.iter().zip([50.5, 90.5, 70.5]).all(|(found, expected)| (found - expected).abs() < 1e-3), "{light:?}");
    assert!(refusal(&files(measured, psf_in(&scratch))).contains("found colours beside grey"));
}

#[test]
fn notices_name_the_channel_and_dark_frames_have_the_colours_of_the_capture() {
    let scratch = Scratch::new();
    let measured = scratch.write("y.npy", &[40, 40, 3], |index| 50.5 + (index % 3) as f32);
    let psf =
        scratch.write("psf.npy", &[32, 32, 3], |index| if index / 3 == 500 { 900.0 + (index % 3) as f32 } else { 2.0 });
    let capture = files(measured.clone(), psf.clone()).open().unwrap();
    for name in ["red", "green", "blue"] {
        let part = format!("psf.npy, {name}: dark level of 2 from");
        assert!(capture.notices.iter().any(|notice| notice.contains(&part)), "{part} in {:?}", capture.notices);
    }
    let grey = scratch.write("grey.npy", &[40, 40], |_| 2.0);
    let of_all = CaptureFiles { dark: Some(DarkLevel::File(grey)), ..files(measured.clone(), psf) };
    assert!(
        of_all.open().unwrap().notices.iter().any(|notice| notice.contains("the same dark frame for all channels"))
    );
    let grey = scratch.write("z.npy", &[40, 40], |index| 60.5 + (index % 3) as f32);
    let colours = CaptureFiles { dark: Some(DarkLevel::File(measured)), ..files(grey, psf_in(&scratch)) };
    assert!(refusal(&colours).contains("y.npy: expected a grey dark frame"), "{}", refusal(&colours));
}

#[test]
fn dark_frames_of_another_level_than_the_psf_are_reported() {
    let scratch = Scratch::new();
    let measured = scratch.write("y.npy", &[40, 48], |index| 160.5 + (index % 7) as f32);
    let notices = |level: f32| {
        let dark = scratch.write("dark.npy", &[40, 48], |_| level);
        let files = CaptureFiles { dark: Some(DarkLevel::File(dark)), ..files(measured.clone(), psf_in(&scratch)) };
        files.open().unwrap().notices
    };
    let is_level = |notice: &String| notice.contains("its mean is 64.0 DN, the corners of the PSF have 10.0 DN");
    assert!(notices(64.0).iter().any(is_level), "{:?}", notices(64.0));
    assert!(notices(10.5).iter().all(|notice| !notice.contains("black level")), "{:?}", notices(10.5));
}

#[test]
fn captures_that_cannot_be_used_are_refused() {
    let scratch = Scratch::new();
    let psf = psf_in(&scratch);
    let broken = scratch.write("broken.npy", &[40, 40], |index| if index == 41 { f32::NAN } else { 3.0 });
    assert!(refusal(&files(broken, psf.clone())).contains("found NaN at row 1, column 1"));
    let bright = scratch.write("bright.npy", &[40, 40], |index| if index < 1500 { 255.0 } else { (index % 3) as f32 });
    assert!(refusal(&files(bright, psf.clone())).contains("94 % of the pixels at 255"));
    let wrapped = scratch.write("wrapped.npy", &[40, 40], |index| ((index % 21) as f32 - 2.0).rem_euclid(65_536.0));
    let said = refusal(&files(wrapped.clone(), psf.clone()));
    assert!(said.contains("wrapped.npy: 9.6 % of the values lie above 58981"), "{said}");
    assert!(refusal(&files(psf.clone(), wrapped)).contains("negative values wrapped around zero"));
    let dark = scratch.write("dark.npy", &[40, 40], |index| 5.0 + (index % 2) as f32);
    assert!(refusal(&files(dark.clone(), psf.clone())).contains("above the dark level of 10"));
    let pair = scratch.write("pair.npy", &[2, 40, 40], |_| 3.0);
    assert!(refusal(&files(dark.clone(), pair)).contains("expected one image, found 2"));
    let small = scratch.write("small.npy", &[30, 40], |_| 30.0);
    assert!(refusal(&files(small, psf.clone())).contains("at least the 32 x 32 px of the PSF, found 30 x 40"));
    let pixel = CaptureFiles {
        bin: 32,
        ..files(scratch.write("wide.npy", &[40, 40], |index| 50.0 + (index % 3) as f32), psf.clone())
    };
    assert!(refusal(&pixel).contains("expected 2 to 4096 px a side, found 1 x 1 px; lower --bin"));
    let pixel = scratch.write("pixel.npy", &[1, 1], |_| 50.0);
    let one = scratch.write("one.npy", &[1, 1], |_| 50.0);
    let files_of_one = CaptureFiles { dark: Some(DarkLevel::Constant(1.0)), ..files(pixel, one) };
    assert!(refusal(&files_of_one).contains("found 1 x 1 px; choose a larger image"));
    let frame = scratch.write("frame.npy", &[20, 20], |_| 3.0);
    let files = CaptureFiles { dark: Some(DarkLevel::File(frame)), ..files(dark, psf) };
    assert!(refusal(&files).contains("expected 40 x 40 px, as the capture, found 20 x 20"));
}
