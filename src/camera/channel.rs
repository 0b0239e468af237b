//! Colour channels of captures: one channel of colour images, or planes of a raw Bayer mosaic.

use std::fmt;
use std::str::FromStr;

use ndarray::{Array3, ArrayView3, s};
use serde::{Deserialize, Serialize};

use super::error::CameraError;
use crate::formats::{Channel, ImageFile, ImageSummary, PixelStack};

/// A colour of a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ColourChannel {
    /// Red of colour images, or of a mosaic.
    Red,
    /// Green of colour images, or both greens of a mosaic.
    Green,
    /// Blue of colour images, or of a mosaic.
    Blue,
    /// The red pixels of a raw mosaic.
    R,
    /// The green pixels of the first mosaic row that has green and red.
    G1,
    /// The green pixels of the rows that have green and blue.
    G2,
    /// The blue pixels of a raw mosaic.
    B,
}

impl ColourChannel {
    /// All colours, by their names.
    pub const NAMES: [(Self, &'static str); 7] = [
        (Self::Red, "red"),
        (Self::Green, "green"),
        (Self::Blue, "blue"),
        (Self::R, "r"),
        (Self::G1, "g1"),
        (Self::G2, "g2"),
        (Self::B, "b"),
    ];

    fn is_of_mosaic(self) -> bool {
        matches!(self, Self::R | Self::G1 | Self::G2 | Self::B)
    }
}

impl fmt::Display for ColourChannel {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Self::NAMES.iter().find(|(channel, _)| channel == self);
        formatter.write_str(name.map_or("", |(_, name)| name))
    }
}

impl FromStr for ColourChannel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::NAMES.iter().find(|(_, name)| name.eq_ignore_ascii_case(text));
        found
            .map(|(channel, _)| *channel)
            .ok_or_else(|| format!("channel {text:?}: expected red, green, blue, or r, g1, g2, b of a raw mosaic"))
    }
}

/// Colours of the top left 2 x 2 pixels of a raw mosaic, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum BayerPattern {
    /// Red, green, green, blue.
    #[default]
    Rggb,
    /// Blue, green, green, red.
    Bggr,
    /// Green, red, blue, green.
    Grbg,
    /// Green, blue, red, green.
    Gbrg,
}

impl BayerPattern {
    /// All patterns, by their names.
    pub const NAMES: [(Self, &'static str); 4] =
        [(Self::Rggb, "RGGB"), (Self::Bggr, "BGGR"), (Self::Grbg, "GRBG"), (Self::Gbrg, "GBRG")];

    /// Row and column of red among the top left 2 x 2 pixels. Blue is diagonal to it.
    fn red(self) -> (usize, usize) {
        match self {
            Self::Rggb => (0, 0),
            Self::Bggr => (1, 1),
            Self::Grbg => (0, 1),
            Self::Gbrg => (1, 0),
        }
    }

    /// Places of the pixels of a channel among the top left 2 x 2 pixels.
    fn places(self, channel: ColourChannel) -> Vec<(usize, usize)> {
        let (row, col) = self.red();
        match channel {
            ColourChannel::Red | ColourChannel::R => vec![(row, col)],
            ColourChannel::Blue | ColourChannel::B => vec![(1 - row, 1 - col)],
            ColourChannel::G1 => vec![(row, 1 - col)],
            ColourChannel::G2 => vec![(1 - row, col)],
            ColourChannel::Green => vec![(row, 1 - col), (1 - row, col)],
        }
    }
}

impl fmt::Display for BayerPattern {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Self::NAMES.iter().find(|(pattern, _)| pattern == self);
        formatter.write_str(name.map_or("", |(_, name)| name))
    }
}

impl FromStr for BayerPattern {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::NAMES.iter().find(|(_, name)| name.eq_ignore_ascii_case(text));
        found
            .map(|(pattern, _)| *pattern)
            .ok_or_else(|| format!("Bayer pattern {text:?}: expected RGGB, BGGR, GRBG or GBRG"))
    }
}

/// The colour that is taken from frames.
///
/// Without a choice, grey frames are taken as they are, and colour images by their green channel. A weighted grey value
/// is never taken: its noise is not that of a photon count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ColourChoice {
    /// The channel.
    pub channel: Option<ColourChannel>,
    /// The pattern of raw mosaics. A channel of a mosaic without a pattern takes RGGB.
    pub bayer: Option<BayerPattern>,
}

