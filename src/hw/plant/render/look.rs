//! Materials, light, lens and sensor of a rendered camera.
//!
//! These numbers belong to the plant. The controller does not know them, and no module of `vision`
//! may use them. Reflectances are linear (not gamma coded), 0..=1. Each number is a field, so that
//! a scenario can set it; [`Look::draw`] draws mild variations.

use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// Linear reflectance of red, green, blue.
pub type Rgb = [f32; 3];

/// Properties on which a picture depends beside the geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    /// The cube's stickers and body.
    pub cube: CubeLook,
    /// Lamps and daylight.
    pub light: Light,
    /// Optics beside the intrinsics.
    pub lens: Lens,
    /// Image sensor.
    pub sensor: Sensor,
    /// The operator's hand.
    pub hand: HandLook,
    /// Paint of the arms' links.
    pub arm: Rgb,
    /// Number of red, orange and yellow things on the walls.
    pub distractors: usize,
    /// Seed of the places of these things.
    pub distractor_seed: u64,
    /// Whether the cap is on the lens, so that pictures show read noise only.
    pub lens_cap: bool,
}

/// Stickers and body of the cube.
#[derive(Debug, Clone, PartialEq)]
pub struct CubeLook {
    /// Side of a sticker as a share of a third of the edge; the rest is the gap.
    pub sticker: f64,
    /// Corner radius as a share of the sticker's side.
    pub corner: f64,
    /// Plastic between the stickers.
    pub body: Rgb,
    /// Paints of the stickers in the order white, red, green, yellow, orange, blue.
    pub stickers: [Rgb; 6],
    /// Strength of the mirrored lamp; above about 0.5 the highlight is overexposed.
    pub gloss: f32,
}

impl CubeLook {
    /// Paints of a cube of 2007 with glossy stickers.
    const STICKERS: [Rgb; 6] = [
        [0.80, 0.80, 0.77],
        [0.46, 0.022, 0.028],
        [0.012, 0.31, 0.085],
        [0.80, 0.63, 0.022],
        [0.84, 0.165, 0.012],
        [0.012, 0.065, 0.37],
    ];

    /// Returns the look of a cube of black plastic with stickers.
    #[must_use]
    pub fn black() -> Self {
        Self {
            sticker: 0.86,
            corner: 0.12,
            body: [0.022, 0.022, 0.024],
            stickers: Self::STICKERS,
            gloss: 0.35,
        }
    }

    /// Returns the look of a cube of white plastic with stickers.
    #[must_use]
    pub fn white() -> Self {
        Self { body: [0.70, 0.70, 0.68], ..Self::black() }
    }
}

/// Light of the room and of one lamp.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// Colour temperature of lamp and room (K), 2700..=7500.
    pub temperature: f64,
    /// Colour temperature that the camera's white balance assumes (K).
    pub balanced_for: f64,
    /// Remaining gain error of red, green, blue as a factor (1 = none).
    pub tint: Rgb,
    /// Irradiance from all around; the sum with `key` is about 1.
    pub ambient: f32,
    /// Irradiance of the lamp on a surface that faces it.
    pub key: f32,
    /// Direction towards the lamp, in the world.
    pub key_direction: Vector3<f64>,
    /// Edge of a shadow, if the lamp casts one.
    pub shadow: Option<Shadow>,
}

/// Straight edge of a shadow.
#[derive(Debug, Clone, PartialEq)]
pub struct Shadow {
    /// A point on the edge's plane, in the world (m).
    pub point: Point3<f64>,
    /// Normal of the edge's plane, in the world; points on its side are dark.
    pub normal: Vector3<f64>,
    /// Width of the transition (m).
    pub softness: f64,
    /// Share of the lamp's light that is taken away, 0..=1.
    pub depth: f32,
}

/// Optics beside the intrinsics (distortion is part of [`crate::cell::Intrinsics`]).
#[derive(Debug, Clone, PartialEq)]
pub struct Lens {
    /// Share of light lost in the image's corners.
    pub vignette: f32,
    /// Standard deviation of the blur (px), at most 0.8.
    pub defocus: f64,
}

/// Image sensor, from irradiance to 8 bits.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Nominal exposure time (s), over which motion blurs; the unit of `exposure` in `render`.
    pub exposure_time: f64,
    /// Signal (1 = full scale) of a white surface of irradiance 1 at the nominal exposure.
    pub gain: f32,
    /// Exponent of the tone curve: coded value = signal^(1/gamma); 1 is a linear camera.
    pub gamma: f64,
    /// Whether a pixel measures one colour of an RGGB mosaic, which is interpolated, or three.
    pub bayer: bool,
    /// Standard deviation of the noise in the dark (of 255), before demosaicing.
    pub read_noise: f64,
    /// Standard deviation of the shot noise at full scale (of 255), before demosaicing; it grows
    /// with the root of the coded value.
    pub shot_noise: f64,
}

