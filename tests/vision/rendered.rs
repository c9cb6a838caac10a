//! Tests of the pose of the cube in rendered frames against the truth of the plant's renderer.
//!
//! `cargo test --release --test vision rendered:: -- --nocapture` prints the table.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use rubik_robot::cell::{Camera, Intrinsics, Mount};
use rubik_robot::hw::camera::FrameSource;
use rubik_robot::hw::plant::render::{Look, PlantCamera, Renderer, cube_alone};
use rubik_robot::motion::PERIOD;
use rubik_robot::spatial::{Pose, pose_from_axes};
use rubik_robot::vision::colours::{decide_cube, decide_face};
use rubik_robot::vision::detect::window_around;
use rubik_robot::vision::{DetectorSettings, Method, detect, locate_cube, locate_in, read_face};
use std::hint::black_box;

/// Edge of the cube (m).
const EDGE: f64 = 0.057;

/// Returns the stand-alone camera: at 1.1 m above the origin, looking along +y.
fn camera() -> Camera {
    let world_from_camera =
        pose_from_axes(Vector3::x(), -Vector3::z(), Vector3::y(), Point3::new(0.0, 0.0, 1.1));
    Camera {
        name: "standalone".to_owned(),
        mount: Mount::World { world_from_camera },
        intrinsics: Intrinsics {
            width: 640,
            height: 480,
            focal: (600.0, 600.0),
            centre: (319.5, 239.5),
            distortion: (-0.05, 0.01),
        },
    }
}

/// Errors over many frames, perpendicular to the sight and along it (m).
#[derive(Debug, Default)]
struct Errors {
    sideways: Vec<f64>,
    depth: Vec<f64>,
}

impl Errors {
    /// Notes the error of a point in camera coordinates (m).
    fn push(&mut self, found: Point3<f64>, truth: Point3<f64>) {
        let sight = truth.coords.normalize();
        let error = found - truth;
        let depth = error.dot(&sight);
        self.depth.push(depth.abs());
        self.sideways.push((error - sight * depth).norm());
    }

    /// Returns the root mean square of lengths in metres, in millimetres.
    fn rms(values: &[f64]) -> f64 {
        (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt() * 1e3
    }

    /// Returns the 95th percentile of lengths in metres, in millimetres.
    fn p95(values: &[f64]) -> f64 {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() * 95 / 100).copied().unwrap_or(f64::NAN) * 1e3
    }

    /// Prints both errors as root mean squares and 95th percentiles.
    fn print(&self, name: &str) {
        println!(
            "{name}: {} frames, lateral r.m.s. {:.3} mm (p95 {:.3}), \
             depth r.m.s. {:.3} mm (p95 {:.3})",
            self.depth.len(),
            Self::rms(&self.sideways),
            Self::p95(&self.sideways),
            Self::rms(&self.depth),
            Self::p95(&self.depth),
        );
    }
}

/// Returns a random pose of a cube before the camera of [`camera`], as `world_from_cube`. The
/// dominant face is 100 px wide and tilted by at most `tilt` (rad) from the line of sight.
fn cube_before(random: &mut Pcg64, tilt: f64) -> Pose {
    let frontal = [
        UnitQuaternion::identity(),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI),
    ][random.random_range(0..3)];
    let angle = random.random_range(0.0..std::f64::consts::TAU);
    let lean = Vector3::new(angle.cos(), 0.0, angle.sin()) * random.random_range(0.0..tilt);
    let roll = Vector3::y() * random.random_range(-0.7..0.7);
    let at = Vector3::new(
        random.random_range(-0.07..0.07),
        0.342 + EDGE / 2.0,
        1.1 + random.random_range(-0.05..0.05),
    );
    let rotation =
        UnitQuaternion::from_scaled_axis(lean) * UnitQuaternion::from_scaled_axis(roll) * frontal;
    Pose::from_parts(at.into(), rotation)
}

