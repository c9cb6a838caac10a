//! At the operator's hand: what touches harder than it may is given way to, and what cannot be seen or taken is asked about.
//!
//! - in: an outcome of a behaviour near the operator's hand
//! - out: jobs; a question; the end of a task that leaves the cube where it is

use super::{Asked, Job, Mission};
use crate::cube::Keeper;
use crate::motion::Depth;
use crate::operator::{Question, Subject};
use crate::tasks::cube::hold::Hand;

/// How often one way is gone on with.
const MOST_MET: u32 = 3;
/// For so long a hand gives way to what it has met [s].
const GIVES_WAY: f64 = 1.0;
/// The first possibility of both questions ...
const AGAIN: &str = "look again";
/// ... and its index.
pub(super) const LOOK_AGAIN: usize = 0;

impl Mission {
    /// Whether what a hand meets on its way may be given way to once more.
    pub(super) fn meets(&self, job: Job) -> bool {
        // What waits gives way to something only when it was met before.
        let waits = matches!(job, Job::Wait(..));
        !(waits && self.going.1 == 0) && self.going.1 < MOST_MET
    }

    /// Gives way to whatever was met for a while, and goes on to where the way leads.
    pub(super) fn give_way(&mut self, hand: Hand, job: Job, why: &str) {
        self.going.1 += 1;
        self.log.notes.push(format!("{why}: the hand gives way, and goes on"));
        let rest = Job::Wait(hand, GIVES_WAY);
        match job {
            // What follows is waiting already.
            Job::Wait(..) => self.push_front(&[rest]),
            _ => self.push_front(&[rest, Job::GoOn]),
        }
    }

    /// Somebody may have taken hold of a cube that met something on its way, or be in that way: a small pull tells, once it does
    /// not press any more. The force of a bump does not.
    pub(super) fn feel(&mut self, then: &[Job]) {
        self.going.1 += 1;
        self.push_front(then);
        self.push_front(&[Job::Wait(Hand::Track, GIVES_WAY), Job::Feel]);
    }

    /// Somebody has hold of a cube on its way: who has it is to have it.
    pub(super) fn somebody_has_hold(&mut self, why: &str) {
        self.log.notes.push(format!("{why}: the jaws let go"));
        self.given_back = true;
        while self.queue.front().is_some_and(|job| !matches!(job, Job::LetGo(_))) {
            self.queue.pop_front();
        }
    }

    /// The cube cannot be taken, or is not let go: the hand opens, whatever strains it, and draws back, and the task has failed.
    pub(super) fn leave(&mut self, why: String) {
        self.belief.released(Hand::Track);
        self.failure = Some(why);
        self.queue.clear();
        let (opening, back) = (self.settings.opening, self.settings.back);
        self.queue.extend([
            Job::Open { hand: Hand::Track, opening, stops: Depth::One },
            Job::DrawBack(back),
            Job::Leave,
        ]);
    }

    /// Nothing is seen that could be taken: whoever is there may see to it, and have it looked for again.
    pub(super) fn unseen(&mut self, why: String) -> Result<(), String> {
        let Some(seconds) = self.patience else { return Err(why) };
        let see = "Is the camera's view free and lit, and the cube where the hand can take it?";
        let otherwise = "without an answer the run ends".to_owned();
        self.ask_to_see(&why, see, otherwise, "end the run", seconds, Asked::Sight);
        Ok(())
    }

    /// The cube cannot be inspected: whoever is there may see to it, and have it looked at again; else it goes back.
    pub(super) fn ask_for_inspection(&mut self, why: String) -> Result<(), String> {
        let Some(seconds) = self.patience else { return self.give_back(why) };
        let see = "Are the views of the cameras in the hands free and lit?";
        let otherwise = format!("without an answer the cube {} as it is", self.goes_back());
        let end = match self.settings.keeper {
            Keeper::Person => "hand it back as it is",
            Keeper::Table => "lay it down as it is",
        };
        self.ask_to_see(&why, see, otherwise, end, seconds, Asked::Inspection);
        Ok(())
    }

