//! The registers of an ISA card, and the encoding of their words.
//!
//! - the pointer selects an axis, to which command and status then belong
//! - a pulse width has its magnitude in the low byte, with 0x0200 (positive) or 0x0300 (negative)
//! - a resolver axis has its current in the low byte of the status, an encoder axis in the reply
//!   register
//! - the aggregated error word has 5 bits for each axis: synchronisation zero, synchronisation
//!   switch, lower limit, upper limit, over-current

use std::time::Duration;

/// Ports of a card.
pub mod port {
    /// Pointer, which selects the axis (8 bits).
    pub const AXIS: u16 = 0x325;
    /// Command to the selected axis (written), its status (read).
    pub const COMMAND: u16 = 0x220;
    /// Digital outputs (written); reply with the current of encoder axes in the high byte (read).
    pub const OUTPUTS: u16 = 0x222;
    /// Low word of the counter, inverted.
    pub const POSITION_LOW: u16 = 0x224;
    /// High word of the counter, inverted.
    pub const POSITION_HIGH: u16 = 0x226;
    /// 16 binary inputs of the I/O packet. Its 8 analog inputs are the bytes of the four words from
    /// [`COMMAND`] on, the low byte first.
    pub const INPUTS: u16 = 0x228;
    /// Value of the pointer for the I/O packet.
    pub const IO_PACKET: u8 = 0xc8;
    /// Value of the pointer for the interrupt generator.
    pub const INTERRUPTS: u8 = 0xc0;
}

/// Commands to an axis.
pub mod command {
    /// Order to set the counter to zero.
    pub const RESET_POSITION: u16 = 0x0400;
    /// Order to end a motion by the cabinet's buttons.
    pub const RESET_MANUAL: u16 = 0x0800;
    /// Order to clear an alarm, of an over-current or a limit switch.
    pub const RESET_ALARM: u16 = 0x0c00;
    /// Order to disable the cabinet's buttons.
    pub const PROHIBIT_MANUAL: u16 = 0x1000;
    /// Order to enable the cabinet's buttons.
    pub const ALLOW_MANUAL: u16 = 0x1400;
    /// Order to track the zero: the next zero of the encoder becomes that of the counter.
    pub const START_SYNCHRO: u16 = 0x1800;
    /// Order to end the tracking of the zero.
    pub const FINISH_SYNCHRO: u16 = 0x1c00;
    /// Order to set the divisor of the interrupt's frequency, in the low byte. For 2 ms it is 8 on
    /// the postument's card and 4 on the track's.
    pub const SET_INTERRUPT_DIVISOR: u16 = 0x2000;
    /// Order to set the limit of the current, in the low byte.
    pub const SET_MAX_CURRENT: u16 = 0x2400;
    /// Order to begin interrupts.
    pub const START_INTERRUPTS: u16 = 0x5000;
    /// Order to obey the words of this table.
    pub const MICROCONTROLLER_MODE: u16 = 0x4c00;
    /// Pulse width 0; with a magnitude in the low byte, a pulse width forwards.
    pub const STOP_MOTOR: u16 = 0x0200;
    /// Pulse width backwards, with its magnitude in the low byte.
    pub const BACKWARDS: u16 = 0x0300;
}

/// Counts of a revolution of a resolver.
pub const REVOLUTION: i64 = 682;

/// Kind of an axis, which decides the encoding of its words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AxisKind {
    /// Resolver with [`REVOLUTION`] counts, whose bad readings are marked.
    Resolver,
    /// Encoder.
    Encoder {
        /// Whether its synchronisation switch is active high.
        sync_high: bool,
    },
}

/// Decoded status word; inverted bits are inverted back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[allow(clippy::struct_excessive_bools, reason = "each bool is one bit of the status word")]
pub struct AxisStatus {
    /// Whether the resolver or encoder is at its zero.
    pub zero: bool,
    /// Whether the current limit was exceeded.
    pub over_current: bool,
    /// Whether the synchronisation switch is pressed.
    pub sync_switch: bool,
    /// Whether the upper limit switch is hit.
    pub upper: bool,
    /// Whether the lower limit switch is hit.
    pub lower: bool,
    /// Whether the counter counts from the synchronisation switch (encoder axes only).
    pub synchronised: bool,
    /// Whether the power is on; one encoder axis of a card reports it for all.
    pub power: bool,
}

