//! Faults of the plant: a schedule of faults, each begun by the plant's time or by an event in the
//! plant, and their effects on bodies and readings.
//!
//! - in: the plant's time and its own events, but no controller or task
//! - out: friction, grip, torque and pushes for the next period, spoilt readings, and start and end
//!   of faults outside of the plant (cameras, lines), which their owners take from
//!   [`Plant::outside_faults`](super::Plant::outside_faults)
//! - there is no random draw, and a plant without faults behaves as if this module did not exist

use super::verdict::Incident;
use crate::cell::{MOST_ARMS, PerArm};
use crate::motion::AXES;
use crate::servo::io::{ArmReading, JAW};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// One fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// Kind of the fault.
    pub what: What,
    /// Start of the fault.
    pub when: When,
    /// Duration (s); infinite for a fault that does not end. A drop and a withdrawal happen at once
    /// and have none.
    pub lasts: f64,
}

/// Start of a fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum When {
    /// At this time (s).
    At(f64),
    /// After an event of the plant has happened for the n-th time, counted from 1.
    After {
        /// Event.
        event: Trigger,
        /// Number of the event.
        nth: u32,
        /// Delay after it (s).
        delay: f64,
    },
}

/// Event in the plant that may begin a fault. `Some` is the index of an arm, `None` any arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Trigger {
    /// Jaws close on the cube.
    Grasped(Option<usize>),
    /// Jaws let go of the cube.
    Released(Option<usize>),
    /// A layer has begun to turn between two hands.
    TurnBegins,
    /// A layer has been turned by this angle (rad) since two hands hold the cube.
    Turned(f64),
    /// The cube falls.
    Dropped,
    /// The cube lies on the tray.
    Landed,
    /// The operator has let go of the cube.
    Given,
    /// The operator has taken the cube.
    Taken,
}

/// Kind of a fault. Arms are given by index, axes as 0 the track, 1..=6, 7 the jaw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum What {
    /// A counter does not change any more.
    EncoderFreeze {
        /// Index of the arm.
        arm: usize,
        /// Number of the axis.
        axis: usize,
    },
    /// A counter is off by a constant while the fault lasts.
    EncoderJump {
        /// Index of the arm.
        arm: usize,
        /// Number of the axis.
        axis: usize,
        /// Offset of the counter (rad of the motor).
        by: f64,
    },
    /// A power stage reports over-current.
    OverCurrent {
        /// Index of the arm.
        arm: usize,
        /// Number of the axis.
        axis: usize,
        /// Current that the power stage reports (A).
        amperes: f64,
    },
    /// The upper limit switch of an axis is pressed.
    LimitSwitch {
        /// Index of the arm.
        arm: usize,
        /// Number of the axis.
        axis: usize,
    },
    /// A binary input of the parallel interface is set.
    Input {
        /// Index of the arm.
        arm: usize,
        /// Number of the input, 0..=15.
        bit: u32,
    },
    /// The force sensor is silent: none of its components is a number.
    ForceDropout {
        /// Index of the arm.
        arm: usize,
    },
    /// One component of the measured wrench is not a number.
    ForceNan {
        /// Index of the arm.
        arm: usize,
        /// Component 0..=5 in the sensor's frame.
        direction: usize,
    },
    /// One component of the measured wrench is at the end of its range, with the sign of its true
    /// value.
    ForceSaturation {
        /// Index of the arm.
        arm: usize,
        /// Component 0..=5 in the sensor's frame.
        direction: usize,
    },
    /// One component of the measured wrench is off by a constant.
    ForceBias {
        /// Index of the arm.
        arm: usize,
        /// Component 0..=5 in the sensor's frame.
        direction: usize,
        /// Offset (N, Nm).
        by: f64,
    },
    /// The pads of a hand have only a share of their friction, and of the torque with which they
    /// turn a tilted cube back.
    Slip {
        /// Index of the arm.
        arm: usize,
        /// Share that is left.
        friction: f64,
    },
    /// A hand holds nothing until its jaws have opened.
    Drop {
        /// Index of the arm.
        arm: usize,
    },
    /// Each layer needs more torque to turn.
    Jam {
        /// Additional torque (Nm).
        torque: f64,
    },
    /// The layer that has been turned slips back under the jaws to its old place.
    TurnUndone {
        /// Time for a quarter turn (s).
        takes: f64,
    },
    /// A force pushes a hand.
    Push {
        /// Index of the arm.
        arm: usize,
        /// Force on the tool, in the world (N).
        force: Vector3<f64>,
    },
    /// The operator withdraws the cube once more.
    Withdraw,
    /// A fault outside of the plant, by its number: the plant only reports its start and end.
    Elsewhere(usize),
}

