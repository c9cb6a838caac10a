//! What is made to go wrong in the plant: a schedule of faults, each begun by the plant's time or by what happens in
//! it, and their effects on bodies and readings.
//!
//! - in: the plant's time and its own events; nothing of a controller or a task
//! - out: friction, grip, torque and pushes for the next period, spoilt readings, and which faults of others begin
//!   and end (cameras, lines: whoever owns those takes [`Plant::upsets`](super::Plant::upsets))
//! - nothing is drawn at random, and a plant without faults does what it did before there were any

use super::verdict::Incident;
use crate::motion::AXES;
use crate::servo::io::{ArmReading, JAW};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// One thing that goes wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// What.
    pub what: What,
    /// When it begins.
    pub when: When,
    /// How long it lasts (s); infinite for good. What happens at once (a jump, a drop) takes no
    /// notice.
    pub lasts: f64,
}

/// When a fault begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum When {
    /// At this time (s).
    At(f64),
    /// So long after something has happened in the plant for the n-th time, counted from 1.
    After {
        /// What.
        event: Trigger,
        /// Which time.
        nth: u32,
        /// How long after it (s).
        delay: f64,
    },
}

/// What happens in the plant; `None` is any arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Trigger {
    /// Jaws close on the cube.
    Grasped(Option<usize>),
    /// Jaws let go of it.
    Released(Option<usize>),
    /// A layer has begun to turn between two hands.
    TurnBegins,
    /// A layer has been turned by so much since two hands hold the cube (rad).
    Turned(f64),
    /// The cube falls.
    Dropped,
    /// It lies on the tray.
    Landed,
    /// The operator has let go of it.
    Given,
    /// The operator has taken it.
    Taken,
}

/// What goes wrong. Arms are given by index, axes as 0 the track, 1..=6, 7 the jaw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum What {
    /// A counter stands still.
    EncoderFreeze {
        /// Which arm.
        arm: usize,
        /// Which axis.
        axis: usize,
    },
    /// A counter is off by so much (rad of the motor).
    EncoderJump {
        /// Which arm.
        arm: usize,
        /// Which axis.
        axis: usize,
        /// By how much.
        by: f64,
    },
    /// A power stage reports over-current.
    OverCurrent {
        /// Which arm.
        arm: usize,
        /// Which axis.
        axis: usize,
        /// What it measures (A).
        amperes: f64,
    },
    /// A limit switch is pressed.
    LimitSwitch {
        /// Which arm.
        arm: usize,
        /// Which axis.
        axis: usize,
    },
    /// The force sensor is silent.
    ForceDropout {
        /// Which arm.
        arm: usize,
    },
    /// One component of the force is not a number.
    ForceNan {
        /// Which arm.
        arm: usize,
        /// 0..=5 in the sensor's frame.
        direction: usize,
    },
    /// One component is at the end of its range.
    ForceSaturation {
        /// Which arm.
        arm: usize,
        /// 0..=5 in the sensor's frame.
        direction: usize,
    },
    /// One component is off by so much (N, Nm).
    ForceBias {
        /// Which arm.
        arm: usize,
        /// 0..=5 in the sensor's frame.
        direction: usize,
        /// By how much.
        by: f64,
    },
    /// The pads of a hand hold with only this share of their friction, and as little against what turns between them.
    Slip {
        /// Which arm.
        arm: usize,
        /// Share of the friction that is left.
        friction: f64,
    },
    /// A hand holds nothing any more until its jaws have opened.
    Drop {
        /// Which arm.
        arm: usize,
    },
    /// Every layer needs so much more torque to turn (Nm).
    Jam {
        /// How much more.
        torque: f64,
    },
    /// The layer that has been turned slips back under the jaws to where it was, in so much time
    /// (s).
    TurnUndone {
        /// How long it takes.
        takes: f64,
    },
    /// Somebody pushes a hand, in the world (N).
    Push {
        /// Which arm.
        arm: usize,
        /// The force on its tool.
        force: Vector3<f64>,
    },
    /// The operator draws the cube back once more.
    Withdraw,
    /// Nothing of the plant's own: it only tells when.
    Elsewhere(usize),
}