/// Renders frames of a cube at random poses and measures the poses. Returns the errors of the
/// dominant face's centre, those of the cube's centre where two faces are visible, and the number
/// of frames without a pose. `look` gives light and noise of each frame.
fn measure(name: &str, frames: u64, look: impl Fn(u64) -> Look) -> (Errors, Errors, usize) {
    let mut random = Pcg64::seed_from_u64(7);
    let (mut faces, mut cubes, mut missed) = (Errors::default(), Errors::default(), 0);
    let mut worst: (f64, u64) = (0.0, 0);
    for frame in 0..frames {
        let facelets = std::array::from_fn(|_| random.random_range(0..6));
        let world_from_cube = cube_before(&mut random, 0.7);
        let mut renderer = Renderer::new(camera(), look(frame), frame);
        let image = renderer.render(&cube_alone(world_from_cube, EDGE, facelets), 1.0);
        if let Ok(dir) = std::env::var("VISION_FRAMES") {
            assert!(image.save(format!("{dir}/{name}-{frame:03}.png")).is_ok());
        }
        let camera = camera();
        let Mount::World { world_from_camera } = camera.mount else { unreachable!() };
        let camera_from_cube = world_from_camera.inverse() * world_from_cube;
        let cube = detect(&image, None, &DetectorSettings::default())
            .ok()
            .and_then(|s| locate_in(&image, &s, &camera.intrinsics, EDGE, None));
        let Some(cube) = cube else {
            missed += 1;
            continue;
        };
        let found = Point3::from(cube.camera_from_face().translation.vector);
        let nearest = [Vector3::x(), Vector3::y(), Vector3::z()]
            .into_iter()
            .flat_map(|a| [a, -a])
            .map(|a| camera_from_cube * Point3::from(a * EDGE / 2.0))
            .min_by(|a, b| (a - found).norm().total_cmp(&(b - found).norm()));
        let Some(truth) = nearest else { unreachable!() };
        // No centre of a face is within 15 mm: vision has found something else.
        if (found - truth).norm() > 0.015 {
            missed += 1;
            continue;
        }
        faces.push(found, truth);
        if (found - truth).norm() > worst.0 {
            worst = ((found - truth).norm(), frame);
        }
        if cube.used.len() > 1 {
            cubes.push(
                Point3::from(cube.camera_from_cube.translation.vector),
                Point3::from(camera_from_cube.translation.vector),
            );
        }
    }
    println!("{name}: {missed} missed, worst frame {} with {:.2} mm", worst.1, worst.0 * 1e3);
    faces.print("  dominant face's centre");
    cubes.print("  cube's centre, two or three faces");
    (faces, cubes, missed)
}

#[test]
fn cube_is_localised_in_studio_light() {
    let (faces, cubes, missed) = measure("studio", 60, |_| Look::studio());

    // The limits of `rms` and `p95` are in millimetres.
    assert!(missed <= 1, "{missed} missed");
    assert!(Errors::rms(&faces.sideways) < 0.05 && Errors::p95(&faces.sideways) < 0.25);
    assert!(Errors::rms(&faces.depth) < 0.4 && Errors::p95(&faces.depth) < 2.0);
    assert!(cubes.depth.len() > 20 && Errors::rms(&cubes.sideways) < 0.1);
}

#[test]
fn cube_is_localised_in_random_light_and_noise() {
    let noisy = |seed| {
        let mut look = Look::draw(seed);
        (look.sensor.read_noise, look.sensor.shot_noise) = (6.0, 0.0);
        look
    };
    let (faces, cubes, missed) = measure("drawn", 120, noisy);

    // The limits of `rms` and `p95` are in millimetres.
    assert!(missed <= 6, "{missed} missed");
    assert!(Errors::rms(&faces.sideways) < 0.1 && Errors::p95(&faces.sideways) < 0.25);
    assert!(Errors::rms(&faces.depth) < 0.8 && Errors::p95(&faces.depth) < 2.0);
    assert!(cubes.depth.len() > 40 && Errors::rms(&cubes.sideways) < 0.2);
}

