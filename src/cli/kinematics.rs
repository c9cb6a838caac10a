//! `rubik-robot kinematics`: answers rows of numbers with the kinematics of an arm.
//!
//! - in: CSV rows of rad and m; joints are q1..q6, with d0 before them for an arm on a track
//! - out: a line of JSON for each row. `fk`: `base_from_flange` and `base_from_tool` as three rows
//!   of four; `ik`: `joints`; `motors`: `motors`; each with `limits`, the list of exceeded limits.
//!   A wrong row gives `error` in the place of the answer

use super::catalogue;
use super::output::{Output, next_line, refuse};
use super::scenarios;
use crate::kinematics::ArmModel;
use crate::motion::{AXES, JointPositions, MoveRefused};
use crate::spatial::Pose;
use clap::{Args, ValueEnum};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};
use serde::Serialize;
use std::io::{self, BufRead, Write};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub(super) struct KinematicsArgs {
    /// Quantity to compute for each row: fk, ik or motors
    #[arg(hide_possible_values = true)]
    question: Question,
    /// Name of an effector (arm with gripper); the built-in cell has track and
    /// postument
    #[arg(long, verbatim_doc_comment)]
    arm: String,
    /// Scenario file (TOML) with the arms and tools [default: the built-in cell]
    #[arg(long, value_name = "FILE", value_parser = scenarios::parser())]
    scenario: Option<PathBuf>,
    /// No effect: answers are lines of JSON in any case
    #[arg(long)]
    json: bool,
}

/// Quantity that is computed for each row.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Question {
    /// Poses of flange and tool in the frame of the base, from joint positions
    Fk,
    /// Joint positions near the current ones, from a pose base_from_tool
    Ik,
    /// Motor positions, from joint positions
    Motors,
}

/// Computes the quantity of `args` for each row of numbers on stdin; returns the exit code.
pub(super) fn run(args: &KinematicsArgs, output: &mut Output) -> anyhow::Result<u8> {
    // The built-in cell is a scenario that sets no key.
    let loaded = match &args.scenario {
        Some(path) => catalogue::load(path, &[]),
        None => catalogue::read(Path::new("the built-in cell"), "", &[]),
    };
    let scenario = loaded.map_err(refuse)?;
    let arms = &scenario.controller.cell.arms;
    let Some(arm) = arms.iter().find(|a| a.name == args.arm) else {
        let names: Vec<&str> = arms.iter().map(|a| a.name.as_str()).collect();
        let names = names.join(" and ");
        return Err(refuse(format!(
            "--arm {}: the scenario has no such arm; it has {names}",
            args.arm
        )));
    };
    let rows = std::io::stdin().lock();
    output.write(|to| stream(args.question, &arm.model, &arm.flange_from_tool, rows, to))?;
    Ok(0)
}

/// Largest element of `R^T R - I` for a rotation matrix R of a row: six decimals are enough.
const ORTHONORMAL: f64 = 1e-5;

/// Answer to a row of `fk`: the upper three rows of two homogeneous matrices (m).
#[derive(Serialize)]
struct Poses {
    base_from_flange: [[f64; 4]; 3],
    base_from_tool: [[f64; 4]; 3],
    limits: Vec<String>,
}

/// Answer to a row of `ik` (rad; m for the track).
#[derive(Serialize)]
struct Joints<'a> {
    joints: &'a [f64],
    limits: Vec<String>,
}

/// Answer to a row of `motors` (rad).
#[derive(Serialize)]
struct Motors<'a> {
    motors: &'a [f64],
    limits: Vec<String>,
}

/// Largest length of a row (bytes).
const LONGEST: usize = 1 << 16;

/// Answer to a wrong row.
#[derive(Serialize)]
struct Refusal {
    error: String,
}

/// Answers all rows in their order, each by one line of JSON. Bytes that are not UTF-8 make a wrong
/// row and do not end the stream.
///
/// # Errors
/// Errors of reading and writing. A closed pipe is an error of writing.
pub(crate) fn stream(
    question: Question,
    model: &ArmModel,
    flange_from_tool: &Pose,
    mut rows: impl BufRead,
    mut answers: impl Write,
) -> io::Result<()> {
    let mut row = Vec::new();
    while let Some(whole) = next_line(&mut rows, LONGEST, &mut row)? {
        // Bytes that are no text become characters that are no number.
        let line = String::from_utf8_lossy(&row);
        let answer = if whole {
            answer(question, model, flange_from_tool, &line)
        } else {
            Some(json(&Refusal { error: format!("a row of more than {LONGEST} bytes") }))
        };
        if let Some(answer) = answer {
            writeln!(answers, "{answer}")?;
        }
    }
    answers.flush()
}

