//! The motions of the mission: one method per motion, and the orders that it sends.
//!
//! - in: the target of a hand, or the grip that it takes
//! - out: the outcome of the motion, or a [`Failure`]
//!
//! | limit | value | reason |
//! |---|---|---|
//! | [`MOST_CONTACTS`] | 3 | obstacles on one path before the mission stops trying |
//! | [`RETRY_SPEED`] | 0.3 | an obstacle that is still there is met with a third of the blow |
//! | [`MOST_STRAINED`] | 6 | retries of strained jaws to open; opening relieves the strain |
//! | [`EASE_SECONDS`] | 0.6 s | a hand that yields about its own z has lost its torque by then |
//! | [`DEVIATIONS`] | 3.5 | in 153 grasps no cube was nearer by more standard deviations |
//! | [`SHORT_TURN`], [`GENTLE`] | 0.2 rad, 1 rad/s2 | a jammed motor looked frozen at 3 rad/s2 |

use super::failure::{Alarm, Failure, alarm};
use super::failure::{Orders, Outcomes, alone};
use super::robot::{LEAST_WIDTH, Robot, Trust, UNSURE};
use super::shared::Doing;
use crate::generators::{Behaviour, Outcome, visual_servo};
use crate::kernel::Until;
use crate::motion::{Depth, JawCommand, JointPositions};
use crate::reach::MeetingPath;
use crate::spatial::Pose;
use crate::tasks::cube::hold::{Grip, Hand, Hold};
use crate::tasks::cube::settings::{ComplianceChoice, CompliantArm};
use nalgebra::{UnitQuaternion, Vector3};

/// Number of times that a hand yields to obstacles on one path.
const MOST_CONTACTS: u32 = 3;
/// Speed of a path after a contact, as a share of its speed at first.
const RETRY_SPEED: f64 = 0.3;
/// Time in which a hand yields to an obstacle (s).
pub(super) const GIVE_WAY_SECONDS: f64 = 1.0;
/// Time in which a hand yields about its own z, until it has lost its torque (s).
const EASE_SECONDS: f64 = 0.6;
/// Retries of strained jaws to open, and the time in which the hand yields between them (s).
pub(super) const MOST_STRAINED: u32 = 6;
const STRAINED_SECONDS: f64 = 0.3;
/// Greatest shortfall of the opening at which jaws count as open (m).
const OPEN_ENOUGH: f64 = 0.0015;
/// Margin of an arm that stops before a cube (m): the arm swings, and its gears have play.
const STOP_MARGIN: f64 = 0.0025;
/// Standard deviation of the cube's position by play and by a cube that lies tilted on the palm's
/// stops (m). The filter of [`super::super::belief`] does not model them.
const UNMODELLED: f64 = 0.0005;
/// Standard deviations before the cube at which an approach begins; [`STOP_MARGIN`] is added, and
/// [`UNSURE`] is the most. In 153 grasps of ten cells no cube was nearer than this.
const DEVIATIONS: f64 = 3.5;
/// Length below which a turn eases a stalled layer (rad), and its greatest acceleration (rad/s2).
/// At 3 rad/s2 a jammed motor stopped behind its set value until its encoder counted as frozen, on
/// 19 of 60 seeds of `faults/jam.toml`. At 1.7 rad/s2 none did.
const SHORT_TURN: f64 = 0.2;
const GENTLE: f64 = 1.0;
/// Length of the small pull that detects a person's hold of the cube (m).
const PULL_DISTANCE: f64 = 0.02;
/// Time in which the cube is held out (s).
const PRESENT_SECONDS: f64 = 20.0;

/// State of the cube on which jaws close.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Closing {
    /// All layers are in line.
    Straight,
    /// The layer between the jaws may be misaligned, so that the smaller width is the cube's.
    OnLayer,
}

impl Robot {
    /// Requests behaviours, and repeats those that end in an alarm: the hand that met an obstacle
    /// yields first, up to [`MOST_CONTACTS`] times.
    pub(super) async fn execute(
        &mut self,
        orders: Orders,
        until: Until,
        doing: Doing,
    ) -> Result<(), Failure> {
        let outcomes = self.behave(orders.clone(), until, doing).await?;
        self.retry_after_contact(outcomes, orders, doing).await
    }

