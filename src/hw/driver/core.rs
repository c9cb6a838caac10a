//! One servo period of all arms, which both drivers of time call.
//!
//! - in: the switches, one command for each arm, the readings of the last exchange
//! - out: drives, published states, records
//! - all arms trip on the emergency stop, on a silence of the actors, on missed periods, and when
//!   the driver calls [`Core::trip`]; every other fault comes from the servo of one arm

use super::link::ServoEnd;
use super::record::{RecordSink, ServoRecord};
use crate::emergency_stop::StopSignal;
use crate::hw::port::{Port, PortFault};
use crate::motion::{ArmFault, MoveRefused};
use crate::servo::io::{ArmDrive, ArmReading, Outside};
use crate::servo::period::Length;
use crate::servo::{ArmServo, ServoCommand, ServoConfig};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Time without a heartbeat of the actors after which the servo brakes the arms. An actor that
/// waits for an arm learns of the braking at the end of the macrostep (16 ms), so it learns within
/// 0.1 s of the last heartbeat.
pub const HEARTBEAT_TIMEOUT: Duration = Duration::from_millis(80);

/// Flags that the servo reads in each period before any arm computes. Any holder may set them,
/// except `emergency`, which takes a [`StopButton`](crate::emergency_stop::StopButton).
#[derive(Debug, Default)]
pub struct Switches {
    /// Emergency stop: after a press all arms trip in the next period. Each must be reset
    /// afterwards.
    pub emergency: StopSignal,
    /// Order to end the driver.
    pub stop: AtomicBool,
    /// Set when an actor is lost: an arm under force control yields for 0.5 s, any other arm
    /// brakes. All arms then hold and refuse motions.
    pub hold: AtomicBool,
    /// Heartbeats of the actors. The servo watches them from the first one on: it brakes the arms
    /// after [`HEARTBEAT_TIMEOUT`] of silence and trips them after 1 s.
    pub beats: AtomicU64,
    /// Set while an arm in another process has stopped: all arms stand by, as the partner of a
    /// stopped arm does.
    pub stands_by: AtomicBool,
    /// Whether a fault stops an arm now.
    stopped: AtomicBool,
    /// Lateness of a wall driver while it runs.
    pub punctual: Punctual,
}

impl Switches {
    /// Makes switches whose emergency stop is `emergency`; all other flags are clear.
    #[must_use]
    pub fn new(emergency: StopSignal) -> Self {
        Self { emergency, ..Self::default() }
    }

    /// Sets the flag of a stopped arm, for tests.
    #[cfg(test)]
    pub(crate) fn stop_for_test(&self, stopped: bool) {
        self.stopped.store(stopped, Ordering::Release);
    }

    /// Returns whether a fault stops an arm now.
    #[must_use]
    pub fn has_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }
}

/// Lateness of a wall driver. The real-time thread writes it without waiting; any thread may read.
#[derive(Debug, Default)]
pub struct Punctual {
    /// Largest lateness of a period since the last [`Punctual::take`] (ns).
    late: AtomicU64,
    /// Longest work of a period since the last [`Punctual::take`] (ns).
    work: AtomicU64,
    /// Number of periods missed so far.
    missed: AtomicU64,
    /// Sum of the lengths of the missed periods (ns).
    missed_nanos: AtomicU64,
}

impl Punctual {
    /// Records how late a period began and how long its work took (ns).
    pub(super) fn note(&self, late: u64, work: u64) {
        self.late.fetch_max(late, Ordering::Relaxed);
        self.work.fetch_max(work, Ordering::Relaxed);
    }

    /// Adds `points` missed periods of this `length` (ns): points of the time grid that passed
    /// without a servo period.
    pub(crate) fn miss(&self, points: u64, length: u64) {
        self.missed.fetch_add(points, Ordering::Relaxed);
        self.missed_nanos.fetch_add(points * length, Ordering::Relaxed);
    }

    /// Returns how far the servo's periods lag behind the clock: the sum of all missed ones (ns).
    pub fn missed_nanos(&self) -> u64 {
        self.missed_nanos.load(Ordering::Relaxed)
    }

    /// Returns the largest lateness of a period and the longest work of a period since the last
    /// call (ns), and the number of all grid points missed so far.
    pub fn take(&self) -> (u64, u64, u64) {
        (
            self.late.swap(0, Ordering::Relaxed),
            self.work.swap(0, Ordering::Relaxed),
            self.missed.load(Ordering::Relaxed),
        )
    }
}

