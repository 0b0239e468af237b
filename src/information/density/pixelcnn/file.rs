//! Reading and writing of network weights as a safetensors file.

use std::collections::HashMap;
use std::fmt::Display;
use std::path::Path;

use super::model::PixelCnn;
use super::scale::DataScale;
use super::shape::PixelCnnShape;
use crate::formats::{read_bytes, write_safely};
use crate::information::error::InformationError;
use crate::nn::{NetworkError, WeightsHeader, read_details, read_weights, write_weights};

/// Header of the file.
const HEADER: WeightsHeader<'_> = WeightsHeader { format: "lenslet-studio/pixelcnn", version: 1 };
/// Largest file to read; that of the published network has 2.5 MB.
const MAX_BYTES: u64 = 1 << 28;

impl PixelCnn {
    /// The weights as bytes of a safetensors file: weights by name, shape and scale in its header.
    ///
    /// # Errors
    /// None for weights of full length; see [`write_weights`].
    pub fn to_bytes(&self) -> Result<Vec<u8>, InformationError> {
        self.to_bytes_with(Vec::new())
    }

    /// As [`PixelCnn::to_bytes`], with further details in the header.
    pub(crate) fn to_bytes_with(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, InformationError> {
        let PixelCnnShape { channels, components, dilations } = &self.shape;
        let dilations: Vec<String> = dilations.iter().map(ToString::to_string).collect();
        let DataScale { mean, deviation, min, max, min_width } = self.scale;
        let own: [(&str, &dyn Display); 8] = [
            ("channels", channels),
            ("components", components),
            ("dilations", &dilations.join(" ")),
            ("mean", &mean),
            ("deviation", &deviation),
            ("min", &min),
            ("max", &max),
            ("min_width", &min_width),
        ];
        let own = own.iter().map(|(name, value)| (*name, value.to_string()));
        let details = details.into_iter().chain(own).collect();
        Ok(write_weights(&self.layout, &self.weights, &HEADER, details)?)
    }

    /// Reads the bytes of [`PixelCnn::to_bytes`].
    ///
    /// # Errors
    /// For bytes of another format, another shape or a newer version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, InformationError> {
        let details = read_details(bytes, &HEADER)?;
        let dilations = text(&details, "dilations")?.split_whitespace().map(str::parse).collect::<Result<_, _>>();
        let dilations = dilations.map_err(|_| wrong("dilations", "whole numbers"))?;
        let shape = PixelCnnShape::new(number(&details, "channels")?, number(&details, "components")?, dilations)?;
        let scale = DataScale {
            mean: number(&details, "mean")?,
            deviation: number(&details, "deviation")?,
            min: number(&details, "min")?,
            max: number(&details, "max")?,
            min_width: number(&details, "min_width")?,
        };
        let all = [scale.mean, scale.deviation, scale.min, scale.max, scale.min_width];
        if !(all.iter().all(|x| x.is_finite())
            && scale.deviation > 0.0
            && scale.min_width > 0.0
            && scale.min < scale.max)
        {
            return Err(wrong("its scale", "finite numbers, widths above 0 and a minimum below the maximum"));
        }
        let (layers, layout) = shape.layers(&scale);
        let weights = read_weights(&layout, bytes)?;
        Ok(Self { shape, layers, layout, scale, weights })
    }

    /// Writes the network to a safetensors file, safely.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), InformationError> {
        let bytes = self.to_bytes()?;
        Ok(write_safely(path, |out| out.write_all(&bytes))?)
    }

    /// As [`PixelCnn::open`], of a network of the published shape.
    ///
    /// # Errors
    /// As there, and for a network of another shape.
    pub(crate) fn open_published(path: &Path) -> Result<Self, InformationError> {
        let (model, published) = (Self::open(path)?, PixelCnnShape::default());
        if model.shape == published {
            return Ok(model);
        }
        let reason = format!("expected {published}, found {}", model.shape);
        Err(InformationError::WeightsFile { path: path.display().to_string(), reason })
    }

    /// Reads a network from a safetensors file of this program.
    ///
    /// # Errors
    /// Where the file cannot be read or holds something else.
    pub fn open(path: &Path) -> Result<Self, InformationError> {
        let failed = |reason: String| InformationError::WeightsFile { path: path.display().to_string(), reason };
        Self::from_bytes(&read_bytes(path, MAX_BYTES)?).map_err(|error| failed(error.to_string()))
    }
}

fn text<'a>(details: &'a HashMap<String, String>, name: &str) -> Result<&'a str, InformationError> {
    details.get(name).map(String::as_str).ok_or_else(|| wrong(name, "a value"))
}

fn number<T: std::str::FromStr>(details: &HashMap<String, String>, name: &str) -> Result<T, InformationError> {
    text(details, name)?.parse().map_err(|_| wrong(name, "a number"))
}

fn wrong(name: &str, expected: &str) -> InformationError {
    let (expected, found) = (format!("a header with {expected} for {name}"), "something else".to_owned());
    NetworkError::Weights { expected, found }.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> PixelCnn {
        let scale = DataScale { mean: 1.0 / 3.0, deviation: 7.5, min: -2.0, max: 90.0, min_width: 1.0 };
        PixelCnn::new(PixelCnnShape::new(8, 4, vec![1, 3]).unwrap(), scale, 5)
    }

    #[test]
    fn a_network_comes_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        let model = model();
        model.save(&path).unwrap();
        let read = PixelCnn::open(&path).unwrap();
        assert_eq!((read.shape, read.scale, read.weights), (model.shape, model.scale, model.weights));
    }

    #[test]
    fn a_network_of_another_shape_is_not_the_published_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        let published = PixelCnn::new(PixelCnnShape::default(), model().scale, 1);
        published.save(&path).unwrap();
        assert_eq!(PixelCnn::open_published(&path).unwrap().weights, published.weights);
        model().save(&path).unwrap();
        let message = PixelCnn::open_published(&path).unwrap_err().to_string();
        assert!(message.contains("weights.safetensors"), "{message}");
        assert!(message.contains("found 8 channels, 4 components, dilations 1, 3"), "{message}");
    }

    #[test]
    fn other_files_are_refused_with_their_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        assert!(PixelCnn::open(&path).unwrap_err().to_string().contains("weights.safetensors"));
        assert!(PixelCnn::open(folder.path()).unwrap_err().to_string().contains("expected a file, found a folder"));
        let message = model().save(folder.path()).unwrap_err().to_string();
        assert_eq!(message.matches(&*folder.path().to_string_lossy()).count(), 1, "{message}");
        std::fs::write(&path, b"not weights at all").unwrap();
        let message = PixelCnn::open(&path).unwrap_err().to_string();
        assert!(message.contains("safetensors file") && message.contains("choose another"), "{message}");
        let bytes = model().to_bytes().unwrap();
        let text = |from: &str, to: &str| {
            assert_eq!(from.len(), to.len());
            let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
            let mut changed = bytes.clone();
            changed[at..at + to.len()].copy_from_slice(to.as_bytes());
            PixelCnn::from_bytes(&changed).unwrap_err().to_string()
        };
        assert!(text("\"channels\":\"8\"", "\"channels\":\"9\"").contains("[3, 1, 9]"));
        assert!(text("\"channels\":\"8\"", "\"channels\":\"0\"").contains("0 channels"));
        assert!(text("\"deviation\":\"7.5\"", "\"deviation\":\"NaN\"").contains("its scale"));
        assert!(text("\"dilations\":\"1 3\"", "\"dilations\":\"1 x\"").contains("whole numbers"));
        assert!(text("format_version\":\"1", "format_version\":\"7").contains("version 7"));
    }
}
