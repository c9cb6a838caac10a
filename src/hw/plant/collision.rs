//! Unwanted contacts: fingers, palms, hands and forearms of the two arms, the cube, the table.
//!
//! - in: poses of both arms, the jaws and the cube, once a servo period
//! - out: forces on the arms (penalty springs with damping, held for the next period), and each new
//!   contact
//! - sweep: a large motion in a period is sampled on its way as well. A graze between two periods
//!   counts but leaves no force; the same bodies in contact at the period's end leave one
//! - shapes: fingers, hands, wrists and forearms are capsules, palm plates are boxes, the cube is
//!   its eight corners. The contact of pads, palms' stops and finger ends with the cube belongs to
//!   the grasp. An arm does not meet itself; the operator's hand gives way

use super::arm::PlantArm;
use super::frame::Frame;
use super::verdict::{Incident, Part};
use crate::cell::{Gripper, MOST_ARMS, PerArm};
use crate::motion::AXES;
use nalgebra::Vector3;

/// Penalty spring (N/m) and damper (Ns/m), and the greatest force that it gives (N).
const SPRING: (f64, f64, f64) = (2e4, 100.0, 300.0);
/// Radii: hand behind the palm, wrist, forearm (m).
const RADII: [f64; 3] = [0.045, 0.05, 0.065];
/// Half the thickness of a palm plate (m).
const PALM: f64 = 0.004;
/// Distance of the parts at which a contact ends (m).
const APART: f64 = 2e-3;
/// Depth to which a cube that is laid down sinks into the table at most (m): 30 N on its four
/// corners.
const LAID_DOWN: f64 = 3e-4;
/// Distance of the wrists beyond which the arms cannot touch (m).
const FAR: f64 = 1.3;
/// Longest motion between two samples (m): a twentieth of a finger's thickness.
const STEP: f64 = 5e-4;
/// Most samples of a period; at 1 m/s four are needed.
const LOOKS: f64 = 8.0;
/// Capsules of an arm: two fingers, hand, wrist, forearm.
const CAPSULES: usize = 5;

/// Capsule: all points within `radius` (m) of the segment from `a` to `b`, in the world.
#[derive(Debug, Clone, Copy)]
struct Capsule {
    a: Vector3<f64>,
    b: Vector3<f64>,
    radius: f64,
}

/// Contact of two parts: its depth (m), its place, and the direction in which it pushes the first
/// part.
#[derive(Clone, Copy)]
struct Contact {
    depth: f64,
    at: Vector3<f64>,
    normal: Vector3<f64>,
}

/// Parts of an arm that may collide.
#[derive(Debug, Clone, Copy)]
struct Shape {
    capsules: [Capsule; CAPSULES],
    /// Centre of the palm plate, in the world.
    palm: Frame,
    /// Half the sides of the palm plate (m).
    palm_half: Vector3<f64>,
}

/// All parts that may collide, at one instant.
#[derive(Debug, Clone, Copy)]
struct Scene {
    arms: PerArm<Option<Shape>>,
    /// Corners of the cube.
    corners: [Vector3<f64>; 8],
}

/// Contacts at the end of the last period, and the forces that they make.
#[derive(Debug, Clone, Default)]
pub(super) struct Collisions {
    /// Set of the pairs of parts in contact, one bit for each pair: at most 207.
    active: [u128; 2],
    /// Scene at the end of the last period.
    before: Option<Scene>,
    /// Joint torques of the obstacles, per arm.
    pub(super) torques: PerArm<[f64; AXES]>,
    /// Least distance between a part of one arm and a part of another in this run (m); `None`
    /// while the arms were far from each other.
    pub(super) arms_apart: Option<f64>,
}

/// Cube as an obstacle: pose, edge, and the arm that holds it alone.
pub(super) struct HeldCube {
    pub(super) frame: Frame,
    pub(super) edge: f64,
    pub(super) holder: Option<usize>,
}

/// Bodies that may touch, once a servo period.
pub(super) struct Bodies<'a> {
    pub(super) arms: &'a [PlantArm],
    /// Openings of the jaws (m).
    pub(super) openings: PerArm<f64>,
    pub(super) grippers: PerArm<&'a Gripper>,
    pub(super) cube: HeldCube,
    /// Height of the table (m).
    pub(super) table: f64,
}