/// The servos of all arms with their inputs and outputs of one period.
pub struct Core {
    servos: Vec<ArmServo>,
    /// Index of the effector of each arm.
    effectors: Vec<u8>,
    ends: Vec<ServoEnd>,
    readings: Vec<ArmReading>,
    drives: Vec<ArmDrive>,
    /// Command of each arm in this period.
    commands: Vec<Option<ServoCommand>>,
    switches: Arc<Switches>,
    records: Box<dyn RecordSink>,
    /// Number of heartbeats at the last change of [`Switches::beats`], and the period of that
    /// change.
    last_beat: u64,
    last_beat_period: u64,
    /// Missed periods and stops that all arms take into account in the next period.
    outside: Outside,
    /// Period in which the braking arms trip, and the fault of that trip.
    stopping: Option<(u64, ArmFault)>,
    length: Length,
}

impl Core {
    /// Time from the beginning of a controlled stop to its trip (ns). Braking takes about 0.1 s.
    const BRAKING: u64 = 200_000_000;
    /// Time without a heartbeat after which the arms trip.
    const DEAD: Duration = Duration::from_secs(1);

    /// Builds the servos of all arms, and fetches their first readings in period 0 with all drives
    /// off.
    ///
    /// `ends` are the servos' ends of the links to the EDPs, one for each arm. All `configs` have
    /// the same length of a period.
    ///
    /// # Errors
    /// The fault of the port in the exchange of period 0.
    ///
    /// # Panics
    /// If the numbers of ends and configurations differ, which is a bug of the caller.
    pub fn new(
        configs: Vec<ServoConfig>,
        ends: Vec<ServoEnd>,
        switches: Arc<Switches>,
        records: Box<dyn RecordSink>,
        port: &mut dyn Port,
    ) -> Result<Self, PortFault> {
        assert_eq!(configs.len(), ends.len(), "one end for each arm");
        let length = configs.first().map_or_else(Length::default, |config| config.period);
        let drives = vec![ArmDrive::OFF; configs.len()];
        let mut readings = vec![ArmReading::default(); configs.len()];
        // A servo begins from measured positions, so the readings come before the servos.
        port.exchange(0, &drives, &mut readings)?;
        let commands = vec![None; configs.len()];
        let servos = configs
            .into_iter()
            .zip(&readings)
            .map(|(config, r)| ArmServo::new(config, r))
            .collect();
        let effectors = (0..commands.len()).map(|arm| arm as u8).collect();
        Ok(Self {
            servos,
            effectors,
            ends,
            readings,
            drives,
            commands,
            switches,
            records,
            last_beat: 0,
            last_beat_period: 0,
            outside: Outside::default(),
            stopping: None,
            length,
        })
    }

    /// Sets the indices of the effectors, for the records. Without it the arms are effectors 0, 1
    /// and so on; a node that has only some of them names these.
    #[must_use]
    pub fn of_effectors(mut self, effectors: &[usize]) -> Self {
        debug_assert_eq!(effectors.len(), self.servos.len(), "one index for each arm");
        self.effectors = effectors.iter().map(|&effector| effector as u8).collect();
        self
    }

    /// Computes period `period` and exchanges its drive commands with the port in the same thread.
    /// The readings of this exchange are the input of the next period.
    ///
    /// # Errors
    /// The fault of the port.
    pub fn period(&mut self, period: u64, port: &mut dyn Port) -> Result<(), PortFault> {
        self.compute(period);
        port.exchange(period, &self.drives, &mut self.readings)
    }

    /// Computes the drive commands of one period from the commands to the arms and the readings,
    /// and publishes the states. Returns the drive commands in the order of effectors. It allocates
    /// nothing and never waits.
    pub fn compute(&mut self, period: u64) -> &[ArmDrive] {
        debug_assert!(period >= self.last_beat_period, "periods count up");
        // Commands are taken before the button is read. In the other order, a reset that is sent
        // after the release of the button could be taken in a period that still saw the button
        // pressed, and would be dropped.
        for (command, end) in self.commands.iter_mut().zip(&mut self.ends) {
            *command = end.take();
        }
        let pressed = self.read_switches(period);
        let held = self.switches.hold.load(Ordering::Acquire)
            || self.switches.stands_by.load(Ordering::Acquire);
        let outside = std::mem::take(&mut self.outside);
        for arm in 0..self.servos.len() {
            // The partner of a stopped arm learns of the stop here, not by a message: both hands
            // may hold one cube, and a message takes longer than a period.
            let is_stopped = |servo: &ArmServo| outside.trip.is_some() || servo.fault().is_some();
            let stands_by =
                held || (0..self.servos.len()).any(|i| i != arm && is_stopped(&self.servos[i]));
            let outside = Outside { stands_by, ..outside };
            let servo = &mut self.servos[arm];
            // Stops come before the step: a trip acts on the drives of this very period. A servo
            // that trips itself in its step stops the arms after it now and those before it in the
            // next period.
            servo.apply_outside(period, &outside);
            let reading = self.readings[arm];
            // A reset must not undo the stop while the button is still pressed.
            let command = self.commands[arm].filter(|c| !(pressed && *c == ServoCommand::Reset));
            let (drive, state) = servo.step(period, &reading, command.as_ref());
            self.drives[arm] = drive;
            self.ends[arm].publish(&state);
            let arm = self.effectors[arm];
            let record = ServoRecord { period, arm, reading, outside, command, drive, state };
            self.records.record(&record);
        }
        let stopped = self.servos.iter().any(|servo| servo.fault().is_some());
        self.switches.stopped.store(stopped, Ordering::Release);
        &self.drives
    }

