//! The stand-alone controller of the original's force sensors. It takes orders on a serial line and
//! sends readings on the same line, or word by word over a parallel interface.
//!
//! - out: lines of two letters that set it up, then one byte (0x14) as the request of a reading
//! - in: a record of a status and six 16-bit components with 20 counts/N and 1000 counts/Nm. On the
//!   line it has 13 bytes: one of status, then the components, high bytes first. On the parallel
//!   interface it has 7 words
//! - 10 ms without a record are a read error, after which the controller is set up again
//! - source: the original's sources of 2008 (38400 baud, 8N1; PCI-1751 with one interrupt a word).
//!   The bytes on the line are the binary output in ATI's manual; the original read the words

use super::net_ft::push_note;
use super::{ForceSource, Intake, Taken};
use crate::hw::note::{NoteKind, Notes};
use crate::hw::serial::Line;
use crate::spatial::Wrench;

/// Speed of the controller's line (bit/s).
const BAUD: u32 = 38_400;
/// Largest number of words that may be left over from an earlier record.
const MOST_WORDS: usize = 64;
/// Length of a record on the line (bytes).
pub const RECORD: usize = 13;
/// Length of a record on the parallel interface (words).
const WORDS: usize = 7;
/// Lines of the set-up: no echo of lines, binary and resolved output of all six components, no
/// averaging, single readings.
const SET_UP: [&[u8]; 7] =
    [b"CL 0\r", b"CF 1\r", b"CD B\r", b"CD R\r", b"CV 3F\r", b"SA 0\r", b"SM 1\r"];
/// Line that moves its answers to the parallel interface. The original repeats the set-up after it.
const PARALLEL: &[u8] = b"CP P\r";
/// Words of an answer that are taken in a period of the set-up. Each holds one character.
const CHARACTERS: usize = 8;
/// Request of one record.
const ONE: &[u8] = &[0x14];
/// Answer to a line of the set-up that was carried out.
const PROMPT: u8 = b'>';
/// Timeout of a record (periods): the original's 10 ms.
const PATIENCE: u32 = 5;
/// Timeout of the answer to a line of the set-up (periods).
const PATIENCE_SET_UP: u32 = 25;

/// Scales of the components (counts/N, counts/Nm), on the line and in words.
const SCALES: [f64; 6] = [20.0, 20.0, 20.0, 1000.0, 1000.0, 1000.0];

/// Decodes a record of the force controller: its status and its wrench (N, Nm).
#[must_use]
pub fn decode_record(bytes: &[u8; RECORD]) -> (u8, Wrench) {
    let counts: [i16; 6] =
        std::array::from_fn(|i| i16::from_be_bytes([bytes[2 * i + 1], bytes[2 * i + 2]]));
    (bytes[0], wrench_of(&counts))
}

/// Encodes a record of the force controller. A component that does not fit into 16 bits becomes the
/// nearest value that does.
#[must_use]
pub fn encode_record(status: u8, wrench: &Wrench) -> [u8; RECORD] {
    let mut bytes = [0; RECORD];
    bytes[0] = status;
    for (i, (value, scale)) in wrench.directions().iter().zip(SCALES).enumerate() {
        let counts = (value * scale).round().clamp(-32768.0, 32767.0) as i16;
        bytes[2 * i + 1..2 * i + 3].copy_from_slice(&counts.to_be_bytes());
    }
    bytes
}

/// Converts the counts of a record to a wrench (N, Nm).
fn wrench_of(counts: &[i16; 6]) -> Wrench {
    Wrench::from_directions(std::array::from_fn(|i| f64::from(counts[i]) / SCALES[i]))
}

/// The parallel interface, which delivers 16-bit words.
pub trait Words: Send {
    /// Takes the next word if one has come. If the word is `due`, because a record has begun but is
    /// not complete, the call may wait briefly for it.
    fn take(&mut self, due: bool) -> Option<u16>;
}

/// Stage of the dialogue with the controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Set-up, with the index of the next line.
    SettingUp(usize),
    /// Requests of records.
    Reading,
}

/// A force/torque controller.
pub struct FtController {
    line: Line,
    words: Option<Box<dyn Words>>,
    intake: Intake,
    stage: Stage,
    /// Periods since the request that is under way, if there is one.
    waiting: Option<u32>,
    record: [u8; RECORD],
    /// Number of bytes of the record that have come. On the parallel interface the status counts
    /// as two.
    length: usize,
}

impl std::fmt::Debug for FtController {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FtController").field("stage", &self.stage).finish_non_exhaustive()
    }
}

