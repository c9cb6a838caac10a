//! What no single key can say: that they agree with each other. And the way from keys to the cell.

use super::keys::{self, BridgeKind, Coordination, HandKeys, Pace, Rule, Servo, Task};
use super::lists::{CameraKeys, Effector, MountKind, Vsp, VspKind};
use super::section::Reader;
use super::{
    CameraSource, ControllerConfig, Draft, EffectorConfig, Owner, PlantSection, Scenario, VspConfig,
};
use crate::arms;
use crate::cell::{Arm, Camera, Cell, CubeSpec, ForceSensor, Gripper, HandZone, Intrinsics, Mount};
use crate::cube::{Cube, Facelets, Keeper};
use crate::hw::text;
use crate::kinematics::ArmModel;
use crate::motion::{AXES, JointPositions};
use crate::servo::period::Length;
use crate::servo::regulator::{self, ServoGains};
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use std::path::Path;

/// Checks a draft and builds the scenario; `None` after faults that leave holes.
pub(super) fn scenario(path: &Path, draft: Draft, reader: &mut Reader) -> Option<Scenario> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let root = draft.root;
    bridge(root.bridge.kind, root.pace, reader);
    if root.bridge.devices.as_ref().is_some_and(|file| file.trim().is_empty()) {
        let reason = "`bridge.devices`: the name of a file is empty".to_owned();
        let advice = "leave it out for the file that `rubik-robot emulate` writes".to_owned();
        help(reader, "bridge.devices", reason, Some(advice));
    }
    let arms: Vec<Option<Arm>> =
        draft.effectors.iter().map(|e| arm(e, &key("effector", &e.name), folder, reader)).collect();
    names("effector", draft.effectors.iter().map(|e| e.name.as_str()), reader);
    names("camera", draft.cameras.iter().map(|c| c.name.as_str()), reader);
    names("vsp", draft.vsps.iter().map(|v| v.name.as_str()), reader);
    if draft.effectors.is_empty() {
        fault(reader, "effector", "a scenario needs at least one [[effector]]".to_owned());
    } else if draft.effectors.len() > 2 {
        fault(reader, "effector.2", "at most two effectors can be driven".to_owned());
    }
    let effectors: Vec<Option<EffectorConfig>> = draft
        .effectors
        .iter()
        .map(|e| {
            let gains = gains(&e.servo_profile, &key("effector", &e.name), folder, reader)?;
            let mut gains = adjusted(gains, &root.servo);
            if root.bridge.kind == BridgeKind::Isa {
                // Cards tell how much current flows, not in which direction.
                gains.axes.iter_mut().for_each(|axis| axis.trip_current = f64::INFINITY);
            }
            Some(EffectorConfig { palm_clearance: e.gripper.palm_clearance, gains })
        })
        .collect();
    let cameras: Vec<Option<Camera>> = draft
        .cameras
        .iter()
        .map(|c| camera(c, &key("camera", &c.name), &draft.effectors, reader))
        .collect();
    let sources = draft
        .cameras
        .iter()
        .map(|c| source(&c.source, &key("camera", &c.name), folder, reader))
        .collect();
    let vsps: Vec<Option<VspConfig>> = draft
        .vsps
        .iter()
        .filter(|v| !v.name.is_empty())
        .map(|v| vsp(v, &draft.effectors, &draft.cameras, reader))
        .collect();
    if root.task != Task::Idle && draft.effectors.len() == 1 {
        let reason = format!(
            "`task`: \"{}\" needs two effectors, the one on the track first; there is one",
            root.task.word()
        );
        help(reader, "task", reason, Some("task = \"idle\" takes any number".to_owned()));
    }
    if root.task != Task::Idle
        && let [Some(first), Some(second)] = &arms[..]
        && !first.model.has_track
    {
        let reason = format!(
            "`task`: \"{}\" needs the effector on the track first; that is \"{}\", not \"{}\"",
            root.task.word(),
            second.name,
            first.name
        );
        fault(reader, &key("effector", &first.name), reason);
    }
    let sees = |kind| draft.vsps.iter().filter(|v| v.kind == kind).count();
    let at = |list: &str| if draft.vsps.is_empty() { "task".to_owned() } else { list.to_owned() };
    if matches!(root.task, Task::Solve | Task::Acquire) && sees(VspKind::Cube) == 0 {
        let reason = format!(
            "task \"{}\" needs a [[vsp]] with kind = \"cube\" and a camera that stands",
            root.task.word()
        );
        fault(reader, &at("vsp"), reason);
    }
    if root.task == Task::Solve && sees(VspKind::Face) < 2 && draft.effectors.len() > 1 {
        let reason =
            "task \"solve\" needs a [[vsp]] with kind = \"face\" for the camera in each hand";
        fault(reader, &at("vsp"), reason.to_owned());
    }
    if root.task == Task::FaceTurn && root.face_turn.angle.abs() < 1_f64.to_radians() {
        let reason = "`face_turn.angle_deg`: less than 1 deg is no turn".to_owned();
        fault(reader, "face_turn.angle_deg", reason);
    }
    if root.coordination == Coordination::Sporadic {
        // The visual servo runs in the first effector's ECP: a sensor that delivers elsewhere would leave it blind.
        for vsp in
            vsps.iter().flatten().filter(|v| v.kind == VspKind::Cube && v.owner != Owner::Ecp(0))
        {
            let at = format!("{}.owner", key("vsp", &vsp.name));
            let first = draft.effectors.first().map_or("the first effector", |e| e.name.as_str());
            let reason = format!(
                "`{at}`: under sporadic coordination {first} follows the cube, so it must be \"{first}\""
            );
            fault(reader, &at, reason);
        }
    }
    let cube_state = cube_state(&root.cube.state, reader);
    let planner = planner(root.planner, &draft.effectors, reader);
    if root.control.force_sign == 0 {
        fault(reader, "control.force_sign", "`control.force_sign`: 0 is neither 1 nor -1".into());
    }

    let length = Length::of_seconds(root.real_time.period);
    if root.bridge.kind.is_hardware() && length != Length::default() {
        let reason = format!(
            "`real_time.period_ms`: the controllers behind a bridge of kind \"{}\" go by periods of 2 ms, not of {} ms",
            root.bridge.kind.word(),
            length.seconds() * 1e3
        );
        let advice = "leave it at 2; only the simulated plant takes others".to_owned();
        help(reader, "real_time.period_ms", reason, Some(advice));
    }
    let macrostep = u64::from(root.control.macrostep_periods) * 2_000_000;
    if macrostep % length.nanos() != 0 || macrostep < 2 * length.nanos() {
        let reason = format!(
            "`real_time.period_ms`: a macrostep of {} ms does not last a whole number of periods of {} ms, two at least",
            macrostep as f64 * 1e-6,
            length.seconds() * 1e3
        );
        let other = "change control.macrostep_periods (of 2 ms) as well".to_owned();
        help(reader, "real_time.period_ms", reason, Some(other));
    }
    let mut named: Vec<&str> = Vec::new();
    for (path, keys) in &draft.faults {
        super::injected::check(keys, path, &draft.effectors, &draft.cameras, reader);
        let of = |arm: &&Arm| Some(&arm.name) == keys.arm.as_ref();
        if keys.axis == Some(0)
            && let Some(arm) = arms.iter().flatten().find(of).filter(|arm| !arm.model.has_track)
        {
            let reason = format!("`{path}.axis`: the {} has no axis 0", arm.name);
            fault(reader, &format!("{path}.axis"), reason);
        }
        if root.bridge.kind.is_hardware() {
            let reason = format!("`{path}`: nothing can be made to go wrong on hardware");
            fault(reader, path, reason);
        }
        if named.contains(&path.as_str()) {
            fault(reader, path, format!("[[fault]] has two elements of the name `{path}`"));
        }
        named.push(path);
    }
    let faults = draft.faults.iter().map(|(_, keys)| keys.clone()).collect();
    let synchronised = draft.effectors.iter().map(|e| e.start_synchronised).collect();
    let (keeper, hand) = place(&root.hand, root.cell.table_height, root.cube.edge, reader);
    let (most, touch) = (root.control.hand_force, root.control.approach_force);
    if keeper == Keeper::Person && most <= touch {
        let reason = format!(
            "`control.hand_force_n`: {most} N would break off every approach, which ends at {touch} N (`control.approach_force_n`)"
        );
        fault(reader, "control.hand_force_n", reason);
    }
    Some(Scenario {
        path: path.to_path_buf(),
        seed: root.seed,
        pace: root.pace,
        real_time: root.real_time,
        bridge: root.bridge,
        controller: ControllerConfig {
            task: root.task,
            coordination: root.coordination,
            cell: Cell {
                arms: arms.into_iter().collect::<Option<_>>()?,
                cameras: cameras.into_iter().collect::<Option<_>>()?,
                cube: CubeSpec { edge: root.cube.edge, mass: root.cube.mass },
                table_height: root.cell.table_height,
                hand,
                keeper,
            },
            effectors: effectors.into_iter().collect::<Option<_>>()?,
            cameras: sources,
            calibrate_views: draft.cameras.iter().map(|c| c.calibrate_views).collect(),
            vsps: vsps.into_iter().collect::<Option<_>>()?,
            control: root.control,
            visual_servo: root.visual_servo,
            vision: root.vision,
            planner,
            face_turn: root.face_turn,
            idle: root.idle,
        },
        plant: PlantSection { cube_state, synchronised, keys: root.plant, faults },
    })
}

