//! The file or folder of a path, with its meaning as stated in the path: `FILE?axis=last&key=psf`.

use std::ffi::OsStr;
use std::fmt::{self, Write};
use std::path::{Path, PathBuf};

use super::FormatError;

/// Options after the question mark, for error sentences.
const CHOICES: &str =
    "axis=first, last or a number, key=NAME, channel=red, green, blue, alpha, luma or a number, or frame=NUMBER";

/// Axis of an array that counts the images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameAxis {
    /// The axis of this number; the first is 1.
    Number(usize),
    /// The last axis.
    Last,
}

impl FrameAxis {
    /// Index of the axis among `count` axes, from 0.
    pub(super) fn index(self, count: usize) -> Option<usize> {
        match self {
            Self::Number(number) => number.checked_sub(1).filter(|&index| index < count),
            Self::Last => count.checked_sub(1),
        }
    }
}

/// One channel of a colour image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Red.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// Opacity.
    Alpha,
    /// The weighted sum of red, green and blue (Rec. ITU-R BT.709).
    Luma,
    /// The channel of this number; the first is 1.
    Number(usize),
}

impl Channel {
    /// Channels with a name.
    const NAMES: [(Self, &'static str); 5] = [
        (Self::Red, "red"),
        (Self::Green, "green"),
        (Self::Blue, "blue"),
        (Self::Alpha, "alpha"),
        (Self::Luma, "luma"),
    ];
}

impl fmt::Display for Channel {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self, Self::NAMES.iter().find(|(channel, _)| channel == self)) {
            (_, Some((_, name))) => formatter.write_str(name),
            (Self::Number(number), None) => write!(formatter, "{number}"),
            _ => Ok(()),
        }
    }
}

/// Interpretation of a file where the file itself does not state it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Meaning {
    /// Axis of an array that counts the images.
    pub axis: Option<FrameAxis>,
    /// Array of an NPZ archive.
    pub key: Option<String>,
    /// Channel of colour images.
    pub channel: Option<Channel>,
    /// The only image that is read, numbered from 1.
    pub frame: Option<usize>,
    /// Channel that stands in for the luma of colours where none is chosen.
    pub(super) of_colours: Option<Channel>,
}

impl Meaning {
    /// Reads options such as `axis=last` and `key=psf`. The error is the option that is not understood.
    ///
    /// # Errors
    /// The first option of an unknown name or value, as text.
    pub fn of(options: &[PathOption]) -> Result<Self, String> {
        let mut meaning = Self::default();
        for option in options {
            let wrong = || option.to_string();
            let value = option.value.as_str();
            let number = || value.parse::<usize>().ok().filter(|&number| number > 0);
            match option.name.as_str() {
                "axis" => {
                    let axis = match value {
                        "first" => Some(FrameAxis::Number(1)),
                        "last" => Some(FrameAxis::Last),
                        _ => number().map(FrameAxis::Number),
                    };
                    meaning.axis = Some(axis.ok_or_else(wrong)?);
                }
                "key" if !value.is_empty() => meaning.key = Some(value.to_owned()),
                "channel" => {
                    let named = Channel::NAMES.iter().find(|(_, name)| *name == value);
                    let channel = named.map(|(channel, _)| *channel).or(number().map(Channel::Number));
                    meaning.channel = Some(channel.ok_or_else(wrong)?);
                }
                "frame" => meaning.frame = Some(number().ok_or_else(wrong)?),
                _ => return Err(wrong()),
            }
        }
        Ok(meaning)
    }

    /// The options that [`Meaning::of`] reads back.
    pub fn options(&self) -> Vec<PathOption> {
        let axis = self.axis.map(|axis| match axis {
            FrameAxis::Number(number) => PathOption::new("axis", number),
            FrameAxis::Last => PathOption::new("axis", "last"),
        });
        let key = self.key.as_ref().map(|key| PathOption::new("key", key));
        let channel = self.channel.map(|channel| PathOption::new("channel", channel));
        let frame = self.frame.map(|frame| PathOption::new("frame", frame));
        [axis, key, channel, frame].into_iter().flatten().collect()
    }
}

