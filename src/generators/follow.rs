//! Motion to targets that come from outside while it goes on, such as the joint commands of another
//! program.
//!
//! - in: at each macrostep the reading of a sensor, [`Targets`]
//! - out: set joint positions with bounded velocity, acceleration and jerk; [`Followed`] at the end
//!
//! Each joint goes to its target as fast as its velocity and acceleration allow, so that it could
//! stop there. The mean of the last `WINDOW` of these places is the set value: it keeps both
//! bounds, and its jerk is at most twice the acceleration divided by the time of the window. It
//! stays between places of the joint, so it also keeps the limits of the joint.
//!
//! | case | reaction |
//! |---|---|
//! | no target, or the reading is an error | the joints brake and hold |
//! | pause | the same; after it the arm follows again |
//! | the way to rest is not free | the joints brake on the way that was checked before |
//! | the servo refuses the set values | the motion ends with the reason |

use super::inputs::Inputs;
use super::outcome::{Next, Outcome};
use super::own::{Forecast, MotionGenerator, Pacing, Places, Site};
use crate::motion::{AXES, JointPositions, Motion};
use serde::{Deserialize, Serialize};

/// Number of macrosteps of which the set value is the mean: about 0.1 s.
const WINDOW: usize = 6;
/// Velocity below which a joint rests (m/s, rad/s): rounding.
const STILL: f64 = 1e-9;

/// Order to follow targets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FollowOrder {
    /// Sensor of the arm's ECP whose reading is [`Targets`].
    pub sensor: String,
    /// Index of the arm in the targets.
    pub effector: usize,
    /// Fraction of the full speeds and accelerations, above 0 and at most 1.
    pub speed: f64,
    /// Time after which the motion ends (s); `None` if its superior ends it.
    pub seconds: Option<f64>,
}

/// Targets of all arms: the reading of the sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Targets {
    /// Joint positions (m or rad) that each arm is to reach, in the scenario's order; `None` for an
    /// arm that is to hold.
    pub arms: Vec<Option<JointPositions>>,
}

/// Account of the motion.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Followed {
    /// Time with a target (s).
    pub followed: f64,
    /// Time without one (s).
    pub held: f64,
    /// Number of times that the way ahead was not free.
    pub hindered: u32,
    /// Greatest distance of a joint from its target (rad).
    pub lag: f64,
}

/// Course of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Joint {
    /// Last places, the newest one first (m or rad).
    places: [f64; WINDOW],
    /// Velocity of the newest place (m/s or rad/s).
    velocity: f64,
}

/// Bounds of one joint, and the length of a macrostep (s).
#[derive(Debug, Clone, Copy)]
struct Bounds {
    velocity: f64,
    acceleration: f64,
    step: f64,
}

impl Bounds {
    /// Returns the greatest velocity of the next macrostep from which a joint stops within
    /// `distance` (m or rad), which it covers in whole macrosteps.
    fn velocity_within(&self, distance: f64) -> f64 {
        // In k further macrosteps a joint loses the velocity k a h. It has covered a h^2 k (k+1)/2
        // by then, and between two of these distances the velocity grows evenly.
        let least = self.acceleration * self.step * self.step;
        let k = (0.5 * ((1.0 + 8.0 * distance / least).sqrt() - 1.0)).floor();
        let rest = distance - 0.5 * least * k * (k + 1.0);
        k * self.acceleration * self.step + rest / (self.step * (k + 1.0))
    }
}

impl Joint {
    /// Makes the course of a joint that rests.
    fn resting(at: f64) -> Self {
        Self { places: [at; WINDOW], velocity: 0.0 }
    }

    /// Returns the set value.
    fn set(&self) -> f64 {
        // A joint that rests keeps its place to the bit, whatever the rounding of the mean.
        if self.rests() {
            return self.places[0];
        }
        self.places.iter().sum::<f64>() / WINDOW as f64
    }

    /// Returns whether the joint rests and its set value has reached its place.
    fn rests(&self) -> bool {
        self.velocity.abs() < STILL
            && self.places.iter().all(|place| (place - self.places[0]).abs() < STILL)
    }

    /// Goes on by one macrostep to `target`, or to rest without one.
    fn advance(&mut self, target: Option<f64>, bounds: &Bounds) {
        let wanted = target.map_or(0.0, |target| {
            let distance = target - self.places[0];
            distance.signum() * bounds.velocity_within(distance.abs()).min(bounds.velocity)
        });
        let change = bounds.acceleration * bounds.step;
        self.velocity = wanted.clamp(self.velocity - change, self.velocity + change);
        self.places.rotate_right(1);
        self.places[0] = self.places[1] + self.velocity * bounds.step;
    }
}

/// Motion to targets from outside.
pub struct Follow {
    order: FollowOrder,
    bounds: [Bounds; AXES],
    joints: [Joint; AXES],
    /// Courses of the joints before the last command.
    before: [Joint; AXES],
    time: f64,
    account: Followed,
    /// Whether the last command was taken back, and the one before it.
    hindered: [bool; 2],
    /// Pace of the last macrostep.
    pace: f64,
}