/// Where the cube is handed over, and by whom.
fn place(hand: &HandKeys, table_height: f64, edge: f64, reader: &mut Reader) -> (Keeper, HandZone) {
    let [x, y, z] = hand.centre_xyz;
    let [roll, pitch, _] = hand.cube_rpy;
    // It would stand on an edge in the table top, and be said to be at rest there.
    if hand.keeper == keys::Keeper::Table && (roll, pitch) != (0.0, 0.0) {
        let (roll, pitch) = (roll.to_degrees(), pitch.to_degrees());
        let reason = format!(
            "`hand.cube_rpy_deg`: a cube on a table is turned about the vertical only: roll and pitch must be 0, not {roll:.2} and {pitch:.2} deg"
        );
        let other = "plant.table.any_face lets it lie on any of its faces".to_owned();
        help(reader, "hand.cube_rpy_deg", reason, Some(other));
    }
    let half = Vector3::from(hand.half_extent_xyz);
    let (keeper, z, height) = match hand.keeper {
        keys::Keeper::Person => (Keeper::Person, z, half.z),
        // What a camera may be mistaken by.
        keys::Keeper::Table => (Keeper::Table, table_height + 0.5 * edge, 0.02),
    };
    let half_extent = Vector3::new(half.x, half.y, height);
    (keeper, HandZone { world_from_cube: pose([x, y, z], hand.cube_rpy), half_extent })
}