/// Takes a picture, with this exposure, of a cube that crosses the line of sight at `speed` (m/s).
/// The cube is 0.342 m before the camera 2 s after the start; `period` is the servo period of the
/// picture. Returns how much later than the picture's stamp the cube was where the picture shows it
/// (s).
fn light_after_stamp(speed: Vector3<f64>, exposure: f64, period: u64) -> f64 {
    let at = |period: u64| {
        let way = speed * (period as f64 * PERIOD - 2.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.3);
        Pose::from_parts((Vector3::new(0.0, 0.342 + EDGE / 2.0, 1.1) + way).into(), turn)
    };
    let facelets = std::array::from_fn(|i| ((i * 7 + i / 5) % 6) as u8);
    let mut scene = cube_alone(at(period), EDGE, facelets);
    scene.period = period;
    scene.cube.velocity.linear = speed;
    let renderer = Renderer::new(camera(), Look::draw(3), 3);
    let (_, scenes) = triple_buffer::triple_buffer(&scene);
    // The sensor asks for a picture in a later period; the stamp is the period of the scene.
    let frame = PlantCamera::new(renderer, scenes).grab(period + 7, exposure).unwrap();
    assert_eq!(frame.period, period);

    let camera = camera();
    let Mount::World { world_from_camera } = camera.mount else { unreachable!() };
    let cube = detect(&frame.image, None, &DetectorSettings::default())
        .ok()
        .and_then(|s| locate_in(&frame.image, &s, &camera.intrinsics, EDGE, None))
        .unwrap();
    let found = world_from_camera * Point3::from(cube.camera_from_face().translation.vector);
    let offset = found - at(frame.period) * Point3::new(0.0, -EDGE / 2.0, 0.0);
    offset.dot(&speed) / speed.norm_squared()
}

#[test]
fn picture_shows_cube_at_time_of_its_stamp() {
    // An error of 0.1 mm in the pose is 0.5 ms of this motion; a stamp that is wrong by a period is
    // off by 2 ms.
    let speed = Vector3::new(0.2, 0.0, 0.05);
    for exposure in [0.5, 1.0, 2.0] {
        let late: Vec<f64> =
            [990, 1000, 1013].map(|period| light_after_stamp(speed, exposure, period)).into();
        println!("exposure {exposure}: the light is {late:?} s later");
        assert!(late.iter().all(|late| late.abs() < 1e-3), "exposure {exposure}: {late:?}");
    }
}

/// Returns the postument's hand camera, a scene and the true `camera_from_face`. The camera looks
/// from 0.2 m, with a roll (rad), at the front face of a cube. The track's gripper holds the cube
/// by the face on the camera's left if `side`, else by the back.
fn in_hand(roll: f64, side: bool) -> (Camera, rubik_robot::hw::scene::Scene, Pose) {
    let world_from_cube = Pose::translation(0.0, 0.9, 1.1);
    let facelets = std::array::from_fn(|i| ((i * 7 + i / 5) % 6) as u8);
    let mut scene = cube_alone(world_from_cube, EDGE, facelets);
    let arm = |world_from_tool: Pose, opening: f64| {
        let world_from_flange = world_from_tool * Pose::translation(0.0, 0.0, -0.25);
        let flange = Point3::from(world_from_flange.translation.vector);
        let far = Point3::new(-0.9, 0.9, 0.9);
        let elbow = nalgebra::center(&far, &flange) + Vector3::z() * 0.3;
        rubik_robot::hw::scene::SceneArm {
            points: [Point3::new(-0.9, 0.9, 0.0), far, elbow, flange, flange],
            world_from_tool,
            world_from_flange,
            opening,
        }
    };
    scene.arm_count = 2;
    // The gripper's z points into the cube: +x from the face on the left, -y from the back.
    let (y, z) = if side { (Vector3::y(), Vector3::x()) } else { (Vector3::x(), -Vector3::y()) };
    let centre = Point3::from(world_from_cube.translation.vector);
    scene.arms[0] = arm(pose_from_axes(y.cross(&z), y, z, centre - z * (EDGE / 3.0)), EDGE);
    // The camera looks along +y at the front face.
    let sight = Vector3::y();
    let x = Vector3::x() * roll.cos() - Vector3::z() * roll.sin();
    let eye = centre - sight * (0.2 + EDGE / 2.0);
    let world_from_camera = pose_from_axes(x, sight.cross(&x), sight, eye);
    let flange_from_camera =
        Pose::new(Vector3::new(0.0551, 0.0, 0.13), Vector3::z() * -std::f64::consts::FRAC_PI_2);
    let flange = world_from_camera * flange_from_camera.inverse();
    scene.arms[1] = arm(flange * Pose::translation(0.0, 0.0, 0.25), 0.08);
    let camera = Camera {
        name: "postument_hand".to_owned(),
        mount: Mount::Flange { arm: 1, flange_from_camera },
        intrinsics: Intrinsics {
            width: 384,
            height: 288,
            focal: (500.0, 500.0),
            centre: (191.5, 143.5),
            distortion: (-0.05, 0.01),
        },
    };
    let front = pose_from_axes(
        Vector3::x(),
        -Vector3::z(),
        Vector3::y(),
        Point3::from(world_from_cube.translation.vector) - Vector3::y() * (EDGE / 2.0),
    );
    (camera, scene, world_from_camera.inverse() * front)
}

