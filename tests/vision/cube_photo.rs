//! Second renderer, for photographs of cubes that the plant's renderer does not make.
//!
//! It traces rays against one box. The cube has stickers on a black or white body, or coloured
//! plastic without stickers. There are logos, fingers, glare, lights and backgrounds, and a camera
//! that blurs, clips, adds noise and compresses. It shares no code with the plant's renderer: a
//! detector that is tuned to one of the renderers fails with the other.
//!
//! - in: a [`Kind`] and a seed
//! - out: a [`Photo`] with the truth of each visible face

use image::{Rgb, RgbImage};
use nalgebra::{Rotation3, Unit, Vector3};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

/// Kind of a photograph: its difference from an ordinary one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Stickers on black, in ordinary light.
    Stickered,
    /// Coloured plastic with rounded cubies and no body that shows.
    Stickerless,
    /// Stickers on white plastic.
    WhiteBody,
    /// A maker's mark on the centre of each face.
    Logo,
    /// One to three fingers over the rim of the face.
    Fingers,
    /// A twentieth of the light, with the noise that follows from it.
    Dark,
    /// A filament lamp that the white balance of the camera corrects only in part.
    Warm,
    /// Shade under a blue sky that the white balance corrects only in part.
    Cold,
    /// Reflection of a lamp in the face.
    Glare,
    /// More light than the camera can measure: white clips, yellow clips in two channels.
    Overexposed,
    /// Out of focus, or blurred by motion.
    Blurred,
    /// A face of 45 to 70 px.
    Small,
    /// Up to three of the other kinds at once.
    Mixed,
}

impl Kind {
    /// All kinds.
    pub(crate) const ALL: [Self; 13] = [
        Self::Stickered,
        Self::Stickerless,
        Self::WhiteBody,
        Self::Logo,
        Self::Fingers,
        Self::Dark,
        Self::Warm,
        Self::Cold,
        Self::Glare,
        Self::Overexposed,
        Self::Blurred,
        Self::Small,
        Self::Mixed,
    ];
}

/// Face that the camera sees.
#[derive(Debug, Clone)]
pub(crate) struct FaceTruth {
    /// Centres of the tiles in reading order (px).
    pub centres: [(f64, f64); 9],
    /// Colours 0..=5 = white, red, green, yellow, orange, blue.
    pub colours: [u8; 9],
    /// Share of each tile that a finger hides, 0..=1.
    pub covered: [f64; 9],
    /// Area in the picture (px^2).
    pub area: f64,
    /// Cosine between the sight and the face's normal.
    pub facing: f64,
}

/// Picture with its truth.
#[derive(Debug, Clone)]
pub(crate) struct Photo {
    /// Picture after compression and decoding.
    pub image: RgbImage,
    /// Visible faces, the largest first.
    pub faces: Vec<FaceTruth>,
    /// Rotation and translation from cube coordinates (unit: a third of the edge) to the camera's.
    pub camera_from_cube: (Rotation3<f64>, Vector3<f64>),
    /// Focal length (px); the principal point is the picture's middle.
    pub focal: f64,
}

/// Size of a photograph (px).
const WIDTH: u32 = 480;
const HEIGHT: u32 = 360;

/// Linear reflectances of white, red, green, yellow, orange, blue by four makers.
const MAKERS: [[[f64; 3]; 6]; 4] = [
    [
        [0.80, 0.80, 0.80],
        [0.50, 0.02, 0.03],
        [0.01, 0.25, 0.07],
        [0.80, 0.60, 0.02],
        [0.85, 0.17, 0.01],
        [0.01, 0.06, 0.32],
    ],
    [
        [0.85, 0.85, 0.85],
        [0.75, 0.03, 0.05],
        [0.05, 0.55, 0.08],
        [0.85, 0.75, 0.05],
        [0.95, 0.28, 0.02],
        [0.02, 0.16, 0.65],
    ],
    [
        [0.70, 0.70, 0.66],
        [0.42, 0.03, 0.05],
        [0.02, 0.20, 0.10],
        [0.75, 0.62, 0.05],
        [0.80, 0.22, 0.05],
        [0.03, 0.06, 0.25],
    ],
    [
        [0.85, 0.85, 0.85],
        [0.85, 0.06, 0.12],
        [0.20, 0.75, 0.08],
        [0.85, 0.88, 0.08],
        [1.00, 0.35, 0.05],
        [0.03, 0.25, 0.80],
    ],
];

