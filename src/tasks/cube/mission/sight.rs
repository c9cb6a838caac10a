//! What the cameras in the hands have seen of the cube, and what is done about what they have not.
//!
//! A sticker is kept as light, not as a level of one picture: looks at several exposures are decided together. What
//! something covers is looked at from beside, then in another grasp, and is never guessed; a doubt about stickers lets
//! their faces be looked at again, and no others.
//!
//! - in: readings of faces, each at its exposure; stickers in doubt
//! - out: the light of 54 stickers; the steps of the looks that are still wanted
//! - source: own work

use super::{Job, Mission, NUDGES};
use crate::cube::Face;
use crate::motion::ArmState;
use crate::operator::Reading;
use crate::tasks::cube::hold::{Hand, Step};
use crate::tasks::cube::identify::Wanted;
use crate::tasks::cube::plan::Planner;
use crate::tasks::cube::think::Doubt;
use crate::vision::colours::{CLIPPED, to_level, to_linear};
use crate::vision::sensor::FaceReading;

/// Looks at one face in one grasp before it counts as hidden there.
const LOOK_TRIES: u32 = 6;
/// Exposures of the looks at one face: glare and shadow each hide stickers at one of them.
const EXPOSURES: [f64; 3] = [1.0, 0.6, 1.6];
/// Rounds of looks, the second at another exposure.
const LOOK_ROUNDS: u32 = 2;
/// Faces that stay hidden in the grasp in which they were looked at, before no other grasp is tried.
const MOST_HIDDEN: usize = 3;

/// All that was seen.
#[derive(Debug, Clone)]
pub(super) struct Sight {
    /// By facelet of the cube frame at acquisition.
    stickers: [Option<Sticker>; 54],
    /// What is wanted of the looks, and what they are not to be tried in.
    wanted: Wanted,
}

/// What was seen of a sticker.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sticker {
    /// Linear light; 1 is full scale at the nominal exposure.
    light: [f64; 3],
    /// The exposure at which a channel was clipped: there was more light than this.
    clipped_at: Option<f64>,
}

impl Default for Sight {
    fn default() -> Self {
        Self { stickers: [None; 54], wanted: Wanted::default() }
    }
}

impl Sight {
    /// A sticker was seen with these levels, 0..=255, at an exposure. What is clipped in a picture that is exposed for
    /// longer than usual says nothing, and else only as long as no other picture says more.
    fn see(&mut self, facelet: usize, levels: [f64; 3], exposure: f64) {
        let light = levels.map(|v| to_linear(v) / exposure);
        let clipped_at = levels.iter().any(|&v| v >= CLIPPED).then_some(exposure);
        let known = self.stickers[facelet].map(|s| s.clipped_at);
        let tells = match (clipped_at, known) {
            (None, _) => true,
            (Some(_), None) => exposure <= 1.0,
            (Some(now), Some(before)) => before.is_some_and(|before| now <= before),
        };
        if tells {
            self.stickers[facelet] = Some(Sticker { light, clipped_at });
        }
    }

    /// Facelets that were not seen.
    pub(super) fn missing(&self) -> Vec<usize> {
        (0..54).filter(|&i| self.stickers[i].is_none()).collect()
    }

    /// Levels as one picture of the whole cube would have them, 0..=255, whose brightest channel is not clipped.
    pub(super) fn levels(&self) -> [Option<[f64; 3]>; 54] {
        let all = self.stickers.iter().flatten().flat_map(|s| s.light);
        let brightest = all.fold(1.0, f64::max);
        self.stickers.map(|s| s.map(|s| s.light.map(|v| to_level(v / brightest))))
    }

    /// The cube's faces have other names from now on: holds are no longer those in which something was hidden.
    pub(super) fn renamed(&mut self) {
        self.wanted.hidden.clear();
    }
}

impl Mission {
    /// Exposure of a try to read a face.
    pub(super) fn exposure(&self, tries: u32) -> f64 {
        EXPOSURES[(tries + self.rounds - 2) as usize % EXPOSURES.len()]
    }

