//! Pixels of a webcam's buffer as RGB.
//!
//! - in: the bytes of a buffer, and the format of the stream
//! - out: the picture; or the reason why the bytes are none
//! - source: ITU-R BT.601, the matrix of both encodings

use super::device::{Encoding, Format, name_of};
use crate::hw::image_file::decode_frame;
use image::{Rgb, RgbImage};

/// Converts the bytes of a buffer to a picture.
///
/// # Errors
/// The reason why the bytes are no picture of this format.
pub fn picture(bytes: &[u8], format: &Format) -> Result<RgbImage, String> {
    match Encoding::of(format.code) {
        Some(Encoding::Yuyv) => yuyv(bytes, format),
        Some(Encoding::Mjpeg) => mjpeg(bytes, format),
        None => Err(format!("its format is {}, which is not read", name_of(format.code))),
    }
}

/// Decodes a JPEG picture, which must have the size of the stream.
fn mjpeg(bytes: &[u8], format: &Format) -> Result<RgbImage, String> {
    let image = decode_frame(bytes).map_err(|why| why.to_string())?;
    if image.dimensions() != format.size {
        let ((width, height), (w, h)) = (image.dimensions(), format.size);
        return Err(format!("a picture of {width}x{height} px in a stream of {w}x{h} px"));
    }
    Ok(image)
}

/// Converts lines of `Y0 U Y1 V`: two pixels with one colour.
fn yuyv(bytes: &[u8], format: &Format) -> Result<RgbImage, String> {
    let (width, height) = (format.size.0 as usize, format.size.1 as usize);
    // A line holds pairs of pixels.
    let used = 4 * width.div_ceil(2);
    // A driver that pads its lines says so. Without its word the lines have no padding.
    let stride = if format.stride == 0 { used } else { format.stride };
    // The last line may lack its padding.
    let least = stride.saturating_mul(height.saturating_sub(1)).saturating_add(used);
    if width == 0 || height == 0 || stride < used || bytes.len() < least {
        return Err(format!(
            "{} bytes are too few for {width}x{height} px of YUYV with {stride} bytes a line",
            bytes.len()
        ));
    }
    let mut image = RgbImage::new(format.size.0, format.size.1);
    for (line, row) in bytes.chunks(stride).zip(image.rows_mut()) {
        for (pixel, (x, four)) in row.zip((0..width).map(|x| (x, &line[4 * (x / 2)..]))) {
            *pixel = rgb([four[2 * (x % 2)], four[1], four[3]], format.full_range);
        }
    }
    Ok(image)
}

/// Converts brightness and the two differences of colour to RGB.
fn rgb([y, u, v]: [u8; 3], full_range: bool) -> Rgb<u8> {
    // Levels of the limited range are 16 to 235, and 16 to 240 for the colours.
    let (offset, bright, colour) =
        if full_range { (0.0, 1.0, 1.0) } else { (16.0, 255.0 / 219.0, 255.0 / 224.0) };
    let y = bright * (f32::from(y) - offset);
    let (u, v) = (colour * (f32::from(u) - 128.0), colour * (f32::from(v) - 128.0));
    let level = |value: f32| value.round().clamp(0.0, 255.0) as u8;
    Rgb([level(y + 1.402 * v), level(y - 0.344_136 * u - 0.714_136 * v), level(y + 1.772 * u)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::jpeg::tests::{encoded, without_huffman_tables};
    use crate::hw::webcam::testing::yuyv_of;

    /// Returns a format of these columns and rows.
    fn format(encoding: Encoding, size: (u32, u32), stride: usize) -> Format {
        Format { code: encoding.code(), size, stride, full_range: true }
    }

    /// Each pair of pixels has one colour, so that the conversion loses nothing.
    fn coloured() -> RgbImage {
        RgbImage::from_fn(8, 5, |x, y| Rgb([30 * (x / 2) as u8 + 40, 40 * y as u8 + 20, 90]))
    }

    /// Checks that two pictures differ by rounding at most.
    fn assert_near(one: &RgbImage, other: &RgbImage) {
        assert_eq!(one.dimensions(), other.dimensions());
        for (a, b) in one.as_raw().iter().zip(other.as_raw()) {
            assert!(a.abs_diff(*b) <= 3, "{a} {b}");
        }
    }

    #[test]
    fn yuyv_lines_longer_than_picture_are_read() {
        let picture_of = |stride, full_range| {
            let format = Format { full_range, ..format(Encoding::Yuyv, (8, 5), stride) };
            picture(&yuyv_of(&coloured(), stride.max(16), full_range), &format).unwrap()
        };

        assert_near(&picture_of(16, true), &coloured());
        assert_near(&picture_of(0, true), &coloured());
        assert_near(&picture_of(28, true), &coloured());
        assert_near(&picture_of(28, false), &coloured());
    }

    #[test]
    fn limited_range_reaches_black_and_white() {
        assert_eq!(rgb([16, 128, 128], false).0, [0; 3]);
        assert_eq!(rgb([235, 128, 128], false).0, [255; 3]);
        assert_eq!(rgb([16, 128, 128], true).0, [16; 3]);
    }

    #[test]
    fn too_few_bytes_are_refused_with_their_number() {
        let bytes = yuyv_of(&coloured(), 28, true);
        let format = format(Encoding::Yuyv, (8, 5), 28);

        // The padding of the last line may be absent.
        assert!(picture(&bytes[..128], &format).is_ok());
        let why = picture(&bytes[..127], &format).unwrap_err();
        assert!(why.starts_with("127 bytes are too few for 8x5 px"), "{why}");
        assert!(picture(&[], &Format { size: (0, 0), ..format }).is_err());
        assert!(picture(&bytes, &Format { stride: 15, ..format }).is_err());
    }

    #[test]
    fn mjpeg_without_huffman_tables_is_read() {
        let stripped = without_huffman_tables(&encoded());
        let format = format(Encoding::Mjpeg, (48, 32), 0);

        assert_eq!(picture(&stripped, &format), picture(&encoded(), &format));
        assert!(picture(&stripped, &format).is_ok());
        let why = picture(&stripped, &Format { size: (64, 48), ..format }).unwrap_err();
        assert_eq!(why, "a picture of 48x32 px in a stream of 64x48 px");
        assert!(picture(&stripped[..300], &format).is_err());
        let unknown = Format { code: *b"H264", ..format };
        assert!(picture(&stripped, &unknown).unwrap_err().contains("H264"));
    }
}
