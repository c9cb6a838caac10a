//! State behind the mission's port, for the journal, the operator and the summary.
//!
//! The robot publishes it with each action. Page, journal, recording and summary read it there, so
//! that it outlives a procedure that is terminated.

use super::entry::Entry;
use crate::cube::{Face, Facelets, Rotation24, Turn, facelet_at, facelet_place, format_turns};
use crate::kernel::Picture;
use crate::motion::ArmState;
use crate::operator::{Net, PlanLine, Reading};
#[cfg(test)]
use crate::tasks::cube::belief::Held;
use crate::tasks::cube::plan::explain::Line;
use crate::tasks::cube::think::Answer;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;

/// State behind the port.
#[derive(Debug, Default)]
pub(super) struct Shared {
    /// States of both arms, as the shell delivered them with the last event.
    pub(super) arms: [ArmState; 2],
    /// Journal entry that must be durable before the present action.
    pub(super) entry: Option<Entry>,
    /// Believed state of the cube, for display.
    pub(super) picture: Option<Picture>,
    /// Believed place of the cube, in words.
    pub(super) whereabouts: String,
    /// Opening below which the jaws of each hand have lost the cube (m); `None` for a hand without
    /// it.
    pub(super) least_openings: [Option<f64>; 2],
    /// Facts for the summary of the run.
    pub(super) log: MissionLog,
    /// Notes that the shell has not taken yet.
    pub(super) notes: Vec<String>,
    /// Face that is looked at, and the grips of both hands, for tests, which cannot see the robot.
    #[cfg(test)]
    pub(super) looking: Option<(Face, [Option<Held>; 2])>,
}

/// Facts about a mission for the summary of the run, as the controller believes them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MissionLog {
    /// Colours that were read, in letters URFDLB by the centres' colours.
    pub identified: Option<String>,
    /// Face turns of the first plan.
    pub solution: Vec<Turn>,
    /// Time that the first plan was expected to take (s).
    pub expected: Option<f64>,
    /// Note on the length of the first solution, if the strategy has a rule about it.
    pub rule: Option<String>,
    /// Turns that were carried out.
    pub executed: Vec<Turn>,
    /// Jaw closings on the cube between identification and hand-back.
    pub grasps: u32,
    /// Number of times that the cube was read and planned again after a failure.
    pub recoveries: u32,
    /// Number of times that the jaws reported a fallen cube.
    pub drops: u32,
    /// Steps of the first plan in words.
    pub plan: Vec<Line>,
}

impl MissionLog {
    /// Returns the facts as figures for the summary, by the names that its JSON has.
    pub(super) fn figures(&self) -> BTreeMap<String, Value> {
        let solution = self.identified.as_ref().map(|_| format_turns(&self.solution));
        let figures = [
            ("identified", json!(self.identified)),
            ("solution", json!(solution)),
            ("expected_s", json!(self.expected)),
            ("executed", json!(format_turns(&self.executed))),
            ("turns", json!(self.executed.len())),
            ("grasps", json!(self.grasps)),
            ("recoveries", json!(self.recoveries)),
            ("drops_noticed", json!(self.drops)),
        ];
        let rule = self.rule.as_ref().map(|rule| ("solution_rule", json!(rule)));
        let figures = figures.into_iter().chain(rule);
        figures.map(|(name, figure)| (name.to_owned(), figure)).collect()
    }
}

/// Cube and plan as the operator sees them.
#[derive(Debug, Default)]
pub(super) struct Shown {
    pub(super) net: Net,
    pub(super) plan: Arc<Vec<PlanLine>>,
    /// Number of steps of the plan that have begun.
    pub(super) step: Option<usize>,
    /// Facelets after the turns that were carried out, named by the centres' colours.
    pub(super) facelets: Option<Facelets>,
}

impl Shown {
    /// Stores the decided cube and its plan for display, both named by the colours of the centres.
    pub(super) fn decide(&mut self, answer: &Answer) {
        let (colours, rotation) = (answer.read.colours(), answer.rotation);
        self.net = Net { facelets: vec![None; 54], decided: true };
        for (index, (colour, confidence)) in colours.iter().zip(answer.margins).enumerate() {
            // The answer's colours are in the frame of acquisition, the plan in the named one.
            self.net.facelets[moved(index, rotation)] =
                Some(Reading { colour: *colour, confidence });
        }
        self.facelets = answer.identified.parse().ok();
        let line = |line: &Line| PlanLine {
            what: line.what.clone(),
            why: line.why.clone(),
            seconds: line.seconds,
        };
        self.plan = Arc::new(answer.lines.iter().map(line).collect());
        self.step = Some(0);
    }

