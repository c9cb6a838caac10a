//! The arms as capsules, and the distances between them.
//!
//! The capsules of the gripper contain what its parts sweep when the wrist rolls, so one distance
//! is valid for every roll. Where both hands are at one cube, the pairs that touch by design are
//! left out: fingers with fingers, palms with the cube, palm with palm. Distances above [`FAR`]
//! count as equal.

use crate::cell::{Arm, Cell, Gripper, HandZone};
use crate::motion::JointPositions;
use nalgebra::{Point3, UnitQuaternion, Vector3};

/// Capsule: all points within a radius of a segment.
#[derive(Debug, Clone, Copy)]
struct Capsule {
    /// Ends of the segment (m).
    ends: [Point3<f64>; 2],
    /// Radius (m).
    radius: f64,
    /// Centre of the segment (m).
    middle: Point3<f64>,
    /// Radius of the sphere about the centre that contains the capsule (m).
    reach: f64,
}

impl Capsule {
    /// Makes the capsule about the segment between `ends` (m).
    fn new(ends: [Point3<f64>; 2], radius: f64) -> Self {
        let reach = 0.5 * (ends[1] - ends[0]).norm() + radius;
        Self { ends, radius, middle: nalgebra::center(&ends[0], &ends[1]), reach }
    }

    /// Returns the capsule displaced by a vector (m).
    fn moved(&self, by: Vector3<f64>) -> Self {
        Self { ends: self.ends.map(|p| p + by), middle: self.middle + by, ..*self }
    }

    /// Returns the height of the lowest point above the floor (m). The body counts as a cylinder
    /// with flat ends, since no part of an arm ends in a ball.
    fn lowest(&self) -> f64 {
        let along = (self.ends[1] - self.ends[0]).try_normalize(1e-9).map_or(0.0, |axis| axis.z);
        let low = self.ends[0].z.min(self.ends[1].z);
        // A flat end reaches down by the radius times the sine of the axis's angle to the vertical.
        low - self.radius * (1.0 - along * along).max(0.0).sqrt()
    }
}

/// Radii of column, lower arm, upper arm, wrist (m). They are assumed, since no drawing of the arm
/// is public.
const LINK_RADII: [f64; 4] = [0.12, 0.09, 0.08, 0.07];
/// Radius that the gripper's body sweeps (m), with the camera that is 0.055 m off its axis.
const GRIPPER_RADIUS: f64 = 0.075;
/// Half the thickness of the palm plate (m).
const PLATE: f64 = 0.006;
/// Least gap between the two grippers' parts in nominal grasps (m): corrections of a grasp are
/// smaller.
const FINGER_GAP: f64 = 0.003;
/// Distance from a cube's centre down to the height that counts as its lowest (m). It is less than
/// half of the edge, so that a cube may be laid on a table.
const CUBE_HALF_HEIGHT: f64 = 0.015;
/// Radius that the closed fingers sweep (m).
const FINGERS_RADIUS: f64 = 0.040;

/// Bodies of one arm at given joint positions, in the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bodies {
    /// Column, lower arm, upper arm, wrist, gripper.
    links: [Capsule; 5],
    /// Disc that the palm plate's corners sweep when the wrist rolls, as four diagonals.
    plate: [Capsule; 4],
    /// Both fingers, closed, with what they sweep when the wrist rolls.
    fingers: Capsule,
    /// The cube between the fingers, as a sphere about its centre.
    cube: Capsule,
}

