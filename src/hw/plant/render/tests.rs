use super::*;
use crate::cell::Intrinsics;

use crate::spatial::pose_from_axes;

const EDGE: f64 = 0.057;
const HEIGHT: f64 = 1.1;

fn intrinsics(width: u32, height: u32, focal: f64) -> Intrinsics {
    let centre = (f64::from(width) / 2.0 - 0.5, f64::from(height) / 2.0 - 0.5);
    Intrinsics { width, height, focal: (focal, focal), centre, distortion: (0.0, 0.0) }
}

/// A camera 1.1 m above the world's origin that looks along +y, x to the right.
fn standing() -> Camera {
    let world_from_camera =
        pose_from_axes(Vector3::x(), -Vector3::z(), Vector3::y(), Point3::new(0.0, 0.0, HEIGHT));
    Camera {
        name: "standalone".to_owned(),
        mount: Mount::World { world_from_camera },
        intrinsics: intrinsics(640, 480, 600.0),
    }
}

fn solved() -> [u8; 54] {
    std::array::from_fn(|i| (i / 9) as u8)
}

fn mixed() -> [u8; 54] {
    std::array::from_fn(|i| ((i * 7 + i / 5) % 6) as u8)
}

/// The cube `depth` in front of the standing camera, turned by a rotation vector.
fn facing(depth: f64, turn: [f64; 3]) -> Pose {
    Pose::new(Vector3::new(0.0, depth, HEIGHT), Vector3::from(turn))
}

/// Two arms, hand over the cube at `world_from_cube`; the track's gripper comes from -x.
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

fn arm(world_from_tool: Pose, base: Point3<f64>, opening: f64) -> SceneArm {
    let world_from_flange = world_from_tool * Pose::translation(0.0, 0.0, -0.25);
    let flange = Point3::from(world_from_flange.translation.vector);
    let wrist = world_from_flange * Point3::new(0.0, 0.0, -0.19);
    let shoulder = base + Vector3::z() * 0.95;
    let elbow = nalgebra::center(&shoulder, &wrist) + Vector3::z() * 0.35;
    let points = [base, shoulder, elbow, wrist, flange];
    SceneArm { points, world_from_tool, world_from_flange, opening }
}

/// The postument's hand camera looks from 0.2 m at the face opposite the track's palm.
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

fn setting() -> Setting {
    Setting {
        table: Point3::new(0.0, 0.85, 0.75),
        room: (Point3::new(-2.0, -1.5, 0.0), Point3::new(2.0, 2.8, 2.8)),
        ..Setting::default()
    }
}

/// Run with `cargo test --release --lib render::tests::samples -- --ignored --nocapture` and look at them.
#[test]
#[ignore = "writes pictures into the temporary folder and measures time"]
fn samples() {
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
#[test]
#[ignore]
fn zz_prof() {
    let scene = hand_over(facing(0.75, [0.1, 0.05, 0.25]), 0.07);
    let mut renderer = Renderer::new(standing(), Look::default(), 1).with_setting(setting());
    for _ in 0..600 {
        std::hint::black_box(renderer.render(&scene, 1.0));
    }
    let v = &renderer.view;
    let touched: usize = (0..480)
        .map(|r| {
            let (a, b) = v.span(r);
            b.saturating_sub(a)
        })
        .sum();
    println!("touched {touched}");
}
