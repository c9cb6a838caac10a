//! Calibration of cameras: an arm shows the cube to a standing camera, or carries its own camera
//! around the cube.
//!
//! The servos and the position generator of a run move the arms through the hardware port, one
//! period after another. The frames come from the camera's port. The adjustment gets only what
//! encoders and pictures say. At the end the result is compared with the plant's truth, for the
//! operator's information alone.
//!
//! - in: a scenario, the cameras to calibrate, the number of views
//! - out: a [`Report`] for each camera: its optics and place, and the error that remains

use super::calibration_poses::{Draw, Plan, in_hand_plan, standing_plan};

use super::simulation as plant_side;
use crate::actors::manner::manner;
use crate::actors::move_instruction::Manner;
use crate::cell::{Camera, Cell, Intrinsics, Mount};
use crate::error::{Error, Fatal, System};
use crate::generators::position::Position;
use crate::generators::{Inputs, Next};
use crate::hw::camera::FrameSource;
use crate::hw::plant::Plant;
use crate::hw::plant::render::PlantCamera;
use crate::hw::port::Port;
use crate::hw::scene::Scene;
use crate::motion::{ArmState, Depth, JawCommand, JointPositions, PERIOD};
use crate::reach::{MeetingTable, ReachSettings};
use crate::scenario::{CameraSource, ControllerConfig, Scenario};
use crate::servo::io::{ArmDrive, ArmReading};
use crate::servo::{ArmServo, ServoCommand, ServoConfig};
use crate::spatial::Pose;
use crate::vision::calibration::{
    Calibrated, NotCalibrated, Rig, Setup, Spreads, View, calibrate, grooves_in,
};
use crate::vision::pose::nearest_of_24;
use crate::vision::{CubeLocation, DetectorSettings, Lens, detect, locate_in, refine_in};
use image::RgbImage;
use nalgebra::{Point3, Vector3};
use std::borrow::Cow;

/// Result of the calibration of one camera.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Report {
    /// Index of the camera in the cell.
    pub(crate) camera: usize,
    /// Optics and place of the camera, or the reason why there are none.
    pub(crate) found: Result<Calibrated, NotCalibrated>,
    /// Number of poses of the plan, and number of those whose frame was usable.
    pub(crate) views: (usize, usize),
    /// Simulated time of the calibration (s).
    pub(crate) time: f64,
    /// Errors against the plant's truth: of the scenario's own values, and of the result.
    pub(crate) errors: (Errors, Option<Errors>),
    /// Mean offset of the moving hand from the place that its encoders gave, in the axes of the
    /// world (m). The arm sags below its encoders.
    pub(crate) sag: [f64; 3],
    /// Distance of the hand's tool from where camera and encoders together expect it, r.m.s. over
    /// all poses: by the scenario's own values, and by the result. Each is across the line of sight
    /// and along it (m).
    pub(crate) hand: ([f64; 2], Option<[f64; 2]>),
}

/// Errors of a camera's values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Errors {
    /// Error of the focal length, relative.
    pub(crate) focal: f64,
    /// Distance of the principal point from the true one (px).
    pub(crate) centre: f64,
    /// Distance of the camera's place from the true one (m).
    pub(crate) place: f64,
    /// Angle of the camera's orientation to the true one (rad).
    pub(crate) tilt: f64,
    /// Error of the measured place of a cube on the optical axis at working distance, which follows
    /// from all of these: the part across the line of sight (m).
    pub(crate) lateral: f64,
    /// Part of the same error along the line of sight (m).
    pub(crate) depth: f64,
}

/// Time that an arm is given to come to rest before a frame is taken (s).
const REST: f64 = 0.5;
/// Exposures that are tried, as factors of the nominal exposure.
const EXPOSURES: [f64; 3] = [1.0, 1.8, 0.55];
/// Least number of grooves that a usable view shows.
const LEAST_GROOVES: usize = 10;

