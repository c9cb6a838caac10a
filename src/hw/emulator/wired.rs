//! The protocol of serial axis controllers around a world in the same process, without lines and
//! clock.
//!
//! - in, out: those of any [`Port`]. Orders and answers are encoded, judged, corrupted and lost as
//!   on lines.
//! - An answer describes the period before, as on lines, so the servo has one more period of delay
//!   than with the bare world.
//! - Runs are repeatable to the bit, including their faults, so whole missions run over the
//!   protocol in virtual time.

use super::faults::{Chance, LineFaults};
use super::sensor::COUNTS;
use super::{AxisController, status};
use crate::hw::force::{Intake, RdtRecord};
use crate::hw::port::{Port, PortFault};
use crate::hw::serial::axis::{Axis, Rules};
use crate::hw::serial::{axis_drive, write_reading};
use crate::motion::AXES;
use crate::servo::io::{ArmDrive, ArmReading};

/// Both ends of an arm's lines.
struct Arm {
    has_track: bool,
    axes: [Axis; AXES + 1],
    controllers: [AxisController; AXES + 1],
    intake: Intake,
    /// Number of periods in which no order reaches the axes and no answer comes back.
    stalled: u32,
}

/// A world behind the protocol.
pub struct Wired<P> {
    world: P,
    arms: Vec<Arm>,
    chance: Chance,
    drives: Vec<ArmDrive>,
    readings: Vec<ArmReading>,
    /// Whether the first exchange has settled the axes.
    begun: bool,
}

impl<P: Port> Wired<P> {
    /// Puts the protocol of serial axis controllers before `world`, a plant in the same process.
    /// `arms` says of each arm whether it has a track, and what the range of its force sensor is
    /// (N, Nm). `rules` say when a line is given up; `seed` is that of the random `faults`.
    pub fn new(
        world: P,
        arms: impl IntoIterator<Item = (bool, [f64; 6])>,
        rules: Rules,
        faults: LineFaults,
        seed: u64,
    ) -> Self {
        let arms: Vec<_> = arms
            .into_iter()
            .map(|(has_track, range)| Arm {
                has_track,
                axes: std::array::from_fn(|_| Axis::new(rules)),
                controllers: std::array::from_fn(|_| AxisController::default()),
                intake: Intake::new(range),
                stalled: 0,
            })
            .collect();
        let (drives, readings) =
            (vec![ArmDrive::OFF; arms.len()], vec![ArmReading::default(); arms.len()]);
        Self { world, arms, chance: Chance::new(faults, seed), drives, readings, begun: false }
    }

    /// Returns the plant behind the protocol.
    pub fn world(&self) -> &P {
        &self.world
    }

    /// Returns the plant behind the protocol, to observe or change it.
    pub fn world_mut(&mut self) -> &mut P {
        &mut self.world
    }

    /// Computes a period of the plant, under the motor drives that result from the orders to the
    /// controllers.
    fn step(&mut self, period: u64) -> Result<(), PortFault> {
        for (arm, drive) in self.arms.iter().zip(&mut self.drives) {
            *drive = super::drive(&arm.controllers, arm.has_track);
        }
        self.world.exchange(period, &self.drives, &mut self.readings)?;
        for (arm, reading) in self.arms.iter_mut().zip(&self.readings) {
            for (axis, controller) in arm.controllers.iter_mut().enumerate() {
                controller.latch(status(reading, axis));
            }
        }
        Ok(())
    }
}

impl Arm {
    /// Sends an order to each axis of the arm and processes the answer, which `chance` may spoil.
    /// Returns the fault of the first axis whose line must be given up.
    fn talk(
        &mut self,
        effector: usize,
        drive: &ArmDrive,
        chance: &mut Chance,
    ) -> Result<(), PortFault> {
        // An arm without a track has no axis 0.
        for index in usize::from(!self.has_track)..=AXES {
            let axis = &mut self.axes[index];
            // In virtual time no exchange is late: each order is sent one period after the order
            // before.
            axis.pass(1.0);
            let order = axis.order(&axis_drive(drive, index, &[u16::MAX; AXES + 1])).encode();
            // The bridge does not judge the lines of an arm that are all late together.
            if self.stalled > 0 {
                continue;
            }
            let controller = &mut self.controllers[index];
            let answer = order.iter().filter_map(|byte| controller.receive(*byte, 1.0)).last();
            let arrived = answer.and_then(|answer| chance.answer(answer.encode()));
            axis.take(arrived.as_ref()).map_err(|fault| PortFault {
                effector,
                reason: format!("axis {index}: {fault}"),
            })?;
        }
        Ok(())
    }
}

