//! The sensor: linear colours -> mosaic, noise, 8 bits, demosaicing.
//!
//! - in: linear colours (1 = full scale at the nominal exposure), the row's random offset
//! - out: an RGB picture
//!
//! Noise is drawn once as a long list of Gaussian numbers; each row of each frame reads it from a random place.
//! It is added to the coded value, in whose units it is given. Values carry four more bits than the picture.

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

/// Returns the channel that a photosite of an RGGB mosaic sees: 0 red, 1 green, 2 blue.
#[inline]
fn mosaic(row: usize, column: usize) -> usize {
    match (row & 1, column & 1) {
        (0, 0) => 0,
        (1, 1) => 2,
        _ => 1,
    }
}

/// Tables of a sensor, made once.
#[derive(Debug, Clone)]
pub(super) struct Converter {
    /// Table by linear signal: the coded value, and the standard deviation of its noise in eighths.
    codes: Vec<(i16, i16)>,
    /// Gaussian numbers in 32nds.
    noise: Vec<i16>,
    pub(super) bayer: bool,
}

impl Converter {
    pub(super) fn new(sensor: &Sensor, seed: u64) -> Self {
        let deviation = |value: i16| {
            let shot = sensor.shot_noise.powi(2) * f64::from(value / ONE) / 255.0;
            (8.0 * libm::sqrt(sensor.read_noise.powi(2) + shot)).min(200.0).round() as i16
        };
        let codes = (0..=STEPS)
            .map(|k| {
                let signal = k as f64 / STEPS as f64;
                let coded = libm::pow(signal, 1.0 / sensor.gamma) * f64::from(FULL);
                let value = coded.round() as i16;
                (value, deviation(value))
            })
            .collect();
        let mut rng = Pcg64::seed_from_u64(seed);
        let noise = (0..NOISE)
            .map(|_| {
                let n: f64 = StandardNormal.sample(&mut rng);
                (n * 32.0).round().clamp(-160.0, 160.0) as i16
            })
            .collect();
        Self { codes, noise, bayer: sensor.bayer }
    }

    /// Values a pixel in the raw picture.
    pub(super) fn channels(&self) -> usize {
        if self.bayer { 1 } else { 3 }
    }

    /// Returns coded value and deviation of a linear signal.
    #[inline]
    fn code(&self, signal: f32) -> (i16, i16) {
        // By way of 32 bits, which one instruction converts to.
        let step = (signal * STEPS as f32 + 0.5) as i32;
        self.codes[step.clamp(0, STEPS as i32) as usize]
    }

    /// Stores a pixel's colour, times `gain`, in raw picture and table of noise.
    #[inline]
    pub(super) fn put(&self, raw: &mut Raw, site: Photosite, colour: Rgb, gain: f32) {
        let Photosite { row, column } = site;
        let pixel = row * raw.width + column;
        if self.bayer {
            let signal = colour[mosaic(row, column)];
            (raw.value[pixel], raw.deviation[pixel]) = self.code(signal * gain);
        } else {
            for (c, channel) in colour.iter().enumerate() {
                let at = 3 * pixel + c;
                (raw.value[at], raw.deviation[at]) = self.code(channel * gain);
            }
        }
    }

    /// Stores the colours of neighbours in a row, `site` and on, each times its `gain` and the
    /// exposure.
    #[inline]
    pub(super) fn put_run(
        &self,
        raw: &mut Raw,
        site: Photosite,
        colours: &[Rgb],
        (gains, exposure): (&[f32], f32),
    ) {
        let Photosite { row, column } = site;
        if !self.bayer {
            for (k, (colour, gain)) in colours.iter().zip(gains).enumerate() {
                let site = Photosite { row, column: column + k };
                self.put(raw, site, *colour, gain * exposure);
            }
            return;
        }
        let start = row * raw.width + column;
        let range = start..start + colours.len();
        let stored = raw.value[range.clone()].iter_mut().zip(&mut raw.deviation[range]);
        let [mut channel, mut next] = [column, column + 1].map(|column| mosaic(row, column));
        for ((value, deviation), (colour, gain)) in stored.zip(colours.iter().zip(gains)) {
            (*value, *deviation) = self.code(colour[channel] * (gain * exposure));
            std::mem::swap(&mut channel, &mut next);
        }
    }

    /// Adds noise and makes the picture; the raw picture stays as it is.
    pub(super) fn develop(&self, raw: &Raw, rng: &mut Pcg64) -> RgbImage {
        let (w, h) = (raw.width, raw.height);
        let mut pixels = vec![0_u8; w * h * 3];
        if self.bayer {
            self.demosaic(raw, rng, &mut pixels);
        } else {
            let mut line = vec![0; 3 * w];
            for (row, out) in pixels.chunks_exact_mut(3 * w).enumerate() {
                self.expose(raw, row, rng, &mut line);
                for (out, value) in out.iter_mut().zip(&line) {
                    *out = ((value + ONE / 2) / ONE) as u8;
                }
            }
        }
        RgbImage::from_raw(w as u32, h as u32, pixels).unwrap_or_default()
    }

    /// A row's values with noise.
    fn expose(&self, raw: &Raw, row: usize, rng: &mut Pcg64, line: &mut [i16]) {
        let stride = line.len();
        let range = row * stride..(row + 1) * stride;
        let start = rng.random_range(0..NOISE - stride);
        let noise = &self.noise[start..start + stride];
        let values = raw.value[range.clone()].iter().zip(&raw.deviation[range]);
        for ((noisy, (value, deviation)), noise) in line.iter_mut().zip(values).zip(noise) {
            // 1/32 times 1/8 times ONE.
            *noisy = (value + ((noise * deviation + 8) >> 4)).clamp(0, FULL);
        }
    }