/// Start or end of a fault outside of the plant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OutsideFault {
    /// Number of its [`What::Elsewhere`].
    pub which: usize,
    /// Whether the fault begins; otherwise it ends.
    pub begins: bool,
}

/// Angle from which on a layer counts as turning (rad).
pub(super) const TURNING: f64 = 0.035;

/// A fault and its progress.
#[derive(Debug, Clone)]
struct Armed {
    fault: Fault,
    /// Number of times that its event has happened.
    seen: u32,
    /// Time at which it is to begin (s).
    due: Option<f64>,
    /// Time at which it began (s).
    began: Option<f64>,
    /// Whether it has ended.
    over: bool,
    /// Count at which the fault froze a counter.
    frozen: Option<i64>,
}

/// All faults of a plant.
#[derive(Debug, Clone)]
pub(super) struct Faults {
    armed: Vec<Armed>,
    /// Starts and ends, not yet taken, of faults outside of the plant.
    outside: Vec<OutsideFault>,
    /// Angle of the layer in the last period (rad).
    turned: f64,
    /// Effects of the present period.
    pub(super) acting: Acting,
}

/// Effects of faults on the bodies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Acting {
    /// Factor of the friction of each hand's pads.
    pub(super) friction: PerArm<f64>,
    /// Whether each hand loses the cube now.
    pub(super) lost: PerArm<bool>,
    /// Additional torque that each layer needs (Nm).
    pub(super) torque: f64,
    /// Time in which a turned layer slips back by a quarter (s).
    pub(super) undo: Option<f64>,
    /// Forces on the tools, in the world (N).
    pub(super) push: PerArm<Vector3<f64>>,
    /// Whether the operator withdraws the cube now.
    pub(super) withdraw: bool,
}

impl Acting {
    const NONE: Self = Self {
        friction: [1.0; MOST_ARMS],
        lost: [false; MOST_ARMS],
        torque: 0.0,
        undo: None,
        push: [Vector3::new(0.0, 0.0, 0.0); MOST_ARMS],
        withdraw: false,
    };
}

impl Trigger {
    /// Checks whether the incident `what` is this event. Turns of a layer are no incidents and
    /// never match.
    fn is(self, what: &Incident) -> bool {
        let fits = |wanted: Option<usize>, arm: usize| wanted.is_none_or(|w| w == arm);
        match (self, what) {
            (Self::Grasped(wanted), Incident::Grasped { arm })
            | (Self::Released(wanted), Incident::Released { arm }) => fits(wanted, *arm),
            (Self::Dropped, Incident::Drop { .. }) | (Self::Landed, Incident::Landed { .. }) => {
                true
            }
            (Self::Given, Incident::Operator { has_cube }) => !has_cube,
            (Self::Taken, Incident::Operator { has_cube }) => *has_cube,
            // A turn is no incident: `decide` measures its angle.
            _ => false,
        }
    }
}

impl Armed {
    /// Checks whether the fault has begun and is not over.
    fn acts(&self) -> bool {
        self.began.is_some() && !self.over
    }

    /// Counts an event at `time` (s) if `is` accepts the trigger of this fault. The `nth` such
    /// event sets the time at which the fault begins.
    fn happened(&mut self, time: f64, is: impl Fn(Trigger) -> bool) {
        if let When::After { event, nth, delay } = self.fault.when
            && self.due.is_none()
            && is(event)
        {
            self.seen += 1;
            if self.seen == nth.max(1) {
                // A fault begins once, so later events do not count.
                self.due = Some(time + delay);
            }
        }
    }
}

impl Faults {
    /// Makes a schedule of these faults, of which none has begun.
    pub(super) fn new(faults: &[Fault]) -> Self {
        let armed = |fault: &Fault| Armed {
            fault: *fault,
            seen: 0,
            due: match fault.when {
                When::At(time) => Some(time),
                When::After { .. } => None,
            },
            began: None,
            over: false,
            frozen: None,
        };
        Self {
            armed: faults.iter().map(armed).collect(),
            outside: Vec::with_capacity(2 * faults.len()),
            turned: 0.0,
            acting: Acting::NONE,
        }
    }

