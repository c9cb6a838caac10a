//! Tests of the colours of whole cubes, whose camera exposes again for each face: every wrong
//! reading comes with a doubt, and no possible cube is refused.
//!
//! Each face has its own gain, a gradient of the light, and stickers that tilt a little towards it
//! or away. The light has a colour, and the picture haze and noise. There are colours of three
//! makers; the last has a red and an orange of the same hue, as on worn stickers.

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use rubik_robot::cube::{Cube, Facelets, parse_turns};
use rubik_robot::vision::colours::{Undecided, decide_cube, to_level, to_linear};

/// Levels of white, red, green, yellow, orange, blue by three makers (sRGB, 0 to 255).
const MAKERS: [[[f64; 3]; 6]; 3] = [
    [
        [235.0, 235.0, 235.0],
        [183.0, 18.0, 52.0],
        [0.0, 155.0, 72.0],
        [255.0, 213.0, 0.0],
        [255.0, 88.0, 0.0],
        [0.0, 70.0, 173.0],
    ],
    [
        [222.0, 224.0, 219.0],
        [171.0, 30.0, 41.0],
        [28.0, 139.0, 77.0],
        [226.0, 199.0, 39.0],
        [224.0, 96.0, 32.0],
        [27.0, 70.0, 158.0],
    ],
    [
        [240.0, 248.0, 245.0],
        [162.0, 6.0, 5.0],
        [22.0, 140.0, 62.0],
        [188.0, 216.0, 28.0],
        [190.0, 50.0, 6.0],
        [15.0, 48.0, 138.0],
    ],
];

/// Turns to patterns whose faces show two colours or one. Only the light can show whether a face is
/// another one in the shade.
const PATTERNS: [&str; 10] = [
    "",
    "U2 D2 R2 L2 F2 B2",
    "U R2 F B R B2 R U2 L B2 R U' D' R2 F R' L B2 U2 F2",
    "U2 D2",
    "R2 L2",
    "F2 B2",
    "U D' R L' F B' U D'",
    "U2 D2 R2 L2",
    "U D",
    "R L' U2 D2 F B",
];

/// Returns the colours 0..=5 of the 54 stickers after these turns of a solved cube.
fn pattern(turns: &str) -> [u8; 54] {
    let turns = if turns.is_empty() { Vec::new() } else { parse_turns(turns).unwrap() };
    *turns.into_iter().fold(Facelets::solved(), |cube, turn| cube.turned(turn)).colours()
}

/// Returns the colours 0..=5 of the 54 stickers of a cube that is scrambled with this seed.
fn scrambled(seed: u64) -> [u8; 54] {
    *Facelets::from(&Cube::scrambled(seed)).colours()
}

/// Returns the colours that a camera measures of the 54 stickers. `stickers` are the levels of the
/// six colours, and `gains` is the exposure of each face.
fn photographed(
    state: &[u8; 54],
    stickers: &[[f64; 3]; 6],
    gains: [f64; 6],
    random: &mut Pcg64,
) -> [[f64; 3]; 54] {
    let light = [random.random_range(0.85..1.0), 1.0, random.random_range(0.7..1.0)];
    let slopes: [[f64; 2]; 6] =
        [[0.0; 2]; 6].map(|slope| slope.map(|_| random.random_range(-0.08..0.08)));
    std::array::from_fn(|i| {
        let (column, row) = ((i % 3) as f64 - 1.0, (i % 9 / 3) as f64 - 1.0);
        let [across, down] = slopes[i / 9];
        let lean: f64 = random.sample(StandardNormal);
        let shade = gains[i / 9] * (1.0 + across * column + down * row) * (1.0 + 0.02 * lean);
        let sticker = stickers[usize::from(state[i])];
        std::array::from_fn(|c| {
            let noise: f64 = random.sample(StandardNormal);
            (to_level(to_linear(sticker[c]) * shade * light[c] + 0.004) + 2.0 * noise)
                .clamp(0.0, 255.0)
        })
    })
}

/// Returns a random exposure of each face; 1 is full light.
fn gains(random: &mut Pcg64) -> [f64; 6] {
    [0.0; 6].map(|_| random.random_range(0.5..1.0))
}

/// No cube is refused, and at most three of 1500 readings are doubtful.
#[test]
fn colours_are_read_despite_uneven_exposure() {
    const EACH: u64 = 25;
    let patterns = PATTERNS.iter().flat_map(|turns| [pattern(turns); EACH as usize]);
    let cubes = patterns.chain((0..10 * EACH).map(scrambled));
    let mut random = Pcg64::seed_from_u64(4);
    let mut doubted = 0;
    for (n, truth) in cubes.enumerate() {
        for (maker, stickers) in MAKERS.iter().enumerate() {
            let gains = gains(&mut random);
            let rgb = photographed(&truth, stickers, gains, &mut random);

            let read = decide_cube(&rgb);

            let read = read.unwrap_or_else(|e| panic!("cube {n}, maker {maker}, {gains:?}: {e}"));
            if read.doubtful.is_empty() {
                assert_eq!(read.facelets, truth, "cube {n}, maker {maker}, {gains:?}");
                assert_eq!(read.colours, truth, "cube {n}, maker {maker}, {gains:?}");
            }
            doubted += usize::from(!read.doubtful.is_empty());
        }
    }
    assert!(doubted <= 3, "{doubted} of 1500 are doubted");
}

#[test]
fn shaded_face_keeps_its_colour() {
    let mut random = Pcg64::seed_from_u64(7);
    for stickers in &MAKERS {
        for turns in PATTERNS {
            for face in 0..6 {
                let mut gains = [1.0; 6];
                gains[face] = 0.5;
                let rgb = photographed(&pattern(turns), stickers, gains, &mut random);

                let read = decide_cube(&rgb).unwrap();

                assert_eq!(read.facelets, pattern(turns), "{turns:?}, face {face}");
                assert!(read.doubtful.is_empty(), "{turns:?}, face {face}: {:?}", read.doubtful);
            }
        }
    }
}

#[test]
fn impossible_colour_readings_are_refused_or_marked_doubtful() {
    const TRIALS: u64 = 60;
    let mut random = Pcg64::seed_from_u64(11);
    let mut refused = 0;
    for trial in 0..TRIALS {
        let mut state = scrambled(500 + trial);
        match trial % 3 {
            // The errors are a flipped edge (UR), a twisted corner (URF) and a sticker of another
            // colour (U1).
            0 => state.swap(5, 10),
            1 => (state[8], state[9], state[20]) = (state[9], state[20], state[8]),
            _ => state[0] = (state[0] + 1 + (trial % 5) as u8) % 6,
        }
        let stickers = &MAKERS[trial as usize / 3 % 3];
        let gains = gains(&mut random);

        match decide_cube(&photographed(&state, stickers, gains, &mut random)) {
            Err(Undecided::Impossible { facelets, .. }) => {
                assert_eq!(*facelets, state, "trial {trial}");
                refused += 1;
            }
            Ok(read) => assert!(!read.doubtful.is_empty(), "trial {trial}"),
            Err(other) => panic!("trial {trial}: {other}"),
        }
    }
    assert!(refused >= TRIALS - 3, "{refused} of {TRIALS} are refused");
}
