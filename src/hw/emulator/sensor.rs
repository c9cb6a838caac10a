//! Force sensors, emulated: the box that streams datagrams, and the controller on a serial line.

use super::faults::Chance;
use super::pty::Pty;
use crate::hw::force::{RdtRecord, encode_record, start_request};
use crate::spatial::Wrench;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};

/// Counts a newton, and a newton metre, of the emulated box: what ATI's boxes come with.
pub const COUNTS: f64 = 1e6;

/// A force sensor with its interface.
#[derive(Debug)]
pub(super) enum Sensor {
    Net(NetBox),
    Controller(Controller),
}

/// A Net F/T box.
#[derive(Debug)]
pub(super) struct NetBox {
    socket: UdpSocket,
    address: SocketAddr,
    client: Option<SocketAddr>,
    sequence: u32,
    sample: u32,
    /// A record that its successor shall overtake.
    held: Option<RdtRecord>,
}

/// A stand-alone controller.
#[derive(Debug)]
pub(super) struct Controller {
    pub(super) pty: Pty,
    wrench: Wrench,
}

impl Sensor {
    pub(super) fn net() -> std::io::Result<Self> {
        let socket = UdpSocket::bind("127.0.0.1:0")?;
        socket.set_nonblocking(true)?;
        let address = socket.local_addr()?;
        Ok(Self::Net(NetBox { socket, address, client: None, sequence: 0, sample: 0, held: None }))
    }

    pub(super) fn controller() -> std::io::Result<Self> {
        Ok(Self::Controller(Controller { pty: Pty::open()?, wrench: Wrench::default() }))
    }

    /// What a file of devices says of it.
    pub(super) fn device(&self) -> String {
        match self {
            Self::Net(sensor) => format!("net_ft:{}", sensor.address),
            Self::Controller(sensor) => format!("ft_controller:{}", sensor.pty.path()),
        }
    }

    /// Takes what was asked.
    pub(super) fn listen(&mut self, silent: bool) {
        match self {
            Self::Net(sensor) => {
                let mut bytes = [0; 64];
                while let Ok((length, from)) = sensor.socket.recv_from(&mut bytes) {
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
                    let heard = match *byte {
                        _ if silent => true,
                        b'\r' => sensor.pty.write(b">"),
                        0x14 => sensor.pty.write(&encode_record(0, &sensor.wrench)),
                        _ => true,
                    };
                    if !heard {
                        tracing::debug!("nobody reads the force controller's line");
                    }
                }
            }
        }
    }

    /// The end of a plant's period.
    pub(super) fn latch(&mut self, wrench: &Wrench, silent: bool, chance: &mut Chance) {
        match self {
            Self::Controller(sensor) => sensor.wrench = *wrench,
            Self::Net(sensor) => {
                sensor.sample = sensor.sample.wrapping_add(1);
                let Some(client) = sensor.client.filter(|_| !silent) else { return };
                sensor.sequence = sensor.sequence.wrapping_add(1);
                let counts = wrench.directions().map(|c| (c * COUNTS).round() as i32);
                let (sequence, sample) = (sensor.sequence, sensor.sample);
                let record = RdtRecord { sequence, sample, status: 0, counts };
                if chance.loses() {
                    return;
                }
                if sensor.held.is_none() && chance.reorders() {
                    sensor.held = Some(record);
                    return;
                }
                // A client that is gone is no concern of the box.
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
