//! The checks that the motors can reach the speeds of a scenario, and that no guarded direction
//! makes its own tool vibrate.
//!
//! | key | refused |
//! |---|---|
//! | `profile` | "swift" on hardware |
//! | `turn_speed`, `roll_speed`, `track_speed` | a motor would exceed its speed limit |
//! | `joint_speed` | no motor reaches it: slower joints move at the speed of their motors |
//! | `approach_speed` | the blow on a held cube would exceed the force limit: [`tff::impact`] |
//! | `approach_speed`, `turn_speed` | the tool would excite itself: [`tff::self_excitation`] |
//! | `visual_servo.inertia` | the tool would excite itself |
//! | `linear_admittance`, `angular_admittance` | the tool would excite itself |
//!
//! The speeds of coupled joints depend on the posture. The servo and the guard of paths check them
//! along each path.
//!
//! With a virtual mass M beyond `m / (2 z L)`, where m is the mass of the tool, z the damping of
//! the arm and L the greatest loop gain, no admittance and no speed makes the tool excite itself.
//! That is 22 kg with a cube in the hand. With the usual 20 kg only an admittance far beyond the
//! permitted one would, so the blow alone limits the speed of an approach.
//!
//! Rotations are checked at the same frequency as translations. A locked arm would let its tool
//! tilt at 56 Hz and more, but the regulators of its motors follow nothing so fast.

use super::keys::{Control, Profile};
use super::root::Root;
use super::section::Reader;
use crate::cell::Arm;
use crate::generators::{guarded_admittance, turn};
use crate::kinematics::ArmModel;
use crate::motion::ROLL;
use crate::servo::path::GOVERNED_SPEED_SHARE;
use crate::servo::tff;

/// Index of the track. Its motor drives no other joint, and neither does that of the roll, so their
/// speeds do not depend on the posture.
const TRACK: usize = 0;

/// Index of the wrist roll, whose gear is the fastest of the joints.
const WRIST: usize = 5;

/// Delay of the force loop in servo periods: one for the sensor, one for the exchange, half of one
/// for the mean of two samples. `control.force_delay_periods` is left out: it makes the controller
/// wrong on purpose.
const DELAY: f64 = 2.5;
/// Radius of gyration of a gripper about its own centre (m), about any axis: 0.006 kg m2 at 1.1 kg.
/// About its long axis a gripper has less, so the check is on the safe side there.
const GYRATION: f64 = 0.074;

/// Checks speeds and forces of the motions of a scenario.
pub(super) fn checks(root: &Root, arms: &[Option<Arm>], reader: &mut Reader) {
    profile(root, reader);
    speeds(&root.control, arms, reader);
    impact(&root.control, reader);
    self_excitation(root, arms, reader);
}

/// Checks that hardware runs with the gentle profile of speeds, "workshop".
fn profile(root: &Root, reader: &mut Reader) {
    let (kind, profile) = (root.bridge.kind, root.profile());
    if profile != Profile::Workshop && kind.is_hardware() {
        let reason = format!(
            "`control.profile`: \"{}\" is tested on the simulated plant only, but \
             `bridge.kind` is \"{}\"",
            profile.word(),
            root.bridge.kind.word()
        );
        let advice = "set profile = \"workshop\" and raise single keys step by step";
        reader.fault_with_help("control.profile", reason, advice);
    }
}

/// Checks that the motors of all arms reach the speeds of turn, roll and track in `control`.
fn speeds(control: &Control, arms: &[Option<Arm>], reader: &mut Reader) {
    for arm in arms.iter().flatten() {
        let c = control;
        // Beyond the share `GOVERNED_SPEED_SHARE` the servo slows a turn down (servo::path).
        for (key, axis, speed, share, unit) in [
            ("turn_speed_deg_s", ROLL, c.turn_speed, GOVERNED_SPEED_SHARE, Unit::Degrees),
            ("roll_speed_deg_s", ROLL, c.roll_speed, 1.0, Unit::Degrees),
            ("joint_speed_deg_s", WRIST, c.joint_speed, 1.0, Unit::Degrees),
            ("track_speed_mm_s", TRACK, c.track_speed, 1.0, Unit::Millimetres),
        ] {
            let limit = share * arm.model.motor_speed_limit;
            if let Some((needed, most)) = too_fast(&arm.model, axis, speed, limit) {
                let reason = format!(
                    "`control.{key}`: {} needs {needed:.0} rad/s of motor {axis} of the {}, whose \
                     limit is {limit:.0} rad/s",
                    unit.write(speed),
                    arm.name
                );
                // Rounded down, so that the advised speed passes the check.
                let advice = format!("at most {}", unit.write(most));
                reader.fault_with_help(&format!("control.{key}"), reason, &advice);
            }
        }
    }
}

