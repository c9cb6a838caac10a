//! The construction of a scenario from a draft: poses and models from keys, and indices from names.
//!
//! - in: a [`Draft`], each of whose keys is in its own range
//! - out: a [`Scenario`], or faults: those of [`check`], and those that only the construction shows

use super::catalogue::{Catalogue, Declaration};
use super::check;
use super::config::{
    CameraSource, ControllerConfig, EffectorConfig, Owner, PlantSection, VspConfig,
};
use super::declared::{ChosenSensor, TaskLabel, TaskSections};
use super::draft::Draft;
use super::fault::nearest;
use super::injected::FaultKeys;
use super::keys::{self, BridgeKind, HandKeys, Servo};
use super::lists::{CameraKeys, Effector, GripperKeys, MountKind, SensorKeys, Vsp, VspKind};
use super::motion;
use super::nodes;
use super::objects::ObjectLists;
use super::parameters;
use super::plant::PlantKeys;
use super::profile;
use super::section::Reader;
use super::whole::Scenario;
use crate::cell::{Arm, Camera, Cell, CubeSpec, ForceSensor, Gripper, HandZone, Intrinsics, Mount};
use crate::cube::{Cube, Facelets, Keeper};
use crate::kinematics::ArmModel;
use crate::motion::{AXES, JointPositions};
use crate::net::refuses_topic;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use std::path::Path;

/// Checks the keys in `draft` against each other and builds the scenario from them. Faults are
/// added to `reader`. Returns `None` if a fault leaves an arm, a camera or a sensor unbuilt.
///
/// Faults at the same place are printed in the order in which they are found here.
pub(super) fn scenario(
    path: &Path,
    draft: Draft,
    catalogue: &Catalogue,
    reader: &mut Reader,
) -> Option<Scenario> {
    let (folder, root) = (path.parent().unwrap_or(Path::new("")), &draft.root);
    // Each step runs even after a fault of an earlier one, so that a user sees all faults at once.
    check::bridge(root, reader);
    let arms = arms(&draft.effectors, folder, reader);
    check::effectors(&draft, reader);
    let effectors = effectors(&draft.effectors, root.bridge.kind, &root.servo, folder, reader);
    let cameras = cameras(&draft.cameras, &draft.effectors, reader);
    let vsps = vsps(&draft, catalogue, reader);
    check::owners(&draft, &vsps, reader);
    let network = nodes::network(&draft, &vsps, folder, reader);
    let cube_state = cube_state(&root.cube.state, reader);
    let task = check::task(&root.task, catalogue, reader);
    check::force_sign(&root.control, reader);
    check::periods(root, reader);
    check::faults(&draft, &arms, reader);
    check::objects(&draft, reader);
    motion::checks(root, &arms, reader);
    let (keeper, hand) = place(&root.hand, root.cell.table_height, root.cube.edge, reader);
    check::hand_force(&root.control, keeper, reader);
    let (bounds, orders) = parameters::of(&draft, &arms, keeper, reader);

    let synchronised = draft.effectors.iter().map(|e| e.start_synchronised).collect();
    // A hole in one of the lists below has its fault in `reader`, so `?` loses no message.
    let (root, sections, task) = (draft.root, draft.sections, task?);
    let mut scenario = Scenario {
        path: path.to_path_buf(),
        text: String::new(),
        seed: root.seed,
        pace: root.pace,
        real_time: root.real_time,
        bridge: root.bridge,
        devices_named: false,
        orders,
        controller: ControllerConfig {
            task: label(task.declaration()),
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
            cameras: sources(&draft.cameras, folder, reader),
            calibrate_views: draft.cameras.iter().map(|c| c.calibrate_views).collect(),
            vsps: vsps.into_iter().collect::<Option<_>>()?,
            network,
            ros: root.ros,
            control: root.control,
            bounds,
            visual_servo: root.visual_servo,
            vision: root.vision,
            sections: TaskSections::default(),
            programmes: catalogue.programmes.clone(),
            generators: catalogue.generators.clone(),
        },
        plant: plant(cube_state, synchronised, root.plant, (draft.faults, draft.objects)),
        task,
    };
    scenario.controller.sections = checked(&scenario, sections, reader);
    Some(scenario)
}