    /// Trips all arms in the next computed period with `fault`, unless another fault is already
    /// waiting to trip them.
    pub fn trip(&mut self, fault: ArmFault) {
        self.outside.trip.get_or_insert(fault);
    }

    /// Records that `missed` points of the time grid passed without a period. The arms kept moving
    /// under their last drive commands.
    pub fn add_missed_periods(&mut self, missed: u64) {
        self.outside.skipped += missed;
    }

    /// Brakes all arms because `periods` periods were missed before the period `period`, and trips
    /// them 0.2 s later.
    pub fn stop(&mut self, period: u64, periods: u64) {
        let fault = ArmFault::Missed { periods };
        self.outside.brake.get_or_insert(MoveRefused::Stopping { periods });
        // A later stop while the arms brake does not put off the trip.
        let _ = self.stopping.get_or_insert((period + Self::BRAKING / self.length.nanos(), fault));
    }

    /// Returns for each arm whether it is synchronised, in the order of effectors.
    pub fn synchronised(&self) -> impl Iterator<Item = bool> {
        self.servos.iter().map(ArmServo::is_synchronised)
    }

    /// Returns the flags by which other threads stop the arms.
    #[must_use]
    pub fn switches(&self) -> &Arc<Switches> {
        &self.switches
    }

    /// Returns the length of a period.
    #[must_use]
    pub fn length(&self) -> Length {
        self.length
    }

    /// Returns the number of arms.
    #[must_use]
    pub fn arms(&self) -> usize {
        self.servos.len()
    }

    /// Returns the latest readings, in the order of effectors.
    #[must_use]
    pub fn readings(&self) -> &[ArmReading] {
        &self.readings
    }

    /// Returns the buffer for the readings of the next period; a driver that fetches them itself
    /// writes them there.
    pub fn readings_mut(&mut self) -> &mut [ArmReading] {
        &mut self.readings
    }

    /// Checks the switches and the heartbeats of the actors, and records the stops that follow for
    /// this period. Returns whether the emergency stop is pressed.
    fn read_switches(&mut self, period: u64) -> bool {
        let pressed = self.switches.emergency.is_pressed();
        if pressed {
            self.trip(ArmFault::EmergencyStop);
        }
        match self.stopping {
            Some((at, fault)) if period >= at => {
                self.stopping = None;
                self.trip(fault);
            }
            // The brake is repeated in each period: a command that was sent before the stop must
            // not move an arm whose power is about to be switched off.
            Some((_, ArmFault::Missed { periods })) => {
                self.outside.brake.get_or_insert(MoveRefused::Stopping { periods });
            }
            _ => {}
        }
        let beat = self.switches.beats.load(Ordering::Relaxed);
        // No beat yet: the actors have not begun, so their silence is no fault.
        if beat != self.last_beat || beat == 0 {
            (self.last_beat, self.last_beat_period) = (beat, period);
        } else {
            // The silence counts in periods: actors that were stopped together with this machine
            // are not blamed for periods that the servo missed as well.
            let silence =
                Duration::from_nanos((period - self.last_beat_period) * self.length.nanos());
            if silence > Self::DEAD {
                self.trip(ArmFault::Heartbeat { seconds: silence.as_secs_f64() });
            } else if silence > HEARTBEAT_TIMEOUT {
                self.outside.brake.get_or_insert(MoveRefused::Aborted);
            }
        }
        pressed
    }
}

impl std::fmt::Debug for Core {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Core").field("arms", &self.servos.len()).finish_non_exhaustive()
    }
}
