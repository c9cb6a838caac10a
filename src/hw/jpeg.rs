//! JPEG pictures without Huffman tables, as webcams send them.
//!
//! The frames of a Motion-JPEG stream may leave out the tables, because all of them use those of
//! the standard. A decoder of files refuses such a frame, so the tables are inserted first.
//!
//! - in: bytes of a JPEG file
//! - out: the bytes, with the standard tables if the file has none
//! - source: ITU-T T.81 (1992), annex K.3, tables K.3 to K.6

use std::borrow::Cow;

/// Returns the bytes of a JPEG file with the standard Huffman tables before its first scan if it
/// defines none. Any other bytes are returned as they are.
#[must_use]
pub(crate) fn with_huffman_tables(bytes: &[u8]) -> Cow<'_, [u8]> {
    match scan_without_tables(bytes) {
        None => Cow::Borrowed(bytes),
        Some(scan) => {
            let (head, rest) = bytes.split_at(scan);
            Cow::Owned([head, &standard_tables(), rest].concat())
        }
    }
}

/// Returns the position of the first scan of a JPEG file that has no Huffman table before it;
/// `None` for any other bytes.
fn scan_without_tables(bytes: &[u8]) -> Option<usize> {
    let mut at = 2;
    bytes.strip_prefix(&[0xFF, 0xD8])?;
    loop {
        let segment = bytes.get(at..)?;
        match *segment {
            // Fill bytes may stand before a marker.
            [0xFF, 0xFF, ..] => at += 1,
            // The file has tables (C4), or its picture is not sequential with Huffman codes: the
            // standard has tables only for such pictures (SOF0, SOF1).
            [0xFF, 0xC2..=0xCF, ..] => return None,
            [0xFF, 0xDA, ..] => return Some(at),
            [0xFF, _, high, low, ..] => at += 2 + usize::from(u16::from_be_bytes([high, low])),
            _ => return None,
        }
    }
}

/// Returns a segment that defines the four standard tables.
fn standard_tables() -> Vec<u8> {
    /// Class and number of a table, number of codes of each length (1 to 16 bits), their values.
    type Table<'a> = (u8, [u8; 16], &'a [u8]);
    let tables: [Table<'_>; 4] = [
        (0x00, [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0], &DC),
        (0x10, [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125], &AC_LUMINANCE),
        (0x01, [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0], &DC),
        (0x11, [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 119], &AC_CHROMINANCE),
    ];
    let mut segment = vec![0xFF, 0xC4, 0, 0];
    for (name, counts, values) in tables {
        segment.push(name);
        segment.extend(counts);
        segment.extend(values);
    }
    // The length includes its own two bytes and not the marker.
    let length = (segment.len() - 2) as u16;
    segment[2..4].copy_from_slice(&length.to_be_bytes());
    segment
}

