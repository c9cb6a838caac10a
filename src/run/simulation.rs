//! From a scenario's plant section to the simulated plant and its cameras.
//!
//! The only file of the actors that reads a `plant.*` key; what it makes goes behind the port and the cameras.

use super::disturbance::{Disturbance, Who};
use super::settings::{FaceTurnStart, meeting_place};
use crate::cell::Cell;
use crate::cube::Keeper;
use crate::hw::emulator::{LineFaults, Wired};
use crate::hw::plant::Identity;
use crate::hw::plant::fault::{Fault, Trigger, What, When};
use crate::hw::plant::render::{Look, Renderer, Setting};
use crate::hw::plant::truth::{self, ErrorSpreads, GraspError};
use crate::hw::plant::{
    CubeMechanics, HandScript, Jaws, Lying, Plant, PlantConfig, SensorNoise, Start, sagging,
};
use crate::hw::serial::axis::Rules;
use crate::motion::JointPositions;
use crate::operator::Class;
use crate::reach::{Meeting, MeetingTable};
use crate::record::recorder::{Entry, Recorder};
use crate::scenario::Scenario;
use crate::scenario::injected::{FaultActor, FaultEvent, FaultKeys, FaultKind};
use crate::scenario::plant::{CubeKind, Jaws as JawsKey, PlantHand, PlantKeys};
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
    // Before the faults: a run that goes on may have others.
    let identity = Identity::of(&config, scenario.seed);
    let layer = scenario.controller.cell.cube.edge / 3.0;
    for keys in &scenario.plant.faults {
        mistake(keys, layer, &mut config.cell);
    }
    config.faults = faults(scenario).0;
    if let Some(start) = face_turn {
        let edge = config.cell.cube.edge;
        let tool_from_cube = start.body.cube_from_tool(start.half_roll, edge).inverse();
        config.start = Start::Held { arm: 1, tool_from_cube };
        config.start_grip = scenario.controller.control.grip;
    }
    let plant = Plant::new(config, scenario.seed).map_err(|e| e.to_string())?;
    Ok(plant.known_as(identity))
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
    let layer = scenario.controller.cell.cube.edge / 3.0;
    for keys in &scenario.plant.faults {
        mistake(keys, layer, &mut config.cell);
    }
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

/// What the plant is made of, around the controller's belief, without any fault.
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
    let mut config = PlantConfig::new(truth::draw(belief, &errors, scenario.seed));
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
    config.noise = sensor_noise(keys);
    config.hand = hand_script(&keys.hand);
    config.facelets = *scenario.cube().colours();
    if config.cell.keeper == Keeper::Table {
        let t = &keys.table;
        config.start = Start::Table(Lying {
            offset: t.offset_xy,
            spread: t.spread,
            yaw: t.yaw,
            any_face: t.any_face,
        });
    }
    config
}

/// Returns what the operator's hand does.
fn hand_script(h: &PlantHand) -> HandScript {
    HandScript {
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
    }
}

/// Returns the errors and the noise of the force sensors.
fn sensor_noise(keys: &PlantKeys) -> SensorNoise {
    let e = &keys.errors;
    SensorNoise {
        force: keys.noise.force,
        torque: keys.noise.torque,
        force_bias: e.sensor_bias,
        torque_bias: e.sensor_torque_bias,
        force_drift: keys.noise.force_drift,
        delay_periods: keys.noise.force_delay_periods as usize,
        ..SensorNoise::default()
    }
}

/// Index of the arm or camera of a name that was checked.
fn index<'a>(mut names: impl Iterator<Item = &'a String>, wanted: Option<&String>) -> usize {
    names.position(|name| Some(name) == wanted).unwrap_or(0)
}

/// Makes the cell differ from the belief from the beginning, where a fault says so; `layer` is the
/// thickness of the cube's (m).
fn mistake(keys: &FaultKeys, layer: f64, truth: &mut Cell) {
    let which = index(truth.arms.iter().map(|a| &a.name), keys.arm.as_ref());
    let size = keys.magnitude.unwrap_or_default() * 1e-3;
    let Some(arm) = truth.arms.get_mut(which) else { return };
    match keys.kind {
        Some(FaultKind::UnderConstrained) => arm.gripper.finger_tip -= layer,
        Some(FaultKind::OverConstrained) => arm.gripper.finger_tip += layer,
        Some(FaultKind::JawCalibration) => arm.gripper.opening_offset += size,
        Some(FaultKind::BaseCalibration) => {
            arm.world_from_base.translation.vector[keys.direction.min(2) as usize] += size;
        }
        _ => {}
    }
}

