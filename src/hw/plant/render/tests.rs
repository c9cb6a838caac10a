//! Tests of the renderer: geometry against the projection and a second ray tracer, and each fault
//! of lens, light and sensor by itself.

use super::*;
use crate::cell::Intrinsics;

use crate::spatial::pose_from_axes;

/// Edge of the cube (m).
const EDGE: f64 = 0.057;
/// Height of the fixed camera and of the cube in front of it (m).
const HEIGHT: f64 = 1.1;

/// Returns the intrinsics of a camera without distortion; `focal` is the focal length (px).
fn intrinsics(width: u32, height: u32, focal: f64) -> Intrinsics {
    let centre = (f64::from(width) / 2.0 - 0.5, f64::from(height) / 2.0 - 0.5);
    Intrinsics { width, height, focal: (focal, focal), centre, distortion: (0.0, 0.0) }
}

/// Returns a camera 1.1 m above the world's origin that looks along +y, with x to the right.
fn standing() -> Camera {
    let world_from_camera =
        pose_from_axes(Vector3::x(), -Vector3::z(), Vector3::y(), Point3::new(0.0, 0.0, HEIGHT));
    Camera {
        name: "standalone".to_owned(),
        mount: Mount::World { world_from_camera },
        intrinsics: intrinsics(640, 480, 600.0),
    }
}

/// Returns the stickers of a solved cube.
fn solved() -> [u8; 54] {
    std::array::from_fn(|i| (i / 9) as u8)
}

/// Returns stickers on which the six colours are mixed.
fn mixed() -> [u8; 54] {
    std::array::from_fn(|i| ((i * 7 + i / 5) % 6) as u8)
}

/// Returns the pose of a cube at `depth` (m) in front of the fixed camera, turned by a rotation
/// vector.
fn facing(depth: f64, turn: [f64; 3]) -> Pose {
    Pose::new(Vector3::new(0.0, depth, HEIGHT), Vector3::from(turn))
}

/// Makes a scene in which a hand holds the cube and the track's gripper comes from -x, `distance`
/// (m) short of its grasp.
fn hand_over(world_from_cube: Pose, distance: f64) -> Scene {
    let mut scene = cube_alone(world_from_cube, EDGE, mixed());
    scene.arm_count = 2;
    let tool = world_from_cube
        * pose_from_axes(
            Vector3::z(),
            Vector3::y(),
            -Vector3::x(),
            Point3::new(-EDGE / 3.0 - distance, 0.0, 0.0),
        )
        * Pose::rotation(Vector3::y() * std::f64::consts::PI);
    scene.arms[0] = arm(tool, Point3::new(-0.75, 0.35, 0.0), 0.075);
    let away = Pose::new(Vector3::new(0.55, 1.1, HEIGHT + 0.15), Vector3::new(1.2, 0.4, 0.3));
    scene.arms[1] = arm(away, Point3::new(0.5, 1.9, 0.0), 0.06);
    scene.hand = Some(world_from_cube);
    scene
}

/// Makes an arm with its base at `base` and its tool at this pose, in a plausible posture with the
/// elbow above the line from shoulder to wrist. `opening` is that of the jaws (m).
fn arm(world_from_tool: Pose, base: Point3<f64>, opening: f64) -> SceneArm {
    let world_from_flange = world_from_tool * Pose::translation(0.0, 0.0, -0.25);
    let flange = Point3::from(world_from_flange.translation.vector);
    let wrist = world_from_flange * Point3::new(0.0, 0.0, -0.19);
    let shoulder = base + Vector3::z() * 0.95;
    let elbow = nalgebra::center(&shoulder, &wrist) + Vector3::z() * 0.35;
    let points = [base, shoulder, elbow, wrist, flange];
    SceneArm { points, world_from_tool, world_from_flange, opening }
}