    /// A face was looked at.
    pub(super) fn looked(
        &mut self,
        viewer: Hand,
        face: Face,
        tries: u32,
        reading: Result<FaceReading, String>,
        arms: &[ArmState],
    ) -> Result<(), String> {
        let first = face.index() * 9;
        let exposure = self.exposure(tries);
        let reading = reading.and_then(|reading| {
            self.shown.net.facelets.resize(54, None);
            for i in (0..9).filter(|&i| !reading.occluded[i]) {
                self.sight.see(first + i, reading.rgb[i], exposure);
                let (colour, confidence) = (reading.colours[i], reading.confidences[i]);
                self.shown.net.facelets[first + i] = Some(Reading { colour, confidence });
            }
            let missing = self.sight.missing().into_iter().filter(|i| i / 9 == face.index());
            let missing: Vec<String> = missing.map(|i| (i % 9 + 1).to_string()).collect();
            // Stickers that something covers are seen from elsewhere, never guessed.
            if missing.is_empty() {
                Ok(reading)
            } else {
                Err(format!("stickers {} are covered", missing.join(", ")))
            }
        });
        match reading {
            Ok(reading) => {
                self.belief.seen(viewer, face, &reading.camera_from_face, arms);
                Ok(())
            }
            Err(reason) if tries < LOOK_TRIES => {
                self.log
                    .notes
                    .push(format!("face {} was not read ({reason}), try {tries}", face.letter()));
                self.push_front(&[
                    // From elsewhere: other reflections, other sampling, past what hides a sticker.
                    Job::Nudge(viewer, NUDGES[(tries as usize - 1) % NUDGES.len()]),
                    Job::Look { viewer, face, tries: tries + 1 },
                ]);
                Ok(())
            }
            Err(reason) => {
                self.hidden(face, format!("face {} cannot be read: {reason}", face.letter()))
            }
        }
    }

    /// A face cannot be read as the cube is held: other grasps may show it, or somebody else see it.
    fn hidden(&mut self, face: Face, reason: String) -> Result<(), String> {
        let (holder, grip) = self.held_alone()?;
        self.sight.wanted.hidden.push((holder, grip.hold, face));
        if self.sight.wanted.hidden.len() < MOST_HIDDEN
            && let Ok(steps) = self.looks()
        {
            self.log.notes.push(format!("{reason}: the cube is grasped otherwise"));
            self.queue.clear();
            self.looks_then_plan(steps);
            return Ok(());
        }
        if self.patience.is_some() {
            self.log.notes.push(reason);
            return Ok(());
        }
        self.give_back(reason)
    }

    /// The looks that show what was not seen yet.
    pub(super) fn looks(&mut self) -> Result<Vec<Step>, String> {
        self.sight.wanted.faces = [false; 6];
        for facelet in self.sight.missing() {
            self.sight.wanted.faces[facelet / 9] = true;
        }
        let start = self.held_alone()?;
        let looks = Planner::new(&self.settings).looks_at(start, &self.sight.wanted);
        looks.map_err(|e| e.to_string())
    }

    pub(super) fn looks_then_plan(&mut self, steps: Vec<Step>) {
        self.queue.extend(steps.into_iter().map(Job::Step));
        self.queue.extend([Job::Phase("plan"), Job::Plan]);
    }

