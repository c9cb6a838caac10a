//! Tests of the bridge thread, and of the servo's side without a thread.

use super::*;
use crate::servo::io::ArmDrive;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Length of a period (ns).
const LENGTH: u64 = 2_000_000;
/// Priority of the bridge's thread.
const PRIORITY: i32 = 6;

/// Makes the servo's side alone, with the buffer into which a bridge would write its readings.
fn port() -> (triple_buffer::Input<Readings>, BridgePort) {
    let (drives, _) = rtrb::RingBuffer::<Drives>::new(RING);
    let start = Readings::default();
    let (outgoing, readings) = triple_buffer::triple_buffer(&start);
    let link = (Arc::default(), std::thread::current());
    (outgoing, BridgePort::new(drives, readings, link, start, LENGTH))
}

/// Fetches the reading of the only arm for `period`.
fn fetch(port: &mut BridgePort, period: u64) -> Result<ArmReading, BridgeLost> {
    let mut readings = [ArmReading::default()];
    port.fetch(period, &mut readings).map(|()| readings[0])
}

#[test]
fn bridge_counts_as_lost_after_50_silent_periods() {
    let (mut bridge, mut servo) = port();
    for period in 1..=200 {
        bridge.write(Readings { period, ..Readings::default() });
        fetch(&mut servo, period + 2).unwrap();
    }
    assert_eq!(servo.late(), 200);

    let lost = (203..400).find(|period| fetch(&mut servo, *period).is_err());

    assert_eq!(lost, Some(203 + 50));
}

/// A port that fails at its second order to switch the drives off, like a line whose controller has
/// stopped by itself. It counts these orders.
#[derive(Default)]
struct Stopped(u32);

impl Port for Stopped {
    fn exchange(
        &mut self,
        _: u64,
        drives: &[ArmDrive],
        _: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        self.0 += u32::from(!drives[0].enabled);
        let reason = "in its error mode".to_owned();
        if self.0 < 2 { Ok(()) } else { Err(PortFault { effector: 0, reason }) }
    }
}

/// Returns the length of the stall that a fault's reason names (ms), or `None` if it names none.
fn stall(reason: &str) -> Option<u64> {
    let stall = reason.strip_prefix("in its error mode").unwrap();
    let stall = stall.strip_prefix("; before that this machine sent nothing for ")?;
    Some(stall.strip_suffix(" ms").unwrap().parse().unwrap())
}

/// The servo is silent for 200 ms before the first stop, and for as long before the second, at
/// which the port fails.
#[test]
fn fault_message_names_a_preceding_transmit_stall() {
    let first = [ArmReading::default()];
    let (bridge, mut servo) =
        Bridge::spawn(Stopped::default(), &first, PRIORITY, LENGTH, |_, _| ()).unwrap();
    let begun = Instant::now();
    servo.send(1, &[ArmDrive { enabled: true, ..ArmDrive::OFF }]);

    let fault = bridge.join().unwrap().1.unwrap();

    let (stall, all) = (stall(&fault.reason).unwrap(), begun.elapsed().as_millis() as u64);
    assert!((200..=all - 200).contains(&stall), "{stall} of {all} ms");
}

#[test]
fn fault_message_names_only_pauses_beyond_stall_limit() {
    let first = [ArmReading::default()];
    let fails_after = |pause: Duration| {
        let heard = Arc::new(AtomicBool::new(false));
        let hears = Arc::clone(&heard);
        let hook = move |_, _: &mut Stopped| hears.store(true, Ordering::Release);
        let (bridge, mut servo) =
            Bridge::spawn(Stopped::default(), &first, PRIORITY, LENGTH, hook).unwrap();
        let begun = Instant::now();
        servo.send(1, &[ArmDrive { enabled: true, ..ArmDrive::OFF }]);
        while !heard.load(Ordering::Acquire) {
            assert!(begun.elapsed() < Duration::from_secs(30), "the port gets no drives");
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(pause);
        servo.send(2, &[ArmDrive::OFF]);
        servo.send(3, &[ArmDrive::OFF]);
        let reason = bridge.join().unwrap().1.unwrap().reason;
        (stall(&reason), begun.elapsed().as_millis() as u64)
    };

    // The limit is 40 ms.
    let (said, lasted) = fails_after(Duration::from_millis(60));
    assert!(said.is_some_and(|said| (60..=lasted).contains(&said)), "{said:?} of {lasted} ms");
    // On a busy machine a pause may last longer than it should: such a case shows nothing.
    let mut short = (0..20).map(|_| fails_after(Duration::from_millis(25)));
    let short = short.find(|(_, lasted)| *lasted < 40);
    assert_eq!(short.and_then(|(said, _)| said), None);
}

#[test]
fn newer_drive_commands_keep_unsent_stop() {
    let on = ArmDrive { enabled: true, ..ArmDrive::OFF };
    let zero = ArmDrive { synchronise: 1 << 2, ..on };
    let of = |drive| Drives { period: 1, drives: [drive; MOST_ARMS] };

    assert!(!of(on).instead_of(&of(ArmDrive::OFF)).drives[0].enabled);
    assert!(!of(ArmDrive::OFF).instead_of(&of(on)).drives[0].enabled);
    assert!(of(on).instead_of(&of(on)).drives[0].enabled);
    for (newer, earlier) in [(on, zero), (zero, on)] {
        assert_eq!(of(newer).instead_of(&of(earlier)).drives[3].synchronise, 1 << 2);
    }
}

/// A port that records the time of each order, and whether the order enabled the drives.
#[derive(Clone, Default)]
struct Told(Arc<Mutex<Vec<(Instant, bool)>>>);

impl Port for Told {
    fn exchange(
        &mut self,
        _: u64,
        drives: &[ArmDrive],
        _: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        self.0.lock().unwrap().push((Instant::now(), drives[0].enabled));
        Ok(())
    }
}

#[test]
fn silent_or_dropped_servo_switches_drives_off() {
    let told = Told::default();
    let first = [ArmReading::default()];
    let (bridge, mut servo) =
        Bridge::spawn(told.clone(), &first, PRIORITY, LENGTH, |_, _| ()).unwrap();
    let on = ArmDrive { enabled: true, ..ArmDrive::OFF };
    // Waits for the order number `count` that switches the drives off, and returns its time.
    let off = |count: usize| {
        let begun = Instant::now();
        loop {
            let told = told.0.lock().unwrap();
            // A slow start is also a silence, so orders before the first drive do not count.
            let driven = told.iter().skip_while(|(_, on)| !on);
            let offs: Vec<_> = driven.filter(|(_, on)| !on).map(|(at, _)| *at).collect();
            if offs.len() >= count {
                return offs[count - 1];
            }
            drop(told);
            assert!(begun.elapsed() < Duration::from_secs(30), "the port gets no stop");
            std::thread::sleep(Duration::from_millis(5));
        }
    };

    let silent_since = Instant::now();
    servo.send(1, &[on]);
    // The first stop and each further one come after a silence of 200 ms. A busy machine may delay
    // some of them.
    let stops = [silent_since, off(1), off(2), off(3), off(4)];
    let silences = stops.windows(2).map(|stops| (stops[1] - stops[0]).as_millis());
    let silences: Vec<_> = silences.collect();
    assert!(silences.iter().all(|silence| *silence >= 200), "{silences:?} ms");
    assert!(silences.iter().any(|silence| *silence < 300), "{silences:?} ms");

    servo.send(2, &[on]);
    drop(servo);
    off(5);
    assert!(bridge.join().unwrap().1.is_none());
    assert!(told.0.lock().unwrap().last().is_some_and(|(_, on)| !on));
}