/// Returns the line of JSON that answers a row, without a line break. Returns `None` for an empty
/// line and for a comment (`#`), which are no rows. A line of column names is a wrong row.
#[must_use]
pub(crate) fn answer(
    question: Question,
    model: &ArmModel,
    flange_from_tool: &Pose,
    line: &str,
) -> Option<String> {
    let line = line.trim();
    if line.is_empty() || line.starts_with('#') {
        return None;
    }
    let answered = match question {
        Question::Fk => forward(model, flange_from_tool, line),
        Question::Ik => inverse(model, flange_from_tool, line),
        Question::Motors => motors(model, line),
    };
    Some(answered.unwrap_or_else(|error| json(&Refusal { error })))
}

/// Returns the JSON answer to a row of joint positions: the poses of flange and tool in the frame
/// of the base.
fn forward(model: &ArmModel, flange_from_tool: &Pose, line: &str) -> Result<String, String> {
    let joints = joints_of(model, &numbers(line, axes(model), "joints")?);
    let base_from_flange = model.base_from_flange(&joints);
    Ok(json(&Poses {
        base_from_flange: rows(&base_from_flange),
        base_from_tool: rows(&(base_from_flange * flange_from_tool)),
        limits: limits(model, &joints),
    }))
}

/// Returns the JSON answer to a row with a pose of the tool and the current joint positions: the
/// joint positions near these that reach the pose.
fn inverse(model: &ArmModel, flange_from_tool: &Pose, line: &str) -> Result<String, String> {
    let what = "numbers: base_from_tool by rows (12), then the current joints";
    let numbers = numbers(line, 12 + axes(model), what)?;
    // The row has the pose of the tool; the inverse kinematics takes that of the flange.
    let base_from_tool = pose_of(&numbers[..12])?;
    let near = joints_of(model, &numbers[12..]);
    let joints = model
        .inverse(&(base_from_tool * flange_from_tool.inverse()), &near)
        .map_err(|refused| refused.to_string())?;
    Ok(json(&Joints { joints: &joints.0[AXES - axes(model)..], limits: limits(model, &joints) }))
}

/// Returns the JSON answer to a row of joint positions: the motor positions.
fn motors(model: &ArmModel, line: &str) -> Result<String, String> {
    let joints = joints_of(model, &numbers(line, axes(model), "joints")?);
    let motors = model.motors(&joints);
    Ok(json(&Motors { motors: &motors.0[AXES - axes(model)..], limits: limits(model, &joints) }))
}

/// Returns the number of joints of an arm.
fn axes(model: &ArmModel) -> usize {
    if model.has_track { AXES } else { AXES - 1 }
}

/// Parses a row of `count` finite numbers. `what` says in an error message what they are.
fn numbers(line: &str, count: usize, what: &str) -> Result<Vec<f64>, String> {
    let numbers = line
        .split(',')
        .enumerate()
        .map(|(i, field)| {
            let field = field.trim();
            let bad = || format!("column {}: {field:?} is not a finite number", i + 1);
            field.parse::<f64>().ok().filter(|x| x.is_finite()).ok_or_else(bad)
        })
        .collect::<Result<Vec<f64>, String>>()?;
    if numbers.len() == count {
        Ok(numbers)
    } else {
        Err(format!("{} columns instead of {count} {what}", numbers.len()))
    }
}

/// Returns the joint positions of a row. An arm without a track gets d0 = 0.
fn joints_of(model: &ArmModel, numbers: &[f64]) -> JointPositions {
    let mut joints = JointPositions::default();
    // The track is the first joint, so an arm without one begins at the second.
    joints.0[AXES - axes(model)..].copy_from_slice(numbers);
    joints
}

/// Returns the pose whose homogeneous matrix has these upper three rows, if it is a rigid motion.
fn pose_of(m: &[f64]) -> Result<Pose, String> {
    let matrix = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let error = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    if !(error < ORTHONORMAL && matrix.determinant() > 0.0) {
        // A reflection is orthonormal as well: only its determinant differs.
        return Err(if error < ORTHONORMAL {
            "columns 1-3, 5-7, 9-11 are a reflection and no rotation".to_owned()
        } else {
            format!("columns 1-3, 5-7, 9-11 are no rotation: the error is {error:.2e}")
        });
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Ok(Pose::from_parts(Translation3::new(m[3], m[7], m[11]), rotation))
}

/// Returns a pose as the upper three rows of its homogeneous matrix.
fn rows(pose: &Pose) -> [[f64; 4]; 3] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)]))
}

/// Returns a text for each limit of a joint or motor that these joint positions exceed.
fn limits(model: &ArmModel, joints: &JointPositions) -> Vec<String> {
    let motors = model.motors(joints);
    let excesses = model.joint_excesses(joints).chain(model.motor_excesses(&motors));
    excesses.map(|excess: MoveRefused| excess.to_string()).collect()
}

