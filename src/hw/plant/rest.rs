//! Table under the cube, or under another body: it carries the body and rubs on it.
//!
//! - in: the body's pose and its corners, the heights of the table and of level supports on it
//! - out: the wrench on the cube and its stiffness; a state that the caller commits once a substep
//! - load: a spring of its own carries each corner below the table top, or below a support's top
//! - friction: a spring along x, y and about z holds the cube where it came to rest, and slides
//!   when it would carry more than its share of the load
//! - damping: near the table the cube moves no faster than its weight would let it. Without inertia
//!   a cube on an edge would lie flat in the next substep, and hit open jaws on its way with 120 N

use super::frame::{Frame, rotation_vector};
use nalgebra::{Matrix6, Vector3, Vector6};

/// Stiffness of the table under one corner (N/m).
const STIFFNESS: f64 = 2.5e4;
/// Stiffness of the friction along the table (N/m) and about the vertical (Nm/rad).
const HOLDING: (f64, f64) = (2e4, 8.0);
/// Coefficient of friction of plastic on felt.
const FRICTION: f64 = 0.4;
/// Damping near the table (Ns/m, Nms/rad): the cube falls flat at about 1 rad/s.
const DAMPING: (f64, f64) = (20.0, 0.03);
/// Height up to which a cube that has just left the table is near it (m).
const NEAR: f64 = 2e-3;
/// Depth of the cube's centre below the table top from which on the cube is beside the table (m).
const DEEPEST: f64 = 0.02;

/// Level top of a fixed body, on which other bodies may lie.
#[derive(Debug, Clone, Copy)]
pub(super) struct Support {
    /// Centre of the top, with the axes of its sides, in the world.
    pub(super) top: Frame,
    /// Half its sides (m).
    pub(super) half: [f64; 2],
}

/// Properties of a body that decide how it lies.
#[derive(Debug, Clone)]
pub(super) struct Resting {
    /// Corners in the body's frame (m), all that can touch the table.
    pub(super) corners: Vec<Vector3<f64>>,
    /// Mean distance of a lower corner from the middle of its face (m), for the friction of a turn.
    pub(super) radius: f64,
    /// Greatest height of the centre above the table in a contact (m).
    pub(super) reach: f64,
    /// Stiffness under one corner (N/m).
    pub(super) stiffness: f64,
    /// Coefficient of friction.
    pub(super) friction: f64,
    /// Damping near the table (Ns/m, Nms/rad).
    pub(super) damping: (f64, f64),
    /// Tops on which the body may lie, beside the table.
    pub(super) supports: Vec<Support>,
}

/// Table top, and the rest of a body on it.
#[derive(Debug, Clone)]
pub(super) struct Rest {
    /// Height of the table top in the world (m).
    pub(super) height: f64,
    body: Resting,
    /// Pose at which the cube came to rest, while it lies there.
    settled: Option<Frame>,
    /// Slip since then along x and y (m), and about z (rad).
    slid: Vector3<f64>,
    /// Pose in the last substep, if near the table.
    before: Option<Frame>,
    /// Force that carried the cube in the last substep (N).
    pub(super) table_load: f64,
}

/// Wrench of the table in one evaluation, about the cube's centre, in the world (N, Nm).
pub(super) struct Bearing {
    pub(super) force: Vector3<f64>,
    pub(super) torque: Vector3<f64>,
    /// Negated derivative of the wrench by displacement and rotation of the cube.
    pub(super) stiffness: Matrix6<f64>,
    /// Pose at which the cube came to rest, as in [`Rest`].
    settled: Option<Frame>,
    /// Slip after this evaluation, as in [`Rest`].
    slid: Vector3<f64>,
    /// Pose of the cube.
    cube: Frame,
    /// Force that carries the cube (N).
    normal: f64,
}

impl Rest {
    /// Makes a table with its top at `height` (m), on which no cube lies yet. `edge` is the edge of
    /// the cube (m).
    pub(super) fn new(height: f64, edge: f64) -> Self {
        let half = 0.5 * edge;
        let side = |i: usize, bit: usize| if i >> bit & 1 == 0 { -half } else { half };
        let corner = |i: usize| Vector3::new(side(i, 0), side(i, 1), side(i, 2));
        let body = Resting {
            corners: (0..8).map(corner).collect(),
            radius: half,
            reach: 2.0 * half,
            stiffness: STIFFNESS,
            friction: FRICTION,
            damping: DAMPING,
            supports: Vec::new(),
        };
        Self::of(height, body)
    }

    /// Makes a table with its top at `height` (m), on which `body` does not lie yet.
    pub(super) fn of(height: f64, body: Resting) -> Self {
        Self { height, body, settled: None, slid: Vector3::zeros(), before: None, table_load: 0.0 }
    }

