//! The motions of the mission: one method each, and the orders that they send.
//!
//! - in: where a hand is to go, or what it is to grasp
//! - out: its outcome, or the failure that it came to
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`MOST_CONTACTS`] | 3 | obstacles on one way before the mission stops trying |
//! | [`MOST_STRAINED`] | 6 | jaws that are strained try to open; opening relieves the strain |
//! | [`EASE_SECONDS`] | 0.6 s | a hand that gives way about its own z is rid of a torque then |

use super::failure::{Alarm, Failure, alarm};
use super::failure::{Orders, Outcomes, alone};
use super::robot::{LEAST_WIDTH, Robot, Trust, UNSURE};
use super::shared::Doing;
use crate::generators::{Behaviour, Outcome, visual_servo};
use crate::motion::{Depth, JawCommand, JointPositions};
use crate::reach::Way;
use crate::spatial::Pose;
use crate::tasks::Until;
use crate::tasks::cube::hold::{Grip, Hand, Hold};
use crate::tasks::cube::settings::{ComplianceChoice, CompliantArm};
use nalgebra::{UnitQuaternion, Vector3};

/// How often a hand gives way to what it meets on one way.
const MOST_CONTACTS: u32 = 3;
/// How long a hand gives way to what it met (s).
pub(super) const GIVE_WAY_SECONDS: f64 = 1.0;
/// How long a hand gives way about its own z to be rid of a torque (s).
const EASE_SECONDS: f64 = 0.6;
/// How often strained jaws try to open again, and how long they give way in between (s).
pub(super) const MOST_STRAINED: u32 = 6;
const STRAINED_SECONDS: f64 = 0.3;
/// Jaws stand open if they are narrower than they are to be by less (m).
const OPEN_ENOUGH: f64 = 0.0015;
/// Room for an arm that stops before a cube (m): it swings, and its gears have play.
const SURE: f64 = 0.0025;
/// Deviation of the cube's place by play and by a cube that lies askew on the palm's stops (m). The
/// filter of [`super::super::belief`] does not model them.
const UNMODELLED: f64 = 0.0005;
/// An approach begins so many standard deviations before the cube, with [`SURE`], and at most
/// [`UNSURE`] before it. Of 153 grasps in ten cells none was nearer by more than that.
const MOST_OFF: f64 = 3.5;
/// Turns that are shorter (rad) ease a layer that stood still, and speed up by no more than this
/// (rad/s2). At 3 rad/s2 a motor that a jam holds stood still behind its set value for so long that
/// its encoder was taken for frozen: 19 of 60 seeds of `faults/jam.toml`, at 1.7 rad/s2 none.
const SHORT_TURN: f64 = 0.2;
const GENTLE: f64 = 1.0;
/// Length of the small pull that tells whether somebody holds the cube (m).
const PULL_WAY: f64 = 0.02;
/// How long the cube is held out (s).
const PRESENT_SECONDS: f64 = 20.0;

/// How the jaws close on a cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Closing {
    /// On a cube whose layers are in line.
    Straight,
    /// On a layer that may still be misaligned: the smaller width is the cube's.
    OnLayer,
}

impl Robot {
    /// Follows a way to its end. A hand that meets something gives way and goes on, a few times.
    pub(super) async fn follow(
        &mut self,
        orders: Orders,
        until: Until,
        doing: Doing,
    ) -> Result<(), Failure> {
        let outcomes = self.behave(orders, until, doing).await?;
        self.go_on(outcomes, orders, doing).await
    }

    /// Has a hand that met something on a way give way and go on to the end, a few times.
    async fn go_on(
        &mut self,
        mut outcomes: Outcomes,
        orders: Orders,
        doing: Doing,
    ) -> Result<(), Failure> {
        while let Some(met) = alarm(&outcomes, doing) {
            if !self.may_give_way() {
                return Err(Failure::Final(met.why));
            }
            self.give_way(met).await?;
            outcomes = self.behave(orders, Until::All, Doing::Adjusting).await?;
        }
        self.contacts = 0;
        Ok(())
    }

    /// Whether what a hand meets may be given way to once more.
    pub(super) fn may_give_way(&self) -> bool {
        self.contacts < MOST_CONTACTS
    }

