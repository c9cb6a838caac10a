//! The frames between the bridge and a serial axis controller, as pure functions.
//!
//! - out: an [`Order`] of 10 bytes: four zeros, `#`, command and parameter in one byte, four bytes
//!   of value
//! - in: a [`Status`] of 8 bytes: `#`, flags, current (mA) in 16 bits, encoder counter in 32 bits
//! - Numbers are little-endian two's complement. A frame has no checksum, so the receiver must
//!   judge whether it can be true (see [`super::axis`]).
//! - source: `hi_moxa` of the original's later sources (921600 baud, 8N2, one line per axis). The
//!   start byte of the answer and the digital outputs in the third byte of a pulse width's value
//!   are this project's.

/// Length of an order (bytes).
pub const ORDER: usize = 10;
/// Length of an answer (bytes).
pub const STATUS: usize = 8;

/// First byte of an answer, and of an order after its four zeros.
const START: u8 = b'#';
/// Full pulse width on the line.
const FULL: i32 = 1000;
/// Full pulse width in an [`Order`].
const WIDEST: i32 = 255;

/// An order to an axis controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Pulse width, -255..=255.
    Pwm {
        /// Pulse width of the motor.
        width: i16,
        /// Digital outputs beside the motor. Bit 0 of a jaw's outputs moves the palm's stops to two
        /// layers.
        outputs: u8,
        /// Whether the controller searches for the encoder's zero behind the synchronisation
        /// switch.
        synchronise: bool,
    },
    /// Wanted motor current (mA).
    Current(i16),
    /// Wanted encoder counter.
    Position(i32),
    /// A parameter.
    Set(Parameter),
}

/// A parameter of an axis controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// Whether the counter counts from the synchronisation switch.
    Synchronised(bool),
    /// Limit of the motor current (mA).
    MaxCurrent(u16),
    /// P, I or D (0..=2) of the position regulator.
    PositionGain(u8, i16),
    /// P, I or D (0..=2) of the current regulator.
    CurrentGain(u8, i16),
    /// Mode of the power stage.
    Mode(Mode),
}

/// Mode of a power stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Off, brake on.
    Manual,
    /// Follows orders of pulse width.
    Pwm,
    /// Off, brake on, until another mode is ordered.
    Error,
}

/// Answer of an axis controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[allow(clippy::struct_excessive_bools, reason = "each bool is one bit of the answer")]
pub struct Status {
    /// Whether the upper limit switch is hit.
    pub upper: bool,
    /// Whether the lower limit switch is hit.
    pub lower: bool,
    /// Whether the synchronisation switch is closed.
    pub sync_switch: bool,
    /// Whether the encoder's zero has passed.
    pub sync_zero: bool,
    /// Whether the power stage reports a fault.
    pub stage_fault: bool,
    /// Whether the current limit was exceeded.
    pub over_current: bool,
    /// Whether the controller is in [`Mode::Error`].
    pub error: bool,
    /// Whether the counter counts from the synchronisation switch.
    pub synchronised: bool,
    /// Motor current (mA).
    pub current: i16,
    /// Encoder counter.
    pub count: i32,
}

impl Order {
    /// Returns the bytes of the order.
    #[must_use]
    pub fn encode(&self) -> [u8; ORDER] {
        let (command, value) = match *self {
            Self::Pwm { width, outputs, synchronise } => {
                // The first two bytes are the width, the third one the outputs.
                let [low, high] = scaled(i32::from(width), FULL, WIDEST).to_le_bytes();
                (if synchronise { 0x10 } else { 0x00 }, [low, high, outputs, 0])
            }
            Self::Current(milliamperes) => (0x01, i32::from(milliamperes).to_le_bytes()),
            Self::Position(count) => (0x02, count.to_le_bytes()),
            Self::Set(parameter) => {
                // The low half of the byte marks a parameter, the high half names it.
                let (which, value) = parameter.encode();
                (0x0f | which, value.to_le_bytes())
            }
        };
        let mut bytes = [0; ORDER];
        bytes[4] = START;
        bytes[5] = command;
        bytes[6..].copy_from_slice(&value);
        bytes
    }

