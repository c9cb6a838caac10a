//! Servo tick: the message of one arm in one servo period, and the comparison of two ticks.
//!
//! - in: a [`ServoRecord`]; or the bytes of a message
//! - out: the bytes; or a [`Tick`], which holds all inputs of the servo in that period; or the
//!   first [`Difference`] of two ticks

use super::cdr::{Malformed, Reader, Writer};
use crate::hw::driver::ServoRecord;
use crate::motion::Depth;
use crate::servo::ServoCommand;
use crate::servo::io::{ArmDrive, ArmReading, Outside};
use crate::spatial::Wrench;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;
use std::hash::{DefaultHasher, Hasher};

/// Servo tick of a recording: what one servo read, got and sent in one servo period.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// Number of the servo period.
    pub period: u64,
    /// Index of the effector.
    pub arm: u8,
    /// Readings of the arm's port: encoders, currents, switches, force sensor.
    pub reading: ArmReading,
    /// Inputs besides reading and command ([`Outside`]) as JSON; empty if there were none.
    pub outside: String,
    /// Command of the EDP as JSON; empty if there was none.
    pub command: String,
    /// Commands to the drives.
    pub drive: ArmDrive,
    /// Measured joint positions (m or rad).
    pub joints: [f64; 7],
    /// Set joint positions (m or rad).
    pub desired_joints: [f64; 7],
    /// Wrench that the tool exerts on its surroundings, in its own axes (N, Nm).
    pub wrench_in_tool: Wrench,
    /// Distance between the pads (m).
    pub jaw_opening: f64,
    /// Force of the jaws (N).
    pub jaw_force: f64,
    /// Reason why the servo refused its latest command; empty if it did not.
    pub refused: String,
    /// Reason why the arm stopped; empty if it did not.
    pub fault: String,
    /// Hash over readings, command, drives and state. The state includes the poses, which are not
    /// in the message.
    pub check: u64,
}

/// Field in which a recorded tick and the same tick of a replay differ.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Name of the field as in the definition of `ServoTick`, with the index in an array or the
    /// path in a command.
    pub field: String,
    /// Value in the recording.
    pub recorded: String,
    /// Value of the present run.
    pub now: String,
}

/// Encodes a servo record as a message `ServoTick` with the time stamp `stamp` (ns).
pub fn write(record: &ServoRecord, stamp: u64, to: &mut Writer) {
    let ServoRecord { reading, drive, state, .. } = record;
    // The order is that of `ServoTick` in the schema; `Tick::read` must follow it.
    to.time(stamp);
    to.u64(record.period);
    to.u8(record.arm);
    for count in reading.counts {
        to.i64(count);
    }
    to.i64(reading.jaw_count);
    to.f64s(&reading.currents);
    for bits in [
        reading.upper_limits,
        reading.lower_limits,
        reading.over_currents,
        reading.power_faults,
        reading.sync_switches,
        reading.encoder_zeros,
        reading.synchronised,
        reading.extrapolated,
        reading.no_answer,
    ] {
        to.u8(bits);
    }
    to.f64s(&reading.wrench_on_sensor.directions());
    to.bool(reading.wrench_is_old);
    to.string(&further_text(record));
    to.string(&command_text(record.command.as_ref()));
    to.bool(drive.enabled);
    for pwm in drive.pwm {
        to.i16(pwm);
    }
    to.i16(drive.jaw_pwm);
    to.u8(depth_number(drive.stops));
    to.u8(drive.synchronise);
    // The state is an output of the servo. A replay compares it; the report draws it.
    to.f64s(&state.joints.0);
    to.f64s(&state.desired_joints.0);
    to.f64s(&state.wrench_in_tool.directions());
    to.f64(state.jaw_opening);
    to.f64(state.jaw_force);
    to.string(&state.refused.map_or_else(String::new, |why| why.to_string()));
    to.string(&state.fault.map_or_else(String::new, |why| why.to_string()));
    to.u64(check(record));
}

/// Returns a command to the servo as JSON; an empty text if there is none.
fn command_text(command: Option<&ServoCommand>) -> String {
    command.map_or_else(String::new, |c| serde_json::to_string(c).unwrap_or_default())
}

