//! Directories of a TIFF file: names and layout of its pages, which the decoder does not report.

use std::collections::HashSet;
use std::io::{self, Read, Seek, SeekFrom};

/// Largest number of pages read.
const MOST_PAGES: usize = 1 << 20;
/// Longest tag value read, bytes. Colour tables of 16 bits take 393,216.
const LONGEST_VALUE_BYTES: u64 = 1 << 20;
/// Compression by LZW (tag 259).
const LZW: u64 = 5;
/// Bytes that the decoder reads beyond the end of an LZW stream.
///
/// It holds back the codes of up to eight bytes. Where a row of a tile ends between them and no byte follows, it takes
/// the stream for cut short (weezl 0.1.12, `decode.rs`).
const LZW_MARGIN_BYTES: u64 = 8;

/// Photometric interpretations (tag 262).
pub(super) mod photometric {
    pub(in crate::formats) const WHITE_IS_ZERO: u64 = 0;
    pub(in crate::formats) const BLACK_IS_ZERO: u64 = 1;
    pub(in crate::formats) const PALETTE: u64 = 3;
    pub(in crate::formats) const FILTER_ARRAY: u64 = 32_803;
    pub(in crate::formats) const LINEAR_RAW: u64 = 34_892;
}

/// The numbers of a tag: where they lie in the file, and the bytes of one and of all.
#[derive(Clone, Copy, Debug, Default)]
struct Numbers {
    place: u64,
    width: u64,
    bytes: u64,
}

/// One page.
#[derive(Clone, Debug, Default)]
pub(super) struct PageTags {
    /// A reduced copy of another page, such as a preview.
    pub(super) is_reduced: bool,
    pub(super) bits: u64,
    pub(super) compression: u64,
    pub(super) photometric: Option<u64>,
    pub(super) description: String,
    /// Offset of its pixels in the file, bytes.
    pub(super) offset: u64,
    pub(super) orientation: u64,
    pub(super) samples_per_pixel: u64,
    pub(super) sample_format: u64,
    /// Order of the bits of a byte: 2 where the lowest bit is the first.
    pub(super) fill_order: u64,
    /// Layers of a page or tile that is a volume.
    pub(super) layers: u64,
    pub(super) rows: u64,
    /// Rows of a tile; 0 for strips.
    pub(super) tile_rows: u64,
    /// Each channel in a plane of its own.
    pub(super) is_planar: bool,
    /// Red, green and blue of the colour table, one after the other, 16 bits each.
    pub(super) palette: Vec<u16>,
    /// Offset of the lowest byte of the photometric interpretation.
    photometric_byte: Option<u64>,
    /// Offsets of its strips or tiles, and their packed bytes.
    chunk_offsets: Option<Numbers>,
    chunk_bytes: Option<Numbers>,
}

/// The directories of a file.
#[derive(Clone, Debug, Default)]
pub(super) struct Directories {
    pub(super) big_endian: bool,
    pub(super) pages: Vec<PageTags>,
    /// Offsets of directories and of their values.
    places: Vec<u64>,
}

impl Directories {
    /// Reads all undamaged directories. The decoder reports damage.
    pub(super) fn read(reader: &mut (impl Read + Seek)) -> Self {
        let mut directories = Self::default();
        let _ = directories.collect(reader);
        directories
    }

    /// Latest end of pixels that start at `start`: the next known offset of other content.
    pub(super) fn end_of_pixels(&self, start: u64) -> Option<u64> {
        self.places.iter().copied().filter(|&place| place > start).min()
    }