/// Makes the camera in the postument's hand, and a scene in which it looks, from 0.2 m, at the face
/// of the cube opposite the track's palm.
fn in_hand() -> (Camera, Scene) {
    let world_from_cube = facing(0.9, [0.0; 3]);
    let mut scene = hand_over(world_from_cube, 0.0);
    scene.hand = None;
    scene.arms[0].opening = EDGE;
    let (y, z) = (-Vector3::z(), -Vector3::x());
    let x = y.cross(&z);
    let centre = Point3::from(world_from_cube.translation.vector) - z * (0.2 + EDGE / 2.0);
    let world_from_camera = pose_from_axes(x, y, z, centre);
    let flange_from_camera = Pose::new(
        Vector3::new(0.0551, 0.0, 0.13),
        Vector3::new(0.0, 0.0, -std::f64::consts::FRAC_PI_2),
    );
    let flange = world_from_camera * flange_from_camera.inverse();
    scene.arms[1] =
        arm(flange * Pose::translation(0.0, 0.0, 0.25), Point3::new(1.6, 1.2, 0.0), 0.08);
    let mount = Mount::Flange { arm: 1, flange_from_camera };
    let camera = Camera {
        name: "postument_hand".to_owned(),
        mount,
        intrinsics: intrinsics(384, 288, 420.0),
    };
    (camera, scene)
}

/// Returns a setting with the table below the cube of [`facing`] and walls around the camera.
fn setting() -> Setting {
    Setting {
        table: Point3::new(0.0, 0.85, 0.75),
        room: (Point3::new(-2.0, -1.5, 0.0), Point3::new(2.0, 2.8, 2.8)),
        ..Setting::default()
    }
}

/// Makes a renderer with the look of [`Look::studio`], which shows geometry alone, after `change`
/// has modified this look.
fn studio(camera: Camera, change: impl FnOnce(&mut Look)) -> Renderer {
    let mut look = Look::studio();
    change(&mut look);
    Renderer::new(camera, look, 1).with_setting(setting())
}

/// Returns the mean of a pixel's three channels, 0 to 255.
fn brightness(image: &RgbImage, x: u32, y: u32) -> f64 {
    image.get_pixel(x, y).0.iter().map(|c| f64::from(*c)).sum::<f64>() / 3.0
}

/// Computes the centre (px) of the image of a white square patch: the mean of the patch's points,
/// weighted by the area of their images. `project` takes patch coordinates (m) to pixels, `half` is
/// half the patch's side (m).
fn centre_of_image(project: impl Fn(f64, f64) -> (f64, f64), half: f64) -> (f64, f64) {
    let (mut sum, mut sx, mut sy) = (0.0, 0.0, 0.0);
    let n = 80;
    let (step, small) = (2.0 * half / f64::from(n), 1e-5);
    for i in 0..n {
        for j in 0..n {
            let (u, v) = ((f64::from(i) + 0.5) * step - half, (f64::from(j) + 0.5) * step - half);
            let (p, pu, pv) = (project(u, v), project(u + small, v), project(u, v + small));
            let area = ((pu.0 - p.0) * (pv.1 - p.1) - (pu.1 - p.1) * (pv.0 - p.0)).abs();
            sum += area;
            sx += area * p.0;
            sy += area * p.1;
        }
    }
    (sx / sum, sy / sum)
}