    /// Lets the hand that met something give way, until nothing presses it any more.
    async fn give_way(&mut self, mut met: Alarm) -> Result<(), Failure> {
        loop {
            self.contacts += 1;
            self.note(format!("{}: the hand gives way, and goes on", met.why));
            let outcomes = self.wait(met.hand, GIVE_WAY_SECONDS).await?;
            match alarm(&outcomes, Doing::GivingWay) {
                None => return Ok(()),
                Some(again) if self.may_give_way() => met = again,
                Some(again) => return Err(Failure::Strained(again.why)),
            }
        }
    }

    /// Lets a hand give way to whatever pulls, for a while (s).
    pub(super) async fn wait(&mut self, hand: Hand, seconds: f64) -> Result<Outcomes, Failure> {
        let selector = self.settings.grasp_selector();
        let yields = Behaviour::Present { pull: f64::INFINITY, selector, seconds };
        self.behave_alone(hand, yields, Doing::GivingWay).await
    }

    /// Lets a hand give way about its own z, too, until no torque is left.
    pub(super) async fn ease(&mut self, hand: Hand) -> Result<Outcomes, Failure> {
        let mut selector = self.settings.grasp_selector();
        selector[5] = true;
        let yields = Behaviour::Present { pull: f64::INFINITY, selector, seconds: EASE_SECONDS };
        self.behave_alone(hand, yields, Doing::GivingWay).await
    }

    /// Lets both hands stand where they are (s).
    pub(super) async fn stand(&mut self, seconds: f64) -> Result<(), Failure> {
        let speed = self.settings.speed;
        let orders = self
            .arms
            .map(|arm| Some(Behaviour::Joints { target: arm.desired_joints, speed, seconds }));
        let outcomes = self.behave(orders, Until::All, Doing::Adjusting).await?;
        match alarm(&outcomes, Doing::Adjusting) {
            Some(met) => Err(Failure::Final(met.why)),
            None => Ok(()),
        }
    }

    /// Moves joints; `None` leaves an arm where it is.
    pub(super) async fn joints(
        &mut self,
        targets: [Option<JointPositions>; 2],
    ) -> Result<(), Failure> {
        self.follow(self.joint_orders(targets), Until::All, Doing::Travelling).await
    }

    /// Moves joints by a way that may be too near to something. `false`: it was refused, and
    /// neither arm has moved.
    pub(super) async fn joints_unless_refused(
        &mut self,
        targets: [Option<JointPositions>; 2],
    ) -> Result<bool, Failure> {
        let orders = self.joint_orders(targets);
        let Some(outcomes) = self.travel_if_free(orders, "the hands go farther apart").await?
        else {
            return Ok(false);
        };
        self.go_on(outcomes, orders, Doing::Travelling).await?;
        Ok(true)
    }

    /// Has both arms go a way. `None`: it was refused, neither arm has moved, and a note says what
    /// is done instead.
    async fn travel_if_free(
        &mut self,
        orders: Orders,
        instead: &str,
    ) -> Result<Option<Outcomes>, Failure> {
        match self.behave(orders, Until::All, Doing::Travelling).await {
            Err(Failure::Final(why)) => {
                self.note(format!("{why}: {instead}"));
                Ok(None)
            }
            outcomes => outcomes.map(Some),
        }
    }

    /// Orders both arms to joint positions, evenly.
    fn joint_orders(&self, targets: [Option<JointPositions>; 2]) -> Orders {
        let (speed, speeds) = (self.settings.speed, &self.settings.speeds);
        // The ways between meetings are free of collisions when both arms go evenly: the quicker
        // one waits for the other at every point.
        let seconds = targets
            .iter()
            .zip(&self.arms)
            .filter_map(|(target, arm)| target.map(|to| (arm.desired_joints, to)))
            .map(|(from, to)| speeds.joints_seconds(&from, &to, speed))
            .fold(0.0, f64::max);
        targets.map(|to| to.map(|target| Behaviour::Joints { target, speed, seconds }))
    }

    /// Moves the track alone, as fast as the scenario lets it.
    async fn track_joints(&mut self, target: JointPositions, doing: Doing) -> Result<(), Failure> {
        let order = Behaviour::Joints { target, speed: self.settings.speed, seconds: 0.0 };
        let until = Until::Effector(Hand::Track.index());
        self.follow(alone(Hand::Track, order), until, doing).await
    }

    /// Retracts the track from the meeting, unless it is apart already.
    pub(super) async fn move_apart(&mut self) -> Result<(), Failure> {
        if self.apart {
            return Ok(());
        }
        self.separate(self.settings.meetings.separation).await
    }

