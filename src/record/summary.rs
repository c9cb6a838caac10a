//! Summary of a run: its verdict and figures, as JSON for programs and as a table for the operator.
//!
//! - in: figures of the mission and of the plant (the simulated cell); on hardware the figures that
//!   only a plant can know are `None`
//! - out: a line of JSON ([`Summary::json`]) or a table ([`Summary::table`]), and the exit code

use crate::error::FaultCode;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Verdict on a run. It comes from the plant if there is one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Success of the task: the cube is solved (`solve`), the layer is turned (`face_turn`), the
    /// cube is in the gripper (`acquire`), or the operator has ended moves by hand.
    Solved,
    /// End of the task without success.
    Failed,
    /// Abort by the operator, or by a fatal or a system error.
    Aborted,
}

/// Cause of the end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndedBy {
    /// End of the task itself.
    Task,
    /// Terminate command of the operator.
    Operator,
    /// Interrupt of the process (Ctrl-C).
    Interrupt,
    /// Fatal error of an effector.
    Fatal,
    /// System error: messages, actors.
    System,
}

/// Phase of a mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Phase {
    /// Name.
    pub name: String,
    /// Simulated time that it took (s).
    pub sim_time_s: f64,
    /// Time by the wall clock (s), counted as [`Summary::wall_time_s`].
    pub wall_time_s: f64,
}

/// Largest force and torque at one tool over the whole run: true contact in the plant, and values
/// of the wrist sensor without the weight of the tool. The virtual sensor samples the wrist sensor
/// every 40 ms, so it may miss the peak that stopped a motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorPeak {
    /// Name of the effector.
    pub effector: String,
    /// Norm of the contact force (N); `None` on hardware.
    pub force_n: Option<f64>,
    /// Norm of the contact torque (Nm); `None` on hardware.
    pub torque_nm: Option<f64>,
    /// Norm of the measured force (N).
    pub felt_force_n: f64,
    /// Norm of the measured torque (Nm).
    pub felt_torque_nm: f64,
}

/// Numbers of acts that no controller may do, whatever fails around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Violations {
    /// Falls of a cube because the last hand that held it opened its jaws.
    pub let_fall: u32,
    /// Arms whose drives went on again after the drives of an arm had gone off.
    pub restarts: u32,
    /// Motions of an arm later than 0.55 s after the drives of an arm had gone off.
    pub moved_after_stop: u32,
}

/// Undesired event in the plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Accident {
    /// Simulated time of the event (s).
    pub time_s: f64,
    /// Description.
    pub what: String,
}

/// Load of motors and arms over a run, from the plant. Each value is the worst of all motors or
/// arms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exertion {
    /// Motor current, as a share of the current that trips the power stage.
    pub current_share: f64,
    /// Heat of a winding, as a share of the heat that trips it.
    pub heat_share: f64,
    /// Speed of a motor (rad/s).
    pub motor_speed_rad_s: f64,
    /// Speed of a point of forearm, wrist, hand or fingers within 175 mm of the place where a
    /// person holds the cube (mm/s).
    pub near_person_mm_s: f64,
    /// Smallest distance between parts of the two arms (mm); `None` if they were never near each
    /// other. In each grasp the fingers are some millimetres from the other palm.
    #[serde(default)]
    pub arms_apart_mm: Option<f64>,
}

