//! Emulated force sensors: the box that streams datagrams, and the controller on a serial line.
//!
//! - in: requests; the wrench at the end of each period of the plant
//! - out: a datagram in each period, or the answer to each request

use super::faults::Chance;
use super::pty::Pty;
use crate::hw::force::{RdtRecord, encode_record, start_request};
use crate::spatial::Wrench;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};

/// Counts per newton, and per newton metre, of the emulated box: the default of ATI's boxes.
pub const COUNTS: f64 = 1e6;

/// A force sensor with its interface.
#[derive(Debug)]
pub(super) enum Sensor {
    Net(NetBox),
    Controller(Controller),
}

/// A Net F/T box, which streams datagrams to the client that started it last.
#[derive(Debug)]
pub(super) struct NetBox {
    socket: UdpSocket,
    address: SocketAddr,
    client: Option<SocketAddr>,
    sequence: u32,
    sample: u32,
    /// A datagram that is held back, to be sent after its successor.
    held: Option<RdtRecord>,
}

/// A stand-alone controller, which answers one request at a time.
#[derive(Debug)]
pub(super) struct Controller {
    pub(super) pty: Pty,
    wrench: Wrench,
}

impl Sensor {
    /// Opens a Net F/T box on a free UDP port of this machine.
    pub(super) fn net() -> std::io::Result<Self> {
        let socket = UdpSocket::bind("127.0.0.1:0")?;
        socket.set_nonblocking(true)?;
        let address = socket.local_addr()?;
        Ok(Self::Net(NetBox { socket, address, client: None, sequence: 0, sample: 0, held: None }))
    }

    /// Opens a controller on a pseudo-terminal.
    pub(super) fn controller() -> std::io::Result<Self> {
        Ok(Self::Controller(Controller { pty: Pty::open()?, wrench: Wrench::default() }))
    }

    /// Returns the interface and address of the sensor, as the key `force` of a devices file states
    /// them.
    pub(super) fn device(&self) -> String {
        match self {
            Self::Net(sensor) => format!("net_ft:{}", sensor.address),
            Self::Controller(sensor) => format!("ft_controller:{}", sensor.pty.path()),
        }
    }

    /// Reads the requests that have come, and answers those to a controller on a serial line,
    /// unless it is `silent`.
    pub(super) fn listen(&mut self, silent: bool) {
        match self {
            Self::Net(sensor) => {
                let mut bytes = [0; 64];
                while let Ok((length, from)) = sensor.socket.recv_from(&mut bytes) {
                    // Only the client that started the stream may stop it. Any other datagram is
                    // ignored.
                    match start_request(&bytes[..length]) {
                        Some(true) => {
                            (sensor.client, sensor.sequence) = (Some(from), 0);
                        }
                        Some(false) if sensor.client == Some(from) => sensor.client = None,
                        _ => {}
                    }
                }
            }
            Self::Controller(sensor) => {
                let mut bytes = [0; 64];
                let length = sensor.pty.read(&mut bytes);
                for byte in &bytes[..length] {
                    // A carriage return asks for the prompt, and 0x14 asks for one record.
                    let heard = match *byte {
                        _ if silent => true,
                        b'\r' => sensor.pty.write(b">"),
                        0x14 => sensor.pty.write(&encode_record(0, &sensor.wrench)),
                        _ => true,
                    };
                    if !heard {
                        tracing::debug!("no program reads the force controller's line");
                    }
                }
            }
        }
    }

    /// Stores the wrench at the end of a period of the plant. A Net F/T box sends it, unless the
    /// box is `silent`; `chance` may lose or reorder the datagram.
    pub(super) fn latch(&mut self, wrench: &Wrench, silent: bool, chance: &mut Chance) {
        match self {
            Self::Controller(sensor) => sensor.wrench = *wrench,
            Self::Net(sensor) => {
                sensor.sample = sensor.sample.wrapping_add(1);
                let Some(client) = sensor.client.filter(|_| !silent) else { return };
                // The client finds lost datagrams by gaps in the sequence, so a lost one counts as
                // well.
                sensor.sequence = sensor.sequence.wrapping_add(1);
                let counts = wrench.directions().map(|c| (c * COUNTS).round() as i32);
                let (sequence, sample) = (sensor.sequence, sensor.sample);
                let record = RdtRecord { sequence, sample, status: 0, counts };
                if chance.loses() {
                    return;
                }
                // At most one datagram is held back, so it is late by exactly one.
                if sensor.held.is_none() && chance.reorders() {
                    sensor.held = Some(record);
                    return;
                }
                // The box cannot know whether its client is still there.
                for record in [Some(record), sensor.held.take()].into_iter().flatten() {
                    let _ = sensor.socket.send_to(&record.encode(), client);
                }
            }
        }
    }
}

impl AsFd for Sensor {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Net(sensor) => sensor.socket.as_fd(),
            Self::Controller(sensor) => sensor.pty.as_fd(),
        }
    }
}
