//! What is done when the cube may be otherwise than the mission believes: look, and begin anew with what is seen.
//!
//! - before the cube is handed back, the three sides that the free hand can see are compared with what the turns
//!   should have made of them: any single layer that stands otherwise shows on one of these sides
//! - what could not be looked at is not called done: it is looked at once more, then whoever is there is asked, and else
//!   the cube goes back with the reason
//! - after a turn that slipped or jammed, and whose layer has been brought back into line (see [`super::unwind`]), all
//!   six faces are read anew and planned anew, whatever has become of them
//! - so little is believed that a mission which was broken off anywhere goes on in the same way: see [`Mission::resumed`]

use super::unwind::Begun;
use super::{Job, Mission, RELEASE_WAIT, name};
use crate::cube::{Axis, Face, Keeper, rotations};
use crate::motion::{ArmState, Depth, JointPositions};
use crate::tasks::Entry;
use crate::tasks::cube::hold::{Grip, Hand, Hold, Step};
use crate::vision::sensor::FaceReading;
use nalgebra::{UnitQuaternion, Vector3};

/// How often a mission begins anew before it gives up.
pub(super) const MOST_RECOVERIES: u32 = 3;
/// Looks at one side before it goes uninspected.
const CHECK_TRIES: u32 = 3;
/// Inspections before somebody is asked, or the cube goes back as it is.
const INSPECTIONS: u32 = 2;
/// Time between them: what shuts an eye may pass [s].
const LATER: f64 = 5.0;
/// Stickers of a row at the rim of a side that must be seen: a turn changes all three.
const ROW_SEEN: usize = 2;
/// The rows at the rim of a side, in reading order.
const ROWS: [[usize; 3]; 4] = [[0, 1, 2], [6, 7, 8], [0, 3, 6], [2, 5, 8]];
/// A sticker looks otherwise when another colour is nearer than this share of the way to its own.
const CLEARLY: f64 = 0.6;
/// Stickers that must look otherwise: every turn of a layer changes three on a side, a reflection changes one.
const ODD_STICKERS: usize = 2;
/// Jaws nearer than this share of the edge hold no cube: less than [`super::LEAST_WIDTH`], more than closed jaws.
const GONE: f64 = 0.945;
/// Jaws that have come so much nearer since they closed hold it no more [m]: pads of rubber give by a fifth of it.
const CLOSER: f64 = 0.0012;
/// Jaws wider than the cube by this hold none [m]: of one that was taken a layer may stand askew.
const WIDER: f64 = super::MORE;
/// A layer that stands off by less is straightened by the jaws that close over it [rad].
const STRAIGHT: f64 = 0.1;
/// A way that is not worth a motion [m].
const NEARLY: f64 = 1e-3;

/// For so long a cube is left to whoever takes it back, and then looked for [s].
const TAKEN_BACK: f64 = 3.0;
const SEEKS: f64 = 5.0;
/// What is known of a cube that was not seen then.
pub(super) const UNSEEN: &str = "by the other run's journal the cube was being handed back, no hand of the robot holds it, and nobody has \
     held it out since: the operator has it";

/// Colours as this cube's stickers look, by face [0..=255 each].
pub(super) type Palette = [[f64; 3]; 6];

/// How a sticker of a colour looks that was never seen on this cube, since the operator has given it.
const USUAL: Palette = [
    [225.0, 225.0, 220.0],
    [180.0, 30.0, 35.0],
    [20.0, 150.0, 60.0],
    [220.0, 210.0, 40.0],
    [230.0, 110.0, 30.0],
    [20.0, 60.0, 160.0],
];

/// The mean of what was seen of each colour.
pub(super) fn palette(seen: &[Option<[f64; 3]>; 54], colours: &[u8; 54]) -> Palette {
    let (mut sums, mut counts) = ([[0.0; 3]; 6], [0_u32; 6]);
    for (rgb, &colour) in seen.iter().zip(colours) {
        let Some(rgb) = rgb else { continue };
        let colour = usize::from(colour);
        for (sum, value) in sums[colour].iter_mut().zip(rgb) {
            *sum += value;
        }
        counts[colour] += 1;
    }
    std::array::from_fn(|c| match counts[c] {
        0 => USUAL[c],
        count => sums[c].map(|sum| sum / f64::from(count)),
    })
}

/// Why a reading does not tell how each layer stands, if it does not: too much is covered.
fn hides(reading: &FaceReading) -> Option<String> {
    let seen = |row: &[usize; 3]| row.iter().filter(|&&i| !reading.occluded[i]).count();
    if ROWS.iter().all(|row| seen(row) >= ROW_SEEN) {
        return None;
    }
    let covered = (0..9).filter(|&i| reading.occluded[i]);
    let covered: Vec<String> = covered.map(|i| (i + 1).to_string()).collect();
    Some(format!("stickers {} are covered", covered.join(", ")))
}

/// The stickers of a face, 1..=9, that clearly have another colour than they should. The centre, which no turn moves,
/// tells how bright the face is.
fn otherwise(reading: &FaceReading, expected: &[u8; 9], palette: &Palette) -> Vec<usize> {
    let norm = |rgb: &[f64; 3]| Vector3::from(*rgb).norm();
    let centre = norm(&palette[usize::from(expected[4])]);
    let gain = norm(&reading.rgb[4]) / centre.max(1.0);
    let far = |i: usize, colour: usize| {
        (Vector3::from(reading.rgb[i]) - gain * Vector3::from(palette[colour])).norm()
    };
    let odd = |&i: &usize| {
        let own = usize::from(expected[i]);
        let other = (0..6).filter(|&c| c != own).map(|c| far(i, c)).fold(f64::INFINITY, f64::min);
        !reading.occluded[i] && other < CLEARLY * far(i, own)
    };
    (0..9).filter(odd).map(|i| i + 1).collect()
}

impl Mission {
    /// A mission that goes on where another was broken off, at whatever moment: the arms are asked what they hold, and
    /// the cameras what has become of the cube. `last` is what the other one noted last, if anything.
    #[must_use]
    pub fn resumed(mut self, last: Option<Entry>) -> Self {
        self.resume = Some(
            last.unwrap_or_else(|| Entry { doing: "nothing yet".to_owned(), ..Entry::default() }),
        );
        self.untouched = false;
        self
    }

    /// Whether there is a plan that can be made anew.
    pub(super) fn may_recover(&self) -> bool {
        self.goal == super::Goal::Solve && self.recoveries < MOST_RECOVERIES
    }

    /// All six faces are read and planned anew from the hand that holds the cube.
    pub(super) fn anew(&mut self) {
        self.forget_cube();
        self.queue.extend([Job::Phase("identify again"), Job::Looks]);
    }

    /// Nothing of what was read and planned holds any more.
    fn forget_cube(&mut self) {
        self.recoveries += 1;
        self.log.recoveries += 1;
        self.sight = super::sight::Sight::default();
        (self.given, self.given_back) = (None, false);
        self.offered = None;
        self.rounds = 1;
        // What goes back unsolved may yet be solved.
        self.failure = None;
        self.odd.clear();
        (self.stood_still, self.uninspected, self.inspections) = (None, None, 0);
        (self.turning, self.straight, self.begun) = (None, None, None);
        self.shown.net = crate::operator::Net::default();
        self.queue.clear();
    }

    /// The cube has fallen: the hand goes where it took the cube from the operator, who may hold it out once more.
    fn dropped(&mut self, hand: Hand, hand_over: JointPositions) {
        self.forget_cube();
        (self.hand_over, self.taken_at, self.short) = (None, None, 0.0);
        let (opening, speed) = (self.settings.opening, self.settings.speed);
        self.queue.extend([
            Job::Phase("wait for the cube"),
            Job::Open { hand, opening, stops: Depth::One },
            Job::Apart,
            Job::Joints([Some(hand_over), None], speed),
        ]);
        self.take();
    }

    /// Looks at the sides that the free hand sees without another grasp, if it is known how they should look.
    pub(super) fn unfold_inspect(&mut self) -> Result<(), String> {
        self.odd.clear();
        let holder = self.holder()?;
        let viewer = holder.other();
        let held = self.belief.held[holder.index()].ok_or("nobody holds the cube")?;
        let rotation = held.hold.cube_from_tool(held.half_roll, self.settings.edge).rotation;
        let mut jobs = vec![Job::Phase("inspect")];
        let sides = [Vector3::z(), Vector3::x(), -Vector3::x()];
        let views = self.settings.meetings.views[holder.index()];
        // A layer beside the palm's axis shows on the side before it, one across it on either of the others.
        let enough = views[0].is_some() && (views[1].is_some() || views[2].is_some());
        let none =
            || "the cube could not be inspected: the cell has no pose for the looks".to_owned();
        self.uninspected = (!enough).then(none);
        for (side, meeting) in sides.iter().zip(views) {
            let normal = rotation * side;
            let face = Face::ALL.into_iter().find(|f| f.normal().dot(&normal) > 0.9);
            if let (Some(face), Some(meeting)) = (face, meeting) {
                jobs.push(Job::Meet { newcomer: viewer, meeting, back: false });
                jobs.push(Job::Check { viewer, face, tries: 1 });
            }
        }
        jobs.push(Job::Reconcile);
        if self.plan_goes_on() {
            jobs.push(Job::Phase("solve"));
        }
        self.push_front(&jobs);
        Ok(())
    }