/// Unit of a speed in the messages.
#[derive(Clone, Copy)]
enum Unit {
    Degrees,
    Millimetres,
}

impl Unit {
    /// Writes a speed (rad/s, m/s) with its unit, rounded down.
    fn write(self, speed: f64) -> String {
        match self {
            Self::Degrees => format!("{} deg/s", down(speed.to_degrees())),
            Self::Millimetres => format!("{} mm/s", down(speed * 1e3)),
        }
    }
}

/// Rounds down to a tenth.
fn down(value: f64) -> f64 {
    // The small term keeps a full tenth that the conversion of units has made a little smaller.
    (value * 10.0 + 1e-6).floor() / 10.0
}

/// Returns `None` if the motor of an axis, which reaches `limit` (rad/s), can move it at `speed`
/// (rad/s, m/s). Otherwise returns the motor speed that would be needed (rad/s), and the greatest
/// speed of the axis (rad/s, m/s).
fn too_fast(model: &ArmModel, axis: usize, speed: f64, limit: f64) -> Option<(f64, f64)> {
    if axis == TRACK && !model.has_track {
        return None;
    }
    let gear = model.gears[axis].abs();
    let needed = gear * speed;
    (needed > limit).then(|| (needed, limit / gear))
}

/// Checks that an approach does not strike a held cube harder than the force limit allows.
fn impact(control: &Control, reader: &mut Reader) {
    let c = control;
    // The approach goes on until the force has reached its threshold, and the blow comes on top.
    let least = c.approach_force;
    let strikes = least + tff::impact(c.approach_speed, c.linear_inertia);
    if strikes <= c.force_limit {
        return;
    }
    let reason = format!(
        "`control.approach_speed_mm_s`: an approach at {:.1} mm/s would strike the cube in the \
         other hand with {strikes:.0} N, more than control.force_limit_n = {:.0}",
        c.approach_speed * 1e3,
        c.force_limit
    );
    let fastest = (c.force_limit - least).max(0.0) / tff::impact(1.0, c.linear_inertia);
    let advice = format!(
        "at most {} mm/s, or a smaller control.linear_inertia_kg or control.approach_force_n",
        down(fastest * 1e3)
    );
    reader.fault_with_help("control.approach_speed_mm_s", reason, &advice);
}

/// Checks that no force-controlled direction makes its arm vibrate by the inertia of the tool,
/// which the force sensor measures. The gain of that loop is [`tff::self_excitation`].
fn self_excitation(root: &Root, arms: &[Option<Arm>], reader: &mut Reader) {
    let (c, visual_servo, period) = (&root.control, &root.visual_servo, root.real_time.period);
    let (speed, force) = c.visual_approach();
    let visual = guarded_admittance(speed, force);
    // A pull at a cube in the other gripper ends at half the force of an approach, so its
    // admittance is twice as large and the approach needs no check of its own.
    let pull = guarded_admittance(c.approach_speed, 0.5 * c.approach_force);
    let turn_admittance = turn::most_ordered(c.turn_speed) / c.turn_torque;
    for arm in arms.iter().flatten() {
        let (mass, moment, about_z) = inertia(arm);
        // A hand that yields may hold the cube alone.
        let mass = mass + root.cube.mass;
        // Each row: key, admittance, virtual inertia, and mass or moment of inertia of the tool.
        // The first two rows are the visual servo along and across its approach.
        let rows = [
            ("visual_servo.inertia_kg", visual, visual_servo.inertia, mass),
            ("visual_servo.inertia_kg", c.linear_admittance, visual_servo.inertia, mass),
            ("control.approach_speed_mm_s", pull, c.linear_inertia, mass),
            ("control.linear_admittance_mm_sn", c.linear_admittance, c.linear_inertia, mass),
            ("control.turn_speed_deg_s", turn_admittance, 0.0, about_z),
            ("control.angular_admittance_rad_snm", c.angular_admittance, c.angular_inertia, moment),
        ];
        let most = tff::MOST_SELF_EXCITATION;
        for (key, admittance, inertia, tool) in rows {
            let (frequency, damping) = (c.resonance, c.resonance_damping);
            let mechanics = tff::Mechanics { tool, frequency, damping, delay: DELAY * period };
            let gain = tff::self_excitation(admittance, inertia, &mechanics);
            if gain <= most {
                continue;
            }
            let reason = format!(
                "`{key}`: the {} would excite its own vibration at about {frequency:.0} \
                 Hz, because the force sensor measures the inertia of the tool: the loop gain is \
                 {gain:.2}, the limit is {most}",
                arm.name
            );
            // The visual servo has its own inertia, and its speed follows from that of the
            // approach.
            let advice = if key == "visual_servo.inertia_kg" {
                "raise it, or lower control.approach_speed_mm_s or control.linear_admittance_mm_sn"
            } else {
                "lower it, or raise the virtual inertia (control.linear_inertia_kg, \
                 control.angular_inertia_kgm2)"
            };
            reader.fault_with_help(key, reason, advice);
        }
    }
}

