//! The header of a NumPy array file (NEP 1, versions 1 to 3).
//!
//! The header is a Python dictionary of three known keys, and this reader accepts only that text. It refuses nested
//! values and texts beyond a fixed length, so no header can exhaust stack or memory.

use std::io::{self, Read};

pub(super) const ADVICE: &str = "write the array again with numpy.save";

/// Longest accepted header text, bytes. NumPy pads its headers to 64 or 128.
const LONGEST_HEADER_BYTES: u64 = 64 * 1024;
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";
/// NumPy's own limit on the number of axes.
const MOST_AXES: usize = 64;

/// Number type of one array element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Element {
    Bool,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F16,
    F32,
    F64,
}

impl Element {
    /// Bytes of one element.
    pub(super) fn width(self) -> usize {
        match self {
            Self::Bool | Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    fn from_descr(kind: &str) -> Option<Self> {
        Some(match kind {
            "b1" => Self::Bool,
            "u1" => Self::U8,
            "i1" => Self::I8,
            "u2" => Self::U16,
            "i2" => Self::I16,
            "u4" => Self::U32,
            "i4" => Self::I32,
            "u8" => Self::U64,
            "i8" => Self::I64,
            "f2" => Self::F16,
            "f4" => Self::F32,
            "f8" => Self::F64,
            _ => return None,
        })
    }

    /// Name of the type, where it is none of [`super::Samples`].
    pub(super) fn for_people(self) -> Option<&'static str> {
        match self {
            Self::U8 | Self::U16 | Self::F32 => None,
            Self::Bool => Some("true or false"),
            Self::I8 => Some("8 bits with sign"),
            Self::I16 => Some("16 bits with sign"),
            Self::U32 => Some("32 bits"),
            Self::I32 => Some("32 bits with sign"),
            Self::U64 => Some("64 bits"),
            Self::I64 => Some("64 bits with sign"),
            Self::F16 => Some("16-bit floats"),
            Self::F64 => Some("64-bit floats"),
        }
    }

    /// Value of one element from its little-endian bytes (eight bytes, the unused ones zero).
    pub(super) fn value(self, bytes: [u8; 8]) -> f64 {
        let [a, b, c, d, ..] = bytes;
        match self {
            Self::Bool => f64::from(u8::from(a != 0)),
            Self::U8 => f64::from(a),
            Self::I8 => f64::from(a.cast_signed()),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U64 => u64::from_le_bytes(bytes) as f64,
            Self::I64 => i64::from_le_bytes(bytes) as f64,
            Self::F16 => half(u16::from_le_bytes([a, b])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(bytes),
        }
    }
}

/// Value of a 16-bit float (IEEE 754 binary16).
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff) / 1024.0);
    let size = match exponent {
        0 => fraction * 2.0_f64.powi(-14),
        0x1f if fraction == 0.0 => f64::INFINITY,
        0x1f => f64::NAN,
        _ => (1.0 + fraction) * 2.0_f64.powi(exponent - 15),
    };
    if bits >> 15 == 0 { size } else { -size }
}

/// Description of an array whose number type (`descr` without its byte order) is not supported, and advice.
fn unread_type(descr: &str) -> (String, &'static str) {
    const NUMBERS: &str = "save an array of numbers";
    let (what, advice) = match descr.as_bytes().first() {
        Some(b'c') => ("complex numbers", "save the light instead, numpy.save(FILE, np.abs(a)**2)"),
        Some(b'f') => ("long doubles", "save it as numpy.save(FILE, a.astype('float32'))"),
        Some(b'O') => ("Python objects", "save one array of numbers, numpy.save(FILE, np.stack(list(a)))"),
        Some(b'U' | b'S' | b'a') => ("text", NUMBERS),
        Some(b'M' | b'm') => ("dates or times", NUMBERS),
        Some(b'V') => ("bytes without a type", "save it as numpy.save(FILE, a.astype('float32'))"),
        _ => ("an unknown number type", ADVICE),
    };
    (format!("{what} ({descr:?})"), advice)
}

/// Content of a header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct NpyHeader {
    pub(super) element: Element,
    pub(super) big_endian: bool,
    pub(super) fortran_order: bool,
    pub(super) shape: Vec<usize>,
    /// Number of elements, the product of `shape`.
    pub(super) count: usize,
    /// Bytes behind the last element.
    pub(super) bytes_behind: u64,
}

/// Product of the axes, where memory can address an array of them. As in `ndarray`, this holds also without its empty
/// axes.
pub(super) fn element_count(shape: &[usize], width: usize) -> Option<usize> {
    let bytes = shape.iter().try_fold(width, |product, &axis| product.checked_mul(axis.max(1)))?;
    isize::try_from(bytes).ok()?;
    Some(shape.iter().product())
}