/// What the plant suffers in the course of a run, and what it only tells the time of.
pub(super) fn faults(scenario: &Scenario) -> (Vec<Fault>, Vec<Disturbance>) {
    let mut others = Vec::new();
    let cell = &scenario.controller.cell;
    let faults = scenario.plant.faults.iter().filter_map(|keys| {
        let what = what(cell, keys, &mut others)?;
        let arm = keys.event_arm.as_ref();
        let event_arm = arm.map(|_| index(cell.arms.iter().map(|a| &a.name), arm));
        let when = match (keys.at, keys.event) {
            (Some(time), _) => When::At(time),
            (None, event) => When::After {
                event: match event? {
                    FaultEvent::Grasped => Trigger::Grasped(event_arm),
                    FaultEvent::Released => Trigger::Released(event_arm),
                    FaultEvent::TurnBegins => Trigger::TurnBegins,
                    FaultEvent::Turned => Trigger::Turned(keys.turned),
                    FaultEvent::Dropped => Trigger::Dropped,
                    FaultEvent::Landed => Trigger::Landed,
                    FaultEvent::Given => Trigger::Given,
                    FaultEvent::Taken => Trigger::Taken,
                },
                nth: keys.nth,
                delay: keys.delay,
            },
        };
        Some(Fault { what, when, lasts: keys.duration.unwrap_or(f64::INFINITY) })
    });
    (faults.collect(), others)
}

/// The same in words, in the same order.
fn fault_words(scenario: &Scenario) -> Vec<String> {
    let words = scenario.plant.faults.iter().filter_map(|keys| {
        what(&scenario.controller.cell, keys, &mut Vec::new())?;
        let kind = keys.kind?.word().replace('_', " ");
        Some(keys.arm.as_ref().map_or_else(|| kind.clone(), |arm| format!("{kind}, {arm}")))
    });
    words.collect()
}

/// Notes in a recording which injected faults have begun: the truth, which no part of the run sees.
pub(super) struct PlantEventLog {
    words: Vec<String>,
    told: usize,
    recorder: Recorder,
}

impl PlantEventLog {
    pub(super) fn new(scenario: &Scenario, recorder: Recorder) -> Self {
        let words = if recorder.is_on() { fault_words(scenario) } else { Vec::new() };
        Self { words, told: 0, recorder }
    }

    /// At a period of 2 ms.
    pub(super) fn look(&mut self, tick: u64, plant: Option<&Plant>) {
        let (Some(plant), false) = (plant, self.words.is_empty()) else { return };
        let begun = plant.begun_faults().count();
        if begun == std::mem::replace(&mut self.told, begun) {
            return;
        }
        for index in plant.begun_faults() {
            let word = self.words.get_mut(index).map(std::mem::take).unwrap_or_default();
            if !word.is_empty() {
                let text = format!("injected fault: {word}");
                self.recorder.note(tick, || Entry::Log(Class::Warning, "plant".to_owned(), text));
            }
        }
    }
}