impl Bodies {
    /// Returns the bodies of an arm at these joint positions, in the world.
    pub(super) fn of(cell: &Cell, arm: &Arm, joints: &JointPositions) -> Self {
        let points = arm.model.points(joints).map(|p| arm.world_from_base * p);
        let world_from_tool =
            arm.world_from_base * arm.model.base_from_flange(joints) * arm.flange_from_tool;
        let on_axis = |z: f64| world_from_tool * Point3::new(0.0, 0.0, z);
        let link = |i: usize| Capsule::new([points[i], points[i + 1]], LINK_RADII[i]);
        let palm = -arm.gripper.palm;
        let gripper = Capsule::new([points[4], on_axis(palm - GRIPPER_RADIUS)], GRIPPER_RADIUS);
        // A capsule ends in balls, so its segment is shorter at each end by its radius.
        let half = arm.gripper.palm_half_width * std::f64::consts::SQRT_2 - PLATE;
        // Four diagonals, 45 deg apart, approximate the disc that the corners sweep.
        let plate = [(1.0, 0.0), (0.0, 1.0), (0.707, 0.707), (0.707, -0.707)].map(|(x, y)| {
            let at = |s: f64| world_from_tool * Point3::new(s * x, s * y, palm - PLATE);
            Capsule::new([at(half), at(-half)], PLATE)
        });
        let centre = on_axis(cell.cube.edge / 3.0);
        Self {
            links: [link(0), link(1), link(2), link(3), gripper],
            plate,
            fingers: Capsule::new([on_axis(palm), on_axis(arm.gripper.finger_tip)], FINGERS_RADIUS),
            // A sphere through the cube's corners needs no orientation.
            cube: Capsule::new([centre; 2], 0.5 * 3f64.sqrt() * cell.cube.edge),
        }
    }

    /// Returns the bodies moved by a vector of the world (m), as by an arm's track.
    pub(super) fn moved(&self, by: Vector3<f64>) -> Self {
        Self {
            links: self.links.map(|c| c.moved(by)),
            plate: self.plate.map(|c| c.moved(by)),
            fingers: self.fingers.moved(by),
            cube: self.cube.moved(by),
        }
    }

    /// Returns the longest distance by which an end of any body has moved since `before` (m). In a
    /// straight motion no point of a body moves farther.
    pub(super) fn moved_since(&self, before: &Self) -> f64 {
        let ends = |at: &Self| {
            let links = at.links.into_iter().chain(at.plate);
            links.chain([at.fingers, at.cube]).flat_map(|c| c.ends).collect::<Vec<_>>()
        };
        let moves = ends(self).into_iter().zip(ends(before)).map(|(now, then)| (now - then).norm());
        moves.fold(0.0, f64::max)
    }

    /// Returns points on wrist, gripper, fingers and cube, each with the radius of its body (m).
    pub(super) fn hand(&self) -> [(Point3<f64>, f64); 7] {
        let [.., wrist, gripper] = &self.links;
        let ends = |c: &Capsule| c.ends.map(|end| (end, c.radius));
        let ([a, b], [c, d], [e, f]) = (ends(wrist), ends(gripper), ends(&self.fingers));
        [a, b, c, d, e, f, (self.cube.middle, self.cube.radius)]
    }

    /// Returns points along the axis of the forearm (called upper arm in an IRp-6), from the elbow
    /// to the wrist, each with the forearm's radius (m).
    pub(super) fn forearm(&self) -> [(Point3<f64>, f64); 6] {
        let forearm = &self.links[2];
        let [elbow, wrist] = forearm.ends;
        std::array::from_fn(|i| (elbow + (wrist - elbow) * (i as f64 / 5.0), forearm.radius))
    }

    /// Returns the lowest height above the floor of the axes of wrist and gripper, and of the
    /// cube's centre (m).
    pub(super) fn lowest_axis(&self) -> f64 {
        let ends = self.links[3..].iter().flat_map(|c| c.ends).chain(self.cube.ends);
        ends.map(|p| p.z).fold(f64::INFINITY, f64::min)
    }

    /// Returns the height above the floor (m) of the lowest point of upper arm, wrist, gripper,
    /// palm, fingers and cube. The cube counts with [`CUBE_HALF_HEIGHT`] below its centre, since it
    /// may be laid on a table.
    pub(super) fn lowest(&self) -> f64 {
        // Column and lower arm do not count: they are the part that rises from the floor.
        let parts = self.links[2..].iter().chain(&self.plate).chain([&self.fingers]);
        let lowest = parts.map(Capsule::lowest).fold(f64::INFINITY, f64::min);
        self.cube.ends.iter().map(|end| end.z - CUBE_HALF_HEIGHT).fold(lowest, f64::min)
    }