    /// Passes an event at `time` (s) to the faults that wait for it.
    pub(super) fn pass_event(&mut self, what: &Incident, time: f64) {
        for armed in &mut self.armed {
            armed.happened(time, |trigger| trigger.is(what));
        }
    }

    /// Begins and ends faults for the period after `time` (s). `turned` is the angle by which a
    /// layer has been turned since two hands hold the cube (rad).
    pub(super) fn decide(&mut self, time: f64, turned: f64) {
        if self.armed.is_empty() {
            return;
        }
        let (before, now) = (self.turned.abs(), turned.abs());
        self.turned = turned;
        // An angle is passed once a turn, in either sense of rotation.
        let passes = |angle: f64| before < angle && now >= angle;
        self.acting = Acting::NONE;
        for armed in &mut self.armed {
            armed.happened(time, |trigger| match trigger {
                Trigger::TurnBegins => passes(TURNING),
                Trigger::Turned(angle) => passes(angle.abs()),
                _ => false,
            });
            // An event without a delay begins its fault in the same period. A fault acts for one
            // period at least.
            let begins = armed.began.is_none() && armed.due.is_some_and(|due| time >= due);
            if begins {
                armed.began = Some(time);
            }
            let ends =
                armed.acts() && armed.began.is_some_and(|began| time >= began + armed.fault.lasts);
            armed.over |= ends && !begins;
            // The plant has no effect for these: their owners apply them.
            if let What::Elsewhere(which) = armed.fault.what {
                if begins {
                    self.outside.push(OutsideFault { which, begins: true });
                }
                if ends && !begins {
                    self.outside.push(OutsideFault { which, begins: false });
                }
            }
            if armed.acts() {
                self.acting.add(&armed.fault.what, begins);
            }
        }
    }

    /// Returns the indices, in the configured list, of the faults that have begun.
    pub(super) fn begun(&self) -> impl Iterator<Item = usize> {
        (0..self.armed.len()).filter(|&i| self.armed[i].began.is_some())
    }

    /// Returns the starts and ends, since the last call, of faults that act outside of the plant,
    /// for instance on a camera.
    pub(super) fn outside_faults(&mut self) -> impl Iterator<Item = OutsideFault> {
        self.outside.drain(..)
    }

    /// Changes an arm's reading as the acting faults demand: counters, switches, currents, forces.
    /// `increments` are those of the encoders per revolution, the jaw's last; `range` are the
    /// limits of the force sensor (N, Nm).
    pub(super) fn spoil(
        &mut self,
        arm: usize,
        reading: &mut ArmReading,
        increments: &[f64; AXES + 1],
        range: &[f64; 6],
    ) {
        for armed in &mut self.armed {
            if armed.acts() {
                armed.spoil(arm, reading, increments, range);
            }
        }
    }
}

impl Acting {
    /// Adds the effect of an acting fault on the bodies. `begins` is whether this is the first
    /// period of the fault. Faults of readings and outside of the plant have no effect here.
    fn add(&mut self, what: &What, begins: bool) {
        match *what {
            // Several faults at a time multiply or add their effects.
            What::Slip { arm, friction } => self.friction[arm] *= friction,
            // A drop and a withdrawal happen once, in their first period.
            What::Drop { arm } => self.lost[arm] |= begins,
            What::Jam { torque } => self.torque += torque,
            What::TurnUndone { takes } => self.undo = Some(takes),
            What::Push { arm, force } => self.push[arm] += force,
            What::Withdraw => self.withdraw |= begins,
            _ => {}
        }
    }
}

