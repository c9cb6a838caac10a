//! The protocol of serial axis controllers around a world in this process: no lines, no clock, every byte of it.
//!
//! - in, out: as any [`Port`]; orders and answers are encoded, judged, spoilt and lost as on lines
//! - an answer tells the period before, as on lines: a servo has one period more of delay than against the bare world
//! - repeatable to the bit, faults and all: whole missions can be tried over the protocol in virtual time

use super::faults::{Chance, LineFaults};
use super::sensor::COUNTS;
use super::{AxisController, status};
use crate::hw::force::{Intake, RdtRecord};
use crate::hw::port::{Port, PortFault};
use crate::hw::serial::axis::{Axis, Rules};
use crate::hw::serial::{axis_drive, hand_over};
use crate::motion::AXES;
use crate::servo::io::{ArmDrive, ArmReading};

/// Both ends of an arm's lines.
struct Arm {
    has_track: bool,
    axes: [Axis; AXES + 1],
    controllers: [AxisController; AXES + 1],
    intake: Intake,
    /// Periods for which nothing gets through to its axes or back.
    stalled: u32,
}

/// A world behind the protocol.
pub struct Wired<P> {
    world: P,
    arms: Vec<Arm>,
    chance: Chance,
    drives: Vec<ArmDrive>,
    readings: Vec<ArmReading>,
    begun: bool,
}

impl<P: Port> Wired<P> {
    /// Puts a world behind the protocol; each arm has a track or not, and a sensor of a range (N,
    /// Nm).
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

    /// The world.
    pub fn world(&self) -> &P {
        &self.world
    }

    /// The world, for whoever looks after it.
    pub fn world_mut(&mut self) -> &mut P {
        &mut self.world
    }

    /// The world's own period under the drives that the controllers make of their orders.
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
    /// One order to each axis and its answer.
    fn talk(
        &mut self,
        effector: usize,
        drive: &ArmDrive,
        chance: &mut Chance,
    ) -> Result<(), PortFault> {
        for index in usize::from(!self.has_track)..=AXES {
            let axis = &mut self.axes[index];
            axis.pass(1.0);
            let order = axis.order(&axis_drive(drive, index, &[u16::MAX; AXES + 1])).encode();
            // As where all lines of an arm are late together: none of them is judged.
            if self.stalled > 0 {
                continue;
            }
            let controller = &mut self.controllers[index];
            let answer = order.iter().filter_map(|byte| controller.hear(*byte, 1.0)).last();
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
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        // The first exchange settles every axis, in front of a world that stands still.
        if !self.begun {
            self.begun = true;
            self.step(0)?;
            for _ in 0..8 {
                for (effector, arm) in self.arms.iter_mut().enumerate() {
                    arm.talk(effector, &ArmDrive::OFF, &mut self.chance)?;
                }
            }
        }
        for (effector, (arm, reading)) in self.arms.iter_mut().zip(readings).enumerate() {
            arm.stalled = match arm.stalled.saturating_sub(1) {
                0 => self.chance.stalls(),
                left => left,
            };
            arm.talk(effector, &drives[effector], &mut self.chance)?;
            hand_over(&arm.axes, arm.has_track, reading);
            let felt = self.readings[effector].wrench_on_sensor.directions();
            let counts = felt.map(|c| (c * COUNTS).round() as i32);
            let record = RdtRecord { sequence: 1, sample: 1, status: 0, counts }.encode();
            let came = (!self.chance.loses()).then(|| RdtRecord::decode(&record)).flatten();
            let wrench = came.map(|record| record.wrench(COUNTS, COUNTS));
            let (wrench, taken) = arm.intake.take(wrench);
            (reading.wrench_on_sensor, reading.wrench_is_old) = (wrench, !taken.is_new());
        }
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

    /// Axes that go a hundred increments a period, and what they were told.
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

    #[test]
    fn axes_that_fall_silent_keep_their_last_width_and_are_not_heard_for_so_long() {
        let faults = LineFaults { stalled: 0.02, stall: 7, ..LineFaults::default() };
        let arm = (true, [100.0; 6]);
        let mut wired = Wired::new(Axes(Vec::new()), [arm], Rules::default(), faults, 3);
        let mut silent = Vec::new();
        for period in 1..=1000 {
            let drive =
                ArmDrive { enabled: true, pwm: [(period % 200) as i16; AXES], ..ArmDrive::OFF };
            let mut readings = [ArmReading::default()];
            wired.exchange(period, &[drive], &mut readings).unwrap();
            let [reading] = readings;
            assert!(reading.no_answer == 0 || reading.no_answer == u8::MAX, "all at once");
            let told = *wired.world().0.last().unwrap();
            silent.push((reading.no_answer != 0).then_some(told));
        }

        let stalls: Vec<_> = silent.chunk_by(|a, b| a.is_some() == b.is_some()).collect();
        // What answers the first parameter is no reading.
        let stalls = stalls.into_iter().filter(|stall| stall[0].is_some()).skip(1);
        let stalls: Vec<_> = stalls.collect();
        assert!(stalls.len() > 5, "{}", stalls.len());
        assert!(stalls.iter().all(|stall| stall.len() % 7 == 0), "{stalls:?}");
        let kept = |stall: &&[Option<i16>]| stall.iter().take(7).all(|told| *told == stall[0]);
        assert!(stalls.iter().all(kept), "{stalls:?}");
    }
}
