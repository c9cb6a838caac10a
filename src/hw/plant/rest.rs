//! The table under the cube: what bears it, and what it slides on.
//!
//! - in: the cube's pose, the table's height
//! - out: the wrench on the cube and its stiffness; a state that the caller commits once a substep
//! - while it is about to come to rest it moves no faster than its weight would let it: without inertia a cube that
//!   stands on an edge would lie flat in the next substep, and knock at open jaws on its way with 120 N
//! - each corner below the table top is borne by a spring of its own; friction holds the cube where it came to rest,
//!   by a spring along x, y and about z that slides when it would carry more than its share of the weight on it

use super::frame::{Frame, rotation_vector};
use nalgebra::{Matrix6, Vector3, Vector6};

/// Of the table under one corner (N/m).
const STIFFNESS: f64 = 2.5e4;
/// Along the table (N/m), and about the vertical (Nm/rad).
const HOLDING: (f64, f64) = (2e4, 8.0);
/// Coefficient of friction of plastic on felt.
const FRICTION: f64 = 0.4;
/// Damping near the table (Ns/m), [Nms/rad]: it falls flat at about 1 rad/s.
const DAMPING: (f64, f64) = (20.0, 0.03);
/// A cube that has just left the table is still near it so far above (m).
const NEAR: f64 = 2e-3;
/// Farther below its top the table bears nothing: the cube is beside it (m).
const DEEPEST: f64 = 0.02;

/// A table top and how the cube stands on it.
#[derive(Debug, Clone)]
pub(super) struct Rest {
    /// Of the table top in the world (m).
    pub(super) height: f64,
    half_edge: f64,
    /// Where the cube came to rest, while it does.
    settled: Option<Frame>,
    /// How far it has slid since along x and y (m), and turned about z (rad).
    slid: Vector3<f64>,
    /// Where it was a substep ago, near the table.
    before: Option<Frame>,
    /// With what the table bore it in the last substep (N).
    pub(super) borne: f64,
}

/// One evaluation, about the cube's centre, in the world.
pub(super) struct Bearing {
    pub(super) force: Vector3<f64>,
    pub(super) torque: Vector3<f64>,
    /// The negated derivative of both by displacement and rotation of the cube.
    pub(super) stiffness: Matrix6<f64>,
    settled: Option<Frame>,
    slid: Vector3<f64>,
    cube: Frame,
    normal: f64,
}

impl Rest {
    pub(super) fn new(height: f64, edge: f64) -> Self {
        Self {
            height,
            half_edge: 0.5 * edge,
            settled: None,
            slid: Vector3::zeros(),
            before: None,
            borne: 0.0,
        }
    }

    /// What the table does to a cube within a substep of `dt` (s); `None` when it does nothing.
    pub(super) fn bear(&self, cube: &Frame, dt: f64) -> Option<Bearing> {
        let above = cube.p.z - self.height;
        if above > 2.0 * self.half_edge || above < -DEEPEST {
            return None;
        }
        let (mut normal, mut torque) = (0.0, Vector3::zeros());
        let mut stiffness = Matrix6::zeros();
        let mut lowest = f64::INFINITY;
        for i in 0..8 {
            let side =
                |bit: usize| if i >> bit & 1 == 0 { -self.half_edge } else { self.half_edge };
            let lever = cube.r * Vector3::new(side(0), side(1), side(2));
            let depth = -above - lever.z;
            lowest = lowest.min(-depth);
            if depth <= 0.0 {
                continue;
            }
            let force = Vector3::z() * (STIFFNESS * depth);
            normal += force.z;
            torque += lever.cross(&force);
            let along = moved_by(&lever, &Vector3::z());
            stiffness += along * along.transpose() * STIFFNESS;
        }
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
            self.rub(&mut bearing, cube, above);
        }
        if let Some(before) = &self.before {
            damp(&mut bearing, cube, before, dt);
        }
        Some(bearing)
    }

    /// Friction on the table top.
    fn rub(&self, bearing: &mut Bearing, cube: &Frame, above: f64) {
        let settled = self.settled.unwrap_or(*cube);
        (bearing.settled, bearing.slid) = (Some(settled), self.slid);
        let turned = rotation_vector(&(cube.r * settled.r.transpose())).z;
        let off = cube.p - settled.p;
        let strain = Vector3::new(off.x, off.y, turned) - bearing.slid;
        let mut force = Vector3::new(strain.x, strain.y, 0.0) * -HOLDING.0;
        let mut twist = -HOLDING.1 * strain.z;
        let most = FRICTION * bearing.normal;
        // A square that turns on its face rubs at two thirds of its half edge, on the average.
        let load = (force.norm() / most).hypot(twist / (most * self.half_edge * 2.0 / 3.0));
        if load > 1.0 {
            force /= load;
            twist /= load;
            bearing.slid += strain * (1.0 - 1.0 / load);
        }
        let lever = Vector3::new(0.0, 0.0, -above);
        bearing.force += force;
        bearing.torque += lever.cross(&force) + Vector3::z() * twist;
        for axis in [Vector3::x(), Vector3::y()] {
            let along = moved_by(&lever, &axis);
            bearing.stiffness += along * along.transpose() * HOLDING.0;
        }
        bearing.stiffness[(5, 5)] += HOLDING.1;
    }

    /// Takes over the substep's last evaluation.
    pub(super) fn commit(&mut self, bearing: Option<Bearing>) {
        self.borne = bearing.as_ref().map_or(0.0, |b| b.normal);
        self.settled = bearing.as_ref().and_then(|b| b.settled);
        self.before = bearing.as_ref().map(|b| b.cube);
        self.slid = bearing.map_or_else(Vector3::zeros, |b| b.slid);
    }
}