/// A fault of others that begins or ends now: the number of its [`What::Elsewhere`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Upset {
    /// Which.
    pub which: usize,
    /// Begins, or is over.
    pub begins: bool,
}

/// A layer counts as turning from here on (rad).
const TURNING: f64 = 0.035;

/// A fault and how far it has come.
#[derive(Debug, Clone)]
struct Armed {
    fault: Fault,
    /// How often its event has happened.
    seen: u32,
    /// When it is to begin (s).
    due: Option<f64>,
    /// When it began, and whether it is over.
    began: Option<f64>,
    over: bool,
    /// What a frozen counter stands at.
    frozen: Option<i64>,
}

/// All faults of a plant.
#[derive(Debug, Clone)]
pub(super) struct Faults {
    armed: Vec<Armed>,
    upsets: Vec<Upset>,
    /// The layer's angle in the last period.
    turned: f64,
    /// What acts in the present period.
    pub(super) acting: Acting,
}

/// What faults do to the bodies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Acting {
    /// Factor of the friction of each hand's pads.
    pub(super) friction: [f64; 2],
    /// Hands that lose the cube now.
    pub(super) lost: [bool; 2],
    /// More torque that each layer needs (Nm).
    pub(super) torque: f64,
    /// Time in which a turned layer slips back (s).
    pub(super) undo: Option<f64>,
    /// Forces on the tools, in the world (N).
    pub(super) push: [Vector3<f64>; 2],
    /// The operator draws back now.
    pub(super) withdraw: bool,
}

impl Acting {
    const NONE: Self = Self {
        friction: [1.0; 2],
        lost: [false; 2],
        torque: 0.0,
        undo: None,
        push: [Vector3::new(0.0, 0.0, 0.0); 2],
        withdraw: false,
    };
}

impl Trigger {
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
            _ => false,
        }
    }
}

impl Armed {
    fn acts(&self) -> bool {
        self.began.is_some() && !self.over
    }

    /// Its event may have happened at `time`.
    fn happened(&mut self, time: f64, is: impl Fn(Trigger) -> bool) {
        if let When::After { event, nth, delay } = self.fault.when
            && self.due.is_none()
            && is(event)
        {
            self.seen += 1;
            if self.seen == nth.max(1) {
                self.due = Some(time + delay);
            }
        }
    }
}