/// Returns an answer as a line of JSON.
fn json(answer: &impl Serialize) -> String {
    // Finite numbers and strings cannot fail. If they did, the row would still get its line.
    serde_json::to_string(answer).unwrap_or_else(|error| format!("{{\"error\":\"{error}\"}}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arms::builtin;
    use serde_json::Value;

    /// Returns the parsed answer to a row of an arm with a tool of 250 mm.
    fn ask(question: Question, arm: &str, line: &str) -> Value {
        let tool = Pose::translation(0.0, 0.0, 0.25);
        let text = answer(question, &builtin(arm).unwrap(), &tool, line).unwrap();
        serde_json::from_str(&text).unwrap()
    }

    #[test]
    fn fk_gives_poses_in_the_base_frame() {
        let pose =
            ask(Question::Fk, "irp6_postument", "0,-1.5707963267948966,0,0,1.5707963267948966,0");

        let at = |name: &str, row: usize| pose[name][row][3].as_f64().unwrap();
        assert!((at("base_from_flange", 0) - 0.86).abs() < 1e-12);
        assert!((at("base_from_flange", 2) - (0.95 + 0.455)).abs() < 1e-12);
        assert!((at("base_from_tool", 2) - (0.95 + 0.455 + 0.25)).abs() < 1e-12);
        assert_eq!(pose["limits"], Value::Array(vec![]));
    }

    #[test]
    fn answer_names_the_limits_that_joints_exceed() {
        let pose = ask(Question::Fk, "irp6_track", "2.0,0.5,-1.2,0.3,0.4,1.0,-0.5");

        let limits: Vec<_> = pose["limits"].as_array().unwrap().iter().collect();
        assert!(limits.iter().any(|l| l.as_str().unwrap().starts_with("joint 0")), "{limits:?}");
        assert!(limits.iter().any(|l| l.as_str().unwrap().starts_with("motor 3")), "{limits:?}");
        assert!(pose["base_from_tool"][0][0].is_f64());
    }

    #[test]
    fn ik_gives_back_the_joints_of_fk() {
        let q = [0.4, 0.3, -1.5, 0.1, 0.4, 1.3, 0.2];
        let line = q.map(|x| x.to_string()).join(",");
        let pose = ask(Question::Fk, "irp6_track", &line);
        let mut row: Vec<String> = Vec::new();
        for r in pose["base_from_tool"].as_array().unwrap() {
            row.extend(r.as_array().unwrap().iter().map(ToString::to_string));
        }

        let found = ask(Question::Ik, "irp6_track", &format!("{},{line}", row.join(",")));

        for (i, wanted) in q.iter().enumerate() {
            assert!((found["joints"][i].as_f64().unwrap() - wanted).abs() < 1e-10, "{found}");
        }
    }

    #[test]
    fn bad_row_is_answered_by_its_error() {
        let error = |question, line| {
            ask(question, "irp6_postument", line)["error"].as_str().unwrap().to_owned()
        };

        assert!(error(Question::Fk, "q1,q2,q3,q4,q5,q6").contains("column 1"));
        assert!(error(Question::Motors, "0,0,0").contains("3 columns instead of 6"));
        assert!(error(Question::Fk, "0,0,nan,0,0,0").contains("column 3"));
        let zeros = ["0"; 18].join(",");
        assert!(error(Question::Ik, &zeros).contains("no rotation"));
        let mirror = format!("-1,0,0,0,0,1,0,0,0,0,1,1,{}", ["0"; 6].join(","));
        assert!(error(Question::Ik, &mirror).contains("a reflection"));
        let far = format!("1,0,0,5,0,1,0,0,0,0,1,1,{}", ["0"; 6].join(","));
        assert!(error(Question::Ik, &far).contains("out of reach"));
    }

    #[test]
    fn stream_answers_each_row_in_order() {
        let model = builtin("irp6_postument").unwrap();
        let rows = b"# six joints\n0,-1.5,0,0,1,0\r\n\xff\xfe\n\n0.1,-1.5,0,0,1,0";
        let mut answers = Vec::new();

        stream(Question::Motors, &model, &Pose::identity(), &rows[..], &mut answers).unwrap();

        let text = String::from_utf8(answers).unwrap();
        let lines: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        assert_eq!(lines.len(), 3);
        assert!((lines[0]["motors"][0].as_f64().unwrap() + 15.9).abs() < 1e-9);
        assert!(lines[1]["error"].is_string());
        assert!((lines[2]["motors"][0].as_f64().unwrap() + 31.7).abs() < 1e-9);
    }

    #[test]
    fn empty_lines_and_comments_are_no_rows() {
        let model = builtin("irp6_track").unwrap();

        for line in ["", "  ", "# d0,q1,q2,q3,q4,q5,q6"] {
            assert_eq!(answer(Question::Fk, &model, &Pose::identity(), line), None);
        }
    }
}