impl FtController {
    /// Opens the serial line at `path`. With `words` the controller sends its records by that
    /// parallel interface instead of the line. `range` is that of the sensor (N, Nm).
    ///
    /// # Errors
    /// The error of the operating system, with the device's name.
    pub fn open(
        path: &str,
        words: Option<Box<dyn Words>>,
        range: [f64; 6],
    ) -> Result<Self, String> {
        Ok(Self {
            line: Line::open(path, BAUD, false)?,
            words,
            intake: Intake::new(range),
            stage: Stage::SettingUp(0),
            waiting: None,
            record: [0; RECORD],
            length: 0,
        })
    }

    /// Sends line `step` of the set-up if the last one was answered or is overdue.
    fn set_up(&mut self, step: usize) {
        let answered = self.is_answered();
        // An overdue answer does not end the set-up: a controller that answers none of the lines
        // will not deliver a record either, which begins the set-up again.
        if let Some(periods) = self.waiting
            && !answered
            && periods < PATIENCE_SET_UP
        {
            self.waiting = Some(periods + 1);
            return;
        }
        let line = match &self.words {
            Some(_) => SET_UP.iter().chain([&PARALLEL]).chain(&SET_UP).nth(step),
            None => SET_UP.get(step),
        };
        if let Some(line) = line {
            // A failed write needs no report of its own: the answer does not come.
            let _ = self.line.write(line);
            (self.stage, self.waiting) = (Stage::SettingUp(step + 1), Some(0));
        } else {
            (self.stage, self.waiting) = (Stage::Reading, None);
        }
    }

    /// Returns whether the controller has answered the last line of the set-up.
    fn is_answered(&mut self) -> bool {
        let mut answer = [0; 64];
        let heard = self.line.read(&mut answer).unwrap_or(0);
        let mut answered = answer[..heard].contains(&PROMPT);
        // The line was read as well, because the answers move from it to the parallel interface
        // during the set-up.
        if let Some(words) = &mut self.words {
            for taken in 0..CHARACTERS {
                let Some(word) = words.take(taken > 0) else { break };
                answered |= word.to_be_bytes()[1] == PROMPT;
            }
        }
        answered
    }

    /// Takes the bytes or words that have come; returns the record if it is complete.
    fn record(&mut self) -> Option<(u8, Wrench)> {
        if let Some(words) = &mut self.words {
            while self.length < 2 * WORDS
                && let Some(word) = words.take(self.length > 0)
            {
                // The low byte of the status word is the status byte of the line. The words of the
                // components have the order of bytes of the line.
                let [high, low] = word.to_be_bytes();
                match self.length {
                    0 => self.record[0] = low,
                    at => self.record[at - 1..=at].copy_from_slice(&[high, low]),
                }
                self.length += 2;
            }
            if self.length < 2 * WORDS {
                return None;
            }
        } else {
            self.length += self.line.read(&mut self.record[self.length..]).unwrap_or(0);
            if self.length < RECORD {
                return None;
            }
        }
        self.length = 0;
        Some(decode_record(&self.record))
    }

    /// Requests the next record.
    fn ask(&mut self) {
        // Bytes and words of a broken record would be taken for the beginning of the next one.
        let _ = self.line.drain();
        if let Some(words) = &mut self.words {
            // Bounded, because a missing board seems to have a word at any time.
            for _ in 0..MOST_WORDS {
                if words.take(false).is_none() {
                    break;
                }
            }
        }
        self.length = 0;
        let _ = self.line.write(ONE);
        self.waiting = Some(0);
    }
}

impl ForceSource for FtController {
    /// Carries out one step of the dialogue with the controller: sends the next line of the set-up,
    /// or takes a record and requests the next one.
    fn read(&mut self, period: u64, effector: usize, notes: &mut Notes) -> (Wrench, bool) {
        let mut good = None;
        match self.stage {
            Stage::SettingUp(step) => self.set_up(step),
            Stage::Reading => match (self.record(), self.waiting) {
                // Status 0: the reading is valid.
                (Some((0, wrench)), Some(_)) => {
                    good = Some(wrench);
                    self.ask();
                }
                // The controller reports a fault: its reading does not count.
                (Some((status, _)), Some(_)) => {
                    notes.push(period, effector, NoteKind::ForceStatus { status: status.into() });
                    self.ask();
                }
                // The record is overdue: a read error, upon which the original repeats the set-up.
                (_, Some(periods)) if periods >= PATIENCE => {
                    (self.stage, self.waiting) = (Stage::SettingUp(0), None);
                }
                (_, Some(periods)) => self.waiting = Some(periods + 1),
                // The first request after the set-up.
                (_, None) => self.ask(),
            },
        }
        let (wrench, taken) = self.intake.take(good);
        // The silence during the first set-up, in the first 0.4 s, is normal and not reported.
        if !(matches!(taken, Taken::Silent { .. })
            && matches!(self.stage, Stage::SettingUp(_))
            && period < 200)
        {
            push_note(taken, period, effector, notes);
        }
        (wrench, taken.is_new())
    }
}

