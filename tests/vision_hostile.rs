//! Tests of the decoder and of vision with hostile pictures: none panics, hangs or takes unbounded
//! memory.
//!
//! - in: bytes that are no picture, pictures with corruptions, pictures that are hard for vision
//! - out: checks of the limits, and of the ranges of results
//!
//! `HOSTILE_CASES=20000 PROPTEST_RNG_SEED=$RANDOM cargo test --release --test vision_hostile`
//! searches longer, and so does `HOSTILE_SECONDS=60`. The search writes an input that fails into
//! the corpus.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

use image::{DynamicImage, ImageFormat, Rgb, RgbImage};
use nalgebra::Matrix3;
use proptest::prelude::*;
use rubik_robot::hw::image_file::decode;
use rubik_robot::vision::homography::apply;
use rubik_robot::vision::paper::{Filters, Stages};
use rubik_robot::vision::{DetectorSettings, Lens, Method, Rect, detect, locate_in};
use search::Input;
use std::path::PathBuf;
use std::time::Duration;

mod memory;
mod search;

/// Memory for an input whose header announces a small picture, or none (bytes).
const SMALL: usize = 64 << 20;
/// Memory for any input (bytes): fifty million pixels of eight bytes, and their conversion to
/// three.
const LARGE: usize = 700 << 20;
/// Time that a picture of less than a million pixels may take, on a machine with other work.
const TIME: Duration = Duration::from_secs(5);
/// Time after which the watchdog ends the process. It is longer than [`TIME`], so that the search
/// can shrink an input that is only slow before it reports it.
const HANGS: Duration = Duration::from_secs(60);

/// Runs `read` and fails if it takes `memory` bytes or [`TIME`]. `what` names the input in the
/// failure.
fn limited(what: &str, memory: usize, read: impl FnOnce()) {
    limited_to(Input::by_name(what), what, memory, read);
}

/// Does the same as [`limited`]; `told` is the input that is reported if `read` hangs.
fn limited_to(told: Input, what: &str, memory: usize, read: impl FnOnce()) {
    let (taken, time) = search::watched(told, HANGS, read);
    assert!(taken < memory, "{what}: {taken} bytes of memory");
    assert!(time < TIME, "{what}: {time:?}");
}

/// Runs all stages of vision on a picture and checks the ranges of their results.
fn look(image: &RgbImage) {
    let (width, height) = image.dimensions();
    let lens = Lens {
        focal: (600.0, 600.0),
        centre: (0.5 * f64::from(width), 0.5 * f64::from(height)),
        radial: [-0.1, 0.02, 0.0],
        tangential: [0.0, 0.0],
    };
    for method in [Method::Edges, Method::Paper2007, Method::Square2007] {
        let settings =
            DetectorSettings { method, least_confidence: 0.0, ..DetectorSettings::default() };
        if let Ok(faces) = detect(image, None, &settings) {
            for face in &faces {
                assert!((0.0..=1.0).contains(&face.confidence), "{face:?}");
                assert!(face.confidences.iter().all(|c| (0.0..=1.0).contains(c)), "{face:?}");
                assert!(face.colours.iter().all(|c| *c < 6));
                assert!(face.centres.iter().all(|c| c.0.is_finite() && c.1.is_finite()));
            }
            if let Some(cube) = locate_in(image, &faces, lens, 0.057, None) {
                assert!(cube.camera_from_cube.translation.vector.iter().all(|v| v.is_finite()));
            }
        }
        let window = Rect { x: width / 3, y: height / 4, width: u32::MAX, height: height / 2 };
        let _ = detect(image, Some(window), &settings);
    }
    let stages = Stages::run(image.as_raw(), width as usize, height as usize, &Filters::default());
    let _ = stages.square();
}

/// Decodes `bytes`, and runs vision on the picture if they are one. Fails if this takes `memory`
/// bytes or [`TIME`]. `what` names the input in the failure.
fn give(what: &str, bytes: &[u8], memory: usize) {
    give_to(Input::by_name(what), what, bytes, memory);
}

/// Does the same as [`give`]; `told` is the input that is reported if it hangs.
fn give_to(told: Input, what: &str, bytes: &[u8], memory: usize) {
    limited_to(told, what, memory, || {
        if let Ok(image) = decode(bytes) {
            assert!(image.width() > 0 && image.height() > 0);
            if image.len() < 3_000_000 {
                look(&image);
            }
        }
    });
}

