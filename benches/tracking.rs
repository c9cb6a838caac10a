//! Time to locate and to track the cube.
//!
//!     cargo bench --bench tracking
//!     RUBIK_PHOTOGRAPHS=DIR cargo bench --bench tracking
//!
//! The folder has photographs as PNG and JPEG files.
//!
//! Rendered frames come from the plant's renderer, at 640x480 and at 1280x960; the cube is 105 px
//! wide. The bench scales photographs to these sizes by repeating or omitting pixels, and uses
//! those in which it detects a face.

#![allow(missing_docs, clippy::unwrap_used, reason = "a bench that cannot go on should stop")]

use criterion::{Criterion, criterion_group, criterion_main};
use image::{RgbImage, imageops};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rubik_robot::cell::{Camera, Intrinsics, Mount};
use rubik_robot::hw::plant::render::{Look, Renderer, cube_alone};
use rubik_robot::spatial::{Pose, pose_from_axes};
use rubik_robot::vision::detect::window_around;
use rubik_robot::vision::watcher::CubeWatcher;
use rubik_robot::vision::{
    DetectorSettings, Lens, Method, Rect, detect, locate_cube, locate_in, refine_in,
};
use std::hint::black_box;
use std::path::Path;

/// Edge of the cube (m).
const EDGE: f64 = 0.057;

/// Renders a picture of a cube that is `shift` m to the right of its usual place. Returns the
/// picture, the camera's intrinsics, `world_from_camera` and `world_from_cube`.
fn frame(width: u32, height: u32, shift: f64) -> (RgbImage, Intrinsics, Pose, Pose) {
    let world_from_camera =
        pose_from_axes(Vector3::x(), -Vector3::z(), Vector3::y(), Point3::new(0.0, 0.0, 1.1));
    let intrinsics = Intrinsics {
        width,
        height,
        focal: (600.0, 600.0),
        centre: (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0),
        distortion: (-0.05, 0.01),
    };
    let lean = UnitQuaternion::from_scaled_axis(Vector3::new(0.35, 0.2, 0.3));
    let world_from_cube = Pose::from_parts(Vector3::new(0.02 + shift, 0.36, 1.09).into(), lean);
    let camera =
        Camera { name: "standalone".into(), mount: Mount::World { world_from_camera }, intrinsics };
    let facelets = std::array::from_fn(|i| ((i * 7 + i / 5) % 6) as u8);
    let image = Renderer::new(camera, Look::draw(1), 1)
        .render(&cube_alone(world_from_cube, EDGE, facelets), 1.0);
    (image, intrinsics, world_from_camera, world_from_cube)
}

/// Measures, on rendered pictures, how long it takes to locate the cube without a prediction and to
/// track it from a predicted pose.
fn benches(c: &mut Criterion) {
    for (width, height) in [(640, 480), (1280, 960)] {
        let (image, intrinsics, world_from_camera, world_from_cube) = frame(width, height, 0.0);
        let settings = DetectorSettings::default();
        let paper = DetectorSettings { method: Method::Paper2007, ..settings };
        let faces = detect(&image, None, &settings).unwrap();
        let near = world_from_camera.inverse()
            * Pose::translation(0.0006, 0.001, -0.0004)
            * world_from_cube;
        let window = window_around(&faces[0].corners, 0.5);
        let mut group = c.benchmark_group(format!("{width}x{height}"));
        group.bench_function("pose from centroids", |b| {
            b.iter(|| locate_cube(black_box(&faces), &intrinsics, EDGE, None));
        });
        group.bench_function("pose on edges, from a detection", |b| {
            b.iter(|| locate_in(black_box(&image), &faces, &intrinsics, EDGE, None));
        });
        group.bench_function("tracking: edges at the predicted pose", |b| {
            b.iter(|| refine_in(black_box(&image), &intrinsics, EDGE, &near).unwrap());
        });
        group.bench_function("tracking: colours in the predicted window", |b| {
            b.iter(|| detect(black_box(&image), window, &paper));
        });
        group.bench_function("tracking: lattices in the predicted window", |b| {
            b.iter(|| detect(black_box(&image), window, &settings));
        });
        // The cube moves by 2 mm in each frame, back and forth.
        let moved = frame(width, height, 0.002).0;
        let mut watcher = CubeWatcher::new(world_from_camera, intrinsics, EDGE, settings);
        let mut time = 0.0_f64;
        group.bench_function("a frame of the whole tracker", |b| {
            b.iter(|| {
                time += 0.04;
                let image =
                    if ((time / 0.04).round() as u64).is_multiple_of(2) { &image } else { &moved };
                watcher.observe(black_box(image), time, None, true)
            });
        });
        group.finish();
    }
}

