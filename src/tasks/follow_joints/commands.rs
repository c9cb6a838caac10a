//! The check of joint commands before an arm follows them.
//!
//! - in: names and positions of a message, its age, the states of the arms
//! - out: the targets of the arms, or the reason why the command is refused

use super::SENSOR;
use crate::generators::follow::Targets;
use crate::motion::{AXES, ArmState, JointPositions};

/// Joints of an arm as other programs know them: those of the URDF.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ArmJoints {
    /// Name of the arm.
    pub(super) name: String,
    /// Whether the arm has joint 0, the track.
    pub(super) has_track: bool,
    /// Limits of the joints (m or rad).
    pub(super) limits: [(f64, f64); AXES],
}

impl ArmJoints {
    /// Returns the numbers of the arm's joints.
    fn axes(&self) -> std::ops::Range<usize> {
        usize::from(!self.has_track)..AXES
    }

    /// Returns the name of a joint in the URDF.
    fn joint(&self, axis: usize) -> String {
        format!("{}_link{axis}_joint", self.name)
    }
}

/// Joint command as it came.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Command {
    /// Names of joints with their positions (m or rad).
    pub(super) positions: Vec<(String, f64)>,
    /// Time since it came (s).
    pub(super) age: f64,
}

/// Limits of a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Limits {
    /// Greatest age (s).
    pub(super) stale: f64,
    /// Greatest distance of a rotary joint from that of the arm (rad).
    pub(super) jump: f64,
    /// Greatest distance of the track from that of the arm (m).
    pub(super) track_jump: f64,
}

/// Returns the targets of the arms by a command; none for an arm that it does not name, and for all
/// if the command is stale.
///
/// # Errors
/// The reason why the command is refused. No arm follows a part of a command.
pub(super) fn targets(
    command: &Command,
    limits: &Limits,
    known: &[ArmJoints],
    arms: &[ArmState],
) -> Result<Targets, String> {
    // A command without an age, as NaN, is stale as well.
    if command.age.is_nan() || command.age > limits.stale {
        return Ok(Targets { arms: vec![None; known.len()] });
    }
    let mut found = vec![[None; AXES]; known.len()];
    for (name, position) in &command.positions {
        let (arm, axis) = place(name, known)?;
        if found[arm][axis].replace(*position).is_some() {
            return Err(format!("the command names the joint {name} twice"));
        }
    }
    let of_arm = |((joints, found), state): ((&ArmJoints, &[Option<f64>; AXES]), &ArmState)| {
        if found.iter().all(Option::is_none) {
            return Ok(None);
        }
        let mut target = state.desired_joints;
        for axis in joints.axes() {
            let name = joints.joint(axis);
            let position = found[axis].ok_or_else(|| {
                format!("the command has no {name}, but other joints of this arm")
            })?;
            check(&name, axis, position, (joints, limits, &state.desired_joints))?;
            target.0[axis] = position;
        }
        Ok(Some(target))
    };
    let arms: Result<_, String> = known.iter().zip(&found).zip(arms).map(of_arm).collect();
    Ok(Targets { arms: arms? })
}

/// Returns the arm and the number of a joint by its name.
fn place(name: &str, known: &[ArmJoints]) -> Result<(usize, usize), String> {
    let all = known.iter().enumerate();
    let mut all = all.flat_map(|(i, arm)| arm.axes().map(move |axis| (i, axis, arm.joint(axis))));
    let found = all.find(|(_, _, joint)| joint == name).map(|(arm, axis, _)| (arm, axis));
    found.ok_or_else(|| {
        let first = known.first().map(|arm| arm.joint(1)).unwrap_or_default();
        format!("{SENSOR}: there is no joint \"{name}\": names are those of the URDF, as {first}")
    })
}