/// Further inputs of a servo period as a recording has them. The binary inputs joined them later
/// than the others: an older recording has none.
#[derive(Serialize, Deserialize)]
struct Further {
    #[serde(flatten)]
    outside: Outside,
    /// Binary inputs of the parallel interface.
    #[serde(default, skip_serializing_if = "is_zero")]
    inputs: u16,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(inputs: &u16) -> bool {
    *inputs == 0
}

/// Returns the further inputs of a servo period as JSON; an empty text if there were none.
fn further_text(record: &ServoRecord) -> String {
    let further = Further { outside: record.outside, inputs: record.reading.inputs };
    // Nearly all periods have the default. An empty text saves space at 500 Hz.
    if further.outside == Outside::default() && is_zero(&further.inputs) {
        return String::new();
    }
    serde_json::to_string(&further).unwrap_or_default()
}

/// Returns the binary inputs in the text of the further inputs; 0 if it has none.
fn inputs_in(text: &str) -> u16 {
    let further = |text| serde_json::from_str::<Further>(text).ok();
    // Most texts are empty.
    if text.is_empty() { 0 } else { further(text).map_or(0, |further| further.inputs) }
}

fn depth_number(depth: Depth) -> u8 {
    match depth {
        Depth::One => 1,
        Depth::Two => 2,
    }
}

/// Returns a hash over the readings, the command, the drives and the state of a servo record.
fn check(record: &ServoRecord) -> u64 {
    let mut hasher = DefaultHasher::new();
    record.feed(&mut |bytes| hasher.write(bytes));
    hasher.finish()
}

impl Tick {
    /// Decodes a message `ServoTick`.
    ///
    /// # Errors
    /// `Malformed` if the bytes are no message `ServoTick`.
    pub fn read(bytes: &[u8]) -> Result<Self, Malformed> {
        let mut from = Reader::new(bytes)?;
        // The stamp follows from the period.
        from.time()?;
        let (period, arm) = (from.u64()?, from.u8()?);
        let mut reading = ArmReading::default();
        for count in &mut reading.counts {
            *count = from.i64()?;
        }
        reading.jaw_count = from.i64()?;
        reading.currents = from.f64s()?;
        for bits in [
            &mut reading.upper_limits,
            &mut reading.lower_limits,
            &mut reading.over_currents,
            &mut reading.power_faults,
            &mut reading.sync_switches,
            &mut reading.encoder_zeros,
            &mut reading.synchronised,
            &mut reading.extrapolated,
            &mut reading.no_answer,
        ] {
            *bits = from.u8()?;
        }
        reading.wrench_on_sensor = Wrench::from_directions(from.f64s()?);
        reading.wrench_is_old = from.bool()?;
        // Both texts are parsed when they are used: most readers need only the numbers.
        let outside = from.string()?.to_owned();
        reading.inputs = inputs_in(&outside);
        let command = from.string()?.to_owned();
        let mut drive = ArmDrive { enabled: from.bool()?, ..ArmDrive::OFF };
        for pwm in &mut drive.pwm {
            *pwm = from.i16()?;
        }
        drive.jaw_pwm = from.i16()?;
        drive.stops = match from.u8()? {
            1 => Depth::One,
            2 => Depth::Two,
            _ => return Err(Malformed),
        };
        drive.synchronise = from.u8()?;
        // Field expressions are evaluated in the order in which they are written here, which is
        // that of the message.
        Ok(Self {
            period,
            arm,
            reading,
            outside,
            command,
            drive,
            joints: from.f64s()?,
            desired_joints: from.f64s()?,
            wrench_in_tool: Wrench::from_directions(from.f64s()?),
            jaw_opening: from.f64()?,
            jaw_force: from.f64()?,
            refused: from.string()?.to_owned(),
            fault: from.string()?.to_owned(),
            check: from.u64()?,
        })
    }

    /// Returns the tick that a recording holds for this servo record, without encoding it.
    #[must_use]
    pub fn of(record: &ServoRecord) -> Self {
        let state = &record.state;
        Self {
            period: record.period,
            arm: record.arm,
            reading: record.reading,
            outside: further_text(record),
            command: command_text(record.command.as_ref()),
            drive: record.drive,
            joints: state.joints.0,
            desired_joints: state.desired_joints.0,
            wrench_in_tool: state.wrench_in_tool,
            jaw_opening: state.jaw_opening,
            jaw_force: state.jaw_force,
            refused: state.refused.map_or_else(String::new, |why| why.to_string()),
            fault: state.fault.map_or_else(String::new, |why| why.to_string()),
            check: check(record),
        }
    }

    /// Returns what acted on the servo in this period besides reading and command, for example
    /// missed periods or a stop and its reason.
    ///
    /// # Errors
    /// The recorded text if it is no [`Outside`].
    pub fn outside(&self) -> Result<Outside, String> {
        if self.outside.is_empty() {
            return Ok(Outside::default());
        }
        serde_json::from_str(&self.outside).map_err(|_| self.outside.clone())
    }

