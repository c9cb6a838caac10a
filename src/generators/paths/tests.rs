//! Tests of all paths: limits, ends and pauses of the sampled set values.
//!
//! The law bounds the continuous motion, so by the mean value theorem the differences of positions
//! and joints exceed the limits by rounding only: a tolerance of 1e-6. The rotation between two
//! samples is the logarithm of a product, which differs from the integral of the angular velocity
//! by commutators of the order of the macrostep: there the tolerance is 1 % of the speed, and 3 %
//! of acceleration and jerk.

use super::super::inputs::Inputs;
use super::super::outcome::{Next, Outcome};
use super::super::own::{MotionGenerator, Places, Site};
use super::super::testing::{compliance, speeds};
use super::*;
use crate::motion::{AXES, ArmState, JointPositions, Motion};
use crate::spatial::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

/// Length of a macrostep (s).
const STEP: f64 = 0.016;
/// Macrosteps from full pace to rest, as the move instruction counts them.
const RAMP: u32 = 38;

/// Runs a motion to its end. `pauses` are pairs of the macrostep at which a pause begins, and of
/// the number of macrosteps at rest. Returns the set values, the one at the beginning first.
fn run<O: PathOrder>(
    order: O,
    arm: &ArmState,
    fraction: f64,
    pauses: &[(usize, usize)],
) -> Result<Vec<Motion>, String> {
    let site = Site { compliance: compliance(), speeds: speeds(), arm, fraction };
    let mut along = Along::begin(order, &site)?;
    let mut course = vec![match along.forecast().unwrap().places {
        Places::Joints(all) => Motion::Joints(all[0]),
        Places::Poses(all) => Motion::Pose(all[0]),
    }];
    let (mut pace, mut rested, mut pauses) = (RAMP, 0, pauses.iter().peekable());
    let mut paused = false;
    loop {
        if let Some((_, rest)) = pauses.next_if(|(begin, _)| !paused && course.len() > *begin) {
            (paused, rested) = (true, *rest);
        }
        if paused && pace == 0 && along.rests() {
            rested = rested.saturating_sub(1);
            paused = rested > 0;
        }
        pace = if paused { pace.saturating_sub(1) } else { (pace + 1).min(RAMP) };
        let share = f64::from(pace) / f64::from(RAMP);
        let pace = fraction * share * share * (3.0 - 2.0 * share);
        match along.next(&Inputs { arm, target: None, reading: None, period: 0, pace }) {
            Next::Go(command) => course.push(command.motion),
            Next::Done(outcome) => {
                assert_eq!(outcome, Outcome::Reached);
                return Ok(course);
            }
        }
        assert!(course.len() < 20_000, "the motion does not end");
    }
}

/// Returns the greatest norm of each of the first three differences over time, for samples that
/// begin and end at rest.
fn peaks<const D: usize>(samples: &[[f64; D]]) -> [f64; 3] {
    let (first, last) = (samples[0], samples[samples.len() - 1]);
    let mut values = vec![first; 3];
    values.extend(samples);
    values.extend([last; 3]);
    [(); 3].map(|()| {
        values = values
            .windows(2)
            .map(|w| std::array::from_fn(|d| (w[1][d] - w[0][d]) / STEP))
            .collect();
        values.iter().map(|v| v.iter().map(|c| c * c).sum::<f64>().sqrt()).fold(0.0, f64::max)
    })
}

/// Checks that peaks are within a limit at a fraction of the speed, with these tolerances for the
/// speed and for the others.
fn within(peaks: [f64; 3], limit: &Limit, fraction: f64, tolerances: (f64, f64)) {
    let limits = [limit.speed, limit.acceleration, limit.jerk];
    for (order, (peak, most)) in peaks.into_iter().zip(limits).enumerate() {
        let tolerance = if order == 0 { tolerances.0 } else { tolerances.1 };
        let most = most * fraction.powi(order as i32 + 1) * (1.0 + tolerance) + 1e-6;
        assert!(peak <= most, "derivative {}: {peak} > {most}", order + 1);
    }
}

