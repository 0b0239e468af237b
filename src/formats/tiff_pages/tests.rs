use std::path::PathBuf;

use tempfile::TempDir;
use tiff::encoder::{TiffEncoder, colortype};

use super::*;
use crate::formats::{ImageSummary, read_stack};

const BYTE: u16 = 1;
const ASCII: u16 = 2;
const SHORT: u16 = 3;
const LONG: u16 = 4;

/// A handmade classic TIFF file of one page: entries of tag, type and values, then the pixels.
struct Handmade {
    big_endian: bool,
    entries: Vec<(u16, u16, Vec<u32>)>,
    pixels: Vec<u8>,
}

impl Handmade {
    /// A grey page of this size, uncompressed in one strip.
    fn grey(cols: u32, rows: u32, bits: u32, pixels: Vec<u8>) -> Self {
        let entries = vec![
            (256, SHORT, vec![cols]),
            (257, SHORT, vec![rows]),
            (258, SHORT, vec![bits]),
            (259, SHORT, vec![1]),
            (262, SHORT, vec![1]),
            (273, LONG, vec![8]),
            (277, SHORT, vec![1]),
            (278, SHORT, vec![rows]),
            (279, LONG, vec![pixels.len() as u32]),
        ];
        Self { big_endian: false, entries, pixels }
    }

    fn with(mut self, tag: u16, kind: u16, values: &[u32]) -> Self {
        self.entries.retain(|(other, ..)| *other != tag);
        self.entries.push((tag, kind, values.to_vec()));
        self.entries.sort_by_key(|(tag, ..)| *tag);
        self
    }

    fn described(self, text: &str) -> Self {
        let letters: Vec<u32> = text.bytes().chain([0]).map(u32::from).collect();
        self.with(270, ASCII, &letters)
    }

    fn number(&self, value: u32, width: usize) -> Vec<u8> {
        let bytes = value.to_be_bytes()[4 - width..].to_vec();
        if self.big_endian { bytes } else { bytes.into_iter().rev().collect() }
    }

    fn save(self, folder: &TempDir) -> PathBuf {
        let mut bytes = if self.big_endian { b"MM\0*".to_vec() } else { b"II*\0".to_vec() };
        let widths = |kind| match kind {
            BYTE | ASCII => 1,
            SHORT => 2,
            _ => 4,
        };
        let values = |(_, kind, values): &(u16, u16, Vec<u32>)| {
            values.iter().flat_map(|&value| self.number(value, widths(*kind))).collect::<Vec<u8>>()
        };
        let mut behind = Vec::new();
        let directory = 8 + self.pixels.len() as u32;
        let after = directory + 2 + 12 * self.entries.len() as u32 + 4;
        let mut entries = Vec::new();
        for entry in &self.entries {
            let data = values(entry);
            entries.extend([self.number(entry.0.into(), 2), self.number(entry.1.into(), 2)].concat());
            entries.extend(self.number(entry.2.len() as u32, 4));
            if data.len() <= 4 {
                entries.extend(data.iter().copied().chain([0; 4]).take(4));
            } else {
                entries.extend(self.number(after + behind.len() as u32, 4));
                behind.extend(data);
            }
        }
        bytes.extend(self.number(directory, 4));
        bytes.extend(&self.pixels);
        bytes.extend(self.number(self.entries.len() as u32, 2));
        bytes.extend(entries);
        bytes.extend([0; 4]);
        bytes.extend(behind);
        let path = folder.path().join("a.tif");
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

fn values(path: &Path) -> Vec<f32> {
    read_stack(path).unwrap().samples.into_f32()
}

fn summary(path: &Path) -> String {
    ImageSummary::of(&read_stack(path).unwrap()).to_string()
}

fn with(path: &Path, query: &str) -> PathBuf {
    format!("{}?{query}", path.display()).into()
}

#[test]
fn alpha_beside_grey_is_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let file = Handmade::grey(2, 1, 8, vec![10, 255, 200, 3]);
    let path = file.with(258, SHORT, &[8, 8]).with(277, SHORT, &[2]).with(338, SHORT, &[2]).save(&folder);
    assert_eq!(read_stack(&path).unwrap().into_array(), ndarray::array![[[10.0, 200.0]]]);
    assert_eq!(values(&with(&path, "channel=alpha")), [255.0, 3.0]);
}

#[test]
fn integers_doubles_and_colour_pages_of_different_shapes_are_read() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut encoder = TiffEncoder::new(file.reopen().unwrap()).unwrap();
    encoder.write_image::<colortype::Gray8>(2, 1, &[3, 250]).unwrap();
    encoder.write_image::<colortype::Gray16>(1, 2, &[3, 65_000]).unwrap();
    encoder.write_image::<colortype::Gray32>(1, 1, &[70_000]).unwrap();
    encoder.write_image::<colortype::GrayI16>(1, 1, &[-7]).unwrap();
    encoder.write_image::<colortype::Gray64Float>(1, 1, &[0.25]).unwrap();
    encoder.write_image::<colortype::RGB8>(1, 1, &[0, 100, 0]).unwrap();
    let pages = read_pages(file.path()).unwrap();
    let values: Vec<f32> = pages.iter().flatten().copied().collect();
    assert_eq!(values, [3.0, 250.0, 3.0, 65_000.0, 70_000.0, -7.0, 0.25, 71.52]);
    assert_eq!((pages[0].dim(), pages[1].dim()), ((1, 2), (2, 1)));
    let error = read_stack(file.path()).unwrap_err().to_string();
    assert!(error.contains("page 2 of 2 x 1 px"), "{error}");
    let mut encoder = TiffEncoder::new(file.reopen().unwrap()).unwrap();
    encoder.write_image::<colortype::Gray64Float>(1, 1, &[1e303]).unwrap();
    let error = read_stack(file.path()).unwrap_err().to_string();
    assert!(error.contains("found 1e303; divide all values"), "{error}");
}

