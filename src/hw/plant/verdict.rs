//! The plant's true account of a run: for summaries and tests, never for the controller.

use super::objects::truth::ObjectTruth;
use crate::cell::{MOST_ARMS, PerArm};
use crate::cube::{Axis, Face, Keeper};
use crate::spatial::Pose;

/// Greatest number of events that are kept; later ones are only counted.
pub const MOST_EVENTS: usize = 256;

/// State and history of the plant.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// Servo periods done.
    pub period: u64,
    /// Stickers URFDLB by position, each named by the centre of its colour, layers at their nearest
    /// quarter.
    pub facelets: [u8; 54],
    /// Place of the cube.
    pub cube: Whereabouts,
    /// Pose of the middle layer in the world.
    pub world_from_cube: Pose,
    /// Whether the operator has the cube back.
    pub returned: bool,
    /// Owner of the cube in the end; where it is the table, no person is in the cell.
    pub keeper: Keeper,
    /// Whether two arms, or more, hold the cube.
    pub both_hold: bool,
    /// Axis that layers turn about, or were turned about last.
    pub turning: Axis,
    /// Angles of the negative and the positive outer layer of that axis against the middle layer
    /// (rad), since the axis became active.
    pub layer_angles: [f64; 2],
    /// Relative rotation of the two grasped parts about that axis since both hold, of the second
    /// arm's part against the first's, right-handed about the cube's axis (rad).
    pub turned: f64,
    /// Numbers of events by kind.
    pub counts: Counts,
    /// Jaw closings on the cube, per arm.
    pub grasps: PerArm<u32>,
    /// Greatest contact force at a tool while both arms hold the cube, grip squeeze excluded (N).
    pub peak_force: f64,
    /// Greatest contact torque at a tool while both arms hold the cube (Nm).
    pub peak_torque: f64,
    /// Greatest contact force of each arm on the cube, or on objects, in the whole run (N).
    pub arm_peak_force: PerArm<f64>,
    /// Greatest contact torque of each arm on the cube, or on objects, in the whole run (Nm).
    pub arm_peak_torque: PerArm<f64>,
    /// Greatest loads of motors and arms.
    pub exertion: Exertion,
    /// Events in order; at most [`MOST_EVENTS`].
    pub events: Vec<Event>,
    /// Rigid objects beside the cube, in the order of the configuration.
    pub objects: Vec<ObjectTruth>,
}

/// Greatest loads of a run, over all motors and arms.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Exertion {
    /// Current, as a share of what trips a motor's power stage.
    pub current: f64,
    /// Heat of a winding, as a share of what trips it.
    pub heat: f64,
    /// Speed of a motor (rad/s).
    pub motor_speed: f64,
    /// Speed of a point of forearm, wrist, hand or fingers within [`Exertion::NEAR`] of the place
    /// where a person holds the cube (m/s).
    pub near_person: f64,
    /// Least distance of a part of one arm from a part of the other (m): fingers, palms, hands,
    /// wrists, forearms; `None` where the arms were never near to each other. At each grasp fingers
    /// are some millimetres from the other palm.
    pub arms_apart: Option<f64>,
}

impl Exertion {
    /// Distance from the person's place within which a point of an arm is near it (m): fingers,
    /// cube or palm may then touch a hand there.
    pub const NEAR: f64 = 0.175;
}

/// Numbers of events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub struct Counts {
    /// Loaded layers that stood still for 3 s away from every quarter.
    pub stuck: u32,
    /// Grips that slipped by more than 3 deg or 1 mm while their jaws were not opening.
    pub slips: u32,
    /// Falls of the cube.
    pub drops: u32,
    /// Pops of the cube: tilt above 3 Nm or a pull above 50 N. Only the first one is counted.
    pub pops: u32,
    /// Squeezes of the cube above 150 N. Only the first one of each arm is counted.
    pub crushed: u32,
    /// Contacts between parts that should not touch.
    pub collisions: u32,
    /// Readings of a wrist sensor at the end of its range, counted when they begin.
    pub saturations: u32,
    /// Rules of conduct that the controller broke. States of older builds have none.
    #[serde(default)]
    pub violations: Violations,
}

/// Numbers of acts that no controller may do, whatever fails around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub struct Violations {
    /// Falls of a cube because the last hand that held it opened its jaws.
    pub let_fall: u32,
    /// Arms whose drives went on again after the drives of an arm had gone off.
    pub restarts: u32,
    /// Motions of an arm later than 0.55 s after the drives of an arm had gone off.
    pub moved_after_stop: u32,
}