/// Verdict and figures of a run. A cube is 54 letters, nine for each of the faces U R F D L B; the
/// letter of a sticker names the face whose centre has its colour.
///
/// A figure that only a plant can know is `None` on hardware.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Verdict.
    pub outcome: Outcome,
    /// Reason of the verdict, as a sentence.
    pub reason: String,
    /// Cause of the end.
    pub ended_by: EndedBy,
    /// Code of the error that ended the run; `None` if no error did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<FaultCode>,
    /// Class, actor and place of that error. Summaries of older builds have them in the reason.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detected_by: Option<String>,
    /// Instruction for the operator after that error, as a sentence; `None` if there is none.
    /// Summaries of older builds have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
    /// Whether the controller reported a success that the plant contradicts.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub untrue: bool,
    /// Path of the recording of the last second before that error; `None` if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_second: Option<String>,
    /// Task of the scenario: "solve", "`face_turn`", "acquire".
    pub task: String,
    /// Seed of all random numbers of the run.
    pub seed: u64,
    /// Cube of the plant at the beginning.
    pub cube_start: Option<String>,
    /// Cube of the plant at the end.
    pub cube_end: Option<String>,
    /// Cube as the controller read it; `None` if it did not read the cube.
    pub identified: Option<String>,
    /// Face turns of the first plan, as in "R U2 F'"; `None` if there was no plan.
    pub solution: Option<String>,
    /// Time that this plan expects for the phase "solve" (s).
    #[serde(default)]
    pub expected_s: Option<f64>,
    /// Face turns that were executed, as the controller counts them.
    pub executed: String,
    /// Number of face turns that were executed.
    pub turns: u32,
    /// Number of jaw closings on the cube between identification and hand-back.
    pub grasps: u32,
    /// Number of times that the cube was read and planned again after a failure.
    #[serde(default)]
    pub recoveries: u32,
    /// Simulated time of the run (s), with its pauses.
    pub sim_time_s: f64,
    /// Time of the run for which the operator paused it (s). Summaries of older builds have none.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub paused_s: f64,
    /// Wall-clock time of the run (s), without the wait for the start and without delays on
    /// purpose: a limit of the speed, pauses, questions and moves by hand.
    pub wall_time_s: f64,
    /// Largest contact force of the plant at the tools while both arms hold the cube, without the
    /// forces of the grips (N); 0 if they never did.
    pub peak_force_n: Option<f64>,
    /// Largest contact torque of the plant at the tools while both arms hold the cube (Nm).
    pub peak_torque_nm: Option<f64>,
    /// Largest force and torque at each tool.
    pub sensors: Vec<SensorPeak>,
    /// Load of motors and arms. Summaries of older builds have none.
    #[serde(default)]
    pub exertion: Option<Exertion>,
    /// Number of jams: a turn was commanded and unfinished, and the layer moved less than 1 deg in
    /// 3 s.
    pub jams: Option<u32>,
    /// Number of times that a grip slipped by more than 3 deg or 1 mm.
    pub slips: Option<u32>,
    /// Number of times that the cube fell.
    pub drops: Option<u32>,
    /// Number of times that the controller detected a fall by its jaws: the only hand that held the
    /// cube had lost it.
    #[serde(default)]
    pub drops_noticed: Option<u32>,
    /// Whether the cube of the plant is back with the operator in the end, or on the table if it
    /// had to go there.
    #[serde(default)]
    pub returned: Option<bool>,
    /// Force at which the controller stops a free motion, `control.force_limit_n` (N).
    #[serde(default)]
    pub force_limit_n: Option<f64>,
    /// Distance of the nearest tool from the centre of the plant's cube at the beginning (mm).
    #[serde(default)]
    pub clearance_mm: Option<f64>,
    /// Number of times that the cube came apart: a tilt above 3 Nm or a pull above 50 N.
    pub pops: Option<u32>,
    /// Number of times that the cube was squeezed by more than 150 N.
    pub crushed: Option<u32>,
    /// Number of collisions: contacts of the plant that must not happen.
    pub collisions: Option<u32>,
    /// Number of those falls that came later than 0.5 s before an error ended the run: the jaws had
    /// no time to report them. Summaries of older builds have none.
    #[serde(default)]
    pub late_drops: Option<u32>,
    /// Acts that no controller may do, as the plant counted them. Summaries of older builds have
    /// none.
    #[serde(default)]
    pub violations: Option<Violations>,
    /// Undesired events in the plant in the order of time: the events that are counted above,
    /// layers that do not move under load, and sensors that leave their range. A run with very many
    /// events leaves out the last.
    #[serde(default)]
    pub accidents: Option<Vec<Accident>>,
    /// Angle of the layer in the plant, positive in the commanded direction (deg); task
    /// "`face_turn`" only.
    pub turned_deg: Option<f64>,
    /// Figures of the task that have no key of their own, by name: those that the plant shows, and
    /// those that the controller reports.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub figures: BTreeMap<String, Value>,
    /// Phases in their order.
    pub phases: Vec<Phase>,
    /// Run hash over all servo records and messages, hexadecimal.
    pub hash: String,
    /// Servo hash over the servo records alone, hexadecimal: equal if two builds move alike. Empty
    /// in summaries of older builds.
    #[serde(default)]
    pub servo_hash: String,
    /// Hash over the parameters that limit speed and force of the plant, hexadecimal: drives,
    /// trips, friction, pads. Figures of two runs are comparable only if it is equal.
    #[serde(default)]
    pub plant_hash: Option<String>,
    /// Cameras that could not be calibrated before the run, each with the reason. For them the run
    /// used the values of the scenario.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub uncalibrated: Vec<String>,
    /// Use of the links to other nodes on the wall clock.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub links: Vec<LinkUse>,
}