#[test]
fn hand_camera_reads_colours_of_held_cube() {
    let mut random = Pcg64::seed_from_u64(3);
    let (mut wrong, mut covered, mut refused, mut frames) = (0, 0, 0, 0);
    let mut errors = Errors::default();
    for (side, quarter) in (0..24).map(|k| (k % 2 == 0, k / 2 % 4)) {
        let roll = f64::from(quarter) * std::f64::consts::FRAC_PI_2;
        let (camera, scene, camera_from_face) = in_hand(roll, side);
        let seed = random.random_range(0..1000);
        let mut renderer = Renderer::new(camera.clone(), Look::draw(seed), seed);
        let image = renderer.render(&scene, 1.0);
        if let Ok(dir) = std::env::var("VISION_FRAMES") {
            image.save(format!("{dir}/hand-{frames:02}.png")).unwrap();
        }
        let astray = Pose::new(
            Vector3::from_fn(|_, _| random.random_range(-0.003..0.003)),
            Vector3::from_fn(|_, _| random.random_range(-0.02..0.02)),
        );
        frames += 1;
        let Ok(reading) = read_face(&image, &camera.intrinsics, EDGE, &(camera_from_face * astray))
        else {
            refused += 1;
            continue;
        };
        errors.push(
            Point3::from(reading.camera_from_face.translation.vector),
            Point3::from(camera_from_face.translation.vector),
        );
        // Facelets 18..27 are those of the front face.
        for i in 0..9 {
            if reading.occluded[i] {
                covered += 1;
            } else if reading.colours[i] != scene.cube.facelets[18 + i] {
                wrong += 1;
                println!("frame {} tile {i}: {:?}", frames - 1, reading);
            }
        }
    }
    println!("hand: {frames} frames, {refused} refused, {covered} tiles covered, {wrong} wrong");
    errors.print("  face's centre");

    assert_eq!((refused, wrong), (0, 0));
    // A finger of the gripper on the left hides one tile in each of twelve frames.
    assert!(covered <= 12, "{covered} tiles are reported as covered");
    // The limits are in millimetres.
    assert!(Errors::rms(&errors.sideways) < 0.3 && Errors::rms(&errors.depth) < 1.5);
}

/// Returns the median time of 60 calls (ms).
fn median_ms<T>(mut call: impl FnMut() -> T) -> f64 {
    let mut times: Vec<f64> = (0..60)
        .map(|_| {
            let start = std::time::Instant::now();
            black_box(call());
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

#[test]
#[ignore = "measures time: cargo test --release --test vision rendered:: -- --ignored --nocapture"]
fn print_times_of_vision_functions() {
    let mut random = Pcg64::seed_from_u64(5);
    let facelets = std::array::from_fn(|_| random.random_range(0..6));
    let pose = cube_before(&mut random, 0.7);
    let camera = camera();
    let image = Renderer::new(camera.clone(), Look::draw(1), 1)
        .render(&cube_alone(pose, EDGE, facelets), 1.0);
    let settings = DetectorSettings::default();
    let faces = detect(&image, None, &settings).unwrap();
    let window = window_around(&faces[0].corners, 0.5);
    let paper = DetectorSettings { method: Method::Paper2007, ..settings };
    let rgb = std::array::from_fn(|i| faces[0].rgb[i % 9]);
    let show = |name: &str, ms: f64| println!("{name}: {ms:.3} ms");
    show("whole frame 640x480", median_ms(|| detect(&image, None, &settings)));
    show("window", median_ms(|| detect(&image, window, &settings)));
    show("whole frame, paper's colours", median_ms(|| detect(&image, None, &paper)));
    show("window, paper's colours", median_ms(|| detect(&image, window, &paper)));
    let locate = || locate_cube(&faces, &camera.intrinsics, EDGE, None);
    show("pose of the cube from centroids", median_ms(locate));
    let refined = || locate_in(&image, &faces, &camera.intrinsics, EDGE, None);
    show("pose of the cube on edges", median_ms(refined));
    show("colours of one face", median_ms(|| decide_face(&faces[0].rgb)));
    show("colours of a cube", median_ms(|| decide_cube(&rgb)));
    println!(
        "faces: {}, paper's: {:?}",
        faces.len(),
        detect(&image, None, &paper).map(|f| f.len())
    );
}
