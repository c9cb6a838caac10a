//! Grasping: the jaws close while the arm accommodates its position.
//!
//! - in: jaw opening and jaw force, wrench
//! - out: jaw set values that close at two speeds, the slow one where the cube may be, and
//!   directions that seek zero force
//! - source: Zieliński et al. (2007), p. 374; the 2008 sources close by 0.05 mm in 16 ms

use super::compliance::{Compliance, Selector};
use super::inputs::Inputs;
use super::outcome::{Next, Outcome};
use crate::motion::{ArmState, Depth, JawCommand, PERIOD};

/// How far below the width that is held the jaw's set value goes, so that the grip rules (m).
pub(super) const SQUEEZE: f64 = 0.002;
/// How far below the least width it goes at the lowest: the jaws' stroke ends there (m).
const BELOW: f64 = 0.001;
/// Jaws are near the cube when they are wider than the least width by less (m): 3 mm to the width
/// of a cube, and 5 mm for one that stands off the middle. Met at full speed a cube is pushed with
/// half of the speed over the admittance.
const NEAR: f64 = 0.008;
/// The jaws count as standing when they move less than this in [`STILL`] seconds (m).
const STAND: f64 = 0.0001;
const STILL: f64 = 0.15;
/// Room for cubes that are narrower than their edge says, in [`NEAR`] (m).
const NARROWER: f64 = 0.003;
/// The grip builds up in this time, as measured in the plant (s).
const BUILD_UP: f64 = 0.13;

/// Returns how long jaws take to close on a cube that they are wider than by `stroke` (m), at their
/// speeds near the cube and before (m/s): seconds.
#[must_use]
pub fn closing_seconds(stroke: f64, slow: f64, fast: f64) -> f64 {
    let near = stroke.min(NEAR - NARROWER);
    (stroke - near) / fast.max(slow) + near / slow + BUILD_UP + STILL
}

#[derive(Debug, Clone, Copy)]
enum Mode {
    /// Closes until something is held.
    Close { force: f64, least_width: f64, stops: Depth },
    /// Goes to a set opening.
    Open { jaw: JawCommand, seconds: f64, strained: bool },
}

/// Memory of a grasp.
#[derive(Debug, Clone)]
pub struct Grasp {
    mode: Mode,
    selector: Selector,
    compliance: Compliance,
    steps: u32,
    set: f64,
    start: f64,
    still_since: u32,
    still_at: f64,
}

impl Grasp {
    /// Closes on whatever is between the pads.
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

    /// Goes to a set opening in a set time, or as long as the jaws need; where `strained`, under whatever wrench.
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

