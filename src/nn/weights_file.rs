//! Weights as the bytes of a safetensors file, with a header that names their network.

use std::collections::HashMap;

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors, serialize};

use super::error::NetworkError;
use super::parameters::ParameterLayout;

use crate::plural::counted;

/// Header of a weights file: the program's name for the network, and everything else as text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WeightsHeader<'a> {
    /// Value of `format`, such as "lenslet-studio/pixelcnn".
    pub format: &'a str,
    /// Newest `format_version`, for writing and reading.
    pub version: u32,
}

/// The bytes of a safetensors file of `weights`, with `details` beside format and version.
///
/// # Errors
/// [`NetworkError::Weights`] where the weights are not those of the layout.
pub fn write_weights(
    layout: &ParameterLayout,
    weights: &[f32],
    header: &WeightsHeader<'_>,
    details: Vec<(&str, String)>,
) -> Result<Vec<u8>, NetworkError> {
    if weights.len() != layout.count() {
        return Err(wrong(counted(layout.count(), "weight"), format!("{}", weights.len())));
    }
    let bytes: Vec<u8> = weights.iter().flat_map(|weight| weight.to_le_bytes()).collect();
    let mut tensors = Vec::new();
    for tensor in layout.tensors() {
        let bytes = &bytes[4 * tensor.range.start..4 * tensor.range.end];
        let view = TensorView::new(Dtype::F32, tensor.shape.clone(), bytes)
            .map_err(|error| wrong(format!("tensor {}", tensor.name), error.to_string()))?;
        tensors.push((tensor.name.as_str(), view));
    }
    let mut metadata: HashMap<String, String> =
        details.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    metadata.insert("format".to_owned(), header.format.to_owned());
    metadata.insert("format_version".to_owned(), header.version.to_string());
    serialize(tensors, Some(metadata)).map_err(|error| wrong("weights that fit a file".to_owned(), error.to_string()))
}

/// Checks format and version of the bytes of a safetensors file and returns the other details of its header.
///
/// # Errors
/// [`NetworkError::Weights`] for other files, [`NetworkError::Version`] for newer ones.
pub fn read_details(bytes: &[u8], header: &WeightsHeader<'_>) -> Result<HashMap<String, String>, NetworkError> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|error| not_a_file(&error))?;
    let details = metadata.metadata().clone().unwrap_or_default();
    let format = details.get("format").map_or("no format", String::as_str);
    if format != header.format {
        return Err(wrong(format!("format {:?}", header.format), format!("{format:?}")));
    }
    let version = details.get("format_version").cloned().unwrap_or_default();
    match version.parse::<u32>() {
        Ok(known) if (1..=header.version).contains(&known) => Ok(details),
        _ => Err(NetworkError::Version { found: version, newest: header.version }),
    }
}

/// One entry of the header of a safetensors file of any format.
///
/// # Errors
/// [`NetworkError::Weights`] for bytes of another format, and where the entry is missing.
pub fn read_detail(bytes: &[u8], name: &str) -> Result<String, NetworkError> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|error| not_a_file(&error))?;
    let found = metadata.metadata().as_ref().and_then(|details| details.get(name).cloned());
    found.ok_or_else(|| wrong(format!("an entry {name:?}"), "none that can be read".to_owned()))
}

/// Reads weights of exactly this layout from the bytes of a safetensors file; call [`read_details`] first.
///
/// # Errors
/// [`NetworkError::Weights`] where tensors are missing, too many, of another shape or type, or not finite.
pub fn read_weights(layout: &ParameterLayout, bytes: &[u8]) -> Result<Vec<f32>, NetworkError> {
    let file = SafeTensors::deserialize(bytes).map_err(|error| not_a_file(&error))?;
    if file.len() != layout.tensors().len() {
        return Err(wrong(counted(layout.tensors().len(), "tensor"), format!("{}", file.len())));
    }
    let mut weights = Vec::with_capacity(layout.count());
    for tensor in layout.tensors() {
        let (name, shape) = (&tensor.name, &tensor.shape);
        let found = file.tensor(name).map_err(|error| wrong(format!("a tensor {name}"), error.to_string()))?;
        if found.dtype() != Dtype::F32 || found.shape() != shape {
            let found = format!("{} {:?}", found.dtype(), found.shape());
            return Err(wrong(format!("tensor {name} of F32 {shape:?}"), found));
        }
        // The shape was checked, so there are whole numbers of four bytes.
        weights.extend(found.data().as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)));
    }
    match weights.iter().find(|weight| !weight.is_finite()) {
        Some(found) => Err(wrong("finite weights".to_owned(), found.to_string())),
        None => Ok(weights),
    }
}

fn wrong(expected: String, found: String) -> NetworkError {
    NetworkError::Weights { expected, found }
}

fn not_a_file(error: &safetensors::SafeTensorError) -> NetworkError {
    wrong("a safetensors file".to_owned(), error.to_string())
}

#[cfg(test)]
mod tests {
    use super::super::parameters::Initial;
    use super::*;

    const HEADER: WeightsHeader<'_> = WeightsHeader { format: "test/network", version: 2 };

    fn layout(cols: usize) -> ParameterLayout {
        let mut layout = ParameterLayout::default();
        layout.add("z.kernel", &[3, cols], Initial::LecunNormal { inputs: 3 });
        layout.add("a.bias", &[5], Initial::Zeros);
        layout
    }

    #[test]
    fn weights_file_round_trips() {
        let layout = layout(4);
        let weights = layout.draw(3);
        let details = vec![("mean", "1.5".to_owned())];
        let bytes = write_weights(&layout, &weights, &HEADER, details).unwrap();
        assert_eq!(read_details(&bytes, &HEADER).unwrap()["mean"], "1.5");
        assert_eq!(read_weights(&layout, &bytes).unwrap(), weights);
    }

    #[test]
    fn other_files_are_refused() {
        let ours = layout(4);
        let bytes = write_weights(&ours, &ours.draw(1), &HEADER, Vec::new()).unwrap();
        let message = read_weights(&layout(5), &bytes).unwrap_err().to_string();
        assert!(message.contains("z.kernel of F32 [3, 5]") && message.contains("[3, 4]"), "{message}");
        let mut more = layout(4);
        more.add("c", &[1], Initial::Zeros);
        assert!(read_weights(&more, &bytes).is_err());
        let other = WeightsHeader { format: "test/other", version: 2 };
        assert!(read_details(&bytes, &other).unwrap_err().to_string().contains("test/other"));
        let older = WeightsHeader { version: 1, ..HEADER };
        let message = read_details(&bytes, &older).unwrap_err().to_string();
        assert!(message.contains("version 2") && message.contains("newer Lenslet Studio"), "{message}");
        for cut in [0, 7, 40, bytes.len() - 1] {
            assert!(read_details(&bytes[..cut], &HEADER).is_err(), "{cut}");
        }
        let mut broken = ours.draw(1);
        broken[2] = f32::NAN;
        let bytes = write_weights(&ours, &broken, &HEADER, Vec::new()).unwrap();
        assert!(read_weights(&ours, &bytes).unwrap_err().to_string().contains("NaN"));
        assert!(write_weights(&ours, &broken[1..], &HEADER, Vec::new()).is_err());
    }
}
