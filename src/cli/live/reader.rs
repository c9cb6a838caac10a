//! Memory of a cube that is read face by face: which faces were taken, and what a picture adds.
//!
//! | rule | limit | reason |
//! |---|---|---|
//! | a face is taken from pictures in a row that agree | [`STEADY`] | one may be blurred |
//! | ... in place and colour | [`STILL`], [`ALIKE`] | a hand that moves blurs the colours |
//! | a face is known by the colour of its centre | [`CENTRE`] | each centre has its own colour |
//!
//! - in: one picture after another
//! - out: what it shows; after the sixth face the cube, or the reason why there is none

use super::super::cubes::{dominant, is_read};
use crate::vision::colours::{Decision, Undecided, decide_cube, face_letter, is_colourless};
use crate::vision::{DetectorSettings, FaceSighting, detect};
use image::RgbImage;

/// Pictures in a row that must agree.
pub(super) const STEADY: usize = 3;
/// Greatest motion of a tile between two pictures that agree, as a share of the face's width.
const STILL: f64 = 0.05;
/// Greatest mean distance of the colours of two pictures that agree (see [`distance`]). Views of
/// one face that is held still differ by 0.01 at most.
const ALIKE: f64 = 0.04;
/// Greatest distance of two centres of one colour. In rendered pictures red and orange, the nearest
/// colours, are 0.2 apart; the centre of one face differs by 0.03 from view to view.
const CENTRE: f64 = 0.06;
/// Faces of a cube.
const FACES: usize = 6;

/// Face above each face in the usual net, in the order URFDLB.
const ABOVE: [char; FACES] = ['B', 'U', 'U', 'F', 'U', 'U'];

/// The cube, or the reason why the colours make none.
pub(super) type Decided = Result<Decision, Undecided>;

/// Content of a picture.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Seen {
    /// No face, with the reason.
    Nothing(String),
    /// A face that is not still yet.
    Moving,
    /// A face that was taken before: its number in the order of showing.
    Known(usize),
    /// A face that is taken now: its number.
    Taken(usize),
    /// The sixth face, and with it the cube.
    Cube(Box<Decided>),
}

/// Memory of the faces of one cube.
#[derive(Debug, Default)]
pub(super) struct Reader {
    taken: Vec<FaceSighting>,
    /// Face of the last picture, and the number of pictures in a row that agree with it.
    held: Option<(FaceSighting, usize)>,
}

impl Reader {
    /// Looks at the next picture; returns its content and its face.
    pub(super) fn see(&mut self, image: &RgbImage) -> (Seen, Option<FaceSighting>) {
        // A cube that was not read is shown again from its first face on.
        if self.taken.len() == FACES {
            self.taken.clear();
        }
        let face = match face_of(image) {
            Ok(face) => face,
            Err(why) => {
                self.held = None;
                return (Seen::Nothing(why), None);
            }
        };
        (self.add(&face), Some(face))
    }

    /// Returns the faces that were taken, in the order of showing.
    pub(super) fn taken(&self) -> &[FaceSighting] {
        &self.taken
    }

    /// Returns the next face to be shown, in words.
    pub(super) fn wanted(&self) -> String {
        let number = self.taken.len() % FACES;
        format!(
            "show face {}, with {} above it ({} of {FACES})",
            face_letter(number),
            ABOVE[number],
            number + 1
        )
    }

    /// Compares the face of a picture with what is known.
    fn add(&mut self, face: &FaceSighting) -> Seen {
        let same = |other: &FaceSighting| distance(&other.rgb[4], &face.rgb[4]) < CENTRE;
        if let Some(number) = self.taken.iter().position(same) {
            self.held = None;
            return Seen::Known(number);
        }
        let count = match &self.held {
            Some((before, count)) if agree(before, face) => count + 1,
            _ => 1,
        };
        if count < STEADY {
            self.held = Some((face.clone(), count));
            return Seen::Moving;
        }
        self.held = None;
        self.taken.push(face.clone());
        if self.taken.len() < FACES {
            return Seen::Taken(self.taken.len() - 1);
        }
        let mut rgb = [[0.0; 3]; 9 * FACES];
        for (nine, face) in rgb.chunks_mut(9).zip(&self.taken) {
            nine.copy_from_slice(&face.rgb);
        }
        Seen::Cube(Box::new(decide_cube(&rgb)))
    }
}

