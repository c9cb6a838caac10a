//! What a run comes to: one object for machines, one table for the operator.
//!
//! - in: figures of the mission and of the plant, collected by whoever ran it; what only a plant
//!   can know is `None` on hardware
//! - out: a line of JSON ([`Summary::json`]) or a table ([`Summary::table`]), and the verdict's
//!   exit code

use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// The verdict, taken from the plant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// What the scenario asks for was achieved: the cube is solved (`solve`), the layer is turned
    /// (`face_turn`), the cube is in the gripper (`acquire`), the arms were moved by hand until the
    /// operator ended it.
    Solved,
    /// The task came to its end without that.
    Failed,
    /// The run was broken off: by the operator, or by a fatal or a system error.
    Aborted,
}

/// What brought the run to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndedBy {
    /// The task itself.
    Task,
    /// The operator's terminate.
    Operator,
    /// An interrupt of the process (Ctrl-C).
    Interrupt,
    /// A fatal error: an effector.
    Fatal,
    /// A system error: messages, actors.
    System,
}

/// A phase of a mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Phase {
    /// Name.
    pub name: String,
    /// Simulated time that it took (s).
    pub sim_time_s: f64,
    /// Time by the wall clock (s), counted as [`Summary::wall_time_s`].
    pub wall_time_s: f64,
}

/// Largest force and torque at one tool over the whole run: of the contact, as the plant has it,
/// and as the wrist's sensor felt it, weight taken off, once a macrostep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorPeak {
    /// Name of the effector.
    pub effector: String,
    /// Norm of the force (N).
    pub force_n: Option<f64>,
    /// Norm of the torque (Nm).
    pub torque_nm: Option<f64>,
    /// Norm of the felt force (N).
    pub felt_force_n: f64,
    /// Norm of the felt torque (Nm).
    pub felt_torque_nm: f64,
}

/// Something in the plant that should not have happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Accident {
    /// When, in simulated time (s).
    pub time_s: f64,
    /// What, in words.
    pub what: String,
}

/// How hard a run was for motors and arms, by the plant: over all of them the greatest of each.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exertion {
    /// Current, as a share of what trips a motor's power stage.
    pub current_share: f64,
    /// Heat of a winding, as a share of what trips it.
    pub heat_share: f64,
    /// Speed of a motor (rad/s).
    pub motor_speed_rad_s: f64,
    /// Speed of a tool within 175 mm of the place where a person holds the cube (mm/s).
    pub near_person_mm_s: f64,
    /// Least distance of a part of one arm from a part of the other (mm); null where they were
    /// never near to each other. At each grasp fingers are some millimetres from the other palm.
    #[serde(default)]
    pub arms_apart_mm: Option<f64>,
}