/// Categories of differences of DC coefficients, in the order of their codes.
const DC: [u8; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];
/// Runs and categories of the AC coefficients of luminance, in the order of their codes.
#[rustfmt::skip]
const AC_LUMINANCE: [u8; 162] = [
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07,
    0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xA1, 0x08, 0x23, 0x42, 0xB1, 0xC1, 0x15, 0x52, 0xD1, 0xF0,
    0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0A, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x25, 0x26, 0x27, 0x28,
    0x29, 0x2A, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3A, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49,
    0x4A, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5A, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69,
    0x6A, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7A, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89,
    0x8A, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9A, 0xA2, 0xA3, 0xA4, 0xA5, 0xA6, 0xA7,
    0xA8, 0xA9, 0xAA, 0xB2, 0xB3, 0xB4, 0xB5, 0xB6, 0xB7, 0xB8, 0xB9, 0xBA, 0xC2, 0xC3, 0xC4, 0xC5,
    0xC6, 0xC7, 0xC8, 0xC9, 0xCA, 0xD2, 0xD3, 0xD4, 0xD5, 0xD6, 0xD7, 0xD8, 0xD9, 0xDA, 0xE1, 0xE2,
    0xE3, 0xE4, 0xE5, 0xE6, 0xE7, 0xE8, 0xE9, 0xEA, 0xF1, 0xF2, 0xF3, 0xF4, 0xF5, 0xF6, 0xF7, 0xF8,
    0xF9, 0xFA,
];
/// Runs and categories of the AC coefficients of chrominance, in the order of their codes.
#[rustfmt::skip]
const AC_CHROMINANCE: [u8; 162] = [
    0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61, 0x71,
    0x13, 0x22, 0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xA1, 0xB1, 0xC1, 0x09, 0x23, 0x33, 0x52, 0xF0,
    0x15, 0x62, 0x72, 0xD1, 0x0A, 0x16, 0x24, 0x34, 0xE1, 0x25, 0xF1, 0x17, 0x18, 0x19, 0x1A, 0x26,
    0x27, 0x28, 0x29, 0x2A, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3A, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48,
    0x49, 0x4A, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5A, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68,
    0x69, 0x6A, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7A, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87,
    0x88, 0x89, 0x8A, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9A, 0xA2, 0xA3, 0xA4, 0xA5,
    0xA6, 0xA7, 0xA8, 0xA9, 0xAA, 0xB2, 0xB3, 0xB4, 0xB5, 0xB6, 0xB7, 0xB8, 0xB9, 0xBA, 0xC2, 0xC3,
    0xC4, 0xC5, 0xC6, 0xC7, 0xC8, 0xC9, 0xCA, 0xD2, 0xD3, 0xD4, 0xD5, 0xD6, 0xD7, 0xD8, 0xD9, 0xDA,
    0xE2, 0xE3, 0xE4, 0xE5, 0xE6, 0xE7, 0xE8, 0xE9, 0xEA, 0xF2, 0xF3, 0xF4, 0xF5, 0xF6, 0xF7, 0xF8,
    0xF9, 0xFA,
];

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use image::{ImageFormat, Rgb, RgbImage};

    /// Returns a picture with all kinds of coefficients as JPEG.
    pub(crate) fn encoded() -> Vec<u8> {
        let level = |x: u32, y: u32| Rgb([x * 5, y * 7, (x * x + 3 * y) % 256].map(|v| v as u8));
        let mut file = std::io::Cursor::new(Vec::new());
        RgbImage::from_fn(48, 32, level).write_to(&mut file, ImageFormat::Jpeg).unwrap();
        file.into_inner()
    }

    /// Returns a JPEG file without the segments that define Huffman tables.
    pub(crate) fn without_huffman_tables(file: &[u8]) -> Vec<u8> {
        let (mut kept, mut at) = (file[..2].to_vec(), 2);
        while file[at + 1] != 0xDA {
            let end = at + 2 + usize::from(u16::from_be_bytes([file[at + 2], file[at + 3]]));
            if file[at + 1] != 0xC4 {
                kept.extend(&file[at..end]);
            }
            at = end;
        }
        kept.extend(&file[at..]);
        kept
    }

    /// The encoder uses the standard tables, so its file is the reference.
    #[test]
    fn inserted_tables_decode_stripped_file() {
        let file = encoded();
        let stripped = without_huffman_tables(&file);
        assert!(stripped.len() + 400 < file.len());

        let whole = with_huffman_tables(&stripped);

        let decoded = |bytes: &[u8]| image::load_from_memory(bytes).unwrap().to_rgb8();
        assert!(image::load_from_memory(&stripped).is_err());
        assert_eq!(decoded(&whole), decoded(&file));
    }

    #[test]
    fn bytes_that_need_no_tables_stay_unchanged() {
        let file = encoded();
        let stripped = without_huffman_tables(&file);
        // The same picture, said to be progressive.
        let mut progressive = stripped.clone();
        let frame = stripped.windows(2).position(|two| two == [0xFF, 0xC0]).unwrap();
        progressive[frame + 1] = 0xC2;

        for bytes in [&file[..], &progressive, &stripped[..60], b"", b"\xff\xd8", b"\x89PNG"] {
            let kept = with_huffman_tables(bytes);

            assert!(matches!(kept, Cow::Borrowed(same) if same == bytes), "{bytes:?}");
        }
    }
}
