//! `rubik-robot vision face`: picture files in, faces as text or JSON lines out.

use crate::vision::colours::{LETTERS, is_colourless};
use crate::vision::{DetectorSettings, FaceSighting, detect};
use anyhow::{Context, Result, anyhow, bail};
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Rgb, RgbImage};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{Cursor, Read};
use std::path::Path;

/// Largest picture that is taken [px]: more than a still camera has, less than fills a small machine's memory.
const MOST_PIXELS: u64 = 50_000_000;

/// Largest file that is read [bytes].
const MOST_BYTES: u64 = 256 << 20;

/// A picture file as RGB; the format is judged by its bytes, not by its name. Sixteen bits become eight, grey becomes
/// three equal channels, what is transparent is shown on black, and a photograph is turned as its camera says it was
/// held. Size and memory are bounded before decoding.
///
/// # Errors
/// What is wrong with the file.
pub fn load(path: &Path) -> Result<RgbImage> {
    let read = || -> Result<RgbImage> {
        let mut bytes = Vec::new();
        File::open(path)?.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
        decode(&bytes)
    };
    read().with_context(|| path.display().to_string())
}

/// The same of a picture file's bytes.
///
/// # Errors
/// What is wrong with them.
pub fn decode(bytes: &[u8]) -> Result<RgbImage> {
    if bytes.len() as u64 > MOST_BYTES {
        bail!("a file of more than {} MB is no picture that is looked at", MOST_BYTES >> 20);
    }
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
    let Some(format) = reader.format().filter(ImageFormat::reading_enabled) else {
        bail!("not a picture: neither PNG nor JPEG by its first bytes");
    };
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(8 * MOST_PIXELS + (64 << 20));
    reader.limits(limits);
    let damaged = "damaged picture";
    if format == ImageFormat::Png && !has_whole_palette(bytes) {
        bail!("{damaged}: its palette ends within a colour");
    }
    let mut decoder = reader.into_decoder().context(damaged)?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        bail!("a picture of {width} x {height} px is empty");
    }
    if u64::from(width) * u64::from(height) > MOST_PIXELS {
        bail!("{width} x {height} px is more than {} million", MOST_PIXELS / 1_000_000);
    }
    if format == ImageFormat::Jpeg && !jpeg_ends(bytes) {
        bail!("{damaged}: the file ends before its picture does");
    }
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let mut picture = DynamicImage::from_decoder(decoder).context(damaged)?;
    picture.apply_orientation(orientation);
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

/// Whether the palette of a PNG file, if it has one, is of whole colours, three bytes each: on another the decoder panics.
fn has_whole_palette(bytes: &[u8]) -> bool {
    // Behind the signature: length, type, data, checksum of each chunk.
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

/// Whether a JPEG stream comes to its end marker: decoders fill what is missing with grey.
fn jpeg_ends(bytes: &[u8]) -> bool {
    // Behind the marker of the start.
    let mut at = 2;
    while let Some(found) = bytes.get(at..).and_then(|rest| rest.iter().position(|&b| b == 0xFF)) {
        at += found + 1;
        match bytes.get(at) {
            Some(0xD9) => return true,
            // Fill bytes, stuffed zeros, restarts: no segment follows.
            Some(0xFF | 0x00 | 0x01 | 0xD0..=0xD8) | None => {}
            // Any other marker has a length, and what it spans may hold a thumbnail with an end of its own.
            Some(_) => {
                let Some(length) = bytes.get(at + 1..at + 3) else { return false };
                at += 1 + usize::from(u16::from_be_bytes([length[0], length[1]]));
            }
        }
    }
    false
}

/// Two decimals are finer than any detector.
fn rounded(points: &[(f64, f64)]) -> Value {
    let two = |v: f64| (v * 100.0).round() / 100.0;
    points.iter().map(|p| json!([two(p.0), two(p.1)])).collect()
}

/// Nine letters in reading order.
pub(super) fn letters(face: &FaceSighting) -> String {
    face.colours.iter().map(|&c| LETTERS[usize::from(c)]).collect()
}

/// Why the colours of faces that were found mean nothing, if so.
fn no_colour(faces: &[FaceSighting]) -> Option<&'static str> {
    let colourless = !faces.is_empty() && faces.iter().all(|face| is_colourless(&face.rgb));
    colourless.then_some("no colour: the picture is in black and white")
}

fn face_json(face: &FaceSighting) -> Value {
    let share = |v: f64| (v * 1000.0).round() / 1000.0;
    let c = &face.centres;
    json!({
        "corners": rounded(&[c[0], c[2], c[8], c[6]]),
        "centres": rounded(c),
        "outline": rounded(&face.corners),
        "colours": letters(face),
        "confidence": share(face.confidence),
        "tile_confidence": face.confidences.map(share),
    })
}

