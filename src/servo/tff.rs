//! The position-force law of one servo period (EDPT in the paper).
//!
//! Each direction of the task frame follows a velocity, or seeks a force, or follows a velocity and
//! yields to a force. The law scales a force error into a velocity, smooths it by a virtual mass
//! and adds the displacement to the commanded pose. The arm acts as a damper in each force
//! direction.
//!
//! The sensor also measures the inertia of the tool beyond it. A compliant arm that vibrates at a
//! frequency f may then excite itself: the force m a of its own vibration makes the law move the
//! tool further. [`self_excitation`] is the gain of that loop at the frequency where it feeds
//! itself. It must not exceed [`MOST_SELF_EXCITATION`] in each direction with a force law.
//! Without a virtual mass the law damps a vibration until the delay of the loop reverses its phase,
//! so `2 pi f m B` must be small. With a virtual mass M the loop has the gain m / M at most, but no
//! damping of its own, so m / M must be small compared with the damping of the arm.
//!
//! - in: the six [`Direction`]s, the frame of their axes, the wrench that the tool exerts on its
//!   surroundings, the commanded pose
//! - out: the commanded pose of the next period
//! - source: Bruyninckx and De Schutter (1996); Zieliński et al. (2007), p. 371; the inertia term
//!   and the integration of the commanded pose are from the sources of the original controller

use super::period::Length;
use crate::motion::{Direction, Frame};
use crate::spatial::{Pose, Twist, Wrench};
use nalgebra::Complex;

/// Six directions and the frame in which they are expressed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaskMotion {
    /// The frame.
    pub frame: Frame,
    /// Law of each direction: x, y, z, then the rotations about them.
    pub directions: [Direction; 6],
}

/// The law with its memory: the displacement of the last period, in base axes.
///
/// ```
/// use rubik_robot::motion::{Direction, Frame};
/// use rubik_robot::servo::tff::{ForceLaw, TaskMotion};
/// use rubik_robot::spatial::{Pose, Wrench};
///
/// // The tool presses on a spring of 2000 N/m along z; the law wants 10 N there.
/// let mut directions = [Direction::HOLD; 6];
/// directions[2] = Direction::Contact { wanted: 10.0, admittance: 0.002, inertia: 0.0 };
/// let task = TaskMotion { frame: Frame::Base, directions };
/// let (mut law, mut pose) = (ForceLaw::default(), Pose::identity());
/// for period in 1..=1000 {
///     let force = 2000.0 * pose.translation.z;
///     let wrench = Wrench::from_directions([0.0, 0.0, force, 0.0, 0.0, 0.0]);
///     pose = law.step(period, &task, &wrench, &pose);
/// }
/// // After two seconds the spring is pressed by 5 mm, and no other direction has moved.
/// assert!((pose.translation.z - 0.005).abs() < 1e-5);
/// assert_eq!((pose.translation.x, pose.translation.y), (0.0, 0.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ForceLaw {
    length: Length,
    last: Twist,
    last_period: u64,
    /// Number of periods in a row in which the step was shortened.
    shortened: u32,
}

impl ForceLaw {
    /// Number of periods without a task motion after which the law forgets its momentum.
    const MEMORY: u64 = 10;

    /// Makes a law that remembers no displacement, for periods of this length.
    #[must_use]
    pub fn new(length: Length) -> Self {
        Self { length, ..Self::default() }
    }

    /// Returns the commanded `base_from_tool` after this period. `wrench` is the one that the tool
    /// exerts on its surroundings, about the tool point, in tool axes (N, Nm).
    pub fn step(
        &mut self,
        period: u64,
        task: &TaskMotion,
        wrench: &Wrench,
        base_from_tool: &Pose,
    ) -> Pose {
        // A contact that begins later must not inherit the speed of an earlier motion.
        if period.saturating_sub(self.last_period) > Self::MEMORY {
            self.last = Twist::default();
        }
        let base_from_axes = match task.frame {
            Frame::Base => Pose::identity().rotation,
            Frame::Tool => base_from_tool.rotation,
        };
        // The memory is in base axes because the axes of the tool turn between two periods.
        let tool_from_axes = base_from_tool.rotation.inverse() * base_from_axes;
        let force = wrench.rotated(&tool_from_axes.inverse());
        let last = self.last.rotated(&base_from_axes.inverse());

        let moved = displacement(&task.directions, &force, &last, self.length.seconds());

        self.last = moved.rotated(&base_from_axes);
        self.last_period = period;
        base_from_tool * moved.rotated(&tool_from_axes).displacement()
    }

