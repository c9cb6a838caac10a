//! What crosses the bridge in each period: readings of an arm's hardware in, set values of its drives out.

use crate::motion::{AXES, Depth};
use crate::spatial::Wrench;
use serde::{Deserialize, Serialize};

/// Drives of one arm for one period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArmDrive {
    /// Power stages on; off means that the brakes hold.
    pub enabled: bool,
    /// Pulse width of each axis, -255..=255.
    pub pwm: [i16; AXES],
    /// Pulse width of the jaw motor, -255..=255.
    pub jaw_pwm: i16,
    /// Current limit of the jaw motor [A].
    pub jaw_current_limit: f64,
    /// Position of the palm's two-position stops (digital output).
    pub stops: Depth,
}

impl ArmDrive {
    /// Power off.
    pub const OFF: Self = Self {
        enabled: false,
        pwm: [0; AXES],
        jaw_pwm: 0,
        jaw_current_limit: 0.0,
        stops: Depth::One,
    };
}

/// Readings of one arm in one period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArmReading {
    /// Encoder counters, zero at the synchronisation position.
    pub counts: [i64; AXES],
    /// Encoder counter of the jaw motor.
    pub jaw_count: i64,
    /// Motor currents, the jaw's last [A].
    pub currents: [f64; AXES + 1],
    /// Bit i: limit switch of axis i is hit.
    pub limit_switches: u8,
    /// Bit i: power stage of axis i reports over-current.
    pub over_currents: u8,
    /// What the surroundings and the weight of the tool exert on the sensor, in the sensor's frame.
    /// Components are NaN when the sensor is silent.
    pub wrench_on_sensor: Wrench,
}

impl Default for ArmReading {
    fn default() -> Self {
        Self {
            counts: [0; AXES],
            jaw_count: 0,
            currents: [0.0; AXES + 1],
            limit_switches: 0,
            over_currents: 0,
            wrench_on_sensor: Wrench::default(),
        }
    }
}
