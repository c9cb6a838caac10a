//! `rubik-robot kinematics`: one row of numbers in, one line of JSON out.
//!
//! - in: CSV rows of rad and m; joints are q1..q6, before them d0 for an arm on a track
//! - out: `fk` `base_from_flange` and `base_from_tool` as three rows of four; `ik` `joints`;
//!   `motors` `motors`; each with `limits`, the list of what is exceeded; or `error` in place of
//!   the answer

use super::output::{Output, next_line, refuse};
use crate::kinematics::ArmModel;
use crate::motion::{AXES, JointPositions, MoveRefused};
use crate::scenario;
use crate::spatial::Pose;
use clap::{Args, ValueEnum};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};
use serde::Serialize;
use std::io::{self, BufRead, Write};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub(super) struct KinematicsArgs {
    /// What is asked of each row
    question: Question,
    /// Effector of the scenario: track or postument in the built-in cell
    #[arg(long)]
    arm: String,
    /// Take arms and tools from this scenario instead of the built-in cell
    #[arg(long)]
    scenario: Option<PathBuf>,
    /// Answers are lines of JSON anyway; the option is accepted for the sake of habit
    #[arg(long)]
    json: bool,
}

/// A question about each row.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Question {
    /// Joints -> base_from_flange, base_from_tool
    Fk,
    /// base_from_tool and the current joints -> joints
    Ik,
    /// Joints -> motors
    Motors,
}

/// Answers the rows of stdin; returns the exit code.
pub(super) fn run(args: &KinematicsArgs, output: &mut Output) -> anyhow::Result<u8> {
    let loaded = match &args.scenario {
        Some(path) => scenario::load(path, &[]),
        None => scenario::read(Path::new("the built-in cell"), "", &[]),
    };
    let scenario = loaded.map_err(refuse)?;
    let arms = &scenario.controller.cell.arms;
    let Some(arm) = arms.iter().find(|a| a.name == args.arm) else {
        let names: Vec<&str> = arms.iter().map(|a| a.name.as_str()).collect();
        return Err(refuse(format!("--arm {}: there are {}", args.arm, names.join(" and "))));
    };
    let rows = std::io::stdin().lock();
    output.write(|to| stream(args.question, &arm.model, &arm.flange_from_tool, rows, to))?;
    Ok(0)
}

/// How far the rotation of a row may be from an orthonormal one: rows with six decimals pass.
const ORTHONORMAL: f64 = 1e-5;

#[derive(Serialize)]
struct Poses {
    base_from_flange: [[f64; 4]; 3],
    base_from_tool: [[f64; 4]; 3],
    limits: Vec<String>,
}

#[derive(Serialize)]
struct Joints<'a> {
    joints: &'a [f64],
    limits: Vec<String>,
}

#[derive(Serialize)]
struct Motors<'a> {
    motors: &'a [f64],
    limits: Vec<String>,
}

/// No row of numbers is longer (bytes).
const LONGEST: usize = 1 << 16;

#[derive(Serialize)]
struct Refusal {
    error: String,
}