/// Linear reflectances of skin.
const SKINS: [[f64; 3]; 4] =
    [[0.78, 0.52, 0.40], [0.62, 0.36, 0.24], [0.38, 0.20, 0.12], [0.16, 0.08, 0.05]];

/// Material between the coloured tiles.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Body {
    /// Black plastic under stickers.
    Black,
    /// White plastic under stickers.
    White,
    /// Coloured plastic without stickers.
    Plastic,
}

/// Drawn parameters of one photograph.
struct Recipe {
    body: Body,
    /// Side of a sticker (pitches).
    share: f64,
    /// Radius of its corners (pitches).
    radius: f64,
    /// Standard deviation of its offset (pitches).
    untidy: f64,
    /// Gap between cubies without stickers (pitches).
    gap: f64,
    /// Width of their rounded rim (pitches).
    bevel: f64,
    /// Whether each centre tile has a maker's mark.
    logo: bool,
    /// Number of fingers before the dominant face.
    fingers: usize,
    /// Linear level of a white tile.
    exposure: f64,
    /// Stray light in each pixel; 1 is a white in full light.
    veil: f64,
    /// Gains of red, green and blue: the light and the white balance.
    gains: [f64; 3],
    /// Light of a lamp that the dominant face reflects; 1 is a white in full light.
    glare: f64,
    /// Light of the highlights of a tile; 1 is a white in full light.
    gloss: f64,
    /// Loss of light towards the corners; a corner loses this share.
    vignette: f64,
    /// Standard deviation of the lens's blur (px).
    blur: f64,
    /// Motion during the exposure (px).
    motion: (f64, f64),
    /// Standard deviation of the noise without light (linear level).
    read_noise: f64,
    /// Standard deviation of the noise at the level 1.
    shot_noise: f64,
    /// Quality of the JPEG file, up to 100.
    quality: u8,
    /// Colour is stored at half the size, as most files do.
    halved: bool,
    /// Width of the dominant face (px).
    face_px: f64,
    /// Angle between its normal and the line of sight (rad).
    tilt: f64,
}

impl Recipe {
    /// Returns random parameters for a photograph of this kind.
    fn draw(kind: Kind, random: &mut Pcg64) -> Self {
        let mut between = |low: f64, high: f64| random.random_range(low..high);
        let mut recipe = Self {
            body: Body::Black,
            share: between(0.80, 0.92),
            radius: between(0.03, 0.18),
            untidy: between(0.0, 0.025),
            gap: between(0.02, 0.05),
            bevel: between(0.04, 0.10),
            logo: false,
            fingers: 0,
            exposure: between(0.65, 0.95),
            veil: between(0.0, 0.02),
            gains: [between(0.92, 1.08), 1.0, between(0.90, 1.10)],
            glare: 0.0,
            gloss: between(0.0, 0.06),
            vignette: between(0.0, 0.35),
            blur: between(0.5, 1.1),
            motion: (0.0, 0.0),
            read_noise: between(0.001, 0.003),
            shot_noise: between(0.005, 0.02),
            quality: between(72.0, 96.0) as u8,
            halved: between(0.0, 1.0) < 0.7,
            face_px: between(85.0, 200.0),
            tilt: between(0.0, 0.75),
        };
        recipe.apply(kind, random);
        recipe
    }