/// Checks the position of a joint against its limits, and against the set position of the arm.
fn check(
    name: &str,
    axis: usize,
    position: f64,
    (joints, limits, arm): (&ArmJoints, &Limits, &JointPositions),
) -> Result<(), String> {
    let (scale, unit) = if axis == 0 { (1e3, "mm") } else { (1.0_f64.to_degrees(), "deg") };
    let (low, high) = joints.limits[axis];
    if !(low..=high).contains(&position) {
        return Err(format!(
            "{name}: {:.1} {unit} is outside its limits, {:.1} to {:.1} {unit}",
            position * scale,
            low * scale,
            high * scale
        ));
    }
    let most = if axis == 0 { limits.track_jump } else { limits.jump };
    let jump = (position - arm.0[axis]).abs();
    if jump.is_nan() || jump > most {
        return Err(format!(
            "{name}: a jump of {:.1} {unit} from the arm, at most {:.1} {unit}",
            jump * scale,
            most * scale
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { stale: 0.5, jump: 0.3, track_jump: 0.1 };

    /// Returns two arms, of which the first has a track.
    fn known() -> [ArmJoints; 2] {
        [("track", true), ("postument", false)].map(|(name, has_track)| ArmJoints {
            name: name.to_owned(),
            has_track,
            limits: [(-1.0, 1.0); AXES],
        })
    }

    /// Returns a command with this age for the joints `axes` of an arm, all at `position`.
    fn command(arm: &str, axes: std::ops::Range<usize>, position: f64) -> Command {
        let named = axes.map(|axis| (format!("{arm}_link{axis}_joint"), position));
        Command { positions: named.collect(), age: 0.1 }
    }

    /// Checks a command for arms whose joints are all at 0.9.
    fn checked(command: &Command) -> Result<Vec<Option<[f64; AXES]>>, String> {
        let state = ArmState { desired_joints: JointPositions([0.9; AXES]), ..Default::default() };
        let targets = targets(command, &LIMITS, &known(), &[state; 2])?;
        Ok(targets.arms.into_iter().map(|arm| arm.map(|joints| joints.0)).collect())
    }

    #[test]
    fn command_moves_named_arms_only() {
        let mut wanted = [0.85; AXES];
        assert_eq!(checked(&command("track", 0..7, 0.85)), Ok(vec![Some(wanted), None]));
        wanted[0] = 0.9;
        assert_eq!(checked(&command("postument", 1..7, 0.85)), Ok(vec![None, Some(wanted)]));
        assert_eq!(checked(&Command { positions: vec![], age: 0.0 }), Ok(vec![None; 2]));
    }

    #[test]
    fn stale_command_lets_arms_hold() {
        for age in [0.51, f64::INFINITY, f64::NAN] {
            let old = Command { age, ..command("track", 0..7, 0.85) };
            assert_eq!(checked(&old), Ok(vec![None; 2]), "{age}");
        }
    }

    #[test]
    fn wrong_commands_are_refused_with_reason() {
        let why = |command: &Command| checked(command).unwrap_err();

        assert!(why(&command("moon", 1..7, 0.9)).contains("no joint \"moon_link1_joint\""));
        // The postument has no track.
        assert!(why(&command("postument", 0..7, 0.9)).contains("no joint \"postument_link0"));
        let part = why(&command("track", 0..6, 0.9));
        assert!(part.contains("the command has no track_link6_joint"), "{part}");
        let outside = why(&command("track", 0..7, 1.1));
        assert!(outside.contains("track_link0_joint: 1100.0 mm is outside"), "{outside}");
        let far = why(&command("postument", 1..7, 0.5));
        assert!(far.contains("postument_link1_joint: a jump of 22.9 deg"), "{far}");
        let mut far = command("track", 0..7, 0.85);
        far.positions[0].1 = 0.79;
        assert!(why(&far).contains("track_link0_joint: a jump of 110.0 mm"));
        for number in [f64::NAN, f64::INFINITY] {
            assert!(why(&command("track", 0..7, number)).contains("is outside its limits"));
        }
        let mut twice = command("track", 0..7, 0.9);
        twice.positions.push(twice.positions[3].clone());
        assert!(why(&twice).contains("names the joint track_link3_joint twice"));
        // A wrong joint of one arm holds both.
        let mut both = command("track", 0..7, 0.9);
        both.positions.extend(command("postument", 1..7, 2.0).positions);
        assert!(why(&both).contains("postument_link1_joint"));
    }
}
