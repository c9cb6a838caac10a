//! `rubik-robot calibrate`: calibrates cameras in the simulated cell and writes the result as part
//! of a scenario.
//!
//! - in: a scenario, a camera or all, a number of views
//! - out: a table of the values and of the errors that are left; the camera sections as TOML

use super::arguments::ScenarioArgs;
use super::output::{Output, clash, inform, refuse, save, warn};
use crate::cell::{Camera, Cell, Mount};
use crate::run::calibrate::{self, Errors, Report};
use crate::scenario::{CameraSource, ControllerConfig};
use crate::vision::calibration::Calibrated;
use clap::Args;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
The track arm shows the cube to a fixed camera. A camera in a hand is moved around the cube that
the other arm holds. The arms are driven through the hardware port, and the pictures come from the
camera. One adjustment finds focal lengths, principal point, radial distortion (k1, k2), the
camera's pose, the pose of the cube in the hand, and the length of its edge.

Poses and their s.d. (standard deviations) are relative to the pose that the encoders give, since a
camera only has to agree with them.
The absolute pose is less certain, by the errors that all poses of the arm have in common (sag,
base). Its s.d. is printed as well and written to [plant.errors]. The lines `off by` give the
difference from the true values, which only a simulation knows, before and after the calibration.
Poses are in the world, or on the flange for a camera in a hand; orientations are roll, pitch, yaw.

Examples:
  rubik-robot calibrate scenarios/solve.toml
  rubik-robot calibrate scenarios/solve.toml --camera standalone --views 40 --seed 3
  rubik-robot calibrate scenarios/solve.toml -o cameras.toml  # sections to copy into a scenario

Keys of the object of --json: seed, and cameras with, for each camera:
  camera (its name), poses, views (those with a usable picture), sim_time_s (simulated time)
  focal_px, centre_px, distortion (k1, k2), xyz_mm, rpy_deg, cube_edge_mm, residual_px (r.m.s.)
  deviations           s.d. of fx, fy, cx, cy (px), k1, k2, the camera's place (m) and orientation
                       (rad), the cube's place (m) and orientation (rad), the edge (m)
  camera_deviations_in_truth    s.d. of the absolute pose: place (m), orientation (rad)
  off_before, off_after    differences from the true values: focal_percent, centre_px, place_mm,
                       tilt_deg; and of a cube at working distance: lateral_mm, depth_mm
  sag_mm               mean offset of the moving hand from its pose by the encoders
  hand_before_mm, hand_after_mm    distance of this hand from where camera and encoders expect it,
                       across and along the line of sight
  reason               instead of the results, if the camera is not calibrated
Exit codes: 0 every camera is calibrated, 1 a camera is not, 2 wrong usage or scenario, 4 system
error, for example a file that cannot be written.")]
pub(super) struct CalibrateArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Calibrate this camera only [default: all cameras]
    #[arg(long)]
    camera: Option<String>,
    /// Number of poses of the arm for each camera (6 to 200)
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(6..=200))]
    views: u32,
    /// Seed of the true errors and noise of the simulated cell
    /// [default: that of the scenario]
    #[arg(long, verbatim_doc_comment)]
    seed: Option<u64>,
    /// Write the sections of all cameras, with the new values, to FILE (TOML)
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print one line of JSON instead of a table
    #[arg(long)]
    json: bool,
}

/// Calibrates the cameras and prints the result; returns the exit code.
pub(super) fn calibrate(args: &CalibrateArgs, output: &mut Output) -> anyhow::Result<u8> {
    clash(&[("the scenario", Some(&args.scenario.scenario))], &[("-o", args.output.as_ref())])?;
    let mut scenario = args.scenario.load(&[]).map_err(refuse)?;
    // Another seed draws other true values of the plant, around those of the scenario.
    scenario.seed = args.seed.unwrap_or(scenario.seed);
    let cameras = &scenario.controller.cell.cameras;
    let wanted = match &args.camera {
        None => None,
        Some(name) => {
            let Some(index) = cameras.iter().position(|c| c.name == *name) else {
                let names: Vec<&str> = cameras.iter().map(|c| c.name.as_str()).collect();
                let names = names.join(", ");
                return Err(refuse(format!(
                    "--camera {name}: the scenario has no such camera; it has {names}"
                )));
            };
            Some(index)
        }
    };
    // Progress goes to stderr: a calibration of all cameras takes a while.
    let reports = calibrate::run(&scenario, wanted, args.views as usize, inform)
        .map_err(|error| anyhow::anyhow!("{error}"))?;
    if args.json {
        let all: Vec<Value> =
            reports.iter().map(|r| object(&scenario.controller.cell, r)).collect();
        output.line(&json!({ "seed": scenario.seed, "cameras": all }).to_string())?;
    } else {
        for report in &reports {
            output.text(&words(&scenario.controller.cell, report))?;
        }
    }
    if let Some(path) = &args.output {
        // A calibration of no camera must not replace the result of an earlier one.
        if reports.iter().any(|report| report.found.is_ok()) {
            save(path, section(&scenario.controller, &reports).as_bytes())?;
        } else {
            let path = path.display();
            warn(&format!("no camera was calibrated: the file {path} is not written"));
        }
    }
    Ok(u8::from(reports.iter().any(|r| r.found.is_err())))
}

