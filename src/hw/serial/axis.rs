//! One axis behind its serial line: the order of each period, and the judgement of each answer.
//!
//! An answer has no checksum, so it counts only if a motor can have made its counter true. While
//! answers are missed, the counter is extrapolated by its last step. Otherwise an axis would seem
//! to stop for a period and then to make a double step, and its regulator would brake fully in
//! between, which trips a power stage at speed. Measured: with one answer in a thousand missed,
//! every mission failed.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | answers missed or impossible in a row | [`Rules::misses`] | single ones are disturbances |
//! | jump of the counter in a period | [`Rules::jump`] | no motor is faster |
//! | counter off its extrapolation | `LEAP`, unless confirmed | a motor gains no more in a period |
//! | extrapolation | `GOES_ON` | it is off by too much after that |
//! | answer of an earlier order | `CLEARLY`, `LATE` in a row | an axis that brakes looks late |
//! | switches, over-current, error, loss of zero | two answers in a row | one bit may be wrong |
//! | answers that settle a start | `SETTLING` that agree | one of them may be corrupt |
//! | parameter without an answer | [`Rules::tries`] | one order may be lost |
//!
//! - in: the drive of the axis; the bytes of its answer, or none
//! - out: one [`Order`] in each period; the readings of the axis; an [`AxisFault`] if the line must
//!   be given up
//! - A parameter replaces the pulse width of one period. It counts as taken once it is answered.
//! - source: the rules of the original, in which three missed answers in a row and a jump by more
//!   than 1000 are faults, switches must show twice, and four answers settle a start. In the
//!   original one impossible answer is a fault, and limit switches, over-current and loss of
//!   synchronisation need to show only once.

use super::frame::{Mode, Order, Parameter, STATUS, Status};
use crate::servo::lateness::Interval;

/// Drive of an axis in a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisDrive {
    /// Whether the power stage is on.
    pub enabled: bool,
    /// Pulse width, -255..=255.
    pub width: i16,
    /// Digital outputs.
    pub outputs: u8,
    /// Limit of the motor current (mA), if the servo sets one.
    pub max_current: Option<u16>,
    /// Whether the counter becomes zero at the next zero of the encoder.
    pub synchronise: bool,
}

/// Rules of an axis's line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rules {
    /// Number of missed or impossible answers in a row after which the line is given up.
    pub misses: u32,
    /// Largest motion of a counter in a period (increments).
    pub jump: i32,
    /// Number of times that a parameter is sent without an answer before the line is given up.
    pub tries: u32,
}

impl Default for Rules {
    fn default() -> Self {
        Self { misses: 3, jump: 1000, tries: 3 }
    }
}

/// Result of judging an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Answer that was taken.
    Taken,
    /// No answer, for this number of times in a row.
    Missed(u32),
    /// Answer that cannot be true, for this number of times in a row.
    Impossible(u32),
    /// Answer that belongs to an earlier order.
    Late,
}

/// Reason for giving up a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AxisFault {
    /// No answers for this number of periods.
    #[error("no answer for {0} periods")]
    Silent(u32),
    /// Answers that cannot be true.
    #[error(
        "{times} impossible answers in a row, the last with the counter at {count} after {before}"
    )]
    Impossible {
        /// Number of them in a row.
        times: u32,
        /// Counter in the last answer.
        count: i32,
        /// Last counter that was believed.
        before: i32,
    },
    /// Error mode, into which the controller has switched itself.
    #[error("the axis controller is in its error mode")]
    Error,
    /// Loss of the synchronisation, which shows that the controller was reset.
    #[error("the axis controller has lost its synchronisation: it was reset")]
    Reset,
    /// Parameter that was never answered.
    #[error("the axis controller does not confirm the parameter {0:?}")]
    Untaken(Parameter),
}

/// A flag that changes when two answers in a row show it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Twice {
    last: bool,
    is: bool,
}

impl Twice {
    /// Takes the flag of the next answer; returns the flag that counts.
    fn see(&mut self, now: bool) -> bool {
        if now == self.last {
            self.is = now;
        }
        self.last = now;
        self.is
    }
}