/// Checks the set values of a tool, which end at `to`.
fn check_tool(course: &[Motion], to: &Pose, speed: f64, fraction: f64) {
    let poses: Vec<Pose> = course
        .iter()
        .map(|motion| match motion {
            Motion::Pose(pose) => *pose,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(poses.last(), Some(to));
    let arm = ArmState::default();
    let site = Site { compliance: compliance(), speeds: speeds(), arm: &arm, fraction };
    let limits = Limits::of(&site, speed).unwrap();
    let at: Vec<[f64; 3]> = poses.iter().map(|p| p.translation.vector.into()).collect();
    within(peaks(&at), &limits.linear, fraction, (1e-6, 1e-6));
    // Angular velocities, whose sum has the differences of a rotation.
    let mut turned = [Vector3::zeros(); 1].to_vec();
    for pair in poses.windows(2) {
        let by = (pair[1].rotation * pair[0].rotation.inverse()).scaled_axis();
        turned.push(turned[turned.len() - 1] + by);
    }
    let turned: Vec<[f64; 3]> = turned.into_iter().map(Into::into).collect();
    within(peaks(&turned), &limits.angular, fraction, (0.01, 0.03));
}

/// Checks the set values of joints, which end at `to`.
fn check_joints(course: &[Motion], to: &JointPositions, speed: f64) {
    let joints: Vec<JointPositions> = course
        .iter()
        .map(|motion| match motion {
            Motion::Joints(joints) => *joints,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(joints.last(), Some(to));
    let arm = ArmState::default();
    let site = Site { compliance: compliance(), speeds: speeds(), arm: &arm, fraction: 1.0 };
    let limits = Limits::of(&site, speed).unwrap();
    for axis in 0..AXES {
        let at: Vec<[f64; 1]> = joints.iter().map(|q| [q.0[axis]]).collect();
        within(peaks(&at), &limits.joints[axis], 1.0, (1e-6, 1e-6));
    }
}

/// Draws a pose within 0.3 m of the origin, turned by up to about 1 rad.
fn pose() -> impl Strategy<Value = Pose> {
    (prop::array::uniform3(-0.3..0.3f64), prop::array::uniform3(-0.6..0.6f64)).prop_map(
        |(at, turn)| {
            Pose::from_parts(
                Vector3::from(at).into(),
                UnitQuaternion::from_scaled_axis(Vector3::from(turn)),
            )
        },
    )
}

/// Returns the state of an arm whose tool is set to this pose.
fn at(desired_base_from_tool: Pose) -> ArmState {
    ArmState { desired_base_from_tool, ..ArmState::default() }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn line_and_arc_keep_limits_despite_pauses(
        (from, to) in (pose(), pose()),
        via in prop::array::uniform3(-0.3..0.3f64),
        (speed, fraction) in (0.2..1.0f64, 0.3..1.0f64),
        begin in 5usize..120,
    ) {
        let (arm, pauses) = (at(from), [(begin, 3), (begin + 90, 20)]);
        let line = Line { target: to, speed };
        check_tool(&run(line.clone(), &arm, 1.0, &[]).unwrap(), &to, speed, 1.0);
        check_tool(&run(line, &arm, fraction, &pauses).unwrap(), &to, speed, fraction);
        let arc = Arc { via: via.into(), target: to, speed };
        // Three points on a line are refused, so they are no failure.
        if let Ok(course) = run(arc, &arm, 1.0, &pauses) {
            check_tool(&course, &to, speed, 1.0);
        }
    }

    #[test]
    fn spline_and_polyline_keep_limits_despite_pauses(
        from in pose(),
        through in prop::collection::vec(pose(), 1..5),
        radius in 0.005..0.1f64,
        (speed, fraction) in (0.2..1.0f64, 0.3..1.0f64),
        begin in 5usize..200,
    ) {
        let (arm, to) = (at(from), through[through.len() - 1]);
        let pauses = [(begin, 1), (begin + 60, 30)];
        let spline = Spline { through: through.clone(), speed };
        check_tool(&run(spline, &arm, fraction, &pauses).unwrap(), &to, speed, fraction);
        let polyline = Polyline { through: through.clone(), radius, speed };
        let course = run(polyline, &arm, 1.0, &pauses).unwrap();
        check_tool(&course, &to, speed, 1.0);
        // The tool leaves the legs only within the radius of a corner.
        let mut corners = vec![from];
        corners.extend(through);
        for motion in &course {
            let Motion::Pose(pose) = motion else { panic!("{motion:?}") };
            let p = pose.translation.vector;
            let off = |pair: &[Pose]| {
                let (a, b) = (pair[0].translation.vector, pair[1].translation.vector);
                let part = (p - a).dot(&(b - a)) / (b - a).norm_squared();
                (p - (a + (b - a) * part.clamp(0.0, 1.0))).norm()
            };
            let nearest = corners.windows(2).map(off).fold(f64::INFINITY, f64::min);
            let inner = corners.iter().map(|c| (c.translation.vector - p).norm());
            let corner = inner.fold(f64::INFINITY, f64::min);
            prop_assert!(nearest < 1e-9 || corner < radius + 1e-9, "{} {}", nearest, corner);
        }
    }

    #[test]
    fn joint_paths_keep_limits_despite_pauses(
        through in prop::collection::vec(prop::array::uniform7(-1.0..1.0f64), 1..5),
        blend in 0.05..0.5f64,
        speed in 0.2..1.0f64,
        begin in 5usize..200,
    ) {
        let arm = ArmState::default();
        let through: Vec<_> = through.into_iter().map(JointPositions).collect();
        let (to, pauses) = (through[through.len() - 1], [(begin, 2)]);
        let spline = JointSpline { through: through.clone(), speed };
        check_joints(&run(spline, &arm, 1.0, &pauses).unwrap(), &to, speed);
        let polyline = JointPolyline { through, blend, speed };
        check_joints(&run(polyline, &arm, 1.0, &pauses).unwrap(), &to, speed);
    }
}

/// A long line reaches its full speed and takes hardly longer than the limits require.
#[test]
fn long_line_uses_its_limits() {
    let to = Pose::translation(0.6, 0.0, 0.0);
    let course = run(Line { target: to, speed: 1.0 }, &at(Pose::identity()), 1.0, &[]).unwrap();

    let limit = Limit::new(0.15, 0.3);
    let xs: Vec<[f64; 1]> = course
        .iter()
        .map(|m| if let Motion::Pose(p) = m { [p.translation.x] } else { [f64::NAN] })
        .collect();
    let [speed, acceleration, jerk] = peaks(&xs);
    assert!(speed > 0.999 * limit.speed && acceleration > 0.99 * limit.acceleration);
    // The bound of the jerk is that of a change from full acceleration to full braking, so a
    // motion with a part at full speed needs half of it.
    assert!((0.45..0.55).contains(&(jerk / limit.jerk)), "{jerk}");
    // Distance over speed, speed over acceleration, and the time of the mean.
    let least = 0.6 / 0.15 + 0.15 / 0.3 + 2.0 * 0.15;
    let seconds = (course.len() - 1) as f64 * STEP;
    assert!((seconds - least).abs() < 0.1, "{seconds} s, {least} s");
}

/// A pause on a spline rests within the time of a stop, not at once and not at the end.
#[test]
fn pause_stops_line_within_stopping_distance() {
    let arm = at(Pose::identity());
    let site = Site { compliance: compliance(), speeds: speeds(), arm: &arm, fraction: 1.0 };
    let target = Pose::translation(0.6, 0.0, 0.0);
    let mut along = Along::begin(Line { target, speed: 1.0 }, &site).unwrap();
    let step = |along: &mut Along<Line>, pace: f64| match along.next(&Inputs {
        arm: &arm,
        target: None,
        reading: None,
        period: 0,
        pace,
    }) {
        Next::Go(command) => match command.motion {
            Motion::Pose(pose) => pose.translation.x,
            other => panic!("{other:?}"),
        },
        Next::Done(outcome) => panic!("{outcome:?}"),
    };
    let mut from = 0.0;
    for _ in 0..100 {
        from = step(&mut along, 1.0);
    }

    let (mut steps, mut to) = (0, from);
    while !along.rests() {
        to = step(&mut along, (0.9 - 0.1 * f64::from(steps)).max(0.0));
        steps += 1;
    }

    // Braking from 0.15 m/s at 0.3 m/s2, and half of the 0.3 s of the mean at full speed.
    let wanted = 0.15 * 0.15 / (2.0 * 0.3) + 0.15 * 0.15;
    assert!((to - from - wanted).abs() < 0.005, "{} m, {wanted} m", to - from);
    assert!((0.75..0.9).contains(&(f64::from(steps) * STEP)), "{steps} macrosteps");
}

#[test]
fn impossible_path_orders_are_refused_with_reason() {
    let arm = at(Pose::identity());
    let refusal = |result: Result<Vec<Motion>, String>| result.err().unwrap_or_default();
    let to = Pose::translation(0.2, 0.0, 0.0);

    let fast = run(Line { target: to, speed: 1.5 }, &arm, 1.0, &[]);
    assert!(refusal(fast).contains("outside 0..=1"));
    let straight = Arc { via: Vector3::new(0.1, 0.0, 0.0), target: to, speed: 1.0 };
    assert!(refusal(run(straight, &arm, 1.0, &[])).contains("lie on a line"));
    let nowhere = Spline { through: Vec::new(), speed: 1.0 };
    assert!(refusal(run(nowhere, &arm, 1.0, &[])).contains("no pose"));
    let lost = Line { target: Pose::translation(f64::NAN, 0.0, 0.0), speed: 1.0 };
    assert!(refusal(run(lost, &arm, 1.0, &[])).contains("not finite"));
    let through = vec![to, Pose::translation(0.2, 0.2, 0.0)];
    let sharp = Polyline { through, radius: 0.0, speed: 1.0 };
    assert!(refusal(run(sharp, &arm, 1.0, &[])).contains("radius"));
    // A path of no length is reached at once.
    let stays = Line { target: Pose::identity(), speed: 1.0 };
    assert_eq!(run(stays, &arm, 1.0, &[]).map(|course| course.len()), Ok(1));
}
