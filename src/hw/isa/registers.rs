//! The registers of a card, and the words in them.
//!
//! - an axis is chosen by the pointer; command and status then belong to it
//! - pulse widths: magnitude in the low byte, 0x0200 positive or 0x0300 negative above it
//! - two kinds of axes: resolver axes have the current in the status's low byte, encoder axes in the reply register
//! - the aggregated error word has 5 bits an axis: synchronisation zero, synchronisation switch, lower limit, upper
//!   limit, over-current

use std::time::Duration;

/// Card's ports.
pub mod port {
    /// Chooses the axis; 8 bits.
    pub const AXIS: u16 = 0x325;
    /// Command to the chosen axis (written), its status (read).
    pub const COMMAND: u16 = 0x220;
    /// Digital outputs (written), reply with the current of encoder axes in the high byte (read).
    pub const OUTPUTS: u16 = 0x222;
    /// Low word of the counter, inverted.
    pub const POSITION_LOW: u16 = 0x224;
    /// High word of the counter, inverted.
    pub const POSITION_HIGH: u16 = 0x226;
    /// The I/O packet's 16 binary inputs; its 8 analog ones are the bytes of the four words from [`COMMAND`] on, the
    /// low byte first.
    pub const INPUTS: u16 = 0x228;
    /// Pointer of the I/O packet.
    pub const IO_PACKET: u8 = 0xc8;
    /// Pointer of the interrupt generator.
    pub const INTERRUPTS: u8 = 0xc0;
}

/// Commands to an axis.
pub mod command {
    /// The counter becomes zero.
    pub const RESET_POSITION: u16 = 0x0400;
    /// Ends a motion by hand.
    pub const RESET_MANUAL: u16 = 0x0800;
    /// Forgets an alarm: over-current, a limit switch.
    pub const RESET_ALARM: u16 = 0x0c00;
    /// Motion by hand is forbidden.
    pub const PROHIBIT_MANUAL: u16 = 0x1000;
    /// Motion by hand is allowed.
    pub const ALLOW_MANUAL: u16 = 0x1400;
    /// The next zero of the encoder is taken for the counter's.
    pub const START_SYNCHRO: u16 = 0x1800;
    /// No more.
    pub const FINISH_SYNCHRO: u16 = 0x1c00;
    /// Divisor of the interrupt's frequency in the low byte: 2 ms are 8 on the postument's card, 4 on the track's.
    pub const SET_INTERRUPT_DIVISOR: u16 = 0x2000;
    /// Limit of the current in the low byte.
    pub const SET_MAX_CURRENT: u16 = 0x2400;
    /// Interrupts begin.
    pub const START_INTERRUPTS: u16 = 0x5000;
    /// The axis obeys the words of this table.
    pub const MICROCONTROLLER_MODE: u16 = 0x4c00;
    /// Motor off.
    pub const STOP_MOTOR: u16 = 0x0200;
    /// Pulse width backwards; forwards is [`STOP_MOTOR`] with a magnitude.
    pub const BACKWARDS: u16 = 0x0300;
}

/// Counts of a resolver's revolution.
pub const REVOLUTION: i64 = 682;

/// How the status word of an axis is to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AxisKind {
    /// A resolver: [`REVOLUTION`] counts, bad readings marked.
    Resolver,
    /// An encoder.
    Encoder {
        /// Its synchronisation switch is active high.
        sync_high: bool,
    },
}

/// What a status word says. Inverted bits are turned right.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[allow(clippy::struct_excessive_bools, reason = "bits of a word, as the hardware has them")]
pub struct AxisStatus {
    /// Zero of the resolver or encoder.
    pub zero: bool,
    /// The current limit was exceeded.
    pub over_current: bool,
    /// Synchronisation switch.
    pub sync_switch: bool,
    /// Upper limit switch.
    pub upper: bool,
    /// Lower limit switch.
    pub lower: bool,
    /// Encoder axes: the counter counts from the synchronisation switch.
    pub synchronised: bool,
    /// Encoder axes: power is on; told by the last axis.
    pub power: bool,
}

impl AxisStatus {
    /// From the word.
    #[must_use]
    pub fn decode(word: u16, kind: AxisKind) -> Self {
        let set = |mask: u16| word & mask != 0;
        let common = Self { zero: set(0x0100), over_current: set(0x0400), ..Self::default() };
        match kind {
            AxisKind::Resolver => Self {
                sync_switch: set(0x8000),
                upper: !set(0x2000),
                lower: !set(0x4000),
                ..common
            },
            AxisKind::Encoder { sync_high } => Self {
                sync_switch: set(0x4000) == sync_high,
                upper: !set(0x1000),
                lower: !set(0x2000),
                synchronised: set(0x0040),
                power: set(0x0080),
                ..common
            },
        }
    }

    /// The word, for an emulated card; the low byte's current of resolver axes is added by whoever knows it.
    #[must_use]
    pub fn encode(&self, kind: AxisKind) -> u16 {
        let bit = |is: bool, mask: u16| if is { mask } else { 0 };
        let common = bit(self.zero, 0x0100) | bit(self.over_current, 0x0400);
        common
            | match kind {
                AxisKind::Resolver => {
                    bit(self.sync_switch, 0x8000)
                        | bit(!self.upper, 0x2000)
                        | bit(!self.lower, 0x4000)
                }
                AxisKind::Encoder { sync_high } => {
                    bit(self.sync_switch == sync_high, 0x4000)
                        | bit(!self.upper, 0x1000)
                        | bit(!self.lower, 0x2000)
                        | bit(self.synchronised, 0x0040)
                        | bit(self.power, 0x0080)
                }
            }
    }

