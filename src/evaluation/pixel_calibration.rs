//! Conversion of grey values to electrons pixel by pixel: dark signal, response and bad pixels.

use ndarray::{Array2, Array3, ArrayView3, Axis, Zip};

use crate::camera::CalibratedCamera;
use crate::evaluation::calibration::Calibration;
use crate::evaluation::measured_error::MeasuredError;
use crate::formats::FormatError;

/// Smallest response of a pixel that is divided by.
const LEAST_RESPONSE: f32 = 0.05;

/// Calibration of each pixel: `electrons = (DN - dark signal) / (gain x response)`, then sums over bins.
#[derive(Clone, Debug)]
pub(crate) struct PixelCalibration {
    /// Gain, bins and, without a dark map, the offset.
    pub(crate) constants: Calibration,
    /// Dark signal of each pixel, DN.
    pub(crate) dark: Option<Array2<f32>>,
    /// Response of each pixel over the mean.
    pub(crate) response: Option<Array2<f32>>,
    /// Pixels that take the value of a neighbour.
    pub(crate) bad: Option<Array2<bool>>,
}

impl PixelCalibration {
    /// The same calibration for all pixels.
    pub(crate) fn constant(constants: Calibration) -> Self {
        Self { constants, dark: None, response: None, bad: None }
    }

    /// Calibration by a camera.
    pub(crate) fn of_camera(camera: &CalibratedCamera, bin: usize) -> Self {
        let CalibratedCamera { calibration, maps } = camera;
        let constants =
            Calibration { gain: calibration.system_gain_dn_per_electron, offset: calibration.dark_signal_dn, bin };
        let bad = maps.mask.mapv(|kind| kind != 0.0);
        let bad = bad.iter().any(|bad| *bad).then_some(bad);
        Self { constants, dark: maps.dark_signal_dn.clone(), response: maps.response.clone(), bad }
    }

    /// Rows and columns that the maps have; `None` without maps.
    pub(crate) fn shape(&self) -> Option<(usize, usize)> {
        let maps = [&self.dark, &self.response];
        let bad = self.bad.as_ref().map(Array2::dim);
        maps.into_iter().flatten().map(Array2::dim).chain(bad).next()
    }

    /// Sets the response from the mean of flat images, DN.
    ///
    /// # Errors
    /// [`MeasuredError::File`] where the flat images are no brighter than the dark signal.
    pub(crate) fn set_response(&mut self, path: &std::path::Path, mut flat: Array2<f32>) -> Result<(), MeasuredError> {
        match &self.dark {
            Some(dark) => flat -= dark,
            None => flat -= self.constants.offset as f32,
        }
        let mean = flat.iter().map(|&value| f64::from(value)).sum::<f64>() / flat.len().max(1) as f64;
        if mean <= 0.0 {
            let found = format!("a mean of {mean:.2} DN above it");
            let advice = "check which images are flat and which are dark";
            return Err(FormatError::malformed(path, "flat images above the dark signal", found, advice).into());
        }
        self.response = Some(flat.mapv(|value| (f64::from(value) / mean) as f32));
        Ok(())
    }

    /// Electrons of images in grey values, shape (n, rows, cols), without bins.
    pub(crate) fn electrons(&self, grey: ArrayView3<'_, f32>) -> Array3<f32> {
        let Calibration { gain, offset, .. } = self.constants;
        let mut electrons = grey.to_owned();
        for mut image in electrons.axis_iter_mut(Axis(0)) {
            match &self.dark {
                Some(dark) => Zip::from(&mut image).and(dark).for_each(|value, &dark| {
                    *value = ((f64::from(*value) - f64::from(dark)) / gain) as f32;
                }),
                None => image.mapv_inplace(|value| ((f64::from(value) - offset) / gain) as f32),
            }
            if let Some(response) = &self.response {
                image.zip_mut_with(response, |value, &response| *value /= response.max(LEAST_RESPONSE));
            }
            if let Some(bad) = &self.bad {
                let whole = image.to_owned();
                for (place, _) in bad.indexed_iter().filter(|(_, bad)| **bad) {
                    if let Some(near) = nearest_good(bad, place) {
                        image[place] = whole[near];
                    }
                }
            }
        }
        electrons
    }
}

/// The nearest pixel that is not bad, within a few pixels.
fn nearest_good(bad: &Array2<bool>, (row, col): (usize, usize)) -> Option<(usize, usize)> {
    const REACH: usize = 5;
    let (rows, cols) = bad.dim();
    let around = |at: usize, length: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(length);
    let places = around(row, rows).flat_map(|r| around(col, cols).map(move |c| (r, c)));
    let distance = |&(r, c): &(usize, usize)| r.abs_diff(row).pow(2) + c.abs_diff(col).pow(2);
    places.filter(|&place| !bad[place]).min_by_key(distance)
}

/// Where gain and dark signal came from, for advice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Origins {
    /// The gain is that of a camera file.
    pub(crate) has_camera: bool,
    /// The dark signal is that of dark frames.
    pub(crate) has_dark: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn each_pixel_has_its_dark_signal_response_and_neighbour() {
        let calibration = PixelCalibration {
            constants: Calibration { gain: 2.0, offset: 1e9, bin: 1 },
            dark: Some(array![[100.0, 90.0], [80.0, 70.0]]),
            response: Some(array![[1.0, 0.5], [2.0, 1.0]]),
            bad: Some(array![[false, false], [false, true]]),
        };
        let grey = array![[[120.0, 110.0], [120.0, 999.0]]];
        assert_eq!(calibration.electrons(grey.view()), array![[[10.0, 20.0], [10.0, 20.0]]]);
        assert_eq!(calibration.shape(), Some((2, 2)));
    }

    #[test]
    fn flat_images_give_the_response() {
        let mut calibration = PixelCalibration::constant(Calibration { gain: 1.0, offset: 10.0, bin: 1 });
        calibration.set_response("flat".as_ref(), array![[20.0, 40.0]]).unwrap();
        assert_eq!(calibration.response, Some(array![[0.5, 1.5]]));
        let error = calibration.set_response("flat".as_ref(), array![[5.0, 6.0]]).unwrap_err().to_string();
        assert!(error.contains("flat: expected flat images above the dark signal"), "{error}");
    }
}
