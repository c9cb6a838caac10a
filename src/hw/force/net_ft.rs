//! An ATI Net F/T box, which streams datagrams (RDT) on request.
//!
//! - out: a request of 8 bytes to port 49152 of the box: 0x1234, the command, the number of records
//!   (0: without end)
//! - in: records of 36 bytes: the number of the record in this stream, the number of the box's
//!   sample, the status, and six components as counts, all big-endian
//! - the record's number shows lost and reordered datagrams; only the newest record is used
//! - source: the RDT protocol in ATI's manual of the Net F/T

use super::{ForceSource, Intake, Taken};
use crate::hw::note::{NoteKind, Notes};
use crate::spatial::Wrench;
use std::net::{SocketAddr, UdpSocket};

/// Length of a request (bytes).
pub const RDT_REQUEST: usize = 8;
/// Length of a record (bytes).
pub const RDT_RECORD: usize = 36;

/// Command that starts a stream of single records without end.
const START: u16 = 2;
/// Command that ends a stream.
const STOP: u16 = 0;
/// Largest number of records that are read in a period. The box sends 14 at its full rate of 7 kHz.
const MOST: usize = 64;
/// Silent periods after which the stream is requested again.
const AGAIN: u64 = 50;

/// Encodes a request to a Net F/T box. The `command` 2 starts a stream and 0 ends it; `count` is
/// the number of records that the box is to send, 0 for no end.
#[must_use]
pub fn request(command: u16, count: u32) -> [u8; RDT_REQUEST] {
    let [a, b] = command.to_be_bytes();
    let [c, d, e, f] = count.to_be_bytes();
    [0x12, 0x34, a, b, c, d, e, f]
}

/// Decodes a request at an emulated box: `true` starts a stream, `false` ends it, `None` is no
/// request.
#[must_use]
pub fn start_request(bytes: &[u8]) -> Option<bool> {
    let bytes: &[u8; RDT_REQUEST] = bytes.try_into().ok()?;
    match (u16::from_be_bytes([bytes[0], bytes[1]]), u16::from_be_bytes([bytes[2], bytes[3]])) {
        (0x1234, START) => Some(true),
        (0x1234, STOP) => Some(false),
        _ => None,
    }
}

/// A record of the stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RdtRecord {
    /// Number of the record in this stream.
    pub sequence: u32,
    /// Number of the box's own sample.
    pub sample: u32,
    /// Status word; 0 if the box reports no fault.
    pub status: u32,
    /// Forces x, y, z and torques about them (counts).
    pub counts: [i32; 6],
}

impl RdtRecord {
    /// Encodes the record for the network.
    #[must_use]
    pub fn encode(&self) -> [u8; RDT_RECORD] {
        let mut bytes = [0; RDT_RECORD];
        let words = [self.sequence, self.sample, self.status];
        let words = words.into_iter().chain(self.counts.map(|c| c as u32));
        for (slot, word) in bytes.chunks_exact_mut(4).zip(words) {
            slot.copy_from_slice(&word.to_be_bytes());
        }
        bytes
    }

    /// Decodes a record; `None` if there are not 36 bytes.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let bytes: &[u8; RDT_RECORD] = bytes.try_into().ok()?;
        let word = |i: usize| {
            u32::from_be_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]])
        };
        Some(Self {
            sequence: word(0),
            sample: word(1),
            status: word(2),
            counts: std::array::from_fn(|i| word(i + 3) as i32),
        })
    }

    /// Converts the counts to a wrench (N, Nm). The scales are in 1/N and 1/Nm.
    #[must_use]
    pub fn wrench(&self, counts_per_newton: f64, counts_per_newton_metre: f64) -> Wrench {
        Wrench::from_directions(std::array::from_fn(|i| {
            let scale = if i < 3 { counts_per_newton } else { counts_per_newton_metre };
            f64::from(self.counts[i]) / scale
        }))
    }
}

/// Detector of lost and late records by their numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sequence {
    /// Number of the newest record so far.
    last: Option<u32>,
}

/// Place of a record among the records before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Record that is newer than all records before it.
    Newer {
        /// Number of records between it and the newest one before, which are lost or still to come.
        missing: u32,
    },
    /// Record that is not newer.
    Late,
}

/// Difference of numbers below which a record belongs to a new stream, not to a late datagram.
const RESTART: i32 = -1000;

impl Sequence {
    /// Compares the number of a record, `sequence`, with the numbers before. Returns whether the
    /// record is newer, and how many are then missing in between.
    pub fn place(&mut self, sequence: u32) -> Order {
        // The wrapping difference keeps the order where the counter wraps.
        let ahead = self.last.map_or(1, |last| sequence.wrapping_sub(last) as i32);
        // A box that restarts counts from 1 again.
        if ahead <= 0 && ahead > RESTART && sequence != 1 {
            return Order::Late;
        }
        self.last = Some(sequence);
        Order::Newer { missing: ahead.saturating_sub(1).max(0) as u32 }
    }
}