/// Returns the bytes of a file with this picture.
fn file(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut out, format).unwrap();
    out.into_inner()
}

/// Returns a picture, as small as possible, of a face with nine tiles in front of a background.
fn face() -> RgbImage {
    const COLOURS: [[u8; 3]; 6] =
        [[230; 3], [180, 20, 40], [10, 150, 70], [240, 205, 20], [245, 100, 20], [15, 70, 165]];
    RgbImage::from_fn(72, 64, |x, y| {
        let (u, v) = (x as i32 - 10, y as i32 - 8);
        if !(0..48).contains(&u) || !(0..48).contains(&v) {
            return Rgb([96, 92, 84]);
        }
        let inside = (2..14).contains(&(u % 16)) && (2..14).contains(&(v % 16));
        let colour = if inside { COLOURS[((u / 16) * 2 + v / 16) as usize % 6] } else { [12; 3] };
        // A little noise, because tiles without any are taken for a program's painting.
        let noise = ((7 * x + 13 * y) % 5) as u8;
        Rgb(colour.map(|level| level + noise))
    })
}

/// Returns pictures in all formats that the decoder accepts.
fn pictures() -> Vec<Vec<u8>> {
    let face = DynamicImage::from(face());
    let mut all = vec![
        file(&face, ImageFormat::Png),
        file(&face, ImageFormat::Jpeg),
        file(&face.to_luma8().into(), ImageFormat::Png),
        file(&face.to_luma8().into(), ImageFormat::Jpeg),
        file(&face.to_rgb16().into(), ImageFormat::Png),
        file(&face.to_rgba8().into(), ImageFormat::Png),
        file(&face.to_rgba16().into(), ImageFormat::Png),
        file(&face.to_luma_alpha16().into(), ImageFormat::Png),
        file(&DynamicImage::new_rgb8(1, 1), ImageFormat::Png),
        file(&DynamicImage::new_rgb8(1, 1), ImageFormat::Jpeg),
    ];
    // One row of pixels of one bit, with a palette of two colours.
    let mut palette = b"\x89PNG\r\n\x1a\n".to_vec();
    for (name, data) in [
        (b"IHDR", &[0, 0, 0, 8, 0, 0, 0, 1, 1, 3, 0, 0, 0][..]),
        (b"PLTE", &[0, 0, 0, 255, 255, 255]),
        (b"tRNS", &[9]),
        (b"IDAT", &[0x78, 0x01, 0x01, 2, 0, 0xFD, 0xFF, 0, 0xA5, 0, 0xA6, 0, 0xA6]),
        (b"IEND", &[]),
    ] {
        palette.extend((data.len() as u32).to_be_bytes());
        palette.extend(name);
        palette.extend(data);
        palette.extend([0; 4]);
    }
    all.push(mended(palette));
    all
}

/// Corrects the checksums of a PNG file. Otherwise the decoder would stop at the first checksum
/// after a corruption.
fn mended(mut bytes: Vec<u8>) -> Vec<u8> {
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 4) {
        let length = u32::from_be_bytes(head.try_into().unwrap()) as usize;
        let end = at.saturating_add(8).saturating_add(length);
        let Some(body) = bytes.get(at + 4..end) else { break };
        let sum = crc32fast::hash(body).to_be_bytes();
        let Some(place) = bytes.get_mut(end..end + 4) else { break };
        place.copy_from_slice(&sum);
        at = end + 4;
    }
    bytes
}

#[test]
fn uncorrupted_test_pictures_decode_without_error() {
    for (i, picture) in pictures().iter().enumerate() {
        assert!(decode(picture).is_ok(), "{i}: {:?}", decode(picture));
        give("whole", picture, SMALL);
    }
    assert_eq!(detect(&face(), None, &DetectorSettings::default()).unwrap().len(), 1);
}