/// Returns what a fault does in the plant; one beside the plant is added to `others`.
fn what(cell: &Cell, keys: &FaultKeys, others: &mut Vec<Disturbance>) -> Option<What> {
    use FaultKind as K;
    let arm = index(cell.arms.iter().map(|a| &a.name), keys.arm.as_ref());
    let camera = index(cell.cameras.iter().map(|c| &c.name), keys.camera.as_ref());
    let axis = keys.axis.unwrap_or_default() as usize;
    let direction = keys.direction as usize;
    let size = keys.magnitude.unwrap_or_default();
    let who = || match keys.actor? {
        FaultActor::Mp => Some(Who::Mp),
        FaultActor::Ecp => Some(Who::Ecp(arm)),
        FaultActor::Edp => Some(Who::Edp(arm)),
        FaultActor::Vsp => Some(Who::Vsp(camera)),
    };
    let receiver = who().unwrap_or(Who::Edp(arm));
    let other = match keys.kind? {
        K::EncoderFreeze => return Some(What::EncoderFreeze { arm, axis }),
        K::EncoderJump => return Some(What::EncoderJump { arm, axis, by: size }),
        K::OverCurrent => return Some(What::OverCurrent { arm, axis, amperes: size }),
        K::LimitSwitch => return Some(What::LimitSwitch { arm, axis }),
        K::ForceDropout => return Some(What::ForceDropout { arm }),
        K::ForceNan => return Some(What::ForceNan { arm, direction }),
        K::ForceSaturation => return Some(What::ForceSaturation { arm, direction }),
        K::ForceBias => return Some(What::ForceBias { arm, direction, by: size }),
        K::Slip => return Some(What::Slip { arm, friction: size }),
        K::Drop => return Some(What::Drop { arm }),
        K::Jam => return Some(What::Jam { torque: size }),
        K::TurnUndone => return Some(What::TurnUndone { takes: size }),
        K::Push => {
            let mut force = Vector3::zeros();
            force[direction.min(2)] = size;
            return Some(What::Push { arm, force });
        }
        K::Withdraw => return Some(What::Withdraw),
        K::UnderConstrained | K::OverConstrained | K::JawCalibration | K::BaseCalibration => {
            return None;
        }
        K::MissedPeriods => Disturbance::Missed(size as u64),
        K::ClockJump => Disturbance::ClockJump(size * 1e-3),
        K::CameraBlackout => Disturbance::Blackout(camera),
        K::CameraSilent => Disturbance::Silent(camera),
        K::LateFrames => Disturbance::Late(camera, size * 1e-3),
        K::Misread => {
            let (sticker, colour) = keys.misread()?;
            Disturbance::Misread(sticker, colour)
        }
        K::LateMessage => Disturbance::LateMessage(receiver, size * 1e-3),
        K::LostMessage => Disturbance::Lost(receiver),
        K::PowerCut => Disturbance::PowerCut,
        K::DuplicatedMessage => Disturbance::Duplicated(arm),
        K::ActorPanic => Disturbance::Panic(who()?),
        K::ActorHang => Disturbance::Hang(who()?),
        K::ActorSpin => Disturbance::Spin(who()?),
        K::HeartBeatLoss => Disturbance::HeartBeat,
        K::DiskFull => Disturbance::DiskFull,
        K::EmergencyStop => Disturbance::EmergencyStop,
    };
    others.push(other);
    Some(What::Elsewhere(others.len() - 1))
}

/// Puts a plant behind the serial protocol.
pub(super) fn wired(scenario: &Scenario, plant: Plant) -> Wired<Plant> {
    let keys = &scenario.plant.keys.lines;
    let faults = LineFaults {
        missed: keys.missed,
        corrupt: keys.corrupt,
        lost: keys.lost,
        stalled: keys.stalled,
        stall: keys.stall_periods,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario;
    use std::path::Path;

    fn identity(text: &str, more: &str) -> Identity {
        let text = format!("task = \"solve\"\nseed = 5\n{text}\n{more}\n");
        let scenario = scenario::read(Path::new("identity.toml"), &text, &[]).unwrap();
        *create(&scenario, None, None).unwrap().identity()
    }

    #[test]
    fn a_plant_is_the_same_whatever_the_controller_and_the_faults_are() {
        let plain = identity("", "");

        let fault = "[[fault]]\nkind = \"base_calibration\"\narm = \"postument\"\nmagnitude = 2\n";
        let same = [
            ("", fault),
            ("coordination = \"continuous\"", ""),
            ("pace = \"real-time\"", ""),
            ("control.grip_n = 29", ""),
            ("cube.state = \"UUFUUFUUFRRRRRRRRRFFDFFDFFDDDBDDBDDBLLLLLLLLLUBBUBBUBB\"", ""),
        ];
        for (keys, more) in same {
            assert_eq!(identity(keys, more), plain, "{keys}{more}");
        }
        let other = ["cube.edge_mm = 56", "plant.cube_kind = \"dry\"", "plant.hand.pull_n = 7"];
        for keys in other {
            assert_ne!(identity(keys, ""), plain, "{keys}");
        }
    }
}