    /// Whether the plan has turns left.
    fn plan_goes_on(&self) -> bool {
        self.queue.iter().any(|job| matches!(job, Job::Step(Step::Turn { .. })))
    }

    /// After a turn that felt odd: where this step begins with a hand that lets go, the other one holds the cube alone, and
    /// it is inspected before the step goes on. Without another turn the plan ends with an inspection anyhow.
    pub(super) fn inspects_at(&mut self, step: Step) -> bool {
        let hand = match step {
            Step::Leave { hand } | Step::Grasp { hand, .. } | Step::Look { viewer: hand, .. } => {
                hand
            }
            Step::Turn { .. } => return false,
        };
        if self.belief.held.iter().any(Option::is_none) || !self.plan_goes_on() {
            return false;
        }
        let Some(turn) = self.stood_still.take() else { return false };
        self.log.notes.push(format!("turn {turn} stood still in between: the cube is inspected"));
        self.push_front(&[Job::LetGo(hand), Job::Inspect]);
        if let Step::Leave { .. } = step {
            self.shown.step = self.shown.step.map(|step| step + 1);
        } else {
            self.queue.insert(2, Job::Step(step));
        }
        true
    }

    /// A side was looked at, or not.
    pub(super) fn checked(
        &mut self,
        viewer: Hand,
        face: Face,
        tries: u32,
        reading: Result<FaceReading, String>,
        arms: &[ArmState],
    ) {
        let known = self.palette.zip(self.shown.facelets).ok_or("nothing is known of the cube");
        let reading = reading.and_then(|reading| match (hides(&reading), known) {
            (None, Ok(known)) => Ok((reading, known)),
            (Some(why), _) => Err(why),
            (None, Err(why)) => Err(why.to_owned()),
        });
        match reading {
            Ok((reading, (palette, facelets))) => {
                self.belief.seen(viewer, face, &reading.camera_from_face, arms);
                let expected = std::array::from_fn(|i| facelets.colours()[face as usize * 9 + i]);
                let odd = otherwise(&reading, &expected, &palette);
                self.odd.extend(odd.into_iter().map(|i| (face, i)));
            }
            Err(reason) if tries < CHECK_TRIES => {
                let letter = face.letter();
                let note = format!("face {letter} could not be inspected ({reason}), try {tries}");
                self.log.notes.push(note);
                self.push_front(&[
                    Job::Nudge(viewer, super::NUDGES[tries as usize - 1]),
                    Job::Check { viewer, face, tries: tries + 1 },
                ]);
            }
            Err(reason) => {
                let letter = face.letter();
                let why = format!("face {letter} could not be inspected: {reason}");
                self.uninspected.get_or_insert(why);
            }
        }
    }

    /// Belief and sight are brought together.
    pub(super) fn reconcile(&mut self) -> Result<(), String> {
        let (odd, unseen) = (std::mem::take(&mut self.odd), self.uninspected.take());
        if odd.len() < ODD_STICKERS {
            return unseen.map_or(Ok(()), |why| self.not_inspected(why));
        }
        let names: Vec<String> =
            odd.iter().map(|(face, i)| format!("{}{i}", face.letter())).collect();
        let reason =
            format!("stickers {} are not as the turns should have left them", names.join(", "));
        if !self.may_recover() {
            return self.give_back(reason);
        }
        self.log.notes.push(format!("{reason}: the cube is read anew"));
        self.anew();
        Ok(())
    }

    /// Nobody knows how the cube looks: what hides it may pass, or somebody may see to it.
    fn not_inspected(&mut self, why: String) -> Result<(), String> {
        if self.plan_goes_on() {
            self.log.notes.push(format!("{why}: it is, before the cube goes back"));
            return Ok(());
        }
        self.inspections += 1;
        if self.inspections < INSPECTIONS {
            self.log.notes.push(format!("{why}: the cube is inspected once more"));
            self.push_front(&[Job::Stand(LATER), Job::Inspect]);
            return Ok(());
        }
        self.inspections = 0;
        self.ask_for_inspection(why)
    }

    /// A hand did not get hold of the cube: the partner, who has it, begins anew.
    pub(super) fn not_grasped(&mut self, hand: Hand, why: &str) -> Result<(), String> {
        if self.unwinds() {
            self.log.notes.push(why.to_owned());
            self.try_again();
            self.queue.push_front(Job::LetGo(hand));
            return Ok(());
        }
        if self.belief.held[hand.other().index()].is_none() {
            return Err(why.to_owned());
        }
        if !self.may_recover() {
            return self.returned_by_partner(hand, why);
        }
        self.log.notes.push(format!("{why}: the cube is read anew"));
        self.queue.clear();
        self.queue.extend([Job::LetGo(hand), Job::Anew]);
        Ok(())
    }

    /// The cube has been read anew too often, and this hand has none of it: its partner gives it back as it is. What fails on
    /// that way is the end.
    fn returned_by_partner(&mut self, hand: Hand, why: &str) -> Result<(), String> {
        if self.goal != super::Goal::Solve || self.failure.is_some() {
            return Err(why.to_owned());
        }
        self.failure = Some(why.to_owned());
        self.queue.clear();
        self.queue.extend([Job::LetGo(hand), Job::GiveUp]);
        Ok(())
    }

    /// Whether a hand has lost what it held: its jaws have closed farther than on a cube.
    pub(super) fn look_after(&mut self, arms: &[ArmState]) -> Result<(), String> {
        for hand in [Hand::Track, Hand::Postument] {
            let gap = arms[hand.index()].jaw_opening;
            let closed = self.widths[hand.index()].is_some_and(|width| gap < width - CLOSER);
            if self.belief.held[hand.index()].is_none() || !closed {
                continue;
            }
            let lost = format!("the cube has slipped out of the {} hand", name(hand));
            if hand == Hand::Track && self.offered.is_some() {
                self.left_to_whoever_has_it(&lost);
                return Ok(());
            }
            if self.belief.held[hand.other().index()].is_some() && self.lost_layer(hand, arms) {
                self.belief.released(hand);
                self.log.notes.push(format!("{lost}: the layer is taken anew"));
                continue;
            }
            self.belief.released(hand);
            if self.belief.held[hand.other().index()].is_none() {
                self.log.drops += 1;
                let tool = self.belief.world_from_base(hand) * arms[hand.index()].base_from_tool;
                let [x, y, _] = tool.translation.vector.map(|place| place * 1e3).into();
                self.fell = Some(format!(
                    "it fell from the {} hand and lies below where that was, at x {x:.0} mm, y {y:.0} mm of the world",
                    name(hand)
                ));
                let Some(hand_over) = self.hand_over.filter(|_| self.may_recover()) else {
                    return Err(lost);
                };
                let next = match self.settings.keeper {
                    Keeper::Person => "pick it up and hold it out again, please",
                    Keeper::Table => "it is looked for on the table",
                };
                self.log.notes.push(format!("{lost} and lies below it: {next}"));
                self.dropped(hand, hand_over);
                return Ok(());
            }
            if !self.may_recover() {
                return self.returned_by_partner(hand, &lost);
            }
            self.log.notes.push(format!("{lost}: the cube is read anew"));
            self.queue.clear();
            self.queue.extend([Job::LetGo(hand), Job::Anew]);
        }
        Ok(())
    }

