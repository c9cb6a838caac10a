//! Time of vision on one core: the detection of faces, and the decision of their colours.
//!
//!     cargo bench --bench vision
//!     RUBIK_PHOTOGRAPHS=DIR RUBIK_CUBES=DIR cargo bench --bench vision
//!
//! The first folder has photographs as PNG and JPEG files. The second one has JSON files of 54
//! squares measured in photographs, as `vision colours` reads them.
//!
//! Rendered frames come from the plant's renderer, at 640x480 and 1280x960. The bench scales
//! photographs to these sizes by repeating or omitting pixels, so that the figures are comparable.

#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use criterion::{Criterion, criterion_group, criterion_main};
use image::RgbImage;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rubik_robot::cell::{Camera, Intrinsics, Mount};
use rubik_robot::cli::cubes::measured_squares;
use rubik_robot::cube::{Cube, Facelets};
use rubik_robot::hw::plant::render::{Look, Renderer, cube_alone};
use rubik_robot::spatial::{Pose, pose_from_axes};
use rubik_robot::vision::colours::{decide_cube, decide_face};
use rubik_robot::vision::{DetectorSettings, FaceSighting, Method, detect};
use std::hint::black_box;
use std::path::Path;

/// Colours of stickers in ordinary light (sRGB), in the order of the faces URFDLB.
const STICKERS: [[f64; 3]; 6] = [
    [222.0, 224.0, 219.0],
    [171.0, 30.0, 41.0],
    [28.0, 139.0, 77.0],
    [226.0, 199.0, 39.0],
    [224.0, 96.0, 32.0],
    [27.0, 70.0, 158.0],
];

/// Widths and heights of the pictures (px).
const SIZES: [(u32, u32); 2] = [(640, 480), (1280, 960)];

/// Renders eight pictures of a cube that appears 100 px to 200 px wide, each in another light, at
/// another pose and with another scramble. `width` and `height` are those of the picture (px).
fn rendered(width: u32, height: u32) -> Vec<RgbImage> {
    let scale = f64::from(width) / 640.0;
    let camera = Camera {
        name: "standalone".to_owned(),
        mount: Mount::World {
            world_from_camera: pose_from_axes(
                Vector3::x(),
                -Vector3::z(),
                Vector3::y(),
                Point3::new(0.0, 0.0, 1.1),
            ),
        },
        intrinsics: Intrinsics {
            width,
            height,
            focal: (600.0 * scale, 600.0 * scale),
            centre: ((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0),
            distortion: (0.0, 0.0),
        },
    };
    (0..8u64)
        .map(|k| {
            let lean = Vector3::new(0.1 + 0.08 * k as f64, 0.05 * k as f64, 0.6 - 0.1 * k as f64);
            let at = Vector3::new(0.02, 0.25 + 0.02 * k as f64, 1.1);
            let pose = Pose::from_parts(at.into(), UnitQuaternion::from_scaled_axis(lean));
            let facelets = *Facelets::from(&Cube::scrambled(k)).colours();
            Renderer::new(camera.clone(), Look::draw(k), k)
                .render(&cube_alone(pose, 0.057, facelets), 1.0)
        })
        .collect()
}

/// Reads the photographs of a folder and scales each to `width` by `height` px.
fn photographs(folder: &Path, width: u32, height: u32) -> Vec<RgbImage> {
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .collect();
    files.sort();
    files
        .iter()
        .filter_map(|file| image::open(file).ok())
        .map(|picture| {
            let picture = picture.into_rgb8();
            RgbImage::from_fn(width, height, |x, y| {
                let at = |v: u32, of: u32, from: u32| {
                    (u64::from(v) * u64::from(from) / u64::from(of)) as u32
                };
                *picture.get_pixel(at(x, width, picture.width()), at(y, height, picture.height()))
            })
        })
        .collect()
}

/// Measures the detection of faces in whole pictures, for each size, set of pictures and method.
fn whole_frame(c: &mut Criterion) {
    let folder = std::env::var_os("RUBIK_PHOTOGRAPHS");
    for (width, height) in SIZES {
        let mut sets = vec![("rendered", rendered(width, height))];
        if let Some(folder) = &folder {
            sets.push(("photographs", photographs(Path::new(folder), width, height)));
        }
        for (name, images) in sets.iter().filter(|(_, images)| !images.is_empty()) {
            for method in [Method::Edges, Method::Paper2007] {
                let settings = DetectorSettings { method, ..DetectorSettings::default() };
                let mut next = images.iter().cycle();
                c.bench_function(
                    &format!("whole frame, {name}, {width}x{height}, {method:?}"),
                    |b| {
                        b.iter(|| {
                            next.next().map(|image| detect(black_box(image), None, &settings))
                        });
                    },
                );
            }
        }
    }
}

/// Returns all cube faces that are detected in the pictures, in one list.
fn faces(images: &[RgbImage]) -> Vec<FaceSighting> {
    let found = |image| detect(image, None, &DetectorSettings::default()).ok();
    images.iter().filter_map(found).flatten().collect()
}

/// Reads the JSON files of a folder; each has the colours of a cube's 54 tiles (sRGB), as measured
/// in photographs.
fn measured(folder: &Path) -> Vec<[[f64; 3]; 54]> {
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .collect();
    files.sort();
    let texts = files.iter().filter_map(|file| std::fs::read_to_string(file).ok());
    texts.filter_map(|text| measured_squares(&text).ok()).collect()
}

/// Makes 50 scrambled cubes, each as the colours of its 54 tiles (sRGB): those in [`STICKERS`],
/// made darker by a factor for each face and changed by a deviation for each tile.
fn made_up() -> Vec<[[f64; 3]; 54]> {
    let cube = |seed: u64| {
        let facelets = *Facelets::from(&Cube::scrambled(seed)).colours();
        std::array::from_fn(|i| {
            let wobble = ((i as u64 * 7919 + seed * 104_729) % 31) as f64 - 15.0;
            let shade = 0.7 + 0.05 * (i / 9) as f64;
            STICKERS[usize::from(facelets[i])].map(|v| (v * shade + wobble).clamp(0.0, 255.0))
        })
    };
    (0..50).map(cube).collect()
}

/// Measures the decision of the colours of one face, and of the 54 facelets of a cube.
fn colours(c: &mut Criterion) {
    let mut sets = vec![("rendered", faces(&rendered(640, 480)))];
    if let Some(folder) = std::env::var_os("RUBIK_PHOTOGRAPHS") {
        sets.push(("photographs", faces(&photographs(Path::new(&folder), 640, 480))));
    }
    for (name, faces) in sets.iter().filter(|(_, faces)| !faces.is_empty()) {
        let mut next = faces.iter().cycle();
        c.bench_function(&format!("colours of one face, {name}"), |b| {
            b.iter(|| next.next().map(|face| decide_face(black_box(&face.rgb))));
        });
    }
    let mut sets = vec![("made up", made_up())];
    if let Some(folder) = std::env::var_os("RUBIK_CUBES") {
        sets.push(("photographs", measured(Path::new(&folder))));
    }
    for (name, cubes) in sets.iter().filter(|(_, cubes)| !cubes.is_empty()) {
        let mut next = cubes.iter().cycle();
        c.bench_function(&format!("54-facelet decision, {name}"), |b| {
            b.iter(|| next.next().map(|rgb| decide_cube(black_box(rgb))));
        });
    }
}

criterion_group!(benches, whole_frame, colours);
criterion_main!(benches);
