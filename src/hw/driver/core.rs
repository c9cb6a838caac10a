//! One servo period of all arms: the same code under both drivers of time.

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

/// Time without a heart beat of the actors after which the arms are brought to a stand: whoever waits for them hears of it by
/// the end of the macrostep, within 0.1 s.
pub const HEART: Duration = Duration::from_millis(80);

/// Flags that the servo reads first in each period. Any holder may set them but `emergency`, which
/// takes a [`StopButton`](crate::emergency_stop::StopButton).
#[derive(Debug, Default)]
pub struct Switches {
    /// The emergency stop: when it is pressed, all arms trip in the next period. Each must be reset
    /// afterwards.
    pub emergency: StopSignal,
    /// Ends the driver.
    pub stop: AtomicBool,
    /// An actor is gone: all arms yield or stand, hold, and take no motion.
    pub hold: AtomicBool,
    /// Counted up by the actors while they live. Watched from the first count on: after [`HEART`] of silence the
    /// arms are brought to a stand and hold, after 1 s they stop.
    pub beats: AtomicU64,
    /// What a wall driver tells of itself while it runs.
    pub punctual: Punctual,
}

impl Switches {
    /// Returns the flags of servos that stop when `emergency` is pressed.
    #[must_use]
    pub fn new(emergency: StopSignal) -> Self {
        Self { emergency, ..Self::default() }
    }
}

/// How punctual a wall driver is: the real-time thread writes without waiting, anyone may read.
#[derive(Debug, Default)]
pub struct Punctual {
    late: AtomicU64,
    work: AtomicU64,
    missed: AtomicU64,
    missed_nanos: AtomicU64,
}

impl Punctual {
    /// A period began this late and worked this long (ns).
    pub(super) fn note(&self, late: u64, work: u64) {
        self.late.fetch_max(late, Ordering::Relaxed);
        self.work.fetch_max(work, Ordering::Relaxed);
    }

    /// Grid points passed without a period of this length (ns).
    pub(crate) fn miss(&self, points: u64, length: u64) {
        self.missed.fetch_add(points, Ordering::Relaxed);
        self.missed_nanos.fetch_add(points * length, Ordering::Relaxed);
    }

    /// By how much the servo's periods lag behind the clock for all that was missed (ns).
    pub fn missed_nanos(&self) -> u64 {
        self.missed_nanos.load(Ordering::Relaxed)
    }

    /// The largest lateness and work since the last call (ns), and all missed grid points.
    pub fn take(&self) -> (u64, u64, u64) {
        (
            self.late.swap(0, Ordering::Relaxed),
            self.work.swap(0, Ordering::Relaxed),
            self.missed.load(Ordering::Relaxed),
        )
    }
}

/// The servos of all arms with what they need in each period.
pub struct Core {
    servos: Vec<ArmServo>,
    ends: Vec<ServoEnd>,
    readings: Vec<ArmReading>,
    drives: Vec<ArmDrive>,
    /// What each arm is told in this period.
    commands: Vec<Option<ServoCommand>>,
    switches: Arc<Switches>,
    records: Box<dyn RecordSink>,
    last_beat: u64,
    last_beat_period: u64,
    /// What all arms heed in the next period.
    outside: Outside,
    /// When the arms stop, and why.
    stopping: Option<(u64, ArmFault)>,
    length: Length,
}

impl Core {
    /// From a controlled stop's beginning to its end (ns).
    const STAND: u64 = 200_000_000;
    /// Time without a heart beat after which they stop.
    const DEAD: Duration = Duration::from_secs(1);