impl MotionGenerator for Follow {
    type Order = FollowOrder;

    fn begin(order: FollowOrder, site: &Site<'_>) -> Result<Self, String> {
        if !(order.speed > 0.0 && order.speed <= 1.0) {
            return Err(format!("a fraction of {} of the speed is outside 0..=1", order.speed));
        }
        let speed = order.speed * site.fraction;
        let bounds = std::array::from_fn(|i| Bounds {
            velocity: speed * site.speeds.joint[i],
            acceleration: speed * site.speeds.joint_acceleration[i],
            step: site.step(),
        });
        let joints = site.arm.desired_joints.0.map(Joint::resting);
        let account = Followed::default();
        Ok(Self {
            order,
            bounds,
            joints,
            before: joints,
            time: 0.0,
            account,
            hindered: [false; 2],
            pace: 1.0,
        })
    }

    fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        let step = self.bounds[0].step;
        self.time += step;
        let is_over = self.order.seconds.is_some_and(|seconds| self.time > seconds);
        if is_over && self.rests() {
            return Next::Done(Outcome::own(&self.account));
        }
        let target = self.target(inputs).filter(|_| !is_over && inputs.pace > 0.0);
        if let Some(target) = &target {
            self.account.followed += step;
            let lag = |i: usize| (target.0[i] - self.joints[i].set()).abs();
            self.account.lag = (1..AXES).map(lag).fold(self.account.lag, f64::max);
        } else {
            self.account.held += step;
        }
        (self.before, self.pace) = (self.joints, inputs.pace);
        self.hindered = [false, self.hindered[0]];
        self.advance(target.as_ref());
        Next::go(Motion::Joints(self.set()))
    }

    fn pacing(&self) -> Pacing {
        Pacing::Clock
    }

    fn rests(&self) -> bool {
        self.joints.iter().all(Joint::rests)
    }

    fn sensor(&self) -> Option<&str> {
        Some(&self.order.sensor)
    }

    fn onward(&self) -> Option<Forecast> {
        if self.rests() {
            return None;
        }
        let from = self.before.map(|joint| joint.set());
        let mut ahead = self.joints;
        let mut places = vec![JointPositions(from), self.set()];
        while !ahead.iter().all(Joint::rests) {
            for (joint, bounds) in ahead.iter_mut().zip(&self.bounds) {
                joint.advance(None, bounds);
            }
            places.push(JointPositions(ahead.map(|joint| joint.set())));
        }
        let seconds = (places.len() - 1) as f64 * self.bounds[0].step;
        Some(Forecast { seconds, places: Places::Joints(places) })
    }

    fn retreat(&mut self) -> Option<Motion> {
        if !self.hindered[1] {
            self.account.hindered += 1;
        }
        self.hindered[0] = true;
        self.joints = self.before;
        self.advance(None);
        Some(Motion::Joints(self.set()))
    }
}

impl Follow {
    /// Returns the target of the arm; `None` if there is none.
    fn target(&self, inputs: &Inputs<'_>) -> Option<JointPositions> {
        let targets = Targets::deserialize(inputs.reading?.ok()?).ok()?;
        let target = targets.arms.into_iter().nth(self.order.effector)??;
        target.0.iter().all(|joint| joint.is_finite()).then_some(target)
    }

    /// Goes on by one macrostep to `target`, or to rest without one.
    fn advance(&mut self, target: Option<&JointPositions>) {
        for (i, (joint, bounds)) in self.joints.iter_mut().zip(&self.bounds).enumerate() {
            let paced = Bounds { velocity: bounds.velocity * self.pace, ..*bounds };
            joint.advance(target.map(|target| target.0[i]), &paced);
        }
    }

