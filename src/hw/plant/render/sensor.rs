//! The sensor: linear colours -> mosaic, noise, 8 bits, demosaicing.
//!
//! - in: linear colours (1 = full scale at the nominal exposure), the row's random offset
//! - out: an RGB picture
//!
//! Noise is drawn once as a long list of Gaussian numbers; each row of each frame reads it from a random place.
//! It is added to the coded value, where its size was measured. Values carry four more bits than the picture.

use super::look::{Rgb, Sensor};
use image::RgbImage;
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// One in the stored values.
const ONE: i16 = 16;
/// Full scale of the stored values.
const FULL: i16 = 255 * ONE;
/// Steps of a linear signal in the table of codes.
const STEPS: usize = 4096;
/// Length of the list of noise.
const NOISE: usize = 1 << 17;

/// Tables of a sensor, made once.
#[derive(Debug, Clone)]
pub(super) struct Converter {
    /// Coded value of a linear signal.
    code: Vec<i16>,
    /// Standard deviation of the noise in eighths, by coded value of 255.
    deviation: [i16; 256],
    /// Gaussian numbers in 32nds.
    noise: Vec<i16>,
    pub(super) bayer: bool,
}

impl Converter {
    pub(super) fn new(sensor: &Sensor, seed: u64) -> Self {
        let code = (0..=STEPS)
            .map(|k| {
                let signal = k as f64 / STEPS as f64;
                (libm::pow(signal, 1.0 / sensor.gamma) * f64::from(FULL)).round() as i16
            })
            .collect();
        let deviation = std::array::from_fn(|v| {
            let shot = sensor.shot_noise.powi(2) * v as f64 / 255.0;
            (8.0 * libm::sqrt(sensor.read_noise.powi(2) + shot)).min(200.0).round() as i16
        });
        let mut rng = Pcg64::seed_from_u64(seed);
        let noise = (0..NOISE)
            .map(|_| {
                let n: f64 = StandardNormal.sample(&mut rng);
                (n * 32.0).round().clamp(-160.0, 160.0) as i16
            })
            .collect();
        Self { code, deviation, noise, bayer: sensor.bayer }
    }

    /// Values a pixel in the raw picture.
    pub(super) fn channels(&self) -> usize {
        if self.bayer { 1 } else { 3 }
    }

    /// Coded value of a linear signal.
    #[inline(always)]
    pub(super) fn code(&self, signal: f32) -> i16 {
        self.code[((signal * STEPS as f32 + 0.5) as usize).min(STEPS)]
    }

    /// Stores a pixel's colour, times `gain`, in raw picture and table of noise.
    #[inline(always)]
    pub(super) fn put(&self, raw: &mut Raw, row: usize, column: usize, colour: Rgb, gain: f32) {
        let pixel = row * raw.width + column;
        if self.bayer {
            let ends = if row & 1 == 0 { colour[0] } else { colour[2] };
            let signal = if (row + column) & 1 == 0 { ends } else { colour[1] };
            let value = self.code(signal * gain);
            raw.value[pixel] = value;
            raw.deviation[pixel] = self.deviation[(value / ONE) as usize];
        } else {
            for (c, channel) in colour.iter().enumerate() {
                let value = self.code(channel * gain);
                raw.value[3 * pixel + c] = value;
                raw.deviation[3 * pixel + c] = self.deviation[(value / ONE) as usize];
            }
        }
    }

    /// Adds noise and makes the picture.
    pub(super) fn develop(&self, raw: &mut Raw, rng: &mut Pcg64) -> RgbImage {
        let stride = raw.width * self.channels();
        for (values, deviations) in
            raw.value.chunks_exact_mut(stride).zip(raw.deviation.chunks_exact(stride))
        {
            let start = rng.random_range(0..NOISE - stride);
            let noise = &self.noise[start..start + stride];
            for ((value, deviation), noise) in values.iter_mut().zip(deviations).zip(noise) {
                // 1/32 times 1/8 times ONE.
                let noisy = *value + ((noise * deviation + 8) >> 4);
                *value = noisy.clamp(0, FULL);
            }
        }
        if self.bayer { demosaic(raw) } else { plain(raw) }
    }
}

/// A picture before demosaicing, with the noise that it will get.
#[derive(Debug, Clone, Default)]
pub(super) struct Raw {
    width: usize,
    height: usize,
    value: Vec<i16>,
    deviation: Vec<i16>,
}

impl Raw {
    pub(super) fn new(width: usize, height: usize, channels: usize) -> Self {
        let size = width * height * channels;
        Self { width, height, value: vec![0; size], deviation: vec![0; size] }
    }

    /// Becomes a copy of another of the same size.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.value.copy_from_slice(&other.value);
        self.deviation.copy_from_slice(&other.deviation);
    }
}

fn plain(raw: &Raw) -> RgbImage {
    let pixels = raw.value.iter().map(|v| ((v + ONE / 2) / ONE) as u8).collect();
    RgbImage::from_raw(raw.width as u32, raw.height as u32, pixels).unwrap_or_default()
}

/// Bilinear interpolation of an RGGB mosaic; borders mirror.
fn demosaic(raw: &Raw) -> RgbImage {
    let (w, h) = (raw.width, raw.height);
    let mut pixels = vec![0_u8; w * h * 3];
    let eight = |sum: i16, shift: i16| ((sum + (ONE / 2 << shift)) >> (4 + shift)).min(255) as u8;
    // A row with one mirrored pixel on either side.
    let padded = |row: usize, line: &mut Vec<i16>| {
        let values = &raw.value[row * w..(row + 1) * w];
        line.clear();
        line.push(values[1.min(w - 1)]);
        line.extend_from_slice(values);
        line.push(values[w.max(2) - 2]);
    };
    let mut lines =
        [Vec::with_capacity(w + 2), Vec::with_capacity(w + 2), Vec::with_capacity(w + 2)];
    for row in 0..h {
        let above = if row == 0 { 1.min(h - 1) } else { row - 1 };
        let below = if row + 1 == h { h.max(2) - 2 } else { row + 1 };
        for (line, source) in lines.iter_mut().zip([above, row, below]) {
            padded(source, line);
        }
        let [up, mid, down] = &lines;
        let (up, mid, down) = (&up[..w + 2], &mid[..w + 2], &down[..w + 2]);
        // Red and green rows alternate with green and blue rows; `own` is the row's own colour.
        let (own, other) = if row & 1 == 0 { (0, 2) } else { (2, 0) };
        let out = &mut pixels[row * w * 3..(row + 1) * w * 3];
        for (column, rgb) in out.chunks_exact_mut(3).enumerate() {
            let k = column + 1;
            let vertical = up[k] + down[k];
            let horizontal = mid[k - 1] + mid[k + 1];
            if (row + column) & 1 == 0 {
                let diagonal = up[k - 1] + up[k + 1] + (down[k - 1] + down[k + 1]);
                rgb[own] = eight(mid[k], 0);
                rgb[1] = eight(vertical + horizontal, 2);
                rgb[other] = eight(diagonal, 2);
            } else {
                rgb[own] = eight(horizontal, 1);
                rgb[1] = eight(mid[k], 0);
                rgb[other] = eight(vertical, 1);
            }
        }
    }
    RgbImage::from_raw(w as u32, h as u32, pixels).unwrap_or_default()
}