    /// Returns the order that these bytes encode, or `None` if they encode none.
    #[must_use]
    pub fn decode(bytes: &[u8; ORDER]) -> Option<Self> {
        if bytes[..4] != [0; 4] || bytes[4] != START {
            return None;
        }
        let value = [bytes[6], bytes[7], bytes[8], bytes[9]];
        let whole = i32::from_le_bytes(value);
        let half = i16::from_le_bytes([value[0], value[1]]);
        match bytes[5] {
            // A pulse width, with the flag that searches for the zero. More than full is a wrong
            // byte.
            command @ (0x00 | 0x10) => (i32::from(half).abs() <= FULL).then(|| Self::Pwm {
                width: scaled(i32::from(half), WIDEST, FULL),
                outputs: value[2],
                synchronise: command != 0,
            }),
            0x01 => Some(Self::Current(half)),
            0x02 => Some(Self::Position(whole)),
            set if set & 0x0f == 0x0f => Parameter::decode(set & 0xf0, whole).map(Self::Set),
            _ => None,
        }
    }
}

/// Returns `value * to / from`, rounded to the nearest.
fn scaled(value: i32, to: i32, from: i32) -> i16 {
    let half = from / 2 * value.signum();
    ((value * to + half) / from).clamp(-1000, 1000) as i16
}

impl Parameter {
    /// Returns the number of the parameter, in the high half of a byte, and its value.
    fn encode(self) -> (u8, i32) {
        match self {
            Self::Synchronised(is) => (0x10, i32::from(is)),
            Self::MaxCurrent(milliamperes) => (0x20, i32::from(milliamperes)),
            Self::PositionGain(which, gain) => (0x30 + 0x10 * which.min(2), i32::from(gain)),
            Self::CurrentGain(which, gain) => (0x60 + 0x10 * which.min(2), i32::from(gain)),
            Self::Mode(Mode::Manual) => (0x90, 0),
            Self::Mode(Mode::Pwm) => (0x90, 3),
            Self::Mode(Mode::Error) => (0x90, 4),
        }
    }

    /// Returns the parameter with the number `which`, in the high half of the byte; `None` if there
    /// is no such parameter or the value is beyond its range.
    fn decode(which: u8, value: i32) -> Option<Self> {
        Some(match (which, value) {
            // Values beyond the range of a parameter are wrong bytes and no order.
            (0x10, 0 | 1) => Self::Synchronised(value == 1),
            (0x20, _) => Self::MaxCurrent(u16::try_from(value).ok()?),
            (0x30..=0x50, _) => Self::PositionGain((which - 0x30) >> 4, i16::try_from(value).ok()?),
            (0x60..=0x80, _) => Self::CurrentGain((which - 0x60) >> 4, i16::try_from(value).ok()?),
            (0x90, 0) => Self::Mode(Mode::Manual),
            (0x90, 3) => Self::Mode(Mode::Pwm),
            (0x90, 4) => Self::Mode(Mode::Error),
            _ => return None,
        })
    }
}

impl Status {
    /// Returns the bytes of the answer.
    #[must_use]
    pub fn encode(&self) -> [u8; STATUS] {
        let flags =
            self.flags().iter().enumerate().fold(0, |sum, (i, is)| sum | u8::from(*is) << i);
        let [c0, c1] = self.current.to_le_bytes();
        let [p0, p1, p2, p3] = self.count.to_le_bytes();
        [START, flags, c0, c1, p0, p1, p2, p3]
    }