/// An axis, and the history of its line.
#[derive(Debug, Clone)]
pub struct Axis {
    rules: Rules,
    /// Latest answer that was believed.
    status: Status,
    /// Counter of that answer, extrapolated since then, and its step per period (increments).
    count: i32,
    step: f64,
    /// Time since that answer by the clock, and the part of it since the previous order (periods).
    interval: Interval,
    passed: f64,
    /// Speed before the last gap without answers (increments per period).
    fast: f64,
    /// Counter of the answer from which the step is computed, and the time since then (periods). It
    /// is the last answer, except while that one may be older than it seems; then it is the one
    /// before the gap.
    from: i32,
    age: f64,
    /// Number of answers that count towards settling the start.
    settled: u32,
    /// First byte of this controller's answers, once one has come.
    begins: Option<u8>,
    misses: u32,
    /// Number of answers in a row that were taken for an earlier order's.
    late: u32,
    impossible: u32,
    /// Counter of the last answer, if no motor could have reached it: another answer may confirm
    /// it.
    doubted: Option<i32>,
    upper: Twice,
    lower: Twice,
    over_current: Twice,
    sync_switch: Twice,
    stage_fault: Twice,
    error: Twice,
    synchronised: Twice,
    was_synchronised: bool,
    /// Whether the controller was asked to synchronise: its counter may jump, and it reports that
    /// it is not synchronised.
    synchronising: bool,
    /// Mode and current limit that the controller has confirmed.
    mode: Option<Mode>,
    max_current: Option<u16>,
    /// Parameter of the last order, and the number of times that it was sent in vain.
    sent: Option<Parameter>,
    tries: u32,
}

/// Largest step of a counter that shows nothing about the time of an answer (increments).
const NOISE: f64 = 8.0;
/// Number of periods for which a counter is extrapolated.
const GOES_ON: f64 = 10.0;
/// Largest distance of a counter from its extrapolation over one period: the most that a motor can
/// gain in it (increments).
const LEAP: f64 = 64.0;
/// Smallest time between two answers that show a speed (periods).
const APART: f64 = 0.5;
/// Factor by which an answer must be nearer to where the axis was expected a period earlier, to
/// count as late. The answer of an axis that brakes is somewhat nearer to that place as well. If it
/// were ignored, the axis would seem to have moved on, and its regulator would brake even harder.
const CLEARLY: f64 = 3.0;
/// Largest number of answers in a row that count as answers to an earlier order. The answers of an
/// axis that brakes look late as well, and the answer that is still due may be lost.
const LATE: u32 = 2;
/// Number of answers that settle a start if they agree.
const SETTLING: u32 = 4;

impl Axis {
    /// Makes the state of an axis with which nothing was exchanged yet.
    #[must_use]
    pub fn new(rules: Rules) -> Self {
        Self {
            rules,
            status: Status::default(),
            count: 0,
            step: 0.0,
            interval: Interval::default(),
            passed: 0.0,
            fast: 0.0,
            from: 0,
            age: 0.0,
            settled: 0,
            begins: None,
            misses: 0,
            late: 0,
            impossible: 0,
            doubted: None,
            upper: Twice::default(),
            lower: Twice::default(),
            over_current: Twice::default(),
            sync_switch: Twice::default(),
            stage_fault: Twice::default(),
            error: Twice::default(),
            synchronised: Twice::default(),
            was_synchronised: false,
            synchronising: false,
            mode: None,
            max_current: None,
            sent: None,
            tries: 0,
        }
    }

    /// Returns the order to send for this period's drive: a parameter that the controller has not
    /// confirmed yet, else the pulse width.
    pub fn order(&mut self, drive: &AxisDrive) -> Order {
        self.synchronising = drive.synchronise;
        if drive.synchronise {
            // The search for the zero makes the controller report that it is not synchronised,
            // which would look like a reset.
            self.was_synchronised = false;
        }
        let mode = if drive.enabled { Mode::Pwm } else { Mode::Manual };
        // The current limit precedes the mode, so it applies when the power comes on.
        let wanted = drive
            .max_current
            .filter(|limit| self.max_current != Some(*limit))
            .map(Parameter::MaxCurrent)
            .or((self.mode != Some(mode)).then_some(Parameter::Mode(mode)));
        // Each new parameter has all its tries.
        if self.sent != wanted {
            self.tries = 0;
        }
        self.sent = wanted;
        match wanted {
            Some(parameter) => Order::Set(parameter),
            None => Order::Pwm {
                width: if drive.enabled { drive.width } else { 0 },
                outputs: drive.outputs,
                synchronise: drive.synchronise,
            },
        }
    }