    fn collect(&mut self, reader: &mut (impl Read + Seek)) -> io::Result<()> {
        let mut start = [0; 8];
        reader.seek(SeekFrom::Start(0))?;
        reader.read_exact(&mut start)?;
        self.big_endian = start[0] == b'M';
        let is_big = self.number(&start[2..4]) == 43;
        let mut next = if is_big { self.number_at(reader, 8, 8)? } else { self.number(&start[4..8]) };
        let mut seen = HashSet::new();
        while next != 0 && self.pages.len() < MOST_PAGES && seen.insert(next) {
            self.places.push(next);
            let (count_bytes, entry_bytes, pointer_bytes) = if is_big { (8, 20, 8) } else { (2, 12, 4) };
            let entries = self.number_at(reader, next, count_bytes)?.min(LONGEST_VALUE_BYTES / entry_bytes);
            let first = next.saturating_add(count_bytes);
            let mut page =
                PageTags { bits: 1, compression: 1, orientation: 1, samples_per_pixel: 1, ..PageTags::default() };
            for index in 0..entries {
                self.entry(reader, first.saturating_add(index * entry_bytes), pointer_bytes, &mut page)?;
            }
            self.pages.push(page);
            next = self.number_at(reader, first.saturating_add(entries * entry_bytes), pointer_bytes)?;
        }
        Ok(())
    }

    /// Reads one entry: tag and type of 2 bytes each, then count and value of `pointer` bytes each.
    fn entry(&mut self, reader: &mut (impl Read + Seek), at: u64, pointer: u64, page: &mut PageTags) -> io::Result<()> {
        let tag = self.number_at(reader, at, 2)?;
        let width = match self.number_at(reader, at + 2, 2)? {
            1 | 2 | 6 | 7 => 1,
            3 | 8 => 2,
            4 | 9 | 13 => 4,
            16..=18 => 8,
            _ => return Ok(()),
        };
        let count = self.number_at(reader, at + 4, pointer)?;
        let bytes = count.saturating_mul(width).min(LONGEST_VALUE_BYTES);
        let inline = at + 4 + pointer;
        let place = if bytes <= pointer { inline } else { self.number_at(reader, inline, pointer)? };
        if place != inline {
            self.places.push(place);
        }
        let first = |reader: &mut _| self.number_at(reader, place, width);
        let numbers = Numbers { place, width, bytes };
        match tag {
            254 => page.is_reduced = first(reader)? & 1 == 1,
            257 => page.rows = first(reader)?,
            258 => page.bits = first(reader)?,
            259 => page.compression = first(reader)?,
            262 => {
                page.photometric = Some(first(reader)?);
                page.photometric_byte = Some(if self.big_endian { place + width - 1 } else { place });
            }
            270 => {
                let text = bytes_at(reader, place, bytes)?;
                String::from_utf8_lossy(&text).trim_end_matches('\0').clone_into(&mut page.description);
            }
            266 => page.fill_order = first(reader)?,
            273 | 324 => {
                page.offset = first(reader)?;
                page.chunk_offsets = Some(numbers);
            }
            274 => page.orientation = first(reader)?,
            277 => page.samples_per_pixel = first(reader)?,
            279 | 325 => page.chunk_bytes = Some(numbers),
            284 => page.is_planar = first(reader)? == 2,
            320 => {
                let table = bytes_at(reader, place, bytes)?;
                page.palette = table.chunks_exact(2).map(|pair| self.number(pair) as u16).collect();
            }
            323 => page.tile_rows = first(reader)?,
            339 => page.sample_format = first(reader)?,
            32_997 | 32_998 => page.layers = page.layers.max(first(reader)?),
            _ => {}
        }
        Ok(())
    }

    /// A number in the byte order of the file.
    fn number(&self, bytes: &[u8]) -> u64 {
        let append = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        if self.big_endian { bytes.iter().fold(0, append) } else { bytes.iter().rev().fold(0, append) }
    }

    fn all_numbers(&self, reader: &mut (impl Read + Seek), numbers: Numbers) -> io::Result<Vec<u64>> {
        let bytes = bytes_at(reader, numbers.place, numbers.bytes)?;
        Ok(bytes.chunks_exact(numbers.width as usize).map(|number| self.number(number)).collect())
    }