/// Bytes that a run has sent over the link to a node and received from it, without those that the
/// network adds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinkUse {
    /// Name of the node.
    pub node: String,
    /// Time since the node was first asked to join the run (s).
    pub time_s: f64,
    /// Bytes sent to the node.
    pub sent_bytes: u64,
    /// Bytes received from the node.
    pub received_bytes: u64,
}

impl std::fmt::Display for LinkUse {
    /// Writes the bytes per second in both directions.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let rate = |bytes: u64| factor(bytes as f64 * 1e-3, self.time_s);
        let (sent, received) = (rate(self.sent_bytes), rate(self.received_bytes));
        write!(f, "{sent:.1} kB/s sent, {received:.1} kB/s received")
    }
}

impl Summary {
    /// Makes the summary of a run that ended before any arm moved: the cube is unchanged, all
    /// figures are 0. `cube` is the cube of the plant; `None` on hardware.
    #[must_use]
    pub(crate) fn not_started(
        task: &str,
        seed: u64,
        cube: Option<&str>,
        reason: &str,
        ended_by: EndedBy,
    ) -> Self {
        // Counts of a plant are 0; on hardware they are unknown.
        let none = cube.map(|_| 0);
        Self {
            outcome: Outcome::Aborted,
            reason: reason.to_owned(),
            ended_by,
            fault: None,
            detected_by: None,
            remedy: None,
            untrue: false,
            last_second: None,
            task: task.to_owned(),
            seed,
            cube_start: cube.map(str::to_owned),
            cube_end: cube.map(str::to_owned),
            identified: None,
            solution: None,
            expected_s: None,
            executed: String::new(),
            turns: 0,
            grasps: 0,
            recoveries: 0,
            // A campaign leaves these zero times out of its statistics.
            sim_time_s: 0.0,
            paused_s: 0.0,
            wall_time_s: 0.0,
            peak_force_n: none.map(f64::from),
            peak_torque_nm: none.map(f64::from),
            sensors: Vec::new(),
            exertion: None,
            jams: none,
            slips: none,
            drops: none,
            drops_noticed: Some(0),
            returned: None,
            force_limit_n: None,
            clearance_mm: None,
            pops: none,
            crushed: none,
            collisions: none,
            late_drops: None,
            violations: None,
            accidents: none.map(|_| Vec::new()),
            turned_deg: None,
            figures: BTreeMap::new(),
            phases: Vec::new(),
            // `has_begun` recognises this summary by its empty hash.
            hash: String::new(),
            servo_hash: String::new(),
            plant_hash: None,
            uncalibrated: Vec::new(),
            links: Vec::new(),
        }
    }

    /// Checks whether the run has begun. A run that ended before any arm moved has no hash, and its
    /// zeros are no measurements.
    #[must_use]
    pub(crate) fn has_begun(&self) -> bool {
        !self.hash.is_empty()
    }