/// Returns the mass of the load beyond the sensor (kg), its greatest moment of inertia about the
/// tool point, and the one about the axis of the tool (kg m2). The force law turns the hand about
/// the tool point.
fn inertia(arm: &Arm) -> (f64, f64, f64) {
    let mass = arm.sensor.mass();
    let own = mass * GYRATION * GYRATION;
    let off = arm.sensor.centre_in_flange.coords - arm.flange_from_tool.translation.vector;
    // The load is close to the axis of the tool, so only its own moment counts about it.
    (mass, own + mass * off.norm_squared(), own)
}

#[cfg(test)]
mod tests {
    use crate::tasks::read;
    use std::path::Path;

    /// Returns the faults of a scenario whose section `control` is `keys`; empty if there are none.
    fn faults(keys: &str) -> String {
        let text = format!("[control]\n{keys}\n");
        read(Path::new("t.toml"), &text, &[])
            .map_or_else(|faults| faults.to_string(), |_| String::new())
    }

    #[test]
    fn speed_above_motor_limit_is_refused() {
        let message = faults("turn_speed_deg_s = 60");
        assert!(
            message.contains("t.toml:2:20: `control.turn_speed_deg_s`: 60 deg/s needs"),
            "{message}"
        );
        assert!(message.contains("of motor 6 of the track, whose limit is 24"), "{message}");
        assert!(message.contains("at most 48.3 deg/s"), "{message}");
        assert_eq!(faults("turn_speed_deg_s = 48"), "");
        for (key, fast, motor, most) in [
            ("roll_speed_deg_s", "50", 6, "49.5 deg/s"),
            ("joint_speed_deg_s", "187", 5, "186.5 deg/s"),
            ("track_speed_mm_s", "160", 0, "159.1 mm/s"),
        ] {
            let message = faults(&format!("{key} = {fast}"));
            for words in [format!("`control.{key}`: {fast} "), format!("of motor {motor} of the")] {
                assert!(message.contains(&words), "no `{words}` in {message}");
            }
            assert!(message.contains(&format!("at most {most}")), "{message}");
            let (slower, _) = most.split_once(' ').unwrap();
            assert_eq!(faults(&format!("{key} = {slower}")), "");
        }
    }