/// The operator's hand.
#[derive(Debug, Clone, PartialEq)]
pub struct HandLook {
    /// Reflectance of the skin.
    pub skin: Rgb,
    /// Reflectance of the sleeve.
    pub sleeve: Rgb,
    /// Number of fingertips on the -y side of the hand frame, which the stand-alone camera sees:
    /// 0..=3.
    pub front_fingers: u8,
    /// Distance by which the fingertips reach over the cube from its +x edge (m).
    pub reach: f64,
    /// Shift of the fingers along the hand's z (m).
    pub height: f64,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            cube: CubeLook::black(),
            light: Light {
                temperature: 4500.0,
                balanced_for: 4700.0,
                tint: [1.0; 3],
                ambient: 0.55,
                key: 0.55,
                key_direction: Vector3::new(-0.35, -0.75, 0.56),
                shadow: None,
            },
            lens: Lens { vignette: 0.15, defocus: 0.35 },
            sensor: Sensor {
                exposure_time: 0.008,
                gain: 0.85,
                gamma: 2.0,
                bayer: true,
                read_noise: 2.5,
                shot_noise: 3.0,
            },
            hand: HandLook {
                skin: [0.52, 0.27, 0.19],
                sleeve: [0.06, 0.08, 0.13],
                front_fingers: 1,
                reach: 0.013,
                height: 0.0,
            },
            arm: [0.80, 0.22, 0.03],
            distractors: 9,
            distractor_seed: 1,
            lens_cap: false,
        }
    }
}

impl Look {
    /// Returns a look that shows geometry alone: even light without noise, blur, shadow,
    /// reflections, vignette and mosaic.
    #[must_use]
    pub fn studio() -> Self {
        let mut look = Self::default();
        look.cube.gloss = 0.0;
        // Equal temperatures make white paper white. Without a lamp the shading is constant.
        look.light = Light {
            temperature: 5500.0,
            balanced_for: 5500.0,
            ambient: 1.0,
            key: 0.0,
            ..look.light
        };
        look.lens = Lens { vignette: 0.0, defocus: 0.0 };
        // The exposure time only blurs motion; the brightness does not depend on it.
        look.sensor = Sensor {
            exposure_time: 0.0,
            gamma: 1.0,
            bayer: false,
            read_noise: 0.0,
            shot_noise: 0.0,
            ..look.sensor
        };
        look
    }

    /// Returns random mild variations of the default look, from a run's seed.
    #[must_use]
    pub fn draw(seed: u64) -> Self {
        // "Look" in ASCII: the draws must not repeat the numbers of another use of the seed. Their
        // order is part of the result: a new one in between would change the pictures of all seeds.
        let mut rng = Pcg64::seed_from_u64(seed ^ 0x4c6f_6f6b);
        let mut look = Self::default();
        let mut within = |low: f64, high: f64| rng.random_range(low..high);
        look.cube.sticker = within(0.82, 0.90);
        look.cube.corner = within(0.06, 0.20);
        look.cube.gloss = within(0.1, 0.6) as f32;
        for colour in &mut look.cube.stickers {
            for channel in colour {
                *channel *= within(0.9, 1.08) as f32;
            }
        }
        look.light.temperature = within(3200.0, 6500.0);
        look.light.balanced_for = look.light.temperature * within(0.9, 1.1);
        look.light.tint = [within(0.96, 1.04) as f32, 1.0, within(0.96, 1.04) as f32];
        look.light.ambient = within(0.45, 0.65) as f32;
        look.light.key = within(0.4, 0.65) as f32;
        look.light.key_direction =
            Vector3::new(within(-0.6, 0.6), within(-0.9, -0.5), within(0.4, 0.8));
        look.lens.vignette = within(0.05, 0.25) as f32;
        look.lens.defocus = within(0.2, 0.5);
        look.sensor.read_noise = within(1.5, 3.5);
        look.sensor.shot_noise = within(2.0, 4.0);
        look.hand.reach = within(0.008, 0.016);
        look.hand.height = within(-0.004, 0.004);
        // One factor for all channels keeps the hue, from dark to light skin.
        let tone = within(0.55, 1.15) as f32;
        look.hand.skin = look.hand.skin.map(|c| c * tone);
        look.hand.front_fingers = within(0.0, 2.0) as u8;
        look.distractor_seed = seed;
        look
    }
}

impl Light {
    /// Returns the colour cast: the factors of red, green and blue with which white paper appears
    /// in the picture, from the lamp's colour and the camera's white balance.
    #[must_use]
    pub(super) fn cast(&self) -> Rgb {
        let lamp = black_body(self.temperature);
        let assumed = black_body(self.balanced_for);
        std::array::from_fn(|c| self.tint[c] * (lamp[c] / assumed[c]) as f32)
    }
}

/// Returns red, green and blue of a black body at this temperature (K) by Planck's law, relative to
/// green, in narrow bands at 610, 540 and 465 nm.
fn black_body(temperature: f64) -> [f64; 3] {
    /// Second radiation constant, h c / k (m K).
    const C2: f64 = 0.014_387_769;
    // The constant factor of the law cancels in the ratio.
    let planck =
        |wavelength: f64| wavelength.powi(-5) / (libm::exp(C2 / (wavelength * temperature)) - 1.0);
    let green = planck(540e-9);
    [planck(610e-9) / green, 1.0, planck(465e-9) / green]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unbalanced_warm_light_is_reddish() {
        let light = Light { temperature: 3000.0, balanced_for: 5000.0, ..Look::default().light };

        let [r, g, b] = light.cast();

        assert!(r > 1.2 * g && b < 0.8 * g, "{r} {g} {b}");
    }

    #[test]
    fn equal_seeds_draw_equal_render_settings() {
        assert_eq!(Look::draw(7), Look::draw(7));
        assert_ne!(Look::draw(7), Look::draw(8));
    }
}