    /// Retracts the track from where it stands (m).
    pub(super) async fn separate(&mut self, by: f64) -> Result<(), Failure> {
        self.check_hold()?;
        self.apart = true;
        if by == 0.0 {
            return Ok(());
        }
        let mut target = self.arms[Hand::Track.index()].desired_joints;
        let back = target.0[0] - by;
        target.0[0] = self.least_track.map_or(back, |least| back.max(least));
        self.track_joints(target, Doing::Travelling).await
    }

    /// Returns how far the track stands back from a meeting at least, on an even way of both arms
    /// between there and where they are apart (m); `None` where none is known.
    pub(super) fn least_separation(
        &self,
        apart: &[JointPositions; 2],
        met: &[JointPositions; 2],
        newcomer: Hand,
    ) -> Option<f64> {
        self.settings.ways.as_ref()?.least_separation(apart, met, newcomer.index())
    }

    /// Brings both arms from one meeting to another in one go. `false`: the way was refused, or
    /// they met something on it and gave way to it, and stand there.
    pub(super) async fn cross(
        &mut self,
        way: &Way,
        to: [JointPositions; 2],
    ) -> Result<bool, Failure> {
        let from = [0, 1].map(|arm: usize| self.arms[arm].desired_joints);
        let speeds = &self.settings.speeds;
        let seconds = way.least_seconds(speeds, &from, &to);
        let orders =
            way.legs(speeds, &from, &to).map(|legs| Some(Behaviour::Legs { legs, seconds }));
        // The way is one of the table's, and the arms do not stand quite where it begins.
        let Some(outcomes) = self.travel_if_free(orders, "the hands go apart first").await? else {
            return Ok(false);
        };
        let Some(met) = alarm(&outcomes, Doing::Travelling) else { return Ok(true) };
        if !self.may_give_way() {
            return Err(Failure::Final(met.why));
        }
        self.give_way(met).await?;
        Ok(false)
    }

    /// Moves the track up to the meeting from where it stands back from it by so much (m).
    pub(super) async fn move_together(
        &mut self,
        track: JointPositions,
        separation: f64,
    ) -> Result<(), Failure> {
        // The arms are near to each other already where the separation is small.
        self.apart = false;
        self.check_hold()?;
        if separation == 0.0 {
            return Ok(());
        }
        self.track_joints(track, Doing::Adjusting).await
    }

    /// Orders a line to a place of the tool.
    pub(super) fn line(&self, target: Pose) -> Behaviour {
        Behaviour::Line { target, speed: self.settings.speed }
    }

    /// Orders a line to or from where the operator's hand may be.
    pub(super) fn gentle_line(&self, target: Pose) -> Behaviour {
        Behaviour::Line { target, speed: self.settings.gentle }
    }

    /// Follows a line that is ordered to a pose relative to the set one of the tool.
    async fn relative(
        &mut self,
        hand: Hand,
        by: Pose,
        order: impl Fn(&Self, Pose) -> Behaviour,
        doing: Doing,
    ) -> Result<(), Failure> {
        let line = order(self, self.arms[hand.index()].desired_base_from_tool * by);
        self.follow(alone(hand, line), Until::Effector(hand.index()), doing).await
    }

    /// Moves a hand along its tool's own z (m) where the operator's hand may be.
    pub(super) async fn along_gently(&mut self, hand: Hand, way: f64) -> Result<(), Failure> {
        let by = Pose::translation(0.0, 0.0, way);
        self.relative(hand, by, Self::gentle_line, Doing::Travelling).await
    }

    /// Moves a hand along its tool's own z (m).
    pub(super) async fn along(&mut self, hand: Hand, way: f64) -> Result<(), Failure> {
        self.relative(hand, Pose::translation(0.0, 0.0, way), Self::line, Doing::Travelling).await
    }

    /// Moves a hand along its tool's axes by a small step (m).
    pub(super) async fn nudge(&mut self, hand: Hand, [x, y, z]: [f64; 3]) -> Result<(), Failure> {
        self.relative(hand, Pose::translation(x, y, z), Self::line, Doing::Adjusting).await
    }

    /// Rolls a hand about its tool's own z (rad).
    pub(super) async fn roll(&mut self, hand: Hand, angle: f64) -> Result<(), Failure> {
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let by = Pose::from_parts(nalgebra::Translation3::identity(), roll);
        self.relative(hand, by, Self::line, Doing::Adjusting).await
    }