/// The centroids of rendered stickers also match with distortion and defocus, since the detector
/// relies on this accuracy.
#[test]
fn sticker_centroids_match_projection() {
    let mut camera = standing();
    camera.intrinsics.distortion = (-0.09, 0.02);
    let Mount::World { world_from_camera } = camera.mount else { unreachable!() };
    let optics = camera.intrinsics;
    let (pitch, share) = (EDGE / 3.0, 0.78);
    let sticker = share * pitch;
    for (defocus, place, turn) in [
        (0.0, Vector3::new(0.03, 0.342, HEIGHT), Vector3::new(0.4, 0.1, 0.5)),
        (0.0, Vector3::new(-0.1, 0.342, HEIGHT + 0.07), Vector3::zeros()),
        (0.5, Vector3::new(0.12, 0.40, HEIGHT - 0.08), Vector3::new(-0.3, 0.2, -0.6)),
    ] {
        let world_from_cube = Pose::new(place, turn);
        // White stickers on black, so that the brightness of a pixel is the share they cover.
        let mut renderer = studio(camera.clone(), |look| {
            look.cube.corner = 0.0;
            look.cube.sticker = share;
            look.cube.body = [0.0; 3];
            look.lens.defocus = defocus;
        });
        let image = renderer.render(&cube_alone(world_from_cube, EDGE, [0; 54]), 1.0);

        let mut checked = 0;
        for face in crate::cube::Face::ALL {
            let (u, v) = face.reading_axes();
            let camera_from_cube = world_from_camera.inverse() * world_from_cube;
            let towards = camera_from_cube * Point3::from(face.normal() * (EDGE / 2.0));
            let slant =
                -(camera_from_cube.rotation * face.normal()).dot(&towards.coords.normalize());
            if slant < 0.45 {
                continue;
            }
            for cell in 0..9_i32 {
                let centre = face.normal() * (EDGE / 2.0)
                    + (u * f64::from(cell % 3 - 1) + v * f64::from(cell / 3 - 1)) * pitch;
                let project = |du: f64, dv: f64| {
                    optics.project(&(camera_from_cube * Point3::from(centre + u * du + v * dv)))
                };
                let expected = centre_of_image(project, sticker / 2.0);
                let (mut sum, mut sx, mut sy) = (0.0, 0.0, 0.0);
                let plane = camera_from_cube * Point3::from(centre);
                let normal = camera_from_cube.rotation * face.normal();
                for y in expected.1 as u32 - 30..expected.1 as u32 + 30 {
                    for x in expected.0 as u32 - 30..expected.0 as u32 + 30 {
                        let (dx, dy) = optics.unproject((f64::from(x), f64::from(y)));
                        let ray = Vector3::new(dx, dy, 1.0);
                        let hit =
                            ray * (normal.dot(&plane.coords) / normal.dot(&ray)) - plane.coords;
                        let hit = camera_from_cube.rotation.inverse() * hit;
                        // Up to 0.47 of the cell's side, so that neighbours and background are out.
                        if hit.dot(&u).abs().max(hit.dot(&v).abs()) < 0.47 * pitch {
                            let weight = brightness(&image, x, y);
                            sum += weight;
                            sx += weight * f64::from(x);
                            sy += weight * f64::from(y);
                        }
                    }
                }
                let off = (sx / sum - expected.0).hypot(sy / sum - expected.1);
                assert!(off < 0.05, "{face:?} {cell}: {off:.3} px off at defocus {defocus}");
                checked += 1;
            }
        }
        assert!(checked >= 9, "{checked}");
    }
}

/// The reference is [`picture`], which intersects each solid in `f64`.
#[test]
fn depths_agree_with_plain_ray_tracer() {
    let mut camera = standing();
    camera.intrinsics.distortion = (-0.12, 0.03);
    let Mount::World { world_from_camera } = camera.mount else { unreachable!() };
    let mut scene = hand_over(facing(0.6, [0.1, 0.3, -0.2]), 0.05);
    scene.cube.turned = (Axis::Y, 0.3, -0.6);
    let mut renderer = studio(camera, |_| ());

    renderer.render(&scene, 1.0);

    let mut solids = Solids::default();
    solids.add_moving(&scene, &setting(), renderer.look(), None);
    solids.add_furniture(&setting());
    let eye = Point3::from(world_from_camera.translation.vector);
    let mut seen = 0;
    let mut differ = 0;
    for row in (0..480).step_by(3) {
        let (from, to) = renderer.view.span(row);
        for column in (0..640).step_by(3) {
            let pixel = row * 640 + column;
            let ray =
                Vector3::new(renderer.rays.x[pixel].into(), renderer.rays.y[pixel].into(), 1.0);
            let length = ray.norm();
            let ray = world_from_camera.rotation * ray / length;
            let expected = picture::distance(&solids, &eye, &ray).map_or(0.0, |t| length / t);
            let inside = (from..to).contains(&column);
            let got = if inside { renderer.view.depth()[pixel] } else { renderer.behind[pixel] };
            seen += usize::from(expected > 0.0);
            differ += usize::from((f64::from(got) - expected).abs() > 1e-3 * expected);
        }
    }
    // On the edge of a solid the rounding to `f32` may decide otherwise.
    assert!(seen > 8000 && differ <= seen / 2000, "{differ} of {seen} differ");
}