/// Makes the half of the plant: `cube_state`, which arms are `synchronised`, the keys under
/// `plant`, and the lists of faults and objects.
fn plant(
    cube_state: Option<Facelets>,
    synchronised: Vec<bool>,
    keys: PlantKeys,
    (faults, lists): (Vec<(String, FaultKeys)>, ObjectLists),
) -> PlantSection {
    PlantSection {
        cube_state,
        synchronised,
        keys,
        faults: unnamed(faults),
        objects: unnamed(lists.objects),
        probes: unnamed(lists.probes),
        leads: unnamed(lists.leads),
    }
}

/// Returns the elements of a list without their dotted names.
fn unnamed<T>(list: Vec<(String, T)>) -> Vec<T> {
    list.into_iter().map(|(_, keys)| keys).collect()
}

/// Returns name and properties of a task.
fn label(task: &dyn Declaration) -> TaskLabel {
    TaskLabel::new(task.name(), task.properties())
}

/// Has the task of a scenario check its keys against the rest, and returns the keys of all tasks.
fn checked(scenario: &Scenario, mut sections: TaskSections, reader: &mut Reader) -> TaskSections {
    let task = scenario.task.declaration();
    check::coordination(task, scenario.controller.coordination, reader);
    check::effectors_of(task, scenario.controller.cell.arms.len(), reader);
    nodes::by_hand(task, &scenario.controller.network, reader);
    if let Some(keys) = sections.get_mut(task.section()) {
        task.check(keys.as_mut(), &scenario.controller, reader);
    }
    sections
}

/// Builds the arm of each effector; `None` for an arm with a fault.
fn arms(effectors: &[Effector], folder: &Path, reader: &mut Reader) -> Vec<Option<Arm>> {
    effectors.iter().map(|keys| arm(keys, folder, reader)).collect()
}

/// Builds the settings of each effector other than its geometry: its gains, and whether its palm
/// keeps a distance from the cube. Returns `None` for an effector with a fault.
fn effectors(
    effectors: &[Effector],
    bridge: BridgeKind,
    servo: &Servo,
    folder: &Path,
    reader: &mut Reader,
) -> Vec<Option<EffectorConfig>> {
    let build = |e: &Effector| {
        let gains = profile::gains(&e.servo_profile, &e.path(), folder, reader)?;
        let mut gains = profile::adjusted(gains, servo);
        if bridge == BridgeKind::Isa {
            // The cards report the size of a current but not its direction.
            gains.axes.iter_mut().for_each(|axis| axis.trip_current = f64::INFINITY);
        }
        let inputs = e.inputs.clone();
        Some(EffectorConfig { palm_clearance: e.gripper.palm_clearance, gains, inputs })
    };
    effectors.iter().map(build).collect()
}

/// Builds the cameras; `None` for a camera with a fault.
fn cameras(
    cameras: &[CameraKeys],
    effectors: &[Effector],
    reader: &mut Reader,
) -> Vec<Option<Camera>> {
    cameras.iter().map(|keys| camera(keys, effectors, reader)).collect()
}

/// Returns for each camera where its frames come from: the renderer or a folder.
fn sources(cameras: &[CameraKeys], folder: &Path, reader: &mut Reader) -> Vec<CameraSource> {
    cameras.iter().map(|keys| source(keys, folder, reader)).collect()
}

/// Builds the virtual sensors; `None` for a sensor with a fault.
fn vsps(draft: &Draft, catalogue: &Catalogue, reader: &mut Reader) -> Vec<Option<VspConfig>> {
    // A sensor without a name is left out, since it has no dotted name for its faults;
    // `check::effectors` reports the missing name.
    let named = draft.vsps.iter().filter(|v| !v.name.is_empty());
    named.map(|v| vsp(v, draft, catalogue, reader)).collect()
}

/// Builds the arm of an effector; `None` if its profile has a fault.
fn arm(keys: &Effector, folder: &Path, reader: &mut Reader) -> Option<Arm> {
    let path = &keys.path();
    check::opening(&keys.gripper, path, reader);
    let model = profile::model(&keys.profile, path, folder, reader)?;
    let start = start(keys, &model, path, reader);
    Some(Arm {
        name: keys.name.clone(),
        model,
        world_from_base: pose(keys.base_xyz, keys.base_rpy),
        flange_from_tool: pose(keys.tool_xyz, keys.tool_rpy),
        gripper: gripper(&keys.gripper),
        sensor: sensor(&keys.sensor),
        start,
    })
}

