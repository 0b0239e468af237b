//! What the information was after each edit.

use crate::forward::Design;
use crate::workbench::{Curve, LiveInformation};

/// Information of past edits.
#[derive(Default)]
pub struct EditHistory {
    /// Oldest first.
    pub points: Vec<EditPoint>,
    /// Scene and sensor of the last point.
    setting: String,
}

/// Information after one edit, bits per pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EditPoint {
    /// Revision of the design.
    pub revision: u64,
    /// Gaussian bound, or approximation.
    pub gaussian: f64,
    /// Whether that is a bound.
    pub gaussian_is_bound: bool,
    /// Object-entropy ceiling.
    pub ceiling: Option<f64>,
    /// Newest live estimate.
    pub live: Option<f64>,
    /// Counts scenes and sensors: points of different ones are not comparable.
    pub setting: usize,
}

impl EditHistory {
    const KEPT: usize = 400;

    /// Notes the information of a revision of `design`, once; of an older revision than the last one never. `objects` is the
    /// fingerprint of what it images.
    pub fn note(&mut self, revision: u64, information: &LiveInformation, design: &Design, objects: &str) {
        let last = self.points.last().copied();
        if last.is_some_and(|last| last.revision >= revision) {
            return;
        }
        if self.points.len() >= Self::KEPT {
            self.points.remove(0);
        }
        let setting = format!(
            "{objects} {} {} {} {} {}",
            design.objects, design.mean_photons, design.bias_photons, design.noise, design.seed
        );
        let changed = usize::from(self.setting != setting);
        self.setting = setting;
        self.points.push(EditPoint {
            revision,
            gaussian: information.gaussian.bits_per_pixel,
            gaussian_is_bound: information.gaussian_is_bound,
            ceiling: information.ceiling_bits(),
            live: None,
            setting: last.map_or(0, |last| last.setting + changed),
        });
    }

    /// Notes the live estimate of a revision that is in the trail.
    pub fn note_live(&mut self, revision: u64, bits_per_pixel: f64) {
        if let Some(point) = self.points.iter_mut().rev().find(|point| point.revision == revision) {
            point.live = Some(bits_per_pixel);
        }
    }

    /// Runs of points that are comparable.
    pub fn runs(&self) -> impl Iterator<Item = &[EditPoint]> {
        self.points.chunk_by(|one, next| one.setting == next.setting)
    }

    /// The trail as columns for a file.
    pub fn curve(&self) -> Curve {
        Curve {
            names: Vec::new(),
            header: [
                "revision",
                "setting",
                "gaussian_bound_bits_per_pixel",
                "gaussian_is_bound",
                "ceiling_bits_per_pixel",
                "live_estimate_bits_per_pixel",
            ]
            .map(String::from)
            .to_vec(),
            rows: self
                .points
                .iter()
                .map(|point| {
                    let known = |bits: Option<f64>| bits.unwrap_or(f64::NAN);
                    let (revision, setting) = (point.revision as f64, point.setting as f64);
                    let is_bound = f64::from(u8::from(point.gaussian_is_bound));
                    vec![revision, setting, point.gaussian, is_bound, known(point.ceiling), known(point.live)]
                })
                .collect(),
        }
    }
}