    /// Returns the command of the EDP (effector driver process) in this period; `None` if there
    /// was none.
    ///
    /// # Errors
    /// The recorded text if it is no command.
    pub fn order(&self) -> Result<Option<ServoCommand>, String> {
        if self.command.is_empty() {
            return Ok(None);
        }
        serde_json::from_str(&self.command).map(Some).map_err(|_| self.command.clone())
    }

    /// Returns the first field, in the order of the message, in which this recorded tick differs
    /// from the tick `now`: readings, further inputs, command, drives, then the state. Floating
    /// point numbers are compared by their bits. `None` if the ticks are equal.
    #[must_use]
    pub fn difference(&self, now: &Self) -> Option<Difference> {
        // A comparison of values would find NaN different from itself, and -0 equal to 0.
        let bits = f64::to_bits;
        let wrench = |w: &Wrench| w.directions();
        let (a, b) = (&self.reading, &now.reading);
        each("counts", &a.counts, &b.counts, |x, y| x == y)
            .or_else(|| one("jaw_count", &a.jaw_count, &b.jaw_count))
            .or_else(|| each("currents", &a.currents, &b.currents, |x, y| bits(*x) == bits(*y)))
            .or_else(|| one("upper_limits", &a.upper_limits, &b.upper_limits))
            .or_else(|| one("lower_limits", &a.lower_limits, &b.lower_limits))
            .or_else(|| one("over_currents", &a.over_currents, &b.over_currents))
            .or_else(|| one("power_faults", &a.power_faults, &b.power_faults))
            .or_else(|| one("sync_switches", &a.sync_switches, &b.sync_switches))
            .or_else(|| one("encoder_zeros", &a.encoder_zeros, &b.encoder_zeros))
            .or_else(|| one("synchronised", &a.synchronised, &b.synchronised))
            .or_else(|| one("guessed", &a.extrapolated, &b.extrapolated))
            .or_else(|| one("unheard", &a.no_answer, &b.no_answer))
            .or_else(|| {
                let (a, b) = (wrench(&a.wrench_on_sensor), wrench(&b.wrench_on_sensor));
                each("wrench_on_sensor", &a, &b, |x, y| bits(*x) == bits(*y))
            })
            .or_else(|| one("wrench_is_old", &a.wrench_is_old, &b.wrench_is_old))
            // The inputs are equal up to here, so a difference below comes from the controller.
            .or_else(|| one("outside", &self.outside, &now.outside))
            .or_else(|| order_difference(&self.command, &now.command))
            .or_else(|| one("enabled", &self.drive.enabled, &now.drive.enabled))
            .or_else(|| each("pwm", &self.drive.pwm, &now.drive.pwm, |x, y| x == y))
            .or_else(|| one("jaw_pwm", &self.drive.jaw_pwm, &now.drive.jaw_pwm))
            .or_else(|| one("stops", &self.drive.stops, &now.drive.stops))
            .or_else(|| one("synchronise", &self.drive.synchronise, &now.drive.synchronise))
            .or_else(|| each("joints", &self.joints, &now.joints, |x, y| bits(*x) == bits(*y)))
            .or_else(|| {
                let (a, b) = (&self.desired_joints, &now.desired_joints);
                each("desired_joints", a, b, |x, y| bits(*x) == bits(*y))
            })
            .or_else(|| {
                let (a, b) = (wrench(&self.wrench_in_tool), wrench(&now.wrench_in_tool));
                each("wrench_in_tool", &a, &b, |x, y| bits(*x) == bits(*y))
            })
            .or_else(|| {
                let (a, b) = ([self.jaw_opening, self.jaw_force], [now.jaw_opening, now.jaw_force]);
                each("jaw (opening, force)", &a, &b, |x, y| bits(*x) == bits(*y))
            })
            .or_else(|| one("refused", &self.refused, &now.refused))
            .or_else(|| one("fault", &self.fault, &now.fault))
            // All fields of the message are equal. The hash also covers the rest of the state,
            // above all the poses.
            .or_else(|| one("check (poses)", &self.check, &now.check))
    }
}

/// Compares the recorded and the present value of a field. Returns the difference, `None` if there
/// is none.
fn one<T: Debug + PartialEq>(field: &str, recorded: &T, now: &T) -> Option<Difference> {
    (recorded != now).then(|| Difference {
        field: field.to_owned(),
        recorded: format!("{recorded:?}"),
        now: format!("{now:?}"),
    })
}

/// Compares the recorded and the present array of a field; `same` tells whether two values are
/// equal. The difference names the index of the first unequal values; `None` if all are equal.
fn each<T: Debug>(
    field: &str,
    recorded: &[T],
    now: &[T],
    same: impl Fn(&T, &T) -> bool,
) -> Option<Difference> {
    let at = recorded.iter().zip(now).position(|(a, b)| !same(a, b))?;
    Some(Difference {
        field: format!("{field}[{at}]"),
        recorded: format!("{:?}", recorded[at]),
        now: format!("{:?}", now[at]),
    })
}

/// Compares two commands to a servo, as JSON. The difference names the path to the first unequal
/// value, as in `command.Move.command.periods`. `None` if the texts are equal.
fn order_difference(recorded: &str, now: &str) -> Option<Difference> {
    if recorded == now {
        return None;
    }
    // The texts differ. If their JSON values are equal all the same, or one of them is no JSON, the
    // difference shows both texts.
    let parse = |text: &str| serde_json::from_str::<serde_json::Value>(text);
    let whole =
        Difference { field: "command".to_owned(), recorded: or_none(recorded), now: or_none(now) };
    let (Ok(a), Ok(b)) = (parse(recorded), parse(now)) else { return Some(whole) };
    Some(json_difference("command", &a, &b).unwrap_or(whole))
}

/// Returns the text of a command, or "nothing" if there was no command.
fn or_none(text: &str) -> String {
    if text.is_empty() { "nothing".to_owned() } else { text.to_owned() }
}

/// Finds the first difference of two JSON values, in the order of `a`; `path` is their place in the
/// whole command. Objects with different keys and arrays of different length differ as a whole.
fn json_difference(path: &str, a: &serde_json::Value, b: &serde_json::Value) -> Option<Difference> {
    use serde_json::Value;
    match (a, b) {
        (Value::Object(x), Value::Object(y)) if x.keys().eq(y.keys()) => x
            .iter()
            .zip(y.values())
            .find_map(|((key, a), b)| json_difference(&format!("{path}.{key}"), a, b)),
        (Value::Array(x), Value::Array(y)) if x.len() == y.len() => {
            let mut pairs = x.iter().zip(y).enumerate();
            pairs.find_map(|(i, (a, b))| json_difference(&format!("{path}[{i}]"), a, b))
        }
        _ => (a != b).then(|| Difference {
            field: path.to_owned(),
            recorded: a.to_string(),
            now: b.to_string(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{
        ArmFault, ArmState, JawCommand, JointPositions, Motion, MoveCommand, MoveRefused,
    };
    use crate::spatial::Pose;

    /// Returns a servo record with another value in each field, some of which are hard to encode:
    /// NaN, 1/3, a sum that rounds.
    fn record() -> ServoRecord {
        let jaw = JawCommand { opening: 0.1 + 0.2, force_limit: 40.0, stops: Depth::Two };
        let command =
            MoveCommand { motion: Motion::Pose(Pose::identity()), periods: 8, jaw: Some(jaw) };
        let reading = ArmReading {
            counts: [11, -12, 13, i64::MIN, 15, 16, i64::MAX],
            jaw_count: -3,
            currents: std::array::from_fn(|i| 0.1 * (i + 1) as f64),
            upper_limits: 1,
            lower_limits: 2,
            over_currents: 4,
            power_faults: 8,
            sync_switches: 16,
            encoder_zeros: 32,
            synchronised: 64,
            extrapolated: 128,
            no_answer: 129,
            wrench_on_sensor: Wrench::from_directions([f64::NAN, -0.0, 3.0, 4.0, 5.0, 6.0]),
            wrench_is_old: true,
            inputs: 0x8001,
            ..ArmReading::default()
        };
        let refused = MoveRefused::JointLimit { axis: 3, value: 1.5, low: -1.0, high: 1.0 };
        ServoRecord {
            period: 77,
            arm: 1,
            reading,
            outside: Outside { skipped: 3, stands_by: true, ..Outside::default() },
            command: Some(ServoCommand::Move { command, start: 78 }),
            drive: ArmDrive {
                enabled: true,
                pwm: [-255, 1, -2, 3, -4, 5, 255],
                jaw_pwm: -7,
                stops: Depth::Two,
                synchronise: 9,
            },
            state: ArmState {
                joints: JointPositions(numbers(20.0)),
                desired_joints: JointPositions(numbers(30.0)),
                wrench_in_tool: Wrench::from_directions(numbers(40.0)),
                jaw_opening: 0.05,
                jaw_force: 1.0 / 3.0,
                refused: Some(refused),
                fault: Some(ArmFault::EmergencyStop),
                ..ArmState::default()
            },
        }
    }

    /// Returns the numbers from `first` on.
    fn numbers<const N: usize>(first: f64) -> [f64; N] {
        std::array::from_fn(|i| first + i as f64)
    }

    /// Encodes a servo record and decodes the message.
    fn recorded(record: &ServoRecord) -> Tick {
        let mut writer = Writer::default();
        write(record, 5, &mut writer);
        Tick::read(&writer.bytes()).unwrap()
    }

    #[test]
    fn decoded_record_equals_encoded_record_exactly() {
        let tick = recorded(&record());

        assert_eq!(tick.difference(&Tick::of(&record())), None);
        assert_eq!(tick.outside().unwrap(), record().outside);
        assert_eq!(tick.reading.inputs, 0x8001);
        assert_eq!(tick.order().unwrap(), record().command);
        assert!(tick.reading.wrench_on_sensor.force.x.is_nan());
    }

    /// A field that is neither written nor compared would hide a difference of a replay.
    #[test]
    fn difference_of_each_field_is_found() {
        type Change = fn(&mut ServoRecord);
        let changes: [(&str, Change); 26] = [
            ("counts[6]", |r| r.reading.counts[6] -= 1),
            ("jaw_count", |r| r.reading.jaw_count = 3),
            ("currents[7]", |r| r.reading.currents[7] += 1e-15),
            ("upper_limits", |r| r.reading.upper_limits = 3),
            ("lower_limits", |r| r.reading.lower_limits = 3),
            ("over_currents", |r| r.reading.over_currents = 3),
            ("power_faults", |r| r.reading.power_faults = 3),
            ("sync_switches", |r| r.reading.sync_switches = 3),
            ("encoder_zeros", |r| r.reading.encoder_zeros = 3),
            ("synchronised", |r| r.reading.synchronised = 3),
            ("guessed", |r| r.reading.extrapolated = 3),
            ("unheard", |r| r.reading.no_answer = 3),
            ("wrench_on_sensor[1]", |r| r.reading.wrench_on_sensor.force.y = 0.0),
            ("wrench_is_old", |r| r.reading.wrench_is_old = false),
            ("outside", |r| r.outside.skipped = 4),
            ("outside", |r| r.reading.inputs = 2),
            ("enabled", |r| r.drive.enabled = false),
            ("pwm[6]", |r| r.drive.pwm[6] = 254),
            ("jaw_pwm", |r| r.drive.jaw_pwm = 7),
            ("stops", |r| r.drive.stops = Depth::One),
            ("synchronise", |r| r.drive.synchronise = 8),
            ("joints[6]", |r| r.state.joints.0[6] += 1e-12),
            ("desired_joints[0]", |r| r.state.desired_joints.0[0] = -0.0),
            ("wrench_in_tool[5]", |r| r.state.wrench_in_tool.torque.z = 0.0),
            ("refused", |r| r.state.refused = None),
            ("fault", |r| r.state.fault = None),
        ];
        for (field, change) in changes {
            let mut other = record();
            change(&mut other);
            for (one, other) in [(record(), other), (other, record())] {
                let found = recorded(&one).difference(&Tick::of(&other));
                assert_eq!(found.map(|found| found.field).as_deref(), Some(field));
            }
        }
    }

    #[test]
    fn difference_names_first_unequal_field() {
        let mut other = record();
        other.drive.pwm[3] = 12;
        let found = recorded(&record()).difference(&Tick::of(&other)).unwrap();
        assert_eq!((found.field.as_str(), found.now.as_str()), ("pwm[3]", "12"));

        let Some(ServoCommand::Move { command, .. }) = &mut other.command else { panic!() };
        command.jaw.as_mut().unwrap().opening = 0.3;
        let found = recorded(&record()).difference(&Tick::of(&other)).unwrap();
        assert_eq!(found.field, "command.Move.command.jaw.opening");
        assert_eq!(found.recorded, "0.30000000000000004");

        other = record();
        other.command = None;
        let found = recorded(&record()).difference(&Tick::of(&other)).unwrap();
        assert_eq!((found.field.as_str(), found.now.as_str()), ("command", "nothing"));

        other = record();
        other.state.base_from_tool.translation.x = 1e-16;
        let found = recorded(&record()).difference(&Tick::of(&other)).unwrap();
        assert_eq!(found.field, "check (poses)");
    }
}