#[test]
fn false_size_in_header_takes_no_excess_memory() {
    let small = file(&face().into(), ImageFormat::Png);
    for (width, height) in
        [(0, 0), (0, 5), (1, u32::MAX), (u32::MAX, u32::MAX), (20_000, 20_000), (50_000, 1000)]
    {
        // Bits of a sample and type of the colours; the last pair is invalid.
        for depth in [[8, 2], [16, 6], [1, 0], [16, 4], [8, 3], [9, 9]] {
            let mut bytes = small.clone();
            bytes[16..20].copy_from_slice(&u32::to_be_bytes(width));
            bytes[20..24].copy_from_slice(&u32::to_be_bytes(height));
            bytes[24..26].copy_from_slice(&depth);
            let bytes = mended(bytes);

            let most = if width == 50_000 { LARGE } else { SMALL };
            limited(&format!("{width}x{height} {depth:?}"), most, || {
                assert!(decode(&bytes).is_err());
            });
        }
    }
    // A JPEG file has its size in the frame header.
    let mut jpeg = file(&face().into(), ImageFormat::Jpeg);
    let frame = jpeg.windows(2).position(|w| w == [0xFF, 0xC0]).unwrap();
    jpeg[frame + 5..frame + 9].fill(0xFF);
    limited("jpeg", SMALL, || assert!(decode(&jpeg).is_err()));
}

#[test]
fn truncated_picture_does_not_panic() {
    for picture in pictures() {
        for end in (0..picture.len()).step_by(1 + picture.len() / 60) {
            give("cut", &picture[..end], SMALL);
        }
    }
}

/// Corruption of a file at a byte. Its number is taken modulo the file's length plus one.
#[derive(Debug, Clone)]
enum Corruption {
    /// The file ends before the byte.
    Cut(usize),
    /// The byte has another value.
    Set(usize, u8),
    /// These bits of the byte are flipped.
    Flip(usize, u8),
    /// These bytes come before the byte.
    Insert(usize, Vec<u8>),
    /// This many bytes from the byte on are missing.
    Remove(usize, usize),
}

/// Returns a strategy for one to five corruptions.
fn corruptions() -> impl Strategy<Value = Vec<Corruption>> {
    let at = 0..100_000usize;
    let one = prop_oneof![
        1 => at.clone().prop_map(Corruption::Cut),
        3 => (at.clone(), any::<u8>()).prop_map(|(at, byte)| Corruption::Set(at, byte)),
        3 => (at.clone(), 0..8u8).prop_map(|(at, bit)| Corruption::Flip(at, 1 << bit)),
        1 => (at.clone(), proptest::collection::vec(any::<u8>(), 1..20))
            .prop_map(|(at, bytes)| Corruption::Insert(at, bytes)),
        1 => (at, 1..50usize).prop_map(|(at, n)| Corruption::Remove(at, n)),
    ];
    proptest::collection::vec(one, 1..6)
}

/// Returns the bytes of a file after these corruptions, one after the other.
fn corrupted(mut bytes: Vec<u8>, corruptions: &[Corruption]) -> Vec<u8> {
    for corruption in corruptions {
        let place = |at: usize| at % (bytes.len() + 1);
        match corruption {
            Corruption::Cut(at) => bytes.truncate(place(*at)),
            Corruption::Set(at, byte) => {
                let at = place(*at);
                bytes.splice(at..(at + 1).min(bytes.len()), [*byte]);
            }
            Corruption::Flip(at, bits) => {
                let at = place(*at);
                bytes.iter_mut().skip(at).take(1).for_each(|b| *b ^= bits);
            }
            Corruption::Insert(at, more) => {
                let at = place(*at);
                bytes.splice(at..at, more.iter().copied());
            }
            Corruption::Remove(at, n) => {
                let at = place(*at);
                bytes.drain(at..(at + n).min(bytes.len()));
            }
        }
    }
    bytes
}