    /// Changes the parameters to those of a kind.
    fn apply(&mut self, kind: Kind, random: &mut Pcg64) {
        let mut between = |low: f64, high: f64| random.random_range(low..high);
        match kind {
            Kind::Stickered => {}
            Kind::Stickerless => {
                self.body = Body::Plastic;
                self.radius = between(0.08, 0.26);
            }
            Kind::WhiteBody => self.body = Body::White,
            Kind::Logo => self.logo = true,
            Kind::Fingers => self.fingers = between(1.0, 4.0) as usize,
            Kind::Dark => {
                self.exposure = between(0.025, 0.09);
                self.read_noise = between(0.0015, 0.004);
            }
            Kind::Warm => self.gains = [between(1.1, 1.35), 1.0, between(0.40, 0.65)],
            Kind::Cold => self.gains = [between(0.62, 0.82), 1.0, between(1.15, 1.4)],
            Kind::Glare => self.glare = between(0.3, 1.2),
            Kind::Overexposed => {
                self.exposure = between(1.5, 2.8);
                self.veil = between(0.02, 0.12);
            }
            Kind::Blurred => {
                self.blur = between(1.4, 2.6);
                let (length, way) = (between(0.0, 6.0), between(0.0, 6.2));
                self.motion = (length * way.cos(), length * way.sin());
            }
            Kind::Small => self.face_px = between(45.0, 70.0),
            Kind::Mixed => {
                for _ in 0..3 {
                    let one = Kind::ALL[random.random_range(0..Kind::ALL.len() - 1)];
                    self.apply(one, random);
                }
            }
        }
    }
}

/// Finger: a capsule in the picture (px).
struct Finger {
    tip: (f64, f64),
    root: (f64, f64),
    radius: f64,
    skin: [f64; 3],
}

