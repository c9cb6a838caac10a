//! From a scenario's plant section to the simulated plant and its cameras.
//!
//! The only file of the actors that reads a `plant.*` key; what it makes goes behind the port and the cameras.

use super::build::{FaceTurnStart, meeting_place};
use crate::cell::Cell;
use crate::hw::emulator::{LineFaults, Wired};
use crate::hw::plant::render::{Look, Renderer, Setting};
use crate::hw::plant::truth::{self, ErrorSpreads, GraspError};
use crate::hw::plant::{
    CubeMechanics, HandScript, Jaws, Plant, PlantConfig, SensorNoise, Start, sagging,
};
use crate::hw::serial::axis::Rules;
use crate::motion::JointPositions;
use crate::reach::{Meeting, MeetingTable};
use crate::scenario::Scenario;
use crate::scenario::plant::{CubeKind, Jaws as JawsKey};
use crate::servo::period::Length;
use crate::spatial::Pose;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// Creates the plant; a face turn starts with the cube in the postument's hand.
pub(super) fn create(
    scenario: &Scenario,
    meetings: Option<&MeetingTable>,
    face_turn: Option<&FaceTurnStart>,
) -> Result<Plant, String> {
    let mut belief = scenario.controller.cell.clone();
    let keys = &scenario.plant.keys;
    let mut grasp = GraspError::default();
    let mut met: Vec<Meeting> =
        meetings.map_or(Vec::new(), |table| table.grasps.iter().flatten().copied().collect());
    if let Some(start) = face_turn {
        place_for_face_turn(&mut belief, start);
        let arm = &belief.arms[1];
        met = vec![start.meeting];
        grasp = GraspError {
            lateral: keys.grasp_error,
            axial: keys.grasp_error,
            tilt: keys.grasp_tilt,
            world_from_tool: arm.world_from_base
                * arm.model.base_from_flange(&arm.start)
                * arm.flange_from_tool,
        };
    }
    let pivot =
        meetings.map_or(ErrorSpreads::default().pivot, |table| meeting_place(&belief, table));
    let measured = calibrated(&belief, &met, pivot);
    let mut config = config(scenario, &measured, pivot, grasp);
    if let Some(start) = face_turn {
        let edge = config.cell.cube.edge;
        let tool_from_cube = start.body.cube_from_tool(start.half_roll, edge).inverse();
        config.start = Start::Held { arm: 1, tool_from_cube };
        config.start_grip = scenario.controller.control.grip;
    }
    Plant::new(config, scenario.seed).map_err(|e| e.to_string())
}

/// Creates the plant with the cube in an arm's hand and both arms where they are to be at first.
pub(super) fn create_holding(
    scenario: &Scenario,
    arm: usize,
    tool_from_cube: Pose,
    starts: &[JointPositions],
) -> Result<Plant, String> {
    let mut belief = scenario.controller.cell.clone();
    for (arm, start) in belief.arms.iter_mut().zip(starts) {
        arm.start = *start;
    }
    let pivot = ErrorSpreads::default().pivot;
    let mut config = config(scenario, &belief, pivot, GraspError::default());
    config.start = Start::Held { arm, tool_from_cube };
    config.start_grip = scenario.controller.control.grip;
    // Nobody waits for the cube: a hand would take it where a pose shows it near the hand-over place.
    (config.hand.appears, config.hand.return_after) = (f64::INFINITY, f64::INFINITY);
    Plant::new(config, scenario.seed).map_err(|e| e.to_string())
}

/// The cell whose arms, sagging as they do, meet where a controller believes: a workshop lets the hands meet to find
/// where the bases stand to each other, and sees the sag of both then. `met` are the meetings, `pivot` their place.
fn calibrated(belief: &Cell, met: &[Meeting], pivot: Point3<f64>) -> Cell {
    let mut cell = belief.clone();
    if cell.arms.len() < 2 || met.is_empty() {
        return cell;
    }
    let dynamics = PlantConfig::new(belief.clone()).arms;
    let pivot = Translation3::from(pivot);
    let (mut moved, mut turned) = (Vector3::zeros(), Vector3::zeros());
    for meeting in met {
        // By how much the second arm's base must be elsewhere for the hands to stand to each other as believed.
        let both = [(0, meeting.track), (1, meeting.postument)].map(|(i, joints)| {
            let arm = &belief.arms[i];
            let meant =
                arm.world_from_base * arm.model.base_from_flange(&joints) * arm.flange_from_tool;
            sagging(arm, &dynamics[i], &joints) * meant.inverse()
        });
        let off = pivot.inverse() * both[0] * both[1].inverse() * pivot;
        moved += off.translation.vector;
        turned += off.rotation.scaled_axis();
    }
    let share = 1.0 / met.len() as f64;
    let off =
        Pose::from_parts((moved * share).into(), UnitQuaternion::from_scaled_axis(turned * share));
    cell.arms[1].world_from_base = pivot * off * pivot.inverse() * cell.arms[1].world_from_base;
    cell
}

