//! The operator's parameters as an actor follows them.
//!
//! - in: the [`Courses`] that the operator ordered, as they have reached the actor's node
//! - out: the [`Factors`] of each macrostep; commands whose jaws hold with the present grip force
//!
//! | case | rule | reason |
//! |---|---|---|
//! | order that comes late | the factors approach it with their rate | no value jumps |
//! | arm that holds an object and moves | the grip force moves with its rate | the object is held |
//! | arm that holds an object and waits | it keeps its grip force | it gets no commands |

use crate::motion::{ArmState, JawCommand, MoveCommand};
use crate::operator::parameter::{AllBounds, COUNT, Courses, DECLARED, Factors};
use crate::operator::{Input, Parameter};
use tokio::sync::watch;

/// The operator's last order of each parameter: its number, counted from 1, and the value.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Orders([(u64, f64); COUNT]);

impl Orders {
    /// Orders a value of a parameter.
    pub fn order(&mut self, parameter: Parameter, value: f64) {
        let (number, ordered) = &mut self.0[parameter as usize];
        // The number makes the same value a second order: the scenario may have changed it between.
        (*number, *ordered) = (*number + 1, value);
    }

    /// Returns the inputs that were given since the orders `taken`.
    pub fn since(self, taken: &Self) -> impl Iterator<Item = Input> {
        let taken = taken.0;
        DECLARED.iter().zip(self.0).zip(taken).filter_map(|((declared, (number, value)), taken)| {
            let parameter = declared.parameter;
            (number > taken.0).then_some(Input::Parameter { parameter, value })
        })
    }
}

/// Follower of the operator's parameters. Each user of a clone follows them by itself.
#[derive(Debug, Clone)]
pub struct Tuning {
    courses: watch::Receiver<Courses>,
    /// Last factors, and their period; `None` before the first ones.
    last: Option<(Factors, u64)>,
    jaws: Jaws,
}

/// Set values of the jaws that were sent last.
#[derive(Debug, Clone, Default)]
struct Jaws {
    /// Set values without the factor of the grip force, and the factor in force.
    sent: Option<(JawCommand, f64)>,
    /// Whether the last command had none, so that the jaws are at rest.
    rest: bool,
}

impl Tuning {
    /// Makes a follower of these courses.
    #[must_use]
    pub fn new(courses: watch::Receiver<Courses>) -> Self {
        Self { courses, last: None, jaws: Jaws::default() }
    }

    /// Makes a follower of parameters that nobody changes.
    #[must_use]
    pub fn fixed() -> Self {
        Self::new(watch::channel(Courses::new(&AllBounds::default())).1)
    }

    /// Returns the courses, to carry them to another node.
    pub(super) fn courses(&self) -> watch::Receiver<Courses> {
        self.courses.clone()
    }

    /// Returns the factors in a period. They approach an order that comes late with their rate.
    pub fn factors(&mut self, period: u64) -> Factors {
        let courses = *self.courses.borrow();
        let mut factors = courses.factors(period);
        if let Some((before, at)) = &self.last {
            factors = factors.reached_from(before, &courses, period.saturating_sub(*at));
        }
        self.last = Some((factors, period));
        factors
    }