#[test]
fn colour_planes_become_pixels() {
    let planes = Samples::U8(vec![1, 2, 10, 20, 100, 200]);
    assert_eq!(interleave(&planes, 2, 3), Samples::U8(vec![1, 10, 100, 2, 20, 200]));
    let folder = tempfile::tempdir().unwrap();
    let file = Handmade::grey(2, 1, 8, vec![1, 2, 10, 20, 100, 200]);
    let file = file.with(258, SHORT, &[8; 3]).with(262, SHORT, &[2]).with(277, SHORT, &[3]).with(284, SHORT, &[2]);
    let path = file.with(273, LONG, &[8, 10, 12]).with(279, LONG, &[2; 3]).save(&folder);
    assert_eq!(values(&with(&path, "channel=green")), [10.0, 20.0]);
}

#[test]
fn inverting_tables_leave_stored_values_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    for big_endian in [false, true] {
        let bytes = |value: u16| if big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
        let pixels = [302, 2, 65_535].map(bytes).concat();
        let path = Handmade { big_endian, ..Handmade::grey(3, 1, 16, pixels) }.with(262, SHORT, &[0]).save(&folder);
        assert_eq!(values(&path), [302.0, 2.0, 65_535.0]);
        assert!(summary(&path).contains("stored values, though they are marked white-is-zero"), "{}", summary(&path));
        let bytes = |value: f32| if big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
        let float = Handmade { big_endian, ..Handmade::grey(2, 1, 32, [302.0, 1e-30].map(bytes).concat()) };
        let path = float.with(262, SHORT, &[0]).with(339, SHORT, &[3]).save(&folder);
        assert_eq!(values(&path), [302.0, 1e-30], "no digit is lost");
    }
    let path = Handmade::grey(2, 1, 8, vec![250, 3]).with(262, SHORT, &[0]).save(&folder);
    assert_eq!(values(&path), [250.0, 3.0]);
}