fn key(list: &str, name: &str) -> String {
    format!("{list}.{name}")
}

/// A fault at the key, or at the nearest section above it that was given.
pub(super) fn fault(reader: &mut Reader, path: &str, reason: String) {
    help(reader, path, reason, None);
}

fn help(reader: &mut Reader, path: &str, reason: String, help: Option<String>) {
    let mut at = Some(path);
    let place = loop {
        match at {
            None => break None,
            Some(here) => match reader.place(here) {
                Some(place) => break Some(place),
                None => at = here.rsplit_once('.').map(|(above, _)| above),
            },
        }
    };
    match help {
        Some(help) => reader.faults.add_with_help(place.as_ref(), reason, help),
        None => reader.faults.add(place.as_ref(), reason),
    }
}

fn bridge(kind: BridgeKind, pace: Pace, reader: &mut Reader) {
    if kind.is_hardware() && pace == Pace::Virtual {
        let reason = format!("`bridge.kind`: \"{}\" is driven by the wall clock only", kind.word());
        let advice = "pace = \"real-time\", or --pace real-time".to_owned();
        help(reader, "bridge.kind", reason, Some(advice));
    }
}

fn names<'a>(list: &str, names: impl Iterator<Item = &'a str>, reader: &mut Reader) {
    let mut seen: Vec<&str> = Vec::new();
    for (index, name) in names.enumerate() {
        if name.is_empty() {
            let path = format!("{list}.{index}");
            fault(reader, &path, format!("element {index} of [[{list}]] has no name"));
        } else if name == "mp" || name.contains('.') || name.parse::<f64>().is_ok() {
            let reason = format!("\"{name}\" cannot name an element of [[{list}]]");
            fault(reader, &format!("{list}.{name}.name"), reason);
        } else if seen.contains(&name) {
            let reason = format!("[[{list}]] has two elements of the name \"{name}\"");
            fault(reader, &format!("{list}.{name}.name"), reason);
        }
        seen.push(name);
    }
}

fn arm(keys: &Effector, path: &str, folder: &Path, reader: &mut Reader) -> Option<Arm> {
    let gripper = &keys.gripper;
    if gripper.opening_min >= gripper.opening_max {
        fault(
            reader,
            &format!("{path}.gripper.opening_min_mm"),
            format!(
                "`{path}.gripper`: opening_min_mm {} is not below opening_max_mm {}",
                gripper.opening_min * 1e3,
                gripper.opening_max * 1e3
            ),
        );
    }
    let model = profile(&keys.profile, path, folder, reader)?;
    let mut start = [0.0; AXES];
    start[0] = keys.start_d0;
    start[1..].copy_from_slice(&keys.start_joints);
    for (axis, (value, (low, high))) in start.iter().zip(model.joint_limits).enumerate() {
        if (axis > 0 || model.has_track) && !(low..=high).contains(value) {
            let (name, unit, factor) = if axis == 0 {
                ("start_d0_mm", "mm", 1e3)
            } else {
                ("start_joints_deg", "deg", 1.0_f64.to_degrees())
            };
            let reason = format!(
                "`{path}.{name}`: axis {axis}: {:.2} {unit} is outside {:.2}..{:.2}",
                value * factor,
                low * factor,
                high * factor
            );
            fault(reader, &format!("{path}.{name}"), reason);
        }
    }
    let sensor = &keys.sensor;
    let (force, torque) = (sensor.range, sensor.torque_range);
    Some(Arm {
        name: keys.name.clone(),
        model,
        world_from_base: pose(keys.base_xyz, keys.base_rpy),
        flange_from_tool: pose(keys.tool_xyz, keys.tool_rpy),
        gripper: Gripper {
            finger_width: gripper.finger_width,
            finger_thickness: gripper.finger_thickness,
            finger_tip: gripper.finger_tip,
            palm: gripper.palm,
            palm_half_width: gripper.palm_half_width,
            opening: (gripper.opening_min, gripper.opening_max),
            opening_of_motor: gripper.opening_of_motor,
            opening_offset: 0.0,
            increments: gripper.increments,
            amperes_per_newton: gripper.current,
        },
        sensor: ForceSensor {
            flange_from_sensor: pose(sensor.xyz, sensor.rpy),
            weight: sensor.weight,
            centre_in_flange: Point3::from(sensor.centre_xyz),
            range: [force[0], force[1], force[2], torque[0], torque[1], torque[2]],
        },
        start: JointPositions(start),
    })
}