    fn number_at(&self, reader: &mut (impl Read + Seek), at: u64, width: u64) -> io::Result<u64> {
        Ok(self.number(&bytes_at(reader, at, width)?))
    }
}

fn bytes_at(reader: &mut (impl Read + Seek), at: u64, length: u64) -> io::Result<Vec<u8>> {
    reader.seek(SeekFrom::Start(at))?;
    let mut bytes = vec![0; length as usize];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}

impl PageTags {
    /// Whether the decoder would change or refuse the stored values because of their stated meaning.
    fn is_stored(&self) -> bool {
        use photometric::{FILTER_ARRAY, LINEAR_RAW, PALETTE, WHITE_IS_ZERO};
        let is_grey = self.samples_per_pixel == 1;
        matches!(self.photometric, Some(WHITE_IS_ZERO))
            || is_grey && matches!(self.photometric, Some(PALETTE | FILTER_ARRAY | LINEAR_RAW))
    }

    /// Number of images stated in the description, as ImageJ and tifffile write it. Without pages of their own, they lie
    /// one after the other after the first.
    pub(super) fn described_images(&self, pixels: u64) -> Option<u64> {
        if self.description.starts_with("ImageJ=") {
            return self.imagej("images").and_then(|count| count.parse().ok());
        }
        let shape = serde_json::from_str::<serde_json::Value>(&self.description).ok()?;
        let axes = shape.get("shape")?.as_array()?.iter().map(serde_json::Value::as_u64).collect::<Option<Vec<_>>>()?;
        let all = axes.iter().try_fold(1_u64, |product, &axis| product.checked_mul(axis))?;
        let page = pixels.checked_mul(self.samples_per_pixel)?;
        (page > 0 && all % page == 0).then(|| all / page)
    }

    /// Whether ImageJ wrote the description.
    pub(super) fn is_imagej(&self) -> bool {
        self.description.starts_with("ImageJ=")
    }

    fn imagej(&self, name: &str) -> Option<&str> {
        let mut lines = self.description.lines().filter_map(|line| line.split_once('='));
        lines.find(|(key, _)| *key == name).map(|(_, value)| value.trim())
    }

    /// Offset to add to stored values that ImageJ shows as signed numbers.
    pub(super) fn imagej_shift(&self) -> Option<f32> {
        let number = |name: &str| self.imagej(name).and_then(|text| text.parse::<f64>().ok());
        let is_signed = self.is_imagej() && self.bits == 16 && number("c0") == Some(-32_768.0);
        (is_signed && number("c1").unwrap_or(1.0) == 1.0).then_some(-32_768.0)
    }

    /// Channels, slices and frames that ImageJ counts, where at least two are several.
    pub(super) fn imagej_axes(&self) -> Option<String> {
        let axes = ["channels", "slices", "frames"]
            .into_iter()
            .filter_map(|name| Some((name, self.imagej(name)?.parse::<u64>().ok().filter(|&count| count > 1)?)));
        let axes: Vec<String> = axes.map(|(name, count)| format!("{count} {name}")).collect();
        (axes.len() > 1).then(|| format!("ImageJ counts {}", axes.join(" x ")))
    }
}

/// Name of an unsupported compression (tag 259).
pub(super) fn unread_compression(number: u64) -> Option<String> {
    let name = match number {
        0 | 1 | 4 | LZW | 7 | 8 | 32_773 | 32_946 => return None,
        2 => "CCITT run lengths",
        3 => "CCITT fax group 3",
        6 => "old JPEG",
        9 | 10 | 34_661 => "JBIG",
        32_766 => "NeXT",
        32_767 => "Sony ARW",
        32_771 => "CCITT run lengths, word-aligned",
        32_809 => "ThunderScan",
        33_003..=33_005 | 34_712 => "JPEG 2000",
        34_676 | 34_677 => "SGI LogLuv",
        34_713 => "Nikon NEF",
        34_715 => "JBIG2",
        34_718..=34_720 => "MDI",
        34_887 => "LERC",
        34_892 => "lossy JPEG of DNG",
        34_925 => "LZMA",
        34_926 | 50_000 => "Zstandard",
        34_927 | 50_001 => "WebP",
        34_933 => "PNG",
        22_610 | 34_934 => "JPEG XR",
        48_124 => "Jetraw",
        50_002 | 52_546 => "JPEG XL",
        other => return Some(format!("compression of number {other}")),
    };
    Some(format!("{name} compression"))
}

