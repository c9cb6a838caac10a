//! The shell of a calibration: an arm shows the cube to a camera, or carries a camera around the cube.
//!
//! The arms are driven through the hardware port by the servos and the generator of a run, one period after another,
//! and the frames come from the camera's port; what the adjustment gets is what the encoders and the pictures say.
//! Only at the end, for the operator's information, the result is compared with the plant's truth.
//!
//! - in: a scenario, which of its cameras, how many views
//! - out: for each camera what was found, and what error it leaves

use super::calibration_poses::{Draw, Plan, in_hand_plan, standing_plan};
use super::settings;
use super::simulation as plant_side;
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
use crate::motion::{ArmState, Depth, JawCommand, JointPositions};
use crate::reach::{MeetingTable, ReachSettings};
use crate::scenario::keys::Task;
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

/// What became of one camera.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Report {
    /// Index of the camera in the cell.
    pub(crate) camera: usize,
    /// What was found, or why nothing was.
    pub(crate) found: Result<Calibrated, NotCalibrated>,
    /// Poses of the arm, and those whose frame could be used.
    pub(crate) views: (usize, usize),
    /// Simulated time that it took (s).
    pub(crate) time: f64,
    /// Against the plant's truth: the scenario's own values, and what was found.
    pub(crate) errors: (Errors, Option<Errors>),
    /// By how much the hand that moved was elsewhere than its encoders said, on the average: it sags. Each axis of the
    /// world (m).
    pub(crate) sag: [f64; 3],
    /// How far a point of the hand is from where camera and encoders together expect it, r.m.s. over all poses, by the
    /// scenario's own values and by what was found: across the sight, along it (m).
    pub(crate) hand: ([f64; 2], Option<[f64; 2]>),
}

/// By how much a camera's values are wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Errors {
    /// Focal length, relative.
    pub(crate) focal: f64,
    /// Principal point (px).
    pub(crate) centre: f64,
    /// Place of the camera (m).
    pub(crate) place: f64,
    /// Its orientation (rad).
    pub(crate) tilt: f64,
    /// Error of the measured place of a cube in the middle of the picture at working distance,
    /// which follows from all these: across the sight (m).
    pub(crate) lateral: f64,
    /// The same along the sight (m).
    pub(crate) depth: f64,
}

/// Time that an arm is given to come to rest before a frame is taken (s).
const REST: f64 = 0.5;
/// Exposures that are tried.
const EXPOSURES: [f64; 3] = [1.0, 1.8, 0.55];
/// A view needs so many grooves.
const LEAST_GROOVES: usize = 10;

/// Calibrates cameras of a scenario; `None` means all. `tell` hears what is going on.
///
/// # Errors
/// When the cell cannot do it at all, or an arm stops; a camera that cannot be calibrated is part of the reports.
pub(crate) fn run(
    scenario: &Scenario,
    camera: Option<usize>,
    views: usize,
    mut tell: impl FnMut(&str),
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
        tell(&format!("{}: {} poses", one.name, plan.poses.len()));
        reports.push(perform(scenario, index, &plan)?);
    }
    Ok(reports)
}

/// Returns the scenario with the cameras as a calibration in its cell finds them, where it wants
/// one and hands over a cube: the workshop's work before a run. The plant's truth is drawn around the
/// scenario as it was read. Also returns the cameras that could not be calibrated, each with the
/// reason: the run uses them as the scenario has them.
pub(super) fn believed(scenario: &Scenario) -> (Cow<'_, Scenario>, Vec<String>) {
    let (mut believed, mut failed) = (Cow::Borrowed(scenario), Vec::new());
    let hands_over = matches!(scenario.controller.task, Task::Solve | Task::Acquire);
    if scenario.bridge.kind.is_hardware() || !hands_over {
        return (believed, failed);
    }
    for (index, views) in scenario.controller.calibrate_views.iter().enumerate() {
        let rendered = scenario.controller.cameras[index] == CameraSource::Renderer;
        if *views == 0 || !rendered {
            continue;
        }
        let found = run(scenario, Some(index), *views as usize, |_| {})
            .map_err(|error| error.to_string())
            .and_then(|mut reports| {
                let report = reports.pop().ok_or("there is no such camera")?;
                report.found.map_err(|reason| reason.to_string())
            });
        let camera = &scenario.controller.cell.cameras[index];
        match found {
            Ok(found) => {
                let cell = &mut believed.to_mut().controller.cell;
                cell.cameras[index] = calibrated(camera, &found.setup);
                // Measured by the way the arm went with it: a cube believed too large is seen too far away.
                cell.cube.edge = found.setup.edge;
            }
            Err(reason) => {
                tracing::warn!(camera = %camera.name, %reason, "not calibrated");
                failed.push(format!("{}: {reason}", camera.name));
            }
        }
    }
    (believed, failed)
}

