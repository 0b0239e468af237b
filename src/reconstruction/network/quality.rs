//! Image quality over several trained networks.

use crate::information::paired_interval;
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::protocol::DecoderQuality;

impl DecoderQuality {
    /// Mean over networks that were tested on the same objects. Intervals cover test objects and networks: their distances from the mean
    /// are added in quadrature. `None` without networks.
    ///
    /// # Errors
    /// [`ReconstructionError::Information`] where an interval cannot be computed.
    pub fn over_networks(all: &[Self]) -> Result<Option<Self>, ReconstructionError> {
        let Some(first) = all.first() else { return Ok(None) };
        let mut result = first.clone();
        let mean = |value: fn(&Self) -> f64, interval: fn(&Self) -> [f64; 2]| {
            let values: Vec<f64> = all.iter().map(value).collect();
            let count = values.len() as f64;
            let mean = values.iter().sum::<f64>() / count;
            let networks = if all.len() > 1 { paired_interval(&values, first.seed)? } else { [mean; 2] };
            let end = |index: usize| {
                let objects = all.iter().map(|one| interval(one)[index] - value(one)).sum::<f64>() / count;
                objects.hypot(networks[index] - mean)
            };
            Ok::<_, ReconstructionError>((mean, [mean - end(0), mean + end(1)]))
        };
        (result.psnr_db, result.psnr_db_interval_95) = mean(|one| one.psnr_db, |one| one.psnr_db_interval_95)?;
        (result.psnr_unclipped_db, result.psnr_unclipped_db_interval_95) =
            mean(|one| one.psnr_unclipped_db, |one| one.psnr_unclipped_db_interval_95)?;
        (result.ssim, result.ssim_interval_95) = mean(|one| one.ssim, |one| one.ssim_interval_95)?;
        (result.mse, result.mse_interval_95) = mean(|one| one.mse, |one| one.mse_interval_95)?;
        if first.r2.is_some() {
            let (r2, interval) = mean(|one| one.r2.unwrap_or(0.0), |one| one.r2_interval_95.unwrap_or_default())?;
            (result.r2, result.r2_interval_95) = (Some(r2), Some(interval));
        }
        result.networks = all.len();
        result.seconds = all.iter().map(|one| one.seconds).sum();
        Ok(Some(result))
    }
}
