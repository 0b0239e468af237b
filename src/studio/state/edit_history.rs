//! The information after each edit.

use crate::evaluation::LiveInformation;
use crate::forward::Design;
use crate::workbench::Curve;

/// Information after each edit.
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
    /// Object-entropy bound.
    pub entropy_bound: Option<f64>,
    /// Newest live estimate.
    pub live: Option<f64>,
    /// Number of the scene; points of different scenes are not comparable.
    pub setting: usize,
}

impl EditHistory {
    const KEPT: usize = 400;

    /// Adds the information of a newer revision of `design`. `objects` is the fingerprint of its object set.
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
            entropy_bound: information.ceiling_bits(),
            live: None,
            setting: last.map_or(0, |last| last.setting + changed),
        });
    }

    /// Sets the live estimate of a revision.
    pub fn note_live(&mut self, revision: u64, bits_per_pixel: f64) {
        if let Some(point) = self.points.iter_mut().rev().find(|point| point.revision == revision) {
            point.live = Some(bits_per_pixel);
        }
    }

    /// Segments of comparable points.
    pub fn comparable_segments(&self) -> impl Iterator<Item = &[EditPoint]> {
        self.points.chunk_by(|one, next| one.setting == next.setting)
    }

    /// The history as a table.
    pub fn curve(&self) -> Curve {
        Curve {
            names: Vec::new(),
            header: [
                "revision",
                "setting",
                "gaussian_bound_bits_per_pixel",
                "gaussian_is_bound",
                "entropy_bound_bits_per_pixel",
                "live_estimate_bits_per_pixel",
            ]
            .map(String::from)
            .to_vec(),
            rows: self
                .points
                .iter()
                .map(|point| {
                    let cell = |bits: Option<f64>| bits.unwrap_or(f64::NAN);
                    let (revision, setting) = (point.revision as f64, point.setting as f64);
                    let is_bound = f64::from(u8::from(point.gaussian_is_bound));
                    vec![revision, setting, point.gaussian, is_bound, cell(point.entropy_bound), cell(point.live)]
                })
                .collect(),
        }
    }
}