    /// Adds the time since the order before (periods, by the clock), and extrapolates the counter
    /// over it, at most 10 periods beyond the last answer. Motors move on while this machine is
    /// delayed.
    pub fn pass(&mut self, periods: f64) {
        self.passed = periods;
        self.age += periods;
        self.interval.pass(periods);
        self.count = self.expected(self.interval.since());
    }

    /// Returns the counter that is expected `since` periods after the last believed answer, at the
    /// speed of the axis then.
    fn expected(&self, since: f64) -> i32 {
        self.status.count.wrapping_add((self.step * since.clamp(0.0, GOES_ON)).round() as i32)
    }

    /// Returns whether an answer belongs to an earlier order that was not answered yet: its counter
    /// is clearly nearer to the counter expected at the order before than to the one expected now.
    #[must_use]
    pub fn is_late(&self, answer: &[u8; STATUS]) -> bool {
        // A corrupt answer tells nothing about its order. After two late answers the one that is
        // still due counts as lost.
        if self.begins != Some(answer[0]) || self.late >= LATE {
            return false;
        }
        let reading = Status::decode(answer);
        let off = |count: i32| f64::from(reading.count.wrapping_sub(count)).abs();
        let since = self.interval.since();
        // An axis at rest has the same counter in both periods.
        self.step.abs() > NOISE
            && off(self.expected(since - self.passed)) * CLEARLY < off(self.expected(since))
    }

    /// Ignores an answer for which [`Self::is_late`] returned true. It shows nothing about this
    /// period, but the line is alive.
    pub fn ignore_late(&mut self) -> Answer {
        self.late += 1;
        self.misses = 0;
        Answer::Late
    }

    /// Decides whether the answer to the last order is believed, or counted as impossible. `None`
    /// means that no answer came, which is counted as missed.
    ///
    /// # Errors
    /// Returns an [`AxisFault`] if the line must be given up.
    pub fn take(&mut self, answer: Option<&[u8; STATUS]>) -> Result<Answer, AxisFault> {
        let Some(bytes) = answer else {
            self.misses += 1;
            if self.misses >= self.rules.misses {
                return Err(AxisFault::Silent(self.misses));
            }
            self.count_try()?;
            return Ok(Answer::Missed(self.misses));
        };
        (self.misses, self.late) = (0, 0);
        // The answer to a parameter only confirms it: its other bytes need not be a reading.
        if self.sent.is_some() && self.begins.is_none_or(|first| first == bytes[0]) {
            self.confirm();
            return Ok(Answer::Taken);
        }
        let settled = self.has_settled();
        // The source does not specify the first byte, so it is learned from the first answers.
        if !settled && self.begins != Some(bytes[0]) {
            (self.begins, self.settled) = (Some(bytes[0]), 0);
        }
        // A reading, if it begins like the others.
        let reading = (self.begins == Some(bytes[0])).then(|| Status::decode(bytes));
        match reading.filter(|now| self.is_possible(now, settled)) {
            Some(now) => self.believe(now, settled),
            None => self.doubt(reading),
        }
    }

    /// Returns the largest distance that a motor can have moved the counter since the last believed
    /// answer (increments).
    fn most(&self) -> f64 {
        f64::from(self.rules.jump) * self.interval.longest()
    }

    /// Returns whether a motor can have moved the counter from the last believed answer to the
    /// reading `now`. Every reading is possible before the start has `settled`. The counter of an
    /// impossible reading is remembered.
    ///
    /// Answers have no checksum, and one wrong bit would make an axis jump. If a motor was really
    /// displaced, the next answer shows a counter near this one.
    fn is_possible(&mut self, now: &Status, settled: bool) -> bool {
        // A motor can stop or double its step, and what it gains by acceleration grows with the
        // square of the time.
        let plain = self.step.abs() + LEAP * self.interval.since().max(1.0).powi(2);
        let jump = f64::from(self.rules.jump);
        // After a gap the last reading may be older than it seems; its step then appears at once.
        let hidden = (self.fast + 2.0 * LEAP).min(jump) * self.interval.older();
        let off = |count: i32| f64::from(now.count.wrapping_sub(count)).abs();
        let most = self.most();
        let confirmed = self.doubted.is_some_and(|at| off(at) <= 0.5 * most);
        let odd = off(self.count) > plain + hidden && !confirmed;
        self.doubted = odd.then_some(now.count);
        // A start has no counter to compare with, and the zero of a synchronisation makes the
        // counter jump.
        !settled || self.finds_zero(now) || (!odd && off(self.count) <= most)
    }