/// Geometry of an arm: a built-in profile by name, or a file.
fn profile(name: &str, path: &str, folder: &Path, reader: &mut Reader) -> Option<ArmModel> {
    let at = format!("{path}.profile");
    data(name, &at, folder, reader, &arms::BUILTIN, arms::builtin_text)
}

/// Regulators of an arm: a built-in profile by name, or a file.
fn gains(name: &str, path: &str, folder: &Path, reader: &mut Reader) -> Option<ServoGains> {
    let at = format!("{path}.servo_profile");
    let gains: ServoGains = data(name, &at, folder, reader, &["irp6_servo"], |name| {
        (name == "irp6_servo").then_some(regulator::IRP6)
    })?;
    // A limit that is none, or no number, would drive an axis instead of holding it back.
    let limits = gains.axes.iter().map(|axis| ("trip_current", axis.trip_current));
    for (key, value) in limits.chain([("pwm_slew", gains.pwm_slew), ("pwm_limit", gains.pwm_limit)])
    {
        if value.is_nan() || value <= 0.0 {
            fault(reader, &at, format!("`{at}`: \"{name}\": {key} is {value}, wanted more than 0"));
            return None;
        }
    }
    Some(gains)
}

fn adjusted(mut gains: ServoGains, keys: &Servo) -> ServoGains {
    for axis in &mut gains.axes {
        axis.ratio *= keys.gain_factor;
    }
    gains.jaw.position *= keys.gain_factor;
    gains.jaw.integral *= keys.gain_factor;
    gains.jaw.speed *= keys.gain_factor;
    gains.pwm_limit = keys.pwm_limit.unwrap_or(gains.pwm_limit);
    gains.following_error = keys.following_error.unwrap_or(gains.following_error);
    gains
}

/// Data that the key `at` refers to: built in by name, or a file from the scenario's folder.
fn data<T: serde::de::DeserializeOwned>(
    name: &str,
    at: &str,
    folder: &Path,
    reader: &mut Reader,
    known: &[&str],
    built_in: impl Fn(&str) -> Option<&'static str>,
) -> Option<T> {
    let file = folder.join(name);
    let (text, source) = if let Some(text) = built_in(name) {
        (text.to_owned(), name.to_owned())
    } else if Path::new(name).extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) {
        match text::read(&file, text::SCENARIO) {
            Ok(text) => (text, file.display().to_string()),
            Err(error) => {
                fault(reader, at, format!("`{at}`: {}: {error}", file.display()));
                return None;
            }
        }
    } else {
        let advice = match super::fault::nearest(name, known) {
            Some(word) => format!("did you mean \"{word}\"?"),
            None => format!("built in: {}; or the path of a .toml file", known.join(", ")),
        };
        help(reader, at, format!("`{at}`: there is no profile \"{name}\""), Some(advice));
        return None;
    };
    match toml::from_str(&text) {
        Ok(data) => Some(data),
        Err(error) => {
            let line = error.span().map_or(1, |s| text[..s.start].matches('\n').count() + 1);
            fault(reader, at, format!("`{at}`: {source}:{line}: {}", error.message()));
            None
        }
    }
}

