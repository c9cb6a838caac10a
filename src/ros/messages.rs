//! Messages that the program takes from ROS 2.
//!
//! - in: the bytes of `sensor_msgs` `Image`, `CompressedImage` and `JointState`
//! - out: a picture; positions of joints
//! - A message is never trusted: each length is compared with the bytes that are there before
//!   anything is allocated, and a picture is at most `LARGEST_SIDE` wide and high.

use super::type_hash::type_hash;
use crate::record::cdr::{Malformed, Reader};
use crate::record::schema::Kind;
use image::{ImageFormat, ImageReader, Limits, RgbImage};
use std::io::Cursor;

/// Raw picture.
pub const IMAGE: &str = "sensor_msgs/msg/Image";
/// Picture as a JPEG or a PNG.
pub const COMPRESSED: &str = "sensor_msgs/msg/CompressedImage";
/// States of joints, or commands for them.
pub const JOINTS: &str = "sensor_msgs/msg/JointState";
/// Hash of [`IMAGE`], by the package `rosbags`: no recording has this type.
const IMAGE_HASH: &str = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47";

/// Greatest width and height of a picture (px).
const LARGEST_SIDE: u32 = 16_384;
/// Most memory that the decoder of a compressed picture may take (bytes).
const DECODER_MEMORY: u64 = 256 << 20;
/// Most joints in a message.
const MOST_JOINTS: usize = 256;

/// Picture with the time that its sender gave it.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Time of the exposure by the clock of the sender (ns).
    pub time: u64,
    /// Pixels.
    pub image: RgbImage,
}

/// Positions of joints, by their names.
#[derive(Debug, Clone, PartialEq)]
pub struct JointState {
    /// Names, each with its position (m or rad).
    pub positions: Vec<(String, f64)>,
}

/// Order of the channels of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Channels {
    Rgb,
    Bgr,
    Mono,
}

impl Channels {
    /// Returns the channels of an encoding.
    ///
    /// # Errors
    /// The reason, if the program does not read this encoding.
    fn of(encoding: &str) -> Result<Self, String> {
        match encoding {
            "rgb8" => Ok(Self::Rgb),
            "bgr8" => Ok(Self::Bgr),
            "mono8" => Ok(Self::Mono),
            other => Err(format!(
                "the encoding is \"{}\": only rgb8, bgr8 and mono8 are read",
                shortened(other)
            )),
        }
    }

    /// Returns the number of bytes of a pixel.
    fn bytes(self) -> usize {
        if self == Self::Mono { 1 } else { 3 }
    }
}

/// Returns at most 40 characters of a text of another program, for a message.
fn shortened(text: &str) -> String {
    text.chars().filter(|letter| !letter.is_control()).take(40).collect()
}

/// Returns the reason of a message that is cut off or of another type.
fn malformed(why: Malformed) -> String {
    why.to_string()
}

/// Returns the hash of a type that the program takes.
pub(super) fn hash_of(kind: &str) -> String {
    match kind {
        COMPRESSED => type_hash(Kind::Picture),
        JOINTS => type_hash(Kind::JointState),
        _ => IMAGE_HASH.to_owned(),
    }
}

/// Returns the type of the pictures of a topic, by the rule of `image_transport` for its name.
pub(super) fn kind_of_pictures(topic: &str) -> &'static str {
    if topic.ends_with("/compressed") { COMPRESSED } else { IMAGE }
}

/// Decodes a message of the type `kind`, such as `sensor_msgs/msg/Image`, to a picture of the
/// `size` (px).
///
/// # Errors
/// The reason, if the message is malformed, or has another type, encoding or size.
pub fn picture(kind: &str, bytes: &[u8], size: Option<(u32, u32)>) -> Result<Picture, String> {
    let found = match kind {
        IMAGE => raw(bytes, size)?,
        COMPRESSED => compressed(bytes, size)?,
        other => {
            return Err(format!(
                "the topic has messages of the type {}: sensor_msgs/msg/Image or \
                 sensor_msgs/msg/CompressedImage are read",
                shortened(other)
            ));
        }
    };
    Ok(found)
}