/// Header of version 1 for little-endian `f32` in C order, padded to a multiple of 64 bytes as by NumPy.
pub(super) fn header_of_f32(shape: &[usize]) -> io::Result<Vec<u8>> {
    let axes = match shape {
        [only] => format!("({only},)"),
        axes => format!("({})", axes.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")),
    };
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {axes}, }}");
    let before = MAGIC.len() + 4;
    let length = (before + text.len() + 1).next_multiple_of(64) - before;
    text.extend(std::iter::repeat_n(' ', length - text.len() - 1));
    text.push('\n');
    let length = u16::try_from(length).map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, "too many axes"))?;
    Ok([MAGIC, &[1, 0], &length.to_le_bytes(), text.as_bytes()].concat())
}

/// Reason why a header is refused.
#[derive(Debug)]
pub(super) struct Mismatch {
    /// Expected content.
    pub(super) expected: String,
    /// Found content.
    pub(super) found: String,
    /// Advice.
    pub(super) advice: &'static str,
}

fn mismatch(expected: impl Into<String>, found: impl Into<String>) -> Mismatch {
    Mismatch { expected: expected.into(), found: found.into(), advice: ADVICE }
}

impl NpyHeader {
    /// Reads a header from the start of an array of `available` bytes, header included. Checks that the stated elements
    /// fit into the rest.
    pub(super) fn read(reader: &mut dyn Read, available: u64) -> Result<Self, Mismatch> {
        let cut = |_| mismatch("a complete NPY header", "the end of the file");
        let mut start = [0; 8];
        reader.read_exact(&mut start).map_err(cut)?;
        if &start[..6] != MAGIC {
            return Err(mismatch("an NPY file", format!("the first bytes {:02x?}", &start[..6])));
        }
        let (length, before) = match start[6] {
            1 => {
                let mut length = [0; 2];
                reader.read_exact(&mut length).map_err(cut)?;
                (u64::from(u16::from_le_bytes(length)), 10)
            }
            2 | 3 => {
                let mut length = [0; 4];
                reader.read_exact(&mut length).map_err(cut)?;
                (u64::from(u32::from_le_bytes(length)), 12)
            }
            version => return Err(mismatch("NPY version 1, 2 or 3", format!("version {version}"))),
        };
        if length > LONGEST_HEADER_BYTES || before + length > available {
            return Err(mismatch("an NPY header within the file", format!("one of {length} bytes")));
        }
        let mut text = vec![0; length as usize];
        reader.read_exact(&mut text).map_err(cut)?;
        let mut header = Self::parse(&text)?;
        let bytes = header.count as u64 * header.element.width() as u64;
        let left = available - before - length;
        if bytes > left {
            return Err(mismatch(format!("{bytes} bytes for shape {:?}", header.shape), format!("{left} bytes")));
        }
        header.bytes_behind = left - bytes;
        Ok(header)
    }

    fn parse(text: &[u8]) -> Result<Self, Mismatch> {
        let mut text = Text { left: text };
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        text.take(b'{')?;
        while !text.skip(b'}') {
            let key = text.string()?;
            text.take(b':')?;
            match key.as_str() {
                "descr" if text.skip(b'[') => {
                    let found = mismatch("an array of plain numbers", "a table of named fields");
                    return Err(Mismatch { advice: "save one field, numpy.save(FILE, a[NAME])", ..found });
                }
                "descr" => descr = Some(text.string()?),
                "fortran_order" => fortran_order = Some(text.boolean()?),
                "shape" => shape = Some(text.shape()?),
                _ => return Err(mismatch("the keys descr, fortran_order and shape", format!("the key {key:?}"))),
            }
            if !text.skip(b',') {
                text.take(b'}')?;
                break;
            }
        }
        let missing = |key: &str| mismatch(format!("the key {key} in the NPY header"), "a header without it");
        let descr = descr.ok_or_else(|| missing("descr"))?;
        let fortran_order = fortran_order.ok_or_else(|| missing("fortran_order"))?;
        let shape = shape.ok_or_else(|| missing("shape"))?;
        let unknown = || {
            let (found, advice) = unread_type(descr.get(1..).unwrap_or_default());
            Mismatch { advice, ..mismatch("integers, floats of 16 to 64 bits or booleans", found) }
        };
        let big_endian = match descr.as_bytes().first() {
            Some(b'<' | b'|') => false,
            Some(b'=') => cfg!(target_endian = "big"),
            Some(b'>') => true,
            _ => return Err(unknown()),
        };
        let element = Element::from_descr(&descr[1..]).ok_or_else(unknown)?;
        let too_large = || mismatch("an array that fits into memory", format!("shape {shape:?}"));
        let count = element_count(&shape, element.width()).ok_or_else(too_large)?;
        Ok(Self { element, big_endian, fortran_order, shape, count, bytes_behind: 0 })
    }

    /// Element of these bytes in the byte order of the file.
    pub(super) fn value(&self, bytes: &[u8]) -> f64 {
        let mut element = [0; 8];
        element[..bytes.len()].copy_from_slice(bytes);
        if self.big_endian {
            element[..bytes.len()].reverse();
        }
        self.element.value(element)
    }
}

/// Unread rest of the header text.
struct Text<'a> {
    left: &'a [u8],
}