/// Returns the name of the camera of a report.
fn name<'a>(cell: &'a Cell, report: &Report) -> &'a str {
    &cell.cameras[report.camera].name
}

/// Returns the errors of a camera against its true values as JSON.
fn errors_object(errors: &Errors) -> Value {
    json!({ "focal_percent": errors.focal * 100.0, "centre_px": errors.centre,
        "place_mm": errors.place * 1e3, "tilt_deg": errors.tilt.to_degrees(),
        "lateral_mm": errors.lateral * 1e3, "depth_mm": errors.depth * 1e3 })
}

/// Returns a report as JSON.
fn object(cell: &Cell, report: &Report) -> Value {
    let mut object = json!({ "camera": name(cell, report), "poses": report.views.0,
        "views": report.views.1, "sim_time_s": report.time,
        "off_before": errors_object(&report.errors.0),
        "off_after": report.errors.1.as_ref().map(errors_object),
        "sag_mm": report.sag.map(|s| s * 1e3),
        "hand_before_mm": report.hand.0.map(|e| e * 1e3),
        "hand_after_mm": report.hand.1.map(|h| h.map(|e| e * 1e3)) });
    match &report.found {
        Ok(found) => {
            let (lens, at) = (&found.setup.lens, found.setup.camera.translation.vector * 1e3);
            object["focal_px"] = json!([lens.focal.0, lens.focal.1]);
            object["centre_px"] = json!([lens.centre.0, lens.centre.1]);
            object["distortion"] = json!([lens.radial[0], lens.radial[1]]);
            object["xyz_mm"] = json!([at.x, at.y, at.z]);
            object["rpy_deg"] = json!(rpy(found));
            object["cube_edge_mm"] = json!(found.setup.edge * 1e3);
            object["residual_px"] = json!(found.residual_px);
            object["deviations"] = json!(found.deviations);
            object["camera_deviations_in_truth"] = json!(found.true_deviations);
        }
        // A camera without a result has this key in the place of all values.
        Err(reason) => object["reason"] = json!(reason.to_string()),
    }
    object
}

/// Returns roll, pitch and yaw of a calibrated camera (deg): in the world, or on the flange for a
/// camera on an arm.
fn rpy(found: &Calibrated) -> [f64; 3] {
    let (roll, pitch, yaw) = found.setup.camera.rotation.euler_angles();
    [roll, pitch, yaw].map(f64::to_degrees)
}

/// Returns a report as text.
fn words(cell: &Cell, report: &Report) -> String {
    let mut text = format!(
        "{}: {} of {} views, {:.0} s of simulated time\n",
        name(cell, report),
        report.views.1,
        report.views.0,
        report.time
    );
    match &report.found {
        Ok(found) => text += &found_words(found),
        Err(reason) => {
            let _ = writeln!(text, "  not calibrated: {reason}");
        }
    }
    text += &error_words("the scenario is", &report.errors.0);
    if let Some(after) = &report.errors.1 {
        text += &error_words("this result is", after);
    }
    text + &hand_words(report)
}