    /// Its five bits of the aggregated error word.
    #[must_use]
    pub fn error_bits(&self) -> u64 {
        [self.zero, self.sync_switch, self.lower, self.upper, self.over_current]
            .iter()
            .enumerate()
            .fold(0, |bits, (i, is)| bits | u64::from(*is) << i)
    }
}

/// Bits of the aggregated error word that stop the motors: all but those of synchronisation.
pub const HARDWARE_ERROR: u64 = 0xe739_cce7_39ce_739c;

/// Those of them that are limit switches.
pub const LIMITS: u64 = {
    let (mut bits, mut axis) = (0, 0);
    while axis < 8 {
        bits |= 0b01100 << (5 * axis);
        axis += 1;
    }
    bits
};

/// The aggregated error word of all axes.
#[must_use]
pub fn error_word(axes: impl IntoIterator<Item = AxisStatus>) -> u64 {
    axes.into_iter().enumerate().fold(0, |word, (i, axis)| word | axis.error_bits() << (5 * i))
}

/// The word of a pulse width, -255..=255.
#[must_use]
pub fn pulse_word(width: i16) -> u16 {
    let magnitude = width.unsigned_abs().min(255);
    if width < 0 { command::BACKWARDS | magnitude } else { command::STOP_MOTOR | magnitude }
}

/// The pulse width of a word, if it is one.
#[must_use]
pub fn width_of(word: u16) -> Option<i16> {
    let magnitude = (word & 0xff) as i16;
    match word & 0xff00 {
        command::STOP_MOTOR => Some(magnitude),
        command::BACKWARDS => Some(-magnitude),
        _ => None,
    }
}

/// The counter of an encoder axis from its two inverted words.
#[must_use]
pub fn counter(low: u16, high: u16) -> i32 {
    (u32::from(!high) << 16 | u32::from(!low)) as i32
}

/// The counter of a resolver axis from its two inverted words: whole revolutions in the high one, signed, and the
/// angle within one in the low one (the interrupt handler of the track's sources); `None` for a bad reading.
#[must_use]
pub fn resolver(low: u16, high: u16) -> Option<i64> {
    let word = !low;
    let revolutions = i64::from(!high as i16);
    (word & 0x0800 == 0).then(|| revolutions * REVOLUTION + i64::from(word & 0x07ff))
}

/// Registers of a card, however they are reached.
pub trait Registers: Send {
    /// Reads a byte.
    fn read8(&mut self, port: u16) -> u8;
    /// Writes a byte.
    fn write8(&mut self, port: u16, value: u8);
    /// Writes a word.
    fn write16(&mut self, port: u16, value: u16);
    /// Reads a word.
    fn read16(&mut self, port: u16) -> u16;
    /// Whether the card has raised its interrupt since it was asked last, or does within this time.
    fn interrupted(&mut self, within: Duration) -> bool;
    /// Lets the 2 ms pass that a card needs to take some of its commands; for its set-up and its end only.
    fn pause(&mut self);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn status_words_come_back(bits in any::<[bool; 7]>(), resolver in any::<bool>(), sync_high in any::<bool>()) {
            let kind = if resolver { AxisKind::Resolver } else { AxisKind::Encoder { sync_high } };
            let status = AxisStatus {
                zero: bits[0], over_current: bits[1], sync_switch: bits[2], upper: bits[3], lower: bits[4],
                synchronised: bits[5] && !resolver, power: bits[6] && !resolver,
            };

            prop_assert_eq!(AxisStatus::decode(status.encode(kind), kind), status);
        }

        #[test]
        fn pulse_widths_and_counters_come_back(width in -255..=255i16, count in any::<i32>()) {
            prop_assert_eq!(width_of(pulse_word(width)), Some(width));
            let bits = count as u32;
            prop_assert_eq!(counter(!(bits as u16), !((bits >> 16) as u16)), count);
        }
    }

    #[test]
    fn words_are_those_of_the_card() {
        assert_eq!(pulse_word(190), 0x02be);
        assert_eq!(pulse_word(-1), 0x0301);
        assert_eq!(width_of(command::RESET_ALARM), None);
        // All limit switches of a resolver axis open, the switch of synchronisation closed.
        let status = AxisStatus::decode(0xe000, AxisKind::Resolver);
        assert_eq!(status, AxisStatus { sync_switch: true, ..AxisStatus::default() });
        let [low, high] = [false, true].map(|sync_high| AxisKind::Encoder { sync_high });
        assert!(AxisStatus::decode(0x3000, low).sync_switch);
        assert!(!AxisStatus::decode(0x3000, high).sync_switch);
        assert_eq!(resolver(!0x0123, !2), Some(2 * 682 + 0x0123));
        assert_eq!(resolver(!681, 0), Some(-1), "the revolution below zero");
        assert_eq!(resolver(!0x0923, !2), None);
    }

    #[test]
    fn synchronisation_is_no_error_and_everything_else_is() {
        let at = |axis: usize, status: AxisStatus| {
            let mut axes = [AxisStatus::default(); 8];
            axes[axis] = status;
            error_word(axes)
        };
        for axis in 0..8 {
            let homing = AxisStatus { zero: true, sync_switch: true, ..AxisStatus::default() };
            assert_eq!(at(axis, homing) & HARDWARE_ERROR, 0, "{axis}");
            for hard in [
                AxisStatus { upper: true, ..AxisStatus::default() },
                AxisStatus { lower: true, ..AxisStatus::default() },
                AxisStatus { over_current: true, ..AxisStatus::default() },
            ] {
                assert_ne!(at(axis, hard) & HARDWARE_ERROR, 0, "{axis} {hard:?}");
            }
        }
    }
}