/// Returns the camera with the optics and at the place that were found.
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

fn failed(why: &str) -> Error {
    let cause = System::NotCreated { who: "calibration".into(), why: why.into() };
    Error::System { actor: "calibration".into(), place: "create", cause }
}

/// The servos of both arms and the port that they work on.
struct Arms {
    port: Plant,
    servos: Vec<ArmServo>,
    readings: Vec<ArmReading>,
    drives: Vec<ArmDrive>,
    states: Vec<ArmState>,
    period: u64,
}

impl Arms {
    fn new(config: &ControllerConfig, mut port: Plant) -> Result<Self, Error> {
        let count = config.cell.arms.len();
        let mut readings = vec![ArmReading::default(); count];
        let drives = vec![ArmDrive::OFF; count];
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

    /// A servo period; at most one arm is told something.
    fn period(&mut self, told: Option<(usize, ServoCommand)>) -> Result<(), Error> {
        self.period += 1;
        for (i, servo) in self.servos.iter_mut().enumerate() {
            let command = told.as_ref().filter(|(arm, _)| *arm == i).map(|(_, c)| c);
            let (drive, state) = servo.step(self.period, &self.readings[i], command);
            (self.drives[i], self.states[i]) = (drive, state);
            if let Some(fault) = state.fault {
                let cause = Fatal::Arm(fault);
                return Err(Error::Fatal {
                    actor: "calibration".into(),
                    place: "move",
                    cause,
                    last: None,
                });
            }
        }
        self.port
            .exchange(self.period, &self.drives, &mut self.readings)
            .map_err(|e| failed(&e.to_string()))
    }

    /// Moves an arm and lets it come to rest; whether it got there.
    fn go(
        &mut self,
        arm: usize,
        to: JointPositions,
        manner: &Manner,
        jaw: Option<JawCommand>,
    ) -> Result<bool, Error> {
        let macrostep = manner.compliance.macrostep;
        let mut generator = Position::joints(to, (0.8, 0.0), &manner.speeds, macrostep);
        loop {
            let state = self.states[arm];
            let inputs = Inputs { arm: &state, target: None, period: state.period, pace: 1.0 };
            let Next::Go(mut command) = generator.next(&inputs) else { break };
            command.jaw = jaw;
            self.period(Some((arm, ServoCommand::Move { command, start: 0 })))?;
            while self.states[arm].command_end > self.period + ArmServo::EARLY {
                self.period(None)?;
            }
            if self.states[arm].refused.is_some() {
                return Ok(false);
            }
        }
        for _ in 0..(REST / crate::motion::PERIOD) as usize {
            self.period(None)?;
        }
        Ok(true)
    }
}

/// What the poses of a plan gave.
#[derive(Default)]
struct Taken {
    /// Where the encoders have the arm, and the picture.
    frames: Vec<(Pose, RgbImage)>,
    /// Where the plant has the arm: for the report alone.
    truths: Vec<Pose>,
}

/// Calibrates a camera by a plan.
fn perform(scenario: &Scenario, index: usize, plan: &Plan) -> Result<Report, Error> {
    let plant =
        plant_side::create_holding(scenario, plan.holder, plan.tool_from_cube, &plan.starts)
            .map_err(|why| failed(&why))?;
    let (scenes, output) = triple_buffer::triple_buffer::<Scene>(&plant.scene());
    let renderer = plant_side::renderer(scenario, &plant, index)
        .ok_or_else(|| failed("the plant has no such camera"))?;
    let source = PlantCamera::new(renderer, output);
    let mut arms = Arms::new(&scenario.controller, plant)?;
    let taken = take_pictures(&scenario.controller, plan, &mut arms, (source, scenes))?;
    let (found, used) = adjust(plan, &taken.frames);
    let report = Report {
        camera: index,
        views: (plan.poses.len(), used),
        time: arms.period as f64 * crate::motion::PERIOD,
        ..compare(&scenario.controller.cell, index, plan, &arms, (taken, found))
    };
    Ok(report)
}

/// Moves the arm through the poses of a plan and takes a picture at each that it reaches.
fn take_pictures(
    config: &ControllerConfig,
    plan: &Plan,
    arms: &mut Arms,
    (mut source, mut scenes): (PlantCamera, triple_buffer::Input<Scene>),
) -> Result<Taken, Error> {
    let cell = &config.cell;
    let manner = settings::manner(config, plan.mover);
    let grip = JawCommand {
        opening: (cell.cube.edge - 0.003).max(cell.arms[plan.holder].gripper.opening.0),
        force_limit: config.control.grip,
        stops: Depth::One,
    };
    // The holder closes its jaws where it stands; then the mover begins.
    arms.period(None)?;
    let stand = arms.states[plan.holder].joints;
    arms.go(plan.holder, stand, &manner, Some(grip))?;
    let jaw = (plan.mover == plan.holder).then_some(grip);
    let mut taken = Taken::default();
    let mut served = 0;
    for pose in &plan.poses {
        if !arms.go(plan.mover, *pose, &manner, jaw)? {
            continue;
        }
        scenes.write(arms.port.scene());
        let arm = &cell.arms[plan.mover];
        let state = &arms.states[plan.mover];
        let pose = match plan.rig {
            Rig::Standing => {
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
            Rig::Standing => seen.world_from_tool,
            Rig::InHand => seen.world_from_flange,
        });
    }
    Ok(taken)
}

/// Takes a picture with the first exposure that shows the cube. The light is not the one for which
/// the nominal exposure was chosen: the exposure that `served` last comes first.
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

/// Compares what was found with the plant's truth, for the operator's information alone.
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
    // In the world, also for an arm whose base stands elsewhere than believed.
    let in_world = |pose: &Pose| match plan.rig {
        Rig::Standing => *pose,
        Rig::InHand => cell.arms[plan.mover].world_from_base * pose,
    };
    let mut sag = Vector3::zeros();
    for ((encoders, _), truth) in frames.iter().zip(&truths) {
        sag += (truth.translation.vector - in_world(encoders).translation.vector)
            / frames.len().max(1) as f64;
    }
    let hand = |camera: &Pose| hand_errors(plan.rig, &place(truth), camera, &frames, &truths);
    let hand = (hand(&place(believed)), found.as_ref().ok().map(|c| hand(&c.setup.camera)));
    let (sag, errors) = (sag.into(), (before, after));
    Report { camera: index, found, views: (0, 0), time: 0.0, errors, sag, hand }
}