impl Faults {
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
            upsets: Vec::with_capacity(2 * faults.len()),
            turned: 0.0,
            acting: Acting::NONE,
        }
    }

    /// Something has happened at `time` (s).
    pub(super) fn saw(&mut self, what: &Incident, time: f64) {
        for armed in &mut self.armed {
            armed.happened(time, |trigger| trigger.is(what));
        }
    }

    /// The period that ends at `time` is over; `turned` is the layer's angle between two hands
    /// (rad).
    pub(super) fn decide(&mut self, time: f64, turned: f64) {
        if self.armed.is_empty() {
            return;
        }
        let (before, now) = (self.turned.abs(), turned.abs());
        self.turned = turned;
        let passes = |angle: f64| before < angle && now >= angle;
        self.acting = Acting::NONE;
        for armed in &mut self.armed {
            armed.happened(time, |trigger| match trigger {
                Trigger::TurnBegins => passes(TURNING),
                Trigger::Turned(angle) => passes(angle.abs()),
                _ => false,
            });
            let begins = armed.began.is_none() && armed.due.is_some_and(|due| time >= due);
            if begins {
                armed.began = Some(time);
            }
            let ends =
                armed.acts() && armed.began.is_some_and(|began| time >= began + armed.fault.lasts);
            armed.over |= ends && !begins;
            if let What::Elsewhere(which) = armed.fault.what {
                if begins {
                    self.upsets.push(Upset { which, begins: true });
                }
                if ends && !begins {
                    self.upsets.push(Upset { which, begins: false });
                }
            }
            if armed.acts() {
                self.acting.add(&armed.fault.what, begins);
            }
        }
    }

    /// Numbers of the faults that have begun, in the order in which they were given.
    pub(super) fn begun(&self) -> impl Iterator<Item = usize> {
        (0..self.armed.len()).filter(|&i| self.armed[i].began.is_some())
    }

    /// What has begun and ended since the last call.
    pub(super) fn upsets(&mut self) -> impl Iterator<Item = Upset> {
        self.upsets.drain(..)
    }

    /// Spoils what an arm's hardware tells; `increments` are those of its axes, the jaw's last.
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
    fn add(&mut self, what: &What, begins: bool) {
        match *what {
            What::Slip { arm, friction } => self.friction[arm] *= friction,
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
                let stands = *self.frozen.get_or_insert(*count);
                *count = stands;
            }
            What::EncoderJump { arm, axis, by } if arm == of => {
                *counter(reading, axis) += (by * increments[axis.min(JAW)] / TAU).round() as i64;
            }
            What::OverCurrent { arm, axis, amperes } if arm == of => {
                reading.over_currents |= 1 << axis;
                reading.currents[axis.min(JAW)] = amperes;
            }
            What::LimitSwitch { arm, axis } if arm == of => reading.upper_limits |= 1 << axis,
            What::ForceDropout { arm } if arm == of => force(reading, &|c| *c = [f64::NAN; 6]),
            What::ForceNan { arm, direction } if arm == of => {
                force(reading, &|c| c[direction.min(5)] = f64::NAN);
            }
            What::ForceSaturation { arm, direction } if arm == of => {
                let i = direction.min(5);
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

fn counter(reading: &mut ArmReading, axis: usize) -> &mut i64 {
    if axis < AXES { &mut reading.counts[axis] } else { &mut reading.jaw_count }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FREEZE: What = What::EncoderFreeze { arm: 0, axis: 2 };

    fn read(faults: &mut Faults, count: i64) -> i64 {
        let mut reading = ArmReading::default();
        reading.counts[2] = count;
        faults.spoil(0, &mut reading, &[4000.0; AXES + 1], &[65.0; 6]);
        reading.counts[2]
    }

    #[test]
    fn a_counter_stands_from_its_time_on_and_as_long_as_it_should() {
        let mut faults = Faults::new(&[Fault { what: FREEZE, when: When::At(1.0), lasts: 0.5 }]);
        let mut seen = Vec::new();

        for i in 0..10 {
            seen.push(read(&mut faults, i));
            faults.decide(f64::from(i as i32) * 0.25, 0.0);
        }

        assert_eq!(seen, [0, 1, 2, 3, 4, 5, 5, 7, 8, 9]);
    }

    #[test]
    fn an_event_counts_to_the_nth_and_waits_for_its_delay() {
        let when = When::After { event: Trigger::Grasped(Some(1)), nth: 2, delay: 0.1 };
        let what = What::Elsewhere(7);
        let mut faults = Faults::new(&[Fault { what, when, lasts: f64::INFINITY }]);
        let mut begun = |events: &[usize], time: f64| {
            for arm in events {
                faults.saw(&Incident::Grasped { arm: *arm }, time);
            }
            faults.decide(time, 0.0);
            faults.upsets().count()
        };

        assert_eq!(begun(&[0, 1, 0], 1.0), 0);
        assert_eq!(begun(&[0], 2.0), 0);
        assert_eq!(begun(&[1], 3.0), 0, "the delay");
        assert_eq!(begun(&[1], 3.1), 1);
        assert_eq!(begun(&[1, 1], 3.2), 0, "once");
    }

    #[test]
    fn an_angle_is_passed_once_in_each_turn() {
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