    /// Returns the exit code of the program: 0 done, 1 failed or aborted, 3 fatal error, 4 system
    /// error, 130 interrupted.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match (self.outcome, self.ended_by) {
            (_, EndedBy::System) => 4,
            (_, EndedBy::Fatal) => 3,
            // Moves by hand succeed when the operator ends them, by a command or by Ctrl-C. So this
            // rule comes before that of the interrupt.
            (Outcome::Solved, _) => 0,
            (_, EndedBy::Interrupt) => 130,
            (Outcome::Failed | Outcome::Aborted, _) => 1,
        }
    }

    /// Returns the ratio of simulated time to wall-clock time; 0 if no wall-clock time has passed.
    #[must_use]
    pub(crate) fn real_time_factor(&self) -> f64 {
        factor(self.sim_time_s, self.wall_time_s)
    }

    /// Returns the summary as one line of JSON. JSON has no NaN and no infinity. A time of the run,
    /// a force or a torque with one of these values becomes the largest number instead of `null`,
    /// so that it fails each test of an upper limit.
    #[must_use]
    pub fn json(&self) -> String {
        let mut clean = self.clone();
        let times = [&mut clean.sim_time_s, &mut clean.wall_time_s];
        let peaks = clean.peak_force_n.iter_mut().chain(clean.peak_torque_nm.iter_mut());
        let sensors = clean.sensors.iter_mut().flat_map(|s| {
            let felt = [&mut s.felt_force_n, &mut s.felt_torque_nm];
            felt.into_iter().chain(s.force_n.iter_mut()).chain(s.torque_nm.iter_mut())
        });
        for number in times.into_iter().chain(peaks).chain(sensors) {
            if !number.is_finite() {
                *number = f64::MAX;
            }
        }
        serde_json::to_string(&clean).unwrap_or_else(|error| format!("{{\"error\":\"{error}\"}}"))
    }

    /// Returns whether the rows of the cube belong into the table: a task with figures of its own
    /// may handle none.
    pub(crate) fn concerns_cube(&self) -> bool {
        let drops = self.drops.unwrap_or(0);
        self.figures.is_empty() || self.identified.is_some() || self.turns + self.grasps + drops > 0
    }

    /// Returns the summary as a table for the operator, with an end of line after each row.
    #[must_use]
    pub fn table(&self) -> String {
        // The order is times, figures, cubes, hashes, verdict: the verdict is next to the prompt.
        let mut t = String::new();
        self.add_phases(&mut t);
        t.push('\n');
        for (name, words) in self.figure_rows() {
            row(&mut t, &name, &words);
        }
        t.push('\n');
        if self.concerns_cube() {
            row(&mut t, "cube at start", self.cube_start.as_deref().unwrap_or(UNKNOWN));
            row(&mut t, "as identified", self.identified.as_deref().unwrap_or("(not read)"));
            row(&mut t, "solution", self.solution.as_deref().unwrap_or("(none)"));
            row(&mut t, "executed", &self.executed);
            row(&mut t, "cube at end", self.cube_end.as_deref().unwrap_or(UNKNOWN));
        }
        row(&mut t, "hash", &self.hash);
        row(&mut t, "servo hash", &self.servo_hash);
        if let Some(plant) = &self.plant_hash {
            row(&mut t, "plant hash", plant);
        }
        t.push('\n');
        // Only the task "solve" has a cube to be solved.
        let verdict = match (self.outcome, self.task.as_str()) {
            (Outcome::Solved, "solve") => "SOLVED",
            (Outcome::Solved, _) => "DONE",
            (Outcome::Failed, _) => "FAILED",
            (Outcome::Aborted, _) => "ABORTED",
        };
        row(&mut t, verdict, &self.reason);
        if let Some(fault) = self.fault {
            row(&mut t, "fault code", &fault.to_string());
        }
        if let Some(detected_by) = &self.detected_by {
            row(&mut t, "detected by", detected_by);
        }
        if let Some(remedy) = &self.remedy {
            row(&mut t, "what to do", remedy);
        }
        if let Some(path) = &self.last_second {
            row(&mut t, "last second", path);
        }
        t
    }

    /// Adds to the table a row for each phase, one for the whole run, and the time that the plan
    /// expected.
    fn add_phases(&self, t: &mut String) {
        row(t, "phase", "simulated time, ratio to real time");
        for phase in &self.phases {
            let factor = factor(phase.sim_time_s, phase.wall_time_s);
            row(t, &phase.name, &format!("{:8.1} s {factor:9.1} x", phase.sim_time_s));
        }
        row(t, "whole run", &format!("{:>10}", self.whole_run()));
        if let Some(seconds) = self.expected_s {
            row(t, "the plan expected", &format!("{seconds:8.1} s of the phase \"solve\""));
        }
    }

    /// Returns the time of the run in words, with that of its pauses.
    pub(crate) fn whole_run(&self) -> String {
        let whole = format!("{:.1} s", self.sim_time_s);
        if self.paused_s == 0.0 {
            return whole;
        }
        format!("{whole}, {:.1} s of them paused", self.paused_s)
    }

    /// Returns the figures of mission and plant in words, each with its name. Rows that most runs
    /// do not need are there only if they have something to report.
    pub(crate) fn figure_rows(&self) -> Vec<(String, String)> {
        let mut rows = self.effort_rows();
        let mut row = |name: &str, words: String| rows.push((name.to_owned(), words));
        let of_cube = self.concerns_cube();
        if of_cube {
            row("jams, slips, drops", counts([self.jams, self.slips, self.drops]));
        }
        // A fall that only one of plant and controller counts must be visible.
        if self.drops.unwrap_or(0) > 0 || self.drops_noticed.unwrap_or(0) > 0 {
            row("drops detected", self.drops_noticed.unwrap_or(0).to_string());
        }
        if of_cube {
            row("pops, crushes, bumps", counts([self.pops, self.crushed, self.collisions]));
        } else {
            row("bumps", known(self.collisions, |bumps| bumps.to_string()));
        }
        for Accident { time_s, what } in self.accidents.iter().flatten() {
            row("", format!("{time_s:8.1} s: {what}"));
        }
        if let Some(angle) = self.turned_deg {
            row("layer turned by", format!("{angle:.1} deg"));
        }
        for (name, figure) in &self.figures {
            row(&figure_label(name), figure_text(figure));
        }
        let clock = format!("{:.1} ({:.1} s)", self.real_time_factor(), self.wall_time_s);
        row("real-time factor", clock);
        rows
    }

    /// Returns the counts of the work, the peaks of force, the cameras without calibration and the
    /// links, each with its name.
    fn effort_rows(&self) -> Vec<(String, String)> {
        let peak = |force: Option<f64>, torque: Option<f64>| {
            known(force.zip(torque), |(force, torque)| format!("{force:.1} N, {torque:.2} Nm"))
        };
        let mut rows = Vec::new();
        let mut row = |name: &str, words: String| rows.push((name.to_owned(), words));
        if self.concerns_cube() {
            row("turns", self.turns.to_string());
            row("grasps", self.grasps.to_string());
            row("recoveries", self.recoveries.to_string());
            row("peak while both hold", peak(self.peak_force_n, self.peak_torque_nm));
        }
        for sensor in &self.sensors {
            let felt = format!("{:.1} N, {:.2} Nm", sensor.felt_force_n, sensor.felt_torque_nm);
            let exerted = peak(sensor.force_n, sensor.torque_nm);
            let words = format!("{exerted}; its sensor measured {felt}");
            row(&format!("peak at {}", sensor.effector), words);
        }
        for camera in &self.uncalibrated {
            row("not calibrated", camera.clone());
        }
        for link in &self.links {
            row(&format!("link to node {}", link.node), link.to_string());
        }
        rows
    }
}