impl Finger {
    /// Returns the colour of the finger at a pixel, or `None` if it does not hide that pixel.
    fn at(&self, x: f64, y: f64) -> Option<[f64; 3]> {
        let (dx, dy) = (self.root.0 - self.tip.0, self.root.1 - self.tip.1);
        let (px, py) = (x - self.tip.0, y - self.tip.1);
        let along = ((px * dx + py * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
        let off = (px - along * dx).hypot(py - along * dy) / self.radius;
        if off >= 1.0 {
            return None;
        }
        let shade = 0.45 + 0.55 * (1.0 - off * off).sqrt();
        // The nail near the tip is paler.
        let nail = along == 0.0 && off < 0.5;
        Some(self.skin.map(|c| (c * shade * if nail { 1.15 } else { 1.0 }).min(1.0)))
    }
}

/// Background of the cube.
struct Backdrop {
    /// Motif, one of those in [`Backdrop::at`].
    style: usize,
    colours: [[f64; 3]; 6],
    /// Period of the motif (px).
    pitch: f64,
    /// Direction of the motif (rad).
    angle: f64,
    /// Objects on a table: left, top, right and bottom edge (px), and the colour.
    boxes: Vec<([f64; 4], [f64; 3])>,
}

impl Backdrop {
    /// Returns a random background.
    fn draw(random: &mut Pcg64) -> Self {
        let mut colour = || {
            let grey = random.random_range(0.03..0.7);
            let tint = random.random_range(0.0..0.6);
            std::array::from_fn(|_| grey * (1.0 - tint * random.random_range(0.0..1.0)))
        };
        let colours = std::array::from_fn(|_| colour());
        let boxes = (0..28)
            .map(|_| {
                let (x, y) = (random.random_range(-20.0..470.0), random.random_range(-20.0..350.0));
                let (w, h) = (random.random_range(8.0..130.0), random.random_range(8.0..130.0));
                let c = std::array::from_fn(|_| random.random_range(0.02..0.8));
                ([x, y, x + w, y + h], c)
            })
            .collect();
        Self {
            style: random.random_range(0..6),
            colours,
            pitch: random.random_range(14.0..45.0),
            angle: random.random_range(0.0..3.1),
            boxes,
        }
    }

    /// Returns the linear colour of the background at a pixel.
    fn at(&self, x: f64, y: f64) -> [f64; 3] {
        let (s, c) = self.angle.sin_cos();
        let (u, v) = ((c * x + s * y) / self.pitch, (c * y - s * x) / self.pitch);
        let mix = |a: [f64; 3], b: [f64; 3], t: f64| -> [f64; 3] {
            std::array::from_fn(|k| a[k] + t * (b[k] - a[k]))
        };
        let [a, b, ..] = self.colours;
        match self.style {
            0 => mix(a, b, 0.5 * (x / f64::from(WIDTH)) + 0.5 * (y / f64::from(HEIGHT))),
            // Wood has uneven stripes of two similar shades.
            1 => {
                let wave = (u * 2.1 + (v * 0.35).sin() * 1.7).sin() * 0.5 + 0.5;
                mix(a, mix(a, b, 0.3), wave * (0.7 + 0.3 * (u * 0.31).sin()))
            }
            // A cluttered table.
            2 => self
                .boxes
                .iter()
                .rev()
                .find(|(r, _)| (r[0]..r[2]).contains(&x) && (r[1]..r[3]).contains(&y))
                .map_or(a, |(_, colour)| *colour),
            // Chequered cloth.
            3 => {
                if (u.floor() + v.floor()).rem_euclid(2.0) < 1.0 {
                    a
                } else {
                    b
                }
            }
            // Carpet.
            4 => {
                let cell = (x / 2.0).floor() * 12.9898 + (y / 2.0).floor() * 78.233;
                mix(a, b, ((cell.sin() * 43_758.547).rem_euclid(1.0) - 0.5) * 0.5 + 0.5)
            }
            // Spines of books.
            _ => {
                let book = u.floor();
                let at = (book.rem_euclid(6.0)) as usize;
                if u - book < 0.06 { [0.01; 3] } else { self.colours[at] }
            }
        }
    }
}

/// Face of the cube: outward normal, and the directions of its columns and rows (x right, y down as
/// seen from outside).
#[derive(Clone, Copy)]
struct Side {
    normal: Vector3<f64>,
    x: Vector3<f64>,
    y: Vector3<f64>,
}

/// Returns the six sides of a cube: +x, -x, +y, -y, +z, -z.
fn sides() -> [Side; 6] {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    std::array::from_fn(|i| {
        let normal = axes[i / 2] * if i % 2 == 0 { 1.0 } else { -1.0 };
        let x = axes[(i / 2 + 1) % 3];
        Side { normal, x, y: (-normal).cross(&x) }
    })
}

/// Cube before a background, with all that a photograph of it depends on.
struct Scene {
    recipe: Recipe,
    sides: [Side; 6],
    /// Colours 0..=5 of the tiles of each side in reading order.
    colours: [[u8; 9]; 6],
    /// Offsets of the stickers (pitches).
    offsets: [[(f64, f64); 9]; 6],
    /// Deviations of the stickers' normals, added to the unit normal of the side.
    tilts: [[Vector3<f64>; 9]; 6],
    /// Linear reflectances of the colours 0..=5.
    palette: [[f64; 3]; 6],
    /// Rotation from cube coordinates to the camera's.
    rotation: Rotation3<f64>,
    /// Cube's centre in camera coordinates (thirds of the edge).
    place: Vector3<f64>,
    /// Focal length (px).
    focal: f64,
    /// Direction to the lamp in camera coordinates.
    lamp: Unit<Vector3<f64>>,
    /// Shape of the maker's mark, one of those in [`Scene::marked`].
    mark: usize,
    fingers: Vec<Finger>,
    backdrop: Backdrop,
    /// Reflection of the lamp: side, place, widths.
    mirror: (usize, (f64, f64), (f64, f64)),
}

/// Returns the signed distance of the point (a, b) from the outline of a square of half side
/// `half`, whose corners have a `radius`.
fn rounded(a: f64, b: f64, half: f64, radius: f64) -> f64 {
    let (x, y) = (a.abs() - half + radius, b.abs() - half + radius);
    x.max(0.0).hypot(y.max(0.0)) + x.max(y).min(0.0) - radius
}

impl Scene {
    /// Returns the random scene of a kind and a seed, and the generator from which its noise is
    /// drawn. `posed` gives the width of the dominant face (px) and its tilt (rad); without it
    /// these are random as well.
    fn draw(kind: Kind, seed: u64, posed: Option<(f64, f64)>) -> (Self, Pcg64) {
        let mut random = Pcg64::seed_from_u64(seed.wrapping_mul(0x9E37_79B9) ^ kind as u64);
        let mut recipe = Recipe::draw(kind, &mut random);
        (recipe.face_px, recipe.tilt) = posed.unwrap_or((recipe.face_px, recipe.tilt));
        let jitter = Normal::new(0.0, 1.0).unwrap();
        let mut normal = |scale: f64| jitter.sample(&mut random) * scale;
        let maker = seed as usize % MAKERS.len();
        let palette =
            MAKERS[maker].map(|c| c.map(|v| (v * (1.0 + normal(0.06))).clamp(0.005, 1.0)));
        let offsets = std::array::from_fn(|_| {
            std::array::from_fn(|_| (normal(recipe.untidy), normal(recipe.untidy)))
        });
        let tilts = std::array::from_fn(|_| {
            std::array::from_fn(|_| Vector3::new(normal(0.03), normal(0.03), normal(0.03)))
        });
        let colours = std::array::from_fn(|_| std::array::from_fn(|_| random.random_range(0..6)));
        let focal = random.random_range(380.0..800.0);
        let depth = focal * 3.0 / recipe.face_px + 1.5;
        let reach =
            |size: u32| (f64::from(size) / 2.0 - 0.75 * recipe.face_px).max(1.0) * depth / focal;
        let place = Vector3::new(
            random.random_range(-1.0..1.0) * reach(WIDTH),
            random.random_range(-1.0..1.0) * reach(HEIGHT),
            depth,
        );
        let way = random.random_range(0.0..std::f64::consts::TAU);
        let lean =
            Rotation3::from_scaled_axis(Vector3::new(way.cos(), way.sin(), 0.0) * recipe.tilt);
        let roll = Rotation3::from_scaled_axis(Vector3::z() * random.random_range(-0.8..0.8));
        let sight = Rotation3::rotation_between(&Vector3::z(), &place).unwrap_or_default();
        let rotation = sight * lean * roll;
        let lamp = Unit::new_normalize(Vector3::new(
            random.random_range(-1.0..1.0),
            random.random_range(-1.2..0.2),
            random.random_range(-1.5..-0.6),
        ));
        let mirror = (
            0,
            (random.random_range(-1.0..1.0), random.random_range(-1.0..1.0)),
            (random.random_range(0.35..0.9), random.random_range(0.35..0.9)),
        );
        let mark = random.random_range(0..3);
        let backdrop = Backdrop::draw(&mut random);
        let mut scene = Self {
            recipe,
            sides: sides(),
            colours,
            offsets,
            tilts,
            palette,
            rotation,
            place,
            focal,
            lamp,
            mark,
            fingers: Vec::new(),
            backdrop,
            mirror,
        };
        let dominant = (0..6).max_by(|a, b| scene.facing(*a).total_cmp(&scene.facing(*b))).unwrap();
        scene.mirror.0 = dominant;
        let skin = SKINS[random.random_range(0..SKINS.len())];
        for _ in 0..scene.recipe.fingers {
            let along = random.random_range(-1.2..1.2);
            let deep = random.random_range(0.35..1.15);
            let turn = random.random_range(0..4);
            let place = |u: f64, v: f64| {
                let (u, v) = [(u, v), (-v, u), (-u, -v), (v, -u)][turn];
                scene.pixel(dominant, u, v)
            };
            let slant = random.random_range(-0.5..0.5);
            let radius = random.random_range(0.34..0.48) * (scene.recipe.face_px / 3.0);
            let (tip, root) = (place(1.5 - deep, along), place(4.5, along + slant));
            scene.fingers.push(Finger { tip, root, radius, skin });
        }
        (scene, random)
    }

    /// Returns the cosine between the line of sight and a side's normal.
    fn facing(&self, side: usize) -> f64 {
        let normal = self.rotation * self.sides[side].normal;
        let centre = self.place + normal * 1.5;
        -normal.dot(&centre) / centre.norm()
    }

    /// Projects the point (u, v) on a side of the cube, in thirds of the edge from the side's
    /// centre, to the picture (px).
    fn pixel(&self, side: usize, u: f64, v: f64) -> (f64, f64) {
        let s = &self.sides[side];
        let p = self.rotation * (s.normal * 1.5 + s.x * u + s.y * v) + self.place;
        (
            self.focal * p.x / p.z + 0.5 * f64::from(WIDTH - 1),
            self.focal * p.y / p.z + 0.5 * f64::from(HEIGHT - 1),
        )
    }

    /// Returns the linear RGB light that a pixel receives; 1 is a perfect white in full light.
    fn light(&self, x: f64, y: f64) -> [f64; 3] {
        if let Some(skin) = self.fingers.iter().find_map(|f| f.at(x, y)) {
            return skin;
        }
        let sight = Vector3::new(
            (x - 0.5 * f64::from(WIDTH - 1)) / self.focal,
            (y - 0.5 * f64::from(HEIGHT - 1)) / self.focal,
            1.0,
        );
        let from = self.rotation.inverse() * -self.place;
        let way = self.rotation.inverse() * sight;
        let (mut enter, mut leave, mut side) = (f64::NEG_INFINITY, f64::INFINITY, 0);
        for k in 0..3 {
            let (a, b) = ((-1.5 - from[k]) / way[k], (1.5 - from[k]) / way[k]);
            if a.min(b) > enter {
                (enter, side) = (a.min(b), 2 * k + usize::from(way[k] > 0.0));
            }
            leave = leave.min(a.max(b));
        }
        if enter.is_nan() || enter >= leave {
            return self.backdrop.at(x, y);
        }
        let at = from + way * enter;
        let s = &self.sides[side];
        self.surface(side, at.dot(&s.x), at.dot(&s.y), &sight)
    }

    /// Returns the linear RGB light from the point (u, v) on a side of the cube, in thirds of the
    /// edge from the side's centre. `sight` is the direction of the ray in camera coordinates.
    fn surface(&self, side: usize, u: f64, v: f64, sight: &Vector3<f64>) -> [f64; 3] {
        let recipe = &self.recipe;
        let (column, row) = ((u + 1.5).floor().clamp(0.0, 2.0), (v + 1.5).floor().clamp(0.0, 2.0));
        let cell = (3.0 * row + column) as usize;
        let (a, b) = (u + 1.0 - column, v + 1.0 - row);
        let colour = self.palette[usize::from(self.colours[side][cell])];
        let (dx, dy) = self.offsets[side][cell];
        let s = &self.sides[side];
        let mut normal = s.normal + self.tilts[side][cell];
        let (mut material, mut shiny) = match recipe.body {
            Body::Plastic => {
                let off = rounded(a, b, 0.5 - 0.5 * recipe.gap, recipe.radius);
                // The rim of a cubie is rounded.
                let bend = ((off + recipe.bevel) / recipe.bevel).clamp(0.0, 1.0);
                let out = if a.abs() > b.abs() { s.x * a.signum() } else { s.y * b.signum() };
                normal += out * (0.7 * bend);
                if off < 0.0 { (colour, true) } else { (colour.map(|c| 0.02 + 0.12 * c), false) }
            }
            body => {
                let inside = rounded(a - dx, b - dy, 0.5 * recipe.share, recipe.radius) < 0.0;
                let groove = a.abs().max(b.abs()) > 0.485 && u.abs().max(v.abs()) < 1.47;
                match (inside, body) {
                    (true, _) => (colour, true),
                    (false, Body::White) => ([if groove { 0.25 } else { 0.72 }; 3], false),
                    (false, _) => ([if groove { 0.008 } else { 0.02 }; 3], false),
                }
            }
        };
        if recipe.logo && cell == 4 && self.marked(a, b) {
            material = if self.palette[0][0] > 0.72 && self.mark != 1 {
                [0.02, 0.02, 0.05]
            } else {
                [0.05, 0.12, 0.5]
            };
            shiny = false;
        }
        let normal = (self.rotation * normal).normalize();
        let lit = 0.45 + 0.62 * normal.dot(&self.lamp).max(0.0);
        let mut light = material.map(|c| c * lit);
        if shiny {
            let half = (self.lamp.into_inner() - sight.normalize()).normalize();
            let gloss = recipe.gloss * normal.dot(&half).max(0.0).powi(40);
            light = light.map(|c| c + gloss);
        }
        let (mirror, place, breadth) = self.mirror;
        if recipe.glare > 0.0 && side == mirror {
            let (p, q) = ((u - place.0) / breadth.0, (v - place.1) / breadth.1);
            let lamp =
                recipe.glare * (-(p * p + q * q).powi(2)).exp() * if shiny { 1.0 } else { 0.3 };
            light = light.map(|c| c + lamp);
        }
        light
    }

    /// Returns whether the point (a, b) of the centre tile, in pitches from its middle, lies on the
    /// maker's mark.
    fn marked(&self, a: f64, b: f64) -> bool {
        match self.mark {
            // The mark is a ring.
            0 => (0.14..0.25).contains(&a.hypot(b)),
            // The mark is a block of writing.
            1 => {
                a.abs() < 0.30
                    && b.abs() < 0.22
                    && (a * 23.0).sin() > -0.2
                    && (b * 14.0).cos() > -0.3
            }
            // The mark is a disc with a hole beside its middle.
            _ => a.hypot(b) < 0.24 && (a - 0.08).hypot(b) > 0.09,
        }
    }

    /// Returns what a detector should find: the visible faces, the largest first.
    fn truths(&self) -> Vec<FaceTruth> {
        let mut faces: Vec<FaceTruth> = (0..6)
            .filter(|&side| self.facing(side) > 0.05)
            .map(|side| {
                let grid = |i: usize| ((i % 3) as f64 - 1.0, (i / 3) as f64 - 1.0);
                let corners = [(-1.5, -1.5), (1.5, -1.5), (1.5, 1.5), (-1.5, 1.5)]
                    .map(|(u, v)| self.pixel(side, u, v));
                let area: f64 = (0..4)
                    .map(|i| (corners[i], corners[(i + 1) % 4]))
                    .map(|(a, b)| 0.5 * (a.0 * b.1 - b.0 * a.1))
                    .sum();
                let hidden = |i: usize| {
                    let (u, v) = grid(i);
                    let probes = (0..49).map(|k| {
                        let (a, b) = (f64::from(k % 7) / 6.0 - 0.5, f64::from(k / 7) / 6.0 - 0.5);
                        self.pixel(side, u + 0.8 * a, v + 0.8 * b)
                    });
                    let under =
                        |p: &(f64, f64)| self.fingers.iter().any(|f| f.at(p.0, p.1).is_some());
                    probes.filter(under).count() as f64 / 49.0
                };
                FaceTruth {
                    centres: std::array::from_fn(|i| {
                        let (u, v) = grid(i);
                        self.pixel(side, u, v)
                    }),
                    colours: self.colours[side],
                    covered: std::array::from_fn(hidden),
                    area: area.abs(),
                    facing: self.facing(side),
                }
            })
            .collect();
        faces.sort_by(|a, b| b.area.total_cmp(&a.area));
        faces
    }
}

/// Returns the photograph of a random cube, which the kind and the seed determine.
pub(crate) fn photograph(kind: Kind, seed: u64) -> Photo {
    taken(Scene::draw(kind, seed, None))
}

/// Returns a photograph of a stickered cube whose dominant face has this width (px) and tilt (rad).
pub(crate) fn posed(seed: u64, face_px: f64, tilt: f64) -> Photo {
    taken(Scene::draw(Kind::Stickered, seed, Some((face_px, tilt))))
}

/// Takes the photograph of a scene; `random` gives the noise.
fn taken((scene, mut random): (Scene, Pcg64)) -> Photo {
    let recipe = &scene.recipe;
    let (width, height) = (WIDTH as usize, HEIGHT as usize);
    let noise = Normal::new(0.0, 1.0).unwrap();
    let mut plane: Vec<[f32; 3]> = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let mut sum = [0.0; 3];
            for (dx, dy) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
                let light = scene.light(x as f64 + dx, y as f64 + dy);
                (0..3).for_each(|c| sum[c] += 0.25 * light[c]);
            }
            let r = (x as f64 / f64::from(WIDTH) - 0.5).hypot(y as f64 / f64::from(HEIGHT) - 0.5);
            let fall = recipe.exposure / 0.8 * (1.0 - recipe.vignette * 2.0 * r * r);
            plane.push(std::array::from_fn(|c| {
                ((sum[c] + recipe.veil) * fall * recipe.gains[c]) as f32
            }));
        }
    }
    // The lens blurs before the sensor clips.
    blur(&mut plane, width, height, recipe.blur);
    if recipe.motion != (0.0, 0.0) {
        smear(&mut plane, width, height, recipe.motion);
    }
    for pixel in &mut plane {
        *pixel = pixel.map(|v| {
            let v = f64::from(v);
            let sd = recipe.read_noise.hypot(recipe.shot_noise * v.max(0.0).sqrt());
            (v + sd * noise.sample(&mut random)).clamp(0.0, 1.0) as f32
        });
    }
    // The second blur models the interpolation of the colour mosaic.
    blur(&mut plane, width, height, 0.45);
    let encode = |v: f32| {
        let v = f64::from(v.clamp(0.0, 1.0));
        let s = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
        (255.0 * s).round() as u8
    };
    let image = RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        Rgb(plane[y as usize * width + x as usize].map(encode))
    });
    let image = if recipe.halved { halved(&image) } else { image };
    let mut file = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut file, recipe.quality);
    encoder.encode_image(&image).unwrap();
    let image = image::load_from_memory(&file).unwrap().into_rgb8();
    let camera_from_cube = (scene.rotation, scene.place);
    Photo { image, faces: scene.truths(), camera_from_cube, focal: scene.focal }
}