    #[test]
    fn default_turn_speed_is_lower_on_hardware() {
        // Returns the speed of a turn (deg/s), or the faults of the scenario.
        let speed = |bridge: &str, keys: &str| {
            let pace = if bridge == "plant" { "virtual" } else { "real-time" };
            let text =
                format!("pace = \"{pace}\"\n[bridge]\nkind = \"{bridge}\"\n[control]\n{keys}\n");
            read(Path::new("t.toml"), &text, &[])
                .map(|scenario| scenario.controller.control.turn_speed.to_degrees().round())
                .map_err(|faults| faults.to_string())
        };
        // The default profile is "swift" in simulation and "workshop" on hardware.
        assert_eq!(speed("plant", ""), Ok(41.0));
        assert_eq!(speed("plant", "profile = \"workshop\""), Ok(25.0));
        assert_eq!(
            speed("plant", "turn_speed_deg_s = 30"),
            Ok(30.0),
            "a key overrides the profile"
        );
        assert_eq!(speed("serial", ""), Ok(25.0));
        assert_eq!(speed("serial", "turn_speed_deg_s = 30"), Ok(30.0));
        let message = speed("serial", "profile = \"swift\"").unwrap_err();
        assert!(
            message.contains("t.toml:5:11: `control.profile`: \"swift\" is tested"),
            "{message}"
        );
        assert!(message.contains("`bridge.kind` is \"serial\""), "{message}");
    }

    #[test]
    fn guarded_motion_that_excites_tool_vibration_is_refused() {
        let message = faults("approach_speed_mm_s = 40\nlinear_inertia_kg = 0");
        assert!(message.contains("t.toml:2:23: `control.approach_speed_mm_s`"), "{message}");
        assert!(message.contains("excite its own vibration at about 31 Hz"), "{message}");
        let sideways = "approach_speed_mm_s = 2\nlinear_admittance_mm_sn = 2\n[visual_servo]\n";
        for (keys, key) in [
            ("[visual_servo]\ninertia_kg = 5", "visual_servo.inertia_kg"),
            (&format!("{sideways}inertia_kg = 10"), "visual_servo.inertia_kg"),
            // The pull fails; the approach alone would pass.
            ("approach_speed_mm_s = 20\nlinear_inertia_kg = 0", "control.approach_speed_mm_s"),
            (
                "linear_admittance_mm_sn = 20\nlinear_inertia_kg = 0\napproach_speed_mm_s = 2",
                "control.linear_admittance_mm_sn",
            ),
            (
                "angular_admittance_rad_snm = 5\nangular_inertia_kgm2 = 0",
                "control.angular_admittance_rad_snm",
            ),
        ] {
            let message = faults(keys);
            let wanted = format!("`{key}`: the track would excite its own vibration");
            assert!(message.contains(&wanted), "no {wanted} in {message}");
        }
        assert_eq!(faults("approach_speed_mm_s = 10\nlinear_inertia_kg = 0"), "");
    }

    #[test]
    fn tool_vibration_check_counts_cube_and_lever() {
        // A moment of inertia about the sensor instead of the tool point would pass.
        let tilts = |inertia: f64| {
            faults(&format!("angular_admittance_rad_snm = 1\nangular_inertia_kgm2 = {inertia}"))
        };
        let wanted = "`control.angular_admittance_rad_snm`: the track would excite";
        assert!(tilts(0.14).contains(wanted), "{}", tilts(0.14));
        assert_eq!(tilts(0.5), "");
        let heavy = "profile = \"swift\"\n[cube]\nmass_g = 400";
        assert!(faults(heavy).contains("would excite its own vibration"), "{}", faults(heavy));
    }

    #[test]
    fn tool_vibration_check_uses_the_servo_period() {
        let with = |period: f64| {
            let keys = "[control]\napproach_speed_mm_s = 5\nlinear_inertia_kg = 0\n\
                        linear_admittance_mm_sn = 0.3\n";
            let text = format!("[real_time]\nperiod_ms = {period}\n{keys}");
            read(Path::new("t.toml"), &text, &[]).map_or_else(|f| f.to_string(), |_| String::new())
        };
        assert_eq!(with(2.0), "");
        assert!(with(4.0).contains("excite its own vibration"), "{}", with(4.0));
    }

    #[test]
    fn approach_that_strikes_the_cube_is_refused() {
        let message = faults("approach_speed_mm_s = 50");
        assert!(message.contains("t.toml:2:23: `control.approach_speed_mm_s`"), "{message}");
        assert!(message.contains("50.0 mm/s would strike the cube"), "{message}");
        assert!(message.contains("at most 16.8 mm/s"), "{message}");
        assert_eq!(faults("approach_speed_mm_s = 16"), "");
        // A lighter virtual mass strikes less hard.
        assert_eq!(faults("approach_speed_mm_s = 17.5\nlinear_inertia_kg = 18"), "");
    }
}