/// Checks the size of a picture (px) against the wanted one.
fn check_size(found: (u32, u32), wanted: Option<(u32, u32)>) -> Result<(), String> {
    let ((width, height), range) = (found, 1..=LARGEST_SIDE);
    if !range.contains(&width) || !range.contains(&height) {
        return Err(format!("a picture of {width}x{height} px is outside 1 to {LARGEST_SIDE} px"));
    }
    match wanted {
        Some((w, h)) if wanted != Some(found) => Err(format!(
            "the picture has {width}x{height} px, but the camera of the scenario has {w}x{h} px"
        )),
        _ => Ok(()),
    }
}

/// Decodes a `sensor_msgs/Image`.
fn raw(bytes: &[u8], size: Option<(u32, u32)>) -> Result<Picture, String> {
    let mut reader = Reader::new(bytes).map_err(malformed)?;
    let mut head = || {
        let (time, _frame) = reader.header()?;
        let (height, width) = (reader.u32()?, reader.u32()?);
        // The byte order is of no meaning for pixels of 8 bits a channel.
        let (encoding, _big_endian, step) = (reader.string()?, reader.u8()?, reader.u32()?);
        Ok((time, (width, height), encoding, step as usize, reader.u8_sequence()?))
    };
    let (time, found, encoding, step, data) = head().map_err(malformed)?;
    let channels = Channels::of(encoding)?;
    check_size(found, size)?;
    let (width, height) = (found.0 as usize, found.1 as usize);
    let row = width * channels.bytes();
    if step < row {
        return Err(format!("a row of {step} bytes is shorter than its {row} bytes of pixels"));
    }
    // The last row may end with its pixels.
    let needed = step.checked_mul(height - 1).and_then(|rows| rows.checked_add(row));
    if needed.is_none_or(|needed| data.len() < needed) {
        return Err(format!(
            "the picture has {} bytes of pixels, fewer than its size needs",
            data.len()
        ));
    }
    let mut pixels = Vec::with_capacity(width * height * 3);
    for line in data.chunks(step).take(height) {
        match channels {
            Channels::Rgb => pixels.extend_from_slice(&line[..row]),
            Channels::Bgr => {
                pixels.extend(line[..row].chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]));
            }
            Channels::Mono => pixels.extend(line[..row].iter().flat_map(|grey| [*grey; 3])),
        }
    }
    let image = RgbImage::from_raw(found.0, found.1, pixels);
    image.map(|image| Picture { time, image }).ok_or_else(|| "the picture is too short".to_owned())
}

/// Decodes a `sensor_msgs/CompressedImage`.
fn compressed(bytes: &[u8], size: Option<(u32, u32)>) -> Result<Picture, String> {
    let mut reader = Reader::new(bytes).map_err(malformed)?;
    let mut head = || {
        let (time, _frame) = reader.header()?;
        // Some senders write the encoding of the raw picture here as well: the data tells.
        let _format = reader.string()?;
        Ok((time, reader.u8_sequence()?))
    };
    let (time, data) = head().map_err(malformed)?;
    let format = image::guess_format(data)
        .ok()
        .filter(|format| matches!(format, ImageFormat::Jpeg | ImageFormat::Png))
        .ok_or("the picture is neither a JPEG nor a PNG")?;
    let refused = |why: image::ImageError| format!("the picture cannot be decoded: {why}");
    // The size is in the head of the picture, so it is checked before the pixels are decoded.
    let head = ImageReader::with_format(Cursor::new(data), format);
    check_size(head.into_dimensions().map_err(refused)?, size)?;
    let mut limits = Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(LARGEST_SIDE), Some(LARGEST_SIDE));
    limits.max_alloc = Some(DECODER_MEMORY);
    let mut reader = ImageReader::with_format(Cursor::new(data), format);
    reader.limits(limits);
    Ok(Picture { time, image: reader.decode().map_err(refused)?.into_rgb8() })
}