    /// The first jobs of a mission that goes on: who holds the cube, is a layer askew?
    pub(super) fn survey(&mut self, last: &Entry, arms: &[ArmState]) {
        let edge = self.settings.edge;
        let between = |hand: Hand| {
            let gap = arms[hand.index()].jaw_opening;
            gap > GONE * edge && gap < edge + WIDER
        };
        (self.hand_over, self.taken_at) = (last.hand_over, last.taken_at);
        self.short = last.short;
        self.stops = [Hand::Track, Hand::Postument].map(|hand| depth(Some(last), hand));
        let places = self.settings.meetings.grasps.iter().flatten().map(|m| m.track_back.0[0]);
        let least = places.fold(f64::INFINITY, f64::min) - self.settings.meetings.separation;
        self.apart = arms[0].desired_joints.0[0] < least + 0.5 * self.settings.meetings.separation;
        self.least_track = Some(least);
        let usual =
            |hand: Hand| Hold { palm: Face::D, jaws: Axis::Y, depth: depth(Some(last), hand) };
        self.log.notes.push(format!("the other run was broken off while {}", last.doing));
        self.queue.push_back(Job::Phase("take stock"));
        match [Hand::Track, Hand::Postument].map(between) {
            [false, false] if last.over || last.handing_back => {
                self.given_back = true;
                self.failure.clone_from(&last.undone);
                if !last.over {
                    self.back_off(arms);
                }
                if !last.over && self.settings.keeper == Keeper::Person {
                    self.seek();
                } else {
                    let achieved = self.failure.is_none();
                    self.queue.push_back(Job::Finish { achieved });
                }
            }
            [false, false] => {
                self.log.notes.push("no hand holds the cube: it is taken anew".to_owned());
                (self.hand_over, self.taken_at, self.short) = (None, None, 0.0);
                self.back_off(arms);
                self.queue.push_back(Job::Apart);
                self.take();
            }
            [true, true] => {
                self.log.notes.push("both hands hold the cube".to_owned());
                self.apart = false;
                for hand in [Hand::Track, Hand::Postument] {
                    self.queue.push_back(Job::Close { hand, hold: usual(hand) });
                }
                self.queue.push_back(Job::Untwist);
            }
            [track, _] => {
                let hand = if track { Hand::Track } else { Hand::Postument };
                self.log.notes.push(format!("the {} hand holds the cube", name(hand)));
                self.belief.taken(hand, usual(hand), false);
                // What was told of forces before this run began is of no zero that anybody knows.
                self.queue.push_back(Job::Bias([track, !track]));
                self.queue.push_back(Job::Close { hand, hold: usual(hand) });
                if track && self.settings.keeper == Keeper::Person {
                    let is_out = last.hand_over.is_some() && self.left(arms) > Some(NEARLY);
                    let gap = arms[Hand::Track.index()].jaw_opening;
                    let opening = last.handing_back && gap > edge - CLOSER;
                    self.offered = (last.handing_back || is_out).then_some(Offered { opening });
                }
                self.clear(hand.other(), arms);
                self.settle(hand, arms);
            }
        }
    }

    /// The other run was about to hand the cube back, and nobody noted that it was taken: it is looked for, and taken once
    /// more where somebody holds it out.
    fn seek(&mut self) {
        self.log.notes.push("the cube was being handed back: it is looked for".to_owned());
        self.seeks = Some(SEEKS);
        (self.hand_over, self.taken_at, self.short) = (None, None, 0.0);
        self.queue.extend([Job::Apart, Job::Stand(TAKEN_BACK)]);
        self.take();
    }

    /// Somebody has the cube that the other run was handing back, or holds it and does not let go: the jaws leave it to them.
    pub(super) fn left_to_whoever_has_it(&mut self, why: &str) {
        self.log.notes.push(format!("{why}: whoever it was handed back to has it"));
        self.given_back = true;
        self.failure = self.resume.as_ref().and_then(|last| last.undone.clone());
        self.queue.clear();
        self.queue.push_back(Job::LetGo(Hand::Track));
        self.seek();
    }

    /// What was looked for is held out again.
    pub(super) fn held_out_again(&mut self) {
        self.log.notes.push("the cube is held out again: it is taken anew".to_owned());
        (self.given_back, self.failure) = (false, None);
        self.offered = None;
    }

    /// Nobody holds out what was looked for. The jaws are empty, and nothing was seen to fall: the operator has it.
    pub(super) fn not_held_out(&mut self) {
        let achieved = self.failure.is_none();
        self.queue.clear();
        self.queue.extend([Job::Watch(false), Job::Finish { achieved }]);
    }

    /// The track hand may have its fingers beside a cube that somebody else has, and press it: it goes out of the way, as
    /// far as its arm folds, before it goes sideways or the forces are zeroed.
    fn back_off(&mut self, arms: &[ArmState]) {
        let (hand, opening) = (Hand::Track, self.settings.opening);
        let goes = self.free_way(hand, self.settings.back, arms);
        self.queue
            .extend([Job::Open { hand, opening, stops: Depth::One }, Job::Along(hand, -goes)]);
    }

    /// An empty hand opens, and goes what is left of the way back where it may have its fingers beside the cube: a limit of
    /// the arm may be near behind that.
    fn clear(&mut self, hand: Hand, arms: &[ArmState]) {
        let (edge, back) = (self.settings.edge, self.settings.back);
        let stops = self.stops[hand.index()];
        self.queue.push_back(Job::Open { hand, opening: self.settings.opening, stops });
        let Some(place) = self.belief.centre_in_tool(hand, arms) else { return };
        if place.norm() >= 3.0 * edge {
            return;
        }
        // Where it would have had one layer, the lesser way of the two.
        let gone = place.z - edge / 3.0;
        let left = (back - gone).clamp(0.0, back);
        if left < NEARLY {
            return;
        }
        let goes = self.folds(hand, left, super::CLEAR * back - gone, arms);
        self.queue.push_back(Job::Along(hand, -goes));
    }

    /// What is left of the way back from where the track took the cube: a part may have been gone already [m].
    fn left(&self, arms: &[ArmState]) -> Option<f64> {
        self.gone(arms).map(|gone| (self.way_back() - gone).max(0.0))
    }

    /// What follows when one hand is known to hold the cube: without a place to hand it back, the operator may still
    /// have hold of it.
    fn settle(&mut self, holder: Hand, arms: &[ArmState]) {
        let left = self.left(arms);
        if self.hand_over.is_none() && holder == Hand::Track {
            self.draw_back_with(left.unwrap_or(self.way_back()));
        } else if let (Some(hand_over), true) = (self.hand_over, self.offered.is_some()) {
            self.queue.extend([Job::Wait(Hand::Track, RELEASE_WAIT), Job::Release { tries: 1 }]);
            if left > Some(NEARLY) {
                self.queue.push_back(Job::Joints([Some(hand_over), None], self.settings.speed));
            }
            // It was zeroed where somebody may have had hold of it.
            self.queue.push_back(Job::Bias([true, false]));
        } else if let (Hand::Track, Keeper::Table, Some(left)) =
            (holder, self.settings.keeper, left)
        {
            // It may stand on the table, or just above: not along it, but up from there.
            if left > 0.0 {
                self.queue.push_back(Job::Along(holder, -left));
            }
        }
        self.queue.extend([Job::Phase("identify"), Job::Looks]);
    }

    /// Both hold, perhaps in the middle of a turn: how the tools stand to each other tells which layer is askew.
    pub(super) fn untwist(&mut self, arms: &[ArmState]) {
        let tool = |hand: Hand| {
            self.belief.world_from_base(hand).rotation
                * arms[hand.index()].desired_base_from_tool.rotation
        };
        let (track, postument) = (tool(Hand::Track), tool(Hand::Postument));
        let (turner, by) = askew(&track, &postument);
        let body = turner.other();
        let last = self.resume.as_ref();
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: depth(last, body) };
        let (own, other) =
            if turner == Hand::Track { (track, postument) } else { (postument, track) };
        let straight = own * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by);
        let cube_from_turner =
            hold.cube_from_tool(false, self.settings.edge).rotation * other.inverse() * straight;
        let (turned, half_roll) = Hold::from_tool_rotation(&cube_from_turner, depth(last, turner));
        self.belief.taken(body, hold, false);
        self.belief.taken(turner, turned, half_roll);
        if by.abs() > STRAIGHT {
            let degrees = by.to_degrees();
            self.log.notes.push(format!(
                "a layer stands askew: the {} hand turns it by {degrees:.0} deg",
                name(turner)
            ));
            self.begun = Some(Begun::new(
                turner,
                Grip { hold: turned, half_roll },
                arms[turner.index()].desired_joints.0[6] + by,
                by.signum(),
            ));
            self.queue.push_back(Job::Turn { turner, angle: by, tries: 1 });
        }
        self.queue.push_back(Job::LetGo(turner));
        self.settle(body, arms);
    }
}

/// How deep a hand holds, as far as it was noted.
fn depth(last: Option<&Entry>, hand: Hand) -> Depth {
    let noted = last.and_then(|last| last.held[hand.index()].or(last.stops[hand.index()]));
    noted.unwrap_or(Depth::One)
}

/// A cube that another run may have held out to a person.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Offered {
    /// Its jaws stood as they do when they begin to open, too.
    pub(super) opening: bool,
}