    /// Moves a hand to where its guarded approach to the partner's cube begins.
    pub(super) async fn pre_grasp(&mut self, hand: Hand, grip: Grip) -> Result<(), Failure> {
        let seat = self.grasp_pose(hand, grip)?;
        let short = self.short_of_cube(hand, grip);
        let line = self.line(seat * Pose::translation(0.0, 0.0, -short));
        let until = Until::Effector(hand.index());
        self.follow(alone(hand, line), until, Doing::Adjusting).await
    }

    /// Returns how far short of the cube its guarded approach begins (m): the cube may stand nearer
    /// than it is believed to, by the filter's own doubt and by what the last grasps were off.
    fn short_of_cube(&self, hand: Hand, grip: Grip) -> f64 {
        let least = self.settings.pre_grasp;
        let doubt = self.belief.doubt_ahead(hand, grip.hold, grip.half_roll, &self.arms);
        let off = doubt.map_or(UNSURE, |deviation| MOST_OFF * deviation.hypot(UNMODELLED));
        (off.max(self.miss) + SURE).clamp(least, least.max(UNSURE))
    }

    fn grasp_pose(&self, hand: Hand, grip: Grip) -> Result<Pose, Failure> {
        let pose = self.belief.grasp_pose(hand, grip.hold, grip.half_roll, &self.arms);
        Ok(pose.ok_or("the partner does not hold the cube")?)
    }

    /// Moves an open hand onto the partner's cube, until the palm touches.
    pub(super) async fn approach(&mut self, hand: Hand, grip: Grip) -> Result<(), Failure> {
        let s = &self.settings;
        let order = if s.compliance == ComplianceChoice::None {
            Behaviour::Line { target: self.grasp_pose(hand, grip)?, speed: 0.2 * s.speed }
        } else {
            Behaviour::Approach {
                speed: s.approach_speed,
                distance: self.short_of_cube(hand, grip) + 0.015,
                force: s.touch,
                selector: [false; 6],
            }
        };
        let outcomes = self.behave_alone(hand, order, Doing::Approaching).await?;
        if let Some(met) = alarm(&outcomes, Doing::Approaching) {
            return Err(Failure::NotGrasped { hand, why: met.why });
        }
        match outcomes[hand.index()] {
            Some(Outcome::Touched(_) | Outcome::Reached) => Ok(()),
            other => {
                let (name, found) = (hand.name(), Outcome::words(other));
                let why = format!(
                    "the {name} hand did not find the cube where the partner holds it: {found}"
                );
                Err(Failure::NotGrasped { hand, why })
            }
        }
    }

    /// Orders the jaws to close on a cube.
    pub(super) fn jaws_close(&self, stops: Depth) -> Behaviour {
        let s = &self.settings;
        Behaviour::Grasp {
            force: s.grip,
            least_width: LEAST_WIDTH * s.edge,
            selector: s.grasp_selector(),
            stops,
        }
    }

    /// Closes the jaws of a hand on the cube.
    pub(super) async fn close(
        &mut self,
        hand: Hand,
        hold: Hold,
        closing: Closing,
    ) -> Result<(), Failure> {
        self.check_hold()?;
        self.stops[hand.index()] = hold.depth;
        let order = self.jaws_close(hold.depth);
        let outcomes = self.behave_alone(hand, order, Doing::ClosingJaws).await?;
        if let Some(met) = alarm(&outcomes, Doing::ClosingJaws) {
            return Err(Failure::NotGrasped { hand, why: met.why });
        }
        match outcomes[hand.index()] {
            Some(Outcome::Grasped(width)) if width > LEAST_WIDTH * self.settings.edge => {
                self.log.grasps += 1;
                let known = self.widths[hand.index()].filter(|_| closing == Closing::OnLayer);
                self.widths[hand.index()] = Some(known.map_or(width, |known| known.min(width)));
                Ok(())
            }
            // Jaws that were opening when the other run ended looked like jaws on a cube.
            Some(Outcome::Empty(_))
                if hand == Hand::Track && self.maybe_offered.is_some_and(|cube| cube.opening) =>
            {
                Err(Failure::WithOperator("the jaws close on nothing".to_owned()))
            }
            other => {
                let (name, found) = (hand.name(), Outcome::words(other));
                let why = format!("the {name} hand's jaws do not hold the cube: {found}");
                Err(Failure::NotGrasped { hand, why })
            }
        }
    }