    /// Returns the net in the frame in which the whole cube will be named. Faces that were read
    /// before the decision stay at their places when it comes: the colours of their centres say
    /// where these are. While only one face is known, it may still turn in its place.
    pub(super) fn net_in_place(&self) -> Net {
        let centre = |face: Face| self.net.facelets.get(face.index() * 9 + 4).copied().flatten();
        let known: Vec<(Face, usize)> = Face::ALL
            .into_iter()
            .filter_map(|face| Some((face, usize::from(centre(face)?.colour))))
            .collect();
        if self.net.decided || known.is_empty() {
            return self.net.clone();
        }
        let fits = |rotation: Rotation24| {
            known.iter().filter(|(face, colour)| rotation.face(*face).index() == *colour).count()
        };
        // The first of equals, so that the choice does not change from picture to picture.
        let best = Rotation24::all().fold(Rotation24::IDENTITY, |best, rotation| {
            if fits(rotation) > fits(best) { rotation } else { best }
        });
        let mut facelets = vec![None; self.net.facelets.len()];
        for (index, reading) in self.net.facelets.iter().enumerate() {
            facelets[moved(index, best)] = *reading;
        }
        Net { facelets, decided: false }
    }

    /// Counts a step of the plan that begins.
    pub(super) fn begin_step(&mut self) {
        self.step = self.step.map(|step| step + 1);
    }
}

/// Returns the index to which a rotation of the whole cube moves a facelet.
fn moved(index: usize, rotation: Rotation24) -> usize {
    let place = facelet_place(index);
    facelet_at(rotation.cell(place.cell()), rotation.face(place.face))
}

/// Kind of an action: it gives a word for messages, and decides whether there is a journal entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Doing {
    /// No motion.
    Nothing,
    /// Motion that needs a journal entry.
    Travelling,
    /// Small or repeated motion, without a journal entry.
    Adjusting,
    Approaching,
    ClosingJaws,
    Securing,
    OpeningJaws,
    GivingWay,
    Turning,
    HandingBack,
    LayingDown,
    /// The mission is over.
    Over,
}

impl Doing {
    /// Returns the action in words, for messages and journal entries.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Nothing | Self::Travelling | Self::Adjusting => "moving",
            Self::Approaching => "approaching",
            Self::ClosingJaws => "closing the jaws",
            Self::Securing => "securing",
            Self::OpeningJaws => "opening the jaws",
            Self::GivingWay => "yielding",
            Self::Turning => "turning",
            Self::HandingBack => "handing back",
            Self::LayingDown => "laying it down",
            Self::Over => "over",
        }
    }

    /// Returns whether the action needs a journal entry: it moves the cube, or a hand at the cube,
    /// so that a run which resumes must know of it.
    pub(super) fn needs_entry(self) -> bool {
        match self {
            Self::Travelling
            | Self::ClosingJaws
            | Self::OpeningJaws
            | Self::Turning
            | Self::HandingBack
            | Self::LayingDown
            | Self::Over => true,
            Self::Nothing
            | Self::Adjusting
            | Self::Approaching
            | Self::Securing
            | Self::GivingWay => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::Cube;

    /// A cube is read in each orientation, one face after the other. Once two faces beside each
    /// other are known, each sticker is shown where the decision will show it.
    #[test]
    fn faces_read_stay_at_their_places() {
        let named = Facelets::from(&Cube::scrambled(7));

        for rotation in Rotation24::all() {
            let read = named.rotated(rotation);
            let mut shown = Shown::default();
            shown.net.facelets = vec![None; 54];
            for (face, colours) in read.colours().chunks(9).enumerate() {
                for (i, colour) in colours.iter().enumerate() {
                    let reading = Reading { colour: *colour, confidence: 1.0 };
                    shown.net.facelets[face * 9 + i] = Some(reading);
                }
                let net = shown.net_in_place();
                let right = |(seen, wanted): (&Option<Reading>, &u8)| {
                    seen.is_none_or(|seen| seen.colour == *wanted)
                };
                let places = net.facelets.iter().zip(named.colours());
                assert_eq!(net.facelets.iter().flatten().count(), (face + 1) * 9);
                assert!(face == 0 || places.clone().all(right), "{rotation:?}, {face}: {net:?}");
            }
        }
    }
}
