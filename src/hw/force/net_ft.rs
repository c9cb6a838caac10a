//! An ATI Net F/T box: it streams datagrams (RDT) once it is asked to.
//!
//! - out: a request of 8 bytes: 0x1234, command, count of records (0: without end); port 49152 at the box
//! - in: records of 36 bytes: three counters (this stream's record, the box's sample, status) and six components as
//!   counts, all big-endian
//! - lost and reordered datagrams are found by the stream's counter; only what is newer than all before is used
//! - source: the RDT protocol as ATI's manual of the Net F/T has it

use super::{ForceSource, Intake, Taken};
use crate::hw::note::{Notes, What};
use crate::spatial::Wrench;
use std::net::{SocketAddr, UdpSocket};

/// Bytes of a request.
pub const RDT_REQUEST: usize = 8;
/// Bytes of a record.
pub const RDT_RECORD: usize = 36;

/// Starts a stream of single records without end.
const START: u16 = 2;
/// Ends it.
const STOP: u16 = 0;
/// Records that are read at most in a period: the box sends 14 at its full rate.
const MOST: usize = 64;
/// Silent periods after which the stream is asked for again.
const AGAIN: u64 = 50;

/// A request.
#[must_use]
pub fn request(command: u16, count: u32) -> [u8; RDT_REQUEST] {
    let [a, b] = command.to_be_bytes();
    let [c, d, e, f] = count.to_be_bytes();
    [0x12, 0x34, a, b, c, d, e, f]
}

/// What a box must do about these bytes: start a stream, end it; `None` for anything else.
#[must_use]
pub fn start_request(bytes: &[u8]) -> Option<bool> {
    let bytes: &[u8; RDT_REQUEST] = bytes.try_into().ok()?;
    match (u16::from_be_bytes([bytes[0], bytes[1]]), u16::from_be_bytes([bytes[2], bytes[3]])) {
        (0x1234, START) => Some(true),
        (0x1234, STOP) => Some(false),
        _ => None,
    }
}

/// A record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RdtRecord {
    /// Number in this stream.
    pub sequence: u32,
    /// Number of the box's own sample.
    pub sample: u32,
    /// 0 when all is well.
    pub status: u32,
    /// Forces x, y, z and torques about them (counts).
    pub counts: [i32; 6],
}

impl RdtRecord {
    /// As it goes over the network.
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

    /// The record of these bytes; `None` when there are not 36.
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

    /// The wrench of the counts.
    #[must_use]
    pub fn wrench(&self, counts_per_newton: f64, counts_per_newton_metre: f64) -> Wrench {
        Wrench::from_directions(std::array::from_fn(|i| {
            let scale = if i < 3 { counts_per_newton } else { counts_per_newton_metre };
            f64::from(self.counts[i]) / scale
        }))
    }
}

/// Which records are new, lost, late.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sequence {
    last: Option<u32>,
}

/// What the number of a record says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Newer than all before; so many are missing between.
    Newer {
        /// Lost, or still to come.
        missing: u32,
    },
    /// Not newer.
    Late,
}

/// Further back than this is a stream that has begun anew.
const RESTART: i32 = -1000;

impl Sequence {
    /// The place of a record among those before.
    pub fn place(&mut self, sequence: u32) -> Order {
        let ahead = self.last.map_or(1, |last| sequence.wrapping_sub(last) as i32);
        if ahead <= 0 && ahead > RESTART && sequence != 1 {
            return Order::Late;
        }
        self.last = Some(sequence);
        Order::Newer { missing: ahead.saturating_sub(1).max(0) as u32 }
    }
}

/// Bit of the status: a threshold set in the box was passed at some time. It stays until it is reset there, and the readings
/// are as good as ever.
const LATCHED: u32 = 1 << 16;

/// A Net F/T box.
#[derive(Debug)]
pub struct NetFt {
    socket: UdpSocket,
    counts_per_newton: f64,
    counts_per_newton_metre: f64,
    sequence: Sequence,
    intake: Intake,
    silent_since: u64,
    status: u32,
}