    /// Presses the cube into the palm and the partner's, and learns where the partner stands.
    pub(super) async fn secure(&mut self, hand: Hand, grip: Grip) -> Result<(), Failure> {
        let Grip { hold, half_roll } = grip;
        let s = &self.settings;
        let order = Behaviour::Secure {
            press: s.press,
            force: s.grip,
            selector: s.grasp_selector(),
            stops: hold.depth,
        };
        self.check_hold()?;
        self.stops[hand.index()] = hold.depth;
        let outcomes = self.behave_alone(hand, order, Doing::Securing).await?;
        if let Some(met) = alarm(&outcomes, Doing::Securing) {
            return Err(Failure::NotGrasped { hand, why: met.why });
        }
        let miss = self.belief.secured(hand, hold, half_roll, &self.arms);
        self.miss = miss.z.abs().max(0.5 * self.miss);
        if miss.norm() > 0.004 {
            let (name, mm) = (hand.name(), miss.norm() * 1e3);
            self.note(format!(
                "the {name} hand found the cube {mm:.1} mm from where it was expected"
            ));
        }
        Ok(())
    }

    /// Opens the jaws of a hand. Whether what strains them hinders depends on who holds the cube.
    pub(super) async fn open(&mut self, hand: Hand, stops: Depth) -> Result<(), Failure> {
        self.open_to(hand, stops, self.given_back).await
    }

    /// Opens the jaws. `theirs`: the person who takes the cube, however hard, gets it.
    pub(super) async fn open_to(
        &mut self,
        hand: Hand,
        stops: Depth,
        theirs: bool,
    ) -> Result<(), Failure> {
        // Opening relieves what strains the jaws: they try again after giving way for a while.
        for tries in 0.. {
            self.check_hold()?;
            let order = self.jaws_open(hand, stops, theirs);
            self.stops[hand.index()] = stops;
            let outcomes = self.behave_alone(hand, order, Doing::OpeningJaws).await?;
            let Some(met) = alarm(&outcomes, Doing::OpeningJaws) else { break };
            if tries >= MOST_STRAINED {
                return Err(Failure::Final(met.why));
            }
            self.note(format!("{}: once more", met.why));
            self.wait(hand, STRAINED_SECONDS).await?;
        }
        Ok(())
    }

    /// Whether the jaws of a hand stand open beside the partner's cube, and the palm's stops where
    /// they are wanted.
    pub(super) fn stands_open(&self, hand: Hand, stops: Depth) -> bool {
        let (i, s) = (hand.index(), &self.settings);
        self.stops[i] == stops && self.arms[i].jaw_opening > s.regrasp_opening - OPEN_ENOUGH
    }

    fn jaws_open(&self, hand: Hand, stops: Depth, theirs: bool) -> Behaviour {
        // While the partner or the operator holds the cube too, what is strained between the hands
        // gives way before the pads do.
        let partner_holds = self.belief.held[hand.other().index()].is_some();
        let chained = partner_holds && !self.apart;
        let yields = (chained || theirs) && self.trust == Trust::Believed;
        let s = &self.settings;
        // Between the hands it is known to a millimetre or two where the cube is.
        let opening = if partner_holds { s.regrasp_opening } else { s.opening };
        Behaviour::Jaw {
            jaw: JawCommand { opening, force_limit: s.grip, stops },
            seconds: s.jaw_leave,
            selector: if yields { s.grasp_selector() } else { [false; 6] },
            // A strain that is only believed does not hinder either.
            strained: theirs || self.trust == Trust::Doubted,
        }
    }

    /// Orders the visual servo to the cube that is held out or lies on the table.
    pub(super) fn servo_to_cube(&self) -> Behaviour {
        let (s, visual) = (&self.settings, self.settings.visual);
        Behaviour::VisualServo(visual_servo::Order {
            world_from_base: self.belief.world_from_base(Hand::Track),
            seat: s.edge / 3.0,
            patience: self.seeks.map_or(visual.patience, |time| time.min(visual.patience)),
            ..visual
        })
    }

    /// Pulls a little at the cube in the track hand, and returns how that ended: touched means that
    /// somebody holds it. `share` is the force that tells, as a share of the operator's pull.
    pub(super) async fn pull(
        &mut self,
        share: f64,
        doing: Doing,
    ) -> Result<Option<Outcome>, Failure> {
        let s = &self.settings;
        let mut selector = s.grasp_selector();
        selector[2] = false;
        let order = Behaviour::Withdraw {
            speed: s.approach_speed,
            distance: PULL_WAY,
            force: share * s.pull,
            selector,
        };
        let outcomes = self.behave_alone(Hand::Track, order, doing).await?;
        Ok(outcomes[Hand::Track.index()])
    }