/// Decodes a message of the type `kind`, which must be `sensor_msgs/msg/JointState`, to positions
/// of joints.
///
/// # Errors
/// The reason, if the message is malformed, has another type, or names and positions that do not
/// belong together.
pub fn joint_state(kind: &str, bytes: &[u8]) -> Result<JointState, String> {
    if kind != JOINTS {
        return Err(format!(
            "the topic has messages of the type {}: sensor_msgs/msg/JointState is read",
            shortened(kind)
        ));
    }
    let mut reader = Reader::new(bytes).map_err(malformed)?;
    let mut fields = || {
        reader.header()?;
        let names = reader.string_sequence()?;
        let positions = reader.f64_sequence()?;
        // Velocities and efforts are not followed, but a message that is cut off there is refused.
        reader.f64_sequence()?;
        reader.f64_sequence()?;
        Ok((names, positions))
    };
    let (names, positions) = fields().map_err(malformed)?;
    if names.len() > MOST_JOINTS {
        return Err(format!("the message has {} joints, at most {MOST_JOINTS}", names.len()));
    }
    if names.len() != positions.len() {
        return Err(format!(
            "the message has {} names of joints and {} positions: it must have one for each",
            names.len(),
            positions.len()
        ));
    }
    let names = names.into_iter().map(shortened);
    Ok(JointState { positions: names.zip(positions).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::cdr::Writer;

    /// Encodes a `sensor_msgs/Image` with rows of `step` bytes.
    fn image(encoding: &str, (width, height): (u32, u32), step: u32, data: &[u8]) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.header(1_500_000_007, "camera");
        writer.u32(height);
        writer.u32(width);
        writer.string(encoding);
        writer.u8(0);
        writer.u32(step);
        writer.u8_sequence(data);
        writer.bytes()
    }

    /// Encodes a `sensor_msgs/CompressedImage`.
    fn packed(data: &[u8]) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.header(9, "");
        writer.string("rgb8; jpeg compressed bgr8");
        writer.u8_sequence(data);
        writer.bytes()
    }

    /// Encodes a `sensor_msgs/JointState`.
    fn joints(names: &[&str], positions: &[f64]) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.header(9, "");
        writer.string_sequence(names);
        writer.f64_sequence(positions);
        writer.f64_sequence(&[]);
        writer.f64_sequence(&[]);
        writer.bytes()
    }

    /// Returns a picture as a file.
    fn file(format: ImageFormat) -> Vec<u8> {
        let mut bytes = Vec::new();
        let picture = RgbImage::from_pixel(8, 4, image::Rgb([250, 20, 20]));
        picture.write_to(&mut Cursor::new(&mut bytes), format).unwrap();
        bytes
    }

    #[test]
    fn pixels_of_each_encoding_are_read() {
        // Rows have a byte of padding each; the last one needs none.
        let rgb = image("rgb8", (1, 2), 4, &[1, 2, 3, 0, 4, 5, 6]);
        let found = picture(IMAGE, &rgb, Some((1, 2))).unwrap();
        assert_eq!(
            (found.time, found.image.as_raw().as_slice()),
            (1_500_000_007, &[1, 2, 3, 4, 5, 6][..])
        );
        let bgr = picture(IMAGE, &image("bgr8", (1, 1), 3, &[1, 2, 3]), None).unwrap();
        assert_eq!(bgr.image.as_raw(), &[3, 2, 1]);
        let mono = picture(IMAGE, &image("mono8", (2, 1), 2, &[7, 8]), None).unwrap();
        assert_eq!(mono.image.as_raw(), &[7, 7, 7, 8, 8, 8]);
    }

    #[test]
    fn compressed_pictures_are_read() {
        for format in [ImageFormat::Jpeg, ImageFormat::Png] {
            let kind = COMPRESSED;
            let found = picture(kind, &packed(&file(format)), Some((8, 4))).unwrap();
            let pixel = found.image.get_pixel(7, 3).0;
            assert!(pixel[0] > 240 && pixel[1] < 40, "{pixel:?}");
            let why = picture(kind, &packed(&file(format)), Some((4, 8))).unwrap_err();
            assert!(why.contains("8x4 px, but the camera of the scenario has 4x8"), "{why}");
        }
    }

    #[test]
    fn wrong_pictures_are_refused_with_reason() {
        let why = |kind: &str, bytes: &[u8]| picture(kind, bytes, Some((2, 2))).unwrap_err();
        let data = [0; 12];

        assert!(why(IMAGE, &image("16UC1", (2, 2), 4, &data)).contains("only rgb8, bgr8"));
        assert!(why(IMAGE, &image("rgb8", (2, 3), 6, &[0; 18])).contains("2x3 px, but"));
        assert!(why(IMAGE, &image("rgb8", (2, 2), 5, &data)).contains("a row of 5 bytes"));
        assert!(why(IMAGE, &image("rgb8", (2, 2), 6, &data[..11])).contains("fewer than"));
        assert!(why(IMAGE, &image("rgb8", (2, 2), u32::MAX, &data)).contains("fewer than"));
        assert!(why("std_msgs/msg/String", &[]).contains("the type std_msgs/msg/String"));
        assert!(why(COMPRESSED, &packed(b"GIF89a")).contains("neither"));
        let huge = image("mono8", (u32::MAX, u32::MAX), u32::MAX, &[]);
        assert!(picture(IMAGE, &huge, None).unwrap_err().contains("outside 1 to 16384"));
        let empty = image("mono8", (0, 0), 0, &[]);
        assert!(picture(IMAGE, &empty, None).unwrap_err().contains("outside 1 to 16384"));
    }

    /// A message that ends at any byte is refused, and so is one whose lengths are wrong.
    #[test]
    fn messages_of_every_length_are_refused() {
        let state = joints(&["a", "bc"], &[1.0, -2.0]);
        let wanted = vec![("a".to_owned(), 1.0), ("bc".to_owned(), -2.0)];
        let kind = JOINTS;
        assert_eq!(joint_state(kind, &state).unwrap().positions, wanted);
        for length in 0..state.len() {
            assert!(joint_state(kind, &state[..length]).is_err(), "{length}");
        }
        let raw = image("rgb8", (2, 2), 6, &[0; 12]);
        for length in 0..raw.len() {
            assert!(picture(IMAGE, &raw[..length], None).is_err(), "{length}");
        }
        let compressed = packed(&file(ImageFormat::Png));
        for length in 0..compressed.len() {
            let cut = &compressed[..length];
            assert!(picture(COMPRESSED, cut, None).is_err(), "{length}");
        }
        // Each byte becomes the largest one: no length may reserve memory that is not there.
        for (kind, whole) in [(kind, state), (IMAGE, raw)] {
            for at in 0..whole.len() {
                let mut damaged = whole.clone();
                damaged[at] = 0xff;
                let _ = joint_state(kind, &damaged);
                let _ = picture(kind, &damaged, None);
            }
        }
    }

    #[test]
    fn joints_without_positions_are_refused() {
        let kind = JOINTS;
        let why = joint_state(kind, &joints(&["a", "b"], &[1.0])).unwrap_err();
        assert!(why.contains("2 names of joints and 1 positions"), "{why}");
        let many = vec!["a"; 257];
        let why = joint_state(kind, &joints(&many, &[0.0; 257])).unwrap_err();
        assert!(why.contains("257 joints, at most 256"), "{why}");
        assert!(joint_state(IMAGE, &joints(&[], &[])).unwrap_err().contains("of the type"));
    }
}