    /// Returns the set values.
    fn set(&self) -> JointPositions {
        JointPositions(self.joints.map(|joint| joint.set()))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{compliance, speeds};
    use super::*;
    use crate::motion::ArmState;
    use serde_json::Value;

    /// Begins to follow with a fraction of the full speeds.
    fn begin(speed: f64) -> Follow {
        let arm = ArmState::default();
        let site = Site { compliance: compliance(), speeds: speeds(), arm: &arm, fraction: 1.0 };
        let order = FollowOrder { sensor: "s".into(), effector: 0, speed, seconds: None };
        Follow::begin(order, &site).unwrap()
    }

    /// Returns the reading with this target for all joints of the first arm.
    fn reading(target: Option<f64>) -> Value {
        let arms = vec![target.map(|at| JointPositions([at; AXES]))];
        serde_json::to_value(Targets { arms }).unwrap()
    }

    /// Calls the generator once, and returns its set values.
    fn step(follow: &mut Follow, reading: &Result<Value, String>, pace: f64) -> [f64; AXES] {
        let arm = ArmState::default();
        let reading = Some(reading.as_ref().map_err(String::as_str));
        let inputs = Inputs { arm: &arm, target: None, reading, period: 0, pace };
        match follow.next(&inputs) {
            Next::Go(command) => match command.motion {
                Motion::Joints(at) => at.0,
                other => panic!("{other:?}"),
            },
            Next::Done(outcome) => panic!("{outcome:?}"),
        }
    }

    /// Checks that set values keep the bounds of velocity, acceleration and jerk.
    fn check_bounds(follow: &Follow, sets: &[[f64; AXES]]) {
        for (i, bounds) in follow.bounds.iter().enumerate() {
            let differences = |values: &[f64]| -> Vec<f64> {
                values.windows(2).map(|pair| (pair[1] - pair[0]) / bounds.step).collect()
            };
            let most = |values: &[f64]| values.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            let mut at = vec![0.0; 3];
            at.extend(sets.iter().map(|set| set[i]));
            let velocity = differences(&at);
            let acceleration = differences(&velocity);
            let jerk = differences(&acceleration);
            assert!(most(&velocity) <= bounds.velocity * (1.0 + 1e-9), "{i}");
            assert!(most(&acceleration) <= bounds.acceleration * (1.0 + 1e-6), "{i}");
            let window = WINDOW as f64 * bounds.step;
            assert!(most(&jerk) <= 2.0 * bounds.acceleration / window * (1.0 + 1e-6), "{i}");
        }
    }

    /// Targets that jump about, end, and come back: a worse source than any that is admitted.
    #[test]
    fn any_targets_give_bounded_motion() {
        let mut follow = begin(0.5);
        let mut sets = Vec::new();
        for (target, steps) in [
            (Ok(Some(0.3)), 40),
            (Ok(Some(-0.2)), 25),
            (Ok(None), 10),
            (Ok(Some(0.31)), 90),
            (Err("two programs".to_owned()), 5),
            (Ok(Some(0.29)), 400),
        ] {
            let found: Result<Value, String> = target.map(reading);
            for _ in 0..steps {
                sets.push(step(&mut follow, &found, 1.0));
            }
        }

        check_bounds(&follow, &sets);
        assert_eq!(sets[sets.len() - 1], [0.29; AXES], "it arrives to the bit");
        assert!(follow.rests() && follow.onward().is_none());
    }

    #[test]
    fn constant_target_is_reached_without_overshoot() {
        let mut follow = begin(1.0);
        let target = Ok(reading(Some(0.2)));
        let sets: Vec<_> = (0..300).map(|_| step(&mut follow, &target, 1.0)).collect();

        assert!(sets.iter().flatten().all(|at| (-1e-12..=0.2 + 1e-9).contains(at)));
        assert_eq!(sets[299], [0.2; AXES]);
        check_bounds(&follow, &sets);
    }

    #[test]
    fn silence_error_and_pause_bring_arm_to_rest() {
        let there = Ok(reading(Some(0.5)));
        for (held, pace) in [
            (Ok(reading(None)), 1.0),
            (Err("late".to_owned()), 1.0),
            (Ok(Value::from("no targets")), 1.0),
            (Ok(reading(Some(f64::NAN))), 1.0),
            (there.clone(), 0.0),
        ] {
            let mut follow = begin(0.5);
            let mut sets: Vec<_> = (0..40).map(|_| step(&mut follow, &there, 1.0)).collect();
            assert!(!follow.rests());
            sets.extend((0..80).map(|_| step(&mut follow, &held, pace)));

            assert!(follow.rests(), "{held:?}");
            assert!(sets[119][1] < 0.4, "{held:?}");
            check_bounds(&follow, &sets);
        }
    }

    /// A course that is not free is left on the course that was checked one macrostep before.
    #[test]
    fn retreat_keeps_the_course_checked_before() {
        let there = Ok(reading(Some(0.5)));
        let mut follow = begin(0.5);
        let mut sets: Vec<_> = (0..30).map(|_| step(&mut follow, &there, 1.0)).collect();
        let Some(Forecast { places: Places::Joints(checked), .. }) = follow.onward() else {
            panic!("it moves")
        };
        // The course begins at the set values before the last command.
        assert_eq!((checked[0].0, checked[1].0), (sets[28], sets[29]));
        for place in &checked[2..] {
            step(&mut follow, &there, 1.0);
            let Some(Motion::Joints(set)) = follow.retreat() else { panic!("it has a course") };
            assert_eq!(&set, place);
            sets.push(set.0);
        }

        assert!(follow.rests());
        check_bounds(&follow, &sets);
        assert_eq!(follow.account.hindered, 1, "one hindrance, however long");
    }

    #[test]
    fn time_ends_the_motion_at_rest() {
        let mut follow = begin(0.5);
        follow.order.seconds = Some(0.5);
        let there = Ok(reading(Some(0.5)));
        let arm = ArmState::default();
        let mut steps = 0;
        let outcome = loop {
            let found: Result<&Value, &str> = there.as_ref().map_err(|why: &String| why.as_str());
            let inputs =
                Inputs { arm: &arm, target: None, reading: Some(found), period: 0, pace: 1.0 };
            match follow.next(&inputs) {
                Next::Done(outcome) => break outcome,
                Next::Go(_) => steps += 1,
            }
            assert!(steps < 100);
        };

        assert!(follow.rests() && steps > 31, "{steps}");
        let account: Followed = outcome.result().unwrap();
        assert!(account.followed > 0.49 && account.held > 0.1, "{account:?}");
    }
}