impl AxisStatus {
    /// Decodes a status word.
    #[must_use]
    pub fn decode(word: u16, kind: AxisKind) -> Self {
        let set = |mask: u16| word & mask != 0;
        let common = Self { zero: set(0x0100), over_current: set(0x0400), ..Self::default() };
        // The bit of a limit switch is 0 while the switch is hit, on both kinds of axes.
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

    /// Encodes the status word of an emulated card, without the current that the low byte of a
    /// resolver axis holds.
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

    /// Returns the five bits of the axis in the aggregated error word.
    #[must_use]
    pub fn error_bits(&self) -> u64 {
        [self.zero, self.sync_switch, self.lower, self.upper, self.over_current]
            .iter()
            .enumerate()
            .fold(0, |bits, (i, is)| bits | u64::from(*is) << i)
    }
}

/// Bits of the aggregated error word that stop the motors: all except those of synchronisation.
pub const HARDWARE_ERROR: u64 = 0xe739_cce7_39ce_739c;

/// Bits of the aggregated error word that are limit switches.
pub const LIMITS: u64 = {
    let (mut bits, mut axis) = (0, 0);
    while axis < 8 {
        bits |= 0b01100 << (5 * axis);
        axis += 1;
    }
    bits
};

/// Returns the aggregated error word: five bits for each axis, those of axis 0 lowest.
#[must_use]
pub fn error_word(axes: impl IntoIterator<Item = AxisStatus>) -> u64 {
    axes.into_iter().enumerate().fold(0, |word, (i, axis)| word | axis.error_bits() << (5 * i))
}

/// Encodes a pulse width, -255..=255, as a command word.
#[must_use]
pub fn pulse_word(width: i16) -> u16 {
    let magnitude = width.unsigned_abs().min(255);
    if width < 0 { command::BACKWARDS | magnitude } else { command::STOP_MOTOR | magnitude }
}

/// Decodes the pulse width in a command word; `None` if the word is another command.
#[must_use]
pub fn width_of(word: u16) -> Option<i16> {
    let magnitude = (word & 0xff) as i16;
    match word & 0xff00 {
        command::STOP_MOTOR => Some(magnitude),
        command::BACKWARDS => Some(-magnitude),
        _ => None,
    }
}

/// Decodes the counter of an encoder axis from its two inverted words.
#[must_use]
pub fn counter(low: u16, high: u16) -> i32 {
    (u32::from(!high) << 16 | u32::from(!low)) as i32
}

/// Decodes the counter of a resolver axis from its two inverted words; `None` for a bad reading.
///
/// The high word holds whole revolutions, signed, the low word the angle within one. Source: the
/// interrupt handler in the original's sources of the track.
#[must_use]
pub fn resolver(low: u16, high: u16) -> Option<i64> {
    let word = !low;
    let revolutions = i64::from(!high as i16);
    (word & 0x0800 == 0).then(|| revolutions * REVOLUTION + i64::from(word & 0x07ff))
}

/// Access to the registers of a card, real or emulated.
pub trait Registers: Send {
    /// Reads a byte from the card's I/O port `port`.
    fn read8(&mut self, port: u16) -> u8;
    /// Writes a byte to the card's I/O port `port`.
    fn write8(&mut self, port: u16, value: u8);
    /// Writes a 16-bit word to the card's I/O port `port`.
    fn write16(&mut self, port: u16, value: u16);
    /// Reads a 16-bit word from the card's I/O port `port`.
    fn read16(&mut self, port: u16) -> u16;
    /// Returns whether the card has raised its interrupt since the last call, or raises it within
    /// this time.
    fn interrupted(&mut self, within: Duration) -> bool;
    /// Waits the 2 ms that a card needs to take some commands. Only the set-up and the end of a run
    /// call this.
    fn pause(&mut self);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn decoded_status_equals_encoded_status(
            bits in any::<[bool; 7]>(), resolver in any::<bool>(), sync_high in any::<bool>()
        ) {
            let kind = if resolver { AxisKind::Resolver } else { AxisKind::Encoder { sync_high } };
            let status = AxisStatus {
                zero: bits[0], over_current: bits[1], sync_switch: bits[2],
                upper: bits[3], lower: bits[4],
                synchronised: bits[5] && !resolver, power: bits[6] && !resolver,
            };

            prop_assert_eq!(AxisStatus::decode(status.encode(kind), kind), status);
        }

        #[test]
        fn decoded_width_and_counter_equal_encoded(width in -255..=255i16, count in any::<i32>()) {
            prop_assert_eq!(width_of(pulse_word(width)), Some(width));
            let bits = count as u32;
            prop_assert_eq!(counter(!(bits as u16), !((bits >> 16) as u16)), count);
        }
    }

    #[test]
    fn register_words_match_original_sources() {
        assert_eq!(pulse_word(190), 0x02be);
        assert_eq!(pulse_word(-1), 0x0301);
        assert_eq!(width_of(command::RESET_ALARM), None);
        // The bits of a resolver axis off its limit switches, and on its synchronisation switch.
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
    fn all_error_bits_except_synchronisation_stop_motors() {
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
