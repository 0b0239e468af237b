//! Reading and writing of decoder weights as a safetensors file.

use super::layers::Decoder;
use crate::information::error::InformationError;
use crate::nn::{NetworkError, WeightsHeader, read_details, read_weights, write_weights};

/// Header of the file.
const HEADER: WeightsHeader<'_> = WeightsHeader { format: "lenslet-studio/bead-decoder", version: 1 };

impl Decoder {
    /// The weights as bytes of a safetensors file: weights by name, and the number of unrolled steps in the header.
    ///
    /// # Errors
    /// None for weights of full length; see [`write_weights`].
    pub fn to_bytes(&self) -> Result<Vec<u8>, InformationError> {
        self.to_bytes_with(Vec::new())
    }

    /// As [`Decoder::to_bytes`], with more entries in the header.
    ///
    /// # Errors
    /// As [`Decoder::to_bytes`].
    pub(crate) fn to_bytes_with(&self, mut details: Vec<(&str, String)>) -> Result<Vec<u8>, InformationError> {
        details.push(("unrolled", self.unrolled().to_string()));
        Ok(write_weights(&self.layout, &self.weights, &HEADER, details)?)
    }

    /// Reads the bytes of [`Decoder::to_bytes`].
    ///
    /// # Errors
    /// For bytes of another format, another shape or a newer version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, InformationError> {
        let details = read_details(bytes, &HEADER)?;
        let unrolled = details.get("unrolled").map_or("nothing", String::as_str);
        let steps = unrolled.parse().map_err(|_| {
            let (expected, found) = ("a number of unrolled steps in the header".to_owned(), unrolled.to_owned());
            NetworkError::Weights { expected, found }
        })?;
        let decoder = Self::new(steps, 0)?;
        let weights = read_weights(&decoder.layout, bytes)?;
        Ok(Self { weights, ..decoder })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decoder_comes_back_bit_for_bit_and_others_are_refused() {
        let decoder = Decoder::new(3, 8).unwrap();
        let bytes = decoder.to_bytes().unwrap();
        let read = Decoder::from_bytes(&bytes).unwrap();
        assert_eq!((read.unrolled(), read.weights()), (3, decoder.weights()));
        assert!(Decoder::from_bytes(b"not weights").unwrap_err().to_string().contains("safetensors"));
        let at = bytes.windows(12).position(|window| window == b"unrolled\":\"3").unwrap();
        let mut changed = bytes.clone();
        changed[at + 11] = b'4';
        assert!(Decoder::from_bytes(&changed).is_err());
        changed[at + 11] = b'x';
        assert!(Decoder::from_bytes(&changed).unwrap_err().to_string().contains("unrolled steps"));
    }
}
