//! The numbers of all snapshots as a table.

use crate::design::merged;
use crate::reconstruction::DecoderKind;
use crate::workbench::export::design_files::Curve;
use crate::workbench::session::snapshots::{Bits, Snapshot, Snapshots};

/// Columns of every table.
const HEADER: [&str; 16] = [
    "lenslets",
    "effective_lenslets",
    "live_estimate_bits_per_pixel",
    "live_low_bits_per_pixel",
    "live_high_bits_per_pixel",
    "gaussian_bound_bits_per_pixel",
    "gaussian_is_bound",
    "ceiling_bits_per_pixel",
    "lower_bound_bits_per_pixel",
    "lower_bound_low_bits_per_pixel",
    "lower_bound_high_bits_per_pixel",
    "upper_bound_bits_per_pixel",
    "upper_bound_low_bits_per_pixel",
    "upper_bound_high_bits_per_pixel",
    "sensor_tamura",
    "scene",
];

impl Snapshots {
    /// All numbers as a table; scenes are numbered in the order of the designs. Every decoder of a snapshot has columns of its own.
    pub fn table(&self) -> Curve {
        let scenes = self.scenes();
        let decoders = self.decoders();
        let known = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let three = |bits: Option<Bits>| {
            bits.map_or([f64::NAN; 3], |Bits { bits, interval_95: [low, high] }| [bits, low, high])
        };
        let row = |snapshot: &Snapshot| {
            let array = snapshot.design.encoder.lenslets();
            let mut row = vec![
                known(array.map(|array| array.lenslets.len() as f64)),
                known(array.map(|array| merged(array).effective_count())),
            ];
            row.extend(three(snapshot.numbers.live.map(|live| live.0)));
            row.push(known(snapshot.numbers.gaussian.map(|bound| bound.bits)));
            row.push(f64::from(u8::from(snapshot.gaussian_is_bound())));
            row.push(known(snapshot.numbers.ceiling));
            row.extend(three(snapshot.numbers.lower));
            row.extend(three(snapshot.upper()));
            row.push(known(snapshot.numbers.tamura));
            row.push(
                scenes.iter().position(|known| *known == snapshot.scene).map_or(f64::NAN, |scene| (scene + 1) as f64),
            );
            for &decoder in &decoders {
                let psnr = snapshot.numbers.reconstruction_by(decoder);
                row.extend(psnr.map_or([f64::NAN; 3], |psnr| [psnr.psnr_db, psnr.interval_95[0], psnr.interval_95[1]]));
            }
            row
        };
        let of_decoder = |decoder: &DecoderKind| {
            let name = decoder.name().to_lowercase().replace([' ', '-'], "_");
            ["", "_low", "_high"].map(|end| format!("{name}_psnr{end}_db"))
        };
        Curve {
            names: self.entries.iter().map(|snapshot| snapshot.name.clone()).collect(),
            header: HEADER.into_iter().map(String::from).chain(decoders.iter().flat_map(of_decoder)).collect(),
            rows: self.entries.iter().map(row).collect(),
        }
    }

    /// Decoders that some snapshot has a PSNR of, in the order of the menu.
    pub fn decoders(&self) -> Vec<DecoderKind> {
        let has = |decoder: &DecoderKind| {
            self.entries.iter().any(|snapshot| snapshot.numbers.reconstruction_by(*decoder).is_some())
        };
        DecoderKind::ALL.into_iter().filter(has).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::forward::Design;
    use crate::information::Protocol;
    use crate::reconstruction::DecoderQuality;
    use crate::workbench::estimates::queue::Estimates;
    use crate::workbench::live::published::Live;
    use crate::workbench::reconstructions::queue::{ReconstructionKey, Reconstructions, SetQuality};
    use crate::workbench::session::snapshots::LiveResults;

    fn quality(decoder: DecoderKind, psnr_db: f64, test_objects: usize) -> DecoderQuality {
        let interval = |value: f64| [value - 0.5, value + 0.5];
        DecoderQuality {
            decoder,
            protocol: Protocol::Default,
            psnr_db,
            psnr_db_interval_95: interval(psnr_db),
            ssim: 0.5,
            ssim_interval_95: [0.5; 2],
            mse: 0.01,
            mse_interval_95: [0.01; 2],
            r2: None,
            r2_interval_95: None,
            psnr_constant_db: 15.0,
            psnr_constant_db_interval_95: [15.0; 2],
            psnr_unclipped_db: psnr_db,
            psnr_unclipped_db_interval_95: interval(psnr_db),
            psnr_linear_closed_form_db: None,
            psnr_posterior_db: None,
            test_objects,
            networks: 0,
            peak_photons: 1.0,
            seed: 1,
            seconds: 0.1,
        }
    }

    fn results<'a>(others: &'a (Live, Estimates), reconstructions: &'a Reconstructions) -> LiveResults<'a> {
        LiveResults { live: &others.0, estimates: &others.1, reconstructions }
    }

    #[test]
    fn every_decoder_of_a_snapshot_has_columns_with_its_name() {
        let mut snapshots = Snapshots::default();
        let nothing = (Live::default(), Estimates::default());
        let of = |revision: u64, decoder: DecoderKind, psnr_db: f64, test_objects: usize| {
            let key = ReconstructionKey { revision, sample: 0, noisy: true, decoder, networks: 0 };
            let set = SetQuality { key, quality: quality(decoder, psnr_db, test_objects), planned: 64 };
            Reconstructions { set: Some(Arc::new(set)), ..Reconstructions::default() }
        };
        let design = Arc::new(Design::default());
        assert!(!snapshots.table().header.iter().any(|name| name.contains("psnr")));
        snapshots.keep(&design, 1, results(&nothing, &of(1, DecoderKind::Linear, 21.5, 64))).unwrap();
        snapshots.keep(&design, 2, results(&nothing, &of(1, DecoderKind::Linear, 9.0, 64))).unwrap();
        // Another method, fewer objects of a known one, and another design.
        snapshots.take_up(results(&nothing, &of(1, DecoderKind::TotalVariation, 20.0, 8)));
        snapshots.take_up(results(&nothing, &of(1, DecoderKind::Linear, 7.0, 16)));
        snapshots.take_up(results(&nothing, &of(3, DecoderKind::Linear, 8.0, 64)));
        let table = snapshots.table();
        let value = |row: usize, name: &str| {
            let column = table.header.iter().position(|known| known == name);
            table.rows[row][column.unwrap_or_else(|| panic!("{name} in {:?}", table.header))]
        };
        assert_eq!(
            ["linear_mmse_psnr_db", "linear_mmse_psnr_low_db", "linear_mmse_psnr_high_db"].map(|name| value(0, name)),
            [21.5, 21.0, 22.0]
        );
        assert_eq!(value(0, "total_variation_psnr_db"), 20.0);
        assert!(value(1, "linear_mmse_psnr_db").is_nan(), "it is of another design");
        assert!(table.rows.iter().all(|row| row.len() == table.header.len()));
    }
}