/// Twice: the grooves are found again with the optics of the first adjustment.
fn adjust(plan: &Plan, frames: &[(Pose, RgbImage)]) -> (Result<Calibrated, NotCalibrated>, usize) {
    let mut setup = plan.guess;
    let mut result = Err(NotCalibrated::TooFewViews { views: 0 });
    let mut used = 0;
    for _ in 0..2 {
        let views: Vec<View> =
            frames.iter().filter_map(|(arm, image)| view(plan.rig, &setup, arm, image)).collect();
        used = views.len();
        result = calibrate(plan.rig, &views, &plan.guess, &Spreads::default());
        match &result {
            Ok(found) => setup = found.setup,
            Err(_) => break,
        }
    }
    (result, used)
}

fn view(rig: Rig, setup: &Setup, arm: &Pose, image: &RgbImage) -> Option<View> {
    let motion = match rig {
        Rig::Standing => *arm,
        Rig::InHand => arm.inverse(),
    };
    let expected = setup.camera.inverse() * motion * setup.cube;
    let located = detect(image, None, &DetectorSettings::default())
        .ok()
        .and_then(|faces| locate_in(image, &faces, setup.lens, setup.edge, Some(&expected)))
        .filter(|location| agrees(location, &expected));
    // After the first round the place is known well enough to do without a detection.
    let location = located.or_else(|| refine_in(image, setup.lens, setup.edge, &expected))?;
    if !agrees(&location, &expected) {
        return None;
    }
    let grooves = grooves_in(image, &setup.lens, setup.edge, &location, &expected);
    (grooves.len() >= LEAST_GROOVES).then_some(View { arm: *arm, grooves })
}