impl Collisions {
    /// Checks arms, cube and table for contacts, now and on the way since the last period, and
    /// calls `found` with each contact that is new. Contacts that exist now push the arms.
    pub(super) fn look(&mut self, bodies: &Bodies<'_>, mut found: impl FnMut(Incident)) {
        self.torques = [[0.0; AXES]; MOST_ARMS];
        let now = Scene::of(bodies);
        if let Some(before) = self.before.replace(now) {
            // Between two periods a fast finger could pass through another one.
            let looks = (before.farthest(&now) / STEP).ceil().min(LOOKS);
            for k in 1..looks as u32 {
                let on_the_way = before.towards(&now, f64::from(k) / looks);
                self.look_at(&on_the_way, bodies, false, &mut found);
            }
        }
        self.look_at(&now, bodies, true, &mut found);
    }

    /// Checks all pairs of parts for contacts at one instant, `scene`, and calls `found` with each
    /// contact that is new. With `push` the contacts also push the arms.
    fn look_at(
        &mut self,
        scene: &Scene,
        bodies: &Bodies<'_>,
        push: bool,
        found: &mut impl FnMut(Incident),
    ) {
        let mut look = Look { collisions: self, bodies, push, found, index: 0 };
        look.arms_and_table(scene);
        let count = bodies.arms.len();
        for pair in (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b))) {
            look.two_arms(scene, pair);
        }
        look.cube(scene);
    }

    /// Adds the joint torques with which a contact pushes its parts `a` and `b` apart. `holder` is
    /// the arm that holds the cube and takes a load on it.
    fn push(
        &mut self,
        arms: &[PlantArm],
        contact: &Contact,
        (a, b): (Part, Part),
        holder: Option<usize>,
    ) {
        let owner = |p: Part| match p {
            Part::Finger(i) | Part::Palm(i) | Part::Hand(i) | Part::Forearm(i) => Some(i),
            Part::Cube => holder,
            Part::Table => None,
        };
        let (first, second) = (owner(a), owner(b));
        let speed = |i: Option<usize>| {
            i.map_or_else(Vector3::zeros, |i| arms[i].velocity_at(&contact.at).0)
        };
        let closing = -(speed(first) - speed(second)).dot(&contact.normal);
        let (k, c, most) = SPRING;
        // A contact pushes and never pulls, so the damper cannot make the force negative.
        let force = contact.normal * (k * contact.depth + c * closing).clamp(0.0, most);
        for (i, sign) in [(first, 1.0), (second, -1.0)] {
            let Some(i) = i else { continue };
            // A forearm moves by the joints before the wrist alone.
            let last = if matches!((a, b), (Part::Forearm(x), _) | (_, Part::Forearm(x)) if x == i)
            {
                4
            } else {
                AXES
            };
            let torques = arms[i].torques(&(force * sign), &Vector3::zeros(), &contact.at);
            for (sum, torque) in self.torques[i].iter_mut().zip(torques).take(last) {
                *sum += torque;
            }
        }
    }
}

/// Examination of one instant. Each pair of parts has a bit of [`Collisions::active`], in the order
/// of the calls.
struct Look<'a, F> {
    collisions: &'a mut Collisions,
    bodies: &'a Bodies<'a>,
    /// Whether contacts act on the arms.
    push: bool,
    found: &'a mut F,
    /// Number of pairs examined.
    index: u32,
}