    /// Holds the cube out and waits for a pull.
    pub(super) async fn present(&mut self) -> Result<Outcomes, Failure> {
        self.check_hold()?;
        self.given_back = true;
        let (pull, selector) = (self.settings.pull, self.settings.grasp_selector());
        let order = Behaviour::Present { pull, selector, seconds: PRESENT_SECONDS };
        self.behave_alone(Hand::Track, order, Doing::HandingBack).await
    }

    /// Turns a layer while the partner gives way; the turn stands still at a torque (Nm).
    pub(super) async fn turn(
        &mut self,
        turner: Hand,
        angle: f64,
        torque: f64,
    ) -> Result<Outcomes, Failure> {
        self.straight = self.straight.or_else(|| self.straight_now(turner));
        let s = &self.settings;
        let body = turner.other();
        let axis = self.belief.turn_axis(turner).ok_or("a hand is empty in a turn")?;
        let (turner_selector, body_selector) = match s.compliant_arm {
            CompliantArm::Body => ([false; 6], s.turn_selector(axis)),
            CompliantArm::Turner => (s.turn_selector(2), [false; 6]),
        };
        let most = if angle.abs() < SHORT_TURN { GENTLE } else { f64::INFINITY };
        let mut orders = alone(
            turner,
            Behaviour::Turn {
                angle,
                // A hand that is to yield to less turns slower: its admittance stays.
                speed: s.turn_speed * (torque / s.turn_torque).min(1.0),
                acceleration: s.turn_acceleration.min(most),
                torque,
                least_torque: s.turn_least_torque,
                selector: turner_selector,
                stiff: s.compliance == ComplianceChoice::None,
            },
        );
        orders[body.index()] = Some(Behaviour::Comply { selector: body_selector });
        self.behave(orders, Until::Effector(turner.index()), Doing::Turning).await
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Stage, goes_well, order, settings, taken, track, words};
    use super::super::{give_back, regrasp};
    use super::*;
    use crate::cube::Keeper;
    use crate::motion::ArmState;
    use crate::reach::{Meeting, WayFinder};
    use crate::tasks::cube::settings::CubeSettings;
    use crate::tasks::cube::think::{Conclusion, Thought};
    use crate::tasks::{Action, Event};

    /// Plays a motion with the cube in the track hand, or a procedure of motions. Returns the word
    /// of each action, and whether an entry for another run was published before it. Nobody takes a
    /// cube that is held out, and a pull finds a holder.
    fn noted(
        keeper: Keeper,
        motion: impl AsyncFnOnce(&mut Robot) -> Result<(), Failure>,
    ) -> Vec<(&'static str, bool)> {
        let mut stage = Stage::holding(CubeSettings { keeper, ..settings() });
        stage.robot.hand_over = Some(JointPositions([0.3; 7]));
        let port = stage.port.clone();
        let mut noted = Vec::new();
        let (end, _) = stage.play(motion, &mut |action, arms| {
            let word = words(std::slice::from_ref(action))[0];
            noted.push((word, port.state(|shared| shared.entry.is_some())));
            match order(action) {
                Some(Behaviour::Present { pull, .. }) if pull.is_finite() => {
                    track(Outcome::TimedOut(20.0))
                }
                Some(Behaviour::Withdraw { .. }) => track(Outcome::Touched(0.003)),
                _ => goes_well(action, arms),
            }
        });
        assert!(end.is_ok(), "{end:?}");
        noted
    }

    /// Checks that a single motion is noted, or not.
    macro_rules! assert_noted {
        ($word:literal, $is_noted:literal, $robot:ident, $motion:expr) => {
            let motion = async |$robot: &mut Robot| $motion.await.map(drop);
            assert_eq!(noted(Keeper::Person, motion), [($word, $is_noted)]);
        };
    }

    #[test]
    fn motion_is_noted_before_it_begins() {
        let hand = Hand::Postument;
        assert_noted!("line", true, robot, robot.along(Hand::Track, -0.05));
        assert_noted!("joints", true, robot, robot.joints([None, Some(JointPositions([0.1; 7]))]));
        assert_noted!("joints", true, robot, {
            robot.apart = false;
            robot.move_apart()
        });
        assert_noted!("close", true, robot, robot.close(hand, taken(), Closing::Straight));
        assert_noted!("open", true, robot, robot.open(hand, Depth::One));
        assert_noted!("turn", true, robot, {
            robot.hold(hand);
            robot.turn(Hand::Track, 1.0, 2.0)
        });
        assert_noted!("present", true, robot, robot.present());
    }

