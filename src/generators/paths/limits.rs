//! Limits of speed, acceleration and jerk, from the full speeds of an arm.
//!
//! - in: the full speeds of position control, and the fraction that an order asks for
//! - out: a [`Limit`] for the tool point, its rotation and each joint

use super::super::own::Site;
use crate::motion::AXES;

/// Acceleration over the limit of the jerk (s). It makes the jerk about as large as that of
/// [`super::super::profile::Profile`] with a ramp at the same limits. The acceleration rises in
/// twice this time, because the change to full braking must keep the limit as well.
const RISE: f64 = 0.15;

/// Limits of one moving thing: in m or rad, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    /// Speed (m/s or rad/s).
    pub speed: f64,
    /// Acceleration (m/s2 or rad/s2).
    pub acceleration: f64,
    /// Jerk (m/s3 or rad/s3).
    pub jerk: f64,
}

impl Limit {
    /// Makes the limit with a jerk of this acceleration per 0.15 s.
    #[must_use]
    pub fn new(speed: f64, acceleration: f64) -> Self {
        Self { speed, acceleration, jerk: acceleration / RISE }
    }
}

/// Limits of an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Tool point.
    pub linear: Limit,
    /// Rotation of the tool.
    pub angular: Limit,
    /// Each joint.
    pub joints: [Limit; AXES],
}

impl Limits {
    /// Returns the limits at this fraction of the full speeds and accelerations.
    ///
    /// # Errors
    /// If the fraction is not above 0 and at most 1, or a full speed is not positive.
    pub fn of(site: &Site<'_>, fraction: f64) -> Result<Self, String> {
        if !(fraction > 0.0 && fraction <= 1.0) {
            return Err(format!("a speed of {fraction} of the full one is outside 0..=1"));
        }
        let s = &site.speeds;
        let limit = |speed: f64, acceleration: f64| {
            let limit = Limit::new(speed * fraction, acceleration * fraction);
            let sound = limit.speed > 0.0 && limit.jerk > 0.0 && limit.jerk.is_finite();
            if sound { Ok(limit) } else { Err("the arm has no full speed".to_owned()) }
        };
        let mut joints = [limit(s.linear, s.linear_acceleration)?; AXES];
        for (axis, joint) in joints.iter_mut().enumerate() {
            *joint = limit(s.joint[axis], s.joint_acceleration[axis])?;
        }
        Ok(Self {
            linear: limit(s.linear, s.linear_acceleration)?,
            angular: limit(s.angular, s.angular_acceleration)?,
            joints,
        })
    }
}