/// Calibrates a camera of a scenario, or all cameras if `camera` is `None`, each with pictures from
/// `views` poses of an arm. `report` is called with a line of text as each camera begins.
///
/// # Errors
/// If the cell does not have two arms, no poses are found, or an arm stops. A camera that cannot be
/// calibrated is part of the reports instead.
pub(crate) fn run(
    scenario: &Scenario,
    camera: Option<usize>,
    views: usize,
    mut report: impl FnMut(&str),
) -> Result<Vec<Report>, Error> {
    let cell = &scenario.controller.cell;
    if cell.arms.len() != 2 {
        return Err(failed("the cell needs two arms: one holds the cube"));
    }
    let draw = Draw { views, seed: scenario.seed };
    let mut reports = Vec::new();
    let mut meetings: Option<MeetingTable> = None;
    for (index, one) in cell.cameras.iter().enumerate() {
        if camera.is_some_and(|wanted| wanted != index) {
            continue;
        }
        let plan = match one.mount {
            Mount::World { world_from_camera } => {
                standing_plan(cell, one, &world_from_camera, draw)
            }
            Mount::Flange { arm, flange_from_camera } => {
                // Only cameras in hands need the meetings, whose search takes about a second.
                let table = meetings
                    .get_or_insert_with(|| MeetingTable::compute(cell, &ReachSettings::default()));
                in_hand_plan(cell, arm, &flange_from_camera, table, draw)
            }
        };
        let Some(plan) = plan else {
            return Err(failed(&format!(
                "no poses were found at which {} sees the cube",
                one.name
            )));
        };
        report(&format!("{}: {} poses", one.name, plan.poses.len()));
        reports.push(perform(scenario, index, &plan)?);
    }
    Ok(reports)
}

/// Returns the scenario with the cameras calibrated in its simulated cell, as a workshop does
/// before a run, if the scenario asks for this and its task takes the cube from the operator.
/// Otherwise returns the scenario unchanged.
///
/// Also returns the cameras that could not be calibrated, each with the reason; they keep the
/// scenario's values.
pub(super) fn believed(scenario: &Scenario) -> (Cow<'_, Scenario>, Vec<String>) {
    let (mut believed, mut failed) = (Cow::Borrowed(scenario), Vec::new());
    // Only a hand-over needs the stand-alone camera in the frame of the arm. A workshop calibrates
    // real cameras by `rubik-robot calibrate` before the run.
    let hands_over = scenario.controller.task.properties.hands_over;
    if scenario.bridge.kind.is_hardware() || !hands_over {
        return (believed, failed);
    }
    for (index, views) in scenario.controller.calibrate_views.iter().enumerate() {
        // Image files do not show the cube at the poses of the plan.
        let rendered = scenario.controller.cameras[index] == CameraSource::Renderer;
        if *views == 0 || !rendered {
            continue;
        }
        let found = run(scenario, Some(index), *views as usize, |_| {})
            .map_err(|error| error.to_string())
            .and_then(|mut reports| {
                let report = reports.pop().ok_or("the camera was not found")?;
                report.found.map_err(|reason| reason.to_string())
            });
        let camera = &scenario.controller.cell.cameras[index];
        match found {
            Ok(found) => {
                let cell = &mut believed.to_mut().controller.cell;
                cell.cameras[index] = calibrated(camera, &found.setup);
                // The arm's known displacements between the views give the edge its scale. A cube
                // that is believed too large is located too far away.
                cell.cube.edge = found.setup.edge;
            }
            Err(reason) => {
                tracing::warn!("the camera {} is not calibrated: {reason}", camera.name);
                failed.push(format!("{}: {reason}", camera.name));
            }
        }
    }
    (believed, failed)
}

/// Returns the camera `before` with the optics and the pose of `setup`, the result of its
/// calibration.
fn calibrated(before: &Camera, setup: &Setup) -> Camera {
    let lens = &setup.lens;
    let mut camera = before.clone();
    camera.intrinsics.focal = lens.focal;
    camera.intrinsics.centre = lens.centre;
    camera.intrinsics.distortion = (lens.radial[0], lens.radial[1]);
    match &mut camera.mount {
        Mount::World { world_from_camera: place }
        | Mount::Flange { flange_from_camera: place, .. } => *place = setup.camera,
    }
    camera
}

/// Returns the error of a calibration that is not possible, with its reason.
fn failed(why: &str) -> Error {
    let cause = System::NotCreated { who: "calibration".into(), why: why.into() };
    Error::System { actor: "calibration".into(), place: "create".into(), cause }
}

/// The servos of both arms and the port that they work on.
struct Arms {
    port: Plant,
    servos: Vec<ArmServo>,
    readings: Vec<ArmReading>,
    drives: Vec<ArmDrive>,
    /// State of each arm after the last period.
    states: Vec<ArmState>,
    /// Number of the last period.
    period: u64,
}