#[test]
fn gripper_hides_cube_only_when_nearer_to_camera() {
    let world_from_cube = facing(0.5, [0.0; 3]);
    let mut renderer = studio(standing(), |_| ());
    let free = renderer.render(&cube_alone(world_from_cube, EDGE, [3; 54]), 1.0);
    let with_gripper_at = |y: f64| {
        let mut scene = cube_alone(world_from_cube, EDGE, [3; 54]);
        scene.arm_count = 1;
        scene.arms[0] =
            arm(Pose::translation(0.0, y, HEIGHT + 0.05), Point3::new(3.0, 0.0, 0.0), 0.06);
        scene
    };

    let before = renderer.render(&with_gripper_at(0.4), 1.0);
    let behind = renderer.render(&with_gripper_at(0.6), 1.0);

    let yellow = *free.get_pixel(320, 240);
    assert!(yellow[0] > 100 && yellow[2] < 40, "{yellow:?}");
    assert_eq!(*behind.get_pixel(320, 240), yellow);
    assert_ne!(*before.get_pixel(320, 240), yellow);
}

/// Without a fingertip in front no sticker is covered, with one to three at least one is.
#[test]
fn fingertips_cover_three_stickers_at_most() {
    let world_from_cube = facing(0.35, [0.0; 3]);
    for fingers in 0..=3 {
        let mut renderer = studio(standing(), |look| {
            look.hand.front_fingers = fingers;
            look.hand.reach = 0.014;
        });
        let mut scene = cube_alone(world_from_cube, EDGE, [5; 54]);
        scene.hand = Some(world_from_cube);

        let image = renderer.render(&scene, 1.0);

        let front = 0.35 - EDGE / 2.0;
        let pixels = |metres: f64| metres * 600.0 / front;
        let mut covered = 0;
        for cell in 0..9_i32 {
            let on_skin = (0..9_i32).any(|point| {
                let place = |cell: i32, point: i32| {
                    pixels((f64::from(cell - 1) + 0.25 * f64::from(point - 1)) * EDGE / 3.0)
                };
                let (x, y) = (place(cell % 3, point % 3), place(cell / 3, point / 3));
                let rgb = image.get_pixel((319.5 + x).round() as u32, (239.5 + y).round() as u32);
                // Skin is more red than blue, other than the blue stickers.
                rgb[0] > rgb[2]
            });
            covered += u8::from(on_skin);
        }
        assert!(
            covered <= 3 && (fingers == 0) == (covered == 0),
            "{fingers} fingers, {covered} tiles"
        );
    }
}

/// At 45 degrees the corners of the front layer project beyond the edges of the cube.
#[test]
fn turned_layer_moves_its_stickers() {
    let world_from_cube = facing(0.4, [0.0; 3]);
    let mut scene = cube_alone(world_from_cube, EDGE, solved());
    let mut renderer = studio(standing(), |_| ());
    let straight = renderer.render(&scene, 1.0);
    let front = 0.4 - EDGE / 2.0;
    // A row that is a quarter of half the edge above the straight cube.
    let at = (239.5 - 600.0 / front * EDGE * 0.5 * 1.25).round() as u32;

    scene.cube.turned = (Axis::Y, std::f64::consts::FRAC_PI_4, 0.0);
    let turned = renderer.render(&scene, 1.0);

    let is_green = |image: &RgbImage| {
        let rgb = image.get_pixel(320, at).0;
        rgb[1] > 60 && rgb[0] < 20
    };
    assert!(!is_green(&straight) && is_green(&turned));
    // The centre of the layer does not move.
    assert_eq!(straight.get_pixel(320, 240), turned.get_pixel(320, 240));
}

/// The cube is turned by -0.4 rad and both outer layers by 0.4 rad, so only the middle layer turns.
#[test]
fn outer_layer_angles_are_relative_to_middle_layer() {
    let mut turned = cube_alone(facing(0.4, [0.2, 0.1, 0.3]), EDGE, mixed());
    let mut whole = turned;
    let quarter = std::f64::consts::FRAC_PI_2;
    whole.cube.world_from_cube *= Pose::rotation(Vector3::z() * quarter);
    turned.cube.world_from_cube = whole.cube.world_from_cube * Pose::rotation(Vector3::z() * -0.4);
    turned.cube.turned = (Axis::Z, 0.4, 0.4);
    let mut renderer = studio(standing(), |_| ());

    let (a, b) = (renderer.render(&whole, 1.0), renderer.render(&turned, 1.0));

    // The outer layers coincide with those of the straight cube.
    let differ = a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
    let cube = 60 * 60;
    assert!(differ > 200 && differ < cube, "{differ}");
}

