//! Check that a JPEG file is complete. Decoders fill the missing part of a truncated image with grey and report no error.

/// First byte of every marker. In the data of a scan, a zero or a restart marker follows where the byte is not a marker.
const MARKER: u8 = 0xff;
const START_OF_IMAGE: u8 = 0xd8;
const END_OF_IMAGE: u8 = 0xd9;

/// Whether the file holds the end of the image. Images within segments, such as a camera's preview, are ignored. Files
/// that are not JPEG are left to the decoder.
pub(super) fn has_its_end(bytes: &[u8]) -> bool {
    let mut at = 0;
    loop {
        let Some(&first) = bytes.get(at) else { return false };
        let Some(&kind) = bytes.get(at + 1) else { return false };
        if first != MARKER {
            // Data of a scan, where the next marker is the end; or not a JPEG file.
            if at == 0 {
                return true;
            }
            at += 1;
            continue;
        }
        at += match kind {
            END_OF_IMAGE => return true,
            // A fill byte, which may be the first byte of a marker.
            MARKER => 1,
            // Part of a scan: the value 255, and restarts. Neither has a length.
            0 | 1 | 0xd0..=0xd7 | START_OF_IMAGE => 2,
            _ => {
                let Some(&[high, low]) = bytes.get(at + 2..at + 4).and_then(|length| length.first_chunk()) else {
                    return false;
                };
                2 + usize::from(u16::from_be_bytes([high, low]))
            }
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_preview_is_not_that_of_the_image() {
        let start = [0xff, 0xd8];
        // A segment with a preview of four bytes, its own length included.
        let preview = [0xff, 0xe1, 0, 6, 0xff, 0xd8, 0xff, 0xd9];
        let scan = [0xff, 0xda, 0, 3, 1, 7, 0xff, 0, 9, 0xff, 0xd0, 5];
        let cut = [&start[..], &preview, &scan].concat();
        for length in 0..cut.len() {
            assert!(!has_its_end(&cut[..length]), "{length} bytes");
        }
        assert!(!has_its_end(&cut));
        let whole = [&cut[..], &[0xff, 0xff, 0xd9]].concat();
        assert!(has_its_end(&whole) && has_its_end(&[&whole[..], b"more"].concat()));
        assert!(has_its_end(b"no image"));
    }
}