/// A file whose pages all give their stored values. White-is-zero and colour tables are read as black-is-zero, and LZW
/// streams with the margin that the decoder needs.
pub(super) struct StoredValues<R> {
    inner: R,
    position: u64,
    /// Offsets of the bytes that are read as others, sorted.
    changed: Vec<(u64, u8)>,
    /// Length of the file with the margin of an LZW stream at its end, of zeros.
    end: u64,
}

impl<R: Read + Seek> StoredValues<R> {
    pub(super) fn new(mut inner: R, directories: &Directories) -> io::Result<Self> {
        let length = inner.seek(SeekFrom::End(0))?;
        let (mut changed, mut end) = (Vec::new(), length);
        let black = photometric::BLACK_IS_ZERO as u8;
        for page in directories.pages.iter().filter(|page| page.is_stored()) {
            let Some(place) = page.photometric_byte else { continue };
            // The bytes above the lowest belong to numbers below 256.
            changed.push((place, black));
            // Interpretations above 255 have a second byte.
            if page.photometric.is_some_and(|number| number > 255) {
                changed.push((if directories.big_endian { place.saturating_sub(1) } else { place + 1 }, 0));
            }
        }
        for page in directories.pages.iter().filter(|page| page.compression == LZW) {
            let (Some(offsets), Some(bytes)) = (page.chunk_offsets, page.chunk_bytes) else { continue };
            // The decoder reports damage.
            let Ok(starts) = directories.all_numbers(&mut inner, offsets) else { continue };
            let Ok(counts) = directories.all_numbers(&mut inner, bytes) else { continue };
            for (index, (start, count)) in (0..).zip(starts.into_iter().zip(counts)) {
                let longer = count.saturating_add(LZW_MARGIN_BYTES);
                let is_whole = start.checked_add(count).is_some_and(|stop| stop <= length);
                if !is_whole || (bytes.width < 8 && longer >> (8 * bytes.width) > 0) {
                    continue;
                }
                end = end.max(start + longer);
                let place = bytes.place + index * bytes.width;
                changed.extend((0..bytes.width).map(|byte| {
                    let shift = if directories.big_endian { bytes.width - 1 - byte } else { byte };
                    (place + byte, (longer >> (8 * shift)) as u8)
                }));
            }
        }
        changed.sort_unstable();
        inner.seek(SeekFrom::Start(0))?;
        Ok(Self { inner, position: 0, changed, end })
    }
}

impl<R: Read> Read for StoredValues<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut length = self.inner.read(buffer)?;
        if length == 0 {
            length = self.end.saturating_sub(self.position).min(buffer.len() as u64) as usize;
            buffer[..length].fill(0);
        }
        let (from, to) = (self.position, self.position + length as u64);
        let first = self.changed.partition_point(|&(place, _)| place < from);
        for &(place, byte) in self.changed[first..].iter().take_while(|&&(place, _)| place < to) {
            buffer[(place - from) as usize] = byte;
        }
        self.position = to;
        Ok(length)
    }
}

impl<R: Seek> Seek for StoredValues<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        // In the margin the file itself stays at its end.
        let to = match to {
            SeekFrom::Current(by) => SeekFrom::Start(self.position.saturating_add_signed(by)),
            to => to,
        };
        self.position = self.inner.seek(to)?;
        Ok(self.position)
    }
}