impl NetFt {
    /// Asks the box for its stream. Scales are in the box's own configuration page (1/N, 1/Nm).
    ///
    /// # Errors
    /// What the operating system says.
    pub fn connect(
        address: SocketAddr,
        counts_per_newton: f64,
        counts_per_newton_metre: f64,
        range: [f64; 6],
    ) -> std::io::Result<Self> {
        let any: SocketAddr =
            if address.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0u16; 8], 0).into() };
        let socket = UdpSocket::bind(any)?;
        // From here on nothing else gets in.
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

    /// The newest record that has come.
    fn newest(&mut self, period: u64, effector: usize, notes: &mut Notes) -> Option<RdtRecord> {
        let mut newest = None;
        let mut bytes = [0; RDT_RECORD + 1];
        for _ in 0..MOST {
            // An error is the box's silence, too: a closed port is told by ICMP.
            let Ok(length) = self.socket.recv(&mut bytes) else { break };
            let Some(record) = RdtRecord::decode(&bytes[..length]) else { continue };
            match self.sequence.place(record.sequence) {
                Order::Late => notes.tell(period, effector, What::Reordered),
                Order::Newer { missing } => {
                    if missing > 0 {
                        notes.tell(period, effector, What::Lost { datagrams: missing });
                    }
                    newest = Some(record);
                }
            }
        }
        newest
    }
}

impl ForceSource for NetFt {
    fn read(&mut self, period: u64, effector: usize, notes: &mut Notes) -> (Wrench, bool) {
        let newest = self.newest(period, effector, notes);
        if let Some(record) = newest
            && record.status != self.status
        {
            self.status = record.status;
            if record.status & !LATCHED != 0 {
                notes.tell(period, effector, What::ForceStatus { status: record.status });
            }
        }
        let (scale, torque_scale) = (self.counts_per_newton, self.counts_per_newton_metre);
        // What a box that reports a fault measures is worth nothing.
        let good =
            newest.filter(|r| r.status & !LATCHED == 0).map(|r| r.wrench(scale, torque_scale));
        let (wrench, taken) = self.intake.take(good);
        tell(taken, period, effector, notes);
        if let Taken::Silent { first } = taken {
            if first {
                self.silent_since = period;
            }
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

/// Notes what became of a reading.
pub(super) fn tell(taken: Taken, period: u64, effector: usize, notes: &mut Notes) {
    match taken {
        Taken::OverRange { direction, reading } => {
            notes.tell(period, effector, What::OverRange { direction, reading });
        }
        Taken::Silent { first: true } => notes.tell(period, effector, What::ForceSilent),
        Taken::Back if period > 0 => notes.tell(period, effector, What::ForceBack),
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
        fn every_record_comes_back_from_its_bytes(
            words in any::<[u32; 3]>(), counts in any::<[i32; 6]>()
        ) {
            let [sequence, sample, status] = words;
            let record = RdtRecord { sequence, sample, status, counts };

            prop_assert_eq!(RdtRecord::decode(&record.encode()), Some(record));
        }
    }

    #[test]
    fn the_request_is_the_manuals() {
        assert_eq!(request(2, 0), [0x12, 0x34, 0x00, 0x02, 0, 0, 0, 0]);
        assert_eq!(start_request(&request(2, 0)), Some(true));
        assert_eq!(start_request(&request(0, 0)), Some(false));
        assert_eq!(start_request(&[0x12, 0x34, 0, 2]), None);
    }

    #[test]
    fn lost_late_and_restarted_records_are_told_apart_even_where_the_counter_wraps() {
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

    fn record(sequence: u32, newtons: i32) -> [u8; RDT_RECORD] {
        let counts = [0, 0, newtons * 1_000_000, 0, 0, 0];
        RdtRecord { sequence, sample: sequence, status: 0, counts }.encode()
    }

    #[test]
    fn the_newest_of_a_disordered_stream_counts() {
        let box_ = UdpSocket::bind("127.0.0.1:0").unwrap();
        box_.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let mut sensor = NetFt::connect(box_.local_addr().unwrap(), 1e6, 1e6, RANGE).unwrap();
        let (mut notes, mut told) = notes();
        let mut bytes = [0; 64];
        let (length, from) = box_.recv_from(&mut bytes).unwrap();
        assert_eq!(start_request(&bytes[..length]), Some(true));
        assert!(!sensor.read(1, 0, &mut notes).0.is_finite(), "nothing has come");

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
        assert!(kinds.contains(&What::Lost { datagrams: 2 }), "{kinds:?}");
        assert!(kinds.contains(&What::Reordered), "{kinds:?}");
    }

    #[test]
    fn a_box_that_is_silent_is_asked_again() {
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