fn camera(
    keys: &CameraKeys,
    path: &str,
    effectors: &[Effector],
    reader: &mut Reader,
) -> Option<Camera> {
    // One that was given takes the place of the other that a built-in camera of this name has.
    let given = |key: &str| reader.place(&format!("{path}.{key}")).is_some();
    let (mut rpy, mut look_at) = (keys.rpy, keys.look_at);
    match (given("rpy_deg"), given("look_at_mm")) {
        (true, false) => look_at = None,
        (false, true) => rpy = None,
        _ => {}
    }
    let pose = match (rpy, look_at) {
        (Some(_), Some(_)) => {
            let reason = format!("`{path}` has both rpy_deg and look_at_mm; give one");
            fault(reader, &format!("{path}.look_at_mm"), reason);
            return None;
        }
        (rpy, None) => pose(keys.xyz, rpy.unwrap_or_default()),
        (None, Some(point)) => {
            let Some(pose) = looking(keys.xyz, point) else {
                let reason =
                    format!("`{path}`: look_at_mm must be beside xyz_mm, not above or at it");
                fault(reader, &format!("{path}.look_at_mm"), reason);
                return None;
            };
            pose
        }
    };
    let mount = match keys.mount {
        MountKind::World => Mount::World { world_from_camera: pose },
        MountKind::Flange => {
            let name = keys.effector.as_deref().unwrap_or_default();
            let Some(arm) = effectors.iter().position(|e| e.name == name) else {
                let at = format!("{path}.effector");
                let reason = match keys.effector {
                    None => format!("`{path}`: mount = \"flange\" needs effector"),
                    Some(_) => format!("`{at}`: there is no [[effector]] \"{name}\""),
                };
                fault(reader, &at, reason);
                return None;
            };
            Mount::Flange { arm, flange_from_camera: pose }
        }
    };
    Some(Camera {
        name: keys.name.clone(),
        mount,
        intrinsics: Intrinsics {
            width: keys.width,
            height: keys.height,
            focal: keys.focal.into(),
            centre: keys.centre.into(),
            distortion: keys.distortion.into(),
        },
    })
}

fn source(text: &str, path: &str, folder: &Path, reader: &mut Reader) -> CameraSource {
    if text == "renderer" {
        return CameraSource::Renderer;
    }
    let images = folder.join(text);
    if !images.is_dir() {
        let at = format!("{path}.source");
        let reason = format!("`{at}`: \"{text}\" is neither \"renderer\" nor a folder");
        let looked = format!("looked for {}", images.display());
        help(reader, &at, reason, Some(looked));
    }
    CameraSource::Folder(images)
}

fn vsp(
    keys: &Vsp,
    effectors: &[Effector],
    cameras: &[CameraKeys],
    reader: &mut Reader,
) -> Option<VspConfig> {
    let path = key("vsp", &keys.name);
    let owner = if keys.owner == "mp" {
        Some(Owner::Mp)
    } else {
        effectors.iter().position(|e| e.name == keys.owner).map(Owner::Ecp)
    };
    if owner.is_none() {
        let at = format!("{path}.owner");
        let mut known = vec!["mp"];
        known.extend(effectors.iter().map(|e| e.name.as_str()));
        let advice = Some(format!("possible: {}", known.join(", ")));
        help(reader, &at, format!("`{at}`: nobody is called \"{}\"", keys.owner), advice);
    }
    let at = format!("{path}.camera");
    let camera = match (keys.kind, keys.camera.as_deref()) {
        (VspKind::Force, None) => Some(None),
        (VspKind::Force, Some(_)) => {
            fault(reader, &at, format!("`{at}`: kind = \"force\" has no camera"));
            None
        }
        (_, None) => {
            fault(reader, &path, format!("`{path}` needs a camera"));
            None
        }
        (_, Some(name)) => {
            let index = cameras.iter().position(|c| c.name == name);
            match index.map(|i| cameras[i].mount) {
                None => fault(reader, &at, format!("`{at}`: there is no [[camera]] \"{name}\"")),
                Some(MountKind::Flange) if keys.kind == VspKind::Cube => {
                    let reason = format!(
                        "`{at}`: \"{name}\" rides on a flange; kind = \"cube\" needs a camera that \
                         stands, mount = \"world\""
                    );
                    fault(reader, &at, reason);
                }
                Some(MountKind::World) if keys.kind == VspKind::Face => {
                    let reason = format!(
                        "`{at}`: \"{name}\" stands alone; kind = \"face\" needs a camera in a hand, \
                         mount = \"flange\""
                    );
                    fault(reader, &at, reason);
                }
                Some(_) => {}
            }
            index.map(Some)
        }
    };
    Some(VspConfig {
        name: keys.name.clone(),
        kind: keys.kind,
        camera: camera?,
        owner: owner?,
        period: keys.period,
    })
}

fn cube_state(text: &str, reader: &mut Reader) -> Option<Facelets> {
    if text == "random" {
        return None;
    }
    let state = text
        .parse::<Facelets>()
        .map_err(|e| e.to_string())
        .and_then(|f| Cube::try_from(f).map(|_| f).map_err(|e| e.to_string()));
    match state {
        Ok(facelets) => Some(facelets),
        Err(reason) => {
            let advice = "\"random\", or 54 letters: U1..U9 R1..R9 F1..F9 D1..D9 L1..L9 B1..B9";
            help(reader, "cube.state", format!("`cube.state`: {reason}"), Some(advice.to_owned()));
            None
        }
    }
}