/// Which hand turns a layer, and by how much more about its own z the layer is straight [rad]: of the 24 ways in which
/// two straight tools stand to each other the nearest, over a roll of one of them.
fn askew(track: &UnitQuaternion<f64>, postument: &UnitQuaternion<f64>) -> (Hand, f64) {
    let mut best = (f64::INFINITY, Hand::Track, 0.0);
    for (hand, own, other) in [(Hand::Track, track, postument), (Hand::Postument, postument, track)]
    {
        for straight in rotations() {
            // own * roll = other * straight
            let off = own.inverse() * other * straight;
            let roll = 2.0 * libm::atan2(off.k, off.w);
            let roll = roll - (roll / std::f64::consts::TAU).round() * std::f64::consts::TAU;
            let rest = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -roll) * off;
            // A small roll with a small rest; the rest weighs more, since only rolls are real.
            let cost = 10.0 * rest.angle() + roll.abs();
            if cost < best.0 {
                best = (cost, hand, roll);
            }
        }
    }
    (best.1, best.2)
}

#[cfg(test)]
mod tests {
    use super::super::Goal;
    use super::super::testing::settings;
    use super::*;
    use crate::cube::{Facelets, Turn};
    use crate::generators::{Behaviour, Outcome};
    use crate::operator::Answer;
    use crate::reach::Fold;
    use crate::spatial::Pose;
    use crate::tasks::cube::settings::CubeSettings;
    use crate::tasks::cube::think::{Conclusion, Thought};
    use crate::tasks::{Action, Event, Finish, Forces, Readings, Task};

    const PALETTE: Palette = [
        [220.0, 220.0, 215.0],
        [180.0, 30.0, 35.0],
        [20.0, 150.0, 60.0],
        [220.0, 210.0, 40.0],
        [230.0, 110.0, 30.0],
        [20.0, 60.0, 160.0],
    ];

    fn reading(colours: [u8; 9], gain: f64) -> FaceReading {
        FaceReading {
            rgb: colours.map(|c| PALETTE[usize::from(c)].map(|v| gain * v + 3.0)),
            colours,
            confidences: [1.0; 9],
            camera_from_face: crate::spatial::Pose::identity(),
            residual_px: 0.1,
            confidence: 1.0,
            occluded: [false; 9],
        }
    }

    /// What another run noted that had taken the cube there, and lowered it again.
    fn lowering() -> Entry {
        Entry {
            doing: "laying it down".to_owned(),
            held: [Some(Depth::Two), None],
            hand_over: Some(JointPositions([0.3; 7])),
            taken_at: Some([0.5, 0.1, 0.7]),
            handing_back: true,
            ..Entry::default()
        }
    }

    /// The first jobs of a mission that goes on from there, with the cube in the track hand, so high above where it was
    /// taken [m].
    fn first_jobs(keeper: Keeper, last: Entry, above: f64) -> Vec<Job> {
        let settings = CubeSettings { keeper, ..settings() };
        let mut mission = Mission::new(settings, Goal::Solve, None).resumed(Some(last));
        let mut arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        arms[0].jaw_opening = 0.057;
        arms[0].desired_base_from_tool = Pose::translation(0.5, 0.1, 0.7 + above);
        let readings = Readings { arms: &arms, forces: Forces::default() };

        assert!(matches!(mission.next(Event::Start, &readings), Action::Phase("take stock")));
        mission.queue.into_iter().collect()
    }

    /// The motions along the hand's own z before the cube is looked at [m].
    fn ways(jobs: &[Job]) -> Vec<f64> {
        let looks = jobs.iter().position(|job| *job == Job::Looks).unwrap();
        let way = |job: &Job| match job {
            Job::Along(Hand::Track, way) => Some(*way),
            Job::DrawBack(way) => Some(-*way),
            _ => None,
        };
        jobs[..looks].iter().filter_map(way).collect()
    }

    #[test]
    fn a_cube_that_may_stand_on_the_table_is_lifted_before_it_is_looked_at() {
        let back = settings().back;

        for above in [0.0, 0.02] {
            let jobs = first_jobs(Keeper::Table, lowering(), above);
            let [way] = ways(&jobs)[..] else { panic!("{jobs:?}") };
            assert!((way + (back - above)).abs() < 1e-12, "{way}");
            // The arm did not fold farther than it had.
            let folded = Entry { short: 0.01, ..lowering() };
            let [way] = ways(&first_jobs(Keeper::Table, folded, above))[..] else { panic!() };
            assert!((way + (back - 0.01 - above)).abs() < 1e-12, "{way}");
            // What it holds is closed upon first, and the place of hand-over is known.
            let close = |job: &Job| matches!(job, Job::Close { hand: Hand::Track, .. });
            let lift = |job: &Job| matches!(job, Job::Along(..));
            assert!(jobs.iter().position(close) < jobs.iter().position(lift), "{jobs:?}");
            assert!(!jobs.contains(&Job::Remember), "{jobs:?}");
        }
        for above in [1.001 * back, 2.0 * back] {
            assert!(ways(&first_jobs(Keeper::Table, lowering(), above)).is_empty(), "{above}");
        }
        // No table is below a cube that a person is given back.
        assert!(ways(&first_jobs(Keeper::Person, lowering(), 0.02)).is_empty());
    }

    #[test]
    fn who_may_have_hold_of_what_is_held_out_is_asked_before_it_is_drawn_back() {
        let back = settings().back;
        let place = Job::Joints([lowering().hand_over, None], settings().speed);
        let at = |jobs: &[Job], job: &Job| jobs.iter().position(|j| j == job);
        let pull = Job::Release { tries: 1 };

        // What was noted when it was on its way out, and when it had been held out.
        for handing_back in [false, true] {
            let jobs = first_jobs(Keeper::Person, Entry { handing_back, ..lowering() }, 0.02);
            let zeroed = at(&jobs, &Job::Bias([true, false]));
            let close = jobs.iter().position(|job| matches!(job, Job::Close { .. }));
            assert!(zeroed.is_some() && zeroed < close, "{jobs:?}");
            let (asks, draws) = (at(&jobs, &pull), at(&jobs, &place));
            assert!(close < asks && asks < draws && draws.is_some(), "{jobs:?}");
            assert!(!jobs.contains(&Job::Remember), "the place is known: {jobs:?}");

            // Drawn back already, or farther.
            let far = first_jobs(Keeper::Person, Entry { handing_back, ..lowering() }, 1.5 * back);
            assert_eq!(
                (far.contains(&pull), far.contains(&place)),
                (handing_back, false),
                "{far:?}"
            );
        }
    }

    #[test]
    fn a_hand_that_had_not_drawn_back_goes_the_rest_of_the_way_and_remembers_the_place() {
        let back = settings().back;
        let taking = Entry { hand_over: None, handing_back: false, ..lowering() };
        let nowhere = Entry { taken_at: None, ..taking.clone() };

        for keeper in [Keeper::Person, Keeper::Table] {
            for (last, above, left) in
                [(&taking, 0.02, back - 0.02), (&taking, 2.0 * back, 0.0), (&nowhere, 0.02, back)]
            {
                let jobs = first_jobs(keeper, last.clone(), above);
                let [way] = ways(&jobs)[..] else { panic!("{jobs:?}") };
                assert!((way + left).abs() < 1e-12, "{way} {left}");
                assert!(jobs.contains(&Job::Remember), "{jobs:?}");
                let waits = jobs.contains(&Job::Release { tries: 1 });
                assert_eq!(waits, keeper == Keeper::Person, "{jobs:?}");
            }
        }
    }

    #[test]
    fn what_the_arm_does_not_fold_counts_where_it_holds_the_cube() {
        let (desired_joints, desired_base_from_tool) = Fold::example_stand();
        let goes = settings().folds[0].way(&desired_base_from_tool, &desired_joints, 0.3);
        let settings = || CubeSettings { back: 1.2 * goes, ..settings() };
        let track = ArmState {
            jaw_opening: 0.057,
            desired_joints,
            desired_base_from_tool,
            ..ArmState::default()
        };
        let arms = [track, ArmState { jaw_opening: 0.09, ..ArmState::default() }];
        let readings = Readings { arms: &arms, forces: Forces::default() };
        let short = |holds: bool, taken_at: Option<[f64; 3]>| {
            let mut mission = Mission::new(settings(), Goal::Solve, None);
            if holds {
                let last = Entry { taken_at, hand_over: None, handing_back: false, ..lowering() };
                mission = mission.resumed(Some(last));
                mission.next(Event::Start, &readings);
            }
            mission.unfold(Job::DrawBack(1.2 * goes), &arms).unwrap();
            mission.short
        };

        let place = super::super::place(&arms);
        // A run that was killed before it noted where it had taken the cube: it may still know that it did.
        for taken_at in [None, Some(place)] {
            assert!((short(true, taken_at) - 0.2 * goes).abs() < 1e-12, "{taken_at:?}");
        }
        assert_eq!(short(false, None), 0.0, "nothing was taken");
    }