impl Arms {
    /// Creates the servos of all arms, at rest where the plant `port` has its arms.
    ///
    /// # Errors
    /// If the port fails.
    fn new(config: &ControllerConfig, mut port: Plant) -> Result<Self, Error> {
        let count = config.cell.arms.len();
        let mut readings = vec![ArmReading::default(); count];
        let drives = vec![ArmDrive::OFF; count];
        // Each servo takes its first set values from a measured position: the port is read once
        // before the servos exist.
        port.exchange(0, &drives, &mut readings).map_err(|e| failed(&e.to_string()))?;
        let servos = config
            .cell
            .arms
            .iter()
            .zip(&config.effectors)
            .zip(&readings)
            .map(|((arm, e), reading)| {
                ArmServo::new(ServoConfig::new(arm, e.gains.clone()), reading)
            })
            .collect();
        let states = vec![ArmState::default(); count];
        Ok(Self { port, servos, readings, drives, states, period: 0 })
    }

    /// Performs a servo period of both arms; `order` is a command for one of them.
    ///
    /// # Errors
    /// If an arm or the port fails.
    fn period(&mut self, order: Option<(usize, ServoCommand)>) -> Result<(), Error> {
        self.period += 1;
        for (i, servo) in self.servos.iter_mut().enumerate() {
            let command = order.as_ref().filter(|(arm, _)| *arm == i).map(|(_, c)| c);
            let (drive, state) = servo.step(self.period, &self.readings[i], command);
            (self.drives[i], self.states[i]) = (drive, state);
            if let Some(fault) = state.fault {
                let cause = Fatal::Arm(fault);
                return Err(Error::Fatal {
                    actor: "calibration".into(),
                    place: "move".into(),
                    cause,
                    last: None,
                });
            }
        }
        self.port
            .exchange(self.period, &self.drives, &mut self.readings)
            .map_err(|e| failed(&e.to_string()))
    }

    /// Moves an arm to joint positions and lets it come to rest. `manner` has its speeds; `jaw` is
    /// the grip that each command repeats. Returns `false` if the servo refused a command.
    ///
    /// # Errors
    /// If an arm or the port fails.
    fn go(
        &mut self,
        arm: usize,
        to: JointPositions,
        manner: &Manner,
        jaw: Option<JawCommand>,
    ) -> Result<bool, Error> {
        let macrostep = manner.compliance.macrostep;
        // At 0.8 of the full speeds, without a least duration.
        let mut generator = Position::joints(to, (0.8, 0.0), &manner.speeds, macrostep);
        loop {
            let state = self.states[arm];
            let inputs = Inputs {
                arm: &state,
                target: None,
                reading: None,
                period: state.period,
                pace: 1.0,
            };
            let Next::Go(mut command) = generator.next(&inputs) else { break };
            // The generator moves joints only; the hand that holds the cube needs its grip in each
            // command.
            command.jaw = jaw;
            self.period(Some((arm, ServoCommand::Move { command, start: 0 })))?;
            // The next macrostep is asked for `EARLY` periods before the end, as an EDP does, so
            // that the motion has no gaps.
            while self.states[arm].command_end > self.period + ArmServo::EARLY {
                self.period(None)?;
            }
            if self.states[arm].refused.is_some() {
                return Ok(false);
            }
        }
        // A moving hand would blur the frame and lag behind its encoders.
        for _ in 0..(REST / PERIOD) as usize {
            self.period(None)?;
        }
        Ok(true)
    }
}

/// Frames of a plan's poses.
#[derive(Default)]
struct Taken {
    /// Pose of the arm by its encoders, and the picture.
    frames: Vec<(Pose, RgbImage)>,
    /// Pose of the arm in the plant, for the report alone.
    truths: Vec<Pose>,
}