/// Answers all rows, one line of JSON each, in their order. Bytes that are no text make a bad row,
/// not an end.
///
/// # Errors
/// Those of reading and writing; a closed pipe is one of the latter.
pub(crate) fn stream(
    question: Question,
    model: &ArmModel,
    flange_from_tool: &Pose,
    mut rows: impl BufRead,
    mut answers: impl Write,
) -> io::Result<()> {
    let mut row = Vec::new();
    while let Some(whole) = next_line(&mut rows, LONGEST, &mut row)? {
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

/// The line of JSON that answers a row, without its end of line; `None` for an empty line and for a
/// comment (`#`), which are not rows. A header row is answered as any other row that holds no
/// numbers: by its error.
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

fn forward(model: &ArmModel, flange_from_tool: &Pose, line: &str) -> Result<String, String> {
    let joints = joints_of(model, &numbers(line, axes(model), "joints")?);
    let base_from_flange = model.base_from_flange(&joints);
    Ok(json(&Poses {
        base_from_flange: rows(&base_from_flange),
        base_from_tool: rows(&(base_from_flange * flange_from_tool)),
        limits: limits(model, &joints),
    }))
}

fn inverse(model: &ArmModel, flange_from_tool: &Pose, line: &str) -> Result<String, String> {
    let what = "numbers: base_from_tool by rows (12), then the current joints";
    let numbers = numbers(line, 12 + axes(model), what)?;
    let base_from_tool = pose_of(&numbers[..12])?;
    let near = joints_of(model, &numbers[12..]);
    let joints = model
        .inverse(&(base_from_tool * flange_from_tool.inverse()), &near)
        .map_err(|refused| refused.to_string())?;
    Ok(json(&Joints { joints: &joints.0[AXES - axes(model)..], limits: limits(model, &joints) }))
}

fn motors(model: &ArmModel, line: &str) -> Result<String, String> {
    let joints = joints_of(model, &numbers(line, axes(model), "joints")?);
    let motors = model.motors(&joints);
    Ok(json(&Motors { motors: &motors.0[AXES - axes(model)..], limits: limits(model, &joints) }))
}

/// Numbers that stand for the joints of an arm.
fn axes(model: &ArmModel) -> usize {
    if model.has_track { AXES } else { AXES - 1 }
}

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

fn joints_of(model: &ArmModel, numbers: &[f64]) -> JointPositions {
    let mut joints = JointPositions::default();
    joints.0[AXES - axes(model)..].copy_from_slice(numbers);
    joints
}

fn pose_of(m: &[f64]) -> Result<Pose, String> {
    let matrix = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let error = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    if !(error < ORTHONORMAL && matrix.determinant() > 0.0) {
        return Err(if error < ORTHONORMAL {
            "columns 1-3, 5-7, 9-11 are a reflection, no rotation".to_owned()
        } else {
            format!("columns 1-3, 5-7, 9-11 are no rotation: off by {error:.2e}")
        });
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Ok(Pose::from_parts(Translation3::new(m[3], m[7], m[11]), rotation))
}

fn rows(pose: &Pose) -> [[f64; 4]; 3] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)]))
}

fn limits(model: &ArmModel, joints: &JointPositions) -> Vec<String> {
    let motors = model.motors(joints);
    let excesses = model.joint_excesses(joints).chain(model.motor_excesses(&motors));
    excesses.map(|excess: MoveRefused| excess.to_string()).collect()
}

fn json(answer: &impl Serialize) -> String {
    // Only finite numbers and strings come here, so this cannot fail; if it did, the row still gets
    // a line.
    serde_json::to_string(answer).unwrap_or_else(|error| format!("{{\"error\":\"{error}\"}}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arms::builtin;
    use serde_json::Value;

    fn ask(question: Question, arm: &str, line: &str) -> Value {
        let tool = Pose::translation(0.0, 0.0, 0.25);
        let text = answer(question, &builtin(arm).unwrap(), &tool, line).unwrap();
        serde_json::from_str(&text).unwrap()
    }

    #[test]
    fn fk_gives_flange_and_tool_in_the_frame_on_the_floor() {
        let pose =
            ask(Question::Fk, "irp6_postument", "0,-1.5707963267948966,0,0,1.5707963267948966,0");

        let at = |name: &str, row: usize| pose[name][row][3].as_f64().unwrap();
        assert!((at("base_from_flange", 0) - 0.86).abs() < 1e-12);
        assert!((at("base_from_flange", 2) - (0.95 + 0.455)).abs() < 1e-12);
        assert!((at("base_from_tool", 2) - (0.95 + 0.455 + 0.25)).abs() < 1e-12);
        assert_eq!(pose["limits"], Value::Array(vec![]));
    }

    #[test]
    fn exceeded_limits_are_named_and_the_row_is_still_answered() {
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
    fn a_bad_row_is_answered_by_its_error_in_its_place() {
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
    fn a_stream_has_one_answer_for_each_row_in_order() {
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