/// Place of the cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Whereabouts {
    /// In the operator's hand alone.
    Hand,
    /// In the grippers of these arms, perhaps with the operator's hand.
    Arms(PerArm<bool>),
    /// In the air.
    Falling,
    /// At rest on the table, or the tray there.
    Tray {
        /// Face that lies down, by position in the cube frame.
        down: Face,
        /// Whether it came there by a fall; else it has lain there from the beginning, or was laid
        /// down.
        fell: bool,
    },
}

/// Event with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// Servo period.
    pub period: u64,
    /// Kind of the event.
    pub what: Incident,
}

/// Kind of an event.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Incident {
    /// Jaws closed on the cube.
    Grasped {
        /// Index of the arm.
        arm: usize,
    },
    /// Jaws let go of the cube.
    Released {
        /// Index of the arm.
        arm: usize,
    },
    /// A loaded layer stood still for 3 s away from every quarter.
    Stuck {
        /// Axis of the layer.
        axis: Axis,
        /// Angle from the nearest quarter turn (rad).
        angle: f64,
        /// Torque on the layer (Nm).
        torque: f64,
    },
    /// A grip has slipped by more than 1 mm or 3 deg since its jaws closed.
    Slip {
        /// Index of the arm.
        arm: usize,
        /// Slip in the plane of the pads (m).
        distance: f64,
        /// Slip angle (rad).
        angle: f64,
    },
    /// The cube fell, and this arm had lost its grasp of it before: the grasp had slipped by more
    /// than 5 mm or 20 deg, or a fault made the arm drop the cube.
    GraspLost {
        /// Index of the arm.
        arm: usize,
    },
    /// The cube fell out of this arm's hand, or of the operator's (`None`).
    Drop {
        /// Index of the last arm that had it.
        arm: Option<usize>,
    },
    /// An arm has laid the cube down and let go of it.
    LaidDown {
        /// Index of the arm.
        arm: usize,
        /// Face that lies down.
        down: Face,
    },
    /// The cube came to rest after a fall.
    Landed {
        /// Face that lies down.
        down: Face,
    },
    /// A layer of the cube popped off.
    Pop {
        /// Torque across the axis (Nm).
        tilt: f64,
        /// Force along the axis (N).
        pull: f64,
    },
    /// An arm squeezed the cube by more than 150 N.
    Crush {
        /// Index of the arm.
        arm: usize,
        /// Force of the squeeze (N).
        squeeze: f64,
    },
    /// Two parts met that should not.
    Collision {
        /// First part.
        what: Part,
        /// Second part.
        with: Part,
        /// Overlap at first (m).
        depth: f64,
    },
    /// A wrist sensor left its range.
    Saturation {
        /// Index of the arm.
        arm: usize,
    },
    /// The operator let go of the cube, or took it.
    Operator {
        /// Whether the operator has the cube now.
        has_cube: bool,
    },
}

impl Incident {
    /// Returns whether the event is an accident, whatever caused it, even an injected fault.
    #[must_use]
    pub fn is_accident(&self) -> bool {
        match self {
            Self::Stuck { .. }
            | Self::Slip { .. }
            | Self::GraspLost { .. }
            | Self::Drop { .. }
            | Self::Pop { .. }
            | Self::Crush { .. }
            | Self::Collision { .. }
            | Self::Saturation { .. } => true,
            Self::Grasped { .. }
            | Self::Released { .. }
            | Self::LaidDown { .. }
            | Self::Landed { .. }
            | Self::Operator { .. } => false,
        }
    }