    /// Replaces the displacement of the last [`Self::step`] by `share` (0 to 1) of it.
    /// `base_from_tool` is the pose that was passed to `step`. Returns the new commanded
    /// `base_from_tool`. The law remembers the shorter displacement.
    pub fn shorten(&mut self, share: f64, base_from_tool: &Pose) -> Pose {
        let Twist { linear, angular } = self.last;
        self.last = Twist { linear: linear * share, angular: angular * share };
        base_from_tool * self.last.rotated(&base_from_tool.rotation.inverse()).displacement()
    }

    /// Registers whether the step of this period was shortened (`now`). Returns the number of
    /// periods in a row with shortened steps.
    pub fn count_shortened(&mut self, now: bool) -> u32 {
        self.shortened = if now { self.shortened + 1 } else { 0 };
        self.shortened
    }

    /// Returns the length of a period (s).
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.length.seconds()
    }
}

/// Force feedback of one period: the law and its input.
#[derive(Debug)]
pub struct ForceFeedback<'a> {
    /// The law, which remembers the step that it commands.
    pub law: &'a mut ForceLaw,
    /// Wrench that the tool exerts on its surroundings, about the tool point, in tool axes.
    pub wrench: &'a Wrench,
}

/// Returns the displacement of the tool in one period of T `seconds` (m, rad), in each direction
/// `d = ((B (wanted - F) + v) T^2 + B M d_last) / (T + B M)`. F is the `wrench` (N, Nm), and `last`
/// the displacement in the period before; the other symbols are parameters of the direction. All
/// arguments and the result are in the axes of the task frame.
#[must_use]
pub fn displacement(
    directions: &[Direction; 6],
    wrench: &Wrench,
    last: &Twist,
    seconds: f64,
) -> Twist {
    let (forces, lasts) = (wrench.directions(), last.directions());
    Twist::from_directions(std::array::from_fn(|i| {
        let (velocity, wanted, admittance, inertia) = match directions[i] {
            // The equation with B = M = 0 would give the same velocity, but a silent sensor reads
            // NaN, and 0 times NaN would reach a direction that does not depend on the force.
            Direction::Unguarded { velocity } => {
                return stopped_softly(i, velocity, lasts[i] / seconds, seconds) * seconds;
            }
            Direction::Guarded { velocity, admittance, inertia } => {
                (velocity, 0.0, admittance, inertia)
            }
            Direction::Contact { wanted, admittance, inertia } => {
                (0.0, wanted, admittance, inertia)
            }
        };
        // The velocity without inertia; B M is the time constant with which the step follows it.
        let pushed = admittance * (wanted - forces[i]) + velocity;
        let lag = admittance * inertia;
        (pushed * seconds * seconds + lag * lasts[i]) / (seconds + lag)
    }))
}

/// Vibration of a compliant arm, and the tool beyond its force sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mechanics {
    /// Mass (kg) or moment of inertia (kg m2) of the tool.
    pub tool: f64,
    /// Natural frequency of the arm (Hz).
    pub frequency: f64,
    /// Damping of that vibration, as a share of the critical damping.
    pub damping: f64,
    /// Delay from a force to the motion that it causes (s).
    pub delay: f64,
}

/// Greatest [`self_excitation`] of a direction: a loop with a gain margin of 1.5.
pub const MOST_SELF_EXCITATION: f64 = 0.67;