#[test]
fn images_behind_a_single_page_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let images = |count: u16| (0..count * 2).flat_map(u16::to_be_bytes).collect::<Vec<u8>>();
    let stack = |count: u16, text: &str| {
        let file = Handmade { big_endian: true, ..Handmade::grey(2, 1, 16, images(count)) };
        file.with(279, LONG, &[4]).described(text).save(&folder)
    };
    for text in ["ImageJ=1.11a\nimages=4\nslices=4\n", "{\"shape\": [2, 2, 1, 2], \"truncated\": true}"] {
        let path = stack(4, text);
        assert_eq!(values(&path), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], "{text}");
        assert!(summary(&path).starts_with("4 images of 1 x 2 px, 16 bits, range 0 to 7"), "{}", summary(&path));
        assert_eq!(read_pages(&path).unwrap().len(), 4);
    }
    // The directory and the description, which lie after the pixels, are not images.
    for (count, missing) in [(1, "other 899 were"), (3, "other 897 were")] {
        let path = stack(count, "ImageJ=1.11a\nimages=900\n");
        assert_eq!(values(&path).len(), 2 * usize::from(count));
        assert!(summary(&path).contains(&format!("counts 900 images; the {missing} not found")), "{}", summary(&path));
    }
}

#[test]
fn images_behind_a_packed_page_are_missed_in_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    // PackBits: two literal bytes.
    let file = Handmade::grey(2, 1, 8, vec![1, 10, 20]).with(259, SHORT, &[32_773]);
    let path = file.described("ImageJ=1\nimages=2\n").save(&folder);
    assert_eq!(values(&path), [10.0, 20.0]);
    assert!(summary(&path).ends_with("counts 2 images; the other 1 was not found in the file"), "{}", summary(&path));
}

#[test]
fn signed_numbers_of_imagej_are_those_that_it_shows() {
    let folder = tempfile::tempdir().unwrap();
    let pixels = [32_768_u16, 32_758, 32_868].map(u16::to_le_bytes).concat();
    let file = Handmade::grey(3, 1, 16, pixels).described("ImageJ=1.54f\ncf=0\nc0=-32768.0\nc1=1.0\nvunit=gray\n");
    let path = file.save(&folder);
    assert_eq!(values(&path), [0.0, -10.0, 100.0]);
    assert!(summary(&path).contains("16 bits with sign"), "{}", summary(&path));
}

#[test]
fn colour_tables_are_colours_but_for_those_of_imagej() {
    let folder = tempfile::tempdir().unwrap();
    // Entry 2 is green, entry 3 white, all others black.
    let table: Vec<u32> = [[0, 0, 0, 0xffff], [0, 0, 0xffff, 0xffff], [0, 0, 0, 0xffff]]
        .iter()
        .flat_map(|colour: &[u32; 4]| colour.iter().copied().chain([0; 252]))
        .collect();
    let file = || Handmade::grey(3, 1, 8, vec![2, 3, 0]).with(262, SHORT, &[3]).with(320, SHORT, &table);
    let path = file().save(&folder);
    assert_eq!(values(&path), [182.376, 255.0, 0.0]);
    assert_eq!(values(&with(&path, "channel=green")), [255.0, 255.0, 0.0]);
    assert_eq!(values(&with(&path, "channel=1")), [2.0, 3.0, 0.0]);
    let path = file().described("ImageJ=1.54f\n").save(&folder);
    assert_eq!(values(&path), [2.0, 3.0, 0.0]);
    assert!(summary(&path).contains("without its colour table (LUT)"), "{}", summary(&path));
}

#[test]
fn few_bits_are_unpacked() {
    let folder = tempfile::tempdir().unwrap();
    for (bits, pixels, expected) in [
        (1, vec![0b1010_0000, 0b0110_0000], vec![1.0, 0.0, 1.0, 0.0, 1.0, 1.0]),
        (2, vec![0b1101_1000, 0b0000_0100], vec![3.0, 1.0, 2.0, 0.0, 0.0, 1.0]),
        (4, vec![0xf1, 0x20, 0x34, 0x50], vec![15.0, 1.0, 2.0, 3.0, 4.0, 5.0]),
    ] {
        let path = Handmade::grey(3, 2, bits, pixels).save(&folder);
        assert_eq!(values(&path), expected, "{bits}");
        assert!(summary(&path).contains(&format!("{bits} bit")), "{}", summary(&path));
    }
}