    /// Returns the event in words. `arms` are the names of the arms by index.
    #[must_use]
    pub fn words(&self, arms: &[&str]) -> String {
        let name = |arm: usize| arms.get(arm).copied().unwrap_or("?");
        let part = |part: Part| match part {
            Part::Finger(arm) => format!("{}'s finger", name(arm)),
            Part::Palm(arm) => format!("{}'s palm", name(arm)),
            Part::Hand(arm) => format!("{}'s hand", name(arm)),
            Part::Forearm(arm) => format!("{}'s forearm", name(arm)),
            Part::Cube => "the cube".to_owned(),
            Part::Table => "the table".to_owned(),
        };
        // People read this: mm and deg instead of SI units.
        match *self {
            Self::Grasped { arm } => format!("{} closes on the cube", name(arm)),
            Self::Released { arm } => format!("{} lets go of the cube", name(arm)),
            Self::Stuck { axis, angle, torque } => format!(
                "a layer about {axis:?} is {:.1} deg off a quarter turn under {torque:.2} Nm",
                angle.to_degrees()
            ),
            Self::Slip { arm, distance, angle } => format!(
                "the cube slips in {}'s grip by {:.1} mm and {:.1} deg",
                name(arm),
                distance * 1e3,
                angle.to_degrees()
            ),
            Self::GraspLost { arm } => format!("{} loses its grasp", name(arm)),
            Self::Drop { arm: Some(arm) } => format!("{} drops the cube", name(arm)),
            Self::Drop { arm: None } => "the cube falls".to_owned(),
            Self::LaidDown { arm, down } => {
                format!("{} lays the cube down, face {} below", name(arm), down.letter())
            }
            Self::Landed { down } => {
                format!("the cube comes to rest, face {} below", down.letter())
            }
            Self::Pop { tilt, pull } => format!("the cube pops under {tilt:.2} Nm and {pull:.0} N"),
            Self::Crush { arm, squeeze } => {
                format!("{} squeezes the cube with {squeeze:.0} N", name(arm))
            }
            Self::Collision { what, with, depth } => {
                format!("{} touches {}, {:.2} mm deep", part(what), part(with), depth * 1e3)
            }
            Self::Saturation { arm } => format!("{}'s wrist sensor leaves its range", name(arm)),
            Self::Operator { has_cube: true } => "the operator has the cube".to_owned(),
            Self::Operator { has_cube: false } => "the operator lets go of the cube".to_owned(),
        }
    }
}

/// Part of the cell that can collide.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Finger of an arm.
    Finger(usize),
    /// Palm plate and gripper's body of an arm.
    Palm(usize),
    /// Wrist and hand of an arm.
    Hand(usize),
    /// Forearm of an arm.
    Forearm(usize),
    /// The cube.
    Cube,
    /// Table top.
    Table,
}

impl Verdict {
    /// Checks whether the cube is at its final place: with the person, or laid down where no person
    /// is.
    #[must_use]
    pub fn is_back(&self) -> bool {
        self.returned
            || self.keeper == Keeper::Table
                && matches!(self.cube, Whereabouts::Tray { fell: false, .. })
    }

    /// Returns the cube's final place in words.
    #[must_use]
    pub fn place(&self) -> &'static str {
        match (self.keeper, self.is_back()) {
            (Keeper::Person, true) => "back in the operator's hand",
            (Keeper::Person, false) => "not with the operator",
            (Keeper::Table, true) => "on the table",
            (Keeper::Table, false) => "not laid on the table",
        }
    }

    /// Returns the events in order: the time of each (s), whether it is an accident, and its
    /// description. `arms` are the names of the arms, `period` is the length of a period (s).
    pub fn described_events(
        &self,
        arms: &[&str],
        period: f64,
    ) -> impl Iterator<Item = (f64, bool, String)> {
        self.events.iter().map(move |Event { period: at, what }| {
            (*at as f64 * period, what.is_accident(), what.words(arms))
        })
    }

    /// Returns the verdict at the start of a run.
    pub(super) fn empty(world_from_cube: &Pose, keeper: Keeper) -> Self {
        Self {
            period: 0,
            facelets: [0; 54],
            cube: Whereabouts::Hand,
            world_from_cube: *world_from_cube,
            returned: false,
            keeper,
            both_hold: false,
            turning: Axis::X,
            layer_angles: [0.0; 2],
            turned: 0.0,
            counts: Counts::default(),
            grasps: [0; MOST_ARMS],
            peak_force: 0.0,
            peak_torque: 0.0,
            arm_peak_force: [0.0; MOST_ARMS],
            arm_peak_torque: [0.0; MOST_ARMS],
            exertion: Exertion::default(),
            // A period must not allocate, so the list has its room from the start.
            events: Vec::with_capacity(MOST_EVENTS),
            objects: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incident_sentences_name_the_arms_involved() {
        let arms = ["left", "right"];
        let bump =
            Incident::Collision { what: Part::Finger(1), with: Part::Palm(0), depth: 2.5e-4 };

        assert!(bump.is_accident() && !Incident::Released { arm: 1 }.is_accident());
        assert_eq!(bump.words(&arms), "right's finger touches left's palm, 0.25 mm deep");
        assert_eq!(Incident::Drop { arm: Some(0) }.words(&arms), "left drops the cube");
    }
}