/// Returns the joint positions of an effector at the start of the run. Adds a fault for each axis
/// that would be outside the limits of the model.
fn start(keys: &Effector, model: &ArmModel, path: &str, reader: &mut Reader) -> JointPositions {
    let mut start = [0.0; AXES];
    start[0] = keys.start_d0;
    start[1..].copy_from_slice(&keys.start_joints);
    for (axis, (value, (low, high))) in start.iter().zip(model.joint_limits).enumerate() {
        if (axis > 0 || model.has_track) && !(low..=high).contains(value) {
            // The message is in the unit of the key, which is not that of the model.
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
            reader.fault(&format!("{path}.{name}"), reason);
        }
    }
    JointPositions(start)
}

/// Builds the gripper of an effector as the controller believes it, without a zero error.
fn gripper(keys: &GripperKeys) -> Gripper {
    Gripper {
        finger_width: keys.finger_width,
        finger_thickness: keys.finger_thickness,
        finger_tip: keys.finger_tip,
        palm: keys.palm,
        palm_half_width: keys.palm_half_width,
        opening: (keys.opening_min, keys.opening_max),
        opening_of_motor: keys.opening_of_motor,
        // Only the true gripper of the plant has a zero error, drawn from the seed.
        opening_offset: 0.0,
        increments: keys.increments,
        amperes_per_newton: keys.current,
    }
}

/// Builds the force sensor in the wrist of an effector, with the load beyond it.
fn sensor(keys: &SensorKeys) -> ForceSensor {
    let (force, torque) = (keys.range, keys.torque_range);
    ForceSensor {
        flange_from_sensor: pose(keys.xyz, keys.rpy),
        weight: keys.weight,
        centre_in_flange: Point3::from(keys.centre_xyz),
        range: [force[0], force[1], force[2], torque[0], torque[1], torque[2]],
    }
}

/// Builds a camera; `None` after a fault of its pose or mount.
fn camera(keys: &CameraKeys, effectors: &[Effector], reader: &mut Reader) -> Option<Camera> {
    let path = &keys.path();
    let pose = camera_pose(keys, path, reader)?;
    Some(Camera {
        name: keys.name.clone(),
        mount: mount(keys, pose, path, effectors, reader)?,
        intrinsics: Intrinsics {
            width: keys.width,
            height: keys.height,
            focal: keys.focal.into(),
            centre: keys.centre.into(),
            distortion: keys.distortion.into(),
        },
    })
}

/// Returns the pose of a camera from its angles (`rpy_deg`) or from the point at which it looks
/// (`look_at_mm`); `None` after a fault. The pose is in the frame of the camera's mount.
fn camera_pose(keys: &CameraKeys, path: &str, reader: &mut Reader) -> Option<Pose> {
    // A given key replaces the other one, which a built-in camera of this name may have.
    let given = |key: &str| reader.is_given(&format!("{path}.{key}"));
    let (mut rpy, mut look_at) = (keys.rpy, keys.look_at);
    match (given("rpy_deg"), given("look_at_mm")) {
        (true, false) => look_at = None,
        (false, true) => rpy = None,
        _ => {}
    }
    match (rpy, look_at) {
        (Some(_), Some(_)) => {
            let reason = format!("`{path}` has both rpy_deg and look_at_mm; set only one");
            reader.fault(&format!("{path}.look_at_mm"), reason);
            None
        }
        // Without both keys the camera has the axes of its frame.
        (rpy, None) => Some(pose(keys.xyz, rpy.unwrap_or_default())),
        (None, Some(point)) => {
            let pose = looking(keys.xyz, point);
            if pose.is_none() {
                let reason = format!("`{path}`: look_at_mm must not be at, above or below xyz_mm");
                reader.fault(&format!("{path}.look_at_mm"), reason);
            }
            pose
        }
    }
}

