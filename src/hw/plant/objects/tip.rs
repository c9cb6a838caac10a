//! Contact of a finger tip or of a probe, as a ball, with a fixed object.
//!
//! - in: the ball with its velocity, the object
//! - out: the force on the tool, and the state of its friction, which the caller keeps
//! - normal: `stiffness * depth`, with a little damping; it never pulls
//! - friction: a spring along the surface from the place where the ball came to rest. Beyond
//!   friction times the normal force it slides along (Coulomb)

use super::super::frame::Frame;
use super::solid::Solid;
use nalgebra::{Matrix3, Vector3};

/// Damping along the normal (Ns/m): 0.2 N at 10 mm/s.
const DAMPING: f64 = 20.0;
/// Greatest normal force (N).
const MOST: f64 = 400.0;

/// Ball on a tool, in the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ball {
    /// Centre (m).
    pub(super) centre: Vector3<f64>,
    /// Radius (m).
    pub(super) radius: f64,
    /// Velocity (m/s).
    pub(super) velocity: Vector3<f64>,
}

/// Fixed object under a ball.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ground<'a> {
    pub(super) solid: &'a Solid,
    /// Pose in the world.
    pub(super) frame: &'a Frame,
    /// Stiffness (N/m).
    pub(super) stiffness: f64,
    /// Coefficient of friction.
    pub(super) friction: f64,
}

/// Place of the object, in its frame (m), at which the friction of a ball has no strain; `None`
/// while the ball does not touch.
pub(super) type Anchor = Option<Vector3<f64>>;

/// Contact of a ball in one substep.
#[derive(Debug, Clone, Copy)]
pub(super) struct Press {
    /// Point of contact, in the world (m).
    pub(super) at: Vector3<f64>,
    /// Point of contact, in the object's frame (m).
    pub(super) place: Vector3<f64>,
    /// Force on the ball, in the world (N).
    pub(super) force: Vector3<f64>,
    /// Negated derivative of the force by the displacement of the ball (N/m), in the world.
    pub(super) stiffness: Matrix3<f64>,
    /// Normal force (N).
    pub(super) normal: f64,
    /// Friction (N).
    pub(super) friction: f64,
}

/// Returns the contact of a ball with a fixed object, and moves the `anchor` of its friction.
pub(super) fn press(ball: &Ball, ground: &Ground<'_>, anchor: &mut Anchor) -> Option<Press> {
    let Ground { solid, frame, stiffness, friction } = ground;
    let local = frame.r.tr_mul(&(ball.centre - frame.p));
    let Some(meeting) = solid.meets(&local, ball.radius) else {
        *anchor = None;
        return None;
    };
    let normal = frame.r * meeting.normal;
    let damped = stiffness * meeting.depth - DAMPING * ball.velocity.dot(&normal);
    let load = damped.clamp(0.0, MOST);
    // The ball's lowest point carries the friction; with a turning tool it hardly moves.
    let place = local - meeting.normal * (ball.radius - meeting.depth);
    let from = anchor.get_or_insert(place);
    let off = place - *from;
    let along = off - meeting.normal * off.dot(&meeting.normal);
    let (trial, most) = (stiffness * along.norm(), friction * load);
    let sticks = trial <= most;
    let held = if sticks { along } else { along * (most / trial) };
    if !sticks {
        *from = place - held;
    }
    let rubs = frame.r * held * -*stiffness;
    let across = normal * normal.transpose();
    // Friction that slides has no stiffness of its own.
    let mut slope = across * *stiffness;
    if sticks {
        slope += (Matrix3::identity() - across) * *stiffness;
    }
    Some(Press {
        at: frame.point(&meeting.at),
        place: meeting.at,
        force: normal * load + rubs,
        stiffness: slope,
        normal: load,
        friction: rubs.norm(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::contour::Contour;
    use super::super::spec::Profile;
    use super::*;
    use rand_pcg::Pcg64;

    /// Returns a slope of 30 deg.
    fn slope() -> Solid {
        let rise = 0.1 * libm::tan(30_f64.to_radians());
        let profile = Profile::Points(vec![[-0.1, -rise], [0.1, rise]]);
        Solid::Surface(Contour::new(&profile, 0.2, &mut Pcg64::new(1, 1)), 0.05, 0.1)
    }

    /// The force stays in the cone of friction around the normal, and on it while the ball slides.
    #[test]
    fn force_on_sliding_tip_lies_on_friction_cone() {
        let solid = slope();
        let ground =
            Ground { solid: &solid, frame: &Frame::IDENTITY, stiffness: 2e4, friction: 0.3 };
        let (sine, cosine) = (0.5, 3_f64.sqrt() / 2.0);
        let (up, along) = (Vector3::new(-sine, 0.0, cosine), Vector3::new(cosine, 0.0, sine));
        let mut anchor = None;
        for step in 0..100 {
            let way = 1e-5 * f64::from(step);
            // 4 mm above the surface with a radius of 5 mm: 1 mm deep, 20 N.
            let centre = Vector3::z() * 0.1 + up * 0.004 + along * way;
            let ball = Ball { centre, radius: 0.005, velocity: Vector3::zeros() };

            let press = press(&ball, &ground, &mut anchor).unwrap();

            assert!((press.normal - 20.0).abs() < 1e-6, "{press:?}");
            assert!((press.force.dot(&up) - 20.0).abs() < 1e-6, "{press:?}");
            let wanted = (2e4 * way).min(0.3 * 20.0);
            assert!((press.force.dot(&along) + wanted).abs() < 1e-6, "{step}: {press:?}");
        }
        let away = Ball { centre: Vector3::z(), radius: 0.005, velocity: Vector3::zeros() };
        assert!(press(&away, &ground, &mut anchor).is_none() && anchor.is_none());
    }
}
