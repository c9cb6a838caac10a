//! Grasping: the jaws close while the arm adapts its position.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | set value below the held width | `SQUEEZE` | the force limit then determines the grip |
//! | set value below the least width | `BELOW` | the stroke of the jaws ends there |
//! | slow closing | within `NEAR` of the least width | a cube met at full speed is pushed |
//! | jaws at rest | `STAND` in `STILL` | they hold something, or have closed |
//! | jaws that neither hold nor close | 15 s | each behaviour must end |
//!
//! - in: jaw opening and jaw force, wrench
//! - out: set values that close the jaws at two speeds, the slow one where the cube may be, and
//!   directions that seek zero force
//! - source: Zieliński et al. (2007), p. 374; the 2008 sources close by 0.05 mm in 16 ms

use super::compliance::{Compliance, Selector};
use super::inputs::Inputs;
use super::outcome::{Next, Outcome};
use crate::motion::{ArmState, Depth, JawCommand, PERIOD};

/// Distance of the jaw's set value below the width that is held, so that the force limit determines
/// the grip (m).
pub(super) const SQUEEZE: f64 = 0.002;
/// Largest distance of the set value below the least width, where the stroke of the jaws ends (m).
const BELOW: f64 = 0.001;
/// Distance above the least width within which jaws close slowly (m): 3 mm up to the width of a
/// cube, and 5 mm for a cube that is not in the middle between them. At full speed v the jaws would
/// push a cube with the force v / (2 admittance) until the arm follows.
const NEAR: f64 = 0.008;
/// Largest motion of jaws at rest in [`STILL`] seconds (m).
const STAND: f64 = 0.0001;
const STILL: f64 = 0.15;
/// Part of [`NEAR`] below the width of a cube (m).
const NARROWER: f64 = 0.003;
/// Time in which the grip builds up, as measured in the plant (s).
const BUILD_UP: f64 = 0.15;

/// Returns the time that jaws take to close on a cube (s). At first their opening exceeds the width
/// of the cube by `stroke` (m); `slow` is their speed near the cube, and `fast` their speed before
/// (m/s).
#[must_use]
pub fn closing_seconds(stroke: f64, slow: f64, fast: f64) -> f64 {
    let near = stroke.min(NEAR - NARROWER);
    (stroke - near) / fast.max(slow) + near / slow + BUILD_UP + STILL
}

/// Kind of motion of the jaws.
#[derive(Debug, Clone, Copy)]
enum Mode {
    /// Closing with a grip force (N) until something of at least the least width (m) is held.
    Close { force: f64, least_width: f64, stops: Depth },
    /// Motion to a set opening in at least `seconds`; `strained` motions ignore the force limits.
    Open { jaw: JawCommand, seconds: f64, strained: bool },
}

/// Memory of a grasp.
#[derive(Debug, Clone)]
pub struct Grasp {
    mode: Mode,
    selector: Selector,
    compliance: Compliance,
    /// Number of macrosteps since the beginning.
    steps: u32,
    /// Last set distance between the pads while closing (m).
    set: f64,
    /// Set distance between the pads at the beginning of an opening (m).
    start: f64,
    /// Macrostep since which the jaws have been at rest, and the distance of the pads then (m).
    still_since: u32,
    still_at: f64,
}

impl Grasp {
    /// Makes a grasp that closes the jaws with the grip force `force` (N) until they hold an
    /// object, at least `least_width` wide (m). The directions of `selector` yield, and the stops
    /// of the palm are at `stops`.
    #[must_use]
    pub fn new(
        force: f64,
        least_width: f64,
        selector: Selector,
        stops: Depth,
        compliance: Compliance,
    ) -> Self {
        Self::with(Mode::Close { force, least_width, stops }, selector, compliance)
    }

    /// Makes a motion of the jaws alone to their set values `jaw`, in `seconds` or longer if the
    /// jaws need it. With `strained` the motion goes on under a wrench beyond the limits.
    #[must_use]
    pub fn jaw_only(
        jaw: JawCommand,
        seconds: f64,
        selector: Selector,
        strained: bool,
        compliance: Compliance,
    ) -> Self {
        Self::with(Mode::Open { jaw, seconds, strained }, selector, compliance)
    }

    /// Makes a generator that has not begun its motion.
    fn with(mode: Mode, selector: Selector, compliance: Compliance) -> Self {
        Self {
            mode,
            selector,
            compliance,
            steps: 0,
            set: 0.0,
            start: 0.0,
            still_since: 0,
            still_at: 0.0,
        }
    }

    /// Makes the next macrosteps follow another compliance.
    pub(super) fn tune(&mut self, compliance: Compliance) {
        self.compliance = compliance;
    }