/// Returns the mount of a camera with the given `pose`: the world, or the flange of its effector.
/// Returns `None` if that effector is missing or unknown.
fn mount(
    keys: &CameraKeys,
    pose: Pose,
    path: &str,
    effectors: &[Effector],
    reader: &mut Reader,
) -> Option<Mount> {
    match keys.mount {
        MountKind::World => Some(Mount::World { world_from_camera: pose }),
        MountKind::Flange => {
            let name = keys.effector.as_deref().unwrap_or_default();
            let Some(arm) = effectors.iter().position(|e| e.name == name) else {
                let at = format!("{path}.effector");
                let reason = match keys.effector {
                    None => format!("`{path}`: mount = \"flange\" needs the key `effector`"),
                    Some(_) => format!("`{at}`: there is no [[effector]] \"{name}\""),
                };
                reader.fault(&at, reason);
                return None;
            };
            Some(Mount::Flange { arm, flange_from_camera: pose })
        }
    }
}

/// Returns where the frames of a camera come from: the renderer, a topic of ROS 2 or a folder.
fn source(keys: &CameraKeys, folder: &Path, reader: &mut Reader) -> CameraSource {
    let text = keys.source.as_str();
    if text == "renderer" {
        return CameraSource::Renderer;
    }
    if text == "ros" {
        let topic = keys.topic.clone().unwrap_or_else(|| format!("/{}/image_raw", keys.name));
        if let Some(why) = refuses_topic(&topic) {
            let at = format!("{}.topic", keys.path());
            reader.fault(&at, format!("`{at}`: {why}"));
        }
        return CameraSource::Ros(topic);
    }
    let images = folder.join(text);
    if !images.is_dir() {
        let at = format!("{}.source", keys.path());
        let reason = format!("`{at}`: \"{text}\" is neither \"renderer\" nor \"ros\" nor a folder");
        reader.fault_with_help(&at, reason, format!("folder not found: {}", images.display()));
    }
    CameraSource::Folder(images)
}

/// Builds a virtual sensor; `None` if its owner or its camera has a fault.
fn vsp(keys: &Vsp, draft: &Draft, catalogue: &Catalogue, reader: &mut Reader) -> Option<VspConfig> {
    let path = keys.path();
    // All references are resolved before `?`, so that all faults are reported.
    let owner = owner(keys, &path, &draft.effectors, reader);
    let (kind, own) = vsp_kind(keys, &path, catalogue, reader)?;
    let camera = vsp_camera((keys, kind), &path, &draft.cameras, reader);
    Some(VspConfig {
        name: keys.name.clone(),
        kind,
        own,
        camera: camera.ok()?,
        owner: owner?,
        period: keys.period,
    })
}

/// Returns the kind of a virtual sensor, with the declaration of a user's own one; `None` for a
/// word that names no kind.
fn vsp_kind(
    keys: &Vsp,
    path: &str,
    catalogue: &Catalogue,
    reader: &mut Reader,
) -> Option<(VspKind, Option<ChosenSensor>)> {
    if let Some((_, kind)) = VspKind::WORDS.iter().find(|(word, _)| *word == keys.kind) {
        return Some((*kind, None));
    }
    let own = catalogue.sensor(&keys.kind);
    if own.is_none() {
        let mut known: Vec<&str> = VspKind::WORDS.iter().map(|(word, _)| *word).collect();
        known.extend(catalogue.sensors.iter().map(|sensor| sensor.name()));
        let at = format!("{path}.kind");
        let help = match nearest(&keys.kind, &known) {
            Some(word) => format!("did you mean \"{word}\"?"),
            None => format!("possible: {}", known.join(", ")),
        };
        let reason = format!("`{at}`: \"{}\" is not a possible value", keys.kind);
        reader.fault_with_help(&at, reason, help);
    }
    own.map(|own| (VspKind::Own, Some(own)))
}

/// Returns the receiver of a sensor's readings, which the key `owner` names: MP, or the ECP of an
/// effector.
fn owner(keys: &Vsp, path: &str, effectors: &[Effector], reader: &mut Reader) -> Option<Owner> {
    if keys.owner == "mp" {
        return Some(Owner::Mp);
    }
    let owner = effectors.iter().position(|e| e.name == keys.owner).map(Owner::Ecp);
    if owner.is_none() {
        let at = format!("{path}.owner");
        let mut known = vec!["mp"];
        known.extend(effectors.iter().map(|e| e.name.as_str()));
        let reason = format!("`{at}`: \"{}\" is neither \"mp\" nor an effector", keys.owner);
        reader.fault_with_help(&at, reason, format!("possible: {}", known.join(", ")));
    }
    owner
}