    /// Yields and repeats the orders while their outcomes contain an alarm, up to [`MOST_CONTACTS`]
    /// times. `outcomes` are those of the first try.
    async fn retry_after_contact(
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
            // The journal has this motion already: a retry costs no second entry.
            outcomes = self.behave(slowed(orders.clone()), Until::All, Doing::Adjusting).await?;
        }
        self.contacts = 0;
        Ok(())
    }

    /// Returns whether a hand may yield once more to an obstacle on the present path.
    pub(super) fn may_give_way(&self) -> bool {
        self.contacts < MOST_CONTACTS
    }

    /// Lets the hand that met an obstacle yield, until the obstacle no longer presses it.
    async fn give_way(&mut self, mut met: Alarm) -> Result<(), Failure> {
        loop {
            self.contacts += 1;
            self.note(format!("{contact}: the hand yields and continues", contact = met.why));
            let outcomes = self.wait(met.hand, GIVE_WAY_SECONDS).await?;
            match alarm(&outcomes, Doing::GivingWay) {
                None => return Ok(()),
                Some(again) if self.may_give_way() => met = again,
                Some(again) => return Err(Failure::Strained(again.why)),
            }
        }
    }

    /// Lets a hand yield to any force for `seconds`.
    pub(super) async fn wait(&mut self, hand: Hand, seconds: f64) -> Result<Outcomes, Failure> {
        let selector = self.settings.grasp_selector();
        // No force reaches an infinite pull, so that only the time or an overload ends this.
        let yields = Behaviour::Present { pull: f64::INFINITY, selector, seconds };
        self.behave_alone(hand, yields, Doing::GivingWay).await
    }

    /// Lets a hand yield for [`EASE_SECONDS`], also about its own z, so that it loses its torque.
    pub(super) async fn yield_torque(&mut self, hand: Hand) -> Result<Outcomes, Failure> {
        let mut selector = self.settings.grasp_selector();
        selector[5] = true;
        let yields = Behaviour::Present { pull: f64::INFINITY, selector, seconds: EASE_SECONDS };
        self.behave_alone(hand, yields, Doing::GivingWay).await
    }

    /// Holds both hands in place for `seconds`.
    pub(super) async fn hold_still(&mut self, seconds: f64) -> Result<(), Failure> {
        let speed = self.settings.speed;
        // A motion to the present set values is stiff, and `seconds` is its least duration.
        let orders = self
            .arms
            .map(|arm| Some(Behaviour::Joints { target: arm.desired_joints, speed, seconds }));
        let outcomes = self.behave(orders, Until::All, Doing::Adjusting).await?;
        match alarm(&outcomes, Doing::Adjusting) {
            Some(met) => Err(Failure::Final(met.why)),
            None => Ok(()),
        }
    }

    /// Moves both arms to joint positions, at which they arrive at the same time; `None` leaves an
    /// arm where it is.
    pub(super) async fn joints(
        &mut self,
        targets: [Option<JointPositions>; 2],
    ) -> Result<(), Failure> {
        self.execute(self.joint_orders(targets), Until::All, Doing::Travelling).await
    }

    /// Moves both arms to joint positions along a path that may be too near to an obstacle. Returns
    /// `false` if the path was refused; neither arm has moved then.
    pub(super) async fn joints_unless_refused(
        &mut self,
        targets: [Option<JointPositions>; 2],
    ) -> Result<bool, Failure> {
        let orders = self.joint_orders(targets);
        let instead = "the hands move farther apart";
        let Some(outcomes) = self.travel_if_free(orders.clone(), instead).await? else {
            return Ok(false);
        };
        self.retry_after_contact(outcomes, orders, Doing::Travelling).await?;
        Ok(true)
    }

    /// Moves both arms along a path. Returns `None` if the path was refused: neither arm has moved
    /// then, and a note says what the arms do `instead`.
    async fn travel_if_free(
        &mut self,
        orders: Orders,
        instead: &str,
    ) -> Result<Option<Outcomes>, Failure> {
        match self.behave(orders, Until::All, Doing::Travelling).await {
            // The guard of MP checks a path before it begins, and refuses it as trouble.
            Err(Failure::Final(why)) => {
                self.note(format!("the path is refused ({why}): {instead}"));
                Ok(None)
            }
            outcomes => outcomes.map(Some),
        }
    }

    /// Makes orders for both arms to joint positions, with one duration for both.
    fn joint_orders(&self, targets: [Option<JointPositions>; 2]) -> Orders {
        let (speed, speeds) = (self.settings.speed, &self.settings.speeds);
        // The paths between meetings are free of collisions only while both arms have covered the
        // same share of them. With a time for each arm a cube was torn out of a hand (seed 49).
        let seconds = targets
            .iter()
            .zip(&self.arms)
            .filter_map(|(target, arm)| target.map(|to| (arm.desired_joints, to)))
            .map(|(from, to)| speeds.joints_seconds(&from, &to, speed))
            .fold(0.0, f64::max);
        targets.map(|to| to.map(|target| Behaviour::Joints { target, speed, seconds }))
    }

    /// Moves the track alone, as fast as the scenario allows.
    async fn track_joints(&mut self, target: JointPositions, doing: Doing) -> Result<(), Failure> {
        let order = Behaviour::Joints { target, speed: self.settings.speed, seconds: 0.0 };
        let until = Until::Effector(Hand::Track.index());
        self.execute(alone(Hand::Track, order), until, doing).await
    }

    /// Retracts the track from the meeting by the usual separation, unless the arms are apart
    /// already.
    pub(super) async fn move_apart(&mut self) -> Result<(), Failure> {
        if self.apart {
            return Ok(());
        }
        self.separate(self.settings.meetings.separation).await
    }

    /// Retracts the track from its present position by the distance `by` (m).
    pub(super) async fn separate(&mut self, by: f64) -> Result<(), Failure> {
        self.check_hold()?;
        self.apart = true;
        // An order without a distance would still cost a journal entry.
        if by == 0.0 {
            return Ok(());
        }
        let mut target = self.arms[Hand::Track.index()].desired_joints;
        let back = target.0[0] - by;
        // A resumed mission may begin anywhere on the track, so the retraction ends where the arm
        // is clear of every meeting.
        target.0[0] = self.least_track.map_or(back, |least| back.max(least));
        self.track_joints(target, Doing::Travelling).await
    }

    /// Returns the shortest distance (m) by which the arm on the track must retract from the joint
    /// positions `met`, at which both hands hold the cube. From there both arms can move at once to
    /// or from the joint positions `apart`. Returns `None` if the distance is unknown.
    pub(super) fn least_separation(
        &self,
        apart: &[JointPositions; 2],
        met: &[JointPositions; 2],
        newcomer: Hand,
    ) -> Option<f64> {
        self.settings.ways.as_ref()?.least_separation(apart, met, newcomer.index())
    }

    /// Moves both arms from one meeting to another in one motion. Returns `false` if the path was
    /// refused, or if a hand met an obstacle, yielded, and stopped there.
    pub(super) async fn move_across(
        &mut self,
        way: &MeetingPath,
        to: [JointPositions; 2],
    ) -> Result<bool, Failure> {
        let from = [0, 1].map(|arm: usize| self.arms[arm].desired_joints);
        let speeds = &self.settings.speeds;
        let seconds = way.least_seconds(speeds, &from, &to);
        let orders =
            way.legs(speeds, &from, &to).map(|legs| Some(Behaviour::Legs { legs, seconds }));
        // The table holds the path from one meeting to another, but the arms are only near its
        // beginning: the filter has corrected the last grasp. So the guard may refuse it.
        let Some(outcomes) = self.travel_if_free(orders, "the hands move apart first").await?
        else {
            return Ok(false);
        };
        let Some(met) = alarm(&outcomes, Doing::Travelling) else { return Ok(true) };
        if !self.may_give_way() {
            return Err(Failure::Final(met.why));
        }
        self.give_way(met).await?;
        Ok(false)
    }

    /// Moves the track forward to its joint positions `track` at the meeting, from which it was
    /// retracted by `separation` (m).
    pub(super) async fn move_together(
        &mut self,
        track: JointPositions,
        separation: f64,
    ) -> Result<(), Failure> {
        // Set before the hold is checked: with a small separation the arms are near already, and
        // after a loss they would otherwise leave sideways without retracting.
        self.apart = false;
        self.check_hold()?;
        if separation == 0.0 {
            return Ok(());
        }
        self.track_joints(track, Doing::Adjusting).await
    }

    /// Makes an order for a straight line of the tool to a pose.
    pub(super) fn line(&self, target: Pose) -> Behaviour {
        Behaviour::Line { target, speed: self.settings.speed }
    }

    /// Makes an order for a slow straight line, where the operator's hand may be.
    pub(super) fn gentle_line(&self, target: Pose) -> Behaviour {
        Behaviour::Line { target, speed: self.settings.gentle }
    }

    /// Moves the tool from its set pose by the displacement `by`, given in the tool's frame.
    /// `order` makes the behaviour for the target.
    async fn relative(
        &mut self,
        hand: Hand,
        by: Pose,
        order: impl Fn(&Self, Pose) -> Behaviour,
        doing: Doing,
    ) -> Result<(), Failure> {
        let line = order(self, self.arms[hand.index()].desired_base_from_tool * by);
        self.execute(alone(hand, line), Until::Effector(hand.index()), doing).await
    }

    /// Moves a hand along its tool's own z by `distance` (m), slowly, since the operator's hand may
    /// be there.
    pub(super) async fn along_gently(&mut self, hand: Hand, distance: f64) -> Result<(), Failure> {
        let by = Pose::translation(0.0, 0.0, distance);
        self.relative(hand, by, Self::gentle_line, Doing::Travelling).await
    }

    /// Moves a hand along its tool's own z by `distance` (m).
    pub(super) async fn along(&mut self, hand: Hand, distance: f64) -> Result<(), Failure> {
        self.relative(hand, Pose::translation(0.0, 0.0, distance), Self::line, Doing::Travelling)
            .await
    }

    /// Moves a hand along its tool's axes by a small step (m).
    pub(super) async fn nudge(&mut self, hand: Hand, [x, y, z]: [f64; 3]) -> Result<(), Failure> {
        self.relative(hand, Pose::translation(x, y, z), Self::line, Doing::Adjusting).await
    }

    /// Rolls a hand about its tool's own z by `angle` (rad).
    pub(super) async fn roll(&mut self, hand: Hand, angle: f64) -> Result<(), Failure> {
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let by = Pose::from_parts(nalgebra::Translation3::identity(), roll);
        self.relative(hand, by, Self::line, Doing::Adjusting).await
    }

    /// Moves a hand to the place from which its guarded approach to the partner's cube begins.
    pub(super) async fn pre_grasp(&mut self, hand: Hand, grip: Grip) -> Result<(), Failure> {
        let seat = self.grasp_pose(hand, grip)?;
        let short = self.short_of_cube(hand, grip);
        let line = self.line(seat * Pose::translation(0.0, 0.0, -short));
        let until = Until::Effector(hand.index());
        self.execute(alone(hand, line), until, Doing::Adjusting).await
    }

    /// Returns the distance before the cube at which a guarded approach begins (m). The cube may be
    /// nearer than believed, by the filter's uncertainty and by the error of the last grasps. It
    /// may also be so far aside that a finger would meet its face.
    fn short_of_cube(&self, hand: Hand, grip: Grip) -> f64 {
        let s = &self.settings;
        let doubt = self.belief.doubt(hand, grip.hold, grip.half_roll, &self.arms);
        let most = |deviation: f64| DEVIATIONS * deviation.hypot(UNMODELLED);
        // The last errors alone are not enough: the filter was uncertain by 2 mm before an error of
        // 4.6 mm, and a line of 450 mm/s hit the cube with 20 N.
        let off = doubt.map_or(UNSURE, |deviation| most(deviation.z));
        let short = (off.max(self.miss) + STOP_MARGIN).clamp(s.pre_grasp, s.pre_grasp.max(UNSURE));
        let room = 0.5 * (self.arms[hand.index()].jaw_opening - s.edge);
        if doubt.is_some_and(|deviation| most(deviation.y) < room) {
            short
        } else {
            // The fingers stop before the face.
            short + s.finger_depth[usize::from(grip.hold.depth == Depth::Two)]
        }
    }

    /// Returns the `base_from_tool` at which a hand would have the partner's cube in a grip.
    fn grasp_pose(&self, hand: Hand, grip: Grip) -> Result<Pose, Failure> {
        let pose = self.belief.grasp_pose(hand, grip.hold, grip.half_roll, &self.arms);
        Ok(pose.ok_or("the partner does not hold the cube")?)
    }

    /// Moves an open hand onto the partner's cube, until the palm touches it.
    pub(super) async fn approach(&mut self, hand: Hand, grip: Grip) -> Result<(), Failure> {
        let s = &self.settings;
        let order = if s.compliance == ComplianceChoice::None {
            // Position control does not detect a contact: the slow line ends at the believed pose.
            Behaviour::Line { target: self.grasp_pose(hand, grip)?, speed: 0.2 * s.speed }
        } else {
            Behaviour::Approach {
                speed: s.approach_speed,
                // An approach without contact 15 mm beyond the believed place has missed the cube.
                distance: self.short_of_cube(hand, grip) + 0.015,
                force: s.touch,
                selector: [false; 6],
            }
        };
        let outcomes = self.behave_alone(hand, order, Doing::Approaching).await?;
        if let Some(met) = alarm(&outcomes, Doing::Approaching) {
            return Err(Failure::NotGrasped { hand, why: met.why, empty: false });
        }
        match outcomes[hand.index()].clone() {
            Some(Outcome::Touched(_) | Outcome::Reached) => Ok(()),
            other => {
                let (name, found) = (hand.name(), Outcome::words(other));
                let why = format!(
                    "the {name} hand did not find the cube where the partner holds it: {found}"
                );
                Err(Failure::NotGrasped { hand, why, empty: false })
            }
        }
    }

    /// Makes an order for jaws that close on a cube.
    pub(super) fn jaws_close(&self, stops: Depth) -> Behaviour {
        let s = &self.settings;
        Behaviour::Grasp {
            force: s.grip,
            least_width: LEAST_WIDTH * s.edge,
            selector: s.grasp_selector(),
            stops,
        }
    }

    /// Closes the jaws of a hand on the cube, and stores their distance. `closing` says whether the
    /// layer between them may be misaligned.
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
            return Err(Failure::NotGrasped { hand, why: met.why, empty: false });
        }
        match outcomes[hand.index()].clone() {
            // The jaws hold a cube. A misaligned layer reads too wide, so the smaller width counts.
            Some(Outcome::Grasped(width)) if width > LEAST_WIDTH * self.settings.edge => {
                self.log.grasps += 1;
                let known = self.widths[hand.index()].filter(|_| closing == Closing::OnLayer);
                self.widths[hand.index()] = Some(known.map_or(width, |known| known.min(width)));
                Ok(())
            }
            // The other run ended while it opened these jaws: they passed the width of a cube, and
            // the person has the cube.
            Some(Outcome::Empty(_))
                if hand == Hand::Track && self.maybe_offered.is_some_and(|cube| cube.opening) =>
            {
                Err(Failure::WithOperator("the jaws closed without a cube".to_owned()))
            }
            other => {
                let empty = matches!(other, Some(Outcome::Empty(_)));
                let (name, found) = (hand.name(), Outcome::words(other));
                let why = format!("the {name} hand's jaws do not hold the cube: {found}");
                Err(Failure::NotGrasped { hand, why, empty })
            }
        }
    }

    /// Presses the cube into the palm and against the partner's palm, and corrects the belief by
    /// the position of the contact.
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
            return Err(Failure::NotGrasped { hand, why: met.why, empty: false });
        }
        let miss = self.belief.secured(hand, hold, half_roll, &self.arms);
        // One good grasp does not prove the next: a larger error fades over several grasps.
        self.miss = miss.z.abs().max(0.5 * self.miss);
        if miss.norm() > 0.004 {
            let (name, mm) = (hand.name(), miss.norm() * 1e3);
            self.note(format!(
                "the {name} hand found the cube {mm:.1} mm from where it was expected"
            ));
        }
        Ok(())
    }

    /// Opens the jaws of a hand, with the palm's stops at `stops`. An overload interrupts the
    /// opening, except while the cube is given back.
    pub(super) async fn open(&mut self, hand: Hand, stops: Depth) -> Result<(), Failure> {
        self.open_to(hand, stops, self.given_back).await
    }

    /// Opens the jaws of a hand, with retries after an overload. With `theirs` no overload
    /// interrupts the opening, since the cube belongs to the person who pulls at it.
    pub(super) async fn open_to(
        &mut self,
        hand: Hand,
        stops: Depth,
        theirs: bool,
    ) -> Result<(), Failure> {
        // Opening relieves the strain, so the jaws retry after the hand has yielded for a while.
        for tries in 0.. {
            self.check_hold()?;
            let order = self.jaws_open(hand, stops, theirs);
            self.stops[hand.index()] = stops;
            let outcomes = self.behave_alone(hand, order, Doing::OpeningJaws).await?;
            let Some(met) = alarm(&outcomes, Doing::OpeningJaws) else { break };
            if tries >= MOST_STRAINED {
                return Err(Failure::Final(met.why));
            }
            self.note(format!("{overload}: the jaws open again", overload = met.why));
            self.wait(hand, STRAINED_SECONDS).await?;
        }
        Ok(())
    }

    /// Returns whether the jaws of a hand are open enough beside the partner's cube, and the palm's
    /// stops are at `stops`.
    pub(super) fn is_open(&self, hand: Hand, stops: Depth) -> bool {
        let (i, s) = (hand.index(), &self.settings);
        self.stops[i] == stops && self.arms[i].jaw_opening > s.regrasp_opening - OPEN_ENOUGH
    }

    /// Makes an order for jaws that open, with the palm's stops at `stops`: to the narrow opening
    /// beside the partner's cube, else to the wide one. With `theirs` a person holds the cube.
    fn jaws_open(&self, hand: Hand, stops: Depth, theirs: bool) -> Behaviour {
        // While the partner or the operator holds the cube as well, a strain between the hands
        // moves the compliant arm before it moves the pads. A doubted sensor may steer no arm.
        let partner_holds = self.belief.held[hand.other().index()].is_some();
        let chained = partner_holds && !self.apart;
        let yields = (chained || theirs) && self.trust == Trust::Believed;
        let s = &self.settings;
        // Between two hands the cube's position is known to a millimetre or two. A layer that is
        // misaligned is wider than the cube: fingers with little room hit its corners with 55 N.
        let narrow = partner_holds && self.turn_in_progress.is_none();
        let opening = if narrow { s.regrasp_opening } else { s.opening };
        Behaviour::Jaw {
            jaw: JawCommand { opening, force_limit: s.grip, stops },
            seconds: s.jaw_leave,
            selector: if yields { s.grasp_selector() } else { [false; 6] },
            // A doubted sensor may report an overload that is not there.
            strained: theirs || self.trust == Trust::Doubted,
        }
    }

    /// Makes the order that has the visual servo lead the track hand to the cube.
    pub(super) fn servo_to_cube(&self) -> Behaviour {
        let (s, visual) = (&self.settings, self.settings.visual);
        Behaviour::VisualServo(visual_servo::Order {
            world_from_base: self.belief.world_from_base(Hand::Track),
            // With one layer between the fingers the tool point ends in that layer's centre plane.
            seat: s.edge / 3.0,
            patience: self.seek_time.map_or(visual.patience, |time| time.min(visual.patience)),
            ..visual
        })
    }

    /// Pulls a little at the cube in the track hand, and returns the outcome: `Touched` means that
    /// a person holds the cube, because the resistance exceeds `share` times the force of an
    /// operator's pull.
    pub(super) async fn pull(
        &mut self,
        share: f64,
        doing: Doing,
    ) -> Result<Option<Outcome>, Failure> {
        let s = &self.settings;
        let mut selector = s.grasp_selector();
        // The pull itself is along z: a z that yields would follow the person's hand.
        selector[2] = false;
        let order = Behaviour::Withdraw {
            speed: s.approach_speed,
            distance: PULL_DISTANCE,
            force: share * s.pull,
            selector,
        };
        let [track, _] = self.behave_alone(Hand::Track, order, doing).await?;
        Ok(track)
    }

    /// Holds the cube out, waits up to [`PRESENT_SECONDS`] for a pull, and returns the outcomes.
    pub(super) async fn present(&mut self) -> Result<Outcomes, Failure> {
        self.check_hold()?;
        self.given_back = true;
        let (pull, selector) = (self.settings.pull, self.settings.grasp_selector());
        let order = Behaviour::Present { pull, selector, seconds: PRESENT_SECONDS };
        self.behave_alone(Hand::Track, order, Doing::HandingBack).await
    }

    /// Turns the layer under the turner's palm by `angle` about its z (rad), while the arm that
    /// [`CompliantArm`] names yields. The turn stalls at `torque` (Nm).
    pub(super) async fn turn(
        &mut self,
        turner: Hand,
        angle: f64,
        torque: f64,
    ) -> Result<Outcomes, Failure> {
        self.straight = self.straight.or_else(|| self.straight_now(turner));
        let s = &self.settings;
        let body = turner.other();
        let axis =
            self.belief.turn_axis(turner).ok_or("one of the hands in a turn holds no cube")?;
        let (turner_selector, body_selector) = match s.compliant_arm {
            CompliantArm::Body => ([false; 6], s.turn_selector(axis)),
            CompliantArm::Turner => (s.turn_selector(2), [false; 6]),
        };
        let most = if angle.abs() < SHORT_TURN { GENTLE } else { f64::INFINITY };
        let mut orders = alone(
            turner,
            Behaviour::Turn {
                angle,
                // The admittance is speed over torque. A lower stall torque at full speed would
                // raise it and excite the tool, so the turn is slower instead.
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

/// Returns the orders with straight and joint motions at [`RETRY_SPEED`]; the others have the
/// speeds of contacts already.
fn slowed(orders: Orders) -> Orders {
    orders.map(|order| {
        order.map(|mut behaviour| {
            match &mut behaviour {
                Behaviour::Line { speed, .. } => *speed *= RETRY_SPEED,
                // The time keeps two arms in step, so it grows as their speeds fall.
                Behaviour::Joints { speed, seconds, .. } => {
                    (*speed, *seconds) = (*speed * RETRY_SPEED, *seconds / RETRY_SPEED);
                }
                _ => {}
            }
            behaviour
        })
    })
}

#[cfg(test)]
mod tests {
    use super::super::testing::{EMPTY, Stage, goes_well, order, settings, taken, track, words};
    use super::super::{give_back, regrasp};
    use super::*;
    use crate::cube::{Axis, Face, Keeper};
    use crate::kernel::{Action, Event};
    use crate::motion::ArmState;
    use crate::reach::{Meeting, WayFinder};
    use crate::tasks::cube::settings::CubeSettings;
    use crate::tasks::cube::think::{Conclusion, Thought};

    /// Plays a motion, or a procedure of motions, with the cube in the track hand. Returns the word
    /// of each action, and whether a journal entry was published before the action. No person takes
    /// the cube that is held out, and a test pull finds a holder.
    fn journaled(
        keeper: Keeper,
        motion: impl AsyncFnOnce(&mut Robot) -> Result<(), Failure>,
    ) -> Vec<(&'static str, bool)> {
        let mut stage = Stage::holding(CubeSettings { keeper, ..settings() });
        stage.robot.hand_over = Some(JointPositions([0.3; 7]));
        let port = stage.port.clone();
        let mut journaled = Vec::new();
        let (end, _) = stage.play(motion, &mut |action, arms| {
            let word = words(std::slice::from_ref(action))[0];
            journaled.push((word, port.state(|shared| shared.entry.is_some())));
            match order(action) {
                Some(Behaviour::Present { pull, .. }) if pull.is_finite() => {
                    track(Outcome::TimedOut(20.0))
                }
                Some(Behaviour::Withdraw { .. }) => track(Outcome::Touched(0.003)),
                _ => goes_well(action, arms),
            }
        });
        assert!(end.is_ok(), "{end:?}");
        journaled
    }

    /// Checks whether a single motion has a journal entry.
    macro_rules! assert_entry {
        ($word:literal, $has_entry:literal, $robot:ident, $motion:expr) => {
            let motion = async |$robot: &mut Robot| $motion.await.map(drop);
            assert_eq!(journaled(Keeper::Person, motion), [($word, $has_entry)]);
        };
    }

    #[test]
    fn motion_is_journaled_before_it_begins() {
        let hand = Hand::Postument;
        assert_entry!("line", true, robot, robot.along(Hand::Track, -0.05));
        assert_entry!("joints", true, robot, robot.joints([None, Some(JointPositions([0.1; 7]))]));
        assert_entry!("joints", true, robot, {
            robot.apart = false;
            robot.move_apart()
        });
        assert_entry!("close", true, robot, robot.close(hand, taken(), Closing::Straight));
        assert_entry!("open", true, robot, robot.open(hand, Depth::One));
        assert_entry!("turn", true, robot, {
            robot.hold(hand);
            robot.turn(Hand::Track, 1.0, 2.0)
        });
        assert_entry!("present", true, robot, robot.present());
    }

    /// A journal entry costs a write to the disk, so small and repeated motions have none.
    #[test]
    fn small_motion_is_not_journaled() {
        assert_entry!("line", false, robot, robot.nudge(Hand::Track, [0.001, 0.0, 0.0]));
        assert_entry!("line", false, robot, robot.roll(Hand::Track, 0.1));
        assert_entry!("yield", false, robot, robot.wait(Hand::Track, 1.0));
    }

    #[test]
    fn hand_back_is_journaled_at_each_motion() {
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
        assert_eq!(journaled(Keeper::Person, solved), handed_back);

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
        assert_eq!(journaled(Keeper::Table, solved), laid_down);
    }

    /// Grip in which the postument takes the cube from the track.
    const ACROSS: Grip =
        Grip { hold: Hold { palm: Face::U, jaws: Axis::X, depth: Depth::One }, half_roll: false };

    /// Returns the distance before the cube at which the next guarded approach of the postument
    /// begins (m), and checks that the hand is sent to that place before.
    fn approach_begins(stage: &mut Stage) -> f64 {
        let seat = stage.robot.grasp_pose(Hand::Postument, ACROSS).unwrap();
        let (mut place, mut found) = (None, None);
        let approach = async |robot: &mut Robot| {
            robot.pre_grasp(Hand::Postument, ACROSS).await?;
            robot.approach(Hand::Postument, ACROSS).await
        };
        let (end, _) = stage.play(approach, &mut |action, arms| {
            match order(action) {
                Some(Behaviour::Line { target, .. }) => place = Some(*target),
                // The approach goes on for 15 mm beyond the believed place.
                Some(Behaviour::Approach { distance, .. }) => found = Some(distance - 0.015),
                other => panic!("{other:?}"),
            }
            goes_well(action, arms)
        });
        assert!(end.is_ok(), "{end:?}");
        let short = found.unwrap();
        let off = (seat.inverse() * place.unwrap()).translation.vector;
        assert!((off + short * Vector3::z()).norm() < 1e-12, "{off} {short}");
        short
    }

    #[test]
    fn displaced_cube_lengthens_the_next_guarded_approach() {
        let mut stage = Stage::holding(CubeSettings { pre_grasp: 0.004, ..settings() });
        // Grasps the cube where it is `off` nearer than believed along the hand's z (m), then
        // returns where the next approach begins.
        let mut after = |off: f64| {
            let robot = &mut stage.robot;
            let seat = robot.grasp_pose(Hand::Postument, ACROSS).unwrap();
            robot.arms[1].desired_base_from_tool = seat * Pose::translation(0.0, 0.0, -off);
            robot.hold(Hand::Postument);
            let secures = async |robot: &mut Robot| robot.secure(Hand::Postument, ACROSS).await;
            let (end, _) = stage.play(secures, &mut goes_well);
            assert_eq!(end, Ok(()));
            stage.robot.belief.released(Hand::Postument);
            stage.robot.arms[1].jaw_opening = settings().opening;
            approach_begins(&mut stage)
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        // A margin of 2.5 mm is added to the error of the last grasp, of which a good grasp leaves
        // a half.
        near(after(0.009), 0.009 + 0.0025);
        near(after(0.0), 0.0045 + 0.0025);
        near(after(-0.008), 0.008 + 0.0025);
    }

    /// In narrow jaws a cube that is a little aside is in the way of a finger.
    #[test]
    fn approach_with_little_room_begins_before_face() {
        let begins = |opening: f64| {
            let mut stage = Stage::holding(settings());
            stage.robot.arms[1].jaw_opening = opening;
            approach_begins(&mut stage)
        };
        let edge = settings().edge;
        let farther = begins(edge + 0.01) - begins(edge + 0.04);
        assert!((farther - settings().finger_depth[0]).abs() < 1e-12, "{farther} m");
    }

    #[test]
    fn guarded_approach_begins_within_its_limits() {
        let begins = |miss: f64, pre_grasp: f64| {
            let mut stage = Stage::holding(CubeSettings { pre_grasp, ..settings() });
            stage.robot.miss = miss;
            approach_begins(&mut stage)
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        let doubted = begins(0.0, 0.004);
        assert!(doubted > 0.006 && doubted < UNSURE, "{doubted} m by the filter's estimate");
        near(begins(0.009, 0.004), 0.009 + 0.0025);
        near(begins(UNSURE, 0.004), UNSURE);
        near(begins(0.0, UNSURE), UNSURE);
        near(begins(0.0, 0.03), 0.03);
    }

    /// Brings the hands to a grasp along a known path, whose motion in legs ends with the event
    /// `legs`. Returns the words of the orders, and the result.
    fn meets(legs: Event<Conclusion>) -> (Vec<&'static str>, Result<(), Failure>) {
        let way =
            MeetingPath { separation: 0.1, stroke: 0.3, across: 0.1, ramp: 0.1, seconds: 2.0 };
        let mut settings = settings();
        // Between all 30 meetings, for each of the two newcomers.
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
            let goes_across = matches!(sent[0], Some(Behaviour::Legs { .. }));
            orders.push(match sent[0] {
                _ if goes_across => "legs",
                Some(Behaviour::Present { .. }) => "yields",
                _ => "joints",
            });
            match legs.take_if(|_| goes_across) {
                Some(event) => event,
                None => goes_well(action, arms),
            }
        });
        (orders, end)
    }

    /// Conditions of a path between a meeting and a place apart.
    #[derive(Clone)]
    struct Conditions {
        /// Finder of the least separation of the arms.
        ways: Option<WayFinder>,
        /// Whether MP refuses the first try.
        refused: bool,
        /// Whether the track has lost the cube at the end of the path.
        lost: bool,
    }

    /// Moves both arms from the joint positions `begin` to a meeting at `end`, or, without `meets`,
    /// the track alone to its joint positions of `end`. The track hand has the cube, and the arms
    /// reach every target. Returns the stage, the result, and the targets of the track.
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
            // MP refuses only the motion on the path, not the track's motion at the meeting.
            if (orders[1].is_some() || !meets && target == track) && std::mem::take(&mut refused) {
                return Event::Trouble("too near".to_owned());
            }
            arms[0].desired_joints = target;
            sent.push(target);
            arms[0].jaw_opening = if lost { EMPTY } else { 0.0567 };
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
    fn track_arm_retracts_by_shortest_free_distance() {
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

    /// Arms that are near must retract before they move sideways, also after they lost the cube.
    #[test]
    fn arms_stay_marked_near_after_losing_cube() {
        let apart = WayFinder::example_start();
        let lost = Conditions { ways: Some(WayFinder::of_example()), refused: false, lost: true };

        let (stage, end, _) = goes(apart, apart, true, lost);

        assert_eq!(end, Err(Failure::Lost(Hand::Track)));
        assert!(!stage.robot.apart, "the arms are not apart");
    }

    /// A refused or blocked path is replaced by three motions: apart, across, together.
    #[test]
    fn refused_path_is_split_into_three_motions() {
        let in_turn = ["joints"; 3];
        let (orders, end) = meets(Event::Behaved(vec![Some(Outcome::Reached); 2]));
        assert!(end.is_ok() && orders == ["legs"], "{orders:?}");

        let (orders, end) = meets(Event::Trouble("too near".to_owned()));
        assert!(end.is_ok() && orders == [&["legs"][..], &in_turn].concat(), "{orders:?}");

        let met = Event::Behaved(vec![Some(Outcome::OverForce(2, 31.0)), Some(Outcome::Ended)]);
        let (orders, end) = meets(met);
        let way = [&["legs", "yields"][..], &in_turn].concat();
        assert!(end.is_ok() && orders == way, "{orders:?}");
    }

    /// A hand that another one was pushed into met it three times with full speed.
    #[test]
    fn retry_after_contact_moves_both_arms_more_slowly() {
        let mut stage = Stage::holding(settings());
        let (near, far) = (JointPositions([0.1; 7]), JointPositions([0.4; 7]));
        let orders = stage.robot.joint_orders([Some(near), Some(far)]);
        let mut motions = Vec::new();

        let (end, _) = stage.play(
            async |robot| robot.execute(orders, Until::All, Doing::Travelling).await,
            &mut |action, _| {
                let Action::Behave { orders, .. } = action else { return Event::Done };
                let Some(Behaviour::Joints { speed, seconds, .. }) = orders[1] else {
                    return Event::Behaved(vec![Some(Outcome::Ended); 2]);
                };
                motions.push((speed, seconds, orders[0].is_some()));
                let met = motions.len() == 1;
                let other = if met { Outcome::OverForce(2, 30.0) } else { Outcome::Reached };
                Event::Behaved(vec![Some(Outcome::Reached), Some(other)])
            },
        );

        assert_eq!(end, Ok(()));
        let [first, again] = motions[..] else { panic!("{motions:?}") };
        assert!(first.2 && again.2, "both arms move again: {motions:?}");
        assert!((again.0 / first.0 - 0.3).abs() < 1e-9, "{motions:?}");
        assert!((first.1 / again.1 - 0.3).abs() < 1e-9, "{motions:?}");
    }
}