impl<F: FnMut(Incident)> Look<'_, F> {
    /// Reports the contact of the parts `a` and `b` if it is new, and pushes them apart. `contact`
    /// is `None` for parts that are too far apart to touch.
    fn touched(&mut self, contact: Option<Contact>, a: Part, b: Part) {
        let bit = 1_u128 << (self.index % u128::BITS);
        let active = &mut self.collisions.active[(self.index / u128::BITS) as usize];
        self.index += 1;
        let depth = contact.map_or(f64::NEG_INFINITY, |c| c.depth);
        // A contact ends only once its parts are apart: parts that tremble against each other are
        // reported once.
        if depth > 0.0 && *active & bit == 0 {
            *active |= bit;
            (self.found)(Incident::Collision { what: a, with: b, depth });
        } else if depth < -APART {
            *active &= !bit;
        }
        if let Some(contact) = contact
            && self.push
            && depth > 0.0
        {
            let Bodies { arms, cube, .. } = self.bodies;
            self.collisions.push(arms, &contact, (a, b), cube.holder);
        }
    }

    /// Checks fingers, hand and wrist of each arm for contact with the table. Forearms are always
    /// well above it.
    fn arms_and_table(&mut self, scene: &Scene) {
        let table = self.bodies.table;
        for (i, shape) in scene.arms.iter().enumerate().take(self.bodies.arms.len()) {
            for k in 0..4 {
                let contact = shape.as_ref().map(|s| above_table(&s.capsules[k], table));
                self.touched(contact, part(i, k), Part::Table);
            }
        }
    }

    /// Checks whether two arms are close enough to touch.
    fn are_near(&self, (a, b): (usize, usize)) -> bool {
        let arms = self.bodies.arms;
        let apart = arms[a].world_from_flange.p - arms[b].world_from_flange.p;
        apart.norm_squared() < FAR * FAR
    }

    /// Checks two arms `a` and `b` for contact with each other: capsules against capsules, then
    /// palms against fingers.
    fn two_arms(&mut self, scene: &Scene, (a, b): (usize, usize)) {
        let near = self.are_near((a, b));
        let [first, second] = [scene.arms[a].as_ref(), scene.arms[b].as_ref()];
        for k in 0..CAPSULES {
            for l in 0..CAPSULES {
                let contact = match (first, second) {
                    // Pairs that cannot touch are called as well: a pair's bit follows from the
                    // order of the calls.
                    (Some(f), Some(s)) if near => Some(capsules(&f.capsules[k], &s.capsules[l])),
                    _ => None,
                };
                self.keep_least_distance(contact);
                self.touched(contact, part(a, k), part(b, l));
            }
        }
        for (owner, guest, plate, other) in [(a, b, first, second), (b, a, second, first)] {
            for k in 0..2 {
                let contact = match (plate, other) {
                    (Some(plate), Some(other)) if near => Some(plate.meets(&other.capsules[k])),
                    _ => None,
                };
                self.keep_least_distance(contact);
                self.touched(contact, part(guest, k), Part::Palm(owner));
            }
        }
    }

    /// Keeps the distance between parts of two arms, if it is the least of the run.
    fn keep_least_distance(&mut self, contact: Option<Contact>) {
        if let Some(Contact { depth, .. }) = contact {
            let least = &mut self.collisions.arms_apart;
            *least = Some(least.map_or(-depth, |least| least.min(-depth)));
        }
    }

    /// Checks a cube that one arm alone holds for contact with the other arms and the table.
    fn cube(&mut self, scene: &Scene) {
        let deepest = |f: &dyn Fn(&Capsule) -> Contact| {
            let mut worst: Option<Contact> = None;
            for at in &scene.corners {
                let contact = f(&Capsule { a: *at, b: *at, radius: 0.0 });
                if worst.is_none_or(|w| contact.depth > w.depth) {
                    worst = Some(contact);
                }
            }
            worst
        };
        let holder = self.bodies.cube.holder;
        let table = self.bodies.table;
        let any = holder.is_some();
        // A cube that is laid down sinks a little into the table; only more than that is a
        // collision.
        let table_contact =
            if any { deepest(&|c| above_table(c, table - LAID_DOWN)) } else { None };
        self.touched(table_contact, Part::Cube, Part::Table);
        for (i, shape) in scene.arms.iter().enumerate().take(self.bodies.arms.len()) {
            // Arms that are far from the holder cannot touch its cube.
            let near = holder.is_some_and(|holder| holder != i && self.are_near((holder, i)));
            let other = shape.as_ref().filter(|_| near);
            // Fingers are left out: their contact with the cube belongs to the grasp.
            for k in 2..CAPSULES {
                let contact = other.and_then(|s| deepest(&|c| capsules(c, &s.capsules[k])));
                self.touched(contact, Part::Cube, part(i, k));
            }
            let contact = other.and_then(|s| deepest(&|c| s.meets(c)));
            self.touched(contact, Part::Cube, Part::Palm(i));
        }
    }
}

/// Returns the part of an arm that a capsule of [`Shape::capsules`] stands for.
fn part(arm: usize, capsule: usize) -> Part {
    match capsule {
        0 | 1 => Part::Finger(arm),
        2 | 3 => Part::Hand(arm),
        _ => Part::Forearm(arm),
    }
}

