//! Reading of picture files.
//!
//! - in: a file or its bytes, PNG or JPEG
//! - out: an upright RGB picture; or the reason why there is none
//!
//! | fault | limit | reason |
//! |---|---|---|
//! | too many pixels | `MOST_PIXELS` | a header may promise more than the memory holds |
//! | file too large | `MOST_BYTES` | the bytes are read before they are decoded |
//! | palette ends within a colour | 3 bytes a colour | the decoder panics |
//! | any other panic of a decoder | - | foreign bytes must not end the program |
//! | pipe or device in a camera's folder | regular files | the camera's worker would wait for it |
//! | JPEG without an end | end marker | the decoder fills the rest with grey |
//! | JPEG without Huffman tables | those of the standard are inserted | webcams leave them out |

use super::jpeg::with_huffman_tables;
use super::text;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Rgb, RgbImage};
use std::fs::File;
use std::io::{Cursor, Read};
use std::panic::catch_unwind;
use std::path::Path;

/// Largest number of pixels: more than a still camera has, and few enough for a small machine.
const MOST_PIXELS: u64 = 50_000_000;

/// Largest number of pixels of a camera's frame. It is smaller than [`MOST_PIXELS`], because a
/// camera delivers many frames.
const MOST_OF_FRAME: u64 = 16_000_000;

/// Largest size of a file (bytes).
const MOST_BYTES: u64 = 256 << 20;

/// Reason why a file is no usable picture.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct Unreadable(String);

impl From<std::io::Error> for Unreadable {
    fn from(error: std::io::Error) -> Self {
        Self(text::reason(&error).into_owned())
    }
}

/// Result of the reading of a picture.
type Result<T> = std::result::Result<T, Unreadable>;

/// Returns an [`Unreadable`] error with this reason.
fn refuse<T>(reason: impl Into<String>) -> Result<T> {
    Err(Unreadable(reason.into()))
}

/// Reads a picture file as RGB. The bytes decide the format, not the name. Sixteen bits become
/// eight, grey becomes three equal channels, transparent pixels are shown on black, and a
/// photograph is turned upright by its orientation tag. Size and memory are checked before the
/// picture is decoded.
///
/// # Errors
/// Reason why the file is no usable picture, with its path.
pub fn load(path: &Path) -> Result<RgbImage> {
    let read = || decode(&bytes_of(text::open_any(path).map_err(|unread| unread.why)?)?);
    named(path, read())
}

/// Reads a camera's picture file as [`load`] does. Only a regular file with at most 16 million
/// pixels is accepted.
///
/// # Errors
/// Reason why the file is no usable picture, with its path.
pub fn load_frame(path: &Path) -> Result<RgbImage> {
    let read = || decode_within(&bytes_of(text::open(path)?)?, MOST_OF_FRAME);
    named(path, read())
}

/// Puts the path before the reason of an error, as [`text::Unread`] does.
fn named(path: &Path, read: Result<RgbImage>) -> Result<RgbImage> {
    read.map_err(|Unreadable(why)| Unreadable(format!("cannot read {}: {why}", path.display())))
}

/// Reads the bytes of a file, at most one more than [`MOST_BYTES`], which shows that the file is
/// larger.
fn bytes_of(file: File) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Decodes the bytes of a picture file as [`load`] does.
///
/// # Errors
/// Reason why the bytes are no usable picture.
pub fn decode(bytes: &[u8]) -> Result<RgbImage> {
    decode_within(bytes, MOST_PIXELS)
}

/// Decodes the bytes of a camera's frame as [`decode`] does, with at most 16 million pixels.
pub(crate) fn decode_frame(bytes: &[u8]) -> Result<RgbImage> {
    decode_within(bytes, MOST_OF_FRAME)
}

/// Decodes a picture of at most `most` pixels. A panic of the decoder becomes an error.
fn decode_within(bytes: &[u8], most: u64) -> Result<RgbImage> {
    guarded(|| decoded(bytes, most))
}

/// Calls a decoder and turns its panic into an error.
fn guarded(decode: impl FnOnce() -> Result<RgbImage> + std::panic::UnwindSafe) -> Result<RgbImage> {
    catch_unwind(decode).unwrap_or_else(|_| refuse("damaged picture: the decoder panicked"))
}