#[test]
fn capped_camera_sees_only_read_noise() {
    let mut look = Look { lens_cap: true, ..Look::default() };
    look.sensor.bayer = false;
    let mut renderer = Renderer::new(standing(), look, 5);
    let image = renderer.render(&hand_over(facing(0.5, [0.0; 3]), 0.1), 1.0);

    let mean =
        image.as_raw().iter().map(|c| f64::from(*c)).sum::<f64>() / image.as_raw().len() as f64;
    // The mean of a Gaussian of 2.5 whose negative half is clipped to 0.
    assert!((mean - 2.5 / std::f64::consts::TAU.sqrt()).abs() < 0.1, "{mean}");
    assert!(*image.as_raw().iter().max().unwrap() < 20);
}

#[test]
fn equal_seeds_render_equal_frames() {
    let scene = hand_over(facing(0.5, [0.1, 0.0, 0.2]), 0.1);
    let frames = |seed| {
        let mut renderer = Renderer::new(standing(), Look::draw(4), seed);
        (renderer.render(&scene, 1.0), renderer.render(&scene, 1.0))
    };

    assert_eq!(frames(3), frames(3));
    assert_ne!(frames(3).0, frames(4).0);
    assert_ne!(frames(3).0, frames(3).1, "noise is new in each frame");
}

#[test]
fn brightness_is_proportional_to_exposure_up_to_white() {
    let scene = cube_alone(facing(0.4, [0.0; 3]), EDGE, [5; 54]);
    let mut renderer = studio(standing(), |_| ());

    let [half, one, two] = [0.5, 1.0, 2.0].map(|e| renderer.render(&scene, e));

    for (x, y) in [(320, 240), (100, 100), (500, 400)] {
        let blue = |image: &RgbImage| f64::from(image.get_pixel(x, y)[2]);
        assert!((blue(&half) * 2.0 - blue(&one)).abs() <= 2.0, "{} {}", blue(&half), blue(&one));
        let expected = (blue(&one) * 2.0).min(255.0);
        assert!((blue(&two) - expected).abs() <= 2.0, "{} {}", blue(&two), blue(&one));
    }
}

#[test]
fn rendered_noise_has_configured_standard_deviation() {
    for read in [2.0, 6.0, 12.0] {
        let mut renderer = studio(standing(), |look| look.sensor.read_noise = read);
        let image = renderer.render(&cube_alone(facing(0.12, [0.0; 3]), EDGE, [5; 54]), 1.0);
        let values: Vec<f64> = (300..340)
            .flat_map(|x| (220..260).map(move |y| (x, y)))
            .map(|(x, y)| f64::from(image.get_pixel(x, y)[2]))
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
        assert!((variance.sqrt() / read - 1.0).abs() < 0.1, "{} for {read}", variance.sqrt());
    }
}

#[test]
fn shadow_leaves_only_ambient_light_beyond_its_edge() {
    let scene = cube_alone(facing(0.35, [0.0; 3]), EDGE, [0; 54]);
    let mut renderer = studio(standing(), |look| {
        look.light.ambient = 0.4;
        look.light.key = 0.6;
        look.light.key_direction = -Vector3::y();
        look.light.shadow = Some(Shadow {
            point: Point3::new(0.0, 0.35, HEIGHT),
            normal: Vector3::x(),
            softness: 0.004,
            depth: 1.0,
        });
    });

    let image = renderer.render(&scene, 1.0);

    // The left and the right column of stickers. A vertical face gets 0.82 of the ambient light.
    let (lit, dark) = (brightness(&image, 284, 240), brightness(&image, 355, 240));
    let expected = (0.82 * 0.4 + 0.6) / (0.82 * 0.4);
    assert!((lit / dark / expected - 1.0).abs() < 0.03, "{lit} {dark}");
}

