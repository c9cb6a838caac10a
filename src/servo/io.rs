//! Data that cross the bridge in each period: readings of an arm's hardware and drives for it.

use crate::motion::{AXES, ArmFault, Depth, MoveRefused};
use crate::spatial::Wrench;
use serde::{Deserialize, Serialize};

/// Axis number of the jaw in the bits of [`ArmReading`] and [`ArmDrive`].
pub const JAW: usize = AXES;

/// Drive commands of one arm for one period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArmDrive {
    /// Whether the power stages are on; off means that the brakes hold. Switching on clears the
    /// alarms of the controllers.
    pub enabled: bool,
    /// Pulse width of each axis, -255..=255.
    pub pwm: [i16; AXES],
    /// Pulse width of the jaw motor, -255..=255.
    pub jaw_pwm: i16,
    /// Position of the palm's two-position stops (digital output).
    pub stops: Depth,
    /// Bit i (the jaw's is [`JAW`]) orders the controller of axis i to set its counter to zero at
    /// the next zero of its encoder, after which the axis is synchronised. A bit that rises ends an
    /// earlier synchronisation.
    pub synchronise: u8,
}

impl ArmDrive {
    /// Drive commands of an arm with its power off.
    pub const OFF: Self =
        Self { enabled: false, pwm: [0; AXES], jaw_pwm: 0, stops: Depth::One, synchronise: 0 };
}

/// Further inputs of an arm's servo at the beginning of a period. Together with the reading and the
/// command they determine the drive commands to the bit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Outside {
    /// Number of grid points that passed without a period since the last one.
    pub skipped: u64,
    /// Reason to bring the arm to rest.
    pub brake: Option<MoveRefused>,
    /// Fault that stops the arm.
    pub trip: Option<ArmFault>,
    /// Whether this arm must stand by, because another arm is stopped by a fault or an actor is
    /// gone.
    pub stands_by: bool,
}

/// Readings of one arm in one period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArmReading {
    /// Encoder counters. They are zero at the synchronisation position once the axis is
    /// synchronised; before that, at the position where the controller was switched on.
    pub counts: [i64; AXES],
    /// Encoder counter of the jaw motor.
    pub jaw_count: i64,
    /// Motor currents, the jaw's last (A); positive if a positive pulse width drives them.
    pub currents: [f64; AXES + 1],
    /// Limit switches at the ends to which the counters grow. Here and below bit i is that of axis
    /// i; the jaw's is [`JAW`].
    pub upper_limits: u8,
    /// Limit switches at the other ends.
    pub lower_limits: u8,
    /// Over-currents that the power stages report.
    pub over_currents: u8,
    /// Power stages that report a fault of their own or have no power.
    pub power_faults: u8,
    /// Synchronisation switches that are pressed.
    pub sync_switches: u8,
    /// Encoders whose zero, once a revolution, has passed since the last reading.
    pub encoder_zeros: u8,
    /// Synchronised axes, whose counter is zero at the synchronisation position.
    pub synchronised: u8,
    /// Axes whose counter was not read in time. The counter is extrapolated by its last steps; the
    /// other values are the last ones that were read. Not set if a bridge is late steadily, or was
    /// late for long: its extrapolated counters are then all that the watchdogs can judge. See
    /// [`super::lateness`].
    #[serde(rename = "guessed")]
    pub extrapolated: u8,
    /// Axes without a new reading since the last period. The power stage keeps the pulse width that
    /// it took last.
    #[serde(rename = "unheard")]
    pub no_answer: u8,
    /// Wrench that the surroundings and the weight of the tool exert on the sensor, in its frame
    /// (N, Nm). The components are NaN if the sensor is silent.
    pub wrench_on_sensor: Wrench,
    /// Whether the wrench is an old one: the sensor has reported no newer one.
    #[serde(default)]
    pub wrench_is_old: bool,
    /// Binary inputs of the parallel interface; 0 if the bridge has none.
    #[serde(default)]
    pub inputs: u16,
    /// Analog inputs of the parallel interface, in its own units; 0 if the bridge has none. Not
    /// recorded.
    #[serde(default)]
    pub analog_inputs: [u8; 8],
}

impl Default for ArmReading {
    fn default() -> Self {
        Self {
            counts: [0; AXES],
            jaw_count: 0,
            currents: [0.0; AXES + 1],
            upper_limits: 0,
            lower_limits: 0,
            over_currents: 0,
            power_faults: 0,
            sync_switches: 0,
            encoder_zeros: 0,
            synchronised: u8::MAX,
            extrapolated: 0,
            no_answer: 0,
            wrench_on_sensor: Wrench::default(),
            wrench_is_old: false,
            inputs: 0,
            analog_inputs: [0; 8],
        }
    }
}