    /// Returns the command of the next macrostep, or how the grasp ended (see
    /// [`super::Generator::next`]).
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        let arm = inputs.arm;
        if self.steps == 0 {
            // Opening starts from the set value, since a held object keeps the jaws wider than
            // that. Closing starts from the measured width.
            self.start = arm.desired_jaw_opening;
            self.set = arm.jaw_opening;
            self.still_at = arm.jaw_opening;
        }
        self.steps += 1;
        // Opening under strain is what relieves it.
        let tolerated = matches!(self.mode, Mode::Open { strained: true, .. });
        if let Some(excess) = self.compliance.excess(arm).filter(|_| !tolerated) {
            return Next::Done(excess);
        }
        match self.mode {
            Mode::Open { jaw, seconds, .. } => self.open(jaw, seconds),
            Mode::Close { force, least_width, stops } => self.close(arm, force, least_width, stops),
        }
    }

    /// Returns the length of a macrostep (s).
    fn macrostep_seconds(&self) -> f64 {
        f64::from(self.compliance.macrostep) * PERIOD
    }

    /// Returns the next command of a motion to the set values `jaw` in at least `seconds`, or the
    /// outcome at its end.
    fn open(&mut self, jaw: JawCommand, seconds: f64) -> Next {
        let step = self.macrostep_seconds();
        let way = (jaw.opening - self.start).abs();
        // The opening is linear in time, and no faster than the jaws can follow.
        let seconds = seconds.max(way / self.compliance.jaw_open_speed);
        let share = f64::from(self.steps) * step / seconds;
        // One more macrostep, so that the jaws reach their set value before the behaviour ends.
        if share >= 1.0 + step / seconds {
            return Next::Done(Outcome::Reached);
        }
        let opening = self.start + share.min(1.0) * (jaw.opening - self.start);
        self.command(JawCommand { opening, ..jaw })
    }

    /// Returns the next command of jaws that close with the grip force `force` (N), or the outcome
    /// once they are at rest: whether they hold something of at least `least_width` (m).
    fn close(&mut self, arm: &ArmState, force: f64, least_width: f64, stops: Depth) -> Next {
        let step = self.macrostep_seconds();
        // Rest is measured from the last motion, so that slow creeping does not count as rest.
        if (arm.jaw_opening - self.still_at).abs() > STAND {
            self.still_at = arm.jaw_opening;
            self.still_since = self.steps;
        }
        let standing = f64::from(self.steps - self.still_since) * step > STILL;
        // Jaws that close on nothing do not have to reach the end of their stroke to detect it.
        let floor = least_width - BELOW;
        let squeezing = self.set <= floor.max(arm.jaw_opening - SQUEEZE) + 1e-9;
        if standing && squeezing {
            return Next::Done(if arm.jaw_opening >= least_width {
                Outcome::Grasped(arm.jaw_opening)
            } else {
                Outcome::Empty(arm.jaw_opening)
            });
        }
        if f64::from(self.steps) * step > 15.0 {
            return Next::Done(Outcome::TimedOut(15.0));
        }
        // The set value follows the measured width down, but no farther than needed to squeeze.
        let lowest = floor.max(arm.jaw_opening - SQUEEZE);
        let near = least_width + NEAR;
        let (slow, fast) = (self.compliance.jaw_close_speed, self.compliance.jaw_reach_speed);
        // The set value falls by a fast step, but near the cube by no more than a slow one.
        let next = (self.set - slow * step).min((self.set - fast * step).max(near));
        // The set value never rises: otherwise an object that pushes the jaws open would lead them.
        self.set = self.set.min(next.max(lowest));
        self.command(JawCommand { opening: self.set, force_limit: force, stops })
    }

    /// Returns the command that moves the jaws while the selected directions yield.
    fn command(&self, jaw: JawCommand) -> Next {
        Next::Go(self.compliance.task(self.compliance.yielding(&self.selector), Some(jaw)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::compliance;
    use super::*;
    use crate::motion::{Motion, MoveCommand};

    /// Least width of a cube between the jaws (m).
    const LEAST: f64 = 0.055;
    /// Width of the cube in these tests (m).
    const CUBE: f64 = 0.0568;

    /// Closes jaws that follow their set value down to `stop` (m). Returns the outcome and the
    /// lowest set value.
    fn close(stop: f64) -> (Outcome, f64) {
        let mut grasp = Grasp::new(30.0, LEAST, [true; 6], Depth::One, compliance());
        let mut arm = ArmState { jaw_opening: 0.07, ..ArmState::default() };
        let mut lowest = f64::INFINITY;
        for period in (0..20_000).step_by(8) {
            match grasp.next(&Inputs { arm: &arm, target: None, reading: None, period, pace: 1.0 })
            {
                Next::Done(outcome) => return (outcome, lowest),
                Next::Go(MoveCommand { motion: Motion::Task { .. }, jaw: Some(jaw), .. }) => {
                    lowest = lowest.min(jaw.opening);
                    arm.jaw_opening = jaw.opening.max(stop);
                }
                Next::Go(other) => panic!("{other:?}"),
            }
        }
        panic!("the grasp never ends")
    }

    #[test]
    fn empty_jaws_stay_within_their_stroke() {
        let (outcome, lowest) = close(0.0);

        assert!(matches!(outcome, Outcome::Empty(_)), "{outcome:?}");
        assert!(lowest >= LEAST - BELOW - 1e-12, "{lowest}");
    }

    #[test]
    fn jaws_close_slowly_only_near_the_cube() {
        let (slow, fast) = (0.012, 0.04);
        let compliance = Compliance { jaw_reach_speed: fast, ..compliance() };
        let mut grasp = Grasp::new(30.0, LEAST, [true; 6], Depth::One, compliance);
        let mut arm = ArmState { jaw_opening: 0.07, ..ArmState::default() };
        let (step, near) = (8.0 * PERIOD, LEAST + NEAR);
        let (mut last, mut fastest) = (arm.jaw_opening, 0.0_f64);
        for period in (0..400).step_by(8) {
            let next =
                grasp.next(&Inputs { arm: &arm, target: None, reading: None, period, pace: 1.0 });
            let Next::Go(MoveCommand { jaw: Some(jaw), .. }) = next else { break };
            let speed = (last - jaw.opening) / step;
            assert!(speed <= if last > near { fast } else { slow } + 1e-9, "{speed} at {last}");
            assert!(
                jaw.opening >= near - slow * step || last <= near,
                "{} from {last}",
                jaw.opening
            );
            fastest = fastest.max(speed);
            (last, arm.jaw_opening) = (jaw.opening, jaw.opening);
        }
        assert!((fastest - fast).abs() < 1e-9 && last < near - 1e-3, "{fastest}, {last}");
    }

    /// The set value never rises while the jaws close.
    #[test]
    fn pushed_jaws_are_not_ordered_to_open() {
        let mut grasp = Grasp::new(30.0, LEAST, [true; 6], Depth::One, compliance());
        let mut set = f64::INFINITY;
        for (step, pushed) in [0.0, 0.0, 0.0, 0.001, 0.002, 0.001].into_iter().enumerate() {
            let arm = ArmState { jaw_opening: CUBE + pushed, ..ArmState::default() };
            let period = 8 * step as u64;
            let next =
                grasp.next(&Inputs { arm: &arm, target: None, reading: None, period, pace: 1.0 });
            let Next::Go(MoveCommand { jaw: Some(jaw), .. }) = next else { panic!("{next:?}") };
            assert!(jaw.opening <= set, "{} after {set}", jaw.opening);
            set = jaw.opening;
        }
    }

    /// A force of 60 N ends a motion of the jaws, except a strained opening, which is to relieve
    /// this force.
    #[test]
    fn jaw_opening_that_relieves_strain_ignores_force_limit() {
        let wrench_in_tool =
            crate::spatial::Wrench::from_directions([0.0, 60.0, 0.0, 0.0, 0.0, 0.0]);
        let arm = ArmState {
            jaw_opening: 0.057,
            desired_jaw_opening: 0.055,
            wrench_in_tool,
            ..ArmState::default()
        };
        let jaw = JawCommand { opening: 0.09, force_limit: 40.0, stops: Depth::One };
        let opened = |strained: bool| {
            let mut grasp = Grasp::jaw_only(jaw, 1.0, [true; 6], strained, compliance());
            let mut set = arm.desired_jaw_opening;
            let mut first = None;
            loop {
                match grasp.next(&Inputs {
                    arm: &arm,
                    target: None,
                    reading: None,
                    period: 0,
                    pace: 1.0,
                }) {
                    Next::Go(command) => {
                        set = command.jaw.unwrap().opening;
                        assert!(*first.get_or_insert(set) < arm.jaw_opening, "the set value jumps");
                    }
                    Next::Done(outcome) => return (outcome, set),
                }
            }
        };

        assert_eq!(opened(true), (Outcome::Reached, 0.09));
        assert_eq!(opened(false), (Outcome::OverForce(1, 60.0), 0.055));
    }

    #[test]
    fn commanded_jaw_opening_ends_below_cube_width() {
        let (outcome, lowest) = close(CUBE);

        assert_eq!(outcome, Outcome::Grasped(CUBE));
        assert!((lowest - (CUBE - SQUEEZE)).abs() < 1e-4, "{lowest}");
    }
}
