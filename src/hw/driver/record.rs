//! Servo records: the inputs and outputs of one arm in one period.
//!
//! The records of a run suffice to replay its servos. Two runs are equal to the bit if the hashes
//! of their records are equal.

use crate::motion::{ArmState, Depth, Direction, Frame, Motion};
use crate::servo::ServoCommand;
use crate::servo::io::{ArmDrive, ArmReading, Outside};
use crate::spatial::{Pose, Wrench};

/// Record of one arm in one period. It has a fixed size and no pointers.
#[derive(Debug, Clone, Copy)]
pub struct ServoRecord {
    /// Number of the period.
    pub period: u64,
    /// Index of the effector.
    pub arm: u8,
    /// Reading at the beginning of the period.
    pub reading: ArmReading,
    /// Missed periods and stops. They are not part of the hash, since their effects are.
    pub outside: Outside,
    /// Command that the servo took in this period.
    pub command: Option<ServoCommand>,
    /// Commands to the drives.
    pub drive: ArmDrive,
    /// Published state.
    pub state: ArmState,
}

/// Receiver of servo records. The wall driver calls it on the real-time thread, where it must not
/// wait, lock or allocate.
pub trait RecordSink: Send {
    /// Receives the record of one arm and one servo period.
    fn record(&mut self, record: &ServoRecord);
}

/// Sink that drops all records.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoRecords;

impl RecordSink for NoRecords {
    fn record(&mut self, _: &ServoRecord) {}
}

/// A ring to another thread. A record that does not fit is dropped, because the caller cannot wait.
impl RecordSink for rtrb::Producer<ServoRecord> {
    fn record(&mut self, record: &ServoRecord) {
        let _ = self.push(*record);
    }
}

impl ServoRecord {
    /// Feeds the record to a hash in a fixed order of bytes: integers little-endian, floats by
    /// their bits.
    ///
    /// Recorded runs keep these hashes, so a change of the order, or of a number that marks the
    /// kind of a command, invalidates them.
    pub fn feed(&self, hash: &mut dyn FnMut(&[u8])) {
        let mut bytes = Bytes(hash);
        bytes.int(self.period);
        bytes.int(u64::from(self.arm));
        bytes.reading(&self.reading);
        bytes.command(self.command.as_ref());
        bytes.drive(&self.drive);
        bytes.state(&self.state);
    }
}

/// Encoder that feeds each value to a hash, as 8 bytes, little-endian.
struct Bytes<'a>(&'a mut dyn FnMut(&[u8]));

impl Bytes<'_> {
    fn int(&mut self, value: u64) {
        (self.0)(&value.to_le_bytes());
    }

    fn float(&mut self, value: f64) {
        self.int(value.to_bits());
    }

    /// Feeds each value by its bits; the number of values is not fed.
    fn floats(&mut self, values: &[f64]) {
        for value in values {
            self.float(*value);
        }
    }

    fn wrench(&mut self, wrench: &Wrench) {
        self.floats(&wrench.directions());
    }

    /// Feeds the translation (x, y, z), then the quaternion (i, j, k, w).
    fn pose(&mut self, pose: &Pose) {
        self.floats(pose.translation.vector.as_slice());
        self.floats(pose.rotation.coords.as_slice());
    }

    fn depth(&mut self, depth: Depth) {
        self.int(depth as u64);
    }

    /// Feeds the counters, currents, flags of the axes and the wrench. Marks of extrapolated or old
    /// values, and the inputs of the parallel interface, are left out: no motion depends on them.
    fn reading(&mut self, reading: &ArmReading) {
        for count in reading.counts {
            self.int(count as u64);
        }
        self.int(reading.jaw_count as u64);
        self.floats(&reading.currents);
        let bits = [
            reading.upper_limits,
            reading.lower_limits,
            reading.over_currents,
            reading.power_faults,
            reading.sync_switches,
            reading.encoder_zeros,
            reading.synchronised,
        ];
        // One byte for each of the seven masks: they fill 56 bits of the word.
        self.int(bits.iter().fold(0, |word, bits| word << 8 | u64::from(*bits)));
        self.wrench(&reading.wrench_on_sensor);
    }

    /// Feeds a number for the kind of the command, 0 for none, then the fields of the command.
    fn command(&mut self, command: Option<&ServoCommand>) {
        // The number keeps kinds apart whose fields have equal bytes. Numbers are given by hand,
        // not by the order of the variants, so a new variant changes no old hash.
        match command {
            None => self.int(0),
            Some(ServoCommand::Move { command, start }) => {
                self.int(1);
                self.int(*start);
                self.int(u64::from(command.periods));
                self.motion(&command.motion);
                if let Some(jaw) = &command.jaw {
                    self.floats(&[jaw.opening, jaw.force_limit]);
                    self.depth(jaw.stops);
                }
            }
            Some(ServoCommand::SetTool(pose)) => {
                self.int(2);
                self.pose(pose);
            }
            Some(ServoCommand::Bias) => self.int(3),
            Some(ServoCommand::Payload { weight, centre }) => {
                self.int(4);
                self.float(*weight);
                self.floats(centre.coords.as_slice());
            }
            Some(ServoCommand::ForceSettings(settings)) => {
                self.int(5);
                self.float(settings.sign);
                self.int(u64::from(settings.delay_periods));
            }
            Some(ServoCommand::Reset) => self.int(6),
            Some(ServoCommand::Synchronise) => self.int(7),
        }
    }

    /// Feeds a number for the kind of the motion, then its fields.
    fn motion(&mut self, motion: &Motion) {
        match motion {
            Motion::Hold => self.int(0),
            // The numbers 4 and 5 belong to the two frames of a task motion; 1 was that of a motion
            // to motor positions.
            Motion::MotorsBy(motors) => {
                self.int(6);
                self.floats(&motors.0);
            }
            Motion::Joints(joints) => {
                self.int(2);
                self.floats(&joints.0);
            }
            Motion::Pose(pose) => {
                self.int(3);
                self.pose(pose);
            }
            Motion::Task { frame, directions } => {
                self.int(4 + u64::from(*frame == Frame::Tool));
                for direction in directions {
                    match *direction {
                        Direction::Unguarded { velocity } => {
                            self.int(0);
                            self.float(velocity);
                        }
                        Direction::Guarded { velocity, admittance, inertia } => {
                            self.int(1);
                            self.floats(&[velocity, admittance, inertia]);
                        }
                        Direction::Contact { wanted, admittance, inertia } => {
                            self.int(2);
                            self.floats(&[wanted, admittance, inertia]);
                        }
                    }
                }
            }
        }
    }

    /// Feeds the commands to the drives: flags in one number, pulse widths, the palm's stops.
    fn drive(&mut self, drive: &ArmDrive) {
        self.int(u64::from(drive.enabled) | u64::from(drive.synchronise) << 8);
        for pwm in drive.pwm {
            self.int(pwm as u64);
        }
        self.int(drive.jaw_pwm as u64);
        self.depth(drive.stops);
    }

    /// Feeds the state of the arm to the hash. A fault or refusal counts by its presence alone: its
    /// kind follows from the rest of the record.
    fn state(&mut self, state: &ArmState) {
        self.floats(&state.desired_joints.0);
        self.pose(&state.base_from_tool);
        self.pose(&state.desired_base_from_tool);
        self.wrench(&state.wrench_in_tool);
        self.floats(&[state.jaw_opening, state.jaw_force]);
        self.int(state.command_end);
        self.int(u64::from(state.refused.is_some()) | u64::from(state.fault.is_some()) << 1);
    }
}