    /// Ignores an answer that cannot be true, until too many of them have come in a row. `reading`
    /// is `None` if its first byte is wrong.
    fn doubt(&mut self, reading: Option<Status>) -> Result<Answer, AxisFault> {
        // Without a counter there is none to confirm.
        if reading.is_none() {
            self.doubted = None;
        }
        self.impossible += 1;
        self.count_try()?;
        // A controller that was reset counts from zero and reports that it is not synchronised.
        let reset = reading.is_some_and(|now| !now.synchronised) && self.was_synchronised;
        if self.impossible < self.rules.misses {
            Ok(Answer::Impossible(self.impossible))
        } else if reset {
            Err(AxisFault::Reset)
        } else {
            let count = reading.map_or(0, |now| now.count);
            let before = self.status.count;
            Err(AxisFault::Impossible { times: self.impossible, count, before })
        }
    }

    /// Accepts a reading as true: its counter, the speed that follows from it, and its flags.
    /// `settled` says whether the start was settled before it.
    fn believe(&mut self, now: Status, settled: bool) -> Result<Answer, AxisFault> {
        self.impossible = 0;
        let near = f64::from(now.count.wrapping_sub(self.status.count)).abs() <= self.most();
        if !settled && !near {
            // One of the two answers is corrupt. Others must agree before the position is known.
            self.settled = 0;
        }
        self.settled = self.settled.saturating_add(1);
        // A jump to zero is no motion, and neither is the first counter.
        if !settled || self.finds_zero(&now) {
            self.step = 0.0;
            self.interval = Interval::default();
        } else {
            self.learn_speed(&now);
        }
        // The time of this reading is sure, so the next step is computed from it.
        if self.interval.older() == 0.0 {
            (self.from, self.age) = (now.count, 0.0);
        }
        (self.status, self.count) = (now, now.count);
        self.confirm();
        self.see_flags(&now)
    }

    /// Computes the speed of the axis from the reading `now`, and decides whether the reading shows
    /// the motion that took place in a gap without answers.
    fn learn_speed(&mut self, now: &Status) {
        let gone = f64::from(now.count.wrapping_sub(self.status.count)).abs();
        let since = self.interval.since();
        if self.interval.older() == 0.0 {
            // After a gap the speed before it is kept, since the readings may not show one.
            self.fast = self.step.abs();
        }
        // Two answers that come close together, because one was delayed, show no speed.
        if self.age > APART {
            self.step = f64::from(now.count.wrapping_sub(self.from)) / self.age;
        }
        // A reading is of the present if it shows half of the step that a gap hid, or more than the
        // time since the last reading explains. Two readings are never exactly one period apart,
        // hence `APART`.
        let gap = since > 1.0 + APART;
        let explained = (self.fast + 2.0 * LEAP) * since.max(1.0);
        self.interval.read(gap && gone > 0.5 * self.fast * since || gone > explained);
    }

    /// Returns whether a reading reports the zero of a synchronisation. Its counter has jumped
    /// already.
    fn finds_zero(&self, now: &Status) -> bool {
        self.synchronising && now.synchronised && !self.synchronised.is
    }

    /// Records that the controller has confirmed the parameter of the last order, if it had one.
    fn confirm(&mut self) {
        match self.sent.take() {
            Some(Parameter::Mode(mode)) => self.mode = Some(mode),
            Some(Parameter::MaxCurrent(limit)) => self.max_current = Some(limit),
            _ => {}
        }
        self.tries = 0;
    }

    /// Counts an order of a parameter that was not answered; returns a fault if it was the last
    /// try.
    fn count_try(&mut self) -> Result<(), AxisFault> {
        let Some(parameter) = self.sent else { return Ok(()) };
        self.tries += 1;
        if self.tries >= self.rules.tries {
            return Err(AxisFault::Untaken(parameter));
        }
        Ok(())
    }