/// What slows the cube down.
fn damp(bearing: &mut Bearing, cube: &Frame, before: &Frame, dt: f64) {
    let (along, about) = (DAMPING.0 / dt, DAMPING.1 / dt);
    bearing.force -= (cube.p - before.p) * along;
    bearing.torque -= rotation_vector(&(cube.r * before.r.transpose())) * about;
    for i in 0..3 {
        bearing.stiffness[(i, i)] += along;
        bearing.stiffness[(3 + i, 3 + i)] += about;
    }
}

/// How far a point goes along an axis, by displacement and rotation of the cube.
fn moved_by(lever: &Vector3<f64>, axis: &Vector3<f64>) -> Vector6<f64> {
    let turn = lever.cross(axis);
    Vector6::new(axis.x, axis.y, axis.z, turn.x, turn.y, turn.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    const EDGE: f64 = 0.06;
    /// So long that nothing is damped (s).
    const DT: f64 = 1e12;

    fn at(x: f64, z: f64) -> Frame {
        Frame { r: Matrix3::identity(), p: Vector3::new(x, 0.0, z) }
    }

    #[test]
    fn a_table_bears_from_below_and_nothing_pulls() {
        let rest = Rest::new(0.7, EDGE);

        assert!(rest.bear(&at(0.0, 0.7301), DT).is_none());
        let borne = rest.bear(&at(0.0, 0.7299), DT).unwrap();

        assert!((borne.force.z - 4.0 * STIFFNESS * 1e-4).abs() < 1e-9);
        assert!(borne.torque.norm() < 1e-12);
    }

    #[test]
    fn a_tilted_cube_is_pushed_flat() {
        let tilt = Frame { r: super::super::frame::about(&Vector3::x(), 0.01), ..at(0.0, 0.7298) };

        let borne = Rest::new(0.7, EDGE).bear(&tilt, DT).unwrap();

        assert!(borne.torque.x < 0.0, "{}", borne.torque);
    }

    #[test]
    fn near_the_table_the_cube_is_slowed_down_the_more_the_faster_it_goes() {
        let mut rest = Rest::new(0.7, EDGE);
        let gone = at(0.0, 0.7299 + 0.5 * NEAR);
        assert!(rest.bear(&gone, DT).is_none(), "it was not there before");
        let borne = rest.bear(&at(0.0, 0.7299), DT).unwrap();
        rest.commit(Some(borne));
        let (down, turned, dt) = (1e-3, 0.02, 5e-4);
        let moved = Frame {
            r: super::super::frame::about(&Vector3::x(), turned),
            ..at(0.0, 0.7299 - down)
        };

        let slowly = rest.bear(&moved, DT).unwrap();
        let quickly = rest.bear(&moved, dt).unwrap();

        let (force, torque) = (quickly.force - slowly.force, quickly.torque - slowly.torque);
        assert!((force - Vector3::z() * (DAMPING.0 * down / dt)).norm() < 1e-6, "{force}");
        assert!((torque + Vector3::x() * (DAMPING.1 * turned / dt)).norm() < 1e-6, "{torque}");
        let stiffer = quickly.stiffness - slowly.stiffness;
        let (along, about) = (DAMPING.0 / dt, DAMPING.1 / dt);
        let wanted = Vector6::new(along, along, along, about, about, about);
        assert!((stiffer - Matrix6::from_diagonal(&wanted)).norm() < 1e-6, "{stiffer}");
        // Just above, too, where nothing bears it any more, and no farther.
        let above = rest.bear(&gone, dt).unwrap();
        assert!((above.force.z + DAMPING.0 * 0.5 * NEAR / dt).abs() < 1e-6, "{}", above.force);
        assert!(rest.bear(&at(0.0, 0.7301 + NEAR), dt).is_none());
    }

    #[test]
    fn friction_holds_to_its_share_of_the_load_and_then_slides() {
        let mut rest = Rest::new(0.7, EDGE);
        let borne = rest.bear(&at(0.0, 0.7299), DT).unwrap();
        rest.commit(Some(borne));
        let most = FRICTION * rest.borne;

        let little = rest.bear(&at(0.2 * most / HOLDING.0, 0.7299), DT).unwrap();
        assert!((little.force.x + 0.2 * most).abs() < 1e-9);
        assert!(little.torque.y > 0.0, "it rubs below the centre: {}", little.torque);

        let far = rest.bear(&at(0.01, 0.7299), DT).unwrap();
        assert!((far.force.x + most).abs() < 1e-9);
        rest.commit(Some(far));
        // It stays where it slid to, and is held from there.
        let back = rest.bear(&at(0.01 - 2.0 * most / HOLDING.0, 0.7299), DT).unwrap();
        assert!((back.force.x - most).abs() < 1e-9, "{}", back.force);
    }
}
