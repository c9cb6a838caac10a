//! Simulated plant and its cameras, created from a scenario's plant section.
//!
//! This is the only file that reads a `plant.*` key. Its results are used behind the port and the
//! cameras only, so that no part of the controller knows them.
//!
//! - in: the scenario; the believed meetings of the arms, and the beginning that a task asks for
//! - out: the plant with its seeded errors and injected faults, its renderers, its serial lines

use super::disturbance::{Actor, Disturbance};

use crate::actors::notice::Notice;
use crate::actors::trace::Trace;
use crate::cell::Cell;
use crate::cube::Keeper;
use crate::hw::emulator::{LineFaults, Wired};
use crate::hw::plant::Identity;
use crate::hw::plant::fault::{Fault, Trigger, What, When};
use crate::hw::plant::render::{Look, Renderer, Setting};
use crate::hw::plant::truth::{self, ErrorSpreads, GraspError};
use crate::hw::plant::{
    CubeMechanics, HandScript, Jaws, LeadConfig, Lying, ObjectConfig, ObjectShape, Plant,
    PlantConfig, Probe, Profile, SensorNoise, Start, sagging,
};
use crate::hw::serial::axis::Rules;
use crate::hw::storage::StorageFault;
use crate::kernel::Input;
use crate::motion::{JointPositions, PERIOD};
use crate::operator::Class;
use crate::reach::{Meeting, MeetingTable, meeting_place};
use crate::registry::{Beginning, DeviceFault};
use crate::scenario::injected::{FaultActor, FaultEvent, FaultKeys, FaultKind};
use crate::scenario::objects::{ObjectKeys, ObjectKind};
use crate::scenario::plant::{CubeKind, Jaws as JawsKey, PlantHand, PlantKeys};
use crate::scenario::{ControllerConfig, Scenario};
use crate::servo::period::Length;
use crate::spatial::Pose;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// Creates the plant of a run with its seeded errors; the bases of the arms are tilted about the
/// mean place of `meetings`. With a `beginning` the arms begin at its meeting, and the second hand
/// holds the cube.
///
/// # Errors
/// If the plant section describes no possible plant.
pub(super) fn create(
    scenario: &Scenario,
    meetings: Option<&MeetingTable>,
    beginning: Option<&Beginning>,
) -> Result<Plant, String> {
    let mut belief = scenario.controller.cell.clone();
    let keys = &scenario.plant.keys;
    let mut grasp = GraspError::default();
    let mut met: Vec<Meeting> =
        meetings.map_or(Vec::new(), |table| table.grasps.iter().flatten().copied().collect());
    if let Some(start) = beginning {
        place_at_meeting(&mut belief, &start.meeting);
        let arm = &belief.arms[1];
        // One meeting matters: the bases are set up for it, and the hold has exactly the errors
        // that the scenario asks for.
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
    add_objects(scenario, &mut config);
    // The identity is taken before the faults are added: a resumed run may have other faults in the
    // same plant.
    let identity = Identity::of(&config, scenario.seed);
    let layer = scenario.controller.cell.cube.edge / 3.0;
    for keys in &scenario.plant.faults {
        add_cell_error(keys, layer, &mut config.cell);
    }
    config.faults = faults(scenario).0;
    // The plant starts with the grip that the controller would have ordered for this hold.
    if let Some(start) = beginning {
        config.start = Start::Held { arm: 1, tool_from_cube: start.tool_from_cube };
        config.start_grip = scenario.controller.control.grip;
    }
    let plant = Plant::new(config, scenario.seed).map_err(|e| e.to_string())?;
    Ok(plant.known_as(identity))
}

/// Creates the plant of a calibration: the hand of `arm` holds the cube, both arms are at `starts`,
/// and no person is there.
///
/// # Errors
/// If the plant section describes no possible plant.
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
    // Errors that exist from the beginning are in this plant too; faults during a run are not.
    for keys in &scenario.plant.faults {
        add_cell_error(keys, layer, &mut config.cell);
    }
    config.start = Start::Held { arm, tool_from_cube };
    config.start_grip = scenario.controller.control.grip;
    // No person is there: the person's hand would take the cube when a pose of a calibration is
    // near the place of the hand-over.
    (config.hand.appears, config.hand.return_after) = (f64::INFINITY, f64::INFINITY);
    Plant::new(config, scenario.seed).map_err(|e| e.to_string())
}