impl Armed {
    /// Changes the reading of the arm `of` as this fault demands, if the fault is one of that arm's
    /// readings. `increments` and `range` are as in [`Faults::spoil`].
    fn spoil(
        &mut self,
        of: usize,
        reading: &mut ArmReading,
        increments: &[f64; AXES + 1],
        range: &[f64; 6],
    ) {
        let force = |reading: &mut ArmReading, change: &dyn Fn(&mut [f64; 6])| {
            let mut components = reading.wrench_on_sensor.directions();
            change(&mut components);
            reading.wrench_on_sensor = crate::spatial::Wrench::from_directions(components);
        };
        match self.fault.what {
            What::EncoderFreeze { arm, axis } if arm == of => {
                let count = counter(reading, axis);
                // The counter freezes at its first reading under the fault.
                let kept = *self.frozen.get_or_insert(*count);
                *count = kept;
            }
            What::EncoderJump { arm, axis, by } if arm == of => {
                // The offset is the same in each reading: a jump at the start of the fault.
                *counter(reading, axis) += (by * increments[axis.min(JAW)] / TAU).round() as i64;
            }
            What::OverCurrent { arm, axis, amperes } if arm == of => {
                reading.over_currents |= 1 << axis;
                reading.currents[axis.min(JAW)] = amperes;
            }
            What::LimitSwitch { arm, axis } if arm == of => reading.upper_limits |= 1 << axis,
            What::Input { arm, bit } if arm == of => reading.inputs |= 1 << bit.min(15),
            What::ForceDropout { arm } if arm == of => force(reading, &|c| *c = [f64::NAN; 6]),
            What::ForceNan { arm, direction } if arm == of => {
                force(reading, &|c| c[direction.min(5)] = f64::NAN);
            }
            What::ForceSaturation { arm, direction } if arm == of => {
                let i = direction.min(5);
                // The true sign remains.
                force(reading, &|c| c[i] = range[i].copysign(c[i]));
            }
            What::ForceBias { arm, direction, by } if arm == of => {
                let i = direction.min(5);
                force(reading, &|c| c[i] = (c[i] + by).clamp(-range[i], range[i]));
            }
            _ => {}
        }
    }
}

/// Returns the counter of an axis in a reading; the axis after the last one of the arm is the jaw.
fn counter(reading: &mut ArmReading, axis: usize) -> &mut i64 {
    if axis < AXES { &mut reading.counts[axis] } else { &mut reading.jaw_count }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fault that freezes the counter which [`read`] returns.
    const FREEZE: What = What::EncoderFreeze { arm: 0, axis: 2 };

    /// Returns the count of axis 2 that arm 0 reports under the faults when the true one is
    /// `count`.
    fn read(faults: &mut Faults, count: i64) -> i64 {
        let mut reading = ArmReading::default();
        reading.counts[2] = count;
        let (increments, range) = ([4000.0; AXES + 1], [65.0; 6]);
        faults.spoil(0, &mut reading, &increments, &range);
        reading.counts[2]
    }

    #[test]
    fn counter_freezes_for_duration_of_fault() {
        let mut faults = Faults::new(&[Fault { what: FREEZE, when: When::At(1.0), lasts: 0.5 }]);
        let mut seen = Vec::new();

        for i in 0..10 {
            seen.push(read(&mut faults, i));
            faults.decide(f64::from(i as i32) * 0.25, 0.0);
        }

        assert_eq!(seen, [0, 1, 2, 3, 4, 5, 5, 7, 8, 9]);
    }

    #[test]
    fn fault_begins_after_nth_event_and_delay() {
        let when = When::After { event: Trigger::Grasped(Some(1)), nth: 2, delay: 0.1 };
        // A fault that only reports its start; 7 is any number.
        let what = What::Elsewhere(7);
        let mut faults = Faults::new(&[Fault { what, when, lasts: f64::INFINITY }]);
        // Passes grasps of these arms at a time (s), and returns the number of faults that begin.
        let mut begun = |events: &[usize], time: f64| {
            for arm in events {
                faults.pass_event(&Incident::Grasped { arm: *arm }, time);
            }
            faults.decide(time, 0.0);
            faults.outside_faults().count()
        };

        assert_eq!(begun(&[0, 1, 0], 1.0), 0);
        assert_eq!(begun(&[0], 2.0), 0);
        assert_eq!(begun(&[1], 3.0), 0, "the delay has not passed");
        assert_eq!(begun(&[1], 3.1), 1);
        assert_eq!(begun(&[1, 1], 3.2), 0, "a fault begins only once");
    }

    #[test]
    fn angle_trigger_fires_once_in_each_turn() {
        let when = When::After { event: Trigger::Turned(0.5), nth: 2, delay: 0.0 };
        let jam = Fault { what: What::Jam { torque: 3.0 }, when, lasts: 1.0 };
        let mut faults = Faults::new(&[jam]);
        let mut torque = |time: f64, turned: f64| {
            faults.decide(time, turned);
            faults.acting.torque
        };

        assert_eq!([torque(0.1, -0.4), torque(0.2, -0.6), torque(0.3, -0.7)], [0.0; 3]);
        assert_eq!([torque(0.4, 0.0), torque(0.5, 0.6), torque(1.6, 0.9)], [0.0, 3.0, 0.0]);
    }
}