    /// Returns the height of the ground below a `point` (m): that of the table, or of the highest
    /// top there that the point has not sunk into by more than the depth of a contact.
    fn ground(&self, point: &Vector3<f64>) -> f64 {
        let mut ground = self.height;
        for Support { top, half } in &self.body.supports {
            let local = top.r.tr_mul(&(point - top.p));
            let above = local.x.abs() <= half[0] && local.y.abs() <= half[1];
            if above && local.z > -DEEPEST {
                ground = ground.max(top.p.z);
            }
        }
        ground
    }

    /// Returns the wrench and the stiffness with which the table acts on a cube at `cube` in a
    /// substep of `dt` (s), or `None` for a cube that is not at the table.
    pub(super) fn contact(&self, cube: &Frame, dt: f64) -> Option<Bearing> {
        let above = cube.p.z - self.height;
        let highest = self.body.supports.iter().fold(self.height, |h, s| h.max(s.top.p.z));
        if cube.p.z - highest > self.body.reach || above < -DEEPEST {
            return None;
        }
        let (mut normal, mut torque) = (0.0, Vector3::zeros());
        let mut stiffness = Matrix6::zeros();
        let mut lowest = f64::INFINITY;
        // Height of the ground below the deepest corner, where friction acts.
        let mut floor = self.height;
        // Corners alone make all contacts: a face lies on four of them, an edge on two.
        for corner in &self.body.corners {
            let lever = cube.r * corner;
            let ground = self.ground(&(cube.p + lever));
            let depth = -(cube.p.z - ground) - lever.z;
            if -depth < lowest {
                (lowest, floor) = (-depth, ground);
            }
            if depth <= 0.0 {
                continue;
            }
            let force = Vector3::z() * (self.body.stiffness * depth);
            normal += force.z;
            torque += lever.cross(&force);
            let along = moved_by(&lever, &Vector3::z());
            stiffness += along * along.transpose() * self.body.stiffness;
        }
        // A cube that has just left the table is still damped: it has no inertia that would limit
        // its speed.
        if normal == 0.0 && (lowest > NEAR || self.before.is_none()) {
            return None;
        }
        let mut bearing = Bearing {
            force: Vector3::z() * normal,
            torque,
            stiffness,
            settled: None,
            slid: Vector3::zeros(),
            cube: *cube,
            normal,
        };
        if normal > 0.0 {
            self.rub(&mut bearing, cube, cube.p.z - floor);
        }
        if let Some(before) = &self.before {
            damp(&mut bearing, cube, before, self.body.damping, dt);
        }
        Some(bearing)
    }

    /// Adds to `bearing` the friction between the cube and the table top. The cube's centre is
    /// `above` (m) higher than the table top.
    fn rub(&self, bearing: &mut Bearing, cube: &Frame, above: f64) {
        let settled = self.settled.unwrap_or(*cube);
        (bearing.settled, bearing.slid) = (Some(settled), self.slid);
        let turned = rotation_vector(&(cube.r * settled.r.transpose())).z;
        let off = cube.p - settled.p;
        let strain = Vector3::new(off.x, off.y, turned) - bearing.slid;
        let mut force = Vector3::new(strain.x, strain.y, 0.0) * -HOLDING.0;
        let mut twist = -HOLDING.1 * strain.z;
        let most = self.body.friction * bearing.normal;
        // A square that turns on its face rubs at two thirds of its half edge on average.
        let load = (force.norm() / most).hypot(twist / (most * self.body.radius * 2.0 / 3.0));
        if load > 1.0 {
            force /= load;
            twist /= load;
            bearing.slid += strain * (1.0 - 1.0 / load);
        }
        // Friction acts on the table top, below the cube's centre: it tilts the cube as well.
        let lever = Vector3::new(0.0, 0.0, -above);
        bearing.force += force;
        bearing.torque += lever.cross(&force) + Vector3::z() * twist;
        for axis in [Vector3::x(), Vector3::y()] {
            let along = moved_by(&lever, &axis);
            bearing.stiffness += along * along.transpose() * HOLDING.0;
        }
        bearing.stiffness[(5, 5)] += HOLDING.1;
    }

    /// Lets a body land on the table at `frame`: from now on its motion is damped.
    pub(super) fn land(&mut self, frame: &Frame) {
        (self.settled, self.slid, self.before) = (None, Vector3::zeros(), Some(*frame));
    }

    /// Checks whether the body was near the table in the last substep.
    pub(super) fn is_near(&self) -> bool {
        self.before.is_some()
    }

    /// Stores the last evaluation of this substep: how the table acts on the cube, or `None` if the
    /// cube is away from the table.
    pub(super) fn commit(&mut self, bearing: Option<Bearing>) {
        self.table_load = bearing.as_ref().map_or(0.0, |b| b.normal);
        self.settled = bearing.as_ref().and_then(|b| b.settled);
        self.before = bearing.as_ref().map(|b| b.cube);
        self.slid = bearing.map_or_else(Vector3::zeros, |b| b.slid);
    }
}