/// Decodes a picture of at most `most` pixels, without a guard against a decoder that panics.
fn decoded(bytes: &[u8], most: u64) -> Result<RgbImage> {
    if bytes.len() as u64 > MOST_BYTES {
        return refuse(format!("the file is larger than {} MiB", MOST_BYTES >> 20));
    }
    let bytes = &*with_huffman_tables(bytes);
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
    let Some(format) = reader.format().filter(ImageFormat::reading_enabled) else {
        return refuse("not a picture: the file begins neither as PNG nor as JPEG");
    };
    let mut limits = image::Limits::default();
    // Eight bytes a pixel are RGBA of sixteen bits; the rest is for the decoder itself.
    limits.max_alloc = Some(8 * most + (64 << 20));
    reader.limits(limits);
    let damaged = |why: image::ImageError| Unreadable(format!("damaged picture: {why}"));
    // A palette with a part of a colour makes the decoder panic.
    if format == ImageFormat::Png && !has_whole_palette(bytes) {
        return refuse("damaged picture: its palette ends within a colour");
    }
    let mut decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return refuse(format!("the picture of {width} x {height} px is empty"));
    }
    // The header is checked before the decoder takes memory for the pixels.
    if u64::from(width) * u64::from(height) > most {
        return refuse(format!(
            "{width} x {height} px is more than {} million: scale the picture down",
            most / 1_000_000
        ));
    }
    // The decoder fills the missing part of a picture with grey.
    if format == ImageFormat::Jpeg && !jpeg_ends(bytes) {
        return refuse("damaged picture: the file ends before the picture is complete");
    }
    // A picture without a readable tag is upright.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let mut picture = DynamicImage::from_decoder(decoder).map_err(damaged)?;
    picture.apply_orientation(orientation);
    // A picture without transparency is converted without a second copy.
    if !picture.color().has_alpha() {
        return Ok(picture.into_rgb8());
    }
    let transparent = picture.into_rgba8();
    let (width, height) = transparent.dimensions();
    Ok(RgbImage::from_fn(width, height, |x, y| {
        let [r, g, b, a] = transparent.get_pixel(x, y).0;
        Rgb([r, g, b].map(|v| (u16::from(v) * u16::from(a) / 255) as u8))
    }))
}

/// Returns whether the palette of a PNG file, if it has one, consists of whole colours of three
/// bytes. On any other palette the decoder panics.
fn has_whole_palette(bytes: &[u8]) -> bool {
    // After the signature each chunk has length, type, data and checksum.
    let mut rest = bytes.get(8..).unwrap_or_default();
    while let Some((length, behind)) = rest.split_first_chunk::<4>() {
        let length = u32::from_be_bytes(*length) as usize;
        if behind.starts_with(b"PLTE") && !length.is_multiple_of(3) {
            return false;
        }
        rest = behind.get(length.saturating_add(8)..).unwrap_or_default();
    }
    true
}