/// Mark of a fault after which a part of the scenario cannot be built.
struct Hole;

/// Returns the index of the camera that a virtual sensor of this kind names, or `None` for a sensor
/// without a camera. A camera on the wrong mount is a fault, but its index is returned, so that
/// other checks can go on.
///
/// # Errors
/// [`Hole`] if a camera is missing or unknown, or if a sensor names one that it cannot use.
fn vsp_camera(
    (keys, kind): (&Vsp, VspKind),
    path: &str,
    cameras: &[CameraKeys],
    reader: &mut Reader,
) -> Result<Option<usize>, Hole> {
    let at = format!("{path}.camera");
    let word = &keys.kind;
    let name = match (kind, keys.camera.as_deref()) {
        (VspKind::Force | VspKind::Own, None) => return Ok(None),
        (VspKind::Force | VspKind::Own, Some(_)) => {
            reader.fault(&at, format!("`{at}`: kind = \"{word}\" takes no camera"));
            return Err(Hole);
        }
        (_, None) => {
            reader.fault(path, format!("`{path}`: kind = \"{word}\" needs the key `camera`"));
            return Err(Hole);
        }
        (_, Some(name)) => name,
    };
    let index = cameras.iter().position(|c| c.name == name);
    // The stand-alone camera finds the cube, and the camera in a hand reads a face.
    let reason = match index.map(|i| cameras[i].mount) {
        None => format!("there is no [[camera]] \"{name}\""),
        Some(MountKind::Flange) if kind == VspKind::Cube => format!(
            "\"{name}\" is mounted on a flange; kind = \"cube\" needs a fixed camera, \
             mount = \"world\""
        ),
        Some(MountKind::World) if kind == VspKind::Face => format!(
            "\"{name}\" is a fixed camera; kind = \"face\" needs a hand camera, mount = \"flange\""
        ),
        Some(_) => return Ok(index),
    };
    reader.fault(&at, format!("`{at}`: {reason}"));
    index.map(Some).ok_or(Hole)
}

/// Parses the state of the cube. Returns `None` for "random", because the seed determines that
/// state, and after a fault.
fn cube_state(text: &str, reader: &mut Reader) -> Option<Facelets> {
    if text == "random" {
        return None;
    }
    // 54 letters may still be an impossible cube.
    let state = text
        .parse::<Facelets>()
        .map_err(|e| e.to_string())
        .and_then(|f| Cube::try_from(f).map(|_| f).map_err(|e| e.to_string()));
    match state {
        Ok(facelets) => Some(facelets),
        Err(reason) => {
            let advice = "\"random\", or 54 letters: U1..U9 R1..R9 F1..F9 D1..D9 L1..L9 B1..B9";
            reader.fault_with_help("cube.state", format!("`cube.state`: {reason}"), advice);
            None
        }
    }
}

/// Makes the regrasp rule of the planner agree with the grippers: if a palm presses the cube,
/// `Rule::Clearance` becomes `Rule::Strict`.
///
/// Returns the keeper of the cube (a person or the table) and the place of the hand-over.
///
/// On a table, the height of that place follows from the height of the table and the `edge` of the
/// cube (m).
fn place(hand: &HandKeys, table_height: f64, edge: f64, reader: &mut Reader) -> (Keeper, HandZone) {
    check::cube_on_table(hand, reader);
    let [x, y, z] = hand.centre_xyz;
    let half = Vector3::from(hand.half_extent_xyz);
    let (keeper, z, height) = match hand.keeper {
        keys::Keeper::Person => (Keeper::Person, z, half.z),
        // The height of the cube is known. The half extent is the error that a camera may make.
        keys::Keeper::Table => (Keeper::Table, table_height + 0.5 * edge, 0.02),
    };
    let half_extent = Vector3::new(half.x, half.y, height);
    (keeper, HandZone { world_from_cube: pose([x, y, z], hand.cube_rpy), half_extent })
}

/// Makes a pose from a position (m) and roll, pitch, yaw (rad).
fn pose(xyz: [f64; 3], rpy: [f64; 3]) -> Pose {
    Pose::from_parts(
        Translation3::from(Vector3::from(xyz)),
        UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]),
    )
}

