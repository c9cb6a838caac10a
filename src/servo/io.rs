//! What crosses the bridge in each period: readings of an arm's hardware in, set values of its drives out.

use crate::motion::{AXES, ArmFault, Depth, MoveRefused};
use crate::spatial::Wrench;
use serde::{Deserialize, Serialize};

/// Axis of the jaw in the bits of [`ArmReading`] and [`ArmDrive`].
pub const JAW: usize = AXES;

/// Drives of one arm for one period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArmDrive {
    /// Power stages on; off means that the brakes hold. Switching on clears the controllers' alarms.
    pub enabled: bool,
    /// Pulse width of each axis, -255..=255.
    pub pwm: [i16; AXES],
    /// Pulse width of the jaw motor, -255..=255.
    pub jaw_pwm: i16,
    /// Position of the palm's two-position stops (digital output).
    pub stops: Depth,
    /// Bit i, the jaw's is [`JAW`]: the controller of axis i sets its counter to zero at the next zero of its
    /// encoder, and then counts as synchronised. A bit that rises makes it forget that it was.
    pub synchronise: u8,
}

impl ArmDrive {
    /// Power off.
    pub const OFF: Self =
        Self { enabled: false, pwm: [0; AXES], jaw_pwm: 0, stops: Depth::One, synchronise: 0 };
}

/// What reaches an arm's servo beside its readings and orders, at the beginning of a period: with these three its
/// drives follow to the bit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Outside {
    /// Grid points that passed without a period since the last one.
    pub skipped: u64,
    /// The arm is brought to a stand, and why.
    pub brake: Option<MoveRefused>,
    /// The arm stops, and why.
    pub trip: Option<ArmFault>,
    /// Another arm is stopped by a fault, or an actor is gone.
    pub stands_by: bool,
}

/// Readings of one arm in one period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArmReading {
    /// Encoder counters, zero at the synchronisation position once the axis is synchronised; until then from
    /// wherever the controller was switched on.
    pub counts: [i64; AXES],
    /// Encoder counter of the jaw motor.
    pub jaw_count: i64,
    /// Motor currents, the jaw's last (A); positive where a positive pulse width drives them.
    pub currents: [f64; AXES + 1],
    /// Bit i, here and below, is that of axis i; the jaw's is [`JAW`]: the limit switch of axis i is hit at the end
    /// to which its counter grows.
    pub upper_limits: u8,
    /// Bit i: the one at the other end.
    pub lower_limits: u8,
    /// Bit i: power stage of axis i reports over-current.
    pub over_currents: u8,
    /// Bit i: power stage of axis i reports a fault of its own, or has no power.
    pub power_faults: u8,
    /// Bit i: the synchronisation switch of axis i is pressed.
    pub sync_switches: u8,
    /// Bit i: the zero of encoder i, once a revolution, has passed since the last reading.
    pub encoder_zeros: u8,
    /// Bit i: the counter of axis i is zero at the synchronisation position.
    pub synchronised: u8,
    /// Bit i: the counter of axis i was not read in time. It is carried on as it went before; the
    /// rest is what the axis last showed. Not set if a bridge is late steadily, or has been late
    /// for long: its counters are carried on, and are all that there is to judge. See
    /// [`super::lateness`].
    #[serde(rename = "guessed")]
    pub extrapolated: u8,
    /// Bit i: nothing new came of axis i since the last period; its power stage stands at the width that it took last.
    #[serde(rename = "unheard")]
    pub no_answer: u8,
    /// What the surroundings and the weight of the tool exert on the sensor, in the sensor's frame.
    /// Components are NaN when the sensor is silent.
    pub wrench_on_sensor: Wrench,
    /// The wrench is the last period's: the sensor has told no newer one.
    #[serde(default)]
    pub wrench_is_old: bool,
    /// Binary inputs of the parallel interface; 0 where the bridge has none. Not recorded.
    #[serde(default)]
    pub inputs: u16,
    /// Its analog inputs, in its own units; likewise.
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