/// Calibrates the camera with this index in a simulated plant of its own, at the poses of `plan`.
///
/// # Errors
/// If the plant cannot be created, or an arm or the port fails.
fn perform(scenario: &Scenario, index: usize, plan: &Plan) -> Result<Report, Error> {
    let scenario = &scenario.at_usual_period();
    let plant =
        plant_side::create_holding(scenario, plan.holder, plan.tool_from_cube, &plan.starts)
            .map_err(|why| failed(&why))?;
    let (scenes, output) = triple_buffer::triple_buffer::<Scene>(&plant.scene());
    let renderer = plant_side::renderer(scenario, &plant, index)
        .ok_or_else(|| failed("the plant does not have this camera"))?;
    let source = PlantCamera::new(renderer, output);
    let mut arms = Arms::new(&scenario.controller, plant)?;
    let taken = take_pictures(&scenario.controller, plan, &mut arms, (source, scenes))?;
    let (found, used) = adjust(plan, &taken.frames);
    let report = Report {
        camera: index,
        // `compare` knows neither the number of usable views nor the time.
        views: (plan.poses.len(), used),
        time: arms.period as f64 * PERIOD,
        ..compare(&scenario.controller.cell, index, plan, &arms, (taken, found))
    };
    Ok(report)
}

/// Moves the arm through the poses of a plan and takes a picture at each pose that it reaches.
/// `source` is the camera, which renders the scene that is written to `scenes`.
///
/// # Errors
/// If an arm or the port fails.
fn take_pictures(
    config: &ControllerConfig,
    plan: &Plan,
    arms: &mut Arms,
    (mut source, mut scenes): (PlantCamera, triple_buffer::Input<Scene>),
) -> Result<Taken, Error> {
    let cell = &config.cell;
    let manner = manner(config, plan.mover);
    let grip = JawCommand {
        // An opening that the jaws cannot reach: the force limit determines the grip.
        opening: (cell.cube.edge - 0.003).max(cell.arms[plan.holder].gripper.opening.0),
        force_limit: config.control.grip,
        stops: Depth::One,
    };
    // The states are valid from the first period on. The holder closes its jaws without moving;
    // then the mover begins.
    arms.period(None)?;
    let stand = arms.states[plan.holder].joints;
    arms.go(plan.holder, stand, &manner, Some(grip))?;
    let jaw = (plan.mover == plan.holder).then_some(grip);
    let mut taken = Taken::default();
    let mut served = 0;
    for pose in &plan.poses {
        // The plan checks single poses, not the paths between them: a refused path loses one view.
        if !arms.go(plan.mover, *pose, &manner, jaw)? {
            continue;
        }
        scenes.write(arms.port.scene());
        // The adjustment knows the pose by the believed cell and the encoders alone.
        let arm = &cell.arms[plan.mover];
        let state = &arms.states[plan.mover];
        let pose = match plan.rig {
            Rig::Fixed => {
                arm.world_from_base
                    * arm.model.base_from_flange(&state.joints)
                    * arm.flange_from_tool
            }
            Rig::InHand => arm.model.base_from_flange(&state.joints),
        };
        let Some(image) = picture(plan, &pose, &mut source, arms.period, &mut served) else {
            continue;
        };
        taken.frames.push((pose, image));
        let seen = arms.port.scene().arms[plan.mover];
        taken.truths.push(match plan.rig {
            Rig::Fixed => seen.world_from_tool,
            Rig::InHand => seen.world_from_flange,
        });
    }
    Ok(taken)
}

/// Takes a picture of the cube at the arm's pose `pose`: with the first of several exposures that
/// shows the cube, or with the last one if none does. The exposure that worked for the last pose
/// (`served`, an index of [`EXPOSURES`]) is tried first, since the nominal exposure was not chosen
/// for this cell's light.
fn picture(
    plan: &Plan,
    pose: &Pose,
    source: &mut PlantCamera,
    period: u64,
    served: &mut usize,
) -> Option<RgbImage> {
    let (first, mut kept) = (*served, None);
    for i in 0..EXPOSURES.len() {
        let number = (first + i) % EXPOSURES.len();
        let Ok(frame) = source.grab(period, EXPOSURES[number]) else { continue };
        let serves = view(plan.rig, &plan.guess, pose, &frame.image).is_some();
        kept = Some(frame.image);
        if serves {
            *served = number;
            break;
        }
    }
    kept
}