/// Returns the gain of the loop through the tool's own inertia, at the frequency at which the loop
/// feeds itself. From a gain of 1 on the tool shakes itself. `admittance` B is in m/(s N) and
/// `inertia` M in kg; for a rotation they are in rad/(s Nm) and kg m2.
///
/// The loop is `j w m B / (1 + j w B M)`, times the delay, times the oscillator that the law
/// drives. It feeds itself where its value is a negative real number (Nyquist 1932).
#[must_use]
pub fn self_excitation(admittance: f64, inertia: f64, arm: &Mechanics) -> f64 {
    /// Factor between two frequencies of the search.
    const STEP: f64 = 1.002;
    let own = std::f64::consts::TAU * arm.frequency;
    let at = |omega: f64| {
        let law = Complex::new(0.0, omega * arm.tool * admittance)
            / Complex::new(1.0, omega * admittance * inertia);
        let arm = own * own
            / Complex::new(own * own - omega * omega, 2.0 * arm.damping * own * omega)
            * Complex::new(0.0, -omega * arm.delay).exp();
        law * arm
    };
    // The oscillator lets only 1/63 of the amplitude through above 8 times its own frequency.
    let (mut omega, mut last, mut most) = (0.05 * own, at(0.05 * own), 0.0_f64);
    while omega < 8.0 * own {
        omega *= STEP;
        let next = at(omega);
        // A change of sign of the imaginary part brackets a crossing of the real axis; of the two
        // neighbours the more negative one counts, and crossings at positive values do not.
        if (next.im < 0.0) != (last.im < 0.0) {
            most = most.max(-next.re.min(last.re));
        }
        last = next;
    }
    most
}

/// Stiffness that a tool meets at a cube which the other arm holds, along its axis (N/m): the
/// greatest one of the closed chain of both arms.
const CONTACT_STIFFNESS: f64 = 45e3;

/// Returns the force (N) with which a guarded motion at `speed` (m/s) strikes a cube that the other
/// arm holds, beyond the force that it seeks. The law moves the tool like a body of its virtual
/// mass `inertia` (kg), whose momentum goes into the spring of the closed chain: `v sqrt(k M)`.
/// In the plant the peak is 0.94 N per mm/s with 20 kg.
#[must_use]
pub fn impact(speed: f64, inertia: f64) -> f64 {
    speed * (CONTACT_STIFFNESS * inertia).sqrt()
}

/// Time in which the speed of a set value falls to 1/e after an abrupt stop of a motion (s). A set
/// value that stops dead trips the power stages.
const FALLS: f64 = 0.035;

/// Returns the velocity of this period in one direction: `velocity`, or one that falls off towards
/// it with the time constant [`FALLS`] if it is far below the velocity `last` of the period before.
/// A motion that is aborted must not stop its motors dead, which trips their power stages.
/// Generators end their own motions more slowly.
fn stopped_softly(direction: usize, velocity: f64, last: f64, seconds: f64) -> f64 {
    // Decrease of the speed in one period that counts as abrupt: m/s along, rad/s about an axis.
    const SUDDEN: [f64; 2] = [0.1, 0.2];
    let excess = last - velocity;
    let slows = velocity.abs() < last.abs();
    if slows && excess.abs() > SUDDEN[usize::from(direction >= 3)] {
        velocity + excess * libm::exp(-seconds / FALLS)
    } else {
        velocity
    }
}