#[cfg(test)]
mod tests {
    use super::super::Pci1751;
    use super::super::parallel::tests::Board;
    use super::*;
    use crate::hw::emulator::pty::Pty;
    use proptest::prelude::*;

    const RANGE: [f64; 6] = [65.0, 65.0, 130.0, 5.0, 5.0, 5.0];

    proptest! {
        #[test]
        fn record_keeps_wrench_to_half_a_count(
            f in prop::array::uniform3(-130.0..130.0f64), t in prop::array::uniform3(-5.0..5.0f64)
        ) {
            let wrench = Wrench::from_directions([f[0], f[1], f[2], t[0], t[1], t[2]]);

            let (status, decoded) = decode_record(&encode_record(3, &wrench));

            prop_assert_eq!(status, 3);
            let off = (decoded - wrench).directions();
            prop_assert!(off.iter().zip(SCALES).all(|(off, scale)| off.abs() <= 0.5001 / scale));
        }
    }

    /// Plays the controller: answers lines of the set-up by a prompt and requests by a record.
    fn serve(pty: &Pty, wrench: &Wrench) {
        let mut bytes = [0; 64];
        let n = pty.read(&mut bytes);
        for byte in &bytes[..n] {
            match *byte {
                b'\r' => assert!(pty.write(b">")),
                0x14 => assert!(pty.write(&encode_record(0, wrench))),
                _ => {}
            }
        }
    }

    #[test]
    fn controller_is_set_up_again_after_silence() {
        let pty = Pty::open().unwrap();
        let mut sensor = FtController::open(pty.path(), None, RANGE).unwrap();
        let mut notes = Notes::none();
        let push = Wrench::from_directions([1.0, -2.0, 3.5, 0.1, 0.2, -0.3]);

        let mut wrench = Wrench::from_directions([f64::NAN; 6]);
        for period in 0..100 {
            serve(&pty, &push);
            wrench = sensor.read(period, 0, &mut notes).0;
        }
        assert_eq!(wrench, push);

        for period in 100..120 {
            wrench = sensor.read(period, 0, &mut notes).0;
        }
        assert!(!wrench.is_finite(), "silent");
        for period in 120..400 {
            serve(&pty, &push);
            wrench = sensor.read(period, 0, &mut notes).0;
        }
        assert_eq!(wrench, push, "the sensor recovers by itself");
    }

    #[test]
    fn seven_parallel_words_make_a_record() {
        let pty = Pty::open().unwrap();
        let board = Board::default();
        let words = Pci1751::new(board.clone());
        let mut sensor = FtController::open(pty.path(), Some(Box::new(words)), RANGE).unwrap();
        let mut bytes = [0; 64];
        let mut wrench = Wrench::default();
        let (mut parallel, mut line) = (false, Vec::new());
        let mut lines = Vec::new();

        for period in 0..200 {
            let n = pty.read(&mut bytes);
            for byte in &bytes[..n] {
                match *byte {
                    b'\r' => {
                        let text = String::from_utf8(std::mem::take(&mut line)).unwrap();
                        parallel |= text == "CP P";
                        lines.push(text);
                        if parallel {
                            board.give(&b"ok\r\n>".map(u16::from));
                        } else {
                            assert!(pty.write(b">"));
                        }
                    }
                    // Before the order "CP P" the controller answers on the line.
                    0x14 if parallel => board.give(&[0u16, 20, 40, (-60i16) as u16, 1000, 0, 500]),
                    0x14 => assert!(pty.write(&encode_record(0, &Wrench::default()))),
                    byte => line.push(byte),
                }
            }
            wrench = sensor.read(period, 0, &mut Notes::none()).0;
        }

        // A status, then three forces at 20 counts/N and three torques at 1000 counts/Nm.
        assert_eq!(wrench, Wrench::from_directions([1.0, 2.0, -3.0, 1.0, 0.0, 0.5]));
        let switch = lines.iter().position(|line| line == "CP P").unwrap();
        assert_eq!(lines[..switch], lines[switch + 1..], "the settings are sent again: {lines:?}");
        assert_eq!(lines.len(), 15, "7 settings, the switch, 7 settings");
    }
}