    /// A journal entry costs a write to the disk: small and repeated ways do without.
    #[test]
    fn small_motion_is_not_noted() {
        assert_noted!("line", false, robot, robot.nudge(Hand::Track, [0.001, 0.0, 0.0]));
        assert_noted!("line", false, robot, robot.roll(Hand::Track, 0.1));
        assert_noted!("give way", false, robot, robot.wait(Hand::Track, 1.0));
    }

    #[test]
    fn hand_back_is_noted_at_each_motion() {
        let solved = async |robot: &mut Robot| give_back::solved(robot).await.map(drop);
        let handed_back = [
            ("hand back", false),
            ("joints", true),
            ("line", true),
            ("zero", false),
            ("present", true),
            ("zero", false),
            ("pull", true),
            ("open", true),
            ("line", true),
        ];
        assert_eq!(noted(Keeper::Person, solved), handed_back);

        let solved = async |robot: &mut Robot| give_back::solved(robot).await.map(drop);
        let laid_down = [
            ("lay down", false),
            ("joints", true),
            ("line", true),
            ("zero", false),
            // The cube is lowered onto the table.
            ("approach", true),
            ("open", true),
            ("line", true),
        ];
        assert_eq!(noted(Keeper::Table, solved), laid_down);
    }

    #[test]
    fn cube_that_was_off_is_approached_from_farther() {
        let distance = |miss: f64, pre_grasp: f64| {
            let mut stage = Stage::holding(CubeSettings { pre_grasp, ..settings() });
            stage.robot.miss = miss;
            let grip = Grip { hold: taken(), half_roll: false };
            let mut found = None;
            let approach = async |robot: &mut Robot| robot.approach(Hand::Postument, grip).await;
            let (end, _) = stage.play(approach, &mut |action, arms| {
                if let Action::Behave { orders, .. } = action
                    && let Some(Behaviour::Approach { distance, .. }) = orders[1]
                {
                    found = Some(distance - 0.015);
                }
                goes_well(action, arms)
            });
            assert!(end.is_ok(), "{end:?}");
            found.unwrap()
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        let doubted = distance(0.0, 0.004);
        assert!(doubted > 0.006 && doubted < UNSURE, "{doubted} m by what the filter knows");
        near(distance(0.009, 0.004), 0.009 + SURE);
        near(distance(UNSURE, 0.004), UNSURE);
        near(distance(0.0, UNSURE), UNSURE);
        near(distance(0.0, 0.03), 0.03);
    }

    /// Brings the hands to a grasp by a way whose legs come to this event. Returns the words of the
    /// orders, and how the way ended.
    fn meets(legs: Event<Conclusion>) -> (Vec<&'static str>, Result<(), Failure>) {
        let way = Way { separation: 0.1, stroke: 0.3, across: 0.1, ramp: 0.1, seconds: 2.0 };
        let mut settings = settings();
        settings.meetings.ways = vec![Some(way); 30 * 30 * 2];
        let mut stage = Stage::holding(settings);
        let meeting = stage.robot.settings.meetings.grasps[0].unwrap();
        (stage.robot.meeting, stage.robot.apart) = (Some(meeting), false);
        let (mut orders, mut legs) = (Vec::new(), Some(legs));
        let meet = async |robot: &mut Robot| {
            regrasp::meet(robot, Hand::Postument, meeting, regrasp::Coming::ToGrasp).await
        };
        let (end, _) = stage.play(meet, &mut |action, arms| {
            let Action::Behave { orders: sent, .. } = action else {
                return goes_well(action, arms);
            };
            let goes_across = matches!(sent, [Some(Behaviour::Legs { .. }), ..]);
            orders.push(match sent {
                _ if goes_across => "legs",
                [Some(Behaviour::Present { .. }), ..] => "gives way",
                _ => "joints",
            });
            match legs.take_if(|_| goes_across) {
                Some(event) => event,
                None => goes_well(action, arms),
            }
        });
        (orders, end)
    }

    /// Conditions of a way between a meeting and a place apart.
    #[derive(Clone)]
    struct Conditions {
        /// Finds how near the arms may go to each other.
        ways: Option<WayFinder>,
        /// MP refuses the first try.
        refused: bool,
        /// The track has lost the cube at its end.
        lost: bool,
    }

    /// Goes with the cube in the track hand from `begin` to a meeting at `end`, or back to where
    /// the track stands at `end`. The arms go where they are sent. Returns the stage, how the way
    /// ended, and where the track was sent.
    fn goes(
        begin: [JointPositions; 2],
        end: [JointPositions; 2],
        meets: bool,
        Conditions { ways, mut refused, lost }: Conditions,
    ) -> (Stage, Result<(), Failure>, Vec<JointPositions>) {
        let mut stage = Stage::holding(CubeSettings { ways, ..settings() });
        stage.robot.apart = meets;
        stage.robot.widths[Hand::Track.index()] = Some(0.0567);
        for (arm, joints) in stage.robot.arms.iter_mut().zip(begin) {
            (arm.desired_joints, arm.jaw_opening) = (joints, 0.0567);
        }
        let [track, postument] = end;
        let meeting = Meeting { track, postument, ..settings().meetings.grasps[0].unwrap() };
        let mut sent = Vec::new();
        let mut shell = |action: &Action<Thought>, arms: &mut [ArmState; 2]| {
            let Action::Behave { orders, .. } = action else { return goes_well(action, arms) };
            let Some(Behaviour::Joints { target, .. }) = orders[0] else { panic!("{action:?}") };
            // All but the track's own way from or to the meeting.
            if (orders[1].is_some() || !meets && target == track) && std::mem::take(&mut refused) {
                return Event::Trouble("too near".to_owned());
            }
            arms[0].desired_joints = target;
            sent.push(target);
            arms[0].jaw_opening = if lost { 0.053 } else { 0.0567 };
            goes_well(action, arms)
        };
        let way = async |robot: &mut Robot| {
            if meets {
                regrasp::meet(robot, Hand::Postument, meeting, regrasp::Coming::ToLook).await
            } else {
                regrasp::return_to(robot, track).await
            }
        };
        let (end, _) = stage.play(way, &mut shell);
        (stage, end, sent)
    }

    #[test]
    fn hands_go_no_farther_apart_than_needed() {
        let finder = WayFinder::of_example();
        let (met, by) = finder.example_place();
        let [apart, _] = WayFinder::example_start();
        let back = |by: f64| {
            let mut track = met[0];
            track.0[0] -= by;
            track
        };
        let usual = settings().meetings.separation;
        let near = Conditions { ways: Some(finder), refused: false, lost: false };
        let too_near = Conditions { refused: true, ..near.clone() };
        let far = Conditions { ways: None, ..near.clone() };

        for (conditions, stands, returns) in [
            (near, by, vec![back(by), apart]),
            (too_near, usual, vec![back(by), back(usual), apart]),
            (far, usual, vec![back(usual), apart]),
        ] {
            let start = [apart, met[1]];
            let (stage, end, sent) = goes(start, met, true, conditions.clone());
            assert!(end.is_ok() && !stage.robot.apart, "{end:?}");
            assert_eq!(sent, [back(stands), met[0]]);

            let (stage, end, sent) = goes(met, start, false, conditions);
            assert!(end.is_ok() && stage.robot.apart, "{end:?}");
            assert_eq!(sent, returns);
        }
    }

    #[test]
    fn lost_cube_leaves_hands_that_are_near() {
        let apart = WayFinder::example_start();
        let lost = Conditions { ways: Some(WayFinder::of_example()), refused: false, lost: true };

        let (stage, end, _) = goes(apart, apart, true, lost);

        assert_eq!(end, Err(Failure::Lost(Hand::Track)));
        assert!(!stage.robot.apart, "nothing stands back");
    }

    #[test]
    fn way_that_is_refused_is_gone_in_turn() {
        let in_turn = ["joints"; 3];
        let (orders, end) = meets(Event::Behaved([Some(Outcome::Reached); 2]));
        assert!(end.is_ok() && orders == ["legs"], "{orders:?}");

        let (orders, end) = meets(Event::Trouble("too near".to_owned()));
        assert!(end.is_ok() && orders == [&["legs"][..], &in_turn].concat(), "{orders:?}");

        let met = Event::Behaved([Some(Outcome::OverForce(2, 31.0)), Some(Outcome::Ended)]);
        let (orders, end) = meets(met);
        let way = [&["legs", "gives way"][..], &in_turn].concat();
        assert!(end.is_ok() && orders == way, "{orders:?}");
    }
}
