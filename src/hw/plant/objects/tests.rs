//! Tests of the objects between tools that move by hand, without arms.

use super::super::config::Jaws;
use super::super::testing::cell;
use super::*;
use crate::cell::{Gripper, MOST_ARMS};
use crate::motion::Depth;
use crate::spatial::Pose;
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion};
use spec::{ObjectShape, Profile};

/// Length of a substep (s).
const DT: f64 = 5e-4;
/// Height of the table (m).
const TABLE: f64 = -0.5;

/// Returns a light bar along x, 57 mm wide, whose centre is at the world's origin.
fn bar() -> ObjectConfig {
    ObjectConfig {
        name: "bar".to_owned(),
        shape: ObjectShape::Box,
        size: Vector3::new(0.4, 0.057, 0.018),
        mass: 1e-4,
        friction: 0.8,
        stiffness: 2e5,
        world_from_object: Pose::identity(),
        fixed: false,
    }
}

/// Tools that a test moves, with the objects around them.
struct Bench {
    objects: Objects,
    gripper: Gripper,
    jaws: Jaws,
    frames: [Frame; 2],
    openings: [f64; 2],
    /// Number of substeps done.
    done: u32,
}

impl Bench {
    /// Makes two open tools at x = +-0.15 m around objects.
    fn new(specs: &[ObjectConfig], probe: Option<Probe>) -> Self {
        let random = |which| Pcg64::new(7, u128::from(which));
        let at = |x: f64| Frame { r: Matrix3::identity(), p: Vector3::x() * x };
        let gripper = cell().arms[0].gripper;
        Self {
            objects: Objects::new((specs, &[]), [probe, None, None, None], TABLE, random),
            gripper,
            jaws: Jaws::rubber(),
            frames: [at(-0.15), at(0.15)],
            openings: [0.09; 2],
            done: 0,
        }
    }

    /// Makes tools of which the first, or both, have closed on the first of the objects.
    fn closed(specs: &[ObjectConfig], both: bool) -> Self {
        let mut bench = Self::new(specs, None);
        // No hand carries the object until the pads close, so it gets its weight afterwards.
        let body = &mut bench.objects.bodies[0].0;
        (body.state, body.spec.mass) = (ObjectState::Resting, 1e-4);
        if !both {
            bench.frames[0].p.x = 0.0;
        }
        // 0.3 mm of strain at each pad of 1.5e5 N/m: a grip of 45 N.
        bench.openings = [0.0564, if both { 0.0564 } else { 0.09 }];
        bench.run(200);
        bench.objects.bodies[0].0.spec.mass = specs[0].mass;
        bench
    }

    /// Performs this number of substeps; four of them are a period.
    fn run(&mut self, substeps: usize) {
        for _ in 0..substeps {
            self.done += 1;
            let tools = std::array::from_fn(|i| {
                Some(Tool {
                    frame: *self.frames.get(i)?,
                    velocity: Vector3::zeros(),
                    spin: Vector3::zeros(),
                    gripper: &self.gripper,
                    jaws: &self.jaws,
                    opening: self.openings[i],
                    opens: false,
                    stops: Depth::Two,
                    friction: 1.0,
                    loses: false,
                    busy: false,
                })
            });
            self.objects.step(&tools, f64::from(self.done) * DT, DT);
            if self.done.is_multiple_of(4) {
                self.objects.end_period(&tools, 4.0 * DT);
            }
        }
    }

    /// Moves the second tool by `way` (m) and `turn` (rad) in this number of substeps.
    fn move_second(&mut self, way: Vector3<f64>, turn: Vector3<f64>, substeps: usize) {
        let from = self.frames[1];
        for step in 1..=substeps {
            let share = step as f64 / substeps as f64;
            let r = super::super::frame::rotation(&(turn * share)) * from.r;
            self.frames[1] = Frame { r, p: from.p + way * share };
            self.run(1);
        }
        self.run(8);
    }

    /// Returns the truth of the first object.
    fn truth(&self) -> ObjectTruth {
        self.objects.truth().next().unwrap()
    }
}