    /// Stores the flags of a reading; returns the fault of a controller that is in its error mode
    /// or was reset.
    fn see_flags(&mut self, now: &Status) -> Result<Answer, AxisFault> {
        self.upper.see(now.upper);
        self.lower.see(now.lower);
        self.over_current.see(now.over_current);
        self.sync_switch.see(now.sync_switch);
        self.stage_fault.see(now.stage_fault);
        // Before its first mode a controller may still be in the error mode of the last run.
        if self.error.see(now.error) && self.mode.is_some() && self.settled >= SETTLING {
            return Err(AxisFault::Error);
        }
        if self.synchronising {
            // The counter jumps in the same answer, so the flag counts at once.
            self.synchronised = Twice { last: now.synchronised, is: now.synchronised };
            return Ok(Answer::Taken);
        }
        self.synchronised.see(now.synchronised);
        // A controller forgets its zero by a reset only.
        if self.was_synchronised && !self.synchronised.is {
            return Err(AxisFault::Reset);
        }
        self.was_synchronised = self.synchronised.is;
        Ok(Answer::Taken)
    }

    /// Returns the encoder counter, extrapolated while answers are missed (increments).
    #[must_use]
    pub fn count(&self) -> i64 {
        i64::from(self.count)
    }

    /// Returns whether the counter is extrapolated, because the last order was not answered.
    #[must_use]
    pub fn is_extrapolated(&self) -> bool {
        self.interval.since() > 0.0
    }

    /// Returns the motor current (A).
    #[must_use]
    pub fn current(&self) -> f64 {
        f64::from(self.status.current) * 1e-3
    }

    /// Returns whether the upper and the lower limit switch are hit.
    #[must_use]
    pub fn at_limits(&self) -> (bool, bool) {
        (self.upper.is, self.lower.is)
    }

    /// Returns whether the power stage reports over-current.
    #[must_use]
    pub fn over_current(&self) -> bool {
        self.over_current.is
    }

    /// Returns whether the power stage reports a fault of its own.
    #[must_use]
    pub fn stage_fault(&self) -> bool {
        self.stage_fault.is
    }

    /// Returns whether the synchronisation switch is closed.
    #[must_use]
    pub fn sync_switch(&self) -> bool {
        self.sync_switch.is
    }

    /// Returns whether the last answer reports that the encoder's zero has passed.
    #[must_use]
    pub fn sync_zero(&self) -> bool {
        self.status.sync_zero
    }

    /// Returns whether the counter counts from the synchronisation switch.
    #[must_use]
    pub fn synchronised(&self) -> bool {
        self.synchronised.is
    }