/// What a run comes to. Cubes are 54 letters URFDLB, named by the colours of the centres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Verdict.
    pub outcome: Outcome,
    /// Why, in a sentence.
    pub reason: String,
    /// What brought the run to its end.
    pub ended_by: EndedBy,
    /// What the scenario asked for: "solve", "`face_turn`", "acquire".
    pub task: String,
    /// Seed.
    pub seed: u64,
    /// The plant's cube at the beginning; `None` on hardware, like every figure below that is
    /// optional for that reason.
    pub cube_start: Option<String>,
    /// The plant's cube at the end.
    pub cube_end: Option<String>,
    /// What the controller read; `None` when it did not come to that.
    pub identified: Option<String>,
    /// The first plan, face turns only: "R U2 F'"; `None` when it did not come to that.
    pub solution: Option<String>,
    /// Time that this plan was expected to take (s): to be held against the phase "solve".
    #[serde(default)]
    pub expected_s: Option<f64>,
    /// What was turned in the end, as the controller counts it.
    pub executed: String,
    /// Number of face turns that were executed.
    pub turns: u32,
    /// Jaw closings on the cube between identification and hand-back.
    pub grasps: u32,
    /// How often the cube was read and planned anew after something had gone wrong.
    #[serde(default)]
    pub recoveries: u32,
    /// Simulated time (s).
    pub sim_time_s: f64,
    /// Time by the wall clock (s), without the wait for the start and what time was held back on
    /// purpose: by a limit of its speed, pauses, questions and moves by hand.
    pub wall_time_s: f64,
    /// Largest force of the plant's contact at the tools while both arms hold the cube, without the
    /// squeeze of the grips (N); 0 when they never did.
    pub peak_force_n: Option<f64>,
    /// Largest torque of the same (Nm).
    pub peak_torque_nm: Option<f64>,
    /// Largest contact at each tool.
    pub sensors: Vec<SensorPeak>,
    /// How much the arms exerted themselves, by the plant. Summaries of older builds have none.
    #[serde(default)]
    pub exertion: Option<Exertion>,
    /// Times that a turn was commanded and unfinished, and the layer moved less than 1 deg in 3 s.
    pub jams: Option<u32>,
    /// Times that a grip slipped by more than 3 deg or 1 mm.
    pub slips: Option<u32>,
    /// Times that the cube fell.
    pub drops: Option<u32>,
    /// How often the controller told that the cube had fallen, as its jaws felt: a hand that alone
    /// held it had lost it.
    #[serde(default)]
    pub drops_noticed: Option<u32>,
    /// Whether the operator has the cube in the end, or the table where it was to go back to, by
    /// the plant.
    #[serde(default)]
    pub returned: Option<bool>,
    /// Force at which the controller breaks a free motion off, `control.force_limit_n` (N).
    #[serde(default)]
    pub force_limit_n: Option<f64>,
    /// Distance of the nearest tool from the cube's centre in the plant when the run begins (mm).
    #[serde(default)]
    pub clearance_mm: Option<f64>,
    /// Times that the cube popped: tilt above 3 Nm or a pull above 50 N.
    pub pops: Option<u32>,
    /// Times that it was squeezed by more than 150 N.
    pub crushed: Option<u32>,
    /// Times that something touched what it should not.
    pub collisions: Option<u32>,
    /// What went wrong in the plant in this run, in its order: what is counted above, layers that
    /// stand still under load and sensors that leave their range. A run with very many events
    /// leaves out the last.
    #[serde(default)]
    pub accidents: Option<Vec<Accident>>,
    /// Task "`face_turn`": the layer's angle in the plant, positive in the asked sense (deg).
    pub turned_deg: Option<f64>,
    /// Phases in their order.
    pub phases: Vec<Phase>,
    /// Over every servo record and message of the run, hexadecimal.
    pub hash: String,
    /// Over the servo records alone, hexadecimal: equal where two builds move alike. Empty in
    /// summaries of older builds.
    #[serde(default)]
    pub servo_hash: String,
    /// Over what bounds the plant's speed and force, hexadecimal: drives, trips, friction, pads.
    /// Figures of two runs are compared only where it is equal.
    #[serde(default)]
    pub plant_hash: Option<String>,
    /// Cameras that could not be calibrated before the run, each with the reason: the run used them
    /// as the scenario has them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub uncalibrated: Vec<String>,
}

impl Summary {
    /// A run that was broken off before anything moved: the cube is as it was, all figures are 0.
    /// `cube` is `None` on hardware.
    #[must_use]
    pub(crate) fn not_started(
        task: &str,
        seed: u64,
        cube: Option<&str>,
        reason: &str,
        ended_by: EndedBy,
    ) -> Self {
        let none = cube.map(|_| 0);
        Self {
            outcome: Outcome::Aborted,
            reason: reason.to_owned(),
            ended_by,
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
            sim_time_s: 0.0,
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
            accidents: none.map(|_| Vec::new()),
            turned_deg: None,
            phases: Vec::new(),
            hash: String::new(),
            servo_hash: String::new(),
            plant_hash: None,
            uncalibrated: Vec::new(),
        }
    }

    /// Whether there was a run: one that was broken off before anything moved has no hash, and
    /// zeros that nobody measured.
    #[must_use]
    pub(crate) fn has_begun(&self) -> bool {
        !self.hash.is_empty()
    }