/// Not something else that looks like a cube, nor an orientation that cannot be.
fn agrees(location: &CubeLocation, expected: &Pose) -> bool {
    let apart = location.camera_from_cube.translation.vector - expected.translation.vector;
    let relative = expected.rotation.inverse() * location.camera_from_cube.rotation;
    let named = nearest_of_24(&relative);
    apart.norm() < 0.04 && (named.inverse() * relative).angle() < 0.2
}

/// `world_from_camera` or `flange_from_camera`.
fn place(camera: &Camera) -> Pose {
    match camera.mount {
        Mount::World { world_from_camera } => world_from_camera,
        Mount::Flange { flange_from_camera, .. } => flange_from_camera,
    }
}

/// Where a standing camera should see the hand's tool by what is believed, against where it is: across the sight,
/// along it, r.m.s. A camera in a hand has nothing to do with this: zero.
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
        let along = error.dot(&is.normalize());
        sums[0] += error.norm_squared() - along * along;
        sums[1] += along * along;
    }
    sums.map(|sum| (sum / frames.len() as f64).sqrt())
}

/// By how much values differ from the truth.
fn errors(truth: &Camera, lens: &Lens, found: &Pose, distance: f64) -> Errors {
    let optics: &Intrinsics = &truth.intrinsics;
    let real = place(truth);
    // A cube on the sight: its direction is read with the wrong optics, its distance scales with the focal length.
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
    use crate::scenario;
    use std::path::Path;

    #[test]
    fn a_standing_camera_and_the_arm_agree_on_where_the_cube_is_taken() {
        let scenario = scenario::read(Path::new("test.toml"), "seed = 5", &[]).unwrap();

        let reports = run(&scenario, Some(0), 16, |_| {}).unwrap();

        let report = &reports[0];
        assert_eq!(report.views, (16, 16), "nothing may take the cube away");
        let (before, after) = (report.hand.0, report.hand.1.unwrap());
        assert!(before[0] > 3e-3, "the arm sags, the camera is elsewhere: {before:?}");
        assert!(after[0] < 1.5e-3 && after[1] < 2e-3, "{after:?}");
    }

    #[test]
    fn only_a_hand_over_is_worth_a_calibration() {
        let text = |task: &str| format!("task = \"{task}\"\nseed = 5");
        let of = |task| scenario::read(Path::new("test.toml"), &text(task), &[]).unwrap();
        let (acquire, idle) = (of("acquire"), of("idle"));

        let (believed, failed) = believed(&acquire);

        assert_eq!(failed, [""; 0]);
        let [old, new] = [&acquire, &*believed].map(|s| place(&s.controller.cell.cameras[0]));
        assert!((old.translation.vector - new.translation.vector).norm() > 1e-3);
        assert_eq!(acquire.controller.cell.cameras[1..], believed.controller.cell.cameras[1..]);
        assert!(matches!(super::believed(&idle), (Cow::Borrowed(_), _)));
    }

    #[test]
    fn camera_with_too_few_views_is_told_uncalibrated() {
        let mut scenario = scenario::read(Path::new("test.toml"), "seed = 5", &[]).unwrap();
        scenario.controller.calibrate_views[0] = 1;

        let (believed, failed) = believed(&scenario);

        assert!(failed.len() == 1 && failed[0].starts_with("standalone: "), "{failed:?}");
        assert!(matches!(believed, Cow::Borrowed(_)), "the camera stays as the scenario has it");
    }
}