    /// Fetches the first readings in period 0 with all drives off; `ends` has an end for each arm.
    ///
    /// # Errors
    /// What the port says.
    ///
    /// All configurations have periods of one length.
    ///
    /// # Panics
    /// When there are not as many ends as configurations: a mistake of ours.
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
        port.exchange(0, &drives, &mut readings)?;
        let commands = vec![None; configs.len()];
        let servos = configs
            .into_iter()
            .zip(&readings)
            .map(|(config, r)| ArmServo::new(config, r))
            .collect();
        Ok(Self {
            servos,
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

    /// Period `period` in line with its port: [`Core::compute`], then the exchange, whose readings count in
    /// the next period.
    ///
    /// # Errors
    /// What the port says; the readings then stay as they were.
    pub fn period(&mut self, period: u64, port: &mut dyn Port) -> Result<(), PortFault> {
        self.compute(period);
        port.exchange(period, &self.drives, &mut self.readings)
    }

    /// Commands and readings to drives. Allocates nothing and never waits.
    pub fn compute(&mut self, period: u64) -> &[ArmDrive] {
        debug_assert!(period >= self.last_beat_period, "periods count up");
        // Before the switches: a reset that was sent when the button was free again would find it pressed.
        for (command, end) in self.commands.iter_mut().zip(&mut self.ends) {
            *command = end.take();
        }
        let pressed = self.heed_switches(period);
        let held = self.switches.hold.load(Ordering::Acquire);
        let outside = std::mem::take(&mut self.outside);
        for arm in 0..self.servos.len() {
            // Below the actors: what joins the arms may be in both hands, and no message is faster than a period.
            let is_stopped = |servo: &ArmServo| outside.trip.is_some() || servo.fault().is_some();
            let stands_by =
                held || (0..self.servos.len()).any(|i| i != arm && is_stopped(&self.servos[i]));
            let outside = Outside { stands_by, ..outside };
            let servo = &mut self.servos[arm];
            servo.heed(period, &outside);
            let reading = self.readings[arm];
            // A reset must not undo the stop while the button is still pressed.
            let command = self.commands[arm].filter(|c| !(pressed && *c == ServoCommand::Reset));
            let (drive, state) = servo.step(period, &reading, command.as_ref());
            self.drives[arm] = drive;
            self.ends[arm].publish(&state);
            let arm = arm as u8;
            let record = ServoRecord { period, arm, reading, outside, command, drive, state };
            self.records.record(&record);
        }
        &self.drives
    }

    /// Stops all arms in the next period until they are reset.
    pub fn trip(&mut self, fault: ArmFault) {
        self.outside.trip.get_or_insert(fault);
    }

    /// Grid points have passed without a period: the arms went on meanwhile, under their last drives.
    pub fn skipped(&mut self, missed: u64) {
        self.outside.skipped += missed;
    }

    /// So many periods were missed that all arms are brought to a stand, and stopped there 0.2 s later.
    pub fn stop(&mut self, period: u64, periods: u64) {
        let fault = ArmFault::Missed { periods };
        self.outside.brake.get_or_insert(MoveRefused::Stopping { periods });
        let _ = self.stopping.get_or_insert((period + Self::STAND / self.length.nanos(), fault));
    }

    /// Arms that know where they are, in the order of effectors.
    pub fn synchronised(&self) -> impl Iterator<Item = bool> {
        self.servos.iter().map(ArmServo::is_synchronised)
    }

    /// The flags.
    #[must_use]
    pub fn switches(&self) -> &Arc<Switches> {
        &self.switches
    }

    /// Length of a period.
    #[must_use]
    pub fn length(&self) -> Length {
        self.length
    }

    /// Number of arms.
    #[must_use]
    pub fn arms(&self) -> usize {
        self.servos.len()
    }

    /// The latest readings, in the order of effectors.
    #[must_use]
    pub fn readings(&self) -> &[ArmReading] {
        &self.readings
    }

    /// Where the readings of the next period go, for a driver that fetches them itself.
    pub fn readings_mut(&mut self) -> &mut [ArmReading] {
        &mut self.readings
    }

    /// Returns whether the emergency stop is pressed.
    fn heed_switches(&mut self, period: u64) -> bool {
        let pressed = self.switches.emergency.is_pressed();
        if pressed {
            self.trip(ArmFault::EmergencyStop);
        }
        match self.stopping {
            Some((at, fault)) if period >= at => {
                self.stopping = None;
                self.trip(fault);
            }
            // A command that was on its way already must not move an arm whose power is about to go.
            Some((_, ArmFault::Missed { periods })) => {
                self.outside.brake.get_or_insert(MoveRefused::Stopping { periods });
            }
            _ => {}
        }
        let beat = self.switches.beats.load(Ordering::Relaxed);
        if beat != self.last_beat || beat == 0 {
            (self.last_beat, self.last_beat_period) = (beat, period);
        } else {
            let silence =
                Duration::from_nanos((period - self.last_beat_period) * self.length.nanos());
            if silence > Self::DEAD {
                self.trip(ArmFault::HeartBeat { seconds: silence.as_secs_f64() });
            } else if silence > HEART {
                self.outside.brake.get_or_insert(MoveRefused::BrokenOff);
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