fn planner(
    mut planner: super::Planner,
    effectors: &[Effector],
    reader: &mut Reader,
) -> super::Planner {
    let presses = effectors.iter().find(|e| !e.gripper.palm_clearance);
    if let (Rule::Clearance, Some(effector)) = (planner.rule, presses) {
        // Not chosen: follow the gripper. Chosen: the two contradict each other.
        if reader.place("planner.rule").is_some() {
            let reason = format!(
                "`planner.rule`: \"clearance\" needs palms that stand off, and \
                 effector.{}.gripper.palm_clearance is false",
                effector.name
            );
            fault(reader, "planner.rule", reason);
        }
        planner.rule = Rule::Strict;
    }
    planner
}

fn pose(xyz: [f64; 3], rpy: [f64; 3]) -> Pose {
    Pose::from_parts(
        Translation3::from(Vector3::from(xyz)),
        UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]),
    )
}

/// `world_from_camera` at `from` towards `to`, upright; `None` when straight up, down, or nowhere.
fn looking(from: [f64; 3], to: [f64; 3]) -> Option<Pose> {
    let z = Vector3::from(to) - Vector3::from(from);
    let x = z.cross(&Vector3::z());
    if x.norm() < 1e-6 {
        return None;
    }
    let (x, z) = (x.normalize(), z.normalize());
    Some(pose_from_axes(x, z.cross(&x), z, Point3::from(from)))
}

#[cfg(test)]
mod tests {
    use super::super::{Override, read};
    use super::*;

    fn faults(text: &str, overrides: &[Override]) -> String {
        match read(Path::new("t.toml"), text, overrides) {
            Ok(_) => String::new(),
            Err(faults) => faults.to_string(),
        }
    }