    /// Returns the distance of the arm from the zone (m): of all its parts if `whole`, else of
    /// column, lower arm and upper arm alone. At most [`FAR`]; negative if a part reaches in.
    pub(super) fn distance_to_zone(&self, zone: &HandZone, whole: bool) -> f64 {
        let zone_from_world = zone.world_from_cube.inverse();
        let parts = if whole { &self.links[..] } else { &self.links[..3] };
        let hand = [self.fingers, self.cube];
        let hand = self.plate.iter().chain(&hand).take(if whole { usize::MAX } else { 0 });
        parts.iter().chain(hand).fold(FAR, |nearest, part| {
            let far = zone.distance(&(zone_from_world * part.middle));
            // If the sphere about a part is farther than the nearest part so far, its segment need
            // not be measured.
            if far - part.reach >= nearest {
                return nearest;
            }
            let [a, b] = part.ends.map(|end| zone_from_world * end);
            nearest.min(zone.distance_to_segment(&a, &b) - part.radius)
        })
    }

    /// Returns the distance of gripper and cube from the arm's own links (m), at most [`FAR`].
    pub(super) fn own(&self) -> f64 {
        let mut nearest = Nearest::default();
        // The gripper is joined to the wrist, so the distance between these two is left out.
        nearest.of(&[self.links[4], self.cube], &self.links[..3]);
        nearest.of(&[self.cube], &self.links[3..4]);
        nearest.0
    }
}

/// Returns whether two grippers can hold one cube, each over one layer, without a collision of
/// their fingers and palms. `rotation` is the second hand's tool in the first one's tool frame, one
/// of the 24 rotations of a cube.
///
/// Hands with palms on one face collide. Hands with palms on adjacent faces collide if each has a
/// finger under the other's palm, since these two fingers cross outside the edge between the palms.
pub(super) fn hands_fit(cell: &Cell, rotation: &UnitQuaternion<f64>) -> bool {
    let half = 0.5 * cell.cube.edge;
    let parts = |gripper: &Gripper| {
        // Coordinates along the tool's axes, from the cube's centre, which is a third of the edge
        // beyond the tool point.
        let near = -cell.cube.edge / 3.0;
        let (x, tip, palm) =
            (0.5 * gripper.finger_width, near + gripper.finger_tip, near - gripper.palm);
        let out = half + gripper.finger_thickness;
        let wide = gripper.palm_half_width;
        // Both fingers, then the palm's plate, as boxes along the tool's axes.
        [
            (Vector3::new(-x, half, palm), Vector3::new(x, out, tip)),
            (Vector3::new(-x, -out, palm), Vector3::new(x, -half, tip)),
            (Vector3::new(-wide, -wide, palm - 2.0 * PLATE), Vector3::new(wide, wide, palm)),
        ]
    };
    let (first, second) = (parts(&cell.arms[0].gripper), parts(&cell.arms[1].gripper));
    first.iter().all(|a| {
        second.iter().all(|b| {
            // A box along the axes, turned by one of the 24 rotations, is still along the axes.
            let corners = (rotation * b.0, rotation * b.1);
            let (low, high) = (corners.0.inf(&corners.1), corners.0.sup(&corners.1));
            // Boxes are apart if they are apart along one axis.
            (0..3).any(|i| (low[i] - a.1[i]).max(a.0[i] - high[i]) > FINGER_GAP)
        })
    })
}

/// Returns the least distance between two arms whose hands are at one cube (m), at most [`FAR`].
/// Fingers are left out, and so is the cube against grippers and palms.
pub(super) fn at_the_cube(a: &Bodies, b: &Bodies) -> f64 {
    let mut nearest = Nearest::default();
    nearest.arms(a, b);
    nearest.of(&[a.cube], &b.links[..4]);
    nearest.of(&[b.cube], &a.links[..4]);
    nearest.0
}

/// Returns the least distance between parts that [`at_the_cube`] leaves out (m), at most [`FAR`]:
/// from the fingers of each hand, and from its cube if it may `hold` one, to the other hand's
/// fingers and cube and to the other arm.
pub(super) fn hands(a: &Bodies, b: &Bodies, hold: [bool; 2]) -> f64 {
    let mut nearest = Nearest::default();
    let parts = |body: &Bodies, holds: bool| {
        // A hand that holds nothing has its fingers only.
        [body.fingers, if holds { body.cube } else { body.fingers }]
    };
    let (of_a, of_b) = (parts(a, hold[0]), parts(b, hold[1]));
    nearest.of(&of_a, &of_b);
    for (one, other) in [(&of_a, b), (&of_b, a)] {
        nearest.of(one, &other.links[4..]);
        nearest.of(one, &other.plate);
        // The cube against the other arm's links is in `at_the_cube` already.
        nearest.of(&one[..1], &other.links[..4]);
    }
    nearest.0
}