    #[test]
    fn what_has_been_drawn_back_already_counts_where_the_arm_folds_only_a_part() {
        let (desired_joints, desired_base_from_tool) = Fold::example_stand();
        let goes = settings().folds[0].way(&desired_base_from_tool, &desired_joints, 0.3);
        let back = goes / 0.6;
        let track = ArmState {
            jaw_opening: 0.057,
            desired_joints,
            desired_base_from_tool,
            ..ArmState::default()
        };
        let arms = [track, ArmState { jaw_opening: 0.09, ..ArmState::default() }];
        let readings = Readings { arms: &arms, forces: Forces::default() };
        let drawn = |before: f64| {
            let taken_at = desired_base_from_tool * nalgebra::Point3::new(0.0, 0.0, before);
            let last = Entry {
                taken_at: Some(taken_at.into()),
                hand_over: None,
                handing_back: false,
                ..lowering()
            };
            let mut mission = Mission::new(CubeSettings { back, ..settings() }, Goal::Solve, None)
                .resumed(Some(last));
            mission.next(Event::Start, &readings);
            mission.track_folds(back, &arms)
        };

        assert_eq!(drawn(0.0), back, "the cube would stay in the operator's hand: the arm refuses");
        assert_eq!(drawn(0.1 * back), goes, "far enough in all");
    }

    #[test]
    fn an_empty_hand_goes_what_is_left_of_the_way_from_its_partners_cube_as_far_as_its_arm_folds() {
        let (desired_joints, stand) = Fold::example_stand();
        let goes = settings().folds[1].way(&stand, &desired_joints, 0.3);
        let back = goes / 0.6;
        let edge = settings().edge;
        let ways = |gone: f64| {
            let settings = CubeSettings { back, ..settings() };
            let mut mission = Mission::new(settings, Goal::Solve, None).resumed(Some(lowering()));
            let cube = stand * Pose::translation(0.0, 0.0, edge / 3.0 + gone);
            let track =
                ArmState { jaw_opening: edge, desired_base_from_tool: cube, ..ArmState::default() };
            let postument = ArmState {
                jaw_opening: 0.09,
                desired_joints,
                desired_base_from_tool: stand,
                ..ArmState::default()
            };
            let arms = [track, postument];
            mission.next(Event::Start, &Readings { arms: &arms, forces: Forces::default() });
            let opens = |job: &Job| matches!(job, Job::Open { hand: Hand::Postument, .. });
            assert!(mission.queue.iter().any(opens), "{gone}");
            let way = |job: &Job| match job {
                Job::Along(Hand::Postument, way) => Some(-*way),
                _ => None,
            };
            mission.queue.iter().filter_map(way).collect::<Vec<_>>()
        };
        let near = |ways: Vec<f64>, way: f64| ways.len() == 1 && (ways[0] - way).abs() < 1e-9;

        assert!(near(ways(0.0), back), "the cube stays between its fingers: the arm refuses");
        assert!(near(ways(0.1 * back), goes), "far enough in all");
        assert!(near(ways(0.5 * back), 0.5 * back));
        assert!(near(ways(-0.1 * back), back), "deeper than it ever holds");
        assert!(ways(back).is_empty(), "it has gone");
        assert!(ways(3.0 * edge).is_empty(), "far from it");
    }

    #[test]
    fn a_hand_that_may_press_a_cube_held_out_to_it_backs_off_before_it_goes_aside_or_zeroes() {
        let (desired_joints, desired_base_from_tool) = Fold::example_stand();
        let settings = CubeSettings { back: 0.3, ..settings() };
        let goes = settings.folds[0].way(&desired_base_from_tool, &desired_joints, 0.3);
        let taking = Entry { held: [None; 2], hand_over: None, handing_back: false, ..lowering() };
        let mut mission = Mission::new(settings, Goal::Solve, None).resumed(Some(taking));
        let arm = ArmState {
            jaw_opening: 0.09,
            desired_joints,
            desired_base_from_tool,
            ..ArmState::default()
        };
        mission.next(Event::Start, &Readings { arms: &[arm; 2], forces: Forces::default() });
        let at = |wanted: Job| mission.queue.iter().position(|job| *job == wanted).unwrap();

        let gone = at(Job::Along(Hand::Track, -goes));
        assert!(gone > 0 && goes < 0.3, "{goes}");
        assert!(matches!(mission.queue[gone - 1], Job::Open { hand: Hand::Track, .. }));
        assert!(gone < at(Job::Apart) && gone < at(Job::Bias([true, true])));
    }

    #[test]
    fn a_hand_that_had_let_go_of_the_cube_leaves_it_before_the_mission_ends() {
        let ends = |over: bool| {
            let last = Entry { held: [None; 2], over, ..lowering() };
            let mut mission = Mission::new(settings(), Goal::Solve, None).resumed(Some(last));
            let arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
            mission.next(Event::Start, &Readings { arms: &arms, forces: Forces::default() });
            let ends = mission.queue.back() == Some(&Job::Finish { achieved: true });
            assert_eq!(ends, over, "{:?}", mission.queue);
            mission.queue.iter().any(|job| matches!(job, Job::Along(Hand::Track, _)))
        };

        assert!(ends(false));
        assert!(!ends(true), "it had left it");
    }

    /// How a mission ends that goes on from an entry, with the track's jaws so far apart, whose behaviours end so. Nobody looks.
    fn played(last: Entry, mut gap: f64, mut ends: impl FnMut(&Behaviour) -> Outcome) -> Finish {
        let mut mission = Mission::new(settings(), Goal::Solve, None).resumed(Some(last));
        let mut event = Event::Start;
        for _ in 0..200 {
            let mut track = ArmState { jaw_opening: gap, ..ArmState::default() };
            track.desired_base_from_tool = Pose::translation(0.5, 0.1, 0.7);
            let arms = [track, ArmState { jaw_opening: 0.09, ..ArmState::default() }];
            event = match mission.next(event, &Readings { arms: &arms, forces: Forces::default() })
            {
                Action::Behave { orders, .. } => {
                    let outcomes = orders.map(|order| order.as_ref().map(&mut ends));
                    match (orders[0], outcomes[0]) {
                        (Some(Behaviour::Jaw { .. }), _) => gap = 0.09,
                        (_, Some(Outcome::Grasped(width))) => gap = width,
                        _ => {}
                    }
                    Event::Behaved(outcomes)
                }
                Action::Finish(end) => return end,
                Action::Look { .. } => panic!("looked at, though somebody has it"),
                _ => Event::Done,
            };
        }
        panic!("it never ends: {:?}", mission.log.notes);
    }

    #[test]
    fn who_has_hold_of_what_another_run_was_handing_back_is_left_it() {
        // The jaws end so at first, and then a small pull each time.
        let ends = |gap: f64, closed: Outcome, pulled: Outcome| {
            let (mut pulls, mut opened) = (0, false);
            let last = Entry { doing: "handing back".to_owned(), ..lowering() };
            let end = played(last, gap, |order| match order {
                Behaviour::Grasp { .. } => closed,
                Behaviour::Withdraw { .. } => {
                    pulls += 1;
                    pulled
                }
                Behaviour::Jaw { .. } => {
                    opened = true;
                    Outcome::Reached
                }
                Behaviour::VisualServo(_) => Outcome::LostSight(5.0),
                _ => Outcome::Reached,
            });
            (end, pulls, opened)
        };

        // Jaws that were opening, and close on nothing.
        let (end, pulls, opened) = ends(0.058, Outcome::Empty(0.053), Outcome::NotTouched);
        assert!(end.achieved && end.reason == UNSEEN && opened && pulls == 0, "{}", end.reason);
        // Jaws that had closed farther than on a cube have lost it.
        let (end, _, opened) = ends(0.055, Outcome::Empty(0.053), Outcome::NotTouched);
        assert!(!end.achieved && !opened && end.reason.contains("do not hold"), "{}", end.reason);
        // What is pressed while they close is not let go.
        let (end, _, opened) = ends(0.057, Outcome::OverForce(2, 25.0), Outcome::NotTouched);
        assert!(!end.achieved && !opened, "{}", end.reason);
        // Somebody who holds on to it.
        let (end, pulls, opened) = ends(0.057, Outcome::Grasped(0.057), Outcome::Touched(0.001));
        assert!(end.achieved && end.reason == UNSEEN && opened, "{}", end.reason);
        assert!(pulls > super::super::RELEASE_TRIES, "{pulls}");
        // On its way out, which the journal does not tell as handing back, closed jaws were not opening.
        let last = Entry { handing_back: false, ..lowering() };
        let end = played(last, 0.0565, |order| match order {
            Behaviour::Grasp { .. } => Outcome::Empty(0.053),
            _ => Outcome::Reached,
        });
        assert!(!end.achieved && end.reason.contains("do not hold"), "{}", end.reason);
    }

