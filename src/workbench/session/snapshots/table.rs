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