impl<P: Port> Port for Wired<P> {
    /// Sends the orders to the emulated controllers and judges their answers, then computes a
    /// period of the world. The readings show the world before that period.
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        // The first exchange settles every axis, while the world is at rest.
        if !self.begun {
            self.begun = true;
            self.step(0)?;
            // Each axis needs two parameters answered, then four readings that agree, and some may
            // be lost.
            for _ in 0..8 {
                for (effector, arm) in self.arms.iter_mut().enumerate() {
                    arm.talk(effector, &ArmDrive::OFF, &mut self.chance)?;
                }
            }
        }
        for (effector, (arm, reading)) in self.arms.iter_mut().zip(readings).enumerate() {
            // A new silence can only begin after the last one has ended.
            arm.stalled = match arm.stalled.saturating_sub(1) {
                0 => self.chance.stalls(),
                left => left,
            };
            arm.talk(effector, &drives[effector], &mut self.chance)?;
            write_reading(&arm.axes, arm.has_track, reading);
            let values = self.readings[effector].wrench_on_sensor.directions();
            // The wrench is treated like a real one: quantised, encoded, perhaps lost, decoded and
            // judged.
            let counts = values.map(|c| (c * COUNTS).round() as i32);
            let record = RdtRecord { sequence: 1, sample: 1, status: 0, counts }.encode();
            let came = (!self.chance.loses()).then(|| RdtRecord::decode(&record)).flatten();
            let wrench = came.map(|record| record.wrench(COUNTS, COUNTS));
            let (wrench, taken) = arm.intake.take(wrench);
            (reading.wrench_on_sensor, reading.wrench_is_old) = (wrench, !taken.is_new());
        }
        // The world moves on after the answers, hence the one period of delay.
        self.step(period)
    }
}

impl<P> std::fmt::Debug for Wired<P> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Wired").field("arms", &self.arms.len()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Axes that move a hundred increments per period, and the pulse widths that they received.
    struct Axes(Vec<i16>);

    impl Port for Axes {
        fn exchange(
            &mut self,
            period: u64,
            drives: &[ArmDrive],
            readings: &mut [ArmReading],
        ) -> Result<(), PortFault> {
            self.0.push(drives[0].pwm[2]);
            readings[0].counts = [100 * period as i64; AXES];
            Ok(())
        }
    }

    /// All axes of an arm fall silent together, each time for a multiple of 7 periods, and the
    /// motors keep their last pulse width meanwhile.
    #[test]
    fn silent_axes_keep_their_last_pulse_width() {
        let faults = LineFaults { stalled: 0.02, stall: 7, ..LineFaults::default() };
        let arm = (true, [100.0; 6]);
        let mut wired = Wired::new(Axes(Vec::new()), [arm], Rules::default(), faults, 3);
        let mut periods = Vec::new();
        for period in 1..=1000 {
            let drive =
                ArmDrive { enabled: true, pwm: [(period % 200) as i16; AXES], ..ArmDrive::OFF };
            let mut readings = [ArmReading::default()];
            wired.exchange(period, &[drive], &mut readings).unwrap();
            let [reading] = readings;
            assert!(reading.no_answer == 0 || reading.no_answer == u8::MAX, "all at once");
            let width = *wired.world().0.last().unwrap();
            periods.push((reading.no_answer != 0, width));
        }

        let parts: Vec<_> = periods.chunk_by(|a, b| a.0 == b.0).collect();
        // The answer to a parameter is no reading, so the mode of the first period looks silent. It
        // has no period before it.
        let stalls: Vec<_> = parts.windows(2).filter(|pair| pair[1][0].0).collect();
        assert!(stalls.len() > 5, "{}", stalls.len());
        for pair in stalls {
            let (before, stall) = (pair[0], pair[1]);
            assert_eq!(stall.len() % 7, 0, "{stall:?}");
            let (_, last) = before[before.len() - 1];
            assert!(last > 0 && stall.iter().take(7).all(|(_, width)| *width == last), "{stall:?}");
        }
    }
}