#[test]
fn pages_are_upright_and_previews_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = Handmade::grey(3, 1, 8, vec![1, 2, 3]).with(274, SHORT, &[6]).save(&folder);
    let stack = read_stack(&path).unwrap();
    assert_eq!((stack.rows, stack.cols, stack.samples), (3, 1, Samples::U8(vec![1, 2, 3])));
    let mut encoder = TiffEncoder::new(std::fs::File::create(&path).unwrap()).unwrap();
    encoder.write_image::<colortype::Gray8>(2, 2, &[3, 250, 7, 9]).unwrap();
    let mut preview = encoder.new_image::<colortype::Gray8>(1, 1).unwrap();
    preview.encoder().write_tag(tiff::tags::Tag::NewSubfileType, 1_u32).unwrap();
    preview.write_data(&[9]).unwrap();
    assert_eq!(values(&path), [3.0, 250.0, 7.0, 9.0]);
    assert!(summary(&path).ends_with("1 reduced page left out"), "{}", summary(&path));
}

#[test]
fn what_is_not_read_is_called_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let file = || Handmade::grey(2, 1, 8, vec![1, 2]);
    for (tag, value, expected) in [
        (259, 34_925, "LZMA compression"),
        (259, 50_000, "Zstandard compression"),
        (259, 34_887, "LERC compression"),
        (259, 34_712, "JPEG 2000 compression"),
        (259, 34_933, "PNG compression"),
        (259, 34_934, "JPEG XR compression"),
        (259, 6, "old JPEG compression"),
        (259, 4_711, "compression of number 4711"),
        (262, 5, "CMYK colours"),
        (262, 8, "Lab colours"),
        (339, 6, "complex numbers"),
        (258, 12, "12 bits packed across bytes"),
        (266, 2, "lowest bit first (FillOrder 2); save it with FillOrder 1"),
        (32_997, 3, "a volume of 3 layers in one page (ImageDepth or TileDepth); save each layer"),
        (32_998, 2, "a volume of 2 layers"),
    ] {
        let error = read_stack(&file().with(tag, SHORT, &[value]).save(&folder)).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let planes = file().with(258, SHORT, &[8; 3]).with(262, SHORT, &[2]).with(277, SHORT, &[3]).with(284, SHORT, &[2]);
    let mut planes = planes.with(322, SHORT, &[16]).with(323, SHORT, &[16]).with(324, LONG, &[8; 3]);
    planes.pixels = vec![7; 256];
    planes.entries.retain(|(tag, ..)| !matches!(tag, 273 | 278 | 279));
    let error = read_stack(&planes.with(325, LONG, &[256; 3]).save(&folder)).unwrap_err().to_string();
    assert!(error.contains("planes of tiles that go beyond the image") && error.contains("-p contig"), "{error}");
    let many = file().with(258, SHORT, &[8; 7]).with(277, SHORT, &[7]).with(279, LONG, &[14]);
    let path = Handmade { pixels: (0..14).collect(), ..many }.save(&folder);
    let error = read_stack(&path).unwrap_err().to_string();
    assert!(error.contains("7 channels") && error.contains("add ?channel=1"), "{error}");
    assert_eq!(values(&with(&path, "channel=7")), [6.0, 13.0]);
}

/// Bytes packed by LZW, with a code that ends with every row. There are fewer codes than those of nine bits.
fn lzw(rows: &[[u8; 16]]) -> Vec<u8> {
    let mut table: std::collections::HashMap<Vec<u8>, u16> = (0..=255).map(|byte| (vec![byte], byte.into())).collect();
    let (mut codes, mut next, mut last) = (vec![256], 258, Vec::new());
    for row in rows {
        let mut left = row.as_slice();
        while !left.is_empty() {
            if !last.is_empty() {
                table.entry([&last[..], &left[..1]].concat()).or_insert(next);
                next += 1;
            }
            let length = (1..=left.len()).rev().find(|&length| table.contains_key(&left[..length])).unwrap();
            last = left[..length].to_vec();
            codes.push(table[&last]);
            left = &left[length..];
        }
    }
    assert!(next < 510);
    codes.push(257);
    let bits: Vec<u16> = codes.iter().flat_map(|code| (0..9).rev().map(move |bit| code >> bit & 1)).collect();
    bits.chunks(8).map(|bits| bits.iter().enumerate().map(|(place, &bit)| (bit as u8) << (7 - place)).sum()).collect()
}