/// An option after the `?` of a path, written `name=value`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PathOption {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: String,
}

impl PathOption {
    /// An option of a name and a value.
    pub fn new(name: &str, value: impl fmt::Display) -> Self {
        Self { name: name.to_owned(), value: value.to_string() }
    }

    /// Splits `name=value`, with `%XX` for bytes of the value. The error is the text.
    fn parse(part: &[u8]) -> Result<Self, String> {
        let wrong = || String::from_utf8_lossy(part).into_owned();
        let mut halves = part.splitn(2, |&byte| byte == b'=');
        let (name, value) = (halves.next().unwrap_or_default(), halves.next().ok_or_else(wrong)?);
        let name = String::from_utf8(name.to_vec()).map_err(|_| wrong())?;
        Ok(Self { name, value: String::from_utf8(percent_decoded(value)).map_err(|_| wrong())? })
    }
}

impl fmt::Display for PathOption {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}=", self.name)?;
        for letter in self.value.chars() {
            match letter {
                '%' | '?' | '&' | '@' => write!(formatter, "%{:02X}", u32::from(letter))?,
                letter => formatter.write_char(letter)?,
            }
        }
        Ok(())
    }
}

/// A file or folder and its interpretation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageFile {
    /// The file or folder.
    pub path: PathBuf,
    /// Its interpretation.
    pub meaning: Meaning,
}

impl ImageFile {
    /// Finds the file or folder of a path.
    ///
    /// An existing file of that exact name takes precedence. Otherwise the text after the last `?` is the [`Meaning`]. In
    /// the name, `%3F` stands for a question mark, `%25` for a percent sign, and any `%XX` for a byte.
    ///
    /// # Errors
    /// [`FormatError::NotFound`] where there is no such file. [`FormatError::Malformed`] where the file exists and its
    /// meaning is not understood.
    pub fn find(named: &Path) -> Result<Self, FormatError> {
        Ok(Self::find_with(named, &[])?.0)
    }

    /// As [`ImageFile::find`]. Options of the names `others` are returned as they are, in their order.
    ///
    /// # Errors
    /// As [`ImageFile::find`].
    pub fn find_with(named: &Path, others: &[&str]) -> Result<(Self, Vec<PathOption>), FormatError> {
        let exact = |path: PathBuf| (Self { path, meaning: Meaning::default() }, Vec::new());
        if named.symlink_metadata().is_ok() {
            return Ok(exact(named.to_path_buf()));
        }
        let bytes = named.as_os_str().as_encoded_bytes();
        if let Some(mark) = bytes.iter().rposition(|&byte| byte == b'?') {
            let (place, query) = (&bytes[..mark], &bytes[mark + 1..]);
            let choices = || [&[CHOICES], others].concat().join(", ");
            let parts = query.split(|&byte| byte == b'&').filter(|part| !part.is_empty()).map(PathOption::parse);
            let meaning = parts.collect::<Result<Vec<_>, _>>().and_then(|options| {
                let (others, own): (Vec<_>, Vec<_>) =
                    options.into_iter().partition(|option| others.contains(&option.name.as_str()));
                Ok((Meaning::of(&own)?, others))
            });
            let found = [path_of(place.to_vec()), path_of(percent_decoded(place))].into_iter().flatten();
            return match (found.into_iter().find(|path| path.symlink_metadata().is_ok()), meaning) {
                (Some(path), Ok((meaning, others))) => Ok((Self { path, meaning }, others)),
                (Some(path), Err(part)) => Err(FormatError::malformed(
                    &path,
                    format!("{} after the ?", choices()),
                    format!("{part:?}"),
                    "write & between several and %26 for an & in a name",
                )),
                (None, Ok(_)) => Err(FormatError::NotFound { path: path_of(place.to_vec()).unwrap_or_default() }),
                (None, Err(_)) => Err(FormatError::NotFound { path: named.to_path_buf() }),
            };
        }
        let decoded = path_of(percent_decoded(bytes)).filter(|path| path.symlink_metadata().is_ok());
        decoded.map(exact).ok_or_else(|| FormatError::NotFound { path: named.to_path_buf() })
    }