    /// See [`super::Generator::next`].
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        let arm = inputs.arm;
        if self.steps == 0 {
            // What they hold keeps jaws wider than they are told to be.
            self.start = arm.desired_jaw_opening;
            self.set = arm.jaw_opening;
            self.still_at = arm.jaw_opening;
        }
        self.steps += 1;
        let borne = matches!(self.mode, Mode::Open { strained: true, .. });
        if let Some(excess) = self.compliance.excess(arm).filter(|_| !borne) {
            return Next::Done(excess);
        }
        match self.mode {
            Mode::Open { jaw, seconds, .. } => self.open(jaw, seconds),
            Mode::Close { force, least_width, stops } => self.close(arm, force, least_width, stops),
        }
    }

    fn macrostep_seconds(&self) -> f64 {
        f64::from(self.compliance.macrostep) * PERIOD
    }

    fn open(&mut self, jaw: JawCommand, seconds: f64) -> Next {
        let step = self.macrostep_seconds();
        let way = (jaw.opening - self.start).abs();
        let seconds = seconds.max(way / self.compliance.jaw_open_speed);
        let share = f64::from(self.steps) * step / seconds;
        if share >= 1.0 + step / seconds {
            return Next::Done(Outcome::Reached);
        }
        let opening = self.start + share.min(1.0) * (jaw.opening - self.start);
        self.command(JawCommand { opening, ..jaw })
    }

    fn close(&mut self, arm: &ArmState, force: f64, least_width: f64, stops: Depth) -> Next {
        let step = self.macrostep_seconds();
        if (arm.jaw_opening - self.still_at).abs() > STAND {
            self.still_at = arm.jaw_opening;
            self.still_since = self.steps;
        }
        let standing = f64::from(self.steps - self.still_since) * step > STILL;
        // Jaws that meet nothing need not close to the end of their stroke to know it.
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
        let lowest = floor.max(arm.jaw_opening - SQUEEZE);
        let near = least_width + NEAR;
        let (slow, fast) = (self.compliance.jaw_close_speed, self.compliance.jaw_reach_speed);
        // As far as a fast step leads, but near the cube no farther than a slow one.
        let next = (self.set - slow * step).min((self.set - fast * step).max(near));
        // Never up again: what gives way would lead itself.
        self.set = self.set.min(next.max(lowest));
        self.command(JawCommand { opening: self.set, force_limit: force, stops })
    }

    fn command(&self, jaw: JawCommand) -> Next {
        Next::Go(self.compliance.task(self.compliance.yielding(&self.selector), Some(jaw)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::compliance;
    use super::*;
    use crate::motion::{Motion, MoveCommand};

    const LEAST: f64 = 0.055;

    /// Closes jaws that follow their set value down to `stop` (m); the outcome and the lowest set
    /// value.
    fn close(stop: f64) -> (Outcome, f64) {
        let mut grasp = Grasp::new(30.0, LEAST, [true; 6], Depth::One, compliance());
        let mut arm = ArmState { jaw_opening: 0.07, ..ArmState::default() };
        let mut lowest = f64::INFINITY;
        for period in (0..20_000).step_by(8) {
            match grasp.next(&Inputs { arm: &arm, target: None, period, pace: 1.0 }) {
                Next::Done(outcome) => return (outcome, lowest),
                Next::Go(MoveCommand { motion: Motion::Task { .. }, jaw: Some(jaw), .. }) => {
                    lowest = lowest.min(jaw.opening);
                    arm.jaw_opening = jaw.opening.max(stop);
                }
                Next::Go(other) => panic!("{other:?}"),
            }
        }
        panic!("it never ends")
    }

    #[test]
    fn jaws_that_meet_nothing_need_not_close_beyond_their_stroke() {
        let (outcome, lowest) = close(0.0);

        assert!(matches!(outcome, Outcome::Empty(_)), "{outcome:?}");
        assert!(lowest >= LEAST - BELOW - 1e-12, "{lowest}");
    }

    #[test]
    fn jaws_close_slowly_near_the_cube_alone() {
        let (slow, fast) = (0.012, 0.04);
        let compliance = Compliance { jaw_reach_speed: fast, ..compliance() };
        let mut grasp = Grasp::new(30.0, LEAST, [true; 6], Depth::One, compliance);
        let mut arm = ArmState { jaw_opening: 0.07, ..ArmState::default() };
        let (step, near) = (8.0 * PERIOD, LEAST + NEAR);
        let (mut last, mut fastest) = (arm.jaw_opening, 0.0_f64);
        for period in (0..400).step_by(8) {
            let next = grasp.next(&Inputs { arm: &arm, target: None, period, pace: 1.0 });
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

    #[test]
    fn jaws_that_are_pushed_open_are_not_told_to_open() {
        let mut grasp = Grasp::new(30.0, LEAST, [true; 6], Depth::One, compliance());
        let mut set = f64::INFINITY;
        for (step, pushed) in [0.0, 0.0, 0.0, 0.001, 0.002, 0.001].into_iter().enumerate() {
            let arm = ArmState { jaw_opening: 0.0568 + pushed, ..ArmState::default() };
            let period = 8 * step as u64;
            let next = grasp.next(&Inputs { arm: &arm, target: None, period, pace: 1.0 });
            let Next::Go(MoveCommand { jaw: Some(jaw), .. }) = next else { panic!("{next:?}") };
            assert!(jaw.opening <= set, "{} after {set}", jaw.opening);
            set = jaw.opening;
        }
    }

    #[test]
    fn jaws_that_are_to_relieve_a_strain_open_under_it_and_others_do_not() {
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
                match grasp.next(&Inputs { arm: &arm, target: None, period: 0, pace: 1.0 }) {
                    Next::Go(command) => {
                        set = command.jaw.unwrap().opening;
                        assert!(*first.get_or_insert(set) < arm.jaw_opening, "they jump");
                    }
                    Next::Done(outcome) => return (outcome, set),
                }
            }
        };

        assert_eq!(opened(true), (Outcome::Reached, 0.09));
        assert_eq!(opened(false), (Outcome::OverForce(1, 60.0), 0.055));
    }

    #[test]
    fn jaws_that_meet_a_cube_squeeze_it() {
        let (outcome, lowest) = close(0.0568);

        assert_eq!(outcome, Outcome::Grasped(0.0568));
        assert!((lowest - (0.0568 - SQUEEZE)).abs() < 1e-4, "{lowest}");
    }
}