/// Returns the calibrated values as lines of text, each with its standard deviation (s.d.).
fn found_words(found: &Calibrated) -> String {
    let (lens, d) = (&found.setup.lens, &found.deviations);
    let at = found.setup.camera.translation.vector * 1e3;
    let turn = rpy(found);
    // `d` has the order of `Calibrated::deviations`: fx, fy, cx, cy, k1, k2, place, orientation ...
    let lens_words = format!(
        "  focal {:.1} {:.1} px (s.d. {:.1}), centre {:.1} {:.1} px (s.d. {:.1} {:.1}), \
         k1 {:.4} k2 {:.4} (s.d. {:.4} {:.4})\n",
        lens.focal.0,
        lens.focal.1,
        d[0],
        lens.centre.0,
        lens.centre.1,
        d[2],
        d[3],
        lens.radial[0],
        lens.radial[1],
        d[4],
        d[5],
    );
    let place_words = format!(
        "  place {:.1} {:.1} {:.1} mm (s.d. {:.2} {:.2} {:.2}), \
         roll pitch yaw {:.2} {:.2} {:.2} deg (s.d. {:.3}), relative to the encoders\n",
        at.x,
        at.y,
        at.z,
        d[6] * 1e3,
        d[7] * 1e3,
        d[8] * 1e3,
        turn[0],
        turn[1],
        turn[2],
        d[9].max(d[10]).max(d[11]).to_degrees(),
    );
    let truth_words = format!(
        "  absolute s.d. {:.1} {:.1} {:.1} mm, {:.2} deg, with the errors that all poses of the \
         arm have in common\n",
        found.true_deviations[0] * 1e3,
        found.true_deviations[1] * 1e3,
        found.true_deviations[2] * 1e3,
        found.true_deviations[3..].iter().copied().fold(0.0, f64::max).to_degrees(),
    );
    // The poses of the arm are part of the adjustment, so their error is known as well.
    let cube_words = format!(
        "  cube's edge {:.2} mm (s.d. {:.2}); residual {:.2} px over {} grooves; the arm was off \
         by {:.2} mm, {:.3} deg\n",
        found.setup.edge * 1e3,
        d[18] * 1e3,
        found.residual_px,
        found.grooves,
        found.arm.0 * 1e3,
        found.arm.1.to_degrees(),
    );
    lens_words + &place_words + &truth_words + &cube_words
}

/// Returns the errors of a camera against the truth as a line of text.
fn error_words(label: &str, e: &Errors) -> String {
    format!(
        "  {label:<16} off by: focal {:+.3} %, centre {:.2} px, place {:.2} mm, tilt {:.3} deg; at \
         the cube {:.2} mm across, {:.2} mm along the line of sight\n",
        e.focal * 100.0,
        e.centre,
        e.place * 1e3,
        e.tilt.to_degrees(),
        e.lateral * 1e3,
        e.depth * 1e3
    )
}

/// Describes how far the moving hand was from the position that its encoders gave, and from the one
/// that the camera and the encoders together predict, before and after the calibration.
fn hand_words(report: &Report) -> String {
    let [x, y, z] = report.sag.map(|s| s * 1e3);
    let sag = format!("  the hand was {x:+.2} {y:+.2} {z:+.2} mm from its pose by the encoders");
    let seen = match report.hand {
        ([a, b], Some([c, d])) if a + b > 0.0 => format!(
            "; encoders and camera together miss it by {:.2} mm across, {:.2} mm along the line of \
             sight (before: {:.2}, {:.2})",
            c * 1e3,
            d * 1e3,
            a * 1e3,
            b * 1e3
        ),
        _ => String::new(),
    };
    sag + &seen + "\n"
}

/// Returns TOML for a scenario: the sections of all cameras, the calibrated ones with their new
/// values, and a section with the size of the errors that a calibration leaves, for the simulated
/// plant.
fn section(config: &ControllerConfig, reports: &[Report]) -> String {
    let mut text = String::from(
        "# Cameras by `rubik-robot calibrate`. A scenario with a list of cameras replaces the \
         built-in one.\n",
    );
    let cell = &config.cell;
    for (index, camera) in cell.cameras.iter().enumerate() {
        let found = reports.iter().find(|r| r.camera == index).and_then(|r| r.found.as_ref().ok());
        let source = match &config.cameras[index] {
            CameraSource::Renderer => "\"renderer\"".to_owned(),
            CameraSource::Folder(folder) => format!("{:?}", folder.display().to_string()),
            CameraSource::Ros(topic) => format!("\"ros\"\ntopic = {topic:?}"),
        };
        // A list of cameras in a scenario replaces the built-in one, so all cameras are written.
        text += &camera_section(camera, &source, found, |arm| cell.arms[arm].name.clone());
    }
    let all: Vec<&Calibrated> = reports.iter().filter_map(|r| r.found.as_ref().ok()).collect();
    if !all.is_empty() {
        // The scenario has one value of each error for all cameras: the root mean square.
        let rms = |of: &dyn Fn(&Calibrated) -> f64| {
            (all.iter().map(|c| of(c).powi(2)).sum::<f64>() / all.len() as f64).sqrt()
        };
        // Errors of several axes become one value: the plant draws each axis with it.
        let mean = |d: &[f64]| (d.iter().map(|x| x * x).sum::<f64>() / d.len() as f64).sqrt();
        let _ = write!(
            text,
            "\n# Errors that the calibration leaves: standard deviations of the absolute poses, \
             since the arm\n# sags below its encoders; mean over the cameras.\n[plant.errors]\n\
             focal_percent = {:.4}\ncentre_px = {:.3}\ncamera_mm = {:.3}\ncamera_deg = {:.4}\n",
            100.0 * rms(&|c| c.deviations[0] / c.setup.lens.focal.0),
            rms(&|c| mean(&c.deviations[2..4])),
            1e3 * rms(&|c| mean(&c.true_deviations[..3])),
            rms(&|c| mean(&c.true_deviations[3..])).to_degrees(),
        );
    }
    text
}