    #[test]
    fn a_cube_that_is_pulled_out_of_a_hand_that_asks_whether_somebody_has_it_did_not_fall() {
        let mut mission = Mission::new(settings(), Goal::Solve, None).resumed(Some(lowering()));
        mission.offered = Some(Offered { opening: false });
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        mission.belief.taken(Hand::Track, hold, false);
        mission.widths = [Some(0.0565); 2];
        let arms = [ArmState { jaw_opening: 0.053, ..ArmState::default() }; 2];

        mission.look_after(&arms).unwrap();

        assert_eq!((mission.log.drops, mission.given_back), (0, true));
        assert_eq!(mission.queue.front(), Some(&Job::LetGo(Hand::Track)));
        assert!(mission.seeks.is_some() && mission.fell.is_none());
    }

    #[test]
    fn who_does_not_let_go_of_what_was_taken_anew_is_not_said_to_have_been_handed_it_back() {
        let last = Entry { held: [None; 2], ..lowering() };

        let end = played(last, 0.09, |order| match order {
            Behaviour::VisualServo(_) | Behaviour::Withdraw { .. } => Outcome::Touched(0.001),
            Behaviour::Grasp { .. } => Outcome::Grasped(0.057),
            _ => Outcome::Reached,
        });

        assert!(!end.achieved && end.reason.contains("does not let go"), "{}", end.reason);
    }

    #[test]
    fn what_another_run_was_handing_back_is_looked_for_and_taken_where_it_is_held_out() {
        let arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        let readings = Readings { arms: &arms, forces: Forces::default() };
        let seeks = |undone: Option<&str>, ended: Outcome| {
            let last = Entry {
                held: [None; 2],
                undone: undone.map(str::to_owned),
                doing: "opening the jaws".to_owned(),
                ..lowering()
            };
            let mut mission = Mission::new(settings(), Goal::Solve, None).resumed(Some(last));
            let (mut event, mut patience) = (Event::Start, None);
            for _ in 0..30 {
                event = match mission.next(event, &readings) {
                    Action::Behave { orders, .. } => match orders[0] {
                        Some(Behaviour::VisualServo(order)) => {
                            patience = Some(order.patience);
                            Event::Behaved([Some(ended), None])
                        }
                        // It is closed upon.
                        Some(Behaviour::Grasp { .. }) => return (mission, None, patience),
                        _ => Event::Behaved(orders.map(|order| order.map(|_| Outcome::Reached))),
                    },
                    Action::Finish(end) => return (mission, Some(end), patience),
                    _ => Event::Done,
                };
            }
            panic!("it never ends: {:?}", mission.log.notes);
        };

        for nobody in [Outcome::LostSight(5.0), Outcome::OutOfZone(5.0)] {
            let (mission, end, patience) = seeks(None, nobody);
            let end = end.unwrap();
            assert!(
                end.achieved && end.reason.contains("nobody has held it out"),
                "{}",
                end.reason
            );
            assert_eq!(
                (patience, mission.whereabouts().as_str()),
                (Some(SEEKS), "the operator has the cube")
            );

            let (_, end, _) = seeks(Some("face U cannot be read"), nobody);
            let end = end.unwrap();
            let told = end.reason.starts_with("face U cannot be read; by the other run's journal");
            assert!(!end.achieved && told, "{}", end.reason);
        }
        let (mission, end, _) = seeks(Some("face U cannot be read"), Outcome::Touched(3.0));
        assert!(end.is_none() && mission.queue.contains(&Job::Looks), "{:?}", mission.queue);
        assert_eq!((mission.given_back, mission.failure.as_ref()), (false, None));
    }

    #[test]
    fn fingers_that_have_let_go_are_clear_after_an_edge_and_what_was_gone_before_counts_nothing() {
        let (desired_joints, desired_base_from_tool) = Fold::example_stand();
        let goes = settings().folds[0].way(&desired_base_from_tool, &desired_joints, 0.3);
        let track = ArmState { desired_joints, desired_base_from_tool, ..ArmState::default() };
        let drawn = |edge: f64| {
            let settings = CubeSettings { back: 2.0 * goes, edge, ..settings() };
            let mut mission = Mission::new(settings, Goal::Solve, None);
            mission.given_back = true;
            mission.taken_at = Some([0.0; 3]);
            mission.track_folds(2.0 * goes, &[track; 2])
        };

        assert_eq!(drawn(0.9 * goes), goes);
        assert_eq!(drawn(1.1 * goes), 2.0 * goes, "the arm refuses");
    }

    #[test]
    fn forces_are_zeroed_before_the_cube_is_approached_once_more() {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        let tried = Job::VisualServo { tries: 1 };

        mission.behaved(tried, [Some(Outcome::NotTouched), None], &[]).unwrap();

        let at = |wanted: Job| mission.queue.iter().position(|job| *job == wanted).unwrap();
        let (back, zeroed) = (Job::DrawBack(settings().back), Job::Bias([true, false]));
        assert!(at(back) < at(zeroed) && at(zeroed) < at(Job::VisualServo { tries: 2 }));
    }

    #[test]
    fn jaws_that_have_opened_in_the_end_may_be_strained_as_often_the_next_time() {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        let open = Job::Open { hand: Hand::Postument, opening: 0.09, stops: Depth::One };
        let strained = [None, Some(Outcome::OverForce(0, 30.0))];

        for _ in 0..2 {
            for _ in 0..super::super::MOST_STRAINED {
                mission.behaved(open, strained, &[]).unwrap();
            }
            mission.behaved(open, [None, Some(Outcome::Reached)], &[]).unwrap();
        }
        for _ in 0..super::super::MOST_STRAINED {
            mission.behaved(open, strained, &[]).unwrap();
        }
        assert!(mission.behaved(open, strained, &[]).is_err());
    }

    #[test]
    fn a_pull_beyond_the_limits_at_a_cube_that_is_handed_back_opens_the_jaws_however_strained() {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        let arms = [ArmState::default(); 2];
        mission.unfold(Job::Present { tries: 1 }, &arms).unwrap();

        let over = Some(Outcome::OverForce(0, 60.0));
        mission.behaved(Job::Present { tries: 1 }, [over, None], &arms).unwrap();

        let opens = mission.open(Hand::Track, 0.09, Depth::One);
        assert!(
            matches!(opens, crate::generators::Behaviour::Jaw { strained: true, .. }),
            "{opens:?}"
        );
        let shaken = Some(Outcome::Oscillates(0, 30.0, 4.0));
        assert!(mission.behaved(Job::Present { tries: 1 }, [shaken, None], &arms).is_err());
    }

    #[test]
    fn where_a_cube_was_taken_that_no_hand_holds_is_not_noted_again() {
        let last = Entry { handing_back: false, short: 0.02, ..lowering() };
        let mut mission = Mission::new(settings(), Goal::Solve, None).resumed(Some(last));
        let arms = [ArmState { jaw_opening: 0.09, ..ArmState::default() }; 2];
        let readings = Readings { arms: &arms, forces: Forces::default() };

        let mut event = Event::Start;
        let noted = (0..10).find_map(|_| {
            let began = std::mem::replace(&mut event, Event::Done);
            if matches!(mission.next(began, &readings), Action::Behave { .. }) {
                event = Event::Behaved([Some(Outcome::Reached), None]);
            }
            mission.entry()
        });

        let noted = noted.unwrap();
        assert_eq!(noted.doing, "opening the jaws");
        assert_eq!((noted.hand_over, noted.taken_at, noted.short), (None, None, 0.0));
    }

    #[test]
    fn what_another_run_must_know_is_noted_before_each_motion_of_the_cube_or_of_a_hand_at_it() {
        let hand = Hand::Track;
        let mut mission = turned(None);
        (mission.given_back, mission.short) = (true, 0.02);
        (mission.taken_at, mission.stops) = (Some([0.5, 0.1, 0.7]), [Depth::Two, Depth::One]);
        mission.failure = Some("a layer stands askew".to_owned());
        let mut noted = |job: Job| {
            mission.pending = Some(job);
            mission.entry()
        };

        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        for job in [
            Job::Take { tries: 1 },
            Job::Close { hand, hold },
            Job::Open { hand, opening: 0.09, stops: Depth::One },
            Job::Turn { turner: hand, angle: 1.0, tries: 1 },
            Job::Present { tries: 1 },
            Job::LayDown,
            Job::Along(hand, 0.1),
            Job::Apart,
            Job::Joints([Some(JointPositions::default()), None], 0.5),
        ] {
            let entry = noted(job).unwrap_or_else(|| panic!("{job:?}"));
            assert!(!entry.over && entry.handing_back, "{job:?}");
            assert_eq!(entry.held, [Some(Depth::One), None]);
            assert_eq!(entry.hand_over, Some(JointPositions::default()));
            assert_eq!((entry.taken_at, entry.short), (Some([0.5, 0.1, 0.7]), 0.02));
            assert_eq!(entry.stops, [Some(Depth::Two), Some(Depth::One)]);
            assert_eq!(entry.undone.as_deref(), Some("a layer stands askew"));
        }
        assert!(noted(Job::Finish { achieved: true }).unwrap().over);
        assert_eq!(noted(Job::Check { viewer: hand, face: Face::U, tries: 1 }), None);
    }