    fn ask_to_see(
        &mut self,
        why: &str,
        see: &str,
        otherwise: String,
        end: &str,
        seconds: f64,
        asked: impl FnOnce(String) -> Asked,
    ) {
        self.questions += 1;
        let question = Question {
            number: self.questions,
            text: format!("{why}. {see}"),
            otherwise,
            seconds,
            until: 0.0,
            subject: Subject::Choice { options: [AGAIN, end].map(str::to_owned).to_vec() },
        };
        self.log.notes.push(format!("{why}: the operator is asked"));
        self.asked = Some((asked(why.to_owned()), question));
        self.queue.push_front(Job::Ask);
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::settings;
    use super::super::{Goal, Thought};
    use super::*;
    use crate::cube::{Axis, Face};
    use crate::generators::{Behaviour, Outcome};
    use crate::motion::{ArmState, JointPositions};
    use crate::operator::Answer;
    use crate::tasks::cube::hold::Hold;
    use crate::tasks::cube::think::Conclusion;
    use crate::tasks::{Action, Event, Finish, Forces, Readings, Task as _};

    fn next(mission: &mut Mission, event: Event<Conclusion>) -> Action<Thought> {
        let arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        mission.next(event, &Readings { arms: &arms, forces: Forces::default() })
    }

    /// Up to where a behaviour of the track's is such.
    fn until(
        mission: &mut Mission,
        mut event: Event<Conclusion>,
        wanted: impl Fn(&Behaviour) -> bool,
    ) -> (Behaviour, Vec<&'static str>) {
        let mut between = Vec::new();
        for _ in 0..30 {
            match next(mission, event) {
                Action::Behave { orders: [Some(order), _], .. } if wanted(&order) => {
                    return (order, between);
                }
                Action::Behave { orders, .. } => {
                    between.push(match orders[0] {
                        Some(Behaviour::Line { .. }) => "line",
                        Some(Behaviour::Jaw { .. }) => "jaws",
                        Some(Behaviour::Present { .. }) => "gives way",
                        _ => "other",
                    });
                    event = Event::Behaved(orders.map(|order| order.map(|_| Outcome::Reached)));
                }
                Action::Bias(_) => {
                    between.push("bias");
                    event = Event::Done;
                }
                Action::Finish(Finish { reason, .. }) => panic!("{reason}"),
                _ => event = Event::Done,
            }
        }
        panic!("never: {between:?}");
    }

    fn servo(order: &Behaviour) -> bool {
        matches!(order, Behaviour::VisualServo(_))
    }

    fn met() -> Event<Conclusion> {
        Event::Behaved([Some(Outcome::OverForce(2, 31.0)), None])
    }

    #[test]
    fn a_hand_that_meets_something_draws_back_and_comes_again_and_in_the_end_stays_back() {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        until(&mut mission, Event::Start, servo);

        for _ in 0..2 {
            let (_, between) = until(&mut mission, met(), servo);
            assert_eq!(between, ["line", "bias"]);
        }
        let (Behaviour::Line { target, .. }, between) =
            until(&mut mission, met(), |order| matches!(order, Behaviour::Line { .. }))
        else {
            panic!()
        };
        assert!(target.translation.vector.z < 0.0 && between == ["jaws"], "{between:?}");
        let reached = Event::Behaved([Some(Outcome::Reached), None]);
        let Action::Finish(end) = next(&mut mission, reached) else { panic!() };
        assert!(!end.achieved && end.reason.contains("over-force of 31.0 N"), "{}", end.reason);
        assert_eq!(mission.whereabouts(), "the operator has the cube");
    }

    #[test]
    fn who_does_not_let_go_pulls_again_and_a_sensor_that_lies_does_not() {
        let release = |last: Outcome| {
            let mut mission = Mission::new(settings(), Goal::Solve, None);
            mission.queue.push_back(Job::Release { tries: 1 });
            mission.resume = None;
            let withdraws = |order: &Behaviour| matches!(order, Behaviour::Withdraw { .. });
            let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
            mission.belief.taken(Hand::Track, hold, false);
            (mission.untouched, mission.widths) = (false, [Some(0.057); 2]);
            let held = || Event::Behaved([Some(Outcome::Touched(3.0)), None]);
            until(&mut mission, Event::Done, withdraws);
            for _ in 1..super::super::RELEASE_TRIES {
                until(&mut mission, held(), withdraws);
            }
            // Once more, with what is felt taken for none.
            let (_, between) = until(&mut mission, held(), withdraws);
            assert_eq!(between, ["bias"]);
            let next = next(&mut mission, Event::Behaved([Some(last), None]));
            (next, mission)
        };

        // In free air it is zeroed again.
        let (zeroes, mission) = release(Outcome::NotTouched);
        assert!(matches!(zeroes, Action::Bias(_)));
        assert_eq!(mission.whereabouts(), "the track hand holds the cube");

        // Whatever strains them, the jaws open.
        let (opens, mission) = release(Outcome::Touched(3.0));
        let Action::Behave { orders: [Some(Behaviour::Jaw { strained, jaw, .. }), _], .. } = opens
        else {
            panic!("{opens:?}")
        };
        assert!(strained && jaw.opening > 0.08);
        assert!(mission.whereabouts().contains("not known"), "{}", mission.whereabouts());
    }

    #[test]
    fn a_cube_that_nobody_takes_is_tugged_at_each_time_and_kept_in_the_end() {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        mission.queue.extend([Job::Present { tries: 1 }, Job::LetGo(Hand::Track)]);
        mission.resume = None;
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        mission.belief.taken(Hand::Track, hold, false);
        mission.widths = [Some(0.057); 2];
        let tugs = |order: &Behaviour| matches!(order, Behaviour::Withdraw { .. });
        let presents = |order: &Behaviour| matches!(order, Behaviour::Present { .. });
        let nobody = |outcome: Outcome| Event::Behaved([Some(outcome), None]);

        until(&mut mission, Event::Done, presents);
        let (_, between) = until(&mut mission, nobody(Outcome::TimedOut(20.0)), tugs);
        assert_eq!(between, ["bias"]);
        let (_, between) = until(&mut mission, nobody(Outcome::NotTouched), presents);
        assert_eq!(between, ["line", "line", "bias"]);
        until(&mut mission, nobody(Outcome::TimedOut(20.0)), tugs);
        let end = next(&mut mission, nobody(Outcome::NotTouched));

        let Action::Finish(end) = end else { panic!("{end:?}") };
        assert!(end.reason.contains("nobody pulls at it; the track hand holds"), "{}", end.reason);
    }

    #[test]
    fn who_takes_hold_of_a_cube_on_its_way_has_it() {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        mission.given_back = true;
        mission.queue.extend([
            Job::Along(Hand::Track, -0.1),
            Job::Present { tries: 2 },
            Job::LetGo(Hand::Track),
        ]);
        mission.resume = None;
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        mission.belief.taken(Hand::Track, hold, false);
        mission.widths = [Some(0.057); 2];

        let goes = next(&mut mission, Event::Done);
        assert!(matches!(goes, Action::Behave { orders: [Some(Behaviour::Line { .. }), _], .. }));
        let opens = next(&mut mission, met());

        let Action::Behave { orders: [Some(Behaviour::Jaw { .. }), _], .. } = opens else {
            panic!("{opens:?}")
        };
    }

    #[test]
    fn who_is_in_the_way_of_a_cube_that_is_handed_back_is_drawn_back_from_and_who_has_hold_of_it_has_it()
     {
        let tugs = |order: &Behaviour| matches!(order, Behaviour::Withdraw { .. });
        let along = |order: &Behaviour| matches!(order, Behaviour::Line { .. });
        let jaws = |order: &Behaviour| matches!(order, Behaviour::Jaw { strained: true, .. });
        let ended = |outcome: Outcome| Event::Behaved([Some(outcome), None]);
        // Up to the pull that follows a contact, with what it is made of.
        let met_on_its_way = || {
            let mut mission = Mission::new(settings(), Goal::Solve, None);
            mission.hand_over = Some(JointPositions([0.3; 7]));
            mission.queue.push_back(Job::HandBack);
            mission.resume = None;
            let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
            mission.belief.taken(Hand::Track, hold, false);
            mission.widths = [Some(0.057); 2];
            let (out, _) = until(&mut mission, Event::Done, along);
            // What still presses after a while is given way to once more.
            let (_, between) = until(&mut mission, met(), tugs);
            assert_eq!(between, ["gives way"]);
            let (_, between) = until(&mut mission, met(), tugs);
            assert_eq!(between, ["gives way"]);
            (mission, out)
        };

        let (mut mission, _) = met_on_its_way();
        let (_, between) = until(&mut mission, ended(Outcome::Touched(0.003)), jaws);
        assert!(between.is_empty() && mission.given_back, "{between:?}");

        let (mut mission, out) = met_on_its_way();
        until(&mut mission, ended(Outcome::NotTouched), along);
        let (again, between) = until(&mut mission, ended(Outcome::Reached), along);
        assert!(between.is_empty());
        assert_eq!(again, out, "to the same place");
        let presents = |order: &Behaviour| matches!(order, Behaviour::Present { .. });
        let (_, between) = until(&mut mission, ended(Outcome::Reached), presents);
        assert_eq!(between, ["bias"]);
        // Met once more on the way back: another pull tells.
        let (mut mission, _) = met_on_its_way();
        until(&mut mission, ended(Outcome::NotTouched), along);
        let (_, between) = until(&mut mission, met(), tugs);
        assert_eq!(between, ["gives way"]);
        until(&mut mission, ended(Outcome::Touched(0.003)), jaws);

        // What stays in the way: the cube stays in the hand.
        let (mut mission, _) = met_on_its_way();
        let mut event = ended(Outcome::NotTouched);
        let end = loop {
            event = match next(&mut mission, event) {
                Action::Behave { orders: [Some(order), _], .. } => match order {
                    Behaviour::Withdraw { .. } => ended(Outcome::NotTouched),
                    Behaviour::Line { .. } if order == out => met(),
                    Behaviour::Jaw { .. } => panic!("the cube falls"),
                    _ => ended(Outcome::Reached),
                },
                Action::Finish(end) => break end,
                _ => Event::Done,
            };
        };
        assert!(!end.achieved && end.reason.contains("the track hand holds"), "{}", end.reason);
    }

    #[test]
    fn what_is_wider_than_a_cube_is_not_kept_between_the_jaws() {
        let taken = |width: f64| {
            let mut mission = Mission::new(settings(), Goal::Solve, None);
            mission.queue.push_back(Job::Take { tries: 1 });
            mission.resume = None;
            let closes = |order: &Behaviour| matches!(order, Behaviour::Grasp { .. });
            until(&mut mission, Event::Done, closes);
            next(&mut mission, Event::Behaved([Some(Outcome::Grasped(width)), None]));
            mission.belief.held[Hand::Track.index()].is_some()
        };

        for (width, kept) in [(0.0565, true), (0.062, true), (0.065, false), (0.053, false)] {
            assert_eq!(taken(width), kept, "{width}");
        }
    }

    #[test]
    fn who_is_asked_may_have_the_cube_looked_for_again_or_end_the_run() {
        let lost = || Event::Behaved([Some(Outcome::LostSight(60.0)), None]);
        let asked = |answer: Option<Answer>| {
            let mut mission = Mission::new(settings(), Goal::Solve, None);
            mission.patience = Some(30.0);
            until(&mut mission, Event::Start, servo);
            let Action::Ask(question) = next(&mut mission, lost()) else { panic!() };
            assert!(question.text.contains("no cube in sight"), "{}", question.text);
            next(&mut mission, Event::Answered(answer))
        };

        let again = asked(Some(Answer::Choice { option: LOOK_AGAIN }));
        assert!(matches!(&again, Action::Behave { orders: [Some(order), _], .. } if servo(order)));
        for answer in [Some(Answer::Choice { option: 1 }), Some(Answer::Declined), None] {
            let Action::Finish(end) = asked(answer) else { panic!() };
            assert!(!end.achieved && end.reason.contains("no cube in sight"), "{}", end.reason);
        }
        // Nobody is there.
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        until(&mut mission, Event::Start, servo);
        assert!(matches!(next(&mut mission, lost()), Action::Finish(_)));
    }

    #[test]
    fn what_is_met_on_a_way_is_given_way_to_and_the_same_way_gone_on_with() {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        let to = JointPositions([0.4; 7]);
        mission.queue.push_back(Job::Joints([Some(to), Some(to)], 0.5));
        mission.resume = None;
        let Action::Behave { orders: sent, .. } = next(&mut mission, Event::Done) else { panic!() };

        for _ in 0..MOST_MET {
            let Action::Behave { orders, .. } = next(&mut mission, met()) else { panic!() };
            assert!(matches!(orders, [Some(Behaviour::Present { .. }), None]), "{orders:?}");
            let rested = Event::Behaved([Some(Outcome::TimedOut(1.0)), None]);
            let Action::Behave { orders, .. } = next(&mut mission, rested) else { panic!() };
            assert_eq!(orders, sent);
        }
        let Action::Finish(end) = next(&mut mission, met()) else { panic!() };
        assert!(!end.achieved && end.reason.contains("while moving"), "{}", end.reason);
    }
}