/// Returns the files of the corpus: pictures that failed once, and similar ones.
fn corpus() -> Vec<Vec<u8>> {
    let folder = [env!("CARGO_MANIFEST_DIR"), "tests/corpus/image"].iter().collect::<PathBuf>();
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    assert!(files.len() >= 5, "the corpus is small");
    files.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

#[test]
fn corrupted_picture_bytes_do_not_panic() {
    let mut all = corpus();
    for bytes in &all {
        give("corpus", bytes, LARGE);
    }
    all.extend(pictures());
    let random = proptest::collection::vec(any::<u8>(), 0..400);
    let of_picture =
        (0..all.len(), corruptions(), any::<bool>()).prop_map(move |(i, corruptions, mend)| {
            let bytes = corrupted(all[i].clone(), &corruptions);
            if mend && bytes.starts_with(b"\x89PNG") { mended(bytes) } else { bytes }
        });
    let inputs = prop_oneof![1 => random, 9 => of_picture];
    search::search("image", 400, &inputs, Clone::clone, |bytes| {
        let own = bytes.clone();
        give_to(Input::generated("image", move || own.clone()), "spoilt", &bytes, LARGE);
    });
}

/// Picture that is full of areas which look like tiles: lattices on top of each other, in any
/// perspective, also beyond the horizon.
#[derive(Debug, Clone)]
struct Hard {
    /// Width and height (px).
    size: (u32, u32),
    /// Homography from the lattice to the picture (by rows), side of a tile in 255ths of the pitch,
    /// and seed of the colours.
    lattices: Vec<([f64; 9], u8, u64)>,
}

impl Hard {
    /// Returns the picture.
    fn draw(&self) -> RgbImage {
        let maps: Vec<(Matrix3<f64>, f64, u64)> = self
            .lattices
            .iter()
            .filter_map(|(h, share, seed)| {
                let h = Matrix3::from_row_slice(h).try_inverse()?;
                Some((h, f64::from(*share) / 255.0, *seed))
            })
            .collect();
        RgbImage::from_fn(self.size.0, self.size.1, |x, y| {
            let mut pixel = [90; 3];
            for (h, share, seed) in &maps {
                let (u, v) = apply(h, (f64::from(x), f64::from(y)));
                let (a, b) = (u - u.round(), v - v.round());
                if u.is_finite() && v.is_finite() && a.abs().max(b.abs()) < 0.5 * share {
                    let cell =
                        (u.round() as i64).wrapping_mul(31) ^ (v.round() as i64) ^ *seed as i64;
                    let mixed = (cell as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
                    pixel = [(mixed >> 56) as u8, (mixed >> 48) as u8, (mixed >> 40) as u8];
                }
            }
            Rgb(pixel)
        })
    }
}

#[test]
fn random_lattice_pictures_do_not_panic_or_hang() {
    let lattice = (
        (2.0..60.0f64, -20.0..20.0f64, -50.0..300.0f64),
        (-20.0..20.0f64, 2.0..60.0f64, -50.0..300.0f64),
        (-0.3..0.3f64, -0.3..0.3f64),
        any::<u8>(),
        any::<u64>(),
    )
        .prop_map(|(a, b, c, share, seed)| {
            ([a.0, a.1, a.2, b.0, b.1, b.2, c.0, c.1, 1.0], share, seed)
        });
    let hard = ((1u32..240, 1u32..240), proptest::collection::vec(lattice, 1..4))
        .prop_map(|(size, lattices)| Hard { size, lattices });
    // The corpus keeps an input that fails as a picture.
    let written = |hard: &Hard| file(&hard.draw().into(), ImageFormat::Png);
    search::search("image", 150, &hard, written, |hard| {
        let own = hard.clone();
        let told = Input::generated("image", move || file(&own.draw().into(), ImageFormat::Png));
        limited_to(told, &format!("{hard:?}"), SMALL, || look(&hard.draw()));
    });
}

#[test]
fn vision_of_chessboards_and_noise_ends_in_time() {
    for pitch in [1, 2, 3, 5, 8, 13] {
        let board = RgbImage::from_fn(960, 720, |x, y| {
            let odd = (x / pitch + y / pitch) % 2 == 1;
            Rgb(if odd { [200, 60, 40] } else { [30, 40, 120] })
        });
        limited(&format!("board of {pitch} px"), 4 * SMALL, || look(&board));
    }
    let noise = RgbImage::from_fn(960, 720, |x, y| {
        let mixed = u64::from(x * 7919 + y * 104_729).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        Rgb([(mixed >> 56) as u8, (mixed >> 48) as u8, (mixed >> 40) as u8])
    });
    limited("noise", 4 * SMALL, || look(&noise));
}

#[test]
fn method_of_2007_bounds_memory_on_large_picture() {
    // The lock comes before the picture, because the memory allows one of this size at a time.
    let _alone = memory::lock_process();
    let (width, height) = (8000usize, 6000usize);
    let mut state = 1u64;
    let noise: Vec<u8> = (0..3 * width * height)
        .map(|_| {
            state = state.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(0x1234_5678_9ABC_DEF1);
            (state >> 56) as u8
        })
        .collect();

    let taken = memory::most_held(|| {
        let stages = Stages::run(&noise, width, height, &Filters::default());
        let _ = stages.square();
    });

    assert!(taken < 4 * SMALL, "{taken} bytes of memory");
}
