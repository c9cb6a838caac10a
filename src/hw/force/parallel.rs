//! The parallel interface of the force controller: a PCI-1751 board, which delivers single words.
//!
//! - in: 16 bits in two input ports, announced by the strobe, which the board keeps as its
//!   interrupt flag
//! - out: "input buffer full", held for 10 us, upon which the controller sends the next word
//! - source: the sensor's part of the original's sources (its registers, their set-up, the
//!   handshake). There each word was an interrupt. Here the flag is polled once a period, and
//!   within a record until the next word has come

use super::Words;
use crate::hw::isa::Registers;
use std::time::{Duration, Instant};

/// Ports of the board, counted from its first one.
mod at {
    /// Low byte of a word.
    pub(super) const LOW: u16 = 1;
    /// Handshake lines.
    pub(super) const CONTROL: u16 = 2;
    /// Directions of the ports.
    pub(super) const SET_UP: [u16; 2] = [3, 7];
    /// High byte of a word.
    pub(super) const HIGH: u16 = 5;
    /// Set-up of the interrupt, and its flag.
    pub(super) const INTERRUPT: u16 = 32;
}

/// Set-up of the directions: input ports as inputs, the rest as outputs.
const DIRECTIONS: u8 = 0x03;
/// Set-up of the interrupt: the strobe's edge sets the flag.
const BY_STROBE: u8 = 0x10;
/// Interrupt flag. A write of 1 clears it.
const FLAG: u8 = 0x80;
/// Handshake line: the output buffer holds nothing for the controller.
const OUTPUT_EMPTY: u8 = 0x10;
/// Handshake line: the input buffer is full.
const INPUT_FULL: u8 = 0x20;
/// Time for which [`INPUT_FULL`] is held.
const HOLDS: Duration = Duration::from_micros(10);
/// Longest wait for the next word of a record. Seven waits leave more than a millisecond of a
/// period.
const PATIENCE: Duration = Duration::from_micros(100);

/// A PCI-1751 board.
#[derive(Debug)]
pub struct Pci1751<R> {
    ports: R,
}

impl<R: Registers> Pci1751<R> {
    /// Number of ports that this driver uses, from the first one on.
    pub const PORTS: u16 = at::INTERRUPT + 1;

    /// Sets up the directions of the board's ports and its interrupt flag.
    #[must_use]
    pub fn new(mut ports: R) -> Self {
        for port in at::SET_UP {
            ports.write8(port, DIRECTIONS);
        }
        ports.write8(at::INTERRUPT, BY_STROBE);
        let mut this = Self { ports };
        this.control(OUTPUT_EMPTY, INPUT_FULL);
        this
    }

    /// Sets some handshake lines and clears others, and leaves the rest unchanged.
    fn control(&mut self, set: u8, clear: u8) {
        let lines = self.ports.read8(at::CONTROL);
        self.ports.write8(at::CONTROL, (lines | set) & !clear);
    }

    /// Returns whether the controller has announced a word.
    fn announced(&mut self) -> bool {
        self.ports.read8(at::INTERRUPT) & FLAG != 0
    }
}

impl<R: Registers> Words for Pci1751<R> {
    /// Takes the word that the strobe has announced and requests the next one by the handshake.
    /// Waits up to 0.1 ms for a word that is `due`.
    fn take(&mut self, due: bool) -> Option<u16> {
        let begun = Instant::now();
        while !self.announced() {
            if !due || begun.elapsed() > PATIENCE {
                return None;
            }
            std::hint::spin_loop();
        }
        // The flag is cleared before the handshake: after it the controller may send the next word
        // at once, whose strobe must not be cleared.
        let interrupt = self.ports.read8(at::INTERRUPT);
        self.ports.write8(at::INTERRUPT, interrupt | FLAG);
        self.control(INPUT_FULL, 0);
        let word = u16::from_le_bytes([self.ports.read8(at::LOW), self.ports.read8(at::HIGH)]);
        // A sleep would take longer than these 10 us: the kernel wakes a thread tens of
        // microseconds late.
        let full = Instant::now();
        while full.elapsed() < HOLDS {
            std::hint::spin_loop();
        }
        self.control(0, INPUT_FULL);
        Some(word)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::collections::VecDeque;
    use std::sync::{Arc, Mutex};

    /// State of an emulated board, and of the controller behind it, which sends a word after the
    /// last one was taken.
    struct State {
        ports: [u8; Pci1751::<Board>::PORTS as usize],
        /// Words that the controller has not finished sending.
        waiting: VecDeque<u16>,
        /// Whether the handshake says that the input buffer is full.
        full: bool,
    }

    /// Emulated board. Clones share it.
    #[derive(Clone)]
    pub(in super::super) struct Board(Arc<Mutex<State>>);

    impl Default for Board {
        fn default() -> Self {
            let ports = [0; Pci1751::<Self>::PORTS as usize];
            Self(Arc::new(Mutex::new(State { ports, waiting: VecDeque::new(), full: false })))
        }
    }

    impl Board {
        /// Makes the controller send these words, one after another.
        pub(in super::super) fn give(&self, words: &[u16]) {
            let mut state = self.0.lock().unwrap();
            state.waiting.extend(words);
            state.next();
        }
    }

    impl State {
        /// Puts the next word on the input ports and raises the flag, if the board is set up and
        /// the last word was taken.
        fn next(&mut self) {
            let set_up =
                self.ports[3] == 0x03 && self.ports[7] == 0x03 && self.ports[32] & 0x10 != 0;
            if set_up
                && !self.full
                && self.ports[32] & FLAG == 0
                && let Some(word) = self.waiting.front()
            {
                [self.ports[1], self.ports[5]] = word.to_le_bytes();
                self.ports[32] |= FLAG;
            }
        }
    }

    impl Registers for Board {
        fn read8(&mut self, port: u16) -> u8 {
            self.0.lock().unwrap().ports[usize::from(port)]
        }
        /// Writes a port as the board does: a write of 1 clears the flag, and the end of "input
        /// buffer full" shows that a word was taken.
        fn write8(&mut self, port: u16, value: u8) {
            let mut state = self.0.lock().unwrap();
            match port {
                32 => {
                    let left = state.ports[32] & FLAG & !value;
                    state.ports[32] = value & !FLAG | left;
                }
                1 | 5 => panic!("an input is written"),
                _ => state.ports[usize::from(port)] = value,
            }
            if port == 2 {
                let full = value & INPUT_FULL != 0;
                if state.full && !full {
                    state.waiting.pop_front();
                }
                state.full = full;
                state.next();
            }
        }
        fn read16(&mut self, _: u16) -> u16 {
            panic!("the board has bytes")
        }
        fn write16(&mut self, _: u16, _: u16) {
            panic!("the board has bytes")
        }
        fn interrupted(&mut self, _: std::time::Duration) -> bool {
            false
        }
        fn pause(&mut self) {}
    }

    #[test]
    fn board_delivers_and_acknowledges_word_by_word() {
        let board = Board::default();
        let mut words = Pci1751::new(board.clone());
        assert_eq!(words.take(false), None);
        assert_eq!(words.take(true), None, "the wait is limited");

        board.give(&[0x1234, 0xfffe]);

        assert_eq!(words.take(false), Some(0x1234));
        assert_eq!(words.take(true), Some(0xfffe));
        assert_eq!(words.take(false), None);
    }
}