/// Returns whether a JPEG stream has its end marker.
fn jpeg_ends(bytes: &[u8]) -> bool {
    // The first marker is that of the start.
    let mut at = 2;
    while let Some(found) = bytes.get(at..).and_then(|rest| rest.iter().position(|&b| b == 0xFF)) {
        at += found + 1;
        match bytes.get(at) {
            Some(0xD9) => return true,
            // Fill bytes, stuffed zeros, restarts: no segment follows.
            Some(0xFF | 0x00 | 0x01 | 0xD0..=0xD8) | None => {}
            // Any other segment has a length. It is skipped, since a thumbnail in it has an end
            // marker of its own.
            Some(_) => {
                let Some(length) = bytes.get(at + 1..at + 3) else { return false };
                at += 1 + usize::from(u16::from_be_bytes([length[0], length[1]]));
            }
        }
    }
    false
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::tables::testing::make_pipe;

    #[test]
    fn palette_that_ends_within_a_colour_is_refused() {
        let bytes = include_bytes!("../../tests/corpus/image/palette-of-four-bytes.png");

        let why = format!("{:#}", decode(bytes).unwrap_err());

        assert_eq!(why, "damaged picture: its palette ends within a colour");
    }

    /// File that is removed at the end of the test.
    pub(crate) struct Written(pub(crate) std::path::PathBuf);

    impl Written {
        /// Writes `bytes` to a file in the folder for temporary files; its name ends with `name`.
        pub(crate) fn new(name: &str, bytes: &[u8]) -> Self {
            let path = std::env::temp_dir().join(format!("rubik-{}-{name}", std::process::id()));
            std::fs::write(&path, bytes).unwrap();
            Self(path)
        }
    }

    impl Drop for Written {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    /// Encodes a picture in a file format.
    pub(crate) fn bytes(picture: &image::DynamicImage, format: ImageFormat) -> Vec<u8> {
        let mut out = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut out, format).unwrap();
        out.into_inner()
    }

    /// Writes `bytes` to a file whose name ends with `name`; returns the error when it is loaded.
    fn reason(name: &str, bytes: &[u8]) -> String {
        format!("{:#}", load(&Written::new(name, bytes).0).unwrap_err())
    }

    #[test]
    fn frame_without_huffman_tables_is_decoded() {
        use crate::hw::jpeg::tests::{encoded, without_huffman_tables};

        let stripped = without_huffman_tables(&encoded());

        assert_eq!(decode(&stripped).unwrap(), decode(&encoded()).unwrap());
    }

    #[test]
    fn decode_error_tells_damaged_file_from_non_picture() {
        let good = bytes(&image::DynamicImage::new_rgb8(60, 40), ImageFormat::Png);

        assert!(reason("text.png", b"not a picture at all").contains("not a picture"));
        assert!(reason("empty.png", b"").contains("not a picture"));
        assert!(reason("short.png", &good[..good.len() / 2]).contains("damaged"));
        assert!(reason("head.jpg", &[0xFF, 0xD8, 0xFF, 0xE0]).contains("damaged"));
        let jpeg = bytes(&image::DynamicImage::new_rgb8(60, 40), ImageFormat::Jpeg);
        assert!(
            reason("short.jpg", &jpeg[..jpeg.len() - 2])
                .contains("ends before the picture is complete")
        );
        assert!(reason("none.png", &vast(0)).contains("damaged"));
    }

    /// Returns a PNG of `side` x `side` pixels with one bit a pixel, whose data compress well.
    pub(crate) fn vast(side: u32) -> Vec<u8> {
        let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
        let mut chunk = |name: &[u8; 4], data: &[u8]| {
            out.extend((data.len() as u32).to_be_bytes());
            let body = [name.as_slice(), data].concat();
            out.extend(&body);
            out.extend(crc32fast::hash(&body).to_be_bytes());
        };
        let side = side.to_be_bytes();
        chunk(b"IHDR", &[side.as_slice(), &side, &[1, 0, 0, 0, 0]].concat());
        chunk(b"IDAT", &[0x78, 0x9C, 3, 0, 0, 0, 0, 1]);
        chunk(b"IEND", &[]);
        out
    }

    #[test]
    fn decode_refuses_400_million_pixels() {
        let why = reason("large.png", &vast(20_000));

        assert!(why.contains("20000 x 20000 px is more than 50 million"), "{why}");
    }

    /// A camera's folder may hold a large photograph, and a pipe that has no writer.
    #[test]
    fn camera_frame_must_be_small_regular_file() {
        let large = Written::new("frame.png", &vast(4_100));
        let why = load_frame(&large.0).unwrap_err().to_string();
        assert!(why.contains("4100 x 4100 px is more than 16 million"), "{why}");

        let pipe = Written(std::env::temp_dir().join(format!("rubik-pipe-{}", std::process::id())));
        make_pipe(&pipe.0);
        let why = load_frame(&pipe.0).unwrap_err().to_string();
        assert!(why.ends_with(": not a regular file"), "{why}");
    }

    #[test]
    fn decoder_panic_is_an_error() {
        let why = guarded(|| panic!("on purpose")).unwrap_err().to_string();

        assert_eq!(why, "damaged picture: the decoder panicked");
    }

    #[test]
    fn photograph_is_turned_upright() {
        let picture = RgbImage::from_fn(24, 8, |x, _| Rgb([if x < 12 { 250 } else { 5 }; 3]));
        let mut file = bytes(&picture.into(), ImageFormat::Jpeg);
        // Exif with one entry, orientation 6: turn clockwise. A comment has the end marker of a
        // thumbnail.
        let exif = b"\xFF\xE1\x00\x22Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\
            \0\0\0\0\0\0";
        let comment = b"\xFF\xFE\x00\x04\xFF\xD9";
        file.splice(2..2, exif.iter().chain(comment).copied());

        let turned = decode(&file).unwrap();

        assert_eq!(turned.dimensions(), (8, 24));
        assert!(turned.get_pixel(4, 2).0[0] > 200 && turned.get_pixel(4, 20).0[0] < 50);
    }

    #[test]
    fn decode_accepts_grey_16_bits_and_alpha() {
        use image::DynamicImage as D;
        for (i, picture) in [
            D::new_luma8(9, 7),
            D::new_luma16(9, 7),
            D::new_luma_a8(9, 7),
            D::new_rgba8(9, 7),
            D::new_rgb16(9, 7),
            D::new_rgba16(9, 7),
            D::new_rgb8(1, 1),
        ]
        .iter()
        .enumerate()
        {
            let file = Written::new(&format!("kind-{i}.png"), &bytes(picture, ImageFormat::Png));

            assert_eq!(load(&file.0).unwrap().width(), picture.width());
        }
    }
}
