//! Time of a message on a link and back, side by side: within the process, over zenoh, and over a
//! bare TCP connection, on the loopback of this machine.
//!
//! Each way carries what a run sends most: the state of an arm, as the link writes it. The ways
//! take turns, in rounds of [`ROUND`] messages, one every 2 ms, at rest and with a busy thread for
//! each core. A message without an answer in [`LOST`] counts as lost.
//!
//! - in: nothing
//! - out: a table: trips (p50, p99, most), lost messages, bytes per second of a run's states
//! - `cargo bench --features net --bench network`

#![allow(clippy::unwrap_used, reason = "a bench that cannot go on should stop loudly")]

use hdrhistogram::Histogram;
use rubik_robot::motion::ArmState;
use rubik_robot::net::{self, End, Lane, Link, Parcels};
use std::hint::black_box;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

/// Messages of a round.
const ROUND: usize = 500;
/// Rounds of each way, at rest and under load.
const ROUNDS: usize = 4;
/// Time after which a message counts as lost.
const LOST: Duration = Duration::from_secs(1);

/// Way of a message to the other end and back.
trait Echo {
    /// Sends a message and waits until it is back; `None` if it is lost.
    fn trip(&mut self, message: &[u8]) -> Option<Duration>;
}

/// Link whose other end sends each message back.
struct OverLink {
    link: Arc<dyn Link>,
    back: mpsc::Receiver<Vec<u8>>,
    /// Sessions that carry the link.
    sessions: Vec<net::Session>,
}

impl OverLink {
    /// Makes the way over both ends of a link.
    fn new(near: (Arc<dyn Link>, Parcels), far: (Arc<dyn Link>, Parcels)) -> Self {
        let (there, mut arrived) = far;
        thread::spawn(move || {
            while let Some((lane, parcel)) = arrived.blocking_recv() {
                there.send(lane, parcel);
            }
        });
        let (link, mut parcels) = near;
        let (arrive, back) = mpsc::channel();
        thread::spawn(move || {
            while let Some((_, parcel)) = parcels.blocking_recv() {
                if arrive.send(parcel).is_err() {
                    return;
                }
            }
        });
        Self { link, back, sessions: Vec::new() }
    }
}

impl Echo for OverLink {
    fn trip(&mut self, message: &[u8]) -> Option<Duration> {
        let sent = Instant::now();
        self.link.send(Lane::Messages, message.to_vec());
        self.back.recv_timeout(LOST).ok()?;
        Some(sent.elapsed())
    }
}

/// TCP connection whose other end sends each message back.
struct OverTcp(TcpStream);

impl OverTcp {
    /// Connects to an end that sends back what it gets.
    fn new() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream.set_nodelay(true).unwrap();
            let mut bytes = vec![0; 65536];
            while let Ok(count @ 1..) = stream.read(&mut bytes) {
                stream.write_all(&bytes[..count]).unwrap();
            }
        });
        let stream = TcpStream::connect(address).unwrap();
        stream.set_nodelay(true).unwrap();
        stream.set_read_timeout(Some(LOST)).unwrap();
        Self(stream)
    }
}

impl Echo for OverTcp {
    fn trip(&mut self, message: &[u8]) -> Option<Duration> {
        let (sent, mut back) = (Instant::now(), vec![0; message.len()]);
        self.0.write_all(message).unwrap();
        self.0.read_exact(&mut back).ok()?;
        Some(sent.elapsed())
    }
}

/// Opens both ends of a link over zenoh, on the loopback.
fn over_zenoh() -> OverLink {
    let endpoint = "tcp/127.0.0.1:17199";
    let far = net::open(&[endpoint], &[], None).unwrap();
    let near = net::open(&[], &[endpoint], None).unwrap();
    let ends = (near.link("bench", End::Home).unwrap(), far.link("bench", End::Node).unwrap());
    let mut way = OverLink::new(ends.0, ends.1);
    way.sessions = vec![near, far];
    // Until both sessions know of each other, messages are lost.
    while way.trip(b"ready").is_none() {}
    way
}

/// Result of a way.
struct Measured {
    name: &'static str,
    way: Box<dyn Echo>,
    /// Trips at rest and under load (ns).
    trips: [Histogram<u64>; 2],
    lost: [usize; 2],
}

fn main() {
    let [near, far] = net::pair();
    let ways: [(&str, Box<dyn Echo>); 3] = [
        ("in the process", Box::new(OverLink::new(near, far))),
        ("zenoh", Box::new(over_zenoh())),
        ("TCP", Box::new(OverTcp::new())),
    ];
    let mut ways = ways.map(|(name, way)| {
        let trips = [(), ()].map(|()| Histogram::new(3).unwrap());
        Measured { name, way, trips, lost: [0; 2] }
    });
    let message = rmp_serde::to_vec_named(&(0_u64, ArmState::default())).unwrap();
    for _ in 0..ROUNDS {
        for (i, loaded) in [false, true].into_iter().enumerate() {
            let load = Load::start(loaded);
            for measured in &mut ways {
                for _ in 0..ROUND {
                    match measured.way.trip(&message) {
                        Some(trip) => measured.trips[i].record(trip.as_nanos() as u64).unwrap(),
                        None => measured.lost[i] += 1,
                    }
                    thread::sleep(Duration::from_millis(2));
                }
            }
            load.end();
        }
    }
    println!("There and back with {} bytes, the state of an arm:\n", message.len());
    println!("| link | load | p50 | p99 | most | lost |\n|---|---|---|---|---|---|");
    for measured in &ways {
        for (i, load) in ["no", "a thread for each core"].into_iter().enumerate() {
            let us = |nanos: u64| nanos as f64 / 1e3;
            let trips = &measured.trips[i];
            let (p50, p99) = (trips.value_at_quantile(0.5), trips.value_at_quantile(0.99));
            println!(
                "| {} | {load} | {:.0} us | {:.0} us | {:.0} us | {} of {} |",
                measured.name,
                us(p50),
                us(p99),
                us(trips.max()),
                measured.lost[i],
                ROUND * ROUNDS
            );
        }
    }
}

/// Busy threads, one for each core.
struct Load(Arc<AtomicBool>, Vec<thread::JoinHandle<()>>);

impl Load {
    /// Starts the threads, or none.
    fn start(loaded: bool) -> Self {
        let (ends, cores) =
            (Arc::default(), thread::available_parallelism().map_or(1, usize::from));
        let busy = |ends: &Arc<AtomicBool>| {
            let ends = Arc::clone(ends);
            thread::spawn(move || {
                let mut work = 0_u64;
                while !ends.load(Ordering::Relaxed) {
                    work = black_box(work.wrapping_mul(6364136223846793005).wrapping_add(1));
                }
            })
        };
        let threads = (0..cores * usize::from(loaded)).map(|_| busy(&ends)).collect();
        Self(ends, threads)
    }

    /// Ends the threads.
    fn end(self) {
        self.0.store(true, Ordering::Relaxed);
        for thread in self.1 {
            thread.join().unwrap();
        }
    }
}