    /// What was seen is no cube, or not for certain: the faces in question are looked at again, then somebody is asked.
    pub(super) fn doubted(&mut self, doubt: Doubt) -> Result<(), String> {
        let mut again = [doubt.doubtful.is_empty(); 6];
        doubt.doubtful.iter().for_each(|facelet| again[facelet / 9] = true);
        let before = self.sight.clone();
        for facelet in (0..54).filter(|facelet| again[facelet / 9]) {
            self.sight.stickers[facelet] = None;
        }
        if self.rounds < LOOK_ROUNDS
            && let Ok(steps) = self.looks()
        {
            let faces: String =
                Face::ALL.iter().filter(|f| again[f.index()]).map(|f| f.letter()).collect();
            self.log.notes.push(format!("{}: faces {faces} are looked at again", doubt.reason));
            self.rounds += 1;
            self.queue.push_back(Job::Phase("identify again"));
            self.looks_then_plan(steps);
            return Ok(());
        }
        self.sight = before;
        self.ask(doubt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::Axis;
    use crate::generators::{Behaviour, Outcome};
    use crate::motion::Depth;
    use crate::tasks::cube::hold::Hold;
    use crate::tasks::cube::mission::Goal;
    use crate::tasks::cube::mission::testing::settings;
    use crate::tasks::cube::think::{Conclusion, NoAnswer, Thought};
    use crate::tasks::{Action, Event, Forces, Readings, Task};

    #[test]
    fn a_sticker_is_the_same_at_every_exposure() {
        let light = [0.5, 0.2, 0.05];
        for exposure in [0.6, 1.0, 1.6] {
            let mut sight = Sight::default();
            sight.see(7, light.map(|v| to_level(v * exposure)), exposure);

            let seen = sight.levels()[7].unwrap();

            for (seen, light) in seen.iter().zip(light) {
                assert!((to_linear(*seen) - light).abs() < 1e-9, "{exposure}: {seen}");
            }
        }
    }

    #[test]
    fn what_is_clipped_gives_way_to_what_is_not_and_tells_nothing_when_exposed_for_long() {
        let mut sight = Sight::default();
        let light = |sight: &Sight| sight.stickers[0].map(|s| s.light[0]);

        sight.see(0, [255.0, 100.0, 100.0], 1.6);
        assert_eq!(light(&sight), None);

        sight.see(0, [255.0, 100.0, 100.0], 1.0);
        assert_eq!(light(&sight), Some(1.0));

        sight.see(0, [255.0, 140.0, 140.0], 1.6);
        assert_eq!(light(&sight), Some(1.0));

        sight.see(0, [240.0, 80.0, 80.0], 0.6);
        let seen = light(&sight).unwrap();
        assert!(seen > 1.4, "{seen}");

        sight.see(0, [255.0, 100.0, 100.0], 1.0);
        assert_eq!(light(&sight), Some(seen));
        // More light than a picture at the nominal exposure can tell, and yet not clipped for the decision.
        assert!(sight.levels()[0].unwrap().iter().all(|v| (0.0..=255.0).contains(v)));
    }

    /// The track hand holds the cube alone, and all faces are to be looked at.
    fn holding() -> Mission {
        let mut mission = Mission::new(settings(), Goal::Solve, None);
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        mission.belief.taken(Hand::Track, hold, false);
        mission.apart = true;
        mission.queue.push_back(Job::Looks);
        mission
    }

    /// A look at a face in a hold, and whether the camera went aside or nearer for it.
    #[derive(Debug, PartialEq)]
    struct Look {
        face: Face,
        hold: Hold,
        nudged: bool,
    }

    /// Performs the mission until it thinks, asks or ends, and tells what was looked at; `hides` tells which stickers of a
    /// face cannot be seen in a hold.
    fn perform(
        mission: &mut Mission,
        begin: Event<Conclusion>,
        hides: impl Fn(Face, Hold) -> [bool; 9],
    ) -> (Action<Thought>, Vec<Look>) {
        let arms = [ArmState { jaw_opening: 0.057, ..ArmState::default() }; 2];
        let (mut event, mut looks, mut nudged) = (begin, Vec::new(), false);
        for _ in 0..1000 {
            let action = mission.next(event, &Readings { arms: &arms, forces: Forces::default() });
            event = match action {
                Action::Phase(_) | Action::Bias(_) => Event::Done,
                Action::Behave { orders, .. } => {
                    nudged |= matches!(mission.pending, Some(Job::Nudge(..)));
                    Event::Behaved(orders.map(|o| {
                        o.map(|order| match order {
                            Behaviour::Approach { .. } => Outcome::Touched(0.0),
                            Behaviour::Grasp { .. } => Outcome::Grasped(0.057),
                            Behaviour::Secure { .. } => Outcome::Secured,
                            _ => Outcome::Reached,
                        })
                    }))
                }
                Action::Look { effector, view } => {
                    let Some(Job::Look { face, .. }) = mission.pending else { panic!() };
                    let hold = mission.belief.held[1 - effector].unwrap().hold;
                    looks.push(Look { face, hold, nudged: std::mem::take(&mut nudged) });
                    Event::Looked(Ok(FaceReading {
                        rgb: [[100.0, 120.0, 140.0]; 9],
                        colours: [0; 9],
                        confidences: [1.0; 9],
                        camera_from_face: view.camera_from_face,
                        residual_px: 0.1,
                        confidence: 1.0,
                        occluded: hides(face, hold),
                    }))
                }
                other => return (other, looks),
            };
        }
        panic!("it never ends: {:?}", mission.log.notes);
    }

    /// Sticker 3 of the upper face is covered as long as the palm is on the lower one.
    fn under_a_finger(face: Face, hold: Hold) -> [bool; 9] {
        std::array::from_fn(|i| i == 2 && face == Face::U && hold.palm == Face::D)
    }

    #[test]
    fn a_sticker_under_a_finger_is_seen_in_another_grasp() {
        let mut mission = holding();

        let (action, looks) = perform(&mut mission, Event::Done, under_a_finger);

        assert!(matches!(action, Action::Think(_)), "{action:?}");
        assert!(mission.sight.missing().is_empty());
        let upper: Vec<Hold> = looks.iter().filter(|l| l.face == Face::U).map(|l| l.hold).collect();
        let covered = upper.iter().filter(|hold| hold.palm == Face::D).count();
        assert_eq!(covered, LOOK_TRIES as usize, "not twice in one hold");
        assert_eq!(upper.len(), covered + 1);
        // The other faces are looked at once each.
        assert_eq!(looks.len(), upper.len() + 5, "{looks:?}");
    }

    #[test]
    fn a_sticker_that_no_grasp_shows_is_asked_about_or_the_cube_goes_back() {
        let always = |face: Face, _: Hold| std::array::from_fn(|i| i == 2 && face == Face::U);

        let (action, looks) = perform(&mut holding(), Event::Done, always);
        let upper: Vec<Hold> = looks.iter().filter(|l| l.face == Face::U).map(|l| l.hold).collect();
        assert_eq!(upper.len(), MOST_HIDDEN * LOOK_TRIES as usize);
        let mut holds = upper.clone();
        holds.dedup();
        assert_eq!(holds.len(), MOST_HIDDEN, "{holds:?}");
        assert!(!matches!(action, Action::Think(_)), "never guessed: {action:?}");

        let mut mission = holding();
        mission.patience = Some(60.0);
        let (action, _) = perform(&mut mission, Event::Done, always);
        let Action::Ask(question) = action else { panic!("{action:?}") };
        assert!(question.text.contains("U3 cannot be read"), "{}", question.text);
    }

    #[test]
    fn a_doubt_lets_only_its_faces_be_looked_at_again() {
        let mut mission = holding();
        let all = |_: Face, _: Hold| [false; 9];
        let (_, looks) = perform(&mut mission, Event::Done, all);
        assert_eq!(looks.len(), 6);
        assert!(looks.iter().all(|l| !l.nudged), "{looks:?}");
        let doubt = || {
            let doubtful = vec![9, 12, 40];
            let doubt = Doubt { reason: "red?".into(), read: None, doubtful, possible: true };
            Event::Thought(Conclusion(Err(NoAnswer::Unread(Box::new(doubt)))))
        };

        let (action, looks) = perform(&mut mission, doubt(), all);

        assert!(matches!(action, Action::Think(_)), "{action:?}");
        let mut faces: Vec<Face> = looks.iter().map(|l| l.face).collect();
        faces.sort_unstable();
        assert_eq!(faces, [Face::R, Face::L]);
        assert!(looks.iter().all(|l| l.nudged), "from elsewhere: {looks:?}");

        // The same doubt once more: there is nobody to ask.
        let (_, looks) = perform(&mut mission, doubt(), all);
        assert!(looks.is_empty(), "{looks:?}");
        assert!(mission.failure.is_some());
    }
}
