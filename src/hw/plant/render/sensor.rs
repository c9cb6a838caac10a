//! Image sensor: turns linear colours into an 8-bit picture with mosaic and noise.
//!
//! - in: linear colours (1 = full scale at the nominal exposure), a source of random numbers
//! - out: an RGB picture
//!
//! The noise is drawn once as a long list of Gaussian numbers, which each row of each frame reads
//! from a random place. The noise is added to the coded value and has the same units. Values have
//! four more bits than the picture, so that the sums of the demosaicing keep their fractions.

use super::look::{Rgb, Sensor};
use image::RgbImage;
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// One step of the picture (1/255 of full scale) in stored values.
const ONE: i16 = 16;
/// Full scale of stored values.
const FULL: i16 = 255 * ONE;
/// Number of steps of a linear signal in the table of codes.
const STEPS: usize = 4096;
/// Number of values in the list of noise.
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

/// Tables of a sensor, which are made once.
#[derive(Debug, Clone)]
pub(super) struct Converter {
    /// Coded value of each linear signal, and the standard deviation of its noise in eighths (of
    /// 255).
    codes: Vec<(i16, i16)>,
    /// Gaussian numbers of variance 1, in 32nds.
    noise: Vec<i16>,
    /// Whether the sensor has an RGGB mosaic.
    pub(super) bayer: bool,
}

impl Converter {
    /// Makes the tables of a sensor: its tone curve, and the list of noise, which `seed` chooses.
    pub(super) fn new(sensor: &Sensor, seed: u64) -> Self {
        // Noise times deviation must fit into 16 bits, of which a vector instruction takes twice as
        // many as of 32 bits: 200 (25 of 255) times 160 (5 standard deviations) is 32000.
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

    /// Returns the number of values that the raw picture has for each pixel: 1 with a mosaic, else
    /// 3.
    pub(super) fn channels(&self) -> usize {
        if self.bayer { 1 } else { 3 }
    }

    /// Returns the coded value of a linear signal and the standard deviation of its noise.
    #[inline]
    fn code(&self, signal: f32) -> (i16, i16) {
        // Via `i32`, because one instruction converts to 32 bits. The cast saturates, and turns NaN
        // into 0.
        let step = (signal * STEPS as f32 + 0.5) as i32;
        self.codes[step.clamp(0, STEPS as i32) as usize]
    }

    /// Stores in `raw` the coded value of a pixel's colour times `gain`, and the standard deviation
    /// of its noise.
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

    /// Stores in `raw` the colours of neighbouring pixels of a row, the first at `site`, each times
    /// its gain and the exposure.
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
        // A row of the mosaic alternates between two channels, so the run swaps them instead of
        // looking up the channel of each photosite.
        let start = row * raw.width + column;
        let range = start..start + colours.len();
        let stored = raw.value[range.clone()].iter_mut().zip(&mut raw.deviation[range]);
        let [mut channel, mut next] = [column, column + 1].map(|column| mosaic(row, column));
        for ((value, deviation), (colour, gain)) in stored.zip(colours.iter().zip(gains)) {
            (*value, *deviation) = self.code(colour[channel] * (gain * exposure));
            std::mem::swap(&mut channel, &mut next);
        }
    }

    /// Makes the picture with noise. The raw picture is not changed, because the background of a
    /// fixed camera stays in it.
    pub(super) fn develop(&self, raw: &Raw, rng: &mut Pcg64) -> RgbImage {
        let (w, h) = (raw.width, raw.height);
        let mut pixels = vec![0_u8; w * h * 3];
        if self.bayer {
            self.demosaic(raw, rng, &mut pixels);
        } else {
            let mut line = vec![0; 3 * w];
            for (row, out) in pixels.chunks_exact_mut(3 * w).enumerate() {
                self.expose(raw, row, rng, &mut line);
                // Rounds to the nearest step.
                for (out, value) in out.iter_mut().zip(&line) {
                    *out = ((value + ONE / 2) / ONE) as u8;
                }
            }
        }
        RgbImage::from_raw(w as u32, h as u32, pixels).unwrap_or_default()
    }