/// Returns the believed cell with the base of the second arm moved, so that the hands of the
/// sagging arms meet where the controller believes. A workshop measures the pose of one base to the
/// other by letting the hands meet, and its result includes the sag.
///
/// `met` are the meetings, `pivot` is their mean place in the world.
fn calibrated(belief: &Cell, met: &[Meeting], pivot: Point3<f64>) -> Cell {
    let mut cell = belief.clone();
    if cell.arms.len() < 2 || met.is_empty() {
        return cell;
    }
    let dynamics = PlantConfig::new(belief.clone()).arms;
    let pivot = Translation3::from(pivot);
    let (mut moved, mut turned) = (Vector3::zeros(), Vector3::zeros());
    for meeting in met {
        // The displacement of the second base after which the sagging hands have the believed pose
        // to each other: the error of the first hand times the inverse error of the second, about
        // the pivot.
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
    // One base cannot fit all meetings: it gets the mean. Errors of millimetres and milliradians
    // may be averaged as vectors.
    let share = 1.0 / met.len() as f64;
    let off =
        Pose::from_parts((moved * share).into(), UnitQuaternion::from_scaled_axis(turned * share));
    cell.arms[1].world_from_base = pivot * off * pivot.inverse() * cell.arms[1].world_from_base;
    cell
}

/// Returns the parameters of the plant without any fault: the controller's belief plus the seeded
/// errors. `pivot` is the place about which the bases are tilted, `grasp` the error of the hold at
/// the start.
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
    // The plant has a flag for each of two arms; the scenario may have only one arm.
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

/// Adds the objects of a scenario, the probes and the persons who lead a tool. A calibration has
/// none of them.
fn add_objects(scenario: &Scenario, config: &mut PlantConfig) {
    let plant = &scenario.plant;
    let which =
        |arm: &String| index(scenario.controller.cell.arms.iter().map(|a| &a.name), Some(arm));
    config.objects = plant.objects.iter().map(object).collect();
    for keys in &plant.probes {
        if let Some(probe) = config.probes.get_mut(which(&keys.arm)) {
            *probe = Some(Probe { centre: keys.xyz.into(), radius: keys.radius });
        }
    }
    let lead = plant.leads.iter().map(|keys| LeadConfig {
        arm: which(&keys.arm),
        points: keys.points.clone(),
        relative: keys.relative,
        speed: keys.speed,
        rest: keys.rest,
        stiffness: keys.stiffness,
        damping: keys.damping,
        most_force: keys.force,
        begins: keys.at,
    });
    config.leads = lead.collect();
}

/// Returns the parameters of an object.
fn object(keys: &ObjectKeys) -> ObjectConfig {
    let (amplitude, wavelength) = (keys.amplitude, keys.wavelength);
    let profile = || match &keys.points {
        Some(points) => Profile::Points(points.clone()),
        None => Profile::Drawn { amplitude, wavelength },
    };
    ObjectConfig {
        name: keys.name.clone(),
        shape: match keys.shape {
            ObjectKind::Box | ObjectKind::Bar => ObjectShape::Box,
            ObjectKind::Cylinder => ObjectShape::Cylinder,
            ObjectKind::Surface => ObjectShape::Surface(profile()),
        },
        size: keys.size.into(),
        mass: keys.mass,
        friction: keys.friction,
        stiffness: keys.stiffness,
        world_from_object: keys.pose(),
        fixed: keys.is_fixed(),
    }
}

/// Converts the keys of the operator's hand to the script by which the simulated hand behaves.
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

/// Returns the errors and the noise of the wrists' force sensors.
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

/// Returns the index of the arm or camera called `wanted`. The scenario was checked, so the name
/// exists; a fault that names none affects the first one.
fn index<'a>(mut names: impl Iterator<Item = &'a String>, wanted: Option<&String>) -> usize {
    names.position(|name| Some(name) == wanted).unwrap_or(0)
}

/// Adds to the true cell the error of a fault that exists from the beginning: too short or too long
/// fingers, or a displaced jaw or base. `layer` is the thickness of a layer of the cube (m).
fn add_cell_error(keys: &FaultKeys, layer: f64, truth: &mut Cell) {
    let which = index(truth.arms.iter().map(|a| &a.name), keys.arm.as_ref());
    // The key is in millimetres here, the cell in metres.
    let size = keys.magnitude.unwrap_or_default() * 1e-3;
    let Some(arm) = truth.arms.get_mut(which) else { return };
    match keys.kind {
        // Fingers one layer shorter hold one layer less than ordered, longer ones one more.
        Some(FaultKind::UnderConstrained) => arm.gripper.finger_tip -= layer,
        Some(FaultKind::OverConstrained) => arm.gripper.finger_tip += layer,
        Some(FaultKind::JawCalibration) => arm.gripper.opening_offset += size,
        Some(FaultKind::BaseCalibration) => {
            arm.world_from_base.translation.vector[keys.direction.min(2) as usize] += size;
        }
        // All other kinds begin during the run: see `fault_event`.
        _ => {}
    }
}