    /// Refuses options that have no meaning for the file: `axis` unless it is an array, `key` unless it is an archive.
    pub(super) fn check_options(&self, is_array: bool, is_archive: bool) -> Result<(), FormatError> {
        let refuse = |option: &str, found: &str| {
            let expected = format!("a file for which ?{option} has a meaning");
            Err(FormatError::malformed(&self.path, expected, found, "leave it out"))
        };
        match &self.meaning {
            Meaning { axis: Some(_), .. } if !is_array => refuse("axis", "a file that is no array"),
            Meaning { key: Some(_), .. } if !is_archive => refuse("key", "a file that is no archive of arrays"),
            _ => Ok(()),
        }
    }
}

/// A path as text that [`ImageFile::find`] reads back. Its name may hold any bytes.
pub fn path_text(path: &Path) -> String {
    if let Some(text) = path.to_str() {
        return text.to_owned();
    }
    let mut text = String::new();
    for chunk in path.as_os_str().as_encoded_bytes().utf8_chunks() {
        for letter in chunk.valid().chars() {
            match letter {
                '%' | '?' => _ = write!(text, "%{:02X}", u32::from(letter)),
                letter => text.push(letter),
            }
        }
        for byte in chunk.invalid() {
            let _ = write!(text, "%{byte:02X}");
        }
    }
    text
}

/// The kind before the first colon of a text such as `stack:FILE`, and the path after it, which may hold any bytes.
/// `None` without a colon.
pub fn split_kind(text: &OsStr) -> Option<(&str, PathBuf)> {
    let bytes = text.as_encoded_bytes();
    let colon = bytes.iter().position(|&byte| byte == b':')?;
    Some((str::from_utf8(&bytes[..colon]).ok()?, path_of(bytes[colon + 1..].to_vec())?))
}

/// A path without its last `mark` and the text after it, and that text. `None` without the mark.
pub fn split_end(path: &Path, mark: u8) -> Option<(PathBuf, &str)> {
    let bytes = path.as_os_str().as_encoded_bytes();
    let at = bytes.iter().rposition(|&byte| byte == mark)?;
    Some((path_of(bytes[..at].to_vec())?, str::from_utf8(&bytes[at + 1..]).ok()?))
}

/// Bytes with each `%XX` replaced by the byte XX.
fn percent_decoded(bytes: &[u8]) -> Vec<u8> {
    let digit = |byte: Option<&u8>| byte.and_then(|&byte| char::from(byte).to_digit(16));
    let (mut decoded, mut at) = (Vec::with_capacity(bytes.len()), 0);
    while let Some(&byte) = bytes.get(at) {
        if let (b'%', Some(high), Some(low)) = (byte, digit(bytes.get(at + 1)), digit(bytes.get(at + 2))) {
            decoded.push((high * 16 + low) as u8);
            at += 3;
        } else {
            decoded.push(byte);
            at += 1;
        }
    }
    decoded
}

/// The path of these bytes, where the system supports such paths.
#[cfg(unix)]
#[allow(clippy::unnecessary_wraps, reason = "not every system has a path for any bytes")]
fn path_of(bytes: Vec<u8>) -> Option<PathBuf> {
    use std::os::unix::ffi::OsStringExt;
    Some(std::ffi::OsString::from_vec(bytes).into())
}

