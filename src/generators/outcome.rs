//! The answer of a generator: the next command, or how the behaviour ended.

use crate::motion::{Motion, MoveCommand, MoveRefused};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::borrow::Borrow;

/// Answer of a generator.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// Command to execute before the generator is asked again.
    Go(MoveCommand),
    /// End of the behaviour.
    Done(Outcome),
}

/// End of a behaviour. A failed step of the task is an outcome, not an error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Outcome {
    /// The target is reached.
    Reached,
    /// The palm's stops touch the cube: after this distance (m), or in the visual servo with this
    /// distance left to the seat (m).
    Touched(f64),
    /// The whole distance is done without a contact.
    NotTouched,
    /// The jaws hold something of this width (m).
    Grasped(f64),
    /// The jaws have closed to this width without holding anything (m).
    Empty(f64),
    /// The cube is seated in the palm and the jaws are clenched.
    Secured,
    /// The face has been turned by this angle (rad).
    Turned(f64),
    /// The hand has turned by this angle (rad) against so small a torque (Nm) that the grip must
    /// have slipped on the face.
    Slipped(f64, f64),
    /// The wrench oscillates in this direction of the tool frame (0..=2 along x, y, z, 3..=5 about
    /// them), with this amplitude (N, Nm) and this frequency (Hz).
    Oscillates(usize, f64, f64),
    /// The turn has stopped at this angle (rad) under this torque (Nm).
    Stalled(f64, f64),
    /// A force (N) or torque (Nm) exceeds its limit, mostly in this direction (0..=5, as in
    /// [`Outcome::Oscillates`]).
    OverForce(usize, f64),
    /// The object in the jaws has forced them apart by this distance since the behaviour began (m):
    /// it turns between them.
    ForcedApart(f64),
    /// The jaws have closed to this width (m): they have lost what they held.
    Lost(f64),
    /// MP has ended the behaviour before its own end: the step of the task is over, the partner arm
    /// has reported an alarm, or the operator has terminated the run.
    Ended,
    /// The operator pulls at the cube.
    Pulled,
    /// The visual sensor has lost the cube for this long (s).
    LostSight(f64),
    /// The cube stayed outside the place of hand-over for this long (s).
    OutOfZone(f64),
    /// The arm cannot reach the place where the cube is held, for this reason.
    OutOfReach(MoveRefused),
    /// The behaviour took longer than allowed (s).
    TimedOut(f64),
    /// Result of a registered generator, in its own form: see [`Outcome::own`].
    Own(Value),
}

impl Next {
    /// Returns the command of a motion that lasts a macrostep and leaves the jaws as they are, for
    /// a registered generator: the macrostep is set by its caller.
    #[must_use]
    pub fn go(motion: Motion) -> Self {
        Self::Go(MoveCommand { motion, periods: 1, jaw: None })
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        const DIRECTIONS: [&str; 6] =
            ["along x", "along y", "along z", "about x", "about y", "about z"];
        match self {
            Self::Reached => f.write_str("the target is reached"),
            Self::Touched(way) => write!(f, "touched after {:.1} mm", way * 1e3),
            Self::NotTouched => f.write_str("nothing was touched on the way"),
            Self::Grasped(width) => write!(f, "the jaws hold {:.1} mm", width * 1e3),
            Self::Empty(width) => write!(f, "the jaws closed to {:.1} mm on nothing", width * 1e3),
            Self::Secured => f.write_str("the cube is seated"),
            Self::Turned(angle) => write!(f, "the face turned by {:.0} deg", angle.to_degrees()),
            Self::Stalled(angle, torque) => {
                write!(
                    f,
                    "the turn stalled after {:.0} deg under {torque:.1} Nm",
                    angle.to_degrees()
                )
            }
            Self::Slipped(angle, torque) => write!(
                f,
                "slip: the hand turned by {:.0} deg against {torque:.2} Nm only, \
                 so no face followed it",
                angle.to_degrees()
            ),
            Self::Oscillates(direction, size, hertz) => {
                let unit = if *direction < 3 { "N" } else { "Nm" };
                write!(
                    f,
                    "oscillation of {size:.1} {unit} at {hertz:.1} Hz {}",
                    DIRECTIONS[*direction.min(&5)]
                )
            }
            Self::OverForce(direction, size) => {
                let unit = if *direction < 3 { "N" } else { "Nm" };
                write!(
                    f,
                    "over-force of {size:.1} {unit}, most of it {}",
                    DIRECTIONS[*direction.min(&5)]
                )
            }
            Self::ForcedApart(way) => {
                write!(f, "slip: the cube has forced the jaws apart by {:.1} mm", way * 1e3)
            }
            Self::Lost(width) => {
                write!(f, "the jaws closed to {:.1} mm: they lost what they held", width * 1e3)
            }
            Self::Ended => f.write_str("MP ended the motion before its own end"),
            Self::Pulled => f.write_str("the operator pulls"),
            Self::LostSight(seconds) => write!(f, "the cube was out of sight for {seconds:.1} s"),
            Self::OutOfZone(seconds) => {
                write!(f, "the cube stayed outside the place of hand-over for {seconds:.1} s")
            }
            Self::OutOfReach(why) => write!(f, "the arm cannot reach the cube ({why})"),
            Self::TimedOut(seconds) => write!(f, "the motion did not end within {seconds:.1} s"),
            Self::Own(result) => write!(f, "the generator ended with {result}"),
        }
    }
}

impl Outcome {
    /// Makes the outcome of a registered generator from its result. A result without a form in JSON
    /// becomes the reason, as a text.
    #[must_use]
    pub fn own(result: &impl Serialize) -> Self {
        Self::Own(serde_json::to_value(result).unwrap_or_else(|why| why.to_string().into()))
    }

    /// Returns the result of a registered generator; `None` if the outcome is another one, or its
    /// result has another form.
    #[must_use]
    pub fn result<T: DeserializeOwned>(&self) -> Option<T> {
        let Self::Own(value) = self else { return None };
        T::deserialize(value).ok()
    }

    /// Returns whether this outcome of one arm ends the behaviour of the partner arm as well.
    #[must_use]
    pub fn alarms(&self) -> bool {
        matches!(
            self,
            Self::OverForce(..) | Self::Oscillates(..) | Self::ForcedApart(_) | Self::Lost(_)
        )
    }

    /// Returns an outcome in words, for the operator. `None` stands for a behaviour without an
    /// outcome.
    #[must_use]
    pub fn words(outcome: Option<impl Borrow<Self>>) -> String {
        let words = |outcome: &Self| outcome.to_string();
        outcome.map_or_else(|| "the motion did not end".to_owned(), |own| words(own.borrow()))
    }
}