    #[test]
    fn a_servo_profile_whose_limits_would_drive_an_axis_is_a_fault() {
        let folder = std::env::temp_dir().join(format!("rubik-gains-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let of = |from: &str, to: &str| {
            assert!(regulator::IRP6.contains(from));
            std::fs::write(folder.join("own.toml"), regulator::IRP6.replacen(from, to, 1)).unwrap();
            let text =
                "task = \"idle\"\n[[effector]]\nname = \"track\"\nservo_profile = \"own.toml\"\n";
            match read(&folder.join("t.toml"), text, &[]) {
                Ok(_) => String::new(),
                Err(faults) => faults.to_string(),
            }
        };

        for value in ["nan", "0.0", "-10.0", "-inf"] {
            let told = of("trip_current = 18.0", &format!("trip_current = {value}"));
            assert!(told.contains("own.toml") && told.contains("trip_current is"), "{told}");
        }
        assert!(of("pwm_slew = 25.0", "pwm_slew = nan").contains("pwm_slew is NaN"));
        assert_eq!(of("trip_current = 18.0", "trip_current = inf"), "");
        let without = of("trip_current = 18.0\n", "");
        assert!(without.contains("missing field `trip_current`"), "{without}");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn the_sign_of_a_current_is_not_known_behind_cards() {
        let trips = |text: &str| {
            let scenario = read(Path::new("t.toml"), text, &[]).unwrap();
            scenario.controller.effectors[0].gains.axes.map(|axis| axis.trip_current)
        };
        let paced = "pace = \"real-time\"\n[bridge]\nkind = ";
        assert!(trips(&format!("{paced}\"isa\"\n")).iter().all(|trip| trip.is_infinite()));
        assert_eq!(trips(&format!("{paced}\"serial\"\n"))[..2], [25.0, 15.0]);
    }

    #[test]
    fn what_a_task_or_a_sensor_cannot_use_is_a_fault() {
        let one = "camera = []\nvsp = []\n[[effector]]\nname = \"track\"\n";
        assert!(faults(one, &[]).contains("\"solve\" needs two effectors"), "{}", faults(one, &[]));
        assert_eq!(faults(&format!("task = \"idle\"\n{one}"), &[]), "");

        let in_hand = faults("[[vsp]]\nname = \"mpc\"\ncamera = \"track_hand\"\n", &[]);
        assert!(in_hand.contains("rides on a flange"), "{in_hand}");
        let alone = faults("[[vsp]]\nname = \"gs1\"\ncamera = \"standalone\"\n", &[]);
        assert!(alone.contains("stands alone"), "{alone}");
        let nameless = faults("[[vsp]]\nkind = \"cube\"\n", &[]);
        assert!(nameless.contains("has no name") && !nameless.contains("`vsp.`"), "{nameless}");

        let swapped = "[[effector]]\nname = \"postument\"\n[[effector]]\nname = \"track\"\n";
        let swapped = faults(swapped, &[]);
        assert!(swapped.contains("needs the effector on the track first"), "{swapped}");
        assert!(swapped.contains("t.toml:"), "{swapped}");

        let over = Override::parse("effector.0.name=left").unwrap();
        assert!(faults("", &[over]).contains("cannot rename"));
    }

    #[test]
    fn an_empty_scenario_is_the_built_in_cell() {
        let scenario = read(Path::new("t.toml"), "", &[]).unwrap();

        let cell = &scenario.controller.cell;
        assert_eq!(
            cell.arms.iter().map(|a| a.name.as_str()).collect::<Vec<_>>(),
            ["track", "postument"]
        );
        assert_eq!(cell.cameras.len(), 3);
        assert_eq!(scenario.controller.vsps.len(), 4);
        assert!((cell.cube.edge - 0.057).abs() < 1e-15);
        assert!((cell.arms[1].world_from_base.translation.y - 2.11).abs() < 1e-12);
        assert_eq!(scenario.plant.cube_state, None);
    }

    #[test]
    fn every_fault_is_told_with_its_place() {
        let text = "taks = \"solve\"\n[cube]\nedge = 57\nmass_g = \"heavy\"\n[control]\n\
                    grip_n = 1000\ncompliance = \"tf\"\n[planner]\nrule = \"best\"\n";

        let told = faults(text, &[]);

        for wanted in [
            "t.toml:1:1: unknown key `taks`",
            "did you mean `task`?",
            "t.toml:3:1: unknown key `edge` in [cube]",
            "did you mean `edge_mm`?",
            "t.toml:4:10: `cube.mass_g`: wanted a number, found \"heavy\"",
            "t.toml:6:10: `control.grip_n`: 1000 is outside 1..100",
            "did you mean \"tff\"?",
            "t.toml:9:8: `planner.rule`: \"best\" is none of its words",
        ] {
            assert!(told.contains(wanted), "no `{wanted}` in:\n{told}");
        }
    }

    #[test]
    fn an_override_reaches_into_a_built_in_list_and_is_checked_like_the_file() {
        let good = Override::parse("effector.track.tool_xyz_mm=[0, 0, 260]").unwrap();
        let scenario = read(Path::new("t.toml"), "", &[good]).unwrap();
        let tool = scenario.controller.cell.arms[0].flange_from_tool;
        assert!((tool.translation.z - 0.26).abs() < 1e-12);
        assert_eq!(scenario.controller.cell.arms.len(), 2);

        let bad = Override::parse("effector.1.gripper.palm=10").unwrap();
        let told = faults("", &[bad]);
        assert!(told.contains("--set effector.1.gripper.palm: unknown key `palm`"), "{told}");
        assert!(told.contains("did you mean `palm_mm`?"), "{told}");
    }

    #[test]
    fn a_list_of_its_own_replaces_the_built_in_one() {
        let text = "task = \"idle\"\ncamera = []\nvsp = []\n[[effector]]\nname = \"track\"\nstart_d0_mm = 100\n";

        let scenario = read(Path::new("t.toml"), text, &[]).unwrap();

        assert_eq!(scenario.controller.cell.arms.len(), 1);
        assert!(scenario.controller.cell.arms[0].model.has_track);
        assert!(scenario.controller.vsps.is_empty());
    }

    #[test]
    fn what_hangs_on_a_missing_effector_is_left_out() {
        let text = "task = \"idle\"\n[[effector]]\nname = \"postument\"\n";

        let scenario = read(Path::new("t.toml"), text, &[]).unwrap();

        let cameras: Vec<&str> =
            scenario.controller.cell.cameras.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(cameras, ["standalone", "postument_hand"]);
        let vsps: Vec<&str> = scenario.controller.vsps.iter().map(|v| v.name.as_str()).collect();
        assert_eq!(vsps, ["gs2", "mpf"]);
    }

    #[test]
    fn references_that_lead_nowhere_are_told() {
        let text = "[[effector]]\nname = \"track\"\nprofile = \"irp6_trak\"\n\
                    [[camera]]\nname = \"c\"\nmount = \"flange\"\neffector = \"left\"\n\
                    [[vsp]]\nname = \"v\"\ncamera = \"d\"\nowner = \"nobody\"\n";

        let told = faults(text, &[]);

        assert!(
            told.contains("t.toml:3:11: `effector.track.profile`: there is no profile"),
            "{told}"
        );
        assert!(told.contains("did you mean \"irp6_track\"?"), "{told}");
        assert!(told.contains("t.toml:7:12: `camera.c.effector`"), "{told}");
        assert!(told.contains("t.toml:10:10: `vsp.v.camera`"), "{told}");
        assert!(told.contains("t.toml:11:9: `vsp.v.owner`"), "{told}");
    }

    #[test]
    fn hardware_is_refused_under_the_virtual_clock_with_the_way_out() {
        let told = faults("[bridge]\nkind = \"serial\"\n", &[]);

        assert!(
            told.contains("t.toml:2:8: `bridge.kind`: \"serial\" is driven by the wall clock only"),
            "{told}"
        );
        assert!(told.contains("--pace real-time"), "{told}");
    }

    #[test]
    fn a_file_of_devices_has_a_name() {
        let told = faults("[bridge]\ndevices = \"\"\n", &[]);
        assert!(
            told.contains("t.toml:2:11: `bridge.devices`: the name of a file is empty"),
            "{told}"
        );

        let at = |text: &str| {
            read(Path::new("cell/t.toml"), text, &[])
                .unwrap()
                .bridge
                .devices_at(Path::new("cell/t.toml"))
        };
        assert_eq!(at("[bridge]\ndevices = \"robot.toml\"\n"), Path::new("cell/robot.toml"));
        assert_eq!(at(""), crate::hw::devices::usual_place());
    }

    #[test]
    fn hardware_stops_after_fewer_missed_periods_unless_told_otherwise() {
        let limit = |text: &str| read(Path::new("t.toml"), text, &[]).unwrap().missed_limit();
        let serial = "pace = \"real-time\"\n[bridge]\nkind = \"serial\"\n";

        assert_eq!(limit(""), 50);
        assert_eq!(limit(serial), 20);
        assert_eq!(limit(&format!("{serial}[real_time]\nmissed_limit = 7\n")), 7);
    }

    #[test]
    fn a_touch_is_no_collision() {
        let text = "[control]\nhand_force_n = 3\n";
        let told = faults(text, &[]);
        assert!(told.contains("hand_force_n") && told.contains("ends at 4 N"), "{told}");
        assert_eq!(faults(&format!("{text}[hand]\nkeeper = \"table\"\n"), &[]), "");
    }

    #[test]
    fn hardware_has_periods_of_2_ms() {
        let told = |kind: &str, period: &str| {
            let text = format!(
                "pace = \"real-time\"\n[bridge]\nkind = \"{kind}\"\n[real_time]\nperiod_ms = {period}\n"
            );
            faults(&text, &[])
        };

        for kind in ["serial", "isa"] {
            let told = told(kind, "1");
            let wanted = format!(
                "t.toml:5:13: `real_time.period_ms`: the controllers behind a bridge of kind \"{kind}\""
            );
            assert!(told.contains(&wanted) && told.contains("not of 1 ms"), "{told}");
        }
        assert_eq!(told("serial", "2"), "");
        assert_eq!(told("isa", "2.0"), "");
        assert_eq!(told("plant", "1"), "");
    }

    #[test]
    fn on_a_table_a_cube_is_turned_about_the_vertical_only() {
        let told = |keeper: &str, rpy: &str| {
            let text = format!("[hand]\nkeeper = \"{keeper}\"\ncube_rpy_deg = {rpy}\n");
            faults(&text, &[])
        };

        for (rpy, found) in
            [("[10, 0, 0]", "not 10.00 and 0.00 deg"), ("[0, -90, 20]", "not 0.00 and -90.00 deg")]
        {
            let told = told("table", rpy);
            let wanted = "t.toml:3:16: `hand.cube_rpy_deg`: a cube on a table is turned about the vertical only";
            assert!(told.contains(wanted) && told.contains(found), "{told}");
        }
        assert_eq!(told("table", "[0, 0, 30]"), "");
        assert_eq!(told("person", "[10, -90, 30]"), "");
    }

    #[test]
    fn an_impossible_cube_is_refused() {
        let short = Override::option("--cube", "cube.state", "UUU");
        assert!(faults("", &[short]).contains("--cube: `cube.state`: 3 letters instead of 54"));

        // One edge flipped: nine of each colour, and yet no cube.
        let mut flipped: Vec<char> =
            "UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB".chars().collect();
        flipped.swap(7, 19);
        let flipped = Override::option("--cube", "cube.state", &String::from_iter(flipped));
        assert!(faults("", &[flipped]).contains("--cube: `cube.state`: "));
    }

    #[test]
    fn a_camera_that_looks_at_a_point_sees_it_in_its_centre_and_upright() {
        let over = Override::parse("camera.standalone.look_at_mm=[1050,0,1200]").unwrap();
        let scenario = read(Path::new("t.toml"), "", &[over]).unwrap();
        let camera = &scenario.controller.cell.cameras[0];
        let Mount::World { world_from_camera } = camera.mount else { panic!("moves") };

        let point = world_from_camera.inverse() * Point3::new(1.05, 0.0, 1.2);
        let above = world_from_camera.inverse() * Point3::new(1.05, 0.0, 1.3);

        assert!((camera.intrinsics.project(&point).0 - 319.5).abs() < 1e-6);
        assert!(camera.intrinsics.project(&above).1 < 239.5);
    }
}