/// Returns the TOML section of a camera, with the values of its calibration (`found`) if there is
/// one. `source` is the value of this key, with the keys that follow from it; `arm` returns the
/// name of the arm with an index.
fn camera_section(
    camera: &Camera,
    source: &str,
    found: Option<&Calibrated>,
    arm: impl Fn(usize) -> String,
) -> String {
    let optics = &camera.intrinsics;
    let (mount, pose) = match camera.mount {
        Mount::World { world_from_camera } => ("mount = \"world\"\n".to_owned(), world_from_camera),
        Mount::Flange { arm: index, flange_from_camera } => {
            (format!("mount = \"flange\"\neffector = {:?}\n", arm(index)), flange_from_camera)
        }
    };
    // A camera that was not calibrated keeps the values of the scenario.
    let (pose, focal, centre, distortion) = match found {
        Some(c) => {
            let lens = &c.setup.lens;
            (c.setup.camera, lens.focal, lens.centre, (lens.radial[0], lens.radial[1]))
        }
        None => (pose, optics.focal, optics.centre, optics.distortion),
    };
    let at = pose.translation.vector * 1e3;
    let (roll, pitch, yaw) = pose.rotation.euler_angles();
    format!(
        "\n[[camera]]\nname = {:?}\nsource = {source}\n{mount}width_px = {}\nheight_px = {}\n\
         focal_px = [{:.3}, {:.3}]\ncentre_px = [{:.3}, {:.3}]\ndistortion = [{:.6}, {:.6}]\n\
         xyz_mm = [{:.3}, {:.3}, {:.3}]\nrpy_deg = [{:.5}, {:.5}, {:.5}]\n",
        camera.name,
        optics.width,
        optics.height,
        focal.0,
        focal.1,
        centre.0,
        centre.1,
        distortion.0,
        distortion.1,
        at.x,
        at.y,
        at.z,
        roll.to_degrees(),
        pitch.to_degrees(),
        yaw.to_degrees(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::spatial::Pose;
    use crate::vision::Lens;
    use crate::vision::calibration::{GLOBALS, NotCalibrated, Setup};
    use nalgebra::Vector3;
    use std::path::Path;

    /// The reported s.d. of the fixed camera is of the size of its true error, and the written
    /// section draws errors of that size.
    #[test]
    fn camera_error_agrees_with_reported_deviations() {
        for seed in [1, 2, 3] {
            let text = format!("seed = {seed}");
            let scenario = crate::tasks::read(Path::new("test.toml"), &text, &[]).unwrap();

            let reports = calibrate::run(&scenario, Some(0), 12, |_| {}).unwrap();

            let found = reports[0].found.as_ref().unwrap();
            let left = reports[0].errors.1.unwrap();
            let norm = |d: &[f64]| d.iter().map(|x| x * x).sum::<f64>().sqrt();
            let of_size = |error: f64, deviation: f64| {
                let ratio = error / deviation;
                assert!((1.0 / 3.0..3.0).contains(&ratio), "{seed}: {ratio} of {left:?} {found:?}");
            };
            of_size(left.place, norm(&found.true_deviations[..3]));
            of_size(left.tilt, norm(&found.true_deviations[3..]));
            // The arm sags, so the s.d. relative to its encoders is smaller than the true error.
            assert!(left.place > 2.0 * norm(&found.deviations[6..9]), "{seed}: {left:?}");
            let written = section(&scenario.controller, &reports);
            let spread = crate::tasks::read(Path::new("again.toml"), &written, &[]).unwrap();
            of_size(left.place, spread.plant.keys.errors.camera * 3.0_f64.sqrt());
            of_size(left.tilt, spread.plant.keys.errors.camera_tilt * 3.0_f64.sqrt());
        }
    }

    /// Returns the report of a calibration of the camera with this index, whose values differ from
    /// those of the scenario and from those of the other cameras.
    fn calibrated(camera: usize) -> Report {
        let by = camera as f64;
        let lens = Lens {
            focal: (601.5 + by, 598.25 - by),
            centre: (322.125 + by, 236.5 - by),
            radial: [-0.031 - 0.001 * by, 0.012, 0.0],
            tangential: [0.0; 2],
        };
        let pose = Pose::new(Vector3::new(0.3, -0.2, 0.1 * by), Vector3::new(0.4, -0.1, by));
        let setup = Setup { lens, camera: pose, cube: Pose::identity(), edge: 0.057 };
        let mut deviations = [0.5; GLOBALS];
        (deviations[0], deviations[2], deviations[3]) = (6.0, 3.0, 4.0);
        let (true_deviations, arm) = ([3e-3, 4e-3, 0.0, 6e-3, 8e-3, 0.0], (0.0, 0.0));
        let found =
            Calibrated { setup, deviations, true_deviations, residual_px: 0.1, arm, grooves: 9 };
        let none =
            Errors { focal: 0.0, centre: 0.0, place: 0.0, tilt: 0.0, lateral: 0.0, depth: 0.0 };
        let (errors, hand) = ((none, Some(none)), ([0.0; 2], None));
        Report { camera, found: Ok(found), views: (9, 9), time: 1.0, errors, sag: [0.0; 3], hand }
    }

    /// All cameras are written, since a list in a scenario replaces the built-in one. One that was
    /// not calibrated keeps its values.
    #[test]
    fn written_calibration_reads_back_as_equal_cameras() {
        let path = Path::new("test.toml");
        let before = crate::tasks::read(path, "", &[]).unwrap().controller;
        let failed = Err(NotCalibrated::Undetermined);
        let reports = [calibrated(0), calibrated(2), Report { found: failed, ..calibrated(1) }];
        let mut wanted = before.cell.cameras.clone();
        for index in [0, 2] {
            let Setup { lens, camera: pose, .. } = calibrated(index).found.unwrap().setup;
            let Camera { intrinsics, mount, .. } = &mut wanted[index];
            (intrinsics.focal, intrinsics.centre) = (lens.focal, lens.centre);
            intrinsics.distortion = (lens.radial[0], lens.radial[1]);
            *place_of(mount) = pose;
        }
        assert_eq!(wanted.len(), 3);

        let written = section(&before, &reports);

        assert_eq!(written.matches("[[camera]]").count(), wanted.len(), "{written}");
        let again = crate::tasks::read(path, &written, &[]).unwrap();
        for (wanted, read) in wanted.iter_mut().zip(again.controller.cell.cameras) {
            let (mut mount, pose) = (read.mount, *place_of(&mut wanted.mount));
            let apart = pose.inverse() * std::mem::replace(place_of(&mut mount), pose);
            assert!(apart.translation.vector.norm() < 1e-6 && apart.rotation.angle() < 1e-6);
            assert_eq!(*wanted, Camera { mount, ..read });
        }
        // The root mean squares of 3 and 4, and of 6 and 8, along two or three axes.
        let errors = again.plant.keys.errors;
        let off = |value: f64, wanted: f64| (value / wanted - 1.0).abs();
        assert!(off(errors.camera, (25e-6_f64 / 3.0).sqrt()) < 1e-3, "{written}");
        assert!(off(errors.camera_tilt, (100e-6_f64 / 3.0).sqrt()) < 1e-3, "{written}");
        assert!(off(errors.centre, 12.5_f64.sqrt()) < 1e-3, "{written}");
        assert!(off(errors.focal, 6.0 / 602.5) < 2e-3, "{written}");
    }

    /// Returns the pose of a mount: in the world, or on the flange.
    fn place_of(mount: &mut Mount) -> &mut Pose {
        match mount {
            Mount::World { world_from_camera: pose }
            | Mount::Flange { flange_from_camera: pose, .. } => pose,
        }
    }
}