/// Returns the least distance between the arm `holder`, whose hand has the cube, and the arm
/// `other`, whose hand is empty and not at the cube (m), at most [`FAR`].
pub(super) fn apart(holder: &Bodies, other: &Bodies) -> f64 {
    let mut nearest = Nearest::default();
    nearest.arms(holder, other);
    nearest.of(&[holder.cube], &other.links);
    nearest.of(&[holder.cube, holder.fingers], &other.plate);
    nearest.of(&[other.fingers], &holder.links);
    nearest.of(&[other.fingers], &holder.plate);
    nearest.of(&[other.fingers], &[holder.cube]);
    nearest.of(&[holder.fingers], &other.links);
    nearest.0
}

/// Returns the distance that [`apart`] measures if the hand of `newcomer` (0 track, 1 postument) is
/// the empty one, and the other hand holds the cube (m).
pub(super) fn newcomer_apart(newcomer: usize, track: &Bodies, postument: &Bodies) -> f64 {
    match newcomer {
        0 => apart(postument, track),
        _ => apart(track, postument),
    }
}

/// Largest distance that is computed (m). Larger ones count as equal to it, which saves most of the
/// work.
const FAR: f64 = 0.10;

/// The least distance of the pairs of bodies that were compared, at most [`FAR`] (m).
struct Nearest(f64);

impl Default for Nearest {
    fn default() -> Self {
        Self(FAR)
    }
}

impl Nearest {
    /// Lowers the least distance to that between links and palm plates of two arms, if it is
    /// smaller.
    fn arms(&mut self, a: &Bodies, b: &Bodies) {
        self.of(&a.links, &b.links);
        self.of(&a.plate, &b.links);
        self.of(&b.plate, &a.links);
    }

    /// Lowers the least distance to that between any body of `a` and any of `b`, if it is smaller.
    fn of(&mut self, a: &[Capsule], b: &[Capsule]) {
        for x in a {
            for y in b {
                // The spheres about two bodies show that most pairs are farther apart than the
                // nearest one so far.
                let far = self.0 + x.reach + y.reach;
                if (x.middle - y.middle).norm_squared() < far * far {
                    self.0 = self.0.min(between(x, y));
                }
            }
        }
    }
}