/// Compares a camera's calibration `found`, made from `taken`, with the plant's true camera, for
/// the operator's information alone.
fn compare(
    cell: &Cell,
    index: usize,
    plan: &Plan,
    arms: &Arms,
    (taken, found): (Taken, Result<Calibrated, NotCalibrated>),
) -> Report {
    let Taken { frames, truths } = taken;
    let truth = &arms.port.cell().cameras[index];
    let believed = &cell.cameras[index];
    let before = errors(truth, &Lens::from(&believed.intrinsics), &place(believed), plan.distance);
    let after =
        found.as_ref().ok().map(|c| errors(truth, &c.setup.lens, &c.setup.camera, plan.distance));
    // Encoders and truths are compared in the world frame, so the error of a displaced base counts
    // as well.
    let in_world = |pose: &Pose| match plan.rig {
        Rig::Fixed => *pose,
        Rig::InHand => cell.arms[plan.mover].world_from_base * pose,
    };
    let mut sag = Vector3::zeros();
    for ((encoders, _), truth) in frames.iter().zip(&truths) {
        sag += (truth.translation.vector - in_world(encoders).translation.vector)
            / frames.len().max(1) as f64;
    }
    // The true place of the camera gives the direction in which it sees the tool.
    let hand = |camera: &Pose| hand_errors(plan.rig, &place(truth), camera, &frames, &truths);
    let hand = (hand(&place(believed)), found.as_ref().ok().map(|c| hand(&c.setup.camera)));
    let (sag, errors) = (sag.into(), (before, after));
    Report { camera: index, found, views: (0, 0), time: 0.0, errors, sag, hand }
}

/// Computes optics and pose of the camera from the frames (arm's pose by its encoders, picture), in
/// two rounds: the second one finds the cube's grooves again with the optics of the first. Returns
/// the result and the number of usable frames.
fn adjust(plan: &Plan, frames: &[(Pose, RgbImage)]) -> (Result<Calibrated, NotCalibrated>, usize) {
    let mut setup = plan.guess;
    let mut result = Err(NotCalibrated::TooFewViews { views: 0 });
    let mut used = 0;
    for _ in 0..2 {
        let views: Vec<View> =
            frames.iter().filter_map(|(arm, image)| view(plan.rig, &setup, arm, image)).collect();
        used = views.len();
        // The guess stays the prior of both rounds: the first result is made of the same pictures.
        result = calibrate(plan.rig, &views, &plan.guess, &Spreads::default());
        match &result {
            Ok(found) => setup = found.setup,
            Err(_) => break,
        }
    }
    (result, used)
}

/// Finds the grooves of the cube in a frame, near the pose in the picture that `setup` and the
/// arm's pose predict. Returns `None` if the cube is not found there or shows fewer than
/// [`LEAST_GROOVES`] grooves.
fn view(rig: Rig, setup: &Setup, arm: &Pose, image: &RgbImage) -> Option<View> {
    // camera_from_cube = camera^-1 * motion * cube, where the arm moves the cube or the camera.
    let motion = match rig {
        Rig::Fixed => *arm,
        Rig::InHand => arm.inverse(),
    };
    let expected = setup.camera.inverse() * motion * setup.cube;
    let located = detect(image, None, &DetectorSettings::default())
        .ok()
        .and_then(|faces| locate_in(image, &faces, setup.lens, setup.edge, Some(&expected)))
        .filter(|location| agrees(location, &expected));
    // If the detection fails, the prediction may be good enough to find the edges. After the first
    // round of the adjustment it is.
    let location = located.or_else(|| refine_in(image, setup.lens, setup.edge, &expected))?;
    if !agrees(&location, &expected) {
        return None;
    }
    let grooves = grooves_in(image, &setup.lens, setup.edge, &location, &expected);
    (grooves.len() >= LEAST_GROOVES).then_some(View { arm: *arm, grooves })
}

/// Returns whether a cube found in a picture may be the expected one: its centre within 40 mm, its
/// orientation within 0.2 rad after one of the 24 rotations of a cube. Rejects other things that
/// look like a cube.
fn agrees(location: &CubeLocation, expected: &Pose) -> bool {
    let apart = location.camera_from_cube.translation.vector - expected.translation.vector;
    let relative = expected.rotation.inverse() * location.camera_from_cube.rotation;
    let named = nearest_of_24(&relative);
    apart.norm() < 0.04 && (named.inverse() * relative).angle() < 0.2
}

/// Returns the `world_from_camera` of a standing camera, or the `flange_from_camera` of one in a
/// hand.
fn place(camera: &Camera) -> Pose {
    match camera.mount {
        Mount::World { world_from_camera } => world_from_camera,
        Mount::Flange { flange_from_camera, .. } => flange_from_camera,
    }
}