    /// Returns the answer that these bytes encode. The first byte is ignored, because the
    /// original's sources do not specify it (see [`super::axis`]).
    #[must_use]
    pub fn decode(bytes: &[u8; STATUS]) -> Self {
        let [_, flags, c0, c1, p0, p1, p2, p3] = *bytes;
        let is = |bit: u32| flags >> bit & 1 == 1;
        Self {
            upper: is(0),
            lower: is(1),
            sync_switch: is(2),
            sync_zero: is(3),
            stage_fault: is(4),
            over_current: is(5),
            error: is(6),
            synchronised: is(7),
            current: i16::from_le_bytes([c0, c1]),
            count: i32::from_le_bytes([p0, p1, p2, p3]),
        }
    }

    /// Returns the flags in the order of their bits, the lowest first.
    fn flags(&self) -> [bool; 8] {
        [
            self.upper,
            self.lower,
            self.sync_switch,
            self.sync_zero,
            self.stage_fault,
            self.over_current,
            self.error,
            self.synchronised,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns a generator of random orders of all kinds.
    fn orders() -> impl Strategy<Value = Order> {
        prop_oneof![
            (-255..=255i16, any::<u8>(), any::<bool>()).prop_map(
                |(width, outputs, synchronise)| { Order::Pwm { width, outputs, synchronise } }
            ),
            any::<i16>().prop_map(Order::Current),
            any::<i32>().prop_map(Order::Position),
            any::<bool>().prop_map(|is| Order::Set(Parameter::Synchronised(is))),
            any::<u16>().prop_map(|limit| Order::Set(Parameter::MaxCurrent(limit))),
            (0..3u8, any::<i16>()).prop_map(|(i, g)| Order::Set(Parameter::PositionGain(i, g))),
            (0..3u8, any::<i16>()).prop_map(|(i, g)| Order::Set(Parameter::CurrentGain(i, g))),
            prop_oneof![Just(Mode::Manual), Just(Mode::Pwm), Just(Mode::Error)]
                .prop_map(|mode| Order::Set(Parameter::Mode(mode))),
        ]
    }

    proptest! {
        #[test]
        fn decoded_order_equals_encoded_order(order in orders()) {
            prop_assert_eq!(Order::decode(&order.encode()), Some(order));
        }

        #[test]
        fn encoding_decoded_answer_restores_its_bytes(
            bytes in any::<[u8; STATUS]>()
        ) {
            let mut bytes = bytes;
            bytes[0] = START;

            prop_assert_eq!(Status::decode(&bytes).encode(), bytes);
        }

        /// Bytes that this program never sends may decode to an order. If that order is encoded and
        /// decoded again, the result is equal to it.
        #[test]
        fn order_decoded_from_arbitrary_bytes_round_trips(bytes in any::<[u8; ORDER]>()) {
            if let Some(order) = Order::decode(&bytes) {
                prop_assert_eq!(Order::decode(&order.encode()), Some(order));
            }
        }
    }

    #[test]
    fn order_and_answer_bytes_match_original_protocol() {
        let width = Order::Pwm { width: -255, outputs: 0, synchronise: false };
        assert_eq!(width.encode(), [0, 0, 0, 0, b'#', 0x00, 0x18, 0xfc, 0, 0]);
        let homing = Order::Pwm { width: 51, outputs: 0, synchronise: true };
        assert_eq!(homing.encode(), [0, 0, 0, 0, b'#', 0x10, 200, 0, 0, 0]);
        let error = Order::Set(Parameter::Mode(Mode::Error));
        assert_eq!(error.encode(), [0, 0, 0, 0, b'#', 0x9f, 4, 0, 0, 0]);
        let limit = Order::Set(Parameter::MaxCurrent(25_000));
        assert_eq!(limit.encode(), [0, 0, 0, 0, b'#', 0x2f, 0xa8, 0x61, 0, 0]);
        let answer =
            Status { upper: true, synchronised: true, current: -2, count: -3, ..Status::default() };
        assert_eq!(answer.encode(), [b'#', 0x81, 0xfe, 0xff, 0xfd, 0xff, 0xff, 0xff]);
    }

    #[test]
    fn order_with_wrong_start_bytes_is_refused() {
        assert_eq!(Order::decode(&[0, 0, 1, 0, b'#', 0, 0, 0, 0, 0]), None);
    }
}