/// Returns the pose `world_from_camera` of a camera at `from` that looks at `to` (m, in the world),
/// with an upright image. Returns `None` if `to` is at, above or below `from`.
fn looking(from: [f64; 3], to: [f64; 3]) -> Option<Pose> {
    let z = Vector3::from(to) - Vector3::from(from);
    // A horizontal x makes the image upright; y = z x x then points downwards.
    let x = z.cross(&Vector3::z());
    if x.norm() < 1e-6 {
        return None;
    }
    let (x, z) = (x.normalize(), z.normalize());
    Some(pose_from_axes(x, z.cross(&x), z, Point3::from(from)))
}

#[cfg(test)]
mod tests {
    use super::super::Override;
    use super::*;
    use crate::tasks::read;

    /// Returns the faults of a scenario with this text and overrides; empty if there are none.
    fn faults(text: &str, overrides: &[Override]) -> String {
        match read(Path::new("t.toml"), text, overrides) {
            Ok(_) => String::new(),
            Err(faults) => faults.to_string(),
        }
    }

    #[test]
    fn empty_scenario_is_the_built_in_cell() {
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
    fn isa_bridge_disables_current_trip_of_axes() {
        // Returns the currents at which the track arm's axes trip (A).
        let trips = |text: &str| {
            let scenario = read(Path::new("t.toml"), text, &[]).unwrap();
            scenario.controller.effectors[0].gains.axes.map(|axis| axis.trip_current)
        };
        let paced = "pace = \"real-time\"\n[bridge]\nkind = ";
        assert!(trips(&format!("{paced}\"isa\"\n")).iter().all(|trip| trip.is_infinite()));
        assert_eq!(trips(&format!("{paced}\"serial\"\n"))[..2], [25.0, 15.0]);
    }

    #[test]
    fn references_to_undefined_scenario_elements_are_reported() {
        let text = "[[effector]]\nname = \"track\"\nprofile = \"irp6_trak\"\n\
                    [[camera]]\nname = \"c\"\nmount = \"flange\"\neffector = \"left\"\n\
                    [[vsp]]\nname = \"v\"\ncamera = \"d\"\nowner = \"absent\"\n";

        let message = faults(text, &[]);

        assert!(
            message.contains("t.toml:3:11: `effector.track.profile`: there is no profile"),
            "{message}"
        );
        assert!(message.contains("did you mean \"irp6_track\"?"), "{message}");
        assert!(message.contains("t.toml:7:12: `camera.c.effector`"), "{message}");
        assert!(message.contains("t.toml:10:10: `vsp.v.camera`"), "{message}");
        assert!(message.contains("t.toml:11:9: `vsp.v.owner`"), "{message}");
    }

    #[test]
    fn impossible_cube_is_refused() {
        let short = Override::option("--cube", "cube.state", "UUU");
        assert!(faults("", &[short]).contains("--cube: `cube.state`: 3 letters instead of 54"));

        // One edge is flipped: each colour occurs nine times, but no cube has these pieces.
        let mut flipped: Vec<char> =
            "UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB".chars().collect();
        flipped.swap(7, 19);
        let flipped = Override::option("--cube", "cube.state", &String::from_iter(flipped));
        let message = faults("", &[flipped]);
        assert!(message.contains("--cube: `cube.state`: edge UF is flipped"), "{message}");
    }

    #[test]
    fn look_at_key_centres_point_in_upright_image() {
        let over = Override::parse("camera.standalone.look_at_mm=[1050,0,1200]").unwrap();
        let scenario = read(Path::new("t.toml"), "", &[over]).unwrap();
        let camera = &scenario.controller.cell.cameras[0];
        let Mount::World { world_from_camera } = camera.mount else { panic!("moves") };

        let point = world_from_camera.inverse() * Point3::new(1.05, 0.0, 1.2);
        let above = world_from_camera.inverse() * Point3::new(1.05, 0.0, 1.3);

        // The middle of a picture of 640 x 480 pixels; y grows downwards in it.
        let middle = (319.5, 239.5);
        let (x, y) = camera.intrinsics.project(&point);
        assert!((x - middle.0).abs() < 1e-6 && (y - middle.1).abs() < 1e-6, "{x} {y}");
        assert!(camera.intrinsics.project(&above).1 < middle.1);
    }
}