/// Frames of one file, in grey values (DN).
#[derive(Clone, Debug)]
pub struct ChosenFrames {
    /// Frames of shape (n, rows, cols). Both greens of a mosaic are two planes, other choices one.
    pub planes: Vec<Array3<f32>>,
    /// Largest count of the number type: 255 or 65535; `None` for floats.
    pub white: Option<u16>,
    /// How the file was interpreted.
    pub summary: ImageSummary,
    /// Name of the colour that was taken; `None` for grey frames.
    pub colour: Option<String>,
}

impl ColourChoice {
    /// Reads a file of frames and takes the chosen colour.
    ///
    /// # Errors
    /// [`CameraError`] for a file that cannot be read, and colour images where a mosaic is needed.
    pub fn read(self, file: &ImageFile) -> Result<ChosenFrames, CameraError> {
        if let Some(pattern) = self.pattern() {
            return Self::read_mosaic(file, pattern, self.channel.unwrap_or(ColourChannel::Green));
        }
        let chosen = match self.channel {
            Some(ColourChannel::Red) => Some((Channel::Red, ColourChannel::Red)),
            Some(ColourChannel::Blue) => Some((Channel::Blue, ColourChannel::Blue)),
            Some(_) => Some((Channel::Green, ColourChannel::Green)),
            None => None,
        };
        // A channel in the path is a choice too.
        let is_named = file.meaning.channel.is_some();
        if let (Some((channel, name)), false) = (chosen, is_named) {
            let (stack, has_colours) = read_channel(file, channel)?;
            let colour = has_colours.then(|| format!("the {name} channel"));
            return Ok(ChosenFrames::of(stack, colour, |array| vec![array]));
        }
        let stack = file.read_of_colours(Channel::Green)?;
        let mut colour = None;
        if stack.from_colour {
            if is_named {
                return Err(CameraError::Colour {
                    path: file.path.clone(),
                    expected: "one colour channel",
                    found: "a weighted grey value",
                    advice: "its noise is not that of a photon count; take ?channel=green",
                });
            }
            colour = Some("the green channel of colour images (--channel takes another)".into());
        }
        Ok(ChosenFrames::of(stack, colour, |array| vec![array]))
    }

    /// The choice for a calibration: of both greens of a mosaic the first is taken, because one plane has one gain.
    pub(super) fn of_one_plane(self) -> Self {
        let is_green = matches!(self.channel, None | Some(ColourChannel::Green));
        if self.bayer.is_some() && is_green { Self { channel: Some(ColourChannel::G1), ..self } } else { self }
    }

    /// Whether a channel of colour images is chosen, and no plane of mosaics.
    pub(super) fn is_of_colour_images(self) -> bool {
        self.channel.is_some() && self.pattern().is_none()
    }

    /// Whether both greens of a mosaic are summed.
    pub fn sums_greens(self) -> bool {
        self.pattern().is_some() && matches!(self.channel, None | Some(ColourChannel::Green))
    }

    /// The Bayer pattern; `None` where frames are no mosaics.
    fn pattern(self) -> Option<BayerPattern> {
        let is_of_mosaic = self.channel.is_some_and(ColourChannel::is_of_mosaic);
        self.bayer.or(is_of_mosaic.then(BayerPattern::default))
    }

    fn read_mosaic(
        file: &ImageFile,
        pattern: BayerPattern,
        channel: ColourChannel,
    ) -> Result<ChosenFrames, CameraError> {
        let stack = file.read()?;
        if stack.from_colour {
            return Err(CameraError::Colour {
                path: file.path.clone(),
                expected: "a raw mosaic of grey pixels",
                found: "colour images",
                advice: "choose --channel red, green or blue and leave --bayer out",
            });
        }
        let places = pattern.places(channel);
        let name = match channel {
            ColourChannel::Green => "both greens, summed,".to_owned(),
            channel => format!("the {} pixels", channel.to_string().to_uppercase()),
        };
        let colour = Some(format!("{name} of raw {pattern} mosaics"));
        let planes = |array: Array3<f32>| places.iter().map(|&place| plane(array.view(), place)).collect();
        Ok(ChosenFrames::of(stack, colour, planes))
    }
}

impl ChosenFrames {
    fn of(stack: PixelStack, colour: Option<String>, planes: impl FnOnce(Array3<f32>) -> Vec<Array3<f32>>) -> Self {
        let (white, summary) = (stack.white, ImageSummary::of(&stack));
        Self { planes: planes(stack.into_array()), white, summary, colour }
    }
}