    /// 0 done, 1 the task failed or was aborted, 3 fatal, 4 system, 130 interrupted.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match (self.outcome, self.ended_by) {
            (_, EndedBy::System) => 4,
            (_, EndedBy::Fatal) => 3,
            // Moving arms by hand ends when its operator ends it, by whatever key.
            (Outcome::Solved, _) => 0,
            (_, EndedBy::Interrupt) => 130,
            (Outcome::Failed | Outcome::Aborted, _) => 1,
        }
    }

    /// Simulated over wall-clock time.
    #[must_use]
    pub(crate) fn real_time_factor(&self) -> f64 {
        factor(self.sim_time_s, self.wall_time_s)
    }

    /// One line of JSON. A figure that is no number would become `null`; it is written as the
    /// largest number instead, so that it stays under no limit.
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

    /// Returns the table for the operator, with an end of line behind each row.
    #[must_use]
    pub fn table(&self) -> String {
        let mut t = String::new();
        self.add_phases(&mut t);
        t.push('\n');
        self.add_figures(&mut t);
        t.push('\n');
        row(&mut t, "cube at start", self.cube_start.as_deref().unwrap_or(UNKNOWN));
        row(&mut t, "as identified", self.identified.as_deref().unwrap_or("(not read)"));
        row(&mut t, "solution", self.solution.as_deref().unwrap_or("(none)"));
        row(&mut t, "executed", &self.executed);
        row(&mut t, "cube at end", self.cube_end.as_deref().unwrap_or(UNKNOWN));
        row(&mut t, "hash", &self.hash);
        row(&mut t, "servo hash", &self.servo_hash);
        if let Some(plant) = &self.plant_hash {
            row(&mut t, "plant hash", plant);
        }
        t.push('\n');
        let verdict = match (self.outcome, self.task.as_str()) {
            (Outcome::Solved, "solve") => "SOLVED",
            (Outcome::Solved, _) => "DONE",
            (Outcome::Failed, _) => "FAILED",
            (Outcome::Aborted, _) => "ABORTED",
        };
        row(&mut t, verdict, &self.reason);
        t
    }

    fn add_phases(&self, t: &mut String) {
        row(t, "phase", "simulated time, times real time");
        for phase in &self.phases {
            let factor = factor(phase.sim_time_s, phase.wall_time_s);
            row(t, &phase.name, &format!("{:8.1} s {factor:9.1} x", phase.sim_time_s));
        }
        row(t, "whole run", &format!("{:8.1} s", self.sim_time_s));
        if let Some(seconds) = self.expected_s {
            row(t, "the plan expected", &format!("{seconds:8.1} s of the phase \"solve\""));
        }
    }

    fn add_figures(&self, t: &mut String) {
        let peak = |force: Option<f64>, torque: Option<f64>| {
            known(force.zip(torque), |(force, torque)| format!("{force:.1} N, {torque:.2} Nm"))
        };
        row(t, "turns", &self.turns.to_string());
        row(t, "grasps", &self.grasps.to_string());
        row(t, "begun anew", &self.recoveries.to_string());
        row(t, "peak while both hold", &peak(self.peak_force_n, self.peak_torque_nm));
        for sensor in &self.sensors {
            let felt = format!("{:.1} N, {:.2} Nm", sensor.felt_force_n, sensor.felt_torque_nm);
            let exerted = peak(sensor.force_n, sensor.torque_nm);
            let words = format!("{exerted}; its sensor felt {felt}");
            row(t, &format!("peak at {}", sensor.effector), &words);
        }
        for camera in &self.uncalibrated {
            row(t, "not calibrated", camera);
        }
        row(t, "jams, slips, drops", &counts([self.jams, self.slips, self.drops]));
        if self.drops.unwrap_or(0) > 0 || self.drops_noticed.unwrap_or(0) > 0 {
            row(t, "drops it noticed", &self.drops_noticed.unwrap_or(0).to_string());
        }
        row(t, "pops, crushes, bumps", &counts([self.pops, self.crushed, self.collisions]));
        for Accident { time_s, what } in self.accidents.iter().flatten() {
            row(t, "", &format!("{time_s:8.1} s: {what}"));
        }
        if let Some(angle) = self.turned_deg {
            row(t, "layer turned by", &format!("{angle:.1} deg"));
        }
        let clock = format!("{:.1} ({:.1} s)", self.real_time_factor(), self.wall_time_s);
        row(t, "real-time factor", &clock);
    }
}

fn factor(sim_time_s: f64, wall_time_s: f64) -> f64 {
    if wall_time_s > 0.0 { sim_time_s / wall_time_s } else { 0.0 }
}

/// What stands for a figure that nobody knows.
const UNKNOWN: &str = "(nobody knows)";

fn known<T>(value: Option<T>, words: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| UNKNOWN.to_owned(), words)
}

fn counts(counts: [Option<u32>; 3]) -> String {
    match counts {
        [Some(a), Some(b), Some(c)] => format!("{a}, {b}, {c}"),
        _ => UNKNOWN.to_owned(),
    }
}

fn row(table: &mut String, name: &str, value: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(table, "{name:<22} {value}");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary() -> Summary {
        Summary {
            outcome: Outcome::Solved,
            reason: "the cube in the plant is solved".into(),
            ended_by: EndedBy::Task,
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
            accidents: Some(vec![]),
            turned_deg: None,
            phases: vec![Phase { name: "acquire".into(), sim_time_s: 10.0, wall_time_s: 0.5 }],
            hash: "ab".into(),
            servo_hash: "cd".into(),
            plant_hash: None,
            uncalibrated: Vec::new(),
        }
    }

    #[test]
    fn peaks_are_never_null_and_the_object_is_one_line() {
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
    fn the_table_tells_each_accident_with_its_time() {
        let mut s = summary();
        s.accidents = Some(vec![Accident { time_s: 12.34, what: "it fell".into() }]);

        assert!(s.table().contains("12.3 s: it fell\n"), "{}", s.table());
    }

    #[test]
    fn the_exit_code_follows_verdict_and_class() {
        let mut s = summary();
        assert_eq!(s.exit_code(), 0);
        s.ended_by = EndedBy::Interrupt;
        assert_eq!(s.exit_code(), 0, "what only the operator ends ended well");
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
    fn the_table_has_a_row_for_each_phase_and_the_verdict_last() {
        let table = summary().table();

        assert!(table.contains("acquire"));
        assert!(table.trim_end().lines().last().unwrap().starts_with("SOLVED"));
    }
}