/// Adds to `bearing` the damping of the cube's motion from `before` to `cube` in one substep of
/// `dt` (s). `damping` is that of a displacement (Ns/m) and of a rotation (Nms/rad).
fn damp(bearing: &mut Bearing, cube: &Frame, before: &Frame, damping: (f64, f64), dt: f64) {
    let (along, about) = (damping.0 / dt, damping.1 / dt);
    bearing.force -= (cube.p - before.p) * along;
    bearing.torque -= rotation_vector(&(cube.r * before.r.transpose())) * about;
    for i in 0..3 {
        bearing.stiffness[(i, i)] += along;
        bearing.stiffness[(3 + i, 3 + i)] += about;
    }
}

/// Returns the gradient of a point's displacement along `axis` by displacement and rotation of the
/// cube. `lever` leads from the cube's centre to the point.
fn moved_by(lever: &Vector3<f64>, axis: &Vector3<f64>) -> Vector6<f64> {
    let turn = lever.cross(axis);
    Vector6::new(axis.x, axis.y, axis.z, turn.x, turn.y, turn.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// Edge of the cube (m). On the table, at 0.7 m, its centre is at 0.73 m.
    const EDGE: f64 = 0.06;
    /// Length of a substep that is so long that no damping remains (s).
    const DT: f64 = 1e12;

    /// Returns the frame of an upright cube whose centre is at (x, 0, z) (m).
    fn at(x: f64, z: f64) -> Frame {
        Frame { r: Matrix3::identity(), p: Vector3::new(x, 0.0, z) }
    }

    #[test]
    fn table_carries_cube_without_pulling() {
        let rest = Rest::new(0.7, EDGE);

        assert!(rest.contact(&at(0.0, 0.7301), DT).is_none());
        let bearing = rest.contact(&at(0.0, 0.7299), DT).unwrap();

        assert!((bearing.force.z - 4.0 * STIFFNESS * 1e-4).abs() < 1e-9);
        assert!(bearing.torque.norm() < 1e-12);
    }

    #[test]
    fn table_pushes_tilted_cube_flat() {
        let tilt = Frame { r: super::super::frame::about(&Vector3::x(), 0.01), ..at(0.0, 0.7298) };

        let bearing = Rest::new(0.7, EDGE).contact(&tilt, DT).unwrap();

        assert!(bearing.torque.x < 0.0, "{}", bearing.torque);
    }

    /// The damping grows with the speed of the cube, and acts only near the table.
    #[test]
    fn table_damps_cube_by_its_speed() {
        let mut rest = Rest::new(0.7, EDGE);
        let gone = at(0.0, 0.7299 + 0.5 * NEAR);
        assert!(rest.contact(&gone, DT).is_none(), "no table force before the contact");
        let bearing = rest.contact(&at(0.0, 0.7299), DT).unwrap();
        rest.commit(Some(bearing));
        let (down, turned, dt) = (1e-3, 0.02, 5e-4);
        let moved = Frame {
            r: super::super::frame::about(&Vector3::x(), turned),
            ..at(0.0, 0.7299 - down)
        };

        let slowly = rest.contact(&moved, DT).unwrap();
        let quickly = rest.contact(&moved, dt).unwrap();

        let (force, torque) = (quickly.force - slowly.force, quickly.torque - slowly.torque);
        assert!((force - Vector3::z() * (DAMPING.0 * down / dt)).norm() < 1e-6, "{force}");
        assert!((torque + Vector3::x() * (DAMPING.1 * turned / dt)).norm() < 1e-6, "{torque}");
        let stiffer = quickly.stiffness - slowly.stiffness;
        let (along, about) = (DAMPING.0 / dt, DAMPING.1 / dt);
        let wanted = Vector6::new(along, along, along, about, about, about);
        assert!((stiffer - Matrix6::from_diagonal(&wanted)).norm() < 1e-6, "{stiffer}");
        // Just above the table it is damped as well although nothing carries it, but no farther up.
        let above = rest.contact(&gone, dt).unwrap();
        assert!((above.force.z + DAMPING.0 * 0.5 * NEAR / dt).abs() < 1e-6, "{}", above.force);
        assert!(rest.contact(&at(0.0, 0.7301 + NEAR), dt).is_none());
    }

    #[test]
    fn table_friction_is_limited_to_share_of_load() {
        let mut rest = Rest::new(0.7, EDGE);
        let bearing = rest.contact(&at(0.0, 0.7299), DT).unwrap();
        rest.commit(Some(bearing));
        let most = FRICTION * rest.table_load;

        let little = rest.contact(&at(0.2 * most / HOLDING.0, 0.7299), DT).unwrap();
        assert!((little.force.x + 0.2 * most).abs() < 1e-9);
        assert!(little.torque.y > 0.0, "friction acts below the centre: {}", little.torque);

        let far = rest.contact(&at(0.01, 0.7299), DT).unwrap();
        assert!((far.force.x + most).abs() < 1e-9);
        rest.commit(Some(far));
        // The cube stays where it slid to, and friction holds it from there.
        let back = rest.contact(&at(0.01 - 2.0 * most / HOLDING.0, 0.7299), DT).unwrap();
        assert!((back.force.x - most).abs() < 1e-9, "{}", back.force);
    }
}