/// Returns the faults of the plant, and the disturbances outside the plant. For these the plant
/// only decides when they begin and end.
pub(super) fn faults(scenario: &Scenario) -> (Vec<Fault>, Vec<Disturbance>) {
    let mut others = Vec::new();
    let cell = &scenario.controller.cell;
    let faults = scenario.plant.faults.iter().filter_map(|keys| {
        let what = fault_event(&scenario.controller, keys, &mut others)?;
        let arm = keys.event_arm.as_ref();
        let event_arm = arm.map(|_| index(cell.arms.iter().map(|a| &a.name), arm));
        // A fault begins at a time, or some time after the n-th event of a kind.
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

/// Returns the name of each fault of [`faults`], in the same order.
fn fault_words(scenario: &Scenario) -> Vec<String> {
    let words = scenario.plant.faults.iter().filter_map(|keys| {
        fault_event(&scenario.controller, keys, &mut Vec::new())?;
        let kind = keys.kind?.word().replace('_', " ");
        let arm = keys.arm.as_ref().map_or_else(String::new, |arm| format!(", {arm}"));
        // A fault without a name has its number.
        let named = keys.name.parse::<u32>().is_err();
        let name = if named { format!(" ({})", keys.name) } else { String::new() };
        Some(format!("{kind}{arm}{name}"))
    });
    words.collect()
}

/// Notices of the injected faults that have begun, for the operator and the recording: no part of
/// the controller sees them.
pub(super) struct FaultNotices {
    /// Name of each fault, replaced by an empty text once its notice is sent.
    words: Vec<String>,
    /// Number of faults that had begun at the last look.
    reported: usize,
    trace: Trace,
}

impl FaultNotices {
    /// Makes the notices of the scenario's faults.
    pub(super) fn new(scenario: &Scenario, trace: Trace) -> Self {
        Self { words: fault_words(scenario), reported: 0, trace }
    }

    /// Sends the notices of the faults that have begun since the last call; `tick` is a period of
    /// 2 ms.
    pub(super) fn look(&mut self, tick: u64, plant: Option<&Plant>) {
        let (Some(plant), false) = (plant, self.words.is_empty()) else { return };
        let begun = plant.begun_faults().count();
        if begun == std::mem::replace(&mut self.reported, begun) {
            return;
        }
        for index in plant.begun_faults() {
            let word = self.words.get_mut(index).map(std::mem::take).unwrap_or_default();
            if !word.is_empty() {
                let (time, text) = (tick as f64 * PERIOD, format!("injected fault: {word}"));
                self.trace.tell(Notice::Elsewhere(time, Class::Warning, "plant".to_owned(), text));
            }
        }
    }
}

/// Returns the event in the plant that a fault causes; a fault outside the plant, in cameras,
/// actors or time, is added to `others`. Returns `None` for an error that exists from the
/// beginning.
fn fault_event(
    config: &ControllerConfig,
    keys: &FaultKeys,
    others: &mut Vec<Disturbance>,
) -> Option<What> {
    if keys.kind? == FaultKind::Input {
        let Input { effector, bit } = config.input(keys.input.as_deref()?)?;
        return Some(What::Input { arm: effector, bit });
    }
    if keys.kind? == FaultKind::NodeDies {
        let node = index(config.network.nodes.iter().map(|node| &node.name), keys.node.as_ref());
        others.push(Disturbance::NodeDies(node));
        return Some(What::Elsewhere(others.len() - 1));
    }
    if let Some(fault) = device_fault(keys) {
        let vsp = index(config.vsps.iter().map(|vsp| &vsp.name), keys.sensor.as_ref());
        others.push(Disturbance::Sensor(vsp, fault));
        return Some(What::Elsewhere(others.len() - 1));
    }
    event_in_cell(&config.cell, keys, others)
}

/// Returns an actor of this arm or this camera.
fn actor(kind: FaultActor, arm: usize, camera: usize) -> Actor {
    match kind {
        FaultActor::Mp => Actor::Mp,
        FaultActor::Ecp => Actor::Ecp(arm),
        FaultActor::Edp => Actor::Edp(arm),
        FaultActor::Vsp => Actor::Vsp(camera),
    }
}

/// Returns the fault of the device of a user's own sensor; `None` for a fault of another part.
fn device_fault(keys: &FaultKeys) -> Option<DeviceFault> {
    match keys.kind? {
        FaultKind::SensorSilent => Some(DeviceFault::Silent),
        FaultKind::SensorFrozen => Some(DeviceFault::Frozen),
        FaultKind::LateMeasurements => {
            Some(DeviceFault::Late(keys.magnitude.unwrap_or_default() * 1e-3))
        }
        _ => None,
    }
}

/// Returns the event of [`fault_event`] for a fault that concerns neither an input nor a user's own
/// sensor.
fn event_in_cell(cell: &Cell, keys: &FaultKeys, others: &mut Vec<Disturbance>) -> Option<What> {
    use FaultKind as K;
    let arm = index(cell.arms.iter().map(|a| &a.name), keys.arm.as_ref());
    let camera = index(cell.cameras.iter().map(|c| &c.name), keys.camera.as_ref());
    let axis = keys.axis.unwrap_or_default() as usize;
    let (direction, size) = (keys.direction as usize, keys.magnitude.unwrap_or_default());
    let force = Vector3::from_fn(|i, _| if i == direction.min(2) { size } else { 0.0 });
    let who = || Some(actor(keys.actor?, arm, camera));
    // Faults of messages affect the EDP of the arm unless the scenario names another actor.
    let receiver = who().unwrap_or(Actor::Edp(arm));
    let other = match keys.kind? {
        // Faults that the plant itself has.
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
        K::Push => return Some(What::Push { arm, force }),
        K::Withdraw => return Some(What::Withdraw),
        // Errors of the cell: see `add_cell_error`.
        K::UnderConstrained
        | K::OverConstrained
        | K::JawCalibration
        | K::BaseCalibration
        | K::NodeDies
        | K::SensorSilent
        | K::SensorFrozen
        | K::LateMeasurements
        | K::Input => return None,
        // Disturbances of the servo's time, the cameras and the messages.
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
        // Disturbances of one actor, or of what all of them share.
        K::ActorPanic => Disturbance::Panic(who()?),
        K::ActorHang => Disturbance::Hang(who()?),
        K::ActorSpin => Disturbance::Spin(who()?),
        K::HeartBeatLoss => Disturbance::HeartBeat,
        // Disturbances of the storage of a file.
        K::DiskFull => Disturbance::Storage(keys.file, StorageFault::Full),
        K::DiskError => Disturbance::Storage(keys.file, StorageFault::Broken),
        K::TornWrite => Disturbance::Storage(keys.file, StorageFault::Torn),
        K::LostWrite => Disturbance::Storage(keys.file, StorageFault::Lost),
        K::EmergencyStop => Disturbance::EmergencyStop,
    };
    // The plant decides when the disturbance begins and ends, as for its own faults, and then
    // reports its index.
    others.push(other);
    Some(What::Elsewhere(others.len() - 1))
}

/// Connects the controller to a plant by the serial protocol, with the line faults of the scenario.
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

/// Moves both arms of the believed cell to a meeting: the second one there, the first one retracted
/// from it.
fn place_at_meeting(belief: &mut Cell, meeting: &Meeting) {
    belief.arms[0].start = meeting.track_back;
    belief.arms[1].start = meeting.postument;
}

/// Returns the renderer of a camera of the plant; `None` if the plant has no camera with
/// this index.
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
    // Each camera has its own noise.
    let seed = scenario.seed.wrapping_mul(0x9e37_79b9).wrapping_add(camera as u64);
    Some(
        Renderer::new(truth.cameras.get(camera)?.clone(), look, seed)
            .with_setting(Setting::of(truth)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::path::Path;

    /// Returns the identity of a plant whose scenario has the keys `text` and the tables `more`.
    fn identity(text: &str, more: &str) -> Identity {
        let text = format!("task = \"solve\"\nseed = 5\n{text}\n{more}\n");
        let scenario = crate::tasks::read(Path::new("identity.toml"), &text, &[]).unwrap();
        *create(&scenario, None, None).unwrap().identity()
    }

    /// A resumed run may change the controller and the faults, but not the plant.
    #[test]
    fn plant_identity_ignores_controller_settings_and_injected_faults() {
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
