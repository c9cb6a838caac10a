//! The shell of a calibration: an arm shows the cube to a camera, or carries a camera around the cube.
//!
//! The arms are driven through the hardware port by the servos and the generator of a run, one period after another,
//! and the frames come from the camera's port; what the adjustment gets is what the encoders and the pictures say.
//! Only at the end, for the operator's information, the result is compared with the plant's truth.
//!
//! - in: a scenario, which of its cameras, how many views
//! - out: for each camera what was found, and what error it leaves

use super::build;
use super::plant as plant_side;
use crate::cell::{Camera, Cell, Intrinsics, Mount};
use crate::cube::{Axis, Face};
use crate::error::{Error, Fatal, System};
use crate::generators::position::{Position, Speeds};
use crate::generators::{Inputs, Next};
use crate::hw::camera::FrameSource;
use crate::hw::plant::Plant;
use crate::hw::plant::render::PlantCamera;
use crate::hw::port::Port;
use crate::hw::scene::Scene;
use crate::motion::{ArmState, Depth, JawCommand, JointPositions};
use crate::reach::{MeetingTable, ReachSettings};
use crate::scenario::keys::Task;
use crate::scenario::{CameraSource, Scenario};
use crate::servo::io::{ArmDrive, ArmReading};
use crate::servo::{ArmServo, ServoCommand, ServoConfig};
use crate::spatial::{Pose, pose_from_axes};
use crate::tasks::cube::hold::Hold;
use crate::vision::calibration::{
    Calibrated, NotCalibrated, Rig, Setup, Spreads, View, calibrate, grooves_in,
};
use crate::vision::pose::nearest_of_24;
use crate::vision::{CubeLocation, DetectorSettings, Lens, detect, locate_in, refine_in};
use image::RgbImage;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use std::borrow::Cow;

/// What became of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Index of the camera in the cell.
    pub camera: usize,
    /// What was found, or why nothing was.
    pub found: Result<Calibrated, NotCalibrated>,
    /// Poses of the arm, and those whose frame could be used.
    pub views: (usize, usize),
    /// Simulated time that it took [s].
    pub time: f64,
    /// Against the plant's truth: the scenario's own values, and what was found.
    pub errors: (Errors, Option<Errors>),
    /// By how much the hand that moved was elsewhere than its encoders said, on the average: it sags. Each axis of the
    /// world [m].
    pub sag: [f64; 3],
    /// How far a point of the hand is from where camera and encoders together expect it, r.m.s. over all poses, by the
    /// scenario's own values and by what was found: across the sight, along it [m].
    pub hand: ([f64; 2], Option<[f64; 2]>),
}

/// By how much a camera's values are wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Errors {
    /// Focal length, relative.
    pub focal: f64,
    /// Principal point [px].
    pub centre: f64,
    /// Place of the camera [m].
    pub place: f64,
    /// Its orientation [rad].
    pub tilt: f64,
    /// What all of it comes to for a cube in the middle of the picture at working distance: across the sight [m].
    pub lateral: f64,
    /// The same along the sight [m].
    pub depth: f64,
}

/// Time that an arm is given to come to rest before a frame is taken [s].
const REST: f64 = 0.5;
/// Exposures that are tried.
const EXPOSURES: [f64; 3] = [1.0, 1.8, 0.55];
/// Poses are drawn this often for each that is wanted.
const TRIES: usize = 4000;
/// A view needs so many grooves.
const LEAST_GROOVES: usize = 10;
/// Distance between a camera in a hand and the cube at which it works [m].
const HAND_DISTANCE: f64 = 0.2;
/// Motors keep this share of their range from their limits.
const MARGIN: f64 = 0.02;