/// A channel of a file, and whether the file has colours. Grey frames are read as they are.
fn read_channel(file: &ImageFile, channel: Channel) -> Result<(PixelStack, bool), CameraError> {
    let plain = file.read_of_colours(channel);
    if plain.as_ref().is_ok_and(|stack| stack.from_colour) {
        return Ok((plain?, true));
    }
    // The channel may also be a plane of an array, whose axes have another meaning then.
    let mut named = file.clone();
    named.meaning.channel = Some(channel);
    let read = named.read();
    match (plain, read) {
        (Ok(plain), Ok(read)) => {
            let is_plane = [3, 4].iter().any(|planes| read.pages * planes == plain.pages);
            let is_grey = (read.rows, read.cols) == (plain.rows, plain.cols) && !is_plane;
            Ok(if is_grey { (plain, false) } else { (read, true) })
        }
        (Ok(plain), Err(_)) => Ok((plain, false)),
        (Err(_), read) => Ok((read?, true)),
    }
}

/// The pixels of every second row and column from (row, col) on.
fn plane(mosaic: ArrayView3<'_, f32>, (row, col): (usize, usize)) -> Array3<f32> {
    let (_, rows, cols) = mosaic.dim();
    let (rows, cols) = (rows / 2 * 2, cols / 2 * 2);
    mosaic.slice(s![.., ..rows, ..cols]).slice(s![.., row..;2, col..;2]).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::write_array;

    #[test]
    fn planes_of_a_mosaic_follow_its_pattern() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        // R G1 / G2 B from the second column on, as GRBG begins with a green.
        let mosaic = Array3::from_shape_fn((1, 5, 6), |(_, r, c)| match (r % 2, c % 2) {
            (0, 1) => 10.0,
            (0, 0) => 20.0,
            (1, 1) => 30.0,
            _ => 40.0,
        });
        write_array(&path, mosaic.view()).unwrap();
        let file = ImageFile::find(&path).unwrap();
        let bayer = Some(BayerPattern::Grbg);
        for (channel, value) in [("r", 10.0), ("g1", 20.0), ("g2", 30.0), ("b", 40.0), ("red", 10.0), ("blue", 40.0)] {
            let choice = ColourChoice { channel: Some(channel.parse().unwrap()), bayer };
            let read = choice.read(&file).unwrap();
            assert_eq!(read.planes, [Array3::from_elem((1, 2, 3), value)], "{channel}");
        }
        let greens = ColourChoice { channel: None, bayer }.read(&file).unwrap();
        assert_eq!(greens.planes.iter().map(|plane| plane[(0, 1, 1)]).collect::<Vec<_>>(), [20.0, 30.0]);
        assert_eq!(greens.colour.unwrap(), "both greens, summed, of raw GRBG mosaics");
    }

    #[test]
    fn colour_images_give_one_channel_and_never_a_weighted_grey() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let colours = ndarray::Array4::from_shape_fn((1, 6, 5, 3), |(.., channel)| channel as f32);
        write_array(&path, colours.view()).unwrap();
        let value = |channel: Option<&str>| {
            let choice = ColourChoice { channel: channel.map(|name| name.parse().unwrap()), bayer: None };
            let read = choice.read(&ImageFile::find(&path).unwrap()).unwrap();
            (read.planes[0][(0, 3, 3)], read.colour.unwrap())
        };
        assert_eq!((value(Some("red")).0, value(Some("blue")).0), (0.0, 2.0));
        let (green, words) = value(None);
        assert!(green == 1.0 && words.contains("green channel"), "{words}");
        let mosaic = ColourChoice { channel: Some(ColourChannel::G1), bayer: None };
        let error = mosaic.read(&ImageFile::find(&path).unwrap()).unwrap_err().to_string();
        assert!(error.contains("found colour images"), "{error}");
        let named = format!("{}?channel=luma", path.display());
        let error = ColourChoice::default().read(&ImageFile::find(named.as_ref()).unwrap()).unwrap_err().to_string();
        assert!(error.contains("weighted grey"), "{error}");
    }

    #[test]
    fn names_are_read_back() {
        for (channel, name) in ColourChannel::NAMES {
            assert_eq!((channel.to_string().as_str(), name.parse()), (name, Ok(channel)));
        }
        for (pattern, name) in BayerPattern::NAMES {
            assert_eq!((pattern.to_string().as_str(), name.to_lowercase().parse()), (name, Ok(pattern)));
        }
        assert!("luma".parse::<ColourChannel>().unwrap_err().contains("r, g1, g2, b"));
        assert!("RGB".parse::<BayerPattern>().is_err());
    }
}
