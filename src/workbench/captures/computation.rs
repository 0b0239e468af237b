//! Computation of captures, channel by channel.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use ndarray::{Array2, Array3, Axis};

use crate::plural::counted;
use crate::progress::CancelToken;
use crate::reconstruction::{
    Capture, CaptureChannel, CaptureError, ImagingModel, ReconstructionError, ReconstructionStep, residual_in_noise,
};
use crate::workbench::background::activity::ActivityHandle;
use crate::workbench::background::mailbox::Mailbox;
use crate::workbench::captures::queue::{CaptureEnd, CaptureOrder, CaptureQuality, CaptureQueue, CaptureState};
use crate::workbench::reconstructions::queue::SeenRegion;

/// Flags of the command line, and the fields of the window that stand for them.
const FIELDS: [(&str, &str); 2] = [("--dark", "\"Dark level\""), ("--bin", "\"Average squares\"")];

/// Reason why a capture has no reconstruction.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error(transparent)]
    Reconstruction(#[from] ReconstructionError),
}

/// Reconstructs a capture.
pub(crate) fn run(
    (order, entry): &(CaptureOrder, ActivityHandle),
    cancel: &CancelToken,
    mailbox: &Mailbox<CaptureQueue>,
) -> CaptureEnd {
    let began = Instant::now();
    match reconstruct(order, entry, cancel, mailbox) {
        Ok(quality) => CaptureEnd::Done { seconds: began.elapsed().as_secs_f64(), quality },
        Err(Refusal::Reconstruction(ReconstructionError::Cancelled)) => CaptureEnd::Stopped,
        Err(refusal) => CaptureEnd::Failed(with_field_names(&refusal.to_string())),
    }
}

/// A sentence with the fields of the window in place of the flags of the command line.
fn with_field_names(sentence: &str) -> String {
    FIELDS.iter().fold(sentence.to_owned(), |sentence, (flag, field)| sentence.replace(flag, field))
}

/// Reconstructs a capture.
fn reconstruct(
    order: &CaptureOrder,
    entry: &ActivityHandle,
    cancel: &CancelToken,
    mailbox: &Mailbox<CaptureQueue>,
) -> Result<CaptureQuality, Refusal> {
    entry.report("Reading the files", None, None);
    let Capture { channels, notices } = order.files.open()?;
    let mut notices: Vec<String> = notices.iter().map(|notice| with_field_names(notice)).collect();
    if cancel.is_cancelled() {
        return Err(ReconstructionError::Cancelled.into());
    }
    let frames = channels.first().map_or(0, |channel| channel.measurements.len_of(Axis(0)));
    if frames > 1 {
        notices.push(format!("The first of {} is reconstructed", counted(frames, "image")));
    }
    let measured: Vec<Array2<f32>> =
        channels.iter().map(|channel| channel.grey_values(channel.measurements.index_axis(Axis(0), 0))).collect();
    let measured = Arc::new(with_channels(measured.iter()));
    mailbox.publish(|queue| queue.publish_measurement(measured, notices));
    let decoder = order.decoder.decoder(None, None)?;
    let mut objects: Vec<Array2<f32>> = Vec::new();
    let mut quality = CaptureQuality::default();
    for (index, channel) in channels.iter().enumerate() {
        let CaptureChannel { measurements, psf, noise, .. } = channel;
        let measurement = measurements.index_axis(Axis(0), 0);
        let model = ImagingModel::of_capture(psf.view(), measurement.dim(), *noise)?;
        let seen = SeenRegion { corner: model.sensor_corner(), shape: model.measurement_shape() };
        let prepared = decoder.prepare(&model, cancel)?;
        let publish = |object: &Array2<f32>, state: CaptureState| {
            let object = Arc::new(so_far(&objects, object, channels.len()));
            mailbox.publish(|queue| queue.publish_object(object, seen, state));
        };
        let at = |done, most| CaptureState::Reconstructing { channel: index + 1, channels: channels.len(), done, most };
        let mut on_progress = |step: &ReconstructionStep| -> ControlFlow<()> {
            if let ReconstructionStep::Iteration { done, most, .. } = step {
                quality.iterations = quality.iterations.max(Some((*done, *most)));
            }
            if let ReconstructionStep::Iteration { done, most, object: Some(object) } = step
                && !cancel.is_cancelled()
            {
                let share = (index as f64 + *done as f64 / (*most).max(1) as f64) / channels.len() as f64;
                entry.report(&format!("Channel {} of {}", index + 1, channels.len()), Some(share), None);
                publish(&channel.grey_values(object.view()), at(*done, *most));
            }
            cancel.check()
        };
        let first = measurement.insert_axis(Axis(0));
        let photons = prepared.reconstruct(first, &mut on_progress)?;
        quality.residual = quality.residual.max(residual_in_noise(&model, photons.view(), first)?);
        let object = channel.grey_values(photons.index_axis(Axis(0), 0));
        publish(&object, at(1, 1));
        objects.push(object);
    }
    Ok(quality)
}

/// Complete channels, and `newest` for the others: the image is grey before it has its colours.
fn so_far(complete: &[Array2<f32>], newest: &Array2<f32>, channels: usize) -> Array3<f32> {
    with_channels((0..channels).map(|index| complete.get(index).unwrap_or(newest)))
}

/// Images of one shape as channels, shape (rows, cols, channels).
fn with_channels<'a>(images: impl ExactSizeIterator<Item = &'a Array2<f32>> + Clone) -> Array3<f32> {
    let (rows, cols) = images.clone().next().map_or((0, 0), Array2::dim);
    let mut all = Array3::zeros((rows, cols, images.len()));
    for (mut channel, image) in all.axis_iter_mut(Axis(2)).zip(images) {
        channel.assign(image);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_name_fields_and_no_flags() {
        for (sentence, expected) in [
            ("found none; check --dark", "found none; check \"Dark level\""),
            ("dark level of 3; --dark sets another", "dark level of 3; \"Dark level\" sets another"),
            ("found 1 x 1 px; change --bin", "found 1 x 1 px; change \"Average squares\""),
        ] {
            assert_eq!(with_field_names(sentence), expected);
        }
    }
}