/// `vision face IMAGE...`: the faces of each picture, or why there are none; one line a picture with `json`.
/// A file that is no picture gets its line too; the flag is false when any picture showed no face. A picture in black and
/// white has faces and a reason, why their colours mean nothing.
#[must_use]
pub fn face(images: &[impl AsRef<Path>], json: bool) -> (String, bool) {
    let (mut text, mut all) = (String::new(), true);
    for path in images {
        let name = path.as_ref().display().to_string();
        let found = load(path.as_ref()).and_then(|image| {
            detect(&image, None, &DetectorSettings::default()).map_err(|refusal| anyhow!(refusal))
        });
        all &= found.is_ok();
        // Writing to a string cannot fail.
        let _ = match (&found, json) {
            (Ok(faces), true) => {
                let found: Vec<Value> = faces.iter().map(face_json).collect();
                let mut line = json!({ "image": name, "faces": found });
                if let Some(reason) = no_colour(faces) {
                    line["reason"] = reason.into();
                }
                writeln!(text, "{line}")
            }
            (Err(reason), true) => {
                let reason = format!("{reason:#}");
                writeln!(text, "{}", json!({ "image": name, "faces": [], "reason": reason }))
            }
            (Err(reason), false) => writeln!(text, "{name}: {reason:#}"),
            (Ok(faces), false) => faces.iter().enumerate().try_for_each(|(i, f)| {
                let c = letters(f);
                let weakest = f.confidences.iter().copied().fold(1.0, f64::min);
                let at = f.centres[4];
                let doubt = no_colour(faces).map(|reason| format!("; {reason}"));
                writeln!(
                    text,
                    "{name}: face {} of {}: {} / {} / {}  centre {:.0},{:.0} px, width {:.0} px, confidence {:.2}, least certain tile {weakest:.2}{}",
                    i + 1,
                    faces.len(),
                    &c[0..3],
                    &c[3..6],
                    &c[6..9],
                    at.0,
                    at.1,
                    f.width_px(),
                    f.confidence,
                    doubt.unwrap_or_default(),
                )
            }),
        };
    }
    (text, all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vision::testing::Drawing;

    #[test]
    fn a_file_that_is_no_picture_gets_a_line_with_the_reason() {
        let (text, all) = face(&["Cargo.toml", "no/such.png"], true);

        let lines: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        assert!(!all);
        assert_eq!(lines.len(), 2);
        assert!(lines.iter().all(|l| l["reason"].is_string()), "{text}");
    }

    #[test]
    fn a_palette_that_ends_within_a_colour_is_damage() {
        let bytes = include_bytes!("../../tests/corpus/image/palette-of-four-bytes.png");

        let why = format!("{:#}", decode(bytes).unwrap_err());

        assert_eq!(why, "damaged picture: its palette ends within a colour");
    }

    /// A file that goes away with the test.
    struct Written(std::path::PathBuf);

    impl Written {
        fn new(name: &str, bytes: &[u8]) -> Self {
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

    fn bytes(picture: &image::DynamicImage, format: ImageFormat) -> Vec<u8> {
        let mut out = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut out, format).unwrap();
        out.into_inner()
    }

    fn reason(name: &str, bytes: &[u8]) -> String {
        format!("{:#}", load(&Written::new(name, bytes).0).unwrap_err())
    }

    #[test]
    fn what_is_wrong_with_a_file_is_said() {
        let good = bytes(&image::DynamicImage::new_rgb8(60, 40), ImageFormat::Png);

        assert!(reason("text.png", b"not a picture at all").contains("not a picture"));
        assert!(reason("empty.png", b"").contains("not a picture"));
        assert!(reason("short.png", &good[..good.len() / 2]).contains("damaged"));
        assert!(reason("head.jpg", &[0xFF, 0xD8, 0xFF, 0xE0]).contains("damaged"));
        let jpeg = bytes(&image::DynamicImage::new_rgb8(60, 40), ImageFormat::Jpeg);
        assert!(reason("short.jpg", &jpeg[..jpeg.len() - 2]).contains("ends before its picture"));
        // A header that promises more than any machine has; the checksum is not what is wrong.
        let mut vast = good.clone();
        vast[16..24].copy_from_slice(&[0, 0, 0x4E, 0x20, 0, 0, 0x4E, 0x20]);
        assert!(!reason("vast.png", &vast).is_empty());
        let mut none = good;
        none[16..24].fill(0);
        assert!(!reason("none.png", &none).is_empty());
    }

    #[test]
    fn a_picture_of_400_million_pixels_is_refused_before_it_is_decoded() {
        // A whole PNG of 20000 x 20000 px in one bit, which packs well.
        let mut out = Vec::new();
        let mut chunk = |name: &[u8; 4], data: &[u8]| {
            out.extend((data.len() as u32).to_be_bytes());
            let start = out.len();
            out.extend(name);
            out.extend(data);
            let mut crc = u32::MAX;
            for byte in &out[start..] {
                crc ^= u32::from(*byte);
                for _ in 0..8 {
                    crc = if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
                }
            }
            out.extend((!crc).to_be_bytes());
        };
        chunk(b"IHDR", &[0, 0, 0x4E, 0x20, 0, 0, 0x4E, 0x20, 1, 0, 0, 0, 0]);
        chunk(b"IDAT", &[0x78, 0x9C, 3, 0, 0, 0, 0, 1]);
        chunk(b"IEND", &[]);
        let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
        file.extend(out);

        let said = reason("large.png", &file);

        assert!(said.contains("20000 x 20000 px is more than 50 million"), "{said}");
    }

    #[test]
    fn a_photograph_is_turned_as_it_was_held() {
        let picture = RgbImage::from_fn(24, 8, |x, _| Rgb([if x < 12 { 250 } else { 5 }; 3]));
        let mut file = bytes(&picture.into(), ImageFormat::Jpeg);
        // Exif with one entry: orientation 6, to be turned clockwise; and a thumbnail's end marker in a comment.
        let exif = b"\xFF\xE1\x00\x22Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
        let comment = b"\xFF\xFE\x00\x04\xFF\xD9";
        file.splice(2..2, exif.iter().chain(comment).copied());

        let turned = decode(&file).unwrap();

        assert_eq!(turned.dimensions(), (8, 24));
        assert!(turned.get_pixel(4, 2).0[0] > 200 && turned.get_pixel(4, 20).0[0] < 50);
    }

    #[test]
    fn grey_sixteen_bits_and_alpha_are_taken() {
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
        let (line, found) =
            face(&[&Written::new("one.png", &bytes(&D::new_rgb8(1, 1), ImageFormat::Png)).0], true);
        assert!(!found && line.contains("only 1x1 px"), "{line}");
    }

    #[test]
    fn of_a_picture_in_black_and_white_it_is_said_that_it_has_no_colour() {
        let optics = crate::cell::Intrinsics {
            width: 320,
            height: 240,
            focal: (400.0, 400.0),
            centre: (159.5, 119.5),
            distortion: (0.0, 0.0),
        };
        let pose = crate::spatial::Pose::translation(0.0, 0.0, 0.2);
        let drawing = Drawing::new(optics, vec![(pose, [0, 1, 2, 3, 4, 5, 4, 1, 0])]);
        let coloured = DynamicImage::from(drawing.render());
        let grey = DynamicImage::from(coloured.to_luma8());
        let line = |name: &str, picture: &DynamicImage| {
            let file = Written::new(name, &bytes(picture, ImageFormat::Png));
            let (line, found) = face(&[&file.0], true);
            assert!(found, "{line}");
            (serde_json::from_str::<Value>(&line).unwrap(), face(&[&file.0], false).0)
        };

        let (json, text) = line("grey.png", &grey);
        assert!(json["reason"].as_str().unwrap().starts_with("no colour"), "{json}");
        assert_eq!(json["faces"][0]["tile_confidence"], json!(vec![0.0; 9]));
        assert!(text.contains("no colour"), "{text}");
        let (json, text) = line("coloured.png", &coloured);
        assert!(json["reason"].is_null() && !text.contains("no colour"), "{json}");
    }

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig::with_cases(48))]
        #[test]
        fn no_bytes_make_it_panic(
            noise in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..200),
            at in 0usize..400, keep in 0usize..800, jpeg in proptest::prelude::any::<bool>(),
        ) {
            let picture = RgbImage::from_fn(24, 20, |x, y| Rgb([(x * 9) as u8, (y * 11) as u8, 90]));
            let format = if jpeg { ImageFormat::Jpeg } else { ImageFormat::Png };
            let mut bytes = bytes(&picture.into(), format);
            let at = at.min(bytes.len());
            let end = (at + noise.len()).min(bytes.len());
            bytes[at..end].copy_from_slice(&noise[..end - at]);
            bytes.truncate(keep);

            let (line, _) = face(&[&Written::new("noise", &bytes).0], true);

            proptest::prop_assert_eq!(line.lines().count(), 1);
        }
    }
}
