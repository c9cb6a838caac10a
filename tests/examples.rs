//! Each example of `examples/` does what it shows. The example's `main` only prints what its other
//! functions return; the tests call these functions.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]
#![allow(dead_code, reason = "no test calls the `main` of an example")]

#[path = "../examples/meeting.rs"]
mod meeting;
#[path = "../examples/read_face.rs"]
mod read_face;
#[path = "../examples/read_recording.rs"]
mod read_recording;
#[path = "../examples/servo_periods.rs"]
mod servo_periods;
#[path = "../examples/small_task.rs"]
mod small_task;
#[path = "../examples/solve_cube.rs"]
mod solve_cube;

use nalgebra::{UnitQuaternion, Vector3};
use rubik_robot::cube::{Facelets, rotations};
use rubik_robot::record::summary::Outcome;
use rubik_robot::tasks;
use rubik_robot::vision::FaceSighting;
use std::path::Path;

/// The axis reaches its target in the ordered time, follows the set value closely meanwhile, and
/// stays where it is afterwards.
#[test]
fn servo_periods_turn_column_by_ordered_angle() {
    let samples = servo_periods::turn(0.04).unwrap();

    let (first, last) = (samples[0], samples[samples.len() - 1]);
    assert_eq!(samples.len(), 800);
    assert!((last.set - first.measured - 0.04).abs() < 2e-4, "{first:?} {last:?}");
    assert!((last.measured - last.set).abs() < 5e-4, "{last:?}");
    // The set value moves on evenly and ends with the command, period 400.
    let step = samples[200].set - samples[199].set;
    assert!((step - 0.04 / 400.0).abs() < 1e-6, "{step}");
    assert!((samples[399].set - last.set).abs() < 1e-9);
    let behind = samples.iter().map(|s| (s.set - s.measured).abs()).fold(0.0, f64::max);
    assert!((1e-5..5e-3).contains(&behind), "{behind}");
    assert!(samples[..400].iter().any(|s| s.pwm != 0));
    // Plant and servo are repeatable to the bit.
    assert_eq!(samples, servo_periods::turn(0.04).unwrap());
}

#[test]
fn solve_cube_solves_turns_and_stickers_alike() {
    let cube = solve_cube::parse("R U2 F' L D").unwrap();
    let stickers = Facelets::from(&cube).to_string();
    assert_eq!(solve_cube::parse(&stickers).unwrap(), cube);
    assert!(solve_cube::parse("R U X").is_err());

    let solutions = solve_cube::solutions(&cube);

    assert!(solutions.iter().all(|found| cube.apply_all(&found.turns).is_solved()));
    assert!(solutions.windows(2).all(|pair| pair[1].turns.len() <= pair[0].turns.len()));
    assert!(solutions[2].turns.len() == 5 && solutions[2].proven, "{:?}", solutions[2]);
}

/// Returns whether a face as it was read is one of the sides of a cube, turned in any way.
fn is_side_of(face: &FaceSighting, facelets: &Facelets) -> bool {
    let sides = facelets.colours().chunks(9);
    let turned: Vec<[u8; 9]> = (0..4).map(|quarters| face.turned(quarters).colours).collect();
    sides.into_iter().any(|side| turned.iter().any(|read| read == side))
}

#[test]
fn read_face_finds_true_colours_and_pose() {
    for seed in [2007, 7] {
        let seen = read_face::look(seed).unwrap();

        for face in &seen.location.faces {
            assert!(is_side_of(face, &seen.facelets), "{:?} {}", face.colours, seen.facelets);
            assert!(face.confidences.iter().all(|sure| *sure > 0.5), "{:?}", face.confidences);
        }
        let (found, truth) = (seen.location.camera_from_cube, seen.camera_from_cube);
        let off = (found.translation.vector - truth.translation.vector).norm();
        assert!(off < 0.006, "seed {seed}: {off} m");
        // The axes are known up to the 24 rotations of a cube.
        let turned =
            |rotation: UnitQuaternion<f64>| (truth.rotation * rotation).angle_to(&found.rotation);
        let angle = rotations().into_iter().map(turned).fold(f64::INFINITY, f64::min);
        assert!(angle < 0.06, "seed {seed}: {angle} rad");
    }
}