impl Text<'_> {
    fn trim(&mut self) {
        self.left = self.left.trim_ascii_start();
    }

    fn found(&self) -> String {
        match self.left {
            [] => "the end of the header".into(),
            left => format!("{:?}", String::from_utf8_lossy(&left[..left.len().min(20)])),
        }
    }

    fn skip(&mut self, byte: u8) -> bool {
        self.trim();
        let is_next = self.left.first() == Some(&byte);
        if is_next {
            self.left = &self.left[1..];
        }
        is_next
    }

    fn take(&mut self, byte: u8) -> Result<(), Mismatch> {
        if self.skip(byte) {
            return Ok(());
        }
        Err(mismatch(format!("{:?} in the NPY header", char::from(byte)), self.found()))
    }

    fn string(&mut self) -> Result<String, Mismatch> {
        self.trim();
        let wanted = |text: &Self| mismatch("quoted text in the NPY header", text.found());
        let quote = *self.left.first().filter(|&&byte| byte == b'\'' || byte == b'"').ok_or_else(|| wanted(self))?;
        let length = self.left[1..].iter().position(|&byte| byte == quote).ok_or_else(|| wanted(self))?;
        let string = String::from_utf8_lossy(&self.left[1..=length]).into_owned();
        self.left = &self.left[length + 2..];
        // All quoted texts of these headers are ASCII. So the first byte can be cut off safely.
        if string.is_ascii() { Ok(string) } else { Err(wanted(self)) }
    }

    fn boolean(&mut self) -> Result<bool, Mismatch> {
        self.trim();
        for (word, value) in [("True", true), ("False", false)] {
            if let Some(left) = self.left.strip_prefix(word.as_bytes()) {
                self.left = left;
                return Ok(value);
            }
        }
        Err(mismatch("True or False in the NPY header", self.found()))
    }

    fn shape(&mut self) -> Result<Vec<usize>, Mismatch> {
        self.take(b'(')?;
        let mut shape = Vec::new();
        while !self.skip(b')') {
            self.trim();
            let digits = self.left.iter().take_while(|byte| byte.is_ascii_digit()).count();
            let axis = std::str::from_utf8(&self.left[..digits]).ok().and_then(|digits| digits.parse().ok());
            let axis = axis.ok_or_else(|| mismatch("the length of an axis in the NPY header", self.found()))?;
            if shape.len() == MOST_AXES {
                return Err(mismatch(format!("at most {MOST_AXES} axes"), "more"));
            }
            shape.push(axis);
            self.left = &self.left[digits..];
            // Python 2 wrote long integers with this suffix.
            self.left = self.left.strip_prefix(b"L").unwrap_or(self.left);
            if !self.skip(b',') {
                self.take(b')')?;
                break;
            }
        }
        Ok(shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numpy_headers_are_understood() {
        let header = NpyHeader::parse(b"{'descr': '>i2', 'fortran_order': True, 'shape': (3, 4), }      \n").unwrap();
        assert_eq!((header.element, header.big_endian, header.fortran_order), (Element::I16, true, true));
        assert_eq!((header.shape, header.count), (vec![3, 4], 12));
        let scalar = NpyHeader::parse(b"{\"shape\":(),\"descr\":\"|b1\",\"fortran_order\":False}").unwrap();
        assert_eq!((scalar.shape, scalar.count), (vec![], 1));
        assert_eq!(NpyHeader::parse(b"{'descr':'<f8','fortran_order':False,'shape':(5L,)}").unwrap().shape, [5]);
    }

    #[test]
    fn written_headers_are_aligned_and_read_back() {
        for shape in [&[][..], &[5], &[7, 9], &[1, 2, 3, 4]] {
            let bytes = header_of_f32(shape).unwrap();
            assert!(bytes.len().is_multiple_of(64) && bytes.ends_with(b"\n"));
            let elements = shape.iter().product::<usize>() * 4;
            let header = NpyHeader::read(&mut bytes.as_slice(), (bytes.len() + elements) as u64).unwrap();
            assert_eq!((header.element, header.big_endian, header.fortran_order), (Element::F32, false, false));
            assert_eq!(header.shape, shape);
        }
        assert!(header_of_f32(&vec![1; 30_000]).is_err());
    }

    #[test]
    fn foreign_or_hostile_headers_are_refused() {
        for (text, expected) in [
            (&b""[..], "'{'"),
            (b"{'descr': '<f4', 'fortran_order': False}", "the key shape"),
            (b"{'descr': '<c8', 'fortran_order': False, 'shape': (1,)}", "booleans"),
            (b"{'descr': '', 'fortran_order': False, 'shape': (1,)}", "booleans"),
            (b"{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,)}", "plain numbers"),
            (b"{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}", "length of an axis"),
            (b"{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 4294967296)}", "fits into memory"),
            (b"{'descr': '<f8', 'fortran_order': False, 'shape': (4611686018427387904,)}", "fits into memory"),
            (b"{'descr': '|u1', 'fortran_order': False, 'shape': (0, 4294967296, 4294967296)}", "fits into memory"),
        ] {
            let found = NpyHeader::parse(text).unwrap_err().expected;
            assert!(found.contains(expected), "{found}");
        }
    }
}