    /// Gives the jaws of a command the present grip force. Jaws at rest get a command of their own
    /// while the operator's grip force differs from theirs, so that a held cube follows as well.
    /// `arm` is the state of the arm before the command.
    pub fn grip(&mut self, command: &mut MoveCommand, arm: &ArmState) {
        let wanted = self.last.as_ref().map_or(1.0, |(factors, _)| factors[Parameter::Grip]);
        let rest = std::mem::replace(&mut self.jaws.rest, command.jaw.is_none());
        // The order may have moved on while the arm waited and kept its grip force.
        let step = self.courses.borrow().step(Parameter::Grip) * f64::from(command.periods);
        let toward = |factor: f64| wanted.clamp(factor - step, factor + step);
        match (&mut command.jaw, &mut self.jaws.sent) {
            (Some(jaw), sent) => {
                let factor = sent.map_or(wanted, |(_, factor)| toward(factor));
                *sent = Some((*jaw, factor));
                jaw.force_limit *= factor;
            }
            // Jaws that moved in the last macrostep are still under way for two periods.
            (None, Some((jaw, factor))) if rest && *factor != wanted => {
                *factor = toward(*factor);
                let force_limit = jaw.force_limit * *factor;
                let opening = arm.desired_jaw_opening;
                command.jaw = Some(JawCommand { opening, force_limit, ..*jaw });
            }
            (None, _) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Depth, Motion};
    use crate::operator::parameter::Bounds;

    /// Returns a follower whose usual grip force is 40 N, and the sender of its courses.
    fn follower() -> (watch::Sender<Courses>, Tuning) {
        let mut bounds = AllBounds::default();
        bounds.0[Parameter::Grip as usize] = Bounds { usual: 40.0, least: 30.0, most: 55.0 };
        let (sender, courses) = watch::channel(Courses::new(&bounds));
        (sender, Tuning::new(courses))
    }

    /// Sends the command of a macrostep through a follower; returns its grip force (N), if any.
    fn sent(tuning: &mut Tuning, period: u64, jaw: Option<JawCommand>) -> Option<JawCommand> {
        let mut command = MoveCommand { motion: Motion::Hold, periods: 8, jaw };
        let arm = ArmState { period, desired_jaw_opening: 0.05, ..ArmState::default() };
        tuning.factors(period);
        tuning.grip(&mut command, &arm);
        command.jaw
    }

    const CLOSE: JawCommand = JawCommand { opening: 0.05, force_limit: 40.0, stops: Depth::Two };

    #[test]
    fn commands_without_order_are_unchanged() {
        let (_sender, mut tuning) = follower();

        assert_eq!(sent(&mut tuning, 8, None), None);
        assert_eq!(sent(&mut tuning, 16, Some(CLOSE)), Some(CLOSE));
        for period in 3..1000 {
            assert_eq!(sent(&mut tuning, 8 * period, None), None);
        }
    }

    /// The jaws that hold an object get the grip force of each macrostep, also after the arm has
    /// waited for long.
    #[test]
    fn held_object_follows_grip_order_without_jump() {
        let (sender, mut tuning) = follower();
        sent(&mut tuning, 8, Some(CLOSE));
        sender.send_modify(|courses| courses.order(Parameter::Grip, 50.0, 16));
        // The jaws are under way until the second macrostep after their command.
        assert_eq!(sent(&mut tuning, 16, None), None);

        // The arm waits for 100 s before its next motion.
        let (mut last, mut steps) = (40.0, 0);
        while last < 50.0 {
            let jaw = sent(&mut tuning, 50_000 + 8 * steps, None).unwrap();
            assert!((jaw.opening, jaw.stops) == (0.05, Depth::Two));
            let most = 5.0 * 8.0 * crate::motion::PERIOD;
            assert!(jaw.force_limit > last && jaw.force_limit - last < most + 1e-9, "{jaw:?}");
            (last, steps) = (jaw.force_limit, steps + 1);
        }
        // 10 N at 5 N/s are 125 macrosteps of 16 ms.
        assert!((last, steps) == (50.0, 125), "{last} N after {steps}");
        assert_eq!(sent(&mut tuning, 60_000, None), None);
    }

    #[test]
    fn closing_jaws_begin_at_grip_in_force() {
        let (sender, mut tuning) = follower();
        sent(&mut tuning, 8, Some(CLOSE));
        sender.send_modify(|courses| courses.order(Parameter::Grip, 30.0, 16));

        let jaw = sent(&mut tuning, 50_000, Some(CLOSE)).unwrap();

        assert!((jaw.force_limit - (40.0 - 0.08)).abs() < 1e-9, "{jaw:?}");
    }

    #[test]
    fn same_value_ordered_again_is_a_second_input() {
        let mut orders = Orders::default();
        orders.order(Parameter::Exposure, 1.5);
        let taken = orders;
        assert_eq!(orders.since(&taken).count(), 0);

        orders.order(Parameter::Exposure, 1.5);

        let again = Input::Parameter { parameter: Parameter::Exposure, value: 1.5 };
        assert_eq!(orders.since(&taken).collect::<Vec<_>>(), [again]);
    }
}
