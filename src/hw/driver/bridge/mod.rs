//! The bridge: a thread that owns the port, so that the servo thread never waits for a device.
//!
//! A ring carries the drive commands to the bridge, a triple buffer the latest readings back. The
//! exchange of period k takes place within that period, so its readings are there for period k + 1,
//! as on the virtual driver. The hook after each exchange, which may publish scenes, takes time of
//! this thread and never of the servo.
//!
//! - [`Bridge`]: the running thread, for the owner of the driver
//! - [`BridgePort`]: the servo's side
//! - `exchange`: the loop of the thread

mod drives;
mod exchange;
mod port;
#[cfg(test)]
mod tests;

pub use port::{BridgeLost, BridgePort};

use super::realtime::RealTime;
use crate::error::panic_text;
use crate::hw::port::{Port, PortFault};
use crate::servo::io::ArmReading;
use crate::servo::lateness::{MOST_ARMS, Readings};
use drives::Drives;
use exchange::Exchange;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

/// Number of periods whose drive commands the ring holds.
const RING: usize = 64;

/// The running bridge thread.
#[derive(Debug)]
pub struct Bridge<P> {
    thread: Option<JoinHandle<(P, Option<PortFault>)>>,
    /// Set at the end of the run: a port that failed no longer needs to repeat its stop.
    over: Arc<AtomicBool>,
}

impl<P: Port + 'static> Bridge<P> {
    /// Starts the bridge thread, under `SCHED_FIFO` at `priority` if the system allows it. Returns
    /// the thread's handle and the servo's side of the bridge.
    ///
    /// `first` are the readings of period 0, `length` is that of a period (ns). The thread calls
    /// `hook` after each exchange.
    ///
    /// # Errors
    /// The error of the operating system if the thread cannot be started.
    ///
    /// # Panics
    /// With more than four effectors.
    pub fn spawn(
        port: P,
        first: &[ArmReading],
        priority: i32,
        length: u64,
        hook: impl FnMut(u64, &mut P) + Send + 'static,
    ) -> std::io::Result<(Self, BridgePort)> {
        assert!(first.len() <= MOST_ARMS, "at most {MOST_ARMS} effectors");
        let mut start = Readings::default();
        start.arms[..first.len()].copy_from_slice(first);
        let (drives, incoming) = rtrb::RingBuffer::<Drives>::new(RING);
        let (outgoing, readings) = triple_buffer::triple_buffer(&start);
        let (broken, over) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
        let exchange = Exchange {
            port,
            hook,
            arms: first.len(),
            length,
            incoming,
            outgoing,
            latest: start,
            broken: Arc::clone(&broken),
            over: Arc::clone(&over),
        };
        let work = move || {
            // Rights that are denied here were denied to the servo too, which reports it.
            let _rights = RealTime::acquire(priority, None);
            exchange.run()
        };
        let thread = std::thread::Builder::new().name("bridge".into()).spawn(work)?;
        // The servo's side needs the thread's handle to wake it.
        let bridge = thread.thread().clone();
        let port = BridgePort::new(drives, readings, (broken, bridge), start, length);
        Ok((Self { thread: Some(thread), over }, port))
    }
}

impl<P> Bridge<P> {
    /// Ends the run and waits for the thread, which ends when the servo's side is dropped or the
    /// port has failed. Returns the port, and its fault if it failed.
    ///
    /// # Errors
    /// The text of the thread's panic.
    pub fn join(mut self) -> Result<(P, Option<PortFault>), String> {
        let thread = self.end().ok_or("the bridge thread was joined before")?;
        thread.join().map_err(|why| panic_text(&*why))
    }

    /// Marks the run as over, so that a port that failed no longer repeats its stop, and wakes the
    /// thread. Returns its handle, or `None` if it was taken before.
    fn end(&mut self) -> Option<JoinHandle<(P, Option<PortFault>)>> {
        self.over.store(true, Ordering::Release);
        let thread = self.thread.take()?;
        thread.thread().unpark();
        Some(thread)
    }
}

impl<P> Drop for Bridge<P> {
    fn drop(&mut self) {
        self.end();
    }
}