#[test]
fn motion_blur_width_is_about_speed_times_exposure() {
    let mut scene = cube_alone(facing(0.4, [0.0; 3]), EDGE, [0; 54]);
    let mut renderer = studio(standing(), |look| look.sensor.exposure_time = 0.01);
    // A ramp from 0 to 1 of width w has the integral w / 6 of (1 - b) b over its brightness b.
    let mut width = |speed: f64| {
        scene.cube.velocity.linear.x = speed;
        let image = renderer.render(&scene, 1.0);
        let inside = brightness(&image, 288, 240);
        let border: Vec<f64> = (274..290).map(|x| brightness(&image, x, 240) / inside).collect();
        let low = border.iter().copied().fold(1.0, f64::min);
        border.iter().map(|b| (b - low) / (1.0 - low)).map(|b| (1.0 - b) * b).sum::<f64>() * 6.0
    };

    let (still, moving) = (width(0.0), width(0.25));

    // 0.25 m/s over 10 ms are 2.5 mm, which at 0.3715 m are 4.04 px. The sub-frames make the ramp a
    // staircase, which measures narrower.
    assert!(still < 1.0 && (3.0..4.2).contains(&moving), "{still} {moving}");
}

#[test]
fn mosaic_preserves_colours_of_uniform_areas() {
    let scene = cube_alone(facing(0.12, [0.0; 3]), EDGE, [4; 54]);
    let plain = studio(standing(), |_| ()).render(&scene, 1.0);
    let mosaic = studio(standing(), |look| look.sensor.bayer = true).render(&scene, 1.0);

    for (x, y) in [(320, 240), (321, 240), (320, 241), (321, 241)] {
        let (a, b) = (plain.get_pixel(x, y).0, mosaic.get_pixel(x, y).0);
        assert!(a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 1), "{a:?} {b:?}");
    }
    let mean = |image: &RgbImage| {
        image.as_raw().iter().map(|c| f64::from(*c)).sum::<f64>() / image.as_raw().len() as f64
    };
    assert!((mean(&plain) - mean(&mosaic)).abs() < 0.5);
}

#[test]
fn frames_do_not_depend_on_earlier_scenes() {
    let mut busy = hand_over(facing(0.5, [0.1, 0.0, 0.2]), 0.1);
    busy.cube.velocity.linear = Vector3::new(0.4, 0.0, 0.2);
    let calm = cube_alone(facing(0.7, [0.0; 3]), EDGE, mixed());
    let with_bayer = |look: &mut Look| {
        look.sensor.bayer = true;
        look.sensor.exposure_time = 0.01;
    };
    let mut used = studio(standing(), with_bayer);
    used.render(&busy, 1.0);
    used.render(&busy, 0.5);

    let after = used.render(&calm, 0.5);

    assert_eq!(after, studio(standing(), with_bayer).render(&calm, 0.5));
}

#[test]
fn hand_camera_sees_cube_and_fails_without_arm() {
    let (camera, mut scene) = in_hand();
    let mut renderer = studio(camera.clone(), |_| ());
    let image = renderer.render(&scene, 1.0);

    // The face opposite the palm is 57 mm wide at 0.20 m: 120 px with f = 420 px.
    let corner = [(-55, -55), (55, -55), (-55, 55), (55, 55)];
    for (dx, dy) in corner {
        let rgb = image.get_pixel((192 + dx) as u32, (144 + dy) as u32).0;
        let spread = rgb.iter().max().unwrap() - rgb.iter().min().unwrap();
        assert!(spread > 60 || rgb[0] > 150, "no sticker at {dx} {dy}: {rgb:?}");
    }
    scene.arm_count = 1;
    let (mut input, output) = triple_buffer::triple_buffer(&scene);
    let mut source = PlantCamera::new(studio(camera, |_| ()), output);
    assert!(source.grab(0, 1.0).is_err());
    scene.arm_count = 2;
    scene.period = 77;
    input.write(scene);
    assert_eq!(source.grab(80, 1.0).unwrap().period, 77);
    assert!(source.grab(80, 0.0).is_err());
}