/// The two grips are springs in series: 1 mm gives half of a pad's stiffness times 1 mm, 30 N along
/// and across the fingers, 150 N along the jaws; 10 mrad about the bar give 0.4 Nm.
#[test]
fn two_grips_on_bar_are_springs_in_series() {
    let [kx, ky, kz] = Jaws::rubber().stiffness;
    for (axis, k, way) in [(0, kx, 1e-3), (1, ky, 1e-4), (2, kz, 1e-3)] {
        let mut bench = Bench::closed(&[bar()], true);
        let mut to = Vector3::zeros();
        to[axis] = way;
        // A bar that shears turns as well; held apart along its length it is straight.
        bench.move_second(to, Vector3::zeros(), 200);

        let [first, second] = [0, 1].map(|i| bench.objects.load(i).unwrap().force);
        assert!((first + second).norm() < 0.05, "the loads cancel: {first} {second}");
        if axis == 0 {
            assert!((first.x - 0.5 * k * way).abs() < 0.05, "{first}");
            let truth = bench.truth();
            assert!((truth.internal.pull - 0.5 * k * way).abs() < 0.05, "{truth:?}");
            assert!((truth.internal.force - 0.5 * k * way).abs() < 0.05, "{truth:?}");
        } else {
            // The pads' rotations share the strain of a shear: it is below that of the springs.
            let most = 0.5 * k * way;
            assert!(first[axis] > 0.01 * most && first[axis] < most, "{axis}: {first}");
        }
    }
    let mut bench = Bench::closed(&[bar()], true);
    bench.move_second(Vector3::zeros(), Vector3::x() * 0.01, 200);
    let torque = bench.objects.load(0).unwrap().torque.x;
    let wanted = 0.5 * Jaws::rubber().rotation[0] * 0.01;
    assert!((torque - wanted).abs() < 0.01 * wanted, "{torque} {wanted}");
}

/// Hands that move apart by 16 mm pull until friction gives way: two pads of 45 N at 0.8.
#[test]
fn hands_apart_break_bound_and_slip() {
    let mut bench = Bench::closed(&[bar()], true);
    assert_eq!(bench.truth().held_by[..2], [true, true]);

    bench.move_second(Vector3::x() * 0.016, Vector3::zeros(), 1000);

    let truth = bench.truth();
    assert!(truth.internal.most_force > 60.0, "{truth:?}");
    assert!(truth.internal.most_force < 2.0 * 0.8 * 45.0 + 0.5, "{truth:?}");
    assert!(truth.internal.p99_force <= truth.internal.most_force + 0.1, "{truth:?}");
    assert!(truth.slips > 0, "{truth:?}");
    assert_ne!(truth.held_by[..2], [true, true], "a grip that slipped by 5 mm is lost");
}

#[test]
fn weight_of_bar_is_shared_by_two_hands() {
    let mut bench = Bench::closed(&[ObjectConfig { mass: 1.0, ..bar() }], true);
    bench.run(400);

    for arm in 0..2 {
        let force = bench.objects.load(arm).unwrap().force;
        assert!((force.z + 0.5 * crate::spatial::GRAVITY).abs() < 0.1, "{arm}: {force}");
    }
    assert!(bench.truth().internal.force < 0.2, "{:?}", bench.truth());
}

#[test]
fn dropped_box_falls_and_rests_flat() {
    let turned = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.2);
    let world_from_object = Pose::from_parts(Translation3::identity(), turned);
    let size = Vector3::new(0.08, 0.057, 0.018);
    let mut bench =
        Bench::closed(&[ObjectConfig { size, mass: 0.3, world_from_object, ..bar() }], false);
    bench.run(100);
    let truth = bench.truth();
    assert_eq!(
        (truth.state, truth.held_by),
        (ObjectState::Held, [true, false, false, false]),
        "{truth:?}"
    );

    bench.openings[0] = 0.09;
    bench.run(100);
    assert_eq!(bench.truth().state, ObjectState::Falling);
    bench.run(8000);

    let truth = bench.truth();
    assert_eq!((truth.state, truth.drops), (ObjectState::Resting, 1), "{truth:?}");
    let height = truth.world_from_object.translation.z - TABLE;
    assert!((height - 0.009).abs() < 1e-4, "{height}");
    let up = truth.world_from_object.rotation * Vector3::z();
    assert!(up.z > 1.0 - 1e-6, "{up}");
}

/// A part lies beside the open hand, 30 mm from the back of a finger: nothing touches it.
#[test]
fn part_beside_open_hand_is_not_touched() {
    let mut beside = ObjectConfig { fixed: true, ..bar() };
    beside.world_from_object = Pose::translation(-0.15, 0.12, 0.0);
    let mut bench = Bench::new(&[beside], None);

    bench.run(10);

    let load = bench.objects.load(0).copied().unwrap_or(Load::NONE);
    assert!(!load.any(), "{load:?}");
}

/// A bar lies on two narrow fixed boxes, with its ends beyond them.
#[test]
fn bar_rests_on_two_supports() {
    let post = |x: f64| ObjectConfig {
        name: format!("post {x}"),
        size: Vector3::new(0.05, 0.1, 0.1),
        world_from_object: Pose::translation(x, 0.0, TABLE + 0.05),
        fixed: true,
        ..bar()
    };
    let high = Pose::translation(0.0, 0.0, TABLE + 0.1 + 0.02);
    let bar = ObjectConfig { mass: 0.5, world_from_object: high, ..bar() };
    let mut bench = Bench::new(&[bar, post(-0.12), post(0.12)], None);

    bench.run(2000);

    let truth = bench.truth();
    assert_eq!(truth.state, ObjectState::Resting);
    let height = truth.world_from_object.translation.z - TABLE;
    assert!((height - 0.109).abs() < 2e-4, "{height}");
}