impl Scene {
    /// Returns all parts at the present poses of the bodies.
    fn of(bodies: &Bodies<'_>) -> Self {
        let shape = |i: usize| {
            let arm = bodies.arms.get(i)?;
            Some(Shape::new(arm, bodies.openings[i], bodies.grippers[i]))
        };
        let corner = |i: usize| {
            let cube = &bodies.cube;
            let side = |bit: usize| if i >> bit & 1 == 0 { -0.5 } else { 0.5 } * cube.edge;
            cube.frame.point(&Vector3::new(side(0), side(1), side(2)))
        };
        Self { arms: std::array::from_fn(shape), corners: std::array::from_fn(corner) }
    }

    /// Returns the longest displacement (m) of a point of an arm or the cube from this scene to
    /// `later`.
    fn farthest(&self, later: &Self) -> f64 {
        let mut most = 0.0_f64;
        let mut see = |a: &Vector3<f64>, b: &Vector3<f64>| most = most.max((a - b).norm_squared());
        for (was, is) in self.arms.iter().zip(&later.arms) {
            let (Some(was), Some(is)) = (was, is) else { continue };
            for (c, d) in was.capsules.iter().zip(&is.capsules) {
                see(&c.a, &d.a);
                see(&c.b, &d.b);
            }
        }
        for (c, d) in self.corners.iter().zip(&later.corners) {
            see(c, d);
        }
        most.sqrt()
    }

    /// Returns the scene in between: the points have covered `share` (0 to 1) of their straight
    /// paths to `later`. Over one period the motion is nearly straight.
    fn towards(&self, later: &Self, share: f64) -> Self {
        let point = |a: &Vector3<f64>, b: &Vector3<f64>| a + (b - a) * share;
        let mut between = *later;
        for (shape, was) in between.arms.iter_mut().zip(&self.arms) {
            let (Some(shape), Some(was)) = (shape, was) else { continue };
            for (c, d) in shape.capsules.iter_mut().zip(&was.capsules) {
                (c.a, c.b) = (point(&d.a, &c.a), point(&d.b, &c.b));
            }
            shape.palm.p = point(&was.palm.p, &shape.palm.p);
        }
        for (c, d) in between.corners.iter_mut().zip(&self.corners) {
            *c = point(d, c);
        }
        between
    }
}

impl Shape {
    /// Returns the parts of an arm with the gripper `g`, whose pads are `opening` (m) apart.
    fn new(arm: &PlantArm, opening: f64, g: &Gripper) -> Self {
        let tool = &arm.world_from_tool;
        let points = arm.points();
        // A finger's capsule has the mean of half its width and half its thickness as its radius.
        let radius = 0.25 * (g.finger_width + g.finger_thickness);
        let finger = |side: f64| {
            let y = side * (0.5 * opening + 0.5 * g.finger_thickness);
            Capsule {
                a: tool.point(&Vector3::new(0.0, y, -g.palm)),
                b: tool.point(&Vector3::new(0.0, y, g.finger_tip - radius)),
                radius,
            }
        };
        let [hand, wrist, forearm] = RADII;
        let behind = tool.point(&Vector3::new(0.0, 0.0, -g.palm - hand));
        Self {
            capsules: [
                finger(1.0),
                finger(-1.0),
                Capsule { a: points[4], b: behind, radius: hand },
                Capsule { a: points[3], b: points[4], radius: wrist },
                Capsule { a: points[2], b: points[3], radius: forearm },
            ],
            palm: Frame { r: tool.r, p: tool.point(&Vector3::new(0.0, 0.0, -g.palm - PALM)) },
            palm_half: Vector3::new(g.palm_half_width, g.palm_half_width, PALM),
        }
    }

    /// Returns the contact of a capsule with this arm's palm plate; its normal pushes the capsule.
    /// Only ends and middle of the capsule are checked, which is enough for fingers not longer than
    /// the plate.
    fn meets(&self, c: &Capsule) -> Contact {
        let mut worst = Contact { depth: f64::NEG_INFINITY, at: c.a, normal: Vector3::z() };
        for share in [0.0, 0.5, 1.0] {
            let at = c.a + (c.b - c.a) * share;
            let local = self.palm.r.tr_mul(&(at - self.palm.p));
            let nearest =
                Vector3::from_fn(|i, _| local[i].clamp(-self.palm_half[i], self.palm_half[i]));
            let away = local - nearest;
            let distance = away.norm();
            let (depth, normal) = if distance > 1e-9 {
                (c.radius - distance, away / distance)
            } else {
                // A point inside the plate leaves it through the nearer of the two large faces.
                let side = if local.z < 0.0 { -1.0 } else { 1.0 };
                (c.radius + self.palm_half.z - local.z.abs(), Vector3::z() * side)
            };
            if depth > worst.depth {
                worst = Contact { depth, at, normal: self.palm.r * normal };
            }
        }
        worst
    }
}

