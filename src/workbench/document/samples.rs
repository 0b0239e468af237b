//! Sample designs of the program.

use crate::forward::Design;

/// A sample design.
pub struct Sample {
    /// Name of the sample.
    pub name: &'static str,
    /// Description of the sample.
    pub about: &'static str,
    /// Its file.
    json: &'static str,
}

/// All samples.
pub const SAMPLES: [Sample; 3] = [
    Sample {
        name: "Nine lenslets",
        about: "The published layout imaging beads: the design to edit by hand",
        json: include_str!("../../../assets/samples/nine-lenslets.json"),
    },
    Sample {
        name: "Designed mask",
        about: "Five lenslets that the optimizer made of 25 random ones",
        json: include_str!("../../../assets/samples/designed.json"),
    },
    Sample {
        name: "Diffuser",
        about: "Caustics of a smooth random surface behind an aperture of 16 px",
        json: include_str!("../../../assets/samples/diffuser.json"),
    },
];

impl Sample {
    /// The design; none where the program was built with a broken file.
    pub fn design(&self) -> Option<Design> {
        Design::from_value(serde_json::from_str(self.json).ok()?, self.name).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_samples_can_be_opened() {
        let designs = SAMPLES.map(|sample| sample.design().unwrap());
        assert_eq!(designs[0], Design::default());
        assert_eq!(designs[1].encoder.lenslets().unwrap().lenslets.len(), 5);
        assert!(designs[2].encoder.lenslets().is_none());
    }
}