    /// Returns whether the axis controller has answered often enough to trust its encoder counter.
    #[must_use]
    pub fn has_settled(&self) -> bool {
        self.settled >= SETTLING
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ON: AxisDrive =
        AxisDrive { enabled: true, width: 100, outputs: 0, max_current: None, synchronise: false };

    /// Returns the answer of a synchronised axis at rest, with this counter.
    fn at(count: i32) -> Status {
        Status { count, synchronised: true, ..Status::default() }
    }

    /// Lets a period pass and gives the axis this answer.
    fn after_a_period(axis: &mut Axis, answer: Option<&[u8; STATUS]>) -> Result<Answer, AxisFault> {
        axis.pass(1.0);
        axis.take(answer)
    }

    /// Makes an axis with power on, at rest at 5000 increments.
    fn running() -> Axis {
        let mut axis = Axis::new(Rules::default());
        for _ in 0..6 {
            axis.order(&ON);
            assert_eq!(after_a_period(&mut axis, Some(&at(5000).encode())), Ok(Answer::Taken));
        }
        axis
    }

    #[test]
    fn axis_sets_mode_before_sending_pulse_widths() {
        let mut axis = Axis::new(Rules::default());

        assert_eq!(axis.order(&ON), Order::Set(Parameter::Mode(Mode::Pwm)));
        assert_eq!(after_a_period(&mut axis, None), Ok(Answer::Missed(1)));
        assert_eq!(
            axis.order(&ON),
            Order::Set(Parameter::Mode(Mode::Pwm)),
            "the order was not answered"
        );
        after_a_period(&mut axis, Some(&at(7).encode())).unwrap();
        assert_eq!(axis.order(&ON), Order::Pwm { width: 100, outputs: 0, synchronise: false });
        let off = AxisDrive { enabled: false, ..ON };
        assert_eq!(axis.order(&off), Order::Set(Parameter::Mode(Mode::Manual)));
    }

    #[test]
    fn current_limit_replaces_one_pulse_width() {
        let mut axis = running();
        let limited = AxisDrive { max_current: Some(54), ..ON };

        assert_eq!(axis.order(&limited), Order::Set(Parameter::MaxCurrent(54)));
        after_a_period(&mut axis, Some(&at(5000).encode())).unwrap();
        assert!(matches!(axis.order(&limited), Order::Pwm { .. }));
    }

    /// One corrupt answer at any place of the start delays it, but its counter is never believed.
    #[test]
    fn corrupt_answer_delays_start_without_setting_counter() {
        let (good, spoilt) = (at(5000).encode(), at(5000 + (1 << 30)).encode());
        for spoilt_one in 0..SETTLING {
            let mut axis = Axis::new(Rules::default());
            for k in 0..=SETTLING + spoilt_one {
                assert!(!axis.has_settled() || axis.count() == 5000, "after {k}");
                let answer = if k == spoilt_one { &spoilt } else { &good };
                assert_eq!(after_a_period(&mut axis, Some(answer)), Ok(Answer::Taken));
            }
            assert!(axis.has_settled() && axis.count() == 5000, "{spoilt_one}");
        }
    }

    #[test]
    fn third_missed_answer_is_a_fault() {
        let mut axis = running();
        let miss = |axis: &mut Axis| {
            axis.order(&ON);
            after_a_period(axis, None)
        };

        assert_eq!(miss(&mut axis), Ok(Answer::Missed(1)));
        assert_eq!(miss(&mut axis), Ok(Answer::Missed(2)));
        axis.order(&ON);
        after_a_period(&mut axis, Some(&at(5001).encode())).unwrap();
        assert_eq!(miss(&mut axis), Ok(Answer::Missed(1)));
        assert_eq!(miss(&mut axis), Ok(Answer::Missed(2)));
        assert_eq!(miss(&mut axis), Err(AxisFault::Silent(3)));
    }

    #[test]
    fn answer_with_outdated_counter_is_judged_late() {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(300 * k))).unwrap();
        }
        after_a_period(&mut axis, None).unwrap();
        axis.pass(1.0);

        assert!(axis.is_late(&at(300 * 20 + 5)));
        assert!(!axis.is_late(&at(300 * 21 - 5)));
    }

    /// Gives an axis that moved by 20 increments per period these counters in three periods, after
    /// one answer was lost. Returns how each was judged.
    fn after_a_lost_answer(counts: [i32; 3]) -> [Answer; 3] {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(20 * k))).unwrap();
        }
        after_a_period(&mut axis, None).unwrap();

        counts.map(|count| {
            axis.pass(1.0);
            let late = axis.is_late(&at(count));
            if late { axis.ignore_late() } else { axis.take(Some(&at(count))).unwrap() }
        })
    }

    /// An answer that looks late does not count as missed, and after two of them the counter is
    /// believed.
    #[test]
    fn at_most_two_consecutive_answers_are_judged_late() {
        use Answer::{Late, Taken};

        // An axis that has stopped gives the same answer as a late one.
        assert_eq!(after_a_lost_answer([400, 400, 400]), [Late, Taken, Taken]);
        // Each answer is one period behind, so the one that is due will not come.
        assert_eq!(after_a_lost_answer([400, 420, 440]), [Late, Late, Taken]);
        assert_eq!(after_a_lost_answer([420, 440, 460]), [Taken; 3]);
    }

    /// The counter of a braking axis is nearer to the one expected a period earlier, but not
    /// clearly nearer. At the end of the braking, below 80 increments per period, a braking axis
    /// and a late answer look alike, and little depends on the difference.
    #[test]
    fn answers_of_braking_axis_are_not_judged_late() {
        for lost in 1..9 {
            let mut axis = Axis::new(Rules::default());
            let at = |count| Status { count, ..Status::default() }.encode();
            let mut count = 0;
            for _ in 0..20 {
                count += 190;
                after_a_period(&mut axis, Some(&at(count))).unwrap();
            }
            for k in 1..12 {
                // A track that brakes as fast as it may, within 20 ms.
                count += 190 - 16 * k;
                axis.pass(1.0);
                if k == lost {
                    axis.take(None).unwrap();
                    continue;
                }
                assert!(k != lost + 1 || !axis.is_late(&at(count)), "{lost}");
                axis.take(Some(&at(count))).unwrap();
            }
        }
    }

    /// The counter is extrapolated over a delay of 8 periods. The next reading may lie anywhere
    /// between the last counter and the extrapolated one.
    #[test]
    fn counter_extrapolates_over_a_delay() {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(300 * k))).unwrap();
        }

        axis.pass(8.0);
        assert_eq!(axis.count(), 300 * 27);
        assert_eq!(axis.take(Some(&at(300 * 23))), Ok(Answer::Taken), "the axis braked meanwhile");
        axis.pass(1.0);
        assert_eq!(axis.count(), 300 * 23 + 150, "4 steps in 8 periods");
        assert!(matches!(axis.take(Some(&at(300 * 60))), Ok(Answer::Impossible(1))));
    }

    /// The first answer after a delay may be from the beginning of the delay. The next answer then
    /// shows all the motion of the delay.
    #[test]
    fn motion_during_delay_is_accepted_one_reading_later() {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(300 * k))).unwrap();
        }

        axis.pass(12.0);
        let old = at(300 * 20);
        assert_eq!(
            axis.take(Some(&old)),
            Ok(Answer::Taken),
            "from the beginning of the standstill"
        );
        for k in 32..40 {
            let taken = after_a_period(&mut axis, Some(&at(300 * k)));
            assert_eq!(taken, Ok(Answer::Taken), "a reading of this period");
            // The extrapolation after the reading is right at once.
            let mut guess = axis.clone();
            after_a_period(&mut guess, None).unwrap();
            assert!((guess.count() - i64::from(300 * (k + 1))).abs() <= 2, "{}", guess.count());
        }
        // By 1100 increments farther than expected: beyond the usual limit of 1000.
        let far = at(300 * 39 + 1400);
        assert_eq!(
            after_a_period(&mut axis, Some(&far)),
            Ok(Answer::Impossible(1)),
            "the tolerance is over"
        );
    }

    /// The motion of a delay may show in two parts, one in each of two readings.
    #[test]
    fn motion_during_delay_is_accepted_in_two_parts() {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(300 * k))).unwrap();
        }

        axis.pass(12.0);
        axis.take(Some(&at(300 * 20))).unwrap();
        for count in [300 * 21, 300 * 33] {
            axis.pass(1.003);
            assert_eq!(axis.take(Some(&at(count))), Ok(Answer::Taken), "{count}");
        }
    }

    #[test]
    fn counter_extrapolates_while_answers_are_missed() {
        let mut axis = running();
        after_a_period(&mut axis, Some(&at(5100).encode())).unwrap();
        after_a_period(&mut axis, Some(&at(5200).encode())).unwrap();

        after_a_period(&mut axis, None).unwrap();
        assert_eq!(axis.count(), 5300);
        after_a_period(&mut axis, Some(b"$1234567")).unwrap();
        assert_eq!(axis.count(), 5400);
        after_a_period(&mut axis, Some(&at(5503).encode())).unwrap();
        assert_eq!(axis.count(), 5503);
        after_a_period(&mut axis, None).unwrap();
        assert_eq!(axis.count(), 5604, "101 a period");
    }

    /// A corrupt answer is ignored. A jump that a second answer confirms is believed, unless it
    /// exceeds the limit.
    #[test]
    fn lasting_impossible_jump_of_counter_is_a_fault() {
        let mut axis = running();
        // The largest possible step is 1000 increments in a period.
        let jumped = at(5000 + 1001).encode();

        assert_eq!(after_a_period(&mut axis, Some(&jumped)), Ok(Answer::Impossible(1)));
        assert_eq!(axis.count(), 5000);
        assert_eq!(after_a_period(&mut axis, Some(&at(5100).encode())), Ok(Answer::Taken));
        assert_eq!(after_a_period(&mut axis, Some(b"$1234567")), Ok(Answer::Impossible(1)));
        for judged in [Ok(Answer::Impossible(2)), Ok(Answer::Taken)] {
            assert_eq!(
                after_a_period(&mut axis, Some(&at(5800).encode())),
                judged,
                "reported twice"
            );
        }
        for _ in 0..2 {
            assert!(matches!(
                after_a_period(&mut axis, Some(&at(0).encode())),
                Ok(Answer::Impossible(_))
            ));
        }
        assert!(matches!(
            after_a_period(&mut axis, Some(&at(0).encode())),
            Err(AxisFault::Impossible { times: 3, count: 0, before: 5800 })
        ));
    }

    #[test]
    fn limit_and_overcurrent_flags_need_two_consecutive_answers() {
        for (upper, lower, over_current) in
            [(true, false, true), (false, true, false), (false, false, true)]
        {
            let mut axis = running();
            let hit = Status { upper, lower, over_current, ..at(5000) };

            after_a_period(&mut axis, Some(&hit.encode())).unwrap();
            assert!(axis.at_limits() == (false, false) && !axis.over_current());
            after_a_period(&mut axis, Some(&at(5000).encode())).unwrap();
            after_a_period(&mut axis, Some(&hit.encode())).unwrap();
            assert!(axis.at_limits() == (false, false) && !axis.over_current());
            after_a_period(&mut axis, Some(&hit.encode())).unwrap();
            assert_eq!((axis.at_limits(), axis.over_current()), ((upper, lower), over_current));
        }
    }

    #[test]
    fn axis_controller_reset_is_reported_as_fault() {
        let mut axis = running();
        let near = Status { synchronised: false, ..at(4950) };
        assert_eq!(after_a_period(&mut axis, Some(&near.encode())), Ok(Answer::Taken));
        assert_eq!(after_a_period(&mut axis, Some(&near.encode())), Err(AxisFault::Reset));

        let mut axis = running();
        let far = Status { synchronised: false, ..at(0) }.encode();
        after_a_period(&mut axis, Some(&far)).unwrap();
        after_a_period(&mut axis, Some(&far)).unwrap();
        assert_eq!(after_a_period(&mut axis, Some(&far)), Err(AxisFault::Reset));
    }

    #[test]
    fn third_unanswered_parameter_order_is_a_fault() {
        let mut axis = running();
        let off = AxisDrive { enabled: false, ..ON };
        for answer in [None, Some(b"$1234567")] {
            axis.order(&off);
            after_a_period(&mut axis, answer).unwrap();
        }
        axis.order(&off);
        assert_eq!(
            after_a_period(&mut axis, None),
            Err(AxisFault::Untaken(Parameter::Mode(Mode::Manual)))
        );
    }

    #[test]
    fn counter_may_jump_while_axis_synchronises() {
        let mut axis = running();
        let homing = AxisDrive { synchronise: true, ..ON };
        let lost = Status { synchronised: false, ..at(5010) };

        assert_eq!(axis.order(&homing), Order::Pwm { width: 100, outputs: 0, synchronise: true });
        assert_eq!(after_a_period(&mut axis, Some(&lost.encode())), Ok(Answer::Taken));
        assert!(!axis.synchronised());
        axis.order(&homing);
        assert_eq!(after_a_period(&mut axis, Some(&at(3).encode())), Ok(Answer::Taken));
        assert!(axis.synchronised());
        assert_eq!(axis.count(), 3);
        axis.order(&ON);
        assert_eq!(after_a_period(&mut axis, Some(&at(4).encode())), Ok(Answer::Taken));
    }

    /// The first byte of the answers is learned at the start.
    #[test]
    fn axis_learns_first_byte_of_its_answers() {
        let begun_with = |first: u8, bytes: [u8; STATUS]| [&[first], &bytes[1..]].concat();
        let mut axis = Axis::new(Rules::default());
        for _ in 0..6 {
            axis.order(&ON);
            let answer: [u8; STATUS] = begun_with(0x55, at(5000).encode()).try_into().unwrap();
            assert_eq!(after_a_period(&mut axis, Some(&answer)), Ok(Answer::Taken));
        }
        assert!(axis.has_settled());
        axis.order(&ON);
        let other = at(5000).encode();
        assert_eq!(after_a_period(&mut axis, Some(&other)), Ok(Answer::Impossible(1)));
    }
}