/// Returns the contact of a capsule's lower end with a table of the height `table` (m), with a
/// negative depth if the capsule is above the table; the normal points up.
fn above_table(c: &Capsule, table: f64) -> Contact {
    let at = if c.a.z < c.b.z { c.a } else { c.b };
    Contact { depth: table + c.radius - at.z, at, normal: Vector3::z() }
}

/// Returns the contact of two capsules, with a negative depth if they are apart; its normal pushes
/// the first one.
fn capsules(c: &Capsule, d: &Capsule) -> Contact {
    let (u, v, w) = (c.b - c.a, d.b - d.a, c.a - d.a);
    let (a, b, e) = (u.norm_squared(), u.dot(&v), v.norm_squared());
    let (cu, cv) = (u.dot(&w), v.dot(&w));
    let divide = |x: f64, by: f64| if by > 1e-12 { (x / by).clamp(0.0, 1.0) } else { 0.0 };
    // Nearest points of two segments: the minimum of a quadratic in the shares s and t, each kept
    // between the ends. For parallel segments the divisor is 0, and s = 0 is as near as any other.
    let mut s = divide(b * cv - cu * e, a * e - b * b);
    let t = divide(b * s + cv, e);
    s = divide(b * t - cu, a);
    let (p, q) = (c.a + u * s, d.a + v * t);
    let away = p - q;
    let distance = away.norm();
    let normal = if distance > 1e-9 { away / distance } else { Vector3::z() };
    Contact { depth: c.radius + d.radius - distance, at: (p + q) * 0.5, normal }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crossed_capsules_overlap_by_radii_less_axis_distance() {
        let c = Capsule { a: -Vector3::x(), b: Vector3::x(), radius: 0.1 };
        for (height, depth) in [(0.25, -0.05), (0.15, 0.05)] {
            let up = Vector3::z() * height;
            let d = Capsule { a: up - Vector3::y(), b: up + Vector3::y(), radius: 0.1 };

            let contact = capsules(&c, &d);

            assert!((contact.depth - depth).abs() < 1e-12);
            assert_eq!(contact.normal, -Vector3::z());
        }
    }

    #[test]
    fn sweep_finds_contact_between_two_periods() {
        let finger = |x: f64| {
            let a = Vector3::new(x, 0.0, 0.0);
            Capsule { a, b: a + Vector3::z() * 0.05, radius: 0.004 }
        };
        let scene = |x: f64| {
            let palm = Frame::rotated(nalgebra::Matrix3::identity());
            let shape =
                Shape { capsules: [finger(x); CAPSULES], palm, palm_half: Vector3::zeros() };
            Scene { arms: [Some(shape), None, None, None], corners: [Vector3::zeros(); 8] }
        };
        let (before, after, obstacle) = (scene(-0.01), scene(0.01), finger(0.0));
        let depth = |s: &Scene| capsules(&s.arms[0].unwrap().capsules[0], &obstacle).depth;

        assert!(depth(&before) < 0.0 && depth(&after) < 0.0);
        assert!((before.farthest(&after) - 0.02).abs() < 1e-12);
        assert!((depth(&before.towards(&after, 0.5)) - 0.008).abs() < 1e-12);
    }

    #[test]
    fn capsule_depth_is_exact_at_ends_and_sides() {
        let c = Capsule { a: Vector3::zeros(), b: Vector3::x(), radius: 0.1 };
        let beyond = Vector3::new(1.3, 0.0, 0.0);
        let d = Capsule { a: beyond, b: beyond + Vector3::y(), radius: 0.1 };
        assert!((capsules(&c, &d).depth + 0.1).abs() < 1e-12);

        let beside = Vector3::y() * 0.15;
        let e = Capsule { a: beside, b: beside + Vector3::x(), radius: 0.1 };
        assert!((capsules(&c, &e).depth - 0.05).abs() < 1e-12);
    }
}