/// Bit of the status: a threshold of the box was exceeded at some time. The bit lasts until it is
/// reset at the box, and does not impair the readings.
const LATCHED: u32 = 1 << 16;

/// A Net F/T box.
#[derive(Debug)]
pub struct NetFt {
    socket: UdpSocket,
    counts_per_newton: f64,
    counts_per_newton_metre: f64,
    sequence: Sequence,
    intake: Intake,
    /// First period of the last silence.
    silent_since: u64,
    /// Last status, so that a lasting one is reported once.
    status: u32,
}

impl NetFt {
    /// Opens a socket to the box and requests its stream of records. The scales are those of the
    /// box's own configuration page (1/N, 1/Nm), `range` is that of the sensor (N, Nm).
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn connect(
        address: SocketAddr,
        counts_per_newton: f64,
        counts_per_newton_metre: f64,
        range: [f64; 6],
    ) -> std::io::Result<Self> {
        let any: SocketAddr =
            if address.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0u16; 8], 0).into() };
        let socket = UdpSocket::bind(any)?;
        // A connected socket takes datagrams from this address alone.
        socket.connect(address)?;
        socket.set_nonblocking(true)?;
        socket.send(&request(START, 0))?;
        Ok(Self {
            socket,
            counts_per_newton,
            counts_per_newton_metre,
            sequence: Sequence::default(),
            intake: Intake::new(range),
            silent_since: 0,
            status: 0,
        })
    }

    /// Reads all records that have arrived and returns the newest one; `None` if none is newer than
    /// those of earlier periods. `notes` gets the lost and the reordered records.
    fn newest(&mut self, period: u64, effector: usize, notes: &mut Notes) -> Option<RdtRecord> {
        let mut newest = None;
        // One byte more than a record, so that a longer datagram is not cut to a valid one.
        let mut bytes = [0; RDT_RECORD + 1];
        for _ in 0..MOST {
            // Every error counts as a silence of the box, for example a closed port, which ICMP
            // reports.
            let Ok(length) = self.socket.recv(&mut bytes) else { break };
            let Some(record) = RdtRecord::decode(&bytes[..length]) else { continue };
            match self.sequence.place(record.sequence) {
                Order::Late => notes.push(period, effector, NoteKind::Reordered),
                Order::Newer { missing } => {
                    if missing > 0 {
                        notes.push(period, effector, NoteKind::Lost { datagrams: missing });
                    }
                    newest = Some(record);
                }
            }
        }
        newest
    }
}

impl ForceSource for NetFt {
    /// Takes the newest record that has arrived. Requests the stream again while the box is silent.
    fn read(&mut self, period: u64, effector: usize, notes: &mut Notes) -> (Wrench, bool) {
        let newest = self.newest(period, effector, notes);
        if let Some(record) = newest
            && record.status != self.status
        {
            self.status = record.status;
            if record.status & !LATCHED != 0 {
                notes.push(period, effector, NoteKind::ForceStatus { status: record.status });
            }
        }
        let (scale, torque_scale) = (self.counts_per_newton, self.counts_per_newton_metre);
        // The readings of a box that reports a fault are not valid.
        let good =
            newest.filter(|r| r.status & !LATCHED == 0).map(|r| r.wrench(scale, torque_scale));
        let (wrench, taken) = self.intake.take(good);
        push_note(taken, period, effector, notes);
        if let Taken::Silent { first } = taken {
            if first {
                self.silent_since = period;
            }
            // UDP does not confirm that the request arrived, and a box that restarts has lost its
            // stream.
            if period.wrapping_sub(self.silent_since).is_multiple_of(AGAIN) {
                let _ = self.socket.send(&request(START, 0));
            }
        }
        (wrench, taken.is_new())
    }
}

impl Drop for NetFt {
    fn drop(&mut self) {
        let _ = self.socket.send(&request(STOP, 0));
    }
}