/// Returns a surface with a random contour whose middle is at the table.
fn surface() -> ObjectConfig {
    ObjectConfig {
        name: "contour".to_owned(),
        shape: ObjectShape::Surface(Profile::Drawn { amplitude: 0.008, wavelength: 0.15 }),
        size: Vector3::new(0.3, 0.12, 0.1),
        world_from_object: Pose::translation(0.0, 0.0, TABLE),
        friction: 0.3,
        stiffness: 2e4,
        fixed: true,
        ..bar()
    }
}

/// A probe moves along the contour at a constant depth: the normal force is stiffness times depth,
/// and friction is that of a sliding body.
#[test]
fn probe_measures_contour_by_stiffness_and_friction() {
    let probe = Probe { centre: Point3::new(0.0, 0.0, -0.05), radius: 0.004 };
    let mut bench = Bench::new(&[surface()], Some(probe));
    let Solid::Surface(contour, _, height) = &bench.objects.bodies[0].0.solid else { panic!() };
    let (contour, height) = (contour.clone(), *height);
    for step in 0..=2000 {
        let x = -0.1 + 1e-4 * f64::from(step);
        let (rise, slope) = contour.at(x);
        let up = Vector3::new(-slope, 0.0, 1.0).normalize();
        let point = Vector3::new(x, 0.0, TABLE + height + rise);
        // 0.5 mm deep at 2e4 N/m.
        let centre = point + up * (0.004 - 5e-4);
        bench.frames[0].p = centre - probe.centre.coords;
        bench.run(4);
        let truth = bench.truth().touch;
        assert!((truth.force[0] - 10.0).abs() < 0.1, "{x}: {truth:?}");
        let load = bench.objects.load(0).unwrap().force;
        assert!((load.dot(&up) - 10.0).abs() < 0.1, "{x}: {load}");
        if step > 20 {
            assert!((truth.friction[0] - 3.0).abs() < 0.05, "{x}: {truth:?}");
        }
    }
    let truth = bench.truth().touch;
    assert!(truth.force_error(10.0) < 0.1 && (truth.force_error(8.0) - 2.0).abs() < 0.1);
    let share = truth.covered / truth.length;
    assert!((share - 0.2 / 0.3).abs() < 0.02, "{share}");
    assert_eq!(truth.contacts, 1);
}

#[test]
fn two_runs_of_one_seed_are_equal() {
    let run = || {
        let mut bench = Bench::closed(&[ObjectConfig { mass: 0.5, ..bar() }, surface()], true);
        bench.move_second(Vector3::new(1e-3, 2e-4, 0.0), Vector3::z() * 2e-3, 300);
        (bench.objects.truth().collect::<Vec<_>>(), bench.objects.load(1).unwrap().force)
    };
    assert_eq!(run(), run());
}

#[test]
fn object_in_two_hands_continues_from_saved_state() {
    let specs = [ObjectConfig { mass: 0.5, ..bar() }, surface()];
    let mut bench = Bench::closed(&specs, true);
    bench.move_second(Vector3::x() * 5e-4, Vector3::zeros(), 100);
    let (bodies, leads) = bench.objects.saved(2);
    let text = serde_json::to_string(&bodies).unwrap();
    let read: Vec<SavedObject> = serde_json::from_str(&text).unwrap();

    let mut again = Bench::new(&specs, None);
    (again.frames, again.openings) = (bench.frames, bench.openings);
    let tools = std::array::from_fn(|i| again.frames.get(i).copied());
    again.objects.restore((&read, &leads), tools).unwrap();
    again.run(8);
    bench.run(8);

    let pull = |bench: &Bench| bench.objects.load(0).unwrap().force.x;
    assert!((pull(&again) - pull(&bench)).abs() < 0.05, "{} {}", pull(&again), pull(&bench));
    assert!(pull(&again) > 10.0);
    let mut far = [Some(Frame::IDENTITY); MOST_ARMS];
    far[1] = Some(Frame { p: Vector3::x() * 9.0, ..Frame::IDENTITY });
    let refused = again.objects.restore((&read, &leads), far).unwrap_err();
    assert_eq!(refused.0, "objects[0]");
    assert!(again.objects.restore((&read[..1], &leads), tools).is_err());
}

#[test]
fn cylinder_is_gripped_at_any_angle() {
    for angle in [0.0, 0.6, 2.0] {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let pose = Pose::from_parts(Translation3::identity(), turned);
        let size = Vector3::new(0.057, 0.057, 0.018);
        let shape = ObjectShape::Cylinder;
        let can = ObjectConfig { shape, size, mass: 0.2, world_from_object: pose, ..bar() };
        let mut bench = Bench::closed(&[can], false);

        bench.run(400);

        let truth = bench.truth();
        assert_eq!(truth.held_by[..2], [true, false], "{angle}");
        let off = truth.world_from_object.rotation.angle_to(&turned);
        assert!(off < 1e-3, "{angle}: {off}");
    }
}