/// Photograph in which the bench has detected a face.
struct Photograph {
    image: RgbImage,
    /// Window around the face.
    window: Option<Rect>,
    /// Pose of the cube, if it was found.
    camera_from_cube: Option<Pose>,
}

/// Reads the photographs of a folder, scales each to the largest size that fits into `width` by
/// `height` px without distortion, and keeps those in which a face is detected.
fn photographs(folder: &Path, width: u32, height: u32, lens: &Lens) -> Vec<Photograph> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let mut files: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.sort();
    let pictures = files.iter().filter_map(|file| Some(image::open(file).ok()?.into_rgb8()));
    pictures
        .filter_map(|picture| {
            let by = f64::from(width) / f64::from(picture.width());
            let by = by.min(f64::from(height) / f64::from(picture.height()));
            let size = |n: u32| ((f64::from(n) * by) as u32).max(1);
            let image = imageops::resize(
                &picture,
                size(picture.width()),
                size(picture.height()),
                imageops::FilterType::Nearest,
            );
            let faces = detect(&image, None, &DetectorSettings::default()).ok()?;
            let found = locate_in(&image, &faces, lens, EDGE, None);
            Some(Photograph {
                window: window_around(&faces[0].corners, 0.5),
                camera_from_cube: found.map(|found| found.camera_from_cube),
                image,
            })
        })
        .collect()
}

/// Measures how long it takes to track the cube in each photograph, beginning with the window and
/// the pose that a detection in the same photograph has found.
fn on_photographs(c: &mut Criterion) {
    let Some(folder) = std::env::var_os("RUBIK_PHOTOGRAPHS") else { return };
    for (width, height) in [(640, 480), (1280, 960)] {
        let middle = (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0);
        let lens = Lens::pinhole((f64::from(width), f64::from(width)), middle);
        let all = photographs(Path::new(&folder), width, height, &lens);
        if all.is_empty() {
            continue;
        }
        let settings = DetectorSettings::default();
        let paper = DetectorSettings { method: Method::Paper2007, ..settings };
        let mut group = c.benchmark_group(format!("{} photographs, {width}x{height}", all.len()));
        let mut next = all.iter().cycle();
        group.bench_function("tracking: colours in the predicted window", |b| {
            b.iter(|| next.next().map(|p| detect(black_box(&p.image), p.window, &paper)));
        });
        let mut next = all.iter().cycle();
        group.bench_function("tracking: lattices in the predicted window", |b| {
            b.iter(|| next.next().map(|p| detect(black_box(&p.image), p.window, &settings)));
        });
        let placed: Vec<_> = all.iter().filter(|p| p.camera_from_cube.is_some()).collect();
        let mut next = placed.iter().cycle();
        group.bench_function("tracking: edges at the predicted pose", |b| {
            b.iter(|| {
                let one = next.next()?;
                refine_in(black_box(&one.image), lens, EDGE, one.camera_from_cube.as_ref()?)
            });
        });
        group.finish();
    }
}

criterion_group!(tracking, benches, on_photographs);
criterion_main!(tracking);