/// Reduces the colours of an image to half their resolution, as JPEG does: four pixels share the
/// mean of their colour differences.
fn halved(image: &RgbImage) -> RgbImage {
    let luma = |p: &Rgb<u8>| {
        0.299 * f64::from(p.0[0]) + 0.587 * f64::from(p.0[1]) + 0.114 * f64::from(p.0[2])
    };
    RgbImage::from_fn(image.width(), image.height(), |x, y| {
        let own = luma(image.get_pixel(x, y));
        let mut mean = [0.0; 3];
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let p = image.get_pixel(x / 2 * 2 + dx, y / 2 * 2 + dy);
            (0..3).for_each(|c| mean[c] += 0.25 * (f64::from(p.0[c]) - luma(p)));
        }
        Rgb(mean.map(|d| (own + d).round().clamp(0.0, 255.0) as u8))
    })
}

/// Blurs a picture by a Gaussian of the standard deviation `sigma` (px) in both directions.
fn blur(plane: &mut [[f32; 3]], width: usize, height: usize, sigma: f64) {
    let reach = (3.0 * sigma).ceil() as isize;
    let weights: Vec<f32> =
        (-reach..=reach).map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp() as f32).collect();
    let total: f32 = weights.iter().sum();
    for (dx, dy) in [(1isize, 0isize), (0, 1)] {
        let source = plane.to_vec();
        for (i, out) in plane.iter_mut().enumerate() {
            let (x, y) = ((i % width) as isize, (i / width) as isize);
            let mut sum = [0.0f32; 3];
            for (k, weight) in (-reach..=reach).zip(&weights) {
                let px = (x + k * dx).clamp(0, width as isize - 1) as usize;
                let py = (y + k * dy).clamp(0, height as isize - 1) as usize;
                let from = source[py * width + px];
                (0..3).for_each(|c| sum[c] += weight * from[c]);
            }
            *out = sum.map(|s| s / total);
        }
    }
}

/// Blurs a picture along `stroke` (px), as the motion of the camera does.
fn smear(plane: &mut [[f32; 3]], width: usize, height: usize, stroke: (f64, f64)) {
    let source = plane.to_vec();
    for (i, out) in plane.iter_mut().enumerate() {
        let (x, y) = ((i % width) as f64, (i / width) as f64);
        let mut sum = [0.0f32; 3];
        for k in 0..9 {
            let t = f64::from(k) / 8.0 - 0.5;
            let px = (x + t * stroke.0).round().clamp(0.0, width as f64 - 1.0) as usize;
            let py = (y + t * stroke.1).round().clamp(0.0, height as f64 - 1.0) as usize;
            (0..3).for_each(|c| sum[c] += source[py * width + px][c] / 9.0);
        }
        *out = sum;
    }
}