/// Returns whether a time is zero, so that JSON leaves it out.
#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(time: &f64) -> bool {
    *time == 0.0
}

/// Returns the ratio of simulated time to wall-clock time; 0 if no wall-clock time has passed.
fn factor(sim_time_s: f64, wall_time_s: f64) -> f64 {
    if wall_time_s > 0.0 { sim_time_s / wall_time_s } else { 0.0 }
}

/// Ends of the names of figures that stand for a unit, and the unit. A longer end comes first.
const UNITS: [(&str, &str); 14] = [
    ("_mm_s", "mm/s"),
    ("_deg_s", "deg/s"),
    ("_rad_s", "rad/s"),
    ("_percent", "%"),
    ("_deg", "deg"),
    ("_rad", "rad"),
    ("_mm", "mm"),
    ("_ms", "ms"),
    ("_kg", "kg"),
    ("_hz", "Hz"),
    ("_nm", "Nm"),
    ("_m", "m"),
    ("_n", "N"),
    ("_s", "s"),
];

/// Returns the name of a figure for people: words, and the unit in brackets.
#[must_use]
pub fn figure_label(name: &str) -> String {
    let unit = UNITS.iter().find_map(|(end, unit)| Some((name.strip_suffix(end)?, unit)));
    match unit {
        Some((name, unit)) => format!("{} [{unit}]", name.replace('_', " ")),
        None => name.replace('_', " "),
    }
}