/// Computes the distance of the true tool (`truths`) from where the encoders and a standing camera
/// at `camera` together expect it, r.m.s. over all frames: across and along the line of sight (m).
/// The true camera is at `real`. Returns zeros for a camera in a hand, since the take of the cube
/// does not use one.
fn hand_errors(
    rig: Rig,
    real: &Pose,
    camera: &Pose,
    frames: &[(Pose, RgbImage)],
    truths: &[Pose],
) -> [f64; 2] {
    if rig == Rig::InHand || frames.is_empty() {
        return [0.0; 2];
    }
    let mut sums = [0.0; 2];
    for ((encoders, _), truth) in frames.iter().zip(truths) {
        let is = (real.inverse() * truth).translation.vector;
        let error = (camera.inverse() * encoders).translation.vector - is;
        // One camera measures depth less well, so the parts along and across the line of sight are
        // reported separately.
        let along = error.dot(&is.normalize());
        sums[0] += error.norm_squared() - along * along;
        sums[1] += along * along;
    }
    sums.map(|sum| (sum / frames.len() as f64).sqrt())
}

/// Computes the errors of a calibrated camera, `lens` and pose `found`, against the true camera;
/// `distance` is the working distance (m).
fn errors(truth: &Camera, lens: &Lens, found: &Pose, distance: f64) -> Errors {
    let optics: &Intrinsics = &truth.intrinsics;
    let real = place(truth);
    // A cube on the true optical axis: the wrong optics give its direction, and its distance, which
    // comes from its apparent size, scales with the focal length.
    let at = Point3::new(0.0, 0.0, distance);
    let (x, y) = lens.unproject(optics.project(&at)).unwrap_or_default();
    let depth = distance * lens.focal.0 / optics.focal.0;
    let seen = found * Point3::new(x * depth, y * depth, depth);
    let error = real.inverse() * seen - at;
    Errors {
        focal: lens.focal.0 / optics.focal.0 - 1.0,
        centre: (lens.centre.0 - optics.centre.0).hypot(lens.centre.1 - optics.centre.1),
        place: (real.translation.vector - found.translation.vector).norm(),
        tilt: real.rotation.angle_to(&found.rotation),
        lateral: error.xy().norm(),
        depth: error.z.abs(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::path::Path;

    /// The arm sags and the camera is not where the scenario has it. After the calibration both
    /// agree on the place of the hand, which is what the take of the cube needs.
    #[test]
    fn calibrated_camera_agrees_with_sagging_arm() {
        let scenario = crate::tasks::read(Path::new("test.toml"), "seed = 5", &[]).unwrap();

        let reports = run(&scenario, Some(0), 16, |_| {}).unwrap();

        let report = &reports[0];
        assert_eq!(report.views, (16, 16), "the cube must not disappear");
        // Distances across the line of sight and along it.
        let (before, after) = (report.hand.0, report.hand.1.unwrap());
        assert!(before[0] > 3e-3, "the arm sags and the camera is displaced: {before:?}");
        assert!(after[0] < 1.5e-3 && after[1] < 2e-3, "{after:?}");
    }

    #[test]
    fn cell_is_calibrated_only_for_hand_over_tasks() {
        let text = |task: &str| format!("task = \"{task}\"\nseed = 5");
        let of = |task| crate::tasks::read(Path::new("test.toml"), &text(task), &[]).unwrap();
        let (acquire, idle) = (of("acquire"), of("idle"));

        let (believed, failed) = believed(&acquire);

        assert_eq!(failed, [""; 0]);
        let [old, new] = [&acquire, &*believed].map(|s| place(&s.controller.cell.cameras[0]));
        assert!((old.translation.vector - new.translation.vector).norm() > 1e-3);
        assert_eq!(acquire.controller.cell.cameras[1..], believed.controller.cell.cameras[1..]);
        assert!(matches!(super::believed(&idle), (Cow::Borrowed(_), _)));
    }

    #[test]
    fn camera_with_too_few_views_is_reported() {
        let mut scenario = crate::tasks::read(Path::new("test.toml"), "seed = 5", &[]).unwrap();
        scenario.controller.calibrate_views[0] = 1;

        let (believed, failed) = believed(&scenario);

        assert!(failed.len() == 1 && failed[0].starts_with("standalone: "), "{failed:?}");
        assert!(matches!(believed, Cow::Borrowed(_)), "the camera stays as the scenario has it");
    }
}