#[test]
fn tiles_whose_rows_end_between_the_last_codes_of_lzw_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let tile = lzw(&[[7; 16]; 16]);
    let last = lzw(&[[9; 16]; 16]);
    for big_endian in [false, true] {
        // The last tile ends with the file.
        let save = |offset: usize| {
            let mut file = Handmade { big_endian, ..Handmade::grey(20, 16, 8, tile.clone()) };
            file.entries.retain(|(tag, ..)| !matches!(tag, 273 | 278 | 279));
            let file = file.with(259, SHORT, &[5]).with(322, SHORT, &[16]).with(323, SHORT, &[16]);
            let file = file.with(324, LONG, &[8, offset as u32]);
            file.with(325, SHORT, &[tile.len() as u32, last.len() as u32]).save(&folder)
        };
        let head = std::fs::read(save(0)).unwrap().len();
        let path = save(head);
        let whole = [std::fs::read(&path).unwrap(), last.clone()].concat();
        std::fs::write(&path, &whole).unwrap();
        let row = [[7.0; 16].as_slice(), &[9.0; 4]].concat();
        assert_eq!(values(&path), row.repeat(16));
        std::fs::write(&path, &whole[..whole.len() - 3]).unwrap();
        let error = read_stack(&path).unwrap_err().to_string();
        assert!(error.contains("cut short"), "{error}");
    }
}

#[test]
fn every_page_of_a_stack_of_imagej_gives_its_stored_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    let save = |description: &str, map: bool| {
        let mut encoder = TiffEncoder::new(std::fs::File::create(&path).unwrap()).unwrap();
        for page in 0..3_u16 {
            let mut image = encoder.new_image::<colortype::Gray16>(2, 1).unwrap();
            if page == 0 {
                image.encoder().write_tag(tiff::tags::Tag::ImageDescription, description).unwrap();
            }
            if map {
                let tag = tiff::tags::Tag::PhotometricInterpretation;
                image.encoder().write_tag(tag, 3_u16).unwrap();
                let table: Vec<u16> = (0..3 << 16).map(|entry| !(entry as u16)).collect();
                image.encoder().write_tag(tiff::tags::Tag::ColorMap, table.as_slice()).unwrap();
            }
            image.write_data(&[32_768 + page, 32_778]).unwrap();
        }
    };
    save("ImageJ=1.54f\nimages=3\nslices=3\n", true);
    assert_eq!(values(&path), [32_768.0, 32_778.0, 32_769.0, 32_778.0, 32_770.0, 32_778.0]);
    assert_eq!(values(&with(&path, "frame=3")), [32_770.0, 32_778.0]);
    assert_eq!(read_pages(&path).unwrap()[1], ndarray::array![[32_769.0, 32_778.0]]);
    save("ImageJ=1.54f\nimages=3\nc0=-32768.0\nc1=1.0\n", false);
    assert_eq!(values(&path), [0.0, 10.0, 1.0, 10.0, 2.0, 10.0]);
}

#[test]
fn pages_of_several_number_types_are_described_as_such() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut encoder = TiffEncoder::new(file.reopen().unwrap()).unwrap();
    encoder.write_image::<colortype::Gray8>(2, 1, &[3, 250]).unwrap();
    encoder.write_image::<colortype::Gray16>(2, 1, &[3, 65_000]).unwrap();
    assert!(summary(file.path()).contains("several number types, range 3 to 65000"), "{}", summary(file.path()));
    let mut encoder = TiffEncoder::new(file.reopen().unwrap()).unwrap();
    encoder.write_image::<colortype::Gray8>(1, 1, &[3]).unwrap();
    encoder.write_image::<colortype::RGB8>(1, 1, &[0, 100, 0]).unwrap();
    assert!(summary(file.path()).contains("8 bits, range 3 to 71.52"), "{}", summary(file.path()));
}