/// Returns whether any direction seeks a force or yields to one.
#[must_use]
pub fn depends_on_force(directions: &[Direction; 6]) -> bool {
    directions.iter().any(|d| !matches!(d, Direction::Unguarded { .. }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::PERIOD;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};
    use proptest::prelude::*;

    const HOLD: Direction = Direction::HOLD;

    /// Returns a wrench with one component: `value` in direction `axis` (0 to 5).
    fn along(axis: usize, value: f64) -> Wrench {
        let mut components = [0.0; 6];
        components[axis] = value;
        Wrench::from_directions(components)
    }

    /// Simulates a tool that pushes on a spring along base z with the force `stiffness * z` (N/m),
    /// by a law with this admittance (m/(s N)) and inertia (kg) that wants 10 N. Returns the force
    /// in each period (N). The force acts on the law `delay` periods late, as the mean of two
    /// samples.
    fn press(
        admittance: f64,
        inertia: f64,
        stiffness: f64,
        delay: usize,
        periods: u64,
    ) -> Vec<f64> {
        let mut law = ForceLaw::default();
        let mut directions = [HOLD; 6];
        directions[2] = Direction::Contact { wanted: 10.0, admittance, inertia };
        let mut pose = Pose::identity();
        let mut forces = vec![0.0; delay + 2];
        for period in 1..=periods {
            let n = forces.len();
            let seen = 0.5 * (forces[n - 1 - delay] + forces[n - 2 - delay]);
            pose = law.step(
                period,
                &TaskMotion { frame: Frame::Base, directions },
                &along(2, seen),
                &pose,
            );
            forces.push(stiffness * pose.translation.z);
        }
        forces
    }

    #[test]
    fn compliant_direction_backs_away_from_push() {
        let mut directions = [HOLD; 6];
        directions[2] = Direction::Guarded { velocity: 0.0, admittance: 0.002, inertia: 0.0 };

        let moved = displacement(&directions, &along(2, 5.0), &Twist::default(), PERIOD);

        let wanted = Twist::from_directions([0.0, 0.0, -0.002 * 5.0 * PERIOD, 0.0, 0.0, 0.0]);
        assert!((moved.linear - wanted.linear).norm() < 1e-18);
        assert_eq!(moved.angular, wanted.angular);
    }

    #[test]
    fn unguarded_direction_ignores_force_and_silent_sensor() {
        let mut directions = [HOLD; 6];
        directions[1] = Direction::Unguarded { velocity: 0.03 };
        let silent = Wrench::from_directions([f64::NAN; 6]);

        for wrench in [along(1, 50.0), Wrench::default(), silent] {
            let moved = displacement(&directions, &wrench, &Twist::default(), PERIOD);

            assert_eq!(moved, Twist::from_directions([0.0, 0.03 * PERIOD, 0.0, 0.0, 0.0, 0.0]));
        }
    }

    /// An abrupt end of a turn takes some hundredths of a second, but at most a tenth.
    #[test]
    fn aborted_turn_stops_within_a_tenth_second() {
        let mut directions = [HOLD; 6];
        let mut last = Twist::from_directions([0.0, 0.0, 0.0, 0.0, 0.0, 0.436 * PERIOD]);
        directions[5] = Direction::Unguarded { velocity: 0.0 };
        let mut speeds = Vec::new();

        for _ in 0..50 {
            last = displacement(&directions, &Wrench::default(), &last, PERIOD);
            speeds.push(last.angular.z / PERIOD);
        }

        assert!(speeds[0] > 0.3 && speeds[10] < 0.25, "{speeds:?}");
        assert_eq!(speeds[49], 0.0);
    }

    #[test]
    fn guarded_direction_settles_where_push_balances_velocity() {
        // F = v / B: 2 mm/s against 0.001 m/(s N) are 2 N.
        let (stiffness, admittance) = (2e4, 0.001);
        let mut directions = [HOLD; 6];
        directions[0] = Direction::Guarded { velocity: 0.002, admittance, inertia: 20.0 };
        let mut law = ForceLaw::default();
        let mut pose = Pose::identity();

        for period in 1..=3000 {
            let force = stiffness * pose.translation.x;
            pose = law.step(
                period,
                &TaskMotion { frame: Frame::Tool, directions },
                &along(0, force),
                &pose,
            );
        }

        assert!((stiffness * pose.translation.x - 2.0).abs() < 1e-6);
    }

    #[test]
    fn contact_direction_reaches_its_force() {
        let forces = press(0.001, 20.0, 4e4, 1, 3000);

        assert!((forces[3000] - 10.0).abs() < 1e-6);
    }

    /// The rule is K <= 0.4 / (b D). The delay D is one period of the loop, the delay of the force
    /// and half a period of the mean. Ten times that stiffness is unstable.
    #[test]
    fn contact_is_stable_up_to_computed_stiffness_limit() {
        for (admittance, delay) in [(0.005, 1), (0.001, 1), (0.001, 6), (0.0005, 3)] {
            let late = (delay as f64 + 1.5) * PERIOD;
            let calm = press(admittance, 0.0, 0.4 / (admittance * late), delay, 4000);
            let wild = press(admittance, 0.0, 4.0 / (admittance * late), delay, 4000);

            let overshoot = calm.iter().fold(0.0, |m: f64, f| m.max(*f));
            assert!((calm[4000] - 10.0).abs() < 1e-6, "b = {admittance}, delay {delay}");
            assert!(overshoot < 12.5, "b = {admittance}, delay {delay}: {overshoot}");
            let bounded = wild.iter().all(|f| f.abs() < 1000.0);
            assert!(!bounded, "b = {admittance}, delay {delay}");
        }
    }

    /// Holds still in a guarded direction on a compliant arm with a mass at its tool. Returns the
    /// factor by which the vibration of the tool grows within a second.
    fn growth(admittance: f64, inertia: f64, arm: &Mechanics) -> f64 {
        let omega = std::f64::consts::TAU * arm.frequency;
        let mut directions = [HOLD; 6];
        directions[2] = Direction::Guarded { velocity: 0.0, admittance, inertia };
        let task = TaskMotion { frame: Frame::Base, directions };
        let (mut law, mut set) = (ForceLaw::new(Length::default()), Pose::identity());
        let (mut z, mut v, mut on_sensor) = (1e-4, 0.0, [0.0; 4]);
        let mut swings = [0.0_f64; 2];
        for period in 1..=550 {
            let seen = 0.5 * (on_sensor[0] + on_sensor[1]);
            set = law.step(period, &task, &along(2, seen), &set);
            let mut acceleration = 0.0;
            for _ in 0..20 {
                acceleration =
                    omega * omega * (set.translation.z - z) - 2.0 * arm.damping * omega * v;
                v += acceleration * PERIOD / 20.0;
                z += v * PERIOD / 20.0;
            }
            // The tool exerts m a on its surroundings; the sensor is a period late.
            on_sensor = [on_sensor[1], on_sensor[2], on_sensor[3], arm.tool * acceleration];
            if !(50..500).contains(&period) {
                let swing = &mut swings[usize::from(period >= 500)];
                *swing = swing.max((z - set.translation.z).abs());
            }
        }
        swings[1] / swings[0]
    }

    #[test]
    fn loop_gain_predicts_self_excited_tool_vibration() {
        let (mut calm, mut wild) = (0, 0);
        for tool in [1.2, 3.0] {
            for inertia in [0.0, 5.0, 20.0, 80.0] {
                for damping in [0.02, 0.05, 0.1] {
                    for admittance in [0.0002, 0.001, 0.003, 0.005, 0.02] {
                        // A period for the sensor, one for the exchange, half of one for the
                        // mean of two samples.
                        let arm = Mechanics { tool, frequency: 31.0, damping, delay: 2.5 * PERIOD };
                        let excitation = self_excitation(admittance, inertia, &arm);
                        let growth = growth(admittance, inertia, &arm);
                        let case = format!("{admittance} m/(s N), {inertia} kg, {arm:?}");
                        if excitation < 0.8 {
                            assert!(growth < 1.0, "{case}: {excitation} {growth}");
                            calm += 1;
                        } else if excitation > 1.25 {
                            assert!(growth > 1.0, "{case}: {excitation} {growth}");
                            wild += 1;
                        }
                    }
                }
            }
        }
        assert!(calm > 30 && wild > 30, "{calm} {wild}");
    }

    #[test]
    fn wrong_force_sign_makes_arm_run_away() {
        let mut directions = [HOLD; 6];
        directions[2] = Direction::Contact { wanted: 1.0, admittance: 0.001, inertia: 20.0 };
        let mut law = ForceLaw::default();
        let mut pose = Pose::identity();

        for period in 1..=1000 {
            let force = -1e4 * pose.translation.z;
            pose = law.step(
                period,
                &TaskMotion { frame: Frame::Base, directions },
                &along(2, force),
                &pose,
            );
        }

        assert!(1e4 * pose.translation.z > 65.0, "beyond the range of a force sensor");
    }

    /// Motions along base and tool axes differ by the orientation of the tool.
    #[test]
    fn force_law_moves_along_axes_of_selected_frame() {
        let turned = Pose::from_parts(
            Translation3::new(0.3, 0.2, 0.1),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2),
        );
        let mut directions = [HOLD; 6];
        directions[0] = Direction::Unguarded { velocity: 0.1 };
        directions[3] = Direction::Unguarded { velocity: 0.2 };

        let by = |frame| {
            ForceLaw::default().step(
                1,
                &TaskMotion { frame, directions },
                &Wrench::default(),
                &turned,
            )
        };

        let (base, tool) = (by(Frame::Base), by(Frame::Tool));
        let moved = |pose: Pose| pose.translation.vector - turned.translation.vector;
        assert!((moved(base) - Vector3::new(0.1 * PERIOD, 0.0, 0.0)).norm() < 1e-15);
        assert!((moved(tool) - Vector3::new(0.0, 0.1 * PERIOD, 0.0)).norm() < 1e-15);
        let about_x = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.2 * PERIOD);
        let off =
            |pose: Pose, wanted: UnitQuaternion<f64>| (pose.rotation.coords - wanted.coords).norm();
        assert!(off(base, about_x * turned.rotation) < 1e-15);
        assert!(off(tool, turned.rotation * about_x) < 1e-15);
    }

    #[test]
    fn force_law_forgets_momentum_after_ten_idle_periods() {
        let mut directions = [HOLD; 6];
        directions[0] = Direction::Guarded { velocity: 0.0, admittance: 0.001, inertia: 20.0 };
        let mut law = ForceLaw::default();
        law.step(
            1,
            &TaskMotion { frame: Frame::Base, directions },
            &along(0, -5.0),
            &Pose::identity(),
        );
        let mut later = law;

        let soon = law.step(
            11,
            &TaskMotion { frame: Frame::Base, directions },
            &Wrench::default(),
            &Pose::identity(),
        );
        let late = later.step(
            12,
            &TaskMotion { frame: Frame::Base, directions },
            &Wrench::default(),
            &Pose::identity(),
        );

        assert!(soon.translation.x > 0.0);
        assert_eq!(late.translation.x, 0.0);
    }

    proptest! {
        /// Control in tool axes gives the same motion from a turned base, only turned.
        #[test]
        fn tool_frame_motion_is_independent_of_base_pose(
            angle in prop::array::uniform3(-3.0..3.0f64),
            force in prop::array::uniform6(-20.0..20.0f64)
        ) {
            let turn = Pose::from_parts(
                Translation3::new(1.0, 2.0, 3.0),
                UnitQuaternion::from_euler_angles(angle[0], angle[1], angle[2]),
            );
            let directions =
                [Direction::Guarded { velocity: 0.01, admittance: 0.001, inertia: 20.0 }; 6];
            let wrench = Wrench::from_directions(force);
            let (mut a, mut b) = (ForceLaw::default(), ForceLaw::default());
            let (mut one, mut two) = (Pose::identity(), turn);

            for period in 1..=20 {
                one = a.step(period, &TaskMotion { frame: Frame::Tool, directions }, &wrench, &one);
                two = b.step(period, &TaskMotion { frame: Frame::Tool, directions }, &wrench, &two);
            }

            let difference = (turn * one).to_homogeneous() - two.to_homogeneous();
            prop_assert!(difference.amax() < 1e-12);
        }
    }
}