/// What the plant is made of, around the controller's belief.
fn config(
    scenario: &Scenario,
    belief: &Cell,
    pivot: Point3<f64>,
    grasp: GraspError,
) -> PlantConfig {
    let keys = &scenario.plant.keys;
    let e = &keys.errors;
    let errors = ErrorSpreads {
        base: e.base,
        base_tilt: e.base_tilt,
        focal: e.focal,
        centre: e.centre,
        camera: e.camera,
        camera_tilt: e.camera_tilt,
        jaw: e.jaw,
        cube: e.cube,
        weight: e.weight,
        weight_centre: e.weight_centre,
        grasp,
        pivot,
    };
    let truth = truth::draw(belief, &errors, scenario.seed);
    let mut config = PlantConfig::new(truth);
    config.cube = match keys.cube_kind {
        CubeKind::Of2007 => CubeMechanics::of_2007(),
        CubeKind::Modern => CubeMechanics::modern(),
        CubeKind::Dry => CubeMechanics::dry(),
    };
    config.substeps = keys.substeps;
    config.period = Length::of_seconds(scenario.real_time.period);
    for (now, wanted) in config.synchronised.iter_mut().zip(&scenario.plant.synchronised) {
        *now = *wanted;
    }
    for arm in &mut config.arms {
        for (motor, trip) in arm.motors.iter_mut().zip(keys.trip_current) {
            motor.trip_current = trip;
        }
    }
    config.jaws = match keys.jaws {
        JawsKey::Rubber => Jaws::rubber(),
        JawsKey::Stiff => Jaws::stiff(),
    };
    config.noise = SensorNoise {
        force: keys.noise.force,
        torque: keys.noise.torque,
        force_bias: e.sensor_bias,
        torque_bias: e.sensor_torque_bias,
        force_drift: keys.noise.force_drift,
        delay_periods: keys.noise.force_delay_periods as usize,
        ..SensorNoise::default()
    };
    let h = &keys.hand;
    config.hand = HandScript {
        appears: h.appears,
        arrival: h.arrival,
        start_offset: h.start_xyz.into(),
        sway: h.sway,
        sway_time: h.sway_time,
        tremor: h.tremor,
        stills: h.stills,
        place_spread: h.place_spread,
        tilt_spread: h.tilt_spread,
        any_orientation: h.any_orientation,
        withdrawals: h.withdrawals,
        withdrawal: h.withdrawal,
        stiffness: h.stiffness,
        damping: h.damping,
        release_load: h.release,
        release_time: h.release_time,
        return_after: h.return_after,
        picks_up_after: h.picks_up_after,
        return_solved_only: h.return_solved_only,
        pull: h.pull,
    };
    config.facelets = *scenario.cube().colours();
    config
}

/// Puts a plant behind the serial protocol.
pub(super) fn wired(scenario: &Scenario, plant: Plant) -> Wired<Plant> {
    let keys = &scenario.plant.keys.lines;
    let faults = LineFaults {
        missed: keys.missed,
        corrupt: keys.corrupt,
        lost: keys.lost,
        ..LineFaults::default()
    };
    let rules = Rules { misses: scenario.bridge.missed_answers, ..Rules::default() };
    let arms = plant.cell().arms.iter().map(|arm| (arm.model.has_track, arm.sensor.range));
    let arms: Vec<_> = arms.collect();
    Wired::new(plant, arms, rules, faults, scenario.seed)
}

/// Both arms stand where the hands meet, the track's drawn back.
fn place_for_face_turn(belief: &mut Cell, start: &FaceTurnStart) {
    belief.arms[0].start = start.meeting.track_back;
    belief.arms[1].start = start.meeting.postument;
}

/// How the cell looks to a camera of the plant.
pub(super) fn renderer(scenario: &Scenario, plant: &Plant, camera: usize) -> Option<Renderer> {
    let truth = plant.cell();
    let keys = &scenario.plant.keys;
    let mut look = Look::draw(scenario.seed);
    look.lens_cap = keys.lens_cap;
    look.distractors = keys.light.distractors as usize;
    if let Some(temperature) = keys.light.temperature {
        look.light.temperature = temperature;
    }
    look.light.ambient *= keys.light.level as f32;
    look.light.key *= keys.light.level as f32;
    look.sensor.read_noise = keys.noise.image;
    let seed = scenario.seed.wrapping_mul(0x9e37_79b9).wrapping_add(camera as u64);
    Some(
        Renderer::new(truth.cameras.get(camera)?.clone(), look, seed)
            .with_setting(Setting::of(truth)),
    )
}