/// Adds a note for the log if the reading of the period left its range, or if a silence of the
/// sensor began or ended.
pub(super) fn push_note(taken: Taken, period: u64, effector: usize, notes: &mut Notes) {
    match taken {
        Taken::OverRange { direction, reading } => {
            notes.push(period, effector, NoteKind::OverRange { direction, reading });
        }
        Taken::Silent { first: true } => notes.push(period, effector, NoteKind::ForceSilent),
        // The first reading ever, in period 0, ends no silence.
        Taken::Back if period > 0 => notes.push(period, effector, NoteKind::ForceBack),
        Taken::Fresh | Taken::Held | Taken::Back | Taken::Silent { first: false } => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::note::notes;
    use proptest::prelude::*;
    use std::time::Duration;

    const RANGE: [f64; 6] = [65.0, 65.0, 130.0, 5.0, 5.0, 5.0];

    proptest! {
        #[test]
        fn decoded_record_equals_encoded_record(
            words in any::<[u32; 3]>(), counts in any::<[i32; 6]>()
        ) {
            let [sequence, sample, status] = words;
            let record = RdtRecord { sequence, sample, status, counts };

            prop_assert_eq!(RdtRecord::decode(&record.encode()), Some(record));
        }
    }

    #[test]
    fn request_bytes_match_the_manual() {
        assert_eq!(request(2, 0), [0x12, 0x34, 0x00, 0x02, 0, 0, 0, 0]);
        assert_eq!(start_request(&request(2, 0)), Some(true));
        assert_eq!(start_request(&request(0, 0)), Some(false));
        assert_eq!(start_request(&[0x12, 0x34, 0, 2]), None);
    }

    /// The last two cases are those of a counter that wraps.
    #[test]
    fn sequence_number_shows_loss_lateness_and_restart() {
        let mut sequence = Sequence::default();

        for (number, wanted) in [
            (7, Order::Newer { missing: 0 }),
            (8, Order::Newer { missing: 0 }),
            (11, Order::Newer { missing: 2 }),
            (10, Order::Late),
            (11, Order::Late),
            (12, Order::Newer { missing: 0 }),
            (1, Order::Newer { missing: 0 }),
            (2, Order::Newer { missing: 0 }),
        ] {
            assert_eq!(sequence.place(number), wanted, "{number}");
        }
        let mut half_way = Sequence { last: Some(0) };
        assert_eq!(half_way.place(1 << 31), Order::Newer { missing: 0 });
        let mut wraps = Sequence { last: Some(u32::MAX) };
        assert_eq!(wraps.place(0), Order::Newer { missing: 0 });
        assert_eq!(wraps.place(u32::MAX), Order::Late);
    }

    /// Returns the bytes of a record with this force along z, at 10^6 counts/N.
    fn record(sequence: u32, newtons: i32) -> [u8; RDT_RECORD] {
        let counts = [0, 0, newtons * 1_000_000, 0, 0, 0];
        RdtRecord { sequence, sample: sequence, status: 0, counts }.encode()
    }

    #[test]
    fn sensor_reads_newest_of_reordered_datagrams() {
        let box_ = UdpSocket::bind("127.0.0.1:0").unwrap();
        box_.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let mut sensor = NetFt::connect(box_.local_addr().unwrap(), 1e6, 1e6, RANGE).unwrap();
        let (mut notes, mut told) = notes();
        let mut bytes = [0; 64];
        let (length, from) = box_.recv_from(&mut bytes).unwrap();
        assert_eq!(start_request(&bytes[..length]), Some(true));
        assert!(!sensor.read(1, 0, &mut notes).0.is_finite(), "no reading has arrived");

        for (sequence, newtons) in [(1, 1), (2, 2), (5, 5), (4, 4)] {
            box_.send_to(&record(sequence, newtons), from).unwrap();
        }
        box_.send_to(&[0; 20], from).unwrap();

        let mut wrench = sensor.read(2, 0, &mut notes);
        for _ in 0..100 {
            if wrench.0.force.z == 5.0 {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
            wrench = sensor.read(3, 0, &mut notes);
        }
        assert_eq!(wrench.0.force.z, 5.0);
        std::thread::sleep(Duration::from_millis(5));
        sensor.read(4, 0, &mut notes);
        let mut kinds = Vec::new();
        while let Ok(note) = told.pop() {
            kinds.push(note.what);
        }
        assert!(kinds.contains(&NoteKind::Lost { datagrams: 2 }), "{kinds:?}");
        assert!(kinds.contains(&NoteKind::Reordered), "{kinds:?}");
    }

    #[test]
    fn start_request_is_repeated_to_silent_sensor_box() {
        let box_ = UdpSocket::bind("127.0.0.1:0").unwrap();
        box_.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let mut sensor = NetFt::connect(box_.local_addr().unwrap(), 1e6, 1e6, RANGE).unwrap();
        let mut bytes = [0; 64];
        box_.recv_from(&mut bytes).unwrap();

        for period in 0..120 {
            sensor.read(period, 0, &mut Notes::none());
        }

        let (length, _) = box_.recv_from(&mut bytes).unwrap();
        assert_eq!(start_request(&bytes[..length]), Some(true));
    }
}