/// The hands of a grasp hold one cube: the tool points lie in its outer layers, so their distance
/// follows from the rotation of the hands to each other alone.
#[test]
fn meeting_brings_both_hands_to_one_cube() {
    let (cell, table) = meeting::search().unwrap();

    assert_eq!(table.found(), (16, 6));
    for (rotation, grasp) in meeting::found(&table) {
        for (arm, joints) in cell.arms.iter().zip([grasp.track, grasp.postument]) {
            assert_eq!(arm.model.check(&joints), Ok(()));
        }
        assert!(grasp.clearance >= 0.02, "{}", grasp.clearance);
        // Each tool point is one third of the edge from the centre of the cube.
        let arm = cell.cube.edge / 3.0;
        let towards = rotations()[rotation] * Vector3::z();
        let wanted = arm * (Vector3::z() - towards).norm();
        let distance = meeting::tool_distance(&cell, grasp);
        assert!((distance - wanted).abs() < 1e-6, "{rotation}: {distance} {wanted}");
    }
}

#[test]
fn read_recording_finds_phases_forces_and_verdict() {
    let path = std::env::temp_dir().join(format!("read_recording_{}.mcap", std::process::id()));
    let summary = read_recording::record(&path).unwrap();

    let story = read_recording::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();

    assert_eq!(story.summary.as_ref(), Some(&summary));
    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    let named: Vec<&str> = story.phases.iter().map(|(_, name)| name.as_str()).collect();
    let wanted: Vec<&str> = summary.phases.iter().map(|phase| phase.name.as_str()).collect();
    assert!(wanted.iter().all(|name| named.contains(name)), "{named:?} {wanted:?}");
    // Recording and summary have the forces of each servo period; curves have single precision.
    assert_eq!(story.arms.len(), 2);
    for (arm, peak) in story.arms.iter().zip(&summary.sensors) {
        let largest = f64::from(read_recording::largest(&arm.force));
        assert_eq!(arm.name, peak.effector);
        assert!((largest - peak.felt_force_n).abs() < 1e-3, "{largest} {peak:?}");
        assert_eq!(arm.missing, 0);
    }
}

#[test]
fn small_task_moves_tool_on_an_arc() {
    let summary = small_task::perform(10.0).unwrap();

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!(summary.phases[0].name, "swing");
    let moved = summary.figures["moved_mm"].as_f64().unwrap();
    assert!(summary.reason.contains(&format!("{moved:.1} mm")), "{}", summary.reason);
    // The tool moves on a circle about the column, so its way is the chord of the angle. The arm
    // overshoots by a milliradian.
    let cell = tasks::read(Path::new("cell"), "task = \"idle\"\n", &[]).unwrap().controller.cell;
    let arm = &cell.arms[0];
    let tool = arm.model.base_from_flange(&arm.start) * arm.flange_from_tool;
    let radius = tool.translation.x.hypot(tool.translation.y - arm.start.0[0]);
    let chord = 2e3 * radius * 5.0_f64.to_radians().sin();
    assert!((moved - chord).abs() < 2.0, "{moved} {chord}");
    assert!(small_task::perform(45.0).unwrap_err().to_string().contains("45 is outside 1..20"));
}

/// Every Rust file of `examples/` has its test above, and says in its header how to run it.
#[test]
fn every_example_is_tested_and_names_its_command() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    let tests = include_str!("examples.rs");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|end| end != "rs") {
            continue;
        }
        let name = path.file_stem().unwrap().to_str().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(&format!("--example {name}")), "{name} does not name its command");
        assert!(tests.contains(&format!("mod {name};")), "{name} has no test");
        assert!((30..=80).contains(&text.lines().count()), "{name} has an unusual length");
        count += 1;
    }
    assert!(count >= 6, "only {count} examples");
}