/// Returns whether the outcome of a reading is a cube, and not a guess.
pub(super) fn is_cube(decided: &Decided) -> bool {
    is_read(decided)
}

/// Returns the main face of a picture, or the reason why there is none.
fn face_of(image: &RgbImage) -> Result<FaceSighting, String> {
    let faces = detect(image, None, &DetectorSettings::default()).map_err(|why| why.to_string())?;
    let face = dominant(faces).ok_or("no face was found")?;
    if is_colourless(&face.rgb) {
        return Err("no colour: the picture is black and white".to_owned());
    }
    Ok(face)
}

/// Returns whether two pictures in a row show a face that is held still.
fn agree(one: &FaceSighting, other: &FaceSighting) -> bool {
    let width = one.width_px();
    let moved = one
        .centres
        .iter()
        .zip(&other.centres)
        .map(|(a, b)| (a.0 - b.0).hypot(a.1 - b.1))
        .fold(0.0, f64::max);
    let differ = one.rgb.iter().zip(&other.rgb).map(|(a, b)| distance(a, b)).sum::<f64>() / 9.0;
    moved < STILL * width && differ < ALIKE
}

/// Returns the distance of two colours, without their brightness: the shares of red, green and blue
/// are compared.
fn distance(one: &[f64; 3], other: &[f64; 3]) -> f64 {
    let share = |rgb: &[f64; 3], c: usize| rgb[c] / rgb.iter().sum::<f64>().max(1.0);
    (0..3).map(|c| (share(one, c) - share(other, c)).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::cell::{Camera, Intrinsics, Mount};
    use crate::cli::frames::FACES as SIDES;
    use crate::cube::{Cube, Facelets};
    use crate::hw::plant::render::{Look, Renderer, cube_alone};
    use crate::spatial::{Pose, pose_from_axes};
    use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

    /// Edge of the cube (m).
    const EDGE: f64 = 0.057;

    /// A cube that is held before a webcam.
    pub(crate) struct Show {
        renderer: Renderer,
        world_from_camera: Pose,
        pub(crate) facelets: [u8; 54],
    }

    impl Show {
        /// Makes a scrambled cube before a camera of 640 x 480 px.
        pub(crate) fn new(scramble: u64) -> Self {
            let intrinsics = Intrinsics {
                width: 640,
                height: 480,
                focal: (600.0, 600.0),
                centre: (319.5, 239.5),
                distortion: (0.0, 0.0),
            };
            let world_from_camera = Pose::from_parts(
                Translation3::new(0.0, 0.0, 1.2),
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2),
            );
            let mount = Mount::World { world_from_camera };
            let camera = Camera { name: "webcam".into(), mount, intrinsics };
            let facelets = *Facelets::from(&Cube::scrambled(scramble)).colours();
            // Each scramble has another light and lens.
            let renderer = Renderer::new(camera, Look::draw(scramble), scramble);
            Self { renderer, world_from_camera, facelets }
        }

        /// Renders a face (0..=5 = URFDLB), moved to the right by `moved` (m), tilted about its
        /// columns by `tilt` and turned in the picture by `turn` (rad).
        pub(crate) fn face(&mut self, face: usize, moved: f64, tilt: f64, turn: f64) -> RgbImage {
            let (_, normal, x, y) = SIDES[face];
            let (normal, x, y) = (Vector3::from(normal), Vector3::from(x), Vector3::from(y));
            let centre = Point3::from(normal * (EDGE / 2.0));
            let cube_from_face = pose_from_axes(x, y, -normal, centre);
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt)
                * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
            let camera_from_face = Pose::from_parts(Translation3::new(moved, 0.0, 0.2), rotation);
            let camera_from_cube = camera_from_face * cube_from_face.inverse();
            let scene = cube_alone(self.world_from_camera * camera_from_cube, EDGE, self.facelets);
            self.renderer.render(&scene, 1.0)
        }
    }

    /// Shows a face until it is taken; returns the last content.
    fn show(reader: &mut Reader, cube: &mut Show, face: usize, turn: f64) -> Seen {
        for _ in 1..STEADY {
            assert_eq!(reader.see(&cube.face(face, 0.0, 0.2, turn)).0, Seen::Moving);
        }
        reader.see(&cube.face(face, 0.0, 0.2, turn)).0
    }

    /// Returns the facelets of a cube that was read, put right if necessary.
    fn facelets(seen: Seen) -> [u8; 54] {
        let Seen::Cube(decided) = seen else { panic!("{seen:?}") };
        match *decided {
            Ok(decision) => decision.facelets,
            Err(Undecided::Misplaced { decision, .. }) => decision.facelets,
            Err(why) => panic!("{why}"),
        }
    }

    #[test]
    fn six_faces_in_order_make_the_cube() {
        let (mut reader, mut cube) = (Reader::default(), Show::new(4));
        assert_eq!(reader.wanted(), "show face U, with B above it (1 of 6)");
        for face in 0..5 {
            assert_eq!(show(&mut reader, &mut cube, face, 0.1), Seen::Taken(face));
            // The face stays before the camera, then the next one is turned to it.
            assert_eq!(reader.see(&cube.face(face, 0.02, -0.3, 0.0)).0, Seen::Known(face));
            assert!(matches!(reader.see(&RgbImage::new(640, 480)).0, Seen::Nothing(_)));
        }
        assert_eq!(reader.wanted(), "show face B, with U above it (6 of 6)");

        let seen = show(&mut reader, &mut cube, 5, 0.1);

        assert_eq!(facelets(seen), cube.facelets);
        assert_eq!(reader.taken().len(), 6);
        // The next picture begins a new cube.
        assert_eq!(reader.see(&cube.face(0, 0.0, 0.2, 0.0)).0, Seen::Moving);
        assert!(reader.taken().is_empty());
    }

    #[test]
    fn turned_and_exchanged_faces_are_put_right() {
        let (mut reader, mut cube) = (Reader::default(), Show::new(7));
        let order = [(0, 0.0), (1, 1.5), (2, 0.0), (3, 0.0), (5, 3.0), (4, 0.0)];
        let mut last = Seen::Moving;
        for (face, turn) in order {
            last = show(&mut reader, &mut cube, face, turn);
        }

        assert_eq!(facelets(last), cube.facelets);
    }

    #[test]
    fn moving_face_is_not_taken() {
        let (mut reader, mut cube) = (Reader::default(), Show::new(4));
        for step in 0..2 * STEADY {
            let picture = cube.face(0, 0.01 * step as f64 - 0.02, 0.1, 0.0);
            assert_eq!(reader.see(&picture).0, Seen::Moving, "{step}");
        }
        // Two pictures agree, then none shows a face: the count begins again.
        let still = cube.face(0, 0.0, 0.1, 0.0);
        reader.see(&still);
        reader.see(&RgbImage::new(640, 480));

        assert_eq!(reader.see(&still).0, Seen::Moving);
        assert!(reader.taken().is_empty());
    }

    #[test]
    fn distances_of_centres_separate_all_colours() {
        let (mut within, mut between) = (0.0_f64, 1.0_f64);
        for seed in 1..9 {
            let mut cube = Show::new(seed);
            let mut centre = |face, tilt| {
                let image = cube.face(face, 0.0, tilt, 0.0);
                face_of(&image).map_or([f64::NAN; 3], |face| face.rgb[4])
            };
            let all: [[f64; 3]; 6] = std::array::from_fn(|face| centre(face, 0.0));
            for (face, one) in all.iter().enumerate() {
                for tilt in [-0.4, 0.3] {
                    within = within.max(distance(one, &centre(face, tilt)));
                }
                for other in &all[..face] {
                    between = between.min(distance(one, other));
                }
            }
        }

        assert!(within < 0.8 * CENTRE && between > 1.3 * CENTRE, "{within} {between}");
    }
}