/// Returns a figure of a task as text: a number with five digits, a text without quotes.
#[must_use]
pub fn figure_text(figure: &Value) -> String {
    match figure {
        Value::Number(number) if number.is_f64() => {
            let number = number.as_f64().unwrap_or(f64::NAN);
            let short: f64 = format!("{number:.4e}").parse().unwrap_or(number);
            short.to_string()
        }
        Value::String(text) => text.clone(),
        // JSON has no other form of a number that is none.
        Value::Null => UNKNOWN.to_owned(),
        other => other.to_string(),
    }
}

/// Text in place of an unknown figure.
const UNKNOWN: &str = "(unknown)";

/// Returns the text that `words` makes of a figure; [`UNKNOWN`] if the figure is `None`.
fn known<T>(value: Option<T>, words: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| UNKNOWN.to_owned(), words)
}

/// Returns three counts separated by commas; [`UNKNOWN`] if any of them is `None`.
fn counts(counts: [Option<u32>; 3]) -> String {
    match counts {
        [Some(a), Some(b), Some(c)] => format!("{a}, {b}, {c}"),
        _ => UNKNOWN.to_owned(),
    }
}

/// Adds a row to the table: name, value.
fn row(table: &mut String, name: &str, value: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(table, "{name:<22} {value}");
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the summary of a solved run whose peak force is NaN.
    fn summary() -> Summary {
        Summary {
            outcome: Outcome::Solved,
            reason: "the cube in the plant is solved".into(),
            ended_by: EndedBy::Task,
            fault: None,
            detected_by: None,
            remedy: None,
            untrue: false,
            last_second: None,
            task: "solve".into(),
            seed: 1,
            cube_start: Some("U".repeat(54)),
            cube_end: Some("U".repeat(54)),
            identified: None,
            solution: Some("R U2 F'".into()),
            expected_s: Some(12.0),
            executed: "R U2 F'".into(),
            turns: 3,
            grasps: 4,
            recoveries: 1,
            sim_time_s: 100.0,
            paused_s: 0.0,
            wall_time_s: 2.0,
            peak_force_n: Some(f64::NAN),
            peak_torque_nm: Some(0.5),
            sensors: vec![],
            jams: Some(0),
            slips: Some(0),
            drops: Some(0),
            drops_noticed: Some(0),
            returned: Some(true),
            exertion: Some(Exertion {
                current_share: 0.2,
                heat_share: 0.01,
                motor_speed_rad_s: 235.0,
                near_person_mm_s: 120.0,
                arms_apart_mm: Some(8.0),
            }),
            force_limit_n: Some(20.0),
            clearance_mm: Some(400.0),
            pops: Some(0),
            crushed: Some(0),
            collisions: Some(0),
            late_drops: Some(0),
            violations: Some(Violations::default()),
            accidents: Some(vec![]),
            turned_deg: None,
            figures: BTreeMap::new(),
            phases: vec![Phase { name: "acquire".into(), sim_time_s: 10.0, wall_time_s: 0.5 }],
            hash: "ab".into(),
            servo_hash: "cd".into(),
            plant_hash: None,
            uncalibrated: Vec::new(),
            links: Vec::new(),
        }
    }

    #[test]
    fn summary_json_has_one_line_without_null_peaks() {
        let mut s = summary();
        s.sensors.push(SensorPeak {
            effector: "track".into(),
            force_n: Some(f64::INFINITY),
            torque_nm: Some(1.0),
            felt_force_n: f64::NAN,
            felt_torque_nm: 1.0,
        });
        let json = s.json();

        let back: serde_json::Value = serde_json::from_str(&json).unwrap();
        let read: Summary = serde_json::from_str(&json).unwrap();
        assert_eq!(read.sensors[0].force_n, Some(f64::MAX));
        assert_eq!(back["outcome"], "solved");
        assert!(back["peak_force_n"].as_f64().unwrap() > 20.0);
        assert!(!json.contains('\n'));
    }

    #[test]
    fn table_lists_accidents_with_their_times() {
        let mut s = summary();
        s.accidents = Some(vec![Accident { time_s: 12.34, what: "it fell".into() }]);

        assert!(s.table().contains("12.3 s: it fell\n"), "{}", s.table());
    }

    #[test]
    fn unit_of_figure_is_in_brackets() {
        let labels = ["gap_mm", "speed_mm_s", "p99_n", "m", "wave_number", "open_percent"];
        let labels = labels.map(figure_label);
        assert_eq!(labels[..3], ["gap [mm]", "speed [mm/s]", "p99 [N]"]);
        assert_eq!(labels[3..], ["m", "wave number", "open [%]"]);
    }

    #[test]
    fn figures_of_task_replace_rows_of_cube() {
        let mut s = Summary { identified: None, turns: 0, grasps: 0, ..summary() };
        assert!(s.table().contains("cube at start") && !s.json().contains("figures"));
        s.figures.insert("force_error_n".into(), 0.123_456_7.into());
        s.figures.insert("hand_overs".into(), 3.into());

        let table = s.table();
        assert!(table.contains("force error [N]        0.12346\n"), "{table}");
        assert!(table.contains("hand overs             3\n"), "{table}");
        assert!(!table.contains("cube at") && !table.contains("grasps"), "{table}");
        assert!(s.json().contains("\"figures\":{\"force_error_n\":0.1234567,\"hand_overs\":3}"));
    }

    #[test]
    fn remedy_is_last_row_and_optional_field() {
        let mut s = summary();
        assert!(!s.table().contains("what to do") && !s.json().contains("remedy"));
        s.remedy = Some("Check the encoder.".into());

        assert!(
            s.table().ends_with("\nwhat to do             Check the encoder.\n"),
            "{}",
            s.table()
        );
        let read: Summary = serde_json::from_str(&s.json()).unwrap();
        assert_eq!(read, Summary { peak_force_n: Some(f64::MAX), ..s });
    }

    #[test]
    fn exit_code_follows_verdict_and_cause_of_end() {
        let mut s = summary();
        assert_eq!(s.exit_code(), 0);
        s.ended_by = EndedBy::Interrupt;
        assert_eq!(s.exit_code(), 0, "a run that only the operator ends is a success");
        for (by, code) in [(EndedBy::Operator, 0), (EndedBy::Fatal, 3), (EndedBy::System, 4)] {
            s.ended_by = by;
            assert_eq!(s.exit_code(), code, "an error counts more than a success");
        }
        s.ended_by = EndedBy::Task;
        s.outcome = Outcome::Failed;
        assert_eq!(s.exit_code(), 1);
        s.outcome = Outcome::Aborted;
        for (by, code) in [
            (EndedBy::Operator, 1),
            (EndedBy::Fatal, 3),
            (EndedBy::System, 4),
            (EndedBy::Interrupt, 130),
        ] {
            s.ended_by = by;
            assert_eq!(s.exit_code(), code);
        }
    }

    #[test]
    fn table_lists_phases_and_ends_with_verdict() {
        let mut s = summary();
        let table = s.table();
        // 10 s of simulated time in 0.5 s by the wall clock.
        assert!(table.contains("\nacquire                    10.0 s      20.0 x\n"), "{table}");
        assert!(table.contains("\nwhole run                 100.0 s\n"), "{table}");

        let verdict = |s: &Summary| s.table().lines().last().unwrap().to_owned();
        assert_eq!(verdict(&s), format!("{:<22} {}", "SOLVED", s.reason));
        s.task = "idle".to_owned();
        assert!(verdict(&s).starts_with("DONE "));
        for (outcome, word) in [(Outcome::Failed, "FAILED "), (Outcome::Aborted, "ABORTED ")] {
            s.outcome = outcome;
            assert!(verdict(&s).starts_with(word), "{}", s.table());
        }
    }
}