    #[test]
    fn where_the_cube_of_another_run_is_is_not_known_before_somebody_has_looked() {
        let begun = Mission::new(settings(), Goal::Solve, None);
        assert_eq!(begun.whereabouts(), "the operator has the cube");

        let resumed = begun.resumed(None);

        assert!(resumed.whereabouts().ends_with("is not known"), "{}", resumed.whereabouts());
    }

    #[test]
    fn nothing_of_what_was_read_before_counts_when_the_cube_is_read_anew() {
        let mut mission = turned(None);
        mission.failure = Some("face U cannot be read".to_owned());
        (mission.given_back, mission.inspections) = (true, 1);
        mission.uninspected = Some("face R could not be inspected".to_owned());
        mission.stood_still = Some(Turn { face: Face::U, quarters: 1 });
        mission.odd = vec![(Face::U, 1), (Face::U, 2)];

        mission.anew();

        assert_eq!((mission.failure.as_ref(), mission.given_back), (None, false));
        assert_eq!((mission.inspections, mission.uninspected.as_ref()), (0, None));
        assert_eq!((mission.stood_still, mission.odd.len()), (None, 0));
        assert_eq!(mission.queue, [Job::Phase("identify again"), Job::Looks]);
    }

    #[test]
    fn a_layer_that_stands_askew_either_way_is_turned_back_by_the_hand_that_has_it() {
        let across = |r: &UnitQuaternion<f64>| (r * Vector3::z()).z.abs() < 0.1;
        let postument = rotations().into_iter().find(across).unwrap();
        for by in [-0.4, 0.4, 0.02] {
            let mut mission = Mission::new(settings(), Goal::Solve, None).resumed(None);
            let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by);
            let arms = [roll, postument].map(|rotation| ArmState {
                jaw_opening: 0.057,
                desired_base_from_tool: Pose::from_parts(
                    nalgebra::Translation3::identity(),
                    rotation,
                ),
                ..ArmState::default()
            });
            mission.next(Event::Start, &Readings { arms: &arms, forces: Forces::default() });
            mission.queue.clear();

            mission.untwist(&arms);

            let turn = mission.queue.iter().find_map(|job| match job {
                Job::Turn { turner: Hand::Track, angle, .. } => Some(*angle),
                _ => None,
            });
            // The jaws straighten what is off by little.
            match turn {
                Some(angle) => assert!((angle + by).abs() < 1e-9, "{angle} {by}"),
                None => assert!(by.abs() < STRAIGHT, "{by}: {:?}", mission.queue),
            }
            assert!(mission.queue.contains(&Job::LetGo(Hand::Track)), "{:?}", mission.queue);
        }
    }

    #[test]
    fn a_row_that_was_not_turned_is_seen_at_any_brightness() {
        for gain in [0.5, 1.0, 1.15] {
            let expected = [4; 9];
            assert!(otherwise(&reading(expected, gain), &expected, &PALETTE).is_empty());

            let seen = [1, 1, 1, 4, 4, 4, 4, 4, 4];
            assert_eq!(otherwise(&reading(seen, gain), &expected, &PALETTE), [1, 2, 3]);
        }
    }

    /// A mission whose turns are made, the cube in the track hand, goes on until somebody is asked or it is over. `look`
    /// knows how often it was looked before.
    fn inspects(
        mission: &mut Mission,
        mut event: Event<Conclusion>,
        look: impl Fn(u32, Face) -> Result<FaceReading, String>,
    ) -> Action<Thought> {
        let arms = [ArmState { jaw_opening: 0.057, ..ArmState::default() }; 2];
        let mut looks = 0;
        for _ in 0..200 {
            let action = mission.next(event, &Readings { arms: &arms, forces: Forces::default() });
            event = match action {
                Action::Look { .. } => {
                    let Some(Job::Check { face, .. }) = mission.pending else { return action };
                    looks += 1;
                    Event::Looked(look(looks - 1, face))
                }
                Action::Behave { orders, .. } => Event::Behaved(orders.map(|order| {
                    order.map(|order| match order {
                        Behaviour::Present { .. } => Outcome::Pulled,
                        Behaviour::Turn { angle, .. } => Outcome::Turned(angle),
                        Behaviour::VisualServo(_) => Outcome::LostSight(60.0),
                        Behaviour::Approach { .. } => Outcome::Touched(0.0),
                        Behaviour::Grasp { .. } => Outcome::Grasped(0.057),
                        Behaviour::Secure { .. } => Outcome::Secured,
                        _ => Outcome::Reached,
                    })
                })),
                Action::Phase(_) | Action::Bias(_) | Action::Watch(_) => Event::Done,
                other => return other,
            };
        }
        panic!("it never ends: {:?}", mission.log.notes);
    }

    /// The turns are made, so that each side has one colour.
    fn turned(patience: Option<f64>) -> Mission {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        mission.belief.taken(Hand::Track, hold, false);
        (mission.widths, mission.untouched) = ([Some(0.057); 2], false);
        mission.palette = Some(PALETTE);
        let solved = "UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB";
        mission.shown.facelets = solved.parse().ok();
        mission.hand_over = Some(JointPositions::default());
        mission.patience = patience;
        mission.queue.extend([Job::Inspect, Job::HandBack, Job::Finish { achieved: true }]);
        mission
    }

    fn one_colour(face: Face) -> FaceReading {
        reading([face as u8; 9], 1.0)
    }

    fn dark() -> Result<FaceReading, String> {
        Err("the picture is black".to_owned())
    }

    #[test]
    fn a_cube_that_could_not_be_looked_at_goes_back_with_the_reason_and_is_not_called_done() {
        let covered = |face: Face| {
            let covered = FaceReading { occluded: [true; 9], ..reading([face as u8; 9], 1.0) };
            Ok(covered)
        };
        for black in [true, false] {
            let look = |_, face| if black { dark() } else { covered(face) };
            let Action::Finish(end) = inspects(&mut turned(None), Event::Done, look) else {
                panic!()
            };
            assert!(!end.achieved, "{}", end.reason);
            let why =
                if black { ": the picture is black" } else { "1, 2, 3, 4, 5, 6, 7, 8, 9 are" };
            let told = end.reason.contains("could not be inspected") && end.reason.contains(why);
            assert!(told && end.reason.ends_with("was handed back as it is"), "{}", end.reason);
        }
        // One side is enough to doubt it.
        let look = |_, face| if face == Face::U { dark() } else { Ok(one_colour(face)) };
        let Action::Finish(end) = inspects(&mut turned(None), Event::Done, look) else { panic!() };
        assert!(!end.achieved && end.reason.starts_with("face U could not"), "{}", end.reason);
    }

    #[test]
    fn a_cell_whose_cameras_see_too_few_sides_calls_no_cube_done() {
        let meeting = settings().meetings.views[0][0];
        for (views, enough) in [
            ([meeting; 3], true),
            // A layer shows on either of both.
            ([meeting, None, meeting], true),
            ([meeting, meeting, None], true),
            ([meeting, None, None], false),
            ([None, meeting, meeting], false),
        ] {
            let mut mission = turned(None);
            mission.settings.meetings.views = [views; 2];

            let look = |_, face| Ok(one_colour(face));
            let Action::Finish(end) = inspects(&mut mission, Event::Done, look) else { panic!() };

            assert_eq!(end.achieved, enough, "{}", end.reason);
            assert_eq!(end.reason.contains("no pose for the looks"), !enough, "{}", end.reason);
        }
    }

    #[test]
    fn two_stickers_that_look_otherwise_are_a_turned_layer_and_one_is_a_reflection() {
        for (covered, anew) in [(0, true), (1, true), (2, false)] {
            let mut mission = turned(None);
            // Of the three at the rim some may be covered.
            let look = |looks, face: Face| {
                let own = face as u8;
                let other = (own + 1) % 6;
                let mut reading = reading([other, other, other, own, own, own, own, own, own], 1.0);
                if looks > 0 {
                    return Ok(one_colour(face));
                }
                reading.rgb[..covered].copy_from_slice(&one_colour(face).rgb[..covered]);
                reading.occluded[0] = covered > 0;
                Ok(reading)
            };
            let end = inspects(&mut mission, Event::Done, look);

            assert_eq!(matches!(end, Action::Look { .. }), anew, "{covered}: {end:?}");
        }
    }

    #[test]
    fn what_hides_the_cube_may_pass_and_two_looks_in_vain_are_asked_about() {
        // Three tries at each of three sides.
        let look = |looks, face| if looks < 9 { dark() } else { Ok(one_colour(face)) };
        let Action::Finish(end) = inspects(&mut turned(Some(30.0)), Event::Done, look) else {
            panic!()
        };
        assert!(end.achieved, "{}", end.reason);

        let asked = |answer: Option<Answer>| {
            let mut mission = turned(Some(30.0));
            let Action::Ask(question) = inspects(&mut mission, Event::Done, |_, _| dark()) else {
                panic!()
            };
            assert!(question.text.contains("could not be inspected"), "{}", question.text);
            let answer = Event::Answered(answer);
            inspects(&mut mission, answer, |_, face| Ok(one_colour(face)))
        };
        let Action::Finish(end) = asked(Some(Answer::Choice { option: 0 })) else { panic!() };
        assert!(end.achieved, "{}", end.reason);
        // Whoever has it looked at again is asked again only after as many looks in vain.
        let mut mission = turned(Some(30.0));
        let Action::Ask(_) = inspects(&mut mission, Event::Done, |_, _| dark()) else { panic!() };
        let again = Event::Answered(Some(Answer::Choice { option: 0 }));
        let look = |looks, face| if looks < 9 { dark() } else { Ok(one_colour(face)) };
        let Action::Finish(end) = inspects(&mut mission, again, look) else { panic!() };
        assert!(end.achieved, "{}", end.reason);
        for answer in [Some(Answer::Choice { option: 1 }), Some(Answer::Declined), None] {
            let Action::Finish(end) = asked(answer) else { panic!() };
            assert!(!end.achieved && end.reason.contains("the picture is black"), "{}", end.reason);
        }
    }

    #[test]
    fn a_colour_that_was_only_given_looks_as_it_usually_does() {
        let colours = std::array::from_fn(|i| (i / 9) as u8);
        let seen = std::array::from_fn(|i| (i >= 9).then(|| PALETTE[i / 9]));
        let palette = palette(&seen, &colours);

        assert_eq!(palette[1..], PALETTE[1..]);
        assert!(otherwise(&reading([0; 9], 1.0), &[0; 9], &palette).is_empty());
        let seen = [0, 0, 0, 3, 3, 3, 3, 3, 3];
        assert_eq!(otherwise(&reading(seen, 1.0), &[3; 9], &palette), [1, 2, 3]);
    }

    /// Two turns that undo each other, the first one in two goes if it is odd, with a grasp between them: how often it was
    /// looked at, and how it ended.
    fn turns_twice(odd: bool, seen: Facelets) -> (u32, Action<Thought>) {
        let mut mission = turned(None);
        let hold = |palm: Face| Hold { palm, jaws: Axis::X, depth: Depth::One };
        mission.belief.taken(Hand::Track, hold(Face::U), false);
        mission.belief.taken(Hand::Postument, hold(Face::F), false);
        (mission.apart, mission.meeting) = (false, settings().meetings.grasps[0]);
        let turn = |quarters| {
            let turn = Turn { face: Face::U, quarters };
            Job::Step(Step::Turn { turner: Hand::Track, turn })
        };
        let hand = Hand::Track;
        let grasp = Job::Step(Step::Grasp { hand, hold: hold(Face::U), half_roll: false });
        mission.queue.clear();
        let end = Job::Finish { achieved: true };
        // At the second grasp everything is as it should be, whatever was before the first.
        mission.queue.extend([turn(1), grasp, turn(3), grasp, turn(1), turn(3), Job::Inspect, end]);

        let arms = [ArmState { jaw_opening: 0.057, ..ArmState::default() }; 2];
        let readings = Readings { arms: &arms, forces: Forces::default() };
        let Action::Behave { orders: [Some(Behaviour::Turn { angle, .. }), _], .. } =
            mission.next(Event::Done, &readings)
        else {
            panic!()
        };
        let ended = if odd { Outcome::Stalled(0.5, 2.0) } else { Outcome::Turned(angle) };
        let looks = std::cell::Cell::new(0);
        let between = if odd { 3 } else { 0 };
        let end = inspects(&mut mission, Event::Behaved([Some(ended), None]), |looked, face| {
            looks.set(looked + 1);
            let solved = [face as u8; 9];
            let first = 9 * face.index();
            let turned = std::array::from_fn(|i| seen.colours()[first + i]);
            Ok(reading(if looked < between { turned } else { solved }, 1.0))
        });
        (looks.get(), end)
    }

    #[test]
    fn after_a_turn_that_stood_still_in_between_the_cube_is_looked_at_before_the_next_grasp() {
        let solved = turned(None).shown.facelets.unwrap();
        let after = solved.turned(Turn { face: Face::U, quarters: 1 });

        let (looks, Action::Finish(end)) = turns_twice(false, after) else { panic!() };
        assert_eq!((looks, end.achieved), (3, true), "{}", end.reason);
        let (looks, Action::Finish(end)) = turns_twice(true, after) else { panic!() };
        assert_eq!((looks, end.achieved), (6, true), "{}", end.reason);
        // The layer has not gone along: all faces are read anew.
        let (looks, end) = turns_twice(true, solved);
        assert!(looks == 3 && matches!(end, Action::Look { .. }), "{looks} {end:?}");
    }

    #[test]
    fn a_cube_that_was_read_anew_too_often_is_handed_back_by_whoever_holds_it() {
        let ends = |holder: Hand, before: Option<&str>| {
            let mut mission = turned(None);
            let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
            mission.belief.released(Hand::Track);
            mission.belief.taken(holder, hold, false);
            mission.recoveries = MOST_RECOVERIES;
            mission.failure = before.map(str::to_owned);
            mission.queue.clear();
            mission.queue.push_back(Job::Close { hand: holder.other(), hold });
            let arms = [ArmState { jaw_opening: 0.057, ..ArmState::default() }; 2];
            let readings = Readings { arms: &arms, forces: Forces::default() };
            mission.next(Event::Done, &readings);
            let mut nothing = [None; 2];
            nothing[holder.other().index()] = Some(Outcome::Grasped(0.05));
            let look = |_, face| Ok(one_colour(face));
            let Action::Finish(end) = inspects(&mut mission, Event::Behaved(nothing), look) else {
                panic!()
            };
            assert!(!end.achieved && end.reason.contains("jaws do not hold"), "{}", end.reason);
            end.reason
        };

        for holder in [Hand::Track, Hand::Postument] {
            let reason = ends(holder, None);
            assert!(reason.ends_with("; the cube was handed back as it is"), "{reason}");
        }
        // On its way back already.
        let reason = ends(Hand::Postument, Some("a layer stands askew"));
        assert!(reason.starts_with("a layer stands askew; the track hand's jaws"), "{reason}");
        assert!(reason.ends_with("; the postument hand holds the cube"), "{reason}");
    }

    #[test]
    fn where_a_cube_fell_that_nobody_finds_is_told() {
        for keeper in [Keeper::Person, Keeper::Table] {
            let mut mission = turned(None);
            mission.settings.keeper = keeper;
            // The jaws have come nearer than that.
            mission.widths = [Some(0.07); 2];

            let look = |_, face| Ok(one_colour(face));
            let Action::Finish(end) = inspects(&mut mission, Event::Done, look) else { panic!() };

            let told = "it fell from the track hand and lies below where that was, at x 0 mm, y 0 mm of the world";
            assert!(end.reason.starts_with("no cube in sight"), "{}", end.reason);
            assert!(end.reason.ends_with(told), "{}", end.reason);
            assert_eq!(mission.whereabouts(), told);
        }
    }

    #[test]
    fn what_is_covered_says_nothing() {
        let mut covered = reading([1, 1, 1, 4, 4, 4, 4, 4, 4], 1.0);
        covered.occluded[..3].fill(true);

        assert!(otherwise(&covered, &[4; 9], &PALETTE).is_empty());
    }

    #[test]
    fn a_layer_askew_is_found_with_its_hand_and_its_angle() {
        let track = UnitQuaternion::from_euler_angles(0.3, -0.7, 1.1);
        for straight in rotations() {
            let postument = track * straight;
            let z = track.inverse() * (postument * Vector3::z());
            if z.z > 0.9 {
                continue; // One palm under the other: no such grasp.
            }
            for by in [-0.7, -0.3, 0.2, 0.6] {
                let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by);

                let (hand, found) = askew(&(track * roll), &postument);

                // Palms on opposite sides roll about one axis: either hand may undo it.
                let opposite = z.z < -0.9;
                assert!(opposite || hand == Hand::Track, "{hand:?}");
                let expected = if hand == Hand::Track { -by } else { by };
                assert!((found.abs() - by.abs()).abs() < 1e-6, "{found} {expected}");
                if hand == Hand::Track {
                    assert!((found + by).abs() < 1e-6, "{found} {by}");
                }
            }
        }
    }
}