    /// Bilinear interpolation of an RGGB mosaic; borders mirror.
    fn demosaic(&self, raw: &Raw, rng: &mut Pcg64, pixels: &mut [u8]) {
        let (w, h) = (raw.width, raw.height);
        // Three rows, each with a mirrored pixel on either side.
        let mut lines = [vec![0_i16; w + 2], vec![0; w + 2], vec![0; w + 2]];
        let mut fill = |row: usize, line: &mut Vec<i16>| {
            self.expose(raw, row, rng, &mut line[1..=w]);
            line[0] = line[2.min(w)];
            line[w + 1] = line[w.max(2) - 1];
        };
        let [up, mid, down] = &mut lines;
        fill(0, mid);
        if h > 1 {
            fill(1, down);
        }
        up.copy_from_slice(down);
        let mut packed = vec![0_u32; w];
        for (row, out) in pixels.chunks_exact_mut(3 * w).enumerate() {
            interpolate(row, up, mid, down, &mut packed);
            store(&packed, out);
            std::mem::swap(up, mid);
            std::mem::swap(mid, down);
            if row + 2 < h {
                fill(row + 2, down);
            } else {
                down.copy_from_slice(up);
            }
        }
    }
}

/// Pixels of a row as 0x00BBGGRR; the lines have one more value on either side.
fn interpolate(row: usize, up: &[i16], mid: &[i16], down: &[i16], packed: &mut [u32]) {
    let w = packed.len();
    let (u0, u1, u2) = (&up[..w], &up[1..=w], &up[2..w + 2]);
    let (m0, m1, m2) = (&mid[..w], &mid[1..=w], &mid[2..w + 2]);
    let (d0, d1, d2) = (&down[..w], &down[1..=w], &down[2..w + 2]);
    // Red and green rows alternate with green and blue rows; `own` is the row's own colour.
    let (own_shift, other_shift) = if row & 1 == 0 { (0, 16) } else { (16, 0) };
    for k in 0..w {
        let vertical = u1[k] + d1[k];
        let horizontal = m0[k] + m2[k];
        let diagonal = u0[k] + u2[k] + (d0[k] + d2[k]);
        let here = (m1[k] + 8) >> 4;
        // All ones where the photosite has the row's own colour.
        let site = -(((k + row + 1) & 1) as i16);
        let pick = |a: i16, b: i16| ((a & site) | (b & !site)) as u32;
        let own = pick(here, (horizontal + 16) >> 5);
        let green = pick((vertical + horizontal + 32) >> 6, here);
        let other = pick((diagonal + 32) >> 6, (vertical + 16) >> 5);
        packed[k] = own << own_shift | green << 8 | other << other_shift;
    }
}

/// Stores packed pixels as three bytes each, four at a time.
fn store(packed: &[u32], out: &mut [u8]) {
    for (p, out) in packed.chunks(4).zip(out.chunks_mut(12)) {
        if let ([a, b, c, d], 12) = (p, out.len()) {
            out[0..4].copy_from_slice(&(a | b << 24).to_le_bytes());
            out[4..8].copy_from_slice(&(b >> 8 | c << 16).to_le_bytes());
            out[8..12].copy_from_slice(&(c >> 16 | d << 8).to_le_bytes());
        } else {
            for (p, out) in p.iter().zip(out.chunks_mut(3)) {
                out.copy_from_slice(&p.to_le_bytes()[..3]);
            }
        }
    }
}

/// Place of a pixel on the sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Photosite {
    pub(super) row: usize,
    pub(super) column: usize,
}

/// A picture before demosaicing, with the noise that it will get.
#[derive(Debug, Clone, Default, PartialEq)]
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

    /// Takes columns of a row over from another of the same size.
    pub(super) fn restore(&mut self, other: &Self, row: usize, columns: std::ops::Range<usize>) {
        let channels = self.value.len() / (self.width * self.height);
        let from = (row * self.width + columns.start) * channels;
        let range = from..from + columns.len() * channels;
        self.value[range.clone()].copy_from_slice(&other.value[range.clone()]);
        self.deviation[range.clone()].copy_from_slice(&other.deviation[range]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Look;
    use super::*;

    #[test]
    fn neighbours_are_stored_as_each_alone_is() {
        let mut rng = Pcg64::seed_from_u64(1);
        let colours: Vec<Rgb> = (0..40).map(|_| rng.random()).collect();
        let gains: Vec<f32> = (0..40).map(|_| rng.random()).collect();
        for bayer in [true, false] {
            let converter = Converter::new(&Sensor { bayer, ..Look::default().sensor }, 1);
            let empty = Raw::new(64, 4, converter.channels());
            for (row, column) in [(0, 0), (0, 3), (1, 2), (3, 7)] {
                let (mut together, mut alone) = (empty.clone(), empty.clone());
                let site = Photosite { row, column };
                converter.put_run(&mut together, site, &colours, (&gains, 1.3));
                for (k, colour) in colours.iter().enumerate() {
                    let site = Photosite { row, column: column + k };
                    converter.put(&mut alone, site, *colour, gains[k] * 1.3);
                }

                assert_eq!(together, alone, "{row} {column}");
                assert_ne!(together, empty);
            }
        }
    }

    #[test]
    fn signals_beyond_the_scale_have_its_ends() {
        let converter = Converter::new(&Look::default().sensor, 1);
        let [dark, full] = [0.0, 1.0].map(|signal| converter.code(signal));

        assert_eq!((dark.0, full.0), (0, FULL));
        for signal in [-1e30, -1.0, -1e-3, f32::NAN] {
            assert_eq!(converter.code(signal), dark, "{signal}");
        }
        for signal in [1.001, 7e5, 1e30, f32::INFINITY] {
            assert_eq!(converter.code(signal), full, "{signal}");
        }
    }
}