/// Returns the distance between two capsules, negative where they overlap (m).
fn between(a: &Capsule, b: &Capsule) -> f64 {
    let (u, v) = (a.ends[1] - a.ends[0], b.ends[1] - b.ends[0]);
    let w = a.ends[0] - b.ends[0];
    let (uu, uv, vv, uw, vw) = (u.dot(&u), u.dot(&v), v.dot(&v), u.dot(&w), v.dot(&w));
    // Nearest points of the two segments: a.ends[0] + s u and b.ends[0] + t v, with s and t first
    // as on infinite lines, then clamped to the segments one after the other.
    let along = |t: f64| t.clamp(0.0, 1.0);
    let determinant = uu * vv - uv * uv;
    let mut s = if determinant > 1e-12 { along((uv * vw - vv * uw) / determinant) } else { 0.0 };
    let mut t = if vv > 0.0 { (uv * s + vw) / vv } else { 0.0 };
    if !(0.0..=1.0).contains(&t) || vv == 0.0 {
        t = along(t);
        s = if uu > 0.0 { along((uv * t - uw) / uu) } else { 0.0 };
    }
    (w + s * u - t * v).norm() - a.radius - b.radius
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Makes random points with coordinates from -1 to 1 m.
    fn point() -> impl Strategy<Value = Point3<f64>> {
        prop::array::uniform3(-1.0..1.0f64).prop_map(Point3::from)
    }

    // Numbers of the parts of an arm, after column 0, lower arm 1, upper arm 2 and wrist 3.
    const GRIPPER: usize = 4;
    const PLATE: usize = 5;
    const FINGERS: usize = 6;
    const CUBE: usize = 7;

    /// Returns an arm whose parts are balls of 1 cm radius, each part at the point that `at`
    /// returns for its number.
    fn of_balls(at: impl Fn(usize) -> Point3<f64>) -> Bodies {
        let ball = |part: usize| Capsule::new([at(part); 2], 0.01);
        Bodies {
            links: std::array::from_fn(ball),
            plate: [ball(PLATE); 4],
            fingers: ball(FINGERS),
            cube: ball(CUBE),
        }
    }

    /// Returns an arm whose parts with the numbers `near` are 2 cm from the origin, towards `side`
    /// (1 or -1) along x. All its other parts are far away.
    fn with_near(near: &[usize], side: f64) -> Bodies {
        let x = |part: usize| if near.contains(&part) { 0.02 } else { 10.0 * (part + 1) as f64 };
        of_balls(|part| Point3::new(side * x(part), 0.0, 0.0))
    }

    /// Every pair of parts of two arms counts in exactly one of [`at_the_cube`] and [`hands`]. Only
    /// the pair of palm plates counts in neither.
    #[test]
    fn arm_and_hand_distances_share_no_part_pair() {
        for i in 0..=CUBE {
            for j in 0..=CUBE {
                let (a, b) = (with_near(&[i], 1.0), with_near(&[j], -1.0));
                let always = at_the_cube(&a, &b) < FAR;
                let seen = |hold: [bool; 2]| hands(&a, &b, hold) < FAR;

                assert_eq!(always || seen([true; 2]), (i, j) != (PLATE, PLATE), "{i} {j}");
                assert!(!(always && seen([true; 2])), "{i} {j} is counted twice");
                // These pairs meet by design where both hands are at one cube.
                let by_design = |i: usize, j: usize| i == CUBE && j >= GRIPPER || i == FINGERS;
                assert_eq!(
                    always,
                    !by_design(i, j) && !by_design(j, i) && (i, j) != (PLATE, PLATE),
                    "{i} {j}"
                );
                // A hand that holds nothing has no cube.
                for hold in [[false, true], [true, false], [false; 2]] {
                    let is_there = (i != CUBE || hold[0]) && (j != CUBE || hold[1]);
                    assert_eq!(seen(hold), seen([true; 2]) && is_there, "{i} {j} {hold:?}");
                }
            }
        }
    }

    /// Brings one part after the other near the own links, the zone and the table, and checks in
    /// which distances it counts.
    #[test]
    fn own_zone_and_table_distances_cover_intended_parts() {
        let zone = HandZone {
            world_from_cube: crate::spatial::Pose::identity(),
            half_extent: Vector3::repeat(0.01),
        };
        for i in 0..=CUBE {
            for j in 0..i {
                // Only gripper and cube count against the own links. The gripper does not count
                // against the wrist, to which it is joined.
                let own = i == GRIPPER && j < 3 || i == CUBE && j < GRIPPER;
                assert_eq!(with_near(&[i, j], 1.0).own() < FAR, own, "{i} {j}");
            }
            let near = with_near(&[i], 1.0);
            assert!(near.distance_to_zone(&zone, true) < FAR, "{i}");
            assert_eq!(
                near.distance_to_zone(&zone, false) < FAR,
                i < 3,
                "{i}: the hand takes the cube"
            );
            let lowered = of_balls(|part| Point3::new(0.0, 0.0, if part == i { 0.5 } else { 1.0 }));
            let lowest = match i {
                // Column and lower arm do not count: at 1 m the cube is the lowest of all others.
                0 | 1 => 1.0 - CUBE_HALF_HEIGHT,
                // The cube may be laid on the table.
                CUBE => 0.5 - CUBE_HALF_HEIGHT,
                _ => 0.49,
            };
            assert!((lowered.lowest() - lowest).abs() < 1e-12, "{i}: {}", lowered.lowest());
        }
        // A lying cylinder reaches below its axis by its radius, an upright one ends with its axis.
        let capsule = |to: Vector3<f64>| {
            let from = Point3::new(0.0, 0.0, 1.0);
            Capsule::new([from, from + to], 0.1).lowest()
        };
        assert!((capsule(Vector3::new(0.3, 0.0, 0.0)) - 0.9).abs() < 1e-12);
        assert!((capsule(Vector3::new(0.0, 0.0, -0.3)) - 0.7).abs() < 1e-12);
    }

    /// The bodies contain the parts of the hand at each roll of the wrist, and no body is much
    /// larger than its part.
    #[test]
    fn bodies_contain_parts_of_arm_and_hand() {
        let cell = crate::reach::example_cell();
        for arm in &cell.arms {
            let at = Bodies::of(&cell, arm, &arm.start);
            let [lower, upper, wrist] = arm.model.links;
            for (link, length) in at.links.iter().zip([0.95, lower, upper, wrist]) {
                assert!(((link.ends[1] - link.ends[0]).norm() - length).abs() < 1e-9);
            }
            let (edge, gripper) = (cell.cube.edge, &arm.gripper);
            for roll in 0..16 {
                let mut joints = arm.start;
                joints.0[6] += 0.2 * f64::from(roll);
                let rolled = Bodies::of(&cell, arm, &joints);
                let world_from_tool = arm.world_from_base
                    * arm.model.base_from_flange(&joints)
                    * arm.flange_from_tool;
                // Distance of a body from a point in the tool's frame.
                let off = |body: &Capsule, at: [f64; 3]| {
                    between(body, &Capsule::new([world_from_tool * Point3::from(at); 2], 0.0))
                };
                for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                    for z in [-edge / 6.0, 5.0 * edge / 6.0] {
                        let corner = [0.5 * x * edge, 0.5 * y * edge, z];
                        assert!(off(&at.cube, corner).abs() < 1e-9, "{corner:?}");
                    }
                    let out = 0.5 * edge + gripper.finger_thickness;
                    for z in [-gripper.palm, gripper.finger_tip] {
                        let deep = -off(&at.fingers, [0.5 * x * gripper.finger_width, y * out, z]);
                        assert!((0.0..0.002).contains(&deep), "{deep}");
                    }
                    let wide = gripper.palm_half_width;
                    let corner = [x * wide, y * wide, -gripper.palm - super::PLATE];
                    let deep = rolled.plate.iter().map(|body| off(body, corner));
                    let deep = deep.fold(f64::INFINITY, f64::min);
                    assert!(deep.abs() < 1e-4, "{deep}");
                }
                // The camera, 55 mm beside the axis and 0.12 m behind the tool point.
                let deep = -off(&at.links[GRIPPER], [0.055, 0.0, -0.12]);
                assert!((0.015..0.025).contains(&deep), "{deep}");
            }
        }
    }

    /// Returns the least value of a convex function between 0 and 1, found by thirds.
    fn least(of: impl Fn(f64) -> f64) -> f64 {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let third = (high - low) / 3.0;
            if of(low + third) < of(high - third) { high -= third } else { low += third }
        }
        of(f64::midpoint(low, high))
    }

    proptest! {
        #[test]
        fn box_to_segment_distance_matches_sampled_points(a in point(), b in point()) {
            let zone = HandZone {
                world_from_cube: crate::spatial::Pose::identity(),
                half_extent: Vector3::new(0.1, 0.2, 0.3),
            };

            let distance = zone.distance_to_segment(&a, &b);

            let at = |i: u32| zone.distance(&(a + (b - a) * (f64::from(i) / 500.0)));
            let nearest = (0..=500).map(at).fold(f64::INFINITY, f64::min);
            prop_assert!(distance <= nearest + 1e-6 && distance > nearest - 4e-3);
        }

        #[test]
        fn capsule_distance_is_least_distance_of_surfaces(
            a in point(), b in point(), c in point(), d in point(),
            radii in prop::array::uniform2(0.0..0.3f64),
        ) {
            let (x, y) = (Capsule::new([a, b], radii[0]), Capsule::new([c, d], radii[1]));

            let distance = between(&x, &y);

            let off = |s: f64, t: f64| ((a + (b - a) * s) - (c + (d - c) * t)).norm();
            let nearest = least(|s| least(|t| off(s, t)));
            prop_assert!((distance - (nearest - radii[0] - radii[1])).abs() < 1e-6);
            prop_assert!((between(&y, &x) - distance).abs() < 1e-9);
            // The sphere about a capsule contains its ends.
            for end in x.ends {
                prop_assert!((end - x.middle).norm() + x.radius <= x.reach + 1e-12);
            }
        }
    }
}