/// Calibrates cameras of a scenario; `None` means all. `tell` hears what is going on.
///
/// # Errors
/// When the cell cannot do it at all, or an arm stops; a camera that cannot be calibrated is part of the reports.
pub fn run(
    scenario: &Scenario,
    camera: Option<usize>,
    views: usize,
    mut tell: impl FnMut(&str),
) -> Result<Vec<Report>, Error> {
    let cell = &scenario.controller.cell;
    if cell.arms.len() != 2 {
        return Err(failed("the cell needs two arms: one holds the cube"));
    }
    let mut reports = Vec::new();
    let mut meetings: Option<MeetingTable> = None;
    for (index, one) in cell.cameras.iter().enumerate() {
        if camera.is_some_and(|wanted| wanted != index) {
            continue;
        }
        let plan = match one.mount {
            Mount::World { world_from_camera } => {
                standing_plan(cell, one, &world_from_camera, views, scenario.seed)
            }
            Mount::Flange { arm, flange_from_camera } => {
                let table = meetings
                    .get_or_insert_with(|| MeetingTable::compute(cell, &ReachSettings::default()));
                in_hand_plan(cell, arm, &flange_from_camera, table, views, scenario.seed)
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

/// The scenario with the cameras as a calibration in its cell finds them, where it wants one and hands over a cube: the
/// workshop's work before a run. What the plant's truth is drawn around stays in the scenario as it was read.
pub(super) fn believed(scenario: &Scenario) -> Cow<'_, Scenario> {
    let mut believed = Cow::Borrowed(scenario);
    let hands_over = matches!(scenario.controller.task, Task::Solve | Task::Acquire);
    if scenario.bridge.kind.is_hardware() || !hands_over {
        return believed;
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
                cell.cameras[index] = found.camera(camera);
                // Measured by the way the arm went with it: a cube believed too large is seen too far away.
                cell.cube.edge = found.setup.edge;
            }
            Err(reason) => tracing::warn!(camera = %camera.name, %reason, "not calibrated"),
        }
    }
    believed
}

impl Calibrated {
    /// A camera with the optics and at the place that were found.
    fn camera(&self, before: &Camera) -> Camera {
        let lens = &self.setup.lens;
        let mut camera = before.clone();
        camera.intrinsics.focal = lens.focal;
        camera.intrinsics.centre = lens.centre;
        camera.intrinsics.distortion = (lens.radial[0], lens.radial[1]);
        match &mut camera.mount {
            Mount::World { world_from_camera: place }
            | Mount::Flange { flange_from_camera: place, .. } => *place = self.setup.camera,
        }
        camera
    }
}

fn failed(why: &str) -> Error {
    let cause = System::NotCreated { who: "calibration".into(), why: why.into() };
    Error::System { actor: "calibration".into(), place: "create", cause }
}

/// Who moves what where.
struct Plan {
    rig: Rig,
    /// Arm with the cube, arm that moves, and its poses in their order.
    holder: usize,
    mover: usize,
    poses: Vec<JointPositions>,
    /// Where both arms are at first.
    starts: [JointPositions; 2],
    /// How the cube lies in the holder's hand.
    tool_from_cube: Pose,
    guess: Setup,
    distance: f64,
}

/// The cube is held by one layer, so that little of it is covered.
fn held(edge: f64) -> Pose {
    let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
    hold.cube_from_tool(false, edge).inverse()
}

/// Joint positions for a flange, with room to the limits; the nearest to `near`.
fn reach(
    cell: &Cell,
    arm: usize,
    world_from_flange: &Pose,
    near: &JointPositions,
) -> Option<JointPositions> {
    let arm = &cell.arms[arm];
    let base_from_flange = arm.world_from_base.inverse() * world_from_flange;
    let room = |joints: &JointPositions| {
        let motors = arm.model.motors(joints).0;
        motors.iter().zip(&arm.model.motor_limits).skip(usize::from(!arm.model.has_track)).all(
            |(m, (low, high))| {
                *m > low + MARGIN * (high - low) && *m < high - MARGIN * (high - low)
            },
        )
    };
    let apart = |joints: &JointPositions| -> f64 {
        joints.0.iter().zip(near.0).map(|(a, b)| (a - b).abs()).sum()
    };
    let solutions = arm.model.branches(&base_from_flange, near.0[0]);
    let fitting = solutions.as_slice().iter().filter(|j| room(j) && arm.model.check(j).is_ok());
    fitting.min_by(|a, b| apart(a).total_cmp(&apart(b))).copied()
}

/// Every second view is so near to where the hand brings the cube [m], and to how it is taken there [rad], each axis: an
/// arm sags otherwise elsewhere, and it is there that camera and arm must agree.
const NEAR: f64 = 0.06;
const TURNED: f64 = 0.35;

/// How the hand stands when it takes a cube: it comes along the world's x, its jaws above and below.
fn take_rotation() -> UnitQuaternion<f64> {
    let (y, z) = (Vector3::z(), Vector3::x());
    pose_from_axes(y.cross(&z), y, z, Point3::origin()).rotation
}

/// The track arm shows the cube to a camera that stands.
fn standing_plan(
    cell: &Cell,
    camera: &Camera,
    world_from_camera: &Pose,
    views: usize,
    seed: u64,
) -> Option<Plan> {
    let (holder, edge) = (0, cell.cube.edge);
    let arm = &cell.arms[holder];
    let tool_from_cube = held(edge);
    let lens = Lens::from(&camera.intrinsics);
    let (width, height) = (f64::from(camera.intrinsics.width), f64::from(camera.intrinsics.height));
    // From twice the working distance to where the cube fills a third of the picture.
    let near = 3.0 * edge * lens.focal.0 / width;
    let working = (cell.hand.world_from_cube.translation.vector
        - world_from_camera.translation.vector)
        .norm()
        .max(near);
    let mut random = Pcg64::seed_from_u64(seed ^ 0x6361_6c69);
    let mut poses: Vec<JointPositions> = Vec::new();
    let mut reference = arm.start;
    for _ in 0..TRIES * views {
        if poses.len() == views {
            break;
        }
        let pixel =
            (random.random_range(0.12..0.88) * width, random.random_range(0.15..0.85) * height);
        let distance = working * random.random_range(0.7..1.15);
        let turn = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
        let track = random.random_range(0.0..1.0);
        let Some((x, y)) = lens.unproject(pixel) else { continue };
        let sight = Vector3::new(x, y, 1.0).normalize();
        let mut centre = world_from_camera * Point3::from(sight * distance);
        let mut turned = UnitQuaternion::from_scaled_axis(turn * std::f64::consts::PI);
        if poses.len() % 2 == 1 {
            let beside = Vector3::from_fn(|_, _| random.random_range(-NEAR..NEAR));
            centre = (cell.hand.world_from_cube.translation.vector + beside).into();
            turned = UnitQuaternion::from_scaled_axis(turn * TURNED)
                * take_rotation()
                * tool_from_cube.rotation;
        }
        let sight = (centre - Point3::from(world_from_camera.translation.vector)).normalize();
        let sight = world_from_camera.rotation.inverse() * sight;
        let world_from_cube = Pose::from_parts(centre.coords.into(), turned);
        let world_from_tool = world_from_cube * tool_from_cube.inverse();
        // Not from behind the hand, and not all too frontally: two faces tell more than one.
        let towards = world_from_tool.rotation.inverse() * (world_from_camera.rotation * -sight);
        let oblique =
            (world_from_cube.rotation.inverse() * (world_from_camera.rotation * sight)).amax();
        if towards.z < -0.25 || oblique > 0.97 || centre.z < cell.table_height + 0.15 {
            continue;
        }
        let (low, high) = arm.model.joint_limits[0];
        reference.0[0] = low + 0.05 + track * (high - low - 0.1);
        let flange = world_from_tool * arm.flange_from_tool.inverse();
        poses.extend(reach(cell, holder, &flange, &reference));
    }
    let poses = in_order(poses);
    let first = *poses.first()?;
    Some(Plan {
        rig: Rig::Standing,
        holder,
        mover: holder,
        poses,
        starts: [first, cell.arms[1].start],
        tool_from_cube,
        guess: Setup { lens, camera: *world_from_camera, cube: tool_from_cube, edge },
        distance: working,
    })
}

/// The other arm holds the cube still, and the camera looks at its free face from many sides.
fn in_hand_plan(
    cell: &Cell,
    arm: usize,
    flange_from_camera: &Pose,
    meetings: &MeetingTable,
    views: usize,
    seed: u64,
) -> Option<Plan> {
    let (holder, edge) = (1 - arm, cell.cube.edge);
    let meeting = meetings.views[holder].iter().flatten().next()?;
    let starts = [meeting.track, meeting.postument];
    let world_from_flange = |arm: usize| {
        cell.arms[arm].world_from_base * cell.arms[arm].model.base_from_flange(&starts[arm])
    };
    let tool_from_cube = held(edge);
    let world_from_cube =
        world_from_flange(holder) * cell.arms[holder].flange_from_tool * tool_from_cube;
    let world_from_camera = world_from_flange(arm) * flange_from_camera;
    let camera = cell.cameras.iter().find(|c| {
        matches!(c.mount, Mount::Flange { arm: a, flange_from_camera: f } if a == arm && f == *flange_from_camera)
    })?;
    let centre = Point3::from(world_from_cube.translation.vector);
    let back = world_from_camera.translation.vector - centre.coords;
    let mut random = Pcg64::seed_from_u64(seed ^ 0x6861_6e64);
    let mut poses = vec![starts[arm]];
    for _ in 0..TRIES * views {
        if poses.len() == views {
            break;
        }
        let mut within = |size: f64| random.random_range(-size..size);
        let swing =
            UnitQuaternion::from_scaled_axis(Vector3::new(within(0.5), within(0.5), within(0.5)));
        let eye = centre + swing * back * (1.0 + within(0.18));
        // The cube stands anywhere in the picture, and the picture is rolled.
        let aim = centre + Vector3::new(within(0.03), within(0.03), within(0.03));
        let z = (aim - eye).normalize();
        let x = world_from_camera.rotation * Vector3::x();
        let x = (x - z * x.dot(&z)).normalize();
        let roll = UnitQuaternion::from_scaled_axis(z * within(0.6));
        let (x, y) = (roll * x, roll * z.cross(&x));
        let flange = pose_from_axes(x, y, z, eye) * flange_from_camera.inverse();
        poses.extend(reach(cell, arm, &flange, &starts[arm]).filter(|joints| {
            // A small motion of the hand is one of the joints, too: no other branch.
            joints.0.iter().zip(starts[arm].0).all(|(a, b)| (a - b).abs() < 1.2)
        }));
    }
    let camera_frame = cell.arms[arm].world_from_base.inverse() * world_from_cube;
    Some(Plan {
        rig: Rig::InHand,
        holder,
        mover: arm,
        poses: in_order(poses),
        starts,
        tool_from_cube,
        guess: Setup {
            lens: Lens::from(&camera.intrinsics),
            camera: *flange_from_camera,
            cube: camera_frame,
            edge,
        },
        distance: HAND_DISTANCE,
    })
}

/// Each pose next to the one before.
fn in_order(mut poses: Vec<JointPositions>) -> Vec<JointPositions> {
    for i in 1..poses.len() {
        let apart = |joints: &JointPositions| {
            let last = &poses[i - 1].0;
            joints.0.iter().zip(last).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        let nearest =
            (i..poses.len()).min_by(|a, b| apart(&poses[*a]).total_cmp(&apart(&poses[*b])));
        poses.swap(i, nearest.unwrap_or(i));
    }
    poses
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
    fn new(scenario: &Scenario, mut port: Plant) -> Result<Self, Error> {
        let config = &scenario.controller;
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
        speeds: &Speeds,
        macrostep: u32,
        jaw: Option<JawCommand>,
    ) -> Result<bool, Error> {
        let mut generator = Position::joints(to, (0.8, 0.0), speeds, macrostep);
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

fn perform(scenario: &Scenario, index: usize, plan: &Plan) -> Result<Report, Error> {
    let config = &scenario.controller;
    let cell = &config.cell;
    let plant =
        plant_side::create_holding(scenario, plan.holder, plan.tool_from_cube, &plan.starts)
            .map_err(|why| failed(&why))?;
    let (mut scenes, output) = triple_buffer::triple_buffer::<Scene>(&plant.scene());
    let renderer = plant_side::renderer(scenario, &plant, index)
        .ok_or_else(|| failed("the plant has no such camera"))?;
    let mut source = PlantCamera::new(renderer, output);
    let mut arms = Arms::new(scenario, plant)?;
    let manner = build::manner(config);
    let grip = JawCommand {
        opening: (cell.cube.edge - 0.003).max(cell.arms[plan.holder].gripper.opening.0),
        force_limit: config.control.grip,
        stops: Depth::One,
    };
    let macrostep = manner.compliance.macrostep;
    // The holder closes its jaws where it stands; then the mover begins.
    arms.period(None)?;
    let stand = arms.states[plan.holder].joints;
    arms.go(plan.holder, stand, &manner.speeds, macrostep, Some(grip))?;
    let jaw = (plan.mover == plan.holder).then_some(grip);
    let mut frames: Vec<(Pose, RgbImage)> = Vec::new();
    let mut truths: Vec<Pose> = Vec::new();
    let mut served = 0;
    for pose in &plan.poses {
        if !arms.go(plan.mover, *pose, &manner.speeds, macrostep, jaw)? {
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
        // The light is not the one for which the nominal exposure was chosen: that which served last comes first.
        let mut kept = None;
        for i in 0..EXPOSURES.len() {
            let exposure = EXPOSURES[(served + i) % EXPOSURES.len()];
            let Ok(frame) = source.grab(arms.period, exposure) else { continue };
            let serves = view(plan.rig, &plan.guess, &pose, &frame.image).is_some();
            kept = Some(frame.image);
            if serves {
                served = (served + i) % EXPOSURES.len();
                break;
            }
        }
        let Some(image) = kept else { continue };
        frames.push((pose, image));
        let seen = arms.port.scene().arms[plan.mover];
        truths.push(match plan.rig {
            Rig::Standing => seen.world_from_tool,
            Rig::InHand => seen.world_from_flange,
        });
    }
    let (found, used) = adjust(plan, &frames);
    // From here on only for the operator's information.
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
    Ok(Report {
        sag: sag.into(),
        hand,
        camera: index,
        found,
        views: (plan.poses.len(), used),
        time: arms.period as f64 * crate::motion::PERIOD,
        errors: (before, after),
    })
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

        let believed = believed(&acquire);

        let [old, new] = [&acquire, &*believed].map(|s| place(&s.controller.cell.cameras[0]));
        assert!((old.translation.vector - new.translation.vector).norm() > 1e-3);
        assert_eq!(acquire.controller.cell.cameras[1..], believed.controller.cell.cameras[1..]);
        assert!(matches!(super::believed(&idle), Cow::Borrowed(_)));
    }
}