/// Writes pictures of the cameras into the temporary folder for a look at them. Run with
/// `cargo test --release --lib renderer_writes -- --ignored --nocapture`.
#[test]
#[ignore = "writes pictures into the temporary folder and measures time"]
fn renderer_writes_sample_pictures() {
    let folder = std::env::temp_dir().join("rubik-robot-render");
    std::fs::create_dir_all(&folder).unwrap();
    let save = |name: &str, image: &RgbImage| image.save(folder.join(name)).unwrap();
    let time = |name: &str, renderer: &mut Renderer, scene: &Scene| {
        for _ in 0..10 {
            renderer.render(scene, 1.0);
        }
        let mut times: Vec<_> = (0..100)
            .map(|_| {
                let start = std::time::Instant::now();
                std::hint::black_box(renderer.render(scene, 1.0));
                start.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        times.sort_by(f64::total_cmp);
        println!("{name}: median {:.3} ms, least {:.3} ms", times[50], times[0]);
    };

    let scene = hand_over(facing(0.75, [0.1, 0.05, 0.25]), 0.07);
    let mut renderer = Renderer::new(standing(), Look::default(), 1).with_setting(setting());
    save("standing.png", &renderer.render(&scene, 1.0));
    time("stand-alone camera, 0.75 m, hand and gripper", &mut renderer, &scene);
    let alone = cube_alone(facing(0.342, [0.3, 0.2, 0.35]), EDGE, mixed());
    save("alone.png", &renderer.render(&alone, 1.0));
    time("stand-alone camera, cube alone at 0.34 m", &mut renderer, &alone);
    let nothing = cube_alone(facing(-5.0, [0.0; 3]), EDGE, mixed());
    time("stand-alone camera, nothing", &mut renderer, &nothing);
    let mut moving = scene;
    moving.cube.velocity.linear = Vector3::new(0.15, 0.0, 0.05);
    save("moving.png", &renderer.render(&moving, 1.0));
    time("stand-alone camera, cube at 0.16 m/s", &mut renderer, &moving);
    let (camera, mut scene) = in_hand();
    let mut renderer = Renderer::new(camera, Look::draw(3), 1).with_setting(setting());
    save("in_hand.png", &renderer.render(&scene, 1.0));
    time("in-hand camera, 0.20 m", &mut renderer, &scene);
    scene.cube.turned = (Axis::X, 0.0, 0.5);
    save("in_hand_turned.png", &renderer.render(&scene, 1.0));
    for seed in 0..6 {
        let scene = hand_over(facing(0.5, [0.2, 0.1, 0.4]), 0.09);
        let mut renderer = Renderer::new(standing(), Look::draw(seed), 1).with_setting(setting());
        save(&format!("look{seed}.png"), &renderer.render(&scene, 1.0));
    }
}

/// Makes a cell like that of 2007: the track arm at the origin, the postument arm 2.11 m to its
/// left.
fn whole_cell() -> (Scene, Setting) {
    let world_from_cube = Pose::translation(0.95, 0.55, 1.05);
    let mut scene = hand_over(world_from_cube, 0.09);
    let way = |x: f64, y: f64, z: f64, turn: Vector3<f64>| Pose::new(Vector3::new(x, y, z), turn);
    let forward = Vector3::y() * std::f64::consts::FRAC_PI_2;
    scene.arms[0] = arm(way(0.80, 0.45, 1.05, forward), Point3::new(0.0, 0.35, 0.0), 0.08);
    let waiting = Vector3::new(-0.9, 1.7, 0.9);
    scene.arms[1] = arm(way(0.75, 1.55, 1.15, waiting), Point3::new(0.0, 2.11, 0.0), 0.07);
    scene.hand = Some(world_from_cube);
    let camera =
        pose_from_axes(Vector3::x(), -Vector3::z(), Vector3::y(), Point3::new(0.95, -0.25, 1.05));
    let table = Point3::new(0.95, 1.0, 0.70);
    (scene, Setting { table, cameras: vec![camera], ..Setting::default() })
}

/// Writes the picture of the whole cell. Run like `renderer_writes_sample_pictures`.
#[test]
#[ignore = "writes a picture into the temporary folder"]
fn renderer_writes_overview_of_cell() {
    let folder = std::env::temp_dir().join("rubik-robot-render");
    std::fs::create_dir_all(&folder).unwrap();
    let (scene, setting) = whole_cell();
    let start = std::time::Instant::now();
    let image = picture::cell(&scene, &setting, 1200, 800);
    println!("overview: {:.2} s", start.elapsed().as_secs_f64());
    image.save(folder.join("cell.png")).unwrap();
}