    /// Writes the values of a row of the raw picture, with noise, into `line`.
    fn expose(&self, raw: &Raw, row: usize, rng: &mut Pcg64, line: &mut [i16]) {
        let stride = line.len();
        let range = row * stride..(row + 1) * stride;
        // One random number for a row, instead of a Gaussian number for each of its values.
        let start = rng.random_range(0..NOISE - stride);
        let noise = &self.noise[start..start + stride];
        let values = raw.value[range.clone()].iter().zip(&raw.deviation[range]);
        for ((noisy, (value, deviation)), noise) in line.iter_mut().zip(values).zip(noise) {
            // The product is in 1/32 times 1/8, the value in 1/16: a shift by 4, with rounding.
            *noisy = (value + ((noise * deviation + 8) >> 4)).clamp(0, FULL);
        }
    }

    /// Interpolates an RGGB mosaic bilinearly; its borders are mirrored.
    fn demosaic(&self, raw: &Raw, rng: &mut Pcg64, pixels: &mut [u8]) {
        let (w, h) = (raw.width, raw.height);
        // Three rows, each with a mirrored pixel on either side. Mirrored about the outermost
        // pixel, a neighbour has the channel that the mosaic would have there.
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
            // The rows move up by one; the row below the last one mirrors the row above it.
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

/// Interpolates the mosaic in a row, `mid`, from this row and its neighbours `up` and `down`. They
/// have one more value on either side. The pixels are packed as 0x00BBGGRR.
fn interpolate(row: usize, up: &[i16], mid: &[i16], down: &[i16], packed: &mut [u32]) {
    let w = packed.len();
    let (u0, u1, u2) = (&up[..w], &up[1..=w], &up[2..w + 2]);
    let (m0, m1, m2) = (&mid[..w], &mid[1..=w], &mid[2..w + 2]);
    let (d0, d1, d2) = (&down[..w], &down[1..=w], &down[2..w + 2]);
    // Rows of red and green alternate with rows of green and blue. `own` is the row's own colour
    // (red or blue), `other` the one that its neighbour rows have. Slices of equal length let the
    // compiler drop the checks of the indices.
    let (own_shift, other_shift) = if row & 1 == 0 { (0, 16) } else { (16, 0) };
    for k in 0..w {
        let vertical = u1[k] + d1[k];
        let horizontal = m0[k] + m2[k];
        let diagonal = u0[k] + u2[k] + (d0[k] + d2[k]);
        // A sum of 1, 2 or 4 values becomes 8 bits by a shift of 4, 5 or 6, with rounding. The
        // largest sum, 4 times 4080, fits into 16 bits.
        let here = (m1[k] + 8) >> 4;
        // A mask instead of a branch: all ones where the photosite has the row's own colour.
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
            // Four pixels of three bytes are three words of four bytes, without gaps.
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

/// Picture before demosaicing, with the deviation of the noise of each value.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Raw {
    width: usize,
    height: usize,
    /// Coded values, `ONE` for each step of the picture.
    value: Vec<i16>,
    /// Standard deviations of the noise, in eighths (of 255).
    deviation: Vec<i16>,
}

impl Raw {
    /// Makes a black picture without noise.
    pub(super) fn new(width: usize, height: usize, channels: usize) -> Self {
        let size = width * height * channels;
        Self { width, height, value: vec![0; size], deviation: vec![0; size] }
    }

    /// Copies columns of a row from another picture of the same size.
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
    fn stored_run_equals_pixels_stored_one_by_one() {
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

    /// Signals below 0 and NaN give the lowest level; signals above 1, also infinite ones, give the
    /// highest.
    #[test]
    fn signals_outside_scale_saturate() {
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