/// The path of these bytes, where the system supports such paths.
#[cfg(not(unix))]
fn path_of(bytes: Vec<u8>) -> Option<PathBuf> {
    String::from_utf8(bytes).ok().map(PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn meaning(axis: Option<FrameAxis>, key: Option<&str>, channel: Option<Channel>, frame: Option<usize>) -> Meaning {
        Meaning { axis, key: key.map(Into::into), channel, frame, ..Meaning::default() }
    }

    #[test]
    fn options_are_read_and_mistakes_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let find = |query: &str, others: &[&str]| {
            ImageFile::find_with(Path::new(&format!("{}?{query}", file.path().display())), others)
        };
        let green = meaning(Some(FrameAxis::Last), Some("a&b"), Some(Channel::Green), None);
        let numbers = meaning(Some(FrameAxis::Number(3)), None, Some(Channel::Number(2)), Some(7));
        for (query, expected) in [("axis=last&key=a%26b&channel=green", green), ("frame=7&axis=3&channel=2&", numbers)]
        {
            let (found, _) = find(query, &[]).unwrap();
            assert_eq!(found.meaning, expected);
            assert_eq!(Meaning::of(&expected.options()), Ok(expected), "the options are read back");
        }
        for wrong in ["axis=0", "axis=middle", "key=", "channel=pink", "frame=-1", "frame=1.5", "colour=red", "axis"] {
            let error = find(&format!("frame=1&{wrong}"), &["dark"]).unwrap_err().to_string();
            assert!(error.contains(&format!("or frame=NUMBER, dark after the ?, found {wrong:?}")), "{error}");
        }
        let (found, others) = find("dark=a%26b&frame=2&window=auto", &["dark", "window"]).unwrap();
        assert_eq!(found.meaning.frame, Some(2));
        assert_eq!(others, [PathOption::new("dark", "a&b"), PathOption::new("window", "auto")]);
        assert_eq!(others[0].to_string(), "dark=a%26b");
    }

    #[test]
    fn a_file_of_that_very_name_wins() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["a.npy", "b?axis=last", "c%3F.npy", "d?e.npy", "100%.npy"] {
            std::fs::write(path(name), "").unwrap();
        }
        let found = |name: &str| {
            let file = ImageFile::find(&path(name)).unwrap();
            (file.path.strip_prefix(folder.path()).unwrap().to_str().unwrap().to_owned(), file.meaning)
        };
        let last = || meaning(Some(FrameAxis::Last), None, None, None);
        for (name, expected, understood) in [
            ("a.npy", "a.npy", Meaning::default()),
            ("a.npy?axis=last", "a.npy", last()),
            ("b?axis=last", "b?axis=last", Meaning::default()),
            ("b?axis=last?axis=last", "b?axis=last", last()),
            ("c%3F.npy", "c%3F.npy", Meaning::default()),
            ("c%253F.npy?axis=last", "c%3F.npy", last()),
            ("d?e.npy", "d?e.npy", Meaning::default()),
            ("d%3Fe.npy", "d?e.npy", Meaning::default()),
            ("d%3fe.npy?axis=last", "d?e.npy", last()),
            ("100%.npy?axis=last", "100%.npy", last()),
        ] {
            assert_eq!(found(name), (expected.to_owned(), understood), "{name}");
        }
        let error = |name: &str| ImageFile::find(&path(name)).unwrap_err();
        assert!(error("a.npy?axes=1").to_string().contains("found \"axes=1\""), "{}", error("a.npy?axes=1"));
        for (name, missing) in [("z.npy?axis=1", "z.npy"), ("z?y.npy", "z?y.npy"), ("z%20.npy", "z%20.npy")] {
            assert!(matches!(error(name), FormatError::NotFound { path: found } if found == path(missing)), "{name}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_name_that_is_not_text_is_found_by_its_text() {
        use std::os::unix::ffi::OsStrExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(std::ffi::OsStr::from_bytes(b"caf\xe9 50%?.npy"));
        std::fs::write(&path, "").unwrap();
        let text = path_text(&path);
        assert!(text.ends_with("caf%E9 50%25%3F.npy"), "{text}");
        assert_eq!(ImageFile::find(Path::new(&text)).unwrap().path, path);
        assert_eq!(ImageFile::find(Path::new(&format!("{text}?frame=2"))).unwrap().meaning.frame, Some(2));
        assert_eq!(path_text(Path::new("/a/50%?.npy")), "/a/50%?.npy");
    }
}
